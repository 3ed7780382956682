//! Two ways to the step of a quadratic subproblem, and what they cost.

use super::kept_states::StateSize;

/// How the quadratic subproblem is put to Clarabel. Both ways lead to the same step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum QpRoute {
    /// The one that [`predict`] says is faster.
    #[default]
    Auto,
    /// Over the variables alone: small and dense.
    Condensed,
    /// With the states and their equations: large and sparse.
    Sparse,
}

impl QpRoute {
    /// Name in scene and result files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Condensed => "condensed",
            Self::Sparse => "sparse",
        }
    }

    /// Condensed or sparse: the faster one where that is left open, condensed where states cannot be kept.
    #[must_use]
    pub fn resolve(self, n_variables: usize, size: Option<StateSize>) -> Self {
        match (self, size) {
            (Self::Auto, size) => predict(n_variables, size).faster(),
            (_, None) => Self::Condensed,
            (wanted, Some(_)) => wanted,
        }
    }
}

/// Predicted seconds of one quadratic subproblem.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QpTimes {
    /// By the condensed route.
    pub condensed: f64,
    /// By the sparse one; `None` where the program does not keep states.
    pub sparse: Option<f64>,
}

impl QpTimes {
    /// The faster route.
    #[must_use]
    pub fn faster(self) -> QpRoute {
        match self.sparse {
            Some(sparse) if sparse < self.condensed => QpRoute::Sparse,
            _ => QpRoute::Condensed,
        }
    }
}

/// Seconds that Clarabel takes for a subproblem over `n` variables, and for one that keeps states of the size `size`.
///
/// Fitted to `cargo bench --bench qp_routes` (4 to 20 elements, 100 to 400 steps, 60 to 600 variables, costs of the control alone; a core
/// of an Intel Xeon): within a factor of 2 of all of it.
#[must_use]
pub fn predict(n_variables: usize, size: Option<StateSize>) -> QpTimes {
    let n = n_variables as f64;
    QpTimes {
        condensed: CONDENSED_S * (n / 120.0).powf(CONDENSED_POWER),
        sparse: size.map(|size| {
            let StateSize { at_once, instants } = size;
            SPARSE_S * instants as f64 * (at_once as f64 / 60.0).powf(SPARSE_POWER)
        }),
    }
}

/// Seconds of a condensed subproblem of 120 variables, and how they grow with their number.
const CONDENSED_S: f64 = 8.5e-4;
const CONDENSED_POWER: f64 = 1.95;
/// Seconds per instant of a sparse subproblem with 60 states at an instant, and how they grow with these.
const SPARSE_S: f64 = 1.2e-3;
const SPARSE_POWER: f64 = 1.65;
