//! Multipliers of the equations of motion.

use nalgebra::Vector3;

use super::{Motion, StateTangent};
use cosserat::load::Wrench;

/// Multipliers of the defect rows of every time node, and of the terminal momenta.
#[derive(Clone, Debug, PartialEq)]
pub struct AdjointSweep {
    /// Covector of the momenta after the kick: of the linear rows `r_k`, in the order of [`Defects::linear`](super::Defects::linear), then
    /// of the linear momenta at `N`; zero on fixed nodes.
    pub linear: Vec<Vector3<f64>>,
    /// Covector of the angular rows, then of the angular momenta at `N`.
    pub angular: Vec<Vector3<f64>>,
    /// Covector of the linear momenta that arrive at a time node, before its kick, in the same order.
    pub arriving_linear: Vec<Vector3<f64>>,
    /// Covector of the angular momenta that arrive, in the same order.
    pub arriving_angular: Vec<Vector3<f64>>,
    /// Covector of the state at the start, momenta before the first kick: the derivative along the initial state; zero on fixed
    /// nodes.
    pub start: StateTangent,
}

impl AdjointSweep {
    /// Returns zeros for so many nodes and time nodes.
    pub(crate) fn zeros(n_nodes: usize, n_times: usize) -> Self {
        let zeros = vec![Vector3::zeros(); n_nodes * n_times];
        Self {
            linear: zeros.clone(),
            angular: zeros.clone(),
            arriving_linear: zeros.clone(),
            arriving_angular: zeros,
            start: StateTangent::zeros(n_nodes),
        }
    }

    /// Derivative along a wrench on `node` at time node `k`: force per newton (spatial), moment per newton metre (body frame).
    #[must_use]
    pub fn wrench(&self, motion: &Motion, k: usize, node: usize) -> Wrench {
        let weight = motion.kick(k).weight;
        let row = k * motion.rod.n_nodes() + node;
        Wrench {
            force: weight * self.linear[row],
            moment: weight * self.angular[row],
        }
    }
}
