//! The state of a solve in progress, and one iteration of its loop.

mod hessian;
mod restoration;
mod saddle;
mod subproblem;
mod warm_start;

use std::sync::Arc;
use std::time::Instant;

use faer::Mat;

use self::restoration::Restoration;
pub use self::warm_start::WarmStart;
use super::best_point::Best;
use super::filter::Filter;
use super::hessian::{HessianKind, ModelHessian};
use super::kept_states::{QpRoute, StateLinearization};
use super::kkt::KktResidual;
use super::norms::norm;
use super::outcome::{Convergence, IterationRecord, SqpOutcome, SqpStatus};
use super::program::Multipliers;
use super::program::{
    ConvexSet, Evaluation, Failure, LagrangianTerms, LiftedProgram, Linearization,
    LinearizationRequest, Softness, norm_without, sum_of_largest, unlimited,
};
use super::progress::Standstill;
use super::quadratic_program::{LinearInequalities, QpError, QpSolution, QuadraticProgram};
use super::settings::{
    HessianChoice, MERIT_ROUNDING, NEGLIGIBLE, ROW_TOLERANCE, SCALED_UNIT, SqpSettings,
};
use super::trace::Trace;
use super::trial::{Accepted, Departure};
use super::trust_region::TrustRegion;
use super::working_set::WorkingSet;
use stop::{Stop, StopSignal};

/// A subproblem that reduces the infeasibility by less than this fraction makes no progress, and defects below this fraction of it do not
/// falsify it. It is a choice above the fraction that the filter asks of a step, 1e-5, and above what [`NEGLIGIBLE`] slacks falsify.
const INFEASIBLE_PROGRESS: f64 = 1e-3;
/// Cap on such subproblems in a row: after these, the restoration begins.
const INFEASIBLE_PATIENCE: usize = 3;
/// Cap on the shrinkages of the trust region in one iteration: [`trust_region`](super::trust_region) shrinks it by 0.3¹² ≈ 5e-7 then.
const SHRINKAGES: usize = 12;
/// Cap on the subproblems without a solution, and on the restorations, of one solve.
const RESCUES: usize = 8;
/// Maximum number of Hessian rebuilds per iteration after a step leaves its active set.
const RELEASES: usize = 3;

/// The derivatives that the stopping test reads at a point.
pub(super) enum Derivatives<P: LiftedProgram> {
    /// The linearization, for a Gauss-Newton step or a restoration step.
    Linearized(Box<Linearization>),
    /// The gradient of the Lagrangian; the linearization with curvature is computed only if the point does not pass.
    Gradient(LagrangianTerms<P::Costates>),
}

/// Result of an iteration.
pub(super) enum Step {
    Taken,
    Refused,
    Infeasible,
}

/// The reason why a solve cannot continue.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(super) enum Breakdown {
    #[error(transparent)]
    Subproblem(#[from] QpError),
    #[error(transparent)]
    Model(#[from] Failure),
}

/// The state of a solve in progress.
pub(super) struct Run<'a, P: LiftedProgram> {
    program: &'a P,
    settings: &'a SqpSettings,
    iterate: Iterate<P>,
    working_set: WorkingSet,
    /// Elastic weight of the subproblem; the first linearization determines the first one.
    elastic_weight: Option<f64>,
    trust_region: TrustRegion,
    /// [Variables](unlimited) that the trust region does not limit.
    unlimited: Vec<usize>,
    filter: Filter,
    hessian: HessianPolicy,
    feasibility: Feasibility,
    states: States,
    best: Best<P::Point>,
    trace: Trace,
}

/// The present iterate.
struct Iterate<P: LiftedProgram> {
    point: Arc<P::Point>,
    evaluation: Evaluation<P::Defects>,
    multipliers: Multipliers,
    /// Tells whether the first multipliers come from another solve.
    has_multipliers: bool,
    /// Distance of the variables from the sets; only at the start can it be positive.
    outside: f64,
    /// Defects of the last rollout, which are rounding; 0 before the first.
    rounding: f64,
}

/// State from which the Hessian of the next subproblem follows, besides the linearization.
#[derive(Default)]
struct HessianPolicy {
    /// [Least curvature](Linearization::least_curvature) of the last linearization.
    least_curvature: f64,
    /// Inequalities and sets that steps of this iteration have left.
    left_rows: Vec<usize>,
    left_sets: Vec<usize>,
}

/// Evidence against feasible constraints.
#[derive(Default)]
struct Feasibility {
    /// Number of subproblems in a row without progress in infeasibility.
    stuck: usize,
    restorations: usize,
    /// The restoration in progress.
    phase: Option<Restoration>,
}

/// The linearization with states, on the sparse route.
struct States {
    route: QpRoute,
    linearization: Option<StateLinearization>,
}

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
        let multipliers = Multipliers::zeros(
            evaluation.constraints.len(),
            evaluation.inequalities.len(),
            program.sets(),
        );
        let point = Arc::new(point);
        let unlimited = unlimited(program, program.variables(&point).len());
        let trust_region = TrustRegion::around(program.variables(&point), &unlimited);
        Ok(Self {
            program,
            settings,
            working_set: WorkingSet::new(program.screening_margin()),
            elastic_weight: None,
            filter: Filter::new(program.infeasibility(&evaluation)),
            hessian: HessianPolicy {
                least_curvature: 1.0,
                ..HessianPolicy::default()
            },
            feasibility: Feasibility::default(),
            states: States {
                route: match program.n_states() {
                    Some(_) => settings.qp,
                    None => QpRoute::Condensed,
                },
                linearization: None,
            },
            best: Best::none(
                Arc::clone(&point),
                multipliers.clone(),
                program.total_objective(&evaluation),
            ),
            trust_region,
            unlimited,
            iterate: Iterate {
                point,
                evaluation,
                multipliers,
                has_multipliers: false,
                outside,
                rounding: 0.0,
            },
            trace: Trace::new(started),
        })
    }

    fn variables(&self) -> &[f64] {
        self.program.variables(&self.iterate.point)
    }

    /// Returns the norm of the variables, or of a step of them, that the trust region limits.
    fn length(&self, v: &[f64]) -> f64 {
        norm_without(v, &self.unlimited)
    }

    fn infeasibility(&self) -> f64 {
        self.program.infeasibility(&self.iterate.evaluation)
    }

    /// Tells whether the next step uses the exact Hessian.
    fn wants_curvature(&self) -> bool {
        if self.feasibility.phase.is_some() {
            return false;
        }
        match self.settings.hessian {
            HessianChoice::GaussNewton => false,
            // The Lagrangian needs multipliers, and those of another solve belong to a point near its own.
            HessianChoice::Exact => self.iterate.has_multipliers || !self.trace.history.is_empty(),
            HessianChoice::Auto if !self.program.knows_curvature() => false,
            HessianChoice::Auto if self.iterate.has_multipliers => {
                self.infeasibility() < SCALED_UNIT
            }
            // The multipliers of a subproblem with slack are limited by the elastic weight and are no estimate of those of the program.
            HessianChoice::Auto => (self.trace.history.last()).is_some_and(|last| {
                last.slack <= NEGLIGIBLE && last.step.hessian != HessianKind::Proximal
            }),
        }
    }

    /// Computes the derivatives for the stopping test at the present point; the curvature for a step follows after the test.
    pub(super) fn derivatives(&mut self) -> Result<Derivatives<P>, Failure> {
        if !self.wants_curvature() {
            let linearization = self.linearize(None)?;
            return Ok(Derivatives::Linearized(Box::new(linearization)));
        }
        let clock = Instant::now();
        let terms = (self.program).lagrangian_terms(
            &self.iterate.point,
            &self.iterate.evaluation,
            &self.iterate.multipliers,
        )?;
        self.trace.phases.linearize += clock.elapsed().as_secs_f64();
        Ok(Derivatives::Gradient(terms))
    }

    /// Linearizes at the present point, with the curvature of the Lagrangian if the terms of its gradient are given.
    fn linearize(
        &mut self,
        terms: Option<LagrangianTerms<P::Costates>>,
    ) -> Result<Linearization, Failure> {
        let clock = Instant::now();
        let request = LinearizationRequest {
            multipliers: terms.is_some().then_some(&self.iterate.multipliers),
            rows: &self.candidates(),
        };
        let (point, evaluation) = (&self.iterate.point, &self.iterate.evaluation);
        let linearization = match terms.and_then(|terms| terms.costates) {
            Some(costates) => (self.program).linearize_with(point, evaluation, &request, costates),
            None => self.program.linearize(point, evaluation, &request),
        }?;
        self.hessian.least_curvature = linearization.least_curvature();
        self.note_rows(&linearization);
        self.keep_states(&linearization)?;
        self.trace.phases.linearize += clock.elapsed().as_secs_f64();
        Ok(linearization)
    }

    /// Computes the linearization with states, on the sparse route.
    fn keep_states(&mut self, linearization: &Linearization) -> Result<(), Failure> {
        if self.states.route == QpRoute::Sparse {
            let rows = &linearization.rows;
            self.states.linearization = self.program.keep_states(&self.iterate.point, rows)?;
        }
        Ok(())
    }

    pub(super) fn residual(&self, derivatives: &Derivatives<P>) -> KktResidual {
        match derivatives {
            Derivatives::Linearized(linearization) => self.linearized_residual(linearization),
            Derivatives::Gradient(terms) => KktResidual::of_terms(
                self.program,
                &self.iterate.point,
                &self.iterate.evaluation,
                terms,
                self.hessian.least_curvature,
                &self.iterate.multipliers,
            ),
        }
    }

    fn linearized_residual(&self, linearization: &Linearization) -> KktResidual {
        KktResidual::of(
            self.program,
            &self.iterate.point,
            &self.iterate.evaluation,
            linearization,
            &self.iterate.multipliers,
        )
    }

    pub(super) fn record(&mut self, iteration: usize, residual: KktResidual) {
        let infeasibility = self.infeasibility();
        let objective = self.program.total_objective(&self.iterate.evaluation);
        self.trace.history.push(IterationRecord {
            trust_radius: self.trust_region.radius,
            elastic_weight: self.elastic_weight.unwrap_or(0.0),
            elapsed: self.trace.started.elapsed().as_secs_f64(),
            ..IterationRecord::at(iteration, objective, residual, infeasibility)
        });
        // A point outside of the sets cannot be used, so its distance counts as infeasibility.
        let here = Best {
            point: Arc::clone(&self.iterate.point),
            multipliers: self.iterate.multipliers.clone(),
            residual,
            objective,
            infeasibility: infeasibility + self.iterate.outside,
        };
        if here.is_no_worse_than(&self.best, self.settings.tolerance) {
            self.best = here;
        }
    }

    /// Returns the KKT residual of the best point.
    pub(super) fn best_residual(&self) -> KktResidual {
        self.best.residual
    }

    /// Returns the norm of the states' defects at the present point.
    pub(super) fn defect(&self) -> f64 {
        self.iterate.evaluation.defect
    }

    /// Returns the defects that rounding leaves; 0 as long as no rollout was computed.
    pub(super) fn rounding(&self) -> f64 {
        self.iterate.rounding
    }

    /// Returns the reason to end the solve early, if there is one.
    pub(super) fn stopped(&self) -> Option<Stop> {
        self.program.stop().and_then(StopSignal::raised)
    }

    /// Runs one iteration: subproblems of shrinking trust radius until a step is accepted, or a step of the restoration.
    pub(super) fn step(&mut self, derivatives: Derivatives<P>) -> Result<Step, Breakdown> {
        let mut linearization = match derivatives {
            Derivatives::Linearized(linearization) => *linearization,
            Derivatives::Gradient(terms) => self.linearize(Some(terms))?,
        };
        if self.feasibility.phase.is_some() {
            return self.restoration_step(linearization);
        }
        let clock = Instant::now();
        self.hessian.left_rows.clear();
        self.hessian.left_sets.clear();
        let mut model = self.model_hessian(&linearization);
        let mut sets = self.subproblem_sets(&model);
        self.trace.phases.condense += clock.elapsed().as_secs_f64();
        let (mut refusals, mut releases) = (0, 0);
        while refusals <= SHRINKAGES {
            let solution = match self.solve_subproblem(&mut linearization, &model, &sets) {
                Ok(solution) => solution,
                Err(_) if self.stopped().is_some() => return Ok(Step::Refused),
                Err(Breakdown::Subproblem(error)) => {
                    self.shrink_after(error)?;
                    continue;
                }
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
            let solution = self.without_terms(&linearization, &model, solution);
            let solution = if refusals == 0 {
                self.past_saddle(&model, solution)
            } else {
                solution
            };
            let clock = Instant::now();
            let found = self.search(&linearization, &model, &sets, &solution);
            self.trace.phases.globalize += clock.elapsed().as_secs_f64();
            match found {
                Some(accepted) => {
                    self.take(accepted, &linearization, &model, &solution);
                    return Ok(Step::Taken);
                }
                None => {
                    self.trust_region.refuse(self.length(&solution.change));
                    refusals += 1;
                }
            }
            if self.stopped().is_some() {
                return Ok(Step::Refused);
            }
        }
        if self.infeasibility() > self.settings.tolerance && self.feasibility.restorations < RESCUES
        {
            return self.restore(linearization);
        }
        Ok(Step::Refused)
    }

    /// Shrinks the trust region after a subproblem that Clarabel could not solve; returns the error after [`RESCUES`] of them.
    fn shrink_after(&mut self, error: QpError) -> Result<(), QpError> {
        if let QpError::Status { problem, .. } = &error {
            self.trace.failed_subproblem.clone_from(problem);
        }
        self.trace.failures += 1;
        if self.trace.failures > RESCUES {
            return Err(error);
        }
        self.trust_region.refuse(f64::INFINITY);
        Ok(())
    }

    fn note_subproblem(
        &mut self,
        kind: HessianKind,
        linearization: &Linearization,
        solution: &QpSolution,
    ) {
        let (weight, radius) = (self.elastic_weight.unwrap_or(0.0), self.trust_region.radius);
        if let Some(row) = self.trace.history.last_mut() {
            row.step.hessian = kind;
            row.slack = solution.slack;
            row.linearized_rows = linearization.rows.len();
            row.working_rows = solution.working.len();
            row.qp_iterations += solution.iterations;
            row.elastic_weight = weight;
            row.trust_radius = radius;
        }
    }

    /// Moves the iterate to an accepted point and adapts the trust region.
    fn take(
        &mut self,
        accepted: Accepted<P>,
        linearization: &Linearization,
        model: &ModelHessian,
        solution: &QpSolution,
    ) {
        let length = self.length(&solution.change);
        self.trace.note_step(&accepted, length);
        let [promise, before, after] = self.judged(&accepted, linearization, model, solution);
        let delivered = before - after;
        let noise = MERIT_ROUNDING * before.abs() + solution.multipliers.row_noise();
        // Near feasibility, the difference between promised and delivered merit of lifted states is their own second-order error. Steps of
        // the exact Hessian contract until rounding, or lead away from a saddle.
        let is_blind = promise.abs() <= noise
            || (!accepted.rolled_out
                && !model.kind.is_second_order()
                && accepted.evaluation.defect > 0.0
                && self.infeasibility() <= NEGLIGIBLE
                && self.program.infeasibility(&accepted.evaluation) <= NEGLIGIBLE);
        let size = self.length(self.variables()).max(1.0);
        if is_blind {
            let contraction = (self.last()).and_then(|row| row.contraction);
            self.trust_region.contract(contraction, length, size);
        } else {
            // A lifted step leaves defects, so that its merit does not measure the model.
            let ratio = accepted.rolled_out.then_some(delivered / promise);
            self.trust_region.adapt(ratio, length, size);
        }
        self.iterate.multipliers = solution.multipliers.clone();
        self.arrive(accepted);
    }

    fn arrive(&mut self, accepted: Accepted<P>) {
        if accepted.rolled_out {
            self.iterate.rounding = accepted.evaluation.defect;
        }
        self.iterate.point = Arc::new(accepted.point);
        self.iterate.evaluation = accepted.evaluation;
        self.iterate.outside =
            distance_from_sets(self.program.sets(), self.variables()).unwrap_or(0.0);
    }

    /// Returns the weight of infeasibility in the merit that adapts the trust radius: twice the largest multiplier, above which the merit
    /// is exact (Nocedal and Wright 2006, theorem 17.3).
    fn merit_weight(&self, solution: &QpSolution) -> f64 {
        2.0 * self.largest_multiplier(solution)
    }

    /// Returns the decrease of a merit over an accepted step that the subproblem predicts, the merit before it and the merit after it.
    ///
    /// The merit is `J + w θ` with the infeasibility `θ`. Where the Hessian is that of the Lagrangian and the step meets the linearized rows,
    /// it is the augmented Lagrangian `J + yᵀ c + zᵀ h + w θ²` (Nocedal and Wright 2006, section 17.3) with the multipliers of the step:
    /// curved rows are violated by the square of a step, and their multipliers turn this into a change of `J` that the Hessian has already.
    /// `w θ` would charge it a second time, and hold the trust region to steps along which curvature is negligible.
    fn judged(
        &self,
        accepted: &Accepted<P>,
        linearization: &Linearization,
        model: &ModelHessian,
        solution: &QpSolution,
    ) -> [f64; 3] {
        let weight = self.merit_weight(solution);
        let lowered = -self.model_change(linearization, model, solution);
        let is_curved = model.kind.is_second_order() && solution.slack <= NEGLIGIBLE;
        if !is_curved {
            let merit = |values: &Evaluation<P::Defects>| {
                self.program.total_objective(values) + weight * self.program.infeasibility(values)
            };
            let met = self.infeasibility() - solution.slack;
            return [
                weight * met + lowered,
                merit(&self.iterate.evaluation),
                merit(&accepted.evaluation),
            ];
        }
        let departure = self.departure(linearization, model, solution);
        let merit = |values: &Evaluation<P::Defects>| {
            let measure = departure.measure(self.program, values);
            measure.lagrangian + weight * measure.infeasibility.powi(2)
        };
        let first = departure.first_order(self.program, &solution.change);
        let by_rows = first.objective - first.lagrangian;
        [
            weight * self.infeasibility().powi(2) + lowered + by_rows,
            merit(&self.iterate.evaluation),
            merit(&accepted.evaluation),
        ]
    }

    /// Returns the change of the objective that the subproblem predicts, with the penalties of soft rows and without that of its slack.
    fn model_change(
        &self,
        linearization: &Linearization,
        model: &ModelHessian,
        solution: &QpSolution,
    ) -> f64 {
        let change = &solution.change;
        let n = change.len();
        let mut bending = model.constant;
        for i in 0..n {
            let bent: f64 = (0..n).map(|j| model.matrix[(i, j)] * change[j]).sum();
            let held = model.gradient[i] - linearization.model_gradient[i];
            bending += change[i] * (held + 0.5 * bent);
        }
        bending + (self.departure(linearization, model, solution)).slope(change)
    }

    fn departure<'b>(
        &'b self,
        linearization: &'b Linearization,
        model: &ModelHessian,
        solution: &'b QpSolution,
    ) -> Departure<'b, P> {
        Departure {
            point: &self.iterate.point,
            evaluation: &self.iterate.evaluation,
            linearization,
            softness: &self.working_set.softness,
            multipliers: &solution.multipliers,
            is_second_order: model.kind.is_second_order(),
            returned: &solution.returned,
        }
    }

    /// Tells whether [`INFEASIBLE_PATIENCE`] subproblems in a row predicted no smaller infeasibility, even without a trust region.
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
            && self.iterate.evaluation.defect < INFEASIBLE_PROGRESS * violation
            && (!self.trust_region.is_used_by(self.length(&solution.change)) || {
                let weight = self.elastic_weight.unwrap_or(0.0);
                let first = self.first_rows(linearization);
                let free = QuadraticProgram {
                    trust_radius: f64::INFINITY,
                    ..self.subproblem(linearization, model, sets, weight, &first)
                };
                free.solve().is_ok_and(|free| promises_nothing(free.slack))
            });
        self.feasibility.stuck = if hopeless {
            self.feasibility.stuck + 1
        } else {
            0
        };
        self.feasibility.stuck >= INFEASIBLE_PATIENCE
    }

    /// Returns the infeasibility of the linearization: its slack at a zero step.
    fn linear_violation(&self, linearization: &Linearization) -> f64 {
        let rows = self
            .working_set
            .softness
            .iter()
            .zip(&self.working_set.groups);
        let hard = (linearization.inequality_offset.iter().zip(rows))
            .filter(|(_, (softness, _))| **softness == Softness::Hard)
            .map(|(h, (_, group))| (*group, *h));
        linearization.offset.iter().map(|c| c.abs()).sum::<f64>() + sum_of_largest(hard)
    }

    /// Searches for an acceptable step; `None` if all trial points are rejected.
    fn search(
        &mut self,
        linearization: &Linearization,
        model: &ModelHessian,
        sets: &[ConvexSet],
        solution: &QpSolution,
    ) -> Option<Accepted<P>> {
        let weight = self.elastic_weight.unwrap_or(0.0);
        let mut filter = self.filter.clone();
        let verdict = filter.accept(
            self.program,
            &self.departure(linearization, model, solution),
            &self.subproblem(linearization, model, sets, weight, &solution.working),
            &solution.change,
        );
        self.filter = filter;
        verdict
    }

    /// Returns the reason why the last steps made no progress, if they were far below the size of the variables; none in a restoration.
    pub(super) fn standstill(&self) -> Option<Standstill> {
        if self.feasibility.phase.is_some() {
            return None;
        }
        Standstill::of(&self.trace.history, self.length(self.variables()).max(1.0))
    }

    /// Returns the row of the last iteration.
    pub(super) fn last(&self) -> Option<&IterationRecord> {
        self.trace.history.last()
    }

    /// Returns the number of rows so far.
    pub(super) fn n_rows(&self) -> usize {
        self.trace.history.len()
    }

    /// Returns the outcome with the best point.
    pub(super) fn end(self, status: SqpStatus) -> SqpOutcome<P::Point> {
        let failed_subproblem = match status {
            SqpStatus::Converged => None,
            _ => self.trace.failed_subproblem,
        };
        // Dropping the iterate leaves the best point as the only owner of its point.
        drop(self.iterate);
        SqpOutcome {
            status,
            point: Arc::unwrap_or_clone(self.best.point),
            multipliers: self.best.multipliers,
            residual: self.best.residual,
            objective: self.best.objective,
            route: self.states.route,
            convergence: Convergence::of(&self.trace.history),
            history: self.trace.history,
            phases: self.trace.phases,
            failed_subproblem,
        }
    }
}

/// Tells whether variables are in all sets up to rounding; variables that are not finite are not.
fn is_within(sets: &[ConvexSet], variables: &[f64]) -> bool {
    let size = norm(variables).max(1.0);
    (sets.iter()).all(|set| set.violation(variables) <= ROW_TOLERANCE * size)
}

/// Returns the distance of variables from the intersection of the sets; 0 inside.
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
        unlimited: &[],
        row_tolerance: ROW_TOLERANCE,
        stop: None,
        states: None,
        expected: None,
    };
    Ok(norm(&projection.solve()?.change))
}
