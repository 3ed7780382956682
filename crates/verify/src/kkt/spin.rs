//! Derivatives of the momenta of a node along its rotations.

use nalgebra::{Matrix3, Vector3};

use super::motion::{momentum_after, momentum_before};

/// Derivatives of a node's momenta over one interval along its rotations at the start and the end of the interval.
pub(super) struct Spin {
    pub(super) start_leaving: Matrix3<f64>,
    pub(super) start_arriving: Matrix3<f64>,
    pub(super) end_leaving: Matrix3<f64>,
    pub(super) end_arriving: Matrix3<f64>,
}

impl Spin {
    pub(super) fn new(
        f: &Matrix3<f64>,
        leaving: &Matrix3<f64>,
        arriving: &Matrix3<f64>,
        h: f64,
    ) -> Self {
        // η_k moves F by F η̂, η_{k-1} by -η̂ F.
        let end = |axis: Vector3<f64>| f * axis.cross_matrix();
        let start = |axis: Vector3<f64>| -axis.cross_matrix() * f;
        let before = |change: Matrix3<f64>| momentum_before(&change, arriving, h);
        let after = |change: Matrix3<f64>| momentum_after(&change, leaving, h);
        Self {
            start_leaving: columns(|axis| after(start(axis))),
            start_arriving: columns(|axis| before(start(axis))),
            end_leaving: columns(|axis| after(end(axis))),
            end_arriving: columns(|axis| before(end(axis))),
        }
    }
}

fn columns(column: impl Fn(Vector3<f64>) -> Vector3<f64>) -> Matrix3<f64> {
    Matrix3::from_columns(&[
        column(Vector3::x()),
        column(Vector3::y()),
        column(Vector3::z()),
    ])
}
