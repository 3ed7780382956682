//! How the dilatation of a rod enters its stress and its inertia.
//!
//! With the dilatation `e` (current over rest length, the paper's (58)), the section keeps its volume: its area goes like
//! `1/e`. Stress per [model](RodModel), with `ε = v - v_rest`, `κ = ψ/l - κ_rest`:
//!
//! ```text
//! standard      n = C₁ ε                   m = C₂ κ            inertia J
//! dilatation    n = C₁ ε/e                 m = C₂ κ/e³         inertia J/e       (the paper's (34)-(46))
//! consistent    n = C₁ ε/e + w ∂e/∂v       m = C₂ κ/e³         inertia J/e       derived from one action
//! ```
//!
//! `consistent` is the gradient of `u(v, κ) = ε·C₁ε/(2e) + κ·C₂κ/(2e³) + EA φ(e)` (J/m), with
//! `φ(e) = (e - 1 - ln e) - (e - 1)²/(2e)`, so that `w = ∂u/∂e`; pure stretching obeys the paper's law `EA (e - 1)/e`. The stress
//! of `dilatation` is no gradient as soon as there is shear or curvature: its energy wanders.

use nalgebra::{Matrix3, Vector3};

use super::strain::Element;

/// How axial stretch enters stiffness and inertia.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum RodModel {
    /// The section keeps its size as the rod stretches: `e = 1` in stiffness and inertia.
    #[default]
    Standard,
    /// The section thins as the rod stretches, at frozen stretch in the equations of motion: the paper's modified model, `C₁/e`, `C₂/e³`,
    /// `J/e`. Not the variation of an action: angular momentum is broken and the energy wanders; long or violent motions can blow up at
    /// any time step.
    Dilatation,
    /// The section thins as the rod stretches, with every derivative kept: a discrete energy exists, and momenta are conserved.
    Consistent,
}

impl RodModel {
    /// Name in scene and result files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Standard => "standard",
            Self::Dilatation => "dilatation",
            Self::Consistent => "consistent",
        }
    }

    /// Whether the stress is the gradient of an energy.
    #[inline]
    #[must_use]
    pub fn has_potential(self) -> bool {
        self != Self::Dilatation
    }

    /// Energy per rest length, J/m, from its linear and angular parts at `e = 1` and the axial stiffness `EA`.
    #[inline]
    #[must_use]
    pub fn energy_density(self, e: f64, linear: f64, angular: f64, axial: f64) -> f64 {
        match self {
            Self::Standard => linear + angular,
            Self::Dilatation => linear / e + angular / (e * e * e),
            Self::Consistent => {
                let u = e - 1.0;
                // (e - 1 - ln e) - (e - 1)²/(2e) = u³/6 + O(u⁴): its digits are lost where it is below rounding of u².
                let completion = (u - u.ln_1p()) - 0.5 * u * u / e;
                linear / e + angular / (e * e * e) + axial * completion
            }
        }
    }
}

/// Factors of the dilatation on stress, and derivatives of the energy density through it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Thinning {
    /// `1/e`
    pub linear: f64,
    /// `1/e³`
    pub angular: f64,
    /// `w = ∂u/∂e`, N; zero at frozen dilatation.
    pub slope: f64,
    /// `∂²u/∂e²`, N; zero at frozen dilatation.
    pub bend: f64,
}

/// Derivative of the stress `(n, m)` along the strain `(v, κ)`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tangent {
    /// `∂n/∂v`, N.
    pub linear: Matrix3<f64>,
    /// `∂n/∂κ`, N m.
    pub linear_angular: Matrix3<f64>,
    /// `∂m/∂v`, N m.
    pub angular_linear: Matrix3<f64>,
    /// `∂m/∂κ`, N m².
    pub angular: Matrix3<f64>,
}

impl Thinning {
    /// At dilatation `e`, with the linear and angular energy densities at `e = 1` (J/m) and `EA` (N).
    #[inline]
    pub fn at(model: RodModel, e: f64, linear: f64, angular: f64, axial: f64) -> Self {
        let inverse = 1.0 / e;
        let square = inverse * inverse;
        let mut out = Self {
            linear: inverse,
            angular: square * inverse,
            slope: 0.0,
            bend: 0.0,
        };
        if model == RodModel::Consistent {
            let u = e - 1.0;
            // φ' = (e - 1)²/(2e²), φ'' = (e - 1)/e³
            out.slope = square * (0.5 * axial * u * u - linear - 3.0 * angular * square);
            out.bend = square * inverse * (axial * u + 2.0 * linear + 12.0 * angular * square);
        }
        out
    }

    /// Tangent of the stress; `n = C₁ε` and `m = C₂κ` before thinning, `along = ∂e/∂v = v/(|v| |v_rest|)`.
    #[inline]
    pub fn tangent(
        &self,
        element: &Element,
        n: &Vector3<f64>,
        m: &Vector3<f64>,
        along: &Vector3<f64>,
        v: &Vector3<f64>,
    ) -> Tangent {
        let linear_change = n * (-self.linear * self.linear);
        let angular_change = m * (-3.0 * self.angular * self.linear);
        let mut tangent = Tangent {
            linear: Matrix3::from_diagonal(&(element.linear_stiffness * self.linear))
                + linear_change * along.transpose(),
            linear_angular: Matrix3::zeros(),
            angular_linear: angular_change * along.transpose(),
            angular: Matrix3::from_diagonal(&(element.angular_stiffness * self.angular)),
        };
        if element.model.has_potential() {
            // ∂²e/∂v² = (I - v vᵀ/|v|²)/(|v| |v_rest|)
            let direction = v / v.norm();
            let bend = (Matrix3::identity() - direction * direction.transpose())
                * (along.norm() / v.norm());
            tangent.linear += along * linear_change.transpose()
                + along * along.transpose() * self.bend
                + bend * self.slope;
            tangent.linear_angular = along * angular_change.transpose();
        }
        tangent
    }
}
