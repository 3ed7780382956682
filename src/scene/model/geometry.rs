//! Orientations and bounds as they stand in a scene.

use nalgebra::Matrix3;

use crate::mechanics::rotation::quaternion;

/// The quaternion of a rotation, scalar first.
pub(in crate::scene) fn wxyz(rotation: &Matrix3<f64>) -> [f64; 4] {
    let q = quaternion(rotation);
    [q.w, q.i, q.j, q.k]
}
