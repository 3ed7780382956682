//! Motions of the model that begin at an estimate.

use crate::command::{Command, ControlOrder, ControlledPart, Controls};
use crate::signal::EARLY;
use mechanics::{ControlSignal, Rod, State, StepError, Stepper, TimeGrid};

use super::{Disturbance, EstimateError, ModelParameters, Motions};

/// Moves a state of the model under commands and a disturbance. After its creation it allocates no memory if steps are explicit.
#[derive(Clone, Debug)]
pub struct Predictor {
    model: Rod,
    /// The model with the corrections of a disturbance, and their values.
    rod: Rod,
    /// The same with no more internal damping than the model.
    least_damped: Rod,
    parameters: ModelParameters,
    longest_step: f64,
    motions: Motions,
    order: ControlOrder,
    /// Controls at both ends of a step.
    controls: [Controls; 2],
    /// State at the end of the last motion.
    end: State,
}

/// Equal steps from a given time on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Steps {
    pub start: f64,
    pub step: f64,
    pub n: usize,
}

impl Steps {
    /// Returns the time after `k` steps, s.
    fn time(&self, k: usize) -> f64 {
        self.start + k as f64 * self.step
    }

    /// Returns at most `most` of the steps, from step `first` on.
    pub fn part(&self, first: usize, most: usize) -> Self {
        Self {
            start: self.time(first),
            n: most.min(self.n - first),
            ..*self
        }
    }
}

impl Predictor {
    /// Creates a predictor of motions of `model` with steps of at most `longest_step` (s).
    #[must_use]
    pub fn new(model: &Rod, longest_step: f64) -> Self {
        let order = ControlOrder::on_all(model);
        Self {
            motions: Motions::new(model, longest_step, Disturbance::NONE.parameters()),
            rod: model.clone(),
            least_damped: model.clone(),
            parameters: Disturbance::NONE.parameters(),
            model: model.clone(),
            longest_step,
            controls: [(); 2].map(|()| order.none()),
            order,
            end: State::at_rest(model.rest.clone()),
        }
    }

    /// Moves `state` from `start` to `end` (s) in equal steps, under a command that acts all the time and a constant disturbance.
    ///
    /// # Errors
    /// Returns [`EstimateError`] as [`Estimator::advance`](super::Estimator::advance) does; `state` is then unchanged.
    pub fn advance(
        &mut self,
        state: &mut State,
        [start, end]: [f64; 2],
        command: &Command,
        disturbance: &Disturbance,
    ) -> Result<(), EstimateError> {
        if let Some(steps) = self.steps(start, end)? {
            self.check(command)?;
            self.roll_out(state, steps, command, disturbance, |_| ())?;
            state.clone_from(&self.end);
        }
        Ok(())
    }

    /// Returns the model.
    pub(super) fn model(&self) -> &Rod {
        &self.model
    }

    /// Returns the model with the corrections of a disturbance.
    pub(super) fn changed(&mut self, disturbance: &Disturbance) -> &Rod {
        self.change(disturbance);
        &self.rod
    }

    /// Corrects the model by a disturbance.
    pub(super) fn change(&mut self, disturbance: &Disturbance) {
        let parameters = disturbance.parameters();
        if self.parameters != parameters {
            disturbance.change_model(&self.model, &mut self.rod);
            disturbance.change_model(&self.model, &mut self.least_damped);
            let least = self.model.internal_damping.min(self.rod.internal_damping);
            self.least_damped.internal_damping = least;
            self.parameters = parameters;
        }
    }

    /// Returns the model with the last corrections.
    pub(super) fn rod(&self) -> &Rod {
        &self.rod
    }

    /// Returns the same with no more internal damping than the model has. Of an internal damping that is estimated nobody knows that it is there; it
    /// would let the errors of all fast waves die out.
    pub(super) fn least_damped(&self) -> &Rod {
        &self.least_damped
    }

    /// Returns the state at the end of the last motion.
    pub(super) fn end(&self) -> &State {
        &self.end
    }

    /// Returns the steps from one time to another; none if these are equal up to rounding.
    pub(super) fn steps(&self, start: f64, end: f64) -> Result<Option<Steps>, EstimateError> {
        let n = (end - start) / self.longest_step;
        if n.abs() <= EARLY {
            return Ok(None);
        }
        if !n.is_finite() {
            let what = "the time to advance to".into();
            return Err(EstimateError::NotFinite { what });
        }
        if n < 0.0 {
            return Err(EstimateError::Ahead {
                time: end,
                estimate: start,
            });
        }
        let TimeGrid { n_steps, step, .. } = TimeGrid::covering(end - start, self.longest_step, 1);
        Ok(Some(Steps {
            start,
            step,
            n: n_steps,
        }))
    }

    /// Checks that a command is valid for this model.
    pub(super) fn check(&self, command: &Command) -> Result<(), EstimateError> {
        let n_nodes = self.model.n_nodes();
        if let Some(&node) = command.nodes().iter().find(|node| **node >= n_nodes) {
            return Err(EstimateError::Node { node, n_nodes });
        }
        let n_actuators = self.model.actuators.len();
        let controls = command.list.controls();
        for effect in controls.iter().flat_map(|control| &control.effects) {
            if let ControlledPart::Effort(actuator) = effect.on
                && actuator >= n_actuators
            {
                return Err(EstimateError::Actuator {
                    actuator,
                    n_actuators,
                });
            }
        }
        for values in [&command.from, &command.to, &command.acting] {
            if values.len() != controls.len() {
                return Err(EstimateError::Values {
                    given: values.len(),
                    n_controls: controls.len(),
                });
            }
            let named = command.list.named().zip(values);
            if let Some((own, _)) = named.into_iter().find(|(_, value)| !value.is_finite()) {
                let what = format!("{} of the command", own.name);
                return Err(EstimateError::NotFinite { what });
            }
        }
        if command.start < command.end {
            return Ok(());
        }
        Err(EstimateError::Span {
            start: command.start,
            end: command.end,
        })
    }

    /// Simulates steps from a state, calls `visit` at every time node after the first, and leaves the last state in [`end`](Self::end).
    pub(super) fn roll_out(
        &mut self,
        from: &State,
        steps: Steps,
        command: &Command,
        disturbance: &Disturbance,
        mut visit: impl FnMut(&Stepper),
    ) -> Result<(), StepError> {
        self.end.clone_from(from);
        self.changed(disturbance);
        let Self {
            rod,
            parameters,
            motions,
            order,
            controls: [now, next],
            end,
            ..
        } = self;
        let start = steps.time(0);
        let model = (&*rod, *parameters);
        motions.run(model, steps.step, (start, end), |stepper| {
            write_controls(rod, command, start, disturbance, now);
            for k in 0..steps.n {
                write_controls(rod, command, steps.time(k + 1), disturbance, next);
                stepper.advance([order.of(now), order.of(next)])?;
                visit(stepper);
                std::mem::swap(now, next);
            }
            Ok(())
        })
    }

    /// Writes the controls of a command and a disturbance at the time nodes of some steps, on a rod that the disturbance has changed.
    pub(super) fn write_signal(
        &self,
        rod: &Rod,
        steps: Steps,
        (command, disturbance): (&Command, &Disturbance),
        out: &mut MotionSignal,
    ) {
        let MotionSignal { signal, room } = out;
        signal.wrenches.clear();
        signal.inputs.clear();
        for k in 0..=steps.n {
            write_controls(rod, command, steps.time(k), disturbance, room);
            signal.wrenches.extend_from_slice(&room.wrenches);
            signal.inputs.extend_from_slice(&room.efforts);
        }
    }

    /// Returns the memory for [`Self::write_signal`].
    pub(super) fn signal(&self) -> MotionSignal {
        MotionSignal {
            signal: ControlSignal {
                nodes: self.order.nodes.clone(),
                n_inputs: self.order.n_efforts(),
                efforts: self.order.efforts.clone(),
                ..ControlSignal::default()
            },
            room: self.order.none(),
        }
    }
}

/// The controls of a motion at its time nodes, on all nodes and actuators of the rod.
#[derive(Clone, Debug)]
pub(super) struct MotionSignal {
    pub signal: ControlSignal,
    room: Controls,
}

/// Writes the controls of a command and a disturbance at time `t`.
fn write_controls(
    rod: &Rod,
    command: &Command,
    t: f64,
    disturbance: &Disturbance,
    out: &mut Controls,
) {
    out.clear();
    disturbance.add_to(rod, &mut out.wrenches);
    command.add_at(t, out);
}
