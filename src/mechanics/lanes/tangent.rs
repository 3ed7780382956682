//! The linearization of rods with explicit steps of the standard model, several time nodes at a time.
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

/// A strain rule, as far as its stiffness is concerned.
pub trait TangentRule {
    /// The [gradient](crate::mechanics::strain::Element::gradient) `(F, M_a, M_b)` of an element between two poses.
    fn gradient<S: Simd>(element: &Element, dx: Vec3<S>, a: Mat3<S>, b: Mat3<S>) -> [Vec3<S>; 3];

    /// The stiffness of an element between two poses.
    fn stiffness<S: Simd>(element: &Element, dx: Vec3<S>, a: Mat3<S>, b: Mat3<S>) -> Blocks<S>;
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

/// The quantities of an element that the helical rule needs.
struct HelicalTerms<S: Simd> {
    c1: Vec3<S>,
    c2: Vec3<S>,
    log: Logarithm<S>,
    y: Vec3<S>,
    s: Mat3<S>,
    g: Mat3<S>,
    n: Vec3<S>,
    mu: Vec3<S>,
    w: Vec3<S>,
}

impl<S: Simd> HelicalTerms<S> {
    #[inline(always)]
    fn at(element: &Element, dx: Vec3<S>, r: Mat3<S>, r_b: Mat3<S>) -> Self {
        let simd = dx.x.simd;
        let l = element.length;
        let c1 = Vec3::splat(simd, &(element.linear_stiffness / l));
        let c2 = Vec3::splat(simd, &(element.angular_stiffness / l));
        let relative = r.transposed_product(r_b);
        let w = ((relative.trace() + 1.0).sqrt()) * 0.5;
        let v = relative.vee() * (Lanes::splat(simd, 0.5) / w);
        let log = logarithm(Quaternion { w, v });
        let y = r.apply_transposed(dx);
        let psi_hat = Mat3::hat(log.psi);
        // S = I - ψ̂/2 + c ψ̂²
        let square = Mat3::outer(log.psi, log.psi) - Mat3::multiple(log.angle_squared);
        let identity = Mat3::multiple(Lanes::splat(simd, 1.0));
        let s = identity - psi_hat * 0.5 + square * log.c;
        let rest = Vec3::splat(simd, &(element.rest.linear[0] * l));
        let rest_psi = Vec3::splat(simd, &(element.rest.curvature * l));
        let n = (s.apply(y) - rest).component_mul(c1);
        let m = (log.psi - rest_psi).component_mul(c2);
        let g = tangent_derivative(&log, y, -1.0);
        Self {
            c1,
            c2,
            log,
            y,
            s,
            g,
            n,
            mu: m + g.apply_transposed(n),
            w: s.apply_transposed(n),
        }
    }
}

impl TangentRule for HelicalTangent {
    #[inline(always)]
    fn gradient<S: Simd>(element: &Element, dx: Vec3<S>, a: Mat3<S>, b: Mat3<S>) -> [Vec3<S>; 3] {
        let HelicalTerms { y, s, mu, w, .. } = HelicalTerms::at(element, dx, a, b);
        [a.apply(w), w.cross(y) - s.apply_transposed(mu), s.apply(mu)]
    }

    #[inline(always)]
    fn stiffness<S: Simd>(element: &Element, dx: Vec3<S>, r: Mat3<S>, r_b: Mat3<S>) -> Blocks<S> {
        let HelicalTerms {
            c1,
            c2,
            log,
            y,
            s,
            g,
            n,
            mu,
            w,
        } = HelicalTerms::at(element, dx, r, r_b);
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
}

/// What the trapezoidal rule needs of an element; the stiffness is halved and over the length, for strains times the length.
struct TrapezoidalTerms<S: Simd> {
    c1: Vec3<S>,
    c2: Vec3<S>,
    v: [Vec3<S>; 2],
    n: [Vec3<S>; 2],
    psi: Vec3<S>,
    y: Vec3<S>,
    p: Mat3<S>,
}

impl<S: Simd> TrapezoidalTerms<S> {
    #[inline(always)]
    fn at(element: &Element, dx: Vec3<S>, a: Mat3<S>, b: Mat3<S>) -> Self {
        let simd = dx.x.simd;
        let l = element.length;
        let c1 = Vec3::splat(simd, &(element.linear_stiffness * (0.5 / l)));
        let c2 = Vec3::splat(simd, &(element.angular_stiffness / l));
        let relative = a.transposed_product(b);
        let psi = relative.vee() * (Lanes::splat(simd, 4.0) / (relative.trace() + 1.0));
        let v = [a.apply_transposed(dx), b.apply_transposed(dx)];
        let mut n = v;
        for end in 0..2 {
            let rest = Vec3::splat(simd, &(element.rest.linear[end] * l));
            n[end] = (v[end] - rest).component_mul(c1);
        }
        let identity = Mat3::multiple(Lanes::splat(simd, 1.0));
        Self {
            c1,
            c2,
            v,
            n,
            psi,
            y: (psi - Vec3::splat(simd, &(element.rest.curvature * l))).component_mul(c2),
            p: identity + Mat3::hat(psi) * 0.5 + Mat3::outer(psi, psi) * 0.25,
        }
    }
}

impl TangentRule for TrapezoidalTangent {
    #[inline(always)]
    fn gradient<S: Simd>(element: &Element, dx: Vec3<S>, a: Mat3<S>, b: Mat3<S>) -> [Vec3<S>; 3] {
        let TrapezoidalTerms { v, n, y, p, .. } = TrapezoidalTerms::at(element, dx, a, b);
        [
            a.apply(n[0]) + b.apply(n[1]),
            n[0].cross(v[0]) - p.apply(y),
            n[1].cross(v[1]) + p.apply_transposed(y),
        ]
    }

    #[inline(always)]
    fn stiffness<S: Simd>(element: &Element, dx: Vec3<S>, a: Mat3<S>, b: Mat3<S>) -> Blocks<S> {
        let simd = dx.x.simd;
        let TrapezoidalTerms {
            c1,
            c2,
            v,
            n,
            psi,
            y,
            p,
        } = TrapezoidalTerms::at(element, dx, a, b);
        let mut k = [[Mat3::zero(simd); 3]; 3];
        for end in 0..2 {
            let r = if end == 0 { a } else { b };
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
}

/// Step of the central difference, in strain and in radians, as in [`curvature`](crate::mechanics::curvature).
const DIFFERENCE_STEP: f64 = 6e-6;

/// Where the stiffness is asked for to find the [element's curvature](crate::mechanics::curvature::element_curvature) along a
/// covector.
#[derive(Clone, Copy)]
pub struct Displacement<S: Simd> {
    covector: [Vec3<S>; 3],
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

    /// The curvature, from the stiffness here, ahead and behind.
    #[inline(always)]
    pub fn curvature(&self, [here, ahead, behind]: &[Blocks<S>; 3]) -> Blocks<S> {
        let simd = self.size.simd;
        let scale = self.size * (0.5 / DIFFERENCE_STEP);
        let mut k = [[Mat3::zero(simd); 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                let mut block = (ahead[i][j] - behind[i][j]) * scale;
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

/// The drift of a node of inertia `rotary` from one rotation to the next, a time step `h` later.
#[inline(always)]
pub fn drift<S: Simd>(rotary: &Vector3<f64>, h: f64, before: Mat3<S>, after: Mat3<S>) -> Drift<S> {
    let simd = before.rows[0].x.simd;
    let one = Lanes::splat(simd, 1.0);
    let turn = before.transposed_product(after);
    let margin = turn.trace() + 1.0;
    let f = turn.vee() * (Lanes::splat(simd, 4.0) / margin);
    let inverse_alpha = one / (f.dot(f) * 0.25 + 1.0);
    let j = Vec3::splat(simd, &(rotary / h));
    let jf = f.component_mul(j);
    let g = (jf + f.cross(jf) * 0.5) * inverse_alpha;
    // ∂g/∂f
    let turned = Mat3::hat(f).product(Mat3::diagonal(j)) - Mat3::hat(jf);
    let slope = (Mat3::diagonal(j) + turned * 0.5) * inverse_alpha
        - Mat3::outer(g * (inverse_alpha * 0.5), f);
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
