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
//! The element's [model](RodModel) determines which stress follows from a strain. Under [`RodModel::Dilatation`] the "energy" is that of
//! the paper's (86) and the "gradient" its derivative at frozen dilatation, which has no potential.
//!
//! `helical.rs` and `trapezoidal.rs` have the formulas of the two rules, for any number of elements at a time, one in each lane of a
//! vector; the methods of [`Element`] and [`StrainRule`] are the same code with one lane. `law.rs` has the stress that follows from a
//! strain.

mod active;
pub mod helical;
mod law;
pub mod learned;
pub mod rule;
pub(crate) mod trapezoidal;

use nalgebra::{Matrix3, SMatrix, Vector3};
use pulp::Scalar;

pub use self::active::Density;
pub use self::active::{ActivePoint, ActiveTangent};
pub use self::law::RodModel;
pub use self::law::Thinning;
pub use self::rule::{
    AnyTurn, Blocks, Displacement, Elasticity, Helical, MildTurn, Stress, TangentRule, Trapezoidal,
    Turns, stiffness_under,
};
use crate::logarithm::Logarithm;
use crate::rotation::{self, InverseTangentCoefficients, log_tangent};
use crate::vector::{Lanes, Mat3, Quaternion, Vec3};

/// The rule by which the strains of an element follow from its two nodes.
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

/// Relative pose of an element's ends, from which both rules compute strains.
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

impl ElementStrain {
    /// Returns the mean of two strains.
    #[must_use]
    pub fn mean(&self, other: &Self) -> Self {
        Self {
            linear: [0, 1].map(|end| 0.5 * (self.linear[end] + other.linear[end])),
            curvature: 0.5 * (self.curvature + other.curvature),
        }
    }
}

/// Stress of one element over an [interval](super::implicit), conjugate to an [`ElementStrain`]: the energy changes by
/// `l/2 Σ_ends n·δv + l m·δκ`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntervalStress {
    /// `n` at node a and at node b, body frame, N. Equal under the helical rule.
    pub linear: [Vector3<f64>; 2],
    /// `m`, body frame, N m.
    pub angular: Vector3<f64>,
}

/// Stiffness and stress-free strain of one element.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Element {
    /// The model of the section: how the dilatation enters the stress.
    pub model: RodModel,
    /// Rest length `l`, m.
    pub length: f64,
    /// `diag(GA, GA, EA)`, N.
    pub linear_stiffness: Vector3<f64>,
    /// `diag(EI₁, EI₂, GJ)`, N m².
    pub angular_stiffness: Vector3<f64>,
    /// Strain of the stress-free element.
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
    /// Returns the name in scene and result files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Helical => "helical",
            Self::Trapezoidal => "trapezoidal",
        }
    }

    /// Returns the number of ends at which the linear strain is taken; that at one is the same at both.
    #[must_use]
    pub fn n_ends(self) -> usize {
        match self {
            Self::Helical => Helical::ENDS,
            Self::Trapezoidal => Trapezoidal::ENDS,
        }
    }

    /// Returns the weight of an end at which the linear strain is taken.
    #[must_use]
    pub fn end_weight(self) -> f64 {
        match self {
            Self::Helical => Helical::END_WEIGHT,
            Self::Trapezoidal => Trapezoidal::END_WEIGHT,
        }
    }

    /// Returns the strains of an element of rest length `length` in the given pose.
    #[must_use]
    pub fn strain(self, length: f64, pose: &ElementPose) -> ElementStrain {
        match self {
            Self::Helical => strain_of::<Helical>(length, &posed::<Helical>(pose)),
            Self::Trapezoidal => strain_of::<Trapezoidal>(length, &posed::<Trapezoidal>(pose)),
        }
    }

    /// Returns [`Self::strain`] and its derivative.
    #[must_use]
    pub fn strain_derivative(
        self,
        length: f64,
        pose: &ElementPose,
    ) -> (ElementStrain, StrainDerivative) {
        match self {
            Self::Helical => derivative_of::<Helical>(length, &posed::<Helical>(pose)),
            Self::Trapezoidal => derivative_of::<Trapezoidal>(length, &posed::<Trapezoidal>(pose)),
        }
    }
}

/// Returns the data of a rule for a pose, in one lane.
fn posed<R: TangentRule>(pose: &ElementPose) -> R::Pose<Scalar> {
    let [a, b] = [pose.rotation_a, pose.rotation_b].map(Mat3::of_matrix);
    pose_of_any_turn::<R>(Vec3::splat(Scalar, &pose.dx), a, b)
}

/// Returns the data of a rule for a pose whose ends are turned against each other by any angle up to half a turn.
pub(crate) fn pose_of_any_turn<R: TangentRule>(
    dx: Vec3<Scalar>,
    a: Mat3<Scalar>,
    b: Mat3<Scalar>,
) -> R::Pose<Scalar> {
    let q = rotation::quaternion(&a.matrix().tr_mul(&b.matrix()));
    let relative = Quaternion {
        w: Lanes::splat(Scalar, q.w),
        v: Vec3::splat(Scalar, &q.imag()),
    };
    R::pose_at(dx, a, b, relative)
}

impl Turns<Scalar> for AnyTurn {
    fn pose<R: TangentRule>(dx: Vec3<Scalar>, a: Mat3<Scalar>, b: Mat3<Scalar>) -> R::Pose<Scalar> {
        pose_of_any_turn::<R>(dx, a, b)
    }
}

fn strain_of<R: TangentRule>(length: f64, pose: &R::Pose<Scalar>) -> ElementStrain {
    let Stress { linear, angular } = R::strain(pose);
    ElementStrain {
        linear: linear.map(|v| v.vector() / length),
        curvature: angular.vector() / length,
    }
}

fn derivative_of<R: TangentRule>(
    length: f64,
    pose: &R::Pose<Scalar>,
) -> (ElementStrain, StrainDerivative) {
    let mut rows = R::derivative(pose);
    if R::ENDS == 1 {
        // The one linear strain belongs to both ends.
        rows[1] = rows[0];
    }
    (strain_of::<R>(length, pose), nine_by_nine(&rows) / length)
}

pub fn nine_by_nine(blocks: &Blocks<Scalar>) -> SMatrix<f64, 9, 9> {
    let mut out = SMatrix::<f64, 9, 9>::zeros();
    for (i, row) in blocks.iter().enumerate() {
        for (j, block) in row.iter().enumerate() {
            let mut part = out.fixed_view_mut::<3, 3>(3 * i, 3 * j);
            part.copy_from(&block.matrix());
        }
    }
    out
}

/// Returns the blocks of a 9×9 matrix.
pub fn blocks_of(matrix: &SMatrix<f64, 9, 9>) -> Blocks<Scalar> {
    let block = |i: usize, j: usize| matrix.fixed_view::<3, 3>(3 * i, 3 * j).into_owned();
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| Mat3::of_matrix(&block(i, j))))
}

/// Returns a stress in the scale of a rule.
fn scaled<R: TangentRule>(linear: &[Vector3<f64>; 2], angular: &Vector3<f64>) -> Stress<Scalar> {
    Stress {
        linear: linear.map(|n| Vec3::splat(Scalar, &n) * R::END_WEIGHT),
        angular: Vec3::splat(Scalar, angular),
    }
}

fn gradient_of<R: TangentRule>(pose: &R::Pose<Scalar>, stress: &Stress<Scalar>) -> ElementGradient {
    let [force, moment_a, moment_b] = R::pull(pose, stress).map(Vec3::vector);
    ElementGradient {
        force,
        moment_a,
        moment_b,
    }
}

/// Adds `factor` times the terms of a [`StressTangent`](law::StressTangent) along the dilatation. Of rank one or two but for `w ∂²e/∂v²`,
/// they are products of the pull `Bᵀ e'` on the ends of the element and that of the change of the stress.
fn add_thinning<R: TangentRule>(
    tangent: &law::StressTangent,
    pose: &R::Pose<Scalar>,
    factor: f64,
    out: &mut Blocks<Scalar>,
) {
    let (linear, angular) = &tangent.change;
    let change = R::pull(pose, &scaled::<R>(linear, angular));
    let along = R::pull(pose, &scaled::<R>(&tangent.along, &Vector3::zeros()));
    // (change + curve/2 e') e'ᵀ, and its transpose where there is a potential.
    let half_curve = (tangent.completion.as_ref()).map_or(0.0, |(_, curve)| 0.5 * curve);
    let left = [0, 1, 2].map(|i| (change[i] + along[i] * half_curve) * factor);
    for i in 0..3 {
        for j in 0..3 {
            out[i][j] = out[i][j] + Mat3::outer(left[i], along[j]);
        }
    }
    let Some((bend, _)) = &tangent.completion else {
        return;
    };
    let rows = R::derivative(pose);
    for i in 0..3 {
        for j in 0..3 {
            out[i][j] = out[i][j] + Mat3::outer(along[i], left[j]);
        }
    }
    for end in 0..R::ENDS {
        let bend = Mat3::of_matrix(&(bend[end] * (R::END_WEIGHT * factor)));
        for j in 0..3 {
            if !R::PATTERN[end][j] {
                continue;
            }
            let bent = bend.product(rows[end][j]);
            for i in 0..3 {
                if R::PATTERN[end][i] {
                    out[i][j] = out[i][j] + rows[end][i].transposed_product(bent);
                }
            }
        }
    }
}

impl Element {
    /// Returns the elastic energy, J, with the dilatation of the [model](RodModel).
    #[must_use]
    pub fn energy(&self, rule: StrainRule, pose: &ElementPose) -> f64 {
        self.energy_of(&rule.strain(self.length, pose))
    }

    /// Returns internal force (N) and moment (N m), with the dilatation of the [model](RodModel). Components in the body frame: under the
    /// helical rule constant along the element, under the trapezoidal rule means of those in the frames of the ends.
    #[must_use]
    pub fn stress(&self, rule: StrainRule, pose: &ElementPose) -> (Vector3<f64>, Vector3<f64>) {
        let stress = self.stress_of(&rule.strain(self.length, pose));
        (0.5 * (stress.linear[0] + stress.linear[1]), stress.angular)
    }

    /// Returns the gradient of the energy.
    #[inline]
    #[must_use]
    pub fn gradient(&self, rule: StrainRule, pose: &ElementPose) -> ElementGradient {
        match rule {
            StrainRule::Helical => self.gradient_by::<Helical>(pose),
            StrainRule::Trapezoidal => self.gradient_by::<Trapezoidal>(pose),
        }
    }

    pub fn gradient_by<R: TangentRule>(&self, pose: &ElementPose) -> ElementGradient {
        let pose = posed::<R>(pose);
        let stress = self.stress_of(&strain_of::<R>(self.length, &pose));
        gradient_of::<R>(&pose, &scaled::<R>(&stress.linear, &stress.angular))
    }

    /// Returns the gradient of the energy and its derivative.
    #[must_use]
    pub fn stiffness(
        &self,
        rule: StrainRule,
        pose: &ElementPose,
    ) -> (ElementGradient, ElementStiffness) {
        match rule {
            StrainRule::Helical => self.stiffness_by::<Helical>(pose),
            StrainRule::Trapezoidal => self.stiffness_by::<Trapezoidal>(pose),
        }
    }

    /// Returns gradient and stiffness. The stiffness of a thinning section is that at the given stress plus `BᵀTB` with the
    /// [tangent](law::StressTangent) `T` of the stress, whose diagonal is a law by itself.
    fn stiffness_by<R: TangentRule>(
        &self,
        pose: &ElementPose,
    ) -> (ElementGradient, ElementStiffness) {
        let at = posed::<R>(pose);
        let stress = self.stress_of(&strain_of::<R>(self.length, &at));
        let scaled = scaled::<R>(&stress.linear, &stress.angular);
        let law = Elasticity::of::<R>(Scalar, self);
        let stiffness = match self.stress_tangent(&stress) {
            None => R::stiffness_under(&law, &at, &scaled),
            Some(tangent) => {
                let law = Elasticity {
                    c1: law.c1 * tangent.linear,
                    c2: law.c2 * tangent.angular,
                    ..law
                };
                let mut stiffness = R::stiffness_under(&law, &at, &scaled);
                add_thinning::<R>(&tangent, &at, 1.0 / self.length, &mut stiffness);
                stiffness
            }
        };
        (gradient_of::<R>(&at, &scaled), nine_by_nine(&stiffness))
    }

    /// Returns `weights[0] C (s₀ - s_rest) + weights[1] C (s₁ - s_rest)` of two strains, by the standard model.
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

    /// Returns `factor C` times a strain, the standard model's law about the stress-free shape.
    #[must_use]
    pub fn stress_of_strain(&self, strain: &ElementStrain, factor: f64) -> IntervalStress {
        let linear = self.linear_stiffness * factor;
        IntervalStress {
            linear: strain.linear.map(|v| linear.component_mul(&v)),
            angular: (self.angular_stiffness * factor).component_mul(&strain.curvature),
        }
    }

    /// Returns the pull of a given stress on the ends of the element: `Bᵀ` times the stress, which equals [`Self::gradient`] if the stress
    /// is that of the pose.
    #[must_use]
    pub fn gradient_under(
        &self,
        rule: StrainRule,
        pose: &ElementPose,
        stress: &IntervalStress,
    ) -> ElementGradient {
        fn by<R: TangentRule>(pose: &ElementPose, stress: &IntervalStress) -> ElementGradient {
            let scaled = scaled::<R>(&stress.linear, &stress.angular);
            gradient_of::<R>(&posed::<R>(pose), &scaled)
        }
        match rule {
            StrainRule::Helical => by::<Helical>(pose, stress),
            StrainRule::Trapezoidal => by::<Trapezoidal>(pose, stress),
        }
    }

    /// Returns the derivative of [`Self::gradient_under`] if the stress changes with `factor` times the standard model's stiffness.
    #[must_use]
    pub fn stiffness_under(
        &self,
        rule: StrainRule,
        pose: &ElementPose,
        stress: &IntervalStress,
        factor: f64,
    ) -> ElementStiffness {
        match rule {
            StrainRule::Helical => self.stiffness_under_by::<Helical>(pose, stress, factor),
            StrainRule::Trapezoidal => self.stiffness_under_by::<Trapezoidal>(pose, stress, factor),
        }
    }

    fn stiffness_under_by<R: TangentRule>(
        &self,
        pose: &ElementPose,
        stress: &IntervalStress,
        factor: f64,
    ) -> ElementStiffness {
        let law = Elasticity::of::<R>(Scalar, self).times(Lanes::splat(Scalar, factor));
        let scaled = scaled::<R>(&stress.linear, &stress.angular);
        nine_by_nine(&R::stiffness_under(&law, &posed::<R>(pose), &scaled))
    }

    /// Returns `B_startᵀ C B_end` with the weights of the two ends and the length: the derivative of the forces at one instant along the
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
        // This is faster than `tr_mul`, which computes dot products.
        start.transpose() * stressed
    }
}

/// Returns `∂(S(ψ) y)/∂ψ` for `sign = -1` and `∂(S(ψ)ᵀ y)/∂ψ` for `sign = +1`.
///
/// `S^{(T)} y = y + (sign/2) ψ × y + c (ψ (ψ·y) - |ψ|² y)`.
#[inline]
pub fn tangent_derivative(psi: &Vector3<f64>, y: &Vector3<f64>, sign: f64) -> Matrix3<f64> {
    let c = InverseTangentCoefficients::at(psi.norm_squared());
    let log = Logarithm {
        psi: Vec3::splat(Scalar, psi),
        angle_squared: Lanes::splat(Scalar, psi.norm_squared()),
        c: Lanes::splat(Scalar, c.value),
        slope: Lanes::splat(Scalar, c.slope),
        bend: Lanes::splat(Scalar, c.bend),
    };
    helical::tangent_derivative(&log, Vec3::splat(Scalar, y), sign).matrix()
}

/// Returns the symmetric second derivative of `y·log(A)` along body rotations `A exp(ζ)` at `A = exp(ψ)`: the derivative of its gradient
/// `S(ψ) y`, with `δψ = Sᵀ ζ`, made symmetric.
#[must_use]
pub fn log_second_derivative(psi: &Vector3<f64>, y: &Vector3<f64>) -> Matrix3<f64> {
    let m = tangent_derivative(psi, y, -1.0) * log_tangent(psi).transpose();
    0.5 * (m + m.transpose())
}
