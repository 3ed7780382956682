//! The data of a page that compares several results.

use serde::Serialize;
use serde_json::Value;

use super::{ReportCommand, ReportData, figure};

/// The content of the page of several results.
#[derive(Debug, Clone, Serialize)]
pub struct ComparisonData {
    /// Title of the page.
    pub title: String,
    /// The command, the same for all results.
    pub command: ReportCommand,
    /// The results.
    pub runs: Vec<ComparedRun>,
    /// Differences by section: scene and summaries.
    pub tables: Vec<ComparisonTable>,
    /// Computing time against error, where both are known.
    pub tradeoff: Vec<TradeoffPoint>,
}

/// One of several results.
#[derive(Debug, Clone, Serialize)]
pub struct ComparedRun {
    /// Name, different from that of the others.
    pub name: String,
    /// Its page.
    pub data: ReportData,
}

/// Differences between several results.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ComparisonTable {
    /// Heading.
    pub title: String,
    /// A key and its value in every result; with two results that are numbers, the relative change.
    pub rows: Vec<ComparisonRow>,
}

/// A key that differs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ComparisonRow {
    /// The key.
    pub key: String,
    /// Its value in every result.
    pub values: Vec<String>,
    /// Relative change from the first to the second of two.
    pub change: Option<String>,
}

/// A result as a point of a trade-off.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TradeoffPoint {
    /// Name of the result.
    pub name: String,
    /// Wall time in seconds.
    pub wall_s: f64,
    /// Estimated error of any node from elements and steps, in meters.
    pub error_m: f64,
    /// Tells whether no other result is both faster and more accurate.
    pub on_front: bool,
}

/// A result that is compared: its name, its summary, the text of its scene, and its page.
pub struct Compared {
    /// Name, different from that of the others.
    pub name: String,
    /// The contents of `summary.json`.
    pub summary: Value,
    /// The text of `scene.toml`.
    pub scene: String,
    /// Its page.
    pub data: ReportData,
}

/// Fields that come first, in this order; the others that differ follow in a table of their own.
const FIRST: [&str; 30] = [
    "status",
    "check.verdict",
    "objective",
    "iterations",
    "wall_s",
    "rms_m",
    "scatter_m",
    "tip_error_m",
    "tip_angle_rad",
    "tip_speed_m_s",
    "duration_s",
    "check.refined_time_m",
    "check.refined_space_m",
    "elements",
    "strain",
    "model",
    "step_s",
    "steps",
    "control_blocks",
    "variables",
    "samples",
    "overruns",
    "tip_error_over_length.rms",
    "tip_error_over_length.max",
    "sample_s.p50",
    "sample_s.p99",
    "energy_J.initial",
    "energy_J.final",
    "node_steps_per_s",
    "plant_elements",
];
/// Fields that say where a result is, and nothing about it.
const NOWHERE: [&str; 2] = ["directory", "scene"];

/// The page that compares results of one command.
#[must_use]
pub fn compare(command: ReportCommand, results: Vec<Compared>) -> ComparisonData {
    let summaries: Vec<Leaves> = (results.iter())
        .map(|result| leaves(&result.summary))
        .collect();
    let scenes: Vec<&str> = (results.iter())
        .map(|result| result.scene.as_str())
        .collect();
    let length = (results.iter())
        .map(|result| result.data.arm.length)
        .fold(0.0, f64::max);
    let shared = differences(&summaries, false, length);
    let (mut first, others): (Vec<_>, Vec<_>) =
        (shared.into_iter()).partition(|row| FIRST.contains(&row.key.as_str()));
    first.sort_by_key(|row| FIRST.iter().position(|key| *key == row.key));
    let tables = [
        ("Scenes", scene_differences(&scenes)),
        ("Results", first),
        ("Other fields of the summaries", others),
    ];
    let names: Vec<&str> = results.iter().map(|result| result.name.as_str()).collect();
    ComparisonData {
        title: names.join(" · "),
        command,
        tradeoff: tradeoff(&results),
        tables: (tables.into_iter())
            .filter(|(_, rows)| !rows.is_empty())
            .map(|(title, rows)| ComparisonTable {
                title: title.into(),
                rows,
            })
            .collect(),
        runs: (results.into_iter())
            .map(|result| ComparedRun {
                name: result.name,
                data: ReportData {
                    summary: Value::Null,
                    ..result.data
                },
            })
            .collect(),
    }
}

/// The keys in which the texts of several scenes differ.
pub fn scene_differences(scenes: &[&str]) -> Vec<ComparisonRow> {
    let scenes: Vec<Leaves> = (scenes.iter())
        .map(|text| {
            let table = text.parse::<toml::Table>().unwrap_or_default();
            leaves(&serde_json::to_value(table).unwrap_or_default())
        })
        .collect();
    differences(&scenes, true, 0.0)
}

/// Values by their dotted paths, in the order of the file.
type Leaves = Vec<(String, Value)>;

/// All that is neither an object nor a list of objects.
fn leaves(value: &Value) -> Leaves {
    fn walk(value: &Value, path: &str, out: &mut Leaves) {
        let join = |key: &str| match path {
            "" => key.to_string(),
            _ => format!("{path}.{key}"),
        };
        match value {
            Value::Object(fields) => {
                for (key, value) in fields {
                    walk(value, &join(key), out);
                }
            }
            Value::Array(items) if items.iter().any(Value::is_object) => {
                for (i, value) in items.iter().enumerate() {
                    walk(value, &join(&i.to_string()), out);
                }
            }
            _ => out.push((path.into(), value.clone())),
        }
    }
    let mut out = Vec::new();
    walk(value, "", &mut out);
    out
}

/// The keys whose values differ by more than rounding, that of lengths (m) by more than rounding of `length`; with `partial` also those
/// that only some results have.
fn differences(results: &[Leaves], partial: bool, length: f64) -> Vec<ComparisonRow> {
    let mut keys: Vec<&str> = Vec::new();
    for (key, _) in results.iter().flatten() {
        if !keys.contains(&key.as_str()) {
            keys.push(key);
        }
    }
    let of = |key: &str| -> Vec<Option<&Value>> {
        (results.iter())
            .map(|leaves| (leaves.iter()).find(|(k, _)| k == key).map(|(_, v)| v))
            .collect()
    };
    (keys.into_iter())
        .filter(|key| !NOWHERE.contains(key) && !is_detail(key))
        .map(|key| (key, of(key)))
        .filter(|(_, values)| partial || values.iter().all(Option::is_some))
        .filter(|(key, values)| {
            let least = ROUNDING * scale(key, results, length);
            (values.windows(2)).any(|pair| !are_alike(pair[0], pair[1], least))
        })
        .map(|(key, values)| ComparisonRow {
            key: key.into(),
            change: match values[..] {
                [Some(a), Some(b)] => change(a, b),
                _ => None,
            },
            values: values.into_iter().map(shown).collect(),
        })
        .collect()
}

/// Rows of the certificate and of its worst places, which the pages of the results show.
fn is_detail(key: &str) -> bool {
    [
        "check.criteria.",
        "check.kkt_parts.",
        "attempts.",
        "starts.",
        "worst_constraints.",
    ]
    .iter()
    .any(|list| key.starts_with(list))
}

fn shown(value: Option<&Value>) -> String {
    match value {
        None | Some(Value::Null) => "–".into(),
        Some(Value::String(text)) => text.clone(),
        Some(Value::Number(number)) => match number.as_u64() {
            Some(count) => count.to_string(),
            None => figure(number.as_f64().unwrap_or(f64::NAN), 5),
        },
        Some(Value::Array(items)) => {
            let mut parts: Vec<String> = (items.iter().take(6))
                .map(|item| shown(Some(item)))
                .collect();
            if items.len() > parts.len() {
                parts.push("…".into());
            }
            format!("[{}]", parts.join(", "))
        }
        Some(other) => other.to_string(),
    }
}

/// Relative difference of numbers that are the same but for rounding.
const ROUNDING: f64 = 1e-9;

/// The size beside which a number is rounding: of a length that of the arm, of an energy the largest of its kind.
fn scale(key: &str, results: &[Leaves], length: f64) -> f64 {
    if key.ends_with("_m") {
        return length;
    }
    let Some((kind, _)) = key
        .rsplit_once('.')
        .filter(|(kind, _)| kind.ends_with("_J"))
    else {
        return 0.0;
    };
    (results.iter().flatten())
        .filter(|(other, _)| other.starts_with(kind))
        .filter_map(|(_, value)| value.as_f64())
        .fold(0.0, |most, value| value.abs().max(most))
}

/// Tells whether values are the same but for rounding: differences of `least`, or small beside the largest number of a list, are none.
fn are_alike(a: Option<&Value>, b: Option<&Value>, least: f64) -> bool {
    let close = |a: f64, b: f64, size: f64| a == b || (a - b).abs() <= least.max(ROUNDING * size);
    let list = |value: Option<&Value>| -> Option<Vec<f64>> {
        (value?.as_array()?.iter()).map(Value::as_f64).collect()
    };
    if let (Some(a), Some(b)) = (a.and_then(Value::as_f64), b.and_then(Value::as_f64)) {
        return close(a, b, a.abs().max(b.abs()));
    }
    match (list(a), list(b)) {
        (Some(a), Some(b)) if a.len() == b.len() => {
            let size = a
                .iter()
                .chain(&b)
                .fold(0.0, |most: f64, v| v.abs().max(most));
            a.iter().zip(&b).all(|(a, b)| close(*a, *b, size))
        }
        _ => a == b,
    }
}

/// Returns the change of a number: in percent, or as a factor if it more than doubles or halves.
fn change(a: &Value, b: &Value) -> Option<String> {
    let (a, b) = (a.as_f64()?, b.as_f64()?);
    let ratio = b / a;
    if !ratio.is_finite() {
        return None;
    }
    Some(if (0.5..=2.0).contains(&ratio) {
        let percent = 100.0 * (ratio - 1.0);
        match percent.abs() {
            tiny if tiny < 1e-2 => "below 0.01 %".into(),
            _ if percent > 0.0 => format!("+{} %", figure(percent, 3)),
            _ => format!("{} %", figure(percent, 3)),
        }
    } else {
        format!("× {}", figure(ratio, 3))
    })
}

/// Wall time and estimated error of every result that has both.
fn tradeoff(results: &[Compared]) -> Vec<TradeoffPoint> {
    let mut points: Vec<TradeoffPoint> = (results.iter())
        .filter_map(|result| {
            let check = &result.summary["check"];
            let error = check["refined_time_m"].as_f64()? + check["refined_space_m"].as_f64()?;
            Some(TradeoffPoint {
                name: result.name.clone(),
                wall_s: result.summary["wall_s"].as_f64()?,
                error_m: error,
                on_front: true,
            })
        })
        .collect();
    let all: Vec<[f64; 2]> = points.iter().map(|p| [p.wall_s, p.error_m]).collect();
    for point in &mut points {
        point.on_front = !(all.iter()).any(|[wall, error]| {
            *wall <= point.wall_s
                && *error <= point.error_m
                && (*wall < point.wall_s || *error < point.error_m)
        });
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// The table has the differences only: of numbers with the change, of keys that one result lacks with a dash.
    #[test]
    fn differences_are_what_differs() {
        let of = |value: Value| leaves(&value);
        let a = of(json!({"a": 1.0, "b": {"c": 10, "d": [1, 2]}, "directory": "x", "only": true}));
        let b = of(json!({"a": 1.1, "b": {"c": 10, "d": [1, 3]}, "directory": "y"}));
        let rows = differences(&[a.clone(), b.clone()], true, 1.0);
        let keys: Vec<_> = rows.iter().map(|row| row.key.as_str()).collect();
        assert_eq!(keys, ["a", "b.d", "only"]);
        assert_eq!(rows[0].change.as_deref(), Some("+10 %"));
        assert_eq!(rows[1].values, ["[1, 2]", "[1, 3]"]);
        assert_eq!(rows[2].values, ["true", "–"]);
        assert_eq!(differences(&[a, b], false, 1.0).len(), 2);
        assert_eq!(change(&json!(2.0), &json!(0.5)).as_deref(), Some("× 0.25"));
        assert_eq!(change(&json!(0.0), &json!(0.5)), None);
        assert_eq!(
            change(&json!(1.0), &json!(1.00001)).as_deref(),
            Some("below 0.01 %")
        );
        let alike = |a: Value, b: Value| are_alike(Some(&a), Some(&b), 0.0);
        assert!(alike(json!(4.9), json!(4.9 * (1.0 + 1e-14))));
        assert!(!alike(json!(4.9), json!(4.9001)));
    }

    /// Differences within rounding of the arm's length, of the largest energy, or of the largest number of a list have no row.
    #[test]
    fn rounding_is_no_difference() {
        let of = |noise: f64| {
            leaves(&json!({
                "tip": {"position_m": [0.5, noise, 0.8]},
                "same_grid_m": noise,
                "energy_J": {"initial": noise, "max": 2.0},
            }))
        };
        assert_eq!(differences(&[of(3e-15), of(7e-16)], false, 1.0), []);
        let keys: Vec<String> = (differences(&[of(3e-6), of(7e-6)], false, 1.0).into_iter())
            .map(|row| row.key)
            .collect();
        assert_eq!(keys, ["tip.position_m", "same_grid_m", "energy_J.initial"]);
    }
}
