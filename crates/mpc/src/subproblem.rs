//! The quadratic program of one sample, with memory of its own: `min ½ xᵀHx + gᵀx` with `a_i + A_i x` in balls and intervals about zero
//! and in half spaces, with fixed variables, and with [rows](super::soft_rows) that may be violated with a penalty.
//!
//! If the minimum without sets is feasible, it is the solution. Otherwise a primal-dual interior-point method finds the minimum (Boyd and
//! Vandenberghe 2004, section 11.7), with one factorization of an `n × n` matrix per iteration. The caller knows a point strictly within
//! all sets, from which the first iterate is derived; all iterates stay strictly within their sets, so that the control is within its
//! bounds whenever the method is stopped. Fixed variables are left out of every system: a penalty that holds them would make it
//! ill-conditioned.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt;
use faer::linalg::triangular_solve::{
    solve_lower_triangular_in_place, solve_upper_triangular_in_place,
};
use faer::{Mat, Par, Spec};

use super::error::MpcError;
use super::soft_rows::{INSIDE, SoftRows};

/// Factor on the product of multiplier and slack from one iteration to the next: Boyd and Vandenberghe 2004, pages 612 and 613.
const CENTERING: f64 = 0.1;
/// Largest fraction of a set's room at the caller's inner point that the first iterate uses: any fraction below 1 gives a first iterate
/// within all sets. With 0.8 and 0.95, the error of the tip changes in the fifth digit in a loop with bounded rates.
const BEGIN: f64 = 0.9;
/// Length of a step within the sets below which a solve ends: a cap of 33 on the halvings of a step. A loop with bounded rates is the same
/// from 1e-12 to 1e-8.
const SHORTEST: f64 = 1e-10;

/// A row of `A` with its few entries.
pub type SparseRow = [(usize, f64); 2];

/// The set of consecutive rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Set {
    /// One row, `|z| ≤ limit`.
    Interval {
        /// The limit.
        limit: f64,
    },
    /// `n` rows together, `|z| ≤ radius`.
    Ball {
        /// Number of rows.
        n: usize,
        /// The radius.
        radius: f64,
    },
    /// One row, `z ≤ limit`.
    Below {
        /// The limit.
        limit: f64,
    },
}

impl Set {
    fn len(self) -> usize {
        match self {
            Self::Interval { .. } | Self::Below { .. } => 1,
            Self::Ball { n, .. } => n,
        }
    }

    /// Returns `½ (|z|² - radius²)/radius`, or `z - limit`, which is at most zero within the set.
    #[must_use]
    pub fn excess(self, z: &[f64]) -> f64 {
        if let Self::Below { limit } = self {
            return z[0] - limit;
        }
        let square = z.iter().map(|z| z * z).sum::<f64>();
        let limit = self.limit();
        0.5 * (square / limit - limit)
    }

    fn limit(self) -> f64 {
        match self {
            Self::Interval { limit } | Self::Ball { radius: limit, .. } | Self::Below { limit } => {
                limit
            }
        }
    }

    /// Returns the derivative of the excess along a row with the value `z`, as numerator and denominator.
    fn slope(self, z: f64) -> (f64, f64) {
        match self {
            Self::Below { .. } => (1.0, 1.0),
            Self::Interval { limit } | Self::Ball { radius: limit, .. } => (z, limit),
        }
    }

    /// Returns the radius of curvature of the excess, which is infinite for a half space.
    fn radius(self) -> f64 {
        match self {
            Self::Below { .. } => f64::INFINITY,
            Self::Interval { limit } | Self::Ball { radius: limit, .. } => limit,
        }
    }

    /// Returns a number that is convex in `z` and below the limit strictly within the set.
    fn size(self, z: &[f64]) -> f64 {
        match self {
            Self::Below { .. } => z[0],
            Self::Interval { .. } | Self::Ball { .. } => {
                z.iter().map(|z| z * z).sum::<f64>().sqrt()
            }
        }
    }

    /// Tells whether the set has a finite limit.
    fn bounds(self) -> bool {
        self.limit().is_finite()
    }
}

/// The end of a solve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SubproblemEnd {
    /// Iterations of the interior-point method; 0 if no bound is active.
    pub iterations: usize,
    /// Tells whether the tolerance was reached.
    pub converged: bool,
}

/// The program and its memory.
pub struct Subproblem {
    /// `H`, symmetric.
    pub hessian: Mat<f64>,
    /// `A`, row by row.
    pub rows: Vec<SparseRow>,
    /// Value of every row, without its offset, in the middle of its set.
    pub middles: Vec<f64>,
    /// Sets of the rows, one after the other.
    pub sets: Vec<Set>,
    /// Rows that may be violated with a penalty.
    pub soft: SoftRows,
    /// Variables that are fixed to the values of the inner point.
    pub fixed: Vec<bool>,
    /// Cholesky factor of `H`, and of the matrix of an iteration.
    free: Mat<f64>,
    matrix: Mat<f64>,
    scratch: MemBuffer,
    direction: Mat<f64>,
    /// `Hx + g`.
    slope: Vec<f64>,
    /// Values of the rows at `x`, and at a trial point.
    z: Vec<f64>,
    trial: Vec<f64>,
    moved: Vec<f64>,
    /// Multipliers of the sets.
    y: Vec<f64>,
}

impl std::fmt::Debug for Subproblem {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Subproblem")
            .field("sets", &self.sets)
            .finish_non_exhaustive()
    }
}

impl Subproblem {
    /// Creates memory for at most `n` variables and the given numbers of rows and soft rows.
    pub fn new(n: usize, most_rows: usize, most_soft: usize) -> Self {
        let need = llt::factor::cholesky_in_place_scratch::<f64>(n, Par::Seq, Spec::default());
        Self {
            hessian: Mat::zeros(n, n),
            rows: Vec::with_capacity(most_rows),
            middles: Vec::with_capacity(most_rows),
            sets: Vec::with_capacity(most_rows),
            soft: SoftRows::new(n, most_soft),
            fixed: vec![false; n],
            free: Mat::zeros(n, n),
            matrix: Mat::zeros(n, n),
            scratch: MemBuffer::new(need),
            direction: Mat::zeros(n, 1),
            slope: vec![0.0; n],
            z: vec![0.0; most_rows],
            trial: vec![0.0; most_rows],
            moved: vec![0.0; n],
            y: vec![0.0; most_rows],
        }
    }

    /// Factors the Hessian of the free variables.
    ///
    /// # Errors
    /// Returns [`MpcError::Subproblem`] if it has no factor.
    pub fn factor(&mut self) -> Result<(), MpcError> {
        self.free.copy_from(&self.hessian);
        leave_out(&self.fixed, &mut self.free);
        factor(&mut self.free, &mut self.scratch)
    }

    /// Computes the minimum for the gradient `g`, where the rows have the values `a` at `x = 0`, and writes it to `x`. `inside` is a point
    /// strictly within all sets, with the values of the fixed variables. The method ends when the duality gap is below `tolerance` times
    /// the decrease that the minimum without sets would bring, after `limit` iterations, or if rounding leaves the matrix of an iteration
    /// without a factor; in each case `x` is within all sets.
    pub fn solve(
        &mut self,
        g: &[f64],
        a: &[f64],
        inside: &[f64],
        tolerance: f64,
        limit: usize,
        x: &mut [f64],
    ) -> SubproblemEnd {
        self.begin(inside, x);
        slope(&self.hessian, g, x, &mut self.slope);
        for (i, fixed) in self.fixed.iter().enumerate() {
            self.direction[(i, 0)] = if *fixed { 0.0 } else { -self.slope[i] };
        }
        solve(&self.free, &mut self.direction);
        let promised: f64 = (self.slope.iter().enumerate())
            .map(|(i, slope)| -0.5 * slope * self.direction[(i, 0)])
            .sum();
        for (i, x) in x.iter_mut().enumerate() {
            *x += self.direction[(i, 0)];
        }
        values(&self.rows, a, x, &mut self.z);
        if self.of_sets().all(|(set, z)| set.excess(z) <= 0.0) && self.soft.largest(x) <= 0.0 {
            return SubproblemEnd {
                iterations: 0,
                converged: true,
            };
        }
        let promised = promised + self.soft.cost();
        let n_sets = self.sets.iter().filter(|set| set.bounds()).count() + 2 * self.soft.n_rows();
        let n_sets = n_sets.max(1) as f64;
        let mut converged = false;
        let mut iterations = 0;
        if !self.start(a, inside, promised / n_sets, x) {
            return SubproblemEnd {
                iterations,
                converged,
            };
        }
        let enough = tolerance * promised.max(f64::MIN_POSITIVE);
        while iterations < limit && !converged {
            iterations += 1;
            let gap: f64 = (self.of_sets().zip(&self.y))
                .map(|((set, z), y)| {
                    if set.bounds() {
                        -set.excess(z) * y
                    } else {
                        0.0
                    }
                })
                .sum();
            let gap = gap + self.soft.gap();
            let target = CENTERING * gap / n_sets;
            self.assemble(g, x, target);
            if factor(&mut self.matrix, &mut self.scratch).is_err() {
                break;
            }
            solve(&self.matrix, &mut self.direction);
            let step = self.step(a, x, target);
            // A full step leaves no dual residual.
            converged = gap <= enough && step == 1.0 || step < SHORTEST;
        }
        SubproblemEnd {
            iterations,
            converged,
        }
    }

    /// Writes zero, with the values of the fixed variables.
    fn begin(&self, inside: &[f64], x: &mut [f64]) {
        for ((x, inside), fixed) in x.iter_mut().zip(inside).zip(&self.fixed) {
            *x = if *fixed { *inside } else { 0.0 };
        }
    }

    /// Computes the first iterate: `x = 0`, moved toward the inner point as far as needed to leave a fraction of every set's room there;
    /// and multipliers whose products with the slacks are `product`. Returns `false` if the inner point is not strictly inside up to
    /// rounding; it is then the iterate.
    fn start(&mut self, a: &[f64], inside: &[f64], product: f64, x: &mut [f64]) -> bool {
        self.begin(inside, x);
        values(&self.rows, a, x, &mut self.trial);
        values(&self.rows, a, inside, &mut self.z);
        let mut part = 1.0f64;
        let mut first = 0;
        for set in &self.sets {
            let range = first..first + set.len();
            first = range.end;
            if !set.bounds() {
                continue;
            }
            let size = set.size(&self.trial[range.clone()]);
            let least = set.size(&self.z[range]);
            let room = set.limit() - least;
            if !(room > 0.0) {
                part = f64::NEG_INFINITY;
            } else if size > least + BEGIN * room {
                // The size is convex along the way.
                part = part.min(BEGIN * room / (size - least));
            }
        }
        let is_inside = part >= 0.0;
        if part < 1.0 {
            let part = part.max(0.0);
            for (x, inside) in x.iter_mut().zip(inside) {
                *x = inside + part * (*x - inside);
            }
        }
        values(&self.rows, a, x, &mut self.z);
        self.soft.start(x, product);
        let mut first = 0;
        for (index, set) in self.sets.iter().enumerate() {
            let z = &self.z[first..first + set.len()];
            first += set.len();
            self.y[index] = if set.bounds() {
                product / -set.excess(z)
            } else {
                0.0
            };
        }
        is_inside
    }

    /// Returns the largest [excess](Set::excess) of a set at `x`, where the rows have the values `a` at `x = 0`; negative infinity without
    /// sets.
    pub fn excess(&mut self, a: &[f64], x: &[f64]) -> f64 {
        values(&self.rows, a, x, &mut self.z);
        (self.of_sets())
            .map(|(set, z)| set.excess(z))
            .fold(f64::NEG_INFINITY, f64::max)
    }

    fn of_sets(&self) -> impl Iterator<Item = (Set, &[f64])> {
        let mut first = 0;
        self.sets.iter().map(move |set| {
            let z = &self.z[first..first + set.len()];
            first += set.len();
            (*set, z)
        })
    }

    /// Assembles `H + Σ y f'' + Σ (y/-f) f' f'ᵀ`, and minus the gradient with multipliers for the products `target`.
    fn assemble(&mut self, g: &[f64], x: &[f64], target: f64) {
        let n = g.len();
        slope(&self.hessian, g, x, &mut self.slope);
        self.matrix.copy_from(&self.hessian);
        for i in 0..n {
            self.direction[(i, 0)] = -self.slope[i];
        }
        (self.soft).assemble(target, &mut self.matrix, &mut self.direction);
        let mut first = 0;
        for (index, set) in self.sets.iter().enumerate() {
            let range = first..first + set.len();
            first = range.end;
            if !set.bounds() {
                continue;
            }
            let slack = -set.excess(&self.z[range.clone()]);
            let (y, pull) = (self.y[index], target / slack);
            for r in range.clone() {
                let (slope, over) = set.slope(self.z[r]);
                for (i, a) in self.rows[r] {
                    self.direction[(i, 0)] -= pull * a * slope / over;
                    for (j, b) in self.rows[r] {
                        self.matrix[(i, j)] += y * a * b / set.radius();
                    }
                    for s in range.clone() {
                        let (other, _) = set.slope(self.z[s]);
                        for (j, b) in self.rows[s] {
                            let slopes = a * slope * b * other / (over * over);
                            self.matrix[(i, j)] += y / slack * slopes;
                        }
                    }
                }
            }
        }
        leave_out(&self.fixed, &mut self.matrix);
        for (i, _) in (self.fixed.iter().enumerate()).filter(|(_, fixed)| **fixed) {
            self.direction[(i, 0)] = 0.0;
        }
    }

    /// Moves along the direction, with the multipliers, as far as the sets and the decrease of the residual allow.
    fn step(&mut self, a: &[f64], x: &mut [f64], target: f64) -> f64 {
        let n = x.len();
        // Changes of the multipliers, in the memory of the trial values, and the longest step that leaves them positive.
        let mut longest = 1.0f64;
        let mut first = 0;
        for (index, set) in self.sets.iter().enumerate() {
            let range = first..first + set.len();
            first = range.end;
            if !set.bounds() {
                continue;
            }
            let slack = -set.excess(&self.z[range.clone()]);
            let along: f64 = range
                .map(|r| {
                    let moved: f64 = (self.rows[r].iter())
                        .map(|&(j, c)| c * self.direction[(j, 0)])
                        .sum();
                    let (slope, over) = set.slope(self.z[r]);
                    moved * slope / over
                })
                .sum();
            let y = self.y[index];
            let change = (target + y * along) / slack - y;
            self.trial[index] = change;
            if change < 0.0 {
                longest = longest.min(-y / change);
            }
        }
        let soft = self.soft.step(self.direction.col_as_slice(0), target);
        let mut step = if longest < 1.0 { INSIDE * longest } else { 1.0 };
        step = step.min(soft);
        loop {
            for (j, moved) in self.moved[..n].iter_mut().enumerate() {
                *moved = x[j] + step * self.direction[(j, 0)];
            }
            let mut inside = true;
            let mut first = 0;
            for set in &self.sets {
                let range = first..first + set.len();
                first = range.end;
                if !set.bounds() {
                    continue;
                }
                let mut square = 0.0;
                for r in range {
                    let value: f64 = a[r]
                        + (self.rows[r].iter())
                            .map(|&(j, c)| c * self.moved[j])
                            .sum::<f64>();
                    square += value * value;
                    if let Set::Below { limit } = *set {
                        inside &= value < limit;
                    }
                }
                inside &= matches!(set, Set::Below { .. }) || square < set.limit() * set.limit();
            }
            if inside || step < SHORTEST {
                break;
            }
            step *= 0.5;
        }
        if step >= SHORTEST {
            x.copy_from_slice(&self.moved[..n]);
            self.soft.advance(step);
            for (index, set) in self.sets.iter().enumerate() {
                if set.bounds() {
                    self.y[index] += step * self.trial[index];
                }
            }
            values(&self.rows, a, x, &mut self.z);
        }
        step
    }
}

/// Writes the values `a + A x` of some rows of `A`.
pub fn values(rows: &[SparseRow], a: &[f64], x: &[f64], out: &mut [f64]) {
    for ((out, a), row) in out.iter_mut().zip(a).zip(rows) {
        *out = a + row.iter().map(|(j, c)| c * x[*j]).sum::<f64>();
    }
}

/// Writes `Hx + g`.
fn slope(hessian: &Mat<f64>, g: &[f64], x: &[f64], out: &mut [f64]) {
    out.copy_from_slice(g);
    for (j, x) in x.iter().enumerate() {
        for (out, h) in out.iter_mut().zip(hessian.col_as_slice(j)) {
            *out += h * x;
        }
    }
}

/// Replaces rows and columns of fixed variables by those of the identity.
fn leave_out(fixed: &[bool], matrix: &mut Mat<f64>) {
    for (i, _) in (fixed.iter().enumerate()).filter(|(_, fixed)| **fixed) {
        for j in 0..fixed.len() {
            matrix[(i, j)] = 0.0;
            matrix[(j, i)] = 0.0;
        }
        matrix[(i, i)] = 1.0;
    }
}

fn factor(matrix: &mut Mat<f64>, scratch: &mut MemBuffer) -> Result<(), MpcError> {
    llt::factor::cholesky_in_place(
        matrix.as_mut(),
        llt::factor::LltRegularization::default(),
        Par::Seq,
        MemStack::new(scratch),
        Spec::default(),
    )
    .map(|_| ())
    .map_err(|_| MpcError::Subproblem)
}

fn solve(factor: &Mat<f64>, x: &mut Mat<f64>) {
    solve_lower_triangular_in_place(factor.as_ref(), x.as_mut(), Par::Seq);
    solve_upper_triangular_in_place(factor.transpose(), x.as_mut(), Par::Seq);
}
