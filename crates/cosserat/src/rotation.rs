//! Rotations: the Cayley map of the integrator, the logarithm of the strain rules, and their tangents.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

/// Returns the skew matrix `v̂` with `v̂ w = v × w`.
#[inline]
#[must_use]
pub fn hat(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// Returns the vector of the skew part of `m`: `vee(m) = ½ (m - mᵀ)^∨`, so that `vee(v̂) = v`.
#[inline]
#[must_use]
pub fn vee(m: &Matrix3<f64>) -> Vector3<f64> {
    0.5 * Vector3::new(
        m[(2, 1)] - m[(1, 2)],
        m[(0, 2)] - m[(2, 0)],
        m[(1, 0)] - m[(0, 1)],
    )
}

/// Cayley map `cay(f) = (I - f̂/2)⁻¹ (I + f̂/2) = I + (f̂ + f̂²/2) / (1 + |f|²/4)` (the paper's equation (4)).
///
/// The rotation angle is `2 atan(|f|/2)`: half a turn is at infinity.
#[inline]
#[must_use]
pub fn cay(f: &Vector3<f64>) -> Matrix3<f64> {
    let inverse_alpha = 1.0 / (1.0 + 0.25 * f.norm_squared());
    let f_hat = hat(f);
    Matrix3::identity() + (f_hat + 0.5 * f_hat * f_hat) * inverse_alpha
}

/// Inverse of [`cay`]: `f = 4 vee(R) / (1 + tr R)`.
///
/// Grows without bound as the angle approaches half a turn; infinite or NaN there.
#[inline]
#[must_use]
pub fn cay_inverse(rotation: &Matrix3<f64>) -> Vector3<f64> {
    vee(rotation) * (4.0 / (1.0 + rotation.trace()))
}

/// Body-frame tangent of [`cay`]: the matrix `T` with `cay(f)ᵀ δcay(f) = (T δf)^`,
/// `T = (I - f̂/2) / (1 + |f|²/4)`.
#[inline]
#[must_use]
pub fn cay_tangent(f: &Vector3<f64>) -> Matrix3<f64> {
    (Matrix3::identity() - 0.5 * hat(f)) / (1.0 + 0.25 * f.norm_squared())
}

/// Inverse of [`cay_tangent`]: `δf = P ζ` for a body-frame rotation of `cay(f)`, `P = I + f̂/2 + f fᵀ/4`.
#[inline]
#[must_use]
pub fn cay_inverse_tangent(f: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::identity() + 0.5 * hat(f) + 0.25 * f * f.transpose()
}

/// Exponential map: the rotation by the angle `|v|` about `v`.
#[must_use]
pub fn exp(v: &Vector3<f64>) -> Matrix3<f64> {
    let angle_squared = v.norm_squared();
    let (a, b) = if angle_squared < 1e-4 {
        // Taylor: the first neglected term is angle⁶/5040 and angle⁶/40320, below rounding.
        (
            1.0 - angle_squared / 6.0 * (1.0 - angle_squared / 20.0),
            0.5 - angle_squared / 24.0 * (1.0 - angle_squared / 30.0),
        )
    } else {
        let angle = angle_squared.sqrt();
        // 1 - cos = 2 sin²(angle/2): no cancellation.
        let half_sine = (0.5 * angle).sin();
        (
            angle.sin() / angle,
            2.0 * half_sine * half_sine / angle_squared,
        )
    };
    let v_hat = hat(v);
    Matrix3::identity() + a * v_hat + b * v_hat * v_hat
}

/// Body-frame tangent of [`exp`]: the matrix `T` with `exp(v)ᵀ δexp(v) = (T δv)^`, at any angle `θ = |v|`,
/// `T = I - (1 - cos θ)/θ² v̂ + (θ - sin θ)/θ³ v̂²`.
#[must_use]
pub fn exp_tangent(v: &Vector3<f64>) -> Matrix3<f64> {
    let angle_squared = v.norm_squared();
    let (a, b) = if angle_squared < 0.25 {
        // Taylor, in nested form: the first neglected terms, θ¹²/14! and θ¹²/15!, are below rounding.
        let nested = |first: f64, orders: [f64; 5]| {
            let tail = orders
                .iter()
                .rev()
                .fold(1.0, |sum, n| 1.0 - angle_squared / (n * (n + 1.0)) * sum);
            tail / first
        };
        (
            nested(2.0, [3.0, 5.0, 7.0, 9.0, 11.0]),
            nested(6.0, [4.0, 6.0, 8.0, 10.0, 12.0]),
        )
    } else {
        let angle = angle_squared.sqrt();
        let half_sine = (0.5 * angle).sin();
        (
            2.0 * half_sine * half_sine / angle_squared,
            (angle - angle.sin()) / (angle_squared * angle),
        )
    };
    let v_hat = hat(v);
    Matrix3::identity() - a * v_hat + b * v_hat * v_hat
}

/// Logarithm: the rotation vector of `rotation`, of length at most π.
///
/// Accurate at every angle: beyond about 120 degrees it goes through the unit quaternion, whose vector part does
/// not vanish near half a turn. At exactly half a turn the sign of the axis is arbitrary.
#[inline]
#[must_use]
pub fn log(rotation: &Matrix3<f64>) -> Vector3<f64> {
    let skew = vee(rotation);
    let cosine = 0.5 * (rotation.trace() - 1.0);
    if cosine > -0.5 {
        let sine = skew.norm();
        if sine < 1e-6 {
            // angle/sin(angle) = 1 + sin²/6 + O(sin⁴)
            return skew * (1.0 + sine * sine / 6.0);
        }
        return skew * (sine.atan2(cosine) / sine);
    }
    let q = shorter_way(rotation);
    let imaginary = q.imag();
    let sine_half = imaginary.norm();
    imaginary * (2.0 * sine_half.atan2(q.w) / sine_half)
}

/// Returns the unit quaternion of a rotation with a nonnegative scalar part: that of at most half a turn.
fn shorter_way(rotation: &Matrix3<f64>) -> Quaternion<f64> {
    let q = quaternion(rotation);
    if q.w < 0.0 { -q } else { q }
}

/// Tells whether a logarithm that is followed along a sequence of rotations, each less than half a turn from the one before, ends as the
/// one beyond half a turn, `ψ (1 - 2π/|ψ|)` with `ψ` of [`log`]; `begins` tells this for the first rotation. The sign of a unit quaternion,
/// which has half of the angle, is continuous there.
pub fn is_followed_beyond_half_turn(
    rotations: impl Iterator<Item = Matrix3<f64>>,
    begins: bool,
) -> bool {
    let mut is_beyond = begins;
    let mut before: Option<Quaternion<f64>> = None;
    for rotation in rotations {
        let q = shorter_way(&rotation);
        if before.is_some_and(|before| before.dot(&q) < 0.0) {
            is_beyond = !is_beyond;
        }
        before = Some(q);
    }
    is_beyond
}

/// Returns the unit quaternion (w, i, j, k) of a rotation matrix, with a nonnegative scalar part where that has a meaning.
#[must_use]
pub fn quaternion(rotation: &Matrix3<f64>) -> Quaternion<f64> {
    let r = nalgebra::Rotation3::from_matrix_unchecked(*rotation);
    UnitQuaternion::from_rotation_matrix(&r).into_inner()
}

/// Returns the components of a quaternion, scalar first.
pub fn wxyz(q: &Quaternion<f64>) -> [f64; 4] {
    [q.w, q.i, q.j, q.k]
}

/// Returns the unit quaternion `(1, f/2)/sqrt(1 + |f|²/4)` of [`cay`]`(f)`.
pub fn cayley_quaternion(f: &Vector3<f64>) -> Quaternion<f64> {
    let w = 1.0 / (1.0 + 0.25 * f.norm_squared()).sqrt();
    Quaternion::from_parts(w, f * (0.5 * w))
}

/// Returns the rotation matrix of a quaternion `[w, x, y, z]` of any nonzero length.
#[must_use]
pub fn from_quaternion(wxyz: [f64; 4]) -> Matrix3<f64> {
    let square = |q: [f64; 4]| q.iter().map(|c| c * c).sum::<f64>();
    // Where squares neither overflow nor vanish, no square root is needed.
    let is_near_unity = (0.25..4.0).contains(&square(wxyz));
    let q = if is_near_unity { wxyz } else { unit(wxyz) };
    let [w, x, y, z] = q;
    let s = 2.0 / square(q);
    let [sx, sy, sz] = [s * x, s * y, s * z];
    Matrix3::new(
        1.0 - (sy * y + sz * z),
        sx * y - sz * w,
        sx * z + sy * w,
        sx * y + sz * w,
        1.0 - (sx * x + sz * z),
        sy * z - sx * w,
        sx * z - sy * w,
        sy * z + sx * w,
        1.0 - (sx * x + sy * y),
    )
}

/// Returns a nonzero vector divided by its length; scaled first, so that squares neither overflow nor vanish.
#[must_use]
pub fn unit<const N: usize>(vector: [f64; N]) -> [f64; N] {
    let largest = (vector.iter()).fold(0.0, |largest: f64, component| largest.max(component.abs()));
    let scaled = vector.map(|component| component / largest);
    let length = scaled
        .iter()
        .map(|component| component * component)
        .sum::<f64>()
        .sqrt();
    scaled.map(|component| component / length)
}

/// Returns the smallest rotation that takes `e3` to `direction` (any nonzero length), preceded by `roll` about `e3`.
#[must_use]
pub fn from_direction(direction: &Vector3<f64>, roll: f64) -> Matrix3<f64> {
    let d = Vector3::from(unit((*direction).into()));
    // Rodrigues with axis e3 × d; the antipode turns about e1.
    let minimal = if d.z < -1.0 + 1e-12 {
        Matrix3::new(1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0)
    } else {
        let axis = hat(&Vector3::new(-d.y, d.x, 0.0));
        Matrix3::identity() + axis + axis * axis / (1.0 + d.z)
    };
    minimal * exp(&Vector3::new(0.0, 0.0, roll))
}

/// Returns by how much a matrix is no rotation: the largest entry of `R Rᵀ - 1`, and infinity without a positive determinant.
pub fn stray(rotation: &Matrix3<f64>) -> f64 {
    if !(rotation.determinant() > 0.0) {
        return f64::INFINITY;
    }
    (rotation * rotation.transpose() - Matrix3::identity()).amax()
}

/// Projects a matrix near a rotation toward it: one step `R (3 I - RᵀR)/2` of Newton and Schulz, which squares `RᵀR - I`.
#[must_use]
pub fn orthonormalized(rotation: &Matrix3<f64>) -> Matrix3<f64> {
    let excess = rotation.tr_mul(rotation) - Matrix3::identity();
    rotation - 0.5 * rotation * excess
}

/// The coefficient `c(θ) = (1 - (θ/2) cot(θ/2)) / θ²` of the inverse tangent of the exponential, and its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct InverseTangentCoefficients {
    /// `c`
    pub value: f64,
    /// `c'(θ)/θ`, so that the gradient of `c(|ψ|)` is `slope ψ`.
    pub slope: f64,
    /// Derivative of `slope` divided by θ once more, so that the Hessian of `c(|ψ|)` is `slope I + bend ψψᵀ`.
    pub bend: f64,
}

impl InverseTangentCoefficients {
    /// Evaluates the coefficients at `θ² = |ψ|²`, below `(2π)²`.
    #[inline]
    #[must_use]
    pub fn at(angle_squared: f64) -> Self {
        let t = angle_squared;
        if t < SERIES_LIMIT {
            // Horner for c and its first two derivatives in t = θ².
            let mut value = 0.0;
            let mut first = 0.0;
            let mut half_second = 0.0;
            // Neighbors usually turn by less than 0.2 rad, where six terms are exact to rounding.
            let terms = if t < SHORT_SERIES_LIMIT {
                &INVERSE_TANGENT_SERIES[..6]
            } else {
                &INVERSE_TANGENT_SERIES[..]
            };
            for &coefficient in terms.iter().rev() {
                half_second = half_second * t + first;
                first = first * t + value;
                value = value * t + coefficient;
            }
            return Self {
                value,
                slope: 2.0 * first,
                bend: 8.0 * half_second,
            };
        }
        let u = 0.5 * t.sqrt();
        let (sine, cosine) = u.sin_cos();
        let cot = cosine / sine;
        let csc2 = 1.0 / (sine * sine);
        let value = (1.0 - u * cot) / t;
        // g = u cot u as a function of t = 4u²: g_t = (cot u - u csc² u)/(8u) and its derivative.
        let g_t = (cot - u * csc2) / (8.0 * u);
        let g_tt = (2.0 * u * u * csc2 * cot - u * csc2 - cot) / (64.0 * u * u * u);
        let first = (-g_t - value) / t;
        let second = (-g_tt - 2.0 * first) / t;
        Self {
            value,
            slope: 2.0 * first,
            bend: 4.0 * second,
        }
    }
}

/// Below this θ² the series with `INVERSE_TANGENT_SERIES` is exact to rounding: the ratio of its terms is θ²/(2π)² < 0.04.
#[doc(hidden)]
pub const SERIES_LIMIT: f64 = 1.5;

/// Below this θ² the first six terms are exact to rounding.
#[doc(hidden)]
pub const SHORT_SERIES_LIMIT: f64 = 0.05;

/// Taylor coefficients `|B₂ⱼ|/(2j)!` of `c` in θ², j = 1, 2, … (Bernoulli numbers).
pub(super) const INVERSE_TANGENT_SERIES: [f64; 13] = [
    1.0 / 12.0,
    1.0 / 720.0,
    1.0 / 30_240.0,
    1.0 / 1_209_600.0,
    1.0 / 47_900_160.0,
    691.0 / 1_307_674_368_000.0,
    1.0 / 74_724_249_600.0,
    3_617.0 / 10_670_622_842_880_000.0,
    43_867.0 / 5_109_094_217_170_944_000.0,
    174_611.0 / 802_857_662_698_291_200_000.0,
    77_683.0 / 14_101_100_039_391_805_440_000.0,
    236_364_091.0 / 1_693_824_136_731_743_669_452_800_000.0,
    657_931.0 / 186_134_520_519_971_831_808_000_000.0,
];

/// Inverse tangent of the exponential, `S(ψ) = I - ψ̂/2 + c ψ̂²`.
///
/// With `A = exp(ψ)`: `δψ = Sᵀ ζ` for a body-frame rotation of the far end (`δA = A ζ̂`) and `δψ = -S ζ` for a
/// body-frame rotation of the near end (`δA = -ζ̂ A`).
#[inline]
#[must_use]
pub fn log_tangent(psi: &Vector3<f64>) -> Matrix3<f64> {
    let c = InverseTangentCoefficients::at(psi.norm_squared());
    let psi_hat = hat(psi);
    Matrix3::identity() - 0.5 * psi_hat + c.value * psi_hat * psi_hat
}

/// Second derivative of `λ·exp(±ζ̂)v` in `ζ`, either sign: `½(λvᵀ + vλᵀ) - (λ·v) I`.
///
/// A moment constant in space is `exp(-ζ̂)RᵀM` in the body frame; a force constant in the body is `R exp(ζ̂)f_b` in
/// space, and `λ` is then turned into the body frame.
#[must_use]
pub fn load_curvature(covector: &Vector3<f64>, vector: &Vector3<f64>) -> Matrix3<f64> {
    let outer = covector * vector.transpose();
    0.5 * (outer + outer.transpose()) - Matrix3::from_diagonal_element(covector.dot(vector))
}
