//! Why a controller cannot be made, or a sample fails.

use crate::mechanics::StepError;
use crate::stop::Stop;
use crate::task::DiscretizeError;

/// What a [`Controller`](super::Controller) refuses.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MpcError {
    /// The task cannot be discretized.
    #[error(transparent)]
    Discretize(#[from] DiscretizeError),
    /// A setting out of range.
    #[error("{name}: {value} is not {expected}")]
    Setting {
        /// Its name.
        name: &'static str,
        /// What was given.
        value: f64,
        /// What it must be.
        expected: &'static str,
    },
    /// The course of the controls within a block.
    #[error(
        "hold: a moving horizon takes constant or linear blocks, not cubic ones; choose one of these"
    )]
    Hold,
    /// The task has something that the controller does not know.
    #[error("{0}")]
    Unsupported(&'static str),
    /// A path that is none.
    #[error("point {point} of the path: expected {expected}")]
    Path {
        /// The first point that is wrong.
        point: usize,
        /// What it must be.
        expected: &'static str,
    },
    /// A measured state that is not finite, or of another size than the model's.
    #[error("the measured state has {found}; give {expected}")]
    Measurement {
        /// What is wrong with it.
        found: String,
        /// What is expected.
        expected: String,
    },
    /// The model's motion under the plan breaks down.
    #[error("the predicted motion breaks down: {0}")]
    Rollout(#[from] StepError),
    /// Whoever makes or runs a loop was asked to stop, or has no time left.
    #[error("{0}")]
    Stopped(#[from] Stop),
    /// The Hessian of the subproblem has no Cholesky factor, which only happens where something is not finite.
    #[error("the subproblem is not finite or not convex")]
    Subproblem,
}
