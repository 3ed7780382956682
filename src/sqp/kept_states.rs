//! A linearization that keeps the states: what the [sparse](super::QpRoute::Sparse) quadratic subproblem is made of.

use faer::Mat;

/// `states·ξ + variables·δ`, linear in what a step of the variables does to the states, and in that step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StateRow {
    /// State, coefficient; those of a state that occurs more than once add up.
    pub states: Vec<(usize, f64)>,
    /// The same of the variables.
    pub variables: Vec<(usize, f64)>,
}

/// How many states a program has, for the [prediction](super::route::predict) of what keeping them costs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StateSize {
    /// States of one instant.
    pub at_once: usize,
    /// Instants.
    pub instants: usize,
}

impl StateSize {
    /// All states.
    #[must_use]
    pub fn total(self) -> usize {
        self.at_once * self.instants
    }
}

/// The linearization of [`Linearization`](super::Linearization) at a point, with the states in it.
///
/// `ξ` is the change of the states beyond their answer to their defects: it vanishes with `δ`, and constants are those of the
/// condensed linearization, like the gradient. (With the answer in it, Clarabel would weigh its gap against costs that no step can
/// change.) The Gauss-Newton term `½ δᵀ(GN)δ` is `½ δᵀHδ + ½ Σ row²` over the residuals.
#[derive(Clone, Debug)]
pub struct StateLinearization {
    /// Length of `ξ`.
    pub n_states: usize,
    /// State equations: all vanish.
    pub equations: Vec<StateRow>,
    /// `dc`
    pub constraints: Vec<StateRow>,
    /// `dh` of the rows that the condensed linearization has, in its order.
    pub inequalities: Vec<StateRow>,
    /// Changes of the residuals of the cost over states.
    pub residuals: Vec<StateRow>,
    /// `H`, of the cost over the variables.
    pub hessian: Mat<f64>,
}
