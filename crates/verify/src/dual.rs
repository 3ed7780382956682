//! Forward-mode differentiation of an element's strain and energy: a second route to the forces, which shares nothing with the analytic
//! derivatives of integrator and solver.

use std::ops::{Add, Div, Mul, Neg, Sub};

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use pulp::Arch;

use mechanics::element::{Element, ElementPose};
use mechanics::{
    Cable, Density, Learned, LearnedBasis, LearnedStrains, Magnet, OfPose, PlacedFunction,
    PlacedPoint, Pose, RodModel, StrainRule,
};

/// Number of directions: of `y = R_aᵀ dx`, and `η` of `A = R_aᵀ R_b`, which moves to `A (I + η̂)`. Strains depend on the pose through these
/// only.
const DIRECTIONS: usize = 6;
/// Number of directions of the pose: `δdx`, `η_a`, `η_b`.
const POSE_DIRECTIONS: usize = 9;

/// A value with its derivatives along the directions of an element.
#[derive(Clone, Copy, Debug)]
struct Dual {
    value: f64,
    slope: [f64; DIRECTIONS],
}

impl Dual {
    #[inline(always)]
    fn constant(value: f64) -> Self {
        Self {
            value,
            slope: [0.0; DIRECTIONS],
        }
    }

    /// Applies the chain rule: returns `f(self)` from the value and derivative of `f`.
    #[inline(always)]
    fn chain(self, value: f64, derivative: f64) -> Self {
        let mut slope = self.slope;
        for s in &mut slope {
            *s *= derivative;
        }
        Self { value, slope }
    }

    #[inline(always)]
    fn ln(self) -> Self {
        self.chain(self.value.ln(), 1.0 / self.value)
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.chain(root, 0.5 / root)
    }

    #[inline(always)]
    fn scale(self, factor: f64) -> Self {
        self.chain(self.value * factor, factor)
    }
}

impl Add for Dual {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        let mut slope = self.slope;
        for (s, o) in slope.iter_mut().zip(other.slope) {
            *s += o;
        }
        Self {
            value: self.value + other.value,
            slope,
        }
    }
}

impl Neg for Dual {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.scale(-1.0)
    }
}

impl Sub for Dual {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self + (-other)
    }
}

impl Mul for Dual {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        let mut slope = self.slope;
        for (s, o) in slope.iter_mut().zip(other.slope) {
            *s = *s * other.value + self.value * o;
        }
        Self {
            value: self.value * other.value,
            slope,
        }
    }
}

impl Div for Dual {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let inverse = 1.0 / other.value;
        self * other.chain(inverse, -inverse * inverse)
    }
}

type Vector = [Dual; 3];

/// Returns the vector of three entries. `map` of an array is compiled as a call that moves its entries through memory.
#[inline(always)]
fn vector(entry: impl Fn(usize) -> Dual) -> Vector {
    [entry(0), entry(1), entry(2)]
}

#[inline(always)]
fn cross(a: &Vector, b: &Vector) -> Vector {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

#[inline(always)]
fn dot(a: &Vector, b: &Vector) -> Dual {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn times(a: &Vector, factor: Dual) -> Vector {
    vector(|i| a[i] * factor)
}

/// Returns `½ Σ stiffness_i (strain_i - rest_i)²`.
#[inline(always)]
fn quadratic(strain: &Vector, rest: &Vector3<f64>, stiffness: &Vector3<f64>) -> Dual {
    let mut sum = Dual::constant(0.0);
    for i in 0..3 {
        let e = strain[i] - Dual::constant(rest[i]);
        sum = sum + (e * e).scale(0.5 * stiffness[i]);
    }
    sum
}

/// Returns the unit quaternion of a rotation by less than half a turn: `w = ½ sqrt(1 + tr A)`, `v = skew(A) / (4 w)`.
#[inline(always)]
fn quaternion(a: &[[Dual; 3]; 3]) -> (Dual, Vector) {
    let trace = a[0][0] + a[1][1] + a[2][2];
    let w = (Dual::constant(1.0) + trace).sqrt().scale(0.5);
    let quarter = Dual::constant(0.25) / w;
    let skew = [a[2][1] - a[1][2], a[0][2] - a[2][0], a[1][0] - a[0][1]];
    (w, times(&skew, quarter))
}

/// Returns `2 asin(√s)/√s`, the factor from a quaternion's vector part to the rotation vector, with its derivative.
#[inline(always)]
fn rotation_factor(s: f64) -> (f64, f64) {
    if s < 1e-4 {
        // asin series in s: 1 + s/6 + 3s²/40 + 15s³/336
        return (
            2.0 * (1.0 + s / 6.0 + 3.0 * s * s / 40.0 + 15.0 * s * s * s / 336.0),
            2.0 * (1.0 / 6.0 + 3.0 * s / 20.0 + 45.0 * s * s / 336.0),
        );
    }
    let root = s.sqrt();
    let value = 2.0 * root.min(1.0).asin() / root;
    (value, (1.0 / (1.0 - s).sqrt() - 0.5 * value) / s)
}

/// Returns `(1 - (θ/2) cot(θ/2))/θ²` as a function of `t = θ²`, with its derivative.
#[inline(always)]
fn bending_factor(t: f64) -> (f64, f64) {
    if t < 1e-2 {
        return (
            1.0 / 12.0 + t / 720.0 + t * t / 30_240.0 + t * t * t / 1_209_600.0,
            1.0 / 720.0 + t / 15_120.0 + t * t / 403_200.0 + t * t * t / 11_975_040.0,
        );
    }
    let half = 0.5 * t.sqrt();
    let cot = 1.0 / half.tan();
    let value = (1.0 - half * cot) / t;
    // d(half cot half)/dt by the chain rule through half = √t/2.
    let inner = (cot - half * (1.0 + cot * cot)) / (8.0 * half);
    (value, (-inner - value) / t)
}

/// Returns the elastic energy, J.
#[must_use]
pub fn energy_value(element: &Element, rule: StrainRule, pose: &ElementPose) -> f64 {
    energy(element, rule, &Relative::of(pose)).value
}

/// Returns the gradient `(F, M_a, M_b)` of an element's energy, by differentiating the energy; at frozen dilatation under the paper's
/// model. It does not depend on the instruction set.
#[must_use]
pub fn gradient(element: &Element, rule: StrainRule, pose: &ElementPose) -> [Vector3<f64>; 3] {
    let relative = Relative::of(pose);
    let energy = Arch::new().dispatch(
        #[inline(always)]
        || energy(element, rule, &relative),
    );
    relative.along_pose(&energy.slope, pose)
}

/// Returns the strain `(v_a, v_b, κ)` of an element and its derivative along `(δx_b - δx_a, η_a, η_b)`.
#[must_use]
pub fn strain(
    length: f64,
    rule: StrainRule,
    pose: &ElementPose,
) -> (
    SVector<f64, POSE_DIRECTIONS>,
    SMatrix<f64, POSE_DIRECTIONS, POSE_DIRECTIONS>,
) {
    let relative = Relative::of(pose);
    let Strain { linear, curvature } = Strain::of(length, rule, &relative);
    let all = [linear[0], linear[1], curvature];
    let entry = |i: usize| all[i / 3][i % 3];
    let mut derivative = SMatrix::<f64, POSE_DIRECTIONS, POSE_DIRECTIONS>::zeros();
    for i in 0..POSE_DIRECTIONS {
        let parts = relative.along_pose(&entry(i).slope, pose);
        for (at, part) in parts.iter().enumerate() {
            derivative
                .fixed_view_mut::<1, 3>(i, 3 * at)
                .copy_from(&part.transpose());
        }
    }
    (SVector::from_fn(|i, _| entry(i).value), derivative)
}

/// Returns the coordinate of an actuator at a point, the mean over both ends of the element, and its derivative along `(v_a, v_b, κ)`.
pub(super) fn coordinate(
    point: &PlacedPoint,
    strain: &SVector<f64, POSE_DIRECTIONS>,
) -> (f64, SVector<f64, POSE_DIRECTIONS>) {
    let mut value = 0.0;
    let mut slope = SVector::<f64, POSE_DIRECTIONS>::zeros();
    for end in 0..2 {
        let of = |i: usize, at: usize| {
            let mut out = Dual::constant(strain[at]);
            out.slope[i] = 1.0;
            out
        };
        let v: Vector = vector(|i| of(i, 3 * end + i));
        let kappa: Vector = vector(|i| of(3 + i, 6 + i));
        let own = along_line(point, &v, &kappa).scale(0.5 * point.weight);
        value += own.value;
        for i in 0..3 {
            slope[3 * end + i] += own.slope[i];
            slope[6 + i] += own.slope[3 + i];
        }
    }
    (value, slope)
}

/// Returns the value of a function of a node's pose and its gradient, along the position and along the rotation `R exp(ζ̂)`; the gradient
/// is that of a function that softarm knows, otherwise zero.
pub(super) fn of_pose(
    own: &PlacedFunction,
    x: &Vector3<f64>,
    r: &Matrix3<f64>,
) -> (f64, [Vector3<f64>; 2]) {
    let position: Vector = vector(|i| {
        let mut out = Dual::constant(x[i]);
        out.slope[i] = 1.0;
        out
    });
    // R exp(ζ̂) v = R v + R (ζ × v)
    let turned = |v: &Vector3<f64>| -> Vector {
        let (value, slope) = (r * v, r * v.cross_matrix());
        vector(|i| {
            let mut out = Dual::constant(value[i]);
            for j in 0..3 {
                out.slope[3 + j] = -slope[(i, j)];
            }
            out
        })
    };
    let value = match &own.function {
        OfPose::Magnet(Magnet {
            moment,
            field,
            gradient,
            center,
        }) => {
            let from = vector(|i| position[i] - Dual::constant(center[i]));
            let field = vector(|i| {
                let slope = vector(|j| Dual::constant(gradient[(i, j)]));
                Dual::constant(field[i]) + dot(&slope, &from)
            });
            dot(&turned(moment), &field)
        }
        OfPose::Cable(Cable { offset, anchor }) => {
            let lever = turned(offset);
            let way = vector(|i| position[i] + lever[i] - Dual::constant(anchor[i]));
            -dot(&way, &way).sqrt()
        }
        OfPose::Own(function) => Dual::constant(function.0.value(&Pose {
            position: *x,
            rotation: *r,
        })),
    };
    let part = |from: usize| Vector3::from_fn(|i, _| value.slope[from + i]);
    (value.value, [part(0), part(3)])
}

/// Returns the density of an actuator, of the tangent `p = v + κ × d + d'` of its line and of the twist.
fn along_line(point: &PlacedPoint, v: &Vector, kappa: &Vector) -> Dual {
    let constant = |[x, y]: [f64; 2]| vector(|i| Dual::constant([x, y, 0.0][i]));
    let turned = cross(kappa, &constant(point.offset));
    let slope = constant(point.slope);
    let p: Vector = vector(|i| v[i] + turned[i] + slope[i]);
    let stretch = dot(&p, &p).sqrt();
    match &point.density {
        Density::Shortening => -stretch,
        &Density::Threaded { spacing, clearance } => {
            let bent = kappa[0] * kappa[0] + kappa[1] * kappa[1];
            let mut shorter = bent.scale(spacing * spacing / 24.0);
            if clearance > 0.0 {
                // Where the arc between two disks is as high as the clearance.
                let least = 8.0 * clearance / spacing.powi(2);
                let size = (bent + Dual::constant(least * least)).sqrt();
                shorter = shorter + (size - Dual::constant(least)).scale(clearance);
            }
            shorter - stretch
        }
        Density::Lengthening => stretch,
        Density::Volume => p[2],
        Density::Muscle => {
            // The zeros of the force between which the muscle pulls.
            let (from, to) = (0.577_292_198_778_78, 1.595_965_216_125_02);
            let bounded = if stretch.value < from {
                Dual::constant(from)
            } else if stretch.value > to {
                Dual::constant(to)
            } else {
                stretch
            };
            let work = |x: Dual| {
                let mut sum = Dual::constant(0.0);
                let mut power = x;
                for (n, coefficient) in [-6.44, 18.01, -13.64, 3.06].into_iter().enumerate() {
                    sum = sum + power.scale(coefficient / (n + 1) as f64);
                    power = power * x;
                }
                sum
            };
            work(Dual::constant(1.0)) - work(bounded)
        }
        Density::Learned(own) => -learned(own, point.offset, v, kappa),
        &Density::Braid { fibre, turns } => {
            let whole = Dual::constant(2.0 * std::f64::consts::PI * turns) + kappa[2];
            let radius = (Dual::constant(fibre * fibre) - stretch * stretch) / (whole * whole);
            (stretch * radius).scale(std::f64::consts::PI)
        }
    }
}

/// Returns `(1 - ρ)⁶ (35 ρ² + 18 ρ + 3)/3 = 1 - 28/3 ρ² + 70 ρ⁴ - 448/3 ρ⁵ + 140 ρ⁶ - 64 ρ⁷ + 35/3 ρ⁸` and its derivative along `ρ²`.
fn wendland(square: f64) -> (f64, f64) {
    let even = [1.0, -28.0 / 3.0, 70.0, 140.0, 35.0 / 3.0];
    let (mut value, mut slope) = (0.0, 0.0);
    // Horner's rule with its derivative.
    for coefficient in even.into_iter().rev() {
        slope = slope * square + value;
        value = value * square + coefficient;
    }
    let cube = square * square.sqrt();
    value -= square * cube * (448.0 / 3.0 + 64.0 * square);
    slope -= cube * (448.0 / 3.0 * 2.5 + 64.0 * 3.5 * square);
    (value, slope)
}

/// Returns the learned potential per length, of the strains of a section and the offset of a point in it.
fn learned(own: &Learned, offset: [f64; 2], v: &Vector, kappa: &Vector) -> Dual {
    let [d, e] = match own.strains {
        // κ₂ d - κ₁ e is then κ₁, and κ₁ d + κ₂ e is κ₂.
        LearnedStrains::OfSection => [0.0, -1.0],
        LearnedStrains::OfLine => {
            let length = offset[0].hypot(offset[1]).max(f64::MIN_POSITIVE);
            [offset[0] / length, offset[1] / length]
        }
    };
    let across = match own.strains {
        LearnedStrains::OfSection => kappa[1],
        LearnedStrains::OfLine => kappa[0].scale(d) + kappa[1].scale(e),
    };
    let x = [
        kappa[1].scale(d) - kappa[0].scale(e),
        across,
        kappa[2],
        v[2] - Dual::constant(1.0),
    ];
    let mut sum = Dual::constant(0.0);
    for (j, weight) in own.weights.iter().enumerate() {
        let value = match &own.basis {
            LearnedBasis::Radial {
                inverse_radii,
                centers,
            } => {
                let mut square = Dual::constant(0.0);
                for ((x, inverse), center) in x.iter().zip(inverse_radii).zip(&centers[j]) {
                    let part = (*x - Dual::constant(*center)).scale(*inverse);
                    square = square + part * part;
                }
                if square.value >= 1.0 {
                    continue;
                }
                let (value, slope) = wendland(square.value);
                square.chain(value, slope)
            }
            LearnedBasis::Ridge { slopes, offsets } => {
                let mut z = Dual::constant(offsets[j]);
                for (x, slope) in x.iter().zip(&slopes[j]) {
                    z = z + x.scale(*slope);
                }
                let size = z.value.hypot(1.0);
                z.chain(size - 1.0, z.value / size)
            }
        };
        sum = sum + value.scale(*weight);
    }
    sum
}

/// The pose of an element: chord and relative rotation.
struct Relative {
    /// `R_aᵀ dx`
    difference: Vector3<f64>,
    /// `R_aᵀ R_b`
    turn: Matrix3<f64>,
}

impl Relative {
    #[inline(always)]
    fn of(pose: &ElementPose) -> Self {
        Self {
            difference: pose.rotation_a.tr_mul(&pose.dx),
            turn: pose.rotation_a.tr_mul(pose.rotation_b),
        }
    }

    /// Returns the derivatives along `δdx`, `η_a` and `η_b`, on which the element's own directions depend as `δy = R_aᵀ δdx + y × η_a` and
    /// `η = η_b - Aᵀ η_a`.
    #[inline(always)]
    fn along_pose(&self, slope: &[f64; DIRECTIONS], pose: &ElementPose) -> [Vector3<f64>; 3] {
        let [shift, turn] = [0, 3].map(|at| Vector3::new(slope[at], slope[at + 1], slope[at + 2]));
        [
            pose.rotation_a * shift,
            shift.cross(&self.difference) - self.turn * turn,
            turn,
        ]
    }
}

/// The measures of an [`ElementStrain`](mechanics::element::ElementStrain).
struct Strain {
    linear: [Vector; 2],
    curvature: Vector,
}

impl Strain {
    #[inline(always)]
    fn of(length: f64, rule: StrainRule, relative: &Relative) -> Self {
        let turn = &relative.turn;
        let mut a = [[Dual::constant(0.0); 3]; 3];
        for (i, row) in a.iter_mut().enumerate() {
            for (j, entry) in row.iter_mut().enumerate() {
                entry.value = turn[(i, j)];
                // Columns of A ê_c: A_{c+2} in column c + 1, -A_{c+1} in column c + 2, none in column c.
                entry.slope[3 + (j + 1) % 3] = -turn[(i, (j + 2) % 3)];
                entry.slope[3 + (j + 2) % 3] = turn[(i, (j + 1) % 3)];
            }
        }
        let (w, v) = quaternion(&a);
        let near = start_difference(&relative.difference);
        let inverse_length = 1.0 / length;
        match rule {
            StrainRule::Helical => {
                let s = dot(&v, &v);
                let (factor, slope) = rotation_factor(s.value);
                let psi = times(&v, s.chain(factor, slope));
                let t = dot(&psi, &psi);
                let (c, c_slope) = bending_factor(t.value);
                let turned = cross(&psi, &near);
                let twice = cross(&psi, &turned);
                let c = t.chain(c, c_slope);
                let strain: Vector = vector(|i| {
                    (near[i] - turned[i].scale(0.5) + c * twice[i]).scale(inverse_length)
                });
                Self {
                    linear: [strain; 2],
                    curvature: vector(|i| psi[i].scale(inverse_length)),
                }
            }
            StrainRule::Trapezoidal => {
                let far = end_difference(relative);
                Self {
                    linear: [
                        vector(|i| near[i].scale(inverse_length)),
                        vector(|i| far[i].scale(inverse_length)),
                    ],
                    curvature: vector(|i| (v[i] / w).scale(2.0 * inverse_length)),
                }
            }
        }
    }
}

#[inline(always)]
fn energy(element: &Element, rule: StrainRule, relative: &Relative) -> Dual {
    let Strain { linear, curvature } = Strain::of(element.length, rule, relative);
    let side = |end: usize| {
        let rest = &element.rest.linear[end];
        quadratic(&linear[end], rest, &element.linear_stiffness)
    };
    let (near, far) = (side(0), side(1));
    let angular = quadratic(
        &curvature,
        &element.rest.curvature,
        &element.angular_stiffness,
    );
    density(element, &linear[0], (near + far).scale(0.5), angular).scale(element.length)
}

/// Returns the energy per rest length with the dilatation `|v|/|v_rest|` of the model, which is a constant under the paper's model.
#[inline(always)]
fn density(element: &Element, strain: &Vector, linear: Dual, angular: Dual) -> Dual {
    let rest = element.rest.linear[0].norm();
    let e = dot(strain, strain).sqrt().scale(1.0 / rest);
    let e = match element.model {
        RodModel::Standard => return linear + angular,
        RodModel::Dilatation => Dual::constant(e.value),
        RodModel::Consistent => e,
    };
    let thinned = linear / e + angular / (e * e * e);
    if element.model == RodModel::Dilatation {
        return thinned;
    }
    let u = e - Dual::constant(1.0);
    let completion = u - e.ln() - (u * u / e).scale(0.5);
    thinned + completion.scale(element.linear_stiffness.z * rest * rest)
}

/// Returns `y = R_aᵀ dx` with its derivatives.
#[inline(always)]
fn start_difference(y: &Vector3<f64>) -> Vector {
    vector(|i| {
        let mut out = Dual::constant(y[i]);
        out.slope[i] = 1.0;
        out
    })
}

/// Returns `R_bᵀ dx = Aᵀ y` with its derivatives.
#[inline(always)]
fn end_difference(relative: &Relative) -> Vector {
    let Relative { difference, turn } = relative;
    let y = turn.tr_mul(difference);
    // δ(Aᵀ y) = Aᵀ δy + (Aᵀ y) × η
    let turning = y.cross_matrix();
    vector(|i| {
        let mut out = Dual::constant(y[i]);
        for j in 0..3 {
            out.slope[j] = turn[(j, i)];
            out.slope[3 + j] = turning[(i, j)];
        }
        out
    })
}
