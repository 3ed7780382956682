//! Orientations and bounds as they stand in a scene.

use nalgebra::Matrix3;

use crate::mechanics::rotation::{self, quaternion};

/// The quaternion of a rotation, scalar first.
pub(in crate::scene) fn wxyz(rotation: &Matrix3<f64>) -> [f64; 4] {
    rotation::wxyz(&quaternion(rotation))
}
