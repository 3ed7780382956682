//! The efforts of the actuators in an arm over time: `efforts.csv`.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::OutputError;
use super::controls::{csv_error, write_rows};
use super::reading::read_text;

/// The effort and the coordinate of one actuator at one time: a row of `efforts.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EffortRow {
    /// Time, in seconds.
    pub t: f64,
    /// Name of the actuator.
    pub name: String,
    /// Effort, in its unit.
    pub effort: f64,
    /// Coordinate `y` minus that of the stress-free shape, along which a positive effort does positive work: the length by which a tendon is
    /// shorter, the volume by which a chamber is larger.
    pub coordinate: f64,
    /// Command that the effort follows, in its unit: the effort plus its rate times the lag, at a jump the value after it. `None` where no
    /// actuator has a lag.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub command: Option<f64>,
    /// Displacement of a tendon's winch, m, negative where it has pulled in; of a tendon whose tension is the input, the displacement of an
    /// end without stretch, minus the coordinate. `None` without a tendon; the outer one if no tendon of the arm is on a winch.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub displacement: Option<Option<f64>>,
}

/// Writes the rows, all of which have the same columns, with a header; every number in the shortest form that reads back as the same `f64`.
pub fn write_efforts(path: &Path, rows: &[EffortRow]) -> Result<(), OutputError> {
    let mut columns = vec!["t", "name", "effort", "coordinate"];
    if let Some(row) = rows.first() {
        columns.extend(row.command.map(|_| "command"));
        columns.extend(row.displacement.map(|_| "displacement"));
    }
    write_rows(path, &columns, rows)
}

/// Upper limit of the bytes of a row without its name.
const LARGEST_ROW: u64 = 1 << 8;

/// Reads `n_rows` rows of a file of [`write_efforts`] with names of at most `longest_name` bytes.
///
/// # Errors
/// Returns [`OutputError`] for another number of rows, or a row that is not as [`EffortRow`] describes.
pub fn read_efforts(
    path: &Path,
    n_rows: usize,
    longest_name: usize,
) -> Result<Vec<EffortRow>, OutputError> {
    let largest = (LARGEST_ROW + 2 * longest_name as u64).saturating_mul(n_rows as u64 + 4);
    let text = read_text(path, largest)?;
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let rows: Result<Vec<EffortRow>, csv::Error> = reader.deserialize().collect();
    let rows = rows.map_err(|error| csv_error(path, "cannot read", error))?;
    if rows.len() != n_rows {
        return Err(OutputError::malformed(
            path,
            format!("{} rows, but scene.toml describes {n_rows}", rows.len()),
        ));
    }
    Ok(rows)
}
