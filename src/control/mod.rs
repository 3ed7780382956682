//! Optimal control of a rod: the problem, its transcription, and the first guess.

pub mod advice;
mod control_cost;
pub mod cost;
mod duration;
pub mod feedback;
pub mod guess;
pub mod hold;
mod journal;
pub mod obstacle;
pub mod path;
pub mod problem;
mod release;
pub mod search;
pub mod second_opinion;
mod static_need;
mod term;
mod tracking_error;
pub mod transcription;

pub use advice::{Observation, observe};
pub use feedback::{Feedback, FeedbackError, FeedbackWeights};
pub use guess::{Guess, GuessError, first_point, simulated};
pub use hold::{ControlGrid, Hold};
pub use journal::{Listener, SearchEvent, SolveLog};
pub use obstacle::{Shape, SignedDistance};
pub use path::{PathConstraint, PathEnforcement, PathLimit, PathMultiplier, Posture};
pub use problem::{
    Actuator, Bound, Channel, Component, DurationConflict, Enforcement, FreeDuration, Goal,
    GoalPart, GoalRow, Objective, OptimalControlProblem, Tracking,
};
pub use search::{Abandoned, Attempt, Continuation, Search, search, search_telling};
pub use static_need::{StaticNeed, StaticNeedError, static_need};
pub use term::{NodeForm, SharedTerm, StateCost, StateTerm, StateView};
pub use tracking_error::{TrackingError, tracking_errors};
pub use transcription::{LiftedDirection, LiftedPoint, PathRow, Transcription, simulate};
