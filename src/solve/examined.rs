//! Check and regulator of a solution, computed in parallel.

use std::panic::resume_unwind;
use std::time::Instant;

use super::solution::Solution;
use crate::control::{Feedback, FeedbackError, FeedbackWeights, ModelMismatch};
use crate::mechanics::StepError;
use crate::stop::Stop;
use crate::verify::{CheckError, ForwardCheck};

/// Check and regulator of a solution.
#[derive(Clone, Debug, Default)]
pub(crate) struct Examined {
    /// The check, if it could be made.
    pub check: Option<ForwardCheck>,
    /// Reason why the check was not completed.
    pub unchecked: Option<Stop>,
    /// The regulator, if it was asked for and found.
    pub feedback: Option<Feedback>,
    /// Effect of the regulator on arms that differ from the model.
    pub mismatches: Vec<ModelMismatch>,
    /// Reason why a regulator that was asked for was not computed.
    pub without_gains: Option<Stop>,
    /// Other failures, in sentences.
    pub warnings: Vec<String>,
}

/// Seconds spent on examining solutions.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Spent {
    /// Seconds spent on checks.
    pub certify: f64,
    /// Seconds spent on gains.
    pub feedback: f64,
}

/// Computes the check and the regulator of a solution, in parallel if there is more than one thread.
pub(crate) fn examine(
    solution: &Solution,
    feedback: Option<&FeedbackWeights>,
    deep: bool,
    n_threads: usize,
) -> (Examined, Spent) {
    let others = n_threads.saturating_sub(1).max(1);
    let weights = feedback.filter(|_| solution.has_converged());
    let (check, gains) = beside(
        n_threads,
        || Timed::of(|| solution.certify_deeply(deep)),
        || {
            Timed::of(|| {
                weights.map(|weights| {
                    let gains = solution.regulator(weights, others)?;
                    let mismatches = solution.mismatches(&gains)?;
                    Ok::<_, FeedbackError>((gains, mismatches))
                })
            })
        },
    );
    let spent = Spent {
        certify: check.seconds,
        feedback: gains.seconds,
    };
    let mut examined = Examined::default();
    match check.found {
        Ok(check) => examined.check = Some(check),
        Err(error) => match CheckError::stopped(&error) {
            Some(stop) => examined.unchecked = Some(stop),
            None => (examined.warnings).push(format!("the check could not be made: {error}")),
        },
    }
    match gains.found.transpose() {
        Ok(Some((gains, mismatches))) => {
            examined.feedback = Some(gains);
            examined.mismatches = mismatches;
        }
        Ok(None) => {}
        Err(FeedbackError::Step(StepError::Stopped(stop))) => examined.without_gains = Some(stop),
        Err(error) => (examined.warnings).push(format!("no feedback gains: {error}")),
    }
    (examined, spent)
}

/// A result and the time that its computation took.
struct Timed<T> {
    found: T,
    seconds: f64,
}

impl<T> Timed<T> {
    fn of(find: impl FnOnce() -> T) -> Self {
        let clock = Instant::now();
        let found = find();
        Self {
            found,
            seconds: clock.elapsed().as_secs_f64(),
        }
    }
}

/// Returns the results of both functions; the second one runs on a thread of its own unless `n_threads` is 1.
pub(super) fn beside<A, B: Send>(
    n_threads: usize,
    first: impl FnOnce() -> A,
    second: impl FnOnce() -> B + Send,
) -> (A, B) {
    if n_threads == 1 {
        return (first(), second());
    }
    std::thread::scope(|scope| {
        let second = scope.spawn(second);
        let first = first();
        let second = second.join();
        (first, second.unwrap_or_else(|panic| resume_unwind(panic)))
    })
}
