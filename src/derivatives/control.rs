//! Derivatives of an optimal-control problem: objective, goals, path constraints, obstacles, actuators, reduced Hessian.

use std::collections::BTreeSet;

use faer::{Mat, MatRef};
use fastrand::Rng;

use super::compare::{Comparison, Groups, compare};
use super::mechanics::{ROUNDING, rounding};
use super::point::{number, random_state, random_variables, vector};
use super::{Block, DerivativeError, gather};
use crate::control::problem::GoalRow;
use crate::control::{
    ActsOn, ControlGrid, LiftedPoint, Objective, OptimalControlProblem, PathConstraint, PathLimit,
    RodView, Transcription,
};
use crate::mechanics::actuator::flat;
use crate::mechanics::linearization::StateTangent;
use crate::mechanics::{Rod, RodModel, StateView, Trajectory, TrajectoryTangent, Wrench};
use crate::sqp::{LiftedProgram as _, LinearizationRequest, Multipliers};

/// Rounding of the exact Hessian: the second derivative of its elastic part is itself a difference, accurate to about 1e-10 of its largest
/// term (2e-9 in lanes), and terms of random multipliers cancel.
const HESSIAN_ROUNDING: f64 = 5e-8;
/// Rounding of an actuator's second derivative, which may itself be a difference with a relative error of about 1e-9.
const ACTUATOR_ROUNDING: f64 = 1e-8;
/// Number of rows of a path constraint that are compared, of points around an obstacle, and of states of an actuator.
const SAMPLES: usize = 24;
/// Number of rows of path constraints with a multiplier in the Lagrangian.
const ACTIVE_ROWS: usize = 12;

/// Returns the same problem over the first `n_steps` steps, with at most `n_blocks` blocks: times move with the horizon, so that every goal
/// and constraint is kept.
pub(super) fn shortened(
    problem: &OptimalControlProblem,
    n_steps: usize,
    n_blocks: usize,
) -> OptimalControlProblem {
    let mut short = problem.clone();
    let all = problem.grid.n_steps;
    let n_steps = n_steps.min(all);
    let n_blocks = n_blocks.min(problem.control.n_blocks()).min(n_steps);
    let step = problem.grid.step;
    let Some(control) = ControlGrid::new(problem.control.hold, n_blocks, n_steps, step) else {
        return short;
    };
    short.control = control;
    short.grid.n_steps = n_steps;
    let moved = |k: usize| (k * n_steps).div_ceil(all);
    for goal in &mut short.goals {
        goal.time_node = moved(goal.time_node).max(1);
    }
    for path in &mut short.path {
        let nodes: BTreeSet<usize> = path.time_nodes.iter().map(|&k| moved(k)).collect();
        path.time_nodes = nodes.into_iter().collect();
    }
    short
}

/// Compares all derivatives of a problem, at controls in general position.
///
/// # Errors
/// Returns [`DerivativeError`] if the motion breaks down.
pub(super) fn blocks(
    problem: &OptimalControlProblem,
    rng: &mut Rng,
) -> Result<Vec<Block>, DerivativeError> {
    let program = Transcription::new(problem, 1);
    let start = LiftedPoint {
        variables: random_variables(problem, program.sets(), rng),
        trajectory: Trajectory::with_capacity(problem.rod.n_nodes(), 0),
    };
    let point = program.rollout(&start, &vec![0.0; start.variables.len()])?;
    let mut out = Vec::new();
    for (name, objective) in terms(&problem.objective) {
        let problem = OptimalControlProblem {
            objective,
            ..problem.clone()
        };
        let term = Transcription::new(&problem, 1);
        out.push(objective_block(name, &term, &point, rng)?);
    }
    out.extend(goal_blocks(&program, &point, rng)?);
    let path = program.path().iter();
    out.extend(path.map(|constraint| path_block(&program, &point, constraint, rng)));
    let path = program.path().iter();
    out.extend(path.map(|constraint| distance_block(&problem.rod, constraint, rng)));
    let acting = 0..problem.acting.len();
    out.extend(acting.map(|index| actuator_block(problem, index, rng)));
    out.push(hessian_block(&program, &point, rng)?);
    Ok(out.into_iter().flatten().collect())
}

/// Access to the weight of a term in an objective.
type Weight = fn(&mut Objective) -> &mut f64;

/// Returns the named whole objective and every single term of it.
fn terms(whole: &Objective) -> Vec<(String, Objective)> {
    let nothing = || Objective {
        samples: whole.samples,
        ..Objective::default()
    };
    let mut terms = Vec::new();
    let weights: [(&str, Weight); 3] = [
        ("effort", |term| &mut term.effort),
        ("rate", |term| &mut term.rate),
        ("energy", |term| &mut term.energy),
    ];
    for (name, weight) in weights {
        let mut term = nothing();
        *weight(&mut term) = *weight(&mut whole.clone());
        terms.push((format!("objective.{name}"), term));
    }
    for (i, track) in whole.tracking.iter().enumerate() {
        let mut term = nothing();
        term.tracking.push(track.clone());
        terms.push((format!("objective.track.{i}"), term));
    }
    for (i, own) in whole.terms.iter().enumerate() {
        let mut term = nothing();
        term.terms.push(own.clone());
        terms.push((format!("objective.term.{i}"), term));
    }
    terms.retain(|(_, term)| *term != nothing());
    // The whole objective includes the penalties of soft goals.
    terms.insert(0, ("objective".into(), whole.clone()));
    terms
}

/// Returns the kinds of variables that are moved together: forces and what drives actuators, moments, and residuals of soft goals.
fn kinds(problem: &OptimalControlProblem) -> Vec<Vec<usize>> {
    let components = problem.actuated_components();
    let n_controls = problem.n_controls();
    let mut kinds = vec![Vec::new(); 3];
    for i in 0..problem.n_variables() {
        let kind = if i >= n_controls {
            2
        } else {
            let own = problem.channels[components[i % components.len()].channel].on;
            usize::from(matches!(own, ActsOn::Moment { .. }))
        };
        kinds[kind].push(i);
    }
    kinds.retain(|kind| !kind.is_empty());
    kinds
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn product(matrix: MatRef<f64>, vector: &[f64]) -> Vec<f64> {
    let row = |i: usize| {
        let terms = vector.iter().enumerate().map(|(j, v)| matrix[(i, j)] * v);
        terms.sum()
    };
    (0..matrix.nrows()).map(row).collect()
}

/// Compares `slopes` along changes of the variables, each kind by itself, with `values` of simulations.
fn along_variables(
    program: &Transcription,
    point: &LiftedPoint,
    rng: &mut Rng,
    rounding: f64,
    slopes: &dyn Fn(&[f64]) -> Groups,
    values: &dyn Fn(&LiftedPoint) -> Option<Groups>,
) -> Vec<Option<Comparison>> {
    let compared = kinds(program.problem()).into_iter().map(|kind| {
        let mut change = vec![0.0; point.variables.len()];
        for i in kind {
            change[i] = number(rng);
        }
        let mut simulated = |s: f64| {
            let scaled: Vec<f64> = change.iter().map(|d| s * d).collect();
            values(&program.rollout(point, &scaled).ok()?)
        };
        compare(&mut simulated, &slopes(&change), rounding)
    });
    compared.collect()
}

/// Returns the rounding of derivatives through the steps of a program.
fn rounded(program: &Transcription) -> f64 {
    let problem = program.problem();
    rounding(&problem.rod, problem.grid.step)
}

fn no_multipliers(program: &Transcription) -> Multipliers {
    let n_rows = program.goal_rows().len();
    Multipliers::zeros(n_rows, program.n_path_rows(), program.sets())
}

/// Compares the gradient of an objective by the adjoint with simulations.
fn objective_block(
    name: String,
    program: &Transcription,
    point: &LiftedPoint,
    rng: &mut Rng,
) -> Result<Option<Block>, DerivativeError> {
    let gradient = program.lagrangian_gradient(point, &no_multipliers(program))?;
    let slopes = |change: &[f64]| vec![vec![dot(&gradient, change)]];
    let values = |there: &LiftedPoint| Some(vec![vec![program.evaluate(there).ok()?.objective]]);
    Ok(gather(
        name,
        "gradient with respect to the controls by the adjoint, and simulations",
        along_variables(program, point, rng, rounded(program), &slopes, &values),
    ))
}

/// Compares the Jacobian of every vector of every goal with simulations.
fn goal_blocks(
    program: &Transcription,
    point: &LiftedPoint,
    rng: &mut Rng,
) -> Result<Vec<Option<Block>>, DerivativeError> {
    let evaluation = program.evaluate(point)?;
    let linearization = program.linearize(point, &evaluation, &LinearizationRequest::default())?;
    let jacobian = &linearization.jacobian;
    let mut first = 0;
    let vectors = program.goal_rows().chunk_by(GoalRow::shares_vector_with);
    let blocks = vectors.map(|rows| {
        let range = first..first + rows.len();
        first = range.end;
        let own = jacobian.subrows(range.start, range.len());
        let slopes = |change: &[f64]| vec![product(own, change)];
        let values = |there: &LiftedPoint| {
            let constraints = program.evaluate(there).ok()?.constraints;
            Some(vec![constraints[range.clone()].to_vec()])
        };
        let goal = &program.problem().goals[rows[0].goal];
        gather(
            format!("{}.{}", goal.name, goal.name_of(rows[0].part)),
            "residuals by the controls, and simulations",
            along_variables(program, point, rng, rounded(program), &slopes, &values),
        )
    });
    Ok(blocks.collect())
}

/// Compares a path constraint by the configurations, in some rows at random times and items.
fn path_block(
    program: &Transcription,
    point: &LiftedPoint,
    constraint: &PathConstraint,
    rng: &mut Rng,
) -> Option<Block> {
    let trajectory = &point.trajectory;
    let rod_view = program.rod_view(point);
    let rod = &program.problem().rod;
    let limit = &constraint.limit;
    let mut times = constraint.time_nodes.clone();
    times.retain(|&k| k > 0);
    let samples = if times.is_empty() { 0 } else { SAMPLES };
    let found = (0..samples).map(|_| {
        let k = times[rng.usize(..times.len())];
        let item = rng.usize(..limit.n_items(rod));
        let poses = trajectory.positions.len();
        let mut vectors = |size: f64| (0..poses).map(|_| vector(rng, size)).collect();
        let direction = TrajectoryTangent {
            positions: vectors(0.1 * rod.scales.length),
            rotations: vectors(1.0),
        };
        let slope = (limit.gradient(&rod_view, k, item).iter())
            .map(|form| form.along(&direction, trajectory.n_nodes))
            .sum();
        let mut value = |s: f64| {
            let moved = trajectory.retract(&direction, s);
            let trajectory = &moved;
            let moved = RodView {
                trajectory,
                ..rod_view
            };
            Some(vec![vec![limit.value(&moved, k, item)]])
        };
        compare(&mut value, &[vec![slope]], ROUNDING)
    });
    gather(
        format!("{} (path)", constraint.name),
        "rows by positions and rotations",
        found,
    )
}

/// Compares gradient and second derivative of an obstacle's distance at random points around the arm.
fn distance_block(rod: &Rod, constraint: &PathConstraint, rng: &mut Rng) -> Option<Block> {
    let PathLimit::Clearance { shape, .. } = &constraint.limit else {
        return None;
    };
    let found = (0..SAMPLES).map(|_| {
        let x = vector(rng, rod.scales.length);
        let change = vector(rng, 0.1 * rod.scales.length);
        let here = shape.distance(&x);
        let mut along = |s: f64| {
            let there = shape.distance(&(x + s * change));
            Some(vec![vec![there.value], there.gradient.as_slice().to_vec()])
        };
        let bend = here.curvature * change;
        let slopes = [vec![here.gradient.dot(&change)], bend.as_slice().to_vec()];
        compare(&mut along, &slopes, ROUNDING)
    });
    gather(
        format!("{} (distance)", constraint.name),
        "gradient and curvature of the signed distance",
        found,
    )
}

/// Compares both derivatives of the wrenches of a user-defined actuator, and the second derivative, at random states and controls.
fn actuator_block(problem: &OptimalControlProblem, index: usize, rng: &mut Rng) -> Option<Block> {
    let rod = &problem.rod;
    let length = rod.scales.length;
    let acting = &problem.acting[index];
    let actuator = &*acting.actuator;
    let nodes = actuator.nodes(rod);
    let n = 6 * nodes.len();
    let scale = |place: &usize| {
        problem
            .channel_of_input(*place)
            .map_or(1.0, |own| own.scale)
    };
    let scales: Vec<f64> = acting.places.iter().map(scale).collect();
    let jacobian = |at: &StateView, u: &[f64]| {
        let configuration = actuator.configuration_jacobian(at, u);
        let controls = actuator.control_jacobian(at, u);
        Mat::from_fn(n, n + u.len(), |i, j| match j.checked_sub(n) {
            None => configuration[(i, j)],
            Some(j) => controls[(i, j)],
        })
    };
    // Groups: forces, moments, and `λ·w` or its slope.
    let groups = |components: &[f64], last: f64| -> Groups {
        let part = |from: usize| -> Vec<f64> {
            let rows = components.chunks(6).map(|row| &row[from..from + 3]);
            rows.flatten().copied().collect()
        };
        vec![part(0), part(3), vec![last]]
    };
    let found = (0..SAMPLES).map(|_| {
        let state = random_state(rod, 1.0, rng);
        let mut controls = || -> Vec<f64> { scales.iter().map(|c| c * number(rng)).collect() };
        let (u, du) = (controls(), controls());
        let mut change = StateTangent::zeros(rod.n_nodes());
        let mut direction: Vec<f64> = Vec::new();
        for &node in &nodes {
            change.positions[node] = vector(rng, 0.1 * length);
            change.rotations[node] = vector(rng, 1.0);
            let [dx, zeta] = [change.positions[node], change.rotations[node]];
            direction.extend(dx.iter().chain(&zeta));
        }
        direction.extend(&du);
        let mut component = |i: usize| number(rng) * if i < 3 { length } else { 1.0 };
        let covector: Vec<Wrench> = (nodes.iter())
            .map(|_| Wrench::from_array(std::array::from_fn(&mut component)))
            .collect();
        let at = |s: f64, values: &dyn Fn(&StateView, &[f64]) -> Groups| {
            let there = state.retract(&change.scaled(s)).configuration;
            let at = StateView {
                rod,
                time: 0.0,
                positions: &there.positions,
                rotations: &there.rotations,
            };
            let u: Vec<f64> = u.iter().zip(&du).map(|(u, du)| u + s * du).collect();
            values(&at, &u)
        };
        let wrenches = |at: &StateView, u: &[f64]| {
            let mut wrenches = vec![Wrench::default(); nodes.len()];
            actuator.wrench(at, u, &mut wrenches);
            let pulled = product(jacobian(at, u).transpose(), &flat(&covector));
            groups(&flat(&wrenches), dot(&pulled, &direction))
        };
        let slopes = |at: &StateView, u: &[f64]| {
            let curvature = actuator.curvature(at, u, &covector);
            let bend = dot(&direction, &product(curvature.as_ref(), &direction));
            groups(&product(jacobian(at, u).as_ref(), &direction), bend)
        };
        let mut along = |s: f64| Some(at(s, &wrenches));
        compare(&mut along, &at(0.0, &slopes), ACTUATOR_ROUNDING)
    });
    gather(
        format!("own actuator {index}"),
        "wrenches by configuration and controls, and their derivatives likewise",
        found,
    )
}

/// Compares the exact Hessian of the Lagrangian along random changes of the controls with gradients by the adjoint; `None` if the Hessian
/// is an approximation by design ([`curvature`](crate::mechanics::curvature)), or leaves terms of friction out.
fn hessian_block(
    program: &Transcription,
    point: &LiftedPoint,
    rng: &mut Rng,
) -> Result<Option<Block>, DerivativeError> {
    let problem = program.problem();
    if problem.rod.model != RodModel::Standard || !program.knows_curvature() {
        return Ok(None);
    }
    let mut multipliers = no_multipliers(program);
    for y in &mut multipliers.constraints {
        *y = number(rng);
    }
    let n_rows = program.n_path_rows();
    for _ in 0..ACTIVE_ROWS.min(n_rows) {
        let row = rng.usize(..n_rows);
        let path_row = program.path_row(row);
        if program.path()[path_row.constraint].time_nodes[path_row.time] > 0 {
            multipliers.inequalities[row] = rng.f64();
        }
    }
    let evaluation = program.evaluate(point)?;
    let request = LinearizationRequest {
        multipliers: Some(&multipliers),
        rows: &[],
    };
    let linearization = program.linearize(point, &evaluation, &request)?;
    let Some(curvature) = &linearization.curvature else {
        return Ok(None);
    };
    let hessian = &linearization.gauss_newton + curvature;
    let kinds = kinds(problem);
    let by_kind = |values: &[f64]| -> Groups {
        let of = |kind: &Vec<usize>| kind.iter().map(|&i| values[i]).collect();
        kinds.iter().map(of).collect()
    };
    let slopes = |change: &[f64]| by_kind(&product(hessian.as_ref(), change));
    let values = |there: &LiftedPoint| {
        let gradient = program.lagrangian_gradient(there, &multipliers).ok()?;
        Some(by_kind(&gradient))
    };
    Ok(gather(
        "hessian",
        "exact Hessian of the Lagrangian with respect to the controls, and gradients by the adjoint",
        along_variables(program, point, rng, HESSIAN_ROUNDING, &slopes, &values),
    ))
}
