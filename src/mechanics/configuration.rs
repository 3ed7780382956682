//! Configurations (positions and rotations of all nodes), states (with momenta), and trajectories of configurations.

use nalgebra::{Matrix3, Vector3};

use super::linearization::StateTangent;
use super::rotation::{exp, log};

/// Position and rotation of every node.
#[derive(Clone, Debug, PartialEq)]
pub struct Configuration {
    /// Spatial positions, m.
    pub positions: Vec<Vector3<f64>>,
    /// Rotations, body to space.
    pub rotations: Vec<Matrix3<f64>>,
}

/// A configuration with its momenta at the same instant.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// Positions and rotations.
    pub configuration: Configuration,
    /// Linear momentum of every node, spatial, kg m/s.
    pub linear_momentum: Vec<Vector3<f64>>,
    /// Angular momentum of every node about itself, body frame, kg m²/s.
    pub angular_momentum: Vec<Vector3<f64>>,
}

impl State {
    /// A configuration at rest.
    #[must_use]
    pub fn at_rest(configuration: Configuration) -> Self {
        let n = configuration.positions.len();
        Self {
            configuration,
            linear_momentum: vec![Vector3::zeros(); n],
            angular_momentum: vec![Vector3::zeros(); n],
        }
    }

    /// The tangent at `reference` that leads here: `x - x̄`, `log(R̄ᵀ R)`, `p - p̄`, `π - π̄`; the momenta of a turned node are
    /// compared in their own body frames, as the linearized motion does.
    #[must_use]
    pub fn difference(&self, reference: &Self) -> StateTangent {
        let minus =
            |a: &[Vector3<f64>], b: &[Vector3<f64>]| a.iter().zip(b).map(|(a, b)| a - b).collect();
        let (here, there) = (&self.configuration, &reference.configuration);
        StateTangent {
            positions: minus(&here.positions, &there.positions),
            rotations: (here.rotations.iter().zip(&there.rotations))
                .map(|(here, there)| log(&there.tr_mul(here)))
                .collect(),
            linear: minus(&self.linear_momentum, &reference.linear_momentum),
            angular: minus(&self.angular_momentum, &reference.angular_momentum),
        }
    }

    /// The state that a tangent leads to: `x + δx`, `R exp(ζ)`, `p + δp`, `π + δπ`; the inverse of [`difference`](Self::difference).
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
    /// Nodes of the rod, `K + 1`.
    pub n_nodes: usize,
    /// Positions: time node `k`, rod node `q` at `k (K+1) + q`.
    pub positions: Vec<Vector3<f64>>,
    /// Rotations, in the same order.
    pub rotations: Vec<Matrix3<f64>>,
}

impl Trajectory {
    /// An empty trajectory with room for `n_times` time nodes.
    #[must_use]
    pub fn with_capacity(n_nodes: usize, n_times: usize) -> Self {
        Self {
            n_nodes,
            positions: Vec::with_capacity(n_nodes * n_times),
            rotations: Vec::with_capacity(n_nodes * n_times),
        }
    }

    /// Number of time nodes, `N + 1`.
    #[must_use]
    pub fn n_times(&self) -> usize {
        self.positions.len() / self.n_nodes
    }

    /// Appends a time node.
    pub fn push(&mut self, configuration: &Configuration) {
        self.positions.extend_from_slice(&configuration.positions);
        self.rotations.extend_from_slice(&configuration.rotations);
    }

    /// Positions at time node `k`.
    #[inline]
    #[must_use]
    pub fn positions_at(&self, k: usize) -> &[Vector3<f64>] {
        &self.positions[k * self.n_nodes..(k + 1) * self.n_nodes]
    }

    /// Rotations at time node `k`.
    #[inline]
    #[must_use]
    pub fn rotations_at(&self, k: usize) -> &[Matrix3<f64>] {
        &self.rotations[k * self.n_nodes..(k + 1) * self.n_nodes]
    }

    /// The configuration at time node `k`.
    #[must_use]
    pub fn configuration(&self, k: usize) -> Configuration {
        Configuration {
            positions: self.positions_at(k).to_vec(),
            rotations: self.rotations_at(k).to_vec(),
        }
    }

    /// Moves every node along `direction`, `x + α δx` and `R exp(α ζ)`.
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
    /// Largest rotation of any node at any time, rad.
    #[must_use]
    pub fn largest_rotation(&self) -> f64 {
        self.rotations.iter().map(Vector3::norm).fold(0.0, f64::max)
    }
}
