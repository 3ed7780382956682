//! The contents of the report page of statics: the sweep as a motion whose clock is the load factor.

use serde_json::Value;

use super::fields::pose;
use super::summary::{Fields, measure, vector};
use super::words::{acting_facts, arm_facts, cost};
use super::{FRAMES, ROWS, arrows, curve, drawn_arm, fact, fields};
use crate::mechanics::diagnostics::ElementStress;
use crate::mechanics::{Rod, Varied};
use crate::output::{
    MotionRecord, ReportChart, ReportClock, ReportCommand, ReportCurve, ReportData, ReportEnergy,
    ReportMotion, ReportVerdict, figure,
};
use crate::scene::Scene;
use crate::task::Arm;

/// The page of the statics of an arm; `rod` is under the loads at factor 1, the rows of `record` are the sweep, and `summary` is the contents of
/// `summary.json`.
pub(crate) fn equilibrium_page(
    scene: &Scene,
    arm: &Arm,
    rod: &Rod,
    record: &MotionRecord,
    summary: &Value,
) -> ReportData {
    let found = Fields(summary);
    let stable = found.text("stability.verdict");
    let factors = record.t.last().copied().unwrap_or(1.0);
    let varied = match found.text("varied") {
        "loads" => Varied::Loads,
        "gravity" => Varied::Gravity,
        _ => Varied::All,
    };
    let mut facts = vec![
        fact(
            "tip",
            format!("{} m", vector(triple(found, "tip.position_m"))),
        ),
        fact(
            "moved by the loads",
            found.measure("tip_displacement_m", "m"),
        ),
        fact("error from elements", found.measure("refined_space_m", "m")),
        fact(
            "force of the base",
            format!("{} N", vector(triple(found, "base.force_n"))),
        ),
        fact(
            "moment of the base",
            format!("{} N\u{b7}m", vector(triple(found, "base.moment_n_m"))),
        ),
        fact("elastic energy", found.measure("energy_J.elastic", "J")),
        fact(
            "largest bending curvature",
            found.measure("curvature_max_1_m", "1/m"),
        ),
        fact("stability", stability_words(found)),
        fact("load factor multiplies", varied.words()),
        fact("while the loads grow", buckling_words(found)),
    ];
    if !found.text("sweep_cut").is_empty() {
        facts.push(fact("sweep", found.text("sweep_cut")));
    }
    let loaded = over_factors(rod, varied, found.number("time_s"), factors);
    let mut forces = arrows::given(&loaded, record, |_| arrows::LOAD);
    if varied != Varied::Loads {
        let rows = record.thinned_rows(FRAMES);
        for arrow in forces.iter_mut().filter(|arrow| !arrow.at.is_empty()) {
            for (vector, &row) in arrow.vectors.iter_mut().zip(&rows) {
                *vector = vector.map(|part| part * record.t[row] as f32);
            }
            arrow.peak *= factors;
        }
    }
    let mut images = fields::fields(&loaded, record);
    if let Some(images) = &mut images {
        images.fields.retain(|field| field.name != "speed");
    }
    let mut charts = over_the_factor(record, found);
    charts.extend(along_the_arm(rod, record));
    ReportData {
        title: found.text("scene").into(),
        command: ReportCommand::Equilibrium,
        verdict: ReportVerdict {
            text: stable.into(),
            ok: stable == "stable",
            checked: true,
        },
        lead: lead(found),
        trust: trust(found),
        arm_facts: arm_facts(arm, rod),
        acting: acting_facts(arm, &scene.limits(), &[], [usize::MAX; 2]),
        facts,
        summary: summary.clone(),
        arm: drawn_arm(arm, rod),
        motion: ReportMotion::thinned(record, FRAMES),
        clock: ReportClock::load_factor(),
        target: None,
        via: Vec::new(),
        paths: Vec::new(),
        arrows: forces,
        fields: images,
        obstacles: None,
        controls: None,
        energy: Some(ReportEnergy::thinned(record, ROWS)),
        sensitivity: None,
        bars: Vec::new(),
        tables: Vec::new(),
        advice: Vec::new(),
        charts,
        iterations: Vec::new(),
        attempts: Vec::new(),
        kinds: Vec::new(),
        checks: Vec::new(),
    }
}

/// Part of the largest of some numbers below which another one is its rounding.
const ROUNDING: f64 = 1e-9;

/// A vector, without rounding.
fn triple(found: Fields, path: &str) -> [f64; 3] {
    let v = [0, 1, 2].map(|i| found.get(path)[i].as_f64().unwrap_or(f64::NAN));
    let largest = v.iter().fold(0.0, |most: f64, part| most.max(part.abs()));
    v.map(|part| {
        if part.abs() < ROUNDING * largest {
            0.0
        } else {
            part
        }
    })
}

/// The rod whose loads follow the load factor as others follow the time.
fn over_factors(rod: &Rod, varied: Varied, time: f64, last: f64) -> Rod {
    let mut out = rod.clone();
    for load in &mut out.loads {
        let factor = load.factor(time);
        load.force *= factor;
        load.moment *= factor;
        load.profile = match varied {
            Varied::Gravity => Vec::new(),
            Varied::All | Varied::Loads => vec![(0.0, 0.0), (last, last)],
        };
    }
    out
}

fn stability_words(found: Fields) -> String {
    match found.text("stability.verdict") {
        "stable" => format!(
            "stable: sways at {}, the tip gives way by {} per newton at most",
            found.measure("stability.first_frequency_hz", "Hz"),
            measure(1.0 / found.number("stability.tip_stiffness_n_m"), "m")
        ),
        "unstable" => format!(
            "unstable: deviations grow e-fold in {}",
            measure(1.0 / found.number("stability.growth_rate_1_s"), "s")
        ),
        "neutral" => "neutral: nothing brings the arm back, and nothing grows".into(),
        _ => "unknown".into(),
    }
}

/// Where stability is lost along the load factor, as a clause.
fn buckling_words(found: Fields) -> String {
    let factor = figure(found.number("buckling.factor"), 5);
    let up_to = format!(
        "it is stable up to load factor {}",
        figure(found.number("buckling.stable_up_to"), 3)
    );
    match (found.text("buckling.how"), found.text("buckling.why")) {
        ("buckling", _) => format!("at load factor {factor} it buckles"),
        ("snapping", _) => format!("at load factor {factor} it snaps through"),
        ("flutter", _) => format!("at load factor {factor} it flutters"),
        (_, "unloaded") => "nothing loads it".into(),
        (_, "out-of-range") => {
            format!("{up_to}, beyond which elements leave the range of rod models")
        }
        (_, "not-followed") => format!("{up_to}, beyond which no equilibrium was found"),
        _ => up_to,
    }
}

fn lead(found: Fields) -> String {
    let moved = found.measure("tip_displacement_m", "m");
    let tip = vector(triple(found, "tip.position_m"));
    let goes = match found.get("goes_to_m").is_array() {
        true => format!(
            "; pushed a little, the arm goes to a tip at {} m",
            vector(triple(found, "goes_to_m"))
        ),
        false => String::new(),
    };
    format!(
        "The arm rests with its tip at {tip} m, which its loads moved by {moved}; {}{goes}; {}{}",
        stability_words(found),
        buckling_words(found),
        cost(found)
    )
}

fn trust(found: Fields) -> String {
    let error = found.number("refined_space_m");
    match error.is_finite() {
        true => format!(
            "Twice as many elements put the tip about {} elsewhere. Stability is that of small deviations under loads that stay as they are.",
            measure(error, "m")
        ),
        false => "Twice as many elements have another equilibrium or none: do not rely on this one, and take more elements.".into(),
    }
}

fn over_factor(title: &str, unit: &str, series: Vec<ReportCurve>) -> ReportChart {
    let clock = ReportClock::load_factor();
    ReportChart {
        section: "Tip and stability over the load factor".into(),
        title: title.into(),
        unit: unit.into(),
        x_name: clock.name.into(),
        x_unit: clock.unit.into(),
        series,
    }
}

/// Charts over the load factor: the way of the tip, and the stability.
fn over_the_factor(record: &MotionRecord, found: Fields) -> Vec<ReportChart> {
    let t = &record.t;
    let tip = record.n_nodes - 1;
    let start = record.position(0, tip);
    let moved = |row: usize| record.position(row, tip) - start;
    let mut way = vec![curve(
        "distance",
        "norm",
        t.clone(),
        (0..t.len()).map(|row| moved(row).norm()).collect(),
    )];
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let values = (0..t.len()).map(|row| moved(row)[axis]).collect();
        way.push(curve(name, name, t.clone(), values));
    }
    let squares: Vec<f64> = (found.list("sweep"))
        .map(|point| point.number("squared_frequency_1_s2"))
        .collect();
    let growth: Vec<f64> = (found.list("sweep"))
        .map(|point| point.number("growth_rate_1_s"))
        .collect();
    let mut out = vec![over_factor(
        "Way of the tip from its place at load factor 0",
        "m",
        way,
    )];
    if squares.len() == t.len() {
        out.push(over_factor(
            "Smallest squared frequency: below zero the arm is unstable",
            "1/s\u{b2}",
            vec![curve("\u{3c9}\u{b2}", "z", t.clone(), squares)],
        ));
    }
    if growth.len() == t.len() && growth.iter().any(|rate| rate.is_finite()) {
        out.push(over_factor(
            "Rate at which deviations grow",
            "1/s",
            vec![curve("growth", "x", t.clone(), growth)],
        ));
    }
    out
}

/// Charts along the arm at load factor 1.
fn along_the_arm(rod: &Rod, record: &MotionRecord) -> Vec<ReportChart> {
    let Some(row) = record.t.iter().position(|factor| *factor == 1.0) else {
        return Vec::new();
    };
    let (positions, rotations) = pose(record, row);
    let mut edges = vec![0.0];
    let [mut curvature, mut force, mut moment] = [const { Vec::new() }; 3];
    for (q, element) in rod.elements.iter().enumerate() {
        let ends = Rod::element_pose(q, &positions, &rotations);
        let stress = ElementStress::of(element, rod.strain_rule, &ends);
        edges.push(edges[q] + element.length);
        curvature.push(rod.strain_rule.strain(element.length, &ends).curvature);
        force.push(stress.force);
        moment.push(stress.moment);
    }
    let chart = |title: &str, unit: &str, names: [&str; 3], values: &[nalgebra::Vector3<f64>]| {
        let largest = values
            .iter()
            .map(nalgebra::Vector3::amax)
            .fold(0.0, f64::max);
        let shown = |value: f64| {
            if value.abs() < ROUNDING * largest {
                0.0
            } else {
                value
            }
        };
        let series = (names.into_iter().zip(["x", "y", "z"]).enumerate())
            .map(|(axis, (name, color))| ReportCurve {
                hold: true,
                ..curve(
                    name,
                    color,
                    edges.clone(),
                    values.iter().map(|v| shown(v[axis])).collect(),
                )
            })
            .collect();
        ReportChart {
            section: "Along the arm at load factor 1".into(),
            title: title.into(),
            unit: unit.into(),
            x_name: "arc length".into(),
            x_unit: "m".into(),
            series,
        }
    };
    vec![
        chart(
            "Curvature and twist",
            "1/m",
            ["about d\u{2081}", "about d\u{2082}", "twist"],
            &curvature,
        ),
        chart(
            "Internal force",
            "N",
            ["shear along d\u{2081}", "shear along d\u{2082}", "tension"],
            &force,
        ),
        chart(
            "Internal moment",
            "N\u{b7}m",
            [
                "bending about d\u{2081}",
                "bending about d\u{2082}",
                "twisting",
            ],
            &moment,
        ),
    ]
}
