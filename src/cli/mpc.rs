//! `softarm mpc SCENE [--out DIR] [--baselines]`: closed-loop model-predictive control in simulation; with `--serve`, of a plant in another
//! process.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};

use super::console::{Console, stop_signal};
use super::error::CliError;
use super::{Global, Outcome, SceneAndOut, exit, scene_name, serve};
use crate::control::{Hold, PathLimit, RodView};
use crate::mechanics::{Energy, Rod, State, TimeGrid, Trajectory, Wrench};
use crate::mpc::{
    Cause, ClosedLoop, Contender, EstimatorChoice, FallbackSettings, Law, MpcError, Outcome as Run,
    Percentiles, Sample, Sensing, TipError, TipGains, Unknowns,
};
use crate::output::closed_loop::{
    BaselineSummary, LimitPeak, MpcSummary, SampleRow, write_samples,
};
use crate::output::summary::{SCHEMA_VERSION, TOOL};
use crate::output::{
    ControlRow, MotionRecord, OutputError, ResultDirectory, ResultKind, RowFiles, RunDirectory,
    ThinnedMotion, render_report, write_controls,
};
use crate::scene::{ClosedLoopSetup, Scene, SceneSource};
use crate::solve::closed_loop_page;
use crate::stop::{Stop, StopSignal};

#[derive(Debug, Args)]
pub(super) struct MpcArguments {
    #[command(flatten)]
    scene: SceneAndOut,
    /// Also run the plan without feedback and with a regulator about it, a spring and a damper at the tip with the best of 24 pairs of gains, the
    /// controller on an arm that is its model, and on an arm that waits for it; print one table
    #[arg(long)]
    baselines: bool,
    /// Drive a plant in another process: lines of JSON on standard input and output (docs/serving.md); writes no files
    #[arg(long, conflicts_with_all = ["baselines", "out"])]
    serve: bool,
}

/// What runs with `--baselines`.
const BASELINES: [Contender; 5] = [
    Contender::OpenLoop,
    Contender::Regulator,
    Contender::TipPd,
    Contender::PlantIsModel,
    Contender::PlantWaits,
];

/// Lines of progress in a run.
const LINES: usize = 10;

pub(super) fn run(arguments: &MpcArguments, global: &Global, console: &Console) -> Outcome {
    let started = Instant::now();
    console.catch_interrupts();
    let (mut scene, source) = Scene::load(&arguments.scene.scene, &global.set)?;
    let stop = stop_signal(scene.deadline(started));
    let seed = u32::try_from(global.seed()).map_err(|_| {
        CliError::Directory("--seed: a closed loop takes seeds up to 4294967295".into())
    })?;
    if let (Some(mpc), Some(_)) = (&mut scene.mpc, global.seed) {
        mpc.seed = Some(seed);
    }
    let setup = (scene.closed_loop(&source, seed, &stop))
        .map_err(|error| CliError::of_scene(error, &stop))?;
    if arguments.serve {
        for warning in setup.warnings.iter().chain(&setup.unbent_paths(&stop)) {
            console.warn(warning);
        }
        let name = scene_name(&arguments.scene.scene);
        return serve::run(&name, &scene, &source, &setup, &stop, console);
    }
    let target = arguments.scene.directory("mpc");
    let directory = RunDirectory::open(&target, ResultKind::Mpc)?;
    for warning in setup.warnings.iter().chain(&setup.unbent_paths(&stop)) {
        console.warn(warning);
    }
    announce(&setup, console);

    let outcome = computed(
        arguments, &scene, &source, &setup, &directory, &stop, console,
    );
    let (recording, run, baselines) = match outcome {
        Ok(found) => found,
        Err(error) => {
            directory.remove()?;
            return Err(error);
        }
    };
    let ended = stop.raised();
    let mut summary = summarize(arguments, &setup, &run, baselines, ended, started, &target);
    summary.limits.clone_from(&recording.limits.peaks);
    let recording = RefCell::new(recording);
    let written = directory.publish_or_rescue(|result| {
        let summary = MpcSummary {
            directory: result.place().display().to_string(),
            ..summary.clone()
        };
        let mut recording = recording.borrow_mut();
        write(result, &setup, &mut recording, &run.samples, &summary)
    });
    if let Err(OutputError::Elsewhere { place, .. }) = &written {
        summary.directory = place.display().to_string();
    }
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

fn announce(setup: &ClosedLoopSetup, console: &Console) {
    let own = &setup.experiment;
    console.say(&format!(
        "model {} elements, {} steps, plant {}; {:.0} samples of {} s, horizon {} s in blocks of {} s; sensors: {}",
        setup.model.n_elements(),
        setup.model.scheme.name(),
        setup.plant.n_elements(),
        (own.duration / own.mpc.period).round().max(1.0),
        own.mpc.period,
        own.mpc.horizon,
        own.mpc.block,
        setup.resolved.sensor.len(),
    ));
}

type Computed = (Recording, Run, Vec<Run>);

/// The loop, and then the others where they are asked for.
fn computed(
    arguments: &MpcArguments,
    scene: &Scene,
    source: &SceneSource,
    setup: &ClosedLoopSetup,
    directory: &RunDirectory,
    stop: &StopSignal,
    console: &Console,
) -> Result<Computed, CliError> {
    let refused = |error| CliError::of_loop(error, scene, source);
    let mut recording = Recording::begin(setup, &directory.path().join("trajectory"))?;
    let mut progress = Progress::new(setup, console);
    let mut unwritten = None;
    let run = setup
        .experiment
        .run(Contender::Mpc, &mut |sample, closed| {
            progress.see(sample);
            if let Err(error) = recording.see(closed) {
                unwritten = Some(error);
                return ControlFlow::Break(());
            }
            or_stop(stop)
        })
        .map_err(refused)?;
    progress.bar.finish_and_clear();
    if let Some(error) = unwritten {
        return Err(error.into());
    }
    let mut others = Vec::new();
    for contender in BASELINES {
        if !arguments.baselines || stop.is_raised() || run.broke_down.is_some() {
            break;
        }
        console.say(&format!("running {}", label(contender)));
        let mut own = setup.experiment.clone();
        let tuned = if contender == Contender::TipPd {
            own.tuned_tip_gains().map(|gains| {
                console.say(&format!(
                    "  the best of {} pairs of gains: {} times the stiffness of the tip, a damping ratio of {}",
                    TipGains::TRIED.0.len() * TipGains::TRIED.1.len(),
                    gains.stiffness,
                    gains.damping
                ));
                own.settings.law = Law::Tip(gains);
            })
        } else {
            Ok(())
        };
        let other = tuned.and_then(|()| own.run(contender, &mut |_, _| or_stop(stop)));
        if matches!(other, Err(MpcError::Stopped(_))) {
            break;
        }
        others.push(other.map_err(refused)?);
    }
    Ok((recording, run, others))
}

fn or_stop(stop: &StopSignal) -> ControlFlow<()> {
    match stop.check() {
        Ok(()) => ControlFlow::Continue(()),
        Err(_) => ControlFlow::Break(()),
    }
}

/// What becomes of the arm, a row at the beginning and after every sample, and what is sent to it.
struct Recording {
    trajectory: RowFiles,
    controls: Vec<ControlRow>,
    hold: Hold,
    /// For the picture, with the last row.
    thinned: ThinnedMotion,
    row: MotionRecord,
    limits: LimitWatch,
}

/// Looks at the limits of the task on the arm as it is.
struct LimitWatch {
    limits: Vec<PathLimit>,
    radii: Vec<f64>,
    peaks: Vec<LimitPeak>,
}

impl LimitWatch {
    fn new(setup: &ClosedLoopSetup) -> Self {
        let (own, rod) = (&setup.experiment, &setup.plant);
        let radii = own.plant.radii_at_nodes(rod.n_elements());
        let limits: Vec<_> = (own.task.limits.iter())
            .map(|limit| limit.kind.on(rod, &radii))
            .collect();
        let peaks = (own.task.limits.iter().zip(&limits))
            .map(|(named, limit)| LimitPeak {
                name: named.name.clone(),
                excess: f64::NEG_INFINITY,
                unit: limit.unit(),
                at_s: 0.0,
                node: 0,
            })
            .collect();
        Self {
            limits,
            radii,
            peaks,
        }
    }

    fn see(&mut self, rod: &Rod, t: f64, state: &State) {
        if self.limits.is_empty() {
            return;
        }
        let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), 1);
        trajectory.push(&state.configuration);
        let view = RodView {
            rod,
            radii: &self.radii,
            trajectory: &trajectory,
            grid: TimeGrid::instant(t),
        };
        for (limit, peak) in self.limits.iter().zip(&mut self.peaks) {
            let (value, item) = limit.worst(&view, 0);
            let excess = value * limit.scale(rod);
            if excess > peak.excess {
                peak.excess = excess;
                peak.at_s = t;
                peak.node = limit.node(rod, item);
            }
        }
    }
}

impl Recording {
    fn begin(setup: &ClosedLoopSetup, folder: &Path) -> Result<Self, OutputError> {
        let layout = MotionRecord::empty(setup.plant.n_nodes());
        let mut recording = Self {
            trajectory: RowFiles::create(folder, &layout.arrays())?,
            controls: Vec::new(),
            hold: setup.experiment.discretization.hold,
            thinned: ThinnedMotion::new(layout.n_nodes),
            row: layout,
            limits: LimitWatch::new(setup),
        };
        recording.push(&setup.plant, 0.0, &setup.initial, &Wrench::default())?;
        Ok(recording)
    }

    fn push(
        &mut self,
        rod: &Rod,
        t: f64,
        state: &State,
        wrench: &Wrench,
    ) -> Result<(), OutputError> {
        self.limits.see(rod, t, state);
        let mut row = MotionRecord::empty(rod.n_nodes());
        let energy = Energy::of(rod, state);
        let dilatation = rod.dilatation(&state.configuration.positions);
        row.push_state(t, state, wrench, &energy, &dilatation);
        self.trajectory.push(&row.arrays())?;
        self.thinned.push(&row);
        self.row = row;
        Ok(())
    }

    fn see(&mut self, closed: &ClosedLoop) -> Result<(), OutputError> {
        let (arm, command) = (closed.arm(), closed.sent());
        let tip = closed.controller().rod().tip();
        let acting = (command.nodes.iter().zip(arm.acting()))
            .find_map(|(node, wrench)| (*node == tip).then_some(*wrench));
        for (at, &node) in command.nodes.iter().enumerate() {
            let row = |t_start, t_end, wrench: &Wrench| {
                let [fx, fy, fz] = wrench.force.into();
                let [mx, my, mz] = wrench.moment.into();
                ControlRow {
                    t_start,
                    t_end,
                    fx,
                    fy,
                    fz,
                    mx,
                    my,
                    mz,
                    node,
                }
            };
            let (start, end) = (command.start, command.end);
            if self.hold == Hold::Constant {
                self.controls.push(row(start, end, &command.from[at]));
            } else {
                self.controls.push(row(start, start, &command.from[at]));
                self.controls.push(row(end, end, &command.to[at]));
            }
        }
        let state = arm.state();
        self.push(arm.rod(), arm.time(), &state, &acting.unwrap_or_default())
    }
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
                "tip off by {:.3} % of the length (rms)",
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

fn write(
    result: &ResultDirectory,
    setup: &ClosedLoopSetup,
    recording: &mut Recording,
    samples: &[Sample],
    summary: &MpcSummary,
) -> Result<(), OutputError> {
    let path = |name: &str| result.path().join(name);
    recording.trajectory.write_npz(&path("trajectory.npz"))?;
    write_samples(&path("samples.csv"), samples)?;
    write_controls(&path("controls.csv"), &recording.controls)?;
    result.write_text("scene.toml", &setup.resolved.to_toml())?;
    let record = recording.thinned.clone().finish(&recording.row);
    let rows: Vec<SampleRow> = samples.iter().map(SampleRow::of).collect();
    let value = serde_json::to_value(summary).unwrap_or_default();
    let page = closed_loop_page(setup, &rows, &record, &value)?;
    result.write_text("report.html", &render_report(&page))?;
    result.write_json("summary.json", summary)
}

/// Errors that count; not a number where none does.
fn errors(run: &Run, counted_from: f64) -> TipError {
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

fn status(run: &Run, n_samples: usize, ended: Option<Stop>) -> &'static str {
    match ended {
        _ if run.broke_down.is_some() => "failed",
        Some(Stop::Interrupted) if run.samples.len() < n_samples => "interrupted",
        Some(Stop::Deadline) if run.samples.len() < n_samples => "deadline",
        _ => "completed",
    }
}

fn summarize(
    arguments: &MpcArguments,
    setup: &ClosedLoopSetup,
    run: &Run,
    others: Vec<Run>,
    ended: Option<Stop>,
    started: Instant,
    target: &Path,
) -> MpcSummary {
    let own = &setup.experiment;
    let n_samples = (own.duration / own.mpc.period).round().max(1.0) as usize;
    let length = own.arm.length;
    let tally = &run.tally;
    let tip_error = errors(run, own.counted_from);
    let why = |run: &Run| run.broke_down.as_ref().map(ToString::to_string);
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
        scene: scene_name(&arguments.scene.scene),
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
        limits: Vec::new(),
        advice: advice(setup, run, &others),
        transfer_error_m: run.transfer_error,
        seed: (setup.resolved.mpc.as_ref())
            .and_then(|mpc| mpc.seed)
            .unwrap_or_default(),
        wall_s: started.elapsed().as_secs_f64(),
        directory: target.display().to_string(),
    }
}

/// Part of the length that the tip may be off at the end of a loop without a word about it, as the root mean square over the last quarter.
const FAR: f64 = 0.01;

/// What stands between a loop and its reference: an estimate that cannot be trusted, what the loop itself tells, and where the tip is far off at the end, what may be changed.
fn advice(setup: &ClosedLoopSetup, run: &Run, others: &[Run]) -> Vec<String> {
    let mut out = estimate_advice(setup, run);
    out.extend(causes(setup, run, others));
    out.extend(changes(setup, run));
    out
}

/// Causes that figures of the runs name.
fn causes(setup: &ClosedLoopSetup, run: &Run, others: &[Run]) -> Vec<String> {
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
    let patience = own.settings.fallback.patience();
    let needed = FallbackSettings::default()
        .following(setup.sensors())
        .patience();
    let blind = (run.tally.fallbacks).get(&Cause::NoMeasurement.to_string());
    if let Some(blind) = blind.filter(|_| patience < needed) {
        out.push(format!(
            "{blind} samples fell back because nothing was measured for longer than mpc.fallback.patience_s = {patience}: the slowest [[sensor]] needs \
             {needed:.3}, its age_s and two of its periods"
        ));
    }
    let rms = |run: &Run| run.tip_error.rms / length;
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

/// What the filter says about the scene.
fn estimate_advice(setup: &ClosedLoopSetup, run: &Run) -> Vec<String> {
    let mut out = Vec::new();
    if let Some(found) = (run.tally.innovations).filter(|found| found.is_off) {
        let missing = match &setup.experiment.sensing {
            Sensing::Estimated {
                estimator: EstimatorChoice::Kalman(unknowns),
                ..
            } => unknowns.missing(),
            _ => Vec::new(),
        };
        let cause = if missing.is_empty() {
            format!(
                "something is wrong that no unknown describes, such as waves that {} elements do not have (rod.elements), a step of the command from \
                 rest (a bound on its rate takes it away), or a sensor that is noisier than [[sensor]] says",
                setup.model.n_elements()
            )
        } else {
            format!(
                "something is wrong that is not among estimator.disturbances, which lacks {}, or a sensor is noisier than [[sensor]] says",
                missing.join(", ")
            )
        };
        out.push(format!(
            "the estimate is in doubt: the squares of what is measured otherwise than expected are {:.2} times as large as the filter expects \
             (consistent: at most {:.2}); {cause}",
            found.per_number, found.at_most
        ));
    }
    let late = (run.samples.last())
        .map(|last| (last.disturbance.delay, last.deviation.delay))
        .filter(|(delay, deviation)| *deviation > 0.0 && delay.abs() > CERTAIN * deviation);
    if let Some((delay, deviation)) = late {
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

/// What may be changed where the tip is far from its reference at the end.
fn changes(setup: &ClosedLoopSetup, run: &Run) -> Vec<String> {
    let own = &setup.experiment;
    let quarter = 0.75 * own.duration;
    let late = run
        .samples
        .iter()
        .any(|sample| sample.t >= quarter && sample.reference.is_some());
    let off = TipError::of(&run.samples, quarter).rms / own.arm.length;
    if !late || off <= FAR {
        return Vec::new();
    }
    let mut what = Vec::new();
    let looks_for = match &own.sensing {
        Sensing::Everything => Some(Unknowns::NONE),
        Sensing::Estimated { estimator, .. } => match *estimator {
            EstimatorChoice::Observer { .. } => None,
            EstimatorChoice::Kalman(unknowns) => Some(Unknowns {
                wrench_change: Unknowns::NONE.wrench_change,
                ..unknowns
            }),
        },
    };
    match looks_for {
        None => what.push(
            "an observer holds its model against the measurements: estimator.kind = \"kalman\" with estimator.disturbances finds what the model \
             has wrong",
        ),
        Some(unknowns) if unknowns == Unknowns::NONE => what.push(
            "[estimator] with estimator.disturbances finds what the model has wrong, which nothing here looks for",
        ),
        Some(_) => {}
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

fn label(contender: Contender) -> &'static str {
    match contender {
        Contender::OpenLoop => "open loop",
        Contender::Regulator => "regulator",
        Contender::TipPd => "PD at the tip",
        Contender::PlantIsModel => "MPC, plant = model",
        Contender::PlantWaits => "MPC, plant waits",
        _ => "MPC",
    }
}

fn conclude(setup: &ClosedLoopSetup, summary: &MpcSummary, console: &Console) {
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
    for peak in &summary.limits {
        let amount = format!("{:.3e} {}", peak.excess.abs(), peak.unit);
        let verdict = if peak.excess > 0.0 {
            format!("exceeded by {amount}")
        } else {
            format!("kept, {amount} to spare")
        };
        console.say(&format!(
            "  {}: {verdict} at node {}, t = {:.3} s",
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
    console.say(&format!(
        "distance of the tip from its reference, from {} s on, in % of the length",
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
        console.say("angle of the tip from how it should be turned, in rad");
        for (name, other) in found {
            if let Some(turn) = &other.tip_turn_rad {
                line(name, turn, 1.0, other.status);
            }
        }
        line(own, turn, 1.0, summary.status);
    }
    for sentence in &summary.advice {
        console.warn(sentence);
    }
    let needed = setup.experiment.mpc.period;
    if summary.sample_s.p99 > needed {
        let most = if summary.estimate_s.p50 > 0.5 * summary.sample_s.p50 {
            "most of it the estimator's: a smaller estimator.elements, "
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
