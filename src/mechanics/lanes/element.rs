//! Energy gradients of elements, one element per lane; see [`strain`](crate::mechanics::strain) for the formulas.

use pulp::Simd;

use super::vector::{Frame, Lanes, Quaternion, Vec3};
use crate::mechanics::rotation::INVERSE_TANGENT_SERIES;
use crate::mechanics::strain::Element;

/// Rows of an element's constants: see the constants below.
pub const ELEMENT_ROWS: usize = 15;
const LINEAR_STIFFNESS: usize = 0;
const ANGULAR_STIFFNESS: usize = 3;
/// Of end a, then of end b.
const REST_LINEAR: usize = 6;
const REST_ANGULAR: usize = 12;

/// Position and rotation of a node.
#[derive(Clone, Copy, Debug)]
pub struct Pose<S: Simd> {
    pub position: Vec3<S>,
    pub rotation: Quaternion<S>,
    pub frame: Frame<S>,
}

impl<S: Simd> Pose<S> {
    /// See [`Lanes::next_lane`].
    #[inline(always)]
    pub fn next_lane(&self) -> Self {
        let rotation = self.rotation.next_lane();
        Self {
            position: self.position.next_lane(),
            rotation,
            frame: Frame::of(&rotation),
        }
    }
}

/// Gradient of the energy of an element: `δU = F·(δx_b - δx_a) + M_a·η_a + M_b·η_b`.
#[derive(Clone, Copy, Debug)]
pub struct Gradient<S: Simd> {
    pub force: Vec3<S>,
    pub moment_a: Vec3<S>,
    pub moment_b: Vec3<S>,
}

/// Stress as a function of strain.
pub trait Law {
    /// Stress at `ENDS` ends from `y_i` (the linear strain times `l`), and from the angular strain, both in the scale
    /// of the [rule](Rule) and its [constants](Rule::constants).
    fn stress<S: Simd, const ENDS: usize>(
        constants: &[S::f64s; ELEMENT_ROWS],
        y: [Vec3<S>; ENDS],
        psi: Vec3<S>,
    ) -> ([Vec3<S>; ENDS], Vec3<S>);
}

/// Proportional to strain: [`RodModel::Standard`](crate::mechanics::RodModel::Standard).
pub struct Standard;

impl Law for Standard {
    #[inline(always)]
    fn stress<S: Simd, const ENDS: usize>(
        constants: &[S::f64s; ELEMENT_ROWS],
        y: [Vec3<S>; ENDS],
        psi: Vec3<S>,
    ) -> ([Vec3<S>; ENDS], Vec3<S>) {
        let simd = psi.x.simd;
        let linear = Vec3::load(simd, constants, LINEAR_STIFFNESS);
        let angular = Vec3::load(simd, constants, ANGULAR_STIFFNESS);
        let mut n = y;
        for end in 0..ENDS {
            let rest = Vec3::load(simd, constants, REST_LINEAR + 3 * end);
            n[end] = linear.component_mul(y[end] - rest);
        }
        let rest = Vec3::load(simd, constants, REST_ANGULAR);
        (n, angular.component_mul(psi - rest))
    }
}

/// A strain rule: the [`StrainRule`](crate::mechanics::StrainRule) of the same name.
pub trait Rule {
    /// `linear` over `l` times the rule's weight of an end, `angular` over `l`, and the rest strains times `l`; the
    /// angular ones in the rule's measure of the rotation.
    fn constants(element: &Element) -> [f64; ELEMENT_ROWS];

    fn gradient<S: Simd, L: Law>(
        constants: &[S::f64s; ELEMENT_ROWS],
        a: &Pose<S>,
        b: &Pose<S>,
    ) -> Gradient<S>;
}

fn constants(element: &Element, end_weight: f64, half_turns: f64) -> [f64; ELEMENT_ROWS] {
    let l = element.length;
    let mut rows = [0.0; ELEMENT_ROWS];
    for i in 0..3 {
        rows[LINEAR_STIFFNESS + i] = end_weight * element.linear_stiffness[i] / l;
        rows[ANGULAR_STIFFNESS + i] = element.angular_stiffness[i] / (half_turns * l);
        rows[REST_LINEAR + i] = element.rest.linear[0][i] * l;
        rows[REST_LINEAR + 3 + i] = element.rest.linear[1][i] * l;
        rows[REST_ANGULAR + i] = element.rest.curvature[i] * (half_turns * l);
    }
    rows
}

/// The paper's rule.
pub struct Trapezoidal;

impl Rule for Trapezoidal {
    /// The measure of the rotation is `ψ/2`.
    fn constants(element: &Element) -> [f64; ELEMENT_ROWS] {
        constants(element, 0.5, 0.5)
    }

    #[inline(always)]
    fn gradient<S: Simd, L: Law>(
        constants: &[S::f64s; ELEMENT_ROWS],
        a: &Pose<S>,
        b: &Pose<S>,
    ) -> Gradient<S> {
        let dx = b.position - a.position;
        let y = [a.frame.to_body(dx), b.frame.to_body(dx)];
        let Quaternion { w, v } = a.rotation.relative(b.rotation);
        // v/w; at exactly half a turn zero instead of infinite, so that a lane without an element stays without force.
        let half_psi = v * (w / (w * w + f64::MIN_POSITIVE));
        let (n, m) = L::stress(constants, y, half_psi);
        let twist = half_psi.cross(m);
        let even = m + half_psi * half_psi.dot(m);
        Gradient {
            force: a.frame.to_space(n[0]) + b.frame.to_space(n[1]),
            moment_a: n[0].cross(y[0]) - (even + twist),
            moment_b: n[1].cross(y[1]) + (even - twist),
        }
    }
}

/// The rule with one constant strain per element.
pub struct Helical;

impl Rule for Helical {
    fn constants(element: &Element) -> [f64; ELEMENT_ROWS] {
        constants(element, 1.0, 1.0)
    }

    #[inline(always)]
    fn gradient<S: Simd, L: Law>(
        constants: &[S::f64s; ELEMENT_ROWS],
        a: &Pose<S>,
        b: &Pose<S>,
    ) -> Gradient<S> {
        let Logarithm {
            psi,
            angle_squared,
            c,
            slope,
        } = logarithm(a.rotation.relative(b.rotation));
        let y = a.frame.to_body(b.position - a.position);
        let psi_y = psi.dot(y);
        let double_cross = psi * psi_y - y * angle_squared;
        let strain = y - psi.cross(y) * 0.5 + double_cross * c;
        let ([n], m) = L::stress(constants, [strain], psi);

        let psi_n = psi.dot(n);
        let y_n = y.dot(n);
        // μ = m + ∂(n·S(ψ) y)/∂ψ
        let along_psi = slope * (psi_n * psi_y - angle_squared * y_n) - c * (y_n + y_n);
        let mu = m + n.cross(y) * 0.5 + n * (c * psi_y) + y * (c * psi_n) + psi * along_psi;
        let w = n + psi.cross(n) * 0.5 + (psi * psi_n - n * angle_squared) * c;
        let odd = psi.cross(mu) * 0.5;
        let even = mu + (psi * psi.dot(mu) - mu * angle_squared) * c;
        Gradient {
            force: a.frame.to_space(w),
            moment_a: w.cross(y) - (even + odd),
            moment_b: even - odd,
        }
    }
}

/// The logarithm of a rotation, and the coefficient of its tangent; see
/// [`InverseTangentCoefficients`](crate::mechanics::rotation::InverseTangentCoefficients).
struct Logarithm<S: Simd> {
    psi: Vec3<S>,
    angle_squared: Lanes<S>,
    c: Lanes<S>,
    slope: Lanes<S>,
}

/// Rotations whose quaternion has at least this scalar part, `sqrt(15)/4`, are near: an angle of at most 0.505.
const NEAR: f64 = 0.968_245_836_551_854_3;

/// `asin(√t)/√t` for `0 <= t <= 1/16` to 3e-18: interpolated at Chebyshev points.
const ARCSINE: [f64; 9] = [
    1.0,
    0.16666666666666308,
    0.07500000000153167,
    0.04464285689206594,
    0.030381964973388388,
    0.02237121790366476,
    0.017377988197123058,
    0.013574602068216915,
    0.014731093985552658,
];

/// Terms of the series of `c` that matter up to `θ² = 0.256`: the next is below 1e-16 of the first.
const SERIES_TERMS: usize = 7;

const C_SERIES: [f64; SERIES_TERMS] = {
    let mut series = [0.0; SERIES_TERMS];
    let mut i = 0;
    while i < SERIES_TERMS {
        series[i] = INVERSE_TANGENT_SERIES[i];
        i += 1;
    }
    series
};

/// Of `c'(θ)/θ = 2 dc/dθ²`.
const SLOPE_SERIES: [f64; SERIES_TERMS] = {
    let mut series = [0.0; SERIES_TERMS];
    let mut i = 0;
    while i < SERIES_TERMS {
        series[i] = 2.0 * (i + 1) as f64 * INVERSE_TANGENT_SERIES[i + 1];
        i += 1;
    }
    series
};

#[inline(always)]
fn logarithm<S: Simd>(rotation: Quaternion<S>) -> Logarithm<S> {
    let Quaternion { w, v } = rotation;
    let t = v.dot(v);
    let stretch = t.polynomial(&ARCSINE);
    let angle_squared = stretch * stretch * t * 4.0;
    let near = Logarithm {
        psi: v * (stretch + stretch),
        angle_squared,
        c: angle_squared.polynomial(&C_SERIES),
        slope: angle_squared.polynomial(&SLOPE_SERIES),
    };
    if (-w).all_at_most(-NEAR) {
        return near;
    }
    // The other sign of a quaternion is the same rotation, the short way round.
    let one = Lanes::splat(w.simd, 1.0);
    let sign = w.select_below(0.0, -one, one);
    let w = w.abs();
    let far = far_logarithm(w, v * sign, t);
    let psi = near.psi * sign;
    Logarithm {
        psi: Vec3 {
            x: w.select_below(NEAR, far.psi.x, psi.x),
            y: w.select_below(NEAR, far.psi.y, psi.y),
            z: w.select_below(NEAR, far.psi.z, psi.z),
        },
        angle_squared: w.select_below(NEAR, far.angle_squared, near.angle_squared),
        c: w.select_below(NEAR, far.c, near.c),
        slope: w.select_below(NEAR, far.slope, near.slope),
    }
}

/// Any rotation but those near the identity: three halvings of the angle lead to the near range. `w >= 0`, `t = |v|²`.
///
/// `c = (1 - (θ/2) cot(θ/2))/θ²` satisfies `c'/θ = (1/4 - 3c + c²θ²)/θ²`.
#[inline(always)]
fn far_logarithm<S: Simd>(w: Lanes<S>, v: Vec3<S>, t: Lanes<S>) -> Logarithm<S> {
    let one = Lanes::splat(w.simd, 1.0);
    let mut halved = t;
    let mut cosine = w;
    let mut cosines = one;
    for _ in 0..3 {
        let twice_square = cosine + 1.0;
        halved = halved / (twice_square + twice_square);
        cosine = (twice_square * 0.5).sqrt();
        cosines = cosines * cosine;
    }
    let stretch = halved.polynomial(&ARCSINE) / cosines;
    let angle_squared = stretch * stretch * t * 4.0;
    let c = (one - stretch * w) / angle_squared;
    Logarithm {
        psi: v * (stretch + stretch),
        angle_squared,
        c,
        slope: (c * c * angle_squared - c * 3.0 + 0.25) / angle_squared,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mechanics::rotation::InverseTangentCoefficients;
    use proptest::prelude::*;
    use pulp::Scalar;

    proptest! {
        /// Angle and coefficients for every angle below half a turn and both signs of the quaternion. What cancels in
        /// the far coefficients is below rounding of `1/12`, divided by the angle's square where the slope is.
        #[test]
        fn logarithm_is_accurate(
            angle in prop_oneof![Just(0.0), Just(1e-9), 0.0..0.6f64, 0.5..0.51f64, 0.0..3.1f64],
            flip in any::<bool>(),
        ) {
            let sign = if flip { -1.0 } else { 1.0 };
            let one = |value: f64| Lanes::splat(Scalar, value * sign);
            let (sine, cosine) = (0.5 * angle).sin_cos();
            let rotation = Quaternion {
                w: one(cosine),
                v: Vec3 { x: one(0.6 * sine), y: one(0.0), z: one(-0.8 * sine) },
            };
            let log = logarithm(rotation);
            let exact = InverseTangentCoefficients::at(angle * angle);
            let error = |value: Lanes<Scalar>, exact: f64| (value.value - exact).abs();
            prop_assert!(error(log.psi.x, 0.6 * angle) <= 2e-15 * angle);
            prop_assert!(error(log.psi.z, -0.8 * angle) <= 2e-15 * angle);
            prop_assert!(error(log.angle_squared, angle * angle) <= 4e-15 * angle * angle);
            prop_assert!(error(log.c, exact.value) <= 3e-15);
            prop_assert!(error(log.slope, exact.slope) <= 2e-14, "{} {}", log.slope.value, exact.slope);
        }
    }
}
