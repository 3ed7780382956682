//! Places of markers, measured and predicted: `residuals.csv` of a fit.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::OutputError;
use super::controls::{csv_error, write_rows};
use super::reading::read_text;

/// A place of a marker, measured and predicted: a row of `residuals.csv`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResidualRow {
    /// Shape or recording.
    pub case: String,
    /// Marker.
    pub marker: String,
    /// Time, s; zero in a shape at rest.
    pub t_s: f64,
    /// Measured place, m.
    pub x_m: f64,
    /// Its second coordinate, m.
    pub y_m: f64,
    /// Its third coordinate, m.
    pub z_m: f64,
    /// Predicted place, m.
    pub predicted_x_m: f64,
    /// Its second coordinate, m.
    pub predicted_y_m: f64,
    /// Its third coordinate, m.
    pub predicted_z_m: f64,
    /// Distance of both, m.
    pub off_m: f64,
    /// Tells whether the distance is larger than that from which places are outliers.
    pub outlier: bool,
}

impl ResidualRow {
    /// Returns the measured and the predicted place, m.
    pub fn places(&self) -> [[f64; 3]; 2] {
        [
            [self.x_m, self.y_m, self.z_m],
            [self.predicted_x_m, self.predicted_y_m, self.predicted_z_m],
        ]
    }
}

/// Columns of the table.
const COLUMNS: [&str; 11] = [
    "case",
    "marker",
    "t_s",
    "x_m",
    "y_m",
    "z_m",
    "predicted_x_m",
    "predicted_y_m",
    "predicted_z_m",
    "off_m",
    "outlier",
];

/// Writes the rows with a header; every number in the shortest form that reads back as the same `f64`.
///
/// # Errors
/// Returns [`OutputError`] where the file cannot be written.
pub fn write_residuals(path: &Path, rows: &[ResidualRow]) -> Result<(), OutputError> {
    write_rows(path, &COLUMNS, rows)
}

/// Cap on the bytes of a table that is read: that of the measurements from which it comes, and the predictions.
const LARGEST: u64 = 1 << 30;

/// Reads a table of [`write_residuals`].
///
/// # Errors
/// Returns [`OutputError`] for a row that is not as [`ResidualRow`] describes.
pub fn read_residuals(path: &Path) -> Result<Vec<ResidualRow>, OutputError> {
    let text = read_text(path, LARGEST)?;
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let rows: Result<_, csv::Error> = reader.deserialize().collect();
    rows.map_err(|error| csv_error(path, "cannot read", error))
}
