//! The contents of report pages: of a solve, a simulation, a closed loop, and of the files of any of them.

mod arrows;
#[cfg(feature = "cli")]
mod closed_loop;
#[cfg(feature = "cli")]
mod equilibrium;
mod fields;
mod findings;
#[cfg(feature = "cli")]
mod loop_tables;
mod obstacles;
mod reaction;
#[cfg(feature = "cli")]
mod saved;
#[cfg(feature = "cli")]
mod simulation;
mod solve;
mod summary;
mod words;

pub(super) use self::solve::{SolvePage, iteration, sensitivity, solve_page};
#[cfg(feature = "cli")]
pub(crate) use self::{
    closed_loop::closed_loop_page,
    equilibrium::equilibrium_page,
    findings::findings,
    saved::{SavedError, SavedPage, saved_page},
    simulation::simulation_page,
};

use crate::mechanics::{BaseCondition, Rod};
use crate::output::{ReportArm, ReportChart, ReportCurve};
use crate::task::Arm;

/// Frames of the picture.
const FRAMES: usize = 240;
/// Points of a curve over the rows of a motion.
const ROWS: usize = 600;

fn fact(label: &str, value: impl ToString) -> (String, String) {
    (label.to_string(), value.to_string())
}

fn drawn_arm(arm: &Arm, rod: &Rod) -> ReportArm {
    ReportArm {
        radius: arm.radii_at_nodes(rod.n_elements()),
        base: (rod.base == BaseCondition::Clamped).then(|| rod.rest.positions[0].into()),
        gravity: rod.gravity.into(),
        length: rod.scales.length,
        payload: arm.payload.map_or(0.0, |payload| payload.mass),
    }
}

/// A chart over time.
fn over_time(section: &str, title: &str, unit: &str, series: Vec<ReportCurve>) -> ReportChart {
    ReportChart {
        section: section.into(),
        title: title.into(),
        unit: unit.into(),
        x_name: "time".into(),
        x_unit: "s".into(),
        series,
    }
}

/// A curve through points.
fn curve(name: &str, color: &'static str, x: Vec<f64>, y: Vec<f64>) -> ReportCurve {
    ReportCurve {
        name: name.into(),
        color,
        x,
        y,
        hold: false,
        band: Vec::new(),
        dashed: false,
    }
}
