//! The verdict on a target that should be held.

use crate::held::Held;
use mechanics::equilibrium::EquilibriumError;
use stop::Stop;

/// Verdict on the existence of a wrench within the bounds that holds the node of the goal there.
#[derive(Clone, Debug, PartialEq)]
pub enum Holding {
    /// There is one.
    Held(Box<Held>),
    /// There is none.
    CannotBeHeld {
        /// The reason.
        why: CannotHold,
        /// The nearest target that was found to be held, and the distance of its node from the goal, m.
        nearest: Option<(Box<Held>, f64)>,
    },
    /// No such wrench was found, which proves nothing.
    NotFound {
        /// The reason why the search ended.
        why: NotFound,
        /// The nearest target that was found to be held, and the distance of its node from the goal, m.
        nearest: Option<(Box<Held>, f64)>,
    },
}

impl Holding {
    /// Returns the nearest target that was found to be held where the goal itself is not, and the distance of its node from the goal, m.
    #[must_use]
    pub fn nearest(&self) -> Option<&(Box<Held>, f64)> {
        match self {
            Self::Held(_) => None,
            Self::CannotBeHeld { nearest, .. } | Self::NotFound { nearest, .. } => nearest.as_ref(),
        }
    }
}

/// The reason why a target cannot be held.
#[derive(Clone, Debug, PartialEq)]
pub enum CannotHold {
    /// Nothing is actuated, and the arm rests elsewhere.
    NothingActuated,
    /// The goal has more equations than there are independent controls.
    TooFewControls {
        /// Number of independent controls.
        controls: usize,
        /// Number of equations.
        equations: usize,
    },
    /// The target is held only by controls beyond their bounds; the controls nearest to the bounds are given.
    AboveBounds(Box<Held>),
    /// The equilibrium at the target is unstable.
    Unstable(Box<Held>),
    /// Loads accelerate a free arm.
    Drifts,
    /// A driven end still moves while the arm should stay.
    EndMoves {
        /// `"base"` or `"tip"`.
        end: &'static str,
        /// Last time after the task at which it moves, s.
        after: f64,
    },
}

impl std::fmt::Display for CannotHold {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NothingActuated => write!(f, "nothing is actuated, and the arm rests elsewhere"),
            Self::TooFewControls {
                controls,
                equations,
            } => write!(
                f,
                "{controls} independent controls cannot meet the {equations} equations of this goal"
            ),
            Self::AboveBounds(_) => {
                write!(f, "the wrench that holds it there is beyond the bounds")
            }
            Self::Drifts => write!(
                f,
                "the base is free, and loads move the arm on where no wrench acts"
            ),
            Self::EndMoves { end, after } => write!(
                f,
                "the {end} still moves {after:.3e} s after the task: let it stand before task.at_s"
            ),
            Self::Unstable(held) => match held.growth_rate {
                Some(rate) => write!(
                    f,
                    "the equilibrium there is unstable: with the wrench held, deviations grow e-fold in {:.3e} s",
                    rate.recip()
                ),
                None => write!(
                    f,
                    "the equilibrium there is neutral: nothing brings the arm back"
                ),
            },
        }
    }
}

/// The reason why the search found neither a wrench that holds the target nor a proof that there is none.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NotFound {
    /// A free arm may rest in any pose.
    #[error(
        "the base is free, so that the arm may rest in any pose: name task.position_m and task.orientation_wxyz"
    )]
    FreeBase,
    /// Between ball joints, and between one and a free end, all sections may turn about their own axes.
    #[error(
        "an end is pinned by a ball joint and no other end holds the arm from turning: all sections may turn about their own axes, and \
         nothing brings them back"
    )]
    LooseEnds,
    /// The search would take too long.
    #[error("too many elements or actuators for a search that takes about a second")]
    TooLarge,
    /// No shape with the node at the goal was found.
    #[error("no shape at rest that is there: {0}")]
    Equilibrium(EquilibriumError),
    /// The equilibria that were found at the goal are unstable; there may be others. The one is given whose deviations grow least.
    #[error("the equilibria that were found there are unstable{}", growth_in_words(.0))]
    Unstable(Box<Held>),
    /// The search for controls within the bounds did not reach the goal.
    #[error("controls within their bounds that put the arm there at rest were not found")]
    Bounds,
}

fn growth_in_words(held: &Held) -> String {
    held.growth_rate.map_or_else(String::new, |rate| {
        format!(
            ": with the controls held, deviations grow e-fold in {:.3e} s",
            rate.recip()
        )
    })
}

/// The reason why no search was made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum HoldingError {
    /// No node has a goal for position or orientation at the end.
    #[error("no node has a goal at the end")]
    NoGoal,
    /// A stop signal ended the search.
    #[error("stopped before it was known whether the target can be held: {0}")]
    Stopped(#[from] Stop),
}
