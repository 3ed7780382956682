//! The two forms of a quadratic subproblem, and the linearization with states from which the sparse form is built.

use faer::Mat;

// Programs that do not provide the equations of their states are solved condensed.
/// Variables of the quadratic subproblems; the step is the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "Qp"))]
#[serde(rename_all = "kebab-case")]
pub enum QpRoute {
    /// Over the controls alone: small and dense.
    #[default]
    Condensed,
    /// Over the controls and the configurations at all time nodes: large and sparse. Explicit steps of the standard model only.
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

/// `states·ξ + variables·δ`: a linear function of the change of the states and of the step of the variables.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StateRow {
    /// `(state, coefficient)`; coefficients of a state that occurs twice add up.
    pub states: Vec<(usize, f64)>,
    /// `(variable, coefficient)`, with the same rule.
    pub variables: Vec<(usize, f64)>,
}

/// The linearization of [`Linearization`](super::Linearization) at a point, before the states are eliminated.
///
/// `ξ` is the change of the states without their response to the defects: it vanishes with `δ`, and constants and gradient are those of the
/// condensed linearization. (With the response included, Clarabel would weigh its gap against costs that no step can change.) The
/// Gauss-Newton term `½ δᵀ(GN)δ` is `½ δᵀHδ + ½ Σ row²` over the residuals.
#[derive(Clone, Debug)]
pub struct StateLinearization {
    /// Length of `ξ`.
    pub n_states: usize,
    /// Equations of the states: each of these vanishes.
    pub equations: Vec<StateRow>,
    /// `dc`
    pub constraints: Vec<StateRow>,
    /// `dh` of the rows of the condensed linearization, in its order.
    pub inequalities: Vec<StateRow>,
    /// Changes of the residuals of the cost on states.
    pub residuals: Vec<StateRow>,
    /// `H`, the Hessian of the cost on variables.
    pub hessian: Mat<f64>,
}
