//! What sensors say, and what a sample of it is worth.

use nalgebra::{Matrix3, Vector3};

/// A quantity of the arm and its value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reading {
    /// Position of a section's center, spatial, m.
    Position(Vector3<f64>),
    /// Rotation of a section, body to space. Its noise is a turn `exp(n)` on the right, `n` in the body frame, rad.
    Rotation(Matrix3<f64>),
    /// Velocity of a section's center, spatial, m/s.
    Velocity(Vector3<f64>),
    /// Angular velocity of a section, body frame, rad/s.
    AngularVelocity(Vector3<f64>),
    /// Curvature and twist `ψ/l`, `ψ = log(R_aᵀ R_b)` of the ends of an element, with the stress-free shape included, body frame, 1/m: the
    /// mean over an element belongs to its middle, between middles it is linear, and so it is outside of the first and the last one.
    Curvature(Vector3<f64>),
    /// Force of the arm on its clamp, spatial, N: what the first element pulls node 0 with, and the weight of node 0.
    BaseForce(Vector3<f64>),
    /// Moment of the arm on its clamp about node 0, in the body frame of node 0, N m.
    BaseMoment(Vector3<f64>),
}

impl Reading {
    /// Whether all its numbers are finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        match self {
            Self::Rotation(rotation) => rotation.iter().all(|c| c.is_finite()),
            Self::Position(v)
            | Self::Velocity(v)
            | Self::AngularVelocity(v)
            | Self::Curvature(v)
            | Self::BaseForce(v)
            | Self::BaseMoment(v) => v.iter().all(|c| c.is_finite()),
        }
    }
}

/// One reading at one place: three numbers with independent noise of one standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signal {
    /// Arc length from the base over the arm's length, 0 to 1: a place is the same on every grid. Between two nodes poses lie on the helix
    /// of a [`Transfer`](super::Transfer), and velocities are linear. Of no meaning for what the clamp feels.
    pub place: f64,
    /// The value.
    pub reading: Reading,
    /// Standard deviation of each of its three numbers, in the unit of the reading (rad for a rotation); 0: exact.
    pub sigma: f64,
}

/// What a sensor saw at one instant.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measurement {
    /// When it was true, s; it may be known later.
    pub time: f64,
    /// The signals, all of that instant.
    pub signals: Vec<Signal>,
}
