//! Writes the files of a result directory.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::controls::{coefficients_of, control_rows, write_rows_of};
use super::efforts::{commands, effort_rows};
use super::examined::{Examined, Spent, beside, examine};
use super::page::{SolvePage, iteration, sensitivity, solve_page};
use super::solution::{Solution, stopped_steps_per_row};
use super::summary::summarize;
use crate::mechanics::signal::EffortTable;
use crate::mechanics::{Energy, NodalState, State};
#[cfg(feature = "cli")]
use crate::output::DiagnosticsRecord;
use crate::output::summary::SolveSummary;
use crate::output::{
    END_FILE, MotionRecord, OutputError, ResultDirectory, ResultKind, RunDirectory, json_value,
    render_report, write_efforts, write_end, write_feedback,
};
#[cfg(feature = "cli")]
use crate::scene::OptimalControl;
use crate::scene::{DescribeError, Scene};
use crate::sqp::SqpStatus;

/// Reason why a solution was not saved.
#[derive(Debug, thiserror::Error)]
pub enum SaveError {
    /// A scene cannot describe the problem.
    #[error(transparent)]
    Describe(#[from] DescribeError),
    /// The files could not be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

/// Scene name of a problem that was posed in a program.
const PROGRAM: &str = "program";

impl Solution {
    /// Checks the solution, as far as that can be done, and writes it as a result directory, which `softarm verify` reads: `summary.json`,
    /// `controls.csv`, `trajectory.npz`, `multipliers.json`, `iterations.csv`, `scene.toml` and `report.html`. Returns the directory.
    ///
    /// # Errors
    /// [`SaveError`] where the problem cannot be written as a scene, or the files cannot be written.
    pub fn save(&self, directory: &Path) -> Result<PathBuf, SaveError> {
        let (examined, _) = examine(self, None, false, 1);
        save(self, &examined, directory)
    }

    /// Returns the number of time nodes per row of the written motion: one, unless the solve or its check was stopped and nothing was
    /// checked; then a long motion is thinned, so that the files are written at once.
    pub(crate) fn steps_per_row(&self, examined: &Examined) -> usize {
        let is_stopped = matches!(self.status(), SqpStatus::Stopped(_));
        if examined.check.is_none() && (is_stopped || examined.unchecked.is_some()) {
            stopped_steps_per_row(&self.problem)
        } else {
            1
        }
    }
}

/// Writes a solution as the result directory `target` and returns the directory.
fn save(solution: &Solution, examined: &Examined, target: &Path) -> Result<PathBuf, SaveError> {
    let scene = Scene::describing(&solution.problem, &solution.settings)?.to_toml();
    let directory = RunDirectory::open(target, ResultKind::Solve)?;
    let elapsed = (solution.attempt.outcome.history.last()).map_or(0.0, |row| row.elapsed);
    let summary = summarize(
        PROGRAM,
        solution,
        examined,
        Vec::new(),
        Spent::default(),
        elapsed,
        target,
    );
    Ok(directory.publish(|result| write(result, &scene, solution, examined, &summary, 1))?)
}

/// Publishes the result of a scene's solve by way of `directory`, or rescues it to another place; the summary names the place. Returns the
/// directory.
///
/// # Errors
/// [`OutputError::Elsewhere`] where the result went to another place, and [`OutputError`] where no place takes it.
#[cfg(feature = "cli")]
pub(crate) fn publish(
    directory: RunDirectory,
    (setup, diagnostics): (&OptimalControl, Option<&DiagnosticsRecord>),
    (solution, examined): (&Solution, &Examined),
    summary: &mut SolveSummary,
    n_threads: usize,
) -> Result<PathBuf, OutputError> {
    let scene = setup.resolved.to_toml();
    let written = directory.publish_or_rescue(|result| {
        let summary = SolveSummary {
            directory: result.place().display().to_string(),
            ..summary.clone()
        };
        if let Some(diagnostics) = diagnostics {
            diagnostics.write_npz(&result.path().join("diagnostics.npz"))?;
        }
        write(result, &scene, solution, examined, &summary, n_threads)
    });
    if let Err(OutputError::Elsewhere { place, .. }) = &written {
        summary.directory = place.display().to_string();
    }
    written
}

/// Writes every file of a solution whose scene, resolved, is this text.
fn write(
    directory: &ResultDirectory,
    scene: &str,
    solution: &Solution,
    examined: &Examined,
    summary: &SolveSummary,
    n_threads: usize,
) -> Result<(), OutputError> {
    let problem = &solution.problem.discrete;
    let record = motion_record(solution, examined);
    let write_motion = || record.write_npz(&directory.path().join("trajectory.npz"));
    let write_rest = || {
        let outcome = &solution.attempt.outcome;
        let rows = control_rows(problem, &solution.coefficients);
        write_rows_of(&directory.path().join("controls.csv"), problem, &rows)?;
        // A page made of the files has the controls as these round them.
        let coefficients = coefficients_of(&rows, problem);
        if !problem.rod.actuators.is_empty() {
            let stride = solution.steps_per_row(examined);
            let control = problem.signal(&problem.control, &solution.coefficients);
            let table = EffortTable::of(&problem.rod.actuators, &problem.grid, Some(&control));
            let rows = effort_rows(&problem.rod, &record, |row| {
                let k = (row * stride).min(problem.grid.n_steps);
                let own = table.nodes[k * table.n_actuators..][..table.n_actuators].to_vec();
                let commands = commands(problem, &solution.coefficients, k, &own);
                (own, commands)
            });
            write_efforts(&directory.path().join("efforts.csv"), &rows)?;
        }
        if let Some(check) = &examined.check {
            let end = NodalState::of(&problem.rod, &check.replay.end);
            write_end(&directory.path().join(END_FILE), &end)?;
        }
        write_iterations(&directory.path().join("iterations.csv"), solution)?;
        directory.write_text("scene.toml", scene)?;
        directory.write_json("multipliers.json", &solution.multipliers.file(problem))?;
        if let Some(feedback) = &examined.feedback {
            let path = directory.path().join("feedback.npz");
            write_feedback(&path, feedback, problem.grid.duration())?;
        }
        directory.write_json("summary.json", summary)?;
        if let Some(problem) = &outcome.failed_subproblem {
            directory.write_text("failed-subproblem.json", problem)?;
        }
        let several = !solution.coarser.is_empty();
        let rows = (solution.solves()).flat_map(|([grid, attempt], solve)| {
            let grid = several.then_some(grid);
            (solve.rows.iter()).map(move |row| iteration(grid, attempt, row))
        });
        let page = solve_page(SolvePage {
            problem: &solution.problem,
            coefficients: &coefficients,
            record: &record,
            summary: &json_value(summary),
            iterations: rows.collect(),
            sensitivity: (examined.feedback.as_ref())
                .map(|found| sensitivity(problem, &found.open_loop, &found.closed_loop)),
        })?;
        directory.write_text("report.html", &render_report(&page))
    };
    let (rest, motion) = beside(n_threads, write_rest, write_motion);
    motion.and(rest)
}

/// Returns the configurations of the solution with the energies of its replay.
fn motion_record(solution: &Solution, examined: &Examined) -> MotionRecord {
    let problem = &solution.problem.discrete;
    let trajectory = solution.trajectory();
    let control = problem.signal(&problem.control, &solution.coefficients);
    let mut record = MotionRecord::empty(trajectory.n_nodes);
    let stride = solution.steps_per_row(examined);
    let last = trajectory.n_times() - 1;
    for k in (0..last).step_by(stride).chain([last]) {
        let wrench = control.at(k).wrenches.first().copied().unwrap_or_default();
        let state = State::at_rest(trajectory.configuration(k));
        let energy = examined.check.as_ref().map_or_else(
            || Energy::of(&problem.rod, &state),
            |check| check.replay.energies[k],
        );
        let dilatation = problem.rod.dilatation(&state.configuration.positions);
        record.push_state(problem.grid.time(k), &state, &wrench, &energy, &dilatation);
    }
    record
}

/// The solve that an iteration is of, in a row of `iterations.csv`.
#[derive(Serialize)]
struct OfAttempt<'a> {
    attempt: usize,
    from: &'a str,
}

/// The grid that an iteration is of, in a row of `iterations.csv` of a solve on several grids.
#[derive(Serialize)]
struct OfGrid {
    grid: usize,
}

/// Writes the iterations of all attempts on all grids, one attempt after the other.
fn write_iterations(path: &Path, solution: &Solution) -> Result<(), OutputError> {
    let cannot_write = |error: csv::Error| {
        OutputError::unwritten(path, "cannot write")(std::io::Error::other(error))
    };
    let mut writer = csv::Writer::from_path(path).map_err(cannot_write)?;
    let several = !solution.coarser.is_empty();
    for ([grid, attempt], solve) in solution.solves() {
        let from = &solve.from;
        for row in &solve.rows {
            let attempt = OfAttempt { attempt, from };
            let written = match several {
                true => writer.serialize((row, attempt, OfGrid { grid })),
                false => writer.serialize((row, attempt)),
            };
            written.map_err(cannot_write)?;
        }
    }
    writer
        .flush()
        .map_err(OutputError::unwritten(path, "cannot write"))
}
