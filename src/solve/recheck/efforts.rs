//! The check of `efforts.csv`: efforts by the check's own hold, coordinates by the check's own strains.

use super::file_check::{DERIVED, FileCheck, ROUNDINGS};
use crate::control::OptimalControlProblem;
use crate::mechanics::{Trajectory, Wrench};
use crate::output::EffortRow;
use crate::verify::{efforts, hold};

/// Checks every row of a solve, whose recorded motion has all time nodes.
#[must_use]
pub(super) fn check(
    problem: &OptimalControlProblem,
    coefficients: &[Wrench],
    trajectory: &Trajectory,
    rows: &[EffortRow],
) -> FileCheck {
    let mut out = FileCheck::of("efforts.csv");
    let rod = &problem.rod;
    let signal = hold::signal(problem, 1, coefficients);
    let at_rest = efforts::coordinates(rod, &rod.rest.positions, &rod.rest.rotations);
    for (k, rows) in rows.chunks(rod.actuators.len().max(1)).enumerate() {
        let efforts = efforts::at_node(rod, &problem.grid.node(k), &signal.at(k));
        let (x, r) = (trajectory.positions_at(k), trajectory.rotations_at(k));
        let coordinates = efforts::coordinates(rod, x, r);
        for (i, (row, actuator)) in rows.iter().zip(rod.actuators.iter()).enumerate() {
            let place = |column: &str| format!("{column}, row {k}, \"{}\"", actuator.name);
            let allowed = ROUNDINGS * problem.grid.duration();
            out.number(row.t, problem.grid.time(k), allowed, || place("t"));
            out.word(&row.name, &actuator.name, || place("name"));
            let allowed = ROUNDINGS * (efforts[i].abs() + actuator.effort(0.0).abs());
            out.number(row.effort, efforts[i], allowed, || place("effort"));
            let change = coordinates[i] - at_rest[i];
            let allowed = DERIVED * change.abs() + ROUNDINGS * at_rest[i].abs();
            out.number(row.coordinate, change, allowed, || place("coordinate"));
        }
    }
    out
}
