//! Factors of a tangent stiffness.

use std::collections::BTreeMap;

use faer::linalg::solvers::Solve as _;
use faer::sparse::linalg::solvers::{Llt, Lu};
use faer::sparse::{SparseColMat, Triplet};
use faer::{Mat, Side};
use nalgebra::{DMatrix, DVector, Matrix6, Vector6};

use super::{Tangent, dot};

/// Relative error of a solution beyond which the products of winches are factored as blocks.
const WELL_SOLVED: f64 = 1e-6;

/// LU factors of a [`Tangent`].
pub struct TangentLu {
    /// Factors of the blocks.
    lu: Lu<usize, f64>,
    /// The terms of winches; `None` without any.
    added: Option<Added>,
}

/// The terms that the products `V F Vᵀ` of winches add to the inverse of the blocks `T`.
struct Added {
    /// `T⁻¹ V`
    answers: Vec<Vec<Vector6<f64>>>,
    /// `(F⁻¹ + Vᵀ T⁻¹ V)⁻¹`
    inverse: DMatrix<f64>,
    /// The whole matrix.
    matrix: Tangent,
}

impl TangentLu {
    /// Returns `K⁻¹` times each of the right-hand sides.
    pub fn solve(&self, right: &[Vec<Vector6<f64>>]) -> Vec<Vec<Vector6<f64>>> {
        let Some(added) = &self.added else {
            return self.blocks_solve(right);
        };
        let correct = |mut answers: Vec<Vec<Vector6<f64>>>| {
            for answer in &mut answers {
                let along = (added.matrix.products.iter()).map(|(_, v)| dot(v, answer));
                let sizes = &added.inverse * DVector::from_iterator(added.answers.len(), along);
                for (own, size) in added.answers.iter().zip(&sizes) {
                    for (part, own) in answer.iter_mut().zip(own) {
                        *part -= own * *size;
                    }
                }
            }
            answers
        };
        let mut answers = correct(self.blocks_solve(right));
        // One refinement: the blocks alone may be worse conditioned than the whole.
        let left: Vec<Vec<_>> = (right.iter().zip(&answers))
            .map(|(b, x)| {
                (b.iter().zip(added.matrix.times(x)))
                    .map(|(b, kx)| b - kx)
                    .collect()
            })
            .collect();
        for (answer, change) in answers.iter_mut().zip(correct(self.blocks_solve(&left))) {
            for (part, change) in answer.iter_mut().zip(change) {
                *part += change;
            }
        }
        answers
    }

    /// Returns `T⁻¹` times each of the right-hand sides, with the blocks `T`.
    fn blocks_solve(&self, right: &[Vec<Vector6<f64>>]) -> Vec<Vec<Vector6<f64>>> {
        let Some(first) = right.first() else {
            return Vec::new();
        };
        let n = first.len();
        let matrix = Mat::from_fn(6 * n, right.len(), |i, j| right[j][i / 6][i % 6]);
        let answer = self.lu.solve(&matrix);
        (0..right.len())
            .map(|j| {
                (0..n)
                    .map(|q| Vector6::from_fn(|i, _| answer[(6 * q + i, j)]))
                    .collect()
            })
            .collect()
    }
}

impl Tangent {
    /// Returns the factors of the matrix; `None` if it is singular.
    ///
    /// The products `V F Vᵀ` of winches enter by `K⁻¹ = T⁻¹ - Z (F⁻¹ + Vᵀ Z)⁻¹ Vᵀ T⁻¹` with the blocks `T` and `Z = T⁻¹ V` (Sherman,
    /// Morrison, Woodbury). Where winches alone make the matrix regular, they are factored as blocks.
    pub fn factor(&self) -> Option<TangentLu> {
        let lu = sparse(self.n_blocks, &self.blocks)?.sp_lu().ok()?;
        if self.products.is_empty() {
            return Some(TangentLu { lu, added: None });
        }
        let vectors: Vec<_> = self.products.iter().map(|(_, v)| v.clone()).collect();
        let mut out = TangentLu { lu, added: None };
        let answers = out.solve(&vectors);
        let m = vectors.len();
        let small = DMatrix::from_fn(m, m, |i, j| {
            let own = if i == j {
                self.products[i].0.recip()
            } else {
                0.0
            };
            own + dot(&vectors[i], &answers[j])
        });
        if let Some(inverse) = small.try_inverse() {
            out.added = Some(Added {
                answers,
                inverse,
                matrix: self.clone(),
            });
            let back = self.times(&out.solve(&vectors[..1])[0]);
            let off: Vec<_> = back.iter().zip(&vectors[0]).map(|(a, b)| a - b).collect();
            if dot(&off, &off) <= WELL_SOLVED * WELL_SOLVED * dot(&vectors[0], &vectors[0]) {
                return Some(out);
            }
        }
        self.in_blocks().factor()
    }
}

fn sparse(
    n_blocks: usize,
    blocks: &BTreeMap<(usize, usize), Matrix6<f64>>,
) -> Option<SparseColMat<usize, f64>> {
    let mut triplets = Vec::with_capacity(36 * blocks.len());
    for (&(row, column), block) in blocks {
        for i in 0..6 {
            for j in 0..6 {
                triplets.push(Triplet::new(6 * row + i, 6 * column + j, block[(i, j)]));
            }
        }
    }
    let n = 6 * n_blocks;
    SparseColMat::try_new_from_triplets(n, n, &triplets).ok()
}

/// Returns a shift, 0 or a power of four times `unit`, that makes a symmetric matrix positive definite, and the factor of the sum.
pub fn positive(
    n_blocks: usize,
    blocks: &BTreeMap<(usize, usize), Matrix6<f64>>,
    unit: f64,
) -> Option<(f64, Llt<usize, f64>)> {
    let mut shift = 0.0;
    // A shift beyond the largest entry cannot help.
    while shift < f64::MAX.sqrt() {
        let mut shifted = blocks.clone();
        for i in 0..n_blocks {
            *shifted.entry((i, i)).or_default() += Matrix6::from_diagonal_element(shift);
        }
        if let Ok(factor) = sparse(n_blocks, &shifted)?.sp_cholesky(Side::Lower) {
            return Some((shift, factor));
        }
        shift = if shift == 0.0 { unit } else { 4.0 * shift };
        if !shift.is_finite() {
            return None;
        }
    }
    None
}
