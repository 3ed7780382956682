//! The linearization of consecutive time nodes in the packed layout: one time node in each lane of a vector if the kernel applies, and the
//! [plain linearization](StepLinearization) for the other nodes.

use std::marker::PhantomData;
use std::ops::RangeInclusive;

use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};

use super::packed::{PackedCurvature, PackedDrift, PackedStep, pack_acting, pack_loads};
use super::solved::SolveRows;
use crate::mechanics::buffer::Buffer;
use crate::mechanics::configuration::Trajectory;
use crate::mechanics::curvature::{
    InertiaCurvature, IntervalCurvature, Multipliers, StepCurvature, StressCurvature,
    load_curvatures,
};
use crate::mechanics::element::RodModel;
use crate::mechanics::element::{Blocks, Displacement, Helical, TangentRule, Trapezoidal};
use crate::mechanics::element::{ElementStiffness, StrainRule};
use crate::mechanics::implicit::IntervalWeights;
use crate::mechanics::lanes::tangent::{
    LEAST_MARGIN, NodePose, POSE_ROWS, drift, inertia_curvature, put_pose,
};
use crate::mechanics::lanes::vector::{Lanes, Mat3, Row, Vec3, rows};
use crate::mechanics::lanes::{CountLanes, dispatch};
use crate::mechanics::linearization::{
    Kick, Motion, StepLinearization, acting_derivatives, arriving_stiffness, load_derivatives,
};
use crate::mechanics::step_error::StepError;
use crate::mechanics::time::TimeScheme;

/// Linearizes the time nodes from `first` on into `steps`; with multipliers, their curvature as well. The result depends neither
/// on the instruction set nor on what is linearized in one call.
///
/// # Errors
/// [`StepError`] of the first time node that cannot be linearized.
pub(super) fn linearize(
    arch: Arch,
    motion: &Motion,
    trajectory: &Trajectory,
    multipliers: Option<&Multipliers>,
    stretch: &RangeInclusive<usize>,
    first: usize,
    steps: &mut [PackedStep],
) -> Result<(), StepError> {
    let mut lanes = Workspace::of(arch, motion);
    linearize_in(
        &mut lanes,
        arch,
        motion,
        trajectory,
        multipliers,
        stretch,
        first,
        steps,
    )
}

/// The same with memory of the caller's, made [for such a motion](Workspace::of).
#[expect(
    clippy::too_many_arguments,
    reason = "what a sweep is about, and its memory"
)]
pub(super) fn linearize_in(
    lanes: &mut Option<Workspace>,
    arch: Arch,
    motion: &Motion,
    trajectory: &Trajectory,
    multipliers: Option<&Multipliers>,
    stretch: &RangeInclusive<usize>,
    first: usize,
    steps: &mut [PackedStep],
) -> Result<(), StepError> {
    let n_lanes = dispatch(arch, CountLanes);
    let run = |first: usize, steps: &mut [PackedStep], workspace: &mut Workspace, scope| {
        let group = Group {
            motion,
            trajectory,
            multipliers,
            stretch,
            first,
            steps,
            workspace,
            scope,
        };
        match motion.rod.strain_rule {
            StrainRule::Helical => dispatch(arch, Ruled::<Helical>::new(group)),
            StrainRule::Trapezoidal => dispatch(arch, Ruled::<Trapezoidal>::new(group)),
        }
    };
    // The interval before a time node is that after the one before.
    let mut before = IntervalCurvature::default();
    if let (Some(k), Some(multipliers)) = (first.checked_sub(1), multipliers) {
        before = IntervalCurvature::at(motion, trajectory, multipliers, k);
        if let Some(workspace) = lanes.as_mut() {
            let mut step = [PackedStep::default()];
            if run(k, &mut step, workspace, Scope::Drifts).drifts & 1 == 1 {
                before = workspace.intervals[0].clone();
            }
        }
    }
    for (steps, first) in steps.chunks_mut(n_lanes).zip((first..).step_by(n_lanes)) {
        let done = (lanes.as_mut()).map_or(Regular::default(), |workspace| {
            run(first, steps, workspace, Scope::All)
        });
        for (lane, (step, k)) in steps.iter_mut().zip(first..).enumerate() {
            let has = |bits: u64| bits >> lane & 1 == 1;
            let interval = (lanes.as_mut()).filter(|_| has(done.drifts));
            let interval = interval.map(|workspace| &mut workspace.intervals[lane]);
            if let (Some(next), true) = (interval, has(done.elements)) {
                if let (Some(multipliers), Some(curvature)) = (multipliers, &mut step.curvature) {
                    let loads = load_curvatures(motion, trajectory, multipliers, k);
                    curvature.add_neighbors(motion.rod, &before, &loads, next);
                    std::mem::swap(&mut before, next);
                }
                continue;
            }
            let linearization = clear_step(motion, trajectory, stretch, k)?;
            let curvature = multipliers.map(|multipliers| {
                let mut here =
                    StepCurvature::at(motion, trajectory, &linearization, multipliers, k);
                if let Some(workspace) = (lanes.as_ref()).filter(|_| has(done.drifts)) {
                    here.interval = workspace.intervals[lane].clone();
                }
                let packed = PackedCurvature::new(motion.rod, &before, &here);
                before = here.interval;
                packed
            });
            let arriving: Vec<_> = if arrives(motion, stretch, k) {
                (0..motion.rod.n_elements())
                    .map(|q| arriving_stiffness(motion, trajectory, k - 1, q))
                    .collect()
            } else {
                Vec::new()
            };
            *step = PackedStep::new(&linearization, &arriving, curvature);
        }
    }
    Ok(())
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

/// Whether the stress of the interval before acts at a time node.
fn arrives(motion: &Motion, stretch: &RangeInclusive<usize>, k: usize) -> bool {
    k > *stretch.start() && IntervalWeights::of(motion.rod, motion.grid.step).is_some()
}

/// The plain linearization of a time node of the stretch.
fn clear_step(
    motion: &Motion,
    trajectory: &Trajectory,
    stretch: &RangeInclusive<usize>,
    k: usize,
) -> Result<StepLinearization, StepError> {
    let mut step = StepLinearization::at(motion, trajectory, k)?;
    step.kick = kick(motion, stretch, k);
    if k == *stretch.end() {
        step.drifts.clear();
        step.element_drifts.clear();
        step.stress_drift = None;
    }
    Ok(step)
}

/// The lanes know the standard model.
pub(super) fn is_possible(motion: &Motion) -> bool {
    motion.rod.model == RodModel::Standard
}

/// What a group of time nodes needs, a number in each lane.
#[derive(Debug)]
pub(super) struct Workspace {
    /// [`POSE_ROWS`] of every node, and those a step later.
    pub poses: Buffer,
    pub next: Buffer,
    /// Those a step earlier, of steps that are solved for.
    pub before: Buffer,
    /// Of steps that are solved for.
    pub solve: Option<SolveRows>,
    /// [`MULTIPLIER_ROWS`] of every node.
    pub multipliers: Buffer,
    /// Weights of the kicks.
    weights: Buffer,
    /// Results on their way to the time nodes.
    pub out: Buffer,
    /// Curvature of the interval after each of the time nodes.
    pub intervals: Vec<IntervalCurvature>,
}

/// `λx` and `λr` times the kick's weight, and for the interval that follows `λr` and the `μr` where it ends, then `λx` and `μx`.
pub(super) const MULTIPLIER_ROWS: usize = 18;
/// Those of three 6×6 matrices, the most that is on its way at once.
const OUT_ROWS: usize = 108;

impl Workspace {
    /// Where the lanes can linearize the motion.
    pub fn of(arch: Arch, motion: &Motion) -> Option<Self> {
        let n_lanes = dispatch(arch, CountLanes);
        is_possible(motion).then(|| Self::new(motion, n_lanes))
    }

    pub fn new(motion: &Motion, n_lanes: usize) -> Self {
        let n_nodes = motion.rod.n_nodes();
        let solve = SolveRows::of(motion, n_lanes);
        let poses = || Buffer::zeros(n_nodes * POSE_ROWS * n_lanes);
        Self {
            poses: poses(),
            next: poses(),
            before: if solve.is_some() {
                poses()
            } else {
                Buffer::zeros(0)
            },
            solve,
            multipliers: Buffer::zeros(n_nodes * MULTIPLIER_ROWS * n_lanes),
            weights: Buffer::zeros(n_lanes),
            out: Buffer::zeros(OUT_ROWS * n_lanes),
            intervals: vec![IntervalCurvature::default(); n_lanes],
        }
    }

    /// The poses of the time nodes from `first` to `last` on, one in each lane, and of those before and after; lanes that are left get
    /// those of the last. Before the first and after the last of the trajectory there are no others.
    pub fn put_poses(
        &mut self,
        trajectory: &Trajectory,
        first: usize,
        last: usize,
        n_lanes: usize,
    ) {
        let end = trajectory.n_times() - 1;
        for lane in 0..n_lanes {
            put_time_node(
                &mut self.poses,
                trajectory,
                (first + lane).min(last),
                lane,
                n_lanes,
            );
        }
        // The neighbors are those of the next lane and of the lane before, but for one.
        let n = self.poses.len();
        self.next[..n - 1].copy_from_slice(&self.poses[1..]);
        let next = (last + 1).min(end);
        for lane in [last - first, n_lanes - 1] {
            put_time_node(&mut self.next, trajectory, next, lane, n_lanes);
        }
        if !self.before.is_empty() {
            self.before[1..].copy_from_slice(&self.poses[..n - 1]);
            put_time_node(
                &mut self.before,
                trajectory,
                first.saturating_sub(1),
                0,
                n_lanes,
            );
        }
    }
}

/// The pose of every node at time node `k`, to one lane.
fn put_time_node(
    poses: &mut [f64],
    trajectory: &Trajectory,
    k: usize,
    lane: usize,
    n_lanes: usize,
) {
    let positions = trajectory.positions_at(k);
    let rotations = trajectory.rotations_at(k);
    for (node, rows) in poses.chunks_exact_mut(POSE_ROWS * n_lanes).enumerate() {
        put_pose(rows, n_lanes, lane, &positions[node], &rotations[node]);
    }
}

/// Time nodes that are linearized together, one in each lane; the last one also fills lanes that are left.
pub(super) struct Group<'a> {
    pub motion: &'a Motion<'a>,
    trajectory: &'a Trajectory,
    multipliers: Option<&'a Multipliers<'a>>,
    stretch: &'a RangeInclusive<usize>,
    pub first: usize,
    pub steps: &'a mut [PackedStep],
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
        let mut group = self.group;
        group.gather(S::F64_LANES);
        group.prepare();
        if group.workspace.solve.is_some() {
            group.prepare_solve(S::F64_LANES);
            let mut irregular = group.spins(simd);
            if group.multipliers.is_some() {
                irregular = irregular + group.bent_intervals::<S, R>(simd);
            }
            if group.scope == Scope::All {
                if group.multipliers.is_some() && group.motion.rod.scheme == TimeScheme::Explicit {
                    irregular = irregular + group.elements::<S, R>(simd);
                }
                irregular = irregular + group.solved_elements::<S, R>(simd) + group.factors(simd);
            }
            let both = group.zeros(irregular);
            return Regular {
                drifts: both,
                elements: both,
            };
        }
        let irregular = group.drifts(simd);
        let drifts = group.zeros(irregular);
        let mut elements = 0;
        if group.scope == Scope::All {
            let irregular = group.elements::<S, R>(simd);
            elements = group.zeros(irregular);
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
        kick(self.motion, self.stretch, k)
    }

    /// Whether an interval of the stretch begins at a time node.
    pub fn leaves(&self, k: usize) -> bool {
        k < *self.stretch.end()
    }

    /// Whether one ends there.
    pub fn arrives(&self, k: usize) -> bool {
        k > *self.stretch.start()
    }

    fn gather(&mut self, n_lanes: usize) {
        let n_nodes = self.motion.rod.n_nodes();
        let n_steps = self.motion.grid.n_steps;
        let last = self.time_node(n_lanes);
        (self.workspace).put_poses(self.trajectory, self.first, last, n_lanes);
        for lane in 0..n_lanes {
            let k = self.time_node(lane);
            self.workspace.weights[lane] = self.kick(k).weight;
            let workspace = &mut *self.workspace;
            let Some(multipliers) = self.multipliers else {
                continue;
            };
            for node in 0..n_nodes {
                let (linear, angular) = multipliers.at(self.motion, k, node);
                let (arriving_linear, arriving) =
                    multipliers.arriving(self.motion, (k + 1).min(n_steps), node);
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
        let rod = self.motion.rod;
        let (motion, stretch) = (self.motion, self.stretch);
        let solved = self.workspace.solve.is_some();
        let n_drifts = |k: usize| if k < *stretch.end() { rod.n_nodes() } else { 0 };
        for (step, k) in self.steps.iter_mut().zip(self.first..) {
            let kick = kick(motion, stretch, k);
            step.decay = kick.decay;
            step.weight = kick.weight;
            step.loads = pack_loads(
                &load_derivatives(self.motion, self.trajectory, k),
                kick.weight,
            );
            step.acting = pack_acting(
                &acting_derivatives(self.motion, self.trajectory, k),
                kick.weight,
            );
            step.first_free_node = rod.first_free_node();
            step.element_drifts.clear();
            if solved {
                step.drifts.clear();
            } else {
                step.solve.clear();
                step.drifts.resize(n_drifts(k), PackedDrift::default());
            }
            step.elements.resize(rod.n_elements(), [[0.0; 9]; 9]);
            if self.multipliers.is_some() {
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
    fn drifts<S: Simd>(&mut self, simd: S) -> Lanes<S> {
        let Motion { rod, grid, .. } = *self.motion;
        let Workspace {
            poses, next, out, ..
        } = &mut *self.workspace;
        let (poses, next) = (rows::<S>(poses), rows::<S>(next));
        let (zero, one) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0));
        let mut irregular = zero;
        for (node, inertia) in rod.nodes.iter().enumerate() {
            let before = NodePose::<S>::load(simd, &poses[node * POSE_ROWS..]).rotation;
            let after = NodePose::<S>::load(simd, &next[node * POSE_ROWS..]).rotation;
            let drift = drift(&inertia.rotary, grid.step, before, after);
            // Also where it is no number.
            irregular = irregular
                + drift.level.select_below(1.0 - ROUNDING, zero, one)
                + (-drift.margin).select_below(-2.0 - ROUNDING, zero, one);
            store(out, 0, drift.turn_transposed);
            store(out, 9, drift.theta);
            store(out, 18, drift.momentum);
            let mobility = grid.step / inertia.mass;
            for (lane, step) in self.steps.iter_mut().enumerate() {
                if let Some(packed) = step.drifts.get_mut(node) {
                    packed.mobility = mobility;
                    packed.turn_transposed = matrix::<S>(out, 0, lane);
                    packed.theta = matrix::<S>(out, 9, lane);
                    packed.momentum = matrix::<S>(out, 18, lane);
                }
            }
        }
        if self.multipliers.is_some() {
            for node in 0..rod.n_nodes() {
                self.inertia_curvatures(simd, node);
            }
        }
        irregular
    }

    /// Curvatures of the inertia of a node over the intervals.
    #[inline(always)]
    pub fn inertia_curvatures<S: Simd>(&mut self, simd: S, node: usize) {
        let Workspace {
            poses,
            next,
            multipliers,
            out,
            intervals,
            ..
        } = &mut *self.workspace;
        let [before, after] = [&*poses, &*next]
            .map(|poses| NodePose::<S>::load(simd, &rows::<S>(poses)[node * POSE_ROWS..]).rotation);
        let multipliers = &rows::<S>(multipliers)[node * MULTIPLIER_ROWS..];
        let (leaving, arriving) = (
            Vec3::load(simd, multipliers, 6),
            Vec3::load(simd, multipliers, 9),
        );
        let rotary = &self.motion.rod.nodes[node].rotary;
        let turn = before.transposed_product(after);
        let h = self.motion.grid.step;
        let [own, mixed, far] = inertia_curvature([rotary; 2], h, turn, leaving, arriving);
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

    /// Counts what is irregular, lane by lane.
    #[inline(always)]
    fn elements<S: Simd, R: TangentRule>(&mut self, simd: S) -> Lanes<S> {
        let Workspace {
            poses,
            multipliers,
            weights,
            out,
            ..
        } = &mut *self.workspace;
        let poses = rows::<S>(poses);
        let multipliers = rows::<S>(multipliers);
        let weight = Lanes {
            simd,
            value: rows::<S>(weights)[0],
        };
        let (zero, one) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0));
        let mut irregular = zero;
        let curved = self.multipliers.is_some();
        let mut found = [[[Mat3::zero(simd); 3]; 3]; 3];
        for (q, element) in self.motion.rod.elements.iter().enumerate() {
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
                *found = R::stiffness(element, dx, a, b);
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

/// Margin of a limit for rounding.
pub(super) const ROUNDING: f64 = 1e-12;

/// Nine rows from row `at` on.
#[inline(always)]
pub(super) fn store<S: Simd>(out: &mut [f64], at: usize, m: Mat3<S>) {
    let out: &mut [Row<S>] = S::as_mut_simd_f64s(out).0;
    for (i, row) in m.rows.into_iter().enumerate() {
        row.store(out, at + 3 * i);
    }
}

/// Block `(i, j)` of a 9×9 matrix in 81 rows.
#[inline(always)]
pub(super) fn store_block<S: Simd>(out: &mut [f64], i: usize, j: usize, m: Mat3<S>) {
    let out: &mut [Row<S>] = S::as_mut_simd_f64s(out).0;
    for (row, values) in m.rows.into_iter().enumerate() {
        values.store(out, 9 * (3 * i + row) + 3 * j);
    }
}

/// One lane of nine rows.
#[inline(always)]
pub(super) fn matrix<S: Simd>(out: &[f64], at: usize, lane: usize) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| out[(at + 3 * i + j) * S::F64_LANES + lane]))
}

/// One lane of 81 rows.
#[inline(always)]
pub(super) fn scatter<S: Simd>(out: &[f64], lane: usize, target: &mut [[f64; 9]; 9]) {
    let rows = out.chunks_exact(S::F64_LANES);
    for (target, row) in target.as_flattened_mut().iter_mut().zip(rows) {
        *target = row[lane];
    }
}

#[cfg(test)]
mod tests;
