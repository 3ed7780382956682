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

#[cfg(test)]
mod tests {
    use super::*;
    use mechanics::rotation::log;
    use mechanics::{Material, NodeInertia};
    use task::{Arm, Discretization};

    fn rod(elements: usize) -> Rod {
        with_body(elements, None)
    }

    /// The rod with a body at a fraction of its length, where an element ends.
    fn with_body(elements: usize, at: Option<f64>) -> Rod {
        let body = NodeInertia {
            mass: 0.1,
            rotary: Vector3::zeros(),
        };
        let arm = Arm {
            bodies: at.map(|at| (at, body)).into_iter().collect(),
            rest_curvature: Vector3::new(1.1, -0.7, 2.0),
            rest_stretch: 1.2,
            ..Arm::cylinder(&Material::isotropic(1e6, 0.5, 1000.0), 1.0, 0.05)
        };
        arm.rod(&Discretization::with_elements(elements)).unwrap()
    }

    /// A helix, whose strain is constant, is the same helix on every grid, also of elements of several lengths, and loses nothing on the way there and back; a uniform motion
    /// keeps its linear momentum.
    #[test]
    fn helices_stay_helices() {
        let even = [(3, 7), (7, 3), (4, 8), (8, 4), (5, 5)].map(|pair| (pair, [None; 2]));
        let uneven = [[Some(0.37); 2], [Some(0.37), None], [None, Some(0.8)]];
        let uneven = uneven.map(|at| ((6, 4), at));
        for ((from, to), at) in even.into_iter().chain(uneven) {
            let (from, to) = (with_body(from, at[0]), with_body(to, at[1]));
            let transfer = Transfer::new(&from, &to);
            let mut state = State::at_rest(from.rest.clone());
            let velocity = Vector3::new(0.3, -0.2, 0.1);
            for (p, node) in state.linear_momentum.iter_mut().zip(&from.nodes) {
                *p = velocity * node.mass;
            }
            let found = transfer.state(&state);
            for q in 0..to.n_nodes() {
                let x = found.configuration.positions[q] - to.rest.positions[q];
                let turn = to.rest.rotations[q].tr_mul(&found.configuration.rotations[q]);
                assert!(x.norm() < 1e-12 && log(&turn).norm() < 1e-12, "{q}");
            }
            assert!(transfer.error(&from.rest) < 1e-12);
            let sum: Vector3<f64> = found.linear_momentum.iter().sum();
            assert!((sum - velocity * to.mass()).norm() < 1e-12 * to.mass());
        }
    }

    /// Nodes at the same place keep their pose exactly, whatever the shape is; the error of a coarse grid is reported.
    #[test]
    fn shared_nodes_are_kept() {
        let (fine, coarse) = (rod(8), rod(4));
        let mut shape = fine.rest.clone();
        for (q, x) in shape.positions.iter_mut().enumerate() {
            x.y += 0.01 * ((3 * q) as f64).sin();
        }
        let transfer = Transfer::new(&fine, &coarse);
        let found = transfer.state(&State::at_rest(shape.clone()));
        for q in 0..coarse.n_nodes() {
            assert_eq!(found.configuration.positions[q], shape.positions[2 * q]);
            assert_eq!(found.configuration.rotations[q], shape.rotations[2 * q]);
        }
        assert_eq!(transfer.nearest(), [0, 2, 4, 6, 8]);
        let error = transfer.error(&shape);
        assert!((1e-3..0.03).contains(&error), "{error}");
    }
}
