//! The energy of a rod left to itself, over as many steps as asked for.

use nalgebra::Matrix3;

use super::{Experiment, PaperError, Study};
use crate::mechanics::{Energy, Integrator, RodModel, Wrench};

/// Energy and rotations of the third experiment's rod after its loads have ended.
#[derive(Clone, Debug)]
pub struct LongRun {
    /// Model of the rod.
    pub model: RodModel,
    /// Time step, s.
    pub step: f64,
    /// Steps without load.
    pub steps: usize,
    /// Mean energy, J.
    pub mean: f64,
    /// Greatest distance of the energy from its mean, relative.
    pub ripple: f64,
    /// Trend of the energy, relative, per second: least squares through the means of a hundred equal parts.
    pub trend: f64,
    /// Standard error of that trend.
    pub trend_error: f64,
    /// Greatest entry of `RᵀR - I` at the end.
    pub orthogonality: f64,
}

/// Steps between two looks at the energy; even, since two steps of the consistent model belong together.
const GLANCE: usize = 10;
/// Parts whose means make the trend.
const PARTS: usize = 100;

impl LongRun {
    /// Third experiment with the step `step` (s); then `steps` steps without load, at least a thousand.
    ///
    /// # Errors
    /// A scene or a step that is not possible.
    pub fn run(
        study: &Study,
        model: RodModel,
        step: f64,
        steps: usize,
    ) -> Result<Self, PaperError> {
        let scene = Experiment::BendingStretching.scene();
        let simulation = study.simulation(
            scene,
            &[
                format!("rod.model={}", model.name()),
                format!("time.step_s={step:e}"),
            ],
        )?;
        let rod = &simulation.rod;
        let step = simulation.grid.step;
        let mut integrator = Integrator::new(rod, step, simulation.initial.clone());
        let advance = |integrator: &mut Integrator, n: usize| {
            (0..n)
                .try_for_each(|_| integrator.advance([Wrench::default(); 2]))
                .map_err(|error| PaperError::Step { scene, error })
        };
        let loaded = (Experiment::BendingStretching.unloaded() / step).round() as usize;
        advance(&mut integrator, loaded.next_multiple_of(2))?;

        let looks = (steps / GLANCE / PARTS).max(1);
        let mut means = [0.0; PARTS];
        let mut range = [f64::INFINITY, f64::NEG_INFINITY];
        for mean in &mut means {
            for _ in 0..looks {
                advance(&mut integrator, GLANCE)?;
                let energy = Energy::of(rod, integrator.state()).total();
                range = [range[0].min(energy), range[1].max(energy)];
                *mean += energy / looks as f64;
            }
        }
        let mean = means.iter().sum::<f64>() / PARTS as f64;
        let (slope, error) = trend(&means);
        let part = (looks * GLANCE) as f64 * step;
        Ok(Self {
            model,
            step,
            steps: looks * GLANCE * PARTS,
            mean,
            ripple: f64::max(mean - range[0], range[1] - mean) / mean,
            trend: slope / (mean * part),
            trend_error: error / (mean * part),
            orthogonality: (integrator.state().configuration.rotations.iter())
                .map(|r| (r.tr_mul(r) - Matrix3::identity()).amax())
                .fold(0.0, f64::max),
        })
    }
}

/// [`LongRun::run`] for every model, time step (s) and number of steps.
pub fn long_runs(
    study: &Study,
    runs: &[(RodModel, f64, usize)],
) -> Vec<Result<LongRun, PaperError>> {
    study.map(runs, |&(model, step, steps)| {
        LongRun::run(study, model, step, steps)
    })
}

/// Slope of a straight line through equidistant values (distance 1), and its standard error.
fn trend(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let (center, mean) = (0.5 * (n - 1.0), values.iter().sum::<f64>() / n);
    let points = || {
        values
            .iter()
            .enumerate()
            .map(|(i, v)| (i as f64 - center, v - mean))
    };
    let spread: f64 = points().map(|(x, _)| x * x).sum();
    let slope = points().map(|(x, y)| x * y).sum::<f64>() / spread;
    let rest: f64 = points().map(|(x, y)| (y - slope * x).powi(2)).sum();
    (slope, (rest / (n - 2.0) / spread).sqrt())
}
