//! Solves a subproblem to rounding, by Newton's method on the conditions of its active set.
//!
//! An interior point ends at a small product of slack and multiplier. On a second-order cone that product is the square of the angle
//! between the control and its multiplier, so that a product of 1e-11 leaves 3e-6 of the gradient unexplained, however often the subproblem
//! is repeated. The active set is known well before; once it is fixed, the conditions are smooth equations.
//!
//! Near a solution, successive subproblems have the same active set. The multipliers of the last one then tell it, and the equations give
//! the solution without an interior point.

use std::collections::BTreeMap;

use faer::Mat;
use faer::linalg::solvers::Solve as _;

use super::{LinearInequalities, QpSolution, QuadraticProgram};
use crate::norms::{infinity_norm, norm};
use crate::program::{ConvexSet, Multipliers, Softness, along};
use crate::settings::{EXACT, NEGLIGIBLE};

/// Steps longer than this fraction of the trust radius are not polished: the cone of the trust region may be active as well. Clarabel
/// leaves a distance of 1e-11 over the multiplier to an active cone, which is within this margin for all multipliers that are not
/// [`NEGLIGIBLE`].
pub(crate) const INSIDE: f64 = 0.999;
/// Cap on Newton iterations after an interior point, whose error of some 1e-6 is rounding after two of them.
const ITERATIONS: usize = 4;
/// Cap on Newton iterations if the active set comes from the multipliers of another subproblem.
const EXPECTED_ITERATIONS: usize = 8;
/// Newton's method has ended with an iteration that leaves more than this fraction of the residual: where it converges, it squares it.
const HALVED: f64 = 0.5;
/// Regularization of dependent rows, relative to the largest entry of the Hessian. A row that depends on others to `ε` then gets
/// multipliers that are off by `ε` over this number, 2e-5, relative; on independent rows every iteration leaves about this fraction of the
/// error.
const REGULARIZATION: f64 = 1e-11;
/// Largest change of the step, relative to its size or one: a larger change means that the active set was guessed wrong. The error of an
/// interior point is the square root of its tolerance, 3e-6, over that of the curvature, which may then be as small as 1e-5.
const FAR: f64 = 1e-3;
/// Rounding of a set's value, relative to the variables or one: four and a half times the machine precision, for a sum of a few terms.
const SET_ROUNDING: f64 = 1e-15;
/// Violation of inactive conditions, and size of multipliers of wrong sign relative to the largest, that count as rounding: the residual
/// that Newton's method [ends with](EXACT), with a condition number of 100 of the active rows.
const ROUNDING: f64 = 1e-10;

/// A row that holds with equality, named by the place of its multiplier.
#[derive(Clone, Copy)]
enum Active {
    Constraint(usize),
    Inequality(usize),
    Set(usize),
    /// One row of a ball of radius zero.
    Center(usize, usize),
}

/// Evidence by which a row counts as active.
#[derive(Clone, Copy)]
enum Clue {
    /// The slack is smaller than the multiplier divided by the largest pull on the variables.
    Slack,
    /// The multiplier is not zero.
    Multiplier,
}

/// What a solution tells about the active set of a program.
struct Evidence<'a> {
    qp: &'a QuadraticProgram<'a>,
    solution: &'a QpSolution,
    clue: Clue,
    /// Unit of multipliers. Slacks are in the units of the rows, which are scaled to about one.
    unit: f64,
}

impl<'a> Evidence<'a> {
    fn of(qp: &'a QuadraticProgram<'a>, solution: &'a QpSolution, clue: Clue) -> Self {
        let multipliers = &solution.multipliers;
        let largest = |values: &[f64]| infinity_norm(values);
        let unit = (multipliers.normals.iter().map(|normal| largest(normal)))
            .fold(largest(&multipliers.inequalities), f64::max)
            .max(largest(qp.gradient))
            .max(f64::MIN_POSITIVE);
        Self {
            qp,
            solution,
            clue,
            unit,
        }
    }

    /// Tells whether a row with this multiplier and this slack holds with equality.
    fn holds(&self, multiplier: f64, slack: f64) -> bool {
        match self.clue {
            Clue::Slack => multiplier / self.unit > slack,
            Clue::Multiplier => multiplier / self.unit > NEGLIGIBLE,
        }
    }

    /// Tells whether a group's slack is positive: it exceeds what its multipliers lack to the elastic weight.
    fn is_open(&self, slack: f64, multiplier: f64) -> bool {
        matches!(self.clue, Clue::Slack)
            && slack > (self.qp.elastic_weight - multiplier).max(0.0) / self.unit
    }

    /// Returns the constraints that hold, and those with a positive slack, with its sign.
    fn constraints(&self) -> (Vec<Active>, Vec<(usize, f64)>) {
        let mut active = Vec::new();
        let mut given_up = Vec::new();
        let of_constraints = self.qp.constraints_along(&self.solution.change);
        for (i, (c, y)) in of_constraints
            .iter()
            .zip(&self.solution.multipliers.constraints)
            .enumerate()
        {
            if self.is_open(c.abs(), y * c.signum()) {
                given_up.push((i, c.signum()));
            } else {
                active.push(Active::Constraint(i));
            }
        }
        (active, given_up)
    }

    /// Returns the groups of hard rows whose slack is positive.
    fn slack_groups(&self) -> Vec<usize> {
        let rows = &self.qp.inequalities;
        let total = |group: usize| -> f64 {
            let of_group = (0..rows.groups.len())
                .filter(|&at| rows.softness[at] == Softness::Hard && rows.groups[at] == group);
            of_group
                .map(|at| self.solution.multipliers.inequalities[at])
                .sum()
        };
        (self.solution.slacks.iter())
            .filter(|&(group, slack)| self.is_open(*slack, total(*group)))
            .map(|(group, _)| *group)
            .collect()
    }

    /// Returns the inequalities that hold with equality, and the violated soft ones with their prices.
    fn inequalities(&self, slack_groups: &[usize]) -> (Vec<Active>, Vec<(usize, f64, f64)>) {
        let (rows, solution) = (&self.qp.inequalities, self.solution);
        let mut active = Vec::new();
        let mut paid = Vec::new();
        let mut values = rows.along(&solution.change);
        for (at, value) in values.iter_mut().enumerate() {
            if open_slack(rows, slack_groups, at).is_some() {
                *value -= solution.slacks[&rows.groups[at]];
            }
        }
        for &at in &solution.working {
            let z = solution.multipliers.inequalities[at];
            match rows.softness[at] {
                Softness::Soft { linear, quadratic } if self.holds(linear.max(z), -values[at]) => {
                    // The row is violated, or at its limit with a multiplier below its price.
                    let left = linear + quadratic * values[at].max(0.0) - z;
                    let is_paid = match self.clue {
                        Clue::Slack => values[at] > 0.0 && left <= values[at] * self.unit,
                        Clue::Multiplier => z >= linear * (1.0 - NEGLIGIBLE),
                    };
                    if is_paid {
                        paid.push((at, linear, quadratic));
                    } else if self.holds(z, -values[at]) {
                        active.push(Active::Inequality(at));
                    }
                }
                Softness::Soft { .. } => {}
                Softness::Hard if self.holds(z, -values[at]) => {
                    active.push(Active::Inequality(at));
                }
                Softness::Hard => {}
            }
        }
        (active, paid)
    }

    /// Returns the sets on whose boundary the variables are; `there` are these.
    fn sets(&self, there: &[f64]) -> Vec<Active> {
        let mut active = Vec::new();
        let normals = &self.solution.multipliers.normals;
        for (at, (set, normal)) in self.qp.sets.iter().zip(normals).enumerate() {
            match set {
                ConvexSet::Ball { rows, radius } if *radius <= 0.0 => {
                    active.extend((0..rows.len()).map(|row| Active::Center(at, row)));
                }
                ConvexSet::Interval { lower, upper, .. } if lower == upper => {
                    active.push(Active::Set(at));
                }
                _ => {
                    let room = match set {
                        // The side of the interval to which the multiplier belongs.
                        ConvexSet::Interval {
                            index,
                            lower,
                            upper,
                        } if normal[0] < 0.0 => there[*index] - lower.min(*upper),
                        _ => -set.violation(there),
                    };
                    if self.holds(norm(normal), room.max(0.0)) {
                        active.push(Active::Set(at));
                    }
                }
            }
        }
        active
    }
}

/// The optimality conditions as equations for a given active set.
struct Conditions<'a> {
    qp: &'a QuadraticProgram<'a>,
    active: Vec<Active>,
    /// `v + δ` of Clarabel's solution.
    before: Vec<f64>,
    /// Violated soft rows `(row, linear, quadratic)`: their penalties are part of the objective.
    paid: Vec<(usize, f64, f64)>,
    /// Constraints with a positive slack, and its sign: the elastic weight times the slack is part of the objective.
    given_up: Vec<(usize, f64)>,
    /// Groups of hard rows whose slack is positive. These slacks are unknowns after those of `δ`.
    slack_groups: Vec<usize>,
    /// Hessian with respect to `δ` and these slacks.
    hessian: Mat<f64>,
    gradient: Vec<f64>,
}

/// Tells whether a solution is well inside the trust region, so that only rows and sets are active.
pub(super) fn can_be_polished(qp: &QuadraticProgram, solution: &QpSolution) -> bool {
    qp.length(&solution.change) <= INSIDE * qp.trust_radius
}

/// Returns the polished form of a solution that [can be polished](can_be_polished), by the condensed conditions. Returns `None` if the
/// active set cannot be identified, or if the result is no better.
pub(super) fn polish(qp: &QuadraticProgram, solution: &QpSolution) -> Option<QpSolution> {
    let conditions = Conditions::of(qp, solution, Clue::Slack);
    let slack = |group| solution.slacks.get(group).copied().unwrap_or(0.0);
    let mut change = solution.change.clone();
    change.extend(conditions.slack_groups.iter().map(slack));
    let mut multipliers = conditions.multipliers(solution);
    let mut residual = conditions.residual(&change, &multipliers);
    let before = infinity_norm(&residual);
    for _ in 0..ITERATIONS {
        let was = infinity_norm(&residual);
        residual = conditions.improve(&mut change, &mut multipliers, &residual)?;
        if !(infinity_norm(&residual) < HALVED * was) {
            break;
        }
    }
    let moved =
        (change.iter().zip(&solution.change)).fold(0.0, |m: f64, (a, b)| m.max((a - b).abs()));
    // Clarabel may stop short of a trust region that a step with hardly any effect on the objective reaches.
    let far = qp.length(&change) > qp.trust_radius
        || moved > FAR * infinity_norm(&solution.change).max(1.0);
    if far || !(infinity_norm(&residual) <= before) || !conditions.allows(&change, &multipliers) {
        return None;
    }
    Some(conditions.solution(solution, change, &multipliers))
}

/// Returns the solution if its active set is that of `expected`, `None` otherwise.
pub(super) fn as_expected(qp: &QuadraticProgram, expected: &Multipliers) -> Option<QpSolution> {
    if qp.states.is_some() {
        return None;
    }
    let start = QpSolution {
        change: vec![0.0; qp.gradient.len()],
        returned: Vec::new(),
        multipliers: expected.clone(),
        slack: 0.0,
        iterations: 0,
        working: (0..qp.inequalities.offset.len()).collect(),
        slacks: BTreeMap::new(),
    };
    let conditions = Conditions::of(qp, &start, Clue::Multiplier);
    let mut change = start.change.clone();
    let mut multipliers = conditions.multipliers(&start);
    let mut residual = conditions.residual(&change, &multipliers);
    // One more iteration follows an exact one, because the tolerance on sets is tighter than that on equations.
    for _ in 0..EXPECTED_ITERATIONS {
        let was_exact = conditions.is_exact(&residual, &change, &multipliers);
        residual = conditions.improve(&mut change, &mut multipliers, &residual)?;
        if was_exact {
            break;
        }
    }
    let holds = conditions.is_exact(&residual, &change, &multipliers)
        && conditions.allows(&change, &multipliers);
    if !holds {
        return None;
    }
    let found = conditions.solution(&start, change, &multipliers);
    let rows = &qp.inequalities;
    let on_slack = found
        .multipliers
        .largest_on_slack(|at| (rows.softness[at] == Softness::Hard).then(|| rows.groups[at]));
    // No row may be cheaper to violate at the price of its slack.
    let keeps_rows = on_slack <= INSIDE * qp.elastic_weight;
    (can_be_polished(qp, &found) && keeps_rows).then(|| QpSolution {
        working: qp.first_rows(),
        ..found
    })
}

impl<'a> Conditions<'a> {
    fn of(qp: &'a QuadraticProgram<'a>, solution: &QpSolution, clue: Clue) -> Self {
        let evidence = Evidence::of(qp, solution, clue);
        let (mut active, given_up) = evidence.constraints();
        let slack_groups = evidence.slack_groups();
        let (rows, paid) = evidence.inequalities(&slack_groups);
        active.extend(rows);
        let before = moved(qp.variables, &solution.change);
        active.extend(evidence.sets(&before));
        let (hessian, gradient) = objective(qp, slack_groups.len(), &paid, &given_up);
        Self {
            qp,
            before,
            active,
            paid,
            given_up,
            slack_groups,
            hessian,
            gradient,
        }
    }

    /// Returns the unknown that is the slack of a hard row, if that slack is positive.
    fn slack_of(&self, at: usize) -> Option<usize> {
        open_slack(&self.qp.inequalities, &self.slack_groups, at)
            .map(|place| self.qp.gradient.len() + place)
    }

    /// Returns the multipliers of the active rows at a solution.
    fn multipliers(&self, solution: &QpSolution) -> Vec<f64> {
        (self.active.iter())
            .map(|&active| self.multiplier(active, solution))
            .collect()
    }

    fn multiplier(&self, active: Active, solution: &QpSolution) -> f64 {
        let multipliers = &solution.multipliers;
        match active {
            Active::Constraint(i) => multipliers.constraints[i],
            Active::Inequality(at) => multipliers.inequalities[at],
            Active::Center(set, row) => multipliers.normals[set][row],
            Active::Set(at) => match self.qp.sets[at] {
                ConvexSet::Ball { .. } => norm(&multipliers.normals[at]),
                _ => multipliers.normals[at][0],
            },
        }
    }

    /// Returns value and gradient of an active row: of an interval, on the side that the sign of the multiplier tells; of a ball,
    /// `|Mv|²/(2r) - r/2`.
    fn row(&self, active: Active, change: &[f64], multiplier: f64) -> (f64, Vec<(usize, f64)>) {
        let qp = self.qp;
        let dense = |matrix: &Mat<f64>, row: usize, offset: f64, slack: Option<usize>| {
            let own = (0..qp.gradient.len()).map(|j| (j, matrix[(row, j)]));
            let gradient: Vec<_> = own.chain(slack.map(|at| (at, -1.0))).collect();
            (offset + along(&gradient, change), gradient)
        };
        match active {
            Active::Constraint(i) => dense(qp.jacobian, i, qp.offset[i], None),
            Active::Inequality(at) => {
                let rows = &qp.inequalities;
                dense(rows.jacobian, at, rows.offset[at], self.slack_of(at))
            }
            Active::Center(set, row) => {
                let there = moved(qp.variables, change);
                let ConvexSet::Ball { rows, .. } = &qp.sets[set] else {
                    unreachable!("only balls have a center")
                };
                (along(&rows[row], &there), rows[row].clone())
            }
            Active::Set(at) => {
                let there = moved(qp.variables, change);
                match &qp.sets[at] {
                    ConvexSet::Interval {
                        index,
                        lower,
                        upper,
                    } => {
                        let bound = if multiplier < 0.0 { lower } else { upper };
                        (there[*index] - bound, vec![(*index, 1.0)])
                    }
                    ConvexSet::HalfSpace { direction, limit } => {
                        (along(direction, &there) - limit, direction.clone())
                    }
                    ConvexSet::Ball { rows, radius } => {
                        let inside: Vec<f64> = rows.iter().map(|row| along(row, &there)).collect();
                        let square: f64 = inside.iter().map(|u| u * u).sum();
                        let gradient = rows.iter().zip(&inside).flat_map(|(row, u)| {
                            row.iter().map(move |&(index, c)| (index, c * u / radius))
                        });
                        (0.5 * (square / radius - radius), gradient.collect())
                    }
                }
            }
        }
    }

    /// Returns the gradient of the Lagrangian, followed by the values of the active rows.
    fn residual(&self, change: &[f64], multipliers: &[f64]) -> Vec<f64> {
        let mut out = self.gradient.clone();
        for (j, d) in change.iter().enumerate() {
            for (o, h) in out.iter_mut().zip(self.hessian.col_as_slice(j)) {
                *o += h * d;
            }
        }
        for (&active, &y) in self.active.iter().zip(multipliers) {
            let (value, gradient) = self.row(active, change, y);
            for (index, c) in gradient {
                out[index] += y * c;
            }
            out.push(value);
        }
        out
    }

    /// Takes one Newton step and returns the residual after it; `None` if that is not finite or the solve was stopped.
    fn improve(
        &self,
        change: &mut [f64],
        multipliers: &mut [f64],
        residual: &[f64],
    ) -> Option<Vec<f64>> {
        let matrix = self.matrix(change, multipliers);
        let right = Mat::from_fn(residual.len(), 1, |i, _| -residual[i]);
        let stop = self.qp.stop.cloned().unwrap_or_default();
        let step = stop
            .unless_raised(residual.len(), move || {
                matrix.partial_piv_lu().solve(&right)
            })
            .ok()?;
        for (i, v) in change.iter_mut().chain(multipliers.iter_mut()).enumerate() {
            *v += step[(i, 0)];
        }
        let next = self.residual(change, multipliers);
        next.iter().all(|r| r.is_finite()).then_some(next)
    }

    /// Tells whether the residual is rounding.
    fn is_exact(&self, residual: &[f64], change: &[f64], multipliers: &[f64]) -> bool {
        let (gradient, rows) = residual.split_at(change.len());
        let pull = infinity_norm(&self.gradient).max(infinity_norm(multipliers));
        let size = infinity_norm(&moved(self.qp.variables, change)).max(1.0);
        infinity_norm(gradient) <= EXACT * pull && infinity_norm(rows) <= EXACT * size
    }

    fn matrix(&self, change: &[f64], multipliers: &[f64]) -> Mat<f64> {
        let n = change.len();
        let size = n + self.active.len();
        let largest = (0..n).map(|i| self.hessian[(i, i)]).fold(0.0, f64::max);
        let mut out = Mat::zeros(size, size);
        for j in 0..n {
            for i in 0..n {
                out[(i, j)] = self.hessian[(i, j)];
            }
        }
        for (at, (&active, &y)) in self.active.iter().zip(multipliers).enumerate() {
            let (_, gradient) = self.row(active, change, y);
            let mut square = 0.0;
            for (index, c) in gradient {
                out[(index, n + at)] += c;
                out[(n + at, index)] += c;
                square += c * c;
            }
            out[(n + at, n + at)] = -REGULARIZATION * square / largest.max(f64::MIN_POSITIVE);
            if let Active::Set(set) = active
                && let ConvexSet::Ball { rows, radius } = &self.qp.sets[set]
            {
                for row in rows {
                    for &(i, a) in row {
                        for &(j, b) in row {
                            out[(i, j)] += y * a * b / radius;
                        }
                    }
                }
            }
        }
        out
    }

    /// Tells whether the inactive conditions hold and the multipliers of the active ones have the right sign.
    fn allows(&self, change: &[f64], multipliers: &[f64]) -> bool {
        let qp = self.qp;
        let there = moved(qp.variables, change);
        let largest = infinity_norm(multipliers).max(infinity_norm(&self.gradient));
        let signs = (self.active.iter().zip(multipliers)).all(|(active, y)| match active {
            Active::Center(..) => true,
            Active::Constraint(_) => y.abs() <= qp.elastic_weight + ROUNDING * largest,
            Active::Inequality(at) => {
                let price = match qp.inequalities.softness[*at] {
                    Softness::Hard => f64::INFINITY,
                    Softness::Soft { linear, .. } => linear,
                };
                *y >= -ROUNDING * largest && *y <= price + ROUNDING * largest
            }
            Active::Set(at) => {
                matches!(qp.sets[*at], ConvexSet::Interval { .. }) || *y >= -ROUNDING * largest
            }
        });
        let (change, slacks) = change.split_at(qp.gradient.len());
        let of_constraints = qp.constraints_along(change);
        let open = slacks.iter().all(|slack| *slack >= -ROUNDING)
            && (self.given_up.iter()).all(|&(i, sign)| sign * of_constraints[i] >= -ROUNDING);
        let values = qp.inequalities.along(change);
        let paid = |at: usize| self.paid.iter().any(|(row, ..)| *row == at);
        let rows = (values.iter().enumerate()).all(|(at, h)| {
            let is_free = qp.inequalities.softness[at] == Softness::FREE;
            if paid(at) {
                *h >= -ROUNDING
            } else {
                let slack = self
                    .slack_of(at)
                    .map_or(0.0, |at| slacks[at - change.len()]);
                is_free || *h - slack <= qp.row_tolerance.max(ROUNDING)
            }
        });
        // Violations of sets up to rounding of the variables, or up to Clarabel's own, are allowed.
        let rounding = SET_ROUNDING * infinity_norm(&there).max(1.0);
        let sets = (qp.sets.iter()).all(|set| {
            set.violation(&there)
                <= set
                    .violation(&self.before)
                    .max(rounding * set.gradient_size())
        });
        signs && open && rows && sets
    }

    /// Returns the solution with its multipliers in the form of Clarabel's.
    fn solution(&self, old: &QpSolution, mut change: Vec<f64>, multipliers: &[f64]) -> QpSolution {
        let mut out = old.clone();
        let slacks = change.split_off(self.qp.gradient.len());
        let of_constraints = self.qp.constraints_along(&change);
        out.slacks.values_mut().for_each(|slack| *slack = 0.0);
        for (group, slack) in self.slack_groups.iter().zip(&slacks) {
            out.slacks.insert(*group, slack.max(0.0));
        }
        let of_given_up = self.given_up.iter().map(|&(i, _)| of_constraints[i].abs());
        out.slack = out
            .slacks
            .values()
            .chain(&of_given_up.collect::<Vec<_>>())
            .sum();
        for &(i, sign) in &self.given_up {
            out.multipliers.constraints[i] = sign * self.qp.elastic_weight;
        }
        out.multipliers.inequalities.fill(0.0);
        for normal in &mut out.multipliers.normals {
            normal.fill(0.0);
        }
        let rows = &self.qp.inequalities;
        let values = rows.along(&change);
        for &(at, linear, quadratic) in &self.paid {
            out.multipliers.inequalities[at] = linear + quadratic * values[at].max(0.0);
        }
        let there = moved(self.qp.variables, &change);
        for (&active, &y) in self.active.iter().zip(multipliers) {
            match active {
                Active::Constraint(i) => out.multipliers.constraints[i] = y,
                Active::Inequality(at) => out.multipliers.inequalities[at] = y.max(0.0),
                Active::Center(set, row) => out.multipliers.normals[set][row] = y,
                Active::Set(at) => match &self.qp.sets[at] {
                    ConvexSet::Ball { rows, radius } => {
                        for (z, row) in out.multipliers.normals[at].iter_mut().zip(rows) {
                            *z = y.max(0.0) * along(row, &there) / radius;
                        }
                    }
                    ConvexSet::Interval { .. } => out.multipliers.normals[at][0] = y,
                    ConvexSet::HalfSpace { .. } => out.multipliers.normals[at][0] = y.max(0.0),
                },
            }
        }
        out.change = change;
        out
    }
}

/// Returns Hessian and gradient of the objective along `δ` and `n_slacks` slacks, with the penalties of violated soft rows `paid` and the
/// prices of constraints that are `given_up`.
fn objective(
    qp: &QuadraticProgram,
    n_slacks: usize,
    paid: &[(usize, f64, f64)],
    given_up: &[(usize, f64)],
) -> (Mat<f64>, Vec<f64>) {
    let rows = &qp.inequalities;
    let n = qp.gradient.len();
    let size = n + n_slacks;
    let mut hessian = Mat::zeros(size, size);
    hessian.submatrix_mut(0, 0, n, n).copy_from(qp.hessian);
    let mut gradient = qp.gradient.to_vec();
    for &(at, linear, quadratic) in paid {
        for j in 0..n {
            let d = rows.jacobian[(at, j)];
            gradient[j] += (linear + quadratic * rows.offset[at]) * d;
            for i in 0..n {
                hessian[(i, j)] += quadratic * rows.jacobian[(at, i)] * d;
            }
        }
    }
    for &(i, sign) in given_up {
        for (j, g) in gradient.iter_mut().enumerate() {
            *g += sign * qp.elastic_weight * qp.jacobian[(i, j)];
        }
    }
    gradient.resize(size, qp.elastic_weight);
    (hessian, gradient)
}

/// Returns the position, among the groups with positive slack, of the group of a hard row.
fn open_slack(rows: &LinearInequalities, slack_groups: &[usize], at: usize) -> Option<usize> {
    let group = rows.groups[at];
    (rows.softness[at] == Softness::Hard)
        .then(|| slack_groups.iter().position(|&open| open == group))
        .flatten()
}

fn moved(variables: &[f64], change: &[f64]) -> Vec<f64> {
    variables.iter().zip(change).map(|(v, d)| v + d).collect()
}
