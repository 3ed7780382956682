//! The two phases of a sample, in their order by type.

use std::ops::Deref;

use super::{Controller, SampleRecord};
use crate::command::Command;
use crate::error::MpcError;

/// The command of a sample whose next one is not prepared yet.
///
/// The plant gets the command first, and [`prepare`](Self::prepare) follows. Without it, the next [`feedback`](Controller::feedback)
/// responds to the state of the same sample again.
#[derive(Debug)]
#[must_use = "Issued::prepare makes the controller ready for the next sample"]
pub struct Issued<'a>(pub(super) &'a mut Controller);

impl Issued<'_> {
    /// Returns times and results of the sample so far.
    #[must_use]
    pub fn record(&self) -> &SampleRecord {
        self.0.record()
    }

    /// Predicts the state of the next sample under the command, moves the horizon and linearizes the plan's motion.
    ///
    /// # Errors
    /// Returns [`MpcError::Rollout`] if the model's motion breaks down.
    pub fn prepare(self) -> Result<(), MpcError> {
        self.0.prepare()
    }
}

impl Deref for Issued<'_> {
    type Target = Command;

    fn deref(&self) -> &Command {
        self.0.command()
    }
}
