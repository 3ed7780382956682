//! The computing side of a loop: a controller with its estimator, the commands that were sent, and the fallbacks for samples without a
//! command.

mod responded;

use std::collections::VecDeque;
use std::time::Instant;

use nalgebra::{Matrix3, Vector3};

pub use self::responded::Responded;
use super::fallback::Fallback;
use super::law::TipLaw;
use super::{Action, Cause, Computing, Law, LoopSettings, Sample};
use crate::command::Command;
use crate::controller::Controller;
use crate::error::MpcError;
use crate::estimator::{Disturbance, Estimate, EstimateError, Estimator, Inbox, Predictor};
use crate::signal::Measurement;
use control::rounding_of;
use mechanics::State;
use stop::clock::ProcessorClock;

/// Cap on consecutive failures of an estimator, after which it restarts from the start of the task: a single one may be a bad reading, and
/// the gate believes a signal after as many refusals.
const MOST_FAILURES: usize = 3;

/// Drives a plant of any kind: a simulated arm, another simulator, or hardware.
///
/// A sample at `t_k = k T` is
///
/// ```text
/// put       every measurement that has become known, if there is an estimator
/// respond   estimate, prediction over the delays, feedback: a Responded
/// told      the command, for the actuators
/// prepare   the next sample, after the command has been sent
/// ```
///
/// [`ClosedLoop`](super::ClosedLoop) is a driver with a simulated arm, and a [`Server`](crate::Server) one with a plant in another
/// process.
pub struct Driver {
    controller: Controller,
    estimator: Option<Box<dyn Estimator>>,
    settings: LoopSettings,
    predictor: Predictor,
    tip_law: Option<TipLaw>,
    fallback: Fallback,
    inbox: Inbox,
    /// Commands by the time from which they act, the earliest first; the first one also acts at all times before.
    sent: VecDeque<Command>,
    told: Command,
    /// Memory for a command shifted by the actuators' delay.
    late: Command,
    measurement: Measurement,
    state: State,
    /// State at the time of the last knowledge.
    known: State,
    disturbance: Disturbance,
    deviation: Disturbance,
    /// Time of the estimate, s, and time of the last measurement that it has used.
    known_at: f64,
    corrected_at: f64,
    /// Number of failures of the estimator since the last measurement that it used.
    failures: usize,
    index: usize,
    begin: ProcessorClock,
    /// Time that the computation of the last command took, s.
    computing: f64,
    /// Tells whether the controller needs a restart.
    is_lost: bool,
}

/// State of knowledge at the beginning of a sample.
#[derive(Clone, Copy, Debug)]
pub enum Known<'a> {
    /// The whole state at the time of the sample, on the nodes of the model.
    State(&'a State),
    /// The measurements that were [put](Driver::put), for the estimator.
    Measurements,
    /// No state and no measurement, for the given reason.
    Nothing(Cause),
}

impl std::fmt::Debug for Driver {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Driver")
            .field("settings", &self.settings)
            .field("index", &self.index)
            .finish_non_exhaustive()
    }
}

impl Driver {
    /// Creates a driver whose first sample is at time 0. The controller's first command must act from the time that computing and actuators
    /// allow: [`MpcSettings::start`](crate::MpcSettings) is [`LoopSettings::lead`]. An estimator must be at time 0, in the state in
    /// which the task begins; `lag` (s) is the largest age of a measurement.
    ///
    /// # Errors
    /// Returns [`MpcError::Setting`] for settings out of range and for a controller that starts at another time, and [`MpcError`] for a tip
    /// law without a reference.
    pub fn new(
        controller: Controller,
        estimator: Option<Box<dyn Estimator>>,
        lag: f64,
        settings: LoopSettings,
    ) -> Result<Self, MpcError> {
        settings.check()?;
        let start = controller.settings().start;
        if (start - settings.lead()).abs() > rounding_of(start) {
            return Err(MpcError::Setting {
                name: "start",
                value: start,
                expected: "when the first command acts: LoopSettings::lead()",
            });
        }
        // The controller's command has no wrench yet, and no effort beside the given ones.
        let before = Command {
            start: start - controller.settings().period,
            end: start,
            ..controller.command().clone()
        };
        let tip_law = match settings.law {
            Law::Tip(gains) => Some(TipLaw::new(&controller, gains)?),
            Law::Mpc | Law::OpenLoop | Law::Regulator => None,
        };
        let model = controller.rod();
        Ok(Self {
            predictor: Predictor::new(model, controller.model_step()),
            tip_law,
            fallback: Fallback::new(&controller, settings.fallback),
            inbox: Inbox::new(lag),
            told: before.clone(),
            late: before.clone(),
            sent: VecDeque::from([before]),
            measurement: Measurement::default(),
            state: controller.expected().clone(),
            known: controller.expected().clone(),
            disturbance: Disturbance::NONE,
            deviation: Disturbance::NONE,
            known_at: 0.0,
            corrected_at: 0.0,
            failures: 0,
            index: 0,
            begin: ProcessorClock::start(),
            computing: 0.0,
            is_lost: false,
            controller,
            estimator,
            settings,
        })
    }

    /// Returns the controller.
    #[must_use]
    pub fn controller(&self) -> &Controller {
        &self.controller
    }

    /// Returns the settings of the loop.
    #[must_use]
    pub fn settings(&self) -> &LoopSettings {
        &self.settings
    }

    /// Tells whether an estimator computes the state from measurements.
    #[must_use]
    pub fn estimates(&self) -> bool {
        self.estimator.is_some()
    }

    /// Returns the time of the last knowledge, s: of the state, or of the last measurement that the estimator has used.
    #[must_use]
    pub fn known_at(&self) -> f64 {
        self.known_at
    }

    /// Returns the state at the time of the last knowledge, on the nodes of the model: as it was measured or estimated.
    #[must_use]
    pub fn known(&self) -> &State {
        &self.known
    }

    /// Returns the estimated disturbance.
    #[must_use]
    pub fn disturbance(&self) -> &Disturbance {
        &self.disturbance
    }

    /// Returns the index of the next sample.
    #[must_use]
    pub fn next_sample(&self) -> usize {
        self.index
    }

    /// Returns the last command, with the times at which it begins to act and the next one should.
    #[must_use]
    pub fn sent(&self) -> &Command {
        &self.sent[self.sent.len() - 1]
    }

    /// Returns the last command as it is sent to the actuators: earlier by their known delay.
    #[must_use]
    pub fn told(&self) -> &Command {
        &self.told
    }

    /// Replaces the path of the tip, see [`Controller::follow`].
    ///
    /// # Errors
    /// As [`Controller::follow`].
    pub fn follow(&mut self, path: &[(f64, Vector3<f64>)]) -> Result<(), MpcError> {
        self.controller.follow(path)
    }

    /// Replaces the rotations of the tip's track, see [`Controller::turn`].
    ///
    /// # Errors
    /// As [`Controller::turn`].
    pub fn turn(&mut self, rotations: &[(f64, Matrix3<f64>)]) -> Result<(), MpcError> {
        self.controller.turn(rotations)
    }

    /// Moves the obstacles of a name, see [`Controller::move_obstacle`].
    ///
    /// # Errors
    /// As [`Controller::move_obstacle`].
    pub fn move_obstacle(
        &mut self,
        name: &str,
        t: f64,
        by: &Vector3<f64>,
        velocity: &Vector3<f64>,
    ) -> Result<(), MpcError> {
        self.controller.move_obstacle(name, t, by, velocity)
    }

    /// Replaces the disturbance that predictions and the controller's model include from the next sample on, in a loop whose state is known
    /// without an estimator.
    ///
    /// # Errors
    /// Returns [`MpcError::Disturbance`] for numbers that are not finite or out of [range](Disturbance::check), and
    /// [`MpcError::Unsupported`] with an estimator, which finds its own.
    pub fn assume(&mut self, disturbance: &Disturbance) -> Result<(), MpcError> {
        if self.estimates() {
            let why = "the estimator of the scene finds the disturbance itself";
            return Err(MpcError::Unsupported(why));
        }
        disturbance.check(self.controller.rod())?;
        self.disturbance = *disturbance;
        Ok(())
    }

    /// Stores a measurement that has become known, for the estimator.
    pub fn put(&mut self, measurement: &Measurement) {
        self.inbox.put(measurement);
    }

    /// Computes the sample at time `t` (s), which must be that of the [next](Self::next_sample) one or later. Samples that are left out are
    /// counted in [`next_sample`](Self::next_sample): the last command acts meanwhile, constant after its end, and the controller restarts.
    ///
    /// The tip of the sample, or the node that follows, and its reference belong to the time of the last knowledge,
    /// [`known_at`](Self::known_at); the reference is
    /// `None` if nothing is known. [`Sample::prepare_s`] is set by [`Responded::prepare`].
    pub fn respond(&mut self, t: f64, known: Known) -> Responded<'_> {
        self.begin = ProcessorClock::start();
        let period = self.controller.settings().period;
        let index = (t / period).round() as usize;
        if index > self.index {
            self.index = index;
            self.is_lost = true;
            self.fallback.lose_plan();
        }
        let beginning = self.index as f64 * period;
        let mut sample = Sample::at(beginning);
        let mut cause = match known {
            Known::State(state) => {
                self.state.clone_from(state);
                self.known_at = t;
                None
            }
            Known::Measurements => self.estimate(t, &mut sample),
            Known::Nothing(cause) => Some(cause),
        };
        let tip = self.controller.followed();
        sample.tip = self.state.configuration.positions[tip].into();
        (sample.reference, sample.turn) = match known {
            Known::Nothing(_) => (None, None),
            Known::State(_) | Known::Measurements => {
                let rotation = &self.state.configuration.rotations[tip];
                let turn = self.controller.turn_from_reference(self.known_at, rotation);
                (self.controller.reference(self.known_at), turn)
            }
        };
        self.known.clone_from(&self.state);
        sample.estimate_s = self.begin.wall();

        let acts_from = beginning + self.lead();
        let clock = Instant::now();
        if self.settings.predicts && !matches!(self.settings.law, Law::OpenLoop) {
            cause = cause.or_else(|| self.predict(acts_from));
        }
        sample.predict_s = clock.elapsed().as_secs_f64();

        let clock = Instant::now();
        let outcome = match (cause, self.settings.law) {
            (_, Law::OpenLoop) => {
                // The plan continues as if the model's own motion had been measured.
                self.state.clone_from(self.controller.expected());
                self.controlled(acts_from)
            }
            (None, Law::Mpc) => self.controlled(acts_from),
            (None, Law::Regulator) => self.regulated(acts_from),
            (None, Law::Tip(_)) => match &mut self.tip_law {
                Some(law) => {
                    law.command(&mut self.controller, &self.state, acts_from);
                    Ok(())
                }
                None => Err(Cause::NoMeasurement),
            },
            (Some(cause), _) => Err(cause),
        };
        if let Err(cause) = outcome {
            let action =
                (self.fallback).command(&mut self.controller, &self.state, acts_from, cause);
            sample.fallback = Some((cause, action));
            // Another command than that of the plan acts, which the controller does not know.
            self.is_lost |= action != Action::Plan;
        } else {
            self.fallback
                .succeed(&self.controller, &self.state, acts_from);
        }
        sample.feedback_s = clock.elapsed().as_secs_f64();
        self.computing = self.begin.wall();
        sample.acts_from = if self.settings.computing == Computing::Measured {
            // A command that is computed later does not act before the one before it.
            let own = beginning + self.computing + self.settings.actuator_delay;
            own.max(self.sent().start)
        } else {
            acts_from
        };
        self.send(sample.acts_from);
        sample.note_command(&self.sent[self.sent.len() - 1], self.controller.record());
        (sample.disturbance, sample.deviation) = (self.disturbance, self.deviation);
        Responded {
            driver: self,
            sample,
        }
    }

    /// Returns the predicted position of the model's tip, or of the node that follows, at the end of the last command, m, from the state
    /// for which it was computed;
    /// `None` if that state is unknown or the motion breaks down.
    pub(super) fn predicted_tip(&mut self, sample: &Sample) -> Option<Vector3<f64>> {
        if sample.fallback.is_some() {
            return None;
        }
        let mut state = self.state.clone();
        let disturbance = self.compensated();
        let sent = &self.sent[self.sent.len() - 1];
        let span = [sent.start, sent.end].map(|t| t + disturbance.delay());
        late_at(&self.sent, disturbance.delay(), span, &mut self.late);
        let moved = (self.predictor).advance(&mut state, span, &self.late, &disturbance);
        let tip = state.configuration.positions[self.controller.followed()];
        moved.ok().map(|()| tip)
    }

    /// Prepares the next sample, and stores the duration of the whole present one.
    pub(super) fn prepare(&mut self, sample: &mut Sample) {
        let clock = Instant::now();
        self.prepare_controller();
        self.prepare_fallback();
        sample.prepare_s = clock.elapsed().as_secs_f64();
        let took = self.begin.seconds();
        (sample.sample_s, sample.processor_s) = (took.wall, took.processor);
        sample.is_overrun = sample.sample_s > self.controller.settings().period;
        self.index = self.index.saturating_add(1);
    }

    /// Returns the time from the beginning of a sample until its command acts, s.
    fn lead(&self) -> f64 {
        match self.settings.computing {
            Computing::Measured => self.settings.actuator_delay + self.computing,
            _ => self.settings.lead(),
        }
    }

    /// Updates the estimate with all measurements that are known at `t`; returns the cause if the estimate cannot be used.
    fn estimate(&mut self, t: f64, sample: &mut Sample) -> Option<Cause> {
        let Some(estimator) = &mut self.estimator else {
            return Some(Cause::NoMeasurement);
        };
        let mut cause = None;
        let mut n_used = 0;
        while let Some(measurement) = self.inbox.take(t) {
            self.measurement.clone_from(measurement);
            let late = &mut self.late;
            let advanced = advance(estimator.as_mut(), &self.sent, late, self.measurement.time);
            match advanced.and_then(|()| estimator.correct(&self.measurement)) {
                Ok(mut innovation) => {
                    if innovation.n > 0 {
                        n_used += 1;
                        self.corrected_at = self.measurement.time;
                    }
                    self.failures = 0;
                    innovation.refused += sample.innovation.map_or(0, |before| before.refused);
                    sample.innovation = Some(innovation);
                }
                Err(error) => {
                    let own = Cause::of_estimate(&error);
                    self.failures += usize::from(own == Cause::Estimate);
                    cause = Some(own);
                }
            }
            if self.failures == MOST_FAILURES {
                // An estimate with which the model's motion breaks down does not recover by itself.
                let start = self.controller.initial();
                if estimator.restart(self.measurement.time, start).is_ok() {
                    self.failures = 0;
                }
            }
        }
        let estimate = estimator.estimate();
        sample.age = t - self.corrected_at;
        self.known_at = estimate.time;
        self.state.clone_from(&estimate.state);
        self.disturbance = estimate.disturbance;
        self.deviation = estimate.deviation;
        // The last good estimate is predicted further within the patience of the fallbacks.
        let is_old = sample.age
            > self
                .settings
                .fallback
                .patience(self.controller.settings().period);
        match cause {
            Some(cause) if n_used == 0 && is_old => Some(cause),
            None if n_used == 0 && is_old => Some(Cause::NoMeasurement),
            _ => None,
        }
    }

    /// Returns the disturbance for predictions.
    fn compensated(&self) -> Disturbance {
        if self.settings.compensates {
            self.disturbance
        } else {
            Disturbance::NONE
        }
    }

    /// Predicts the known state until `until` under the commands that act meanwhile.
    fn predict(&mut self, until: f64) -> Option<Cause> {
        let disturbance = self.compensated();
        let mut from = self.known_at;
        // The estimated delay applies to this command and to every one before it.
        let until = until + disturbance.delay();
        while from < until - rounding_of(until) {
            let end = late_at(
                &self.sent,
                disturbance.delay(),
                [from, until],
                &mut self.late,
            );
            let moved =
                (self.predictor).advance(&mut self.state, [from, end], &self.late, &disturbance);
            if moved.is_err() {
                return Some(Cause::Prediction);
            }
            from = end;
        }
        None
    }

    /// Lets the controller issue its command for the present state; after failures it restarts.
    fn controlled(&mut self, acts_from: f64) -> Result<(), Cause> {
        self.find_again(acts_from)?;
        let issued = self.controller.feedback(&self.state);
        // The sample is prepared once its command has been sent.
        issued
            .map(|_| ())
            .map_err(|error| Cause::of_controller(&error))
    }

    /// Lets the controller issue the response of the regulator about the plan's own motion to the present state.
    fn regulated(&mut self, acts_from: f64) -> Result<(), Cause> {
        self.find_again(acts_from)?;
        let response = self.controller.regulate(&self.state);
        response.map_err(|error| Cause::of_controller(&error))
    }

    /// Restarts a lost controller.
    fn find_again(&mut self, acts_from: f64) -> Result<(), Cause> {
        if !self.is_lost {
            return Ok(());
        }
        if self.settings.compensates {
            let disturbed = self.controller.disturb(&self.disturbance);
            disturbed.map_err(|error| Cause::of_controller(&error))?;
        }
        let restarted = self.controller.restart(acts_from, &self.state);
        restarted.map_err(|error| Cause::of_controller(&error))?;
        self.is_lost = false;
        Ok(())
    }

    /// Sends the controller's last command from `acts_from` on, and keeps it for later estimates.
    fn send(&mut self, acts_from: f64) {
        let command = self.controller.release(acts_from);
        self.told.clone_from(&command);
        self.told.start -= self.settings.actuator_delay;
        self.told.end -= self.settings.actuator_delay;
        self.sent.retain(|other| other.start < acts_from);
        self.sent.push_back(command);
        // Commands that ended before the oldest estimate are no longer needed.
        let oldest =
            self.known_at - self.disturbance.delay().max(0.0) - self.controller.settings().period;
        while (self.sent.get(1)).is_some_and(|next| next.start < oldest) {
            self.sent.pop_front();
        }
    }

    fn prepare_controller(&mut self) {
        if matches!(self.settings.law, Law::Tip(_)) || self.is_lost {
            return;
        }
        let disturbs = self.settings.compensates && self.settings.law == Law::Mpc;
        let disturbed = if disturbs {
            self.controller.disturb(&self.disturbance)
        } else {
            Ok(())
        };
        if disturbed.and_then(|()| self.controller.prepare()).is_err() {
            self.is_lost = true;
        }
    }

    /// Lets the fallbacks seek where the arm may stop. Its last known shape is that of the last knowledge, moved on by the model under the
    /// commands since where the controller has predicted this.
    fn prepare_fallback(&mut self) {
        let is_predicted = !(self.is_lost || matches!(self.settings.law, Law::Tip(_)));
        let state = if is_predicted {
            self.controller.expected()
        } else {
            &self.known
        };
        let start = self.sent().end;
        let shape = &state.configuration;
        self.fallback.prepare(&self.controller, shape, start);
    }
}

/// Returns the command that acts at `from`, and the end of its action, at most `until`.
fn acting_at(sent: &VecDeque<Command>, from: f64, until: f64) -> (&Command, f64) {
    let next = sent.partition_point(|command| command.start <= from + rounding_of(from));
    let command = &sent[next.saturating_sub(1)];
    let end = sent.get(next).map_or(until, |next| next.start.min(until));
    (command, end)
}

/// Writes the command that acts at `from`, if all act later by `delay` (s), to `late`; returns the end of its action, at most `until`.
fn late_at(
    sent: &VecDeque<Command>,
    delay: f64,
    [from, until]: [f64; 2],
    late: &mut Command,
) -> f64 {
    let (command, end) = acting_at(sent, from - delay, until - delay);
    late.clone_from(command);
    (late.start, late.end) = (command.start + delay, command.end + delay);
    (end + delay).min(until)
}

/// Advances an estimator under the commands that acted, shifted by the delay that it estimates; `late` is memory.
fn advance(
    estimator: &mut dyn Estimator,
    sent: &VecDeque<Command>,
    late: &mut Command,
    until: f64,
) -> Result<(), EstimateError> {
    loop {
        let Estimate {
            time, disturbance, ..
        } = estimator.estimate();
        let from = *time;
        let end = late_at(sent, disturbance.delay(), [from, until], late);
        estimator.advance(late, end)?;
        if end >= until - rounding_of(until) {
            return Ok(());
        }
        if estimator.estimate().time <= from {
            return estimator.advance(late, until);
        }
    }
}
