//! Soft rows of a sample's quadratic program, which may be violated with a penalty.
//!
//! A row `r = r₀ + j·x` costs `w₁ σ + ½ w₂ σ²` with `σ = max(r, 0)`. In the interior-point method `σ` is a variable of its own, with
//!
//! ```text
//! s₁ = σ - r ≥ 0,  s₂ = σ ≥ 0,      w₁ + w₂ σ = y₁ + y₂,      y₁ s₁ = y₂ s₂ = τ
//! ```
//!
//! which Newton's step eliminates: with `a = y₁/s₁`, `b = y₂/s₂`, `D = w₂ + a + b` and `c = w₁ + w₂ σ - τ/s₁ - τ/s₂`, the row adds `a (w₂ +
//! b)/D j jᵀ` to the matrix and `j (τ/s₁ + a c/D)` to the gradient, and its own step is `Δσ = (a j·Δx - c)/D`. With a price above the
//! multiplier that the row would have as a constraint, the row holds (an exact penalty; Nocedal and Wright 2006, section 17.2).

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};

/// Fraction of the way to zero that a multiplier may go: Boyd and Vandenberghe 2004, page 613.
pub(super) const INSIDE: f64 = 0.99;

/// Rows with penalties, and the memory of their steps.
#[derive(Debug)]
pub struct SoftRows {
    /// `r` at `x = 0`, one per row.
    pub values: Vec<f64>,
    /// `w₁` and `w₂`.
    pub prices: Vec<[f64; 2]>,
    /// `j`: one column per row.
    pub slopes: Mat<f64>,
    weighted: Mat<f64>,
    r: Vec<f64>,
    sigma: Vec<f64>,
    y: Vec<[f64; 2]>,
    /// Steps of `r`, `σ` and `y`.
    along: Vec<[f64; 4]>,
}

impl SoftRows {
    /// Creates memory for `n` variables and at most `most` rows.
    pub fn new(n: usize, most: usize) -> Self {
        Self {
            values: Vec::with_capacity(most),
            prices: Vec::with_capacity(most),
            slopes: Mat::zeros(n, most),
            weighted: Mat::zeros(n, most),
            r: vec![0.0; most],
            sigma: vec![0.0; most],
            y: vec![[0.0; 2]; most],
            along: vec![[0.0; 4]; most],
        }
    }

    /// Returns the number of rows.
    #[must_use]
    pub fn n_rows(&self) -> usize {
        self.values.len()
    }

    /// Returns the penalty of the rows at `x = 0`.
    pub fn cost(&self) -> f64 {
        (self.values.iter().zip(&self.prices))
            .map(|(r, [w1, w2])| {
                let sigma = r.max(0.0);
                sigma * (w1 + 0.5 * w2 * sigma)
            })
            .sum()
    }

    /// Returns the largest value of a row at `x`; negative infinity without rows.
    pub fn largest(&self, x: &[f64]) -> f64 {
        (0..self.n_rows())
            .map(|i| self.value(i, x))
            .fold(f64::NEG_INFINITY, f64::max)
    }

    /// Returns the value of a row at `x`.
    pub fn value(&self, row: usize, x: &[f64]) -> f64 {
        self.values[row] + self.times(row, x)
    }

    /// Returns the multiplier of a row in the last solve, divided by the price that a violation of nothing has: 1 where the row gives way.
    /// It is zero if no set and no row bound the solution.
    pub fn share(&self, row: usize) -> f64 {
        self.y[row][0] / self.prices[row][0]
    }

    fn times(&self, row: usize, x: &[f64]) -> f64 {
        let slopes = self.slopes.col_as_slice(row);
        slopes.iter().zip(x).map(|(j, x)| j * x).sum()
    }

    /// Sets slacks and multipliers at `x` to the products `product`, as far as the prices allow.
    pub fn start(&mut self, x: &[f64], product: f64) {
        for i in 0..self.n_rows() {
            let r = self.value(i, x);
            let [w1, w2] = self.prices[i];
            let violated = r.max(0.0);
            let sigma = violated + 2.0 * product / (w1 + w2 * violated);
            let price = w1 + w2 * sigma;
            let first = (0.5 * price).min(product / (sigma - r));
            self.r[i] = r;
            self.sigma[i] = sigma;
            self.y[i] = [first, price - first];
        }
    }

    /// Returns the sum of the products of slacks and multipliers.
    pub fn gap(&self) -> f64 {
        (0..self.n_rows())
            .map(|i| {
                let [y1, y2] = self.y[i];
                y1 * (self.sigma[i] - self.r[i]) + y2 * self.sigma[i]
            })
            .sum()
    }

    /// Adds the terms of the rows to the lower half of the matrix and to minus the gradient, for the products `target`.
    pub fn assemble(&mut self, target: f64, matrix: &mut Mat<f64>, direction: &mut Mat<f64>) {
        let m = self.n_rows();
        if m == 0 {
            return;
        }
        for i in 0..m {
            let Terms { a, b, d, c, pull } = self.terms(i, target);
            let [_, w2] = self.prices[i];
            let root = (a * (w2 + b) / d).sqrt();
            let push = pull + a * c / d;
            let slopes = self.slopes.col_as_slice(i);
            for (out, j) in self.weighted.col_as_slice_mut(i).iter_mut().zip(slopes) {
                *out = root * j;
            }
            for (k, j) in slopes.iter().enumerate() {
                direction[(k, 0)] -= push * j;
            }
        }
        let weighted = self.weighted.as_ref().subcols(0, m);
        let transposed = weighted.transpose();
        matmul(matrix, Accum::Add, weighted, transposed, 1.0, Par::Seq);
    }

    /// Computes the steps of the rows when `x` moves along `direction`; returns the longest fraction of them that leaves slacks and
    /// multipliers positive.
    pub fn step(&mut self, direction: &[f64], target: f64) -> f64 {
        let mut longest = f64::INFINITY;
        for i in 0..self.n_rows() {
            let Terms { a, b, d, c, pull } = self.terms(i, target);
            let along = self.times(i, direction);
            let sigma = (a * along - c) / d;
            let [y1, y2] = self.y[i];
            let first = pull - a * (sigma - along) - y1;
            let second = target / self.sigma[i] - b * sigma - y2;
            for (value, change) in [
                (y1, first),
                (y2, second),
                (self.sigma[i], sigma),
                (self.sigma[i] - self.r[i], sigma - along),
            ] {
                if change < 0.0 {
                    longest = longest.min(-INSIDE * value / change);
                }
            }
            self.along[i] = [along, sigma, first, second];
        }
        longest
    }

    /// Moves by a fraction `part` of the last [step](Self::step).
    pub fn advance(&mut self, part: f64) {
        for i in 0..self.n_rows() {
            let [along, sigma, first, second] = self.along[i];
            self.r[i] += part * along;
            self.sigma[i] += part * sigma;
            self.y[i][0] += part * first;
            self.y[i][1] += part * second;
        }
    }

    fn terms(&self, i: usize, target: f64) -> Terms {
        let ([w1, w2], [y1, y2]) = (self.prices[i], self.y[i]);
        let sigma = self.sigma[i];
        let (s1, s2) = (sigma - self.r[i], sigma);
        let (a, b) = (y1 / s1, y2 / s2);
        let pull = target / s1;
        Terms {
            a,
            b,
            d: w2 + a + b,
            c: w1 + w2 * sigma - pull - target / s2,
            pull,
        }
    }
}

/// The quantities named at the head of this file; `pull` is `τ/s₁`.
struct Terms {
    a: f64,
    b: f64,
    d: f64,
    c: f64,
    pull: f64,
}
