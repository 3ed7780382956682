//! The noise of unknown forces on the momenta: white in time, mostly smooth along the arm.
//!
//! A wrong load or a wrong stiffness moves an arm slowly and smoothly: its error is large in the slow modes and small in the fast ones. The
//! fast waves of a model of few elements are wrong by themselves, by less energy. Within one second unknown forces add to the momenta, in
//! the frames of the nodes, the covariance
//!
//! ```text
//! Q = 2 e (ω₁² M K⁻¹ M + ε M),     e = 3 EI/L³ σ²,     ε = 0.1
//! ```
//!
//! with the stiffness `K` and the inertia `M` at rest. A mode of frequency `ν` gains the mean energy `e ((ω₁/ν)² + ε)`. `e` is the mean
//! energy of the first bending mode of a cantilever whose tip has a standard deviation `σ`. A covariance that is the inverse of an elastic
//! operator is that of a random field as smooth as the bending of the arm (Whittle 1954; Lindgren, Rue and Lindström 2011).
//!
//! With the same energy for all modes, `Q = 2 e M`, a filter explains the noise of its sensors by fast modes, which then must be damped:
//! the bias of an extended Kalman filter whose noise is too large (Ljung 1979). With none for the fast modes, a gyroscope, which measures
//! them, misleads it.

use faer::Mat;
use nalgebra::Matrix3;

use mechanics::forms::NODE_COMPONENTS;
use mechanics::{Configuration, Rod};

use super::node_frames::{NodeFrames, POSE, leave_free_motions};
use crate::beam::frequencies;

/// `ε`: energy that every mode gains, divided by that of the first bending mode; measured (decision 49).
const ROUGH: f64 = 0.1;

/// The covariance that unknown forces add to the momenta.
#[derive(Debug)]
pub(super) struct UnknownForces {
    first_free_node: usize,
    /// `ω₁² M K⁻¹ M + ε M` in the frames of the nodes.
    covariance: Mat<f64>,
}

impl UnknownForces {
    pub fn new(model: &Rod, frames: &NodeFrames) -> Self {
        let n = frames.inertia.len();
        let [first, _] = frequencies(model);
        let squared = first.powi(2);
        let smooth = |i: usize, j: usize| {
            squared * frames.inertia[i] * frames.compliance_times_inertia[(i, j)]
        };
        // Rounding makes the triangles differ; the lower one is used.
        let mut covariance = Mat::from_fn(n, n, |i, j| {
            let rough = if i == j {
                ROUGH * frames.inertia[i]
            } else {
                0.0
            };
            smooth(i.max(j), i.min(j)) + rough
        });
        leave_free_motions(model, &mut covariance, POSE);
        Self {
            first_free_node: frames.first_free_node,
            covariance,
        }
    }

    /// Adds `2 e` times the covariance to one of all components, at a shape; the sum is exactly symmetric if that one is.
    pub fn add(&self, energy: f64, shape: &Configuration, covariance: &mut Mat<f64>) {
        let rotations = &shape.rotations[self.first_free_node..];
        for (a, left) in rotations.iter().enumerate() {
            for (b, right) in rotations.iter().enumerate() {
                for (p, q) in [(0, 0), (0, 3), (3, 0), (3, 3)] {
                    let [row, column] = [POSE * a + p, POSE * b + q];
                    if row < column {
                        continue;
                    }
                    let block = Matrix3::from_fn(|i, j| {
                        2.0 * energy * self.covariance[(row + i, column + j)]
                    });
                    let block = if p == 0 { left * block } else { block };
                    let block = if q == 0 {
                        block * right.transpose()
                    } else {
                        block
                    };
                    let row = NODE_COMPONENTS * a + POSE + p;
                    let column = NODE_COMPONENTS * b + POSE + q;
                    for j in 0..3 {
                        for i in 0..3 {
                            let (i_all, j_all) = (row + i, column + j);
                            if i_all > j_all {
                                covariance[(j_all, i_all)] += block[(i, j)];
                            }
                            if i_all >= j_all {
                                covariance[(i_all, j_all)] += block[(i, j)];
                            }
                        }
                    }
                }
            }
        }
    }
}
