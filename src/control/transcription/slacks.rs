//! Variables that stand for the residuals of rest within a tolerance.

use super::{LiftedPoint, Transcription};
use crate::sqp::norm;

/// A vector that is shorter than a radius by no more than this part is on the surface of its ball.
const ON_SURFACE: f64 = 1e-6;

impl Transcription<'_> {
    /// Moves the variables of rest within a tolerance to where their constraints are violated least.
    pub(super) fn reset(&self, point: &mut LiftedPoint, constraints: &mut [f64]) {
        for (range, radius) in self.problem.goal_balls(&self.goal_rows) {
            let slacks: Vec<usize> = (self.slack_variables[range.clone()].iter().flatten())
                .copied()
                .collect();
            let constraints = &mut constraints[range];
            let residuals: Vec<f64> = (slacks.iter().zip(&*constraints))
                .map(|(&slack, c)| c + point.variables[slack])
                .collect();
            // The nearest point of the ball, or of its surface where the step has put it there: in the residual's own direction, which so is
            // that of its multiplier's normal.
            let step: Vec<f64> = slacks.iter().map(|&slack| point.variables[slack]).collect();
            let part = radius / norm(&residuals);
            let is_held = norm(&step) >= (1.0 - ON_SURFACE) * radius;
            let factor = if is_held { part } else { part.min(1.0) };
            let nearest: Vec<f64> = residuals.iter().map(|r| r * factor).collect();
            if !nearest.iter().all(|r| r.is_finite()) {
                continue;
            }
            for (i, (&slack, c)) in slacks.iter().zip(constraints).enumerate() {
                point.variables[slack] = nearest[i];
                *c = residuals[i] - nearest[i];
            }
        }
    }
}
