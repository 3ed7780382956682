//! `controls.csv`: the times of the coefficients, recomputed.

use super::{FileCheck, ROUNDINGS};
use crate::control::OptimalControlProblem;
use crate::output::ControlRow;
use crate::verify::hold::Spline;

/// Start and end of every row: those of its block, or the time that its coefficient stands for. What is applied is for the conditions
/// of the motion to judge.
#[must_use]
pub fn check(problem: &OptimalControlProblem, rows: &[ControlRow]) -> FileCheck {
    let mut out = FileCheck::of("controls.csv");
    let allowed = ROUNDINGS * problem.grid.duration();
    let intervals = Spline::of(problem).intervals();
    let n = problem.actuators.len().max(1);
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
