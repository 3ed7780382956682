//! What acts on the nodes besides the elements: control and loads.

use nalgebra::Vector3;

use super::LaneIntegrator;
use super::sweep::{FORCE, MOMENT};
use crate::mechanics::actuator::StateView;
use crate::mechanics::load::Wrench;
use crate::mechanics::signal::NodeWrenches;
use crate::mechanics::time::TimeNode;

impl LaneIntegrator<'_> {
    /// Half a kick of the control before this time node and half of the one after it; the former is forgotten.
    pub(super) fn add_control(&mut self, after: NodeWrenches) {
        let first = self.rod.first_free_node();
        let acting = self.acting(after);
        let given = after.iter().map(|(node, wrench)| (node, *wrench));
        for (i, (node, wrench)) in given.chain(acting).enumerate() {
            // As a rule the same nodes as before, in the same order.
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
            // Single numbers written where a vector is read next hold it up.
            if wrench.force != Vector3::zeros() {
                self.add(place, FORCE, &(wrench.force * 0.5));
            }
            if wrench.moment != Vector3::zeros() {
                self.add(place, MOMENT, &(wrench.moment * 0.5));
            }
        }
        // Its memory serves the next step.
        self.control = control;
    }

    /// Wrenches of the actuators of one's own at the present configuration.
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

    /// This time node, as the end of the step before it.
    pub(super) fn end_of_step(&self) -> TimeNode {
        TimeNode {
            time: self.time(),
            before: self.clock.step,
            after: 0.0,
        }
    }

    /// Half of what loads that jump near this time node apply after it more than before it.
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

    /// The loads just before this time node.
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
