//! A held base in the lanes.

use nalgebra::Vector3;

use super::LaneIntegrator;
use super::place::BASE;
use super::sweep::{
    ANGULAR_MOMENTUM, LAST_TURN, LINEAR_MOMENTUM, POSITION, ROTATION, SPIN_ROWS, STATE_ROWS,
};
use crate::mechanics::base_motion::BaseState;
use crate::mechanics::rotation::{cayley_quaternion, quaternion, wxyz};

/// The pose of a clamped or driven base.
#[derive(Clone, Debug)]
pub struct HeldBase {
    pub rows: [f64; STATE_ROWS],
    /// Quaternion of its last turn.
    pub turn: [f64; 4],
}

impl LaneIntegrator<'_> {
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
