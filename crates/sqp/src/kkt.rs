//! The optimality conditions, and the residual of a point in them.

use super::norms::{infinity_norm, norm};
use super::program::{
    ConvexSet, Evaluation, LagrangianTerms, LiftedProgram, Linearization, Multipliers, Softness,
    along,
};
use super::settings::ROW_TOLERANCE;

/// Scaled residuals of the Karush-Kuhn-Tucker conditions.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct KktResidual {
    /// `|∇J_v + (∇J_q + Jᵀy + Dᵀz) + Σ pulls of the sets|_∞`, relative to the largest entry of its terms, as bracketed, along the variables
    /// that are [controls](LiftedProgram::n_controls). The terms are the cost of the variables themselves
    /// ([`own_gradient`](LiftedProgram::own_gradient), or all of `∇J` if the program does not separate it), the rest through the states,
    /// and the pull of every set. The check in `verify` uses the same terms, so that neither test is stricter than the
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
/// fail the test. The check in `verify` has the same number.
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
