//! NumPy archives of 64-bit numbers, written and read one number at a time, so that an array need not fit in memory.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::Path;

use npyz::npz::file_name_from_array_name;
use npyz::{NpyFile, Order, WriteOptions, WriterBuilder};
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
    let shape: Vec<u64> = shape.iter().map(|&size| size as u64).collect();
    let size = 8 * shape.iter().product::<u64>() + HEADER_ALLOWANCE;
    archive.start_file(file_name_from_array_name(name), entry_options(size))?;
    let mut array = WriteOptions::<f64>::new()
        .default_dtype()
        .shape(&shape)
        .writer(BufWriter::with_capacity(CHUNK, archive))
        .begin_nd()?;
    for value in values {
        array.push(&value?)?;
    }
    array.finish()
}

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
    let mut header = format!(
        "{{'descr': '<U{width}', 'fortran_order': False, 'shape': ({},), }}",
        words.len()
    );
    // Ten bytes precede the header, which ends a line and aligns the data.
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    for word in words {
        let filled = (word.chars().map(u32::from))
            .chain(std::iter::repeat(0))
            .take(width);
        bytes.extend(filled.flat_map(u32::to_le_bytes));
    }
    let options = entry_options(bytes.len() as u64);
    archive.start_file(file_name_from_array_name(name), options)?;
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
    let header = header_of(&mut entry)?;
    let header: String = (header.iter().skip(10))
        .map(|byte| char::from(*byte))
        .filter(|character| !character.is_whitespace())
        .collect();
    let after = |key: &str| header.split_once(key).map(|(_, rest)| rest);
    let width =
        after("'descr':'<U").and_then(|rest| rest.split('\'').next()?.parse::<usize>().ok());
    let width = width.ok_or("not text")?;
    let length = after("'shape':(").and_then(|rest| rest.split(',').next()?.parse::<usize>().ok());
    if length != Some(n) {
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
    (archive.by_name(&file_name_from_array_name(name))).map_err(|error| match error {
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
    let mut entry = entry_of(archive, name)?;
    let header = header_of(&mut entry)?;
    let mut bytes = header.as_slice().chain(entry);
    let array = NpyFile::new(&mut bytes).map_err(|error| error.to_string())?;
    let shape: Vec<usize> = array.shape().iter().map(|&size| size as usize).collect();
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
    if array.order() != Order::C && shape.len() > 1 {
        return Err("in Fortran order; save it in C order".into());
    }
    let numbers = array.data::<f64>().map_err(|error| error.to_string())?;
    for value in numbers {
        value
            .and_then(&mut visit)
            .map_err(|error| error.to_string())?;
    }
    // The archive compares its checksum only at the end of the array.
    match bytes.read(&mut [0]) {
        Ok(0) => Ok(shape),
        Ok(_) => Err("longer than its shape".into()),
        Err(error) => Err(error.to_string()),
    }
}

/// Reads the header of an array and checks, before it is parsed, that it is short and not nested, as for plain numbers.
fn header_of(entry: &mut impl Read) -> Result<Vec<u8>, String> {
    let broken = |error: io::Error| match error.kind() {
        io::ErrorKind::UnexpectedEof => "breaks off within its header".to_string(),
        _ => error.to_string(),
    };
    let mut header = vec![0; 10];
    entry.read_exact(&mut header).map_err(broken)?;
    if !header.starts_with(b"\x93NUMPY") {
        return Err("not a numpy array".into());
    }
    // The length has two bytes in version 1, four in later ones.
    let mut length = u64::from(header[8]) | u64::from(header[9]) << 8;
    if header[6] > 1 {
        let mut more = [0; 2];
        entry.read_exact(&mut more).map_err(broken)?;
        length |= u64::from(more[0]) << 16 | u64::from(more[1]) << 24;
        header.extend(more);
    }
    if length > HEADER_ALLOWANCE {
        return Err(format!(
            "a header of {length} bytes; expected at most {HEADER_ALLOWANCE}"
        ));
    }
    let before = header.len();
    header.resize(before + length as usize, 0);
    entry.read_exact(&mut header[before..]).map_err(broken)?;
    // One dictionary and one tuple are expected; the parser's time doubles with every further level of nesting.
    let opened = (header[before..].iter())
        .filter(|byte| b"([{".contains(byte))
        .count();
    if opened > 2 {
        return Err("not an array of plain numbers".into());
    }
    Ok(header)
}
