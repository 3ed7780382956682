//! Where an arm stays after its task: the equilibrium at its target, with what holds it.

use super::definition::Staying;
use super::error::DiscretizeError;
use crate::control::{
    CannotHold, Held, Holding, HoldingError, OptimalControlProblem, Stay, holding,
};
use crate::mechanics::equilibrium::EquilibriumError;

/// Where the arm stays from the end of the horizon of `problem` on, for an arm of `length` in m.
///
/// `None` where it is not known whether anything holds the target.
///
/// # Errors
/// [`DiscretizeError::NotHeld`] where nothing within the bounds can hold the target.
pub(super) fn stay(
    problem: &OptimalControlProblem,
    staying: Staying,
    length: f64,
) -> Result<Option<Stay>, DiscretizeError> {
    let refuse = |reason: String| Err(DiscretizeError::NotHeld(reason));
    let held = match holding(problem) {
        Ok(Holding::Held(held)) => *held,
        Ok(Holding::CannotBeHeld {
            why: CannotHold::Unstable(held),
            ..
        }) if grows_little(&held, staying) => *held,
        Ok(Holding::CannotBeHeld { why, nearest }) => {
            let nearest = nearest.map_or_else(String::new, |(held, distance)| {
                let x = held.shape.positions[problem.rod.tip()];
                format!(
                    "; the nearest tip that can be held is [{:.6}, {:.6}, {:.6}] m, {distance:.2e} m from it",
                    x.x, x.y, x.z
                )
            });
            return refuse(format!("the arm cannot stay there: {why}{nearest}"));
        }
        Ok(Holding::NotFound { .. }) => return Ok(None),
        Err(HoldingError::Stopped(stop)) => {
            return Err(DiscretizeError::Start(EquilibriumError::Stopped(stop)));
        }
        Err(error) => return refuse(error.to_string()),
    };
    let (tip, last) = (problem.rod.tip(), problem.grid.n_steps);
    let goal = (problem.goals.iter())
        .position(|goal| goal.node == tip && goal.time_node == last)
        .unwrap_or(0);
    let seconds = seconds(&held, staying);
    let distance = staying.distance(length);
    match Stay::at(&problem.rod, held, [seconds, distance], goal) {
        Some(stay) => Ok(Some(stay)),
        None => refuse("the equilibrium there is hardly stable".into()),
    }
}

/// How long the arm stays, s: one first period of the held arm, where nothing else is asked.
fn seconds(held: &Held, staying: Staying) -> f64 {
    (staying.seconds).unwrap_or(std::f64::consts::TAU / held.least_squared_frequency.sqrt())
}

/// Tells whether an equilibrium with a positive stiffness, which only a body moment makes unstable, lets deviations grow no more over the stay than
/// the part of the distance that the motion leaves unused.
fn grows_little(held: &Held, staying: Staying) -> bool {
    let growth = held.growth_rate.unwrap_or(f64::INFINITY);
    held.least_squared_frequency > 0.0 && growth * seconds(held, staying) < Stay::ROOM.ln()
}
