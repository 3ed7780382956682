//! The first node, held, moved or free.

use nalgebra::{Matrix3, Vector3};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::error::DescribeError;
use super::super::keys::{Checked, Keys};
use super::super::values::{self, Positive, known};
use crate::mechanics::rotation::unit;
use crate::mechanics::{self, CubicSpline, LoadFrame, MotionCurve, RodError};

/// Pose and motion of the first node.
///
/// The arm at rest leaves the base along `direction`, which is the third axis of the base's frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Base {
    /// Condition of the base: held, driven, or free.
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

impl Keys<'_> {
    pub(in crate::scene) fn check_base(&self, base: &Base) -> Checked {
        self.finite("base.position_m", &base.position_m)?;
        if let Some(direction) = &base.direction {
            self.nonzero("base.direction", direction)?;
        }
        if let Some(roll) = base.roll_rad {
            self.finite_number("base.roll_rad", roll)?;
        }
        if let Some(orientation) = &base.orientation_wxyz {
            self.nonzero("base.orientation_wxyz", orientation)?;
            if base.direction.is_some() {
                return Err(self.contradiction("base.orientation_wxyz", "base.direction"));
            }
            if base.roll_rad.is_some() {
                return Err(self.contradiction("base.orientation_wxyz", "base.roll_rad"));
            }
        }
        match (&base.motion, base.kind) {
            (Some(motion), BaseKind::Driven) => self.check_motion(motion),
            (None, BaseKind::Driven) => Err(self.missing(
                "base.motion",
                "a driven base needs to know how it moves, for example velocity_m_s = [0.1, 0, 0]",
            )),
            (Some(_), BaseKind::Clamped | BaseKind::Free) => Err(self.source.error_at(
                "base.motion",
                "only a driven base has a given motion",
                Some("set base.kind = \"driven\", or leave base.motion out".to_string()),
            )),
            (None, BaseKind::Clamped | BaseKind::Free) => Ok(()),
        }
    }

    fn check_motion(&self, motion: &BaseMotion) -> Checked {
        self.finite("base.motion.velocity_m_s", &motion.velocity_m_s)?;
        self.finite(
            "base.motion.angular_velocity_rad_s",
            &motion.angular_velocity_rad_s,
        )?;
        if let Some(table) = &motion.translation_m {
            self.table("base.motion.translation_m", table, "no translation")?;
        }
        if let Some(table) = &motion.rotation_rad {
            self.table("base.motion.rotation_rad", table, "no rotation")?;
        }
        for (index, oscillation) in motion.oscillation.iter().enumerate() {
            let key = |name: &str| format!("base.motion.oscillation.{index}.{name}");
            self.finite(&key("translation_m"), &oscillation.translation_m)?;
            self.finite(&key("rotation_rad"), &oscillation.rotation_rad)?;
            self.finite_number(&key("phase_rad"), oscillation.phase_rad)?;
        }
        Ok(())
    }
}

/// Returns the motion of a base with this orientation: `exp(r) R_b = R_b exp(R_bᵀ r)` turns spatial rotation vectors into those of its
/// frame.
pub(in crate::scene) fn base_motion(
    motion: &BaseMotion,
    orientation: &Matrix3<f64>,
) -> Result<mechanics::BaseMotion, RodError> {
    let curve = |rate: [f64; 3],
                 table: &Option<Vec<[f64; 4]>>,
                 amplitude: fn(&Oscillation) -> [f64; 3],
                 own: Matrix3<f64>|
     -> Result<MotionCurve, RodError> {
        let point = |&[t, x, y, z]: &[f64; 4]| (t, own * Vector3::new(x, y, z));
        let table = table
            .as_ref()
            .map(|rows| CubicSpline::through(&rows.iter().map(point).collect::<Vec<_>>()));
        let oscillations = motion.oscillation.iter().map(|o| mechanics::Oscillation {
            amplitude: own * Vector3::from(amplitude(o)),
            frequency: o.frequency_hz.get(),
            phase: o.phase_rad,
        });
        Ok(MotionCurve {
            rate: own * Vector3::from(rate),
            table: table.transpose()?,
            oscillations: oscillations.collect(),
        })
    };
    let turned = match motion.rotation_frame {
        LoadFrame::Spatial => orientation.transpose(),
        LoadFrame::Body => Matrix3::identity(),
    };
    Ok(mechanics::BaseMotion {
        translation: curve(
            motion.velocity_m_s,
            &motion.translation_m,
            |o| o.translation_m,
            Matrix3::identity(),
        )?,
        rotation: curve(
            motion.angular_velocity_rad_s,
            &motion.rotation_rad,
            |o| o.rotation_rad,
            turned,
        )?,
    })
}

pub(in crate::scene) fn described_motion(
    motion: &mechanics::BaseMotion,
) -> Result<BaseMotion, DescribeError> {
    let table = |curve: &MotionCurve| {
        (curve.table.as_ref()).map(|table| {
            (table.points())
                .map(|(t, x)| [t, x.x, x.y, x.z])
                .collect::<Vec<_>>()
        })
    };
    let (translation, rotation) = (&motion.translation, &motion.rotation);
    let pairs = || translation.oscillations.iter().zip(&rotation.oscillations);
    let belong = |(a, b): (&mechanics::Oscillation, &mechanics::Oscillation)| {
        (a.frequency, a.phase) == (b.frequency, b.phase)
    };
    if translation.oscillations.len() != rotation.oscillations.len() || !pairs().all(belong) {
        return Err(DescribeError(
            "its base translates and rotates at different frequencies",
        ));
    }
    Ok(BaseMotion {
        velocity_m_s: translation.rate.into(),
        angular_velocity_rad_s: rotation.rate.into(),
        translation_m: table(translation),
        rotation_rad: table(rotation),
        rotation_frame: LoadFrame::Body,
        oscillation: pairs()
            .map(|(translation, rotation)| Oscillation {
                translation_m: translation.amplitude.into(),
                rotation_rad: rotation.amplitude.into(),
                frequency_hz: known(translation.frequency),
                phase_rad: translation.phase,
            })
            .collect(),
    })
}
