//! The contents of the report page of a solve.

use serde_json::Value;

use super::findings::saved_findings;
use super::obstacles::obstacles;
use super::summary::{Fields, counted, measure};
use super::words::{acting_facts, arm_facts, solve_words};
use super::{FRAMES, ROWS, arrows, drawn_arm, fact, fields, reaction};
use crate::control::{Bound, Hold, OptimalControlProblem, Tracking};
use crate::mechanics::Wrench;
use crate::output::{
    self, MotionRecord, ReportAttempt, ReportCheck, ReportClock, ReportCommand, ReportControls,
    ReportData, ReportEnergy, ReportIteration, ReportMotion, ReportPath, ReportSensitivity,
    ReportTarget, ReportVerdict, ReportVia, figure,
};
use crate::scene::translate::directors;
use crate::solve::step_kind::{MEANINGS, step_kind};
use crate::sqp::IterationRecord;
use crate::task::Problem;

/// What the page of a solve is made of: a run has it, and so do the files that it wrote.
pub(in crate::solve) struct SolvePage<'a> {
    /// The problem, on the grid of the solution.
    pub problem: &'a Problem,
    /// Coefficients of the controls.
    pub coefficients: &'a [Wrench],
    /// The rows of `trajectory.npz`.
    pub record: &'a MotionRecord,
    /// The contents of `summary.json`.
    pub summary: &'a Value,
    /// The rows of `iterations.csv`.
    pub iterations: Vec<ReportIteration>,
    /// Growth of perturbations, where gains were computed.
    pub sensitivity: Option<ReportSensitivity>,
}

pub(in crate::solve) fn solve_page(page: SolvePage) -> ReportData {
    let Problem {
        arm,
        task,
        discrete,
        ..
    } = page.problem;
    let (record, summary) = (page.record, Fields(page.summary));
    let converged = summary.text("status") == "converged";
    let verdict = match summary.text("check.verdict") {
        _ if !converged => summary.text("status"),
        "" => "not checked",
        verdict => verdict,
    };
    let motion = ReportMotion::thinned(record, FRAMES);
    let obstacles = obstacles(&task.limits, &discrete.rod, &discrete.radii, record);
    let (lead, trust) = solve_words(page.problem, page.coefficients, summary, obstacles.as_ref());
    ReportData {
        title: summary.text("scene").into(),
        command: ReportCommand::Solve,
        verdict: ReportVerdict {
            text: verdict.into(),
            ok: verdict == "certified",
            checked: true,
        },
        lead,
        trust,
        arm_facts: arm_facts(arm, &discrete.rod),
        acting: acting_facts(arm, &task.limits, &task.actuators, [usize::MAX; 2])
            .into_iter()
            .chain((discrete.acting.iter()).map(|_| {
                fact(
                    "control along the arm",
                    "an actuator that acts on many nodes",
                )
            }))
            .collect(),
        facts: facts(summary, discrete.final_goals().next().is_some()),
        arm: drawn_arm(arm, &discrete.rod),
        target: target(discrete),
        via: via(discrete),
        paths: paths(discrete, record),
        arrows: (arrows::controls(discrete, page.coefficients, record).into_iter())
            .chain(arrows::given(&discrete.rod, record, |_| arrows::LOAD))
            .collect(),
        fields: fields::fields(&discrete.rod, record),
        obstacles,
        controls: Some(controls(discrete, page.coefficients)),
        energy: Some(ReportEnergy::thinned(record, ROWS)),
        sensitivity: page.sensitivity,
        bars: Vec::new(),
        tables: Vec::new(),
        advice: Vec::new(),
        charts: if crate::output::summary::was_checked(page.summary) {
            reaction::optimized(discrete, page.coefficients)
        } else {
            // Of a solve that was stopped nobody waits for another simulation.
            Vec::new()
        },
        iterations: page.iterations,
        attempts: summary.list("attempts").map(attempt).collect(),
        kinds: (MEANINGS.iter())
            .map(|(sign, meaning)| ((*sign).into(), (*meaning).into()))
            .collect(),
        checks: summary.list("check.criteria").map(check_row).collect(),
        summary: page.summary.clone(),
        motion,
        clock: ReportClock::time(),
    }
}

fn facts(summary: Fields, has_target: bool) -> Vec<(String, String)> {
    let mut facts = vec![
        fact("status", summary.text("status")),
        fact("iterations", summary.count("iterations")),
        fact("objective", figure(summary.number("objective"), 6)),
        fact("wall time", summary.measure("wall_s", "s")),
    ];
    if has_target {
        facts.push(fact("tip error", summary.measure("tip_error_m", "m")));
    }
    for error in summary.list("tracking") {
        let label = format!("path of node {}", error.count("node"));
        let missed = format!(
            "missed by {} rms, at most {} at t = {} s",
            error.measure("rms_m", "m"),
            error.measure("max_m", "m"),
            figure(error.number("max_at_s"), 4)
        );
        facts.push(fact(&label, missed));
    }
    let step = summary.measure("step_s", "s");
    facts.extend([
        fact(
            "tip speed at the end",
            summary.measure("tip_speed_m_s", "m/s"),
        ),
        fact("steps", format!("{} of {step}", summary.count("steps"))),
        fact(
            "control",
            format!(
                "{}, {} variables",
                counted(summary.count("control_blocks"), "block", "blocks"),
                summary.count("variables")
            ),
        ),
        fact("Hessian", summary.text("hessian")),
        fact("start", summary.text("guess")),
    ]);
    if !summary.text("message").is_empty() {
        facts.push(fact("message", summary.text("message")));
    }
    if summary.text("status") != "converged" {
        for worst in summary.list("worst_constraints") {
            let off = measure(worst.number("amount"), worst.text("unit"));
            facts.push(fact(worst.text("name"), format!("off by {off}")));
        }
    }
    facts.extend(saved_findings(Fields(summary.get("check"))));
    facts
}

/// What the tip should reach at the end; `None` where there is nothing.
fn target(problem: &OptimalControlProblem) -> Option<ReportTarget> {
    let goals = || problem.final_goals();
    goals().next().map(|_| ReportTarget {
        position: goals().find_map(|goal| goal.position).map(Into::into),
        directions: goals()
            .find_map(|goal| goal.rotation.as_ref())
            .map(directors),
    })
}

/// The positions of all other goals.
fn via(problem: &OptimalControlProblem) -> Vec<ReportVia> {
    let (tip, last) = (problem.rod.tip(), problem.grid.n_steps);
    (problem.goals.iter())
        .filter(|goal| (goal.node, goal.time_node) != (tip, last))
        .filter_map(|goal| {
            Some(ReportVia {
                name: goal.name.clone(),
                node: goal.node,
                t: problem.grid.time(goal.time_node),
                position: goal.position?.into(),
            })
        })
        .collect()
}

/// The paths that nodes should follow, over the horizon.
fn paths(problem: &OptimalControlProblem, record: &MotionRecord) -> Vec<ReportPath> {
    let end = problem.grid.duration();
    let frames = record.thinned_rows(FRAMES);
    let of = |tracking: &Tracking| {
        let corners = tracking.path.iter().map(|&(t, _)| t);
        let within = corners.filter(|t| (0.0..end).contains(t) && *t > 0.0);
        let t: Vec<f64> = ([0.0].into_iter().chain(within).chain([end])).collect();
        let off = |&row: &usize| {
            let is = record.position(row, tracking.node);
            Some((is - tracking.position(record.t[row])?).norm())
        };
        let x = t.iter().map(|&t| Some(tracking.position(t)?.into()));
        // One that is only to be turned has no path.
        Some(ReportPath {
            node: tracking.node,
            x: x.collect::<Option<_>>()?,
            off: frames.iter().map(off).collect::<Option<_>>()?,
            t,
        })
    };
    (problem.objective.tracking.iter()).filter_map(of).collect()
}

/// Points per block of a spline in a drawing.
const SPLINE_POINTS: usize = 8;

pub(super) fn drawn_bound(bound: &Option<Bound>) -> Option<output::Bound> {
    bound.as_ref().map(|bound| match bound {
        Bound::Norm(limit) => output::Bound::Norm(*limit),
        Bound::PerAxis(limits) => output::Bound::Axes((*limits).into()),
    })
}

/// The tip's wrench; a spline is drawn as a polygon.
fn controls(problem: &OptimalControlProblem, coefficients: &[Wrench]) -> ReportControls {
    let n = problem.actuators.len();
    let tip = &problem.actuators[0];
    let control = &problem.control;
    let at = |j: usize| coefficients[j * n];
    let (hold, t, wrenches): (_, Vec<f64>, Vec<Wrench>) = match control.hold {
        Hold::Constant | Hold::Linear => (
            if control.hold == Hold::Constant {
                output::Hold::Constant
            } else {
                output::Hold::Linear
            },
            control.edge_times(),
            (0..control.n_coefficients()).map(at).collect(),
        ),
        Hold::Cubic => {
            let last = control.n_steps();
            let points = (SPLINE_POINTS * control.n_blocks()).min(last);
            let nodes = || (0..=points).map(|i| i * last / points);
            (
                output::Hold::Linear,
                nodes().map(|k| problem.grid.time(k)).collect(),
                nodes().map(|k| control.value(k, at)).collect(),
            )
        }
    };
    ReportControls {
        hold,
        t,
        force: wrenches.iter().map(|u| u.force.into()).collect(),
        moment: wrenches.iter().map(|u| u.moment.into()).collect(),
        force_bound: drawn_bound(&tip.force.bound),
        moment_bound: drawn_bound(&tip.moment.bound),
    }
}

/// The growth up to the edges of the blocks, without and with feedback.
pub(in crate::solve) fn sensitivity(
    problem: &OptimalControlProblem,
    open: &[f64],
    closed: &[f64],
) -> ReportSensitivity {
    ReportSensitivity {
        t: problem.control.edge_times(),
        open: open.to_vec(),
        closed: closed.to_vec(),
    }
}

/// A row of the solve of this number, counted from 0.
pub(in crate::solve) fn iteration(number: usize, row: &IterationRecord) -> ReportIteration {
    ReportIteration {
        attempt: number + 1,
        iteration: row.iteration,
        objective: row.objective,
        stationarity: row.stationarity,
        feasibility: row.feasibility,
        complementarity: row.complementarity,
        step_norm: row.step_norm,
        kind: step_kind(row),
    }
}

fn attempt(attempt: Fields) -> ReportAttempt {
    ReportAttempt {
        from: attempt.text("from").into(),
        iterations: attempt.count("iterations") as usize,
        ended: attempt.text("ended").into(),
        is_result: attempt.get("is_result") == &Value::Bool(true),
    }
}

fn check_row(item: Fields) -> ReportCheck {
    let (value, limit, unit) = (
        item.number("value"),
        item.number("limit"),
        item.text("unit"),
    );
    ReportCheck {
        name: item.text("name").into(),
        // Of what is far below its limit, mostly rounding, the size counts.
        value: format!(
            "{} {unit}",
            figure(value, if value > 1e-3 * limit { 3 } else { 1 })
        )
        .trim_end()
        .into(),
        limit: measure(limit, unit),
        ok: item.get("holds") == &Value::Bool(true),
        meaning: item.text("meaning").into(),
    }
}
