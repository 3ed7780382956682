//! An equilibrium under controls that hold it.

use nalgebra::Matrix3;

use mechanics::Configuration;
use mechanics::tangent::Tangent;

/// An equilibrium, and the controls that hold it.
#[derive(Clone, Debug, PartialEq)]
pub struct Held {
    /// The controls: a coefficient of [the problem's](super::OptimalControlProblem), whose
    /// [`wrenches`](super::OptimalControlProblem::wrenches) are those on its nodes.
    pub controls: Vec<f64>,
    /// By how much the vector of every channel exceeds its bound; 0 within.
    pub excess: Vec<f64>,
    /// The shape at the equilibrium.
    pub shape: Configuration,
    /// Tells whether small deviations stay small under constant controls: no motion of the arm's elements grows.
    pub is_stable: bool,
    /// Smallest `ω²`, 1/s², of the symmetric part of the tangent stiffness and the inertia.
    pub least_squared_frequency: f64,
    /// Rate `s` at which small deviations grow as `exp(s t)`, 1/s, with damping; `None` if they do not grow.
    pub growth_rate: Option<f64>,
    /// Lowest angular frequency of the held arm without damping, rad/s; `None` if the equilibrium is unstable.
    pub first_frequency: Option<f64>,
    /// Displacement of the node that has the goal per force on it under constant controls, m/N, spatial frame; infinite for a free arm.
    pub compliance: Matrix3<f64>,
    /// The obstacle or limit of the task that the shape crosses most, and by how much, in words; `None` if it crosses none.
    pub crosses: Option<String>,
    /// Tangent stiffness under constant controls.
    pub tangent: Tangent,
}

impl Held {
    /// Tells whether all controls are within their bounds.
    #[must_use]
    pub fn is_within_bounds(&self) -> bool {
        self.excess.iter().all(|excess| *excess == 0.0)
    }

    /// Returns the stiffness of that node along its softest direction, N/m; 0 for a free arm.
    #[must_use]
    pub fn least_stiffness(&self) -> f64 {
        let c = &self.compliance;
        if !c.iter().all(|c| c.is_finite()) {
            return 0.0;
        }
        (0.5 * (c + c.transpose()))
            .symmetric_eigenvalues()
            .max()
            .recip()
    }
}
