//! Independent work on several threads.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Evaluates numbers from 0 on, each on one of some threads, and returns what is found in their order, whatever the number of threads.
///
/// # Errors
/// The error of the first number that has one; those after it may be left out.
pub fn on_threads<T: Send, E: Send>(
    n: usize,
    n_threads: usize,
    evaluate: impl Fn(usize) -> Result<T, E> + Sync,
) -> Result<Vec<T>, E> {
    let next = AtomicUsize::new(0);
    let found: Mutex<Vec<Option<Result<T, E>>>> = Mutex::new((0..n).map(|_| None).collect());
    let work = || {
        loop {
            // Numbers are given out in their order, so that those before an error are all evaluated.
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= n {
                return;
            }
            let own = evaluate(number);
            if own.is_err() {
                next.store(n, Ordering::Relaxed);
            }
            found.lock().unwrap_or_else(PoisonError::into_inner)[number] = Some(own);
        }
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..n_threads.clamp(1, n.max(1)))
            .map(|_| scope.spawn(work))
            .collect();
        for thread in threads {
            thread
                .join()
                .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        }
    });
    let found = found.into_inner().unwrap_or_else(PoisonError::into_inner);
    found.into_iter().flatten().collect()
}
