//! The files of a closed loop: its summary, and a row for each sample.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write as _};
use std::path::Path;

use nalgebra::Vector3;
use serde::Serialize;

use super::OutputError;
use super::reading::read_text;
use super::summary::SlackSummary;
use mpc::{Innovations, N_COMPONENTS, Percentiles, Sample, TipError, Unknown};
use verify::doubt::UnderDoubt;

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
    /// Samples in which an obstacle or a limit gave way: the plan violates it, because no command within the bounds keeps it.
    pub breaking: usize,
    /// Nearest approaches to obstacles and limits, at the ends of samples.
    pub limits: Vec<LimitPeak>,
    /// The loop on the plants of the stated doubt, its limits at the ends of samples; absent without one, and where it was stopped.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub doubt: Option<UnderDoubt>,
    /// Ranges of the efforts that acted in the actuators in the arm, at the ends of samples; absent without them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub efforts: Vec<EffortRange>,
    /// Slack of the tendons on winches, at the ends of samples; absent where there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub slack: Vec<SlackSummary>,
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

/// The range of the efforts of an actuator in the arm.
#[derive(Clone, Debug, Serialize)]
pub struct EffortRange {
    /// Name of the actuator.
    pub name: String,
    /// Unit of the effort.
    pub unit: &'static str,
    /// Least effort.
    pub least: f64,
    /// Largest effort.
    pub largest: f64,
}

/// The place and time at which an arm was nearest to violating a limit, or farthest beyond it.
#[derive(Clone, Debug, Serialize)]
pub struct LimitPeak {
    /// Name of the obstacle or limit.
    pub name: String,
    /// Excess over the limit, in its unit; negative within the limit.
    pub excess: f64,
    /// Excess up to which the limit counts as kept: a hundredth of the radius of obstacle and arm, or of the limit; infinite for a soft one.
    #[serde(skip)]
    pub allowed: f64,
    /// Tells whether the limit was violated by more than a hundredth of the radius of obstacle and arm, or of the limit; never for a soft one.
    pub violated: bool,
    /// `m`, `1/m`, or nothing.
    pub unit: &'static str,
    /// Time, s.
    pub at_s: f64,
    /// Node of the plant, or first node of the element.
    pub node: usize,
    /// By how much plans keep inside of the limit, in its unit.
    pub margin: f64,
    /// The samples whose plan violates the limit, because no command within the bounds keeps it; absent without any.
    #[serde(skip_serializing_if = "GaveWay::is_nowhere")]
    pub gave_way: GaveWay,
}

/// The samples in which a limit gave way.
#[derive(Clone, Debug, Default, Serialize)]
pub struct GaveWay {
    /// Number of samples.
    pub samples: usize,
    /// Time at which the first one began, s.
    pub from_s: f64,
    /// Time at which the last one began, s.
    pub to_s: f64,
    /// Largest violation along their plans, in the unit of the limit.
    pub by: f64,
}

impl GaveWay {
    /// Notes a sample that began at `t` (s), and the violation along its plan.
    pub fn note(&mut self, t: f64, by: f64) {
        if self.samples == 0 {
            self.from_s = t;
        }
        self.samples += 1;
        self.to_s = t;
        self.by = self.by.max(by);
    }

    fn is_nowhere(&self) -> bool {
        self.samples == 0
    }
}

impl LimitPeak {
    /// Says by how much the limit was exceeded, when and where.
    #[must_use]
    pub fn words(&self) -> String {
        format!(
            "{} exceeded by {:.3e} {} at node {}, t = {:.3} s",
            self.name, self.excess, self.unit, self.node, self.at_s
        )
    }
}

/// Result of another law on the same arm.
#[derive(Clone, Debug, Serialize)]
pub struct BaselineSummary {
    /// Status, as in the summary; `missing` for a law that the arm cannot have.
    pub status: &'static str,
    /// The reason of a failure, or why the law does not exist.
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

impl BaselineSummary {
    /// Returns the entry of a law that the arm cannot have, for the given reason.
    #[must_use]
    pub fn missing(why: &str) -> Self {
        let unknown = TipError {
            last: f64::NAN,
            rms: f64::NAN,
            p95: f64::NAN,
            max: f64::NAN,
        };
        Self {
            status: "missing",
            error: Some(why.into()),
            samples: 0,
            tip_error_m: unknown,
            tip_error_over_length: unknown,
            tip_turn_rad: None,
        }
    }
}

/// Columns of `samples.csv`, each with its name and its text; the last ones, from [`FIRST_TIMED_COLUMN`] on, are times of this machine.
struct Columns(Vec<Column>);

/// A column: its name, and what a sample has in it.
type Column = (String, Box<dyn Fn(&Sample) -> String>);

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
        out.text("gave_way", |s| Some(s.breaks_limit));
        out.vector("f", |s| Some(s.wrench.force.into()));
        out.vector("m", |s| Some(s.wrench.moment.into()));
        out.text("cause", |s| {
            s.fallback.as_ref().map(|(cause, _)| cause.to_string())
        });
        out.text("action", |s| {
            s.fallback.as_ref().map(|(_, action)| action.to_string())
        });
        for (i, name) in Unknown::columns().enumerate() {
            out.number(format!("{ESTIMATED}{name}"), move |s| {
                Some(s.disturbance.components()[i])
            });
        }
        for (i, name) in Unknown::columns().enumerate() {
            out.number(format!("{DEVIATION}{name}"), move |s| {
                Some(s.deviation.components()[i])
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

/// Writes one row for each sample, with a header; every number in the shortest form that reads back as the same `f64`, absent values as
/// empty fields.
///
/// # Errors
/// Returns [`OutputError::Unwritten`].
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
    /// Components of the estimated unknowns, in the order and the units of [`Unknown::TABLE`].
    pub disturbance: [f64; N_COMPONENTS],
    /// Their standard deviations.
    pub deviation: [f64; N_COMPONENTS],
    /// Times of estimation, prediction, feedback, preparation and of the whole sample, ms.
    pub times_ms: [f64; 5],
}

impl SampleRow {
    /// Returns the row of a sample.
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
            disturbance: *sample.disturbance.components(),
            deviation: *sample.deviation.components(),
            times_ms: TIMES.map(|(_, seconds)| 1e3 * seconds(sample)),
        }
    }
}

/// Bytes of a row, at most: fifty numbers.
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
            disturbance: [0.0; N_COMPONENTS],
            deviation: [0.0; N_COMPONENTS],
            times_ms: [0.0; 5],
        };
        for (i, name) in Unknown::columns().enumerate() {
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

    /// Columns have distinct names, and some are timed.
    #[test]
    fn columns_have_names_of_their_own() {
        let Columns(columns) = Columns::new();
        let names: std::collections::BTreeSet<_> =
            columns.iter().map(|(name, _)| &name[..]).collect();
        assert_eq!(names.len(), columns.len());
        assert!(names.contains(FIRST_TIMED_COLUMN));
    }
}
