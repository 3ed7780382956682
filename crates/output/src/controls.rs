//! The controls over time: `controls.csv`.

use std::fs::File;
use std::io::Write;
use std::path::Path;

use serde::Serialize;

use super::OutputError;
use super::reading::read_text;

/// The values of all controls on an interval of time: a row of `controls.csv`.
#[derive(Debug, Clone, PartialEq)]
pub struct ControlRow {
    /// Start of the interval, in seconds.
    pub t_start: f64,
    /// End of the interval, in seconds.
    pub t_end: f64,
    /// Value of every control, in its unit: forces and moments, and whole efforts of actuators.
    pub values: Vec<f64>,
}

/// The columns of the times.
const TIMES: [&str; 2] = ["t_start", "t_end"];

impl ControlRow {
    /// Checks that every number is finite and the interval does not end before it starts.
    fn validate(&self, headings: &[String]) -> Result<(), String> {
        let names = TIMES.into_iter().chain(headings.iter().map(String::as_str));
        let values = [self.t_start, self.t_end].into_iter();
        for (name, value) in names.zip(values.chain(self.values.iter().copied())) {
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

/// Writes rows under the [headings](control::NamedControl::heading) of their controls; every number in the shortest form that reads
/// back as the same `f64`, headings in quotes where a comma, a quote or the end of a line asks for them.
///
/// # Errors
/// Returns [`OutputError`] if the file cannot be written, or a row has no finite number or another number of values than headings.
pub fn write_controls(
    path: &Path,
    headings: &[String],
    rows: &[ControlRow],
) -> Result<(), OutputError> {
    let first = first_line(headings);
    for (line, row) in (first..).zip(rows) {
        let right = match row.values.len() == headings.len() {
            true => row.validate(headings),
            false => Err(format!(
                "{} values under {} headings",
                row.values.len(),
                headings.len()
            )),
        };
        right.map_err(|reason| OutputError::Malformed {
            path: path.to_path_buf(),
            line: Some(line),
            reason,
        })?;
    }
    let columns: Vec<&str> = (TIMES.into_iter())
        .chain(headings.iter().map(String::as_str))
        .collect();
    let rows: Vec<(f64, f64, &[f64])> = (rows.iter())
        .map(|row| (row.t_start, row.t_end, &row.values[..]))
        .collect();
    write_rows(path, &columns, &rows)
}

/// Returns the line of the first row after these headings, which may have ends of lines of their own.
pub fn first_line(headings: &[String]) -> u64 {
    2 + (headings.iter().flat_map(|heading| heading.bytes()))
        .filter(|byte| *byte == b'\n')
        .count() as u64
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

/// Upper limit of the bytes of a row beside its numbers, including columns that others may have added.
const LARGEST_ROW: u64 = 1 << 10;
/// Upper limit of the bytes of a number.
const LARGEST_NUMBER: u64 = 1 << 5;

/// Reads `n_rows` rows of a file of [`write_controls`] under these headings; columns may be in any order, with others between them.
///
/// # Errors
/// Returns [`OutputError`] for a missing column, another number of rows, and for text that is not a finite number; columns of forces and
/// moments on a node, which versions before schema 2 wrote, are refused with what to do.
pub fn read_controls(
    path: &Path,
    headings: &[String],
    n_rows: usize,
) -> Result<Vec<ControlRow>, OutputError> {
    let numbers = LARGEST_NUMBER * (headings.len() as u64 + 2);
    let words: u64 = headings.iter().map(|own| 2 * own.len() as u64 + 3).sum();
    let largest = (LARGEST_ROW + numbers).saturating_mul(n_rows as u64 + 4);
    let text = read_text(path, largest.saturating_add(words))?;
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let read_error = |error| csv_error(path, "cannot read", error);
    let malformed = |line, reason| OutputError::Malformed {
        path: path.to_path_buf(),
        line: Some(line),
        reason,
    };

    let header = reader.headers().map_err(read_error)?.clone();
    let place = |column: &str| header.iter().position(|name| name == column);
    let columns: Vec<&str> = (TIMES.into_iter())
        .chain(headings.iter().map(String::as_str))
        .collect();
    let mut places = Vec::with_capacity(columns.len());
    for column in &columns {
        places.push(place(column).ok_or_else(|| {
            let is_old = FORMER.iter().all(|former| place(former).is_some());
            malformed(
                1,
                match is_old {
                    true => "forces and moments by node (schema 1), which an earlier version of softarm wrote and this one does not read; \
                             solve the scene.toml beside it again"
                        .into(),
                    false => format!("no column {column}; expected {}", columns.join(",")),
                },
            )
        })?);
    }
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(read_error)?;
        let line = record.position().map_or(0, csv::Position::line);
        let mut values = Vec::with_capacity(columns.len());
        for (column, place) in columns.iter().zip(&places) {
            let field = record.get(*place).unwrap_or_default();
            let value = field.trim().parse::<f64>().map_err(|_| {
                let field: String = field.chars().take(LONGEST_FIELD).collect();
                malformed(line, format!("{column}: \"{field}\" is not a number"))
            })?;
            values.push(value);
        }
        let row = ControlRow {
            t_start: values[0],
            t_end: values[1],
            values: values.split_off(TIMES.len()),
        };
        row.validate(headings)
            .map_err(|reason| malformed(line, reason))?;
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

/// Columns by which a file of schema 1 is known.
const FORMER: [&str; 7] = ["fx", "fy", "fz", "mx", "my", "mz", "node"];
/// Cap on the characters of a field that are repeated.
const LONGEST_FIELD: usize = 60;

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
    use crate::reading::tests::{accidents, damaged};
    use proptest::prelude::*;

    fn headings() -> Vec<String> {
        [
            "tip force x (N)",
            "a, \"quoted\" #1 (N)",
            "two\nlines (Pa)",
            "magnet (T)",
            "muscle (1)",
            "winch (m)",
        ]
        .map(String::from)
        .to_vec()
    }

    fn row(start: f64) -> ControlRow {
        ControlRow {
            t_start: start,
            t_end: start + 0.1,
            values: vec![1.0 / 3.0, -5e-324, f64::MAX, -0.0, 6.02e23, 0.1 + 0.2],
        }
    }

    /// Thirds, subnormals, the largest number and negative zero are read back with the same bits, under names with commas, quotes and ends
    /// of lines.
    #[test]
    fn csv_round_trip_is_exact() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("controls.csv");
        for rows in [vec![], vec![row(0.0)], vec![row(0.0), row(0.1), row(0.2)]] {
            write_controls(&path, &headings(), &rows).unwrap();
            let text = std::fs::read_to_string(&path).unwrap();
            assert_eq!(
                text.lines().next(),
                Some("t_start,t_end,tip force x (N),\"a, \"\"quoted\"\" #1 (N)\",\"two")
            );
            let read = read_controls(&path, &headings(), rows.len()).unwrap();
            let bits = |rows: &[ControlRow]| -> Vec<Vec<u64>> {
                let of = |r: &ControlRow| {
                    let values = [r.t_start, r.t_end].into_iter();
                    let values = values.chain(r.values.iter().copied());
                    values.map(f64::to_bits).collect()
                };
                rows.iter().map(of).collect()
            };
            assert_eq!(bits(&read), bits(&rows));
        }
    }

    /// A faulty file is refused with the line and the fault, and one of schema 1 with what to do.
    #[test]
    fn errors_name_the_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("controls.csv");
        let columns = ["tip force x (N)", "left (N)"].map(String::from);
        let header = "t_start,t_end,tip force x (N),left (N)\n0,1,0,0\n";
        let cases = [
            (
                "t_start,t_end,tip force x (N)\n".to_string(),
                ":1: no column left (N); expected t_start,t_end,tip force x (N),left (N)",
            ),
            (
                "t_start,t_end,fx,fy,fz,mx,my,mz,node\n0,1,0,0,0,0,0,0,4\n".to_string(),
                ":1: forces and moments by node (schema 1)",
            ),
            (
                format!("{header}1,2,0,zero\n"),
                ":3: left (N): \"zero\" is not a number",
            ),
            (format!("{header}1,2,0\n"), ":3: 3 fields instead of 4"),
            (
                format!("{header}1,2,NaN,0\n"),
                ":3: tip force x (N): NaN is not",
            ),
            (format!("{header}2,1,0,0\n"), ":3: the interval ends"),
        ];
        for (text, message) in cases {
            std::fs::write(&path, text).unwrap();
            let error = read_controls(&path, &columns, 2).unwrap_err().to_string();
            assert!(error.contains(&format!("controls.csv{message}")), "{error}");
        }
        let mut bad = row(0.0);
        bad.values[4] = f64::NAN;
        let error = write_controls(&path, &headings(), &[row(0.0), bad]).unwrap_err();
        assert!(error.to_string().contains(":4: muscle (1): NaN"), "{error}");
        let error = write_controls(&path, &columns, &[row(0.0)]).unwrap_err();
        assert!(error.to_string().contains("6 values under 2"), "{error}");
    }

    /// Another number of rows, and a file longer than that many rows can be, are refused.
    #[test]
    fn the_number_of_rows_is_known() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("controls.csv");
        write_controls(&path, &headings(), &[row(0.0), row(0.1)]).unwrap();
        assert_eq!(read_controls(&path, &headings(), 2).unwrap().len(), 2);
        for n_rows in [1, 3] {
            let error = read_controls(&path, &headings(), n_rows).unwrap_err();
            let error = error.to_string();
            assert!(error.contains("2 rows, but scene.toml"), "{error}");
        }
        let mut text = std::fs::read_to_string(&path).unwrap();
        text.push_str(&",".repeat(10_000));
        std::fs::write(&path, text).unwrap();
        let error = read_controls(&path, &headings(), 2).unwrap_err();
        let error = error.to_string();
        assert!(error.contains("it should hold takes at most"), "{error}");
    }

    proptest! {
        /// Whatever happens to the bytes, reading ends with finite rows or with an error that names the file.
        #[test]
        fn damaged_rows_are_read_or_refused(accidents in accidents()) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("controls.csv");
            let columns = headings();
            write_controls(&path, &columns, &[row(0.0), row(0.1), row(0.2)]).unwrap();
            let bytes = damaged(&std::fs::read(&path).unwrap(), &accidents);
            std::fs::write(&path, bytes).unwrap();
            match read_controls(&path, &columns, 3) {
                Ok(rows) => prop_assert!(rows.iter().all(|row| row.validate(&columns).is_ok())),
                Err(error) => prop_assert!(error.to_string().contains("controls.csv")),
            }
        }

        /// Any text in any field: rows of finite numbers, or an error with the line.
        #[test]
        fn any_fields_are_read_or_refused(fields in prop::collection::vec(
            prop_oneof![any::<f64>().prop_map(|v| v.to_string()), "[ -~]{0,6}", Just("1e999".to_string()), Just("-5".to_string())], 4)) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("controls.csv");
            let columns = ["left (N)", "right (N)"].map(String::from);
            std::fs::write(&path, format!("t_start,t_end,left (N),right (N)\n{}\n", fields.join(","))).unwrap();
            match read_controls(&path, &columns, 1) {
                Ok(rows) => prop_assert!(rows[0].values.iter().all(|v| v.is_finite())),
                Err(error) => prop_assert!(error.to_string().contains("controls.csv")),
            }
        }
    }
}
