//! Actuators on the strains, at several time nodes at a time: what their stress adds to the elements of the linearized motion.

use std::marker::PhantomData;
use std::ops::Range;

use pulp::{Simd, WithSimd};

use super::along::Along;
use super::step::WinchKick;
use super::winches::WinchDrift;
use crate::curved::{CurvedEnd, StressBlocks};
use crate::linearization::Motion;
use crate::tangent::{NodePose, POSE_ROWS, put_pose};
use cosserat::buffer::Buffer;
use cosserat::configuration::Trajectory;
use cosserat::element::{
    ActivePoint, ActiveTangent, Blocks, Displacement, Elasticity, Element, Helical, StrainRule,
    Stress, TangentRule, Trapezoidal, Turns, stiffness_under,
};
use cosserat::forces::{IntervalMemory, SlopeMemory};
use cosserat::instructions::{CountLanes, dispatch, instructions};
use cosserat::load::Wrench;
use cosserat::part::{Part, apart};
use cosserat::rod::Rod;
use cosserat::signal::{ControlSignal, Efforts, write_interval_efforts, write_node_efforts};
use cosserat::strain_actuator::{EffortState, RodActuators};
use cosserat::time::TimeScheme;
use cosserat::vector::{Lanes, Mat3, Row, Vec3, rows};

/// Efforts of a group of time nodes of a motion, one time node in each lane.
#[derive(Debug)]
pub(super) struct ActiveTimes {
    n_actuators: usize,
    /// Number of efforts, with those of lines.
    n_efforts: usize,
    /// Inputs of the time nodes, lane by lane: efforts, or the displacements of winches.
    inputs: Vec<f64>,
    /// Mean inputs of the intervals after them.
    interval_inputs: Vec<f64>,
    /// The interval whose efforts the last lane has.
    last: Option<usize>,
    /// Inputs, then efforts of an interval.
    interval: [Vec<f64>; 2],
    /// Efforts of the time nodes, or of the intervals after them and then of those before them.
    lanes: Buffer,
    intervals: bool,
    /// Memory for the efforts of winches.
    efforts: Vec<f64>,
    state: EffortState,
    slopes: SlopeMemory,
    pulls: IntervalMemory,
}

impl ActiveTimes {
    /// Returns memory for the efforts along motions of a rod; `None` if it has no actuators.
    pub fn of(motion: &Motion, n_lanes: usize) -> Option<Self> {
        let actuators = &motion.rod.actuators;
        if actuators.is_empty() {
            return None;
        }
        let intervals = motion.rod.scheme == TimeScheme::Implicit;
        let n_rows = actuators.n_efforts() * if intervals { 2 } else { 1 };
        Some(Self {
            n_actuators: actuators.len(),
            n_efforts: actuators.n_efforts(),
            inputs: vec![0.0; actuators.len() * n_lanes],
            interval_inputs: vec![0.0; actuators.len() * n_lanes],
            last: None,
            interval: [actuators.len(), actuators.n_efforts()].map(|n| vec![0.0; n]),
            lanes: Buffer::zeros(n_rows * n_lanes),
            intervals,
            efforts: vec![0.0; actuators.len()],
            state: actuators.effort_state(),
            slopes: SlopeMemory::of(motion.rod),
            pulls: IntervalMemory::of(motion.rod),
        })
    }

    /// Returns the inputs at the time node of a lane.
    pub fn inputs(&self, lane: usize) -> &[f64] {
        &self.inputs[lane * self.n_actuators..][..self.n_actuators]
    }

    /// Writes the efforts of time node `k` of a trajectory under a control to one lane. Before the first and after the last interval of the
    /// grid there is none. The tensions of winches are those at the configuration of the time node, or at the mean strains of the interval.
    /// The lanes are written in order.
    pub fn put(
        &mut self,
        (motion, control, trajectory): (&Motion, Option<&ControlSignal>, &Trajectory),
        k: usize,
        (lane, n_lanes): (usize, usize),
    ) {
        let n = self.n_actuators;
        let Motion { rod, grid, .. } = motion;
        let inputs = &mut self.inputs[lane * n..][..n];
        write_node_efforts(&rod.actuators, grid, control, k, inputs);
        if self.intervals {
            let before = k.checked_sub(1);
            if lane > 0 && before.is_some() && before == self.last {
                // It is that after the time node of the lane before.
                for line in 0..self.n_efforts {
                    self.lanes[(self.n_efforts + line) * n_lanes + lane] =
                        self.lanes[line * n_lanes + lane - 1];
                }
            } else {
                self.put_interval((motion, control, trajectory), before, (1, lane, n_lanes));
            }
            self.put_interval((motion, control, trajectory), Some(k), (0, lane, n_lanes));
            self.last = Some(k);
            return;
        }
        if rod.actuators.follow_shape() {
            let efforts = &mut self.efforts;
            efforts.copy_from_slice(inputs);
            rod.turn_into_efforts(efforts, trajectory.poses_at(k), &mut self.state);
            for (actuator, &effort) in efforts.iter().enumerate() {
                self.lanes[actuator * n_lanes + lane] = effort;
            }
            return;
        }
        for (actuator, effort) in inputs.iter().enumerate() {
            self.lanes[actuator * n_lanes + lane] = *effort;
        }
    }

    /// Writes the efforts of the interval from time node `k` on to a part of one lane, and zeros where there is no such interval.
    fn put_interval(
        &mut self,
        (motion, control, trajectory): (&Motion, Option<&ControlSignal>, &Trajectory),
        k: Option<usize>,
        (part, lane, n_lanes): (usize, usize, usize),
    ) {
        let n = self.n_actuators;
        let Motion { rod, grid, .. } = motion;
        let [inputs, efforts] = &mut self.interval;
        efforts.fill(0.0);
        if let Some(k) = k.filter(|k| *k < grid.n_steps) {
            write_interval_efforts(&rod.actuators, grid, control, k, inputs);
            if part == 0 {
                self.interval_inputs[lane * n..][..n].copy_from_slice(inputs);
            }
            if rod.actuators.follow_shape() {
                let ends = [k, k + 1].map(|k| trajectory.poses_at(k));
                rod.write_interval_effort_state(ends, grid.step, &mut self.state);
                rod.actuators.write_lines(inputs, &self.state, efforts);
            } else {
                efforts.copy_from_slice(inputs);
            }
        }
        for (line, effort) in efforts.iter().enumerate() {
            self.lanes[(part * self.n_efforts + line) * n_lanes + lane] = *effort;
        }
    }

    /// Writes the laws and pulls of winches over the interval from time node `k` of a trajectory on, which is in a lane; nothing under the
    /// explicit scheme. The pulls of a slack tendon are zero.
    pub fn write_winch_drifts(
        &mut self,
        (motion, trajectory): (&Motion, &Trajectory),
        (k, lane): (usize, usize),
        out: &mut Vec<WinchDrift>,
    ) {
        let (rod, time) = (motion.rod, motion.grid.step);
        if !self.intervals {
            out.clear();
            return;
        }
        let inputs = &self.interval_inputs[lane * self.n_actuators..][..self.n_actuators];
        let ends = [k, k + 1].map(|k| trajectory.poses_at(k));
        let mut index = 0;
        let mut next = |renew: &mut dyn FnMut(&mut WinchDrift)| {
            if index == out.len() {
                out.push(WinchDrift::default());
            }
            renew(&mut out[index]);
            index += 1;
        };
        self.pulls
            .visit(rod, inputs, (ends, time), |actuator, law, pulls| {
                next(&mut |own| own.renew(rod, actuator, law, pulls));
            });
        for mut line in rod
            .line_changes(inputs, ends, Some(time))
            .into_iter()
            .map(Some)
        {
            next(&mut |own| {
                if let Some(line) = line.take() {
                    own.renew_line(rod, line);
                }
            });
        }
        out.truncate(index);
    }

    /// Writes the kicks of winches at time node `k` of a trajectory, which is in a lane; that of a slack tendon is none. Nothing under the
    /// implicit scheme.
    pub fn write_winch_kicks(
        &mut self,
        (rod, trajectory): (&Rod, &Trajectory),
        (k, lane): (usize, usize),
        weight: f64,
        out: &mut Vec<WinchKick>,
    ) {
        if self.intervals {
            out.clear();
            return;
        }
        let inputs = &self.inputs[lane * self.n_actuators..][..self.n_actuators];
        let at = (trajectory.positions_at(k), trajectory.rotations_at(k));
        let mut index = 0;
        (self.slopes).visit(rod, inputs, at, |actuator, slope, pull| {
            if index == out.len() {
                out.push(WinchKick::default());
            }
            out[index].renew(rod, actuator, weight * slope, pull);
            index += 1;
        });
        out.truncate(index);
    }

    /// Returns the efforts of the one time node of a group.
    pub fn single(&self) -> &[f64] {
        &self.lanes[..self.n_efforts]
    }

    /// Returns the efforts of the time nodes (`part` 0), or of the intervals after (0) and before (1) them.
    #[inline(always)]
    pub fn part<'a, S: Simd>(
        &'a self,
        actuators: &'a RodActuators,
        part: usize,
    ) -> ActiveEfforts<'a, S> {
        let n = self.n_efforts;
        ActiveEfforts {
            actuators,
            efforts: &rows::<S>(&self.lanes)[part * n..][..n],
        }
    }
}

/// The actuators of a rod with an effort in each lane.
#[derive(Clone, Copy)]
pub(super) struct ActiveEfforts<'a, S: Simd> {
    actuators: &'a RodActuators,
    efforts: &'a [Row<S>],
}

impl<S: Simd> ActiveEfforts<'_, S> {
    /// Returns the stress `-Σ u ∂y/∂(l v, ψ)` in element `q` at a strain times its length.
    #[inline(always)]
    pub fn stress<R: TangentRule>(&self, q: usize, length: f64, strain: &Stress<S>) -> Stress<S> {
        apart(
            strain.angular.x.simd,
            Stressed(self.at::<R>(q, length, *strain)),
        )
    }

    /// Adds `factor` times [`Self::stress`], and times its derivative along the strain.
    #[inline(always)]
    pub fn add_derivatives<R: TangentRule>(
        &self,
        q: usize,
        length: f64,
        strain: &Stress<S>,
        factor: Lanes<S>,
        (stress, tangent): (&mut Stress<S>, &mut ActiveTangent<S>),
    ) {
        let part = Derivatives {
            at: self.at::<R>(q, length, *strain),
            factor,
            stress,
            tangent,
        };
        apart(factor.simd, part);
    }

    #[inline(always)]
    pub fn effort(&self, simd: S, line: usize) -> Lanes<S> {
        Lanes {
            simd,
            value: self.efforts[line],
        }
    }

    #[inline(always)]
    fn at<R>(&self, q: usize, length: f64, strain: Stress<S>) -> At<'_, S, R> {
        At {
            efforts: *self,
            q,
            length,
            strain,
            rule: PhantomData,
        }
    }

    /// Returns the gradient `(F, M_a, M_b)` of `-Σ u y` of element `q` in a pose.
    #[inline(always)]
    pub fn gradient<R: TangentRule>(
        &self,
        q: usize,
        length: f64,
        pose: &R::Pose<S>,
    ) -> [Vec3<S>; 3] {
        R::pull(pose, &self.stress::<R>(q, length, &R::strain(pose)))
    }

    /// Returns the stiffness of element `q` with its actuators in a pose.
    #[inline(always)]
    pub fn stiffness<R: TangentRule>(
        &self,
        element: &Element,
        q: usize,
        dx: Vec3<S>,
        a: Mat3<S>,
        b: Mat3<S>,
    ) -> Blocks<S> {
        let simd = dx.x.simd;
        let law = Elasticity::of::<R>(simd, element);
        let pose = R::pose(dx, a, b);
        let strain = R::strain(&pose);
        let (mut active, mut tangent) = (Stress::zero(simd), ActiveTangent::zero(simd));
        let one = Lanes::splat(simd, 1.0);
        let sums = (&mut active, &mut tangent);
        self.add_derivatives::<R>(q, element.length, &strain, one, sums);
        let stress = law.stress(strain.minus(law.rest)).plus(active);
        let mut out = stiffness_under::<S, R>(&law, &pose, &stress);
        let derivative = R::derivative(&pose);
        tangent.add_between::<R>(&derivative, &derivative, &mut out);
        out
    }

    /// Returns the second derivatives of the effect of the stress at the mean strain of the interval on element `q`, for the weights of its
    /// impulses in the covectors of both ends.
    ///
    /// The impulses are the gradient of `Φ = -Σ u y((s_start + s_end)/2)` over both poses, so that this is the third derivative of `Φ` along
    /// the covectors: the difference of its second derivatives at poses that are moved along them, in the chart of
    /// [`Displacement::curvature`].
    #[inline(always)]
    pub fn curvature<R: TangentRule, P: Turns<S>>(
        &self,
        element: &Element,
        q: usize,
        ends: &[CurvedEnd<S>; 2],
    ) -> StressBlocks<S> {
        let part = Curvature::<S, R, P> {
            efforts: *self,
            element,
            q,
            ends,
            kind: PhantomData,
        };
        apart(ends[0].dx.x.simd, part)
    }
}

/// The arguments of [`ActiveEfforts::stress`] and [`ActiveEfforts::add_derivatives`].
struct At<'a, S: Simd, R> {
    efforts: ActiveEfforts<'a, S>,
    q: usize,
    length: f64,
    strain: Stress<S>,
    rule: PhantomData<R>,
}

struct Stressed<'a, S: Simd, R>(At<'a, S, R>);

impl<S: Simd, R: TangentRule> Part for Stressed<'_, S, R> {
    type Output = Stress<S>;

    #[inline(always)]
    fn run(self) -> Stress<S> {
        let At {
            efforts,
            q,
            length,
            strain,
            ..
        } = self.0;
        let simd = strain.angular.x.simd;
        let zero = Vec3::zero(simd);
        let mut sum = Stress {
            linear: [zero; 2],
            angular: zero,
        };
        for point in efforts.actuators.on(q) {
            let at = point.in_element(simd, length);
            let slopes = if R::ENDS == 1 {
                at.slopes::<1>(&point.density, strain.linear, strain.angular)
            } else {
                at.slopes::<2>(&point.density, strain.linear, strain.angular)
            };
            sum = sum.minus(slopes.times(efforts.effort(simd, point.line)));
        }
        sum
    }
}

struct Derivatives<'a, S: Simd, R> {
    at: At<'a, S, R>,
    factor: Lanes<S>,
    stress: &'a mut Stress<S>,
    tangent: &'a mut ActiveTangent<S>,
}

impl<S: Simd, R: TangentRule> Part for Derivatives<'_, S, R> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self {
            at:
                At {
                    efforts,
                    q,
                    length,
                    strain,
                    ..
                },
            factor,
            stress,
            tangent,
        } = self;
        let simd = factor.simd;
        let strain = (strain.linear, strain.angular);
        for point in efforts.actuators.on(q) {
            let at: ActivePoint<S> = point.in_element(simd, length);
            // The potential is minus the coordinate.
            let factor = -efforts.effort(simd, point.line) * factor;
            if R::ENDS == 1 {
                at.add_derivatives::<1>(&point.density, strain, factor, stress, tangent);
            } else {
                at.add_derivatives::<2>(&point.density, strain, factor, stress, tangent);
            }
        }
    }
}

/// The arguments of [`ActiveEfforts::curvature`].
struct Curvature<'a, S: Simd, R, P> {
    efforts: ActiveEfforts<'a, S>,
    element: &'a Element,
    q: usize,
    ends: &'a [CurvedEnd<S>; 2],
    kind: PhantomData<(R, P)>,
}

impl<S: Simd, R: TangentRule, P: Turns<S>> Part for Curvature<'_, S, R, P> {
    type Output = StressBlocks<S>;

    #[inline(always)]
    fn run(self) -> StressBlocks<S> {
        let Self {
            efforts,
            element,
            q,
            ends,
            ..
        } = self;
        let length = element.length;
        let simd = ends[0].dx.x.simd;
        let none = Elasticity::of::<R>(simd, element).times(Lanes::splat(simd, 0.0));
        let half = Lanes::splat(simd, 0.5);
        let both = Displacement::along_both(ends[0].covector, ends[1].covector, length);
        // Own at the start, mixed, own at the end; each here, ahead and behind.
        let mut found = [[[[Mat3::zero(simd); 3]; 3]; 3]; 3];
        for (at, sign) in [0.0, 1.0, -1.0].into_iter().enumerate() {
            let (dx, [a, b]) = both[0].moved(ends[0].dx, ends[0].rotations, sign);
            let start = P::pose::<R>(dx, a, b);
            let (dx, [a, b]) = both[1].moved(ends[1].dx, ends[1].rotations, sign);
            let end = P::pose::<R>(dx, a, b);
            let mean = R::strain(&start).plus(R::strain(&end)).times(half);
            let mut stress = Stress::zero(simd);
            let mut tangent = ActiveTangent::zero(simd);
            let sums = (&mut stress, &mut tangent);
            efforts.add_derivatives::<R>(q, length, &mean, half, sums);
            let [left, right] = [R::derivative(&start), R::derivative(&end)];
            // The weight of a strain in the mean is one half.
            let tangent = tangent.times(0.5);
            found[0][at] = stiffness_under::<S, R>(&none, &start, &stress);
            tangent.add_between::<R>(&left, &left, &mut found[0][at]);
            tangent.add_between::<R>(&left, &right, &mut found[1][at]);
            found[2][at] = stiffness_under::<S, R>(&none, &end, &stress);
            tangent.add_between::<R>(&right, &right, &mut found[2][at]);
        }
        // The covectors have the weights of the impulses, which are twice the derivative along one of both strains.
        StressBlocks {
            start: times(both[0].curvature(&found[0]), 2.0),
            cross: times(both[0].mixed_curvature(&both[1], &found[1]), 2.0),
            end: times(both[1].curvature(&found[2]), 2.0),
        }
    }
}

/// Returns the sum of two matrices.
#[inline(always)]
pub(super) fn sum<S: Simd>(a: Blocks<S>, b: Blocks<S>) -> Blocks<S> {
    let mut out = a;
    for (row, other) in out.iter_mut().zip(&b) {
        for (block, other) in row.iter_mut().zip(other) {
            *block = *block + *other;
        }
    }
    out
}

/// Returns a matrix times a number.
#[inline(always)]
pub fn times<S: Simd>(mut blocks: Blocks<S>, factor: f64) -> Blocks<S> {
    for block in blocks.as_flattened_mut() {
        *block = *block * factor;
    }
    blocks
}

/// Number of lanes of the widest vectors.
pub(super) const MOST_LANES: usize = 8;

/// Wrenches on the nodes under a unit effort of each of some actuators, and their derivatives along the configuration.
///
/// Under the explicit scheme there is one set for every time node. Under the implicit scheme there is one for each interval, with the
/// wrenches where it starts and those where it ends: the stress at the mean strain acts at both.
#[derive(Clone, Debug)]
pub struct EffortPulls {
    n_nodes: usize,
    n_actuators: usize,
    /// Number of sets of the present motion.
    n_sets: usize,
    /// First of the sets that are evaluated.
    first: usize,
    scheme: TimeScheme,
    /// Place of every actuator of the rod among those that are evaluated.
    index: Vec<Option<usize>>,
    /// Poses of all nodes at both ends of a set, and covectors there, with a set in each lane.
    poses: [Buffer; 2],
    covectors: Buffer,
    /// Shares of efforts in the lines of tendons with friction, with a set in each lane.
    shares: Buffer,
    state: EffortState,
    /// Six numbers of every node, for every set, end and actuator: force, spatial, and moment, body frame, per effort.
    wrenches: Vec<f64>,
    /// The derivative of the covectors' product with the wrenches, `(δx, ζ)` of every node, in the same order; empty without covectors.
    slopes: Vec<f64>,
}

/// Covector of the wrench on a node at one end of a set: of its force (spatial) and of its moment (body frame).
pub type Covectors<'a> = dyn Fn(usize, usize, usize) -> Wrench + 'a;

impl EffortPulls {
    /// Evaluates unit efforts of the given actuators along a trajectory. `covectors` gives those of `(set, end, node)`, if slopes are asked
    /// for.
    #[must_use]
    pub fn of(
        motion: &Motion,
        trajectory: &Trajectory,
        actuators: &[usize],
        covectors: Option<&Covectors>,
    ) -> Self {
        let n_sets = motion.n_sets();
        let mut out = Self::new(motion, n_sets, actuators, covectors.is_some());
        out.evaluate(motion, trajectory, 0..n_sets, covectors);
        out
    }

    /// Creates memory for so many sets of motions of this rod.
    fn new(motion: &Motion, n_sets: usize, actuators: &[usize], with_slopes: bool) -> Self {
        let rod = motion.rod;
        let ends = rod.scheme.n_ends();
        let mut index = vec![None; rod.actuators.len()];
        for (own, &actuator) in actuators.iter().enumerate() {
            index[actuator] = Some(own);
        }
        let n_lanes = dispatch(instructions(), CountLanes);
        let n_covectors = if with_slopes {
            ends * rod.n_nodes() * 6
        } else {
            0
        };
        let mut out = Self {
            n_nodes: rod.n_nodes(),
            n_actuators: actuators.len(),
            n_sets,
            first: 0,
            scheme: rod.scheme,
            index,
            poses: [0, 1].map(|_| Buffer::zeros(rod.n_nodes() * POSE_ROWS * n_lanes)),
            covectors: Buffer::zeros(n_covectors * n_lanes),
            shares: Buffer::zeros((rod.actuators.n_efforts() - rod.actuators.len()) * n_lanes),
            state: rod.actuators.effort_state(),
            wrenches: Vec::new(),
            slopes: Vec::new(),
        };
        let n = out.at(n_sets, 0, 0);
        out.wrenches = vec![0.0; n];
        out.slopes = vec![0.0; if with_slopes { n } else { 0 }];
        out
    }

    /// Creates memory for motions of this rod of at most this duration.
    #[must_use]
    pub fn along(motion: &Motion, actuators: &[usize]) -> Self {
        Self::new(motion, motion.n_sets(), actuators, false)
    }

    /// Evaluates the unit efforts along another motion of the same rod.
    pub fn evaluate_along(&mut self, motion: &Motion, trajectory: &Trajectory) {
        self.evaluate(motion, trajectory, 0..motion.n_sets(), None);
    }

    /// Evaluates the unit efforts in some sets of another motion of the same rod. `covectors` are given if the memory is to have slopes.
    fn evaluate(
        &mut self,
        motion: &Motion,
        trajectory: &Trajectory,
        sets: Range<usize>,
        covectors: Option<&Covectors>,
    ) {
        let rod = motion.rod;
        self.n_sets = motion.n_sets();
        self.first = sets.start;
        self.wrenches.fill(0.0);
        self.slopes.fill(0.0);
        let ends = self.scheme.n_ends();
        let arch = instructions();
        let n_lanes = dispatch(arch, CountLanes);
        let Self {
            index,
            poses,
            covectors: covector_rows,
            shares,
            state,
            wrenches,
            slopes,
            ..
        } = self;
        let n_actuators = self.n_actuators;
        for first in sets.clone().step_by(n_lanes) {
            for lane in 0..n_lanes {
                let set = (first + lane).min(sets.end - 1);
                if rod.actuators.has_friction() {
                    rod.write_effort_state_of_set(trajectory, (set, motion.grid.step), state);
                    for (extra, line) in
                        (rod.actuators.len()..rod.actuators.n_efforts()).enumerate()
                    {
                        shares[extra * n_lanes + lane] = rod.actuators.share(line, state);
                    }
                }
                for (end, poses) in poses.iter_mut().enumerate().take(ends) {
                    let x = trajectory.positions_at(set + end);
                    let r = trajectory.rotations_at(set + end);
                    for (node, rows) in poses.chunks_exact_mut(POSE_ROWS * n_lanes).enumerate() {
                        put_pose(rows, n_lanes, lane, &x[node], &r[node]);
                    }
                }
                if let Some(covectors) = covectors {
                    for end in 0..ends {
                        for node in 0..rod.n_nodes() {
                            let numbers = covectors(set, end, node).to_array();
                            for (row, number) in numbers.into_iter().enumerate() {
                                let at = (end * rod.n_nodes() + node) * 6 + row;
                                covector_rows[at * n_lanes + lane] = number;
                            }
                        }
                    }
                }
            }
            let work = PullGroup {
                rod,
                index,
                first: first - sets.start,
                n_sets: sets.end.min(first + n_lanes) - first,
                ends,
                n_actuators,
                poses,
                covectors: covectors.map(|_| &covector_rows[..]),
                shares,
                wrenches,
                slopes,
            };
            match rod.strain_rule {
                StrainRule::Helical => dispatch(arch, RuledPulls::<Helical>(work, PhantomData)),
                StrainRule::Trapezoidal => {
                    dispatch(arch, RuledPulls::<Trapezoidal>(work, PhantomData));
                }
            }
        }
    }

    fn at(&self, set: usize, end: usize, actuator: usize) -> usize {
        let set = set - self.first;
        ((set * self.scheme.n_ends() + end) * self.n_actuators + actuator) * self.n_nodes * 6
    }

    /// Returns the number of actuators whose unit efforts are evaluated.
    #[must_use]
    pub fn n_actuators(&self) -> usize {
        self.n_actuators
    }

    /// Returns the sets whose wrenches act at time node `k`, with the end at which they do, and the part that their mean effort has there.
    /// Under the implicit scheme these are the intervals beside it; the only one beside an end of the grid counts whole.
    pub fn sets_at(&self, k: usize) -> impl Iterator<Item = (usize, usize, f64)> + use<> {
        let n_sets = self.n_sets;
        let share = self.scheme.share(k, n_sets);
        let before = match self.scheme {
            TimeScheme::Explicit => None,
            TimeScheme::Implicit => k.checked_sub(1),
        };
        let at = (k < n_sets).then_some((k, 0, share));
        at.into_iter().chain(before.map(|set| (set, 1, share)))
    }

    /// Returns the six numbers of every node's wrench in a set, at one of its ends.
    #[must_use]
    pub fn wrenches(&self, set: usize, end: usize, actuator: usize) -> &[f64] {
        &self.wrenches[self.at(set, end, actuator)..][..self.n_nodes * 6]
    }

    /// Returns the slopes in the same way, `δx` and then `ζ` of every node.
    #[must_use]
    pub fn slopes(&self, set: usize, end: usize, actuator: usize) -> &[f64] {
        &self.slopes[self.at(set, end, actuator)..][..self.n_nodes * 6]
    }

    /// Calls `visit([set, time], node, component, wrench)` for the wrench on a node at time node `k` that follows in a set from a unit
    /// effort at time node `time`: at `k` itself, and under the implicit scheme at its neighbors too.
    pub fn visit(
        &self,
        k: usize,
        actuator: usize,
        visit: &mut dyn FnMut([usize; 2], usize, usize, f64),
    ) {
        let weight = 1.0 / self.scheme.n_ends() as f64;
        for (set, end, share) in self.sets_at(k) {
            let wrenches = self.wrenches(set, end, actuator).iter().enumerate();
            for (at, wrench) in wrenches.filter(|(_, wrench)| **wrench != 0.0) {
                for time in set..set + self.scheme.n_ends() {
                    visit([set, time], at / 6, at % 6, weight * share * wrench);
                }
            }
        }
    }
}

/// Unit efforts of the actuators that a control drives, at the time nodes of a piece, with the slopes of their wrenches.
#[derive(Debug)]
pub(super) struct MixedSlopes(Option<EffortPulls>);

impl MixedSlopes {
    /// Evaluates the mixed second derivatives along efforts and configuration at `n` time nodes from `first` on.
    pub fn of(along: &Along, first: usize, n: usize) -> Self {
        let motion = along.motion;
        let n_strains = motion.rod.actuators.strains().len();
        let driven = (motion.control).and_then(|control| control.efforts.as_ref());
        let on_strains = |own: &&Efforts| own.actuators.iter().any(|i| *i < n_strains);
        let (Some(multipliers), Some(driven)) = (along.multipliers, driven.filter(on_strains))
        else {
            return Self(None);
        };
        let ends = motion.rod.scheme.n_ends();
        let sets = (first + 1).saturating_sub(ends)..motion.n_sets().min(first + n);
        let n_steps = motion.grid.n_steps;
        let covectors = |set: usize, end: usize, node: usize| {
            let wrench = multipliers.adjoint.wrench(motion, set + end, node);
            let share = motion.rod.scheme.share(set + end, n_steps);
            Wrench {
                force: wrench.force * share,
                moment: wrench.moment * share,
            }
        };
        let mut pulls = EffortPulls::new(motion, sets.len(), &driven.actuators, true);
        pulls.evaluate(motion, along.trajectory, sets, Some(&covectors));
        Self(Some(pulls))
    }

    /// Writes those of time node `k`.
    pub fn write(&self, k: usize, out: &mut Vec<f64>) {
        out.clear();
        let Some(pulls) = &self.0 else {
            return;
        };
        for (set, end, _) in pulls.sets_at(k) {
            for actuator in 0..pulls.n_actuators {
                out.extend_from_slice(pulls.slopes(set, end, actuator));
            }
        }
    }
}

/// Sets whose time nodes lie in the lanes.
struct PullGroup<'a> {
    rod: &'a Rod,
    /// Place of every actuator of the rod among those that are asked for.
    index: &'a [Option<usize>],
    first: usize,
    n_sets: usize,
    ends: usize,
    n_actuators: usize,
    poses: &'a [Buffer; 2],
    covectors: Option<&'a [f64]>,
    shares: &'a [f64],
    wrenches: &'a mut [f64],
    slopes: &'a mut [f64],
}

struct RuledPulls<'a, R>(PullGroup<'a>, PhantomData<R>);

impl<R: TangentRule> WithSimd for RuledPulls<'_, R> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        self.0.run::<S, R>(simd);
    }
}

impl PullGroup<'_> {
    /// Returns the pose of element `q` at one end of the sets, and the covector of its pull.
    #[inline(always)]
    fn end_of<S: Simd>(&self, simd: S, q: usize, end: usize) -> CurvedEnd<S> {
        let poses = rows::<S>(&self.poses[end]);
        let a = NodePose::<S>::load(simd, &poses[q * POSE_ROWS..]);
        let b = NodePose::<S>::load(simd, &poses[(q + 1) * POSE_ROWS..]);
        let mut covector = [Vec3::zero(simd); 3];
        if let Some(numbers) = self.covectors {
            let numbers = &rows::<S>(numbers)[(end * self.rod.n_nodes() + q) * 6..][..12];
            // The element pulls a with +F and b with -F, and turns them with -M.
            covector = [
                Vec3::load(simd, numbers, 0) - Vec3::load(simd, numbers, 6),
                -Vec3::load(simd, numbers, 3),
                -Vec3::load(simd, numbers, 9),
            ];
        }
        CurvedEnd {
            dx: b.position - a.position,
            rotations: [a.rotation, b.rotation],
            covector,
        }
    }

    #[inline(always)]
    fn run<S: Simd, R: TangentRule>(self, simd: S) {
        let (rod, ends, n_actuators) = (self.rod, self.ends, self.n_actuators);
        let at = |set: usize, end: usize, actuator: usize| {
            ((set * ends + end) * n_actuators + actuator) * rod.n_nodes() * 6
        };
        let mut numbers = [0.0; 12 * MOST_LANES];
        let numbers = &mut numbers[..12 * S::F64_LANES];
        for (q, element) in rod.elements.iter().enumerate() {
            let points = rod.actuators.on(q);
            if points.is_empty() {
                continue;
            }
            let near = self.end_of::<S>(simd, q, 0);
            let far = if ends == 2 {
                self.end_of::<S>(simd, q, 1)
            } else {
                near
            };
            let both = if ends == 2 {
                Displacement::along_both(near.covector, far.covector, element.length)
            } else {
                [Displacement::along(near.covector, element.length); 2]
            };
            let signs: &[f64] = if self.covectors.is_some() {
                &[0.0, 1.0, -1.0]
            } else {
                &[0.0]
            };
            let zero = Vec3::zero(simd);
            let none = Stress {
                linear: [zero; 2],
                angular: zero,
            };
            let [a, b] = near.rotations;
            let mut poses = [([R::pose(near.dx, a, b); 2], none); 3];
            for ((poses, strain), sign) in poses.iter_mut().zip(signs) {
                for (i, end) in [near, far].iter().enumerate() {
                    let (dx, [a, b]) = if *sign == 0.0 {
                        (end.dx, end.rotations)
                    } else {
                        both[i].moved(end.dx, end.rotations, *sign)
                    };
                    poses[i] = R::pose(dx, a, b);
                }
                *strain = R::strain(&poses[0]);
                if ends == 2 {
                    let half = Lanes::splat(simd, 0.5);
                    *strain = strain.plus(R::strain(&poses[1])).times(half);
                }
            }
            for point in points {
                let Some(actuator) = self.index[point.actuator] else {
                    continue;
                };
                let mut here = point.in_element(simd, element.length);
                if let Some(extra) = point.line.checked_sub(rod.actuators.len()) {
                    // The slopes are proportional to the weight.
                    let value = rows::<S>(self.shares)[extra];
                    here.weight = here.weight * Lanes { simd, value };
                }
                let mut pulls = [[[zero; 3]; 2]; 3];
                for (pulls, (poses, strain)) in pulls.iter_mut().zip(&poses).take(signs.len()) {
                    let slopes = if R::ENDS == 1 {
                        here.slopes::<1>(&point.density, strain.linear, strain.angular)
                    } else {
                        here.slopes::<2>(&point.density, strain.linear, strain.angular)
                    };
                    // The potential is minus the coordinate.
                    let stress = slopes.times(Lanes::splat(simd, -1.0));
                    for end in 0..ends {
                        pulls[end] = R::pull(&poses[end], &stress);
                    }
                }
                for end in 0..ends {
                    let base = at(self.first, end, actuator);
                    let set = at(1, 0, 0);
                    let place = (base + q * 6, set, self.n_sets);
                    let [force, a, b] = pulls[0][end];
                    add(self.wrenches, place, [force, -a, -force, -b], numbers);
                    if self.covectors.is_some() {
                        let found = [pulls[0][end], pulls[1][end], pulls[2][end]];
                        let [dx, a, b] = both[end].slope(&found);
                        add(self.slopes, place, [-dx, a, dx, b], numbers);
                    }
                }
            }
        }
    }
}

/// Adds the vectors of both nodes of an element to every set: linear and angular of one node, then of the other. `place` has the place of
/// the first set, the distance of two sets, and their number.
#[inline(always)]
fn add<S: Simd>(
    out: &mut [f64],
    (base, distance, n_sets): (usize, usize, usize),
    vectors: [Vec3<S>; 4],
    numbers: &mut [f64],
) {
    let rows: &mut [Row<S>] = S::as_mut_simd_f64s(numbers).0;
    for (i, vector) in vectors.into_iter().enumerate() {
        vector.store(rows, 3 * i);
    }
    for lane in 0..n_sets {
        let target = &mut out[base + lane * distance..][..12];
        for (row, target) in target.iter_mut().enumerate() {
            *target += numbers[row * S::F64_LANES + lane];
        }
    }
}
