//! The closed loop in simulation: a controller, a simulated arm that differs from its model, sensors, an estimator, with realistic timing.
//!
//! One sample at `t_k = k T`, each part of which is timed:
//!
//! ```text
//! estimate   every measurement that is known by t_k corrects the estimate at the time at which it was true, under the commands that acted
//! predict    from there to the instant at which the new command will act: t_k + computing + actuator delay, under the commands sent
//! feedback   one quadratic program
//! send       the command, with the instant from which it acts
//! prepare    the next sample: disturbance, horizon, roll-out, linearization, Hessian
//! ```
//!
//! The arm moves meanwhile under the commands sent before. All but the arm and its sensors is a [`Driver`]. [`Experiment`] runs the same
//! scene with other laws, and with its imperfections removed one at a time.

mod driver;
mod experiment;
mod fallback;
mod law;
mod sample;
mod tuning;

use std::collections::VecDeque;
use std::ops::ControlFlow;

use nalgebra::Vector3;

pub use self::driver::{Driver, Known, Responded};
pub use self::experiment::{
    Contender, Experiment, Outcome, SampleObserver, Sensing, SensorChoice, Unknowns,
};
pub use self::fallback::{Action, Cause, FallbackSettings};
pub use self::law::{Law, TipGains};
pub use self::sample::{Innovations, Percentiles, Sample, Tally, TipError};
use super::command::Command;
use super::controller::Controller;
use super::error::MpcError;
use super::estimator::Estimator;
use super::sensor::Sensor;
use super::signal::Measurement;
use super::simulated_arm::SimulatedArm;
use control::rounding_of;
use mechanics::StepError;

/// Computing time in the loop's own time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Computing {
    /// Zero: the command of a sample acts from its beginning.
    #[default]
    Instant,
    /// A fixed time, s, after which the command acts and over which the loop predicts.
    Fixed(f64),
    /// The time that estimation, prediction and feedback take on this machine. It is not known in advance: the loop predicts over the time
    /// that the sample before has taken.
    Measured,
}

/// Settings of a [`ClosedLoop`] besides those of its parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopSettings {
    /// Computing time of a command.
    pub computing: Computing,
    /// Tells whether the state is predicted over all delays; otherwise the last estimate replaces the state at which the command begins to
    /// act.
    pub predicts: bool,
    /// Tells whether the controller's model includes the estimated disturbance.
    pub compensates: bool,
    /// Known delay of the actuators, over which the loop predicts, s.
    pub actuator_delay: f64,
    /// Law that computes the commands.
    pub law: Law,
    /// Fallbacks for samples without a command.
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

/// Source of a controller's knowledge of its arm.
pub enum Knowledge {
    /// The true state on the nodes of its model, at once.
    Everything,
    /// An estimate from the measurements of sensors.
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

/// A change of measurements before they are used, for robustness tests; `false` drops the measurement.
pub type Tamper = Box<dyn FnMut(&mut Measurement) -> bool>;

/// A closed loop in simulation.
pub struct ClosedLoop<'a> {
    driver: Driver,
    arm: SimulatedArm<'a>,
    sensors: Vec<Sensor>,
    /// Measurements that have been taken and are not known yet, with the time at which they will be.
    on_the_way: VecDeque<(f64, Measurement)>,
    tamper: Option<Tamper>,
}

impl std::fmt::Debug for ClosedLoop<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ClosedLoop")
            .field("driver", &self.driver)
            .finish_non_exhaustive()
    }
}

impl<'a> ClosedLoop<'a> {
    /// Creates a loop that begins at time 0. The controller's first command must act from the time that computing and actuators allow:
    /// [`MpcSettings::start`](super::MpcSettings) is [`LoopSettings::lead`].
    ///
    /// # Errors
    /// As [`Driver::new`].
    pub fn new(
        controller: Controller,
        arm: SimulatedArm<'a>,
        knowledge: Knowledge,
        settings: LoopSettings,
    ) -> Result<Self, MpcError> {
        let (sensors, estimator) = match knowledge {
            Knowledge::Everything => (Vec::new(), None),
            Knowledge::Sensors { sensors, estimator } => (sensors, Some(estimator)),
        };
        let lag = (sensors.iter()).fold(0.0, |lag: f64, sensor| lag.max(sensor.settings().age_s));
        let settings = LoopSettings {
            fallback: (settings.fallback).following(
                sensors.iter().map(Sensor::settings),
                controller.settings().period,
            ),
            ..settings
        };
        Ok(Self {
            driver: Driver::new(controller, estimator, lag, settings)?,
            arm,
            sensors,
            on_the_way: VecDeque::new(),
            tamper: None,
        })
    }

    /// Applies `tamper` to every measurement before it is used; a measurement for which it returns `false` is lost.
    pub fn tamper(&mut self, tamper: Tamper) {
        self.tamper = Some(tamper);
    }

    /// Returns the simulated arm.
    #[must_use]
    pub fn arm(&self) -> &SimulatedArm<'a> {
        &self.arm
    }

    /// Returns the controller.
    #[must_use]
    pub fn controller(&self) -> &Controller {
        self.driver.controller()
    }

    /// Returns the last command, with the times at which it begins to act and the next one should.
    #[must_use]
    pub fn sent(&self) -> &Command {
        self.driver.sent()
    }

    /// Runs `n` samples; `observer` gets each and may end the run. Returns the samples that ran.
    ///
    /// # Errors
    /// Returns [`StepError`] if the simulated arm's motion breaks down.
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

    /// Runs one sample, and the arm's motion until the next one.
    ///
    /// # Errors
    /// Returns [`StepError`] if the simulated arm's motion breaks down.
    pub fn sample(&mut self) -> Result<Sample, StepError> {
        let period = self.controller().settings().period;
        let t = self.driver.next_sample() as f64 * period;
        let (tip, rotation) = self.arm.pose_on_model(self.controller().followed());
        let responded = if self.driver.estimates() {
            self.deliver(t);
            self.driver.respond(t, Known::Measurements)
        } else {
            let state = self.arm.state_on_model();
            self.driver.respond(t, Known::State(&state))
        };
        let controller = responded.controller();
        let reference = controller.reference(t);
        let turn = controller.turn_from_reference(t, &rotation);
        self.arm.send(responded.told());
        // A simulated arm knows where its tip really is.
        let sample = Sample {
            tip: tip.into(),
            reference,
            turn,
            ..responded.prepare()
        };
        self.move_on(self.driver.next_sample() as f64 * period)?;
        Ok(sample)
    }

    /// Gives the driver the measurements that have become known by `t`.
    fn deliver(&mut self, t: f64) {
        while (self.on_the_way.front()).is_some_and(|(known, _)| *known <= t + rounding_of(t)) {
            let Some((_, mut measurement)) = self.on_the_way.pop_front() else {
                break;
            };
            let is_kept = (self.tamper.as_mut()).is_none_or(|tamper| tamper(&mut measurement));
            if is_kept {
                self.driver.put(&measurement);
            }
        }
    }

    /// Moves the arm to `until`, and measures whenever a sensor is due.
    fn move_on(&mut self, until: f64) -> Result<(), StepError> {
        loop {
            let next = (self.sensors.iter())
                .map(Sensor::next_due)
                .fold(f64::INFINITY, f64::min);
            if next > until + rounding_of(until) {
                return self.arm.advance(until);
            }
            self.arm.advance(next)?;
            let (now, state) = (self.arm.time(), self.arm.state());
            for sensor in (self.sensors.iter_mut()).filter(|sensor| sensor.is_due(now)) {
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

impl LoopSettings {
    /// Returns the time from the beginning of a sample until its command acts, s; for measured computing, the assumption for the first
    /// sample.
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

/// Returns the distance of a point from a reference, m; NaN without one.
fn distance(tip: [f64; 3], reference: Option<[f64; 3]>) -> f64 {
    reference.map_or(f64::NAN, |reference| {
        (Vector3::from(tip) - Vector3::from(reference)).norm()
    })
}
