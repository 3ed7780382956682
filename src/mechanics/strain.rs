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

use super::constitutive::{RodModel, Tangent, Thinning};
use super::rotation::{
    InverseTangentCoefficients, cay_inverse, cay_inverse_tangent, hat, log, log_tangent,
};

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
pub(super) fn tangent_derivative(
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

/// What the helical rule needs of a pose, whatever the stress.
struct HelicalPose<'a> {
    rotation_a: &'a Matrix3<f64>,
    psi: Vector3<f64>,
    /// `R_aᵀ dx`
    y: Vector3<f64>,
    c: InverseTangentCoefficients,
    /// `S(ψ)`
    s: Matrix3<f64>,
}

impl<'a> HelicalPose<'a> {
    #[inline]
    fn at(pose: &ElementPose<'a>) -> Self {
        let psi = log(&(pose.rotation_a.transpose() * pose.rotation_b));
        let c = InverseTangentCoefficients::at(psi.norm_squared());
        Self {
            rotation_a: pose.rotation_a,
            psi,
            y: pose.rotation_a.transpose() * pose.dx,
            c,
            s: log_tangent(&psi, &c),
        }
    }

    #[inline]
    fn terms(
        self,
        n: Vector3<f64>,
        m: Vector3<f64>,
        thinning: Option<Tangent>,
    ) -> HelicalTerms<'a> {
        let Self {
            rotation_a,
            psi,
            y,
            c,
            s,
        } = self;
        HelicalTerms {
            rotation_a,
            psi,
            y,
            c,
            s,
            n,
            m,
            mu: m + tangent_derivative(&psi, &y, &c, -1.0).transpose() * n,
            w: s.transpose() * n,
            thinning,
        }
    }

    fn under(self, stress: &IntervalStress) -> HelicalTerms<'a> {
        self.terms(stress.linear[0], stress.angular, None)
    }
}

/// Intermediate quantities of the helical rule; see the [module documentation](self).
struct HelicalTerms<'a> {
    rotation_a: &'a Matrix3<f64>,
    psi: Vector3<f64>,
    /// `R_aᵀ dx`
    y: Vector3<f64>,
    c: InverseTangentCoefficients,
    /// `S(ψ)`
    s: Matrix3<f64>,
    /// Internal force `C₁ (v - v_rest)`, body.
    n: Vector3<f64>,
    /// Internal moment `C₂ (ψ/l - κ_rest)`, body.
    m: Vector3<f64>,
    /// `∂U/∂ψ = m + ∂(n·S(ψ)y)/∂ψ`
    mu: Vector3<f64>,
    /// `Sᵀ n`
    w: Vector3<f64>,
    /// Tangent of the stress, where the model thins the section.
    thinning: Option<Tangent>,
}

impl HelicalTerms<'_> {
    #[inline]
    fn gradient(&self) -> ElementGradient {
        ElementGradient {
            force: self.rotation_a * self.w,
            moment_a: self.w.cross(&self.y) - self.s.transpose() * self.mu,
            moment_b: self.s * self.mu,
        }
    }

    /// Second derivatives over `(y, ψ)` first, then the chain rule `δy = R_aᵀ δdx + ŷ η_a`, `δψ = Sᵀ η_b - S η_a`.
    /// Blocks of different nodes are each other's transposes where there is a potential, because their fields commute.
    fn stiffness(&self, element: &Element) -> ElementStiffness {
        let Self {
            psi,
            y,
            c,
            s,
            n,
            mu,
            w,
            ..
        } = self;
        let r = self.rotation_a;
        let s_t = s.transpose();
        let y_hat = hat(y);
        let w_hat = hat(w);
        let g = tangent_derivative(psi, y, c, -1.0);
        let turned = tangent_derivative(psi, n, c, 1.0);

        // dw = A δy + B δψ, dμ = B' δy + D δψ; B' = Bᵀ where there is a potential.
        let l = element.length;
        let (a, b, b_transposed, d) = match &self.thinning {
            None => {
                let c1 = element.linear_stiffness / l;
                let bent = scale_rows(&c1, &g);
                let b = s_t * bent + turned;
                let d = Matrix3::from_diagonal(&(element.angular_stiffness / l)) + g.tr_mul(&bent);
                (s_t * scale_rows(&c1, s), b, b.transpose(), d)
            }
            Some(t) => {
                let bent = t.linear * g + t.linear_angular;
                let stretched = t.linear * s / l;
                (
                    s_t * stretched,
                    s_t * bent / l + turned,
                    g.tr_mul(&stretched) + t.angular_linear * s / l + turned.transpose(),
                    (t.angular + t.angular_linear * g + g.tr_mul(&bent)) / l,
                )
            }
        };
        let d = d + self.curvature_of_coupling();

        // F = R_a w
        let w_near = a * y_hat - b * s;
        let force_x = r * a * r.transpose();
        let force_a = r * (w_near - w_hat);
        let force_b = r * (b * s_t);
        // M_b = S μ, M_a = w × y - Sᵀ μ
        let mu_near = b_transposed * y_hat - d * s;
        let turn_b = tangent_derivative(psi, mu, c, -1.0);
        let turn_a = tangent_derivative(psi, mu, c, 1.0);
        let b_b = (s * d + turn_b) * s_t;
        let b_a = s * mu_near - turn_b * s;
        let a_a = turn_a * s - s_t * mu_near - y_hat * w_near + w_hat * y_hat;
        let (a_x, b_x, a_b) = if element.model.has_potential() {
            (force_a.transpose(), force_b.transpose(), b_a.transpose())
        } else {
            let r_t = r.transpose();
            (
                (w_hat - y_hat * a - s_t * b_transposed) * r_t,
                s * b_transposed * r_t,
                -(y_hat * b + s_t * d + turn_a) * s_t,
            )
        };

        let mut k = ElementStiffness::zeros();
        let mut set = |row: usize, column: usize, block: &Matrix3<f64>| {
            k.fixed_view_mut::<3, 3>(row, column).copy_from(block);
        };
        set(0, 0, &force_x);
        set(0, 3, &force_a);
        set(0, 6, &force_b);
        set(3, 0, &a_x);
        set(3, 3, &a_a);
        set(3, 6, &a_b);
        set(6, 0, &b_x);
        set(6, 3, &b_a);
        set(6, 6, &b_b);
        k
    }

    /// `∂²(n·S(ψ)y)/∂ψ²` at fixed `n`, `y`: symmetric.
    fn curvature_of_coupling(&self) -> Matrix3<f64> {
        let Self { psi, y, n, c, .. } = self;
        let p = psi.dot(n);
        let r = psi.dot(y);
        let s = n.dot(y);
        let q = p * r - psi.norm_squared() * s;
        let grad_q = n * r + y * p - psi * (2.0 * s);
        let hess_q =
            n * y.transpose() + y * n.transpose() - Matrix3::from_diagonal_element(2.0 * s);
        c.value * hess_q
            + c.slope * (psi * grad_q.transpose() + grad_q * psi.transpose())
            + q * (Matrix3::from_diagonal_element(c.slope) + c.bend * psi * psi.transpose())
    }
}

/// Intermediate quantities of the trapezoidal rule.
struct TrapezoidalTerms<'a> {
    rotations: [&'a Matrix3<f64>; 2],
    length: f64,
    v: [Vector3<f64>; 2],
    /// Internal forces `C₁ (v - v_rest)` at the two ends, body.
    n: [Vector3<f64>; 2],
    psi: Vector3<f64>,
    /// Internal moment `C₂ (ψ/l - κ_rest)`.
    y: Vector3<f64>,
    /// `P = I + ψ̂/2 + ψψᵀ/4`: `δψ = P η_b - Pᵀ η_a`.
    p: Matrix3<f64>,
    /// Derivatives through the dilatation, where the model thins the section; `n` and `y` are thinned already.
    thinning: Option<ChordThinning>,
}

/// The dilatation `e = |dx|/|dx_rest|` of the trapezoidal rule.
struct ChordThinning {
    thinning: Thinning,
    /// `∂e/∂dx`, 1/m.
    along: Vector3<f64>,
    /// `∂²e/∂dx²`, 1/m².
    bend: Matrix3<f64>,
}

impl TrapezoidalTerms<'_> {
    #[inline]
    fn gradient(&self) -> ElementGradient {
        let mut force = 0.5 * (self.rotations[0] * self.n[0] + self.rotations[1] * self.n[1]);
        if let Some(chord) = &self.thinning {
            force += chord.along * (self.length * chord.thinning.slope);
        }
        let shear = [0, 1].map(|end| 0.5 * self.length * self.n[end].cross(&self.v[end]));
        ElementGradient {
            force,
            moment_a: shear[0] - self.p * self.y,
            moment_b: shear[1] + self.p.transpose() * self.y,
        }
    }

    fn stiffness(&self, element: &Element) -> ElementStiffness {
        let mut k = ElementStiffness::zeros();
        let mut c1 = Matrix3::from_diagonal(&element.linear_stiffness);
        let mut c2 = Matrix3::from_diagonal(&(element.angular_stiffness / element.length));
        if let Some(ChordThinning { thinning, .. }) = &self.thinning {
            c1 *= thinning.linear;
            c2 *= thinning.angular;
        }
        for end in 0..2 {
            let r = self.rotations[end];
            let v_hat = hat(&self.v[end]);
            // B = C₁ v̂ - n̂; the force turns with B, the moment with Bᵀ.
            let b = c1 * v_hat - hat(&self.n[end]);
            let at = 3 + 3 * end;
            let mut force = k.fixed_view_mut::<3, 3>(0, 0);
            force += (r * c1 * r.transpose()) * (0.5 / self.length);
            k.fixed_view_mut::<3, 3>(0, at).copy_from(&(0.5 * r * b));
            k.fixed_view_mut::<3, 3>(at, 0)
                .copy_from(&(0.5 * b.transpose() * r.transpose()));
            k.fixed_view_mut::<3, 3>(at, at)
                .copy_from(&((0.5 * self.length) * b.transpose() * v_hat));
        }
        let Self { psi, y, p, .. } = self;
        let outer = 0.25 * (Matrix3::from_diagonal_element(psi.dot(y)) + psi * y.transpose());
        let half_y = 0.5 * hat(y);
        // d(Pᵀ y) and d(P y) along δψ, and δψ along the ends.
        let mb_dpsi = p.transpose() * c2 + half_y + outer;
        let ma_dpsi = -(p * c2 - half_y + outer);
        for (row, along_psi) in [(3, ma_dpsi), (6, mb_dpsi)] {
            let mut near = k.fixed_view_mut::<3, 3>(row, 3);
            near -= along_psi * p.transpose();
            let mut far = k.fixed_view_mut::<3, 3>(row, 6);
            far += along_psi * p;
        }
        if let Some(chord) = &self.thinning {
            self.add_thinning(element, chord, &mut k);
        }
        k
    }

    /// With `g₁/e + g₂/e³` the gradient at frozen dilatation and `w ∂e` the rest of it: `-(g₁/e² + 3g₂/e⁴) ∂eᵀ`, and
    /// for a potential its transpose and `w' ∂e ∂eᵀ + w ∂²e`.
    fn add_thinning(&self, element: &Element, chord: &ChordThinning, k: &mut ElementStiffness) {
        let ChordThinning {
            thinning,
            along,
            bend,
        } = chord;
        let linear = Self {
            y: Vector3::zeros(),
            thinning: None,
            ..*self
        }
        .gradient();
        let angular = self.p * self.y;
        let turn_b = self.p.tr_mul(&self.y);
        let rate = -thinning.linear;
        let column = [
            rate * linear.force,
            rate * (linear.moment_a - 3.0 * angular),
            rate * (linear.moment_b + 3.0 * turn_b),
        ];
        for (part, change) in column.iter().enumerate() {
            let mut block = k.fixed_view_mut::<3, 3>(3 * part, 0);
            block += change * along.transpose();
            if element.model.has_potential() {
                let mut block = k.fixed_view_mut::<3, 3>(0, 3 * part);
                block += along * change.transpose();
            }
        }
        let mut block = k.fixed_view_mut::<3, 3>(0, 0);
        block +=
            element.length * (along * along.transpose() * thinning.bend + bend * thinning.slope);
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::mechanics::rotation::exp;
    use proptest::prelude::*;

    const RULES: [StrainRule; 2] = [StrainRule::Helical, StrainRule::Trapezoidal];
    const MODELS: [RodModel; 3] = [
        RodModel::Standard,
        RodModel::Dilatation,
        RodModel::Consistent,
    ];

    fn laws() -> impl Iterator<Item = (StrainRule, RodModel)> {
        RULES
            .into_iter()
            .flat_map(|rule| MODELS.map(|model| (rule, model)))
    }

    fn element() -> Element {
        Element {
            model: RodModel::Standard,
            length: 0.13,
            linear_stiffness: Vector3::new(2.0, 2.5, 7.0),
            angular_stiffness: Vector3::new(0.03, 0.02, 0.05),
            rest: ElementStrain {
                linear: [
                    Vector3::new(0.1, -0.05, 1.1),
                    Vector3::new(0.05, 0.02, 0.95),
                ],
                curvature: Vector3::new(0.4, -0.2, 0.6),
            },
        }
    }

    /// The helical rule has one rest strain, the trapezoidal one two of the same length.
    fn element_for(rule: StrainRule, model: RodModel) -> Element {
        let mut e = element();
        e.model = model;
        e.rest.linear[1] *= e.rest.linear[0].norm() / e.rest.linear[1].norm();
        if rule == StrainRule::Helical {
            e.rest.linear[1] = e.rest.linear[0];
        }
        e
    }

    #[derive(Clone, Debug)]
    struct Pose {
        dx: Vector3<f64>,
        a: Matrix3<f64>,
        b: Matrix3<f64>,
    }

    impl Pose {
        fn view(&self) -> ElementPose<'_> {
            ElementPose {
                dx: self.dx,
                rotation_a: &self.a,
                rotation_b: &self.b,
            }
        }

        fn moved(&self, d: &SMatrix<f64, 9, 1>, h: f64) -> Self {
            Self {
                dx: self.dx + d.fixed_rows::<3>(0) * h,
                a: self.a * exp(&(d.fixed_rows::<3>(3) * h)),
                b: self.b * exp(&(d.fixed_rows::<3>(6) * h)),
            }
        }
    }

    prop_compose! {
        fn pose()(
            a in proptest::array::uniform3(-1.5..1.5f64),
            psi in proptest::array::uniform3(-1.0..1.0f64),
            scale in prop_oneof![Just(0.0), Just(1e-9), Just(1e-3), Just(0.1), 0.0..1.6f64],
            v in proptest::array::uniform3(-0.4..0.4f64),
        ) -> Pose {
            let a = exp(&Vector3::from(a));
            let b = a * exp(&(Vector3::from(psi) * scale));
            Pose { dx: a * (Vector3::from(v) + Vector3::z()) * 0.13, a, b }
        }
    }

    fn direction() -> impl Strategy<Value = SMatrix<f64, 9, 1>> {
        proptest::collection::vec(-1.0..1.0f64, 9)
            .prop_map(|v| SMatrix::<f64, 9, 1>::from_column_slice(&v))
    }

    fn flat(g: &ElementGradient) -> SMatrix<f64, 9, 1> {
        let mut out = SMatrix::<f64, 9, 1>::zeros();
        out.fixed_rows_mut::<3>(0).copy_from(&g.force);
        out.fixed_rows_mut::<3>(3).copy_from(&g.moment_a);
        out.fixed_rows_mut::<3>(6).copy_from(&g.moment_b);
        out
    }

    /// Derivative of `f(h)` at zero to fourth order: Richardson's extrapolation of central differences.
    fn derivative<T>(f: impl Fn(f64) -> T) -> T
    where
        T: std::ops::Sub<Output = T> + std::ops::Mul<f64, Output = T>,
    {
        const H: f64 = 2e-5;
        let central = |h: f64| (f(h) - f(-h)) * (0.5 / h);
        central(H) * (4.0 / 3.0) - central(2.0 * H) * (1.0 / 3.0)
    }

    proptest! {
        /// Differences of the energy agree with the gradient to the differences' own error.
        #[test]
        fn gradient_is_the_derivative_of_the_energy(pose in pose(), d in direction()) {
            for (rule, model) in laws().filter(|law| law.1.has_potential()) {
                let e = element_for(rule, model);
                let g = flat(&e.gradient(rule, &pose.view()));
                let u = e.energy(rule, &pose.view());
                let error = derivative(|h| e.energy(rule, &pose.moved(&d, h).view())) - g.dot(&d);
                prop_assert!(error.abs() < 1e-8 * (u + g.norm()), "{rule:?} {model:?} error {error}");
            }
        }

        /// Differences of the gradient agree with the stiffness to the differences' own error.
        #[test]
        fn stiffness_is_the_derivative_of_the_gradient(pose in pose(), d in direction()) {
            for (rule, model) in laws() {
                let e = element_for(rule, model);
                let (g, k) = e.stiffness(rule, &pose.view());
                let again = e.gradient(rule, &pose.view());
                prop_assert_eq!(flat(&g), flat(&again));
                let difference = derivative(|h| flat(&e.gradient(rule, &pose.moved(&d, h).view())));
                let error = (difference - k * d).norm();
                prop_assert!(error < 1e-8 * (k * d).norm().max(k.norm() * 0.1), "{rule:?} {model:?} error {:e}", error / k.norm());
            }
        }

        /// Differences of the strain agree with its derivative to the differences' own error.
        #[test]
        fn strain_derivative_is_the_derivative(pose in pose(), d in direction()) {
            for rule in RULES {
                let l = element().length;
                let flat = |s: ElementStrain| {
                    let mut out = SMatrix::<f64, 9, 1>::zeros();
                    for (at, v) in [s.linear[0], s.linear[1], s.curvature * l].iter().enumerate() {
                        out.fixed_rows_mut::<3>(3 * at).copy_from(v);
                    }
                    out
                };
                let (strain, b) = rule.strain_derivative(l, &pose.view());
                let again = rule.strain(l, &pose.view());
                prop_assert!((flat(strain) - flat(again)).norm() < 1e-14 * flat(again).norm());
                let mut along = b * d;
                let mut curvature = along.fixed_rows_mut::<3>(6);
                curvature *= l;
                let difference = derivative(|h| flat(rule.strain(l, &pose.moved(&d, h).view())));
                let error = (difference - along).norm();
                prop_assert!(error < 1e-8 * (1.0 + along.norm()), "{rule:?} error {error:e}");
            }
        }

        /// Under the stress of its own pose an element has its own gradient and stiffness, and the gradient is `Bᵀ` times
        /// the stress; under any other stress the stiffness is the derivative of that product.
        #[test]
        fn given_stress_acts_like_ones_own(pose in pose(), other in pose(), d in direction()) {
            for rule in RULES {
                let e = element_for(rule, RodModel::Standard);
                let (strain, b) = rule.strain_derivative(e.length, &pose.view());
                let elsewhere = rule.strain(e.length, &other.view());
                let own = e.interval_stress([&strain, &strain], [0.3, 0.7]);
                let (g, k) = e.stiffness(rule, &pose.view());
                let (g, again) = (flat(&g), flat(&e.gradient_under(rule, &pose.view(), &own)));
                prop_assert!((g - again).norm() < 1e-13 * (1.0 + g.norm()));
                let k_again = e.stiffness_under(rule, &pose.view(), &own, 1.0);
                prop_assert!((k - k_again).norm() < 1e-13 * k.norm());

                let stress = |strain: &ElementStrain| e.interval_stress([strain, &elsewhere], [1.4, -0.9]);
                let given = stress(&strain);
                let pulled = |b: &StrainDerivative, s: &IntervalStress| {
                    b.fixed_rows::<3>(0).tr_mul(&s.linear[0]) * (0.5 * e.length)
                        + b.fixed_rows::<3>(3).tr_mul(&s.linear[1]) * (0.5 * e.length)
                        + b.fixed_rows::<3>(6).tr_mul(&s.angular) * e.length
                };
                let under = flat(&e.gradient_under(rule, &pose.view(), &given));
                prop_assert!((pulled(&b, &given) - under).norm() < 1e-13 * (1.0 + under.norm()));
                let tangent = e.stiffness_under(rule, &pose.view(), &given, 1.4);
                let difference = derivative(|h| {
                    let moved = pose.moved(&d, h);
                    let s = rule.strain(e.length, &moved.view());
                    flat(&e.gradient_under(rule, &moved.view(), &stress(&s)))
                });
                let error = (difference - tangent * d).norm();
                prop_assert!(error < 1e-8 * (tangent * d).norm().max(tangent.norm() * 0.1), "{rule:?} {error:e}");
                // Only the other end moves: B of this end, C, and B of the other one.
                let there = rule.strain_derivative(e.length, &other.view()).1;
                let moved_stress = derivative(|h| {
                    let s = rule.strain(e.length, &other.moved(&d, h).view());
                    flat(&e.gradient_under(rule, &pose.view(), &e.interval_stress([&strain, &s], [1.4, -0.9])))
                });
                let coupled = e.coupling(&b, &there) * d * -0.9;
                let error = (moved_stress - coupled).norm();
                prop_assert!(error < 1e-8 * (1.0 + coupled.norm()), "{rule:?} {error:e}");
            }
        }

        /// The paper's model is the standard one with `C₁/e` and `C₂/e³`, gradient and energy.
        #[test]
        fn dilatation_freezes_the_stretch(pose in pose()) {
            for rule in RULES {
                let thinned = element_for(rule, RodModel::Dilatation);
                let v = rule.strain(thinned.length, &pose.view()).linear[0];
                let e = v.norm() / thinned.rest.linear[0].norm();
                let scaled = Element {
                    model: RodModel::Standard,
                    linear_stiffness: thinned.linear_stiffness / e,
                    angular_stiffness: thinned.angular_stiffness / e.powi(3),
                    ..thinned
                };
                let (g, expected) = [thinned, scaled].map(|element| flat(&element.gradient(rule, &pose.view()))).into();
                prop_assert!((g - expected).norm() < 1e-13 * (1.0 + expected.norm()));
                let (u, expected) = [thinned, scaled].map(|element| element.energy(rule, &pose.view())).into();
                prop_assert!((u - expected).abs() < 1e-13 * (1.0 + expected));
            }
        }

        /// A rigid motion of both ends changes neither the energy nor, seen from the bodies, the moments.
        #[test]
        fn energy_is_objective(pose in pose(), turn in proptest::array::uniform3(-3.0..3.0f64)) {
            let turn = exp(&Vector3::from(turn));
            let moved = Pose { dx: turn * pose.dx, a: turn * pose.a, b: turn * pose.b };
            for (rule, model) in laws() {
                let e = element_for(rule, model);
                let (u, u_moved) = (e.energy(rule, &pose.view()), e.energy(rule, &moved.view()));
                prop_assert!((u - u_moved).abs() < 1e-12 * (1.0 + u));
                let (g, g_moved) = (e.gradient(rule, &pose.view()), e.gradient(rule, &moved.view()));
                prop_assert!((turn * g.force - g_moved.force).norm() < 1e-11 * (1.0 + g.force.norm()));
                prop_assert!((g.moment_a - g_moved.moment_a).norm() < 1e-11);
                prop_assert!((g.moment_b - g_moved.moment_b).norm() < 1e-11);
                // Balance of moments about node a: R_a M_a + R_b M_b + dx × F = 0.
                let balance = pose.a * g.moment_a + pose.b * g.moment_b + pose.dx.cross(&g.force);
                prop_assert!(balance.norm() < 1e-12);
            }
        }
    }

    /// Pure stretching, both models with dilatation: the axial force is `EA (e - 1)/e`, the paper's law.
    #[test]
    fn stretching_obeys_the_law_of_the_paper() {
        let element = Element {
            rest: ElementStrain {
                linear: [Vector3::z(); 2],
                curvature: Vector3::zeros(),
            },
            ..element()
        };
        for (rule, model) in laws().filter(|law| law.1 != RodModel::Standard) {
            for e in [0.05, 0.7, 1.0 - 1e-9, 1.0, 1.3, 5.0] {
                let pose = Pose {
                    dx: Vector3::z() * (e * element.length),
                    a: Matrix3::identity(),
                    b: Matrix3::identity(),
                };
                let force = Element { model, ..element }
                    .gradient(rule, &pose.view())
                    .force;
                let law = element.linear_stiffness.z * (e - 1.0) / e;
                assert!((force - Vector3::z() * law).norm() < 1e-13 * (1.0 + law.abs()));
            }
        }
    }
}
