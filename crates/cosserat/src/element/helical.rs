//! The helical rule: one constant strain per element, from the exponential of SE(3).
//!
//! With `ψ = log(R_aᵀ R_b)`, `y = R_aᵀ dx` and `S(ψ) = I - ψ̂/2 + c ψ̂²`, `c = (1 - (θ/2) cot(θ/2))/θ²`, the strains times the length are
//! `S y` and `ψ`. Their variations are `δψ = Sᵀ η_b - S η_a` and `δ(S y) = S (R_aᵀ δdx + ŷ η_a) + G δψ`, `G = ∂(S y)/∂ψ`. A stress `(n, m)`
//! pulls with
//!
//! ```text
//! F = R_a w,   M_a = w × y - Sᵀ μ,   M_b = S μ,     w = Sᵀ n,   μ = m + Gᵀ n
//! ```

use nalgebra::Vector3;
use pulp::{Scalar, Simd};

use super::ElementPose;
use super::rule::{Blocks, Elasticity, Helical, Stress, TangentRule};
use crate::logarithm::{Logarithm, logarithm};
use crate::rotation::{log, log_tangent};
use crate::vector::{Lanes, Mat3, Quaternion, Vec3};

/// Returns `S(ψ) = I - ψ̂/2 + c ψ̂²`.
#[inline(always)]
pub fn inverse_tangent<S: Simd>(log: &Logarithm<S>) -> Mat3<S> {
    let psi_hat = Mat3::hat(log.psi);
    let square = Mat3::outer(log.psi, log.psi) - Mat3::multiple(log.angle_squared);
    let identity = Mat3::multiple(Lanes::splat(log.c.simd, 1.0));
    identity - psi_hat * 0.5 + square * log.c
}

/// Returns the derivative along `ψ` of `S^{(T)} y = y + (sign/2) ψ × y + c (ψ (ψ·y) - |ψ|² y)`.
#[inline(always)]
pub fn tangent_derivative<S: Simd>(log: &Logarithm<S>, y: Vec3<S>, sign: f64) -> Mat3<S> {
    let psi = log.psi;
    let along = psi.dot(y);
    let double_cross = psi * along - y * log.angle_squared;
    let inner = Mat3::outer(psi, y) - Mat3::outer(y, psi) * 2.0 + Mat3::multiple(along);
    Mat3::hat(y) * (-0.5 * sign) + inner * log.c + Mat3::outer(double_cross * log.slope, psi)
}

/// Returns `∂²(n·S(ψ)y)/∂ψ²`.
#[inline(always)]
fn curvature_of_coupling<S: Simd>(log: &Logarithm<S>, n: Vec3<S>, y: Vec3<S>) -> Mat3<S> {
    let psi = log.psi;
    let (p, r, s) = (psi.dot(n), psi.dot(y), n.dot(y));
    let q = p * r - log.angle_squared * s;
    let grad_q = n * r + y * p - psi * (s + s);
    let hess_q = Mat3::outer(n, y) + Mat3::outer(y, n) - Mat3::multiple(s + s);
    let turned = Mat3::outer(psi, grad_q) + Mat3::outer(grad_q, psi);
    let own = Mat3::multiple(log.slope) + Mat3::outer(psi * log.bend, psi);
    hess_q * log.c + turned * log.slope + own * q
}

/// The strains `(S y, ψ)` of an element, linearized at a pose: `δψ = Sᵀ η_b - S η_a` and `δ(S y) = S (z + y × η_a) + G δψ`, with the motion
/// `z = R_aᵀ δdx` of the chord in the frame of end a.
#[derive(Clone, Copy, Debug)]
pub struct HelicalChart<S: Simd> {
    /// `R_aᵀ dx`
    pub y: Vec3<S>,
    /// `S = I - ψ̂/2 + c ψ̂²`
    pub s: Mat3<S>,
    /// `G = ∂(S y)/∂ψ`
    pub g: Mat3<S>,
}

impl<S: Simd> HelicalChart<S> {
    #[inline(always)]
    pub fn at(log: &Logarithm<S>, y: Vec3<S>) -> Self {
        Self {
            y,
            s: inverse_tangent(log),
            g: tangent_derivative(log, y, -1.0),
        }
    }

    /// Returns the derivatives of `ψ` along `η_a` and `η_b`.
    #[inline(always)]
    pub fn angular(&self) -> [Mat3<S>; 2] {
        [-self.s, self.s.transpose()]
    }

    /// Returns the derivatives of `S y` along `η_a` and `η_b`; that along `z` is `S`.
    #[inline(always)]
    pub fn linear(&self) -> [Mat3<S>; 2] {
        [
            self.s.product_hat(self.y) - self.g.product(self.s),
            self.g.product_transposed(self.s),
        ]
    }

    /// Returns `δ(S y)` and `δψ` of a motion `(z, η_a, η_b)`.
    #[inline(always)]
    pub fn apply(&self, [z, near, far]: [Vec3<S>; 3]) -> [Vec3<S>; 2] {
        let turn = self.s.apply_transposed(far) - self.s.apply(near);
        let shift = z + self.y.cross(near);
        [self.s.apply(shift) + self.g.apply(turn), turn]
    }

    /// Returns the covectors `w = Sᵀ n` of `z` and `μ = m + Gᵀ n` of `δψ` under a stress `(n, m)`.
    #[inline(always)]
    fn covectors(&self, stress: &Stress<S>) -> [Vec3<S>; 2] {
        let n = stress.linear[0];
        let mu = stress.angular + self.g.apply_transposed(n);
        [self.s.apply_transposed(n), mu]
    }

    /// Returns the transpose of [`Self::apply`] of a stress: the covectors `(w, M_a, M_b)` of `(z, η_a, η_b)`.
    #[inline(always)]
    pub fn apply_transposed(&self, stress: &Stress<S>) -> [Vec3<S>; 3] {
        let [w, mu] = self.covectors(stress);
        let near = w.cross(self.y) - self.s.apply_transposed(mu);
        [w, near, self.s.apply(mu)]
    }
}

impl HelicalChart<Scalar> {
    /// Returns the chart of one pose, and `ψ`.
    pub fn of(pose: &ElementPose) -> (Self, Vector3<f64>) {
        let psi = log(&pose.rotation_a.tr_mul(pose.rotation_b));
        let y = pose.rotation_a.tr_mul(&pose.dx);
        let chart = Self {
            y: Vec3::splat(Scalar, &y),
            s: Mat3::of_matrix(&log_tangent(&psi)),
            g: Mat3::of_matrix(&super::tangent_derivative(&psi, &y, -1.0)),
        };
        (chart, psi)
    }
}

/// The quantities that the helical rule needs of a pose.
#[derive(Clone, Copy)]
pub struct HelicalPose<S: Simd> {
    r: Mat3<S>,
    log: Logarithm<S>,
    chart: HelicalChart<S>,
}

impl<S: Simd> HelicalPose<S> {
    /// Returns `l δv` along `(dx; body a; body b)`.
    #[inline(always)]
    fn linear_derivative(&self) -> [Mat3<S>; 3] {
        let [near, far] = self.chart.linear();
        [self.chart.s.product_transposed(self.r), near, far]
    }
}

impl TangentRule for Helical {
    type Pose<S: Simd> = HelicalPose<S>;
    const ENDS: usize = 1;
    const PATTERN: [[bool; 3]; 3] = [
        [true, true, true],
        [false, false, false],
        [false, true, true],
    ];

    #[inline(always)]
    fn pose<S: Simd>(dx: Vec3<S>, r: Mat3<S>, r_b: Mat3<S>) -> HelicalPose<S> {
        let relative = r.transposed_product(r_b);
        let w = ((relative.trace() + 1.0).sqrt()) * 0.5;
        let v = relative.vee() * (Lanes::splat(dx.x.simd, 0.5) / w);
        Self::pose_at(dx, r, r_b, Quaternion { w, v })
    }

    #[inline(always)]
    fn pose_at<S: Simd>(
        dx: Vec3<S>,
        r: Mat3<S>,
        _: Mat3<S>,
        relative: Quaternion<S>,
    ) -> HelicalPose<S> {
        let log = logarithm(relative);
        let y = r.apply_transposed(dx);
        HelicalPose {
            r,
            log,
            chart: HelicalChart::at(&log, y),
        }
    }

    #[inline(always)]
    fn strain<S: Simd>(pose: &HelicalPose<S>) -> Stress<S> {
        Stress {
            linear: [pose.chart.s.apply(pose.chart.y); 2],
            angular: pose.log.psi,
        }
    }

    #[inline(always)]
    fn derivative<S: Simd>(pose: &HelicalPose<S>) -> Blocks<S> {
        let none = Mat3::zero(pose.chart.y.x.simd);
        let [near, far] = pose.chart.angular();
        [pose.linear_derivative(), [none; 3], [none, near, far]]
    }

    #[inline(always)]
    fn pull<S: Simd>(pose: &HelicalPose<S>, stress: &Stress<S>) -> [Vec3<S>; 3] {
        let [w, near, far] = pose.chart.apply_transposed(stress);
        [pose.r.apply(w), near, far]
    }

    #[inline(always)]
    fn stiffness_under<S: Simd>(
        law: &Elasticity<S>,
        pose: &HelicalPose<S>,
        stress: &Stress<S>,
    ) -> Blocks<S> {
        let HelicalPose { r, log, chart } = *pose;
        let HelicalChart { y, s, g } = chart;
        let Elasticity { c1, c2, .. } = *law;
        let n = stress.linear[0];
        let [w, mu] = chart.covectors(stress);
        let turned = tangent_derivative(&log, n, 1.0);
        let bent = g.scale_rows(c1);
        let b = s.transposed_product(bent) + turned;
        let d = Mat3::diagonal(c2) + g.transposed_product(bent) + curvature_of_coupling(&log, n, y);
        let a = s.transposed_product(s.scale_rows(c1));
        // F = R_a w
        let w_near = a.product_hat(y) - b.product(s);
        let force_x = r.product(a).product_transposed(r);
        let force_a = r.product(w_near - Mat3::hat(w));
        let force_b = r.product(b.product_transposed(s));
        // M_b = S μ, M_a = w × y - Sᵀ μ
        let mu_near = b.transpose().product_hat(y) - d.product(s);
        let turn_b = tangent_derivative(&log, mu, -1.0);
        let turn_a = tangent_derivative(&log, mu, 1.0);
        let b_b = (s.product(d) + turn_b).product_transposed(s);
        let b_a = s.product(mu_near) - turn_b.product(s);
        let a_a = turn_a.product(s) - s.transposed_product(mu_near) - Mat3::hat_product(y, w_near)
            + Mat3::hat(w).product_hat(y);
        [
            [force_x, force_a, force_b],
            [force_a.transpose(), a_a, b_a.transpose()],
            [force_b.transpose(), b_a, b_b],
        ]
    }

    #[inline(always)]
    fn coupling<S: Simd>(
        law: &Elasticity<S>,
        start: &HelicalPose<S>,
        end: &HelicalPose<S>,
    ) -> Blocks<S> {
        let simd = law.c1.x.simd;
        let (left, right) = (start.linear_derivative(), end.linear_derivative());
        let mut x = [[Mat3::zero(simd); 3]; 3];
        for (j, right) in right.into_iter().enumerate() {
            let stressed = right.scale_rows(law.c1);
            for (i, left) in left.into_iter().enumerate() {
                x[i][j] = left.transposed_product(stressed);
            }
        }
        let (left, right) = (start.chart.angular(), end.chart.angular());
        for (j, right) in right.into_iter().enumerate() {
            let stressed = right.scale_rows(law.c2);
            for (i, left) in left.into_iter().enumerate() {
                x[1 + i][1 + j] = x[1 + i][1 + j] + left.transposed_product(stressed);
            }
        }
        x
    }
}
