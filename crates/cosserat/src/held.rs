//! The held ends of a rod: their poses, their gaps, and the motions that they leave loose. [`ends`](cosserat::ends) has the conditions.

use nalgebra::{Matrix3, Matrix6, SMatrix, SVD, Vector3, Vector6};

use crate::base_motion::BaseState;
use crate::block_tridiagonal::BlockTridiagonal;
use crate::configuration::{Configuration, State};
use crate::ends::{EndCondition, Joint};
use crate::load::Wrench;
use crate::rod::Rod;
use crate::rotation::{exp, log};
use crate::strain_coordinates::retract_shape;

impl Rod {
    /// Returns the joint at a node.
    #[must_use]
    pub fn joint(&self, node: usize) -> Option<&Joint> {
        self.joints.iter().find(|joint| joint.node == node)
    }

    /// Returns the part of a wrench on a node that moves it.
    #[must_use]
    pub fn on_free_motions(&self, node: usize, wrench: Wrench) -> Wrench {
        match self.joint(node) {
            None => wrench,
            Some(joint) => Wrench {
                force: Vector3::zeros(),
                moment: joint.turning * wrench.moment,
            },
        }
    }

    /// Tells whether an end is held, so that the rod has a place.
    #[must_use]
    pub fn is_held(&self) -> bool {
        self.base != EndCondition::Free || self.tip_end != EndCondition::Free
    }

    /// Tells whether the tip moves freely.
    #[must_use]
    pub fn has_free_tip(&self) -> bool {
        self.tip_end == EndCondition::Free
    }

    /// Writes the shape to which a tangent `(δx, ζ)` of every node leads: the strains of its elements [follow it linearly](retract_shape), or,
    /// since that would carry a held tip away, the pose of every node does.
    pub fn retract(
        &self,
        from: &Configuration,
        (positions, rotations): (&[Vector3<f64>], &[Vector3<f64>]),
        to: &mut Configuration,
    ) {
        if self.has_free_tip() {
            return retract_shape(from, positions, rotations, to);
        }
        for q in 0..self.n_nodes() {
            to.positions[q] = from.positions[q] + positions[q];
            to.rotations[q] = from.rotations[q] * exp(&rotations[q]);
        }
    }

    /// Tells whether the tip follows a motion that is given.
    #[must_use]
    pub fn has_driven_tip(&self) -> bool {
        matches!(self.tip_end, EndCondition::Driven(_))
    }

    /// Returns the condition at an end.
    #[must_use]
    pub fn end_at(&self, node: usize) -> &EndCondition {
        match node {
            0 => &self.base,
            _ => &self.tip_end,
        }
    }

    /// Returns pose and velocity of a driven end at time `t`; `None` for any other end.
    #[must_use]
    pub fn driven_end(&self, node: usize, t: f64) -> Option<BaseState> {
        if node == 0 {
            return self.driven_base(t);
        }
        match &self.tip_end {
            EndCondition::Driven(motion) => {
                let (position, rotation) = &self.tip_reference;
                Some(motion.at(position, rotation, t))
            }
            _ => None,
        }
    }

    /// Returns the pose in which a joint holds its end at time `t`: of its rotation only the held part counts.
    #[must_use]
    pub fn held_pose(&self, joint: &Joint, t: f64) -> (Vector3<f64>, Matrix3<f64>) {
        if joint.node == 0 {
            return self.base_reference;
        }
        (self.driven_end(joint.node, t))
            .map_or(self.tip_reference, |end| (end.position, end.rotation))
    }

    /// Returns the rotation in which the base (node 0) or the tip is held, body to space.
    fn held_rotation(&self, node: usize) -> Matrix3<f64> {
        match node {
            0 => self.base_reference.1,
            _ => self.tip_reference.1,
        }
    }

    /// Returns the motion `(δx, η)` that takes the held part of a joint's pose to where it is held at time `t`; of a hinge to first order
    /// in the angle between its axes.
    #[must_use]
    pub fn gap(&self, joint: &Joint, at: &Configuration, t: f64) -> Vector6<f64> {
        let (position, rotation) = self.held_pose(joint, t);
        let q = joint.node;
        let way = position - at.positions[q];
        let across = log(&at.rotations[q].tr_mul(&rotation));
        let turn = match joint.axis() {
            // The rotation that takes the axis to its place: a × (Rᵀ R_held a), as long as its angle.
            Some(axis) => {
                let place = at.rotations[q].tr_mul(&(rotation * axis));
                let normal = axis.cross(&place);
                let angle = normal.norm().atan2(axis.dot(&place));
                normal.try_normalize(0.0).map_or(normal, |n| n * angle)
            }
            None => across - joint.turning * across,
        };
        Vector6::new(way.x, way.y, way.z, turn.x, turn.y, turn.z)
    }

    /// Returns by how far the held ends are from where they are held at time `t`: the largest distance, m, and angle, rad.
    #[must_use]
    pub fn largest_gap(&self, at: &Configuration, t: f64) -> (f64, f64) {
        (self.joints.iter())
            .map(|joint| self.gap(joint, at, t))
            .map(|gap| (gap.fixed_rows::<3>(0).norm(), gap.fixed_rows::<3>(3).norm()))
            .fold((0.0, 0.0), |most, gap| {
                (most.0.max(gap.0), most.1.max(gap.1))
            })
    }

    /// Puts the held part of the joints to its pose and momenta at time `t`.
    pub(super) fn start_joints(&self, t: f64, state: &mut State) {
        for joint in &self.joints {
            let q = joint.node;
            let driven = self.driven_end(q, t);
            let (position, rotation) = self.held_pose(joint, t);
            let gap = self.gap(joint, &state.configuration, t);
            state.configuration.positions[q] = position;
            if !joint.turns() {
                state.configuration.rotations[q] = rotation;
            } else if joint.axis().is_some() {
                let turn = Vector3::new(gap[3], gap[4], gap[5]);
                if turn.norm() > ON_AXIS {
                    state.configuration.rotations[q] *= exp(&turn);
                }
            }
            let spin = joint.turning * state.angular_momentum[q];
            let moving = driven.map(|end| {
                let spin = self.nodes[q].rotary.component_mul(&end.angular_velocity);
                (end.velocity * self.nodes[q].mass, spin)
            });
            (state.linear_momentum[q], state.angular_momentum[q]) =
                moving.unwrap_or((Vector3::zeros(), spin));
        }
    }

    /// Projects a vector over the free nodes, of forces and moments or of motions, onto the motions that joints leave free.
    pub fn project_joints(&self, vector: &mut [Vector6<f64>]) {
        for joint in &self.joints {
            let own = &mut vector[joint.node - self.first_free_node()];
            *own = joint.project(own);
        }
    }

    /// Returns a block between two nodes of a matrix over the free nodes as it acts on the motions that joints leave free, `P K P`.
    pub fn project_block(
        &self,
        (row, column): (usize, usize),
        mut block: Matrix6<f64>,
    ) -> Matrix6<f64> {
        if let Some(joint) = self.joint(row) {
            block = joint.projection() * block;
        }
        if let Some(joint) = self.joint(column) {
            block *= joint.projection();
        }
        block
    }

    /// Replaces the rows and columns of the held motions, `K` by `P K P + (1 - P) c`, with `c` the stiffness of the elements beside the
    /// joint: the held motions are then fast modes on their own. Block 0 belongs to node `first`.
    pub fn hold_joints(&self, first: usize, k: &mut BlockTridiagonal) {
        for joint in &self.joints {
            let p = joint.projection();
            let i = joint.node - first;
            let element = &self.elements[joint.node.saturating_sub(1)];
            let linear = element.linear_stiffness.max() / element.length;
            let angular = element.angular_stiffness.max() / element.length
                + element.linear_stiffness.max() * element.length;
            let stiff = Vector6::new(linear, linear, linear, angular, angular, angular);
            let rest = Matrix6::identity() - p;
            k.diagonal[i] = p * k.diagonal[i] * p + rest * Matrix6::from_diagonal(&stiff) * rest;
            if let Some(before) = i.checked_sub(1) {
                k.below[before] = p * k.below[before];
                k.above[before] *= p;
            }
            if i < k.above.len() {
                k.above[i] = p * k.above[i];
                k.below[i] *= p;
            }
        }
    }

    /// Returns the largest number of motions that cost no elastic energy: those of a rigid body that the ends leave free, and the spin of
    /// all sections about the arm's own axis between two ball joints.
    #[must_use]
    pub fn most_loose_motions(&self) -> usize {
        let n_turns = |end: &EndCondition| match end {
            EndCondition::Clamped | EndCondition::Driven(_) => 0,
            EndCondition::Pinned { axis: Some(_) } => 1,
            EndCondition::Pinned { axis: None } | EndCondition::Free => 3,
        };
        let is_fixed = |end: &EndCondition| *end != EndCondition::Free;
        match (is_fixed(&self.base), is_fixed(&self.tip_end)) {
            (false, false) => 6,
            (true, false) => n_turns(&self.base),
            (false, true) => n_turns(&self.tip_end),
            // Two points leave the turn about the line through them, and two balls the spin of a flexible shaft.
            (true, true) => match n_turns(&self.base).min(n_turns(&self.tip_end)) {
                0 => 0,
                3 => 2,
                _ => 1,
            },
        }
    }

    /// Tells whether all sections of a round arm may turn about their own axes at no cost, in any shape and under any forces: no end holds
    /// them, and one is a ball joint.
    #[must_use]
    pub fn may_spin(&self) -> bool {
        let ends = [&self.base, &self.tip_end];
        let is_ball = |end: &EndCondition| matches!(end, EndCondition::Pinned { axis: None });
        (ends.into_iter()).all(|end| is_ball(end) || *end == EndCondition::Free)
            && ends.into_iter().any(is_ball)
    }

    /// Returns the number of motions of a rigid body that the ends leave free in a configuration: the dimension of the twists `(v, ω)` with
    /// `v + ω × x = 0` and `(1 - P) Rᵀ ω = 0` at every held end.
    #[must_use]
    pub fn n_rigid_motions(&self, at: &Configuration) -> usize {
        let mut rows = SMatrix::<f64, 12, 6>::zeros();
        let length = self.scales.length;
        let ends = [(0, &self.base), (self.tip(), &self.tip_end)];
        for (i, (q, end)) in ends.into_iter().enumerate() {
            if *end == EndCondition::Free {
                continue;
            }
            let x = at.positions[q] / length;
            let turning = end.turning(&self.held_rotation(q));
            let held = (Matrix3::identity() - turning) * at.rotations[q].transpose();
            let mut part = rows.fixed_rows_mut::<6>(6 * i);
            part.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
            part.fixed_view_mut::<3, 3>(0, 3)
                .copy_from(&-x.cross_matrix());
            part.fixed_view_mut::<3, 3>(3, 3).copy_from(&held);
        }
        let values = SVD::new(rows, false, false).singular_values;
        values
            .iter()
            .filter(|value| **value < NO_CONSTRAINT)
            .count()
    }
}

/// Angle between the axes of a hinge, rad, up to which they are one: rounding of a rotation.
const ON_AXIS: f64 = 1e-12;
/// Singular value of the conditions on a rigid motion, in units of the arm's length, below which they leave it free: rounding of poses.
const NO_CONSTRAINT: f64 = 1e-9;
