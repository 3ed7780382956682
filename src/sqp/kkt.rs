//! The optimality conditions, and the residual of a point in them.

use std::collections::BTreeMap;

use super::program::{
    ConvexSet, Evaluation, LagrangianTerms, LiftedProgram, Linearization, Softness, along,
};
use super::settings::{EXACT, ROW_TOLERANCE};

/// Multipliers of the constraints, the inequalities and the convex sets.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Multipliers {
    /// `y`, one per constraint; Lagrangian `J + yᵀ c + …`.
    pub constraints: Vec<f64>,
    /// `z ≥ 0`, one per inequality; Lagrangian `… + zᵀ h + …`.
    pub inequalities: Vec<f64>,
    /// Per set: an interval has one entry (positive: upper limit), a half-space the factor of its direction, a ball the
    /// vector `w` that pulls on the variables with `Mᵀ w`.
    pub normals: Vec<Vec<f64>>,
}

impl Multipliers {
    /// Returns zero multipliers for the given numbers of constraints and inequalities and for `sets`.
    #[must_use]
    pub fn zeros(n_constraints: usize, n_inequalities: usize, sets: &[ConvexSet]) -> Self {
        Self {
            constraints: vec![0.0; n_constraints],
            inequalities: vec![0.0; n_inequalities],
            normals: sets
                .iter()
                .map(|set| match set {
                    ConvexSet::Interval { .. } | ConvexSet::HalfSpace { .. } => vec![0.0],
                    ConvexSet::Ball { rows, .. } => vec![0.0; rows.len()],
                })
                .collect(),
        }
    }
}

impl Multipliers {
    /// Returns the multipliers with the inequalities of the given rows only, in the order of `rows`.
    pub(super) fn at_rows(&self, rows: &[usize]) -> Self {
        Self {
            inequalities: rows.iter().map(|&row| self.inequalities[row]).collect(),
            ..self.clone()
        }
    }

    /// Returns the largest sum of multipliers that share a slack, which the elastic weight must exceed. A constraint has a slack of its
    /// own, the inequalities of a group share one. `group_of` returns `None` for rows without such a slack.
    pub(super) fn largest_on_slack(&self, group_of: impl Fn(usize) -> Option<usize>) -> f64 {
        let mut groups: BTreeMap<usize, f64> = BTreeMap::new();
        let pushing = self
            .inequalities
            .iter()
            .enumerate()
            .filter(|(_, z)| **z > 0.0);
        for (row, z) in pushing {
            if let Some(group) = group_of(row) {
                *groups.entry(group).or_insert(0.0) += z;
            }
        }
        (self.constraints.iter())
            .chain(groups.values())
            .fold(0.0, |m: f64, y| m.max(y.abs()))
    }

    /// Returns `yᵀc + Σ z h` over the hard rows among the given ones.
    pub(super) fn work<P: LiftedProgram>(
        &self,
        program: &P,
        constraints: &[f64],
        rows: impl Iterator<Item = (usize, f64)>,
    ) -> f64 {
        let held = (constraints.iter().zip(&self.constraints)).map(|(c, y)| c * y);
        let pushed = rows
            .filter(|&(row, _)| {
                self.inequalities[row] != 0.0 && program.softness(row) == Softness::Hard
            })
            .map(|(row, h)| self.inequalities[row] * h);
        held.chain(pushed).sum()
    }
}

impl Multipliers {
    /// Returns the change of the objective that rows account for if a subproblem meets them to its accuracy only, [`EXACT`].
    pub(super) fn row_noise(&self) -> f64 {
        let pulls = self.constraints.iter().map(|y| y.abs());
        EXACT * (pulls.sum::<f64>() + self.inequalities.iter().sum::<f64>())
    }
}

/// Scaled residuals of the Karush-Kuhn-Tucker conditions.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct KktResidual {
    /// `|∇J_v + (∇J_q + Jᵀy + Dᵀz) + Σ pulls of the sets|_∞`, relative to the largest entry of its terms, as bracketed, along the variables
    /// that are [controls](LiftedProgram::n_controls). The terms are the cost of the variables themselves
    /// ([`own_gradient`](LiftedProgram::own_gradient), or all of `∇J` if the program does not separate it), the rest through the states,
    /// and the pull of every set. The check in [`verify`](crate::verify) uses the same terms, so that neither test is stricter than the
    /// other.
    pub stationarity: f64,
    /// Largest of the scaled constraints, the violated hard inequalities, the state defect, and the violation of the sets.
    pub feasibility: f64,
    /// Largest product of a slack and its multiplier, relative like the stationarity; it covers wrong signs as well. A soft row of
    /// violation `t` has two pairs: `z` with `max(-h, 0)`, and `linear + quadratic t - z` with `t`.
    pub complementarity: f64,
}

/// Size, in units of the [least curvature](Linearization::least_curvature), below which the terms of the gradient count as vanished. With
/// the default tolerance of 1e-6, variables that are off by 1e-12 of their unit then still pass, and rounding of vanishing terms does not
/// fail the test. The check in [`verify`](crate::verify) has the same number.
const NO_TERM: f64 = 1e-6;

/// Sums of the terms of `∇L`, and the largest term.
struct Sum {
    gradient: Vec<f64>,
    largest: f64,
    n_controls: usize,
}

impl Sum {
    fn add(&mut self, index: usize, term: f64) {
        if index < self.n_controls {
            self.largest = self.largest.max(term.abs());
        }
        self.gradient[index] += term;
    }
}

impl KktResidual {
    /// Returns the larger of stationarity and complementarity; NaN if either is.
    #[must_use]
    pub fn optimality(&self) -> f64 {
        Self {
            feasibility: 0.0,
            ..*self
        }
        .max()
    }

    /// Returns the largest of the three residuals; NaN if any is.
    #[must_use]
    pub fn max(&self) -> f64 {
        // f64::max drops NaN, and a NaN must not pass for small.
        if self.stationarity.is_nan() || self.feasibility.is_nan() || self.complementarity.is_nan()
        {
            return f64::NAN;
        }
        self.stationarity
            .max(self.feasibility)
            .max(self.complementarity)
    }

    /// Computes the residuals at a point. Inequalities with a multiplier must be among the linearized rows.
    #[must_use]
    pub fn of<P: LiftedProgram>(
        program: &P,
        point: &P::Point,
        evaluation: &Evaluation<P::Defects>,
        linearization: &Linearization,
        multipliers: &Multipliers,
    ) -> Self {
        let terms = linearization.lagrangian_terms(program.own_gradient(point), multipliers);
        let unit = linearization.least_curvature();
        Self::of_terms(program, point, evaluation, &terms, unit, multipliers)
    }

    /// Computes the residuals at a point from the gradient of its Lagrangian; `least_curvature` replaces that of the terms if they have
    /// none.
    pub(super) fn of_terms<P: LiftedProgram>(
        program: &P,
        point: &P::Point,
        evaluation: &Evaluation<P::Defects>,
        terms: &LagrangianTerms<P::Costates>,
        least_curvature: f64,
        multipliers: &Multipliers,
    ) -> Self {
        let variables = program.variables(point);
        let n_controls = program.n_controls().min(variables.len());
        let mut sum = Sum {
            gradient: terms.own.clone(),
            largest: infinity_norm(&terms.own[..n_controls]),
            n_controls,
        };
        // Rows with nearly parallel gradients, or rows and costs of the states, may have large opposite multipliers. They are therefore one
        // term.
        for (j, term) in terms.through_states.iter().enumerate() {
            sum.add(j, *term);
        }
        let mut feasibility = infinity_norm(&evaluation.constraints).max(evaluation.defect);
        let mut complementarity: f64 = 0.0;
        for (row, (&h, &z)) in (evaluation.inequalities.iter())
            .zip(&multipliers.inequalities)
            .enumerate()
        {
            let softness = program.softness(row);
            if softness == Softness::Hard {
                feasibility = feasibility.max(h);
            }
            complementarity = complementarity.max(row_complementarity(h, z, softness));
        }
        for (set, normal) in program.sets().iter().zip(&multipliers.normals) {
            feasibility = feasibility.max(set.violation(variables));
            complementarity =
                complementarity.max(set_complementarity(set, normal, variables, &mut sum));
        }
        // A problem whose terms all vanish (already at its optimum) is judged against variables of one unit instead.
        let unit = NO_TERM * terms.least_curvature.unwrap_or(least_curvature);
        let scale = sum.largest.max(unit).max(f64::MIN_POSITIVE);
        Self {
            stationarity: infinity_norm(&sum.gradient) / scale,
            feasibility,
            complementarity: complementarity / scale,
        }
    }
}

/// Returns the largest product of slack and multiplier of one inequality, or a multiplier of wrong sign if that is larger.
fn row_complementarity(h: f64, z: f64, softness: Softness) -> f64 {
    match softness {
        Softness::Hard => (z * h).abs().max(-z),
        Softness::Soft { linear, quadratic } => {
            let t = h.max(0.0);
            let left = linear + quadratic * t - z;
            let products = (z * h.min(0.0)).abs().max((left * t).abs());
            products.max(-z).max(-left)
        }
    }
}

/// Returns the product of a set's slack and its normal, and adds the set's pull to `sum`.
fn set_complementarity(set: &ConvexSet, normal: &[f64], variables: &[f64], sum: &mut Sum) -> f64 {
    match set {
        ConvexSet::Interval {
            index,
            lower,
            upper,
        } => {
            let (v, z) = (variables[*index], normal[0]);
            sum.add(*index, z);
            // A positive normal belongs to the upper limit, a negative one to the lower.
            let slack = if z >= 0.0 { upper - v } else { v - lower };
            (z * slack).abs()
        }
        ConvexSet::HalfSpace { direction, .. } => {
            let z = normal[0];
            for &(index, component) in direction {
                sum.add(index, z * component);
            }
            // A normal must point outward; the size of a negative one counts as violation.
            (z * set.violation(variables)).abs().max(-z)
        }
        ConvexSet::Ball { rows, radius } => {
            // Only the component along Mv is a normal of the ball. The rest is left to the stationarity: the product of slack and normal
            // sees only its square.
            let inside: Vec<f64> = rows.iter().map(|row| along(row, variables)).collect();
            let size = norm(&inside);
            let inner: f64 = normal.iter().zip(&inside).map(|(z, u)| z * u).sum();
            // A shorter vector is rounding of the variables and has no direction.
            let has_direction = size > ROW_TOLERANCE * infinity_norm(variables).max(1.0);
            let outward = inner / size;
            for ((row, z), u) in rows.iter().zip(normal).zip(&inside) {
                let pull = if has_direction {
                    outward.max(0.0) * u / size
                } else {
                    *z
                };
                for &(index, component) in row {
                    sum.add(index, pull * component);
                }
            }
            if has_direction {
                (outward * (radius - size)).abs().max(-outward)
            } else {
                (norm(normal) * radius - inner).abs()
            }
        }
    }
}

/// `a - b`
pub(super) fn difference(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

/// Euclidean norm.
pub(crate) fn norm(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Returns the largest absolute value; NaN if any entry is NaN.
pub(crate) fn infinity_norm(v: &[f64]) -> f64 {
    v.iter().fold(0.0, |m: f64, x| {
        if x.is_nan() || m.is_nan() {
            f64::NAN
        } else {
            m.max(x.abs())
        }
    })
}
