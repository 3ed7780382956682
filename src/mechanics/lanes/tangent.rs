//! The linearization of rods of the standard model, several time nodes at a time; [`curved`](super::curved) has the second derivatives
//! of steps that are solved for.
//!
//! [`Element::stiffness`](crate::mechanics::strain::Element::stiffness), the [`NodeDrift`](crate::mechanics::linearization::NodeDrift)
//! and [`element_curvature`](crate::mechanics::curvature::element_curvature) are its clear counterparts and test oracles; notation
//! is theirs.

use nalgebra::{Matrix3, Vector3};
use pulp::Simd;

use super::logarithm::{Logarithm, logarithm};
use super::vector::{Lanes, Mat3, Quaternion, Row, Vec3};
use crate::mechanics::strain::Element;

/// Numbers of a pose: position, rotation matrix row by row.
pub const POSE_ROWS: usize = 12;

/// Writes a pose to a lane of [`POSE_ROWS`] rows of `n_lanes`.
pub fn put_pose(
    rows: &mut [f64],
    n_lanes: usize,
    lane: usize,
    position: &Vector3<f64>,
    rotation: &Matrix3<f64>,
) {
    for i in 0..3 {
        rows[i * n_lanes + lane] = position[i];
        for j in 0..3 {
            rows[(3 + 3 * i + j) * n_lanes + lane] = rotation[(i, j)];
        }
    }
}

/// A node at several time nodes.
#[derive(Clone, Copy)]
pub struct NodePose<S: Simd> {
    pub position: Vec3<S>,
    pub rotation: Mat3<S>,
}

impl<S: Simd> NodePose<S> {
    #[inline(always)]
    pub fn load(simd: S, rows: &[Row<S>]) -> Self {
        Self {
            position: Vec3::load(simd, rows, 0),
            rotation: Mat3::load(simd, rows, 3),
        }
    }
}

/// A matrix over `(dx; body a; body b)`, in blocks.
pub type Blocks<S> = [[Mat3<S>; 3]; 3];

/// `4 cos²` of half the angle between the ends of an element, `1 + tr`, from which on its relative rotation is taken apart
/// without loss of digits: up to 2.2 rad.
pub const LEAST_MARGIN: f64 = 0.75;

/// The parts of [`inertia_curvature`](crate::mechanics::curvature::inertia_curvature): before, mixed (rows before), after.
#[inline(always)]
pub fn inertia_curvature<S: Simd>(
    rotary: &Vector3<f64>,
    h: f64,
    turn: Mat3<S>,
    before: Vec3<S>,
    after: Vec3<S>,
) -> [Mat3<S>; 3] {
    let simd = before.x.simd;
    let inertia = Mat3::diagonal(Vec3::splat(
        simd,
        &rotary.map(|j| (0.5 * rotary.sum() - j) / h),
    ));
    let c = inertia.product_hat(before) - Mat3::hat_product(after, inertia);
    // The mixed cofactor of Cᵀ and F: of the rows of one and the other, both ways.
    let (c_t, f) = (c.transpose().rows, turn.rows);
    let mixed = Mat3 {
        rows: [
            c_t[1].cross(f[2]) + f[1].cross(c_t[2]),
            c_t[2].cross(f[0]) + f[2].cross(c_t[0]),
            c_t[0].cross(f[1]) + f[0].cross(c_t[1]),
        ],
    };
    let (near, far) = (turn.product(c), c.product(turn));
    [
        near.symmetric() - Mat3::multiple(near.trace()),
        mixed,
        far.symmetric() - Mat3::multiple(far.trace()),
    ]
}

/// A stress, or a strain times the length: linear at the two ends, and angular. The helical rule has the first of the linear ones only.
#[derive(Clone, Copy)]
pub struct Stress<S: Simd> {
    pub linear: [Vec3<S>; 2],
    pub angular: Vec3<S>,
}

impl<S: Simd> Stress<S> {
    #[inline(always)]
    pub fn plus(self, other: Self) -> Self {
        Self {
            linear: [
                self.linear[0] + other.linear[0],
                self.linear[1] + other.linear[1],
            ],
            angular: self.angular + other.angular,
        }
    }

    #[inline(always)]
    pub fn minus(self, other: Self) -> Self {
        self.plus(other.times(Lanes::splat(other.angular.x.simd, -1.0)))
    }

    #[inline(always)]
    pub fn times(self, factor: Lanes<S>) -> Self {
        Self {
            linear: [self.linear[0] * factor, self.linear[1] * factor],
            angular: self.angular * factor,
        }
    }
}

/// Stress per strain times the length, and the strain at rest times the length.
#[derive(Clone, Copy)]
pub struct Law<S: Simd> {
    pub c1: Vec3<S>,
    pub c2: Vec3<S>,
    pub rest: Stress<S>,
}

impl<S: Simd> Law<S> {
    #[inline(always)]
    pub fn of<R: TangentRule>(simd: S, element: &Element) -> Self {
        let l = element.length;
        let rest = |end: usize| Vec3::splat(simd, &(element.rest.linear[end] * l));
        Self {
            c1: Vec3::splat(simd, &(element.linear_stiffness * (R::END_WEIGHT / l))),
            c2: Vec3::splat(simd, &(element.angular_stiffness / l)),
            rest: Stress {
                linear: [rest(0), rest(1)],
                angular: Vec3::splat(simd, &(element.rest.curvature * l)),
            },
        }
    }

    /// Of a strain without that at rest.
    #[inline(always)]
    pub fn stress(&self, strain: Stress<S>) -> Stress<S> {
        Stress {
            linear: [
                strain.linear[0].component_mul(self.c1),
                strain.linear[1].component_mul(self.c1),
            ],
            angular: strain.angular.component_mul(self.c2),
        }
    }

    /// With so many times the stiffness.
    #[inline(always)]
    pub fn times(&self, factor: Lanes<S>) -> Self {
        Self {
            c1: self.c1 * factor,
            c2: self.c2 * factor,
            ..*self
        }
    }
}

/// A strain rule, as far as its stiffness is concerned.
pub trait TangentRule {
    /// What the rule needs of an element's pose.
    type Pose<S: Simd>: Copy;
    /// Weight of an end at which the linear strain is taken.
    const END_WEIGHT: f64;
    /// Which blocks of [`Self::derivative`] there are.
    const PATTERN: [[bool; 3]; 3];

    fn pose<S: Simd>(dx: Vec3<S>, a: Mat3<S>, b: Mat3<S>) -> Self::Pose<S>;

    /// The strain times the length.
    fn strain<S: Simd>(pose: &Self::Pose<S>) -> Stress<S>;

    /// The derivative of the strain: rows of the linear strain at either end, of which the helical rule has one, and of the angular one.
    fn derivative<S: Simd>(pose: &Self::Pose<S>) -> Blocks<S>;

    /// `Bᵀ` times a stress: `(F, M_a, M_b)`, as [`gradient_under`](crate::mechanics::strain::Element::gradient_under).
    fn pull<S: Simd>(pose: &Self::Pose<S>, stress: &Stress<S>) -> [Vec3<S>; 3];

    /// Derivative of the pull when the stress changes with the stiffness of a law, as
    /// [`stiffness_under`](crate::mechanics::strain::Element::stiffness_under).
    fn stiffness_under<S: Simd>(
        law: &Law<S>,
        pose: &Self::Pose<S>,
        stress: &Stress<S>,
    ) -> Blocks<S>;

    /// `B_startᵀ C B_end`, as [`coupling`](crate::mechanics::strain::Element::coupling).
    fn coupling<S: Simd>(law: &Law<S>, start: &Self::Pose<S>, end: &Self::Pose<S>) -> Blocks<S>;

    /// The [gradient](crate::mechanics::strain::Element::gradient) `(F, M_a, M_b)` of an element between two poses.
    #[inline(always)]
    fn gradient<S: Simd>(element: &Element, dx: Vec3<S>, a: Mat3<S>, b: Mat3<S>) -> [Vec3<S>; 3]
    where
        Self: Sized,
    {
        let (pose, law) = (Self::pose(dx, a, b), Law::of::<Self>(dx.x.simd, element));
        Self::pull(&pose, &law.stress(Self::strain(&pose).minus(law.rest)))
    }

    /// The stiffness of an element between two poses.
    #[inline(always)]
    fn stiffness<S: Simd>(element: &Element, dx: Vec3<S>, a: Mat3<S>, b: Mat3<S>) -> Blocks<S>
    where
        Self: Sized,
    {
        let (pose, law) = (Self::pose(dx, a, b), Law::of::<Self>(dx.x.simd, element));
        let stress = law.stress(Self::strain(&pose).minus(law.rest));
        Self::stiffness_under(&law, &pose, &stress)
    }
}

/// [`StrainRule::Helical`](crate::mechanics::StrainRule::Helical)
pub struct HelicalTangent;

/// [`StrainRule::Trapezoidal`](crate::mechanics::StrainRule::Trapezoidal)
pub struct TrapezoidalTangent;

/// `S^{(T)} y = y + (sign/2) ψ × y + c (ψ (ψ·y) - |ψ|² y)`: its derivative along `ψ`.
#[inline(always)]
pub fn tangent_derivative<S: Simd>(log: &Logarithm<S>, y: Vec3<S>, sign: f64) -> Mat3<S> {
    let psi = log.psi;
    let along = psi.dot(y);
    let double_cross = psi * along - y * log.angle_squared;
    let inner = Mat3::outer(psi, y) - Mat3::outer(y, psi) * 2.0 + Mat3::multiple(along);
    Mat3::hat(y) * (-0.5 * sign) + inner * log.c + Mat3::outer(double_cross * log.slope, psi)
}

/// `∂²(n·S(ψ)y)/∂ψ²`
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

/// What the helical rule needs of a pose.
#[derive(Clone, Copy)]
pub struct HelicalPose<S: Simd> {
    r: Mat3<S>,
    log: Logarithm<S>,
    /// `R_aᵀ dx`
    y: Vec3<S>,
    /// `S = I - ψ̂/2 + c ψ̂²`
    s: Mat3<S>,
    /// `∂(S y)/∂ψ`
    g: Mat3<S>,
}

impl<S: Simd> HelicalPose<S> {
    /// `l δv` along `(dx; body a; body b)`.
    #[inline(always)]
    fn linear_derivative(&self) -> [Mat3<S>; 3] {
        [
            self.s.product_transposed(self.r),
            self.s.product_hat(self.y) - self.g.product(self.s),
            self.g.product_transposed(self.s),
        ]
    }
}

impl TangentRule for HelicalTangent {
    type Pose<S: Simd> = HelicalPose<S>;
    const END_WEIGHT: f64 = 1.0;
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
        let log = logarithm(Quaternion { w, v });
        let y = r.apply_transposed(dx);
        let psi_hat = Mat3::hat(log.psi);
        let square = Mat3::outer(log.psi, log.psi) - Mat3::multiple(log.angle_squared);
        let identity = Mat3::multiple(Lanes::splat(dx.x.simd, 1.0));
        HelicalPose {
            r,
            log,
            y,
            s: identity - psi_hat * 0.5 + square * log.c,
            g: tangent_derivative(&log, y, -1.0),
        }
    }

    #[inline(always)]
    fn strain<S: Simd>(pose: &HelicalPose<S>) -> Stress<S> {
        Stress {
            linear: [pose.s.apply(pose.y); 2],
            angular: pose.log.psi,
        }
    }

    /// `δψ = Sᵀ η_b - S η_a`
    #[inline(always)]
    fn derivative<S: Simd>(pose: &HelicalPose<S>) -> Blocks<S> {
        let none = Mat3::zero(pose.y.x.simd);
        [
            pose.linear_derivative(),
            [none; 3],
            [none, -pose.s, pose.s.transpose()],
        ]
    }

    #[inline(always)]
    fn pull<S: Simd>(pose: &HelicalPose<S>, stress: &Stress<S>) -> [Vec3<S>; 3] {
        let HelicalPose { r, y, s, g, .. } = *pose;
        let n = stress.linear[0];
        let mu = stress.angular + g.apply_transposed(n);
        let w = s.apply_transposed(n);
        [r.apply(w), w.cross(y) - s.apply_transposed(mu), s.apply(mu)]
    }

    #[inline(always)]
    fn stiffness_under<S: Simd>(
        law: &Law<S>,
        pose: &HelicalPose<S>,
        stress: &Stress<S>,
    ) -> Blocks<S> {
        let HelicalPose { r, log, y, s, g } = *pose;
        let Law { c1, c2, .. } = *law;
        let n = stress.linear[0];
        let mu = stress.angular + g.apply_transposed(n);
        let w = s.apply_transposed(n);
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
    fn coupling<S: Simd>(law: &Law<S>, start: &HelicalPose<S>, end: &HelicalPose<S>) -> Blocks<S> {
        let simd = law.c1.x.simd;
        let (left, right) = (start.linear_derivative(), end.linear_derivative());
        let mut x = [[Mat3::zero(simd); 3]; 3];
        for (j, right) in right.into_iter().enumerate() {
            let stressed = right.scale_rows(law.c1);
            for (i, left) in left.into_iter().enumerate() {
                x[i][j] = left.transposed_product(stressed);
            }
        }
        // δψ = Sᵀ η_b - S η_a
        let left = [-start.s, start.s.transpose()];
        let right = [-end.s, end.s.transpose()];
        for (j, right) in right.into_iter().enumerate() {
            let stressed = right.scale_rows(law.c2);
            for (i, left) in left.into_iter().enumerate() {
                x[1 + i][1 + j] = x[1 + i][1 + j] + left.transposed_product(stressed);
            }
        }
        x
    }
}

/// What the trapezoidal rule needs of a pose.
#[derive(Clone, Copy)]
pub struct TrapezoidalPose<S: Simd> {
    rotations: [Mat3<S>; 2],
    v: [Vec3<S>; 2],
    psi: Vec3<S>,
    p: Mat3<S>,
}

impl TangentRule for TrapezoidalTangent {
    type Pose<S: Simd> = TrapezoidalPose<S>;
    const END_WEIGHT: f64 = 0.5;
    const PATTERN: [[bool; 3]; 3] = [
        [true, true, false],
        [true, false, true],
        [false, true, true],
    ];

    #[inline(always)]
    fn pose<S: Simd>(dx: Vec3<S>, a: Mat3<S>, b: Mat3<S>) -> TrapezoidalPose<S> {
        let simd = dx.x.simd;
        let relative = a.transposed_product(b);
        let psi = relative.vee() * (Lanes::splat(simd, 4.0) / (relative.trace() + 1.0));
        let identity = Mat3::multiple(Lanes::splat(simd, 1.0));
        TrapezoidalPose {
            rotations: [a, b],
            v: [a.apply_transposed(dx), b.apply_transposed(dx)],
            psi,
            p: identity + Mat3::hat(psi) * 0.5 + Mat3::outer(psi, psi) * 0.25,
        }
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
        law: &Law<S>,
        pose: &TrapezoidalPose<S>,
        stress: &Stress<S>,
    ) -> Blocks<S> {
        let simd = law.c1.x.simd;
        let Law { c1, c2, .. } = *law;
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
        law: &Law<S>,
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

/// Step of the central difference, in strain and in radians, as in [`curvature`](crate::mechanics::curvature).
const DIFFERENCE_STEP: f64 = 6e-6;

/// Where the stiffness is asked for to find the [element's curvature](crate::mechanics::curvature::element_curvature) along a
/// covector.
#[derive(Clone, Copy)]
pub struct Displacement<S: Simd> {
    pub covector: [Vec3<S>; 3],
    size: Lanes<S>,
    step: Lanes<S>,
}

impl<S: Simd> Displacement<S> {
    #[inline(always)]
    pub fn along(covector: [Vec3<S>; 3], length: f64) -> Self {
        let one = Lanes::splat(covector[0].x.simd, 1.0);
        let turns = covector[1].norm().max(covector[2].norm());
        let size = (covector[0].norm() * (1.0 / length)).max(turns);
        // Nothing that pulls is a difference of nothing.
        let size = size.select_below(f64::MIN_POSITIVE, one, size);
        Self {
            covector,
            size,
            step: one / size * DIFFERENCE_STEP,
        }
    }

    /// The pose moved by `sign` steps.
    #[inline(always)]
    pub fn moved(&self, dx: Vec3<S>, [a, b]: [Mat3<S>; 2], sign: f64) -> (Vec3<S>, [Mat3<S>; 2]) {
        let step = self.step * sign;
        let turned_a = a.product(small_turn(self.covector[1] * step));
        let turned_b = b.product(small_turn(self.covector[2] * step));
        (dx + self.covector[0] * step, [turned_a, turned_b])
    }

    /// The derivative along the covector, from what is ahead and behind.
    #[inline(always)]
    pub fn difference(&self, ahead: Mat3<S>, behind: Mat3<S>) -> Mat3<S> {
        (ahead - behind) * (self.size * (0.5 / DIFFERENCE_STEP))
    }

    /// The curvature, from the stiffness here, ahead and behind.
    #[inline(always)]
    pub fn curvature(&self, [here, ahead, behind]: &[Blocks<S>; 3]) -> Blocks<S> {
        let simd = self.size.simd;
        let mut k = [[Mat3::zero(simd); 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                let mut block = self.difference(ahead[i][j], behind[i][j]);
                if j > 0 {
                    block = block - here[i][j].product_hat(self.covector[j]);
                }
                if i > 0 {
                    block = block + Mat3::hat_product(self.covector[i], here[i][j]);
                }
                k[i][j] = block;
            }
        }
        for i in 0..3 {
            k[i][i] = k[i][i].symmetric();
            for j in 0..i {
                k[i][j] = (k[i][j] + k[j][i].transpose()) * 0.5;
                k[j][i] = k[i][j].transpose();
            }
        }
        k
    }
}

/// `exp(v̂)` for a vector of at most [`DIFFERENCE_STEP`]: `I + (1 - θ²/6) v̂ + v̂²/2`, off by `θ⁴/24`.
#[inline(always)]
fn small_turn<S: Simd>(v: Vec3<S>) -> Mat3<S> {
    let square = v.dot(v);
    let one = Lanes::splat(v.x.simd, 1.0);
    Mat3::multiple(one - square * 0.5)
        + Mat3::outer(v, v) * 0.5
        + Mat3::hat(v) * (one - square * (1.0 / 6.0))
}

/// Drift of a node, linearized, and whether it is regular there.
#[derive(Clone, Copy)]
pub struct Drift<S: Simd> {
    pub turn_transposed: Mat3<S>,
    pub theta: Mat3<S>,
    pub momentum: Mat3<S>,
    /// Angular momentum, body frame before the drift, and after it.
    pub leaving: Vec3<S>,
    pub arriving: Vec3<S>,
    /// `|f|²/4` of the Cayley vector, below 1 where the node turns by less than a quarter turn.
    pub level: Lanes<S>,
    /// `1 + tr F`, above 2 there.
    pub margin: Lanes<S>,
}

/// The turn of a node from one rotation to the next.
struct Turn<S: Simd> {
    turn: Mat3<S>,
    margin: Lanes<S>,
    f: Vec3<S>,
    /// `1/(1 + |f|²/4)`
    inverse_alpha: Lanes<S>,
    /// Angular momentum before it, and its derivative along `f`.
    g: Vec3<S>,
    slope: Mat3<S>,
}

impl<S: Simd> Turn<S> {
    #[inline(always)]
    fn of(rotary: &Vector3<f64>, h: f64, before: Mat3<S>, after: Mat3<S>) -> Self {
        let simd = before.rows[0].x.simd;
        let one = Lanes::splat(simd, 1.0);
        let turn = before.transposed_product(after);
        let margin = turn.trace() + 1.0;
        let f = turn.vee() * (Lanes::splat(simd, 4.0) / margin);
        let inverse_alpha = one / (f.dot(f) * 0.25 + 1.0);
        let j = Vec3::splat(simd, &(rotary / h));
        let jf = f.component_mul(j);
        let g = (jf + f.cross(jf) * 0.5) * inverse_alpha;
        let turned = Mat3::hat(f).product(Mat3::diagonal(j)) - Mat3::hat(jf);
        let slope = (Mat3::diagonal(j) + turned * 0.5) * inverse_alpha
            - Mat3::outer(g * (inverse_alpha * 0.5), f);
        Self {
            turn,
            margin,
            f,
            inverse_alpha,
            g,
            slope,
        }
    }
}

/// The spin of a node in a step that is solved for.
#[derive(Clone, Copy)]
pub struct Spin<S: Simd> {
    pub turn_transposed: Mat3<S>,
    /// `Θ⁻¹`: angular momentum before the drift per rotation, see [`spin_inertia`](crate::mechanics::implicit::spin_inertia).
    pub inertia: Mat3<S>,
    /// `M Θ⁻¹`: that after it.
    pub arriving: Mat3<S>,
    /// As in [`Drift`].
    pub level: Lanes<S>,
    pub margin: Lanes<S>,
}

/// The spin of a node of inertia `rotary` from one rotation to the next, a time step `h` later.
#[inline(always)]
pub fn spin<S: Simd>(rotary: &Vector3<f64>, h: f64, before: Mat3<S>, after: Mat3<S>) -> Spin<S> {
    let Turn {
        turn,
        margin,
        f,
        g,
        slope,
        ..
    } = Turn::of(rotary, h, before, after);
    let one = Mat3::multiple(Lanes::splat(margin.simd, 1.0));
    let inertia = slope.product(one + Mat3::hat(f) * 0.5 + Mat3::outer(f, f) * 0.25);
    let turn_transposed = turn.transpose();
    // M = Fᵀ + (Fᵀg)^ Θ
    let arriving = turn_transposed.product(inertia) + Mat3::hat(turn_transposed.apply(g));
    Spin {
        turn_transposed,
        inertia,
        arriving,
        level: f.dot(f) * 0.25,
        margin,
    }
}

/// The drift of a node of inertia `rotary` from one rotation to the next, a time step `h` later.
#[inline(always)]
pub fn drift<S: Simd>(rotary: &Vector3<f64>, h: f64, before: Mat3<S>, after: Mat3<S>) -> Drift<S> {
    let one = Lanes::splat(before.rows[0].x.simd, 1.0);
    let Turn {
        turn,
        margin,
        f,
        inverse_alpha,
        g,
        slope,
    } = Turn::of(rotary, h, before, after);
    let tangent = (Mat3::multiple(one) - Mat3::hat(f) * 0.5) * inverse_alpha;
    let theta = tangent.product(slope.inverse());
    let turn_transposed = turn.transpose();
    let arriving = turn_transposed.apply(g);
    Drift {
        turn_transposed,
        theta,
        momentum: turn_transposed + Mat3::hat_product(arriving, theta),
        leaving: g,
        arriving,
        level: f.dot(f) * 0.25,
        margin,
    }
}
