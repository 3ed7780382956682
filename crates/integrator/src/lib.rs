//! The variational integrator in SIMD lanes. A part of softarm.

#![forbid(unsafe_code)]

#[doc(hidden)]
pub mod diagnostics;
#[doc(hidden)]
pub mod lanes;
#[doc(hidden)]
pub mod stepper;

pub use diagnostics::{Diagnostics, MomentumBalance, PowerBalance};
#[doc(hidden)]
pub use lanes::{LaneIntegrator, SolverWork};
pub use stepper::Stepper;
#[doc(hidden)]
pub use stepper::StepperMemory;
