//! The least of the times of several runs.

use crate::clock::Seconds;

/// Returns the least of the times of several runs, and their number. Runs are repeated up to [`MOST_RUNS`] times, as long as [`FOR_RUNS_S`]
/// allows another one.
pub(super) fn least<E>(
    first: Seconds,
    mut again: impl FnMut() -> Result<Seconds, E>,
) -> (Seconds, usize) {
    let (mut least, mut runs, mut spent) = (first, 1, first.processor);
    while runs < MOST_RUNS && spent + first.processor <= FOR_RUNS_S {
        let Ok(seconds) = again() else { break };
        runs += 1;
        spent += seconds.processor;
        least.wall = least.wall.min(seconds.wall);
        least.processor = least.processor.min(seconds.processor);
    }
    (least, runs)
}

/// Cap on the runs of one setting; the least of their times counts.
const MOST_RUNS: usize = 5;
/// Cap on the seconds of all runs of one setting after the first.
const FOR_RUNS_S: f64 = 4.0;
