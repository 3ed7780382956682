//! `softarm solve SCENE [--out DIR]`

use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

use serde::Serialize;

use super::check::warnings;
use super::console::{Console, interrupted};
use super::report_pages::{SolvePage, solve_page, step_kind};
use super::simulate::push_row;
use super::{Global, Outcome, SceneAndOut, exit, scene_name};
use crate::control::{
    Enforcement, Guess, Hold, LiftedPoint, OptimalControlProblem, TargetRow, Transcription,
    first_point,
};
use crate::mechanics::{Energy, State, Wrench};
use crate::output::summary::{
    CheckOutcome, EnergyAccount, NamedConstraint, PhaseSummary, SCHEMA_VERSION, SolveSummary,
};
use crate::output::{
    ControlRow, MotionRecord, OutputError, ResultDirectory, render_report, write_controls,
};
use crate::scene::{OptimalControl, Scene};
use crate::sqp::{
    Evaluation, IterationRecord, LiftedProgram as _, SqpOutcome, SqpStatus, Stop, solve,
};
use crate::verify::{CheckError, CheckLimits, ForwardCheck, Solution, forward_check};

/// How many constraints are named.
const NAMED: usize = 5;

pub(super) fn run(arguments: &SceneAndOut, global: &Global, console: &Console) -> Outcome {
    let started = Instant::now();
    let (scene, source) = Scene::load(&arguments.scene, &global.set)?;
    let setup = scene.optimal_control(&source)?;
    for warning in warnings(&scene, &setup.problem.rod, setup.problem.grid.step) {
        console.warn(&warning);
    }
    let target = arguments.directory("solve");
    let directory = ResultDirectory::create(&target)?;
    console.catch_interrupts();

    let (start, guess) = first_point(&setup.problem, setup.guess)?;
    if guess != setup.guess {
        console.warn(
            "no static path to the target was found; starting from the motion without control",
        );
    }
    announce(&setup, guess, console);
    let program = Transcription::new(&setup.problem, global.n_threads());
    let outcome = solve(&program, start, &setup.settings, &mut |row| {
        console.say(&table_row(row));
        if interrupted() {
            ControlFlow::Break(Stop::Interrupted)
        } else {
            ControlFlow::Continue(())
        }
    });

    let clock = Instant::now();
    let solution = Solved::of(&setup, &program, outcome);
    let check = certify(
        &setup,
        &Solution {
            trajectory: &solution.outcome.point.trajectory,
            coefficients: &solution.coefficients,
            multipliers: &solution.outcome.multipliers.constraints,
        },
    );
    let certify_time = clock.elapsed().as_secs_f64();
    let check = match check {
        Ok(check) => Some(check),
        Err(error) => {
            console.warn(&format!("the check could not be made: {error}"));
            None
        }
    };
    let wall = started.elapsed().as_secs_f64();
    let summary = summarize(
        arguments,
        &setup,
        guess,
        &solution,
        check.as_ref(),
        wall,
        certify_time,
        &target,
    );
    write(
        &directory,
        &scene,
        &setup,
        &solution,
        check.as_ref(),
        &summary,
    )?;
    let written = directory.finish()?;
    conclude(&summary, check.as_ref(), &written, console);
    console.summary(&summary);
    Ok(exit_code(&solution.outcome.status, check.as_ref()))
}

fn exit_code(status: &SqpStatus, check: Option<&ForwardCheck>) -> u8 {
    match status {
        SqpStatus::Converged if check.is_some_and(ForwardCheck::is_certified) => exit::DONE,
        SqpStatus::Converged => exit::REJECTED,
        SqpStatus::LocallyInfeasible => exit::INFEASIBLE,
        SqpStatus::IterationLimit | SqpStatus::StepTooSmall => exit::NOT_CONVERGED,
        SqpStatus::Stopped(_) => exit::STOPPED,
        SqpStatus::Failed(_) => exit::NUMERICAL,
    }
}

/// An outcome with the control and the target's residuals that belong to it.
struct Solved {
    outcome: SqpOutcome<LiftedPoint>,
    coefficients: Vec<Wrench>,
    rows: Vec<TargetRow>,
    /// Scaled residuals of the target at the solution.
    residuals: Vec<f64>,
}

impl Solved {
    fn of(
        setup: &OptimalControl,
        program: &Transcription,
        outcome: SqpOutcome<LiftedPoint>,
    ) -> Self {
        let residuals = program
            .evaluate(&outcome.point)
            .map(|values: Evaluation<_>| values.constraints)
            .unwrap_or_default();
        Self {
            coefficients: setup.problem.wrenches(&outcome.point.variables),
            rows: program.rows().to_vec(),
            residuals,
            outcome,
        }
    }
}

/// The check of a solution, with the limits that its scene asks for.
pub(super) fn certify(
    setup: &OptimalControl,
    solution: &Solution,
) -> Result<ForwardCheck, CheckError> {
    forward_check(
        &setup.problem,
        &setup.parameters,
        &|rod| {
            // The finer rod's equilibrium exists wherever the coarse one's did; its rest shape is the fall-back.
            (setup.resolved.starting_state(rod))
                .unwrap_or_else(|_| rod.at_rest_on_base(rod.rest.clone()))
        },
        solution,
        &CheckLimits {
            kkt: setup.settings.tolerance.max(CheckLimits::default().kkt),
            ..CheckLimits::default()
        },
    )
}

fn announce(setup: &OptimalControl, guess: Guess, console: &Console) {
    let problem = &setup.problem;
    console.say(&format!(
        "{} elements ({}), {} steps of {:.4e} s, {} blocks, {} variables, start: {}",
        problem.rod.n_elements(),
        problem.rod.strain_rule.name(),
        problem.grid.n_steps,
        problem.grid.step,
        problem.control.n_blocks(),
        problem.control.n_coefficients() * problem.actuated_components().len(),
        guess.name()
    ));
    console.say(" iter     objective   stationar.  feasib.    complem.   step       radius     kind  qp  time");
}

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

#[allow(clippy::too_many_arguments)]
fn summarize(
    arguments: &SceneAndOut,
    setup: &OptimalControl,
    guess: Guess,
    solution: &Solved,
    check: Option<&ForwardCheck>,
    wall: f64,
    certify: f64,
    target: &Path,
) -> SolveSummary {
    let problem = &setup.problem;
    let outcome = &solution.outcome;
    let (status, message) = status_words(&outcome.status, solution, problem);
    SolveSummary {
        schema_version: SCHEMA_VERSION,
        command: "solve",
        scene: scene_name(&arguments.scene),
        status,
        message,
        iterations: outcome.history.len().saturating_sub(1),
        objective: outcome.objective,
        wall_s: wall,
        iteration_s: median_iteration(&outcome.history),
        phases_s: PhaseSummary {
            linearize: outcome.phases.linearize,
            condense: outcome.phases.condense,
            qp: outcome.phases.qp,
            globalize: outcome.phases.globalize,
            certify,
        },
        kkt: outcome.residual,
        tip_error_m: check.map_or(f64::NAN, |check| check.tip_error),
        tip_angle_rad: check.map_or(f64::NAN, |check| check.tip_angle),
        tip_speed_m_s: check.map_or(f64::NAN, |check| check.tip_speed),
        check: check.map(check_outcome),
        worst_constraints: worst_constraints(problem, solution),
        qp_backend: "condensed",
        hessian: setup.settings.hessian.name(),
        guess: guess.name(),
        model: problem.rod.model.name(),
        strain: problem.rod.strain_rule.name(),
        elements: problem.rod.n_elements(),
        step_s: problem.grid.step,
        steps: problem.grid.n_steps,
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
        refined_time_m: check.refined_time,
        refined_space_m: check.refined_space,
        kkt: check.kkt,
        energy: EnergyAccount {
            work: check.energy.work,
            change: check.energy.change,
            dissipation: check.energy.dissipation,
            relative_residual: check.energy.relative(),
            halving_ratio: check.energy_ratio,
        },
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
fn status_words(
    status: &SqpStatus,
    solution: &Solved,
    problem: &OptimalControlProblem,
) -> (&'static str, Option<String>) {
    match status {
        SqpStatus::Converged => ("converged", None),
        SqpStatus::LocallyInfeasible => (
            "locally-infeasible",
            worst_constraints(problem, solution).first().map(|worst| {
                format!(
                    "the target cannot be met to first order: {} is off by {:.3e} {}; move the target, give it more time, or \
                     loosen control.force_max_n and control.moment_max_n_m",
                    worst.name, worst.amount, worst.unit
                )
            }),
        ),
        SqpStatus::IterationLimit => (
            "iteration-limit",
            Some("raise solver.max_iterations, or loosen solver.tolerance".into()),
        ),
        SqpStatus::StepTooSmall => (
            "step-too-small",
            Some("no acceptable step was found; try solver.guess, more blocks, or more time".into()),
        ),
        SqpStatus::Stopped(Stop::Deadline) => ("deadline", None),
        SqpStatus::Stopped(Stop::Interrupted) => ("interrupted", None),
        SqpStatus::Failed(reason) => ("failed", Some(reason.clone())),
    }
}

/// Residuals of the target by name, the largest scaled one first.
fn worst_constraints(problem: &OptimalControlProblem, solution: &Solved) -> Vec<NamedConstraint> {
    if problem.target.enforcement != Enforcement::Hard {
        return Vec::new();
    }
    let axes = ["x", "y", "z"];
    let multipliers = &solution.outcome.multipliers.constraints;
    let mut order: Vec<usize> = (0..solution.residuals.len()).collect();
    order.sort_by(|&a, &b| {
        solution.residuals[b]
            .abs()
            .total_cmp(&solution.residuals[a].abs())
    });
    order
        .into_iter()
        .take(NAMED)
        .map(|i| {
            let row = &solution.rows[i];
            NamedConstraint {
                name: format!("{} {}", row.part.name(), axes[row.axis]),
                node: problem.rod.tip(),
                time_s: problem.grid.end(),
                amount: solution.residuals[i] * problem.target_scale(row.part),
                unit: row.part.unit(),
                multiplier: multipliers.get(i).copied().unwrap_or(f64::NAN),
            }
        })
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
    check: Option<&ForwardCheck>,
    summary: &SolveSummary,
) -> Result<(), OutputError> {
    let record = motion_record(&setup.problem, solution, check);
    record.write_npz(&directory.path().join("trajectory.npz"))?;
    write_controls(
        &directory.path().join("controls.csv"),
        &control_rows(&setup.problem, &solution.coefficients),
    )?;
    write_iterations(
        &directory.path().join("iterations.csv"),
        &solution.outcome.history,
    )?;
    directory.write_text("scene.toml", &setup.resolved.to_toml())?;
    directory.write_json("summary.json", summary)?;
    let page = solve_page(&SolvePage {
        scene,
        setup,
        record: &record,
        coefficients: &solution.coefficients,
        history: &solution.outcome.history,
        check,
        summary,
    });
    directory.write_text("report.html", &render_report(&page))
}

/// The solution's own configurations, with the energies of its replay.
fn motion_record(
    problem: &OptimalControlProblem,
    solution: &Solved,
    check: Option<&ForwardCheck>,
) -> MotionRecord {
    let trajectory = &solution.outcome.point.trajectory;
    let control = problem.control.nodal_wrenches(&solution.coefficients);
    let mut record = MotionRecord::empty(trajectory.n_nodes);
    for (k, wrench) in control.iter().enumerate() {
        let state = State::at_rest(trajectory.configuration(k));
        let energy = check.map_or_else(
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

/// A row per block of a constant hold; a row per knot, with equal times, of a linear one.
fn control_rows(problem: &OptimalControlProblem, coefficients: &[Wrench]) -> Vec<ControlRow> {
    let times = problem.control.edge_times();
    coefficients
        .iter()
        .enumerate()
        .map(|(j, u)| ControlRow {
            t_start: times[j],
            t_end: match problem.control.hold {
                Hold::Constant => times[j + 1],
                Hold::Linear => times[j],
            },
            fx: u.force.x,
            fy: u.force.y,
            fz: u.force.z,
            mx: u.moment.x,
            my: u.moment.y,
            mz: u.moment.z,
        })
        .collect()
}

#[derive(Serialize)]
struct IterationRow {
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
    qp_iterations: u32,
    elapsed_s: f64,
}

fn write_iterations(path: &Path, history: &[IterationRecord]) -> Result<(), OutputError> {
    let cannot_write =
        |error: csv::Error| OutputError::io(path, "cannot write")(std::io::Error::other(error));
    let mut writer = csv::Writer::from_path(path).map_err(cannot_write)?;
    for row in history {
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
                qp_iterations: row.qp_iterations,
                elapsed_s: row.elapsed,
            })
            .map_err(cannot_write)?;
    }
    writer
        .flush()
        .map_err(OutputError::io(path, "cannot write"))
}

fn conclude(
    summary: &SolveSummary,
    check: Option<&ForwardCheck>,
    written: &Path,
    console: &Console,
) {
    console.say(&format!(
        "{} after {} iterations, {:.2} s: objective {:.8e}",
        summary.status, summary.iterations, summary.wall_s, summary.objective
    ));
    if summary.status != "converged" {
        let message = summary
            .message
            .as_deref()
            .unwrap_or("the best iterate is in the result directory");
        console.always(&format!("{}: {message}", summary.status));
    } else if check.is_some_and(|check| !check.is_certified()) {
        console.always("the solver converged, but the check rejects the result");
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
    if let Some(check) = check {
        show_check(check, summary.status == "converged", console);
    }
    console.say(&format!(
        "report: {}",
        written.join("report.html").display()
    ));
}

/// Every criterion on its line, then the verdict.
pub(super) fn show_check(check: &ForwardCheck, converged: bool, console: &Console) {
    for item in &check.items {
        let mark = if item.holds() { "ok  " } else { "FAIL" };
        console.say(&format!(
            "  {mark} {:20} {:10.3e} <= {:9.2e} {}",
            item.name, item.value, item.limit, item.unit
        ));
    }
    if converged {
        console.verdict(check.is_certified(), check.verdict());
        for item in check.items.iter().filter(|item| !item.holds()) {
            console.say(&format!("  {}: {}", item.name, item.remedy()));
        }
    }
}
