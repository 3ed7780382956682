//! The check of `controls.csv`: the times of the coefficients, recomputed.

use super::file_check::{ELSEWHERE, FileCheck, ROUNDINGS};
use crate::control::OptimalControlProblem;
use crate::output::ControlRow;
use crate::verify::hold::Spline;

/// The columns of a wrench.
const WRENCH: [&str; 6] = ["fx", "fy", "fz", "mx", "my", "mz"];

/// Checks start and end of every row: those of its block, or the time of its coefficient; for the rows after the horizon, with which the
/// arm stays, also their wrenches. The wrenches before are judged by the conditions of the motion.
#[must_use]
pub(super) fn check(problem: &OptimalControlProblem, rows: &[ControlRow]) -> FileCheck {
    let mut out = FileCheck::of("controls.csv");
    let allowed = ROUNDINGS * problem.grid.duration();
    let mut intervals = Spline::of(problem).intervals();
    let n = problem.actuators.len().max(1);
    let n_coefficients = n * intervals.len();
    if let Some(stay) = &problem.stay {
        let end = problem.grid.duration();
        intervals.push([end, end + stay.seconds]);
        let held = rows.iter().skip(n_coefficients).zip(&stay.wrenches);
        for (i, (row, wrench)) in held.enumerate() {
            let found = [row.fx, row.fy, row.fz, row.mx, row.my, row.mz];
            let expected = wrench.to_array();
            for (column, (found, expected)) in WRENCH.iter().zip(found.iter().zip(&expected)) {
                let allowed = ELSEWHERE * (wrench.force.norm() + wrench.moment.norm());
                out.number(*found, *expected, allowed, || {
                    format!("{column}, line {}", n_coefficients + i + 2)
                });
            }
        }
    }
    for (i, row) in rows.iter().enumerate() {
        let [start, end] = intervals.get(i / n).copied().unwrap_or([f64::NAN; 2]);
        for (column, found, expected) in
            [("t_start", row.t_start, start), ("t_end", row.t_end, end)]
        {
            out.number(found, expected, allowed, || {
                format!("{column}, line {}", i + 2)
            });
        }
    }
    out
}
