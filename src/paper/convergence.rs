//! The convergence study of section 5.4.
//!
//! Errors (94) and (95) are against a reference run, at the nodes that both have and every 1 ms; the clamped node, where (94)
//! divides by zero, is left out.

use nalgebra::Matrix3;

use super::{PaperError, Study};
use crate::mechanics::{NodeWrenches, RodModel, Stepper, Trajectory};

const SCENE: &str = "paper-convergence";
const SAMPLE_PERIOD: f64 = 1e-3;

/// Elements of the study in time.
pub const TIME_STUDY_ELEMENTS: usize = 50;
/// Steps of the study in time, s, the reference last.
pub const TIME_STUDY_STEPS: [f64; 6] = [1e-3, 5e-4, 1e-4, 5e-5, 1e-5, 1e-6];
/// Step of the study in space, s.
pub const SPACE_STUDY_STEP: f64 = 1e-4;
/// Elements of the study in space, the reference last.
pub const SPACE_STUDY_ELEMENTS: [usize; 10] = [10, 100, 200, 300, 400, 500, 600, 700, 800, 900];

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

/// Errors of `steps` (s) against the last of them, with `elements` elements until `end` (s).
///
/// # Errors
/// A scene or a step that is not possible.
pub fn in_time(
    study: &Study,
    model: RodModel,
    elements: usize,
    steps: &[f64],
    end: f64,
) -> Result<Vec<ConvergencePoint>, PaperError> {
    let grids: Vec<_> = steps.iter().map(|&step| (elements, step)).collect();
    against_the_last(study, model, &grids, end)
}

/// Errors of `elements` against the last of them, with the step `step` (s) until `end` (s).
///
/// # Errors
/// A scene or a step that is not possible.
pub fn in_space(
    study: &Study,
    model: RodModel,
    elements: &[usize],
    step: f64,
    end: f64,
) -> Result<Vec<ConvergencePoint>, PaperError> {
    let grids: Vec<_> = elements.iter().map(|&k| (k, step)).collect();
    against_the_last(study, model, &grids, end)
}

/// Slope of the straight line through `(log size, log error)`, least squares.
#[must_use]
pub fn order(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let logs = || points.iter().map(|(size, error)| (size.ln(), error.ln()));
    let (mean_x, mean_y) = logs().fold((0.0, 0.0), |m, (x, y)| (m.0 + x / n, m.1 + y / n));
    let (xy, xx) = logs().fold((0.0, 0.0), |s, (x, y)| {
        (
            s.0 + (x - mean_x) * (y - mean_y),
            s.1 + (x - mean_x) * (x - mean_x),
        )
    });
    xy / xx
}

fn against_the_last(
    study: &Study,
    model: RodModel,
    grids: &[(usize, f64)],
    end: f64,
) -> Result<Vec<ConvergencePoint>, PaperError> {
    let Some((&(reference, _), others)) = grids.split_last() else {
        return Ok(Vec::new());
    };
    let parts: Vec<usize> = others.iter().map(|&(k, _)| divisor(k, reference)).collect();
    // Of the reference, only what some other grid shares with it is kept.
    let kept = parts.iter().fold(1, |all, &n| all / divisor(all, n) * n);
    // The reference first: it takes longest.
    let jobs: Vec<_> = (grids.last().into_iter().chain(others))
        .zip([kept].into_iter().chain(parts))
        .map(|(&(elements, step), parts)| (elements, step, parts))
        .collect();
    let mut runs = study
        .map(&jobs, |&(elements, step, parts)| {
            sample(study, model, elements, step, parts, end)
        })
        .into_iter();
    let Some(reference) = runs.next().transpose()? else {
        return Ok(Vec::new());
    };
    runs.zip(others)
        .map(|(run, &(elements, step))| {
            let (position, rotation) = distance(&run?, &reference);
            Ok(ConvergencePoint {
                elements,
                step,
                position,
                rotation,
            })
        })
        .collect()
}

/// The ends of `parts` equal parts of the rod, every [`SAMPLE_PERIOD`].
fn sample(
    study: &Study,
    model: RodModel,
    elements: usize,
    step: f64,
    parts: usize,
    end: f64,
) -> Result<Trajectory, PaperError> {
    let mut posed = study.posed(SCENE)?;
    posed.arm.model = model;
    posed.discretization.elements = elements;
    posed.discretization.step = Some(step);
    posed.end = end;
    let (rod, grid, start) = posed.discretize()?;
    let every = ((SAMPLE_PERIOD / grid.step).round() as usize).max(1);
    let mut integrator = Stepper::new(&rod, grid.step, start);
    let mut samples = Trajectory::with_capacity(parts + 1, grid.n_steps / every + 1);
    for k in 0..=grid.n_steps {
        if k % every == 0 {
            let now = &integrator.state().configuration;
            for node in (0..=elements).step_by(elements / parts) {
                samples.positions.push(now.positions[node]);
                samples.rotations.push(now.rotations[node]);
            }
        }
        if k < grid.n_steps {
            integrator
                .advance([NodeWrenches::NONE; 2])
                .map_err(|error| PaperError::Step {
                    scene: SCENE,
                    error,
                })?;
        }
    }
    Ok(samples)
}

/// `ε_pos` (94) and `ε_rot` (95) over the nodes of `run` but the clamped one, all of which `reference` has.
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

/// Greatest common divisor.
fn divisor(a: usize, b: usize) -> usize {
    if b == 0 { a } else { divisor(b, a % b) }
}
