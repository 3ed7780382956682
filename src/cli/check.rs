//! `softarm check SCENE`: validates a scene and prints what follows from it: mass, sag, frequency, bounds, time step, predicted times and
//! memory.

use std::time::Instant;

use nalgebra::Vector3;

use super::console::Console;
use super::error::CliError;
use super::{Global, Outcome, exit, scene_name};
use crate::mechanics::Rod;
use crate::memory::in_words;
use crate::output::closed_loop::LoopSummary;
use crate::output::quantity::{digits, entry, mass, quantity};
use crate::output::summary::{ActuatorSummary, CheckSummary, RestSummary, StaticNeedSummary};
use crate::scene::Scene;
use crate::solve::scene_check::{
    ABOVE, CANNOT, ControlUnit, NO_WRENCH, SceneCheck, UNSTABLE, WITHIN, check_scene,
    time_in_words, what_weighs,
};
use crate::task::prediction::SolveTime;

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
    answer(&found, &scene, console);
    let summary = &found.summary;
    detail(summary, console);
    for warning in &summary.warnings {
        console.warn(warning);
    }
    console.verdict(true, "the scene is valid");
    console.summary(summary);
    Ok(exit::DONE)
}

/// The first questions about an arm: what it weighs, how it hangs and sways, what acts on it, whether that suffices, and how long a
/// solve takes.
fn answer(found: &SceneCheck, scene: &Scene, console: &Console) {
    let SceneCheck {
        summary,
        rod,
        duration,
        ..
    } = found;
    let say = |word: &str, text: &str| console.say(&entry(word, text));
    let payload = if summary.payload_kg > 0.0 {
        format!(" and a payload of {}", mass(summary.payload_kg))
    } else {
        String::new()
    };
    console.say(&format!(
        "{}: an arm of {}, {}{payload}",
        summary.scene,
        quantity(rod.scales.length, "m"),
        mass(summary.mass_kg - summary.payload_kg),
    ));
    if let (Some(preset), Some(material)) = (&summary.material, &scene.rod.material) {
        let [least, largest] = preset.range_pa.map(|modulus| quantity(modulus, "Pa"));
        say(
            "material",
            &format!(
                "{}: E {} ({least} to {largest} reported), {} kg/m³",
                preset.name,
                quantity(material.youngs_modulus().unwrap_or(f64::NAN), "Pa"),
                digits(material.density().unwrap_or(f64::NAN))
            ),
        );
    }
    say("at rest", &rest_in_words(&summary.at_rest, rod));
    if let Some(frequency) = summary.at_rest.first_frequency_hz {
        say(
            "sways",
            &format!(
                "at {} first: {} is {} of its periods",
                quantity(frequency, "Hz"),
                quantity(*duration, "s"),
                digits(duration * frequency)
            ),
        );
    }
    let (on_nodes, along) = (scene.load.len(), scene.distributed_load.len());
    if on_nodes + along > 0 {
        say(
            "loads",
            &format!("{on_nodes} on nodes, {along} along the arm"),
        );
    }
    say_actuators(found, console);
    say("steps", &steps_in_words(summary));
    if let Some(cost) = &summary.solve_cost {
        let time = SolveTime {
            iteration: cost.iteration_s,
            check: cost.check_s,
            has_rows: (summary.optimal_control.as_ref()).is_some_and(|size| size.path_rows > 0),
        };
        say("solve", &time_in_words(&time, summary.memory_bytes as f64));
    }
    if let Some(closed_loop) = &summary.closed_loop {
        say_loop(closed_loop, console);
    }
}

/// Prints what the controls are, and what they need to hold the arm at its target.
fn say_actuators(found: &SceneCheck, console: &Console) {
    let SceneCheck {
        summary,
        rod,
        distance,
        own_units,
        ..
    } = found;
    let say = |word: &str, text: &str| console.say(&entry(word, text));
    let acting = |actuator: &&ActuatorSummary| {
        [&actuator.force, &actuator.moment]
            .iter()
            .any(|limit| *limit != NO_WRENCH)
            || summary.actuators.len() == 1
    };
    let (along, on_nodes): (Vec<_>, Vec<_>) =
        (summary.actuators.iter()).partition(|actuator| actuator.controls.is_some());
    let on_nodes: Vec<_> = on_nodes.into_iter().filter(acting).collect();
    for actuator in on_nodes.iter().take(WRENCHES_SHOWN) {
        let node = if actuator.node == rod.tip() {
            "tip".to_string()
        } else {
            format!("node {}", actuator.node)
        };
        say(&node, &wrench_in_words(actuator));
    }
    if on_nodes.len() > WRENCHES_SHOWN {
        let more = on_nodes.len() - WRENCHES_SHOWN;
        say("", &format!("and wrenches on {more} nodes more"));
    }
    let needed = summary.static_need.as_ref();
    let needed = needed.map(|need| efforts(&need.controls, own_units));
    for (at, actuator) in along.into_iter().enumerate() {
        let of_target = (needed.as_ref().and_then(|needed| needed.get(at)))
            .map_or_else(String::new, |effort| format!("; at the target {effort}"));
        let word = if at == 0 { "along it" } else { "" };
        say(
            word,
            &(actuator.controls.clone().unwrap_or_default() + &of_target),
        );
    }
    if let Some(need) = &summary.static_need {
        let away = distance.map_or_else(String::new, |d| format!("{} away; ", quantity(d, "m")));
        say("target", &(away + &held_by(need, own_units)));
    }
}

fn wrench_in_words(actuator: &ActuatorSummary) -> String {
    let mut parts = Vec::new();
    if actuator.force != NO_WRENCH {
        parts.push(format!("force in space {}", actuator.force));
    }
    if actuator.moment != NO_WRENCH {
        parts.push(format!("moment in body frame {}", actuator.moment));
    }
    if parts.is_empty() {
        parts.push("neither force nor moment".into());
    }
    parts.join("; ")
}

fn steps_in_words(summary: &CheckSummary) -> String {
    let chosen = if summary.integrator_is_chosen {
        let cost = &summary.cost;
        format!(
            ", chosen: a simulation takes {} explicit, {} implicit",
            quantity(cost.explicit_wall_s, "s"),
            quantity(cost.implicit_wall_s, "s")
        )
    } else {
        String::new()
    };
    format!(
        "{} of {}, {}{chosen}",
        summary.steps,
        quantity(summary.step_s, "s"),
        summary.integrator
    )
}

fn rest_in_words(rest: &RestSummary, rod: &Rod) -> String {
    let weight = format!("rho A g L^3/EI = {}", digits(rest.weight_number));
    if rod.gravity == Vector3::zeros() {
        return "no gravity".into();
    }
    if rest.growth_rate_1_s.is_some() {
        let payload = rod.mass() * rod.gravity.norm() / rod.scales.force - rest.weight_number;
        let payload = match payload > 1e-9 * rest.weight_number {
            true => format!(", m g L^2/EI = {} of the payload", digits(payload)),
            false => String::new(),
        };
        return format!("TOPPLES under {}; {weight}{payload}", what_weighs(rod));
    }
    let (Some(sag), Some(stretch)) = (rest.sag_m, rest.stretch) else {
        let reason = rest.no_equilibrium.as_deref().unwrap_or("not looked at");
        return format!("no static shape: {reason}; {weight}");
    };
    let percent = 100.0 * stretch.abs();
    let change = match stretch {
        _ if percent < 0.01 => "does not stretch".to_string(),
        longer if longer > 0.0 => format!("stretches {} %", digits(percent)),
        _ => format!("shortens {} %", digits(percent)),
    };
    format!(
        "gravity moves the tip {} ({} % of the length); the arm {change}; {weight}",
        quantity(sag, "m"),
        digits(100.0 * sag / rod.scales.length)
    )
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

/// The largest force, moment and controls in words; `units` are those of the controls.
fn in_parts(wrenches: &[[f64; 6]], controls: &[Vec<f64>], units: &[ControlUnit]) -> String {
    let largest = |from: usize| {
        (wrenches.iter())
            .map(|wrench| Vector3::from_column_slice(&wrench[from..from + 3]).norm())
            .fold(0.0, f64::max)
    };
    let wrenches = [(largest(0), "N"), (largest(3), "N m")].into_iter();
    let wrenches =
        (wrenches.filter(|(size, _)| *size > 0.0)).map(|(size, unit)| quantity(size, unit));
    let own = (efforts(controls, units).into_iter().zip(units)).map(|(effort, own)| {
        let name = own.name.as_ref();
        name.map_or(effort.clone(), |name| format!("{effort} ({name})"))
    });
    let parts: Vec<String> = wrenches.chain(own).collect();
    if parts.is_empty() {
        "nothing".to_string()
    } else {
        parts.join(" and ")
    }
}

/// The wrench that holds the tip at its target, in words.
fn held_by(need: &StaticNeedSummary, units: &[ControlUnit]) -> String {
    // The controls at the target stand with their actuators.
    let parts = match need.controls.is_empty() {
        true => in_parts(&need.wrenches, &[], &[]),
        false if need.wrenches.iter().flatten().all(|part| *part == 0.0) => "these".to_string(),
        false => in_parts(&need.wrenches, &[], &[]) + " and these",
    };
    let nearest = need.nearest.as_ref().map_or_else(String::new, |nearest| {
        let [x, y, z] = nearest.position_m.map(digits);
        format!(
            "; the nearest point found that is held is [{x}, {y}, {z}] m, {} away{}, by {}",
            quantity(nearest.distance_m, "m"),
            (nearest.angle_rad).map_or_else(String::new, |angle| {
                format!(" and turned by {}", quantity(angle, "rad"))
            }),
            in_parts(&nearest.wrenches, &nearest.controls, units)
        )
    });
    let reason = need.reason.as_deref().unwrap_or("unknown");
    match need.verdict {
        WITHIN => {
            let stiffness = need.stiffness_n_m.map_or_else(String::new, |stiffness| {
                format!(
                    "; stable: along its softest direction the tip gives way by {} per newton",
                    quantity(stiffness.recip(), "m")
                )
            });
            let swings = need
                .first_frequency_hz
                .map_or_else(String::new, |frequency| {
                    format!(", and the held arm sways at {}", quantity(frequency, "Hz"))
                });
            let grows = need.growth_rate_1_s.map_or_else(String::new, |rate| {
                format!(
                    "; deviations grow e-fold in {}, too slowly to matter while the arm stays",
                    quantity(rate.recip(), "s")
                )
            });
            let crosses =
                (need.reason.as_ref()).map_or_else(String::new, |reason| format!("; BUT {reason}"));
            format!("held there by {parts}: within the bounds{stiffness}{swings}{grows}{crosses}")
        }
        ABOVE => format!("what holds it there, {parts}, is ABOVE THE BOUNDS{nearest}"),
        UNSTABLE => {
            let growth = need.growth_rate_1_s.map_or_else(
                || "stay".to_string(),
                |rate| format!("grow e-fold in {}", quantity(rate.recip(), "s")),
            );
            format!("NOT HELD by {parts}, which balances it there: deviations {growth}{nearest}")
        }
        CANNOT => format!("CANNOT BE HELD there: {reason}{nearest}"),
        _ => format!(
            "nothing that holds it there was found, nor a reason that nothing does: {reason}{nearest}"
        ),
    }
}

/// Figures for whoever tunes or scripts.
fn detail(summary: &CheckSummary, console: &Console) {
    console.say(&format!(
        "  grid   {} elements, {} strain, {} model",
        summary.elements, summary.strain, summary.model
    ));
    console.say(&format!(
        "  time   {} step {:.4e} s (explicit: stable below {:.4e} s), {} steps",
        summary.integrator, summary.step_s, summary.stable_step_s, summary.steps
    ));
    if let Some(contact) = &summary.contact {
        console.say(&format!("  contact {}", contact.in_words()));
    }
    let cost = &summary.cost;
    console.say(&format!(
        "  cost   simulation explicit {:.1e} s at {:.4e} s, implicit {:.1e} s at {:.4e} s: {} is cheaper",
        cost.explicit_wall_s,
        cost.explicit_step_s,
        cost.implicit_wall_s,
        cost.implicit_step_s,
        cost.cheaper
    ));
    console.say(&format!(
        "  scales length {:.4} m, force EI/L² {:.4e} N, moment EI/L {:.4e} N m, time {:.4} s",
        summary.scales.length_m,
        summary.scales.force_n,
        summary.scales.moment_n_m,
        summary.scales.time_s
    ));
    if let Some(size) = &summary.optimal_control {
        console.say(&format!(
            "  control {} blocks, {} variables; {} target equations, {} path rows; {} configuration unknowns eliminated",
            size.control_blocks,
            size.variables,
            size.target_equations,
            size.path_rows,
            size.eliminated
        ));
    }
    if let Some(output) = &summary.output {
        console.say(&format!(
            "  output {} rows, {:.1} MB",
            output.rows,
            output.bytes as f64 * 1e-6
        ));
    }
    console.say(&format!(
        "  memory about {}",
        in_words(summary.memory_bytes as f64)
    ));
}

/// Figures of a closed loop.
fn say_loop(summary: &LoopSummary, console: &Console) {
    let say = |word: &str, text: &str| console.say(&entry(word, text));
    say(
        "loop",
        &format!(
            "{} samples of {}; a horizon of {} in blocks of {}",
            summary.samples,
            quantity(summary.period_s, "s"),
            quantity(summary.horizon_s, "s"),
            quantity(summary.block_s, "s")
        ),
    );
    if let Some(seconds) = summary.sample_s {
        say(
            "sample",
            &format!(
                "takes {} of {} on this machine, now",
                quantity(seconds, "s"),
                quantity(summary.period_s, "s")
            ),
        );
    }
    if summary.sensors.is_empty() {
        say("sensors", "none: the true state is known at once");
    }
    for sensor in &summary.sensors {
        let places: Vec<_> = sensor.places.iter().map(|place| digits(*place)).collect();
        let at = if places.is_empty() {
            "on the clamp".to_string()
        } else {
            format!("at {} of the length", places.join(", "))
        };
        say(
            "sensor",
            &format!(
                "{at}, {} times a second, known after {}",
                digits(sensor.rate_hz),
                quantity(sensor.age_s, "s")
            ),
        );
    }
    if let Some(need) = &summary.reference {
        let moment = need.moment();
        let turn = if moment > 0.0 {
            format!(" and {}", quantity(moment, "N m"))
        } else {
            String::new()
        };
        let verdict = if need.is_within() {
            "within the bounds"
        } else {
            "ABOVE THE BOUNDS"
        };
        say(
            "reference",
            &format!(
                "held by at most {}{turn} on the tip, at t = {}: {verdict}",
                quantity(need.force(), "N"),
                quantity(need.at_s, "s")
            ),
        );
    }
}
