//! Places on a rod. Between nodes the strain of an element is taken as constant.

use nalgebra::{Matrix3, Vector3};

use super::configuration::Configuration;
use super::mesh::Mesh;
use super::rotation::{exp, exp_tangent, log};

/// A place along an arm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Place {
    /// The base, where the arm is held.
    Base,
    /// Its free end.
    #[default]
    Tip,
    /// The arc coordinate at rest over the length, from 0 at the base to 1 at the tip. A discretization takes the nearest node.
    Fraction(f64),
}

impl Place {
    /// The place of a node.
    #[must_use]
    pub fn of_node(node: usize, mesh: &Mesh) -> Self {
        match node {
            0 => Self::Base,
            last if last == mesh.n_elements() => Self::Tip,
            _ => Self::Fraction(mesh.fraction(node)),
        }
    }

    /// Arc coordinate at rest over the length.
    #[must_use]
    pub fn fraction(self) -> f64 {
        match self {
            Self::Base => 0.0,
            Self::Tip => 1.0,
            Self::Fraction(s) => s,
        }
    }

    /// The nearest node.
    #[must_use]
    pub fn node(self, mesh: &Mesh) -> usize {
        match self {
            Self::Base => 0,
            Self::Tip => mesh.n_elements(),
            Self::Fraction(s) => mesh.nearest(s),
        }
    }
}

/// Returns the pose at the fraction `s` of element `q`.
pub fn pose(at: &Configuration, q: usize, s: f64) -> (Vector3<f64>, Matrix3<f64>) {
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

/// Returns the element at a fraction of the length, and the fraction of the element, given the [places of the nodes](crate::Rod::places).
pub fn locate(nodes: &[f64], part: f64) -> (usize, f64) {
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

/// Returns the poses at places that [`locate`] found.
pub fn carry(places: &[(usize, f64)], from: &Configuration) -> Configuration {
    let mut out = Configuration {
        positions: Vec::new(),
        rotations: Vec::new(),
    };
    carry_into(places, from, &mut out);
    out
}

/// Writes the poses at places that [`locate`] found into existing memory.
pub fn carry_into(places: &[(usize, f64)], from: &Configuration, out: &mut Configuration) {
    out.positions.clear();
    out.rotations.clear();
    for &(q, s) in places {
        let (position, rotation) = pose(from, q, s);
        out.positions.push(position);
        out.rotations.push(rotation);
    }
}
