//! The defects of the discrete equations of motion, and right-hand sides of the linearized ones.

use nalgebra::Vector3;

use super::StateTangent;

/// Defects of the discrete equations of motion, and the momenta at the last time node.
#[derive(Clone, Debug, PartialEq)]
pub struct Defects {
    /// Linear rows, spatial, kg m/s: time node `k < N`, rod node `q` at `k (K+1) + q`; zero on fixed nodes.
    pub linear: Vec<Vector3<f64>>,
    /// Angular rows, body frame, kg m²/s, in the same order.
    pub angular: Vec<Vector3<f64>>,
    /// Linear momentum of every node at `N`.
    pub terminal_linear: Vec<Vector3<f64>>,
    /// Angular momentum of every node at `N`, body frame.
    pub terminal_angular: Vec<Vector3<f64>>,
}

/// A right-hand side of the linearized equations of motion: a change of every row `r_k`, of the momenta at the end, and of the
/// state at the start.
#[derive(Clone, Debug, PartialEq)]
pub struct RightHandSide {
    /// Linear rows, spatial, in the order of [`Defects::linear`]; without effect on fixed nodes.
    pub linear: Vec<Vector3<f64>>,
    /// Angular rows, body frame, in the same order.
    pub angular: Vec<Vector3<f64>>,
    /// Direct change of the linear momentum of every node at `N`.
    pub terminal_linear: Vec<Vector3<f64>>,
    /// Direct change of the angular momenta, body frame.
    pub terminal_angular: Vec<Vector3<f64>>,
    /// Deviation of the state at time node 0, momenta before the first kick; `None` where it is as given. Without effect on
    /// fixed nodes.
    pub start: Option<StateTangent>,
}

impl RightHandSide {
    /// Returns the right-hand side that has only a deviation of the state at the start, over `n_steps` steps.
    #[must_use]
    pub fn at_start(deviation: StateTangent, n_steps: usize) -> Self {
        let n_nodes = deviation.positions.len();
        let rows = vec![Vector3::zeros(); n_nodes * n_steps];
        let end = vec![Vector3::zeros(); n_nodes];
        Self {
            linear: rows.clone(),
            angular: rows,
            terminal_linear: end.clone(),
            terminal_angular: end,
            start: Some(deviation),
        }
    }

    /// Minus the defects: what makes them vanish to first order. The terminal momenta have none.
    #[must_use]
    pub fn against(defects: &Defects) -> Self {
        let minus = |v: &[Vector3<f64>]| v.iter().map(|v| -v).collect();
        let zeros = vec![Vector3::zeros(); defects.terminal_linear.len()];
        Self {
            linear: minus(&defects.linear),
            angular: minus(&defects.angular),
            terminal_linear: zeros.clone(),
            terminal_angular: zeros,
            start: None,
        }
    }

    /// Change of the momenta of all `n` nodes after the kick at time node `k`.
    pub(crate) fn at(&self, k: usize, n: usize) -> (&[Vector3<f64>], &[Vector3<f64>]) {
        match self.linear.get(k * n..(k + 1) * n) {
            Some(linear) => (linear, &self.angular[k * n..(k + 1) * n]),
            None => (&self.terminal_linear, &self.terminal_angular),
        }
    }
}
