//! The trapezoidal rule of the paper, equations (59)-(62): linear strains at both ends with half weight each.
//!
//! With `ψ = cay⁻¹(R_aᵀ R_b)`, `P = I + ψ̂/2 + ψψᵀ/4` and `v_i = R_iᵀ dx` the strains times the length are `v_a`, `v_b` and `ψ`. Their
//! variations are `δv_i = R_iᵀ δdx + v̂_i η_i` and `δψ = P η_b - Pᵀ η_a`. A stress, with the weights of the ends in it, pulls with
//!
//! ```text
//! F = R_a n_a + R_b n_b,   M_a = n_a × v_a - P m,   M_b = n_b × v_b + Pᵀ m
//! ```

use pulp::Simd;

use super::rule::{Blocks, Elasticity, Stress, TangentRule, Trapezoidal};
use crate::vector::{Lanes, Mat3, Quaternion, Vec3};

/// The data of a pose that the trapezoidal rule uses.
#[derive(Clone, Copy)]
pub struct TrapezoidalPose<S: Simd> {
    rotations: [Mat3<S>; 2],
    v: [Vec3<S>; 2],
    psi: Vec3<S>,
    p: Mat3<S>,
}

impl<S: Simd> TrapezoidalPose<S> {
    #[inline(always)]
    fn of(dx: Vec3<S>, rotations: [Mat3<S>; 2], psi: Vec3<S>) -> Self {
        let identity = Mat3::multiple(Lanes::splat(dx.x.simd, 1.0));
        Self {
            rotations,
            v: [
                rotations[0].apply_transposed(dx),
                rotations[1].apply_transposed(dx),
            ],
            psi,
            p: identity + Mat3::hat(psi) * 0.5 + Mat3::outer(psi, psi) * 0.25,
        }
    }
}

impl TangentRule for Trapezoidal {
    type Pose<S: Simd> = TrapezoidalPose<S>;
    const ENDS: usize = 2;
    const PATTERN: [[bool; 3]; 3] = [
        [true, true, false],
        [true, false, true],
        [false, true, true],
    ];

    #[inline(always)]
    fn pose<S: Simd>(dx: Vec3<S>, a: Mat3<S>, b: Mat3<S>) -> TrapezoidalPose<S> {
        let relative = a.transposed_product(b);
        let psi = relative.vee() * (Lanes::splat(dx.x.simd, 4.0) / (relative.trace() + 1.0));
        TrapezoidalPose::of(dx, [a, b], psi)
    }

    #[inline(always)]
    fn pose_at<S: Simd>(
        dx: Vec3<S>,
        a: Mat3<S>,
        b: Mat3<S>,
        relative: Quaternion<S>,
    ) -> TrapezoidalPose<S> {
        let psi = relative.v * (Lanes::splat(dx.x.simd, 2.0) / relative.w);
        TrapezoidalPose::of(dx, [a, b], psi)
    }

    #[inline(always)]
    fn strain<S: Simd>(pose: &TrapezoidalPose<S>) -> Stress<S> {
        Stress {
            linear: pose.v,
            angular: pose.psi,
        }
    }

    /// `l δv_i = R_iᵀ δdx + v̂_i η_i`, `δψ = P η_b - Pᵀ η_a`.
    #[inline(always)]
    fn derivative<S: Simd>(pose: &TrapezoidalPose<S>) -> Blocks<S> {
        let TrapezoidalPose {
            rotations: [a, b],
            v,
            p,
            ..
        } = *pose;
        let none = Mat3::zero(v[0].x.simd);
        [
            [a.transpose(), Mat3::hat(v[0]), none],
            [b.transpose(), none, Mat3::hat(v[1])],
            [none, -p.transpose(), p],
        ]
    }

    #[inline(always)]
    fn pull<S: Simd>(pose: &TrapezoidalPose<S>, stress: &Stress<S>) -> [Vec3<S>; 3] {
        let TrapezoidalPose {
            rotations: [a, b],
            v,
            p,
            ..
        } = *pose;
        let (n, y) = (stress.linear, stress.angular);
        [
            a.apply(n[0]) + b.apply(n[1]),
            n[0].cross(v[0]) - p.apply(y),
            n[1].cross(v[1]) + p.apply_transposed(y),
        ]
    }

    #[inline(always)]
    fn stiffness_under<S: Simd>(
        law: &Elasticity<S>,
        pose: &TrapezoidalPose<S>,
        stress: &Stress<S>,
    ) -> Blocks<S> {
        let simd = law.c1.x.simd;
        let Elasticity { c1, c2, .. } = *law;
        let TrapezoidalPose {
            rotations,
            v,
            psi,
            p,
        } = *pose;
        let (n, y) = (stress.linear, stress.angular);
        let mut k = [[Mat3::zero(simd); 3]; 3];
        for (end, r) in rotations.into_iter().enumerate() {
            let stretched = Mat3::hat(v[end]).scale_rows(c1) - Mat3::hat(n[end]);
            let force = r.product(stretched);
            k[0][0] = k[0][0] + r.product(Mat3::diagonal(c1)).product_transposed(r);
            k[0][1 + end] = force;
            k[1 + end][0] = force.transpose();
            k[1 + end][1 + end] = stretched.transpose().product_hat(v[end]);
        }
        let outer = (Mat3::multiple(psi.dot(y)) + Mat3::outer(psi, y)) * 0.25;
        let half_y = Mat3::hat(y) * 0.5;
        let near = p.product(Mat3::diagonal(c2)) - half_y + outer;
        let far = p.transposed_product(Mat3::diagonal(c2)) + half_y + outer;
        k[1][1] = k[1][1] + near.product_transposed(p);
        k[1][2] = -near.product(p);
        k[2][1] = -far.product_transposed(p);
        k[2][2] = k[2][2] + far.product(p);
        k
    }

    /// `l δv_i = R_iᵀ δdx + v̂_i η_i`, `δψ = P η_b - Pᵀ η_a`.
    #[inline(always)]
    fn coupling<S: Simd>(
        law: &Elasticity<S>,
        start: &TrapezoidalPose<S>,
        end: &TrapezoidalPose<S>,
    ) -> Blocks<S> {
        let simd = law.c1.x.simd;
        let mut x = [[Mat3::zero(simd); 3]; 3];
        for i in 0..2 {
            let stretched = end.rotations[i].transpose().scale_rows(law.c1);
            let turned = Mat3::hat(end.v[i]).scale_rows(law.c1);
            let r = start.rotations[i];
            let v = start.v[i];
            x[0][0] = x[0][0] + r.product(stretched);
            x[0][1 + i] = r.product(turned);
            x[1 + i][0] = -Mat3::hat_product(v, stretched);
            x[1 + i][1 + i] = -Mat3::hat_product(v, turned);
        }
        let left = [-start.p.transpose(), start.p];
        let right = [-end.p.transpose(), end.p];
        for (j, right) in right.into_iter().enumerate() {
            let stressed = right.scale_rows(law.c2);
            for (i, left) in left.into_iter().enumerate() {
                x[1 + i][1 + j] = x[1 + i][1 + j] + left.transposed_product(stressed);
            }
        }
        x
    }
}
