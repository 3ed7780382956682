//! Distances of a motion from the paths that it should follow.

use super::problem::OptimalControlProblem;
use super::tracking::Tracking;
use mechanics::Trajectory;

/// Distances of a node from its path, its orientations and its velocities; distances that no track asks for are absent.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct TrackingError {
    /// Index of the node.
    pub node: usize,
    /// `sqrt(1/T ∫ |x - x*|² dt)` over the time `T` in which the distance counts, by the trapezoidal rule over its time nodes, m; 0 if it
    /// never counts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rms_m: Option<f64>,
    /// Largest distance at the time nodes at which it counts, m; NaN if any is NaN.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_m: Option<f64>,
    /// Time of the largest distance, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_at_s: Option<f64>,
    /// `sqrt(1/T ∫ θ² dt)` with the angle from the orientation, `|log(R*ᵀ R)|`, or from the direction, rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rms_rad: Option<f64>,
    /// Largest of these angles, rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_rad: Option<f64>,
    /// Time of the largest angle, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_rad_at_s: Option<f64>,
    /// `sqrt(1/T ∫ |v - v*|² dt)` with mean velocities over steps, m/s; present if the objective has a weight on it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rms_m_s: Option<f64>,
    /// Largest of these differences, m/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_m_s: Option<f64>,
    /// Time at the end of the step of the largest difference, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_m_s_at_s: Option<f64>,
}

/// Returns the error of every track of the objective, in their order.
#[must_use]
pub fn tracking_errors(
    problem: &OptimalControlProblem,
    trajectory: &Trajectory,
) -> Vec<TrackingError> {
    let grid = problem.grid;
    let of = |tracking: &Tracking| {
        let node = tracking.node;
        let place = |k: usize| {
            let should = tracking.position(grid.time(k))?;
            Some((trajectory.positions_at(k)[node] - should).norm())
        };
        let turn = |k: usize| {
            let r = &trajectory.rotations_at(k)[node];
            tracking.angle(grid.time(k), r)
        };
        let speed = |k: usize| {
            (tracking.speed_weight > 0.0).then(|| {
                k.checked_sub(1).map_or(0.0, |before| {
                    let x = |k: usize| trajectory.positions_at(k)[node];
                    let should = tracking.velocity([before, k].map(|k| grid.time(k)));
                    ((x(k) - x(before)) / grid.step - should).norm()
                })
            })
        };
        let [rms_m, max_m, max_at_s] = sized(problem, tracking, place);
        let [rms_rad, max_rad, max_rad_at_s] = sized(problem, tracking, turn);
        let [rms_m_s, max_m_s, max_m_s_at_s] = sized(problem, tracking, speed);
        TrackingError {
            node,
            rms_m,
            max_m,
            max_at_s,
            rms_rad,
            max_rad,
            max_rad_at_s,
            rms_m_s,
            max_m_s,
            max_m_s_at_s,
        }
    };
    problem.objective.tracking.iter().map(of).collect()
}

/// Returns the root mean square and the largest of distances at time nodes, and the time of the largest.
fn sized(
    problem: &OptimalControlProblem,
    tracking: &Tracking,
    off: impl Fn(usize) -> Option<f64>,
) -> [Option<f64>; 3] {
    let grid = problem.grid;
    let first = (0..=grid.n_steps).find(|&k| tracking.counts(grid.time(k)));
    // A track counts until the end, or never.
    let first = first.unwrap_or(grid.n_steps + 1);
    let (mut sum, mut max, mut at) = (0.0, 0.0, first.min(grid.n_steps));
    for k in first..=grid.n_steps {
        let Some(off) = off(k) else {
            return [None; 3];
        };
        let is_end = k == first || k == grid.n_steps;
        sum += off * off * if is_end { 0.5 } else { 1.0 };
        if !(off <= max) && !f64::is_nan(max) {
            (max, at) = (off, k);
        }
    }
    let intervals = grid.n_steps.saturating_sub(first).max(1);
    [(sum / intervals as f64).sqrt(), max, grid.time(at)].map(Some)
}

/// Writes the distances in words, for the terminal and the report.
impl std::fmt::Display for TrackingError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut separator = "";
        for (sizes, unit) in [
            ([self.rms_m, self.max_m, self.max_at_s], "m"),
            ([self.rms_rad, self.max_rad, self.max_rad_at_s], "rad"),
            ([self.rms_m_s, self.max_m_s, self.max_m_s_at_s], "m/s"),
        ] {
            if let [Some(rms), Some(max), Some(at)] = sizes {
                write!(
                    f,
                    "{separator}{rms:.3e} {unit} rms, at most {max:.3e} {unit} (t = {at:.4} s)"
                )?;
                separator = "; ";
            }
        }
        Ok(())
    }
}
