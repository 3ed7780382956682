//! A filter on (infeasibility, objective) with a switching condition, which decides about trial points.
//!
//! After Wächter and Biegler (2006), the filter line search of Ipopt. Constants that name an option of Ipopt have its default.

use super::program::Multipliers;
use super::program::{Evaluation, LiftedProgram};
use super::settings::{MERIT_ROUNDING, NEGLIGIBLE, SCALED_UNIT};

/// `γ_θ`: Ipopt's `gamma_theta`.
const MARGIN_INFEASIBILITY: f64 = 1e-5;
/// `γ_φ`: Ipopt's `gamma_phi`.
const MARGIN_OBJECTIVE: f64 = 1e-8;
/// `s_φ`: Ipopt's `s_phi`.
const SWITCH_OBJECTIVE_POWER: f64 = 2.3;
/// `s_θ`: Ipopt's `s_theta`.
const SWITCH_INFEASIBILITY_POWER: f64 = 1.1;
/// `η_φ`: the constant of sufficient decrease of Nocedal and Wright (2006), p. 33; Ipopt's `eta_phi` is 1e-8.
const SUFFICIENT_DECREASE: f64 = 1e-4;
/// `θ_max / max(1, θ₀)`: points of larger infeasibility are refused. It is a choice (decision 68). Ipopt's `theta_max_fact` is 1e4; a
/// motion with so many times the violation of the start has run away.
const LARGEST_INFEASIBILITY: f64 = 10.0;
/// `θ_min / max(1, θ₀)`: Ipopt's `theta_min_fact`.
const SMALL_INFEASIBILITY: f64 = 1e-4;

/// The values of a point that the filter compares.
#[derive(Clone, Copy, Debug)]
pub struct Measure {
    pub(super) infeasibility: f64,
    objective: f64,
    /// Lagrangian with the multipliers of the step under test.
    pub(super) lagrangian: f64,
}

impl Measure {
    /// Collects the values of a point: [`LiftedProgram::infeasibility`], [`LiftedProgram::total_objective`], and the latter plus `yᵀc +
    /// zᵀh` over the hard rows.
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

/// First-order changes along a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slope {
    pub(super) objective: f64,
    pub(super) lagrangian: f64,
    /// Change of the objective that rows account for if a subproblem meets them to its accuracy only.
    pub(super) noise: f64,
}

/// Pairs (infeasibility, objective); a later point must be better than each of them in one of the two.
#[derive(Clone, Debug)]
pub struct Filter {
    entries: Vec<(f64, f64)>,
    largest: f64,
    small: f64,
    /// Length of the last step whose lifted point was refused; infinite if the last lifted point was accepted.
    pub(super) refused_lift: f64,
}

/// The condition by which a trial point passed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Passage {
    /// The objective decreased at small infeasibility; the filter stays as it is.
    Objective,
    /// The filter allows the point; the point left behind joins the filter.
    Filter,
}

impl Filter {
    /// Returns an empty filter for a start of infeasibility `initial`.
    #[must_use]
    pub fn new(initial: f64) -> Self {
        let unit = initial.max(SCALED_UNIT);
        Self {
            entries: Vec::new(),
            largest: LARGEST_INFEASIBILITY * unit,
            small: SMALL_INFEASIBILITY * unit,
            refused_lift: f64::INFINITY,
        }
    }

    /// Tells whether a point is better than every entry in infeasibility or objective; an objective counts as better unless it is higher by
    /// `noise` or more.
    #[must_use]
    pub fn allows(&self, to: Measure, noise: f64) -> bool {
        to.infeasibility <= self.largest
            && to.objective.is_finite()
            && !(self.entries.iter())
                .any(|&(t, p)| to.infeasibility >= t && to.objective >= p + noise)
    }

    /// Returns the condition by which `to` passes, if any. Under the switching condition, the Lagrangian is compared in place of the
    /// objective: curved rows change the objective of a good step either way by as much as they are then violated (Maratos effect), and
    /// steps that only trade objective for violation are no progress.
    fn passage(&self, from: Measure, to: Measure, slope: Slope) -> Option<Passage> {
        let rounding = MERIT_ROUNDING * from.objective.abs();
        // A step that promises less than the noise is judged by the noise only; a step that promises more must deliver it.
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
                > from.infeasibility.powf(SWITCH_INFEASIBILITY_POWER);
        let is_feasible = from.infeasibility <= NEGLIGIBLE && slope.lagrangian < 0.0;
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

    /// Adds a point that is left behind.
    pub fn leave(&mut self, from: Measure) {
        let (theta, phi) = (from.infeasibility, from.objective);
        let entry = (
            (1.0 - MARGIN_INFEASIBILITY) * theta,
            phi - MARGIN_OBJECTIVE * theta,
        );
        self.entries.retain(|&(t, p)| t < entry.0 || p < entry.1);
        self.entries.push(entry);
    }

    /// Tells whether a trial point passes, and adds the point left behind where that is required.
    pub(super) fn lets_pass(&mut self, from: Measure, to: Measure, slope: Slope) -> bool {
        let passage = self.passage(from, to, slope);
        if passage == Some(Passage::Filter) {
            self.leave(from);
        }
        passage.is_some()
    }
}
