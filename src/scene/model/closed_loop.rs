//! The closed loop: the controller, the arm as it is, what is measured of it, and what is estimated.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::values::{self, NonNegative, Positive, known};
use super::{Payload, Section};
use crate::mpc::{EffortFrom, FallbackSettings, MpcSettings, SensorPreset};

/// Model-predictive control of the arm in simulation, `softarm mpc`. The rod of the scene is the controller's model; `[control]` bounds
/// what it sends, and `[task]` and `[[objective.track]]` say what it does.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Mpc {
    /// Time between two samples in s, positive, default 0.01.
    pub period_s: Positive<values::Duration>,
    /// Length of the horizon in s, not below `period_s`. Absent: half of the first natural period of the arm, along a path at most a
    /// quarter of `time.end_s`, and at least ten periods.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub horizon_s: Option<Positive<values::Duration>>,
    /// When the task is due in s, positive: the horizon does not go beyond, and shrinks before. Absent: `task.at_s`; without that the horizon
    /// recedes for ever.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub due_s: Option<Positive<values::Instant>>,
    /// Length of a block of the control in s, positive. Absent: a tenth of the horizon.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub block_s: Option<Positive<values::Duration>>,
    /// After so many blocks of one length the next ones are twice as long, at least 1. Absent: all are equal.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    pub equal_blocks: Option<usize>,
    /// Weight w of w/2 |u - a|², the jump from the control a that acts when a sample begins, in units of `objective.force_scale_n` and
    /// `moment_scale_n_m`; not negative, default 100.
    pub jump: NonNegative<values::Weight>,
    /// Where effort counts from while the horizon recedes: `"auto"` (default), from what holds the model's tip where its reference rests, if the arm is
    /// stable under it, and from zero where it moves; `"holding"`, everywhere from what holds it there; or `"zero"`.
    pub effort_from: EffortFrom,
    /// Weight of the target of `[task]` at the end of the horizon, positive, default 1e4; targets are soft in a loop. Where the horizon recedes,
    /// the target's place is a track with ten times the default weight instead, and rest comes by itself.
    pub target_weight: Positive<values::Weight>,
    /// Price of a violation of 1, in the scale of its limit, of obstacles and limits that are not `soft` themselves: linear for a second, and
    /// of half of its square; positive, default 5000. What keeps a limit is the weight of a track times the distance over the length by which
    /// it holds the node back; far above that, commands jump.
    pub limit_price: Positive<values::Weight>,
    /// Gauss-Newton iterations a sample, at least 1, default 1.
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    pub iterations: usize,
    /// Time in s after which a command is to be there, positive: no iteration but the first is begun that would end later. Commands then depend on
    /// the machine. Absent: all iterations are made.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub deadline_s: Option<Positive<values::Duration>>,
    /// How long the loop runs in s, positive. Absent: `time.end_s`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub duration_s: Option<Positive<values::Duration>>,
    /// From when on distances of the tip from its reference count, in s, not negative. Absent: after the first sample.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub counted_from_s: Option<NonNegative<values::Time>>,
    /// How long a command takes to be computed, in the loop's own time.
    pub computing: Computing,
    /// That time in s, not negative, with `computing = "fixed"`. Absent: one period.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub computing_s: Option<NonNegative<values::Time>>,
    /// Delay of the actuators that the loop knows of in s, not negative. Absent: that of `[plant.actuator]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub actuator_delay_s: Option<NonNegative<values::Time>>,
    /// Whether the state is predicted over all delays, to when the command acts. Default: true.
    pub predict: bool,
    /// Whether the controller's model takes over the estimated disturbances. Default: true.
    pub compensate: bool,
    /// Seed of the noise. Absent: that of `--seed`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u32>,
    /// What is done where no command can be computed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fallback: Option<Fallback>,
}

/// How long a command takes to be computed, in the loop's own time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Computing {
    /// No time: the command of a sample acts from its beginning.
    #[default]
    None,
    /// A fixed time, which the loop waits for.
    Fixed,
    /// What it takes on this machine: no two runs are the same.
    Measured,
}

/// What is done where no command can be computed: the plan as it is, then damping at the tip, then a ramp to zero.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Fallback {
    /// Age in s of an estimate that is still predicted from, positive. Absent: `age_s` of a sensor and two of its periods, of the slowest one, and at
    /// least 0.1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub patience_s: Option<Positive<values::Duration>>,
    /// Samples in a row that follow the plan, default 10.
    pub plan_samples: usize,
    /// Samples in a row after these that damp the tip where its velocity is known, default 50.
    pub damping_samples: usize,
    /// Time in s in which a ramp goes to zero, positive, default 0.5.
    pub ramp_s: Positive<values::Duration>,
    /// Damping of the tip's force over the critical one of a cantilever's first mode, positive, default 0.5.
    pub damping: Positive<values::Factor>,
}

/// The arm as it is, where it differs from the rod that the controller knows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Plant {
    /// Number of elements, 1 to 5000. Absent: `rod.elements`.
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = 5000)))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub elements: Option<usize>,
    /// Factor on all stiffnesses of the rod, positive, default 1.
    pub stiffness_factor: Positive<values::Factor>,
    /// Factor on the mass and the rotary inertia of the rod, positive, default 1.
    pub density_factor: Positive<values::Factor>,
    /// Rate of viscous damping in 1/s, not negative. Absent: `damping.viscous_1_s`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub viscous_1_s: Option<NonNegative<values::DampingRate>>,
    /// Kelvin-Voigt time in s, not negative. Absent: `damping.internal_s`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub internal_s: Option<NonNegative<values::Time>>,
    /// Curvature and twist without stress in 1/m, body frame. Absent: those of `[rod.reference]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub curvature_1_m: Option<[f64; 3]>,
    /// Section of a rod that has a material. Absent: `[rod.section]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub section: Option<Section>,
    /// A rigid body at the tip, instead of `[payload]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub payload: Option<Payload>,
    /// What lies between a command and the wrench that acts. Absent: it acts at once and exactly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub actuator: Option<PlantActuator>,
}

/// Actuators that are late, slow and limited.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct PlantActuator {
    /// Time in s until a command has any effect, not negative, default 0.
    pub delay_s: NonNegative<values::Time>,
    /// Time constant in s of a first-order lag, not negative, default 0.
    pub lag_s: NonNegative<values::Time>,
    /// Largest force in N, positive. Absent: unbounded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_max_n: Option<Positive<values::Force>>,
    /// Largest moment in N m, positive. Absent: unbounded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moment_max_n_m: Option<Positive<values::Moment>>,
    /// Fastest change of a force in N/s, positive. Absent: unbounded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_rate_max_n_s: Option<Positive<values::ForceRate>>,
    /// Fastest change of a moment in N m/s, positive. Absent: unbounded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moment_rate_max_n_m_s: Option<Positive<values::MomentRate>>,
}

/// What is measured, how often, how late and with what noise. A standard deviation is that of each of three numbers; 0 is exact, and what has
/// none, of its own or by `preset`, is not measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// A usual sensor, whose numbers count where none is given below.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub preset: Option<SensorPreset>,
    /// Where, as fractions of the arm's length from the base.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub places: Option<Vec<f64>>,
    /// Standard deviation of positions in m, not negative.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_sigma_m: Option<NonNegative<values::Deviation>>,
    /// Standard deviation of rotations in rad, not negative.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotation_sigma_rad: Option<NonNegative<values::Deviation>>,
    /// Standard deviation of velocities in m/s, not negative.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity_sigma_m_s: Option<NonNegative<values::Deviation>>,
    /// Standard deviation of angular velocities in rad/s, not negative.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub angular_velocity_sigma_rad_s: Option<NonNegative<values::Deviation>>,
    /// Standard deviation of curvatures and twist in 1/m, not negative.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub curvature_sigma_1_m: Option<NonNegative<values::Deviation>>,
    /// Standard deviation of the force on the clamp in N, not negative.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub base_force_sigma_n: Option<NonNegative<values::Deviation>>,
    /// Standard deviation of the moment on the clamp in N m, not negative.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub base_moment_sigma_n_m: Option<NonNegative<values::Deviation>>,
    /// Measurements a second, positive. Absent: that of `preset`, or 100.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate_hz: Option<Positive<values::Rate>>,
    /// Time in s from the instant of a measurement until it is known, not negative. Absent: that of `preset`, or 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub age_s: Option<NonNegative<values::Time>>,
}

/// How the state becomes known from sensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Estimator {
    /// The method.
    pub kind: EstimatorKind,
    /// Number of elements of the estimator's own model, 1 to 5000. Absent: `rod.elements`.
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = 5000)))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub elements: Option<usize>,
    /// What is estimated besides the state. For an observer both `"tip_force"` and `"tip_moment"`, or nothing. Absent: for a Kalman filter all
    /// of them, for an observer nothing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub disturbances: Option<Vec<Unknown>>,
    /// How fast the unknown wrenches of a Kalman filter change: the deflection over the length that they cause more or less within a second;
    /// not negative. Larger, pushes are followed faster, and the noise of sensors with them. Absent: 0.007.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wrench_change_1_s: Option<NonNegative<values::Rate>>,
}

/// How the state becomes known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum EstimatorKind {
    /// The true state is known at once; sensors play no part.
    None,
    /// The model, with forces and moments in proportion to what is measured otherwise than expected.
    Observer,
    /// An extended Kalman filter.
    Kalman,
}

/// What an estimator may find out besides the state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Unknown {
    /// A force on the tip.
    TipForce,
    /// A moment on the tip.
    TipMoment,
    /// A force all along the arm.
    Distributed,
    /// A factor on the stiffness.
    Stiffness,
    /// A mass on the tip, beyond that of `[payload]`.
    Payload,
    /// Viscous damping, beyond that of `[damping]`.
    Viscous,
    /// Internal damping, beyond that of `[damping]`; of a model with implicit steps.
    Internal,
    /// Delay of the commands, beyond `mpc.actuator_delay_s`.
    Delay,
}

impl Estimator {
    /// What is estimated besides the state.
    pub(crate) fn unknowns(&self) -> &[Unknown] {
        match (&self.disturbances, self.kind) {
            (Some(named), _) => named,
            (None, EstimatorKind::Kalman) => &Unknown::ALL,
            (None, EstimatorKind::None | EstimatorKind::Observer) => &[],
        }
    }
}

impl Unknown {
    /// All of them.
    pub(crate) const ALL: [Self; 8] = [
        Self::TipForce,
        Self::TipMoment,
        Self::Distributed,
        Self::Stiffness,
        Self::Payload,
        Self::Viscous,
        Self::Internal,
        Self::Delay,
    ];
}

/// Jumps are dearer than by default in the library: a model coarser than the arm has its fast modes wrong, and must not chase them.
const JUMP: f64 = 100.0;

impl Default for Mpc {
    fn default() -> Self {
        let settings = MpcSettings::receding(1.0);
        Self {
            period_s: known(settings.period),
            horizon_s: None,
            due_s: None,
            block_s: None,
            equal_blocks: None,
            jump: known(JUMP),
            effort_from: settings.effort,
            target_weight: known(settings.target_weight),
            limit_price: known(settings.limit_price),
            iterations: settings.iterations,
            deadline_s: None,
            duration_s: None,
            counted_from_s: None,
            computing: Computing::default(),
            computing_s: None,
            actuator_delay_s: None,
            predict: true,
            compensate: true,
            seed: None,
            fallback: None,
        }
    }
}

impl Default for Fallback {
    fn default() -> Self {
        let settings = FallbackSettings::default();
        Self {
            patience_s: settings.patience.map(known),
            plan_samples: settings.plan_samples,
            damping_samples: settings.damping_samples,
            ramp_s: known(settings.ramp),
            damping: known(settings.damping),
        }
    }
}

impl Default for Plant {
    fn default() -> Self {
        Self {
            elements: None,
            stiffness_factor: known(1.0),
            density_factor: known(1.0),
            viscous_1_s: None,
            internal_s: None,
            curvature_1_m: None,
            section: None,
            payload: None,
            actuator: None,
        }
    }
}
