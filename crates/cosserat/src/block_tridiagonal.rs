//! Factorizations of block-tridiagonal matrices with 6×6 blocks, in O(K): Cholesky of symmetric ones, LU of others.
//!
//! `L U` with pivots by blocks and their quarters is the recursion `P_i = (A_ii - A_{i,i-1} U_{i-1})⁻¹`, `U_i = P_i A_{i,i+1}`. It stands
//! here for one matrix ([`BlockTridiagonal::factor`]), and in the linearization of steps that are solved for for one matrix in each lane of
//! a vector, which writes the factors of consecutive time nodes to the steps as it goes (`sensitivity/linearize/solved.rs`); both invert
//! their pivots here. The steps themselves (`lanes/solved/chain.rs`) have but one matrix at a time, and eliminate it from both ends with the lanes along
//! the columns of a block, because a recursion from one end would wait for every operation of its own; there, blocks have no quarters.
//!
//! Neither faer nor nalgebra has a banded type, and a general sparse LU spends most of its time on the bookkeeping of a
//! pattern that is known here; the blocks themselves are nalgebra's.

use nalgebra::{Matrix6, Vector6};
use pulp::{Scalar, Simd};

use crate::element::ElementStiffness;
use crate::vector::Mat3;

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

    /// Diagonal blocks of `L`.
    pub fn diagonal(&self) -> &[Matrix6<f64>] {
        &self.diagonal
    }

    /// Blocks of `L` below the diagonal.
    pub fn below(&self) -> &[Matrix6<f64>] {
        &self.below
    }
}

/// A block-tridiagonal matrix: `diagonal[i] = A_ii`, `below[i] = A_{i+1,i}`, `above[i] = A_{i,i+1}`.
#[derive(Clone, Debug)]
pub struct BlockTridiagonal {
    /// Diagonal blocks.
    pub diagonal: Vec<Matrix6<f64>>,
    /// Blocks below the diagonal, one fewer.
    pub below: Vec<Matrix6<f64>>,
    /// Blocks above the diagonal, one fewer.
    pub above: Vec<Matrix6<f64>>,
}

impl BlockTridiagonal {
    /// The zero matrix of `n_blocks` block rows.
    #[must_use]
    pub fn zeros(n_blocks: usize) -> Self {
        let off_diagonal = vec![Matrix6::zeros(); n_blocks.saturating_sub(1)];
        Self {
            diagonal: vec![Matrix6::zeros(); n_blocks],
            below: off_diagonal.clone(),
            above: off_diagonal,
        }
    }

    /// Adds a matrix over `(x_b - x_a, η_a, η_b)` of element `q` to the rows and columns `(x, η)` of its nodes; block `0` is node `first`,
    /// and entries of nodes before it are left out.
    pub fn add_element(&mut self, first: usize, q: usize, k: &ElementStiffness) {
        for (row_end, column_end) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            if q + row_end.min(column_end) < first {
                continue;
            }
            let at = q + row_end.min(column_end) - first;
            let block = match (row_end, column_end) {
                (0, 1) => &mut self.above[at],
                (1, 0) => &mut self.below[at],
                _ => &mut self.diagonal[at],
            };
            // Node a moves the chord by -δx, node b by δx.
            let sign = |end: usize| if end == 0 { -1.0 } else { 1.0 };
            for (i, row) in [(0, 0), (3, 3 + 3 * row_end)] {
                for (j, column) in [(0, 0), (3, 3 + 3 * column_end)] {
                    let mut factor = 1.0;
                    if row == 0 {
                        factor *= sign(row_end);
                    }
                    if column == 0 {
                        factor *= sign(column_end);
                    }
                    let mut part = block.fixed_view_mut::<3, 3>(i, j);
                    part += k.fixed_view::<3, 3>(row, column) * factor;
                }
            }
        }
    }

    /// `A = L U` with `U` of unit diagonal blocks; the pivots are the diagonal blocks and their quarters, which is stable where
    /// these dominate, as those of an inertia plus a stiffness do. `None` when a pivot block is singular.
    #[must_use]
    pub fn factor(mut self) -> Option<BlockLu> {
        for i in 0..self.diagonal.len() {
            if let Some(previous) = i.checked_sub(1) {
                let fill = self.below[previous] * self.above[previous];
                self.diagonal[i] -= fill;
            }
            let mut pivot = square_of(&self.diagonal[i]);
            invert(&mut pivot);
            self.diagonal[i] = matrix_of(&pivot);
            if !self.diagonal[i].iter().all(|entry| entry.is_finite()) {
                return None;
            }
            if let Some(above) = self.above.get_mut(i) {
                *above = self.diagonal[i] * *above;
            }
        }
        Some(BlockLu { factors: self })
    }
}

/// A 6×6 matrix per lane, over motion and rotation of a node, in quarters.
pub type Square<S> = [[Mat3<S>; 2]; 2];

/// `-M`, in place.
#[inline(always)]
pub fn negate<S: Simd>(m: &mut Square<S>) {
    for i in 0..2 {
        for j in 0..2 {
            m[i][j] = -m[i][j];
        }
    }
}

/// `A B`
#[inline(always)]
pub fn multiply<S: Simd>(a: &Square<S>, b: &Square<S>, out: &mut Square<S>) {
    for i in 0..2 {
        for j in 0..2 {
            out[i][j] = a[i][0].product(b[0][j]) + a[i][1].product(b[1][j]);
        }
    }
}

/// Inverts a matrix whose upper left quarter is regular as well, by quarters. If one of the two pivots is singular, the result has entries
/// that are no numbers.
#[inline(always)]
pub fn invert<S: Simd>(m: &mut Square<S>) {
    let first = m[0][0].inverse();
    let first_right = first.product(m[0][1]);
    let below_first = m[1][0].product(first);
    let second = (m[1][1] - m[1][0].product(first_right)).inverse();
    let corner = -first_right.product(second);
    m[0][0] = first - corner.product(below_first);
    m[0][1] = corner;
    m[1][0] = -second.product(below_first);
    m[1][1] = second;
}

fn square_of(matrix: &Matrix6<f64>) -> Square<Scalar> {
    let quarter = |i: usize, j: usize| matrix.fixed_view::<3, 3>(3 * i, 3 * j).into_owned();
    [0, 1].map(|i| [0, 1].map(|j| Mat3::of_matrix(&quarter(i, j))))
}

fn matrix_of(square: &Square<Scalar>) -> Matrix6<f64> {
    let quarters = square.map(|row| row.map(Mat3::matrix));
    Matrix6::from_fn(|i, j| quarters[i / 3][j / 3][(i % 3, j % 3)])
}

/// Factors of a [`BlockTridiagonal`].
#[derive(Clone, Debug)]
pub struct BlockLu {
    /// Inverses of the pivot blocks, the blocks of `L` below them, and the blocks of `U` above its unit diagonal.
    factors: BlockTridiagonal,
}

impl BlockLu {
    /// `A⁻¹ b`, in place.
    pub fn solve(&self, b: &mut [Vector6<f64>]) {
        let BlockTridiagonal {
            diagonal,
            below,
            above,
        } = &self.factors;
        for i in 0..b.len() {
            if i > 0 {
                let before = below[i - 1] * b[i - 1];
                b[i] -= before;
            }
            b[i] = diagonal[i] * b[i];
        }
        for i in (1..b.len()).rev() {
            let after = above[i - 1] * b[i];
            b[i - 1] -= after;
        }
    }
}
