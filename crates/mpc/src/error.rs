//! Errors of the construction of a controller and of its samples.

use mechanics::{Rod, State, StepError};
use stop::Stop;
use task::DiscretizeError;

/// The reason why a [`Controller`](super::Controller) fails.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MpcError {
    /// The task cannot be discretized.
    #[error(transparent)]
    Discretize(#[from] DiscretizeError),
    /// A setting is out of range.
    #[error("{name}: {value} is not {expected}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// Given value.
        value: f64,
        /// Allowed values.
        expected: &'static str,
    },
    /// The integrator of the estimator's model cannot take its steps.
    #[error("estimator: {0}")]
    EstimatorStep(#[source] DiscretizeError),
    /// The hold of the controls is not supported.
    #[error(
        "hold: a moving horizon takes constant or linear blocks, not cubic ones; choose one of these"
    )]
    Hold,
    /// The task has a feature that the controller does not support.
    #[error("{0}")]
    Unsupported(&'static str),
    /// The points of a path are invalid.
    #[error("point {point} of the path: expected {expected}")]
    Path {
        /// The first invalid point.
        point: usize,
        /// Requirement on it.
        expected: &'static str,
    },
    /// A disturbance that was estimated elsewhere is not finite or beyond its range, or its kind is not known here.
    #[error("{name}: {found}; give {expected}")]
    Disturbance {
        /// Name of the number in the lines of a served loop.
        name: &'static str,
        /// Content of the number.
        found: String,
        /// Requirement on it.
        expected: String,
    },
    /// A measured state is not finite, or of another size than the model's.
    #[error("the measured state has {found}; give {expected}")]
    Measurement {
        /// Content of the state.
        found: String,
        /// Requirement on it.
        expected: String,
    },
    /// The model's motion under the plan breaks down.
    #[error("the predicted motion breaks down: {0}")]
    Rollout(#[from] StepError),
    /// A stop signal or a deadline ended the work.
    #[error("{0}")]
    Stopped(#[from] Stop),
    /// The Hessian of the subproblem has no Cholesky factor, which happens only if a value is not finite.
    #[error("the subproblem is not finite or not convex")]
    Subproblem,
}

/// Checks that a state has positions, rotations and momenta of every node of a rod.
pub(super) fn state_fits(state: &State, rod: &Rod) -> Result<(), MpcError> {
    let n = rod.n_nodes();
    let sizes = [
        state.configuration.positions.len(),
        state.configuration.rotations.len(),
        state.linear_momentum.len(),
        state.angular_momentum.len(),
    ];
    if sizes == [n; 4] {
        return Ok(());
    }
    Err(MpcError::Measurement {
        found: format!("{sizes:?} positions, rotations, linear and angular momenta"),
        expected: format!("{n} of each, one a node of the rod"),
    })
}
