//! From a checked scene to the rod, the simulation and the optimal-control problem that it describes.

use std::time::{Duration, Instant};

use nalgebra::{Matrix3, Vector3};

use super::check::{MOST_ELEMENTS, MOST_STEPS};
use super::error::SceneError;
use super::model::{self, InitialShape, Objective, Scene, TimeStep};
use super::prediction::{Work, automatic_scheme, prefers_segments};
use super::source::SceneSource;
use crate::control::path::thinnest;
use crate::control::{
    Actuator, Bound, Channel, Continuation, ControlGrid, DurationConflict, Enforcement,
    FeedbackWeights, FreeDuration, Goal, GoalPart, Guess, Hold, OptimalControlProblem,
    PathConstraint, PathEnforcement, PathLimit, Posture, Search, Shape,
};
use crate::mechanics::equilibrium::{EquilibriumError, TipSpring, static_equilibrium_until};
use crate::mechanics::rotation::{from_quaternion, log, unit};
use crate::mechanics::stability::{automatic_step, stable_step};
use crate::mechanics::{
    BaseCondition, BaseMotion, CubicSpline, DistributedLoad, Load, LoadFrame, Material,
    MotionCurve, NodeInertia, Oscillation, Rod, RodError, RodModel, RodParameters, RotaryInertia,
    Section, SectionProfile, State, StrainRule, TimeGrid, TimeScheme,
};
use crate::sqp::{HessianChoice, QpRoute, SqpSettings};
use crate::stop::StopSignal;
use crate::verify::{CheckError, CheckLimits, ForwardCheck, Solution, forward_check};

/// A forward simulation.
#[derive(Clone, Debug)]
pub struct Simulation {
    /// What the rod is built from.
    pub parameters: RodParameters,
    /// The rod.
    pub rod: Rod,
    /// The time grid.
    pub grid: TimeGrid,
    /// Steps between two rows of the result.
    pub steps_per_row: usize,
    /// Whether diagnostics are written.
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

    /// Where rows cannot fall at the times that `output.rate_hz` asks for, because the steps do not divide their interval: what they do
    /// instead, in a sentence.
    #[must_use]
    pub fn row_warning(&self) -> Option<String> {
        let rate = self.resolved.output.as_ref()?.rate_hz?;
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

/// An optimal-control problem, and how to solve it.
#[derive(Clone, Debug)]
pub struct OptimalControl {
    /// What the rod is built from.
    pub parameters: RodParameters,
    /// The problem.
    pub problem: OptimalControlProblem,
    /// Settings of the solver.
    pub settings: SqpSettings,
    /// Where the solve starts.
    pub search: Search,
    /// Weights of the regulator around the solution; none where there should be none.
    pub feedback: Option<FeedbackWeights>,
    /// Whether diagnostics are written.
    pub diagnostics: bool,
    /// The scene with every default and derived value written out.
    pub resolved: Scene,
}

impl OptimalControl {
    /// The same problem on the grid of a solution, whose free duration then is that of the grid.
    #[must_use]
    pub fn on_own_grid(&self, variables: &mut [f64]) -> Self {
        let out = self.stretched(self.problem.stretch(variables));
        if let Some(duration) = self.problem.duration_variable() {
            variables[duration] = 1.0;
        }
        out
    }

    /// The same problem around a solution whose duration is `stretch` times that of the grid: its scene, read again, describes that grid.
    #[must_use]
    pub fn stretched(&self, stretch: f64) -> Self {
        let mut out = self.clone();
        if stretch == 1.0 {
            return out;
        }
        out.problem = self.problem.stretched(stretch);
        resolve_time(&mut out.resolved, &out.problem.grid);
        if let Some(task) = &mut out.resolved.task {
            let end = out.problem.grid.end();
            task.at_s = Some(end);
            for via in &mut task.via {
                via.at_s *= stretch;
            }
            out.resolved.time.end_s = out.resolved.time.end_s.max(end);
        }
        out
    }

    /// Checks a solution, with the limits that the scene asks for.
    ///
    /// # Errors
    /// [`CheckError`] when a replay cannot be made.
    pub fn certify(&self, solution: &Solution) -> Result<ForwardCheck, CheckError> {
        forward_check(
            &self.problem,
            &self.parameters,
            &|rod| {
                // The finer rod's equilibrium exists wherever the coarse one's did; its rest shape is the fall-back.
                (self.resolved.starting_state_until(rod, &self.problem.stop))
                    .unwrap_or_else(|_| rod.at_rest_on_base(rod.rest.clone()))
            },
            solution,
            &self.check_limits(),
        )
    }

    /// The limits of the check: those of optimality go with the solver's tolerance, as far as a certificate may.
    #[must_use]
    pub fn check_limits(&self) -> CheckLimits {
        let limits = CheckLimits::default();
        CheckLimits {
            kkt: self
                .settings
                .tolerance
                .clamp(limits.kkt, CheckLimits::LOOSEST_KKT),
            saddle_gain: self.settings.saddle_gain,
            ..limits
        }
    }
}

/// Variables of the dense subproblem: beyond, one iteration takes minutes and gigabytes.
const MOST_VARIABLES: usize = 2000;
/// Times at which a path constraint is kept where its scene names no rate: what an arm does in between is of higher order in the
/// spacing, and the check looks at it.
const MOST_SAMPLES: usize = 1000;
/// Elements up to which gains are computed unasked: they take time with the cube of the number, and a part of a solve's up to here.
const MOST_FEEDBACK_ELEMENTS: usize = 40;
/// Penetration of an obstacle that counts as touching, in rod lengths; and what else is scaled and rounded.
const START_TOLERANCE: f64 = 1e-9;
/// States that a solve may hold; beyond, the trajectory alone would not fit in memory.
const MOST_STORED_STATES: f64 = 5e7;

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
        let (parameters, rod) = self.rod_of(source, self.time.end_s, Work::Simulation)?;
        let output = self.output.clone().unwrap_or_default();
        let mut grid = self.grid(source, &rod, self.time.end_s, 1)?;
        if let (Some(rate), TimeStep::Auto) = (output.rate_hz, self.time.step_s) {
            grid = row_grid(source, grid, rate)?;
        }
        let initial = self.initial_state(source, &rod, stop)?;
        let mut resolved = self.with_material_resolved();
        resolve_time(&mut resolved, &grid);
        resolved.time.integrator = integrator(&rod);
        resolved.rod.rotary_inertia = rotary_inertia(&parameters);
        Ok(Simulation {
            parameters,
            rod,
            grid,
            steps_per_row: output.rate_hz.map_or(1, |rate| {
                ((1.0 / (rate * grid.step)).round() as usize).max(1)
            }),
            diagnostics: output.diagnostics,
            initial,
            resolved,
        })
    }

    /// The optimal-control problem that the scene describes; its horizon ends at `task.at_s`, or without a task at `time.end_s`.
    ///
    /// # Errors
    /// [`SceneError`] when `[control]` is missing, or both `[task]` and `[[objective.track]]`, and as [`Self::simulation`].
    pub fn optimal_control(&self, source: &SceneSource) -> Result<OptimalControl, SceneError> {
        let deadline = self.deadline(Instant::now());
        self.optimal_control_until(source, &StopSignal::new(deadline, None))
    }

    /// When a solve that began at an instant must end, by `solver.deadline_s`.
    #[must_use]
    pub fn deadline(&self, began: Instant) -> Option<Instant> {
        let seconds = self.solver.as_ref()?.deadline_s?;
        // Beyond what a clock can tell there is no deadline worth the name.
        began.checked_add(Duration::try_from_secs_f64(seconds).ok()?)
    }

    /// [`Self::optimal_control`] with another signal than the scene's own [deadline](Self::deadline), counted from here: `stop` ends
    /// this, while the initial state is not found, and all work on the problem.
    ///
    /// # Errors
    /// As [`Self::optimal_control`].
    pub fn optimal_control_until(
        &self,
        source: &SceneSource,
        stop: &StopSignal,
    ) -> Result<OptimalControl, SceneError> {
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
        let control = self.control.as_ref().ok_or_else(|| missing("control"))?;
        let solver = self.solver.clone().unwrap_or_default();
        let horizon = task.map_or(self.time.end_s, |task| task.instant(self.time.end_s));
        if !(horizon > 0.0) {
            let message = "a path cannot be followed in no time";
            let error = source.error_at("time.end_s", message, None);
            return Err(error.expecting("expected a positive duration"));
        }
        let free_duration = task.and_then(|task| task.free_duration);
        let work = Work::Solve {
            n_variables: control
                .blocks
                .saturating_mul(6 * (1 + control.actuator.len())),
        };
        let longest = free_duration.map_or(horizon, |free| free.longest_s);
        let (parameters, rod) = self.rod_of(source, longest, work)?;
        let grid = match &free_duration {
            None => self.grid(source, &rod, horizon, control.blocks)?,
            Some(free) => self.stretching_grid(source, &rod, horizon, free, control.blocks)?,
        };
        let states = grid.n_steps as f64 * rod.n_nodes() as f64;
        if !(states <= MOST_STORED_STATES) {
            return Err(source.error_at(
                "time.end_s",
                format!(
                    "{:.3e} steps of {:.3e} s with {} nodes do not fit in memory",
                    grid.n_steps as f64,
                    grid.step,
                    rod.n_nodes()
                ),
                Some("use a shorter time, fewer elements, or a softer or heavier arm".into()),
            ));
        }
        let initial = self.initial_state(source, &rod, stop)?;
        let hold = match control.hold {
            model::Hold::Constant => Hold::Constant,
            model::Hold::Linear => Hold::Linear,
            model::Hold::Cubic => Hold::Cubic,
        };
        let blocks =
            ControlGrid::new(hold, control.blocks, grid.n_steps, grid.step).ok_or_else(|| {
                source.error_at(
                    "control.blocks",
                    format!(
                        "{} blocks do not fit into {} time steps",
                        control.blocks, grid.n_steps
                    ),
                    Some("use fewer blocks or a shorter time.step_s".into()),
                )
            })?;
        let force_scale = objective.force_scale_n.unwrap_or(rod.scales.force);
        let moment_scale = objective
            .moment_scale_n_m
            .unwrap_or_else(|| weakest_bending(&rod, control) / rod.scales.length);
        let actuator = |node: usize, force: Option<model::Bound>, moment: Option<model::Bound>| {
            let channel =
                |scale: f64, limit: Option<model::Bound>, rate: Option<model::Bound>| Channel {
                    scale,
                    bound: limit.map_or(Some(NOT_ACTUATED), bound),
                    rate_bound: rate.and_then(bound),
                };
            Actuator {
                node,
                force: channel(force_scale, force, control.force_rate_max_n_s),
                moment: channel(moment_scale, moment, control.moment_rate_max_n_m_s),
            }
        };
        let mut actuators = vec![actuator(
            rod.tip(),
            control.force_max_n,
            control.moment_max_n_m,
        )];
        actuators.extend((control.actuator.iter()).map(|definition| {
            actuator(
                definition.node,
                definition.force_max_n,
                definition.moment_max_n_m,
            )
        }));
        let objective = objective.weighted(&rod, &actuators);
        let resolved = {
            let mut resolved = self.with_material_resolved();
            resolve_time(&mut resolved, &grid);
            resolved.time.integrator = integrator(&rod);
            resolved.rod.rotary_inertia = rotary_inertia(&parameters);
            if let Some(task) = &mut resolved.task {
                task.at_s = Some(horizon);
                if task.at_rest && task.hard {
                    let [speed, spin] = task.rest_tolerances(self.rod.length_m, horizon);
                    task.tolerance_m_s = Some(speed);
                    task.tolerance_rad_s = Some(spin);
                }
            }
            resolved.objective = Some(Objective {
                force_scale_n: Some(force_scale),
                moment_scale_n_m: Some(moment_scale),
                ..objective.clone()
            });
            resolved.solver = Some(solver.clone());
            resolved
        };
        let problem = OptimalControlProblem {
            stop: stop.clone(),
            radii: self.display_radii(),
            goals: task.map_or_else(Vec::new, |task| self.goals(task, &rod, &grid)),
            path: self.path_constraints(&rod, &longest_grid(free_duration.as_ref(), grid)),
            duration: free_duration.map(|free| FreeDuration {
                shortest: free.shortest_s,
                longest: free.longest_s,
                price: free.price,
            }),
            objective: crate::control::Objective {
                effort: objective.effort,
                rate: objective.rate,
                energy: objective.energy,
                tracking: (objective.track.iter())
                    .map(|track| track.tracking(&rod))
                    .collect(),
                samples: objective.samples,
            },
            grid,
            initial,
            control: blocks,
            actuators,
            rod,
        };
        self.check_start(source, &problem)?;
        self.check_goals(source, &problem)?;
        if let Some((conflict, what)) = problem.duration_conflict() {
            let key = match conflict {
                DurationConflict::Rate => "control".into(),
                DurationConflict::Path(at) => match at.checked_sub(self.obstacle.len()) {
                    None => format!("obstacle.{at}.soft"),
                    Some(at) => format!("limit.{at}.soft"),
                },
                DurationConflict::Base => "base.motion".into(),
            };
            let message = format!("task.free_duration does not go with {what}");
            return Err(source.error_at(&key, message, None));
        }
        if problem.n_variables() > MOST_VARIABLES {
            return Err(source.error_at(
                "control.blocks",
                format!(
                    "{} blocks make {} variables, more than {MOST_VARIABLES}",
                    control.blocks,
                    problem.n_variables()
                ),
                Some("the subproblem is dense in the controls; use fewer blocks".into()),
            ));
        }
        if solver.qp == model::Qp::Sparse && problem.state_size().is_none() {
            return Err(source.error_at(
                "solver.qp",
                "\"sparse\" is for explicit steps of the standard model without internal damping",
                Some("give \"auto\" or \"condensed\"".into()),
            ));
        }
        Ok(OptimalControl {
            parameters,
            problem,
            settings: SqpSettings {
                tolerance: solver.tolerance,
                max_iterations: solver.max_iterations,
                saddle_escapes: solver.saddle_escapes,
                saddle_gain: solver.saddle_gain,
                hessian: match solver.hessian {
                    model::Hessian::Auto => HessianChoice::Auto,
                    model::Hessian::GaussNewton => HessianChoice::GaussNewton,
                    model::Hessian::Exact => HessianChoice::Exact,
                    model::Hessian::Bfgs => HessianChoice::Bfgs,
                    model::Hessian::Sr1 => HessianChoice::Sr1,
                },
                qp: match solver.qp {
                    model::Qp::Auto => QpRoute::Auto,
                    model::Qp::Condensed => QpRoute::Condensed,
                    model::Qp::Sparse => QpRoute::Sparse,
                },
                stop: stop.clone(),
                ..SqpSettings::default()
            },
            search: Search {
                continuation: solver.continuation.as_ref().map(|stages| match *stages {
                    model::Continuation::Target(stages) => Continuation::Target { stages },
                    model::Continuation::Load(stages) => Continuation::Load { stages },
                }),
                guess: match solver.guess {
                    model::Guess::Auto => None,
                    model::Guess::Static => Some(Guess::StaticPath),
                    model::Guess::Slow => Some(Guess::Slow),
                    model::Guess::Rest => Some(Guess::Rest),
                },
                ..Search::default()
            },
            feedback: match &control.feedback {
                Some(feedback) => Some(FeedbackWeights {
                    state: feedback.state,
                    input: feedback.input,
                    tolerance: feedback.tolerance,
                }),
                None if self.rod.elements <= MOST_FEEDBACK_ELEMENTS => {
                    Some(FeedbackWeights::default())
                }
                None => None,
            },
            diagnostics: (self.output.as_ref()).is_some_and(|output| output.diagnostics),
            resolved,
        })
    }

    /// The task and the points on the way to it.
    fn goals(&self, task: &model::Task, rod: &Rod, grid: &TimeGrid) -> Vec<Goal> {
        let last = grid.n_steps;
        let via = task.via.iter().enumerate().flat_map(|(index, via)| {
            let time_node = ((via.at_s / grid.step).round() as usize).clamp(1, last);
            let goal = Goal {
                name: format!("task.via.{index}"),
                node: via.node.index(rod.tip()),
                time_node,
                position: via.position_m.map(Vector3::from),
                rotation: via.orientation_wxyz.map(from_quaternion),
                at_rest: false,
                enforcement: enforcement(via.hard, via.weight),
            };
            let tolerances = Tolerances {
                distance: via.tolerance_m,
                angle: via.tolerance_rad,
                ..Tolerances::default()
            };
            with_tolerances(goal, tolerances)
        });
        let goal = Goal {
            name: "task".into(),
            node: rod.tip(),
            time_node: last,
            position: task.position_m.map(Vector3::from),
            rotation: task.orientation_wxyz.map(from_quaternion),
            at_rest: task.at_rest,
            enforcement: enforcement(task.hard, task.weight),
        };
        let mut goals: Vec<Goal> = via.collect();
        let tolerances = Tolerances {
            distance: task.tolerance_m,
            angle: task.tolerance_rad,
            rest: task.rest_tolerances(self.rod.length_m, task.instant(self.time.end_s)),
        };
        goals.extend(with_tolerances(goal, tolerances));
        goals
    }

    fn path_constraints(&self, rod: &Rod, grid: &TimeGrid) -> Vec<PathConstraint> {
        let time_nodes = |rate: Option<f64>| -> Vec<usize> {
            let stride = rate.map_or_else(
                || grid.n_steps.div_ceil(MOST_SAMPLES).max(1),
                |rate| ((1.0 / (rate * grid.step)).round() as usize).clamp(1, grid.n_steps),
            );
            let mut nodes: Vec<usize> = (0..=grid.n_steps).step_by(stride).collect();
            if nodes[nodes.len() - 1] != grid.n_steps {
                nodes.push(grid.n_steps);
            }
            nodes
        };
        let price = |soft: Option<model::Price>| {
            soft.map_or(PathEnforcement::Hard, |price| PathEnforcement::Soft {
                linear: price.linear,
                quadratic: price.quadratic,
            })
        };
        let obstacles =
            (self.clearances(rod).into_iter()).map(|(obstacle, name, limit)| PathConstraint {
                name,
                limit,
                time_nodes: time_nodes(obstacle.rate_hz),
                enforcement: price(obstacle.soft),
            });
        let limits = self.limit.iter().filter_map(|limit| {
            let definition = if let Some([least, largest]) = limit.stretch {
                PathLimit::Stretch { least, largest }
            } else if let Some(largest) = limit.curvature_max_1_m {
                PathLimit::Curvature { largest }
            } else if let Some(largest) = limit.twist_max_1_m {
                PathLimit::Twist { largest }
            } else {
                let node = limit.node.unwrap_or_default().index(rod.tip());
                let largest = limit.speed_max_m_s?;
                PathLimit::Speed { node, largest }
            };
            Some(PathConstraint {
                name: limit.name(),
                limit: definition,
                time_nodes: time_nodes(limit.rate_hz),
                enforcement: price(limit.soft),
            })
        });
        obstacles.chain(limits).collect()
    }

    /// The obstacles with their names in reports, each as a limit on the scene's own rod.
    #[must_use]
    pub fn clearances(&self, rod: &Rod) -> Vec<(&model::Obstacle, String, PathLimit)> {
        let thinnest = thinnest(&self.display_radii());
        let chord = (rod.rest_chords.iter().copied()).fold(0.0, f64::max);
        (self.obstacle.iter().enumerate())
            .filter_map(|(index, obstacle)| {
                let name = obstacle.name(index);
                let shape = shape(obstacle)?;
                let margin = obstacle.margin_m;
                let radius = shape.least_radius() + thinnest + margin;
                let limit = PathLimit::Clearance {
                    shape,
                    margin,
                    points: PathLimit::points_per_element(chord, radius),
                };
                Some((obstacle, name, limit))
            })
            .collect()
    }

    /// Whether the arm, as it is at the start, keeps all that is hard: nothing could be done about it.
    fn check_start(
        &self,
        source: &SceneSource,
        problem: &OptimalControlProblem,
    ) -> Result<(), SceneError> {
        let mut start = crate::mechanics::Trajectory::with_capacity(problem.rod.n_nodes(), 1);
        start.push(&problem.initial.configuration);
        let posture = Posture {
            rod: &problem.rod,
            radii: &problem.radii,
            trajectory: &start,
            step: problem.grid.step,
        };
        for (index, constraint) in problem.path.iter().enumerate() {
            if constraint.enforcement != PathEnforcement::Hard {
                continue;
            }
            let limit = &constraint.limit;
            let worst = (0..limit.n_items(&problem.rod))
                .map(|item| (limit.value(&posture, 0, item), item))
                .fold(
                    (0.0, 0),
                    |worst, row| if row.0 > worst.0 { row } else { worst },
                );
            if worst.0 <= START_TOLERANCE {
                continue;
            }
            let (name, node) = (&constraint.name, limit.node(worst.1));
            let amount = worst.0 * limit.scale(&problem.rod);
            let (key, message, help) = match index.checked_sub(self.obstacle.len()) {
                None => (
                    format!("obstacle.{index}"),
                    format!("at t = 0 the arm is {amount:.3e} m inside \"{name}\" at node {node}"),
                    "move the obstacle, give it a smaller margin_m, or a soft price",
                ),
                Some(index) => (
                    format!("limit.{index}"),
                    format!(
                        "at t = 0 the arm is {amount:.3e} {} beyond \"{name}\" at the element from node {node}",
                        limit.unit()
                    )
                    .replace("  ", " "),
                    "loosen the limit, start from another shape, or give it a soft price",
                ),
            };
            return Err(source.error_at(&key, message, Some(help.into())));
        }
        Ok(())
    }

    /// Whether hard goals leave room for each other, for the obstacles, and for what holds the base.
    fn check_goals(
        &self,
        source: &SceneSource,
        problem: &OptimalControlProblem,
    ) -> Result<(), SceneError> {
        let rod = &problem.rod;
        let rounding = START_TOLERANCE * rod.scales.length;
        let hard: Vec<(&Goal, [f64; 2])> = (problem.goals.iter())
            .filter_map(|goal| match goal.enforcement {
                Enforcement::Hard => Some((goal, [rounding, START_TOLERANCE])),
                Enforcement::Within {
                    distance, angle, ..
                } => Some((goal, [distance, angle])),
                Enforcement::Soft { .. } => None,
            })
            .collect();
        for (at, &(goal, [distance, angle])) in hard.iter().enumerate() {
            let t = problem.grid.time(goal.time_node);
            let refuse = |part: GoalPart, off: f64, what: String, help: &str| {
                let message = format!("{off:.3e} {} {what} (t = {t:.4e} s)", part.unit());
                let key = format!("{}.{}", goal.name, part.name());
                Err(source.error_at(&key, message, Some(help.into())))
            };
            const APART: &str =
                "move one of them, give it another time, a larger tolerance, or hard = false";
            for &(other, [other_distance, other_angle]) in &hard[..at] {
                if (goal.node, goal.time_node) != (other.node, other.time_node) {
                    continue;
                }
                let what = format!(
                    "away from where {} has node {} at the same step",
                    other.name, goal.node
                );
                let off = separation(&goal.position, &other.position);
                if off > distance + other_distance {
                    return refuse(GoalPart::Position, off, what, APART);
                }
                let off = turn(&goal.rotation, &other.rotation);
                if off > angle + other_angle {
                    return refuse(GoalPart::Orientation, off, what, APART);
                }
            }
            if goal.node < rod.first_free_node() {
                const HELD: &str = "choose another node, or base.kind = \"free\"";
                let (position, rotation) = match rod.driven_base(t) {
                    Some(base) => (base.position, base.rotation),
                    None => {
                        let start = &problem.initial.configuration;
                        (start.positions[goal.node], start.rotations[goal.node])
                    }
                };
                let what = format!("away from where node {} is held", goal.node);
                let off = separation(&goal.position, &Some(position));
                if off > distance {
                    return refuse(GoalPart::Position, off, what, HELD);
                }
                let off = turn(&goal.rotation, &Some(rotation));
                if off > angle {
                    return refuse(GoalPart::Orientation, off, what, HELD);
                }
            }
            let Some(position) = &goal.position else {
                continue;
            };
            let radius = problem.radii.get(goal.node).copied().unwrap_or(0.0);
            for constraint in &problem.path {
                if let PathLimit::Clearance { shape, margin, .. } = &constraint.limit
                    && constraint.enforcement == PathEnforcement::Hard
                {
                    let depth = radius + margin - shape.distance(position).value;
                    if depth > distance {
                        let what = format!(
                            "too near to \"{}\" for node {}, whose radius is {radius:.3e} m",
                            constraint.name, goal.node
                        );
                        return refuse(
                            GoalPart::Position,
                            depth,
                            what,
                            "move one of them, give the obstacle a smaller margin_m, or one of them hard = false or a soft price",
                        );
                    }
                }
            }
        }
        Ok(())
    }

    /// Radius of every node for pictures, m; empty when the scene does not say.
    #[must_use]
    pub fn display_radii(&self) -> Vec<f64> {
        let n = self.rod.elements;
        if let Some([base, tip]) = self.rod.section.as_ref().and_then(model::Section::radii) {
            return (0..=n)
                .map(|q| base + (tip - base) * q as f64 / n as f64)
                .collect();
        }
        self.rod
            .display_radius_m
            .map_or_else(Vec::new, |radius| vec![radius; n + 1])
    }

    /// This scene with the figures of its material in place of the name.
    fn with_material_resolved(&self) -> Scene {
        let mut resolved = self.clone();
        resolved.rod.material = self.rod.material.as_ref().map(model::Material::resolved);
        resolved
    }

    /// The rod, with the integrator that the scene names, or that suits `work` over `duration`.
    fn rod_of(
        &self,
        source: &SceneSource,
        duration: f64,
        work: Work,
    ) -> Result<(RodParameters, Rod), SceneError> {
        let mut parameters = self.rod_parameters(source)?;
        let mut rod = Rod::new(&parameters).map_err(|error| self.rod_error(source, &error))?;
        let sparse = matches!(work, Work::Solve { .. })
            && (self.solver.as_ref()).is_some_and(|solver| solver.qp == model::Qp::Sparse);
        let given = match self.time.step_s {
            TimeStep::Auto => None,
            TimeStep::Seconds(step) => Some(step),
        };
        let scheme = |rod: &Rod| match self.time.integrator {
            model::TimeScheme::Auto if !sparse => automatic_scheme(rod, given, duration, work),
            _ => rod.scheme,
        };
        rod.scheme = scheme(&rod);
        let may_choose = self.rod.rotary_inertia == model::RotaryInertia::Auto
            && self.rod.material.is_some()
            && parameters.model == RodModel::Standard
            && given.is_none();
        if may_choose {
            let other = RodParameters {
                rotary_inertia: RotaryInertia::Segment,
                ..parameters.clone()
            };
            let mut segments = Rod::new(&other).map_err(|error| self.rod_error(source, &error))?;
            segments.scheme = scheme(&segments);
            if prefers_segments(&rod, &segments, duration, work) {
                (parameters, rod) = (other, segments);
            }
        }
        parameters.scheme = rod.scheme;
        Ok((parameters, rod))
    }

    /// What [`Rod::new`] refuses, by the key of the scene that says it.
    fn rod_error(&self, source: &SceneSource, error: &RodError) -> SceneError {
        let RodError::OutOfRange {
            parameter, value, ..
        } = *error
        else {
            let (key, remedy) = match error.parameter() {
                "scheme" => ("time.integrator", "set it to \"explicit\""),
                "rotary_inertia" => ("rod.rotary_inertia", "set it to \"section\""),
                _ => ("damping.internal_s", "leave it out"),
            };
            let help = format!("{remedy}, or set rod.model = \"standard\"");
            let name = match self.rod.model {
                model::RodModel::Standard => "standard",
                model::RodModel::Dilatation => "dilatation",
                model::RodModel::Consistent => "consistent",
            };
            let message = format!("the {name} model does not have it, only the standard one");
            return source.error_at(key, message, Some(help));
        };
        const APART: &str = "the numbers are too far apart to be computed with: look for a unit that was mistaken, and give lengths in m, \
                             moduli in Pa and densities in kg/m³";
        let given = |material: &'static str, directly: &'static str| match &self.rod.material {
            Some(_) => material,
            None => directly,
        };
        let (key, message, help) = match parameter {
            "rest_curvature" => {
                let curvature: Vector3<f64> = (self.rod.reference.as_ref())
                    .map_or_else(Vector3::zeros, |reference| reference.curvature_1_m.into());
                let least = curvature.norm() * self.rod.length_m / std::f64::consts::PI;
                let help = if least < MOST_ELEMENTS as f64 {
                    format!(
                        "make it smaller, or rod.elements {} or more",
                        least as usize + 1
                    )
                } else {
                    "make it smaller: it is in 1/m, one over the radius of the bend".into()
                };
                let message = format!("turns each element by {value:.4} rad, half a turn or more");
                ("rod.reference.curvature_1_m", message, help)
            }
            "section mass" | "mass of a node" => (
                given("rod.material.density_kg_m3", "rod.inertia.mass_kg_m"),
                format!(
                    "makes the {parameter} {value} kg/m or kg, which is not positive and finite"
                ),
                APART.into(),
            ),
            "section rotary inertia" | "inertia of a node" => (
                given("rod.section", "rod.inertia.rotary_kg_m"),
                format!("makes the {parameter} {value}, which is not positive and finite"),
                APART.into(),
            ),
            "section linear stiffness"
            | "section angular stiffness"
            | "stiffness of an element" => (
                given("rod.section", "rod.stiffness"),
                format!("makes the {parameter} {value}, which is not positive and finite"),
                APART.into(),
            ),
            "length of an element" => (
                "rod.length_m",
                format!("makes the {parameter} {value} m, which is not positive and finite"),
                APART.into(),
            ),
            _ => (
                "rod.length_m",
                format!("makes the {parameter} {value}"),
                APART.into(),
            ),
        };
        source.error_at(key, message, Some(help))
    }

    fn rod_parameters(&self, source: &SceneSource) -> Result<RodParameters, SceneError> {
        let reference = self.rod.reference.as_ref();
        Ok(RodParameters {
            length: self.rod.length_m,
            n_elements: self.rod.elements,
            strain_rule: match self.rod.strain {
                model::StrainRule::Helical => StrainRule::Helical,
                model::StrainRule::Trapezoidal => StrainRule::Trapezoidal,
            },
            model: match self.rod.model {
                model::RodModel::Standard => RodModel::Standard,
                model::RodModel::Dilatation => RodModel::Dilatation,
                model::RodModel::Consistent => RodModel::Consistent,
            },
            section: self.section_profile(source)?,
            rotary_inertia: match self.rod.rotary_inertia {
                model::RotaryInertia::Auto | model::RotaryInertia::Section => {
                    RotaryInertia::Section
                }
                model::RotaryInertia::Segment => RotaryInertia::Segment,
            },
            rest_curvature: reference.map_or_else(Vector3::zeros, |r| r.curvature_1_m.into()),
            rest_stretch: reference.map_or(1.0, |r| r.stretch),
            base: match self.base.kind {
                model::BaseKind::Clamped => BaseCondition::Clamped,
                model::BaseKind::Driven => {
                    let motion = self.base.motion.clone().unwrap_or_default();
                    BaseCondition::driven(
                        base_motion(&motion).map_err(|error| {
                            source.error_at("base.motion", error.to_string(), None)
                        })?,
                    )
                }
                model::BaseKind::Free => BaseCondition::Free,
            },
            base_position: self.base.position_m.into(),
            base_rotation: from_quaternion(self.base.unit_quaternion()),
            gravity: self
                .gravity
                .as_ref()
                .map_or_else(Vector3::zeros, |g| g.acceleration_m_s2.into()),
            viscous_damping: self.damping.as_ref().map_or(0.0, |d| d.viscous_1_s),
            internal_damping: self.damping.as_ref().map_or(0.0, |d| d.internal_s),
            scheme: match self.time.integrator {
                model::TimeScheme::Auto | model::TimeScheme::Explicit => TimeScheme::Explicit,
                model::TimeScheme::Implicit => TimeScheme::Implicit,
            },
            loads: self.load.iter().map(|load| self.load_of(load)).collect(),
            distributed_loads: self.distributed_load.iter().map(distributed_load).collect(),
            payload: self.payload.as_ref().map(|payload| NodeInertia {
                mass: payload.mass_kg,
                rotary: payload.inertia_kg_m2.into(),
            }),
        })
    }

    fn section_profile(&self, source: &SceneSource) -> Result<SectionProfile, SceneError> {
        let incomplete = || {
            source.error_at(
                "rod",
                "material and section, or stiffness and inertia, are incomplete",
                None,
            )
        };
        if let (Some(stiffness), Some(inertia)) = (&self.rod.stiffness, &self.rod.inertia) {
            return Ok(SectionProfile::Uniform(Section {
                linear_stiffness: Vector3::new(stiffness.ga_n, stiffness.ga_n, stiffness.ea_n),
                angular_stiffness: Vector3::new(
                    stiffness.ei_n_m2,
                    stiffness.ei_n_m2,
                    stiffness.gj_n_m2,
                ),
                mass: inertia.mass_kg_m,
                rotary: inertia.rotary_kg_m.into(),
            }));
        }
        let material = self.rod.material.as_ref().ok_or_else(incomplete)?;
        let [base_radius, tip_radius] = self
            .rod
            .section
            .as_ref()
            .and_then(model::Section::radii)
            .ok_or_else(incomplete)?;
        let material = Material {
            youngs_modulus: material.youngs_modulus().ok_or_else(incomplete)?,
            shear_modulus: material.shear_modulus().ok_or_else(incomplete)?,
            density: material.density().ok_or_else(incomplete)?,
            shear_factor: material.shear_factor,
        };
        Ok(if base_radius == tip_radius {
            SectionProfile::Uniform(Section::circle(&material, base_radius))
        } else {
            SectionProfile::TaperedCircle {
                material,
                base_radius,
                tip_radius,
            }
        })
    }

    fn load_of(&self, load: &model::Load) -> Load {
        Load {
            node: load.node.index(self.rod.elements),
            force: load.force_n.into(),
            moment: load.moment_n_m.into(),
            frame: load_frame(load.frame),
            profile: load_profile(&load.profile),
        }
    }

    /// A grid that can be stretched to the longest duration with steps that can be taken.
    fn stretching_grid(
        &self,
        source: &SceneSource,
        rod: &Rod,
        start: f64,
        free: &model::FreeDuration,
        multiple: usize,
    ) -> Result<TimeGrid, SceneError> {
        let TimeStep::Seconds(step) = self.time.step_s else {
            let longest = self.grid(source, rod, free.longest_s, multiple)?;
            return Ok(TimeGrid {
                step: start / longest.n_steps as f64,
                ..longest
            });
        };
        let grid = self.grid(source, rod, start, multiple)?;
        let longest = free.longest_s / grid.n_steps as f64;
        let limit = stable_step(rod);
        if longest > limit && rod.scheme == TimeScheme::Explicit {
            return Err(source.error_at(
                "task.free_duration.longest_s",
                format!(
                    "{} steps of this duration, {longest:.4e} s each, are above the stable step of this rod, {limit:.4e} s",
                    grid.n_steps
                ),
                Some(format!(
                    "time.step_s counts at task.at_s; make it {:.4e} s or less, or \"auto\"",
                    automatic_step(rod) * step / longest
                )),
            ));
        }
        Ok(grid)
    }

    /// A grid of equal steps, no longer than asked for, whose number is a multiple of `multiple`.
    fn grid(
        &self,
        source: &SceneSource,
        rod: &Rod,
        end: f64,
        multiple: usize,
    ) -> Result<TimeGrid, SceneError> {
        let limit = stable_step(rod);
        if !(limit > 0.0 && limit.is_finite()) {
            let key = match &self.rod.material {
                Some(_) => "rod.section",
                None => "rod.stiffness",
            };
            return Err(source.error_at(
                key,
                format!("the stable time step of this rod is {limit}"),
                Some("its stiffness and inertia are too far apart to be computed with".into()),
            ));
        }
        let step = match self.time.step_s {
            TimeStep::Auto => automatic_step(rod),
            TimeStep::Seconds(step) if step <= limit || rod.scheme == TimeScheme::Implicit => step,
            TimeStep::Seconds(step) => {
                return Err(source.error_at(
                    "time.step_s",
                    format!("{step} s is above the stable step of this rod, {limit:.4e} s"),
                    Some(format!(
                        "use \"auto\" ({:.4e} s), fewer elements, or time.integrator = \"implicit\"; with this step the motion \
                         would grow without bound",
                        automatic_step(rod)
                    )),
                ));
            }
        };
        if !(end / step <= MOST_STEPS) {
            return Err(source.error_at(
                "time.end_s",
                format!(
                    "{:.3e} steps of {step:.3e} s are more than {MOST_STEPS:e}",
                    end / step
                ),
                Some("use a shorter time, fewer elements, or a softer or heavier arm".into()),
            ));
        }
        Ok(TimeGrid::covering(end, step, multiple))
    }

    fn initial_state(
        &self,
        source: &SceneSource,
        rod: &Rod,
        stop: &StopSignal,
    ) -> Result<State, SceneError> {
        self.starting_state_until(rod, stop).map_err(|error| {
            let help = match error {
                EquilibriumError::FreeBase => {
                    "set base.kind = \"clamped\", or initial.shape = \"rest\""
                }
                EquilibriumError::NotConverged { .. } => {
                    "set initial.shape = \"rest\" and let it settle (damping.viscous_1_s, or a profile that raises a [[load]] from 0), or \
                     make gravity and loads smaller or the rod stiffer"
                }
                EquilibriumError::Overstretched { .. } => {
                    "make the loads smaller or the rod stiffer; rod.model = \"standard\" bears any pull"
                }
                EquilibriumError::Stopped(_) => {
                    "set initial.shape = \"rest\", which needs no search, or a longer solver.deadline_s"
                }
            };
            source.error_at("initial.shape", error.to_string(), Some(help.into()))
        })
    }

    /// State at t = 0 of a rod of this scene: in the shape of `[initial]`, moving as a rigid body with the velocities
    /// given there (free base) or with its base (driven).
    ///
    /// # Errors
    /// [`EquilibriumError`] when there is no equilibrium to start from.
    pub fn starting_state(&self, rod: &Rod) -> Result<State, EquilibriumError> {
        self.starting_state_until(rod, &StopSignal::default())
    }

    fn starting_state_until(
        &self,
        rod: &Rod,
        stop: &StopSignal,
    ) -> Result<State, EquilibriumError> {
        let initial = self.initial.clone().unwrap_or_default();
        let shape = match initial.shape {
            InitialShape::Rest => rod.rest.clone(),
            InitialShape::Equilibrium => {
                static_equilibrium_until(rod, &rod.rest, 0.0, &TipSpring::default(), stop)?
            }
        };
        Ok(match rod.base {
            BaseCondition::Clamped | BaseCondition::Driven(_) => rod.at_rest_on_base(shape),
            BaseCondition::Free => {
                let center = rod.center_of_mass(&shape.positions);
                let (velocity, spin) = (initial.velocity_m_s, initial.angular_velocity_rad_s);
                rod.rigid_motion(shape, &center, &velocity.into(), &spin.into())
            }
        })
    }
}

/// Distance between two places, m; 0 where one is not given.
fn separation(a: &Option<Vector3<f64>>, b: &Option<Vector3<f64>>) -> f64 {
    a.zip(*b).map_or(0.0, |(a, b)| (a - b).norm())
}

/// Angle between two orientations, rad; 0 where one is not given.
fn turn(a: &Option<Matrix3<f64>>, b: &Option<Matrix3<f64>>) -> f64 {
    a.zip(*b)
        .map_or(0.0, |(a, b)| log(&(a.transpose() * b)).norm())
}

fn enforcement(hard: bool, weight: Option<f64>) -> Enforcement {
    if hard {
        Enforcement::Hard
    } else {
        Enforcement::Soft {
            weight: weight.unwrap_or(1.0),
        }
    }
}

/// How near to a goal is near enough; `None` where it must be met exactly.
#[derive(Clone, Copy, Default)]
struct Tolerances {
    /// m
    distance: Option<f64>,
    /// rad
    angle: Option<f64>,
    /// m/s and rad/s; zero for exactly.
    rest: [f64; 2],
}

/// A goal whose parts may be met within tolerances: those that may become a goal of their own.
fn with_tolerances(goal: Goal, tolerances: Tolerances) -> Vec<Goal> {
    let Tolerances {
        distance,
        angle,
        rest: [speed, spin],
    } = tolerances;
    let mut exact = goal.clone();
    let mut near = Goal {
        position: None,
        rotation: None,
        at_rest: false,
        enforcement: Enforcement::Within {
            distance: distance.unwrap_or(0.0),
            angle: angle.unwrap_or(0.0),
            speed,
            spin,
        },
        ..goal
    };
    if distance.is_some() {
        near.position = exact.position.take();
    }
    if angle.is_some() {
        near.rotation = exact.rotation.take();
    }
    if speed > 0.0 || spin > 0.0 {
        near.at_rest = std::mem::take(&mut exact.at_rest);
    }
    [near, exact]
        .into_iter()
        .filter(|goal| goal.position.is_some() || goal.rotation.is_some() || goal.at_rest)
        .collect()
}

fn shape(obstacle: &model::Obstacle) -> Option<Shape> {
    if let Some(sphere) = &obstacle.sphere {
        return Some(Shape::Sphere {
            center: sphere.center_m.into(),
            radius: sphere.radius_m,
        });
    }
    if let Some(capsule) = &obstacle.capsule {
        return Some(Shape::Capsule {
            from: capsule.from_m.into(),
            to: capsule.to_m.into(),
            radius: capsule.radius_m,
        });
    }
    if let Some(half_space) = &obstacle.half_space {
        return Some(Shape::HalfSpace {
            point: half_space.point_m.into(),
            normal: Vector3::from(unit(half_space.normal)),
        });
    }
    obstacle.cuboid.as_ref().map(|cuboid| Shape::Cuboid {
        center: cuboid.center_m.into(),
        rotation: cuboid
            .orientation_wxyz
            .map_or_else(Matrix3::identity, from_quaternion),
        half_size: Vector3::from(cuboid.size_m) * 0.5,
    })
}

fn load_frame(frame: model::LoadFrame) -> LoadFrame {
    match frame {
        model::LoadFrame::Spatial => LoadFrame::Spatial,
        model::LoadFrame::Body => LoadFrame::Body,
    }
}

fn load_profile(profile: &Option<Vec<[f64; 2]>>) -> Vec<(f64, f64)> {
    let points = profile.iter().flatten();
    points.map(|&[t, factor]| (t, factor)).collect()
}

fn distributed_load(load: &model::DistributedLoad) -> DistributedLoad {
    DistributedLoad {
        from: load.from,
        to: load.to,
        force: load.force_n_per_m.into(),
        moment: load.moment_n_m_per_m.into(),
        frame: load_frame(load.frame),
        profile: load_profile(&load.profile),
    }
}

fn base_motion(motion: &model::BaseMotion) -> Result<BaseMotion, RodError> {
    let curve = |rate: [f64; 3],
                 table: &Option<Vec<[f64; 4]>>,
                 amplitude: fn(&model::Oscillation) -> [f64; 3]|
     -> Result<MotionCurve, RodError> {
        let point = |&[t, x, y, z]: &[f64; 4]| (t, Vector3::new(x, y, z));
        let table = table
            .as_ref()
            .map(|rows| CubicSpline::through(&rows.iter().map(point).collect::<Vec<_>>()));
        let oscillations = motion.oscillation.iter().map(|o| Oscillation {
            amplitude: amplitude(o).into(),
            frequency: o.frequency_hz,
            phase: o.phase_rad,
        });
        Ok(MotionCurve {
            rate: rate.into(),
            table: table.transpose()?,
            oscillations: oscillations.collect(),
        })
    };
    Ok(BaseMotion {
        translation: curve(motion.velocity_m_s, &motion.translation_m, |o| {
            o.translation_m
        })?,
        rotation: curve(motion.angular_velocity_rad_s, &motion.rotation_rad, |o| {
            o.rotation_rad
        })?,
    })
}

/// Relative difference below which two intervals are one: roundings of a quotient.
const SAME_INTERVAL: f64 = 1e-9;
/// Numbers of steps per row that are tried beyond the least: with ends that are no multiple of the interval, one of them may still divide
/// both.
const MORE_STEPS_PER_ROW: usize = 100;

/// A grid with steps no longer than those of `grid` that divide the interval between rows, where there is one that ends at the same time:
/// rows then fall where they were asked for.
fn row_grid(source: &SceneSource, grid: TimeGrid, rate: f64) -> Result<TimeGrid, SceneError> {
    let intervals = grid.end() * rate;
    let least = (1.0 / (rate * grid.step) * (1.0 - SAME_INTERVAL))
        .ceil()
        .max(1.0);
    if !(intervals >= 1.0) {
        return Ok(grid);
    }
    if !(intervals * least <= MOST_STEPS) {
        let message = format!(
            "a row every {:.3e} s up to time.end_s, {} s, takes {:.3e} steps, more than {MOST_STEPS:e}",
            1.0 / rate,
            grid.end(),
            intervals * least
        );
        let help = "give a lower rate".to_string();
        return Err(source.error_at("output.rate_hz", message, Some(help)));
    }
    let whole = (0..=MORE_STEPS_PER_ROW)
        .map(|more| intervals * (least + more as f64))
        .find(|steps| (steps - steps.round()).abs() <= SAME_INTERVAL * steps);
    Ok(whole.map_or(grid, |steps| TimeGrid {
        step: grid.end() / steps.round(),
        n_steps: steps.round() as usize,
    }))
}

/// The grid at the longest duration: what a rate of samples is counted on, so that it does not depend on where the search begins.
fn longest_grid(free: Option<&model::FreeDuration>, grid: TimeGrid) -> TimeGrid {
    let longest = |free: &model::FreeDuration| TimeGrid {
        step: free.longest_s / grid.n_steps as f64,
        ..grid
    };
    free.map_or(grid, longest)
}

/// The rod's integrator, by its name in scenes.
fn integrator(rod: &Rod) -> model::TimeScheme {
    match rod.scheme {
        TimeScheme::Explicit => model::TimeScheme::Explicit,
        TimeScheme::Implicit => model::TimeScheme::Implicit,
    }
}

/// The rod's rotary inertia, by its name in scenes.
fn rotary_inertia(parameters: &RodParameters) -> model::RotaryInertia {
    match parameters.rotary_inertia {
        RotaryInertia::Section => model::RotaryInertia::Section,
        RotaryInertia::Segment => model::RotaryInertia::Segment,
    }
}

fn resolve_time(scene: &mut Scene, grid: &TimeGrid) {
    scene.time.step_s = TimeStep::Seconds(grid.step);
}

/// Bending stiffness in N m² of the weakest section that a moment of the control acts on; the mean of the arm where none does.
fn weakest_bending(rod: &Rod, control: &model::Control) -> f64 {
    let acts = |moment: Option<model::Bound>| moment.is_some_and(|moment| !moment.is_zero());
    let tip = acts(control.moment_max_n_m).then(|| rod.tip());
    let others = (control.actuator.iter())
        .filter(|actuator| acts(actuator.moment_max_n_m))
        .map(|actuator| actuator.node);
    let beside = |node: usize| {
        [
            node.checked_sub(1),
            (node < rod.n_elements()).then_some(node),
        ]
    };
    (tip.into_iter().chain(others))
        .flat_map(beside)
        .flatten()
        .map(|element| {
            let stiffness = &rod.elements[element].angular_stiffness;
            stiffness.x.min(stiffness.y)
        })
        .reduce(f64::min)
        .unwrap_or(rod.scales.moment * rod.scales.length)
}

/// What a part of a wrench that the scene does not name is bounded by.
const NOT_ACTUATED: Bound = Bound::Norm(0.0);

/// A bound; `None` where all of it is infinite.
fn bound(bound: model::Bound) -> Option<Bound> {
    match bound {
        model::Bound::Norm(limit) => limit.is_finite().then_some(Bound::Norm(limit)),
        model::Bound::PerAxis(limits) => (limits.iter())
            .any(|limit| limit.is_finite())
            .then(|| Bound::PerAxis(limits.into())),
    }
}

/// Columns of a rotation: the directors `d1`, `d2`, `d3`.
#[must_use]
pub fn directors(rotation: &Matrix3<f64>) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|i| rotation.column(i).into_owned().into())
}
