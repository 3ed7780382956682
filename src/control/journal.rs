//! What a search reports while it runs: events, and the solves of one start by name.

use std::cell::RefCell;
use std::ops::ControlFlow;

use super::guess::GuessError;
use super::search::Attempt;
use super::transcription::LiftedPoint;
use crate::sqp::{IterationRecord, SqpOutcome, SqpStatus};
use crate::stop::Stop;

/// One solve of a start.
#[derive(Clone, Debug, PartialEq)]
pub struct SolveLog {
    /// What it began from: name of a guess, `detour` or `previous`, with the stage or the duration where there are several.
    pub from: String,
    /// Its rows, in order.
    pub rows: Vec<IterationRecord>,
    /// How the solve ended, in words.
    pub ended: String,
}

impl SolveLog {
    /// Iterations of the solve: its rows without that of the first point.
    pub(super) fn iterations(&self) -> usize {
        self.rows.len().saturating_sub(1)
    }
}

/// An event of a search.
#[derive(Clone, Copy, Debug)]
pub enum SearchEvent<'a> {
    /// A start begins, before any of its solves. Every start that begins ends once.
    StartBegins {
        /// Its number, from 0.
        start: usize,
    },
    /// A solve begins; `before` are those of the same start that came before it.
    Begins {
        /// Number of the start, from 0.
        start: usize,
        /// Name of the first point.
        from: &'a str,
        /// The solves before it.
        before: &'a [SolveLog],
    },
    /// A row of the solve that began last.
    Row {
        /// Number of the start, from 0.
        start: usize,
        /// The row.
        row: &'a IterationRecord,
    },
    /// A start has ended, after all of its solves.
    StartEnds {
        /// Its number, from 0.
        start: usize,
        /// The best of its solves; an error where it has no first point.
        found: Result<&'a Attempt, &'a GuessError>,
    },
}

/// Receives the events of a search; may stop a solve at each of its rows.
pub type Listener<'a> = dyn Fn(&SearchEvent) -> ControlFlow<Stop> + Sync + 'a;

/// The solves of one start, as they happen.
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

    /// A solve begins.
    pub(super) fn begin(&self, from: String) {
        {
            let before = self.solves.borrow();
            // It is stopped at its first row, if at all.
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

    /// A row of the present solve.
    pub(super) fn row(&self, row: &IterationRecord) -> ControlFlow<Stop> {
        if let Some(solve) = self.solves.borrow_mut().last_mut() {
            solve.rows.push(*row);
        }
        (self.listener)(&SearchEvent::Row {
            start: self.start,
            row,
        })
    }

    /// Iterations of all solves so far.
    pub(super) fn iterations(&self) -> usize {
        self.solves.borrow().iter().map(SolveLog::iterations).sum()
    }

    /// How the present solve ended.
    pub(super) fn end(&self, words: impl Into<String>) {
        if let Some(solve) = self.solves.borrow_mut().last_mut() {
            solve.ended = words.into();
        }
    }

    /// How the present solve ended, by its status.
    pub(super) fn end_as(&self, status: &SqpStatus) {
        self.end(match status {
            SqpStatus::Converged => "converged".to_string(),
            SqpStatus::LocallyInfeasible => "locally infeasible".into(),
            SqpStatus::IterationLimit => "out of iterations".into(),
            SqpStatus::StepTooSmall => "no step led on".into(),
            SqpStatus::Stopped(_) => "stopped".into(),
            SqpStatus::Failed(reason) => reason.clone(),
        });
    }

    /// All solves, and which of them has this outcome.
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
