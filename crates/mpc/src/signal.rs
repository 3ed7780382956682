//! The signals of sensors, with their accuracy.

use nalgebra::{Matrix3, Vector3};

/// Fraction of a period, or of a step, by which a time may be early: more than the rounding of times up to 1e9 periods.
pub(super) const EARLY: f64 = 1e-6;

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
    /// Curvature and twist `ψ/l`, `ψ = log(R_aᵀ R_b)` of the ends of an element, including that of the stress-free shape, body frame, 1/m.
    /// The mean over an element is its value at the element's middle; between middles it is linear, and it is extrapolated linearly beyond
    /// the first and the last one.
    Curvature(Vector3<f64>),
    /// Force of the arm on its clamp, spatial frame, N: the pull of the first element on node 0, plus the weight of node 0.
    BaseForce(Vector3<f64>),
    /// Moment of the arm on its clamp about node 0, in the body frame of node 0, N m.
    BaseMoment(Vector3<f64>),
}

impl Reading {
    /// Tells whether all values are finite.
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

/// One reading at one place: three values with independent noise of the same standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signal {
    /// Arc length from the base divided by the arm's length, 0 to 1, so that a place is the same on every grid. Between two nodes poses lie
    /// on the helix of a [`Transfer`](super::Transfer), and velocities are linear. Without meaning for forces and moments on the clamp.
    pub place: f64,
    /// Value of the reading.
    pub reading: Reading,
    /// Standard deviation of each of its three values, in the unit of the reading (rad for a rotation); 0 for an exact one.
    pub sigma: f64,
}

/// The measurement of a sensor at one time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measurement {
    /// Time of the measurement, s; it may become known later.
    pub time: f64,
    /// The signals, all of that instant.
    pub signals: Vec<Signal>,
}
