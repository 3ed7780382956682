//! A run with its rows on disk and its checkpoints.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use nalgebra::{Matrix3, Vector3};

use super::resuming::Found;
use super::tally::Tally;
use super::touching::Touching;
use super::{End, SimulationError, Stepped};
use crate::mechanics::rotation::{quaternion, wxyz};
use crate::mechanics::{
    Diagnostics, Energy, NodalState, NodeWrenches, PowerBalance, Rod, State, StepError, Stepper,
    TimeScheme, Wrench, kinetic_energy,
};
use crate::output::summary::{EnergySummary, SCHEMA_VERSION, SimulateSummary, TOOL, TipPose};
use crate::output::{
    ArrayView, BaseReaction, Checkpoint, DiagnosticsRecord, END_FILE, Extremes, MotionRecord,
    OutputError, ResultDirectory, RowFiles, RowPrefix, RunDirectory, ThinnedMotion, json_value,
    render_report, write_efforts, write_end,
};
use crate::scene::{Scene, Simulation};
use crate::solve::causes::causes;
use crate::solve::efforts::{effort_rows, slack};
use crate::solve::page::simulation_page;
use crate::stop::StopSignal;

/// Steps between two whose energy counts as an extreme; a divisor of [`Stepper::SEAT`], so that a motion that goes on looks at the same
/// ones.
const ENERGY_EVERY: usize = 8;
/// Time between two checkpoints: the work of at most so long is lost when the process is killed.
const CHECKPOINT_PERIOD: Duration = Duration::from_secs(1);

/// Part of the kinetic energy that changes its sign from step to step beyond which the motion rings: most of it. It decides about a sentence
/// alone, as does the part of the range of the energy from which on that counts.
const RINGS: f64 = 0.5;
const RINGS_LOUDLY: f64 = 1e-3;

/// A simulation on its way. Rows go to files, so that memory does not grow with them; from time to time, a checkpoint
/// says how far they count.
pub(super) struct Run<'a> {
    setup: &'a Simulation,
    /// Destination of rows and checkpoints.
    folder: PathBuf,
    pub(super) integrator: Stepper<'a>,
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
    touching: Option<Touching>,
    /// Time that the integrator took.
    stepping: Duration,
}

impl<'a> Run<'a> {
    /// Starts from the beginning; files of an earlier run are removed.
    pub(super) fn start(
        setup: &'a Simulation,
        directory: &RunDirectory,
    ) -> Result<Self, SimulationError> {
        directory.clear()?;
        let files = |name: &str, layout: &[ArrayView]| {
            RowFiles::create(&directory.path().join(name), layout)
        };
        let row = MotionRecord::empty(setup.rod.n_nodes());
        let diagnostics = DiagnosticsRecord::empty(&setup.rod);
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
            touching: Touching::of(&setup.rod, &setup.initial.configuration.positions),
        };
        run.observe(None)?;
        Ok(run)
    }

    /// Continues from a checkpoint, with the rows up to it.
    pub(super) fn resume(
        setup: &'a Simulation,
        directory: &RunDirectory,
        found: &Found,
        target: &Path,
    ) -> Result<Self, SimulationError> {
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
        let layout = DiagnosticsRecord::empty(&setup.rod);
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
            touching: Touching::of(&setup.rod, &checkpoint.state().configuration.positions),
        })
    }

    /// Steps to the end, or until something happens; `tell` is told the number of a step from time to time. `most` is the largest divisor by which the step
    /// may be shortened, if the scene leaves it open.
    pub(super) fn integrate(
        &mut self,
        most: Option<usize>,
        stop: &StopSignal,
        tell: &mut dyn FnMut(usize),
    ) -> Result<Stepped, SimulationError> {
        let n_steps = self.setup.grid.n_steps;
        self.note_rows();
        self.save()?;
        let mut saved = Instant::now();
        let end = loop {
            let k = self.integrator.step();
            match self.judge_contact(most) {
                Ok(None) => {}
                Ok(Some(by)) => return Ok(Stepped::TooLong(by)),
                Err(error) => break End::Failed(error),
            }
            if k.is_multiple_of(Stepper::SEAT) {
                self.note_rows();
            }
            if k == n_steps {
                tell(k);
                break End::Completed;
            }
            if stop.check_at(k).is_err() {
                break End::Interrupted;
            }
            if k.is_multiple_of(Stepper::SEAT) {
                tell(k);
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
                // What flings the arm out of a body so fast is more than the step resolves.
                if let (Some(most), Some(touching)) = (most, &self.touching)
                    && let Some(by) = touching.divisor_after_failure(self.setup.grid.step)
                    && by <= most
                {
                    return Ok(Stepped::TooLong(by));
                }
                break End::Failed(error);
            }
            self.touch();
            let seen = if leads_to_row {
                self.observe(before.as_ref())
            } else {
                self.count().map_err(SimulationError::Step)
            };
            match seen {
                Err(SimulationError::Step(error)) => break End::Failed(error),
                other => other?,
            }
        };
        if !matches!(end, End::Failed(_)) {
            self.save()?;
        }
        Ok(Stepped::To(end))
    }

    /// Follows what the arm touches at the end of a step.
    fn touch(&mut self) {
        let Some(touching) = &mut self.touching else {
            return;
        };
        let rod = &self.setup.rod;
        let integrator = &self.integrator;
        let looks = touching.advance(rod, |node| integrator.position(node));
        for look in 1..=looks {
            let part = look as f64 / looks as f64;
            let t = integrator.time() - (1.0 - part) * self.setup.grid.step;
            let (positions, allowed) = touching.on_the_way(part);
            (self.tally.clearance).include_depths(rod, t, positions, allowed);
        }
    }

    /// Returns the divisor by which contacts need the step shortened, if it is open up to `most`; `None` if it is short enough.
    fn judge_contact(&self, most: Option<usize>) -> Result<Option<usize>, StepError> {
        let Some(touching) = &self.touching else {
            return Ok(None);
        };
        let rod = &self.setup.rod;
        let (step, time) = (self.integrator.step(), self.integrator.time());
        if let (Some(most), Some(by)) = (most, touching.divisor(self.setup.grid.step)) {
            return if by <= most {
                Ok(Some(by))
            } else {
                Err(touching.too_stiff(rod, step, time))
            };
        }
        match touching.check(rod, step, time) {
            Ok(()) => Ok(None),
            Err(_) if most.is_some_and(|most| most >= 2) => Ok(Some(2)),
            Err(error) => Err(error),
        }
    }

    /// Writes a row; `before` is the state one step ago.
    fn observe(&mut self, before: Option<&State>) -> Result<(), SimulationError> {
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
        self.tally.beyond.see(rod, state.configuration.poses());
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
            (self.setup.grid.step, self.setup.divided),
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

    /// Writes the files of the result, and adds to the summary what follows from the recorded rows.
    pub(super) fn write(
        mut self,
        result: &ResultDirectory,
        scene: &Scene,
        end: &End,
        summary: &mut SimulateSummary,
    ) -> Result<(), OutputError> {
        self.trajectory
            .write_npz(&result.path().join("trajectory.npz"))?;
        if let Some(diagnostics) = &mut self.diagnostics {
            diagnostics.write_npz(&result.path().join("diagnostics.npz"))?;
        }
        let rod = &self.setup.rod;
        if !rod.actuators.is_empty() {
            let record = MotionRecord::read_npz(&result.path().join("trajectory.npz"))?;
            let given = |row: usize| (rod.actuators.efforts(record.t[row]), None);
            let rows = effort_rows(rod, &record, given);
            write_efforts(&result.path().join("efforts.csv"), &rows)?;
            summary.slack = slack(rod, &rows);
        }
        if !matches!(end, End::Failed(_)) {
            self.checkpoint().write(result.path())?;
            let end = NodalState::of(rod, &self.integrator.state());
            write_end(&result.path().join(END_FILE), &end)?;
        }
        result.write_text("scene.toml", &self.setup.resolved.to_toml())?;
        result.write_json("summary.json", summary)?;
        let record = self.thinned.finish(&self.row);
        let diagnostics = result.path().join("diagnostics.npz");
        let base = (self.diagnostics.is_some())
            .then(|| BaseReaction::read(&diagnostics, self.trajectory.n_rows()))
            .transpose()?;
        let summary = json_value(summary);
        let page = simulation_page(scene, self.setup, &record, &summary, base.as_ref());
        result.write_text("report.html", &render_report(&page?))
    }

    /// Returns the kinetic energy, J, of the part of the momenta that changes its sign from step to step after the end, `(a - 2 b + c)/4` of
    /// three in a row, if that is most of all: waves that implicit steps do not resolve.
    fn ringing(&self, extremes: &Extremes) -> Option<f64> {
        let rod = &self.setup.rod;
        if rod.scheme != TimeScheme::Implicit {
            return None;
        }
        let (step, state) = (self.setup.grid.step, self.integrator.state());
        let mut ahead = Stepper::resume(rod, step, state.clone(), self.integrator.step());
        let mut next = || {
            ahead.advance([NodeWrenches::NONE; 2]).ok()?;
            Some(ahead.state())
        };
        let [first, second, third] = [state, next()?, next()?];
        let mut alternating = second.clone();
        for q in 0..rod.n_nodes() {
            let of = |momentum: fn(&State) -> &Vec<Vector3<f64>>| {
                (momentum(&first)[q] - 2.0 * momentum(&second)[q] + momentum(&third)[q]) / 4.0
            };
            alternating.linear_momentum[q] = of(|state| &state.linear_momentum);
            alternating.angular_momentum[q] = of(|state| &state.angular_momentum);
        }
        let [ringing, all] = [&alternating, &second].map(|state| kinetic_energy(rod, state));
        let range = extremes.energy.max - extremes.energy.min;
        (ringing > RINGS * all && ringing > RINGS_LOUDLY * range).then_some(ringing)
    }

    pub(super) fn summarize(
        &self,
        scene: &str,
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
            scene: scene.into(),
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
                orientation_wxyz: wxyz(&q),
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
            contact: self.tally.clearance.depths(),
            contact_gives: (self.touching.as_ref()).and_then(Touching::gave),
            ringing: match end {
                End::Completed => self.ringing(&extremes),
                End::Interrupted | End::Failed(_) => None,
            },
            beyond_learned: self.tally.beyond.sentence(),
            slack: Vec::new(),
            warnings: Vec::new(),
            accuracy: None,
            directory: target.display().to_string(),
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
