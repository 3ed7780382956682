//! Impulses on the nodes besides those of the elements: control and loads.

use nalgebra::Vector3;

use super::LaneIntegrator;
use super::sweep::{FORCE, MOMENT};
use cosserat::actuator::StateView;
use cosserat::load::Wrench;
use cosserat::signal::NodeWrenches;
use cosserat::time::TimeNode;

impl LaneIntegrator<'_> {
    /// Adds half a kick of the control before this time node and half of the one after it; the former is discarded.
    pub(super) fn add_control(&mut self, after: NodeWrenches) {
        let first = self.rod.first_free_node();
        let acting = self.acting(after);
        let given = after.iter().map(|(node, wrench)| (node, *wrench));
        for (i, (node, wrench)) in given.chain(acting).enumerate() {
            // Usually the nodes are the same as before, in the same order.
            let before = match self.control.get(i) {
                Some((same, _)) if *same == node => Some(i),
                _ => self.control.iter().position(|(other, _)| *other == node),
            };
            if let Some(before) = before {
                let sum = &mut self.control[before].1;
                sum.force += wrench.force;
                sum.moment += wrench.moment;
            } else if node >= first {
                self.control.push((node, wrench));
            }
        }
        let mut control = std::mem::take(&mut self.control);
        for (node, wrench) in control.drain(..) {
            let place = self.slots.place(node);
            // Scalar writes to memory that is read as a vector next would delay the read.
            if wrench.force != Vector3::zeros() {
                self.add(place, FORCE, &(wrench.force * 0.5));
            }
            if wrench.moment != Vector3::zeros() {
                self.add(place, MOMENT, &(wrench.moment * 0.5));
            }
        }
        // The memory is reused by the next step.
        self.control = control;
    }

    /// Returns the wrenches of user-defined actuators at the present configuration.
    pub(super) fn acting(&self, control: NodeWrenches) -> Vec<(usize, Wrench)> {
        if control.acting.is_empty() {
            return Vec::new();
        }
        let nodes = 0..self.rod.n_nodes();
        let positions: Vec<_> = nodes.clone().map(|node| self.position(node)).collect();
        let rotations: Vec<_> = nodes.map(|node| self.rotation(node)).collect();
        let view = StateView {
            rod: self.rod,
            time: self.time(),
            positions: &positions,
            rotations: &rotations,
        };
        control.acting_on(view).collect()
    }

    /// Returns this time node as the end of the step before it.
    pub(super) fn end_of_step(&self) -> TimeNode {
        TimeNode {
            time: self.time(),
            before: self.clock.step,
            after: 0.0,
        }
    }

    /// Adds half of the difference between the loads after and before this time node, for loads that jump near it.
    pub(super) fn share_jumps(&mut self) {
        let rod = self.rod;
        let [start, end] = [self.clock.ends_of_step(self.step)[0], self.end_of_step()];
        let free = rod.first_free_node();
        for load in rod.loads.iter().filter(|load| load.node >= free) {
            if load.factor_at_node(&start) == load.factor_at_node(&end) {
                continue;
            }
            let rotation = self.rotation(load.node);
            let [after, before] = [start, end].map(|node| load.wrench_at_node(&node, &rotation));
            let place = self.slots.place(load.node);
            self.add(place, FORCE, &((after.force - before.force) * 0.5));
            self.add(place, MOMENT, &((after.moment - before.moment) * 0.5));
        }
    }

    /// Adds the loads just before this time node.
    pub(super) fn add_loads(&mut self) {
        let rod = self.rod;
        let end = self.end_of_step();
        let free = rod.first_free_node();
        for load in rod.loads.iter().filter(|load| load.node >= free) {
            let wrench = load.wrench_at_node(&end, &self.rotation(load.node));
            let place = self.slots.place(load.node);
            self.add(place, FORCE, &wrench.force);
            self.add(place, MOMENT, &wrench.moment);
        }
    }
}
