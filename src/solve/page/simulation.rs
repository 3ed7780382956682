//! The contents of the report page of a simulation.

use serde_json::{Value, json};

use super::obstacles::obstacles;
use super::{FRAMES, ROWS, arm, arrows, drawn_arm, efforts, fields, reaction, words};
use crate::mechanics::BaseCondition;
use crate::output::{
    BaseReaction, MotionRecord, OutputError, ReportCommand, ReportData, ReportEnergy, ReportMotion,
};
use crate::scene::{Scene, Simulation};

/// The page of a motion that `setup` made of `scene`; `summary` is the contents of `summary.json`, and the reaction that of
/// `diagnostics.npz`, if there is one.
pub(crate) fn simulation_page(
    scene: &Scene,
    setup: &Simulation,
    record: &MotionRecord,
    summary: &Value,
    base: Option<&BaseReaction>,
) -> Result<ReportData, OutputError> {
    let (own, rod) = (&setup.arm, &setup.rod);
    let limits = scene.limits();
    let mut columns = match base {
        Some(base) if rod.base != BaseCondition::Free => reaction::saved(base),
        _ => reaction::nearest_to_base(rod, record),
    };
    let efforts = |row: usize| {
        let inputs = rod.actuators.efforts(record.t[row]);
        efforts::of_inputs(rod, record, row, inputs)
    };
    let shown = efforts::shown(rod, record, &scene.effort_controls(), &efforts);
    columns.extend(shown.columns);
    let context = json!({
        "summary": summary,
        "efforts": shown.groups,
        "arm": arm::arm(own, rod, [usize::MAX; 2]),
        "limits": arm::names(&limits),
        "way": way(record),
        "rounding_j": f64::EPSILON * rod.scales.moment,
    });
    let words = words("simulation.jinja", &context, &columns)?;
    let motion = ReportMotion::thinned(record, FRAMES);
    Ok(ReportData {
        arrows: (arrows::given(rod, record, |_| arrows::LOAD).into_iter())
            .chain(shown.arrows)
            .collect(),
        routes: shown.routes,
        fields: fields::fields(rod, record),
        obstacles: obstacles(&limits, rod, &own.radii_at_nodes(&rod.mesh), record),
        energy: Some(ReportEnergy::thinned(record, ROWS)),
        ..ReportData::of(
            ReportCommand::Simulate,
            summary,
            words,
            drawn_arm(own, rod),
            motion,
        )
    })
}

/// Largest distance of the tip from its start with its time, and the end of the motion with its time.
fn way(record: &MotionRecord) -> Value {
    let tip = |row: usize| record.position(row, record.n_nodes - 1);
    let last = record.n_rows() - 1;
    let (row, moved) = (0..=last)
        .map(|row| (row, (tip(row) - tip(0)).norm()))
        .fold(
            (0, 0.0),
            |most, next| if next.1 > most.1 { next } else { most },
        );
    json!({
        "moved": moved,
        "time_s": record.t[row],
        "end": <[f64; 3]>::from(tip(last)),
        "duration_s": record.t[last] - record.t[0],
    })
}
