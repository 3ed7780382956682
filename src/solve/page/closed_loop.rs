//! The contents of the report page of a closed loop.

use serde_json::Value;

use super::obstacles::obstacles;
use super::solve::drawn_bound;
use super::summary::{Fields, counted, measure, vector};
use super::words::{acting_facts, arm_facts, at_most, cost, in_numbers};
use super::{FRAMES, ROWS, arrows, drawn_arm, fact, fields, loop_tables, over_time, reaction};
use crate::control::Hold;
use crate::output::closed_loop::SampleRow;
use crate::output::{
    self, MotionRecord, ReportChart, ReportClock, ReportCommand, ReportControls, ReportCurve,
    ReportData, ReportEnergy, ReportMotion, ReportPath, ReportTarget, ReportVerdict, ReportVia,
    figure,
};
use crate::scene::translate::directors;
use crate::scene::{ClosedLoopSetup, LoadNode};

/// Points of a curve over samples.
const POINTS: usize = 1000;
/// Bins of the histogram of sample times; the last one has all that took longer.
const BINS: usize = 60;

/// The page of samples that `setup` ran; `summary` is the contents of `summary.json`.
pub(crate) fn closed_loop_page(
    setup: &ClosedLoopSetup,
    samples: &[SampleRow],
    record: &MotionRecord,
    summary: &Value,
) -> ReportData {
    let thin: Vec<&SampleRow> = thinned(samples);
    let found = Fields(summary);
    let own = &setup.experiment;
    let period = own.mpc.period;
    let task = &own.task;
    let has_path = (task.cost.tracks.iter()).any(|track| !track.path.is_empty());
    let follows = has_path && thin.iter().all(|s| s.reference.is_some());
    let mut charts = Vec::new();
    // A path to follow has a chart of its own.
    if !follows && thin.iter().any(|sample| sample.error.is_finite()) {
        let title = "Distance of the tip from its reference, at every sample";
        charts.push(tip_chart(title, "m", &thin, |sample| sample.error));
    }
    if thin.iter().any(|sample| sample.turn.is_finite()) {
        let title = "Angle of the tip from how it should be turned, at every sample";
        charts.push(tip_chart(title, "rad", &thin, |sample| sample.turn));
    }
    charts.extend(tip_beside_reference(&thin));
    charts.extend([histogram(samples, period), times_chart(&thin, period)]);
    charts.extend(disturbance_charts(&thin));
    charts.extend(reaction::nearest_to_base(&setup.plant, record));
    let (last, earlier) = match task.targets.split_last() {
        Some((last, earlier)) => (Some(last), earlier),
        None => (None, &[][..]),
    };
    let (lead, trust) = words(setup, samples, found, follows);
    ReportData {
        title: found.text("scene").into(),
        command: ReportCommand::Mpc,
        verdict: ReportVerdict {
            text: found.text("status").into(),
            ok: found.text("status") == "completed",
            checked: false,
        },
        lead,
        trust,
        arm_facts: arm_facts(&setup.experiment.plant, &setup.plant),
        acting: acting_facts(
            &own.plant,
            &own.task.limits,
            &own.task.actuators,
            [own.arm.loads.len(), own.arm.distributed_loads.len()],
        ),
        facts: facts(found),
        summary: summary.clone(),
        arm: drawn_arm(&setup.experiment.plant, &setup.plant),
        motion: ReportMotion::thinned(record, FRAMES),
        clock: ReportClock::time(),
        target: last.map(|target| ReportTarget {
            position: target.position.map(Into::into),
            directions: target.rotation.as_ref().map(directors),
        }),
        via: (earlier.iter())
            .filter_map(|target| {
                Some(ReportVia {
                    name: target.name.clone(),
                    node: target.at.node(setup.plant.n_elements()),
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
            .collect(),
        fields: fields::fields(&setup.plant, record),
        obstacles: obstacles(
            &task.limits,
            &setup.plant,
            &setup
                .experiment
                .plant
                .radii_at_nodes(setup.plant.n_elements()),
            record,
        ),
        controls: Some(controls(setup, &thin)),
        energy: Some(ReportEnergy::thinned(record, ROWS)),
        sensitivity: None,
        bars: loop_tables::baselines(found),
        tables: loop_tables::tables(setup),
        advice: (found.get("advice").as_array().into_iter().flatten())
            .filter_map(|sentence| Some(sentence.as_str()?.to_string()))
            .collect(),
        charts,
        iterations: Vec::new(),
        attempts: Vec::new(),
        kinds: Vec::new(),
        checks: Vec::new(),
    }
}

/// At most [`POINTS`] samples, evenly spread.
fn thinned(samples: &[SampleRow]) -> Vec<&SampleRow> {
    let stride = samples.len().div_ceil(POINTS).max(1);
    samples.iter().step_by(stride).collect()
}

fn percent(part: f64) -> String {
    format!("{} %", figure(100.0 * part, 3))
}

fn words(
    setup: &ClosedLoopSetup,
    samples: &[SampleRow],
    summary: Fields,
    follows: bool,
) -> (String, String) {
    let own = &setup.experiment;
    let peak = |of: fn(&SampleRow) -> &[f64; 3]| {
        (samples.iter())
            .map(|sample| of(sample).iter().map(|v| v * v).sum::<f64>().sqrt())
            .fold(0.0, f64::max)
    };
    let acts = |peak: f64| (peak > 0.0).then_some(peak);
    let [places, turns] = [
        samples.iter().any(|sample| sample.error.is_finite()),
        samples.iter().any(|sample| sample.turn.is_finite()),
    ];
    let does = match (follows, places, turns) {
        (true, _, _) => followed(setup, samples),
        (false, false, true) => "The tip is turned as it should be".into(),
        _ => "The tip is driven to its target".into(),
    };
    let off = summary.number("tip_error_over_length.rms");
    let missed = match off.is_finite() {
        true => format!(
            ", off by {} of the length (rms from {} on) and {} at most",
            percent(off),
            summary.measure("counted_from_s", "s"),
            percent(summary.number("tip_error_over_length.max"))
        ),
        false => String::new(),
    };
    let turned = summary.number("tip_turn_rad.rms");
    let missed = match turned.is_finite() {
        true => format!("{missed}, turned off by {}", measure(turned, "rad")),
        false => missed,
    };
    let comma = if missed.is_empty() { "" } else { "," };
    let unknown = own.plant.loads.iter().skip(own.arm.loads.len());
    let unknown: Vec<String> = unknown.flat_map(in_numbers).collect();
    let spite = match unknown.is_empty() {
        true => String::new(),
        false => format!(" in spite of {}", unknown.join(" and ")),
    };
    let lead = format!(
        "{does} for {}{spite}{missed}{comma}{}; {}{}",
        measure(own.duration, "s"),
        at_most(acts(peak(|s| &s.force)), acts(peak(|s| &s.moment))),
        summary.text("status"),
        cost(summary)
    );
    let overruns = counted(summary.count("overruns"), "sample", "samples");
    let trust = match summary.text("error") {
        "" => format!(
            "The controller has a model of {} and drives a simulated arm of {}; {overruns} of {} took longer than the period of {} on this machine.",
            counted(summary.count("elements"), "element", "elements"),
            counted(summary.count("plant_elements"), "element", "elements"),
            summary.count("samples"),
            measure(1e3 * own.mpc.period, "ms")
        ),
        error => format!("Do not rely on it: {error}."),
    };
    (lead, trust)
}

/// "The tip goes round a circle of 0.2 m radius about (0, 0, 0.976) m, a turn in 2 s," for a path that has a name, and for others the box that
/// they stay in.
fn followed(setup: &ClosedLoopSetup, samples: &[SampleRow]) -> String {
    let track = (setup.resolved.objective.iter())
        .flat_map(|objective| &objective.track)
        .find(|track| track.node == LoadNode::Tip);
    if let Some(circle) = track.and_then(|track| track.circle.as_ref()) {
        return format!(
            "The tip goes round a circle of {} about {} m, a turn in {},",
            measure(circle.radius_m.get(), "m radius"),
            vector(circle.center_m),
            measure(circle.turn_s.get(), "s")
        );
    }
    if let Some(eight) = track.and_then(|track| track.figure_eight.as_ref()) {
        return format!(
            "The tip goes along a figure eight of {} about {} m, a turn in {},",
            measure(2.0 * eight.half_length_m.get(), "m length"),
            vector(eight.center_m),
            measure(eight.turn_s.get(), "s")
        );
    }
    let places = samples.iter().filter_map(|sample| sample.reference);
    let corners = places.fold(
        [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]],
        |[low, high], x| {
            [
                std::array::from_fn(|i| low[i].min(x[i])),
                std::array::from_fn(|i| high[i].max(x[i])),
            ]
        },
    );
    let [low, high] = corners.map(vector);
    format!("The tip follows a path within {low} to {high} m")
}

/// Whether the load of this index on the arm as it is belongs to the controller's model, in a word.
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
            let lumps = known.map(|load| load.lumped(plant.length, setup.plant.n_elements()).len());
            lump < lumps.sum::<usize>()
        }
    };
    if is_known {
        arrows::LOAD
    } else {
        "disturbance"
    }
}

/// The references of the tip, and how far it is from them at the frames.
fn path(setup: &ClosedLoopSetup, samples: &[&SampleRow], record: &MotionRecord) -> ReportPath {
    let t: Vec<f64> = samples.iter().map(|sample| sample.t).collect();
    let x: Vec<[f64; 3]> = samples
        .iter()
        .filter_map(|sample| sample.reference)
        .collect();
    let tip = setup.plant.tip();
    let off = |row: usize| {
        let now = record.t[row];
        let next = t.partition_point(|&time| time <= now).min(t.len() - 1);
        let before = next.saturating_sub(1);
        let span = t[next] - t[before];
        let part = if span > 0.0 {
            ((now - t[before]) / span).clamp(0.0, 1.0)
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

fn facts(summary: Fields) -> Vec<(String, String)> {
    let ms = |path: &str| measure(1e3 * summary.number(path), "ms");
    let off = |part: &str| {
        let part = summary.number(&format!("tip_error_over_length.{part}"));
        if part.is_finite() {
            percent(part)
        } else {
            "–".into()
        }
    };
    let period = summary.measure("period_s", "s");
    let mut facts = vec![
        fact("status", summary.text("status")),
        fact(
            "samples",
            format!("{} of {period}", summary.count("samples")),
        ),
        fact("horizon", summary.measure("horizon_s", "s")),
        fact(
            "elements",
            format!(
                "{} of the model, {} of the arm",
                summary.count("elements"),
                summary.count("plant_elements")
            ),
        ),
        fact(
            "tip error over the length",
            format!(
                "{} rms, {} at most, from {} on",
                off("rms"),
                off("max"),
                summary.measure("counted_from_s", "s")
            ),
        ),
        fact(
            "time of a sample",
            format!(
                "{} (median), {} (99 %), {} (longest)",
                ms("sample_s.p50"),
                ms("sample_s.p99"),
                ms("sample_s.max")
            ),
        ),
        fact("overruns", summary.count("overruns")),
        fact(
            "real-time factor",
            figure(summary.number("real_time_factor"), 3),
        ),
        fact("wall time", summary.measure("wall_s", "s")),
        fact("seed", summary.count("seed")),
    ];
    if !summary.get("innovations").is_null() {
        let number = |key: &str| summary.number(&format!("innovations.{key}"));
        let verdict = if summary.get("innovations.is_off") == &serde_json::Value::Bool(true) {
            ": the estimate is in doubt"
        } else {
            ""
        };
        let said = format!(
            "{:.2}, consistent at most {:.2}{verdict}",
            number("per_number"),
            number("at_most")
        );
        facts.push(fact("squared innovations over their variance", said));
        facts.push(fact("signals refused", summary.get("innovations.refused")));
    }
    for (cause, n) in summary.get("fallbacks").as_object().into_iter().flatten() {
        facts.push(fact(&format!("fall-back, {cause}"), n));
    }
    if !summary.text("error").is_empty() {
        facts.push(fact("error", summary.text("error")));
    }
    facts
}

/// What the tip is told, from sample to sample.
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
            output::Hold::Constant
        } else {
            output::Hold::Linear
        },
        t,
        force: samples.iter().map(|sample| sample.force).collect(),
        moment: samples.iter().map(|sample| sample.moment).collect(),
        force_bound: tip.and_then(|tip| drawn_bound(&tip.force.bound)),
        moment_bound: tip.and_then(|tip| drawn_bound(&tip.moment.bound)),
    }
}

/// Sections of the page.
const TIP: &str = "Tip and reference";
const LOOP: &str = "Loop";
const ESTIMATES: &str = "Estimated disturbances, with a band of one standard deviation";

fn curve(
    name: &str,
    color: &'static str,
    samples: &[&SampleRow],
    of: impl Fn(&SampleRow) -> f64,
) -> ReportCurve {
    let t = samples.iter().map(|sample| sample.t).collect();
    super::curve(
        name,
        color,
        t,
        samples.iter().map(|sample| of(sample)).collect(),
    )
}

fn tip_chart(
    title: &str,
    unit: &str,
    samples: &[&SampleRow],
    of: impl Fn(&SampleRow) -> f64,
) -> ReportChart {
    over_time(LOOP, title, unit, vec![curve("tip", "target", samples, of)])
}

/// The tip and where it should be, along every axis along which either moves.
fn tip_beside_reference(samples: &[&SampleRow]) -> Vec<ReportChart> {
    if samples.iter().any(|sample| sample.reference.is_none()) {
        return Vec::new();
    }
    let reference = |sample: &SampleRow, axis: usize| {
        sample
            .reference
            .map_or(f64::NAN, |reference| reference[axis])
    };
    (["x", "y", "z"].into_iter().enumerate())
        .map(|(axis, name)| {
            let should = ReportCurve {
                dashed: true,
                ..curve("reference", "target", samples, |s| reference(s, axis))
            };
            let is = curve("tip", "norm", samples, |sample| sample.tip[axis]);
            over_time(
                TIP,
                &format!("Tip beside its reference, {name}"),
                "m",
                vec![is, should],
            )
        })
        .collect()
}

/// Index of the time of the whole sample.
const WHOLE: usize = 4;

/// How many samples took how long, with the period.
fn histogram(samples: &[SampleRow], period: f64) -> ReportChart {
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
    let edges = (0..=BINS).map(|i| i as f64 * width).collect();
    let samples = ReportCurve {
        hold: true,
        ..super::curve("samples", "z", edges, counts)
    };
    ReportChart {
        section: LOOP.into(),
        title: "Samples by their time on this machine; the last bin has all that took longer"
            .into(),
        unit: "samples".into(),
        x_name: "time of a sample".into(),
        x_unit: "ms".into(),
        series: vec![
            samples,
            super::curve("period", "bad", vec![1e3 * period; 2], vec![0.0, most]),
        ],
    }
}

fn times_chart(samples: &[&SampleRow], period: f64) -> ReportChart {
    over_time(
        LOOP,
        "Time of a sample on this machine",
        "ms",
        vec![
            curve("whole", "norm", samples, |s| s.times_ms[WHOLE]),
            curve("estimate and predict", "x", samples, |s| {
                s.times_ms[0] + s.times_ms[1]
            }),
            curve("feedback", "y", samples, |s| s.times_ms[2]),
            curve("prepare", "z", samples, |s| s.times_ms[3]),
            curve("period", "bad", samples, |_| 1e3 * period),
        ],
    )
}

const COLORS: [&str; 3] = ["x", "y", "z"];

/// What is estimated, with one standard deviation on both sides; nothing of what is not.
fn disturbance_charts(samples: &[&SampleRow]) -> Vec<ReportChart> {
    let parts: [(&str, &str, [&str; 3], usize); 3] = [
        ("Estimated force on the tip", "N", ["f x", "f y", "f z"], 0),
        (
            "Estimated moment on the tip, body frame",
            "N\u{b7}m",
            ["m\u{2081}", "m\u{2082}", "m\u{2083}"],
            3,
        ),
        (
            "Estimated force along the arm",
            "N/m",
            ["q x", "q y", "q z"],
            6,
        ),
    ];
    let mut out = Vec::new();
    for (title, unit, names, first) in parts {
        if samples
            .iter()
            .all(|s| (0..3).all(|i| s.disturbance[first + i] == 0.0))
        {
            continue;
        }
        let series = (names.iter().enumerate())
            .map(|(i, name)| with_deviation(name, COLORS[i], samples, first + i))
            .collect();
        out.push(over_time(ESTIMATES, title, unit, series));
    }
    for (part, (title, unit, name, known)) in (PARAMETERS..).zip([
        ("Estimated factor on the stiffness", "", "factor", 1.0),
        (
            "Estimated mass on the tip beyond the model's",
            "kg",
            "m",
            0.0,
        ),
        (
            "Estimated viscous damping beyond the model's",
            "1/s",
            "c",
            0.0,
        ),
        (
            "Estimated time of internal damping beyond the model's",
            "s",
            "τ",
            0.0,
        ),
        ("Estimated delay of the commands", "s", "d", 0.0),
    ]) {
        if samples.iter().any(|s| s.disturbance[part] != known) {
            let series = with_deviation(name, "norm", samples, part);
            out.push(over_time(ESTIMATES, title, unit, vec![series]));
        }
    }
    out
}

/// Index of the first parameter of the model among the disturbances.
const PARAMETERS: usize = 9;

/// An estimate with one standard deviation on both sides.
fn with_deviation(
    name: &str,
    color: &'static str,
    samples: &[&SampleRow],
    part: usize,
) -> ReportCurve {
    ReportCurve {
        band: samples.iter().map(|s| s.deviation[part]).collect(),
        ..curve(name, color, samples, |s| s.disturbance[part])
    }
}
