//! Limits on the states over one horizon: of each, where it is nearest to being violated.
//!
//! A limit has a row `h ≤ 0` for every element or point of the arm. At every sample of the horizon but the first, which no command can change
//! any more, the controller sees every element of a limit on strains, because what is taken from one bends its neighbors, and of the
//! clearance of an obstacle the greatest local maxima along the arm.

use faer::Mat;

use crate::control::path::{PathEnforcement, PathLimit, RodView};
use crate::control::{Enforcement, Goal, OptimalControlProblem, PathConstraint};
use crate::mechanics::linearization::StateTangent;
use crate::mechanics::{Rod, StateForm};

use super::error::MpcError;
use super::soft_rows::SoftRows;

/// Local maxima along the arm that count, of each obstacle at each sample.
const MAXIMA: usize = 2;
/// Value of a row that there is not: as far from a violation as the arm is long.
const NOWHERE: f64 = -1.0;

/// A row of a limit at a sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct LimitRow {
    /// Index of the limit.
    limit: usize,
    /// Time node of the sample, on the longest grid.
    time_node: usize,
    /// Which of the rows that are seen: an element, or a local maximum, the greatest first.
    rank: usize,
    /// Which row of the horizon it is.
    row: usize,
    /// Prices of the violation and of half of its square.
    prices: [f64; 2],
}

/// The rows of all limits, in the order of time.
#[derive(Debug)]
pub(super) struct Limits {
    rows: Vec<LimitRow>,
    /// Items of the maxima of the obstacle and sample at hand.
    items: [Option<usize>; MAXIMA],
    values: Vec<f64>,
    along_start: Mat<f64>,
}

/// Whether a controller can see a problem's limits.
///
/// # Errors
/// [`MpcError::Unsupported`].
pub(super) fn check(problem: &OptimalControlProblem) -> Result<(), MpcError> {
    let has_tolerance = |goal: &Goal| matches!(goal.enforcement, Enforcement::Within { .. });
    if problem.goals.iter().any(has_tolerance) {
        return Err(MpcError::Unsupported(
            "the controller's targets are soft; leave out tolerances of targets",
        ));
    }
    let is_speed = |path: &PathConstraint| matches!(path.limit, PathLimit::Speed { .. });
    if problem.path.iter().any(is_speed) {
        return Err(MpcError::Unsupported(
            "the controller knows obstacles and limits of stretch, curvature and twist; leave out limits of speed",
        ));
    }
    Ok(())
}

impl Limits {
    /// At the samples of the horizon but the first; `hard` are the prices of limits that are to be kept.
    pub fn new(problem: &OptimalControlProblem, hard: f64, n_states: usize) -> Self {
        let n = problem.grid.n_steps;
        let samples = problem.objective.samples.clamp(1, n);
        let duration = problem.grid.duration() / samples as f64;
        let mut rows = Vec::new();
        for time_node in (1..=samples).map(|i| i * n / samples) {
            for (limit, path) in problem.path.iter().enumerate() {
                let [linear, quadratic] = match path.enforcement {
                    PathEnforcement::Hard => [hard; 2],
                    PathEnforcement::Soft { linear, quadratic } => [linear, quadratic],
                };
                rows.extend((0..n_seen(&path.limit, &problem.rod)).map(|rank| LimitRow {
                    limit,
                    time_node,
                    rank,
                    row: 0,
                    prices: [linear * duration, quadratic * duration],
                }));
            }
        }
        let m = rows.len();
        Self {
            rows,
            items: [None; MAXIMA],
            values: vec![NOWHERE; m],
            along_start: Mat::zeros(m, n_states),
        }
    }

    /// Time nodes of the rows, in their order.
    pub fn time_nodes(&self) -> impl Iterator<Item = usize> {
        self.rows.iter().map(|row| row.time_node)
    }

    /// Tells the rows, in their order, their places among those of the horizon.
    pub fn place(&mut self, places: impl Iterator<Item = usize>) {
        for (row, place) in self.rows.iter_mut().zip(places) {
            row.row = place;
        }
    }

    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Places of the rows among those of the horizon from `first` on, counted from there, with their indices.
    pub fn present(&self, first: usize) -> impl Iterator<Item = (usize, usize)> {
        let rows = self.rows.iter().enumerate();
        rows.filter_map(move |(index, row)| Some((index, row.row.checked_sub(first)?)))
    }

    /// Value and form of a row; the rows of one limit and sample follow each other.
    pub fn evaluate(
        &mut self,
        problem: &OptimalControlProblem,
        view: &RodView,
        index: usize,
        form: &mut StateForm,
    ) {
        let LimitRow { limit, rank, .. } = self.rows[index];
        let limit = &problem.path[limit].limit;
        let k = form.time_node;
        let value = |item: usize| limit.value(view, k, item);
        let item = match limit {
            PathLimit::Stretch { .. } | PathLimit::Twist { .. } => {
                let [upper, lower] = [2 * rank, 2 * rank + 1];
                Some(if value(lower) > value(upper) {
                    lower
                } else {
                    upper
                })
            }
            PathLimit::Curvature { .. } => Some(rank),
            _ => {
                if rank == 0 {
                    self.items = maxima(limit.n_items(&problem.rod), value);
                }
                self.items[rank]
            }
        };
        form.terms.clear();
        self.values[index] = NOWHERE;
        if let Some(item) = item {
            self.values[index] = limit.value(view, k, item);
            for part in limit.gradient(view, k, item) {
                form.terms.extend(part.terms);
            }
        }
    }

    /// Takes their derivatives along a component of the state at the start out of those of all rows from `first` on.
    pub fn take_along_start(&mut self, first: usize, component: usize, slopes: &mut [f64]) {
        for (index, row) in self.rows.iter().enumerate() {
            if let Some(place) = row.row.checked_sub(first) {
                self.along_start[(index, component)] = std::mem::take(&mut slopes[place]);
            }
        }
    }

    /// Prices and number of the rows from `first` on; values and slopes are to be filled.
    pub fn write(&self, first: usize, soft: &mut SoftRows) {
        soft.prices.clear();
        soft.prices.extend(
            self.present(first)
                .map(|(index, _)| self.rows[index].prices),
        );
        soft.values.clear();
        soft.values.resize(soft.prices.len(), NOWHERE);
    }

    /// Values of the rows from `first` on, where the start deviates.
    pub fn write_values(
        &self,
        first: usize,
        free_node: usize,
        deviation: &StateTangent,
        out: &mut [f64],
    ) {
        for ((index, _), out) in self.present(first).zip(out) {
            let moved: f64 = (deviation.components_from(free_node).enumerate())
                .map(|(i, d)| self.along_start[(index, i)] * d)
                .sum();
            *out = self.values[index] + moved;
        }
    }
}

/// Rows of a limit that are seen at a sample.
fn n_seen(limit: &PathLimit, rod: &Rod) -> usize {
    match limit {
        PathLimit::Stretch { .. } | PathLimit::Twist { .. } | PathLimit::Curvature { .. } => {
            rod.n_elements()
        }
        _ => MAXIMA.min(limit.n_items(rod)),
    }
}

/// Items of the greatest local maxima, the greatest first.
fn maxima(n: usize, value: impl Fn(usize) -> f64) -> [Option<usize>; MAXIMA] {
    let mut found: [Option<(usize, f64)>; MAXIMA] = [None; MAXIMA];
    let mut before = f64::NEG_INFINITY;
    let mut here = value(0);
    for item in 0..n {
        let after = if item + 1 < n {
            value(item + 1)
        } else {
            f64::NEG_INFINITY
        };
        if here >= before && here > after {
            let place = found
                .iter()
                .position(|old| old.is_none_or(|old| old.1 < here));
            if let Some(place) = place {
                found[place..].rotate_right(1);
                found[place] = Some((item, here));
            }
        }
        (before, here) = (here, after);
    }
    found.map(|one| one.map(|(item, _)| item))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The greatest local maxima, ends and plateaus among them.
    #[test]
    fn maxima_are_local() {
        let of = |values: &[f64]| maxima(values.len(), |i| values[i]);
        assert_eq!(of(&[1.0, 0.0, 3.0, 2.0, 2.5]), [Some(2), Some(4)]);
        assert_eq!(of(&[5.0, 4.0, 3.0]), [Some(0), None]);
        assert_eq!(of(&[0.0, 2.0, 2.0, 1.0]), [Some(2), None]);
        assert_eq!(of(&[7.0]), [Some(0), None]);
    }
}
