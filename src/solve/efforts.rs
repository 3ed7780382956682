//! The efforts and coordinates of the actuators in an arm along a recorded motion.

use nalgebra::{Matrix3, Vector3};

use crate::mechanics::Rod;
use crate::output::{EffortRow, MotionRecord};

/// Returns the rows of `efforts.csv` for a recorded motion; `efforts` gives those of all actuators in a row of the record.
pub(crate) fn effort_rows(
    rod: &Rod,
    record: &MotionRecord,
    efforts: impl Fn(usize) -> Vec<f64>,
) -> Vec<EffortRow> {
    let rest = rod.actuator_coordinates(&rod.rest.positions, &rod.rest.rotations);
    let n = record.n_nodes;
    let mut out = Vec::with_capacity(record.n_rows() * rest.len());
    for k in 0..record.n_rows() {
        let positions: Vec<Vector3<f64>> = (record.x[3 * n * k..][..3 * n].chunks_exact(3))
            .map(Vector3::from_column_slice)
            .collect();
        let rotations: Vec<Matrix3<f64>> = (record.rotation[9 * n * k..][..9 * n].chunks_exact(9))
            .map(Matrix3::from_row_slice)
            .collect();
        let coordinates = rod.actuator_coordinates(&positions, &rotations);
        let parts = rod.actuators.iter().zip(efforts(k));
        for ((actuator, effort), (y, at_rest)) in parts.zip(coordinates.iter().zip(&rest)) {
            out.push(EffortRow {
                t: record.t[k],
                name: actuator.name.clone(),
                effort,
                coordinate: y - at_rest,
            });
        }
    }
    out
}
