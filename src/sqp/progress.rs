//! Tells whether residuals were still decreasing when a solve stopped.

use super::outcome::IterationRecord;
use super::settings::PROGRESS;

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
}
