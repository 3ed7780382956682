//! Writes the files of a result directory.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::examined::{Examined, Spent, beside};
use super::page::{SolvePage, iteration, sensitivity, solve_page};
use super::solution::Solution;
use super::step_kind::step_kind;
use super::summary::summarize;
use crate::control::{Hold, OptimalControlProblem, SolveLog};
use crate::mechanics::{Energy, State, Wrench};
use crate::output::summary::SolveSummary;
use crate::output::{
    ControlRow, MotionRecord, OutputError, ResultDirectory, ResultKind, RunDirectory,
    render_report, write_controls, write_feedback,
};
use crate::scene::{DescribeError, Scene};
use crate::sqp::IterationRecord;

/// Why a solution was not saved.
#[derive(Debug, thiserror::Error)]
pub enum SaveError {
    /// The problem is none that a scene can describe.
    #[error(transparent)]
    Describe(#[from] DescribeError),
    /// The files could not be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

/// Name of the scene of a problem that was posed in a program.
const PROGRAM: &str = "program";

/// Writes a solution as the result directory `target`.
pub(super) fn save(
    solution: &Solution,
    examined: &Examined,
    target: &Path,
) -> Result<PathBuf, SaveError> {
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

/// Writes every file of a solution whose scene, resolved, is this text.
pub(crate) fn write(
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
        write_controls(
            &directory.path().join("controls.csv"),
            &control_rows(problem, &solution.coefficients),
        )?;
        write_iterations(
            &directory.path().join("iterations.csv"),
            &solution.attempt.solves,
        )?;
        directory.write_text("scene.toml", scene)?;
        directory.write_json("multipliers.json", &solution.multipliers)?;
        if let Some(feedback) = &examined.feedback {
            let path = directory.path().join("feedback.npz");
            write_feedback(&path, feedback, problem.grid.duration())?;
        }
        directory.write_json("summary.json", summary)?;
        if let Some(problem) = &outcome.failed_subproblem {
            directory.write_text("failed-subproblem.json", problem)?;
        }
        let rows = (solution.attempt.solves.iter().enumerate())
            .flat_map(|(number, solve)| solve.rows.iter().map(move |row| iteration(number, row)));
        let page = solve_page(SolvePage {
            problem: &solution.problem,
            coefficients: &solution.coefficients,
            record: &record,
            summary: &serde_json::to_value(summary).unwrap_or_default(),
            iterations: rows.collect(),
            sensitivity: (examined.feedback.as_ref())
                .map(|found| sensitivity(problem, &found.open_loop, &found.closed_loop)),
        })?;
        directory.write_text("report.html", &render_report(&page))
    };
    let (rest, motion) = beside(n_threads, write_rest, write_motion);
    motion.and(rest)
}

/// The solution's own configurations, with the energies of its replay.
fn motion_record(solution: &Solution, examined: &Examined) -> MotionRecord {
    let problem = &solution.problem.discrete;
    let trajectory = solution.trajectory();
    let control = problem.signal(&problem.control, &solution.coefficients);
    let mut record = MotionRecord::empty(trajectory.n_nodes);
    let stride = solution.steps_per_row(examined);
    let last = trajectory.n_times() - 1;
    for k in (0..last).step_by(stride).chain([last]) {
        let wrench = &control.at(k).wrenches[0];
        let state = State::at_rest(trajectory.configuration(k));
        let energy = examined.check.as_ref().map_or_else(
            || Energy::of(&problem.rod, &state),
            |check| check.replay.energies[k],
        );
        let dilatation = problem.rod.dilatation(&state.configuration.positions);
        record.push_state(problem.grid.time(k), &state, wrench, &energy, &dilatation);
    }
    record
}

/// A row per coefficient and actuator: per block of a constant hold, per knot, with equal times, of a linear one, per control point
/// of a spline; and where the arm stays, one per actuator for the time after the horizon.
fn control_rows(problem: &OptimalControlProblem, coefficients: &[Wrench]) -> Vec<ControlRow> {
    let edges = problem.control.edge_times();
    let times = problem.control.coefficient_times();
    let n = problem.actuators.len();
    let end = problem.grid.duration();
    // Where the arm stays, its last wrenches are held for a time.
    let held = (problem.stay.iter())
        .flat_map(|stay| (stay.wrenches.iter()).map(|u| (u, (end, end + stay.seconds))));
    (coefficients.iter().enumerate())
        .map(|(i, u)| {
            let j = i / n;
            let interval = match problem.control.hold {
                Hold::Constant => (edges[j], edges[j + 1]),
                Hold::Linear | Hold::Cubic => (times[j], times[j]),
            };
            (u, interval)
        })
        .chain(held)
        .enumerate()
        .map(|(i, (u, (t_start, t_end)))| ControlRow {
            t_start,
            t_end,
            fx: u.force.x,
            fy: u.force.y,
            fz: u.force.z,
            mx: u.moment.x,
            my: u.moment.y,
            mz: u.moment.z,
            node: problem.actuators[i % n].node,
        })
        .collect()
}

/// A row of `iterations.csv`, and of the lines of JSON.
#[derive(Serialize)]
pub(crate) struct IterationRow<'a> {
    iteration: usize,
    objective: f64,
    stationarity: f64,
    feasibility: f64,
    complementarity: f64,
    infeasibility: f64,
    step_norm: f64,
    trust_radius: f64,
    kind: String,
    elastic_weight: f64,
    slack: f64,
    linearized_rows: usize,
    working_rows: usize,
    contraction: Option<f64>,
    qp_iterations: u32,
    elapsed_s: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    attempt: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    from: Option<&'a str>,
}

/// What an iteration did.
pub(crate) fn iteration_row<'a>(row: &IterationRecord) -> IterationRow<'a> {
    IterationRow {
        iteration: row.iteration,
        objective: row.objective,
        stationarity: row.residual.stationarity,
        feasibility: row.residual.feasibility,
        complementarity: row.residual.complementarity,
        infeasibility: row.infeasibility,
        step_norm: row.step_norm,
        trust_radius: row.trust_radius,
        kind: step_kind(row),
        elastic_weight: row.elastic_weight,
        slack: row.slack,
        linearized_rows: row.linearized_rows,
        working_rows: row.working_rows,
        contraction: row.contraction,
        qp_iterations: row.qp_iterations,
        elapsed_s: row.elapsed,
        attempt: None,
        from: None,
    }
}

/// The rows of all attempts, one after the other.
fn write_iterations(path: &Path, solves: &[SolveLog]) -> Result<(), OutputError> {
    let cannot_write = |error: csv::Error| {
        OutputError::unwritten(path, "cannot write")(std::io::Error::other(error))
    };
    let mut writer = csv::Writer::from_path(path).map_err(cannot_write)?;
    let rows = (solves.iter().enumerate())
        .flat_map(|(number, solve)| solve.rows.iter().map(move |row| (number, solve, row)));
    for (number, solve, row) in rows {
        writer
            .serialize(IterationRow {
                attempt: Some(number + 1),
                from: Some(&solve.from),
                ..iteration_row(row)
            })
            .map_err(cannot_write)?;
    }
    writer
        .flush()
        .map_err(OutputError::unwritten(path, "cannot write"))
}
