use std::fs::{self, File, OpenOptions};
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::OutputError;
use super::npz::{self, visit_array, write_array};

/// Name, shape (the number of rows first) and values of an array of an archive.
pub type ArrayView<'a> = (&'static str, Vec<usize>, &'a [f64]);

/// Bytes of a row of all arrays.
pub fn row_bytes(layout: &[ArrayView]) -> u64 {
    let numbers: usize = layout
        .iter()
        .map(|(_, shape, _)| shape[1..].iter().product::<usize>())
        .sum();
    8 * numbers as u64
}

/// Rows of several arrays on their way to an archive: a file of plain numbers (64 bits, little-endian) per array.
///
/// Memory does not grow with the rows. Files that hold more rows than are known to be good, as after the death of
/// the process, are cut when they are opened again.
#[derive(Debug)]
pub struct RowFiles {
    arrays: Vec<RowFile>,
    n_rows: usize,
}

#[derive(Debug)]
struct RowFile {
    name: &'static str,
    /// Shape of one row; empty for a number per row.
    row_shape: Vec<usize>,
    path: PathBuf,
    writer: BufWriter<File>,
}

impl RowFile {
    fn row_bytes(&self) -> u64 {
        8 * self.row_shape.iter().product::<usize>() as u64
    }

    fn unwritten(&self, action: &'static str) -> impl FnOnce(io::Error) -> OutputError {
        OutputError::unwritten(&self.path, action)
    }

    fn unread(&self) -> impl FnOnce(io::Error) -> OutputError {
        OutputError::io(&self.path, "cannot read")
    }

    fn reader(&self) -> Result<BufReader<File>, OutputError> {
        File::open(&self.path)
            .map(BufReader::new)
            .map_err(self.unread())
    }
}

impl RowFiles {
    /// Opens the files in `folder` for arrays like those of `layout`, whose values do not matter, and keeps the first
    /// `n_rows` rows; with 0 the files need not exist.
    pub fn open(folder: &Path, layout: &[ArrayView], n_rows: usize) -> Result<Self, OutputError> {
        fs::create_dir_all(folder).map_err(OutputError::unwritten(folder, "cannot create"))?;
        let mut arrays = Vec::new();
        for (name, shape, _) in layout {
            let path = folder.join(format!("{name}.f64"));
            let file = OpenOptions::new()
                .write(true)
                .create(true)
                .truncate(false)
                .open(&path)
                .map_err(OutputError::unwritten(&path, "cannot open"))?;
            let mut array = RowFile {
                name,
                row_shape: shape[1..].to_vec(),
                path,
                writer: BufWriter::new(file),
            };
            let length = n_rows as u64 * array.row_bytes();
            let file = array.writer.get_mut();
            let cut = || {
                let present = file.metadata()?.len();
                file.set_len(length)?;
                file.seek(SeekFrom::Start(length))?;
                Ok(present)
            };
            let present = { cut }().map_err(array.unwritten("cannot cut"))?;
            if present < length {
                return Err(OutputError::malformed(
                    &array.path,
                    format!("{present} bytes, but {n_rows} rows take {length}; start over"),
                ));
            }
            arrays.push(array);
        }
        Ok(Self { arrays, n_rows })
    }

    /// Fills the files from an archive that [`write_npz`](Self::write_npz) wrote, and keeps the first `n_rows` rows.
    pub fn unpack(
        archive: &Path,
        folder: &Path,
        layout: &[ArrayView],
        n_rows: usize,
    ) -> Result<Self, OutputError> {
        let mut files = Self::open(folder, layout, 0)?;
        let mut source = npz::open(archive)?;
        for array in &mut files.arrays {
            let mut expected = vec![None];
            expected.extend(array.row_shape.iter().map(|&size| Some(size)));
            visit_array(&mut source, array.name, &expected, |value| {
                array.writer.write_all(&value.to_le_bytes())
            })
            .map_err(|reason| {
                OutputError::malformed(archive, format!("array {}: {reason}", array.name))
            })?;
        }
        files.flush()?;
        drop(files);
        Self::open(folder, layout, n_rows)
    }

    /// Rows so far.
    pub fn n_rows(&self) -> usize {
        self.n_rows
    }

    /// Appends a row: the values of every array, in the order of the layout.
    pub fn push(&mut self, row: &[ArrayView]) -> Result<(), OutputError> {
        for (array, (_, _, values)) in self.arrays.iter_mut().zip(row) {
            values
                .iter()
                .try_for_each(|value| array.writer.write_all(&value.to_le_bytes()))
                .map_err(array.unwritten("cannot write"))?;
        }
        self.n_rows += 1;
        Ok(())
    }

    /// Hands everything to the operating system, where it outlives the process.
    pub fn flush(&mut self) -> Result<(), OutputError> {
        for array in &mut self.arrays {
            array
                .writer
                .flush()
                .map_err(array.unwritten("cannot write"))?;
        }
        Ok(())
    }

    /// One reader an array, of everything pushed so far.
    fn readers(&mut self) -> Result<Vec<BufReader<File>>, OutputError> {
        self.flush()?;
        self.arrays.iter().map(RowFile::reader).collect()
    }

    /// Reads the rows again, from the first one on: the values of every array, in the order of the layout.
    pub fn replay(&mut self, mut visit: impl FnMut(&[Vec<f64>])) -> Result<(), OutputError> {
        let mut readers = self.readers()?;
        let mut row: Vec<Vec<f64>> = self
            .arrays
            .iter()
            .map(|array| vec![0.0; array.row_bytes() as usize / 8])
            .collect();
        for _ in 0..self.n_rows {
            for ((array, reader), values) in self.arrays.iter().zip(&mut readers).zip(&mut row) {
                for value in values {
                    *value = next_number(reader).map_err(array.unread())?;
                }
            }
            visit(&row);
        }
        Ok(())
    }

    /// Writes the rows as a numpy archive: byte for byte what it would be had they all been in memory.
    pub fn write_npz(&mut self, path: &Path) -> Result<(), OutputError> {
        let mut readers = self.readers()?;
        npz::write(path, |archive| {
            for (array, reader) in self.arrays.iter().zip(&mut readers) {
                let mut shape = vec![self.n_rows];
                shape.extend(&array.row_shape);
                let n_numbers: usize = shape.iter().product();
                let numbers = (0..n_numbers).map(|_| next_number(reader));
                write_array(archive, array.name, &shape, numbers)?;
            }
            Ok(())
        })
    }
}

fn next_number(reader: &mut impl Read) -> io::Result<f64> {
    let mut bytes = [0; 8];
    reader.read_exact(&mut bytes)?;
    Ok(f64::from_le_bytes(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::MotionRecord;
    use crate::output::motion::tests::record;

    /// Row `row` of a record, as a record.
    fn row_of(record: &MotionRecord, row: usize) -> MotionRecord {
        let mut one = MotionRecord::empty(record.n_nodes);
        for (target, (_, shape, values)) in one.arrays_mut().into_iter().zip(record.arrays()) {
            let width: usize = shape[1..].iter().product();
            target.extend(&values[row * width..(row + 1) * width]);
        }
        one
    }

    fn pushed(folder: &Path, record: &MotionRecord, rows: std::ops::Range<usize>) -> RowFiles {
        let mut files = RowFiles::open(folder, &record.arrays(), rows.start).unwrap();
        for row in rows {
            files.push(&row_of(record, row).arrays()).unwrap();
        }
        files
    }

    /// Rows through files give the bytes of the archive that memory gives, for arrays beyond one chunk of the
    /// compressor; so do rows that were written after a cut, and rows that were unpacked from the archive.
    #[test]
    fn both_routes_write_the_same_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let [direct, streamed] =
            ["direct.npz", "streamed.npz"].map(|name| folder.path().join(name));
        let bytes = |path: &Path| fs::read(path).unwrap();
        let whole = record(1500, 7); // x takes 252000 bytes
        whole.write_npz(&direct).unwrap();

        let rows = folder.path().join("rows");
        let mut files = pushed(&rows, &whole, 0..1500);
        files.write_npz(&streamed).unwrap();
        assert!(bytes(&direct) == bytes(&streamed));

        // 300 rows too many, the last of them half written.
        drop(files);
        let x = OpenOptions::new()
            .write(true)
            .open(rows.join("x.f64"))
            .unwrap();
        x.set_len(x.metadata().unwrap().len() - 5).unwrap();
        pushed(&rows, &whole, 1200..1500)
            .write_npz(&streamed)
            .unwrap();
        assert!(bytes(&direct) == bytes(&streamed));

        let again = folder.path().join("again");
        let mut files = RowFiles::unpack(&direct, &again, &whole.arrays(), 900).unwrap();
        assert_eq!(files.n_rows(), 900);
        let mut row = 0;
        files
            .replay(|values| {
                assert!(
                    values
                        .iter()
                        .zip(row_of(&whole, row).arrays())
                        .all(|(a, b)| a == b.2)
                );
                row += 1;
            })
            .unwrap();
        assert_eq!(row, 900);
        drop(files);
        pushed(&again, &whole, 900..1500)
            .write_npz(&streamed)
            .unwrap();
        assert!(bytes(&direct) == bytes(&streamed));
    }

    /// Fewer rows than a checkpoint promises are an error that names the file, the size and the rows.
    #[test]
    fn missing_rows_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let record = record(3, 2);
        drop(pushed(folder.path(), &record, 0..3));
        let error = RowFiles::open(folder.path(), &record.arrays(), 4)
            .unwrap_err()
            .to_string();
        for word in ["t.f64", "24 bytes", "4 rows", "32"] {
            assert!(error.contains(word), "{error}");
        }
    }
}
