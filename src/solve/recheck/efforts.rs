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
    let n = rod.actuators.len();
    let along: Vec<[Vec<f64>; 2]> = (0..trajectory.n_times().min(problem.grid.n_steps + 1))
        .map(|k| {
            let (x, r) = (trajectory.positions_at(k), trajectory.rotations_at(k));
            let coordinates = efforts::coordinates(rod, x, r);
            let changes = coordinates.iter().zip(&at_rest).map(|(y, rest)| y - rest);
            let own = efforts::at_node(rod, &problem.grid.node(k), &signal.at(k));
            [own, changes.collect()]
        })
        .collect();
    // A value near zero is a difference of others: what counts is the largest along the motion.
    let largest = |of: usize, i: usize| {
        let sizes = along.iter().map(|numbers| numbers[of][i].abs());
        sizes.fold(0.0, f64::max)
    };
    let sizes: Vec<[f64; 2]> = (0..n).map(|i| [largest(0, i), largest(1, i)]).collect();
    for (k, (rows, [efforts, changes])) in rows.chunks(n.max(1)).zip(&along).enumerate() {
        for (i, (row, actuator)) in rows.iter().zip(rod.actuators.iter()).enumerate() {
            let place = |column: &str| format!("{column}, row {k}, \"{}\"", actuator.name);
            let [effort, change] = sizes[i];
            let allowed = ROUNDINGS * problem.grid.duration();
            out.number(row.t, problem.grid.time(k), allowed, || place("t"));
            out.word(&row.name, &actuator.name, || place("name"));
            let allowed = ROUNDINGS * (effort + actuator.effort(0.0).abs());
            out.number(row.effort, efforts[i], allowed, || place("effort"));
            let allowed = DERIVED * change + ROUNDINGS * at_rest[i].abs();
            out.number(row.coordinate, changes[i], allowed, || place("coordinate"));
        }
    }
    out
}
