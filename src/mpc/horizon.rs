//! The model over one horizon: roll-out, rows, sensitivities, and the condensed Gauss-Newton Hessian, all in memory that is kept.
//!
//! With `v` the scaled coefficients of the plan, `δs` the deviation of the state at the start from the predicted one and `r` the
//! residuals of what is made small, the model of a sample is
//!
//! ```text
//! r(v + x, s + δs) = r + J x + G δs,     ½ |r|² + ½ (v + x)ᵀ C (v + x) + ½ w |v₀ + x₀ - a|²
//! ```
//!
//! `J` and `G` come from one reverse sweep: the covectors of the rows, read where the controls act and where the sweep ends. `C` is effort
//! and rate, `a` the control that acts when the horizon begins.

use std::sync::Arc;

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};
use nalgebra::{Matrix3, Vector3};

use super::error::MpcError;
use super::estimator::{Disturbance, ModelParameters};
use super::knots::Knots;
use super::limits::{self, Limits};
use super::soft_rows::SoftRows;
use super::speeds::Speeds;
use crate::control::path::{PathLimit, RodView};
use crate::control::{Component, OptimalControlProblem, Shape};
use crate::mechanics::forms::NODE_COMPONENTS;
use crate::mechanics::linearization::{Motion, StateTangent};
use crate::mechanics::rotation::{log, log_tangent};
use crate::mechanics::sensitivity::{ControlColumns, RepeatedReverse};
use crate::mechanics::{
    FormTerm, NodeWrenches, Rod, State, StateForm, StepError, StepperMemory, TimeGrid, Trajectory,
    Wrench,
};
use crate::stop::StopSignal;

/// Part of the length, or of a radian.
const NEGLIGIBLE: f64 = 1e-4;

/// What a row of the residuals is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Quantity {
    /// A node's distance from its path, one axis, over the rod's length.
    Track {
        index: usize,
        axis: usize,
    },
    /// A node's rotation from how its track wants it turned, one axis, rad.
    TrackRotation {
        index: usize,
        axis: usize,
    },
    /// The difference of a node's mean velocity since the sample before from that of its path, one axis, over the rod's length and time; see
    /// [`Speeds`].
    TrackSpeed {
        index: usize,
        axis: usize,
    },
    /// A target's position, rotation, velocity or angular velocity, one axis, in the scales of its goal.
    Position {
        goal: usize,
        axis: usize,
    },
    Rotation {
        goal: usize,
        axis: usize,
    },
    Velocity {
        goal: usize,
        axis: usize,
    },
    Spin {
        goal: usize,
        axis: usize,
    },
    /// A vector of the deviation from where the arm stays once it is due, one axis, as a distance of the tip over the length.
    Stay {
        vector: usize,
        axis: usize,
    },
    /// A limit on the states, no residual but a row of the subproblem.
    Limit {
        index: usize,
    },
}

/// A row of the residuals.
#[derive(Clone, Copy, Debug)]
struct Row {
    quantity: Quantity,
    /// Square root of its weight, over its scale.
    factor: f64,
}

/// What a unit of a component does: node, component of its wrench, and N or N m.
type Effect = (usize, usize, f64);

/// The effects of every component; `None` where an actuator of one's own is not linear.
fn effects(problem: &OptimalControlProblem, components: &[Component]) -> Option<Vec<Vec<Effect>>> {
    let maps = (problem.acting.iter())
        .map(|acting| {
            Some((
                acting.actuator.nodes(&problem.rod),
                acting.actuator.linear_map(&problem.rod)?,
            ))
        })
        .collect::<Option<Vec<_>>>()?;
    let of = |component: &Component| match problem.own_control(component) {
        None => {
            let node = problem.actuators[component.actuator].node;
            vec![(node, component.axis, 1.0)]
        }
        Some((index, control)) => {
            let (nodes, map) = &maps[index];
            let rows = (0..map.nrows()).filter(|row| map[(*row, control)] != 0.0);
            rows.map(|row| (nodes[row / 6], row % 6, map[(row, control)]))
                .collect()
        }
    };
    Some(components.iter().map(of).collect())
}

/// The model, at the plan and the start it was last prepared for.
#[derive(Debug)]
pub(super) struct Horizon {
    pub problem: OptimalControlProblem,
    pub components: Vec<Component>,
    /// Scale of every component, N or N m, or the unit of a control of an actuator of one's own.
    pub scales: Vec<f64>,
    /// What a unit of every component does.
    pub effects: Vec<Vec<Effect>>,
    pub knots: Knots,
    /// The grid of the present horizon; of the longest one with its start.
    pub grid: TimeGrid,
    longest: TimeGrid,
    rows: Vec<Row>,
    speeds: Speeds,
    /// Of every row, on the longest grid: ascending in time. Those of the present horizon are the last ones, moved to its grid.
    forms: Vec<StateForm>,
    form_nodes: Vec<usize>,
    /// First row of the present horizon.
    first_row: usize,
    /// All nodes.
    pub nodes: Vec<usize>,
    /// Of the two ends of a step, one a node.
    wrenches: [Vec<Wrench>; 2],
    /// The obstacles among the limits of the problem as the task has them at t = 0.
    obstacles: Vec<(usize, Shape)>,
    /// The model without anything wrong with it.
    model: Arc<Rod>,
    /// What ends simulations and sweeps before they are done.
    pub stop: StopSignal,
    /// What is wrong with the model of the present horizon, and what the constants in `memory` are for.
    parameters: ModelParameters,
    tuned: ModelParameters,
    /// What disturbs every node, constant in time.
    disturbing: Vec<Wrench>,
    /// By how much later commands act than they say, s.
    delay: f64,
    trajectory: Trajectory,
    /// State that the roll-out starts from, and the one that it ends in.
    pub start: State,
    end: State,
    memory: Option<StepperMemory>,
    sweep: RepeatedReverse,
    residuals: Vec<f64>,
    limits: Limits,
    /// The residuals of the present horizon with the start moved.
    moved: Vec<f64>,
    /// `J` and `G`.
    jacobian: Mat<f64>,
    along_start: Mat<f64>,
    /// `JᵀJ`.
    pub square: Mat<f64>,
}

/// The columns of the plan's coefficients.
struct Columns<'a> {
    knots: &'a Knots,
    grid: TimeGrid,
    effects: &'a [Vec<Effect>],
    scales: &'a [f64],
    n: usize,
}

impl ControlColumns for Columns<'_> {
    fn n_columns(&self) -> usize {
        self.n
    }

    fn visit(&self, k: usize, visit: &mut dyn FnMut(usize, usize, usize, f64)) {
        for (coefficient, weight) in self.knots.at_node(&self.grid, k) {
            if weight == 0.0 {
                continue;
            }
            for (at, (effects, scale)) in self.effects.iter().zip(self.scales).enumerate() {
                let column = coefficient * self.effects.len() + at;
                for &(node, component, effect) in effects {
                    visit(column, node, component, weight * scale * effect);
                }
            }
        }
    }

    fn n_started(&self, _: usize) -> usize {
        self.n
    }
}

impl Horizon {
    /// `weight` is what a unit of a target's scaled residual costs, squared and halved, `price` that of a violated limit.
    pub fn new(
        mut problem: OptimalControlProblem,
        mut knots: Knots,
        weight: f64,
        price: f64,
    ) -> Result<Self, MpcError> {
        if !problem.objective.terms.is_empty() || problem.objective.energy != 0.0 {
            return Err(MpcError::Unsupported(
                "the controller knows tracks, targets, effort and rate; leave out cost.energy and terms of one's own",
            ));
        }
        limits::check(&problem)?;
        if problem.duration.is_some() {
            return Err(MpcError::Unsupported(
                "the controller knows a fixed duration; leave out free_duration",
            ));
        }
        let model = Arc::clone(&problem.rod);
        // The rod that disturbances change is the horizon's own from the beginning: a sample allocates nothing.
        Arc::make_mut(&mut problem.rod);
        let grid = problem.grid;
        let components = problem.actuated_components();
        let Some(effects) = effects(&problem, &components) else {
            return Err(MpcError::Unsupported(
                "the controller knows wrenches on nodes and actuators that are linear; leave out other own_actuators",
            ));
        };
        let scales: Vec<f64> = (components.iter())
            .map(|component| problem.channel(component).scale)
            .collect();
        let n_states = NODE_COMPONENTS * (problem.rod.n_nodes() - problem.rod.first_free_node());
        let mut limits = Limits::new(&problem, price, n_states);
        let (rows, forms) = rows(&problem, weight, &limits);
        let limited = rows.iter().enumerate();
        let limited = limited.filter(|(_, row)| matches!(row.quantity, Quantity::Limit { .. }));
        limits.place(limited.map(|(place, _)| place));
        let speeds = rows.iter().enumerate();
        let speeds = Speeds::new(speeds.filter_map(|(place, row)| match row.quantity {
            Quantity::TrackSpeed { index, axis } => Some((place, [index, axis], row.factor)),
            _ => None,
        }));
        let n = knots.most(grid.duration()) * components.len();
        knots.place(grid.start, grid.time(grid.n_steps));
        let start = problem.initial.clone();
        let n_nodes = problem.rod.n_nodes();
        let mut trajectory = Trajectory::with_capacity(n_nodes, grid.n_steps + 1);
        for _ in 0..=grid.n_steps {
            trajectory.push(&start.configuration);
        }
        let sweep = {
            let motion = Motion {
                rod: &problem.rod,
                grid,
                initial: &start,
                stop: None,
                control: None,
            };
            let columns = Columns {
                knots: &knots,
                grid,
                effects: &effects,
                scales: &scales,
                n,
            };
            RepeatedReverse::new(&motion, &trajectory, &columns, &forms)
        };
        Ok(Self {
            limits,
            memory: Some(StepperMemory::new(&problem.rod, grid.step)),
            form_nodes: forms.iter().map(|form| form.time_node).collect(),
            first_row: 0,
            wrenches: [(); 2].map(|()| vec![Wrench::default(); n_nodes]),
            nodes: (0..n_nodes).collect(),
            model,
            stop: StopSignal::default(),
            obstacles: (problem.path.iter().enumerate())
                .filter_map(|(index, path)| match &path.limit {
                    PathLimit::Clearance { shape, .. } => Some((index, *shape)),
                    _ => None,
                })
                .collect(),
            parameters: Disturbance::NONE.parameters(),
            tuned: Disturbance::NONE.parameters(),
            disturbing: vec![Wrench::default(); n_nodes],
            delay: 0.0,
            trajectory,
            end: start.clone(),
            start,
            sweep,
            residuals: vec![0.0; rows.len()],
            moved: vec![0.0; rows.len()],
            jacobian: Mat::zeros(rows.len(), n),
            along_start: Mat::zeros(rows.len(), n_states),
            square: Mat::zeros(n, n),
            rows,
            speeds,
            forms,
            components,
            scales,
            effects,
            knots,
            longest: grid,
            grid,
            problem,
        })
    }

    /// The most variables that a horizon has.
    pub fn n_variables(&self) -> usize {
        self.square.nrows()
    }

    /// Variables of the present horizon.
    pub fn n_present(&self) -> usize {
        self.knots.len() * self.components.len()
    }

    /// Nodes on which components act, wrenches on nodes before actuators of one's own, each once.
    pub fn actuated_nodes(&self) -> Vec<usize> {
        let mut nodes = self.problem.actuated_nodes();
        for &(node, _, _) in self.effects.iter().flatten() {
            if !nodes.contains(&node) {
                nodes.push(node);
            }
        }
        nodes
    }

    /// Puts the horizon from `start` (s) on: as long as the longest one, or until `due`. False where nothing is left of it.
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
        self.first_row = self.form_nodes.partition_point(|node| *node < passed);
        for (form, node) in (self.forms.iter_mut().zip(&self.form_nodes)).skip(self.first_row) {
            form.time_node = node - passed;
        }
        self.knots.place(start, self.grid.time(n_steps));
        true
    }

    /// Gives a track another path: the residuals of the present horizon are those from the new one.
    pub fn follow(&mut self, track: usize, path: &[(f64, Vector3<f64>)]) {
        let own = &mut self.problem.objective.tracking[track].path;
        own.clear();
        own.extend_from_slice(path);
        self.evaluate_anew();
    }

    /// The same for how a track is to be turned.
    pub fn turn(&mut self, track: usize, rotations: &[(f64, Matrix3<f64>)]) {
        let own = &mut self.problem.objective.tracking[track].rotations;
        own.clear();
        own.extend_from_slice(rotations);
        self.evaluate_anew();
    }

    /// Names of the obstacles.
    pub fn obstacles(&self) -> impl Iterator<Item = &str> {
        (self.obstacles.iter()).map(|(index, _)| &self.problem.path[*index].name[..])
    }

    /// Puts an obstacle where it is at time `t` (s): `by` (m) away from where the task has it at t = 0, and on its way at `velocity` (m/s). The next
    /// horizon sees it. False where none has this name.
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

    /// Takes a disturbance into the model.
    pub fn disturb(&mut self, disturbance: &Disturbance) {
        self.disturbing.fill(Wrench::default());
        disturbance.add_to(&self.model, &mut self.disturbing);
        self.delay = disturbance.delay;
        let parameters = disturbance.parameters();
        if parameters != self.parameters {
            disturbance.change_model(&self.model, Arc::make_mut(&mut self.problem.rod));
            self.parameters = parameters;
        }
    }

    /// When the motion happens: later than the commands say by how much they are found to be late.
    fn acting_grid(&self) -> TimeGrid {
        TimeGrid {
            start: self.grid.start + self.delay,
            ..self.grid
        }
    }

    /// By how much later commands act than they say, s.
    pub fn delay(&self) -> f64 {
        self.delay
    }

    /// The model without anything wrong with it.
    pub fn model(&self) -> &Rod {
        &self.model
    }

    /// What is wrong with the model: equal numbers make equal models.
    pub fn parameters(&self) -> ModelParameters {
        self.parameters
    }

    /// What disturbs every node.
    pub fn disturbing(&self) -> &[Wrench] {
        &self.disturbing
    }

    /// What the plan applies at time `t`, scaled, one of each component.
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
            nodes,
            wrenches: [now, next],
            disturbing,
            trajectory,
            ..
        } = self;
        let n = self.components.len();
        let fill = |k: usize, wrenches: &mut [Wrench]| {
            wrenches.copy_from_slice(disturbing);
            for (coefficient, weight) in knots.at_node(grid, k) {
                let own = &plan[coefficient * n..][..n];
                for ((effects, v), scale) in self.effects.iter().zip(own).zip(&self.scales) {
                    add_effects(effects, weight * v * scale, wrenches);
                }
            }
        };
        trajectory.positions.clear();
        trajectory.rotations.clear();
        trajectory.push(&self.start.configuration);
        let memory = self.memory.take();
        let mut memory = memory.unwrap_or_else(|| StepperMemory::new(&problem.rod, grid.step));
        if self.tuned != self.parameters {
            memory.retune(&problem.rod, grid.step);
            self.tuned = self.parameters;
        }
        let mut stepper = memory.begin(&problem.rod, grid.start, &self.start);
        fill(0, now);
        let mut outcome = Ok(());
        for k in 0..grid.n_steps {
            fill(k + 1, next);
            let of = |wrenches| NodeWrenches::on(nodes, wrenches);
            outcome = (self.stop.check_at(k).map_err(StepError::from))
                .and_then(|()| stepper.advance([of(now), of(next)]));
            if outcome.is_err() {
                break;
            }
            stepper.record(trajectory);
            std::mem::swap(now, next);
        }
        stepper.write_state(&mut self.end);
        self.memory = Some(stepper.into_memory());
        outcome?;
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
            control: None,
        };
        let columns = Columns {
            knots: &self.knots,
            grid: self.grid,
            effects: &self.effects,
            scales: &self.scales,
            n: self.square.nrows(),
        };
        let forms = &self.forms[self.first_row..];
        (self.sweep).sweep(&motion, &self.trajectory, &columns, forms)?;
        let n = self.knots.len() * self.components.len();
        for j in 0..n {
            let column = self.jacobian.col_as_slice_mut(j);
            for (row, value) in column[..forms.len()].iter_mut().enumerate() {
                *value = self.sweep.along_column(row, j);
            }
            for (_, row) in self.limits.present(self.first_row) {
                column[row] = 0.0;
            }
            self.speeds.take_differences(self.first_row, column);
        }
        for i in 0..self.along_start.ncols() {
            let column = self.along_start.col_as_slice_mut(i);
            for (row, value) in column[..forms.len()].iter_mut().enumerate() {
                *value = self.sweep.along_start(row, i);
            }
            self.limits.take_along_start(self.first_row, i, column);
            self.speeds.take_differences(self.first_row, column);
        }
        let jacobian = self.jacobian.get(..forms.len(), ..n);
        let square = self.square.as_mut().get_mut(..n, ..n);
        let transposed = jacobian.transpose();
        matmul(square, Accum::Replace, transposed, jacobian, 1.0, Par::Seq);
        Ok(())
    }

    /// The limits of the present horizon as rows of a subproblem, but for their values.
    pub fn write_limits(&self, soft: &mut SoftRows) {
        self.limits.write(self.first_row, soft);
        let n = self.n_present();
        for (at, (_, row)) in self.limits.present(self.first_row).enumerate() {
            let slopes = soft.slopes.col_as_slice_mut(at);
            slopes[n..].fill(0.0);
            for (j, slope) in slopes[..n].iter_mut().enumerate() {
                *slope = self.sweep.along_column(row, j);
            }
        }
    }

    /// Their values where the start deviates.
    pub fn write_limit_values(&self, deviation: &StateTangent, out: &mut [f64]) {
        let free = self.problem.rod.first_free_node();
        (self.limits).write_values(self.first_row, free, deviation, out);
    }

    /// Rows that limits have in the longest horizon.
    pub fn n_limit_rows(&self) -> usize {
        self.limits.len()
    }

    /// `Jᵀ (r + G δs)` over the present variables, and `½ |r + G δs|²`.
    pub fn gradient(&mut self, deviation: &StateTangent, gradient: &mut [f64]) -> f64 {
        let first = self.problem.rod.first_free_node();
        let present = &self.residuals[self.first_row..];
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

    /// `½ |r|²` of the present horizon, from the motion of the last roll-out.
    pub fn cost(&self) -> f64 {
        let present = &self.residuals[self.first_row..];
        0.5 * present.iter().map(|r| r * r).sum::<f64>()
    }

    /// What it costs that all that is followed or aimed at is off by a ten-thousandth of the length or of a radian, all the time.
    pub fn negligible_cost(&self) -> f64 {
        let length = self.problem.rod.scales.length;
        let of = |row: &Row| match row.quantity {
            Quantity::Track { .. } | Quantity::Position { .. } => row.factor * length,
            Quantity::TrackRotation { .. } | Quantity::Rotation { .. } => row.factor,
            Quantity::TrackSpeed { .. }
            | Quantity::Velocity { .. }
            | Quantity::Spin { .. }
            | Quantity::Stay { .. }
            | Quantity::Limit { .. } => 0.0,
        };
        let square: f64 = self.rows.iter().map(|row| of(row).powi(2)).sum();
        0.5 * NEGLIGIBLE * NEGLIGIBLE * square
    }

    /// Position of a node at time node `k` of the last roll-out, m.
    pub fn position(&self, k: usize, node: usize) -> Vector3<f64> {
        self.trajectory.positions_at(k)[node]
    }

    /// Values and forms of all rows of the present horizon.
    fn evaluate_all(&mut self) {
        for at in self.first_row..self.rows.len() {
            self.evaluate(at);
        }
        self.speeds.evaluate(
            &self.problem,
            (&self.trajectory, &self.acting_grid()),
            (&self.forms, self.first_row),
            &mut self.residuals,
        );
    }

    /// Value and form of one row, but for those of speeds.
    fn evaluate(&mut self, at: usize) {
        let Row { quantity, factor } = self.rows[at];
        let acting = self.acting_grid();
        let form = &mut self.forms[at];
        if let Quantity::Limit { index } = quantity {
            let view = RodView {
                rod: &self.problem.rod,
                radii: &self.problem.radii,
                trajectory: &self.trajectory,
                grid: self.grid,
            };
            self.limits.evaluate(&self.problem, &view, index, form);
            self.residuals[at] = 0.0;
            return;
        }
        let k = form.time_node;
        let goals = &self.problem.goals;
        let value = match quantity {
            Quantity::Track { index, axis } => {
                let track = &self.problem.objective.tracking[index];
                let x = self.trajectory.positions_at(k)[track.node];
                let t = acting.time(k);
                let place = track.position(t).filter(|_| track.counts(t));
                form.terms[0].coefficient = if place.is_some() { factor } else { 0.0 };
                place.map_or(0.0, |place| (x - place)[axis])
            }
            Quantity::TrackRotation { index, axis } => {
                let track = &self.problem.objective.tracking[index];
                let r = self.trajectory.rotations_at(k)[track.node];
                let t = acting.time(k);
                let psi = track.turn(t, &r).filter(|_| track.counts(t));
                let own = if psi.is_some() { factor } else { 0.0 };
                let psi = psi.unwrap_or_default();
                write_turn(form, own, psi, axis);
                psi[axis]
            }
            Quantity::Position { goal, axis } => {
                let goal = &goals[goal];
                let x = self.trajectory.positions_at(k)[goal.node];
                goal.position.map_or(0.0, |target| (x - target)[axis])
            }
            Quantity::Rotation { goal, axis } => {
                let goal = &goals[goal];
                let r = self.trajectory.rotations_at(k)[goal.node];
                let psi = log(&(goal.rotation.unwrap_or(r).transpose() * r));
                write_turn(form, factor, psi, axis);
                psi[axis]
            }
            Quantity::Velocity { goal, axis } => {
                let node = goals[goal].node;
                let mass = self.problem.rod.nodes[node].mass;
                form.terms[0].coefficient = factor / mass;
                self.end.linear_momentum[node][axis] / mass
            }
            Quantity::Spin { goal, axis } => {
                let node = goals[goal].node;
                self.end.angular_momentum[node][axis] / self.problem.rod.nodes[node].rotary[axis]
            }
            Quantity::Stay { vector, axis } => (self.problem.stay.as_ref()).map_or(0.0, |stay| {
                let r = self.trajectory.rotations_at(k);
                for (term, new) in (form.terms.iter_mut()).zip(stay.gradient(vector, axis, r)) {
                    term.coefficient = factor * new.coefficient;
                }
                let momenta = [&self.end.linear_momentum[..], &self.end.angular_momentum];
                let vectors = [self.trajectory.positions_at(k), momenta[0], momenta[1]];
                stay.vector(vector, vectors, r)[axis]
            }),
            Quantity::TrackSpeed { .. } | Quantity::Limit { .. } => 0.0,
        };
        self.residuals[at] = factor * value;
    }
}

/// The form of `factor` times one axis of a rotation vector `ψ = log(R*ᵀ R)`: `δψ = Sᵀ ζ`.
fn write_turn(form: &mut StateForm, factor: f64, psi: Vector3<f64>, axis: usize) {
    let slope = log_tangent(&psi);
    for (i, term) in form.terms.iter_mut().enumerate() {
        term.coefficient = factor * slope[(i, axis)];
    }
}

/// Adds what so much of a component does to the wrenches of all nodes.
pub(super) fn add_effects(effects: &[Effect], amount: f64, wrenches: &mut [Wrench]) {
    for &(node, component, effect) in effects {
        match component.checked_sub(3) {
            None => wrenches[node].force[component] += amount * effect,
            Some(axis) => wrenches[node].moment[axis] += amount * effect,
        }
    }
}

/// All rows of the longest horizon, with their forms, in ascending order of time.
fn rows(
    problem: &OptimalControlProblem,
    weight: f64,
    limits: &Limits,
) -> (Vec<Row>, Vec<StateForm>) {
    let rod = &problem.rod;
    let one = |node: usize, component: usize, coefficient: f64| FormTerm {
        node,
        component,
        coefficient,
    };
    let mut out: Vec<(Row, StateForm)> = Vec::new();
    let mut push = |time_node: usize, quantity: Quantity, factor: f64, terms: Vec<FormTerm>| {
        out.push((Row { quantity, factor }, StateForm { time_node, terms }));
    };
    for (time_node, duration) in crate::control::sample_times(problem) {
        for (index, track) in problem.objective.tracking.iter().enumerate() {
            let factor = (track.weight * duration).sqrt() / rod.scales.length;
            for axis in (0..3).filter(|_| !track.path.is_empty()) {
                let terms = vec![one(track.node, axis, factor)];
                push(time_node, Quantity::Track { index, axis }, factor, terms);
            }
            let factor = track.speed_weight.sqrt() * rod.scales.time / rod.scales.length;
            for axis in (0..3).filter(|_| factor > 0.0) {
                let terms = vec![one(track.node, axis, 1.0)];
                push(
                    time_node,
                    Quantity::TrackSpeed { index, axis },
                    factor,
                    terms,
                );
            }
            let factor = (track.rotation_weight * duration).sqrt();
            for axis in (0..3).filter(|_| !track.rotations.is_empty()) {
                let terms = (0..3).map(|i| one(track.node, 3 + i, 0.0)).collect();
                let quantity = Quantity::TrackRotation { index, axis };
                push(time_node, quantity, factor, terms);
            }
        }
    }
    for (goal, target) in problem.goals.iter().enumerate() {
        let (k, node) = (target.time_node, target.node);
        let (length, time) = (rod.scales.length, rod.scales.time);
        let root = weight.sqrt();
        let inertia = &rod.nodes[node];
        for axis in 0..3 {
            if target.position.is_some() {
                let factor = root / length;
                let terms = vec![one(node, axis, factor)];
                push(k, Quantity::Position { goal, axis }, factor, terms);
            }
            if target.rotation.is_some() {
                let terms = (0..3).map(|i| one(node, 3 + i, 0.0)).collect();
                push(k, Quantity::Rotation { goal, axis }, root, terms);
            }
            if target.at_rest {
                let factor = root * time / length;
                let terms = vec![one(node, 6 + axis, 0.0)];
                push(k, Quantity::Velocity { goal, axis }, factor, terms);
                let factor = root * time;
                let terms = vec![one(node, 9 + axis, factor / inertia.rotary[axis])];
                push(k, Quantity::Spin { goal, axis }, factor, terms);
            }
        }
    }
    if let Some(stay) = &problem.stay {
        let k = problem.goals[stay.goal].time_node;
        // A deviation of energy ½ |r|² moves the tip by |r| times the root of its compliance.
        let factor = (weight * stay.compliance).sqrt() / rod.scales.length;
        for vector in 0..stay.n_vectors() {
            for axis in 0..3 {
                let r = &stay.shape.rotations;
                let terms = stay.gradient(vector, axis, r).collect();
                push(k, Quantity::Stay { vector, axis }, factor, terms);
            }
        }
    }
    for (index, time_node) in limits.time_nodes().enumerate() {
        push(time_node, Quantity::Limit { index }, 1.0, Vec::new());
    }
    out.sort_by_key(|(_, form)| form.time_node);
    out.into_iter().unzip()
}
