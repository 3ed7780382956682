//! Settings of the Kalman filter.

use super::super::parameter::N_PARAMETERS;
use super::super::setting;
use crate::error::MpcError;
use mechanics::Rod;
use mechanics::stability::automatic_step;

/// A quantity whose components change as random walks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RandomWalk {
    /// Standard deviation at the start, in the unit of the quantity.
    pub initial: f64,
    /// Standard deviation of its change within one second; 0 for a constant.
    pub change: f64,
}

/// Settings of a [`KalmanFilter`](super::KalmanFilter). A disturbance that is `None` is not estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KalmanSettings {
    /// Uncertainty of the state at the start, as a standard deviation of the tip's position, m. Every mode of motion has the same energy,
    /// that of a cantilever with this deflection of its tip: the covariance is `3 EI/L³ σ²` times the inverse of the Hessian of the energy.
    pub initial: f64,
    /// Strength of unknown forces, as the standard deviation of the tip's position that they cause within one second, m: white noise in
    /// time on the momenta, mostly smooth along the arm. A mode of frequency `ν` gains `3 EI/L³ σ² ((ω₁/ν)² + 0.1)`, with `ω₁` the
    /// frequency of the first bending mode.
    pub change: f64,
    /// Force at the tip, N.
    pub tip_force: Option<RandomWalk>,
    /// Moment at the tip, N m.
    pub tip_moment: Option<RandomWalk>,
    /// Distributed force, N/m.
    pub distributed: Option<RandomWalk>,
    /// Factor on the elastic moduli. Estimates are limited to 0.1 to 1.6, where the explicit scheme with the automatic step is stable.
    pub stiffness: Option<RandomWalk>,
    /// Mass at the tip beyond the model's, kg. The payload is limited to between nothing and ten times the mass of the arm.
    pub payload: Option<RandomWalk>,
    /// Viscous damping beyond the model's, 1/s. The damping is limited to between none and 50 divided by the time scale of the arm, `L²
    /// sqrt(ρA/EI)`.
    pub viscous: Option<RandomWalk>,
    /// Time of the internal damping beyond the model's, s; only for a model with implicit steps. The damping time is limited to between
    /// zero and a tenth of the time scale of the arm.
    pub internal: Option<RandomWalk>,
    /// Delay of commands beyond their known delay, s. It is limited to a tenth of the time scale of the arm.
    pub delay: Option<RandomWalk>,
    /// Tells whether impossible signals are refused: those whose squared innovation, normalized by the covariance that the filter expects,
    /// exceeds that of all but one in 10⁹ (chi-square, three degrees of freedom; Bar-Shalom, Li and Kirubarajan 2001, section 5.4). If
    /// recent signals are all farther off than expected, by their median (Hampel 1974), the model is wrong, and the threshold is multiplied
    /// by as much. A signal that is refused three consecutive times is accepted afterwards: then the estimate is wrong.
    pub refuses: bool,
    /// Tells whether sensors are taken to be no more exact than the elements of the model, as an arm that is not the model demands
    /// (decision 116).
    pub model_error: bool,
    /// Longest time step of the model, s.
    pub longest_step: f64,
}

impl KalmanSettings {
    /// Returns settings that estimate the state only: the tip is within a twentieth of the length at the start, and unknown forces deflect
    /// it by 3 thousandths within a second, which is about the error of ten elements for a swinging arm.
    #[must_use]
    pub fn of(model: &Rod) -> Self {
        Self {
            initial: INITIAL * model.scales.length,
            change: CHANGE * model.scales.length / model.scales.time.sqrt(),
            tip_force: None,
            tip_moment: None,
            distributed: None,
            stiffness: None,
            payload: None,
            viscous: None,
            internal: None,
            delay: None,
            refuses: false,
            model_error: false,
            longest_step: automatic_step(model),
        }
    }

    /// Returns the random walks of tip force, tip moment and distributed force.
    pub(super) fn wrench_walks(&self) -> [Option<RandomWalk>; 3] {
        [self.tip_force, self.tip_moment, self.distributed]
    }

    /// Returns the random walks of [`Parameter::ALL`](crate::estimator::Parameter::ALL).
    pub(super) fn parameter_walks(&self) -> [Option<RandomWalk>; N_PARAMETERS] {
        [
            self.stiffness,
            self.payload,
            self.viscous,
            self.internal,
            self.delay,
        ]
    }

    /// Refuses unknowns that change no motion because the tip is held.
    pub(super) fn check_tip(&self, model: &Rod) -> Result<(), MpcError> {
        let tip = model.joint(model.tip());
        if tip.is_some() && (self.tip_force.is_some() || self.payload.is_some()) {
            return Err(MpcError::Unsupported(
                "neither a force nor a mass on a tip that is held moves the arm, so that no filter finds them; leave tip_force and payload out, \
                 and take distributed for what pushes",
            ));
        }
        if tip.is_some_and(|joint| !joint.turns()) && self.tip_moment.is_some() {
            return Err(MpcError::Unsupported(
                "no moment on a clamped or driven tip moves the arm, so that no filter finds it; leave tip_moment out",
            ));
        }
        Ok(())
    }

    pub(super) fn check(&self) -> Result<(), MpcError> {
        let at_least_zero =
            |name, value: f64| setting(name, value, value >= 0.0, "a finite number of at least 0");
        let positive =
            |name, value: f64| setting(name, value, value > 0.0, "a positive finite number");
        positive("longest_step", self.longest_step)?;
        positive("initial", self.initial)?;
        at_least_zero("change", self.change)?;
        let names = [
            "tip_force",
            "tip_moment",
            "distributed",
            "stiffness",
            "payload",
            "viscous",
            "internal",
            "delay",
        ];
        let walks = (self.wrench_walks().into_iter()).chain(self.parameter_walks());
        for (name, walk) in names.into_iter().zip(walks) {
            if let Some(walk) = walk {
                at_least_zero(name, walk.initial)?;
                at_least_zero(name, walk.change)?;
            }
        }
        Ok(())
    }
}

/// Default standard deviations of the tip's distance at the start and of the deflection that unknown forces cause within the time scale of
/// the arm, divided by the length, which [`KalmanSettings::initial`] and [`KalmanSettings::change`] expose.
const INITIAL: f64 = 0.05;
const CHANGE: f64 = 0.003;
