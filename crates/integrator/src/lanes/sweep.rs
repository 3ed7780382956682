//! One step of all nodes and elements.
//!
//! The nodes are distributed over the lanes in runs: of a rod of `B` blocks, run `j` has the nodes `j B` to `(j + 1) B - 1`, and block `i`
//! is the `i`-th of every run. The right neighbors of a block are then the next block in the same lanes, and values that two blocks share
//! stay in registers; only the last block has its neighbors in the first one, a lane further. Slots beyond the tip hold nodes that cannot
//! move, joined by elements without stiffness.

use std::marker::PhantomData;

use pulp::{Simd, WithSimd};

use super::active::{ActiveBlocks, ActiveLanes};
use super::element::{Chord, FramedPose, SectionLaw};
pub use super::place::{
    ANGULAR_MOMENTUM, FORCE, LINEAR_MOMENTUM, MOMENT, POSITION, ROTATION, STATE_ROWS,
};
use super::rule::Rule;
use super::turn::{Gyration, TURN_LIMIT, Turn};
use super::vector::{Lanes, Quaternion, Row, Vec3, blocks, blocks_mut, row, rows};

/// Number of rows of the constants of a block of nodes.
pub const NODE_ROWS: usize = 8;
/// `h/m`; zero for a held node.
pub const MOBILITY: usize = 0;
/// Mass times the acceleration of gravity.
pub const WEIGHT: usize = 1;
/// The four numbers of [`Gyration`], in their order; if the inertia follows the dilatation, the inertia at rest and the `unequal` of
/// [`Gyration::of`].
pub const GYRATION: usize = 4;

/// Number of rows of a block of nodes whose inertia follows the dilatation.
pub const SPIN_ROWS: usize = 7;
/// Principal moments of inertia.
pub const ROTARY: usize = 0;
/// Unit quaternion of the last rotation.
pub const LAST_TURN: usize = 3;

/// Number of rows of the exchange with [`TurnSingly`]: the angular momentum before, the inertia, and the results of [`Turn`].
pub const EXCHANGE_ROWS: usize = 14;
const MOMENTUM_BEFORE: usize = 0;
const LEVEL: usize = 3;
const TURN: usize = 4;
const MOMENTUM_AFTER: usize = 8;
const INERTIA: usize = 11;

/// A solver for nodes that the lanes cannot turn, one node at a time.
pub trait TurnSingly {
    /// Returns the unit quaternion of the rotation `F`, and `Fᵀ g`, for the node in a slot. The inertia is given if it follows the
    /// dilatation.
    fn turn(
        &mut self,
        block: usize,
        lane: usize,
        g: [f64; 3],
        inertia: Option<[f64; 3]>,
    ) -> ([f64; 4], [f64; 3]);
}

/// A part of a step. With a kinetic reaction a step has several parts, between which a driven base is moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// A whole step without kinetic reaction.
    Whole,
    /// Kicks and turns, with the present inertia.
    Turn,
    /// Kinetic reaction of these turns, then translation.
    ReactAndTranslate,
    /// Kick and translation.
    Translate,
    /// Inertia at the present positions, then kick and turns.
    FollowAndTurn,
    /// Forces.
    Forces,
    /// Kinetic reaction of the last turns, and forces.
    ReactingForces,
}

/// The task of a step or a part of it.
pub(crate) struct Sweep<'a, R, L, T> {
    pub part: Part,
    pub state: &'a mut [f64],
    pub nodes: &'a [f64],
    pub elements: &'a [f64],
    /// Indices of the blocks of `nodes` and of `elements` with the constants of a block.
    pub kinds: &'a [[usize; 2]],
    /// Actuators on the strains, if there are any.
    pub active: Option<&'a ActiveLanes>,
    /// Empty if the inertia is constant.
    pub spin: &'a mut [f64],
    pub exchange: &'a mut [f64],
    pub singly: &'a mut T,
    /// `h`
    pub time_step: f64,
    /// `a = c h/2` of the viscous damping.
    pub half_damping: f64,
    /// Tells whether the quaternions are normalized.
    pub normalize: bool,
    pub kind: PhantomData<(R, L)>,
}

/// The findings of a part of a step.
#[derive(Clone, Copy, Debug)]
pub struct Finding {
    /// Tells whether all positions, forces and moments are finite.
    pub finite: bool,
    /// Tells whether the time step resolves the dilatation of all elements, with a margin for rounding.
    pub resolved: bool,
    /// Tells whether the ends of all elements are within half a turn.
    pub unfolded: bool,
}

/// A limit below one by more than the rounding of a quotient.
const COMPRESSION_LIMIT: f64 = 1.0 - 1e-12;

impl<R: Rule, L: SectionLaw, T: TurnSingly> WithSimd for Sweep<'_, R, L, T> {
    type Output = Finding;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Finding {
        let scale = 1.0 / (1.0 + self.half_damping);
        let mut work = Work::<S, R, L, T> {
            simd,
            blocks: blocks_mut::<S, STATE_ROWS>(self.state),
            nodes: blocks::<S, NODE_ROWS>(self.nodes),
            elements: rows::<S>(self.elements),
            kinds: self.kinds,
            active: self.active.map(ActiveLanes::blocks),
            spin: blocks_mut::<S, SPIN_ROWS>(self.spin),
            exchange: self.exchange,
            singly: self.singly,
            time_step: self.time_step,
            kick: Lanes::splat(simd, self.time_step * scale),
            decay: Lanes::splat(simd, (1.0 - self.half_damping) * scale),
            reaction: Lanes::splat(simd, 2.0 / self.time_step * scale),
            normalize: self.normalize,
            sum: Lanes::splat(simd, 0.0),
            compression: Lanes::splat(simd, 0.0),
            fold: Lanes::splat(simd, 0.0),
            kind: PhantomData,
        };
        if L::REACTS {
            match self.part {
                Part::Turn => work.turn_all(false),
                Part::ReactAndTranslate => work.react_and_translate(),
                Part::Translate => work.push_and_translate(),
                Part::FollowAndTurn => work.turn_all(true),
                Part::Whole | Part::Forces => work.forces::<false>(false),
                Part::ReactingForces => work.forces::<false>(true),
            }
        } else {
            work.forces::<true>(false);
        }
        Finding {
            finite: work.sum.has_finite_sum(),
            resolved: work.compression.all_at_most(COMPRESSION_LIMIT),
            unfolded: work.fold.all_at_most(0.0),
        }
    }
}

struct Work<'a, S: Simd, R, L, T> {
    simd: S,
    blocks: &'a mut [[Row<S>; STATE_ROWS]],
    nodes: &'a [[Row<S>; NODE_ROWS]],
    elements: &'a [Row<S>],
    kinds: &'a [[usize; 2]],
    active: Option<ActiveBlocks<'a, S>>,
    spin: &'a mut [[Row<S>; SPIN_ROWS]],
    exchange: &'a mut [f64],
    singly: &'a mut T,
    time_step: f64,
    /// `h/(1 + a)`
    kick: Lanes<S>,
    /// `(1 - a)/(1 + a)`
    decay: Lanes<S>,
    /// `2/(h (1 + a))`
    reaction: Lanes<S>,
    normalize: bool,
    /// Sum of all positions, angular momenta, forces and moments, which is not finite as soon as one of them is not.
    sum: Lanes<S>,
    /// Largest compression; see [`Chord::compression`].
    compression: Lanes<S>,
    /// Largest fold; see [`Gradient`](super::element::Gradient).
    fold: Lanes<S>,
    kind: PhantomData<(R, L)>,
}

impl<'a, S: Simd, R: Rule, L: SectionLaw, T: TurnSingly> Work<'a, S, R, L, T> {
    #[inline(always)]
    fn node(&self, index: usize) -> &'a [Row<S>; NODE_ROWS] {
        &self.nodes[self.kinds[index][0]]
    }

    #[inline(always)]
    fn element(&self, index: usize) -> &'a [Row<S>] {
        &self.elements[self.kinds[index][1] * L::ROWS..][..L::ROWS]
    }

    /// Computes elements, and the consequences for the nodes at their ends; with `MOVE` the nodes make their kick and drift first, well
    /// before the elements to their left need them, so that their long chains of dependent operations overlap with those of other blocks.
    #[inline(always)]
    fn forces<const MOVE: bool>(&mut self, react: bool) {
        let simd = self.simd;
        let n_blocks = self.blocks.len();
        let zero = Vec3::zero(simd);
        let mut left = FramedPose::of(zero, Quaternion { w: zero.x, v: zero });
        let mut right = left;
        let mut pull = zero;
        let mut twist = zero;
        let mut gain = zero;
        let mut impulse = zero;
        for ahead in 0..n_blocks + 2 {
            let (position, rotation) = if ahead < n_blocks {
                if MOVE {
                    let p = self.push(ahead);
                    (self.translate(ahead, p), self.turn(ahead))
                } else {
                    (self.position(ahead), self.rotation(ahead))
                }
            } else {
                // The last block is followed by the nodes of the first one, a lane further.
                (self.position(0).next_lane(), self.rotation(0).next_lane())
            };
            let next = FramedPose::of(position, rotation);
            if ahead >= 2 {
                let i = ahead - 2;
                let constants = self.element(i);
                let chord = Chord::between(left.position, right.position);
                let gradient = R::gradient::<S, L>(
                    constants,
                    &left,
                    &right,
                    &chord,
                    self.active.map(|active| (active, i)),
                );
                let weight = Vec3::load(simd, self.node(i), WEIGHT);
                let block = &mut self.blocks[i];
                let force = weight + gradient.force - pull;
                let moment = -(twist + gradient.moment_a);
                force.store(block, FORCE);
                moment.store(block, MOMENT);
                self.sum = self.sum + (force + moment).sum();
                self.fold = self.fold.max(gradient.fold);
                pull = gradient.force;
                twist = gradient.moment_b;
                if L::THINS {
                    self.compression = self.compression.max(chord.compression(constants));
                    if MOVE {
                        let [a, b] = chord.inertia(constants);
                        self.set_inertia(i, a, gain);
                        gain = b;
                        if i > 0 {
                            self.arrive(i);
                        }
                    }
                }
                if L::REACTS && react {
                    let turns = [self.last_turn(i), self.last_turn_or(i + 1)];
                    let next = chord.kinetic_reaction(constants, turns) * self.reaction;
                    self.add_impulse(i, -next);
                    self.add_impulse(i, impulse);
                    impulse = next;
                }
            }
            left = right;
            right = next;
        }
        self.sum = self.sum + (pull + twist).sum();
        let block = &mut self.blocks[0];
        (Vec3::load(simd, block, FORCE) - pull.previous_lane()).store(block, FORCE);
        (Vec3::load(simd, block, MOMENT) - twist.previous_lane()).store(block, MOMENT);
        if L::THINS && MOVE {
            let rotary = Vec3::load(simd, &self.spin[0], ROTARY) + gain.previous_lane();
            rotary.store(&mut self.spin[0], ROTARY);
            self.arrive(0);
        }
        if L::REACTS && react {
            self.add_impulse(0, impulse.previous_lane());
        }
    }

    /// Returns the linear momentum after the kick.
    #[inline(always)]
    fn push(&self, index: usize) -> Vec3<S> {
        let block = &self.blocks[index];
        Vec3::load(self.simd, block, LINEAR_MOMENTUM)
            + Vec3::load(self.simd, block, FORCE) * self.kick
    }

    #[inline(always)]
    fn translate(&mut self, index: usize, p: Vec3<S>) -> Vec3<S> {
        let mobility = row(self.simd, self.node(index), MOBILITY);
        let block = &mut self.blocks[index];
        let position = Vec3::load(self.simd, block, POSITION) + p * mobility;
        self.sum = self.sum + position.sum();
        position.store(block, POSITION);
        (p * self.decay).store(block, LINEAR_MOMENTUM);
        position
    }

    /// Applies kick and rotation, and the angular momentum after it if the inertia is constant during the step.
    #[inline(always)]
    fn turn(&mut self, index: usize) -> Quaternion<S> {
        let simd = self.simd;
        let constants = self.node(index);
        let block = &self.blocks[index];
        let g =
            Vec3::load(simd, block, ANGULAR_MOMENTUM) + Vec3::load(simd, block, MOMENT) * self.kick;
        let mut before = Quaternion::load(simd, block, ROTATION);
        let gyration = if L::THINS {
            let rotary = Vec3::load(simd, &self.spin[index], ROTARY);
            Gyration::of(rotary, row(simd, constants, GYRATION + 3), self.time_step)
        } else {
            Gyration {
                lateral: row(simd, constants, GYRATION),
                axial: row(simd, constants, GYRATION + 1),
                excess: row(simd, constants, GYRATION + 2),
                precession: row(simd, constants, GYRATION + 3),
            }
        };
        let mut turn = gyration.turn(g);
        if !turn.level.all_at_most(TURN_LIMIT) {
            turn = self.turn_singly(g, &turn, index);
        }
        if self.normalize {
            before = before.normalized_near_one();
        }
        let rotation = before.product(turn.rotation);
        let block = &mut self.blocks[index];
        rotation.store(block, ROTATION);
        if L::THINS {
            turn.rotation.store(&mut self.spin[index], LAST_TURN);
        }
        if !L::THINS || L::REACTS {
            (turn.momentum * self.decay).store(block, ANGULAR_MOMENTUM);
        }
        self.sum = self.sum + turn.momentum.sum();
        rotation
    }

    #[inline(always)]
    fn turn_singly(&mut self, g: Vec3<S>, turn: &Turn<S>, index: usize) -> Turn<S> {
        let exchange = &mut blocks_mut::<S, EXCHANGE_ROWS>(self.exchange)[0];
        g.store(exchange, MOMENTUM_BEFORE);
        exchange[LEVEL] = turn.level.value;
        turn.rotation.store(exchange, TURN);
        turn.momentum.store(exchange, MOMENTUM_AFTER);
        if L::THINS {
            Vec3::load(self.simd, &self.spin[index], ROTARY).store(exchange, INERTIA);
        }
        turn_lanes_singly(self.singly, self.exchange, index, L::THINS);
        let exchange = &blocks::<S, EXCHANGE_ROWS>(self.exchange)[0];
        Turn {
            rotation: Quaternion::load(self.simd, exchange, TURN),
            momentum: Vec3::load(self.simd, exchange, MOMENTUM_AFTER),
            level: turn.level,
        }
    }

    /// Sets the inertia: that at rest plus the shares of the elements to the right and to the left.
    #[inline(always)]
    fn set_inertia(&mut self, index: usize, right: Vec3<S>, left: Vec3<S>) {
        let rest = Vec3::load(self.simd, self.node(index), GYRATION);
        (rest + right + left).store(&mut self.spin[index], ROTARY);
    }

    /// Sets the angular momentum of the last rotation with the inertia at its end: `(2/h) (w J v - v × J v)` for its quaternion.
    #[inline(always)]
    fn arrive(&mut self, index: usize) {
        let spin = &self.spin[index];
        let Quaternion { w, v } = Quaternion::load(self.simd, spin, LAST_TURN);
        let jv = Vec3::load(self.simd, spin, ROTARY).component_mul(v);
        let momentum = (jv * w - v.cross(jv)) * (2.0 / self.time_step);
        self.sum = self.sum + momentum.sum();
        (momentum * self.decay).store(&mut self.blocks[index], ANGULAR_MOMENTUM);
    }

    #[inline(always)]
    fn last_turn(&self, index: usize) -> Vec3<S> {
        Vec3::load(self.simd, &self.spin[index], LAST_TURN + 1)
    }

    /// Returns the last turn of a block; beyond the last block that of the first one, a lane further.
    #[inline(always)]
    fn last_turn_or(&self, index: usize) -> Vec3<S> {
        if index < self.spin.len() {
            self.last_turn(index)
        } else {
            self.last_turn(0).next_lane()
        }
    }

    #[inline(always)]
    fn position(&self, index: usize) -> Vec3<S> {
        Vec3::load(self.simd, &self.blocks[index], POSITION)
    }

    #[inline(always)]
    fn rotation(&self, index: usize) -> Quaternion<S> {
        Quaternion::load(self.simd, &self.blocks[index], ROTATION)
    }

    #[inline(always)]
    fn add_impulse(&mut self, index: usize, impulse: Vec3<S>) {
        let block = &mut self.blocks[index];
        let p = Vec3::load(self.simd, block, LINEAR_MOMENTUM) + impulse;
        p.store(block, LINEAR_MOMENTUM);
    }

    #[inline(always)]
    fn push_and_translate(&mut self) {
        for i in 0..self.blocks.len() {
            let p = self.push(i);
            self.translate(i, p);
        }
    }

    /// Applies the kinetic reaction, then translates. The element to the left of the first block is the last one, a lane back, and comes
    /// first.
    #[inline(always)]
    fn react_and_translate(&mut self) {
        let last = self.blocks.len() - 1;
        let first = self.position(0).next_lane();
        let wrapped = Chord::between(self.position(last), first);
        let turns = [self.last_turn(last), self.last_turn(0).next_lane()];
        let impulse = wrapped.kinetic_reaction(self.element(last), turns) * self.reaction;
        let mut left = impulse.previous_lane();
        for i in 0..=last {
            let next = if i == last {
                first
            } else {
                self.position(i + 1)
            };
            let chord = Chord::between(self.position(i), next);
            let turns = [self.last_turn(i), self.last_turn_or(i + 1)];
            let right = chord.kinetic_reaction(self.element(i), turns) * self.reaction;
            self.add_impulse(i, left - right);
            let p = Vec3::load(self.simd, &self.blocks[i], LINEAR_MOMENTUM);
            self.translate(i, p);
            left = right;
        }
    }

    /// Turns all nodes; with `follow` their inertia is first updated to the present positions, otherwise they are pushed.
    #[inline(always)]
    fn turn_all(&mut self, follow: bool) {
        let last = self.blocks.len() - 1;
        let first = self.position(0).next_lane();
        let wrapped = Chord::between(self.position(last), first);
        let mut left = wrapped.inertia(self.element(last))[1].previous_lane();
        for i in 0..=last {
            if follow {
                let next = if i == last {
                    first
                } else {
                    self.position(i + 1)
                };
                let chord = Chord::between(self.position(i), next);
                let constants = self.element(i);
                self.compression = self.compression.max(chord.compression(constants));
                let [a, b] = chord.inertia(constants);
                self.set_inertia(i, a, left);
                left = b;
            } else {
                self.push(i).store(&mut self.blocks[i], LINEAR_MOMENTUM);
            }
            self.turn(i);
        }
    }
}

/// Replaces rotation and momentum in the lanes whose level exceeds the limit or is NaN.
#[cold]
#[inline(never)]
fn turn_lanes_singly<T: TurnSingly>(
    singly: &mut T,
    exchange: &mut [f64],
    block: usize,
    with_inertia: bool,
) {
    let n_lanes = exchange.len() / EXCHANGE_ROWS;
    for lane in 0..n_lanes {
        if exchange[LEVEL * n_lanes + lane] <= TURN_LIMIT {
            continue;
        }
        let vector = |row: usize| [0, 1, 2].map(|i| exchange[(row + i) * n_lanes + lane]);
        let inertia = with_inertia.then(|| vector(INERTIA));
        let (rotation, momentum) = singly.turn(block, lane, vector(MOMENTUM_BEFORE), inertia);
        for (i, value) in rotation.into_iter().enumerate() {
            exchange[(TURN + i) * n_lanes + lane] = value;
        }
        for (i, value) in momentum.into_iter().enumerate() {
            exchange[(MOMENTUM_AFTER + i) * n_lanes + lane] = value;
        }
    }
}
