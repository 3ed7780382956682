//! The part of the objective that depends on the variables alone: effort, rate, residuals of soft goals, and the price of the
//! duration.

use faer::Mat;

use super::problem::{GoalRow, OptimalControlProblem};

/// `½ vᵀ (s E + R/s + W) v + w s` over controls and soft residuals `v` and the duration `s` over that of the grid; `s = 1` where that is
/// fixed.
#[derive(Clone, Debug)]
pub(super) struct ControlCost {
    /// `E + R + W`.
    fixed: Mat<f64>,
    /// What a free duration changes.
    timed: Option<Timed>,
}

#[derive(Clone, Debug)]
struct Timed {
    /// Variable of the duration.
    at: usize,
    /// `w`
    price: f64,
    /// `E`: weighted effort.
    effort: Mat<f64>,
    /// `R`: weighted rate.
    rate: Mat<f64>,
}

/// `Ev`, `Rv`, and their products with `v`.
struct Along {
    by_effort: Vec<f64>,
    by_rate: Vec<f64>,
    effort: f64,
    rate: f64,
}

impl Timed {
    fn along(&self, variables: &[f64]) -> Along {
        let [by_effort, by_rate] = [&self.effort, &self.rate].map(|m| product(m, variables));
        Along {
            effort: dot(variables, &by_effort),
            rate: dot(variables, &by_rate),
            by_effort,
            by_rate,
        }
    }
}

impl ControlCost {
    pub(super) fn of(
        problem: &OptimalControlProblem,
        n_components: usize,
        goal_rows: &[GoalRow],
        slack_variables: &[Option<usize>],
    ) -> Self {
        let n = problem.n_variables();
        let spread = |weight: f64, matrix: &Mat<f64>| {
            let mut out = Mat::zeros(n, n);
            for i in 0..matrix.nrows() {
                for j in 0..matrix.ncols() {
                    for c in 0..n_components {
                        out[(i * n_components + c, j * n_components + c)] = weight * matrix[(i, j)];
                    }
                }
            }
            out
        };
        let effort = spread(problem.objective.effort, &problem.control.effort_matrix());
        let rate = spread(problem.objective.rate, &problem.control.rate_matrix());
        let mut fixed = &effort + &rate;
        for (row, variable) in goal_rows.iter().zip(slack_variables) {
            if let Some(variable) = *variable {
                fixed[(variable, variable)] = problem.soft_weight(row).unwrap_or(0.0);
            }
        }
        Self {
            fixed,
            timed: problem.duration_variable().map(|at| Timed {
                at,
                price: problem.duration_price(),
                effort,
                rate,
            }),
        }
    }

    /// Value and gradient.
    pub(super) fn value(&self, variables: &[f64]) -> (f64, Vec<f64>) {
        let mut gradient = product(&self.fixed, variables);
        let mut value = 0.5 * dot(variables, &gradient);
        if let Some(timed) = &self.timed {
            let s = variables[timed.at];
            let along = timed.along(variables);
            for (i, g) in gradient.iter_mut().enumerate() {
                *g += (s - 1.0) * along.by_effort[i] + (1.0 / s - 1.0) * along.by_rate[i];
            }
            let (effort, rate) = (along.effort, along.rate);
            value += 0.5 * ((s - 1.0) * effort + (1.0 / s - 1.0) * rate) + timed.price * s;
            gradient[timed.at] = 0.5 * (effort - rate / (s * s)) + timed.price;
        }
        (value, gradient)
    }

    /// Positive semidefinite Hessian: of the least squares `|√s √E v|²` and `|√(R/s) v|²`; exact where the duration is fixed.
    pub(super) fn gauss_newton(&self, variables: &[f64]) -> Mat<f64> {
        let mut out = self.fixed.clone();
        if let Some(timed) = &self.timed {
            let (at, s) = (timed.at, variables[timed.at]);
            let along = timed.along(variables);
            for j in 0..out.ncols() {
                for i in 0..out.nrows() {
                    out[(i, j)] +=
                        (s - 1.0) * timed.effort[(i, j)] + (1.0 / s - 1.0) * timed.rate[(i, j)];
                }
            }
            for i in 0..at {
                let across = 0.5 * (along.by_effort[i] - along.by_rate[i] / (s * s));
                out[(i, at)] = across;
                out[(at, i)] = across;
            }
            out[(at, at)] = 0.25 * (along.effort / s + along.rate / (s * s * s));
        }
        out
    }
}

fn product(matrix: &Mat<f64>, v: &[f64]) -> Vec<f64> {
    (0..v.len())
        .map(|i| {
            (v.iter().enumerate())
                .map(|(j, v)| matrix[(i, j)] * v)
                .sum()
        })
        .collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
