use std::fs::File;
use std::io::Write;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::OutputError;
use super::reading::read_text;

/// The force and moment on a node on one interval of time: a row of `controls.csv`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ControlRow {
    /// Start of the interval, in seconds.
    pub t_start: f64,
    /// End of the interval, in seconds.
    pub t_end: f64,
    /// Force along x, spatial frame, in newtons.
    pub fx: f64,
    /// Force along y, spatial frame, in newtons.
    pub fy: f64,
    /// Force along z, spatial frame, in newtons.
    pub fz: f64,
    /// Moment about the first director, body frame, in newton meters.
    pub mx: f64,
    /// Moment about the second director, body frame, in newton meters.
    pub my: f64,
    /// Moment about the third director, body frame, in newton meters.
    pub mz: f64,
    /// Index of the node.
    pub node: usize,
}

const COLUMNS: [&str; 9] = [
    "t_start", "t_end", "fx", "fy", "fz", "mx", "my", "mz", "node",
];

impl ControlRow {
    fn values(&self) -> [f64; 8] {
        [
            self.t_start,
            self.t_end,
            self.fx,
            self.fy,
            self.fz,
            self.mx,
            self.my,
            self.mz,
        ]
    }

    /// Checks that every number is finite and the interval does not end before it starts.
    fn validate(&self) -> Result<(), String> {
        for (name, value) in COLUMNS.iter().zip(self.values()) {
            if !value.is_finite() {
                return Err(format!("{name}: {value} is not a finite number"));
            }
        }
        if self.t_end < self.t_start {
            return Err(format!(
                "the interval ends at t_end = {} s, before its start at t_start = {} s",
                self.t_end, self.t_start
            ));
        }
        Ok(())
    }
}

/// Writes the rows with a header; every number in the shortest form that reads back as the same `f64`.
pub fn write_controls(path: &Path, rows: &[ControlRow]) -> Result<(), OutputError> {
    for (index, row) in rows.iter().enumerate() {
        row.validate().map_err(|reason| OutputError::Malformed {
            path: path.to_path_buf(),
            line: Some(index as u64 + 2),
            reason,
        })?;
    }
    write_rows(path, &COLUMNS, rows)
}

/// Writes a header and rows; every number in the shortest form that reads back as the same `f64`.
pub(super) fn write_rows(
    path: &Path,
    columns: &[&str],
    rows: &[impl Serialize],
) -> Result<(), OutputError> {
    let file = File::create(path).map_err(OutputError::unwritten(path, "cannot write"))?;
    let mut writer = csv::WriterBuilder::new()
        .has_headers(false)
        .from_writer(file);
    let written = writer
        .write_record(columns)
        .and_then(|()| rows.iter().try_for_each(|row| writer.serialize(row)));
    let cannot_write = OutputError::unwritten(path, "cannot write");
    written.map_err(|error| cannot_write(std::io::Error::other(error)))?;
    writer
        .into_inner()
        .map_err(csv::IntoInnerError::into_error)
        .and_then(|mut file| file.flush())
        .map_err(OutputError::unwritten(path, "cannot write"))
}

/// Upper limit of the bytes of a row, including columns that others may have added.
const LARGEST_ROW: u64 = 1 << 10;

/// Reads `n_rows` rows of a file of [`write_controls`]; columns may be in any order, with others between them.
///
/// # Errors
/// Returns [`OutputError`] for another number of rows, or a row that is not as [`ControlRow`] describes.
pub fn read_controls(path: &Path, n_rows: usize) -> Result<Vec<ControlRow>, OutputError> {
    let largest = LARGEST_ROW.saturating_mul(n_rows as u64 + 4);
    let text = read_text(path, largest)?;
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let read_error = |error| csv_error(path, "cannot read", error);
    let malformed = |line, reason| OutputError::Malformed {
        path: path.to_path_buf(),
        line: Some(line),
        reason,
    };

    let header = reader.headers().map_err(read_error)?.clone();
    if let Some(column) = COLUMNS
        .iter()
        .find(|&&column| !header.iter().any(|name| name == column))
    {
        let expected = COLUMNS.join(",");
        return Err(malformed(
            1,
            format!("no column {column}; expected {expected}"),
        ));
    }
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(read_error)?;
        let line = record.position().map_or(0, csv::Position::line);
        let row: ControlRow = record.deserialize(Some(&header)).map_err(read_error)?;
        row.validate().map_err(|reason| malformed(line, reason))?;
        rows.push(row);
    }
    if rows.len() != n_rows {
        return Err(OutputError::malformed(
            path,
            format!("{} rows, but scene.toml describes {n_rows}", rows.len()),
        ));
    }
    Ok(rows)
}

pub(super) fn csv_error(path: &Path, action: &'static str, error: csv::Error) -> OutputError {
    let line = error.position().map(csv::Position::line);
    match error.into_kind() {
        csv::ErrorKind::Io(source) => OutputError::io(path, action)(source),
        csv::ErrorKind::Deserialize { err, .. } => OutputError::Malformed {
            path: path.to_path_buf(),
            line,
            reason: match err.field() {
                Some(field) => {
                    let column = field as usize + 1;
                    format!("column {column}: {}", err.kind())
                }
                None => err.kind().to_string(),
            },
        },
        csv::ErrorKind::UnequalLengths {
            expected_len, len, ..
        } => OutputError::Malformed {
            path: path.to_path_buf(),
            line,
            reason: format!("{len} fields instead of {expected_len}"),
        },
        csv::ErrorKind::Utf8 { .. } => OutputError::Malformed {
            path: path.to_path_buf(),
            line,
            reason: "not UTF-8 text".into(),
        },
        other => OutputError::Malformed {
            path: path.to_path_buf(),
            line,
            reason: format!("{other:?}"),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::reading::tests::{accidents, damaged};
    use proptest::prelude::*;

    fn row(start: f64) -> ControlRow {
        ControlRow {
            t_start: start,
            t_end: start + 0.1,
            fx: 1.0 / 3.0,
            fy: -5e-324,
            fz: f64::MAX,
            mx: -0.0,
            my: 6.02e23,
            mz: 0.1 + 0.2,
            node: 20,
        }
    }

    /// Thirds, subnormals, the largest number and negative zero are read back with the same bits.
    #[test]
    fn csv_round_trip_is_exact() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("controls.csv");
        for rows in [vec![], vec![row(0.0)], vec![row(0.0), row(0.1), row(0.2)]] {
            write_controls(&path, &rows).unwrap();
            let text = std::fs::read_to_string(&path).unwrap();
            assert_eq!(
                text.lines().next(),
                Some("t_start,t_end,fx,fy,fz,mx,my,mz,node")
            );
            let read = read_controls(&path, rows.len()).unwrap();
            let bits = |rows: &[ControlRow]| -> Vec<_> {
                rows.iter().map(|r| r.values().map(f64::to_bits)).collect()
            };
            assert_eq!(bits(&read), bits(&rows));
        }
    }

    /// A faulty file is refused with the line and the fault.
    #[test]
    fn errors_name_the_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("controls.csv");
        let header = "t_start,t_end,fx,fy,fz,mx,my,mz,node\n0,1,0,0,0,0,0,0,4\n";
        let cases = [
            (
                "t_start,t_end,fx,fy,fz,mx,my,node\n".to_string(),
                ":1: no column mz",
            ),
            (format!("{header}1,2,0,zero,0,0,0,0,4\n"), ":3: column 4: "),
            (format!("{header}1,2,0,0\n"), ":3: 4 fields instead of 9"),
            (
                format!("{header}1,2,0,0,0,NaN,0,0,4\n"),
                ":3: mx: NaN is not",
            ),
            (
                format!("{header}2,1,0,0,0,0,0,0,4\n"),
                ":3: the interval ends",
            ),
        ];
        for (text, message) in cases {
            std::fs::write(&path, text).unwrap();
            let error = read_controls(&path, 2).unwrap_err().to_string();
            assert!(error.contains(&format!("controls.csv{message}")), "{error}");
        }
        let mut bad = row(0.0);
        bad.my = f64::NAN;
        let error = write_controls(&path, &[row(0.0), bad]).unwrap_err();
        assert!(error.to_string().contains(":3: my: NaN"), "{error}");
    }

    /// Another number of rows, and a file longer than that many rows can be, are refused.
    #[test]
    fn the_number_of_rows_is_known() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("controls.csv");
        write_controls(&path, &[row(0.0), row(0.1)]).unwrap();
        assert_eq!(read_controls(&path, 2).unwrap().len(), 2);
        for n_rows in [1, 3] {
            let error = read_controls(&path, n_rows).unwrap_err().to_string();
            assert!(error.contains("2 rows, but scene.toml"), "{error}");
        }
        let mut text = std::fs::read_to_string(&path).unwrap();
        text.push_str(&",".repeat(10_000));
        std::fs::write(&path, text).unwrap();
        let error = read_controls(&path, 2).unwrap_err().to_string();
        assert!(error.contains("it should hold takes at most"), "{error}");
    }

    proptest! {
        /// Whatever happens to the bytes, reading ends with finite rows or with an error that names the file.
        #[test]
        fn damaged_rows_are_read_or_refused(accidents in accidents()) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("controls.csv");
            write_controls(&path, &[row(0.0), row(0.1), row(0.2)]).unwrap();
            let bytes = damaged(&std::fs::read(&path).unwrap(), &accidents);
            std::fs::write(&path, bytes).unwrap();
            match read_controls(&path, 3) {
                Ok(rows) => prop_assert!(rows.iter().all(|row| row.validate().is_ok())),
                Err(error) => prop_assert!(error.to_string().contains("controls.csv")),
            }
        }

        /// Any text in any field: rows of finite numbers, or an error with the line.
        #[test]
        fn any_fields_are_read_or_refused(fields in prop::collection::vec(
            prop_oneof![any::<f64>().prop_map(|v| v.to_string()), "[ -~]{0,6}", Just("1e999".to_string()), Just("-5".to_string())], 9)) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("controls.csv");
            std::fs::write(&path, format!("{}\n{}\n", COLUMNS.join(","), fields.join(","))).unwrap();
            match read_controls(&path, 1) {
                Ok(rows) => prop_assert!(rows[0].values().iter().all(|v| v.is_finite())),
                Err(error) => prop_assert!(error.to_string().contains("controls.csv")),
            }
        }
    }
}
