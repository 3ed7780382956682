//! A second opinion on an optimum, by another method: argmin's L-BFGS over the controls alone, within a loop of augmented
//! Lagrangians for the hard goals.
//!
//! The states are eliminated by simulation and gradients come from one adjoint sweep; neither the lifted iterates, nor the sensitivities
//! of many columns, Hessians, Clarabel or the filter are involved. With the constraints `c(v) = 0` every stage minimizes
//! `J + yᵀc + ½ μ cᵀWc`, and `y ← y + μ W c` (Nocedal & Wright 2006, algorithm 17.4). `W = (AAᵀ)⁻¹` of the Jacobian `A` at the start: all
//! constraints are then equally steep, whatever their units. Inequalities are not treated: problems with path constraints are refused, and
//! bounds on controls are examined afterwards.

use std::cell::RefCell;

use argmin::core::{CostFunction, Error as ArgminError, Executor, Gradient};
use argmin::solver::linesearch::MoreThuenteLineSearch;
use argmin::solver::quasinewton::LBFGS;
use nalgebra::{DMatrix, DVector};

use super::problem::OptimalControlProblem;
use super::transcription::{LiftedPoint, Transcription};
use crate::mechanics::Trajectory;
use crate::sqp::{Failure, LiftedProgram as _, Multipliers};

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SecondOpinionSettings {
    /// Largest constraint.
    pub feasibility: f64,
    /// Norm of the gradient of the Lagrangian, over that of the objective at the start or 1; the objective is off by its square.
    pub gradient: f64,
    /// Stages, at most.
    pub max_stages: usize,
    /// Iterations of L-BFGS in a stage, at most.
    pub max_iterations: u64,
}

impl Default for SecondOpinionSettings {
    fn default() -> Self {
        Self {
            feasibility: 5e-8,
            gradient: 1e-5,
            max_stages: 30,
            max_iterations: 2000,
        }
    }
}

/// How a second opinion ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OpinionStatus {
    /// Constraints and gradient are within the tolerance.
    Converged,
    /// They are, but a bound on the controls is violated, which it does not know: not comparable.
    BoundsViolated,
    /// Stages or steps used up.
    NotConverged,
}

impl OpinionStatus {
    /// The word in summaries.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::BoundsViolated => "bounds-violated",
            Self::NotConverged => "not-converged",
        }
    }
}

/// What the other method found.
#[derive(Clone, Debug)]
pub struct SecondOpinion {
    /// How it ended.
    pub status: OpinionStatus,
    /// Value of the objective.
    pub objective: f64,
    /// The variables: scaled controls, then residuals of soft goals.
    pub variables: Vec<f64>,
    /// Multipliers of the constraints.
    pub multipliers: Vec<f64>,
    /// Largest constraint.
    pub feasibility: f64,
    /// Norm of the gradient of the Lagrangian.
    pub gradient: f64,
    /// Stages of the augmented Lagrangian.
    pub stages: usize,
    /// Simulations with an adjoint.
    pub evaluations: usize,
}

/// Why there is no second opinion.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SecondOpinionError {
    /// A constraint on the way.
    #[error(
        "a second opinion knows no inequalities, and {name} is one; leave out --second-opinion, or the obstacle or limit"
    )]
    Inequality {
        /// Its name.
        name: String,
    },
    /// The start cannot be simulated.
    #[error("a second opinion cannot start: {0}")]
    Start(#[from] Failure),
}

/// Values and gradient at a point.
#[derive(Clone, Debug)]
pub struct ReducedValues {
    /// `J`
    pub objective: f64,
    /// `c`
    pub constraints: Vec<f64>,
    /// `∇J + Aᵀ pull(c)`
    pub gradient: Vec<f64>,
}

/// A program over its variables alone, with equality constraints.
pub trait ReducedProgram {
    /// Number of constraints.
    fn n_constraints(&self) -> usize;

    /// Values at `variables`, with the gradient of a function of objective and constraints whose derivative along `J` is 1 and along
    /// `c` is `pull(c)`.
    ///
    /// # Errors
    /// [`Failure`] where the model has no meaning.
    fn values(
        &self,
        variables: &[f64],
        pull: &dyn Fn(&[f64]) -> Vec<f64>,
    ) -> Result<ReducedValues, Failure>;
}

impl ReducedProgram for Transcription<'_> {
    fn n_constraints(&self) -> usize {
        self.goal_rows().len()
    }

    fn values(
        &self,
        variables: &[f64],
        pull: &dyn Fn(&[f64]) -> Vec<f64>,
    ) -> Result<ReducedValues, Failure> {
        let here = LiftedPoint {
            variables: variables.to_vec(),
            trajectory: Trajectory::with_capacity(self.problem().rod.n_nodes(), 0),
        };
        let point = self.rollout(&here, &vec![0.0; variables.len()])?;
        let evaluation = self.evaluate(&point)?;
        let pulls = Multipliers {
            constraints: pull(&evaluation.constraints),
            ..Multipliers::zeros(0, self.n_path_rows(), self.sets())
        };
        let mut gradient = self.lagrangian_gradient(&point, &pulls)?;
        // What a tolerance leaves stays as it is at the start.
        for slack in self.tolerance_slacks() {
            gradient[slack] = 0.0;
        }
        Ok(ReducedValues {
            objective: evaluation.objective,
            gradient,
            constraints: evaluation.constraints,
        })
    }
}

/// Whether the problem has inequalities that a second opinion does not know.
///
/// # Errors
/// [`SecondOpinionError::Inequality`] with the name of the first one.
pub fn without_inequalities(problem: &OptimalControlProblem) -> Result<(), SecondOpinionError> {
    match problem.path.first() {
        Some(constraint) => Err(SecondOpinionError::Inequality {
            name: constraint.name.clone(),
        }),
        None => Ok(()),
    }
}

/// Minimizes a problem's objective from `start`, the scaled variables.
///
/// # Errors
/// [`SecondOpinionError`] for a problem with path constraints, or a start that cannot be simulated.
pub fn second_opinion(
    problem: &OptimalControlProblem,
    start: &[f64],
    settings: &SecondOpinionSettings,
) -> Result<SecondOpinion, SecondOpinionError> {
    without_inequalities(problem)?;
    let program = Transcription::new(problem, 1);
    let mut found = minimize(&program, start, settings)?;
    let outside = |set: &crate::sqp::ConvexSet| !(set.violation(&found.variables) <= BOUND_MARGIN);
    if found.status == OpinionStatus::Converged && program.sets().iter().any(outside) {
        found.status = OpinionStatus::BoundsViolated;
    }
    Ok(found)
}

/// Violation of a bound that counts as touching it, in scaled variables.
const BOUND_MARGIN: f64 = 1e-6;
/// Growth of the penalty, at first the size of the gradient of the objective or 1, where a stage gains too little.
const PENALTY_GROWTH: f64 = 10.0;
/// Largest one, likewise: a line search knows gradients to the root of rounding times the curvature, which the penalty makes.
const LARGEST_PENALTY: f64 = 1e2;
/// Length of the first step of a stage, at most, which L-BFGS takes along the gradient, in scaled variables: the merit is measured in
/// units that make it so, and in those of its largest curvature, the penalty's.
const FIRST_STEP: f64 = 0.1;
/// Calls of a line search without a better point, and of a stage, after which it ends: the search has no end of its own at rounding.
const PATIENCE: usize = 40;
const MOST_CALLS: usize = 5000;
/// Part of the infeasibility that a stage may leave without the penalty growing.
const ENOUGH: f64 = 0.5;
/// Pairs of steps and gradients that L-BFGS keeps.
const MEMORY: usize = 20;

/// The loop of augmented Lagrangians.
///
/// # Errors
/// [`Failure`] where the program has no values at the start.
pub fn minimize(
    program: &dyn ReducedProgram,
    start: &[f64],
    settings: &SecondOpinionSettings,
) -> Result<SecondOpinion, Failure> {
    let mut multipliers = vec![0.0; program.n_constraints()];
    let first = program.values(start, &|c| vec![0.0; c.len()])?;
    let slope = norm(&first.gradient).max(1.0);
    let metric = metric(program, start, &first.gradient)?;
    let mut penalty = slope;
    let largest_penalty = LARGEST_PENALTY * slope;
    let mut evaluations = 1;
    let mut best = Seen {
        variables: start.to_vec(),
        values: first,
        merit: f64::INFINITY,
    };
    let mut feasibility = f64::INFINITY;
    for stage in 1..=settings.max_stages {
        let memory = RefCell::new(Memory::default());
        let here = program.values(&best.variables, &|c| {
            pulled(&multipliers, &metric, penalty, c)
        })?;
        let unit = (norm(&here.gradient) / FIRST_STEP).max(penalty);
        let problem = Stage {
            program,
            multipliers: &multipliers,
            metric: &metric,
            penalty,
            unit,
            memory: &memory,
        };
        let aim = 0.01 * settings.gradient * slope;
        let run = LBFGS::new(MoreThuenteLineSearch::new(), MEMORY)
            .with_tolerance_grad(aim / unit)
            .and_then(|solver| solver.with_tolerance_cost(0.0))
            .and_then(|solver| {
                Executor::new(problem, solver)
                    .configure(|state| {
                        (state.param(best.variables.clone())).max_iters(settings.max_iterations)
                    })
                    .timer(false)
                    .run()
            });
        // A line search that cannot improve any more ends the stage; its best point is known here.
        drop(run);
        let memory = memory.into_inner();
        evaluations += memory.evaluations;
        if let Some(seen) = memory.best {
            best = seen;
        }
        multipliers = pulled(&multipliers, &metric, penalty, &best.values.constraints);
        let left = (best.values.constraints.iter()).fold(0.0, |m: f64, c| m.max(c.abs()));
        let gradient = norm(&best.values.gradient);
        let converged = left <= settings.feasibility && gradient <= settings.gradient * slope;
        if converged || stage == settings.max_stages {
            return Ok(SecondOpinion {
                status: if converged {
                    OpinionStatus::Converged
                } else {
                    OpinionStatus::NotConverged
                },
                objective: best.values.objective,
                variables: best.variables,
                multipliers,
                feasibility: left,
                gradient,
                stages: stage,
                evaluations,
            });
        }
        // A stage that was not finished says nothing about the penalty.
        if gradient <= 10.0 * aim && !(left <= ENOUGH * feasibility) {
            penalty = (penalty * PENALTY_GROWTH).min(largest_penalty);
        }
        feasibility = left;
    }
    Ok(SecondOpinion {
        status: OpinionStatus::NotConverged,
        objective: best.values.objective,
        variables: best.variables,
        multipliers,
        feasibility,
        gradient: norm(&best.values.gradient),
        stages: 0,
        evaluations,
    })
}

/// `y + μ W c`
fn pulled(multipliers: &[f64], metric: &DMatrix<f64>, penalty: f64, c: &[f64]) -> Vec<f64> {
    let push = metric * DVector::from_column_slice(c) * penalty;
    multipliers.iter().zip(&push).map(|(y, p)| y + p).collect()
}

/// `W = (AAᵀ)⁻¹`, from one gradient for every constraint; dependent ones are held apart by a rounding of the largest.
fn metric(
    program: &dyn ReducedProgram,
    start: &[f64],
    gradient: &[f64],
) -> Result<DMatrix<f64>, Failure> {
    let m = program.n_constraints();
    let mut jacobian = DMatrix::zeros(m, start.len());
    for i in 0..m {
        let unit = |c: &[f64]| (0..c.len()).map(|j| f64::from(i == j)).collect();
        let with = program.values(start, &unit)?.gradient;
        for (j, (with, without)) in with.iter().zip(gradient).enumerate() {
            jacobian[(i, j)] = with - without;
        }
    }
    let mut square = &jacobian * jacobian.transpose();
    let floor = (1e-10 * square.diagonal().amax()).max(f64::MIN_POSITIVE);
    for i in 0..m {
        square[(i, i)] += floor;
    }
    square
        .cholesky()
        .map(|factor| factor.inverse())
        .ok_or_else(|| Failure("the constraints have no finite derivative at the start".into()))
}

fn norm(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// A point with its values and its augmented Lagrangian.
#[derive(Clone, Debug)]
struct Seen {
    variables: Vec<f64>,
    values: ReducedValues,
    merit: f64,
}

/// What a stage has evaluated: argmin asks for value and gradient of the same point one after the other.
#[derive(Debug, Default)]
struct Memory {
    last: Option<Seen>,
    best: Option<Seen>,
    evaluations: usize,
    /// Calls, and those since the last better point.
    calls: usize,
    fruitless: usize,
}

/// One stage as argmin sees it.
struct Stage<'a> {
    program: &'a dyn ReducedProgram,
    multipliers: &'a [f64],
    metric: &'a DMatrix<f64>,
    penalty: f64,
    /// What counts as 1 to argmin.
    unit: f64,
    memory: &'a RefCell<Memory>,
}

impl Stage<'_> {
    fn at(&self, variables: &[f64]) -> Result<(f64, Vec<f64>), ArgminError> {
        let mut memory = self.memory.borrow_mut();
        memory.calls += 1;
        memory.fruitless += 1;
        if memory.fruitless > PATIENCE || memory.calls > MOST_CALLS {
            return Err(ArgminError::msg("a line search without end"));
        }
        if let Some(last) = (memory.last.as_ref()).filter(|last| last.variables == variables) {
            return Ok((last.merit, last.values.gradient.clone()));
        }
        let pull = |penalty: f64, c: &[f64]| pulled(self.multipliers, self.metric, penalty, c);
        let values = (self.program).values(variables, &|c| pull(self.penalty, c))?;
        let half = pull(0.5 * self.penalty, &values.constraints);
        let held = values.constraints.iter().zip(half).map(|(c, y)| c * y);
        let merit = values.objective + held.sum::<f64>();
        let seen = Seen {
            variables: variables.to_vec(),
            values,
            merit,
        };
        memory.evaluations += 1;
        // At rounding of the value the gradient says which is better.
        let better = memory.best.as_ref().is_none_or(|best| {
            let rounding = 1e-14 * best.merit.abs();
            merit < best.merit - rounding
                || (merit <= best.merit + rounding
                    && norm(&seen.values.gradient) < norm(&best.values.gradient))
        });
        if better {
            memory.fruitless = 0;
            memory.best = Some(seen.clone());
        }
        let gradient = seen.values.gradient.clone();
        memory.last = Some(seen);
        Ok((merit, gradient))
    }
}

impl CostFunction for Stage<'_> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, variables: &Vec<f64>) -> Result<f64, ArgminError> {
        Ok(self.at(variables)?.0 / self.unit)
    }
}

impl Gradient for Stage<'_> {
    type Param = Vec<f64>;
    type Gradient = Vec<f64>;

    fn gradient(&self, variables: &Vec<f64>) -> Result<Vec<f64>, ArgminError> {
        let gradient = self.at(variables)?.1;
        Ok(gradient.iter().map(|g| g / self.unit).collect())
    }
}
