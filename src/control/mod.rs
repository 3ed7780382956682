//! Optimal control of a rod: the problem, its transcription, and the first guess.

#[doc(hidden)]
pub mod advice;
mod control_cost;
#[doc(hidden)]
pub mod cost;
mod duration;
#[doc(hidden)]
pub mod feedback;
#[doc(hidden)]
pub mod guess;
#[doc(hidden)]
pub mod hold;
mod journal;
#[doc(hidden)]
pub mod obstacle;
#[doc(hidden)]
pub mod path;
#[doc(hidden)]
pub mod problem;
mod release;
#[doc(hidden)]
pub mod search;
#[doc(hidden)]
pub mod second_opinion;
mod static_need;
mod term;
mod tracking_error;
#[doc(hidden)]
pub mod transcription;

pub use advice::{Observation, observe};
pub use cost::sample_times;
pub use feedback::{Feedback, FeedbackError, FeedbackWeights};
pub use guess::{Guess, GuessError, first_point, simulated};
pub use hold::{ControlGrid, Hold};
#[doc(hidden)]
pub use journal::{Listener, SearchEvent, SolveLog};
pub use obstacle::{Shape, SignedDistance};
pub use path::{PathConstraint, PathEnforcement, PathLimit, PathMultiplier, Posture};
pub use problem::{
    Actuator, Bound, Channel, DurationConflict, Enforcement, FreeDuration, Goal, GoalPart,
    Objective, OptimalControlProblem, Tracking,
};
#[doc(hidden)]
pub use problem::{Component, GoalRow};
pub use search::{Abandoned, Attempt, Continuation, Search, search, search_telling};
pub use static_need::{StaticNeed, StaticNeedError, static_need};
pub use term::{NodeForm, SharedTerm, StateCost, StateTerm, StateView};
pub use tracking_error::{TrackingError, tracking_errors};
#[doc(hidden)]
pub use transcription::{LiftedDirection, LiftedPoint, PathRow, Transcription, simulate};
