//! The best point that a solve has visited.

use std::sync::Arc;

use super::kkt::KktResidual;
use super::program::Multipliers;

/// The best point so far: the one of least infeasibility, and among feasible ones the one with the smallest KKT residual.
#[derive(Clone)]
pub(super) struct Best<Point> {
    pub(super) point: Arc<Point>,
    pub(super) multipliers: Multipliers,
    pub(super) residual: KktResidual,
    pub(super) objective: f64,
    pub(super) infeasibility: f64,
}

const UNKNOWN_RESIDUAL: KktResidual = KktResidual {
    stationarity: f64::INFINITY,
    feasibility: f64::INFINITY,
    complementarity: f64::INFINITY,
};

impl<Point> Best<Point> {
    /// Returns a placeholder of infinite infeasibility, which every visited point replaces.
    pub(super) fn none(point: Arc<Point>, multipliers: Multipliers, objective: f64) -> Self {
        Self {
            point,
            multipliers,
            residual: UNKNOWN_RESIDUAL,
            objective,
            infeasibility: f64::INFINITY,
        }
    }

    /// Tells whether this point may replace `other`. Infeasibilities up to `tolerance` count as zero.
    pub(super) fn is_no_worse_than(&self, other: &Self, tolerance: f64) -> bool {
        if self.infeasibility.max(other.infeasibility) <= tolerance {
            self.residual.max() <= other.residual.max()
        } else {
            self.infeasibility <= other.infeasibility
        }
    }
}
