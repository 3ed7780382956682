//! The contents of the report page of a fit: the shapes at rest as frames, with their markers, and recordings as curves over time.

use std::path::Path;

use serde_json::{Value, json};

use super::{ROWS, arm, drawn_arm, words};
use crate::mechanics::Rod;
use crate::output::{
    Columns, MotionRecord, OutputError, ReportCommand, ReportData, ReportMark, ReportMotion,
    ResidualRow,
};
use crate::scene::Scene;
use crate::task::Arm;

/// Colors of markers in charts, in turn.
const COLORS: [&str; 6] = ["z", "x", "y", "violet", "target", "norm"];
/// Charts of places over time, at most.
const MOST_CHARTS: usize = 12;
/// Rows of the table of outliers, at most.
const MOST_OUTLIERS: usize = 30;

/// The page of a fit: `rod` has the fitted numbers, `shapes` are the shapes at rest with their numbers as times, `rows` the contents of
/// `residuals.csv`, and `summary` those of `summary.json`.
pub(crate) fn fit_page(
    scene: &Scene,
    own: &Arm,
    rod: &Rod,
    shapes: &MotionRecord,
    rows: &[ResidualRow],
    summary: &Value,
) -> Result<ReportData, OutputError> {
    let (resting, moving): (Vec<_>, Vec<_>) =
        (cases(summary, rows)?.into_iter()).partition(|case| case.at_rest);
    let mut columns = Columns::new();
    let charts = [
        over_shapes(&resting, summary, &mut columns),
        over_time(&moving, &mut columns),
    ];
    let outliers = (rows.iter().filter(|row| row.outlier)).map(|row| {
        let [measured, predicted] = row.places();
        json!({ "case": row.case, "marker": row.marker, "t": row.t_s, "measured": measured, "predicted": predicted, "off": row.off_m })
    });
    let context = json!({
        "summary": summary,
        "arm": arm::arm(own, rod, [usize::MAX; 2]),
        "limits": arm::names(&scene.limits()),
        "shapes": charts[0],
        "recordings": charts[1],
        "outliers": outliers.take(MOST_OUTLIERS).collect::<Vec<_>>(),
        "n_outliers": rows.iter().filter(|row| row.outlier).count(),
        "most_charts": MOST_CHARTS,
    });
    let words = words("fit.jinja", &context, &columns)?;
    let mut motion = ReportMotion::thinned(shapes, usize::MAX);
    let mut marks = Vec::new();
    for (frame, number) in shapes.t.iter().enumerate() {
        // Shapes are counted from one.
        let Some(case) = resting.get((number - 1.0) as usize) else {
            return Err(OutputError::malformed(
                Path::new("trajectory.npz"),
                format!("shape {number}; summary.json has {}", resting.len()),
            ));
        };
        motion.names.push(case.name.into());
        marks.extend(case.rows.iter().map(|row| {
            let [measured, predicted] = row.places();
            ReportMark {
                frame,
                name: row.marker.clone(),
                measured,
                predicted,
                outlier: row.outlier,
            }
        }));
    }
    let drawn = drawn_arm(own, rod);
    Ok(ReportData {
        marks,
        ..ReportData::of(ReportCommand::Fit, summary, words, drawn, motion)
    })
}

/// A shape or a recording with its places.
struct Case<'a> {
    name: &'a str,
    at_rest: bool,
    rows: &'a [ResidualRow],
}

/// Returns the cases of a summary with their rows of the table, which follow each other.
fn cases<'a>(summary: &'a Value, rows: &'a [ResidualRow]) -> Result<Vec<Case<'a>>, OutputError> {
    let mut left = rows;
    let mut out = Vec::new();
    for case in summary["cases"].as_array().into_iter().flatten() {
        let count = case["places"].as_u64().unwrap_or(0) as usize;
        let Some((rows, others)) = left.split_at_checked(count) else {
            return Err(OutputError::malformed(
                Path::new("residuals.csv"),
                "fewer rows than the places of summary.json",
            ));
        };
        left = others;
        out.push(Case {
            name: case["name"].as_str().unwrap_or_default(),
            at_rest: case["at_rest"] == true,
            rows,
        });
    }
    Ok(out)
}

/// Names of the markers in some rows, in the order in which they come.
fn markers<'a>(rows: impl Iterator<Item = &'a ResidualRow>) -> Vec<&'a str> {
    let mut out: Vec<&str> = Vec::new();
    for row in rows {
        if !out.contains(&row.marker.as_str()) {
            out.push(&row.marker);
        }
    }
    out
}

/// A column of numbers of some rows.
fn column<'a>(
    rows: impl Iterator<Item = &'a ResidualRow>,
    of: impl Fn(&ResidualRow) -> f64,
) -> Vec<f64> {
    rows.map(of).collect()
}

/// Distances of every marker over the number of the shape, with the distance from which places are outliers.
fn over_shapes(resting: &[Case], summary: &Value, columns: &mut Columns) -> Vec<Value> {
    let limit = summary["outliers_beyond_m"].as_f64().unwrap_or(f64::NAN);
    columns.insert("shape_ends".into(), vec![1.0, resting.len() as f64]);
    columns.insert("shape_limit".into(), vec![limit; 2]);
    let all = || (resting.iter()).flat_map(|case| case.rows.iter());
    let mut out = Vec::new();
    for (i, marker) in markers(all()).into_iter().enumerate() {
        let (mut numbers, mut off) = (Vec::new(), Vec::new());
        for (index, case) in resting.iter().enumerate() {
            for row in case.rows.iter().filter(|row| row.marker == marker) {
                numbers.push((index + 1) as f64);
                off.push(row.off_m);
            }
        }
        columns.insert(format!("shape_{i}"), numbers);
        columns.insert(format!("shape_off_{i}"), off);
        out.push(json!({ "name": marker, "color": COLORS[i % COLORS.len()], "key": i }));
    }
    out
}

/// Distances and places of the markers of every recording over time.
fn over_time(moving: &[Case], columns: &mut Columns) -> Vec<Value> {
    let mut n_charts = 0;
    let mut out = Vec::new();
    for (index, case) in moving.iter().enumerate() {
        let mut own = Vec::new();
        for (i, marker) in markers(case.rows.iter()).into_iter().enumerate() {
            let seen: Vec<&ResidualRow> =
                (case.rows.iter()).filter(|row| row.marker == marker).collect();
            let some = || seen.iter().copied().step_by(seen.len().div_ceil(ROWS).max(1));
            let key = format!("{index}_{i}");
            columns.insert(format!("t_{key}"), column(some(), |row| row.t_s));
            columns.insert(format!("off_{key}"), column(some(), |row| row.off_m));
            for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
                for (word, which) in [("measured", 0), ("predicted", 1)] {
                    let values = column(some(), |row| row.places()[which][axis]);
                    columns.insert(format!("{word}_{letter}_{key}"), values);
                }
            }
            n_charts += 1;
            own.push(json!({
                "name": marker,
                "color": COLORS[i % COLORS.len()],
                "key": key,
                "is_drawn": n_charts <= MOST_CHARTS,
            }));
        }
        out.push(json!({ "name": case.name, "markers": own }));
    }
    out
}
