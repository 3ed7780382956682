//! The distance of a motion from the paths that it should follow.

use super::problem::OptimalControlProblem;
use crate::mechanics::Trajectory;

/// Distances of a node from where it should be.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct TrackingError {
    /// The node.
    pub node: usize,
    /// `sqrt(1/T ∫ |x - x*|² dt)` over the time `T` in which the distance counts, by the trapezoidal rule over its time nodes, m; 0 where it
    /// never counts.
    pub rms_m: f64,
    /// Largest at any time node at which it counts, m; NaN if any is.
    pub max_m: f64,
    /// Time of the largest, s.
    pub max_at_s: f64,
}

/// The error of every path that the objective wants to be followed, in their order.
#[must_use]
pub fn tracking_errors(
    problem: &OptimalControlProblem,
    trajectory: &Trajectory,
) -> Vec<TrackingError> {
    let grid = problem.grid;
    let of = |tracking: &super::Tracking| {
        let first = (0..=grid.n_steps).find(|&k| tracking.counts(grid.time(k)));
        // It counts to the end, or never.
        let first = first.unwrap_or(grid.n_steps + 1);
        let (mut sum, mut max_m, mut at) = (0.0, 0.0, first.min(grid.n_steps));
        for k in first..=grid.n_steps {
            let should = tracking.position(grid.time(k));
            let off = (trajectory.positions_at(k)[tracking.node] - should).norm();
            let is_end = k == first || k == grid.n_steps;
            sum += off * off * if is_end { 0.5 } else { 1.0 };
            if !(off <= max_m) && !f64::is_nan(max_m) {
                (max_m, at) = (off, k);
            }
        }
        TrackingError {
            node: tracking.node,
            rms_m: (sum / grid.n_steps.saturating_sub(first).max(1) as f64).sqrt(),
            max_m,
            max_at_s: grid.time(at),
        }
    };
    problem.objective.tracking.iter().map(of).collect()
}

/// In words, for the terminal and the report.
impl std::fmt::Display for TrackingError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{:.3e} m rms, at most {:.3e} m (t = {:.4} s)",
            self.rms_m, self.max_m, self.max_at_s
        )
    }
}
