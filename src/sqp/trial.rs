//! Trial points of a step: its lifted point, whose states move linearly, and the point whose states obey their equations. Who refuses both
//! shrinks the trust region.

use super::filter::{Filter, Measure, Slope};
use super::kkt::{Multipliers, norm};
use super::program::{Evaluation, LiftedProgram, Linearization, Softness};
use super::quadratic_program::QuadraticProgram;

/// A lifted step is tried when its turns are within what the charts allow, and kept when it is no less feasible than the point it
/// leaves or than this: beyond, its defects are worse than what simulated states cost.
const LIFTED_INFEASIBILITY: f64 = 1.0;
/// Part of the variables (at least of one) up to which a step is short.
const SHORT: f64 = 0.1;
/// After a lifted step was refused, one of this part of its length is tried next: longer ones would be computed to be refused as well.
const SHORTER: f64 = 0.5;

/// An accepted step.
pub struct Accepted<P: LiftedProgram> {
    /// The new point.
    pub point: P::Point,
    /// Its values.
    pub evaluation: Evaluation<P::Defects>,
    /// Whether the states were computed from the variables rather than moved linearly.
    pub rolled_out: bool,
    /// Second-order corrections it took.
    pub corrections: usize,
}

/// Values of a refused step's simulated point. The point itself, as large as all else together, is not kept.
pub struct Refused {
    /// Its constraints.
    pub constraints: Vec<f64>,
    /// Its path inequalities.
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
    /// Tries the step `change` of a subproblem: its lifted point, and the point whose states obey their equations under the same
    /// variables; then second-order corrections of that. As a rule the lifted point comes first, since it is linear where the states'
    /// answer is not; of a short step of second order the other, which costs a third and leaves no defects.
    ///
    /// `None` when all are refused: the trust region must shrink.
    pub fn accept<P: LiftedProgram>(
        &mut self,
        program: &P,
        from: &Departure<P>,
        subproblem: &QuadraticProgram,
        change: &[f64],
    ) -> Option<Accepted<P>> {
        let length = norm(change) / norm(program.variables(from.point)).max(1.0);
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

    /// The simulated point; its values where it is refused, and nothing where it cannot be computed.
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

    /// The point of a step whose states obey their equations; `None` where the model fails.
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

    /// The lifted point, unless one at about this length was refused before.
    fn try_lifted<P: LiftedProgram>(
        &mut self,
        program: &P,
        from: &Departure<P>,
        change: &[f64],
        slope: Slope,
    ) -> Option<Accepted<P>> {
        let length = norm(change);
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
        if there.infeasibility > LIFTED_INFEASIBILITY.max(here.infeasibility) {
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
    /// Its values.
    pub evaluation: &'a Evaluation<P::Defects>,
    /// Its linearization.
    pub linearization: &'a Linearization,
    /// Of the linearized inequalities.
    pub softness: &'a [Softness],
    /// Of the subproblem whose step is judged.
    pub multipliers: &'a Multipliers,
    /// Whether that held the second derivative of the Lagrangian.
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

    /// First-order change of the objective over a step; soft rows by their linear models, whose price is convex.
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
