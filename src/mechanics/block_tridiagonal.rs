//! Cholesky factorization of symmetric block-tridiagonal matrices with 6×6 blocks, in O(K).
//!
//! Neither faer nor nalgebra has a banded type; the blocks themselves are nalgebra's.

use nalgebra::{Matrix6, Vector6};

/// Lower factor `L` of `A = L Lᵀ`: diagonal blocks and the blocks below them.
#[derive(Clone, Debug)]
pub struct BlockCholesky {
    diagonal: Vec<Matrix6<f64>>,
    below: Vec<Matrix6<f64>>,
}

impl BlockCholesky {
    /// Factors the matrix with the given diagonal blocks and blocks below the diagonal (one fewer).
    /// `None` when it is not positive definite.
    #[must_use]
    pub fn new(diagonal: &[Matrix6<f64>], below: &[Matrix6<f64>]) -> Option<Self> {
        let mut factor = Self {
            diagonal: Vec::with_capacity(diagonal.len()),
            below: Vec::with_capacity(below.len()),
        };
        for (i, block) in diagonal.iter().enumerate() {
            let mut schur = *block;
            if let Some(previous) = i.checked_sub(1) {
                // L_{i,i-1} = A_{i,i-1} L_{i-1,i-1}⁻ᵀ
                let left = factor.diagonal[previous]
                    .solve_lower_triangular(&below[previous].transpose())?
                    .transpose();
                schur -= left * left.transpose();
                factor.below.push(left);
            }
            factor.diagonal.push(schur.cholesky()?.l());
        }
        Some(factor)
    }

    /// `L⁻¹ b`, in place.
    pub fn solve_lower(&self, b: &mut [Vector6<f64>]) {
        for i in 0..b.len() {
            if i > 0 {
                let before = self.below[i - 1] * b[i - 1];
                b[i] -= before;
            }
            // The factors' diagonals are positive, so the solve always succeeds.
            self.diagonal[i].solve_lower_triangular_mut(&mut b[i]);
        }
    }

    /// `L⁻ᵀ b`, in place.
    pub fn solve_lower_transposed(&self, b: &mut [Vector6<f64>]) {
        for i in (0..b.len()).rev() {
            if i + 1 < b.len() {
                let after = self.below[i].tr_mul(&b[i + 1]);
                b[i] -= after;
            }
            self.diagonal[i].tr_solve_lower_triangular_mut(&mut b[i]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `L Lᵀ` solves reproduce a known solution of a random positive definite matrix.
    #[test]
    fn factor_solves() {
        let n = 5;
        let noise =
            |seed: f64| Matrix6::from_fn(|i, j| (seed + 1.7 * i as f64 + 0.9 * j as f64).sin());
        let below: Vec<_> = (1..n).map(|i| noise(i as f64)).collect();
        let diagonal: Vec<_> = (0..n)
            .map(|i| {
                let m = noise(0.3 * i as f64);
                m * m.transpose() + Matrix6::identity() * 12.0
            })
            .collect();
        let x: Vec<_> = (0..n)
            .map(|i| Vector6::from_fn(|j, _| (i * 6 + j) as f64))
            .collect();
        let mut b: Vec<_> = (0..n)
            .map(|i| {
                let mut sum = diagonal[i] * x[i];
                if i > 0 {
                    sum += below[i - 1] * x[i - 1];
                }
                if i + 1 < n {
                    sum += below[i].transpose() * x[i + 1];
                }
                sum
            })
            .collect();
        let factor = BlockCholesky::new(&diagonal, &below).expect("positive definite");
        factor.solve_lower(&mut b);
        factor.solve_lower_transposed(&mut b);
        for (solved, exact) in b.iter().zip(&x) {
            assert!((solved - exact).norm() < 1e-12 * 30.0);
        }
    }

    /// An indefinite matrix is refused.
    #[test]
    fn indefinite_is_refused() {
        assert!(
            BlockCholesky::new(
                &[Matrix6::identity(), -Matrix6::identity()],
                &[Matrix6::zeros()]
            )
            .is_none()
        );
    }
}
