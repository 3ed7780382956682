//! The closed loop: the controller, the arm as it is, what is measured of it, and what is estimated.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::values::{self, NonNegative, Positive, known};
use super::{Payload, Section};
use crate::mpc::{EffortFrom, FallbackSettings, MpcSettings, SensorPreset};

/// Model-predictive control of an arm, in simulation or, with `softarm mpc --serve`, of a plant in another process. The
/// rod of the scene is the model of the controller, `[control]` bounds its commands, and `[task]` or
/// `[[objective.track]]` is its reference.
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
    /// Time in s at which the task is due, positive: the horizon does not extend beyond it, and shrinks before.
    /// Afterwards the wrench that holds the target acts, if `task.at_rest = true`. Absent: `task.at_s`; without that
    /// the horizon recedes for ever.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub due_s: Option<Positive<values::Instant>>,
    /// Length of a block of the control in s, positive. Absent: a tenth of the horizon.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub block_s: Option<Positive<values::Duration>>,
    /// Number of blocks of one length, after which the next ones are twice as long: near decisions are fine, far ones
    /// coarse; at least 1. Absent: all blocks are equal.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    pub equal_blocks: Option<usize>,
    /// Weight w of w/2 |u - a|², the jump from the control a that acts when a sample begins, in units of
    /// `objective.force_scale_n` and `moment_scale_n_m`; not negative, default 100. If the model is coarser than the
    /// arm, it keeps the controller from reacting to unmodeled fast modes. With a constant hold, which changes by jumps
    /// alone, a jump costs the lesser of this and of a ramp between the middles of two blocks.
    pub jump: NonNegative<values::Weight>,
    /// Control from which effort counts while the horizon recedes; before a due time it counts from zero.
    pub effort_from: EffortFrom,
    /// Weight of the target of `[task]` at the end of the horizon, positive, default 1e4; targets are soft in a loop.
    /// If the horizon recedes, a track takes the place of the target, with ten times the default weight, or with the
    /// default weights if there is an orientation too.
    pub target_weight: Positive<values::Weight>,
    /// Price of obstacles and limits that have no `soft` of their own, as its `linear` and its `quadratic`; positive,
    /// default 5000. A limit holds if its price exceeds the weight of a track times the distance, over the length, by
    /// which the limit keeps the node from its reference. With prices far above that, commands jump.
    pub limit_price: Positive<values::Weight>,
    /// Gauss-Newton iterations per sample, at least 1, default 1. They end early if the plan does not change any more.
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    pub iterations: usize,
    /// Time in s from the start of a sample at which its command is due, positive: an iteration other than the first is
    /// not begun if it would end later. Commands then depend on the machine. Absent: all iterations are made.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub deadline_s: Option<Positive<values::Duration>>,
    /// Duration of the loop in s, positive. Absent: `time.end_s`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub duration_s: Option<Positive<values::Duration>>,
    /// Time in s from which on the errors of the tip count in the summary, not negative. Absent: after the first
    /// sample.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub counted_from_s: Option<NonNegative<values::Time>>,
    /// Computing time of a command in the loop's own time.
    pub computing: Computing,
    /// That time in s, not negative, with `computing = "fixed"`. Absent: one period.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub computing_s: Option<NonNegative<values::Time>>,
    /// Delay of the actuators in s that the controller assumes, not negative. Absent: that of `[plant.actuator]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub actuator_delay_s: Option<NonNegative<values::Time>>,
    /// Whether the state is predicted over all delays, to the time at which the command acts. Default: true.
    pub predict: bool,
    /// Whether the controller's model includes the estimated disturbances. Default: true.
    pub compensate: bool,
    /// Seed of the noise; `--seed` takes precedence. Absent: that of `--seed`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u32>,
    /// Commands of samples for which no command can be computed. Absent: the defaults.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fallback: Option<Fallback>,
}

/// Computing time of a command in the loop's own time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Computing {
    /// No time: the command of a sample acts from its beginning.
    #[default]
    None,
    /// A fixed time, for which the loop waits.
    Fixed,
    /// The time that it takes on this machine: no two runs are the same.
    Measured,
}

/// Commands of samples for which no command can be computed: the plan goes on, then the tip is damped, then the wrench
/// goes to zero along a ramp.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Fallback {
    /// Largest age in s of an estimate from which the state is still predicted, positive. Absent: the largest `age_s`
    /// plus two periods of the slowest sensor, so that one reading may be lost, and at least 0.1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub patience_s: Option<Positive<values::Duration>>,
    /// Samples in a row that follow the plan, default 10.
    pub plan_samples: usize,
    /// Samples in a row after these that damp the tip where its velocity is known, default 50.
    pub damping_samples: usize,
    /// Duration in s of the ramp to zero, positive, default 0.5.
    pub ramp_s: Positive<values::Duration>,
    /// Damping of the tip's force over the critical one of a cantilever's first mode, positive, default 0.5.
    pub damping: Positive<values::Factor>,
}

/// The arm that the controller acts on, where it differs from the controller's model. Its time step is its own.
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
    /// Stress-free curvature and twist in 1/m, body frame. Absent: those of `[rod.reference]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub curvature_1_m: Option<[f64; 3]>,
    /// Section of a rod that has a material. Absent: `[rod.section]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub section: Option<Section>,
    /// A rigid body at the tip. Absent: `[payload]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub payload: Option<Payload>,
    /// Dynamics and limits of the actuators. Absent: the wrench is the command.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub actuator: Option<PlantActuator>,
}

/// Actuators that are late, slow and limited; the limits are norms of the wrench that acts.
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

/// A sensor with its noise, rate and age; a single one may be written as `[sensor]`. A standard deviation is that of
/// each of three numbers, and 0 is exact; a quantity without a standard deviation, of its own or by `preset`, is not
/// measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Usual sensor, which supplies the keys below that are not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub preset: Option<SensorPreset>,
    /// Places of the measurement, as fractions of the length from the base. Absent: those of `preset`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub places: Option<Vec<f64>>,
    /// Standard deviation of positions in m, not negative. Absent: that of `preset`, or not measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_sigma_m: Option<NonNegative<values::Deviation>>,
    /// Standard deviation of rotations in rad, not negative. Absent: that of `preset`, or not measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotation_sigma_rad: Option<NonNegative<values::Deviation>>,
    /// Standard deviation of velocities in m/s, not negative. Absent: that of `preset`, or not measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity_sigma_m_s: Option<NonNegative<values::Deviation>>,
    /// Standard deviation of angular velocities in rad/s, not negative. Absent: that of `preset`, or not measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub angular_velocity_sigma_rad_s: Option<NonNegative<values::Deviation>>,
    /// Standard deviation of curvatures and twist in 1/m, not negative. Absent: that of `preset`, or not measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub curvature_sigma_1_m: Option<NonNegative<values::Deviation>>,
    /// Standard deviation of the force on the clamp in N, not negative. Absent: that of `preset`, or not measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub base_force_sigma_n: Option<NonNegative<values::Deviation>>,
    /// Standard deviation of the moment on the clamp in N m, not negative. Absent: that of `preset`, or not measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub base_moment_sigma_n_m: Option<NonNegative<values::Deviation>>,
    /// Measurements per second, positive. The default of `mpc.fallback.patience_s` depends on it. Absent: that of
    /// `preset`, or 100.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate_hz: Option<Positive<values::Rate>>,
    /// Time in s from the instant of a measurement until it is known, not negative. Absent: that of `preset`, or 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub age_s: Option<NonNegative<values::Time>>,
}

/// Estimator of the state from sensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Estimator {
    /// Method.
    pub kind: EstimatorKind,
    /// Number of elements of the estimator's own model, 1 to 5000. The cost of a Kalman filter grows with its third
    /// power. Ten follow a path as well as more; an arm that stands still may be off by the difference of the two
    /// models. Absent: `rod.elements`.
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = 5000)))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub elements: Option<usize>,
    /// Unknowns that are estimated besides the state. For an observer both `"tip_force"` and `"tip_moment"`, or
    /// nothing. Absent: for a Kalman filter all of them, for an observer nothing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub disturbances: Option<Vec<Unknown>>,
    /// Rate of change of the unknown wrenches of a Kalman filter: the deflection over the length that they typically
    /// cause within a second; not negative. With a larger rate, the estimate follows pushes faster, and the noise of
    /// the sensors too. Absent: 0.007.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wrench_change_1_s: Option<NonNegative<values::Rate>>,
}

/// Method of an estimator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum EstimatorKind {
    /// The true state is known at once; sensors play no part.
    None,
    /// The model, with forces and moments in proportion to the difference between measurement and model.
    Observer,
    /// An extended Kalman filter.
    Kalman,
}

/// Unknown that an estimator finds besides the state.
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
