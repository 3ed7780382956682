//! The motion of a closed loop, its commands and its limits, as they are recorded and written.

use std::path::Path;

use super::advice::FAR;
use crate::control::path::PathEnforcement;
use crate::control::{Hold, NamedControl, PathLimit, RodView};
use crate::mechanics::{
    Configuration, Energy, NodalState, Rod, State, TimeGrid, Trajectory, Wrench,
};
use crate::mpc::{ClosedLoop, KEPT, Outcome, Sample};
use crate::output::closed_loop::{
    EffortRange, GaveWay, LimitPeak, MpcSummary, SampleRow, write_samples,
};
use crate::output::summary::SlackSummary;
use crate::output::{
    ControlRow, END_FILE, EffortRow, MotionRecord, OutputError, ResultDirectory, RowFiles,
    ThinnedMotion, json_value, render_report, write_controls, write_efforts, write_end,
};
use crate::scene::ClosedLoopSetup;
use crate::solve::efforts::{efforts_at, slack};
use crate::solve::learned::BeyondLearned;
use crate::solve::page::closed_loop_page;

/// Part of a run up to which a slack tendon is not worth a word, a choice.
const BRIEF: f64 = 0.05;

/// Recording of the arm's motion, a row at the beginning and after every sample, and of the commands that are sent to it.
pub(super) struct Recording {
    trajectory: RowFiles,
    /// The controls, from the first command on.
    commanded: Vec<NamedControl>,
    controls: Vec<ControlRow>,
    /// Efforts of the actuators in the arm, as they act.
    efforts: Vec<EffortRow>,
    hold: Hold,
    /// Rows for the picture, with the last one.
    thinned: ThinnedMotion,
    row: MotionRecord,
    /// The state of that row.
    end: State,
    pub(super) limits: LimitWatch,
    /// Expected states of the controller's model beyond what a learned density knows.
    pub(super) beyond: BeyondLearned,
}

/// Looks at the limits of the task on the arm as it is.
pub(super) struct LimitWatch {
    limits: Vec<PathLimit>,
    radii: Vec<f64>,
    pub(super) peaks: Vec<LimitPeak>,
    /// Time (s) and shape of the row before, from which on a speed is a mean.
    before: Option<(f64, Configuration)>,
}

impl LimitWatch {
    pub(super) fn new(setup: &ClosedLoopSetup) -> Self {
        let (own, rod) = (&setup.experiment, &setup.plant);
        let radii = own.plant.radii_at_nodes(&rod.mesh);
        let limits: Vec<_> = (own.task.limits.iter())
            .map(|limit| limit.kind.on(rod, &radii))
            .collect();
        let margins = own.margins.iter().copied().chain(std::iter::repeat(0.0));
        let peaks = (own.task.limits.iter().zip(&limits).zip(margins))
            .map(|((named, limit), margin)| LimitPeak {
                name: named.name.clone(),
                allowed: match named.enforcement {
                    PathEnforcement::Hard => KEPT * limit.reference(rod, &radii),
                    PathEnforcement::Soft { .. } => f64::INFINITY,
                },
                violated: false,
                excess: f64::NEG_INFINITY,
                unit: limit.unit(),
                at_s: 0.0,
                node: 0,
                margin,
                gave_way: GaveWay::default(),
            })
            .collect();
        Self {
            limits,
            radii,
            peaks,
            before: None,
        }
    }

    /// Looks at the plan of a sample, and at the arm at its end.
    pub(super) fn look(&mut self, sample: &Sample, closed: &ClosedLoop) {
        let arm = closed.arm();
        self.see(arm.rod(), arm.time(), &arm.state());
        self.note_plan(sample, closed);
    }

    fn note_plan(&mut self, sample: &Sample, closed: &ClosedLoop) {
        if !sample.breaks_limit {
            return;
        }
        for (name, by) in closed.controller().gave_way() {
            let peaks = self.peaks.iter_mut();
            for own in peaks.filter(|peak| peak.name == name) {
                own.gave_way.note(sample.t, by);
            }
        }
    }

    fn see(&mut self, rod: &Rod, t: f64, state: &State) {
        if self.limits.is_empty() {
            return;
        }
        let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), 2);
        let mut grid = TimeGrid::instant(t);
        if let Some((start, shape)) = &self.before {
            trajectory.push(shape);
            grid = TimeGrid {
                start: *start,
                step: t - start,
                n_steps: 1,
            };
        }
        trajectory.push(&state.configuration);
        let view = RodView {
            rod,
            radii: &self.radii,
            trajectory: &trajectory,
            grid,
        };
        self.before = Some((t, state.configuration.clone()));
        for (limit, peak) in self.limits.iter().zip(&mut self.peaks) {
            let (value, item) = limit.worst(&view, grid.n_steps);
            let excess = value * limit.scale(rod);
            if excess > peak.excess {
                peak.excess = excess;
                peak.violated = excess > peak.allowed;
                peak.at_s = t;
                peak.node = limit.node(rod, item);
            }
        }
    }
}

impl Recording {
    pub(super) fn begin(setup: &ClosedLoopSetup, folder: &Path) -> Result<Self, OutputError> {
        let layout = MotionRecord::empty(setup.plant.n_nodes());
        let mut recording = Self {
            trajectory: RowFiles::create(folder, &layout.arrays())?,
            commanded: Vec::new(),
            controls: Vec::new(),
            efforts: Vec::new(),
            hold: setup.experiment.discretization.hold,
            thinned: ThinnedMotion::new(layout.n_nodes),
            row: layout,
            end: setup.initial.clone(),
            limits: LimitWatch::new(setup),
            beyond: BeyondLearned::default(),
        };
        recording.note_efforts(
            &setup.plant,
            0.0,
            &setup.initial,
            &setup.plant.actuators.efforts(0.0),
        );
        recording.push(&setup.plant, 0.0, &setup.initial, &Wrench::default())?;
        Ok(recording)
    }

    fn note_efforts(&mut self, rod: &Rod, t: f64, state: &State, efforts: &[f64]) {
        if !rod.actuators.is_empty() {
            (self.efforts).extend(efforts_at(rod, t, &state.configuration, efforts, None));
        }
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
        self.end.clone_from(state);
        Ok(())
    }

    pub(super) fn see(&mut self, sample: &Sample, closed: &ClosedLoop) -> Result<(), OutputError> {
        self.limits.note_plan(sample, closed);
        let controller = closed.controller();
        let expected = &controller.expected().configuration;
        self.beyond.see(controller.rod(), expected.poses());
        let (arm, command) = (closed.arm(), closed.sent());
        if self.controls.is_empty() {
            self.commanded = command.list.named().cloned().collect();
        }
        let tip = closed.controller().rod().tip();
        let acting = (command.nodes().iter().zip(arm.acting()))
            .find_map(|(node, wrench)| (*node == tip).then_some(*wrench));
        let row = |t_start, t_end, at_end| ControlRow {
            t_start,
            t_end,
            values: if at_end {
                command.to.clone()
            } else {
                command.from.clone()
            },
        };
        let (start, end) = (command.start, command.end);
        let rows = match self.hold {
            Hold::Constant => vec![row(start, end, false)],
            Hold::Linear | Hold::Cubic => vec![row(start, start, false), row(end, end, true)],
        };
        self.controls.extend(rows);
        let state = arm.state();
        self.note_efforts(arm.rod(), arm.time(), &state, &arm.acting_efforts());
        self.push(arm.rod(), arm.time(), &state, &acting.unwrap_or_default())
    }

    /// Returns the least and the largest effort that acted in each actuator in the arm.
    pub(super) fn effort_ranges(&self, rod: &Rod) -> Vec<EffortRange> {
        (rod.actuators.iter().enumerate())
            .map(|(index, actuator)| {
                let rows = self.efforts.iter().skip(index).step_by(rod.actuators.len());
                let efforts = rows.map(|row| row.effort);
                EffortRange {
                    name: actuator.name.clone(),
                    unit: actuator.input_unit(),
                    least: efforts.clone().fold(f64::INFINITY, f64::min),
                    largest: efforts.fold(f64::NEG_INFINITY, f64::max),
                }
            })
            .collect()
    }

    /// Returns the part of the ends of samples at which the tendon of each winch has no tension.
    pub(super) fn slack(&self, rod: &Rod) -> Vec<SlackSummary> {
        slack(rod, &self.efforts)
    }

    /// Returns a sentence on the tendons of winches that are slack for a part of a run that ends far from its reference.
    pub(super) fn slack_advice(&self, setup: &ClosedLoopSetup, run: &Outcome) -> Option<String> {
        let own = &setup.experiment;
        if !(run.tip_error.rms > FAR * own.arm.length) {
            return None;
        }
        let longest = |name: &str| {
            let rows = self.efforts.iter().filter(|row| row.name == name);
            rows.filter_map(|row| Some(row.displacement.flatten()? + row.coordinate))
                .fold(0.0, f64::max)
        };
        let found: Vec<String> = (self.slack(&setup.plant).into_iter())
            .filter(|own| own.fraction > BRIEF)
            .map(|own| {
                let (part, by) = (100.0 * own.fraction, 1e3 * longest(&own.name));
                format!(
                    "\"{}\" for {part:.0} % of the run, by up to {by:.2} mm",
                    own.name
                )
            })
            .collect();
        (!found.is_empty()).then(|| {
            format!(
                "tendons are slack, so that their winches have no effect: {}; begin with them taut, by a smaller rest_displacement_m, and keep \
                 them taut by control.keep_taut = true",
                found.join("; ")
            )
        })
    }

    /// Writes the files of the result, the summary last.
    pub(super) fn write(
        &mut self,
        result: &ResultDirectory,
        setup: &ClosedLoopSetup,
        samples: &[Sample],
        summary: &MpcSummary,
    ) -> Result<(), OutputError> {
        let path = |name: &str| result.path().join(name);
        self.trajectory.write_npz(&path("trajectory.npz"))?;
        let end = NodalState::of(&setup.plant, &self.end);
        write_end(&path(END_FILE), &end)?;
        write_samples(&path("samples.csv"), samples)?;
        let headings: Vec<String> = self.commanded.iter().map(NamedControl::heading).collect();
        write_controls(&path("controls.csv"), &headings, &self.controls)?;
        if !self.efforts.is_empty() {
            write_efforts(&path("efforts.csv"), &self.efforts)?;
        }
        result.write_text("scene.toml", &setup.resolved.to_toml())?;
        let record = self.thinned.clone().finish(&self.row);
        let rows: Vec<SampleRow> = samples.iter().map(SampleRow::of).collect();
        let value = json_value(summary);
        let page = closed_loop_page(setup, &rows, &record, &self.efforts, &value);
        result.write_text("report.html", &render_report(&page?))?;
        result.write_json("summary.json", summary)
    }
}
