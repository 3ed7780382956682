//! The actuators in the arm as a page shows them: their lines, and their efforts over time beside the bounds.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::{FRAMES, ROWS};
use crate::mechanics::{Density, Rod, SAME_PLACE, StrainActuator};
use crate::output::{Columns, MotionRecord, ReportRoute};
use crate::solve::efforts::shape_of;
use crate::task::EffortControl;

/// Colors of curves by their names in the style sheet; a group with more curves begins anew.
const COLORS: [&str; 6] = ["x", "y", "z", "violet", "norm", "target"];

/// The actuators of a rod along a motion, for a page.
pub(super) struct Shown {
    /// Their lines and efforts in the picture.
    pub routes: Vec<ReportRoute>,
    /// Facts and curves, by kinds of actuators, for a template.
    pub groups: Value,
    /// Columns of the curves.
    pub columns: Columns,
}

/// Returns the efforts of all actuators of a rod for their inputs in a row of a record.
pub(super) fn of_inputs(
    rod: &Rod,
    record: &MotionRecord,
    row: usize,
    inputs: Vec<f64>,
) -> Vec<f64> {
    let shape = shape_of(record, row);
    rod.efforts_at(inputs, &shape.positions, &shape.rotations)
}

/// Returns the actuators on the strains of `rod` along a motion; `efforts` gives those of all in a row of the record, `controls` are those
/// with bounds. Of a winch, whose input is a displacement, the tension is shown, without bounds.
pub(super) fn shown(
    rod: &Rod,
    record: &MotionRecord,
    controls: &[EffortControl],
    efforts: &dyn Fn(usize) -> Vec<f64>,
) -> Shown {
    let mut columns = Columns::new();
    if rod.actuators.strains().is_empty() {
        return Shown {
            routes: Vec::new(),
            groups: Value::Array(Vec::new()),
            columns,
        };
    }
    let largest = rod.largest_efforts();
    let frames: Vec<Vec<f64>> = (record.thinned_rows(FRAMES).into_iter())
        .map(efforts)
        .collect();
    let rows = record.thinned_rows(ROWS);
    let curves: Vec<Vec<f64>> = rows.iter().map(|&row| efforts(row)).collect();
    let t: Vec<f64> = rows.iter().map(|&row| record.t[row]).collect();
    let ends: Vec<f64> = t.first().into_iter().chain(t.last()).copied().collect();
    columns.insert("effort_t".into(), t);
    columns.insert("effort_ends".into(), ends.clone());
    let mut routes = Vec::new();
    let mut groups: BTreeMap<usize, Vec<Value>> = BTreeMap::new();
    let mut bounds: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for (index, own) in rod.actuators.strains().iter().enumerate() {
        let column = |rows: &[Vec<f64>]| rows.iter().map(|row| row[index]).collect::<Vec<f64>>();
        let curve = column(&curves);
        let bound = (controls.iter())
            .find_map(|c| (c.actuator == index && own.winch.is_none()).then_some(c.bounds));
        let most = largest[index];
        // In words an effort that does not count is none.
        let told = |effort: f64| if is_slack(effort, most) { 0.0 } else { effort };
        let group = group(own.density);
        let members = groups.entry(group).or_default();
        let slack = curve
            .iter()
            .filter(|effort| is_slack(**effort, most))
            .count();
        members.push(json!({
            "name": own.name,
            "column": format!("effort_{index}"),
            "color": COLORS[members.len() % COLORS.len()],
            "from": own.route.from,
            "to": own.route.to,
            "offset": own.route.offset_from,
            "offset_to": own.route.offset_to,
            "turns": own.route.turns,
            "bounds": bound,
            "least": told(curve.iter().copied().fold(f64::INFINITY, f64::min)),
            "most": told(curve.iter().copied().fold(f64::NEG_INFINITY, f64::max)),
            "slack": slack as f64 / curve.len().max(1) as f64,
            "last": told(curve.last().copied().unwrap_or(0.0)),
        }));
        let limits = bounds.entry(group).or_default();
        for limit in bound
            .into_iter()
            .flatten()
            .filter(|limit| limit.is_finite())
        {
            if !limits.contains(&limit) {
                limits.push(limit);
            }
        }
        columns.insert(format!("effort_{index}"), curve);
        routes.push(route(rod, own, most, column(&frames)));
    }
    let groups = groups.into_iter().map(|(group, members)| {
        let (word, title) = WORDS[group];
        let limits: Vec<Value> = (bounds[&group].iter().enumerate())
            .map(|(i, limit)| {
                let column = format!("effort_bound_{group}_{i}");
                columns.insert(column.clone(), vec![*limit; ends.len()]);
                json!({ "column": column, "value": limit })
            })
            .collect();
        json!({
            "word": word,
            "title": title,
            "unit": UNITS[group],
            "members": members,
            "bounds": limits,
        })
    });
    let groups = groups.collect();
    Shown {
        routes,
        groups,
        columns,
    }
}

/// Words of the groups: of one actuator, and of their efforts.
const WORDS: [(&str, &str); 3] = [
    ("tendon", "Tensions"),
    ("chamber", "Pressures"),
    ("muscle", "Activations"),
];
/// Units of the efforts of the groups.
const UNITS: [&str; 3] = ["N", "Pa", ""];

/// Returns the group of an actuator among [`WORDS`].
fn group(density: Density) -> usize {
    match density {
        Density::Shortening | Density::Lengthening => 0,
        Density::Volume | Density::Braid { .. } => 1,
        Density::Muscle => 2,
    }
}

/// Part of the largest effort below which an actuator is slack: far above the tolerance of a solve, and not to be seen in a picture.
const SLACK: f64 = 1e-4;

/// Tells whether an actuator, whose largest effort is `most`, does nothing that counts.
fn is_slack(effort: f64, most: f64) -> bool {
    effort.abs() <= SLACK * most
}

/// Returns the line of an actuator through the nodes that it passes, with its effort at the frames of the picture.
fn route(rod: &Rod, own: &StrainActuator, most: f64, efforts: Vec<f64>) -> ReportRoute {
    let places = rod.places();
    let nodes: Vec<usize> = (0..places.len())
        .filter(|&q| {
            places[q] >= own.route.from - SAME_PLACE && places[q] <= own.route.to + SAME_PLACE
        })
        .collect();
    let length = rod.scales.length;
    ReportRoute {
        name: own.name.clone(),
        kind: WORDS[group(own.density)].0,
        first: nodes.first().copied().unwrap_or(0),
        offsets: (nodes.iter())
            .map(|&q| own.route.at(places[q], length).0.map(|part| part as f32))
            .collect(),
        radius: match own.density {
            // A chamber as wide as a circle of its area.
            Density::Volume | Density::Braid { .. } => (own.scale / std::f64::consts::PI).sqrt(),
            Density::Shortening | Density::Lengthening | Density::Muscle => 0.0,
        },
        slack: efforts
            .iter()
            .map(|effort| is_slack(*effort, most))
            .collect(),
        most,
        efforts: efforts.into_iter().map(|effort| effort as f32).collect(),
    }
}
