//! Numpy archives of 64-bit floats, written and read one number at a time, so that an array need not fit in memory.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::Path;

use npyz::npz::{NpzArchive, NpzWriter, NpzWriterBuilder, file_name_from_array_name};
use npyz::{NpyFile, Order, WriteOptions, WriterBuilder};

use super::OutputError;

/// An archive that is being read.
pub(super) type Archive = NpzArchive<BufReader<File>>;
/// An archive that is being written.
pub(super) type ArchiveWriter = NpzWriter<BufWriter<File>>;

/// Opens an archive.
pub(super) fn open(path: &Path) -> Result<Archive, OutputError> {
    let file = File::open(path).map_err(OutputError::io(path, "cannot read"))?;
    NpzArchive::new(BufReader::new(file))
        .map_err(|error| OutputError::malformed(path, format!("not a numpy archive: {error}")))
}

/// Creates an archive and lets `fill` write its arrays.
pub(super) fn write(
    path: &Path,
    fill: impl FnOnce(&mut ArchiveWriter) -> io::Result<()>,
) -> Result<(), OutputError> {
    let attempt = || {
        let mut archive = NpzWriter::new(BufWriter::new(File::create(path)?));
        fill(&mut archive)?;
        archive.zip_writer().finish()?.flush()
    };
    attempt().map_err(OutputError::unwritten(path, "cannot write"))
}

/// Fastest deflate: mantissas do not compress, but zeros of planar motions and held controls do.
const DEFLATE_LEVEL: i32 = 1;
/// Bytes that the compressor gets at once. It is slow with eight, and what it makes of an array depends on how the array
/// is cut; here is the only place that cuts, so the same numbers give the same bytes.
const CHUNK: usize = 1 << 16;
/// More than the header of an array takes.
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
    let options = default_options(ArchiveWriter::array::<f64>)
        .last_modified_time(Default::default()) // 1980, instead of the clock
        .compression_level(Some(DEFLATE_LEVEL))
        .large_file(size > u64::from(u32::MAX) / 2);
    let zip = archive.zip_writer();
    zip.start_file(file_name_from_array_name(name), options)?;
    let mut array = WriteOptions::<f64>::new()
        .default_dtype()
        .shape(&shape)
        .writer(BufWriter::with_capacity(CHUNK, zip))
        .begin_nd()?;
    for value in values {
        array.push(&value?)?;
    }
    array.finish()
}

/// The default of the zip options that [`NpzWriter::array`] takes: npyz does not re-export their type,
/// so it is inferred from the signature.
fn default_options<O: Default>(
    _: impl for<'a> Fn(
        &'a mut ArchiveWriter,
        &str,
        O,
    ) -> io::Result<NpzWriterBuilder<'a, f64, BufWriter<File>>>,
) -> O {
    O::default()
}

/// Shape and values of an array; `None` in `expected` admits any size in that dimension.
pub(super) fn read_array(
    archive: &mut Archive,
    name: &str,
    expected: &[Option<usize>],
) -> Result<(Vec<usize>, Vec<f64>), String> {
    // Not as long as the header claims: it may claim anything.
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
    let array = archive
        .by_name(name)
        .map_err(|error| error.to_string())?
        .ok_or("missing")?;
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
    let header = array.header().clone();
    let mut bytes = array.into_inner();
    let numbers = NpyFile::with_header(header, &mut bytes)
        .data::<f64>()
        .map_err(|error| error.to_string())?;
    for value in numbers {
        value
            .and_then(&mut visit)
            .map_err(|error| error.to_string())?;
    }
    // The archive compares its checksum only where the array ends.
    match bytes.read(&mut [0]) {
        Ok(0) => Ok(shape),
        Ok(_) => Err("longer than its shape".into()),
        Err(error) => Err(error.to_string()),
    }
}
