//! The stay of an arm after its task: the equilibrium at its target, with the wrenches that hold it.

use super::arm::StartError;
use super::definition::Staying;
use super::error::{DiscretizeError, NearestHeld};
use control::{
    CannotHold, Held, Holding, HoldingError, NotFound, OptimalControlProblem, Stay, holding,
};

/// Returns the stay from the end of the horizon of `problem` on, for an arm of `length` in m.
///
/// `None` if it is unknown whether anything holds the target.
///
/// # Errors
/// [`DiscretizeError::NotHeld`] if nothing within the bounds can hold the target, or if the ends let the arm turn where nothing brings it
/// back.
pub(super) fn stay(
    problem: &OptimalControlProblem,
    staying: Staying,
    length: f64,
) -> Result<Option<Stay>, DiscretizeError> {
    let refuse = |reason: String, nearest: Option<NearestHeld>| {
        Err(DiscretizeError::NotHeld { reason, nearest })
    };
    let found = holding(problem).map(|found| judged(found, problem, staying, length));
    match found {
        Ok(Ok((_, stay))) => Ok(Some(stay)),
        Ok(Err(Holding::NotFound {
            why: why @ NotFound::LooseEnds,
            ..
        })) => refuse(why.to_string(), None),
        Ok(Err(Holding::NotFound { .. } | Holding::Held(_))) => Ok(None),
        Ok(Err(Holding::CannotBeHeld { why, nearest })) => {
            let words = nearest_in_words(problem, nearest.as_ref());
            let place = nearest.map(|(held, distance)| NearestHeld {
                position: held.shape.positions[problem.goal_node()].into(),
                distance,
            });
            refuse(format!("the arm cannot stay there: {why}{words}"), place)
        }
        Err(HoldingError::Stopped(stop)) => {
            Err(DiscretizeError::Start(StartError::Equilibrium(stop.into())))
        }
        Err(error) => refuse(error.to_string(), None),
    }
}

/// Names the nearest target that was found to be held, in words that follow a reason; empty without one.
pub fn nearest_in_words(
    problem: &OptimalControlProblem,
    nearest: Option<&(Box<Held>, f64)>,
) -> String {
    let Some((held, distance)) = nearest else {
        return String::new();
    };
    let node = problem.goal_node();
    let what = if node == problem.rod.tip() {
        "tip".to_string()
    } else {
        format!("place of node {node}")
    };
    let x = held.shape.positions[node];
    format!(
        "; the nearest {what} that can be held is [{:.6}, {:.6}, {:.6}] m, {distance:.2e} m from it",
        x.x, x.y, x.z
    )
}

/// Returns the verdict on holding the goal of `problem` over a stay, the same for a solve and for `check`. It is that of
/// [`holding`](fn@holding), except that an equilibrium whose deviations grow too little over the stay to matter is held, and one without a
/// positive stiffness is not.
///
/// # Errors
/// Those of [`holding`](fn@holding).
pub fn holding_over(
    problem: &OptimalControlProblem,
    staying: Staying,
    length: f64,
) -> Result<Holding, HoldingError> {
    let verdict = judged(holding(problem)?, problem, staying, length);
    Ok(verdict.map_or_else(|other| other, |(held, _)| Holding::Held(held)))
}

/// Returns the equilibrium that holds the goal over a stay, with the stay there, from the verdict without regard to time; or the verdict
/// that nothing is known to hold it.
///
/// # Errors
/// Returns that verdict as an error.
pub fn judged(
    found: Holding,
    problem: &OptimalControlProblem,
    staying: Staying,
    length: f64,
) -> Result<(Box<Held>, Stay), Holding> {
    let held = match found {
        Holding::Held(held) => held,
        Holding::CannotBeHeld {
            why: CannotHold::Unstable(held),
            ..
        }
        | Holding::NotFound {
            why: NotFound::Unstable(held),
            ..
        } if held.is_within_bounds() && grows_little(&held, staying) => held,
        found => return Err(found),
    };
    match stay_at(problem, (*held).clone(), staying, length) {
        Some(stay) => Ok((held, stay)),
        None => Err(Holding::CannotBeHeld {
            why: CannotHold::Unstable(held),
            nearest: None,
        }),
    }
}

/// Returns the stay at an equilibrium; `None` if its stiffness is not positive.
fn stay_at(
    problem: &OptimalControlProblem,
    held: Held,
    staying: Staying,
    length: f64,
) -> Option<Stay> {
    let (node, last) = (problem.goal_node(), problem.grid.n_steps);
    let goal = (problem.goals.iter())
        .position(|goal| goal.node == node && goal.time_node == last)
        .unwrap_or(0);
    let seconds = seconds(&held, staying);
    let distance = staying.distance(length);
    Stay::at(&problem.rod, held, [seconds, distance], (goal, node))
}

/// Returns the duration of the stay, s: one first period of the held arm, unless a duration is given.
fn seconds(held: &Held, staying: Staying) -> f64 {
    (staying.seconds).unwrap_or(std::f64::consts::TAU / held.least_squared_frequency.sqrt())
}

/// Tells whether the deviations from an equilibrium grow, over the stay, by no more than the fraction of the distance that the motion
/// leaves unused. The equilibrium must have a positive stiffness, so that only a body moment makes it unstable.
fn grows_little(held: &Held, staying: Staying) -> bool {
    let growth = held.growth_rate.unwrap_or(f64::INFINITY);
    held.least_squared_frequency > 0.0 && growth * seconds(held, staying) < Stay::ROOM.ln()
}
