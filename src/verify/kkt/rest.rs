//! Rest within a tolerance: the multiplier of a velocity in a ball points along the velocity at the edge and vanishes inside.

use nalgebra::Vector3;

use super::controls::normal_cone;
use super::motion::Conditions;
use super::rows::{Place, Worst, per};
use crate::control::{Bound, GoalPart};

/// The velocity, or angular velocity, of a goal that may be at rest within a tolerance.
pub(in crate::verify) struct RestBall {
    /// Index of its first component among the rows of the goals.
    pub(in crate::verify) first: usize,
    goal: usize,
    part: GoalPart,
    /// Largest scaled residual.
    pub(in crate::verify) radius: f64,
    /// Scaled residual `r`.
    pub(in crate::verify) residual: Vector3<f64>,
    /// Multiplier `y` of `r = s` with `s` in the ball.
    pub(in crate::verify) multiplier: Vector3<f64>,
}

/// What is left of the conditions of rest: `|r| ≤ ρ`, `y` along `r` and outward, and none within the ball.
#[derive(Default)]
pub(super) struct RestConditions {
    pub(super) violation: Worst,
    pub(super) stationarity: Worst,
    pub(super) complementarity: Worst,
}

impl Conditions<'_> {
    /// The goals that may be at rest within a tolerance, from the scaled residuals and multipliers of all goals.
    pub(in crate::verify) fn rest_balls(
        &self,
        residuals: &[f64],
        multipliers: &[f64],
    ) -> Vec<RestBall> {
        let rows = self.problem.goal_rows();
        (rows.iter().enumerate())
            .filter(|(_, row)| row.axis == 0)
            .filter_map(|(first, row)| {
                Some(RestBall {
                    first,
                    goal: row.goal,
                    part: row.part,
                    radius: self.problem.rest_radius(row.goal, row.part)?,
                    residual: Vector3::from_row_slice(residuals.get(first..first + 3)?),
                    multiplier: Vector3::from_row_slice(multipliers.get(first..first + 3)?),
                })
            })
            .collect()
    }

    pub(super) fn rest_conditions(&self, residuals: &[f64], multipliers: &[f64]) -> RestConditions {
        let mut out = RestConditions::default();
        for ball in self.rest_balls(residuals, multipliers) {
            let scale = self.problem.goal_scale(ball.part);
            let goal = &self.problem.goals[ball.goal];
            let place = |value: f64, unit: String| Place {
                name: format!("{}.{}", goal.name, ball.part.name()),
                node: goal.node,
                time: self.problem.grid.time(goal.time_node),
                component: "",
                value,
                unit,
            };
            let over = ball.residual.norm() - ball.radius;
            out.violation
                .note(over, || place(over * scale, ball.part.unit().into()));
            let bound = Some(Bound::Norm(ball.radius));
            let (rest, gap, _) = normal_cone(&bound, &-ball.multiplier, &ball.residual, 1.0);
            out.stationarity.note(rest.amax(), || {
                place(rest.amax() / scale, per(ball.part.unit()))
            });
            out.complementarity.note(gap, || place(gap, String::new()));
        }
        out
    }
}
