//! Second derivatives of the discrete equations of motion, contracted with their multipliers.
//!
//! With the rows `r_k` and the multipliers `λ_k` of [`linearization`](super::linearization), a functional `φ` of the states at the
//! time nodes has the Lagrangian `L = φ - Σ_{k<N} λ_k·r_k`, stationary in the configurations by the choice of `λ`. Its second
//! derivative along directions that obey the linearized motion is that of the functional as a function of the control; without the
//! curvature of `φ` in the states it is, with `λ_N = ∂φ/∂(p_N, π_N)` and the covector `μr_k` of the angular momenta that arrive
//! at `k` (`decay_k λr_k`, and `∂φ/∂π_k` for `k < N`),
//!
//! ```text
//! Σ_{k=0..N} weight_k Σ_q [λx_kq·δ²f_q + λr_kq·δ²τ_q] + Σ_{k<N} Σ_q [μr_{k+1,q}·δ²π_q(F_k) - λr_kq·δ²g_q(F_k)]
//! ```
//!
//! A stress of the [interval](cosserat::implicit) adds `Σ_{k<N} δ²(w_k·B_kᵀσ + v_{k+1}·B_{k+1}ᵀσ)` with `w_k = -(h/2) impulse_k λ_k`
//! and `v_k` the same of `μ_k`, which couples whole elements at both ends of the interval ([`StressCurvature`]). The curvature
//! of `φ` in the configurations is [given](OwnCurvature).
//!
//! All second derivatives are those in the chart `x + δx`, `R exp(ζ̂)`, hence symmetric. They are not those of
//! another chart, nor the derivative of the left-trivialized derivative; their sum over all rows is the same in each,
//! because `L` is stationary.
//!
//! Where the inertia follows the dilatation, its second derivatives along the dilatation are left out: the form is then an
//! approximation, as good as the rotary inertia is small. Gradients are exact.

use faer::Mat;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use pulp::Scalar;

use super::curved::{CurvedEnd, StressBlocks, stress_curvature as stress_blocks};
use super::linearization::{AdjointSweep, Motion};
use super::tangent;
use cosserat::configuration::Trajectory;
use cosserat::element::rule::DIFFERENCE_STEP;
use cosserat::element::{
    AnyTurn, Displacement, Elasticity, Element, ElementPose, ElementStiffness, Helical, StrainRule,
    TangentRule, Trapezoidal, blocks_of, nine_by_nine,
};
use cosserat::implicit::IntervalWeights;
use cosserat::load::LoadFrame;
use cosserat::rod::Rod;
use cosserat::rotation::exp;
pub use cosserat::rotation::load_curvature;
use cosserat::vector::{Mat3, Vec3};

/// Second derivative along `(δx_b - δx_a, ζ_a, ζ_b)` of an element; symmetric.
pub type ElementCurvature = SMatrix<f64, 9, 9>;

/// Second derivative along the rotations `(ζ_k, ζ_{k+1})` of one node at the two ends of an interval; symmetric.
pub type InertiaCurvature = SMatrix<f64, 6, 6>;

/// Multipliers of the equations of motion, as [`adjoint`](super::adjoint) takes and
/// returns them for the same motion and trajectory; unit: that of the functional per unit of momentum.
#[derive(Clone, Copy, Debug)]
pub struct MotionMultipliers<'a> {
    /// Covectors `λ_k` of the rows and, as `λ_N`, of the terminal momenta.
    pub adjoint: &'a AdjointSweep,
    /// Second derivatives of costs and constraints themselves, in ascending order of time.
    pub own: &'a [OwnCurvature],
}

/// Second derivative of costs and constraints themselves, in the configuration of one time node, or of two that follow each other, and in
/// the same chart as that of the equations of motion, multipliers multiplied in.
#[derive(Clone, Debug)]
pub struct OwnCurvature {
    /// Time node `k`.
    pub time_node: usize,
    /// The rod node and the component of every row: 0..3 `δx` (spatial), 3..6 `ζ` (body).
    pub rows: Vec<(usize, usize)>,
    /// Linear forms of the rows, a coefficient for each of them; empty if every row is a form by itself.
    pub forms: Vec<Vec<f64>>,
    /// For each form the coefficients of the same rows at the time node before, which it has in addition; empty if it has none.
    pub earlier: Vec<Vec<f64>>,
    /// Symmetric, as many rows and columns as there are forms; unit of the functional per unit of both.
    pub matrix: Mat<f64>,
}

/// Returns those of the time nodes in `range`.
pub(super) fn own_within(own: &[OwnCurvature], range: std::ops::Range<usize>) -> &[OwnCurvature] {
    let before = |limit| own.partition_point(|own| own.time_node < limit);
    &own[before(range.start)..before(range.end)]
}

impl MotionMultipliers<'_> {
    /// `(λx, λr)` of rod node `q` at time node `k`; zero where the node is held.
    pub(super) fn at(&self, motion: &Motion, k: usize, q: usize) -> (Vector3<f64>, Vector3<f64>) {
        let row = k * motion.rod.n_nodes() + q;
        (self.adjoint.linear[row], self.adjoint.angular[row])
    }

    /// Returns the covectors of rod node `q` for the momenta that arrive at time node `k`; zero where the node is held.
    pub(super) fn arriving(
        &self,
        motion: &Motion,
        k: usize,
        q: usize,
    ) -> (Vector3<f64>, Vector3<f64>) {
        let row = k * motion.rod.n_nodes() + q;
        let adjoint = self.adjoint;
        (adjoint.arriving_linear[row], adjoint.arriving_angular[row])
    }
}

/// A load's second derivative along the rotation of its node.
#[derive(Clone, Copy, Debug)]
pub struct NodeCurvature {
    /// The node.
    pub node: usize,
    /// Symmetric, J.
    pub rotation: Matrix3<f64>,
}

/// The terms that belong to the interval from one time node to the next; empty after the last.
#[derive(Clone, Debug, Default)]
pub struct IntervalCurvature {
    /// `μr_{k+1}·δ²π - λr_k·δ²g` of every node.
    pub inertia: Vec<InertiaCurvature>,
    /// Curvatures of the stress, element by element; empty if no stress depends on both ends.
    pub stress: Vec<StressCurvature>,
}

/// Second derivative of `w_start·B_startᵀσ + w_end·B_endᵀσ` along `(δx_b - δx_a, ζ_a, ζ_b)` of an element at both ends of an
/// interval, for constant components `w` and the stress `σ` that the strains at both ends make.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StressCurvature {
    /// Both directions at the start of the interval; symmetric.
    pub start: ElementCurvature,
    /// Rows at the start of the interval, columns at its end.
    pub cross: ElementStiffness,
    /// Both directions at the end of the interval; symmetric.
    pub end: ElementCurvature,
}

/// The terms of the loads at time node `k`.
#[must_use]
pub fn load_curvatures(
    motion: &Motion,
    trajectory: &Trajectory,
    multipliers: &MotionMultipliers,
    k: usize,
) -> Vec<NodeCurvature> {
    let weight = motion.kick(k).weight;
    (motion.rod.loads.iter().filter(|load| load.turns()))
        .map(|load| {
            let rotation = &trajectory.rotations_at(k)[load.node];
            let (linear, angular) = multipliers.at(motion, k, load.node);
            let (linear, angular) = (weight * linear, weight * angular);
            let wrench = load.wrench_at_node(&motion.grid.node(k), rotation);
            let rotation = match load.frame {
                LoadFrame::Spatial => load_curvature(&angular, &wrench.moment),
                LoadFrame::Body => {
                    load_curvature(&rotation.tr_mul(&linear), &rotation.tr_mul(&wrench.force))
                }
            };
            NodeCurvature {
                node: load.node,
                rotation,
            }
        })
        .collect()
}

/// The terms of [resistance](cosserat::resistance), in ascending order of time: of every interval from `k` to `k + 1` and every node
/// `h/2 (impulse_k λ_k·δ²f(v, R_k) + μ_{k+1}·δ²f(v, R_{k+1})/(1 - a))` along `(δv, ζ_k, ζ_{k+1})`, `v = (x_{k+1} - x_k)/h`.
#[must_use]
pub fn resistance_curvatures(
    motion: &Motion,
    trajectory: &Trajectory,
    adjoint: &AdjointSweep,
) -> Vec<OwnCurvature> {
    let (rod, h) = (motion.rod, motion.grid.step);
    let mut out = Vec::new();
    if rod.resistances.is_empty() {
        return out;
    }
    let multipliers = MotionMultipliers { adjoint, own: &[] };
    let unit = |at: usize, size: f64| {
        let mut form = vec![0.0; 6];
        form[at] = size;
        form
    };
    let zero = || vec![0.0; 6];
    for k in 0..motion.grid.n_steps {
        for node in rod.first_free_node()..rod.n_nodes() {
            let Some(resistance) = rod.resistance(node) else {
                continue;
            };
            let moved = trajectory.positions_at(k + 1)[node] - trajectory.positions_at(k)[node];
            let mut matrix = Mat::zeros(9, 9);
            for (end, covector, factor) in [
                (0, multipliers.at(motion, k, node).0, motion.kick(k).impulse),
                (
                    1,
                    multipliers.arriving(motion, k + 1, node).0,
                    motion.arriving_impulse(),
                ),
            ] {
                let rotation = &trajectory.rotations_at(k + end)[node];
                let covector = covector * (0.5 * h * factor);
                let own = resistance.curvature(&covector, &(moved / h), rotation);
                let place = |i: usize| if i < 3 { i } else { i + 3 * end };
                for i in 0..6 {
                    for j in 0..6 {
                        matrix[(place(i), place(j))] += own[(i, j)];
                    }
                }
            }
            let forms = [0, 1, 2].map(|i| unit(i, 1.0 / h)).into_iter();
            let earlier = [0, 1, 2].map(|i| unit(i, -1.0 / h)).into_iter();
            out.push(OwnCurvature {
                time_node: k + 1,
                rows: (0..6).map(|component| (node, component)).collect(),
                forms: forms
                    .chain([zero(), zero(), zero()])
                    .chain((3..6).map(|i| unit(i, 1.0)))
                    .collect(),
                earlier: earlier
                    .chain((3..6).map(|i| unit(i, 1.0)))
                    .chain([zero(), zero(), zero()])
                    .collect(),
                matrix,
            });
        }
    }
    out
}

/// Second derivative of `λ·∇U` in the chart `(dx + δx, R_a exp(ζ̂_a), R_b exp(ζ̂_b))`, where `∇U` is the element's
/// [gradient](Element::gradient) and `λ = covector` its constant components `(dx; body a; body b)`.
///
/// With the left-invariant fields `E_a` and `[a, b] = a × b` of each rotation, `E_aE_bE_λU = E_λ(E_aE_bU) +
/// E_[a,λ]E_bU + E_aE_[b,λ]U`; `E_aE_bU = b·Ka` is the [stiffness](Element::stiffness), given at the same pose, and
/// its derivative along `λ` is a central difference, exact to about 1e-10 of `|K|` (unit of `K` times that of `λ`).
/// Where the stress has no potential, the nine derivatives of `Kᵀλ` are differenced instead.
#[must_use]
pub fn element_curvature(
    element: &Element,
    rule: StrainRule,
    pose: &ElementPose,
    stiffness: &ElementStiffness,
    covector: &SVector<f64, 9>,
) -> ElementCurvature {
    if element.model.has_potential() {
        return conservative_curvature(element.length, pose, stiffness, covector, |pose| {
            element.stiffness(rule, pose).1
        });
    }
    let stiffness_at = |dx: Vector3<f64>, turn_a: &Matrix3<f64>, turn_b: &Matrix3<f64>| {
        let pose = ElementPose {
            dx,
            rotation_a: &(pose.rotation_a * turn_a),
            rotation_b: &(pose.rotation_b * turn_b),
        };
        element.stiffness(rule, &pose).1
    };
    let (still, identity) = (pose.dx, Matrix3::identity());
    let columns: [SVector<f64, 9>; 9] = std::array::from_fn(|j| {
        let (part, axis) = (j / 3, j % 3);
        let size = DIFFERENCE_STEP * if part == 0 { element.length } else { 1.0 };
        let moved = |size: f64| {
            let unit = Vector3::ith(axis, size);
            match part {
                0 => stiffness_at(still + unit, &identity, &identity),
                1 => stiffness_at(still, &exp(&unit), &identity),
                _ => stiffness_at(still, &identity, &exp(&unit)),
            }
        };
        (moved(size) - moved(-size)).tr_mul(covector) * (0.5 / size)
    });
    let curvature = ElementCurvature::from_columns(&columns);
    0.5 * (curvature + curvature.transpose())
}

/// Second derivative of `λ·∇(-Σ u y)` of the actuators in element `q` with the given efforts, as [`element_curvature`] has that of the
/// elastic energy; `stiffness` is [`Rod::active_stiffness`] at the same pose.
#[must_use]
pub fn active_curvature(
    rod: &Rod,
    q: usize,
    pose: &ElementPose,
    stiffness: &ElementStiffness,
    efforts: &[f64],
    covector: &SVector<f64, 9>,
) -> ElementCurvature {
    conservative_curvature(rod.elements[q].length, pose, stiffness, covector, |pose| {
        let stiffness = rod.active_stiffness(q, pose, efforts);
        stiffness.unwrap_or_else(ElementStiffness::zeros)
    })
}

/// The curvature of a potential, from its stiffness at the pose and at poses that are moved along the covector.
fn conservative_curvature(
    length: f64,
    pose: &ElementPose,
    stiffness: &ElementStiffness,
    covector: &SVector<f64, 9>,
    stiffness_at: impl Fn(&ElementPose) -> ElementStiffness,
) -> ElementCurvature {
    let vectors = [0, 3, 6].map(|at| covector.fixed_rows::<3>(at).into_owned());
    let displacement =
        Displacement::along(vectors.each_ref().map(|v| Vec3::splat(Scalar, v)), length);
    let moved = |sign: f64| {
        let turns = [pose.rotation_a, pose.rotation_b].map(Mat3::of_matrix);
        let (dx, turns) = displacement.moved(Vec3::splat(Scalar, &pose.dx), turns, sign);
        let [a, b] = turns.map(Mat3::matrix);
        blocks_of(&stiffness_at(&ElementPose {
            dx: dx.vector(),
            rotation_a: &a,
            rotation_b: &b,
        }))
    };
    let found = [blocks_of(stiffness), moved(1.0), moved(-1.0)];
    nine_by_nine(&displacement.curvature(&found))
}

/// The [`StressCurvature`] of an element, from its pose and the components `w` at both ends of the interval.
#[must_use]
pub fn stress_curvature(
    element: &Element,
    rule: StrainRule,
    weights: IntervalWeights,
    ends: &[(ElementPose, SVector<f64, 9>); 2],
) -> StressCurvature {
    match rule {
        StrainRule::Helical => stress_curvature_by::<Helical>(element, weights, ends),
        StrainRule::Trapezoidal => stress_curvature_by::<Trapezoidal>(element, weights, ends),
    }
}

fn stress_curvature_by<R: TangentRule>(
    element: &Element,
    weights: IntervalWeights,
    ends: &[(ElementPose, SVector<f64, 9>); 2],
) -> StressCurvature {
    let ends = ends.each_ref().map(|(pose, covector)| {
        let part = |at: usize| Vec3::splat(Scalar, &covector.fixed_rows::<3>(at).into_owned());
        CurvedEnd {
            dx: Vec3::splat(Scalar, &pose.dx),
            rotations: [pose.rotation_a, pose.rotation_b].map(Mat3::of_matrix),
            covector: [part(0), part(3), part(6)],
        }
    });
    let law = Elasticity::of::<R>(Scalar, element);
    let StressBlocks { start, cross, end } =
        stress_blocks::<Scalar, R, AnyTurn>(&law, element.length, weights, &ends);
    let [start, cross, end] = [start, cross, end].map(|blocks| nine_by_nine(&blocks));
    StressCurvature { start, cross, end }
}

/// Second derivative of the momenta of a node over an interval, see `tangent::inertia_curvature`.
#[must_use]
pub fn inertia_curvature(
    rotary: [&Vector3<f64>; 2],
    time_step: f64,
    turn: &Matrix3<f64>,
    before: &Vector3<f64>,
    after: &Vector3<f64>,
) -> InertiaCurvature {
    let [before, after] = [before, after].map(|v| Vec3::splat(Scalar, v));
    let turn = Mat3::of_matrix(turn);
    let [own, mixed, far] =
        tangent::inertia_curvature(rotary, time_step, turn, before, after).map(Mat3::matrix);
    let mut curvature = InertiaCurvature::zeros();
    for (row, column, block) in [
        (0, 0, own),
        (0, 3, mixed),
        (3, 0, mixed.transpose()),
        (3, 3, far),
    ] {
        let mut part = curvature.fixed_view_mut::<3, 3>(row, column);
        part.copy_from(&block);
    }
    curvature
}
