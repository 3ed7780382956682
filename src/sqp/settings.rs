//! Settings of a solve, and the tolerances of its stopping test.

use super::hessian::HessianChoice;
use super::kept_states::QpRoute;

/// Settings of a solve.
#[derive(Clone, Debug, PartialEq)]
pub struct SqpSettings {
    /// Largest scaled KKT residual of a converged point.
    pub tolerance: f64,
    /// Maximum number of iterations.
    pub max_iterations: usize,
    /// A step is lengthened past a saddle if that is expected to lower the objective by this fraction.
    pub saddle_gain: f64,
    /// Hessian of the subproblems.
    pub hessian: HessianChoice,
    /// Form of the subproblems.
    pub qp: QpRoute,
    /// Fraction of the KKT residual by which a subproblem may violate inequalities outside its working set; 0 if every step must meet all
    /// rows. Far from a solution, not every violated row is worth another solve.
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

/// Relative rounding of an objective or a merit, which are sums over many nodes and times: 100 units in the last place.
pub(super) const MERIT_ROUNDING: f64 = 100.0 * f64::EPSILON;
/// Relative residual at which Newton's method on the conditions of a subproblem has ended: rounding.
pub(super) const EXACT: f64 = 1e-12;
/// Violation of rows and sets that subproblems leave, relative to the variables or the row (at least one).
pub(super) const ROW_TOLERANCE: f64 = 1e-9;
/// About the square root of the machine precision: slacks, multipliers, infeasibilities and independent fractions of rows below it cannot
/// be told from zero by an interior point.
pub(super) const NEGLIGIBLE: f64 = 1e-8;
/// A residual, slack or infeasibility that keeps more than this fraction of its value makes no progress.
pub(super) const PROGRESS: f64 = 0.9;
/// The loop stops at this fraction of the tolerance, so that values recomputed elsewhere, by sums in another order, are within the
/// tolerance.
pub(super) const STOP_PART: f64 = 0.5;
/// The states' defects must be below this fraction of the tolerance. This costs at most one more iteration, and a replay of the controls
/// shows every digit of the defects.
pub(super) const DEFECT_PART: f64 = 1e-3;
/// Constraints must be met to this fraction of the tolerance.
pub(super) const VIOLATION_PART: f64 = 1e-2;
/// Lower limit of the feasibility tolerance: rounding of the sum of the defects of a long motion.
pub(super) const FEASIBILITY_FLOOR: f64 = 5e-10;
/// Lower limit of the feasibility tolerance, as a multiple of the defects that a rollout leaves; stiff equations leave larger ones.
pub(super) const ROUNDING_MARGIN: f64 = 3.0;
