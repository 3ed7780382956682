//! Paths to follow, as points in time.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3};

use super::{Circle, FigureEight, TrackKeys};
use crate::control::Tracking;
use crate::mechanics::rotation::{from_quaternion, unit};
use crate::scene::model::Base;
use crate::scene::values::{Number, known};

/// Number of points on a turn, and on a ramp: the chords between them are off the circle by `r (1 - cos(π/360))`, a fraction of 4e-5 of the
/// radius.
const POINTS: f64 = 360.0;
/// Largest number of points; beyond it, points are farther apart.
const MOST_POINTS: f64 = 1e6;

impl TrackKeys {
    /// Takes the weights that the discretization chose for the quantities that the track follows.
    pub(in crate::scene) fn take_weights(&mut self, chosen: &Tracking) {
        self.weight = (!chosen.path.is_empty()).then(|| known(chosen.weight));
        self.orientation_weight =
            (chosen.end_of_turns().is_some()).then(|| known(chosen.rotation_weight));
    }

    /// Times in s and directions of length 1.
    pub(in crate::scene) fn directions(&self) -> Vec<(f64, Vector3<f64>)> {
        (self.directions.iter())
            .map(|&[t, x, y, z]| (t, unit([x, y, z]).into()))
            .collect()
    }

    /// Times in s and orientations, body to space.
    pub(in crate::scene) fn rotations(&self) -> Vec<(f64, Matrix3<f64>)> {
        (self.orientations_wxyz.iter())
            .map(|&[t, w, x, y, z]| (t, from_quaternion([w, x, y, z])))
            .collect()
    }

    /// Times in s and positions in m, up to `end` in s at least where the path turns.
    pub(in crate::scene) fn path(&self, end: f64) -> Vec<(f64, Vector3<f64>)> {
        if let Some((turns, shape)) = self.turns() {
            turns.points(end, shape)
        } else {
            let rows = (self.path_m.iter()).map(|&[t, x, y, z]| (t, Vector3::new(x, y, z)));
            if self.switches {
                held(rows)
            } else {
                rows.collect()
            }
        }
    }
}

impl TrackKeys {
    /// A closed path, and its shape.
    fn turns(&self) -> Option<(Turns, Shape)> {
        let circle = (self.circle.as_ref()).map(|circle| (Turns::from(circle), circle_of as Shape));
        circle.or_else(|| Some((Turns::from(self.figure_eight.as_ref()?), eight_of as Shape)))
    }

    /// Places of the tip along one turn of a closed path, m.
    pub(in crate::scene) fn round(&self) -> Option<Vec<Vector3<f64>>> {
        let (turns, shape) = self.turns()?;
        let phases = (0..ROUND).map(|i| TAU * i as f64 / ROUND as f64);
        Some(phases.map(|phase| turns.on_path(phase, shape)).collect())
    }

    /// Center of a closed path, m.
    pub(in crate::scene) fn center(&self) -> Option<Vector3<f64>> {
        self.turns().map(|(turns, _)| Vector3::from(turns.center))
    }
}

/// Function that returns the point of a closed path in its plane, in units of its size, from sine and cosine of the phase.
type Shape = fn(f64, f64) -> [f64; 2];

fn circle_of(sin: f64, cos: f64) -> [f64; 2] {
    [cos, sin]
}

fn eight_of(sin: f64, cos: f64) -> [f64; 2] {
    [sin, sin * cos]
}

/// Number of places that represent a closed path.
const ROUND: usize = 24;

/// Time between the end of one place and the beginning of the next, divided by the time of the switch (at least 1 s): zero up to rounding.
const SWITCH: f64 = 1e-9;

/// Returns the points of a path that stays at each place until the time of the next one.
fn held(rows: impl Iterator<Item = (f64, Vector3<f64>)>) -> Vec<(f64, Vector3<f64>)> {
    let mut out: Vec<(f64, Vector3<f64>)> = Vec::new();
    for (t, place) in rows {
        if let Some(&(before, last)) = out.last() {
            let end = t - SWITCH * t.abs().max(1.0);
            if end > before {
                out.push((end, last));
            }
        }
        out.push((t, place));
    }
    out
}

/// A closed path in a plane, repeated without end.
pub(super) struct Turns {
    pub center: [f64; 3],
    pub size: f64,
    pub normal: [f64; 3],
    pub turn: f64,
    pub from: Option<[f64; 3]>,
    pub ramp: Option<f64>,
}

impl From<&Circle> for Turns {
    fn from(circle: &Circle) -> Self {
        Self {
            center: circle.center_m,
            size: circle.radius_m.get(),
            normal: circle.normal,
            turn: circle.turn_s.get(),
            from: circle.from_m,
            ramp: circle.ramp_s.map(Number::get),
        }
    }
}

impl From<&FigureEight> for Turns {
    fn from(eight: &FigureEight) -> Self {
        Self {
            center: eight.center_m,
            size: eight.half_length_m.get(),
            normal: eight.normal,
            turn: eight.turn_s.get(),
            from: eight.from_m,
            ramp: eight.ramp_s.map(Number::get),
        }
    }
}

impl Turns {
    fn points(&self, end: f64, shape: Shape) -> Vec<(f64, Vector3<f64>)> {
        let ramp = self.ramp.unwrap_or(self.turn);
        let spacing = (self.turn.min(ramp) / POINTS).max(end / MOST_POINTS);
        let n = (end / spacing).ceil() as usize;
        (0..=n)
            .map(|i| {
                let t = i as f64 * spacing;
                (t, self.position(t, ramp, shape))
            })
            .collect()
    }

    /// The place at a phase, in rad.
    fn on_path(&self, phase: f64, shape: Shape) -> Vector3<f64> {
        let frame = from_quaternion(
            Base {
                direction: Some(self.normal),
                ..Base::default()
            }
            .unit_quaternion(),
        );
        let (sin, cos) = phase.sin_cos();
        let [x, y] = shape(sin, cos);
        Vector3::from(self.center) + frame * Vector3::new(x, y, 0.0) * self.size
    }

    fn position(&self, t: f64, ramp: f64, shape: Shape) -> Vector3<f64> {
        let on_path = self.on_path(TAU * t / self.turn, shape);
        let Some(from) = self.from.map(Vector3::from) else {
            return on_path;
        };
        let part = (t / ramp).min(1.0);
        from + (on_path - from) * (part * part * (3.0 - 2.0 * part))
    }
}
