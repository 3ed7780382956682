//! The contents of the report page of a fit: the shapes at rest as frames, with their markers, and recordings as curves over time.

use std::path::Path;

use serde_json::{Value, json};

use super::{ROWS, add_components, arm, drawn_arm, words};
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
        json!({
            "case": row.case,
            "marker": row.marker,
            "t": row.t_s,
            "measured": row.measured(),
            "predicted": row.predicted(),
            "off": row.off_m,
            "turned": row.turned(),
        })
    });
    let context = json!({
        "summary": summary,
        "arm": arm::arm(own, rod, [usize::MAX; 2]),
        "limits": arm::names(&scene.limits()),
        "shapes": charts[0],
        "recordings": charts[1],
        "outliers": outliers.take(MOST_OUTLIERS).collect::<Vec<_>>(),
        "n_outliers": rows.iter().filter(|row| row.outlier).count(),
        "n_charts": columns.keys().filter(|name| name.starts_with("predicted_") && name.ends_with("_x")).count(),
        "most_charts": MOST_CHARTS,
        "turns": rows.iter().any(|row| row.turned().is_some()),
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
        marks.extend(case.rows.iter().filter_map(|row| {
            Some(ReportMark {
                frame,
                name: row.marker.clone(),
                measured: row.measured()?,
                predicted: row.predicted(),
                outlier: row.outlier,
            })
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

/// Distances and angles of every marker over the number of the shape, with those from which places and orientations are outliers.
fn over_shapes(resting: &[Case], summary: &Value, columns: &mut Columns) -> Vec<Value> {
    columns.insert("shape_ends".into(), vec![1.0, resting.len() as f64]);
    for unit in ["m", "rad"] {
        let limit = summary[format!("outliers_beyond_{unit}")].as_f64();
        columns.insert(format!("limit_{unit}"), vec![limit.unwrap_or(f64::NAN); 2]);
    }
    let rows = || {
        let numbered = resting.iter().zip(1_u32..);
        numbered.flat_map(|(case, number)| case.rows.iter().map(move |row| (number, row)))
    };
    let mut out = Vec::new();
    for (i, marker) in markers(rows().map(|(_, row)| row)).into_iter().enumerate() {
        let own: Vec<_> = rows().filter(|(_, row)| row.marker == marker).collect();
        let numbers = own.iter().map(|(number, _)| f64::from(*number)).collect();
        let key = format!("shape_{i}");
        add_residuals(columns, &key, numbers, own.iter().map(|(_, row)| *row));
        out.push(json!({ "name": marker, "color": COLORS[i % COLORS.len()], "key": key }));
    }
    out
}

/// Adds the columns of a marker: the abscissa, distances, and angles.
fn add_residuals<'a>(
    columns: &mut Columns,
    key: &str,
    abscissa: Vec<f64>,
    rows: impl Iterator<Item = &'a ResidualRow> + Clone,
) {
    let off = rows.clone().map(|row| row.off_m.unwrap_or(f64::NAN));
    let turned = rows.map(|row| row.turned().unwrap_or(f64::NAN));
    columns.insert(format!("off_{key}"), off.collect());
    columns.insert(format!("turned_{key}"), turned.collect());
    columns.insert(key.into(), abscissa);
}

/// Distances, angles and places of the markers of every recording over time.
fn over_time(moving: &[Case], columns: &mut Columns) -> Vec<Value> {
    let mut n_charts = 0;
    let mut out = Vec::new();
    for (index, case) in moving.iter().enumerate() {
        let mut own = Vec::new();
        for (i, marker) in markers(case.rows.iter()).into_iter().enumerate() {
            let seen: Vec<_> = (case.rows.iter())
                .filter(|row| row.marker == marker)
                .collect();
            let some = || (seen.iter().copied()).step_by(seen.len().div_ceil(ROWS).max(1));
            let key = format!("t_{index}_{i}");
            add_residuals(columns, &key, some().map(|row| row.t_s).collect(), some());
            let unseen = [f64::NAN; 3];
            let measured: Vec<_> = some().map(|row| row.measured().unwrap_or(unseen)).collect();
            let predicted: Vec<_> = some().map(ResidualRow::predicted).collect();
            add_components(columns, &format!("measured_{key}"), measured.iter());
            add_components(columns, &format!("predicted_{key}"), predicted.iter());
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
