//! The strain rules: strains of elements, and what a stress does to their ends; see [`element`](cosserat::element)
//! for the formulas.
//!
//! They are those of [`TangentRule::strain`](cosserat::element::TangentRule::strain) and
//! [`pull`](cosserat::element::TangentRule::pull) without the matrices `S`, `G` and `P`, which nothing else in an explicit step
//! needs: strain and pull take 99 multiplications in place of 144 (helical) and 24 in place of 57 (trapezoidal), besides those that turn
//! vectors between frames, and a step that is solved for keeps 12 numbers of a strain.

use pulp::Simd;

use super::active::ActiveBlocks;
use super::element::{
    Chord, FramedPose, Gradient, LINEAR_STIFFNESS, SectionLaw, THINNING_ROWS, constants, fold,
    inverse_length,
};
use super::logarithm::{Logarithm, logarithm};
use super::vector::{Frame, Lanes, Quaternion, Row, Vec3, row};
pub(crate) use cosserat::element::Stress;
use cosserat::element::{Helical, Trapezoidal};
use cosserat::rod::Rod;

/// The strains of an element, and what else a stress needs to pull at its ends.
#[derive(Clone, Copy, Debug)]
pub struct Strained<S: Simd> {
    /// `R_aᵀ dx`, and `R_bᵀ dx` under the trapezoidal rule.
    pub chord: [Vec3<S>; 2],
    /// Linear strain times `l`, at the first end only under the helical rule.
    pub linear: [Vec3<S>; 2],
    /// Relative rotation, in the measure of the rule.
    pub psi: Vec3<S>,
    /// Of the logarithm, under the helical rule.
    pub angle_squared: Lanes<S>,
    pub c: Lanes<S>,
    pub slope: Lanes<S>,
    /// Scalar part of the relative rotation, which is not stored.
    pub w: Lanes<S>,
}

/// What a stress does to the ends of an element: `(F, M_a, M_b)`, as a [`Gradient`].
#[derive(Clone, Copy, Debug)]
pub struct Pull<S: Simd> {
    pub force: Vec3<S>,
    pub moment_a: Vec3<S>,
    pub moment_b: Vec3<S>,
}

impl<S: Simd> Strained<S> {
    /// Returns the strain times `l`, with the rotation in the measure of the rule.
    #[inline(always)]
    pub fn measures(&self) -> Stress<S> {
        Stress {
            linear: self.linear,
            angular: self.psi,
        }
    }

    /// Returns the mean of two strains times `l`.
    #[inline(always)]
    pub fn mean(&self, other: &Self) -> Stress<S> {
        let half = Lanes::splat(self.w.simd, 0.5);
        self.measures().plus(other.measures()).times(half)
    }
}

/// Positive where an element has no stretch along the arm; not where there is no element. It counts where actuators press.
#[inline(always)]
pub fn pressed<S: Simd>(constants: &[Row<S>], strained: &Strained<S>) -> Lanes<S> {
    -(strained.linear[0].z * row(strained.w.simd, constants, LINEAR_STIFFNESS))
}

/// Rows of a stored [`Strained`].
pub const STRAINED_ROWS: usize = 12;

/// A strain rule: the [`StrainRule`](cosserat::StrainRule) of the same name.
pub trait Rule {
    /// Ends at which the linear strain is taken.
    const ENDS: usize;

    /// `linear` over `l` times the rule's weight of an end, `angular` over `l`, and the rest strains times `l`; the
    /// angular ones in the rule's measure of the rotation. Then what the dilatation needs.
    fn constants(rod: &Rod, q: usize, time_step: f64) -> [f64; THINNING_ROWS];

    fn strained<S: Simd>(a: &FramedPose<S>, b: &FramedPose<S>, chord: &Chord<S>) -> Strained<S>;

    /// To at most [`STRAINED_ROWS`] rows.
    fn store<S: Simd>(strained: &Strained<S>, rows: &mut [Row<S>]);

    fn load<S: Simd>(simd: S, rows: &[Row<S>]) -> Strained<S>;

    /// `Bᵀ` times a stress; `frames` are those of the ends.
    fn pull<S: Simd>(strained: &Strained<S>, frames: [&Frame<S>; 2], stress: &Stress<S>)
    -> Pull<S>;

    /// Subtracts what the actuators of a block do from the stress of its elements at a strain, see [`Strained::measures`].
    fn add_active<S: Simd>(
        active: &ActiveBlocks<S>,
        block: usize,
        strain: &Stress<S>,
        stress: &mut Stress<S>,
    );

    /// Returns the gradient of the energy of the elements of a block, with the actuators that pass them.
    fn gradient<S: Simd, L: SectionLaw>(
        constants: &[Row<S>],
        a: &FramedPose<S>,
        b: &FramedPose<S>,
        chord: &Chord<S>,
        active: Option<(ActiveBlocks<S>, usize)>,
    ) -> Gradient<S>;
}

impl<S: Simd> Pull<S> {
    #[inline(always)]
    fn with_fold(self, fold: Lanes<S>) -> Gradient<S> {
        Gradient {
            force: self.force,
            moment_a: self.moment_a,
            moment_b: self.moment_b,
            fold,
        }
    }
}

impl Rule for Trapezoidal {
    const ENDS: usize = <Self as cosserat::element::TangentRule>::ENDS;

    /// The measure of the rotation is `ψ/2`.
    fn constants(rod: &Rod, q: usize, time_step: f64) -> [f64; THINNING_ROWS] {
        constants(rod, q, time_step, 0.5, 0.5)
    }

    #[inline(always)]
    fn strained<S: Simd>(a: &FramedPose<S>, b: &FramedPose<S>, chord: &Chord<S>) -> Strained<S> {
        let y = [a.frame.to_body(chord.dx), b.frame.to_body(chord.dx)];
        let Quaternion { w, v } = a.rotation.relative(b.rotation);
        // v/w; at exactly half a turn zero instead of infinite, so that a lane without an element stays without force.
        let half_psi = v * (w / (w * w + f64::MIN_POSITIVE));
        Strained {
            chord: y,
            linear: y,
            psi: half_psi,
            angle_squared: w,
            c: w,
            slope: w,
            w,
        }
    }

    #[inline(always)]
    fn store<S: Simd>(strained: &Strained<S>, rows: &mut [Row<S>]) {
        strained.linear[0].store(rows, 0);
        strained.linear[1].store(rows, 3);
        strained.psi.store(rows, 6);
    }

    #[inline(always)]
    fn load<S: Simd>(simd: S, rows: &[Row<S>]) -> Strained<S> {
        let y = [Vec3::load(simd, rows, 0), Vec3::load(simd, rows, 3)];
        let one = Lanes::splat(simd, 1.0);
        Strained {
            chord: y,
            linear: y,
            psi: Vec3::load(simd, rows, 6),
            angle_squared: one,
            c: one,
            slope: one,
            w: one,
        }
    }

    #[inline(always)]
    fn pull<S: Simd>(
        strained: &Strained<S>,
        [a, b]: [&Frame<S>; 2],
        stress: &Stress<S>,
    ) -> Pull<S> {
        let Stress {
            linear: n,
            angular: m,
        } = *stress;
        let (y, half_psi) = (strained.linear, strained.psi);
        let twist = half_psi.cross(m);
        let even = m + half_psi * half_psi.dot(m);
        Pull {
            force: a.to_space(n[0]) + b.to_space(n[1]),
            moment_a: n[0].cross(y[0]) - (even + twist),
            moment_b: n[1].cross(y[1]) + (even - twist),
        }
    }

    #[inline(always)]
    fn add_active<S: Simd>(
        active: &ActiveBlocks<S>,
        block: usize,
        strain: &Stress<S>,
        stress: &mut Stress<S>,
    ) {
        active.add_stress::<2>(block, strain.linear, strain.angular * 2.0, stress);
    }

    #[inline(always)]
    fn gradient<S: Simd, L: SectionLaw>(
        constants: &[Row<S>],
        a: &FramedPose<S>,
        b: &FramedPose<S>,
        chord: &Chord<S>,
        active: Option<(ActiveBlocks<S>, usize)>,
    ) -> Gradient<S> {
        let strained = Self::strained(a, b, chord);
        let (linear, angular) = L::stress(
            constants,
            strained.linear,
            chord.inverse_length,
            strained.psi,
        );
        let mut stress = Stress { linear, angular };
        let mut fold = fold(constants, strained.w);
        if let Some((active, block)) = active {
            Self::add_active(&active, block, &strained.measures(), &mut stress);
            fold = fold.max(pressed(constants, &strained));
        }
        Self::pull(&strained, [&a.frame, &b.frame], &stress).with_fold(fold)
    }
}

impl Rule for Helical {
    const ENDS: usize = <Self as cosserat::element::TangentRule>::ENDS;

    fn constants(rod: &Rod, q: usize, time_step: f64) -> [f64; THINNING_ROWS] {
        constants(rod, q, time_step, 1.0, 1.0)
    }

    #[inline(always)]
    fn strained<S: Simd>(a: &FramedPose<S>, b: &FramedPose<S>, chord: &Chord<S>) -> Strained<S> {
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
        Strained {
            chord: [y; 2],
            linear: [strain; 2],
            psi,
            angle_squared,
            c,
            slope,
            w: relative.w,
        }
    }

    #[inline(always)]
    fn store<S: Simd>(strained: &Strained<S>, rows: &mut [Row<S>]) {
        strained.chord[0].store(rows, 0);
        strained.linear[0].store(rows, 3);
        strained.psi.store(rows, 6);
        rows[9] = strained.angle_squared.value;
        rows[10] = strained.c.value;
        rows[11] = strained.slope.value;
    }

    #[inline(always)]
    fn load<S: Simd>(simd: S, rows: &[Row<S>]) -> Strained<S> {
        Strained {
            chord: [Vec3::load(simd, rows, 0); 2],
            linear: [Vec3::load(simd, rows, 3); 2],
            psi: Vec3::load(simd, rows, 6),
            angle_squared: row(simd, rows, 9),
            c: row(simd, rows, 10),
            slope: row(simd, rows, 11),
            w: Lanes::splat(simd, 1.0),
        }
    }

    #[inline(always)]
    fn pull<S: Simd>(
        strained: &Strained<S>,
        [a, _]: [&Frame<S>; 2],
        stress: &Stress<S>,
    ) -> Pull<S> {
        let Strained {
            psi,
            angle_squared,
            c,
            slope,
            ..
        } = *strained;
        let (y, n, m) = (strained.chord[0], stress.linear[0], stress.angular);
        let psi_y = psi.dot(y);
        let psi_n = psi.dot(n);
        let y_n = y.dot(n);
        // μ = m + ∂(n·S(ψ) y)/∂ψ
        let along_psi = slope * (psi_n * psi_y - angle_squared * y_n) - c * (y_n + y_n);
        let mu = m + n.cross(y) * 0.5 + n * (c * psi_y) + y * (c * psi_n) + psi * along_psi;
        let w = n + psi.cross(n) * 0.5 + (psi * psi_n - n * angle_squared) * c;
        let odd = psi.cross(mu) * 0.5;
        let even = mu + (psi * psi.dot(mu) - mu * angle_squared) * c;
        Pull {
            force: a.to_space(w),
            moment_a: w.cross(y) - (even + odd),
            moment_b: even - odd,
        }
    }

    #[inline(always)]
    fn add_active<S: Simd>(
        active: &ActiveBlocks<S>,
        block: usize,
        strain: &Stress<S>,
        stress: &mut Stress<S>,
    ) {
        active.add_stress::<1>(block, strain.linear, strain.angular, stress);
    }

    #[inline(always)]
    fn gradient<S: Simd, L: SectionLaw>(
        constants: &[Row<S>],
        a: &FramedPose<S>,
        b: &FramedPose<S>,
        chord: &Chord<S>,
        active: Option<(ActiveBlocks<S>, usize)>,
    ) -> Gradient<S> {
        let strained = Self::strained(a, b, chord);
        let strain = strained.linear[0];
        let ([n], angular) = L::stress(constants, [strain], inverse_length(strain), strained.psi);
        let mut stress = Stress {
            linear: [n; 2],
            angular,
        };
        let mut fold = fold(constants, strained.w);
        if let Some((active, block)) = active {
            Self::add_active(&active, block, &strained.measures(), &mut stress);
            fold = fold.max(pressed(constants, &strained));
        }
        Self::pull(&strained, [&a.frame, &b.frame], &stress).with_fold(fold)
    }
}
