//! The slow part of a change of the state.
//!
//! A wrong stiffness detunes all modes of an arm; the phases of the fast ones, which are hardly damped, become unknown within a few of
//! their periods. A filter that propagates this to first order becomes ever less certain of modes that do not matter, and excites them by
//! its own corrections. The effect of the stiffness on slow modes is enough to find it: of a change `u` of the poses and `m` of the momenta
//! only
//!
//! ```text
//! (M + θ K)⁻¹ M u     and     M (M + θ K)⁻¹ m,     θ = 1/ω²
//! ```
//!
//! are kept, that is a fraction `1/(1 + (ν/ω)²)` of a mode of frequency `ν`. `K` is the stiffness of the rod at rest, in the frames of the
//! nodes, so that it turns with the arm; `ω` is the frequency of the fifth bending mode of a cantilever.

use faer::Mat;
use faer::linalg::solvers::Solve as _;
use nalgebra::Vector3;

use mechanics::forms::NODE_COMPONENTS;
use mechanics::{Configuration, Rod};

use super::node_frames::{NodeFrames, POSE};
use crate::beam::frequencies;

/// Projects changes of a rod's state to their slow part.
#[derive(Debug)]
pub(super) struct SlowPart {
    first_free_node: usize,
    /// Maps of poses and of momenta.
    maps: [Mat<f64>; 2],
    room: Vec<f64>,
    slow: Vec<f64>,
}

impl SlowPart {
    pub fn new(model: &Rod, frames: &NodeFrames) -> Self {
        let n = frames.inertia.len();
        let moved = &frames.compliance_times_inertia;
        // (M + θ K)⁻¹ M = (K⁻¹ M + θ)⁻¹ K⁻¹ M
        let [_, fifth] = frequencies(model);
        let theta = fifth.powi(-2);
        let sum = Mat::from_fn(n, n, |i, j| {
            moved[(i, j)] + if i == j { theta } else { 0.0 }
        });
        let poses = sum.partial_piv_lu().solve(moved);
        Self {
            first_free_node: frames.first_free_node,
            maps: [poses.clone(), poses.transpose().to_owned()],
            room: vec![0.0; n],
            slow: vec![0.0; n],
        }
    }

    /// Replaces a change `(δx, ζ, δp, δπ)` of every free node by its slow part.
    pub fn leave(&mut self, shape: &Configuration, change: &mut [f64]) {
        let rotations = &shape.rotations[self.first_free_node..];
        for (part, map) in self.maps.iter().enumerate() {
            let part = POSE * part;
            for (node, rotation) in rotations.iter().enumerate() {
                let own = &change[NODE_COMPONENTS * node + part..][..POSE];
                let room = &mut self.room[POSE * node..][..POSE];
                let moved = rotation.tr_mul(&Vector3::from_column_slice(&own[..3]));
                room[..3].copy_from_slice(moved.as_slice());
                room[3..].copy_from_slice(&own[3..]);
            }
            self.slow.fill(0.0);
            for (j, value) in self.room.iter().enumerate() {
                for (sum, slope) in self.slow.iter_mut().zip(map.col_as_slice(j)) {
                    *sum += slope * value;
                }
            }
            for (node, rotation) in rotations.iter().enumerate() {
                let slow = &self.slow[POSE * node..][..POSE];
                let moved = rotation * Vector3::from_column_slice(&slow[..3]);
                let own = &mut change[NODE_COMPONENTS * node + part..][..POSE];
                own[..3].copy_from_slice(moved.as_slice());
                own[3..].copy_from_slice(&slow[3..]);
            }
        }
    }
}
