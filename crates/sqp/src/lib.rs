//! Sequential quadratic programming for lifted programs: programs whose states obey recursions.

#![forbid(unsafe_code)]

#[doc(hidden)]
pub mod balls;
mod best_point;
mod correction;
#[doc(hidden)]
pub mod filter;
#[doc(hidden)]
pub mod hessian;
#[doc(hidden)]
pub mod kept_states;
#[doc(hidden)]
pub mod kkt;
mod norms;
#[doc(hidden)]
pub mod outcome;
#[doc(hidden)]
pub mod program;
#[doc(hidden)]
pub mod progress;
#[doc(hidden)]
pub mod quadratic_program;
mod run;
mod settings;
#[doc(hidden)]
pub mod solver;
mod trace;
mod trial;
mod trust_region;
mod working_set;

pub use hessian::HessianKind;
#[doc(hidden)]
pub use hessian::is_strict_minimum;
pub use kept_states::QpRoute;
#[doc(hidden)]
pub use kept_states::{StateLinearization, StateRow};
pub use kkt::KktResidual;
#[doc(hidden)]
pub use norms::norm;
pub use outcome::{
    Convergence, IterationRecord, Leave, PhaseTimes, SqpOutcome, SqpStatus, StepKind,
};
pub use program::{
    ConvexSet, Evaluation, Failure, LagrangianTerms, LiftedProgram, Linearization,
    LinearizationRequest, Multipliers, Softness,
};
pub use progress::{Progress, Trend};
pub use run::WarmStart;
pub use settings::{HessianChoice, SADDLE_GAIN, SqpSettings};
pub use solver::{Iteration, Solver, solve, solve_warm};

pub use stop::{Stop, StopSignal};
