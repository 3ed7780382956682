//! Deadlines and requests to stop.
//!
//! The caller of long work makes a [`StopSignal`] and passes it in; loops read it every few milliseconds at least. A raised signal stays
//! raised. A loop that finds it raised may therefore return an incomplete result: its caller also reads the signal and discards that
//! result.

#![forbid(unsafe_code)]

pub mod clock;

use std::panic::resume_unwind;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

/// The reason why work ended before it was done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Stop {
    /// The user or the caller asked for it.
    #[error("interrupted")]
    Interrupted,
    /// The deadline has passed.
    #[error("out of time")]
    Deadline,
}

/// Number of turns of a counting loop between two readings of the signal, which take at most some milliseconds.
const EVERY: usize = 32;

/// Size of dense matrices from which their factorizations take more than some hundredths of a second.
pub const LARGE: usize = 300;

/// Time between two readings of the signal while another thread works.
const GLANCE: Duration = Duration::from_millis(5);

/// A deadline and a request to stop. The default is never raised.
#[derive(Clone, Debug, Default)]
pub struct StopSignal {
    deadline: Option<Instant>,
    request: Option<Arc<AtomicBool>>,
}

impl StopSignal {
    /// Creates a signal that is raised from `deadline` on, if there is one, and as soon as `request` is true; `request` must not become
    /// false again.
    #[must_use]
    pub fn new(deadline: Option<Instant>, request: Option<Arc<AtomicBool>>) -> Self {
        Self { deadline, request }
    }

    /// Creates a signal that is raised from `deadline` on.
    #[must_use]
    pub fn at(deadline: Instant) -> Self {
        Self::new(Some(deadline), None)
    }

    /// Returns a signal with the same request and another deadline.
    #[must_use]
    pub fn with_deadline(&self, deadline: Option<Instant>) -> Self {
        Self::new(deadline, self.request.clone())
    }

    /// Returns the same signal, raised from `deadline` on at the latest.
    #[must_use]
    pub fn no_later_than(&self, deadline: Instant) -> Self {
        let earlier = self.deadline.map_or(deadline, |own| own.min(deadline));
        self.with_deadline(Some(earlier))
    }

    /// Tells whether the signal can ever be raised.
    #[must_use]
    pub fn is_possible(&self) -> bool {
        self.deadline.is_some() || self.request.is_some()
    }

    /// Returns the reason to end the work, if the signal is raised.
    #[must_use]
    pub fn raised(&self) -> Option<Stop> {
        if (self.request.as_ref()).is_some_and(|request| request.load(Ordering::Relaxed)) {
            return Some(Stop::Interrupted);
        }
        (self.deadline)
            .is_some_and(|deadline| Instant::now() >= deadline)
            .then_some(Stop::Deadline)
    }

    /// Tells whether the signal is raised.
    #[must_use]
    pub fn is_raised(&self) -> bool {
        self.raised().is_some()
    }

    /// Returns [`Self::raised`] as a result.
    ///
    /// # Errors
    /// Returns [`Stop`] if the signal is raised.
    pub fn check(&self) -> Result<(), Stop> {
        self.raised().map_or(Ok(()), Err)
    }

    /// Checks as [`Self::check`] does, in a loop with turns of microseconds: the signal is read at some counts only.
    ///
    /// # Errors
    /// Returns [`Stop`] if the signal is raised.
    pub fn check_at(&self, count: usize) -> Result<(), Stop> {
        if count.is_multiple_of(EVERY) {
            self.check()
        } else {
            Ok(())
        }
    }

    /// Returns `work()`, a dense factorization of matrices of the given size, which cannot read the signal itself. The factorization of
    /// large matrices, which may take long, runs on a thread of its own, which is abandoned if the signal is raised before it ends; others,
    /// and all if the signal cannot be raised, run on this thread.
    ///
    /// # Errors
    /// Returns [`Stop`] if the signal was raised first.
    pub fn unless_raised<T: Send + 'static>(
        &self,
        size: usize,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Stop> {
        self.check()?;
        if size < LARGE || !self.is_possible() {
            return Ok(work());
        }
        let (send, receive) = mpsc::channel();
        let worker = std::thread::spawn(move || {
            // After the signal was raised, there is no receiver any more.
            let _ = send.send(work());
        });
        loop {
            match receive.recv_timeout(GLANCE) {
                Ok(found) => return Ok(found),
                Err(RecvTimeoutError::Timeout) => self.check()?,
                Err(RecvTimeoutError::Disconnected) => match worker.join() {
                    Err(panic) => resume_unwind(panic),
                    Ok(()) => unreachable!("a worker sends before it ends"),
                },
            }
        }
    }
}

/// Two signals are equal if they share one request and have one deadline.
impl PartialEq for StopSignal {
    fn eq(&self, other: &Self) -> bool {
        let same_request = match (&self.request, &other.request) {
            (None, None) => true,
            (Some(a), Some(b)) => Arc::ptr_eq(a, b),
            _ => false,
        };
        same_request && self.deadline == other.deadline
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A signal is raised by its request at once, by its deadline from then on, and by default never; a request takes precedence over a
    /// deadline.
    #[test]
    fn signals_are_raised_by_requests_and_deadlines() {
        let now = Instant::now();
        let request = Arc::new(AtomicBool::new(false));
        let later = StopSignal::new(Some(now + Duration::from_secs(3600)), Some(request.clone()));
        let over = StopSignal::new(Some(now), Some(request.clone()));
        assert_eq!(StopSignal::default().raised(), None);
        assert_eq!(later.raised(), None);
        assert_eq!(over.raised(), Some(Stop::Deadline));
        assert_eq!(over.check_at(1), Ok(()));
        assert_eq!(over.check_at(2 * EVERY), Err(Stop::Deadline));
        request.store(true, Ordering::Relaxed);
        assert_eq!(later.raised(), Some(Stop::Interrupted));
        assert_eq!(over.raised(), Some(Stop::Interrupted));
        assert!(!StopSignal::default().is_possible() && later.is_possible());
    }

    /// Work that does not read the signal is waited for, on whichever thread it runs; if the signal is raised meanwhile, waiting ends
    /// although the work never does; a panic reaches the caller.
    #[test]
    fn work_is_abandoned_once_the_signal_is_raised() {
        let request = Arc::new(AtomicBool::new(false));
        let signal = StopSignal::new(None, Some(request.clone()));
        assert_eq!(StopSignal::default().unless_raised(LARGE, || 3), Ok(3));
        assert_eq!(signal.unless_raised(LARGE, || 3), Ok(3));
        let failed = std::panic::catch_unwind(|| {
            signal.unless_raised(LARGE, || -> u8 { panic!("on purpose") })
        });
        assert!(failed.is_err());
        let ended: Result<(), Stop> = signal.unless_raised(LARGE, move || {
            request.store(true, Ordering::Relaxed);
            loop {
                std::thread::park();
            }
        });
        assert_eq!(ended, Err(Stop::Interrupted));
        assert_eq!(signal.unless_raised(1, || 3), Err(Stop::Interrupted));
    }
}
