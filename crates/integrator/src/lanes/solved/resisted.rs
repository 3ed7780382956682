//! [Resistance](cosserat::resistance) in steps that are solved for: the impulse at the start of a step, which depends on its end.

use pulp::Simd;

use crate::lanes::place::Slots;
use crate::lanes::vector::{Frame, Lanes, Row, Vec3, row};
use cosserat::buffer::Buffer;
use cosserat::rod::Rod;

/// Rows of a block of nodes: `h/2/(1 + a)` times `c/h²`, across the axis and along it.
const ROWS: usize = 2;
/// Rows of a slope, in the body frame: `xx`, `xy`, `yy` and `zz`.
pub const SLOPE_ROWS: usize = 4;

/// Returns the rows of all nodes, zero where nothing resists; `None` if nothing resists any.
pub(super) fn rows_of(rod: &Rod, slots: Slots, time_step: f64) -> Option<Buffer> {
    if rod.resistances.is_empty() {
        return None;
    }
    let mut out = Buffer::zeros(slots.len() * ROWS);
    let weight = 0.5 / (time_step * (1.0 + 0.5 * rod.viscous_damping * time_step));
    for node in 0..rod.n_nodes() {
        if let Some(resistance) = rod.resistance(node) {
            let place = slots.place(node);
            out[slots.index(place, ROWS, 0)] = weight * resistance.normal;
            out[slots.index(place, ROWS, 1)] = weight * resistance.tangential;
        }
    }
    Some(out)
}

/// The resistance to the motion of a block of nodes during a step, in their body frames at its start.
pub(super) struct Resisted<S: Simd> {
    moved: Vec3<S>,
    across: Lanes<S>,
    normal: Lanes<S>,
    tangential: Lanes<S>,
}

impl<S: Simd> Resisted<S> {
    #[inline(always)]
    pub fn of(rows: &Buffer, block: usize, frame: &Frame<S>, moved: Vec3<S>) -> Self {
        let rows = &crate::lanes::vector::blocks::<S, ROWS>(rows)[block];
        let moved = frame.to_body(moved);
        let simd = moved.x.simd;
        Self {
            across: (moved.x * moved.x + moved.y * moved.y).sqrt(),
            normal: row(simd, rows, 0),
            tangential: row(simd, rows, 1),
            moved,
        }
    }

    /// Minus its impulse, spatial frame.
    #[inline(always)]
    pub fn impulse(&self, frame: &Frame<S>) -> Vec3<S> {
        let across = self.normal * self.across;
        frame.to_space(Vec3 {
            x: self.moved.x * across,
            y: self.moved.y * across,
            z: self.moved.z * (self.tangential * self.moved.z.abs()),
        })
    }

    /// Stores the derivative of minus the impulse along the motion, body frame.
    #[inline(always)]
    pub fn store_slope(&self, out: &mut [Row<S>], at: usize) {
        let across = self.normal * self.across;
        // Without motion across the axis there is no direction.
        let least = Lanes::splat(across.simd, f64::MIN_POSITIVE);
        let norm = self.across.max(least);
        let (x, y) = (self.moved.x / norm, self.moved.y / norm);
        let slope = [
            across + x * x * across,
            x * y * across,
            across + y * y * across,
            self.moved.z.abs() * self.tangential * 2.0,
        ];
        for (i, value) in slope.into_iter().enumerate() {
            out[at + i] = value.value;
        }
    }
}

/// Returns the slope of one lane from its rows.
#[inline(always)]
pub(super) fn slope(rows: &[f64], n_lanes: usize) -> [[f64; 3]; 3] {
    let [xx, xy, yy, zz] = [0, 1, 2, 3].map(|i| rows[i * n_lanes]);
    [[xx, xy, 0.0], [xy, yy, 0.0], [0.0, 0.0, zz]]
}
