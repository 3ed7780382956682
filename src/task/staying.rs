//! Where an arm stays after its task: the equilibrium at its target, with what holds it.

use super::definition::Staying;
use super::error::DiscretizeError;
use crate::control::{CannotHold, Holding, HoldingError, OptimalControlProblem, Stay, holding};
use crate::mechanics::equilibrium::EquilibriumError;

/// Where the arm stays from the end of the horizon of `problem` on, for an arm of `length` in m.
///
/// # Errors
/// [`DiscretizeError::NotHeld`] where nothing within the bounds is known to hold the target.
pub(super) fn stay(
    problem: &OptimalControlProblem,
    staying: Staying,
    length: f64,
) -> Result<Stay, DiscretizeError> {
    let refuse = |reason: String| Err(DiscretizeError::NotHeld(reason));
    let held = match holding(problem) {
        Ok(Holding::Held(held)) => *held,
        Ok(Holding::CannotBeHeld { why, nearest }) => {
            let nearest = nearest.map_or_else(String::new, |(held, distance)| {
                let x = held.shape.positions[problem.rod.tip()];
                format!(
                    "; the nearest tip that can be held is [{:.4}, {:.4}, {:.4}] m, {distance:.2e} m from it",
                    x.x, x.y, x.z
                )
            });
            return refuse(format!(
                "the arm cannot stay there: {}{nearest}",
                reason(&why)
            ));
        }
        Ok(Holding::NotFound { why }) => {
            return refuse(format!("nothing was found that holds the arm there: {why}"));
        }
        Err(HoldingError::Stopped(stop)) => {
            return Err(DiscretizeError::Start(EquilibriumError::Stopped(stop)));
        }
        Err(error) => return refuse(error.to_string()),
    };
    let (tip, last) = (problem.rod.tip(), problem.grid.n_steps);
    let goal = (problem.goals.iter())
        .position(|goal| goal.node == tip && goal.time_node == last)
        .unwrap_or(0);
    let seconds = (staying.seconds).or_else(|| {
        held.first_frequency
            .map(|frequency| std::f64::consts::TAU / frequency)
    });
    let distance = staying.distance(length);
    match seconds.and_then(|seconds| Stay::at(&problem.rod, held, [seconds, distance], goal)) {
        Some(stay) => Ok(stay),
        None => refuse("the equilibrium there is hardly stable".into()),
    }
}

fn reason(why: &CannotHold) -> String {
    match why {
        CannotHold::NothingActuated => "nothing is actuated, and it rests elsewhere".into(),
        CannotHold::TooFewControls {
            controls,
            equations,
        } => format!("{controls} independent controls hold no {equations} coordinates of a target"),
        CannotHold::AboveBounds(held) => format!(
            "what holds it is above the bounds by {}",
            in_words(&held.excess)
        ),
        CannotHold::Unstable(held) => match held.growth_rate {
            Some(rate) => {
                format!("its equilibrium there is unstable, deviations grow as exp({rate:.2} t)")
            }
            None => "its equilibrium there is not stable".into(),
        },
    }
}

/// The largest excess over bounds, "1.2 N and 0.3 N m".
fn in_words(excess: &[[f64; 2]]) -> String {
    let largest = |part: usize| excess.iter().map(|e| e[part]).fold(0.0, f64::max);
    let parts: Vec<String> = [(largest(0), "N"), (largest(1), "N m")]
        .into_iter()
        .filter(|(size, _)| *size > 0.0)
        .map(|(size, unit)| format!("{size:.3e} {unit}"))
        .collect();
    parts.join(" and ")
}
