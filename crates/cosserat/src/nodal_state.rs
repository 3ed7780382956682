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
