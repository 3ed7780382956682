//! Estimators: the state of the model and its disturbances, from the measurements of sensors.
//!
//! The time of an estimator is that of the last measurement that it has used. A sample of the loop runs
//!
//! ```text
//! until the time at which the measurement was true:   advance(command, min(command.end, time))    for every command that acted since
//!                                                     correct(measurement)
//! until the instant at which the next command acts:   a Predictor, from the estimate, under the commands that were sent
//! ```
//!
//! so that a measurement that is known late corrects the state at its own time.
//!
//! **Order.** The time of a measurement must be that of the estimator. A measurement older than the estimator is refused with
//! [`EstimateError::Late`], and one to whose time the estimator has not been advanced with [`EstimateError::Ahead`]; both leave the
//! estimator unchanged. If several sensors have different ages, early measurements must wait until nothing older can arrive; an [`Inbox`]
//! does that. Measurements of the same time may be used one after the other.

use super::command::Command;
use super::error::{MpcError, state_fits};
use super::signal::Measurement;
use control::rounding_of;
use mechanics::{Rod, State, StepError};

pub(super) mod comparison;
mod covariance;
mod disturbance;
pub mod gate;
mod inbox;
mod kalman;
mod motions;
mod node_frames;
mod prediction;
mod readings;
mod regridded;
mod slow;
mod unknown;
mod unknown_forces;

pub use self::disturbance::Disturbance;
pub(crate) use self::disturbance::ModelParameters;
pub use self::inbox::Inbox;
pub use self::kalman::{KalmanFilter, KalmanSettings, RandomWalk};
pub(crate) use self::motions::Motions;
pub use self::prediction::Predictor;
pub(super) use self::readings::Reader;
pub use self::regridded::Regridded;
pub use self::unknown::{N_COMPONENTS, N_UNKNOWNS, Needs, Unknown, UnknownRow};

/// The estimate at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// Time, s: that of the last measurement used, or the later one to which the estimator has been advanced.
    pub time: f64,
    /// State on the nodes of the model.
    pub state: State,
    /// Disturbance; the values of [`Disturbance::NONE`] where it is not estimated.
    pub disturbance: Disturbance,
    /// Standard deviation of every component of the disturbance, in its unit; 0 where it is not estimated.
    pub deviation: Disturbance,
}

/// Result of the comparison of a measurement with its prediction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Innovation {
    /// Number of values used, three for each signal.
    pub n: usize,
    /// Root mean square of measured minus expected, each divided by its standard deviation; 0 if no signal was used.
    pub rms: f64,
    /// `eᵀ S⁻¹ e`, with `S` the expected covariance of the innovation `e`: distributed as chi-square with `n` degrees of freedom if the
    /// estimator is consistent. `None` for an estimator without covariance.
    pub normalized: Option<f64>,
    /// Distance between the measured and the expected position nearest to the tip, m; `None` without a measured position.
    pub distance: Option<f64>,
    /// Number of signals that were refused as impossible and do not count in `n`.
    pub refused: usize,
}

/// The reason why an estimator refuses a call, after which it is unchanged.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EstimateError {
    /// A number is not finite.
    #[error("{what} is not finite; leave it out")]
    NotFinite {
        /// Quantity of the number.
        what: String,
    },
    /// A signal is impossible.
    #[error("signal {index}: {name} is {value}, not {expected}")]
    Signal {
        /// Index of the signal in the measurement.
        index: usize,
        /// Property of the signal.
        name: &'static str,
        /// Value of the property.
        value: f64,
        /// Allowed values.
        expected: &'static str,
    },
    /// The measurement is older than one that was used.
    #[error(
        "a measurement of t = {time} s came after the estimate had gone to {estimate} s; hold early measurements back (Inbox) or drop this one"
    )]
    Late {
        /// Time of the measurement, s.
        time: f64,
        /// Time of the estimate, s.
        estimate: f64,
    },
    /// The estimator has not been advanced to the time of the measurement, or an advance would go back in time.
    #[error(
        "t = {time} s is not where the estimate is, {estimate} s; advance it with the commands that were sent"
    )]
    Ahead {
        /// Time of the measurement, s.
        time: f64,
        /// Time of the estimate, s.
        estimate: f64,
    },
    /// A command does not end after its start.
    #[error("the command ends at {end} s, and that is not after its start at {start} s")]
    Span {
        /// Start of the command, s.
        start: f64,
        /// End of the command, s.
        end: f64,
    },
    /// A command has another number of values than controls.
    #[error("the command has {given} values for {n_controls} controls: give one for each")]
    Values {
        /// Number of values.
        given: usize,
        /// Number of controls in the list of the command.
        n_controls: usize,
    },
    /// A command acts on an actuator that the model does not have.
    #[error(
        "the command acts on the actuator of index {actuator}, and the model has {n_actuators}"
    )]
    Actuator {
        /// Index of the actuator.
        actuator: usize,
        /// Number of actuators of the model.
        n_actuators: usize,
    },
    /// A command acts on a node that the model does not have.
    #[error("the command acts on node {node}, and the model has nodes 0 to {}", n_nodes - 1)]
    Node {
        /// Index of the node.
        node: usize,
        /// Number of nodes of the model.
        n_nodes: usize,
    },
    /// The estimator can use none of the signals.
    #[error("the estimator can use none of the signals: {expected}")]
    Unusable {
        /// Signals that it can use.
        expected: &'static str,
    },
    /// The model's motion breaks down.
    #[error("the motion of the estimate breaks down: {0}")]
    Motion(#[from] StepError),
    /// The covariance of the innovation has no Cholesky factor.
    #[error("the covariance of the innovation is not positive definite; restart the estimator")]
    Singular,
}

/// An estimator of the arm's state and of its disturbances.
///
/// After an error the estimate is that before the call.
pub trait Estimator: Send + Sync {
    /// Advances to `until` (s) under a command that acts from the estimate's time to then; a command is constant before its start and after
    /// its end. Call it once for every command that acted. It does nothing if the estimate is at that time already, up to rounding.
    ///
    /// # Errors
    /// Returns [`EstimateError::Ahead`] if `until` is before the estimate's time, [`EstimateError::NotFinite`], [`EstimateError::Span`] and
    /// [`EstimateError::Node`] for an invalid command, and [`EstimateError::Motion`].
    fn advance(&mut self, command: &Command, until: f64) -> Result<(), EstimateError>;

    /// Corrects the estimate by a measurement of its time.
    ///
    /// # Errors
    /// Returns [`EstimateError`] for a measurement that is not finite, of another time, or of no use.
    fn correct(&mut self, measurement: &Measurement) -> Result<Innovation, EstimateError>;

    /// Returns the present estimate.
    fn estimate(&self) -> &Estimate;

    /// Discards everything and restarts at `time` (s) from `state`, on the nodes of the model, as a new estimator would.
    ///
    /// # Errors
    /// Returns [`MpcError::Measurement`] for a state that is not finite or of another size, and [`MpcError::Setting`] for such a time.
    fn restart(&mut self, time: f64, state: &State) -> Result<(), MpcError>;
}

/// Checks that the time of a measurement is that of an estimate.
fn check_time(time: f64, estimate: f64) -> Result<(), EstimateError> {
    let ahead = time - estimate;
    if !ahead.is_finite() {
        let what = "the time of the measurement".into();
        Err(EstimateError::NotFinite { what })
    } else if ahead.abs() <= rounding_of(estimate) {
        Ok(())
    } else if ahead < 0.0 {
        Err(EstimateError::Late { time, estimate })
    } else {
        Err(EstimateError::Ahead { time, estimate })
    }
}

/// Checks that an estimate may start from a state.
fn check_start(model: &Rod, time: f64, state: &State) -> Result<(), MpcError> {
    setting("time", time, true, "a finite number")?;
    state_fits(state, model)?;
    let at = &state.configuration;
    let vectors = (at.positions.iter())
        .chain(&state.linear_momentum)
        .chain(&state.angular_momentum)
        .all(|v| v.iter().all(|c| c.is_finite()));
    if vectors && (at.rotations.iter()).all(|r| r.iter().all(|c| c.is_finite())) {
        return Ok(());
    }
    Err(MpcError::Measurement {
        found: "a number that is not finite".into(),
        expected: "finite positions, rotations and momenta".into(),
    })
}

fn setting(
    name: &'static str,
    value: f64,
    holds: bool,
    expected: &'static str,
) -> Result<(), MpcError> {
    if value.is_finite() && holds {
        Ok(())
    } else {
        Err(MpcError::Setting {
            name,
            value,
            expected,
        })
    }
}
