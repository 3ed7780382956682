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

/// Columns of `samples.csv`, each with its name and its text; the last ones, from [`FIRST_TIMED_COLUMN`] on, are times of this machine.
struct Columns(Vec<Column>);

/// A column: its name, and what a sample has in it.
type Column = (String, Box<dyn Fn(&Sample) -> String>);

/// Parts of a disturbance: force (N) and moment (N m) at the tip, force per length (N/m), factor on the stiffness, payload (kg), viscous damping (1/s),
/// time of internal damping and delay (s).
const PARTS: [Named<Disturbance>; 14] = [
    ("tip_fx", |d| d.tip.force.x),
    ("tip_fy", |d| d.tip.force.y),
    ("tip_fz", |d| d.tip.force.z),
    ("tip_mx", |d| d.tip.moment.x),
    ("tip_my", |d| d.tip.moment.y),
    ("tip_mz", |d| d.tip.moment.z),
    ("distributed_x", |d| d.distributed.x),
    ("distributed_y", |d| d.distributed.y),
    ("distributed_z", |d| d.distributed.z),
    ("stiffness", |d| d.stiffness),
    ("payload", |d| d.payload),
    ("viscous", |d| d.viscous),
    ("internal", |d| d.internal),
    ("delay", |d| d.delay),
];

/// Times of the parts of a sample, and of the whole, s.
const TIMES: [Named<Sample>; 5] = [
    ("estimate_ms", |s| s.estimate_s),
    ("predict_ms", |s| s.predict_s),
    ("feedback_ms", |s| s.feedback_s),
    ("prepare_ms", |s| s.prepare_s),
    ("sample_ms", |s| s.sample_s),
];

/// A number of something, with its name.
type Named<T> = (&'static str, fn(&T) -> f64);

const AXES: [&str; 3] = ["x", "y", "z"];

impl Columns {
    fn new() -> Self {
        let mut out = Self(Vec::new());
        out.number("t", |s| Some(s.t));
        out.number("acts_from", |s| Some(s.acts_from));
        out.number("age", |s| Some(s.age));
        out.vector("tip_", |s| Some(s.tip));
        out.vector("reference_", |s| s.reference);
        out.number("error", |s| s.reference.map(|_| s.tip_error()));
        out.number("turn", |s| s.turn);
        out.text("innovation_n", |s| s.innovation.map(|found| found.n));
        out.number("innovation_rms", |s| s.innovation.map(|found| found.rms));
        out.number("innovation_normalized", |s| s.innovation?.normalized);
        out.number("innovation_distance", |s| s.innovation?.distance);
        out.text("innovation_refused", |s| {
            s.innovation.map(|found| found.refused)
        });
        out.number("predicted_cost", |s| Some(s.predicted_cost));
        out.text("iterations", |s| Some(s.iterations));
        out.text("subproblem_iterations", |s| Some(s.subproblem.iterations));
        out.text("subproblem_converged", |s| Some(s.subproblem.converged));
        out.vector("f", |s| Some(s.wrench.force.into()));
        out.vector("m", |s| Some(s.wrench.moment.into()));
        out.text("cause", |s| {
            s.fallback.as_ref().map(|(cause, _)| cause.to_string())
        });
        out.text("action", |s| {
            s.fallback.as_ref().map(|(_, action)| action.to_string())
        });
        for (name, part) in PARTS {
            out.number(format!("{ESTIMATED}{name}"), move |s| {
                Some(part(&s.disturbance))
            });
        }
        for (name, part) in PARTS {
            out.number(format!("{DEVIATION}{name}"), move |s| {
                Some(part(&s.deviation))
            });
        }
        for (name, seconds) in TIMES {
            out.number(name, move |s| Some(1e3 * seconds(s)));
        }
        out.text("overrun", |s| Some(s.is_overrun));
        out
    }

    /// Adds a column of numbers, which is empty where there is none.
    fn number(&mut self, name: impl Into<String>, of: impl Fn(&Sample) -> Option<f64> + 'static) {
        let text = move |s: &Sample| of(s).map_or_else(String::new, |number| format!("{number:?}"));
        self.0.push((name.into(), Box::new(text)));
    }

    /// Adds a column of counts, words or truth values.
    fn text<T: ToString + 'static>(&mut self, name: &str, of: fn(&Sample) -> Option<T>) {
        let text = move |s: &Sample| of(s).map_or_else(String::new, |value| value.to_string());
        self.0.push((name.into(), Box::new(text)));
    }

    /// Adds three columns, for the axes.
    fn vector(&mut self, stem: &str, of: fn(&Sample) -> Option<[f64; 3]>) {
        for (axis, name) in AXES.into_iter().enumerate() {
            self.number(format!("{stem}{name}"), move |s| Some(of(s)?[axis]));
        }
    }
}

/// Beginning of the names of what is estimated.
const ESTIMATED: &str = "estimated_";
/// Beginning of the names of its standard deviations.
const DEVIATION: &str = "deviation_";

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
    let Columns(columns) = Columns::new();
    let row = |sample| columns.iter().map(move |(_, text)| text(sample));
    let written = writer
        .write_record(columns.iter().map(|(name, _)| name))
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
        Self {
            t: sample.t,
            acts_from: sample.acts_from,
            tip: sample.tip,
            reference: sample.reference,
            error: sample.tip_error(),
            turn: sample.turn.unwrap_or(f64::NAN),
            force: sample.wrench.force.into(),
            moment: sample.wrench.moment.into(),
            disturbance: PARTS.map(|(_, part)| part(&sample.disturbance)),
            deviation: PARTS.map(|(_, part)| part(&sample.deviation)),
            times_ms: TIMES.map(|(_, seconds)| 1e3 * seconds(sample)),
        }
    }
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
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(broken)?;
        let line = record.position().map(csv::Position::line);
        let text = |name: &str| Ok(record.get(column(name)?).unwrap_or_default());
        let number = |name: &str| {
            let text = text(name)?;
            (text.parse::<f64>())
                .map_err(|_| malformed(line, format!("{name}: `{text}` is not a number")))
        };
        let known = |name: &str| match text(name)? {
            "" => Ok(f64::NAN),
            _ => number(name),
        };
        let three = |stem: &str| {
            let [x, y, z] = AXES.map(|axis| number(&format!("{stem}{axis}")));
            Ok([x?, y?, z?])
        };
        let has_reference = !text("reference_x")?.is_empty();
        let mut row = SampleRow {
            t: number("t")?,
            acts_from: number("acts_from")?,
            tip: three("tip_")?,
            reference: has_reference.then(|| three("reference_")).transpose()?,
            error: known("error")?,
            turn: known("turn")?,
            force: three("f")?,
            moment: three("m")?,
            disturbance: [0.0; 14],
            deviation: [0.0; 14],
            times_ms: [0.0; 5],
        };
        for (i, (name, _)) in PARTS.iter().enumerate() {
            row.disturbance[i] = number(&format!("{ESTIMATED}{name}"))?;
            row.deviation[i] = number(&format!("{DEVIATION}{name}"))?;
        }
        for (i, (name, _)) in TIMES.iter().enumerate() {
            row.times_ms[i] = number(name)?;
        }
        rows.push(row);
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// No column has the name of another, and there are some that are timed.
    #[test]
    fn columns_have_names_of_their_own() {
        let Columns(columns) = Columns::new();
        let names: std::collections::BTreeSet<_> =
            columns.iter().map(|(name, _)| &name[..]).collect();
        assert_eq!(names.len(), columns.len());
        assert!(names.contains(FIRST_TIMED_COLUMN));
    }
}
