//! The data of a group of time nodes.

use nalgebra::Vector3;
use pulp::Simd;

use super::super::active::ActiveTimes;
use super::solved::SolveRows;
use crate::curvature::IntervalCurvature;
use crate::linearization::Motion;
use crate::tangent::{POSE_ROWS, put_pose};
use cosserat::buffer::Buffer;
use cosserat::configuration::Trajectory;
use cosserat::rod::Rod;
use cosserat::vector::{Mat3, Row};

/// `λx` and `λr` times the kick's weight, and for the interval that follows `λr` and the `μr` where it ends, then `λx` and `μx`.
pub const MULTIPLIER_ROWS: usize = 18;
/// Number of rows of three 6×6 matrices, the largest result that is on its way at once.
const OUT_ROWS: usize = 108;

/// Data of a group of time nodes, a number in each lane.
#[derive(Debug)]
pub struct Workspace {
    /// [`POSE_ROWS`] of every node, and those a step later.
    pub poses: Buffer,
    pub next: Buffer,
    /// Poses a step earlier, of steps that are solved for.
    pub before: Buffer,
    /// Data of steps that are solved for.
    pub solve: Option<SolveRows>,
    /// [`MULTIPLIER_ROWS`] of every node.
    pub multipliers: Buffer,
    /// Weights of the kicks.
    pub weights: Buffer,
    /// Results on their way to the time nodes.
    pub out: Buffer,
    /// Curvature of the interval after each of the time nodes.
    pub intervals: Vec<IntervalCurvature>,
    /// Inertia of every node where the interval after the one time node starts and where it ends, if it is not that at rest.
    pub rotary: Option<[Vec<Vector3<f64>>; 2]>,
    /// Efforts of the actuators, if the rod has any.
    pub active: Option<ActiveTimes>,
}

impl Workspace {
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
            rotary: None,
            active: ActiveTimes::of(motion, n_lanes),
        }
    }

    /// Inertia of a node where the interval starts and where it ends, kg m².
    pub fn rotary<'a>(&'a self, rod: &'a Rod, node: usize) -> [&'a Vector3<f64>; 2] {
        match &self.rotary {
            Some([leaving, arriving]) => [&leaving[node], &arriving[node]],
            None => [&rod.nodes[node].rotary; 2],
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
        self.put_own_poses(trajectory, first, last, n_lanes);
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

    /// [`Self::put_poses`] without those before and after.
    pub fn put_own_poses(
        &mut self,
        trajectory: &Trajectory,
        first: usize,
        last: usize,
        n_lanes: usize,
    ) {
        for lane in 0..n_lanes {
            let k = (first + lane).min(last);
            put_time_node(&mut self.poses, trajectory, k, lane, n_lanes);
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

/// Nine rows from row `at` on.
#[inline(always)]
pub fn store<S: Simd>(out: &mut [f64], at: usize, m: Mat3<S>) {
    let out: &mut [Row<S>] = S::as_mut_simd_f64s(out).0;
    for (i, row) in m.rows.into_iter().enumerate() {
        row.store(out, at + 3 * i);
    }
}

/// Block `(i, j)` of a 9×9 matrix in 81 rows.
#[inline(always)]
pub fn store_block<S: Simd>(out: &mut [f64], i: usize, j: usize, m: Mat3<S>) {
    let out: &mut [Row<S>] = S::as_mut_simd_f64s(out).0;
    for (row, values) in m.rows.into_iter().enumerate() {
        values.store(out, 9 * (3 * i + row) + 3 * j);
    }
}

/// One lane of nine rows.
#[inline(always)]
pub fn matrix<S: Simd>(out: &[f64], at: usize, lane: usize) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| out[(at + 3 * i + j) * S::F64_LANES + lane]))
}

/// One lane of 81 rows.
#[inline(always)]
pub fn scatter<S: Simd>(out: &[f64], lane: usize, target: &mut [[f64; 9]; 9]) {
    let rows = out.chunks_exact(S::F64_LANES);
    for (target, row) in target.as_flattened_mut().iter_mut().zip(rows) {
        *target = row[lane];
    }
}
