//! Variables that stand for the residuals of rest within a tolerance.

use nalgebra::Vector3;

use super::{LiftedPoint, Transcription};

/// A vector that is shorter than a radius by no more than this part is on the surface of its ball.
const ON_SURFACE: f64 = 1e-6;

impl Transcription<'_> {
    /// Moves the variables of rest within a tolerance to where their constraints are violated least.
    pub(super) fn reset(&self, point: &mut LiftedPoint, constraints: &mut [f64]) {
        let goals = (self.goal_rows.chunks(3).zip(self.slack_variables.chunks(3)))
            .zip(constraints.chunks_mut(3));
        for ((rows, slacks), constraints) in goals {
            let Some(radius) = self.problem.rest_radius(rows[0].goal, rows[0].part) else {
                continue;
            };
            let slacks = || slacks.iter().flatten().copied();
            let residuals = Vector3::from_iterator(
                (slacks().zip(&*constraints)).map(|(slack, c)| c + point.variables[slack]),
            );
            // The nearest point of the ball, or of its surface where the step has put it there: in the residual's own direction, which so is
            // that of its multiplier's normal.
            let step = Vector3::from_iterator(slacks().map(|slack| point.variables[slack]));
            let part = radius / residuals.norm();
            let is_held = step.norm() >= (1.0 - ON_SURFACE) * radius;
            let nearest = residuals * if is_held { part } else { part.min(1.0) };
            if !nearest.iter().all(|r| r.is_finite()) {
                continue;
            }
            for (axis, (slack, c)) in slacks().zip(constraints).enumerate() {
                point.variables[slack] = nearest[axis];
                *c = residuals[axis] - nearest[axis];
            }
        }
    }
}
