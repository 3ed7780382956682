//! The continuous problem: an [`Arm`], its [`Task`], and the [`Discretization`] that makes numbers of both.
//!
//! An arm has no elements and a task no time steps, so that the same problem can be cut finer, coarser, or with another integrator.
//! [`Task::discretize`] returns the discrete [`Problem`]; whatever is left open in the discretization is chosen, and the problem says what.
//!
//! ```
//! # mod softarm { pub use {mechanics, nalgebra, softarm_task as task}; }
//! use softarm::mechanics::Material;
//! use softarm::nalgebra::Vector3;
//! use softarm::task::{Arm, Discretization, Task};
//!
//! let silicone = Material::isotropic(1e6, 0.5, 1000.0);
//! let arm = Arm::cylinder(&silicone, 1.0, 0.05);
//! let task = Task::reach(Vector3::new(0.5, 0.0, 0.8), 1.0, 20.0);
//! let coarse = task.discretize(&arm, &Discretization::with_elements(5))?;
//! let fine = task.discretize(&arm, &Discretization::with_elements(40))?;
//! assert_eq!(coarse.discrete.n_controls(), fine.discrete.n_controls());
//! assert!(fine.discrete.grid.step < coarse.discrete.grid.step);
//! # Ok::<(), softarm::task::DiscretizeError>(())
//! ```

#![forbid(unsafe_code)]

mod arm;
mod contradictions;
mod definition;
mod discretization;
mod discretize;
#[doc(hidden)]
pub mod distributed;
mod effort;
mod error;
mod goals;
mod own;
#[doc(hidden)]
pub mod prediction;
#[doc(hidden)]
pub mod staying;
mod taut;
mod tracking;

pub use arm::{Arm, Place, PointLoad, Start, StartError, StartShape};
pub use control::PathLimit;
pub use definition::{
    ChannelLimits, ControlGroup, Cost, Hardness, Limit, OwnActuator, Rest, Staying, Target, Task,
    Tolerances, Track, WrenchActuator,
};
pub use discretization::Discretization;
pub use discretize::{DiscreteMotion, Problem};
#[doc(hidden)]
pub use discretize::{MOST_STEPS, longest_step};
pub use distributed::DistributedCouple;
pub use effort::{EffortControl, Follows};
pub use error::{DiscretizeError, NearestHeld, Obstruction};
#[doc(hidden)]
pub use taut::{Begins, allow_slack, taut_limit};
