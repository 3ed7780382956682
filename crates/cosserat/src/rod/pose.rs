//! Scalar functions of the pose of a node.

use std::fmt;

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use crate::load::Wrench;
use crate::rotation::exp;

/// Position (m) and rotation (body to space) of a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Position, spatial frame, m.
    pub position: Vector3<f64>,
    /// Rotation, body to space.
    pub rotation: Matrix3<f64>,
}

impl Pose {
    /// Returns the pose moved by `(δx, ζ)` to `x + δx`, `R exp(ζ̂)`.
    #[must_use]
    pub fn moved(&self, by: &Vector6<f64>) -> Self {
        Self {
            position: self.position + by.fixed_rows::<3>(0),
            rotation: self.rotation * exp(&by.fixed_rows::<3>(3).into()),
        }
    }
}

/// A scalar function of the pose of one node, with its derivatives in the chart `(x + δx, R exp(ζ̂))`.
///
/// `softarm derivatives` and `derivatives::check` compare them with differences. The certificate uses
/// [`Self::value`] alone, so that a wrong derivative makes it reject a solution.
pub trait PoseFunction: fmt::Debug + Send + Sync {
    /// Returns the value: in the unit of energy over that of the effort, or for a potential without one in J.
    fn value(&self, at: &Pose) -> f64;

    /// Returns the derivative along `δx` as a force (spatial frame) and along `ζ` as a moment (body frame).
    fn gradient(&self, at: &Pose) -> Wrench;

    /// Returns the second derivative along `(δx, ζ)`, symmetric.
    fn hessian(&self, at: &Pose) -> Matrix6<f64>;
}
