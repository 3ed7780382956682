//! The reports of a search in progress: its events, and the named solves of one start.

use std::cell::RefCell;
use std::ops::ControlFlow;

use super::attempt::{Attempt, SolveLog};
use super::guess::GuessError;
use super::transcription::LiftedPoint;
use sqp::{IterationRecord, SqpOutcome, SqpStatus};
use stop::Stop;

/// An event of a search.
#[derive(Clone, Copy, Debug)]
pub enum SearchEvent<'a> {
    /// A start begins, before any of its solves. Every start that begins ends once.
    StartBegins {
        /// Index of the start, from 0.
        start: usize,
    },
    /// A solve begins.
    Begins {
        /// Index of the start, from 0.
        start: usize,
        /// Name of the initial guess.
        from: &'a str,
        /// Earlier solves of the same start.
        before: &'a [SolveLog],
    },
    /// A row of the solve that began last.
    Row {
        /// Index of the start, from 0.
        start: usize,
        /// The row.
        row: &'a IterationRecord,
    },
    /// A start has ended, after all of its solves.
    StartEnds {
        /// Index of the start, from 0.
        start: usize,
        /// The best of its solves; an error if it has no initial guess.
        found: Result<&'a Attempt, &'a GuessError>,
    },
}

/// Receives the events of a search; may stop a solve at each of its rows.
pub type Listener<'a> = dyn Fn(&SearchEvent) -> ControlFlow<Stop> + Sync + 'a;

/// The solves of one start while they run.
pub(super) struct Journal<'a> {
    start: usize,
    listener: &'a Listener<'a>,
    solves: RefCell<Vec<SolveLog>>,
}

impl<'a> Journal<'a> {
    pub(super) fn new(start: usize, listener: &'a Listener<'a>) -> Self {
        Self {
            start,
            listener,
            solves: RefCell::default(),
        }
    }

    /// Records the begin of a solve.
    pub(super) fn begin(&self, from: String) {
        {
            let before = self.solves.borrow();
            // A listener can stop the solve at its first row, not here.
            let _ = (self.listener)(&SearchEvent::Begins {
                start: self.start,
                from: &from,
                before: &before,
            });
        }
        self.solves.borrow_mut().push(SolveLog {
            from,
            rows: Vec::new(),
            ended: String::new(),
        });
    }

    /// Records a row of the present solve.
    pub(super) fn row(&self, row: &IterationRecord) -> ControlFlow<Stop> {
        if let Some(solve) = self.solves.borrow_mut().last_mut() {
            solve.rows.push(*row);
        }
        (self.listener)(&SearchEvent::Row {
            start: self.start,
            row,
        })
    }

    /// Returns the number of iterations of all solves so far.
    pub(super) fn iterations(&self) -> usize {
        self.solves.borrow().iter().map(SolveLog::iterations).sum()
    }

    /// Records the end of the present solve in words.
    pub(super) fn end(&self, words: impl Into<String>) {
        if let Some(solve) = self.solves.borrow_mut().last_mut() {
            solve.ended = words.into();
        }
    }

    /// Records the end of the present solve by its status.
    pub(super) fn end_as(&self, status: &SqpStatus) {
        self.end(match status {
            SqpStatus::Converged => "converged".to_string(),
            SqpStatus::LocallyInfeasible => "locally infeasible".into(),
            SqpStatus::IterationLimit => "out of iterations".into(),
            SqpStatus::StepTooSmall => "no step led on".into(),
            SqpStatus::RoundingLimit { .. } => "rounding limits the residuals".into(),
            SqpStatus::Stopped(_) => "stopped".into(),
            SqpStatus::Failed(reason) => reason.clone(),
        });
    }

    /// Returns all solves, and the index of the one with the given outcome.
    pub(super) fn close(&self, outcome: &SqpOutcome<LiftedPoint>) -> (Vec<SolveLog>, usize) {
        let solves = self.solves.take();
        let clock = |rows: &[IterationRecord]| rows.last().map(|row| row.elapsed.to_bits());
        let last = clock(&outcome.history);
        let chosen = solves
            .iter()
            .rposition(|solve| {
                solve.rows.len() == outcome.history.len() && clock(&solve.rows) == last
            })
            .unwrap_or(solves.len().saturating_sub(1));
        (solves, chosen)
    }
}
