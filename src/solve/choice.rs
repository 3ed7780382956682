//! Which of several attempts is the result: the best one that the check certifies, or else the best.

use std::panic::resume_unwind;
use std::time::Instant;

use super::solution::Solution;
use super::summary::status_words;
use crate::control::{Attempt, Feedback, FeedbackError, FeedbackWeights};
use crate::mechanics::StepError;
use crate::output::summary::{NOT_CHECKED, StartSummary};
use crate::sqp::{SqpSettings, SqpStatus};
use crate::stop::Stop;
use crate::task::Problem;
use crate::verify::{CheckError, ForwardCheck};

/// What was found out about a solution.
#[derive(Clone, Debug, Default)]
pub(crate) struct Examined {
    /// The check, if it could be made.
    pub check: Option<ForwardCheck>,
    /// Why the check was not made to its end.
    pub unchecked: Option<Stop>,
    /// The regulator, if it was asked for and found.
    pub feedback: Option<Feedback>,
    /// Why a regulator that was asked for was not found any more.
    pub without_gains: Option<Stop>,
    /// What else went wrong, in sentences.
    pub warnings: Vec<String>,
}

impl Examined {
    fn is_certified(&self) -> bool {
        self.check.as_ref().is_some_and(ForwardCheck::is_certified)
    }

    fn verdict(&self) -> Option<&'static str> {
        match (&self.check, self.unchecked) {
            (Some(check), _) => Some(check.verdict()),
            (None, Some(_)) => Some(NOT_CHECKED),
            (None, None) => None,
        }
    }
}

/// Seconds that were spent on examining.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Spent {
    /// On checks.
    pub certify: f64,
    /// On gains.
    pub feedback: f64,
}

/// What a search ends with.
pub(crate) struct Chosen {
    pub solution: Solution,
    pub examined: Examined,
    /// How all starts fared.
    pub starts: Vec<StartSummary>,
    /// The checks of all attempts, and the gains of the result.
    pub spent: Spent,
}

/// What is examined, and how.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Examination<'a> {
    /// Weights of the regulator around a converged solution; none where there should be none.
    pub feedback: Option<&'a FeedbackWeights>,
    /// Whether the second-order condition and the growth of disturbances are examined in any case.
    pub deep: bool,
    /// Threads.
    pub n_threads: usize,
}

/// The best attempt that the check certifies, or else the best.
pub(crate) fn choose(
    problem: &Problem,
    settings: &SqpSettings,
    attempts: Vec<Attempt>,
    n_starts: usize,
    how: &Examination,
) -> Chosen {
    let mut starts = Vec::new();
    let mut chosen: Option<(Solution, Examined, f64)> = None;
    let mut certify = 0.0;
    let mut warnings = Vec::new();
    let certified = |solution: &Solution, examined: &Examined| {
        examined.is_certified() && solution.has_converged()
    };
    for attempt in attempts {
        let settled =
            (chosen.as_ref()).is_some_and(|(solution, examined, _)| certified(solution, examined));
        let mut start = StartSummary {
            start: attempt.start,
            from: attempt.from,
            status: status_words(&attempt.outcome.status, &[]).0,
            objective: attempt.outcome.objective,
            iterations: attempt.iterations(),
            verdict: None,
        };
        // Worse than a certified one, or not converged while another is: nothing to check.
        let worth =
            chosen.is_none() || (!settled && attempt.outcome.status == SqpStatus::Converged);
        if worth {
            let solution = Solution::of(problem, settings, attempt);
            let (mut examined, spent) = examine(&solution, how.feedback, how.deep, how.n_threads);
            certify += spent.certify;
            start.verdict = examined.verdict();
            warnings.append(&mut examined.warnings);
            if chosen.is_none() || certified(&solution, &examined) {
                chosen = Some((solution, examined, spent.feedback));
            }
        }
        starts.push(start);
    }
    // Those that nobody waited for.
    let missing = (0..n_starts).filter(|at| !starts.iter().any(|start| start.start == *at));
    let missing: Vec<usize> = missing.collect();
    starts.extend(missing.into_iter().map(|start| StartSummary {
        start,
        from: "not begun",
        status: (problem.discrete.stop.raised()).map_or("failed", |stop| {
            status_words(&SqpStatus::Stopped(stop), &[]).0
        }),
        objective: f64::NAN,
        iterations: 0,
        verdict: None,
    }));
    starts.sort_by_key(|start| start.start);
    let Some((solution, examined, feedback)) = chosen else {
        unreachable!("a search has at least one attempt")
    };
    Chosen {
        solution,
        examined: Examined {
            warnings,
            ..examined
        },
        starts,
        spent: Spent { certify, feedback },
    }
}

/// The check and the regulator of a solution, beside each other if there is more than one thread.
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
        || Timed::of(|| weights.map(|weights| solution.regulator(weights, others))),
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
        Ok(found) => examined.feedback = found,
        Err(FeedbackError::Step(StepError::Stopped(stop))) => examined.without_gains = Some(stop),
        Err(error) => (examined.warnings).push(format!("no feedback gains: {error}")),
    }
    (examined, spent)
}

/// What was found, and the time that it took.
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

/// Both results, the second from a thread of its own if there may be more than one.
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
