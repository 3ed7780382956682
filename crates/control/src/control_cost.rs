//! The part of the objective that depends on the variables alone: effort, rate, and penalties on the residuals of soft goals.

use faer::Mat;

use super::problem::{Component, GoalRow, OptimalControlProblem};

/// `½ vᵀ (E + R + W) v + w τ`: weighted effort and rate of the controls, and the penalties of the soft residuals among the variables `v`;
/// `τ` is the last variable of a [relaxed](super::transcription) program.
#[derive(Clone, Debug)]
pub(super) struct ControlCost {
    hessian: Mat<f64>,
    /// Price `w` of `τ`; `None` if the program is not relaxed.
    shortfall: Option<f64>,
}

impl ControlCost {
    pub(super) fn of(
        problem: &OptimalControlProblem,
        components: &[Component],
        goal_rows: &[GoalRow],
        slack_variables: &[Option<usize>],
        shortfall: Option<f64>,
    ) -> Self {
        let n = problem.n_variables() + usize::from(shortfall.is_some());
        let spread = |weight: f64, matrix: &Mat<f64>| {
            let mut out = Mat::zeros(n, n);
            for i in 0..matrix.nrows() {
                for j in 0..matrix.ncols() {
                    for (c, component) in components.iter().enumerate() {
                        let channel = problem.channel(component);
                        let part = channel.unit() / channel.scale;
                        out[(i * components.len() + c, j * components.len() + c)] =
                            weight * part * part * matrix[(i, j)];
                    }
                }
            }
            out
        };
        let mut hessian = spread(problem.objective.effort, &problem.control.effort_matrix());
        hessian += spread(problem.objective.rate, &problem.control.rate_matrix());
        for (row, variable) in goal_rows.iter().zip(slack_variables) {
            if let Some(variable) = *variable {
                let unit = problem.slack_unit(row);
                hessian[(variable, variable)] =
                    problem.soft_weight(row).unwrap_or(0.0) * unit * unit;
            }
        }
        Self { hessian, shortfall }
    }

    /// Returns value and gradient.
    pub(super) fn value(&self, variables: &[f64]) -> (f64, Vec<f64>) {
        let mut gradient = product(&self.hessian, variables);
        let mut value = 0.5 * dot(variables, &gradient);
        if let (Some(weight), Some(shortfall), Some(slope)) =
            (self.shortfall, variables.last(), gradient.last_mut())
        {
            value += weight * shortfall;
            *slope += weight;
        }
        (value, gradient)
    }

    /// Returns the Hessian, which is positive semidefinite.
    pub(super) fn hessian(&self) -> &Mat<f64> {
        &self.hessian
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
