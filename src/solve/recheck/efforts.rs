//! The check of `efforts.csv`: efforts by the check's own hold, coordinates by the check's own strains.

use super::file_check::{DERIVED, FileCheck, ROUNDINGS};
use crate::control::{Component, OptimalControlProblem};
use crate::mechanics::{Density, Trajectory, Wrench};
use crate::output::EffortRow;
use crate::verify::{efforts, hold};

/// Returns the commands of all actuators just after time node `k`, by the check's own hold; `None` if no actuator has a lag.
fn commands(
    problem: &OptimalControlProblem,
    coefficients: &[Wrench],
    k: usize,
    efforts: &[f64],
) -> Option<Vec<f64>> {
    let driven = problem.efforts.as_ref()?;
    let spline = hold::Spline::of(problem);
    let n = problem.actuators.len();
    let mut out = None;
    for (i, &actuator) in driven.actuators.iter().enumerate() {
        let component = Component {
            actuator: driven.first + driven.places[i] / 6,
            axis: driven.places[i] % 6,
        };
        let lag = problem.channel(&component).lag;
        if lag > 0.0 {
            let value = |lag: f64| -> f64 {
                (spline.command_weights(k, lag).iter())
                    .map(|&(j, weight)| {
                        let wrench = coefficients[j * n + component.actuator].to_array();
                        weight * wrench[component.axis]
                    })
                    .sum()
            };
            out.get_or_insert_with(|| efforts.to_vec())[actuator] += value(lag) - value(0.0);
        }
    }
    out
}

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
        let (x, r) = (trajectory.positions_at(k), trajectory.rotations_at(k));
        let inputs = efforts::inputs(rod, &problem.grid.node(k), &signal.at(k));
        let coordinates = efforts::coordinates(rod, x, r);
        let commands = commands(problem, coefficients, k, &inputs);
        let efforts = efforts::of_inputs(rod, inputs.clone(), &coordinates);
        for (i, (row, actuator)) in rows.iter().zip(rod.actuators.iter()).enumerate() {
            let place = |column: &str| format!("{column}, row {k}, \"{}\"", actuator.name);
            let allowed = ROUNDINGS * problem.grid.duration();
            out.number(row.t, problem.grid.time(k), allowed, || place("t"));
            out.word(&row.name, &actuator.name, || place("name"));
            let rounding = ROUNDINGS * (efforts[i].abs() + actuator.effort(0.0).abs());
            let allowed = rounding;
            out.number(row.effort, efforts[i], allowed, || place("effort"));
            let change = coordinates[i] - at_rest[i];
            let allowed = DERIVED * change.abs() + ROUNDINGS * at_rest[i].abs();
            out.number(row.coordinate, change, allowed, || place("coordinate"));
            let displacement = match actuator.density {
                _ if !rod.actuators.has_winches() => None,
                _ if actuator.winch.is_some() => Some(inputs[i]),
                Density::Shortening => Some(-change),
                _ => None,
            };
            if let Some(expected) = displacement {
                let found = row.displacement.flatten().unwrap_or(f64::NAN);
                let allowed = allowed + ROUNDINGS * expected.abs();
                out.number(found, expected, allowed, || place("displacement"));
            }
            let Some(commands) = &commands else {
                continue;
            };
            let found = row.command.unwrap_or(f64::NAN);
            let allowed = DERIVED * (commands[i] - efforts[i]).abs() + rounding;
            out.number(found, commands[i], allowed, || place("command"));
        }
    }
    out
}
