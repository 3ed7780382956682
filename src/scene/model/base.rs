//! The two ends of the arm: held, moved or free.

use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::error::DescribeError;
use super::super::keys::{Checked, Excludes, Keys, Needs, given, given_of};
use super::super::values::{self, Positive, known};
use crate::mechanics::rotation::unit;
use crate::mechanics::{self, CubicSpline, EndCondition, LoadFrame, MotionCurve, RodError};

/// Pose and motion of the first node.
///
/// The arm at rest leaves the base along `direction`, which is the third axis of the base's frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Base {
    /// Condition of the base: clamped, pinned, driven, or free.
    pub kind: EndKind,
    /// Position in m; for a driven base, the position from which it moves. Default: the origin.
    pub position_m: [f64; 3],
    /// Direction of the arm at the base, of any length but zero. Default: [0, 0, 1].
    pub direction: Option<[f64; 3]>,
    /// Rotation about `direction` in rad, after the shortest rotation of +z onto it, for -z a half turn about +x. Default: 0.
    pub roll_rad: Option<f64>,
    /// Orientation of the base as a quaternion, scalar first, of any length but zero; instead of `direction` and
    /// `roll_rad`.
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Axis of a pinned base that is a hinge, spatial frame, of any length but zero. Default: none, a ball joint.
    pub axis: Option<[f64; 3]>,
    /// Prescribed motion of a driven base.
    pub motion: Option<BaseMotionKeys>,
}

/// Condition of the tip, and the pose in which it is held.
///
/// Without a pose, the tip is held where the arm at rest ends. With another pose, the arm starts from its equilibrium there
/// (`initial.shape = "equilibrium"`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Tip {
    /// Condition of the tip: clamped, pinned, driven, or free.
    #[schemars(default = "free_tip")]
    pub kind: EndKind,
    /// Position in m in which the tip is held; for a driven tip, the position from which it moves. Default: where the arm at rest ends.
    pub position_m: Option<[f64; 3]>,
    /// Direction in which the arm arrives at its tip, of any length but zero. Default: that of the arm at rest.
    pub direction: Option<[f64; 3]>,
    /// Rotation about `direction` in rad, after the shortest rotation of +z onto it, for -z a half turn about +x. Default: 0.
    pub roll_rad: Option<f64>,
    /// Orientation of the tip as a quaternion, scalar first, of any length but zero; instead of `direction` and
    /// `roll_rad`.
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Axis of a pinned tip that is a hinge, spatial frame, of any length but zero. Default: none, a ball joint.
    pub axis: Option<[f64; 3]>,
    /// Prescribed motion of a driven tip, relative to the pose in which it is held.
    pub motion: Option<BaseMotionKeys>,
}

fn free_tip() -> EndKind {
    EndKind::Free
}

impl Default for Tip {
    fn default() -> Tip {
        Tip {
            kind: free_tip(),
            position_m: None,
            direction: None,
            roll_rad: None,
            orientation_wxyz: None,
            axis: None,
            motion: None,
        }
    }
}

/// Prescribed motion of a driven end: the sum of a uniform motion, curves through tables, and oscillations.
///
/// Translations are displacements from `position_m` of the end, in the spatial frame. Rotations are rotation vectors r: the
/// orientation at time t is exp(r(t)) times the given one, or with `rotation_frame = "body"` the given one times
/// exp(r(t)). Rotation vectors of several terms add up. At t = 0 the arm has its shape where a driven base is then, and
/// moves with it as a rigid body.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct BaseMotionKeys {
    /// Constant velocity in m/s. Default: none.
    pub velocity_m_s: [f64; 3],
    /// Constant angular velocity in rad/s. Default: none.
    pub angular_velocity_rad_s: [f64; 3],
    /// Displacement in m over time, as [t in s, x, y, z] with increasing t: the cubic spline through the points that
    /// starts and ends with zero velocity; constant before and after.
    pub translation_m: Option<Vec<[f64; 4]>>,
    /// Rotation vector in rad over time, as [t in s, x, y, z], by the same kind of spline. Rows of at most half a turn, as logarithms of
    /// orientations have them, turn the shorter way: of the vectors r + 2πk r/|r| of a row, which are one orientation, the nearest to the
    /// row before is taken. A table with a longer row is taken as it is written, turns of more than half a turn from row to row included.
    pub rotation_rad: Option<Vec<[f64; 4]>>,
    /// Frame of all rotation vectors: the spatial one, or that of the base as it is given, whose third axis is the
    /// arm's direction there.
    pub rotation_frame: LoadFrame,
    /// Harmonic terms.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub oscillation: Vec<OscillationKeys>,
}

/// A harmonic motion, amplitude times sin(2π f t + phase) - sin(phase): zero at t = 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OscillationKeys {
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

/// Condition of an end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum EndKind {
    /// Position and orientation are held.
    #[default]
    Clamped,
    /// The position is held; the orientation is free, or with `axis` turns about it alone.
    Pinned,
    /// Position and orientation follow `motion`.
    Driven,
    /// The end moves like any other node.
    Free,
}

impl EndKind {
    /// Returns the word of the scene file.
    pub(in crate::scene) fn name(self) -> &'static str {
        match self {
            Self::Clamped => "clamped",
            Self::Pinned => "pinned",
            Self::Driven => "driven",
            Self::Free => "free",
        }
    }
}

impl Base {
    /// The base's orientation as a unit quaternion, scalar first: the rotation from its body frame to the spatial
    /// frame. With a direction `d` it is the shortest rotation of e3 onto `d` times the rotation by `roll` about e3;
    /// for `d = -e3` the shortest rotation is the half turn about e1.
    pub fn unit_quaternion(&self) -> [f64; 4] {
        unit_quaternion(self.orientation_wxyz, self.direction, self.roll_rad)
    }
}

impl Tip {
    /// The tip's orientation as [`Base::unit_quaternion`] has it; `None` for that of the arm at rest.
    pub fn unit_quaternion(&self) -> Option<[f64; 4]> {
        let is_given = self.orientation_wxyz.is_some() || self.direction.is_some();
        is_given.then(|| unit_quaternion(self.orientation_wxyz, self.direction, self.roll_rad))
    }
}

fn unit_quaternion(
    orientation: Option<[f64; 4]>,
    direction: Option<[f64; 3]>,
    roll: Option<f64>,
) -> [f64; 4] {
    if let Some(orientation) = orientation {
        return unit(orientation);
    }
    let [x, y, z] = unit(direction.unwrap_or([0.0, 0.0, 1.0]));
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
    let (sin, cos) = (0.5 * roll.unwrap_or(0.0)).sin_cos();
    [w * cos, i * cos + j * sin, j * cos - i * sin, w * sin]
}

/// The keys that both ends have.
struct End<'a> {
    name: &'static str,
    kind: EndKind,
    direction: Option<[f64; 3]>,
    roll_rad: Option<f64>,
    orientation_wxyz: Option<[f64; 4]>,
    axis: Option<[f64; 3]>,
    motion: Option<&'a BaseMotionKeys>,
}

impl super::Scene {
    /// Returns the condition of the tip.
    pub(in crate::scene) fn tip_kind(&self) -> EndKind {
        self.tip.as_ref().map_or(EndKind::Free, |tip| tip.kind)
    }
}

impl Keys<'_> {
    pub(in crate::scene) fn check_base(&self, base: &Base) -> Checked {
        self.finite("base.position_m", &base.position_m)?;
        self.check_end(&End {
            name: "base",
            kind: base.kind,
            direction: base.direction,
            roll_rad: base.roll_rad,
            orientation_wxyz: base.orientation_wxyz,
            axis: base.axis,
            motion: base.motion.as_ref(),
        })
    }

    pub(in crate::scene) fn check_tip(&self, tip: &Tip) -> Checked {
        if let Some(position) = &tip.position_m {
            self.finite("tip.position_m", position)?;
        }
        let pose = given!(tip: position_m, direction, orientation_wxyz);
        if tip.kind == EndKind::Free
            && let Some(key) = given_of(&pose).next()
        {
            let help = "set tip.kind = \"clamped\" or \"pinned\", or leave the key out";
            let message = "a free tip is not held in any pose";
            return Err((self.source).error_at(&format!("tip.{key}"), message, Some(help.into())));
        }
        let [roll, direction] = given!(tip: roll_rad, direction);
        self.relations("tip", &[Needs(roll, direction, "goes with tip.roll_rad")])?;
        if let Some(motion) = &tip.motion {
            let turns = motion.angular_velocity_rad_s != [0.0; 3]
                || motion.rotation_rad.is_some()
                || motion
                    .oscillation
                    .iter()
                    .any(|o| o.rotation_rad != [0.0; 3]);
            let in_space = motion.rotation_frame == LoadFrame::Spatial;
            if turns && in_space && tip.unit_quaternion().is_none() {
                return Err(self.missing(
                    "tip.direction",
                    "a tip that turns in the spatial frame needs its orientation; or set tip.motion.rotation_frame = \"body\"",
                ));
            }
        }
        self.check_end(&End {
            name: "tip",
            kind: tip.kind,
            direction: tip.direction,
            roll_rad: tip.roll_rad,
            orientation_wxyz: tip.orientation_wxyz,
            axis: tip.axis,
            motion: tip.motion.as_ref(),
        })
    }

    fn check_end(&self, end: &End) -> Checked {
        let key = |name: &str| format!("{}.{name}", end.name);
        if let Some(direction) = &end.direction {
            self.nonzero(&key("direction"), direction)?;
        }
        if let Some(roll) = end.roll_rad {
            self.finite_number(&key("roll_rad"), roll)?;
        }
        if let Some(orientation) = &end.orientation_wxyz {
            self.nonzero(&key("orientation_wxyz"), orientation)?;
        }
        let [orientation, direction, roll] = given!(end: orientation_wxyz, direction, roll_rad);
        let rows = [
            Excludes(orientation, direction),
            Excludes(orientation, roll),
        ];
        self.relations(end.name, &rows)?;
        if let Some(axis) = &end.axis {
            self.nonzero(&key("axis"), axis)?;
            if end.kind != EndKind::Pinned {
                let message = format!("only a pinned {} has an axis", end.name);
                let help = format!("set {} = \"pinned\", or leave the axis out", key("kind"));
                return Err(self.source.error_at(&key("axis"), message, Some(help)));
            }
        }
        let name = key("motion");
        match (end.motion, end.kind) {
            (Some(motion), EndKind::Driven) => self.check_motion(&name, motion),
            (None, EndKind::Driven) => Err(self.missing(
                &name,
                &format!(
                    "a driven {} needs to know how it moves, for example velocity_m_s = [0.1, 0, 0]",
                    end.name
                ),
            )),
            (Some(_), _) => Err(self.source.error_at(
                &name,
                format!("only a driven {} has a given motion", end.name),
                Some(format!(
                    "set {} = \"driven\", or leave {name} out",
                    key("kind")
                )),
            )),
            (None, _) => Ok(()),
        }
    }

    fn check_motion(&self, name: &str, motion: &BaseMotionKeys) -> Checked {
        let key = |own: &str| format!("{name}.{own}");
        self.finite(&key("velocity_m_s"), &motion.velocity_m_s)?;
        self.finite(
            &key("angular_velocity_rad_s"),
            &motion.angular_velocity_rad_s,
        )?;
        if let Some(table) = &motion.translation_m {
            self.table(&key("translation_m"), table, "no translation")?;
        }
        if let Some(table) = &motion.rotation_rad {
            self.table(&key("rotation_rad"), table, "no rotation")?;
        }
        for (index, oscillation) in motion.oscillation.iter().enumerate() {
            let key = |own: &str| format!("{name}.oscillation.{index}.{own}");
            self.finite(&key("translation_m"), &oscillation.translation_m)?;
            self.finite(&key("rotation_rad"), &oscillation.rotation_rad)?;
            self.finite_number(&key("phase_rad"), oscillation.phase_rad)?;
        }
        Ok(())
    }
}

/// Returns the condition of an end with these keys and this orientation.
pub(in crate::scene) fn end_condition(
    kind: EndKind,
    axis: Option<[f64; 3]>,
    motion: Option<&BaseMotionKeys>,
    orientation: &Matrix3<f64>,
) -> Result<EndCondition, RodError> {
    Ok(match kind {
        EndKind::Clamped => EndCondition::Clamped,
        EndKind::Pinned => EndCondition::Pinned {
            axis: axis.map(Vector3::from),
        },
        EndKind::Driven => {
            let motion = motion.cloned().unwrap_or_default();
            EndCondition::driven(base_motion(&motion, orientation)?)
        }
        EndKind::Free => EndCondition::Free,
    })
}

/// Kind, axis and motion of an end.
type DescribedEnd = (EndKind, Option<[f64; 3]>, Option<BaseMotionKeys>);

/// Returns the keys of an end with this condition.
pub(in crate::scene) fn described_end(end: &EndCondition) -> Result<DescribedEnd, DescribeError> {
    Ok(match end {
        EndCondition::Clamped => (EndKind::Clamped, None, None),
        EndCondition::Pinned { axis } => (EndKind::Pinned, axis.map(Into::into), None),
        EndCondition::Driven(motion) => (EndKind::Driven, None, Some(described_motion(motion)?)),
        EndCondition::Free => (EndKind::Free, None, None),
    })
}

/// Length up to which a row is a logarithm, rad: half a turn, with rows of three decimals.
const LOGARITHM: f64 = std::f64::consts::PI + 1e-3;

/// Returns rows of rotation vectors of which each is, of the vectors `r + 2πk r/|r|` of its orientation, the nearest to the one before; rows
/// as they are where one is longer than half a turn.
fn unrolled(rows: &[[f64; 4]]) -> Vec<[f64; 4]> {
    let vector = |&[_, x, y, z]: &[f64; 4]| Vector3::new(x, y, z);
    let mut out = rows.to_vec();
    if rows.iter().any(|row| vector(row).norm() > LOGARITHM) {
        return out;
    }
    for i in 1..out.len() {
        let (before, own) = (vector(&out[i - 1]), vector(&out[i]));
        // An orientation that is that of the zero vector is a whole turn about any axis.
        let axis = if own.norm() > 1e-12 { own } else { before };
        let Some(axis) = axis.try_normalize(1e-12) else {
            continue;
        };
        let turns = ((before - own).dot(&axis) / std::f64::consts::TAU).round();
        let other = own + axis * (std::f64::consts::TAU * turns);
        // Two that are equally near, as at a turn by half a turn, are left as they are written.
        if (other - before).norm() < (own - before).norm() - 2e-3 {
            out[i][1..].copy_from_slice(other.as_slice());
        }
    }
    out
}

/// Returns the motion of an end with this orientation: `exp(r) R_b = R_b exp(R_bᵀ r)` turns spatial rotation vectors into those of its
/// frame.
fn base_motion(
    motion: &BaseMotionKeys,
    orientation: &Matrix3<f64>,
) -> Result<mechanics::BaseMotion, RodError> {
    let curve = |rate: [f64; 3],
                 table: &Option<Vec<[f64; 4]>>,
                 amplitude: fn(&OscillationKeys) -> [f64; 3],
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
            &motion.rotation_rad.as_deref().map(unrolled),
            |o| o.rotation_rad,
            turned,
        )?,
    })
}

fn described_motion(motion: &mechanics::BaseMotion) -> Result<BaseMotionKeys, DescribeError> {
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
            "an end of it translates and rotates at different frequencies",
        ));
    }
    Ok(BaseMotionKeys {
        velocity_m_s: translation.rate.into(),
        angular_velocity_rad_s: rotation.rate.into(),
        translation_m: table(translation),
        rotation_rad: table(rotation),
        rotation_frame: LoadFrame::Body,
        oscillation: pairs()
            .map(|(translation, rotation)| OscillationKeys {
                translation_m: translation.amplitude.into(),
                rotation_rad: rotation.amplitude.into(),
                frequency_hz: known(translation.frequency),
                phase_rad: translation.phase,
            })
            .collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Logarithms of a constant spin about an axis that is not one of the frame, from -170° over two turns on, are unrolled to the spin
    /// itself, either way; a table with a row of more than half a turn stays as it is written, and a turn by half a turn too.
    #[test]
    fn logarithms_turn_the_shorter_way() {
        let axis = Vector3::new(0.6, 0.0, -0.8);
        let row = |t: f64, angle: f64| {
            let r = axis * angle;
            [t, r.x, r.y, r.z]
        };
        for sign in [1.0, -1.0] {
            let angle = |i: i32| sign * (-2.967 + 0.16 * f64::from(i));
            let wrapped = |angle: f64| {
                let turns = (angle / std::f64::consts::TAU).round();
                angle - std::f64::consts::TAU * turns
            };
            let rows: Vec<_> = (0..80)
                .map(|i| row(f64::from(i), wrapped(angle(i))))
                .collect();
            for (i, own) in (0..).zip(unrolled(&rows)) {
                for (own, expected) in own.iter().zip(row(f64::from(i), angle(i))) {
                    assert!((own - expected).abs() < 1e-12, "row {i}");
                }
            }
        }
        for written in [
            vec![row(0.0, 0.0), row(1.0, 4.0), row(2.0, -2.5)],
            vec![row(0.0, 0.0), row(1.0, std::f64::consts::PI)],
        ] {
            assert_eq!(unrolled(&written), written);
        }
    }
}
