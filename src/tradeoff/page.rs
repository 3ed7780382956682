//! The files that `softarm tradeoff` writes: summary, table of points, picture, page.

mod chart;
mod journal;
mod saved;

use self::chart::{BROAD, Chart, Curve, NARROW, color_of, has_place};
pub use self::journal::{Journal, journal_in};
pub use self::saved::{SavedTradeoff, tradeoff_comparison, tradeoff_tables};

use std::path::Path;

use serde::Serialize;
use serde_json::{Value, json};

use super::{Fate, FeatureCost, Point, Recommendation, Setting, Subject, Tradeoff};
use crate::output::{OutputError, PAGE_STYLE, figure, fill, json_value};

/// `summary.json` of `softarm tradeoff`.
#[derive(Debug, Serialize)]
pub struct TradeoffSummary<'a> {
    /// [`SCHEMA_VERSION`](crate::output::summary::SCHEMA_VERSION)
    pub schema_version: u32,
    /// [`TOOL`](crate::output::summary::TOOL)
    pub tool: &'static str,
    /// `tradeoff`
    pub command: &'static str,
    /// Name of the scene.
    pub scene: &'a str,
    /// `completed`, `cut` by the budget, `interrupted`, or `deadline`.
    pub status: &'static str,
    /// The budget, s.
    pub budget_s: f64,
    /// Wall time, s.
    pub wall_s: f64,
    /// Result of the sweep.
    #[serde(flatten)]
    pub found: &'a Tradeoff,
    /// The setting of the scene itself.
    pub usual: &'a Setting,
    /// The result directory.
    pub directory: String,
}

/// Writes `points.csv`: one row for each setting, in the order in which they were run.
pub fn write_points(path: &Path, points: &[Point]) -> Result<(), OutputError> {
    let text = table(points).map_err(|error| OutputError::malformed(path, error.to_string()))?;
    std::fs::write(path, text).map_err(OutputError::unwritten(path, "cannot write"))
}

/// Columns of `points.csv`: their names, and their places in the JSON of a point.
const COLUMNS: [(&str, &str); 27] = [
    ("elements", "/elements"),
    ("strain", "/strain"),
    ("integrator", "/integrator"),
    ("step_s", "/step_s"),
    ("rotary_inertia", "/rotary_inertia"),
    ("model", "/model"),
    ("blocks", "/blocks"),
    ("hold", "/hold"),
    ("tolerance", "/tolerance"),
    ("hessian", "/hessian"),
    ("horizon_s", "/horizon_s"),
    ("block_s", "/block_s"),
    ("terminal_cost", "/terminal_cost"),
    ("iterations", "/iterations"),
    ("estimator", "/estimator"),
    ("status", "/status"),
    ("error", "/error"),
    ("error_bar", "/error_bars/shape"),
    ("tip_end", "/errors/tip_end"),
    ("tip", "/errors/tip"),
    ("orientation_rad", "/errors/orientation_rad"),
    ("energy", "/errors/energy"),
    ("curvature", "/errors/curvature"),
    ("objective", "/objective"),
    ("wall_s", "/wall_s"),
    ("memory_mb", "/memory_mb"),
    ("on_front", "/on_front"),
];

fn table(points: &[Point]) -> Result<Vec<u8>, csv::Error> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(COLUMNS.map(|(name, _)| name))?;
    for point in points {
        let point = json_value(point);
        writer.write_record(COLUMNS.map(|(_, place)| match point.pointer(place) {
            Some(Value::String(word)) => word.clone(),
            Some(Value::Null) | None => String::new(),
            Some(other) => other.to_string(),
        }))?;
    }
    writer.flush()?;
    Ok(writer.into_inner().unwrap_or_default())
}

/// Describes the differences between a setting and the usual one, except for the elements.
fn family(setting: &Setting, usual: &Setting) -> String {
    let own = Setting {
        elements: usual.elements,
        ..setting.clone()
    };
    let words = own.differences(usual);
    match words.split_once(", ") {
        Some((_, rest)) => rest.into(),
        None => "as the scene".into(),
    }
}

/// Draws error and time of all points on logarithmic axes: families that differ in their elements only are lines, the front is marked, and
/// points without an error are at the right edge.
///
/// # Errors
/// Returns a sentence if the picture cannot be drawn.
pub fn picture(found: &Tradeoff, usual: &Setting) -> Result<String, String> {
    chart(found, usual).svg(BROAD)
}

/// Returns the picture of a trade-off: a curve for each family of points that differ in their elements only, in the order of the points.
fn chart<'a>(found: &'a Tradeoff, usual: &Setting) -> Chart<'a> {
    let mut curves: Vec<Curve> = Vec::new();
    for point in found.points.iter().filter(|point| has_place(point)) {
        let name = family(&point.setting, usual);
        match curves.iter_mut().find(|curve| curve.name == name) {
            Some(curve) => curve.points.push(point),
            None => curves.push(Curve {
                name,
                points: vec![point],
                tolerance: None,
                recommended: None,
            }),
        }
    }
    for curve in &mut curves {
        curve.points.sort_by_key(|point| point.setting.elements);
    }
    let failed = |point: &&Point| point.status != Fate::Done && point.time() > 0.0;
    Chart {
        subject: found.subject,
        curves,
        tolerance: Some(found.tolerance),
        recommended: found.recommended.as_ref().map(|found| &found.point),
        failed: found.points.iter().filter(failed).collect(),
    }
}

/// Describes the recommended setting in a sentence.
#[must_use]
pub fn sentence(found: &Tradeoff, usual: &Setting) -> String {
    let tolerance = found.tolerance;
    match &found.recommended {
        Some(Recommendation {
            point,
            checked_error,
            checked,
        }) => format!(
            "Recommended for {tolerance:e} of the length: {}, which takes {} and has an error of {:.1e} ({}: {checked_error:.1e}, {}).",
            point.setting.differences(usual),
            milliseconds(point.time()),
            point.error.unwrap_or(f64::NAN),
            match found.subject {
                Subject::ClosedLoop => "against an arm with twice the elements",
                _ => "against a run finer by four in space and time",
            },
            if *checked {
                "within the tolerance"
            } else {
                "NOT within the tolerance"
            }
        ),
        None => format!("No setting is recommended for {tolerance:e} of the length."),
    }
}

/// The page of a trade-off, which opens without a network.
///
/// # Errors
/// [`OutputError`] where the template cannot use what was found.
pub fn page(
    scene: &str,
    found: &Tradeoff,
    usual: &Setting,
    sentence: &str,
    svg: &str,
) -> Result<String, OutputError> {
    let recommended = found.recommended.as_ref().map(|found| &found.point);
    let mut points: Vec<&Point> = found.points.iter().collect();
    points.sort_by(|a, b| a.time().total_cmp(&b.time()));
    let points: Vec<Value> = (points.into_iter())
        .map(|point| {
            json!({
                "setting": point.setting.differences(usual),
                "keys": point.assignments(usual),
                "time": milliseconds(point.time()),
                "error": point.error,
                "why": point.why,
                "objective": point.objective,
                "on_front": point.on_front,
                "recommended": recommended.is_some_and(|found| found.setting == point.setting),
            })
        })
        .collect();
    let chart = chart(found, usual);
    let families: Vec<(&str, &str)> = (chart.curves.iter().enumerate())
        .map(|(index, curve)| (curve.name.as_str(), color_of(index)))
        .collect();
    filled(
        "page.html",
        &json!({
            "title": scene,
            "sentence": sentence,
            "style": PAGE_STYLE,
            "svg": svg,
            "narrow": chart.svg(NARROW).unwrap_or_default(),
            "families": families,
            "keys": recommended.map(|point| point.assignments(usual)),
            "subject": found.subject,
            "reference": found.reference,
            "findings": found.findings,
            "models": found.models,
            "features": found.features,
            "ratios": found.features.iter().map(FeatureCost::ratio_in_words).collect::<Vec<_>>(),
            "points": points,
        }),
    )
}

/// The templates by their names.
const TEMPLATES: [(&str, &str); 3] = [
    ("chart.html", include_str!("page/chart.html")),
    ("page.html", include_str!("page/page.html")),
    ("comparison.html", include_str!("page/comparison.html")),
];

fn filled(template: &str, context: &Value) -> Result<String, OutputError> {
    let malformed = |error| OutputError::malformed(Path::new("summary.json"), error);
    fill(&TEMPLATES, template, context).map_err(|error| malformed(format!("{error:#}")))
}

fn milliseconds(seconds: f64) -> String {
    if seconds.is_finite() {
        format!("{} ms", figure(1e3 * seconds, 3))
    } else {
        String::new()
    }
}
