//! The rotation of a node during one step, (85), without a division, a square root or a branch.

use pulp::Simd;

use super::vector::{Lanes, Quaternion, Vec3};

/// Data for the rotation of a step, from an axisymmetric node inertia `diag(a, a, b)` and the time step `h`.
#[derive(Clone, Copy, Debug)]
pub struct Gyration<T> {
    /// `h/a`
    pub lateral: T,
    /// `h/b`
    pub axial: T,
    /// `(b - a)/a`
    pub excess: T,
    /// `4 (b - a)/h`
    pub precession: T,
}

/// A node's rotation during one step.
#[derive(Clone, Copy, Debug)]
pub struct Turn<S: Simd> {
    /// `F`, from the old body frame to the new one.
    pub rotation: Quaternion<S>,
    /// `Fᵀ g`, the angular momentum in the new body frame.
    pub momentum: Vec3<S>,
    /// Valid where at most [`TURN_LIMIT`].
    pub level: Lanes<S>,
}

/// Largest level at which the solution is exact to rounding. For `a <= b`, as for every section, every `h |g| <= min(a, b)/2` is inside.
pub const TURN_LIMIT: f64 = 0.25;

/// Coefficients of `1/(1 + sqrt(1 - z))` for `0 <= z <= 1/4`, accurate to 6e-5: interpolated at Chebyshev points.
const START: [f64; 3] = [0.50002539995366, 0.12318935511503, 0.08071405498084];

/// Coefficients of `1/sqrt(1 + t)` for `0 <= t <= 0.072`, accurate to 8e-10: interpolated at Chebyshev points.
const INVERSE_ROOT: [f64; 5] = [
    0.99999999921347,
    -0.49999945232042,
    0.37493864113049,
    -0.31007387904985,
    0.23354634570100,
];

impl<S: Simd> Gyration<Lanes<S>> {
    /// Returns the data for a variable inertia; `unequal` is zero if it is axisymmetric, infinite otherwise.
    #[inline(always)]
    pub fn of(rotary: Vec3<S>, unequal: Lanes<S>, h: f64) -> Self {
        let Vec3 { x: a, z: b, .. } = rotary;
        let inverse = Lanes::splat(a.simd, 1.0) / (a * b);
        let difference = b - a;
        Self {
            lateral: b * inverse * h,
            axial: a * inverse * h,
            excess: difference * b * inverse + unequal,
            precession: difference * (4.0 / h),
        }
    }

    /// Solves `J f + ½ f × J f = (1 + |f|²/4) h g` for the Cayley vector `f` of the rotation.
    ///
    /// With `s = (1 + |f|²/4)/2`, `σ = h g₃/b`, `λ = h² (g₁² + g₂²)/a²` and `κ = (b - a) σ/a` the scalar equation is
    /// `1 - 2s + s² (λ + σ² + κ²) - κ² s³ (2 - σ² s) = 0`; then `f₃ = 2 s σ` and
    /// `(f₁, f₂) = 2 s [1, κs; -κs, 1]⁻¹ (h/a) (g₁, g₂)`. The unit quaternion is `(1, f/2)/sqrt(2s)`, and
    /// `g - Fᵀ g = (4/h) v × J v` with its vector part `v`.
    #[inline(always)]
    pub fn turn(&self, g: Vec3<S>) -> Turn<S> {
        let one = Lanes::splat(g.x.simd, 1.0);
        let (gx, gy) = (g.x * self.lateral, g.y * self.lateral);
        let spin = g.z * self.axial;
        let kappa = spin * self.excess;
        let lateral = gx * gx + gy * gy;
        let spin_squared = spin * spin;
        let kappa_squared = kappa * kappa;
        let isotropic = lateral + spin_squared;
        let level = isotropic + kappa_squared;

        // The error is 1.3e-4 in the worst case up to the limit, so that its fourth power is below rounding.
        let start = (isotropic - lateral * kappa_squared * 0.25).polynomial(&START);
        let ks = kappa_squared * start;
        let gain = spin_squared * start;
        let value = (one - (start + start)) + start * start * (level - ks * (-gain + 2.0));
        // The slope is -2 (1 - deviation); x solves x = newton + second x² + third x³.
        let deviation = start * (level - ks * (-(gain + gain) + 3.0));
        let scale = inverse_of_one_minus(deviation) * 0.5;
        let newton = value * scale;
        let second = (level - ks * 6.0 * (one - gain)) * scale;
        let third = kappa_squared * (gain * 4.0 - 2.0) * scale;
        let third = second * second * 2.0 + third;
        let s = start + newton * (newton * (newton * third + second) + 1.0);

        let ks = kappa * s;
        let inverse = inverse_of_one_minus(-(ks * ks));
        let alpha = s + s;
        let t = alpha - 1.0;
        let [c0, c1, c2, c3, c4] = INVERSE_ROOT;
        let square = t * t;
        let root = (t * c1 + c0) + square * ((t * c3 + c2) + square * c4);
        let w = root * (-(alpha * root * root) * 0.5 + 1.5);
        let axial = s * w;
        let scale = axial * inverse;
        let v = Vec3 {
            x: scale * (gx - ks * gy),
            y: scale * (gy + ks * gx),
            z: axial * spin,
        };
        let precession = self.precession * v.z;
        Turn {
            rotation: Quaternion { w, v },
            momentum: Vec3 {
                x: g.x - precession * v.y,
                y: g.y + precession * v.x,
                z: g.z,
            },
            level,
        }
    }
}

/// Returns `1/(1 - x)` as `(1 + x)(1 + x²)(1 + x⁴)(1 + x⁸)`, with the relative error `x¹⁶`: below 1e-13 for `|x| <= 0.15`, below rounding
/// for `|x| <= 0.1`.
#[inline(always)]
fn inverse_of_one_minus<S: Simd>(x: Lanes<S>) -> Lanes<S> {
    let square = x * x;
    let fourth = square * square;
    let eighth = fourth * fourth;
    ((x + 1.0) * (square + 1.0)) * ((fourth + 1.0) * (eighth + 1.0))
}
