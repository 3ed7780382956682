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
pub(super) type Row = [(usize, f64); 2];

/// The set of consecutive rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Set {
    /// One row, `|z| ≤ limit`.
    Interval { limit: f64 },
    /// `n` rows together, `|z| ≤ radius`.
    Ball { n: usize, radius: f64 },
    /// One row, `z ≤ limit`.
    Below { limit: f64 },
}

impl Set {
    fn len(self) -> usize {
        match self {
            Self::Interval { .. } | Self::Below { .. } => 1,
            Self::Ball { n, .. } => n,
        }
    }

    /// Returns `½ (|z|² - radius²)/radius`, or `z - limit`, which is at most zero within the set.
    fn excess(self, z: &[f64]) -> f64 {
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
pub(super) struct Subproblem {
    pub hessian: Mat<f64>,
    pub rows: Vec<Row>,
    /// Value of every row, without its offset, in the middle of its set.
    pub middles: Vec<f64>,
    pub sets: Vec<Set>,
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

#[cfg(test)]
thread_local! {
    /// Decides which factorizations of this thread fail, for tests of a loop.
    pub(crate) static FAILS: std::cell::RefCell<Box<dyn FnMut() -> bool>> =
        std::cell::RefCell::new(Box::new(|| false));
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
        #[cfg(test)]
        if FAILS.with_borrow_mut(|fails| fails()) {
            return Err(MpcError::Subproblem);
        }
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
        let n_sets = self.sets.iter().filter(|set| set.bounds()).count() + 2 * self.soft.len();
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

/// Writes `a + A x`.
fn values(rows: &[Row], a: &[f64], x: &[f64], out: &mut [f64]) {
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

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    /// A half space is an interval whose other end is far away: both have the same minimum, up to the gap of the method, and it lies within.
    #[test]
    fn half_spaces_are_long_intervals() {
        let n = 6;
        let mut dice = fastrand::Rng::with_seed(11);
        for case in 0..40 {
            let g: Vec<f64> = (0..n).map(|_| 4.0 * (dice.f64() - 0.5)).collect();
            let a: Vec<f64> = (0..n).map(|_| 0.4 * (dice.f64() - 0.5)).collect();
            let sign = if case % 2 == 0 { 1.0 } else { -1.0 };
            let mut found = [(); 2].map(|()| vec![0.0; n]);
            for (x, is_open) in found.iter_mut().zip([true, false]) {
                let mut program = Subproblem::new(n, n, 0);
                let mut offsets = a.clone();
                for i in 0..n {
                    for j in 0..n {
                        program.hessian[(i, j)] = if i == j { 1.5 } else { 0.2 };
                    }
                    program.rows.push([(i, sign), (i, 0.0)]);
                    if is_open {
                        program.sets.push(Set::Below { limit: 0.3 });
                    } else {
                        offsets[i] += 4.7;
                        program.sets.push(Set::Interval { limit: 5.0 });
                    }
                }
                program.factor().unwrap();
                program.solve(&g, &offsets, &vec![0.0; n], 1e-10, 100, x);
                for (a, x) in a.iter().zip(&*x) {
                    assert!(a + sign * x <= 0.3, "{case} {is_open}");
                }
            }
            let [open, closed] = found;
            for (a, b) in open.iter().zip(&closed) {
                assert!((a - b).abs() < 1e-4, "{case}: {a} {b}");
            }
        }
    }

    /// Minima with balls and intervals, active or not, from values within and on the boundary: no higher than those of many steps of the
    /// projected-gradient method, up to the requested gap, and exactly within their sets.
    #[test]
    fn minima_are_those_of_projected_gradients() {
        let n = 12;
        let mut dice = fastrand::Rng::with_seed(5);
        for case in 0..60 {
            let size = 10f64.powi(case % 5 - 2);
            let root: Vec<f64> = (0..n * n).map(|_| dice.f64() - 0.5).collect();
            let mut program = Subproblem::new(n, 3 * n, 0);
            for i in 0..n {
                for j in 0..n {
                    let dot: f64 = (0..n).map(|k| root[i * n + k] * root[j * n + k]).sum();
                    program.hessian[(i, j)] = dot + if i == j { 0.02 } else { 0.0 };
                }
            }
            for start in [0, 3] {
                program
                    .rows
                    .extend((start..start + 3).map(|i| [(i, 1.0), (i, 0.0)]));
                program.sets.push(Set::Ball { n: 3, radius: 1.0 });
            }
            for i in 6..12 {
                program.rows.push([(i, 1.0), (i, 0.0)]);
                program.sets.push(Set::Interval { limit: 0.7 });
            }
            let g: Vec<f64> = (0..n).map(|_| size * (dice.f64() - 0.5)).collect();
            let mut plan: Vec<f64> = (0..n).map(|_| 0.4 * (dice.f64() - 0.5)).collect();
            plan[7] = 0.7;
            let a: Vec<f64> = plan.clone();
            program.factor().unwrap();
            let mut x = vec![0.0; n];
            let inside: Vec<f64> = a.iter().map(|a| -a).collect();
            let end = program.solve(&g, &a, &inside, 1e-10, 60, &mut x);
            assert!(end.converged, "{case}: {end:?}");
            // The same minimum by projected gradients.
            let step = 1.0 / (0..n).map(|i| program.hessian[(i, i)]).sum::<f64>();
            let mut other = vec![0.0; n];
            for _ in 0..100_000 {
                let mut slopes = vec![0.0; n];
                slope(&program.hessian, &g, &other, &mut slopes);
                for i in 0..n {
                    other[i] -= step * slopes[i];
                }
                for start in [0, 3] {
                    let v: Vec<f64> = (start..start + 3).map(|i| other[i] + a[i]).collect();
                    let size = v.iter().map(|v| v * v).sum::<f64>().sqrt();
                    if size > 1.0 {
                        for i in 0..3 {
                            other[start + i] = v[i] / size - a[start + i];
                        }
                    }
                }
                for i in 6..12 {
                    other[i] = (other[i] + a[i]).clamp(-0.7, 0.7) - a[i];
                }
            }
            let cost = |x: &[f64]| -> f64 {
                let mut slopes = vec![0.0; n];
                slope(&program.hessian, &g, x, &mut slopes);
                (x.iter().zip(slopes.iter().zip(&g)))
                    .map(|(x, (s, g))| 0.5 * x * (s + g))
                    .sum()
            };
            let free: Vec<f64> = {
                let mut free = Mat::from_fn(n, 1, |i, _| -g[i]);
                super::solve(&program.free, &mut free);
                (0..n).map(|i| free[(i, 0)]).collect()
            };
            // The requested gap is relative to the decrease that the minimum without bounds would bring.
            let (here, there, promised) = (cost(&x), cost(&other), cost(&free).abs());
            assert!(
                here <= there + 2e-10 * promised,
                "{case}: {here:e} {there:e}"
            );
            for (set, z) in program.of_sets() {
                assert!(set.excess(z) <= 0.0);
            }
        }
    }

    /// Four vectors of three components, the first of which is fixed, also on the boundary of its ball, and neighbors of which differ by
    /// little, from a plan that is feasible or far from it: at the minimum, no direction to another feasible point descends.
    #[test]
    fn minima_keep_rates() {
        let n = 12;
        let mut dice = fastrand::Rng::with_seed(9);
        for case in 0..60 {
            let size = 10f64.powi(case % 5 - 2);
            let mut program = Subproblem::new(n, 2 * n, 0);
            let root: Vec<f64> = (0..n * n).map(|_| dice.f64() - 0.5).collect();
            for i in 0..n {
                for j in 0..n {
                    let dot: f64 = (0..n).map(|k| root[i * n + k] * root[j * n + k]).sum();
                    program.hessian[(i, j)] = dot + if i == j { 0.02 } else { 0.0 };
                }
            }
            let change = 10f64.powi(-(case % 4));
            for first in [3, 6, 9] {
                program
                    .rows
                    .extend((first..first + 3).map(|i| [(i, 1.0), (i, 0.0)]));
                program.sets.push(Set::Ball { n: 3, radius: 1.0 });
                let differences = (first..first + 3).map(|i| [(i, 1.0), (i - 3, -1.0)]);
                program.rows.extend(differences);
                if case % 2 == 0 {
                    let radius = change;
                    program.sets.push(Set::Ball { n: 3, radius });
                } else {
                    let limit = change;
                    program.sets.extend([Set::Interval { limit }; 3]);
                }
            }
            program.fixed[..3].fill(true);
            let acting = Vector3::new(dice.f64() - 0.5, dice.f64() - 0.5, dice.f64() - 0.5);
            let acting = acting.normalize() * if case % 3 == 0 { 1.0 } else { 0.4 };
            let plan: Vec<f64> = (0..n).map(|_| 3.0 * (dice.f64() - 0.5)).collect();
            let inside: Vec<f64> = (0..n)
                .map(|i| acting[i % 3] * (1.0 - 0.3 * change * (i / 3) as f64) - plan[i])
                .collect();
            let mut a = vec![0.0; program.rows.len()];
            values(&program.rows, &vec![0.0; a.len()], &plan, &mut a);
            let g: Vec<f64> = (0..n).map(|_| size * (dice.f64() - 0.5)).collect();
            program.factor().unwrap();
            let mut x = vec![0.0; n];
            let end = program.solve(&g, &a, &inside, 1e-10, 100, &mut x);
            assert!(end.converged, "{case}: {end:?}");
            assert_eq!(x[..3], inside[..3]);
            let mut slopes = vec![0.0; n];
            slope(&program.hessian, &g, &x, &mut slopes);
            let excess = |program: &mut Subproblem, x: &[f64]| {
                values(&program.rows, &a, x, &mut program.z);
                (program.of_sets())
                    .map(|(set, z)| set.excess(z))
                    .fold(f64::NEG_INFINITY, f64::max)
            };
            assert!(excess(&mut program, &x) <= 0.0, "{case}");
            let mut steepest = 0.0f64;
            for _ in 0..1000 {
                let way: Vec<f64> = (0..n)
                    .map(|i| if i < 3 { 0.0 } else { dice.f64() - 0.5 })
                    .collect();
                let mut part = 2.0;
                let other = loop {
                    let other: Vec<f64> = (inside.iter().zip(&way))
                        .map(|(x, d)| x + part * d)
                        .collect();
                    if excess(&mut program, &other) <= 0.0 {
                        break other;
                    }
                    part *= 0.7;
                };
                let along =
                    (slopes.iter().zip(other.iter().zip(&x))).map(|(s, (to, x))| s * (to - x));
                steepest = steepest.min(along.sum());
            }
            // The gap is relative to the decrease that the minimum without sets would bring, which curvatures above 0.02 bound by 25 |g|².
            let promised = 25.0 * slopes.iter().chain(&g).map(|s| s * s).sum::<f64>() + 1.0;
            assert!(steepest > -1e-8 * promised, "{case}: {steepest:e}");
        }
    }

    /// With soft rows, no point near the minimum or far from it is cheaper: for rows that hold, that are violated and that do not matter,
    /// with and without bounds, over ten orders of magnitude of the prices.
    #[test]
    fn minima_with_prices_are_minima() {
        let (n, m) = (10, 7);
        let mut dice = fastrand::Rng::with_seed(11);
        for case in 0..60 {
            let mut program = Subproblem::new(n, n, m);
            let root: Vec<f64> = (0..n * n).map(|_| dice.f64() - 0.5).collect();
            for i in 0..n {
                for j in 0..n {
                    let dot: f64 = (0..n).map(|k| root[i * n + k] * root[j * n + k]).sum();
                    program.hessian[(i, j)] = dot + if i == j { 0.02 } else { 0.0 };
                }
            }
            if case % 2 == 0 {
                for i in 0..n {
                    program.rows.push([(i, 1.0), (i, 0.0)]);
                    program.sets.push(Set::Interval { limit: 0.5 });
                }
            }
            let price = 10f64.powi(case % 10 - 3);
            for i in 0..m {
                program.soft.values.push(2.0 * dice.f64() - 1.0);
                program.soft.prices.push([price, price * dice.f64()]);
                for k in 0..n {
                    program.soft.slopes[(k, i)] = dice.f64() - 0.5;
                }
            }
            let g: Vec<f64> = (0..n).map(|_| dice.f64() - 0.5).collect();
            let a = vec![0.0; program.rows.len()];
            program.factor().unwrap();
            let mut x = vec![0.0; n];
            let end = program.solve(&g, &a, &vec![0.0; n], 1e-12, 100, &mut x);
            assert!(end.converged, "{case}: {end:?}");
            let cost = |x: &[f64]| -> f64 {
                if case % 2 == 0 && x.iter().any(|x| x.abs() > 0.5) {
                    return f64::INFINITY;
                }
                let mut slopes = vec![0.0; n];
                slope(&program.hessian, &g, x, &mut slopes);
                let smooth: f64 = (x.iter().zip(slopes.iter().zip(&g)))
                    .map(|(x, (s, g))| 0.5 * x * (s + g))
                    .sum();
                let soft = &program.soft;
                let priced = (0..m).map(|i| {
                    let moved: f64 = (0..n).map(|k| soft.slopes[(k, i)] * x[k]).sum();
                    let sigma = (soft.values[i] + moved).max(0.0);
                    let [w1, w2] = soft.prices[i];
                    sigma * (w1 + 0.5 * w2 * sigma)
                });
                smooth + priced.sum::<f64>()
            };
            let here = cost(&x);
            let size = 1.0 + cost(&vec![0.0; n]).abs();
            for trial in 0..4000 {
                let reach = 10f64.powi(-(trial % 6));
                let other: Vec<f64> = (x.iter()).map(|x| x + reach * (dice.f64() - 0.5)).collect();
                assert!(cost(&other) >= here - 1e-11 * size, "{case} {trial}");
            }
        }
    }
}
