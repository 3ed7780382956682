//! A clock of processor time, which unlike wall time does not grow while other programs compute on the same machine.

use std::time::Instant;

/// A clock of the processor time of this process, all threads together; of wall time if the system does not report it.
#[derive(Clone, Copy, Debug)]
pub struct ProcessorClock {
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

impl ProcessorClock {
    /// Starts a clock.
    pub fn start() -> Self {
        Self {
            wall: Instant::now(),
            processor: processor_seconds(),
        }
    }

    /// Returns the wall time since the start, s.
    pub fn wall(&self) -> f64 {
        self.wall.elapsed().as_secs_f64()
    }

    /// Returns both times since the start.
    pub fn seconds(&self) -> Seconds {
        let wall = self.wall();
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
