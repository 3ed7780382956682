//! The tangent stiffness of the whole rod, a block-tridiagonal matrix.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use crate::block_tridiagonal::BlockTridiagonal;
use crate::configuration::Configuration;
use crate::pose_actuator::Posed;
use crate::rod::Rod;

/// Returns the derivative of minus the forces and body moments on the free nodes (elements, loads at their value at time `t`, and
/// actuators with their efforts) along `(δx, η)` of these nodes, the first of them in block 0; motions that a joint holds are
/// [fast modes of their own](Rod::hold_joints). It is symmetric at an equilibrium under loads with a potential. The effort of a winch is
/// constant here; [`winch_stiffness`] and [`friction_stiffness`] have the rest.
pub fn tangent_stiffness(rod: &Rod, at: &Configuration, t: f64) -> BlockTridiagonal {
    let mut out = free_stiffness(rod, at, t);
    rod.hold_joints(rod.first_free_node(), &mut out);
    out
}

/// Returns the stiffness of [`tangent_stiffness`] as if the joints of the rod were free.
pub fn free_stiffness(rod: &Rod, at: &Configuration, t: f64) -> BlockTridiagonal {
    let first = rod.first_free_node();
    let efforts = rod.efforts_at(rod.actuators.efforts(t), &at.positions, &at.rotations);
    let mut out = BlockTridiagonal::zeros(rod.n_nodes() - first);
    for (q, element) in rod.elements.iter().enumerate() {
        let pose = Rod::element_pose(q, &at.positions, &at.rotations);
        let (_, mut k) = element.stiffness(rod.strain_rule, &pose);
        if let Some(active) = rod.active_stiffness(q, &pose, &efforts) {
            k += active;
        }
        out.add_element(first, q, &k);
    }
    out.add_posed(rod, at, (Posed::All, &efforts));
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

/// A part `left rightᵀ` of a stiffness on the free nodes, over `(δx, η)` of each.
#[derive(Clone, Debug, PartialEq)]
pub struct Product {
    /// Wrenches.
    pub left: Vec<Vector6<f64>>,
    /// The form of the motion to which they are proportional.
    pub right: Vec<Vector6<f64>>,
}

/// Returns the part of the stiffness on the free nodes from the efforts of winches, of tendons without friction, that change with the
/// configuration: for every tendon with tension a factor, positive, and a vector `v` over `(δx, η)` of each node, of `factor v vᵀ`.
pub fn winch_stiffness(rod: &Rod, at: &Configuration, t: f64) -> Vec<(f64, Vec<Vector6<f64>>)> {
    let first = rod.first_free_node();
    let inputs = rod.actuators.efforts(t);
    (rod.effort_slopes(&inputs, &at.positions, &at.rotations)
        .iter())
    .map(|own| {
        let nodes = own.pull.forces.iter().zip(&own.pull.moments).skip(first);
        let vector = nodes.map(|(f, m)| Vector6::new(f.x, f.y, f.z, m.x, m.y, m.z));
        let mut vector: Vec<_> = vector.collect();
        rod.project_joints(&mut vector);
        (-own.slope, vector)
    })
    .collect()
}

/// Returns the part of the stiffness on the free nodes from the tensions of tendons with friction that change with the configuration: a product
/// for every element that one of them passes.
pub fn friction_stiffness(rod: &Rod, at: &Configuration, t: f64) -> Vec<Product> {
    let free = |numbers: &[f64], sign: f64| -> Vec<Vector6<f64>> {
        let nodes = numbers.chunks_exact(6).skip(rod.first_free_node());
        let mut out: Vec<_> = nodes
            .map(|own| Vector6::from_column_slice(own) * sign)
            .collect();
        rod.project_joints(&mut out);
        out
    };
    let inputs = rod.actuators.efforts(t);
    (rod.line_changes(&inputs, [at.poses(); 2], None).iter())
        .map(|own| Product {
            left: free(&own.pulls[0], -1.0),
            right: free(&own.forms[0], 1.0),
        })
        .collect()
}

impl BlockTridiagonal {
    /// Adds the stiffness of functions of nodes, those of actuators with the given efforts, and but for [`Posed::Driven`] of contacts, to a matrix over the free nodes.
    pub fn add_posed(&mut self, rod: &Rod, at: &Configuration, (which, efforts): (Posed, &[f64])) {
        let first = rod.first_free_node();
        for (own, factor) in rod
            .posed(which, efforts)
            .filter(|(own, _)| own.node >= first)
        {
            let pose = own.pose(&at.positions, &at.rotations);
            self.diagonal[own.node - first] -= own.function.tangent(&pose) * factor;
        }
        if which != Posed::Driven {
            self.add_contacts(rod, &at.positions);
        }
    }

    /// Adds the stiffness of contacts to a matrix over the free nodes.
    fn add_contacts(&mut self, rod: &Rod, positions: &[Vector3<f64>]) {
        let first = rod.first_free_node();
        for touch in rod.touches() {
            let ends = [touch.element, touch.element + 1];
            let Some(hessian) = touch.hessian(ends.map(|node| &positions[node])) else {
                continue;
            };
            let part = |i: usize, j: usize| hessian.fixed_view::<3, 3>(3 * i, 3 * j);
            let add = |block: &mut Matrix6<f64>, i: usize, j: usize| {
                let mut linear = block.fixed_view_mut::<3, 3>(0, 0);
                linear += part(i, j);
            };
            let Some(q) = touch.element.checked_sub(first) else {
                // The base is held.
                if let Some(block) = self.diagonal.get_mut(touch.element + 1 - first) {
                    add(block, 1, 1);
                }
                continue;
            };
            add(&mut self.diagonal[q], 0, 0);
            add(&mut self.diagonal[q + 1], 1, 1);
            add(&mut self.below[q], 1, 0);
            add(&mut self.above[q], 0, 1);
        }
    }
}
