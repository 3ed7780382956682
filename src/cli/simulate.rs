//! `softarm simulate SCENE [--out DIR] [--resume]`: forward simulation with rows on disk and checkpoints.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use nalgebra::{Matrix3, Vector3};

use super::accuracy::of_simulation as accurate;
use super::check::{output_size, size_warning, warnings};
use super::clearance::Clearances;
use super::console::{Console, stop_signal};
use super::error::CliError;
use super::{Global, Outcome, SceneAndOut, exit, memory, scene_name};
use crate::mechanics::rotation::quaternion;
use crate::mechanics::{
    Diagnostics, Energy, NodeWrenches, PowerBalance, Rod, State, StepError, Stepper, Wrench,
};
use crate::memory::of_simulation;
use crate::output::summary::{
    EnergySummary, Range, SCHEMA_VERSION, SimulateSummary, TOOL, TipPose,
};
use crate::output::{
    ArrayView, BaseReaction, Checkpoint, DiagnosticsRecord, Extremes, MotionRecord, OutputError,
    ResultDirectory, ResultKind, RowFiles, RowPrefix, RunDirectory, ThinnedMotion, render_report,
};
use crate::scene::{MOST_ELEMENTS, Scene, SceneSource, Simulation, TimeStep};
use crate::solve::{causes, simulation_page, stands_by_symmetry};
use crate::stop::{Stop, StopSignal};

/// Steps between two whose energy counts as an extreme; a divisor of [`Stepper::SEAT`], so that a motion that goes on looks at the same ones.
const ENERGY_EVERY: usize = 8;
/// At most this much work is lost when the process is killed.
const CHECKPOINT_PERIOD: Duration = Duration::from_secs(1);
/// Relative difference below which two step lengths are one: roundings of a quotient.
const SAME_STEP: f64 = 1e-9;

pub(super) fn run(
    arguments: &SceneAndOut,
    resume: bool,
    global: &Global,
    console: &Console,
) -> Outcome {
    let began = Instant::now();
    console.catch_interrupts();
    let (scene, source) = Scene::load(&arguments.scene, &global.set)?;
    let stop = stop_signal(scene.deadline(began));
    let target = arguments.directory("simulate");
    let mut accuracy = None;
    let (directory, setup, found) = if resume {
        let directory = Found::directory(&target)?;
        let found = Found::beside(&directory, &target, &scene)?;
        let setup = continued(&scene, &source, &found.checkpoint, &stop)?;
        (directory, setup, Some(found))
    } else {
        let (scene, chosen) = accurate(scene.clone(), &source, &stop, console)?;
        accuracy = chosen;
        let setup = (scene.simulation_until(&source, &stop))
            .map_err(|error| CliError::of_scene(error, &stop))?;
        let directory = RunDirectory::open(&target, ResultKind::Simulate)?;
        (directory, setup, None)
    };
    memory::require(&of_simulation(&setup), &source)?;
    let mut concerns = warnings(&scene, &setup.rod, setup.grid.step);
    concerns.extend(size_warning(&output_size(&setup)));
    concerns.extend(setup.row_warning());
    let duration = setup.grid.duration();
    concerns.extend(stands_by_symmetry(&setup.rod, &setup.initial, duration));
    for warning in concerns {
        console.warn(&warning);
    }
    if scene.task.is_some() || scene.control.is_some() {
        console.warn("[task] and [control] play no part in a simulation; `softarm solve` computes the control");
    }

    let opened = match &found {
        Some(found) => Run::resume(&setup, &directory, found, &target),
        None => Run::start(&setup, &directory),
    };
    let mut run = match opened {
        Ok(run) => run,
        Err(error) => {
            if found.is_none_or(|found| !found.killed) {
                directory.remove()?;
            }
            return Err(error);
        }
    };
    let first_step = run.integrator.step();
    if resume {
        console.say(&format!(
            "continuing at step {first_step} of {}, t = {:.6} s",
            setup.grid.n_steps,
            run.integrator.time()
        ));
    }
    let started = Instant::now();
    let folder = directory.path().to_path_buf();
    let kept = |source: OutputError| OutputError::Kept {
        source: Box::new(source),
        folder: folder.clone(),
    };
    let end = match run.integrate(&stop, console) {
        Ok(end) => end,
        Err(CliError::Output(error)) if Checkpoint::is_in(&folder) => {
            return Err(kept(error).into());
        }
        Err(error) => {
            directory.remove()?;
            return Err(error);
        }
    };
    let wall = started.elapsed().as_secs_f64();

    let summary = SimulateSummary {
        accuracy,
        ..run.summarize(arguments, &end, first_step, wall, &target)
    };
    let written = directory
        .publish(|result| run.write(result, &scene, &end, &summary))
        .map_err(kept)?;

    let speed = if summary.steps > first_step {
        format!(
            ", the integrator alone {:.1} ns per node-step",
            1e9 / summary.node_steps_per_s
        )
    } else {
        String::new()
    };
    console.say(&format!(
        "{} steps of {:.3e} s in {:.3} s{speed}",
        summary.steps - first_step,
        summary.step_s,
        summary.wall_s
    ));
    if let Some(warning) = stretch_warning(&summary.dilatation) {
        console.warn(&warning);
    }
    for clearance in &summary.clearance {
        console.say(&clearance.in_words());
        if clearance.least_m < 0.0 {
            console.warn(&format!(
                "{}: the arm goes through it: a simulation does not know obstacles",
                clearance.obstacle
            ));
        }
    }
    let tip = summary.tip.position_m;
    console.say(&format!(
        "tip at ({:.6}, {:.6}, {:.6}) m; energy {:.6e} J at the start, {:.6e} J at the end",
        tip[0], tip[1], tip[2], summary.energy.initial, summary.energy.r#final
    ));
    console.say(&format!(
        "report: {}",
        written.join("report.html").display()
    ));
    console.summary(&summary);
    Ok(match end {
        End::Completed => exit::DONE,
        End::Interrupted => {
            let why = stop.raised().unwrap_or(Stop::Interrupted);
            console.always(&format!("{why}; the same command with --resume goes on"));
            exit::STOPPED
        }
        End::Failed(error) => {
            console.error(&error.into());
            for cause in causes(&setup.rod, &setup.initial, &setup.grid) {
                console.always(&cause);
            }
            exit::NUMERICAL
        }
    })
}

/// What an earlier run left to continue.
struct Found {
    checkpoint: Checkpoint,
    /// Whether the run was killed: its rows are still in files of their own.
    killed: bool,
}

impl Found {
    /// Takes hold of the directory of the run, if there is anything to continue.
    fn directory(target: &Path) -> Result<RunDirectory, CliError> {
        if Checkpoint::is_in(&RunDirectory::folder_of(target)?) || Checkpoint::is_in(target) {
            Ok(RunDirectory::open(target, ResultKind::Simulate)?)
        } else {
            Err(Self::nothing(target))
        }
    }

    /// A run that was killed, or else one that wrote its result.
    fn beside(directory: &RunDirectory, target: &Path, scene: &Scene) -> Result<Self, CliError> {
        let elements = match scene.accuracy() {
            Some(_) => MOST_ELEMENTS,
            None => scene.rod.elements,
        };
        let most_bytes = Checkpoint::most_bytes(elements + 1, scene.to_toml().len());
        for (folder, killed) in [(directory.path(), true), (target, false)] {
            if let Some(checkpoint) = Checkpoint::read(folder, most_bytes)? {
                return Ok(Self { checkpoint, killed });
            }
        }
        Err(Self::nothing(target))
    }

    fn nothing(target: &Path) -> CliError {
        CliError::Directory(format!(
            "{}: holds no checkpoint to continue from; run without --resume",
            target.display()
        ))
    }
}

/// The simulation that a checkpoint belongs to, on its grid; `time.end_s` may be later.
fn continued(
    scene: &Scene,
    source: &SceneSource,
    checkpoint: &Checkpoint,
    stop: &StopSignal,
) -> Result<Simulation, CliError> {
    let (earlier, _) = Scene::from_toml("the scene of the checkpoint", &checkpoint.scene, &[])?;
    let mut scene = scene.clone();
    if scene.accuracy().is_some() {
        scene = scene.with_grid(&earlier.discretization());
    }
    if scene.time.step_s == TimeStep::Auto {
        scene.time.step_s = earlier.time.step_s;
    }
    let mut setup =
        (scene.simulation_until(source, stop)).map_err(|error| CliError::of_scene(error, stop))?;
    let refuse = |reason: String| {
        Err(CliError::Directory(format!(
            "cannot resume: {reason}; restore it, or run without --resume"
        )))
    };
    let timeless = Scene {
        time: earlier.time.clone(),
        ..setup.resolved.clone()
    };
    if timeless != earlier {
        let (now, then) = (timeless.to_toml(), earlier.to_toml());
        let mut lines = now.lines().zip(then.lines());
        let (now, then) = lines.find(|(now, then)| now != then).unwrap_or_default();
        return refuse(format!(
            "the scene has changed (`{}`, and in the earlier run `{}`)",
            now.trim(),
            then.trim()
        ));
    }
    let step = checkpoint.step_s;
    if !((setup.grid.step - step).abs() <= SAME_STEP * step) {
        return refuse(format!(
            "the earlier run has steps of {step} s, and this one of {} s; time.end_s must be a whole number of the \
             earlier steps, for instance {}, and time.step_s may be left out",
            setup.grid.step,
            (scene.time.end_s.get() / step).round() * step
        ));
    }
    setup.grid.step = step;
    setup.resolved.time.step_s = TimeStep::Seconds(step);
    let rows = checkpoint.step / setup.steps_per_row + 1; // and one at the end
    if checkpoint.n_nodes() != setup.rod.n_nodes()
        || !checkpoint.step.is_multiple_of(Stepper::SEAT)
        || !(rows..=rows + 1).contains(&checkpoint.trajectory.rows)
        || checkpoint.diagnostics.is_some() != setup.diagnostics
    {
        return refuse(format!(
            "the checkpoint, of {} nodes and {} rows at step {}, is not one of this scene",
            checkpoint.n_nodes(),
            checkpoint.trajectory.rows,
            checkpoint.step
        ));
    }
    if setup.grid.n_steps < checkpoint.step {
        return refuse(format!(
            "time.end_s is {} s, before the {} s from where the earlier run can be continued",
            scene.time.end_s,
            setup.grid.time(checkpoint.step)
        ));
    }
    if setup.n_rows(checkpoint.step) > checkpoint.trajectory.rows {
        return refuse(format!(
            "time.end_s is {} s, from where the earlier run can be continued, but it has no row there; choose a later one",
            scene.time.end_s
        ));
    }
    Ok(setup)
}

/// Elements that leave this range of dilatations are outside what any [model](crate::mechanics::RodModel) describes: a
/// section of constant volume or size, and a linear material.
const CREDIBLE_DILATATION: [f64; 2] = [0.5, 2.0];

fn stretch_warning(dilatation: &Range) -> Option<String> {
    let [least, largest] = CREDIBLE_DILATATION;
    (dilatation.min < least || dilatation.max > largest).then(|| {
        format!(
            "elements went from {:.3e} to {:.3e} of their length; rod models hold within about 0.7 to 1.3, and the standard \
             one lets an element turn inside out; soften the loads, or stiffen the rod",
            dilatation.min, dilatation.max
        )
    })
}

/// How a run ended.
enum End {
    Completed,
    Interrupted,
    Failed(StepError),
}

/// A simulation on its way. Rows go to files, so that memory does not grow with them; from time to time, a checkpoint
/// says how far they count.
struct Run<'a> {
    setup: &'a Simulation,
    /// Where rows and checkpoints go.
    folder: PathBuf,
    integrator: Stepper<'a>,
    trajectory: RowFiles,
    diagnostics: Option<RowFiles>,
    /// The rows of both at the last step from which the run can be resumed.
    resumable: (RowPrefix, Option<RowPrefix>, Extremes),
    /// The last state that was looked at without a row.
    seen: State,
    /// The last row.
    row: MotionRecord,
    thinned: ThinnedMotion,
    tally: Tally,
    /// Time that the integrator took.
    stepping: Duration,
}

impl<'a> Run<'a> {
    /// From the beginning; what an earlier run left is removed.
    fn start(setup: &'a Simulation, directory: &RunDirectory) -> Result<Self, CliError> {
        directory.clear()?;
        let files = |name: &str, layout: &[ArrayView]| {
            RowFiles::create(&directory.path().join(name), layout)
        };
        let row = MotionRecord::empty(setup.rod.n_nodes());
        let diagnostics = DiagnosticsRecord::empty(setup.rod.n_elements());
        let mut run = Self {
            setup,
            folder: directory.path().into(),
            integrator: Stepper::new(&setup.rod, setup.grid.step, setup.initial.clone()),
            trajectory: files("trajectory", &row.arrays())?,
            diagnostics: if setup.diagnostics {
                Some(files("diagnostics", &diagnostics.arrays())?)
            } else {
                None
            },
            resumable: (RowPrefix::default(), None, Extremes::EMPTY),
            stepping: Duration::ZERO,
            seen: setup.initial.clone(),
            thinned: ThinnedMotion::new(row.n_nodes),
            row,
            tally: Tally::of(setup),
        };
        run.observe(None)?;
        Ok(run)
    }

    /// From a checkpoint, with the rows up to it.
    fn resume(
        setup: &'a Simulation,
        directory: &RunDirectory,
        found: &Found,
        target: &Path,
    ) -> Result<Self, CliError> {
        let checkpoint = &found.checkpoint;
        if !found.killed {
            directory.clear()?;
        }
        let n_rows = setup.n_rows(checkpoint.step);
        // A result ends before the next step from which it could be resumed, with one more row at its end.
        let most_rows = (checkpoint.step + Stepper::SEAT) / setup.steps_per_row + 2;
        let files = |name: &str,
                     layout: &[ArrayView],
                     written: RowPrefix,
                     visit: &mut dyn FnMut(&[Vec<f64>])| {
            let folder = directory.path().join(name);
            if !found.killed {
                let archive = target.join(format!("{name}.npz"));
                RowFiles::unpack(&archive, &folder, layout, most_rows)?;
            }
            RowFiles::resume(&folder, layout, written, n_rows, visit)
        };
        let layout = MotionRecord::empty(setup.rod.n_nodes());
        let mut row = layout.clone();
        let mut thinned = ThinnedMotion::new(row.n_nodes);
        let mut tally = Tally::of(setup);
        let trajectory = files(
            "trajectory",
            &layout.arrays(),
            checkpoint.trajectory,
            &mut |values| {
                for (array, values) in row.arrays_mut().into_iter().zip(values) {
                    array.clone_from(values);
                }
                thinned.push(&row);
                // The checkpoint has the energies that count.
                tally.include(&row, &setup.rod, false);
            },
        )?;
        tally.extremes.widen(&checkpoint.extremes);
        let layout = DiagnosticsRecord::empty(setup.rod.n_elements());
        let diagnostics = (checkpoint.diagnostics)
            .map(|written| files("diagnostics", &layout.arrays(), written, &mut |_| ()))
            .transpose()?;
        Ok(Self {
            setup,
            folder: directory.path().into(),
            integrator: Stepper::resume(
                &setup.rod,
                setup.grid.step,
                checkpoint.state(),
                checkpoint.step,
            ),
            trajectory,
            diagnostics,
            resumable: (RowPrefix::default(), None, Extremes::EMPTY),
            stepping: Duration::ZERO,
            seen: setup.initial.clone(),
            row,
            thinned,
            tally,
        })
    }

    /// Steps to the end, or until something happens.
    fn integrate(&mut self, stop: &StopSignal, console: &Console) -> Result<End, CliError> {
        let n_steps = self.setup.grid.n_steps;
        let bar = console.progress(n_steps as u64);
        bar.set_position(self.integrator.step() as u64);
        bar.reset_eta();
        self.note_rows();
        self.save()?;
        let mut saved = Instant::now();
        let end = loop {
            let k = self.integrator.step();
            if k.is_multiple_of(Stepper::SEAT) {
                self.note_rows();
            }
            if k == n_steps {
                break End::Completed;
            }
            if stop.check_at(k).is_err() {
                break End::Interrupted;
            }
            if k.is_multiple_of(Stepper::SEAT) {
                bar.set_position(k as u64);
                if saved.elapsed() > CHECKPOINT_PERIOD {
                    self.save()?;
                    saved = Instant::now();
                }
            }
            let leads_to_row = self.setup.n_rows(k + 1) > self.trajectory.n_rows();
            let before = (leads_to_row && self.setup.diagnostics).then(|| self.integrator.state());
            let started = Instant::now();
            let advanced = self.integrator.advance([NodeWrenches::NONE; 2]);
            self.stepping += started.elapsed();
            if let Err(error) = advanced {
                break End::Failed(error);
            }
            let seen = if leads_to_row {
                self.observe(before.as_ref())
            } else {
                self.count().map_err(CliError::from)
            };
            match seen {
                Err(CliError::Step(error)) => break End::Failed(error),
                other => other?,
            }
        };
        bar.finish_and_clear();
        if !matches!(end, End::Failed(_)) {
            self.save()?;
        }
        Ok(end)
    }

    /// Writes a row; `before` is the state one step ago.
    fn observe(&mut self, before: Option<&State>) -> Result<(), CliError> {
        let (rod, t) = (&self.setup.rod, self.integrator.time());
        let state = &self.integrator.state();
        let mut row = MotionRecord::empty(rod.n_nodes());
        row.push_state(
            t,
            state,
            &tip_load(rod, t, state),
            &Energy::of(rod, state),
            &rod.dilatation(&state.configuration.positions),
        );
        self.check_finite(&row.arrays())?;
        if self.setup.diagnostics {
            let h = self.setup.grid.step;
            let power = before.map_or_else(PowerBalance::default, |before| {
                PowerBalance::over_step(rod, h, t, before, state)
            });
            let row = DiagnosticsRecord::row(t, &Diagnostics::of(rod, h, t, state), &power);
            self.check_finite(&row.arrays())?;
            if let Some(files) = &mut self.diagnostics {
                files.push(&row.arrays())?;
            }
        }
        self.trajectory.push(&row.arrays())?;
        self.thinned.push(&row);
        let counts = self.integrator.step().is_multiple_of(ENERGY_EVERY);
        self.tally.include(&row, rod, counts);
        self.row = row;
        Ok(())
    }

    /// Counts a step that has no row among the extremes; its energy only at some steps, because it takes several times as long as the step.
    fn count(&mut self) -> Result<(), StepError> {
        let rod = &self.setup.rod;
        if self.integrator.step().is_multiple_of(ENERGY_EVERY) {
            self.integrator.write_state(&mut self.seen);
            let energy = Energy::of(rod, &self.seen).total();
            if !energy.is_finite() {
                return Err(StepError::NotFinite {
                    node: rod.tip(),
                    step: self.integrator.step(),
                    time: self.integrator.time(),
                    quantity: "energy",
                });
            }
            self.tally.extremes.energy.include(energy);
        }
        let mut before = self.integrator.position(0);
        let elements = rod.elements.iter().enumerate().map(|(q, element)| {
            let next = self.integrator.position(q + 1);
            let chord = (next - before).norm();
            before = next;
            (chord / element.length, element.length)
        });
        self.tally.extremes.include_lengths(elements);
        Ok(())
    }

    /// A motion that grows without bound shows in its energy before a position overflows.
    fn check_finite(&self, row: &[ArrayView]) -> Result<(), StepError> {
        let finite = |values: &[f64]| values.iter().all(|value| value.is_finite());
        match row.iter().find(|(_, _, values)| !finite(values)) {
            None => Ok(()),
            Some(&(quantity, _, _)) => Err(StepError::NotFinite {
                node: self.setup.rod.tip(),
                step: self.integrator.step(),
                time: self.integrator.time(),
                quantity,
            }),
        }
    }

    fn checkpoint(&self) -> Checkpoint {
        let (step, state) = self.integrator.seat();
        let scene = self.setup.resolved.to_toml();
        let (trajectory, diagnostics, extremes) = self.resumable;
        Checkpoint::new(
            *step,
            self.setup.grid.step,
            state,
            &scene,
            trajectory,
            diagnostics,
            extremes,
        )
    }

    /// Takes note of the rows that belong to the integrator's [seat](Stepper::seat), which is at the present step.
    fn note_rows(&mut self) {
        let diagnostics = self.diagnostics.as_ref().map(RowFiles::prefix);
        self.resumable = (self.trajectory.prefix(), diagnostics, self.tally.extremes);
    }

    /// Makes sure that a run that dies from here on can be continued from here. Rows first: a checkpoint never promises
    /// rows that are not there.
    fn save(&mut self) -> Result<(), OutputError> {
        self.trajectory.flush()?;
        if let Some(diagnostics) = &mut self.diagnostics {
            diagnostics.flush()?;
        }
        self.checkpoint().write(&self.folder)
    }

    /// Writes the files of the result.
    fn write(
        mut self,
        result: &ResultDirectory,
        scene: &Scene,
        end: &End,
        summary: &SimulateSummary,
    ) -> Result<(), OutputError> {
        self.trajectory
            .write_npz(&result.path().join("trajectory.npz"))?;
        if let Some(diagnostics) = &mut self.diagnostics {
            diagnostics.write_npz(&result.path().join("diagnostics.npz"))?;
        }
        if !matches!(end, End::Failed(_)) {
            self.checkpoint().write(result.path())?;
        }
        result.write_text("scene.toml", &self.setup.resolved.to_toml())?;
        result.write_json("summary.json", summary)?;
        let record = self.thinned.finish(&self.row);
        let diagnostics = result.path().join("diagnostics.npz");
        let base = (self.diagnostics.is_some())
            .then(|| BaseReaction::read(&diagnostics, self.trajectory.n_rows()))
            .transpose()?;
        let summary = serde_json::to_value(summary).unwrap_or_default();
        let page = simulation_page(scene, self.setup, &record, &summary, base.as_ref())?;
        result.write_text("report.html", &render_report(&page))
    }

    fn summarize(
        &self,
        arguments: &SceneAndOut,
        end: &End,
        first_step: usize,
        wall: f64,
        target: &Path,
    ) -> SimulateSummary {
        let rod = &self.setup.rod;
        let tip = rod.tip();
        let error = match end {
            End::Failed(error) => {
                let mut sentences = vec![error.to_string()];
                sentences.extend(causes(rod, &self.setup.initial, &self.setup.grid));
                Some(sentences.join("; "))
            }
            End::Completed | End::Interrupted => None,
        };
        let (position, rotation) = if error.is_some() {
            // The integrator's state is spoiled.
            let row = &self.row;
            (
                Vector3::from_column_slice(&row.x[3 * tip..]),
                Matrix3::from_row_slice(&row.rotation[9 * tip..]),
            )
        } else {
            let configuration = self.integrator.state().configuration;
            (configuration.positions[tip], configuration.rotations[tip])
        };
        let q = quaternion(&rotation);
        let steps = self.integrator.step();
        let mut extremes = self.tally.extremes;
        extremes.energy.include(self.tally.last);
        SimulateSummary {
            schema_version: SCHEMA_VERSION,
            tool: TOOL,
            command: "simulate",
            scene: scene_name(&arguments.scene),
            status: match end {
                End::Completed => "completed",
                End::Interrupted => "interrupted",
                End::Failed(_) => "failed",
            },
            error,
            model: rod.model.name(),
            strain: rod.strain_rule.name(),
            elements: rod.n_elements(),
            step_s: self.setup.grid.step,
            steps,
            wall_s: wall,
            node_steps_per_s: ((steps - first_step) * rod.n_nodes()) as f64
                / (self.stepping.as_secs_f64()).max(f64::MIN_POSITIVE),
            tip: TipPose {
                position_m: position.into(),
                orientation_wxyz: [q.w, q.i, q.j, q.k],
            },
            energy: EnergySummary {
                initial: self.tally.initial,
                r#final: self.tally.last,
                min: extremes.energy.min,
                max: extremes.energy.max,
            },
            dilatation: extremes.dilatation,
            length_m: extremes.length,
            clearance: self.tally.clearance.summary(),
            accuracy: None,
            directory: target.display().to_string(),
        }
    }
}

/// Energy of the first and the last row, J, and the extremes over every step.
struct Tally {
    n_rows: usize,
    initial: f64,
    last: f64,
    extremes: Extremes,
    clearance: Clearances,
}

impl Tally {
    fn of(setup: &Simulation) -> Self {
        Self {
            n_rows: 0,
            initial: 0.0,
            last: 0.0,
            extremes: Extremes::EMPTY,
            clearance: Clearances::of(setup),
        }
    }

    /// A row, and whether its energy is among those that count as extremes: these do not depend on what has a row.
    fn include(&mut self, row: &MotionRecord, rod: &Rod, counts: bool) {
        let energy = row.energy[0] + row.energy[1] + row.energy[2];
        self.clearance.include(row);
        if self.n_rows == 0 {
            self.initial = energy;
        }
        self.n_rows += 1;
        self.last = energy;
        let lengths = rod.elements.iter().map(|element| element.length);
        let elements = row.dilatation.iter().copied().zip(lengths);
        self.extremes.include_lengths(elements);
        if counts {
            self.extremes.energy.include(energy);
        }
    }
}

/// Sum of the loads on the tip.
fn tip_load(rod: &Rod, t: f64, state: &State) -> Wrench {
    let tip = rod.tip();
    let mut wrench = Wrench::default();
    for load in rod.loads.iter().filter(|load| load.node == tip) {
        let acting = load.wrench(t, &state.configuration.rotations[tip]);
        wrench.force += acting.force;
        wrench.moment += acting.moment;
    }
    wrench
}
