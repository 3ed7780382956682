//! A simulation with rows on disk and checkpoints, from which it goes on after an interruption: what the verb `simulate` calls.

mod clearance;
mod resuming;
mod run;
mod tally;

use std::path::{Path, PathBuf};
use std::time::Instant;

use self::resuming::{Found, continued};
use self::run::Run;
use crate::mechanics::StepError;
use crate::output::summary::{AccuracySummary, SimulateSummary};
use crate::output::{Checkpoint, OutputError, ResultKind, RunDirectory};
use crate::scene::{Scene, SceneError, SceneSource, Simulation};
use crate::stop::StopSignal;

/// Why there is no result of a simulation.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SimulationError {
    /// The scene is none, or setting it up was stopped.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A file cannot be read or written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The first row cannot be computed.
    #[error(transparent)]
    Step(#[from] StepError),
    /// There is nothing to continue, or it belongs to another scene.
    #[error("{0}")]
    Directory(String),
}

/// Outcome of a run.
pub(crate) enum End {
    Completed,
    Interrupted,
    Failed(StepError),
}

/// A simulation that is set up, with the directory that its result goes to.
pub(crate) struct SimulationRun {
    /// The simulation, on its grid.
    pub setup: Simulation,
    directory: RunDirectory,
    target: PathBuf,
    found: Option<Found>,
}

/// A simulation that has ended.
pub(crate) struct Simulated {
    pub setup: Simulation,
    pub end: End,
    /// Step at which this run began.
    pub first_step: usize,
    pub summary: SimulateSummary,
    /// The result directory.
    pub directory: PathBuf,
}

/// Progress of a run.
pub(crate) enum SimulationEvent {
    /// Steps begin, with this one, at this time, s.
    Begins { step: usize, time: f64 },
    /// Number of steps that are done.
    Step(usize),
}

impl SimulationRun {
    /// A run from the beginning.
    ///
    /// # Errors
    /// [`SimulationError::Output`] for a directory that is not to be replaced.
    pub fn anew(setup: Simulation, target: &Path) -> Result<Self, SimulationError> {
        Ok(Self {
            setup,
            directory: RunDirectory::open(target, ResultKind::Simulate)?,
            target: target.into(),
            found: None,
        })
    }

    /// A run that goes on from the checkpoint in `target`; `time.end_s` of the scene may be later.
    ///
    /// # Errors
    /// [`SimulationError::Directory`] where there is no checkpoint, and for one of another scene.
    pub fn resumed(
        scene: &Scene,
        source: &SceneSource,
        target: &Path,
        stop: &StopSignal,
    ) -> Result<Self, SimulationError> {
        let directory = Found::directory(target)?;
        let found = Found::beside(&directory, target, scene)?;
        Ok(Self {
            setup: continued(scene, source, &found.checkpoint, stop)?,
            directory,
            target: target.into(),
            found: Some(found),
        })
    }

    /// Steps to the end or until `stop` is raised, and writes the result of `scene`, whose name is `name`.
    ///
    /// # Errors
    /// [`SimulationError`] where nothing can be written. A motion that breaks down is a [result](End::Failed).
    pub fn run(
        self,
        name: &str,
        scene: &Scene,
        accuracy: Option<AccuracySummary>,
        stop: &StopSignal,
        tell: &dyn Fn(SimulationEvent),
    ) -> Result<Simulated, SimulationError> {
        let Self {
            setup,
            directory,
            target,
            found,
        } = self;
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
        tell(SimulationEvent::Begins {
            step: first_step,
            time: run.integrator.time(),
        });
        let started = Instant::now();
        let folder = directory.path().to_path_buf();
        let kept = |source: OutputError| OutputError::Kept {
            source: Box::new(source),
            folder: folder.clone(),
        };
        let end = match run.integrate(stop, &mut |step| tell(SimulationEvent::Step(step))) {
            Ok(end) => end,
            Err(SimulationError::Output(error)) if Checkpoint::is_in(&folder) => {
                return Err(kept(error).into());
            }
            Err(error) => {
                directory.remove()?;
                return Err(error);
            }
        };
        let wall = started.elapsed().as_secs_f64();
        let mut summary = SimulateSummary {
            accuracy,
            ..run.summarize(name, &end, first_step, wall, &target)
        };
        let directory = directory
            .publish(|result| run.write(result, scene, &end, &mut summary))
            .map_err(kept)?;
        Ok(Simulated {
            setup,
            end,
            first_step,
            summary,
            directory,
        })
    }
}
