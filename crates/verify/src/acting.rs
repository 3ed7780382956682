//! Another evaluation of user-defined actuators: only their wrenches are used, and differences of these replace the derivatives that the
//! actuators provide.

use nalgebra::Vector3;

use super::limits::slope_at_zero;
use mechanics::rotation::exp;
use mechanics::{Actuator, StateView, Wrench};

/// Shift in differences along positions, in lengths of the rod, and along controls, in their scales; turn along rotations, rad.
const SHIFT: f64 = 1e-3;

/// Returns nodes and wrenches under the controls `u`.
pub(super) fn wrenches(actuator: &dyn Actuator, at: &StateView, u: &[f64]) -> Vec<(usize, Wrench)> {
    let nodes = actuator.nodes(at.rod);
    let mut out = vec![Wrench::default(); nodes.len()];
    actuator.wrench(at, u, &mut out);
    nodes.into_iter().zip(out).collect()
}

/// Returns `Σ λ·w` over the nodes, for covectors of force and moment of every node of the rod.
fn paired(
    actuator: &dyn Actuator,
    at: &StateView,
    u: &[f64],
    [lx, lr]: [&[Vector3<f64>]; 2],
) -> f64 {
    (wrenches(actuator, at, u).iter())
        .map(|(node, wrench)| lx[*node].dot(&wrench.force) + lr[*node].dot(&wrench.moment))
        .sum()
}

/// Adds `weight` times the slope of [`paired`] along every position and rotation.
pub(super) fn add_slopes(
    actuator: &dyn Actuator,
    at: &StateView,
    u: &[f64],
    weight: f64,
    covectors: [&[Vector3<f64>]; 2],
    [cx, ceta]: [&mut [Vector3<f64>]; 2],
) {
    let length = at.rod.scales.length;
    for node in actuator.nodes(at.rod) {
        for axis in 0..3 {
            let shifted = |s: f64| {
                let mut positions = at.positions.to_vec();
                positions[node][axis] += s * length;
                let there = StateView {
                    positions: &positions,
                    ..*at
                };
                paired(actuator, &there, u, covectors)
            };
            cx[node][axis] += weight * slope_at_zero(shifted, SHIFT) / length;
            let turned = |angle: f64| {
                let mut rotations = at.rotations.to_vec();
                rotations[node] *= exp(&Vector3::ith(axis, angle));
                let there = StateView {
                    rotations: &rotations,
                    ..*at
                };
                paired(actuator, &there, u, covectors)
            };
            ceta[node][axis] += weight * slope_at_zero(turned, SHIFT);
        }
    }
}

/// Returns the slope of [`paired`] along a control of the given `scale`.
pub(super) fn control_slope(
    actuator: &dyn Actuator,
    at: &StateView,
    u: &[f64],
    control: usize,
    scale: f64,
    covectors: [&[Vector3<f64>]; 2],
) -> f64 {
    let moved = |s: f64| {
        let mut u = u.to_vec();
        u[control] += s * scale;
        paired(actuator, at, &u, covectors)
    };
    slope_at_zero(moved, SHIFT) / scale
}
