//! Where the tip should be, when, and what it passes on the way.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::values::{self, NonNegative, Number, Positive};
use super::LoadNode;

/// Target of the tip: a position, an orientation, or both.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Task {
    /// Position of the tip in m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_m: Option<[f64; 3]>,
    /// Orientation of the tip as a quaternion, scalar first, of any length but zero. The arm reaches it by more than
    /// half a turn if rows of a track or waypoints lead there so, or if that bends the arm less.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Time in s at which the target is due, above 0 and up to `time.end_s`; the horizon of a solve ends then. Absent:
    /// `time.end_s`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at_s: Option<Positive<values::Instant>>,
    /// Free final time: the duration of the task is chosen too, and `at_s` is its initial guess. Absent: the task is
    /// due at `at_s`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub free_duration: Option<FreeDuration>,
    /// Motion at `at_s`: with true, the whole arm comes to rest and stays there with the last wrench held; with "tip",
    /// the tip has neither velocity nor angular velocity at that instant; with false, the tip passes.
    #[serde(default)]
    pub at_rest: AtRest,
    /// Time in s for which the arm stays, positive. Only with `at_rest = true`. Absent: one first period of the held
    /// arm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stays_s: Option<Positive<values::Duration>>,
    /// Largest distance of the tip from `position_m` while it stays, in m, positive. Only with `at_rest = true`. Absent: a hundredth of
    /// `rod.length_m`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stays_m: Option<Positive<values::Distance>>,
    /// Whether the target is a constraint (true) or a term of the objective (false).
    #[serde(default = "yes")]
    pub hard: bool,
    /// Weight of that term, positive; only with `hard = false`. Absent: one that misses the target by about a
    /// thousandth of the way.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weight: Option<Positive<values::Weight>>,
    /// Tolerance in m of the distance from `position_m`, positive. Absent: the position is met exactly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance_m: Option<Positive<values::Distance>>,
    /// Tolerance in rad of the angle from `orientation_wxyz`, positive and below π. Absent: the orientation is met
    /// exactly.
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
    /// Waypoints that the arm passes on the way.
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

/// Free final time. Blocks of the control, waypoints and samples scale with the duration; loads and paths to follow
/// keep to the clock.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct FreeDuration {
    /// Shortest duration in s, positive.
    pub shortest_s: Positive<values::Duration>,
    /// Longest duration in s, not below `shortest_s`. The time step is chosen for this one.
    pub longest_s: Positive<values::Duration>,
    /// Cost of a second in 1/s, not negative, default 1: as much as a control of the size sqrt(2 price/effort) costs
    /// that is held for a second, in units of `objective.force_scale_n` or `moment_scale_n_m`. With `objective.effort =
    /// 0` and `rate = 0` only time counts, whatever its price: this is minimum time, for which the controls need
    /// bounds.
    #[serde(default = "NonNegative::<values::PriceOfTime>::one")]
    pub price: NonNegative<values::PriceOfTime>,
}

/// A waypoint: a position, an orientation, or both.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Via {
    /// Time of passage in s, above 0 and before the task's own time. The nearest time node counts.
    pub at_s: Positive<values::Instant>,
    /// Node that passes. Default: "tip".
    #[serde(default)]
    pub node: LoadNode,
    /// Position in m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_m: Option<[f64; 3]>,
    /// Orientation as a quaternion, scalar first, of any length but zero.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Whether the waypoint is a constraint (true) or a term of the objective (false).
    #[serde(default = "yes")]
    pub hard: bool,
    /// Weight of that term, positive; only with `hard = false`. Absent: one that misses the waypoint by about a
    /// thousandth of the way.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weight: Option<Positive<values::Weight>>,
    /// Tolerance in m of the distance from `position_m`, positive. Absent: the position is met exactly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance_m: Option<Positive<values::Distance>>,
    /// Tolerance in rad of the angle from `orientation_wxyz`, positive and below π. Absent: the orientation is met
    /// exactly.
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
