//! One step of all nodes and elements, in one pass over memory.
//!
//! The nodes are dealt to the lanes in runs: of a rod of `B` blocks, lane `j` holds the nodes `j B` to `(j + 1) B - 1`,
//! and block `i` is the `i`-th of every run. The right neighbors of a block are then the next block in the same lanes,
//! and what two blocks share stays in registers; only the last block finds its neighbors in the first one, a lane
//! further. Slots beyond the tip hold nodes that cannot move, joined by elements without stiffness.

use std::marker::PhantomData;

use pulp::{Simd, WithSimd};

use super::element::{ELEMENT_ROWS, Law, Pose, Rule};
use super::turn::{Gyration, TURN_LIMIT, Turn};
use super::vector::{Frame, Lanes, Quaternion, Vec3, row};

/// Rows of a block of nodes.
pub const STATE_ROWS: usize = 19;
/// Spatial, m.
pub const POSITION: usize = 0;
/// Unit quaternion w, x, y, z.
pub const ROTATION: usize = 3;
/// Of the last half step, damped: `(p - h/2 f)/(1 + a)` with momentum `p` and force `f` at the time node.
pub const LINEAR_MOMENTUM: usize = 7;
/// In the same way, body frame.
pub const ANGULAR_MOMENTUM: usize = 10;
/// Spatial, without the control.
pub const FORCE: usize = 13;
/// Body frame, without the control.
pub const MOMENT: usize = 16;

/// Rows of the constants of a block of nodes.
pub const NODE_ROWS: usize = 8;
/// `h/m`; zero for a node that does not move.
pub const MOBILITY: usize = 0;
/// Mass times the acceleration of gravity.
pub const WEIGHT: usize = 1;
/// The four numbers of [`Gyration`], in their order.
pub const GYRATION: usize = 4;

/// Rows of the exchange with [`TurnSingly`]: the angular momentum before, and what [`Turn`] says.
pub const EXCHANGE_ROWS: usize = 11;
const MOMENTUM_BEFORE: usize = 0;
const LEVEL: usize = 3;
const TURN: usize = 4;
const MOMENTUM_AFTER: usize = 8;

/// What the lanes leave to a solver that takes one node at a time.
pub trait TurnSingly {
    /// The unit quaternion of the rotation `F` and `Fᵀ g` of the node in a slot.
    fn turn(&mut self, block: usize, lane: usize, g: [f64; 3]) -> ([f64; 4], [f64; 3]);
}

/// The task of one step; its output says whether all positions are finite.
pub struct Sweep<'a, R, L, T> {
    pub state: &'a mut [f64],
    pub nodes: &'a [f64],
    pub elements: &'a [f64],
    pub exchange: &'a mut [f64],
    pub singly: &'a mut T,
    /// `h/(1 + a)`
    pub kick: f64,
    /// `(1 - a)/(1 + a)`
    pub decay: f64,
    /// Whether to bring the quaternions back to unit length.
    pub normalize: bool,
    pub kind: PhantomData<(R, L)>,
}

impl<R: Rule, L: Law, T: TurnSingly> WithSimd for Sweep<'_, R, L, T> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> bool {
        let blocks = S::as_mut_simd_f64s(self.state).0;
        let blocks = blocks.as_chunks_mut::<STATE_ROWS>().0;
        let nodes = S::as_simd_f64s(self.nodes).0.as_chunks::<NODE_ROWS>().0;
        let elements = S::as_simd_f64s(self.elements).0;
        let elements = elements.as_chunks::<ELEMENT_ROWS>().0;
        let mut drift = Drift {
            simd,
            exchange: self.exchange,
            singly: self.singly,
            kick: Lanes::splat(simd, self.kick),
            decay: Lanes::splat(simd, self.decay),
            normalize: self.normalize,
            sum: Lanes::splat(simd, 0.0),
        };

        // The nodes of a block drift well before the elements to their left need them, so that their long chains of
        // dependent operations overlap with those of other blocks.
        let last = blocks.len() - 1;
        let first = drift.advance(&mut blocks[0], &nodes[0], 0);
        let mut left = first;
        let mut right = drift.advance_or(blocks, nodes, 1, &first);
        let mut pull = Vec3::zero(simd);
        let mut twist = Vec3::zero(simd);
        for i in 0..=last {
            let next = drift.advance_or(blocks, nodes, i + 2, &first);
            let gradient = R::gradient::<S, L>(&elements[i], &left, &right);
            let weight = Vec3::load(simd, &nodes[i], WEIGHT);
            (weight + gradient.force - pull).store(&mut blocks[i], FORCE);
            (-(twist + gradient.moment_a)).store(&mut blocks[i], MOMENT);
            left = right;
            right = next;
            pull = gradient.force;
            twist = gradient.moment_b;
        }
        let force = Vec3::load(simd, &blocks[0], FORCE) - pull.previous_lane();
        force.store(&mut blocks[0], FORCE);
        let moment = Vec3::load(simd, &blocks[0], MOMENT) - twist.previous_lane();
        moment.store(&mut blocks[0], MOMENT);
        simd.reduce_sum_f64s(drift.sum.value).is_finite()
    }
}

/// Kick and drift of the nodes.
struct Drift<'a, S: Simd, T> {
    simd: S,
    exchange: &'a mut [f64],
    singly: &'a mut T,
    kick: Lanes<S>,
    decay: Lanes<S>,
    normalize: bool,
    /// Of all positions: not finite as soon as one is not.
    sum: Lanes<S>,
}

impl<S: Simd, T: TurnSingly> Drift<'_, S, T> {
    /// The nodes of a block; beyond the last block those of the first, a lane further.
    #[inline(always)]
    fn advance_or(
        &mut self,
        blocks: &mut [[S::f64s; STATE_ROWS]],
        nodes: &[[S::f64s; NODE_ROWS]],
        index: usize,
        first: &Pose<S>,
    ) -> Pose<S> {
        match (blocks.get_mut(index), nodes.get(index)) {
            (Some(block), Some(constants)) => self.advance(block, constants, index),
            _ => first.next_lane(),
        }
    }

    #[inline(always)]
    fn advance(
        &mut self,
        block: &mut [S::f64s; STATE_ROWS],
        constants: &[S::f64s; NODE_ROWS],
        index: usize,
    ) -> Pose<S> {
        let simd = self.simd;
        let p =
            Vec3::load(simd, block, LINEAR_MOMENTUM) + Vec3::load(simd, block, FORCE) * self.kick;
        let position = Vec3::load(simd, block, POSITION) + p * row(simd, constants, MOBILITY);
        self.sum = self.sum + (position.x + position.y + position.z);
        position.store(block, POSITION);
        (p * self.decay).store(block, LINEAR_MOMENTUM);

        let g =
            Vec3::load(simd, block, ANGULAR_MOMENTUM) + Vec3::load(simd, block, MOMENT) * self.kick;
        let gyration = Gyration {
            lateral: row(simd, constants, GYRATION),
            axial: row(simd, constants, GYRATION + 1),
            excess: row(simd, constants, GYRATION + 2),
            precession: row(simd, constants, GYRATION + 3),
        };
        let mut turn = gyration.turn(g);
        if !turn.level.all_at_most(TURN_LIMIT) {
            turn = self.turn_singly(g, &turn, index);
        }
        let mut before = Quaternion::load(simd, block, ROTATION);
        if self.normalize {
            before = before.normalized_near_one();
        }
        let rotation = before.product(turn.rotation);
        rotation.store(block, ROTATION);
        (turn.momentum * self.decay).store(block, ANGULAR_MOMENTUM);
        Pose {
            position,
            rotation,
            frame: Frame::of(&rotation),
        }
    }

    #[inline(always)]
    fn turn_singly(&mut self, g: Vec3<S>, turn: &Turn<S>, index: usize) -> Turn<S> {
        let rows = S::as_mut_simd_f64s(self.exchange).0;
        let (rows, _) = rows.as_chunks_mut::<EXCHANGE_ROWS>();
        g.store(&mut rows[0], MOMENTUM_BEFORE);
        rows[0][LEVEL] = turn.level.value;
        turn.rotation.store(&mut rows[0], TURN);
        turn.momentum.store(&mut rows[0], MOMENTUM_AFTER);
        turn_lanes_singly(self.singly, self.exchange, S::F64_LANES, index);
        let rows = S::as_simd_f64s(self.exchange).0;
        let (rows, _) = rows.as_chunks::<EXCHANGE_ROWS>();
        Turn {
            rotation: Quaternion::load(self.simd, &rows[0], TURN),
            momentum: Vec3::load(self.simd, &rows[0], MOMENTUM_AFTER),
            level: turn.level,
        }
    }
}

/// Replaces rotation and momentum in the lanes whose level is beyond the limit or NaN.
#[cold]
#[inline(never)]
fn turn_lanes_singly<T: TurnSingly>(
    singly: &mut T,
    exchange: &mut [f64],
    n_lanes: usize,
    block: usize,
) {
    for lane in 0..n_lanes {
        if exchange[LEVEL * n_lanes + lane] <= TURN_LIMIT {
            continue;
        }
        let g = [0, 1, 2].map(|i| exchange[(MOMENTUM_BEFORE + i) * n_lanes + lane]);
        let (rotation, momentum) = singly.turn(block, lane, g);
        for (i, value) in rotation.into_iter().enumerate() {
            exchange[(TURN + i) * n_lanes + lane] = value;
        }
        for (i, value) in momentum.into_iter().enumerate() {
            exchange[(MOMENTUM_AFTER + i) * n_lanes + lane] = value;
        }
    }
}
