//! Motions of the model from an estimate on.

use crate::mechanics::{Rod, State, StepError};
use crate::mpc::controller::Command;

use super::Disturbance;

/// Moves a state of the model under commands and a disturbance. It asks for no memory after it is made, where steps are explicit.
#[derive(Clone, Debug)]
pub struct Predictor {
    model: Rod,
    longest_step: f64,
}

impl Predictor {
    /// For motions of `model` with steps of at most `longest_step` (s).
    #[must_use]
    pub fn new(model: &Rod, longest_step: f64) -> Self {
        Self {
            model: model.clone(),
            longest_step,
        }
    }

    /// Moves `state` from `start` to `end` (s) in equal steps, under a command that acts all along and a constant disturbance.
    ///
    /// # Errors
    /// [`StepError`] where the motion breaks down; `state` is then as it was.
    pub fn advance(
        &mut self,
        state: &mut State,
        [start, end]: [f64; 2],
        command: &Command,
        disturbance: &Disturbance,
    ) -> Result<(), StepError> {
        todo!("{state:?} {start} {end} {command:?} {disturbance:?} {self:?}")
    }
}
