//! Errors of a discretization: what the continuous problem or the requested numbers do not allow.

use crate::control::{DurationConflict, GoalPart};
use crate::mechanics::RodError;
use crate::mechanics::equilibrium::EquilibriumError;

/// Why there is no discrete problem.
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
    /// A free duration whose longest makes steps that cannot be taken.
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
    Start(#[from] EquilibriumError),
    /// Nothing holds the arm at its target.
    #[error("{0}")]
    NotHeld(String),
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
    /// A hard limit that the arm violates where it starts, which nothing could mend.
    #[error("at t = 0 the arm is {amount:.3e} {unit}{relation} \"{name}\" at {place} {node}")]
    ViolatedAtStart {
        /// Index among the task's limits.
        limit: usize,
        /// Its name.
        name: String,
        /// By how much.
        amount: f64,
        /// In what unit, with a space behind it where there is one.
        unit: String,
        /// Inside or beyond.
        relation: &'static str,
        /// A node, or the element from a node.
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
        /// By how much, in the part's unit.
        amount: f64,
        /// The reason, with the place of the obstruction.
        why: String,
        /// Time of the goal, s.
        time: f64,
        /// The obstruction.
        with: Obstruction,
    },
    /// A hard goal that a hard limit excludes, whatever acts.
    #[error("{why}: that takes {needed:.4} {unit} or more, and \"{name}\" allows {allowed} {unit}")]
    LimitConflict {
        /// Index among the task's limits.
        limit: usize,
        /// Its name.
        name: String,
        /// What the goal asks for.
        why: String,
        /// The least that it takes.
        needed: f64,
        /// The most that the limit allows.
        allowed: f64,
        /// Unit of both.
        unit: &'static str,
    },
    /// The problem has a part that a free duration does not allow.
    #[error("a free duration does not go with {what}")]
    Duration {
        /// That part.
        conflict: DurationConflict,
        /// In words.
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
