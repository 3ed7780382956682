//! Second derivatives of the effect of an interval's stress on an element, several time nodes at a time.
//!
//! Strains are multiplied by the length, as in [`element`](cosserat::element).

use std::marker::PhantomData;

use pulp::Simd;

use cosserat::element::{
    Blocks, Displacement, Elasticity, Stress, TangentRule, Turns, stiffness_under,
};
use cosserat::implicit::IntervalWeights;
use cosserat::part::{Part, apart};
use cosserat::vector::{Lanes, Mat3, Vec3};

/// An element at one end of an interval, and the constant components `(dx; body a; body b)` along which its pull is taken.
#[derive(Clone, Copy)]
pub struct CurvedEnd<S: Simd> {
    pub dx: Vec3<S>,
    pub rotations: [Mat3<S>; 2],
    pub covector: [Vec3<S>; 3],
}

/// See [`StressCurvature`](crate::curvature::StressCurvature).
pub struct StressBlocks<S: Simd> {
    pub start: Blocks<S>,
    pub cross: Blocks<S>,
    pub end: Blocks<S>,
}

/// An end of the interval with the strain there, its derivative `B`, and the derivative of `B` along the covector.
struct Bent<S: Simd, R: TangentRule> {
    displacement: Displacement<S>,
    poses: [R::Pose<S>; 3],
    derivative: Blocks<S>,
    bend: Blocks<S>,
}

/// The arguments of [`Bent::at`].
struct BentAt<'a, S: Simd, R, P> {
    end: &'a CurvedEnd<S>,
    length: f64,
    kind: PhantomData<(R, P)>,
}

impl<S: Simd, R: TangentRule, P: Turns<S>> Part for BentAt<'_, S, R, P> {
    type Output = Bent<S, R>;

    #[inline(always)]
    fn run(self) -> Bent<S, R> {
        Bent::at::<P>(self.end, self.length)
    }
}

impl<S: Simd, R: TangentRule> Bent<S, R> {
    #[inline(always)]
    fn at<P: Turns<S>>(end: &CurvedEnd<S>, length: f64) -> Self {
        let CurvedEnd {
            dx,
            rotations,
            covector,
        } = *end;
        let displacement = Displacement::along(covector, length);
        let [a, b] = rotations;
        let mut poses = [P::pose::<R>(dx, a, b); 3];
        let derivative = R::derivative(&poses[0]);
        let mut moved = [derivative; 2];
        for (i, sign) in [1.0, -1.0].into_iter().enumerate() {
            let (dx, [a, b]) = displacement.moved(dx, rotations, sign);
            poses[1 + i] = P::pose::<R>(dx, a, b);
            moved[i] = R::derivative(&poses[1 + i]);
        }
        let [ahead, behind] = moved;
        let mut bend = derivative;
        for (i, row) in bend.iter_mut().enumerate() {
            for (j, block) in row.iter_mut().enumerate() {
                if !R::PATTERN[i][j] {
                    continue;
                }
                *block = displacement.difference(ahead[i][j], behind[i][j]);
                if j > 0 {
                    *block = *block - derivative[i][j].product_hat(covector[j]);
                }
            }
        }
        Self {
            displacement,
            poses,
            derivative,
            bend,
        }
    }

    /// Returns the derivative of the strain along the covector.
    #[inline(always)]
    fn along(&self) -> Stress<S> {
        let simd = self.displacement.covector[0].x.simd;
        let mut sums = [Vec3::zero(simd); 3];
        for (i, sum) in sums.iter_mut().enumerate() {
            for j in 0..3 {
                if R::PATTERN[i][j] {
                    *sum = *sum + self.derivative[i][j].apply(self.displacement.covector[j]);
                }
            }
        }
        let [a, b, angular] = sums;
        Stress {
            linear: [a, b],
            angular,
        }
    }

    /// Returns the second derivative with both directions at this end, whose strain has the given weight in the stress.
    #[inline(always)]
    fn own(
        &self,
        law: &Elasticity<S>,
        stress: &Stress<S>,
        along: &Stress<S>,
        weight: f64,
    ) -> Blocks<S> {
        let weight = Lanes::splat(law.c1.x.simd, weight);
        let slack = law.times(Lanes::splat(weight.simd, 0.0));
        let [here, ahead, behind] = &self.poses;
        let mut own = self.displacement.curvature(&[
            stiffness_under::<S, R>(&slack, here, stress),
            stiffness_under::<S, R>(&slack, ahead, stress),
            stiffness_under::<S, R>(&slack, behind, stress),
        ]);
        let bent = stiffness_under::<S, R>(&slack, here, &law.stress(along.times(weight)));
        let mixed = coupled::<S, R>(law, &self.bend, &self.derivative);
        for i in 0..3 {
            for j in 0..3 {
                let both = mixed[i][j] + mixed[j][i].transpose();
                let turned = (bent[i][j] + bent[j][i].transpose()) * 0.5;
                own[i][j] = own[i][j] + both * weight + turned;
            }
        }
        own
    }
}

/// The arguments of [`Bent::own`].
struct Own<'a, S: Simd, R: TangentRule> {
    bent: &'a Bent<S, R>,
    law: &'a Elasticity<S>,
    stress: &'a Stress<S>,
    along: &'a Stress<S>,
    weight: f64,
}

impl<S: Simd, R: TangentRule> Part for Own<'_, S, R> {
    type Output = Blocks<S>;

    #[inline(always)]
    fn run(self) -> Blocks<S> {
        self.bent
            .own(self.law, self.stress, self.along, self.weight)
    }
}

/// Returns `Lᵀ C R` of two derivatives of strains.
#[inline(always)]
fn coupled<S: Simd, R: TangentRule>(
    law: &Elasticity<S>,
    left: &Blocks<S>,
    right: &Blocks<S>,
) -> Blocks<S> {
    let mut x = [[Mat3::zero(law.c1.x.simd); 3]; 3];
    for (strain, pattern) in R::PATTERN.iter().enumerate() {
        let stiffness = if strain < 2 { law.c1 } else { law.c2 };
        for j in 0..3 {
            if !pattern[j] {
                continue;
            }
            let stressed = right[strain][j].scale_rows(stiffness);
            for i in 0..3 {
                if pattern[i] {
                    x[i][j] = x[i][j] + left[strain][i].transposed_product(stressed);
                }
            }
        }
    }
    x
}

/// Returns the curvature of an element of the given length over an interval.
///
/// With `d = B w` of either end, the function is `(d_start + d_end)·σ`, and `σ` is linear in the strains of both ends. Its second
/// derivatives are those of the strains themselves, at the given stress ([`TangentRule::stiffness_under`]) and at the stress of the strains
/// `d`, and the derivatives of `d` along `w`, which are central differences.
#[inline(always)]
pub fn stress_curvature<S: Simd, R: TangentRule, P: Turns<S>>(
    law: &Elasticity<S>,
    length: f64,
    weights: IntervalWeights,
    ends: &[CurvedEnd<S>; 2],
) -> StressBlocks<S> {
    let simd = law.c1.x.simd;
    let bent = |end| BentAt::<S, R, P> {
        end,
        length,
        kind: PhantomData,
    };
    let start = apart(simd, bent(&ends[0]));
    let end = apart(simd, bent(&ends[1]));
    let [near, far] = [R::strain(&start.poses[0]), R::strain(&end.poses[0])];
    let of = |weight: f64| Lanes::splat(simd, weight);
    let elastic = near.minus(law.rest).times(of(weights.start + weights.end));
    let stress = law.stress(elastic.plus(far.minus(near).times(of(weights.end))));
    let along = start.along().plus(end.along());
    let mut cross = coupled::<S, R>(law, &start.bend, &end.derivative);
    let other = coupled::<S, R>(law, &start.derivative, &end.bend);
    for i in 0..3 {
        for j in 0..3 {
            cross[i][j] = cross[i][j] * weights.end + other[i][j] * weights.start;
        }
    }
    let own = |bent, weight| Own {
        bent,
        law,
        stress: &stress,
        along: &along,
        weight,
    };
    StressBlocks {
        start: apart(simd, own(&start, weights.start)),
        cross,
        end: apart(simd, own(&end, weights.end)),
    }
}
