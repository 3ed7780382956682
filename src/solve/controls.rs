//! The controls of a solution as `controls.csv` has them.

use std::path::Path;

use crate::control::{Hold, NamedControl, OptimalControlProblem};
#[cfg(feature = "cli")]
use crate::output::read_controls;
use crate::output::{ControlRow, OutputError, write_controls};

/// Returns the heads of the columns of a problem's controls.
fn headings(named: &[NamedControl]) -> Vec<String> {
    named.iter().map(NamedControl::heading).collect()
}

/// Returns one row per coefficient: per block of a constant hold; per knot of a linear hold or control point of a spline, with two equal
/// times. Where the arm stays after the task, a row follows for the time after the horizon.
pub(super) fn control_rows(
    problem: &OptimalControlProblem,
    coefficients: &[f64],
) -> Vec<ControlRow> {
    let named = problem.named_controls();
    let edges = problem.control.edge_times();
    let times = problem.control.coefficient_times();
    let row = |[t_start, t_end]: [f64; 2], coefficient: &[f64]| ControlRow {
        t_start,
        t_end,
        values: (named.iter().map(|own| own.value(coefficient))).collect(),
    };
    let n = problem.n_numbers();
    let end = problem.grid.duration();
    // The last controls are held for a time where the arm stays.
    let held = (problem.stay.iter()).map(|stay| row([end, end + stay.seconds], &stay.controls));
    (0..problem.control.n_coefficients())
        .map(|j| {
            let interval = match problem.control.hold {
                Hold::Constant => [edges[j], edges[j + 1]],
                Hold::Linear | Hold::Cubic => [times[j]; 2],
            };
            row(interval, &coefficients[j * n..][..n])
        })
        .chain(held)
        .collect()
}

/// Writes the controls of a solution.
///
/// # Errors
/// [`OutputError`] where the file cannot be written.
pub(super) fn write_rows_of(
    path: &Path,
    problem: &OptimalControlProblem,
    rows: &[ControlRow],
) -> Result<(), OutputError> {
    write_controls(path, &headings(&problem.named_controls()), rows)
}

/// Reads the `controls.csv` in the result directory of a problem.
///
/// # Errors
/// [`OutputError`] for a file that cannot be read, or has the controls of another problem.
#[cfg(feature = "cli")]
pub(super) fn read_rows(
    directory: &Path,
    problem: &OptimalControlProblem,
) -> Result<Vec<ControlRow>, OutputError> {
    let headings = headings(&problem.named_controls());
    let path = directory.join("controls.csv");
    read_controls(&path, &headings, problem.n_control_rows())
}

/// Returns the coefficients of the controls in rows of the problem.
pub(super) fn coefficients_of(rows: &[ControlRow], problem: &OptimalControlProblem) -> Vec<f64> {
    let named = problem.named_controls();
    let (n, n_coefficients) = (problem.n_numbers(), problem.control.n_coefficients());
    let mut out = vec![0.0; n * n_coefficients];
    for (j, row) in rows.iter().take(n_coefficients).enumerate() {
        for (own, value) in named.iter().zip(&row.values) {
            own.write(*value, &mut out[j * n..][..n]);
        }
    }
    out
}
