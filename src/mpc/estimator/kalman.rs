//! An extended Kalman filter on the full state, in the tangent of the integrator.

use faer::Mat;

use crate::mechanics::{Rod, State};
use crate::mpc::controller::Command;
use crate::mpc::error::MpcError;
use crate::mpc::signal::Measurement;

use super::{Estimate, EstimateError, Estimator, Innovation};

/// A quantity that changes at random: each of its components.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RandomWalk {
    /// Standard deviation at the start, in the unit of the quantity.
    pub initial: f64,
    /// Standard deviation of its change within one second; 0: a constant.
    pub change: f64,
}

/// What a [`KalmanFilter`] expects. A disturbance that is `None` is not estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KalmanSettings {
    /// Standard deviation of the tip's position at the start, m. The deviation is spread over all motions with equal energy each: that of
    /// a cantilever whose tip is off by as much, `½ (3 EI/L³) σ²` for every position and for every momentum.
    pub initial: f64,
    /// The same for what forces that nobody knows add within one second, m: white noise on all momenta.
    pub change: f64,
    /// Force at the tip, N.
    pub tip_force: Option<RandomWalk>,
    /// Moment at the tip, N m.
    pub tip_moment: Option<RandomWalk>,
    /// Distributed force, N/m.
    pub distributed: Option<RandomWalk>,
    /// Factor on the elastic moduli.
    pub stiffness: Option<RandomWalk>,
    /// Longest time step of the model, s.
    pub longest_step: f64,
}

impl KalmanSettings {
    /// Estimates the state only.
    #[must_use]
    pub fn of(model: &Rod) -> Self {
        todo!("{model:?}")
    }
}

/// An extended Kalman filter whose error is `(δx, ζ, δp, δπ)` of every free node, as the [difference](State::difference) of states has
/// it, and that of the disturbances.
#[derive(Debug)]
pub struct KalmanFilter {
    estimate: Estimate,
    covariance: Mat<f64>,
}

impl KalmanFilter {
    /// A filter that is at `time` (s) in `state`, on the nodes of `model`.
    ///
    /// # Errors
    /// [`MpcError::Setting`] for a setting out of range, [`MpcError::Measurement`] for a state of another size or that is not finite.
    pub fn new(
        model: &Rod,
        time: f64,
        state: &State,
        settings: &KalmanSettings,
    ) -> Result<Self, MpcError> {
        todo!("{model:?} {time} {state:?} {settings:?}")
    }

    /// Covariance of the error: of `(δx, ζ, δp, δπ)` of every free node, node by node, then of those disturbances that are estimated: tip force,
    /// tip moment, distributed force, stiffness.
    #[must_use]
    pub fn covariance(&self) -> &Mat<f64> {
        &self.covariance
    }
}

impl Estimator for KalmanFilter {
    fn advance(&mut self, command: &Command, until: f64) -> Result<(), EstimateError> {
        todo!("{command:?} {until}")
    }

    fn correct(&mut self, measurement: &Measurement) -> Result<Innovation, EstimateError> {
        todo!("{measurement:?}")
    }

    fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    fn restart(&mut self, time: f64, state: &State) {
        todo!("{time} {state:?}")
    }
}
