//! The tangent stiffness of the whole rod, a block-tridiagonal matrix.

use nalgebra::Matrix3;

use super::block_tridiagonal::BlockTridiagonal;
use super::configuration::Configuration;
use super::rod::Rod;

/// Returns the derivative of minus the forces and body moments on the free nodes (elements, loads at their value at time `t`, and
/// actuators with their given efforts) along
/// `(δx, η)` of these nodes, the first of them in block 0; motions that a joint holds are [fast modes of their own](Rod::hold_joints). It is symmetric at an equilibrium under loads with a potential.
pub(super) fn tangent_stiffness(rod: &Rod, at: &Configuration, t: f64) -> BlockTridiagonal {
    let mut out = free_stiffness(rod, at, t);
    rod.hold_joints(rod.first_free_node(), &mut out);
    out
}

/// Returns the stiffness of [`tangent_stiffness`] as if the joints of the rod were free.
pub(super) fn free_stiffness(rod: &Rod, at: &Configuration, t: f64) -> BlockTridiagonal {
    let first = rod.first_free_node();
    let efforts = rod.actuators.efforts(t);
    let mut out = BlockTridiagonal::zeros(rod.n_nodes() - first);
    for (q, element) in rod.elements.iter().enumerate() {
        let pose = Rod::element_pose(q, &at.positions, &at.rotations);
        let (_, mut k) = element.stiffness(rod.strain_rule, &pose);
        if let Some(active) = rod.active_stiffness(q, &pose, &efforts) {
            k += active;
        }
        out.add_element(first, q, &k);
    }
    for load in rod.loads.iter().filter(|load| load.node >= first) {
        let (force, moment) = load.wrench_derivative(t, &at.rotations[load.node]);
        let block = &mut out.diagonal[load.node - first];
        let mut subtract = |row: usize, change: &Matrix3<f64>| {
            let mut part = block.fixed_view_mut::<3, 3>(row, 3);
            part -= change;
        };
        subtract(0, &force);
        subtract(3, &moment);
    }
    out
}
