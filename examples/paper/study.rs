//! Simulations of the paper's experiments, several at a time.

use std::error::Error;
use std::sync::{Mutex, PoisonError};

use softarm::mechanics::{NodeWrenches, RodModel, State, StepError, Stepper};
use softarm::scene::{Scene, Simulation};

/// A result, or why a scene or a step is not possible.
pub type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;

/// An experiment for which the paper prints numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Experiment {
    /// Section of the paper.
    pub section: &'static str,
    /// Built-in scene.
    pub scene: &'static str,
    /// Time from which on no load acts, s.
    pub unloaded: f64,
}

pub const FLYING_BEAM: Experiment = Experiment {
    section: "5.1",
    scene: "paper-flying-beam",
    unloaded: 5.0,
};
pub const STRETCHING: Experiment = Experiment {
    section: "5.2",
    scene: "paper-stretching",
    unloaded: 5.0,
};
pub const BENDING_STRETCHING: Experiment = Experiment {
    section: "5.3",
    scene: "paper-bending-stretching",
    unloaded: 10.0,
};

/// Settings that all runs share.
pub struct Study {
    /// Overrides of the scenes, `KEY=VALUE`; those of a run come after them.
    pub overrides: Vec<String>,
    /// Runs at a time.
    pub threads: usize,
}

impl Study {
    /// Returns the simulation of a built-in scene under a model and further overrides.
    pub fn simulation(&self, scene: &str, model: RodModel, own: &[String]) -> Outcome<Simulation> {
        let mut overrides = self.overrides.clone();
        overrides.push(format!("rod.model={}", model.name()));
        overrides.extend_from_slice(own);
        let (scene, source) = Scene::load(scene, &overrides)?;
        Ok(scene.simulation(&source)?)
    }

    /// Runs all jobs and returns their results in the order of the jobs.
    pub fn map<J: Sync, T: Send>(
        &self,
        jobs: &[J],
        run: impl Fn(&J) -> Outcome<T> + Sync,
    ) -> Outcome<Vec<T>> {
        let mut results: Vec<_> = jobs.iter().map(|_| None).collect();
        let queue = Mutex::new(jobs.iter().zip(&mut results));
        let next = || queue.lock().unwrap_or_else(PoisonError::into_inner).next();
        std::thread::scope(|scope| {
            for _ in 0..self.threads {
                scope.spawn(|| {
                    while let Some((job, result)) = next() {
                        *result = Some(run(job));
                    }
                });
            }
        });
        results.into_iter().flatten().collect()
    }
}

/// Takes all steps of a simulation; `observe` sees the state at every time node, the last included.
pub fn run(
    simulation: &Simulation,
    mut observe: impl FnMut(usize, &State),
) -> Result<(), StepError> {
    let (rod, grid) = (&simulation.rod, simulation.grid);
    let mut integrator = Stepper::new(rod, grid.step, simulation.initial.clone());
    observe(0, &integrator.state());
    for k in 1..=grid.n_steps {
        integrator.advance([NodeWrenches::NONE; 2])?;
        observe(k, &integrator.state());
    }
    Ok(())
}

/// Returns the slope of the straight line through points `(x, y)` by least squares, and its standard error.
pub fn slope(points: &[(f64, f64)]) -> [f64; 2] {
    let n = points.len() as f64;
    let x_mean = points.iter().map(|(x, _)| x).sum::<f64>() / n;
    let y_mean = points.iter().map(|(_, y)| y).sum::<f64>() / n;
    let centered = || points.iter().map(|(x, y)| (x - x_mean, y - y_mean));
    let spread: f64 = centered().map(|(x, _)| x * x).sum();
    let slope = centered().map(|(x, y)| x * y).sum::<f64>() / spread;
    let rest: f64 = centered().map(|(x, y)| (y - slope * x).powi(2)).sum();
    [slope, (rest / (n - 2.0) / spread).sqrt()]
}
