//! A state with all that is needed to give it to another rod: the places of its nodes and their inertia.

use nalgebra::Vector3;

use super::configuration::State;
use super::place::{carry, locate};
use super::rod::Rod;
use super::rotation::stray;

/// The state of an arm at one instant, at nodes with places and inertia of their own.
#[derive(Clone, Debug, PartialEq)]
pub struct NodalState {
    /// Length of the arm at rest, m.
    pub length: f64,
    /// Fractions of the length, from 0 to 1, increasing.
    pub places: Vec<f64>,
    /// Poses and momenta.
    pub state: State,
    /// Masses, kg.
    pub mass: Vec<f64>,
    /// Principal moments of inertia in this configuration, kg m², body frame.
    pub rotary: Vec<Vector3<f64>>,
}

/// The number of a node that no state of an arm has.
#[derive(Clone, Debug, PartialEq)]
pub struct NodalFault {
    /// Index of the node.
    pub node: usize,
    /// The fault in words.
    pub reason: String,
}

/// Largest entry of `RᵀR - 1` of a rotation. The integrator's rotations deviate by rounding, which adds up to 1e-8 in 10⁸ steps at worst.
pub const ORTHONORMAL: f64 = 1e-6;

impl NodalState {
    /// Returns the state of a rod.
    #[must_use]
    pub fn of(rod: &Rod, state: &State) -> Self {
        Self {
            length: rod.elements.iter().map(|element| element.length).sum(),
            places: rod.places(),
            state: state.clone(),
            mass: rod.nodes.iter().map(|node| node.mass).collect(),
            rotary: rod.rotary_at(&state.configuration.positions),
        }
    }

    /// Returns the first fault of a state whose numbers come from a file; `None` if it can be that of an arm.
    #[must_use]
    pub fn fault(&self) -> Option<NodalFault> {
        let n = self.places.len();
        let fault = |node: usize, reason: String| Some(NodalFault { node, reason });
        let at = &self.state;
        let counts = [
            at.configuration.positions.len(),
            at.configuration.rotations.len(),
            at.linear_momentum.len(),
            at.angular_momentum.len(),
            self.mass.len(),
            self.rotary.len(),
        ];
        if n < 2 || counts != [n; 6] {
            return fault(0, "its arrays are not of one length of two or more".into());
        }
        if !(self.length > 0.0 && self.length.is_finite()) {
            return fault(0, format!("an arm of {} m", self.length));
        }
        for node in 0..n {
            let vectors = [
                at.configuration.positions[node],
                at.linear_momentum[node],
                at.angular_momentum[node],
            ];
            if !vectors.iter().flatten().all(|value| value.is_finite()) {
                return fault(node, "a number is not finite".into());
            }
            let r = &at.configuration.rotations[node];
            if !(stray(r) <= ORTHONORMAL) {
                let (stray, turn) = (stray(r), r.determinant());
                let reason = format!("not a rotation: off by {stray:.1e}, determinant {turn:.3}");
                return fault(node, reason);
            }
            let place = self.places[node];
            let is_later = node == 0 || place > self.places[node - 1];
            let is_end = (node != 0 || place == 0.0) && (node + 1 != n || place == 1.0);
            if !(is_later && is_end) {
                let reason = format!("place {place}; fractions of the length increase from 0 to 1");
                return fault(node, reason);
            }
            let inertia = self.rotary[node].iter().chain([&self.mass[node]]);
            if !inertia
                .into_iter()
                .all(|part| *part > 0.0 && part.is_finite())
            {
                return fault(node, "mass and inertia are not all positive".into());
            }
        }
        None
    }

    /// Returns this state on the nodes of a rod of the same length.
    ///
    /// Between two nodes poses lie on a helix, as in those of places on the rod, and velocities, linear ones in space and angular ones in the
    /// body frame, are linear. Momenta are the velocities times the inertia of the rod's nodes. On a rod with the same places and inertia the
    /// state is the same to the bit.
    #[must_use]
    pub fn on(&self, rod: &Rod) -> State {
        let own = Self::of(rod, &self.state_for(rod));
        if own.places == self.places && own.mass == self.mass && own.rotary == self.rotary {
            return self.state.clone();
        }
        let between = |(q, s): (usize, f64), of: &dyn Fn(usize) -> Vector3<f64>| {
            of(q) * (1.0 - s) + of(q + 1) * s
        };
        let velocity = |q: usize| self.state.linear_momentum[q] / self.mass[q];
        let spin = |q: usize| self.state.angular_momentum[q].component_div(&self.rotary[q]);
        let places: Vec<_> = (own.places.iter())
            .map(|part| locate(&self.places, *part))
            .collect();
        State {
            linear_momentum: (places.iter().zip(&own.mass))
                .map(|(place, mass)| between(*place, &velocity) * *mass)
                .collect(),
            angular_momentum: (places.iter().zip(&own.rotary))
                .map(|(place, rotary)| between(*place, &spin).component_mul(rotary))
                .collect(),
            configuration: own.state.configuration,
        }
    }

    /// Returns the configuration on the nodes of a rod, at rest.
    fn state_for(&self, rod: &Rod) -> State {
        let places: Vec<_> = (rod.places().into_iter())
            .map(|part| locate(&self.places, part))
            .collect();
        State::at_rest(carry(&places, &self.state.configuration))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Material, Section, SectionProfile};
    use crate::{RodParameters, rotation::exp};

    fn rod(elements: usize) -> Rod {
        let silicone = Material::isotropic(1e6, 0.5, 1000.0);
        let section = SectionProfile::Uniform(Section::circle(&silicone, 0.05));
        Rod::new(&RodParameters::straight(1.0, elements, section)).unwrap()
    }

    /// The rod bent, twisted and moving as a rigid body about its base.
    fn moving(rod: &Rod) -> State {
        let mut shape = rod.rest.clone();
        for q in 0..rod.n_elements() {
            let turn = exp(&Vector3::new(0.7, -0.4, 1.1).scale(rod.elements[q].length));
            shape.rotations[q + 1] = shape.rotations[q] * turn;
            let along = shape.rotations[q] * Vector3::new(0.0, 0.0, rod.elements[q].length);
            shape.positions[q + 1] = shape.positions[q] + along;
        }
        let (v, w) = (Vector3::new(0.3, -0.1, 0.2), Vector3::new(1.0, 2.0, -0.5));
        let base = shape.positions[0];
        rod.rigid_motion(shape, &base, &v, &w)
    }

    /// On its own rod a state is the same to the bit; on a rod whose inertia alone differs it has the same velocities; on a finer rod it has
    /// the poses of the shared nodes.
    #[test]
    fn states_keep_poses_and_velocities() {
        let own = rod(5);
        let state = moving(&own);
        let found = NodalState::of(&own, &state);
        assert_eq!(found.fault(), None);
        assert_eq!(found.on(&own), state);
        let mut heavy = rod(5);
        heavy.nodes.iter_mut().for_each(|node| node.mass *= 3.0);
        let moved = found.on(&heavy);
        assert_eq!(moved.configuration, state.configuration);
        for (q, p) in moved.linear_momentum.iter().enumerate() {
            let velocity = p / heavy.nodes[q].mass;
            let expected = state.linear_momentum[q] / own.nodes[q].mass;
            assert!((velocity - expected).norm() < 1e-15 * (1.0 + expected.norm()));
        }
        let fine = rod(10);
        let moved = found.on(&fine);
        for q in 0..own.n_nodes() {
            let [there, here] = [&moved, &state].map(|state| &state.configuration);
            assert_eq!(there.positions[2 * q], here.positions[q]);
            assert_eq!(there.rotations[2 * q], here.rotations[q]);
        }
    }

    /// Every kind of number that no arm has is named with its node.
    #[test]
    fn faults_are_found() {
        let own = rod(3);
        let good = NodalState::of(&own, &moving(&own));
        type Damage = fn(&mut NodalState);
        let cases: [(Damage, usize, &str); 8] = [
            (|s| s.places[2] = 0.1, 2, "increase from 0 to 1"),
            (|s| s.places[3] = 0.9, 3, "increase from 0 to 1"),
            (|s| s.mass[1] = 0.0, 1, "not all positive"),
            (|s| s.rotary[1].x = f64::NAN, 1, "not all positive"),
            (
                |s| s.state.configuration.positions[2].y = f64::NAN,
                2,
                "not finite",
            ),
            (
                |s| s.state.configuration.rotations[2] *= 1.1,
                2,
                "not a rotation",
            ),
            (
                |s| s.state.linear_momentum.truncate(2),
                0,
                "not of one length",
            ),
            (|s| s.length = -1.0, 0, "an arm of -1 m"),
        ];
        for (damage, node, word) in cases {
            let mut bad = good.clone();
            damage(&mut bad);
            let fault = bad.fault().unwrap();
            assert_eq!(fault.node, node, "{word}");
            assert!(fault.reason.contains(word), "{}", fault.reason);
        }
    }
}
