//! Variables that stand for the residuals of goals within a tolerance, and their reset.

use super::{LiftedPoint, Transcription};
use crate::problem::GoalRow;
use sqp::norm;

/// A vector is on the surface of its ball if it is shorter than the radius by no more than this fraction, the default tolerance of a solve:
/// Newton's method on the active conditions leaves less, an interior point as much. Goals within tolerances are met alike, to the bit, with
/// half and with twice the value.
const ON_SURFACE: f64 = 1e-6;

impl Transcription<'_> {
    /// Returns the point whose variables of soft goals are the residuals of these goals; `None` if there are none, or they are already.
    pub(super) fn with_soft_residuals(
        &self,
        point: &LiftedPoint,
        constraints: &[f64],
    ) -> Option<LiftedPoint> {
        let mut out: Option<LiftedPoint> = None;
        for (i, row) in self.goal_rows.iter().enumerate() {
            let off = constraints[i] / self.slack_units[i];
            let variable = self.slack_variables[i].filter(|_| off != 0.0);
            if let (Some(variable), Some(_)) = (variable, self.problem.soft_weight(row)) {
                out.get_or_insert_with(|| point.clone()).variables[variable] += off;
            }
        }
        out
    }

    /// Moves the variables of goals within a tolerance to the place where their constraints are violated least.
    pub(super) fn reset(&self, point: &mut LiftedPoint, constraints: &mut [f64]) {
        let mut first = 0;
        for rows in self.goal_rows.chunk_by(GoalRow::shares_vector_with) {
            let range = first..first + rows.len();
            first = range.end;
            let Some(radius) = self.problem.goal_radius(rows[0].goal, rows[0].part) else {
                continue;
            };
            let slacks: Vec<usize> = (self.slack_variables[range.clone()].iter().flatten())
                .copied()
                .collect();
            let constraints = &mut constraints[range];
            let step: Vec<f64> = slacks.iter().map(|&i| point.variables[i]).collect();
            let residuals: Vec<f64> = (constraints.iter().zip(&step))
                .map(|(c, s)| c + s)
                .collect();
            // The new value is the nearest point of the ball, or of its surface if the step has put it there: in the direction of the
            // residual, which is then also that of the multiplier's normal.
            let part = radius / norm(&residuals);
            let is_held = norm(&step) >= (1.0 - ON_SURFACE) * radius;
            let part = if is_held { part } else { part.min(1.0) };
            let nearest: Vec<f64> = residuals.iter().map(|r| part * r).collect();
            if !nearest.iter().all(|r| r.is_finite()) {
                continue;
            }
            for (at, &slack) in slacks.iter().enumerate() {
                point.variables[slack] = nearest[at];
                constraints[at] = residuals[at] - nearest[at];
            }
        }
    }
}
