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

use pulp::Simd;

use super::rule::{Blocks, Stress, TangentRule};
use crate::mechanics::part::{Part, apart};
use crate::mechanics::vector::{Lanes, Mat3, Vec3};

/// The coordinate of an actuator per length of the rod, as a function of the tangent `p` of its line and of the twist `κ₃`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Density {
    /// `-|p|`: a tendon, whose tension does work as it gets shorter.
    Shortening,
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
    pub fn effort_unit(self) -> &'static str {
        match self {
            Self::Shortening | Self::Lengthening => "N",
            Self::Volume | Self::Braid { .. } => "Pa",
            Self::Muscle => "",
        }
    }

    /// Returns the unit of the coordinate.
    #[must_use]
    pub fn coordinate_unit(self) -> &'static str {
        match self {
            Self::Shortening | Self::Lengthening => "m",
            Self::Volume | Self::Braid { .. } => "m³",
            Self::Muscle => "J",
        }
    }

    /// Returns the density itself, for `λ` and `κ₃`, or for the axial component of `p` of a [`Self::Volume`].
    fn value(self, stretch: f64, twist: f64) -> f64 {
        match self {
            Self::Shortening => -stretch,
            Self::Lengthening | Self::Volume => stretch,
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
    fn slopes<S: Simd>(self, stretch: Lanes<S>, twist: Lanes<S>) -> Slopes<S> {
        let simd = stretch.simd;
        let of = |value: f64| Lanes::splat(simd, value);
        let along_stretch = match self {
            Self::Shortening => of(-1.0),
            Self::Lengthening | Self::Volume => of(1.0),
            Self::Muscle => -muscle_force(stretch),
            Self::Braid { fibre, turns } => {
                let inverse = of(1.0) / (twist + std::f64::consts::TAU * turns);
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
            twist: of(0.0),
        }
    }

    #[inline(always)]
    fn bends<S: Simd>(self, stretch: Lanes<S>, twist: Lanes<S>) -> Bends<S> {
        let simd = stretch.simd;
        let of = |value: f64| Lanes::splat(simd, value);
        let mut bends = Bends {
            stretch: of(0.0),
            mixed: of(0.0),
            twist: of(0.0),
        };
        match self {
            Self::Shortening | Self::Lengthening | Self::Volume => {}
            Self::Muscle => bends.stretch = -muscle_slope(stretch),
            Self::Braid { fibre, turns } => {
                let inverse = of(1.0) / (twist + std::f64::consts::TAU * turns);
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

    /// `[d]×`
    #[inline(always)]
    fn arm(&self) -> Mat3<S> {
        let [x, y] = self.offset;
        Mat3::hat(Vec3::of(x, y, Lanes::splat(x.simd, 0.0)))
    }

    /// Returns the derivative of the coordinate along `(l v, ψ)`, with the strain at one end.
    #[inline(always)]
    fn slope(&self, density: Density, linear: Vec3<S>, psi: Vec3<S>) -> (Vec3<S>, Vec3<S>) {
        let zero = Lanes::splat(psi.x.simd, 0.0);
        if density == Density::Volume {
            let g = Vec3::of(zero, zero, self.weight);
            return (g, self.moment(g));
        }
        let line = self.tangent_line(linear, psi);
        let length = (line.dot(line) + LEAST_SQUARE).sqrt();
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
        density: Density,
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

    /// Returns `∂²y` along `(l v, ψ)` with the strain at one end: linear, mixed and angular block.
    #[inline(always)]
    fn bend(&self, density: Density, linear: Vec3<S>, psi: Vec3<S>) -> [Mat3<S>; 3] {
        let simd = psi.x.simd;
        let line = self.tangent_line(linear, psi);
        let length = (line.dot(line) + LEAST_SQUARE).sqrt();
        let (stretch, turn) = (length * self.inverse_length, psi.z * self.inverse_length);
        let slopes = density.slopes(stretch, turn);
        let bends = density.bends(stretch, turn);
        let way = line * (Lanes::splat(simd, 1.0) / length);
        let scale = self.weight * self.inverse_length;
        // ∂²φ/∂p² = f_λλ t tᵀ + f_λ/λ (I - t tᵀ)
        let across = slopes.stretch / stretch;
        let along = Mat3::outer(way, way);
        let a = (along * bends.stretch
            + (Mat3::multiple(Lanes::splat(simd, 1.0)) - along) * across)
            * scale;
        let arm = self.arm();
        let b = way * (bends.mixed * scale);
        let axis = Vec3::of(
            Lanes::splat(simd, 0.0),
            Lanes::splat(simd, 0.0),
            Lanes::splat(simd, 1.0),
        );
        // ∂(l p)/∂ψ = -[d]×
        let mixed = Mat3::outer(b, axis) - a.product(arm);
        let turned = Mat3::outer(arm.apply(b), axis);
        let angular = turned + turned.transpose() - arm.product(a.product(arm))
            + Mat3::outer(axis, axis) * (bends.twist * scale);
        [a, mixed, angular]
    }

    /// Returns the second derivative of the coordinate; zero for a [`Density::Volume`].
    #[inline(always)]
    pub fn bends<const ENDS: usize>(
        &self,
        density: Density,
        linear: [Vec3<S>; 2],
        psi: Vec3<S>,
    ) -> ActiveTangent<S> {
        let simd = psi.x.simd;
        if density == Density::Volume {
            return ActiveTangent::zero(simd);
        }
        let [a, mixed, angular] = self.bend(density, linear[0], psi);
        if ENDS == 1 {
            return ActiveTangent {
                linear: [a, Mat3::zero(simd)],
                mixed: [mixed, Mat3::zero(simd)],
                angular,
            };
        }
        let [far, mixed_far, angular_far] = self.bend(density, linear[1], psi);
        ActiveTangent {
            linear: [a * 0.5, far * 0.5],
            mixed: [mixed * 0.5, mixed_far * 0.5],
            angular: (angular + angular_far) * 0.5,
        }
    }
}

impl ActivePoint<pulp::Scalar> {
    /// Returns the coordinate, with the mean over the ends that the rule has.
    pub fn value(
        &self,
        density: Density,
        linear: &[Vec3<pulp::Scalar>],
        psi: Vec3<pulp::Scalar>,
    ) -> f64 {
        let inverse = self.inverse_length.value;
        let of = |v: &Vec3<pulp::Scalar>| {
            let line = self.tangent_line(*v, psi);
            let stretch = match density {
                Density::Volume => line.z,
                _ => line.norm(),
            };
            density.value(stretch.value * inverse, psi.z.value * inverse)
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

    #[inline(always)]
    pub fn plus(self, other: Self, factor: Lanes<S>) -> Self {
        let add = |a: Mat3<S>, b: Mat3<S>| a + b * factor;
        Self {
            linear: [0, 1].map(|i| add(self.linear[i], other.linear[i])),
            mixed: [0, 1].map(|i| add(self.mixed[i], other.mixed[i])),
            angular: add(self.angular, other.angular),
        }
    }

    /// Returns `Lᵀ T R` of two derivatives of the strains of an element by one rule.
    #[inline(always)]
    pub fn between<R: TangentRule>(&self, left: &Blocks<S>, right: &Blocks<S>) -> Blocks<S> {
        let part = Between::<S, R> {
            tangent: self,
            left,
            right,
            rule: PhantomData,
        };
        apart(self.angular.rows[0].x.simd, part)
    }
}

/// The arguments of [`ActiveTangent::between`].
struct Between<'a, S: Simd, R> {
    tangent: &'a ActiveTangent<S>,
    left: &'a Blocks<S>,
    right: &'a Blocks<S>,
    rule: PhantomData<R>,
}

impl<S: Simd, R: TangentRule> Part for Between<'_, S, R> {
    type Output = Blocks<S>;

    #[inline(always)]
    fn run(self) -> Blocks<S> {
        let Self {
            tangent,
            left,
            right,
            ..
        } = self;
        let simd = tangent.angular.rows[0].x.simd;
        let zero = Mat3::zero(simd);
        let ends = if R::END_WEIGHT == 1.0 { 1 } else { 2 };
        let mut out = [[zero; 3]; 3];
        for j in 0..3 {
            // T R, column j: of the strains at the ends and of the angular one.
            let turn = R::PATTERN[2][j].then_some(right[2][j]);
            let mut angular = turn.map_or(zero, |turn| tangent.angular.product(turn));
            let mut linear = [zero; 2];
            for end in 0..ends {
                if R::PATTERN[end][j] {
                    let moved = right[end][j];
                    linear[end] = tangent.linear[end].product(moved);
                    angular = angular + tangent.mixed[end].transposed_product(moved);
                }
                if let Some(turn) = turn {
                    linear[end] = linear[end] + tangent.mixed[end].product(turn);
                }
            }
            for i in 0..3 {
                for end in 0..ends {
                    if R::PATTERN[end][i] {
                        out[i][j] = out[i][j] + left[end][i].transposed_product(linear[end]);
                    }
                }
                if R::PATTERN[2][i] {
                    out[i][j] = out[i][j] + left[2][i].transposed_product(angular);
                }
            }
        }
        out
    }
}
