//! Poses, frames and strains of an arm at one instant, and the stresses that follow from them.

use std::marker::PhantomData;

use pulp::{Simd, WithSimd};

use super::coupling::{Instant, SolvedRule};
use crate::lanes::element::{Chord, FramedPose, excess, proportional};
use crate::lanes::rule::{STRAINED_ROWS, Strained, Stress};
use crate::lanes::sweep::{POSITION, STATE_ROWS};
use crate::lanes::vector::{Frame, Quaternion, Row, Vec3, blocks, blocks_mut};
use cosserat::implicit::IntervalWeights;
use cosserat::time::TimeScheme;

/// Rows of a block at one instant: frames of the nodes, then strains of the elements.
pub const INSTANT_ROWS: usize = STRAINED + STRAINED_ROWS;
pub(super) const STRAINED: usize = 9;

/// Frames and strains of a state.
pub struct Settle<'a, R> {
    pub state: &'a [f64],
    pub instant: &'a mut [f64],
    pub rule: PhantomData<R>,
}

impl<R: SolvedRule> WithSimd for Settle<'_, R> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let state = blocks::<S, STATE_ROWS>(self.state);
        let instant = blocks_mut::<S, INSTANT_ROWS>(self.instant);
        let n_blocks = state.len();
        for i in 0..n_blocks {
            let a = pose(simd, &state[i], POSITION);
            let b = if i + 1 < n_blocks {
                pose(simd, &state[i + 1], POSITION)
            } else {
                next_lane(pose(simd, &state[0], POSITION))
            };
            let chord = Chord::between(a.position, b.position);
            a.frame.store(&mut instant[i], 0);
            let strained = R::strained(&a, &b, &chord);
            R::store(&strained, &mut instant[i][STRAINED..]);
        }
    }
}

#[inline(always)]
pub(super) fn pose<S: Simd>(simd: S, rows: &[Row<S>], at: usize) -> FramedPose<S> {
    FramedPose::of(
        Vec3::load(simd, rows, at),
        Quaternion::load(simd, rows, at + 3),
    )
}

#[inline(always)]
pub(super) fn next_lane<S: Simd>(pose: FramedPose<S>) -> FramedPose<S> {
    FramedPose {
        position: pose.position.next_lane(),
        rotation: pose.rotation.next_lane(),
        frame: pose.frame.next_lane(),
    }
}

#[inline(always)]
pub(super) fn framed<S: Simd>(simd: S, trial: &[Row<S>], end: &[Row<S>]) -> FramedPose<S> {
    FramedPose {
        position: Vec3::load(simd, trial, 0),
        rotation: Quaternion::load(simd, trial, 3),
        frame: Frame::load(simd, end, 0),
    }
}

/// The elements to the right of a block of nodes.
#[inline(always)]
pub(super) fn instant<S: Simd, R: SolvedRule>(
    simd: S,
    rows: &[[Row<S>; INSTANT_ROWS]],
    block: usize,
) -> Instant<S> {
    let a = Frame::load(simd, &rows[block], 0);
    let b = match rows.get(block + 1) {
        Some(next) => Frame::load(simd, next, 0),
        None => Frame::load(simd, &rows[0], 0).next_lane(),
    };
    Instant {
        strained: R::load(simd, &rows[block][STRAINED..]),
        to_body: [a.transposed(), b.transposed()],
    }
}

/// Returns `C (γ (s^k - s_rest) + β (s^{k+1} - s_rest))` as `C (β (s^{k+1} - s^k) + (γ + β) (s^k - s_rest))`, so that the constant part of
/// a strain is not lost by rounding in its change. The sum of the weights is one, or zero if the elastic stress is that of the time nodes.
#[inline(always)]
pub(super) fn interval_stress<S: Simd, R: SolvedRule>(
    constants: &[Row<S>],
    before: &Strained<S>,
    after: &Strained<S>,
    weights: IntervalWeights,
    scheme: TimeScheme,
) -> Stress<S> {
    let mut near = (after.linear[0] - before.linear[0]) * weights.end;
    let mut far = (after.linear[1] - before.linear[1]) * weights.end;
    let mut turn = (after.psi - before.psi) * weights.end;
    if scheme == TimeScheme::Implicit {
        let (linear, angular) = excess(constants, before.linear, before.psi);
        near = near + linear[0];
        far = far + linear[1];
        turn = turn + angular;
    }
    stress::<S, R>(constants, [near, far], turn)
}

/// Returns the stress of a strain at both ends, or at the single end that the rule has.
#[inline(always)]
fn stress<S: Simd, R: SolvedRule>(
    constants: &[Row<S>],
    linear: [Vec3<S>; 2],
    angular: Vec3<S>,
) -> Stress<S> {
    let (linear, angular) = if R::ENDS == 1 {
        let ([n], m) = proportional(constants, [linear[0]], angular);
        ([n; 2], m)
    } else {
        proportional(constants, linear, angular)
    };
    Stress { linear, angular }
}

#[inline(always)]
pub(super) fn elastic_stress<S: Simd, R: SolvedRule>(
    constants: &[Row<S>],
    strained: &Strained<S>,
) -> Stress<S> {
    let (linear, angular) = excess(constants, strained.linear, strained.psi);
    stress::<S, R>(constants, linear, angular)
}
