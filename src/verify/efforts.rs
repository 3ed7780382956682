//! Actuators on the strains, for the check: their coordinates are differentiated forward along the strains, and their stresses along the
//! pose by the check's own derivative of the strains.

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::dual;
use super::interval::{self, Nine, Strained, add_to_nodes, pose};
use crate::mechanics::{NodeWrenches, Rod, TimeGrid, TimeNode, TimeScheme, Wrench};

/// Returns the given efforts at a side of a time node with those of a control.
pub(crate) fn at_node(rod: &Rod, node: &TimeNode, control: &NodeWrenches) -> Vec<f64> {
    let mut out: Vec<f64> = (rod.actuators.iter())
        .map(|actuator| actuator.effort_at_node(node))
        .collect();
    if let Some(efforts) = control.efforts {
        for (i, &actuator) in efforts.actuators.iter().enumerate() {
            let place = efforts.places[i];
            let numbers = control.wrenches[efforts.first + place / 6].to_array();
            out[actuator] += numbers[place % 6];
        }
    }
    out
}

/// Returns the efforts of the interval from time node `k` to the next: the mean of both ends.
pub(super) fn of_interval(
    rod: &Rod,
    grid: TimeGrid,
    k: usize,
    control: [NodeWrenches; 2],
) -> Vec<f64> {
    let [start, end] = grid.clock().ends_of_step(k);
    mean(rod, [start, end], control)
}

/// Returns the mean of the efforts at the two ends of an interval.
pub(super) fn mean(rod: &Rod, ends: [TimeNode; 2], control: [NodeWrenches; 2]) -> Vec<f64> {
    let [from, to] = [0, 1].map(|end| at_node(rod, &ends[end], &control[end]));
    from.iter().zip(&to).map(|(a, b)| 0.5 * (a + b)).collect()
}

/// Returns `-Σ u ∂y/∂(v_a, v_b, κ)` of element `q`.
pub(super) fn stress(rod: &Rod, q: usize, strain: &Nine, efforts: &[f64]) -> Nine {
    let mut out = Nine::zeros();
    for point in rod.actuators.on(q) {
        out -= dual::coordinate(point, strain).1 * efforts[point.actuator];
    }
    out
}

/// Returns the derivative of [`stress`] along a change of the strain, by differences of fourth order.
pub(super) fn stress_slope(
    rod: &Rod,
    q: usize,
    strain: &Nine,
    efforts: &[f64],
    change: &Nine,
) -> Nine {
    // Strains are of order one, curvatures of the inverse of the offsets.
    const STEP: f64 = 1e-3;
    let reach = (rod.actuators.on(q).iter())
        .map(|point| point.offset[0].hypot(point.offset[1]))
        .fold(0.0, f64::max);
    let linear = change.fixed_rows::<6>(0).norm();
    let size = linear.max(change.fixed_rows::<3>(6).norm() * reach);
    if size == 0.0 {
        return Nine::zeros();
    }
    let at = |s: f64| stress(rod, q, &(strain + change * (s * STEP / size)), efforts);
    ((at(1.0) - at(-1.0)) * 8.0 - (at(2.0) - at(-2.0))) * (size / (12.0 * STEP))
}

/// Returns the matrix of [`stress_slope`].
pub(super) fn stress_tangent(
    rod: &Rod,
    q: usize,
    strain: &Nine,
    efforts: &[f64],
) -> SMatrix<f64, 9, 9> {
    let columns: [Nine; 9] = std::array::from_fn(|j| {
        let mut unit = Nine::zeros();
        unit[j] = 1.0;
        stress_slope(rod, q, strain, efforts, &unit)
    });
    SMatrix::from_columns(&columns)
}

/// Adds to every interval stress that of the actuators at the mean strain; nothing under [`TimeScheme::Explicit`].
pub(super) fn add_to_stresses(
    rod: &Rod,
    start: &[Strained],
    end: &[Strained],
    efforts: &[f64],
    stresses: &mut [Nine],
) {
    if rod.scheme == TimeScheme::Explicit || efforts.is_empty() {
        return;
    }
    for (q, total) in stresses.iter_mut().enumerate() {
        *total += stress(rod, q, &((start[q].0 + end[q].0) * 0.5), efforts);
    }
}

/// Adds the forces of the actuators at a time node of [`TimeScheme::Explicit`] to those on the nodes.
pub(super) fn add_at_node(
    rod: &Rod,
    x: &[Vector3<f64>],
    r: &[Matrix3<f64>],
    efforts: &[f64],
    out: &mut [Wrench],
) {
    if rod.scheme == TimeScheme::Implicit || efforts.iter().all(|effort| *effort == 0.0) {
        return;
    }
    let mut gradient = [
        vec![Vector3::zeros(); x.len()],
        vec![Vector3::zeros(); x.len()],
    ];
    for q in 0..rod.n_elements() {
        let covector = gradient_of(rod, q, x, r, efforts);
        let [gx, geta] = &mut gradient;
        add_to_nodes(q, -1.0, &covector, gx, geta);
    }
    let [gx, geta] = gradient;
    for (wrench, (force, moment)) in out.iter_mut().zip(gx.iter().zip(&geta)) {
        wrench.force += force;
        wrench.moment += moment;
    }
}

/// Returns the gradient of `-Σ u y` of element `q` along `(δx_b - δx_a, η_a, η_b)`.
pub(super) fn gradient_of(
    rod: &Rod,
    q: usize,
    x: &[Vector3<f64>],
    r: &[Matrix3<f64>],
    efforts: &[f64],
) -> Nine {
    if rod.actuators.on(q).is_empty() {
        return Nine::zeros();
    }
    let (strain, b) = dual::strain(rod.elements[q].length, rod.strain_rule, &pose(x, r, q));
    b.tr_mul(&stress(rod, q, &strain, efforts))
}

/// Returns the coordinates of all actuators in a configuration.
pub(crate) fn coordinates(rod: &Rod, x: &[Vector3<f64>], r: &[Matrix3<f64>]) -> Vec<f64> {
    let mut out = vec![0.0; rod.actuators.len()];
    if out.is_empty() {
        return out;
    }
    for (q, (strain, _)) in interval::strains(rod, x, r).iter().enumerate() {
        for point in rod.actuators.on(q) {
            out[point.actuator] += dual::coordinate(point, strain).0;
        }
    }
    out
}
