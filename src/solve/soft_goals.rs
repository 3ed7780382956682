//! Distances of a motion from soft goals.

use crate::control::{Enforcement, OptimalControlProblem};
use crate::mechanics::Trajectory;
use crate::output::summary::SoftGoalSummary;

/// Computes the distance, m, and the angle, rad, of the node of every soft goal from the goal at its time.
pub(super) fn soft_goals(
    problem: &OptimalControlProblem,
    motion: &Trajectory,
) -> Vec<SoftGoalSummary> {
    (problem.goals.iter())
        .filter_map(|goal| {
            let Enforcement::Soft { weight } = goal.enforcement else {
                return None;
            };
            let k = goal.time_node;
            let position = goal.position.map(|to| {
                let from = motion.positions_at(k)[goal.node];
                (to - from).norm()
            });
            let angle = goal.angle(&motion.rotations_at(k)[goal.node]);
            Some(SoftGoalSummary {
                goal: goal.name.clone(),
                weight,
                left_m: position,
                left_rad: angle,
            })
        })
        .collect()
}
