//! The files of a closed loop: its summary, and a row for each sample.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write as _};
use std::path::Path;

use nalgebra::Vector3;
use serde::Serialize;

use super::OutputError;
use super::reading::read_text;
use crate::mpc::{Disturbance, Innovations, Percentiles, Sample, TipError};

/// Figures of a closed loop before it runs, as `check` reports them.
#[derive(Clone, Debug, Serialize)]
pub struct LoopSummary {
    /// Number of samples of a run.
    pub samples: usize,
    /// Sample period, s.
    pub period_s: f64,
    /// Length of the horizon, s.
    pub horizon_s: f64,
    /// Length of a block of the plan, s.
    pub block_s: f64,
    /// Sensors that an estimator uses; empty if the true state is known.
    pub sensors: Vec<LoopSensor>,
    /// Median time of a sample on this machine, s; absent if the first samples took too long.
    pub sample_s: Option<f64>,
    /// The wrench that holds the tip at its reference, at the time at which it is largest; absent without a reference of at most ten
    /// minutes, and if no force acts on the tip.
    pub reference: Option<ReferenceSummary>,
}

/// A sensor of a loop.
#[derive(Clone, Debug, Serialize)]
pub struct LoopSensor {
    /// Places, divided by the length; empty for a sensor on the clamp.
    pub places: Vec<f64>,
    /// Measurements per second, Hz.
    pub rate_hz: f64,
    /// Time until a measurement is known, s.
    pub age_s: f64,
}

/// The wrench on the tip that holds the model at its reference and accelerates its mass along it.
#[derive(Clone, Debug, Serialize)]
pub struct ReferenceSummary {
    /// Time at which it is largest, s.
    pub at_s: f64,
    /// Force, spatial frame, N.
    pub force_n: [f64; 3],
    /// Moment, body frame, N m.
    pub moment_n_m: [f64; 3],
    /// Excess of the force over its bound, N; 0 within.
    pub force_excess_n: f64,
    /// Excess of the moment over its bound, N m; 0 within.
    pub moment_excess_n_m: f64,
}

/// Fraction of a wrench by which it may exceed a bound for the sake of rounding.
const ROUNDING: f64 = 1e-6;

impl ReferenceSummary {
    /// Size of the force, N.
    #[must_use]
    pub fn force(&self) -> f64 {
        Vector3::from(self.force_n).norm()
    }

    /// Size of the moment, N m.
    #[must_use]
    pub fn moment(&self) -> f64 {
        Vector3::from(self.moment_n_m).norm()
    }

    /// Tells whether the wrench is within its bounds.
    #[must_use]
    pub fn is_within(&self) -> bool {
        self.force_excess_n <= ROUNDING * self.force()
            && self.moment_excess_n_m <= ROUNDING * self.moment()
    }
}

/// Summary of `mpc`. Durations of samples are those of this machine; the first sample is not among them.
#[derive(Clone, Debug, Serialize)]
pub struct MpcSummary {
    /// [`SCHEMA_VERSION`](super::summary::SCHEMA_VERSION)
    pub schema_version: u32,
    /// [`TOOL`](super::summary::TOOL)
    pub tool: &'static str,
    /// `mpc`
    pub command: &'static str,
    /// Name of the scene.
    pub scene: String,
    /// `completed`, `interrupted`, `deadline` or `failed`.
    pub status: &'static str,
    /// The reason of a failure.
    pub error: Option<String>,
    /// Number of samples that ran.
    pub samples: usize,
    /// Time between two samples, s.
    pub period_s: f64,
    /// Length of the horizon, s.
    pub horizon_s: f64,
    /// Elements of the controller's model.
    pub elements: usize,
    /// Elements of the plant.
    pub plant_elements: usize,
    /// Number of samples that took longer than the period.
    pub overruns: usize,
    /// Seconds of a whole sample.
    pub sample_s: Percentiles,
    /// Seconds of estimation and prediction.
    pub estimate_s: Percentiles,
    /// Seconds of the feedback.
    pub feedback_s: Percentiles,
    /// Seconds of the preparation of the next sample.
    pub prepare_s: Percentiles,
    /// Seconds of the first sample.
    pub first_sample_s: f64,
    /// Simulated seconds divided by seconds of samples.
    pub real_time_factor: f64,
    /// Time from which errors count, s.
    pub counted_from_s: f64,
    /// Distance of the tip from its reference, m.
    pub tip_error_m: TipError,
    /// Distance of the tip from its reference, divided by the length of the arm.
    pub tip_error_over_length: TipError,
    /// Angle of the tip from its reference orientation, rad; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tip_turn_rad: Option<TipError>,
    /// Results of other laws, and of this one with its imperfections removed; empty without `--baselines`.
    pub baselines: BTreeMap<&'static str, BaselineSummary>,
    /// Number of samples without a command of their own, by cause.
    pub fallbacks: BTreeMap<String, usize>,
    /// Innovations of the filter; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub innovations: Option<Innovations>,
    /// Number of samples with active bounds.
    pub bounded: usize,
    /// Nearest approaches to obstacles and limits, at the ends of samples.
    pub limits: Vec<LimitPeak>,
    /// Changes that may help if the estimate is doubtful, commands are late, or the tip ends far from its reference.
    pub advice: Vec<String>,
    /// Error of the arm's shape at the end on the model's nodes, m.
    pub transfer_error_m: f64,
    /// Seed of the noise.
    pub seed: u32,
    /// Time of the whole command, s.
    pub wall_s: f64,
    /// Path of the result directory.
    pub directory: String,
}

/// The place and time at which an arm was nearest to violating a limit, or farthest beyond it.
#[derive(Clone, Debug, Serialize)]
pub struct LimitPeak {
    /// Name of the obstacle or limit.
    pub name: String,
    /// Excess over the limit, in its unit; negative within the limit.
    pub excess: f64,
    /// `m`, `1/m`, or nothing.
    pub unit: &'static str,
    /// Time, s.
    pub at_s: f64,
    /// Node of the plant, or first node of the element.
    pub node: usize,
}

/// Result of another law on the same arm.
#[derive(Clone, Debug, Serialize)]
pub struct BaselineSummary {
    /// Status, as in the summary.
    pub status: &'static str,
    /// The reason of a failure.
    pub error: Option<String>,
    /// Number of samples that ran.
    pub samples: usize,
    /// Distance of the tip from its reference, m.
    pub tip_error_m: TipError,
    /// Distance of the tip from its reference, divided by the length of the arm.
    pub tip_error_over_length: TipError,
    /// Angle of the tip from its reference orientation, rad; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tip_turn_rad: Option<TipError>,
}

/// Columns of `samples.csv`; from [`FIRST_TIMED_COLUMN`] on they are times of this machine.
const COLUMNS: [&str; 62] = [
    "t",
    "acts_from",
    "age",
    "tip_x",
    "tip_y",
    "tip_z",
    "reference_x",
    "reference_y",
    "reference_z",
    "error",
    "turn",
    "innovation_n",
    "innovation_rms",
    "innovation_normalized",
    "innovation_distance",
    "innovation_refused",
    "predicted_cost",
    "iterations",
    "subproblem_iterations",
    "subproblem_converged",
    "fx",
    "fy",
    "fz",
    "mx",
    "my",
    "mz",
    "cause",
    "action",
    "estimated_tip_fx",
    "estimated_tip_fy",
    "estimated_tip_fz",
    "estimated_tip_mx",
    "estimated_tip_my",
    "estimated_tip_mz",
    "estimated_distributed_x",
    "estimated_distributed_y",
    "estimated_distributed_z",
    "estimated_stiffness",
    "estimated_payload",
    "estimated_viscous",
    "estimated_internal",
    "estimated_delay",
    "deviation_tip_fx",
    "deviation_tip_fy",
    "deviation_tip_fz",
    "deviation_tip_mx",
    "deviation_tip_my",
    "deviation_tip_mz",
    "deviation_distributed_x",
    "deviation_distributed_y",
    "deviation_distributed_z",
    "deviation_stiffness",
    "deviation_payload",
    "deviation_viscous",
    "deviation_internal",
    "deviation_delay",
    "estimate_ms",
    "predict_ms",
    "feedback_ms",
    "prepare_ms",
    "sample_ms",
    "overrun",
];

/// First of the columns in which two runs of one scene differ: times of this machine.
pub const FIRST_TIMED_COLUMN: &str = "estimate_ms";

/// Writes one row for each sample, with a header; every number in the shortest form that reads back as the same `f64`, absent values as
/// empty fields.
///
/// # Errors
/// Returns [`OutputError::Unwritten`].
pub fn write_samples(path: &Path, samples: &[Sample]) -> Result<(), OutputError> {
    let unwritten = || OutputError::unwritten(path, "cannot write");
    let file = File::create(path).map_err(unwritten())?;
    let mut writer = csv::Writer::from_writer(file);
    let written = writer
        .write_record(COLUMNS)
        .and_then(|()| (samples.iter()).try_for_each(|sample| writer.write_record(row(sample))));
    written.map_err(|error| unwritten()(io::Error::other(error)))?;
    writer
        .into_inner()
        .map_err(csv::IntoInnerError::into_error)
        .and_then(|mut file| file.flush())
        .map_err(unwritten())
}

/// The columns of `samples.csv` that a page shows.
#[derive(Clone, Debug, PartialEq)]
pub struct SampleRow {
    /// Time at which the sample began, s.
    pub t: f64,
    /// Time at which its command began to act, s.
    pub acts_from: f64,
    /// Position of the tip, m.
    pub tip: [f64; 3],
    /// Reference position of the tip, m.
    pub reference: Option<[f64; 3]>,
    /// Distance of the tip from its reference, m; NaN without a reference.
    pub error: f64,
    /// Angle of the tip from its reference orientation, rad; NaN without one.
    pub turn: f64,
    /// First force of the command, spatial frame, N.
    pub force: [f64; 3],
    /// First moment of the command, body frame, N m.
    pub moment: [f64; 3],
    /// Estimated disturbance: force (N) and moment (N m) at the tip, force per length (N/m), factor on the stiffness, payload (kg), viscous
    /// damping (1/s), time of internal damping and delay (s).
    pub disturbance: [f64; 14],
    /// Standard deviations of the estimated disturbance.
    pub deviation: [f64; 14],
    /// Times of estimation, prediction, feedback, preparation and of the whole sample, ms.
    pub times_ms: [f64; 5],
}

impl SampleRow {
    /// Returns the row of a sample.
    #[must_use]
    pub fn of(sample: &Sample) -> Self {
        let numbers = |d: &Disturbance| {
            let mut out = [0.0; 14];
            out[..3].copy_from_slice(d.tip.force.as_slice());
            out[3..6].copy_from_slice(d.tip.moment.as_slice());
            out[6..9].copy_from_slice(d.distributed.as_slice());
            out[9..].copy_from_slice(&[d.stiffness, d.payload, d.viscous, d.internal, d.delay]);
            out
        };
        Self {
            t: sample.t,
            acts_from: sample.acts_from,
            tip: sample.tip,
            reference: sample.reference,
            error: sample.tip_error(),
            turn: sample.turn.unwrap_or(f64::NAN),
            force: sample.wrench.force.into(),
            moment: sample.wrench.moment.into(),
            disturbance: numbers(&sample.disturbance),
            deviation: numbers(&sample.deviation),
            times_ms: milliseconds(sample),
        }
    }
}

/// Returns the times of the parts of a sample, and of the whole, ms.
fn milliseconds(sample: &Sample) -> [f64; 5] {
    [
        sample.estimate_s,
        sample.predict_s,
        sample.feedback_s,
        sample.prepare_s,
        sample.sample_s,
    ]
    .map(|s| 1e3 * s)
}

/// Upper limit of the bytes of a row of fifty numbers.
const LARGEST_ROW: u64 = 1 << 11;

/// Reads the columns for a page from at most `most` rows of a file of [`write_samples`].
///
/// # Errors
/// Returns [`OutputError`] for a missing column, and for a field that is not a number.
pub fn read_samples(path: &Path, most: usize) -> Result<Vec<SampleRow>, OutputError> {
    let malformed = |line: Option<u64>, reason: String| OutputError::Malformed {
        path: path.to_path_buf(),
        line,
        reason,
    };
    let broken =
        |error: csv::Error| malformed(error.position().map(csv::Position::line), error.to_string());
    let text = read_text(path, LARGEST_ROW.saturating_mul(most as u64 + 1))?;
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let header = reader.headers().map_err(broken)?.clone();
    let column = |name: &str| {
        (header.iter().position(|known| known == name))
            .ok_or_else(|| malformed(Some(1), format!("no column {name}")))
    };
    // Groups of columns are located by their first one.
    let [
        t,
        acts_from,
        tip,
        reference,
        error,
        turn,
        force,
        estimated,
        deviation,
        times,
    ] = [
        "t",
        "acts_from",
        "tip_x",
        "reference_x",
        "error",
        "turn",
        "fx",
        "estimated_tip_fx",
        "deviation_tip_fx",
        "estimate_ms",
    ]
    .map(column);
    let (t, acts_from, tip) = (t?, acts_from?, tip?);
    let (reference, error, turn) = (reference?, error?, turn?);
    let (force, estimated, deviation, times) = (force?, estimated?, deviation?, times?);
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(broken)?;
        let line = record.position().map(csv::Position::line);
        let text = |at: usize| record.get(at).unwrap_or_default();
        let number = |at: usize| {
            text(at).parse::<f64>().map_err(|_| {
                let name = header.get(at).unwrap_or_default();
                malformed(line, format!("{name}: `{}` is not a number", text(at)))
            })
        };
        let three = |at| Ok([number(at)?, number(at + 1)?, number(at + 2)?]);
        let has_reference = !text(reference).is_empty();
        let known = |at: usize| {
            if text(at).is_empty() {
                Ok(f64::NAN)
            } else {
                number(at)
            }
        };
        let mut row = SampleRow {
            t: number(t)?,
            acts_from: number(acts_from)?,
            tip: three(tip)?,
            reference: has_reference.then(|| three(reference)).transpose()?,
            error: known(error)?,
            turn: known(turn)?,
            force: three(force)?,
            moment: three(force + 3)?,
            disturbance: [0.0; 14],
            deviation: [0.0; 14],
            times_ms: [0.0; 5],
        };
        for (i, value) in row.disturbance.iter_mut().enumerate() {
            *value = number(estimated + i)?;
        }
        for (i, value) in row.deviation.iter_mut().enumerate() {
            *value = number(deviation + i)?;
        }
        for (i, value) in row.times_ms.iter_mut().enumerate() {
            *value = number(times + i)?;
        }
        rows.push(row);
    }
    Ok(rows)
}

/// Returns the fields of [`COLUMNS`] for a sample.
fn row(sample: &Sample) -> Vec<String> {
    let mut row = Row(Vec::with_capacity(COLUMNS.len()));
    row.numbers(&[sample.t, sample.acts_from, sample.age]);
    row.numbers(&sample.tip);
    match &sample.reference {
        Some(reference) => {
            row.numbers(reference);
            row.numbers(&[sample.tip_error()]);
        }
        None => row.nothing(4),
    }
    row.optional(sample.turn);
    match &sample.innovation {
        Some(innovation) => {
            row.0.push(innovation.n.to_string());
            row.numbers(&[innovation.rms]);
            row.optional(innovation.normalized);
            row.optional(innovation.distance);
            row.0.push(innovation.refused.to_string());
        }
        None => row.nothing(5),
    }
    row.numbers(&[sample.predicted_cost]);
    row.0.push(sample.iterations.to_string());
    row.0.push(sample.subproblem.iterations.to_string());
    row.0.push(sample.subproblem.converged.to_string());
    row.numbers(sample.wrench.force.as_slice());
    row.numbers(sample.wrench.moment.as_slice());
    match &sample.fallback {
        Some((cause, action)) => row.0.extend([cause.to_string(), action.to_string()]),
        None => row.nothing(2),
    }
    row.disturbance(&sample.disturbance);
    row.disturbance(&sample.deviation);
    row.numbers(&milliseconds(sample));
    row.0.push(sample.is_overrun.to_string());
    row.0
}

struct Row(Vec<String>);

impl Row {
    fn numbers(&mut self, numbers: &[f64]) {
        self.0
            .extend(numbers.iter().map(|number| format!("{number:?}")));
    }

    fn optional(&mut self, number: Option<f64>) {
        match number {
            Some(number) => self.numbers(&[number]),
            None => self.nothing(1),
        }
    }

    fn nothing(&mut self, n: usize) {
        self.0.extend(std::iter::repeat_n(String::new(), n));
    }

    fn disturbance(&mut self, disturbance: &Disturbance) {
        self.numbers(disturbance.tip.force.as_slice());
        self.numbers(disturbance.tip.moment.as_slice());
        self.numbers(disturbance.distributed.as_slice());
        self.numbers(&[
            disturbance.stiffness,
            disturbance.payload,
            disturbance.viscous,
            disturbance.internal,
            disturbance.delay,
        ]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Columns have distinct names, and some are timed.
    #[test]
    fn columns_have_distinct_names() {
        let names: std::collections::BTreeSet<_> = COLUMNS.into_iter().collect();
        assert_eq!(names.len(), COLUMNS.len());
        assert!(names.contains(FIRST_TIMED_COLUMN));
    }
}
