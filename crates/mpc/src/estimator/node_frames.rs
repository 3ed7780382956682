//! Compliance and inertia of an arm at rest in the frames of its nodes, which turn with the arm.

use faer::Mat;
use nalgebra::Vector3;

use mechanics::Rod;
use mechanics::forms::NODE_COMPONENTS;

/// Number of components of a pose, and of the momenta of a node.
pub(super) const POSE: usize = 6;

/// Leaves of a symmetric matrix over the free nodes, with `size` components each, the part along motions that the ends leave free, `P A P`:
/// of a node, every six components are those of a displacement or force and of a turn or moment.
pub(super) fn leave_free_motions(rod: &Rod, matrix: &mut Mat<f64>, size: usize) {
    let n = matrix.nrows();
    for joint in &rod.joints {
        let own = size * (joint.node - rod.first_free_node());
        for first in (own..own + size).step_by(POSE) {
            for other in 0..n {
                let row = joint.turning * Vector3::from_fn(|i, _| matrix[(first + 3 + i, other)]);
                for i in 0..3 {
                    matrix[(first + i, other)] = 0.0;
                    matrix[(first + 3 + i, other)] = row[i];
                }
            }
            for other in 0..n {
                let column =
                    joint.turning * Vector3::from_fn(|i, _| matrix[(other, first + 3 + i)]);
                for i in 0..3 {
                    matrix[(other, first + i)] = 0.0;
                    matrix[(other, first + 3 + i)] = column[i];
                }
            }
        }
    }
}

/// The compliance `K⁻¹` of the free nodes about the stress-free shape, and their inertia `M`, both with respect to position and rotation of
/// each node in its own frame.
#[derive(Debug)]
pub(super) struct NodeFrames {
    pub first_free_node: usize,
    /// `K⁻¹ M`.
    pub compliance_times_inertia: Mat<f64>,
    /// Diagonal of `M`: for every node three times its mass, kg, and its rotary inertia, kg m².
    pub inertia: Vec<f64>,
}

impl NodeFrames {
    /// Computes both from `at_rest`, the inverse of the Hessian of the energy with respect to the components of the state, about the
    /// stress-free shape.
    pub fn new(model: &Rod, at_rest: &Mat<f64>) -> Self {
        let first_free_node = model.first_free_node();
        let n = POSE * (model.n_nodes() - first_free_node);
        let to_frames = Mat::from_fn(n, n, |i, j| {
            let (node, a, b) = (i / POSE, i % POSE, j % POSE);
            if node != j / POSE {
                0.0
            } else if a < 3 && b < 3 {
                model.rest.rotations[first_free_node + node][(b, a)]
            } else {
                f64::from(u8::from(a == b))
            }
        });
        let place = |i: usize| NODE_COMPONENTS * (i / POSE) + i % POSE;
        let compliance = Mat::from_fn(n, n, |i, j| at_rest[(place(i), place(j))]);
        let compliance = &to_frames * compliance * to_frames.transpose();
        let inertia: Vec<f64> = (model.nodes[first_free_node..].iter())
            .flat_map(|node| [Vector3::repeat(node.mass), node.rotary])
            .flat_map(|part| [part.x, part.y, part.z])
            .collect();
        let compliance_times_inertia = Mat::from_fn(n, n, |i, j| compliance[(i, j)] * inertia[j]);
        Self {
            first_free_node,
            compliance_times_inertia,
            inertia,
        }
    }
}
