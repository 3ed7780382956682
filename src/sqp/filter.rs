//! Which trial points pass: a filter on (infeasibility, objective) with a switching condition.
//!
//! After Wächter and Biegler (2006), Ipopt's filter line search, with its constants.

use super::kkt::Multipliers;
use super::program::{Evaluation, LiftedProgram};
use super::settings::{MERIT_ROUNDING, NEGLIGIBLE};

const MARGIN_INFEASIBILITY: f64 = 1e-5; // γ_θ
const MARGIN_OBJECTIVE: f64 = 1e-8; // γ_φ
const SWITCH_OBJECTIVE_POWER: f64 = 2.3; // s_φ
const SWITCH_INFEASIBILITY_POWER: f64 = 1.1; // s_θ
const SUFFICIENT_DECREASE: f64 = 1e-4; // Nocedal & Wright 2006, p. 33
const LARGEST_INFEASIBILITY: f64 = 10.0; // θ_max over θ₀; Ipopt has 1e4: too wide where recursions amplify
const SMALL_INFEASIBILITY: f64 = 1e-4; // θ_min over θ₀
/// What the filter compares.
#[derive(Clone, Copy, Debug)]
pub struct Measure {
    pub(super) infeasibility: f64,
    objective: f64,
    /// With the multipliers of the step that is judged.
    lagrangian: f64,
}

impl Measure {
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
pub(super) struct Slope {
    pub(super) objective: f64,
    pub(super) lagrangian: f64,
    /// What rows that are met to the accuracy of a subproblem change the objective by.
    pub(super) noise: f64,
}

/// Pairs (infeasibility, objective) that no later point may be worse than in both.
#[derive(Clone, Debug)]
pub struct Filter {
    entries: Vec<(f64, f64)>,
    largest: f64,
    small: f64,
    /// Length of the step whose lifted point was refused last; infinite after one was not.
    pub(super) refused_lift: f64,
}

/// How a trial point passed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Passage {
    /// By decrease of the objective at small infeasibility: the filter stays as it is.
    Objective,
    /// By the filter: the point left behind joins it.
    Filter,
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
        let rounding = MERIT_ROUNDING * from.objective.abs();
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

    /// Whether a trial point passes; the filter remembers the point it leaves where it must.
    pub(super) fn lets_pass(&mut self, from: Measure, to: Measure, slope: Slope) -> bool {
        let passage = self.passage(from, to, slope);
        if passage == Some(Passage::Filter) {
            self.leave(from);
        }
        passage.is_some()
    }
}
