//! The results of one start of a search: its solves, and the best of them.

use super::transcription::LiftedPoint;
use sqp::{IterationRecord, SqpOutcome, SqpStatus};

/// One solve of a start.
#[derive(Clone, Debug, PartialEq)]
pub struct SolveLog {
    /// Name of its initial guess, `detour` or `previous`, with the stage or the duration if there are several.
    pub from: String,
    /// Rows of its iterations, in order.
    pub rows: Vec<IterationRecord>,
    /// Reason for the end of the solve, in words.
    pub ended: String,
}

impl SolveLog {
    /// Returns the number of iterations of the solve: its rows without that of the first point.
    pub(super) fn iterations(&self) -> usize {
        self.rows.len().saturating_sub(1)
    }
}

/// A solve other than that of the result: given up for another initial guess, or for another duration.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Abandoned {
    /// Name of the initial guess, or `held duration`.
    pub from: &'static str,
    /// Tells whether it ended at a point that is infeasible to first order.
    pub infeasible: bool,
    /// Number of its iterations.
    pub iterations: usize,
}

/// The result of one start.
#[derive(Clone, Debug)]
pub struct Attempt {
    /// Index of the start, from 0.
    pub start: usize,
    /// Name of the initial guess: that of a guess, `detour`, or `previous`.
    pub from: &'static str,
    /// Outcome of the solve; its objective includes the price of a free duration.
    pub outcome: SqpOutcome<LiftedPoint>,
    /// Duration of the outcome divided by that of the problem's grid; 1 if it is fixed.
    pub time_scale: f64,
    /// Earlier solves of the same start.
    pub abandoned: Vec<Abandoned>,
    /// All solves of this start in their order, with their rows.
    pub solves: Vec<SolveLog>,
    /// Index of the solve with the outcome.
    pub chosen: usize,
}

impl Attempt {
    /// Returns the number of iterations, including abandoned solves.
    #[must_use]
    pub fn iterations(&self) -> usize {
        if !self.solves.is_empty() {
            return self.solves.iter().map(SolveLog::iterations).sum();
        }
        let before: usize = self.abandoned.iter().map(|tried| tried.iterations).sum();
        before + iterations(&self.outcome)
    }

    /// Orders attempts: converged ones first, by objective; the others by infeasibility; equal ones by their starts.
    pub(super) fn rank(&self, other: &Self) -> std::cmp::Ordering {
        let converged = |attempt: &Self| attempt.outcome.status == SqpStatus::Converged;
        let value = |attempt: &Self| {
            if converged(attempt) {
                attempt.outcome.objective
            } else {
                attempt.outcome.residual.feasibility
            }
        };
        (converged(other).cmp(&converged(self)))
            .then(value(self).total_cmp(&value(other)))
            .then(self.start.cmp(&other.start))
    }

    /// Tells whether this attempt replaces an earlier one. An unfinished attempt does not replace one that is locally infeasible.
    pub(super) fn improves_on(&self, earlier: &Self) -> bool {
        let is_proven = |attempt: &Self| attempt.outcome.status == SqpStatus::LocallyInfeasible;
        let is_unfinished = self.outcome.status != SqpStatus::Converged && !is_proven(self);
        self.rank(earlier).is_lt() && !(is_proven(earlier) && is_unfinished)
    }
}

/// Returns the number of iterations of a solve.
pub(super) fn iterations(outcome: &SqpOutcome<LiftedPoint>) -> usize {
    outcome.history.len().saturating_sub(1)
}
