//! The transfer of states between rods of the same arm with different nodes.

use nalgebra::Vector3;

use mechanics::place::{carry, carry_into, locate};
use mechanics::{Configuration, Rod, State};

/// Carries states from the nodes of one rod to those of another, finer or coarser, of the same arm.
///
/// Between two nodes the strain is taken as constant, so that poses lie on a helix, `R(s) = R_a exp(s ψ)`, `x(s) = x_a + R_a ∫₀ˢ exp(t ψ)
/// dt ε` with `ψ = log(R_aᵀ R_b)`; linear (spatial frame) and angular (body frame) velocities are linear. Momenta follow from the
/// velocities and the inertia of the other rod's nodes. Nodes at the same place keep their pose up to rounding.
#[derive(Clone, Debug)]
pub struct Transfer {
    /// Element and fraction of it of every node of the other rod.
    places: Vec<(usize, f64)>,
    /// Element and fraction of every node of this rod on the other, for the way back.
    back: Vec<(usize, f64)>,
    /// Mass and rotary inertia of the nodes of this rod and of the other.
    inertia: [Vec<(f64, Vector3<f64>)>; 2],
}

impl Transfer {
    /// Creates the transfer between rods of the same length; a place on one is at the same fraction of the length on the other.
    #[must_use]
    pub fn new(from: &Rod, to: &Rod) -> Self {
        let inertia = |rod: &Rod| {
            let nodes = rod.nodes.iter();
            nodes.map(|node| (node.mass, node.rotary)).collect()
        };
        Self {
            places: places(from, to),
            back: places(to, from),
            inertia: [inertia(from), inertia(to)],
        }
    }

    /// Returns the state on the other rod's nodes.
    #[must_use]
    pub fn state(&self, state: &State) -> State {
        let mut out = State::at_rest(Configuration {
            positions: Vec::new(),
            rotations: Vec::new(),
        });
        self.state_into(state, &mut out);
        out
    }

    /// Writes the state on the other rod's nodes into existing memory.
    pub fn state_into(&self, state: &State, out: &mut State) {
        let [from, to] = &self.inertia;
        carry_into(&self.places, &state.configuration, &mut out.configuration);
        let velocity = |q: usize| state.linear_momentum[q] / from[q].0;
        let spin = |q: usize| state.angular_momentum[q].component_div(&from[q].1);
        let between = |(q, s): (usize, f64), of: &dyn Fn(usize) -> Vector3<f64>| {
            of(q) * (1.0 - s) + of(q + 1) * s
        };
        let nodes = || self.places.iter().zip(to);
        out.linear_momentum.clear();
        (out.linear_momentum)
            .extend(nodes().map(|(place, (mass, _))| between(*place, &velocity) * *mass));
        out.angular_momentum.clear();
        (out.angular_momentum).extend(
            nodes().map(|(place, (_, rotary))| between(*place, &spin).component_mul(rotary)),
        );
    }

    /// Returns the nodes of this rod beside a node of the other, and the weights of linear interpolation; `None` for a node that does not
    /// exist.
    #[must_use]
    pub fn shares(&self, node: usize) -> Option<[(usize, f64); 2]> {
        let &(q, s) = self.places.get(node)?;
        Some([(q, 1.0 - s), (q + 1, s)])
    }

    /// Returns the nearest node of this rod for every node of the other.
    #[must_use]
    pub fn nearest(&self) -> Vec<usize> {
        let nearest = |&(q, s): &(usize, f64)| if s > 0.5 { q + 1 } else { q };
        self.places.iter().map(nearest).collect()
    }

    /// Returns the largest distance of a node from its position after a transfer and back, m: the error of the shape on the other rod's
    /// nodes.
    #[must_use]
    pub fn error(&self, configuration: &Configuration) -> f64 {
        let there = carry(&self.places, configuration);
        let back = carry(&self.back, &there);
        (back.positions.iter().zip(&configuration.positions))
            .fold(0.0, |worst, (a, b)| worst.max((a - b).norm()))
    }
}

/// Returns, for every node of `to`, the element of `from` on which it lies and the fraction of it.
fn places(from: &Rod, to: &Rod) -> Vec<(usize, f64)> {
    let own = from.places();
    (to.places().into_iter())
        .map(|part| locate(&own, part))
        .collect()
}
