//! From a checked scene to a closed loop: controller, plant, sensors, estimator.

use std::f64::consts::TAU;
use std::sync::Arc;

use super::error::SceneError;
use super::model::{self, ComputingKey, EstimatorKind, Mpc, PlantKeys, Scene, SensorKeys};
use super::section::profile;
use super::source::SceneSource;
use super::values::{Instant, Number, Positive, digits, known};
use crate::control::{OptimalControlProblem, rounding_of};
use crate::mechanics::vibration::SmallMotions;
use crate::mechanics::{Rod, State, SweptSurface};
use crate::mpc::{
    ActuatorDynamics, EffortDynamics, Experiment, Heard, LoopSettings, MpcError, Sensing, Sensor,
    SensorChoice, SensorSettings, ServeError, Server, Transfer, followed, with_long_steps,
};
use crate::stop::StopSignal;
use crate::task::{Arm, Discretization, DiscretizeError, StartError, Task};

/// Displacement of a winch, in lengths of the arm, from which on a slack tendon is worth a word, a choice.
const WORTH_TAKING_UP: f64 = 1e-3;

/// A closed loop that a scene describes.
#[derive(Clone, Debug)]
pub struct ClosedLoopSetup {
    /// The loop.
    pub experiment: Experiment,
    /// Rod of the controller's model.
    pub model: Arc<Rod>,
    /// Rod of the plant.
    pub plant: Arc<Rod>,
    /// Node of the plant that follows a reference: the tip, or the nearest to that of the task.
    pub followed: usize,
    /// State of the plant at time 0.
    pub initial: State,
    /// The scene with every default and derived value written out.
    pub resolved: Scene,
    /// Warnings about keys without effect, and about a loop that goes on after its task.
    pub warnings: Vec<String>,
}

/// The reason why the closed loop of a scene has no server.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// The scene describes no loop with a controller.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The controller could not be made for another reason.
    #[error(transparent)]
    Serve(#[from] ServeError),
}

/// Distance from the surface that the tip sweeps, divided by the length, up to which a path lies on it.
const ON_THE_SURFACE: f64 = 0.01;
/// Default horizon: this fraction of the first natural period, along a path at most `PART_OF_TIME` of the scene's time, and at least
/// `FEWEST_SAMPLES` samples.
const PART_OF_PERIOD: f64 = 0.5;
const PART_OF_TIME: f64 = 0.25;
const FEWEST_SAMPLES: f64 = 10.0;
/// Remedy for a plant that cannot be computed with.
const OF_PLANT: &str =
    "the arm as it is has the keys of [rod], and in their place those of [plant]";

impl ClosedLoopSetup {
    /// The sensors that an estimator uses.
    pub fn sensors(&self) -> impl Iterator<Item = &SensorSettings> {
        let sensors = match &self.experiment.sensing {
            Sensing::Everything => &[][..],
            Sensing::Estimated { sensors, .. } => &sensors[..],
        };
        sensors.iter().filter_map(|choice| match choice {
            SensorChoice::Own(settings) => Some(settings),
            SensorChoice::Preset(_) => None,
        })
    }

    /// Returns a sentence for each closed path of the tip that lies off the surface that the tip sweeps, with its distances from it; none
    /// if `stop` is raised.
    #[must_use]
    pub fn unbent_paths(&self, stop: &StopSignal) -> Vec<String> {
        let model = &*self.model;
        // Actuators in the arm reach other places than forces on the tip.
        let task = &self.experiment.task;
        let pushes = task.actuators.iter().any(|own| own.force.acts());
        if !task.efforts.is_empty() && !pushes {
            return Vec::new();
        }
        let tracks = self
            .resolved
            .objective
            .iter()
            .flat_map(|objective| &objective.track);
        let paths = tracks.filter_map(|track| Some((track, track.round()?)));
        paths
            .filter(|(track, _)| track.node == model::LoadNode::Tip)
            .filter_map(|(track, round)| {
                let mut surface = SweptSurface::new(model, &model.rest, 0.0, stop).ok()?;
                let found = round.iter().map(|place| surface.distance(place, stop).ok()?);
                let off = found.collect::<Option<Vec<f64>>>()?;
                let least = off.iter().copied().fold(f64::INFINITY, f64::min);
                let most = off.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                let length = model.scales.length;
                if least.abs().max(most.abs()) < ON_THE_SURFACE * length {
                    return None;
                }
                let middle = 0.5 * (least + most);
                let center = track.center()? - surface.direction().into_inner() * middle;
                Some(format!(
                    "objective.track: where forces across the direction of the base bend the arm, its tip passes this path at {:.1} to {:.1} mm (positive: the \
                     arm is too short, negative: it is pressed together); with center_m = [{:.4}, {:.4}, {:.4}] half of that remains",
                    1e3 * least, 1e3 * most, center.x, center.y, center.z
                ))
            })
            .collect()
    }
}

impl Scene {
    /// Returns the settings of the loop; its fall-back waits as long as its sensors may be silent.
    fn loop_settings(&self, mpc: &Mpc, delay: f64, sensors: &[SensorSettings]) -> LoopSettings {
        let mut out = mpc.loop_settings(delay);
        if self.estimator.is_some() {
            out.fallback = (out.fallback).following(sensors, mpc.period_s.get());
        }
        out
    }

    /// Returns what the controller knows of the arm.
    fn sensing(&self, sensors: &[SensorSettings], seed: u32) -> Sensing {
        (self.estimator.as_ref()).map_or(Sensing::Everything, |estimator| {
            estimator.sensing(sensors, seed, self)
        })
    }

    /// Tells whether plans keep the tendons of winches taut.
    fn keeps_taut(&self) -> bool {
        self.control.as_ref().is_none_or(|own| own.keep_taut)
    }

    /// Returns by how much plans keep inside of the limits; empty without margins.
    fn margins(&self) -> Vec<f64> {
        let given = self.doubt.as_ref().and_then(|doubt| doubt.margins.clone());
        given.unwrap_or_default()
    }

    /// Returns the horizon, s. Blocks of a default one have to be short beside the paths that the arm follows.
    fn horizon(&self, mpc: &Mpc, rod: &Rod, stop: &StopSignal) -> Result<f64, StartError> {
        if let Some(horizon) = mpc.horizon_s {
            return Ok(horizon.get());
        }
        let start = self.start().state(rod, stop)?;
        let follows =
            (self.objective.as_ref()).is_some_and(|objective| !objective.track.is_empty());
        let longest = match follows {
            true => PART_OF_TIME * self.time.end_s.get(),
            false => f64::INFINITY,
        };
        Ok(default_horizon(rod, &start, mpc.period_s.get(), longest))
    }

    /// Returns the closed loop that the scene describes; `seed` is that of the noise if the scene has none, and `stop` ends the search for
    /// an initial state.
    ///
    /// # Errors
    /// [`SceneError`] if `[mpc]`, `[control]`, or both `[task]` and `[[objective.track]]` are missing, for features that a controller does not
    /// have (waypoints, a free final time, cubic blocks), and as [`Self::optimal_control`].
    pub fn closed_loop(
        &self,
        source: &SceneSource,
        seed: u32,
        stop: &StopSignal,
    ) -> Result<ClosedLoopSetup, SceneError> {
        let mpc = self.controller(source)?;
        let arm = self.arm(source)?;
        let duration = mpc.duration_s.map_or(self.time.end_s.get(), Number::get);
        let period = mpc.period_s.get();
        let refused = |error| self.discretize_error(source, error);
        let asked = self.discretization();
        let rod = arm.rod(&asked).map_err(|error| refused(error.into()))?;
        let horizon = (self.horizon(mpc, &rod, stop)).map_err(|error| refused(error.into()))?;
        let due = mpc.due_s.or(self.task.as_ref().and_then(|task| task.at_s));
        let task = Task {
            horizon,
            // The plan of a controller has rows of its own for tendons that should stay taut.
            keeps_taut: false,
            ..self.posed_task_until(source, duration + horizon)?
        };
        // Where the arm stays is for the controller alone to find out, and only where the task is due.
        let passing = task.clone().stopping();
        let settings = mpc.settings(horizon, due.map(Number::get));
        let asked = with_long_steps(&rod, &task, &asked, &settings);
        let blocks = (horizon / settings.block).round().max(1.0) as usize;
        let posed = passing
            .discretize_until(&arm, &Discretization { blocks, ..asked }, stop)
            .map_err(refused)?;
        let discretization = Discretization {
            step: asked.step,
            ..posed.discretization
        };
        let model = Arc::clone(&posed.discrete.rod);

        let (plant, plant_discretization) = self.plant(&arm, &discretization);
        let efforts = self.plant_efforts(arm.pose_actuators.len());
        let found = passing
            .discretize_until(&plant, &plant_discretization, stop)
            .map_err(|error| source.error_at("plant", error.to_string(), Some(OF_PLANT.into())))?
            .discrete;

        let seed = mpc.seed.unwrap_or(seed);
        let sensors = self.sensors(source, &model, &found.rod)?;
        let actuators = self.actuator_dynamics();
        let loop_settings = self.loop_settings(mpc, actuators.delay, &sensors);
        let counted_from = counted_from(mpc, &task);

        let mut resolved = self.resolved(&arm, &discretization);
        resolved.time.step_s = asked.step;
        resolved.objective = Some(self.resolved_objective(&posed.discrete));
        resolved.mpc = Some(Mpc {
            horizon_s: Some(known(horizon)),
            due_s: due,
            block_s: Some(known(settings.block)),
            duration_s: Some(known(duration)),
            counted_from_s: Some(known(counted_from)),
            seed: Some(seed),
            ..mpc.resolved(&loop_settings, self.estimator.is_some())
        });
        resolved.plant = Some(self.resolved_plant(&plant, &plant_discretization));
        resolved.sensor = sensors.iter().map(SensorKeys::describing).collect();
        if let Some(estimator) = &mut resolved.estimator {
            estimator.disturbances = Some(estimator.unknowns(self));
        }

        let mut warnings = self.concerns(due, duration);
        warnings.extend(self.sharp_sensors(&sensors, &model));
        warnings.extend(seldom_asked(&task, asked.step, period));
        warnings.extend(self.slack_winches(&found.rod, &found.initial));
        let task = Task {
            keeps_taut: self.keeps_taut(),
            ..if due.is_some() { task } else { passing }
        };
        let task = with_weights_of(task, &posed.discrete);
        Ok(ClosedLoopSetup {
            experiment: Experiment {
                plant,
                plant_discretization,
                margins: self.margins(),
                actuators,
                efforts,
                sensing: self.sensing(&sensors, seed),
                settings: loop_settings,
                duration,
                counted_from,
                stop: stop.clone(),
                ..Experiment::new(arm, task, discretization, settings)
            },
            followed: Transfer::new(&found.rod, &model).nearest()[followed(&posed.discrete)],
            plant: found.rod,
            resolved,
            warnings,
            model,
            initial: found.initial,
        })
    }

    /// Returns the server of the controller of the scene's closed loop, which answers one call after the other, beside the loop; `name` is that of the scene.
    ///
    /// # Errors
    /// Returns an error at the key that keeps the scene from being a loop or its controller from being made, and any other error of the controller.
    pub fn server(
        &self,
        source: &SceneSource,
        name: &str,
        stop: &StopSignal,
    ) -> Result<(Server<Heard>, ClosedLoopSetup), ServerError> {
        let setup = self.closed_loop(source, 0, stop)?;
        match Server::new(&setup.experiment, name, Heard::default()) {
            Ok(server) => Ok((server, setup)),
            Err(ServeError::Mpc(error)) => Err(match self.mpc_error(source, &error) {
                Some(of_scene) => of_scene.into(),
                None => ServeError::Mpc(error).into(),
            }),
            Err(error) => Err(error.into()),
        }
    }

    /// Returns the error of a closed loop at the key of the scene that causes it; `None` for an error within a run.
    #[must_use]
    pub fn mpc_error(&self, source: &SceneSource, error: &MpcError) -> Option<SceneError> {
        let message = error.to_string();
        match error {
            MpcError::Discretize(error) => Some(self.discretize_error(source, error.clone())),
            MpcError::EstimatorStep(error) => {
                let help = match error {
                    DiscretizeError::UnstableStep { automatic, .. } => Some(format!(
                        "use at most {automatic:.4e} s, a smaller estimator.elements, or time.integrator = \"implicit\""
                    )),
                    _ => None,
                };
                Some(source.error_at("estimator.step_s", error.to_string(), help))
            }
            MpcError::Hold => Some(source.error_at("control.hold", message, None)),
            MpcError::Unsupported(_) => Some(source.error_at("mpc", message, None)),
            MpcError::Setting { name, .. } => {
                let key = match *name {
                    "period" => "mpc.period_s",
                    "horizon" => "mpc.horizon_s",
                    "block" => "mpc.block_s",
                    "due" => "mpc.due_s",
                    "margins" => "doubt.margins",
                    _ => "mpc",
                };
                Some(source.error_at(key, message, None))
            }
            MpcError::Disturbance { .. }
            | MpcError::Measurement { .. }
            | MpcError::Path { .. }
            | MpcError::Rollout(_)
            | MpcError::Stopped(_)
            | MpcError::Subproblem => None,
        }
    }

    /// Returns the keys of the controller; refuses features that it does not support: waypoints, a free duration and cubic blocks.
    fn controller(&self, source: &SceneSource) -> Result<&Mpc, SceneError> {
        let Some(mpc) = &self.mpc else {
            let help =
                "softarm mpc needs it, be it empty; `softarm example mpc-track-circle` shows one";
            return Err(source.error_at("mpc", "[mpc] is missing", Some(help.into())));
        };
        let task = self.task.as_ref();
        let cubic = (self.control.as_ref())
            .is_some_and(|control| control.hold == crate::control::Hold::Cubic);
        let refusals = [
            (
                "task.via",
                task.is_some_and(|task| !task.via.is_empty()),
                "a moving horizon has no points on the way",
                "give an [[objective.track]] through them",
            ),
            (
                "task.free_duration",
                task.is_some_and(|task| task.free_duration.is_some()),
                "a moving horizon has no free duration",
                "leave it out; mpc.due_s says when the task is due",
            ),
            (
                "control.hold",
                cubic,
                "a moving horizon has no cubic blocks",
                "give \"linear\" or \"constant\"",
            ),
        ];
        match refusals.into_iter().find(|(_, is_there, _, _)| *is_there) {
            Some((key, _, message, help)) => Err(source.error_at(key, message, Some(help.into()))),
            None => Ok(mpc),
        }
    }

    /// Returns a warning about tendons on winches, driven by the controller, that are slack at the start, and by how much.
    fn slack_winches(&self, rod: &Rod, initial: &State) -> Option<String> {
        let state = rod.effort_state(initial.configuration.poses());
        let inputs = rod.actuators.efforts(0.0);
        let controls = self.effort_controls();
        let slack = rod.actuators.iter().enumerate().filter_map(|(i, own)| {
            controls.iter().find(|control| control.actuator == i)?;
            let by = (rod.actuators).too_long(i, 0.0, inputs[i], state.coordinates[i])?;
            let far = by > WORTH_TAKING_UP * rod.scales.length;
            far.then(|| format!("\"{}\" by {:.2} mm", own.name, 1e3 * by))
        });
        let slack: Vec<String> = slack.collect();
        let what = if self.keeps_taut() {
            "the plan takes that up first, as far as effort has a price; a smaller rest_displacement_m begins taut"
        } else {
            "a slack tendon does not feel its winch, so that no plan may move the arm: a smaller rest_displacement_m begins taut, and \
             control.keep_taut = true takes up what is slack"
        };
        (!slack.is_empty()).then(|| {
            format!(
                "tendons are slack at the start, which their winches have to take up: {}; {what}",
                slack.join(", ")
            )
        })
    }

    /// Returns warnings about keys without effect, and about a loop that goes on after its task.
    fn concerns(&self, due: Option<Positive<Instant>>, duration: f64) -> Vec<String> {
        let mut out = Vec::new();
        let kind = self.estimator.as_ref().map(|estimator| estimator.kind);
        if kind == Some(EstimatorKind::None) && !self.sensor.is_empty() {
            out.push(
                "estimator.kind is \"none\": the true state is known, and [[sensor]] plays no part"
                    .into(),
            );
        }
        let mpc = self.mpc.as_ref();
        if mpc.is_some_and(|mpc| mpc.computing_s.is_some() && mpc.computing != ComputingKey::Fixed)
        {
            out.push("mpc.computing_s plays no part: mpc.computing is not \"fixed\"".into());
        }
        let due = due.map(Number::get).filter(|due| *due < duration);
        if let (Some(due), false) = (due, self.stays()) {
            out.push(format!(
                "the loop runs for {duration} s, and its task is due at {due} s: nothing holds the arm afterwards; give the task at_rest = true, \
                 leave mpc.due_s and task.at_s out, or shorten mpc.duration_s"
            ));
        }
        out
    }

    /// Returns a sentence for every sensor that is more exact than the model of a Kalman filter.
    fn sharp_sensors(&self, sensors: &[SensorSettings], model: &Rod) -> Vec<String> {
        if self.estimator.as_ref().map(|estimator| estimator.kind) != Some(EstimatorKind::Kalman) {
            return Vec::new();
        }
        let of = |(index, sensor): (usize, &SensorSettings)| {
            let sharper = sensor.sharper_than(model);
            let own = |(name, sigma, error): &(&str, f64, f64)| {
                format!("{name} = {} below {}", digits(*sigma), digits(*error))
            };
            (!sharper.is_empty()).then(|| {
                format!(
                    "sensor.{index} is more exact than a model of {} elements ({}): the filter takes it as exact as the model; more rod.elements use \
                     more of it",
                    model.n_elements(),
                    sharper.iter().map(own).collect::<Vec<_>>().join(", ")
                )
            })
        };
        sensors.iter().enumerate().filter_map(of).collect()
    }

    /// Returns the plant: the arm that the controller acts on, with its discretization.
    fn plant(&self, arm: &Arm, discretization: &Discretization) -> (Arm, Discretization) {
        let keys = self.plant.clone().unwrap_or_default();
        let mut plant = arm.clone();
        let [stiffness, density] = [keys.stiffness_factor.get(), keys.density_factor.get()];
        if let Some(shapes) = keys.section.as_ref().and_then(model::SectionKeys::shapes) {
            let [base, tip] = shapes.map(|shape| shape.half_width());
            plant.radii = vec![(0.0, base), (1.0, tip)];
            if let Some(material) = self.material() {
                plant.section = profile(material, shapes);
            }
        }
        plant.section = plant.section.scaled(stiffness, density);
        if let Some(rate) = keys.viscous_1_s {
            plant.viscous_damping = rate.get();
        }
        if let Some(time) = keys.internal_s {
            plant.internal_damping = time.get();
        }
        if let Some(curvature) = keys.curvature_1_m {
            plant.rest_curvature = curvature.into();
        }
        for (section, _, own) in keys.hardware() {
            if let Some((index, ..)) = self.hardware_named(section, &own.name) {
                own.change(&mut plant.actuators[index]);
            }
        }
        for own in &keys.tendon {
            if let Some((index, ..)) = self.hardware_named("tendon", &own.name) {
                own.rub(&mut plant.actuators[index]);
            }
        }
        if let Some(payload) = &keys.payload {
            plant.payload = Some(*payload);
        }
        let mesh = self.mesh();
        plant
            .loads
            .extend(self.disturbance.iter().map(|load| load.of_arm(&mesh)));
        let own = Discretization {
            elements: keys.elements.unwrap_or(self.rod.elements),
            scheme: None,
            rotary_inertia: None,
            step: None,
            ..*discretization
        };
        (plant, own)
    }

    /// Returns the rod of the plant with the discretization of one.
    ///
    /// # Errors
    /// As [`Self::closed_loop`].
    pub(super) fn plant_rod(
        &self,
        source: &SceneSource,
        discretization: &Discretization,
    ) -> Result<Rod, SceneError> {
        let (plant, _) = self.plant(&self.arm(source)?, discretization);
        (plant.rod(discretization))
            .map_err(|error| source.error_at("plant", error.to_string(), Some(OF_PLANT.into())))
    }

    fn actuator_dynamics(&self) -> ActuatorDynamics {
        let own = self.plant.as_ref().and_then(|plant| plant.actuator);
        own.unwrap_or_default()
    }

    fn resolved_plant(&self, plant: &Arm, discretization: &Discretization) -> PlantKeys {
        PlantKeys {
            elements: Some(discretization.elements),
            viscous_1_s: Some(known(plant.viscous_damping)),
            internal_s: Some(known(plant.internal_damping)),
            curvature_1_m: Some(plant.rest_curvature.into()),
            ..self.plant.clone().unwrap_or_default()
        }
    }

    /// Returns the dynamics of the plant's actuators, the last `n_poses` of which are on poses: lags are those of the plant, or else of the
    /// model.
    fn plant_efforts(&self, n_poses: usize) -> Vec<EffortDynamics> {
        let keys = self.plant.clone().unwrap_or_default();
        let of_all = keys.actuator.as_ref().map_or(0.0, |own| own.lag);
        let on_poses = std::iter::repeat_n(None, n_poses);
        let lags = self.lags().into_iter().chain(on_poses);
        let mut out: Vec<EffortDynamics> = lags
            .map(|lag| EffortDynamics {
                lag: lag.unwrap_or(of_all),
                ..EffortDynamics::default()
            })
            .collect();
        for (section, _, own) in keys.hardware() {
            if let Some((index, ..)) = self.hardware_named(section, &own.name) {
                out[index] = own.dynamics(out[index].lag);
            }
        }
        out
    }

    /// Returns the settings of the sensors on this model, after a check that this plant can have them.
    fn sensors(
        &self,
        source: &SceneSource,
        model: &Rod,
        plant: &Rod,
    ) -> Result<Vec<SensorSettings>, SceneError> {
        let mut out = Vec::with_capacity(self.sensor.len());
        for (index, keys) in self.sensor.iter().enumerate() {
            let settings = keys.settings(model);
            Sensor::new(&settings, plant).map_err(|error| {
                source.error_at(&format!("sensor.{index}"), error.to_string(), None)
            })?;
            out.push(settings);
        }
        Ok(out)
    }
}

/// Returns a task with the weights and scales that were chosen for a problem, so that the problem of the controller has the same.
fn with_weights_of(mut task: Task, problem: &OptimalControlProblem) -> Task {
    for (track, chosen) in (task.cost.tracks.iter_mut()).zip(&problem.objective.tracking) {
        track.weight = Some(chosen.weight);
        track.rotation_weight = Some(chosen.rotation_weight);
    }
    let tip = problem.wrench_actuators().into_iter().next();
    task.cost.force_scale = tip.map(|tip| tip.force.scale);
    task.cost.moment_scale = tip.map(|tip| tip.moment.scale);
    task
}

/// Returns a warning that steps of the model, s, are longer than the period, s, of a loop with limits, which are asked once in a step.
fn seldom_asked(task: &Task, step: Option<f64>, period: f64) -> Option<String> {
    let step = step.filter(|step| *step > period + rounding_of(period))?;
    (!task.limits.is_empty()).then(|| {
        format!(
            "time.step_s = {step} is longer than mpc.period_s = {period}: limits are kept at every step of the plan, and not at the end of every sample; \
             give the period, or leave time.step_s out"
        )
    })
}

/// Returns the time from which errors count, s: that of the scene, or that from which all references do.
fn counted_from(mpc: &Mpc, task: &Task) -> f64 {
    let begins = task.cost.tracks.iter().map(|track| track.from);
    (mpc.counted_from_s).map_or_else(|| begins.fold(mpc.period_s.get(), f64::max), Number::get)
}

/// Returns half of the first natural period about the start, s, at most `longest` and at least ten samples, as a whole number of samples.
fn default_horizon(rod: &Rod, start: &State, period: f64, longest: f64) -> f64 {
    let frequency = SmallMotions::about(rod, &start.configuration, 0.0).first_frequency();
    let natural = frequency.map_or(rod.scales.time, |omega| TAU / omega);
    ((PART_OF_PERIOD * natural).min(longest) / period)
        .round()
        .max(FEWEST_SAMPLES)
        * period
}
