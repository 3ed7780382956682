//! Threads that share out the tasks of one round after the other.
//!
//! A sweep has hundreds of rounds of some microseconds each: the threads stay from the first to the last, and wait for each other without
//! going to sleep.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

/// Looks at the others before a thread lets another one have its core.
const PATIENCE: usize = 2000;

/// Calls `work(round, task)` for `n_tasks(round)` tasks of every round; a round begins when the one before has ended. A task of the same
/// number always belongs to the same of up to `n_threads` threads, whose cache holds what it left there, and every thread takes its own
/// in their order.
pub(super) fn rounds(
    n_threads: usize,
    n_rounds: usize,
    n_tasks: impl Fn(usize) -> usize + Sync,
    work: impl Fn(usize, usize) + Sync,
) {
    let n_threads = n_threads.min((0..n_rounds).map(&n_tasks).max().unwrap_or(0));
    if n_threads <= 1 {
        for round in 0..n_rounds {
            for task in 0..n_tasks(round) {
                work(round, task);
            }
        }
        return;
    }
    let meeting = Meeting::of(n_threads);
    let member = |index: usize| {
        let _leaving = Leaving(&meeting);
        for round in 0..n_rounds {
            for task in (0..n_tasks(round)).filter(|task| owner(*task, n_threads) == index) {
                work(round, task);
            }
            if !meeting.waits() {
                return;
            }
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

/// Where all threads wait for the last one.
struct Meeting {
    size: usize,
    arrived: AtomicUsize,
    held: AtomicUsize,
    /// A thread has panicked: nobody is to wait for it.
    is_abandoned: AtomicBool,
}

impl Meeting {
    fn of(size: usize) -> Self {
        Self {
            size,
            arrived: AtomicUsize::new(0),
            held: AtomicUsize::new(0),
            is_abandoned: AtomicBool::new(false),
        }
    }

    /// Returns when all have come, or false when one never will.
    fn waits(&self) -> bool {
        let held = self.held.load(Ordering::Acquire);
        if self.arrived.fetch_add(1, Ordering::AcqRel) + 1 == self.size {
            self.arrived.store(0, Ordering::Relaxed);
            self.held.fetch_add(1, Ordering::Release);
        }
        let mut looks = 0;
        while self.held.load(Ordering::Acquire) == held {
            if self.is_abandoned.load(Ordering::Relaxed) {
                return false;
            }
            if looks < PATIENCE {
                looks += 1;
                std::hint::spin_loop();
            } else {
                std::thread::yield_now();
            }
        }
        true
    }
}

/// Tells the others when a thread panics.
struct Leaving<'a>(&'a Meeting);

impl Drop for Leaving<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.is_abandoned.store(true, Ordering::Relaxed);
        }
    }
}

// A lock is poisoned only where a panic is on its way to the caller anyway.

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

pub(super) fn read<T>(lock: &RwLock<T>) -> RwLockReadGuard<'_, T> {
    lock.read().unwrap_or_else(PoisonError::into_inner)
}

pub(super) fn write<T>(lock: &RwLock<T>) -> RwLockWriteGuard<'_, T> {
    lock.write().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every task is done once, and none before all of the round before it.
    #[test]
    fn rounds_follow_each_other() {
        for n_threads in [1, 2, 5] {
            let done: Vec<AtomicUsize> = (0..40).map(|_| AtomicUsize::new(0)).collect();
            let sizes = |round: usize| (7 * round) % 5;
            rounds(n_threads, done.len(), sizes, |round, task| {
                assert!(task < sizes(round));
                if let Some(before) = round.checked_sub(1) {
                    assert_eq!(done[before].load(Ordering::Relaxed), sizes(before));
                }
                done[round].fetch_add(1, Ordering::Relaxed);
            });
            for (round, done) in done.iter().enumerate() {
                assert_eq!(done.load(Ordering::Relaxed), sizes(round));
            }
        }
    }

    /// A panic reaches the caller; the other threads do not wait for ever.
    #[test]
    fn panics_end_the_rounds() {
        let failed = std::panic::catch_unwind(|| {
            rounds(3, 10, |_| 4, |round, task| assert!(round < 5 || task != 2));
        });
        assert!(failed.is_err());
    }
}
