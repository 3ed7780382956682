//! The laws by which the dilatation of a rod enters its stress and its inertia.
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
use pulp::{Scalar, Simd};

use super::{Element, ElementStrain};
use crate::vector::Lanes;

/// The law by which axial stretch enters stiffness and inertia.
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

    /// Tells whether the stress is the gradient of an energy.
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
#[derive(Clone, Copy)]
pub struct Thinning<S: Simd> {
    /// `1/e`
    pub linear: Lanes<S>,
    /// `1/e³`
    pub angular: Lanes<S>,
    /// `w = ∂u/∂e`, N.
    pub slope: Lanes<S>,
    /// `∂²u/∂e²`, N.
    pub bend: Lanes<S>,
}

impl<S: Simd> Thinning<S> {
    /// At dilatation `e`, given as `1/e`, that is frozen: under [`RodModel::Dilatation`].
    #[inline(always)]
    pub fn frozen(inverse: Lanes<S>) -> Self {
        let none = Lanes::splat(inverse.simd, 0.0);
        Self {
            linear: inverse,
            angular: inverse * inverse * inverse,
            slope: none,
            bend: none,
        }
    }

    /// At dilatation `e`, given as `1/e`, with the linear and angular energy densities at `e = 1` (J/m) and `EA` (N).
    #[inline(always)]
    pub fn at(inverse: Lanes<S>, linear: Lanes<S>, angular: Lanes<S>, axial: Lanes<S>) -> Self {
        let factors = Self::frozen(inverse);
        let square = inverse * inverse;
        let angular = angular * 3.0;
        // φ' = ½ (1 - 1/e)², φ'' = (1 - 1/e)/e²
        let stretch = -inverse + 1.0;
        let twice = linear * 2.0 + angular * square * 4.0;
        Self {
            slope: axial * 0.5 * (stretch * stretch) - square * (linear + angular * square),
            bend: square * (axial * stretch + inverse * twice),
            ..factors
        }
    }
}

/// Stress of an element, and the dilatation through which it was thinned.
pub(super) struct Stressed {
    /// `n` at both ends, body frames, N.
    pub linear: [Vector3<f64>; 2],
    /// `m`, body frame, N m.
    pub angular: Vector3<f64>,
    thinned: Option<Thinned>,
}

/// Quantities for the stiffness of a section that thins.
struct Thinned {
    thinning: Thinning<Scalar>,
    /// `C₁ ε` at both ends and `C₂ κ`.
    unthinned: [Vector3<f64>; 3],
    /// `∂e/∂v` of both ends: each has half of the dilatation.
    along: [Vector3<f64>; 2],
    /// `∂²e/∂v²` of both ends.
    bend: [Matrix3<f64>; 2],
}

impl Element {
    /// `|v_rest|`
    #[inline]
    pub(super) fn rest_stretch(&self) -> f64 {
        self.rest.linear[0].norm()
    }

    /// `EA |v_rest|²`, N: the factor of `φ`.
    #[inline]
    pub(super) fn axial(&self) -> f64 {
        self.linear_stiffness.z * self.rest.linear[0].norm_squared()
    }

    /// `ε` at both ends and `κ`.
    fn excess(&self, strain: &ElementStrain) -> [Vector3<f64>; 3] {
        let [a, b] = [0, 1].map(|end| strain.linear[end] - self.rest.linear[end]);
        [a, b, strain.curvature - self.rest.curvature]
    }

    /// Elastic energy, J: `(l/4) Σ_ends ε·C₁ε + (l/2) κ·C₂κ` with `ε = v - v_rest`, `κ = ψ/l - κ_rest`; with the
    /// dilatation `e` of the [model](RodModel), `(l/4e) Σ_ends ε·C₁ε + (l/2e³) κ·C₂κ`, and [`RodModel::Consistent`] adds
    /// `l EA φ(e)`.
    pub(super) fn energy_of(&self, strain: &ElementStrain) -> f64 {
        let [a, b, kappa] = self.excess(strain);
        let linear: f64 = [a, b]
            .iter()
            .map(|eps| eps.dot(&self.linear_stiffness.component_mul(eps)))
            .sum();
        let angular = kappa.dot(&self.angular_stiffness.component_mul(&kappa));
        let e = strain.linear[0].norm() / self.rest_stretch();
        let density = self
            .model
            .energy_density(e, 0.25 * linear, 0.5 * angular, self.axial());
        self.length * density
    }

    /// Returns the stress of a strain. The term `w ∂e/∂v` along the chord, which the model `consistent` adds, is that of both ends.
    pub(super) fn stress_of(&self, strain: &ElementStrain) -> Stressed {
        let [a, b, kappa] = self.excess(strain);
        let [n_a, n_b] = [a, b].map(|eps| self.linear_stiffness.component_mul(&eps));
        let m = self.angular_stiffness.component_mul(&kappa);
        if self.model == RodModel::Standard {
            return Stressed {
                linear: [n_a, n_b],
                angular: m,
                thinned: None,
            };
        }
        let nu = self.rest_stretch();
        let of = |value: f64| Lanes::splat(Scalar, value);
        let inverse = of(nu / strain.linear[0].norm());
        let thinning = if self.model == RodModel::Dilatation {
            Thinning::frozen(inverse)
        } else {
            Thinning::at(
                inverse,
                of(0.25 * (a.dot(&n_a) + b.dot(&n_b))),
                of(0.5 * kappa.dot(&m)),
                of(self.axial()),
            )
        };
        let [inverse, slope] = [thinning.linear, thinning.slope].map(|factor| factor.value);
        let along = strain.linear.map(|v| v / (2.0 * v.norm() * nu));
        let bend = strain.linear.map(|v| {
            let (length, way) = (v.norm(), v.normalize());
            (Matrix3::identity() - way * way.transpose()) / (2.0 * length * nu)
        });
        let linear = [n_a * inverse, n_b * inverse];
        Stressed {
            linear: [0, 1].map(|end| linear[end] + along[end] * (2.0 * slope)),
            angular: m * thinning.angular.value,
            thinned: Some(Thinned {
                thinning,
                unthinned: [n_a, n_b, m],
                along,
                bend,
            }),
        }
    }

    /// Returns the parts of `∂(n_a, n_b, m)/∂(v_a, v_b, κ)` of a section that thins; `None` where it is `diag(C₁, C₁, C₂)`.
    pub(super) fn stress_tangent(&self, stress: &Stressed) -> Option<StressTangent> {
        let Thinned {
            thinning,
            unthinned: [n_a, n_b, m],
            along,
            bend,
        } = stress.thinned.as_ref()?;
        let [inverse, cube, slope, curve] = [
            thinning.linear,
            thinning.angular,
            thinning.slope,
            thinning.bend,
        ]
        .map(|factor| factor.value);
        let rate = -inverse * inverse;
        Some(StressTangent {
            linear: inverse,
            angular: cube,
            change: ([n_a * rate, n_b * rate], m * (-3.0 * cube * inverse)),
            along: along.map(|way| way * 2.0),
            completion: (self.model.has_potential())
                .then(|| (bend.map(|bend| bend * (2.0 * slope)), curve)),
        })
    }
}

/// The derivative of the stress `(n_a, n_b, m)` of a section that thins along the strain `(v_a, v_b, κ)`: `diag(C₁/e, C₁/e, C₂/e³)`, and
/// terms along the derivative `e' = ∂e/∂(v_a, v_b)` of the dilatation,
///
/// ```text
/// change e'ᵀ                                                             under `dilatation`,
/// change e'ᵀ + e' changeᵀ + w ∂²e/∂v² + ∂²u/∂e² e' e'ᵀ                   under `consistent`: the Hessian of the energy.
/// ```
pub(super) struct StressTangent {
    /// `1/e`
    pub linear: f64,
    /// `1/e³`
    pub angular: f64,
    /// `∂(n, m)/∂e` at constant strain: of both ends in N, and angular in N m.
    pub change: ([Vector3<f64>; 2], Vector3<f64>),
    /// `∂e/∂v` of both ends, each twice: the ends have half weight each.
    pub along: [Vector3<f64>; 2],
    /// `w ∂²e/∂v²` of both ends, each twice, and `∂²u/∂e²`, N; `None` at frozen dilatation.
    pub completion: Option<([Matrix3<f64>; 2], f64)>,
}
