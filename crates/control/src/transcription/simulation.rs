//! Simulation of the motion under given controls.

use crate::problem::OptimalControlProblem;
use mechanics::{ControlSignal, StepError, Stepper, TimeGrid, Trajectory};

/// Simulates the problem's rod forward under the given wrenches.
///
/// # Errors
/// Returns [`StepError`] of the integrator, or of the problem's [`StopSignal`](stop::StopSignal).
pub fn simulate(
    problem: &OptimalControlProblem,
    grid: TimeGrid,
    control: &ControlSignal,
) -> Result<Trajectory, StepError> {
    let rod = &problem.rod;
    let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), grid.n_steps + 1);
    let mut stepper = Stepper::new(rod, grid, problem.initial.clone());
    stepper.record(&mut trajectory);
    for k in 0..grid.n_steps {
        problem.stop.check_at(k)?;
        stepper.advance([control.at(k), control.at(k + 1)])?;
        stepper.record(&mut trajectory);
    }
    Ok(trajectory)
}
