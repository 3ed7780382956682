//! `softarm solve SCENE [--out DIR]`

use std::ops::ControlFlow;
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::Serialize;

use clap::Args;

use super::advice;
use super::check::{expectation, warnings};
use super::console::{Console, stop_signal};
use super::error::CliError;
use super::report_pages::{SolvePage, solve_page};
use super::simulate::push_row;
use super::solve_diagnostics::diagnostics;
use super::step_kind::{legend, step_kind};
use super::verify::read_coefficients;
use super::{Global, Outcome, SceneAndOut, exit, memory, scene_name};
use crate::control::second_opinion::{SecondOpinionSettings, second_opinion, without_inequalities};
use crate::control::{
    Attempt, Feedback, FeedbackError, Hold, LiftedPoint, OptimalControlProblem, PathEnforcement,
    PathRow, Search, SearchEvent, SolveLog, TrackingError, Transcription, observe, search_telling,
    tracking_errors,
};
use crate::mechanics::{Energy, State, StepError, Wrench};
use crate::memory::of_solve;
use crate::output::summary::{
    AttemptSummary, BetweenSummary, CheckOutcome, CheckRecord, EnergyAccount, GrowthSummary,
    MomentumAccount, NOT_CHECKED, NamedConstraint, PhaseSummary, SCHEMA_VERSION,
    SecondOpinionSummary, SecondOrderSummary, SensitivitySummary, SolveSummary, StartSummary,
    StrainSummary, TOOL,
};
use crate::output::{
    ControlRow, MotionRecord, MultiplierRecord, OutputError, ResultDirectory, ResultKind,
    RunDirectory, render_report, row_bytes, write_controls, write_feedback,
};
use crate::scene::{OptimalControl, Scene};
use crate::sqp::{
    Evaluation, IterationRecord, LiftedProgram as _, Multipliers, Progress, SqpOutcome, SqpStatus,
    Stop, StopSignal,
};
use crate::verify::growth::Growth;
use crate::verify::second_order::Extremum;
use crate::verify::{CheckError, ForwardCheck, Solution};

/// How many constraints are named.
const NAMED: usize = 5;

/// Arguments of `solve`.
#[derive(Debug, Args)]
#[command(after_help = super::step_kind::help())]
pub(super) struct SolveArguments {
    #[command(flatten)]
    scene: SceneAndOut,
    /// Solve from this many starts, detours chosen by --seed after the first, and keep the best that is certified
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1000))]
    starts: u16,
    /// Start from the controls in the result directory of an earlier solve, of this scene or one like it; where that leads nowhere, as
    /// without
    #[arg(long, value_name = "DIR")]
    from: Option<PathBuf>,
    /// Check as `verify` does: the second-order condition and the growth of disturbances too, which take longer than most solves
    #[arg(long)]
    deep: bool,
    /// Minimize the same objective by L-BFGS on adjoint gradients as well, from a tenth away, and compare; for problems without
    /// obstacles, limits and tolerances
    #[arg(long)]
    second_opinion: bool,
}

pub(super) fn run(arguments: &SolveArguments, global: &Global, console: &Console) -> Outcome {
    let started = Instant::now();
    console.catch_interrupts();
    let (scene, source) = Scene::load(&arguments.scene.scene, &global.set)?;
    let stop = stop_signal(scene.deadline(started));
    let mut described = (scene.optimal_control_until(&source, &stop))
        .map_err(|error| CliError::of_scene(error, &stop))?;
    for warning in warnings(&scene, &described.problem.rod, described.problem.grid.step) {
        console.warn(&warning);
    }
    let mut previous = None;
    if let Some(directory) = arguments.from.as_deref() {
        let earlier = Earlier::read(directory, &stop)?;
        described = earlier.timed(described);
        previous = Some(earlier.controls(&described.problem));
    }
    if arguments.second_opinion {
        without_inequalities(&described.problem)?;
    }
    let starts = usize::from(arguments.starts);
    memory::require(&of_solve(&described, starts, global.n_threads()), &source)?;
    let target = arguments.scene.directory("solve");
    let directory = RunDirectory::open(&target, ResultKind::Solve)?;

    if let Some(expected) = expectation(&described, global.n_threads()) {
        console.say(&expected);
    }
    announce(&described, console);
    let plan = Search {
        previous,
        starts,
        seed: global.seed,
        n_threads: global.n_threads(),
        ..described.search.clone()
    };
    let alone = plan.starts == 1;
    let attempts = search_telling(&described.problem, &described.settings, &plan, &|event| {
        match event {
            SearchEvent::Begins { from, before, .. } if alone => {
                if let Some(last) = before.last() {
                    let number = before.len() + 1;
                    let (earlier, ended) = (&last.from, &last.ended);
                    console.say(&format!(
                        "attempt {number}, from {from}; the one before, from {earlier}: {ended}"
                    ));
                }
            }
            SearchEvent::Row { row, .. } if alone => console.say(&table_row(row)),
            SearchEvent::Ends(attempt) if !alone => console.say(&start_row(attempt)),
            _ => {}
        }
        ControlFlow::Continue(())
    })?;
    let Chosen {
        setup,
        solved: solution,
        starts,
        feedback,
        certify_time,
        feedback_time,
    } = best(
        &described,
        attempts,
        plan.starts,
        arguments.deep,
        global,
        console,
    );
    let other = (arguments.second_opinion && !stop.is_raised())
        .then(|| other_opinion(&setup, &solution, console))
        .transpose()
        .or_else(|error| {
            if stop.is_raised() {
                Ok(None)
            } else {
                Err(error)
            }
        })?;
    let wall = started.elapsed().as_secs_f64();
    let mut summary = summarize(
        arguments,
        &setup,
        &solution,
        starts,
        wall,
        certify_time,
        &target,
    );
    if summary.status != "converged" {
        let problem = &setup.problem;
        let mut causes = advice::causes(&problem.rod, &problem.initial, problem.grid.end());
        if !causes.is_empty() {
            causes.extend(summary.message.take());
            summary.message = Some(causes.join("; "));
        }
    }
    summary.phases_s.feedback = feedback_time;
    summary.second_opinion = other;
    if let Some(feedback) = &feedback {
        summary.open_loop_sensitivity = Some(SensitivitySummary::of(&feedback.open_loop));
        summary.closed_loop_sensitivity = Some(SensitivitySummary::of(&feedback.closed_loop));
    }
    let diagnostics = (setup.diagnostics && !stop.is_raised())
        .then(|| diagnostics(&setup.problem, &solution.coefficients))
        .and_then(|found| {
            let warn = |error| console.warn(&format!("no diagnostics.npz: {error}"));
            found.map_err(warn).ok()
        });
    let written = directory.publish_or_rescue(|result| {
        let summary = SolveSummary {
            directory: result.place().display().to_string(),
            ..summary.clone()
        };
        if let Some(diagnostics) = &diagnostics {
            diagnostics.write_npz(&result.path().join("diagnostics.npz"))?;
        }
        write(
            result,
            &scene,
            &setup,
            &solution,
            feedback.as_ref(),
            &summary,
            global.n_threads(),
        )
    });
    if let Err(OutputError::Elsewhere { place, .. }) = &written {
        summary.directory = place.display().to_string();
    }
    if alone {
        let rows: Vec<_> = (solution.attempt.solves.iter())
            .flat_map(|solve| &solve.rows)
            .copied()
            .collect();
        console.say(&legend(&rows));
    }
    conclude(&setup.problem, &summary, &solution, console);
    if let Ok(directory) = &written {
        let report = directory.join("report.html");
        console.say(&format!("report: {}", report.display()));
    }
    console.summary(&summary);
    written?;
    Ok(exit_code(&solution))
}

/// Size of the start of a second opinion, in that of the solution.
const AWAY: f64 = 0.9;

/// The optimum by another method; of a free duration, at the one that was found.
fn other_opinion(
    setup: &OptimalControl,
    solution: &Solved,
    console: &Console,
) -> Result<SecondOpinionSummary, CliError> {
    let outcome = &solution.attempt.outcome;
    let problem = setup.problem.held();
    let ours = &outcome.point.variables[..problem.n_variables()];
    let n_controls = problem.n_controls();
    let start: Vec<f64> = (ours.iter().enumerate())
        .map(|(i, v)| if i < n_controls { AWAY * v } else { *v })
        .collect();
    let found = second_opinion(&problem, &start, &SecondOpinionSettings::default())?;
    let objective = found.objective + setup.problem.duration_price();
    let summary = SecondOpinionSummary {
        status: found.status.name(),
        objective,
        relative_difference: (objective / outcome.objective - 1.0).abs(),
        iterations: found.evaluations,
        largest_control_difference: (found.variables.iter().zip(ours))
            .take(n_controls)
            .fold(0.0, |m: f64, (a, b)| m.max((a - b).abs())),
    };
    console.say(&format!(
        "second opinion (L-BFGS): {} after {} simulations, objective {:.8e}, off by {:.1e}; controls by {:.1e} of their scale",
        summary.status,
        summary.iterations,
        summary.objective,
        summary.relative_difference,
        summary.largest_control_difference
    ));
    Ok(summary)
}

/// The regulator around a converged solution, where the scene wants one.
fn feedback_of(setup: &OptimalControl, solution: &Solved, n_threads: usize) -> FoundFeedback {
    let weights = setup.feedback.as_ref()?;
    let converged = solution.attempt.outcome.status == SqpStatus::Converged;
    let trajectory = &solution.attempt.outcome.point.trajectory;
    let coefficients = &solution.coefficients;
    converged.then(|| Feedback::along(&setup.problem, trajectory, coefficients, weights, n_threads))
}

/// An earlier solution.
struct Earlier {
    problem: OptimalControlProblem,
    coefficients: Vec<Wrench>,
}

impl Earlier {
    fn read(directory: &Path, stop: &StopSignal) -> Result<Self, CliError> {
        let path = directory.join("scene.toml");
        if !path.is_file() {
            return Err(CliError::Directory(format!(
                "--from {}: {}; give the result directory of an earlier solve, as results/reach-solve",
                directory.display(),
                if directory.is_dir() {
                    "a directory without scene.toml is no result"
                } else {
                    "there is no such directory"
                }
            )));
        }
        let (scene, source) = Scene::load(&path.to_string_lossy(), &[])?;
        let described = scene.optimal_control_until(&source, stop);
        let problem = described
            .map_err(|error| CliError::of_scene(error, stop))?
            .problem;
        Ok(Self {
            coefficients: read_coefficients(directory, &problem)?,
            problem,
        })
    }

    /// A problem with a free duration begins with that of the earlier solution, as near as its limits allow.
    fn timed(&self, setup: OptimalControl) -> OptimalControl {
        let Some(free) = setup.problem.duration else {
            return setup;
        };
        let duration = self.problem.grid.end().clamp(free.shortest, free.longest);
        setup.stretched(duration / setup.problem.grid.end())
    }

    /// The coefficients at the times of a problem's.
    fn controls(&self, problem: &OptimalControlProblem) -> Vec<Wrench> {
        let earlier = &self.problem;
        let n = earlier.actuators.len();
        let last = earlier.grid.n_steps;
        let nodes = earlier.actuated_nodes();
        let mut out = Vec::new();
        for t in problem.control.coefficient_times() {
            let k = ((t / earlier.grid.step).round() as usize).min(last);
            out.extend(problem.actuators.iter().map(|actuator| {
                let found = nodes.iter().position(|node| *node == actuator.node);
                found.map_or_else(Wrench::default, |a| {
                    (earlier.control).value(k, |j| self.coefficients[j * n + a])
                })
            }));
        }
        out
    }
}

/// What a search ends with.
struct Chosen {
    /// The problem, on the grid of the solution.
    setup: OptimalControl,
    solved: Solved,
    feedback: Option<Feedback>,
    /// How all attempts fared.
    starts: Vec<StartSummary>,
    /// Of all checks, s.
    certify_time: f64,
    /// Of the solution's feedback, s.
    feedback_time: f64,
}

/// The best attempt that the check certifies, or else the best.
fn best(
    described: &OptimalControl,
    attempts: Vec<Attempt>,
    n_starts: usize,
    deep: bool,
    global: &Global,
    console: &Console,
) -> Chosen {
    let mut starts = Vec::new();
    let mut chosen: Option<(OptimalControl, Solved, Timed<FoundFeedback>)> = None;
    let mut certify_time = 0.0;
    for mut attempt in attempts {
        let certified = |solved: &Solved| {
            (solved.check.as_ref()).is_some_and(ForwardCheck::is_certified)
                && solved.attempt.outcome.status == SqpStatus::Converged
        };
        let settled = (chosen.as_ref()).is_some_and(|(_, solved, _)| certified(solved));
        let mut start = StartSummary {
            start: attempt.start,
            from: attempt.from,
            status: status_words(&attempt.outcome.status, &[]).0,
            objective: attempt.outcome.objective,
            iterations: attempt.iterations(),
            verdict: None,
        };
        // Worse than a certified one, or not converged while another is: nothing to check.
        let worth =
            chosen.is_none() || (!settled && attempt.outcome.status == SqpStatus::Converged);
        if worth {
            let setup = described.on_own_grid(&mut attempt.outcome.point.variables);
            let program = Transcription::new(&setup.problem, 1);
            let mut solved = Solved::of(&setup, &program, attempt);
            let (check, feedback) = examine(&setup, &solved, deep, global.n_threads());
            certify_time += check.seconds;
            match check.found {
                Ok(check) => {
                    start.verdict = Some(check.verdict());
                    solved.check = Some(check);
                }
                Err(error) => match error.stopped() {
                    Some(stop) => {
                        start.verdict = Some(NOT_CHECKED);
                        solved.unchecked = Some(stop);
                    }
                    None => console.warn(&format!("the check could not be made: {error}")),
                },
            }
            if chosen.is_none() || certified(&solved) {
                chosen = Some((setup, solved, feedback));
            }
        }
        starts.push(start);
    }
    // Those that nobody waited for.
    let missing = (0..n_starts).filter(|at| !starts.iter().any(|start| start.start == *at));
    let missing: Vec<usize> = missing.collect();
    starts.extend(missing.into_iter().map(|start| StartSummary {
        start,
        from: "not begun",
        status: (described.problem.stop.raised()).map_or("failed", |stop| {
            status_words(&SqpStatus::Stopped(stop), &[]).0
        }),
        objective: f64::NAN,
        iterations: 0,
        verdict: None,
    }));
    starts.sort_by_key(|start| start.start);
    let Some((setup, solved, feedback)) = chosen else {
        unreachable!("a search has at least one attempt")
    };
    let feedback_time = feedback.seconds;
    let mut solved = solved;
    let feedback = (feedback.found.transpose()).unwrap_or_else(|error| {
        match error {
            FeedbackError::Step(StepError::Stopped(stop)) => solved.without_gains = Some(stop),
            error => console.warn(&format!("no feedback gains: {error}")),
        }
        None
    });
    Chosen {
        setup,
        solved,
        feedback,
        starts,
        certify_time,
        feedback_time,
    }
}

/// What was found, and the time that it took.
struct Timed<T> {
    found: T,
    seconds: f64,
}

impl<T> Timed<T> {
    fn of(find: impl FnOnce() -> T) -> Self {
        let clock = Instant::now();
        let found = find();
        Self {
            found,
            seconds: clock.elapsed().as_secs_f64(),
        }
    }
}

type FoundFeedback = Option<Result<Feedback, FeedbackError>>;

/// The check and the feedback, beside each other if there is more than one thread.
fn examine(
    setup: &OptimalControl,
    solved: &Solved,
    deep: bool,
    n_threads: usize,
) -> (
    Timed<Result<ForwardCheck, CheckError>>,
    Timed<FoundFeedback>,
) {
    let certify = || Timed::of(|| certify(setup, solved, deep));
    let others = n_threads.saturating_sub(1).max(1);
    let feedback = || Timed::of(|| feedback_of(setup, solved, others));
    beside(n_threads, certify, feedback)
}

/// Both results, the second from a thread of its own if there may be more than one.
fn beside<A, B: Send>(
    n_threads: usize,
    first: impl FnOnce() -> A,
    second: impl FnOnce() -> B + Send,
) -> (A, B) {
    if n_threads == 1 {
        return (first(), second());
    }
    std::thread::scope(|scope| {
        let second = scope.spawn(second);
        let first = first();
        let second = second.join();
        (first, second.unwrap_or_else(|panic| resume_unwind(panic)))
    })
}

/// The check, with the second-order condition where it is asked for, or where the solver's last Hessian was not positive by itself:
/// there it may have stopped at a saddle.
fn certify(
    setup: &OptimalControl,
    solved: &Solved,
    deep: bool,
) -> Result<ForwardCheck, CheckError> {
    let outcome = &solved.attempt.outcome;
    let mut check = setup.certify(&solved.solution())?;
    let last = (outcome.history.iter().rev()).find(|row| row.step_norm > 0.0);
    let doubtful = last.is_some_and(|row| !row.hessian.is_positive());
    if deep || (outcome.status == SqpStatus::Converged && check.is_certified() && doubtful) {
        check.deepen(&setup.problem, &solved.solution())?;
    }
    Ok(check)
}

fn exit_code(solved: &Solved) -> u8 {
    let check = solved.check.as_ref();
    match solved.attempt.outcome.status {
        SqpStatus::Converged if solved.unchecked.is_some() => exit::STOPPED,
        SqpStatus::Converged if check.is_some_and(ForwardCheck::is_certified) => {
            match solved.without_gains {
                Some(_) => exit::STOPPED,
                None => exit::DONE,
            }
        }
        SqpStatus::Converged => exit::REJECTED,
        SqpStatus::LocallyInfeasible => exit::INFEASIBLE,
        SqpStatus::IterationLimit | SqpStatus::StepTooSmall => exit::NOT_CONVERGED,
        SqpStatus::Stopped(_) => exit::STOPPED,
        SqpStatus::Failed(_) => exit::NUMERICAL,
    }
}

/// An attempt, with what belongs to it.
struct Solved {
    attempt: Attempt,
    coefficients: Vec<Wrench>,
    multipliers: MultiplierRecord,
    /// The constraints that are violated most, or nearest to it.
    worst: Vec<NamedConstraint>,
    /// The check, if it could be made.
    check: Option<ForwardCheck>,
    /// Why the check was not made to its end.
    unchecked: Option<Stop>,
    /// Why the gains that the scene wants were not found any more.
    without_gains: Option<Stop>,
}

impl Solved {
    fn of(setup: &OptimalControl, program: &Transcription, mut attempt: Attempt) -> Self {
        let outcome = &mut attempt.outcome;
        let is_start =
            outcome.history.is_empty() && matches!(outcome.status, SqpStatus::Stopped(_));
        // Nobody waits for the values of a long motion that is not even the first iterate.
        let values = (!(is_start && stopped_steps_per_row(&setup.problem) > 1))
            .then(|| program.evaluate(&outcome.point).ok())
            .flatten();
        if let (true, Some(values)) = (is_start, &values) {
            outcome.objective = program.total_objective(values);
            outcome.multipliers = Multipliers::zeros(
                values.constraints.len(),
                values.inequalities.len(),
                program.sets(),
            );
        }
        let worst = values
            .map(|values: Evaluation<_>| worst_constraints(program, outcome, &values))
            .unwrap_or_default();
        Self {
            coefficients: setup.problem.wrenches(&outcome.point.variables),
            multipliers: MultiplierRecord::of(program, outcome),
            worst,
            check: None,
            unchecked: None,
            without_gains: None,
            attempt,
        }
    }

    /// Every how many time nodes the written motion has a row: every one, unless the solve or its check was stopped, when nobody waits for
    /// that many.
    fn steps_per_row(&self, problem: &OptimalControlProblem) -> usize {
        let is_stopped = matches!(self.attempt.outcome.status, SqpStatus::Stopped(_));
        if self.check.is_none() && (is_stopped || self.unchecked.is_some()) {
            stopped_steps_per_row(problem)
        } else {
            1
        }
    }

    fn solution(&self) -> Solution<'_> {
        Solution {
            trajectory: &self.attempt.outcome.point.trajectory,
            coefficients: &self.coefficients,
            multipliers: self.multipliers.borrowed(),
        }
    }
}

/// What of a motion is packed in about a tenth of a second, in bytes.
const MOST_STOPPED_BYTES: u64 = 4_000_000;

/// Every how many time nodes the motion of a solve that was stopped is written.
fn stopped_steps_per_row(problem: &OptimalControlProblem) -> usize {
    let row = row_bytes(&MotionRecord::empty(problem.rod.n_nodes()).arrays());
    let rows = (MOST_STOPPED_BYTES / row).max(2) as usize;
    problem.grid.n_steps.div_ceil(rows).max(1)
}

fn announce(setup: &OptimalControl, console: &Console) {
    let problem = &setup.problem;
    console.say(&format!(
        "{} elements ({}), {} steps of {:.4e} s, {} blocks, {} variables",
        problem.rod.n_elements(),
        problem.rod.strain_rule.name(),
        problem.grid.n_steps,
        problem.grid.step,
        problem.control.n_blocks(),
        problem.n_controls(),
    ));
    if let (Some(free), true) = (problem.duration, problem.objective.effort > 0.0) {
        let size = (2.0 * free.price / problem.objective.effort).sqrt();
        let tip = &problem.actuators[0];
        console.say(&format!(
            "a second costs {}, as much as a force of {:.3e} N or a moment of {:.3e} N m that is held for it",
            free.price,
            size * tip.force.scale,
            size * tip.moment.scale
        ));
    }
    console.say(TABLE_HEAD);
}

const TABLE_HEAD: &str =
    " iter     objective   stationar.  feasib.    complem.   step       radius     kind  qp  time";

fn table_row(row: &IterationRecord) -> String {
    format!(
        "{:5}  {:12.6e}  {:9.2e}  {:9.2e}  {:9.2e}  {:9.2e}  {:9.2e}  {:4}  {:3}  {:.2}",
        row.iteration,
        row.objective,
        row.residual.stationarity,
        row.residual.feasibility,
        row.residual.complementarity,
        row.step_norm,
        row.trust_radius,
        step_kind(row),
        row.qp_iterations,
        row.elapsed
    )
}

/// The solves of the start that the result is from.
fn attempts(attempt: &Attempt) -> Vec<AttemptSummary> {
    let of = |(number, solve): (usize, &SolveLog)| AttemptSummary {
        from: solve.from.clone(),
        iterations: solve.rows.len().saturating_sub(1),
        ended: solve.ended.clone(),
        is_result: number == attempt.chosen,
    };
    attempt.solves.iter().enumerate().map(of).collect()
}

/// A start that has ended, of several.
fn start_row(attempt: &Attempt) -> String {
    let outcome = &attempt.outcome;
    format!(
        "start {:3}  {:9} {:18} {:4} iterations  objective {:12.6e}  infeasibility {:8.2e}",
        attempt.start,
        attempt.from,
        status_words(&outcome.status, &[]).0,
        attempt.iterations(),
        outcome.objective,
        outcome.residual.feasibility
    )
}

#[allow(clippy::too_many_arguments)]
fn summarize(
    arguments: &SolveArguments,
    setup: &OptimalControl,
    solution: &Solved,
    starts: Vec<StartSummary>,
    wall: f64,
    certify: f64,
    target: &Path,
) -> SolveSummary {
    let problem = &setup.problem;
    let outcome = &solution.attempt.outcome;
    let check = solution.check.as_ref();
    let (status, message) = status_words(&outcome.status, &solution.worst);
    SolveSummary {
        schema_version: SCHEMA_VERSION,
        tool: TOOL,
        command: "solve",
        scene: scene_name(&arguments.scene.scene),
        status,
        message,
        advice: advice(setup, solution),
        iterations: solution.attempt.iterations(),
        objective: outcome.objective,
        wall_s: wall,
        iteration_s: median_iteration(&outcome.history),
        phases_s: PhaseSummary {
            linearize: outcome.phases.linearize,
            condense: outcome.phases.condense,
            qp: outcome.phases.qp,
            globalize: outcome.phases.globalize,
            certify,
            feedback: 0.0,
        },
        kkt: outcome.residual,
        convergence: outcome.convergence,
        tip_error_m: check.map_or(f64::NAN, |check| check.tip_error),
        tip_angle_rad: check.map_or(f64::NAN, |check| check.tip_angle),
        tip_speed_m_s: check.map_or(f64::NAN, |check| check.tip_speed),
        tracking: tracking_errors(problem, &outcome.point.trajectory),
        check: (check.map(|check| CheckRecord::Made(Box::new(check_outcome(check)))))
            .or_else(|| solution.unchecked.map(CheckRecord::not_checked)),
        progress: match outcome.status {
            SqpStatus::Stopped(_) => Progress::of(&outcome.history),
            _ => None,
        },
        steps_per_row: Some(solution.steps_per_row(problem)).filter(|&steps| steps > 1),
        open_loop_sensitivity: None,
        closed_loop_sensitivity: None,
        second_opinion: None,
        worst_constraints: solution.worst.clone(),
        qp_backend: outcome.route.name(),
        hessian: setup.settings.hessian.name(),
        guess: solution.attempt.from,
        abandoned: solution.attempt.abandoned.clone(),
        attempts: attempts(&solution.attempt),
        starts,
        model: problem.rod.model.name(),
        strain: problem.rod.strain_rule.name(),
        elements: problem.rod.n_elements(),
        step_s: problem.grid.step,
        steps: problem.grid.n_steps,
        duration_s: problem.grid.end(),
        control_blocks: problem.control.n_blocks(),
        variables: outcome.point.variables.len(),
        multipliers: outcome.multipliers.constraints.clone(),
        directory: target.display().to_string(),
    }
}

/// The check as the summaries carry it.
pub(super) fn check_outcome(check: &ForwardCheck) -> CheckOutcome {
    CheckOutcome {
        same_grid_m: check.same_grid,
        same_grid_rad: check.same_grid_turn,
        refined_time_m: check.refined_time,
        refined_space_m: check.refined_space,
        order_time: check.order_time,
        order_space: check.order_space,
        objective: check.objective,
        between: (check.between.iter())
            .map(|between| BetweenSummary {
                name: between.name.clone(),
                excess: between.excess,
                unit: between.unit,
                reference: between.reference,
                along: between.along,
                time_s: between.time,
            })
            .collect(),
        strains: StrainSummary {
            stretch: [check.strains.least_stretch, check.strains.largest_stretch],
            curvature_1_m: check.strains.curvature,
            twist_1_m: check.strains.twist,
        },
        kkt: check.kkt,
        kkt_parts: check.kkt_parts.to_vec(),
        energy: EnergyAccount {
            work: check.energy.work,
            change: check.energy.change,
            dissipation: check.energy.dissipation,
            relative_residual: check.energy.relative(),
            halving_ratio: check.energy_ratio,
            halving_ratio_largest: check.energy_halving,
        },
        momentum: MomentumAccount {
            linear_n_s: check.momentum.linear,
            angular_n_m_s: check.momentum.angular,
            over_rounding: check.momentum.over_rounding,
            time_s: check.momentum.time,
        },
        second_order: check.second_order.as_ref().map(|found| SecondOrderSummary {
            verdict: found.extremum().name(),
            eigenvalue: found.eigenvalue,
            error: found.error,
            largest: found.largest,
            dimension: found.dimension,
            held: found.held,
            products: found.products,
            gain: check.gain_over_objective(found),
        }),
        growth: check.growth.as_ref().map(|growth| GrowthSummary {
            amplification: growth.amplification,
            disturbance: growth.disturbance,
            tip_from_state_m: growth.tip_from_state,
            tip_from_control_m: growth.tip_from_control,
            sentence: growth.sentence(),
        }),
        verdict: check.verdict(),
        failed: check
            .items
            .iter()
            .filter(|item| !item.holds())
            .map(|item| item.name)
            .collect(),
    }
}

/// The status in a word, and what else there is to say.
fn status_words(status: &SqpStatus, worst: &[NamedConstraint]) -> (&'static str, Option<String>) {
    match status {
        SqpStatus::Converged => ("converged", None),
        SqpStatus::LocallyInfeasible => (
            "locally-infeasible",
            worst.first().map(|worst| {
                format!(
                    "the constraints cannot all be met to first order: {} is off by {:.3e} {}; move the target, give it more \
                     time, or loosen control.force_max_n, control.moment_max_n_m, obstacles and limits",
                    worst.name, worst.amount, worst.unit
                )
            }),
        ),
        SqpStatus::IterationLimit => (
            "iteration-limit",
            Some("raise solver.max_iterations, loosen solver.tolerance, or try another solver.guess".into()),
        ),
        SqpStatus::StepTooSmall => (
            "step-too-small",
            Some("no acceptable step was found; try solver.guess, more blocks, or more time".into()),
        ),
        SqpStatus::Stopped(Stop::Deadline) => (
            "deadline",
            Some("solver.deadline_s is over; the best iterate is in the result directory".into()),
        ),
        SqpStatus::Stopped(Stop::Interrupted) => ("interrupted", None),
        SqpStatus::Failed(reason) => ("failed", Some(reason.clone())),
    }
}

/// Constraints by name, the most violated (scaled) first; those of a path with their worst row only. Where nothing is hard, the soft
/// goals.
fn worst_constraints<D>(
    program: &Transcription,
    outcome: &SqpOutcome<LiftedPoint>,
    values: &Evaluation<D>,
) -> Vec<NamedConstraint> {
    let problem = program.problem();
    let axes = ["x", "y", "z"];
    let of = |multipliers: &[f64], i: usize| multipliers.get(i).copied().unwrap_or(f64::NAN);
    let (mut named, mut soft) = (Vec::new(), Vec::new());
    let mut slacks = outcome.point.variables[problem.n_controls()..].iter();
    for (i, row) in program.goal_rows().iter().enumerate() {
        let goal = &problem.goals[row.goal];
        let slack = problem.has_slack(row).then(|| slacks.next());
        let scaled = values.constraints[i] + slack.flatten().copied().unwrap_or(0.0);
        let (off, list) = match problem.rest_radius(row.goal, row.part) {
            Some(radius) => ((scaled.abs() - radius).max(0.0), &mut named),
            None if problem.soft_weight(row).is_some() => (scaled.abs(), &mut soft),
            None => (scaled.abs(), &mut named),
        };
        list.push((
            off,
            NamedConstraint {
                name: format!("{}.{} {}", goal.name, row.part.name(), axes[row.axis]),
                node: goal.node,
                time_s: problem.grid.time(goal.time_node),
                amount: scaled * problem.goal_scale(row.part),
                unit: row.part.unit(),
                multiplier: of(&outcome.multipliers.constraints, i),
            },
        ));
    }
    let mut worst: Vec<Option<(f64, usize)>> = vec![None; program.path().len()];
    for (i, &h) in values.inequalities.iter().enumerate() {
        let slot = &mut worst[program.path_row(i).constraint];
        if slot.is_none_or(|(most, _)| h > most) {
            *slot = Some((h, i));
        }
    }
    for (h, i) in worst.into_iter().flatten() {
        let PathRow {
            constraint,
            time,
            item,
        } = program.path_row(i);
        let constraint = &program.path()[constraint];
        if constraint.enforcement != PathEnforcement::Hard {
            continue;
        }
        named.push((
            h,
            NamedConstraint {
                name: constraint.name.clone(),
                node: constraint.limit.node(item),
                time_s: problem.grid.time(constraint.time_nodes[time]),
                amount: h * constraint.limit.scale(&problem.rod),
                unit: constraint.limit.unit(),
                multiplier: of(&outcome.multipliers.inequalities, i),
            },
        ));
    }
    if named.is_empty() {
        named = soft;
    }
    named.sort_by(|a, b| b.0.total_cmp(&a.0));
    named
        .into_iter()
        .map(|(_, named)| named)
        .take(NAMED)
        .collect()
}

/// What helps where a solve did not converge, or the check rejects it.
fn advice(setup: &OptimalControl, solution: &Solved) -> Vec<String> {
    let outcome = &solution.attempt.outcome;
    let converged = outcome.status == SqpStatus::Converged;
    // What the check rejects for another reason than its errors has a remedy of its own.
    let is_unresolved = |check: &ForwardCheck| {
        let fails =
            |name: &str| (check.items.iter()).any(|item| item.name == name && !item.holds());
        [
            "refined_time_m",
            "refined_space_m",
            "energy",
            "energy_halving",
        ]
        .into_iter()
        .any(fails)
    };
    if converged && !solution.check.as_ref().is_some_and(is_unresolved) {
        return Vec::new();
    }
    let tolerance = setup.settings.tolerance;
    let feasible = !converged && outcome.residual.feasibility <= tolerance;
    let not_optimal = feasible.then(|| {
        format!(
            "feasible, not optimal: every constraint holds to {:.1e} (scaled), the stationarity is {:.1e}; the motion can be used, at an \
             objective that is not the least",
            outcome.residual.feasibility, outcome.residual.stationarity
        )
    });
    // Nobody waits for statics after a deadline.
    let motion = if setup.problem.stop.is_raised() {
        Vec::new()
    } else {
        observe(
            &setup.problem,
            &outcome.point.trajectory,
            &solution.coefficients,
        )
    };
    not_optimal
        .into_iter()
        .chain(motion.iter().map(ToString::to_string))
        .collect()
}

fn median_iteration(history: &[IterationRecord]) -> f64 {
    let mut times: Vec<f64> = history
        .windows(2)
        .map(|rows| rows[1].elapsed - rows[0].elapsed)
        .collect();
    if times.is_empty() {
        return 0.0;
    }
    times.sort_by(f64::total_cmp);
    let (low, high) = ((times.len() - 1) / 2, times.len() / 2);
    0.5 * (times[low] + times[high])
}

fn write(
    directory: &ResultDirectory,
    scene: &Scene,
    setup: &OptimalControl,
    solution: &Solved,
    feedback: Option<&Feedback>,
    summary: &SolveSummary,
    n_threads: usize,
) -> Result<(), OutputError> {
    let record = motion_record(&setup.problem, solution);
    let write_motion = || record.write_npz(&directory.path().join("trajectory.npz"));
    let write_rest = || {
        let outcome = &solution.attempt.outcome;
        write_controls(
            &directory.path().join("controls.csv"),
            &control_rows(&setup.problem, &solution.coefficients),
        )?;
        write_iterations(
            &directory.path().join("iterations.csv"),
            &solution.attempt.solves,
        )?;
        directory.write_text("scene.toml", &setup.resolved.to_toml())?;
        directory.write_json("multipliers.json", &solution.multipliers)?;
        if let Some(feedback) = feedback {
            let path = directory.path().join("feedback.npz");
            write_feedback(&path, feedback, setup.problem.grid.end())?;
        }
        directory.write_json("summary.json", summary)?;
        if let Some(problem) = &outcome.failed_subproblem {
            directory.write_text("failed-subproblem.json", problem)?;
        }
        let page = solve_page(&SolvePage {
            scene,
            setup,
            record: &record,
            coefficients: &solution.coefficients,
            solves: &solution.attempt.solves,
            check: solution.check.as_ref(),
            feedback,
            summary,
        });
        directory.write_text("report.html", &render_report(&page))
    };
    let (rest, motion) = beside(n_threads, write_rest, write_motion);
    motion.and(rest)
}

/// The solution's own configurations, with the energies of its replay.
fn motion_record(problem: &OptimalControlProblem, solution: &Solved) -> MotionRecord {
    let trajectory = &solution.attempt.outcome.point.trajectory;
    let control = problem.signal(&problem.control, &solution.coefficients);
    let mut record = MotionRecord::empty(trajectory.n_nodes);
    let stride = solution.steps_per_row(problem);
    let last = trajectory.n_times() - 1;
    for k in (0..last).step_by(stride).chain([last]) {
        let wrench = &control.at(k).wrenches[0];
        let state = State::at_rest(trajectory.configuration(k));
        let energy = solution.check.as_ref().map_or_else(
            || Energy::of(&problem.rod, &state),
            |check| check.replay.energies[k],
        );
        let dilatation = problem.rod.dilatation(&state.configuration.positions);
        push_row(
            &mut record,
            problem.grid.time(k),
            &state,
            wrench,
            &energy,
            &dilatation,
        );
    }
    record
}

/// A row per coefficient and actuator: per block of a constant hold, per knot, with equal times, of a linear one, per control point
/// of a spline.
fn control_rows(problem: &OptimalControlProblem, coefficients: &[Wrench]) -> Vec<ControlRow> {
    let edges = problem.control.edge_times();
    let times = problem.control.coefficient_times();
    let n = problem.actuators.len();
    coefficients
        .iter()
        .enumerate()
        .map(|(i, u)| {
            let j = i / n;
            let (t_start, t_end) = match problem.control.hold {
                Hold::Constant => (edges[j], edges[j + 1]),
                Hold::Linear | Hold::Cubic => (times[j], times[j]),
            };
            ControlRow {
                t_start,
                t_end,
                fx: u.force.x,
                fy: u.force.y,
                fz: u.force.z,
                mx: u.moment.x,
                my: u.moment.y,
                mz: u.moment.z,
                node: problem.actuators[i % n].node,
            }
        })
        .collect()
}

#[derive(Serialize)]
struct IterationRow<'a> {
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
    attempt: usize,
    from: &'a str,
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
                attempt: number + 1,
                from: &solve.from,
            })
            .map_err(cannot_write)?;
    }
    writer
        .flush()
        .map_err(OutputError::unwritten(path, "cannot write"))
}

fn conclude(
    problem: &OptimalControlProblem,
    summary: &SolveSummary,
    solution: &Solved,
    console: &Console,
) {
    let check = solution.check.as_ref();
    let objective = if summary.objective.is_nan() {
        "no value of the objective".into()
    } else {
        format!("objective {:.8e}", summary.objective)
    };
    console.say(&format!(
        "{} after {} iterations, {:.2} s: {objective}",
        summary.status, summary.iterations, summary.wall_s
    ));
    if let Some(free) = problem.duration {
        console.say(&format!(
            "duration {:.6} s, free between {} and {} s",
            summary.duration_s, free.shortest, free.longest
        ));
    }
    show_tracking(&summary.tracking, console);
    if summary.status != "converged" {
        let message = summary
            .message
            .as_deref()
            .unwrap_or("the best iterate is in the result directory");
        console.always(&format!("{}: {message}", summary.status));
        if let Some(progress) = summary.progress {
            console.always(&progress.sentence());
        }
    } else if check.is_some_and(|check| !check.is_certified()) {
        console.always("the solver converged, but the check rejects the result");
    }
    for sentence in &summary.advice {
        console.say(&format!("  {sentence}"));
    }
    if summary.status != "converged" {
        for constraint in &summary.worst_constraints {
            console.say(&format!(
                "  {}: off by {:.3e} {} at node {}, t = {} s (multiplier {:.3e})",
                constraint.name,
                constraint.amount,
                constraint.unit,
                constraint.node,
                constraint.time_s,
                constraint.multiplier
            ));
        }
    }
    if let (Some(open), Some(closed)) = (
        summary.open_loop_sensitivity,
        summary.closed_loop_sensitivity,
    ) {
        console.say(&format!(
            "a perturbation grows at most {:.3} times by the end ({:.3} with feedback), {:.3} times on the way ({:.3})",
            open.horizon, closed.horizon, open.worst, closed.worst
        ));
    }
    if let Some(check) = check {
        let converged = summary.status == "converged";
        show_check(check, problem, converged, console);
        if console.is_quiet() && converged && check.is_certified() {
            console.always(&format!(
                "{} after {} iterations, {:.2} s: objective {:.8e}",
                check.verdict(),
                summary.iterations,
                summary.wall_s,
                summary.objective
            ));
        }
    }
    if let Some(stop) = solution.unchecked {
        let status = &summary.status;
        console.always(&format!("{status}, {NOT_CHECKED}: {stop}"));
    }
    if let Some(steps) = summary.steps_per_row {
        console.say(&format!(
            "the motion is written every {steps} steps; `softarm solve SCENE --from {}` goes on from its controls",
            summary.directory
        ));
    }
    if let Some(stop) = solution.without_gains {
        console.always(&format!("no feedback gains: {stop}"));
    }
}

/// How well the paths are followed.
pub(super) fn show_tracking(tracking: &[TrackingError], console: &Console) {
    for error in tracking {
        console.say(&format!("path of node {}: missed by {error}", error.node));
    }
}

/// What the check found beside its criteria: the worst row of every part of the conditions by name, the kind of extremum, and the
/// growth of disturbances.
pub(super) fn findings(check: &ForwardCheck) -> Vec<String> {
    let rows = (check.kkt_parts.iter())
        .filter_map(|part| Some((part.name, part.worst.as_ref()?)))
        .map(|(part, row)| {
            let name = [row.name.as_str(), row.component].join(" ");
            let value = format!("{:.2e} {}", row.value, row.unit);
            format!(
                "worst of {part}: {} of node {} at t = {:.5} s, {} ({:.1e} scaled)",
                name.trim_end(),
                row.node,
                row.time_s,
                value.trim_end(),
                row.scaled
            )
        });
    let second = check.second_order.as_ref().map(|found| {
        let to_gain = match found.extremum() {
            Extremum::NotAMinimum => format!(
                "stationary, not a minimum: at most {:.2} % to gain; ",
                100.0 * check.gain_over_objective(found)
            ),
            kind => format!("{}: ", kind.name()),
        };
        format!(
            "{to_gain}smallest curvature {:.3e} +- {:.1e} in {} directions, {} held",
            found.eigenvalue, found.error, found.dimension, found.held
        )
    });
    let growth = check.growth.as_ref().map(Growth::sentence);
    rows.chain(second).chain(growth).collect()
}

/// Every criterion on its line, then the verdict.
pub(super) fn show_check(
    check: &ForwardCheck,
    problem: &OptimalControlProblem,
    converged: bool,
    console: &Console,
) {
    for item in &check.items {
        let mark = if item.holds() { "ok  " } else { "FAIL" };
        console.say(&format!(
            "  {mark} {:20} {:10.3e} <= {:9.2e} {}",
            item.name, item.value, item.limit, item.unit
        ));
    }
    for line in findings(check) {
        console.say(&format!("  {line}"));
    }
    if converged {
        console.verdict(check.is_certified(), check.verdict());
        for item in check.items.iter().filter(|item| !item.holds()) {
            console.say(&format!("  {}: {}", item.name, item.remedy(problem)));
        }
    }
}
