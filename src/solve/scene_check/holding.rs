//! Tells whether and by what an arm is held at its target.

use std::f64::consts::TAU;

use crate::control::{CannotHold, Held, Holding, OptimalControlProblem, holding};
use crate::output::summary::StaticNeedSummary;
use crate::solve::nearest::{controls, nearest, wrenches};
use crate::task::Staying;
use crate::task::staying::holding_over;

/// Verdicts of what holds the tip at its target.
pub(super) const WITHIN: &str = "within-bounds";
const ABOVE: &str = "above-bounds";
const UNSTABLE: &str = "unstable";
const CANNOT: &str = "cannot-be-held";
pub(super) const NOT_FOUND: &str = "not-found";

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
    let found = found.ok()?;
    let nearest = nearest(problem, &found);
    let mut out = match found {
        Holding::Held(held) => {
            let crosses = held.crosses.as_ref().map(|crossed| {
                format!(
                    "{crossed} in the shape that holds it there, and none that obeys it was found"
                )
            });
            summary(WITHIN, Some(&held), crosses)
        }
        Holding::NotFound { why, .. } => summary(NOT_FOUND, None, Some(why.to_string())),
        Holding::CannotBeHeld { why, .. } => {
            let (verdict, held) = match &why {
                CannotHold::AboveBounds(held) => (ABOVE, Some(&**held)),
                CannotHold::Unstable(held) => (UNSTABLE, Some(&**held)),
                CannotHold::NothingActuated
                | CannotHold::TooFewControls { .. }
                | CannotHold::Drifts
                | CannotHold::EndMoves { .. } => (CANNOT, None),
            };
            summary(verdict, held, Some(why.to_string()))
        }
    };
    out.nearest = nearest;
    Some(out)
}

/// Distance of the target from where its node starts, m.
pub(super) fn distance(problem: &OptimalControlProblem) -> Option<f64> {
    let start = problem.initial.configuration.positions[problem.goal_node()];
    let target = problem.final_goals().find_map(|goal| goal.position)?;
    Some((target - start).norm())
}
