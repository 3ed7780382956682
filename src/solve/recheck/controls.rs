//! The check of `controls.csv`: the times of the coefficients, recomputed.

use super::file_check::{ELSEWHERE, FileCheck, ROUNDINGS};
use crate::control::{NamedControl, OptimalControlProblem};
use crate::output::{ControlRow, first_line};
use crate::verify::hold::Spline;

/// Checks start and end of every row: those of its block, or the time of its coefficient; of the row after the horizon, with which the arm
/// stays, also the values. The values before are judged by the conditions of the motion.
#[must_use]
pub(super) fn check(problem: &OptimalControlProblem, rows: &[ControlRow]) -> FileCheck {
    let mut out = FileCheck::of("controls.csv");
    let allowed = ROUNDINGS * problem.grid.duration();
    let mut intervals = Spline::of(problem).intervals();
    let named = problem.named_controls();
    let headings: Vec<String> = named.iter().map(NamedControl::heading).collect();
    let first = first_line(&headings) as usize;
    if let Some(stay) = &problem.stay {
        let at = intervals.len();
        let end = problem.grid.duration();
        intervals.push([end, end + stay.seconds]);
        // A number is as exact as the vector of which it is a component.
        let size_of = |own: &NamedControl| {
            let channel = (0..problem.channels.len())
                .find(|channel| problem.numbers_of(*channel).contains(&own.index));
            channel.map_or(0.0, |channel| {
                problem.vector(&stay.controls, channel).norm()
            })
        };
        for (i, own) in named.iter().enumerate() {
            let found = rows.get(at).map_or(f64::NAN, |row| row.values[i]);
            let size = size_of(own) + own.rest.abs();
            let expected = own.value(&stay.controls);
            out.number(found, expected, ELSEWHERE * size, || {
                format!("{}, line {}", headings[i], first + at)
            });
        }
    }
    for (i, row) in rows.iter().enumerate() {
        let [start, end] = intervals.get(i).copied().unwrap_or([f64::NAN; 2]);
        for (column, found, expected) in
            [("t_start", row.t_start, start), ("t_end", row.t_end, end)]
        {
            out.number(found, expected, allowed, || {
                format!("{column}, line {}", first + i)
            });
        }
    }
    out
}
