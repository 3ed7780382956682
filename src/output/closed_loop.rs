//! The files of a closed loop: its summary, and a row a sample.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write as _};
use std::path::Path;

use nalgebra::Vector3;
use serde::Serialize;

use super::OutputError;
use super::reading::read_text;
use crate::mpc::{Disturbance, Innovations, Percentiles, Sample, TipError};

/// A closed loop before it runs, of which `check` tells.
#[derive(Clone, Debug, Serialize)]
pub struct LoopSummary {
    /// Samples that a run has.
    pub samples: usize,
    /// Sample period, s.
    pub period_s: f64,
    /// Length of the horizon, s.
    pub horizon_s: f64,
    /// Length of a block of the plan, s.
    pub block_s: f64,
    /// Sensors that an estimator uses; empty where the true state is known.
    pub sensors: Vec<LoopSensor>,
    /// Median time of a sample on this machine, s; absent where the first samples took too long.
    pub sample_s: Option<f64>,
    /// What holds the tip at its reference where that takes most; absent without a reference of at most ten minutes and where no force acts on the
    /// tip.
    pub reference: Option<ReferenceSummary>,
}

/// A sensor of a loop.
#[derive(Clone, Debug, Serialize)]
pub struct LoopSensor {
    /// Places over the length; empty for one on the clamp.
    pub places: Vec<f64>,
    /// Measurements a second, Hz.
    pub rate_hz: f64,
    /// Time until a measurement is known, s.
    pub age_s: f64,
}

/// The wrench on the tip that holds the model at its reference and moves its mass along.
#[derive(Clone, Debug, Serialize)]
pub struct ReferenceSummary {
    /// Time at which it takes most, s.
    pub at_s: f64,
    /// Force in space, N.
    pub force_n: [f64; 3],
    /// Moment in the body frame, N m.
    pub moment_n_m: [f64; 3],
    /// By how much the force exceeds its bound, N; 0 within.
    pub force_excess_n: f64,
    /// By how much the moment exceeds its bound, N m; 0 within.
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
    /// Why it failed.
    pub error: Option<String>,
    /// Samples that ran.
    pub samples: usize,
    /// Time between two samples, s.
    pub period_s: f64,
    /// Length of the horizon, s.
    pub horizon_s: f64,
    /// Elements of the controller's model.
    pub elements: usize,
    /// Elements of the arm as it is.
    pub plant_elements: usize,
    /// Samples that took longer than the period.
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
    /// Simulated seconds over seconds of samples.
    pub real_time_factor: f64,
    /// From when on errors count, s.
    pub counted_from_s: f64,
    /// Distance of the tip from its reference, m.
    pub tip_error_m: TipError,
    /// The same over the length of the arm.
    pub tip_error_over_length: TipError,
    /// Angle of the tip from how it should be turned, rad; absent where nothing asks for it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tip_turn_rad: Option<TipError>,
    /// Other laws, and this one with parts taken away that may be wrong; empty without `--baselines`.
    pub baselines: BTreeMap<&'static str, BaselineSummary>,
    /// Samples without a command of their own, by the cause.
    pub fallbacks: BTreeMap<String, usize>,
    /// What was measured beside what the filter expected; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub innovations: Option<Innovations>,
    /// Samples with active bounds.
    pub bounded: usize,
    /// How nearly the arm kept obstacles and limits, at the ends of samples.
    pub limits: Vec<LimitPeak>,
    /// What may be changed where the estimate is in doubt, where commands are late, and where the tip is far from its reference at the end.
    pub advice: Vec<String>,
    /// How far the model's nodes were from describing the arm's shape at the end, m.
    pub transfer_error_m: f64,
    /// Seed of the noise.
    pub seed: u32,
    /// Time of the whole command, s.
    pub wall_s: f64,
    /// Where the result is.
    pub directory: String,
}

/// Where an arm was nearest to violating a limit, or farthest beyond it.
#[derive(Clone, Debug, Serialize)]
pub struct LimitPeak {
    /// Name of the obstacle or limit.
    pub name: String,
    /// By how much the limit was exceeded, in its unit; negative: what was left.
    pub excess: f64,
    /// `m`, `1/m`, or nothing.
    pub unit: &'static str,
    /// When, s.
    pub at_s: f64,
    /// At which node of the arm as it is, or in the element after it.
    pub node: usize,
}

/// What another law did on the same arm.
#[derive(Clone, Debug, Serialize)]
pub struct BaselineSummary {
    /// As of the summary.
    pub status: &'static str,
    /// Why it failed.
    pub error: Option<String>,
    /// Samples that ran.
    pub samples: usize,
    /// Distance of the tip from its reference, m.
    pub tip_error_m: TipError,
    /// The same over the length of the arm.
    pub tip_error_over_length: TipError,
    /// Angle of the tip from how it should be turned, rad; absent where nothing asks for it.
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

/// Columns from which on two runs of one scene differ: times of this machine.
pub const FIRST_TIMED_COLUMN: &str = "estimate_ms";

/// Writes one row a sample, with a header; every number in the shortest form that reads back as the same `f64`, what there is not as
/// nothing.
///
/// # Errors
/// [`OutputError::Unwritten`].
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

/// What a page shows of a sample: some columns of `samples.csv`.
#[derive(Clone, Debug, PartialEq)]
pub struct SampleRow {
    /// When the sample began, s.
    pub t: f64,
    /// When its command began to act, s.
    pub acts_from: f64,
    /// Where the tip was, m.
    pub tip: [f64; 3],
    /// Where the tip should have been, m.
    pub reference: Option<[f64; 3]>,
    /// Distance of the tip from there, m; NaN without a reference.
    pub error: f64,
    /// Angle of the tip from how it should have been turned, rad; NaN where nothing asks for it.
    pub turn: f64,
    /// First force of the command, spatial, N.
    pub force: [f64; 3],
    /// First moment of the command, body frame, N m.
    pub moment: [f64; 3],
    /// Estimated disturbance: force (N) and moment (N m) at the tip, force per length (N/m), factor on the stiffness, payload (kg), viscous
    /// damping (1/s), time of internal damping and delay (s).
    pub disturbance: [f64; 14],
    /// Its standard deviations.
    pub deviation: [f64; 14],
    /// Times of estimation, prediction, feedback, preparation and of the whole sample, ms.
    pub times_ms: [f64; 5],
}

impl SampleRow {
    /// Of a sample that was run.
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

/// Times of the parts of a sample, and of the whole, ms.
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

/// Bytes of a row, at most: fifty numbers.
const LARGEST_ROW: u64 = 1 << 11;

/// Reads at most `most` rows of what [`write_samples`] writes, as far as a page shows it.
///
/// # Errors
/// [`OutputError`] for a missing column, and for a number that is none.
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
    // Columns that follow each other in the file are found by the first of them.
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

/// What stands under [`COLUMNS`].
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

    /// No column has the name of another, and there are some that are timed.
    #[test]
    fn columns_have_names_of_their_own() {
        let names: std::collections::BTreeSet<_> = COLUMNS.into_iter().collect();
        assert_eq!(names.len(), COLUMNS.len());
        assert!(names.contains(FIRST_TIMED_COLUMN));
    }
}
