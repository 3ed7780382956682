//! Places between the nodes of a rod, where the strain of an element is taken as constant.

use nalgebra::{Matrix3, Vector3};

use super::configuration::Configuration;
use super::rod::Rod;
use super::rotation::{exp, exp_tangent, log};

/// Returns the pose at the fraction `s` of element `q`.
pub(crate) fn pose(at: &Configuration, q: usize, s: f64) -> (Vector3<f64>, Matrix3<f64>) {
    if s == 0.0 {
        return (at.positions[q], at.rotations[q]);
    }
    if s == 1.0 {
        return (at.positions[q + 1], at.rotations[q + 1]);
    }
    let (x, r) = (at.positions[q], at.rotations[q]);
    let psi = log(&r.tr_mul(&at.rotations[q + 1]));
    // ∫₀¹ exp(t ψ) dt is the transpose of the body-frame tangent.
    let whole = exp_tangent(&psi).transpose();
    let chord = r.tr_mul(&(at.positions[q + 1] - x));
    let strain = whole.lu().solve(&chord).unwrap_or(chord);
    let part = exp_tangent(&(psi * s)).transpose() * s;
    (x + r * (part * strain), r * exp(&(psi * s)))
}

/// Returns the arc length of every node divided by the rod's length.
pub(crate) fn node_places(rod: &Rod) -> Vec<f64> {
    let mut sum = 0.0;
    let mut ends = vec![0.0];
    for element in &rod.elements {
        sum += element.length;
        ends.push(sum);
    }
    for end in &mut ends {
        *end /= sum;
    }
    ends
}

/// Returns the element at a fraction of the length, and the fraction of the element, given the [places of the nodes](node_places).
pub(crate) fn locate(nodes: &[f64], part: f64) -> (usize, f64) {
    // A place that equals a node up to rounding is that node.
    const SAME: f64 = 1e-12;
    let q = nodes
        .partition_point(|end| *end <= part + SAME)
        .clamp(1, nodes.len() - 1)
        - 1;
    let s = (part - nodes[q]) / (nodes[q + 1] - nodes[q]);
    let s = if s < 1e-9 { 0.0 } else { s };
    (q, if s > 1.0 - 1e-9 { 1.0 } else { s })
}
