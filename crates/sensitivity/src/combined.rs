//! Linear combinations of the rows of a tile, and multiples of columns that are added to them.

use pulp::{Simd, WithSimd};

use super::TILE;
use cosserat::forms::NODE_COMPONENTS;

/// The sum of some rows of every node with the given coefficients, for all columns of a tile.
pub(super) struct Combined<'a> {
    pub data: &'a [f64],
    /// The first row of each node.
    pub part: usize,
    /// Number of rows of a node.
    pub width: usize,
    /// A coefficient for each of the rows, node by node.
    pub coefficients: &'a [f64],
}

impl<'a> Combined<'a> {
    /// The sum over the poses, six rows of every node.
    pub fn on_poses(data: &'a [f64], coefficients: &'a [f64]) -> Self {
        Self {
            data,
            part: 0,
            width: 6,
            coefficients,
        }
    }
}

impl WithSimd for Combined<'_> {
    type Output = [f64; TILE];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> [f64; TILE] {
        let mut out = [0.0; TILE];
        let (sums, _) = S::as_mut_simd_f64s(&mut out);
        let nodes = self.data.chunks_exact(NODE_COMPONENTS * TILE);
        for (node, coefficients) in nodes.zip(self.coefficients.chunks_exact(self.width)) {
            let (rows, _) = S::as_simd_f64s(&node[self.part * TILE..][..self.width * TILE]);
            for (row, coefficient) in rows.chunks_exact(sums.len()).zip(coefficients) {
                let coefficient = simd.splat_f64s(*coefficient);
                for (sum, value) in sums.iter_mut().zip(row) {
                    *sum = simd.mul_add_e_f64s(coefficient, *value, *sum);
                }
            }
        }
        out
    }
}

/// Adds to the first rows of every node the given coefficients times a factor of each column of a tile: the transpose of [`Combined`].
pub(super) struct Spread<'a> {
    pub data: &'a mut [f64],
    /// Number of rows of a node.
    pub width: usize,
    /// A coefficient for each of the rows, node by node.
    pub coefficients: &'a [f64],
    /// A number for each column.
    pub factors: &'a [f64; TILE],
}

impl<'a> Spread<'a> {
    /// Adds to the poses, six rows of every node.
    pub fn on_poses(
        data: &'a mut [f64],
        coefficients: &'a [f64],
        factors: &'a [f64; TILE],
    ) -> Self {
        Self {
            data,
            width: 6,
            coefficients,
            factors,
        }
    }
}

impl WithSimd for Spread<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (factors, _) = S::as_simd_f64s(self.factors);
        let nodes = self.data.chunks_exact_mut(NODE_COMPONENTS * TILE);
        for (node, coefficients) in nodes.zip(self.coefficients.chunks_exact(self.width)) {
            let (rows, _) = S::as_mut_simd_f64s(&mut node[..self.width * TILE]);
            for (row, coefficient) in rows.chunks_exact_mut(factors.len()).zip(coefficients) {
                let coefficient = simd.splat_f64s(*coefficient);
                for (value, factor) in row.iter_mut().zip(factors) {
                    *value = simd.mul_add_e_f64s(coefficient, *factor, *value);
                }
            }
        }
    }
}
