//! The derivative along a free duration: how rows, costs and the Lagrangian change when the time step becomes longer.

use faer::Mat;

use super::cost::CostRow;
use super::path::RodView;
use super::transcription::{LiftedDirection, LiftedPoint, Transcription, describe};
use crate::mechanics::differences;
use crate::mechanics::linearization::RightHandSide;
use crate::mechanics::sensitivity::direction;
use crate::mechanics::step_derivative::step_right_hand_side;
use crate::sqp::{Failure, LiftedProgram as _, Linearization, Multipliers};

/// Rotation, and displacement over the length, of the differences that measure how the Lagrangian bends with the duration.
const PROBE: f64 = 3e-4;

impl Transcription<'_> {
    /// Column of a variable among those that move the states: controls, then the duration; `None` of residuals of soft goals.
    pub(super) fn driven(&self, variable: usize) -> Option<usize> {
        if variable < self.n_controls {
            Some(variable)
        } else {
            (self.duration_variable == Some(variable)).then_some(self.n_controls)
        }
    }

    /// The right-hand side of the linearized motion along the duration's variable, where there is one.
    pub(super) fn duration_right_hand_side(
        &self,
        point: &LiftedPoint,
    ) -> Result<Option<RightHandSide>, Failure> {
        let Some(at) = self.duration_variable else {
            return Ok(None);
        };
        let control = self.signal(&point.variables);
        let motion = self.motion(&point.variables);
        let mut sources =
            step_right_hand_side(&motion, &point.trajectory, &control).map_err(describe)?;
        // From the logarithm of the step to the step over the grid's.
        let inverse = 1.0 / point.variables[at];
        for part in [
            &mut sources.linear,
            &mut sources.angular,
            &mut sources.terminal_linear,
            &mut sources.terminal_angular,
        ] {
            part.iter_mut().for_each(|v| *v *= inverse);
        }
        Ok(Some(sources))
    }

    /// Derivative of a path row along the duration's variable, while the configurations stay.
    pub(super) fn path_slope(&self, point: &LiftedPoint, rod_view: &RodView, row: usize) -> f64 {
        let (constraint, k, _) = self.located(row);
        constraint.limit.step_slope(rod_view, k) / self.problem().time_scale(&point.variables)
    }

    /// Derivative of a cost's residual along the duration's variable, while the configurations stay.
    pub(super) fn cost_slope(&self, point: &LiftedPoint, row: &CostRow) -> f64 {
        (0.5 * row.residual - row.reference_drift) / self.problem().time_scale(&point.variables)
    }

    /// Values of the rows (goals, path rows, costs) along the controls, and along the duration as their last column.
    pub(super) fn along_driven(
        &self,
        point: &LiftedPoint,
        path_rows: &[usize],
        costs: &[CostRow],
        values: Mat<f64>,
        responses: &Mat<f64>,
    ) -> Mat<f64> {
        if self.duration_variable.is_none() {
            return values;
        }
        let rod_view = self.rod_view(point);
        let n_goals = self.goal_rows().len();
        let first_cost = n_goals + path_rows.len();
        let explicit = |row: usize| {
            if row < n_goals {
                0.0
            } else if let Some(&path) = path_rows.get(row - n_goals) {
                self.path_slope(point, &rod_view, path)
            } else {
                (costs.get(row - first_cost)).map_or(0.0, |cost| self.cost_slope(point, cost))
            }
        };
        let last = values.ncols();
        Mat::from_fn(values.nrows(), last + 1, |i, j| {
            if j < last {
                values[(i, j)]
            } else {
                responses[(i, 1)] + explicit(i)
            }
        })
    }

    /// Adds what the duration bends to the curvature: the change of the Lagrangian's gradient along it, by differences of fourth order
    /// of adjoints, whose motions obey their equations to second order where this one does.
    pub(super) fn bend_duration(
        &self,
        point: &LiftedPoint,
        multipliers: &Multipliers,
        along_duration: &RightHandSide,
        linearization: &mut Linearization,
    ) -> Result<(), Failure> {
        let (Some(at), Some(curvature)) =
            (self.duration_variable, linearization.curvature.as_mut())
        else {
            return Ok(());
        };
        // The direction in which the duration's variable grows by 1 and the motion follows.
        let mut variables = vec![0.0; point.variables.len()];
        let none = self.signal(&variables);
        variables[at] = 1.0;
        let motion = self.motion(&point.variables);
        let (trajectory, _) = direction(
            &motion,
            &point.trajectory,
            Some(along_duration),
            &none,
            self.n_threads,
        )
        .map_err(describe)?;
        let along = LiftedDirection {
            variables,
            trajectory,
        };
        let furthest = (along.trajectory.positions.iter())
            .map(|v| v.norm() / self.problem().rod.scales.length)
            .fold(along.trajectory.largest_rotation(), f64::max);
        let step = PROBE / furthest.max(1.0);
        let gradient = |step: f64| {
            let moved = self.retract(point, &along, step);
            self.lagrangian_gradient(&moved, multipliers)
        };
        let (plus, minus) = (gradient(step)?, gradient(-step)?);
        let (plus_far, minus_far) = (gradient(2.0 * step)?, gradient(-2.0 * step)?);
        for i in 0..plus.len() {
            let far = [plus_far[i], minus_far[i]];
            let exact = differences::slope([plus[i], minus[i]], far, step);
            let bent = exact - linearization.gauss_newton[(i, at)];
            curvature[(i, at)] = bent;
            curvature[(at, i)] = bent;
        }
        Ok(())
    }
}
