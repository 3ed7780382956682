//! The contents of the report page of a solve.

use serde_json::{Value, json};

use super::obstacles::obstacles;
use super::{FRAMES, ROWS, arm, arrows, drawn_arm, efforts, fields, reaction, words};
use crate::control::{Bound, Enforcement, Hold, OptimalControlProblem, Tracking};
use crate::mechanics::Wrench;
use crate::mechanics::signal::EffortTable;
use crate::output::{
    self, Columns, MotionRecord, OutputError, ReportCommand, ReportControls, ReportData,
    ReportEnergy, ReportIteration, ReportMotion, ReportObstacles, ReportPath, ReportSensitivity,
    ReportTarget, ReportVia,
};
use crate::scene::translate::target_directors;
use crate::solve::step_kind::{MEANINGS, step_kind};
use crate::sqp::IterationRecord;
use crate::task::Problem;

/// Inputs of the page of a solve: a run has them, and so do the files that it wrote.
pub(in crate::solve) struct SolvePage<'a> {
    /// The problem, on the grid of the solution.
    pub problem: &'a Problem,
    /// Coefficients of the controls.
    pub coefficients: &'a [f64],
    /// The rows of `trajectory.npz`.
    pub record: &'a MotionRecord,
    /// The contents of `summary.json`.
    pub summary: &'a Value,
    /// The rows of `iterations.csv`.
    pub iterations: Vec<ReportIteration>,
    /// Growth of perturbations, where gains were computed.
    pub sensitivity: Option<ReportSensitivity>,
}

pub(in crate::solve) fn solve_page(page: SolvePage) -> Result<ReportData, OutputError> {
    let Problem {
        arm: own,
        task,
        discrete,
        ..
    } = page.problem;
    let (record, summary) = (page.record, page.summary);
    let obstacles = obstacles(&task.limits, &discrete.rod, &discrete.radii, record);
    // Of a solve that was stopped nobody waits for another simulation.
    let mut columns = match crate::output::summary::was_checked(summary) {
        true => reaction::optimized(discrete, page.coefficients),
        false => Columns::new(),
    };
    let control = discrete.signal(&discrete.control, page.coefficients);
    let table = EffortTable::of(&discrete.rod.actuators, &discrete.grid, Some(&control));
    let (rod, grid) = (&discrete.rod, &discrete.grid);
    let shown = efforts::shown(rod, record, &task.efforts, &|row| {
        // A motion that is thinned has rows at some time nodes.
        let k = ((record.t[row] - grid.start) / grid.step).round() as usize;
        let inputs = &table.nodes[k.min(grid.n_steps) * table.n_actuators..][..table.n_actuators];
        efforts::of_inputs(rod, record, row, inputs.to_vec())
    });
    columns.extend(shown.columns);
    let context = json!({
        "summary": summary,
        "efforts": shown.groups,
        "arm": arm::arm(own, &discrete.rod, [usize::MAX; 2]),
        "actuators": arm::actuators(&task.actuators),
        "limits": arm::names(&task.limits),
        "posed": posed(discrete, page.coefficients),
        "obstacles": obstacles.as_ref().and_then(nearest),
    });
    let words = words("solve.jinja", &context, &columns)?;
    let motion = ReportMotion::thinned(record, FRAMES);
    Ok(ReportData {
        target: target(discrete),
        via: via(discrete),
        paths: paths(discrete, record),
        arrows: (arrows::controls(discrete, page.coefficients, record).into_iter())
            .chain(arrows::given(&discrete.rod, record, |_| arrows::LOAD))
            .chain(shown.arrows)
            .collect(),
        routes: shown.routes,
        fields: fields::fields(&discrete.rod, record),
        obstacles,
        controls: controls(discrete, page.coefficients),
        energy: Some(ReportEnergy::thinned(record, ROWS)),
        sensitivity: page.sensitivity,
        iterations: page.iterations,
        kinds: (MEANINGS.iter())
            .map(|(sign, meaning)| ((*sign).into(), (*meaning).into()))
            .collect(),
        ..ReportData::of(
            ReportCommand::Solve,
            summary,
            words,
            drawn_arm(own, &discrete.rod),
            motion,
        )
    })
}

/// Describes the task, and the largest force (N) and moment (N m) of any actuator.
fn posed(problem: &OptimalControlProblem, coefficients: &[f64]) -> Value {
    let goals = || problem.final_goals();
    let position = goals().find_map(|goal| Some((goal.position?, &goal.enforcement)));
    let goal = goals().next().map(|_| {
        json!({
            "position": position.map(|(place, _)| <[f64; 3]>::from(place)),
            "soft": position.is_some_and(|(_, how)| matches!(how, Enforcement::Soft { .. })),
            "turned": goals().any(|goal| goal.rotation.is_some()),
            "direction": goals().find_map(|goal| goal.direction).map(<[f64; 3]>::from),
            "velocity": goals().find_map(|goal| goal.velocity).map(<[f64; 3]>::from),
            "at_rest": goals().any(|goal| goal.at_rest),
        })
    });
    let stay = problem.stay.as_ref().map(|stay| {
        let wrenches = problem.wrenches(&stay.controls);
        let largest = |part: fn(&Wrench) -> f64| {
            let size = wrenches.iter().map(part).fold(0.0, f64::max);
            (size > 0.0).then_some(size)
        };
        json!({
            "seconds": stay.seconds,
            "force": largest(|u| u.force.norm()),
            "moment": largest(|u| u.moment.norm()),
        })
    });
    let largest = arrows::largest_controls(problem, coefficients);
    let actuators = problem.wrench_actuators();
    let peak = |part: usize, acts: bool| {
        acts.then(|| largest.iter().map(|sizes| sizes[part]).fold(0.0, f64::max))
    };
    json!({
        "start": <[f64; 3]>::from(problem.initial.configuration.positions[problem.goal_node()]),
        "goal": goal,
        "on_the_way": via(problem).len(),
        "tracks": problem.objective.tracking.len(),
        "duration_s": problem.grid.duration(),
        "duration_is_free": problem.duration.is_some(),
        "stay": stay,
        "force": peak(0, actuators.iter().any(|node| node.force.acts())),
        "moment": peak(1, actuators.iter().any(|node| node.moment.acts())),
        "own_actuators": problem.acting.len(),
    })
}

/// The number of obstacles, and the least distance of the arm from any, m.
fn nearest(obstacles: &ReportObstacles) -> Option<Value> {
    let avoided: Vec<_> = (obstacles.bodies.iter())
        .filter(|body| !body.is_touched)
        .collect();
    let nearest = (avoided.iter().flat_map(|body| &body.clearance))
        .fold(f64::INFINITY, |nearest, c| nearest.min(f64::from(*c)));
    (!avoided.is_empty()).then(|| json!({ "n": avoided.len(), "nearest": nearest }))
}

/// Describes the target of the tip at the end; `None` without one.
fn target(problem: &OptimalControlProblem) -> Option<ReportTarget> {
    let goals = || problem.final_goals();
    goals().next().map(|_| ReportTarget {
        position: goals().find_map(|goal| goal.position).map(Into::into),
        directions: goals().find_map(|goal| target_directors(goal.rotation, goal.direction)),
    })
}

/// The positions of all other goals.
fn via(problem: &OptimalControlProblem) -> Vec<ReportVia> {
    let (node, last) = (problem.goal_node(), problem.grid.n_steps);
    (problem.goals.iter())
        .filter(|goal| (goal.node, goal.time_node) != (node, last))
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

pub(super) fn drawn_bound(bound: &Option<Bound>) -> Option<output::ReportBound> {
    bound.as_ref().map(|bound| match bound {
        Bound::Norm(limit) => output::ReportBound::Norm(*limit),
        Bound::PerAxis(limits) => output::ReportBound::Axes((*limits).into()),
        Bound::Between { lower, upper } => {
            output::ReportBound::Between((*lower).into(), (*upper).into())
        }
    })
}

/// The tip's wrench, if it is a control; a spline is drawn as a polygon. Efforts have curves of their own.
fn controls(problem: &OptimalControlProblem, coefficients: &[f64]) -> Option<ReportControls> {
    let tip = (problem.wrench_actuators().into_iter().next()).filter(|tip| tip.acts())?;
    let n = problem.actuated_nodes().len();
    let control = &problem.control;
    let (hold, t, wrenches): (_, Vec<f64>, Vec<Wrench>) = match control.hold {
        Hold::Constant | Hold::Linear => (
            if control.hold == Hold::Constant {
                output::ReportHold::Constant
            } else {
                output::ReportHold::Linear
            },
            control.edge_times(),
            (problem.wrenches(coefficients).into_iter().step_by(n)).collect(),
        ),
        Hold::Cubic => {
            let last = control.n_steps();
            let points = (SPLINE_POINTS * control.n_blocks()).min(last);
            let nodes = || (0..=points).map(|i| i * last / points);
            (
                output::ReportHold::Linear,
                nodes().map(|k| problem.grid.time(k)).collect(),
                {
                    let all = problem.signal(control, coefficients).wrenches;
                    nodes().map(|k| all[k * n]).collect()
                },
            )
        }
    };
    Some(ReportControls {
        hold,
        t,
        force: wrenches.iter().map(|u| u.force.into()).collect(),
        moment: wrenches.iter().map(|u| u.moment.into()).collect(),
        force_bound: drawn_bound(&tip.force.bound),
        moment_bound: drawn_bound(&tip.moment.bound),
    })
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

/// Returns the row of an iteration of the solve with this number, on the grid with this number; `None` for the only grid.
pub(in crate::solve) fn iteration(
    grid: Option<usize>,
    attempt: usize,
    row: &IterationRecord,
) -> ReportIteration {
    ReportIteration {
        grid,
        attempt,
        iteration: row.iteration,
        objective: row.objective,
        stationarity: row.stationarity,
        feasibility: row.feasibility,
        complementarity: row.complementarity,
        step_norm: row.step_norm,
        kind: step_kind(row),
    }
}
