//! Factors of a chain of blocks, in lanes along the columns of a block.

use integrator::lanes::solved::chain::*;
use nalgebra::{DMatrix, DVector};

struct Dense(DMatrix<f64>);

impl ChainBlocks for Dense {
    fn diagonal(&self, i: usize) -> ChainBlock {
        self.beside(i, i)
    }

    fn beside(&self, i: usize, j: usize) -> ChainBlock {
        let mut out = ZERO;
        for (column, entries) in out.iter_mut().enumerate() {
            for (row, entry) in entries.0.iter_mut().enumerate().take(SIZE) {
                *entry = self.0[(SIZE * i + row, SIZE * j + column)];
            }
        }
        out
    }
}

/// Chains of every length up to eight reproduce a known solution of a matrix without symmetry, whose diagonal outweighs the
/// rest: what is left is rounding of some thousand products.
#[test]
fn chains_solve() {
    for n in 1..=8 {
        let matrix = DMatrix::from_fn(SIZE * n, SIZE * n, |i, j| {
            let noise = (0.7 + 2.3 * i as f64 - 1.1 * j as f64).sin();
            match (i / SIZE).abs_diff(j / SIZE) {
                0 if i == j => 9.0 + noise,
                0 | 1 => noise,
                _ => 0.0,
            }
        });
        let solution = DVector::from_fn(SIZE * n, |i, _| (0.4 * i as f64).cos());
        let right = &matrix * &solution;
        let mut chain = Chain::new(n);
        chain.factor(&Dense(matrix));
        for _ in 0..2 {
            for (i, column) in chain.columns.iter_mut().enumerate() {
                column.0[..SIZE].copy_from_slice(&right.as_slice()[SIZE * i..][..SIZE]);
            }
            chain.solve();
            for (i, column) in chain.columns.iter().enumerate() {
                for (row, x) in column.0.iter().enumerate().take(SIZE) {
                    assert!((x - solution[SIZE * i + row]).abs() < 1e-13, "{n}");
                }
            }
        }
    }
}
