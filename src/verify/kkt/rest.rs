//! Residuals of goals in a ball (rest within a tolerance, the deviation from where the arm stays): the multiplier points along the residual
//! at the edge and vanishes inside.

use std::ops::Range;

use nalgebra::{DVector, Vector3};

use super::controls::cone_of_ball;
use super::motion::Conditions;
use super::rows::{Place, Worst, per};
use crate::control::{GoalPart, STAY_VECTORS};
use crate::verify::stay;

/// The residual of a goal that may lie within a tolerance.
pub(in crate::verify) struct RestBall {
    /// Its components among the rows of the goals.
    pub(in crate::verify) rows: Range<usize>,
    goal: usize,
    part: GoalPart,
    /// Largest scaled residual.
    pub(in crate::verify) radius: f64,
    /// Scaled residual `r`.
    pub(in crate::verify) residual: DVector<f64>,
    /// Multiplier `y` of `r = s` with `s` in the ball.
    pub(in crate::verify) multiplier: DVector<f64>,
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
        (self.problem.goal_balls(&rows).into_iter())
            .filter_map(|(range, radius)| {
                let row = &rows[range.start];
                Some(RestBall {
                    goal: row.goal,
                    part: row.part,
                    radius,
                    residual: DVector::from_row_slice(residuals.get(range.clone())?),
                    multiplier: DVector::from_row_slice(multipliers.get(range.clone())?),
                    rows: range,
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
            let (rest, gap) = cone_of_ball(ball.radius, &-&ball.multiplier, &ball.residual);
            out.stationarity.note(rest.amax(), || {
                place(rest.amax() / scale, per(ball.part.unit()))
            });
            out.complementarity.note(gap, || place(gap, String::new()));
        }
        out
    }

    /// Derivative of `Σ y·r` over the state at the end of the horizon, of the deviation from where the arm stays; `None` where it need not
    /// stay.
    pub(super) fn stay_covectors(&self, goals: &[f64]) -> Option<(usize, stay::Covectors)> {
        let stay = self.problem.stay.as_ref()?;
        let first = self.problem.goal_rows().len() - 3 * stay.n_vectors();
        let scale = self.problem.goal_scale(GoalPart::Deviation(0));
        let y: Vec<_> = (goals.get(first..)?.chunks_exact(3))
            .map(|y| Vector3::from_row_slice(y) / scale)
            .collect();
        if y.len() != STAY_VECTORS * stay.n_nodes() {
            return None;
        }
        let k = self.problem.goals[stay.goal].time_node;
        Some((
            k,
            stay::covectors(stay, &y, self.trajectory.rotations_at(k)),
        ))
    }
}
