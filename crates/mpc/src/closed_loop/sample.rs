//! The record of a sample, and the statistics of a run.

use std::collections::BTreeMap;

use super::fallback::{Action, Cause};
use crate::command::Command;
use crate::controller::SampleRecord;
use crate::estimator::{Disturbance, Innovation, Unknown};
use crate::subproblem::SubproblemEnd;
use mechanics::{Rod, Wrench};

/// One sample of a closed loop. Times are those of the loop, s; durations are those of this machine, s.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Time at which the sample began.
    pub t: f64,
    /// Time at which its command began to act.
    pub acts_from: f64,
    /// Age of the last measurement in the estimate.
    pub age: f64,
    /// True position at the beginning, m, of the tip, or of the node that [follows](crate::Controller::followed) a reference.
    pub tip: [f64; 3],
    /// Its reference position, m.
    pub reference: Option<[f64; 3]>,
    /// Angle between its true orientation and its reference, rad.
    pub turn: Option<f64>,
    /// Innovation of the last measurement.
    pub innovation: Option<Innovation>,
    /// `½ |r|²` of tracks and targets, as predicted by the controller.
    pub predicted_cost: f64,
    /// Gauss-Newton iterations from the estimate to the command; 0 without a command of its own.
    pub iterations: usize,
    /// End of the subproblem.
    pub subproblem: SubproblemEnd,
    /// Tells whether an obstacle or a limit [gave way](crate::Controller::gave_way): the plan violates it, because no command within the
    /// bounds keeps it.
    pub breaks_limit: bool,
    /// First wrench of the command at the time at which it begins to act: force (spatial frame, N) and moment (body frame, N m).
    pub wrench: Wrench,
    /// Seconds of estimation.
    pub estimate_s: f64,
    /// Seconds of the prediction over the delays.
    pub predict_s: f64,
    /// Seconds of the feedback.
    pub feedback_s: f64,
    /// Seconds of the preparation of the next sample.
    pub prepare_s: f64,
    /// Seconds of the whole sample.
    pub sample_s: f64,
    /// Processor seconds of the whole sample, of all threads of the process.
    pub processor_s: f64,
    /// Tells whether the whole sample took longer than the period.
    pub is_overrun: bool,
    /// Cause and replacement of a missing command.
    pub fallback: Option<(Cause, Action)>,
    /// The estimated disturbance.
    pub disturbance: Disturbance,
    /// Standard deviations of the estimated disturbance.
    pub deviation: Disturbance,
}

/// Part of the weight of an arm above which an estimated lift is told, and the number of its standard deviations: an arm whose density is off
/// by less than that is as its data sheet says.
const LARGE_LIFT: f64 = 0.3;
const CERTAIN_LIFT: f64 = 3.0;

impl Sample {
    pub(super) fn at(t: f64) -> Self {
        Self {
            t,
            acts_from: t,
            age: 0.0,
            tip: [0.0; 3],
            reference: None,
            turn: None,
            innovation: None,
            predicted_cost: 0.0,
            iterations: 0,
            subproblem: SubproblemEnd {
                iterations: 0,
                converged: true,
            },
            breaks_limit: false,
            wrench: Wrench::default(),
            estimate_s: 0.0,
            predict_s: 0.0,
            feedback_s: 0.0,
            prepare_s: 0.0,
            sample_s: 0.0,
            processor_s: 0.0,
            is_overrun: false,
            fallback: None,
            disturbance: Disturbance::NONE,
            deviation: Disturbance::NONE,
        }
    }

    pub(super) fn note_command(&mut self, command: &Command, record: &SampleRecord) {
        let first = command.nodes().first();
        self.wrench = first.map_or_else(Wrench::default, |node| command.wrench_on(*node, false));
        self.predicted_cost = record.predicted_cost;
        self.iterations = record.iterations;
        self.subproblem = record.subproblem;
        self.breaks_limit = record.breaks_limit && self.fallback.is_none();
    }

    /// Says that the estimated distributed force carries much of the weight of the arm `rod`, which an arm does to its model that stretches less;
    /// `None` if it does not, or within the noise.
    #[must_use]
    pub fn lift(&self, rod: &Rod) -> Option<String> {
        let down = rod.gravity.try_normalize(0.0)?;
        let weight = rod.mass() * rod.gravity.norm() / rod.scales.length;
        let lift = -down.dot(&self.disturbance.vector(Unknown::Distributed));
        let deviation = (down.abs()).dot(&self.deviation.vector(Unknown::Distributed));
        (lift > LARGE_LIFT * weight && lift > CERTAIN_LIFT * deviation).then(|| {
            format!(
                "the estimate has a force of {lift:.3} N/m against gravity all along the arm, {:.0} % of its weight: if nothing lifts it, it is lighter \
                 (plant.density_factor, [rod.material]) or stretches less than its model ([rod.stiffness] ea); the force is then an error of the model",
                100.0 * lift / weight
            )
        })
    }

    /// Returns the distance of the tip from its reference at the beginning of the sample, m; NaN without a reference.
    #[must_use]
    pub fn tip_error(&self) -> f64 {
        super::distance(self.tip, self.reference)
    }
}

/// Percentiles of a set of numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Maximum.
    pub max: f64,
}

impl Percentiles {
    /// Computes the percentiles of any numbers; all 0 if there are none.
    #[must_use]
    pub fn of(numbers: impl IntoIterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = numbers.into_iter().collect();
        sorted.sort_by(f64::total_cmp);
        let at = |part: f64| {
            let last = sorted.len().saturating_sub(1) as f64;
            sorted
                .get((part * last).ceil() as usize)
                .copied()
                .unwrap_or(0.0)
        };
        Self {
            p50: at(0.5),
            p95: at(0.95),
            p99: at(0.99),
            max: at(1.0),
        }
    }
}

/// Distances of the tip from its reference, m, or angles, rad.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct TipError {
    /// Value at the last sample.
    #[serde(rename = "final")]
    pub last: f64,
    /// Root mean square.
    pub rms: f64,
    /// 95th percentile.
    pub p95: f64,
    /// Largest.
    pub max: f64,
}

impl TipError {
    /// Computes the errors of the samples from `after` (s) on.
    #[must_use]
    pub fn of(samples: &[Sample], after: f64) -> Self {
        let counted = samples.iter().filter(|sample| sample.t >= after);
        Self::of_distances(&counted.map(Sample::tip_error).collect::<Vec<f64>>())
    }

    /// Computes the errors of the orientation, rad; `None` without a reference orientation.
    #[must_use]
    pub fn of_turns(samples: &[Sample], after: f64) -> Option<Self> {
        let counted = samples.iter().filter(|sample| sample.t >= after);
        let turns: Vec<f64> = counted.filter_map(|sample| sample.turn).collect();
        (!turns.is_empty()).then(|| Self::of_distances(&turns))
    }

    /// Computes the errors from distances in the order of time, m; NaN and 0 if there are none.
    pub(crate) fn of_distances(errors: &[f64]) -> Self {
        let squares: f64 = errors.iter().map(|e| e * e).sum();
        let percentiles = Percentiles::of(errors.iter().copied());
        Self {
            last: errors.last().copied().unwrap_or(f64::NAN),
            rms: (squares / errors.len() as f64).sqrt(),
            p95: percentiles.p95,
            max: errors.iter().copied().fold(0.0, f64::max),
        }
    }
}

/// Statistics of a run. Times do not include the first sample, which has no predecessor.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Tally {
    /// Number of samples.
    pub samples: usize,
    /// Number of samples that took longer than the period.
    pub overruns: usize,
    /// Seconds of whole samples.
    pub sample_s: Percentiles,
    /// Processor seconds of whole samples, which other programs do not change.
    pub processor_s: Percentiles,
    /// Seconds of estimation and prediction.
    pub estimate_s: Percentiles,
    /// Seconds of the feedback.
    pub feedback_s: Percentiles,
    /// Seconds of the preparation.
    pub prepare_s: Percentiles,
    /// Seconds of the first sample.
    pub first_s: f64,
    /// Simulated seconds divided by computed seconds.
    pub real_time_factor: f64,
    /// Number of samples whose subproblem had active bounds.
    pub bounded: usize,
    /// Number of samples whose plan violates an obstacle or a limit that no command within the bounds keeps.
    pub breaking: usize,
    /// Number of fallbacks by cause.
    pub fallbacks: BTreeMap<String, usize>,
    /// Innovations; `None` without an estimator that predicts its measurements.
    pub innovations: Option<Innovations>,
}

/// Innovations of a run, as a test of consistency: the distances of measurements from their predictions beside those that the estimator
/// expects.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Innovations {
    /// Number of values used from the last measurement of every sample.
    pub numbers: usize,
    /// Sum of all `eᵀ S⁻¹ e` divided by this number: 1 for a consistent estimator, less for one that trusts its model less than it could.
    pub per_number: f64,
    /// Upper limit of `per_number` for a consistent estimator, exceeded once in 30 000 runs: `1 + 4 sqrt(2/n)`, the normal approximation of
    /// chi-square.
    pub at_most: f64,
    /// Tells whether innovations are larger than the estimator can explain: its state, its unknowns and their accuracy are then doubtful.
    pub is_off: bool,
    /// Number of signals that were refused as impossible.
    pub refused: usize,
}

/// Number of standard deviations of the sum of squares in this limit, exceeded once in 30 000 runs of a consistent estimator.
const FAR_OFF: f64 = 4.0;

impl Innovations {
    /// Collects the innovations of samples; `None` if there are none.
    #[must_use]
    pub fn of(samples: &[Sample]) -> Option<Self> {
        let (mut numbers, mut sum, mut refused) = (0, 0.0, 0);
        for innovation in samples.iter().filter_map(|sample| sample.innovation) {
            refused += innovation.refused;
            if let Some(normalized) = innovation.normalized {
                numbers += innovation.n;
                sum += normalized;
            }
        }
        let per_number = sum / numbers as f64;
        let at_most = 1.0 + FAR_OFF * (2.0 / numbers as f64).sqrt();
        (numbers > 0).then_some(Self {
            numbers,
            per_number,
            at_most,
            is_off: per_number > at_most,
            refused,
        })
    }
}

impl Innovations {
    /// Says that the estimate is in doubt and what may cause it, where innovations are larger than expected. `missing` are the names of the
    /// unknowns that the filter does not look for, `n_elements` the number of its elements.
    #[must_use]
    pub fn doubt(&self, missing: &[&str], n_elements: usize) -> Option<String> {
        let cause = if missing.is_empty() {
            format!(
                "something is wrong that no unknown describes, such as waves that {n_elements} elements do not have (rod.elements), a step of the \
                 command from rest (a bound on its rate takes it away), or a sensor that is noisier than [[sensor]] says"
            )
        } else {
            format!(
                "something is wrong that is not among estimator.disturbances, which lacks {}, or a sensor is noisier than [[sensor]] says{}",
                missing.join(", "),
                if missing.contains(&"delay") {
                    "; commands that act late, by a lag of tendons as well, look like that, and \"delay\" finds them"
                } else {
                    ""
                }
            )
        };
        self.is_off.then(|| {
            format!(
                "the estimate is in doubt: the squares of what is measured otherwise than expected are {:.2} times as large as the filter expects \
                 (consistent: at most {:.2}); {cause}",
                self.per_number, self.at_most
            )
        })
    }
}

impl Tally {
    /// Computes the statistics of a run with this period, s.
    #[must_use]
    pub fn of(samples: &[Sample], period: f64) -> Self {
        let timed = samples.get(1..).unwrap_or(&[]);
        let of = |field: fn(&Sample) -> f64| Percentiles::of(timed.iter().map(field));
        let mut fallbacks = BTreeMap::new();
        for (cause, _) in samples.iter().filter_map(|sample| sample.fallback) {
            *fallbacks.entry(cause.to_string()).or_insert(0) += 1;
        }
        let computed: f64 = samples.iter().map(|sample| sample.sample_s).sum();
        Self {
            samples: samples.len(),
            overruns: samples.iter().filter(|sample| sample.is_overrun).count(),
            sample_s: of(|sample| sample.sample_s),
            processor_s: of(|sample| sample.processor_s),
            estimate_s: of(|sample| sample.estimate_s + sample.predict_s),
            feedback_s: of(|sample| sample.feedback_s),
            prepare_s: of(|sample| sample.prepare_s),
            first_s: samples.first().map_or(0.0, |sample| sample.sample_s),
            real_time_factor: samples.len() as f64 * period / computed,
            bounded: (samples.iter())
                .filter(|sample| sample.subproblem.iterations > 0)
                .count(),
            breaking: (samples.iter())
                .filter(|sample| sample.breaks_limit)
                .count(),
            fallbacks,
            innovations: Innovations::of(samples),
        }
    }
}
