//! The first node, held, moved or free.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::values::{self, Positive};
use crate::mechanics::LoadFrame;
use crate::mechanics::rotation::unit;

/// Pose and motion of the first node.
///
/// The arm at rest leaves the base along `direction`, which is the third axis of the base's frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Base {
    /// Whether the base is held, driven, or free.
    pub kind: BaseKind,
    /// Position in m; for a driven base, the position from which it moves. Default: the origin.
    pub position_m: [f64; 3],
    /// Direction of the arm at the base, of any length but zero. Default: [0, 0, 1].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub direction: Option<[f64; 3]>,
    /// Rotation about `direction` in rad, after the shortest rotation of +z onto it. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roll_rad: Option<f64>,
    /// Orientation of the base as a quaternion, scalar first, of any length but zero; instead of `direction` and
    /// `roll_rad`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Prescribed motion of a driven base.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion: Option<BaseMotion>,
}

/// Prescribed motion of the base: the sum of a uniform motion, curves through tables, and oscillations.
///
/// Translations are displacements from `base.position_m` in the spatial frame. Rotations are rotation vectors r: the
/// orientation at time t is exp(r(t)) times the given one, or with `rotation_frame = "body"` the given one times
/// exp(r(t)). Rotation vectors of several terms add up. At t = 0 the arm has its shape where the base is then, and
/// moves with it as a rigid body.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct BaseMotion {
    /// Constant velocity in m/s. Default: none.
    pub velocity_m_s: [f64; 3],
    /// Constant angular velocity in rad/s. Default: none.
    pub angular_velocity_rad_s: [f64; 3],
    /// Displacement in m over time, as [t in s, x, y, z] with increasing t: the cubic spline through the points that
    /// starts and ends with zero velocity; constant before and after.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub translation_m: Option<Vec<[f64; 4]>>,
    /// Rotation vector in rad over time, as [t in s, x, y, z], by the same kind of spline.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotation_rad: Option<Vec<[f64; 4]>>,
    /// Frame of all rotation vectors: the spatial one, or that of the base as it is given, whose third axis is the
    /// arm's direction there.
    pub rotation_frame: LoadFrame,
    /// Harmonic terms.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub oscillation: Vec<Oscillation>,
}

/// A harmonic motion, amplitude times sin(2π f t + phase) - sin(phase): zero at t = 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Oscillation {
    /// Amplitude of the displacement in m. Default: none.
    #[serde(default)]
    pub translation_m: [f64; 3],
    /// Amplitude of the rotation vector in rad. Default: none.
    #[serde(default)]
    pub rotation_rad: [f64; 3],
    /// Frequency f in Hz, positive.
    pub frequency_hz: Positive<values::Frequency>,
    /// Phase in rad, default 0; π/2 starts without velocity.
    #[serde(default)]
    pub phase_rad: f64,
}

/// Condition of the first node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum BaseKind {
    /// Position and orientation are held.
    #[default]
    Clamped,
    /// Position and orientation follow `base.motion`.
    Driven,
    /// The base moves like any other node.
    Free,
}

impl Default for Base {
    fn default() -> Base {
        Base {
            kind: BaseKind::default(),
            position_m: [0.0; 3],
            direction: None,
            roll_rad: None,
            orientation_wxyz: None,
            motion: None,
        }
    }
}

impl Base {
    /// The base's orientation as a unit quaternion, scalar first: the rotation from its body frame to the spatial
    /// frame. With a direction `d` it is the shortest rotation of e3 onto `d` times the rotation by `roll` about e3;
    /// for `d = -e3` the shortest rotation is the half turn about e1.
    pub fn unit_quaternion(&self) -> [f64; 4] {
        if let Some(orientation) = self.orientation_wxyz {
            return unit(orientation);
        }
        let [x, y, z] = unit(self.direction.unwrap_or([0.0, 0.0, 1.0]));
        // 1 + z, without cancellation where d is close to -e3.
        let one_plus_z = if z < 0.0 {
            (x * x + y * y) / (1.0 - z)
        } else {
            1.0 + z
        };
        let [w, i, j, _] = if one_plus_z > 0.0 {
            unit([one_plus_z, -y, x, 0.0])
        } else {
            [0.0, 1.0, 0.0, 0.0]
        };
        let (sin, cos) = (0.5 * self.roll_rad.unwrap_or(0.0)).sin_cos();
        [w * cos, i * cos + j * sin, j * cos - i * sin, w * sin]
    }
}
