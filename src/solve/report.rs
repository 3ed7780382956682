//! The contents of the report page of a solve.

use nalgebra::{Matrix3, Vector3};

use super::examined::Examined;
use super::solution::Solution;
use super::step_kind::{MEANINGS, step_kind};
use crate::control::{Bound, Hold, OptimalControlProblem, PathLimit, RodView, Shape, Tracking};
use crate::mechanics::{BaseCondition, Rod, TimeGrid, Trajectory, Wrench};
use crate::output::summary::SolveSummary;
use crate::output::{
    self, MotionRecord, ReportArm, ReportAttempt, ReportCheck, ReportCommand, ReportControls,
    ReportData, ReportEnergy, ReportIteration, ReportMotion, ReportObstacle, ReportObstacles,
    ReportPath, ReportSensitivity, ReportShape, ReportTarget, ReportVerdict,
};
use crate::scene::translate::directors;
use crate::sqp::IterationRecord;
use crate::task::{Arm, Limit, LimitKind, Problem};
use crate::verify::growth::Growth;
use crate::verify::second_order::Extremum;
use crate::verify::{CheckItem, ForwardCheck};

pub(super) const FRAMES: usize = 240;
pub(super) const ENERGY_ROWS: usize = 600;
const CLEARANCE_ROWS: usize = 600;

/// The contents of the page of a solve.
pub(super) struct SolvePage<'a> {
    pub solution: &'a Solution,
    pub examined: &'a Examined,
    pub record: &'a MotionRecord,
    pub summary: &'a SolveSummary,
}

pub(super) fn solve_page(page: &SolvePage) -> ReportData {
    let SolvePage {
        solution, summary, ..
    } = page;
    let Problem {
        arm: body,
        task,
        discrete: problem,
        ..
    } = &solution.problem;
    let checked = page.examined.check.as_ref();
    let solves = &solution.attempt.solves;
    let certified =
        checked.is_some_and(ForwardCheck::is_certified) && summary.status == "converged";
    let text = if summary.status == "converged" {
        checked
            .map_or("not checked", |check| check.verdict())
            .to_string()
    } else {
        summary.status.to_string()
    };
    ReportData {
        title: summary.scene.clone(),
        command: ReportCommand::Solve,
        verdict: ReportVerdict {
            text,
            ok: certified,
        },
        facts: (solve_facts(summary, problem.final_goals().next().is_some()).into_iter())
            .chain(
                checked
                    .iter()
                    .flat_map(|check| findings(check))
                    .map(|text| fact("check", text)),
            )
            .collect(),
        summary: serde_json::to_value(summary).unwrap_or_default(),
        arm: arm(body, &problem.rod),
        motion: ReportMotion::thinned(page.record, FRAMES),
        target: target(problem),
        paths: paths(problem),
        obstacles: obstacles(&task.limits, &problem.rod, &problem.radii, page.record),
        controls: Some(controls(problem, &solution.coefficients)),
        energy: Some(ReportEnergy::thinned(page.record, ENERGY_ROWS)),
        sensitivity: page
            .examined
            .feedback
            .as_ref()
            .map(|feedback| ReportSensitivity {
                t: problem.control.edge_times(),
                open: feedback.open_loop.clone(),
                closed: feedback.closed_loop.clone(),
            }),
        charts: Vec::new(),
        iterations: (solves.iter().enumerate())
            .flat_map(|(number, solve)| solve.rows.iter().map(move |row| iteration(number, row)))
            .collect(),
        attempts: (summary.attempts.iter())
            .map(|attempt| ReportAttempt {
                from: attempt.from.clone(),
                iterations: attempt.iterations,
                ended: attempt.ended.clone(),
                is_result: attempt.is_result,
            })
            .collect(),
        kinds: (MEANINGS.iter())
            .map(|(sign, meaning)| ((*sign).into(), (*meaning).into()))
            .collect(),
        checks: checked
            .iter()
            .flat_map(|check| check.items.iter().map(check_row))
            .collect(),
    }
}

pub(super) fn fact(label: &str, value: impl ToString) -> (String, String) {
    (label.to_string(), value.to_string())
}

fn solve_facts(summary: &SolveSummary, has_target: bool) -> Vec<(String, String)> {
    let mut facts = vec![
        fact("status", summary.status),
        fact("iterations", summary.iterations),
        fact("objective", format!("{:.8e}", summary.objective)),
        fact("wall time", format!("{:.3} s", summary.wall_s)),
    ];
    if has_target {
        facts.push(fact("tip error", format!("{:.3e} m", summary.tip_error_m)));
    }
    for error in &summary.tracking {
        let label = format!("path of node {}", error.node);
        facts.push(fact(&label, format!("missed by {error}")));
    }
    facts.extend([
        fact(
            "tip speed at the end",
            format!("{:.3e} m/s", summary.tip_speed_m_s),
        ),
        fact("Hessian", summary.hessian),
        fact("start", summary.guess),
        fact(
            "elements",
            format!("{} ({})", summary.elements, summary.strain),
        ),
        fact(
            "steps",
            format!("{} of {:.4e} s", summary.steps, summary.step_s),
        ),
        fact(
            "control",
            format!(
                "{} blocks, {} variables",
                summary.control_blocks, summary.variables
            ),
        ),
    ]);
    if let Some(message) = &summary.message {
        facts.push(fact("message", message));
    }
    if summary.status != "converged" {
        for constraint in &summary.worst_constraints {
            let off = format!("off by {:.3e} {}", constraint.amount, constraint.unit);
            facts.push(fact(&constraint.name, off));
        }
    }
    facts
}

pub(super) fn arm(arm: &Arm, rod: &Rod) -> ReportArm {
    ReportArm {
        radius: arm.radii_at_nodes(rod.n_elements()),
        base: (rod.base == BaseCondition::Clamped).then(|| rod.rest.positions[0].into()),
        gravity: rod.gravity.into(),
    }
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

/// The paths that nodes should follow, over the horizon.
fn paths(problem: &OptimalControlProblem) -> Vec<ReportPath> {
    let end = problem.grid.duration();
    let of = |tracking: &Tracking| {
        let corners = tracking.path.iter().map(|&(t, _)| t);
        let within = corners.filter(|t| (0.0..end).contains(t) && *t > 0.0);
        let t: Vec<f64> = ([0.0].into_iter().chain(within).chain([end])).collect();
        ReportPath {
            node: tracking.node,
            x: t.iter().map(|&t| tracking.position(t).into()).collect(),
            t,
        }
    };
    problem.objective.tracking.iter().map(of).collect()
}

/// The obstacles, and the arm's clearance of each; `None` where there are none.
pub(super) fn obstacles(
    limits: &[Limit],
    rod: &Rod,
    radii: &[f64],
    record: &MotionRecord,
) -> Option<ReportObstacles> {
    let limits: Vec<(&str, PathLimit)> = (limits.iter())
        .filter(|limit| matches!(limit.kind, LimitKind::Clearance { .. }))
        .map(|limit| (limit.name.as_str(), limit.kind.on(rod, radii)))
        .collect();
    if limits.is_empty() {
        return None;
    }
    let rows = record.thinned_rows(CLEARANCE_ROWS);
    let mut clearances = vec![Vec::with_capacity(rows.len()); limits.len()];
    for row in &rows {
        let coordinates = record.x.chunks_exact(3 * rod.n_nodes()).nth(*row)?;
        let positions = coordinates.chunks_exact(3).map(Vector3::from_column_slice);
        let trajectory = Trajectory {
            n_nodes: rod.n_nodes(),
            positions: positions.collect(),
            rotations: vec![Matrix3::identity(); rod.n_nodes()],
        };
        let rod_view = RodView {
            rod,
            radii,
            trajectory: &trajectory,
            grid: TimeGrid {
                start: record.t[*row],
                step: 0.0,
                n_steps: 0,
            },
        };
        for ((_, limit), clearance) in limits.iter().zip(&mut clearances) {
            let worst = (0..limit.n_items(rod))
                .map(|item| limit.value(&rod_view, 0, item))
                .fold(f64::NEG_INFINITY, f64::max);
            clearance.push(-worst * limit.scale(rod));
        }
    }
    let bodies = (limits.into_iter().zip(clearances)).filter_map(|((name, limit), beyond)| {
        let PathLimit::Clearance { shape, margin, .. } = limit else {
            return None;
        };
        Some(ReportObstacle {
            name: name.into(),
            shape: drawn(&shape),
            margin,
            clearance: beyond.iter().map(|c| (c + margin) as f32).collect(),
        })
    });
    Some(ReportObstacles {
        t: rows.iter().map(|&row| record.t[row]).collect(),
        bodies: bodies.collect(),
    })
}

fn drawn(shape: &Shape) -> ReportShape {
    match *shape {
        Shape::Sphere { center, radius } => ReportShape::Sphere {
            center: center.into(),
            radius,
        },
        Shape::Capsule { from, to, radius } => ReportShape::Capsule {
            from: from.into(),
            to: to.into(),
            radius,
        },
        Shape::HalfSpace { point, normal } => ReportShape::HalfSpace {
            point: point.into(),
            normal: normal.into(),
        },
        Shape::Cuboid {
            center,
            rotation,
            half_size,
        } => ReportShape::Box {
            center: center.into(),
            axes: directors(&rotation),
            half_size: half_size.into(),
        },
    }
}

/// Points per block of a spline in a drawing.
const SPLINE_POINTS: usize = 8;

/// The tip's wrench; a spline is drawn as a polygon.
fn controls(problem: &OptimalControlProblem, coefficients: &[Wrench]) -> ReportControls {
    let bound = |bound: &Option<Bound>| {
        bound.as_ref().map(|bound| match bound {
            Bound::Norm(limit) => output::Bound::Norm(*limit),
            Bound::PerAxis(limits) => output::Bound::Axes((*limits).into()),
        })
    };
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
        force_bound: bound(&tip.force.bound),
        moment_bound: bound(&tip.moment.bound),
    }
}

fn iteration(number: usize, row: &IterationRecord) -> ReportIteration {
    ReportIteration {
        attempt: number + 1,
        iteration: row.iteration,
        objective: row.objective,
        stationarity: row.residual.stationarity,
        feasibility: row.residual.feasibility,
        complementarity: row.residual.complementarity,
        step_norm: row.step_norm,
        kind: step_kind(row),
    }
}

fn check_row(item: &CheckItem) -> ReportCheck {
    let with_unit = |value: f64| format!("{value:.3e} {}", item.unit).trim_end().to_string();
    ReportCheck {
        name: item.name.into(),
        value: with_unit(item.value),
        limit: with_unit(item.limit),
        ok: item.holds(),
        meaning: item.meaning.into(),
    }
}

/// What the check found beside its criteria: the worst row of every part of the conditions by name, the kind of extremum, and the
/// growth of disturbances.
pub(crate) fn findings(check: &ForwardCheck) -> Vec<String> {
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
