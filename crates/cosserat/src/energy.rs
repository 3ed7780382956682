//! Kinetic, elastic and gravitational energy and the momenta of a state.

use nalgebra::Vector3;

use super::configuration::State;
use super::rod::Rod;

/// The three parts of the energy, J.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Energy {
    /// `Σ |p|²/(2m) + ½ π·J⁻¹π`
    pub kinetic: f64,
    /// Elastic energy of the elements.
    pub elastic: f64,
    /// Potential energy of gravity, `-Σ m g·x`, and of the potentials of nodes that have no effort.
    pub potential: f64,
}

impl Energy {
    /// Returns the energy of a state, with its momenta at the same instant as its configuration.
    #[must_use]
    pub fn of(rod: &Rod, state: &State) -> Self {
        let configuration = &state.configuration;
        let mut potential = rod.gravity_energy(&configuration.positions);
        if rod.actuators.act_on_poses() {
            potential += rod.potential_energy(&configuration.positions, &configuration.rotations);
        }
        Self {
            kinetic: kinetic_energy(rod, state),
            elastic: rod.elastic_energy(&configuration.positions, &configuration.rotations),
            potential,
        }
    }

    /// Returns the sum of the parts.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.kinetic + self.elastic + self.potential
    }
}

/// Returns `Σ |p|²/(2m) + ½ π·J⁻¹π`, J, with the inertia of the state's dilatation.
#[must_use]
pub fn kinetic_energy(rod: &Rod, state: &State) -> f64 {
    let rotary = rod.rotary_at(&state.configuration.positions);
    (rod.nodes.iter().zip(&rotary))
        .zip(state.linear_momentum.iter().zip(&state.angular_momentum))
        .map(|((node, rotary), (p, pi))| {
            0.5 * (p.norm_squared() / node.mass + pi.dot(&pi.component_div(rotary)))
        })
        .sum()
}

/// Returns the total linear momentum `Σ p`, kg m/s.
#[must_use]
pub fn linear_momentum(state: &State) -> Vector3<f64> {
    state.linear_momentum.iter().sum()
}

/// Returns the total angular momentum about the origin, `Σ x × p + R π`, spatial frame, kg m²/s.
#[must_use]
pub fn angular_momentum(state: &State) -> Vector3<f64> {
    let configuration = &state.configuration;
    configuration
        .positions
        .iter()
        .zip(&configuration.rotations)
        .zip(state.linear_momentum.iter().zip(&state.angular_momentum))
        .map(|((x, r), (p, pi))| x.cross(p) + r * pi)
        .sum()
}
