//! A boundary observer: the model, with a wrench at the tip that damps its deviation from what is measured there.

use crate::mechanics::{Rod, State};
use crate::mpc::controller::Command;
use crate::mpc::error::MpcError;
use crate::mpc::signal::Measurement;

use super::{Estimate, EstimateError, Estimator, Innovation};

/// Gains of a [`BoundaryObserver`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObserverSettings {
    /// Gain on velocities over the matched impedance of the arm's waves: `sqrt(ρA GA)` across, `sqrt(ρA EA)` along, `sqrt(ρI EI)` for bending,
    /// `sqrt(ρJ GJ)` for twist. There is an optimum: a tip that is held too hard reflects waves as a clamp does.
    pub gain: f64,
    /// Time constant with which the tip would follow the measured pose by itself, s: the gain on poses is that on velocities over it.
    pub follow_time: f64,
    /// Time in which the injected wrench becomes a disturbance at the tip, s; `None`: no disturbance is estimated.
    pub integral_time: Option<f64>,
    /// Longest time step of the model, s.
    pub longest_step: f64,
}

impl ObserverSettings {
    /// What suits most arms.
    #[must_use]
    pub fn of(model: &Rod) -> Self {
        todo!("{model:?}")
    }
}

/// The boundary observer of Zheng et al. (arXiv 2303.06130): a copy of the model with one more tip wrench, in the body frame of the tip
///
/// ```text
/// -Gv (twist_hat - twist) - Gp log(pose⁻¹ pose_hat)
/// ```
///
/// It damps the deviation from the true motion as a matched end of a line absorbs its waves; it has no covariance and is the same on every
/// grid. It uses positions, rotations and velocities that were measured at the tip; what is not measured of a pose is left alone.
///
/// The wrench acts over the time between two measurements, towards the pose between them, so that the estimate at a measurement's time
/// follows from all that was measured until then.
#[derive(Clone, Debug)]
pub struct BoundaryObserver {
    estimate: Estimate,
}

impl BoundaryObserver {
    /// An observer that is at `time` (s) in `state`, on the nodes of `model`.
    ///
    /// # Errors
    /// [`MpcError::Setting`] for a gain or a time out of range, [`MpcError::Measurement`] for a state of another size or that is not finite.
    pub fn new(
        model: &Rod,
        time: f64,
        state: &State,
        settings: &ObserverSettings,
    ) -> Result<Self, MpcError> {
        todo!("{model:?} {time} {state:?} {settings:?}")
    }
}

impl Estimator for BoundaryObserver {
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
