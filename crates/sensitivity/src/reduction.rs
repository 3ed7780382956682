//! The second derivative of the Lagrangian, reduced to the control columns: `Σ_k Z_kᵀ Q_k Z_k`.

use std::ops::Range;

use faer::Mat;
use pulp::{Arch, Simd, WithSimd};

use super::step::StepCurvature;
use super::{BATCH, TILE};
use crate::curvature::{OwnCurvature, own_within};
use cosserat::buffer::Buffer;
use cosserat::forms::NODE_COMPONENTS;

/// Rows of a tile at one round of time nodes, stored for the curvature.
///
/// A slot holds the rows `ζ_0, dx_0, ζ_1, dx_1, … ζ_K` of one time node, so that an element's nine are consecutive.
pub(super) struct Record<'a> {
    n_rows: usize,
    /// Slots `-1..=n`: the last time node of the round before, the `n` of this round, the first of the next.
    rows: Buffer,
    /// `Q z` for the time nodes of this round.
    product: Buffer,
    own: &'a [OwnCurvature],
    /// The rows that own curvatures of this round take, one after the other, and their products.
    own_rows: Vec<f64>,
    own_product: Vec<f64>,
    /// Ends of those of each time node of the round.
    own_ends: Vec<usize>,
    /// Products of the present rows with the earlier parts of the forms of the next time node, form by form.
    earlier: Vec<f64>,
    /// Tells whether any column of the tile has begun to act.
    active: bool,
}

impl<'a> Record<'a> {
    pub fn new(n_nodes: usize, round: usize, own: &'a [OwnCurvature]) -> Self {
        let n_rows = 6 * n_nodes - 3;
        Self {
            n_rows,
            rows: Buffer::zeros((round + 2) * n_rows * TILE),
            product: Buffer::zeros(round * n_rows * TILE),
            own,
            own_rows: Vec::new(),
            own_product: Vec::new(),
            own_ends: Vec::new(),
            earlier: Vec::new(),
            active: false,
        }
    }

    /// Begins a round.
    pub fn start(&mut self, active: bool) {
        self.active = active;
        self.own_rows.clear();
        self.own_product.clear();
        self.own_ends.clear();
        if !active {
            self.earlier.clear();
        }
    }

    /// Stores the rows of the tile that the own curvatures of time node `k` read, and their products.
    pub fn keep_own(&mut self, data: &[f64], k: usize) {
        let of = |(node, component): &(usize, usize)| {
            let row = (node * NODE_COMPONENTS + component) * TILE;
            &data[row..row + TILE]
        };
        let sum = |own: &OwnCurvature, form: &[f64]| {
            let mut sums = [0.0; TILE];
            for (row, coefficient) in own.rows.iter().zip(form) {
                for (sum, value) in sums.iter_mut().zip(of(row)) {
                    *sum += coefficient * value;
                }
            }
            sums
        };
        // Absent where all columns were zero at the time node before.
        let mut earlier = self.earlier.as_chunks::<TILE>().0.iter();
        for own in own_within(self.own, k..k + 1) {
            let start = self.own_rows.len();
            if own.forms.is_empty() {
                (own.rows.iter()).for_each(|row| self.own_rows.extend_from_slice(of(row)));
            }
            for (index, form) in own.forms.iter().enumerate() {
                let mut sums = sum(own, form);
                if index < own.earlier.len()
                    && let Some(before) = earlier.next()
                {
                    (sums.iter_mut().zip(before)).for_each(|(sum, before)| *sum += before);
                }
                self.own_rows.extend_from_slice(&sums);
            }
            let rows = &self.own_rows[start..];
            for i in 0..own.matrix.nrows() {
                let at = self.own_product.len();
                self.own_product.resize(at + TILE, 0.0);
                for (j, row) in rows.chunks(TILE).enumerate() {
                    let factor = own.matrix[(i, j)];
                    for (sum, value) in self.own_product[at..].iter_mut().zip(row) {
                        *sum += factor * value;
                    }
                }
            }
        }
        self.own_ends.push(self.own_rows.len());
        self.earlier.clear();
        for own in own_within(self.own, k + 1..k + 2) {
            for form in &own.earlier {
                self.earlier.extend_from_slice(&sum(own, form));
            }
        }
    }

    /// Place of the own rows of a batch of slots.
    fn own_batch(&self, batch: usize) -> Range<usize> {
        let end = |slot: usize| self.own_ends.get(slot.wrapping_sub(1)).copied();
        let last = self.own_rows.len();
        end(batch * BATCH).unwrap_or(0)..end((batch + 1) * BATCH).unwrap_or(last)
    }

    /// Records the present rows of the tile in a slot.
    pub fn keep(&mut self, arch: Arch, data: &[f64], slot: usize) {
        let size = self.n_rows * TILE;
        arch.dispatch(Keep {
            data,
            rows: &mut self.rows[(slot + 1) * size..][..size],
        });
    }

    /// `Q z` of a slot whose two neighbors are filled; returns the number of operations.
    pub fn multiply(&mut self, arch: Arch, curvature: &StepCurvature, slot: usize) -> u64 {
        let size = self.n_rows * TILE;
        arch.dispatch(Multiply {
            curvature,
            rows: &self.rows[slot * size..][..3 * size],
            product: &mut self.product[slot * size..][..size],
        });
        let products = curvature.elements.len() + 2 * curvature.stresses.len();
        (TILE * (products * 162 + curvature.couplings.len() * 36)) as u64
    }

    /// Makes the last of `n_steps` slots the one before the next round.
    pub fn carry(&mut self, n_steps: usize) {
        let size = self.n_rows * TILE;
        self.rows
            .copy_within(n_steps * size..(n_steps + 1) * size, 0);
    }
}

/// Copies `ζ` and the differences of `δx` into a slot of a `Record`.
pub struct Keep<'a> {
    pub data: &'a [f64],
    pub rows: &'a mut [f64],
}

impl WithSimd for Keep<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (data, _) = S::as_simd_f64s(self.data);
        let (rows, _) = S::as_mut_simd_f64s(self.rows);
        let width = TILE / S::F64_LANES;
        let third = 3 * width;
        let mut nodes = data.chunks_exact(4 * third).peekable();
        let mut targets = rows.chunks_mut(2 * third);
        while let (Some(node), Some(target)) = (nodes.next(), targets.next()) {
            let (zeta, dx) = target.split_at_mut(third);
            for (zeta, value) in zeta.iter_mut().zip(&node[third..]) {
                *zeta = *value;
            }
            if let Some(next) = nodes.peek() {
                for ((dx, x), x_next) in dx.iter_mut().zip(node).zip(*next) {
                    *dx = simd.sub_f64s(*x_next, *x);
                }
            }
        }
    }
}

/// `Q z` at one time node, for all columns of a tile.
pub struct Multiply<'a> {
    pub curvature: &'a StepCurvature,
    /// Three slots: the time node before, this one, the next.
    pub rows: &'a [f64],
    pub product: &'a mut [f64],
}

impl WithSimd for Multiply<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (rows, _) = S::as_simd_f64s(self.rows);
        let (product, _) = S::as_mut_simd_f64s(self.product);
        let width = TILE / S::F64_LANES;
        let size = product.len();
        let (last, rest) = rows.split_at(size);
        let (here, next) = rest.split_at(size);
        for (q, couplings) in self.curvature.couplings.iter().enumerate() {
            let range = 6 * q * width..(6 * q + 3) * width;
            let (last, next) = (&last[range.clone()], &next[range.clone()]);
            let product = &mut product[range];
            for at in 0..width {
                for i in 0..3 {
                    let mut sum = simd.splat_f64s(0.0);
                    for j in 0..3 {
                        let coefficient = simd.splat_f64s(couplings[0][i][j]);
                        sum = simd.mul_add_e_f64s(coefficient, last[j * width + at], sum);
                        let coefficient = simd.splat_f64s(couplings[1][i][j]);
                        sum = simd.mul_add_e_f64s(coefficient, next[j * width + at], sum);
                    }
                    product[i * width + at] = sum;
                }
            }
        }
        // The rows of ζ hold the couplings and the element before; those of dx belong to this element alone.
        for (q, element) in self.curvature.elements.iter().enumerate() {
            let range = 6 * q * width..(6 * q + 9) * width;
            product[range.start + 3 * width..range.start + 6 * width].fill(simd.splat_f64s(0.0));
            multiply_element(
                simd,
                element,
                &here[range.clone()],
                &mut product[range],
                width,
            );
        }
        for (q, stresses) in self.curvature.stresses.iter().enumerate() {
            let range = 6 * q * width..(6 * q + 9) * width;
            for (stress, rows) in stresses.iter().zip([last, next]) {
                let (rows, product) = (&rows[range.clone()], &mut product[range.clone()]);
                multiply_element(simd, stress, rows, product, width);
            }
        }
    }
}

/// Adds a 9×9 matrix times nine rows to `product`.
#[inline(always)]
fn multiply_element<S: Simd>(
    simd: S,
    element: &[[f64; 9]; 9],
    here: &[S::f64s],
    product: &mut [S::f64s],
    width: usize,
) {
    let mut at = 0;
    while at + 2 <= width {
        multiply_vectors::<S, 2>(simd, element, here, product, at, width);
        at += 2;
    }
    if at < width {
        multiply_vectors::<S, 1>(simd, element, here, product, at, width);
    }
}

#[inline(always)]
fn multiply_vectors<S: Simd, const V: usize>(
    simd: S,
    element: &[[f64; 9]; 9],
    here: &[S::f64s],
    product: &mut [S::f64s],
    at: usize,
    width: usize,
) {
    let zero = simd.splat_f64s(0.0);
    let mut input = [[zero; V]; 9];
    for (i, input) in input.iter_mut().enumerate() {
        input.copy_from_slice(&here[i * width + at..][..V]);
    }
    for (i, row) in element.iter().enumerate() {
        let target = &mut product[i * width + at..][..V];
        let mut sum = [zero; V];
        sum.copy_from_slice(target);
        for (coefficient, input) in row.iter().zip(&input) {
            let coefficient = simd.splat_f64s(*coefficient);
            for v in 0..V {
                sum[v] = simd.mul_add_e_f64s(coefficient, input[v], sum[v]);
            }
        }
        target.copy_from_slice(&sum);
    }
}

/// The block of `H` that belongs to two tiles, `left <= right`; row by row.
pub(super) struct Block {
    left: usize,
    right: usize,
    data: Buffer,
    flops: u64,
}

impl Block {
    pub fn new(left: usize, right: usize) -> Self {
        Self {
            left,
            right,
            data: Buffer::zeros(TILE * TILE),
            flops: 0,
        }
    }

    pub fn flops(&self) -> u64 {
        self.flops
    }

    /// Adds `Zᵀ Q Z` of one round of `n_steps` time nodes that its tiles have recorded.
    pub fn add(&mut self, arch: Arch, left: &Record, right: &Record, n_steps: usize) {
        if !(left.active && right.active) {
            return;
        }
        let size = left.n_rows * TILE;
        let rows = left.rows[size..(n_steps + 1) * size].chunks(BATCH * size);
        let products = right.product[..n_steps * size].chunks(BATCH * size);
        // Batch by batch, whatever the length of the round: the sum does not depend on it.
        for (batch, (rows, products)) in rows.zip(products).enumerate() {
            arch.dispatch(Contract {
                rows,
                products,
                block: &mut self.data,
            });
            let own = left.own_batch(batch);
            if !own.is_empty() {
                arch.dispatch(Contract {
                    rows: &left.own_rows[own.clone()],
                    products: &right.own_product[own],
                    block: &mut self.data,
                });
            }
        }
        self.flops += (2 * TILE * (size * n_steps + left.own_rows.len())) as u64;
    }
}

/// `block += rowsᵀ products`, a product of tall matrices of [`TILE`] columns each.
pub struct Contract<'a> {
    pub rows: &'a [f64],
    pub products: &'a [f64],
    pub block: &'a mut [f64],
}

impl WithSimd for Contract<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // Accumulators are two vectors wide and as many rows high as the registers hold: 16 of 32, or 8 of 16.
        if S::F64_LANES == 8 {
            contract::<S, 8, 2>(simd, self);
        } else if S::F64_LANES > 1 {
            contract::<S, 4, 2>(simd, self);
        } else {
            contract::<S, 2, 4>(simd, self);
        }
    }
}

#[inline(always)]
fn contract<S: Simd, const R: usize, const V: usize>(simd: S, task: Contract) {
    let (products, _) = S::as_simd_f64s(task.products);
    let (block, _) = S::as_mut_simd_f64s(task.block);
    let products = products.as_chunks::<V>().0;
    let rows = task.rows.as_chunks::<R>().0;
    let width = TILE / S::F64_LANES;
    for i0 in 0..TILE / R {
        for v0 in 0..width / V {
            let mut sums = [[simd.splat_f64s(0.0); V]; R];
            for (i, sums) in sums.iter_mut().enumerate() {
                sums.copy_from_slice(&block[(i0 * R + i) * width + v0 * V..][..V]);
            }
            let factors = rows.iter().skip(i0).step_by(TILE / R);
            let products = products.iter().skip(v0).step_by(width / V);
            for (factors, products) in factors.zip(products) {
                for i in 0..R {
                    let factor = simd.splat_f64s(factors[i]);
                    for v in 0..V {
                        sums[i][v] = simd.mul_add_e_f64s(factor, products[v], sums[i][v]);
                    }
                }
            }
            for (i, sums) in sums.iter().enumerate() {
                block[(i0 * R + i) * width + v0 * V..][..V].copy_from_slice(sums);
            }
        }
    }
}

/// All blocks of `H`, exactly symmetric.
pub(super) fn assemble(blocks: &[Block], n_all: usize) -> Mat<f64> {
    let mut all = Mat::zeros(n_all, n_all);
    for block in blocks {
        for i in 0..TILE {
            for j in 0..TILE {
                let (row, column) = (block.left * TILE + i, block.right * TILE + j);
                if row >= n_all || column >= n_all {
                    continue;
                }
                let mut value = block.data[i * TILE + j];
                if block.left == block.right {
                    value = 0.5 * (value + block.data[j * TILE + i]);
                }
                all[(row, column)] = value;
                all[(column, row)] = value;
            }
        }
    }
    all
}
