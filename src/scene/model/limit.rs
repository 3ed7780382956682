//! What the arm keeps clear of, and the limits on its strains and speeds.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::values::{self, NonNegative, Positive};
use super::LoadNode;

/// A body that the arm stays clear of, with its own radius around its center line: exactly one of the four shapes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Obstacle {
    /// Name in reports. Default: "obstacle" and its number, from 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// All points within a distance of a center.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sphere: Option<Sphere>,
    /// All points within a distance of a segment.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub capsule: Option<Capsule>,
    /// All points behind a plane.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub half_space: Option<HalfSpace>,
    /// A box.
    #[serde(rename = "box", skip_serializing_if = "Option::is_none")]
    pub cuboid: Option<Cuboid>,
    /// Velocity of the obstacle in m/s; its shape is that at t = 0. Absent: it does not move.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity_m_s: Option<[f64; 3]>,
    /// Clearance in m between the arm's surface and the body, not negative, default 0.
    #[serde(default)]
    pub margin_m: NonNegative<values::Clearance>,
    /// Price of a violation. Absent: the constraint is hard.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub soft: Option<Price>,
    /// Times per second at which the clearance is enforced, positive; the check looks between them. Absent: every time
    /// step, or about 1000 times of a longer motion.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate_hz: Option<Positive<values::Rate>>,
}

/// All points within a distance of a center.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Sphere {
    /// Center in m.
    pub center_m: [f64; 3],
    /// Radius in m, positive.
    pub radius_m: Positive<values::Radius>,
}

/// All points within a distance of a segment: a cylinder with round ends.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Capsule {
    /// One end of the axis in m.
    pub from_m: [f64; 3],
    /// The other end of the axis in m.
    pub to_m: [f64; 3],
    /// Radius in m, positive.
    pub radius_m: Positive<values::Radius>,
}

/// All points behind a plane.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct HalfSpace {
    /// A point of the plane in m.
    pub point_m: [f64; 3],
    /// Direction out of the obstacle, of any length but zero.
    pub normal: [f64; 3],
}

/// A box.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Cuboid {
    /// Center in m.
    pub center_m: [f64; 3],
    /// Whole edges in m, positive.
    pub size_m: [Positive<values::Edge>; 3],
    /// Orientation as a quaternion, scalar first, of any length but zero. Default: along the axes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation_wxyz: Option<[f64; 4]>,
}

/// Price of a violation d, in the units of the objective: `linear` times d and `quadratic` times d²/2, per second.
/// Distances are divided by the length of the arm, curvatures multiplied by it, and speeds divided by length over time
/// scale; stretch counts as it is. A linear price above the constraint's multiplier enforces the constraint exactly.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Price {
    /// Price of a violation of 1 for a second; not negative, default 0.
    #[serde(default)]
    pub linear: NonNegative<values::PriceOfViolation>,
    /// Price of half of its square; not negative, default 0; one of the two is positive.
    #[serde(default)]
    pub quadratic: NonNegative<values::PriceOfViolation>,
}

/// A limit on the strain of every element, or on the speed of a node: exactly one of the four.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Limit {
    /// Name in reports. Default: the key of what is limited.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Smallest and largest length of an element, over its length at rest. The model of the section holds for about
    /// [0.7, 1.3].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stretch: Option<[f64; 2]>,
    /// Largest bending curvature in 1/m, positive.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub curvature_max_1_m: Option<Positive<values::LargestCurvature>>,
    /// Largest twist in 1/m, positive.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub twist_max_1_m: Option<Positive<values::LargestCurvature>>,
    /// Largest speed of a node in m/s, positive.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed_max_m_s: Option<Positive<values::LargestSpeed>>,
    /// Node whose speed is limited; only with `speed_max_m_s`. Absent: "tip".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub node: Option<LoadNode>,
    /// Price of a violation. Absent: the constraint is hard.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub soft: Option<Price>,
    /// Times per second at which the limit is enforced, positive; the check looks between them. Absent: every time
    /// step, or about 1000 times of a longer motion.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate_hz: Option<Positive<values::Rate>>,
}

impl Limit {
    /// Name in reports and errors: its own, or the key of what is limited.
    #[must_use]
    pub fn name(&self) -> String {
        limit_name(self.name.as_deref(), |key| match key {
            "stretch" => self.stretch.is_some(),
            "curvature_max_1_m" => self.curvature_max_1_m.is_some(),
            "twist_max_1_m" => self.twist_max_1_m.is_some(),
            _ => self.speed_max_m_s.is_some(),
        })
    }
}

/// Name of a limit: its own, or the first word of the first key that is given.
pub(in crate::scene) fn limit_name(own: Option<&str>, is_given: impl Fn(&str) -> bool) -> String {
    const KINDS: [(&str, &str); 4] = [
        ("stretch", "stretch"),
        ("curvature", "curvature_max_1_m"),
        ("twist", "twist_max_1_m"),
        ("speed", "speed_max_m_s"),
    ];
    let kind = || KINDS.iter().find(|(_, key)| is_given(key));
    own.or_else(|| kind().map(|(name, _)| *name))
        .unwrap_or("without a kind")
        .to_string()
}

/// Name of an obstacle: its own, or its place in the list.
pub(in crate::scene) fn obstacle_name(own: Option<&str>, index: usize) -> String {
    own.map_or_else(|| format!("obstacle {index}"), str::to_string)
}

impl Obstacle {
    /// Name in reports and errors: its own, or its place in the list.
    #[must_use]
    pub fn name(&self, index: usize) -> String {
        obstacle_name(self.name.as_deref(), index)
    }
}
