//! The discrete goals of targets, and whether they leave room for each other.

use nalgebra::{Matrix3, Vector3};

use super::arm::Arm;
use super::definition::{Hardness, Rest, Target, Task};
use super::discretize::START_TOLERANCE;
use super::error::{DiscretizeError, Obstruction};
use control::{Enforcement, Goal, GoalPart, OptimalControlProblem, PathEnforcement, PathLimit};
use mechanics::rotation::log;
use mechanics::{Rod, TimeGrid};

/// Weight of a soft goal, divided by that of a track that holds its place for the horizon: the goal is missed by ten times as much.
const OF_A_TRACK: f64 = 0.1;

impl Task {
    /// Returns the discrete goals of a target. The parts with a tolerance become a goal of their own.
    ///
    /// Weights of tracks count per second; times the horizon, they give the default weight of a soft goal.
    pub(super) fn goals(
        &self,
        target: &Target,
        arm: &Arm,
        rod: &Rod,
        grid: &TimeGrid,
        default_weights: [f64; 2],
    ) -> Vec<Goal> {
        let time_node = target.time.map_or(grid.n_steps, |time| {
            ((time / grid.step).round() as usize).clamp(1, grid.n_steps)
        });
        let exact = Goal {
            name: target.name.clone(),
            node: target.at.node(&rod.mesh),
            time_node,
            position: target.position,
            rotation: target.rotation,
            direction: target.direction,
            at_rest: target.rest == Rest::Instant,
            velocity: target.velocity,
            enforcement: match target.hardness {
                Hardness::Hard => Enforcement::Hard,
                Hardness::Soft { weight } => Enforcement::Soft {
                    weight: weight.unwrap_or_else(|| {
                        let [place, turn] =
                            default_weights.map(|weight| OF_A_TRACK * weight * self.horizon);
                        if target.position.is_some() {
                            place
                        } else {
                            turn
                        }
                    }),
                },
            },
        };
        if target.hardness != Hardness::Hard {
            return vec![exact];
        }
        let tolerances = &target.tolerances;
        let [speed, spin] = if exact.sees_velocity() {
            tolerances.rest(arm.length, self.horizon)
        } else {
            [0.0; 2]
        };
        with_tolerances(exact, tolerances.distance, tolerances.angle, [speed, spin])
    }
}

/// Splits a goal into goals with tolerances. `distance` and `angle` are met exactly if they are `None`, and the velocities if their
/// tolerances are zero.
fn with_tolerances(
    goal: Goal,
    distance: Option<f64>,
    angle: Option<f64>,
    [speed, spin]: [f64; 2],
) -> Vec<Goal> {
    let mut exact = goal.clone();
    let mut near = Goal {
        position: None,
        rotation: None,
        direction: None,
        at_rest: false,
        velocity: None,
        enforcement: Enforcement::Within {
            distance: distance.unwrap_or(0.0),
            angle: angle.unwrap_or(0.0),
            speed,
            spin,
        },
        ..goal
    };
    if distance.is_some() {
        near.position = exact.position.take();
    }
    if angle.is_some() {
        near.rotation = exact.rotation.take();
        near.direction = exact.direction.take();
    }
    if speed > 0.0 || spin > 0.0 {
        near.at_rest = std::mem::take(&mut exact.at_rest);
        near.velocity = exact.velocity.take();
    }
    [near, exact]
        .into_iter()
        .filter(|goal| !goal.parts().is_empty())
        .collect()
}

/// Refuses hard goals that leave no room for each other, for the obstacles, or for the condition at the base.
pub(super) fn check_goals(problem: &OptimalControlProblem) -> Result<(), DiscretizeError> {
    let rod = &problem.rod;
    let rounding = START_TOLERANCE * rod.scales.length;
    let hard: Vec<(&Goal, [f64; 2])> = (problem.goals.iter())
        .filter_map(|goal| match goal.enforcement {
            Enforcement::Hard => Some((goal, [rounding, START_TOLERANCE])),
            Enforcement::Within {
                distance, angle, ..
            } => Some((goal, [distance, angle])),
            Enforcement::Soft { .. } => None,
        })
        .collect();
    for (at, &(goal, [distance, angle])) in hard.iter().enumerate() {
        let time = problem.grid.time(goal.time_node);
        let refuse = |part: GoalPart, amount: f64, why: String, with: Obstruction| {
            Err(DiscretizeError::GoalConflict {
                goal: goal.name.clone(),
                part,
                amount,
                why,
                time,
                with,
            })
        };
        for &(other, [other_distance, other_angle]) in &hard[..at] {
            if (goal.node, goal.time_node) != (other.node, other.time_node) {
                continue;
            }
            let why = format!(
                "away from where {} has node {} at the same step",
                other.name, goal.node
            );
            let off = separation(&goal.position, &other.position);
            if off > distance + other_distance {
                return refuse(GoalPart::Position, off, why, Obstruction::Goal);
            }
            let off = turn(&goal.rotation, &other.rotation);
            if off > angle + other_angle {
                return refuse(GoalPart::Orientation, off, why, Obstruction::Goal);
            }
            let off = axis(goal).zip(axis(other)).map_or(0.0, between);
            if off > angle + other_angle {
                return refuse(GoalPart::Direction, off, why, Obstruction::Goal);
            }
        }
        let joint = rod.joint(goal.node);
        if goal.node < rod.first_free_node() || joint.is_some() {
            let (position, rotation) = match rod.driven_end(goal.node, time) {
                Some(end) => (end.position, end.rotation),
                None => {
                    let start = &problem.initial.configuration;
                    (start.positions[goal.node], start.rotations[goal.node])
                }
            };
            let why = format!("away from where node {} is held", goal.node);
            let off = separation(&goal.position, &Some(position));
            if off > distance {
                return refuse(GoalPart::Position, off, why, Obstruction::Base);
            }
            let off = turn(&goal.rotation, &Some(rotation));
            let is_turned = joint.is_none_or(|joint| !joint.turns());
            if off > angle && is_turned {
                return refuse(GoalPart::Orientation, off, why, Obstruction::Base);
            }
            let held = rotation.column(2).into_owned();
            let off = goal.direction.map_or(0.0, |to| between((to, held)));
            if off > angle && is_turned {
                return refuse(GoalPart::Direction, off, why, Obstruction::Base);
            }
        }
        let Some(position) = &goal.position else {
            continue;
        };
        let radius = problem.radii.get(goal.node).copied().unwrap_or(0.0);
        for constraint in &problem.path {
            if let PathLimit::Clearance {
                shape,
                velocity,
                margin,
                ..
            } = &constraint.limit
                && constraint.enforcement == PathEnforcement::Hard
            {
                let seen = position - velocity * problem.grid.time(goal.time_node);
                let depth = radius + margin - shape.distance(&seen).value;
                if depth > distance {
                    let why = format!(
                        "too near to \"{}\" for node {}, whose radius is {radius:.3e} m",
                        constraint.name, goal.node
                    );
                    return refuse(GoalPart::Position, depth, why, Obstruction::Obstacle);
                }
            }
        }
    }
    Ok(())
}

/// Returns the distance between two places, m; 0 if one of them is not given.
fn separation(a: &Option<Vector3<f64>>, b: &Option<Vector3<f64>>) -> f64 {
    a.zip(*b).map_or(0.0, |(a, b)| (a - b).norm())
}

/// Returns the angle between two orientations, rad; 0 if one of them is not given.
fn turn(a: &Option<Matrix3<f64>>, b: &Option<Matrix3<f64>>) -> f64 {
    a.zip(*b)
        .map_or(0.0, |(a, b)| log(&(a.transpose() * b)).norm())
}

/// Returns the direction of the axis that a goal asks for.
fn axis(goal: &Goal) -> Option<Vector3<f64>> {
    let of_rotation = goal
        .rotation
        .map(|rotation| rotation.column(2).into_owned());
    goal.direction.or(of_rotation)
}

/// Returns the angle between two directions of length 1, rad.
fn between((a, b): (Vector3<f64>, Vector3<f64>)) -> f64 {
    a.cross(&b).norm().atan2(a.dot(&b))
}
