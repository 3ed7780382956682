//! The Hessian of the quadratic subproblem: Gauss-Newton, or the exact one made convex where it must be.

use faer::linalg::solvers::Solve as _;
use faer::{Mat, Side};

use super::program::Linearization;

/// Which Hessian the solver uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HessianChoice {
    /// Gauss-Newton far out, exact once the point is near enough to a solution.
    Auto,
    /// Gauss-Newton throughout.
    GaussNewton,
    /// Exact throughout.
    Exact,
}

impl HessianChoice {
    /// Name in scene and result files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::GaussNewton => "gauss-newton",
            Self::Exact => "exact",
        }
    }
}

/// What was put into the subproblem.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum HessianKind {
    /// Gauss-Newton.
    GaussNewton,
    /// Exact; positive definite on the null space of the constraints as it is.
    Exact,
    /// Exact, with its negative curvature on the null space turned round.
    Convexified,
}

/// A positive semidefinite Hessian and the gradient that goes with it.
#[derive(Clone, Debug)]
pub struct ModelHessian {
    /// `H`
    pub matrix: Mat<f64>,
    /// Gradient of the model; differs from the given one by a term that vanishes on the constraints.
    pub gradient: Vec<f64>,
    /// Where it came from.
    pub kind: HessianKind,
}

/// Eigenvalues below this part of the largest Gauss-Newton diagonal entry count as negative curvature.
const CURVATURE_FLOOR: f64 = 1e-4;

impl ModelHessian {
    /// Gauss-Newton.
    #[must_use]
    pub fn gauss_newton(linearization: &Linearization) -> Self {
        Self {
            matrix: linearization.gauss_newton.clone(),
            gradient: linearization.model_gradient.clone(),
            kind: HessianKind::GaussNewton,
        }
    }

    /// The exact Hessian `H = GN + curvature`, convexified: on the null space of the constraints negative eigenvalues
    /// are turned round, and on their row space `½ σ |Yᵀδ - t|²` is added, which vanishes where the constraints hold
    /// (`t` is what `Yᵀδ` must be there) and so changes neither the step nor the multipliers.
    ///
    /// Falls back to Gauss-Newton without curvature, or when the constraints' rows are dependent.
    #[must_use]
    pub fn exact(linearization: &Linearization) -> Self {
        Self::try_exact(linearization).unwrap_or_else(|| Self::gauss_newton(linearization))
    }

    fn try_exact(linearization: &Linearization) -> Option<Self> {
        let curvature = linearization.curvature.as_ref()?;
        let full = &linearization.gauss_newton + curvature;
        let n = full.nrows();
        let m = linearization.jacobian.nrows();
        if m >= n {
            return None;
        }
        let unit = largest_diagonal(&linearization.gauss_newton);
        let floor = CURVATURE_FLOOR * unit;
        let basis = linearization
            .jacobian
            .transpose()
            .to_owned()
            .qr()
            .compute_Q();
        let (range, null) = basis.split_at_col(m);
        let reduced = null.transpose() * &full * null;
        let eigen = reduced.self_adjoint_eigen(Side::Lower).ok()?;
        let values: Vec<f64> = (0..n - m).map(|i| eigen.S()[i]).collect();
        if !values.iter().all(|v| v.is_finite()) {
            return None;
        }
        let turned: Vec<f64> = values.iter().map(|v| v.abs().max(floor)).collect();
        let kind = if values.iter().all(|&v| v >= floor) {
            HessianKind::Exact
        } else {
            HessianKind::Convexified
        };
        let vectors = null * eigen.U();
        let mut matrix = full.clone();
        if kind == HessianKind::Convexified {
            let scaled = Mat::from_fn(n, n - m, |i, j| vectors[(i, j)] * (turned[j] - values[j]));
            matrix += &scaled * vectors.transpose();
        }
        let mut gradient = linearization.model_gradient.clone();
        if m > 0 {
            // Schur complement of the row space: what σ must outweigh.
            let cross = vectors.transpose() * &full * range;
            let weighted = Mat::from_fn(n - m, m, |i, j| cross[(i, j)] / turned[i]);
            let schur = cross.transpose() * &weighted - range.transpose() * &full * range;
            let worst = schur
                .self_adjoint_eigen(Side::Lower)
                .ok()
                .map(|e| (0..m).map(|i| e.S()[i]).fold(0.0, f64::max))?;
            let sigma = 2.0 * worst + unit;
            let square = &linearization.jacobian * range;
            let offset = Mat::from_fn(m, 1, |i, _| -linearization.offset[i]);
            let t = square.partial_piv_lu().solve(&offset);
            if !sigma.is_finite() || !(0..m).all(|i| t[(i, 0)].is_finite()) {
                return None;
            }
            matrix += (range * range.transpose()) * faer::Scale(sigma);
            for (i, g) in gradient.iter_mut().enumerate() {
                *g -= sigma * (0..m).map(|j| range[(i, j)] * t[(j, 0)]).sum::<f64>();
            }
        }
        Some(Self {
            matrix,
            gradient,
            kind,
        })
    }
}

fn largest_diagonal(m: &Mat<f64>) -> f64 {
    (0..m.nrows()).map(|i| m[(i, i)]).fold(0.0, f64::max)
}
