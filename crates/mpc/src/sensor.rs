//! Simulated sensors: the measured quantities of a plant, with their rate, age and noise.

use nalgebra::Vector3;

use super::error::{MpcError, state_fits};
use super::estimator::{Disturbance, Reader};
use super::signal::{EARLY, Measurement, Quantity, Signal};
use mechanics::{Rod, State};

/// Usual sensors, with their noise, rate and age.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum SensorPreset {
    /// The whole state on the nodes of the model, exact and at once, 1000 Hz. A filter assumes that velocities are off
    /// by a hundredth of the length over the time scale, because no model has the fast waves of an arm right.
    State,
    /// Motion capture: poses at a third, two thirds and all of the length; 0.2 mm, 0.2 degrees, 200 Hz, 5 ms.
    Mocap,
    /// An electromagnetic tracker: pose of the tip; 0.7 mm, 0.4 degrees, 40 Hz, 15 ms.
    Em,
    /// A pair of cameras: position of the tip; 1 mm, 30 Hz, 30 ms.
    Camera,
    /// A fiber with Bragg gratings: curvature and twist at 12 stations; 2 % of the length in the tip's position after integration, 100 Hz,
    /// 10 ms.
    Fbg,
    /// A force-torque sensor under the clamp; 0.02 N, 0.5 mN m, 500 Hz, 2 ms.
    BaseWrench,
    /// An inertial unit on the tip: rotation and angular velocity; 1 degree, 0.1 degrees/s, 200 Hz, 5 ms.
    Imu,
}

/// Number of stations of a fiber: the default of `places` of the preset `"fbg"`.
const STATIONS: usize = 12;
/// Error of the tip's position after the integration of a fiber's curvatures, divided by the length: the default of `curvature_1_m` of the
/// preset `"fbg"` follows from it. A multi-core fiber was measured to be off by less than 0.025 (Violakis et al. 2025, *Sensors* 25, 4494).
const FIBER_ERROR: f64 = 0.02;

impl SensorPreset {
    /// Returns the settings of this kind for an arm: defaults of the keys of a `[[sensor]]`, each of which replaces its own. `model` is the
    /// rod whose nodes [`Self::State`] measures, and whose length enters [`Self::Fbg`].
    ///
    /// Independent curvatures of standard deviation `σ` at `n` stations `L/n` apart displace the tip laterally by `σ L²/sqrt(3 n)`, to
    /// first order for a straight arm; that is set to 2 % of `L`.
    #[must_use]
    pub fn settings(self, model: &Rod) -> SensorSettings {
        let degrees = f64::to_radians;
        let poses = |places: Vec<f64>, position: f64, rotation: f64| SensorSettings {
            places,
            position: Some(position),
            rotation: Some(rotation),
            ..SensorSettings::nothing()
        };
        let known = |settings: SensorSettings, rate_hz: f64, age_s: f64| SensorSettings {
            rate_hz,
            age_s,
            ..settings
        };
        match self {
            Self::State => {
                let places = model.places().split_off(model.first_free_node());
                let settings = SensorSettings {
                    velocity: Some(0.0),
                    angular_velocity: Some(0.0),
                    ..poses(places, 0.0, 0.0)
                };
                known(settings, 1000.0, 0.0)
            }
            Self::Mocap => {
                let places = vec![1.0 / 3.0, 2.0 / 3.0, 1.0];
                known(poses(places, 2e-4, degrees(0.2)), 200.0, 0.005)
            }
            Self::Em => known(poses(vec![1.0], 7e-4, degrees(0.4)), 40.0, 0.015),
            Self::Camera => {
                let settings = SensorSettings {
                    places: vec![1.0],
                    position: Some(1e-3),
                    ..SensorSettings::nothing()
                };
                known(settings, 30.0, 0.03)
            }
            Self::Fbg => {
                let n = STATIONS as f64;
                let settings = SensorSettings {
                    places: (0..STATIONS).map(|i| (i as f64 + 0.5) / n).collect(),
                    curvature: Some(FIBER_ERROR * (3.0 * n).sqrt() / model.scales.length),
                    ..SensorSettings::nothing()
                };
                known(settings, 100.0, 0.01)
            }
            Self::BaseWrench => {
                let settings = SensorSettings {
                    base_force: Some(0.02),
                    base_moment: Some(5e-4),
                    ..SensorSettings::nothing()
                };
                known(settings, 500.0, 0.002)
            }
            Self::Imu => {
                let settings = SensorSettings {
                    places: vec![1.0],
                    rotation: Some(degrees(1.0)),
                    angular_velocity: Some(degrees(0.1)),
                    ..SensorSettings::nothing()
                };
                known(settings, 200.0, 0.005)
            }
        }
    }
}

/// Settings of a [`Sensor`]. Every standard deviation is that of each of three values; `None` means not measured, 0 means exact.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorSettings {
    /// Places of the measurements: arc length divided by the arm's length, 0 to 1.
    pub places: Vec<f64>,
    /// Offsets from the center of the section, along its first and second director, m, at each of which the quantities that
    /// [have one](crate::QuantityRow::has_offset) are measured at every place.
    pub offsets: Vec<[f64; 2]>,
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
    /// Strains of fibres at the offsets, at the places.
    pub strain: Option<f64>,
    /// Force on the clamp, N.
    pub base_force: Option<f64>,
    /// Moment on the clamp, N m.
    pub base_moment: Option<f64>,
    /// Measurements per second, Hz.
    pub rate_hz: f64,
    /// Time from the instant of a measurement until it is known, s.
    pub age_s: f64,
    /// Seed of the noise: equal seeds give equal noise. Several sensors need different seeds.
    pub seed: u64,
}

impl SensorSettings {
    /// Returns a sensor without measured quantities, at 100 Hz and without delay, to be completed with `..`.
    #[must_use]
    pub fn nothing() -> Self {
        Self {
            places: Vec::new(),
            offsets: vec![[0.0; 2]],
            position: None,
            rotation: None,
            velocity: None,
            angular_velocity: None,
            curvature: None,
            strain: None,
            base_force: None,
            base_moment: None,
            rate_hz: 100.0,
            age_s: 0.0,
            seed: 0,
        }
    }

    /// Returns the standard deviation of a quantity; `None` where it is not measured.
    #[must_use]
    pub fn sigma(&self, quantity: Quantity) -> Option<f64> {
        match quantity {
            Quantity::Position => self.position,
            Quantity::Rotation => self.rotation,
            Quantity::Velocity => self.velocity,
            Quantity::AngularVelocity => self.angular_velocity,
            Quantity::Curvature => self.curvature,
            Quantity::Strain => self.strain,
            Quantity::BaseForce => self.base_force,
            Quantity::BaseMoment => self.base_moment,
        }
    }

    /// Returns the place of a quantity's standard deviation.
    pub fn sigma_mut(&mut self, quantity: Quantity) -> &mut Option<f64> {
        match quantity {
            Quantity::Position => &mut self.position,
            Quantity::Rotation => &mut self.rotation,
            Quantity::Velocity => &mut self.velocity,
            Quantity::AngularVelocity => &mut self.angular_velocity,
            Quantity::Curvature => &mut self.curvature,
            Quantity::Strain => &mut self.strain,
            Quantity::BaseForce => &mut self.base_force,
            Quantity::BaseMoment => &mut self.base_moment,
        }
    }

    /// Returns what is measured, with its standard deviation: at places along the arm, or at the clamp.
    pub fn measured(&self, at_clamp: bool) -> impl Iterator<Item = (Quantity, f64)> + '_ {
        (Quantity::TABLE.iter())
            .filter(move |row| row.at_clamp == at_clamp)
            .filter_map(|row| Some((row.quantity, self.sigma(row.quantity)?)))
    }

    /// Returns the names, as in scenes, of the quantities of a shape that the sensor measures more exactly than a model with its elements can, each with
    /// its standard deviation and with that of the model's error; a Kalman filter takes the latter for it.
    pub fn sharper_than(&self, model: &Rod) -> Vec<(&'static str, f64, f64)> {
        (Quantity::TABLE.iter().filter(|row| row.of_shape))
            .filter_map(|row| {
                let own = row.quantity.model_error(model, f64::INFINITY);
                let sigma = self.sigma(row.quantity).filter(|sigma| *sigma < own)?;
                Some((row.key, sigma, own))
            })
            .collect()
    }

    fn check(&self) -> Result<(), MpcError> {
        let require = |name, value: f64, holds: bool, expected| {
            if value.is_finite() && holds {
                Ok(())
            } else {
                Err(MpcError::Setting {
                    name,
                    value,
                    expected,
                })
            }
        };
        for &place in &self.places {
            let holds = (0.0..=1.0).contains(&place);
            require("places", place, holds, "a part of the length, 0 to 1")?;
        }
        for &offset in self.offsets.iter().flatten() {
            require("offsets", offset, true, "a finite number")?;
        }
        for row in &Quantity::TABLE {
            let sigma = self.sigma(row.quantity).unwrap_or(0.0);
            require(row.key, sigma, sigma >= 0.0, "a number of at least 0")?;
        }
        let is_used = self.measured(false).any(|(own, _)| own.row().has_offset);
        if self.offsets.iter().flatten().any(|x| *x != 0.0) && !is_used {
            return Err(MpcError::Unsupported(
                "offsets in the section belong to positions and strains, which this sensor does not measure; leave offsets_m out",
            ));
        }
        let rate = self.rate_hz;
        require("rate_hz", rate, rate > 0.0, "a positive number")?;
        let age = self.age_s;
        require("age_s", age, age >= 0.0, "a number of at least 0")?;
        let n_places = self.places.len() as f64;
        if self.measured(false).next().is_some() {
            let expected = "at least one where something is measured at places";
            require("number of places", n_places, n_places > 0.0, expected)?;
            let n_offsets = self.offsets.len() as f64;
            require(
                "number of offsets",
                n_offsets,
                n_offsets > 0.0,
                "at least one; [0, 0] is the center",
            )
        } else if self.measured(true).next().is_some() {
            Ok(())
        } else {
            Err(MpcError::Unsupported(
                "a sensor measures something; give at least one standard deviation",
            ))
        }
    }
}

/// A simulated sensor on a plant.
#[derive(Clone, Debug)]
pub struct Sensor {
    settings: SensorSettings,
    rod: Rod,
    reader: Reader,
    dice: fastrand::Rng,
    /// Index of the next measurement.
    next: f64,
}

impl Sensor {
    /// Creates a sensor for an arm with this rod; its first measurement is due at time 0.
    ///
    /// # Errors
    /// Returns [`MpcError::Setting`] for a place, a standard deviation, a rate or an age out of range, and [`MpcError::Unsupported`] if
    /// nothing is measured.
    pub fn new(settings: &SensorSettings, plant: &Rod) -> Result<Self, MpcError> {
        settings.check()?;
        if !plant.actuators.is_empty() && settings.measured(true).next().is_some() {
            return Err(MpcError::Unsupported(
                "the force on the clamp of an arm with actuators in it does not follow from its shape alone; measure poses or curvatures",
            ));
        }
        Ok(Self {
            settings: settings.clone(),
            rod: plant.clone(),
            reader: Reader::new(plant),
            dice: fastrand::Rng::with_seed(scattered(settings.seed)),
            next: 0.0,
        })
    }

    /// Returns the settings.
    #[must_use]
    pub fn settings(&self) -> &SensorSettings {
        &self.settings
    }

    /// Returns the time at which the next measurement is due, s.
    #[must_use]
    pub fn next_due(&self) -> f64 {
        self.next / self.settings.rate_hz
    }

    /// Tells whether a measurement is due at time `t`, s.
    #[must_use]
    pub fn is_due(&self, t: f64) -> bool {
        t * self.settings.rate_hz >= self.next - EARLY
    }

    /// Measures a plant at time `t` (s) in `state`, on its own nodes; the next measurement is due at the next multiple of the sensor's
    /// period. The measurement is known from `t` plus the [age](SensorSettings::age_s) on.
    ///
    /// # Errors
    /// Returns [`MpcError::Measurement`] for a state of another size.
    pub fn measure(
        &mut self,
        t: f64,
        state: &State,
        out: &mut Measurement,
    ) -> Result<(), MpcError> {
        state_fits(state, &self.rod)?;
        out.time = t;
        out.signals.clear();
        let settings = &self.settings;
        let along = settings.places.iter().flat_map(|&place| {
            settings.measured(false).flat_map(move |(quantity, sigma)| {
                let offsets = match quantity.row().has_offset {
                    true => &settings.offsets[..],
                    false => &[[0.0; 2]],
                };
                (offsets.iter()).map(move |&offset| (quantity, (place, offset), sigma))
            })
        });
        let at_clamp = settings.measured(true);
        let at_clamp = at_clamp.map(|(own, sigma)| (own, (0.0, [0.0; 2]), sigma));
        for (quantity, site, sigma) in along.chain(at_clamp) {
            let reader = &self.reader;
            let exact = reader.read(&self.rod, t, state, &Disturbance::NONE, quantity, site);
            let numbers = quantity.row().numbers;
            let noise = Vector3::from_fn(|axis, _| {
                let number = normal(&mut self.dice);
                if axis < numbers { number } else { 0.0 }
            });
            let noise = noise * sigma;
            out.signals.push(Signal {
                place: site.0,
                offset: site.1,
                reading: exact.with_noise(&noise),
                sigma,
            });
        }
        self.next = (t * self.settings.rate_hz + EARLY).floor() + 1.0;
        Ok(())
    }
}

/// Returns a seed far from those of neighboring seeds, whose first numbers would resemble each other: the finalizer of SplitMix64 (Steele,
/// Lea and Flood 2014).
#[must_use]
pub fn scattered(seed: u64) -> u64 {
    let mut z = seed.wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// Returns a number from the standard normal distribution, by Box and Muller's formula.
pub fn normal(dice: &mut fastrand::Rng) -> f64 {
    let radius = (-2.0 * (1.0 - dice.f64()).ln()).sqrt();
    radius * (std::f64::consts::TAU * dice.f64()).cos()
}
