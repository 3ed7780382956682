//! Paths that a node should follow with its position, its orientation or direction, and its velocity.

use nalgebra::{Matrix3, Vector3};

use mechanics::direction::{Deviation, across};
use mechanics::rotation::{exp, log};

/// Returns the difference, s, up to which two times near `t` count as equal: far above the rounding of sums of steps, 1e-16 of a time for
/// each step, and far below any step.
pub fn rounding_of(t: f64) -> f64 {
    1e-9 * (1.0 + t.abs())
}

/// Weighted distances of a node from a path and from a sequence of orientations, from a given time on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tracking {
    /// Index of the node.
    pub node: usize,
    /// Path: `(t, x)` in s and m with increasing times; linear in between, constant outside. Empty for a free position.
    pub path: Vec<(f64, Vector3<f64>)>,
    /// Weight of `½ |x - x*|²/L²`, per second.
    pub weight: f64,
    /// Orientations: `(t, R*)`, body to space, with increasing times; turning at constant speed about one axis in between, constant
    /// outside. Empty for a free orientation.
    pub rotations: Vec<(f64, Matrix3<f64>)>,
    /// Directions of the axis `R e₃`: `(t, d)` of length 1, with increasing times; turning at constant speed along a great circle in
    /// between, constant outside. Empty for a free direction; excludes `rotations`.
    pub directions: Vec<(f64, Vector3<f64>)>,
    /// Weight of `½ |log(R*ᵀ R)|²`, or of half the squared angle between axis and direction, per second.
    pub rotation_weight: f64,
    /// Weight of `½ |v - v*|² T²/L²`, per second, where `v*` is the velocity along the path, or 0 without a path. Both are means from one
    /// sample to the next. 0 leaves the velocity free.
    pub speed_weight: f64,
    /// Time from which the distances count, s.
    pub from: f64,
}

/// Returns the rows around a time, and the fraction of the interval between them that has passed.
fn around<T: Copy>(rows: &[(f64, T)], t: f64) -> Option<(T, T, f64)> {
    let next = rows.partition_point(|&(time, _)| time <= t);
    let at = |i: usize| rows.get(i).copied();
    match (next.checked_sub(1).and_then(at), at(next)) {
        (Some((t0, from)), Some((t1, to))) => Some((from, to, (t - t0) / (t1 - t0))),
        (Some((_, held)), None) | (None, Some((_, held))) => Some((held, held, 0.0)),
        (None, None) => None,
    }
}

/// Returns the direction at a fraction of the great circle from one direction to another; two opposite ones are connected by a turn about
/// the first axis [across] them.
pub(super) fn on_great_circle(from: &Vector3<f64>, to: &Vector3<f64>, part: f64) -> Vector3<f64> {
    let about = from.cross(to);
    let turn = about.norm().atan2(from.dot(to));
    let about = (about.try_normalize(f64::EPSILON)).unwrap_or_else(|| across(from)[0]);
    exp(&(about * (turn * part))) * from
}

impl Tracking {
    /// Tells whether the distances count at time `t`.
    #[must_use]
    pub fn counts(&self, t: f64) -> bool {
        t >= self.from - rounding_of(self.from)
    }

    /// Returns the position on the path at time `t`, m; `None` if the position is free.
    #[must_use]
    pub fn position(&self, t: f64) -> Option<Vector3<f64>> {
        around(&self.path, t).map(|(from, to, part)| from + (to - from) * part)
    }

    /// Returns the mean velocity of the path between two times, m/s; 0 without a path.
    #[must_use]
    pub fn velocity(&self, [from, to]: [f64; 2]) -> Vector3<f64> {
        match (self.position(from), self.position(to)) {
            (Some(a), Some(b)) => (b - a) / (to - from),
            _ => Vector3::zeros(),
        }
    }

    /// Returns the orientation at time `t`, body to space; `None` if the orientation is free.
    #[must_use]
    pub fn rotation(&self, t: f64) -> Option<Matrix3<f64>> {
        around(&self.rotations, t).map(|(from, to, part)| {
            if part == 0.0 {
                from
            } else {
                from * exp(&(log(&(from.transpose() * to)) * part))
            }
        })
    }

    /// Returns the direction at time `t`, of length 1; `None` if the direction is free.
    #[must_use]
    pub fn direction(&self, t: f64) -> Option<Vector3<f64>> {
        around(&self.directions, t).map(|(from, to, part)| on_great_circle(&from, &to, part))
    }

    /// Returns the time of the last orientation or direction, s; `None` if both are free.
    #[must_use]
    pub fn end_of_turns(&self) -> Option<f64> {
        let directions = self.directions.last().map(|row| row.0);
        self.rotations.last().map(|row| row.0).or(directions)
    }

    /// Returns the angle, rad, of a node of rotation `r` from its orientation or its direction at time `t`; `None` if both are free.
    #[must_use]
    pub fn angle(&self, t: f64, r: &Matrix3<f64>) -> Option<f64> {
        let turn = self.turn(t, r).map(|turn| turn.norm());
        turn.or_else(|| Some(Deviation::of(&self.direction(t)?, r).angle()))
    }

    /// Returns `log(R*ᵀ R)`, rad, for a node of rotation `r` at time `t`; `None` if the orientation is free.
    #[must_use]
    pub fn turn(&self, t: f64, r: &Matrix3<f64>) -> Option<Vector3<f64>> {
        (self.rotation(t)).map(|rotation| log(&(rotation.transpose() * r)))
    }
}
