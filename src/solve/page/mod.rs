//! The contents of report pages: of a solve, a simulation, a closed loop, and of the files of any of them.
//!
//! What a page says stands in the templates beside this file; the code gathers what they speak of, and the arrays that are drawn.

mod arm;
mod arrows;
#[cfg(feature = "cli")]
mod closed_loop;
mod efforts;
#[cfg(feature = "cli")]
mod equilibrium;
mod fields;
#[cfg(feature = "cli")]
mod findings;
#[cfg(feature = "cli")]
mod fit;
mod obstacles;
mod reaction;
#[cfg(feature = "cli")]
mod saved;
#[cfg(feature = "cli")]
mod simulation;
mod solve;

pub(super) use self::solve::{SolvePage, iteration, sensitivity, solve_page};
#[cfg(feature = "cli")]
pub(crate) use self::{
    closed_loop::closed_loop_page,
    equilibrium::equilibrium_page,
    findings::findings,
    fit::fit_page,
    saved::{SavedError, SavedPage, saved_page},
    simulation::simulation_page,
};

use std::path::Path;

use nalgebra::Vector3;
use serde_json::Value;

use crate::mechanics::{BaseCondition, Rod};
use crate::output::{Columns, OutputError, ReportArm, Words};
use crate::task::Arm;

/// Frames of the picture.
const FRAMES: usize = 240;
/// Points of a curve over the rows of a motion.
const ROWS: usize = 600;

/// The templates by their names.
const TEMPLATES: [(&str, &str); 6] = [
    ("arm.jinja", include_str!("arm.jinja")),
    ("closed_loop.jinja", include_str!("closed_loop.jinja")),
    ("equilibrium.jinja", include_str!("equilibrium.jinja")),
    ("fit.jinja", include_str!("fit.jinja")),
    ("simulation.jinja", include_str!("simulation.jinja")),
    ("solve.jinja", include_str!("solve.jinja")),
];

/// Returns the words of a page from `context` and `columns`; a context that a template cannot use is reported as a malformed summary.
fn words(template: &str, context: &Value, columns: &Columns) -> Result<Words, OutputError> {
    Words::of(&TEMPLATES, template, context, columns)
        .map_err(|error| OutputError::malformed(Path::new("summary.json"), format!("{error:#}")))
}

/// Adds the components of vectors, as columns `name_x`, `name_y`, `name_z`.
fn add_components<'a>(
    columns: &mut Columns,
    name: &str,
    vectors: impl Iterator<Item = &'a [f64; 3]> + Clone,
) {
    for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
        let values = vectors.clone().map(|vector| vector[axis]).collect();
        columns.insert(format!("{name}_{letter}"), values);
    }
}

/// Euclidean norms.
fn sizes(vectors: &[[f64; 3]]) -> Vec<f64> {
    (vectors.iter())
        .map(|vector| Vector3::from(*vector).norm())
        .collect()
}

fn drawn_arm(arm: &Arm, rod: &Rod) -> ReportArm {
    ReportArm {
        radius: arm.radii_at_nodes(&rod.mesh),
        base: (rod.base == BaseCondition::Clamped).then(|| rod.rest.positions[0].into()),
        gravity: rod.gravity.into(),
        length: rod.scales.length,
        payload: arm.payload.map_or(0.0, |payload| payload.mass),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every page can be made of an arm and a summary that lacks everything.
    #[test]
    fn pages_need_no_field() {
        let names = [
            "t",
            "error",
            "turn",
            "tip_x",
            "tip_y",
            "tip_z",
            "factor",
            "way",
            "way_x",
            "way_y",
            "way_z",
            "sample_ms",
            "estimate_and_predict_ms",
            "feedback_ms",
            "prepare_ms",
            "period_ms",
            "bin_edges_ms",
            "bin_counts",
            "bin_period_ms",
            "bin_period",
        ];
        let columns = names.map(|name| (name.to_string(), Vec::new())).into();
        for (name, _) in TEMPLATES {
            let arm = serde_json::json!({ "loads": [], "distributed_loads": [], "length": 1.0 });
            let context = serde_json::json!({ "arm": arm, "period_s": 1.0, "rounding_j": 0.0 });
            if let Err(error) = words(name, &context, &columns) {
                panic!("{name}: {error}");
            }
        }
    }
}
