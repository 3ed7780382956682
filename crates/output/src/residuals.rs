//! Poses of markers, measured and predicted: `residuals.csv` of a fit.

use std::path::Path;

use serde::Deserialize;

use super::OutputError;
use super::controls::{csv_error, write_rows};
use super::reading::read_text;

/// A marker, measured and predicted: a row of `residuals.csv`. What was not measured has empty cells, and no orientation of a table no columns.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub struct ResidualRow {
    /// Shape or recording.
    pub case: String,
    /// Marker.
    pub marker: String,
    /// Time, s; zero in a shape at rest.
    pub t_s: f64,
    /// Measured place, m.
    pub x_m: Option<f64>,
    /// Its second coordinate, m.
    pub y_m: Option<f64>,
    /// Its third coordinate, m.
    pub z_m: Option<f64>,
    /// Predicted place, m.
    pub predicted_x_m: f64,
    /// Its second coordinate, m.
    pub predicted_y_m: f64,
    /// Its third coordinate, m.
    pub predicted_z_m: f64,
    /// Distance of the measured and the predicted place, m.
    pub off_m: Option<f64>,
    /// Tells whether distance or angle is larger than that from which places and orientations are outliers.
    pub outlier: bool,
    /// Rotation vector from the measured to the predicted orientation, in the frame of the measured section, rad.
    pub turn_x_rad: Option<f64>,
    /// Its second component, rad.
    pub turn_y_rad: Option<f64>,
    /// Its third component, rad.
    pub turn_z_rad: Option<f64>,
}

impl ResidualRow {
    /// Returns the measured place, m.
    pub fn measured(&self) -> Option<[f64; 3]> {
        Some([self.x_m?, self.y_m?, self.z_m?])
    }

    /// Returns the predicted place, m.
    pub fn predicted(&self) -> [f64; 3] {
        [self.predicted_x_m, self.predicted_y_m, self.predicted_z_m]
    }

    /// Returns the angle between the measured and the predicted orientation, rad.
    pub fn turned(&self) -> Option<f64> {
        let turn = [self.turn_x_rad?, self.turn_y_rad?, self.turn_z_rad?];
        Some(nalgebra::Vector3::from(turn).norm())
    }

    fn cells(&self) -> [String; 14] {
        let known =
            |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:?}"));
        [
            self.case.clone(),
            self.marker.clone(),
            known(Some(self.t_s)),
            known(self.x_m),
            known(self.y_m),
            known(self.z_m),
            known(Some(self.predicted_x_m)),
            known(Some(self.predicted_y_m)),
            known(Some(self.predicted_z_m)),
            known(self.off_m),
            self.outlier.to_string(),
            known(self.turn_x_rad),
            known(self.turn_y_rad),
            known(self.turn_z_rad),
        ]
    }
}

/// Columns of the table, those of orientations last.
const COLUMNS: [&str; 14] = [
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
    "turn_x_rad",
    "turn_y_rad",
    "turn_z_rad",
];
/// Number of the columns of orientations.
const OF_ORIENTATIONS: usize = 3;

/// Writes the rows with a header; every number in the shortest form that reads back as the same `f64`.
///
/// # Errors
/// Returns [`OutputError`] where the file cannot be written.
pub fn write_residuals(path: &Path, rows: &[ResidualRow]) -> Result<(), OutputError> {
    let turns = rows.iter().any(|row| row.turned().is_some());
    let n = COLUMNS.len() - if turns { 0 } else { OF_ORIENTATIONS };
    let cells: Vec<Vec<String>> = (rows.iter()).map(|row| row.cells()[..n].to_vec()).collect();
    write_rows(path, &COLUMNS[..n], &cells)
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
