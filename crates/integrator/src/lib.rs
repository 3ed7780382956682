//! The variational integrator in SIMD lanes, its linearization and its second derivatives. A part of softarm.

#![forbid(unsafe_code)]

mod buffer;
#[doc(hidden)]
pub mod curvature;
#[doc(hidden)]
pub mod diagnostics;
#[doc(hidden)]
pub mod lanes;
#[doc(hidden)]
pub mod linearization;
#[doc(hidden)]
pub mod sensitivity;
#[doc(hidden)]
pub mod sparse_motion;
#[doc(hidden)]
pub mod stepper;

pub use diagnostics::{Diagnostics, MomentumBalance, PowerBalance};
#[doc(hidden)]
pub use lanes::{LaneIntegrator, SolverWork};
pub use stepper::Stepper;
#[doc(hidden)]
pub use stepper::StepperMemory;
