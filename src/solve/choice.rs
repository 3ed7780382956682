//! Selects the result among several attempts: the best one that is certified, or else the best one.

use super::examined::{Examined, Spent, examine};
use super::solution::Solution;
use super::summary::{start_not_begun, start_summary, status_words};
use crate::control::{Attempt, FeedbackWeights};
use crate::output::summary::{NOT_CHECKED, StartSummary};
use crate::sqp::{SqpSettings, SqpStatus};
use crate::task::Problem;
use crate::verify::ForwardCheck;

/// Result of a search.
pub(crate) struct Chosen {
    pub solution: Solution,
    pub examined: Examined,
    /// Status and verdict of every start.
    pub starts: Vec<StartSummary>,
    /// Time spent on the checks of all attempts and on the gains of the result.
    pub spent: Spent,
}

impl Chosen {
    /// Tells whether the solve converged and the check certifies what it found.
    pub fn is_certified(&self) -> bool {
        self.examined.is_certified() && self.solution.has_converged()
    }
}

/// Extent of the examination of solutions.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Examination<'a> {
    /// Weights of the regulator around a converged solution; `None` for no regulator.
    pub feedback: Option<&'a FeedbackWeights>,
    /// `true` to examine the second-order condition and the growth of disturbances in any case.
    pub deep: bool,
    /// Number of threads.
    pub n_threads: usize,
}

/// Returns the best converged attempt that the check certifies, or else the best attempt.
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
        let mut start = start_summary(&attempt);
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
    // Starts whose attempts were never begun, as the work was stopped before.
    let missing = (0..n_starts).filter(|at| !starts.iter().any(|start| start.start == *at));
    let missing: Vec<usize> = missing.collect();
    let status = (problem.discrete.stop.raised()).map_or("failed", |stop| {
        status_words(&SqpStatus::Stopped(stop), &[]).0
    });
    starts.extend((missing.into_iter()).map(|start| start_not_begun(start, status)));
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
