//! The loop: a controller, a simulated arm that is not its model, sensors, an estimator, and time told truly.
//!
//! One sample at `t_k = k T`, each of its parts timed:
//!
//! ```text
//! estimate   every measurement that is known by t_k corrects the estimate at the time at which it was true, under the commands that acted
//! predict    from there to the instant at which the new command will act: t_k + computing + actuator delay, under the commands sent
//! feedback   one quadratic program
//! send       the command, with the instant from which it acts
//! prepare    the next sample: disturbance, horizon, roll-out, linearization, Hessian
//! ```
//!
//! Meanwhile the arm moves on under what was sent before. [`Experiment`] runs the same scene with other laws, and with the parts that may be
//! wrong taken away one at a time.

mod experiment;
mod fallback;
mod law;
mod sample;

use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::time::Instant;

use nalgebra::Vector3;

pub use self::experiment::{
    Contender, EstimatorChoice, Experiment, Outcome, SampleObserver, Sensing, SensorChoice,
    Unknowns,
};
use self::fallback::Fallback;
pub use self::fallback::{Action, Cause, FallbackSettings};
use self::law::TipLaw;
pub use self::law::{Law, TipGains};
pub use self::sample::{Percentiles, Sample, Tally, TipError};
use super::controller::{Command, Controller};
use super::error::MpcError;
use super::estimator::{Disturbance, Estimator, Inbox, Predictor};
use super::sensor::Sensor;
use super::signal::Measurement;
use super::simulated_arm::SimulatedArm;
use crate::mechanics::{State, StepError, Wrench};

/// How long computing takes, in the loop's own time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Computing {
    /// No time: the command of a sample acts from its beginning.
    #[default]
    Instant,
    /// A fixed time, s, which the loop waits for and predicts over.
    Fixed(f64),
    /// What estimation, prediction and feedback have taken on this machine. It is not known in advance: the loop predicts over what the sample
    /// before has taken.
    Measured,
}

/// What a [`ClosedLoop`] does besides what its parts do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopSettings {
    /// Time that a command takes to be computed.
    pub computing: Computing,
    /// Whether the state is predicted over all delays; if not, the last estimate stands for the state in which the command begins to act.
    pub predicts: bool,
    /// Whether the controller's model takes over the estimated disturbance.
    pub compensates: bool,
    /// Delay of the actuators that the loop knows of and predicts over, s.
    pub actuator_delay: f64,
    /// What computes the commands.
    pub law: Law,
    /// What is done where no command can be computed.
    pub fallback: FallbackSettings,
}

impl Default for LoopSettings {
    fn default() -> Self {
        Self {
            computing: Computing::Instant,
            predicts: true,
            compensates: true,
            actuator_delay: 0.0,
            law: Law::Mpc,
            fallback: FallbackSettings::default(),
        }
    }
}

/// What a controller knows of its arm.
pub enum Knowledge {
    /// The true state on the nodes of its model, at once.
    Everything,
    /// What an estimator makes of sensors.
    Sensors {
        /// The sensors.
        sensors: Vec<Sensor>,
        /// The estimator, at the time and in the state at which the loop begins.
        estimator: Box<dyn Estimator>,
    },
}

impl std::fmt::Debug for Knowledge {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Everything => f.write_str("Everything"),
            Self::Sensors { sensors, .. } => f
                .debug_struct("Sensors")
                .field("sensors", sensors)
                .finish_non_exhaustive(),
        }
    }
}

/// A change of what a measurement says, before it is used: for tests of what a loop survives.
pub type Tamper = Box<dyn FnMut(&mut Measurement) -> bool>;

/// A closed loop in simulation.
pub struct ClosedLoop<'a> {
    controller: Controller,
    arm: SimulatedArm<'a>,
    knowledge: Knowledge,
    settings: LoopSettings,
    predictor: Predictor,
    tip_law: Option<TipLaw>,
    fallback: Fallback,
    inbox: Inbox,
    /// Measurements that are true already and not known yet, with the time at which they will be.
    on_the_way: VecDeque<(f64, Measurement)>,
    /// Commands that acted or will act, by the instant from which they do, the earliest first; the first acts for ever before.
    sent: VecDeque<Command>,
    measurement: Measurement,
    state: State,
    disturbance: Disturbance,
    deviation: Disturbance,
    /// Time to which the estimate has come, s, and that of the last measurement that it has used.
    known_at: f64,
    corrected_at: f64,
    index: usize,
    /// Time that the sample before took to its command, s.
    computing: f64,
    tamper: Option<Tamper>,
    /// Whether the controller waits for a restart.
    is_lost: bool,
}

impl std::fmt::Debug for ClosedLoop<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ClosedLoop")
            .field("settings", &self.settings)
            .field("index", &self.index)
            .finish_non_exhaustive()
    }
}

impl<'a> ClosedLoop<'a> {
    /// A loop that begins at time 0. The controller's first command must act from when computing and actuators allow:
    /// [`MpcSettings::start`](super::MpcSettings) is [`LoopSettings::lead`].
    ///
    /// # Errors
    /// [`MpcError::Setting`] for settings out of range, and for a controller that starts at another time; [`MpcError`] of a tip law without a
    /// reference.
    pub fn new(
        controller: Controller,
        arm: SimulatedArm<'a>,
        knowledge: Knowledge,
        settings: LoopSettings,
    ) -> Result<Self, MpcError> {
        settings.check()?;
        let start = controller.settings().start;
        if (start - settings.lead()).abs() > 1e-9 {
            return Err(MpcError::Setting {
                name: "start",
                value: start,
                expected: "when the first command acts: LoopSettings::lead()",
            });
        }
        let lag = match &knowledge {
            Knowledge::Everything => 0.0,
            Knowledge::Sensors { sensors, .. } => {
                (sensors.iter()).fold(0.0, |lag, sensor| sensor.settings().age_s.max(lag))
            }
        };
        let nodes = controller.command().nodes.clone();
        let still = vec![Wrench::default(); nodes.len()];
        let before = Command {
            start: start - controller.settings().period,
            end: start,
            nodes,
            from: still.clone(),
            to: still,
        };
        let tip_law = match settings.law {
            Law::Tip(gains) => Some(TipLaw::new(&controller, gains)?),
            Law::Mpc | Law::OpenLoop => None,
        };
        let model = controller.rod();
        Ok(Self {
            predictor: Predictor::new(model, controller.model_step()),
            tip_law,
            fallback: Fallback::new(model, settings.fallback),
            inbox: Inbox::new(lag),
            on_the_way: VecDeque::new(),
            sent: VecDeque::from([before]),
            measurement: Measurement::default(),
            state: controller.expected().clone(),
            disturbance: Disturbance::NONE,
            deviation: Disturbance::NONE,
            known_at: 0.0,
            corrected_at: 0.0,
            index: 0,
            computing: 0.0,
            tamper: None,
            is_lost: false,
            controller,
            arm,
            knowledge,
            settings,
        })
    }

    /// Changes every measurement before it is used; one for which the function says no is lost.
    pub fn tamper(&mut self, tamper: Tamper) {
        self.tamper = Some(tamper);
    }

    /// The arm.
    #[must_use]
    pub fn arm(&self) -> &SimulatedArm<'a> {
        &self.arm
    }

    /// The controller.
    #[must_use]
    pub fn controller(&self) -> &Controller {
        &self.controller
    }

    /// The command that was sent last, with the instants at which it begins to act and the next one should.
    #[must_use]
    pub fn sent(&self) -> &Command {
        &self.sent[self.sent.len() - 1]
    }

    /// Runs `n` samples; `observer` sees each and may end the run. Returns those that ran.
    ///
    /// # Errors
    /// [`StepError`] where the simulated arm's motion breaks down.
    pub fn run(
        &mut self,
        n: usize,
        observer: &mut dyn FnMut(&Sample, &Self) -> ControlFlow<()>,
    ) -> Result<Vec<Sample>, StepError> {
        let mut samples = Vec::with_capacity(n);
        for _ in 0..n {
            let sample = self.sample()?;
            let goes_on = observer(&sample, self);
            samples.push(sample);
            if goes_on.is_break() {
                break;
            }
        }
        Ok(samples)
    }

    /// One sample, and the arm's motion until the next one.
    ///
    /// # Errors
    /// [`StepError`] where the simulated arm's motion breaks down.
    pub fn sample(&mut self) -> Result<Sample, StepError> {
        let period = self.controller.settings().period;
        let t = self.index as f64 * period;
        let begin = Instant::now();
        let mut sample = Sample::at(t);
        let tip = self.arm.tip();
        sample.tip = tip.into();
        sample.reference = self.controller.reference(t);
        let mut cause = self.estimate(t, &mut sample);
        sample.estimate_s = begin.elapsed().as_secs_f64();

        let acts_from = t + self.lead();
        let clock = Instant::now();
        if self.settings.predicts && !matches!(self.settings.law, Law::OpenLoop) {
            cause = cause.or(self.predict(acts_from));
        }
        sample.predict_s = clock.elapsed().as_secs_f64();

        let clock = Instant::now();
        let mut command = match (cause, self.settings.law) {
            (_, Law::OpenLoop) => {
                // The plan goes on as if the model's own motion were measured.
                self.state.clone_from(self.controller.expected());
                self.controlled(acts_from)
            }
            (None, Law::Mpc) => self.controlled(acts_from),
            (None, Law::Tip(_)) => match &self.tip_law {
                Some(law) => Ok(law.command(&self.controller, &self.state, acts_from)),
                None => Err(Cause::NoMeasurement),
            },
            (Some(cause), _) => Err(cause),
        };
        if let Err(cause) = command {
            let (own, action) =
                (self.fallback).command(&mut self.controller, &self.state, acts_from, cause);
            sample.fallback = Some((cause, action));
            // The controller does not know what acts instead of its plan.
            self.is_lost |= action != Action::Plan;
            command = Ok(own);
        } else {
            self.fallback.succeed();
        }
        let command = command.unwrap_or_else(|_| self.sent[self.sent.len() - 1].clone());
        sample.feedback_s = clock.elapsed().as_secs_f64();
        self.computing = begin.elapsed().as_secs_f64();
        if self.settings.computing == Computing::Measured {
            sample.acts_from = t + self.computing + self.settings.actuator_delay;
        } else {
            sample.acts_from = acts_from;
        }
        sample.note_command(&command, self.controller.record());
        self.send(command, sample.acts_from);

        let clock = Instant::now();
        self.prepare();
        sample.prepare_s = clock.elapsed().as_secs_f64();
        sample.sample_s = begin.elapsed().as_secs_f64();
        sample.is_overrun = sample.sample_s > period;
        sample.disturbance = self.disturbance;
        sample.deviation = self.deviation;

        self.index += 1;
        self.move_on(self.index as f64 * period)?;
        Ok(sample)
    }

    /// From the beginning of a sample to when its command acts, s.
    fn lead(&self) -> f64 {
        match self.settings.computing {
            Computing::Measured => self.settings.actuator_delay + self.computing,
            _ => self.settings.lead(),
        }
    }

    /// Takes in what is known at `t`.
    fn estimate(&mut self, t: f64, sample: &mut Sample) -> Option<Cause> {
        let Knowledge::Sensors { estimator, .. } = &mut self.knowledge else {
            self.state = self.arm.state_on_model();
            self.known_at = t;
            return None;
        };
        while (self.on_the_way.front()).is_some_and(|(known, _)| *known <= t + 1e-9) {
            let Some((_, mut measurement)) = self.on_the_way.pop_front() else {
                break;
            };
            let is_kept = (self.tamper.as_mut()).is_none_or(|tamper| tamper(&mut measurement));
            if is_kept {
                self.inbox.put(&measurement);
            }
        }
        let mut cause = None;
        let mut n_used = 0;
        while let Some(measurement) = self.inbox.take(t) {
            self.measurement.clone_from(measurement);
            let advanced = advance(estimator.as_mut(), &self.sent, self.measurement.time);
            match advanced.and_then(|()| estimator.correct(&self.measurement)) {
                Ok(innovation) => {
                    n_used += 1;
                    self.corrected_at = self.measurement.time;
                    sample.innovation = Some(innovation);
                }
                Err(error) => cause = Some(Cause::of_estimate(&error)),
            }
        }
        let estimate = estimator.estimate();
        sample.age = t - self.corrected_at;
        self.known_at = estimate.time;
        self.state.clone_from(&estimate.state);
        self.disturbance = estimate.disturbance;
        self.deviation = estimate.deviation;
        // The last good estimate is predicted further for as long as the fall-back's patience.
        let is_old = sample.age > self.settings.fallback.patience;
        match cause {
            Some(cause) if n_used == 0 && is_old => Some(cause),
            None if n_used == 0 && is_old => Some(Cause::NoMeasurement),
            _ => None,
        }
    }

    /// Moves the known state on to `until` under the commands that act meanwhile.
    fn predict(&mut self, until: f64) -> Option<Cause> {
        let disturbance = if self.settings.compensates {
            self.disturbance
        } else {
            Disturbance::NONE
        };
        let mut from = self.known_at;
        while from < until - 1e-9 {
            let (command, end) = acting_at(&self.sent, from, until);
            let moved =
                (self.predictor).advance(&mut self.state, [from, end], command, &disturbance);
            if moved.is_err() {
                return Some(Cause::Prediction);
            }
            from = end;
        }
        None
    }

    /// The controller's command for the present state; after failures it starts anew.
    fn controlled(&mut self, acts_from: f64) -> Result<Command, Cause> {
        if self.is_lost {
            if self.settings.compensates {
                let disturbed = self.controller.disturb(&self.disturbance);
                disturbed.map_err(|error| Cause::of_controller(&error))?;
            }
            let restarted = self.controller.restart(acts_from, &self.state);
            restarted.map_err(|error| Cause::of_controller(&error))?;
            self.is_lost = false;
        }
        let command = self.controller.feedback(&self.state);
        match command {
            Ok(command) => Ok(command.clone()),
            Err(error) => Err(Cause::of_controller(&error)),
        }
    }

    /// Keeps a command for the estimates to come, and tells it to the arm.
    fn send(&mut self, mut command: Command, acts_from: f64) {
        let shift = acts_from - command.start;
        command.start += shift;
        command.end += shift;
        let told = Command {
            start: command.start - self.settings.actuator_delay,
            end: command.end - self.settings.actuator_delay,
            ..command.clone()
        };
        self.arm.send(&told);
        self.sent.retain(|other| other.start < acts_from);
        self.sent.push_back(command);
        // Nothing asks for what acted before the oldest estimate.
        while (self.sent.get(1)).is_some_and(|next| next.start < self.known_at) {
            self.sent.pop_front();
        }
    }

    /// Prepares the controller's next sample.
    fn prepare(&mut self) {
        if self.settings.law != Law::Mpc && self.settings.law != Law::OpenLoop {
            return;
        }
        if self.is_lost {
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

    /// Moves the arm to `until`, and measures whenever a sensor is due.
    fn move_on(&mut self, until: f64) -> Result<(), StepError> {
        let Knowledge::Sensors { sensors, .. } = &mut self.knowledge else {
            return self.arm.advance(until);
        };
        loop {
            let next = (sensors.iter())
                .map(Sensor::next_due)
                .fold(f64::INFINITY, f64::min);
            if next > until + 1e-9 {
                return self.arm.advance(until);
            }
            self.arm.advance(next)?;
            let (now, state) = (self.arm.time(), self.arm.state());
            for sensor in sensors.iter_mut().filter(|sensor| sensor.is_due(now)) {
                let mut measurement = Measurement::default();
                if sensor.measure(now, &state, &mut measurement).is_ok() {
                    let known = now + sensor.settings().age_s;
                    let place = self
                        .on_the_way
                        .partition_point(|(other, _)| *other <= known);
                    self.on_the_way.insert(place, (known, measurement));
                }
            }
        }
    }
}

/// The command that acts at `from`, and until when it does, at most `until`.
fn acting_at(sent: &VecDeque<Command>, from: f64, until: f64) -> (&Command, f64) {
    let next = sent.partition_point(|command| command.start <= from + 1e-9);
    let command = &sent[next.saturating_sub(1)];
    let end = sent.get(next).map_or(until, |next| next.start.min(until));
    (command, end)
}

/// Moves an estimator on under the commands that acted.
fn advance(
    estimator: &mut dyn Estimator,
    sent: &VecDeque<Command>,
    until: f64,
) -> Result<(), super::estimator::EstimateError> {
    loop {
        let from = estimator.estimate().time;
        let (command, end) = acting_at(sent, from, until);
        estimator.advance(command, end)?;
        if end >= until - 1e-9 {
            return Ok(());
        }
        if estimator.estimate().time <= from {
            return estimator.advance(command, until);
        }
    }
}

impl LoopSettings {
    /// From the beginning of a sample to when its command acts, s; for measured computing, what is assumed of the first sample.
    #[must_use]
    pub fn lead(&self) -> f64 {
        self.actuator_delay
            + match self.computing {
                Computing::Fixed(delay) => delay,
                Computing::Instant | Computing::Measured => 0.0,
            }
    }

    pub(super) fn check(&self) -> Result<(), MpcError> {
        let lead = self.lead();
        if !(lead.is_finite() && lead >= 0.0) {
            return Err(MpcError::Setting {
                name: "computing and actuator delay",
                value: lead,
                expected: "a finite number of at least 0",
            });
        }
        self.fallback.check()
    }
}

/// Distance of a point from a reference, m; NaN without one.
fn distance(tip: [f64; 3], reference: Option<[f64; 3]>) -> f64 {
    reference.map_or(f64::NAN, |reference| {
        (Vector3::from(tip) - Vector3::from(reference)).norm()
    })
}
