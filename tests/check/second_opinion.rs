//! The SQP's optima against those of another method: argmin's L-BFGS over the controls alone, within a loop of augmented
//! Lagrangians for the hard goals.
//!
//! The states are eliminated by simulation, and gradients come from one adjoint sweep: neither lifted iterates, nor sensitivities of
//! many columns, Hessians, Clarabel or the filter are involved. With the constraints `c(v) = 0` every stage minimizes
//! `J + yᵀc + ½ μ cᵀWc`, and `y ← y + μ W c` (Nocedal & Wright 2006, algorithm 17.4). `W = (AAᵀ)⁻¹` with the Jacobian `A` at the
//! start makes all constraints equally steep, whatever their units.

use crate::common;

use std::cell::RefCell;
use std::ops::ControlFlow;

use argmin::core::{CostFunction, Error as ArgminError, Executor, Gradient};
use argmin::solver::linesearch::MoreThuenteLineSearch;
use argmin::solver::quasinewton::LBFGS;
use common::tasks::reach;
use faer::linalg::solvers::Solve as _;
use faer::{Mat, Side};
use nalgebra::{DMatrix, DVector};
use softarm::control::{
    Bound, Enforcement, Guess, Hold, LiftedPoint, OptimalControlProblem, Transcription, first_point,
};
use softarm::mechanics::Trajectory;
use softarm::sqp::{
    ConvexSet, LiftedProgram as _, LinearizationRequest, Multipliers, SqpSettings, SqpStatus, solve,
};

/// Values at a point.
#[derive(Clone, Debug)]
struct Values {
    /// `J`
    objective: f64,
    /// `c`
    constraints: Vec<f64>,
    /// `∇J + Aᵀ pull(c)`
    gradient: Vec<f64>,
}

/// A program over its variables alone, with equality constraints: values at the variables, with the gradient of a function of
/// objective and constraints whose derivative along `J` is 1 and along `c` is `pull(c)`.
type Program<'a> = dyn Fn(&[f64], &dyn Fn(&[f64]) -> Vec<f64>) -> Values + 'a;

/// A point at which constraints and gradient of the Lagrangian are within the tolerances below.
#[derive(Debug)]
struct Optimum {
    objective: f64,
    variables: Vec<f64>,
    multipliers: Vec<f64>,
    /// Largest constraint.
    feasibility: f64,
    /// Norm of the gradient of the Lagrangian.
    gradient: f64,
}

/// Largest constraint at an optimum.
const FEASIBILITY: f64 = 5e-8;
/// Norm of the gradient of the Lagrangian at an optimum, over that of the objective at the start or 1; the objective is off by its square.
const GRADIENT: f64 = 1e-5;
/// Stages, and iterations of L-BFGS in each, at most.
const STAGES: usize = 30;
const ITERATIONS: u64 = 2000;
/// Growth of the penalty, at first the size of the gradient of the objective or 1, where a stage leaves more than half of the infeasibility.
const PENALTY_GROWTH: f64 = 10.0;
/// Largest one, likewise: a line search knows gradients to the root of rounding times the curvature, which the penalty makes.
const LARGEST_PENALTY: f64 = 1e2;
/// Length of the first step of a stage, at most, which L-BFGS takes along the gradient, in scaled variables: the merit is measured in
/// units that make it so, and in those of its largest curvature, the penalty's.
const FIRST_STEP: f64 = 0.1;
/// Calls of a line search without a better point, and of a stage, after which it ends: the search has no end of its own at rounding.
const PATIENCE: usize = 40;
const MOST_CALLS: usize = 5000;
/// Pairs of steps and gradients that L-BFGS keeps.
const MEMORY: usize = 20;

/// The loop of augmented Lagrangians, until it converges.
fn minimize(program: &Program, start: &[f64]) -> Optimum {
    let first = program(start, &|c| vec![0.0; c.len()]);
    let mut multipliers = vec![0.0; first.constraints.len()];
    let slope = norm(&first.gradient).max(1.0);
    let metric = metric(program, start, &first);
    let mut penalty = slope;
    let mut best = Seen {
        variables: start.to_vec(),
        values: first,
        merit: f64::INFINITY,
    };
    let mut feasibility = f64::INFINITY;
    for _ in 0..STAGES {
        let pull =
            |part: f64, c: &[f64]| -> Vec<f64> { pulled(&multipliers, &metric, part * penalty, c) };
        let here = program(&best.variables, &|c| pull(1.0, c));
        let unit = (norm(&here.gradient) / FIRST_STEP).max(penalty);
        let memory = RefCell::new(Memory::default());
        let stage = Stage {
            program,
            pull: &pull,
            unit,
            memory: &memory,
        };
        let aim = 0.01 * GRADIENT * slope;
        let solver = LBFGS::new(MoreThuenteLineSearch::new(), MEMORY)
            .with_tolerance_grad(aim / unit)
            .and_then(|solver| solver.with_tolerance_cost(0.0))
            .unwrap();
        let run = Executor::new(stage, solver)
            .configure(|state| state.param(best.variables.clone()).max_iters(ITERATIONS))
            .timer(false)
            .run();
        // A line search that cannot improve any more ends the stage; its best point is known here.
        drop(run);
        best = memory.into_inner().best.unwrap_or(best);
        multipliers = pull(1.0, &best.values.constraints);
        let left = (best.values.constraints.iter()).fold(0.0, |m: f64, c| m.max(c.abs()));
        let gradient = norm(&best.values.gradient);
        if left <= FEASIBILITY && gradient <= GRADIENT * slope {
            return Optimum {
                objective: best.values.objective,
                variables: best.variables,
                multipliers,
                feasibility: left,
                gradient,
            };
        }
        // A stage that was not finished says nothing about the penalty.
        if gradient <= 10.0 * aim && !(left <= 0.5 * feasibility) {
            penalty = (penalty * PENALTY_GROWTH).min(LARGEST_PENALTY * slope);
        }
        feasibility = left;
    }
    panic!("not converged: {feasibility:e} {best:?}")
}

/// `y + μ W c`
fn pulled(multipliers: &[f64], metric: &DMatrix<f64>, penalty: f64, c: &[f64]) -> Vec<f64> {
    let push = metric * DVector::from_column_slice(c) * penalty;
    multipliers.iter().zip(&push).map(|(y, p)| y + p).collect()
}

/// `W = (AAᵀ)⁻¹`, from one gradient for every constraint.
fn metric(program: &Program, start: &[f64], first: &Values) -> DMatrix<f64> {
    let m = first.constraints.len();
    let mut jacobian = DMatrix::zeros(m, start.len());
    for i in 0..m {
        let unit = |c: &[f64]| (0..c.len()).map(|j| f64::from(i == j)).collect();
        let with = program(start, &unit).gradient;
        for (j, (with, without)) in with.iter().zip(&first.gradient).enumerate() {
            jacobian[(i, j)] = with - without;
        }
    }
    let square = &jacobian * jacobian.transpose();
    square
        .cholesky()
        .expect("independent constraints")
        .inverse()
}

fn norm(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// A point with its values and its augmented Lagrangian.
#[derive(Clone, Debug)]
struct Seen {
    variables: Vec<f64>,
    values: Values,
    merit: f64,
}

/// The evaluations of a stage: argmin asks for value and gradient of the same point one after the other.
#[derive(Default)]
struct Memory {
    last: Option<Seen>,
    best: Option<Seen>,
    /// Calls, and those since the last better point.
    calls: usize,
    fruitless: usize,
}

/// One stage as argmin sees it.
struct Stage<'a> {
    program: &'a Program<'a>,
    /// `y + part μ W c`
    pull: &'a dyn Fn(f64, &[f64]) -> Vec<f64>,
    /// Size of the merit that counts as 1 to argmin.
    unit: f64,
    memory: &'a RefCell<Memory>,
}

impl Stage<'_> {
    fn at(&self, variables: &[f64]) -> Result<Seen, ArgminError> {
        let mut memory = self.memory.borrow_mut();
        memory.calls += 1;
        memory.fruitless += 1;
        if memory.fruitless > PATIENCE || memory.calls > MOST_CALLS {
            return Err(ArgminError::msg("a line search without end"));
        }
        if let Some(last) = (memory.last.as_ref()).filter(|last| last.variables == variables) {
            return Ok(last.clone());
        }
        let values = (self.program)(variables, &|c| (self.pull)(1.0, c));
        let half = (self.pull)(0.5, &values.constraints);
        let held = values.constraints.iter().zip(half).map(|(c, y)| c * y);
        let seen = Seen {
            variables: variables.to_vec(),
            merit: values.objective + held.sum::<f64>(),
            values,
        };
        // At rounding of the value the gradient says which is better.
        let better = memory.best.as_ref().is_none_or(|best| {
            let rounding = 1e-14 * best.merit.abs();
            seen.merit < best.merit - rounding
                || (seen.merit <= best.merit + rounding
                    && norm(&seen.values.gradient) < norm(&best.values.gradient))
        });
        if better {
            memory.fruitless = 0;
            memory.best = Some(seen.clone());
        }
        memory.last = Some(seen.clone());
        Ok(seen)
    }
}

impl CostFunction for Stage<'_> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, variables: &Vec<f64>) -> Result<f64, ArgminError> {
        Ok(self.at(variables)?.merit / self.unit)
    }
}

impl Gradient for Stage<'_> {
    type Param = Vec<f64>;
    type Gradient = Vec<f64>;

    fn gradient(&self, variables: &Vec<f64>) -> Result<Vec<f64>, ArgminError> {
        let gradient = self.at(variables)?.values.gradient;
        Ok(gradient.iter().map(|g| g / self.unit).collect())
    }
}

/// The problem behind a transcription, its states eliminated by simulation.
fn reduced(program: &Transcription, v: &[f64], pull: &dyn Fn(&[f64]) -> Vec<f64>) -> Values {
    let here = LiftedPoint {
        variables: v.to_vec(),
        trajectory: Trajectory::with_capacity(program.problem().rod.n_nodes(), 0),
    };
    let point = program.rollout(&here, &vec![0.0; v.len()]).unwrap();
    let evaluation = program.evaluate(&point).unwrap();
    let pulls = Multipliers {
        constraints: pull(&evaluation.constraints),
        ..Multipliers::zeros(0, program.n_path_rows(), program.sets())
    };
    Values {
        objective: evaluation.objective,
        gradient: program.lagrangian_gradient(&point, &pulls).unwrap(),
        constraints: evaluation.constraints,
    }
}

/// The short reach, its force within `bound`.
fn bounded(hold: Hold, bound: Option<Bound>) -> OptimalControlProblem {
    let (_, mut problem) = reach(hold);
    problem.channels[0].channel.bound = bound;
    problem
}

/// Of the projection on what constraints see: more than the negative curvature there.
const PENALTY: f64 = 1e6;

/// Short reaches, hard and soft goals, one with a bound that is not touched: both methods end at the same optimum, also when
/// the second one starts a tenth away from it, without multipliers. Objectives agree to 1e-6; controls to what both residual gradients leave
/// and constraints leave to first order, twice.
#[test]
fn both_methods_agree() {
    let soft = |mut problem: OptimalControlProblem| {
        problem.goals[0].enforcement = Enforcement::Soft { weight: 3.0 };
        problem.objective.rate = 1e-3;
        problem
    };
    for problem in [
        bounded(Hold::Constant, Some(Bound::Norm(1e3))),
        soft(bounded(Hold::Constant, None)),
    ] {
        let program = Transcription::new(&problem, 1);
        let (start, _) = first_point(&problem, Guess::StaticPath, None).unwrap();
        let settings = SqpSettings {
            tolerance: 1e-8,
            ..SqpSettings::default()
        };
        let outcome = solve(&program, start, &settings, &mut |_| {
            ControlFlow::Continue(())
        });
        assert_eq!(outcome.status, SqpStatus::Converged);
        let optimum = &outcome.point.variables;
        let away: Vec<f64> = optimum.iter().map(|v| 0.9 * v).collect();
        let other = minimize(&|v, pull| reduced(&program, v, pull), &away);
        let inside = |set: &ConvexSet| set.violation(&other.variables) <= 0.0;
        assert!(program.sets().iter().all(inside));
        let difference = (other.objective / outcome.objective - 1.0).abs();
        assert!(difference < 1e-6, "{difference:e}");

        let evaluation = program.evaluate(&outcome.point).unwrap();
        let request = LinearizationRequest {
            multipliers: Some(&outcome.multipliers),
            rows: &[],
        };
        let linearization = program
            .linearize(&outcome.point, &evaluation, &request)
            .unwrap();
        // A residual gradient g and unmet constraints c move the optimum by (H + μ A⁺A)⁻¹ (g + μ A⁺c) to first order, whatever μ is,
        // with the pseudoinverse A⁺.
        // AAᵀ would lose half of the digits.
        let jacobian = &linearization.jacobian;
        let svd = jacobian.thin_svd().unwrap();
        let (m, n) = (jacobian.nrows(), jacobian.ncols());
        let singular = svd.S().column_vector();
        let scaled = Mat::from_fn(n, m, |i, j| svd.V()[(i, j)] / singular[j]);
        let inverse = scaled * svd.U().transpose();
        let hessian = &linearization.gauss_newton
            + linearization.curvature.as_ref().unwrap()
            + svd.V() * svd.V().transpose() * faer::Scale(PENALTY);
        let least = hessian.self_adjoint_eigenvalues(Side::Lower).unwrap()[0];
        assert!(least > 0.0, "{least:e}");
        let own = program
            .lagrangian_gradient(&outcome.point, &outcome.multipliers)
            .unwrap();
        let own = own.iter().map(|g| g * g).sum::<f64>().sqrt();
        let factor = hessian.llt(Side::Lower).unwrap();
        let by_constraints = factor.solve(&inverse).norm_l2() * PENALTY;
        let unmet = (other.feasibility + outcome.residual.feasibility) * (m as f64).sqrt();
        let allowed = 2.0 * ((own + other.gradient) / least + by_constraints * unmet);
        let apart = (other.variables.iter().zip(optimum))
            .map(|(a, b)| (a - b).powi(2))
            .sum::<f64>()
            .sqrt();
        assert!(apart < allowed, "{apart:e} {allowed:e}");
        assert!(allowed < 5e-2, "{allowed:e}");
    }
}

/// A block that is pushed from rest at 0 to rest at 1 in unit time by `n` constant forces: the double integrator, exactly
/// discretized. The least `½∫u²` is `6/(1 - 1/n²)`.
fn push(u: &[f64], pull: &dyn Fn(&[f64]) -> Vec<f64>) -> Values {
    let h = 1.0 / u.len() as f64;
    let lever = |j: usize| h * (1.0 - (j as f64 + 0.5) * h);
    let position: f64 = u.iter().enumerate().map(|(j, u)| lever(j) * u).sum();
    let velocity: f64 = u.iter().map(|u| h * u).sum();
    let constraints = vec![position - 1.0, velocity];
    let pull = pull(&constraints);
    Values {
        objective: 0.5 * h * u.iter().map(|u| u * u).sum::<f64>(),
        gradient: (u.iter().enumerate())
            .map(|(j, u)| h * u + pull[0] * lever(j) + pull[1] * h)
            .collect(),
        constraints,
    }
}

/// The loop on a problem whose answer is known: value, forces falling linearly, multipliers.
#[test]
fn double_integrator_is_exact() {
    for n in [2, 10, 50] {
        let found = minimize(&push, &vec![0.0; n]);
        let n = n as f64;
        let exact = 6.0 / (1.0 - 1.0 / (n * n));
        assert!((found.objective / exact - 1.0).abs() < 1e-6, "{found:?}");
        for (j, u) in found.variables.iter().enumerate() {
            let expected = exact * (1.0 - (2.0 * j as f64 + 1.0) / n);
            // The gradient h (u - u*) is below 1e-6.
            assert!(
                (u - expected).abs() < 1e-6 * n + 1e-6,
                "{j}: {u} {expected}"
            );
        }
        assert!((found.multipliers[0] + 2.0 * exact).abs() < 1e-4 * exact);
    }
}
