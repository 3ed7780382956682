//! Elements, one per lane: the poses of their ends, and what stress follows from their strain.

use pulp::Simd;

use super::vector::{Frame, Lanes, Quaternion, Row, Vec3, row};
use cosserat::element::Thinning;
use cosserat::rod::Rod;

pub const LINEAR_STIFFNESS: usize = 0;
pub const ANGULAR_STIFFNESS: usize = 3;
/// The quantity at end a, then at end b.
const REST_LINEAR: usize = 6;
const REST_ANGULAR: usize = 12;
/// Rows of an element's constants: those above.
pub const STRESS_ROWS: usize = 15;

/// `l |v_rest|`; zero where there is no element.
const REST_STRETCH: usize = 15;
/// Factor of `Σ (y - y_rest)·n` that makes it `ε·C₁ε/2`, N.
const LINEAR_DENSITY: usize = 16;
/// Returns the same as above for `κ·C₂κ/2`.
const ANGULAR_DENSITY: usize = 17;
/// `EA |v_rest|²`
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
pub const THINNING_ROWS: usize = 28;

/// Position and rotation of a node.
#[derive(Clone, Copy, Debug)]
pub struct FramedPose<S: Simd> {
    pub position: Vec3<S>,
    pub rotation: Quaternion<S>,
    pub frame: Frame<S>,
}

impl<S: Simd> FramedPose<S> {
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
pub fn inverse_length<S: Simd>(v: Vec3<S>) -> Lanes<S> {
    Lanes::splat(v.x.simd, 1.0) / (v.dot(v) + LEAST_SQUARE).sqrt()
}

/// See [`Gradient`]: from the scalar part of the relative quaternion, which is continuous along the motion.
#[inline(always)]
pub fn fold<S: Simd>(constants: &[Row<S>], w: Lanes<S>) -> Lanes<S> {
    -(w * row(w.simd, constants, LINEAR_STIFFNESS))
}

/// Stress as a function of strain, see [`law`](cosserat::element::RodModel).
pub trait SectionLaw {
    /// Rows of an element's constants.
    const ROWS: usize;
    /// Tells whether stiffness and inertia follow the dilatation.
    const THINS: bool;
    /// Tells whether the kinetic energy pulls at the elements.
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

/// [`RodModel::Standard`](cosserat::RodModel::Standard)
pub struct Standard;

/// [`RodModel::Dilatation`](cosserat::RodModel::Dilatation)
pub struct Dilatation;

/// [`RodModel::Consistent`](cosserat::RodModel::Consistent)
pub struct Consistent;

/// Strain without that at rest.
#[inline(always)]
pub fn excess<S: Simd, const ENDS: usize>(
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

/// Stress of the standard model.
#[inline(always)]
pub fn proportional<S: Simd, const ENDS: usize>(
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

impl SectionLaw for Standard {
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

impl SectionLaw for Dilatation {
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
        let thinning = Thinning::frozen(inverse);
        for end in 0..ENDS {
            n[end] = n[end] * thinning.linear;
        }
        (n, m * thinning.angular)
    }
}

impl SectionLaw for Consistent {
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
        let mut linear = eps[0].dot(n[0]);
        for end in 1..ENDS {
            linear = linear + eps[end].dot(n[end]);
        }
        let thinning = Thinning::at(
            inverse,
            linear * row(simd, constants, LINEAR_DENSITY),
            kappa.dot(m) * row(simd, constants, ANGULAR_DENSITY),
            row(simd, constants, AXIAL),
        );
        let along = thinning.slope * inverse * row(simd, constants, ALONG);
        for end in 0..ENDS {
            n[end] = n[end] * thinning.linear;
        }
        // Along the chord or the strain: no matter at which end.
        n[0] = n[0] + y[0] * along;
        (n, m * thinning.angular)
    }
}

/// The rows of element `q`, for the linear stiffness times `end_weight`, and rotations measured in `half_turns` times `ψ`.
pub fn constants(
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
    rows[ANGULAR_DENSITY] = 0.5 / (half_turns * l);
    rows[AXIAL] = element.linear_stiffness.z * stretch * stretch;
    rows[ALONG] = 1.0 / (l * stretch * stretch);
    rows[REST_CHORD] = rod.rest_chords[q];
    rows[LEAST_DILATATION] = rod.least_dilatation(q, time_step);
    rows
}
