//! The direction of turns of half a turn or more.
//!
//! A node can turn to an orientation in two classes of ways that no continuous change of the motion transforms into each other: the unit
//! quaternion, whose sign follows the node continuously from the start, ends at `q*` or at `-q*`. The rotation vector of the error,
//! `log(R*ᵀ R)`, changes its sign at half a turn, where rounding decides about it; the logarithm of the quaternion jumps at a full turn
//! only.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{Matrix3, Vector3};

use super::problem::{Goal, OptimalControlProblem};
use super::tracking::Tracking;
use mechanics::rotation::{exp, is_followed_beyond_half_turn, log};
use mechanics::{BaseCondition, Trajectory};

/// Stiffness of a cantilever against a force on its tip, in units of `EI/L³`.
pub const TIP_STIFFNESS: f64 = 3.0;
/// Fraction of the energy of one way that the other must save, and angle, rad, by which a turn may fall short of half a turn and still
/// count as one: more than the rounding of the energies of two ways that are equal, and of rotations that a scene gives with seven digits.
const SAVED: f64 = 1e-6;

/// Returns the rotation vector of the same rotation as `psi` in the other direction, `ψ (1 - 2π/|ψ|)`; zero stays.
pub(super) fn other_way(psi: &Vector3<f64>) -> Vector3<f64> {
    let angle = psi.norm();
    if angle > 0.0 {
        psi * (1.0 - TAU / angle)
    } else {
        *psi
    }
}

/// Tells for every goal whether its orientation is approached by more than half a turn from the start.
pub(super) fn longer_ways(problem: &OptimalControlProblem) -> Vec<bool> {
    (problem.goals.iter())
        .map(|goal| is_longer(problem, goal).unwrap_or(false))
        .collect()
}

/// Tells whether a goal is approached by more than half a turn: along the rows of a track, or the goals of its node, that come before it;
/// without these, in the direction that bends the arm less. `None` if the goal has no orientation.
fn is_longer(problem: &OptimalControlProblem, goal: &Goal) -> Option<bool> {
    let to = goal.rotation?;
    let start = &problem.initial.configuration;
    let before = rows_before(problem, goal);
    if before.is_empty() {
        // The logarithm with which the residual begins: at half a turn its sign is decided by rounding.
        let from = &start.rotations[goal.node];
        let psi = from * -log(&(to.transpose() * from));
        return Some(psi.norm() > FRAC_PI_2 && is_bent_less_the_other_way(problem, goal, &psi));
    }
    let rows = before.iter().chain([&to]);
    let all = std::iter::once(&start.rotations[goal.node]).chain(rows);
    let off = all.map(|r| start.rotations[goal.node].transpose() * r);
    Some(is_followed_beyond_half_turn(off, false))
}

/// Returns the orientations of the goal's node that are prescribed before the goal, in the order of time.
fn rows_before(problem: &OptimalControlProblem, goal: &Goal) -> Vec<Matrix3<f64>> {
    let end = problem.grid.time(goal.time_node);
    let goals = (problem.goals.iter())
        .filter(|other| other.node == goal.node)
        .filter_map(|other| Some((problem.grid.time(other.time_node), other.rotation?)));
    let tracks = (problem.objective.tracking.iter())
        .filter(|track| track.node == goal.node)
        .flat_map(|track| track.rotations.iter().copied());
    let mut rows: Vec<_> = goals.chain(tracks).filter(|(t, _)| *t < end).collect();
    rows.sort_by(|a, b| a.0.total_cmp(&b.0));
    rows.into_iter().map(|(_, rotation)| rotation).collect()
}

/// Compares the energies of an arm that turns evenly along its length by the rotation vector `psi` (spatial frame) or in the other
/// direction, and whose tip is then pulled to the goal's position like that of a cantilever: in units of `½ EI/L`, `|ψ|² + 3 |x - x*|²/L²`.
/// A free arm turns the shorter way.
fn is_bent_less_the_other_way(
    problem: &OptimalControlProblem,
    goal: &Goal,
    psi: &Vector3<f64>,
) -> bool {
    let Some(target) = goal
        .position
        .filter(|_| problem.rod.base != BaseCondition::Free)
    else {
        return false;
    };
    let length = problem.rod.scales.length;
    let energy = |psi: &Vector3<f64>| {
        let missed = evenly_turned(problem, goal.node, psi) - target;
        psi.norm_squared() + TIP_STIFFNESS * missed.norm_squared() / (length * length)
    };
    energy(&other_way(psi)) < (1.0 - SAVED) * energy(psi)
}

/// Returns the position of a node of the initial shape that is turned evenly along its length, by `psi` (spatial frame) at the node.
fn evenly_turned(problem: &OptimalControlProblem, node: usize, psi: &Vector3<f64>) -> Vector3<f64> {
    let (shape, mesh) = (&problem.initial.configuration, &problem.rod.mesh);
    (0..node).fold(shape.positions[0], |x, q| {
        let turn = exp(&(psi * (mesh.along(q, 0.5) / mesh.fraction(node))));
        x + turn * (shape.positions[q + 1] - shape.positions[q])
    })
}

/// `log(R*ᵀ R)` of a node at time node `k`, where `R*` is `to`, followed along the motion of its node from the start, where `longer` says
/// by which way: so it goes on beyond half a turn where the motion does. Within a quarter turn of the goal the node is there by either way.
pub(super) fn rotation_error(
    node: usize,
    to: &Matrix3<f64>,
    (trajectory, k): (&Trajectory, usize),
    longer: bool,
) -> Vector3<f64> {
    let off = |k: usize| to.transpose() * trajectory.rotations_at(k)[node];
    let psi = log(&off(k));
    if psi.norm() > FRAC_PI_2 && is_followed_beyond_half_turn((0..=k).map(off), longer) {
        other_way(&psi)
    } else {
        psi
    }
}

/// Returns orientations on the way from `from` to `to`, each at most a quarter turn from the one before; the last is `to`. `longer` selects
/// the direction of more than half a turn.
pub(super) fn quarter_turns(
    from: &Matrix3<f64>,
    to: &Matrix3<f64>,
    longer: bool,
) -> Vec<Matrix3<f64>> {
    let psi = -log(&(to.transpose() * from));
    let psi = if longer { other_way(&psi) } else { psi };
    let n = (psi.norm() / FRAC_PI_2).ceil().max(1.0);
    let between = (1..n as usize).map(|i| from * exp(&(psi * (i as f64 / n))));
    between.chain([*to]).collect()
}

/// Returns the tip's tracks of orientations that lead away from the start by more than half a turn, in any number of rows.
pub(super) fn long_turns(problem: &OptimalControlProblem) -> impl Iterator<Item = &Tracking> {
    let tip = problem.rod.tip();
    let start = problem.initial.configuration.rotations[tip].transpose();
    (problem.objective.tracking.iter()).filter(move |track| {
        let off = |n: usize| {
            let rows = (track.rotations[..n].iter()).map(move |(_, to)| start * to);
            std::iter::once(Matrix3::identity()).chain(rows)
        };
        let is_half = |row: &(f64, Matrix3<f64>)| log(&(start * row.1)).norm() > PI - SAVED;
        track.node == tip
            && (track.rotations.iter().any(is_half)
                || (1..=track.rotations.len()).any(|n| is_followed_beyond_half_turn(off(n), false)))
    })
}
