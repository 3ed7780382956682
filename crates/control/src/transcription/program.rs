//! The transcription as a [`LiftedProgram`].

use nalgebra::Vector3;

use super::{LiftedDirection, LiftedPoint, PathRow, Transcription, describe, simulate};
use crate::path::{PathLimit, RowGradient};
use crate::problem::GoalRow;
use mechanics::StateForm;
use mechanics::linearization::{AdjointSweep, Defects, Motion, RightHandSide};
use mechanics::sensitivity::{defects, direction};
use mechanics::sparse_motion::{MotionRow, SparseMotion};
use sqp::{
    ConvexSet, Evaluation, Failure, LagrangianTerms, LiftedProgram, Linearization,
    LinearizationRequest, Multipliers, Softness, StateLinearization, StateRow,
};
use stop::StopSignal;

/// Largest rotation of a node in one step of the solver, rad: half of the quarter turn up to which the rotation of a time step is unique,
/// as two neighboring nodes of a step may turn in opposite directions. `reach` is solved alike, to the bit, with half and with twice the
/// value.
const LARGEST_TURN: f64 = std::f64::consts::FRAC_PI_4;
/// Rotation of a node, rad, below which a step may stretch the rod, which it does by half the square of the rotation: 5e-7, below the
/// default tolerance of a solve. `reach` is solved alike, to the bit, with half and with twice the value.
const SMALL_TURN: f64 = 1e-3;
/// Rows of path constraints nearer to their limit than this (in lengths of the arm, radians, ...) enter the subproblem from the start.
/// Others join where a step violates them, so that the solution does not depend on it (`screening_changes_nothing` in the tests). Half and
/// twice the value change the iterations past a sphere, and the objective in the eleventh digit.
const SCREENING_MARGIN: f64 = 0.05;

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

    /// Those of the shares of tensions that friction leaves are not there.
    fn knows_curvature(&self) -> bool {
        !self.problem.rod.actuators.has_friction()
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
        if let Some(goal) =
            (self.problem.goals.iter()).find(|g| g.sees_velocity() && g.time_node != last)
        {
            return Err(Failure(format!(
                "{}.at_rest at time node {} of {last}: only a goal at the end of the horizon can be at rest or have a velocity",
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
