//! Conditions at the two ends of a rod.
//!
//! A clamped or driven base has no place in vectors over the moving nodes, which begin at node 1. Every other end that is held, a pinned
//! base or a tip that is not free, has one, and is a [`Joint`]: its held motions do not move by the equations of motion, and have no
//! variation. With the projection `P` onto its free motions, a force on it is `P f`, a matrix `P K P` and a unit on the held motions.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use super::base_motion::BaseMotion;

/// The condition at an end of the rod.
#[derive(Clone, Debug, PartialEq)]
pub enum EndCondition {
    /// Position and rotation fixed.
    Clamped,
    /// Position and rotation given as functions of time.
    Driven(Box<BaseMotion>),
    /// Position fixed, rotation free: about all axes (a ball joint), or about one axis (a hinge), which is fixed in space and in the body
    /// frame of the end.
    Pinned {
        /// Axis of a hinge, spatial frame, of any length but zero: through the end in the rotation in which it is held, or in that of the
        /// stress-free shape. `None` for a ball joint.
        axis: Option<Vector3<f64>>,
    },
    /// No constraint.
    Free,
}

impl EndCondition {
    /// Returns an end that follows `motion`.
    #[must_use]
    pub fn driven(motion: BaseMotion) -> Self {
        Self::Driven(Box::new(motion))
    }

    /// Returns the name in scene and result files.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Clamped => "clamped",
            Self::Driven(_) => "driven",
            Self::Pinned { .. } => "pinned",
            Self::Free => "free",
        }
    }

    /// Returns the projection onto the free rotations, body frame, of an end with this rotation.
    pub(super) fn turning(&self, rotation: &Matrix3<f64>) -> Matrix3<f64> {
        match self {
            Self::Clamped | Self::Driven(_) => Matrix3::zeros(),
            Self::Pinned { axis: Some(axis) } => {
                let unit = rotation.tr_mul(axis).normalize();
                unit * unit.transpose()
            }
            Self::Pinned { axis: None } | Self::Free => Matrix3::identity(),
        }
    }
}

/// A held end that has a place among the moving nodes. Its position is held, and rotations of it outside of `turning`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// The node, 0 or `K`.
    pub node: usize,
    /// Projection onto the free rotations, body frame: 0 of a clamped or driven tip, `a aᵀ` of a hinge with the axis `a`, 1 of a ball.
    pub turning: Matrix3<f64>,
}

impl Joint {
    /// Returns the joints of a rod of `tip` elements with these conditions.
    /// The ends come with the rotations in which they are held.
    pub(super) fn of_ends(
        base: (&EndCondition, &Matrix3<f64>),
        end: (&EndCondition, &Matrix3<f64>),
        tip: usize,
    ) -> Vec<Self> {
        let joint = |node: usize, (end, rotation): (&EndCondition, &Matrix3<f64>)| Self {
            node,
            turning: end.turning(rotation),
        };
        let at_base = matches!(base.0, EndCondition::Pinned { .. }).then(|| joint(0, base));
        let at_tip = (*end.0 != EndCondition::Free).then(|| joint(tip, end));
        at_base.into_iter().chain(at_tip).collect()
    }

    /// Tells whether some rotation is free.
    #[must_use]
    pub fn turns(&self) -> bool {
        self.turning != Matrix3::zeros()
    }

    /// Returns the axis of a hinge, body frame.
    #[must_use]
    pub fn axis(&self) -> Option<Vector3<f64>> {
        let is_hinge = self.turns() && self.turning != Matrix3::identity();
        let longest = (0..3).max_by(|&i, &j| self.turning[(i, i)].total_cmp(&self.turning[(j, j)]));
        let column = self.turning.column(longest.unwrap_or(0)).into_owned();
        is_hinge.then(|| column.normalize())
    }

    /// Returns the projection onto the free motions `(δx, η)`.
    #[must_use]
    pub fn projection(&self) -> Matrix6<f64> {
        let mut out = Matrix6::zeros();
        out.fixed_view_mut::<3, 3>(3, 3).copy_from(&self.turning);
        out
    }

    /// Returns the part of `(force, moment)`, or of a motion `(δx, η)`, along the free motions.
    #[must_use]
    pub fn project(&self, wrench: &Vector6<f64>) -> Vector6<f64> {
        let moment = self.turning * wrench.fixed_rows::<3>(3);
        Vector6::new(0.0, 0.0, 0.0, moment.x, moment.y, moment.z)
    }
}
