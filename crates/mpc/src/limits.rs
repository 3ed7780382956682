//! Limits on the states over one horizon, each at the places nearest to a violation.
//!
//! A limit has a row `h ≤ 0` for every element or point of the arm. The controller evaluates it at every time within the horizon at which a
//! sample of the loop ends, so that the next plan is asked at no other times than this one was: of a limit on strains every element, because
//! a strain that is taken from one element bends its neighbors, of the limit that keeps tendons taut every tendon, and of all other limits the greatest local maxima along the arm. Nothing is
//! asked of the beginning, which no command can change any more.

use control::OptimalControlProblem;
use control::path::{PathEnforcement, PathLimit, RodView};
use mechanics::Rod;

/// Cap on the local maxima along the arm that count, per limit and sample: an arm that lies on an obstacle touches it at two ends of a
/// stretch.
const MAXIMA: usize = 2;

/// Price at which a limit begins, whose price the controller finds (decision 63).
const FIRST_PRICE: f64 = 5e3;
/// Factor on the price of a limit from one subproblem to the next while the plan violates it, and by which it may come down after a sample.
const RISE: f64 = 2.0;
/// Cap on the factor by which a price rises. In a loop whose ball would be passed at the first price, forty times are needed; above some
/// thousand times, rounding of the violation's price hides what the objective gains.
const MOST_RISEN: f64 = 1024.0;
/// Part of a price that a multiplier may have before the price counts as too low to come down: twice below one.
const LOW: f64 = 0.25;
/// Violation of a limit, divided by its [reference](PathLimit::reference), up to which it counts as kept: that of a certificate between
/// nodes and samples.
pub const KEPT: f64 = 0.01;

/// Prices of the limits of a controller: exact penalties whose weights follow the multipliers.
///
/// A penalty `w σ` keeps a limit exactly if `w` is above the multiplier that the limit has as a constraint (Nocedal and Wright 2006, theorem
/// 17.3), which is the pull of the objective and known only together with the solution. The price of a limit rises within a sample until
/// the plan keeps it, and comes down afterwards where its multipliers are far below (steering: Byrd, Nocedal and Waltz 2008). The plan does
/// not depend on a price above the multipliers. A limit that is violated at the highest price gives way: bounds, or the time that is left,
/// forbid to keep it, and the plan violates it as little as they allow.
#[derive(Debug)]
pub(super) struct Prices {
    /// Price of a limit without a price of its own.
    first: f64,
    limits: Vec<Price>,
}

#[derive(Clone, Copy, Debug)]
struct Price {
    /// Factor on the first price.
    factor: f64,
    /// Scaled violation up to which the limit counts as kept.
    tolerance: f64,
    /// Tells whether the price follows the multipliers.
    follows: bool,
    /// Largest violation and largest part of the price that a multiplier has, in the last plan.
    worst: [f64; 2],
}

impl Prices {
    /// Creates the prices of all limits of a problem; `price` is that of hard limits, `None` if it is to be found.
    pub fn new(problem: &OptimalControlProblem, price: Option<f64>) -> Self {
        let rod = &problem.rod;
        let limits = (problem.path.iter())
            .map(|path| Price {
                factor: 1.0,
                tolerance: KEPT * path.limit.reference(rod, &problem.radii) / path.limit.scale(rod),
                follows: price.is_none() && path.enforcement == PathEnforcement::Hard,
                worst: [0.0; 2],
            })
            .collect();
        Self {
            first: price.unwrap_or(FIRST_PRICE),
            limits,
        }
    }

    /// Returns the prices of a row.
    pub fn of(&self, row: &LimitRow) -> [f64; 2] {
        row.prices
            .map(|price| self.limits[row.limit].factor * price)
    }

    /// Begins to look at the rows of a plan.
    pub fn begin(&mut self) {
        for own in &mut self.limits {
            own.worst = [0.0; 2];
        }
    }

    /// Sees a row of the plan: its value, and its multiplier divided by its price.
    pub fn see(&mut self, limit: usize, value: f64, share: f64) {
        let [violation, largest] = &mut self.limits[limit].worst;
        *violation = violation.max(value);
        *largest = largest.max(share);
    }

    /// Raises the prices of the limits that the plan violates; returns `false` if none can rise.
    pub fn rise(&mut self) -> bool {
        let mut rose = false;
        for own in self.limits.iter_mut().filter(|own| own.follows) {
            if own.worst[0] > own.tolerance && own.factor < MOST_RISEN {
                own.factor = (RISE * own.factor).min(MOST_RISEN);
                rose = true;
            }
        }
        rose
    }

    /// Lowers the prices that are far above their multipliers.
    pub fn come_down(&mut self) {
        for own in self.limits.iter_mut().filter(|own| own.follows) {
            let [violation, share] = own.worst;
            if violation <= own.tolerance && share < LOW {
                own.factor = (own.factor / RISE).max(1.0);
            }
        }
    }

    /// Returns by how much the last plan violates the limit with this index at the highest price, in the scale of its rows; `None` if the
    /// plan keeps it, and for a limit whose price is given.
    pub fn gave_way(&self, limit: usize) -> Option<f64> {
        let own = &self.limits[limit];
        let gives = own.follows && own.factor >= MOST_RISEN && own.worst[0] > own.tolerance;
        gives.then_some(own.worst[0])
    }
}

/// A row of a limit at a sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct LimitRow {
    /// Index of the limit.
    pub limit: usize,
    /// Time node of the sample, on the longest grid.
    pub time_node: usize,
    /// Time node of the row before, from which on a speed is a mean: a mean over one step would miss the waves in between.
    pub before: usize,
    /// Rank among the evaluated rows: an element, or a local maximum, the greatest first.
    pub rank: usize,
    /// Prices of the violation and of half of its square, before they [follow](Prices) the multipliers.
    pub prices: [f64; 2],
}

impl LimitRow {
    /// Value of an unused row: as far from a violation as the arm is long.
    pub const NOWHERE: f64 = -1.0;
}

/// Returns the rows of all limits at the ends of the samples within the horizon, and at its own, in the order of time; `period` (s) is that
/// of the loop. Steps of the model that are longer than the period leave one row for each step.
pub(super) fn limit_rows(
    problem: &OptimalControlProblem,
    prices: &Prices,
    period: f64,
) -> Vec<LimitRow> {
    let (n, step) = (problem.grid.n_steps, problem.grid.step);
    let mut nodes: Vec<usize> = (0..=n)
        .map(|sample| (sample as f64 * period / step).round() as usize)
        .take_while(|node| *node < n)
        .chain([n])
        .collect();
    nodes.dedup();
    let mut rows = Vec::new();
    for [before, time_node] in nodes.windows(2).map(|pair| [pair[0], pair[1]]) {
        let duration = (time_node - before) as f64 * step;
        for (limit, path) in problem.path.iter().enumerate() {
            let [linear, quadratic] = match path.enforcement {
                PathEnforcement::Hard => [prices.first; 2],
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
        // Every tendon has its own winch.
        None if limit.depends_on_inputs() => limit.n_items(rod),
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
            None if limit.depends_on_inputs() => Some(rank),
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
pub fn maxima(n: usize, value: impl Fn(usize) -> f64) -> [Option<usize>; MAXIMA] {
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
