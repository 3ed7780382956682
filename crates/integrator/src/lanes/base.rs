//! Held ends in the lanes.

use nalgebra::{Quaternion, Vector3};

use super::LaneIntegrator;
use super::place::{BASE, Slot, Slots};
use super::sweep::{
    ANGULAR_MOMENTUM, FORCE, LAST_TURN, LINEAR_MOMENTUM, MOMENT, POSITION, ROTATION, SPIN_ROWS,
    STATE_ROWS,
};
use cosserat::base_motion::BaseState;
use cosserat::ends::Joint;
use cosserat::guards::approach_end;
use cosserat::rod::Rod;
use cosserat::rotation::{cayley_quaternion, quaternion, wxyz};
use cosserat::step_error::StepError;

/// The pose of a clamped or driven base.
#[derive(Clone, Debug)]
pub struct HeldBase {
    pub rows: [f64; STATE_ROWS],
    /// Quaternion of its last turn.
    pub turn: [f64; 4],
}

/// A [`Joint`] in the lanes.
#[derive(Clone, Copy, Debug)]
pub struct HeldEnd {
    pub joint: Joint,
    pub place: Slot,
    /// State of a driven end at the end of the step under way, and the rows of its pose there.
    pub driven: Option<(BaseState, [f64; 7])>,
}

impl HeldEnd {
    pub fn of_rod(rod: &Rod, slots: Slots) -> Vec<Self> {
        (rod.joints.iter())
            .map(|joint| Self {
                joint: *joint,
                place: slots.place(joint.node),
                driven: None,
            })
            .collect()
    }
}

/// Returns the sign of a rotation's quaternion that is nearer to another one.
fn nearer(q: Quaternion<f64>, to: &Quaternion<f64>) -> Quaternion<f64> {
    if q.dot(to) >= 0.0 { q } else { -q }
}

impl LaneIntegrator<'_> {
    /// Finds where the driven ends among the joints are at the end of the step.
    pub(super) fn approach_ends(&mut self) -> Result<(), StepError> {
        for i in 0..self.ends.len() {
            let node = self.ends[i].joint.node;
            let at = self.rotation(node);
            let Some((end, _)) = approach_end(self.rod, node, &at, self.step, self.clock)? else {
                continue;
            };
            let q = nearer(quaternion(&end.rotation), &self.quaternion(node));
            let [w, x, y, z] = wxyz(&q);
            let p = end.position;
            self.ends[i].driven = Some((end, [p.x, p.y, p.z, w, x, y, z]));
        }
        Ok(())
    }

    /// Moves driven ends to their pose at the end of the step.
    pub(super) fn put_ends(&mut self) {
        for held in &self.ends {
            for (i, value) in held
                .driven
                .iter()
                .flat_map(|(_, pose)| pose.iter().enumerate())
            {
                let at = self.slots.index(held.place, STATE_ROWS, POSITION + i);
                self.state[at] = *value;
            }
        }
    }

    /// Takes away the forces on the held motions of the joints.
    pub(super) fn hold_forces(&mut self) {
        for i in 0..self.ends.len() {
            let HeldEnd { joint, place, .. } = self.ends[i];
            self.set(place, FORCE, &Vector3::zeros());
            let moment = joint.turning * self.get(place, MOMENT);
            self.set(place, MOMENT, &moment);
        }
    }

    /// Takes away the forces on the held motions of the joints, and the momenta of these motions but those of a driven end.
    pub(super) fn hold_ends(&mut self) {
        let damping = 1.0 + self.half_damping();
        for i in 0..self.ends.len() {
            let HeldEnd {
                joint,
                place,
                driven,
            } = self.ends[i];
            let node = &self.rod.nodes[joint.node];
            let (p, mut pi) = driven.map_or_else(Default::default, |(end, _)| {
                let spin = node.rotary.component_mul(&end.angular_velocity);
                (end.velocity * (node.mass / damping), spin / damping)
            });
            pi += joint.turning * self.get(place, ANGULAR_MOMENTUM);
            self.set(place, LINEAR_MOMENTUM, &p);
            self.set(place, ANGULAR_MOMENTUM, &pi);
        }
        self.hold_forces();
    }

    /// Sets the pose of a driven base at the end of the step.
    pub(super) fn aim_base(&mut self, base: &BaseState, turn: &Vector3<f64>) {
        let Some(held) = &mut self.base else { return };
        let q = quaternion(&base.rotation);
        let rows = &mut held.rows;
        let [w, x, y, z] = [0, 1, 2, 3].map(|i| rows[ROTATION + i]);
        let same = q.w * w + q.i * x + q.j * y + q.k * z >= 0.0;
        let q = if same { q } else { -q };
        rows[POSITION..][..3].copy_from_slice(base.position.as_slice());
        rows[ROTATION] = q.w;
        rows[ROTATION + 1..][..3].copy_from_slice(q.imag().as_slice());
        held.turn = wxyz(&cayley_quaternion(turn));
    }

    /// Sets the momenta of a driven base.
    pub(super) fn set_base_momenta(&mut self, base: &BaseState) {
        let damping = 1.0 + self.half_damping();
        let rotary = self.rod.base_rotary(&[base.position, self.position(1)]);
        let p = base.velocity * (self.rod.nodes[0].mass / damping);
        let pi = rotary.component_mul(&base.angular_velocity) / damping;
        let Some(held) = &mut self.base else { return };
        held.rows[LINEAR_MOMENTUM..][..3].copy_from_slice(p.as_slice());
        held.rows[ANGULAR_MOMENTUM..][..3].copy_from_slice(pi.as_slice());
    }

    pub(super) fn turn_base(&mut self) {
        let Some(held) = &self.base else { return };
        for (i, value) in held.turn.iter().enumerate() {
            let at = self.slots.index(BASE, SPIN_ROWS, LAST_TURN + i);
            self.spin[at] = *value;
        }
    }

    pub(super) fn put_base(&mut self) {
        let Some(held) = &self.base else { return };
        for (row, value) in held.rows.iter().enumerate() {
            let at = self.slots.index(BASE, STATE_ROWS, row);
            self.state[at] = *value;
        }
        if !self.spin.is_empty() {
            self.turn_base();
        }
    }
}
