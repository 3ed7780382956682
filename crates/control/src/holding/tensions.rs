//! The search for what holds a target by winches, over the [tensions](crate::tensions) of their tendons. Bounds and stability are
//! those of the arm on its winches, whose springs only stiffen it.

use super::program::Aim;
use super::statics::HoldingStatics;
use super::{BRANCHES, Demand, Held, HeldLimits, HoldingPoint, Search, ends};
use crate::tensions::Winches;

/// Multiples of the least tensions that tendons have where the arm is held, one after the other: an arm that comes to rest swings, and its
/// tendons stay taut only if they have more tension than its inertia takes away. A target at the edge of what tensions hold leaves no choice.
const LEAST_TIMES: [f64; 3] = [20.0, 4.0, 1.0];

/// Returns a stable equilibrium that holds the target by winches within their bounds, found over the tensions of their tendons; `None` if
/// there are no winches among the controls, or none was found.
pub(super) fn held_by_tensions(search: &Search) -> Option<Held> {
    let problem = search.statics.problem;
    let times = match problem.least_tensions().next() {
        Some(_) => &LEAST_TIMES[..],
        None => &[1.0],
    };
    times.iter().find_map(|factor| {
        let winches = Winches::with_least_times(problem, *factor)?;
        held_by(&winches, search)
    })
}

fn held_by(winches: &Winches, search: &Search) -> Option<Held> {
    let own = search.statics;
    let problem = winches.by_tensions();
    let components = own.components.clone();
    let statics = HoldingStatics {
        problem: &problem,
        ends: (components.iter())
            .map(|component| ends::ends(&problem, component))
            .collect(),
        components,
        time: own.time,
        unit: own.unit,
    };
    let twin = Search {
        limits: HeldLimits::of(&problem),
        statics: &statics,
        target: search.target,
        start: search.start.clone(),
    };
    let accepted = |point: &HoldingPoint| {
        let tensions = statics.coefficient(&point.controls);
        let displacements = winches.displacements(&tensions, &point.shape);
        let held = search.held(&HoldingPoint {
            controls: own.controls(&displacements),
            shape: point.shape.clone(),
        })?;
        let is_there = held.is_stable && held.is_within_bounds() && held.crosses.is_none();
        (is_there && search.is_at_goal(&held)).then_some(held)
    };
    let mut known = Vec::new();
    for branch in 0..=BRANCHES.len() {
        if problem.stop.is_raised() {
            return None;
        }
        let Ok(shape) = twin.pulled(branch) else {
            continue;
        };
        if known.iter().any(|other| twin.is_same(other, &shape)) {
            continue;
        }
        let first = HoldingPoint {
            controls: vec![0.0; statics.components.len()],
            shape: shape.clone(),
        };
        known.push(shape);
        let demand = Demand::of(Aim::Hold);
        let Some(point) = twin.solve(&demand, &first) else {
            continue;
        };
        let clear = twin.cleared(demand, [&point, &first]);
        let point = clear.map_or(point, |(_, clear)| clear);
        if let Some(held) = accepted(&point) {
            return Some(held);
        }
    }
    let (held, _) = twin.nearest_of_starts()?;
    accepted(&HoldingPoint {
        controls: statics.controls(&held.controls),
        shape: held.shape.clone(),
    })
}
