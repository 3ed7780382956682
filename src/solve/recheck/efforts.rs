//! The check of `efforts.csv`: efforts by the check's own hold, coordinates by the check's own strains.

use super::file_check::{DERIVED, FileCheck, ROUNDINGS};
use crate::control::OptimalControlProblem;
use crate::mechanics::Trajectory;
use crate::output::EffortRow;
use crate::verify::{efforts, hold};

/// Returns the commands of all actuators just after time node `k`, by the check's own hold; `None` if no actuator has a lag.
fn commands(
    problem: &OptimalControlProblem,
    spline: &hold::Spline,
    coefficients: &[f64],
    k: usize,
    efforts: &[f64],
) -> Option<Vec<f64>> {
    let n = problem.n_numbers();
    let mut out = None;
    for (driven, component) in problem.driven_components() {
        let lag = problem.channel(&component).lag;
        if lag > 0.0 {
            let value = |lag: f64| -> f64 {
                (spline.command_weights(k, lag).iter())
                    .map(|&(j, weight)| weight * coefficients[j * n + component.index])
                    .sum()
            };
            out.get_or_insert_with(|| efforts.to_vec())[driven.actuator] +=
                driven.gain * (value(lag) - value(0.0));
        }
    }
    out
}

/// The expected numbers of all actuators at a time node.
struct Row {
    inputs: Vec<f64>,
    efforts: Vec<f64>,
    /// Coordinates relative to the stress-free shape.
    changes: Vec<f64>,
    commands: Option<Vec<f64>>,
    /// Derivatives of the efforts along the coordinates.
    slopes: Vec<f64>,
}

/// Checks every row of a solve, whose recorded motion has all time nodes.
#[must_use]
pub(super) fn check(
    problem: &OptimalControlProblem,
    coefficients: &[f64],
    trajectory: &Trajectory,
    rows: &[EffortRow],
) -> FileCheck {
    let mut out = FileCheck::of("efforts.csv");
    let rod = &problem.rod;
    let signal = hold::signal(problem, 1, coefficients);
    let at_rest = efforts::coordinates(rod, &rod.rest.positions, &rod.rest.rotations);
    let spline = hold::Spline::of(problem);
    let n = rod.actuators.len();
    let along: Vec<Row> = (0..trajectory.n_times().min(problem.grid.n_steps + 1))
        .map(|k| {
            let (x, r) = (trajectory.positions_at(k), trajectory.rotations_at(k));
            let inputs = efforts::inputs(rod, &problem.grid.node(k), &signal.at(k));
            let coordinates = efforts::coordinates(rod, x, r);
            let changes = coordinates.iter().zip(&at_rest).map(|(y, rest)| y - rest);
            Row {
                commands: commands(problem, &spline, coefficients, k, &inputs),
                efforts: efforts::of_inputs(rod, inputs.clone(), &coordinates),
                changes: changes.collect(),
                slopes: (efforts::slopes(rod, &inputs, &coordinates).iter())
                    .map(|[along_coordinate, _]| *along_coordinate)
                    .collect(),
                inputs,
            }
        })
        .collect();
    // A value near zero is a difference of others: what counts is the largest along the motion.
    let largest = |of: fn(&Row) -> &[f64], i: usize| {
        along.iter().map(|row| of(row)[i].abs()).fold(0.0, f64::max)
    };
    let sizes: Vec<[f64; 2]> = (0..n)
        .map(|i| {
            [
                largest(|row| &row.efforts, i),
                largest(|row| &row.changes, i),
            ]
        })
        .collect();
    for (k, (rows, expected)) in rows.chunks(n.max(1)).zip(&along).enumerate() {
        let Row {
            inputs,
            efforts,
            changes,
            commands,
            slopes,
        } = expected;
        for (i, (row, actuator)) in rows.iter().zip(rod.actuators.iter()).enumerate() {
            let place = |column: &str| format!("{column}, row {k}, \"{}\"", actuator.name);
            let [effort, change] = sizes[i];
            let allowed = ROUNDINGS * problem.grid.duration();
            out.number(row.t, problem.grid.time(k), allowed, || place("t"));
            out.word(&row.name, &actuator.name, || place("name"));
            // The tension of a winch is a difference of lengths.
            let length = actuator.winch.map_or(0.0, |winch| winch.outside) + at_rest[i].abs();
            let difference = slopes[i].abs() * length;
            let rounding = ROUNDINGS * (effort + actuator.effort(0.0).abs() + difference);
            out.number(row.effort, efforts[i], rounding, || place("effort"));
            let allowed = DERIVED * change + ROUNDINGS * at_rest[i].abs();
            out.number(row.coordinate, changes[i], allowed, || place("coordinate"));
            let displacement = match rod.actuators.strains().get(i).map(|own| &own.density) {
                _ if !rod.actuators.follow_shape() => None,
                _ if actuator.winch.is_some() => Some(inputs[i]),
                Some(density) if density.is_tendon() => Some(-changes[i]),
                _ => None,
            };
            if let Some(expected) = displacement {
                let found = row.displacement.flatten().unwrap_or(f64::NAN);
                let allowed = allowed + ROUNDINGS * expected.abs();
                out.number(found, expected, allowed, || place("displacement"));
            }
            let Some(commands) = commands else {
                continue;
            };
            let found = row.command.unwrap_or(f64::NAN);
            let allowed = DERIVED * (commands[i] - efforts[i]).abs() + rounding;
            out.number(found, commands[i], allowed, || place("command"));
        }
    }
    out
}
