//! The stress that actuators add to the elements which they pass.
//!
//! An actuator with the effort `u` and the coordinate `y` has the potential `-u y`. Its coordinate is an integral over the rest length,
//! evaluated at few points, of a [`Density`] of the extension `p` and of the twist `κ₃`:
//!
//! ```text
//! y = Σ w φ(p, κ₃)            p = v + κ × d + d'
//! ```
//!
//! `d` is the offset of the actuator in the section, `d'` its derivative along the rest length, and `p` the tangent of the actuator's line
//! in the frame of the section, so that `|p| ds` is the length of the line. The stress beside the elastic one is
//!
//! ```text
//! n = -u w/l φ_p              m = -u w/l (d × φ_p + φ_κ₃ e₃)
//! ```
//!
//! Under the trapezoidal rule `φ` is the mean of its values at the strains of both ends. Strains are multiplied by the length of the
//! element here, as in the [rules](super::rule), so that stresses are derivatives along `(l v, ψ)`.

use std::marker::PhantomData;
use std::sync::Arc;

use pulp::Simd;

use super::learned::{Learned, LearnedSlopes};
use super::rule::{Blocks, Stress, TangentRule};
use crate::part::{Part, apart};
use crate::vector::{Lanes, Mat3, Vec3};

/// The coordinate of an actuator per length of the rod, as a function of the tangent `p` of its line and of the twist `κ₃`.
#[derive(Clone, Debug, PartialEq)]
pub enum Density {
    /// `-|p|`: a tendon, whose tension does work as it gets shorter.
    Shortening,
    /// `-|p| + s² q/24 + c (√(q + κ₀²) - κ₀)` with `q = κ₁² + κ₂²` and `κ₀ = 8 c/s²`: a tendon through disks at the distance `s`, between which it
    /// is straight, in holes that are wider than it by `c` on every side. On an arc a chord is shorter than the line through the section by
    /// the second term, to second order in `s`. A pulled tendon lies on the side of its holes to which the arm bends, which shortens its
    /// way by `c` times the curvature, once that is above `κ₀`: there an arc of the length `s` is `c` high. Below, a tendon is straight
    /// through several disks.
    Threaded {
        /// `s`, m, above 0.
        spacing: f64,
        /// `c`, m, 0 or more.
        clearance: f64,
    },
    /// `|p|`: a rod that pushes.
    Lengthening,
    /// `p·e₃`: a chamber whose section stays plane and keeps its area; the volume divided by that area.
    Volume,
    /// `-∫ w(λ) dλ` from 1 to `λ = |p|`, with `w = 3.06 λ³ - 13.64 λ² + 18.01 λ - 6.44`, zero where that is negative and beyond `λ = 2`: a
    /// muscle, by the relation of active force and length in COOMM (Shih et al. 2023).
    Muscle,
    /// `π λ (β² - λ²)/(2πν + κ₃)²` with `λ = |p|`: the volume inside a braid of inextensible fibres (Chou and Hannaford 1996).
    Braid {
        /// `β`, length of a fibre over that of the rod.
        fibre: f64,
        /// `ν`, turns of a fibre per length of the rod, 1/m.
        turns: f64,
    },
    /// `-W(x)` of the strains `x` of the section, from data.
    Learned(Arc<Learned>),
}

/// Coefficients of `w(λ)` of a muscle, the constant one first.
const MUSCLE: [f64; 4] = [-6.44, 18.01, -13.64, 3.06];
/// The interval of `λ` between the zeros of the polynomial in which a muscle pulls.
const MUSCLE_RANGE: [f64; 2] = [0.577_292_199, 1.595_965_219];

/// Far below the square of any length.
const LEAST_SQUARE: f64 = 1e-200;

/// First derivatives of a density along `λ = |p|` and `κ₃`.
struct Slopes<S: Simd> {
    stretch: Lanes<S>,
    twist: Lanes<S>,
}

/// Second derivatives.
struct Bends<S: Simd> {
    stretch: Lanes<S>,
    mixed: Lanes<S>,
    twist: Lanes<S>,
}

impl Density {
    /// Returns the unit of the effort; empty for a number.
    #[must_use]
    pub fn effort_unit(&self) -> &'static str {
        match self {
            Self::Shortening | Self::Threaded { .. } | Self::Lengthening => "N",
            Self::Volume | Self::Braid { .. } => "Pa",
            Self::Muscle | Self::Learned(_) => "",
        }
    }

    /// Returns the unit of the coordinate.
    #[must_use]
    pub fn coordinate_unit(&self) -> &'static str {
        match self {
            Self::Shortening | Self::Threaded { .. } | Self::Lengthening => "m",
            Self::Volume | Self::Braid { .. } => "m³",
            Self::Muscle | Self::Learned(_) => "J",
        }
    }

    /// Tells whether it is that of a tendon.
    #[must_use]
    pub fn is_tendon(&self) -> bool {
        matches!(self, Self::Shortening | Self::Threaded { .. })
    }

    /// Returns the factor of `|p|` in a density that is a multiple of it.
    #[inline(always)]
    fn length_sign(&self) -> Option<f64> {
        match self {
            Self::Shortening | Self::Threaded { .. } => Some(-1.0),
            Self::Lengthening => Some(1.0),
            Self::Volume | Self::Muscle | Self::Braid { .. } | Self::Learned(_) => None,
        }
    }

    /// Returns the part of the density that depends on `q = κ₁² + κ₂²`, 1/m².
    fn bent(&self, q: f64) -> f64 {
        match self {
            Self::Threaded { spacing, clearance } => {
                let least = 8.0 * clearance / (spacing * spacing);
                let shift = if *clearance > 0.0 {
                    clearance * q / ((q + least * least).sqrt() + least)
                } else {
                    0.0
                };
                spacing * spacing / 24.0 * q + shift
            }
            _ => 0.0,
        }
    }

    /// Returns twice the first derivative of that part along `q`, m², and four times the second one, m⁴, for a bending; `None` of a density
    /// without it.
    #[inline(always)]
    fn bent_slopes<S: Simd>(&self, kappa: [Lanes<S>; 2]) -> Option<[Lanes<S>; 2]> {
        let Self::Threaded { spacing, clearance } = self else {
            return None;
        };
        let simd = kappa[0].simd;
        let chord = Lanes::splat(simd, spacing * spacing / 12.0);
        if *clearance == 0.0 {
            return Some([chord, Lanes::splat(simd, 0.0)]);
        }
        let least = 8.0 * clearance / (spacing * spacing);
        let q = kappa[0] * kappa[0] + kappa[1] * kappa[1] + least * least;
        let slope = Lanes::splat(simd, *clearance) / q.sqrt();
        Some([chord + slope, -(slope / q)])
    }

    /// Returns the part of the density that depends on `λ` and `κ₃`, or for the axial component of `p` of a [`Self::Volume`]; zero of a learned
    /// one.
    fn value(&self, stretch: f64, twist: f64) -> f64 {
        match self {
            Self::Shortening | Self::Threaded { .. } => -stretch,
            Self::Lengthening | Self::Volume => stretch,
            Self::Learned(_) => 0.0,
            Self::Muscle => {
                let [a, b, c, d] = MUSCLE;
                let integral = |x: f64| x * (a + x * (b / 2.0 + x * (c / 3.0 + x * d / 4.0)));
                let [from, to] = MUSCLE_RANGE;
                integral(1.0) - integral(stretch.clamp(from, to))
            }
            Self::Braid { fibre, turns } => {
                let whole = std::f64::consts::TAU * turns + twist;
                std::f64::consts::PI * stretch * (fibre * fibre - stretch * stretch)
                    / (whole * whole)
            }
        }
    }

    #[inline(always)]
    fn slopes<S: Simd>(&self, stretch: Lanes<S>, twist: Lanes<S>) -> Slopes<S> {
        let simd = stretch.simd;
        let one = Lanes::splat(simd, 1.0);
        let along_stretch = match self {
            Self::Shortening | Self::Threaded { .. } => -one,
            Self::Lengthening | Self::Volume => one,
            Self::Learned(_) => Lanes::splat(simd, 0.0),
            Self::Muscle => -muscle_force(stretch),
            Self::Braid { fibre, turns } => {
                let inverse = one / (twist + std::f64::consts::TAU * turns);
                let area = -(stretch * stretch * 3.0) + fibre * fibre;
                let square = inverse * inverse;
                return Slopes {
                    stretch: area * square * std::f64::consts::PI,
                    twist: stretch
                        * (-(stretch * stretch) + fibre * fibre)
                        * (square * inverse)
                        * -std::f64::consts::TAU,
                };
            }
        };
        Slopes {
            stretch: along_stretch,
            twist: Lanes::splat(simd, 0.0),
        }
    }

    #[inline(always)]
    fn bends<S: Simd>(&self, stretch: Lanes<S>, twist: Lanes<S>) -> Bends<S> {
        let simd = stretch.simd;
        let zero = Lanes::splat(simd, 0.0);
        let mut bends = Bends {
            stretch: zero,
            mixed: zero,
            twist: zero,
        };
        match self {
            Self::Shortening
            | Self::Threaded { .. }
            | Self::Lengthening
            | Self::Volume
            | Self::Learned(_) => {}
            Self::Muscle => bends.stretch = -muscle_slope(stretch),
            Self::Braid { fibre, turns } => {
                let one = Lanes::splat(simd, 1.0);
                let inverse = one / (twist + std::f64::consts::TAU * turns);
                let square = inverse * inverse;
                let cube = square * inverse;
                let area = -(stretch * stretch * 3.0) + fibre * fibre;
                let volume = stretch * (-(stretch * stretch) + fibre * fibre);
                bends.stretch = stretch * square * (-6.0 * std::f64::consts::PI);
                bends.mixed = area * cube * -std::f64::consts::TAU;
                bends.twist = volume * (square * square) * (6.0 * std::f64::consts::PI);
            }
        }
        bends
    }
}

/// `w(λ)`
#[inline(always)]
fn muscle_force<S: Simd>(stretch: Lanes<S>) -> Lanes<S> {
    let zero = Lanes::splat(stretch.simd, 0.0);
    let inside = stretch.polynomial(&MUSCLE).max(zero);
    stretch.select_below(MUSCLE_RANGE[1], inside, zero)
}

/// `w'(λ)`, zero where `w` is cut off.
#[inline(always)]
fn muscle_slope<S: Simd>(stretch: Lanes<S>) -> Lanes<S> {
    let zero = Lanes::splat(stretch.simd, 0.0);
    let [_, b, c, d] = MUSCLE;
    let inside = stretch.polynomial(&[b, 2.0 * c, 3.0 * d]);
    let inside = stretch.select_below(MUSCLE_RANGE[0], zero, inside);
    stretch.select_below(MUSCLE_RANGE[1], inside, zero)
}

/// A point at which the coordinate of an actuator is evaluated, in one element of each lane.
#[derive(Clone, Copy)]
pub struct ActivePoint<S: Simd> {
    /// `w/l`; zero in a lane whose element the actuator does not pass.
    pub weight: Lanes<S>,
    /// `d`, which lies in the section, m.
    pub offset: [Lanes<S>; 2],
    /// `l d'`, m.
    pub way: [Lanes<S>; 2],
    /// `1/l`
    pub inverse_length: Lanes<S>,
}

/// Second derivative of a coordinate along the strains `(l v_a, l v_b, ψ)` of an element; the ends do not mix. The helical rule uses the
/// first end only.
#[derive(Clone, Copy)]
pub struct ActiveTangent<S: Simd> {
    pub linear: [Mat3<S>; 2],
    /// Rows of the linear strain, columns of the angular one.
    pub mixed: [Mat3<S>; 2],
    pub angular: Mat3<S>,
}

impl<S: Simd> ActivePoint<S> {
    /// `l p` for a strain at one end.
    #[inline(always)]
    fn tangent_line(&self, linear: Vec3<S>, psi: Vec3<S>) -> Vec3<S> {
        let [first, second] = self.offset;
        Vec3::of(
            linear.x - psi.z * second + self.way[0],
            linear.y + psi.z * first + self.way[1],
            linear.z + psi.x * second - psi.y * first,
        )
    }

    /// `d × g`
    #[inline(always)]
    fn moment(&self, g: Vec3<S>) -> Vec3<S> {
        let [first, second] = self.offset;
        Vec3::of(second * g.z, -(first * g.z), first * g.y - second * g.x)
    }

    /// Returns the derivative of the coordinate along `(l v, ψ)`, with the strain at one end.
    #[inline(always)]
    fn slope(&self, density: &Density, linear: Vec3<S>, psi: Vec3<S>) -> (Vec3<S>, Vec3<S>) {
        let zero = Lanes::splat(psi.x.simd, 0.0);
        if matches!(density, Density::Volume) {
            let g = Vec3::of(zero, zero, self.weight);
            return (g, self.moment(g));
        }
        if let Density::Learned(own) = density {
            let (axial, angular) = apart(psi.x.simd, LearnedStress(self.learned(own, linear, psi)));
            return (Vec3::of(zero, zero, axial), angular);
        }
        let line = self.tangent_line(linear, psi);
        let length = (line.dot(line) + LEAST_SQUARE).sqrt();
        if let Some(sign) = density.length_sign() {
            let g = line * (self.weight * sign / length);
            let mut moment = self.moment(g);
            let kappa = [psi.x * self.inverse_length, psi.y * self.inverse_length];
            if let Some([slope, _]) = density.bent_slopes(kappa) {
                let slope = self.weight * self.inverse_length * slope;
                moment.x = moment.x + psi.x * slope;
                moment.y = moment.y + psi.y * slope;
            }
            return (g, moment);
        }
        let Slopes { stretch, twist } =
            density.slopes(length * self.inverse_length, psi.z * self.inverse_length);
        let g = line * (stretch * self.weight / length);
        let mut moment = self.moment(g);
        moment.z = moment.z + twist * self.weight;
        (g, moment)
    }

    /// Returns the derivative of the coordinate along `(l v_a, l v_b, ψ)`; a rule with one end has it in the first one.
    #[inline(always)]
    pub fn slopes<const ENDS: usize>(
        &self,
        density: &Density,
        linear: [Vec3<S>; 2],
        psi: Vec3<S>,
    ) -> Stress<S> {
        let (n, m) = self.slope(density, linear[0], psi);
        if ENDS == 1 {
            return Stress {
                linear: [n; 2],
                angular: m,
            };
        }
        let (far, m_far) = self.slope(density, linear[1], psi);
        Stress {
            linear: [n * 0.5, far * 0.5],
            angular: (m + m_far) * 0.5,
        }
    }

    /// Returns a learned density at the strain at one end.
    #[inline(always)]
    fn learned<'a>(&self, own: &'a Learned, linear: Vec3<S>, psi: Vec3<S>) -> LearnedAt<'a, S> {
        LearnedAt {
            at: *self,
            own,
            axial: linear.z,
            psi,
        }
    }

    /// [`Self::add_at`] of a learned density.
    #[inline(always)]
    fn add_learned(
        &self,
        own: &Learned,
        (linear, psi): (Vec3<S>, Vec3<S>),
        factor: Lanes<S>,
        end: usize,
        (first, second): (&mut Stress<S>, &mut ActiveTangent<S>),
    ) {
        let mut at = self.learned(own, linear, psi);
        at.at.weight = at.at.weight * factor;
        let slopes = apart(factor.simd, LearnedTangent(at));
        first.linear[end].z = first.linear[end].z + slopes.axial;
        first.angular = first.angular + slopes.angular;
        let axial = &mut second.linear[end].rows[2].z;
        *axial = *axial + slopes.axial_axial;
        let mixed = &mut second.mixed[end].rows[2];
        *mixed = *mixed + slopes.axial_angular;
        let [xx, xy, xz, yy, yz, zz] = slopes.angular_angular;
        let [x, y, z] = &mut second.angular.rows;
        *x = *x + Vec3::of(xx, xy, xz);
        *y = *y + Vec3::of(xy, yy, yz);
        *z = *z + Vec3::of(xz, yz, zz);
    }

    /// Adds `factor` times the first and the second derivative of the coordinate with the strain at one end.
    ///
    /// With the derivative `g = (t; d × t)` of `λ` along `(v, κ)`, that of `κ₃`, `e`, and the second derivative `D` of `|p|²/2`, which is
    /// constant, the second derivative of a density `f(λ, κ₃)` is `f_λ/λ (D - g gᵀ) + f_λλ g gᵀ + f_λκ (g eᵀ + e gᵀ) + f_κκ e eᵀ`.
    #[inline(always)]
    fn add_at(
        &self,
        density: &Density,
        strain: (Vec3<S>, Vec3<S>),
        factor: Lanes<S>,
        end: usize,
        (first, second): (&mut Stress<S>, &mut ActiveTangent<S>),
    ) {
        let (linear, psi) = strain;
        let simd = psi.x.simd;
        let weight = self.weight * factor;
        if matches!(density, Density::Volume) {
            let zero = Lanes::splat(simd, 0.0);
            let g = Vec3::of(zero, zero, weight);
            first.linear[end] = first.linear[end] + g;
            first.angular = first.angular + self.moment(g);
            return;
        }
        if let Density::Learned(own) = density {
            self.add_learned(own, strain, factor, end, (first, second));
            return;
        }
        let line = self.tangent_line(linear, psi);
        let length = (line.dot(line) + LEAST_SQUARE).sqrt();
        let inverse = Lanes::splat(simd, 1.0) / length;
        let way = line * inverse;
        let turn = self.moment(way);
        let (pull, across, along);
        if let Some(sign) = density.length_sign() {
            pull = weight * sign;
            across = pull * inverse;
            along = -across;
            let (kx, ky) = (psi.x * self.inverse_length, psi.y * self.inverse_length);
            if let Some([slope, bend]) = density.bent_slopes([kx, ky]) {
                let scale = weight * self.inverse_length;
                let (slope, bend) = (scale * slope, scale * bend);
                first.angular.x = first.angular.x + psi.x * slope;
                first.angular.y = first.angular.y + psi.y * slope;
                let [x, y, _] = &mut second.angular.rows;
                (x.x, y.y) = (x.x + slope + bend * kx * kx, y.y + slope + bend * ky * ky);
                let mixed = bend * kx * ky;
                (x.y, y.x) = (x.y + mixed, y.x + mixed);
            }
        } else {
            let (stretch, twist) = (length * self.inverse_length, psi.z * self.inverse_length);
            let slopes = density.slopes(stretch, twist);
            let bends = density.bends(stretch, twist);
            let scale = weight * self.inverse_length;
            pull = slopes.stretch * weight;
            across = pull * inverse;
            along = bends.stretch * scale - across;
            first.angular.z = first.angular.z + slopes.twist * weight;
            let mixed = bends.mixed * scale;
            let (way, turn) = (way * mixed, turn * mixed);
            let [x, y, z] = &mut second.mixed[end].rows;
            (x.z, y.z, z.z) = (x.z + way.x, y.z + way.y, z.z + way.z);
            let [x, y, z] = &mut second.angular.rows;
            (x.z, y.z, z.z) = (x.z + turn.x, y.z + turn.y, z.z + turn.z);
            *z = *z + turn;
            z.z = z.z + bends.twist * scale;
        }
        first.linear[end] = first.linear[end] + way * pull;
        first.angular = first.angular + turn * pull;
        let (from_way, from_turn) = (way * along, turn * along);
        let [d, e] = self.offset;
        let (d_across, e_across) = (d * across, e * across);
        let [x, y, z] = &mut second.linear[end].rows;
        *x = *x + way * from_way.x;
        *y = *y + way * from_way.y;
        *z = *z + way * from_way.z;
        (x.x, y.y, z.z) = (x.x + across, y.y + across, z.z + across);
        // D has -[d]× here
        let [x, y, z] = &mut second.mixed[end].rows;
        *x = *x + turn * from_way.x;
        *y = *y + turn * from_way.y;
        *z = *z + turn * from_way.z;
        (x.z, y.z) = (x.z - e_across, y.z + d_across);
        (z.x, z.y) = (z.x + e_across, z.y - d_across);
        // and -[d]×² here.
        let [x, y, z] = &mut second.angular.rows;
        *x = *x + turn * from_turn.x;
        *y = *y + turn * from_turn.y;
        *z = *z + turn * from_turn.z;
        let (dd, ee, de) = (d * d_across, e * e_across, d * e_across);
        (x.x, x.y) = (x.x + ee, x.y - de);
        (y.x, y.y) = (y.x - de, y.y + dd);
        z.z = z.z + (dd + ee);
    }

    /// Adds `factor` times the first and the second derivative of the coordinate along `(l v_a, l v_b, ψ)`; a rule with one end has them
    /// in the first one.
    #[inline(always)]
    pub fn add_derivatives<const ENDS: usize>(
        &self,
        density: &Density,
        (linear, psi): ([Vec3<S>; 2], Vec3<S>),
        factor: Lanes<S>,
        first: &mut Stress<S>,
        second: &mut ActiveTangent<S>,
    ) {
        if ENDS == 1 {
            self.add_at(density, (linear[0], psi), factor, 0, (first, second));
        } else {
            let half = factor * 0.5;
            let sums = (&mut *first, &mut *second);
            self.add_at(density, (linear[0], psi), half, 0, sums);
            self.add_at(density, (linear[1], psi), half, 1, (first, second));
        }
    }

    /// Returns the change `dy` of the coordinate along a change `(l δv_a, l δv_b, δψ)` of the strain, and the derivatives of `dy` along the
    /// components of `d` and of `l d'`; zeros of a learned density.
    ///
    /// With the gradient `g` of the coordinate along `l p` and the derivative `h` of `dy` along it, which is that along `l v`, a change `e` of `d`
    /// changes `dy` by `g·(δψ × e) + h·(ψ × e)`, and one of `l d'` by `h·e`.
    #[inline(always)]
    pub fn change<const ENDS: usize>(
        &self,
        density: &Density,
        (linear, psi): ([Vec3<S>; 2], Vec3<S>),
        [near, far, turn]: [Vec3<S>; 3],
    ) -> (Lanes<S>, [Lanes<S>; 4]) {
        let simd = psi.x.simd;
        let zero = Lanes::splat(simd, 0.0);
        let (mut first, mut second) = (Stress::zero(simd), ActiveTangent::zero(simd));
        let strain = (linear, psi);
        let one = Lanes::splat(simd, 1.0);
        self.add_derivatives::<ENDS>(density, strain, one, &mut first, &mut second);
        let mut change = first.angular.dot(turn);
        let mut slopes = [zero; 4];
        for (end, own) in [near, far].into_iter().enumerate().take(ENDS) {
            let g = first.linear[end];
            change = change + g.dot(own);
            let bent = second.linear[end].apply(own) + second.mixed[end].apply(turn);
            slopes[0] =
                slopes[0] + (g.y * turn.z - g.z * turn.y) + (bent.y * psi.z - bent.z * psi.y);
            slopes[1] =
                slopes[1] + (g.z * turn.x - g.x * turn.z) + (bent.z * psi.x - bent.x * psi.z);
            slopes[2] = slopes[2] + bent.x;
            slopes[3] = slopes[3] + bent.y;
        }
        if matches!(density, Density::Learned(_)) {
            slopes = [zero; 4];
        }
        (change, slopes)
    }
}

/// A learned density at a point of an actuator, for the strain at one end.
struct LearnedAt<'a, S: Simd> {
    at: ActivePoint<S>,
    own: &'a Learned,
    /// `l v₃`
    axial: Lanes<S>,
    psi: Vec3<S>,
}

impl<S: Simd> LearnedAt<'_, S> {
    /// Returns the derivatives of the coordinate, with the second ones if `BENT`.
    #[inline(always)]
    fn slopes<const BENT: bool>(self) -> LearnedSlopes<S> {
        let inverse = self.at.inverse_length;
        let slopes =
            (self.own).slopes::<S, BENT>(self.axial * inverse, self.psi * inverse, self.at.offset);
        // The coordinate is minus the potential.
        let weight = -self.at.weight;
        slopes.times(weight, weight * inverse)
    }
}

/// The first derivatives, along `l v₃` and `ψ`.
struct LearnedStress<'a, S: Simd>(LearnedAt<'a, S>);

impl<S: Simd> Part for LearnedStress<'_, S> {
    type Output = (Lanes<S>, Vec3<S>);

    #[inline(always)]
    fn run(self) -> Self::Output {
        let slopes = self.0.slopes::<false>();
        (slopes.axial, slopes.angular)
    }
}

/// First and second derivatives.
struct LearnedTangent<'a, S: Simd>(LearnedAt<'a, S>);

impl<S: Simd> Part for LearnedTangent<'_, S> {
    type Output = LearnedSlopes<S>;

    #[inline(always)]
    fn run(self) -> LearnedSlopes<S> {
        self.0.slopes::<true>()
    }
}

impl ActivePoint<pulp::Scalar> {
    /// Returns the coordinate, with the mean over the ends that the rule has.
    pub fn value(
        &self,
        density: &Density,
        linear: &[Vec3<pulp::Scalar>],
        psi: Vec3<pulp::Scalar>,
    ) -> f64 {
        let inverse = self.inverse_length.value;
        let of = |v: &Vec3<pulp::Scalar>| {
            if let Density::Learned(own) = density {
                let kappa = [psi.x, psi.y, psi.z].map(|own| own.value * inverse);
                let offset = self.offset.map(|own| own.value);
                return -own.value(&own.strains_at(v.z.value * inverse, kappa, offset));
            }
            let line = self.tangent_line(*v, psi);
            let stretch = match density {
                Density::Volume => line.z,
                _ => line.norm(),
            };
            let [x, y] = [psi.x, psi.y].map(|own| own.value * inverse);
            let bent = density.bent(x * x + y * y);
            density.value(stretch.value * inverse, psi.z.value * inverse) + bent
        };
        let mean = linear.iter().map(of).sum::<f64>() / linear.len() as f64;
        self.weight.value / inverse * mean
    }
}

impl<S: Simd> ActiveTangent<S> {
    #[inline(always)]
    pub fn zero(simd: S) -> Self {
        let zero = Mat3::zero(simd);
        Self {
            linear: [zero; 2],
            mixed: [zero; 2],
            angular: zero,
        }
    }

    /// Returns a multiple.
    #[inline(always)]
    pub fn times(mut self, factor: f64) -> Self {
        for end in 0..2 {
            self.linear[end] = self.linear[end] * factor;
            self.mixed[end] = self.mixed[end] * factor;
        }
        self.angular = self.angular * factor;
        self
    }

    /// Adds `Lᵀ T R` of two derivatives of the strains of an element by one rule.
    #[inline(always)]
    pub fn add_between<R: TangentRule>(
        &self,
        left: &Blocks<S>,
        right: &Blocks<S>,
        out: &mut Blocks<S>,
    ) {
        let part = Between::<S, R> {
            tangent: self,
            left,
            right,
            out,
            rule: PhantomData,
        };
        apart(self.angular.rows[0].x.simd, part);
    }
}

/// The arguments of [`ActiveTangent::add_between`].
struct Between<'a, S: Simd, R> {
    tangent: &'a ActiveTangent<S>,
    left: &'a Blocks<S>,
    right: &'a Blocks<S>,
    out: &'a mut Blocks<S>,
    rule: PhantomData<R>,
}

impl<S: Simd, R: TangentRule> Part for Between<'_, S, R> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self {
            tangent,
            left,
            right,
            out,
            ..
        } = self;
        let simd = tangent.angular.rows[0].x.simd;
        let zero = Mat3::zero(simd);
        for j in 0..3 {
            // T R, column j: of the strains at the ends and of the angular one.
            let turn = right[2][j];
            let mut angular = if R::PATTERN[2][j] {
                tangent.angular.product(turn)
            } else {
                zero
            };
            let mut linear = [zero; 2];
            for end in 0..R::ENDS {
                if R::PATTERN[end][j] {
                    let moved = right[end][j];
                    linear[end] = tangent.linear[end].product(moved);
                    angular = angular + tangent.mixed[end].transposed_product(moved);
                }
                if R::PATTERN[2][j] {
                    linear[end] = linear[end] + tangent.mixed[end].product(turn);
                }
            }
            for i in 0..3 {
                // Added at once: every sum with the stiffness of the arm itself is rounded by the size of that.
                let mut block = zero;
                for end in 0..R::ENDS {
                    if R::PATTERN[end][i] {
                        block = block + left[end][i].transposed_product(linear[end]);
                    }
                }
                if R::PATTERN[2][i] {
                    block = block + left[2][i].transposed_product(angular);
                }
                out[i][j] = out[i][j] + block;
            }
        }
    }
}
