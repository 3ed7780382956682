//! Ranges and relations of the keys of a closed loop, and of paths to follow.

use super::check::{LARGEST_COUNT, MOST_ELEMENTS};
use super::keys::{Checked, Keys};
use super::model::{Estimator, EstimatorKind, Mpc, Plant, Scene, Sensor, Track, Unknown};
use super::path::Turns;
use super::values::{Number, digits};

impl Keys<'_> {
    pub(super) fn check_closed_loop(&self, scene: &Scene) -> Checked {
        if let Some(mpc) = &scene.mpc {
            self.check_mpc(mpc, scene)?;
        }
        if let Some(plant) = &scene.plant {
            self.check_plant(plant, scene)?;
        }
        for (index, sensor) in scene.sensor.iter().enumerate() {
            self.check_sensor(sensor, index)?;
        }
        match (&scene.estimator, scene.sensor.is_empty()) {
            (None, false) => {
                let relation = "goes with sensor; kind = \"kalman\", \"observer\" or \"none\"";
                return Err(self.missing("estimator", relation));
            }
            (Some(estimator), no_sensor) => self.check_estimator(estimator, no_sensor)?,
            (None, true) => {}
        }
        for (index, load) in scene.disturbance.iter().enumerate() {
            self.check_load("disturbance", load, index, scene.rod.elements)?;
        }
        Ok(())
    }

    fn check_mpc(&self, mpc: &Mpc, scene: &Scene) -> Checked {
        self.count("mpc.iterations", mpc.iterations, LARGEST_COUNT)?;
        let period = mpc.period_s.get();
        if let Some(horizon) = mpc.horizon_s.map(Number::get)
            && horizon < period
        {
            let message = format!("{} s is below the period", digits(horizon));
            return Err(self
                .source
                .error_at("mpc.horizon_s", message, None)
                .expecting(format!(
                    "expected at least mpc.period_s, {}",
                    digits(period)
                )));
        }
        let duration = mpc.duration_s.map_or(scene.time.end_s.get(), Number::get);
        if !(duration > 0.0) {
            let message = "a loop cannot run for no time";
            let error = self.source.error_at("time.end_s", message, None);
            return Err(error.expecting("expected a positive duration, or mpc.duration_s"));
        }
        if duration / period > LARGEST_COUNT as f64 {
            let message = format!("makes {} samples", digits((duration / period).ceil()));
            return Err(self
                .source
                .error_at("mpc.period_s", message, None)
                .expecting(format!("expected at most {LARGEST_COUNT} samples")));
        }
        Ok(())
    }

    fn check_plant(&self, plant: &Plant, scene: &Scene) -> Checked {
        if let Some(elements) = plant.elements {
            self.count("plant.elements", elements, MOST_ELEMENTS)?;
        }
        if let Some(curvature) = &plant.curvature_1_m {
            self.finite("plant.curvature_1_m", curvature)?;
        }
        if let Some(section) = &plant.section {
            if scene.rod.section.is_none() {
                return Err(self.contradiction("plant.section", "rod.stiffness"));
            }
            self.check_section("plant.section", section)?;
        }
        Ok(())
    }

    fn check_sensor(&self, sensor: &Sensor, index: usize) -> Checked {
        let key = |name: &str| format!("sensor.{index}.{name}");
        for (at, place) in sensor.places.iter().flatten().enumerate() {
            if !(0.0..=1.0).contains(place) {
                let key = key(&format!("places.{at}"));
                return Err(self.out_of_range(&key, *place, "fraction from 0 to 1", ""));
            }
        }
        let at_places = [
            sensor.position_sigma_m,
            sensor.rotation_sigma_rad,
            sensor.velocity_sigma_m_s,
            sensor.angular_velocity_sigma_rad_s,
            sensor.curvature_sigma_1_m,
        ];
        let at_base = [sensor.base_force_sigma_n, sensor.base_moment_sigma_n_m];
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
        match (at_places.iter().any(Option::is_some), is_somewhere) {
            (true, false) => Err(self.missing(&key("places"), "as fractions of the arm's length")),
            (false, true) => Err(self.missing(
                &key("position_sigma_m"),
                "or another standard deviation of what is measured at the places",
            )),
            (false, false) if !at_base.iter().any(Option::is_some) => Err(self.missing(
                &key("preset"),
                "or else give places and standard deviations",
            )),
            _ => Ok(()),
        }
    }

    fn check_estimator(&self, estimator: &Estimator, no_sensor: bool) -> Checked {
        if estimator.kind != EstimatorKind::None && no_sensor {
            return Err(self.missing("sensor", "an estimator needs one; preset = \"mocap\""));
        }
        if let Some(elements) = estimator.elements {
            self.count("estimator.elements", elements, MOST_ELEMENTS)?;
        }
        let named = estimator.unknowns();
        for (index, one) in named.iter().enumerate() {
            if named[..index].contains(one) {
                let key = format!("estimator.disturbances.{index}");
                return Err(self.source.error_at(&key, "is named twice", None));
            }
        }
        let wrench = [Unknown::TipForce, Unknown::TipMoment];
        let is_known = match estimator.kind {
            EstimatorKind::Kalman => true,
            EstimatorKind::None => named.is_empty(),
            EstimatorKind::Observer => {
                named.is_empty()
                    || named.len() == wrench.len() && named.iter().all(|one| wrench.contains(one))
            }
        };
        if !is_known {
            let message = match estimator.kind {
                EstimatorKind::None => "without an estimator nothing is estimated",
                _ => "an observer estimates both \"tip_force\" and \"tip_moment\", or nothing",
            };
            let help = "give estimator.kind = \"kalman\" for a choice of all of them".to_string();
            let key = "estimator.disturbances";
            return Err(self.source.error_at(key, message, Some(help)));
        }
        Ok(())
    }

    /// A table of points, a circle or a figure eight, or none of them where there are orientations; `section` is the key of the track.
    pub(super) fn check_path(&self, section: &str, track: &Track) -> Checked {
        let key = |name: &str| format!("{section}.{name}");
        let circle = track.circle.as_ref().map(Turns::from);
        let eight = track.figure_eight.as_ref().map(Turns::from);
        let kinds = [
            ("path_m", !track.path_m.is_empty()),
            ("circle", circle.is_some()),
            ("figure_eight", eight.is_some()),
        ];
        let turns = &track.orientations_wxyz;
        if !turns.is_empty() {
            self.table(&key("orientations_wxyz"), turns, "any orientation")?;
            for (point, &[_, w, x, y, z]) in turns.iter().enumerate() {
                self.nonzero(&key(&format!("orientations_wxyz.{point}")), &[w, x, y, z])?;
            }
        } else if track.orientation_weight.is_some() {
            return Err(self.missing(&key("orientations_wxyz"), "goes with orientation_weight"));
        }
        let goes_somewhere = kinds.iter().any(|(_, given)| *given);
        if !goes_somewhere && turns.is_empty() && track.speed_weight.is_none() {
            let relation = "rows [t, x, y, z], or else give path_csv, circle or figure_eight, or \
                            orientations_wxyz, or speed_weight";
            return Err(self.missing(&key("path_m"), relation));
        }
        if goes_somewhere {
            self.exactly_one(section, &kinds)?;
        } else if track.weight.is_some() {
            return Err(self.missing(&key("path_m"), "goes with weight"));
        }
        if track.switches && track.path_m.is_empty() {
            return Err(self.missing(&key("path_m"), "goes with switches"));
        }
        if track.switches && track.speed_weight.is_some() {
            let message = "targets that switch have no velocity";
            let help = "leave out switches or speed_weight".into();
            return Err(self
                .source
                .error_at(&key("speed_weight"), message, Some(help)));
        }
        let circle = circle.map(|turns| ("circle", turns));
        let Some((name, turns)) = circle.or(eight.map(|turns| ("figure_eight", turns))) else {
            return match &track.path_m[..] {
                [] => Ok(()),
                rows => self.table(&key("path_m"), rows, "a circle"),
            };
        };
        let key = |part: &str| key(&format!("{name}.{part}"));
        self.finite(&key("center_m"), &turns.center)?;
        self.nonzero(&key("normal"), &turns.normal)?;
        match &turns.from {
            Some(from) => self.finite(&key("from_m"), from),
            None if turns.ramp.is_some() => Err(self.missing(&key("from_m"), "goes with ramp_s")),
            None => Ok(()),
        }
    }
}
