//! The contents of the report page of a closed loop.

use super::report::{ENERGY_ROWS, FRAMES, arm, fact};
use crate::control::{Bound, Hold};
use crate::mpc::{Disturbance, Sample};
use crate::output::closed_loop::MpcSummary;
use crate::output::{
    self, MotionRecord, ReportChart, ReportCommand, ReportControls, ReportCurve, ReportData,
    ReportEnergy, ReportMotion, ReportPath, ReportTarget, ReportVerdict,
};
use crate::scene::ClosedLoopSetup;
use crate::scene::translate::directors;

/// Points of a curve over samples.
const POINTS: usize = 1000;
/// Bins of the histogram of sample times; the last one has all that took longer.
const BINS: usize = 60;

/// The page of samples that `setup` ran.
pub(crate) fn closed_loop_page(
    setup: &ClosedLoopSetup,
    samples: &[Sample],
    record: &MotionRecord,
    summary: &MpcSummary,
) -> ReportData {
    let thin: Vec<&Sample> = thinned(samples);
    let mut charts = vec![
        error_chart(&thin),
        histogram(samples, summary.period_s),
        times_chart(&thin, summary.period_s),
    ];
    charts.extend(disturbance_charts(&thin));
    let task = &setup.experiment.task;
    let path = || ReportPath {
        node: setup.plant.tip(),
        t: thin.iter().map(|sample| sample.t).collect(),
        x: (thin.iter())
            .filter_map(|sample| sample.reference)
            .collect(),
    };
    let follows = !task.cost.tracks.is_empty() && thin.iter().all(|s| s.reference.is_some());
    ReportData {
        title: summary.scene.clone(),
        command: ReportCommand::Mpc,
        verdict: ReportVerdict {
            text: summary.status.into(),
            ok: summary.status == "completed",
        },
        facts: facts(summary),
        summary: serde_json::to_value(summary).unwrap_or_default(),
        arm: arm(&setup.experiment.plant, &setup.plant),
        motion: ReportMotion::thinned(record, FRAMES),
        target: (task.targets.last()).map(|target| ReportTarget {
            position: target.position.map(Into::into),
            directions: target.rotation.as_ref().map(directors),
        }),
        paths: if follows && !thin.is_empty() {
            vec![path()]
        } else {
            Vec::new()
        },
        obstacles: None,
        controls: Some(controls(setup, &thin)),
        energy: Some(ReportEnergy::thinned(record, ENERGY_ROWS)),
        sensitivity: None,
        charts,
        iterations: Vec::new(),
        attempts: Vec::new(),
        kinds: Vec::new(),
        checks: Vec::new(),
    }
}

/// At most [`POINTS`] samples, evenly spread.
fn thinned(samples: &[Sample]) -> Vec<&Sample> {
    let stride = samples.len().div_ceil(POINTS).max(1);
    samples.iter().step_by(stride).collect()
}

fn facts(summary: &MpcSummary) -> Vec<(String, String)> {
    let percent = |e: f64| format!("{:.4} %", 100.0 * e);
    let off = &summary.tip_error_over_length;
    let times = &summary.sample_s;
    let ms = |seconds: f64| format!("{:.2} ms", 1e3 * seconds);
    let mut facts = vec![
        fact(
            "samples",
            format!("{} of {} s", summary.samples, summary.period_s),
        ),
        fact("horizon", format!("{} s", summary.horizon_s)),
        fact(
            "elements",
            format!(
                "{} of the model, {} of the arm",
                summary.elements, summary.plant_elements
            ),
        ),
        fact(
            "tip error over the length",
            format!(
                "{} rms, {} at most, from {} s on",
                percent(off.rms),
                percent(off.max),
                summary.counted_from_s
            ),
        ),
        fact(
            "time of a sample",
            format!(
                "{} (median), {} (99 %), {} (longest)",
                ms(times.p50),
                ms(times.p99),
                ms(times.max)
            ),
        ),
        fact("overruns", summary.overruns),
        fact(
            "real-time factor",
            format!("{:.2}", summary.real_time_factor),
        ),
        fact("seed", summary.seed),
    ];
    for (name, baseline) in &summary.baselines {
        let rms = baseline.tip_error_over_length.rms;
        facts.push(fact(
            &format!("baseline {name}"),
            format!("{} rms, {}", percent(rms), baseline.status),
        ));
    }
    for (cause, n) in &summary.fallbacks {
        facts.push(fact(&format!("fall-back, {cause}"), n));
    }
    if let Some(error) = &summary.error {
        facts.push(fact("error", error));
    }
    facts
}

/// What the tip is told, from sample to sample.
fn controls(setup: &ClosedLoopSetup, samples: &[&Sample]) -> ReportControls {
    let own = &setup.experiment;
    let bound = |bound: &Option<Bound>| {
        bound.as_ref().map(|bound| match bound {
            Bound::Norm(limit) => output::Bound::Norm(*limit),
            Bound::PerAxis(limits) => output::Bound::Axes((*limits).into()),
        })
    };
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
        force: (samples.iter())
            .map(|sample| sample.wrench.force.into())
            .collect(),
        moment: (samples.iter())
            .map(|sample| sample.wrench.moment.into())
            .collect(),
        force_bound: tip.and_then(|tip| bound(&tip.force.bound)),
        moment_bound: tip.and_then(|tip| bound(&tip.moment.bound)),
    }
}

/// A chart over time.
fn over_time(title: &str, unit: &str, series: Vec<ReportCurve>) -> ReportChart {
    ReportChart {
        title: title.into(),
        unit: unit.into(),
        x_name: "time".into(),
        x_unit: "s".into(),
        series,
    }
}

fn curve(
    name: &str,
    color: &'static str,
    samples: &[&Sample],
    of: impl Fn(&Sample) -> f64,
) -> ReportCurve {
    ReportCurve {
        name: name.into(),
        color,
        x: samples.iter().map(|sample| sample.t).collect(),
        y: samples.iter().map(|sample| of(sample)).collect(),
        hold: false,
        thin: false,
    }
}

fn error_chart(samples: &[&Sample]) -> ReportChart {
    let error = curve("tip", "target", samples, Sample::tip_error);
    over_time(
        "Distance of the tip from its reference, at every sample",
        "m",
        vec![error],
    )
}

/// How many samples took how long, with the period.
fn histogram(samples: &[Sample], period: f64) -> ReportChart {
    let ms = |sample: &Sample| 1e3 * sample.sample_s;
    let timed = samples.get(1..).unwrap_or(&[]);
    let mut sorted: Vec<f64> = timed.iter().map(ms).collect();
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
    let line = |name: &str, color, x, y, hold| ReportCurve {
        name: name.into(),
        color,
        x,
        y,
        hold,
        thin: false,
    };
    ReportChart {
        title: "Samples by their time on this machine; the last bin has all that took longer"
            .into(),
        unit: "samples".into(),
        x_name: "time of a sample".into(),
        x_unit: "ms".into(),
        series: vec![
            line("samples", "z", edges, counts, true),
            line(
                "period",
                "bad",
                vec![1e3 * period; 2],
                vec![0.0, most],
                false,
            ),
        ],
    }
}

fn times_chart(samples: &[&Sample], period: f64) -> ReportChart {
    let ms = 1e3;
    over_time(
        "Time of a sample on this machine",
        "ms",
        vec![
            curve("whole", "norm", samples, |s| ms * s.sample_s),
            curve("estimate and predict", "x", samples, |s| {
                ms * (s.estimate_s + s.predict_s)
            }),
            curve("feedback", "y", samples, |s| ms * s.feedback_s),
            curve("prepare", "z", samples, |s| ms * s.prepare_s),
            curve("period", "bad", samples, |_| ms * period),
        ],
    )
}

const COLORS: [&str; 3] = ["x", "y", "z"];

/// What is estimated, with one standard deviation on both sides; nothing of what is not.
fn disturbance_charts(samples: &[&Sample]) -> Vec<ReportChart> {
    type Part = fn(&Disturbance, usize) -> f64;
    let parts: [(&str, &str, [&str; 3], Part); 3] = [
        (
            "Estimated force on the tip",
            "N",
            ["f x", "f y", "f z"],
            |d, i| d.tip.force[i],
        ),
        (
            "Estimated moment on the tip, body frame",
            "N\u{b7}m",
            ["m\u{2081}", "m\u{2082}", "m\u{2083}"],
            |d, i| d.tip.moment[i],
        ),
        (
            "Estimated force along the arm",
            "N/m",
            ["q x", "q y", "q z"],
            |d, i| d.distributed[i],
        ),
    ];
    let mut out = Vec::new();
    for (title, unit, names, part) in parts {
        if samples
            .iter()
            .all(|s| (0..3).all(|i| part(&s.disturbance, i) == 0.0))
        {
            continue;
        }
        let series = (names.iter().enumerate())
            .flat_map(|(i, name)| with_deviation(name, COLORS[i], samples, move |d| part(d, i)))
            .collect();
        out.push(over_time(title, unit, series));
    }
    if samples.iter().any(|s| s.disturbance.stiffness != 1.0) {
        let series = with_deviation("factor", "norm", samples, |d| d.stiffness);
        out.push(over_time(
            "Estimated factor on the stiffness",
            "",
            series.into(),
        ));
    }
    out
}

fn with_deviation(
    name: &str,
    color: &'static str,
    samples: &[&Sample],
    of: impl Fn(&Disturbance) -> f64,
) -> [ReportCurve; 3] {
    let beside = |side: f64| ReportCurve {
        thin: true,
        ..curve("", color, samples, |s| {
            of(&s.disturbance) + side * of(&s.deviation)
        })
    };
    [
        curve(name, color, samples, |s| of(&s.disturbance)),
        beside(1.0),
        beside(-1.0),
    ]
}
