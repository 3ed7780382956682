//! The files that `softarm tradeoff` writes: summary, table of points, picture, page.

mod journal;
mod saved;

pub use self::journal::{Journal, journal_in};
pub use self::saved::{SavedTradeoff, tradeoff_comparison, tradeoff_tables};

use std::ops::Range;
use std::path::Path;

use plotters::coord::Shift;
use plotters::coord::combinators::WithKeyPoints;
use plotters::prelude::*;
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
const COLUMNS: [(&str, &str); 26] = [
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

/// Size of the picture, in its own units.
const SIZE: (u32, u32) = (960, 600);
/// Size for a narrow screen, on which the text keeps its size.
const NARROW: (u32, u32) = (420, 470);
/// Colors that most eyes can distinguish, on light and dark ground.
const COLORS: [RGBColor; 11] = [
    RGBColor(0x1f, 0x77, 0xb4),
    RGBColor(0xe6, 0x6a, 0x00),
    RGBColor(0x2c, 0x9f, 0x4b),
    RGBColor(0xc0, 0x3a, 0x8b),
    RGBColor(0x8c, 0x6b, 0xb1),
    RGBColor(0x9a, 0x6a, 0x3a),
    RGBColor(0x00, 0x9e, 0xa6),
    RGBColor(0xb0, 0x9b, 0x00),
    RGBColor(0xd6, 0x6d, 0x80),
    RGBColor(0x4a, 0x55, 0xd8),
    RGBColor(0x80, 0x80, 0x80),
];
const INK: RGBColor = RGBColor(0x78, 0x78, 0x78);
/// Radii of points and of the ring about the recommended one, in the units of [`SIZE`], and opacity of the lines between points.
const DOT: i32 = 5;
const RING: i32 = 12;
const FAINT: f64 = 0.7;
/// Factors on both coordinates of a point, on logarithmic axes, that give the place of a text beside it.
const BESIDE: [f64; 2] = [1.05, 1.07];

/// Returns the place of a text beside a point.
fn beside((x, y): (f64, f64)) -> (f64, f64) {
    (x * BESIDE[0], y * BESIDE[1])
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
    sized(found, usual, SIZE)
}

/// Draws the picture in a given size; a narrow picture has no legend, and [`legend`] is printed below it.
fn sized(found: &Tradeoff, usual: &Setting, size: (u32, u32)) -> Result<String, String> {
    let done = drawn(found);
    if done.is_empty() {
        return Err("no point has an error and a time".into());
    }
    let (errors, times) = errors_and_times(&done, &[found.tolerance]);
    let mut svg = String::new();
    draw(&mut svg, size, found, usual, &done, errors, times).map_err(|error| error.to_string())?;
    Ok(svg)
}

/// The points that have a place in the picture.
fn drawn(found: &Tradeoff) -> Vec<&Point> {
    (found.points.iter())
        .filter(|point| point.error.is_some_and(|e| e.is_finite() && e > 0.0))
        .filter(|point| point.time() > 0.0)
        .collect()
}

/// Ranges of the errors and tolerances, over the length, and of the times, in ms, with room around them.
fn errors_and_times(points: &[&Point], tolerances: &[f64]) -> (Range<f64>, Range<f64>) {
    let range = |values: &mut dyn Iterator<Item = f64>| {
        let (low, high) = values.fold((f64::INFINITY, 0.0_f64), |(low, high), v| {
            (low.min(v), high.max(v))
        });
        low / 1.6..high * 1.6
    };
    let errors = (points.iter().filter_map(|point| point.error)).chain(tolerances.iter().copied());
    let times = points.iter().map(|point| 1e3 * point.time());
    (range(&mut { errors }), range(&mut { times }))
}

/// Returns the titles of the horizontal and the vertical axis.
fn names_of_axes(subject: Subject) -> [&'static str; 2] {
    match subject {
        Subject::Motion => [
            "largest error of any place at any time / length",
            "processor time of the simulation, ms",
        ],
        Subject::OptimalControl => [
            "largest error of any place at any time / length",
            "processor time of the solve, ms",
        ],
        Subject::ClosedLoop => [
            "distance of the tip from its reference (rms) / length",
            "processor time of a sample, ms",
        ],
    }
}

/// Returns the families of points that differ in their elements only, in the order of the points.
fn families(done: &[&Point], usual: &Setting) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for point in done {
        let name = family(&point.setting, usual);
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names
}

/// Returns the color of a family.
fn color_of(index: usize) -> RGBColor {
    COLORS[index.min(COLORS.len() - 1)]
}

/// A chart of times over errors, both on logarithmic axes.
type Chart<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<Decades, Decades>>;
/// A logarithmic axis with ticks at powers of ten.
type Decades = WithKeyPoints<LogCoord<f64>>;

/// Returns the style of labels.
fn label() -> TextStyle<'static> {
    ("sans-serif", 15).into_font().color(&INK)
}

/// Draws the axes of a chart of times against errors.
fn axes<'a>(
    root: &DrawingArea<SVGBackend<'a>, Shift>,
    subject: Subject,
    errors: &Range<f64>,
    times: &Range<f64>,
) -> Result<Chart<'a>, Box<dyn std::error::Error>> {
    let [x_name, y_name] = names_of_axes(subject);
    let mut chart = ChartBuilder::on(root)
        .margin(14)
        .x_label_area_size(52)
        .y_label_area_size(74)
        .build_cartesian_2d(
            errors.clone().log_scale().with_key_points(decades(errors)),
            times.clone().log_scale().with_key_points(decades(times)),
        )?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(INK.mix(0.25))
        .axis_style(INK)
        .label_style(label())
        .x_label_formatter(&|value| format!("{value:e}"))
        .y_label_formatter(&|value| format!("{value}"))
        .x_desc(x_name)
        .y_desc(y_name)
        .axis_desc_style(label())
        .draw()?;
    Ok(chart)
}

fn draw(
    svg: &mut String,
    size: (u32, u32),
    found: &Tradeoff,
    usual: &Setting,
    done: &[&Point],
    errors: Range<f64>,
    times: Range<f64>,
) -> Result<(), Box<dyn std::error::Error>> {
    let root = SVGBackend::with_string(svg, size).into_drawing_area();
    let (right, top) = (errors.end, times.end);
    let mut chart = axes(&root, found.subject, &errors, &times)?;
    let text = label();
    chart.draw_series(LineSeries::new(
        [(found.tolerance, times.start), (found.tolerance, top)],
        INK.stroke_width(2),
    ))?;

    for (index, name) in families(done, usual).iter().enumerate() {
        let color = color_of(index);
        let mut own: Vec<&&Point> = (done.iter())
            .filter(|point| family(&point.setting, usual) == *name)
            .collect();
        own.sort_by_key(|point| point.setting.elements);
        let at = |point: &Point| (point.error.unwrap_or(right), 1e3 * point.time());
        chart
            .draw_series(LineSeries::new(
                own.iter().map(|point| at(point)),
                color.mix(FAINT).stroke_width(2),
            ))?
            .label(name.clone())
            .legend(move |(x, y)| Circle::new((x + 8, y), DOT, color.filled()));
        chart.draw_series(own.iter().map(|point| {
            let style = if point.on_front {
                color.filled()
            } else {
                color.stroke_width(1)
            };
            Circle::new(at(point), if point.on_front { 6 } else { 4 }, style)
        }))?;
        chart.draw_series(own.iter().filter(|point| point.on_front).map(|point| {
            let (x, y) = at(point);
            Text::new(
                point.setting.elements.to_string(),
                beside((x, y)),
                text.clone(),
            )
        }))?;
    }
    let failed = (found.points.iter())
        .filter(|point| point.status != Fate::Done && point.time() > 0.0)
        .map(|point| 1e3 * point.time());
    chart.draw_series(failed.filter(|t| times.contains(t)).map(|t| {
        Cross::new(
            (right / BESIDE[0], t),
            DOT,
            RGBColor(0xcc, 0x22, 0x22).stroke_width(2),
        )
    }))?;
    if let Some(recommended) = &found.recommended {
        let point = &recommended.point;
        chart.draw_series([Circle::new(
            (point.error.unwrap_or(right), 1e3 * point.time()),
            RING,
            RGBColor(0xcc, 0x22, 0x22).stroke_width(2),
        )])?;
    }
    if size == SIZE {
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .label_font(text)
            .border_style(INK.mix(0.4))
            .draw()?;
    }
    root.present()?;
    Ok(())
}

/// Returns the powers of ten in a range; also two and five times these if there are few.
fn decades(range: &Range<f64>) -> Vec<f64> {
    let powers = range.start.log10().floor() as i32..=range.end.log10().ceil() as i32;
    let wide = range.end / range.start > 1e3;
    let factors: &[f64] = if wide { &[1.0] } else { &[1.0, 2.0, 5.0] };
    powers
        .flat_map(|power| factors.iter().map(move |factor| factor * 10f64.powi(power)))
        .filter(|value| range.contains(value))
        .collect()
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
    let families: Vec<(String, [u8; 3])> = (families(&drawn(found), usual).into_iter().enumerate())
        .map(|(index, name)| {
            let RGBColor(r, g, b) = color_of(index);
            (name, [r, g, b])
        })
        .collect();
    filled(
        "page.html",
        &json!({
            "title": scene,
            "sentence": sentence,
            "style": PAGE_STYLE,
            "svg": svg,
            "narrow": sized(found, usual, NARROW).unwrap_or_default(),
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
const TEMPLATES: [(&str, &str); 2] = [
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
