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
    /// The motion then: true (the default), the whole arm comes to rest and stays there with the last wrench held; "tip", the tip has
    /// neither velocity nor angular velocity for an instant; false, it passes.
    #[serde(default)]
    pub at_rest: AtRest,
    /// How long the arm stays, in s, positive. Only with `at_rest = true`. Absent: one first period of the held arm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stays_s: Option<Positive<values::Duration>>,
    /// Largest distance of the tip from `position_m` while it stays, in m, positive. Only with `at_rest = true`. Absent: a hundredth of
    /// `rod.length_m`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stays_m: Option<Positive<values::Distance>>,
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
    /// Speed in m/s up to which the tip counts as at rest, not negative; 0 for exactly at rest. Only with `at_rest = "tip"` and `hard`. Absent:
    /// a hundredth of `rod.length_m` per duration of the task.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance_m_s: Option<NonNegative<values::Speed>>,
    /// Angular speed in rad/s up to which the tip counts as at rest, not negative; 0 for exactly at rest. Only with `at_rest = "tip"` and `hard`.
    /// Absent: a tenth of a radian per duration of the task.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance_rad_s: Option<NonNegative<values::AngularSpeed>>,
    /// Points to pass through on the way.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub via: Vec<Via>,
}

/// The motion of an arm at its target.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(from = "AtRestKey", into = "AtRestKey")]
pub enum AtRest {
    /// The whole arm comes to rest and stays.
    #[default]
    Staying,
    /// The tip stops for an instant.
    Tip,
    /// It passes.
    Passing,
}

/// true, "tip", or false.
#[derive(Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(untagged, expecting = "expected true, \"tip\" or false")]
#[cfg_attr(feature = "schema", schemars(rename = "AtRest"))]
enum AtRestKey {
    Word(TipWord),
    Flag(bool),
}

#[derive(Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "schema", schemars(inline))]
enum TipWord {
    Tip,
}

impl From<AtRestKey> for AtRest {
    fn from(key: AtRestKey) -> Self {
        match key {
            AtRestKey::Word(TipWord::Tip) => Self::Tip,
            AtRestKey::Flag(true) => Self::Staying,
            AtRestKey::Flag(false) => Self::Passing,
        }
    }
}

impl From<AtRest> for AtRestKey {
    fn from(rest: AtRest) -> Self {
        match rest {
            AtRest::Staying => Self::Flag(true),
            AtRest::Tip => Self::Word(TipWord::Tip),
            AtRest::Passing => Self::Flag(false),
        }
    }
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
