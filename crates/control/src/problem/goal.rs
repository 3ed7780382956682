//! The goals of a problem.

use nalgebra::{Matrix3, Vector3};

use mechanics::direction::Deviation;
#[cfg(doc)]
use mechanics::direction::across;
use mechanics::rotation::log;
use mechanics::{Rod, TimeGrid};

/// The way in which a goal is enforced: as an equality, within a tolerance, or by a penalty.
///
/// A soft goal is solved as a hard one with variables of its own: residual = s, with the penalty `½ weight |s|²`. It thereby has all that
/// makes hard goals converge (second-order correction, filter).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Enforcement {
    /// Equality constraints.
    Hard,
    /// Penalty `½ weight Σ r²` on the scaled residuals of [`Goal`].
    Soft {
        /// Weight on the squared scaled residual.
        weight: f64,
    },
    /// A set around the goal: `|x - x*| ≤ distance`, an angle of at most `angle` between the rotations or directions, `|v - v*| ≤ speed`,
    /// and for a goal at rest `|ω| ≤ spin`; a tolerance of 0 is an equality.
    ///
    /// Each of the four is solved as a hard goal with variables of its own: residual = s, with s in the ball of the tolerance. The
    /// subproblem has the ball as a second-order cone, so that no step linearizes its surface.
    Within {
        /// Tolerance of the position, m.
        distance: f64,
        /// Tolerance of the orientation or direction, rad.
        angle: f64,
        /// Tolerance of the velocity, m/s.
        speed: f64,
        /// Tolerance of the angular velocity, rad/s.
        spin: f64,
    },
}

impl Enforcement {
    /// Returns the tolerance of a part of the goal, in the part's own unit; 0 for an equality and for a soft goal.
    #[must_use]
    pub fn tolerance(&self, part: GoalPart) -> f64 {
        match (*self, part) {
            (Self::Within { distance, .. }, GoalPart::Position) => distance,
            (Self::Within { angle, .. }, GoalPart::Orientation | GoalPart::Direction) => angle,
            (Self::Within { speed, .. }, GoalPart::Velocity) => speed,
            (Self::Within { spin, .. }, GoalPart::AngularVelocity) => spin,
            (Self::Within { .. }, GoalPart::Deviation(_)) => 0.0,
            (Self::Hard | Self::Soft { .. }, _) => 0.0,
        }
    }
}

/// A pose that a node must reach at a time node.
///
/// Scaled residuals: the position error divided by the rod's length, the orientation error as the rotation vector `log(R*ᵀ R)`, the
/// deviation of the node's axis from a direction as `θ/sin θ (a₁·t, a₂·t)` with the axes [across] the direction, and the error of the
/// velocity times `T₀/L` and the angular velocity times `T₀` ([`Scales`](mechanics::Scales)), both from the terminal Legendre transform.
#[derive(Clone, Debug, PartialEq)]
pub struct Goal {
    /// Name in reports: its key in the scene.
    pub name: String,
    /// Index of the node.
    pub node: usize,
    /// Index of the time node.
    pub time_node: usize,
    /// Position, m.
    pub position: Option<Vector3<f64>>,
    /// Rotation, body to space.
    pub rotation: Option<Matrix3<f64>>,
    /// Direction of the node's axis `R e₃`, of length 1, whatever its roll; excludes `rotation`.
    pub direction: Option<Vector3<f64>>,
    /// Asks for zero linear and angular velocity of the node. Only a goal at the end of the horizon may ask for it (otherwise a solve
    /// fails): before the end, momenta are those before the kick, which do not give the velocity of the time node.
    pub at_rest: bool,
    /// Velocity, m/s, with a free angular velocity; excludes `at_rest`, and is likewise for the end of the horizon alone.
    pub velocity: Option<Vector3<f64>>,
    /// Equality, tolerance or penalty.
    pub enforcement: Enforcement,
}

impl Goal {
    /// Returns a hard goal at rest of the tip at the end of the horizon.
    #[must_use]
    pub fn reach(rod: &Rod, grid: TimeGrid, position: Vector3<f64>) -> Self {
        Self {
            name: "task".into(),
            node: rod.tip(),
            time_node: grid.n_steps,
            position: Some(position),
            rotation: None,
            direction: None,
            at_rest: true,
            velocity: None,
            enforcement: Enforcement::Hard,
        }
    }

    /// Tells whether the goal depends on velocities, which are known at the end of the horizon alone.
    #[must_use]
    pub fn sees_velocity(&self) -> bool {
        self.at_rest || self.velocity.is_some()
    }

    /// Tells whether the goal turns its node to an orientation or a direction.
    #[must_use]
    pub fn turns(&self) -> bool {
        self.rotation.is_some() || self.direction.is_some()
    }

    /// Returns the angle of a node of rotation `r` from the goal's orientation, or of its axis from the goal's direction, rad; `None` where
    /// both are free.
    #[must_use]
    pub fn angle(&self, r: &Matrix3<f64>) -> Option<f64> {
        let turn = self.rotation.map(|to| log(&to.tr_mul(r)).norm());
        turn.or_else(|| Some(Deviation::of(&self.direction?, r).angle()))
    }

    /// Returns the scene key of a part of the goal, below the goal's own key, or a description if it has none.
    #[must_use]
    pub fn name_of(&self, part: GoalPart) -> &'static str {
        match part {
            GoalPart::Velocity if self.velocity.is_some() => "velocity_m_s",
            _ => part.name(),
        }
    }

    /// Returns the vectors of the goal, each of which gives [as many](GoalPart::n_rows) equations as it has components.
    #[must_use]
    pub fn parts(&self) -> Vec<GoalPart> {
        let mut parts = Vec::new();
        parts.extend(self.position.map(|_| GoalPart::Position));
        parts.extend(self.rotation.map(|_| GoalPart::Orientation));
        parts.extend(self.direction.map(|_| GoalPart::Direction));
        parts.extend(self.velocity.map(|_| GoalPart::Velocity));
        if self.at_rest {
            parts.extend([GoalPart::Velocity, GoalPart::AngularVelocity]);
        }
        parts
    }
}

/// One scalar residual of a goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GoalRow {
    /// Index of the goal.
    pub goal: usize,
    /// Vector of the goal.
    pub part: GoalPart,
    /// Component, from 0 to the [number of rows](GoalPart::n_rows); of a direction along the axes [across] it.
    pub axis: usize,
}

impl GoalRow {
    /// Tells whether both rows are components of one vector; the deviation from a stay counts as one vector as a whole. Rows of a vector
    /// are adjacent.
    #[must_use]
    pub fn shares_vector_with(&self, other: &Self) -> bool {
        let is_of_whole = |row: &Self| matches!(row.part, GoalPart::Deviation(_));
        self.goal == other.goal
            && (self.part == other.part || (is_of_whole(self) && is_of_whole(other)))
    }
}

/// The vectors of a goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GoalPart {
    /// Position.
    Position,
    /// Orientation.
    Orientation,
    /// Direction of the axis, with two components.
    Direction,
    /// Velocity.
    Velocity,
    /// Angular velocity.
    AngularVelocity,
    /// A vector of the deviation of the whole arm from where it [stays](crate::Stay).
    Deviation(usize),
}

impl GoalPart {
    /// Returns the number of components.
    #[must_use]
    pub fn n_rows(self) -> usize {
        match self {
            Self::Direction => 2,
            _ => 3,
        }
    }

    /// Returns the scene key of this part, below the goal's own key, or a description if it has none.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Position => "position_m",
            Self::Orientation => "orientation_wxyz",
            Self::Direction => "direction",
            Self::Velocity => "at_rest (velocity)",
            Self::AngularVelocity => "at_rest (angular velocity)",
            Self::Deviation(_) => "at_rest (deviation from the equilibrium)",
        }
    }

    /// Returns the unit of the residual before scaling.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self {
            Self::Position => "m",
            Self::Orientation | Self::Direction => "rad",
            Self::Velocity => "m/s",
            Self::AngularVelocity => "rad/s",
            Self::Deviation(_) => "J^(1/2)",
        }
    }
}
