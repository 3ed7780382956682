//! One closed loop under several laws, and with its imperfections removed one at a time.

use std::ops::ControlFlow;
use std::sync::Arc;

use super::{
    ClosedLoop, Computing, Driver, Knowledge, Law, LoopSettings, Sample, Tally, TipError, TipGains,
};
use crate::beam::weakest_bending;
use crate::controller::{Controller, MpcSettings};
use crate::error::MpcError;
use crate::estimator::{Estimator, KalmanFilter, KalmanSettings, RandomWalk, Regridded};
use crate::sensor::{Sensor, SensorPreset, SensorSettings};
use crate::simulated_arm::{ActuatorDynamics, EffortDynamics, SimulatedArm};
use crate::transfer::Transfer;
use mechanics::beam::Beam;
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
    /// A force at the tip.
    pub tip_force: bool,
    /// A moment at the tip.
    pub tip_moment: bool,
    /// A force all along the arm.
    pub distributed: bool,
    /// A factor on the stiffness.
    pub stiffness: bool,
    /// A mass at the tip.
    pub payload: bool,
    /// Viscous damping.
    pub viscous: bool,
    /// Internal damping, of a model with implicit steps.
    pub internal: bool,
    /// Delay of the commands beyond their known delay.
    pub delay: bool,
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
        tip_force: false,
        tip_moment: false,
        distributed: false,
        stiffness: false,
        payload: false,
        viscous: false,
        internal: false,
        delay: false,
        wrench_change: None,
    };
    /// All unknowns.
    pub const ALL: Self = Self {
        tip_force: true,
        tip_moment: true,
        distributed: true,
        stiffness: true,
        payload: true,
        viscous: true,
        internal: true,
        delay: true,
        ..Self::NONE
    };
}

/// Number of periods of the loop in which unknowns change by the parts that follow. A filter forgets by its number of measurements, as the
/// forgetting factor of recursive least squares does (Åström and Wittenmark 1995), and not by seconds: a loop is the same in
/// any unit of time.
const MEMORY: f64 = 100.0;
/// Default of [`Unknowns::wrench_change`] and of the key `estimator.wrench_change_1_s`, times [`MEMORY`] periods; measured (decision 64).
const WRENCH_CHANGE: f64 = 0.007;
/// Distance between the seeds of two runs, more than a scene has sensors.
const MOST_SENSORS: u64 = 1000;
/// Prior standard deviation of an unknown wrench, as the deflection that it causes divided by the length. The expected sizes from here on
/// say how wrong a model may be that is meant for an arm: a filter weighs its unknowns against each other by them. With half and with twice
/// the value, the error of `mpc-track-circle` in its first 0.6 s changes by -1 and 2 %; that of `mpc-reach`, whose filter refuses signals
/// there, by -14 and 19 %, and any of the sizes scatters it by as much.
const EXPECTED_DEFLECTION: f64 = 0.05;
/// Prior standard deviation of the factor on the stiffness: the range of the hundred drawn arms of `benches/mpc.md`, all of which are
/// followed. With half of it, the first 0.6 s of `mpc-track-circle` have an error that is smaller by 0.6 %.
const EXPECTED_STIFFNESS: f64 = 0.3;
/// Prior standard deviation of the payload, divided by the mass of the arm: a third of the largest payload of these arms, half of that of
/// the scene `mpc-payload`. With half and with twice the value, the error of `mpc-track-circle`, whose arm carries none, changes by -19 and
/// 21 % in the first 0.6 s, while the filter finds that.
const EXPECTED_PAYLOAD: f64 = 0.1;
/// Prior standard deviation of the viscous damping times the time scale of the arm: a tenth of the critical damping `2 ω₁` of a
/// cantilever's first mode. With half and with twice the value, the error of `mpc-track-circle` changes by 1 % in the first 0.6 s.
const EXPECTED_DAMPING: f64 = 0.7;
/// Prior standard deviation of the time of internal damping, divided by the time scale of the arm: a fiftieth of the critical damping
/// `2/ω₁` of a cantilever's first mode.
const EXPECTED_INTERNAL: f64 = 0.01;
/// Prior standard deviation of the delay, divided by the time scale of the arm. With three times as much, the filter of a light arm that
/// starts with a step of the force mistakes a payload for a delay and diverges (decision 79).
const EXPECTED_DELAY: f64 = 0.003;
/// Standard deviation of the change of a parameter within [`MEMORY`] periods, divided by its prior standard deviation; measured (decision
/// 75). A parameter that may change faster absorbs other errors of the model; for one that may change more slowly, the filter's standard deviation
/// is too small.
const PARAMETER_WALK: f64 = 0.05;
/// Standard deviation of the deflection that unknown forces on all nodes cause within [`MEMORY`] periods, divided by the length; measured
/// (decision 64). With more, the filter attributes its corrections to motions of the arm, from which it learns wrong parameters (Ljung 1979, on the
/// bias of extended Kalman filters with a wrong noise); with less, the innovations of arms that differ in other ways stay unexplained.
const UNKNOWN_FORCES: f64 = 0.005;

impl Unknowns {
    /// Creates a filter for a loop with this period (s), at time 0 in a state of a model, whose steps are no longer than `step` (s), if that
    /// is given.
    fn filter(
        self,
        model: &Rod,
        start: &State,
        step: Option<f64>,
        period: f64,
    ) -> Result<Box<dyn Estimator>, MpcError> {
        let settings = KalmanSettings {
            longest_step: longest_step(model, step).map_err(MpcError::EstimatorStep)?,
            ..self.settings(model, period)
        };
        Ok(Box::new(KalmanFilter::new(model, 0.0, start, &settings)?))
    }

    /// Returns the names, as in scenes, of the quantities that are not estimated.
    #[must_use]
    pub fn missing(&self) -> Vec<&'static str> {
        let all = [
            ("tip_force", self.tip_force),
            ("tip_moment", self.tip_moment),
            ("distributed", self.distributed),
            ("stiffness", self.stiffness),
            ("payload", self.payload),
            ("viscous", self.viscous),
            ("internal", self.internal),
            ("delay", self.delay),
        ];
        (all.into_iter())
            .filter_map(|(name, is_there)| (!is_there).then_some(name))
            .collect()
    }

    /// Returns the standard deviation of the deflection by unknown forces within [`MEMORY`] periods, divided by the length. If no other unknown is
    /// estimated, these forces must also explain a wrong model.
    fn unknown_forces(self) -> f64 {
        let estimates_state_alone = self.missing().len() == Self::NONE.missing().len();
        if estimates_state_alone {
            EXPECTED_DEFLECTION
        } else {
            UNKNOWN_FORCES
        }
    }

    /// Returns the settings of a filter for a model, in a loop with this period (s).
    #[must_use]
    pub fn settings(self, model: &Rod, period: f64) -> KalmanSettings {
        let length = model.scales.length;
        let bending = weakest_bending(model);
        let beam = Beam::of(model);
        let memory = MEMORY * period;
        let wrench_change = self
            .wrench_change
            .map_or(WRENCH_CHANGE, |rate| rate * memory);
        // Of a random walk within one second that is as large as given within the memory.
        let within_a_second = memory.sqrt().recip();
        let walk = |is_unknown: bool, size: f64| {
            is_unknown.then_some(RandomWalk {
                initial: EXPECTED_DEFLECTION * size,
                change: wrench_change * within_a_second * size,
            })
        };
        let parameter = |is_unknown: bool, size: f64| {
            is_unknown.then_some(RandomWalk {
                initial: size,
                change: PARAMETER_WALK * within_a_second * size,
            })
        };
        KalmanSettings {
            change: self.unknown_forces() * within_a_second * length,
            tip_force: walk(
                self.tip_force,
                beam.by_force[0] * bending / (length * length),
            ),
            tip_moment: walk(self.tip_moment, beam.by_moment[0] * bending / length),
            distributed: walk(self.distributed, beam.by_line * bending / length.powi(3)),
            stiffness: parameter(self.stiffness, EXPECTED_STIFFNESS),
            payload: parameter(self.payload, EXPECTED_PAYLOAD * model.mass()),
            viscous: parameter(self.viscous, EXPECTED_DAMPING / model.scales.time),
            internal: parameter(self.internal, EXPECTED_INTERNAL * model.scales.time),
            delay: parameter(self.delay, EXPECTED_DELAY * model.scales.time),
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
        match &self.sensing {
            Sensing::Estimated { unknowns, .. } => unknowns.missing(),
            Sensing::Everything => Vec::new(),
        }
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
        let of_model = controller.command().lags.iter().skip(efforts.len());
        efforts.extend(of_model.map(|&lag| EffortDynamics {
            lag,
            ..EffortDynamics::default()
        }));
        let arm = SimulatedArm::new(
            &rod,
            start,
            period,
            controller.rod(),
            &controller.command().nodes,
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
        let period = controller.settings().period;
        let Some(elements) = elements.filter(|own| *own != model.n_elements()) else {
            return unknowns.filter(model, start, *step, period).map(Some);
        };
        let own = Discretization {
            elements,
            step: None,
            scheme: Some(model.scheme),
            ..self.discretization
        };
        let own = self.arm.rod(&own).map_err(DiscretizeError::from)?;
        let start = Transfer::new(model, &own).state(start);
        let estimator = unknowns.filter(&own, &start, *step, period)?;
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
