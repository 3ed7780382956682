//! Which steps are taken: a filter on (infeasibility, objective), lifted and simulated trial points, second-order corrections, and
//! refits (Newton's method back to what a step promised, with derivatives of its own end). Who refuses a step shrinks the trust region.
//!
//! After Wächter and Biegler (2006), Ipopt's filter line search, with its constants.

use super::balls::change_into_balls;
use super::program::{Evaluation, LiftedProgram, Linearization, Softness};
use super::quadratic_program::{LinearInequalities, QuadraticProgram};
use super::refit::Promise;
use super::residual::{Multipliers, norm};

const MARGIN_INFEASIBILITY: f64 = 1e-5; // γ_θ
const MARGIN_OBJECTIVE: f64 = 1e-8; // γ_φ
const SWITCH_FACTOR: f64 = 1.0; // δ
const SWITCH_OBJECTIVE_POWER: f64 = 2.3; // s_φ
const SWITCH_INFEASIBILITY_POWER: f64 = 1.1; // s_θ
const SUFFICIENT_DECREASE: f64 = 1e-4; // Nocedal & Wright 2006, p. 33
const LARGEST_INFEASIBILITY: f64 = 10.0; // θ_max over θ₀; Ipopt has 1e4: too wide where recursions amplify
const SMALL_INFEASIBILITY: f64 = 1e-4; // θ_min over θ₀
/// A lifted step is tried when its turns are within what the charts allow, and kept when it is no less feasible than the point it
/// leaves or than this: beyond, its defects are worse than what simulated states cost.
const LIFTED_INFEASIBILITY: f64 = 1.0;
/// Part of the variables (at least of one) up to which a step is short.
const SHORT: f64 = 0.1;
/// After a lifted step was refused, one of this part of its length is tried next: longer ones would be computed to be refused as well.
const SHORTER: f64 = 0.5;
/// Infeasibility at which only optimality is left to be gained.
pub(super) const FEASIBLE: f64 = 1e-8;
/// Of the objective, relatively.
const ROUNDING: f64 = 10.0 * f64::EPSILON;
const CORRECTIONS: usize = 8;
/// Part of the trust radius from which a correction of a step may reach its end.
const INSIDE: f64 = 0.9;
/// A correction that does not shrink the infeasibility by this is the last one.
const CORRECTION_PROGRESS: f64 = 0.99;
/// Newton steps of a refit, at most, and what one must leave of what the promise is missed by, at most.
const REFITS: usize = 6;
const REFIT_PROGRESS: f64 = 0.7;
/// What the filter compares.
#[derive(Clone, Copy, Debug)]
pub struct Measure {
    infeasibility: f64,
    objective: f64,
    /// With the multipliers of the step that is judged.
    lagrangian: f64,
}

impl Measure {
    /// `J + weight · infeasibility`
    #[must_use]
    pub fn merit(&self, weight: f64) -> f64 {
        self.objective + weight * self.infeasibility
    }

    /// Of a point's values: [`LiftedProgram::infeasibility`], [`LiftedProgram::total_objective`], and that with `yᵀc + zᵀh`
    /// over the hard rows.
    #[must_use]
    pub fn of<P: LiftedProgram>(
        program: &P,
        evaluation: &Evaluation<P::Defects>,
        multipliers: &Multipliers,
    ) -> Self {
        let objective = program.total_objective(evaluation);
        Self {
            infeasibility: program.infeasibility(evaluation),
            objective,
            lagrangian: objective
                + multipliers.work(
                    program,
                    &evaluation.constraints,
                    evaluation.inequalities.iter().copied().enumerate(),
                ),
        }
    }
}

/// What a step does to first order.
#[derive(Clone, Copy, Debug)]
struct Slope {
    objective: f64,
    lagrangian: f64,
    /// What rows that are met to the accuracy of a subproblem change the objective by.
    noise: f64,
}

/// Pairs (infeasibility, objective) that no later point may be worse than in both.
#[derive(Clone, Debug)]
pub struct Filter {
    entries: Vec<(f64, f64)>,
    largest: f64,
    small: f64,
    /// Length of the step whose lifted point was refused last; infinite after one was not.
    refused_lift: f64,
}

/// How a trial point passed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Passage {
    /// By decrease of the objective at small infeasibility: the filter stays as it is.
    Objective,
    /// By the filter: the point left behind joins it.
    Filter,
}

/// An accepted step.
pub struct Accepted<P: LiftedProgram> {
    /// The new point.
    pub point: P::Point,
    /// Its values.
    pub evaluation: Evaluation<P::Defects>,
    /// Whether the states were computed from the variables rather than moved linearly.
    pub rolled_out: bool,
    /// Second-order corrections it took, or refits.
    pub corrections: usize,
}

/// Values of a refused step's simulated point. The point itself, as large as all else together, is not kept.
pub struct Refused {
    /// Its constraints.
    pub constraints: Vec<f64>,
    /// Its path inequalities.
    pub inequalities: Vec<f64>,
    /// What the filter compared.
    pub measure: Measure,
}

impl Refused {
    fn of<R>(evaluation: &Evaluation<R>, measure: Measure) -> Self {
        Self {
            constraints: evaluation.constraints.clone(),
            inequalities: evaluation.inequalities.clone(),
            measure,
        }
    }
}

impl Filter {
    /// An empty filter for a start of infeasibility `initial`.
    #[must_use]
    pub fn new(initial: f64) -> Self {
        let unit = initial.max(1.0);
        Self {
            entries: Vec::new(),
            largest: LARGEST_INFEASIBILITY * unit,
            small: SMALL_INFEASIBILITY * unit,
            refused_lift: f64::INFINITY,
        }
    }

    /// Whether a point is better than every remembered one in one of the two; an objective that is higher by no more than
    /// `noise` is no worse.
    #[must_use]
    pub fn allows(&self, to: Measure, noise: f64) -> bool {
        to.infeasibility <= self.largest
            && to.objective.is_finite()
            && !(self.entries.iter())
                .any(|&(t, p)| to.infeasibility >= t && to.objective >= p + noise)
    }

    /// Where the objective is what matters, it is judged by the Lagrangian: rows that bend turn a good step's objective
    /// either way by as much as they are then violated (Maratos), and steps that only trade one for the other are no
    /// progress.
    fn passage(&self, from: Measure, to: Measure, slope: Slope) -> Option<Passage> {
        let rounding = ROUNDING * from.objective.abs();
        // A step that promises less than the noise is judged by nothing else; one that promises more must deliver it.
        let noise = if slope.lagrangian.abs() <= slope.noise {
            rounding + slope.noise
        } else {
            rounding
        };
        if !self.allows(to, noise) {
            return None;
        }
        let switching = slope.objective < 0.0
            && (-slope.objective).powf(SWITCH_OBJECTIVE_POWER)
                > SWITCH_FACTOR * from.infeasibility.powf(SWITCH_INFEASIBILITY_POWER);
        let is_feasible = from.infeasibility <= FEASIBLE && slope.lagrangian < 0.0;
        if is_feasible || (from.infeasibility <= self.small && switching) {
            let change = if slope.lagrangian < 0.0 {
                to.lagrangian - from.lagrangian - SUFFICIENT_DECREASE * slope.lagrangian
            } else {
                to.objective - from.objective - SUFFICIENT_DECREASE * slope.objective
            };
            return (change <= noise && to.infeasibility <= self.small.max(from.infeasibility))
                .then_some(Passage::Objective);
        }
        (to.infeasibility <= (1.0 - MARGIN_INFEASIBILITY) * from.infeasibility
            || to.objective <= from.objective - MARGIN_OBJECTIVE * from.infeasibility + noise)
            .then_some(Passage::Filter)
    }

    /// Remembers a point that is left behind.
    pub fn leave(&mut self, from: Measure) {
        let (theta, phi) = (from.infeasibility, from.objective);
        let entry = (
            (1.0 - MARGIN_INFEASIBILITY) * theta,
            phi - MARGIN_OBJECTIVE * theta,
        );
        self.entries.retain(|&(t, p)| t < entry.0 || p < entry.1);
        self.entries.push(entry);
    }

    /// Tries the step `change` of a subproblem: its lifted point, and the point whose states obey their equations under the same
    /// variables; then second-order corrections of that. As a rule the lifted point comes first, since it is linear where the states'
    /// answer is not; of a short step of second order the other, which costs a third and leaves no defects.
    ///
    /// # Errors
    /// When all are refused: the simulated point's values, uncorrected, if it could be computed. Unless that point serves some other
    /// measure, the trust region must shrink.
    pub fn accept<P: LiftedProgram>(
        &mut self,
        program: &P,
        from: &Departure<P>,
        subproblem: &QuadraticProgram,
        change: &[f64],
    ) -> Result<Accepted<P>, Option<Refused>> {
        let length = norm(change) / norm(program.variables(from.point)).max(1.0);
        let slope = from.first_order(program, change);
        let is_short = from.is_second_order && length <= SHORT;
        if !is_short && let Some(accepted) = self.try_lifted(program, from, change, slope) {
            return Ok(accepted);
        }
        let refused = match self.try_rollout(program, from, change, slope) {
            Ok(accepted) => return Ok(accepted),
            Err(refused) => refused,
        };
        if is_short && let Some(accepted) = self.try_lifted(program, from, change, slope) {
            return Ok(accepted);
        }
        let refused = refused.ok_or(None)?;
        self.correct(program, from, subproblem, change, &refused, slope)
            .or_else(|| {
                let trial = Self::rollout(program, from.point, change, 0)?;
                self.refit(program, from, subproblem, change, trial, f64::INFINITY)
            })
            .ok_or(Some(refused))
    }

    /// Refits of a trial point until one that misses its promise by no more than `miss` passes.
    fn refit<P: LiftedProgram>(
        &mut self,
        program: &P,
        from: &Departure<P>,
        subproblem: &QuadraticProgram,
        change: &[f64],
        mut trial: Accepted<P>,
        miss: f64,
    ) -> Option<Accepted<P>> {
        let promise = Promise::of(from.linearization, from.softness, change);
        let here = from.measure(program, from.evaluation);
        let mut change = change.to_vec();
        let mut missed = promise.missed_by(&trial.evaluation);
        for count in 1.. {
            let there = from.measure(program, &trial.evaluation);
            let slope = from.first_order(program, &change);
            if missed <= miss && self.lets_pass(here, there, slope) {
                return Some(trial);
            }
            if count > REFITS {
                break;
            }
            let correction = promise.correction(program, &trial.point, &trial.evaluation)?;
            if !(norm(&correction) <= subproblem.trust_radius) {
                break;
            }
            let next = Self::rollout(program, &trial.point, &correction, count)?;
            let left = promise.missed_by(&next.evaluation);
            if !(left < REFIT_PROGRESS * missed) {
                break;
            }
            for (all, own) in change.iter_mut().zip(&correction) {
                *all += own;
            }
            (trial, missed) = (next, left);
        }
        None
    }

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
        Err(Some(Refused::of(&trial.evaluation, there)))
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

    /// Whether a trial point passes; the filter remembers the point it leaves where it must.
    fn lets_pass(&mut self, from: Measure, to: Measure, slope: Slope) -> bool {
        let passage = self.passage(from, to, slope);
        if passage == Some(Passage::Filter) {
            self.leave(from);
        }
        passage.is_some()
    }

    /// Second-order corrections of a refused step, while they reduce its infeasibility.
    fn correct<P: LiftedProgram>(
        &mut self,
        program: &P,
        from: &Departure<P>,
        subproblem: &QuadraticProgram,
        change: &[f64],
        refused: &Refused,
        slope: Slope,
    ) -> Option<Accepted<P>> {
        let linearization = from.linearization;
        let mut change = change.to_vec();
        let mut constraints = refused.constraints.clone();
        let mut inequalities = refused.inequalities.clone();
        let here = from.measure(program, from.evaluation);
        let mut infeasibility = refused.measure.infeasibility;
        // As a rule the same is active, which saves the interior point; the trust region can be no part of that.
        let active = from.multipliers.at_rows(&linearization.rows);
        let expected = (norm(&change) < INSIDE * subproblem.trust_radius).then_some(&active);
        for count in 1..=CORRECTIONS {
            // The states of the trial obey their equations, so only the rows' own curvature is left.
            let offset: Vec<f64> = (linearization.constraints_along(&change).iter())
                .zip(&linearization.offset)
                .zip(&constraints)
                .map(|((linear, offset), c)| c - (linear - offset))
                .collect();
            let inequality_offset: Vec<f64> = (linearization.inequalities_along(&change).iter())
                .zip(&linearization.inequality_offset)
                .zip(&linearization.rows)
                .map(|((linear, offset), &row)| inequalities[row] - (linear - offset))
                .collect();
            let corrected = QuadraticProgram {
                offset: &offset,
                inequalities: LinearInequalities {
                    offset: &inequality_offset,
                    ..subproblem.inequalities
                },
                expected,
                ..subproblem.clone()
            };
            let corrected =
                within_balls(program, from, subproblem, &corrected.solve().ok()?.change);
            let trial = Self::rollout(program, from.point, &corrected, count)?;
            let there = from.measure(program, &trial.evaluation);
            if self.lets_pass(here, there, slope) {
                return Some(trial);
            }
            if there.infeasibility > CORRECTION_PROGRESS * infeasibility {
                return None;
            }
            change = corrected;
            infeasibility = there.infeasibility;
            constraints = trial.evaluation.constraints;
            inequalities = trial.evaluation.inequalities;
        }
        None
    }
}

/// The step, back in the balls that the subproblem held by their tangents: along these a step may go as far as its trust region.
fn within_balls<P: LiftedProgram>(
    program: &P,
    from: &Departure<P>,
    subproblem: &QuadraticProgram,
    change: &[f64],
) -> Vec<f64> {
    let left = (program.sets().iter().zip(subproblem.sets))
        .filter(|(own, held)| own != held)
        .map(|(own, _)| own);
    change_into_balls(program.variables(from.point), change, left)
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
}

impl<P: LiftedProgram> Departure<'_, P> {
    fn measure(&self, program: &P, evaluation: &Evaluation<P::Defects>) -> Measure {
        Measure::of(program, evaluation, self.multipliers)
    }

    fn first_order(&self, program: &P, change: &[f64]) -> Slope {
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
