//! The efforts and coordinates of the actuators in an arm along a motion.

use nalgebra::{Matrix3, Vector3};

use crate::mechanics::{Configuration, Rod};
use crate::output::{EffortRow, MotionRecord};

/// Returns the rows of `efforts.csv` for a recorded motion; `efforts` gives those of all actuators in a row of the record.
pub(crate) fn effort_rows(
    rod: &Rod,
    record: &MotionRecord,
    efforts: impl Fn(usize) -> Vec<f64>,
) -> Vec<EffortRow> {
    let n = record.n_nodes;
    let mut out = Vec::with_capacity(record.n_rows() * rod.actuators.len());
    for k in 0..record.n_rows() {
        let positions: Vec<Vector3<f64>> = (record.x[3 * n * k..][..3 * n].chunks_exact(3))
            .map(Vector3::from_column_slice)
            .collect();
        let rotations: Vec<Matrix3<f64>> = (record.rotation[9 * n * k..][..9 * n].chunks_exact(9))
            .map(Matrix3::from_row_slice)
            .collect();
        let shape = Configuration {
            positions,
            rotations,
        };
        out.extend(efforts_at(rod, record.t[k], &shape, &efforts(k)));
    }
    out
}

/// Returns the rows of `efforts.csv` for one shape at time `t` (s), under the efforts of all actuators.
pub(crate) fn efforts_at(
    rod: &Rod,
    t: f64,
    shape: &Configuration,
    efforts: &[f64],
) -> Vec<EffortRow> {
    let of = |shape: &Configuration| rod.actuator_coordinates(&shape.positions, &shape.rotations);
    let coordinates = of(shape).into_iter().zip(of(&rod.rest));
    (rod.actuators.iter().zip(efforts).zip(coordinates))
        .map(|((actuator, effort), (y, at_rest))| EffortRow {
            t,
            name: actuator.name.clone(),
            effort: *effort,
            coordinate: y - at_rest,
        })
        .collect()
}
