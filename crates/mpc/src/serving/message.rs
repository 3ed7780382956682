//! The lines of a served loop: one JSON object each.

#![expect(missing_docs, reason = "docs/serving.md explains every field")]

use std::collections::BTreeMap;

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use super::SERVING_VERSION;
use crate::closed_loop::{Percentiles, TipError};
use crate::command::CommandedControl;
use crate::estimator::Disturbance;
use crate::sensor::SensorSettings;
use crate::signal::Quantity;
use control::{ActuatedNode, Bound, Channel};
use mechanics::Drive;

/// Three numbers, and a rotation row by row.
pub type Vector = [f64; 3];
pub(crate) type Rows = [[f64; 3]; 3];

/// Returns the rows of a matrix.
pub fn rows(matrix: &Matrix3<f64>) -> Rows {
    std::array::from_fn(|i| std::array::from_fn(|j| matrix[(i, j)]))
}

/// Kind of a line of the plant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    Measurement,
    Bye,
}

/// A line of the plant. An absent or null field is not measured.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Line {
    #[serde(rename = "type")]
    pub kind: Kind,
    pub version: Option<u64>,
    pub time_s: Option<f64>,
    pub positions_m: Option<Vec<Vector>>,
    pub rotations: Option<Vec<Rows>>,
    pub velocities_m_s: Option<Vec<Vector>>,
    pub angular_velocities_rad_s: Option<Vec<Vector>>,
    pub linear_momenta_kg_m_s: Option<Vec<Vector>>,
    pub angular_momenta_kg_m2_s: Option<Vec<Vector>>,
    pub readings: Option<Vec<ReadingLine>>,
    /// Rows of a time, s, and a position, m.
    pub reference_m: Option<Vec<[f64; 4]>>,
    /// Rows of a time, s, and a quaternion.
    pub reference_wxyz: Option<Vec<[f64; 5]>>,
    pub obstacles: Option<Vec<ObstacleLine>>,
    pub disturbance: Option<Disturbance>,
}

/// The displacement of an obstacle at the time of the sample from its place in the scene.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObstacleLine {
    pub name: String,
    pub moved_m: Vector,
    pub velocity_m_s: Option<Vector>,
}

/// A reading of one sensor at one place: fields `time_s`, `place`, `offset_m`, and values under the names of [`Quantity::TABLE`].
#[derive(Clone, Debug, Deserialize)]
#[serde(try_from = "BTreeMap<String, serde_json::Value>")]
pub struct ReadingLine {
    pub time_s: Option<f64>,
    pub place: Option<f64>,
    pub offset_m: Option<[f64; 2]>,
    pub values: Vec<(Quantity, Given)>,
}

/// A value of a reading as it is given.
#[derive(Clone, Copy, Debug)]
pub enum Given {
    Rotation(Rows),
    Vector(Vector),
}

impl TryFrom<BTreeMap<String, serde_json::Value>> for ReadingLine {
    type Error = String;

    fn try_from(mut given: BTreeMap<String, serde_json::Value>) -> Result<Self, String> {
        fn take<T: serde::de::DeserializeOwned>(
            given: &mut BTreeMap<String, serde_json::Value>,
            name: &str,
        ) -> Result<Option<T>, String> {
            (given.remove(name).filter(|value| !value.is_null()))
                .map(|value| {
                    serde_json::from_value(value).map_err(|error| format!("`{name}`: {error}"))
                })
                .transpose()
        }
        let mut out = Self {
            time_s: take(&mut given, "time_s")?,
            place: take(&mut given, "place")?,
            offset_m: take(&mut given, "offset_m")?,
            values: Vec::new(),
        };
        for row in &Quantity::TABLE {
            let value = match row.quantity {
                Quantity::Rotation => take(&mut given, row.field)?.map(Given::Rotation),
                _ if row.numbers == 1 => {
                    take(&mut given, row.field)?.map(|number| Given::Vector([number, 0.0, 0.0]))
                }
                _ => take(&mut given, row.field)?.map(Given::Vector),
            };
            out.values.extend(value.map(|value| (row.quantity, value)));
        }
        if let Some(unknown) = given.keys().next() {
            let known: Vec<&str> = Quantity::TABLE.iter().map(|row| row.field).collect();
            return Err(format!(
                "unknown field `{unknown}`; a reading has time_s, place, offset_m, {}",
                known.join(", ")
            ));
        }
        Ok(out)
    }
}

/// The first line of the server.
#[derive(Debug, Serialize)]
pub struct Hello<'a> {
    #[serde(rename = "type")]
    pub kind: &'static str,
    pub version: u64,
    pub tool: &'static str,
    pub scene: &'a str,
    pub period_s: f64,
    pub first_command_from_s: f64,
    pub model_step_s: f64,
    pub horizon_s: f64,
    pub duration_s: f64,
    pub length_m: f64,
    pub nodes: Vec<NodeLine>,
    pub actuators: Vec<ActuatorLine>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub efforts: Vec<EffortLimits<'a>>,
    pub controls: Vec<ControlLine<'a>>,
    pub accepts: Vec<&'static str>,
    pub most_readings: usize,
    pub sensors: Vec<SensorLine>,
    pub obstacles: Vec<&'a str>,
    pub path_ends_s: Option<f64>,
}

#[derive(Debug, Serialize)]
pub struct NodeLine {
    pub place: f64,
    pub rest_position_m: Vector,
    pub rest_rotation: Rows,
    pub initial_position_m: Vector,
    pub initial_rotation: Rows,
    pub mass_kg: f64,
    pub rotary_inertia_kg_m2: Vector,
}

/// A control: name, unit, value before the first command, time constant of its lag, limits; `null` means unbounded, or bounded together with
/// others.
#[derive(Debug, Serialize)]
pub struct ControlLine<'a> {
    pub name: &'a str,
    pub unit: &'static str,
    pub rest: f64,
    pub lag_s: f64,
    pub least: Option<f64>,
    pub most: Option<f64>,
    pub fastest_fall: Option<f64>,
    pub fastest_rise: Option<f64>,
}

impl<'a> ControlLine<'a> {
    pub fn of((own, channel, axis): (&'a CommandedControl, &Channel, usize)) -> Self {
        let rest = own.named.rest;
        let [least, most] = ends(channel.bound, axis, 1.0).map(|end| end.map(|end| rest + end));
        let [fastest_fall, fastest_rise] = ends(channel.rate_bound, axis, 1.0);
        Self {
            name: &own.named.name,
            unit: own.named.unit,
            rest,
            lag_s: own.lag,
            least,
            most,
            fastest_fall,
            fastest_rise,
        }
    }
}

/// Returns the ends of a bound on a component times a gain; `None` where there is none, or not for it alone.
fn ends(bound: Option<Bound>, axis: usize, gain: f64) -> [Option<f64>; 2] {
    let interval = bound.and_then(|bound| bound.interval(axis));
    let interval = interval.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]);
    let [one, other] = interval.map(|end| end * gain);
    let finite = |end: f64| end.is_finite().then_some(end);
    [finite(one.min(other)), finite(one.max(other))]
}

/// An actuator in the arm whose effort is commanded: unit, effort before the first command, limits; `null` means unbounded.
#[derive(Debug, Serialize)]
pub struct EffortLimits<'a> {
    pub name: &'a str,
    pub unit: &'static str,
    pub rest: f64,
    pub least: Option<f64>,
    pub most: Option<f64>,
    pub fastest_fall: Option<f64>,
    pub fastest_rise: Option<f64>,
}

impl<'a> EffortLimits<'a> {
    pub fn of((_, actuator, gain, channel): (usize, &'a Drive, f64, &Channel)) -> Self {
        let rest = actuator.effort(0.0);
        let [least, most] = ends(channel.bound, 0, gain).map(|end| end.map(|end| rest + end));
        let [fastest_fall, fastest_rise] = ends(channel.rate_bound, 0, gain);
        Self {
            name: &actuator.name,
            unit: actuator.input_unit(),
            rest,
            least,
            most,
            fastest_fall,
            fastest_rise,
        }
    }
}

#[derive(Debug, Serialize)]
pub struct ActuatorLine {
    pub node: usize,
    pub force: Option<ChannelLine>,
    pub moment: Option<ChannelLine>,
}

/// Limits of a force or moment; `null` means unbounded.
#[derive(Debug, Serialize)]
pub struct ChannelLine {
    pub unit: &'static str,
    pub frame: &'static str,
    pub max_norm: Option<f64>,
    pub max_per_axis: Option<[Option<f64>; 3]>,
    pub rate_unit: &'static str,
    pub max_rate_norm: Option<f64>,
    pub max_rate_per_axis: Option<[Option<f64>; 3]>,
}

impl ActuatorLine {
    pub fn of(actuator: &ActuatedNode) -> Self {
        Self {
            node: actuator.node,
            force: ChannelLine::of(&actuator.force, ["N", "spatial", "N/s"]),
            moment: ChannelLine::of(&actuator.moment, ["N m", "body", "N m/s"]),
        }
    }

    /// Returns a line without limits, for a node whose forces and moments follow from other controls.
    pub fn unbounded(node: usize) -> Self {
        let free = Channel::new(1.0, None);
        Self {
            node,
            force: ChannelLine::of(&free, ["N", "spatial", "N/s"]),
            moment: ChannelLine::of(&free, ["N m", "body", "N m/s"]),
        }
    }
}

impl ChannelLine {
    fn of(channel: &Channel, [unit, frame, rate_unit]: [&'static str; 3]) -> Option<Self> {
        let finite = |most: f64| most.is_finite().then_some(most);
        let norm = |bound: Option<Bound>| match bound {
            Some(Bound::Norm(most)) => finite(most),
            _ => None,
        };
        let axes = |bound: Option<Bound>| match bound {
            Some(Bound::PerAxis(most)) => Some(Vector::from(most).map(finite)),
            _ => None,
        };
        channel.acts().then(|| Self {
            unit,
            frame,
            max_norm: norm(channel.bound),
            max_per_axis: axes(channel.bound),
            rate_unit,
            max_rate_norm: norm(channel.rate_bound),
            max_rate_per_axis: axes(channel.rate_bound),
        })
    }
}

/// A sensor of the scene: standard deviations of what it measures.
#[derive(Debug, Serialize)]
pub struct SensorLine {
    pub places: Vec<f64>,
    pub rate_hz: f64,
    pub age_s: f64,
    pub sigma: BTreeMap<&'static str, f64>,
}

impl SensorLine {
    pub fn of(settings: &SensorSettings) -> Self {
        Self {
            places: settings.places.clone(),
            rate_hz: settings.rate_hz,
            age_s: settings.age_s,
            sigma: ([false, true].into_iter())
                .flat_map(|at_clamp| settings.measured(at_clamp))
                .map(|(quantity, sigma)| (quantity.row().field, sigma))
                .collect(),
        }
    }
}

/// A fault in a line of the plant, and its remedy.
#[derive(Clone, Debug, Serialize)]
pub struct ErrorLine {
    #[serde(rename = "type")]
    pub kind: &'static str,
    pub line: usize,
    #[serde(rename = "where")]
    pub place: String,
    pub message: String,
    pub help: String,
}

/// The response to a measurement.
#[derive(Clone, Debug, Serialize)]
pub struct CommandLine {
    #[serde(rename = "type")]
    pub kind: &'static str,
    pub sample: usize,
    pub time_s: f64,
    pub from_s: f64,
    pub to_s: f64,
    pub controls_from: Vec<f64>,
    pub controls_to: Vec<f64>,
    pub wrenches: Vec<WrenchLine>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub efforts: Vec<EffortLine>,
    pub fallback: Option<FallbackLine>,
    pub tip: Option<TipLine>,
    pub predicted_tip_m: Option<Vector>,
    pub rotation_change: Option<f64>,
    pub skipped_samples: usize,
    pub disturbance: Option<Disturbance>,
    pub innovation: Option<InnovationLine>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub advice: Vec<String>,
    pub phases_s: Phases,
}

/// The last measurement that an estimator used, compared with its prediction.
#[derive(Clone, Debug, Serialize)]
pub struct InnovationLine {
    pub numbers: usize,
    pub rms: f64,
    pub distance_m: Option<f64>,
    pub refused_signals: usize,
}

#[derive(Clone, Debug, Serialize)]
pub struct WrenchLine {
    pub node: usize,
    pub force_from_n: Vector,
    pub force_to_n: Vector,
    pub moment_from_n_m: Vector,
    pub moment_to_n_m: Vector,
}

/// The effort of an actuator in the arm, in its unit.
#[derive(Clone, Debug, Serialize)]
pub struct EffortLine {
    pub name: String,
    pub from: f64,
    pub to: f64,
}

#[derive(Clone, Debug, Serialize)]
pub struct FallbackLine {
    pub cause: String,
    pub action: String,
}

#[derive(Clone, Debug, Serialize)]
pub struct TipLine {
    pub time_s: f64,
    pub position_m: Vector,
    pub reference_m: Option<Vector>,
}

/// Durations on this machine, s.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Phases {
    pub read: f64,
    pub estimate: f64,
    pub predict: f64,
    pub feedback: f64,
    pub prepare_before: f64,
}

/// Statistics of a served loop, which are its last line.
#[derive(Clone, Debug, Serialize)]
pub struct Served {
    /// `summary`
    #[serde(rename = "type")]
    pub kind: &'static str,
    /// `bye`, `end-of-input` or `stopped`.
    pub status: &'static str,
    /// Number of samples with a command.
    pub samples: usize,
    /// Number of samples that the plant left out.
    pub skipped_samples: usize,
    /// Number of lines or parts of lines that were refused.
    pub errors: usize,
    /// Time between two samples, s.
    pub period_s: f64,
    /// Number of samples that took longer than the period, including the preparation.
    pub overruns: usize,
    /// Seconds from a line to the command that answers it.
    pub response_s: Percentiles,
    /// Seconds of a whole sample, including the preparation.
    pub sample_s: Percentiles,
    /// Seconds of estimation and prediction.
    pub estimate_s: Percentiles,
    /// Seconds of the feedback.
    pub feedback_s: Percentiles,
    /// Seconds of the preparation.
    pub prepare_s: Percentiles,
    /// Time from which distances of the tip from its reference count, s.
    pub counted_from_s: f64,
    /// Distance of the known tip from its reference, m.
    pub tip_error_m: TipError,
    /// Distance of the known tip from its reference, divided by the length of the arm.
    pub tip_error_over_length: TipError,
    /// Number of samples without a command of their own, by cause.
    pub fallbacks: BTreeMap<String, usize>,
    /// Largest Frobenius distance of a given rotation from the nearest one.
    pub rotation_change: f64,
}

/// Describes an unsupported version of a line.
pub(super) fn version_message(found: u64) -> String {
    format!("version {found} is not {SERVING_VERSION}")
}
