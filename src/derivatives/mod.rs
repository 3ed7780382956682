//! The check of every analytic derivative of a problem, with a verdict on each.
//!
//! The code of simulations and solves is compared: laws of the elements, the linearized step, objective, goals, path constraints,
//! actuators, the reduced Hessian. A [`Block`] is a family of curves through one point with the analytic slopes of their values there. The
//! step of the differences is swept, and the bound of the deviation follows from the sweep. The point is random, bent, moving and
//! admissible, because at rest many derivatives vanish. Identities that hold for any rod (the symplectic form, tangent against adjoint,
//! kernels against the plain sweeps) are in the tests.

mod compare;
mod control;
#[doc(hidden)]
pub mod mechanics;
mod point;

use fastrand::Rng;
use serde::Serialize;

pub use self::compare::{Comparison, Verdict};
use self::point::random_state;
use crate::control::OptimalControlProblem;
use crate::mechanics::implicit::IntervalWeights;
use crate::mechanics::{NodeWrenches, Rod, RodModel, State, StepError, Stepper, TimeGrid};
use crate::sqp::Failure;

/// One derivative, or a family of them, with its largest deviation.
#[derive(Clone, Debug, Serialize)]
pub struct Block {
    /// Name of the derivative.
    pub name: String,
    /// The two sides of the comparison.
    pub compared: &'static str,
    /// The worst of its comparisons.
    #[serde(flatten)]
    pub worst: Comparison,
    /// Verdict of that comparison.
    pub verdict: Verdict,
}

/// All blocks of a check.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The worst verdict of any block.
    pub verdict: Verdict,
    /// The comparisons.
    pub blocks: Vec<Block>,
    /// Notes on derivatives that were not compared, and on the point of the check.
    pub notes: Vec<String>,
}

impl Report {
    fn new(blocks: Vec<Block>, notes: Vec<String>) -> Self {
        let verdicts = blocks.iter().map(|block| block.verdict);
        Self {
            verdict: verdicts.max().unwrap_or(Verdict::Ok),
            blocks,
            notes,
        }
    }
}

/// The motion breaks down at the point of the derivatives.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DerivativeError {
    /// The integrator fails.
    #[error("no motion to differentiate: {0}")]
    Step(#[from] StepError),
    /// The transcribed problem fails.
    #[error("no motion to differentiate: {0}")]
    Model(#[from] Failure),
}

/// Returns the block of the worst of some comparisons; `None` if nothing was compared.
fn gather(
    name: impl Into<String>,
    compared: &'static str,
    found: impl IntoIterator<Item = Option<Comparison>>,
) -> Option<Block> {
    let worst = found.into_iter().flatten().reduce(Comparison::worse)?;
    Some(Block {
        name: name.into(),
        compared,
        worst,
        verdict: worst.verdict(),
    })
}

/// Caps on the steps of a horizon, explicit and implicit ones; implicit steps cost a hundred times as much.
const LONGEST: usize = 48;
const LONGEST_IMPLICIT: usize = 16;
/// Cap on the blocks of control of that horizon.
const MOST_BLOCKS: usize = 4;
/// Number of draws of the random state, each half as far from rest as the one before.
const DRAWS: i32 = 8;

/// Checks the derivatives for a simulation of `rod`, at a state drawn by `seed`.
///
/// # Errors
/// Returns [`DerivativeError`] if no drawn state can be simulated.
pub fn check_motion(rod: &Rod, grid: TimeGrid, seed: u64) -> Result<Report, DerivativeError> {
    let short = shortened(rod, grid);
    let state = simulable_state(rod, short, seed)?;
    let mut notes = vec![format!(
        "at a random state (seed {seed}), over {} of {} steps",
        short.n_steps, grid.n_steps
    )];
    if rod.model == RodModel::Dilatation {
        notes.push("the paper's dilatation model has no energy: no stress by energy".into());
    }
    let [stress, stiffness] = mechanics::element_law(rod, &state, seed);
    let loads = mechanics::loads(rod, &state, seed);
    let [pull, bend] = mechanics::pose_functions(rod, &state, seed);
    let step = mechanics::step_linearization(rod, grid.step, &state, &|_| {}, seed)?;
    let blocks = [stress, stiffness, loads, pull, bend, step];
    Ok(Report::new(blocks.into_iter().flatten().collect(), notes))
}

/// Checks all derivatives of an optimal-control problem, at a state and controls drawn by `seed`.
///
/// # Errors
/// Returns [`DerivativeError`] if no drawn state can be simulated.
pub fn check(problem: &OptimalControlProblem, seed: u64) -> Result<Report, DerivativeError> {
    let rod = &problem.rod;
    let Report {
        mut blocks,
        mut notes,
        ..
    } = check_motion(rod, problem.grid, seed)?;
    let grid = shortened(rod, problem.grid);
    let mut short = control::shortened(problem, grid.n_steps, MOST_BLOCKS);
    short.initial = simulable_state(rod, short.grid, seed)?;
    if rod.model != RodModel::Standard {
        notes.push(
            "the reduced Hessian leaves out second derivatives along the dilatation of the inertia by design: not compared".into(),
        );
    }
    blocks.extend(control::blocks(&short, &mut Rng::with_seed(seed))?);
    Ok(Report::new(blocks, notes))
}

/// Returns the beginning of a horizon, within the caps on its steps.
fn shortened(rod: &Rod, grid: TimeGrid) -> TimeGrid {
    let longest = match IntervalWeights::of(rod, grid.step) {
        None => LONGEST,
        Some(_) => LONGEST_IMPLICIT,
    };
    TimeGrid {
        n_steps: grid.n_steps.min(longest),
        ..grid
    }
}

/// Returns a random state from which the rod can be simulated over the grid.
fn simulable_state(rod: &Rod, grid: TimeGrid, seed: u64) -> Result<State, DerivativeError> {
    let mut outcome = Ok(());
    for draw in 0..DRAWS {
        let state = random_state(rod, f64::powi(0.5, draw), &mut Rng::with_seed(seed));
        let mut stepper = Stepper::new(rod, grid, state.clone());
        outcome = (0..grid.n_steps).try_for_each(|_| stepper.advance([NodeWrenches::NONE; 2]));
        if outcome.is_ok() {
            return Ok(state);
        }
    }
    outcome?;
    Ok(rod.at_rest_on_base(rod.rest.clone()))
}
