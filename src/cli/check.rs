//! `softarm check SCENE`: validates a scene and prints what follows from it: mass, sag, frequency, bounds, time step, predicted times and
//! memory. Its words stand in the template beside this file.

use std::path::Path;
use std::time::Instant;

use nalgebra::Vector3;
use serde_json::{Value, json};

use super::console::Console;
use super::error::CliError;
use super::{Global, Outcome, exit, scene_name};
use crate::memory::in_words;
use crate::output::closed_loop::ReferenceSummary;
use crate::output::quantity::{digits, entry, mass, quantity};
use crate::output::summary::ActuatorSummary;
use crate::output::{OutputError, entries, json_value};
use crate::scene::Scene;
use crate::solve::scene_check::{
    ControlUnit, NO_WRENCH, SceneCheck, check_scene, time_in_words, what_weighs,
};
use crate::task::prediction::SolveTime;

/// The words, as a template.
const TEMPLATE: [(&str, &str); 1] = [("check.jinja", include_str!("check.jinja"))];
/// Nodes with a wrench that are described one by one.
const WRENCHES_SHOWN: usize = 3;
/// Controls below this fraction of the largest of their unit are rounding: equilibria are accurate to about 1e-6.
const CONTROL_ROUNDING: f64 = 1e-6;

pub(super) fn run(scene_argument: &str, global: &Global, console: &Console) -> Outcome {
    let (scene, source) = console.load(scene_argument, global)?;
    let name = scene_name(scene_argument);
    let stop = console.stop_signal(None);
    // Parts of a check do not read the signal: an interrupt abandons them.
    let found = {
        let (scene, source, until) = (scene.clone(), source.clone(), stop.clone());
        let n_threads = global.n_threads();
        let work = move || {
            let until = |time| until.no_later_than(Instant::now() + time);
            check_scene(&scene, &source, &name, n_threads, &until)
        };
        stop.unless_raised(usize::MAX, work)
            .map_err(CliError::Stopped)??
    };
    let summary = &found.summary;
    console.say(&format!(
        "{}: an arm of {}, {}{}",
        summary.scene,
        quantity(found.rod.scales.length, "m"),
        mass(summary.mass_kg - summary.payload_kg),
        match summary.payload_kg {
            none if none <= 0.0 => String::new(),
            payload => format!(" and a payload of {}", mass(payload)),
        }
    ));
    let words = entries(&TEMPLATE, "check.jinja", &context(&found, &scene));
    let malformed = |error| OutputError::malformed(Path::new("check.jinja"), format!("{error:#}"));
    for (word, text) in words.map_err(malformed)? {
        console.say(&entry(&word, &text));
    }
    for warning in &summary.warnings {
        console.warn(warning);
    }
    console.verdict(true, "the scene is valid");
    console.summary(summary);
    Ok(exit::DONE)
}

/// The values of the template.
fn context(found: &SceneCheck, scene: &Scene) -> Value {
    let SceneCheck {
        summary,
        rod,
        own_units,
        ..
    } = found;
    let acting = |actuator: &&ActuatorSummary| {
        [&actuator.force, &actuator.moment]
            .iter()
            .any(|limit| *limit != NO_WRENCH)
            || summary.actuators.len() == 1
    };
    let (along, on_nodes): (Vec<_>, Vec<_>) =
        (summary.actuators.iter()).partition(|actuator| actuator.controls.is_some());
    let need = summary.static_need.as_ref();
    let nearest = need.and_then(|need| need.nearest.as_ref());
    let material = scene.rod.material.as_ref();
    let time = summary.solve_cost.as_ref().map(|cost| SolveTime {
        iteration: cost.iteration_s,
        check: cost.check_s,
        has_rows: (summary.optimal_control.as_ref()).is_some_and(|size| size.path_rows > 0),
    });
    json!({
        "summary": json_value(summary),
        "rod": {
            "length": rod.scales.length,
            "tip": rod.tip(),
            "has_gravity": rod.gravity != Vector3::zeros(),
            "weighs": what_weighs(rod),
            "payload_number":
                rod.mass() * rod.gravity.norm() / rod.scales.force - summary.at_rest.weight_number,
            "youngs_modulus": material.and_then(|material| material.youngs_modulus()),
            "density": material.and_then(|material| material.density()),
        },
        "duration_s": found.duration,
        "distance_m": found.distance,
        "loads": [scene.load.len(), scene.distributed_load.len()],
        "shown": WRENCHES_SHOWN,
        "wrenches": on_nodes.into_iter().filter(acting).collect::<Vec<_>>(),
        "along": along,
        "needed": need.map(|need| json!({
            "efforts": efforts(&need.controls, own_units),
            "wrenches": wrenches_in_words(&need.wrenches),
        })),
        "nearest": nearest.map(|nearest| held(&nearest.wrenches, &nearest.controls, own_units)),
        "solve": time.map(|time| time_in_words(&time, summary.memory_bytes as f64)),
        "reference_is_within": (summary.closed_loop.as_ref())
            .and_then(|own| own.reference.as_ref())
            .map(ReferenceSummary::is_within),
        "contact": summary.contact.as_ref().map(|contact| contact.in_words()),
        "memory": in_words(summary.memory_bytes as f64),
    })
}

/// The largest control of every actuator that is no wrench, with its sign and unit; zero where it is rounding.
fn efforts(controls: &[Vec<f64>], units: &[ControlUnit]) -> Vec<String> {
    let largest = |controls: &[f64]| {
        (controls.iter()).fold(
            0.0,
            |most: f64, u| if u.abs() > most.abs() { *u } else { most },
        )
    };
    let of_unit = |unit: &str| {
        let same = controls
            .iter()
            .zip(units)
            .filter(|(_, own)| own.unit == unit);
        same.map(|(controls, _)| largest(controls).abs())
            .fold(0.0, f64::max)
    };
    (controls.iter().zip(units))
        .map(|(controls, own)| {
            let size = largest(controls);
            let is_rounding = size.abs() < CONTROL_ROUNDING * of_unit(&own.unit);
            let size = if is_rounding { 0.0 } else { size };
            if own.unit.is_empty() {
                // A prefix without a unit reads as a unit.
                digits(size)
            } else {
                quantity(size, &own.unit)
            }
        })
        .collect()
}

/// The largest force and the largest moment in words, of those that are not zero.
fn wrenches_in_words(wrenches: &[[f64; 6]]) -> Vec<String> {
    let largest = |from: usize| {
        (wrenches.iter())
            .map(|wrench| Vector3::from_column_slice(&wrench[from..from + 3]).norm())
            .fold(0.0, f64::max)
    };
    ([(largest(0), "N"), (largest(3), "N m")].into_iter())
        .filter(|(size, _)| *size > 0.0)
        .map(|(size, unit)| quantity(size, unit))
        .collect()
}

/// The largest force, moment and controls in words; `units` are those of the controls.
fn held(wrenches: &[[f64; 6]], controls: &[Vec<f64>], units: &[ControlUnit]) -> Vec<String> {
    let own = (efforts(controls, units).into_iter().zip(units)).map(|(effort, own)| {
        let name = own.name.as_ref();
        name.map_or(effort.clone(), |name| format!("{effort} ({name})"))
    });
    wrenches_in_words(wrenches).into_iter().chain(own).collect()
}
