//! The optimal-control problem as a lifted program: controls are variables, configurations at every time node are states.
//!
//! The state equations are the discrete equations of motion; they are eliminated exactly, by the forward recursion of the linearized motion
//! (condensing), or its transpose. The constraints are the scaled residuals of the goals, the inequalities the rows of the path
//! constraints; a soft goal, and a goal within a tolerance, has variables of its own for its residuals.

use nalgebra::Vector3;

use crate::acting::ActingAlong;
use crate::control_cost::ControlCost;
use crate::path::{PathConstraint, PathLimit, PathMultiplier, RodView, RowCurvature, RowGradient};
use crate::problem::{Component, GoalRow, OptimalControlProblem};
use crate::residual::{Residual, States, cost_residuals, goal_curvature, goal_residuals};
use crate::turns::longer_ways;
use mechanics::linearization::{AdjointSweep, Defects, Motion, RightHandSide};
use mechanics::sensitivity::{ControlColumns, defects, direction};
use mechanics::sparse_motion::{MotionRow, SparseMotion};
use mechanics::{ControlSignal, StateForm, Trajectory, TrajectoryTangent};
use sqp::{
    ConvexSet, Evaluation, Failure, LagrangianTerms, LiftedProgram, Linearization,
    LinearizationRequest, Multipliers, Softness, StateLinearization, StateRow,
};
use stop::StopSignal;

mod condense;
mod rows;
mod sets;
mod simulation;
mod slacks;

pub(super) use self::rows::describe;
use self::rows::{Columns, CostRow, WrenchColumn};
use self::sets::{CommandSet, convex_sets};
pub use self::simulation::simulate;

/// Largest rotation of a node in one step of the solver, rad: half of the quarter turn up to which the rotation of a time step is unique,
/// as two neighboring nodes of a step may turn in opposite directions. `reach` is solved alike, to the bit, with half and with twice the
/// value.
const LARGEST_TURN: f64 = std::f64::consts::FRAC_PI_4;
/// Rotation of a node, rad, below which a step may stretch the rod, which it does by half the square of the rotation: 5e-7, below the
/// default tolerance of a solve. `reach` is solved alike, to the bit, with half and with twice the value.
const SMALL_TURN: f64 = 1e-3;
/// Number of products from which a Gauss-Newton Hessian takes more than some hundredths of a second, so that it is computed where a stop
/// signal can leave it behind. The result is the same.
const MANY_PRODUCTS: usize = 100_000_000;
/// Rows of path constraints nearer to their limit than this (in lengths of the arm, radians, ...) enter the subproblem from the start.
/// Others join where a step violates them, so that the solution does not depend on it (`screening_changes_nothing` in the tests). Half and
/// twice the value change the iterations past a sphere, and the objective in the eleventh digit.
const SCREENING_MARGIN: f64 = 0.05;

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

    /// Returns the normals of the bounds on rates, for every step between coefficients and every actuator, from those of all sets; empty
    /// without such bounds.
    #[must_use]
    pub fn rate_normals(&self, normals: &[Vec<f64>]) -> Vec<[f64; 6]> {
        let n_components = self.components.len();
        let n = self.problem.actuators.len();
        let steps = self.problem.control.n_coefficients() - 1;
        let mut out = vec![[0.0; 6]; steps * n];
        let mut any = false;
        // The later coefficient of a difference tells the step to which it belongs.
        let mut add = |row: &[(usize, f64)], normal: f64| {
            let Some(&(later, sign)) = row.iter().max_by_key(|(index, _)| index) else {
                return;
            };
            let component = self.components[later % n_components];
            let step = later / n_components - 1;
            out[step * n + component.actuator][component.axis] += sign * normal;
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

    /// Returns the normals of the bounds on commands, for every [row](ControlGrid::command_rows) and every actuator, from those of all sets;
    /// empty without such bounds.
    #[must_use]
    pub fn command_normals(&self, normals: &[Vec<f64>]) -> Vec<[f64; 6]> {
        let n = self.problem.actuators.len();
        let n_rows = self.commands.iter().map(|own| own.row + 1).max();
        let mut out = vec![[0.0; 6]; n_rows.unwrap_or(0) * n];
        for own in &self.commands {
            let Component { actuator, axis } = own.component;
            // A program that could not begin has none.
            let normal = normals.get(own.set).and_then(|normal| normal.first());
            out[own.row * n + actuator][axis] += own.sign * normal.unwrap_or(&0.0);
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
        let coefficients = self.problem.wrenches(variables);
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
            for item in 0..n_items {
                let value = |&k: &usize| constraint.limit.value(&rod_view, k, item);
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

impl LiftedProgram for Transcription<'_> {
    type Point = LiftedPoint;
    type Direction = LiftedDirection;
    type Defects = Defects;
    type Costates = AdjointSweep;

    fn sets(&self) -> &[ConvexSet] {
        &self.sets
    }

    fn stop(&self) -> Option<&StopSignal> {
        Some(&self.problem.stop)
    }

    fn variables<'b>(&self, point: &'b LiftedPoint) -> &'b [f64] {
        &point.variables
    }

    fn n_controls(&self) -> usize {
        self.n_controls
    }

    /// Returns the gradient of effort, rate and penalties of soft residuals.
    fn own_gradient(&self, point: &LiftedPoint) -> Option<Vec<f64>> {
        Some(self.control_cost.value(&point.variables).1)
    }

    fn softness(&self, row: usize) -> Softness {
        let PathRow {
            constraint, time, ..
        } = self.path_row(row);
        let duration = self.path_durations[constraint][time];
        self.path[constraint].enforcement.softness(duration)
    }

    fn group(&self, row: usize) -> usize {
        self.path_row(row).constraint
    }

    fn screening_margin(&self) -> f64 {
        SCREENING_MARGIN
    }

    fn evaluate(&self, point: &LiftedPoint) -> Result<Evaluation<Defects>, Failure> {
        let last = self.problem.grid.n_steps;
        if let Some(goal) = (self.problem.goals.iter()).find(|g| g.at_rest && g.time_node != last) {
            return Err(Failure(format!(
                "{}.at_rest at time node {} of {last}: only a goal at the end of the horizon can be at rest",
                goal.name, goal.time_node
            )));
        }
        let control = self.signal(&point.variables);
        let motion = self.problem.motion();
        let found = defects(&motion, &point.trajectory, &control).map_err(describe)?;
        let residuals = self.goal_values(&point.trajectory, &found);
        let (control_cost, _) = self.control_cost.value(&point.variables);
        let state_cost: f64 = (self.state_costs(point).iter())
            .map(|row| 0.5 * row.residual * row.residual)
            .sum();
        let objective = control_cost + state_cost;
        let constraints = self.less_slacks(residuals, &point.variables);
        let inequalities = self.path_values(point);
        if !objective.is_finite() {
            return Err(Failure(
                "the objective is not finite; check its weights and scales".into(),
            ));
        }
        if let Some(row) = constraints.iter().position(|c| !c.is_finite()) {
            let GoalRow { goal, part, .. } = self.goal_rows[row];
            return Err(Failure(format!(
                "{}.{} is not finite; check it and the objective's scales",
                self.problem.goals[goal].name,
                part.name()
            )));
        }
        if let Some(row) = inequalities.iter().position(|h| !h.is_finite()) {
            let (constraint, k, item) = self.located(row);
            return Err(Failure(format!(
                "{} is not finite at node {}, time node {k}",
                constraint.name,
                constraint.limit.node(&self.problem.rod, item)
            )));
        }
        // Impulses are divided by the impulse of the rod's force scale over its time scale.
        let scales = &self.problem.rod.scales;
        let sum = |rows: &[Vector3<f64>]| rows.iter().map(Vector3::norm).sum::<f64>();
        let defect = sum(&found.linear) / (scales.force * scales.time)
            + sum(&found.angular) / (scales.moment * scales.time);
        Ok(Evaluation {
            objective,
            constraints,
            inequalities,
            defect,
            defects: found,
        })
    }

    fn linearize(
        &self,
        point: &LiftedPoint,
        evaluation: &Evaluation<Defects>,
        request: &LinearizationRequest,
    ) -> Result<Linearization, Failure> {
        let costates = (request.multipliers)
            .map(|multipliers| self.costates(point, &self.state_costs(point), multipliers))
            .transpose()?;
        self.linearize_by(point, evaluation, request, costates.as_ref())
    }

    /// Computes the terms by one adjoint sweep.
    fn lagrangian_terms(
        &self,
        point: &LiftedPoint,
        _: &Evaluation<Defects>,
        multipliers: &Multipliers,
    ) -> Result<LagrangianTerms<AdjointSweep>, Failure> {
        let costs = self.state_costs(point);
        let costates = self.costates(point, &costs, multipliers)?;
        Ok(LagrangianTerms {
            own: self.control_cost.value(&point.variables).1,
            through_states: self.through_states(point, &costates, multipliers),
            least_curvature: None,
            costates: Some(costates),
        })
    }

    fn linearize_with(
        &self,
        point: &LiftedPoint,
        evaluation: &Evaluation<Defects>,
        request: &LinearizationRequest,
        costates: AdjointSweep,
    ) -> Result<Linearization, Failure> {
        self.linearize_by(point, evaluation, request, Some(&costates))
    }

    fn n_states(&self) -> Option<usize> {
        // A relaxed program is solved too rarely to keep its states.
        self.relaxation.is_none().then(|| self.problem.n_states())?
    }

    fn keep_states(
        &self,
        point: &LiftedPoint,
        rows: &[usize],
    ) -> Result<Option<StateLinearization>, Failure> {
        let trajectory = &point.trajectory;
        if !self.problem.acting.is_empty() || self.relaxation.is_some() || self.depends_on_inputs()
        {
            return Ok(None);
        }
        let motion = self.problem.motion();
        let Some(motion) = SparseMotion::along(&motion, trajectory).map_err(describe)? else {
            return Ok(None);
        };
        let columns = self.columns_by_time();
        let add = |row: &mut StateRow, part: MotionRow| {
            row.states.extend(part.states);
            for wrench in part.wrenches {
                let acting = (columns[wrench.time_node].iter())
                    .filter(|c| (c.node, c.component) == (wrench.node, wrench.component));
                let terms = acting.map(|c| (c.column, c.weight * wrench.coefficient));
                row.variables.extend(terms);
            }
        };
        let of_forms = |gradient: RowGradient| {
            let mut row = StateRow::default();
            for form in &gradient {
                add(&mut row, motion.form(form));
            }
            row
        };
        let rod_view = self.rod_view(point);
        Ok(Some(StateLinearization {
            n_states: self.n_states().unwrap_or(0),
            equations: (motion.equations().into_iter())
                .map(|equation| {
                    let mut row = StateRow::default();
                    add(&mut row, equation);
                    row
                })
                .collect(),
            constraints: (self.goal_gradients(trajectory).into_iter())
                .zip(self.slack_variables.iter().zip(&self.slack_units))
                .map(|(gradient, (soft, unit))| {
                    let mut row = of_forms(gradient);
                    row.variables.extend(soft.map(|variable| (variable, -unit)));
                    row
                })
                .collect(),
            inequalities: (rows.iter())
                .map(|&row| of_forms(self.path_gradient(&rod_view, row)))
                .collect(),
            residuals: (self.state_costs(point).into_iter())
                .map(|cost| of_forms(cost.gradient))
                .collect(),
            hessian: self.control_cost.hessian().clone(),
        }))
    }

    fn predict_inequalities(
        &self,
        point: &LiftedPoint,
        evaluation: &Evaluation<Defects>,
        direction: &LiftedDirection,
    ) -> Result<Vec<f64>, Failure> {
        let rod_view = self.rod_view(point);
        let n_nodes = self.problem.rod.n_nodes();
        let moved = |form: &StateForm| form.along(&direction.trajectory, n_nodes);
        let furthest = (direction.trajectory.positions.iter())
            .map(Vector3::norm)
            .fold(0.0, f64::max);
        // A distance changes by no more than the largest displacement, so that most rows need no gradient.
        let is_out_of_reach = |row: usize, h: f64| {
            let limit = &self.located(row).0.limit;
            matches!(limit, PathLimit::Clearance { .. })
                && h + furthest / limit.scale(&self.problem.rod) < 0.0
        };
        let shortfall = self.shortfall(&direction.variables);
        let predict = |(row, &h): (usize, &f64)| {
            let h = h + self.relaxed_inequality(row) * shortfall;
            if is_out_of_reach(row, h) {
                return h;
            }
            let gradient = self.path_gradient(&rod_view, row);
            let own = self.path_columns(row);
            let own: f64 = own.map(|(i, slope)| slope * direction.variables[i]).sum();
            h + own + gradient.iter().map(moved).sum::<f64>()
        };
        Ok((evaluation.inequalities.iter().enumerate())
            .map(predict)
            .collect())
    }

    fn expand(
        &self,
        point: &LiftedPoint,
        defects: &Defects,
        change: &[f64],
    ) -> Result<LiftedDirection, Failure> {
        let mut control = self.signal(change);
        let acting = self.acting(point);
        if let Some(acting) = &acting {
            control = acting.change(&control);
        }
        let sources = RightHandSide::against(defects);
        let motion = Motion {
            control: acting.as_ref().map(|acting| &acting.signal),
            ..self.problem.motion()
        };
        let (trajectory, _) = direction(
            &motion,
            &point.trajectory,
            Some(&sources),
            &control,
            self.n_threads,
        )
        .map_err(describe)?;
        Ok(LiftedDirection {
            variables: change.to_vec(),
            trajectory,
        })
    }

    fn reset_slacks(&self, point: &mut LiftedPoint, evaluation: &mut Evaluation<Defects>) {
        self.reset(point, &mut evaluation.constraints);
    }

    fn absorbed(
        &self,
        point: &LiftedPoint,
        evaluation: &Evaluation<Defects>,
    ) -> Option<LiftedPoint> {
        self.with_soft_residuals(point, &evaluation.constraints)
    }

    fn retract(
        &self,
        point: &LiftedPoint,
        direction: &LiftedDirection,
        step_length: f64,
    ) -> LiftedPoint {
        LiftedPoint {
            variables: point
                .variables
                .iter()
                .zip(&direction.variables)
                .map(|(v, d)| v + step_length * d)
                .collect(),
            // A large step preserves the stiff strains; a small one need not and has less rounding.
            // Strains that change linearly would carry a held tip away.
            trajectory: if direction.trajectory.largest_rotation() > SMALL_TURN
                && self.problem.rod.has_free_tip()
            {
                point
                    .trajectory
                    .retract_strains(&direction.trajectory, step_length, self.n_threads)
            } else {
                point.trajectory.retract(&direction.trajectory, step_length)
            },
        }
    }

    fn longest_step(&self, direction: &LiftedDirection) -> f64 {
        LARGEST_TURN / direction.trajectory.largest_rotation()
    }

    fn rollout(&self, point: &LiftedPoint, change: &[f64]) -> Result<LiftedPoint, Failure> {
        let variables: Vec<f64> = point
            .variables
            .iter()
            .zip(change)
            .map(|(v, d)| v + d)
            .collect();
        let control = self.signal(&variables);
        let trajectory = simulate(self.problem, self.problem.grid, &control).map_err(describe)?;
        Ok(LiftedPoint {
            variables,
            trajectory,
        })
    }
}
