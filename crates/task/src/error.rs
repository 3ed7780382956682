//! Errors of a discretization, by the continuous problem or by the requested numbers.

use super::arm::StartError;
use control::{DurationConflict, GoalPart};
use mechanics::RodError;

/// Reason why there is no discrete problem.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DiscretizeError {
    /// A number of the task or the discretization that is out of its range.
    #[error("{what}: {value} is not {expected}")]
    OutOfRange {
        /// The field of the arm, task or discretization.
        what: &'static str,
        /// The number.
        value: f64,
        /// The values that are allowed.
        expected: &'static str,
    },
    /// No rod can be built from the arm.
    #[error(transparent)]
    Rod(#[from] RodError),
    /// Stiffness and inertia are too far apart.
    #[error("the stable time step of this rod is {0}")]
    NoStableStep(f64),
    /// A step that explicit steps cannot take.
    #[error("{step} s is above the stable step of this rod, {limit:.4e} s")]
    UnstableStep {
        /// The step, s.
        step: f64,
        /// The stable one, s.
        limit: f64,
        /// The step that is chosen if none is given, s.
        automatic: f64,
    },
    /// The steps of the longest free duration are above the stable step.
    #[error(
        "{n_steps} steps of this duration, {longest:.4e} s each, are above the stable step of this rod, {limit:.4e} s"
    )]
    UnstableLongest {
        /// Steps of the horizon.
        n_steps: usize,
        /// The step of the longest duration, s.
        longest: f64,
        /// The stable one, s.
        limit: f64,
        /// A step of the horizon at which the longest one is stable, s.
        automatic: f64,
    },
    /// The horizon has too many steps.
    #[error("{n_steps:.3e} steps of {step:.3e} s are more than {most:e}")]
    TooManySteps {
        /// Number of steps.
        n_steps: f64,
        /// The time step, s.
        step: f64,
        /// The most there may be.
        most: f64,
    },
    /// A trajectory that does not fit in memory.
    #[error("{n_steps:.3e} steps of {step:.3e} s with {n_nodes} nodes do not fit in memory")]
    TooManyStates {
        /// Steps of the horizon.
        n_steps: f64,
        /// The time step, s.
        step: f64,
        /// Nodes of the rod.
        n_nodes: usize,
    },
    /// The rod has no state to start from.
    #[error(transparent)]
    Start(#[from] StartError),
    /// Nothing holds the arm at its target.
    #[error("{reason}")]
    NotHeld {
        /// The reason, in words.
        reason: String,
        /// The nearest place that was found to be held.
        nearest: Option<NearestHeld>,
    },
    /// More blocks than steps.
    #[error("{blocks} blocks do not fit into {n_steps} time steps")]
    TooManyBlocks {
        /// Blocks.
        blocks: usize,
        /// Steps.
        n_steps: usize,
    },
    /// A dense subproblem beyond reason.
    #[error("{blocks} blocks make {n_variables} variables, more than {most}")]
    TooManyVariables {
        /// Blocks.
        blocks: usize,
        /// Variables.
        n_variables: usize,
        /// The most there may be.
        most: usize,
    },
    /// The arm violates a hard limit at the start, where no control can act.
    #[error("at t = 0 the arm is {amount:.3e} {unit}{relation} \"{name}\" at {place} {node}")]
    ViolatedAtStart {
        /// Index among the task's limits.
        limit: usize,
        /// Its name.
        name: String,
        /// Size of the violation.
        amount: f64,
        /// Unit of the size, followed by a space unless it is empty.
        unit: String,
        /// The word "inside" or "beyond".
        relation: &'static str,
        /// The words for a node, or for the element from a node.
        place: &'static str,
        /// The node.
        node: usize,
    },
    /// A hard goal that leaves no room for something else.
    #[error("{amount:.3e} {} {why} (t = {time:.4e} s)", part.unit())]
    GoalConflict {
        /// Name of the goal.
        goal: String,
        /// The part of the goal.
        part: GoalPart,
        /// Size of the conflict, in the unit of `part`.
        amount: f64,
        /// The reason, with the place of the obstruction.
        why: String,
        /// Time of the goal, s.
        time: f64,
        /// The obstruction.
        with: Obstruction,
    },
    /// A hard goal that a hard limit excludes, whatever the actuators do.
    #[error("{why}: that takes {needed:.4} {unit} or more, and \"{name}\" allows {allowed} {unit}")]
    LimitConflict {
        /// Index among the task's limits.
        limit: usize,
        /// Name of the limit.
        name: String,
        /// Reason why the goal needs that much.
        why: String,
        /// Smallest value that the goal needs.
        needed: f64,
        /// Largest value that the limit allows.
        allowed: f64,
        /// Unit of both.
        unit: &'static str,
    },
    /// A feature of the problem that a free duration does not allow.
    #[error("a free duration does not go with {what}")]
    Duration {
        /// That feature.
        conflict: DurationConflict,
        /// That feature in words.
        what: String,
    },
}

/// The obstruction of a hard goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Obstruction {
    /// Another goal.
    Goal,
    /// The condition at the base.
    Base,
    /// A hard obstacle.
    Obstacle,
}

/// The nearest place to a target at which its node was found to be held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearestHeld {
    /// The place, m.
    pub position: [f64; 3],
    /// Its distance from the target, m; 0 for a target without a position.
    pub distance: f64,
}
