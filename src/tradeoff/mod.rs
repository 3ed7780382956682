//! Speed against accuracy: the errors of discretizations beside their computing time, and the coarsest grid that is accurate enough.
//!
//! [`search`] finds the coarsest grid for an accuracy by measuring one after the other: [`choose`] measures simulations of a [`ComparedMotion`],
//! [`accurate_statics`] equilibria, `solve` and a sweep their own results. [`Course::errors`] compares motions on different grids at the
//! same places and times.

mod choice;
mod clock;
mod course;
mod grid;
mod motion;
#[cfg(feature = "cli")]
#[doc(hidden)]
pub mod page;
#[cfg(feature = "cli")]
mod solves;
mod statics;
mod sweep;

pub use crate::clock::Seconds;
pub use crate::output::summary::Level;
pub use crate::task::prediction::first_elements;
pub use choice::{Choice, ChoiceError, choose, choose_telling};
pub use course::{Course, Errors};
pub use grid::{End, Grid, GridErrors, GridRule, Measured, Order, search};
pub use motion::{ComparedMotion, Run, RunError};
#[cfg(feature = "cli")]
pub(crate) use solves::solve_on_grids;
pub use statics::accurate_statics;
pub use sweep::{
    CostModel, ErrorModel, Fate, FeatureCost, Models, News, Point, Recommendation, Setting,
    Subject, Sweep, SweepError, SweepReference, Tradeoff,
};
