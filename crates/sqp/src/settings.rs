//! Settings of a solve, and the tolerances of its stopping test.

use super::kept_states::QpRoute;

/// Second derivatives in the quadratic model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "Hessian"))]
#[serde(rename_all = "kebab-case")]
pub enum HessianChoice {
    /// Gauss-Newton while the linearized constraints cannot be met, exact afterwards, with the multipliers of the last subproblem; Gauss-Newton
    /// throughout where second derivatives are not all known, as with friction of tendons.
    #[default]
    Auto,
    /// Second derivatives of the objective alone, without those of its residuals.
    GaussNewton,
    /// Second derivatives of the Lagrangian.
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

/// Settings of a solve. In a scene, the keys of `[solver]` set all of them but the accuracy of rows.
#[derive(Clone, Debug, PartialEq)]
pub struct SqpSettings {
    /// Largest scaled KKT residual of a converged point.
    pub tolerance: f64,
    /// Maximum number of iterations.
    pub max_iterations: usize,
    /// A step is lengthened past a saddle if that is expected to lower the objective by this fraction; the key `solver.saddle_gain`.
    pub saddle_gain: f64,
    /// Hessian of the subproblems.
    pub hessian: HessianChoice,
    /// Form of the subproblems.
    pub qp: QpRoute,
    /// Fraction of the KKT residual by which a subproblem may violate inequalities outside its working set; 0 if every step must meet all
    /// rows. Far from a solution, not every violated row is worth another solve. The default adds a hundredth to the violation that the
    /// step leaves anyway; the result does not depend on it, because the tolerance falls with the residual.
    pub row_accuracy: f64,
}

/// Default of `saddle_gain`: about the error of the objective that the discretization of an ordinary solve makes.
pub const SADDLE_GAIN: f64 = 1e-2;

impl Default for SqpSettings {
    fn default() -> Self {
        Self {
            tolerance: 1e-6,
            max_iterations: 600,
            saddle_gain: SADDLE_GAIN,
            hessian: HessianChoice::Auto,
            qp: QpRoute::Condensed,
            row_accuracy: 1e-2,
        }
    }
}

impl SqpSettings {
    /// Returns the feasibility tolerance on defects or violations: the given fraction of `tolerance`, but not below what rounding leaves;
    /// `rounding` is the size of the defects that a rollout leaves.
    pub(super) fn feasibility_tolerance(&self, part: f64, rounding: f64) -> f64 {
        (part * self.tolerance)
            .max(FEASIBILITY_FLOOR)
            .min(STOP_PART * self.tolerance)
            .max(ROUNDING_MARGIN * rounding)
    }
}

/// Violation of one unit of the scaled rows, as a length of the arm. A point that is farther off than this tells nothing about the
/// solution: neither its multipliers nor the linear prediction of its states.
pub(super) const SCALED_UNIT: f64 = 1.0;
/// Relative rounding of an objective or a merit, which are sums over nodes and times. The rounding of a sum of `N` positive terms grows as
/// `√N` times the machine precision if the single roundings are independent (Higham 2002, chapter 4); `N` is 1e4 here.
pub(super) const MERIT_ROUNDING: f64 = 100.0 * f64::EPSILON;
/// Relative residual at which Newton's method on the conditions of a subproblem has ended: the bound `N ε` on the rounding of a sum of
/// `N` terms (Higham 2002, chapter 4) for the largest subproblems, whose rows have some thousand terms.
pub(super) const EXACT: f64 = 1e-12;
/// Violation of rows and sets that subproblems leave, relative to the variables or the row (at least one). It lies between the tolerance
/// of Clarabel, 1e-11, and that to which the solver meets constraints, [`VIOLATION_PART`] of 1e-6.
pub(super) const ROW_TOLERANCE: f64 = 1e-9;
/// About the square root of the machine precision: slacks, multipliers, infeasibilities and independent fractions of rows below it cannot
/// be told from zero by an interior point.
pub(super) const NEGLIGIBLE: f64 = 1e-8;
/// A residual, slack or infeasibility that keeps more than this fraction of its value makes no progress: Ipopt's
/// `required_infeasibility_reduction`.
pub(super) const PROGRESS: f64 = 0.9;
/// The loop stops at this fraction of the tolerance, so that values recomputed elsewhere, by sums in another order, are within the
/// tolerance. Rounding alone would need far less; the other half is for the derivatives of the check, which are not those of the solver.
pub(super) const STOP_PART: f64 = 0.5;
/// The states' defects must be below this fraction of the tolerance. A replay of the controls shows every digit of the defects. Since a
/// Newton step squares the error, which is already below the tolerance, this costs at most one more iteration.
pub(super) const DEFECT_PART: f64 = 1e-3;
/// Constraints must be met to this fraction of the tolerance, at the same price as the [defects](DEFECT_PART). A goal is then met to 1e-8
/// of the arm's length by default.
pub(super) const VIOLATION_PART: f64 = 1e-2;
/// Lower limit of the feasibility tolerance, for tolerances below the default: the bound `N ε` on the rounding of a sum of `N` terms
/// (Higham 2002, chapter 4) for the defects of a long motion, 2e6 components.
pub(super) const FEASIBILITY_FLOOR: f64 = 5e-10;
/// Lower limit of the feasibility tolerance, as a multiple of the defects that a rollout leaves: stiff equations leave larger ones, which
/// vary by a small factor from one rollout to the next.
pub(super) const ROUNDING_MARGIN: f64 = 3.0;
