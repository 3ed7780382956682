//! What a solve may do, and when a point is good enough.

use super::hessian::HessianChoice;
use super::kept_states::QpRoute;

/// What the solver may do.
#[derive(Clone, Debug, PartialEq)]
pub struct SqpSettings {
    /// Largest scaled KKT residual of a converged point.
    pub tolerance: f64,
    /// Iterations, at most.
    pub max_iterations: usize,
    /// Part of the objective that passing a saddle must gain for a step to go out of its way.
    pub saddle_gain: f64,
    /// Which Hessian.
    pub hessian: HessianChoice,
    /// How its subproblems are solved.
    pub qp: QpRoute,
    /// Part of the KKT residual by which a subproblem may violate inequalities that it has not seen; 0 for none, so that every step is
    /// that of all rows. Far from a solution not every one of them is worth a solve.
    pub row_accuracy: f64,
}

/// Part of the objective that is worth passing a saddle for: what the discretization of an ordinary solve is off by.
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
    /// What is left of states' defects and of violations, as parts of the tolerance, for which a point counts as feasible; where states that
    /// were computed leave defects of the size `rounding`.
    pub(super) fn feasibility_tolerance(&self, part: f64, rounding: f64) -> f64 {
        (part * self.tolerance)
            .max(FEASIBILITY_FLOOR)
            .min(STOP_PART * self.tolerance)
            .max(ROUNDING_MARGIN * rounding)
    }
}

/// Rounding of an objective or a merit, relatively.
pub(super) const MERIT_ROUNDING: f64 = 100.0 * f64::EPSILON;
/// Accuracy to which the conditions of a subproblem hold that Newton's method has ended on: rounding.
pub(super) const EXACT: f64 = 1e-12;
/// Violation of rows and sets, over the variables or the row (at least one), that subproblems leave, and no step can tell from none.
pub(super) const ROW_TOLERANCE: f64 = 1e-9;
/// The root of rounding: slacks, multipliers, infeasibilities and independent parts of rows that an interior point cannot tell from zero.
pub(super) const NEGLIGIBLE: f64 = 1e-8;
/// Improvements of a residual, slack or infeasibility to more than this part of what it was are no progress.
pub(super) const PROGRESS: f64 = 0.9;
/// Part of the tolerance at which the loop stops: what is recomputed elsewhere, by other sums, is then within it.
pub(super) const STOP_PART: f64 = 0.5;
/// Defects of the states must be this much better than the tolerance: that costs one more iteration at most, and the replay of the
/// controls shows every digit of them.
pub(super) const DEFECT_PART: f64 = 1e-3;
/// And constraints and inequalities this much.
pub(super) const VIOLATION_PART: f64 = 1e-2;
/// The sum of the defects of a long motion cannot be brought much below this: rounding.
pub(super) const FEASIBILITY_FLOOR: f64 = 5e-10;
/// Nor below what it is for computed states, give or take; stiff equations leave more.
pub(super) const ROUNDING_MARGIN: f64 = 3.0;
