//! The signals of sensors, with their accuracy.

use mechanics::Rod;
use mechanics::rotation::{exp, log, orthonormalized};
use nalgebra::{Matrix3, Vector3};

/// Fraction of a period, or of a step, by which a time may be early: more than the rounding of times up to 1e9 periods.
pub(super) const EARLY: f64 = 1e-6;

/// A standard deviation of 0, or below this multiple of the arm's own scale, is replaced by the multiple. The covariance of an innovation
/// then has a condition number of at most `(0.05/1e-6)² = 2.5e9` for the prior of 0.05 of the length, and a solution with it keeps six
/// digits.
pub(super) const EXACT: f64 = 1e-6;
/// Replacement of the standard deviation of exact velocities, in the arm's own scales: velocities contain the fast waves of an arm, in
/// which a model of few elements is wrong. As exact values they would be explained by a wrong stiffness, a different one at every sample. A
/// sensor with a standard deviation of its own (the keys `velocity_sigma_m_s` and `angular_velocity_sigma_rad_s`) is believed.
pub(super) const EXACT_VELOCITY: f64 = 1e-2;
/// A quantity that sensors measure; [`row`](Self::row) has its names and unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Position of a point of a section, `x + R d` with the offset `d`, spatial, m.
    Position,
    /// Rotation of a section, body to space. Its noise is a turn `exp(n)` on the right, `n` in the body frame, rad.
    Rotation,
    /// Velocity of a section's center, spatial, m/s.
    Velocity,
    /// Angular velocity of a section, body frame, rad/s.
    AngularVelocity,
    /// Curvature and twist `ψ/l`, `ψ = log(R_aᵀ R_b)` of the ends of an element, including that of the stress-free shape, body frame, 1/m.
    /// The mean over an element is its value at the element's middle; between middles it is linear, and it is extrapolated linearly beyond
    /// the first and the last one.
    Curvature,
    /// Strain of a fibre that runs beside the center at the offset `d`: `|v + κ × d|` over its value without stress, minus 1; one number. As
    /// with curvatures, the mean over an element is its value at the element's middle.
    Strain,
    /// Force of the arm on its clamp, spatial frame, N: the pull of the first element on node 0, plus the weight of node 0.
    BaseForce,
    /// Moment of the arm on its clamp about node 0, in the body frame of node 0, N m.
    BaseMoment,
}

/// Time for which the error of a model stays the same, divided by the time scale of the arm: `1/ω₁` of a cantilever, 1/3.516.
const LASTS: f64 = 0.28;

/// Names, unit and form of a quantity.
#[derive(Clone, Copy, Debug)]
pub struct QuantityRow {
    /// The quantity.
    pub quantity: Quantity,
    /// Words of it, as pages say them.
    pub words: &'static str,
    /// Name of a value, as lines of a served loop have it.
    pub field: &'static str,
    /// Scene key of its standard deviation.
    pub key: &'static str,
    /// Unit of its standard deviation.
    pub unit: &'static str,
    /// Whether it belongs to the clamp and not to a place along the arm.
    pub at_clamp: bool,
    /// Whether the shape alone has it, and no motion and no stress.
    pub of_shape: bool,
    /// Whether it depends on the offset of its place from the center of the section.
    pub has_offset: bool,
    /// How many of the three numbers of a [`Reading::Vector`] it has; the others are 0. A rotation counts as three.
    pub numbers: usize,
}

impl Quantity {
    /// All quantities, those at places along the arm first.
    pub const TABLE: [QuantityRow; 8] = {
        const fn row(
            quantity: Quantity,
            [words, field, key, unit]: [&'static str; 4],
            at_clamp: bool,
        ) -> QuantityRow {
            QuantityRow {
                quantity,
                words,
                field,
                key,
                unit,
                at_clamp,
                of_shape: matches!(
                    quantity,
                    Quantity::Position
                        | Quantity::Rotation
                        | Quantity::Curvature
                        | Quantity::Strain
                ),
                has_offset: matches!(quantity, Quantity::Position | Quantity::Strain),
                numbers: if matches!(quantity, Quantity::Strain) {
                    1
                } else {
                    3
                },
            }
        }
        use Quantity as Q;
        [
            row(
                Q::Position,
                ["position", "position_m", "position_sigma_m", "m"],
                false,
            ),
            row(
                Q::Rotation,
                ["rotation", "rotation", "rotation_sigma_rad", "rad"],
                false,
            ),
            row(
                Q::Velocity,
                ["velocity", "velocity_m_s", "velocity_sigma_m_s", "m/s"],
                false,
            ),
            row(
                Q::AngularVelocity,
                [
                    "angular velocity",
                    "angular_velocity_rad_s",
                    "angular_velocity_sigma_rad_s",
                    "rad/s",
                ],
                false,
            ),
            row(
                Q::Curvature,
                ["curvature", "curvature_1_m", "curvature_sigma_1_m", "1/m"],
                false,
            ),
            row(Q::Strain, ["strain", "strain", "strain_sigma", ""], false),
            row(
                Q::BaseForce,
                [
                    "force of the base",
                    "base_force_n",
                    "base_force_sigma_n",
                    "N",
                ],
                true,
            ),
            row(
                Q::BaseMoment,
                [
                    "moment of the base",
                    "base_moment_n_m",
                    "base_moment_sigma_n_m",
                    "N·m",
                ],
                true,
            ),
        ]
    };

    /// Returns the row of the quantity.
    #[must_use]
    pub fn row(self) -> &'static QuantityRow {
        // The table has the order of the quantities.
        &Self::TABLE[self as usize]
    }

    /// Returns the size that the quantity has on an arm that is bent by a radian or so, in its unit.
    pub(super) fn scale(self, rod: &Rod) -> f64 {
        let scales = &rod.scales;
        match self {
            Self::Position => scales.length,
            Self::Rotation | Self::Strain => 1.0,
            Self::Velocity => scales.length / scales.time,
            Self::AngularVelocity => 1.0 / scales.time,
            Self::Curvature => 1.0 / scales.length,
            Self::BaseForce => scales.force,
            Self::BaseMoment => scales.moment,
        }
    }

    /// Returns the standard deviation of white noise that tells as little, at one measurement every `interval` (s), as the error of the model
    /// allows to know.
    ///
    /// An arm that is bent by one radian turns by `θ = 1/K` along each of its `K` elements of the length `l = L/K`. A chord is shorter than its
    /// arc by up to `l θ²/24`, and by up to `θ²/12` its direction differs from that of the mean frame of its ends: nodes of the arm that are
    /// taken exactly as they are stretch and shear the elements by as much. An error anywhere within such a bound has the standard deviation of
    /// the bound over √3. It stays while the arm keeps its shape, during which measurements repeat it: for the time `1/ω₁ = 0.28 T` of a
    /// cantilever with the time scale `T`. `n` equal errors tell as little as `n` independent ones that are `√n` times as large.
    pub(super) fn model_error(self, rod: &Rod, interval: f64) -> f64 {
        let n = rod.n_elements() as f64;
        let own = match self {
            Self::Position => 1.0 / (24.0 * n.powi(3)) / f64::sqrt(3.0),
            Self::Rotation | Self::Curvature => 1.0 / (12.0 * n.powi(2)) / f64::sqrt(3.0),
            Self::Strain => 1.0 / (24.0 * n.powi(2)) / f64::sqrt(3.0),
            Self::Velocity | Self::AngularVelocity => EXACT_VELOCITY,
            Self::BaseForce | Self::BaseMoment => EXACT,
        };
        let repeated = (LASTS * rod.scales.time / interval).max(1.0);
        own.max(EXACT) * self.scale(rod) * repeated.sqrt()
    }
}

/// The value of a quantity of the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reading {
    /// A [`Quantity::Rotation`].
    Rotation(Matrix3<f64>),
    /// Three numbers of any other quantity.
    Vector(Quantity, Vector3<f64>),
}

impl Reading {
    /// Returns the quantity of the value.
    #[must_use]
    pub fn quantity(&self) -> Quantity {
        match self {
            Self::Rotation(_) => Quantity::Rotation,
            Self::Vector(quantity, _) => *quantity,
        }
    }

    /// Tells whether all values are finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        match self {
            Self::Rotation(rotation) => rotation.iter().all(|c| c.is_finite()),
            Self::Vector(_, v) => v.iter().all(|c| c.is_finite()),
        }
    }

    /// Returns the value with noise: a vector is shifted by it, a rotation is turned by `exp(noise)` on the right.
    #[must_use]
    pub fn with_noise(&self, noise: &Vector3<f64>) -> Self {
        match self {
            Self::Rotation(r) => Self::Rotation(r * exp(noise)),
            Self::Vector(quantity, v) => Self::Vector(*quantity, v + noise),
        }
    }

    /// Returns this minus an expected value of the same quantity; for rotations the turn in the expected body frame that leads to the
    /// measured one. Zero for readings of different quantities, which are never compared.
    #[must_use]
    pub fn minus(&self, expected: &Self) -> Vector3<f64> {
        match (self, expected) {
            (Self::Rotation(measured), Self::Rotation(expected)) => {
                log(&expected.tr_mul(&orthonormalized(measured)))
            }
            (Self::Vector(a, measured), Self::Vector(b, expected)) if a == b => measured - expected,
            _ => Vector3::zeros(),
        }
    }
}

/// One reading at one place: three values with independent noise of the same standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signal {
    /// Arc length from the base divided by the arm's length, 0 to 1, so that a place is the same on every grid. Between two nodes poses lie
    /// on the helix of a [`Transfer`](super::Transfer), and velocities are linear. Without meaning for forces and moments on the clamp.
    pub place: f64,
    /// Offset `d` from the center of the section, along its first and second director, m; counts for quantities that
    /// [have one](QuantityRow::has_offset).
    pub offset: [f64; 2],
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
