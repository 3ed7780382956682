//! The rod: rotations, strain rules, energy, loads, integrator, and its linearization. No costs.

pub mod base_motion;
mod block_tridiagonal;
mod buffer;
pub mod configuration;
pub mod constitutive;
pub mod curvature;
pub mod diagnostics;
pub mod differences;
pub mod energy;
mod energy_norm;
pub mod equilibrium;
pub mod forces;
pub mod forms;
pub mod implicit;
pub mod inertia;
pub mod integrator;
pub mod lanes;
pub mod linearization;
pub mod load;
pub mod rod;
pub mod rotation;
pub mod sensitivity;
pub mod signal;
pub mod sparse_motion;
pub mod stability;
pub mod step_derivative;
pub mod stepper;
mod stiffness;
pub mod strain;
pub mod strain_coordinates;
pub mod vibration;

pub use base_motion::{BaseMotion, BaseState, CubicSpline, MotionCurve, Oscillation};
pub use configuration::{Configuration, State, Trajectory, TrajectoryTangent};
pub use constitutive::RodModel;
pub use diagnostics::{Diagnostics, MomentumBalance, PowerBalance};
pub use energy::Energy;
pub use energy_norm::EnergyNorm;
pub use equilibrium::{TipSpring, static_equilibrium, static_equilibrium_until};
pub use forms::{FormTerm, StateForm};
pub use integrator::{Integrator, StepError, TimeGrid, TimeNode, TimeScheme};
pub use lanes::LaneIntegrator;
pub use load::{DistributedLoad, Load, LoadFrame, Wrench};
pub use rod::{
    BaseCondition, Material, NodeInertia, Rod, RodError, RodParameters, RotaryInertia, Scales,
    Section, SectionProfile,
};
pub use signal::{ControlSignal, NodeWrenches};
pub use stability::{AUTO_STEP_FRACTION, stable_step};
pub use stepper::Stepper;
pub use strain::StrainRule;
pub use vibration::SmallMotions;
