//! The linearization of consecutive time nodes: the standard model in vector instructions, one time node in each lane, and a time node by
//! itself where the section thins or an element is bent by more than vectors take.

mod parts;
mod reach;
mod solved;
mod workspace;

use std::marker::PhantomData;
use std::ops::RangeInclusive;

use nalgebra::{SVector, Vector3};
use pulp::{Arch, Scalar, Simd, WithSimd};

pub(super) use self::parts::Inertias;
use self::parts::{Drifts, Factors, Spins};
use self::reach::ROUNDING;
pub(super) use self::reach::Reach;
pub(super) use self::solved::{Weights, element_at};
pub(super) use self::workspace::{MULTIPLIER_ROWS, Workspace, matrix, scatter, store, store_block};
use super::active::{ActiveTimes, MixedSlopes};
use super::along::Along;
use super::dilated::element_drifts;
use super::step::{
    ActingKick, LinearizedStep, NodeDrift, ResistedDrift, StepCurvature, WinchKick, add_reordered,
    pack_loads, square,
};
use crate::curvature::{
    InertiaCurvature, IntervalCurvature, MotionMultipliers, StressCurvature, active_curvature,
    element_curvature, load_curvatures,
};
use crate::linearization::{Kick, Motion, acting_derivatives, load_derivatives};
use crate::tangent::{LEAST_MARGIN, NodePose, POSE_ROWS, drift, drift_to, inertia_curvature};
use cosserat::configuration::Trajectory;
use cosserat::element::{
    AnyTurn, Blocks, Displacement, ElementStiffness, Helical, MildTurn, RodModel, StrainRule,
    TangentRule, Trapezoidal,
};
use cosserat::guards::not_finite;
use cosserat::inertia::InertiaRule;
use cosserat::instructions::{CountLanes, dispatch};
use cosserat::rod::Rod;
use cosserat::rotation::cay_inverse;
use cosserat::step_error::StepError;
use cosserat::time::TimeScheme;
use cosserat::vector::{Lanes, Mat3, Row, Vec3, rows};

/// Memory of a linearization, for motions of one rod.
#[derive(Debug)]
pub struct Memory {
    /// Memory for one time node in each lane, if the [vectors know](is_possible) the rod.
    many: Option<Workspace>,
    /// Memory for one time node; allocated when it is needed first.
    single: Option<Workspace>,
}

impl Memory {
    /// Memory of a linearization that takes every time node by itself.
    pub fn singly() -> Self {
        Self {
            many: None,
            single: None,
        }
    }

    pub fn of(arch: Arch, motion: &Motion) -> Self {
        let n_lanes = dispatch(arch, CountLanes);
        let possible = is_possible(motion);
        Self {
            many: possible.then(|| Workspace::new(motion, n_lanes)),
            single: (!possible).then(|| Workspace::new(motion, 1)),
        }
    }

    /// Linearizes the time nodes from `first` on into `steps`; with multipliers, their curvature as well. The result depends neither
    /// on the instruction set nor on what is linearized in one call.
    ///
    /// # Errors
    /// [`StepError`] of the first time node that cannot be linearized.
    pub fn linearize(
        &mut self,
        arch: Arch,
        along: &Along,
        first: usize,
        steps: &mut [LinearizedStep],
    ) -> Result<(), StepError> {
        let n_lanes = dispatch(arch, CountLanes);
        // The interval before a time node is that after the one before.
        let mut before = IntervalCurvature::default();
        if let (Some(k), Some(_)) = (first.checked_sub(1), along.multipliers) {
            before = self.interval(arch, along, k)?;
        }
        let mixed = MixedSlopes::of(along, first, steps.len());
        for (steps, first) in steps.chunks_mut(n_lanes).zip((first..).step_by(n_lanes)) {
            let regular = (self.many.as_mut()).map_or(Regular::default(), |workspace| {
                many(arch, along, first, steps, workspace, Scope::All)
            });
            for (lane, (step, k)) in steps.iter_mut().zip(first..).enumerate() {
                let is_done = regular.both() >> lane & 1 == 1;
                let next = match &mut self.many {
                    Some(workspace) if is_done => &mut workspace.intervals[lane],
                    _ => {
                        let single = self.single(along.motion);
                        linearize_one(along, k, step, single, Scope::All)?;
                        &mut single.intervals[0]
                    }
                };
                step.finish_winches(along.motion, k)?;
                if let (Some(multipliers), Some(curvature)) =
                    (along.multipliers, &mut step.curvature)
                {
                    for winch in &step.winches {
                        winch.add_curvature(along, multipliers, k, curvature);
                    }
                    for winch in &step.solve.winches {
                        winch.add_curvature(along, multipliers, k, next);
                    }
                    mixed.write(k, &mut curvature.mixed);
                    let loads = load_curvatures(along.motion, along.trajectory, multipliers, k);
                    curvature.add_neighbors(along.motion.rod, &before, &loads, next);
                    std::mem::swap(&mut before, next);
                }
            }
        }
        Ok(())
    }

    /// The curvature of the interval after a time node.
    fn interval(
        &mut self,
        arch: Arch,
        along: &Along,
        k: usize,
    ) -> Result<IntervalCurvature, StepError> {
        let mut step = [LinearizedStep::default()];
        let mut interval = if let Some(workspace) = &mut self.many
            && many(arch, along, k, &mut step, workspace, Scope::Drifts).drifts & 1 == 1
        {
            workspace.intervals[0].clone()
        } else {
            let single = self.single(along.motion);
            linearize_one(along, k, &mut step[0], single, Scope::Drifts)?;
            single.intervals[0].clone()
        };
        if let Some(multipliers) = along.multipliers {
            for winch in &step[0].solve.winches {
                winch.add_curvature(along, multipliers, k, &mut interval);
            }
        }
        Ok(interval)
    }

    fn single(&mut self, motion: &Motion) -> &mut Workspace {
        self.single.get_or_insert_with(|| Workspace::new(motion, 1))
    }
}

/// Linearizes time nodes from `first` on, one in each lane.
fn many(
    arch: Arch,
    along: &Along,
    first: usize,
    steps: &mut [LinearizedStep],
    workspace: &mut Workspace,
    scope: Scope,
) -> Regular {
    let group = Group {
        along,
        first,
        steps,
        workspace,
        scope,
    };
    match along.motion.rod.strain_rule {
        StrainRule::Helical => dispatch(arch, Ruled::<Helical>::new(group)),
        StrainRule::Trapezoidal => dispatch(arch, Ruled::<Trapezoidal>::new(group)),
    }
}

/// Linearizes one time node of any motion.
fn linearize_one(
    along: &Along,
    k: usize,
    step: &mut LinearizedStep,
    workspace: &mut Workspace,
    scope: Scope,
) -> Result<(), StepError> {
    let motion = along.motion;
    let leaves = k < *along.stretch.end();
    workspace.rotary = (leaves && motion.rod.model != RodModel::Standard)
        .then(|| motion.inertia(along.trajectory, k));
    let group = Group {
        along,
        first: k,
        steps: std::slice::from_mut(step),
        workspace,
        scope,
    };
    let regular = match motion.rod.strain_rule {
        StrainRule::Helical => group.run::<Scalar, Helical, AnyTurn>(Scalar),
        StrainRule::Trapezoidal => group.run::<Scalar, Trapezoidal, AnyTurn>(Scalar),
    };
    if regular.drifts & 1 == 1 || !leaves {
        return Ok(());
    }
    let pivots = || {
        let first = motion.rod.first_free_node();
        let time = motion.grid.time(k);
        not_finite(first, k, time, "the inverse of the implicit step")
    };
    Err(turn_error(motion, along.trajectory, k).unwrap_or_else(pivots))
}

/// The error of the first node that turns by a quarter turn or more, where the discrete momentum folds over, from time node `k` to the
/// next, or that is no number.
pub(super) fn turn_error(motion: &Motion, trajectory: &Trajectory, k: usize) -> Option<StepError> {
    let (before, after) = (trajectory.rotations_at(k), trajectory.rotations_at(k + 1));
    let time = motion.grid.time(k);
    before
        .iter()
        .zip(after)
        .enumerate()
        .find_map(|(node, (before, after))| {
            let turn = before.tr_mul(after);
            let ratio = 0.5 * cay_inverse(&turn).norm();
            if ratio < 1.0 - ROUNDING && turn.trace() > 1.0 + ROUNDING {
                return None;
            }
            let what = "the rotation between two time nodes";
            Some(if ratio.is_finite() {
                StepError::RotationTooLarge {
                    node,
                    step: k,
                    time,
                    ratio: ratio.max(1.0),
                }
            } else {
                not_finite(node, k, time, what)
            })
        })
}

/// Writes the kicks of actuators of one's own, of functions of nodes and of contacts at time node `k`, which is in a lane.
fn write_acting_kicks(
    along: &Along,
    active: Option<&ActiveTimes>,
    (k, lane): (usize, usize),
    weight: f64,
    out: &mut Vec<ActingKick>,
) {
    let (rod, trajectory) = (along.motion.rod, along.trajectory);
    let own = acting_derivatives(along.motion, trajectory, k);
    let functions = rod.actuators.functions();
    let touches = rod.touches();
    let n_kicks = own.len() + functions.len() + touches.len();
    out.resize_with(n_kicks, ActingKick::default);
    for (kick, acting) in out.iter_mut().zip(&own) {
        *kick = ActingKick::new(acting, weight);
    }
    let efforts = active.map_or(&[][..], |active| active.inputs(lane));
    let (x, r) = (trajectory.positions_at(k), trajectory.rotations_at(k));
    for (kick, function) in out[own.len()..].iter_mut().zip(functions) {
        let tangent = function.function.tangent(&function.pose(x, r)) * function.factor(efforts);
        kick.renew(function.node, &tangent, weight);
    }
    for (kick, touch) in out[own.len() + functions.len()..].iter_mut().zip(touches) {
        let ends = [touch.element, touch.element + 1];
        kick.touch(
            touch.element,
            touch.hessian(ends.map(|node| &x[node])),
            weight,
        );
    }
}

impl WinchKick {
    /// Adds `k' (λ·g) ∂²y` to the second derivatives of the elements, with the derivative `k'` of the tension along the coordinate `y`, its
    /// pull `g` and the multipliers `λ`. The rest, `k' (g bᵀ + b gᵀ)` with the derivative `b` of `λ·g`, couples all elements.
    fn add_curvature(
        &self,
        along: &Along,
        multipliers: &MotionMultipliers,
        k: usize,
        curvature: &mut StepCurvature,
    ) {
        let (motion, trajectory) = (along.motion, along.trajectory);
        let rod = motion.rod;
        let pulled: f64 = (self.pull())
            .map(|(node, component, pull)| {
                let (linear, angular) = multipliers.at(motion, k, node);
                let covector = [linear, angular][component / 3][component % 3];
                covector * pull
            })
            .sum();
        let mut unit = vec![0.0; rod.actuators.n_efforts()];
        // The potential of an effort is minus the coordinate.
        unit[self.actuator] = -self.factor * pulled;
        for (q, target) in curvature.elements.iter_mut().enumerate() {
            let (x, r) = (trajectory.positions_at(k), trajectory.rotations_at(k));
            let pose = Rod::element_pose(q, x, r);
            if let Some(stiffness) = rod.active_stiffness(q, &pose, &unit) {
                add_reordered(target, &(0.5 * (stiffness + stiffness.transpose())));
            }
        }
    }
}

/// The kick of a time node: half of it at either end of the stretch.
fn kick(motion: &Motion, stretch: &RangeInclusive<usize>, k: usize) -> Kick {
    if k == *stretch.start() {
        motion.kick(0)
    } else if k == *stretch.end() {
        motion.kick(motion.grid.n_steps)
    } else {
        motion.kick(k)
    }
}

/// The vectors know the standard model.
pub(super) fn is_possible(motion: &Motion) -> bool {
    motion.rod.model == RodModel::Standard
}

/// Time nodes that are linearized together, one in each lane; the last one also fills lanes that are left.
pub(super) struct Group<'a> {
    pub along: &'a Along<'a>,
    pub first: usize,
    pub steps: &'a mut [LinearizedStep],
    pub workspace: &'a mut Workspace,
    scope: Scope,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Scope {
    Drifts,
    All,
}

/// A bit for every lane that could do it: where a node turns too far, or the ends of an element are near half a turn, it cannot.
#[derive(Clone, Copy, Default)]
struct Regular {
    drifts: u64,
    /// Zero where they were not asked for.
    elements: u64,
}

impl Regular {
    fn both(self) -> u64 {
        self.drifts & self.elements
    }
}

/// A [`Group`] under a strain rule.
struct Ruled<'a, R> {
    group: Group<'a>,
    rule: PhantomData<R>,
}

impl<'a, R> Ruled<'a, R> {
    fn new(group: Group<'a>) -> Self {
        Self {
            group,
            rule: PhantomData,
        }
    }
}

impl<R: TangentRule> WithSimd for Ruled<'_, R> {
    type Output = Regular;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Regular {
        self.group.run::<S, R, MildTurn>(simd)
    }
}

impl Group<'_> {
    #[inline(always)]
    fn run<S: Simd, R: TangentRule, P: Reach<S>>(mut self, simd: S) -> Regular {
        self.gather(S::F64_LANES);
        self.prepare();
        let is_curved = self.along.multipliers.is_some();
        let explicit = self.along.motion.rod.scheme == TimeScheme::Explicit;
        if self.workspace.solve.is_some() {
            self.prepare_solve(S::F64_LANES);
            let mut irregular = self.apart::<S, Spins<P>>(simd);
            if is_curved {
                irregular = irregular + self.bent_intervals::<S, R, P>(simd);
            }
            if self.scope == Scope::All {
                if is_curved && explicit {
                    irregular = irregular + self.elements::<S, R, P>(simd);
                }
                irregular = irregular + self.solved_elements::<S, R, P>(simd);
                irregular = irregular + self.apart::<S, Factors>(simd);
            }
            let both = self.zeros(irregular);
            return Regular {
                drifts: both,
                elements: both,
            };
        }
        let irregular = self.apart::<S, Drifts<P>>(simd);
        let drifts = self.zeros(irregular);
        let mut elements = 0;
        if self.scope == Scope::All {
            let irregular = self.elements::<S, R, P>(simd);
            elements = self.zeros(irregular);
        }
        Regular { drifts, elements }
    }
}

impl Group<'_> {
    /// Time node of a lane.
    pub fn time_node(&self, lane: usize) -> usize {
        self.first + lane.min(self.steps.len() - 1)
    }

    pub fn kick(&self, k: usize) -> Kick {
        kick(self.along.motion, &self.along.stretch, k)
    }

    /// Tells whether an interval of the stretch begins at a time node.
    pub fn leaves(&self, k: usize) -> bool {
        k < *self.along.stretch.end()
    }

    /// Tells whether an interval of the stretch ends at a time node.
    pub fn arrives(&self, k: usize) -> bool {
        k > *self.along.stretch.start()
    }

    fn gather(&mut self, n_lanes: usize) {
        let n_nodes = self.along.motion.rod.n_nodes();
        let n_steps = self.along.motion.grid.n_steps;
        let last = self.time_node(n_lanes);
        (self.workspace).put_poses(self.along.trajectory, self.first, last, n_lanes);
        for lane in 0..n_lanes {
            let k = self.time_node(lane);
            self.workspace.weights[lane] = self.kick(k).weight;
            let workspace = &mut *self.workspace;
            if let Some(active) = &mut workspace.active {
                let motion = self.along.motion;
                let along = (motion, motion.control, self.along.trajectory);
                active.put(along, k, (lane, n_lanes));
            }
            let Some(multipliers) = self.along.multipliers else {
                continue;
            };
            for node in 0..n_nodes {
                let (linear, angular) = multipliers.at(self.along.motion, k, node);
                let (arriving_linear, arriving) =
                    multipliers.arriving(self.along.motion, (k + 1).min(n_steps), node);
                let weight = workspace.weights[lane];
                let vectors = [
                    linear * weight,
                    angular * weight,
                    angular,
                    arriving,
                    linear,
                    arriving_linear,
                ];
                for (i, value) in vectors.iter().flat_map(Vector3::iter).enumerate() {
                    let row = node * MULTIPLIER_ROWS + i;
                    workspace.multipliers[row * n_lanes + lane] = *value;
                }
            }
        }
    }

    /// All but drifts and elements, which the lanes fill in.
    fn prepare(&mut self) {
        let rod = self.along.motion.rod;
        let (motion, stretch) = (self.along.motion, &self.along.stretch);
        let solved = self.workspace.solve.is_some();
        let n_drifts = |k: usize| if k < *stretch.end() { rod.n_nodes() } else { 0 };
        for (lane, (step, k)) in self.steps.iter_mut().zip(self.first..).enumerate() {
            let kick = kick(motion, stretch, k);
            step.decay = kick.decay;
            step.weight = kick.weight;
            step.loads = pack_loads(
                &load_derivatives(self.along.motion, self.along.trajectory, k),
                kick.weight,
            );
            let active = self.workspace.active.as_ref();
            write_acting_kicks(self.along, active, (k, lane), kick.weight, &mut step.acting);
            if let Some(active) = &mut self.workspace.active {
                let at = (self.along.motion.rod, self.along.trajectory);
                active.write_winch_kicks(at, (k, lane), kick.weight, &mut step.winches);
                if k < *stretch.end() {
                    let at = (motion, self.along.trajectory);
                    active.write_winch_drifts(at, (k, lane), &mut step.solve.winches);
                }
            } else {
                // The memory may have been that of another rod.
                step.winches.clear();
                step.solve.winches.clear();
            }
            step.first_free_node = rod.first_free_node();
            step.joints.clone_from(&rod.joints);
            step.element_drifts.clear();
            step.resisted.clear();
            if k < *stretch.end() && !rod.resistances.is_empty() {
                let nodes = 0..rod.n_nodes();
                let at = (motion, self.along.trajectory);
                let drifts = nodes.map(|q| ResistedDrift::of(at.0, at.1, (k, q), kick.impulse));
                step.resisted.extend(drifts);
            }
            if solved {
                step.drifts.clear();
            } else {
                step.solve.clear();
                step.drifts.resize(n_drifts(k), NodeDrift::default());
            }
            step.elements.resize(rod.n_elements(), [[0.0; 9]; 9]);
            if self.along.multipliers.is_some() {
                let curvature = step.curvature.get_or_insert_default();
                // The terms of the elements themselves, where they have any, come next.
                curvature.elements.clear();
                curvature.elements.resize(rod.n_elements(), [[0.0; 9]; 9]);
            } else {
                step.curvature = None;
            }
        }
        for (interval, k) in self.workspace.intervals.iter_mut().zip(self.first..) {
            interval
                .inertia
                .resize(n_drifts(k), InertiaCurvature::zeros());
            let n_stressed = if solved && k < *stretch.end() {
                rod.n_elements()
            } else {
                0
            };
            let zeros = ElementStiffness::zeros();
            interval.stress.resize(
                n_stressed,
                StressCurvature {
                    start: zeros,
                    cross: zeros,
                    end: zeros,
                },
            );
        }
    }

    /// A bit for every lane that is zero.
    #[inline(always)]
    fn zeros<S: Simd>(&mut self, counts: Lanes<S>) -> u64 {
        let out = &mut self.workspace.out;
        let rows: &mut [Row<S>] = S::as_mut_simd_f64s(out).0;
        rows[0] = counts.value;
        let mut bits = 0;
        for (lane, count) in out[..S::F64_LANES].iter().enumerate() {
            bits |= u64::from(*count == 0.0) << lane;
        }
        bits
    }

    /// Counts what is irregular, lane by lane.
    #[inline(always)]
    fn drifts<S: Simd, P: Reach<S>>(&mut self, simd: S) -> Lanes<S> {
        let Motion { rod, grid, .. } = *self.along.motion;
        let inertia = InertiaRule::of(rod.model, self.first);
        let Workspace {
            poses,
            next,
            out,
            rotary,
            ..
        } = &mut *self.workspace;
        let (poses, next) = (rows::<S>(poses), rows::<S>(next));
        let (zero, one) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0));
        let mut irregular = zero;
        for (node, at_rest) in rod.nodes.iter().enumerate() {
            let before = NodePose::<S>::load(simd, &poses[node * POSE_ROWS..]).rotation;
            let after = NodePose::<S>::load(simd, &next[node * POSE_ROWS..]).rotation;
            let h = grid.step;
            let drift = match rotary {
                Some([leaving, arriving]) if P::ALL && inertia == InertiaRule::Both => {
                    drift_to(&arriving[node], &leaving[node], h, before, after)
                }
                Some([leaving, _]) if P::ALL => drift(&leaving[node], h, before, after),
                _ => drift(&at_rest.rotary, h, before, after),
            };
            // Also where it is no number.
            irregular = irregular
                + drift.level.select_below(1.0 - P::MARGIN, zero, one)
                + (-drift.margin).select_below(-2.0 - P::MARGIN, zero, one);
            store(out, 0, drift.turn_transposed);
            store(out, 9, drift.theta);
            store(out, 18, drift.momentum);
            let mobility = grid.step / at_rest.mass;
            for (lane, step) in self.steps.iter_mut().enumerate() {
                if let Some(packed) = step.drifts.get_mut(node) {
                    packed.mobility = mobility;
                    packed.turn_transposed = matrix::<S>(out, 0, lane);
                    packed.theta = matrix::<S>(out, 9, lane);
                    packed.momentum = matrix::<S>(out, 18, lane);
                }
            }
        }
        if P::ALL && rotary.is_some() && inertia != InertiaRule::Constant {
            self.dilated_drifts();
        }
        if self.along.multipliers.is_some() {
            self.apart::<S, Inertias>(simd);
        }
        irregular
    }

    /// Curvatures of the inertia of a node over the intervals.
    #[inline(always)]
    fn inertia_curvatures<S: Simd>(&mut self, simd: S, node: usize) {
        let rod = self.along.motion.rod;
        let rotary = self.workspace.rotary(rod, node).map(|rotary| *rotary);
        let Workspace {
            poses,
            next,
            multipliers,
            out,
            intervals,
            ..
        } = &mut *self.workspace;
        let at = node * POSE_ROWS;
        let before = NodePose::<S>::load(simd, &rows::<S>(poses)[at..]).rotation;
        let after = NodePose::<S>::load(simd, &rows::<S>(next)[at..]).rotation;
        let multipliers = &rows::<S>(multipliers)[node * MULTIPLIER_ROWS..];
        let (leaving, arriving) = (
            Vec3::load(simd, multipliers, 6),
            Vec3::load(simd, multipliers, 9),
        );
        let turn = before.transposed_product(after);
        let h = self.along.motion.grid.step;
        let [own, mixed, far] = inertia_curvature(rotary.each_ref(), h, turn, leaving, arriving);
        store(out, 0, own);
        store(out, 9, mixed);
        store(out, 18, far);
        for (lane, interval) in intervals.iter_mut().enumerate() {
            let Some(target) = interval.inertia.get_mut(node) else {
                continue;
            };
            for i in 0..3 {
                for j in 0..3 {
                    let at = |from: usize| out[(from + 3 * i + j) * S::F64_LANES + lane];
                    target[(i, j)] = at(0);
                    target[(i, 3 + j)] = at(9);
                    target[(3 + j, i)] = at(9);
                    target[(3 + i, 3 + j)] = at(18);
                }
            }
        }
    }

    /// The parts of all drifts that the dilatation of the elements has, of one time node.
    fn dilated_drifts(&mut self) {
        let Along {
            motion, trajectory, ..
        } = self.along;
        if let Some([leaving, _]) = &self.workspace.rotary {
            let step = &mut self.steps[0];
            element_drifts(motion, trajectory, self.first, leaving, step);
        }
    }

    /// Stiffnesses and curvatures of all elements, by whatever law and bent by whatever angle, at one time node.
    fn all_elements(&mut self) {
        let Along {
            motion,
            trajectory,
            multipliers,
            ..
        } = self.along;
        let (rod, k) = (motion.rod, self.first);
        let weight = self.kick(k).weight;
        let (positions, rotations) = (trajectory.positions_at(k), trajectory.rotations_at(k));
        let step = &mut self.steps[0];
        let efforts = (self.workspace.active.as_ref()).map(ActiveTimes::single);
        for (q, element) in rod.elements.iter().enumerate() {
            let pose = Rod::element_pose(q, positions, rotations);
            let (_, stiffness) = element.stiffness(rod.strain_rule, &pose);
            let active = efforts.and_then(|efforts| rod.active_stiffness(q, &pose, efforts));
            let total = active.map_or(stiffness, |active| stiffness + active);
            step.elements[q] = square(&(total * weight));
            if let (Some(multipliers), Some(packed)) = (multipliers, &mut step.curvature) {
                let [a, b] = [q, q + 1].map(|node| multipliers.at(motion, k, node));
                // The element pulls a with +F and b with -F, and turns them with -M.
                let parts = [a.0 - b.0, -a.1, -b.1].map(|part| part * weight);
                let covector = SVector::from_iterator(parts.iter().flatten().copied());
                let curvature =
                    element_curvature(element, rod.strain_rule, &pose, &stiffness, &covector);
                add_reordered(&mut packed.elements[q], &curvature);
                if let (Some(active), Some(efforts)) = (active, efforts) {
                    let curvature = active_curvature(rod, q, &pose, &active, efforts, &covector);
                    add_reordered(&mut packed.elements[q], &curvature);
                }
            }
        }
    }

    /// Counts what is irregular, lane by lane.
    #[inline(always)]
    fn elements<S: Simd, R: TangentRule, P: Reach<S>>(&mut self, simd: S) -> Lanes<S> {
        if P::ALL {
            self.all_elements();
            return Lanes::splat(simd, 0.0);
        }
        let Workspace {
            poses,
            multipliers,
            weights,
            out,
            active,
            ..
        } = &mut *self.workspace;
        let actuators = &self.along.motion.rod.actuators;
        let active = active.as_ref().map(|active| active.part::<S>(actuators, 0));
        let poses = rows::<S>(poses);
        let multipliers = rows::<S>(multipliers);
        let weight = Lanes {
            simd,
            value: rows::<S>(weights)[0],
        };
        let (zero, one) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0));
        let mut irregular = zero;
        let curved = self.along.multipliers.is_some();
        let mut found = [[[Mat3::zero(simd); 3]; 3]; 3];
        for (q, element) in self.along.motion.rod.elements.iter().enumerate() {
            let a = NodePose::<S>::load(simd, &poses[q * POSE_ROWS..]);
            let b = NodePose::<S>::load(simd, &poses[(q + 1) * POSE_ROWS..]);
            let dx = b.position - a.position;
            let turns = [a.rotation, b.rotation];
            let margin = a.rotation.transposed_product(b.rotation).trace() + 1.0;
            irregular = irregular + (-margin).select_below(-LEAST_MARGIN, zero, one);
            let rows_a = &multipliers[q * MULTIPLIER_ROWS..];
            let rows_b = &multipliers[(q + 1) * MULTIPLIER_ROWS..];
            let covector = [
                Vec3::load(simd, rows_a, 0) - Vec3::load(simd, rows_b, 0),
                -Vec3::load(simd, rows_a, 3),
                -Vec3::load(simd, rows_b, 3),
            ];
            let displacement = Displacement::along(covector, element.length);
            let signs: &[f64] = if curved { &[0.0, 1.0, -1.0] } else { &[0.0] };
            for (found, sign) in found.iter_mut().zip(signs) {
                let (dx, [a, b]) = if *sign == 0.0 {
                    (dx, turns)
                } else {
                    displacement.moved(dx, turns, *sign)
                };
                *found = match &active {
                    Some(active) => active.stiffness::<R>(element, q, dx, a, b),
                    None => R::stiffness(element, dx, a, b),
                };
            }
            for (i, blocks) in found[0].iter().enumerate() {
                for (j, block) in blocks.iter().enumerate() {
                    store_block(out, i, j, *block * weight);
                }
            }
            for (lane, step) in self.steps.iter_mut().enumerate() {
                scatter::<S>(out, lane, &mut step.elements[q]);
            }
            if curved {
                let curvature: Blocks<S> = displacement.curvature(&found);
                // In the order ζ_a, dx, ζ_b.
                const ORDER: [usize; 3] = [1, 0, 2];
                for (i, from) in ORDER.into_iter().enumerate() {
                    for (j, to) in ORDER.into_iter().enumerate() {
                        store_block(out, i, j, curvature[from][to]);
                    }
                }
                for (lane, step) in self.steps.iter_mut().enumerate() {
                    if let Some(packed) = &mut step.curvature {
                        scatter::<S>(out, lane, &mut packed.elements[q]);
                    }
                }
            }
        }
        irregular
    }
}
