//! A simulation with rows on disk and checkpoints, from which it goes on after an interruption: what the verb `simulate` calls.

mod clearance;
mod resuming;
mod run;
mod tally;
mod touching;

use std::path::{Path, PathBuf};
use std::time::Instant;

use self::resuming::{Found, continued};
use self::run::Run;
use self::touching::MOST_DIVISIONS;
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

/// The end of the steps of a run.
enum Stepped {
    /// The run is over.
    To(End),
    /// The arm is so deep in a body that it needs steps shorter by this divisor.
    TooLong(usize),
}

/// A simulation that is set up, with the directory that its result goes to.
pub(crate) struct SimulationRun {
    /// The simulation, on its grid.
    pub setup: Simulation,
    directory: RunDirectory,
    target: PathBuf,
    found: Option<Found>,
    /// Sentences about what to know before the run.
    pub warnings: Vec<String>,
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
            warnings: Vec::new(),
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
            warnings: Vec::new(),
        })
    }

    /// Steps to the end or until `stop` is raised, and writes the result of `scene`, whose name is `name`. Where the scene leaves the step open, and the arm
    /// comes so deep into a body that the contact allows shorter steps only, the run begins anew with these.
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
            mut setup,
            directory,
            target,
            mut found,
            warnings,
        } = self;
        let is_open = scene.time.step_s.is_none();
        let started = Instant::now();
        let folder = directory.path().to_path_buf();
        let kept = |source: OutputError| OutputError::Kept {
            source: Box::new(source),
            folder: folder.clone(),
        };
        loop {
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
                step: first_step / setup.divided,
                time: run.integrator.time(),
            });
            let divided = setup.divided;
            let most = is_open.then_some(MOST_DIVISIONS / divided);
            let mut tell_step = |step| tell(SimulationEvent::Step(step / divided));
            let end = match run.integrate(most, stop, &mut tell_step) {
                Ok(Stepped::To(end)) => end,
                Ok(Stepped::TooLong(by)) => {
                    drop(run);
                    // A run that went on from an earlier one begins anew as well: its first part had the long steps.
                    found = None;
                    setup = setup.with_steps_divided(by);
                    continue;
                }
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
            let found_out = summary.concerns();
            summary.warnings = warnings;
            summary.warnings.extend(found_out);
            let directory = directory
                .publish(|result| run.write(result, scene, &end, &mut summary))
                .map_err(kept)?;
            return Ok(Simulated {
                setup,
                end,
                first_step,
                summary,
                directory,
            });
        }
    }
}
