//! Time nodes of steps that are solved for, one in each lane: the part of their linearization that a stress of the intervals changes.
//!
//! At a time node the elastic stress and those of the intervals before and after act on the same strains, so that one stiffness under
//! their weighted sum is that of all three. With the weights `γ` and `β` of an interval, whose sum is `e = 0` explicit and `e = 1`
//! implicit, the stresses of the intervals after and before are those of the strains
//!
//! ```text
//! γ (s^k - s_rest) + β (s^{k+1} - s_rest) = e (s^k - s_rest) + β (s^{k+1} - s^k)
//! γ (s^{k-1} - s_rest) + β (s^k - s_rest) = e (s^k - s_rest) - γ (s^k - s^{k-1})
//! ```
//!
//! and the weights of both impulses add up to that of the kick: either scheme has the elastic stress of the time node with the kick's
//! weight, and the changes of the strain with `β` and `-γ`. How the stress of the interval after it answers to the interval's end, `X`, is
//! the only other matrix of an element; see [`SolvedDrift`](crate::SolvedDrift).

use pulp::Simd;

use super::{Group, Reach, matrix, scatter, store, store_block};
use crate::active::{ActiveTimes, times};
use crate::linearization::{Kick, Motion};
use crate::step::LinearizedStep;
use crate::tangent::{LEAST_MARGIN, NodePose, POSE_ROWS, Spin, spin};
use cosserat::block_tridiagonal::{Square, invert, multiply, negate};
use cosserat::buffer::Buffer;
use cosserat::element::{ActiveTangent, Blocks, Elasticity, Stress, TangentRule, stiffness_under};
use cosserat::ends::Joint;
use cosserat::implicit::IntervalWeights;
use cosserat::rod::Rod;
use cosserat::time::TimeScheme;
use cosserat::vector::{Lanes, Mat3, Row, Vec3, rows};

/// Rows of a node: `Fᵀ` and `Θ⁻¹`.
const SPIN_ROWS: usize = 18;
/// Rows of an element: `X`.
const COUPLING_ROWS: usize = 81;
/// Factors on the elastic stress, and on those of the intervals after and before the time node, s.
const WEIGHT_ROWS: usize = 3;

/// Additional data of the time nodes of steps that are solved for.
#[derive(Debug)]
pub(crate) struct SolveRows {
    spins: Buffer,
    couplings: Buffer,
    weights: Buffer,
    /// Weights of the strains at both ends of an interval in its stress.
    rates: IntervalWeights,
    /// Momenta that arrive at the end of an interval, divided by those that leave at its start, by the same stress.
    ratio: f64,
    /// This quotient for a stress on which both strains have the same weight.
    even_ratio: f64,
}

impl SolveRows {
    /// Returns the data if stresses depend on both ends of an interval; `None` otherwise.
    pub fn of(motion: &Motion, n_lanes: usize) -> Option<Self> {
        let weights = IntervalWeights::of(motion.rod, motion.grid.step)?;
        let (n_nodes, n_elements) = (motion.rod.n_nodes(), motion.rod.n_elements());
        let mut out = Self {
            spins: Buffer::zeros(n_nodes * SPIN_ROWS * n_lanes),
            couplings: Buffer::zeros(n_elements * COUPLING_ROWS * n_lanes),
            weights: Buffer::zeros(WEIGHT_ROWS * n_lanes),
            rates: weights,
            ratio: 0.0,
            even_ratio: 0.0,
        };
        out.retune(motion);
        Some(out)
    }

    /// Adapts the weights to the damping and to the step of a motion, which may be others than those of the motion before.
    pub fn retune(&mut self, motion: &Motion) {
        let Some(weights) = IntervalWeights::of(motion.rod, motion.grid.step) else {
            return;
        };
        self.rates = weights;
        self.even_ratio = motion.arriving_impulse() / motion.kick(0).impulse;
        self.ratio = weights.start / weights.end * self.even_ratio;
    }
}

impl SolveRows {
    /// Returns the momenta that arrive at the end of an interval, divided by those that leave at its start: by the elastic and viscous
    /// stress, and by that of actuators.
    fn ratios(&self) -> [f64; 2] {
        [self.ratio, self.even_ratio]
    }

    /// Weights of a time node, to one lane: of the intervals after and before it where there are any.
    pub fn put_weights(
        &mut self,
        motion: &Motion,
        (lane, n_lanes): (usize, usize),
        kick: &Kick,
        ends: [bool; 2],
    ) {
        let weights = motion.stress_weights(kick, ends);
        for (row, weight) in weights.into_iter().enumerate() {
            self.weights[row * n_lanes + lane] = weight;
        }
    }

    #[inline(always)]
    pub fn weights<S: Simd>(&self, simd: S) -> Weights<S> {
        let [elastic, leaving, arriving] = std::array::from_fn(|row| Lanes {
            simd,
            value: rows::<S>(&self.weights)[row],
        });
        Weights {
            elastic,
            after: leaving * self.rates.end,
            past: arriving * -self.rates.start,
            impulses: [leaving, arriving],
        }
    }
}

/// Weights of the elastic stress, and of those that the change of the strain until the next time node and since the last one makes, s.
#[derive(Clone, Copy)]
pub(crate) struct Weights<S: Simd> {
    pub elastic: Lanes<S>,
    pub after: Lanes<S>,
    pub past: Lanes<S>,
    /// Weights of the stresses of the intervals after and before the time node, s.
    pub impulses: [Lanes<S>; 2],
}

impl<S: Simd> Weights<S> {
    /// The strain whose stress is the impulse at a time node, from the poses of an element at that, the next and the last time node.
    #[inline(always)]
    pub fn strain<R: TangentRule>(
        &self,
        law: &Elasticity<S>,
        here: &R::Pose<S>,
        there: &R::Pose<S>,
        last: &R::Pose<S>,
    ) -> Stress<S> {
        let strain = R::strain(here);
        self.weighted::<R>(strain.minus(law.rest), strain, [there, last])
    }

    /// Returns the part of [`Self::strain`] that does not depend on the strain at rest.
    #[inline(always)]
    pub fn elongation<R: TangentRule>(&self, [here, there, last]: [&R::Pose<S>; 3]) -> Stress<S> {
        let strain = R::strain(here);
        self.weighted::<R>(strain, strain, [there, last])
    }

    #[inline(always)]
    fn weighted<R: TangentRule>(
        &self,
        elastic: Stress<S>,
        strain: Stress<S>,
        [there, last]: [&R::Pose<S>; 2],
    ) -> Stress<S> {
        (elastic.times(self.elastic))
            .plus(R::strain(there).minus(strain).times(self.after))
            .plus(strain.minus(R::strain(last)).times(self.past))
    }

    /// Returns the stress of the actuators in element `q`, times the weight of its impulse at a time node, from the poses there, at the next
    /// and at the last time node: that at the time node itself, or under the implicit scheme those at the mean strains of the intervals.
    #[inline(always)]
    pub fn active<R: TangentRule>(
        &self,
        active: &ActiveTimes,
        rod: &Rod,
        q: usize,
        poses: [&R::Pose<S>; 3],
    ) -> Stress<S> {
        let length = rod.elements[q].length;
        let efforts = active.part::<S>(&rod.actuators, 0);
        let here = R::strain(poses[0]);
        if rod.scheme == TimeScheme::Explicit {
            return efforts.stress::<R>(q, length, &here).times(self.elastic);
        }
        let [after, before] = self.means::<R>(here, poses);
        let past = active.part::<S>(&rod.actuators, 1);
        (efforts
            .stress::<R>(q, length, &after)
            .times(self.impulses[0]))
        .plus(past.stress::<R>(q, length, &before).times(self.impulses[1]))
    }

    /// Returns the mean strains of the intervals after and before the time node.
    #[inline(always)]
    pub fn means<R: TangentRule>(
        &self,
        here: Stress<S>,
        poses: [&R::Pose<S>; 3],
    ) -> [Stress<S>; 2] {
        let half = Lanes::splat(self.elastic.simd, 0.5);
        [
            here.plus(R::strain(poses[1])).times(half),
            here.plus(R::strain(poses[2])).times(half),
        ]
    }

    /// Adds [`Self::active`] to a stress, and returns its derivatives along the strain at the time node and along that at the next one.
    #[inline(always)]
    pub fn add_active<R: TangentRule>(
        &self,
        active: &ActiveTimes,
        rod: &Rod,
        q: usize,
        poses: [&R::Pose<S>; 3],
        stress: &mut Stress<S>,
    ) -> [ActiveTangent<S>; 2] {
        let length = rod.elements[q].length;
        let mut after = ActiveTangent::zero(self.elastic.simd);
        let efforts = active.part::<S>(&rod.actuators, 0);
        let here = R::strain(poses[0]);
        if rod.scheme == TimeScheme::Explicit {
            let mut own = after;
            let sums = (stress, &mut own);
            efforts.add_derivatives::<R>(q, length, &here, self.elastic, sums);
            return [own, after];
        }
        let [there, before] = self.means::<R>(here, poses);
        let past = active.part::<S>(&rod.actuators, 1);
        let sums = (&mut *stress, &mut after);
        efforts.add_derivatives::<R>(q, length, &there, self.impulses[0], sums);
        let mut own = after;
        let sums = (stress, &mut own);
        past.add_derivatives::<R>(q, length, &before, self.impulses[1], sums);
        // The weight of a strain in a mean is one half.
        [own.times(0.5), after.times(0.5)]
    }

    /// Returns the derivative of that strain along the strain here.
    #[inline(always)]
    pub fn scale(&self) -> Lanes<S> {
        self.elastic + (self.past - self.after)
    }
}

impl Group<'_> {
    /// Weights and memory of the time nodes.
    pub(super) fn prepare_solve(&mut self, n_lanes: usize) {
        let n_nodes = self.along.motion.rod.n_nodes();
        let n_elements = self.along.motion.rod.n_elements();
        let n_free = n_nodes - self.along.motion.rod.first_free_node();
        if let Some(solve) = &mut self.workspace.solve {
            solve.retune(self.along.motion);
        }
        for lane in 0..n_lanes {
            let k = self.time_node(lane);
            let kick = self.kick(k);
            let ends = [self.leaves(k), self.arrives(k)];
            if let Some(solve) = &mut self.workspace.solve {
                solve.put_weights(self.along.motion, (lane, n_lanes), &kick, ends);
            }
        }
        let ratio = self.workspace.solve.as_ref().map_or(0.0, |s| s.ratio);
        let is_uneven = (self.workspace.solve.as_ref()).is_some_and(|s| s.ratio != s.even_ratio);
        let rod = self.along.motion.rod;
        let is_active = !rod.actuators.is_empty() && rod.scheme == TimeScheme::Implicit;
        let n_arriving = if is_uneven && is_active {
            n_elements
        } else {
            0
        };
        for i in 0..self.steps.len() {
            let leaves = self.leaves(self.first + i);
            let step = &mut self.steps[i].solve;
            step.ratio = if leaves { ratio } else { 0.0 };
            let n = |n: usize| if leaves { n } else { 0 };
            step.coupling.resize(n(n_elements), [[0.0; 9]; 9]);
            step.arriving.resize(n(n_arriving), [[0.0; 9]; 9]);
            step.nodes.resize_with(n(n_nodes), Default::default);
            step.pivots.resize(n(n_free), [[0.0; 6]; 6]);
            step.below.resize(n(n_free - 1), [[0.0; 6]; 6]);
            step.above.resize(n(n_free - 1), [[0.0; 6]; 6]);
        }
    }

    /// Spins of the nodes; counts what is irregular, lane by lane.
    #[inline(always)]
    pub(super) fn spins<S: Simd, P: Reach<S>>(&mut self, simd: S) -> Lanes<S> {
        let (zero, one) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0));
        let mut irregular = zero;
        let h = self.along.motion.grid.step;
        let workspace = &mut *self.workspace;
        let Some(solve) = &mut workspace.solve else {
            return irregular;
        };
        let (poses, next) = (rows::<S>(&workspace.poses), rows::<S>(&workspace.next));
        for (q, node) in self.along.motion.rod.nodes.iter().enumerate() {
            let before = NodePose::<S>::load(simd, &poses[q * POSE_ROWS..]).rotation;
            let after = NodePose::<S>::load(simd, &next[q * POSE_ROWS..]).rotation;
            let Spin {
                turn_transposed,
                inertia,
                arriving,
                level,
                margin,
            } = spin(&node.rotary, h, before, after);
            irregular = irregular
                + level.select_below(1.0 - P::MARGIN, zero, one)
                + (-margin).select_below(-2.0 - P::MARGIN, zero, one);
            store::<S>(&mut solve.spins, q * SPIN_ROWS, turn_transposed);
            store::<S>(&mut solve.spins, q * SPIN_ROWS + 9, inertia);
            store::<S>(&mut workspace.out, 0, arriving);
            let mass_rate = node.mass / h;
            for (lane, step) in self.steps.iter_mut().enumerate() {
                if let Some(packed) = step.solve.nodes.get_mut(q) {
                    packed.mass_rate = mass_rate;
                    packed.turn_transposed = matrix::<S>(&solve.spins, q * SPIN_ROWS, lane);
                    packed.spin = matrix::<S>(&workspace.out, 0, lane);
                }
            }
        }
        irregular
    }

    /// Stiffnesses and couplings of the elements; counts what is irregular.
    #[inline(always)]
    pub(super) fn solved_elements<S: Simd, R: TangentRule, P: Reach<S>>(
        &mut self,
        simd: S,
    ) -> Lanes<S> {
        let mut irregular = Lanes::splat(simd, 0.0);
        let workspace = &mut *self.workspace;
        let Some(solve) = &mut workspace.solve else {
            return irregular;
        };
        let (poses, next) = (rows::<S>(&workspace.poses), rows::<S>(&workspace.next));
        let before = rows::<S>(&workspace.before);
        let weights = solve.weights(simd);
        let rod = self.along.motion.rod;
        let active = workspace.active.as_ref();
        let ratios = solve.ratios();
        for (q, element) in rod.elements.iter().enumerate() {
            let (here, folded_here) = element_at::<S, R, P>(simd, poses, q);
            let (there, folded_there) = element_at::<S, R, P>(simd, next, q);
            let (last, folded_last) = element_at::<S, R, P>(simd, before, q);
            irregular = irregular + folded_here + folded_there + folded_last;
            let law = Elasticity::of::<R>(simd, element);
            let strain = weights.strain::<R>(&law, &here, &there, &last);
            let scaled = law.times(weights.scale());
            let mut stress = law.stress(strain);
            let mut tangents = None;
            if let Some(active) = active {
                let poses = [&here, &there, &last];
                let mut own = Stress::zero(simd);
                tangents = Some(weights.add_active::<R>(active, rod, q, poses, &mut own));
                stress = stress.plus(own);
            }
            let mut kicked = stiffness_under::<S, R>(&scaled, &here, &stress);
            let mut coupling = R::coupling(&law.times(weights.after), &here, &there);
            let mut arriving = None;
            if let Some([own, after]) = &tangents {
                let derivative = R::derivative(&here);
                own.add_between::<R>(&derivative, &derivative, &mut kicked);
                if rod.scheme == TimeScheme::Implicit {
                    let there = R::derivative(&there);
                    if ratios[0] != ratios[1] {
                        let mut total = times(coupling, ratios[0]);
                        let after = after.times(ratios[1]);
                        after.add_between::<R>(&derivative, &there, &mut total);
                        arriving = Some(total);
                    }
                    after.add_between::<R>(&derivative, &there, &mut coupling);
                }
            }
            // What the step carries to its end.
            let turned = rows::<S>(&solve.spins);
            let carry = [
                Mat3::load(simd, turned, q * SPIN_ROWS),
                Mat3::load(simd, turned, (q + 1) * SPIN_ROWS),
            ];
            for (kicked, coupling) in kicked.iter_mut().zip(&coupling) {
                kicked[0] = kicked[0] + coupling[0];
                kicked[1] = kicked[1] + coupling[1].product(carry[0]);
                kicked[2] = kicked[2] + coupling[2].product(carry[1]);
            }
            store_blocks(&mut workspace.out, &kicked);
            for (lane, step) in self.steps.iter_mut().enumerate() {
                scatter::<S>(&workspace.out, lane, &mut step.elements[q]);
            }
            let target = &mut solve.couplings[q * COUPLING_ROWS * S::F64_LANES..];
            store_blocks(target, &coupling);
            let target = &target[..COUPLING_ROWS * S::F64_LANES];
            for (lane, step) in self.steps.iter_mut().enumerate() {
                if let Some(packed) = step.solve.coupling.get_mut(q) {
                    scatter::<S>(target, lane, packed);
                }
            }
            if let Some(arriving) = arriving {
                store_blocks(&mut workspace.out, &arriving);
                for (lane, step) in self.steps.iter_mut().enumerate() {
                    if let Some(packed) = step.solve.arriving.get_mut(q) {
                        scatter::<S>(&workspace.out, lane, packed);
                    }
                }
            }
        }
        irregular
    }

    /// Factors of what is solved for, by the recursion of
    /// [`BlockTridiagonal::factor`](cosserat::block_tridiagonal::BlockTridiagonal::factor); counts lanes where a pivot is
    /// singular.
    #[inline(always)]
    pub(super) fn factors<S: Simd>(&mut self, simd: S) -> Lanes<S> {
        let (zero, one) = (Lanes::splat(simd, 0.0), Lanes::splat(simd, 1.0));
        let workspace = &mut *self.workspace;
        let Some(solve) = &mut workspace.solve else {
            return zero;
        };
        let rod = self.along.motion.rod;
        let h = self.along.motion.grid.step;
        let first = rod.first_free_node();
        let (spins, couplings) = (rows::<S>(&solve.spins), rows::<S>(&solve.couplings));
        let none = Mat3::zero(simd);
        let mut fill = [[none; 2]; 2];
        let mut sum = zero;
        for (q, node) in rod.nodes.iter().enumerate().skip(first) {
            let mut pivot = fill;
            negate(&mut pivot);
            pivot[0][0] = pivot[0][0] + Mat3::multiple(Lanes::splat(simd, node.mass / h));
            pivot[1][1] = pivot[1][1] + Mat3::load(simd, spins, q * SPIN_ROWS + 9);
            if !rod.resistances.is_empty() {
                pivot[0][0] =
                    pivot[0][0] + taken_by_motion(simd, &mut workspace.out, self.steps, q);
            }
            if q > 0 {
                add_blocks(&mut pivot, couplings, q - 1, [1, 1]);
            }
            let i = q - first;
            let last = q == rod.n_elements();
            if !last {
                add_blocks(&mut pivot, couplings, q, [0, 0]);
            }
            let own = rod.joint(q).map(|joint| turning(simd, joint));
            if let Some(own) = own {
                pivot[1][1] = own.product(pivot[1][1]).product(own)
                    + (Mat3::multiple(Lanes::splat(simd, 1.0)) - own);
                pivot[0][0] = Mat3::multiple(Lanes::splat(simd, 1.0));
                (pivot[0][1], pivot[1][0]) = (none, none);
            }
            invert(&mut pivot);
            sum = sum + pivot[0][0].trace() + pivot[1][1].trace();
            store_square(&mut workspace.out, 0, &pivot);
            if !last {
                let mut beside = [[none; 2]; 2];
                add_blocks(&mut beside, couplings, q, [0, 1]);
                let next = rod.joint(q + 1).map(|joint| turning(simd, joint));
                hold_square(&mut beside, own, next);
                let mut above = beside;
                multiply(&pivot, &beside, &mut above);
                store_square(&mut workspace.out, 72, &above);
                let mut below = [[none; 2]; 2];
                add_blocks(&mut below, couplings, q, [1, 0]);
                hold_square(&mut below, next, own);
                store_square(&mut workspace.out, 36, &below);
                multiply(&below, &above, &mut fill);
            }
            for (lane, step) in self.steps.iter_mut().enumerate() {
                let out = &workspace.out;
                let packed = &mut step.solve;
                if let Some(pivot) = packed.pivots.get_mut(i) {
                    take_square::<S>(out, 0, lane, pivot);
                }
                if let (Some(below), Some(above)) =
                    (packed.below.get_mut(i), packed.above.get_mut(i))
                {
                    take_square::<S>(out, 36, lane, below);
                    take_square::<S>(out, 72, lane, above);
                }
            }
        }
        // Zero where it is a number.
        (sum * 0.0).select_below(1.0, zero, one)
    }
}

/// Momentum that resistance takes from node `q` per motion, of all time nodes.
#[inline(always)]
fn taken_by_motion<S: Simd>(
    simd: S,
    memory: &mut [f64],
    steps: &[LinearizedStep],
    q: usize,
) -> Mat3<S> {
    for lane in 0..S::F64_LANES {
        let step = &steps[lane.min(steps.len() - 1)];
        let own = step
            .resisted
            .get(q)
            .map_or([[0.0; 3]; 3], |own| own.leaving);
        for (row, value) in own.as_flattened().iter().enumerate() {
            memory[row * S::F64_LANES + lane] = *value;
        }
    }
    Mat3::load(simd, rows::<S>(memory), 0)
}

/// The pose of element `q`, and one where its ends are farther apart than the reach, or no numbers.
#[inline(always)]
pub(crate) fn element_at<S: Simd, R: TangentRule, P: Reach<S>>(
    simd: S,
    poses: &[Row<S>],
    q: usize,
) -> (R::Pose<S>, Lanes<S>) {
    let a = NodePose::load(simd, &poses[q * POSE_ROWS..]);
    let b = NodePose::load(simd, &poses[(q + 1) * POSE_ROWS..]);
    let pose = P::pose::<R>(b.position - a.position, a.rotation, b.rotation);
    let zero = Lanes::splat(simd, 0.0);
    if P::ALL {
        return (pose, zero);
    }
    let margin = a.rotation.transposed_product(b.rotation).trace() + 1.0;
    let is_folded = (-margin).select_below(-LEAST_MARGIN, zero, Lanes::splat(simd, 1.0));
    (pose, is_folded)
}

#[inline(always)]
fn store_blocks<S: Simd>(out: &mut [f64], blocks: &Blocks<S>) {
    for (i, row) in blocks.iter().enumerate() {
        for (j, block) in row.iter().enumerate() {
            store_block(out, i, j, *block);
        }
    }
}

/// Adds to a matrix over motion and rotation of a node what `X` of element `q` has for the given ends, rows and columns: node a moves the
/// chord by `-δx`, node b by `δx`.
#[inline(always)]
fn add_blocks<S: Simd>(
    target: &mut Square<S>,
    couplings: &[Row<S>],
    q: usize,
    [row_end, column_end]: [usize; 2],
) {
    let simd = target[0][0].rows[0].x.simd;
    let rows = &couplings[q * COUPLING_ROWS..][..COUPLING_ROWS];
    for (i, from_row) in [0, 3 + 3 * row_end].into_iter().enumerate() {
        for (j, from_column) in [0, 3 + 3 * column_end].into_iter().enumerate() {
            let negative = (i == 0 && row_end == 0) != (j == 0 && column_end == 0);
            for axis in 0..3 {
                let values = Vec3::load(simd, rows, 9 * (from_row + axis) + from_column);
                let sum = &mut target[i][j].rows[axis];
                *sum = if negative {
                    *sum - values
                } else {
                    *sum + values
                };
            }
        }
    }
}

/// Returns the projection onto the free rotations of a joint.
#[inline(always)]
fn turning<S: Simd>(simd: S, joint: &Joint) -> Mat3<S> {
    let mut out = Mat3::zero(simd);
    for (i, row) in out.rows.iter_mut().enumerate() {
        *row = Vec3::splat(simd, &joint.turning.row(i).transpose());
    }
    out
}

/// Takes away the held motions of joints at the nodes of the rows and of the columns, whose free rotations are given.
#[inline(always)]
fn hold_square<S: Simd>(m: &mut Square<S>, rows: Option<Mat3<S>>, columns: Option<Mat3<S>>) {
    let none = Mat3::zero(m[0][0].rows[0].x.simd);
    if let Some(free) = rows {
        m[0] = [none; 2];
        m[1] = [free.product(m[1][0]), free.product(m[1][1])];
    }
    if let Some(free) = columns {
        for row in m.iter_mut() {
            *row = [none, row[1].product(free)];
        }
    }
}

/// 36 rows, row by row, from row `at` on.
#[inline(always)]
fn store_square<S: Simd>(out: &mut [f64], at: usize, m: &Square<S>) {
    let out: &mut [Row<S>] = S::as_mut_simd_f64s(out).0;
    for (i, blocks) in m.iter().enumerate() {
        for (j, block) in blocks.iter().enumerate() {
            for (row, values) in block.rows.iter().enumerate() {
                values.store(out, at + 6 * (3 * i + row) + 3 * j);
            }
        }
    }
}

/// One lane of 36 rows.
#[inline(always)]
fn take_square<S: Simd>(out: &[f64], at: usize, lane: usize, target: &mut [[f64; 6]; 6]) {
    let rows = out[at * S::F64_LANES..].chunks_exact(S::F64_LANES);
    for (target, row) in target.as_flattened_mut().iter_mut().zip(rows) {
        *target = row[lane];
    }
}
