//! Sequential quadratic programming for lifted programs. Knows no rod.

mod balls;
pub mod globalization;
pub mod hessian;
pub mod kept_states;
mod polish;
pub mod program;
pub mod progress;
pub mod quadratic_program;
mod refit;
pub mod residual;
mod run;
pub mod solver;

pub use hessian::{HessianChoice, HessianKind};
pub use kept_states::{QpRoute, StateLinearization, StateRow};
pub use program::{
    ConvexSet, Evaluation, Failure, LiftedProgram, Linearization, LinearizationRequest, Softness,
};
pub use progress::{Progress, Trend};
pub use residual::{KktResidual, Multipliers};
pub use solver::{
    Convergence, IterationRecord, Leave, PhaseTimes, SADDLE_GAIN, SqpOutcome, SqpSettings,
    SqpStatus, solve,
};

pub use crate::stop::{Stop, StopSignal};
