//! The simulation of one motion with several discretizations.

use super::course::{Course, TIMES, advance};
use super::grid::Grid;
use crate::clock::{ProcessorClock, Seconds};
use crate::mechanics::{Rod, State, StepError, TimeGrid};
use crate::scene::{Scene, SceneError, SceneSource};
use crate::stop::StopSignal;
use crate::task::prediction::simulation_seconds;
use crate::task::{Arm, Discretization, DiscretizeError, Start};

/// A motion on which discretizations are compared: an arm, its start, and a duration.
#[derive(Clone, Debug)]
pub struct ComparedMotion {
    /// The arm.
    pub arm: Arm,
    /// State at time 0.
    pub start: Start,
    /// Duration, s.
    pub duration: f64,
}

/// The reason why a motion was not simulated to its end.
#[derive(Clone, Debug, thiserror::Error)]
pub enum RunError {
    /// The arm cannot be discretized in this way.
    #[error(transparent)]
    Discretize(#[from] DiscretizeError),
    /// The motion broke down.
    #[error(transparent)]
    Step(#[from] StepError),
}

impl RunError {
    /// Tells whether a stop signal ended the motion.
    #[must_use]
    pub fn is_stop(&self) -> bool {
        matches!(self, Self::Step(StepError::Stopped(_)))
    }
}

/// The result of a motion on one grid.
#[derive(Clone, Debug)]
pub struct Run {
    /// The discretization; nothing in it is left open.
    pub discretization: Discretization,
    /// Number of steps.
    pub n_steps: usize,
    /// The sampled motion.
    pub course: Course,
    /// Seconds of the simulation, without start and files.
    pub seconds: Seconds,
}

impl Run {
    /// The time step, s.
    #[must_use]
    pub fn step(&self) -> f64 {
        self.discretization.step.unwrap_or(f64::NAN)
    }

    /// Returns elements and step.
    pub(super) fn grid(&self) -> Grid {
        Grid {
            elements: self.discretization.elements,
            step: self.step(),
        }
    }
}

/// Rod, grid and start of a motion.
pub(super) struct Setup {
    pub discretization: Discretization,
    pub rod: Rod,
    pub grid: TimeGrid,
    initial: State,
}

impl Setup {
    /// Returns the predicted time of the simulation, s.
    pub fn predicted(&self) -> f64 {
        simulation_seconds(&self.rod, self.grid.n_steps as f64)
    }

    pub fn run(&self, stop: &StopSignal) -> Result<Run, StepError> {
        let clock = ProcessorClock::start();
        let course = Course::of(&self.rod, self.grid, &self.initial, None, stop)?;
        Ok(Run {
            discretization: self.discretization,
            n_steps: self.grid.n_steps,
            course,
            seconds: clock.seconds(),
        })
    }

    /// Simulates and returns the seconds of the simulation.
    pub fn time(&self, stop: &StopSignal) -> Result<Seconds, StepError> {
        let clock = ProcessorClock::start();
        advance(&self.rod, self.grid, &self.initial, None, stop, |_, _| ())?;
        Ok(clock.seconds())
    }
}

impl ComparedMotion {
    /// Returns the motion of a scene.
    ///
    /// # Errors
    /// As [`Scene::arm`].
    pub fn of_scene(scene: &Scene, source: &SceneSource) -> Result<Self, SceneError> {
        Ok(Self {
            arm: scene.arm(source)?,
            start: scene.start(),
            duration: scene.time.end_s.get(),
        })
    }

    /// Sets the motion up with the step of `discretization`, or the automatic one; the step is at most `longest`, s, and divides the times
    /// of the comparison.
    pub(super) fn setup(
        &self,
        discretization: &Discretization,
        longest: f64,
        stop: &StopSignal,
    ) -> Result<Setup, DiscretizeError> {
        self.setup_longer(discretization, 1.0, longest, stop)
    }

    /// Sets the motion up as [`Self::setup`] does, with the step of `discretization`, or the automatic one times a factor.
    pub(super) fn setup_longer(
        &self,
        discretization: &Discretization,
        factor: f64,
        longest: f64,
        stop: &StopSignal,
    ) -> Result<Setup, DiscretizeError> {
        let found = self.arm.discretize(self.duration, discretization)?;
        let step = (factor * found.grid.step).min(longest);
        let grid = TimeGrid::covering(self.duration, step, TIMES);
        let initial = self.start.state(&found.rod, stop)?;
        Ok(Setup {
            discretization: Discretization {
                step: Some(grid.step),
                ..found.discretization
            },
            rod: found.rod,
            grid,
            initial,
        })
    }

    /// Simulates with a discretization. Its step may be shortened to the stable step, and to a fraction of the interval between the times
    /// at which motions are compared.
    ///
    /// # Errors
    /// Returns [`RunError`] if the arm cannot be discretized or the motion breaks down.
    pub fn run(&self, discretization: &Discretization, stop: &StopSignal) -> Result<Run, RunError> {
        Ok(self.setup(discretization, f64::INFINITY, stop)?.run(stop)?)
    }
}
