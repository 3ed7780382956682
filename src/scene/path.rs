//! Paths to follow, as points in time.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use super::model::{Base, Circle, Track};
use super::values::Number;
use crate::mechanics::rotation::from_quaternion;

/// Points a turn, and a ramp: chords between them are `r (1 - cos(π/360))`, four parts in 100 000 of the radius, off the circle.
const POINTS: f64 = 360.0;
/// Points beyond this number would be farther apart.
const MOST_POINTS: f64 = 1e6;

impl Track {
    /// Times in s and positions in m, up to `end` in s at least where the path is a circle.
    pub(super) fn path(&self, end: f64) -> Vec<(f64, Vector3<f64>)> {
        match &self.circle {
            Some(circle) => circle.points(end),
            None => (self.path_m.iter())
                .map(|&[t, x, y, z]| (t, Vector3::new(x, y, z)))
                .collect(),
        }
    }
}

impl Circle {
    fn points(&self, end: f64) -> Vec<(f64, Vector3<f64>)> {
        let ramp = self.ramp_s.map_or(self.turn_s.get(), Number::get);
        let spacing = (self.turn_s.get().min(ramp) / POINTS).max(end / MOST_POINTS);
        let n = (end / spacing).ceil() as usize;
        (0..=n)
            .map(|i| {
                let t = i as f64 * spacing;
                (t, self.position(t, ramp))
            })
            .collect()
    }

    fn position(&self, t: f64, ramp: f64) -> Vector3<f64> {
        let frame = from_quaternion(
            Base {
                direction: Some(self.normal),
                ..Base::default()
            }
            .unit_quaternion(),
        );
        let (sin, cos) = (TAU * t / self.turn_s.get()).sin_cos();
        let on_circle = Vector3::from(self.center_m)
            + frame * Vector3::new(cos, sin, 0.0) * self.radius_m.get();
        let Some(from) = self.from_m.map(Vector3::from) else {
            return on_circle;
        };
        let part = (t / ramp).min(1.0);
        from + (on_circle - from) * (part * part * (3.0 - 2.0 * part))
    }
}
