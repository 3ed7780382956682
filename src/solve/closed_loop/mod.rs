//! A closed loop from its first sample to its files: what the verb `mpc` calls.

mod advice;
mod doubt;
mod recording;

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use self::advice::advice;
pub(crate) use self::doubt::LoopsInDoubt;
use self::recording::Recording;
use crate::mpc::{Contender, Law, MpcError, Outcome, Sample, TipError, TipGains};
use crate::output::closed_loop::{BaselineSummary, LimitPeak, MpcSummary};
use crate::output::summary::{SCHEMA_VERSION, TOOL};
use crate::output::{OutputError, RunDirectory};
use crate::scene::ClosedLoopSetup;
use crate::stop::{Stop, StopSignal};
use crate::verify::doubt::UnderDoubt;

/// Other laws and other arms that a loop is compared with.
pub(crate) const BASELINES: [Contender; 5] = [
    Contender::OpenLoop,
    Contender::Regulator,
    Contender::TipPd,
    Contender::PlantIsModel,
    Contender::PlantWaits,
];

/// Why a closed loop has no result.
#[derive(Debug, thiserror::Error)]
pub(crate) enum LoopError {
    /// The controller, or that of a baseline, cannot begin.
    #[error(transparent)]
    Mpc(#[from] MpcError),
    /// A file cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

/// Progress of a closed loop.
pub(crate) enum LoopEvent<'a> {
    /// A sample of the loop has run.
    Sample(&'a Sample),
    /// The loop has ended.
    Ended,
    /// A baseline begins.
    Baseline(Contender),
    /// The best gains of those that were tried.
    Tuned(&'a TipGains),
    /// The loop begins on the plants of the stated doubt.
    InDoubt,
}

/// A closed loop that has ended.
pub(crate) struct LoopRun {
    pub run: Outcome,
    /// Why it ended early.
    pub ended: Option<Stop>,
    pub summary: MpcSummary,
    /// The result directory, or why it could not be written.
    pub written: Result<PathBuf, OutputError>,
}

/// A closed loop to be run, and where its result goes.
pub(crate) struct LoopOrder<'a> {
    pub setup: &'a ClosedLoopSetup,
    /// Name of the scene.
    pub name: &'a str,
    /// Tells whether the [baselines](BASELINES) run as well.
    pub baselines: bool,
    /// The plants of the stated doubt, on which the loop runs as well.
    pub doubt: Option<&'a LoopsInDoubt>,
    pub target: &'a Path,
    pub started: Instant,
    pub stop: &'a StopSignal,
}

impl LoopOrder<'_> {
    /// Runs the loop, and then the others, and writes the result by way of `directory`.
    ///
    /// # Errors
    /// [`LoopError`] where there is nothing to write.
    pub fn run(
        &self,
        directory: RunDirectory,
        tell: &mut dyn FnMut(LoopEvent),
    ) -> Result<LoopRun, LoopError> {
        let computed = Recording::begin(self.setup, &directory.path().join("trajectory"))
            .map_err(LoopError::from)
            .and_then(|mut recording| {
                let run = self.own(&mut recording, tell)?;
                let mut missing = BTreeMap::new();
                let others = self.others(&run, &mut missing, tell)?;
                let doubt = self.in_doubt(&run, tell)?;
                Ok((recording, run, others, missing, doubt))
            });
        let (recording, run, others, missing, doubt) = match computed {
            Ok(found) => found,
            Err(error) => {
                directory.remove()?;
                return Err(error);
            }
        };
        let ended = self.stop.raised();
        let mut summary = self.summarize(&run, &others, recording.limits.peaks.clone(), ended);
        summary.advice.extend(recording.beyond.sentence());
        summary.baselines.extend(missing);
        let broken = self.doubt.zip(doubt.as_ref());
        (summary.advice).extend(broken.and_then(|(plants, found)| plants.broken_promise(found)));
        summary.doubt = doubt;
        summary.efforts = recording.effort_ranges(&self.setup.plant);
        summary.slack = recording.slack(&self.setup.plant);
        (summary.advice).extend(recording.slack_advice(self.setup, &run));
        let recording = RefCell::new(recording);
        let written = directory.publish_or_rescue(|result| {
            let summary = MpcSummary {
                directory: result.place().display().to_string(),
                ..summary.clone()
            };
            let mut recording = recording.borrow_mut();
            recording.write(result, self.setup, &run.samples, &summary)
        });
        if let Err(OutputError::Elsewhere { place, .. }) = &written {
            summary.directory = place.display().to_string();
        }
        Ok(LoopRun {
            run,
            ended,
            summary,
            written,
        })
    }

    /// The loop of the scene itself.
    fn own(
        &self,
        recording: &mut Recording,
        tell: &mut dyn FnMut(LoopEvent),
    ) -> Result<Outcome, LoopError> {
        let mut unwritten = None;
        let experiment = &self.setup.experiment;
        let run = experiment.run(Contender::Mpc, &mut |sample, closed| {
            tell(LoopEvent::Sample(sample));
            if let Err(error) = recording.see(sample, closed) {
                unwritten = Some(error);
                return ControlFlow::Break(());
            }
            self.or_stop()
        })?;
        tell(LoopEvent::Ended);
        match unwritten {
            Some(error) => Err(error.into()),
            None => Ok(run),
        }
    }

    /// The baselines, where they are asked for, up to where they are stopped; those that do not exist for this arm become `missing`.
    fn others(
        &self,
        run: &Outcome,
        missing: &mut BTreeMap<&'static str, BaselineSummary>,
        tell: &mut dyn FnMut(LoopEvent),
    ) -> Result<Vec<Outcome>, LoopError> {
        let mut others = Vec::new();
        for contender in BASELINES {
            if !self.baselines || self.stop.is_raised() || run.broke_down.is_some() {
                break;
            }
            tell(LoopEvent::Baseline(contender));
            let mut own = self.setup.experiment.clone();
            let tuned = if contender == Contender::TipPd {
                own.tuned_tip_gains().map(|gains| {
                    tell(LoopEvent::Tuned(&gains));
                    own.settings.law = Law::Tip(gains);
                })
            } else {
                Ok(())
            };
            let other = tuned.and_then(|()| own.run(contender, &mut |_, _| self.or_stop()));
            match other {
                Err(MpcError::Stopped(_)) => break,
                Err(MpcError::Unsupported(why)) if contender == Contender::TipPd => {
                    missing.insert(contender.name(), BaselineSummary::missing(why));
                }
                other => others.push(other?),
            }
        }
        Ok(others)
    }

    /// The loop on the plants of the stated doubt, if it states one; absent where these are stopped.
    fn in_doubt(
        &self,
        run: &Outcome,
        tell: &mut dyn FnMut(LoopEvent),
    ) -> Result<Option<UnderDoubt>, LoopError> {
        let Some(doubt) = self.doubt.filter(|_| run.broke_down.is_none()) else {
            return Ok(None);
        };
        tell(LoopEvent::InDoubt);
        match doubt.run(self.stop) {
            Ok(found) => Ok(Some(found)),
            Err(MpcError::Stopped(_)) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    fn or_stop(&self) -> ControlFlow<()> {
        match self.stop.check() {
            Ok(()) => ControlFlow::Continue(()),
            Err(_) => ControlFlow::Break(()),
        }
    }

    fn summarize(
        &self,
        run: &Outcome,
        others: &[Outcome],
        limits: Vec<LimitPeak>,
        ended: Option<Stop>,
    ) -> MpcSummary {
        let setup = self.setup;
        let own = &setup.experiment;
        let n_samples = (own.duration / own.mpc.period).round().max(1.0) as usize;
        let length = own.arm.length;
        let tally = &run.tally;
        let tip_error = errors(run, own.counted_from);
        let why = |run: &Outcome| run.broke_down.as_ref().map(ToString::to_string);
        let baselines: BTreeMap<_, _> = others
            .iter()
            .map(|run| {
                let tip_error = errors(run, own.counted_from);
                let summary = BaselineSummary {
                    status: status(run, n_samples, ended),
                    error: why(run),
                    samples: run.samples.len(),
                    tip_error_m: tip_error,
                    tip_error_over_length: over(tip_error, length),
                    tip_turn_rad: run.tip_turn,
                };
                (run.contender.name(), summary)
            })
            .collect();
        MpcSummary {
            schema_version: SCHEMA_VERSION,
            tool: TOOL,
            command: "mpc",
            scene: self.name.into(),
            status: status(run, n_samples, ended),
            error: why(run),
            samples: tally.samples,
            period_s: own.mpc.period,
            horizon_s: own.mpc.horizon,
            elements: setup.model.n_elements(),
            plant_elements: setup.plant.n_elements(),
            overruns: tally.overruns,
            sample_s: tally.sample_s,
            estimate_s: tally.estimate_s,
            feedback_s: tally.feedback_s,
            prepare_s: tally.prepare_s,
            first_sample_s: tally.first_s,
            real_time_factor: tally.real_time_factor,
            counted_from_s: own.counted_from,
            tip_error_m: tip_error,
            tip_error_over_length: over(tip_error, length),
            tip_turn_rad: run.tip_turn,
            baselines,
            fallbacks: tally.fallbacks.clone(),
            innovations: tally.innovations,
            bounded: tally.bounded,
            breaking: tally.breaking,
            efforts: Vec::new(),
            slack: Vec::new(),
            doubt: None,
            advice: advice(setup, run, others, &limits),
            limits,
            transfer_error_m: run.transfer_error,
            seed: (setup.resolved.mpc.as_ref())
                .and_then(|mpc| mpc.seed)
                .unwrap_or_default(),
            wall_s: self.started.elapsed().as_secs_f64(),
            directory: self.target.display().to_string(),
        }
    }
}

/// Errors that count; not a number where none does.
fn errors(run: &Outcome, counted_from: f64) -> TipError {
    let counts = |sample: &Sample| sample.t >= counted_from && sample.reference.is_some();
    if run.samples.iter().any(counts) {
        return run.tip_error;
    }
    TipError {
        last: f64::NAN,
        rms: f64::NAN,
        p95: f64::NAN,
        max: f64::NAN,
    }
}

fn over(error: TipError, length: f64) -> TipError {
    TipError {
        last: error.last / length,
        rms: error.rms / length,
        p95: error.p95 / length,
        max: error.max / length,
    }
}

fn status(run: &Outcome, n_samples: usize, ended: Option<Stop>) -> &'static str {
    match ended {
        _ if run.broke_down.is_some() => "failed",
        Some(Stop::Interrupted) if run.samples.len() < n_samples => "interrupted",
        Some(Stop::Deadline) if run.samples.len() < n_samples => "deadline",
        _ => "completed",
    }
}
