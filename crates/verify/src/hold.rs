//! The controls as functions of time, from the definition of the hold; no code is shared with the solver's `control/hold.rs`.
//!
//! Every hold is a spline of some degree `p` (constant 0, linear 1, cubic 3) over clamped knots: the edges of the blocks, the first and the
//! last repeated `p` more times. Its basis functions are those of Cox and de Boor (de Boor 1978, A Practical Guide to Splines, ch. IX),
//!
//! ```text
//! N_j,0 = 1 on the piece between knots j and j + 1, else 0
//! N_j,p = (t - τ_j)/(τ_j+p - τ_j) N_j,p-1 + (τ_j+p+1 - t)/(τ_j+p+1 - τ_j+1) N_j+1,p-1
//! N'_j,p = p [N_j,p-1/(τ_j+p - τ_j) - N_j+1,p-1/(τ_j+p+1 - τ_j+1)]
//! ```
//!
//! evaluated by this recursion; at a time node, the mean of the pieces that meet there. Integrals of squares are those of Gauss and Lobatto
//! with five points per piece, exact up to degree seven.

use nalgebra::{DMatrix, Vector3};

use control::{Hold, OptimalControlProblem};
use mechanics::ControlSignal;

/// A hold over the blocks of a problem.
#[derive(Clone, Debug)]
pub struct Spline {
    degree: usize,
    /// Edges of the blocks in steps.
    edges: Vec<usize>,
    /// Time step, s.
    step: f64,
}

impl Spline {
    /// That of a problem's control, on its time grid.
    pub fn of(problem: &OptimalControlProblem) -> Self {
        Self::new(
            problem.control.hold,
            problem.control.edges(),
            problem.grid.step,
        )
    }

    /// Returns the spline of a hold on blocks between `edges`, numbers of steps of `step` s, the first of which is 0.
    #[must_use]
    pub fn new(hold: Hold, edges: &[usize], step: f64) -> Self {
        Self {
            degree: match hold {
                Hold::Constant => 0,
                Hold::Linear => 1,
                Hold::Cubic => 3,
            },
            edges: edges.to_vec(),
            step,
        }
    }

    /// Returns the number of pieces.
    fn n_pieces(&self) -> usize {
        self.edges.len() - 1
    }

    /// Returns the number of coefficients.
    #[must_use]
    pub fn n_coefficients(&self) -> usize {
        self.n_pieces() + self.degree
    }

    /// Returns knot `i` of the clamped sequence, s.
    fn knot(&self, i: usize) -> f64 {
        let edge = i.saturating_sub(self.degree).min(self.n_pieces());
        self.edges[edge] as f64 * self.step
    }

    /// Evaluates the polynomial of `N_j,p` on a piece, at time `t`.
    fn basis(&self, j: usize, p: usize, piece: usize, t: f64) -> f64 {
        // The piece lies between the knots `at` and `at + 1`.
        let at = piece + self.degree;
        if !(j..=j + p).contains(&at) {
            return 0.0;
        }
        if p == 0 {
            return 1.0;
        }
        let part = |lower: usize, weight: f64| {
            let width = self.knot(lower + p) - self.knot(lower);
            // Between coinciding knots there is no function.
            if width > 0.0 {
                weight / width * self.basis(lower, p - 1, piece, t)
            } else {
                0.0
            }
        };
        part(j, t - self.knot(j)) + part(j + 1, self.knot(j + p + 1) - t)
    }

    /// Evaluates the derivative of a basis function, 1/s.
    fn slope(&self, j: usize, piece: usize, t: f64) -> f64 {
        let p = self.degree;
        if p == 0 {
            return 0.0;
        }
        let part = |lower: usize| {
            let width = self.knot(lower + p) - self.knot(lower);
            if width > 0.0 {
                p as f64 / width * self.basis(lower, p - 1, piece, t)
            } else {
                0.0
            }
        };
        part(j) - part(j + 1)
    }

    /// Returns the coefficients that act at the time of `k / factor` steps, with their weights.
    #[must_use]
    pub fn weights(&self, k: usize, factor: usize) -> Vec<(usize, f64)> {
        let t = k as f64 * (self.step / factor as f64);
        let (first, last) = self.pieces_at(k, factor);
        let share = 1.0 / (last - first + 1) as f64;
        let mut out: Vec<(usize, f64)> = (first..=last + self.degree).map(|j| (j, 0.0)).collect();
        for piece in first..=last {
            for j in piece..=piece + self.degree {
                out[j - first].1 += share * self.basis(j, self.degree, piece, t);
            }
        }
        out
    }

    /// Returns the first and the last piece that touch the time of `k / factor` steps: one, or the two that meet there.
    fn pieces_at(&self, k: usize, factor: usize) -> (usize, usize) {
        let begun = self.edges.partition_point(|edge| edge * factor <= k);
        let last = begun.saturating_sub(1).min(self.n_pieces() - 1);
        let meets = last > 0 && self.edges[last] * factor == k;
        (if meets { last - 1 } else { last }, last)
    }

    /// Returns the times of the coefficients, s: the middle of a block, or the mean of the knots inside a basis function.
    pub fn times(&self) -> Vec<f64> {
        let p = self.degree;
        (0..self.n_coefficients())
            .map(|j| match p {
                0 => 0.5 * (self.knot(j) + self.knot(j + 1)),
                _ => (1..=p).map(|i| self.knot(j + i)).sum::<f64>() / p as f64,
            })
            .collect()
    }

    /// Start and end of what every coefficient of a constant hold lasts for, s; of the others, the time that it stands for, twice.
    pub fn intervals(&self) -> Vec<[f64; 2]> {
        (self.times().iter().enumerate())
            .map(|(j, t)| match self.degree {
                0 => [self.knot(j), self.knot(j + 1)],
                _ => [*t; 2],
            })
            .collect()
    }

    /// Returns the times between neighboring coefficients, s: a difference of coefficients divided by its gap is the rate of a ramp between
    /// blocks, or a coefficient of the derivative, which bounds it.
    #[must_use]
    pub fn gaps(&self) -> Vec<f64> {
        self.times().windows(2).map(|t| t[1] - t[0]).collect()
    }

    /// Returns the weights of the coefficients in the Bernstein coefficients of the command `u + lag u̇` on every piece; for a cubic spline,
    /// whose command is continuous, the last one of a piece is the first one of the next and is left out there. Empty for a constant hold.
    ///
    /// A polynomial of degree `p` has the Bernstein coefficients `V⁻¹ f` with its values `f` at `p + 1` points and the values `V` of the
    /// Bernstein polynomials there.
    pub(super) fn command_rows(&self, lag: f64) -> Vec<Vec<(usize, f64)>> {
        let p = self.degree;
        if p == 0 {
            return Vec::new();
        }
        let place = |i: usize| i as f64 / p as f64;
        let choose = |i: usize| (1..=i).fold(1.0, |c, j| c * (p + 1 - j) as f64 / j as f64);
        let polynomials = DMatrix::from_fn(p + 1, p + 1, |i, j| {
            let s = place(i);
            choose(j) * s.powi(j as i32) * (1.0 - s).powi((p - j) as i32)
        });
        let Some(inverse) = polynomials.try_inverse() else {
            return Vec::new();
        };
        let mut out = Vec::new();
        for piece in 0..self.n_pieces() {
            let [from, to] = [piece, piece + 1].map(|edge| self.edges[edge] as f64 * self.step);
            let values = DMatrix::from_fn(p + 1, p + 1, |i, j| {
                let t = from + place(i) * (to - from);
                self.basis(piece + j, p, piece, t) + lag * self.slope(piece + j, piece, t)
            });
            let rows = &inverse * values;
            let shared = usize::from(p > 1 && piece + 1 < self.n_pieces());
            for i in 0..=p - shared {
                out.push((0..=p).map(|j| (piece + j, rows[(i, j)])).collect());
            }
        }
        out
    }

    /// Returns the weights of the coefficients in the command `u + lag u̇` on the piece that begins at time node `k`, or at the end on the
    /// last one.
    pub fn command_weights(&self, k: usize, lag: f64) -> Vec<(usize, f64)> {
        let (_, piece) = self.pieces_at(k, 1);
        let t = k as f64 * self.step;
        (piece..=piece + self.degree)
            .map(|j| {
                let value = self.basis(j, self.degree, piece, t);
                (j, value + lag * self.slope(j, piece, t))
            })
            .collect()
    }

    /// Returns `½ ∫ effort |u|² + rate |u̇|² dt` and its gradient along the coefficients. Jumps of a constant hold count as ramps between
    /// the middles of the blocks.
    #[must_use]
    pub fn cost(
        &self,
        coefficients: &[Vector3<f64>],
        effort: f64,
        rate: f64,
    ) -> (f64, Vec<Vector3<f64>>) {
        let mut gradient = vec![Vector3::zeros(); coefficients.len()];
        let mut cost = 0.0;
        for piece in 0..self.n_pieces() {
            let (from, to) = (
                self.edges[piece] as f64 * self.step,
                self.edges[piece + 1] as f64 * self.step,
            );
            for (s, share) in lobatto() {
                let t = from + s * (to - from);
                let active = piece..=piece + self.degree;
                let values: Vec<[f64; 2]> = (active.clone())
                    .map(|j| {
                        [
                            self.basis(j, self.degree, piece, t),
                            self.slope(j, piece, t),
                        ]
                    })
                    .collect();
                for (i, weight) in [effort, rate].into_iter().enumerate() {
                    let weight = weight * share * (to - from);
                    let u: Vector3<f64> = (active.clone().zip(&values))
                        .map(|(j, value)| coefficients[j] * value[i])
                        .sum();
                    cost += 0.5 * weight * u.norm_squared();
                    for (j, value) in active.clone().zip(&values) {
                        gradient[j] += u * (weight * value[i]);
                    }
                }
            }
        }
        if self.degree == 0 {
            for (j, gap) in self.gaps().into_iter().enumerate() {
                let jump = coefficients[j + 1] - coefficients[j];
                cost += 0.5 * rate * jump.norm_squared() / gap;
                gradient[j + 1] += jump * (rate / gap);
                gradient[j] -= jump * (rate / gap);
            }
        }
        (cost, gradient)
    }

    /// Returns the largest second derivative of [`Self::cost`] along any one coefficient.
    pub(super) fn largest_curvature(&self, effort: f64, rate: f64) -> f64 {
        let n = self.n_coefficients();
        (0..n)
            .map(|j| {
                let mut one = vec![Vector3::zeros(); n];
                one[j] = Vector3::x();
                2.0 * self.cost(&one, effort, rate).0
            })
            .fold(0.0, f64::max)
    }
}

/// Returns points and weights of the rule of Gauss and Lobatto on [0, 1] with five points (Abramowitz & Stegun 1964, 25.4.32).
fn lobatto() -> [(f64, f64); 5] {
    let inner = 0.5 * (3.0_f64 / 7.0).sqrt();
    [
        (0.0, 1.0 / 20.0),
        (0.5 - inner, 49.0 / 180.0),
        (0.5, 16.0 / 45.0),
        (0.5 + inner, 49.0 / 180.0),
        (1.0, 1.0 / 20.0),
    ]
}

/// The controls at every time node of a grid whose steps are `factor` times shorter.
pub fn signal(
    problem: &OptimalControlProblem,
    factor: usize,
    coefficients: &[f64],
) -> ControlSignal {
    let spline = Spline::of(problem);
    let n = problem.n_numbers();
    let n_times = problem.grid.n_steps * factor + 1;
    let mut numbers = vec![0.0; n * n_times];
    for (k, here) in numbers.chunks_exact_mut(n.max(1)).enumerate() {
        for &(j, weight) in &spline.weights(k, factor) {
            for (sum, u) in here.iter_mut().zip(&coefficients[j * n..]) {
                *sum += u * weight;
            }
        }
    }
    let inputs: Vec<f64> = (numbers.chunks_exact(n.max(1)))
        .flat_map(|here| problem.inputs(here))
        .copied()
        .collect();
    ControlSignal {
        nodes: problem.actuated_nodes(),
        wrenches: problem.wrenches(&numbers),
        n_inputs: inputs.len() / n_times,
        inputs,
        acting: problem.acting.clone(),
        efforts: problem.efforts.clone(),
    }
}
