//! Linear combinations of the rows of a tile.

use pulp::{Simd, WithSimd};

use super::TILE;
use crate::mechanics::forms::NODE_COMPONENTS;

/// The sum of six rows of every node, from the row `part` of each on, with the given coefficients, for all columns of a tile.
pub(super) struct Combined<'a> {
    pub data: &'a [f64],
    pub part: usize,
    /// Six coefficients of every node.
    pub coefficients: &'a [f64],
}

impl WithSimd for Combined<'_> {
    type Output = [f64; TILE];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> [f64; TILE] {
        let mut out = [0.0; TILE];
        let (sums, _) = S::as_mut_simd_f64s(&mut out);
        let nodes = self.data.chunks_exact(NODE_COMPONENTS * TILE);
        for (node, coefficients) in nodes.zip(self.coefficients.chunks_exact(6)) {
            let (rows, _) = S::as_simd_f64s(&node[self.part * TILE..][..6 * TILE]);
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
