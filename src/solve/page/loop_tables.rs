//! Tables and bars of the page of a closed loop: what is measured and estimated, the plant beside the model, and other laws.

use serde_json::Value;

use super::summary::{Fields, measure};
use super::words::{acting_facts, arm_facts};
use crate::mechanics::Rod;
use crate::output::{ReportBars, ReportTable, figure};
use crate::scene::ClosedLoopSetup;
use crate::task::Arm;

/// Section of other laws.
const LAWS: &str = "Other laws in the same loop";

/// The tables, none of what there is not.
pub(super) fn tables(setup: &ClosedLoopSetup) -> Vec<ReportTable> {
    [sensors(setup), Some(plant_beside_model(setup))]
        .into_iter()
        .flatten()
        .collect()
}

fn table(title: &str, heads: &[&str], rows: Vec<Vec<String>>) -> ReportTable {
    ReportTable {
        title: title.into(),
        heads: heads.iter().map(ToString::to_string).collect(),
        rows,
    }
}

/// What is measured by a sensor: the key of its standard deviation, its name, and its unit.
const MEASURED: [(&str, &str, &str); 7] = [
    ("position_sigma_m", "position", "m"),
    ("rotation_sigma_rad", "rotation", "rad"),
    ("velocity_sigma_m_s", "velocity", "m/s"),
    ("angular_velocity_sigma_rad_s", "angular velocity", "rad/s"),
    ("curvature_sigma_1_m", "curvature", "1/m"),
    ("base_force_sigma_n", "force of the base", "N"),
    ("base_moment_sigma_n_m", "moment of the base", "N\u{b7}m"),
];

/// The sensors and the estimator; `None` where the state is known.
fn sensors(setup: &ClosedLoopSetup) -> Option<ReportTable> {
    let scene = serde_json::to_value(&setup.resolved).unwrap_or_default();
    let estimator = &scene["estimator"];
    let kind = estimator["kind"].as_str()?;
    let title = "Sensors and estimator";
    let heads = ["", "what", "where", "how often", "how late"];
    if kind == "none" {
        let known = [
            "the true state",
            "is known at once",
            "all along the arm",
            "every sample",
            "0 s",
        ];
        return Some(table(title, &heads, vec![known.map(String::from).to_vec()]));
    }
    let list = |value: &Value| -> Vec<String> {
        let items = value.as_array().into_iter().flatten();
        items
            .map(|item| match item {
                Value::String(word) => word.replace('_', " "),
                other => figure(other.as_f64().unwrap_or(f64::NAN), 3),
            })
            .collect()
    };
    let mut rows: Vec<Vec<String>> = (scene["sensor"].as_array().into_iter().flatten())
        .enumerate()
        .map(|(index, sensor)| {
            let number = |key: &str| sensor[key].as_f64();
            let measured: Vec<String> = (MEASURED.iter())
                .filter_map(|(key, name, unit)| {
                    Some(match number(key)? {
                        0.0 => format!("{name}, exact"),
                        sigma => format!("{name} \u{b1} {}", measure(sigma, unit)),
                    })
                })
                .collect();
            let places = list(&sensor["places"]);
            let places = match (
                places.len(),
                measured.iter().any(|what| !what.contains("base")),
            ) {
                (0, _) | (_, false) => "at the base".into(),
                (n, _) if n > 6 => format!(
                    "{n} places from {} to {} of the length",
                    places[0],
                    places[n - 1]
                ),
                _ => format!("at {} of the length", places.join(", ")),
            };
            vec![
                format!("sensor {}", index + 1),
                measured.join("; "),
                places,
                number("rate_hz").map_or("–".into(), |rate| measure(rate, "Hz")),
                number("age_s").map_or("–".into(), |age| measure(age, "s")),
            ]
        })
        .collect();
    let unknowns = list(&estimator["disturbances"]);
    let name = match kind {
        "kalman" => "extended Kalman filter",
        other => other,
    };
    let finds = match unknowns.is_empty() {
        true => "the state".into(),
        false => format!("the state, and {}", unknowns.join(", ")),
    };
    let elements = estimator["elements"].as_u64();
    let elements = elements.map_or(String::new(), |n| format!("a model of {n} elements"));
    rows.push(vec![
        name.into(),
        finds,
        elements,
        "every sample".into(),
        String::new(),
    ]);
    Some(table(title, &heads, rows))
}

/// What the arm is, beside what the controller takes it to be: only where they differ.
fn plant_beside_model(setup: &ClosedLoopSetup) -> ReportTable {
    let own = &setup.experiment;
    let facts = |arm: &Arm, rod: &Rod, delay: f64, lag: f64| -> Vec<(String, String)> {
        let mut out = arm_facts(arm, rod);
        out.extend(acting_facts(arm, &[], &[], [usize::MAX; 2]));
        out.push(("delay of commands".into(), measure(delay, "s")));
        out.push(("lag of actuators".into(), measure(lag, "s")));
        out
    };
    let known = own.settings.actuator_delay;
    let model = facts(&own.arm, &setup.model, known, 0.0);
    let plant = facts(
        &own.plant,
        &setup.plant,
        own.actuators.delay,
        own.actuators.lag,
    );
    let mut names: Vec<&String> = Vec::new();
    for (name, _) in model.iter().chain(&plant) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let value = |facts: &[(String, String)], name: &str| -> String {
        let found: Vec<&str> = (facts.iter())
            .filter(|(other, _)| other == name)
            .map(|(_, value)| value.as_str())
            .collect();
        match found.is_empty() {
            true => "–".into(),
            false => found.join("; "),
        }
    };
    let mut rows: Vec<Vec<String>> = (names.into_iter())
        .map(|name| vec![name.clone(), value(&model, name), value(&plant, name)])
        .filter(|row| row[1] != row[2])
        .collect();
    if own.adjust.is_some() {
        rows.push(vec![
            "rod".into(),
            "as described".into(),
            "changed by a program".into(),
        ]);
    }
    if rows.is_empty() {
        let same = ["everything", "as the arm is", "as the model is"];
        rows.push(same.map(String::from).to_vec());
    }
    table(
        "The arm as it is, beside the model",
        &["", "the controller's model", "the arm as it is"],
        rows,
    )
}

/// How far the tip is off under this law and under others; nothing without others.
pub(super) fn baselines(summary: Fields) -> Vec<ReportBars> {
    let Some(others) = summary
        .get("baselines")
        .as_object()
        .filter(|all| !all.is_empty())
    else {
        return Vec::new();
    };
    let own = (String::from("this controller"), summary, String::new());
    let others = (others.iter()).map(|(name, value)| {
        let found = Fields(value);
        let status = match found.text("status") {
            "completed" => String::new(),
            status => format!(", {status}"),
        };
        (name.replace('_', " "), found, status)
    });
    let bars = std::iter::once(own)
        .chain(others)
        .map(|(name, found, status)| {
            let rms = 100.0 * found.number("tip_error_over_length.rms");
            let most = 100.0 * found.number("tip_error_over_length.max");
            let words = format!(
                "{} %, {} % at most{status}",
                figure(rms, 3),
                figure(most, 3)
            );
            (name, rms, words)
        })
        .collect();
    vec![ReportBars {
        section: LAWS.into(),
        title: "Distance of the tip from its reference over the length, rms".into(),
        bars,
        note: "All laws drive the same arm with the same sensors from the same start.".into(),
    }]
}
