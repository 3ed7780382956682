//! The derivative of the discrete equations of motion along the time step, at fixed configurations.

use nalgebra::Vector3;

use super::configuration::Trajectory;
use super::differences;
use super::integrator::StepError;
use super::linearization::{Defects, Motion, RightHandSide};
use super::sensitivity::defects;
use super::signal::ControlSignal;

/// Relative change of the step in the differences: their error is of its fourth power, and it stays far above rounding.
const CHANGE: f64 = 1e-3;

/// `-h ∂r_k/∂h` of every row of the [equations of motion](defects) at fixed configurations, and `h ∂p_N/∂h` of the momenta at the end:
/// the right-hand side whose answer is the motion's derivative along the logarithm of its time step.
///
/// The rows are rational functions of the step (momenta are differences over `h`, impulses forces times `h`, damping enters as
/// `1/(1 + c h/2)`), so that differences of fourth order over a thousandth of it are good to 1e-10 of their terms.
///
/// # Errors
/// [`StepError`] of [`defects`].
pub fn step_right_hand_side(
    motion: &Motion,
    trajectory: &Trajectory,
    control: &ControlSignal,
) -> Result<RightHandSide, StepError> {
    let at = |change: f64| -> Result<Defects, StepError> {
        let mut changed = *motion;
        changed.grid.step *= 1.0 + change;
        defects(&changed, trajectory, control)
    };
    let near = [at(CHANGE)?, at(-CHANGE)?];
    let far = [at(2.0 * CHANGE)?, at(-2.0 * CHANGE)?];
    let slope = |part: fn(&Defects) -> &[Vector3<f64>], sign: f64| -> Vec<Vector3<f64>> {
        let [near, far] = [&near, &far].map(|pair| (part(&pair[0]), part(&pair[1])));
        (0..near.0.len())
            .map(|i| {
                sign * differences::slope([near.0[i], near.1[i]], [far.0[i], far.1[i]], CHANGE)
            })
            .collect()
    };
    Ok(RightHandSide {
        linear: slope(|defects| &defects.linear, -1.0),
        angular: slope(|defects| &defects.angular, -1.0),
        terminal_linear: slope(|defects| &defects.terminal_linear, 1.0),
        terminal_angular: slope(|defects| &defects.terminal_angular, 1.0),
        start: None,
    })
}
