//! The two ways to put a quadratic subproblem, and the linearization that keeps the states, of which the sparse one is made.

use faer::Mat;

/// How the quadratic subproblem is put to Clarabel. Both ways lead to the same step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum QpRoute {
    /// Over the variables alone: small and dense.
    #[default]
    Condensed,
    /// With the states and their equations: large and sparse. Programs that do not keep their states are solved condensed.
    Sparse,
}

impl QpRoute {
    /// Name in scene and result files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Condensed => "condensed",
            Self::Sparse => "sparse",
        }
    }
}

/// `states·ξ + variables·δ`, linear in what a step of the variables does to the states, and in that step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StateRow {
    /// State, coefficient; those of a state that occurs more than once add up.
    pub states: Vec<(usize, f64)>,
    /// The same of the variables.
    pub variables: Vec<(usize, f64)>,
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
