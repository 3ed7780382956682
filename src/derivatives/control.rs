//! Derivatives of an optimal-control problem: objective, goals, path constraints, obstacles, reduced Hessian.

use std::collections::BTreeSet;

use fastrand::Rng;
use nalgebra::Vector3;

use super::compare::{Comparison, compare};
use super::mechanics::ROUNDING;
use super::point::{number, random_state, random_variables, vector};
use super::{Block, DerivativeError, gather};
use crate::control::path::RowGradient;
use crate::control::problem::GoalRow;
use crate::control::{
    ControlGrid, LiftedPoint, Objective, OptimalControlProblem, PathLimit, RodView, Shape,
    Transcription,
};
use crate::mechanics::actuator::flat;
use crate::mechanics::rotation::exp;
use crate::mechanics::{
    Actuator, Configuration, Rod, RodModel, StateForm, StateView, TrajectoryTangent, Wrench,
};
use crate::sqp::{LiftedProgram as _, LinearizationRequest, Multipliers};

/// The second derivative of the elastic part is itself a difference, good to about 1e-10 of its largest term (2e-9 in lanes), and
/// terms of random multipliers cancel.
const HESSIAN_ROUNDING: f64 = 5e-8;
/// An actuator's second derivative may itself be a difference, good to about 1e-9 of it.
const ACTUATOR_ROUNDING: f64 = 1e-8;
/// Rows of a path constraint that are compared, and points around an obstacle.
const SAMPLES: usize = 24;
/// Rows of path constraints that have a multiplier in the Lagrangian.
const ACTIVE_ROWS: usize = 12;

/// The same problem over the first `n_steps` steps, with at most `n_blocks` blocks: times move with the horizon, so that every goal
/// and constraint stays.
#[must_use]
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

/// Everything that is differentiated of a problem, at controls in general position.
///
/// # Errors
/// [`DerivativeError`] where the motion breaks down.
pub(super) fn blocks(
    problem: &OptimalControlProblem,
    rng: &mut Rng,
) -> Result<Vec<Block>, DerivativeError> {
    let program = Transcription::new(problem, 1);
    let start = LiftedPoint {
        variables: random_variables(problem, program.sets(), rng),
        trajectory: crate::mechanics::Trajectory::with_capacity(problem.rod.n_nodes(), 0),
    };
    let still = vec![0.0; start.variables.len()];
    let point = program.rollout(&start, &still)?;
    let mut out = objective_blocks(problem, &point, rng)?;
    out.extend(goal_blocks(&program, &point, rng)?);
    out.extend(path_blocks(&program, &point, rng));
    out.extend(obstacle_blocks(&program, rng));
    out.extend(actuator_blocks(problem, rng));
    out.extend(hessian_block(&program, &point, rng)?);
    Ok(out)
}

/// Kinds of variables that are moved together: forces, moments, and residuals of soft goals.
fn kinds(problem: &OptimalControlProblem) -> Vec<Vec<usize>> {
    let components = problem.actuated_components();
    let n_controls = problem.n_controls();
    let mut kinds = vec![Vec::new(); 3];
    for i in 0..problem.n_variables() {
        let kind = if i >= n_controls {
            2
        } else {
            usize::from(components[i % components.len()].axis >= 3)
        };
        kinds[kind].push(i);
    }
    kinds.retain(|kind| !kind.is_empty());
    kinds
}

fn random_change(n: usize, kind: &[usize], rng: &mut Rng) -> Vec<f64> {
    let mut change = vec![0.0; n];
    for &i in kind {
        change[i] = number(rng);
    }
    change
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn scaled(change: &[f64], s: f64) -> Vec<f64> {
    change.iter().map(|d| s * d).collect()
}

fn no_multipliers(program: &Transcription) -> Multipliers {
    Multipliers::zeros(
        program.goal_rows().len(),
        program.n_path_rows(),
        program.sets(),
    )
}

/// Every term of the objective by itself: its gradient by the adjoint, and simulations.
fn objective_blocks(
    problem: &OptimalControlProblem,
    point: &LiftedPoint,
    rng: &mut Rng,
) -> Result<Vec<Block>, DerivativeError> {
    let whole = &problem.objective;
    let nothing = Objective {
        samples: whole.samples,
        ..Objective::default()
    };
    let mut terms = vec![("objective".to_string(), whole.clone())];
    let mut add = |name: String, weight: f64, objective: Objective| {
        if weight > 0.0 {
            terms.push((name, objective));
        }
    };
    add(
        "objective.effort".into(),
        whole.effort,
        Objective {
            effort: whole.effort,
            ..nothing.clone()
        },
    );
    add(
        "objective.rate".into(),
        whole.rate,
        Objective {
            rate: whole.rate,
            ..nothing.clone()
        },
    );
    add(
        "objective.energy".into(),
        whole.energy,
        Objective {
            energy: whole.energy,
            ..nothing.clone()
        },
    );
    for (i, track) in whole.tracking.iter().enumerate() {
        add(
            format!("objective.track.{i}"),
            track
                .weight
                .max(track.rotation_weight)
                .max(track.speed_weight),
            Objective {
                tracking: vec![track.clone()],
                ..nothing.clone()
            },
        );
    }
    let mut out = Vec::new();
    for (name, objective) in terms {
        let problem = OptimalControlProblem {
            objective,
            ..problem.clone()
        };
        let program = Transcription::new(&problem, 1);
        let gradient = program.lagrangian_gradient(point, &no_multipliers(&program))?;
        let mut found = Vec::new();
        for kind in kinds(&problem) {
            let change = random_change(gradient.len(), &kind, rng);
            let mut value = |s: f64| {
                let there = program.rollout(point, &scaled(&change, s)).ok()?;
                Some(vec![vec![program.evaluate(&there).ok()?.objective]])
            };
            let slope = vec![dot(&gradient, &change)];
            found.extend(compare(&mut value, &[slope], ROUNDING));
        }
        out.extend(gather(
            name,
            "gradient over the controls by the adjoint, and simulations",
            found,
        ));
    }
    Ok(out)
}

/// Every vector of every goal.
fn goal_blocks(
    program: &Transcription,
    point: &LiftedPoint,
    rng: &mut Rng,
) -> Result<Vec<Block>, DerivativeError> {
    let problem = program.problem();
    let evaluation = program.evaluate(point)?;
    let linearization = program.linearize(point, &evaluation, &LinearizationRequest::default())?;
    let n = point.variables.len();
    let mut out = Vec::new();
    let mut first = 0;
    for rows in program.goal_rows().chunk_by(GoalRow::shares_vector_with) {
        let (row, range) = (&rows[0], first..first + rows.len());
        first = range.end;
        let mut found = Vec::new();
        for kind in kinds(problem) {
            let change = random_change(n, &kind, rng);
            let slopes = (range.clone())
                .map(|i| {
                    (0..n)
                        .map(|j| linearization.jacobian[(i, j)] * change[j])
                        .sum()
                })
                .collect();
            let mut values = |s: f64| {
                let there = program.rollout(point, &scaled(&change, s)).ok()?;
                let constraints = program.evaluate(&there).ok()?.constraints;
                Some(vec![constraints[range.clone()].to_vec()])
            };
            found.extend(compare(&mut values, &[slopes], ROUNDING));
        }
        let name = format!("{}.{}", problem.goals[row.goal].name, row.part.name());
        out.extend(gather(
            name,
            "residuals by the controls, and simulations",
            found,
        ));
    }
    Ok(out)
}

/// Value of a sum of forms on a direction of the configurations.
fn form_value(gradient: &RowGradient, direction: &TrajectoryTangent, n_nodes: usize) -> f64 {
    let of = |form: &StateForm| -> f64 {
        (form.terms.iter())
            .map(|term| {
                let row = form.time_node * n_nodes + term.node;
                let vector = if term.component < 3 {
                    direction.positions[row]
                } else {
                    direction.rotations[row]
                };
                term.coefficient * vector[term.component % 3]
            })
            .sum()
    };
    gradient.iter().map(of).sum()
}

/// Every path constraint: some rows at random times and items, by the configurations.
fn path_blocks(program: &Transcription, point: &LiftedPoint, rng: &mut Rng) -> Vec<Block> {
    let problem = program.problem();
    let trajectory = &point.trajectory;
    let n_nodes = trajectory.n_nodes;
    let length = problem.rod.scales.length;
    let mut out = Vec::new();
    for constraint in program.path() {
        let limit = &constraint.limit;
        let times: Vec<usize> = (constraint.time_nodes.iter().copied())
            .filter(|&k| k > 0)
            .collect();
        if times.is_empty() {
            continue;
        }
        let mut found = Vec::new();
        for _ in 0..SAMPLES {
            let k = times[rng.usize(..times.len())];
            let item = rng.usize(..limit.n_items(&problem.rod));
            let mut vectors = |size: f64| -> Vec<Vector3<f64>> {
                (0..trajectory.positions.len())
                    .map(|_| vector(rng, size))
                    .collect()
            };
            let direction = TrajectoryTangent {
                positions: vectors(0.1 * length),
                rotations: vectors(1.0),
            };
            let rod_view = program.rod_view(point);
            let slope = form_value(&limit.gradient(&rod_view, k, item), &direction, n_nodes);
            let mut value = |s: f64| {
                let moved = trajectory.retract(&direction, s);
                let rod_view = RodView {
                    trajectory: &moved,
                    ..rod_view
                };
                Some(vec![vec![limit.value(&rod_view, k, item)]])
            };
            found.extend(compare(&mut value, &[vec![slope]], ROUNDING));
        }
        out.extend(gather(
            format!("{} (path)", constraint.name),
            "rows by positions and rotations",
            found,
        ));
    }
    out
}

/// Every obstacle's distance: gradient and second derivative at random points around the arm.
fn obstacle_blocks(program: &Transcription, rng: &mut Rng) -> Vec<Block> {
    let length = program.problem().rod.scales.length;
    let mut out = Vec::new();
    for constraint in program.path() {
        let PathLimit::Clearance { shape, .. } = &constraint.limit else {
            continue;
        };
        let found = (0..SAMPLES)
            .filter_map(|_| distance_comparison(shape, length, rng))
            .collect();
        out.extend(gather(
            format!("{} (distance)", constraint.name),
            "gradient and curvature of the signed distance",
            found,
        ));
    }
    out
}

/// Every actuator of one's own at random states and controls: both derivatives of its wrenches, and the second derivative.
fn actuator_blocks(problem: &OptimalControlProblem, rng: &mut Rng) -> Vec<Block> {
    let rod = &problem.rod;
    let mut out = Vec::new();
    for (index, acting) in problem.acting.iter().enumerate() {
        let actuator = &*acting.actuator;
        let nodes = actuator.nodes(rod);
        let scales: Vec<f64> = (acting.places.iter())
            .map(|place| {
                let carrier = &problem.actuators[acting.first + place / 6];
                [&carrier.force, &carrier.moment][place % 6 / 3].scale
            })
            .collect();
        let found = (0..SAMPLES)
            .filter_map(|_| actuator_comparison(rod, actuator, &nodes, &scales, rng))
            .collect();
        out.extend(gather(
            format!("own actuator {index}"),
            "wrenches by configuration and controls, and their derivatives likewise",
            found,
        ));
    }
    out
}

fn view<'a>(rod: &'a Rod, at: &'a Configuration) -> StateView<'a> {
    StateView {
        rod,
        time: 0.0,
        positions: &at.positions,
        rotations: &at.rotations,
    }
}

fn actuator_comparison(
    rod: &Rod,
    actuator: &dyn Actuator,
    nodes: &[usize],
    scales: &[f64],
    rng: &mut Rng,
) -> Option<Comparison> {
    let state = random_state(rod, 1.0, rng).configuration;
    let u: Vec<f64> = scales.iter().map(|scale| scale * number(rng)).collect();
    let du: Vec<f64> = scales.iter().map(|scale| scale * number(rng)).collect();
    let length = rod.scales.length;
    let moves: Vec<_> = (nodes.iter())
        .map(|_| [vector(rng, 0.1 * length), vector(rng, 1.0)])
        .collect();
    let at = |s: f64| {
        let mut there = state.clone();
        for (&node, [dx, zeta]) in nodes.iter().zip(&moves) {
            there.positions[node] += s * dx;
            there.rotations[node] *= exp(&(s * zeta));
        }
        let u: Vec<f64> = u.iter().zip(&du).map(|(u, du)| u + s * du).collect();
        (there, u)
    };
    let direction: Vec<f64> = (moves.iter().flatten())
        .flat_map(|v| [v.x, v.y, v.z])
        .chain(du.iter().copied())
        .collect();
    let covector: Vec<Wrench> = (nodes.iter())
        .map(|_| {
            Wrench::from_array(std::array::from_fn(|i| {
                number(rng) * if i < 3 { length } else { 1.0 }
            }))
        })
        .collect();
    let n = 6 * nodes.len();
    // The derivative of the wrenches along the direction, and that of `λ·w` along all.
    let slopes_at = |there: &Configuration, u: &[f64]| {
        let (mut slopes, mut covectors) = (vec![0.0; n], vec![0.0; direction.len()]);
        let at = view(rod, there);
        let configuration = actuator.configuration_jacobian(&at, u);
        let controls = actuator.control_jacobian(&at, u);
        for (i, weight) in flat(&covector).into_iter().enumerate() {
            for (j, along) in direction.iter().enumerate() {
                let entry = match j.checked_sub(n) {
                    None => configuration[(i, j)],
                    Some(j) => controls[(i, j)],
                };
                slopes[i] += entry * along;
                covectors[j] += weight * entry;
            }
        }
        (slopes, covectors)
    };
    let (slopes, _) = slopes_at(&state, &u);
    let curvature = actuator.curvature(&view(rod, &state), &u, &covector);
    let mut bend = 0.0;
    for (i, a) in direction.iter().enumerate() {
        for (j, b) in direction.iter().enumerate() {
            bend += a * curvature[(i, j)] * b;
        }
    }
    let halves = |all: &[f64]| -> Vec<Vec<f64>> {
        let part = |from: usize| -> Vec<f64> {
            (all.chunks(6))
                .flat_map(|row| row[from..from + 3].to_vec())
                .collect()
        };
        vec![part(0), part(3)]
    };
    let mut along = |s: f64| {
        let (there, u) = at(s);
        let mut wrenches = vec![Wrench::default(); nodes.len()];
        actuator.wrench(&view(rod, &there), &u, &mut wrenches);
        let (_, covectors) = slopes_at(&there, &u);
        let mut out = halves(&flat(&wrenches));
        out.push(vec![dot(&covectors, &direction)]);
        Some(out)
    };
    let mut expected = halves(&slopes);
    expected.push(vec![bend]);
    compare(&mut along, &expected, ACTUATOR_ROUNDING)
}

fn distance_comparison(shape: &Shape, length: f64, rng: &mut Rng) -> Option<Comparison> {
    let x = vector(rng, length);
    let change = vector(rng, 0.1 * length);
    let here = shape.distance(&x);
    let mut along = |s: f64| {
        let there = shape.distance(&(x + s * change));
        Some(vec![vec![there.value], there.gradient.as_slice().to_vec()])
    };
    let slopes = [
        vec![here.gradient.dot(&change)],
        (here.curvature * change).as_slice().to_vec(),
    ];
    compare(&mut along, &slopes, ROUNDING)
}

/// The exact Hessian of the Lagrangian along random changes of the controls, and gradients by the adjoint; `None` where the Hessian
/// is an approximation by design ([`curvature`](crate::mechanics::curvature)).
fn hessian_block(
    program: &Transcription,
    point: &LiftedPoint,
    rng: &mut Rng,
) -> Result<Option<Block>, DerivativeError> {
    let problem = program.problem();
    if problem.rod.model != RodModel::Standard {
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
    let n = point.variables.len();
    let kinds = kinds(problem);
    let by_kind = |values: &[f64]| -> Vec<Vec<f64>> {
        let of = |kind: &Vec<usize>| kind.iter().map(|&i| values[i]).collect();
        kinds.iter().map(of).collect()
    };
    let mut found = Vec::new();
    for kind in &kinds {
        let change = random_change(n, kind, rng);
        let product: Vec<f64> = (0..n)
            .map(|i| {
                (0..n)
                    .map(|j| (linearization.gauss_newton[(i, j)] + curvature[(i, j)]) * change[j])
                    .sum()
            })
            .collect();
        let mut gradient = |s: f64| {
            let there = program.rollout(point, &scaled(&change, s)).ok()?;
            Some(by_kind(
                &program.lagrangian_gradient(&there, &multipliers).ok()?,
            ))
        };
        found.extend(compare(&mut gradient, &by_kind(&product), HESSIAN_ROUNDING));
    }
    Ok(gather(
        "hessian",
        "exact Hessian of the Lagrangian over the controls, and gradients by the adjoint",
        found,
    ))
}
