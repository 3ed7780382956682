//! The summary of `check`.

use serde::Serialize;

use super::ContactFacts;
use crate::closed_loop::LoopSummary;

/// Summary of `check`.
#[derive(Clone, Debug, Serialize)]
pub struct CheckSummary {
    /// [`SCHEMA_VERSION`](super::SCHEMA_VERSION)
    pub schema_version: u32,
    /// `check`
    pub command: &'static str,
    /// Name of the scene.
    pub scene: String,
    /// Rod model.
    pub model: &'static str,
    /// Strain rule.
    pub strain: &'static str,
    /// Number of elements.
    pub elements: usize,
    /// Mass of the rod, kg.
    pub mass_kg: f64,
    /// Stable step of the explicit integrator, s.
    pub stable_step_s: f64,
    /// The bodies that the arm touches; absent where there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contact: Option<ContactFacts>,
    /// `explicit` or `implicit`.
    pub integrator: &'static str,
    /// `section` or `segment`: what the rotary inertia of the nodes is made of.
    pub rotary_inertia: &'static str,
    /// Predicted cost of a second of motion with either integrator.
    pub cost: CostEstimate,
    /// Step that a run takes, s.
    pub step_s: f64,
    /// Steps of a run.
    pub steps: usize,
    /// `GA l²/(4 EI)`: by how much the trapezoidal rule stiffens bending.
    pub locking_ratio: f64,
    /// Reference magnitudes of the rod.
    pub scales: ScalesSummary,
    /// Size of the optimal-control problem, if the scene has one.
    pub optimal_control: Option<ProblemSize>,
    /// Size of the files that a simulation writes; absent for an optimal-control scene.
    pub output: Option<OutputSize>,
    /// Bytes that a run needs for its trajectory, about.
    pub memory_bytes: u64,
    /// Mass of the payload, part of `mass_kg`, kg.
    pub payload_kg: f64,
    /// The material, if the scene names it.
    pub material: Option<MaterialSummary>,
    /// The arm left alone.
    pub at_rest: RestSummary,
    /// The controls that the optimizer may choose, with their nodes; empty for a simulation.
    pub actuators: Vec<ActuatorSummary>,
    /// The wrench that holds the tip at its target.
    pub static_need: Option<StaticNeedSummary>,
    /// The predicted time of a solve; absent for a simulation and for a closed loop.
    pub solve_cost: Option<SolveCost>,
    /// The closed loop; absent for a scene without `[mpc]`.
    pub closed_loop: Option<LoopSummary>,
    /// Tells whether the scene left the integrator open.
    pub integrator_is_chosen: bool,
    /// Things a user should know before running.
    pub warnings: Vec<String>,
}

/// A material by its name.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct MaterialSummary {
    /// Name in scenes.
    pub name: &'static str,
    /// Young's modulus of the name, Pa; the scene may give another one.
    pub youngs_modulus_pa: f64,
    /// Least and largest Young's modulus, Pa.
    pub range_pa: [f64; 2],
    /// Source of the figures.
    pub source: &'static str,
}

/// The arm under gravity, with its payload and without loads.
#[derive(Clone, Debug, Default, Serialize)]
pub struct RestSummary {
    /// Distance of the tip's equilibrium from its place in the stress-free shape, m.
    pub sag_m: Option<f64>,
    /// Length of the arm there over its length at rest, less 1.
    pub stretch: Option<f64>,
    /// Why there is no equilibrium to speak of.
    pub no_equilibrium: Option<String>,
    /// Frequency of the slowest mode about the equilibrium, without damping, Hz.
    pub first_frequency_hz: Option<f64>,
    /// Rate at which deviations from the equilibrium grow, 1/s; absent where it is stable.
    pub growth_rate_1_s: Option<f64>,
    /// `ρA g L³/EI`, the payload left out.
    pub weight_number: f64,
}

/// A wrench that may be chosen.
#[derive(Clone, Debug, Serialize)]
pub struct ActuatorSummary {
    /// Index of the node.
    pub node: usize,
    /// Bound of the force, N, in space: `none` where there is no force, `unbounded`, or a number or list in words.
    pub force: String,
    /// Bound of the moment, N m, in the node's body frame, likewise.
    pub moment: String,
    /// Controls of an actuator that is no wrench on one node, and their bounds in words; `node` is then the first that it acts on.
    pub controls: Option<String>,
}

/// The verdict on whether the tip can be held at its target, and the wrench that holds it.
#[derive(Clone, Debug, Serialize)]
pub struct StaticNeedSummary {
    /// `within-bounds`: held by a wrench within the bounds, in a stable equilibrium. `above-bounds`, `unstable`, `cannot-be-held`: it
    /// cannot be. `not-found`: neither was found.
    pub verdict: &'static str,
    /// The wrench of every actuated node: force in space, N, and moment in the body frame, N m; that of the equilibrium at the target, also
    /// where it is beyond the bounds or unstable; empty where there is none.
    pub wrenches: Vec<[f64; 6]>,
    /// The controls of other actuators, actuator by actuator, in their own unit.
    pub controls: Vec<Vec<f64>>,
    /// Why it cannot be held, or why nothing was found.
    pub reason: Option<String>,
    /// Stiffness of the held tip along its softest direction, N/m.
    pub stiffness_n_m: Option<f64>,
    /// Lowest frequency of the held arm without damping, Hz.
    pub first_frequency_hz: Option<f64>,
    /// Rate at which deviations from the equilibrium grow with the wrench held, 1/s.
    pub growth_rate_1_s: Option<f64>,
    /// The nearest point that is held.
    pub nearest: Option<NearestHeldSummary>,
}

/// The nearest point to a target at which the tip can be held.
#[derive(Clone, Debug, Serialize)]
pub struct NearestHeldSummary {
    /// m
    pub position_m: [f64; 3],
    /// Distance from the target, m; 0 for a target without a position.
    pub distance_m: f64,
    /// Angle from the orientation or direction of the target, rad.
    pub angle_rad: Option<f64>,
    /// Wrenches, as in [`StaticNeedSummary`].
    pub wrenches: Vec<[f64; 6]>,
    /// Controls, as in [`StaticNeedSummary`].
    pub controls: Vec<Vec<f64>>,
}

/// The predicted time of a solve.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SolveCost {
    /// Seconds of an iteration.
    pub iteration_s: f64,
    /// Iterations that half and 95 % of random reaches of this kind need at most.
    pub iterations: [usize; 2],
    /// Seconds of the check of the solution.
    pub check_s: f64,
    /// Seconds of as many iterations and of the check; of the larger number, with iterations near obstacles and limits.
    pub total_s: [f64; 2],
}

/// The predicted time of a simulation with either integrator, from the seconds per node-step that `softarm::task` predicts.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct CostEstimate {
    /// Step of the explicit integrator, s: the scene's own, or the automatic one.
    pub explicit_step_s: f64,
    /// Seconds for the whole motion.
    pub explicit_wall_s: f64,
    /// Step of the implicit integrator, s.
    pub implicit_step_s: f64,
    /// Seconds for the whole motion.
    pub implicit_wall_s: f64,
    /// `explicit` or `implicit`.
    pub cheaper: &'static str,
}

/// Reference magnitudes.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ScalesSummary {
    /// Length, m.
    pub length_m: f64,
    /// `EI/L²`, N.
    pub force_n: f64,
    /// `EI/L`, N m.
    pub moment_n_m: f64,
    /// `L² sqrt(ρA/EI)`, s.
    pub time_s: f64,
}

/// Size of an optimal-control problem.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ProblemSize {
    /// Blocks of the control.
    pub control_blocks: usize,
    /// Variables of the solver: the controls, and the residuals of soft goals and of goals within a tolerance.
    pub variables: usize,
    /// Scalar equations of a hard target.
    pub target_equations: usize,
    /// Rows of the path constraints.
    pub path_rows: usize,
    /// Configuration unknowns that condensing eliminates.
    pub eliminated: usize,
}

/// Size of what a simulation writes.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct OutputSize {
    /// Rows of every array.
    pub rows: usize,
    /// Bytes of all arrays, not compressed. While they are packed at the end of a run, the disk holds them twice.
    pub bytes: u64,
}
