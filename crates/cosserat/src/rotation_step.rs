//! The rotation of one step: its angular momentum, and the equation (81) for each node.
//!
//! With the Cayley vector `f` of a node's rotation over a step of length `h` and `α = 1 + |f|²/4`, equation (81) is `(J f + ½ f × J f)/(α
//! h) = g` for the angular momentum `g` in the frame before the step; after it, the same momentum is `(J f - ½ f × J f)/(α h)`.

use nalgebra::{Matrix3, Vector3};
use pulp::{Scalar, Simd};

use super::rotation::{cay_inverse, hat};
use super::vector::{Lanes, Mat3, Vec3};

/// `1/α`
#[inline(always)]
pub fn inverse_alpha<S: Simd>(f: Vec3<S>) -> Lanes<S> {
    Lanes::splat(f.x.simd, 1.0) / (f.dot(f) * 0.25 + 1.0)
}

/// Returns `(J f ± ½ f × J f)/(α h)` for `rate = J/h`: before the step with the sign `1`, after it with `-1`.
#[inline(always)]
pub fn momentum<S: Simd>(rate: Vec3<S>, f: Vec3<S>, inverse_alpha: Lanes<S>, sign: f64) -> Vec3<S> {
    let jf = f.component_mul(rate);
    (jf + f.cross(jf) * (0.5 * sign)) * inverse_alpha
}

/// Returns the derivative of a [`momentum`] `g` along `f`.
#[inline(always)]
pub fn momentum_slope<S: Simd>(
    rate: Vec3<S>,
    f: Vec3<S>,
    inverse_alpha: Lanes<S>,
    g: Vec3<S>,
    sign: f64,
) -> Mat3<S> {
    let turned = Mat3::hat(f).product(Mat3::diagonal(rate)) - Mat3::hat(f.component_mul(rate));
    (Mat3::diagonal(rate) + turned * (0.5 * sign)) * inverse_alpha
        - Mat3::outer(g * (inverse_alpha * 0.5), f)
}

/// Returns `∂g/∂η` of the momentum before the step along the body rotation at its end, from its [slope](momentum_slope).
#[inline(always)]
pub fn spin_inertia<S: Simd>(slope: Mat3<S>, f: Vec3<S>) -> Mat3<S> {
    let one = Mat3::multiple(Lanes::splat(f.x.simd, 1.0));
    slope.product(one + Mat3::hat(f) * 0.5 + Mat3::outer(f, f) * 0.25)
}

/// Returns the derivatives of `covector·g h` along the moments of inertia of a node that turns by a rotation in a step of length `h`, for its
/// angular momentum `g` before the step (with the sign `1`) or after it (`-1`), both in the frame there.
#[must_use]
pub fn momentum_coefficients(
    turn: &Matrix3<f64>,
    covector: &Vector3<f64>,
    sign: f64,
) -> Vector3<f64> {
    let f = cay_inverse(turn);
    let along = covector + covector.cross(&f) * (0.5 * sign);
    along.component_mul(&f) / (1.0 + 0.25 * f.norm_squared())
}

/// A node of inertia `rotary`, kg m², that turns by `f` in a step of length `h`, s.
#[derive(Clone, Copy)]
pub struct TurnedNode {
    rate: Vec3<Scalar>,
    f: Vec3<Scalar>,
    inverse_alpha: Lanes<Scalar>,
}

impl TurnedNode {
    pub fn new(rotary: &Vector3<f64>, f: &Vector3<f64>, h: f64) -> Self {
        let f = Vec3::splat(Scalar, f);
        Self {
            rate: Vec3::splat(Scalar, &(rotary / h)),
            f,
            inverse_alpha: inverse_alpha(f),
        }
    }

    fn momentum(&self, sign: f64) -> Vec3<Scalar> {
        momentum(self.rate, self.f, self.inverse_alpha, sign)
    }

    /// Angular momentum in the frame before the step.
    pub fn momentum_before(&self) -> Vector3<f64> {
        self.momentum(1.0).vector()
    }

    /// Angular momentum in the frame after the step.
    pub fn momentum_after(&self) -> Vector3<f64> {
        self.momentum(-1.0).vector()
    }
}

/// Solves `J f + ½ f × J f = (1 + |f|²/4) b` for the Cayley vector `f` of one step's rotation, `b = h g`.
///
/// The regular branch exists if `|b| < min J` (a quarter turn); otherwise, and for NaN, returns `None`.
#[inline]
#[must_use]
pub fn solve_rotation(inertia: &Vector3<f64>, b: &Vector3<f64>) -> Option<Vector3<f64>> {
    let least = inertia.min();
    // Normalization prevents overflow and underflow of extreme inertias.
    let (j, b) = (inertia / least, b / least);
    if !(b.norm_squared() < 1.0) {
        return None;
    }
    if j.x == j.y {
        Some(solve_axisymmetric(j.x, j.z, &b))
    } else {
        solve_general(&j, &b)
    }
}

const ROTATION_NEWTON_LIMIT: usize = 40; // 5 to 11 needed next to the fold, 2 usually

/// Solves the equation for `J = diag(a, a, b)`, with one scalar unknown `s = (1 + |f|²/4)/2`.
///
/// With `c = f/2`: `c₃ = s g₃/b`, `(c₁, c₂) = s [a, ks; -ks, a]⁻¹ (g₁, g₂)`, `k = (b - a) g₃/b`, and `2s - 1 = s² [(g₁² + g₂²)/(a² + k²s²)
/// + (g₃/b)²]`.
#[inline]
fn solve_axisymmetric(a: f64, b: f64, g: &Vector3<f64>) -> Vector3<f64> {
    let lateral = g.x * g.x + g.y * g.y;
    let spin = g.z / b;
    let k = (b - a) * spin;
    let isotropic = lateral / (a * a) + spin * spin;
    // The regular root for k = 0.
    let mut s = 1.0 / (1.0 + (1.0 - isotropic).max(0.0).sqrt());
    if k != 0.0 {
        for _ in 0..ROTATION_NEWTON_LIMIT {
            let d = a * a + k * k * s * s;
            let ratio = lateral / d;
            let value = 2.0 * s - 1.0 - s * s * (ratio + spin * spin);
            let slope = 2.0 - 2.0 * s * (ratio + spin * spin) + 2.0 * s * s * s * k * k * ratio / d;
            let change = value / slope;
            s -= change;
            if change.abs() <= 2.0 * f64::EPSILON * s {
                break;
            }
        }
    }
    let ks = k * s;
    let scale = 2.0 * s / (a * a + ks * ks);
    Vector3::new(
        scale * (a * g.x - ks * g.y),
        scale * (ks * g.x + a * g.y),
        2.0 * s * spin,
    )
}

/// Solves the vector equation by Newton's method, for three different moments of inertia.
fn solve_general(j: &Vector3<f64>, b: &Vector3<f64>) -> Option<Vector3<f64>> {
    let mut f = b.component_div(j);
    let mut last_change = f64::INFINITY;
    for _ in 0..ROTATION_NEWTON_LIMIT {
        let jf = j.component_mul(&f);
        let alpha = 1.0 + 0.25 * f.norm_squared();
        let residual = jf + 0.5 * f.cross(&jf) - alpha * b;
        let slope = Matrix3::from_diagonal(j)
            + 0.5 * (hat(&f) * Matrix3::from_diagonal(j) - hat(&jf))
            - 0.5 * b * f.transpose();
        let change = slope.lu().solve(&residual)?;
        f -= change;
        let size = change.norm();
        if size <= 2.0 * f64::EPSILON * f.norm() || (size >= last_change && size < 1e-12) {
            return Some(f);
        }
        last_change = size;
    }
    None
}
