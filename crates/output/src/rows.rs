use std::fs::{self, File, OpenOptions};
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crc32fast::Hasher;
use serde::{Deserialize, Serialize};

use super::OutputError;
use super::npz::{self, visit_array, write_array};

/// Name, shape (the number of rows first) and values of an array of an archive.
pub type ArrayView<'a> = (&'static str, Vec<usize>, &'a [f64]);

/// Upper limit of the bytes of an archive besides its numbers.
const ARCHIVE_FRAME: u64 = 1 << 16;

/// Returns the bytes of a row of all arrays.
pub fn row_bytes(layout: &[ArrayView]) -> u64 {
    let numbers: usize = layout
        .iter()
        .map(|(_, shape, _)| shape[1..].iter().product::<usize>())
        .sum();
    8 * numbers as u64
}

/// The first rows of several arrays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RowPrefix {
    /// Number of rows.
    pub rows: usize,
    /// CRC-32 of their numbers (64 bits, little-endian), row by row, in the order of the arrays.
    pub checksum: u32,
}

/// Rows of several arrays on their way to an archive: a file of plain numbers (64 bits, little-endian) for each array.
///
/// Memory does not grow with the rows. Files with more rows than are known to be good, as after the death of the process, are truncated
/// when they are opened again.
#[derive(Debug)]
pub struct RowFiles {
    arrays: Vec<RowFile>,
    n_rows: usize,
    checksum: Hasher,
    /// A row of one array, as bytes.
    bytes: Vec<u8>,
}

#[derive(Debug)]
struct RowFile {
    name: &'static str,
    /// Shape of one row; empty for one number per row.
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
    /// Creates the files in `folder`, without rows, for arrays like those of `layout`, whose values are not used.
    pub fn create(folder: &Path, layout: &[ArrayView]) -> Result<Self, OutputError> {
        fs::create_dir_all(folder).map_err(OutputError::unwritten(folder, "cannot create"))?;
        let mut files = Self::open(folder, layout)?;
        files.cut(0)?;
        Ok(files)
    }

    /// Opens the files, and creates missing ones.
    fn open(folder: &Path, layout: &[ArrayView]) -> Result<Self, OutputError> {
        let mut arrays = Vec::new();
        for (name, shape, _) in layout {
            let path = folder.join(format!("{name}.f64"));
            let file = OpenOptions::new()
                .write(true)
                .create(true)
                .truncate(false)
                .open(&path)
                .map_err(OutputError::unwritten(&path, "cannot open"))?;
            arrays.push(RowFile {
                name,
                row_shape: shape[1..].to_vec(),
                path,
                writer: BufWriter::new(file),
            });
        }
        Ok(Self {
            arrays,
            n_rows: 0,
            checksum: Hasher::new(),
            bytes: Vec::new(),
        })
    }

    /// Keeps the first `n_rows` rows, to be continued.
    fn cut(&mut self, n_rows: usize) -> Result<(), OutputError> {
        self.n_rows = n_rows;
        for array in &mut self.arrays {
            let length = n_rows as u64 * array.row_bytes();
            let file = array.writer.get_mut();
            file.set_len(length)
                .and_then(|()| file.seek(SeekFrom::Start(length)))
                .map_err(array.unwritten("cannot cut"))?;
        }
        Ok(())
    }

    /// Opens the files of a stopped run, whose first array is the time. Rows beyond those `written` are cut off; these must have their
    /// checksum, finite numbers, and increasing times. The first `n_rows` of them are passed to `visit` and kept.
    ///
    /// # Errors
    /// Returns [`OutputError::Malformed`] for rows that have changed.
    pub fn resume(
        folder: &Path,
        layout: &[ArrayView],
        written: RowPrefix,
        n_rows: usize,
        mut visit: impl FnMut(&[Vec<f64>]),
    ) -> Result<Self, OutputError> {
        let mut files = Self::open(folder, layout)?;
        for array in &files.arrays {
            let length = written.rows as u64 * array.row_bytes();
            let metadata = fs::metadata(&array.path).map_err(array.unread())?;
            if metadata.len() < length {
                return Err(OutputError::malformed(
                    &array.path,
                    format!(
                        "{} bytes, but {} rows take {length}; start over without --resume",
                        metadata.len(),
                        written.rows
                    ),
                ));
            }
        }
        let malformed = |reason: String| {
            OutputError::malformed(folder, format!("{reason}; start over without --resume"))
        };
        let mut readers = files.readers()?;
        let mut row: Vec<Vec<f64>> = (files.arrays.iter())
            .map(|array| vec![0.0; array.row_bytes() as usize / 8])
            .collect();
        let mut checksum = Hasher::new();
        let mut kept = checksum.clone();
        let mut earlier = f64::NEG_INFINITY;
        for i in 0..written.rows {
            for ((array, reader), values) in files.arrays.iter().zip(&mut readers).zip(&mut row) {
                files.bytes.resize(8 * values.len(), 0);
                reader
                    .read_exact(&mut files.bytes)
                    .map_err(array.unread())?;
                checksum.update(&files.bytes);
                for (value, bytes) in values.iter_mut().zip(files.bytes.chunks_exact(8)) {
                    *value = f64::from_le_bytes(bytes.try_into().unwrap_or_default());
                    if !value.is_finite() {
                        return Err(malformed(format!("{value} in row {i} of {}", array.name)));
                    }
                }
            }
            let time = row[0][0];
            if !(time > earlier) {
                return Err(malformed(format!(
                    "time does not grow from {earlier} to {time} s at row {i}"
                )));
            }
            earlier = time;
            if i < n_rows {
                visit(&row);
                kept = checksum.clone();
            }
        }
        if checksum.finalize() != written.checksum {
            return Err(malformed(
                "the rows are not those that the checkpoint belongs to".into(),
            ));
        }
        files.cut(n_rows.min(written.rows))?;
        files.checksum = kept;
        Ok(files)
    }

    /// Fills files in `folder` from an archive of at most `most_rows` rows that [`write_npz`](Self::write_npz) wrote, for
    /// [`resume`](Self::resume).
    ///
    /// # Errors
    /// Returns [`OutputError::Malformed`] for any other archive.
    pub fn unpack(
        archive: &Path,
        folder: &Path,
        layout: &[ArrayView],
        most_rows: usize,
    ) -> Result<(), OutputError> {
        let malformed = |reason: String| OutputError::malformed(archive, reason);
        let metadata = fs::metadata(archive).map_err(OutputError::io(archive, "cannot read"))?;
        if !metadata.is_file() {
            return Err(malformed("not a file".into()));
        }
        // Incompressible data grow a little.
        let most_bytes = most_rows as u64 * row_bytes(layout) / 32 * 33 + ARCHIVE_FRAME;
        if metadata.len() > most_bytes {
            return Err(malformed(format!(
                "{} bytes, and {most_rows} rows take at most {most_bytes}",
                metadata.len()
            )));
        }
        let mut files = Self::create(folder, layout)?;
        let mut source = npz::open(archive)?;
        for array in &mut files.arrays {
            let mut expected = vec![None];
            expected.extend(array.row_shape.iter().map(|&size| Some(size)));
            let most_bytes = most_rows as u64 * array.row_bytes();
            let mut n_bytes = 0;
            visit_array(&mut source, array.name, &expected, |value| {
                n_bytes += 8;
                if n_bytes > most_bytes {
                    return Err(io::Error::other(format!("more than {most_rows} rows")));
                }
                array.writer.write_all(&value.to_le_bytes())
            })
            .map_err(|reason| malformed(format!("array {}: {reason}", array.name)))?;
        }
        files.flush()
    }

    /// Returns the number of rows so far.
    pub fn n_rows(&self) -> usize {
        self.n_rows
    }

    /// Appends a row: the values of every array, in the order of the layout.
    pub fn push(&mut self, row: &[ArrayView]) -> Result<(), OutputError> {
        for (array, (_, _, values)) in self.arrays.iter_mut().zip(row) {
            self.bytes.clear();
            for value in *values {
                self.bytes.extend_from_slice(&value.to_le_bytes());
            }
            self.checksum.update(&self.bytes);
            (array.writer.write_all(&self.bytes)).map_err(array.unwritten("cannot write"))?;
        }
        self.n_rows += 1;
        Ok(())
    }

    /// Returns the number of rows so far, and their checksum.
    #[must_use]
    pub fn prefix(&self) -> RowPrefix {
        RowPrefix {
            rows: self.n_rows,
            checksum: self.checksum.clone().finalize(),
        }
    }

    /// Passes all rows to the operating system, so that they survive the process.
    pub fn flush(&mut self) -> Result<(), OutputError> {
        for array in &mut self.arrays {
            array
                .writer
                .flush()
                .map_err(array.unwritten("cannot write"))?;
        }
        Ok(())
    }

    /// Returns one reader for each array, of all rows so far.
    fn readers(&mut self) -> Result<Vec<BufReader<File>>, OutputError> {
        self.flush()?;
        self.arrays.iter().map(RowFile::reader).collect()
    }

    /// Writes the rows as a numpy archive, with the same bytes as if they had all been in memory.
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
    use proptest::prelude::*;

    use crate::MotionRecord;
    use crate::motion::tests::record;

    /// Returns row `row` of a record, as a record.
    fn row_of(record: &MotionRecord, row: usize) -> MotionRecord {
        let mut one = MotionRecord::empty(record.n_nodes);
        for (target, (_, shape, values)) in one.arrays_mut().into_iter().zip(record.arrays()) {
            let width: usize = shape[1..].iter().product();
            target.extend(&values[row * width..(row + 1) * width]);
        }
        one
    }

    /// Pushes rows to files that have the rows before.
    fn pushed(folder: &Path, record: &MotionRecord, rows: std::ops::Range<usize>) -> RowFiles {
        let mut files = if rows.start == 0 {
            RowFiles::create(folder, &record.arrays()).unwrap()
        } else {
            let written = prefix(record, rows.start);
            RowFiles::resume(folder, &record.arrays(), written, rows.start, |_| ()).unwrap()
        };
        for row in rows {
            files.push(&row_of(record, row).arrays()).unwrap();
        }
        files
    }

    /// The first rows of a record, by another route than that of the files: their bytes at once.
    fn prefix(record: &MotionRecord, rows: usize) -> RowPrefix {
        let mut bytes = Vec::new();
        for row in 0..rows {
            for (_, _, values) in row_of(record, row).arrays() {
                bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
            }
        }
        RowPrefix {
            rows,
            checksum: crc32fast::hash(&bytes),
        }
    }

    /// The rows that a run finds when it resumes these files after the given number of rows, all of which it keeps.
    fn resumed(
        folder: &Path,
        record: &MotionRecord,
        written: RowPrefix,
    ) -> Result<Vec<Vec<Vec<f64>>>, OutputError> {
        let mut found = Vec::new();
        let visit = |row: &[Vec<f64>]| found.push(row.to_vec());
        RowFiles::resume(folder, &record.arrays(), written, written.rows, visit)?;
        Ok(found)
    }

    fn rows_of(record: &MotionRecord) -> Vec<Vec<Vec<f64>>> {
        let row = |row| {
            row_of(record, row)
                .arrays()
                .map(|array| array.2.to_vec())
                .to_vec()
        };
        (0..record.n_rows()).map(row).collect()
    }

    /// Rows through files give the bytes of the archive from memory, for arrays beyond one chunk of the compressor; so do rows that were
    /// written after a cut, and rows that were unpacked from the archive.
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
        assert_eq!(files.prefix(), prefix(&whole, 1500));
        files.write_npz(&streamed).unwrap();
        assert!(bytes(&direct) == bytes(&streamed));

        // 300 additional rows, the last of them half written.
        drop(files);
        let x = OpenOptions::new()
            .write(true)
            .open(rows.join("x.f64"))
            .unwrap();
        x.set_len(x.metadata().unwrap().len() - 5).unwrap();
        let mut files = pushed(&rows, &whole, 1200..1500);
        assert_eq!(files.prefix(), prefix(&whole, 1500));
        files.write_npz(&streamed).unwrap();
        assert!(bytes(&direct) == bytes(&streamed));

        let again = folder.path().join("again");
        RowFiles::unpack(&direct, &again, &whole.arrays(), 1500).unwrap();
        assert!(resumed(&again, &whole, prefix(&whole, 900)).unwrap() == rows_of(&whole)[..900]);
        pushed(&again, &whole, 900..1500)
            .write_npz(&streamed)
            .unwrap();
        assert!(bytes(&direct) == bytes(&streamed));
    }

    /// Fewer rows than were written can be kept: the rest are checked too, and removed.
    #[test]
    fn fewer_rows_can_be_kept() {
        let folder = tempfile::tempdir().unwrap();
        let whole = record(5, 3);
        drop(pushed(folder.path(), &whole, 0..5));
        let mut n_visited = 0;
        let files = RowFiles::resume(folder.path(), &whole.arrays(), prefix(&whole, 5), 4, |_| {
            n_visited += 1;
        });
        assert_eq!((n_visited, files.unwrap().prefix()), (4, prefix(&whole, 4)));
        assert_eq!(
            fs::metadata(folder.path().join("t.f64")).unwrap().len(),
            4 * 8
        );
    }

    /// Fewer rows than a checkpoint names are an error that names the file, the size and the rows.
    #[test]
    fn missing_rows_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let record = record(3, 2);
        drop(pushed(folder.path(), &record, 0..3));
        let written = RowPrefix {
            rows: 4,
            checksum: 0,
        };
        let error = resumed(folder.path(), &record, written)
            .unwrap_err()
            .to_string();
        for word in ["t.f64", "24 bytes", "4 rows", "32"] {
            assert!(error.contains(word), "{error}");
        }
    }

    /// Rows with the right checksum but with a number that is not finite, or with a time that does not increase, are refused, with the row.
    #[test]
    fn impossible_rows_are_refused() {
        for (array, row, value, words) in [
            (1, 2, f64::NAN, "NaN in row 2 of x"),
            (5, 0, f64::INFINITY, "inf in row 0 of energy"),
            (0, 3, 0.1, "from 0.2 to 0.1 s at row 3"),
            (0, 3, 0.2, "from 0.2 to 0.2 s at row 3"),
        ] {
            let folder = tempfile::tempdir().unwrap();
            let mut record = record(5, 3);
            record.t = vec![0.0, 0.1, 0.2, 0.3, 0.4];
            let values = &mut record.arrays_mut()[array];
            let width = values.len() / 5;
            values[row * width] = value;
            drop(pushed(folder.path(), &record, 0..5));
            let error = resumed(folder.path(), &record, prefix(&record, 5)).unwrap_err();
            let error = error.to_string();
            assert!(
                error.contains(words) && error.contains("--resume"),
                "{error}"
            );
        }
    }

    /// An archive with more rows than a run can have written, a longer file, and a path that is not a file, are not unpacked.
    #[test]
    fn archives_are_limited() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("trajectory.npz");
        let mut record = record(500, 3);
        let error = |record: &MotionRecord, most_rows| {
            let rows = folder.path().join("rows");
            RowFiles::unpack(&path, &rows, &record.arrays(), most_rows)
                .unwrap_err()
                .to_string()
        };
        // Zeros take a thousandth of their size in the archive.
        (record.arrays_mut().into_iter()).for_each(|values| values.fill(0.0));
        record.write_npz(&path).unwrap();
        let message = error(&record, 499);
        assert!(message.contains("array t: more than 499 rows"), "{message}");
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        let message = error(&record, 500);
        assert!(message.contains("1099511627776 bytes"), "{message}");
        fs::remove_file(&path).unwrap();
        fs::create_dir(&path).unwrap();
        assert!(error(&record, 500).contains("not a file"));
    }

    proptest! {
        /// Whatever happens to the bytes of the files, the rows are those that were written, or refused.
        #[test]
        fn damaged_rows_are_refused(
            edits in proptest::collection::vec((0..7_usize, any::<prop::sample::Index>(), any::<u8>(), 0..4_u8), 1..4),
        ) {
            let folder = tempfile::tempdir().unwrap();
            let record = record(4, 3);
            drop(pushed(folder.path(), &record, 0..4));
            for (array, place, byte, kind) in edits {
                let path = folder.path().join(format!("{}.f64", record.arrays()[array].0));
                let mut bytes = fs::read(&path).unwrap();
                let at = place.index(bytes.len() + 1);
                match kind {
                    0 => bytes.insert(at, byte),
                    1 => bytes.truncate(at),
                    _ => {
                        if let Some(old) = bytes.get_mut(at) {
                            *old ^= byte;
                        }
                    }
                }
                fs::write(path, bytes).unwrap();
            }
            if let Ok(found) = resumed(folder.path(), &record, prefix(&record, 4)) {
                prop_assert!(found == rows_of(&record));
            }
        }
    }
}
