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
pub(super) enum Standstill {
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
    pub(super) fn of(history: &[IterationRecord], size: f64) -> Option<Self> {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn row(infeasibility: f64, stationarity: f64) -> IterationRecord {
        IterationRecord {
            stationarity,
            feasibility: infeasibility,
            infeasibility,
            ..IterationRecord::default()
        }
    }

    fn trend(values: impl Iterator<Item = (f64, f64)>) -> Option<Trend> {
        let rows: Vec<_> = values.map(|(i, s)| row(i, s)).collect();
        Progress::of(&rows).map(|progress| progress.trend)
    }

    /// A residual that falls by a tenth within ten iterations is falling, in either measure; one that stays, or only rises from its best,
    /// has stalled; a history without a step has no trend.
    #[test]
    fn falling_and_stalled_solves_are_told_apart() {
        let falls = |k: i32| 0.98_f64.powi(k);
        assert_eq!(trend(std::iter::once((1.0, 1.0))), None);
        assert_eq!(trend((0..30).map(|_| (1.0, 1.0))), Some(Trend::Stalled));
        assert_eq!(
            trend((0..30).map(|k| (falls(k), 1.0))),
            Some(Trend::Falling)
        );
        assert_eq!(
            trend((0..30).map(|k| (0.0, falls(k)))),
            Some(Trend::Falling)
        );
        let rises = (0..30).map(|k| (1.0 / falls(k), 1.0 / falls(k)));
        assert_eq!(trend(rises), Some(Trend::Stalled));
        let late = (0..30).map(|k| (falls(k.min(10)), falls(k.min(10))));
        assert_eq!(trend(late), Some(Trend::Stalled));
    }

    /// Two short Newton steps without progress end at rounding; one does not, nor do steps that lower a residual, long ones, or ones that
    /// the trust region has shortened. Ten short steps of another kind end without that name.
    #[test]
    fn newton_steps_that_gain_nothing_end_at_rounding() {
        let history = |stationarity: &[f64], hessian: HessianKind, length: f64, radius: f64| {
            let mut rows: Vec<_> = stationarity.iter().map(|&s| row(4e-10, s)).collect();
            for row in &mut rows {
                row.step.left = Leave::Step;
                row.step.hessian = hessian;
                row.step_norm = length;
                row.trust_radius = radius;
            }
            Standstill::of(&rows, 1.0)
        };
        let exact = |s: &[f64], length: f64| history(s, HessianKind::Exact, length, 1.0);
        let still = [8e-11, 8.2e-11, 7.9e-11];
        assert_eq!(exact(&still, 1e-12), Some(Standstill::Rounding));
        assert_eq!(exact(&still[1..], 1e-12), None);
        assert_eq!(exact(&[8e-11, 8e-11, 4e-11], 1e-12), None);
        assert_eq!(exact(&still, 1e-6), None);
        let cut = history(&still, HessianKind::Exact, 1e-12, 1e-12);
        assert_eq!(cut, None);
        let others = |n: usize| history(&vec![8e-11; n], HessianKind::GaussNewton, 1e-12, 1.0);
        assert_eq!(others(10), None);
        assert_eq!(others(11), Some(Standstill::Steps));
    }
}
