//! Rounds of tasks that threads share.

use std::sync::atomic::{AtomicUsize, Ordering};

use sensitivity::team::rounds;

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

/// While one thread is held up in a task, the others do all the rest of its round.
#[test]
fn nobody_waits_for_what_has_not_begun() {
    let done = AtomicUsize::new(0);
    rounds(
        2,
        1,
        |_| 9,
        |_, task| {
            if task == 0 {
                while done.load(Ordering::Relaxed) < 8 {
                    std::thread::yield_now();
                }
            } else {
                done.fetch_add(1, Ordering::Relaxed);
            }
        },
    );
    assert_eq!(done.load(Ordering::Relaxed), 8);
}

/// A panic reaches the caller; the other threads do not wait for ever.
#[test]
fn panics_end_the_rounds() {
    let failed = std::panic::catch_unwind(|| {
        rounds(3, 10, |_| 4, |round, task| assert!(round < 5 || task != 2));
    });
    assert!(failed.is_err());
}
