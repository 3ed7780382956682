//! Steps past saddles: points that meet the first-order conditions and are no minima.

use super::super::balls::change_into_balls;
use super::super::hessian::{ModelHessian, NegativeCurvature};
use super::super::program::LiftedProgram;
use super::super::quadratic_program::QpSolution;
use super::{Run, is_within};

/// Length of a step past a saddle, as a fraction of the length that promises the worthwhile gain: half of it promises a quarter of the
/// gain, and from there steps along the negative curvature double by themselves. It is a choice (decision 68).
const PASSING_PART: f64 = 0.5;
/// Largest length of a step past a saddle, as a fraction of the trust radius and of the norm of the variables (at least one): near enough
/// for the quadratic model. It is a choice (decision 68).
const PASSING_REACH: f64 = 0.3;

impl<P: LiftedProgram> Run<'_, P> {
    /// Returns the step, lengthened along the most negative curvature if it hardly goes that way and a worthwhile gain is within reach.
    /// Near a saddle, the component along that direction only doubles from one iteration to the next, and in a symmetric problem it begins
    /// with rounding.
    pub(super) fn past_saddle(&self, model: &ModelHessian, mut solution: QpSolution) -> QpSolution {
        let Some(NegativeCurvature { direction, value }) = &model.descent else {
            return solution;
        };
        let gain = self.settings.saddle_gain * self.iterate.evaluation.objective.abs();
        let worthwhile = (2.0 * gain / -value).sqrt();
        let reach = self
            .trust_region
            .radius
            .min(self.length(self.variables()).max(1.0));
        if worthwhile > reach {
            return solution;
        }
        let length = (PASSING_PART * worthwhile).min(PASSING_REACH * reach);
        let has: f64 = (direction.iter().zip(&solution.change))
            .map(|(d, c)| d * c)
            .sum();
        if has.abs() >= length {
            return solution;
        }
        let missing = length.copysign(has) - has;
        let change: Vec<f64> = (solution.change.iter().zip(direction))
            .map(|(c, d)| c + missing * d)
            .collect();
        let sets = self.program.sets();
        let change = change_into_balls(self.variables(), &change, sets.iter());
        let there: Vec<f64> = (self.variables().iter().zip(&change))
            .map(|(v, c)| v + c)
            .collect();
        if is_within(sets, &there) {
            solution.change = change;
        }
        solution
    }
}
