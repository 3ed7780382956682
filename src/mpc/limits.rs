//! Limits on the states over one horizon, each at the places nearest to a violation.
//!
//! A limit has a row `h ≤ 0` for every element or point of the arm. The controller evaluates it at every sample of the horizon but the
//! first, which no command can change any more: of a limit on strains every element, because a strain that is taken from one element bends
//! its neighbors, and of all other limits the greatest local maxima along the arm.

use crate::control::OptimalControlProblem;
use crate::control::path::{PathEnforcement, PathLimit, RodView};
use crate::mechanics::Rod;

/// Cap on the local maxima along the arm that count, per limit and sample: an arm that lies on an obstacle touches it at two ends of a
/// stretch.
const MAXIMA: usize = 2;

/// A row of a limit at a sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct LimitRow {
    /// Index of the limit.
    pub limit: usize,
    /// Time node of the sample, on the longest grid.
    pub time_node: usize,
    /// Time node of the sample before, from which on a speed is a mean: a mean over one step would miss the waves in between.
    pub before: usize,
    /// Rank among the evaluated rows: an element, or a local maximum, the greatest first.
    pub rank: usize,
    /// Prices of the violation and of half of its square.
    pub prices: [f64; 2],
}

impl LimitRow {
    /// Value of an unused row: as far from a violation as the arm is long.
    pub const NOWHERE: f64 = -1.0;
}

/// Returns the rows of all limits at the samples of the horizon but the first, in the order of time; `hard` is the price of hard limits.
pub(super) fn limit_rows(problem: &OptimalControlProblem, hard: f64) -> Vec<LimitRow> {
    let n = problem.grid.n_steps;
    let samples = problem.objective.samples.clamp(1, n);
    let duration = problem.grid.duration() / samples as f64;
    let mut rows = Vec::new();
    for [before, time_node] in (1..=samples).map(|i| [i - 1, i].map(|i| i * n / samples)) {
        for (limit, path) in problem.path.iter().enumerate() {
            let [linear, quadratic] = match path.enforcement {
                PathEnforcement::Hard => [hard; 2],
                PathEnforcement::Soft { linear, quadratic } => [linear, quadratic],
            };
            let n_seen = n_seen(&path.limit, &problem.rod);
            rows.extend((0..n_seen).map(|rank| LimitRow {
                limit,
                time_node,
                before,
                rank,
                prices: [linear * duration, quadratic * duration],
            }));
        }
    }
    rows
}

/// Returns the number of rows of a limit that are evaluated at a sample.
fn n_seen(limit: &PathLimit, rod: &Rod) -> usize {
    match limit.rows_per_element() {
        Some(_) => rod.n_elements(),
        None => MAXIMA.min(limit.n_items(rod)),
    }
}

/// Items of the maxima of the present limit and sample.
#[derive(Debug, Default)]
pub(super) struct Maxima([Option<usize>; MAXIMA]);

impl Maxima {
    /// Returns the item of the row of rank `rank` at the second of two time nodes; ranks of one limit and sample must be requested in
    /// ascending order.
    pub fn item(
        &mut self,
        limit: &PathLimit,
        view: &RodView,
        instants: [usize; 2],
        rank: usize,
    ) -> Option<usize> {
        let value = |item: usize| limit.value_since(view, instants, item);
        match limit.rows_per_element() {
            Some(sides) => {
                let items = sides * rank..sides * (rank + 1);
                items.reduce(|best, item| {
                    if value(item) > value(best) {
                        item
                    } else {
                        best
                    }
                })
            }
            None => {
                if rank == 0 {
                    self.0 = maxima(limit.n_items(view.rod), value);
                }
                self.0[rank]
            }
        }
    }
}
/// Returns the items of the greatest local maxima, the greatest first.
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
