//! Trade-offs read from their result directories: the page of one, and a page that compares several.

use std::path::Path;

use serde::Deserialize;
use serde_json::{Value, json};

use super::{BROAD, Chart, Curve, filled, has_place, milliseconds, page, picture, sentence};
use crate::output::{
    ComparisonRow, ComparisonTable, OutputError, PAGE_STYLE, read_text, scene_differences,
};
use crate::scene::LARGEST_SCENE;
use crate::tradeoff::{Point, Setting, Subject, Tradeoff};

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
            .filter(|point| point.on_front && has_place(point))
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
    let subject = (saved.first()).map_or(Subject::Motion, |saved| saved.found.subject);
    let curves = names.iter().zip(saved).map(|(name, saved)| Curve {
        name: name.clone(),
        points: saved.front(),
        tolerance: Some(saved.found.tolerance),
        recommended: saved.found.recommended.as_ref().map(|found| &found.point),
    });
    Chart {
        subject,
        curves: curves.collect(),
        tolerance: None,
        recommended: None,
        failed: Vec::new(),
    }
    .svg(BROAD)
}
