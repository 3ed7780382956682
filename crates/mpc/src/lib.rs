//! Closed-loop model-predictive control on the full rod.
//!
//! A [`Controller`] is made from an arm, a task and a discretization, as a solve is. Once per sample period it takes the measured state,
//! positions, rotations and momenta of all nodes, and returns the wrenches to apply until the next sample. The measured state is a
//! parameter of its linearized model, so that the response to a measurement is one small quadratic program; all slow work is done before
//! the measurement arrives (the real-time iteration of Diehl, Bock and Schlöder 2005). No sample after the first allocates memory, except
//! for the slopes of obstacles, limits and contacts.
//!
//! A [`Plant`] executes commands and is measured: [`RodPlant`] is an arm with a grid and a material of its own, whose state a [`Transfer`]
//! carries to the model's nodes; hardware and other simulators implement the trait.
//!
//! If the state cannot be measured, a [`Sensor`] gives [`Measurement`]s, late and with noise, and an [`Estimator`] computes from them an
//! [`Estimate`] of the state and of the disturbances of the arm: a [`KalmanFilter`], or one of the caller's.
//!
//! A [`ClosedLoop`] combines all of these in simulation. A [`Driver`] is its computing side, with estimator and fallbacks, for a user's own
//! plant. [`serve`] drives a plant in another process by lines of JSON.
//!
//! ```
//! # mod softarm { pub use {mechanics, softarm_mpc as mpc, task}; }
//! use nalgebra::Vector3;
//! use softarm::mechanics::{Material, State, stable_step};
//! use softarm::mpc::{Controller, MpcSettings, Plant as _, RodPlant};
//! use softarm::task::{Arm, Cost, Discretization, Task, Track};
//!
//! let silicone = Material::isotropic(1e6, 0.5, 1000.0);
//! let arm = Arm::cylinder(&silicone, 1.0, 0.05);
//! let upright = Vector3::new(0.0, 0.0, 1.0);
//! let path = vec![(0.0, upright), (1.0, upright + Vector3::new(0.1, 0.0, 0.0))]; // times in s, positions in m
//! let task = Task {
//!     targets: Vec::new(),
//!     cost: Cost {
//!         effort: 0.01,
//!         tracks: vec![Track { path, weight: Some(1e4), ..Track::default() }],
//!         ..Cost::default()
//!     },
//!     ..Task::reach(upright, 1.0, 20.0)
//! };
//! let settings = MpcSettings::receding(0.2);
//! let discretization = Discretization { samples: 10, ..Discretization::with_elements(4) };
//! let mut controller = Controller::new(&arm, &task, &discretization, &settings)?;
//!
//! // The plant has finer elements than the controller's model.
//! let rod = arm.rod(&Discretization::with_elements(8))?;
//! let start = State::at_rest(rod.rest.clone());
//! let mut plant = RodPlant::new(&rod, start, settings.period, stable_step(&rod), controller.rod());
//! for _ in 0..3 {
//!     let command = controller.feedback(&plant.measure())?;
//!     plant.apply(&command)?;
//!     command.prepare()?;
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

mod beam;
mod closed_loop;
mod command;
mod controller;
mod error;
#[doc(hidden)]
pub mod estimator;
#[doc(hidden)]
pub mod holding;
mod horizon;
#[doc(hidden)]
pub mod knots;
#[doc(hidden)]
pub mod limits;
mod plant;
mod rows;
#[doc(hidden)]
pub mod sensor;
mod serving;
mod signal;
mod simulated_arm;
#[doc(hidden)]
pub mod soft_rows;
#[doc(hidden)]
pub mod subproblem;
mod transfer;

pub use closed_loop::{
    Action, Cause, ClosedLoop, Computing, Contender, Driver, Experiment, FallbackSettings,
    Innovations, Knowledge, Known, Law, LoopSettings, Outcome, Percentiles, Responded, Sample,
    SampleObserver, Sensing, SensorChoice, Tally, Tamper, TipError, TipGains, Unknowns,
};
pub use command::{Command, CommandedControl, ControlList, ControlledPart, Effect};
pub use controller::{Controller, EffortFrom, Issued, MpcSettings, ReferenceNeed, SampleRecord};
#[doc(hidden)]
pub use controller::{ControllerParts, followed, with_long_steps};
pub use error::MpcError;
pub use estimator::{
    Disturbance, Estimate, EstimateError, Estimator, Inbox, Innovation, KalmanFilter,
    KalmanSettings, N_COMPONENTS, N_UNKNOWNS, Needs, Predictor, RandomWalk, Regridded, Unknown,
    UnknownRow,
};
pub use limits::KEPT;
pub use plant::{Plant, RodPlant};
pub use sensor::{Sensor, SensorPreset, SensorSettings};
#[doc(hidden)]
pub use serving::{CommandLine, ErrorLine, Heard, MeasurementLine, Peer, rotation_rows};
pub use serving::{
    LONGEST_LINE, SERVING_VERSION, ServeError, Served, Server, ServingEnd, read_line, serve,
};
pub use signal::{Measurement, Quantity, QuantityRow, Reading, Signal};
pub use simulated_arm::{ActuatorDynamics, EffortDynamics, SimulatedArm, follow_with_play};
pub use subproblem::SubproblemEnd;
pub use transfer::Transfer;

/// Name of the program, by which its results and its lines of JSON say who wrote them.
#[doc(hidden)]
pub const TOOL: &str = "softarm";
