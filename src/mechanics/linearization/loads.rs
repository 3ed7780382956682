//! Derivatives of the wrenches of loads and of actuators of one's own along the configuration.

use faer::Mat;
use nalgebra::{Matrix3, Matrix6};

use super::Motion;
use crate::mechanics::actuator::{ActingDerivative, StateView};
use crate::mechanics::configuration::Trajectory;
use crate::mechanics::pose_actuator::Posed;

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
pub(in crate::mechanics) fn load_derivatives(
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

/// Returns the derivatives of all actuators of one's own and of all functions of nodes.
pub(in crate::mechanics) fn acting_derivatives(
    motion: &Motion,
    trajectory: &Trajectory,
    k: usize,
) -> Vec<ActingDerivative> {
    let mut out = Vec::new();
    if let Some(control) = motion.control.filter(|control| !control.acting.is_empty()) {
        let at = StateView::of(motion.rod, &motion.grid, trajectory, k);
        out.extend(control.acting.iter().map(|acting| {
            let u = acting.controls(control.at(k).wrenches);
            ActingDerivative {
                nodes: acting.actuator.nodes(motion.rod),
                matrix: acting.actuator.configuration_jacobian(&at, &u),
            }
        }));
    }
    if motion.rod.actuators.functions().is_empty() {
        return out;
    }
    let efforts = motion.efforts_at(k);
    let (x, r) = (trajectory.positions_at(k), trajectory.rotations_at(k));
    out.extend(
        (motion.rod.posed(Posed::All, &efforts)).filter_map(|(own, factor)| {
            let tangent = own.function.tangent(&own.pose(x, r)) * factor;
            // That of a node that touches nothing is zero.
            (tangent != Matrix6::zeros()).then(|| ActingDerivative {
                nodes: vec![own.node],
                matrix: Mat::from_fn(6, 6, |i, j| tangent[(i, j)]),
            })
        }),
    );
    out
}
