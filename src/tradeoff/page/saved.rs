//! Trade-offs read from their result directories: the page of one, and a page that compares several.

use std::ops::Range;
use std::path::Path;

use plotters::prelude::*;
use serde::Deserialize;
use serde_json::{Value, json};

use super::{
    COLORS, DOT, FAINT, INK, RING, SIZE, axes, beside, errors_and_times, filled, label,
    milliseconds, page, picture, sentence,
};
use crate::output::{
    ComparisonRow, ComparisonTable, OutputError, PAGE_STYLE, read_text, scene_differences,
};
use crate::scene::LARGEST_SCENE;
use crate::tradeoff::{Point, Setting, Tradeoff};

/// A trade-off read from a result directory.
#[derive(Debug, Deserialize)]
pub struct SavedTradeoff {
    /// Name of the scene.
    pub scene: String,
    /// Result of the sweep.
    #[serde(flatten)]
    pub found: Tradeoff,
    /// The setting of the scene itself.
    pub usual: Setting,
    /// The text of `scene.toml`.
    #[serde(skip)]
    pub text: String,
}

impl SavedTradeoff {
    /// Reads the trade-off of a result directory with the given summary.
    ///
    /// # Errors
    /// Returns [`OutputError`] if the summary lacks a field or the scene is missing.
    pub fn read(directory: &Path, summary: Value) -> Result<Self, OutputError> {
        let path = directory.join("summary.json");
        let saved: Self = serde_json::from_value(summary)
            .map_err(|error| OutputError::malformed(&path, error.to_string()))?;
        if let Some(fault) = saved.found.fault() {
            return Err(OutputError::malformed(&path, fault));
        }
        let text = read_text(&directory.join("scene.toml"), LARGEST_SCENE)?;
        Ok(Self { text, ..saved })
    }

    /// The page that the run wrote.
    ///
    /// # Errors
    /// As [`page`].
    pub fn page(&self) -> Result<String, OutputError> {
        let svg = picture(&self.found, &self.usual).unwrap_or_default();
        let sentence = sentence(&self.found, &self.usual);
        page(&self.scene, &self.found, &self.usual, &sentence, &svg)
    }

    /// Returns the points of the front, the fastest first.
    fn front(&self) -> Vec<&Point> {
        let mut front: Vec<&Point> = (self.found.points.iter())
            .filter(|point| point.on_front && point.error.is_some_and(|error| error > 0.0))
            .filter(|point| point.time() > 0.0)
            .collect();
        front.sort_by(|a, b| a.time().total_cmp(&b.time()));
        front
    }
}

/// Returns tables of the recommendations of several trade-offs and of the differences between their scenes.
#[must_use]
pub fn tradeoff_tables(saved: &[SavedTradeoff]) -> Vec<ComparisonTable> {
    type Of = fn(&SavedTradeoff) -> Option<String>;
    let rows: [(&str, Of); 8] = [
        ("scene", |saved| Some(saved.scene.clone())),
        ("tolerance", |saved| {
            Some(format!("{:e}", saved.found.tolerance))
        }),
        ("setting", |saved| {
            let recommended = saved.found.recommended.as_ref()?;
            Some(recommended.point.setting.differences(&saved.usual))
        }),
        ("time", |saved| {
            Some(milliseconds(saved.found.recommended.as_ref()?.point.time()))
        }),
        ("error", |saved| {
            let error = saved.found.recommended.as_ref()?.point.error?;
            Some(format!("{error:.2e}"))
        }),
        ("error when checked", |saved| {
            let recommended = saved.found.recommended.as_ref()?;
            Some(format!("{:.2e}", recommended.checked_error))
        }),
        ("within the tolerance", |saved| {
            let checked = saved.found.recommended.as_ref()?.checked;
            Some(if checked { "yes" } else { "no" }.into())
        }),
        ("settings tried", |saved| {
            Some(saved.found.points.len().to_string())
        }),
    ];
    let recommendations = rows.map(|(key, of)| ComparisonRow {
        key: key.into(),
        values: (saved.iter())
            .map(|saved| of(saved).unwrap_or_else(|| "–".into()))
            .collect(),
        change: None,
    });
    let scenes: Vec<&str> = saved.iter().map(|saved| saved.text.as_str()).collect();
    let differences = scene_differences(&scenes);
    let mut tables = vec![ComparisonTable {
        title: "Recommendations".into(),
        rows: recommendations.into(),
    }];
    if !differences.is_empty() {
        tables.push(ComparisonTable {
            title: "Scenes".into(),
            rows: differences,
        });
    }
    tables
}

/// The page of several trade-offs of one kind: their fronts in one picture, their recommendations in one table.
///
/// # Errors
/// As [`page`].
pub fn tradeoff_comparison(
    names: &[String],
    saved: &[SavedTradeoff],
) -> Result<String, OutputError> {
    filled(
        "comparison.html",
        &json!({
            "names": names,
            "tables": tradeoff_tables(saved),
            "svg": fronts(names, saved).unwrap_or_default(),
            "style": PAGE_STYLE,
        }),
    )
}

/// Draws the fronts of several trade-offs.
///
/// # Errors
/// Returns a sentence if there is none to draw.
fn fronts(names: &[String], saved: &[SavedTradeoff]) -> Result<String, String> {
    let all: Vec<&Point> = saved.iter().flat_map(SavedTradeoff::front).collect();
    if all.is_empty() {
        return Err("no front has a point".into());
    }
    let tolerances: Vec<f64> = saved.iter().map(|saved| saved.found.tolerance).collect();
    let (errors, times) = errors_and_times(&all, &tolerances);
    let mut svg = String::new();
    draw(&mut svg, names, saved, errors, times).map_err(|error| error.to_string())?;
    Ok(svg)
}

fn draw(
    svg: &mut String,
    names: &[String],
    saved: &[SavedTradeoff],
    errors: Range<f64>,
    times: Range<f64>,
) -> Result<(), Box<dyn std::error::Error>> {
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    let mut chart = axes(&root, saved[0].found.subject, &errors, &times)?;
    let text = label();
    let at = |point: &Point| (point.error.unwrap_or(errors.end), 1e3 * point.time());
    for (index, (name, saved)) in names.iter().zip(saved).enumerate() {
        let color = COLORS[index.min(COLORS.len() - 1)];
        let front = saved.front();
        let tolerance = saved.found.tolerance;
        chart.draw_series(LineSeries::new(
            [(tolerance, times.start), (tolerance, times.end)],
            color.mix(0.5).stroke_width(1),
        ))?;
        chart
            .draw_series(LineSeries::new(
                front.iter().map(|point| at(point)),
                color.mix(FAINT).stroke_width(2),
            ))?
            .label(name.clone())
            .legend(move |(x, y)| Circle::new((x + 8, y), DOT, color.filled()));
        chart
            .draw_series((front.iter()).map(|point| Circle::new(at(point), DOT, color.filled())))?;
        chart.draw_series(front.iter().map(|point| {
            let elements = point.setting.elements.to_string();
            Text::new(elements, beside(at(point)), text.clone())
        }))?;
        if let Some(recommended) = &saved.found.recommended {
            let ring = color.stroke_width(2);
            chart.draw_series([Circle::new(at(&recommended.point), RING, ring)])?;
        }
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .label_font(text)
        .border_style(INK.mix(0.4))
        .draw()?;
    root.present()?;
    Ok(())
}
