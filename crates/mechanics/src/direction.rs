//! The deviation of the axis of a section from a direction in space, whatever the roll about the axis.

use nalgebra::{Matrix3, Vector3};

use cosserat::rotation::hat;

/// Sine of the angle from the antipode below which a deviation counts as one at this angle: the direction in which to turn back is
/// undetermined at the antipode itself, and its derivative grows there as the inverse of the sine.
pub const NEAREST_TO_ANTIPODE: f64 = 1e-3;
/// Values of `1 - cos θ` below which the series of `θ/sin θ` takes the place of its closed form, whose second derivative loses digits as
/// `1e-16/θ⁴`; its terms fall by more than a factor of 20.
const SERIES: f64 = 0.1;
/// Number of terms of the series, `20⁻¹⁴ < 1e-18`.
const TERMS: usize = 14;

/// Returns the two axes of length 1 across a direction of length 1 along which the components of a deviation are measured. Together with
/// the direction they are a right-handed frame; the first axis is across the coordinate axis that is farthest from the direction.
#[must_use]
pub fn across(direction: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let first = direction
        .cross(&Vector3::ith(direction.iamin(), 1.0))
        .normalize();
    [first, direction.cross(&first)]
}

/// The deviation of the axis `t = R e₃` of a section from a direction `d`,
///
/// ```text
/// ρ = θ/sin θ (a₁·t, a₂·t)    cos θ = d·t
/// ```
///
/// with the axes `a` [across] the direction. Its norm is the angle `θ`, and it does not depend on the roll about `t`. It is smooth but at
/// the antipode, `t = -d`.
#[derive(Clone, Copy, Debug)]
pub struct Deviation {
    /// Components of `t` across the direction.
    parts: [f64; 2],
    /// `θ/sin θ` and its first two derivatives along `cos θ`.
    factor: [f64; 3],
    /// Derivatives of the components and of `cos θ`.
    slopes: [Vector3<f64>; 3],
    /// The axes across the direction, and the direction, in the body frame.
    body: [Vector3<f64>; 3],
}

impl Deviation {
    /// Returns the deviation of a section of rotation `r`, body to space, from a direction of length 1.
    #[must_use]
    pub fn of(direction: &Vector3<f64>, r: &Matrix3<f64>) -> Self {
        let [first, second] = across(direction);
        let body = [first, second, *direction].map(|axis| r.tr_mul(&axis));
        let (mut parts, mut cos) = ([body[0].z, body[1].z], body[2].z);
        let sin = parts[0].hypot(parts[1]);
        if cos < 0.0 && sin < NEAREST_TO_ANTIPODE {
            parts = if sin > 0.0 {
                parts.map(|part| part * (NEAREST_TO_ANTIPODE / sin))
            } else {
                [NEAREST_TO_ANTIPODE, 0.0]
            };
            cos = -(1.0 - NEAREST_TO_ANTIPODE * NEAREST_TO_ANTIPODE).sqrt();
        }
        Self {
            parts,
            factor: angle_over_sine(parts[0].hypot(parts[1]), cos),
            // δ(a·t) = ζ·(e₃ × Rᵀa)
            slopes: body.map(|axis| Vector3::new(-axis.y, axis.x, 0.0)),
            body,
        }
    }

    /// Returns the deviation, rad.
    #[must_use]
    pub fn value(&self) -> [f64; 2] {
        self.parts.map(|part| self.factor[0] * part)
    }

    /// Returns the angle `θ`, rad.
    #[must_use]
    pub fn angle(&self) -> f64 {
        let [a, b] = self.value();
        a.hypot(b)
    }

    /// Returns the derivatives of both components along `ζ`, `δR = R ζ̂`.
    #[must_use]
    pub fn gradients(&self) -> [Vector3<f64>; 2] {
        let [f, slope, _] = self.factor;
        [0, 1].map(|i| self.slopes[i] * f + self.slopes[2] * (slope * self.parts[i]))
    }

    /// Returns the second derivative of `y·ρ` along `s ↦ R exp(s ζ̂)`.
    #[must_use]
    pub fn curvature(&self, y: [f64; 2]) -> Matrix3<f64> {
        let [f, slope, curvature] = self.factor;
        let along = self.slopes[2];
        let mut out = Matrix3::zeros();
        for i in [0, 1] {
            let mixed = self.slopes[i] * along.transpose();
            out += (along * along.transpose() * (curvature * self.parts[i])
                + (mixed + mixed.transpose()) * slope
                + turned(&self.body[2]) * (slope * self.parts[i])
                + turned(&self.body[i]) * f)
                * y[i];
        }
        out
    }

    /// Returns the gradient of `½ θ²` along `ζ`, and the derivative of this gradient along the rotation.
    #[must_use]
    pub fn of_half_square(&self) -> (Vector3<f64>, Matrix3<f64>) {
        let (value, [a, b]) = (self.value(), self.gradients());
        let gradient = a * value[0] + b * value[1];
        let symmetric = a * a.transpose() + b * b.transpose() + self.curvature(value);
        // Derivatives along two body axes commute up to the gradient along their commutator.
        (gradient, symmetric + hat(&gradient) * 0.5)
    }
}

/// Returns the second derivative of `a·t` along `s ↦ R exp(s ζ̂)`, with `a` in the body frame: `(a·ζ) ζ₃ - a₃ |ζ|²`.
fn turned(a: &Vector3<f64>) -> Matrix3<f64> {
    let mut out = Matrix3::from_diagonal_element(-a.z);
    for axis in 0..3 {
        out[(axis, 2)] += 0.5 * a[axis];
        out[(2, axis)] += 0.5 * a[axis];
    }
    out
}

/// Returns `f = θ/sin θ` and its first two derivatives along `c = cos θ`: `f' sin²θ = c f - 1`, `f'' sin²θ = 3 c f' + f`. The series in
/// `x = 1 - c` has the coefficients `b_n = b_{n-1} n/(2 n + 1)`.
fn angle_over_sine(sin: f64, cos: f64) -> [f64; 3] {
    let square = sin * sin;
    let x = square / (1.0 + cos);
    if cos > 0.0 && x < SERIES {
        let mut out = [1.0, 0.0, 0.0];
        let (mut b, mut powers) = (1.0, [1.0, 0.0, 0.0]);
        for n in (1..=TERMS).map(|n| n as f64) {
            b *= n / (2.0 * n + 1.0);
            powers = [powers[0] * x, powers[0], powers[1]];
            out[0] += b * powers[0];
            out[1] -= b * n * powers[1];
            out[2] += b * n * (n - 1.0) * powers[2];
        }
        return out;
    }
    let f = sin.atan2(cos) / sin;
    let slope = (cos * f - 1.0) / square;
    [f, slope, (3.0 * cos * slope + f) / square]
}
