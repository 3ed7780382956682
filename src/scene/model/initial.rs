//! The state at t = 0: a shape in words or rows, or the end of another result.

use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::keys::{Checked, Excludes, Keys, given};
use super::super::values::digits;
use super::geometry::wxyz;
use super::{EndKind, Scene};
use crate::mechanics::rotation::from_quaternion;
use crate::mechanics::{Configuration, NodalState, State};
use crate::task::{Start, StartShape};

/// State at t = 0: a shape and the velocity of a rigid body, or the end of another result.
///
/// Only a free base can have a velocity: a clamped one is at rest, and an arm on a driven base starts with the velocity
/// of its base. The end of a result has velocities of its own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Initial {
    /// Shape that the motion starts from: `"rest"`, the stress-free shape, on which gravity and loads act suddenly;
    /// `"equilibrium"`, the static equilibrium under gravity and the loads at t = 0, which needs a clamped or driven base; or
    /// rows, each of which begins with a fraction of the length. Rows of four numbers, [fraction, three components in 1/m],
    /// are curvature and twist, linear between two rows and constant beyond the first and the last one, of an arm without
    /// shear that is as long as at rest. Rows of eight numbers, [fraction, x, y, z in m, quaternion w, x, y, z], are poses,
    /// the first at 0, on the base, the last at 1; between two of them the arm is a helix. Default: "rest".
    pub shape: InitialShape,
    /// Velocity of the center of mass in m/s. Default: none.
    pub velocity_m_s: [f64; 3],
    /// Angular velocity about the center of mass in rad/s, spatial frame. Default: none.
    pub angular_velocity_rad_s: [f64; 3],
    /// Result directory of a `simulate`, `solve` or `mpc`, relative to the folder of the scene: the motion starts with the
    /// poses and velocities at its end, at t = 0 of this scene. Loads, targets, controls and elements may be others; the
    /// length and the pose of a held base are the same. The `scene.toml` of the new result has the state itself, in
    /// `[initial.state]`, instead of this key.
    pub from: Option<String>,
    /// State of all nodes, as softarm writes it in the place of `from`.
    pub state: Option<InitialState>,
}

/// Shape that a motion starts from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(
    untagged,
    expecting = "expected \"rest\", \"equilibrium\", or rows of numbers"
)]
pub enum InitialShape {
    /// A shape that the arm finds.
    Word(ShapeWord),
    /// Curvature or poses along the arm.
    Rows(Vec<Vec<f64>>),
}

/// A shape that needs no numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(inline)]
#[serde(rename_all = "kebab-case")]
pub enum ShapeWord {
    /// The stress-free shape: gravity and loads act suddenly.
    #[default]
    Rest,
    /// Static equilibrium under gravity and the loads at t = 0; needs a clamped or driven base.
    Equilibrium,
}

impl Default for InitialShape {
    fn default() -> Self {
        Self::Word(ShapeWord::default())
    }
}

/// State of all nodes of an arm, with one row a node in every table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InitialState {
    /// Length at rest in m, which must be that of the arm.
    pub length_m: f64,
    /// Fractions of the length, from 0 to 1, increasing.
    pub at: Vec<f64>,
    /// Positions in m, spatial frame.
    pub position_m: Vec<[f64; 3]>,
    /// Rotations from the body frame to space, the matrix row by row.
    pub rotation: Vec<[f64; 9]>,
    /// Linear momenta, spatial frame.
    pub momentum_kg_m_s: Vec<[f64; 3]>,
    /// Angular momenta about the node, body frame.
    pub angular_momentum_kg_m2_s: Vec<[f64; 3]>,
    /// Masses of the nodes in kg: a momentum over its mass is the velocity with which an arm of another mass starts.
    pub mass_kg: Vec<f64>,
    /// Principal moments of inertia of the nodes in this shape, body frame.
    pub inertia_kg_m2: Vec<[f64; 3]>,
}

impl InitialState {
    /// Returns the keys of a state.
    pub(in crate::scene) fn describing(found: &NodalState) -> Self {
        let arrays = |vectors: &[Vector3<f64>]| vectors.iter().map(|&v| v.into()).collect();
        let at = &found.state.configuration;
        let rows = |r: &Matrix3<f64>| {
            let mut rows = [0.0; 9];
            rows.copy_from_slice(r.transpose().as_slice());
            rows
        };
        Self {
            length_m: found.length,
            at: found.places.clone(),
            position_m: arrays(&at.positions),
            rotation: at.rotations.iter().map(rows).collect(),
            momentum_kg_m_s: arrays(&found.state.linear_momentum),
            angular_momentum_kg_m2_s: arrays(&found.state.angular_momentum),
            mass_kg: found.mass.clone(),
            inertia_kg_m2: arrays(&found.rotary),
        }
    }

    fn of_task(&self) -> NodalState {
        let vectors = |arrays: &[[f64; 3]]| arrays.iter().map(|&v| v.into()).collect();
        NodalState {
            length: self.length_m,
            places: self.at.clone(),
            state: State {
                configuration: Configuration {
                    positions: vectors(&self.position_m),
                    rotations: (self.rotation.iter())
                        .map(|rows| Matrix3::from_row_slice(rows))
                        .collect(),
                },
                linear_momentum: vectors(&self.momentum_kg_m_s),
                angular_momentum: vectors(&self.angular_momentum_kg_m2_s),
            },
            mass: self.mass_kg.clone(),
            rotary: vectors(&self.inertia_kg_m2),
        }
    }
}

impl Initial {
    /// Returns the start that the keys mean.
    pub(in crate::scene) fn of_task(&self) -> Start {
        let shape = match (&self.state, &self.shape) {
            (Some(state), _) => StartShape::State(Box::new(state.of_task())),
            (None, InitialShape::Word(ShapeWord::Rest)) => StartShape::Rest,
            (None, InitialShape::Word(ShapeWord::Equilibrium)) => StartShape::Equilibrium,
            (None, InitialShape::Rows(rows)) => match rows.first().map(Vec::len) {
                Some(CURVATURE) => StartShape::Curvature(
                    (rows.iter())
                        .map(|row| (row[0], Vector3::from_column_slice(&row[1..])))
                        .collect(),
                ),
                _ => StartShape::Poses(
                    rows.iter().map(|row| row[0]).collect(),
                    Configuration {
                        positions: (rows.iter())
                            .map(|row| Vector3::from_column_slice(&row[1..4]))
                            .collect(),
                        rotations: (rows.iter())
                            .map(|row| from_quaternion([row[4], row[5], row[6], row[7]]))
                            .collect(),
                    },
                ),
            },
        };
        Start {
            shape,
            velocity: self.velocity_m_s.into(),
            angular_velocity: self.angular_velocity_rad_s.into(),
        }
    }

    /// Returns the keys that describe a start.
    pub(in crate::scene) fn describing(start: &Start) -> Self {
        let (mut shape, mut state) = (InitialShape::default(), None);
        match &start.shape {
            StartShape::Rest => {}
            StartShape::Equilibrium => shape = InitialShape::Word(ShapeWord::Equilibrium),
            StartShape::Curvature(rows) => {
                let row = |(s, k): &(f64, Vector3<f64>)| vec![*s, k.x, k.y, k.z];
                shape = InitialShape::Rows(rows.iter().map(row).collect());
            }
            StartShape::Poses(places, poses) => {
                let nodes = poses.positions.iter().zip(&poses.rotations);
                let row = |(s, (x, r)): (&f64, (&Vector3<f64>, &Matrix3<f64>))| {
                    [*s, x.x, x.y, x.z].into_iter().chain(wxyz(r)).collect()
                };
                shape = InitialShape::Rows(places.iter().zip(nodes).map(row).collect());
            }
            StartShape::State(found) => state = Some(InitialState::describing(found)),
        }
        Self {
            shape,
            velocity_m_s: start.velocity.into(),
            angular_velocity_rad_s: start.angular_velocity.into(),
            from: None,
            state,
        }
    }
}

/// Numbers of a row of curvature.
const CURVATURE: usize = 4;
/// Numbers of a row of poses.
const POSE: usize = 8;

impl Keys<'_> {
    pub(in crate::scene) fn check_initial(&self, initial: &Initial, scene: &Scene) -> Checked {
        let tip = scene.tip_kind();
        if let Some(state) = &initial.state {
            self.check_initial_state(initial, state)?;
        }
        if let InitialShape::Rows(rows) = &initial.shape {
            self.check_shape_rows(rows)?;
        }
        for (name, velocity) in [
            ("initial.velocity_m_s", &initial.velocity_m_s),
            (
                "initial.angular_velocity_rad_s",
                &initial.angular_velocity_rad_s,
            ),
        ] {
            self.finite(name, velocity)?;
            if *velocity == [0.0; 3] {
                continue;
            }
            let (message, help) = match scene.base.kind {
                EndKind::Free if tip == EndKind::Free => continue,
                EndKind::Free | EndKind::Pinned => (
                    "an arm that is held at an end cannot start as a moving rigid body",
                    "leave the velocity out, or free both ends",
                ),
                EndKind::Clamped => (
                    "a clamped arm cannot start as a moving rigid body",
                    "set base.kind = \"free\", or \"driven\" with a base.motion",
                ),
                EndKind::Driven => (
                    "an arm on a driven base starts with the velocity of its base",
                    "give the velocity in base.motion",
                ),
            };
            return Err(self.source.error_at(name, message, Some(help.to_string())));
        }
        Ok(())
    }

    fn check_shape_rows(&self, rows: &[Vec<f64>]) -> Checked {
        const SHAPE: &str = "initial.shape";
        let refuse = |key: &str, message: String, expected: &str| {
            Err((self.source.error_at(key, message, None)).expecting(expected))
        };
        let kinds = "expected rows of 4 numbers (fraction, curvature) or of 8 (fraction, position, quaternion)";
        let Some(width) = rows.first().map(Vec::len) else {
            return refuse(SHAPE, "no rows".into(), kinds);
        };
        for (index, row) in rows.iter().enumerate() {
            let key = format!("{SHAPE}.{index}");
            if row.len() != width || ![CURVATURE, POSE].contains(&row.len()) {
                let message = format!("a row of {} numbers", row.len());
                return refuse(&key, message, kinds);
            }
            self.finite(&key, row)?;
            let before = index.checked_sub(1).map_or(0.0, |before| rows[before][0]);
            let is_step = index > 0 && before == row[0];
            let is_third = is_step && index > 1 && rows[index - 2][0] == row[0];
            let message = format!("{} is not a later place on the arm", digits(row[0]));
            if !(row[0] >= before && row[0] <= 1.0) || is_third {
                let expected = "expected fractions of the length from 0 to 1 that increase; two rows of one fraction are a step of the curvature";
                return refuse(&key, message, expected);
            }
            if width == POSE {
                self.nonzero(&key, &row[4..])?;
                let is_end =
                    (index != 0 || row[0] == 0.0) && (index + 1 != rows.len() || row[0] == 1.0);
                if is_step || !is_end || rows.len() < 2 {
                    let expected = "expected poses at fractions that increase, from 0 at the base to 1 at the tip";
                    return refuse(&key, message, expected);
                }
            }
        }
        Ok(())
    }

    fn check_initial_state(&self, initial: &Initial, state: &InitialState) -> Checked {
        self.alone_in_initial(initial, "state")?;
        let Some(fault) = state.of_task().fault() else {
            return Ok(());
        };
        let message = format!("node {}: {}", fault.node, fault.reason);
        let help = "softarm writes this section; give initial.from = \"DIR\" again";
        Err((self.source).error_at("initial.state", message, Some(help.into())))
    }

    /// Refuses other keys beside a state of all nodes.
    pub(in crate::scene) fn alone_in_initial(&self, initial: &Initial, key: &str) -> Checked {
        let others = given!(initial: shape, velocity_m_s, angular_velocity_rad_s);
        self.relations("initial", &others.map(|other| Excludes(other, (key, true))))
    }
}
