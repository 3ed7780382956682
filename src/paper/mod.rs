//! The numerical experiments of the paper's section 5, recomputed.
//!
//! The experiments are built-in scenes. [`Comparison`] holds the quantities that the paper prints, [`Figure`] sets them
//! beside the printed ones, [`convergence`] is the study of section 5.4, and [`LongRun`] looks at the energy over as many
//! steps as asked for.

mod comparison;
pub mod convergence;
mod figures;
mod long_run;
mod measurements;

pub use comparison::{Comparison, DiscreteEnergy, Instant, section_area};
pub use convergence::{ConvergencePoint, order};
pub use figures::{Experiment, Figure, Reading, figures};
pub use long_run::{LongRun, Trend, long_runs};
pub use measurements::{BlowUp, Tip, blow_up, tip_at};

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::mechanics::equilibrium::EquilibriumError;
use crate::mechanics::{Rod, State, StepError, TimeGrid};
use crate::scene::{Scene, SceneError, Simulation};
use crate::stop::StopSignal;
use crate::task::{Arm, Discretization, DiscretizeError, Start};

/// An experiment could not be run.
#[derive(Debug, thiserror::Error)]
pub enum PaperError {
    /// Its scene does not hold together, as an override can bring about.
    #[error("{0}")]
    Scene(#[from] SceneError),
    /// It cannot be discretized so.
    #[error("error: {0}")]
    Discretize(#[from] DiscretizeError),
    /// Its initial equilibrium does not exist.
    #[error("error: {0}")]
    Start(#[from] EquilibriumError),
    /// Its simulation broke down.
    #[error("error: {scene}: {error}")]
    Step {
        /// The scene.
        scene: &'static str,
        /// Where and why.
        error: StepError,
    },
}

/// A motion of an arm that can be discretized in many ways.
#[derive(Clone, Debug)]
pub struct PosedMotion {
    /// The arm.
    pub arm: Arm,
    /// The state in which it starts.
    pub start: Start,
    /// The discretization.
    pub discretization: Discretization,
    /// When the motion ends, s.
    pub end: f64,
}

impl PosedMotion {
    /// The rod, the time grid, and the state at its start.
    ///
    /// # Errors
    /// [`PaperError::Discretize`] and [`PaperError::Start`]
    pub fn discretize(&self) -> Result<(Rod, TimeGrid, State), PaperError> {
        let motion = self.arm.discretize(self.end, &self.discretization)?;
        let start = self.start.state(&motion.rod, &StopSignal::default())?;
        Ok((motion.rod, motion.grid, start))
    }
}

/// What all runs share.
#[derive(Clone, Debug)]
pub struct Study {
    /// Overrides of the scenes, `KEY=VALUE`; what an experiment sets itself comes after them.
    pub overrides: Vec<String>,
    /// Runs at a time.
    pub threads: usize,
}

impl Study {
    /// The simulation of a built-in scene under the overrides of this study and then those given.
    ///
    /// # Errors
    /// [`PaperError::Scene`]
    pub fn simulation(
        &self,
        scene: &'static str,
        overrides: &[String],
    ) -> Result<Simulation, PaperError> {
        let all: Vec<String> = self.overrides.iter().chain(overrides).cloned().collect();
        let (scene, source) = Scene::load(scene, &all)?;
        Ok(scene.simulation(&source)?)
    }

    /// A built-in scene under the overrides of this study, before it is discretized.
    ///
    /// # Errors
    /// [`PaperError::Scene`]
    pub fn posed(&self, scene: &'static str) -> Result<PosedMotion, PaperError> {
        let (scene, source) = Scene::load(scene, &self.overrides)?;
        Ok(PosedMotion {
            arm: scene.arm(&source)?,
            start: scene.start(),
            discretization: scene.discretization(),
            end: scene.time.end_s.get(),
        })
    }

    /// `run` of every job, in the order of the jobs.
    fn map<J: Sync, T: Send>(&self, jobs: &[J], run: impl Fn(&J) -> T + Sync) -> Vec<T> {
        let next = AtomicUsize::new(0);
        let done = Mutex::new(Vec::with_capacity(jobs.len()));
        std::thread::scope(|scope| {
            for _ in 0..self.threads.clamp(1, jobs.len().max(1)) {
                scope.spawn(|| {
                    while let Some((i, job)) = {
                        let i = next.fetch_add(1, Ordering::Relaxed);
                        jobs.get(i).map(|job| (i, job))
                    } {
                        let result = run(job);
                        // A run that panicked takes the scope down with it.
                        if let Ok(mut done) = done.lock() {
                            done.push((i, result));
                        }
                    }
                });
            }
        });
        let mut done = done
            .into_inner()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        done.sort_by_key(|(i, _)| *i);
        done.into_iter().map(|(_, result)| result).collect()
    }
}
