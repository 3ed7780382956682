//! Whether a solve that ended before its time was still getting on.

use super::outcome::IterationRecord;
use super::settings::PROGRESS;

/// Iterations that are looked back over.
const WINDOW: usize = 10;

/// Whether residuals were still falling when a solve ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Trend {
    /// Over the last iterations, the infeasibility or the KKT residual of the best point fell by a tenth or more.
    Falling,
    /// Neither did.
    Stalled,
}

/// The last iterations of a solve: the best point before them and the best point after them.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Progress {
    /// Whether residuals were still falling.
    pub trend: Trend,
    /// Iterations that are looked back over.
    pub iterations: usize,
    /// Least infeasibility before and after them.
    pub infeasibility: [f64; 2],
    /// Least KKT residual before and after them.
    pub residual: [f64; 2],
}

impl Progress {
    /// Of the iterations of a solve; `None` where there is no step to judge.
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

    /// In words.
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

    /// What falls by a tenth within ten iterations is falling, in either measure; what stands still, or only rises from its best, has
    /// stalled; without a step there is nothing to say.
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
