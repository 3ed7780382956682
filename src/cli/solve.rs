//! `softarm solve SCENE [--out DIR]`: solves, certifies, writes the result and prints progress and verdict.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use serde::Serialize;

use super::console::Console;
use super::error::CliError;
use super::progress::{Awaited, LiveStarts};
use super::{Global, Outcome, SceneAndOut, exit, memory, scene_name};
use crate::control::{
    Attempt, GuessError, Holding, ModelMismatch, OptimalControlProblem, Search, SearchEvent,
    TipDeviation, TrackingError, holding, search_telling,
};
use crate::memory::of_solve;
use crate::output::summary::{NOT_CHECKED, NearestHeldSummary, SolveSummary};
use crate::output::{ResultKind, RunDirectory};
use crate::scene::{OptimalControl, Scene};
use crate::solve::nearest::nearest;
use crate::solve::scene_check::{expectation, warnings};
use crate::solve::{
    Chosen, Doubted, Earlier, Examination, Examined, Solution, choose, diagnostics, findings, help,
    legend, publish, read_coefficients, start_not_begun, start_summary, status_words, summarize,
};
use crate::sqp::{IterationRecord, SqpStatus, StopSignal};
use crate::task::staying::nearest_in_words;
use crate::tradeoff::solve_on_grids;
use crate::verify::ForwardCheck;

/// Arguments of `solve`.
#[derive(Debug, Args)]
#[command(after_help = help())]
pub(super) struct SolveArguments {
    #[command(flatten)]
    pub(super) scene: SceneAndOut,
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
}

pub(super) fn run(arguments: &SolveArguments, global: &Global, console: &Console) -> Outcome {
    let started = Instant::now();
    console.catch_interrupts();
    let (scene, source) = console.load(&arguments.scene.scene, global)?;
    let stop = console.stop_signal(scene.deadline(started));
    let mut described = (scene.optimal_control_until(&source, &stop))
        .map_err(|error| CliError::of_scene(error, &stop))?;
    for warning in warnings(&scene, &described.problem.rod, described.problem.grid.step) {
        console.warn(&warning);
    }
    let not_held = not_held(&scene, &described.problem);
    if let Some((words, _)) = &not_held {
        console.warn(words);
    }
    let mut previous = None;
    if let Some(directory) = arguments.from.as_deref() {
        let earlier = earlier(directory, &stop)?;
        described = earlier.timed(described);
        previous = Some(earlier.controls(&described.problem));
    }
    let starts = usize::from(arguments.starts);
    memory::require(&of_solve(&described, starts, global.n_threads()), &source)?;
    let doubted = Doubted::of(&described, &source, global.n_threads())?;
    let target = arguments.scene.directory("solve");
    let directory = RunDirectory::open(&target, ResultKind::Solve)?;

    let pose = |scene: &Scene| {
        (scene.optimal_control_until(&source, &stop))
            .map_err(|error| CliError::of_scene(error, &stop))
    };
    let attempt = |setup: &OptimalControl, previous| {
        memory::require(&of_solve(setup, starts, global.n_threads()), &source)?;
        attempt(setup, previous, arguments, global, console)
    };
    let first = (described, previous);
    let mut found = solve_on_grids(&scene, first, pose, attempt, |words| console.say(words))?;
    if let Some(warning) = &found.warning {
        console.warn(warning);
    }
    if let Some(doubted) = doubted {
        let doubted = doubted.on(&found.setup, &source)?;
        let again = |setup: &OptimalControl, controls| attempt(setup, Some(controls));
        let unnarrowed = (found.setup, found.chosen);
        let (setup, mut chosen) = doubted.narrow(unnarrowed, again, |words| console.say(words))?;
        doubted.replay_chosen(&setup, &mut chosen);
        (found.setup, found.chosen) = (setup, chosen);
    }
    let Chosen {
        solution,
        examined,
        starts,
        spent,
    } = found.chosen;
    for warning in &examined.warnings {
        console.warn(warning);
    }
    let setup = found.setup.around(&solution.problem);
    let problem = &solution.problem.discrete;
    let wall = started.elapsed().as_secs_f64();
    let mut summary = summarize(
        &scene_name(&arguments.scene.scene),
        &solution,
        &examined,
        starts,
        spent,
        wall,
        &target,
    );
    summary.accuracy = found.accuracy;
    if let Some((words, nearest)) = not_held {
        summary.advice.push(words);
        summary.nearest = summary.nearest.or(nearest);
    }
    let diagnostics = (setup.diagnostics && !stop.is_raised())
        .then(|| diagnostics(problem, &solution.coefficients))
        .and_then(|found| {
            let warn = |error| console.warn(&format!("no diagnostics.npz: {error}"));
            found.map_err(warn).ok()
        });
    let written = publish(
        directory,
        (&setup, diagnostics.as_ref()),
        (&solution, &examined),
        &mut summary,
        global.n_threads(),
    );
    if arguments.starts == 1 {
        let rows: Vec<_> = (solution.solves())
            .flat_map(|(_, solve)| &solve.rows)
            .copied()
            .collect();
        console.say(&legend(&rows));
    }
    conclude(problem, &summary, &examined, console);
    if let Ok(directory) = &written {
        let report = directory.join("report.html");
        console.say(&format!("report: {}", report.display()));
    }
    console.summary(&summary);
    written?;
    if let Some(accuracy) = &summary.accuracy {
        if !accuracy.met {
            console.always(&accuracy.why);
            return Ok(exit::REJECTED);
        }
        console.say(&accuracy.why);
    }
    Ok(exit_code(&solution, &examined))
}

/// Returns the reason why the tip of an arm that should stay at its target only stops there for an instant, and the nearest point at which
/// it can be held, if one was found.
fn not_held(
    scene: &Scene,
    problem: &OptimalControlProblem,
) -> Option<(String, Option<NearestHeldSummary>)> {
    if !scene.stays() || problem.stay.is_some() {
        return None;
    }
    let found = holding(problem).ok();
    let why = match &found {
        Some(Holding::NotFound { why, nearest }) => {
            format!(": {why}{}", nearest_in_words(problem, nearest.as_ref()))
        }
        _ => String::new(),
    };
    let words = format!(
        "task.at_rest: nothing was found that holds the arm at its target, so that the tip only stops for an instant{why}"
    );
    Some((words, found.and_then(|found| nearest(problem, &found))))
}

/// Solves a problem from all starts, checks what they find, and tells on the way.
fn attempt(
    setup: &OptimalControl,
    previous: Option<Vec<f64>>,
    arguments: &SolveArguments,
    global: &Global,
    console: &Console,
) -> Result<Chosen, CliError> {
    let starts = usize::from(arguments.starts);
    let alone = starts == 1;
    if let Some(expected) = expectation(setup, global.n_threads()) {
        console.say(&expected);
    }
    announce(setup, console);
    if alone {
        console.say(TABLE_HEAD);
    }
    let plan = Search {
        previous,
        starts,
        seed: global.seed(),
        n_threads: global.n_threads(),
        ..setup.search.clone()
    };
    let live = (!alone).then(|| LiveStarts::new(starts, console));
    let attempts = search_telling(&setup.problem, &setup.settings, &plan, &|event| {
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
            SearchEvent::Row { start, row } => {
                let event = IterationEvent { start: *start, row };
                match &live {
                    None => {
                        console.event("iteration", &event);
                        console.say(&table_row(row));
                    }
                    Some(live) => {
                        if console.json() {
                            live.beside(|| console.event("iteration", &event));
                        }
                        live.iterate(*start, row);
                    }
                }
            }
            SearchEvent::StartBegins { start } => {
                if let Some(live) = &live {
                    live.begin(*start, None);
                }
            }
            SearchEvent::Begins { start, from, .. } => {
                if let Some(live) = &live {
                    live.begin(*start, Some(from));
                }
            }
            SearchEvent::StartEnds { start, found } => {
                if let Some(live) = &live {
                    let summary =
                        found.map_or_else(|_| start_not_begun(*start, "failed"), start_summary);
                    let converged = summary.status == "converged";
                    live.end(*start, converged.then_some(summary.objective));
                    live.beside(|| {
                        console.event("start", &summary);
                        console.say(&start_row(*start, *found));
                    });
                }
            }
        }
        ControlFlow::Continue(())
    })?;
    let posed = setup.posed();
    let awaited = Awaited::check(&setup.problem, arguments.deep, console);
    let chosen = choose(
        &posed,
        &setup.settings,
        attempts,
        plan.starts,
        &Examination {
            feedback: setup.feedback.as_ref(),
            deep: arguments.deep,
            n_threads: global.n_threads(),
        },
    );
    drop(awaited);
    Ok(chosen)
}

/// The solution in the result directory of an earlier solve.
fn earlier(directory: &Path, stop: &StopSignal) -> Result<Earlier, CliError> {
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
    Ok(Earlier {
        coefficients: read_coefficients(directory, &problem)?,
        problem,
    })
}

fn exit_code(solution: &Solution, examined: &Examined) -> u8 {
    let check = examined.check.as_ref();
    match solution.status() {
        SqpStatus::Converged if examined.unchecked.is_some() => exit::STOPPED,
        SqpStatus::Converged if check.is_some_and(ForwardCheck::is_certified) => {
            match examined.without_gains {
                Some(_) => exit::STOPPED,
                None => exit::DONE,
            }
        }
        SqpStatus::Converged => exit::REJECTED,
        SqpStatus::LocallyInfeasible => exit::INFEASIBLE,
        SqpStatus::IterationLimit | SqpStatus::StepTooSmall | SqpStatus::RoundingLimit { .. } => {
            exit::NOT_CONVERGED
        }
        SqpStatus::Stopped(_) => exit::STOPPED,
        SqpStatus::Failed(_) => exit::NUMERICAL,
    }
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
        problem.n_variables(),
    ));
    if let (Some(free), true) = (problem.duration, problem.objective.effort > 0.0) {
        let size = (2.0 * free.price / problem.objective.effort).sqrt();
        let held = price_in_words(problem, size);
        if !held.is_empty() {
            console.say(&format!(
                "a second costs {}, as much as {held} that is held for it",
                free.price
            ));
        }
    }
}

/// Returns what costs as much as `size` of scaled controls: a force or a moment on the first actuated node, or the change of the effort of
/// the first actuator whose effort is a control.
fn price_in_words(problem: &OptimalControlProblem, size: f64) -> String {
    if let Some(first) = problem
        .wrench_actuators()
        .into_iter()
        .find(|node| node.acts())
    {
        let force =
            (first.force.acts()).then(|| format!("a force of {:.3e} N", size * first.force.scale));
        let moment = (first.moment.acts())
            .then(|| format!("a moment of {:.3e} N m", size * first.moment.scale));
        return (force.into_iter().chain(moment))
            .collect::<Vec<_>>()
            .join(" or ");
    }
    let efforts = problem.driven().next().map(|(drive, channel)| {
        let value = format!("{:.3e} {}", size * channel.scale, drive.input_unit());
        format!("{} of \"{}\"", value.trim_end(), drive.name)
    });
    efforts.unwrap_or_default()
}

const TABLE_HEAD: &str =
    "iter    objective stationar  feasib. complem.     step   radius kind   qp    time";

fn table_row(row: &IterationRecord) -> String {
    format!(
        "{:4} {:12.6e} {:9.1e} {:8.1e} {:8.1e} {:8.1e} {:8.1e} {:5} {:3} {:7.2}",
        row.iteration,
        row.objective,
        row.stationarity,
        row.feasibility,
        row.complementarity,
        row.step_norm,
        row.trust_radius,
        row.step,
        row.qp_iterations,
        row.elapsed
    )
}

/// The line of an iteration in the output of `--json-lines`.
#[derive(Serialize)]
struct IterationEvent<'a> {
    /// Number of the start, from 0.
    start: usize,
    #[serde(flatten)]
    row: &'a IterationRecord,
}

/// A start that has ended, of several.
fn start_row(start: usize, found: Result<&Attempt, &GuessError>) -> String {
    let attempt = match found {
        Ok(attempt) => attempt,
        Err(error) => return format!("start {start:3} has no first point: {error}"),
    };
    let outcome = &attempt.outcome;
    format!(
        "start {:3} {:8} {:18} {:4} iterations, objective {:.5e}, off {:.0e}",
        attempt.start,
        attempt.from,
        status_words(&outcome.status, &[]).0,
        attempt.iterations(),
        outcome.objective,
        outcome.residual.feasibility
    )
}

fn conclude(
    problem: &OptimalControlProblem,
    summary: &SolveSummary,
    examined: &Examined,
    console: &Console,
) {
    let check = examined.check.as_ref();
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
            summary.facts.duration_s, free.shortest, free.longest
        ));
    }
    show_tracking(&summary.reached.tracking, console);
    for goal in &summary.reached.soft_goals {
        console.say(&goal.in_words());
    }
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
    } else if check.is_none() && examined.unchecked.is_none() {
        console.always("the solver converged, but the check could not be made");
        for warning in examined.warnings.iter().filter(|_| console.is_quiet()) {
            console.always(warning);
        }
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
        summary.sensitivities.open_loop_sensitivity,
        summary.sensitivities.closed_loop_sensitivity,
    ) {
        console.say(&format!(
            "a perturbation grows at most {:.3} times by the end ({:.3} with feedback), {:.3} times on the way ({:.3})",
            open.horizon, closed.horizon, open.worst, closed.worst
        ));
    }
    show_mismatches(&summary.model_mismatch, console);
    if let Some(check) = check {
        let converged = summary.status == "converged";
        show_check(check, problem, converged, console);
        if console.is_quiet() && converged && check.is_certified() {
            console.always(&format!(
                "{}; {} iterations, {:.2} s: objective {:.8e}",
                check.sentence(problem),
                summary.iterations,
                summary.wall_s,
                summary.objective
            ));
        }
    }
    if let Some(stop) = examined.unchecked {
        let status = &summary.status;
        console.always(&format!("{status}, {NOT_CHECKED}: {stop}"));
    }
    if let Some(steps) = summary.steps_per_row {
        console.say(&format!(
            "the motion is written every {steps} steps; `softarm solve SCENE --from {}` goes on from its controls",
            summary.directory
        ));
    }
    if let Some(stop) = examined.without_gains {
        console.always(&format!("no feedback gains: {stop}"));
    }
}

/// Prints the effect of the gains on arms that differ from the model; always if they do harm.
fn show_mismatches(mismatches: &[ModelMismatch], console: &Console) {
    if mismatches.is_empty() {
        return;
    }
    let end = |deviation: Option<TipDeviation>| {
        deviation.map_or("breaks down".to_string(), |deviation| {
            format!("{:.2e} m", deviation.end_m)
        })
    };
    console.say("the tip's distance from its planned end on an arm that differs from the model:");
    console.say("  differs by         controls alone  with the gains");
    for mismatch in mismatches {
        let part = 100.0 * (mismatch.factor - 1.0);
        console.say(&format!(
            "  {:10} {part:+5.0} %  {:>14}  {:>14}{}",
            mismatch.quantity.name(),
            end(mismatch.open_loop),
            end(mismatch.closed_loop),
            if mismatch.does_harm() { "  worse" } else { "" }
        ));
    }
    let worse = mismatches.iter().filter(|mismatch| mismatch.does_harm());
    let n_worse = worse.count();
    if n_worse > 0 {
        console.always(&format!(
            "the gains make {n_worse} of {} arms that differ from the model worse: they are for small kicks of an arm that is its model; \
             `softarm mpc` closes the loop on one that is not",
            mismatches.len()
        ));
    }
}

/// Prints the errors of the tracked paths.
pub(super) fn show_tracking(tracking: &[TrackingError], console: &Console) {
    for error in tracking {
        console.say(&format!("path of node {}: missed by {error}", error.node));
    }
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
        console.verdict(check.is_certified(), &check.sentence(problem));
        for item in check.items.iter().filter(|item| !item.holds()) {
            console.say(&format!("  {}: {}", item.name, item.remedy(problem)));
        }
    }
}
