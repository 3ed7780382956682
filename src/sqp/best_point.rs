//! The best point that a solve has seen.

use std::sync::Arc;

use super::kkt::{KktResidual, Multipliers};

/// The best point so far: least infeasible, and among feasible ones the nearest to optimal.
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
    /// A first point, than which every other is better.
    pub(super) fn none(point: Arc<Point>, multipliers: Multipliers, objective: f64) -> Self {
        Self {
            point,
            multipliers,
            residual: UNKNOWN_RESIDUAL,
            objective,
            infeasibility: f64::INFINITY,
        }
    }

    /// Whether it takes the place of another; infeasibilities within `tolerance` count as none.
    pub(super) fn is_no_worse_than(&self, other: &Self, tolerance: f64) -> bool {
        if self.infeasibility.max(other.infeasibility) <= tolerance {
            self.residual.max() <= other.residual.max()
        } else {
            self.infeasibility <= other.infeasibility
        }
    }
}
