//! Estimators: the state of the model, and what disturbs it, from what sensors say.
//!
//! An estimator lives at the time of the last measurement that it has used. A sample of the loop goes
//!
//! ```text
//! until the time at which the measurement was true:   advance(command, min(command.end, time))    for every command that acted since
//!                                                     correct(measurement)
//! until the instant at which the next command acts:   a Predictor, from the estimate, under the commands that were sent
//! ```
//!
//! so that a measurement that is known late corrects the state at the time at which it was true.
//!
//! **Order.** A measurement must be of the time at which the estimator is. One that is older than what the estimator has used is refused with
//! [`EstimateError::Late`], and one to whose time the estimator has not been advanced with [`EstimateError::Ahead`]; both leave the
//! estimator as it was. Where several sensors have different ages, hold back what is known early until nothing older can arrive: an
//! [`Inbox`] does that. Measurements of the same instant may be used one after the other.

use nalgebra::Vector3;

use super::controller::Command;
use super::error::MpcError;
use super::sensor::state_fits;
use super::signal::Measurement;
use crate::mechanics::{Rod, State, StepError, Wrench};

mod comparison;
mod covariance;
mod gate;
mod inbox;
mod kalman;
mod node_frames;
mod observer;
mod parameter;
mod prediction;
mod readings;
mod regridded;
mod slow;
mod unknown_forces;

pub use self::inbox::Inbox;
pub use self::kalman::{KalmanFilter, KalmanSettings, RandomWalk};
pub use self::observer::{BoundaryObserver, ObserverSettings};
pub(in crate::mpc) use self::parameter::ModelParameters;
use self::parameter::Parameter;
pub use self::prediction::Predictor;
pub(super) use self::readings::{Kind, Reader};
pub use self::regridded::Regridded;

/// What acts on the arm, or is wrong with its model, beyond what the model knows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disturbance {
    /// At the tip: force (spatial, N) and moment (body frame, N m).
    pub tip: Wrench,
    /// Force per rest length all along the arm, spatial, N/m.
    pub distributed: Vector3<f64>,
    /// Factor on the model's elastic moduli; 1: those of the model.
    pub stiffness: f64,
    /// Mass at the tip beyond the model's own, kg: it has weight and inertia, and no rotary inertia.
    pub payload: f64,
    /// Viscous damping beyond the model's own, 1/s.
    pub viscous: f64,
    /// Time of the internal damping beyond the model's own, s.
    pub internal: f64,
    /// By how much later commands act than they are said to, s.
    pub delay: f64,
}

impl Disturbance {
    /// An undisturbed arm that is its model.
    pub const NONE: Self = Self {
        tip: Wrench {
            force: Vector3::new(0.0, 0.0, 0.0),
            moment: Vector3::new(0.0, 0.0, 0.0),
        },
        distributed: Vector3::new(0.0, 0.0, 0.0),
        stiffness: 1.0,
        payload: 0.0,
        viscous: 0.0,
        internal: 0.0,
        delay: 0.0,
    };

    /// Adds its wrenches to `wrenches`, one a node of the rod: that at the tip, and of the distributed force what acts on a node's halves of
    /// the elements beside it.
    pub fn add_to(&self, rod: &Rod, wrenches: &mut [Wrench]) {
        for (q, element) in rod.elements.iter().enumerate() {
            let share = self.distributed * (0.5 * element.length);
            wrenches[q].force += share;
            wrenches[q + 1].force += share;
        }
        let tip = &mut wrenches[rod.tip()];
        tip.force += self.tip.force;
        tip.moment += self.tip.moment;
    }

    /// Gives `rod`, a copy of `model`, what is wrong with the model: the stiffness times its factor, the payload and both kinds of damping.
    pub fn change_model(&self, model: &Rod, rod: &mut Rod) {
        rod.take_stiffness(model, self.stiffness);
        let tip = model.tip();
        rod.nodes[tip].mass = model.nodes[tip].mass + self.payload;
        rod.viscous_damping = model.viscous_damping + self.viscous;
        rod.internal_damping = model.internal_damping + self.internal;
    }

    /// What [`change_model`](Self::change_model) takes from it: equal numbers make equal models.
    pub(in crate::mpc) fn parameters(&self) -> ModelParameters {
        Parameter::OF_THE_MODEL.map(|parameter| parameter.of(self))
    }
}

impl Default for Disturbance {
    fn default() -> Self {
        Self::NONE
    }
}

/// What is known at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// The instant, s: that of the last measurement used, or where the estimator has been advanced to since.
    pub time: f64,
    /// On the nodes of the model.
    pub state: State,
    /// What disturbs the arm; [`Disturbance::NONE`] in what is not estimated.
    pub disturbance: Disturbance,
    /// Standard deviation of every component of the disturbance, in its unit; 0 in what is not estimated.
    pub deviation: Disturbance,
}

/// How a measurement compared with what was expected.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Innovation {
    /// Numbers that were used, three a signal.
    pub n: usize,
    /// Root of the mean square of measured minus expected, each over its own standard deviation; 0 where nothing was used.
    pub rms: f64,
    /// `eᵀ S⁻¹ e`, `S` the covariance that the estimator expects of the innovation `e`: distributed as chi-square with `n` degrees of freedom
    /// where the estimator is consistent. `None` for an estimator without covariance.
    pub normalized: Option<f64>,
    /// Distance of the measured from the expected position nearest to the tip, m; `None` where no position was measured.
    pub distance: Option<f64>,
    /// Signals that were refused because they cannot be true, and are not among the `n` numbers.
    pub refused: usize,
}

/// Why an estimator refuses something; it is left as it was.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EstimateError {
    /// A number that is not finite.
    #[error("{what} is not finite; leave it out")]
    NotFinite {
        /// What it is part of.
        what: String,
    },
    /// A signal that cannot be.
    #[error("signal {index}: {name} is {value}, not {expected}")]
    Signal {
        /// Its place among the signals of the measurement.
        index: usize,
        /// What of it.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        expected: &'static str,
    },
    /// A measurement older than what has been used.
    #[error(
        "a measurement of t = {time} s came after the estimate had gone to {estimate} s; hold back what is known early (Inbox) or drop it"
    )]
    Late {
        /// When it was true, s.
        time: f64,
        /// Where the estimator is, s.
        estimate: f64,
    },
    /// A measurement to whose time the estimator has not been advanced, or an advance that would go back.
    #[error(
        "t = {time} s is not where the estimate is, {estimate} s; advance it with the commands that were sent"
    )]
    Ahead {
        /// When it was true, s.
        time: f64,
        /// Where the estimator is, s.
        estimate: f64,
    },
    /// A command that ends before it starts, or at once.
    #[error("the command ends at {end} s, and that is not after its start at {start} s")]
    Span {
        /// Its start, s.
        start: f64,
        /// Its end, s.
        end: f64,
    },
    /// A command on a node that the model does not have.
    #[error("the command acts on node {node}, and the model has nodes 0 to {}", n_nodes - 1)]
    Node {
        /// The node.
        node: usize,
        /// Nodes of the model.
        n_nodes: usize,
    },
    /// Signals of which the estimator can use none.
    #[error("the estimator can use none of the signals: {expected}")]
    Unusable {
        /// What it can use.
        expected: &'static str,
    },
    /// The model's motion breaks down.
    #[error("the motion of the estimate breaks down: {0}")]
    Motion(#[from] StepError),
    /// The covariance of the innovation has no Cholesky factor.
    #[error("the covariance of the innovation is not positive definite; restart the estimator")]
    Singular,
}

/// Keeps an estimate of the arm's state, and of what disturbs it.
///
/// After an error the estimate is the one before the call.
pub trait Estimator {
    /// Goes on to `until` (s) under a command that acts from the estimate's time to then; a command is constant before its start and after its
    /// end. Call it once for every command that acted. Nothing happens where the estimate is there already, to rounding.
    ///
    /// # Errors
    /// [`EstimateError::Ahead`] where `until` lies before the estimate's time, [`EstimateError::NotFinite`], [`EstimateError::Span`] and
    /// [`EstimateError::Node`] for a command that is none, and [`EstimateError::Motion`].
    fn advance(&mut self, command: &Command, until: f64) -> Result<(), EstimateError>;

    /// Corrects the estimate by a measurement of its time.
    ///
    /// # Errors
    /// [`EstimateError`] for a measurement that is not finite, of another time, or of no use.
    fn correct(&mut self, measurement: &Measurement) -> Result<Innovation, EstimateError>;

    /// The present estimate.
    fn estimate(&self) -> &Estimate;

    /// Forgets everything, and starts anew at `time` (s) from `state`, on the nodes of the model: what follows is the same as with a new
    /// estimator.
    ///
    /// # Errors
    /// [`MpcError::Measurement`] for a state that is not finite or of another size, and [`MpcError::Setting`] for such a time.
    fn restart(&mut self, time: f64, state: &State) -> Result<(), MpcError>;
}

/// Part of a second by which times that are the same may differ.
const SAME_TIME: f64 = 1e-9;

/// Whether a measurement is of the time at which an estimate is.
fn check_time(time: f64, estimate: f64) -> Result<(), EstimateError> {
    let ahead = time - estimate;
    if !ahead.is_finite() {
        let what = "the time of the measurement".into();
        Err(EstimateError::NotFinite { what })
    } else if ahead.abs() <= SAME_TIME * (1.0 + estimate.abs()) {
        Ok(())
    } else if ahead < 0.0 {
        Err(EstimateError::Late { time, estimate })
    } else {
        Err(EstimateError::Ahead { time, estimate })
    }
}

/// Whether an estimate may start from a state.
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
