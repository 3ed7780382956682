//! The record of a solve in progress.

use std::time::Instant;

use super::outcome::{IterationRecord, Leave, PhaseTimes};
use super::program::LiftedProgram;
use super::trial::Accepted;

/// Rows of the iterations, seconds of the phases, and failed subproblems.
pub(super) struct Trace {
    pub(super) started: Instant,
    pub(super) history: Vec<IterationRecord>,
    pub(super) phases: PhaseTimes,
    /// Number of subproblems without a solution, and the last of them as Clarabel's own JSON.
    pub(super) failures: usize,
    pub(super) failed_subproblem: Option<String>,
}

impl Trace {
    pub(super) fn new(started: Instant) -> Self {
        Self {
            started,
            history: Vec::new(),
            phases: PhaseTimes::default(),
            failures: 0,
            failed_subproblem: None,
        }
    }

    /// Writes an accepted step of the given length into the present row.
    pub(super) fn note_step<P: LiftedProgram>(&mut self, accepted: &Accepted<P>, length: f64) {
        let before = (self.history.iter().rev())
            .map(|row| row.step_norm)
            .find(|&step| step > 0.0);
        if let Some(row) = self.history.last_mut() {
            row.step.left = if length > 0.0 {
                Leave::Step
            } else {
                Leave::Settled
            };
            row.step_norm = length;
            row.contraction = before.map(|before| length / before);
            row.step.corrections = accepted.corrections;
            row.step.rolled_out = accepted.rolled_out;
        }
    }
}
