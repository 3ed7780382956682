//! Quasi-Newton matrices of the Lagrangian over the variables.

use faer::Mat;

use super::program::Linearization;

/// How a step changes the matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Formula {
    /// Damped BFGS: stays positive definite (Powell 1978; Nocedal & Wright 2006, procedure 18.2).
    Bfgs,
    /// Symmetric rank one: follows negative curvature too (Nocedal & Wright 2006, section 6.2).
    Sr1,
}

/// An approximation `B` of the Hessian of the Lagrangian.
#[derive(Clone, Debug)]
pub struct QuasiNewton {
    /// `B`, symmetric.
    pub matrix: Mat<f64>,
    formula: Formula,
    /// Nothing learned yet.
    is_fresh: bool,
}

/// Curvature along a step that BFGS insists on, as a part of what it has there.
const DAMPING: f64 = 0.2;
/// SR1 skips updates whose denominator is this much smaller than its factors.
const SKIP: f64 = 1e-6;

impl QuasiNewton {
    /// The Gauss-Newton Hessian, and where that is singular a little more.
    #[must_use]
    pub fn new(linearization: &Linearization, formula: Formula) -> Self {
        let mut matrix = linearization.gauss_newton.clone();
        let floor = FLOOR * linearization.least_curvature();
        for i in 0..matrix.nrows() {
            matrix[(i, i)] += floor;
        }
        Self {
            matrix,
            formula,
            is_fresh: true,
        }
    }

    /// Learns that the gradient of the Lagrangian changed by `change` over `step`.
    pub fn update(&mut self, step: &[f64], change: &[f64]) {
        let n = step.len();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let length = dot(step, step);
        let along = dot(step, change);
        if !(length > 0.0) || !change.iter().all(|y| y.is_finite()) {
            return;
        }
        if self.is_fresh
            && (0..n).all(|i| self.matrix[(i, i)] == self.matrix[(0, 0)])
            && along > 0.0
        {
            // A multiple of the identity knows no scale but this one (Shanno & Phua 1978).
            let scale = dot(change, change) / along;
            self.matrix = Mat::from_fn(n, n, |i, j| if i == j { scale } else { 0.0 });
        }
        self.is_fresh = false;
        let bent: Vec<f64> = (0..n)
            .map(|i| (0..n).map(|j| self.matrix[(i, j)] * step[j]).sum())
            .collect();
        let curvature = dot(step, &bent);
        match self.formula {
            Formula::Bfgs => {
                let theta = if along >= DAMPING * curvature {
                    1.0
                } else {
                    (1.0 - DAMPING) * curvature / (curvature - along)
                };
                let damped: Vec<f64> = (change.iter().zip(&bent))
                    .map(|(y, b)| theta * y + (1.0 - theta) * b)
                    .collect();
                let found = dot(step, &damped);
                if !(found > 0.0 && curvature > 0.0) {
                    return;
                }
                for j in 0..n {
                    for i in 0..n {
                        self.matrix[(i, j)] +=
                            damped[i] * damped[j] / found - bent[i] * bent[j] / curvature;
                    }
                }
            }
            Formula::Sr1 => {
                let rest: Vec<f64> = change.iter().zip(&bent).map(|(y, b)| y - b).collect();
                let denominator = dot(&rest, step);
                if !(denominator.abs() > SKIP * (dot(&rest, &rest) * length).sqrt()) {
                    return;
                }
                for j in 0..n {
                    for i in 0..n {
                        self.matrix[(i, j)] += rest[i] * rest[j] / denominator;
                    }
                }
            }
        }
    }
}

/// Curvature that a singular Gauss-Newton Hessian begins with, relative to its least positive one.
const FLOOR: f64 = 1e-4;

#[cfg(test)]
mod tests {
    use super::*;

    fn start(n: usize, formula: Formula) -> QuasiNewton {
        QuasiNewton {
            matrix: Mat::identity(n, n),
            formula,
            is_fresh: false,
        }
    }

    /// After an update `B s = y`; of BFGS where the curvature along the step is positive.
    #[test]
    fn secant_equation_holds() {
        let (step, change) = ([1.0, -2.0, 0.5], [3.0, -1.0, 2.0]);
        for formula in [Formula::Bfgs, Formula::Sr1] {
            let mut b = start(3, formula);
            b.update(&step, &change);
            for i in 0..3 {
                let row: f64 = (0..3).map(|j| b.matrix[(i, j)] * step[j]).sum();
                assert!((row - change[i]).abs() < 1e-14, "{formula:?}");
            }
        }
    }

    /// Negative curvature: BFGS keeps a fifth of what it had along the step, SR1 takes it as it is.
    #[test]
    fn damping_keeps_bfgs_positive() {
        let (step, change) = ([1.0, 0.0], [-4.0, 0.0]);
        let mut b = start(2, Formula::Bfgs);
        b.update(&step, &change);
        assert!((b.matrix[(0, 0)] - DAMPING).abs() < 1e-14);
        let mut b = start(2, Formula::Sr1);
        b.update(&step, &change);
        assert!((b.matrix[(0, 0)] + 4.0).abs() < 1e-14);
    }

    /// On a quadratic, SR1 has the Hessian after as many independent steps as there are variables (Nocedal & Wright
    /// 2006, theorem 6.1).
    #[test]
    fn sr1_finds_a_quadratic() {
        let hessian = [[2.0, 1.0, 0.0], [1.0, -3.0, 0.5], [0.0, 0.5, 4.0]];
        let mut b = start(3, Formula::Sr1);
        for k in 0..3 {
            let step: Vec<f64> = (0..3).map(|i| if i == k { 1.0 } else { 0.3 }).collect();
            let change: Vec<f64> = (0..3)
                .map(|i| (0..3).map(|j| hessian[i][j] * step[j]).sum())
                .collect();
            b.update(&step, &change);
        }
        for i in 0..3 {
            for j in 0..3 {
                assert!((b.matrix[(i, j)] - hessian[i][j]).abs() < 1e-12);
            }
        }
    }
}
