//! Speed against accuracy: errors of discretizations beside the time that they take, and the coarsest grid that is accurate enough.
//!
//! A [`Motion`] is simulated on one grid after the other, and [`Course::errors`] compares what comes out at the same places and times.
//! [`choose`] finds the grid for an accuracy.

mod choice;
mod clock;
mod course;
mod motion;
#[cfg(feature = "cli")]
#[doc(hidden)]
pub mod page;
mod sweep;

pub use crate::output::summary::Level;
pub use crate::task::prediction::first_elements;
pub use choice::{Choice, ChoiceError, choose, choose_telling, finer};
pub use clock::Seconds;
pub use course::{Course, Errors};
pub use motion::{Motion, Run, RunError};
pub use sweep::{
    CostModel, ErrorModel, Fate, FeatureCost, Models, News, Point, Recommendation, Reference,
    Setting, Subject, Sweep, SweepError, Tradeoff,
};
