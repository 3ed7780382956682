//! The sections and keys of a scene. Doc comments are the descriptions in the JSON Schema; a key that is `None` is not written, since TOML has no
//! null.

mod base;
mod contact;
mod control;
mod doubt;
mod estimator;
mod field;
pub(super) mod geometry;
mod hardware;
mod initial;
mod learned;
mod limit;
mod load;
mod mpc;
mod objective;
mod plant;
mod rod;
mod section;
mod sensor;
mod solver;
mod task;
mod time;

pub use self::base::*;
pub use self::contact::*;
pub use self::control::*;
pub use self::doubt::*;
pub use self::estimator::*;
pub use self::field::*;
pub use self::hardware::*;
pub use self::initial::*;
pub use self::learned::*;
pub use self::limit::*;
pub use self::load::*;
pub use self::mpc::*;
pub use self::objective::*;
pub use self::plant::*;
pub use self::rod::*;
pub use self::section::*;
pub use self::sensor::*;
pub use self::solver::*;
pub use self::task::*;
pub use self::time::*;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A soft arm, what acts on it, and what it should do. SI units throughout.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// The arm.
    pub rod: RodKeys,
    /// Pose of the first node, and whether it is held. Default: clamped at the origin, the arm along +z.
    #[serde(default)]
    pub base: Base,
    /// Condition of the last node. Absent: free.
    pub tip: Option<Tip>,
    /// Uniform gravity. Absent: none.
    pub gravity: Option<Gravity>,
    /// Damping. Absent: none.
    pub damping: Option<Damping>,
    /// Fluid around the arm: drag, buoyancy and added mass. Absent: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fluid: Option<Fluid>,
    /// A rigid body at the tip. Absent: none.
    pub payload: Option<Payload>,
    /// Rigid bodies on the arm. An element ends at each of them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub body: Vec<Body>,
    /// Prescribed forces and moments on nodes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub load: Vec<LoadKeys>,
    /// Prescribed forces and moments along the arm.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub distributed_load: Vec<DistributedLoad>,
    /// Tendons in the arm.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub tendon: Vec<Tendon>,
    /// Pneumatic or hydraulic chambers in the arm.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub chamber: Vec<Chamber>,
    /// Muscles in the arm.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub muscle: Vec<Muscle>,
    /// McKibben muscles in the arm: tubes in braids.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub braid: Vec<Braid>,
    /// Magnets in the arm, with the magnetic field around it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub magnet: Vec<MagnetKeys>,
    /// Cables from the arm to points in space.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cable: Vec<CableKeys>,
    /// Rests of the model that are learned from data.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub learned: Vec<LearnedRest>,
    /// Bodies that the arm touches: contact with a floor, a wall, a ball, a box, in every motion, simulated or optimized.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub contact: Vec<ContactKeys>,
    /// State at t = 0. Absent: the stress-free shape, at rest or moving with a driven base.
    pub initial: Option<Initial>,
    /// Duration and time step.
    pub time: Time,
    /// Target of the tip. Absent: there is nothing to reach.
    pub task: Option<TaskKeys>,
    /// Forces and moments that the optimizer or the controller chooses. Absent: none.
    pub control: Option<Control>,
    /// Bodies that the arm stays clear of.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub obstacle: Vec<Obstacle>,
    /// Limits on strain and speed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub limit: Vec<LimitKeys>,
    /// Terms that the optimizer minimizes, with their weights. Absent: the defaults.
    pub objective: Option<ObjectiveKeys>,
    /// Settings of the optimizer. Absent: the defaults.
    pub solver: Option<SolverKeys>,
    /// Doubt about the arm, under which the controls of a solve are replayed. Absent: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub doubt: Option<Doubt>,
    /// Contents of the result files. Absent: the defaults.
    pub output: Option<Output>,
    /// Model-predictive controller of a closed loop. Absent: there is no loop.
    pub mpc: Option<Mpc>,
    /// Plant of the loop: the arm that the controller acts on. Absent: the rod of the scene.
    pub plant: Option<PlantKeys>,
    /// Sensors of the loop; they go with `estimator`. Absent: the true state is known at once.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensor: Vec<SensorKeys>,
    /// Estimator of the state from sensors.
    pub estimator: Option<EstimatorKeys>,
    /// Forces and moments on the plant that the controller does not know; nodes are counted as in `[rod]`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub disturbance: Vec<LoadKeys>,
}

impl Scene {
    /// Returns the scene of an arm alone, without any other section.
    pub(in crate::scene) fn bare(rod: RodKeys, time: Time) -> Self {
        Self {
            rod,
            base: Base::default(),
            tip: None,
            gravity: None,
            damping: None,
            fluid: None,
            payload: None,
            body: Vec::new(),
            load: Vec::new(),
            distributed_load: Vec::new(),
            tendon: Vec::new(),
            chamber: Vec::new(),
            muscle: Vec::new(),
            braid: Vec::new(),
            magnet: Vec::new(),
            cable: Vec::new(),
            learned: Vec::new(),
            contact: Vec::new(),
            initial: None,
            time,
            task: None,
            control: None,
            obstacle: Vec::new(),
            limit: Vec::new(),
            objective: None,
            solver: None,
            doubt: None,
            output: None,
            mpc: None,
            plant: None,
            sensor: Vec::new(),
            estimator: None,
            disturbance: Vec::new(),
        }
    }
}
