//! A closed loop before it runs: horizon, sensors, the time of a sample, and what its reference takes.

use std::ops::ControlFlow;
use std::time::Duration;

use crate::mpc::{Contender, MpcError, Percentiles, SensorSettings};
use crate::output::closed_loop::{LoopSensor, LoopSummary, ReferenceSummary};
use crate::output::quantity::{digits, quantity};
use crate::scene::{ClosedLoopSetup, Scene, SceneError, SceneSource};
use crate::stop::StopSignal;

/// Number of samples that are timed; the first one is not counted.
const SAMPLES: usize = 6;
/// Time after which the samples are given up.
const PATIENCE: Duration = Duration::from_secs(5);

/// Returns the figures of the loop that a scene describes, and concerns about it; `None` for a scene without `[mpc]`.
///
/// # Errors
/// Returns [`SceneError`] as the verb `mpc` does.
pub(super) fn summarize(
    scene: &Scene,
    source: &SceneSource,
    until: &dyn Fn(Duration) -> StopSignal,
) -> Result<Option<(LoopSummary, Vec<String>)>, SceneError> {
    if scene.mpc.is_none() {
        return Ok(None);
    }
    let stop = until(PATIENCE);
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
    if need.is_within() {
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
        quantity(need.force(), "N"),
        quantity(need.moment(), "N m"),
    ))
}
