//! Threads that share the tasks of a sweep, round by round.
//!
//! A sweep has hundreds of rounds of some microseconds each: the threads stay from the first to the last, and wait for each other without
//! going to sleep. No thread waits for one that has not begun a task: the tasks of a thread without a core are taken over by the others.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

/// Looks at the others before a thread lets another one have its core.
const PATIENCE: usize = 2000;

/// Calls `work(round, task)` for `n_tasks(round)` tasks of every round; a round begins when the one before has ended. A task of the same
/// number belongs to the same of up to `n_threads` threads, whose cache holds what it left there; who has finished takes over what
/// others have not begun.
pub fn rounds(
    n_threads: usize,
    n_rounds: usize,
    n_tasks: impl Fn(usize) -> usize + Sync,
    work: impl Fn(usize, usize) + Sync,
) {
    let most = (0..n_rounds).map(&n_tasks).max().unwrap_or(0);
    let n_threads = n_threads.min(most);
    if n_threads <= 1 {
        for round in 0..n_rounds {
            for task in 0..n_tasks(round) {
                work(round, task);
            }
        }
        return;
    }
    let begins = |round: usize| {
        let next = (round..n_rounds).find(|&round| n_tasks(round) > 0);
        next.unwrap_or(n_rounds)
    };
    let progress = Progress {
        round: AtomicUsize::new(begins(0)),
        begun: (0..most).map(|_| AtomicUsize::new(0)).collect(),
        done: AtomicUsize::new(0),
        is_abandoned: AtomicBool::new(false),
    };
    let member = |index: usize| {
        let _leaving = Leaving(&progress);
        while let Some(round) = progress.round_before(n_rounds) {
            let n_tasks = n_tasks(round);
            let is_own = |task: &usize| owner(*task, n_threads) == index;
            let own = (0..n_tasks).filter(is_own);
            // From the end, which their owners come to last.
            let others = (0..n_tasks).rev().filter(|task| !is_own(task));
            for task in own.chain(others) {
                if progress.begins(round, task) {
                    work(round, task);
                    if progress.done.fetch_add(1, Ordering::AcqRel) + 1 == n_tasks {
                        progress.done.store(0, Ordering::Relaxed);
                        let next = begins(round + 1);
                        progress.round.store(next, Ordering::Release);
                    }
                }
            }
            progress.wait_for_end_of(round);
        }
    };
    std::thread::scope(|scope| {
        let member = &member;
        for index in 1..n_threads {
            scope.spawn(move || member(index));
        }
        member(0);
    });
}

/// The thread of a task: there and back again, so that tasks whose cost rises or falls with their number are shared out evenly.
fn owner(task: usize, n_threads: usize) -> usize {
    let place = task % (2 * n_threads);
    place.min(2 * n_threads - 1 - place)
}

/// The round that all threads have reached.
struct Progress {
    round: AtomicUsize,
    /// The first round in which each task has not begun.
    begun: Vec<AtomicUsize>,
    /// Tasks of the round that have ended.
    done: AtomicUsize,
    /// Tells whether a thread has panicked, so that the others must not wait for it.
    is_abandoned: AtomicBool,
}

impl Progress {
    /// Returns the present round; `None` if all have ended or one thread has panicked.
    fn round_before(&self, n_rounds: usize) -> Option<usize> {
        let round = self.round.load(Ordering::Acquire);
        (round < n_rounds && !self.is_abandoned.load(Ordering::Relaxed)).then_some(round)
    }

    /// Tells whether this call is the one that begins a task. All tasks of a round that has ended have begun.
    fn begins(&self, round: usize, task: usize) -> bool {
        let begun = &self.begun[task];
        let seen = begun.load(Ordering::Relaxed);
        seen <= round
            && (begun.compare_exchange(seen, round + 1, Ordering::AcqRel, Ordering::Relaxed))
                .is_ok()
    }

    /// Returns when the others have ended what they have begun, or when one never will.
    fn wait_for_end_of(&self, round: usize) {
        let mut looks = 0;
        while self.round.load(Ordering::Acquire) == round
            && !self.is_abandoned.load(Ordering::Relaxed)
        {
            if looks < PATIENCE {
                looks += 1;
                std::hint::spin_loop();
            } else {
                std::thread::yield_now();
            }
        }
    }
}

/// Tells the others when a thread panics.
struct Leaving<'a>(&'a Progress);

impl Drop for Leaving<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.is_abandoned.store(true, Ordering::Relaxed);
        }
    }
}

// A lock is poisoned only where a panic is on its way to the caller anyway.

/// Locks, also where another thread has panicked.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

pub(super) fn read<T>(lock: &RwLock<T>) -> RwLockReadGuard<'_, T> {
    lock.read().unwrap_or_else(PoisonError::into_inner)
}

pub(super) fn write<T>(lock: &RwLock<T>) -> RwLockWriteGuard<'_, T> {
    lock.write().unwrap_or_else(PoisonError::into_inner)
}
