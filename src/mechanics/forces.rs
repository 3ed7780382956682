//! Nodal forces: elastic, gravity, and the rod's own loads.

use nalgebra::{Matrix3, Vector3};

use super::integrator::TimeScheme;
use super::rod::Rod;

/// Force (spatial, N) and moment (body frame, N m) on every node.
#[derive(Clone, Debug, PartialEq)]
pub struct NodalForces {
    /// Forces, spatial frame.
    pub forces: Vec<Vector3<f64>>,
    /// Moments, body frame of each node.
    pub moments: Vec<Vector3<f64>>,
}

impl NodalForces {
    /// Zero forces on `n_nodes` nodes.
    #[must_use]
    pub fn zeros(n_nodes: usize) -> Self {
        Self {
            forces: vec![Vector3::zeros(); n_nodes],
            moments: vec![Vector3::zeros(); n_nodes],
        }
    }

    /// `-dU/dx`, `-dU/dη`, gravity and loads at time `t`. Control wrenches are not included.
    pub fn evaluate(
        &mut self,
        rod: &Rod,
        positions: &[Vector3<f64>],
        rotations: &[Matrix3<f64>],
        t: f64,
    ) {
        self.start_with_gravity(rod);
        self.add_elastic(rod, positions, rotations);
        self.add_loads(rod, rotations, t);
    }

    /// What acts at a time node by itself: all of [`Self::evaluate`], or under [`TimeScheme::Implicit`] gravity and loads
    /// only, because the elastic forces are those of the intervals.
    pub fn evaluate_at_node(
        &mut self,
        rod: &Rod,
        positions: &[Vector3<f64>],
        rotations: &[Matrix3<f64>],
        t: f64,
    ) {
        match rod.scheme {
            TimeScheme::Explicit => self.evaluate(rod, positions, rotations, t),
            TimeScheme::Implicit => {
                self.start_with_gravity(rod);
                self.add_loads(rod, rotations, t);
            }
        }
    }

    fn start_with_gravity(&mut self, rod: &Rod) {
        for ((force, moment), node) in self
            .forces
            .iter_mut()
            .zip(&mut self.moments)
            .zip(&rod.nodes)
        {
            *force = rod.gravity * node.mass;
            *moment = Vector3::zeros();
        }
    }

    fn add_elastic(&mut self, rod: &Rod, positions: &[Vector3<f64>], rotations: &[Matrix3<f64>]) {
        for (q, element) in rod.elements.iter().enumerate() {
            let gradient =
                element.gradient(rod.strain_rule, &Rod::element_pose(q, positions, rotations));
            self.forces[q] += gradient.force;
            self.forces[q + 1] -= gradient.force;
            self.moments[q] -= gradient.moment_a;
            self.moments[q + 1] -= gradient.moment_b;
        }
    }

    fn add_loads(&mut self, rod: &Rod, rotations: &[Matrix3<f64>], t: f64) {
        for load in &rod.loads {
            let wrench = load.wrench(t, &rotations[load.node]);
            self.forces[load.node] += wrench.force;
            self.moments[load.node] += wrench.moment;
        }
    }
}
