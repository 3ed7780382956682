//! Motions of a model whose parameters change from one motion to the next.

use super::ModelParameters;
use mechanics::{Rod, State, Stepper, StepperMemory};

/// Memory that motions of a model reuse. Its constants belong to a step length and to parameters of the model, and are computed anew for a
/// motion with others.
#[derive(Clone, Debug)]
pub(crate) struct Motions {
    /// Empty only while a motion runs.
    memory: Option<StepperMemory>,
    tuned: (f64, ModelParameters),
}

impl Motions {
    /// Creates memory for motions of `rod`, which has these parameters, with steps of `step` (s).
    pub fn new(rod: &Rod, step: f64, parameters: ModelParameters) -> Self {
        Self {
            memory: Some(StepperMemory::new(rod, step)),
            tuned: (step, parameters),
        }
    }

    /// Runs a motion of `rod`, which has these parameters, with steps of `step` (s) from time `start` (s) on, and moves `state` along it: to its
    /// end, or to where it broke down.
    pub fn run<T>(
        &mut self,
        (rod, parameters): (&Rod, ModelParameters),
        step: f64,
        (start, state): (f64, &mut State),
        motion: impl FnOnce(&mut Stepper) -> T,
    ) -> T {
        let kept = self.memory.take();
        let mut memory = kept.unwrap_or_else(|| StepperMemory::new(rod, step));
        if self.tuned != (step, parameters) {
            memory.retune(rod, step);
            self.tuned = (step, parameters);
        }
        let mut stepper = memory.begin(rod, start, state);
        let out = motion(&mut stepper);
        stepper.write_state(state);
        self.memory = Some(stepper.into_memory());
        out
    }
}
