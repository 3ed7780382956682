//! From a problem to a certified solution and its files: [`solve`], [`Solution::certify`], [`Solution::regulator`], [`Solution::save`].

mod causes;
#[cfg(feature = "cli")]
mod choice;
#[cfg(feature = "cli")]
mod closed_loop;
mod constraints;
mod controls;
mod diagnostics;
#[cfg(feature = "cli")]
mod doubt;
#[cfg(feature = "cli")]
mod earlier;
mod efforts;
#[cfg(feature = "cli")]
mod equilibrium;
mod examined;
mod files;
pub(crate) mod learned;
pub(crate) mod nearest;
mod page;
#[cfg(feature = "cli")]
mod recheck;
#[cfg(feature = "cli")]
pub(crate) mod scene_check;
#[cfg(feature = "cli")]
mod simulation;
mod soft_goals;
mod solution;
mod statics;
mod step_kind;
mod summary;

#[cfg(feature = "cli")]
pub(crate) use self::{
    causes::{causes, stands_by_symmetry},
    choice::{Chosen, Examination, choose},
    closed_loop::{BASELINES, LoopError, LoopEvent, LoopOrder, LoopRun, LoopsInDoubt},
    diagnostics::diagnostics,
    doubt::{Doubted, narrow_as_saved},
    earlier::Earlier,
    equilibrium::{EquilibriumSummary, sweep_record, write_tables},
    examined::Examined,
    files::publish,
    page::{SavedError, SavedPage, equilibrium_page, findings, fit_page, saved_page},
    recheck::{RecheckError, SavedSolution, VerifySummary, read_coefficients},
    simulation::{End, Simulated, SimulationError, SimulationEvent, SimulationRun},
    step_kind::{help, legend},
    summary::{start_not_begun, start_summary, status_words, summarize},
};

/// Returns the coefficients of the controls in the result directory of a problem.
///
/// # Errors
/// Returns the reason why files cannot be read, or have the controls of another problem.
#[cfg(feature = "cli")]
#[doc(hidden)]
pub fn saved_coefficients(
    directory: &std::path::Path,
    problem: &crate::control::OptimalControlProblem,
) -> Result<Vec<f64>, String> {
    read_coefficients(directory, problem).map_err(|error| error.to_string())
}

pub use files::SaveError;
pub use solution::Solution;
pub use statics::{Statics, StaticsError, StaticsOptions, statics};

use std::ops::ControlFlow;

use crate::control::{GuessError, Search, search};
use crate::sqp::SqpSettings;
use crate::task::{Arm, Discretization, DiscretizeError, Problem, Task};

/// Reason why there is no solution, not even one that has not converged.
#[derive(Debug, thiserror::Error)]
pub enum SolveError {
    /// The task cannot be discretized for this arm.
    #[error(transparent)]
    Discretize(#[from] DiscretizeError),
    /// The solver has no initial guess.
    #[error("no start for the solver: {0}")]
    Start(#[from] GuessError),
}

/// Options of [`solve_with`]. The defaults are those of a scene.
#[derive(Clone, Debug, Default)]
pub struct SolveOptions {
    /// Settings of the solver.
    pub settings: SqpSettings,
    /// Number and kind of the initial guesses, and number of threads.
    pub search: Search,
}

/// Discretizes a task for an arm and solves it from one initial guess on one thread.
///
/// A solve that does not converge returns a [`Solution`] too, whose status and residuals tell how far it came.
///
/// # Errors
/// [`SolveError`] where the problem cannot be discretized, or there is no initial guess.
pub fn solve(
    arm: &Arm,
    task: &Task,
    discretization: &Discretization,
) -> Result<Solution, SolveError> {
    solve_with(arm, task, discretization, &SolveOptions::default())
}

/// Does the same as [`solve`] with other settings, initial guesses or threads.
///
/// # Errors
/// As [`solve`].
pub fn solve_with(
    arm: &Arm,
    task: &Task,
    discretization: &Discretization,
    options: &SolveOptions,
) -> Result<Solution, SolveError> {
    let problem = task.discretize(arm, discretization)?;
    solve_problem(&problem, options)
}

/// Solves a problem that is discretized already. The signal with which it was [discretized](Task::discretize_until) ends the work early.
///
/// # Errors
/// [`SolveError::Start`] where there is no initial guess.
pub fn solve_problem(problem: &Problem, options: &SolveOptions) -> Result<Solution, SolveError> {
    let settings = &options.settings;
    let mut attempts = search(&problem.discrete, settings, &options.search, &|_, _| {
        ControlFlow::Continue(())
    })?;
    // The attempts are ordered, the best one first.
    Ok(Solution::of(problem, settings, attempts.swap_remove(0)))
}
