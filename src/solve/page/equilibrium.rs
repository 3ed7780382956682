//! The contents of the report page of statics: the sweep as a motion whose clock is the load factor.

use serde_json::{Value, json};

use super::fields::pose;
use super::obstacles::obstacles;
use super::{FRAMES, ROWS, add_components, arm, arrows, drawn_arm, fields, sizes, words};
use crate::mechanics::diagnostics::ElementStress;
use crate::mechanics::{Rod, Varied};
use crate::output::{
    Columns, MotionRecord, OutputError, ReportCommand, ReportData, ReportEnergy, ReportMotion,
};
use crate::scene::Scene;
use crate::task::Arm;

/// The page of the statics of an arm; `rod` is under the loads at factor 1, the rows of `record` are the sweep, and `summary` is the contents of
/// `summary.json`.
pub(crate) fn equilibrium_page(
    scene: &Scene,
    own: &Arm,
    rod: &Rod,
    record: &MotionRecord,
    summary: &Value,
) -> Result<ReportData, OutputError> {
    let last = record.t.last().copied().unwrap_or(1.0);
    let varied = (summary["varied"].as_str())
        .and_then(Varied::named)
        .unwrap_or_default();
    let loaded = over_factors(rod, varied, number(&summary["time_s"]), last);
    let mut forces = arrows::given(&loaded, record, |_| arrows::LOAD);
    if varied != Varied::Loads {
        let rows = record.thinned_rows(FRAMES);
        for arrow in forces.iter_mut().filter(|arrow| !arrow.at.is_empty()) {
            for (vector, &row) in arrow.vectors.iter_mut().zip(&rows) {
                *vector = vector.map(|part| part * record.t[row] as f32);
            }
            arrow.peak *= last;
        }
    }
    let mut images = fields::fields(&loaded, record);
    if let Some(images) = &mut images {
        images.fields.retain(|field| field.name != "speed");
    }
    let mut columns = over_the_factor(record, summary);
    columns.extend(along_the_arm(rod, record));
    let context = json!({
        "summary": summary,
        "arm": arm::arm(own, rod, [usize::MAX; 2]),
        "limits": arm::names(&scene.limits()),
        "varied": varied.words(),
    });
    let words = words("equilibrium.jinja", &context, &columns)?;
    let motion = ReportMotion::thinned(record, FRAMES);
    Ok(ReportData {
        arrows: forces,
        fields: images,
        obstacles: obstacles(&[], rod, &[], record),
        energy: Some(ReportEnergy::thinned(record, ROWS)),
        ..ReportData::of(
            ReportCommand::Equilibrium,
            summary,
            words,
            drawn_arm(own, rod),
            motion,
        )
    })
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
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

/// Over the load factor: the way of the tip, and the stability.
fn over_the_factor(record: &MotionRecord, summary: &Value) -> Columns {
    let tip = record.n_nodes - 1;
    let start = record.position(0, tip);
    let way: Vec<[f64; 3]> = (0..record.n_rows())
        .map(|row| (record.position(row, tip) - start).into())
        .collect();
    let mut out = Columns::from([
        ("factor".into(), record.t.clone()),
        ("way".into(), sizes(&way)),
    ]);
    add_components(&mut out, "way", way.iter());
    let sweep = summary["sweep"].as_array();
    if let Some(points) = sweep.filter(|points| points.len() == record.n_rows()) {
        for (name, key) in [
            ("squared_frequency", "squared_frequency_1_s2"),
            ("growth", "growth_rate_1_s"),
        ] {
            let values = points.iter().map(|point| number(&point[key])).collect();
            out.insert(name.into(), values);
        }
    }
    out
}

/// Fraction of the largest of some numbers below which another one is its rounding.
const ROUNDING: f64 = 1e-9;

/// Along the arm at load factor 1: edges of the elements, curvature, force and moment of each.
fn along_the_arm(rod: &Rod, record: &MotionRecord) -> Columns {
    let Some(row) = record.t.iter().position(|factor| *factor == 1.0) else {
        return Columns::new();
    };
    let (positions, rotations) = pose(record, row);
    let mut edges = vec![0.0];
    let [mut curvature, mut force, mut moment] = [const { Vec::<[f64; 3]>::new() }; 3];
    for (q, element) in rod.elements.iter().enumerate() {
        let ends = Rod::element_pose(q, &positions, &rotations);
        let stress = ElementStress::of(element, rod.strain_rule, &ends);
        edges.push(edges[q] + element.length);
        curvature.push(
            rod.strain_rule
                .strain(element.length, &ends)
                .curvature
                .into(),
        );
        force.push(stress.force.into());
        moment.push(stress.moment.into());
    }
    let mut out = Columns::from([("edge".into(), edges)]);
    for (name, mut vectors) in [
        ("curvature", curvature),
        ("force", force),
        ("moment", moment),
    ] {
        let largest = (vectors.iter().flatten()).fold(0.0, |most: f64, v| most.max(v.abs()));
        for value in vectors.iter_mut().flatten() {
            if value.abs() < ROUNDING * largest {
                *value = 0.0;
            }
        }
        add_components(&mut out, name, vectors.iter());
    }
    out
}
