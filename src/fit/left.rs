//! The distances that a fit leaves, by marker, by the direction of the commands, and by the bending of the arm.

use nalgebra::Vector3;
use serde::Serialize;

use super::{Model, Pose};

/// Fewest places that are compared by the bending.
const FEWEST: usize = 6;
/// Turns of the arm that differ by less are one, rad.
const SAME_TURN: f64 = 1e-6;

/// Distances of the places of markers, in parts.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Left {
    /// By marker, in the order of the data.
    pub by_marker: Vec<Part>,
    /// `rising` and `falling` commands of rows of tables, by the change of their sum since the row before in the same group.
    pub by_direction: Vec<Part>,
    /// Thirds of the places by the turn of the arm under the estimates.
    pub by_bend: Vec<Part>,
    /// Correlation of the distance and the turn of the arm, of fitted places.
    pub bend_correlation: Option<f64>,
}

/// Distances of a part of the places.
#[derive(Clone, Debug, Serialize)]
pub struct Part {
    /// Name of the marker, or the direction.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Least and largest turn of the arm: the sum of the angles between the tangents of neighboring nodes, rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub turn_rad: Option<[f64; 2]>,
    /// Number of places, with those that were held out.
    pub places: usize,
    /// Root of the mean square of the distances of fitted places, m; null without any.
    pub rms_m: Option<f64>,
    /// That of places that were held out, m.
    pub held_out_rms_m: Option<f64>,
    /// Mean of the vectors from measured to predicted places, m.
    pub mean_m: [f64; 3],
}

/// A place as it is predicted, beside the measured one.
struct Place {
    marker: usize,
    held_out: bool,
    /// Tells whether the commands have risen.
    rises: Option<bool>,
    /// Turn of the arm, rad.
    turn: f64,
    /// Vector from the measured to the predicted place, m.
    off: Vector3<f64>,
}

impl Part {
    /// Returns the distances of some places; `None` without any.
    fn of(name: Option<String>, places: &[&Place]) -> Option<Self> {
        let n = places.len();
        let rms = |held_out: bool| {
            let own = places.iter().filter(|place| place.held_out == held_out);
            let squares: Vec<f64> = own.map(|place| place.off.norm_squared()).collect();
            (!squares.is_empty())
                .then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
        };
        let sum: Vector3<f64> = places.iter().map(|place| place.off).sum();
        (n > 0).then(|| Self {
            name,
            turn_rad: None,
            places: n,
            rms_m: rms(false),
            held_out_rms_m: rms(true),
            mean_m: (sum / n as f64).into(),
        })
    }
}

impl Left {
    /// Returns the distances of predicted poses, case by case.
    pub(super) fn of(model: &Model, predicted: &[Vec<Pose>]) -> Self {
        let mut places = Vec::new();
        for (case, poses) in model.cases.iter().zip(predicted) {
            let rises = case.rows().map(|rows| rows.rises());
            for (sight, pose) in case.sights.iter().zip(poses) {
                let Some(off) = pose.off(sight) else {
                    continue;
                };
                places.push(Place {
                    marker: sight.marker,
                    held_out: case.held_out,
                    rises: rises.as_ref().and_then(|own| own[sight.time as usize]),
                    turn: pose.turn_of_arm,
                    off,
                });
            }
        }
        let part = |name: &str, is: &dyn Fn(&Place) -> bool| {
            let own: Vec<&Place> = places.iter().filter(|place| is(place)).collect();
            Part::of(Some(name.into()), &own)
        };
        let markers = model.markers.iter().enumerate();
        Self {
            by_marker: markers
                .filter_map(|(i, own)| part(&own.name, &|place| place.marker == i))
                .collect(),
            by_direction: [("rising", true), ("falling", false)]
                .into_iter()
                .filter_map(|(name, rises)| part(name, &|place| place.rises == Some(rises)))
                .collect(),
            by_bend: by_bend(&places),
            bend_correlation: correlation(&places),
        }
    }
}

/// Returns thirds of the places, from the least to the largest turn of the arm; nothing where there are few, or all turns are alike.
fn by_bend(places: &[Place]) -> Vec<Part> {
    let mut sorted: Vec<&Place> = places.iter().collect();
    sorted.sort_by(|a, b| a.turn.total_cmp(&b.turn));
    let n = sorted.len();
    if n < FEWEST || sorted[n - 1].turn - sorted[0].turn < SAME_TURN {
        return Vec::new();
    }
    (0..3)
        .filter_map(|third| {
            let own = &sorted[third * n / 3..(third + 1) * n / 3];
            Some(Part {
                turn_rad: Some([own.first()?.turn, own.last()?.turn]),
                ..Part::of(None, own)?
            })
        })
        .collect()
}

/// Returns the correlation of distance and turn of fitted places.
fn correlation(places: &[Place]) -> Option<f64> {
    let fitted = || places.iter().filter(|place| !place.held_out);
    let n = fitted().count();
    let mean = |of: &dyn Fn(&Place) -> f64| fitted().map(of).sum::<f64>() / n as f64;
    let (turn, off) = (mean(&|own| own.turn), mean(&|own| own.off.norm()));
    let covariance = |a: &dyn Fn(&Place) -> f64, b: &dyn Fn(&Place) -> f64| {
        fitted().map(|own| a(own) * b(own)).sum::<f64>()
    };
    let turns = |own: &Place| own.turn - turn;
    let offs = |own: &Place| own.off.norm() - off;
    let squares = [covariance(&turns, &turns), covariance(&offs, &offs)];
    let is_told = n >= FEWEST && squares[0].sqrt() > SAME_TURN && squares[1] > 0.0;
    is_told.then(|| covariance(&turns, &offs) / (squares[0] * squares[1]).sqrt())
}
