//! A clock of processor time, which unlike wall time does not grow while other programs compute on the same machine.

use std::time::Instant;

/// A clock of the processor time of this process, all threads together; of wall time if the system does not report it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clock {
    wall: Instant,
    processor: Option<f64>,
}

/// Seconds that a piece of work took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seconds {
    /// Wall time, s.
    pub wall: f64,
    /// Processor time, s.
    pub processor: f64,
}

impl Clock {
    pub(super) fn start() -> Self {
        Self {
            wall: Instant::now(),
            processor: processor_seconds(),
        }
    }

    pub(super) fn seconds(&self) -> Seconds {
        let wall = self.wall.elapsed().as_secs_f64();
        let processor = (self.processor.zip(processor_seconds())).map(|(from, to)| to - from);
        Seconds {
            wall,
            processor: processor.unwrap_or(wall),
        }
    }
}

#[cfg(unix)]
fn processor_seconds() -> Option<f64> {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Some(time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64)
}

#[cfg(not(unix))]
fn processor_seconds() -> Option<f64> {
    None
}

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
