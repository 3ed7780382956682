//! Checks every analytic derivative of a problem, with a verdict on each.
//!
//! What is compared is the code that simulations and solves run: laws of the elements, the linearized step, sweeps, objective,
//! goals, path constraints, the reduced Hessian. Against differences the step size is swept and the bound follows from the sweep
//! ([`compare()`]); where an identity exists (the symplectic form, tangent against adjoint) it needs no step size, and sees a wrong
//! entry far below what differences see. The point is random, bent, moving and admissible, because at rest many derivatives vanish.

#[doc(hidden)]
pub mod compare;
mod control;
#[doc(hidden)]
pub mod mechanics;
mod point;

use fastrand::Rng;
use serde::Serialize;

pub use self::compare::{Comparison, Verdict, compare};
pub use self::point::random_state;
use crate::control::OptimalControlProblem;
use crate::mechanics::implicit::IntervalWeights;
use crate::mechanics::linearization::{Motion, StepLinearization};
use crate::mechanics::{Rod, RodModel, State, StepError, Stepper, TimeGrid};
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

/// A block of the worst of some comparisons; `None` without any.
fn gather(
    name: impl Into<String>,
    compared: &'static str,
    found: Vec<Comparison>,
) -> Option<Block> {
    let worst = found.into_iter().reduce(Comparison::worse)?;
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
    let short = TimeGrid {
        n_steps: grid.n_steps.min(longest(rod, grid)),
        ..grid
    };
    let state = simulable_state(rod, short, seed)?;
    let mut notes = vec![format!(
        "at a random state (seed {seed}), over {} of {} steps",
        short.n_steps, grid.n_steps
    )];
    if rod.model == RodModel::Dilatation {
        notes.push(
            "the paper's dilatation model has no energy and is not the variation of an action: no stress by energy, no symplectic \
             identity"
                .into(),
        );
    }
    let blocks = motion_blocks(rod, short, &state, seed)?;
    Ok(report(blocks, notes))
}

/// Checks everything that an optimal-control problem needs, from a state and controls drawn by `seed`.
///
/// # Errors
/// [`DerivativeError`] where no drawn state can be simulated.
pub fn check(problem: &OptimalControlProblem, seed: u64) -> Result<Report, DerivativeError> {
    let mut out = check_motion(&problem.rod, problem.grid, seed)?;
    let mut short = control::shortened(problem, longest(&problem.rod, problem.grid), MOST_BLOCKS);
    short.initial = simulable_state(&problem.rod, short.grid, seed)?;
    if problem.rod.model != RodModel::Standard {
        out.notes.push(
            "the reduced Hessian leaves out second derivatives along the dilatation of the inertia by design: not compared".into(),
        );
    }
    let mut rng = Rng::with_seed(seed);
    out.blocks.extend(control::blocks(&short, &mut rng)?);
    Ok(report(out.blocks, out.notes))
}

fn longest(rod: &Rod, grid: TimeGrid) -> usize {
    match IntervalWeights::of(rod, grid.step) {
        None => LONGEST,
        Some(_) => LONGEST_IMPLICIT,
    }
}

fn report(blocks: Vec<Block>, notes: Vec<String>) -> Report {
    Report {
        verdict: (blocks.iter().map(|block| block.verdict))
            .max()
            .unwrap_or(Verdict::Ok),
        blocks,
        notes,
    }
}

/// A random state from which the rod can be simulated over the grid.
fn simulable_state(rod: &Rod, grid: TimeGrid, seed: u64) -> Result<State, DerivativeError> {
    let mut outcome = Ok(());
    for draw in 0..DRAWS {
        let rng = &mut Rng::with_seed(seed);
        let state = random_state(rod, f64::powi(0.5, draw), rng);
        let mut stepper = Stepper::new(rod, grid, state.clone());
        outcome = (0..grid.n_steps)
            .try_for_each(|_| stepper.advance([crate::mechanics::NodeWrenches::NONE; 2]));
        if outcome.is_ok() {
            return Ok(state);
        }
    }
    outcome?;
    Ok(rod.at_rest_on_base(rod.rest.clone()))
}

fn motion_blocks(
    rod: &Rod,
    grid: TimeGrid,
    state: &State,
    seed: u64,
) -> Result<Vec<Block>, DerivativeError> {
    let clear = |motion: &Motion, trajectory: &crate::mechanics::Trajectory, k: usize| {
        StepLinearization::at(motion, trajectory, k)
    };
    let mut blocks = mechanics::element_law(rod, state, seed);
    blocks.extend(mechanics::loads(rod, state, seed));
    blocks.extend(mechanics::step_linearization(
        rod, grid.step, state, &clear, seed,
    )?);
    blocks.extend(mechanics::symplectic_identity(
        rod, grid.step, state, &clear, seed,
    )?);
    let motion = Motion {
        stop: None,
        rod,
        grid,
        initial: state,
        control: None,
    };
    blocks.extend(mechanics::sweeps(&motion, seed)?);
    Ok(blocks)
}
