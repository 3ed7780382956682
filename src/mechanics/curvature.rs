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
//! A stress of the [interval](super::implicit) adds `Σ_{k<N} δ²(w_k·B_kᵀσ + v_{k+1}·B_{k+1}ᵀσ)` with `w_k = -(h/2) impulse_k λ_k`
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

use super::configuration::{Trajectory, TrajectoryTangent};
use super::element::rule::DIFFERENCE_STEP;
use super::element::{
    Displacement, Element, ElementPose, ElementStiffness, Helical, Law, StrainRule, TangentRule,
    Trapezoidal, blocks_of, nine_by_nine, pose_of_any_turn,
};
use super::implicit::IntervalWeights;
use super::lanes;
use super::lanes::curved::{CurvedEnd, StressBlocks};
use super::lanes::vector::{Mat3, Vec3};
use super::linearization::{AdjointSweep, Motion, StepLinearization};
use super::load::LoadFrame;
use super::rod::Rod;
use super::rotation::exp;
use super::step_error::StepError;

/// Second derivative along `(δx_b - δx_a, ζ_a, ζ_b)` of an element; symmetric.
pub type ElementCurvature = SMatrix<f64, 9, 9>;

/// Second derivative along the rotations `(ζ_k, ζ_{k+1})` of one node at the two ends of an interval; symmetric.
pub type InertiaCurvature = SMatrix<f64, 6, 6>;

/// Multipliers of the equations of motion, as [`adjoint_sweep`](super::linearization::adjoint_sweep) takes and
/// returns them for the same motion and trajectory; unit: that of the functional per unit of momentum.
#[derive(Clone, Copy, Debug)]
pub struct Multipliers<'a> {
    /// Covectors `λ_k` of the rows and, as `λ_N`, of the terminal momenta.
    pub adjoint: &'a AdjointSweep,
    /// What costs and constraints bend by themselves, in ascending order of time.
    pub own: &'a [OwnCurvature],
}

/// Second derivative of costs and constraints themselves, in the configuration of one time node and in the same chart as that
/// of the equations of motion, multipliers multiplied in.
#[derive(Clone, Debug)]
pub struct OwnCurvature {
    /// Time node `k`.
    pub time_node: usize,
    /// The rod node and the component of every row: 0..3 `δx` (spatial), 3..6 `ζ` (body).
    pub rows: Vec<(usize, usize)>,
    /// Symmetric, as many rows and columns as `rows`; unit of the functional per unit of both components.
    pub matrix: Mat<f64>,
}

/// Those of the time nodes in `range`.
pub(super) fn own_within(own: &[OwnCurvature], range: std::ops::Range<usize>) -> &[OwnCurvature] {
    let before = |limit| own.partition_point(|own| own.time_node < limit);
    &own[before(range.start)..before(range.end)]
}

impl Multipliers<'_> {
    /// `(λx, λr)` of rod node `q` at time node `k`; zero where the node is held.
    pub(super) fn at(&self, motion: &Motion, k: usize, q: usize) -> (Vector3<f64>, Vector3<f64>) {
        let row = k * motion.rod.n_nodes() + q;
        (self.adjoint.linear[row], self.adjoint.angular[row])
    }

    /// The same for the momenta that arrive.
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

/// The terms of the second derivative that belong to time node `k` and to the interval that follows it.
#[derive(Clone, Debug)]
pub struct StepCurvature {
    /// `weight λ·δ²` of the elastic forces at `k`, element by element; none under
    /// [`TimeScheme::Implicit`](super::TimeScheme::Implicit).
    pub elements: Vec<ElementCurvature>,
    /// The same of the loads.
    pub loads: Vec<NodeCurvature>,
    /// The interval that follows.
    pub interval: IntervalCurvature,
}

/// The terms that belong to the interval from one time node to the next; empty after the last.
#[derive(Clone, Debug, Default)]
pub struct IntervalCurvature {
    /// `μr_{k+1}·δ²π - λr_k·δ²g` of every node.
    pub inertia: Vec<InertiaCurvature>,
    /// Those of the stress, element by element; empty where none depends on both ends.
    pub stress: Vec<StressCurvature>,
}

/// Second derivative of `w_start·B_startᵀσ + w_end·B_endᵀσ` along `(δx_b - δx_a, ζ_a, ζ_b)` of an element at both ends of an
/// interval, for constant components `w` and the stress `σ` that the strains at both ends make.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StressCurvature {
    /// Both directions where the interval starts; symmetric.
    pub start: ElementCurvature,
    /// Rows where it starts, columns where it ends.
    pub cross: ElementStiffness,
    /// Both where it ends; symmetric.
    pub end: ElementCurvature,
}

impl StepCurvature {
    /// The terms of time node `k` (`0..=N`); `linearization` is that of the same time node.
    #[must_use]
    pub fn at(
        motion: &Motion,
        trajectory: &Trajectory,
        linearization: &StepLinearization,
        multipliers: &Multipliers,
        k: usize,
    ) -> Self {
        let rod = motion.rod;
        let weight = linearization.kick.weight;
        let positions = trajectory.positions_at(k);
        let rotations = trajectory.rotations_at(k);
        let weighted = |q| {
            let (linear, angular) = multipliers.at(motion, k, q);
            (weight * linear, weight * angular)
        };
        let elements = (rod.elements.iter().zip(&linearization.elements).enumerate())
            .map(|(q, (element, stiffness))| {
                let (linear_a, angular_a) = weighted(q);
                let (linear_b, angular_b) = weighted(q + 1);
                // The element pulls a with +F and b with -F, and turns them with -M.
                element_curvature(
                    element,
                    rod.strain_rule,
                    &Rod::element_pose(q, positions, rotations),
                    stiffness,
                    &stack(&(linear_a - linear_b), &-angular_a, &-angular_b),
                )
            })
            .collect();
        Self {
            elements,
            loads: load_curvatures(motion, trajectory, multipliers, k),
            interval: IntervalCurvature::at(motion, trajectory, multipliers, k),
        }
    }

    /// The bilinear form on two directions, each given by its parts at `k` and at `k + 1`.
    fn form(&self, a: &Slice, b: &Slice) -> f64 {
        let mut sum = 0.0;
        for (q, element) in self.elements.iter().enumerate() {
            sum += a.element(q).dot(&(element * b.element(q)));
        }
        for load in &self.loads {
            sum += a.rotations[load.node].dot(&(load.rotation * b.rotations[load.node]));
        }
        for (q, inertia) in self.interval.inertia.iter().enumerate() {
            sum += a.interval(q).dot(&(inertia * b.interval(q)));
        }
        for (q, stress) in self.interval.stress.iter().enumerate() {
            let ([here, there], [other, beyond]) = (a.both(q), b.both(q));
            sum += here.dot(&(stress.start * other + stress.cross * beyond))
                + there.dot(&(stress.cross.tr_mul(&other) + stress.end * beyond));
        }
        sum
    }
}

/// The terms of the loads at time node `k`.
pub(super) fn load_curvatures(
    motion: &Motion,
    trajectory: &Trajectory,
    multipliers: &Multipliers,
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

impl IntervalCurvature {
    /// The interval from `k` to `k + 1`.
    #[must_use]
    pub fn at(
        motion: &Motion,
        trajectory: &Trajectory,
        multipliers: &Multipliers,
        k: usize,
    ) -> Self {
        if k >= motion.grid.n_steps {
            return Self::default();
        }
        let stress = IntervalWeights::of(motion.rod, motion.grid.step)
            .map_or_else(Vec::new, |weights| {
                stress_curvatures(motion, trajectory, multipliers, weights, k)
            });
        Self {
            inertia: inertia_curvatures(motion, trajectory, multipliers, k),
            stress,
        }
    }
}

fn stress_curvatures(
    motion: &Motion,
    trajectory: &Trajectory,
    multipliers: &Multipliers,
    weights: IntervalWeights,
    k: usize,
) -> Vec<StressCurvature> {
    let rod = motion.rod;
    (rod.elements.iter().enumerate())
        .map(|(q, element)| {
            let half_step = 0.5 * motion.grid.step;
            let end = |k: usize, weight: f64, [a, b]: [(Vector3<f64>, Vector3<f64>); 2]| {
                let covector = stack(&(a.0 - b.0), &-a.1, &-b.1) * weight;
                let pose =
                    Rod::element_pose(q, trajectory.positions_at(k), trajectory.rotations_at(k));
                (pose, covector)
            };
            let leaving = [q, q + 1].map(|q| multipliers.at(motion, k, q));
            let arriving = [q, q + 1].map(|q| multipliers.arriving(motion, k + 1, q));
            let ends = [
                end(k, half_step * motion.kick(k).impulse, leaving),
                end(k + 1, half_step * motion.arriving_impulse(), arriving),
            ];
            stress_curvature(element, rod.strain_rule, weights, &ends)
        })
        .collect()
}

/// The inertia terms of every node over the interval from `k` to `k + 1`.
fn inertia_curvatures(
    motion: &Motion,
    trajectory: &Trajectory,
    multipliers: &Multipliers,
    k: usize,
) -> Vec<InertiaCurvature> {
    let [leaving, arriving] = motion.inertia(trajectory, k);
    let ends = trajectory
        .rotations_at(k)
        .iter()
        .zip(trajectory.rotations_at(k + 1));
    ends.zip(leaving.iter().zip(&arriving))
        .enumerate()
        .map(|(q, ((before, after), (leaving, arriving)))| {
            inertia_curvature(
                [leaving, arriving],
                motion.grid.step,
                &before.tr_mul(after),
                &multipliers.at(motion, k, q).1,
                &multipliers.arriving(motion, k + 1, q).1,
            )
        })
        .collect()
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
        let vectors = [0, 3, 6].map(|at| covector.fixed_rows::<3>(at).into_owned());
        let displacement = Displacement::along(
            vectors.each_ref().map(|v| Vec3::splat(Scalar, v)),
            element.length,
        );
        let moved = |sign: f64| {
            let turns = [pose.rotation_a, pose.rotation_b].map(Mat3::of_matrix);
            let (dx, turns) = displacement.moved(Vec3::splat(Scalar, &pose.dx), turns, sign);
            let [a, b] = turns.map(Mat3::matrix);
            let pose = ElementPose {
                dx: dx.vector(),
                rotation_a: &a,
                rotation_b: &b,
            };
            blocks_of(&element.stiffness(rule, &pose).1)
        };
        let found = [blocks_of(stiffness), moved(1.0), moved(-1.0)];
        return nine_by_nine(&displacement.curvature(&found));
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
    let law = Law::of::<R>(Scalar, element);
    let pose = pose_of_any_turn::<R>;
    let StressBlocks { start, cross, end } =
        lanes::curved::stress_curvature::<Scalar, R>(&law, element.length, weights, &ends, pose);
    let [start, cross, end] = [start, cross, end].map(|blocks| nine_by_nine(&blocks));
    StressCurvature { start, cross, end }
}

/// Second derivative of the momenta of a node over an interval, see `lanes::tangent::inertia_curvature`.
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
        lanes::tangent::inertia_curvature(rotary, time_step, turn, before, after).map(Mat3::matrix);
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

/// Second derivative of `λ·exp(±ζ̂)v` in `ζ`, either sign: `½(λvᵀ + vλᵀ) - (λ·v) I`.
///
/// A moment constant in space is `exp(-ζ̂)RᵀM` in the body frame; a force constant in the body is `R exp(ζ̂)f_b` in
/// space, and `λ` is then turned into the body frame.
#[must_use]
pub fn load_curvature(covector: &Vector3<f64>, vector: &Vector3<f64>) -> Matrix3<f64> {
    let outer = covector * vector.transpose();
    0.5 * (outer + outer.transpose()) - Matrix3::from_diagonal_element(covector.dot(vector))
}

/// Second derivative of the Lagrangian, with the [own](OwnCurvature) one of the functional as far as it is given, along every pair
/// of `directions`: symmetric, in their order; the unit is that of the functional per unit of both directions.
///
/// The clear counterpart and test oracle of
/// [`sensitivities`](super::sensitivity::sensitivities), and the form for directions of any kind.
///
/// # Errors
/// [`StepError`] where the trajectory cannot be linearized.
pub fn lagrangian_curvature(
    motion: &Motion,
    trajectory: &Trajectory,
    multipliers: &Multipliers,
    directions: &[TrajectoryTangent],
) -> Result<Mat<f64>, StepError> {
    let n = motion.rod.n_nodes();
    let mut curvature = Mat::zeros(directions.len(), directions.len());
    for k in 0..=motion.grid.n_steps {
        let linearization = StepLinearization::at(motion, trajectory, k)?;
        let step = StepCurvature::at(motion, trajectory, &linearization, multipliers, k);
        let slices: Vec<Slice> = (directions.iter())
            .map(|direction| Slice {
                positions: &direction.positions[k * n..][..n],
                rotations: &direction.rotations[k * n..][..n],
                next_positions: direction.positions.get((k + 1) * n..).unwrap_or_default(),
                next: direction.rotations.get((k + 1) * n..).unwrap_or_default(),
            })
            .collect();
        for (j, b) in slices.iter().enumerate() {
            for (i, a) in slices[..=j].iter().enumerate() {
                curvature[(i, j)] += step.form(a, b);
                for own in own_within(multipliers.own, k..k + 1) {
                    curvature[(i, j)] += own.form(a, b);
                }
            }
        }
    }
    for j in 0..directions.len() {
        for i in 0..j {
            curvature[(j, i)] = curvature[(i, j)];
        }
    }
    Ok(curvature)
}

/// One time node of a direction, and the next.
struct Slice<'a> {
    positions: &'a [Vector3<f64>],
    rotations: &'a [Vector3<f64>],
    next_positions: &'a [Vector3<f64>],
    next: &'a [Vector3<f64>],
}

impl OwnCurvature {
    fn form(&self, a: &Slice, b: &Slice) -> f64 {
        let mut sum = 0.0;
        for (i, &row) in self.rows.iter().enumerate() {
            for (j, &column) in self.rows.iter().enumerate() {
                sum += self.matrix[(i, j)] * a.component(row) * b.component(column);
            }
        }
        sum
    }
}

impl Slice<'_> {
    fn component(&self, (node, component): (usize, usize)) -> f64 {
        [self.positions, self.rotations][component / 3][node][component % 3]
    }

    fn element(&self, q: usize) -> SVector<f64, 9> {
        stack(
            &(self.positions[q + 1] - self.positions[q]),
            &self.rotations[q],
            &self.rotations[q + 1],
        )
    }

    /// Element `q` at both time nodes.
    fn both(&self, q: usize) -> [SVector<f64, 9>; 2] {
        let there = stack(
            &(self.next_positions[q + 1] - self.next_positions[q]),
            &self.next[q],
            &self.next[q + 1],
        );
        [self.element(q), there]
    }

    fn interval(&self, q: usize) -> SVector<f64, 6> {
        let mut both = SVector::<f64, 6>::zeros();
        both.fixed_rows_mut::<3>(0).copy_from(&self.rotations[q]);
        both.fixed_rows_mut::<3>(3).copy_from(&self.next[q]);
        both
    }
}

fn stack(a: &Vector3<f64>, b: &Vector3<f64>, c: &Vector3<f64>) -> SVector<f64, 9> {
    let mut out = SVector::<f64, 9>::zeros();
    out.fixed_rows_mut::<3>(0).copy_from(a);
    out.fixed_rows_mut::<3>(3).copy_from(b);
    out.fixed_rows_mut::<3>(6).copy_from(c);
    out
}
