//! The defects of (77) and (81) along a trajectory, one time node in each lane of a vector.

use std::marker::PhantomData;

use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};

use super::linearize::{ROUNDING, Workspace, is_possible};
use super::solved::{Weights, element_at};
use crate::mechanics::buffer::Buffer;
use crate::mechanics::configuration::Trajectory;
use crate::mechanics::element::StrainRule;
use crate::mechanics::element::{Helical, Law, TangentRule, Trapezoidal};
use crate::mechanics::lanes::tangent::{LEAST_MARGIN, NodePose, POSE_ROWS, drift};
use crate::mechanics::lanes::vector::{Lanes, Row, Vec3, rows};
use crate::mechanics::lanes::{CountLanes, dispatch};
use crate::mechanics::linearization::{self, Defects, Kick, Motion};
use crate::mechanics::rod::Rod;
use crate::mechanics::signal::ControlSignal;
use crate::mechanics::step_error::StepError;

/// [`linearization::defects`] in lanes: the same to rounding, on every instruction set to the bit. What lanes do not know is left
/// to it.
///
/// # Errors
/// As [`linearization::defects`].
pub fn defects(
    motion: &Motion,
    trajectory: &Trajectory,
    control: &ControlSignal,
) -> Result<Defects, StepError> {
    let along;
    let control = if control.acting.is_empty() {
        control
    } else {
        along = control.along(motion.rod, &motion.grid, trajectory);
        &along
    };
    let found = is_possible(motion).then(|| in_lanes(Arch::new(), motion, trajectory, control));
    match found.flatten() {
        Some(found) => Ok(found),
        None => linearization::defects(motion, trajectory, control),
    }
}

/// Of a node: elastic force and moment, angular momentum that leaves and that arrives.
const OUT_ROWS: usize = 12;

/// `None` where a node turns too far, an element's ends are near half a turn, or something is not finite.
pub(super) fn in_lanes(
    arch: Arch,
    motion: &Motion,
    trajectory: &Trajectory,
    control: &ControlSignal,
) -> Option<Defects> {
    let Motion {
        rod, grid, initial, ..
    } = *motion;
    let (n, h) = (rod.n_nodes(), grid.step);
    let first = rod.first_free_node();
    let n_lanes = dispatch(arch, CountLanes);
    let mut workspace = Workspace::new(motion, n_lanes);
    let solved = workspace.solve.is_some();
    let mut out = Buffer::zeros(n * OUT_ROWS * n_lanes);
    let zeros = vec![Vector3::zeros(); n * grid.n_steps];
    let mut defects = Defects {
        linear: zeros.clone(),
        angular: zeros,
        terminal_linear: initial.linear_momentum.clone(),
        terminal_angular: initial.angular_momentum.clone(),
    };
    // Momenta that arrive at the time node, before its kick.
    let (p, pi) = (&mut defects.terminal_linear, &mut defects.terminal_angular);
    let mut forces = vec![Vector3::zeros(); n];
    let mut moments = forces.clone();
    let mut probe = 0.0;
    for start in (0..=grid.n_steps).step_by(n_lanes) {
        let last = (start + n_lanes - 1).min(grid.n_steps);
        workspace.put_poses(trajectory, start, last, n_lanes);
        if let Some(solve) = &mut workspace.solve {
            for lane in 0..n_lanes {
                let k = (start + lane).min(grid.n_steps);
                let ends = [k < grid.n_steps, k > 0];
                solve.put_weights(motion, (lane, n_lanes), &motion.kick(k), ends);
            }
        }
        let group = Group {
            rod,
            h,
            workspace: &workspace,
            out: &mut out,
        };
        let regular = match rod.strain_rule {
            StrainRule::Helical => dispatch(arch, Ruled(group, PhantomData::<Helical>)),
            StrainRule::Trapezoidal => dispatch(arch, Ruled(group, PhantomData::<Trapezoidal>)),
        };
        if !regular {
            return None;
        }
        for (lane, k) in (start..=grid.n_steps).take(n_lanes).enumerate() {
            let of = |q: usize, part: usize| {
                Vector3::from_fn(|axis, _| out[(q * OUT_ROWS + part + axis) * n_lanes + lane])
            };
            let Kick { decay, weight, .. } = motion.kick(k);
            // Of the elements: forces, or impulses where steps are solved for.
            let kick = if solved { 1.0 } else { weight };
            for (q, node) in rod.nodes.iter().enumerate() {
                forces[q] = rod.gravity * node.mass;
                moments[q] = Vector3::zeros();
            }
            let rotations = trajectory.rotations_at(k);
            for load in &rod.loads {
                let wrench = load.wrench_at_node(&grid.node(k), &rotations[load.node]);
                forces[load.node] += wrench.force;
                moments[load.node] += wrench.moment;
            }
            for (node, wrench) in control.at(k).iter() {
                forces[node] += wrench.force;
                moments[node] += wrench.moment;
            }
            let (positions, last) = (trajectory.positions_at(k), k == grid.n_steps);
            for q in first..n {
                let kicked = decay * p[q] + (weight * forces[q] + kick * of(q, 0));
                let turned = decay * pi[q] + (weight * moments[q] + kick * of(q, 3));
                if last {
                    (p[q], pi[q]) = (kicked, turned);
                    continue;
                }
                let step = trajectory.positions_at(k + 1)[q] - positions[q];
                let moving = step * (rod.nodes[q].mass / h);
                let row = k * n + q;
                defects.linear[row] = moving - kicked;
                defects.angular[row] = of(q, 6) - turned;
                probe += (defects.linear[row] + defects.angular[row]).sum();
                p[q] = moving;
                pi[q] = of(q, 9);
            }
        }
    }
    f64::is_finite(probe).then_some(defects)
}

/// Time nodes whose forces and momenta are found together.
struct Group<'a> {
    rod: &'a Rod,
    h: f64,
    workspace: &'a Workspace,
    out: &'a mut [f64],
}

struct Ruled<'a, R>(Group<'a>, PhantomData<R>);

impl<R: TangentRule> WithSimd for Ruled<'_, R> {
    /// Whether all time nodes are regular.
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> bool {
        let Group {
            rod,
            h,
            workspace,
            out,
        } = self.0;
        let (poses, next) = (rows::<S>(&workspace.poses), rows::<S>(&workspace.next));
        let before = rows::<S>(&workspace.before);
        let weights: Option<Weights<S>> =
            (workspace.solve.as_ref()).map(|solve| solve.weights(simd));
        let out: &mut [Row<S>] = S::as_mut_simd_f64s(out).0;
        let (zero, one) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0));
        let mut irregular = zero;
        let mut a = NodePose::<S>::load(simd, poses);
        let (mut pull, mut twist) = (Vec3::zero(simd), Vec3::zero(simd));
        for (q, node) in rod.nodes.iter().enumerate() {
            let after = NodePose::<S>::load(simd, &next[q * POSE_ROWS..]).rotation;
            let drift = drift(&node.rotary, h, a.rotation, after);
            irregular = irregular
                + drift.level.select_below(1.0 - ROUNDING, zero, one)
                + (-drift.margin).select_below(-2.0 - ROUNDING, zero, one);
            let (mut force, mut moment) = (-pull, -twist);
            if let (Some(element), Some(weights)) = (rod.elements.get(q), &weights) {
                let (here, folded_here) = element_at::<S, R>(simd, poses, q);
                let (there, folded_there) = element_at::<S, R>(simd, next, q);
                let (last, folded_last) = element_at::<S, R>(simd, before, q);
                irregular = irregular + folded_here + folded_there + folded_last;
                let law = Law::of::<R>(simd, element);
                let strain = weights.strain::<R>(&law, &here, &there, &last);
                let [f, m_a, m_b] = R::pull(&here, &law.stress(strain));
                force = force + f;
                moment = moment - m_a;
                (pull, twist) = (f, m_b);
                a = NodePose::load(simd, &poses[(q + 1) * POSE_ROWS..]);
            } else if let Some(element) = rod.elements.get(q) {
                let b = NodePose::<S>::load(simd, &poses[(q + 1) * POSE_ROWS..]);
                let margin = a.rotation.transposed_product(b.rotation).trace() + 1.0;
                irregular = irregular + (-margin).select_below(-LEAST_MARGIN, zero, one);
                let dx = b.position - a.position;
                let [f, m_a, m_b] = R::gradient(element, dx, a.rotation, b.rotation);
                force = force + f;
                moment = moment - m_a;
                (pull, twist) = (f, m_b);
                a = b;
            }
            let rows = &mut out[q * OUT_ROWS..];
            force.store(rows, 0);
            moment.store(rows, 3);
            drift.leaving.store(rows, 6);
            drift.arriving.store(rows, 9);
        }
        irregular.all_at_most(0.0)
    }
}
