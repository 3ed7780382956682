//! The energy of a rod without loads over a long time.

use nalgebra::Matrix3;

use super::{Experiment, PaperError, Study};
use crate::mechanics::forces::NodalForces;
use crate::mechanics::{Energy, NodeWrenches, Rod, RodModel, State, Stepper};

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
    /// Of the energy.
    pub trend: Trend,
    /// Of the energy with its correction for the step, which the steps keep to the fourth order.
    pub corrected: Trend,
    /// Greatest entry of `RᵀR - I` at the end.
    pub orthogonality: f64,
}

/// Change of an energy over the whole run: least squares through the means of a hundred equal parts.
#[derive(Clone, Copy, Debug)]
pub struct Trend {
    /// Relative, per second.
    pub slope: f64,
    /// Its standard error, as if the parts were independent.
    pub error: f64,
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
        Self::run_telling(study, model, step, steps, &|_| {})
    }

    /// [`LongRun::run`] that tells of so many steps more.
    fn run_telling(
        study: &Study,
        model: RodModel,
        step: f64,
        steps: usize,
        tell: &dyn Fn(usize),
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
        let mut integrator = Stepper::new(rod, step, simulation.initial.clone());
        let advance = |integrator: &mut Stepper, n: usize| {
            (0..n)
                .try_for_each(|_| integrator.advance([NodeWrenches::NONE; 2]))
                .map_err(|error| PaperError::Step { scene, error })
        };
        let loaded = (Experiment::BendingStretching.unloaded() / step).round() as usize;
        advance(&mut integrator, loaded.next_multiple_of(2))?;

        let looks = (steps / GLANCE / PARTS).max(1);
        let mut means = [0.0; PARTS];
        let mut corrected = [0.0; PARTS];
        let mut range = [f64::INFINITY, f64::NEG_INFINITY];
        for (mean, corrected) in means.iter_mut().zip(&mut corrected) {
            for _ in 0..looks {
                advance(&mut integrator, GLANCE)?;
                let state = integrator.state();
                let energy = Energy::of(rod, &state).total();
                range = [range[0].min(energy), range[1].max(energy)];
                *mean += energy / looks as f64;
                let correction = step_correction(rod, &state, integrator.time(), step);
                *corrected += (energy + correction) / looks as f64;
            }
            tell(looks * GLANCE);
        }
        let mean = means.iter().sum::<f64>() / PARTS as f64;
        let part = (looks * GLANCE) as f64 * step;
        Ok(Self {
            model,
            step,
            steps: looks * GLANCE * PARTS,
            mean,
            ripple: f64::max(mean - range[0], range[1] - mean) / mean,
            trend: Trend::of(&means, mean * part),
            corrected: Trend::of(&corrected, mean * part),
            orthogonality: (integrator.state().configuration.rotations.iter())
                .map(|r| (r.tr_mul(r) - Matrix3::identity()).amax())
                .fold(0.0, f64::max),
        })
    }
}

/// What the mean over time of the energy at the time nodes lacks of the energy that the steps keep to the fourth order,
/// `(h²/24) Σ |f|²/m + τ·J⁻¹τ`, J.
///
/// Backward error analysis of the Störmer-Verlet step gives the kept energy as `H + (h²/12) v·V″v - (h²/24) V′·M⁻¹V′`
/// (Hairer, Lubich and Wanner, Geometric Numerical Integration, IX.3); `v·V″v` is `V′·M⁻¹V′` but for the derivative of
/// `V′·v` with respect to time, whose mean vanishes over long times. As energy wanders to shorter waves the correction grows,
/// and `H` falls by as much without any loss. The turning of nodes within a step is left out: forces act on slender rods far
/// more than inertia.
fn step_correction(rod: &Rod, state: &State, time: f64, h: f64) -> f64 {
    let configuration = &state.configuration;
    let mut forces = NodalForces::zeros(rod.n_nodes());
    forces.evaluate(
        rod,
        &configuration.positions,
        &configuration.rotations,
        time,
    );
    let rotary = rod.rotary_at(&configuration.positions);
    let sum: f64 = (rod.first_free_node()..rod.n_nodes())
        .map(|node| {
            let (f, t) = (&forces.forces[node], &forces.moments[node]);
            f.norm_squared() / rod.nodes[node].mass + t.dot(&t.component_div(&rotary[node]))
        })
        .sum();
    h * h / 24.0 * sum
}

/// [`LongRun::run`] for every model, time step (s) and number of steps; `tell` hears of the steps without load while they are made.
pub fn long_runs(
    study: &Study,
    runs: &[(RodModel, f64, usize)],
    tell: &(dyn Fn(usize) + Sync),
) -> Vec<Result<LongRun, PaperError>> {
    study.map(runs, |&(model, step, steps)| {
        LongRun::run_telling(study, model, step, steps, &|n| tell(n))
    })
}

impl Trend {
    /// Of values at equal distances, over `scale`.
    fn of(values: &[f64], scale: f64) -> Self {
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
        Self {
            slope: slope / scale,
            error: (rest / (n - 2.0) / spread).sqrt() / scale,
        }
    }
}
