//! The defects of the discrete equations of motion, and right-hand sides of the linearized ones.

use nalgebra::{Matrix3, Vector3};

use crate::mechanics::actuator::StateView;
use crate::mechanics::configuration::Trajectory;
use crate::mechanics::forces::NodalForces;
use crate::mechanics::guards::not_finite;
use crate::mechanics::inertia::InertiaRule;
use crate::mechanics::rotation::cay_inverse;
use crate::mechanics::rotation_step::TurnedNode;
use crate::mechanics::signal::ControlSignal;
use crate::mechanics::step_error::StepError;

use super::{Kick, Motion, StateTangent};

/// Half-step momenta of one interval, and the rotation that carries them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Interval {
    /// Cayley vector of `F = R^{k,T} R^{k+1}`.
    pub(super) f: Vector3<f64>,
    /// `F`
    pub(super) turn: Matrix3<f64>,
    /// `g`, body frame at the start of the interval.
    pub(super) g: Vector3<f64>,
}

impl Interval {
    /// `None` when the nodes turn by a quarter turn or more, where the discrete momentum folds over, or for NaN.
    fn between(
        before: &Matrix3<f64>,
        after: &Matrix3<f64>,
        rotary: &Vector3<f64>,
        h: f64,
    ) -> Option<Self> {
        let turn = before.transpose() * after;
        let f = cay_inverse(&turn);
        if !(f.norm_squared() < 4.0 && turn.trace() > 1.0) {
            return None;
        }
        Some(Self {
            f,
            turn,
            g: TurnedNode::new(rotary, &f, h).momentum_before(),
        })
    }

    /// The intervals of all nodes from `k` to `k + 1`, with the inertia where they leave.
    pub(super) fn all(
        motion: &Motion,
        trajectory: &Trajectory,
        rotary: &[Vector3<f64>],
        k: usize,
    ) -> Result<Vec<Self>, StepError> {
        let (before, after) = (trajectory.rotations_at(k), trajectory.rotations_at(k + 1));
        (0..motion.rod.n_nodes())
            .map(|q| {
                Self::between(&before[q], &after[q], &rotary[q], motion.grid.step).ok_or_else(
                    || interval_error(q, k, motion.grid.time(k), &before[q], trajectory),
                )
            })
            .collect()
    }
}

/// Defects of the discrete equations of motion, and the momenta at the last time node.
#[derive(Clone, Debug, PartialEq)]
pub struct Defects {
    /// Linear rows, spatial, kg m/s: time node `k < N`, rod node `q` at `k (K+1) + q`; zero on fixed nodes.
    pub linear: Vec<Vector3<f64>>,
    /// Angular rows, body frame, kg m²/s, in the same order.
    pub angular: Vec<Vector3<f64>>,
    /// Linear momentum of every node at `N`.
    pub terminal_linear: Vec<Vector3<f64>>,
    /// Angular momentum of every node at `N`, body frame.
    pub terminal_angular: Vec<Vector3<f64>>,
}

/// A right-hand side of the linearized equations of motion: a change of every row `r_k`, of the momenta at the end, and of the
/// state at the start.
#[derive(Clone, Debug, PartialEq)]
pub struct RightHandSide {
    /// Linear rows, spatial, in the order of [`Defects::linear`]; without effect on fixed nodes.
    pub linear: Vec<Vector3<f64>>,
    /// Angular rows, body frame, in the same order.
    pub angular: Vec<Vector3<f64>>,
    /// Direct change of the linear momentum of every node at `N`.
    pub terminal_linear: Vec<Vector3<f64>>,
    /// Direct change of the angular momenta, body frame.
    pub terminal_angular: Vec<Vector3<f64>>,
    /// Deviation of the state at time node 0, momenta before the first kick; `None` where it is as given. Without effect on
    /// fixed nodes.
    pub start: Option<StateTangent>,
}

impl RightHandSide {
    /// Nothing but a deviation of the state at the start, over `n_steps` steps.
    #[must_use]
    pub fn at_start(deviation: StateTangent, n_steps: usize) -> Self {
        let n_nodes = deviation.positions.len();
        let rows = vec![Vector3::zeros(); n_nodes * n_steps];
        let end = vec![Vector3::zeros(); n_nodes];
        Self {
            linear: rows.clone(),
            angular: rows,
            terminal_linear: end.clone(),
            terminal_angular: end,
            start: Some(deviation),
        }
    }

    /// Minus the defects: what makes them vanish to first order. The terminal momenta have none.
    #[must_use]
    pub fn against(defects: &Defects) -> Self {
        let minus = |v: &[Vector3<f64>]| v.iter().map(|v| -v).collect();
        let zeros = vec![Vector3::zeros(); defects.terminal_linear.len()];
        Self {
            linear: minus(&defects.linear),
            angular: minus(&defects.angular),
            terminal_linear: zeros.clone(),
            terminal_angular: zeros,
            start: None,
        }
    }

    /// Change of the momenta of all `n` nodes after the kick at time node `k`.
    pub(in crate::mechanics) fn at(
        &self,
        k: usize,
        n: usize,
    ) -> (&[Vector3<f64>], &[Vector3<f64>]) {
        match self.linear.get(k * n..(k + 1) * n) {
            Some(linear) => (linear, &self.angular[k * n..(k + 1) * n]),
            None => (&self.terminal_linear, &self.terminal_angular),
        }
    }
}

/// Evaluates the defects of a trajectory under a control.
///
/// # Errors
/// [`StepError`] where a node turns a quarter turn or more within a step, or where something is not finite.
pub fn defects(
    motion: &Motion,
    trajectory: &Trajectory,
    control: &ControlSignal,
) -> Result<Defects, StepError> {
    let Motion {
        rod, grid, initial, ..
    } = *motion;
    let n = rod.n_nodes();
    let h = grid.step;
    let mut forces = NodalForces::zeros(n);
    let mut linear = vec![Vector3::zeros(); n * grid.n_steps];
    let mut angular = linear.clone();
    // Momenta that arrive at the time node, before its kick.
    let mut p = initial.linear_momentum.clone();
    let mut pi = initial.angular_momentum.clone();
    for k in 0..=grid.n_steps {
        let positions = trajectory.positions_at(k);
        forces.evaluate_at_node(rod, positions, trajectory.rotations_at(k), &grid.node(k));
        for (node, wrench) in control.at(k).iter() {
            forces.forces[node] += wrench.force;
            forces.moments[node] += wrench.moment;
        }
        let here = StateView::of(rod, &grid, trajectory, k);
        for (node, wrench) in control.at(k).acting_on(here) {
            forces.forces[node] += wrench.force;
            forces.moments[node] += wrench.moment;
        }
        let Kick {
            decay,
            weight,
            impulse,
        } = motion.kick(k);
        let first = rod.first_free_node();
        for q in first..n {
            p[q] = decay * p[q] + weight * forces.forces[q];
            pi[q] = decay * pi[q] + weight * forces.moments[q];
        }
        if k == grid.n_steps {
            break;
        }
        let [leaving, arriving] = motion.inertia(trajectory, k);
        let intervals = Interval::all(motion, trajectory, &leaving, k)?;
        let rule = InertiaRule::of(rod.model, k);
        if rule == InertiaRule::Start {
            rod.add_kinetic_reaction(positions, |q| &intervals[q].f, impulse, h, &mut p);
        }
        let stresses = motion.interval_stresses(trajectory, k);
        if let Some(stresses) = &stresses {
            let weight = 0.5 * h * impulse;
            motion.add_stress_impulses(trajectory, k, stresses, weight, &mut p, &mut pi);
        }
        let next = trajectory.positions_at(k + 1);
        for q in first..n {
            let interval = &intervals[q];
            let moving = (next[q] - positions[q]) * (rod.nodes[q].mass / h);
            let row = k * n + q;
            linear[row] = moving - p[q];
            angular[row] = interval.g - pi[q];
            p[q] = moving;
            pi[q] = if rule == InertiaRule::Both {
                TurnedNode::new(&arriving[q], &interval.f, h).momentum_after()
            } else {
                interval.turn.tr_mul(&interval.g)
            };
            if !(linear[row] + angular[row]).iter().all(|c| c.is_finite()) {
                return Err(not_finite(
                    q,
                    k,
                    grid.time(k),
                    "the residual of the equations of motion",
                ));
            }
        }
        if rule == InertiaRule::End {
            let arrival = motion.arriving_impulse();
            rod.add_kinetic_reaction(next, |q| &intervals[q].f, arrival, h, &mut p);
        }
        if let Some(stresses) = &stresses {
            let weight = 0.5 * h * motion.arriving_impulse();
            motion.add_stress_impulses(trajectory, k + 1, stresses, weight, &mut p, &mut pi);
        }
    }
    Ok(Defects {
        linear,
        angular,
        terminal_linear: p,
        terminal_angular: pi,
    })
}

pub(super) fn interval_error(
    node: usize,
    step: usize,
    time: f64,
    before: &Matrix3<f64>,
    trajectory: &Trajectory,
) -> StepError {
    let f = cay_inverse(&(before.transpose() * trajectory.rotations_at(step + 1)[node]));
    let ratio = 0.5 * f.norm();
    if ratio.is_finite() {
        StepError::RotationTooLarge {
            node,
            step,
            time,
            ratio: ratio.max(1.0),
        }
    } else {
        not_finite(node, step, time, "the rotation between two time nodes")
    }
}
