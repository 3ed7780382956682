//! The linearized drift of nodes, several time nodes at a time; [`element`](cosserat::element) has that of elements.
//!
//! With the Cayley vector `f` of a node's turn `F` over the step, `α = 1 + |f|²/4`, `g` the angular momentum of the interval (body frame
//! before the step, kg m²/s) and `G_f = ∂g/∂f`, a drift takes the rotation `ζ` (body frame) and `δg` after the kick to
//!
//! ```text
//! ζ⁺ = Fᵀ ζ + Θ δg,    δ(Fᵀ g) = M δg,    Θ = (1/α)(I - f̂/2) G_f⁻¹,    M = Fᵀ + (Fᵀg)^ Θ
//! ```

use nalgebra::{Matrix3, Vector3};
use pulp::Simd;

use cosserat::rotation_step::{inverse_alpha, momentum, momentum_slope, spin_inertia};
use cosserat::vector::{Lanes, Mat3, Row, Vec3};

/// Number of rows of a pose: position, rotation matrix row by row.
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
pub(crate) struct NodePose<S: Simd> {
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

/// Smallest `4 cos²` of half the angle between the ends of an element, `1 + tr`, for which its relative rotation is decomposed without loss
/// of digits: up to 2.2 rad.
pub const LEAST_MARGIN: f64 = 0.75;

/// Returns the second derivative of `μ·π(F) - λ·g(F)` in the chart `F = exp(-ζ̂_k) F exp(ζ̂_{k+1})`, for the momenta `g = (1/h) (F J_d -
/// J_d Fᵀ)^∨` (body frame before the step) and `π = Fᵀ g` (after it), kg m²/s: before, mixed (rows before), after.
///
/// The function is `tr(CF)` with `C = (J_d λ̂ - μ̂ J_d)/h`, linear in `F`; `tr(M ζ̂²) = ζ·(M - tr M)ζ`, and the mixed term is the mixed
/// cofactor of `Cᵀ` and `F`. `rotary` is the node's `J` (kg m²) for `g` and for `π`, `J_d = (tr J/2) I - J`.
#[inline(always)]
pub fn inertia_curvature<S: Simd>(
    rotary: [&Vector3<f64>; 2],
    h: f64,
    turn: Mat3<S>,
    before: Vec3<S>,
    after: Vec3<S>,
) -> [Mat3<S>; 3] {
    let simd = before.x.simd;
    let rate = |rotary: &Vector3<f64>| rotary.map(|j| (0.5 * rotary.sum() - j) / h);
    let leaving = Mat3::diagonal(Vec3::splat(simd, &rate(rotary[0])));
    let arriving = Mat3::diagonal(Vec3::splat(simd, &rate(rotary[1])));
    let c = leaving.product_hat(before) - Mat3::hat_product(after, arriving);
    // The mixed cofactor of Cᵀ and F combines rows of both, in both orders.
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

/// The linearized drift of a node, and its regularity.
#[derive(Clone, Copy)]
pub struct Drift<S: Simd> {
    /// `Fᵀ`
    pub turn_transposed: Mat3<S>,
    /// `Θ`, rotation per angular momentum, s/(kg m²).
    pub theta: Mat3<S>,
    /// `M`
    pub momentum: Mat3<S>,
    /// Angular momentum, body frame before the drift, and after it.
    pub leaving: Vec3<S>,
    pub arriving: Vec3<S>,
    /// `|f|²/4` of the Cayley vector, below 1 where the node turns by less than a quarter turn.
    pub level: Lanes<S>,
    /// `1 + tr F`, above 2 under the same condition.
    pub margin: Lanes<S>,
}

/// The turn of a node from one rotation to the next.
struct Turn<S: Simd> {
    turn: Mat3<S>,
    margin: Lanes<S>,
    f: Vec3<S>,
    /// `1/(1 + |f|²/4)`
    inverse_alpha: Lanes<S>,
    /// Angular momentum before the turn, and its derivative along `f`.
    g: Vec3<S>,
    slope: Mat3<S>,
}

impl<S: Simd> Turn<S> {
    #[inline(always)]
    fn of(rotary: &Vector3<f64>, h: f64, before: Mat3<S>, after: Mat3<S>) -> Self {
        let simd = before.rows[0].x.simd;
        let turn = before.transposed_product(after);
        let margin = turn.trace() + 1.0;
        let f = turn.vee() * (Lanes::splat(simd, 4.0) / margin);
        let inverse_alpha = inverse_alpha(f);
        let rate = Vec3::splat(simd, &(rotary / h));
        let g = momentum(rate, f, inverse_alpha, 1.0);
        let slope = momentum_slope(rate, f, inverse_alpha, g, 1.0);
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
    /// `Θ⁻¹`: derivative of the angular momentum before the drift along the rotation, see [`spin_inertia`].
    pub inertia: Mat3<S>,
    /// `M Θ⁻¹`: derivative of the angular momentum after the drift.
    pub arriving: Mat3<S>,
    /// Level of the rotation, as in [`Drift::level`].
    pub level: Lanes<S>,
    pub margin: Lanes<S>,
}

/// Computes the spin of a node of inertia `rotary` from one rotation to the next, a time step `h` later.
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
    let inertia = spin_inertia(slope, f);
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

/// Computes the drift of a node of inertia `rotary` from one rotation to the next, a time step `h` later.
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

/// The [`drift`] of a node whose inertia is another one, `arriving`, when the step ends: there, angular momentum is
/// `π = (J f - ½ f × J f)/(α h)` with that inertia, and `M = ∂π/∂f G_f⁻¹`.
pub fn drift_to<S: Simd>(
    arriving: &Vector3<f64>,
    leaving: &Vector3<f64>,
    h: f64,
    before: Mat3<S>,
    after: Mat3<S>,
) -> Drift<S> {
    let Turn {
        f,
        inverse_alpha,
        slope,
        ..
    } = Turn::of(leaving, h, before, after);
    let rate = Vec3::splat(inverse_alpha.simd, &(arriving / h));
    let arriving = momentum(rate, f, inverse_alpha, -1.0);
    let along = momentum_slope(rate, f, inverse_alpha, arriving, -1.0);
    Drift {
        momentum: along.product(slope.inverse()),
        arriving,
        ..drift(leaving, h, before, after)
    }
}
