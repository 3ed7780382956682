//! Optimal control of a rod: the problem, its transcription, and the initial guess.
//!
//! An [`OptimalControlProblem`] comes from `softarm::task::Task::discretize`; [`search`](fn@search) solves it,
//! [`holding`](fn@holding) finds the wrench that holds the target, and a [`StateTerm`] is a user-defined cost or limit.
//!
//! ```
//! # mod softarm { pub use {mechanics, softarm_control as control, task}; }
//! use nalgebra::Vector3;
//! use softarm::control::{CannotHold, Holding, holding};
//! use softarm::mechanics::Material;
//! use softarm::task::{Arm, Discretization, Task};
//!
//! let arm = Arm::cylinder(&Material::isotropic(1e6, 0.5, 1000.0), 1.0, 0.05);
//! let task = Task::reach(Vector3::new(0.4, 0.0, 0.85), 1.0, 1.0);
//! let problem = task.discretize(&arm, &Discretization::with_elements(8))?.discrete;
//! let Holding::CannotBeHeld { why: CannotHold::Unstable(balanced), nearest } = holding(&problem)? else {
//!     panic!("a force alone balances this arm there, and does not hold it")
//! };
//! println!("{:.2} N, growing with {:?} 1/s", problem.wrenches(&balanced.controls)[0].force.norm(), balanced.growth_rate);
//! println!("{:.3} m away it can be held", nearest.map_or(f64::NAN, |(_, distance)| distance));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

mod acting;
#[doc(hidden)]
pub mod advice;
mod attempt;
mod control_cost;
#[doc(hidden)]
pub mod feedback;
mod free_duration;
#[doc(hidden)]
pub mod guess;
mod held;
#[doc(hidden)]
pub mod hold;
#[doc(hidden)]
pub mod holding;
mod journal;
#[doc(hidden)]
pub mod named;
#[doc(hidden)]
pub mod path;
#[doc(hidden)]
pub mod problem;
#[doc(hidden)]
pub mod residual;
#[doc(hidden)]
pub mod search;
mod stay;
mod tensions;
mod term;
mod tracking;
mod tracking_error;
#[doc(hidden)]
pub mod transcription;
mod turns;

#[doc(hidden)]
pub use advice::slack_of;
#[doc(hidden)]
pub use advice::slack_of_motion;
pub use advice::{Observation, observe};
#[doc(hidden)]
pub use attempt::SolveLog;
pub use attempt::{Abandoned, Attempt};
pub use feedback::{
    Feedback, FeedbackError, FeedbackWeights, ModelMismatch, ModelQuantity, TipDeviation,
    block_transitions,
};
pub use guess::{Guess, GuessError, first_point, simulated};
pub use held::Held;
pub use hold::{ControlGrid, Hold, b_splines};
pub use holding::{CannotHold, Holding, HoldingError, NotFound, holding};
#[doc(hidden)]
pub use holding::{ControlsAlong, HeldModes, HeldTarget};
#[doc(hidden)]
pub use journal::{Listener, SearchEvent};
pub use mechanics::solid::{Shape, SignedDistance};
pub use mechanics::{Actuator, SharedActuator};
pub use named::{ControlKind, NamedControl};
pub use path::{PathConstraint, PathEnforcement, PathLimit, PathMultiplier, RodView};
#[doc(hidden)]
pub use problem::named_axes;
pub use problem::{
    ActsOn, ActuatedNode, Bound, Channel, DurationConflict, Enforcement, FreeDuration, Goal,
    GoalPart, Objective, OptimalControlProblem, PlacedChannel,
};
#[doc(hidden)]
pub use problem::{Component, GoalRow};
#[doc(hidden)]
pub use residual::sample_times;
pub use search::{Continuation, Search, search, search_telling};
pub use stay::Stay;
#[doc(hidden)]
pub use term::DIFFERENCE;
#[doc(hidden)]
pub use term::{NodeForm, SharedTerm, StateCost, StateTerm, StateView};
pub use tracking::Tracking;
#[doc(hidden)]
pub use tracking::rounding_of;
pub use tracking_error::{TrackingError, tracking_errors};
#[doc(hidden)]
pub use transcription::{LiftedDirection, LiftedPoint, PathRow, Transcription, simulate};
#[doc(hidden)]
pub use turns::TIP_STIFFNESS;
