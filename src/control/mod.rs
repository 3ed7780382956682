//! Optimal control of a rod: the problem, its transcription, and the first guess.

pub mod guess;
pub mod hold;
pub mod problem;
pub mod transcription;

pub use guess::{Guess, GuessError, first_point};
pub use hold::{ControlGrid, Hold};
pub use problem::{
    Bound, Channel, Enforcement, OptimalControlProblem, TargetPart, TargetRow, TipTarget,
};
pub use transcription::{LiftedDirection, LiftedPoint, Transcription, simulate};
