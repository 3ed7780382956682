//! Sentences that help where a loop is far from its reference, or its estimate is in doubt.

use nalgebra::Vector3;

use crate::mpc::{Cause, Contender, FallbackSettings, Innovations, Outcome, Sensing, TipError};
use crate::output::closed_loop::LimitPeak;
use crate::scene::{ClosedLoopSetup, LARGEST_STRETCH};
use crate::stop::StopSignal;

/// Part of the length that the tip may be off at the end of a loop without a word about it, as the root mean square over the last quarter.
pub(super) const FAR: f64 = 0.01;

/// Returns sentences on the errors of a loop: an estimate that cannot be trusted, fallbacks and bounds that the loop reports, and changes
/// that may help if the tip is far off at the end.
pub(super) fn advice(
    setup: &ClosedLoopSetup,
    run: &Outcome,
    others: &[Outcome],
    limits: &[LimitPeak],
) -> Vec<String> {
    let mut out = limit_advice(setup, run, limits);
    out.extend(estimate_advice(setup, run));
    out.extend(causes(setup, run, others));
    match beyond_reach(setup, run) {
        Some(beyond) => out.insert(0, beyond),
        None => out.extend(changes(setup, run)),
    }
    out
}

/// Returns a sentence on a reference that is farther from a base that stays than the arm is long, stretched as far as rods are modeled.
fn beyond_reach(setup: &ClosedLoopSetup, run: &Outcome) -> Option<String> {
    let rod = &setup.model;
    if !rod.is_held() || rod.driven_base(0.0).is_some() {
        return None;
    }
    let (base, length) = (rod.rest.positions[0], setup.experiment.arm.length);
    let places = run.samples.iter().filter_map(|sample| {
        let place = Vector3::from(sample.reference?);
        Some((sample.t, (place - base).norm()))
    });
    let (t, farthest) = places.max_by(|a, b| a.1.total_cmp(&b.1))?;
    (farthest > LARGEST_STRETCH * length).then(|| {
        format!(
            "at t = {t:.3} s the reference is {farthest:.3} m from the base, and the arm is {length:.3} m long: no controller brings the tip there; give \
             a reference within its reach"
        )
    })
}

/// Returns a sentence on every obstacle and limit that was not kept.
fn limit_advice(setup: &ClosedLoopSetup, run: &Outcome, limits: &[LimitPeak]) -> Vec<String> {
    let why = if let Some(price) = setup.experiment.mpc.limit_price {
        format!(
            "mpc.limit_price = {price} is what a violation costs: without the key, the price rises until the limit holds"
        )
    } else if run.tally.breaking > 0 {
        format!(
            "in {} of {} samples no command within the bounds and rates of [control] keeps it over the horizon: larger bounds, a longer \
             mpc.horizon_s to begin earlier, or another reference",
            run.tally.breaking, run.tally.samples
        )
    } else {
        let how = match setup.experiment.margins.iter().any(|own| *own > 0.0) {
            true => "",
            false => ", and doubt.share finds how much",
        };
        format!(
            "the plan keeps it, the arm does not: what the model has wrong takes the rest; a margin_m or a smaller limit leaves room for that{how}"
        )
    };
    (limits.iter().filter(|peak| peak.violated))
        .map(|peak| format!("{}: {why}", peak.words()))
        .collect()
}

/// Causes that figures of the runs name.
fn causes(setup: &ClosedLoopSetup, run: &Outcome, others: &[Outcome]) -> Vec<String> {
    let own = &setup.experiment;
    let length = own.arm.length;
    let mut out = Vec::new();
    let n = run.tally.samples;
    if n > 0 && run.tally.bounded == n {
        out.push(format!(
            "a bound was active in all {n} samples: what is asked takes more than the bounds and rates of [control] allow, or limits and obstacles are \
             in the way"
        ));
    }
    let period = own.mpc.period;
    let patience = own.settings.fallback.patience(period);
    let needed = FallbackSettings::default()
        .following(setup.sensors(), period)
        .patience(period);
    let blind = (run.tally.fallbacks).get(&Cause::NoMeasurement.to_string());
    if let Some(blind) = blind.filter(|_| patience < needed) {
        out.push(format!(
            "{blind} samples fell back because nothing was measured for longer than mpc.fallback.patience_s = {patience}: the slowest [[sensor]] needs \
             {needed:.3}, its age_s and two of its periods"
        ));
    }
    let rms = |run: &Outcome| run.tip_error.rms / length;
    let of = |contender: Contender| others.iter().find(|other| other.contender == contender);
    if rms(run) > FAR {
        out.extend(setup.unbent_paths(&StopSignal::default()));
    }
    if rms(run) > FAR
        && let (Some(model), Some(waits)) = (of(Contender::PlantIsModel), of(Contender::PlantWaits))
    {
        let [whole, model, waits] = [run, model, waits].map(|run| 100.0 * rms(run));
        // The largest of three parts: of what the model has wrong and the delays nothing is in the first.
        let parts = [
            (
                model,
                "on an arm that is its model and known at once, the tip is nearly as far off: the path, the bounds, or the horizon are at fault, not \
                 what the model has wrong",
            ),
            (
                waits - model,
                "most of it goes with what the model has wrong: an [estimator] with estimator.disturbances looks for it",
            ),
            (
                whole - waits,
                "most of it goes with sensors and delays: mpc.actuator_delay_s, mpc.computing and age_s of [[sensor]] say what the loop predicts over",
            ),
        ];
        let largest = parts.into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, words)) = largest {
            out.push(format!(
                "the tip is {whole:.2} % of the length off (rms), {waits:.2} % where the arm waits and is known, {model:.2} % where it is the model as \
                 well: {words}"
            ));
        }
    }
    out
}

/// Standard deviations from which on a delay is more than noise.
const CERTAIN: f64 = 3.0;
/// Fraction of a run after which its last quarter begins. By then an estimate agrees with the measurements, or nothing confirms it: with
/// delays of 10 and 20 ms, which a filter finds as 8.6 and 18.7 ms, their squares are 17 and 71 times as large as expected over the first
/// quarter, and 1.0 times over the last one (the worked scene of `docs/loops.md` with the default unknowns).
const LAST: f64 = 0.75;

/// Returns the remarks on the scene that follow from the innovations of the filter.
fn estimate_advice(setup: &ClosedLoopSetup, run: &Outcome) -> Vec<String> {
    let mut out = Vec::new();
    if let Some(found) = &run.tally.innovations {
        let missing = setup.experiment.missing_unknowns();
        out.extend(found.doubt(&missing, setup.model.n_elements()));
    }
    out.extend((run.samples.last()).and_then(|last| last.lift(&setup.model)));
    let late = (run.samples.last())
        .map(|last| (last.disturbance.delay(), last.deviation.delay()))
        .filter(|(delay, deviation)| *deviation > 0.0 && delay.abs() > CERTAIN * deviation);
    let last = (LAST * run.samples.len() as f64) as usize;
    let doubt = Innovations::of(&run.samples[last..]).filter(|found| found.is_off);
    if let (Some((delay, deviation)), Some(doubt)) = (late, doubt) {
        out.push(format!(
            "an estimated delay of the commands of {:.1} +- {:.1} ms is not confirmed: over the last quarter of the samples, the squares of what is \
             measured otherwise than expected are {:.2} times as large as the filter expects (consistent: at most {:.2}); measure the delay, or name \
             estimator.disturbances without \"delay\"",
            1e3 * delay,
            1e3 * deviation,
            doubt.per_number,
            doubt.at_most
        ));
    } else if let Some((delay, deviation)) = late {
        let said = setup.experiment.settings.actuator_delay + delay;
        let when = if delay > 0.0 { "later" } else { "earlier" };
        let what = if said >= 0.0 {
            format!("mpc.actuator_delay_s = {said:.4} says so")
        } else {
            "no command acts before it is sent, so that this stands for what the model has wrong about damping or its time steps".into()
        };
        out.push(format!(
            "commands act {:.1} +- {:.1} ms {when} than they are said to, which the loop predicts over: {what}",
            1e3 * delay.abs(),
            1e3 * deviation,
        ));
    }
    out
}

/// Returns changes that may help if the tip is far from its reference at the end.
fn changes(setup: &ClosedLoopSetup, run: &Outcome) -> Vec<String> {
    let own = &setup.experiment;
    let quarter = LAST * own.duration;
    let late = run
        .samples
        .iter()
        .any(|sample| sample.t >= quarter && sample.reference.is_some());
    let off = TipError::of(&run.samples, quarter).rms / own.arm.length;
    if !late || off <= FAR {
        return Vec::new();
    }
    let mut what = Vec::new();
    let looks_for_nothing = match &own.sensing {
        Sensing::Everything => true,
        Sensing::Estimated { unknowns, .. } => unknowns.is_empty(),
    };
    if looks_for_nothing {
        what.push(
            "[estimator] with estimator.disturbances finds what the model has wrong, which nothing here looks for",
        );
    }
    // A horizon that recedes has a price of its own.
    if own.task.cost.rate == 0.0 && own.mpc.due.is_some() {
        what.push("objective.rate makes plans smooth, where the tip trembles");
    }
    let is_damped = own.arm.viscous_damping > 0.0 || own.arm.internal_damping > 0.0;
    if !is_damped {
        what.push("[damping] gives the model the damping that a real arm has");
    }
    let turns = (own.task.actuators.iter()).any(|actuator| actuator.moment.acts());
    if is_damped && turns && own.arm.internal_damping == 0.0 {
        what.push(
            "damping.internal_s damps the fast waves that a moment excites, as a real elastomer does",
        );
    }
    what.push("--baselines tells what the plant, the time and the controller have in it");
    vec![format!(
        "over the last quarter the tip is {:.1} % of the length off its reference: {}",
        100.0 * off,
        what.join("; ")
    )]
}
