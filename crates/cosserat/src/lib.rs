//! The discrete rod: rotations, sections, strain rules, energies, loads and what acts on it. A part of softarm.

#![forbid(unsafe_code)]

#[doc(hidden)]
pub mod actuator;
#[doc(hidden)]
pub mod base_motion;
#[doc(hidden)]
pub mod block_tridiagonal;
#[doc(hidden)]
pub mod buffer;
#[doc(hidden)]
pub mod configuration;
#[doc(hidden)]
pub mod differences;
#[doc(hidden)]
pub mod element;
#[doc(hidden)]
pub mod ends;
#[doc(hidden)]
pub mod energy;
#[doc(hidden)]
pub mod forces;
#[doc(hidden)]
pub mod forms;
#[doc(hidden)]
pub mod guards;
mod held;
#[doc(hidden)]
pub mod implicit;
#[doc(hidden)]
pub mod inertia;
#[doc(hidden)]
pub mod instructions;
#[doc(hidden)]
pub mod load;
#[doc(hidden)]
pub mod logarithm;
#[doc(hidden)]
pub mod mesh;
#[doc(hidden)]
pub mod nodal_state;
#[doc(hidden)]
pub mod part;
#[doc(hidden)]
pub mod place;
pub mod resistance;
#[doc(hidden)]
pub mod rod;
#[doc(hidden)]
pub mod rod_error;
pub mod rotation;
#[doc(hidden)]
pub mod rotation_step;
#[doc(hidden)]
pub mod rows;
#[doc(hidden)]
pub mod section;
#[doc(hidden)]
pub mod shape;
#[doc(hidden)]
pub mod signal;
#[doc(hidden)]
pub mod solid;
#[doc(hidden)]
pub mod stability;
#[doc(hidden)]
pub mod state_tangent;
#[doc(hidden)]
pub mod step_error;
#[doc(hidden)]
pub mod stiffness;
#[doc(hidden)]
pub mod strain_coordinates;
#[doc(hidden)]
pub mod time;
#[doc(hidden)]
pub mod vector;

#[doc(hidden)]
pub use self::rod::{pose_actuator, strain_actuator};
#[doc(hidden)]
pub use actuator::{Acting, ActingDerivative};
pub use actuator::{Actuator, SharedActuator, StateView};
pub use base_motion::{BaseMotion, BaseState, CubicSpline, MotionCurve, Oscillation};
pub use configuration::{Configuration, State, Trajectory, TrajectoryTangent};
pub use element::learned::{Learned, LearnedBasis, LearnedStrains};
pub use element::{Density, RodModel, StrainRule};
pub use ends::{EndCondition, Joint};
pub use energy::{Energy, kinetic_energy};
#[doc(hidden)]
pub use forms::{FormTerm, StateForm};
pub use load::{DistributedLoad, Load, LoadFrame, Wrench};
pub use mesh::Mesh;
#[doc(hidden)]
pub use mesh::{MOST_ELEMENTS, SAME as SAME_PLACE};
pub use nodal_state::{NodalFault, NodalState};
pub use place::Place;
pub use pose_actuator::{
    Cable, Magnet, OfPose, PlacedFunction, Pose, PoseActuator, PoseFunction, Posed,
    SharedPoseFunction, Span,
};
pub use rod::contact::{Contact, Deepest, HOLDS, Pressed, Touch};
pub use rod::friction::{Friction, LineChange, Rubbing};
pub use rod::learned::LearnedPart;
pub use rod::{
    BaseCondition, Material, NodeInertia, Rod, RodError, RodParameters, RotaryInertia, Scales,
    Section, SectionProfile, SectionSegment,
};
pub use shape::Outline;
pub use signal::{ControlSignal, Efforts, NodeWrenches};
pub use stability::{AUTO_STEP_FRACTION, stable_step};
pub use step_error::StepError;
pub use strain_actuator::{
    Drive, EffortLaw, EffortState, PlacedPoint, RodActuators, Route, StrainActuator, Winch,
};
pub use time::{Clock, TimeGrid, TimeNode, TimeScheme};
