//! Simulated sensors: what is measured of a plant, how often, how late and with what noise.

use super::error::MpcError;
use super::signal::Measurement;
use crate::mechanics::{Rod, State};

/// Kinds of sensors, with noise, rate and age as they are usual.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum SensorPreset {
    /// The whole state without noise and at once, 1000 Hz.
    State,
    /// Motion capture: poses at three places, the tip included; 0.2 mm, 0.2 degrees, 200 Hz, 5 ms.
    Mocap,
    /// An electromagnetic tracker: pose of the tip; 0.7 mm, 0.4 degrees, 40 Hz, 15 ms.
    Em,
    /// A pair of cameras: position of the tip; 1 mm, 30 Hz, 30 ms.
    Camera,
    /// A fiber with Bragg gratings: curvature at 12 stations; 2 % of the length in the tip's position after integration, 100 Hz, 10 ms.
    Fbg,
    /// A force-torque sensor under the clamp; 0.02 N, 0.5 mN m, 500 Hz, 2 ms.
    BaseWrench,
    /// An inertial unit on the tip: rotation and angular velocity; 1 degree, 0.1 degrees/s, 200 Hz, 2 ms.
    Imu,
}

impl SensorPreset {
    /// Its settings for an arm; `model` is the rod whose nodes [`Self::State`] gives.
    #[must_use]
    pub fn settings(self, model: &Rod) -> SensorSettings {
        todo!("{model:?}")
    }
}

/// What a [`Sensor`] measures. Every standard deviation is that of each of three numbers; `None`: not measured, 0: exact.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorSettings {
    /// Where: arc length over the arm's length, 0 to 1.
    pub places: Vec<f64>,
    /// Positions at the places, m.
    pub position: Option<f64>,
    /// Rotations at the places, rad.
    pub rotation: Option<f64>,
    /// Velocities at the places, m/s.
    pub velocity: Option<f64>,
    /// Angular velocities at the places, rad/s.
    pub angular_velocity: Option<f64>,
    /// Curvatures at the places, 1/m.
    pub curvature: Option<f64>,
    /// Force on the clamp, N.
    pub base_force: Option<f64>,
    /// Moment on the clamp, N m.
    pub base_moment: Option<f64>,
    /// Measurements a second, Hz.
    pub rate_hz: f64,
    /// Time from the instant of a measurement until it is known, s.
    pub age_s: f64,
    /// Seed of the noise: the same seed gives the same noise.
    pub seed: u64,
}

/// A simulated sensor on a plant.
#[derive(Clone, Debug)]
pub struct Sensor {
    settings: SensorSettings,
}

impl Sensor {
    /// A sensor on an arm with this rod; its first measurement is due at time 0.
    ///
    /// # Errors
    /// [`MpcError::Setting`] for a place, a standard deviation, a rate or an age out of range, and where nothing is measured.
    pub fn new(settings: &SensorSettings, plant: &Rod) -> Result<Self, MpcError> {
        todo!("{settings:?} {plant:?}")
    }

    /// What it was made of.
    #[must_use]
    pub fn settings(&self) -> &SensorSettings {
        &self.settings
    }

    /// Whether a measurement is due at time `t`, s.
    #[must_use]
    pub fn is_due(&self, t: f64) -> bool {
        todo!("{t}")
    }

    /// Measures a plant that is at time `t` (s) in `state`, on its own nodes; the next measurement is due a period later on the sensor's own
    /// lattice of times. It is known from `t` plus the [age](SensorSettings::age_s) on.
    ///
    /// # Errors
    /// [`MpcError::Measurement`] for a state of another size.
    pub fn measure(
        &mut self,
        t: f64,
        state: &State,
        out: &mut Measurement,
    ) -> Result<(), MpcError> {
        todo!("{t} {state:?} {out:?}")
    }
}
