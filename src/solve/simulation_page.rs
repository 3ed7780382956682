//! The contents of the report page of a simulation.

use super::report::{ENERGY_ROWS, FRAMES, arm, fact, obstacles};
use crate::output::summary::SimulateSummary;
use crate::output::{
    MotionRecord, ReportCommand, ReportData, ReportEnergy, ReportMotion, ReportVerdict,
};
use crate::scene::{Scene, Simulation};

/// The page of a motion that `setup` made of `scene`.
pub(crate) fn simulation_page(
    scene: &Scene,
    setup: &Simulation,
    record: &MotionRecord,
    summary: &SimulateSummary,
) -> ReportData {
    let tip = summary.tip.position_m;
    let error = summary.error.iter().map(|error| fact("error", error));
    ReportData {
        title: summary.scene.clone(),
        command: ReportCommand::Simulate,
        verdict: ReportVerdict {
            text: summary.status.into(),
            ok: summary.status == "completed",
        },
        facts: vec![
            fact("model", summary.model),
            fact("strain rule", summary.strain),
            fact("elements", summary.elements),
            fact(
                "steps",
                format!("{} of {:.4e} s", summary.steps, summary.step_s),
            ),
            fact("wall time", format!("{:.3} s", summary.wall_s)),
            fact(
                "tip at the end",
                format!("({:.5}, {:.5}, {:.5}) m", tip[0], tip[1], tip[2]),
            ),
            fact(
                "energy",
                format!(
                    "{:.5e} J at the start, {:.5e} J at the end",
                    summary.energy.initial, summary.energy.r#final
                ),
            ),
            fact(
                "dilatation",
                format!(
                    "{:.5} to {:.5}",
                    summary.dilatation.min, summary.dilatation.max
                ),
            ),
        ]
        .into_iter()
        .chain(error)
        .collect(),
        summary: serde_json::to_value(summary).unwrap_or_default(),
        arm: arm(&setup.arm, &setup.rod),
        motion: ReportMotion::thinned(record, FRAMES),
        target: None,
        paths: Vec::new(),
        obstacles: obstacles(
            &scene.limits(),
            &setup.rod,
            &setup.arm.radii_at_nodes(setup.rod.n_elements()),
            record,
        ),
        controls: None,
        energy: Some(ReportEnergy::thinned(record, ENERGY_ROWS)),
        sensitivity: None,
        charts: Vec::new(),
        iterations: Vec::new(),
        attempts: Vec::new(),
        kinds: Vec::new(),
        checks: Vec::new(),
    }
}
