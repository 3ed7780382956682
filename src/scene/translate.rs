//! From a checked scene to its arm, task and discretization, and to a simulation or an optimal-control problem.

use std::time::{Duration, Instant};

use nalgebra::{Matrix3, Vector3};

use super::error::SceneError;
use super::model::{self, ObjectiveKeys, Scene, end_condition};
use super::rows::{SAME_INTERVAL, row_grid};
use super::source::SceneSource;
use super::values::{Number, digits, known};
use crate::control::{FeedbackWeights, OptimalControlProblem, Search};
use crate::mechanics::rotation::{exp, from_quaternion};
use crate::mechanics::rows;
use crate::mechanics::{Mesh, Rod, RotaryInertia, State, TimeGrid, TimeScheme};
use crate::sqp::{QpRoute, SqpSettings};
use crate::stop::StopSignal;
use crate::task::{Arm, Discretization, Limit, Problem, Rest, Start, Staying, Task};
use crate::verify::{CheckError, CheckLimits, Claim, ForwardCheck};

/// A forward simulation.
#[derive(Clone, Debug)]
pub struct Simulation {
    /// The arm.
    pub arm: Arm,
    /// The discretization; nothing in it is left open.
    pub discretization: Discretization,
    /// The rod.
    pub rod: Rod,
    /// The time grid.
    pub grid: TimeGrid,
    /// Steps between two rows of the result.
    pub steps_per_row: usize,
    /// Divisor by which the steps are shorter than the scene's, because of the depth in a body that the arm touches.
    pub divided: usize,
    /// Tells whether diagnostics are written.
    pub diagnostics: bool,
    /// State at time 0.
    pub initial: State,
    /// The scene with every default and derived value written out.
    pub resolved: Scene,
}

impl Simulation {
    /// Rows up to step `k`, the first one included: one every [`steps_per_row`](Self::steps_per_row), and one at the end.
    #[must_use]
    pub fn n_rows(&self, k: usize) -> usize {
        let at_end = k == self.grid.n_steps && !k.is_multiple_of(self.steps_per_row);
        k / self.steps_per_row + 1 + usize::from(at_end)
    }

    /// Returns the simulation with steps shorter by a divisor, whose rows are at the same times.
    #[must_use]
    #[cfg(feature = "cli")]
    pub(crate) fn with_steps_divided(mut self, by: usize) -> Self {
        self.grid.step /= by as f64;
        self.grid.n_steps *= by;
        self.steps_per_row *= by;
        self.divided *= by;
        self.discretization.step = Some(self.grid.step);
        self.resolved.time.step_s = Some(self.grid.step);
        let between_rows = self.steps_per_row as f64 * self.grid.step;
        let output = self.resolved.output.get_or_insert_default();
        output.rate_hz.get_or_insert(known(1.0 / between_rows));
        self
    }

    /// Returns a sentence on the times of the rows if the steps do not divide the interval that `output.rate_hz` asks for; `None` if they
    /// do.
    #[must_use]
    pub fn row_warning(&self) -> Option<String> {
        let rate = self.resolved.output.as_ref()?.rate_hz?.get();
        let step = self.grid.step;
        let rows = self.steps_per_row as f64 * step;
        // One row at the start and one at the end, whatever the interval.
        let only_ends = self.steps_per_row >= self.grid.n_steps;
        (!only_ends && (rows * rate - 1.0).abs() > SAME_INTERVAL).then(|| {
            format!(
                "output.rate_hz: steps of {step:.6e} s do not divide the interval of {:.6e} s between rows; rows fall every {rows:.6e} s; give \
                 a time.step_s that divides it, or \"auto\" and an end_s that is a multiple of it",
                1.0 / rate
            )
        })
    }
}

/// An optimal-control problem, with the settings of its solve.
#[derive(Clone, Debug)]
pub struct OptimalControl {
    /// The arm.
    pub arm: Arm,
    /// The task.
    pub task: Task,
    /// The discretization; nothing in it is left open.
    pub discretization: Discretization,
    /// The discrete problem of all three.
    pub problem: OptimalControlProblem,
    /// Settings of the solver.
    pub settings: SqpSettings,
    /// Initial guesses of the solve.
    pub search: Search,
    /// Weights of the regulator around the solution; `None` if no gains are to be computed.
    pub feedback: Option<FeedbackWeights>,
    /// Tells whether diagnostics are written.
    pub diagnostics: bool,
    /// The scene with every default and derived value written out.
    pub resolved: Scene,
}

impl OptimalControl {
    /// Returns the setup with a duration that is `factor` times that of the grid: its scene, read again, describes that grid.
    #[must_use]
    pub fn with_time_scale(&self, factor: f64) -> Self {
        self.around(&self.posed().with_time_scale(factor))
    }

    /// Returns the setup around the problem of a solution, which may last longer or shorter: its scene, read again, describes that
    /// problem's grid.
    #[must_use]
    pub fn around(&self, problem: &Problem) -> Self {
        let mut out = self.clone();
        if problem.discrete.grid == self.problem.grid {
            return out;
        }
        out.task = problem.task.clone();
        out.discretization = problem.discretization;
        out.problem = problem.discrete.clone();
        resolve_time(&mut out.resolved, &out.problem.grid);
        if let Some(task) = &mut out.resolved.task {
            let end = out.problem.grid.duration();
            task.at_s = Some(known(end));
            for (via, target) in task.via.iter_mut().zip(&problem.task.targets) {
                via.at_s = known(target.time.unwrap_or(end));
            }
            let until = out.resolved.time.end_s.get().max(end);
            out.resolved.time.end_s = known(until);
        }
        out
    }

    /// Arm, task, discretization and discrete problem together.
    #[must_use]
    pub fn posed(&self) -> Problem {
        Problem {
            arm: self.arm.clone(),
            task: self.task.clone(),
            discretization: self.discretization,
            discrete: self.problem.clone(),
        }
    }

    /// Checks a solution, with the limits that the scene asks for.
    ///
    /// # Errors
    /// [`CheckError`] when a replay cannot be made.
    pub fn certify(&self, solution: &Claim) -> Result<ForwardCheck, CheckError> {
        self.posed().certify(solution, &self.check_limits())
    }

    /// Returns the limits of the check: those of optimality follow the solver's tolerance, as far as a certificate may.
    #[must_use]
    pub fn check_limits(&self) -> CheckLimits {
        CheckLimits::of(&self.settings)
    }
}

impl Scene {
    /// The forward simulation that the scene describes.
    ///
    /// # Errors
    /// [`SceneError`] for a step above the stable limit, or an initial equilibrium that does not exist.
    pub fn simulation(&self, source: &SceneSource) -> Result<Simulation, SceneError> {
        self.simulation_until(source, &StopSignal::default())
    }

    /// [`Self::simulation`], unless `stop` is raised before its initial state is found.
    ///
    /// # Errors
    /// As [`Self::simulation`].
    pub fn simulation_until(
        &self,
        source: &SceneSource,
        stop: &StopSignal,
    ) -> Result<Simulation, SceneError> {
        self.check_step(source)?;
        let arm = self.arm(source)?;
        let refused = |error| self.discretize_error(source, error);
        let motion = arm
            .discretize(self.time.end_s.get(), &self.discretization())
            .map_err(refused)?;
        let output = self.output.clone().unwrap_or_default();
        let rate_hz = output.rate_hz.map(Number::get);
        let (mut grid, rod) = (motion.grid, motion.rod);
        if let (Some(rate), None) = (rate_hz, self.time.step_s) {
            grid = row_grid(source, grid, rate)?;
        }
        let discretization = Discretization {
            step: Some(grid.step),
            ..motion.discretization
        };
        let initial = (self.start().state(&rod, stop)).map_err(|error| refused(error.into()))?;
        let resolved = self.resolved(&arm, &discretization);
        Ok(Simulation {
            arm,
            discretization,
            steps_per_row: rate_hz.map_or(1, |rate| {
                ((1.0 / (rate * grid.step)).round() as usize).max(1)
            }),
            divided: 1,
            diagnostics: output.diagnostics,
            initial,
            resolved,
            rod,
            grid,
        })
    }

    /// The rod of the scene's arm with the elements of `rod.elements`, or where these are to be chosen with those of its simulation.
    ///
    /// # Errors
    /// As [`Self::arm`], and [`SceneError`] for a rod that cannot be built.
    pub fn discrete_rod(&self, source: &SceneSource) -> Result<Rod, SceneError> {
        if self.rod.accuracy.is_some() {
            return Ok(self.simulation(source)?.rod);
        }
        self.rod_of(source, &self.discretization())
    }

    /// Returns the rod of the scene's arm with a discretization.
    ///
    /// # Errors
    /// As [`Self::discrete_rod`].
    pub(crate) fn rod_of(
        &self,
        source: &SceneSource,
        discretization: &Discretization,
    ) -> Result<Rod, SceneError> {
        let arm = self.arm(source)?;
        (arm.rod(discretization)).map_err(|error| self.discretize_error(source, error.into()))
    }

    /// The optimal-control problem that the scene describes; its horizon ends at `task.at_s`, or without a task at `time.end_s`.
    ///
    /// # Errors
    /// [`SceneError`] when `[control]` is missing, or both `[task]` and `[[objective.track]]`, and as [`Self::simulation`].
    pub fn optimal_control(&self, source: &SceneSource) -> Result<OptimalControl, SceneError> {
        let deadline = self.deadline(Instant::now());
        self.optimal_control_until(source, &StopSignal::new(deadline, None))
    }

    /// Returns the instant at which a solve that began at `began` must end, by `solver.deadline_s`.
    #[must_use]
    pub fn deadline(&self, began: Instant) -> Option<Instant> {
        let seconds = self.solver.as_ref()?.deadline_s?.get();
        // A deadline beyond the range of the clock is none.
        began.checked_add(Duration::try_from_secs_f64(seconds).ok()?)
    }

    /// Returns the same as [`Self::optimal_control`], with another signal than the scene's own [deadline](Self::deadline), counted from
    /// here: `stop` ends the search for the initial state, and later all work on the problem.
    ///
    /// # Errors
    /// Those of [`Self::optimal_control`].
    pub fn optimal_control_until(
        &self,
        source: &SceneSource,
        stop: &StopSignal,
    ) -> Result<OptimalControl, SceneError> {
        let task = self.posed_task(source)?;
        let solver = self.solver.clone().unwrap_or_default();
        let posed = task
            .discretize_until(&self.arm(source)?, &self.discretization(), stop)
            .map_err(|error| self.discretize_error(source, error))?;
        if solver.qp == QpRoute::Sparse && posed.discrete.n_states().is_none() {
            return Err(source.error_at(
                "solver.qp",
                "\"sparse\" is for explicit steps of the standard model without internal damping",
                Some("give \"condensed\"".into()),
            ));
        }
        let resolved = Scene {
            task: (self.task.clone()).map(|task| task.resolved(&posed)),
            objective: Some(self.resolved_objective(&posed.discrete)),
            solver: Some(solver.clone()),
            ..self.resolved(&posed.arm, &posed.discretization)
        };
        let Problem {
            arm,
            task,
            discretization,
            discrete: problem,
        } = posed;
        let feedback = self.control.as_ref().and_then(|control| control.feedback);
        Ok(OptimalControl {
            arm,
            task,
            discretization,
            problem,
            settings: SqpSettings {
                tolerance: solver.tolerance.get(),
                max_iterations: solver.max_iterations,
                saddle_gain: solver.saddle_gain.get(),
                hessian: solver.hessian,
                qp: solver.qp,
                ..SqpSettings::default()
            },
            search: Search {
                continuation: solver.continuation,
                guess: solver.guess,
                ..Search::default()
            },
            feedback,
            diagnostics: (self.output.as_ref()).is_some_and(|output| output.diagnostics),
            resolved,
        })
    }

    /// Returns the places of the nodes.
    #[must_use]
    pub fn mesh(&self) -> Mesh {
        Mesh::new(self.rod.elements, &self.breaks(), 1)
    }

    /// Returns the fractions of the length at which elements end, besides base and tip.
    pub(super) fn breaks(&self) -> Vec<f64> {
        let segments = self.rod.segment_ends().into_iter().map(|[_, to]| to);
        let curvature = self.rod.curvature_rows();
        let bodies = self.body.iter().map(|body| body.at.get());
        let actuators = self.strain_actuators();
        let actuators = actuators
            .iter()
            .flat_map(crate::mechanics::StrainActuator::breaks);
        let poses = self.pose_actuators().into_iter().flat_map(|own| own.parts);
        let poses = poses.flat_map(|(span, _)| span.breaks());
        let contacts = self.contact.iter();
        let contacts = contacts.flat_map(|own| [own.from.get(), own.to.get()]);
        let learned = (self.learned.iter()).flat_map(|own| [own.from.get(), own.to.get()]);
        let contacts = contacts.chain(learned);
        let of_rod = segments.chain(rows::steps(&curvature)).chain(bodies);
        (of_rod.chain(actuators).chain(poses))
            .chain(contacts)
            .collect()
    }

    /// The arm that the scene describes.
    ///
    /// # Errors
    /// [`SceneError`] where the section is incomplete, or the motion of the base is no curve.
    pub fn arm(&self, source: &SceneSource) -> Result<Arm, SceneError> {
        let reference = self.rod.reference.as_ref();
        let mesh = self.mesh();
        let roll = self.rod.roll();
        let rolled = |orientation: [f64; 4]| {
            let mut rotation = from_quaternion(orientation);
            if roll != 0.0 {
                rotation *= exp(&Vector3::new(0.0, 0.0, roll));
            }
            rotation
        };
        let base_rotation = rolled(self.base.unit_quaternion());
        let tip = self.tip.clone().unwrap_or_default();
        let tip_rotation = tip.unit_quaternion().map(rolled);
        let straight = Arm::straight(self.rod.length_m.get(), self.section_profile(source)?);
        let mut arm = Arm {
            model: self.rod.model,
            rest_curvature: match reference {
                Some(reference) if !self.rod.is_curved_by_segments() => {
                    reference.curvature_1_m.into()
                }
                _ => Vector3::zeros(),
            },
            curvature_rows: (self.rod.curvature_rows().into_iter())
                .map(|(s, curvature)| (s, curvature.into()))
                .collect(),
            rest_stretch: reference.map_or(1.0, |r| r.stretch.get()),
            base: end_condition(
                self.base.kind,
                self.base.axis,
                self.base.motion.as_ref(),
                &base_rotation,
            )
            .map_err(|error| source.error_at("base.motion", error.to_string(), None))?,
            base_position: self.base.position_m.into(),
            base_rotation,
            tip: end_condition(
                tip.kind,
                tip.axis,
                tip.motion.as_ref(),
                &tip_rotation.unwrap_or_else(Matrix3::identity),
            )
            .map_err(|error| source.error_at("tip.motion", error.to_string(), None))?,
            tip_position: tip.position_m.map(Into::into),
            tip_rotation,
            actuators: self.strain_actuators(),
            pose_actuators: self.pose_actuators(),
            learned: self.learned_parts(),
            radii: self.radii(),
            ..straight
        };
        self.put_loads(&mesh, &mut arm);
        if self.contact.is_empty() {
            return Ok(arm);
        }
        let usual = (arm.usual_contact_force())
            .map_err(|error| self.discretize_error(source, error.into()))?;
        let contacts = self.contact.iter().enumerate();
        let radius = (arm.radii.iter())
            .map(|row| row.1)
            .fold(f64::INFINITY, f64::min);
        let radius = if radius.is_finite() { radius } else { 0.0 };
        let size = [arm.length, radius];
        arm.contacts = contacts
            .filter_map(|(index, own)| own.of_arm(index, usual, size))
            .collect();
        Ok(arm)
    }

    /// The state in which the scene's motion starts.
    #[must_use]
    pub fn start(&self) -> Start {
        (self.initial.as_ref()).map_or_else(Start::default, model::Initial::of_task)
    }

    /// The discretization that the scene asks for.
    #[must_use]
    pub fn discretization(&self) -> Discretization {
        let default = Discretization::default();
        let is_sparse = (self.solver.as_ref()).is_some_and(|solver| solver.qp == QpRoute::Sparse);
        Discretization {
            elements: match self.rod.accuracy {
                // The elements are chosen later, and each piece has one at least.
                Some(_) => self.mesh().n_elements(),
                None => self.rod.elements,
            },
            multiple: 1,
            strain_rule: self.rod.strain,
            // Implicit steps are not local enough for the sparse route.
            scheme: (self.time.integrator).or(is_sparse.then_some(TimeScheme::Explicit)),
            // Whoever gives an inertia means that one.
            rotary_inertia: (self.rod.rotary_inertia)
                .or((!self.rod.has_material()).then_some(RotaryInertia::Section)),
            step: self.time.step_s,
            hold: (self.control.as_ref()).map_or(default.hold, |control| control.hold),
            blocks: (self.control.as_ref()).map_or(default.blocks, |control| control.blocks),
            samples: (self.objective.as_ref())
                .map_or(default.samples, |objective| objective.samples),
        }
    }

    /// The task that the scene describes.
    ///
    /// # Errors
    /// [`SceneError`] when `[control]` is missing, or both `[task]` and `[[objective.track]]`.
    pub fn posed_task(&self, source: &SceneSource) -> Result<Task, SceneError> {
        self.check_step(source)?;
        let end = self.time.end_s.get();
        let end = (self.task.as_ref()).map_or(end, |task| task.instant(end));
        self.posed_task_until(source, end)
    }

    /// Refuses a step that is longer than the motion. A loop may have steps longer than `time.end_s`, because its horizon is longer, and an
    /// equilibrium has none.
    fn check_step(&self, source: &SceneSource) -> Result<(), SceneError> {
        let end = self.time.end_s.get();
        match self.time.step_s {
            Some(step) if end > 0.0 && step > end => {
                let message = format!(
                    "a step of {} s is longer than time.end_s, {} s",
                    digits(step),
                    digits(end)
                );
                Err(source.error_at("time.step_s", message, None))
            }
            _ => Ok(()),
        }
    }

    /// Returns the task that the scene describes, with paths that go on until `end`, s.
    pub(super) fn posed_task_until(
        &self,
        source: &SceneSource,
        end: f64,
    ) -> Result<Task, SceneError> {
        let missing = |section: &str| {
            source.error_at(
                section,
                format!("[{section}] is missing"),
                Some(
                    "an optimal-control problem needs [control], and [task] or [[objective.track]]; `softarm example reach` shows \
                     [task] and [control]"
                        .into(),
                ),
            )
        };
        let objective = self.objective.clone().unwrap_or_default();
        let task = self.task.as_ref();
        if task.is_none() && objective.track.is_empty() {
            return Err(missing("task"));
        }
        let efforts = self.effort_controls();
        let none = model::Control::default();
        let control = match &self.control {
            Some(control) => control,
            // The efforts of actuators in the arm are controls enough.
            None if !efforts.is_empty() => &none,
            None => return Err(missing("control")),
        };
        let horizon = task.map_or(self.time.end_s.get(), |task| {
            task.instant(self.time.end_s.get())
        });
        if !(horizon > 0.0) {
            let message = "a path cannot be followed in no time";
            let error = source.error_at("time.end_s", message, None);
            return Err(error.expecting("expected a positive duration"));
        }
        let mesh = self.mesh();
        Ok(Task {
            horizon,
            free_duration: task.and_then(|task| task.free_duration),
            start: self.start(),
            targets: task.map_or_else(Vec::new, |task| task.targets(&mesh)),
            limits: self.limits(),
            actuators: control.of_task(&mesh),
            efforts,
            keeps_taut: control.keep_taut,
            own_actuators: (control.distributed.iter())
                .map(model::Distributed::of_task)
                .collect(),
            cost: objective.of_task(&mesh, end),
        })
    }

    /// Tells whether there is something to choose: a force or a moment, or the effort of an actuator in the arm.
    #[must_use]
    pub fn has_controls(&self) -> bool {
        self.control.is_some() || !self.effort_controls().is_empty()
    }

    /// Returns the obstacles, then the limits.
    #[must_use]
    pub fn limits(&self) -> Vec<Limit> {
        let obstacles = self.obstacle.iter().enumerate();
        let obstacles = obstacles.filter_map(|(index, obstacle)| obstacle.of_task(index));
        let mesh = self.mesh();
        let limits = (self.limit.iter()).filter_map(|limit| limit.of_task(&mesh));
        obstacles.chain(limits).collect()
    }

    /// This scene with the figures of its material in place of the name.
    fn with_material_resolved(&self) -> Scene {
        let mut resolved = self.clone();
        resolved.rod.material = self
            .rod
            .material
            .as_ref()
            .map(model::MaterialKeys::resolved);
        for segment in &mut resolved.rod.segment {
            segment.material = segment.material.as_ref().map(model::MaterialKeys::resolved);
        }
        resolved
    }

    /// Returns this scene, of this arm, with material, integrator, rotary inertia, time step and the forces of contacts written out as they were
    /// chosen.
    pub(crate) fn resolved(&self, arm: &Arm, discretization: &Discretization) -> Scene {
        let mut resolved = self.with_material_resolved();
        resolved.rod.accuracy = None;
        for (own, contact) in resolved.contact.iter_mut().zip(&arm.contacts) {
            own.force_n = Some(known(contact.force));
        }
        resolved.take_steps(discretization);
        resolved
    }

    /// Writes out time step, integrator and rotary inertia of a discretization, as far as they are chosen.
    pub(super) fn take_steps(&mut self, chosen: &Discretization) {
        self.time.step_s = chosen.step.or(self.time.step_s);
        self.time.integrator = chosen.scheme.or(self.time.integrator);
        self.rod.rotary_inertia = chosen.rotary_inertia.or(self.rod.rotary_inertia);
    }
}

impl Scene {
    /// Returns the objective as it was [resolved](ObjectiveKeys::resolved) for a problem.
    pub(super) fn resolved_objective(&self, problem: &OptimalControlProblem) -> ObjectiveKeys {
        let objective = self.objective.clone().unwrap_or_default();
        objective.resolved(problem)
    }

    /// Returns the duration and tolerance of the stay at the target; `None` if the arm need not stay.
    pub(crate) fn staying(&self) -> Option<Staying> {
        match self.task.as_ref()?.rest() {
            Rest::Staying(staying) => Some(staying),
            Rest::Passing | Rest::Instant => None,
        }
    }
}

fn resolve_time(scene: &mut Scene, grid: &TimeGrid) {
    scene.time.step_s = Some(grid.step);
}

/// Returns the columns of a rotation: the directors `d1`, `d2`, `d3`.
#[must_use]
pub fn directors(rotation: &Matrix3<f64>) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|i| rotation.column(i).into_owned().into())
}

/// Returns the directors that a target asks for: those of an orientation, or the third one of a direction; `None` without either.
pub(crate) fn target_directors(
    rotation: Option<Matrix3<f64>>,
    direction: Option<Vector3<f64>>,
) -> Option<[Option<[f64; 3]>; 3]> {
    let all = rotation.map(|rotation| directors(&rotation).map(Some));
    all.or_else(|| Some([None, None, Some(direction?.into())]))
}
