//! The Hessian of the quadratic subproblem: Gauss-Newton, or the exact one made convex where it must be.

use faer::linalg::solvers::Solve as _;
use faer::{Mat, Side};

use super::kkt::{Multipliers, norm};
use super::program::{
    ConvexSet, Failure, LiftedProgram, Linearization, LinearizationRequest, Softness, along,
};
use super::settings::NEGLIGIBLE;

/// The second derivatives that the quadratic model uses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "Hessian"))]
#[serde(rename_all = "kebab-case")]
pub enum HessianChoice {
    /// Gauss-Newton while the linearized constraints cannot be met, exact afterwards, with the multipliers of the last subproblem.
    #[default]
    Auto,
    /// Of the objective alone.
    GaussNewton,
    /// Of the Lagrangian.
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
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum HessianKind {
    /// Gauss-Newton.
    #[default]
    GaussNewton,
    /// Exact; positive definite as it is where constraints and active sets leave the variables free.
    Exact,
    /// Exact, with its negative curvature there turned round.
    Convexified,
    /// None: restoration of feasibility, with a proximal term.
    Proximal,
}

impl HessianKind {
    /// Whether it holds the second derivative of the Lagrangian, so that steps near a solution contract by themselves.
    #[must_use]
    pub fn is_second_order(self) -> bool {
        matches!(self, Self::Exact | Self::Convexified)
    }
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
    /// Value of the model at no step, which the terms of what is held contribute.
    pub constant: f64,
    /// The most negative curvature that was turned round.
    pub descent: Option<NegativeCurvature>,
    /// Whether `matrix` and `gradient` have terms of what is held, which are right only where a step does hold it.
    pub holds: bool,
}

/// A direction that holds what is active, to first order, and along which the Lagrangian bends downward.
#[derive(Clone, Debug, PartialEq)]
pub struct NegativeCurvature {
    /// Unit vector of the variables.
    pub direction: Vec<f64>,
    /// Second derivative along it, negative.
    pub value: f64,
}

/// Eigenvalues below this part of the least positive Gauss-Newton diagonal entry count as negative curvature.
const CURVATURE_FLOOR: f64 = 1e-4;
/// Negative curvature beyond this part of it makes a stationary point a saddle.
const SADDLE_CURVATURE: f64 = 1e-2;

impl ModelHessian {
    /// Gauss-Newton.
    #[must_use]
    pub fn gauss_newton(linearization: &Linearization) -> Self {
        Self {
            matrix: linearization.gauss_newton.clone(),
            gradient: linearization.model_gradient.clone(),
            kind: HessianKind::GaussNewton,
            tangents: Vec::new(),
            constant: 0.0,
            descent: None,
            holds: false,
        }
    }

    /// A given matrix and no objective.
    pub(super) fn proximal(matrix: Mat<f64>) -> Self {
        Self {
            gradient: vec![0.0; matrix.nrows()],
            matrix,
            kind: HessianKind::Proximal,
            tangents: Vec::new(),
            constant: 0.0,
            descent: None,
            holds: false,
        }
    }

    /// The exact Hessian `H = GN + curvature`, convexified. Directions are split by the gradients of constraints and
    /// active inequalities and the normals of the active sets: on what they leave free, negative eigenvalues are turned
    /// round; on what they hold, `½ σ |Yᵀδ - t|²` is added, which vanishes where all of them hold (`t` is what `Yᵀδ` must
    /// be there) and so changes neither the step nor the multipliers, but for the sets' own curvature.
    ///
    /// A ball that is active bends the Lagrangian as well, by its multiplier over its radius across the normal. Where
    /// only that makes the Hessian positive, it goes into the matrix, and the ball's tangent takes the ball's place in
    /// the subproblem: otherwise the convexification would spoil the convergence for nothing.
    ///
    /// A Hessian that is positive definite is left alone; without curvature it is Gauss-Newton.
    #[must_use]
    pub fn exact(linearization: &Linearization, sets: &[ConvexSet], active: &ActiveSet) -> Self {
        let Some(curvature) = &linearization.curvature else {
            return Self::gauss_newton(linearization);
        };
        let full = &linearization.gauss_newton + curvature;
        if is_positive(&full, CURVATURE_FLOOR * linearization.least_curvature()) {
            return Self {
                matrix: full,
                kind: HessianKind::Exact,
                ..Self::gauss_newton(linearization)
            };
        }
        match Self::convexified(full.clone(), linearization, active) {
            Some(model) if model.kind == HessianKind::Exact => model,
            plain => Self::bent(full, linearization, sets, active)
                .filter(|model| model.kind == HessianKind::Exact)
                .or(plain)
                .unwrap_or_else(|| Self::gauss_newton(linearization)),
        }
    }

    /// With the curvature of the active balls.
    fn bent(
        mut full: Mat<f64>,
        linearization: &Linearization,
        sets: &[ConvexSet],
        active: &ActiveSet,
    ) -> Option<Self> {
        // What bends more would drown the curvature that decides in its own rounding.
        let most = CURVATURE_FLOOR * linearization.least_curvature() / f64::EPSILON;
        let tangents: Vec<ActiveNormal> = (active.normals.iter())
            .filter(|normal| normal.curvature > 0.0 && normal.curvature < most)
            .cloned()
            .collect();
        if tangents.is_empty() {
            return None;
        }
        for normal in &tangents {
            normal.add_curvature(sets, &mut full);
        }
        Some(Self {
            tangents,
            ..Self::convexified(full, linearization, active)?
        })
    }

    fn convexified(
        full: Mat<f64>,
        linearization: &Linearization,
        active: &ActiveSet,
    ) -> Option<Self> {
        let n = full.nrows();
        let Held {
            basis: range,
            target,
        } = Held::of(linearization, active);
        let m = target.len();
        let unit = largest_diagonal(&linearization.gauss_newton);
        let floor = CURVATURE_FLOOR * linearization.least_curvature();
        let complete = range.qr().compute_Q();
        let null = complete.subcols(m, n - m);
        let mut matrix = full.clone();
        let mut gradient = linearization.model_gradient.clone();
        let mut kind = HessianKind::Exact;
        let mut constant = 0.0;
        let mut cross_terms = Mat::zeros(m, m);
        let mut descent = None;
        let reduced = null.transpose() * &full * null;
        if n > m && is_positive(&reduced, floor) {
            let cross = null.transpose() * &full * &range;
            let inverse = reduced.llt(Side::Lower).ok()?;
            cross_terms = cross.transpose() * inverse.solve(&cross);
        } else if n > m {
            let eigen = reduced.self_adjoint_eigen(Side::Lower).ok()?;
            let values: Vec<f64> = (0..n - m).map(|i| eigen.S()[i]).collect();
            if !values.iter().all(|v| v.is_finite()) {
                return None;
            }
            let turned: Vec<f64> = values.iter().map(|v| v.abs().max(floor)).collect();
            let vectors = null * eigen.U();
            if !values.iter().all(|&v| v >= floor) {
                kind = HessianKind::Convexified;
                let scaled =
                    Mat::from_fn(n, n - m, |i, j| vectors[(i, j)] * (turned[j] - values[j]));
                matrix += &scaled * vectors.transpose();
                descent = (values.iter().enumerate())
                    .min_by(|a, b| a.1.total_cmp(b.1))
                    .filter(|&(_, &value)| {
                        value < -SADDLE_CURVATURE * linearization.least_curvature()
                    })
                    .map(|(j, &value)| NegativeCurvature {
                        direction: (0..n).map(|i| vectors[(i, j)]).collect(),
                        value,
                    });
            }
            let cross = vectors.transpose() * &full * &range;
            let weighted = Mat::from_fn(n - m, m, |i, j| cross[(i, j)] / turned[i]);
            cross_terms = cross.transpose() * &weighted;
        }
        if m > 0 {
            // Schur complement of the held directions: what σ must outweigh.
            let schur = cross_terms - range.transpose() * &full * &range;
            let worst = schur
                .self_adjoint_eigen(Side::Lower)
                .ok()
                .map(|e| (0..m).map(|i| e.S()[i]).fold(0.0, f64::max))?;
            let sigma = 2.0 * worst + unit;
            if !sigma.is_finite() || !target.iter().all(|t| t.is_finite()) {
                return None;
            }
            matrix += (&range * range.transpose()) * faer::Scale(sigma);
            constant = 0.5 * sigma * target.iter().map(|t| t * t).sum::<f64>();
            for (i, g) in gradient.iter_mut().enumerate() {
                *g -= sigma * (0..m).map(|j| range[(i, j)] * target[j]).sum::<f64>();
            }
        }
        Some(Self {
            matrix,
            gradient,
            kind,
            tangents: Vec::new(),
            constant,
            descent,
            holds: m > 0,
        })
    }
}

/// Whether the Hessian of the Lagrangian at a solution is positive on what constraints, and inequalities and sets with a multiplier, leave free:
/// the second-order sufficient condition (Nocedal and Wright 2006, theorem 12.6), by the solver's own derivatives. `false` says nothing.
///
/// # Errors
/// [`Failure`] where the program cannot be evaluated or linearized there.
pub fn is_strict_minimum<P: LiftedProgram>(
    program: &P,
    point: &P::Point,
    multipliers: &Multipliers,
) -> Result<bool, Failure> {
    let evaluation = program.evaluate(point)?;
    let held = multipliers.inequalities.iter().enumerate();
    let rows: Vec<usize> = held
        .filter(|(_, z)| **z > 0.0)
        .map(|(row, _)| row)
        .collect();
    let request = LinearizationRequest {
        multipliers: Some(multipliers),
        rows: &rows,
    };
    let linearization = program.linearize(point, &evaluation, &request)?;
    let softness: Vec<Softness> = rows.iter().map(|&row| program.softness(row)).collect();
    let (sets, variables) = (program.sets(), program.variables(point));
    let active = ActiveSet::of(&linearization, &softness, sets, variables, multipliers);
    Ok(ModelHessian::exact(&linearization, sets, &active).kind == HessianKind::Exact)
}

/// An orthonormal basis of the directions that something holds, and how far the step must go along each. A gradient that
/// depends on those before it holds nothing of its own.
struct Held {
    basis: Mat<f64>,
    target: Vec<f64>,
}

/// Part of a row's gradient that must be independent of the others. Neighbors among many inequalities point almost the same way;
/// the one with the larger multiplier holds that direction, and what the other is off by would be magnified.
const INDEPENDENT_PART_OF_ROWS: f64 = 1e-2;
/// Where it is magnified to no more than this, as near a solution, neighbors hold what is their own from this part on: at an optimum that both
/// hold, the curvature there need not be positive.
const NEAR_TARGET: f64 = 1e-3;
const LEAST_PART: f64 = 1e-5;

impl Held {
    fn of(linearization: &Linearization, active: &ActiveSet) -> Self {
        let n = linearization.gradient.len();
        let mut held = (Vec::<Vec<f64>>::new(), Vec::new());
        for (i, offset) in linearization.offset.iter().enumerate() {
            let row = (0..n).map(|j| linearization.jacobian[(i, j)]).collect();
            hold(&mut held, row, -offset, NEGLIGIBLE);
        }
        for &at in &active.rows {
            let jacobian = &linearization.inequality_jacobian;
            let row = (0..n).map(|j| jacobian[(at, j)]).collect();
            let target = -linearization.inequality_offset[at];
            hold(&mut held, row, target, INDEPENDENT_PART_OF_ROWS);
        }
        for normal in &active.normals {
            let mut row = vec![0.0; n];
            for &(index, component) in &normal.direction {
                row[index] += component;
            }
            hold(&mut held, row, normal.gap, NEGLIGIBLE);
        }
        let (basis, target) = held;
        Self {
            basis: Mat::from_fn(n, basis.len(), |i, j| basis[j][i]),
            target,
        }
    }
}

/// Gram and Schmidt, twice, on `row · δ = target`.
fn hold(
    held: &mut (Vec<Vec<f64>>, Vec<f64>),
    mut row: Vec<f64>,
    mut target: f64,
    independent_part: f64,
) {
    let size = norm(&row);
    if held.0.len() == row.len() {
        return;
    }
    for _ in 0..2 {
        for (direction, t) in held.0.iter().zip(&held.1) {
            let along: f64 = direction.iter().zip(&row).map(|(d, r)| d * r).sum();
            for (r, d) in row.iter_mut().zip(direction) {
                *r -= along * d;
            }
            target -= along * t;
        }
    }
    let left = norm(&row);
    let holds_its_own = left > LEAST_PART * size && target.abs() <= NEAR_TARGET * left;
    if left > independent_part * size || holds_its_own {
        held.0.push(row.iter().map(|r| r / left).collect());
        held.1.push(target / left);
    }
}

/// What holds the variables besides the constraints.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ActiveSet {
    /// Linearized inequalities, by their place in the linearization, the largest multiplier first.
    pub rows: Vec<usize>,
    /// Convex sets.
    pub normals: Vec<ActiveNormal>,
}

impl ActiveSet {
    /// What has a multiplier that, in units of the cost's curvature, exceeds the slack. A soft row holds nothing once its
    /// price is paid. `softness`: of the linearized rows.
    #[must_use]
    pub fn of(
        linearization: &Linearization,
        softness: &[Softness],
        sets: &[ConvexSet],
        variables: &[f64],
        multipliers: &Multipliers,
    ) -> Self {
        let unit = linearization.least_curvature();
        let multiplier = |at: usize| multipliers.inequalities[linearization.rows[at]];
        let holds = |&at: &usize| {
            let z = multiplier(at);
            let is_bought = match softness[at] {
                Softness::Hard => false,
                Softness::Soft { linear, .. } => !(z < (1.0 - BOUGHT) * linear),
            };
            z > 0.0 && z / unit > -linearization.inequality_offset[at] && !is_bought
        };
        let mut rows: Vec<usize> = (0..linearization.rows.len()).filter(holds).collect();
        rows.sort_by(|&a, &b| multiplier(b).total_cmp(&multiplier(a)));
        Self {
            rows,
            normals: ActiveNormal::of(sets, variables, multipliers, unit),
        }
    }

    /// Returns what a step leaves behind: linearized inequalities and sets, whose slack after the step is more than a part of the multiplier that
    /// goes with it, in units of the cost's curvature. A step along the tangent of a ball returns to the ball, and leaves that only by its own slack: its
    /// normal falls short of the tangent by the square of the step, `|δ|²/2r`, however well it holds.
    #[must_use]
    pub fn left_by(
        &self,
        linearization: &Linearization,
        change: &[f64],
        multipliers: &Multipliers,
        tangents: &Tangents,
    ) -> Self {
        let unit = linearization.least_curvature();
        let is_left = |slack: f64, multiplier: f64| slack > TIGHT * multiplier / unit;
        let values = linearization.inequalities_along(change);
        let row = |&&at: &&usize| {
            let multiplier = multipliers.inequalities[linearization.rows[at]];
            is_left(-values[at], multiplier)
        };
        let normal = |held: &&ActiveNormal| {
            let gap = (tangents.slack(held.set, change))
                .unwrap_or_else(|| held.gap - along(&held.direction, change));
            is_left(gap, norm(&multipliers.normals[held.set]))
        };
        Self {
            rows: self.rows.iter().filter(row).copied().collect(),
            normals: self.normals.iter().filter(normal).cloned().collect(),
        }
    }
}

/// Balls that a subproblem held by their tangents, and the variables that its step leaves.
#[derive(Clone, Copy, Debug)]
pub struct Tangents<'a> {
    /// The balls' normals.
    pub held: &'a [ActiveNormal],
    /// All sets.
    pub sets: &'a [ConvexSet],
    /// `v`
    pub variables: &'a [f64],
}

impl Tangents<'_> {
    /// Slack of a set after a step that has returned to the balls; `None` where the set was not held by a tangent.
    fn slack(&self, set: usize, change: &[f64]) -> Option<f64> {
        self.held.iter().find(|held| held.set == set)?;
        let there: Vec<f64> = (self.variables.iter().zip(change))
            .map(|(v, d)| v + d)
            .collect();
        Some(-self.sets[set].violation(&there))
    }
}

/// Slack over multiplier, in units of the cost's curvature, up to which a subproblem's solution holds a row.
const TIGHT: f64 = 1e-5;

/// A soft row's multiplier this near to its price, relatively, is at it.
const BOUGHT: f64 = 1e-6;

/// The outward normal of a set whose boundary holds the variables, and the distance that is left to it.
#[derive(Clone, Debug, PartialEq)]
pub struct ActiveNormal {
    /// `(variable, component)`: the gradient of what the set limits.
    pub direction: Vec<(usize, f64)>,
    /// What is left to the limit.
    pub gap: f64,
    /// Multiplier over radius of a ball; 0 for a flat set.
    pub curvature: f64,
    /// Which set it is.
    pub set: usize,
    /// Unit vector in the space of the set's own rows: a ball's `M v / |M v|`, of which `direction` is the pull.
    pub outward: Vec<f64>,
}

impl ActiveNormal {
    /// Adds a ball's `curvature (MᵀM - g gᵀ)`, `g = Mᵀn` the direction.
    fn add_curvature(&self, sets: &[ConvexSet], matrix: &mut Mat<f64>) {
        let ConvexSet::Ball { rows, .. } = &sets[self.set] else {
            return;
        };
        let mut add = |direction: &[(usize, f64)], factor: f64| {
            for &(i, a) in direction {
                for &(j, b) in direction {
                    matrix[(i, j)] += factor * a * b;
                }
            }
        };
        for row in rows {
            add(row, self.curvature);
        }
        add(&self.direction, -self.curvature);
    }

    /// The half-space that touches the set where the variables are closest to it.
    #[must_use]
    pub fn tangent(&self, variables: &[f64]) -> ConvexSet {
        ConvexSet::HalfSpace {
            limit: along(&self.direction, variables) + self.gap,
            direction: self.direction.clone(),
        }
    }

    fn of(
        sets: &[ConvexSet],
        variables: &[f64],
        multipliers: &Multipliers,
        unit: f64,
    ) -> Vec<Self> {
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
                        outward: vec![1.0],
                    })
                }
                ConvexSet::HalfSpace { direction, limit } => {
                    let gap = limit - along(direction, variables);
                    (normal[0] / unit > gap).then(|| Self {
                        direction: direction.clone(),
                        gap,
                        curvature: 0.0,
                        set: at,
                        outward: vec![1.0],
                    })
                }
                ConvexSet::Ball { rows, radius } => {
                    let inside: Vec<f64> = rows.iter().map(|row| along(row, variables)).collect();
                    let size = norm(&inside);
                    let pull = norm(normal);
                    let gap = radius - size;
                    (size > 0.0 && *radius > 0.0 && pull / unit > gap).then(|| Self {
                        direction: combination(rows, &inside, 1.0 / size),
                        gap,
                        curvature: pull / radius,
                        set: at,
                        outward: inside.iter().map(|x| x / size).collect(),
                    })
                }
            })
            .collect()
    }
}

/// `factor Mᵀx`, each variable once.
fn combination(rows: &[Vec<(usize, f64)>], x: &[f64], factor: f64) -> Vec<(usize, f64)> {
    let mut sums = std::collections::BTreeMap::new();
    for (row, x) in rows.iter().zip(x) {
        for &(index, component) in row {
            *sums.entry(index).or_insert(0.0) += factor * component * x;
        }
    }
    sums.into_iter().collect()
}

/// Whether every eigenvalue exceeds `floor`.
fn is_positive(matrix: &Mat<f64>, floor: f64) -> bool {
    let n = matrix.nrows();
    let shifted = Mat::from_fn(n, n, |i, j| {
        matrix[(i, j)] - if i == j { floor } else { 0.0 }
    });
    shifted.llt(Side::Lower).is_ok()
}

fn largest_diagonal(m: &Mat<f64>) -> f64 {
    (0..m.nrows()).map(|i| m[(i, i)]).fold(0.0, f64::max)
}
