//! Sensors of a closed loop: their keys, and the quantities that they measure.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::keys::{Checked, Keys};
use super::super::values::{self, NonNegative, Number, Positive, known};
use crate::mechanics::Rod;
use crate::mpc::{Quantity, QuantityRow, SensorPreset, SensorSettings};

/// A sensor with its noise, rate and age; a single one may be written as `[sensor]`. A standard deviation is that of
/// each of three numbers, and 0 is exact; a quantity without a standard deviation, of its own or by `preset`, is not
/// measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SensorKeys {
    /// Usual sensor, which supplies the keys below that are not given.
    pub preset: Option<SensorPreset>,
    /// Places of the measurement, as fractions of the length from the base. Absent: those of `preset`.
    pub places: Option<Vec<f64>>,
    /// Offsets in m from the center of the section, along its two directors, at each of which positions and strains are measured
    /// at every place, as by markers on the surface and by fibres along it. Absent: the center alone.
    pub offsets_m: Option<Vec<[f64; 2]>>,
    /// Standard deviation of positions in m, not negative. Absent: that of `preset`, or not measured.
    pub position_sigma_m: Option<NonNegative<values::Deviation>>,
    /// Standard deviation of rotations in rad, not negative. Absent: that of `preset`, or not measured.
    pub rotation_sigma_rad: Option<NonNegative<values::Deviation>>,
    /// Standard deviation of velocities in m/s, not negative. Absent: that of `preset`, or not measured.
    pub velocity_sigma_m_s: Option<NonNegative<values::Deviation>>,
    /// Standard deviation of angular velocities in rad/s, not negative. Absent: that of `preset`, or not measured.
    pub angular_velocity_sigma_rad_s: Option<NonNegative<values::Deviation>>,
    /// Standard deviation of curvatures and twist in 1/m, not negative. Absent: that of `preset`, or not measured.
    pub curvature_sigma_1_m: Option<NonNegative<values::Deviation>>,
    /// Standard deviation of the strains of fibres that run along the arm at `offsets_m`, not negative. Absent: not measured.
    pub strain_sigma: Option<NonNegative<values::Deviation>>,
    /// Standard deviation of the force on the clamp in N, not negative. Absent: that of `preset`, or not measured.
    pub base_force_sigma_n: Option<NonNegative<values::Deviation>>,
    /// Standard deviation of the moment on the clamp in N m, not negative. Absent: that of `preset`, or not measured.
    pub base_moment_sigma_n_m: Option<NonNegative<values::Deviation>>,
    /// Measurements per second, positive. The default of `mpc.fallback.patience_s` depends on it. Absent: that of
    /// `preset`, or 100.
    pub rate_hz: Option<Positive<values::Rate>>,
    /// Time in s from the instant of a measurement until it is known, not negative. Absent: that of `preset`, or 0.
    pub age_s: Option<NonNegative<values::Time>>,
}

impl SensorKeys {
    /// Returns the key of a quantity's standard deviation.
    fn sigma(&self, quantity: Quantity) -> Option<NonNegative<values::Deviation>> {
        match quantity {
            Quantity::Position => self.position_sigma_m,
            Quantity::Rotation => self.rotation_sigma_rad,
            Quantity::Velocity => self.velocity_sigma_m_s,
            Quantity::AngularVelocity => self.angular_velocity_sigma_rad_s,
            Quantity::Curvature => self.curvature_sigma_1_m,
            Quantity::Strain => self.strain_sigma,
            Quantity::BaseForce => self.base_force_sigma_n,
            Quantity::BaseMoment => self.base_moment_sigma_n_m,
        }
    }

    /// Returns the settings of the sensor on an arm with this model: its own numbers, and for absent ones those of its preset.
    pub(in crate::scene) fn settings(&self, model: &Rod) -> SensorSettings {
        let mut out = self
            .preset
            .map_or_else(SensorSettings::nothing, |preset| preset.settings(model));
        for row in &Quantity::TABLE {
            let own = out.sigma_mut(row.quantity);
            *own = self.sigma(row.quantity).map(Number::get).or(*own);
        }
        if let Some(places) = &self.places {
            out.places.clone_from(places);
        }
        if let Some(offsets) = &self.offsets_m {
            out.offsets.clone_from(offsets);
        }
        out.rate_hz = self.rate_hz.map_or(out.rate_hz, Number::get);
        out.age_s = self.age_s.map_or(out.age_s, Number::get);
        out
    }

    /// The keys of a sensor, all of them.
    pub(in crate::scene) fn describing(settings: &SensorSettings) -> Self {
        Self {
            preset: None,
            places: (!settings.places.is_empty()).then(|| settings.places.clone()),
            offsets_m: (settings.offsets != [[0.0; 2]]).then(|| settings.offsets.clone()),
            position_sigma_m: settings.position.map(known),
            rotation_sigma_rad: settings.rotation.map(known),
            velocity_sigma_m_s: settings.velocity.map(known),
            angular_velocity_sigma_rad_s: settings.angular_velocity.map(known),
            curvature_sigma_1_m: settings.curvature.map(known),
            strain_sigma: settings.strain.map(known),
            base_force_sigma_n: settings.base_force.map(known),
            base_moment_sigma_n_m: settings.base_moment.map(known),
            rate_hz: Some(known(settings.rate_hz)),
            age_s: Some(known(settings.age_s)),
        }
    }
}

impl Keys<'_> {
    pub(in crate::scene) fn check_sensor(&self, sensor: &SensorKeys, index: usize) -> Checked {
        let key = |name: &str| format!("sensor.{index}.{name}");
        for (at, place) in sensor.places.iter().flatten().enumerate() {
            if !(0.0..=1.0).contains(place) {
                let key = key(&format!("places.{at}"));
                return Err(self.out_of_range(&key, *place, "fraction from 0 to 1", ""));
            }
        }
        if let Some(offsets) = &sensor.offsets_m {
            if offsets.is_empty() {
                return Err(self.missing(&key("offsets_m.0"), "[0.0, 0.0] is the center"));
            }
            for (at, offset) in offsets.iter().enumerate() {
                self.finite(&key(&format!("offsets_m.{at}")), offset)?;
            }
            let is_of_use = |row: &&QuantityRow| {
                row.has_offset && (sensor.preset.is_some() || sensor.sigma(row.quantity).is_some())
            };
            if !Quantity::TABLE.iter().any(|row| is_of_use(&row)) {
                let relation = "offsets_m belong to positions and strains";
                return Err(self.missing(&key("position_sigma_m"), relation));
            }
        }
        let measures = |at_clamp| {
            let mut rows = (Quantity::TABLE.iter()).filter(|row| row.at_clamp == at_clamp);
            rows.any(|row| sensor.sigma(row.quantity).is_some())
        };
        if sensor.preset.is_some() {
            return match &sensor.places {
                Some(places) if places.is_empty() => {
                    Err(self.missing(&key("places.0"), "a sensor is somewhere"))
                }
                _ => Ok(()),
            };
        }
        let is_somewhere = sensor
            .places
            .as_ref()
            .is_some_and(|places| !places.is_empty());
        match (measures(false), is_somewhere) {
            (true, false) => Err(self.missing(&key("places"), "as fractions of the arm's length")),
            (false, true) => Err(self.missing(
                &key("position_sigma_m"),
                "or another standard deviation of what is measured at the places",
            )),
            (false, false) if !measures(true) => Err(self.missing(
                &key("preset"),
                "or else give places and standard deviations",
            )),
            _ => Ok(()),
        }
    }
}
