//! The search for the coarsest grid that is accurate enough: one for simulations, solves, statics, and the reference of a sweep.
//!
//! The error on `K` elements with steps of `h` is modelled as `a/K² + b h²`, by the orders of the rod and of its integrators, and the time
//! as proportional to the node-steps, `K/h`. Every grid is measured: the motion on it is compared with that on another grid, which gives
//! both parts of its error. While these are too large, the model gives the grid of least time that is accurate enough, and the search
//! continues there.

use crate::output::summary::{AccuracySummary, Level};
use crate::scene::MOST_ELEMENTS;

/// Relative error of an estimated error. Richardson's extrapolation from two grids assumes the order 2; for a true order of 1.6 the
/// estimate on a grid finer by √2 is too low by `1 - (2^0.8 - 1) = 0.26`, and on stiff wires one was too low by as much (decision 76).
const WRONG: f64 = 0.25;
/// Cap on the work of a search: its last grid is at most this many times as fine as its first one, five doublings.
const FINEST: f64 = 32.0;
/// Cap on the predicted time of work on one automatically chosen grid, s; a grid that a scene names has none.
pub(super) const LONGEST: f64 = HOUR;
/// Seconds of an hour.
pub(super) const HOUR: f64 = 3600.0;
/// Observed order below which refinement is taken to have no effect: a quarter of the order 2 that all methods have. With it, all the
/// refinement that a search may do lowers an error by a factor of `sqrt(32) = 5.7`.
pub(super) const NO_ORDER: f64 = 0.5;
/// Cap on the finer grids without an order before a search ends: two, because the first of them may be the first that resolves the shape.
const WITHOUT_ORDER: usize = 2;

/// Elements and a time step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Elements.
    pub elements: usize,
    /// Longest step, s.
    pub step: f64,
}

impl Grid {
    /// Returns the ratios of this grid's fineness to that of another, in elements and in steps.
    fn over(self, other: Self) -> [f64; 2] {
        [
            self.elements as f64 / other.elements as f64,
            other.step / self.step,
        ]
    }

    /// Returns the grid that is finer by the given factors in elements and steps.
    fn refined(self, [elements, steps]: [f64; 2]) -> Self {
        // Far above the rounding of a product, and less than an element for any number of elements.
        const WHOLE: f64 = 1e-12;
        let wanted = (elements * self.elements as f64 * (1.0 - WHOLE)).ceil();
        Self {
            elements: wanted as usize,
            step: self.step / steps,
        }
    }
}

/// The errors that elements and steps make on a grid, divided by the length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridErrors {
    /// The grid.
    pub grid: Grid,
    /// `a/K²` and `b h²`.
    pub parts: [f64; 2],
}

/// Knowledge of the order by which errors are extrapolated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// The order was observed on three grids.
    Observed,
    /// The order is assumed, and errors are extrapolated from two grids.
    Assumed,
}

/// Requirements on a grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridRule {
    /// Largest error, divided by the length.
    pub accuracy: f64,
    /// Knowledge of the order of the errors.
    pub order: Order,
    /// Cap on the predicted time of the work on one grid, s.
    pub longest: f64,
}

impl GridRule {
    /// Returns the fraction of the accuracy up to which an estimate confirms a grid.
    fn confirmed(&self) -> f64 {
        match self.order {
            Order::Observed => 1.0,
            Order::Assumed => 1.0 - WRONG,
        }
    }

    /// Returns the error for which a grid is chosen: with this aim, an estimate that is too large by its own relative error still confirms
    /// the grid.
    fn aim(&self) -> f64 {
        self.accuracy * self.confirmed() / (1.0 + WRONG)
    }

    /// Returns the largest factor of one refinement. Errors are observed with grids up to twice as fine, and the model is not extrapolated
    /// any further. If the order is assumed, an error is extrapolated from the grid before, and its own error grows with the ratio of both
    /// grids: for a true order of 1.6 it is too low by a quarter at √2, and by a third at 2.
    fn at_once(&self) -> f64 {
        match self.order {
            Order::Observed => 2.0,
            Order::Assumed => 2f64.sqrt(),
        }
    }

    /// Returns the largest number of grids that are measured.
    fn rounds(&self) -> usize {
        1 + (FINEST.ln() / self.at_once().ln()).round() as usize
    }
}

impl GridErrors {
    /// Returns the error, divided by the length.
    #[must_use]
    pub fn error(&self) -> f64 {
        self.parts[0] + self.parts[1]
    }

    /// Tells whether the grid is accurate enough for the rule.
    #[must_use]
    pub fn meets(&self, rule: &GridRule) -> bool {
        self.error() <= rule.confirmed() * rule.accuracy
    }

    /// Returns the errors that the model predicts on another grid.
    #[must_use]
    pub fn on(&self, grid: Grid) -> Self {
        let [elements, steps] = grid.over(self.grid);
        let [of_elements, of_steps] = self.parts;
        Self {
            grid,
            parts: [
                of_elements / (elements * elements),
                of_steps / (steps * steps),
            ],
        }
    }

    /// Returns the errors on a finer grid whose motion has the `distance` (divided by the length) from that on this grid. By the model that
    /// distance is `x (f² - 1) + y (g² - 1)` if the finer grid has the parts `x` and `y` and is finer by `f` in elements and by `g` in
    /// steps. Both parts are scaled by one factor; a part in which the grids do not differ keeps its predicted value. If the errors of this
    /// grid are unknown, both parts count as equal.
    #[must_use]
    pub fn seen(&self, grid: Grid, distance: f64) -> Self {
        let is_known = self.error().is_finite();
        let known = Self {
            parts: if is_known { self.parts } else { [1.0; 2] },
            ..*self
        };
        let expected = known.on(grid).parts;
        let gaps = grid.over(self.grid).map(|finer| finer * finer - 1.0);
        let expected_distance = expected[0] * gaps[0].max(0.0) + expected[1] * gaps[1].max(0.0);
        let factor = match distance {
            0.0 => 0.0,
            _ => distance / expected_distance,
        };
        let part = |at: usize| match gaps[at] > 0.0 {
            true => factor * expected[at],
            false => expected[at],
        };
        let parts = [part(0), part(1)];
        let is_known = parts.iter().all(|part| part.is_finite());
        Self {
            grid,
            parts: if is_known {
                parts
            } else {
                [f64::INFINITY, 0.0]
            },
        }
    }

    /// Returns the grid, no coarser than this one, on which the model predicts the error `aim` after the least time.
    ///
    /// With the parts `x` and `y` of the error on that grid, the time `K/h` is proportional to `1/√(x y)`, which is least for `x = y` where
    /// `x + y = aim` is given. A part that is already below `aim/2` stays as it is, and the other part gets the rest.
    #[must_use]
    pub fn cheapest(&self, aim: f64) -> Grid {
        let [x, y] = self.parts;
        let half = 0.5 * aim;
        let finer = |part: f64, goal: f64| (part / goal).sqrt().max(1.0);
        let factors = if x <= half {
            [1.0, finer(y, aim - x)]
        } else if y <= half {
            [finer(x, aim - y), 1.0]
        } else {
            [finer(x, half), finer(y, half)]
        };
        self.grid.refined(factors)
    }

    /// Returns the grid between this one and a finer one that is finer than this one by at most the given factor.
    fn towards(&self, grid: Grid, factor: f64) -> Grid {
        self.grid
            .refined(grid.over(self.grid).map(|finer| finer.clamp(1.0, factor)))
    }
}

/// A measured grid.
#[derive(Clone, Copy, Debug)]
pub struct Measured {
    /// Errors on the grid.
    pub estimate: GridErrors,
    /// Predicted seconds of the work on the grid.
    pub seconds: f64,
    /// Tells whether the grid is too coarse for a reason other than its errors.
    pub too_coarse: bool,
}

/// The result of a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum End {
    /// The last grid is accurate enough.
    Met,
    /// Errors do not fall with finer grids, or not within the number of grids or elements that are tried.
    OutOfReach,
    /// The required grid would take too long.
    TooLong {
        /// The required grid.
        wanted: Grid,
        /// Predicted time of work on this grid, s.
        seconds: f64,
    },
    /// The error of a grid could not be determined.
    Unmeasured,
}

/// Measures one grid after the other, from `first` on, until one is accurate enough or [`End`] says why none is. `measure` returns `None`
/// if it cannot determine the error; the grid that it measures may be finer than the requested one.
///
/// # Errors
/// Those of `measure`.
pub fn search<E>(
    rule: &GridRule,
    first: Grid,
    mut measure: impl FnMut(Grid, Option<&Measured>) -> Result<Option<Measured>, E>,
) -> Result<(Option<Measured>, End), E> {
    let mut grid = first;
    let mut last: Option<Measured> = None;
    let mut without_order = 0;
    for _ in 0..rule.rounds() {
        let Some(found) = measure(grid, last.as_ref())? else {
            return Ok((last, End::Unmeasured));
        };
        let estimate = found.estimate;
        if estimate.meets(rule) && !found.too_coarse {
            return Ok((Some(found), End::Met));
        }
        if let Some(before) = last {
            let order = observed_order(&before.estimate, &estimate);
            without_order += usize::from(!(order >= NO_ORDER));
        }
        last = Some(found);
        if without_order == WITHOUT_ORDER {
            break;
        }
        // If the error is unknown, or something other than the error is wrong, the required refinement is unknown too.
        let wanted = match estimate.meets(rule) || !estimate.error().is_finite() {
            true => estimate.grid.refined([rule.at_once(); 2]),
            false => estimate.cheapest(rule.aim()),
        };
        let [elements, steps] = wanted.over(estimate.grid);
        let seconds = found.seconds * elements * steps;
        if seconds > rule.longest {
            return Ok((last, End::TooLong { wanted, seconds }));
        }
        grid = estimate.towards(wanted, rule.at_once());
        if grid.elements > MOST_ELEMENTS {
            break;
        }
    }
    Ok((last, End::OutOfReach))
}

/// Returns the order by which an error fell from `before` to `after`, given that the model of second order predicts the fall; NaN if an
/// error is unknown.
fn observed_order(before: &GridErrors, after: &GridErrors) -> f64 {
    let expected = before.on(after.grid).error() / before.error();
    2.0 * (after.error() / before.error()).ln() / expected.ln()
}

/// Returns the order by which the distance between motions fell from one pair of grids to the next, each grid twice as fine as the one
/// before.
pub(super) fn order_of_distances(before: f64, after: f64) -> f64 {
    (before / after).log2()
}

/// Returns the ratio of the error on a grid to the distance from a grid half as fine, by Richardson's extrapolation with an observed order
/// from 1 to 2; an unknown order counts as 1.
pub(super) fn remainder(order: Option<f64>) -> f64 {
    1.0 / (order.unwrap_or(1.0).clamp(1.0, 2.0).exp2() - 1.0)
}

/// Returns the result of a search for an accuracy as the numbers and the sentence of a summary.
pub(super) fn summary(
    asked: f64,
    last: &GridErrors,
    met: bool,
    levels: Vec<Level>,
) -> AccuracySummary {
    let [of_elements, of_steps] = last.parts;
    let error = last.error();
    AccuracySummary {
        asked,
        error,
        met,
        error_of_elements: of_elements,
        error_of_steps: of_steps,
        levels,
        why: format!(
            "{} elements and steps of {:.4e} s: the estimated error is {error:.1e} of the length, of which elements make {of_elements:.1e} and steps \
             {of_steps:.1e}; {asked:e} is asked{}",
            last.grid.elements,
            last.grid.step,
            if met { "" } else { " and not reached" }
        ),
    }
}
