//! The model over one horizon: roll-out, rows, sensitivities, and the condensed Gauss-Newton Hessian, all in memory that is reused.
//!
//! With `v` the scaled coefficients of the plan, `δs` the deviation of the state at the start from the predicted one and `r` the residuals
//! of tracks, targets and terms, the model of a sample is
//!
//! ```text
//! r(v + x, s + δs) = r + J x + G δs,     ½ |r|² + ½ (v + x)ᵀ C (v + x) + ½ w |v₀ + x₀ - a|²
//! ```
//!
//! `J` and `G` come from one reverse sweep: the covectors of the rows, read where the controls act and where the sweep ends. An effort of an
//! actuator of the arm, on its strains or on poses of its nodes, acts by wrenches that follow from the configuration, so that its columns are
//! evaluated along every roll-out. `C` is effort and rate, `a` the control that acts when the horizon begins.

mod columns;
mod terminal;

use std::sync::Arc;

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};
use nalgebra::{Matrix3, Vector3};

use self::columns::{Columns, WinchSlopes};
pub use self::terminal::TerminalCost;
use super::command::{
    CommandedControl, ControlList, ControlOrder, ControlledPart, Controls, Effect,
};
use super::controller::MpcSettings;
use super::error::MpcError;
use super::estimator::{Disturbance, ModelParameters, Motions};
use super::knots::Knots;
use super::rows::{Evaluated, Rows};
use super::soft_rows::SoftRows;
use control::path::{PathLimit, RodView};
use control::{Component, Enforcement, Goal, OptimalControlProblem, Shape, residual};
use mechanics::forms::NODE_COMPONENTS;
use mechanics::linearization::{Motion, StateTangent};
use mechanics::sensitivity::{EffortPulls, RepeatedReverse};
use mechanics::{ControlSignal, Rod, State, StepError, TimeGrid, Trajectory, Wrench};
use stop::StopSignal;

/// Negligible error of a tracked quantity, divided by the length, or in rad: a tenth of the default accuracy of a scene, 1e-3. Plans that
/// cost less than this error does all the time are not rejected. With half of it, the first 0.6 s of `mpc-reach` and `mpc-push` are the
/// same, with twice the value to three digits.
const NEGLIGIBLE: f64 = 1e-4;

/// Adds the wrenches and efforts of `amount` units of a component.
fn add_effects(effects: &[Effect], amount: f64, controls: &mut Controls) {
    for effect in effects {
        controls.add(effect.on, amount * effect.size);
    }
}

/// Returns the effects of every component; `None` if an actuator of one's own is not linear.
fn effects(problem: &OptimalControlProblem, components: &[Component]) -> Option<Vec<Vec<Effect>>> {
    let driven = driven(problem);
    let maps = (problem.acting.iter())
        .map(|acting| {
            Some((
                acting.actuator.nodes(&problem.rod),
                acting.actuator.linear_map(&problem.rod)?,
            ))
        })
        .collect::<Option<Vec<_>>>()?;
    let effect = |on, size| Effect { on, size };
    let of = |component: &Component| match (
        problem.of_wrench(component),
        problem.own_control(component),
    ) {
        (Some((node, component)), _) => vec![effect(ControlledPart::Node(node, component), 1.0)],
        (None, None) => (problem.driven_by(component))
            .map(|(index, gain)| effect(ControlledPart::Effort(driven[index]), gain))
            .collect(),
        (None, Some((index, control))) => {
            let (nodes, map) = &maps[index];
            let rows = (0..map.nrows()).filter(|row| map[(*row, control)] != 0.0);
            rows.map(|row| {
                effect(
                    ControlledPart::Node(nodes[row / 6], row % 6),
                    map[(row, control)],
                )
            })
            .collect()
        }
    };
    Some(components.iter().map(of).collect())
}

/// Returns the actuators in the arm whose efforts are controls.
pub(super) fn driven(problem: &OptimalControlProblem) -> &[usize] {
    (problem.efforts.as_ref()).map_or(&[], |efforts| &efforts.actuators)
}

/// Refuses goals and durations that the controller does not know.
fn refuse_unsupported(problem: &OptimalControlProblem) -> Result<(), MpcError> {
    let has_tolerance = |goal: &Goal| matches!(goal.enforcement, Enforcement::Within { .. });
    if problem.goals.iter().any(has_tolerance) {
        return Err(MpcError::Unsupported(
            "the controller's targets are soft; leave out tolerances of targets",
        ));
    }
    if problem.duration.is_some() {
        return Err(MpcError::Unsupported(
            "the controller knows a fixed duration; leave out free_duration",
        ));
    }
    Ok(())
}

/// Returns the motion that stays in its first configuration.
fn resting(start: &State, grid: TimeGrid) -> Trajectory {
    let n_nodes = start.configuration.positions.len();
    let mut trajectory = Trajectory::with_capacity(n_nodes, grid.n_steps + 1);
    for _ in 0..=grid.n_steps {
        trajectory.push(&start.configuration);
    }
    trajectory
}

/// Returns the indices and shapes of the obstacles among the limits of a problem.
fn obstacles(problem: &OptimalControlProblem) -> Vec<(usize, Shape)> {
    (problem.path.iter().enumerate())
        .filter_map(|(index, path)| match &path.limit {
            PathLimit::Clearance { shape, .. } => Some((index, *shape)),
            _ => None,
        })
        .collect()
}

/// The components of a plan that drive actuators in the arm.
#[derive(Default)]
struct Drivers {
    /// Components that drive actuators on strains, with the effort for one unit; below it, these actuators.
    of_efforts: Vec<(usize, f64)>,
    on_strains: Vec<usize>,
    /// Components that drive actuators on poses, likewise, each with the index of a function of its actuator.
    of_poses: Vec<((usize, f64), usize)>,
}

impl Drivers {
    fn of(problem: &OptimalControlProblem, components: &[Component]) -> Self {
        let mut out = Self::default();
        for (index, &actuator) in driven(problem).iter().enumerate() {
            let driver = components.iter().enumerate().find_map(|(at, component)| {
                let (_, gain) = problem.driven_by(component).find(|own| own.0 == index)?;
                Some((at, gain))
            });
            let Some(driver) = driver else {
                continue;
            };
            if actuator < problem.rod.actuators.strains().len() {
                out.of_efforts.push(driver);
                out.on_strains.push(actuator);
            }
            let functions = problem.rod.actuators.functions().iter().enumerate();
            let own = functions.filter(|(_, own)| own.actuator == Some(actuator));
            (out.of_poses).extend(own.map(|(function, _)| (driver, function)));
        }
        out
    }
}

/// The model, at the plan and the start for which it was last prepared.
#[derive(Debug)]
pub(super) struct Horizon {
    pub problem: OptimalControlProblem,
    pub components: Vec<Component>,
    /// Scale of every component, N or N m, or the unit of a control of an actuator of one's own.
    pub scales: Vec<f64>,
    /// Wrenches of one unit of every component.
    pub effects: Vec<Vec<Effect>>,
    pub knots: Knots,
    /// Components that drive actuators on strains, with the effort for one unit, in the order in which these are driven.
    of_efforts: Vec<(usize, f64)>,
    /// Components that drive actuators on poses, likewise, each with the index of a function of its actuator.
    of_poses: Vec<((usize, f64), usize)>,
    /// The grid of the present horizon; below it, that of the longest horizon, from the first start.
    pub grid: TimeGrid,
    longest: TimeGrid,
    rows: Rows,
    /// Order of the controls of a motion.
    pub order: ControlOrder,
    /// Controls at the two ends of a step.
    controls: [Controls; 2],
    /// Efforts of the plan along the last roll-out; `None` without actuators of the arm. Below it, the wrenches of unit efforts there of
    /// those that are driven on strains; `None` if none is.
    efforts: Option<ControlSignal>,
    pulls: Option<EffortPulls>,
    /// Slopes of the tensions of winches along the last roll-out; `None` without winches.
    winches: Option<WinchSlopes>,
    /// Indices and shapes of the obstacles among the limits of the problem, at t = 0 by the task.
    obstacles: Vec<(usize, Shape)>,
    /// The model without estimated errors.
    model: Arc<Rod>,
    /// Signal that ends simulations and sweeps early.
    pub stop: StopSignal,
    /// Parameters by which the model of the present horizon differs from the one without a disturbance.
    parameters: ModelParameters,
    /// Disturbing wrench of every node, constant in time.
    pub disturbing: Vec<Wrench>,
    /// By how much later commands act than they say, s.
    delay: f64,
    trajectory: Trajectory,
    /// State from which the roll-out starts; below it, the state in which it ends.
    pub start: State,
    end: State,
    motions: Motions,
    sweep: RepeatedReverse,
    /// Residuals of the present horizon after the deviation of the start.
    moved: Vec<f64>,
    /// The derivative `J`; below it, `G`.
    jacobian: Mat<f64>,
    along_start: Mat<f64>,
    /// `JᵀJ`.
    pub square: Mat<f64>,
}

impl Horizon {
    /// Creates the horizon of a controller with these settings, with the cost of what comes after it or without.
    pub fn new(
        mut problem: OptimalControlProblem,
        mut knots: Knots,
        settings: &MpcSettings,
        terminal: Option<TerminalCost>,
    ) -> Result<Self, MpcError> {
        refuse_unsupported(&problem)?;
        let model = Arc::clone(&problem.rod);
        // The rod that disturbances change is the horizon's own from the beginning: a sample allocates nothing.
        Arc::make_mut(&mut problem.rod);
        let grid = problem.grid;
        let components = problem.actuated_components();
        let Some(effects) = effects(&problem, &components) else {
            return Err(MpcError::Unsupported(
                "the controller knows wrenches on nodes, efforts of actuators in the arm, and actuators of one's own that are linear; leave out others",
            ));
        };
        let scales: Vec<f64> = (components.iter())
            .map(|component| problem.channel(component).scale)
            .collect();
        let n_states = NODE_COMPONENTS * (problem.rod.n_nodes() - problem.rod.first_free_node());
        let n = knots.most(grid.duration()) * components.len();
        knots.place(grid.start, grid.time(grid.n_steps));
        let start = problem.initial.clone();
        let order = ControlOrder::on_all(&problem.rod);
        let efforts = order.signal_of_efforts(grid.n_steps + 1);
        let Drivers {
            of_efforts,
            on_strains,
            of_poses,
        } = Drivers::of(&problem, &components);
        let trajectory = resting(&start, grid);
        let rows = {
            let whole = evaluated(&problem, (&trajectory, None), grid, &start);
            Rows::new(&problem, &whole.states, settings, n_states, terminal)
        };
        let winches = WinchSlopes::of(&problem.rod, &on_strains, grid);
        let (sweep, pulls) = {
            let motion = Motion {
                rod: &problem.rod,
                grid,
                initial: &start,
                stop: None,
                control: efforts.as_ref(),
            };
            let pulls = (!on_strains.is_empty()).then(|| EffortPulls::along(&motion, &on_strains));
            let columns = Columns {
                knots: &knots,
                grid,
                effects: &effects,
                pulls: pulls.as_ref(),
                of_efforts: &of_efforts,
                winches: winches.as_ref(),
                of_poses: &of_poses,
                rod: &problem.rod,
                trajectory: &trajectory,
                ends: problem.rod.scheme.n_ends(),
                scales: &scales,
                n,
            };
            let sweep = RepeatedReverse::new(&motion, &trajectory, &columns, rows.forms());
            (sweep, pulls)
        };
        Ok(Self {
            motions: Motions::new(&problem.rod, grid.step, Disturbance::NONE.parameters()),
            controls: [(); 2].map(|()| order.none()),
            disturbing: order.none().wrenches,
            order,
            efforts,
            pulls,
            winches,
            of_efforts,
            of_poses,
            model,
            stop: StopSignal::default(),
            obstacles: obstacles(&problem),
            parameters: Disturbance::NONE.parameters(),
            delay: 0.0,
            trajectory,
            end: start.clone(),
            start,
            sweep,
            moved: vec![0.0; rows.len()],
            jacobian: Mat::zeros(rows.len(), n),
            along_start: Mat::zeros(rows.len(), n_states),
            square: Mat::zeros(n, n),
            rows,
            components,
            scales,
            effects,
            knots,
            longest: grid,
            grid,
            problem,
        })
    }

    /// Returns the number of variables of the longest horizon.
    pub fn n_variables(&self) -> usize {
        self.square.nrows()
    }

    /// Variables of the present horizon.
    pub fn n_present(&self) -> usize {
        self.knots.n_coefficients() * self.components.len()
    }

    /// Returns the controls of commands, in the order of the components.
    pub fn control_list(&self) -> ControlList {
        let named = self.problem.named_controls();
        let controls = (named.into_iter().zip(&self.components).zip(&self.effects)).map(
            |((named, component), effects)| CommandedControl {
                named,
                lag: self.problem.channel(component).lag,
                effects: effects.clone(),
            },
        );
        ControlList::new(controls.collect())
    }

    /// Places the horizon from `start` (s) on: as long as the longest one, or until `due`. Returns `false` if nothing is left of it.
    pub fn place(&mut self, start: f64, due: Option<f64>) -> bool {
        let whole = self.longest.n_steps;
        let left = due.map_or(whole, |due| {
            ((due - start) / self.longest.step).round().max(0.0) as usize
        });
        let n_steps = left.min(whole);
        if n_steps == 0 {
            self.grid.start = start;
            return false;
        }
        self.grid = TimeGrid {
            start,
            n_steps,
            ..self.longest
        };
        let passed = if due.is_some() { whole - n_steps } else { 0 };
        self.rows.place(passed);
        self.knots.place(start, self.grid.time(n_steps));
        true
    }

    /// Replaces the path of a track, and evaluates the residuals of the present horizon anew.
    pub fn follow(&mut self, track: usize, path: &[(f64, Vector3<f64>)]) {
        let own = &mut self.problem.objective.tracking[track].path;
        own.clear();
        own.extend_from_slice(path);
        self.evaluate_anew();
    }

    /// Replaces the rotations of a track, and evaluates the residuals of the present horizon anew.
    pub fn turn(&mut self, track: usize, rotations: &[(f64, Matrix3<f64>)]) {
        let own = &mut self.problem.objective.tracking[track].rotations;
        own.clear();
        own.extend_from_slice(rotations);
        self.evaluate_anew();
    }

    /// Looks at the limits along a plan, see [`Rows::see`].
    pub fn see_limits(&mut self, soft: &SoftRows, x: &[f64], bounded: bool) -> f64 {
        self.rows.see(soft, x, bounded)
    }

    /// Sets by how much plans should keep inside of a limit, in its unit, see [`Rows::set_margin`].
    pub fn set_margin(&mut self, limit: usize, margin: f64) {
        let scale = self.problem.path[limit].limit.scale(&self.problem.rod);
        self.rows.set_margin(limit, margin / scale);
    }

    /// Raises the prices of violated limits, see [`Rows::raise_prices`].
    pub fn raise_prices(&mut self, soft: &mut SoftRows) -> bool {
        self.rows.raise_prices(soft)
    }

    /// Lowers the prices of limits that are far above their multipliers.
    pub fn lower_prices(&mut self) {
        self.rows.prices.come_down();
    }

    /// Returns the indices of the limits that the last plan violates although a violation has the highest price, each with its largest
    /// violation in the unit of the limit.
    pub fn gave_way(&self) -> impl Iterator<Item = (usize, f64)> {
        (self.problem.path.iter().enumerate()).filter_map(|(index, path)| {
            let violation = self.rows.prices.gave_way(index)?;
            Some((index, violation * path.limit.scale(&self.problem.rod)))
        })
    }

    /// Names of the obstacles.
    pub fn obstacles(&self) -> impl Iterator<Item = &str> {
        (self.obstacles.iter()).map(|(index, _)| &self.problem.path[*index].name[..])
    }

    /// Moves an obstacle: at time `t` (s) it is displaced by `by` (m) from its place in the task at t = 0, and moves at `velocity` (m/s).
    /// The next horizon takes this into account. Returns `false` if no obstacle has this name.
    pub fn move_obstacle(
        &mut self,
        name: &str,
        t: f64,
        by: &Vector3<f64>,
        velocity: &Vector3<f64>,
    ) -> bool {
        let mut is_there = false;
        for (index, there) in &self.obstacles {
            let path = &mut self.problem.path[*index];
            if let PathLimit::Clearance {
                shape,
                velocity: own,
                ..
            } = &mut path.limit
                && path.name == name
            {
                *shape = there.moved(&(by - velocity * t));
                *own = *velocity;
                is_there = true;
            }
        }
        is_there
    }

    fn evaluate_anew(&mut self) {
        // A motion that broke down is simulated anew before anything asks for its residuals.
        let whole = (self.grid.n_steps + 1) * self.problem.rod.n_nodes();
        if self.trajectory.positions.len() == whole {
            self.evaluate_all();
        }
    }

    /// Applies an estimated disturbance to the model.
    pub fn disturb(&mut self, disturbance: &Disturbance) {
        self.disturbing.fill(Wrench::default());
        disturbance.add_to(&self.model, &mut self.disturbing);
        self.delay = disturbance.delay();
        let parameters = disturbance.parameters();
        if parameters != self.parameters {
            disturbance.change_model(&self.model, Arc::make_mut(&mut self.problem.rod));
            self.parameters = parameters;
        }
    }

    /// Returns the grid of times at which commands act: later than their own times by the estimated additional delay.
    fn acting_grid(&self) -> TimeGrid {
        TimeGrid {
            start: self.grid.start + self.delay,
            ..self.grid
        }
    }

    /// Returns the estimated additional delay of commands, s.
    pub fn delay(&self) -> f64 {
        self.delay
    }

    /// Returns the model without estimated errors.
    pub fn model(&self) -> &Arc<Rod> {
        &self.model
    }

    /// Returns the estimated errors of the model: equal parameters make equal models.
    pub fn parameters(&self) -> ModelParameters {
        self.parameters
    }

    /// Writes the scaled controls that the plan applies at time `t`, one for each component.
    pub fn control(&self, plan: &[f64], t: f64, out: &mut [f64]) {
        let n = self.components.len();
        out.fill(0.0);
        for (coefficient, weight) in self.knots.at(t) {
            for (out, v) in out.iter_mut().zip(&plan[coefficient * n..][..n]) {
                *out += weight * v;
            }
        }
    }

    /// Simulates the plan from the start, and evaluates the residuals of its motion.
    ///
    /// # Errors
    /// [`MpcError::Rollout`] where the motion breaks down.
    pub fn roll_out(&mut self, plan: &[f64]) -> Result<(), MpcError> {
        let Self {
            problem,
            knots,
            grid,
            order,
            controls: [now, next],
            efforts,
            disturbing,
            trajectory,
            motions,
            parameters,
            start,
            end,
            stop,
            components,
            effects,
            scales,
            ..
        } = self;
        let n = components.len();
        let fill = |k: usize, controls: &mut Controls| {
            controls.begin_with(disturbing);
            for (coefficient, weight) in knots.at_node(grid, k) {
                let own = &plan[coefficient * n..][..n];
                for ((effects, v), scale) in effects.iter().zip(own).zip(scales.iter()) {
                    add_effects(effects, weight * v * scale, controls);
                }
            }
        };
        let mut note = |k: usize, controls: &Controls| {
            if let Some(efforts) = efforts {
                let n = controls.efforts.len();
                efforts.inputs[k * n..][..n].copy_from_slice(&controls.efforts);
            }
        };
        trajectory.positions.clear();
        trajectory.rotations.clear();
        trajectory.push(&start.configuration);
        let steps = grid.n_steps;
        end.clone_from(start);
        let model = (&*problem.rod, *parameters);
        let outcome = motions.run(model, grid.step, (grid.start, end), |stepper| {
            fill(0, now);
            note(0, now);
            for k in 0..steps {
                fill(k + 1, next);
                note(k + 1, next);
                stop.check_at(k)?;
                stepper.advance([order.of(now), order.of(next)])?;
                stepper.record(trajectory);
                std::mem::swap(now, next);
            }
            Ok(())
        });
        outcome.map_err(|error: StepError| MpcError::from(error))?;
        self.evaluate_all();
        Ok(())
    }

    /// Derivatives of the residuals along the plan and the start, and `JᵀJ`, at the motion of the last roll-out.
    ///
    /// # Errors
    /// [`MpcError::Rollout`] where the motion cannot be linearized.
    pub fn linearize(&mut self) -> Result<(), MpcError> {
        let motion = Motion {
            rod: &self.problem.rod,
            grid: self.grid,
            initial: &self.start,
            stop: Some(&self.stop),
            control: self.efforts.as_ref(),
        };
        if let Some(pulls) = &mut self.pulls {
            pulls.evaluate_along(&motion, &self.trajectory);
        }
        if let Some(winches) = &mut self.winches {
            winches.evaluate(&motion, &self.trajectory);
        }
        let columns = Columns {
            knots: &self.knots,
            grid: self.grid,
            effects: &self.effects,
            pulls: self.pulls.as_ref(),
            of_efforts: &self.of_efforts,
            winches: self.winches.as_ref(),
            of_poses: &self.of_poses,
            rod: &self.problem.rod,
            trajectory: &self.trajectory,
            ends: self.problem.rod.scheme.n_ends(),
            scales: &self.scales,
            n: self.square.nrows(),
        };
        let forms = self.rows.present_forms();
        (self.sweep).sweep(&motion, &self.trajectory, &columns, forms)?;
        let n = self.knots.n_coefficients() * self.components.len();
        let n_rows = self.rows.present().len();
        let last = n - self.components.len();
        for j in 0..n {
            let column = &mut self.jacobian.col_as_slice_mut(j)[..n_rows];
            self.rows.write_along_column(&self.sweep, j, column);
            if let Some(component) = j.checked_sub(last) {
                self.rows.add_along_last_control(component, column);
            }
        }
        for i in 0..self.along_start.ncols() {
            let column = &mut self.along_start.col_as_slice_mut(i)[..n_rows];
            self.rows.write_along_start(&self.sweep, i, column);
        }
        let jacobian = self.jacobian.get(..n_rows, ..n);
        let square = self.square.as_mut().get_mut(..n, ..n);
        let transposed = jacobian.transpose();
        matmul(square, Accum::Replace, transposed, jacobian, 1.0, Par::Seq);
        Ok(())
    }

    /// Writes the limits of the present horizon as rows of a subproblem, except for their values.
    pub fn write_limits(&self, soft: &mut SoftRows) {
        self.rows.write_limits(&self.sweep, self.n_present(), soft);
        let n = self.components.len();
        (self.rows).write_along_inputs(&self.problem, &mut |row, k, actuator, slope| {
            let slopes = soft.slopes.col_as_slice_mut(row);
            for (coefficient, weight) in self.knots.at_node(&self.grid, k) {
                let own = &mut slopes[coefficient * n..][..n];
                for ((effects, scale), out) in self.effects.iter().zip(&self.scales).zip(own) {
                    let driven = effects
                        .iter()
                        .filter(|own| own.on == ControlledPart::Effort(actuator));
                    let size: f64 = driven.map(|own| own.size).sum();
                    *out += slope * weight * scale * size;
                }
            }
        });
    }

    /// Writes the values of the limit rows for a start that deviates.
    pub fn write_limit_values(&self, deviation: &StateTangent, out: &mut [f64]) {
        let free = self.problem.rod.first_free_node();
        self.rows.write_limit_values(free, deviation, out);
    }

    /// Returns the number of rows of limits in the longest horizon.
    pub fn n_limit_rows(&self) -> usize {
        self.rows.n_limits()
    }

    /// `Jᵀ (r + G δs)` over the present variables, and `½ |r + G δs|²`.
    pub fn gradient(&mut self, deviation: &StateTangent, gradient: &mut [f64]) -> f64 {
        let first = self.problem.rod.first_free_node();
        let present = self.rows.present();
        let moved = &mut self.moved[..present.len()];
        moved.copy_from_slice(present);
        for (i, d) in deviation.components_from(first).enumerate() {
            for (r, slope) in moved.iter_mut().zip(self.along_start.col_as_slice(i)) {
                *r += slope * d;
            }
        }
        for (j, g) in gradient.iter_mut().enumerate() {
            let column = self.jacobian.col_as_slice(j);
            *g = moved.iter().zip(column).map(|(r, slope)| r * slope).sum();
        }
        0.5 * moved.iter().map(|r| r * r).sum::<f64>()
    }

    /// Residuals of the present horizon, from the motion of the last roll-out.
    pub fn residuals(&self) -> &[f64] {
        self.rows.present()
    }

    /// Slope of a present residual along a variable, of the last linearization.
    pub fn slope(&self, row: usize, variable: usize) -> f64 {
        self.jacobian[(row, variable)]
    }

    /// `½ |r|²` of the present horizon, from the motion of the last roll-out.
    pub fn cost(&self) -> f64 {
        let present = self.rows.present();
        0.5 * present.iter().map(|r| r * r).sum::<f64>()
    }

    /// Returns the cost if every tracked quantity has a constant error of 1e-4 (divided by the length, or rad).
    pub fn negligible_cost(&self) -> f64 {
        self.rows.cost_of(NEGLIGIBLE)
    }

    /// Position of a node at time node `k` of the last roll-out, m.
    pub fn position(&self, k: usize, node: usize) -> Vector3<f64> {
        self.trajectory.positions_at(k)[node]
    }

    /// Replaces the terminal cost, see [`Rows::replace_terminal`].
    pub fn replace_terminal(&mut self, other: Option<TerminalCost>) {
        self.rows.replace_terminal(other);
    }

    /// Notes the last control of a plan, and the one that costs no effort there, both scaled: the terminal cost counts from these.
    pub fn note_end(&mut self, plan: &[f64], free: &[f64]) {
        let n = self.components.len();
        let last = (self.knots.n_coefficients() - 1) * n;
        let model = (&*self.problem.rod, &self.disturbing[..]);
        let controls = [plan, free].map(|all| &all[last..last + n]);
        self.rows.note_end(model, controls, &self.end);
    }

    /// Evaluates values and forms of all rows of the present horizon.
    fn evaluate_all(&mut self) {
        let acting = self.acting_grid();
        self.rows.evaluate(&Evaluated {
            grid: self.grid,
            ..evaluated(
                &self.problem,
                (&self.trajectory, self.efforts.as_ref()),
                acting,
                &self.end,
            )
        });
    }
}

/// Returns a motion under efforts that ends in `end`, with the times of a grid.
fn evaluated<'a>(
    problem: &'a OptimalControlProblem,
    (trajectory, efforts): (&'a Trajectory, Option<&'a ControlSignal>),
    grid: TimeGrid,
    end: &'a State,
) -> Evaluated<'a> {
    Evaluated {
        problem,
        states: residual::States {
            view: RodView {
                rod: &problem.rod,
                radii: &problem.radii,
                trajectory,
                grid,
            },
            momenta: [&end.linear_momentum, &end.angular_momentum],
        },
        grid,
        efforts,
        end,
    }
}
