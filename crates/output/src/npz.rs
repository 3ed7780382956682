//! NumPy archives of 64-bit numbers, written and read one number at a time, so that an array need not fit in memory.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::Path;

use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipArchive, ZipWriter};

use super::{OutputError, reading};

/// An archive that is being read.
pub(super) type Archive = ZipArchive<BufReader<File>>;
/// An archive that is being written.
pub(super) type ArchiveWriter = ZipWriter<Sink>;

/// A file that an archive is written to. Its first failure is returned, and whatever comes after is accepted and lost: an archive that is
/// given up tries to end itself, and would tell of another failure on the standard error.
#[derive(Debug)]
pub(super) struct Sink {
    file: BufWriter<File>,
    position: u64,
    has_failed: bool,
}

impl Sink {
    fn new(file: File) -> Self {
        Self {
            file: BufWriter::new(file),
            position: 0,
            has_failed: false,
        }
    }

    /// Returns the result of an operation on the file, with a note of its failure.
    fn noted<T>(&mut self, result: io::Result<T>) -> io::Result<T> {
        let is_failure = |error: &io::Error| error.kind() != io::ErrorKind::Interrupted;
        self.has_failed |= result.as_ref().err().is_some_and(is_failure);
        result
    }
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = match self.has_failed {
            true => bytes.len(),
            false => {
                let result = self.file.write(bytes);
                self.noted(result)?
            }
        };
        self.position += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.has_failed {
            return Ok(());
        }
        let result = self.file.flush();
        self.noted(result)
    }
}

impl Seek for Sink {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.position = match (self.has_failed, to) {
            (false, to) => {
                let result = self.file.seek(to);
                self.noted(result)?
            }
            (true, SeekFrom::Start(place)) => place,
            (true, SeekFrom::Current(way) | SeekFrom::End(way)) => {
                self.position.saturating_add_signed(way)
            }
        };
        Ok(self.position)
    }
}

/// Opens an archive of any size.
pub(super) fn open(path: &Path) -> Result<Archive, OutputError> {
    open_within(path, u64::MAX)
}

/// Opens an archive of at most `largest` bytes.
pub(super) fn open_within(path: &Path, largest: u64) -> Result<Archive, OutputError> {
    let file = reading::open(path, largest)?;
    let archive = ZipArchive::new(BufReader::new(file))
        .map_err(|error| OutputError::malformed(path, format!("not a numpy archive: {error}")))?;
    let entries = archive.len();
    if entries > MOST_ENTRIES {
        return Err(OutputError::malformed(
            path,
            format!("{entries} arrays; expected at most {MOST_ENTRIES}"),
        ));
    }
    Ok(archive)
}

/// Returns the largest size in bytes of an archive of arrays with these counts, whoever packed it: deflate lengthens data by at most a
/// thousandth, and the headers of the arrays and of the archive are short.
pub(super) fn largest_archive(arrays: &[usize]) -> u64 {
    let numbers = arrays
        .iter()
        .fold(0u64, |sum, &n| sum.saturating_add(n as u64));
    let data = numbers.saturating_mul(8);
    data.saturating_add(data / 100)
        .saturating_add(4 * HEADER_ALLOWANCE * (arrays.len() as u64 + 4))
}

/// Cap on the arrays of an archive.
const MOST_ENTRIES: usize = 64;

/// Creates an archive and lets `fill` write its arrays.
pub(super) fn write(
    path: &Path,
    fill: impl FnOnce(&mut ArchiveWriter) -> io::Result<()>,
) -> Result<(), OutputError> {
    let attempt = || {
        let mut archive = ZipWriter::new(Sink::new(File::create(path)?));
        fill(&mut archive)?;
        archive.finish()?.flush()
    };
    attempt().map_err(OutputError::unwritten(path, "cannot write"))
}

/// Fastest deflate: mantissas do not compress, but zeros of planar motions and constant controls do.
const DEFLATE_LEVEL: i64 = 1;
/// Bytes that the compressor gets at once. It is slow with eight, and its output depends on how an array is cut. Arrays are cut here only,
/// so that the same numbers give the same bytes.
const CHUNK: usize = 1 << 16;
/// Upper limit of the bytes of an array's header.
const HEADER_ALLOWANCE: u64 = 1 << 10;

/// Appends an array; `values` are in C order and fill `shape`.
pub(super) fn write_array(
    archive: &mut ArchiveWriter,
    name: &str,
    shape: &[usize],
    values: impl IntoIterator<Item = io::Result<f64>>,
) -> io::Result<()> {
    let count: usize = shape.iter().product();
    let size = 8 * count as u64 + HEADER_ALLOWANCE;
    archive.start_file(entry_name(name), entry_options(size))?;
    let mut entry = BufWriter::with_capacity(CHUNK, archive);
    entry.write_all(&header("<f8", shape))?;
    let mut n_written = 0;
    for value in values {
        entry.write_all(&value?.to_le_bytes())?;
        n_written += 1;
    }
    if n_written != count {
        let error = format!("{n_written} numbers for an array of {count}");
        return Err(io::Error::new(io::ErrorKind::InvalidInput, error));
    }
    entry.flush()
}

/// Name of the entry of an array.
fn entry_name(array: &str) -> String {
    format!("{array}.npy")
}

/// The header of an array of numpy's `.npy` format, version 1.0, whose end aligns the data to 64 bytes.
fn header(descr: &str, shape: &[usize]) -> Vec<u8> {
    let sizes: String = shape.iter().map(|size| format!("{size}, ")).collect();
    let mut text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({sizes}), }}");
    while !(PREFIX + text.len() + 1).is_multiple_of(64) {
        text.push(' ');
    }
    text.push('\n');
    let mut bytes = MAGIC.to_vec();
    bytes.extend([1, 0]);
    bytes.extend((text.len() as u16).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes
}

/// The first bytes of a `.npy` file.
const MAGIC: &[u8] = b"\x93NUMPY";
/// Bytes before the text of a header of version 1: the magic ones, the version, and the length of the text.
const PREFIX: usize = 10;

fn entry_options(size: u64) -> SimpleFileOptions {
    SimpleFileOptions::default()
        .compression_method(CompressionMethod::Deflated)
        .compression_level(Some(DEFLATE_LEVEL))
        .last_modified_time(DateTime::default()) // a fixed date, 1980
        .large_file(size > u64::from(u32::MAX) / 2)
}

/// Bytes of a character of text in numpy, UTF-32.
const CHARACTER: usize = 4;

/// Appends a list of words as text of as many characters as the longest, the shorter ones filled up with zeros (numpy's type `U`).
pub(super) fn write_words(
    archive: &mut ArchiveWriter,
    name: &str,
    words: &[String],
) -> io::Result<()> {
    let width = (words.iter().map(|word| word.chars().count())).fold(1, usize::max);
    let mut bytes = header(&format!("<U{width}"), &[words.len()]);
    for word in words {
        let filled = (word.chars().map(u32::from))
            .chain(std::iter::repeat(0))
            .take(width);
        bytes.extend(filled.flat_map(u32::to_le_bytes));
    }
    let options = entry_options(bytes.len() as u64);
    archive.start_file(entry_name(name), options)?;
    archive.write_all(&bytes)
}

/// Reads a list of `n` words of at most `longest` characters, as [`write_words`] and numpy write them.
pub(super) fn read_words(
    archive: &mut Archive,
    name: &str,
    n: usize,
    longest: usize,
) -> Result<Vec<String>, String> {
    let mut entry = entry_of(archive, name)?;
    let header = Header::read(&mut entry)?;
    let width = (header.descr.strip_prefix("<U")).and_then(|width| width.parse::<usize>().ok());
    let width = width.ok_or("not text")?;
    if header.shape != [n] {
        return Err(format!("not a list of {n} words"));
    }
    if width > longest.max(1) {
        return Err(format!(
            "words of {width} characters; expected at most {longest}"
        ));
    }
    let mut bytes = vec![0; CHARACTER * width * n];
    entry
        .read_exact(&mut bytes)
        .map_err(|error| error.to_string())?;
    match entry.read(&mut [0]) {
        Ok(0) => {}
        Ok(_) => return Err("longer than its shape".into()),
        Err(error) => return Err(error.to_string()),
    }
    (bytes.chunks_exact((CHARACTER * width).max(1)))
        .map(|word| {
            (word.chunks_exact(CHARACTER))
                .map(|four| u32::from_le_bytes([four[0], four[1], four[2], four[3]]))
                .take_while(|code| *code != 0)
                .map(|code| char::from_u32(code).ok_or_else(|| "no Unicode text".to_string()))
                .collect()
        })
        .collect()
}

/// Returns the entry of an array.
fn entry_of<'a>(
    archive: &'a mut Archive,
    name: &str,
) -> Result<zip::read::ZipFile<'a, BufReader<File>>, String> {
    (archive.by_name(&entry_name(name))).map_err(|error| match error {
        ZipError::FileNotFound => "missing".into(),
        other => other.to_string(),
    })
}

/// Reads shape and values of an array; `None` in `expected` admits any size in that dimension.
pub(super) fn read_array(
    archive: &mut Archive,
    name: &str,
    expected: &[Option<usize>],
) -> Result<(Vec<usize>, Vec<f64>), String> {
    // The memory does not grow by the length in the header, which may be false.
    let mut values = Vec::new();
    let shape = visit_array(archive, name, expected, |value| {
        values.push(value);
        Ok(())
    })?;
    Ok((shape, values))
}

/// Passes the values of an array to `visit`, in C order, and returns its shape.
pub(super) fn visit_array(
    archive: &mut Archive,
    name: &str,
    expected: &[Option<usize>],
    mut visit: impl FnMut(f64) -> io::Result<()>,
) -> Result<Vec<usize>, String> {
    let mut bytes = BufReader::with_capacity(CHUNK, entry_of(archive, name)?);
    let Header {
        descr,
        in_fortran_order,
        shape,
    } = Header::read(&mut bytes)?;
    let matches = shape.len() == expected.len()
        && shape
            .iter()
            .zip(expected)
            .all(|(size, expected)| expected.is_none_or(|expected| *size == expected));
    if !matches {
        let expected: Vec<String> = expected
            .iter()
            .map(|size| size.map_or("any".into(), |size| size.to_string()))
            .collect();
        return Err(format!("shape {shape:?}, not [{}]", expected.join(", ")));
    }
    if in_fortran_order && shape.len() > 1 {
        return Err("in Fortran order; save it in C order".into());
    }
    let number: fn([u8; 8]) -> f64 = match descr.as_str() {
        "<f8" => f64::from_le_bytes,
        ">f8" => f64::from_be_bytes,
        _ => return Err(format!("of type '{descr}', not of 64-bit numbers ('<f8')")),
    };
    let count = (shape.iter()).try_fold(1usize, |count, &size| count.checked_mul(size));
    for _ in 0..count.ok_or("larger than the memory of any computer")? {
        let mut eight = [0; 8];
        (bytes.read_exact(&mut eight))
            .and_then(|()| visit(number(eight)))
            .map_err(|error| match error.kind() {
                io::ErrorKind::UnexpectedEof => "shorter than its shape".to_string(),
                _ => error.to_string(),
            })?;
    }
    // The archive compares its checksum only at the end of the array.
    match bytes.read(&mut [0]) {
        Ok(0) => Ok(shape),
        Ok(_) => Err("longer than its shape".into()),
        Err(error) => Err(error.to_string()),
    }
}

/// The header of an array of plain numbers or text.
#[derive(Debug)]
struct Header {
    /// Numpy's name of the type of an entry.
    descr: String,
    in_fortran_order: bool,
    shape: Vec<usize>,
}

impl Header {
    /// Reads a header of any version of the format, which is a literal of Python: a dictionary with a string, a truth value, and a tuple of
    /// integers.
    fn read(entry: &mut impl Read) -> Result<Self, String> {
        let broken = |error: io::Error| match error.kind() {
            io::ErrorKind::UnexpectedEof => "breaks off within its header".to_string(),
            _ => error.to_string(),
        };
        let mut prefix = [0; PREFIX];
        entry.read_exact(&mut prefix).map_err(broken)?;
        if !prefix.starts_with(MAGIC) {
            return Err("not a numpy array".into());
        }
        // The length has two bytes in version 1, four in later ones.
        let mut length = [prefix[8], prefix[9], 0, 0];
        if prefix[6] > 1 {
            entry.read_exact(&mut length[2..]).map_err(broken)?;
        }
        let length = u32::from_le_bytes(length);
        if u64::from(length) > HEADER_ALLOWANCE {
            return Err(format!(
                "a header of {length} bytes; expected at most {HEADER_ALLOWANCE}"
            ));
        }
        let mut text = vec![0; length as usize];
        entry.read_exact(&mut text).map_err(broken)?;
        (std::str::from_utf8(&text).ok())
            .and_then(|text| Self::parse(text.trim()))
            .ok_or_else(|| "not an array of plain numbers".into())
    }

    fn parse(text: &str) -> Option<Self> {
        let (mut descr, mut in_fortran_order, mut shape) = (None, None, None);
        let mut rest = text.strip_prefix('{')?.strip_suffix('}')?.trim();
        while !rest.is_empty() {
            let (key, value) = quoted(rest)?;
            let value = value.trim_start().strip_prefix(':')?.trim_start();
            rest = match key {
                "descr" => {
                    let (word, rest) = quoted(value)?;
                    descr = Some(word.to_string());
                    rest
                }
                "fortran_order" => {
                    in_fortran_order = Some(value.starts_with("True"));
                    (value.strip_prefix("True")).or_else(|| value.strip_prefix("False"))?
                }
                "shape" => {
                    let (sizes, rest) = value.strip_prefix('(')?.split_once(')')?;
                    shape = Some(tuple(sizes)?);
                    rest
                }
                _ => return None,
            };
            rest = rest.trim_start();
            rest = match rest.strip_prefix(',') {
                Some(next) => next.trim_start(),
                None if rest.is_empty() => rest,
                None => return None,
            };
        }
        Some(Self {
            descr: descr?,
            in_fortran_order: in_fortran_order?,
            shape: shape?,
        })
    }
}

/// Reads what stands between the brackets of a tuple of sizes, whose last comma may have none after it.
fn tuple(text: &str) -> Option<Vec<usize>> {
    let text = text.trim();
    let sizes = text.strip_suffix(',').unwrap_or(text);
    if sizes.is_empty() {
        return text.is_empty().then(Vec::new);
    }
    sizes
        .split(',')
        .map(|size| size.trim().parse().ok())
        .collect()
}

/// Splits off a string in quotation marks of Python.
fn quoted(text: &str) -> Option<(&str, &str)> {
    let mark = text.chars().next().filter(|mark| "'\"".contains(*mark))?;
    text[1..].split_once(mark)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Headers as this program and numpy write them, of versions 1 and 2 of the format.
    #[test]
    fn headers_are_read() {
        for shape in [&[][..], &[7], &[3, 0, 2]] {
            let read = Header::read(&mut &header("<f8", shape)[..]).unwrap();
            assert_eq!((read.descr.as_str(), &read.shape[..]), ("<f8", shape));
            assert!(!read.in_fortran_order);
        }
        let text = b"{'shape': (12, 3), \"fortran_order\": True, 'descr': '>f8'}\n";
        let mut bytes = [MAGIC, &[2, 0]].concat();
        bytes.extend((text.len() as u32).to_le_bytes());
        bytes.extend(text);
        let read = Header::read(&mut &bytes[..]).unwrap();
        assert_eq!(
            (read.descr.as_str(), &read.shape[..]),
            (">f8", &[12, 3][..])
        );
        assert!(read.in_fortran_order);
    }

    /// Headers that lack a key or a comma, or have more than an array of numbers or words needs.
    #[test]
    fn other_headers_are_refused() {
        for text in [
            "",
            "{}",
            "{'descr': '<f8', 'fortran_order': False}",
            "{'descr': '<f8', 'shape': (3,)}",
            "{'fortran_order': False, 'shape': (3,)}",
            "{'descr': '<f8' 'fortran_order': False, 'shape': (3,)}",
            "{'descr': '<f8', 'fortran_order': 0, 'shape': (3,)}",
            "{'descr': '<f8', 'fortran_order': False, 'shape': (3,,4)}",
            "{'descr': '<f8', 'fortran_order': False, 'shape': (,)}",
            "{'descr': '<f8', 'fortran_order': False, 'shape': (-3,)}",
            "{'descr': '<f8', 'fortran_order': False, 'shape': (3,), 'more': 1}",
            "{'descr': [('x', '<f8')], 'fortran_order': False, 'shape': (3,)}",
        ] {
            assert!(Header::parse(text).is_none(), "{text}");
        }
    }
}
