//! The Hessian of the quadratic subproblem: Gauss-Newton, or the exact one made convex where it must be.

use faer::linalg::solvers::Solve as _;
use faer::{Mat, Side};

use super::program::{ConvexSet, Linearization};
use super::residual::{Multipliers, norm};

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
    /// Exact; positive definite as it is where constraints and active sets leave the variables free.
    Exact,
    /// Exact, with its negative curvature there turned round.
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
    /// Balls whose own curvature is in `matrix`: the subproblem must hold them by their tangents instead.
    pub tangents: Vec<ActiveNormal>,
}

/// Eigenvalues below this part of the least positive Gauss-Newton diagonal entry count as negative curvature.
const CURVATURE_FLOOR: f64 = 1e-4;

impl ModelHessian {
    /// Gauss-Newton.
    #[must_use]
    pub fn gauss_newton(linearization: &Linearization) -> Self {
        Self {
            matrix: linearization.gauss_newton.clone(),
            gradient: linearization.model_gradient.clone(),
            kind: HessianKind::GaussNewton,
            tangents: Vec::new(),
        }
    }

    /// The exact Hessian `H = GN + curvature`, convexified. Directions are split by the constraints' gradients and the
    /// normals of the active sets: on what they leave free, negative eigenvalues are turned round; on what they hold,
    /// `½ σ |Yᵀδ - t|²` is added, which vanishes where constraints and active sets hold (`t` is what `Yᵀδ` must be
    /// there) and so changes neither the step nor the multipliers, but for the sets' own curvature.
    ///
    /// A ball that is active bends the Lagrangian as well, by its multiplier over its radius across the normal. Where
    /// only that makes the Hessian positive, it goes into the matrix, and the ball's tangent takes the ball's place in
    /// the subproblem: otherwise the convexification would spoil the convergence for nothing.
    ///
    /// Falls back to Gauss-Newton without curvature, or when the held directions are dependent.
    #[must_use]
    pub fn exact(linearization: &Linearization, active: &[ActiveNormal]) -> Self {
        match Self::try_exact(linearization, active, false) {
            Some(model) if model.kind == HessianKind::Exact => model,
            plain => Self::try_exact(linearization, active, true)
                .filter(|model| model.kind == HessianKind::Exact)
                .or(plain)
                .or_else(|| Self::try_exact(linearization, &[], false))
                .unwrap_or_else(|| Self::gauss_newton(linearization)),
        }
    }

    fn try_exact(
        linearization: &Linearization,
        active: &[ActiveNormal],
        bent: bool,
    ) -> Option<Self> {
        let curvature = linearization.curvature.as_ref()?;
        let mut full = &linearization.gauss_newton + curvature;
        let tangents: Vec<ActiveNormal> = active
            .iter()
            .filter(|normal| bent && normal.curvature > 0.0)
            .cloned()
            .collect();
        for normal in &tangents {
            normal.add_curvature(&mut full);
        }
        let n = full.nrows();
        let held = Held::new(linearization, active);
        let m = held.target.len();
        if m >= n {
            return None;
        }
        let unit = largest_diagonal(&linearization.gauss_newton);
        let floor = CURVATURE_FLOOR * linearization.least_curvature();
        let basis = held.gradients.transpose().to_owned().qr().compute_Q();
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
            // Schur complement of the held directions: what σ must outweigh.
            let cross = vectors.transpose() * &full * range;
            let weighted = Mat::from_fn(n - m, m, |i, j| cross[(i, j)] / turned[i]);
            let schur = cross.transpose() * &weighted - range.transpose() * &full * range;
            let worst = schur
                .self_adjoint_eigen(Side::Lower)
                .ok()
                .map(|e| (0..m).map(|i| e.S()[i]).fold(0.0, f64::max))?;
            let sigma = 2.0 * worst + unit;
            let square = &held.gradients * range;
            let target = Mat::from_fn(m, 1, |i, _| held.target[i]);
            let t = square.partial_piv_lu().solve(&target);
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
            tangents,
        })
    }
}

/// Gradients of everything that holds a direction, and how far the step must go along them.
struct Held {
    gradients: Mat<f64>,
    target: Vec<f64>,
}

impl Held {
    fn new(linearization: &Linearization, active: &[ActiveNormal]) -> Self {
        let jacobian = &linearization.jacobian;
        let m = jacobian.nrows();
        let mut gradients = Mat::zeros(m + active.len(), jacobian.ncols());
        let mut target: Vec<f64> = linearization.offset.iter().map(|c| -c).collect();
        for i in 0..m {
            for j in 0..jacobian.ncols() {
                gradients[(i, j)] = jacobian[(i, j)];
            }
        }
        for (row, normal) in active.iter().enumerate() {
            for &(index, value) in &normal.direction {
                gradients[(m + row, index)] = value;
            }
            target.push(normal.gap);
        }
        Self { gradients, target }
    }
}

/// The outward unit normal of a set whose boundary holds the variables, and the distance that is left to it.
#[derive(Clone, Debug, PartialEq)]
pub struct ActiveNormal {
    /// `(variable, component)`
    pub direction: Vec<(usize, f64)>,
    /// Distance to the boundary along the normal.
    pub gap: f64,
    /// Multiplier over radius of a ball; 0 for a flat set.
    pub curvature: f64,
    /// Which set it is.
    pub set: usize,
}

impl ActiveNormal {
    /// Adds `curvature (I - n nᵀ)` on the set's variables.
    fn add_curvature(&self, matrix: &mut Mat<f64>) {
        for &(i, a) in &self.direction {
            matrix[(i, i)] += self.curvature;
            for &(j, b) in &self.direction {
                matrix[(i, j)] -= self.curvature * a * b;
            }
        }
    }

    /// The half-space that touches the set where the variables are closest to it.
    #[must_use]
    pub fn tangent(&self, variables: &[f64]) -> ConvexSet {
        let along: f64 = self.direction.iter().map(|&(i, c)| c * variables[i]).sum();
        ConvexSet::HalfSpace {
            direction: self.direction.clone(),
            limit: along + self.gap,
        }
    }

    /// The active sets: those whose multiplier, in units of the cost's curvature, exceeds their slack.
    #[must_use]
    pub fn of(
        sets: &[ConvexSet],
        variables: &[f64],
        multipliers: &Multipliers,
        linearization: &Linearization,
    ) -> Vec<Self> {
        let unit = linearization.least_curvature();
        sets.iter()
            .zip(&multipliers.normals)
            .enumerate()
            .filter_map(|(at, (set, normal))| match set {
                ConvexSet::Interval {
                    index,
                    lower,
                    upper,
                } => {
                    let v = variables[*index];
                    let sign = normal[0].signum();
                    let gap = if sign > 0.0 { upper - v } else { v - lower };
                    (normal[0].abs() / unit > gap).then(|| Self {
                        direction: vec![(*index, sign)],
                        gap,
                        curvature: 0.0,
                        set: at,
                    })
                }
                ConvexSet::HalfSpace { direction, limit } => {
                    let along: f64 = direction.iter().map(|&(i, c)| c * variables[i]).sum();
                    let gap = limit - along;
                    (normal[0] / unit > gap).then(|| Self {
                        direction: direction.clone(),
                        gap,
                        curvature: 0.0,
                        set: at,
                    })
                }
                ConvexSet::Ball { indices, radius } => {
                    let u: Vec<f64> = indices.iter().map(|&i| variables[i]).collect();
                    let size = norm(&u);
                    let pull = norm(normal);
                    let gap = radius - size;
                    (size > 0.0 && pull / unit > gap).then(|| Self {
                        direction: indices
                            .iter()
                            .zip(&u)
                            .map(|(&i, x)| (i, x / size))
                            .collect(),
                        gap,
                        curvature: pull / radius,
                        set: at,
                    })
                }
            })
            .collect()
    }
}

fn largest_diagonal(m: &Mat<f64>) -> f64 {
    (0..m.nrows()).map(|i| m[(i, i)]).fold(0.0, f64::max)
}
