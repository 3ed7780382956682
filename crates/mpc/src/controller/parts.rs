//! Parts of a controller's iteration by themselves.

use faer::Mat;

use super::Controller;
use crate::error::MpcError;
use crate::soft_rows::SoftRows;
use mechanics::linearization::StateTangent;

/// Parts of the iteration of a [`Controller`], which only tests see by themselves. Plans are scaled coefficients of the controls, the first
/// knot first and its components one after the other. Afterwards the controller has the plan and the start that it had.
#[doc(hidden)]
#[derive(Debug)]
pub struct ControllerParts<'a>(&'a mut Controller);

impl Controller {
    /// Returns the parts of the iteration.
    #[doc(hidden)]
    pub fn parts(&mut self) -> ControllerParts<'_> {
        ControllerParts(self)
    }
}

impl ControllerParts<'_> {
    /// Returns the present plan, with room for the longest horizon.
    #[must_use]
    pub fn plan(&self) -> &[f64] {
        &self.0.plan
    }

    /// Returns the number of coefficients of a plan over the present horizon.
    #[must_use]
    pub fn n_coefficients(&self) -> usize {
        self.0.horizon.n_present()
    }

    /// Returns the plan after an iteration from a start that deviates, by the linear term of the prepared model.
    ///
    /// # Errors
    /// Returns [`MpcError::Subproblem`] if the iteration is not finite.
    pub fn corrected(&mut self, deviation: &StateTangent) -> Result<Vec<f64>, MpcError> {
        let controller = &mut *self.0;
        let plan = controller.plan.clone();
        controller.deviation = deviation.clone();
        let outcome = controller.correct();
        controller.deviation.fill_zero();
        let corrected = std::mem::replace(&mut controller.plan, plan);
        outcome.map(|()| corrected)
    }

    /// Returns the plan after an iteration from a start that deviates, by a model that is simulated and linearized anew from there.
    ///
    /// # Errors
    /// Returns [`MpcError::Rollout`] if the motion breaks down, and [`MpcError::Subproblem`] if the iteration is not finite.
    pub fn corrected_anew(&mut self, deviation: &StateTangent) -> Result<Vec<f64>, MpcError> {
        let start = self.0.horizon.start.clone();
        self.0.horizon.start = start.retract(deviation);
        let still = StateTangent::zeros(self.0.rod().n_nodes());
        let outcome = self.0.model().and_then(|()| self.corrected(&still));
        self.0.horizon.start = start;
        self.0.model()?;
        outcome
    }

    /// Returns the residuals of tracks, targets and terms along the motion of a plan, and the rows of limits, which are at most zero where
    /// a limit is kept.
    ///
    /// # Errors
    /// Returns [`MpcError::Rollout`] if the motion breaks down.
    pub fn values(&mut self, plan: &[f64]) -> Result<[Vec<f64>; 2], MpcError> {
        let horizon = &mut self.0.horizon;
        horizon.roll_out(plan)?;
        let mut limits = vec![0.0; horizon.n_limit_rows()];
        let still = StateTangent::zeros(horizon.problem.rod.n_nodes());
        horizon.write_limit_values(&still, &mut limits);
        Ok([horizon.residuals().to_vec(), limits])
    }

    /// Returns the derivatives of both kinds of [`Self::values`] along the coefficients of a plan: one row per value, one column per
    /// coefficient.
    ///
    /// # Errors
    /// Returns [`MpcError::Rollout`] if the motion breaks down or cannot be linearized.
    pub fn slopes(&mut self, plan: &[f64]) -> Result<[Mat<f64>; 2], MpcError> {
        let horizon = &mut self.0.horizon;
        horizon.roll_out(plan)?;
        horizon.linearize()?;
        let n = horizon.n_present();
        let mut soft = SoftRows::new(n, horizon.n_limit_rows());
        horizon.write_limits(&mut soft);
        let n_residuals = horizon.residuals().len();
        Ok([
            Mat::from_fn(n_residuals, n, |row, j| horizon.slope(row, j)),
            soft.slopes.transpose().to_owned(),
        ])
    }

    /// Returns the controls that cost no effort at the coefficients of the present plan, in N, N m or the units of their actuators.
    #[must_use]
    pub fn free_controls(&mut self) -> Vec<f64> {
        self.0.note_free();
        let scales = self.0.horizon.scales.iter().cycle();
        (self.0.free.iter().zip(scales))
            .map(|(value, scale)| value * scale)
            .collect()
    }
}
