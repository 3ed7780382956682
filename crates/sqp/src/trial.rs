//! Trial points of a step: the lifted point, whose states move linearly, and the rollout, whose states obey their equations. If both are
//! rejected, the trust region shrinks.

use super::filter::{Filter, Measure, Slope};
use super::program::Multipliers;
use super::program::{Evaluation, LiftedProgram, Linearization, Softness, norm_without, unlimited};
use super::quadratic_program::QuadraticProgram;
use super::settings::SCALED_UNIT;

/// A step is short up to this fraction of the norm of the variables (at least one). It is a choice: the defects of a step grow with its
/// square, a hundredth at this length (decision 68).
const SHORT: f64 = 0.1;
/// After a lifted point was refused, the next one is tried at this fraction of that step's length: longer ones would be refused as well.
/// It is a choice: the defects of half of a step are a quarter (decision 68).
const SHORTER: f64 = 0.5;

/// An accepted step.
pub struct Accepted<P: LiftedProgram> {
    /// The new point.
    pub point: P::Point,
    /// Values at the new point.
    pub evaluation: Evaluation<P::Defects>,
    /// Tells whether the states are a rollout of the variables rather than a linear step.
    pub rolled_out: bool,
    /// Number of second-order corrections.
    pub corrections: usize,
}

/// Values of a refused rollout. The point itself is not kept, because it is larger than all other data together.
pub struct Refused {
    /// Equality constraints `c`.
    pub constraints: Vec<f64>,
    /// Inequalities `h`.
    pub inequalities: Vec<f64>,
    /// [`LiftedProgram::infeasibility`]
    pub infeasibility: f64,
}

impl Refused {
    fn of<R>(evaluation: &Evaluation<R>, infeasibility: f64) -> Self {
        Self {
            constraints: evaluation.constraints.clone(),
            inequalities: evaluation.inequalities.clone(),
            infeasibility,
        }
    }
}

impl Filter {
    /// Tries the step `change` of a subproblem: its lifted point, and the rollout of the same variables, then second-order corrections of
    /// the rollout. The lifted point comes first, since it is linear where the response of the states is not; after a short step with an
    /// exact Hessian the rollout comes first, which costs a third as much and leaves no defects.
    ///
    /// Returns `None` if all are refused: the trust region must shrink.
    pub fn accept<P: LiftedProgram>(
        &mut self,
        program: &P,
        from: &Departure<P>,
        subproblem: &QuadraticProgram,
        change: &[f64],
    ) -> Option<Accepted<P>> {
        let unlimited = unlimited(program, change.len());
        let size = |v: &[f64]| norm_without(v, &unlimited);
        let length = size(change) / size(program.variables(from.point)).max(1.0);
        let slope = from.first_order(program, change);
        let is_short = from.is_second_order && length <= SHORT;
        if !is_short && let Some(accepted) = self.try_lifted(program, from, change, slope) {
            return Some(accepted);
        }
        let refused = match self.try_rollout(program, from, change, slope) {
            Ok(accepted) => return Some(accepted),
            Err(refused) => refused,
        };
        if is_short && let Some(accepted) = self.try_lifted(program, from, change, slope) {
            return Some(accepted);
        }
        self.correct(program, from, subproblem, change, &refused?, slope)
    }

    /// Tries the rollout. Returns its values as an error if the filter refuses it, and no values if it cannot be computed.
    fn try_rollout<P: LiftedProgram>(
        &mut self,
        program: &P,
        from: &Departure<P>,
        change: &[f64],
        slope: Slope,
    ) -> Result<Accepted<P>, Option<Refused>> {
        let trial = Self::rollout(program, from.point, change, 0).ok_or(None)?;
        let here = from.measure(program, from.evaluation);
        let there = from.measure(program, &trial.evaluation);
        if self.lets_pass(here, there, slope) {
            return Ok(trial);
        }
        Err(Some(Refused::of(&trial.evaluation, there.infeasibility)))
    }

    /// Returns the rollout of the variables after a step; `None` if the model fails.
    pub(super) fn rollout<P: LiftedProgram>(
        program: &P,
        from: &P::Point,
        change: &[f64],
        corrections: usize,
    ) -> Option<Accepted<P>> {
        let mut point = program.rollout(from, change).ok()?;
        let mut evaluation = program.evaluate(&point).ok()?;
        program.reset_slacks(&mut point, &mut evaluation);
        Some(Accepted {
            point,
            evaluation,
            rolled_out: true,
            corrections,
        })
    }

    /// Tries the lifted point, unless one of about this length was refused before.
    fn try_lifted<P: LiftedProgram>(
        &mut self,
        program: &P,
        from: &Departure<P>,
        change: &[f64],
        slope: Slope,
    ) -> Option<Accepted<P>> {
        let length = norm_without(change, &unlimited(program, change.len()));
        if length > SHORTER * self.refused_lift {
            return None;
        }
        let accepted = self.lifted(program, from, change, slope);
        self.refused_lift = if accepted.is_some() {
            f64::INFINITY
        } else {
            length
        };
        accepted
    }

    fn lifted<P: LiftedProgram>(
        &mut self,
        program: &P,
        from: &Departure<P>,
        change: &[f64],
        slope: Slope,
    ) -> Option<Accepted<P>> {
        let direction = program
            .expand(from.point, &from.evaluation.defects, change)
            .ok()?;
        if program.longest_step(&direction) < 1.0 {
            return None;
        }
        let mut trial = program.retract(from.point, &direction, 1.0);
        let mut values = program.evaluate(&trial).ok()?;
        program.reset_slacks(&mut trial, &mut values);
        let here = from.measure(program, from.evaluation);
        let there = from.measure(program, &values);
        // Larger defects would cost more iterations than a rollout costs.
        if there.infeasibility > SCALED_UNIT.max(here.infeasibility) {
            return None;
        }
        (self.lets_pass(here, there, slope)).then_some(Accepted {
            point: trial,
            evaluation: values,
            rolled_out: false,
            corrections: 0,
        })
    }
}

/// The point that a step leaves, and its linear model.
pub struct Departure<'a, P: LiftedProgram> {
    /// The point.
    pub point: &'a P::Point,
    /// Values of the point.
    pub evaluation: &'a Evaluation<P::Defects>,
    /// Linearization at the point.
    pub linearization: &'a Linearization,
    /// Softness of the linearized inequalities.
    pub softness: &'a [Softness],
    /// Multipliers of the subproblem whose step is under test.
    pub multipliers: &'a Multipliers,
    /// Tells whether that subproblem has the second derivative of the Lagrangian.
    pub is_second_order: bool,
    /// [`QpSolution::returned`](super::quadratic_program::QpSolution::returned) of its step.
    pub returned: &'a [f64],
}

impl<P: LiftedProgram> Departure<'_, P> {
    pub(super) fn measure(&self, program: &P, evaluation: &Evaluation<P::Defects>) -> Measure {
        Measure::of(program, evaluation, self.multipliers)
    }

    pub(super) fn first_order(&self, program: &P, change: &[f64]) -> Slope {
        let objective = self.slope(change);
        let linearization = self.linearization;
        let work = |constraints: &[f64], rows: &mut dyn Iterator<Item = (usize, f64)>| {
            self.multipliers.work(program, constraints, rows)
        };
        let values = linearization.inequalities_along(change);
        let after = work(
            &linearization.constraints_along(change),
            &mut linearization.rows.iter().copied().zip(values),
        );
        let now = work(
            &self.evaluation.constraints,
            &mut self.evaluation.inequalities.iter().copied().enumerate(),
        );
        Slope {
            objective,
            lagrangian: objective + after - now,
            noise: self.multipliers.row_noise(),
        }
    }

    /// Returns the first-order change of the objective over a step; soft rows count by the penalty of their linear models.
    #[must_use]
    pub fn slope(&self, change: &[f64]) -> f64 {
        let linearization = self.linearization;
        let cost: f64 = (linearization.gradient.iter().zip(change))
            .map(|(g, d)| g * d)
            .sum();
        let values = linearization.inequalities_along(change);
        let prices: f64 = (linearization.rows.iter().zip(values))
            .zip(self.softness)
            .map(|((&row, value), softness)| {
                softness.penalty(value) - softness.penalty(self.evaluation.inequalities[row])
            })
            .sum();
        linearization.defect_slope + cost + prices
    }
}
