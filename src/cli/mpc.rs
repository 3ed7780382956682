//! `softarm mpc SCENE [--out DIR] [--baselines]`: closed-loop model-predictive control in simulation; with `--serve`, of a plant in another
//! process.

use std::path::Path;
use std::time::Instant;

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use super::console::Console;
use super::error::CliError;
use super::{Global, Outcome, SceneAndOut, exit, scene_name, serve};
use crate::mpc::{Contender, Percentiles, Sample, TipError, TipGains};
use crate::output::closed_loop::MpcSummary;
use crate::output::quantity::digits;
use crate::output::{ResultKind, RunDirectory};
use crate::scene::ClosedLoopSetup;
use crate::solve::{BASELINES, LoopError, LoopEvent, LoopOrder, LoopRun, LoopsInDoubt};

#[derive(Debug, Args)]
pub(super) struct MpcArguments {
    #[command(flatten)]
    pub(super) scene: SceneAndOut,
    /// Also run the plan without feedback and with a regulator about it, a spring, a damper and an integral at the tip with the best of 33 sets
    /// of gains, the controller on an arm that is its model, and on an arm that waits for it; print one table
    #[arg(long)]
    baselines: bool,
    /// Drive a plant in another process: lines of JSON on standard input and output (docs/serving.md); writes no files
    #[arg(long, conflicts_with_all = ["baselines", "out"])]
    serve: bool,
}

/// Lines of progress in a run.
const LINES: usize = 10;

pub(super) fn run(arguments: &MpcArguments, global: &Global, console: &Console) -> Outcome {
    let started = Instant::now();
    console.catch_interrupts();
    let (mut scene, source) = console.load(&arguments.scene.scene, global)?;
    let stop = console.stop_signal(scene.deadline(started));
    let seed = u32::try_from(global.seed()).map_err(|_| {
        CliError::Directory("--seed: a closed loop takes seeds up to 4294967295".into())
    })?;
    if let (Some(mpc), Some(_)) = (&mut scene.mpc, global.seed) {
        mpc.seed = Some(seed);
    }
    let mut setup = (scene.closed_loop(&source, seed, &stop))
        .map_err(|error| CliError::of_scene(error, &stop))?;
    if arguments.serve {
        for warning in setup.warnings.iter().chain(&setup.unbent_paths(&stop)) {
            console.warn(warning);
        }
        let name = scene_name(&arguments.scene.scene);
        return serve::run(&name, &scene, &source, &setup, &stop, console);
    }
    let mut doubt = LoopsInDoubt::of(&setup, &source, global.n_threads(), &stop)?;
    if let Some(doubt) = &mut doubt {
        (doubt.narrow(&mut setup, &stop, |line| console.say(line)))
            .map_err(|error| CliError::of_loop(error, &scene, &source))?;
    }
    let target = arguments.scene.directory("mpc");
    let directory = RunDirectory::open(&target, ResultKind::Mpc)?;
    for warning in setup.warnings.iter().chain(&setup.unbent_paths(&stop)) {
        console.warn(warning);
    }
    announce(&setup, console);
    let mut progress = Progress::new(&setup, console);
    let order = LoopOrder {
        setup: &setup,
        name: &scene_name(&arguments.scene.scene),
        baselines: arguments.baselines,
        doubt: doubt.as_ref(),
        target: &target,
        started,
        stop: &stop,
    };
    let ended = order.run(directory, &mut |event| match event {
        LoopEvent::Sample(sample) => {
            progress.see(sample);
            console.event("sample", &SampleEvent::of(sample));
        }
        LoopEvent::Ended => progress.bar.finish_and_clear(),
        LoopEvent::Baseline(contender) => console.say(&format!("running {}", label(contender))),
        LoopEvent::InDoubt => console.say("running the plants of the stated doubt"),
        LoopEvent::Tuned(gains) => console.say(&format!(
            "  the best of {} sets of gains: {} times the stiffness of the tip, a damping ratio of {}, {} integrals a period",
            TipGains::TRIALS,
            gains.stiffness,
            gains.damping,
            gains.integral
        )),
    });
    let LoopRun {
        run,
        ended,
        summary,
        written,
    } = ended.map_err(|error| match error {
        LoopError::Mpc(error) => CliError::of_loop(error, &scene, &source),
        LoopError::Output(error) => CliError::Output(error),
    })?;
    conclude(&setup, &summary, console);
    console.summary(&summary);
    written?;
    Ok(match (&run.broke_down, ended) {
        (Some(error), _) => {
            console.always(&format!("error: the arm's motion broke down: {error}"));
            exit::NUMERICAL
        }
        (None, Some(stop)) => {
            let n = run.samples.len();
            console.always(&format!("{stop} after {n} samples; what ran is written"));
            exit::STOPPED
        }
        (None, None) => exit::DONE,
    })
}

/// A sample as it ends.
#[derive(Serialize)]
struct SampleEvent {
    /// Time at which it began, s.
    t_s: f64,
    /// Position of the tip, m.
    tip_m: [f64; 3],
    /// Distance from its reference, m.
    error_m: Option<f64>,
    /// Reason why the command is not of the plan.
    cause: Option<String>,
    /// Time that the controller took, s.
    sample_s: f64,
}

impl SampleEvent {
    fn of(sample: &Sample) -> Self {
        Self {
            t_s: sample.t,
            tip_m: sample.tip,
            error_m: sample.reference.map(|_| sample.tip_error()),
            cause: (sample.fallback.as_ref()).map(|(cause, _)| cause.to_string()),
            sample_s: sample.sample_s,
        }
    }
}

fn announce(setup: &ClosedLoopSetup, console: &Console) {
    let own = &setup.experiment;
    console.say(&format!(
        "model {} elements, {} steps, plant {}; {:.0} samples of {} s, horizon {} s in blocks of {} s; sensors: {}",
        setup.model.n_elements(),
        setup.model.scheme.name(),
        setup.plant.n_elements(),
        (own.duration / own.mpc.period).round().max(1.0),
        own.mpc.period,
        digits(own.mpc.horizon),
        own.mpc.block,
        setup.resolved.sensor.len(),
    ));
}

/// Running figures.
struct Progress<'a> {
    console: &'a Console,
    bar: ProgressBar,
    length: f64,
    n_samples: usize,
    counted_from: f64,
    squares: f64,
    n_counted: usize,
    seconds: Vec<f64>,
}

impl<'a> Progress<'a> {
    fn new(setup: &ClosedLoopSetup, console: &'a Console) -> Self {
        let own = &setup.experiment;
        let n_samples = (own.duration / own.mpc.period).round().max(1.0) as usize;
        let bar = console.progress(n_samples as u64);
        if let Ok(style) =
            ProgressStyle::with_template("{bar:40} {percent:>3} %  {msg}  {eta} left")
        {
            bar.set_style(style);
        }
        Self {
            console,
            bar,
            length: own.arm.length,
            n_samples,
            counted_from: own.counted_from,
            squares: 0.0,
            n_counted: 0,
            seconds: Vec::new(),
        }
    }

    fn see(&mut self, sample: &Sample) {
        self.seconds.push(sample.sample_s);
        if sample.t >= self.counted_from && sample.reference.is_some() {
            self.squares += sample.tip_error().powi(2);
            self.n_counted += 1;
        }
        let n = self.seconds.len();
        self.bar.inc(1);
        let every = (self.n_samples / LINES).max(1);
        if !n.is_multiple_of(every) {
            return;
        }
        let error = if self.n_counted > 0 {
            let rms = (self.squares / self.n_counted as f64).sqrt();
            format!(
                "off by {:.3} % of the length (rms)",
                100.0 * rms / self.length
            )
        } else {
            "no error counted yet".into()
        };
        let times = Percentiles::of(self.seconds.iter().copied());
        let line = format!(
            "t = {:.3} s: {error}; a sample takes {:.2} ms (p99)",
            sample.t,
            1e3 * times.p99
        );
        self.bar.set_message(line.clone());
        self.bar.suspend(|| self.console.say(&line));
    }
}

/// Names the node that follows a reference.
fn followed(setup: &ClosedLoopSetup) -> String {
    let place = setup.plant.mesh.fraction(setup.followed);
    if setup.followed == setup.plant.tip() {
        "the tip".into()
    } else {
        format!("the node at {} of the length", digits(place))
    }
}

fn label(contender: Contender) -> &'static str {
    match contender {
        Contender::OpenLoop => "open loop",
        Contender::Regulator => "regulator",
        Contender::TipPd => "PID at the tip",
        Contender::PlantIsModel => "MPC, plant = model",
        Contender::PlantWaits => "MPC, plant waits",
        _ => "MPC",
    }
}

fn conclude(setup: &ClosedLoopSetup, summary: &MpcSummary, console: &Console) {
    for peak in summary.limits.iter().filter(|peak| peak.violated) {
        console.say(&format!("VIOLATED: {}", peak.words()));
    }
    say_times(summary, console);
    for peak in &summary.limits {
        let amount = format!("{:.3e} {}", peak.excess.abs(), peak.unit);
        let verdict = if peak.excess > 0.0 {
            format!("exceeded by {amount}")
        } else {
            format!("kept, {amount} to spare")
        };
        let margin = if peak.margin > 0.0 {
            format!(" (plans keep {:.3e} {} inside)", peak.margin, peak.unit)
        } else {
            String::new()
        };
        console.say(&format!(
            "  {}: {verdict} at node {}, t = {:.3} s{margin}",
            peak.name, peak.node, peak.at_s
        ));
    }
    if let Some(found) = &summary.innovations {
        console.say(&format!(
            "  innovations: eᵀS⁻¹e over its numbers is {:.2} (consistent: at most {:.2}); {} signals refused",
            found.per_number, found.at_most, found.refused
        ));
    }
    for (cause, n) in &summary.fallbacks {
        console.say(&format!(
            "  {n} samples without a command of their own: {cause}"
        ));
    }
    if let Some(found) = &summary.doubt {
        console.say(&format!(
            "  {}",
            found.sentence("rms distances from the reference are")
        ));
    }
    say_errors(setup, summary, console);
    for sentence in &summary.advice {
        console.warn(sentence);
    }
    let needed = setup.experiment.mpc.period;
    if summary.sample_s.p99 > needed {
        let most = if summary.estimate_s.p50 > 0.5 * summary.sample_s.p50 {
            "most of it the estimator's: a smaller estimator.elements, a longer estimator.step_s, "
        } else {
            ""
        };
        console.warn(&format!(
            "one sample in a hundred takes more than the period, {} ms here: {most}fewer elements, a shorter mpc.horizon_s, longer blocks, or a \
             longer mpc.period_s",
            1e3 * needed
        ));
    }
    let report = Path::new(&summary.directory).join("report.html");
    console.say(&format!("report: {}", report.display()));
}

/// Prints how long samples and their parts took.
fn say_times(summary: &MpcSummary, console: &Console) {
    let times = |name: &str, p: &Percentiles| {
        console.say(&format!(
            "  {name:9} {:8.3} {:8.3} {:8.3} {:8.3} ms",
            1e3 * p.p50,
            1e3 * p.p95,
            1e3 * p.p99,
            1e3 * p.max
        ));
    };
    console.say(&format!(
        "{} samples, {} overruns of {} ms, {:.1} times real time; a sample takes (p50, p95, p99, longest)",
        summary.samples,
        summary.overruns,
        1e3 * summary.period_s,
        summary.real_time_factor
    ));
    times("whole", &summary.sample_s);
    times("estimate", &summary.estimate_s);
    times("feedback", &summary.feedback_s);
    times("prepare", &summary.prepare_s);
}

/// Prints the errors of the loop beside those of its baselines.
fn say_errors(setup: &ClosedLoopSetup, summary: &MpcSummary, console: &Console) {
    let who = followed(setup);
    console.say(&format!(
        "distance of {who} from its reference, from {} s on, in % of the length",
        summary.counted_from_s
    ));
    console.say("                          rms      95 %   largest      last");
    let line = |name: &str, error: &TipError, unit: f64, status: &str| {
        let numbers = [error.rms, error.p95, error.max, error.last].map(|e| {
            if e.is_finite() {
                format!("{:9.4}", e / unit)
            } else {
                format!("{:>9}", "-")
            }
        });
        let ending = if status == "completed" { "" } else { status };
        console.say(&format!("  {name:18} {} {ending}", numbers.join(" ")));
    };
    let found = (BASELINES.into_iter())
        .filter_map(|other| Some((label(other), summary.baselines.get(other.name())?)));
    for (name, other) in found.clone() {
        line(name, &other.tip_error_over_length, 0.01, other.status);
    }
    let own = label(Contender::Mpc);
    line(own, &summary.tip_error_over_length, 0.01, summary.status);
    if let Some(turn) = &summary.tip_turn_rad {
        console.say(&format!(
            "angle of {who} from how it should be turned, in rad"
        ));
        for (name, other) in found {
            if let Some(turn) = &other.tip_turn_rad {
                line(name, turn, 1.0, other.status);
            }
        }
        line(own, turn, 1.0, summary.status);
    }
}
