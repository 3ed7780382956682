//! Optimal control of a rod: the problem, its transcription, and the first guess.

pub mod cost;
pub mod feedback;
pub mod guess;
pub mod hold;
pub mod obstacle;
pub mod path;
pub mod problem;
pub mod search;
pub mod second_opinion;
pub mod transcription;

pub use feedback::{Feedback, FeedbackError, FeedbackWeights};
pub use guess::{Guess, GuessError, first_point, simulated};
pub use hold::{ControlGrid, Hold};
pub use obstacle::{Shape, SignedDistance};
pub use path::{PathConstraint, PathEnforcement, PathLimit, PathMultiplier, Posture};
pub use problem::{
    Actuator, Bound, Channel, Component, Enforcement, Goal, GoalPart, GoalRow, Objective,
    OptimalControlProblem, Tracking,
};
pub use search::{Abandoned, Attempt, Continuation, Search, search};
pub use transcription::{LiftedDirection, LiftedPoint, PathRow, Transcription, simulate};
