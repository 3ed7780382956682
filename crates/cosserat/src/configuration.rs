//! Configurations (positions and rotations of all nodes), states (with momenta), and trajectories of configurations.

use nalgebra::{Matrix3, Vector3};

use super::rotation::{exp, log};
use super::section::NodeInertia;
use super::state_tangent::StateTangent;

/// Positions (m) and rotations of all nodes.
pub type Poses<'a> = (&'a [Vector3<f64>], &'a [Matrix3<f64>]);

/// Position (m) and rotation, body to space, of an end.
pub type EndPose = (Vector3<f64>, Matrix3<f64>);

/// Position and rotation of every node.
#[derive(Debug, PartialEq)]
pub struct Configuration {
    /// Spatial positions, m.
    pub positions: Vec<Vector3<f64>>,
    /// Rotations, body to space.
    pub rotations: Vec<Matrix3<f64>>,
}

impl Configuration {
    /// Returns positions and rotations.
    #[must_use]
    pub fn poses(&self) -> Poses<'_> {
        (&self.positions, &self.rotations)
    }

    /// Carries all nodes along as a rigid body that moves from one pose to another: `x' + R' Rᵀ (x_q - x)` and `R' Rᵀ R_q`.
    pub fn carry(&mut self, from: EndPose, to: EndPose) {
        let turn = to.1 * from.1.transpose();
        for (x, r) in self.positions.iter_mut().zip(&mut self.rotations) {
            *x = to.0 + turn * (*x - from.0);
            *r = turn * *r;
        }
    }

    /// Carries all nodes along, as a rigid body with node 0, to where this one has a pose, without rounding there.
    pub fn carry_base(&mut self, to: EndPose) {
        self.carry((self.positions[0], self.rotations[0]), to);
        (self.positions[0], self.rotations[0]) = to;
    }

    /// Returns the node that is farthest from its place in other positions, the first of several, and its distance, m.
    pub fn farthest_node<'a>(
        &self,
        places: impl IntoIterator<Item = &'a Vector3<f64>>,
    ) -> (usize, f64) {
        (self.positions.iter().zip(places).enumerate())
            .map(|(node, (own, other))| (node, (other - own).norm()))
            .fold(
                (0, 0.0),
                |most, own| if own.1 > most.1 { own } else { most },
            )
    }
}

/// A configuration with its momenta at the same instant.
#[derive(Debug, PartialEq)]
pub struct State {
    /// Positions and rotations.
    pub configuration: Configuration,
    /// Linear momentum of every node, spatial, kg m/s.
    pub linear_momentum: Vec<Vector3<f64>>,
    /// Angular momentum of every node about itself, body frame, kg m²/s.
    pub angular_momentum: Vec<Vector3<f64>>,
}

impl Clone for Configuration {
    fn clone(&self) -> Self {
        Self {
            positions: self.positions.clone(),
            rotations: self.rotations.clone(),
        }
    }

    /// Copies into existing memory.
    fn clone_from(&mut self, other: &Self) {
        self.positions.clone_from(&other.positions);
        self.rotations.clone_from(&other.rotations);
    }
}

impl Clone for State {
    fn clone(&self) -> Self {
        Self {
            configuration: self.configuration.clone(),
            linear_momentum: self.linear_momentum.clone(),
            angular_momentum: self.angular_momentum.clone(),
        }
    }

    /// Copies into existing memory.
    fn clone_from(&mut self, other: &Self) {
        self.configuration.clone_from(&other.configuration);
        self.linear_momentum.clone_from(&other.linear_momentum);
        self.angular_momentum.clone_from(&other.angular_momentum);
    }
}

impl State {
    /// Returns a configuration at rest.
    #[must_use]
    pub fn at_rest(configuration: Configuration) -> Self {
        let n = configuration.positions.len();
        Self {
            configuration,
            linear_momentum: vec![Vector3::zeros(); n],
            angular_momentum: vec![Vector3::zeros(); n],
        }
    }

    /// Returns velocity (spatial, m/s) and angular velocity (body frame, rad/s) of every node, `p/m` and `π/J`, for the inertia of the nodes.
    #[must_use]
    pub fn velocities(&self, nodes: &[NodeInertia]) -> [Vec<Vector3<f64>>; 2] {
        let linear = self.linear_momentum.iter().zip(nodes);
        let angular = self.angular_momentum.iter().zip(nodes);
        [
            linear.map(|(p, node)| p / node.mass).collect(),
            angular
                .map(|(pi, node)| pi.component_div(&node.rotary))
                .collect(),
        ]
    }

    /// Returns the tangent at `reference` that leads here: `x - x̄`, `log(R̄ᵀ R)`, `p - p̄`, `π - π̄`. The momenta of a turned node are
    /// compared in their own body frames, as in the linearized motion.
    #[must_use]
    pub fn difference(&self, reference: &Self) -> StateTangent {
        let mut out = StateTangent::zeros(self.linear_momentum.len());
        self.difference_into(reference, &mut out);
        out
    }

    /// Writes [`difference`](Self::difference) into a tangent of the same size.
    pub fn difference_into(&self, reference: &Self, out: &mut StateTangent) {
        let (here, there) = (&self.configuration, &reference.configuration);
        for q in 0..here.positions.len() {
            out.positions[q] = here.positions[q] - there.positions[q];
            out.rotations[q] = log(&there.rotations[q].tr_mul(&here.rotations[q]));
            out.linear[q] = self.linear_momentum[q] - reference.linear_momentum[q];
            out.angular[q] = self.angular_momentum[q] - reference.angular_momentum[q];
        }
    }

    /// Returns the state to which a tangent leads: `x + δx`, `R exp(ζ)`, `p + δp`, `π + δπ`; the inverse of
    /// [`difference`](Self::difference).
    #[must_use]
    pub fn retract(&self, tangent: &StateTangent) -> Self {
        let plus =
            |a: &[Vector3<f64>], b: &[Vector3<f64>]| a.iter().zip(b).map(|(a, b)| a + b).collect();
        let here = &self.configuration;
        Self {
            configuration: Configuration {
                positions: plus(&here.positions, &tangent.positions),
                rotations: (here.rotations.iter().zip(&tangent.rotations))
                    .map(|(rotation, turn)| rotation * exp(turn))
                    .collect(),
            },
            linear_momentum: plus(&self.linear_momentum, &tangent.linear),
            angular_momentum: plus(&self.angular_momentum, &tangent.angular),
        }
    }
}

/// Configurations at the time nodes `k = 0..=N`, stored one after the other.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    /// Number of nodes of the rod, `K + 1`.
    pub n_nodes: usize,
    /// Positions: time node `k`, rod node `q` at `k (K+1) + q`.
    pub positions: Vec<Vector3<f64>>,
    /// Rotations, in the same order.
    pub rotations: Vec<Matrix3<f64>>,
}

impl Trajectory {
    /// Creates an empty trajectory with room for `n_times` time nodes.
    #[must_use]
    pub fn with_capacity(n_nodes: usize, n_times: usize) -> Self {
        Self {
            n_nodes,
            positions: Vec::with_capacity(n_nodes * n_times),
            rotations: Vec::with_capacity(n_nodes * n_times),
        }
    }

    /// Returns the number of time nodes, `N + 1`.
    #[must_use]
    pub fn n_times(&self) -> usize {
        self.positions.len() / self.n_nodes
    }

    /// Appends a time node.
    pub fn push(&mut self, configuration: &Configuration) {
        self.positions.extend_from_slice(&configuration.positions);
        self.rotations.extend_from_slice(&configuration.rotations);
    }

    /// Returns the positions at time node `k`.
    #[inline]
    #[must_use]
    pub fn positions_at(&self, k: usize) -> &[Vector3<f64>] {
        &self.positions[k * self.n_nodes..(k + 1) * self.n_nodes]
    }

    /// Returns the rotations at time node `k`.
    #[inline]
    #[must_use]
    pub fn rotations_at(&self, k: usize) -> &[Matrix3<f64>] {
        &self.rotations[k * self.n_nodes..(k + 1) * self.n_nodes]
    }

    /// Returns positions and rotations at time node `k`.
    #[must_use]
    pub fn poses_at(&self, k: usize) -> Poses<'_> {
        (self.positions_at(k), self.rotations_at(k))
    }

    /// Returns the configuration at time node `k`.
    #[must_use]
    pub fn configuration(&self, k: usize) -> Configuration {
        Configuration {
            positions: self.positions_at(k).to_vec(),
            rotations: self.rotations_at(k).to_vec(),
        }
    }

    /// Returns the trajectory with every node moved along `direction`, `x + α δx` and `R exp(α ζ)`.
    #[must_use]
    pub fn retract(&self, direction: &TrajectoryTangent, step_length: f64) -> Self {
        Self {
            n_nodes: self.n_nodes,
            positions: self
                .positions
                .iter()
                .zip(&direction.positions)
                .map(|(x, dx)| x + dx * step_length)
                .collect(),
            rotations: self
                .rotations
                .iter()
                .zip(&direction.rotations)
                .map(|(r, zeta)| r * exp(&(zeta * step_length)))
                .collect(),
        }
    }
}

/// A direction in the tangent space of a [`Trajectory`], in the same order.
#[derive(Clone, Debug, PartialEq)]
pub struct TrajectoryTangent {
    /// `δx`, spatial, m.
    pub positions: Vec<Vector3<f64>>,
    /// `ζ` with `δR = R ζ̂`, body frame.
    pub rotations: Vec<Vector3<f64>>,
}

impl TrajectoryTangent {
    /// Returns the largest rotation of any node at any time, rad.
    #[must_use]
    pub fn largest_rotation(&self) -> f64 {
        self.rotations.iter().map(Vector3::norm).fold(0.0, f64::max)
    }
}
