//! The convergence study of section 5.4.
//!
//! Errors (94) and (95) are against a reference run, at the nodes that both have and every 1 ms; the clamped node, where (94)
//! divides by zero, is left out.

use nalgebra::Matrix3;
use softarm::mechanics::{RodModel, Trajectory};

use super::study::{Outcome, Study, run, slope};

const SAMPLE_PERIOD: f64 = 1e-3; // s

/// Errors of one run against the reference.
#[derive(Clone, Copy, Debug)]
pub struct ConvergencePoint {
    /// Number of elements.
    pub elements: usize,
    /// Time step, s.
    pub step: f64,
    /// `ε_pos`, (94).
    pub position: f64,
    /// `ε_rot`, (95).
    pub rotation: f64,
}

/// Returns the errors of grids (elements, step in s) against the last of them over `end` seconds.
pub fn against_the_last(
    study: &Study,
    model: RodModel,
    grids: &[(usize, f64)],
    end: f64,
) -> Outcome<Vec<ConvergencePoint>> {
    let finest = grids.last().map_or(1, |&(elements, _)| elements);
    let mut runs = study.map(grids, |&(elements, step)| {
        // Only the nodes that the reference has as well are kept.
        let parts = divisor(elements, finest);
        sample(study, model, elements, step, parts, end)
    })?;
    let reference = runs.pop().ok_or("there is no grid")?;
    let errors = |(run, &(elements, step)): (&Trajectory, &(usize, f64))| {
        let (position, rotation) = distance(run, &reference);
        ConvergencePoint {
            elements,
            step,
            position,
            rotation,
        }
    };
    Ok(runs.iter().zip(grids).map(errors).collect())
}

/// Returns the order of `error` in `size`: the slope of its logarithm.
pub fn order(
    points: &[ConvergencePoint],
    size: impl Fn(&ConvergencePoint) -> f64,
    error: impl Fn(&ConvergencePoint) -> f64,
) -> f64 {
    let logs = points.iter().map(|p| (size(p).ln(), error(p).ln()));
    slope(&logs.collect::<Vec<_>>())[0]
}

/// Returns the ends of `parts` equal parts of the rod, every [`SAMPLE_PERIOD`].
fn sample(
    study: &Study,
    model: RodModel,
    elements: usize,
    step: f64,
    parts: usize,
    end: f64,
) -> Outcome<Trajectory> {
    let own = [
        format!("rod.elements={elements}"),
        format!("time.step_s={step}"),
        format!("time.end_s={end}"),
    ];
    let simulation = study.simulation("paper-convergence", model, &own)?;
    let every = ((SAMPLE_PERIOD / simulation.grid.step).round() as usize).max(1);
    let mut samples = Trajectory::with_capacity(parts + 1, simulation.grid.n_steps / every + 1);
    run(&simulation, |k, state| {
        if k % every == 0 {
            let now = &state.configuration;
            for node in (0..=elements).step_by(elements / parts) {
                samples.positions.push(now.positions[node]);
                samples.rotations.push(now.rotations[node]);
            }
        }
    })?;
    Ok(samples)
}

/// Returns `ε_pos` (94) and `ε_rot` (95) over the nodes of `run` but the clamped one, all of which `reference` has.
fn distance(run: &Trajectory, reference: &Trajectory) -> (f64, f64) {
    let stride = (reference.n_nodes - 1) / (run.n_nodes - 1);
    let mut worst = (0.0, 0.0);
    for k in 0..run.n_times() {
        let (x, r) = (run.positions_at(k), run.rotations_at(k));
        let (x_ref, r_ref) = (reference.positions_at(k), reference.rotations_at(k));
        for q in 1..run.n_nodes {
            let (x_ref, r_ref) = (x_ref[q * stride], r_ref[q * stride]);
            worst.0 = f64::max(worst.0, (x[q] - x_ref).norm() / x_ref.norm());
            worst.1 = f64::max(worst.1, (Matrix3::identity() - r_ref.tr_mul(&r[q])).norm());
        }
    }
    worst
}

/// Returns the greatest common divisor.
fn divisor(a: usize, b: usize) -> usize {
    if b == 0 { a } else { divisor(b, a % b) }
}
