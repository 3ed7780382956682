//! Paths that a node should follow, of its position, of its orientation, and of its velocity.

use nalgebra::{Matrix3, Vector3};

use crate::mechanics::rotation::{exp, log};

/// Part of a second by which times that are the same may differ.
const SAME_TIME: f64 = 1e-9;

/// Weighted distances of a node from where it should be and from how it should be turned, from a time on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tracking {
    /// The node.
    pub node: usize,
    /// Where it should be: `(t, x)` in s and m with increasing times; linear in between, constant outside. Empty: anywhere.
    pub path: Vec<(f64, Vector3<f64>)>,
    /// Weight of `½ |x - x*|²/L²`, per second.
    pub weight: f64,
    /// How it should be turned: `(t, R*)`, body to space, with increasing times; at constant speed about one axis in between, constant
    /// outside. Empty: in any way.
    pub rotations: Vec<(f64, Matrix3<f64>)>,
    /// Weight of `½ |log(R*ᵀ R)|²`, per second.
    pub rotation_weight: f64,
    /// Weight of `½ |v - v*|² T²/L²`, per second, with `v*` the velocity along the path, 0 without a path. Both are means from one
    /// sample to the next; 0: any velocity.
    pub speed_weight: f64,
    /// Time from which on the distances count, s.
    pub from: f64,
}

/// The rows around a time, and the part of the way between them that has passed.
fn around<T: Copy>(rows: &[(f64, T)], t: f64) -> Option<(T, T, f64)> {
    let next = rows.partition_point(|&(time, _)| time <= t);
    let at = |i: usize| rows.get(i).copied();
    match (next.checked_sub(1).and_then(at), at(next)) {
        (Some((t0, from)), Some((t1, to))) => Some((from, to, (t - t0) / (t1 - t0))),
        (Some((_, held)), None) | (None, Some((_, held))) => Some((held, held, 0.0)),
        (None, None) => None,
    }
}

impl Tracking {
    /// Whether the distances count at time `t`.
    #[must_use]
    pub fn counts(&self, t: f64) -> bool {
        t >= self.from - SAME_TIME * (1.0 + self.from.abs())
    }

    /// Where the node should be at time `t`, m; `None` where that is free.
    #[must_use]
    pub fn position(&self, t: f64) -> Option<Vector3<f64>> {
        around(&self.path, t).map(|(from, to, part)| from + (to - from) * part)
    }

    /// Mean velocity of the path between two times, m/s; 0 without a path.
    #[must_use]
    pub fn velocity(&self, [from, to]: [f64; 2]) -> Vector3<f64> {
        match (self.position(from), self.position(to)) {
            (Some(a), Some(b)) => (b - a) / (to - from),
            _ => Vector3::zeros(),
        }
    }

    /// How the node should be turned at time `t`, body to space; `None` where that is free.
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

    /// `log(R*ᵀ R)` of a node that is turned by `r` at time `t`, rad; `None` where its orientation is free.
    #[must_use]
    pub fn turn(&self, t: f64, r: &Matrix3<f64>) -> Option<Vector3<f64>> {
        (self.rotation(t)).map(|rotation| log(&(rotation.transpose() * r)))
    }
}
