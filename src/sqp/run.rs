//! A solve in progress: what one iteration of the loop does, and what it remembers.

mod rescue;
mod restoration;
mod subproblem;

use std::sync::Arc;
use std::time::Instant;

use faer::Mat;

use self::rescue::{Care, Recovery};
use self::restoration::Restoration;
use self::subproblem::NO_SLACK;
use super::globalization::{Accepted, CAREFUL_MISS, Departure, FEASIBLE, Filter, Measure, Refused};
use super::hessian::{ActiveSet, HessianChoice, HessianKind, ModelHessian, NegativeCurvature};
use super::kept_states::{QpRoute, StateLinearization};
use super::outcome::{Convergence, IterationRecord, Leave, PhaseTimes, SqpOutcome, SqpStatus};
use super::program::{
    ConvexSet, Evaluation, Failure, LagrangianTerms, LiftedProgram, Linearization,
    LinearizationRequest, Softness, sum_of_largest,
};
use super::quadratic_program::{
    LinearInequalities, QpError, QpSolution, QuadraticProgram, ROW_TOLERANCE,
};
use super::residual::{KktResidual, Multipliers, norm};
use super::settings::SqpSettings;
use super::solver::WarmStart;
use crate::stop::{LARGE, Stop};

/// `Auto` uses the exact Hessian below this stationarity and infeasibility.
const EXACT_BELOW: f64 = 0.3;
/// It uses it below this infeasibility already where the last subproblem met its constraints, whose multipliers then are no mere
/// limits: where constraints bend more than the objective, Gauss-Newton's steps do not contract.
const EXACT_BELOW_WITH_MULTIPLIERS: f64 = 1.0;
/// `Auto` goes back to Gauss-Newton for a few iterations when an exact step took this many shorter attempts.
const EXACT_REFUSALS: usize = 3;
const EXACT_PAUSE: usize = 3;
/// Subproblems that promise less than this part of the infeasibility make no progress.
const INFEASIBLE_PROGRESS: f64 = 1e-3;
const INFEASIBLE_PATIENCE: usize = 3;
/// Iterations over which an infeasibility above this must fall to this part.
const CRAWL: usize = 15;
const CRAWL_INFEASIBILITY: f64 = 1e-4;
const CRAWL_GAIN: f64 = 0.98;
/// First trust radius, relative to the first variables (at least to one).
const FIRST_TRUST_RADIUS: f64 = 2.0;
/// A set may be violated by this much before the trust region makes room for the way back.
const SET_TOLERANCE: f64 = 1e-9;
const SHRINK: f64 = 0.3;
const GROW: f64 = 2.5;
/// Ratios of what a step delivered to what it promised, above which the trust region grows and below which it shrinks.
const GOOD_RATIO: f64 = 0.5;
const POOR_RATIO: f64 = 0.05;
const POOR_SHRINK: f64 = 0.5;
/// Rounding of the merit, relatively.
const MERIT_ROUNDING: f64 = 100.0 * f64::EPSILON;
/// A trust region is shrunk by poor steps to no less than this, relative to the variables (at least to one).
const LEAST_TRUST_RADIUS: f64 = 1e-9;
/// Steps that shrink by less than this no longer converge by themselves.
const SLOW_CONTRACTION: f64 = 0.95;
const SHRINKAGES: usize = 12;
const REFUSALS_IN_A_ROW: usize = 4;
const FILTER_RESETS: usize = 5;
/// Refused trials of an iteration whose violated rows join the subproblem at the same trust radius.
const TRIAL_JOINS: usize = 2;
/// Part of the promise that a step refused by the filter must deliver, and how many such steps there may be.
const MERIT_RATIO: f64 = 0.2;
const MERIT_STEPS: usize = 40;
/// Restorations, at most.
const RESTORATIONS: usize = 5;
/// Models of an iteration that are made anew because a step leaves what they hold.
const RELEASES: usize = 3;
/// Steps shorter than this, relative to the variables (at least to one), go nowhere.
const NO_STEP: f64 = 1e-9;
/// So many of them in a row, and what they lead to is where the solve is. States that still come nearer to their equations have done so by
/// then: their defects fall with the square.
const NULL_STEPS: usize = 8;

/// What the stopping test reads at a point.
pub(super) enum Derivatives<P: LiftedProgram> {
    /// The linearization for a step of Gauss-Newton or of the restoration.
    Linearized(Box<Linearization>),
    /// The gradient of the Lagrangian; the linearization with curvature is computed only if the point does not pass.
    Gradient(LagrangianTerms<P::Costates>),
}

/// What an iteration did.
pub(super) enum Step {
    Taken,
    Restarted,
    Refused,
    Infeasible,
}

/// Why a solve cannot go on.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(super) enum Breakdown {
    #[error(transparent)]
    Subproblem(#[from] QpError),
    #[error(transparent)]
    Model(#[from] Failure),
}

/// A solve in progress.
pub(super) struct Run<'a, P: LiftedProgram> {
    program: &'a P,
    settings: &'a SqpSettings,
    started: Instant,
    point: Arc<P::Point>,
    evaluation: Evaluation<P::Defects>,
    multipliers: Multipliers,
    /// Whether the first multipliers are those of another solve.
    has_multipliers: bool,
    filter: Filter,
    care: Care,
    elastic_weight: Option<f64>,
    trust_radius: f64,
    /// Distance of the variables from the sets; positive at most at the start.
    outside: f64,
    /// Inequalities above minus this are linearized from the start.
    screening_margin: f64,
    /// Of the linearized inequalities.
    softness: Vec<Softness>,
    /// Group of every linearized inequality.
    groups: Vec<usize>,
    /// How subproblems are solved, and the linearization with its states where that needs it.
    route: QpRoute,
    kept: Option<StateLinearization>,
    /// [Least curvature](Linearization::least_curvature) of the last linearization.
    least_curvature: f64,
    /// Inequalities of the last working set that mattered.
    working: Vec<usize>,
    stuck: usize,
    /// Length of the history when the last restoration began.
    restored_at: usize,
    rescues: usize,
    refused_in_a_row: usize,
    /// Accepted steps in a row that go nowhere.
    null_steps: usize,
    filter_resets: usize,
    merit_steps: usize,
    exact_pause: usize,
    /// Inequalities and sets that the steps of this iteration left behind.
    rows_let_go: Vec<usize>,
    sets_let_go: Vec<usize>,
    restoration: Option<Restoration>,
    restorations: usize,
    returns: usize,
    /// Defects of the last states that were computed from their variables.
    rounding: f64,
    /// Negative curvature of the last exact Hessian.
    descent: Option<NegativeCurvature>,
    escapes: usize,
    /// The best point before the last escape.
    saddle: Option<Best<P::Point>>,
    /// What the Lagrangian still falls by from a saddle that is not worth leaving.
    left_to_gain: Option<f64>,
    /// Whether states were computed anew for want of any other progress.
    has_rolled_out: bool,
    best: Best<P::Point>,
    history: Vec<IterationRecord>,
    phases: PhaseTimes,
    failed_subproblem: Option<String>,
}

/// The best point so far: least infeasible, and among feasible ones the nearest to optimal.
#[derive(Clone)]
struct Best<Point> {
    point: Arc<Point>,
    multipliers: Multipliers,
    residual: KktResidual,
    objective: f64,
    infeasibility: f64,
    trust_radius: f64,
}

const UNKNOWN_RESIDUAL: KktResidual = KktResidual {
    stationarity: f64::INFINITY,
    feasibility: f64::INFINITY,
    complementarity: f64::INFINITY,
};

impl<'a, P: LiftedProgram> Run<'a, P> {
    pub(super) fn begin(
        program: &'a P,
        point: P::Point,
        settings: &'a SqpSettings,
    ) -> Result<Self, Box<SqpOutcome<P::Point>>> {
        let started = Instant::now();
        let evaluation = match program.evaluate(&point) {
            Ok(evaluation) => evaluation,
            Err(failure) => {
                let status = SqpStatus::Failed(failure.0);
                return Err(Box::new(SqpOutcome::without_start(point, status)));
            }
        };
        let outside = match distance_from_sets(program.sets(), program.variables(&point)) {
            Ok(outside) => outside,
            Err(error) => {
                let words = format!("no variables are in all convex sets ({error})");
                let status = SqpStatus::Failed(words);
                return Err(Box::new(SqpOutcome::without_start(point, status)));
            }
        };
        let point = Arc::new(point);
        let multipliers = Multipliers::zeros(
            evaluation.constraints.len(),
            evaluation.inequalities.len(),
            program.sets(),
        );
        Ok(Self {
            program,
            settings,
            started,
            filter: Filter::new(program.infeasibility(&evaluation)),
            care: Care::NotYet,
            best: Best {
                point: Arc::clone(&point),
                multipliers: multipliers.clone(),
                residual: UNKNOWN_RESIDUAL,
                objective: program.total_objective(&evaluation),
                infeasibility: f64::INFINITY,
                trust_radius: first_trust_radius(program.variables(&point)),
            },
            trust_radius: first_trust_radius(program.variables(&point)),
            outside,
            screening_margin: program.screening_margin(),
            softness: Vec::new(),
            groups: Vec::new(),
            route: match program.n_states() {
                Some(_) => settings.qp,
                None => QpRoute::Condensed,
            },
            kept: None,
            least_curvature: 1.0,
            working: Vec::new(),
            point,
            evaluation,
            multipliers,
            has_multipliers: false,
            elastic_weight: None,
            stuck: 0,
            restored_at: 0,
            rescues: 0,
            refused_in_a_row: 0,
            null_steps: 0,
            filter_resets: 0,
            merit_steps: 0,
            exact_pause: 0,
            rows_let_go: Vec::new(),
            sets_let_go: Vec::new(),
            restoration: None,
            restorations: 0,
            returns: 0,
            rounding: 0.0,
            descent: None,
            escapes: 0,
            saddle: None,
            left_to_gain: None,
            has_rolled_out: false,
            history: Vec::new(),
            phases: PhaseTimes::default(),
            failed_subproblem: None,
        })
    }

    fn variables(&self) -> &[f64] {
        self.program.variables(&self.point)
    }

    fn infeasibility(&self) -> f64 {
        self.program.infeasibility(&self.evaluation)
    }

    /// Whether the exact Hessian is to be used at the present point.
    fn wants_curvature(&self) -> bool {
        if self.restoration.is_some() {
            return false;
        }
        match self.settings.hessian {
            HessianChoice::GaussNewton => false,
            // Without multipliers there is no Lagrangian yet.
            HessianChoice::Exact => self.has_multipliers || !self.history.is_empty(),
            HessianChoice::Auto if self.history.is_empty() => {
                self.has_multipliers && self.infeasibility() < EXACT_BELOW_WITH_MULTIPLIERS
            }
            HessianChoice::Auto => self.history.last().is_some_and(|last| {
                let infeasibility = self.infeasibility();
                let is_near =
                    last.residual.stationarity < EXACT_BELOW && infeasibility < EXACT_BELOW;
                // What the elastic weight limits is no multiplier.
                let has_multipliers =
                    last.slack < NO_SLACK && infeasibility < EXACT_BELOW_WITH_MULTIPLIERS;
                self.exact_pause == 0 && (is_near || has_multipliers)
            }),
        }
    }

    /// What the stopping test reads at the present point. A curvature that is wanted for the step from there waits for the test.
    pub(super) fn derivatives(&mut self) -> Result<Derivatives<P>, Failure> {
        if !self.wants_curvature() {
            let linearization = self.linearize(None)?;
            return Ok(Derivatives::Linearized(Box::new(linearization)));
        }
        let clock = Instant::now();
        let terms =
            (self.program).lagrangian_terms(&self.point, &self.evaluation, &self.multipliers)?;
        self.phases.linearize += clock.elapsed().as_secs_f64();
        Ok(Derivatives::Gradient(terms))
    }

    /// The linearization at the present point; with the curvature of the Lagrangian if the terms of its gradient are given.
    fn linearize(
        &mut self,
        terms: Option<LagrangianTerms<P::Costates>>,
    ) -> Result<Linearization, Failure> {
        let clock = Instant::now();
        let request = LinearizationRequest {
            multipliers: terms.is_some().then_some(&self.multipliers),
            rows: &self.candidates(),
        };
        let (point, evaluation) = (&self.point, &self.evaluation);
        let linearization = match terms.and_then(|terms| terms.costates) {
            Some(costates) => (self.program).linearize_with(point, evaluation, &request, costates),
            None => self.program.linearize(point, evaluation, &request),
        }?;
        self.least_curvature = linearization.least_curvature();
        self.note_rows(&linearization);
        self.keep_states(&linearization)?;
        self.phases.linearize += clock.elapsed().as_secs_f64();
        Ok(linearization)
    }

    /// On the sparse route: the linearization with its states.
    fn keep_states(&mut self, linearization: &Linearization) -> Result<(), Failure> {
        if self.route == QpRoute::Sparse {
            let rows = &linearization.rows;
            self.kept = self.program.keep_states(&self.point, rows)?;
        }
        Ok(())
    }

    pub(super) fn residual(&self, derivatives: &Derivatives<P>) -> KktResidual {
        match derivatives {
            Derivatives::Linearized(linearization) => self.linearized_residual(linearization),
            Derivatives::Gradient(terms) => KktResidual::of_terms(
                self.program,
                &self.point,
                &self.evaluation,
                terms,
                self.least_curvature,
                &self.multipliers,
            ),
        }
    }

    fn linearized_residual(&self, linearization: &Linearization) -> KktResidual {
        KktResidual::of(
            self.program,
            &self.point,
            &self.evaluation,
            linearization,
            &self.multipliers,
        )
    }

    pub(super) fn record(&mut self, iteration: usize, residual: KktResidual) {
        let infeasibility = self.infeasibility();
        let objective = self.program.total_objective(&self.evaluation);
        self.history.push(IterationRecord {
            iteration,
            objective,
            residual,
            infeasibility,
            step_norm: 0.0,
            contraction: None,
            left: Leave::End,
            hessian: HessianKind::GaussNewton,
            corrections: 0,
            rolled_out: false,
            trust_radius: self.trust_radius,
            elastic_weight: self.elastic_weight.unwrap_or(0.0),
            slack: 0.0,
            linearized_rows: 0,
            working_rows: 0,
            qp_iterations: 0,
            elapsed: self.started.elapsed().as_secs_f64(),
        });
        // A point outside of the sets is none that could be used.
        let infeasibility = infeasibility + self.outside;
        let feasible = self.settings.tolerance;
        let better = if infeasibility.max(self.best.infeasibility) <= feasible {
            residual.max() <= self.best.residual.max()
        } else {
            infeasibility <= self.best.infeasibility
        };
        if better {
            self.best = Best {
                point: Arc::clone(&self.point),
                multipliers: self.multipliers.clone(),
                residual,
                objective,
                infeasibility,
                trust_radius: self.trust_radius,
            };
        }
    }

    /// KKT residual of the best point.
    pub(super) fn best_residual(&self) -> KktResidual {
        self.best.residual
    }

    /// KKT residual of the point before.
    pub(super) fn last_residual(&self) -> Option<KktResidual> {
        self.history.last().map(|row| row.residual)
    }

    /// Defects of the states.
    pub(super) fn defect(&self) -> f64 {
        self.evaluation.defect
    }

    /// Defects that rounding leaves; 0 as long as no states have been computed.
    pub(super) fn rounding(&self) -> f64 {
        self.rounding
    }

    /// Why the solve is to end before it is done, if it is.
    pub(super) fn stopped(&self) -> Option<Stop> {
        self.settings.stop.raised()
    }

    /// One iteration: subproblems of shrinking trust radius, until one's step is accepted, or a step of the restoration.
    pub(super) fn step(&mut self, derivatives: Derivatives<P>) -> Result<Step, Breakdown> {
        let mut linearization = match derivatives {
            Derivatives::Linearized(linearization) => *linearization,
            Derivatives::Gradient(terms) => self.linearize(Some(terms))?,
        };
        if self.restoration.is_some() {
            return self.restoration_step(linearization);
        }
        let clock = Instant::now();
        self.rows_let_go.clear();
        self.sets_let_go.clear();
        self.take_care();
        let mut model = self.model_hessian(&linearization);
        match model.kind {
            HessianKind::Exact => self.descent = None,
            HessianKind::Convexified => self.descent = model.descent.clone(),
            _ => {}
        }
        let mut sets = self.subproblem_sets(&model);
        self.phases.condense += clock.elapsed().as_secs_f64();
        let (mut refusals, mut joins, mut releases) = (0, 0, 0);
        while refusals <= SHRINKAGES {
            let solution = match self.solve_subproblem(&mut linearization, &model, &sets) {
                Ok(solution) => solution,
                Err(_) if self.stopped().is_some() => return Ok(Step::Refused),
                Err(Breakdown::Subproblem(error)) => match self.recover(error)? {
                    Recovery::Smaller => continue,
                    Recovery::Restarted => return Ok(Step::Restarted),
                },
                Err(error) => return Err(error),
            };
            self.note_subproblem(model.kind, &linearization, &solution);
            if releases < RELEASES && self.lets_go(&linearization, &model, &solution) {
                releases += 1;
                model = self.model_hessian(&linearization);
                sets = self.subproblem_sets(&model);
                continue;
            }
            if self.is_stuck(&linearization, &model, &sets, &solution) {
                return self.restore(linearization);
            }
            let solution = if refusals == 0 {
                self.past_saddle(&model, solution)
            } else {
                solution
            };
            let clock = Instant::now();
            let found = self.search(&linearization, &model, &sets, &solution);
            self.phases.globalize += clock.elapsed().as_secs_f64();
            match found {
                Ok(accepted) => {
                    self.note_refusals(refusals);
                    self.take(accepted, &linearization, &model, &solution);
                    return Ok(Step::Taken);
                }
                // A trial that fails by what was screened out says nothing about the trust region, unless that goes on and on.
                Err(Some(trial))
                    if joins < TRIAL_JOINS
                        && self.join(&mut linearization, &trial.inequalities)? =>
                {
                    joins += 1;
                }
                Err(_) => {
                    self.trust_radius = SHRINK * norm(&solution.change).min(self.trust_radius);
                    refusals += 1;
                }
            }
            if self.stopped().is_some() {
                return Ok(Step::Refused);
            }
        }
        if self.infeasibility() > self.settings.tolerance && self.restorations < RESTORATIONS {
            return self.restore(linearization);
        }
        // Not even a short step: forget the past once more, before giving up.
        let was_careful = self.care == Care::Taken;
        if self.filter_resets < FILTER_RESETS && (self.filter.has_entries() || was_careful) {
            self.filter_resets += 1;
            if was_careful {
                self.care = Care::GivenUp;
            }
            self.forget();
            return Ok(Step::Restarted);
        }
        Ok(Step::Refused)
    }

    /// Hessian of this iteration's subproblems.
    fn model_hessian(&mut self, linearization: &Linearization) -> ModelHessian {
        self.exact_pause = self.exact_pause.saturating_sub(1);
        if linearization.curvature.is_none() {
            return ModelHessian::gauss_newton(linearization);
        }
        let active = self.active_set(linearization);
        self.exact_hessian(linearization, active)
    }

    /// The exact Hessian; where its factorizations take long and the solve is stopped meanwhile, that of Gauss-Newton, which nobody uses.
    fn exact_hessian(&self, linearization: &Linearization, active: ActiveSet) -> ModelHessian {
        let sets = self.program.sets();
        if self.variables().len() < LARGE || !self.settings.stop.is_possible() {
            return ModelHessian::exact(linearization, sets, &active);
        }
        let (own, sets) = (linearization.clone(), sets.to_vec());
        (self.settings.stop)
            .unless_raised(LARGE, move || ModelHessian::exact(&own, &sets, &active))
            .unwrap_or_else(|_| ModelHessian::gauss_newton(linearization))
    }

    fn active_set(&self, linearization: &Linearization) -> ActiveSet {
        let mut active = ActiveSet::of(
            linearization,
            &self.softness,
            self.program.sets(),
            self.variables(),
            &self.multipliers,
        );
        (active.rows).retain(|&at| !self.rows_let_go.contains(&linearization.rows[at]));
        (active.normals).retain(|held| !self.sets_let_go.contains(&held.set));
        active
    }

    /// Whether a step leaves some of what the model's Hessian takes for held, where its terms would falsify gradient and multipliers; the
    /// model is then to be made anew without it.
    fn lets_go(
        &mut self,
        linearization: &Linearization,
        model: &ModelHessian,
        solution: &QpSolution,
    ) -> bool {
        if !model.holds {
            return false;
        }
        let active = self.active_set(linearization);
        let left = active.left_by(linearization, &solution.change, &solution.multipliers);
        let any = !(left.rows.is_empty() && left.normals.is_empty());
        let rows = left.rows.iter().map(|&at| linearization.rows[at]);
        self.rows_let_go.extend(rows);
        (self.sets_let_go).extend(left.normals.iter().map(|held| held.set));
        any
    }

    /// A filter that refuses the first trial again and again remembers a place that the iteration cannot get back to:
    /// it is emptied (Wächter and Biegler 2006, section 3.4), at most a few times.
    fn note_refusals(&mut self, refusals: usize) {
        let last = self.history.last().map(|row| row.hessian);
        if refusals >= EXACT_REFUSALS && last.is_some_and(HessianKind::is_second_order) {
            self.exact_pause = EXACT_PAUSE;
        }
        // Careful steps are as long as they can be.
        self.refused_in_a_row = if refusals > 0 && self.care != Care::Taken {
            self.refused_in_a_row + 1
        } else {
            0
        };
        if self.refused_in_a_row >= REFUSALS_IN_A_ROW && self.filter_resets < FILTER_RESETS {
            self.filter_resets += 1;
            self.refused_in_a_row = 0;
            self.filter = Filter::new(self.infeasibility());
        }
    }

    fn note_subproblem(
        &mut self,
        kind: HessianKind,
        linearization: &Linearization,
        solution: &QpSolution,
    ) {
        let (weight, radius) = (self.elastic_weight.unwrap_or(0.0), self.trust_radius);
        if let Some(row) = self.history.last_mut() {
            row.hessian = kind;
            row.slack = solution.slack;
            row.linearized_rows = linearization.rows.len();
            row.working_rows = solution.working.len();
            row.qp_iterations += solution.iterations;
            row.elastic_weight = weight;
            row.trust_radius = radius;
        }
    }

    /// Goes to an accepted point.
    fn take(
        &mut self,
        accepted: Accepted<P>,
        linearization: &Linearization,
        model: &ModelHessian,
        solution: &QpSolution,
    ) {
        let length = norm(&solution.change);
        self.note_step(&accepted, length);
        self.null_steps = if length <= self.negligible() {
            self.null_steps + 1
        } else {
            0
        };
        let is_optimal = (self.history.last())
            .is_some_and(|row| row.residual.stationarity <= self.settings.tolerance);
        if model.holds && !is_optimal && length <= self.negligible() {
            // What is left of the gradient is what the model holds without it being held.
            self.exact_pause = EXACT_PAUSE;
        }
        let weight = self.merit_weight(solution);
        let promise = self.promise(linearization, model, solution, weight);
        let before = self.merit(&self.evaluation, weight);
        let delivered = before - self.merit(&accepted.evaluation, weight);
        let noise = MERIT_ROUNDING * before.abs() + solution.multipliers.row_noise();
        // Lifted states are off by their own second order, which near feasibility is all there is to see. Steps of the
        // exact Hessian contract until rounding, or lead away from a saddle.
        let is_blind = promise.abs() <= noise
            || (!accepted.rolled_out
                && !model.kind.is_second_order()
                && accepted.evaluation.defect > 0.0
                && self.infeasibility() <= FEASIBLE
                && self.program.infeasibility(&accepted.evaluation) <= FEASIBLE);
        let contraction = (self.history.last()).and_then(|row| row.contraction);
        let is_good = if is_blind {
            // Steps that do not contract by themselves are made to.
            contraction.is_some_and(|ratio| ratio < SLOW_CONTRACTION)
        } else {
            // Every lifted step leaves defects; farther out they say nothing about the radius.
            !accepted.rolled_out || delivered > GOOD_RATIO * promise
        };
        let is_poor = if is_blind {
            !is_good
        } else {
            accepted.rolled_out && !(delivered > POOR_RATIO * promise)
        };
        if is_good && length > 0.5 * self.trust_radius {
            self.trust_radius *= GROW;
        } else if is_poor && length > self.negligible() {
            let least = LEAST_TRUST_RADIUS * norm(self.variables()).max(1.0);
            self.trust_radius = self.trust_radius.min((length * POOR_SHRINK).max(least));
        }
        self.multipliers = solution.multipliers.clone();
        self.arrive(accepted);
    }

    /// Whether steps were accepted that go nowhere, one after the other; they are counted anew from here.
    pub(super) fn stands_still(&mut self) -> bool {
        let stands = self.null_steps >= NULL_STEPS;
        if stands {
            self.null_steps = 0;
        }
        stands
    }

    /// Length of a step that goes nowhere.
    fn negligible(&self) -> f64 {
        NO_STEP * norm(self.variables()).max(1.0)
    }

    fn note_step(&mut self, accepted: &Accepted<P>, length: f64) {
        let before = (self.history.iter().rev())
            .map(|row| row.step_norm)
            .find(|&step| step > 0.0);
        if let Some(row) = self.history.last_mut() {
            row.step_norm = length;
            row.left = if length > 0.0 {
                Leave::Step
            } else {
                Leave::Settled
            };
            row.contraction = before.map(|before| length / before);
            row.corrections = accepted.corrections;
            row.rolled_out = accepted.rolled_out;
        }
    }

    /// Says how the present point was left.
    pub(super) fn leave(&mut self, left: Leave) {
        if let Some(row) = self.history.last_mut() {
            row.left = left;
        }
    }

    fn arrive(&mut self, accepted: Accepted<P>) {
        if accepted.rolled_out {
            self.rounding = accepted.evaluation.defect;
        }
        self.point = Arc::new(accepted.point);
        self.evaluation = accepted.evaluation;
        self.outside = distance_from_sets(self.program.sets(), self.variables()).unwrap_or(0.0);
    }

    /// Weight of infeasibility in the merit that sizes the trust region: above every multiplier.
    fn merit_weight(&self, solution: &QpSolution) -> f64 {
        2.0 * self.largest_multiplier(solution)
    }

    /// What the subproblem promised to take off the merit `J + weight · infeasibility`.
    fn promise(
        &self,
        linearization: &Linearization,
        model: &ModelHessian,
        solution: &QpSolution,
        weight: f64,
    ) -> f64 {
        let change = &solution.change;
        let n = change.len();
        let mut bending = model.constant;
        for i in 0..n {
            let bent: f64 = (0..n).map(|j| model.matrix[(i, j)] * change[j]).sum();
            let held = model.gradient[i] - linearization.model_gradient[i];
            bending += change[i] * (held + 0.5 * bent);
        }
        let slope = self.departure(linearization, model, solution).slope(change);
        let [now, then] = [self.infeasibility(), solution.slack].map(|at| self.counted(at));
        weight * (now - then) - bending - slope
    }

    /// What of an infeasibility counts in the merit: what careful steps may miss is no loss.
    fn counted(&self, infeasibility: f64) -> f64 {
        if self.care == Care::Taken {
            infeasibility.max(CAREFUL_MISS)
        } else {
            infeasibility
        }
    }

    /// `J + weight · infeasibility`
    fn merit(&self, values: &Evaluation<P::Defects>, weight: f64) -> f64 {
        let infeasibility = self.counted(self.program.infeasibility(values));
        self.program.total_objective(values) + weight * infeasibility
    }

    fn departure<'b>(
        &'b self,
        linearization: &'b Linearization,
        model: &ModelHessian,
        solution: &'b QpSolution,
    ) -> Departure<'b, P> {
        Departure {
            point: &self.point,
            evaluation: &self.evaluation,
            linearization,
            softness: &self.softness,
            multipliers: &solution.multipliers,
            is_second_order: model.kind.is_second_order(),
        }
    }

    /// Whether several subproblems in a row could not promise a smaller infeasibility, even without a trust region.
    fn is_stuck(
        &mut self,
        linearization: &Linearization,
        model: &ModelHessian,
        sets: &[ConvexSet],
        solution: &QpSolution,
    ) -> bool {
        let violation = self.linear_violation(linearization);
        let promises_nothing = |slack: f64| {
            slack > self.settings.tolerance && violation - slack < INFEASIBLE_PROGRESS * violation
        };
        let hopeless = promises_nothing(solution.slack)
            && self.evaluation.defect < INFEASIBLE_PROGRESS * violation
            && (norm(&solution.change) < 0.5 * self.trust_radius || {
                let weight = self.elastic_weight.unwrap_or(0.0);
                let first = self.first_rows(linearization);
                let free = QuadraticProgram {
                    trust_radius: f64::INFINITY,
                    ..self.subproblem(linearization, model, sets, weight, &first)
                };
                free.solve().is_ok_and(|free| promises_nothing(free.slack))
            });
        self.stuck = if hopeless { self.stuck + 1 } else { 0 };
        self.stuck >= INFEASIBLE_PATIENCE || self.crawls()
    }

    /// Whether the infeasibility hardly fell over many iterations: the restoration gets on, or proves that there is no way.
    fn crawls(&self) -> bool {
        let seen = &self.history[self.restored_at.min(self.history.len())..];
        let Some(before) = (seen.len().checked_sub(CRAWL + 1)).map(|at| &seen[at..]) else {
            return false;
        };
        let least = (before.iter().map(|row| row.infeasibility)).fold(f64::INFINITY, f64::min);
        self.restorations < RESTORATIONS
            && least > CRAWL_INFEASIBILITY
            && least > CRAWL_GAIN * before[0].infeasibility
    }

    /// Infeasibility that the linearization sees here: its slack without a step.
    fn linear_violation(&self, linearization: &Linearization) -> f64 {
        let rows = self.softness.iter().zip(&self.groups);
        let hard = (linearization.inequality_offset.iter().zip(rows))
            .filter(|(_, (softness, _))| **softness == Softness::Hard)
            .map(|(h, (_, group))| (*group, *h));
        linearization.offset.iter().map(|c| c.abs()).sum::<f64>() + sum_of_largest(hard)
    }

    /// The accepted step, or the values of the trial that was refused.
    fn search(
        &mut self,
        linearization: &Linearization,
        model: &ModelHessian,
        sets: &[ConvexSet],
        solution: &QpSolution,
    ) -> Result<Accepted<P>, Option<Refused>> {
        let weight = self.elastic_weight.unwrap_or(0.0);
        let mut filter = self.filter.clone();
        let verdict = filter.accept(
            self.program,
            &self.departure(linearization, model, solution),
            &self.subproblem(linearization, model, sets, weight, &solution.working),
            &solution.change,
        );
        self.filter = filter;
        match verdict {
            Ok(accepted) => Ok(accepted),
            Err(Some(refused)) => {
                if self.passes_by_merit(linearization, model, solution, refused.measure)
                    && let Some(there) =
                        Filter::rollout(self.program, &self.point, &solution.change, 0)
                {
                    self.merit_steps += 1;
                    self.filter = Filter::new(self.infeasibility());
                    Ok(there)
                } else {
                    Err(Some(refused))
                }
            }
            Err(None) => Err(None),
        }
    }

    /// What the filter refuses may still be what the elastic subproblem set out to do: lower `J + γ · infeasibility`.
    /// A point far below in infeasibility, visited and left for a better objective, must not block the way back for
    /// ever; such a step empties the filter.
    fn passes_by_merit(
        &self,
        linearization: &Linearization,
        model: &ModelHessian,
        solution: &QpSolution,
        refused: Measure,
    ) -> bool {
        let Some(weight) = self.elastic_weight else {
            return false;
        };
        let is_barred = self.merit_steps >= MERIT_STEPS || self.care == Care::Taken;
        if is_barred || self.evaluation.defect > self.settings.tolerance {
            return false;
        }
        let promise = self.promise(linearization, model, solution, weight);
        let delivered = self.merit(&self.evaluation, weight) - refused.merit(weight);
        promise > 0.0 && delivered >= MERIT_RATIO * promise
    }

    /// The row of the last iteration.
    pub(super) fn last(&self) -> Option<&IterationRecord> {
        self.history.last()
    }

    /// Rows so far.
    pub(super) fn n_rows(&self) -> usize {
        self.history.len()
    }

    /// Takes over what another solve knew, besides its point.
    pub(super) fn warm(&mut self, start: &WarmStart<P::Point>) -> Result<(), String> {
        let (own, other) = (&self.multipliers, &start.multipliers);
        let sizes = |m: &Multipliers| (m.constraints.len(), m.inequalities.len(), m.normals.len());
        if sizes(own) != sizes(other) {
            return Err(format!(
                "a warm start with {:?} constraints, inequalities and sets for a program with {:?}",
                sizes(other),
                sizes(own)
            ));
        }
        self.multipliers = start.multipliers.clone();
        self.best.multipliers = start.multipliers.clone();
        self.working.clone_from(&start.working_rows);
        self.elastic_weight = start.elastic_weight;
        self.trust_radius = start.trust_radius;
        self.best.trust_radius = start.trust_radius;
        self.has_multipliers = true;
        Ok(())
    }

    /// What another solve may take over.
    pub(super) fn warm_start(&self) -> WarmStart<P::Point> {
        WarmStart {
            point: P::Point::clone(&self.point),
            multipliers: self.multipliers.clone(),
            working_rows: self.working.clone(),
            elastic_weight: self.elastic_weight,
            trust_radius: self.trust_radius,
        }
    }

    /// What was found; where a saddle was left for nothing better, the saddle.
    pub(super) fn end(mut self, mut status: SqpStatus) -> SqpOutcome<P::Point> {
        if status != SqpStatus::Converged
            && let Some(saddle) = self.saddle.take()
        {
            self.best = saddle;
            if !matches!(status, SqpStatus::Stopped(_)) {
                status = SqpStatus::Converged;
            }
        }
        let failed_subproblem = match status {
            SqpStatus::Converged => None,
            _ => self.failed_subproblem,
        };
        drop((self.point, self.saddle));
        SqpOutcome {
            status,
            point: Arc::unwrap_or_clone(self.best.point),
            multipliers: self.best.multipliers,
            residual: self.best.residual,
            objective: self.best.objective,
            route: self.route,
            convergence: Convergence::of(&self.history),
            history: self.history,
            phases: self.phases,
            failed_subproblem,
            left_to_gain: self.left_to_gain,
        }
    }
}

fn first_trust_radius(variables: &[f64]) -> f64 {
    FIRST_TRUST_RADIUS * norm(variables).max(1.0)
}

/// Whether variables are in all sets, but for rounding; those that are no numbers are not.
fn is_within(sets: &[ConvexSet], variables: &[f64]) -> bool {
    let size = norm(variables).max(1.0);
    (sets.iter()).all(|set| set.violation(variables) <= SET_TOLERANCE * size)
}

/// How far variables are from the intersection of the sets; 0 inside.
fn distance_from_sets(sets: &[ConvexSet], variables: &[f64]) -> Result<f64, QpError> {
    if is_within(sets, variables) {
        return Ok(0.0);
    }
    let n = variables.len();
    let projection = QuadraticProgram {
        hessian: &Mat::identity(n, n),
        gradient: &vec![0.0; n],
        jacobian: &Mat::zeros(0, n),
        offset: &[],
        inequalities: LinearInequalities {
            jacobian: &Mat::zeros(0, n),
            offset: &[],
            softness: &[],
            groups: &[],
            first: &[],
        },
        variables,
        sets,
        elastic_weight: 1.0,
        trust_radius: f64::INFINITY,
        row_tolerance: ROW_TOLERANCE,
        stop: None,
        states: None,
        expected: None,
    };
    Ok(norm(&projection.solve()?.change))
}
