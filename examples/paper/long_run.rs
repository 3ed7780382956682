//! The energy of a rod without loads over a long time.

use nalgebra::Matrix3;
use softarm::mechanics::forces::NodalForces;
use softarm::mechanics::{Energy, NodeWrenches, Rod, RodModel, State, Stepper};

use super::study::{BENDING_STRETCHING, Outcome, Study, slope};

/// Energy and rotations of the third experiment's rod after its loads have ended.
#[derive(Clone, Debug)]
pub struct LongRun {
    /// Mean energy, J.
    pub mean: f64,
    /// Greatest distance of the energy from its mean, relative.
    pub ripple: f64,
    /// Relative change of the energy per second, and its standard error as if the parts were independent.
    pub trend: [f64; 2],
    /// The same of the energy with its correction for the step, which the steps keep to the fourth order.
    pub corrected: [f64; 2],
    /// Greatest entry of `RᵀR - I` at the end.
    pub orthogonality: f64,
}

/// Steps between two looks at the energy; even, since two steps of the consistent model belong together.
const GLANCE: usize = 10;
/// Parts of the run whose means make the trends.
const PARTS: usize = 100;

/// Runs the third experiment with a step (s), and then `steps` steps without load, a multiple of a thousand.
pub fn long_run(study: &Study, model: RodModel, step: f64, steps: usize) -> Outcome<LongRun> {
    let own = [format!("time.step_s={step}")];
    let simulation = study.simulation(BENDING_STRETCHING.scene, model, &own)?;
    let (rod, step) = (&simulation.rod, simulation.grid.step);
    let mut stepper = Stepper::new(rod, step, simulation.initial.clone());
    let loaded = (BENDING_STRETCHING.unloaded / step).round() as usize;
    for _ in 0..loaded.next_multiple_of(2) {
        stepper.advance([NodeWrenches::NONE; 2])?;
    }
    let looks = steps / GLANCE / PARTS;
    let (mut means, mut corrected) = ([0.0; PARTS], [0.0; PARTS]);
    let (mut least, mut greatest) = (f64::INFINITY, f64::NEG_INFINITY);
    for (mean, corrected) in means.iter_mut().zip(&mut corrected) {
        for _ in 0..looks {
            for _ in 0..GLANCE {
                stepper.advance([NodeWrenches::NONE; 2])?;
            }
            let state = stepper.state();
            let energy = Energy::of(rod, &state).total();
            (least, greatest) = (energy.min(least), energy.max(greatest));
            *mean += energy / looks as f64;
            let correction = step_correction(rod, &state, stepper.time(), step);
            *corrected += (energy + correction) / looks as f64;
        }
    }
    let mean = means.iter().sum::<f64>() / PARTS as f64;
    let part = (looks * GLANCE) as f64 * step;
    let trend = |values: [f64; PARTS]| {
        let points: Vec<_> = (0..PARTS).map(|i| (i as f64, values[i])).collect();
        slope(&points).map(|change| change / (mean * part))
    };
    Ok(LongRun {
        mean,
        ripple: f64::max(mean - least, greatest - mean) / mean,
        trend: trend(means),
        corrected: trend(corrected),
        orthogonality: (stepper.state().configuration.rotations.iter())
            .map(|r| (r.tr_mul(r) - Matrix3::identity()).amax())
            .fold(0.0, f64::max),
    })
}

/// Returns by how much the mean over time of the energy at the time nodes is below the energy that the steps keep to the fourth
/// order, `(h²/24) Σ |f|²/m + τ·J⁻¹τ`, J.
///
/// Backward error analysis of the Störmer-Verlet step gives the kept energy as `H + (h²/12) v·V″v - (h²/24) V′·M⁻¹V′`
/// (Hairer, Lubich and Wanner, Geometric Numerical Integration, IX.3); `v·V″v` is `V′·M⁻¹V′` but for the derivative of
/// `V′·v` with respect to time, whose mean vanishes over long times. As energy wanders to shorter waves the correction grows,
/// and `H` falls by as much without any loss. The turning of nodes within a step is left out: forces act on slender rods far
/// more than inertia.
fn step_correction(rod: &Rod, state: &State, time: f64, h: f64) -> f64 {
    let (x, r) = (
        &state.configuration.positions,
        &state.configuration.rotations,
    );
    let mut forces = NodalForces::zeros(rod.n_nodes());
    forces.evaluate(rod, x, r, time);
    let rotary = rod.rotary_at(x);
    let sum: f64 = (rod.first_free_node()..rod.n_nodes())
        .map(|node| {
            let (f, t) = (&forces.forces[node], &forces.moments[node]);
            f.norm_squared() / rod.nodes[node].mass + t.dot(&t.component_div(&rotary[node]))
        })
        .sum();
    h * h / 24.0 * sum
}
