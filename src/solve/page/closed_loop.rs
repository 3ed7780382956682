//! The contents of the report page of a closed loop.

use serde_json::{Value, json};

use super::obstacles::obstacles;
use super::solve::drawn_bound;
use super::{
    FRAMES, ROWS, add_components, arm, arrows, drawn_arm, efforts, fields, reaction, words,
};
use crate::control::Hold;
use crate::mpc::{Sensing, SensorChoice, Unknown};
use crate::output::closed_loop::SampleRow;
use crate::output::{
    self, Columns, EffortRow, MotionRecord, OutputError, ReportCommand, ReportControls, ReportData,
    ReportEnergy, ReportMotion, ReportPath, ReportTarget, ReportVia,
};
use crate::scene::ClosedLoopSetup;
use crate::scene::translate::target_directors;

/// Points of a curve over samples.
const POINTS: usize = 1000;
/// Bins of the histogram of sample times; the last one has all that took longer.
const BINS: usize = 60;

/// The page of samples that `setup` ran; `acting` is the contents of `efforts.csv`, if there is one, and `summary` that of `summary.json`.
pub(crate) fn closed_loop_page(
    setup: &ClosedLoopSetup,
    samples: &[SampleRow],
    record: &MotionRecord,
    acting: &[EffortRow],
    summary: &Value,
) -> Result<ReportData, OutputError> {
    let stride = samples.len().div_ceil(POINTS).max(1);
    let thin: Vec<&SampleRow> = samples.iter().step_by(stride).collect();
    let own = &setup.experiment;
    let task = &own.task;
    let has_path = (task.cost.tracks.iter()).any(|track| !track.path.is_empty());
    let follows = has_path && thin.iter().all(|s| s.reference.is_some());
    let mut columns = columns(&thin, own.mpc.period);
    columns.extend(histogram(samples, own.mpc.period));
    columns.extend(reaction::nearest_to_base(&setup.plant, record));
    let n_actuators = setup.plant.actuators.len();
    let instants: Vec<&[EffortRow]> = acting.chunks(n_actuators.max(1)).collect();
    let shown = efforts::shown(&setup.plant, record, &task.efforts, &|row| {
        let at = instants.partition_point(|rows| rows[0].t < record.t[row]);
        let rows = instants.get(at).or(instants.last());
        let of_rows = rows.map(|rows| rows.iter().map(|row| row.effort).collect());
        of_rows.unwrap_or_else(|| vec![0.0; n_actuators])
    });
    columns.extend(shown.columns);
    let (last, earlier) = match task.targets.split_last() {
        Some((last, earlier)) => (Some(last), earlier),
        None => (None, &[][..]),
    };
    let words = words(
        "closed_loop.jinja",
        &context(setup, samples, summary, follows, &shown.groups),
        &columns,
    )?;
    let motion = ReportMotion::thinned(record, FRAMES);
    Ok(ReportData {
        target: last.map(|target| ReportTarget {
            position: target.position.map(Into::into),
            directions: target_directors(target.rotation, target.direction),
        }),
        via: (earlier.iter())
            .filter_map(|target| {
                Some(ReportVia {
                    name: target.name.clone(),
                    node: target.at.node(&setup.plant.mesh),
                    t: target.time?,
                    position: target.position?.into(),
                })
            })
            .collect(),
        paths: if follows && !thin.is_empty() {
            vec![path(setup, &thin, record)]
        } else {
            Vec::new()
        },
        arrows: (arrows::on_tip(record).into_iter())
            .chain(arrows::given(&setup.plant, record, |i| load_name(setup, i)))
            .chain(shown.arrows)
            .collect(),
        routes: shown.routes,
        fields: fields::fields(&setup.plant, record),
        obstacles: obstacles(
            &task.limits,
            &setup.plant,
            &own.plant.radii_at_nodes(&setup.plant.mesh),
            record,
        ),
        controls: Some(controls(setup, &thin)),
        energy: Some(ReportEnergy::thinned(record, ROWS)),
        ..ReportData::of(
            ReportCommand::Mpc,
            summary,
            words,
            drawn_arm(&own.plant, &setup.plant),
            motion,
        )
    })
}

/// Returns the values of the template: the plant, with the loads that the controller knows told apart from the others, and the model.
fn context(
    setup: &ClosedLoopSetup,
    samples: &[SampleRow],
    summary: &Value,
    follows: bool,
    efforts: &Value,
) -> Value {
    let own = &setup.experiment;
    let peak = |of: fn(&SampleRow) -> &[f64; 3]| {
        let size = |sample: &SampleRow| of(sample).iter().map(|v| v * v).sum::<f64>().sqrt();
        let largest = samples.iter().map(size).fold(0.0, f64::max);
        (largest > 0.0).then_some(largest)
    };
    let corner = |most: fn(f64, f64) -> f64, from: f64| {
        (samples.iter().filter_map(|sample| sample.reference)).fold([from; 3], |corner, x| {
            std::array::from_fn::<f64, 3, _>(|i| most(corner[i], x[i]))
        })
    };
    let known = [own.arm.loads.len(), own.arm.distributed_loads.len()];
    let all = [usize::MAX; 2];
    json!({
        "summary": summary,
        "efforts": efforts,
        "scene": setup.resolved,
        "measured": measured(setup),
        "unknowns": Unknown::TABLE.map(|row| {
            json!([row.words, row.unit, row.symbols, row.columns, row.neutral])
        }),
        "plant": arm::arm(&own.plant, &setup.plant, known),
        "plant_as_loaded": arm::arm(&own.plant, &setup.plant, all),
        "model": arm::arm(&own.arm, &setup.model, all),
        "plant_delay_s": own.actuators.delay,
        "plant_lag_s": own.actuators.lag,
        "model_delay_s": own.settings.actuator_delay,
        "is_adjusted": own.adjust.is_some(),
        "actuators": arm::actuators(&own.task.actuators),
        "limits": arm::names(&own.task.limits),
        "duration_s": own.duration,
        "period_s": own.mpc.period,
        "follows": follows,
        "within": [corner(f64::min, f64::INFINITY), corner(f64::max, f64::NEG_INFINITY)],
        "peak": { "force": peak(|s| &s.force), "moment": peak(|s| &s.moment) },
    })
}

/// Returns what every sensor measures, at places along the arm and at the clamp: words, standard deviation and unit of each quantity.
fn measured(setup: &ClosedLoopSetup) -> Vec<[Vec<Value>; 2]> {
    let Sensing::Estimated { sensors, .. } = &setup.experiment.sensing else {
        return Vec::new();
    };
    (sensors.iter())
        .map(|choice| {
            let settings = match choice {
                SensorChoice::Preset(preset) => preset.settings(&setup.model),
                SensorChoice::Own(settings) => settings.clone(),
            };
            [false, true].map(|at_clamp| {
                (settings.measured(at_clamp))
                    .map(|(own, sigma)| json!([own.row().words, sigma, own.row().unit]))
                    .collect()
            })
        })
        .collect()
}

/// Returns a word that tells whether the plant's load of this index belongs to the controller's model.
///
/// Point loads come first, then those of the nodes of distributed ones.
fn load_name(setup: &ClosedLoopSetup, index: usize) -> &'static str {
    let (model, plant) = (&setup.experiment.arm, &setup.experiment.plant);
    let is_known = match index.checked_sub(plant.loads.len()) {
        None => index < model.loads.len(),
        Some(lump) => {
            let known = plant
                .distributed_loads
                .iter()
                .take(model.distributed_loads.len());
            let lumps = known.map(|load| load.lumped(plant.length, &setup.plant.mesh).len());
            lump < lumps.sum::<usize>()
        }
    };
    if is_known {
        arrows::LOAD
    } else {
        "disturbance"
    }
}

/// The references of the tip, or of the node that follows, and how far it is from them at the frames.
fn path(setup: &ClosedLoopSetup, samples: &[&SampleRow], record: &MotionRecord) -> ReportPath {
    let t: Vec<f64> = samples.iter().map(|sample| sample.t).collect();
    let x: Vec<[f64; 3]> = samples
        .iter()
        .filter_map(|sample| sample.reference)
        .collect();
    let tip = setup.followed;
    let off = |row: usize| {
        let now = record.t[row];
        let next = t.partition_point(|&time| time <= now).min(t.len() - 1);
        let before = next.saturating_sub(1);
        let span = t[next] - t[before];
        let part = if span > 0.0 {
            // The last frame is a period after the last sample, and the reference goes on there.
            ((now - t[before]) / span).max(0.0)
        } else {
            0.0
        };
        let [a, b] = [before, next].map(|i| nalgebra::Vector3::from(x[i]));
        (record.position(row, tip) - (a + (b - a) * part)).norm()
    };
    ReportPath {
        node: tip,
        off: record.thinned_rows(FRAMES).into_iter().map(off).collect(),
        t,
        x,
    }
}

/// Commands to the tip, from sample to sample.
fn controls(setup: &ClosedLoopSetup, samples: &[&SampleRow]) -> ReportControls {
    let own = &setup.experiment;
    let tip = own.task.actuators.first();
    let is_constant = own.discretization.hold == Hold::Constant;
    let end = (samples.last()).map(|sample| sample.acts_from + own.mpc.period);
    let mut t: Vec<f64> = samples.iter().map(|sample| sample.acts_from).collect();
    if is_constant {
        t.extend(end);
    }
    ReportControls {
        hold: if is_constant {
            output::ReportHold::Constant
        } else {
            output::ReportHold::Linear
        },
        t,
        force: samples.iter().map(|sample| sample.force).collect(),
        moment: samples.iter().map(|sample| sample.moment).collect(),
        force_bound: tip.and_then(|tip| drawn_bound(&tip.force.bound)),
        moment_bound: tip.and_then(|tip| drawn_bound(&tip.moment.bound)),
    }
}

/// Index of the time of the whole sample.
const WHOLE: usize = 4;

/// Columns of the charts over samples; references only if every sample has one.
fn columns(samples: &[&SampleRow], period: f64) -> Columns {
    let mut out = Columns::new();
    let mut add = |name: &str, of: &dyn Fn(&SampleRow) -> f64| {
        out.insert(
            name.into(),
            samples.iter().map(|sample| of(sample)).collect(),
        );
    };
    add("t", &|s| s.t);
    add("error", &|s| s.error);
    add("turn", &|s| s.turn);
    for (i, name) in Unknown::columns().enumerate() {
        add(&format!("estimated_{name}"), &|s| s.disturbance[i]);
        add(&format!("deviation_{name}"), &|s| s.deviation[i]);
    }
    add("estimate_and_predict_ms", &|s| {
        s.times_ms[0] + s.times_ms[1]
    });
    add("feedback_ms", &|s| s.times_ms[2]);
    add("prepare_ms", &|s| s.times_ms[3]);
    add("sample_ms", &|s| s.times_ms[WHOLE]);
    add("period_ms", &|_| 1e3 * period);
    add_components(&mut out, "tip", samples.iter().map(|s| &s.tip));
    let references: Option<Vec<_>> = samples.iter().map(|s| s.reference).collect();
    if let Some(references) = references {
        add_components(&mut out, "reference", references.iter());
    }
    out
}

/// Histogram of the durations of samples, with the period, ms.
fn histogram(samples: &[SampleRow], period: f64) -> Columns {
    let timed = samples.get(1..).unwrap_or(&[]);
    let mut sorted: Vec<f64> = timed.iter().map(|sample| sample.times_ms[WHOLE]).collect();
    sorted.sort_by(f64::total_cmp);
    let p99 = sorted
        .get((0.99 * sorted.len() as f64) as usize)
        .copied()
        .unwrap_or(0.0);
    let width = (1.5 * p99).max(1.2e3 * period) / BINS as f64;
    let mut counts = vec![0.0; BINS];
    for time in sorted {
        counts[((time / width) as usize).min(BINS - 1)] += 1.0;
    }
    let most = counts.iter().copied().fold(1.0, f64::max);
    Columns::from(
        [
            (
                "bin_edges_ms",
                (0..=BINS).map(|i| i as f64 * width).collect(),
            ),
            ("bin_counts", counts),
            ("bin_period_ms", vec![1e3 * period; 2]),
            ("bin_period", vec![0.0, most]),
        ]
        .map(|(name, values)| (name.to_string(), values)),
    )
}
