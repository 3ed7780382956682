//! The energy of a small deviation from a motion, as a quadratic form and a norm.

use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::prelude::*;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use nalgebra::{Matrix6, Vector3, Vector6};

use super::vibration::inertia_roots;
use cosserat::block_tridiagonal::{BlockCholesky, BlockTridiagonal};
use cosserat::configuration::Configuration;
use cosserat::element::IntervalStress;
use cosserat::forms::NODE_COMPONENTS;
use cosserat::rod::Rod;

/// Number of components of a node's deviation that belong to its pose; those of its momenta follow.
const POSE: usize = NODE_COMPONENTS / 2;

/// The norm `|dx|² = dxᵀ L Lᵀ dx`: twice the energy of a deviation `(δx, ζ, δp, δπ)` of every free node, kinetic, and that of the strains
/// that it adds to the elements; on a free or pinned base also that of springs `EI/L³`, `EI/L` at node 0. Motions that joints hold have
/// none of this energy and are motions of their own. Maps of deviations can be transformed to `z
/// = Lᵀ dx`, whose Euclidean norm this is.
#[derive(Clone, Debug)]
pub struct EnergyNorm {
    /// `L` for the poses.
    poses: BlockCholesky,
    /// Diagonal of `L` for the momenta, node by node.
    momenta: Vec<Vector6<f64>>,
}

impl EnergyNorm {
    /// Returns the norm at a configuration; `None` if the energy is not positive definite.
    #[must_use]
    pub fn at(rod: &Rod, at: &Configuration) -> Option<Self> {
        let first = rod.first_free_node();
        let n_free = rod.n_nodes() - first;
        let mut diagonal = vec![Matrix6::zeros(); n_free];
        let mut below = vec![Matrix6::zeros(); n_free.saturating_sub(1)];
        let nothing = IntervalStress {
            linear: [Vector3::zeros(); 2],
            angular: Vector3::zeros(),
        };
        for (q, element) in rod.elements.iter().enumerate() {
            let pose = Rod::element_pose(q, &at.positions, &at.rotations);
            let stiffness = element.stiffness_under(rod.strain_rule, &pose, &nothing, 1.0);
            // Row and sign of a component of the element's ends in its (dx, ζ_a, ζ_b).
            let place = |end: usize, component: usize| match component.checked_sub(3) {
                None => (component, [-1.0, 1.0][end]),
                Some(axis) => (3 + 3 * end + axis, 1.0),
            };
            let block = |a: usize, b: usize| {
                Matrix6::from_fn(|i, j| {
                    let ((row, left), (column, right)) = (place(a, i), place(b, j));
                    left * right * stiffness[(row, column)]
                })
            };
            let start = q.checked_sub(first);
            diagonal[q + 1 - first] += block(1, 1);
            if let Some(start) = start {
                diagonal[start] += block(0, 0);
                below[start] += block(1, 0);
            }
        }
        if first == 0 {
            for axis in 0..3 {
                diagonal[0][(axis, axis)] += rod.scales.force / rod.scales.length;
                diagonal[0][(3 + axis, 3 + axis)] += rod.scales.moment;
            }
        }
        let mut blocks = BlockTridiagonal {
            above: below.iter().map(|block| block.transpose()).collect(),
            diagonal,
            below,
        };
        rod.hold_joints(first, &mut blocks);
        let BlockTridiagonal {
            diagonal, below, ..
        } = blocks;
        Some(Self {
            momenta: inertia_roots(rod, at),
            poses: BlockCholesky::new(&diagonal, &below)?,
        })
    }

    /// Returns `M L⁻ᵀ`: a map of deviations as a map of `z`.
    #[must_use]
    pub fn columns_over(&self, mut map: Mat<f64>) -> Mat<f64> {
        for node in 0..self.momenta.len() {
            let (before, mut own) = map.as_mut().split_at_col_mut(node * NODE_COMPONENTS);
            let mut poses = own.rb_mut().subcols_mut(0, POSE);
            if let Some(below) = node.checked_sub(1).map(|at| &self.poses.below()[at]) {
                let before = before.rb().subcols((node - 1) * NODE_COMPONENTS, POSE);
                let below = block(below).transpose();
                matmul(poses.rb_mut(), Accum::Add, before, below, -1.0, Par::Seq);
            }
            // Solves X Lᵀ = M by its transpose.
            let diagonal = block(&self.poses.diagonal()[node]);
            solve_lower_triangular_in_place(diagonal, poses.transpose_mut(), Par::Seq);
            for (i, root) in self.momenta[node].iter().enumerate() {
                let momenta = own.rb_mut().col_mut(POSE + i);
                momenta.iter_mut().for_each(|m| *m /= root);
            }
        }
        map
    }

    /// Returns `M Lᵀ`: a map of `z` as a map of deviations.
    #[must_use]
    pub fn columns_of(&self, map: &Mat<f64>) -> Mat<f64> {
        let mut transposed = map.transpose().to_owned();
        let mut own = Mat::zeros(POSE, map.nrows());
        // The rows of the node before must not have been overwritten yet.
        for node in (0..self.momenta.len()).rev() {
            let (before, here) = (transposed.as_mut()).split_at_row_mut(node * NODE_COMPONENTS);
            let diagonal = block(&self.poses.diagonal()[node]);
            let below = node.checked_sub(1).map(|at| {
                let before = before.rb().subrows(at * NODE_COMPONENTS, POSE);
                (block(&self.poses.below()[at]), before)
            });
            self.multiply(
                node,
                here.subrows_mut(0, NODE_COMPONENTS),
                diagonal,
                below,
                &mut own,
            );
        }
        transposed.transpose().to_owned()
    }

    /// Returns `Lᵀ M`: a map to deviations as a map to `z`.
    #[must_use]
    pub fn out_of(&self, mut map: Mat<f64>) -> Mat<f64> {
        let mut own = Mat::zeros(POSE, map.ncols());
        for node in 0..self.momenta.len() {
            let (here, after) = (map.as_mut()).split_at_row_mut((node + 1) * NODE_COMPONENTS);
            let here = here.subrows_mut(node * NODE_COMPONENTS, NODE_COMPONENTS);
            let diagonal = block(&self.poses.diagonal()[node]).transpose();
            let below = (self.poses.below().get(node))
                .map(|below| (block(below).transpose(), after.rb().subrows(0, POSE)));
            self.multiply(node, here, diagonal, below, &mut own);
        }
        map
    }

    /// Multiplies a node's rows by its block of the factor, or of its transpose, and adds those of a neighbor's poses by theirs; `own` is
    /// room for a copy.
    fn multiply(
        &self,
        node: usize,
        mut rows: MatMut<f64>,
        diagonal: MatRef<f64>,
        neighbor: Option<(MatRef<f64>, MatRef<f64>)>,
        own: &mut Mat<f64>,
    ) {
        let (mut poses, momenta) = rows.rb_mut().split_at_row_mut(POSE);
        own.copy_from(&poses);
        matmul(
            poses.rb_mut(),
            Accum::Replace,
            diagonal,
            &*own,
            1.0,
            Par::Seq,
        );
        if let Some((block, theirs)) = neighbor {
            matmul(poses, Accum::Add, block, theirs, 1.0, Par::Seq);
        }
        for column in momenta.col_iter_mut() {
            for (value, root) in column.iter_mut().zip(&self.momenta[node]) {
                *value *= root;
            }
        }
    }
}

fn block(matrix: &Matrix6<f64>) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(matrix.as_slice(), POSE, POSE)
}
