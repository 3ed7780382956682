//! [Resistance](cosserat::resistance) in explicit steps: the momenta are slowed before the nodes move, and once more where they arrive.

use nalgebra::Vector3;

use super::LaneIntegrator;
use super::sweep::{FORCE, LINEAR_MOMENTUM, POSITION};

/// The nodes of a rod that is resisted, where a step starts; empty for other rods.
#[derive(Clone, Debug, Default)]
pub struct Departures {
    positions: Vec<Vector3<f64>>,
    tangents: Vec<Vector3<f64>>,
}

impl LaneIntegrator<'_> {
    /// Returns `h/2/(1 + a)`, the time for which a force acts on the momenta at either end of a step, s.
    fn half_kick(&self) -> f64 {
        0.5 * self.clock.step / (1.0 + self.half_damping())
    }

    fn tangent(&self, node: usize) -> Vector3<f64> {
        self.rotation(node).column(2).into_owned()
    }

    /// Notes where the nodes are.
    pub(super) fn depart(&mut self) {
        if self.rod.resistances.is_empty() {
            return;
        }
        let mut departures = std::mem::take(&mut self.departures);
        departures.positions.clear();
        departures.tangents.clear();
        for node in 0..self.rod.n_nodes() {
            departures.positions.push(self.position(node));
            departures.tangents.push(self.tangent(node));
        }
        self.departures = departures;
    }

    /// Slows the momenta with the kick by which the nodes are about to be moved.
    pub(super) fn slow_kicked(&mut self) {
        let rod = self.rod;
        let weight = self.half_kick();
        for node in 0..self.departures.tangents.len() {
            let Some(resistance) = rod.resistance(node) else {
                continue;
            };
            let place = self.slots.place(node);
            let kick = self.get(place, FORCE) * (2.0 * weight);
            let before = self.get(place, LINEAR_MOMENTUM) + kick;
            let tangent = &self.departures.tangents[node];
            let after = resistance.slowed(&before, tangent, rod.nodes[node].mass, weight);
            self.set(place, LINEAR_MOMENTUM, &(after - kick));
        }
    }

    /// Slows the momenta by which the nodes have just been moved, and their motion with them.
    pub(super) fn slow_moved(&mut self) {
        let (rod, h) = (self.rod, self.clock.step);
        let weight = self.half_kick();
        let decay = (1.0 - self.half_damping()) / (1.0 + self.half_damping());
        for node in 0..self.departures.positions.len() {
            let Some(resistance) = rod.resistance(node) else {
                continue;
            };
            let place = self.slots.place(node);
            let mass = rod.nodes[node].mass;
            let from = self.departures.positions[node];
            // Without rounding by the distance from the origin, unless damping has taken all of the momentum.
            let before = if decay == 0.0 {
                (self.get(place, POSITION) - from) * (mass / h)
            } else {
                self.get(place, LINEAR_MOMENTUM) / decay
            };
            let tangent = &self.departures.tangents[node];
            let after = resistance.slowed(&before, tangent, mass, weight);
            self.set(place, POSITION, &(from + after * (h / mass)));
            self.set(place, LINEAR_MOMENTUM, &(after * decay));
        }
    }

    /// Takes the impulse of the resistance at the end of a step from the momenta that arrive.
    pub(super) fn resist_arrival(&mut self) {
        let rod = self.rod;
        let weight = self.half_kick();
        for node in 0..self.departures.positions.len() {
            let Some(resistance) = rod.resistance(node) else {
                continue;
            };
            let place = self.slots.place(node);
            let moved = self.get(place, POSITION) - self.departures.positions[node];
            let force = resistance.force(&(moved / self.clock.step), &self.tangent(node));
            self.add(place, LINEAR_MOMENTUM, &(force * weight));
        }
    }
}
