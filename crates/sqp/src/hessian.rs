//! The Hessian of the quadratic subproblem: the Gauss-Newton one, or the exact one with its negative curvature removed.

use faer::linalg::solvers::Solve as _;
use faer::{Mat, Side};

use super::norms::norm;
use super::program::{
    ConvexSet, Failure, LiftedProgram, Linearization, LinearizationRequest, Multipliers, Softness,
    along,
};
use super::settings::{EXACT, NEGLIGIBLE};

/// Hessian of a subproblem.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum HessianKind {
    /// Gauss-Newton.
    #[default]
    GaussNewton,
    /// Exact Hessian, which is positive definite on the directions that constraints and active sets leave free.
    Exact,
    /// Exact Hessian with its negative eigenvalues on those directions replaced by small positive ones.
    Convexified,
    /// No second derivatives but a proximal term: restoration of feasibility.
    Proximal,
}

impl HessianKind {
    /// Tells whether the matrix has the second derivative of the Lagrangian, so that steps near a solution contract by themselves.
    #[must_use]
    pub fn is_second_order(self) -> bool {
        matches!(self, Self::Exact | Self::Convexified)
    }
}

/// A positive semidefinite Hessian and the matching gradient.
#[derive(Clone, Debug)]
pub struct ModelHessian {
    /// `H`
    pub matrix: Mat<f64>,
    /// Gradient of the model; it differs from that of the linearization by a term that vanishes on the constraints.
    pub gradient: Vec<f64>,
    /// Origin of the matrix.
    pub kind: HessianKind,
    /// Balls whose own curvature is in `matrix`; the subproblem must replace them by their tangents.
    pub tangents: Vec<ActiveNormal>,
    /// Value of the model at a zero step, contributed by the terms for active conditions.
    pub constant: f64,
    /// Direction of the most negative curvature, if it makes the point a saddle.
    pub descent: Option<NegativeCurvature>,
    /// The terms of `matrix` and `gradient` for active conditions, which are correct only if the step keeps those active.
    pub held: Option<HeldTerms>,
}

/// A unit direction along which active conditions stay active to first order and the Lagrangian has negative curvature.
#[derive(Clone, Debug, PartialEq)]
pub struct NegativeCurvature {
    /// Unit vector of the variables.
    pub direction: Vec<f64>,
    /// Second derivative along it, negative.
    pub value: f64,
}

/// Eigenvalues below this fraction of the least positive Gauss-Newton diagonal entry count as negative curvature. It is a choice that
/// bounds the condition of the reduced Hessian by as much as the cost's own, times 1e4 (decision 68).
const CURVATURE_FLOOR: f64 = 1e-4;
/// A stationary point is a saddle if it has negative curvature beyond this fraction of that entry: the factor 100 keeps it apart from
/// curvature that is [as good as none](CURVATURE_FLOOR) (decision 68).
const SADDLE_CURVATURE: f64 = 1e-2;
/// Fraction of its size with which a negative eigenvalue is left as a positive one. All of it would make a step as short as the gradient is
/// small beside the curvature, however good the model is; much less makes `σ`, which grows with the inverse, hide the rest. It is a choice:
/// a third and three times the value take other scenes fewer iterations (decision 26).
const KEPT_CURVATURE: f64 = 0.1;

impl ModelHessian {
    /// Returns the Gauss-Newton model of a linearization.
    #[must_use]
    pub fn gauss_newton(linearization: &Linearization) -> Self {
        Self {
            matrix: linearization.gauss_newton.clone(),
            gradient: linearization.model_gradient.clone(),
            kind: HessianKind::GaussNewton,
            tangents: Vec::new(),
            constant: 0.0,
            descent: None,
            held: None,
        }
    }

    /// Returns a model with the given matrix and no objective.
    pub(super) fn proximal(matrix: Mat<f64>) -> Self {
        Self {
            gradient: vec![0.0; matrix.nrows()],
            matrix,
            kind: HessianKind::Proximal,
            tangents: Vec::new(),
            constant: 0.0,
            descent: None,
            held: None,
        }
    }

    /// Returns the exact Hessian `H = GN + curvature`, convexified. Directions are split by the gradients of constraints and active
    /// inequalities and the normals of the active sets. On the directions that these leave free, negative eigenvalues are replaced by a small
    /// part of their absolute values, so that the trust region alone limits steps along them. On the others `½ σ |Yᵀδ - t|²` is added, where
    /// `t` is the value that `Yᵀδ` has if all conditions hold with equality; it vanishes there and so changes neither the step nor the
    /// multipliers, but for the curvature of the sets themselves.
    ///
    /// An active ball adds to the Lagrangian's curvature across its normal, by its multiplier divided by its radius. Where only this term
    /// makes the Hessian positive, it goes into the matrix, and the subproblem replaces the ball by its tangent: otherwise the
    /// convexification would slow the convergence down for nothing.
    ///
    /// A positive definite Hessian is returned as it is; a linearization without curvature gives Gauss-Newton.
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

    /// Returns the convexified model with the curvature of the active balls; `None` without active balls or if a factorization fails.
    fn bent(
        mut full: Mat<f64>,
        linearization: &Linearization,
        sets: &[ConvexSet],
        active: &ActiveSet,
    ) -> Option<Self> {
        // A larger curvature would drown the deciding one in its rounding.
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
        let mut held = HeldTerms::of(linearization, active);
        let (range, target) = (&held.basis, &held.target);
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
            let cross = null.transpose() * &full * range;
            let inverse = reduced.llt(Side::Lower).ok()?;
            cross_terms = cross.transpose() * inverse.solve(&cross);
        } else if n > m {
            let eigen = reduced.self_adjoint_eigen(Side::Lower).ok()?;
            let values: Vec<f64> = (0..n - m).map(|i| eigen.S()[i]).collect();
            if !values.iter().all(|v| v.is_finite()) {
                return None;
            }
            let turned: Vec<f64> = (values.iter())
                .map(|&v| f64::max(if v < 0.0 { -KEPT_CURVATURE * v } else { v }, floor))
                .collect();
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
            let cross = vectors.transpose() * &full * range;
            let weighted = Mat::from_fn(n - m, m, |i, j| cross[(i, j)] / turned[i]);
            cross_terms = cross.transpose() * &weighted;
        }
        if m > 0 {
            // The Schur complement of the directions of active conditions, which `σ` must exceed.
            let schur = cross_terms - range.transpose() * &full * range;
            let worst = schur
                .self_adjoint_eigen(Side::Lower)
                .ok()
                .map(|e| (0..m).map(|i| e.S()[i]).fold(0.0, f64::max))?;
            // Twice the least value, so that the model is as convex along these directions as it would be concave without.
            let sigma = 2.0 * worst + unit;
            if !sigma.is_finite() || !target.iter().all(|t| t.is_finite()) {
                return None;
            }
            matrix += (range * range.transpose()) * faer::Scale(sigma);
            constant = 0.5 * sigma * target.iter().map(|t| t * t).sum::<f64>();
            for (i, g) in gradient.iter_mut().enumerate() {
                *g -= sigma * (0..m).map(|j| range[(i, j)] * target[j]).sum::<f64>();
            }
            held.sigma = sigma;
        }
        Some(Self {
            matrix,
            gradient,
            kind,
            tangents: Vec::new(),
            constant,
            descent,
            held: (m > 0).then_some(held),
        })
    }
}

/// Tells whether the Hessian of the Lagrangian at a solution is positive on the directions that constraints, and inequalities and sets with
/// a multiplier, leave free: the second-order sufficient condition (Nocedal and Wright 2006, theorem 12.6), by the solver's own
/// derivatives. `false` does not prove the contrary.
///
/// # Errors
/// Returns [`Failure`] if the program cannot be evaluated or linearized there.
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

/// A condition that the terms of a model's Hessian hold.
#[derive(Clone, Debug, PartialEq)]
pub enum Condition {
    /// A constraint, by its index.
    Constraint(usize),
    /// A linearized inequality, by its place in the linearization.
    Row(usize),
    /// The normal of a set.
    Normal {
        /// Index of the set.
        set: usize,
        /// Multiplier of the set whose pull on the variables is one unit along the held direction.
        outward: Vec<f64>,
    },
}

/// The part of a condition's multiplier that the terms for active conditions stand for.
#[derive(Clone, Debug, PartialEq)]
pub struct HeldMultiplier {
    /// The condition.
    pub condition: Condition,
    /// Multiplier that the terms add to its own.
    pub multiplier: f64,
    /// The part of it that comes from the condition's own direction: it is negative if the step leaves slack.
    pub own: f64,
    /// Bound on what rounding contributes to `own`.
    pub noise: f64,
}

/// The terms `½ σ |Yᵀδ - t|²` of active conditions: an orthonormal basis `Y` of the directions that these fix, and the length `t` of the
/// step along each. A gradient that depends on those before it adds no direction.
#[derive(Clone, Debug)]
pub struct HeldTerms {
    basis: Mat<f64>,
    target: Vec<f64>,
    /// `σ`; 0 until the terms are known to be needed.
    sigma: f64,
    /// The conditions of the directions.
    conditions: Vec<Condition>,
    /// `C`, upper triangular, with `Y = A C`, where the columns of `A` are the gradients of the conditions.
    combination: Mat<f64>,
}

/// Fraction of a row's gradient that must be independent of the other rows. Neighboring inequalities have nearly parallel gradients; only
/// the row with the larger multiplier is kept then, because dividing the violation of the other by a small remainder would magnify it, by
/// the inverse of this number at most. It is a choice (decision 68).
const INDEPENDENT_PART_OF_ROWS: f64 = 1e-2;
/// A nearly dependent row is kept as well if its independent fraction exceeds [`LEAST_PART`] and its magnified target stays below this, as
/// near a solution: at an optimum where two neighbors are active, the curvature between them need not be positive. It is a choice
/// (decision 68).
const NEAR_TARGET: f64 = 1e-3;
/// Least independent fraction of a row that is kept: two passes of Gram and Schmidt leave `ε` of a row, so that the direction of the rest
/// is accurate to `ε` over this number, 2e-11.
const LEAST_PART: f64 = 1e-5;

impl HeldTerms {
    fn of(linearization: &Linearization, active: &ActiveSet) -> Self {
        let n = linearization.gradient.len();
        let mut held = Vec::new();
        for (i, offset) in linearization.offset.iter().enumerate() {
            let row = (0..n).map(|j| linearization.jacobian[(i, j)]).collect();
            let condition = Condition::Constraint(i);
            hold(&mut held, condition, row, -offset, NEGLIGIBLE);
        }
        for &at in &active.rows {
            let jacobian = &linearization.inequality_jacobian;
            let row = (0..n).map(|j| jacobian[(at, j)]).collect();
            let target = -linearization.inequality_offset[at];
            let condition = Condition::Row(at);
            hold(&mut held, condition, row, target, INDEPENDENT_PART_OF_ROWS);
        }
        for normal in &active.normals {
            let mut row = vec![0.0; n];
            for &(index, component) in &normal.direction {
                row[index] += component;
            }
            let condition = Condition::Normal {
                set: normal.set,
                outward: normal.outward.clone(),
            };
            hold(&mut held, condition, row, normal.gap, NEGLIGIBLE);
        }
        let m = held.len();
        Self {
            basis: Mat::from_fn(n, m, |i, j| held[j].unit[i]),
            combination: Mat::from_fn(m, m, |i, j| {
                held[j].combination.get(i).copied().unwrap_or(0.0)
            }),
            target: held.iter().map(|direction| direction.target).collect(),
            conditions: held.into_iter().map(|held| held.condition).collect(),
            sigma: 0.0,
        }
    }

    /// Returns the multipliers `C σ (Yᵀδ - t)` that the terms stand for at a step `δ` of the subproblem. Its optimality conditions have the
    /// pull `σ Y (Yᵀδ - t) = A C σ (Yᵀδ - t)` of the terms. Added to the multipliers of the subproblem, these are the multipliers of the
    /// same step without the terms, as for an augmented Lagrangian (Nocedal and Wright 2006, equation 17.39). They vanish where the step
    /// meets all conditions with equality.
    #[must_use]
    pub fn pulls(&self, change: &[f64]) -> Vec<HeldMultiplier> {
        let m = self.target.len();
        let size = norm(change);
        let (mut forces, mut noises) = (vec![0.0; m], vec![0.0; m]);
        for j in 0..m {
            let along: f64 = (change.iter().enumerate())
                .map(|(i, d)| self.basis[(i, j)] * d)
                .sum();
            forces[j] = self.sigma * (along - self.target[j]);
            noises[j] = self.sigma * EXACT * (size + self.target[j].abs());
        }
        (self.conditions.iter().enumerate())
            .map(|(i, condition)| HeldMultiplier {
                condition: condition.clone(),
                multiplier: (0..m).map(|j| self.combination[(i, j)] * forces[j]).sum(),
                own: self.combination[(i, i)] * forces[i],
                noise: self.combination[(i, i)] * noises[i],
            })
            .collect()
    }
}

/// A direction that a condition fixes, orthogonal to those before it.
struct HeldDirection {
    condition: Condition,
    unit: Vec<f64>,
    /// Length of the step along it.
    target: f64,
    /// Coefficients by which the gradients of the conditions up to this one add up to `unit`.
    combination: Vec<f64>,
}

/// Adds `row · δ = target` by two passes of Gram and Schmidt.
fn hold(
    held: &mut Vec<HeldDirection>,
    condition: Condition,
    mut row: Vec<f64>,
    mut target: f64,
    independent_part: f64,
) {
    let size = norm(&row);
    if held.len() == row.len() {
        return;
    }
    let mut combination = vec![0.0; held.len()];
    combination.push(1.0);
    for _ in 0..2 {
        for before in held.iter() {
            let along: f64 = before.unit.iter().zip(&row).map(|(d, r)| d * r).sum();
            for (r, d) in row.iter_mut().zip(&before.unit) {
                *r -= along * d;
            }
            for (own, of_before) in combination.iter_mut().zip(&before.combination) {
                *own -= along * of_before;
            }
            target -= along * before.target;
        }
    }
    let left = norm(&row);
    let holds_its_own = left > LEAST_PART * size && target.abs() <= NEAR_TARGET * left;
    if left > independent_part * size || holds_its_own {
        held.push(HeldDirection {
            condition,
            unit: row.iter().map(|r| r / left).collect(),
            target: target / left,
            combination: combination.iter().map(|c| c / left).collect(),
        });
    }
}

/// Active conditions besides the constraints.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ActiveSet {
    /// Active linearized inequalities, by their place in the linearization, the largest multiplier first.
    pub rows: Vec<usize>,
    /// Normals of the active convex sets.
    pub normals: Vec<ActiveNormal>,
}

impl ActiveSet {
    /// Collects the rows and sets whose multiplier, divided by the cost's least curvature, exceeds their slack. A soft row whose multiplier
    /// has reached its price is not active. `softness` belongs to the linearized rows.
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

    /// Returns the active rows and sets that a step leaves: their slack after the step exceeds [`TIGHT`] times their multiplier, divided by
    /// the cost's least curvature. For a ball that was replaced by its tangent, the slack is that of the step after its return to the ball:
    /// measured by the normal, even an active ball would have a slack of the order of the square of the step, `|δ|²/2r`.
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

/// Balls that a subproblem replaced by their tangents, and the variables at which its step begins.
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
    /// Returns the slack of a set after a step that has returned to the balls; `None` if no tangent replaced the set.
    fn slack(&self, set: usize, change: &[f64]) -> Option<f64> {
        self.held.iter().find(|held| held.set == set)?;
        let there: Vec<f64> = (self.variables.iter().zip(change))
            .map(|(v, d)| v + d)
            .collect();
        Some(-self.sets[set].violation(&there))
    }
}

/// A row is still active after a subproblem up to this ratio of slack to multiplier, in units of the cost's curvature. An interior point
/// ends with products of slack `s` and multiplier `z` of 1e-11, that is with a ratio `s/z` of `1e-11/z²`: a row that is active passes if
/// its multiplier is above 1e-3 units. The iterations of `reach-3d` depend on it (decision 68).
const TIGHT: f64 = 1e-5;

/// Relative distance to its price up to which the multiplier of a soft row counts as having reached it. An interior point leaves 1e-11 over
/// the violation: a row that is violated by more than 1e-5 counts.
const BOUGHT: f64 = 1e-6;

/// The outward normal of a set on whose boundary the variables are, and the distance to that boundary.
#[derive(Clone, Debug, PartialEq)]
pub struct ActiveNormal {
    /// `(variable, component)`: the gradient of the limited quantity.
    pub direction: Vec<(usize, f64)>,
    /// Distance to the limit.
    pub gap: f64,
    /// Multiplier divided by the radius of a ball; 0 for a flat set.
    pub curvature: f64,
    /// Index of the set.
    pub set: usize,
    /// Multiplier of the set whose pull on the variables is `direction`: `M v / |M v|` of a ball, the sign of the limit of an interval.
    pub outward: Vec<f64>,
}

impl ActiveNormal {
    /// Adds a ball's `curvature (MᵀM - g gᵀ)` to `matrix`, where `g = Mᵀn` is the direction.
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

    /// Returns the half-space that touches the set where the variables are closest to it.
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
                        outward: vec![sign],
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

/// Returns `factor Mᵀx` with one entry per variable.
fn combination(rows: &[Vec<(usize, f64)>], x: &[f64], factor: f64) -> Vec<(usize, f64)> {
    let mut sums = std::collections::BTreeMap::new();
    for (row, x) in rows.iter().zip(x) {
        for &(index, component) in row {
            *sums.entry(index).or_insert(0.0) += factor * component * x;
        }
    }
    sums.into_iter().collect()
}

/// Tells whether every eigenvalue exceeds `floor`.
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
