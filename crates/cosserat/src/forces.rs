//! Forces and moments on the nodes: elastic, gravity, and the rod's own loads.

use nalgebra::{Matrix3, Vector3};

use super::configuration::Poses;
use super::element::ElementGradient;
use super::pose_actuator::Posed;
use super::rod::Rod;
use super::strain_actuator::{EffortLaw, EffortState};
use super::time::{TimeNode, TimeScheme};
use crate::{Configuration, Wrench};

/// Force (spatial, N) and moment (body frame, N m) on every node.
#[derive(Clone, Debug, PartialEq)]
pub struct NodalForces {
    /// Forces, spatial frame.
    pub forces: Vec<Vector3<f64>>,
    /// Moments, body frame of each node.
    pub moments: Vec<Vector3<f64>>,
}

/// The derivative of an effort along the configuration: `δu = slope (pull·δq)`, with the wrenches `pull` on the nodes of a unit effort.
/// Its forces have the derivative `slope pull pullᵀ`, of rank one.
#[derive(Clone, Debug)]
pub struct EffortSlope {
    /// `∂u/∂y`, negative.
    pub slope: f64,
    /// Forces, spatial frame, and moments, body frame of the node, per effort.
    pub pull: NodalForces,
}

impl NodalForces {
    /// Returns zero forces on `n_nodes` nodes.
    #[must_use]
    pub fn zeros(n_nodes: usize) -> Self {
        Self {
            forces: vec![Vector3::zeros(); n_nodes],
            moments: vec![Vector3::zeros(); n_nodes],
        }
    }

    /// Sets all to zero.
    pub(super) fn clear(&mut self) {
        self.forces.fill(Vector3::zeros());
        self.moments.fill(Vector3::zeros());
    }

    /// Computes `-dU/dx`, `-dU/dη`, gravity, loads and the given efforts of actuators at the instant `t`. Controls are not included.
    pub fn evaluate(
        &mut self,
        rod: &Rod,
        positions: &[Vector3<f64>],
        rotations: &[Matrix3<f64>],
        t: f64,
    ) {
        self.evaluate_elastic(rod, positions, rotations);
        let instant = TimeNode {
            time: t,
            before: 0.0,
            after: 0.0,
        };
        self.add_loads(rod, rotations, &instant);
        self.add_alone(rod, positions, rotations);
        let efforts = rod.efforts_at(rod.actuators.efforts(t), positions, rotations);
        self.add_active(rod, positions, rotations, &efforts);
    }

    /// Adds the forces of the actuators with the given efforts at one instant.
    pub fn add_active(
        &mut self,
        rod: &Rod,
        positions: &[Vector3<f64>],
        rotations: &[Matrix3<f64>],
        efforts: &[f64],
    ) {
        if efforts.iter().all(|effort| *effort == 0.0) {
            return;
        }
        self.add_posed(rod, positions, rotations, (Posed::Driven, efforts));
        self.add_active_stress(rod, positions, rotations, efforts);
    }

    /// Adds the forces of functions of nodes, those of actuators with the given efforts.
    pub fn add_posed(
        &mut self,
        rod: &Rod,
        positions: &[Vector3<f64>],
        rotations: &[Matrix3<f64>],
        (which, efforts): (Posed, &[f64]),
    ) {
        for (own, factor) in rod.posed(which, efforts) {
            let wrench = own.wrench(&own.pose(positions, rotations), factor);
            self.forces[own.node] += wrench.force;
            self.moments[own.node] += wrench.moment;
        }
    }

    /// Adds the forces of what needs no effort: of potentials of nodes, and of contacts.
    pub fn add_alone(&mut self, rod: &Rod, positions: &[Vector3<f64>], rotations: &[Matrix3<f64>]) {
        self.add_posed(rod, positions, rotations, (Posed::Alone, &[]));
        rod.visit_contact_forces(
            |node| positions[node],
            |node, force| self.forces[node] += force,
        );
    }

    /// Adds the forces of the stress of actuators on strains with the given efforts.
    pub fn add_active_stress(
        &mut self,
        rod: &Rod,
        positions: &[Vector3<f64>],
        rotations: &[Matrix3<f64>],
        efforts: &[f64],
    ) {
        if rod.actuators.points().is_empty() {
            return;
        }
        for q in 0..rod.n_elements() {
            let pose = Rod::element_pose(q, positions, rotations);
            if let Some(gradient) = rod.active_gradient(q, &pose, efforts) {
                self.add_gradient(q, &gradient);
            }
        }
    }

    /// Adds the forces on the ends of element `q` of a gradient.
    pub(super) fn add_gradient(&mut self, q: usize, gradient: &ElementGradient) {
        self.forces[q] += gradient.force;
        self.forces[q + 1] -= gradient.force;
        self.moments[q] -= gradient.moment_a;
        self.moments[q + 1] -= gradient.moment_b;
    }

    /// Computes `-dU/dx`, `-dU/dη` and gravity, whatever the time scheme is.
    pub fn evaluate_elastic(
        &mut self,
        rod: &Rod,
        positions: &[Vector3<f64>],
        rotations: &[Matrix3<f64>],
    ) {
        self.start_with_gravity(rod);
        self.add_elastic(rod, positions, rotations);
    }

    /// Computes the forces of a time node: elastic forces, gravity and loads, or under [`TimeScheme::Implicit`] gravity and loads only,
    /// because the elastic forces belong to the intervals.
    pub fn evaluate_at_node(
        &mut self,
        rod: &Rod,
        positions: &[Vector3<f64>],
        rotations: &[Matrix3<f64>],
        node: &TimeNode,
    ) {
        self.evaluate_without_loads(rod, positions, rotations);
        self.add_loads(rod, rotations, node);
    }

    /// Computes [`Self::evaluate_at_node`] without loads, which may differ before and after the time node.
    pub fn evaluate_without_loads(
        &mut self,
        rod: &Rod,
        positions: &[Vector3<f64>],
        rotations: &[Matrix3<f64>],
    ) {
        match rod.scheme {
            TimeScheme::Explicit => self.evaluate_elastic(rod, positions, rotations),
            TimeScheme::Implicit => self.start_with_gravity(rod),
        }
        self.add_alone(rod, positions, rotations);
    }

    fn start_with_gravity(&mut self, rod: &Rod) {
        for (node, (force, moment)) in (self.forces.iter_mut().zip(&mut self.moments)).enumerate() {
            *force = rod.weight(node);
            *moment = Vector3::zeros();
        }
    }

    pub fn add_elastic(
        &mut self,
        rod: &Rod,
        positions: &[Vector3<f64>],
        rotations: &[Matrix3<f64>],
    ) {
        for (q, element) in rod.elements.iter().enumerate() {
            let gradient =
                element.gradient(rod.strain_rule, &Rod::element_pose(q, positions, rotations));
            self.add_gradient(q, &gradient);
        }
    }

    /// Adds the loads at a time node.
    pub fn add_loads(&mut self, rod: &Rod, rotations: &[Matrix3<f64>], node: &TimeNode) {
        for load in &rod.loads {
            let wrench = load.wrench_at_node(node, &rotations[load.node]);
            self.forces[load.node] += wrench.force;
            self.moments[load.node] += wrench.moment;
        }
    }
}

impl Rod {
    /// Writes the wrenches of a unit effort of one actuator without friction at the mean strain of an interval on the nodes at both of its
    /// ends.
    pub fn write_interval_pulls(
        &self,
        actuator: usize,
        ends: [Poses; 2],
        out: [&mut NodalForces; 2],
    ) {
        let [start, end] = out;
        start.clear();
        end.clear();
        let unit = |line: usize| f64::from(u8::from(line == actuator));
        for (q, element) in self.elements.iter().enumerate() {
            if !(self.actuators.on(q).iter()).any(|point| point.actuator == actuator) {
                continue;
            }
            let poses = ends.map(|(x, r)| Self::element_pose(q, x, r));
            let strains =
                (poses.each_ref()).map(|pose| self.strain_rule.strain(element.length, pose));
            let mean = strains[0].mean(&strains[1]);
            let Some(stress) = self.active_stress_under(q, &mean, &unit) else {
                continue;
            };
            for (out, pose) in [&mut *start, &mut *end].into_iter().zip(&poses) {
                out.add_gradient(q, &element.gradient_under(self.strain_rule, pose, &stress));
            }
        }
    }

    /// Returns the wrench of the base on an arm at rest in a shape, under the loads at time `t`: force in the spatial frame, moment in the
    /// frame of the base.
    #[must_use]
    pub fn static_reaction(&self, at: &Configuration, t: f64) -> Wrench {
        self.static_reaction_at(0, at, t)
    }

    /// Returns the wrench of the end at node `node` on an arm at rest in a shape, as [`Self::static_reaction`] does that of the base.
    #[must_use]
    pub fn static_reaction_at(&self, node: usize, at: &Configuration, t: f64) -> Wrench {
        let mut net = NodalForces::zeros(self.n_nodes());
        net.evaluate(self, &at.positions, &at.rotations, t);
        Wrench {
            force: -net.forces[node],
            moment: -net.moments[node],
        }
    }

    /// Returns the [derivatives](EffortSlope) of the efforts of winches with tension, for the inputs of all actuators.
    pub fn effort_slopes(
        &self,
        inputs: &[f64],
        positions: &[Vector3<f64>],
        rotations: &[nalgebra::Matrix3<f64>],
    ) -> Vec<EffortSlope> {
        let mut out = Vec::new();
        let mut memory = SlopeMemory::of(self);
        memory.visit(self, inputs, (positions, rotations), |_, slope, pull| {
            if slope != 0.0 {
                out.push(EffortSlope {
                    slope,
                    pull: pull.clone(),
                });
            }
        });
        out
    }
}

/// Memory for the [derivatives](EffortSlope) of the efforts of winches.
#[derive(Clone, Debug)]
pub struct SlopeMemory {
    state: EffortState,
    unit: Vec<f64>,
    pull: NodalForces,
}

impl SlopeMemory {
    /// Creates memory for a rod.
    pub fn of(rod: &Rod) -> Self {
        Self {
            state: rod.actuators.effort_state(),
            unit: vec![0.0; rod.actuators.n_efforts()],
            pull: NodalForces::zeros(rod.n_nodes()),
        }
    }

    /// Calls `visit(actuator, slope, pull)` for every winch of a tendon without friction, for the inputs of all actuators. The slope of a slack
    /// tendon is zero, and its pull is not evaluated.
    pub fn visit(
        &mut self,
        rod: &Rod,
        inputs: &[f64],
        (positions, rotations): (&[Vector3<f64>], &[Matrix3<f64>]),
        mut visit: impl FnMut(usize, f64, &NodalForces),
    ) {
        let mut springs = rod.actuators.springs().peekable();
        if springs.peek().is_none() {
            return;
        }
        rod.write_effort_state((positions, rotations), &mut self.state);
        for i in springs {
            let law = rod.actuators.law(i, inputs[i], &self.state);
            self.pull.clear();
            if law.along_coordinate != 0.0 {
                self.unit.fill(0.0);
                self.unit[i] = 1.0;
                (self.pull).add_active(rod, positions, rotations, &self.unit);
            }
            visit(i, law.along_coordinate, &self.pull);
        }
    }
}

/// Memory for the laws and pulls of winches without friction over an interval.
#[derive(Clone, Debug)]
pub struct IntervalMemory {
    state: EffortState,
    pulls: [NodalForces; 2],
}

impl IntervalMemory {
    /// Creates memory for a rod.
    pub fn of(rod: &Rod) -> Self {
        let n_nodes = if rod.actuators.follow_shape() {
            rod.n_nodes()
        } else {
            0
        };
        Self {
            state: rod.actuators.effort_state(),
            pulls: [(); 2].map(|()| NodalForces::zeros(n_nodes)),
        }
    }

    /// Calls `visit(actuator, law, pulls)` for every winch of a tendon without friction, for the inputs of all actuators and the poses at both
    /// ends of an interval of a time, s, with the wrenches of a unit tension at the mean strain on the nodes at either end. Those of a slack
    /// tendon are zero.
    pub fn visit(
        &mut self,
        rod: &Rod,
        inputs: &[f64],
        (ends, time): ([Poses; 2], f64),
        mut visit: impl FnMut(usize, &EffortLaw, [&NodalForces; 2]),
    ) {
        let mut springs = rod.actuators.springs().peekable();
        if springs.peek().is_none() {
            return;
        }
        rod.write_interval_effort_state(ends, time, &mut self.state);
        for i in springs {
            let law = rod.actuators.law(i, inputs[i], &self.state);
            let [start, end] = &mut self.pulls;
            if law.along_coordinate == 0.0 {
                start.clear();
                end.clear();
            } else {
                rod.write_interval_pulls(i, ends, [start, end]);
            }
            visit(i, &law, self.pulls.each_ref());
        }
    }
}
