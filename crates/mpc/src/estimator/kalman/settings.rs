//! Settings of the Kalman filter.

use super::super::setting;
use super::super::unknown::{N_UNKNOWNS, Unknown};
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

impl RandomWalk {
    /// Returns the variance that it gains within a time (s), in the square of the unit of the quantity.
    #[must_use]
    pub fn growth(&self, duration: f64) -> f64 {
        self.change * self.change * duration
    }
}

/// Settings of a [`KalmanFilter`](super::KalmanFilter).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KalmanSettings {
    /// Uncertainty of the state at the start, as a standard deviation of the tip's position, m. Every mode of motion has the same energy,
    /// that of a cantilever with this deflection of its tip: the covariance is `3 EI/L³ σ²` times the inverse of the Hessian of the energy.
    pub initial: f64,
    /// Strength of unknown forces, as the standard deviation of the tip's position that they cause within one second, m: white noise in
    /// time on the momenta, mostly smooth along the arm. A mode of frequency `ν` gains `3 EI/L³ σ² ((ω₁/ν)² + 0.1)`, with `ω₁` the
    /// frequency of the first bending mode.
    pub change: f64,
    /// Random walks of the unknowns, in the order of [`Unknown::TABLE`] and in their units; `None` for one that is not estimated. Estimates
    /// are limited to the ranges of the table: factors on the stiffness of 0.1 to 1.6, where the explicit scheme with the automatic step is
    /// stable; a payload between nothing and ten times the mass of the arm; viscous damping between none and 50 divided by the time scale of
    /// the arm, `L² sqrt(ρA/EI)`; internal damping between none and a tenth of the time scale, and a delay to as much.
    pub walks: [Option<RandomWalk>; N_UNKNOWNS],
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
    /// Longest time by which commands may be found to act earlier than the filter is told, s. Beyond the time for which commands are known ahead, an
    /// estimate of the delay changes nothing, so that no measurement corrects it: a loop knows them for a period and for its lead.
    pub earliest: f64,
}

impl KalmanSettings {
    /// Returns settings that estimate the state only: the tip is within a twentieth of the length at the start, and unknown forces deflect
    /// it by 3 thousandths within a second, which is about the error of ten elements for a swinging arm.
    #[must_use]
    pub fn of(model: &Rod) -> Self {
        Self {
            initial: INITIAL * model.scales.length,
            change: CHANGE * model.scales.length / model.scales.time.sqrt(),
            walks: [None; N_UNKNOWNS],
            refuses: false,
            model_error: false,
            longest_step: automatic_step(model),
            earliest: f64::INFINITY,
        }
    }

    /// Returns the settings with an unknown that is a random walk.
    #[must_use]
    pub fn with(mut self, unknown: Unknown, walk: RandomWalk) -> Self {
        self.walks[unknown as usize] = Some(walk);
        self
    }

    /// Returns the random walk of an unknown; `None` if it is not estimated.
    #[must_use]
    pub fn walk(&self, unknown: Unknown) -> Option<RandomWalk> {
        self.walks[unknown as usize]
    }

    /// Returns which unknowns have components in the filter of a model: those that are estimated and that the model has.
    ///
    /// # Errors
    /// Returns [`MpcError::Unsupported`] for unknowns that change no motion because the tip is held.
    pub(super) fn present(&self, model: &Rod) -> Result<[bool; N_UNKNOWNS], MpcError> {
        let mut out = self.walks.map(|walk| walk.is_some());
        for unknown in Unknown::all().filter(|own| self.walk(*own).is_some()) {
            let needs = unknown.row().needs;
            if !needs.met_by(model) {
                if let Some(reason) = needs.refusal() {
                    return Err(MpcError::Unsupported(reason));
                }
                out[unknown as usize] = false;
            }
        }
        Ok(out)
    }

    pub(super) fn check(&self) -> Result<(), MpcError> {
        let at_least_zero =
            |name, value: f64| setting(name, value, value >= 0.0, "a finite number of at least 0");
        let positive =
            |name, value: f64| setting(name, value, value > 0.0, "a positive finite number");
        positive("longest_step", self.longest_step)?;
        positive("initial", self.initial)?;
        if self.earliest.is_nan() || self.earliest < 0.0 {
            at_least_zero("earliest", self.earliest)?;
        }
        at_least_zero("change", self.change)?;
        for unknown in Unknown::all() {
            if let Some(walk) = self.walk(unknown) {
                at_least_zero(unknown.row().key, walk.initial)?;
                at_least_zero(unknown.row().key, walk.change)?;
            }
        }
        Ok(())
    }
}

/// Default standard deviations of the tip's distance at the start and of the deflection that unknown forces cause within the time scale of
/// the arm, divided by the length, which [`KalmanSettings::initial`] and [`KalmanSettings::change`] expose.
const INITIAL: f64 = 0.05;
const CHANGE: f64 = 0.003;
