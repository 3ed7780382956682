//! The efforts and coordinates of the actuators in an arm along a motion.

use nalgebra::{Matrix3, Vector3};

use crate::control::{self, OptimalControlProblem};
use crate::mechanics::{Configuration, Rod, Trajectory};
use crate::output::summary::SlackSummary;
use crate::output::{EffortRow, MotionRecord};

/// Returns the commands of all actuators just after a time node, from their efforts there and the coefficients of the control: the effort
/// plus its rate times the lag. `None` if no actuator has a lag.
pub(crate) fn commands(
    problem: &OptimalControlProblem,
    coefficients: &[f64],
    k: usize,
    efforts: &[f64],
) -> Option<Vec<f64>> {
    let mut out = None;
    for (driven, component) in problem.driven_components() {
        let lag = problem.channel(&component).lag;
        if lag == 0.0 {
            continue;
        }
        let n = problem.n_numbers();
        let along = |lag: f64| -> f64 {
            let weights = problem.control.command_weights(k, lag);
            let term = |&(j, weight): &(usize, f64)| weight * coefficients[j * n + component.index];
            weights.iter().map(term).sum()
        };
        out.get_or_insert_with(|| efforts.to_vec())[driven.actuator] +=
            driven.gain * (along(lag) - along(0.0));
    }
    out
}

/// Returns the rows of `efforts.csv` for a recorded motion; `inputs` gives those of all actuators in a row of the record, and their commands
/// where any of them has a lag.
pub(crate) fn effort_rows(
    rod: &Rod,
    record: &MotionRecord,
    inputs: impl Fn(usize) -> (Vec<f64>, Option<Vec<f64>>),
) -> Vec<EffortRow> {
    let mut out = Vec::with_capacity(record.n_rows() * rod.actuators.len());
    for k in 0..record.n_rows() {
        let (inputs, commands) = inputs(k);
        let shape = shape_of(record, k);
        let rows = efforts_at(rod, record.t[k], &shape, &inputs, commands.as_deref());
        out.extend(rows);
    }
    out
}

/// Returns the shape in a row of a recorded motion.
pub(crate) fn shape_of(record: &MotionRecord, row: usize) -> Configuration {
    let n = record.n_nodes;
    Configuration {
        positions: (record.x[3 * n * row..][..3 * n].chunks_exact(3))
            .map(Vector3::from_column_slice)
            .collect(),
        rotations: (record.rotation[9 * n * row..][..9 * n].chunks_exact(9))
            .map(Matrix3::from_row_slice)
            .collect(),
    }
}

/// Returns the rows of `efforts.csv` for one shape at time `t` (s), under the inputs of all actuators, and their commands where any of them
/// has a lag.
pub(crate) fn efforts_at(
    rod: &Rod,
    t: f64,
    shape: &Configuration,
    inputs: &[f64],
    commands: Option<&[f64]>,
) -> Vec<EffortRow> {
    let state = rod.effort_state(shape.poses());
    let at_rest = rod.actuator_coordinates(&rod.rest.positions, &rod.rest.rotations);
    let coordinates = state.coordinates.iter().zip(at_rest);
    (rod.actuators.iter().zip(coordinates).enumerate())
        .map(|(i, (actuator, (y, at_rest)))| EffortRow {
            t,
            name: actuator.name.clone(),
            effort: rod.actuators.law(i, inputs[i], &state).effort,
            coordinate: y - at_rest,
            command: commands.map(|commands| commands[i]),
            displacement: (rod.actuators.follow_shape())
                .then(|| displacement(rod, i, inputs[i], y - at_rest)),
        })
        .collect()
}

/// Returns the displacement of a tendon, m, for an input and a coordinate relative to the stress-free shape; `None` for another actuator.
fn displacement(rod: &Rod, actuator: usize, input: f64, coordinate: f64) -> Option<f64> {
    let own = rod.actuators.strains().get(actuator)?;
    match &own.density {
        _ if own.winch.is_some() => Some(input),
        density if density.is_tendon() => Some(-coordinate),
        _ => None,
    }
}

/// Returns the fraction of the rows of `efforts.csv` in which the tendon of each winch has no tension.
#[cfg(feature = "cli")]
pub(crate) fn slack(rod: &Rod, rows: &[EffortRow]) -> Vec<SlackSummary> {
    let efforts: Vec<f64> = rows.iter().map(|row| row.effort).collect();
    named(rod, control::slack_of(rod, &efforts))
}

/// Returns the fraction of the time nodes of a motion at which the tendon of each winch has no tension.
pub(crate) fn slack_of_motion(
    problem: &OptimalControlProblem,
    coefficients: &[f64],
    motion: &Trajectory,
) -> Vec<SlackSummary> {
    let found = control::slack_of_motion(problem, motion, coefficients);
    named(&problem.rod, found)
}

fn named(rod: &Rod, slack: Vec<(usize, f64)>) -> Vec<SlackSummary> {
    let actuators: Vec<_> = rod.actuators.iter().collect();
    (slack.into_iter())
        .map(|(actuator, fraction)| SlackSummary {
            name: actuators[actuator].name.clone(),
            fraction,
        })
        .collect()
}
