//! Checks every analytic derivative of a problem, with a verdict on each.
//!
//! The code that simulations and solves run is compared: laws of the elements, the linearized step, objective, goals, path
//! constraints, actuators, the reduced Hessian. A [`Block`] is a family of curves through one point with the analytic slopes of their
//! values there. The step of the differences is swept, and the bound of the deviation follows from the sweep. The point is random, bent,
//! moving and admissible, because at rest many derivatives vanish. Identities that hold for any rod (the symplectic form, tangent against
//! adjoint, kernels against the plain sweeps) are in the tests.

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

/// One derivative, or family of them, and how far it is from what it was compared with, at its worst.
#[derive(Clone, Debug, Serialize)]
pub struct Block {
    /// Its name.
    pub name: String,
    /// The two sides.
    pub compared: &'static str,
    /// The worst of its comparisons.
    #[serde(flatten)]
    pub worst: Comparison,
    /// What that says.
    pub verdict: Verdict,
}

/// All blocks of a check.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The worst verdict of any block.
    pub verdict: Verdict,
    /// What was compared.
    pub blocks: Vec<Block>,
    /// What was not, and where the check was made.
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

/// The motion breaks down at the point where it should be differentiated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DerivativeError {
    /// In the integrator.
    #[error("no motion to differentiate: {0}")]
    Step(#[from] StepError),
    /// In the transcribed problem.
    #[error("no motion to differentiate: {0}")]
    Model(#[from] Failure),
}

/// Returns the block of the worst of some comparisons; `None` if nothing was to be compared.
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

/// Longest horizon that is differentiated, in steps; steps that are solved for cost a hundred times as much.
const LONGEST: usize = 48;
const LONGEST_IMPLICIT: usize = 16;
/// Its blocks of control.
const MOST_BLOCKS: usize = 4;
/// The random state is drawn this many times, each half as far from rest as the one before.
const DRAWS: i32 = 8;

/// Checks what a simulation of `rod` needs, from a state drawn by `seed`.
///
/// # Errors
/// [`DerivativeError`] where no drawn state can be simulated.
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
    let step = mechanics::step_linearization(rod, grid.step, &state, &|_| {}, seed)?;
    let blocks = [stress, stiffness, loads, step];
    Ok(Report::new(blocks.into_iter().flatten().collect(), notes))
}

/// Checks everything that an optimal-control problem needs, from a state and controls drawn by `seed`.
///
/// # Errors
/// [`DerivativeError`] where no drawn state can be simulated.
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

/// The beginning of a horizon that is not too long to be differentiated.
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

/// A random state from which the rod can be simulated over the grid.
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
