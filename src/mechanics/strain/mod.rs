//! Strain rules: the elastic energy of one element, its gradient, and the derivative of that gradient.
//!
//! An element joins node `a` to node `b`. Its energy depends on `dx = x_b - x_a` (spatial), `R_a` and `R_b`; variations
//! are `δR = R η̂` (body frame). A gradient is `(F, M_a, M_b)` with
//! `δU = F·(δx_b - δx_a) + M_a·η_a + M_b·η_b`, so the element pulls node `b` with `-F` and node `a` with `+F`.
//!
//! Two rules (notation of the paper, section 4.1):
//!
//! * [`StrainRule::Trapezoidal`], equations (59)-(62): strains `v_i = R_iᵀ dx / l` at both ends, half weight each, and
//!   `ψ = cay⁻¹(R_aᵀ R_b)`. It stiffens bending to `EI + GA l²/4` (shear locking).
//! * [`StrainRule::Helical`]: one constant strain per element from the exponential of SE(3), `ψ = log(R_aᵀ R_b)`,
//!   `v = S(ψ) R_aᵀ dx / l`. Arcs and helices are represented exactly; there is no locking.
//!
//! What stress follows from a strain is the element's [model](RodModel). Under [`RodModel::Dilatation`] the "energy" is
//! that of the paper's (86) and the "gradient" its derivative at frozen dilatation, which has no potential.

use nalgebra::{Matrix3, SMatrix, Vector3};

use crate::mechanics::constitutive::{RodModel, Thinning};
use crate::mechanics::rotation::{
    InverseTangentCoefficients, cay_inverse, cay_inverse_tangent, hat, log, log_tangent,
};

mod helical;
mod trapezoidal;

use self::helical::{HelicalPose, HelicalTerms};
use self::trapezoidal::{ChordThinning, TrapezoidalTerms};

/// How the strains of an element follow from its two nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum StrainRule {
    /// One constant strain per element; arcs and helices are exact, and elements may be long.
    #[default]
    Helical,
    /// Strains at both ends with half weight each; locks in shear unless elements are shorter than the radius.
    Trapezoidal,
}

/// Relative pose of an element's ends and what both rules need of it.
#[derive(Clone, Copy, Debug)]
pub struct ElementPose<'a> {
    /// `x_b - x_a`, spatial, m.
    pub dx: Vector3<f64>,
    /// Rotation of node `a`, body to space.
    pub rotation_a: &'a Matrix3<f64>,
    /// Rotation of node `b`, body to space.
    pub rotation_b: &'a Matrix3<f64>,
}

/// Strain measures of one element, per unit of rest length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ElementStrain {
    /// `v` at node a and at node b (dimensionless; `e3` when straight and unstretched). Equal under the helical rule.
    pub linear: [Vector3<f64>; 2],
    /// `ψ/l`, 1/m, body frame.
    pub curvature: Vector3<f64>,
}

/// Stress of one element over an [interval](super::implicit), conjugate to an [`ElementStrain`]: the energy changes by `l/2 Σ_ends n·δv + l m·δκ`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntervalStress {
    /// `n` at node a and at node b, body frame, N. Equal under the helical rule.
    pub linear: [Vector3<f64>; 2],
    /// `m`, body frame, N m.
    pub angular: Vector3<f64>,
}

/// Stiffness and stress-free strain of one element.
#[derive(Clone, Copy, Debug)]
pub struct Element {
    /// The model of the section: how the dilatation enters the stress.
    pub model: RodModel,
    /// Rest length `l`, m.
    pub length: f64,
    /// `diag(GA, GA, EA)`, N.
    pub linear_stiffness: Vector3<f64>,
    /// `diag(EI₁, EI₂, GJ)`, N m².
    pub angular_stiffness: Vector3<f64>,
    /// Strain at which the element is free of stress.
    pub rest: ElementStrain,
}

/// Gradient of an element's energy: `δU = F·(δx_b - δx_a) + M_a·η_a + M_b·η_b`.
#[derive(Clone, Copy, Debug)]
pub struct ElementGradient {
    /// `F`, spatial, N.
    pub force: Vector3<f64>,
    /// `M_a`, body frame of node a, N m.
    pub moment_a: Vector3<f64>,
    /// `M_b`, body frame of node b, N m.
    pub moment_b: Vector3<f64>,
}

/// Derivative of `(F, M_a, M_b)` along `(δx_b - δx_a, η_a, η_b)`, each component in its own body frame.
///
/// Not symmetric where moments are not zero: left-invariant fields do not commute.
pub type ElementStiffness = SMatrix<f64, 9, 9>;

/// Derivative of the strain `(v_a, v_b, κ)` along `(δx_b - δx_a, η_a, η_b)`.
pub type StrainDerivative = SMatrix<f64, 9, 9>;

impl StrainRule {
    /// Name in scene and result files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Helical => "helical",
            Self::Trapezoidal => "trapezoidal",
        }
    }

    /// Strains of an element of rest length `length` in the given pose.
    #[must_use]
    pub fn strain(self, length: f64, pose: &ElementPose) -> ElementStrain {
        let relative = pose.rotation_a.transpose() * pose.rotation_b;
        match self {
            Self::Helical => {
                let psi = log(&relative);
                let y = pose.rotation_a.transpose() * pose.dx;
                let c = InverseTangentCoefficients::at(psi.norm_squared());
                let v = log_tangent(&psi, &c) * y / length;
                ElementStrain {
                    linear: [v, v],
                    curvature: psi / length,
                }
            }
            Self::Trapezoidal => ElementStrain {
                linear: [
                    pose.rotation_a.transpose() * pose.dx / length,
                    pose.rotation_b.transpose() * pose.dx / length,
                ],
                curvature: cay_inverse(&relative) / length,
            },
        }
    }

    /// [`Self::strain`] and its derivative. Helical: `δv = (S (R_aᵀ δdx + ŷ η_a) + G δψ)/l`, `G = ∂(S y)/∂ψ`,
    /// `δψ = Sᵀ η_b - S η_a`; trapezoidal: `δv_i = R_iᵀ δdx/l + v̂_i η_i`, `δψ = P η_b - Pᵀ η_a`.
    #[must_use]
    pub fn strain_derivative(
        self,
        length: f64,
        pose: &ElementPose,
    ) -> (ElementStrain, StrainDerivative) {
        let mut b = StrainDerivative::zeros();
        let mut set = |row: usize, column: usize, block: &Matrix3<f64>| {
            b.fixed_view_mut::<3, 3>(row, column).copy_from(block);
        };
        let strain = match self {
            Self::Helical => {
                let HelicalPose {
                    rotation_a,
                    psi,
                    y,
                    c,
                    s,
                } = HelicalPose::at(pose);
                let s = s / length;
                let g = tangent_derivative(&psi, &y, &c, -1.0);
                let along_dx = s * rotation_a.transpose();
                let along_a = s * hat(&y) - g * s;
                let along_b = g * s.transpose();
                for row in [0, 3] {
                    set(row, 0, &along_dx);
                    set(row, 3, &along_a);
                    set(row, 6, &along_b);
                }
                set(6, 3, &-s);
                set(6, 6, &s.transpose());
                ElementStrain {
                    linear: [s * y; 2],
                    curvature: psi / length,
                }
            }
            Self::Trapezoidal => {
                let strain = self.strain(length, pose);
                for (end, rotation) in [pose.rotation_a, pose.rotation_b].into_iter().enumerate() {
                    set(3 * end, 0, &(rotation.transpose() / length));
                    set(3 * end, 3 + 3 * end, &hat(&strain.linear[end]));
                }
                let p = cay_inverse_tangent(&(strain.curvature * length)) / length;
                set(6, 3, &-p.transpose());
                set(6, 6, &p);
                strain
            }
        };
        (strain, b)
    }
}

impl Element {
    /// Elastic energy, J: `(l/4) Σ_ends ε·C₁ε + (l/2) κ·C₂κ` with `ε = v - v_rest`, `κ = ψ/l - κ_rest`; with the
    /// dilatation `e` of the [model](RodModel), `(l/4e) Σ_ends ε·C₁ε + (l/2e³) κ·C₂κ`, and [`RodModel::Consistent`] adds
    /// `l EA φ(e)`.
    #[must_use]
    pub fn energy(&self, rule: StrainRule, pose: &ElementPose) -> f64 {
        let strain = rule.strain(self.length, pose);
        let linear: f64 = (0..2)
            .map(|end| {
                let eps = strain.linear[end] - self.rest.linear[end];
                eps.dot(&self.linear_stiffness.component_mul(&eps))
            })
            .sum();
        let kappa = strain.curvature - self.rest.curvature;
        let angular = kappa.dot(&self.angular_stiffness.component_mul(&kappa));
        let e = strain.linear[0].norm() / self.rest_stretch();
        let density = self
            .model
            .energy_density(e, 0.25 * linear, 0.5 * angular, self.axial());
        self.length * density
    }

    /// `|v_rest|`
    #[inline]
    fn rest_stretch(&self) -> f64 {
        self.rest.linear[0].norm()
    }

    /// `EA |v_rest|²`, N: the factor of `φ`.
    #[inline]
    fn axial(&self) -> f64 {
        self.linear_stiffness.z * self.rest.linear[0].norm_squared()
    }

    /// Internal force (N) and moment (N m), with the dilatation of the [model](RodModel). Components in the body frame: under
    /// the helical rule the same all along the element, under the trapezoidal rule means of those in the frames of the ends.
    #[must_use]
    pub fn stress(&self, rule: StrainRule, pose: &ElementPose) -> (Vector3<f64>, Vector3<f64>) {
        match rule {
            StrainRule::Helical => {
                let terms = self.helical(pose);
                (terms.n, terms.m)
            }
            StrainRule::Trapezoidal => {
                let terms = self.trapezoidal(pose);
                let along_chord = terms.thinning.map_or_else(Vector3::zeros, |chord| {
                    chord.along * (self.length * chord.thinning.slope)
                });
                let ends =
                    [0, 1].map(|end| terms.n[end] + terms.rotations[end].tr_mul(&along_chord));
                (0.5 * (ends[0] + ends[1]), terms.y)
            }
        }
    }

    /// Gradient of the energy.
    #[inline]
    #[must_use]
    pub fn gradient(&self, rule: StrainRule, pose: &ElementPose) -> ElementGradient {
        match rule {
            StrainRule::Helical => self.helical(pose).gradient(),
            StrainRule::Trapezoidal => self.trapezoidal(pose).gradient(),
        }
    }

    /// Gradient of the energy and its derivative.
    #[must_use]
    pub fn stiffness(
        &self,
        rule: StrainRule,
        pose: &ElementPose,
    ) -> (ElementGradient, ElementStiffness) {
        match rule {
            StrainRule::Helical => {
                let terms = self.helical(pose);
                (terms.gradient(), terms.stiffness(self))
            }
            StrainRule::Trapezoidal => {
                let terms = self.trapezoidal(pose);
                (terms.gradient(), terms.stiffness(self))
            }
        }
    }

    /// `weights[0] C (s₀ - s_rest) + weights[1] C (s₁ - s_rest)` of two strains, by the standard model.
    #[must_use]
    pub fn interval_stress(
        &self,
        strains: [&ElementStrain; 2],
        weights: [f64; 2],
    ) -> IntervalStress {
        let rest = self.rest.linear;
        let [start, end] = strains;
        let mean = |start: Vector3<f64>, end: Vector3<f64>| start * weights[0] + end * weights[1];
        let strain = ElementStrain {
            linear: [0, 1].map(|i| mean(start.linear[i] - rest[i], end.linear[i] - rest[i])),
            curvature: mean(
                start.curvature - self.rest.curvature,
                end.curvature - self.rest.curvature,
            ),
        };
        self.stress_of_strain(&strain, 1.0)
    }

    /// `factor C` times a strain, the standard model's law about the stress-free shape.
    #[must_use]
    pub fn stress_of_strain(&self, strain: &ElementStrain, factor: f64) -> IntervalStress {
        let linear = self.linear_stiffness * factor;
        IntervalStress {
            linear: strain.linear.map(|v| linear.component_mul(&v)),
            angular: (self.angular_stiffness * factor).component_mul(&strain.curvature),
        }
    }

    /// What a given stress does on the ends of the element: `Bᵀ` times the stress, [`Self::gradient`] where the
    /// stress is that of the pose.
    #[must_use]
    pub fn gradient_under(
        &self,
        rule: StrainRule,
        pose: &ElementPose,
        stress: &IntervalStress,
    ) -> ElementGradient {
        match rule {
            StrainRule::Helical => HelicalPose::at(pose).under(stress).gradient(),
            StrainRule::Trapezoidal => self.trapezoidal_under(pose, stress).gradient(),
        }
    }

    /// Derivative of [`Self::gradient_under`] when the stress changes with `factor` times the standard model's stiffness.
    #[must_use]
    pub fn stiffness_under(
        &self,
        rule: StrainRule,
        pose: &ElementPose,
        stress: &IntervalStress,
        factor: f64,
    ) -> ElementStiffness {
        let scaled = Self {
            model: RodModel::Standard,
            linear_stiffness: self.linear_stiffness * factor,
            angular_stiffness: self.angular_stiffness * factor,
            ..*self
        };
        match rule {
            StrainRule::Helical => HelicalPose::at(pose).under(stress).stiffness(&scaled),
            StrainRule::Trapezoidal => self.trapezoidal_under(pose, stress).stiffness(&scaled),
        }
    }

    /// `B_startᵀ C B_end` with the weights of the two ends and the length: how the forces at one instant change with the
    /// configuration at another.
    #[must_use]
    pub fn coupling(&self, start: &StrainDerivative, end: &StrainDerivative) -> ElementStiffness {
        let mut stressed = *end;
        for axis in 0..3 {
            let linear = 0.5 * self.length * self.linear_stiffness[axis];
            let angular = self.length * self.angular_stiffness[axis];
            for (row, stiffness) in [(0, linear), (3, linear), (6, angular)] {
                let mut row = stressed.row_mut(row + axis);
                row *= stiffness;
            }
        }
        // Faster than `tr_mul`, which takes dot products.
        start.transpose() * stressed
    }

    #[inline]
    fn helical<'a>(&self, pose: &ElementPose<'a>) -> HelicalTerms<'a> {
        let kinematics = HelicalPose::at(pose);
        let HelicalPose { psi, y, s, .. } = &kinematics;
        let v = s * y / self.length;
        let eps = v - self.rest.linear[0];
        let kappa = psi / self.length - self.rest.curvature;
        let mut n = self.linear_stiffness.component_mul(&eps);
        let mut m = self.angular_stiffness.component_mul(&kappa);
        let thinning = (self.model != RodModel::Standard).then(|| {
            let nu = self.rest_stretch();
            let stretch = v.norm();
            let thinning = Thinning::at(
                self.model,
                stretch / nu,
                0.5 * eps.dot(&n),
                0.5 * kappa.dot(&m),
                self.axial(),
            );
            let along = v / (stretch * nu);
            let tangent = thinning.tangent(self, &n, &m, &along, &v);
            n = n * thinning.linear + along * thinning.slope;
            m *= thinning.angular;
            tangent
        });
        kinematics.terms(n, m, thinning)
    }

    #[inline]
    fn trapezoidal<'a>(&self, pose: &ElementPose<'a>) -> TrapezoidalTerms<'a> {
        let v = [pose.rotation_a, pose.rotation_b].map(|r| r.transpose() * pose.dx / self.length);
        let eps = [0, 1].map(|end| v[end] - self.rest.linear[end]);
        let mut n = eps.map(|eps| self.linear_stiffness.component_mul(&eps));
        let psi = cay_inverse(&(pose.rotation_a.transpose() * pose.rotation_b));
        let kappa = psi / self.length - self.rest.curvature;
        let mut y = self.angular_stiffness.component_mul(&kappa);
        let thinning = (self.model != RodModel::Standard).then(|| {
            let rest_chord = self.rest_stretch() * self.length;
            let chord = pose.dx.norm();
            let thinning = Thinning::at(
                self.model,
                chord / rest_chord,
                0.25 * (eps[0].dot(&n[0]) + eps[1].dot(&n[1])),
                0.5 * kappa.dot(&y),
                self.axial(),
            );
            n = n.map(|n| n * thinning.linear);
            y *= thinning.angular;
            ChordThinning {
                thinning,
                along: pose.dx / (chord * rest_chord),
                bend: (Matrix3::identity() - pose.dx * pose.dx.transpose() / (chord * chord))
                    / (chord * rest_chord),
            }
        });
        TrapezoidalTerms {
            rotations: [pose.rotation_a, pose.rotation_b],
            length: self.length,
            v,
            n,
            psi,
            y,
            p: cay_inverse_tangent(&psi),
            thinning,
        }
    }

    fn trapezoidal_under<'a>(
        &self,
        pose: &ElementPose<'a>,
        stress: &IntervalStress,
    ) -> TrapezoidalTerms<'a> {
        let psi = cay_inverse(&(pose.rotation_a.transpose() * pose.rotation_b));
        TrapezoidalTerms {
            rotations: [pose.rotation_a, pose.rotation_b],
            length: self.length,
            v: [pose.rotation_a, pose.rotation_b].map(|r| r.transpose() * pose.dx / self.length),
            n: stress.linear,
            psi,
            y: stress.angular,
            p: cay_inverse_tangent(&psi),
            thinning: None,
        }
    }
}

/// `∂(S(ψ) y)/∂ψ` for `sign = -1` and `∂(S(ψ)ᵀ y)/∂ψ` for `sign = +1`.
///
/// `S^{(T)} y = y + (sign/2) ψ × y + c (ψ (ψ·y) - |ψ|² y)`.
#[inline]
pub(crate) fn tangent_derivative(
    psi: &Vector3<f64>,
    y: &Vector3<f64>,
    c: &InverseTangentCoefficients,
    sign: f64,
) -> Matrix3<f64> {
    let along = psi.dot(y);
    let double_cross = psi * along - y * psi.norm_squared();
    hat(y) * (-0.5 * sign)
        + c.value
            * (Matrix3::from_diagonal_element(along) + psi * y.transpose()
                - 2.0 * y * psi.transpose())
        + c.slope * double_cross * psi.transpose()
}

/// `diag(d) m`
#[inline]
fn scale_rows(d: &Vector3<f64>, m: &Matrix3<f64>) -> Matrix3<f64> {
    Matrix3::from_rows(&[m.row(0) * d.x, m.row(1) * d.y, m.row(2) * d.z])
}

/// Symmetric second derivative of `y·log(A)` along body rotations `A exp(ζ)` at `A = exp(ψ)`: the derivative of its
/// gradient `S(ψ) y`, with `δψ = Sᵀ ζ`, made symmetric.
#[must_use]
pub fn log_second_derivative(psi: &Vector3<f64>, y: &Vector3<f64>) -> Matrix3<f64> {
    let c = InverseTangentCoefficients::at(psi.norm_squared());
    let m = tangent_derivative(psi, y, &c, -1.0) * log_tangent(psi, &c).transpose();
    0.5 * (m + m.transpose())
}

#[cfg(test)]
pub(crate) mod tests;
