//! The optimal-control problem as a lifted program: controls are variables, configurations at every time node are states.
//!
//! The state equations are the discrete equations of motion; they are eliminated exactly, by the forward recursion of the linearized motion
//! (condensing), or its transpose. The constraints are the scaled residuals of the goals, the inequalities the rows of the path
//! constraints; a soft goal, and a goal within a tolerance, has variables of its own for its residuals.

use crate::acting::ActingAlong;
use crate::control_cost::ControlCost;
use crate::path::{PathConstraint, PathMultiplier, RodView, RowCurvature, RowGradient};
use crate::problem::{Component, GoalRow, OptimalControlProblem};
use crate::residual::{Residual, States, cost_residuals, goal_curvature, goal_residuals};
use crate::turns::longer_ways;
use mechanics::linearization::Defects;
use mechanics::sensitivity::ControlColumns;
use mechanics::{ControlSignal, Trajectory, TrajectoryTangent};
use sqp::{ConvexSet, Multipliers};

mod condense;
mod program;
mod rows;
mod sets;
mod simulation;
mod slacks;

pub(super) use self::rows::describe;
use self::rows::{Columns, CostRow, WrenchColumn};
use self::sets::{CommandSet, convex_sets};
pub use self::simulation::simulate;

/// Controls and configurations; the configurations need not obey the dynamics.
#[derive(Clone, Debug)]
pub struct LiftedPoint {
    /// Scaled control coefficients, then the residuals of soft goals and of those within a tolerance.
    pub variables: Vec<f64>,
    /// Configurations at every time node.
    pub trajectory: Trajectory,
}

/// A change of a [`LiftedPoint`].
#[derive(Clone, Debug)]
pub struct LiftedDirection {
    /// Change of the variables.
    pub variables: Vec<f64>,
    /// Direction of the configurations.
    pub trajectory: TrajectoryTangent,
}

/// A row of a path constraint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PathRow {
    /// Index into [`Transcription::path`].
    pub constraint: usize,
    /// Index into the constraint's time nodes.
    pub time: usize,
    /// Index of the item at that time node.
    pub item: usize,
}

/// A relaxation of a program's rows: with one more variable `τ`, the last, constraints read `c = τ d` and inequalities `h ≤ τ d`, and
/// `weight τ` is added to the objective.
///
/// At a solution `weight = dᵀ(y, z)`. If the rows of a program can only just be met, its multipliers are not unique; those of the relaxed
/// one are.
#[derive(Clone, Debug)]
pub(super) struct Relaxation {
    /// Price of `τ`.
    pub(super) weight: f64,
    /// `d` of the constraints.
    pub(super) constraints: Vec<f64>,
    /// `d ≥ 0` of the inequalities.
    pub(super) inequalities: Vec<f64>,
}

/// The transcription of an optimal-control problem.
pub struct Transcription<'a> {
    problem: &'a OptimalControlProblem,
    components: Vec<Component>,
    goal_rows: Vec<GoalRow>,
    /// Their residuals, three rows each.
    goals: Vec<Residual>,
    /// Variable of every goal row whose residual has one.
    slack_variables: Vec<Option<usize>>,
    /// [Scaled residual](OptimalControlProblem::slack_unit) for one unit of that variable, row by row.
    slack_units: Vec<f64>,
    sets: Vec<ConvexSet>,
    /// Places of the bounds on commands among the sets.
    commands: Vec<CommandSet>,
    path: Vec<PathConstraint>,
    /// First row of every path constraint, and their number at the end. The rows of an item are successive in time: neighbors are similar,
    /// on which the solver's choice of rows relies.
    path_starts: Vec<usize>,
    /// Duration that every time node of every path constraint represents, s.
    path_durations: Vec<Vec<f64>>,
    /// The residuals of the costs over states.
    costs: Vec<Residual>,
    control_cost: ControlCost,
    relaxation: Option<Relaxation>,
    pub(super) n_controls: usize,
    pub(super) n_threads: usize,
}

impl<'a> Transcription<'a> {
    /// Transcribes `problem`; sensitivities use `n_threads` threads, which has no effect on the result.
    #[must_use]
    pub fn new(problem: &'a OptimalControlProblem, n_threads: usize) -> Self {
        Self::of(problem, n_threads, None)
    }

    /// Transcribes and relaxes `problem`.
    pub(super) fn relaxed(
        problem: &'a OptimalControlProblem,
        n_threads: usize,
        relaxation: Relaxation,
    ) -> Self {
        Self::of(problem, n_threads, Some(relaxation))
    }

    fn of(
        problem: &'a OptimalControlProblem,
        n_threads: usize,
        relaxation: Option<Relaxation>,
    ) -> Self {
        let components = problem.actuated_components();
        let goal_rows = problem.goal_rows();
        let n_controls = problem.n_controls();
        let mut next = n_controls;
        let slack_variables: Vec<Option<usize>> = goal_rows
            .iter()
            .map(|row| {
                problem.has_slack(row).then(|| {
                    next += 1;
                    next - 1
                })
            })
            .collect();
        let slack_units = (goal_rows.iter().map(|row| problem.slack_unit(row))).collect();
        let path = problem.path.clone();
        let mut path_starts = vec![0];
        for constraint in &path {
            let rows = constraint.time_nodes.len() * constraint.limit.n_items(&problem.rod);
            path_starts.push(path_starts[path_starts.len() - 1] + rows);
        }
        let path_durations = (path.iter())
            .map(|constraint| constraint.node_durations(problem.grid.step))
            .map(|nodes| nodes.into_iter().map(|(_, duration)| duration).collect())
            .collect();
        let (sets, commands) = convex_sets(problem, &components, &goal_rows, &slack_variables);
        Self {
            sets,
            commands,
            control_cost: ControlCost::of(
                problem,
                &components,
                &goal_rows,
                &slack_variables,
                relaxation.as_ref().map(|relaxation| relaxation.weight),
            ),
            relaxation,
            costs: (cost_residuals(problem).into_iter())
                .filter(|residual| residual.counts(problem, &problem.grid))
                .collect(),
            goals: goal_residuals(problem, Some(&longer_ways(problem))),
            problem,
            components,
            goal_rows,
            slack_variables,
            slack_units,
            path,
            path_starts,
            path_durations,
            n_controls,
            n_threads,
        }
    }

    /// Returns the problem.
    #[must_use]
    pub fn problem(&self) -> &OptimalControlProblem {
        self.problem
    }

    /// Returns the rows of the goals, in the order of constraints and their multipliers.
    #[must_use]
    pub fn goal_rows(&self) -> &[GoalRow] {
        &self.goal_rows
    }

    /// Returns the path constraints.
    #[must_use]
    pub fn path(&self) -> &[PathConstraint] {
        &self.path
    }

    /// Returns constraint, time and item of row `index` of the inequalities.
    #[must_use]
    pub fn path_row(&self, index: usize) -> PathRow {
        let constraint = self.path_starts.partition_point(|&start| start <= index) - 1;
        let within = index - self.path_starts[constraint];
        let n_times = self.path[constraint].time_nodes.len();
        PathRow {
            constraint,
            time: within % n_times,
            item: within / n_times,
        }
    }

    /// Returns the nonzero multipliers among those of all path rows.
    #[must_use]
    pub fn path_multipliers(&self, inequalities: &[f64]) -> Vec<PathMultiplier> {
        (inequalities.iter().enumerate())
            .filter(|(_, multiplier)| **multiplier != 0.0)
            .map(|(row, &multiplier)| {
                let PathRow {
                    constraint,
                    time,
                    item,
                } = self.path_row(row);
                PathMultiplier {
                    constraint,
                    time_node: self.path[constraint].time_nodes[time],
                    item,
                    multiplier,
                }
            })
            .collect()
    }

    /// Returns the number of rows of the path constraints.
    #[must_use]
    pub fn n_path_rows(&self) -> usize {
        self.path_starts[self.path.len()]
    }

    /// Returns the normals of the bounds on rates, for every step between coefficients and every number of these, from those of all sets;
    /// empty without such bounds.
    #[must_use]
    pub fn rate_normals(&self, normals: &[Vec<f64>]) -> Vec<f64> {
        let n_components = self.components.len();
        let n = self.problem.n_numbers();
        let steps = self.problem.control.n_coefficients() - 1;
        let mut out = vec![0.0; steps * n];
        let mut any = false;
        // The later coefficient of a difference tells the step to which it belongs.
        let mut add = |row: &[(usize, f64)], normal: f64| {
            let Some(&(later, sign)) = row.iter().max_by_key(|(index, _)| index) else {
                return;
            };
            let component = self.components[later % n_components];
            let step = later / n_components - 1;
            out[step * n + component.index] += sign * normal;
            any = true;
        };
        let is_command =
            |index: usize| (self.commands.binary_search_by_key(&index, |own| own.set)).is_ok();
        for (index, (set, normal)) in self.sets.iter().zip(normals).enumerate() {
            match set {
                _ if is_command(index) => {}
                ConvexSet::Ball { rows, .. } if rows.iter().any(|row| row.len() > 1) => {
                    for (row, z) in rows.iter().zip(normal) {
                        add(row, *z);
                    }
                }
                ConvexSet::HalfSpace { direction, .. } => {
                    add(direction, normal.first().copied().unwrap_or(0.0));
                }
                ConvexSet::Ball { .. } | ConvexSet::Interval { .. } => {}
            }
        }
        if any { out } else { Vec::new() }
    }

    /// Returns the normals of the bounds on commands, for every [row](ControlGrid::command_rows) and every number of a coefficient, from
    /// those of all sets; empty without such bounds.
    #[must_use]
    pub fn command_normals(&self, normals: &[Vec<f64>]) -> Vec<f64> {
        let n = self.problem.n_numbers();
        let n_rows = self.commands.iter().map(|own| own.row + 1).max();
        let mut out = vec![0.0; n_rows.unwrap_or(0) * n];
        for own in &self.commands {
            // A program that could not begin has none.
            let normal = normals.get(own.set).and_then(|normal| normal.first());
            out[own.row * n + own.component.index] += own.sign * normal.unwrap_or(&0.0);
        }
        out
    }

    /// Returns the sum over the bounds on commands of normal times command, in scaled variables.
    pub(super) fn commanded(&self, variables: &[f64], normals: &[Vec<f64>]) -> f64 {
        let term = |own: &CommandSet| match &self.sets[own.set] {
            ConvexSet::HalfSpace { direction, .. } => {
                let command: f64 = direction.iter().map(|&(i, w)| w * variables[i]).sum();
                let normal = normals.get(own.set).and_then(|normal| normal.first());
                normal.unwrap_or(&0.0) * command
            }
            ConvexSet::Ball { .. } | ConvexSet::Interval { .. } => 0.0,
        };
        self.commands.iter().map(term).sum()
    }

    pub fn rod_view<'b>(&'b self, point: &'b LiftedPoint) -> RodView<'b> {
        RodView {
            rod: &self.problem.rod,
            radii: &self.problem.radii,
            trajectory: &point.trajectory,
            grid: self.problem.grid,
        }
    }

    /// Evaluates actuators at a point; `None` if there is nothing that [depends on it](OptimalControlProblem::acts_on_configuration).
    fn acting<'b>(&'b self, point: &'b LiftedPoint) -> Option<ActingAlong<'b>> {
        if !self.problem.acts_on_configuration() {
            return None;
        }
        ActingAlong::of(
            self.problem,
            self.signal(&point.variables),
            &point.trajectory,
        )
    }

    pub(super) fn signal(&self, variables: &[f64]) -> ControlSignal {
        let coefficients = self.problem.coefficients(variables);
        self.problem.signal(&self.problem.control, &coefficients)
    }

    /// The motion of a point with the momenta in which it ends; derivatives of residuals do without these.
    fn states<'b>(&'b self, trajectory: &'b Trajectory, end: Option<&'b Defects>) -> States<'b> {
        States {
            view: RodView {
                rod: &self.problem.rod,
                radii: &self.problem.radii,
                trajectory,
                grid: self.problem.grid,
            },
            momenta: end.map_or([&[], &[]], |end| {
                [&end.terminal_linear[..], &end.terminal_angular]
            }),
        }
    }

    /// Scaled residuals of the goals, without the variables that some have for them.
    fn goal_values(&self, trajectory: &Trajectory, end: &Defects) -> Vec<f64> {
        let states = self.states(trajectory, Some(end));
        let mut out = Vec::with_capacity(self.goal_rows.len());
        for residual in &self.goals {
            residual.values(self.problem, &states, &mut |_, value| out.push(value));
        }
        out
    }

    /// Derivatives of the scaled residuals of the goals, in the order of [`Self::goal_rows`].
    pub(crate) fn goal_gradients(&self, trajectory: &Trajectory) -> Vec<RowGradient> {
        let states = self.states(trajectory, None);
        (self.goals.iter())
            .flat_map(|residual| residual.gradients(self.problem, &states))
            .collect()
    }

    /// The rows of the costs over states.
    fn state_costs(&self, point: &LiftedPoint) -> Vec<CostRow> {
        let states = self.states(&point.trajectory, None);
        let mut out: Vec<CostRow> = Vec::new();
        for residual in &self.costs {
            let first = out.len();
            let gradients = residual.gradients(self.problem, &states);
            out.extend(gradients.into_iter().map(|gradient| CostRow {
                residual: 0.0,
                gradient,
            }));
            residual.values(self.problem, &states, &mut |row, value| {
                out[first + row].residual = value;
            });
        }
        out
    }

    /// Residuals of the goals minus the variables that some have for them.
    fn less_slacks(&self, mut residuals: Vec<f64>, variables: &[f64]) -> Vec<f64> {
        for (row, (r, variable)) in residuals.iter_mut().zip(&self.slack_variables).enumerate() {
            *r -= variable.map_or(0.0, |variable| self.slack_units[row] * variables[variable]);
            *r += self.relaxed_constraint(row) * self.shortfall(variables);
        }
        residuals
    }

    /// Returns `τ` of a [`Relaxation`]; 0 without one.
    fn shortfall(&self, variables: &[f64]) -> f64 {
        match (&self.relaxation, variables.last()) {
            (Some(_), Some(shortfall)) => *shortfall,
            _ => 0.0,
        }
    }

    /// Returns the derivative of a constraint along `τ`.
    fn relaxed_constraint(&self, row: usize) -> f64 {
        (self.relaxation.as_ref()).map_or(0.0, |relaxation| -relaxation.constraints[row])
    }

    /// Returns the derivative of an inequality along `τ`.
    fn relaxed_inequality(&self, row: usize) -> f64 {
        (self.relaxation.as_ref()).map_or(0.0, |relaxation| -relaxation.inequalities[row])
    }

    /// Returns the values of all path rows.
    fn path_values(&self, point: &LiftedPoint) -> Vec<f64> {
        let rod_view = self.rod_view(point);
        let mut values = Vec::with_capacity(self.n_path_rows());
        for constraint in &self.path {
            let n_items = constraint.limit.n_items(&self.problem.rod);
            let scale = constraint.limit.scale(&self.problem.rod);
            for item in 0..n_items {
                let value = |&k: &usize| {
                    constraint.limit.value(&rod_view, k, item) + constraint.margin(k, item) / scale
                };
                values.extend(constraint.time_nodes.iter().map(value));
            }
        }
        if self.depends_on_inputs() {
            for (row, h) in values.iter_mut().enumerate() {
                for (column, slope) in self.path_columns(row) {
                    *h += slope * point.variables[column];
                }
            }
        }
        if let Some(relaxation) = &self.relaxation {
            let shortfall = self.shortfall(&point.variables);
            for (h, d) in values.iter_mut().zip(&relaxation.inequalities) {
                *h -= shortfall * d;
            }
        }
        values
    }

    /// Returns constraint, time node and item of a row.
    pub(super) fn located(&self, row: usize) -> (&PathConstraint, usize, usize) {
        let PathRow {
            constraint,
            time,
            item,
        } = self.path_row(row);
        let constraint = &self.path[constraint];
        (constraint, constraint.time_nodes[time], item)
    }

    /// Returns, for every time node, the derivatives of the wrenches along the variables.
    fn columns_by_time(&self) -> Vec<Vec<WrenchColumn>> {
        let columns = Columns::new(self.problem, &self.components, None);
        (0..=self.problem.grid.n_steps)
            .map(|k| {
                let mut out = Vec::new();
                columns.visit(k, &mut |column, node, component, weight| {
                    out.push(WrenchColumn {
                        column,
                        node,
                        component,
                        weight,
                    });
                });
                out
            })
            .collect()
    }

    fn path_gradient(&self, rod_view: &RodView, row: usize) -> RowGradient {
        let (constraint, k, item) = self.located(row);
        constraint.limit.gradient(rod_view, k, item)
    }

    /// Tells whether any row depends on variables at fixed states.
    pub(super) fn depends_on_inputs(&self) -> bool {
        (self.path.iter()).any(|path| path.limit.depends_on_inputs())
    }

    /// Returns the derivatives of a row along the variables at fixed states: those of the [inputs](PathLimit::along_input) on which it
    /// depends.
    pub(super) fn path_columns(&self, row: usize) -> impl Iterator<Item = (usize, f64)> {
        let (constraint, k, item) = self.located(row);
        let input = constraint.limit.along_input(&self.problem.rod, item);
        let driven = input.and_then(|(actuator, slope)| {
            let efforts = self.problem.efforts.as_ref()?;
            let index = efforts.actuators.iter().position(|own| *own == actuator)?;
            self.components
                .iter()
                .enumerate()
                .find_map(|(at, component)| {
                    let (_, gain) =
                        (self.problem.driven_by(component)).find(|own| own.0 == index)?;
                    Some((at, slope * gain * self.problem.channel(component).unit()))
                })
        });
        let n = self.components.len();
        (driven.into_iter()).flat_map(move |(at, slope)| {
            (self.problem.control.weights(k).into_iter())
                .map(move |(coefficient, weight)| (coefficient * n + at, weight * slope))
        })
    }

    fn path_curvature(&self, rod_view: &RodView, row: usize) -> RowCurvature {
        let (constraint, k, item) = self.located(row);
        constraint.limit.curvature(rod_view, k, item)
    }

    /// Returns the second derivatives of goals, path constraints and costs themselves, with the multipliers as factors.
    fn own_curvature(&self, point: &LiftedPoint, multipliers: &Multipliers) -> Vec<RowCurvature> {
        let rod_view = self.rod_view(point);
        let states = self.states(&point.trajectory, None);
        let y = &multipliers.constraints;
        let mut out = goal_curvature(self.problem, &self.goals, &states, y);
        for (row, &y) in multipliers.inequalities.iter().enumerate() {
            if y != 0.0 {
                let mut curvature = self.path_curvature(&rod_view, row);
                curvature.matrix *= y;
                out.push(curvature);
            }
        }
        let costs = self.costs.iter();
        out.extend(costs.filter_map(|residual| residual.curvature(self.problem, &rod_view)));
        out
    }
}
