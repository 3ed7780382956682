//! One closed loop under several laws, and with its imperfections removed one at a time.

use std::ops::ControlFlow;
use std::sync::Arc;

use super::{
    ClosedLoop, Computing, Driver, Knowledge, Law, LoopSettings, Sample, Tally, TipError, TipGains,
};
use crate::controller::{Controller, MpcSettings};
use crate::error::MpcError;
use crate::estimator::{
    Estimator, KalmanFilter, KalmanSettings, N_UNKNOWNS, Needs, RandomWalk, Regridded, Unknown,
};
use crate::sensor::{Sensor, SensorPreset, SensorSettings};
use crate::simulated_arm::{ActuatorDynamics, EffortDynamics, SimulatedArm};
use crate::transfer::Transfer;
use mechanics::{Rod, State, StepError};
use stop::StopSignal;
use task::{Arm, Discretization, DiscretizeError, Task, longest_step};

/// The description of a closed loop: all of its parts before anything is discretized.
#[derive(Clone, Debug)]
pub struct Experiment {
    /// The arm that the controller assumes.
    pub arm: Arm,
    /// The task.
    pub task: Task,
    /// Elements, step and hold of the controller's model.
    pub discretization: Discretization,
    /// Settings of the controller.
    pub mpc: MpcSettings,
    /// By how much plans keep inside of the task's obstacles and limits, in their order and units; empty for none.
    pub margins: Vec<f64>,
    /// The arm of the plant.
    pub plant: Arm,
    /// Elements and step of the plant.
    pub plant_discretization: Discretization,
    /// A change of the plant's rod that an [`Arm`] cannot describe, such as one soft element.
    pub adjust: Option<fn(&mut Rod)>,
    /// Dynamics of the actuators between commands and wrenches.
    pub actuators: ActuatorDynamics,
    /// Dynamics of the plant's actuators in the arm, in their order; those that are left have the lags of the task.
    pub efforts: Vec<EffortDynamics>,
    /// Sensing of the state.
    pub sensing: Sensing,
    /// Settings of the loop.
    pub settings: LoopSettings,
    /// Duration of a run, s.
    pub duration: f64,
    /// Time from which errors count, s.
    pub counted_from: f64,
    /// Signal that ends the construction of plants and controllers early. The samples of a run are ended by its observer.
    pub stop: StopSignal,
}

/// Source of the controller's knowledge of the state.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Sensing {
    /// The true state.
    #[default]
    Everything,
    /// An estimate from the measurements of sensors.
    Estimated {
        /// The sensors.
        sensors: Vec<SensorChoice>,
        /// Unknowns that the Kalman filter estimates besides the state.
        unknowns: Unknowns,
        /// Elements of the estimator's own model; `None` for those of the controller's.
        elements: Option<usize>,
        /// Longest time step of the estimator's own model, s; `None` for the automatic one.
        step: Option<f64>,
        /// Seed of the noise, from which every sensor derives its own.
        seed: u64,
    },
}

/// A sensor.
#[derive(Clone, Debug, PartialEq)]
pub enum SensorChoice {
    /// A common kind of sensor.
    Preset(SensorPreset),
    /// A sensor with the given settings.
    Own(SensorSettings),
}

/// Quantities that a Kalman filter estimates besides the state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unknowns {
    /// Those that are estimated, in the order of [`Unknown::TABLE`].
    pub estimated: [bool; N_UNKNOWNS],
    /// Rate of change of unknown wrenches, 1/s: the standard deviation of the deflection that they cause within a hundred periods of the
    /// loop, divided by the length and by that time; they are random walks, and within another time it grows with the root. With a larger
    /// value, pushes are followed faster, and so is the noise of sensors. `None`: 0.007 divided by that time.
    pub wrench_change: Option<f64>,
}

impl Default for Unknowns {
    fn default() -> Self {
        Self::NONE
    }
}

impl Unknowns {
    /// No unknowns, and the default rate of change of wrenches.
    pub const NONE: Self = Self {
        estimated: [false; N_UNKNOWNS],
        wrench_change: None,
    };
    /// All unknowns.
    pub const ALL: Self = Self {
        estimated: [true; N_UNKNOWNS],
        ..Self::NONE
    };

    /// Returns these unknowns, with the default rate of change of wrenches.
    #[must_use]
    pub fn of(unknowns: &[Unknown]) -> Self {
        let mut out = Self::NONE;
        for unknown in unknowns {
            out.estimated[*unknown as usize] = true;
        }
        out
    }

    /// Returns the others of these unknowns.
    #[must_use]
    pub fn without(mut self, unknown: Unknown) -> Self {
        self.estimated[unknown as usize] = false;
        self
    }

    /// Tells whether an unknown is estimated.
    #[must_use]
    pub fn has(&self, unknown: Unknown) -> bool {
        self.estimated[unknown as usize]
    }

    /// Tells whether nothing is estimated besides the state.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.estimated == Self::NONE.estimated
    }
}

/// Number of periods of the loop in which unknowns change by the parts that follow. A filter forgets by its number of measurements, as the
/// forgetting factor of recursive least squares does (Åström and Wittenmark 1995), and not by seconds: a loop is the same in
/// any unit of time.
const MEMORY: f64 = 100.0;
/// Default of [`Unknowns::wrench_change`] and of the key `estimator.wrench_change_1_s`, times [`MEMORY`] periods; measured (decision 64).
const WRENCH_CHANGE: f64 = 0.007;
/// Distance between the seeds of two runs, more than a scene has sensors.
const MOST_SENSORS: u64 = 1000;
/// Prior standard deviation of an unknown wrench, as the deflection that it causes divided by the length; those of other unknowns stand in
/// [their table](Unknown::TABLE). With half and with twice the value, the error of `mpc-track-circle` in its first 0.6 s changes by -1 and
/// 2 %; that of `mpc-reach`, whose filter refuses signals there, by -14 and 19 %, and any of the sizes scatters it by as much.
const EXPECTED_DEFLECTION: f64 = 0.05;
/// Standard deviation of the change of a parameter within [`MEMORY`] periods, divided by its prior standard deviation; measured (decision
/// 75). A parameter that may change faster absorbs other errors of the model; for one that may change more slowly, the filter's standard deviation
/// is too small.
const PARAMETER_WALK: f64 = 0.05;
/// Standard deviation of the deflection that unknown forces on all nodes cause within [`MEMORY`] periods, divided by the length; measured
/// (decision 64). With more, the filter attributes its corrections to motions of the arm, from which it learns wrong parameters (Ljung 1979, on the
/// bias of extended Kalman filters with a wrong noise); with less, the innovations of arms that differ in other ways stay unexplained.
const UNKNOWN_FORCES: f64 = 0.005;

impl Unknowns {
    /// Creates a filter for a loop with this period, in which a command acts by this lead after the beginning of its sample (s), at time 0 in a
    /// state of a model, whose steps are no longer than `step` (s), if that is given.
    fn filter(
        self,
        model: &Rod,
        start: &State,
        step: Option<f64>,
        [period, lead]: [f64; 2],
    ) -> Result<Box<dyn Estimator>, MpcError> {
        let settings = KalmanSettings {
            longest_step: longest_step(model, step).map_err(MpcError::EstimatorStep)?,
            earliest: period + lead,
            ..self.settings(model, period)
        };
        Ok(Box::new(KalmanFilter::new(model, 0.0, start, &settings)?))
    }

    /// Returns the unknowns that are not estimated.
    #[must_use]
    pub fn missing(&self) -> Vec<Unknown> {
        Unknown::all().filter(|own| !self.has(*own)).collect()
    }

    /// Returns the standard deviation of the deflection by unknown forces within [`MEMORY`] periods, divided by the length. If no other unknown is
    /// estimated, these forces must also explain a wrong model.
    fn unknown_forces(self) -> f64 {
        if self.is_empty() {
            EXPECTED_DEFLECTION
        } else {
            UNKNOWN_FORCES
        }
    }

    /// Returns the settings of a filter for a model, in a loop with this period (s).
    #[must_use]
    pub fn settings(self, model: &Rod, period: f64) -> KalmanSettings {
        let length = model.scales.length;
        let memory = MEMORY * period;
        let wrench_change = self
            .wrench_change
            .map_or(WRENCH_CHANGE, |rate| rate * memory);
        // Of a random walk within one second that is as large as given within the memory.
        let within_a_second = memory.sqrt().recip();
        let walk = |unknown: Unknown| {
            let row = unknown.row();
            let size = (row.size)(model);
            let (initial, change) = if row.is_load() {
                (EXPECTED_DEFLECTION * size, wrench_change)
            } else {
                (size, PARAMETER_WALK)
            };
            RandomWalk {
                initial,
                change: change * within_a_second * size,
            }
        };
        KalmanSettings {
            change: self.unknown_forces() * within_a_second * length,
            walks: std::array::from_fn(|i| {
                self.estimated[i].then(|| walk(Unknown::TABLE[i].unknown))
            }),
            refuses: true,
            model_error: true,
            ..KalmanSettings::of(model)
        }
    }
}

/// The controller or law of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Contender {
    /// The controller with the scene as it is.
    Mpc,
    /// The controller's plan without any measurement.
    OpenLoop,
    /// The plan of [`OpenLoop`](Self::OpenLoop) with a linear-quadratic regulator about its motion.
    Regulator,
    /// A spring and a damper at the tip, and the force that holds the model at the reference.
    TipPd,
    /// The controller on a plant that is its model, with the true state at once.
    PlantIsModel,
    /// The controller on the plant of the scene, which waits for the commands: the true state, and no delay.
    PlantWaits,
}

impl Contender {
    /// All contenders.
    pub const ALL: [Self; 6] = [
        Self::Mpc,
        Self::OpenLoop,
        Self::Regulator,
        Self::TipPd,
        Self::PlantIsModel,
        Self::PlantWaits,
    ];

    /// Returns the name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Mpc => "mpc",
            Self::OpenLoop => "open_loop",
            Self::Regulator => "regulator",
            Self::TipPd => "pd",
            Self::PlantIsModel => "plant_is_model",
            Self::PlantWaits => "plant_waits",
        }
    }
}

/// The result of a run of a contender.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The contender.
    pub contender: Contender,
    /// Samples; fewer than requested if the run was ended.
    pub samples: Vec<Sample>,
    /// Distances from the reference.
    pub tip_error: TipError,
    /// Angles from the reference orientation, rad; `None` without one.
    pub tip_turn: Option<TipError>,
    /// Times and fallbacks.
    pub tally: Tally,
    /// Error of the plant's motion, if it broke down.
    pub broke_down: Option<StepError>,
    /// Error of the arm's shape at the end on the model's nodes, m; see [`Transfer::error`](crate::Transfer::error).
    pub transfer_error: f64,
}

/// Observer of the samples of a run, which may end it.
pub type SampleObserver<'a> = dyn FnMut(&Sample, &ClosedLoop) -> ControlFlow<()> + 'a;

impl Experiment {
    /// Returns the names, as in scenes, of the quantities that a Kalman filter could estimate and does not; empty without one.
    #[must_use]
    pub fn missing_unknowns(&self) -> Vec<&'static str> {
        let Sensing::Estimated { unknowns, .. } = &self.sensing else {
            return Vec::new();
        };
        let rubs = self.arm.actuators.iter().any(|own| own.friction.is_some());
        (unknowns.missing().into_iter())
            .filter(|own| own.row().needs != Needs::Friction || rubs)
            .map(|own| own.row().key)
            .collect()
    }

    /// Returns a loop with the true state of a plant that is the model, as a base for changes.
    #[must_use]
    pub fn new(arm: Arm, task: Task, discretization: Discretization, mpc: MpcSettings) -> Self {
        Self {
            plant: arm.clone(),
            plant_discretization: discretization,
            duration: task.horizon,
            arm,
            task,
            discretization,
            mpc,
            margins: Vec::new(),
            adjust: None,
            actuators: ActuatorDynamics::default(),
            efforts: Vec::new(),
            sensing: Sensing::Everything,
            settings: LoopSettings::default(),
            counted_from: 0.0,
            stop: StopSignal::default(),
        }
    }

    /// Runs one contender; `observer` gets every sample and may end the run.
    ///
    /// # Errors
    /// Returns [`MpcError`] for parts that cannot be discretized, settings out of range, and features that the controller does not support.
    pub fn run(
        &self,
        contender: Contender,
        observer: &mut SampleObserver,
    ) -> Result<Outcome, MpcError> {
        let mut own = self.clone();
        match contender {
            Contender::Mpc => own.settings.law = Law::Mpc,
            Contender::OpenLoop => own.settings.law = Law::OpenLoop,
            Contender::Regulator => own.settings.law = Law::Regulator,
            // Gains that the scene gives are kept.
            Contender::TipPd if matches!(self.settings.law, Law::Tip(_)) => {}
            Contender::TipPd => own.settings.law = Law::Tip(TipGains::default()),
            Contender::PlantIsModel => {
                own.plant = self.arm.clone();
                own.adjust = None;
                own.plant_discretization = self.discretization;
                own.without_delay();
            }
            Contender::PlantWaits => own.without_delay(),
        }
        own.contend(contender, observer)
    }

    fn without_delay(&mut self) {
        self.actuators = ActuatorDynamics::default();
        self.efforts.clear();
        self.sensing = Sensing::Everything;
        self.settings = LoopSettings {
            computing: Computing::Instant,
            actuator_delay: 0.0,
            law: Law::Mpc,
            ..self.settings
        };
    }

    /// Creates the controller, whose first command acts as soon as the loop allows.
    ///
    /// # Errors
    /// As [`Controller::new`].
    pub fn controller(&self) -> Result<Controller, MpcError> {
        self.settings.check()?;
        let mpc = MpcSettings {
            start: self.settings.lead(),
            ..self.mpc
        };
        let (arm, task) = (&self.arm, &self.task);
        let mut controller =
            Controller::new_until(arm, task, &self.discretization, &mpc, &self.stop)?;
        if !self.margins.is_empty() {
            controller.keep_inside(&self.margins)?;
        }
        Ok(controller)
    }

    fn contend(
        &self,
        contender: Contender,
        observer: &mut SampleObserver,
    ) -> Result<Outcome, MpcError> {
        let controller = self.controller()?;
        let plant =
            (self.task).discretize_until(&self.plant, &self.plant_discretization, &self.stop)?;
        let (mut rod, start) = (plant.discrete.rod, plant.discrete.initial);
        if let Some(adjust) = self.adjust {
            adjust(Arc::make_mut(&mut rod));
        }
        let knowledge = self.knowledge(&controller, &rod)?;
        let period = self.mpc.period;
        let mut efforts = self.efforts.clone();
        let of_model = efforts.len()..controller.rod().actuators.len();
        efforts.extend(of_model.map(|actuator| EffortDynamics {
            lag: controller.command().list.lag_of_effort(actuator),
            ..EffortDynamics::default()
        }));
        let arm = SimulatedArm::new(
            &rod,
            start,
            period,
            controller.rod(),
            controller.command().nodes(),
            self.actuators,
        )?
        .with_efforts(&efforts)?;
        let mut closed = ClosedLoop::new(controller, arm, knowledge, self.settings)?;
        self.stop.check()?;
        let n = (self.duration / period).round().max(1.0) as usize;
        let mut samples = Vec::with_capacity(n);
        let mut broke_down = None;
        for _ in 0..n {
            match closed.sample() {
                Ok(sample) => {
                    let goes_on = observer(&sample, &closed);
                    samples.push(sample);
                    if goes_on.is_break() {
                        break;
                    }
                }
                Err(error) => {
                    broke_down = Some(error);
                    break;
                }
            }
        }
        Ok(Outcome {
            contender,
            tip_error: TipError::of(&samples, self.counted_from),
            tip_turn: TipError::of_turns(&samples, self.counted_from),
            tally: Tally::of(&samples, period),
            transfer_error: closed.arm().transfer_error(),
            samples,
            broke_down,
        })
    }

    /// Creates the driver of a plant that is not simulated here, in the place of a [`ClosedLoop`].
    ///
    /// # Errors
    /// As [`Self::run`].
    pub fn driver(&self) -> Result<Driver, MpcError> {
        let controller = self.controller()?;
        let estimator = self.estimator(&controller)?;
        let sensors = self.sensors(controller.rod());
        let lag = (sensors.iter()).fold(0.0, |lag: f64, sensor| lag.max(sensor.age_s));
        let settings = LoopSettings {
            fallback: (self.settings.fallback).following(&sensors, controller.settings().period),
            ..self.settings
        };
        Driver::new(controller, estimator, lag, settings)
    }

    /// Returns the settings of the sensors, each with a seed of its own; none without an estimator.
    pub(crate) fn sensors(&self, model: &Rod) -> Vec<SensorSettings> {
        let Sensing::Estimated { sensors, seed, .. } = &self.sensing else {
            return Vec::new();
        };
        (sensors.iter().enumerate())
            .map(|(i, choice)| SensorSettings {
                seed: seed.wrapping_mul(MOST_SENSORS).wrapping_add(i as u64),
                ..match choice {
                    SensorChoice::Preset(preset) => preset.settings(model),
                    SensorChoice::Own(settings) => settings.clone(),
                }
            })
            .collect()
    }

    fn estimator(&self, controller: &Controller) -> Result<Option<Box<dyn Estimator>>, MpcError> {
        let Sensing::Estimated {
            unknowns,
            elements,
            step,
            ..
        } = &self.sensing
        else {
            return Ok(None);
        };
        let (model, start) = (controller.rod(), controller.initial());
        let times = [controller.settings().period, self.settings.lead()];
        let Some(elements) = elements.filter(|own| *own != model.n_elements()) else {
            return unknowns.filter(model, start, *step, times).map(Some);
        };
        let own = Discretization {
            elements,
            step: None,
            scheme: Some(model.scheme),
            ..self.discretization
        };
        let own = self.arm.rod(&own).map_err(DiscretizeError::from)?;
        let start = Transfer::new(model, &own).state(start);
        let estimator = unknowns.filter(&own, &start, *step, times)?;
        Ok(Some(Box::new(Regridded::new(model, &own, estimator))))
    }

    fn knowledge(&self, controller: &Controller, rod: &Rod) -> Result<Knowledge, MpcError> {
        let Some(estimator) = self.estimator(controller)? else {
            return Ok(Knowledge::Everything);
        };
        let sensors = self.sensors(controller.rod());
        let sensors = (sensors.iter()).map(|settings| Sensor::new(settings, rod));
        Ok(Knowledge::Sensors {
            sensors: sensors.collect::<Result<_, _>>()?,
            estimator,
        })
    }
}
