//! A solve in progress: what one iteration of the loop does, and what it remembers.

use std::ops::ControlFlow;
use std::time::Instant;

use super::globalization::{Accepted, Departure, Filter};
use super::hessian::{ActiveNormal, HessianChoice, HessianKind, ModelHessian};
use super::program::{ConvexSet, Evaluation, Failure, LiftedProgram, Linearization};
use super::quadratic_program::{QpError, QpSolution, QuadraticProgram};
use super::residual::{KktResidual, Multipliers, infinity_norm, norm};
use super::solver::{IterationRecord, PhaseTimes, SqpOutcome, SqpSettings, SqpStatus, Stop};

/// Smallest and first elastic weight, relative to the size of the cost gradient.
const FIRST_ELASTIC_WEIGHT: f64 = 1e3;
const LARGEST_ELASTIC_WEIGHT: f64 = 1e8;
const ELASTIC_FACTOR: f64 = 10.0;
/// A heavier weight must bring the slack below this part of what it was.
const ELASTIC_GAIN: f64 = 0.9;
/// The weight is kept this much above the largest multiplier, so that it can come down again.
const ELASTIC_MARGIN: f64 = 10.0;
/// Slack that counts as none.
const NO_SLACK: f64 = 1e-8;
/// `Auto` uses the exact Hessian below this stationarity and infeasibility.
const EXACT_BELOW: f64 = 0.3;
/// After an exact step from here the next point is expected to pass; its curvature would be computed for nothing.
const NEARLY_DONE: f64 = 1e-4;
/// Subproblems that promise less than this part of the infeasibility make no progress.
const INFEASIBLE_PROGRESS: f64 = 1e-3;
const INFEASIBLE_PATIENCE: usize = 3;
/// First trust radius, relative to the first variables (at least to one).
const FIRST_TRUST_RADIUS: f64 = 2.0;
const SHRINK: f64 = 0.3;
const GROW: f64 = 2.5;
/// Ratios of what a step delivered to what it promised, above which the trust region grows and below which it shrinks.
const GOOD_RATIO: f64 = 0.5;
const POOR_RATIO: f64 = 0.05;
const POOR_SHRINK: f64 = 0.5;
const SHRINKAGES: usize = 12;
/// Subproblems without a solution, in all, after which a solve gives up.
const RESCUES: usize = 8;
const REFUSALS_IN_A_ROW: usize = 4;
const FILTER_RESETS: usize = 5;
/// Part of the promise that a step refused by the filter must deliver, and how many such steps there may be.
const MERIT_RATIO: f64 = 0.2;
const MERIT_STEPS: usize = 40;

/// What was done about a subproblem without a solution.
enum Recovery {
    Smaller,
    Restored,
}

/// What an iteration did.
pub(super) enum Step {
    Taken,
    Restored,
    Refused,
    Infeasible,
}

/// A solve in progress.
pub(super) struct Run<'a, P: LiftedProgram> {
    program: &'a P,
    settings: &'a SqpSettings,
    started: Instant,
    point: P::Point,
    evaluation: Evaluation<P::Defects>,
    multipliers: Multipliers,
    filter: Filter,
    elastic_weight: Option<f64>,
    trust_radius: f64,
    stuck: usize,
    rescues: usize,
    refused_in_a_row: usize,
    filter_resets: usize,
    merit_steps: usize,
    /// Defects of the last states that were computed from their variables.
    rounding: f64,
    best: Best<P::Point>,
    history: Vec<IterationRecord>,
    phases: PhaseTimes,
}

/// The best point so far: least infeasible, and among feasible ones the nearest to optimal.
struct Best<Point> {
    point: Point,
    multipliers: Multipliers,
    residual: KktResidual,
    objective: f64,
    infeasibility: f64,
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
        match program.evaluate(&point) {
            Ok(evaluation) => {
                let multipliers = Multipliers::zeros(evaluation.constraints.len(), program.sets());
                Ok(Self {
                    program,
                    settings,
                    started,
                    filter: Filter::new(evaluation.infeasibility()),
                    best: Best {
                        point: point.clone(),
                        multipliers: multipliers.clone(),
                        residual: UNKNOWN_RESIDUAL,
                        objective: evaluation.objective,
                        infeasibility: f64::INFINITY,
                    },
                    trust_radius: first_trust_radius(program.variables(&point)),
                    point,
                    evaluation,
                    multipliers,
                    elastic_weight: None,
                    stuck: 0,
                    rescues: 0,
                    refused_in_a_row: 0,
                    filter_resets: 0,
                    merit_steps: 0,
                    rounding: 0.0,
                    history: Vec::new(),
                    phases: PhaseTimes::default(),
                })
            }
            Err(failure) => Err(Box::new(SqpOutcome {
                status: SqpStatus::Failed(failure.0),
                point,
                multipliers: Multipliers::default(),
                residual: UNKNOWN_RESIDUAL,
                objective: f64::NAN,
                history: Vec::new(),
                phases: PhaseTimes::default(),
            })),
        }
    }

    fn wants_curvature(&self) -> bool {
        match self.settings.hessian {
            HessianChoice::GaussNewton => false,
            // Without multipliers there is no Lagrangian yet.
            HessianChoice::Exact => !self.history.is_empty(),
            HessianChoice::Auto => self.history.last().is_some_and(|last| {
                let about_to_converge = last.residual.stationarity <= self.settings.tolerance
                    || (last.hessian == HessianKind::Exact
                        && last.residual.stationarity < NEARLY_DONE);
                last.residual.stationarity < EXACT_BELOW
                    && self.evaluation.infeasibility() < EXACT_BELOW
                    && !about_to_converge
            }),
        }
    }

    pub(super) fn linearize(&mut self) -> Result<Linearization, Failure> {
        let clock = Instant::now();
        let multipliers = self
            .wants_curvature()
            .then_some(self.multipliers.constraints.as_slice());
        let linearization = self
            .program
            .linearize(&self.point, &self.evaluation, multipliers);
        self.phases.linearize += clock.elapsed().as_secs_f64();
        linearization
    }

    pub(super) fn residual(&self, linearization: &Linearization) -> KktResidual {
        KktResidual::of(
            linearization,
            &self.evaluation.constraints,
            self.evaluation.defect,
            self.program.variables(&self.point),
            self.program.sets(),
            &self.multipliers,
        )
    }

    pub(super) fn record(&mut self, iteration: usize, residual: KktResidual) {
        let infeasibility = self.evaluation.infeasibility();
        self.history.push(IterationRecord {
            iteration,
            objective: self.evaluation.objective,
            residual,
            infeasibility,
            step_norm: 0.0,
            hessian: HessianKind::GaussNewton,
            corrections: 0,
            restored: false,
            trust_radius: self.trust_radius,
            elastic_weight: self.elastic_weight.unwrap_or(0.0),
            slack: 0.0,
            qp_iterations: 0,
            elapsed: self.started.elapsed().as_secs_f64(),
        });
        let feasible = self.settings.tolerance;
        let better = if infeasibility.max(self.best.infeasibility) <= feasible {
            residual.max() <= self.best.residual.max()
        } else {
            infeasibility <= self.best.infeasibility
        };
        if better {
            self.best = Best {
                point: self.point.clone(),
                multipliers: self.multipliers.clone(),
                residual,
                objective: self.evaluation.objective,
                infeasibility,
            };
        }
    }

    /// Defects that rounding leaves; 0 as long as no states have been computed.
    pub(super) fn rounding(&self) -> f64 {
        self.rounding
    }

    pub(super) fn out_of_time(&self) -> Option<Stop> {
        self.settings
            .deadline
            .filter(|&deadline| self.started.elapsed() >= deadline)
            .map(|_| Stop::Deadline)
    }

    /// Subproblems of shrinking trust radius, until one's step is accepted.
    pub(super) fn step(&mut self, linearization: &Linearization) -> Result<Step, QpError> {
        let clock = Instant::now();
        let model = if linearization.curvature.is_some() {
            let active = ActiveNormal::of(
                self.program.sets(),
                self.program.variables(&self.point),
                &self.multipliers,
                linearization,
            );
            ModelHessian::exact(linearization, &active)
        } else {
            ModelHessian::gauss_newton(linearization)
        };
        let sets = self.subproblem_sets(&model);
        self.phases.condense += clock.elapsed().as_secs_f64();
        for refusals in 0..=SHRINKAGES {
            let solution = match self.solve_subproblem(linearization, &model, &sets) {
                Ok(solution) => solution,
                Err(error) => match self.recover(error)? {
                    Recovery::Smaller => continue,
                    Recovery::Restored => return Ok(Step::Restored),
                },
            };
            self.note_subproblem(&model, &solution);
            if self.is_stuck(linearization, &model, &sets, &solution) {
                return Ok(Step::Infeasible);
            }
            let clock = Instant::now();
            let accepted = self.search(linearization, &model, &sets, &solution);
            self.phases.globalize += clock.elapsed().as_secs_f64();
            let length = norm(&solution.change);
            if let Some(accepted) = accepted {
                self.note_refusals(refusals);
                let weight = self.merit_weight(&solution);
                let promise = self.promise(linearization, &model, &solution, weight);
                self.take(accepted, &solution, promise, length);
                return Ok(Step::Taken);
            }
            self.trust_radius = SHRINK * length.min(self.trust_radius);
            if self.out_of_time().is_some() {
                return Ok(Step::Refused);
            }
        }
        // Not even a short step: forget the past once more, before giving up.
        if self.filter_resets < FILTER_RESETS && self.filter.has_entries() {
            self.filter_resets += 1;
            self.filter = Filter::new(self.evaluation.infeasibility());
            self.trust_radius = first_trust_radius(self.program.variables(&self.point));
            return Ok(Step::Restored);
        }
        Ok(Step::Refused)
    }

    /// A filter that refuses the first trial again and again remembers a place that the iteration cannot get back to:
    /// it is emptied (Wächter and Biegler 2006, section 3.4), at most a few times.
    fn note_refusals(&mut self, refusals: usize) {
        self.refused_in_a_row = if refusals > 0 {
            self.refused_in_a_row + 1
        } else {
            0
        };
        if self.refused_in_a_row >= REFUSALS_IN_A_ROW && self.filter_resets < FILTER_RESETS {
            self.filter_resets += 1;
            self.refused_in_a_row = 0;
            self.filter = Filter::new(self.evaluation.infeasibility());
        }
    }

    /// After a subproblem that Clarabel could not solve: put the states back onto their equations (large defects make
    /// badly scaled subproblems), or else shrink the trust region.
    fn recover(&mut self, error: QpError) -> Result<Recovery, QpError> {
        self.rescues += 1;
        if self.rescues > RESCUES {
            return Err(error);
        }
        let still = vec![0.0; self.program.variables(&self.point).len()];
        if self.evaluation.defect > self.settings.tolerance
            && let Ok(point) = self.program.restored_step(&self.point, &still)
            && let Ok(evaluation) = self.program.evaluate(&point)
        {
            self.filter = Filter::new(evaluation.infeasibility());
            self.elastic_weight = None;
            self.point = point;
            self.evaluation = evaluation;
            return Ok(Recovery::Restored);
        }
        self.trust_radius *= SHRINK;
        Ok(Recovery::Smaller)
    }

    fn note_subproblem(&mut self, model: &ModelHessian, solution: &QpSolution) {
        let (weight, radius) = (self.elastic_weight.unwrap_or(0.0), self.trust_radius);
        if let Some(row) = self.history.last_mut() {
            row.hessian = model.kind;
            row.slack = solution.slack;
            row.qp_iterations += solution.iterations;
            row.elastic_weight = weight;
            row.trust_radius = radius;
        }
    }

    fn take(&mut self, accepted: Accepted<P>, solution: &QpSolution, promise: f64, length: f64) {
        if let Some(row) = self.history.last_mut() {
            row.step_norm = length;
            row.corrections = accepted.corrections;
            row.restored = accepted.restored;
        }
        let weight = self.merit_weight(solution);
        let ratio =
            (merit(&self.evaluation, weight) - merit(&accepted.evaluation, weight)) / promise;
        // Every lifted step leaves defects of its own second order; they say nothing about the radius.
        let good = !accepted.restored || ratio > GOOD_RATIO;
        if good && length > 0.5 * self.trust_radius {
            self.trust_radius *= GROW;
        } else if !(ratio > POOR_RATIO) && accepted.restored {
            self.trust_radius = self.trust_radius.min(length * POOR_SHRINK);
        }
        if accepted.restored {
            self.rounding = accepted.evaluation.defect;
        }
        self.point = accepted.point;
        self.evaluation = accepted.evaluation;
        self.multipliers = solution.multipliers.clone();
    }

    /// Weight of infeasibility in the merit that sizes the trust region: above every multiplier.
    fn merit_weight(&self, solution: &QpSolution) -> f64 {
        2.0 * infinity_norm(&solution.multipliers.constraints)
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
        let mut cost = 0.0;
        for i in 0..n {
            let bent: f64 = (0..n).map(|j| model.matrix[(i, j)] * change[j]).sum();
            cost += change[i] * (linearization.gradient[i] + 0.5 * bent);
        }
        let violation: f64 = self.evaluation.constraints.iter().map(|c| c.abs()).sum();
        let saved = violation + self.evaluation.defect - solution.slack;
        weight * saved - cost - linearization.defect_slope
    }

    /// The program's sets, with the tangents that the model's Hessian asks for in the place of balls.
    fn subproblem_sets(&self, model: &ModelHessian) -> Vec<ConvexSet> {
        let mut sets = self.program.sets().to_vec();
        for tangent in &model.tangents {
            sets[tangent.set] = tangent.tangent(self.program.variables(&self.point));
        }
        sets
    }

    fn solve_subproblem(
        &mut self,
        linearization: &Linearization,
        model: &ModelHessian,
        sets: &[ConvexSet],
    ) -> Result<QpSolution, QpError> {
        let clock = Instant::now();
        let unit = cost_unit(linearization);
        let mut weight = self.elastic_weight.unwrap_or(FIRST_ELASTIC_WEIGHT * unit);
        let mut solution = self
            .subproblem(linearization, model, sets, weight)
            .solve()?;
        // A larger weight helps only where it buys feasibility; a small trust region is no reason to raise it.
        while solution.slack > NO_SLACK && weight < LARGEST_ELASTIC_WEIGHT * unit {
            let heavier = self
                .subproblem(linearization, model, sets, weight * ELASTIC_FACTOR)
                .solve()?;
            if heavier.slack > ELASTIC_GAIN * solution.slack {
                break;
            }
            weight *= ELASTIC_FACTOR;
            solution = heavier;
        }
        if solution.slack <= NO_SLACK {
            let largest = infinity_norm(&solution.multipliers.constraints);
            weight = (ELASTIC_MARGIN * largest).max(FIRST_ELASTIC_WEIGHT * unit);
        }
        self.return_to_balls(model, &mut solution);
        self.elastic_weight = Some(weight);
        self.phases.qp += clock.elapsed().as_secs_f64();
        Ok(solution)
    }

    /// After a subproblem with tangents: the step ends on the balls themselves, and their normals are vectors again.
    fn return_to_balls(&self, model: &ModelHessian, solution: &mut QpSolution) {
        let variables = self.program.variables(&self.point);
        for tangent in &model.tangents {
            let length = solution.multipliers.normals[tangent.set][0];
            solution.multipliers.normals[tangent.set] =
                tangent.direction.iter().map(|&(_, c)| c * length).collect();
            let ConvexSet::Ball { indices, radius } = &self.program.sets()[tangent.set] else {
                continue;
            };
            let end: Vec<f64> = indices
                .iter()
                .map(|&i| variables[i] + solution.change[i])
                .collect();
            let size = norm(&end);
            if size > *radius {
                for (&i, e) in indices.iter().zip(&end) {
                    solution.change[i] = e * (radius / size) - variables[i];
                }
            }
        }
    }

    fn subproblem<'b>(
        &'b self,
        linearization: &'b Linearization,
        model: &'b ModelHessian,
        sets: &'b [ConvexSet],
        elastic_weight: f64,
    ) -> QuadraticProgram<'b> {
        let time_limit = self.settings.deadline.map_or(f64::INFINITY, |deadline| {
            deadline
                .saturating_sub(self.started.elapsed())
                .as_secs_f64()
                .max(1e-3)
        });
        QuadraticProgram {
            hessian: &model.matrix,
            gradient: &model.gradient,
            jacobian: &linearization.jacobian,
            offset: &linearization.offset,
            variables: self.program.variables(&self.point),
            sets,
            elastic_weight,
            trust_radius: self.trust_radius,
            time_limit,
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
        let violation: f64 = linearization.offset.iter().map(|c| c.abs()).sum();
        let promises_nothing = |slack: f64| {
            slack > self.settings.tolerance && violation - slack < INFEASIBLE_PROGRESS * violation
        };
        let hopeless = promises_nothing(solution.slack)
            && self.evaluation.defect < INFEASIBLE_PROGRESS * violation
            && (norm(&solution.change) < 0.5 * self.trust_radius || {
                let weight = self.elastic_weight.unwrap_or(0.0);
                let free = QuadraticProgram {
                    trust_radius: f64::INFINITY,
                    ..self.subproblem(linearization, model, sets, weight)
                };
                free.solve().is_ok_and(|free| promises_nothing(free.slack))
            });
        self.stuck = if hopeless { self.stuck + 1 } else { 0 };
        self.stuck >= INFEASIBLE_PATIENCE
    }

    fn search(
        &mut self,
        linearization: &Linearization,
        model: &ModelHessian,
        sets: &[ConvexSet],
        solution: &QpSolution,
    ) -> Option<Accepted<P>> {
        let weight = self.elastic_weight.unwrap_or(0.0);
        let mut filter = self.filter.clone();
        let departure = Departure {
            point: &self.point,
            evaluation: &self.evaluation,
            linearization,
        };
        let verdict = filter.accept(
            self.program,
            &departure,
            &self.subproblem(linearization, model, sets, weight),
            &solution.change,
        );
        self.filter = filter;
        match verdict {
            Ok(accepted) => Some(accepted),
            Err(refused) => self.accept_by_merit(linearization, model, solution, refused?),
        }
    }

    /// What the filter refuses may still be what the elastic subproblem set out to do: lower `J + γ · infeasibility`.
    /// A point far below in infeasibility, visited and left for a better objective, must not block the way back for
    /// ever; such a step empties the filter.
    fn accept_by_merit(
        &mut self,
        linearization: &Linearization,
        model: &ModelHessian,
        solution: &QpSolution,
        refused: Accepted<P>,
    ) -> Option<Accepted<P>> {
        let weight = self.elastic_weight?;
        if self.merit_steps >= MERIT_STEPS || self.evaluation.defect > self.settings.tolerance {
            return None;
        }
        let promise = self.promise(linearization, model, solution, weight);
        let delivered = merit(&self.evaluation, weight) - merit(&refused.evaluation, weight);
        if !(promise > 0.0 && delivered >= MERIT_RATIO * promise) {
            return None;
        }
        self.merit_steps += 1;
        self.filter = Filter::new(self.evaluation.infeasibility());
        Some(refused)
    }

    pub(super) fn show(
        &self,
        observer: &mut dyn FnMut(&IterationRecord) -> ControlFlow<Stop>,
    ) -> ControlFlow<Stop> {
        self.history
            .last()
            .map_or(ControlFlow::Continue(()), observer)
    }

    /// Shows the last row and ends.
    pub(super) fn finish(
        self,
        status: SqpStatus,
        observer: &mut dyn FnMut(&IterationRecord) -> ControlFlow<Stop>,
    ) -> SqpOutcome<P::Point> {
        // Already ending: a request to stop changes nothing.
        let _ = self.show(observer);
        self.end(status)
    }

    pub(super) fn end(self, status: SqpStatus) -> SqpOutcome<P::Point> {
        SqpOutcome {
            status,
            point: self.best.point,
            multipliers: self.best.multipliers,
            residual: self.best.residual,
            objective: self.best.objective,
            history: self.history,
            phases: self.phases,
        }
    }
}

/// `J + weight · infeasibility`
fn merit<R>(values: &Evaluation<R>, weight: f64) -> f64 {
    values.objective + weight * values.infeasibility()
}

fn first_trust_radius(variables: &[f64]) -> f64 {
    FIRST_TRUST_RADIUS * norm(variables).max(1.0)
}

/// Size of the cost's derivatives: the weight of a violated constraint is counted in these.
fn cost_unit(linearization: &Linearization) -> f64 {
    linearization
        .least_curvature()
        .max(infinity_norm(&linearization.gradient))
}
