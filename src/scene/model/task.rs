//! Where the tip should be, when, and what it passes on the way.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::values::{self, NonNegative, Number, Positive};
use super::LoadNode;

/// Where the tip should be: a position, an orientation, or both.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Task {
    /// Position of the tip in m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_m: Option<[f64; 3]>,
    /// Orientation of the tip as a quaternion, scalar first, of any length but zero.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation_wxyz: Option<[f64; 4]>,
    /// When, in s; above 0 and up to `time.end_s`, which is the default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at_s: Option<Positive<values::Instant>>,
    /// Choose the duration of the task as well; `at_s` is where the search begins. Absent: the task is due at `at_s`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub free_duration: Option<FreeDuration>,
    /// Whether the tip should be at rest then: no velocity and no angular velocity. Default: true.
    #[serde(default = "yes")]
    pub at_rest: bool,
    /// Whether the task is a constraint (true, the default) or a term of the objective.
    #[serde(default = "yes")]
    pub hard: bool,
    /// Weight of that term, positive; only with `hard = false`. Default: one that reaches, so that about a thousandth of the way is missed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weight: Option<Positive<values::Weight>>,
    /// Distance in m from `position_m` that is near enough, positive. Absent: the position is met exactly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance_m: Option<Positive<values::Distance>>,
    /// Angle in rad from `orientation_wxyz` that is near enough, positive and below π. Absent: the orientation is met exactly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance_rad: Option<Positive<values::Angle>>,
    /// Speed in m/s up to which the tip counts as at rest, not negative; 0 for exactly at rest. Only with `at_rest` and `hard`. Absent:
    /// a hundredth of `rod.length_m` per duration of the task.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance_m_s: Option<NonNegative<values::Speed>>,
    /// Angular speed in rad/s up to which the tip counts as at rest, not negative; 0 for exactly at rest. Only with `at_rest` and `hard`.
    /// Absent: a tenth of a radian per duration of the task.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance_rad_s: Option<NonNegative<values::AngularSpeed>>,
    /// Points to pass through on the way.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub via: Vec<Via>,
}

/// A duration that the optimizer chooses. Blocks of the control, points on the way and samples stretch with it; loads and paths to
/// follow keep to the clock.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct FreeDuration {
    /// Shortest, s; positive.
    pub shortest_s: Positive<values::Duration>,
    /// Longest, s; not below `shortest_s`. The time step is chosen for this one.
    pub longest_s: Positive<values::Duration>,
    /// What a second costs, a pure number like the effort's: as much as a control of the size sqrt(2 price/effort) costs that is held for a
    /// second, in units of `objective.force_scale_n` or `moment_scale_n_m`. Not negative, default 1. With `objective.effort = 0` (and
    /// `rate = 0`) only time counts, whatever its price: minimum time, for which the controls need bounds.
    #[serde(default = "NonNegative::<values::PriceOfTime>::one")]
    pub price: NonNegative<values::PriceOfTime>,
}

/// A point to pass through: a position, an orientation, or both.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Via {
    /// When, in s; above 0 and before the task's own time. The nearest time node counts.
    pub at_s: Positive<values::Instant>,
    /// Which node passes. Default: "tip".
    #[serde(default)]
    pub node: LoadNode,
    /// Position in m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_m: Option<[f64; 3]>,
    /// Orientation as a quaternion, scalar first, of any length but zero.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Whether it is a constraint (true, the default) or a term of the objective.
    #[serde(default = "yes")]
    pub hard: bool,
    /// Weight of that term, positive; only with `hard = false`. Default: one that reaches, so that about a thousandth of the way is missed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weight: Option<Positive<values::Weight>>,
    /// Distance in m from `position_m` that is near enough, positive. Absent: the position is met exactly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance_m: Option<Positive<values::Distance>>,
    /// Angle in rad from `orientation_wxyz` that is near enough, positive and below π. Absent: the orientation is met exactly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance_rad: Option<Positive<values::Angle>>,
}

impl Task {
    /// When the tip should be there, in s, given the duration of the scene.
    pub fn instant(&self, end_s: f64) -> f64 {
        self.at_s.map_or(end_s, Number::get)
    }
}

fn yes() -> bool {
    true
}
