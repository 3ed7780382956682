//! The matrix of the equations of a step that is solved for.

use nalgebra::Matrix6;

use super::chain::{ChainBlock, ChainBlocks, SIZE, ZERO};
use super::resisted;
use crate::lanes::base::HeldEnd;
use crate::lanes::place::Slots;
use cosserat::ends::Joint;

/// Rows of [`StepSolver::rates`](super::StepSolver::rates): `m/h`, and `J/h`.
pub const RATE_ROWS: usize = 4;

/// Rows of the matrix: four blocks of an element, row by row, the spin inertia of a node, and what resists it.
pub const EQUATION_ROWS: usize = RESISTED + resisted::SLOPE_ROWS;
pub const SPIN: usize = 4 * 36;
pub const RESISTED: usize = SPIN + 9;

/// The matrix of a step, from the rows of nodes and elements.
pub struct Equations<'a> {
    pub slots: Slots,
    pub first: usize,
    pub rows: &'a [f64],
    pub rates: &'a [f64],
    pub ends: &'a [HeldEnd],
}

impl Equations<'_> {
    /// A block of the element to the right of a node, added to a square.
    #[inline(always)]
    fn add(&self, q: usize, block: usize, out: &mut ChainBlock) {
        let place = self.slots.place(q);
        let at = self.slots.index(place, EQUATION_ROWS, 36 * block);
        let numbers = &self.rows[at..][..35 * self.slots.n_lanes + 1];
        for (column, entries) in out.iter_mut().enumerate() {
            for (row, entry) in entries.0.iter_mut().enumerate().take(SIZE) {
                *entry += numbers[(SIZE * row + column) * self.slots.n_lanes];
            }
        }
    }
}

impl Equations<'_> {
    /// Replaces the equations of motions that are held in a block of two nodes: they are unit equations, and nothing else depends on them.
    #[inline(always)]
    fn hold(&self, block: &mut ChainBlock, row: usize, column: usize) {
        for HeldEnd { joint, .. } in self.ends {
            if joint.node == row || joint.node == column {
                hold(block, joint, row, column);
            }
        }
    }
}

/// `P A`, `A P`, or on the diagonal `P A P + 1 - P`, with the projection onto the free motions of a joint.
#[cold]
#[inline(never)]
fn hold(block: &mut ChainBlock, joint: &Joint, row: usize, column: usize) {
    let p = joint.projection();
    let mut a = Matrix6::from_fn(|i, j| block[j].0[i]);
    if joint.node == row {
        a = p * a;
    }
    if joint.node == column {
        a *= p;
    }
    if row == column {
        a += Matrix6::identity() - p;
    }
    for (j, column) in block.iter_mut().enumerate() {
        for (i, entry) in column.0.iter_mut().enumerate().take(SIZE) {
            *entry = a[(i, j)];
        }
    }
}

impl ChainBlocks for Equations<'_> {
    #[inline(always)]
    fn diagonal(&self, i: usize) -> ChainBlock {
        let mut out = ZERO;
        let q = self.first + i;
        let place = self.slots.place(q);
        let mass_rate = self.rates[self.slots.index(place, RATE_ROWS, 0)];
        let spin = self.slots.index(place, EQUATION_ROWS, SPIN);
        let resisted = self.slots.index(place, EQUATION_ROWS, RESISTED);
        let slope = resisted::slope(&self.rows[resisted..], self.slots.n_lanes);
        for i in 0..3 {
            out[i].0[i] = mass_rate;
            for j in 0..3 {
                out[j].0[i] += slope[i][j];
                out[3 + j].0[3 + i] = self.rows[spin + (3 * i + j) * self.slots.n_lanes];
            }
        }
        // Where there is no element, there is no stiffness.
        self.add(q, 0, &mut out);
        if q > 0 {
            self.add(q - 1, 3, &mut out);
        }
        self.hold(&mut out, q, q);
        out
    }

    #[inline(always)]
    fn beside(&self, i: usize, j: usize) -> ChainBlock {
        let mut out = ZERO;
        let (block, q) = if i < j { (1, i) } else { (2, j) };
        self.add(self.first + q, block, &mut out);
        self.hold(&mut out, self.first + i, self.first + j);
        out
    }
}
