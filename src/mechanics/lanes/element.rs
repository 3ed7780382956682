//! Energy gradients of elements, one element per lane; see [`strain`](crate::mechanics::strain) for the formulas.

use pulp::Simd;

use super::vector::{Frame, Lanes, Quaternion, Row, Vec3, row};
use crate::mechanics::rod::Rod;
use crate::mechanics::rotation::INVERSE_TANGENT_SERIES;

const LINEAR_STIFFNESS: usize = 0;
const ANGULAR_STIFFNESS: usize = 3;
/// Of end a, then of end b.
const REST_LINEAR: usize = 6;
const REST_ANGULAR: usize = 12;
/// Rows of an element's constants: those above.
const STRESS_ROWS: usize = 15;

/// `l |v_rest|`; zero where there is no element.
const REST_STRETCH: usize = 15;
/// Factor of `Σ (y - y_rest)·n` that makes it `ε·C₁ε/2`, N.
const LINEAR_DENSITY: usize = 16;
/// The same for three times `κ·C₂κ/2`.
const ANGULAR_DENSITY: usize = 17;
/// `EA |v_rest|²/2`
const AXIAL: usize = 18;
/// `1/(l |v_rest|²)`
const ALONG: usize = 19;
/// Length of the chord at rest.
const REST_CHORD: usize = 20;
/// See [`Rod::least_dilatation`].
const LEAST_DILATATION: usize = 21;
/// Rotary inertia that end a has of the element at rest, then end b.
const SHARES: usize = 22;
/// Rows of an element's constants where the dilatation counts: all of the above.
const THINNING_ROWS: usize = 28;

/// Position and rotation of a node.
#[derive(Clone, Copy, Debug)]
pub struct Pose<S: Simd> {
    pub position: Vec3<S>,
    pub rotation: Quaternion<S>,
    pub frame: Frame<S>,
}

impl<S: Simd> Pose<S> {
    #[inline(always)]
    pub fn of(position: Vec3<S>, rotation: Quaternion<S>) -> Self {
        Self {
            position,
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
    /// Positive where the ends have come past half a turn against each other; not where there is no element.
    pub fold: Lanes<S>,
}

/// The chord of an element.
#[derive(Clone, Copy, Debug)]
pub struct Chord<S: Simd> {
    /// `x_b - x_a`
    pub dx: Vec3<S>,
    pub inverse_length: Lanes<S>,
}

impl<S: Simd> Chord<S> {
    #[inline(always)]
    pub fn between(a: Vec3<S>, b: Vec3<S>) -> Self {
        let dx = b - a;
        Self {
            dx,
            inverse_length: inverse_length(dx),
        }
    }

    /// `1/e - 1`: what the inertia at rest is to grow by.
    #[inline(always)]
    pub fn thickening(&self, constants: &[Row<S>]) -> Lanes<S> {
        self.inverse_length * row(self.dx.x.simd, constants, REST_CHORD) - 1.0
    }

    /// The least dilatation that the time step resolves over the present one.
    #[inline(always)]
    pub fn compression(&self, constants: &[Row<S>]) -> Lanes<S> {
        let simd = self.dx.x.simd;
        let inverse = self.inverse_length * row(simd, constants, REST_CHORD);
        inverse * row(simd, constants, LEAST_DILATATION)
    }

    /// Inertia that the two ends gain by the dilatation.
    #[inline(always)]
    pub fn inertia(&self, constants: &[Row<S>]) -> [Vec3<S>; 2] {
        let thickening = self.thickening(constants);
        let [a, b] = shares(self.dx.x.simd, constants);
        [a * thickening, b * thickening]
    }

    /// Impulse of the kinetic reaction on the right node, the opposite on the left one, over `2/h`, for the vector parts
    /// of the quaternions by which the ends turn; see [`Rod::kinetic_reaction`].
    #[inline(always)]
    pub fn kinetic_reaction(&self, constants: &[Row<S>], turns: [Vec3<S>; 2]) -> Vec3<S> {
        let simd = self.dx.x.simd;
        let [a, b] = shares(simd, constants);
        let spin =
            turns[0].dot(a.component_mul(turns[0])) + turns[1].dot(b.component_mul(turns[1]));
        let cube = self.inverse_length * self.inverse_length * self.inverse_length;
        -(self.dx * (spin * row(simd, constants, REST_CHORD) * cube))
    }
}

#[inline(always)]
fn shares<S: Simd>(simd: S, constants: &[Row<S>]) -> [Vec3<S>; 2] {
    [
        Vec3::load(simd, constants, SHARES),
        Vec3::load(simd, constants, SHARES + 3),
    ]
}

/// Far below the square of any length; the cube of the inverse of its root is finite.
const LEAST_SQUARE: f64 = 1e-200;

/// `1/|v|`, finite for a zero vector too, so that a lane without an element stays without force.
#[inline(always)]
fn inverse_length<S: Simd>(v: Vec3<S>) -> Lanes<S> {
    Lanes::splat(v.x.simd, 1.0) / (v.dot(v) + LEAST_SQUARE).sqrt()
}

/// See [`Gradient`]: from the scalar part of the relative quaternion, which is continuous along the motion.
#[inline(always)]
fn fold<S: Simd>(constants: &[Row<S>], w: Lanes<S>) -> Lanes<S> {
    -(w * row(w.simd, constants, LINEAR_STIFFNESS))
}

/// Stress as a function of strain.
pub trait Law {
    /// Rows of an element's constants.
    const ROWS: usize;
    /// Whether stiffness and inertia follow the dilatation.
    const THINS: bool;
    /// Whether the kinetic energy pulls at the elements.
    const REACTS: bool;

    /// Stress at `ENDS` ends from `y_i` (the linear strain times `l`), and from the angular strain, both in the scale
    /// of the [rule](Rule) and its [constants](Rule::constants); `inverse_stretch` is `1/|y_0|`.
    fn stress<S: Simd, const ENDS: usize>(
        constants: &[Row<S>],
        y: [Vec3<S>; ENDS],
        inverse_stretch: Lanes<S>,
        psi: Vec3<S>,
    ) -> ([Vec3<S>; ENDS], Vec3<S>);
}

/// [`RodModel::Standard`](crate::mechanics::RodModel::Standard)
pub struct Standard;

/// [`RodModel::Dilatation`](crate::mechanics::RodModel::Dilatation)
pub struct Dilatation;

/// [`RodModel::Consistent`](crate::mechanics::RodModel::Consistent)
pub struct Consistent;

/// Strain without that at rest.
#[inline(always)]
fn excess<S: Simd, const ENDS: usize>(
    constants: &[Row<S>],
    mut y: [Vec3<S>; ENDS],
    psi: Vec3<S>,
) -> ([Vec3<S>; ENDS], Vec3<S>) {
    let simd = psi.x.simd;
    for end in 0..ENDS {
        y[end] = y[end] - Vec3::load(simd, constants, REST_LINEAR + 3 * end);
    }
    (y, psi - Vec3::load(simd, constants, REST_ANGULAR))
}

#[inline(always)]
fn proportional<S: Simd, const ENDS: usize>(
    constants: &[Row<S>],
    mut eps: [Vec3<S>; ENDS],
    kappa: Vec3<S>,
) -> ([Vec3<S>; ENDS], Vec3<S>) {
    let simd = kappa.x.simd;
    let stiffness = Vec3::load(simd, constants, LINEAR_STIFFNESS);
    for end in 0..ENDS {
        eps[end] = stiffness.component_mul(eps[end]);
    }
    let stiffness = Vec3::load(simd, constants, ANGULAR_STIFFNESS);
    (eps, stiffness.component_mul(kappa))
}

impl Law for Standard {
    const ROWS: usize = STRESS_ROWS;
    const THINS: bool = false;
    const REACTS: bool = false;

    #[inline(always)]
    fn stress<S: Simd, const ENDS: usize>(
        constants: &[Row<S>],
        y: [Vec3<S>; ENDS],
        _: Lanes<S>,
        psi: Vec3<S>,
    ) -> ([Vec3<S>; ENDS], Vec3<S>) {
        let (eps, kappa) = excess(constants, y, psi);
        proportional(constants, eps, kappa)
    }
}

impl Law for Dilatation {
    const ROWS: usize = THINNING_ROWS;
    const THINS: bool = true;
    const REACTS: bool = false;

    #[inline(always)]
    fn stress<S: Simd, const ENDS: usize>(
        constants: &[Row<S>],
        y: [Vec3<S>; ENDS],
        inverse_stretch: Lanes<S>,
        psi: Vec3<S>,
    ) -> ([Vec3<S>; ENDS], Vec3<S>) {
        let (eps, kappa) = excess(constants, y, psi);
        let (mut n, m) = proportional(constants, eps, kappa);
        let inverse = inverse_stretch * row(psi.x.simd, constants, REST_STRETCH);
        for end in 0..ENDS {
            n[end] = n[end] * inverse;
        }
        (n, m * (inverse * inverse * inverse))
    }
}

impl Law for Consistent {
    const ROWS: usize = THINNING_ROWS;
    const THINS: bool = true;
    const REACTS: bool = true;

    #[inline(always)]
    fn stress<S: Simd, const ENDS: usize>(
        constants: &[Row<S>],
        y: [Vec3<S>; ENDS],
        inverse_stretch: Lanes<S>,
        psi: Vec3<S>,
    ) -> ([Vec3<S>; ENDS], Vec3<S>) {
        let simd = psi.x.simd;
        let (eps, kappa) = excess(constants, y, psi);
        let (mut n, m) = proportional(constants, eps, kappa);
        let inverse = inverse_stretch * row(simd, constants, REST_STRETCH);
        let square = inverse * inverse;
        let mut linear = eps[0].dot(n[0]);
        for end in 1..ENDS {
            linear = linear + eps[end].dot(n[end]);
        }
        let linear = linear * row(simd, constants, LINEAR_DENSITY);
        let angular = kappa.dot(m) * row(simd, constants, ANGULAR_DENSITY);
        // ∂u/∂e: (e - 1)/e in the completion is 1 - 1/e.
        let stretch = -inverse + 1.0;
        let axial = row(simd, constants, AXIAL) * (stretch * stretch);
        let slope = axial - square * (linear + angular * square);
        let along = slope * inverse * row(simd, constants, ALONG);
        for end in 0..ENDS {
            n[end] = n[end] * inverse;
        }
        // Along the chord or the strain: no matter at which end.
        n[0] = n[0] + y[0] * along;
        (n, m * (square * inverse))
    }
}

/// A strain rule: the [`StrainRule`](crate::mechanics::StrainRule) of the same name.
pub trait Rule {
    /// `linear` over `l` times the rule's weight of an end, `angular` over `l`, and the rest strains times `l`; the
    /// angular ones in the rule's measure of the rotation. Then what the dilatation needs.
    fn constants(rod: &Rod, q: usize, time_step: f64) -> [f64; THINNING_ROWS];

    fn gradient<S: Simd, L: Law>(
        constants: &[Row<S>],
        a: &Pose<S>,
        b: &Pose<S>,
        chord: &Chord<S>,
    ) -> Gradient<S>;
}

fn constants(
    rod: &Rod,
    q: usize,
    time_step: f64,
    end_weight: f64,
    half_turns: f64,
) -> [f64; THINNING_ROWS] {
    let element = &rod.elements[q];
    let l = element.length;
    let mut rows = [0.0; THINNING_ROWS];
    for i in 0..3 {
        rows[LINEAR_STIFFNESS + i] = end_weight * element.linear_stiffness[i] / l;
        rows[ANGULAR_STIFFNESS + i] = element.angular_stiffness[i] / (half_turns * l);
        rows[REST_LINEAR + i] = element.rest.linear[0][i] * l;
        rows[REST_LINEAR + 3 + i] = element.rest.linear[1][i] * l;
        rows[REST_ANGULAR + i] = element.rest.curvature[i] * (half_turns * l);
        for end in 0..2 {
            rows[SHARES + 3 * end + i] = rod.element_inertia[q][end].rotary[i];
        }
    }
    let stretch = element.rest.linear[0].norm();
    rows[REST_STRETCH] = l * stretch;
    rows[LINEAR_DENSITY] = 0.5 / l;
    rows[ANGULAR_DENSITY] = 1.5 / (half_turns * l);
    rows[AXIAL] = 0.5 * element.linear_stiffness.z * stretch * stretch;
    rows[ALONG] = 1.0 / (l * stretch * stretch);
    rows[REST_CHORD] = rod.rest_chords[q];
    rows[LEAST_DILATATION] = rod.least_dilatation(q, time_step);
    rows
}

/// The paper's rule.
pub struct Trapezoidal;

impl Rule for Trapezoidal {
    /// The measure of the rotation is `ψ/2`.
    fn constants(rod: &Rod, q: usize, time_step: f64) -> [f64; THINNING_ROWS] {
        constants(rod, q, time_step, 0.5, 0.5)
    }

    #[inline(always)]
    fn gradient<S: Simd, L: Law>(
        constants: &[Row<S>],
        a: &Pose<S>,
        b: &Pose<S>,
        chord: &Chord<S>,
    ) -> Gradient<S> {
        let y = [a.frame.to_body(chord.dx), b.frame.to_body(chord.dx)];
        let Quaternion { w, v } = a.rotation.relative(b.rotation);
        // v/w; at exactly half a turn zero instead of infinite, so that a lane without an element stays without force.
        let half_psi = v * (w / (w * w + f64::MIN_POSITIVE));
        let (n, m) = L::stress(constants, y, chord.inverse_length, half_psi);
        let twist = half_psi.cross(m);
        let even = m + half_psi * half_psi.dot(m);
        Gradient {
            force: a.frame.to_space(n[0]) + b.frame.to_space(n[1]),
            moment_a: n[0].cross(y[0]) - (even + twist),
            moment_b: n[1].cross(y[1]) + (even - twist),
            fold: fold(constants, w),
        }
    }
}

/// The rule with one constant strain per element.
pub struct Helical;

impl Rule for Helical {
    fn constants(rod: &Rod, q: usize, time_step: f64) -> [f64; THINNING_ROWS] {
        constants(rod, q, time_step, 1.0, 1.0)
    }

    #[inline(always)]
    fn gradient<S: Simd, L: Law>(
        constants: &[Row<S>],
        a: &Pose<S>,
        b: &Pose<S>,
        chord: &Chord<S>,
    ) -> Gradient<S> {
        let relative = a.rotation.relative(b.rotation);
        let Logarithm {
            psi,
            angle_squared,
            c,
            slope,
            ..
        } = logarithm(relative);
        let y = a.frame.to_body(chord.dx);
        let psi_y = psi.dot(y);
        let double_cross = psi * psi_y - y * angle_squared;
        let strain = y - psi.cross(y) * 0.5 + double_cross * c;
        let ([n], m) = L::stress(constants, [strain], inverse_length(strain), psi);

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
            fold: fold(constants, relative.w),
        }
    }
}

/// The logarithm of a rotation, and the coefficient of its tangent; see
/// [`InverseTangentCoefficients`](crate::mechanics::rotation::InverseTangentCoefficients).
#[derive(Clone, Copy, Debug)]
pub struct Logarithm<S: Simd> {
    pub psi: Vec3<S>,
    pub angle_squared: Lanes<S>,
    pub c: Lanes<S>,
    pub slope: Lanes<S>,
    pub bend: Lanes<S>,
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

/// Of the derivative of the slope over `θ` once more, `4 d²c/d(θ²)²`.
const BEND_SERIES: [f64; SERIES_TERMS] = {
    let mut series = [0.0; SERIES_TERMS];
    let mut i = 0;
    while i < SERIES_TERMS {
        series[i] = 4.0 * ((i + 2) * (i + 1)) as f64 * INVERSE_TANGENT_SERIES[i + 2];
        i += 1;
    }
    series
};

#[inline(always)]
pub fn logarithm<S: Simd>(rotation: Quaternion<S>) -> Logarithm<S> {
    let Quaternion { w, v } = rotation;
    let t = v.dot(v);
    let stretch = t.polynomial(&ARCSINE);
    let angle_squared = stretch * stretch * t * 4.0;
    let near = Logarithm {
        psi: v * (stretch + stretch),
        angle_squared,
        c: angle_squared.polynomial(&C_SERIES),
        slope: angle_squared.polynomial(&SLOPE_SERIES),
        bend: angle_squared.polynomial(&BEND_SERIES),
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
        bend: w.select_below(NEAR, far.bend, near.bend),
    }
}

/// Any rotation but those near the identity: three halvings of the angle lead to the near range. `w >= 0`, `t = |v|²`.
///
/// `c = (1 - (θ/2) cot(θ/2))/θ²` satisfies `c'/θ = (1/4 - 3c + c²θ²)/θ²`; with this slope `s`, `s'/θ = (2c² - 5s + 2csθ²)/θ²`.
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
    let slope = (c * c * angle_squared - c * 3.0 + 0.25) / angle_squared;
    Logarithm {
        psi: v * (stretch + stretch),
        angle_squared,
        c,
        slope,
        bend: (c * c * 2.0 - slope * 5.0 + c * slope * angle_squared * 2.0) / angle_squared,
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
        /// the far `c` is below a few roundings of one over the angle's square (at least 0.255); the slope has three times
        /// its error, over that square.
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
            // Five times the error of the slope, over the square again.
            prop_assert!(error(log.bend, exact.bend) <= 7.1e-13);
            prop_assert!(error(log.slope, exact.slope) <= 3.6e-14, "{} {}", log.slope.value, exact.slope);
        }
    }
}
