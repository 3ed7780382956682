//! The check of a stay: its part of the optimality conditions, by differences of its definition, and the motion after the horizon under the
//! last wrench.

use super::worse::worse;
use nalgebra::{Matrix3, Vector3};

use super::{CheckError, ReplayKind};
use control::{OptimalControlProblem, Stay};
use mechanics::differences;
use mechanics::rotation::exp;
use mechanics::{NodeWrenches, Rod, State, Stepper, TimeGrid};

/// The motion of an arm after its task under the last wrench.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StayReplay {
    /// Duration of the simulation, s.
    pub seconds: f64,
    /// Largest distance of the tip, or of the node that has the goal, from its target, m.
    pub tip_error: f64,
    /// Time of the largest distance, in s after the task.
    pub at: f64,
    /// Largest speed of any node, m/s.
    pub node_speed: f64,
    /// Largest possible distance of that node from the place where the wrench holds it, m, to second order, by the energy that the arrival on
    /// the solution's own grid leaves in every mode.
    pub bound: f64,
}

/// Simulates `rod` from `state`, at the end of the horizon, under constant wrenches; distances are those of the node that has the
/// goal from the place where it should stay.
///
/// # Errors
/// Returns [`CheckError`] if the motion breaks down.
pub(super) fn follow(
    problem: &OptimalControlProblem,
    stay: &Stay,
    (rod, state, step): (&Rod, State, f64),
    wrenches: NodeWrenches,
    bound: f64,
    mut observe: impl FnMut(&Stepper),
) -> Result<StayReplay, CheckError> {
    let goal = &problem.goals[stay.goal];
    let node = goal.node * (rod.n_elements() / problem.rod.n_elements());
    let place = goal.position.unwrap_or(stay.shape.positions[goal.node]);
    let grid = TimeGrid {
        start: problem.grid.start + problem.grid.duration(),
        ..TimeGrid::covering(stay.seconds, step, 1)
    };
    let mut stepper = Stepper::new(rod, grid, state);
    let mut out = StayReplay {
        seconds: stay.seconds,
        tip_error: (stepper.position(node) - place).norm(),
        at: 0.0,
        node_speed: 0.0,
        bound,
    };
    let mut before: Vec<Vector3<f64>> = Vec::new();
    for k in 0..grid.n_steps {
        problem.stop.check_at(k)?;
        (stepper.advance([wrenches; 2])).map_err(|source| CheckError::Replay {
            which: ReplayKind::Held,
            source,
        })?;
        let off = (stepper.position(node) - place).norm();
        if !(off <= out.tip_error) {
            (out.tip_error, out.at) = (off, (k + 1) as f64 * grid.step);
        }
        let here: Vec<_> = (0..rod.n_nodes()).map(|q| stepper.position(q)).collect();
        for (a, b) in before.iter().zip(&here) {
            out.node_speed = worse(out.node_speed, (b - a).norm() / grid.step);
        }
        before = here;
        observe(&stepper);
    }
    Ok(out)
}

/// Covectors of every node of a rod: of positions and body rotations, and of linear and angular momenta.
pub(super) struct Covectors {
    pub(super) x: Vec<Vector3<f64>>,
    pub(super) eta: Vec<Vector3<f64>>,
    pub(super) p: Vec<Vector3<f64>>,
    pub(super) pi: Vec<Vector3<f64>>,
}

/// Rotation, rad, in differences of the logarithms: differences of fourth order have an error of 1e-13 there.
const STEP: f64 = 1e-3;

/// Returns the derivative of `Σ y·r` with respect to the state `(x, R, p, π)` of all nodes, in which `r` is linear except for the
/// logarithms of rotations.
pub(super) fn covectors(stay: &Stay, y: &[Vector3<f64>], r: &[Matrix3<f64>]) -> Covectors {
    let n = r.len();
    let zeros = || vec![Vector3::zeros(); n];
    let mut out = Covectors {
        x: zeros(),
        eta: zeros(),
        p: zeros(),
        pi: zeros(),
    };
    for q in stay.free_nodes() {
        let none = Vector3::zeros();
        let value = |x: &Vector3<f64>, r: &Matrix3<f64>, p: &Vector3<f64>, pi: &_| -> f64 {
            (y.iter().enumerate())
                .map(|(vector, y)| y.dot(&stay.part_of_node(vector, q, [x, p, pi], r)))
                .sum()
        };
        let place = &stay.shape.positions[q];
        let at_rest = value(place, &r[q], &none, &none);
        for axis in 0..3 {
            let unit = Vector3::ith(axis, 1.0);
            out.x[q][axis] = value(&(place + unit), &r[q], &none, &none) - at_rest;
            out.p[q][axis] = value(place, &r[q], &unit, &none) - at_rest;
            out.pi[q][axis] = value(place, &r[q], &none, &unit) - at_rest;
            let turned = |angle: f64| value(place, &(r[q] * exp(&(unit * angle))), &none, &none);
            let [near, far] = [STEP, 2.0 * STEP].map(|step| [turned(step), turned(-step)]);
            out.eta[q][axis] = differences::slope(near, far, STEP);
        }
    }
    out
}
