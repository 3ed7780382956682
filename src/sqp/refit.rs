//! Back to what a step promised, by Newton's method.
//!
//! Second-order corrections of a step go by the linearization that the step left. Where rows bend so much that this no longer leads back
//! (a light tip whose fast waves change their phase with every change of shape), the linearization of the trial point itself still does: of
//! all changes of the variables that keep the promise to first order, the shortest is taken,
//!
//! ```text
//! minimize |δ|   subject to   c + C δ = c̄,   h + D δ = max(h̄, 0)
//! ```
//!
//! with the promised values `c̄`, `h̄` of the rows that the step holds or the trial violates.

use faer::Mat;

use super::balls::change_into_balls;
use super::kkt::norm;
use super::program::{
    ConvexSet, Evaluation, LiftedProgram, Linearization, LinearizationRequest, Softness, along,
};
use super::quadratic_program::peaks;

/// A row, or a set, that is nearer to its limit than this is held.
const HELD: f64 = 1e-8;
/// Directions in which rows change by less than this part of what they do in the steepest one are left alone.
const RANK: f64 = 1e-12;

/// Values that a step promises to first order.
pub(super) struct Promise<'a> {
    linearization: &'a Linearization,
    softness: &'a [Softness],
    constraints: Vec<f64>,
    inequalities: Vec<f64>,
}

impl<'a> Promise<'a> {
    /// What the linearization says of a step.
    pub(super) fn of(
        linearization: &'a Linearization,
        softness: &'a [Softness],
        change: &[f64],
    ) -> Self {
        Self {
            linearization,
            softness,
            constraints: linearization.constraints_along(change),
            inequalities: linearization.inequalities_along(change),
        }
    }

    /// `Σ|c - c̄| + Σ max(h - max(h̄, 0), 0)` over the constraints and the hard ones of the linearized inequalities.
    pub(super) fn missed_by<R>(&self, evaluation: &Evaluation<R>) -> f64 {
        let constraints: f64 = self.constraints_off(evaluation).map(f64::abs).sum();
        let inequalities = (self.softness.iter().enumerate())
            .filter(|(_, softness)| **softness == Softness::Hard)
            .map(|(at, _)| self.inequality_off(evaluation, at))
            .filter(|off| !(*off <= 0.0));
        inequalities.fold(constraints, |sum, off| sum + off)
    }

    fn constraints_off<R>(&self, evaluation: &Evaluation<R>) -> impl Iterator<Item = f64> {
        (evaluation.constraints.iter().zip(&self.constraints))
            .map(|(value, promised)| value - promised)
    }

    fn inequality_off<R>(&self, evaluation: &Evaluation<R>, at: usize) -> f64 {
        evaluation.inequalities[self.linearization.rows[at]] - self.inequalities[at].max(0.0)
    }

    /// Places, ascending, of the hard inequalities that the step holds, and, among neighbors, of the worst of those that miss their promise.
    fn held<R>(&self, evaluation: &Evaluation<R>) -> Vec<usize> {
        let hard = (0..self.inequalities.len()).filter(|&at| self.softness[at] == Softness::Hard);
        let (mut held, others): (Vec<usize>, Vec<usize>) =
            hard.partition(|&at| self.inequalities[at].abs() <= HELD);
        let missed: Vec<(usize, f64)> = (others.into_iter())
            .map(|at| (at, self.inequality_off(evaluation, at)))
            .filter(|(_, off)| *off > 0.0)
            .collect();
        held.extend(peaks(&missed).into_iter().map(|(at, _)| at));
        held.sort_unstable();
        held
    }

    /// The shortest change of the variables of `point` that keeps the promise to first order and leaves no convex set; `None` where there is
    /// none, or the model fails.
    pub(super) fn correction<P: LiftedProgram>(
        &self,
        program: &P,
        point: &P::Point,
        evaluation: &Evaluation<P::Defects>,
    ) -> Option<Vec<f64>> {
        let held = self.held(evaluation);
        let request = LinearizationRequest {
            multipliers: None,
            rows: &(held.iter().map(|&at| self.linearization.rows[at])).collect::<Vec<usize>>(),
        };
        let here = program.linearize(point, evaluation, &request).ok()?;
        let variables = program.variables(point);
        let n = variables.len();
        let mut rows: Vec<(Vec<f64>, f64)> = (self.constraints_off(evaluation).enumerate())
            .map(|(i, off)| ((0..n).map(|j| here.jacobian[(i, j)]).collect(), -off))
            .collect();
        rows.extend(held.iter().enumerate().map(|(i, &at)| {
            let row = (0..n).map(|j| here.inequality_jacobian[(i, j)]);
            (row.collect(), -self.inequality_off(evaluation, at))
        }));
        let size = norm(variables).max(1.0);
        let touched = (program.sets().iter())
            .filter(|set| set.violation(variables) > -HELD * set.gradient_size() * size);
        rows.extend(touched.map(|set| (outward(set, variables), 0.0)));
        let change = shortest(&rows, n)?;
        let change = change_into_balls(variables, &change, program.sets().iter());
        let end: Vec<f64> = variables.iter().zip(&change).map(|(v, d)| v + d).collect();
        let is_inside = |set: &ConvexSet| set.violation(&end) <= HELD * set.gradient_size() * size;
        program.sets().iter().all(is_inside).then_some(change)
    }
}

/// Direction in which the violation of a set grows.
fn outward(set: &ConvexSet, variables: &[f64]) -> Vec<f64> {
    let mut direction = vec![0.0; variables.len()];
    match set {
        ConvexSet::Interval { index, .. } => direction[*index] = 1.0,
        ConvexSet::HalfSpace { direction: own, .. } => {
            own.iter().for_each(|&(j, c)| direction[j] += c);
        }
        ConvexSet::Ball { rows, .. } => {
            for row in rows {
                let inside = along(row, variables);
                row.iter().for_each(|&(j, c)| direction[j] += inside * c);
            }
        }
    }
    direction
}

/// The shortest `δ` with `row · δ = value` for all, or the one that comes nearest; rows are counted in their own length.
fn shortest(rows: &[(Vec<f64>, f64)], n: usize) -> Option<Vec<f64>> {
    if rows.is_empty() {
        return Some(vec![0.0; n]);
    }
    let lengths: Vec<f64> = rows.iter().map(|(row, _)| norm(row)).collect();
    if lengths.iter().any(|length| !length.is_finite()) {
        return None;
    }
    let unit = |i: usize| if lengths[i] > 0.0 { lengths[i] } else { 1.0 };
    let matrix = Mat::from_fn(rows.len(), n, |i, j| rows[i].0[j] / unit(i));
    let values = Mat::from_fn(rows.len(), 1, |i, _| rows[i].1 / unit(i));
    let parts = matrix.thin_svd().ok()?;
    let sizes = parts.S().column_vector();
    let mut coordinates = parts.U().transpose() * &values;
    for i in 0..coordinates.nrows() {
        let counts = sizes[i] > RANK * sizes[0];
        coordinates[(i, 0)] = if counts {
            coordinates[(i, 0)] / sizes[i]
        } else {
            0.0
        };
    }
    let change = parts.V() * &coordinates;
    Some((0..n).map(|j| change[(j, 0)]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dot(a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).map(|(x, y)| x * y).sum()
    }

    /// It meets every row, and has no part that no row asks for; rows in other units, or said twice, change nothing.
    #[test]
    fn shortest_change() {
        let rows = vec![
            (vec![1.0, 2.0, 0.0, -1.0], 3.0),
            (vec![0.0, 1.0, 1e-3, 0.5], -2.0),
        ];
        let change = shortest(&rows, 4).expect("finite");
        for (row, value) in &rows {
            assert!((dot(row, &change) - value).abs() < 1e-13);
        }
        for across in [[-2.0, 1.0, -1e3, 0.0], [1.0, 0.0, -5e2, 1.0]] {
            assert!(rows.iter().all(|(row, _)| dot(row, &across).abs() < 1e-12));
            assert!(dot(&across, &change).abs() < 1e-10);
        }
        let mut others = rows.clone();
        others[0] = (rows[0].0.iter().map(|c| 1e14 * c).collect(), 3e14);
        others.push((rows[1].0.iter().map(|c| 1e-9 * c).collect(), -2e-9));
        let again = shortest(&others, 4).expect("finite");
        for (a, b) in change.iter().zip(&again) {
            assert!((a - b).abs() < 1e-12 * norm(&change));
        }
    }
}
