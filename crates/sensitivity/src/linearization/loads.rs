//! Derivatives of the wrenches of loads and of actuators of one's own along the configuration.

use nalgebra::Matrix3;

use super::Motion;
use cosserat::actuator::{ActingDerivative, StateView};
use cosserat::configuration::Trajectory;

/// The derivative of a load's wrench along the rotation of its node.
#[derive(Clone, Copy, Debug)]
pub struct LoadDerivative {
    /// The node.
    pub node: usize,
    /// `∂f/∂ζ`, N.
    pub force: Matrix3<f64>,
    /// `∂τ/∂ζ`, N m.
    pub moment: Matrix3<f64>,
}

/// Returns the derivatives of all loads that turn with their node.
pub(crate) fn load_derivatives(
    motion: &Motion,
    trajectory: &Trajectory,
    k: usize,
) -> Vec<LoadDerivative> {
    let Motion { rod, grid, .. } = *motion;
    let rotations = trajectory.rotations_at(k);
    let node = grid.node(k);
    (rod.loads.iter().filter(|load| load.turns()))
        .map(|load| {
            let rotation = &rotations[load.node];
            let (force, moment) = load.wrench_derivative_at_node(&node, rotation);
            LoadDerivative {
                node: load.node,
                force,
                moment,
            }
        })
        .collect()
}

/// Returns the derivatives of all actuators of one's own.
pub(crate) fn acting_derivatives(
    motion: &Motion,
    trajectory: &Trajectory,
    k: usize,
) -> Vec<ActingDerivative> {
    let mut out = Vec::new();
    if let Some(control) = motion.control.filter(|control| !control.acting.is_empty()) {
        let at = StateView::of(motion.rod, &motion.grid, trajectory, k);
        out.extend(control.acting.iter().map(|acting| {
            let u = acting.controls(control.at(k).inputs);
            ActingDerivative {
                nodes: acting.actuator.nodes(motion.rod),
                matrix: acting.actuator.configuration_jacobian(&at, &u),
            }
        }));
    }
    out
}
