//! The linearized steps that a sweep uses: computed some time nodes ahead of the sweep and dropped behind it, so that a trajectory is never
//! linearized in memory as a whole.

use std::cell::RefCell;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError, RwLock, RwLockReadGuard};

use super::along::Along;
use super::linearize::Memory;
use super::step::LinearizedStep;
use super::team::{lock, read, rounds, write};
use cosserat::instructions::instructions;
use cosserat::step_error::StepError;
use stop::StopSignal;

/// Time nodes that are linearized by one task: all lanes full, and few that are begun in their middle.
pub(super) const PIECE: usize = 16;
/// Pieces of a group: with the next group they stay in the second-level cache.
const GROUP: usize = 2;

/// Direction of a sweep.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Sense {
    Forward,
    Backward,
}

/// The steps of a group in pieces, for the two groups that take turns.
type Pieces = Vec<RwLock<Vec<LinearizedStep>>>;

thread_local! {
    /// Pieces of the last sweep on this thread, whose memory the next one reuses and writes anew.
    static SPARE: RefCell<Pieces> = const { RefCell::new(Vec::new()) };
}

/// The steps that are linearized, and their order.
pub(super) struct Conveyor<'a> {
    pub along: Along<'a>,
    /// Time nodes.
    pub range: Range<usize>,
    pub sense: Sense,
    pub n_threads: usize,
}

/// The linearized steps of a group, in pieces.
pub(super) struct Group<'a> {
    pieces: Vec<(usize, RwLockReadGuard<'a, Vec<LinearizedStep>>)>,
}

impl Group<'_> {
    /// Every time node with its step.
    pub fn steps(&self) -> impl DoubleEndedIterator<Item = (usize, &LinearizedStep)> {
        (self.pieces.iter()).flat_map(|(first, steps)| {
            steps
                .iter()
                .enumerate()
                .map(move |(i, step)| (first + i, step))
        })
    }

    /// The steps of the `index`th part of `length` time nodes, with the first of these; a piece holds a whole number of parts.
    pub fn part(&self, index: usize, length: usize) -> Option<(usize, &[LinearizedStep])> {
        let start = index * length;
        let (first, steps) = self.pieces.get(start / PIECE)?;
        let from = start % PIECE;
        let part = steps.get(from..steps.len().min(from + length))?;
        (!part.is_empty()).then_some((first + from, part))
    }
}

/// Parts of `length` time nodes in a full group.
pub(super) const fn parts_of(length: usize) -> usize {
    GROUP * PIECE / length
}

impl Conveyor<'_> {
    /// Calls `work(phase, task, group)` for all tasks of every phase of one group after the other. Tasks of one phase run beside each
    /// other, and beside the linearization of the next group.
    ///
    /// # Errors
    /// [`StepError`] of a time node that cannot be linearized: the first one of the first group that has any; or of the motion's
    /// [`StopSignal`].
    pub fn run(
        &self,
        n_phases: usize,
        n_tasks: impl Fn(usize) -> usize + Sync,
        work: impl Fn(usize, usize, &Group) + Sync,
    ) -> Result<(), StepError> {
        let n_groups = self.range.len().div_ceil(GROUP * PIECE);
        let arch = instructions();
        let mut pieces = SPARE.take();
        pieces.resize_with(2 * GROUP, RwLock::default);
        let place = |group: usize, piece: usize| &pieces[(group % 2) * GROUP + piece];
        let failure: Mutex<Option<(usize, StepError)>> = Mutex::new(None);
        // What has begun beside a failure ends as if there were none, so that the same one is always found.
        let last_round = AtomicUsize::new(usize::MAX);
        // The first round makes the first group; every group has its phases, and the next one is made in the first of them.
        let at = |round: usize| {
            round
                .checked_sub(1)
                .map(|round| (round / n_phases, round % n_phases))
        };
        let next = |round: usize| match at(round) {
            None => Some(0),
            Some((group, 0)) => Some(group + 1).filter(|group| *group < n_groups),
            Some(_) => None,
        };
        let uses = |round: usize| at(round).map_or(0, |(_, phase)| n_tasks(phase));
        let makes = |round: usize| next(round).map_or(0, |group| self.pieces_of(group).count());
        rounds(
            self.n_threads,
            1 + n_groups * n_phases,
            |round| uses(round) + makes(round),
            |round, task| {
                if round > last_round.load(Ordering::Relaxed) {
                    return;
                }
                if let Some(stop) = self.along.motion.stop.and_then(StopSignal::raised) {
                    lock(&failure).get_or_insert((usize::MAX, stop.into()));
                    last_round.store(round, Ordering::Relaxed);
                    return;
                }
                let made = task.checked_sub(uses(round));
                if let (Some(piece), Some(group)) = (made, next(round)) {
                    let Some(range) = self.pieces_of(group).nth(piece) else {
                        return;
                    };
                    let mut steps = write(place(group, piece));
                    steps.resize_with(range.len(), LinearizedStep::default);
                    let (first, along) = (range.start, &self.along);
                    let mut memory = Memory::of(arch, along.motion);
                    let made = memory.linearize(arch, along, first, &mut steps);
                    if let Err(error) = made {
                        let mut failure = lock(&failure);
                        if failure.as_ref().is_none_or(|(before, _)| first < *before) {
                            *failure = Some((first, error));
                        }
                        last_round.store(round, Ordering::Relaxed);
                    }
                } else if let Some((group, phase)) = at(round) {
                    let pieces = self.pieces_of(group).enumerate();
                    let pieces =
                        pieces.map(|(piece, range)| (range.start, read(place(group, piece))));
                    let group = Group {
                        pieces: pieces.collect(),
                    };
                    work(phase, task, &group);
                }
            },
        );
        SPARE.set(pieces);
        let failure = failure.into_inner();
        match failure.unwrap_or_else(PoisonError::into_inner) {
            None => Ok(()),
            Some((_, error)) => Err(error),
        }
    }

    /// Time nodes of the pieces of a group, ascending.
    fn pieces_of(&self, group: usize) -> impl Iterator<Item = Range<usize>> {
        let n_groups = self.range.len().div_ceil(GROUP * PIECE);
        let ascending = match self.sense {
            Sense::Forward => group,
            Sense::Backward => n_groups - 1 - group,
        };
        let end = self.range.end;
        let start = self.range.start + ascending * GROUP * PIECE;
        (start..end.min(start + GROUP * PIECE))
            .step_by(PIECE)
            .map(move |first| first..end.min(first + PIECE))
    }
}
