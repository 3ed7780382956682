//! Which steps are taken: a filter on (infeasibility, objective), lifted and restored trial points, and a second-order
//! correction. Who refuses a step shrinks the trust region.
//!
//! After Wächter and Biegler (2006), Ipopt's filter line search, with its constants.

use super::program::{Evaluation, LiftedProgram, Linearization};
use super::quadratic_program::QuadraticProgram;
use super::residual::norm;

const MARGIN_INFEASIBILITY: f64 = 1e-5; // γ_θ
const MARGIN_OBJECTIVE: f64 = 1e-8; // γ_φ
const SWITCH_FACTOR: f64 = 1.0; // δ
const SWITCH_OBJECTIVE_POWER: f64 = 2.3; // s_φ
const SWITCH_INFEASIBILITY_POWER: f64 = 1.1; // s_θ
const SUFFICIENT_DECREASE: f64 = 1e-4; // Nocedal & Wright 2006, p. 33
const LARGEST_INFEASIBILITY: f64 = 10.0; // θ_max over θ₀; Ipopt has 1e4, too wide for stiff rods
const SMALL_INFEASIBILITY: f64 = 1e-4; // θ_min over θ₀
/// A lifted step is tried when it is this much shorter than the charts allow, and kept when it is no less feasible than
/// the point it leaves or than this: a stiff rod that is moved linearly through a large rotation is stretched, and its
/// defects are then worse than what restored states cost.
const LIFTED_MARGIN: f64 = 8.0;
/// Longer steps of the (scaled) variables are not worth the attempt.
const LIFTED_LENGTH: f64 = 0.3;
const LIFTED_INFEASIBILITY: f64 = 0.1;
const CORRECTIONS: usize = 3;
/// A correction that does not shrink the infeasibility by this is the last one.
const CORRECTION_PROGRESS: f64 = 0.99;

/// Pairs (infeasibility, objective) that no later point may be worse than in both.
#[derive(Clone, Debug)]
pub struct Filter {
    entries: Vec<(f64, f64)>,
    largest: f64,
    small: f64,
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
    pub restored: bool,
    /// Second-order corrections it took.
    pub corrections: usize,
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
        }
    }

    /// Whether it remembers any point.
    #[must_use]
    pub fn has_entries(&self) -> bool {
        !self.entries.is_empty()
    }

    fn passage<R>(&self, from: &Evaluation<R>, to: &Evaluation<R>, slope: f64) -> Option<Passage> {
        let (theta, phi) = (from.infeasibility(), from.objective);
        let (theta_to, phi_to) = (to.infeasibility(), to.objective);
        if !(theta_to <= self.largest && phi_to.is_finite()) {
            return None;
        }
        // Differences at rounding of the objective are no increase.
        let noise = 10.0 * f64::EPSILON * phi.abs();
        if self
            .entries
            .iter()
            .any(|&(t, p)| theta_to >= t && phi_to >= p + noise)
        {
            return None;
        }
        let switching = slope < 0.0
            && (-slope).powf(SWITCH_OBJECTIVE_POWER)
                > SWITCH_FACTOR * theta.powf(SWITCH_INFEASIBILITY_POWER);
        if theta <= self.small && switching {
            return (phi_to <= phi + SUFFICIENT_DECREASE * slope + noise
                && theta_to <= self.small.max(theta))
            .then_some(Passage::Objective);
        }
        (theta_to <= (1.0 - MARGIN_INFEASIBILITY) * theta
            || phi_to <= phi - MARGIN_OBJECTIVE * theta + noise)
            .then_some(Passage::Filter)
    }

    fn leave<R>(&mut self, from: &Evaluation<R>) {
        let (theta, phi) = (from.infeasibility(), from.objective);
        let entry = (
            (1.0 - MARGIN_INFEASIBILITY) * theta,
            phi - MARGIN_OBJECTIVE * theta,
        );
        self.entries.retain(|&(t, p)| t < entry.0 || p < entry.1);
        self.entries.push(entry);
    }

    /// Tries the step `change` of a subproblem: the lifted point first, then the point whose states obey their
    /// equations under the same variables, then second-order corrections of that.
    ///
    ///
    /// # Errors
    /// When all are refused: the restored point, uncorrected, if it could be computed. Unless that serves some other
    /// measure, the trust region must shrink.
    pub fn accept<P: LiftedProgram>(
        &mut self,
        program: &P,
        from: &Departure<P>,
        subproblem: &QuadraticProgram,
        change: &[f64],
    ) -> Result<Accepted<P>, Option<Accepted<P>>> {
        let slope = from.slope(change);
        if norm(change) <= LIFTED_LENGTH
            && let Some(accepted) = self.try_lifted(program, from, change, slope)
        {
            return Ok(accepted);
        }
        let trial = Self::restored(program, from, change, 0).ok_or(None)?;
        if let Some(passage) = self.passage(from.evaluation, &trial.evaluation, slope) {
            self.pass(passage, from.evaluation);
            return Ok(trial);
        }
        self.correct(program, from, subproblem, change, &trial.evaluation, slope)
            .ok_or(Some(trial))
    }

    /// The point of a step whose states obey their equations; `None` where the model fails.
    fn restored<P: LiftedProgram>(
        program: &P,
        from: &Departure<P>,
        change: &[f64],
        corrections: usize,
    ) -> Option<Accepted<P>> {
        let point = program.restored_step(from.point, change).ok()?;
        let evaluation = program.evaluate(&point).ok()?;
        Some(Accepted {
            point,
            evaluation,
            restored: true,
            corrections,
        })
    }

    fn try_lifted<P: LiftedProgram>(
        &mut self,
        program: &P,
        from: &Departure<P>,
        change: &[f64],
        slope: f64,
    ) -> Option<Accepted<P>> {
        let direction = program
            .expand(from.point, &from.evaluation.defects, change)
            .ok()?;
        if program.longest_step(&direction) < LIFTED_MARGIN {
            return None;
        }
        let trial = program.retract(from.point, &direction, 1.0);
        let values = program.evaluate(&trial).ok()?;
        if values.infeasibility() > LIFTED_INFEASIBILITY.max(from.evaluation.infeasibility()) {
            return None;
        }
        let passage = self.passage(from.evaluation, &values, slope)?;
        self.pass(passage, from.evaluation);
        Some(Accepted {
            point: trial,
            evaluation: values,
            restored: false,
            corrections: 0,
        })
    }

    fn pass<R>(&mut self, passage: Passage, from: &Evaluation<R>) {
        if passage == Passage::Filter {
            self.leave(from);
        }
    }

    /// Second-order corrections of a refused step, while they reduce its infeasibility.
    fn correct<P: LiftedProgram>(
        &mut self,
        program: &P,
        from: &Departure<P>,
        subproblem: &QuadraticProgram,
        change: &[f64],
        refused: &Evaluation<P::Defects>,
        slope: f64,
    ) -> Option<Accepted<P>> {
        let jacobian = &from.linearization.jacobian;
        let along = |change: &[f64], row: usize| -> f64 {
            change
                .iter()
                .enumerate()
                .map(|(j, d)| jacobian[(row, j)] * d)
                .sum()
        };
        let mut change = change.to_vec();
        let mut constraints = refused.constraints.clone();
        let mut infeasibility = refused.infeasibility();
        for count in 1..=CORRECTIONS {
            // The states of the trial obey their equations, so only the constraints' own curvature is left.
            let offset: Vec<f64> = constraints
                .iter()
                .enumerate()
                .map(|(i, c)| c - along(&change, i))
                .collect();
            let corrected = QuadraticProgram {
                offset: &offset,
                ..subproblem.clone()
            };
            let solution = corrected.solve().ok()?;
            let trial = Self::restored(program, from, &solution.change, count)?;
            if let Some(passage) = self.passage(from.evaluation, &trial.evaluation, slope) {
                self.pass(passage, from.evaluation);
                return Some(trial);
            }
            if trial.evaluation.infeasibility() > CORRECTION_PROGRESS * infeasibility {
                return None;
            }
            change = solution.change;
            infeasibility = trial.evaluation.infeasibility();
            constraints = trial.evaluation.constraints;
        }
        None
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
}

impl<P: LiftedProgram> Departure<'_, P> {
    /// Derivative of the objective along a step.
    fn slope(&self, change: &[f64]) -> f64 {
        let along: f64 = self
            .linearization
            .gradient
            .iter()
            .zip(change)
            .map(|(g, d)| g * d)
            .sum();
        self.linearization.defect_slope + along
    }
}
