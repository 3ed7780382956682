//! The rod: rotations, strain rules, energy, loads, integrator, and its linearization. No costs.
//!
//! A [`Rod`] is built from [`RodParameters`] (or by the `Arm::rod` of `softarm::task`); a [`Stepper`] moves its [`State`];
//! [`static_equilibrium`] finds its equilibrium, [`SmallMotions`] the natural frequencies about it.
//!
//! ```
//! # mod softarm { pub use softarm_mechanics as mechanics; }
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

#![forbid(unsafe_code)]

pub mod at_rest;
#[doc(hidden)]
pub mod beam;
#[doc(hidden)]
pub mod direction;
mod energy_norm;
#[doc(hidden)]
pub mod equilibrium;

pub mod load_path;
pub mod rollout;
pub mod sloped_motion;
#[doc(hidden)]
pub mod slow_modes;
mod swept;
#[doc(hidden)]
pub mod tangent;
#[doc(hidden)]
pub mod threads;
#[doc(hidden)]
pub mod vibration;

#[doc(inline)]
pub use cosserat::{
    AUTO_STEP_FRACTION, Actuator, BaseCondition, BaseMotion, BaseState, Cable, Clock,
    Configuration, Contact, ControlSignal, CubicSpline, Deepest, Density, DistributedLoad, Drive,
    EffortLaw, EffortState, Efforts, EndCondition, Energy, Friction, HOLDS, Joint, Learned,
    LearnedBasis, LearnedPart, LearnedStrains, LineChange, Load, LoadFrame, Magnet, Material, Mesh,
    MotionCurve, NodalFault, NodalState, NodeInertia, NodeWrenches, OfPose, Oscillation, Outline,
    Place, PlacedFunction, PlacedPoint, Pose, PoseActuator, PoseFunction, Posed, Pressed, Rod,
    RodActuators, RodError, RodModel, RodParameters, RotaryInertia, Route, Rubbing, Scales,
    Section, SectionProfile, SectionSegment, SharedActuator, SharedPoseFunction, Span, State,
    StateView, StepError, StrainActuator, StrainRule, TimeGrid, TimeNode, TimeScheme, Touch,
    Trajectory, TrajectoryTangent, Winch, Wrench, kinetic_energy, resistance, rotation,
    stable_step,
};
#[doc(hidden)]
pub use cosserat::{
    Acting, ActingDerivative, FormTerm, MOST_ELEMENTS, SAME_PLACE, StateForm, actuator,
    base_motion, block_tridiagonal, configuration, differences, element, ends, energy, forces,
    forms, guards, implicit, inertia, instructions, load, nodal_state, place, pose_actuator, rod,
    rows, signal, solid, stability, strain_actuator, strain_coordinates,
};
#[doc(hidden)]
pub use energy_norm::EnergyNorm;
pub use equilibrium::{
    EquilibriumError, NodeSpring, Settled, nearby_equilibrium_until, settled, static_equilibrium,
    static_equilibrium_until,
};
#[doc(inline)]
pub use integrator::{Diagnostics, MomentumBalance, PowerBalance, Stepper};
#[doc(hidden)]
pub use integrator::{LaneIntegrator, SolverWork, StepperMemory, diagnostics, lanes, stepper};
pub use load_path::{Critical, Kept, LoadPath, LoadedShape, Loss, Varied};
#[doc(hidden)]
pub use sensitivity::{self, curvature, linearization, sparse_motion};
pub use swept::SweptSurface;
pub use tangent::Stability;
pub use vibration::SmallMotions;
