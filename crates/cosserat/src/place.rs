//! Places on a rod. Between nodes the strain of an element is taken as constant.

use nalgebra::{Matrix3, Vector3};
use pulp::Scalar;

use super::configuration::Configuration;
use super::element::helical::HelicalChart;
use super::element::tangent_derivative;
use super::mesh::Mesh;
use super::rod::Rod;
use super::rotation::{exp, exp_tangent, hat, log};
use super::vector::Mat3;

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

/// Derivatives of the [`pose`] at a fraction `s` of an element along the motions `(δx, ζ)` of its ends, spatial and body frame.
///
/// With the strains `ψ` and `w` of the helix through the ends, their [chart](HelicalChart) in `z = R_aᵀ (δx_b - δx_a)`, and the spatial tangent
/// `M(v)` and the body-frame tangent `T(v)` of `exp`,
///
/// ```text
/// x(s) = x_a + s R_a z_s,  z_s = M(sψ) w    δx(s) = δx_a - s R_a ẑ_s ζ_a + s R_a M(sψ) (δw - s G(sψ, z_s) δψ),   G(v, z) = ∂(S(v) z)/∂v
/// R(s) = R_a exp(sψ)                        ζ(s)  = exp(sψ)ᵀ ζ_a + s T(sψ) δψ
/// ```
pub struct PoseSlopes {
    rotation_a: Matrix3<f64>,
    psi: Vector3<f64>,
    chart: HelicalChart<Scalar>,
}

impl PoseSlopes {
    /// Returns those of element `q`.
    pub fn at(at: &Configuration, q: usize) -> Self {
        let (chart, psi) = HelicalChart::of(&Rod::element_pose(q, &at.positions, &at.rotations));
        Self {
            rotation_a: at.rotations[q],
            psi,
            chart,
        }
    }

    /// Returns the derivatives of the position along `δx_b - δx_a`, `ζ_a` and `ζ_b`; that along `δx_a` at constant difference is one.
    pub fn position(&self, s: f64) -> [Matrix3<f64>; 3] {
        let HelicalChart { y, s: tangent, g } = self.chart;
        let turn = self.psi * s;
        let spread = exp_tangent(&-turn);
        let z = spread * tangent.apply(y).vector();
        let along_turn = g.matrix() - tangent_derivative(&turn, &z, -1.0) * s;
        // Derivatives of w less s G(sψ, z_s) δψ.
        let less = HelicalChart {
            g: Mat3::of_matrix(&along_turn),
            ..self.chart
        };
        let ([near, _], [_, far_turn]) = (less.linear(), less.angular());
        let outer = self.rotation_a * spread * s;
        [
            outer * tangent.matrix() * self.rotation_a.transpose(),
            outer * near.matrix() - self.rotation_a * hat(&z) * s,
            outer * along_turn * far_turn.matrix(),
        ]
    }

    /// Returns the derivatives of the rotation along `ζ_a` and `ζ_b`.
    pub fn rotation(&self, s: f64) -> [Matrix3<f64>; 2] {
        let turn = self.psi * s;
        let along_turn = exp_tangent(&turn) * s;
        let [near, far] = (self.chart.angular()).map(|own| along_turn * own.matrix());
        [exp(&turn).transpose() + near, far]
    }
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
