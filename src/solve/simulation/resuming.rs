//! The run that a checkpoint belongs to.

use std::path::Path;

use super::super::causes::SAME;
use super::SimulationError;
use crate::mechanics::Stepper;
use crate::output::{Checkpoint, ResultKind, RunDirectory};
use crate::scene::{MOST_ELEMENTS, Scene, SceneSource, Simulation};
use crate::stop::StopSignal;

/// Checkpoint of an earlier run.
pub(super) struct Found {
    pub(super) checkpoint: Checkpoint,
    /// Tells whether the run was killed, so that its rows are still in files of their own.
    pub(super) killed: bool,
}

impl Found {
    /// Takes hold of the directory of the run, if there is anything to continue.
    pub(super) fn directory(target: &Path) -> Result<RunDirectory, SimulationError> {
        if Checkpoint::is_in(&RunDirectory::folder_of(target)?) || Checkpoint::is_in(target) {
            Ok(RunDirectory::open(target, ResultKind::Simulate)?)
        } else {
            Err(Self::nothing(target))
        }
    }

    /// A run that was killed, or else one that wrote its result.
    pub(super) fn beside(
        directory: &RunDirectory,
        target: &Path,
        scene: &Scene,
    ) -> Result<Self, SimulationError> {
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

    fn nothing(target: &Path) -> SimulationError {
        SimulationError::Directory(format!(
            "{}: holds no checkpoint to continue from; run without --resume",
            target.display()
        ))
    }
}

/// The simulation that a checkpoint belongs to, on its grid; `time.end_s` may be later.
pub(super) fn continued(
    scene: &Scene,
    source: &SceneSource,
    checkpoint: &Checkpoint,
    stop: &StopSignal,
) -> Result<Simulation, SimulationError> {
    let (earlier, _) = Scene::from_toml("the scene of the checkpoint", &checkpoint.scene, &[])?;
    let mut scene = scene.clone();
    if scene.accuracy().is_some() {
        scene = scene.with_grid(&earlier.discretization());
    }
    let is_divided = checkpoint.divided > 1 && scene.time.step_s.is_none();
    if is_divided {
        scene.time.step_s = Some(checkpoint.step_s * checkpoint.divided as f64);
    } else if scene.time.step_s.is_none() {
        scene.time.step_s = earlier.time.step_s;
    }
    let mut setup = scene.simulation_until(source, stop)?;
    if is_divided {
        setup = setup.with_steps_divided(checkpoint.divided);
    }
    let refuse = |reason: String| {
        Err(SimulationError::Directory(format!(
            "cannot resume: {reason}; restore it, or run without --resume"
        )))
    };
    let mut timeless = Scene {
        time: earlier.time.clone(),
        ..setup.resolved.clone()
    };
    let asks_for_rows = (scene.output.as_ref()).is_some_and(|output| output.rate_hz.is_some());
    if is_divided
        && !asks_for_rows
        && let (Some(now), Some(then)) = (&mut timeless.output, &earlier.output)
    {
        // The distance of rows is that of the steps before they were divided, whose last digits may differ.
        now.rate_hz = then.rate_hz;
    }
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
    if !((setup.grid.step - step).abs() <= SAME * step) {
        return refuse(format!(
            "the earlier run has steps of {step} s, and this one of {} s; time.end_s must be a whole number of the \
             earlier steps, for instance {}, and time.step_s may be left out",
            setup.grid.step,
            (scene.time.end_s.get() / step).round() * step
        ));
    }
    setup.grid.step = step;
    setup.resolved.time.step_s = Some(step);
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
