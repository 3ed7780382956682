//! The rod: rotations, strain rules, energy, loads, integrator, and its linearization. No costs.
//!
//! A [`Rod`] is built from [`RodParameters`] (or by [`Arm::rod`](crate::task::Arm::rod)); a [`Stepper`] moves its [`State`];
//! [`static_equilibrium`] finds its equilibrium, [`SmallMotions`] the natural frequencies about it.
//!
//! ```
//! use nalgebra::Vector3;
//! use softarm::mechanics::{
//!     Energy, Material, NodeWrenches, Rod, RodParameters, Section, SectionProfile, State, Stepper, stable_step,
//! };
//!
//! let silicone = Material::isotropic(1e6, 0.5, 1000.0);
//! let section = SectionProfile::Uniform(Section::circle(&silicone, 0.05));
//! let rod = Rod::new(&RodParameters {
//!     gravity: Vector3::new(-9.81, 0.0, 0.0), // sideways
//!     ..RodParameters::straight(1.0, 10, section)
//! })?;
//! let start = State::at_rest(rod.rest.clone());
//! let before = Energy::of(&rod, &start).total();
//! let mut stepper = Stepper::new(&rod, 0.5 * stable_step(&rod), start);
//! for _ in 0..200 {
//!     stepper.advance([NodeWrenches::NONE; 2])?;
//! }
//! let state = stepper.state();
//! assert!(state.configuration.positions[rod.tip()].x < -0.01); // it falls
//! assert!((Energy::of(&rod, &state).total() - before).abs() < 1e-2); // and keeps its energy, J
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#[doc(hidden)]
pub mod actuator;
#[doc(hidden)]
pub mod base_motion;
pub(crate) mod beam;
pub(crate) mod block_tridiagonal;
mod buffer;
#[doc(hidden)]
pub mod configuration;
#[doc(hidden)]
pub mod curvature;
#[doc(hidden)]
pub mod diagnostics;
#[doc(hidden)]
pub mod differences;
#[doc(hidden)]
pub mod element;
#[doc(hidden)]
pub mod ends;
#[doc(hidden)]
pub mod energy;
mod energy_norm;
#[doc(hidden)]
pub mod equilibrium;
#[doc(hidden)]
pub mod forces;
#[doc(hidden)]
pub mod forms;
pub(crate) mod guards;
mod held;
#[doc(hidden)]
pub mod implicit;
#[doc(hidden)]
pub mod inertia;
#[doc(hidden)]
pub mod lanes;
#[doc(hidden)]
pub mod linearization;
#[doc(hidden)]
pub mod load;
pub mod load_path;
mod logarithm;
mod mesh;
pub(crate) mod nodal_state;
mod part;
pub(crate) mod place;
#[doc(hidden)]
pub mod rod;
mod rod_error;
pub mod rotation;
mod rotation_step;
pub(crate) mod rows;
mod section;
#[doc(hidden)]
pub mod sensitivity;
mod shape;
#[doc(hidden)]
pub mod signal;
pub(crate) mod slow_modes;
#[doc(hidden)]
pub mod solid;
#[doc(hidden)]
pub mod sparse_motion;
#[doc(hidden)]
pub mod stability;
mod state_tangent;
#[doc(hidden)]
mod step_error;
#[doc(hidden)]
pub mod stepper;
mod stiffness;
#[doc(hidden)]
pub mod strain_coordinates;
mod swept;
pub(crate) mod tangent;
mod time;
mod vector;
#[doc(hidden)]
pub mod vibration;

#[doc(hidden)]
pub use self::rod::{pose_actuator, strain_actuator};
#[doc(hidden)]
pub use actuator::{Acting, ActingDerivative};
pub use actuator::{Actuator, SharedActuator, StateView};
pub use base_motion::{BaseMotion, BaseState, CubicSpline, MotionCurve, Oscillation};
pub use configuration::{Configuration, State, Trajectory, TrajectoryTangent};
pub use diagnostics::{Diagnostics, MomentumBalance, PowerBalance};
pub use element::{Density, RodModel, StrainRule};
pub use ends::{EndCondition, Joint};
pub use energy::{Energy, kinetic_energy};
#[doc(hidden)]
pub use energy_norm::EnergyNorm;
pub use equilibrium::{
    EquilibriumError, NodeSpring, Settled, nearby_equilibrium_until, settled, static_equilibrium,
    static_equilibrium_until,
};
#[doc(hidden)]
pub use forms::{FormTerm, StateForm};
#[doc(hidden)]
pub use lanes::{LaneIntegrator, SolverWork};
pub use load::{DistributedLoad, Load, LoadFrame, Wrench};
pub use load_path::{Critical, Kept, LoadPath, LoadedShape, Loss, Varied};
pub use mesh::Mesh;
pub(crate) use mesh::{MOST_ELEMENTS, SAME as SAME_PLACE};
pub use nodal_state::{NodalFault, NodalState};
pub use place::Place;
pub use pose_actuator::{
    Cable, Magnet, OfPose, PlacedFunction, Pose, PoseActuator, PoseFunction, Posed,
    SharedPoseFunction, Span,
};
pub use rod::contact::{Contact, Deepest, HOLDS, Pressed, Touch};
pub use rod::{
    BaseCondition, Material, NodeInertia, Rod, RodError, RodParameters, RotaryInertia, Scales,
    Section, SectionProfile, SectionSegment,
};
pub use shape::Shape;
pub use signal::{ControlSignal, Efforts, NodeWrenches};
pub use stability::{AUTO_STEP_FRACTION, stable_step};
pub use step_error::StepError;
pub use stepper::Stepper;
pub(crate) use stepper::StepperMemory;
pub use strain_actuator::{
    Drive, EffortLaw, PlacedPoint, RodActuators, Route, StrainActuator, Winch,
};
pub use swept::SweptSurface;
pub use tangent::Stability;
pub use time::{Clock, TimeGrid, TimeNode, TimeScheme};
pub use vibration::SmallMotions;
