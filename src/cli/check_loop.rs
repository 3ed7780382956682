//! The part of `softarm check` about a closed loop: horizon, sensors, the time of a sample, and the wrench for its reference.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use super::console::{Console, stop_signal};
use super::quantity::{digits, entry, quantity};
use crate::mpc::{Contender, MpcError, Percentiles, SensorSettings};
use crate::output::closed_loop::{LoopSensor, LoopSummary, ReferenceSummary};
use crate::scene::{ClosedLoopSetup, Scene, SceneError, SceneSource};
use crate::stop::StopSignal;

/// Number of samples that are timed; the first one is not counted.
const SAMPLES: usize = 6;
/// Time limit of these samples, s.
const PATIENCE: f64 = 5.0;
/// Fraction by which a wrench may exceed a bound, for rounding.
const ROUNDING: f64 = 1e-6;

/// Returns the figures of the loop that a scene describes, and concerns about it; `None` for a scene without `[mpc]`.
///
/// # Errors
/// Returns [`SceneError`] as the verb `mpc` does.
pub(super) fn summarize(
    scene: &Scene,
    source: &SceneSource,
) -> Result<Option<(LoopSummary, Vec<String>)>, SceneError> {
    if scene.mpc.is_none() {
        return Ok(None);
    }
    let stop = stop_signal(Some(Instant::now() + Duration::from_secs_f64(PATIENCE)));
    let setup = match scene.closed_loop(source, 0, &stop) {
        Err(_) if stop.is_raised() => return Ok(None),
        setup => setup?,
    };
    let own = &setup.experiment;
    let mut need = None;
    let mut seconds = Vec::new();
    let run = own.run(Contender::Mpc, &mut |sample, closed| {
        seconds.push(sample.sample_s);
        if seconds.len() < SAMPLES && !stop.is_raised() {
            return ControlFlow::Continue(());
        }
        need = closed.controller().reference_need();
        ControlFlow::Break(())
    });
    let mut concerns = [
        &setup.warnings[..],
        &setup.unbent_paths(&StopSignal::default()),
    ]
    .concat();
    match run {
        Ok(run) => concerns.extend(run.broke_down.map(|error| {
            format!("the arm's motion breaks down within the first {SAMPLES} samples: {error}")
        })),
        Err(MpcError::Stopped(_)) => {}
        Err(error) => match scene.mpc_error(source, &error) {
            Some(error) => return Err(error),
            None => concerns.push(format!("the loop does not begin: {error}")),
        },
    }
    let reference = need.map(|need| ReferenceSummary {
        at_s: need.t,
        force_n: need.wrench.force.into(),
        moment_n_m: need.wrench.moment.into(),
        force_excess_n: need.excess[0],
        moment_excess_n_m: need.excess[1],
    });
    concerns.extend(reference.as_ref().and_then(|need| above(need, &setup)));
    let timed = seconds.get(1..).filter(|timed| !timed.is_empty());
    let summary = LoopSummary {
        samples: (own.duration / own.mpc.period).round().max(1.0) as usize,
        period_s: own.mpc.period,
        horizon_s: own.mpc.horizon,
        block_s: own.mpc.block,
        sensors: setup.sensors().map(sensor).collect(),
        sample_s: timed.map(|timed| Percentiles::of(timed.iter().copied()).p50),
        reference,
    };
    Ok(Some((summary, concerns)))
}

fn sensor(settings: &SensorSettings) -> LoopSensor {
    LoopSensor {
        places: settings.places.clone(),
        rate_hz: settings.rate_hz,
        age_s: settings.age_s,
    }
}

/// Says that the reference needs more than the bounds allow; `None` if it does not.
fn above(need: &ReferenceSummary, setup: &ClosedLoopSetup) -> Option<String> {
    if is_within(need) {
        return None;
    }
    let actuators = &setup.experiment.task.actuators;
    let others = actuators.len() > 1
        || !setup.experiment.task.own_actuators.is_empty()
        || actuators.iter().any(|actuator| actuator.moment.acts());
    let what = if others {
        "other actuators must provide the rest, or the tip does not reach the reference"
    } else {
        "the tip does not reach the reference there"
    };
    Some(format!(
        "[control]: to hold the tip at its reference at t = {} s takes a force of {} and a moment of {} on the tip, which is above the bounds: {what}",
        digits(need.at_s),
        quantity(norm(need.force_n), "N"),
        quantity(norm(need.moment_n_m), "N m"),
    ))
}

fn norm(vector: [f64; 3]) -> f64 {
    vector.iter().map(|value| value * value).sum::<f64>().sqrt()
}

fn is_within(need: &ReferenceSummary) -> bool {
    need.force_excess_n <= ROUNDING * norm(need.force_n)
        && need.moment_excess_n_m <= ROUNDING * norm(need.moment_n_m)
}

/// Prints the figures.
pub(super) fn say(summary: &LoopSummary, console: &Console) {
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
        let moment = norm(need.moment_n_m);
        let turn = if moment > 0.0 {
            format!(" and {}", quantity(moment, "N m"))
        } else {
            String::new()
        };
        let verdict = if is_within(need) {
            "within the bounds"
        } else {
            "ABOVE THE BOUNDS"
        };
        say(
            "reference",
            &format!(
                "held by at most {}{turn} on the tip, at t = {}: {verdict}",
                quantity(norm(need.force_n), "N"),
                quantity(need.at_s, "s")
            ),
        );
    }
}
