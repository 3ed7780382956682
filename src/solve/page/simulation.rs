//! The contents of the report page of a simulation.

use serde_json::Value;

use super::obstacles::obstacles;
use super::summary::{Fields, counted, measure, vector};
use super::words::{acting_facts, arm_facts, cost, in_numbers};
use super::{FRAMES, ROWS, arrows, drawn_arm, fact, fields, reaction};
use crate::mechanics::BaseCondition;
use crate::output::{
    BaseReaction, MotionRecord, ReportClock, ReportCommand, ReportData, ReportEnergy, ReportMotion,
    ReportVerdict, figure,
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
) -> ReportData {
    let rod = &setup.rod;
    let found = Fields(summary);
    let limits = scene.limits();
    let range = |path: &str, unit: &str| {
        let [min, max] = ["min", "max"].map(|end| found.number(&format!("{path}.{end}")));
        format!("{} to {}", figure(min, 4), measure(max, unit))
    };
    let steps = format!(
        "{} of {}",
        found.count("steps"),
        found.measure("step_s", "s")
    );
    // What is below the rounding of the energies of such an arm is none.
    let energy = |path: &str| {
        let joule = found.number(path);
        let none = joule.abs() < f64::EPSILON * rod.scales.moment;
        measure(if none { 0.0 } else { joule }, "J")
    };
    let mut facts = vec![
        fact("status", found.text("status")),
        fact("steps", steps),
        fact("wall time", found.measure("wall_s", "s")),
        fact(
            "tip at the end",
            format!("{} m", vector(tip_at(record, record.n_rows() - 1))),
        ),
        fact("energy at the start", energy("energy_J.initial")),
        fact("energy at the end", energy("energy_J.final")),
        fact(
            "length of an element over that at rest",
            range("dilatation", ""),
        ),
        fact("length of the arm", range("length_m", "m")),
    ];
    if !found.text("error").is_empty() {
        facts.push(fact("error", found.text("error")));
    }
    let (lead, trust) = words(setup, record, found);
    ReportData {
        title: found.text("scene").into(),
        command: ReportCommand::Simulate,
        verdict: ReportVerdict {
            text: found.text("status").into(),
            ok: found.text("status") == "completed",
            checked: false,
        },
        lead,
        trust,
        arm_facts: arm_facts(&setup.arm, rod),
        acting: acting_facts(&setup.arm, &limits, &[], [usize::MAX; 2]),
        facts,
        summary: summary.clone(),
        arm: drawn_arm(&setup.arm, rod),
        motion: ReportMotion::thinned(record, FRAMES),
        clock: ReportClock::time(),
        target: None,
        via: Vec::new(),
        paths: Vec::new(),
        arrows: arrows::given(rod, record, |_| arrows::LOAD),
        fields: fields::fields(rod, record),
        obstacles: obstacles(
            &limits,
            rod,
            &setup.arm.radii_at_nodes(rod.n_elements()),
            record,
        ),
        controls: None,
        energy: Some(ReportEnergy::thinned(record, ROWS)),
        sensitivity: None,
        bars: Vec::new(),
        tables: Vec::new(),
        advice: Vec::new(),
        charts: match base {
            Some(base) if rod.base != BaseCondition::Free => {
                reaction::charts(&base.t, &base.force, &base.moment)
            }
            _ => reaction::nearest_to_base(rod, record),
        },
        iterations: Vec::new(),
        attempts: Vec::new(),
        kinds: Vec::new(),
        checks: Vec::new(),
    }
}

fn tip_at(record: &MotionRecord, row: usize) -> nalgebra::Vector3<f64> {
    record.position(row, record.n_nodes - 1)
}

/// The row in which the tip is farthest from where it began, and how far that is, m.
fn farthest(record: &MotionRecord) -> (usize, f64) {
    let start = tip_at(record, 0);
    (0..record.n_rows())
        .map(|row| (row, (tip_at(record, row) - start).norm()))
        .fold(
            (0, 0.0),
            |most, next| if next.1 > most.1 { next } else { most },
        )
}

fn words(setup: &Simulation, record: &MotionRecord, summary: Fields) -> (String, String) {
    let arm = &setup.arm;
    let (row, way) = farthest(record);
    let (first, last) = (record.t[0], record.t[record.n_rows() - 1]);
    let moves = if way > 1e-9 * arm.length {
        format!(
            "The tip moves up to {} from where it begins, at t = {} s, and is at {} m after {}",
            measure(way, "m"),
            figure(record.t[row], 3),
            vector(tip_at(record, record.n_rows() - 1)),
            measure(last - first, "s")
        )
    } else {
        format!(
            "The tip stays where it is for {}",
            measure(last - first, "s")
        )
    };
    let mut causes = Vec::new();
    if arm.gravity.norm() > 0.0 {
        causes.push("its weight".to_string());
    }
    let loads = (arm.loads.len() + arm.distributed_loads.len()) as u64;
    match (&arm.loads[..], loads) {
        (_, 0) => {}
        ([only], 1) => causes.extend(in_numbers(only)),
        _ => causes.push(counted(loads, "load", "loads")),
    }
    if matches!(arm.base, BaseCondition::Driven(_)) {
        causes.push("a moving base".into());
    }
    let under = match causes.is_empty() {
        true => String::new(),
        false => format!(", under {}", causes.join(" and ")),
    };
    let status = summary.text("status");
    let lead = format!("{moves}{under}; {status}{}", cost(summary));
    let trust = match status {
        "completed" => {
            "A simulation has no certificate: halve time.step_s and double rod.elements to see how far step and elements misplace the arm."
                .to_string()
        }
        "interrupted" => "The run was interrupted: the motion is that up to then.".into(),
        _ => format!("Do not rely on it: {}.", summary.text("error")),
    };
    (lead, trust)
}
