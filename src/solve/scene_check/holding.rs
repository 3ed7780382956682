//! Tells whether and by what an arm is held at its target.

use std::f64::consts::TAU;

use crate::control::{CannotHold, Held, Holding, NotFound, OptimalControlProblem, holding};
use crate::mechanics::{NodeWrenches, Wrench};
use crate::output::summary::{NearestHeldSummary, StaticNeedSummary};
use crate::task::Staying;
use crate::task::staying::holding_over;

/// Verdicts of what holds the tip at its target.
pub(crate) const WITHIN: &str = "within-bounds";
pub(crate) const ABOVE: &str = "above-bounds";
pub(crate) const UNSTABLE: &str = "unstable";
pub(crate) const CANNOT: &str = "cannot-be-held";
pub(crate) const NOT_FOUND: &str = "not-found";

/// Fraction of the length below which a coordinate of an equilibrium is rounding: the scaled residual that an equilibrium may leave.
const PLACE_ROUNDING: f64 = 1e-9;

/// Says whether and by what the tip, or the node of the task, can be held at its goal, over a stay if the arm should stay; `None` where it
/// has none, or the search was stopped.
pub(super) fn need(
    problem: &OptimalControlProblem,
    staying: Option<Staying>,
    length: f64,
) -> Option<StaticNeedSummary> {
    let summary = |verdict, held: Option<&Held>, reason| StaticNeedSummary {
        verdict,
        wrenches: held.map_or_else(Vec::new, |held| wrenches(problem, held)),
        controls: held.map_or_else(Vec::new, |held| controls(problem, held)),
        reason,
        stiffness_n_m: held
            .filter(|held| held.is_stable)
            .map(Held::least_stiffness)
            .filter(|stiffness| *stiffness > 0.0),
        first_frequency_hz: held
            .and_then(|held| held.first_frequency)
            .map(|omega| omega / TAU),
        growth_rate_1_s: held.and_then(|held| held.growth_rate),
        nearest: None,
    };
    let found = match staying {
        Some(staying) => holding_over(problem, staying, length),
        None => holding(problem),
    };
    match found.ok()? {
        Holding::Held(held) => {
            let crosses = held.crosses.as_ref().map(|crossed| {
                format!(
                    "{crossed} in the shape that holds it there, and none that obeys it was found"
                )
            });
            Some(summary(WITHIN, Some(&held), crosses))
        }
        Holding::NotFound { why } => {
            let mut out = summary(NOT_FOUND, None, Some(why.to_string()));
            if let NotFound::Bounds { nearest } = why {
                out.nearest = nearest.map(|found| nearest_summary(problem, found));
            }
            Some(out)
        }
        Holding::CannotBeHeld { why, nearest } => {
            let (verdict, held) = match &why {
                CannotHold::AboveBounds(held) => (ABOVE, Some(&**held)),
                CannotHold::Unstable(held) => (UNSTABLE, Some(&**held)),
                CannotHold::NothingActuated
                | CannotHold::TooFewControls { .. }
                | CannotHold::Drifts
                | CannotHold::EndMoves { .. } => (CANNOT, None),
            };
            let mut out = summary(verdict, held, Some(why.to_string()));
            out.nearest = nearest.map(|found| nearest_summary(problem, found));
            Some(out)
        }
    }
}

/// The nearest target that is held, with what holds it.
fn nearest_summary(
    problem: &OptimalControlProblem,
    (held, distance_m): (Box<Held>, f64),
) -> NearestHeldSummary {
    NearestHeldSummary {
        position_m: {
            // Rounding of a place in a plane of symmetry is nothing.
            let least = PLACE_ROUNDING * problem.rod.scales.length;
            let place = held.shape.positions[problem.goal_node()];
            place.map(|x| if x.abs() < least { 0.0 } else { x }).into()
        },
        distance_m,
        wrenches: wrenches(problem, &held),
        controls: controls(problem, &held),
    }
}

fn wrenches(problem: &OptimalControlProblem, held: &Held) -> Vec<[f64; 6]> {
    let wrenches = problem.wrenches(&held.controls);
    wrenches.iter().map(Wrench::to_array).collect()
}

fn controls(problem: &OptimalControlProblem, held: &Held) -> Vec<Vec<f64>> {
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

/// Distance of the target from where its node starts, m.
pub(super) fn distance(problem: &OptimalControlProblem) -> Option<f64> {
    let start = problem.initial.configuration.positions[problem.goal_node()];
    let target = problem.final_goals().find_map(|goal| goal.position)?;
    Some((target - start).norm())
}
