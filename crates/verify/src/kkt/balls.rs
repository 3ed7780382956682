//! The conditions of goals within a tolerance: the multiplier of a residual in a ball points along the residual at the edge and vanishes
//! inside.

use nalgebra::{DVector, Vector3};

use super::controls::outward_pull;
use super::motion::Conditions;
use super::rows::{Place, Worst, per};
use crate::stay;
use control::{GoalPart, GoalRow};

/// A vector of a goal with a tolerance.
pub(crate) struct GoalBall {
    /// Index of its first component among the rows of the goals.
    pub(crate) first: usize,
    goal: usize,
    part: GoalPart,
    /// Largest scaled residual.
    pub(crate) radius: f64,
    /// Scaled residual `r`.
    pub residual: DVector<f64>,
    /// Multiplier `y` of `r = s` with `s` in the ball.
    pub(crate) multiplier: DVector<f64>,
}

/// Residuals of the conditions of a ball: `|r| ≤ ρ`, `y` along `r` and outward, and zero within the ball.
#[derive(Default)]
pub(super) struct BallConditions {
    pub(super) violation: Worst,
    pub(super) stationarity: Worst,
    pub(super) complementarity: Worst,
}

impl Conditions<'_> {
    /// Returns the goals within a tolerance, from the scaled residuals and multipliers of all goals.
    pub(crate) fn goal_balls(&self, residuals: &[f64], multipliers: &[f64]) -> Vec<GoalBall> {
        let rows = self.problem.goal_rows();
        let mut first = 0;
        let mut out = Vec::new();
        for rows in rows.chunk_by(GoalRow::shares_vector_with) {
            let range = first..first + rows.len();
            first = range.end;
            let GoalRow { goal, part, .. } = rows[0];
            let (Some(radius), Some(residual), Some(multiplier)) = (
                self.problem.goal_radius(goal, part),
                residuals.get(range.clone()),
                multipliers.get(range.clone()),
            ) else {
                continue;
            };
            out.push(GoalBall {
                first: range.start,
                goal,
                part,
                radius,
                residual: DVector::from_column_slice(residual),
                multiplier: DVector::from_column_slice(multiplier),
            });
        }
        out
    }

    pub(super) fn ball_conditions(&self, residuals: &[f64], multipliers: &[f64]) -> BallConditions {
        let mut out = BallConditions::default();
        for ball in self.goal_balls(residuals, multipliers) {
            let scale = self.problem.goal_scale(ball.part);
            let goal = &self.problem.goals[ball.goal];
            let place = |value: f64, unit: String| Place {
                name: format!("{}.{}", goal.name, goal.name_of(ball.part)),
                node: Some(goal.node),
                time: self.problem.grid.time(goal.time_node),
                component: "",
                value,
                unit,
            };
            let size = ball.residual.norm();
            let over = size - ball.radius;
            out.violation
                .note(over, || place(over * scale, ball.part.unit().into()));
            let against = -&ball.multiplier;
            let pull = outward_pull(ball.radius, against.as_slice(), ball.residual.as_slice());
            let outward = if pull > 0.0 { pull / size } else { 0.0 };
            let rest = (&ball.residual * outward + against).amax();
            (out.stationarity).note(rest, || place(rest / scale, per(ball.part.unit())));
            let gap = pull * over.abs();
            (out.complementarity).note(gap, || place(gap, String::new()));
        }
        out
    }

    /// Returns the derivative of `Σ y·r` with respect to the state at the end of the horizon, for the deviation from a stay; `None` if the
    /// arm need not stay.
    pub(super) fn stay_covectors(&self, goals: &[f64]) -> Option<(usize, stay::Covectors)> {
        let stay = self.problem.stay.as_ref()?;
        let first = self.problem.goal_rows().len() - 3 * stay.n_vectors();
        let scale = self.problem.goal_scale(GoalPart::Deviation(0));
        let y: Vec<_> = (goals.get(first..)?.chunks_exact(3))
            .map(|y| Vector3::from_row_slice(y) / scale)
            .collect();
        if y.len() != stay.n_vectors() {
            return None;
        }
        let k = self.problem.goals[stay.goal].time_node;
        Some((
            k,
            stay::covectors(stay, &y, self.trajectory.rotations_at(k)),
        ))
    }
}
