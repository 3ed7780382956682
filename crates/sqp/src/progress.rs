//! Tells whether residuals were still decreasing when a solve stopped.

use super::hessian::HessianKind;
use super::outcome::{IterationRecord, Leave};
use super::quadratic_program::INSIDE;
use super::settings::{NEGLIGIBLE, PROGRESS};

/// Cap on the number of iterations that are compared with those before them.
const WINDOW: usize = 10;

/// Trend of the residuals when a solve stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Trend {
    /// Over the last iterations, the infeasibility or the KKT residual of the best point fell by a tenth or more.
    Falling,
    /// Both residuals fell by less than a tenth.
    Stalled,
}

/// The last iterations of a solve: the best point before them and the best point after them.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Progress {
    /// Trend of the residuals.
    pub trend: Trend,
    /// Number of iterations that are compared with those before them.
    pub iterations: usize,
    /// Least infeasibility before and after them.
    pub infeasibility: [f64; 2],
    /// Least KKT residual before and after them.
    pub residual: [f64; 2],
}

impl Progress {
    /// Compares the last iterations of a history with those before; `None` if the history has no step.
    #[must_use]
    pub fn of(history: &[IterationRecord]) -> Option<Self> {
        let iterations = history.len().checked_sub(1)?.min(WINDOW);
        if iterations == 0 {
            return None;
        }
        let before = history.len() - iterations;
        let least = |value: fn(&IterationRecord) -> f64| {
            let of =
                |rows: &[IterationRecord]| rows.iter().map(value).fold(f64::INFINITY, f64::min);
            [of(&history[..before]), of(history)]
        };
        let infeasibility = least(|row| row.infeasibility);
        let residual = least(|row| row.residual().max());
        let falls = |[from, to]: [f64; 2]| to < PROGRESS * from;
        Some(Self {
            trend: if falls(infeasibility) || falls(residual) {
                Trend::Falling
            } else {
                Trend::Stalled
            },
            iterations,
            infeasibility,
            residual,
        })
    }

    /// Describes the trend in words.
    #[must_use]
    pub fn sentence(&self) -> String {
        let Self {
            iterations,
            infeasibility: [infeasible, feasible],
            residual: [from, to],
            ..
        } = self;
        let what = match self.trend {
            Trend::Falling => "residuals were still falling",
            Trend::Stalled => "residuals were no longer falling",
        };
        format!(
            "{what}: over the last {iterations} iterations the infeasibility went from {infeasible:.1e} to {feasible:.1e}, the KKT \
             residual from {from:.1e} to {to:.1e} at best"
        )
    }
}

/// Number of Newton steps in a row without progress that show a floor of rounding: a single one may be the step that reaches it.
const NEWTON_STEPS: usize = 2;

/// The reason why steps far below the size of the variables make no progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standstill {
    /// The steps were those of Newton's method. The error that such a step leaves is its square, relative to the variables, which is below
    /// the machine precision: what is left of the residuals is rounding.
    Rounding,
    /// The steps were others.
    Steps,
}

impl Standstill {
    /// Returns the reason if the last steps, [`NEWTON_STEPS`] of Newton's method or [`WINDOW`] of any kind, were all shorter than the
    /// [square root of the machine precision](NEGLIGIBLE) times `size`, the norm of the variables (at least one), and neither optimality
    /// nor feasibility fell below [`PROGRESS`] times the least before. The last row of the history has no step yet.
    #[must_use]
    pub fn of(history: &[IterationRecord], size: f64) -> Option<Self> {
        let is_still = |steps: usize, counts: fn(&IterationRecord) -> bool| {
            let Some(first) = history.len().checked_sub(steps + 1) else {
                return false;
            };
            let taken = &history[first..history.len() - 1];
            let least = |rows: &[IterationRecord], value: fn(&IterationRecord) -> f64| {
                rows.iter().map(value).fold(f64::INFINITY, f64::min)
            };
            let stays = |value: fn(&IterationRecord) -> f64| {
                least(&history[first + 1..], value) >= PROGRESS * least(&history[..=first], value)
            };
            (taken.iter()).all(|row| {
                row.step.left == Leave::Step && counts(row) && row.step_norm <= NEGLIGIBLE * size
            }) && stays(|row| row.residual().optimality())
                && stays(|row| row.feasibility)
        };
        // A step that the trust region has shortened is none of Newton's method.
        let is_newton = |row: &IterationRecord| {
            row.step.hessian == HessianKind::Exact && row.step_norm < INSIDE * row.trust_radius
        };
        if is_still(NEWTON_STEPS, is_newton) {
            Some(Self::Rounding)
        } else {
            is_still(WINDOW, |_| true).then_some(Self::Steps)
        }
    }
}
