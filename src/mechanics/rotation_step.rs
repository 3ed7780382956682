//! The rotation of one step from the angular momentum: the equation that (81) leaves to each node.

use nalgebra::{Matrix3, Vector3};

use super::rotation::hat;

/// Solves `J f + ½ f × J f = (1 + |f|²/4) b` for the Cayley vector `f` of one step's rotation, `b = h g`.
///
/// Regular branch: exists whenever `|b| < min J` (a quarter turn); `None` outside, and for NaN.
#[inline]
#[must_use]
pub fn solve_rotation(inertia: &Vector3<f64>, b: &Vector3<f64>) -> Option<Vector3<f64>> {
    let least = inertia.min();
    // Normalized first, so that extreme inertias neither overflow nor vanish.
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

/// `J = diag(a, a, b)`: one scalar unknown `s = (1 + |f|²/4)/2`.
///
/// With `c = f/2`: `c₃ = s g₃/b`, `(c₁, c₂) = s [a, ks; -ks, a]⁻¹ (g₁, g₂)`, `k = (b - a) g₃/b`, and
/// `2s - 1 = s² [(g₁² + g₂²)/(a² + k²s²) + (g₃/b)²]`.
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

/// Three different moments of inertia: Newton on the vector equation.
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
