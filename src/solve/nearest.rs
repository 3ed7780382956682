//! The nearest point to a target at which the arm can be held.

use crate::control::{Held, Holding, OptimalControlProblem, holding};
use crate::mechanics::{NodeWrenches, Wrench};
use crate::output::summary::NearestHeldSummary;

/// Fraction of the length below which a coordinate of an equilibrium is rounding: the scaled residual that an equilibrium may leave.
const PLACE_ROUNDING: f64 = 1e-9;

/// Returns the nearest point to the target at which the arm can be held, where no motion to the target was found; `None` without a target,
/// and where the target is held or no point was found.
pub(super) fn nearest_to_target(problem: &OptimalControlProblem) -> Option<NearestHeldSummary> {
    nearest(problem, &holding(problem).ok()?)
}

/// Returns the nearest point to a goal at which its node was found to be held, with what holds it there.
pub(crate) fn nearest(
    problem: &OptimalControlProblem,
    found: &Holding,
) -> Option<NearestHeldSummary> {
    let (held, distance_m) = found.nearest()?;
    let node = problem.goal_node();
    let r = &held.shape.rotations[node];
    Some(NearestHeldSummary {
        position_m: {
            // Rounding of a place in a plane of symmetry is nothing.
            let least = PLACE_ROUNDING * problem.rod.scales.length;
            let place = held.shape.positions[node];
            place.map(|x| if x.abs() < least { 0.0 } else { x }).into()
        },
        distance_m: *distance_m,
        angle_rad: problem.final_goals().find_map(|goal| goal.angle(r)),
        wrenches: wrenches(problem, held),
        controls: controls(problem, held),
    })
}

/// Returns the wrenches on nodes that hold an arm.
pub(super) fn wrenches(problem: &OptimalControlProblem, held: &Held) -> Vec<[f64; 6]> {
    let wrenches = problem.wrenches(&held.controls);
    wrenches.iter().map(Wrench::to_array).collect()
}

/// Returns the controls of other actuators that hold an arm.
pub(super) fn controls(problem: &OptimalControlProblem, held: &Held) -> Vec<Vec<f64>> {
    let mut efforts = problem.rod.actuators.efforts(problem.grid.duration());
    let inputs = problem.inputs(&held.controls);
    let control = NodeWrenches {
        inputs,
        efforts: problem.efforts.as_ref(),
        ..NodeWrenches::NONE
    };
    control.add_efforts(&mut efforts);
    let driven = problem.efforts.iter().flat_map(|own| &own.actuators);
    (problem.acting.iter())
        .map(|acting| acting.controls(inputs))
        .chain(driven.map(|&actuator| vec![efforts[actuator]]))
        .collect()
}
