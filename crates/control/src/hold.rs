//! Controls as functions of time: coefficients times basis functions, one linear map for every kind of hold.

use faer::Mat;

/// The course of the controls within a block.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Hold {
    /// Constant in each block; its jumps set off elastic waves.
    Constant,
    /// Linear between the ends of blocks (one coefficient per end). The default.
    #[default]
    Linear,
    /// A cubic spline, smooth where blocks meet: a clamped B-spline with blocks + 3 coefficients. Bounds hold for its control points, and
    /// so for the spline.
    Cubic,
}

impl Hold {
    /// Returns the degree of the polynomials.
    fn degree(self) -> usize {
        match self {
            Self::Constant => 0,
            Self::Linear => 1,
            Self::Cubic => 3,
        }
    }
}

/// The blocks of a control on a time grid, and the map from its coefficients to the time nodes.
#[derive(Clone, Debug, PartialEq)]
pub struct ControlGrid {
    /// The course of a control between its coefficients.
    pub hold: Hold,
    /// First step of every block, and the number of steps at the end.
    edges: Vec<usize>,
    /// Step of the grid, s.
    step: f64,
}

/// The coefficients that act at one time, with their weights; unused entries have weight 0 and repeat an index.
pub type Weights = [(usize, f64); 4];

/// Returns the sum of coefficients by their weights.
pub(super) fn weigh(weights: &Weights, coefficient: impl Fn(usize) -> f64) -> f64 {
    let mut sum = 0.0;
    for &(j, weight) in weights {
        if weight != 0.0 {
            sum += coefficient(j) * weight;
        }
    }
    sum
}

/// Points and weights of Gauss-Legendre quadrature on [0, 1], exact for the squares of cubics.
const QUADRATURE: [(f64, f64); 4] = [
    (0.069_431_844_202_973_71, 0.173_927_422_568_726_93),
    (0.330_009_478_207_571_87, 0.326_072_577_431_273_07),
    (0.669_990_521_792_428_1, 0.326_072_577_431_273_07),
    (0.930_568_155_797_026_3, 0.173_927_422_568_726_93),
];

impl ControlGrid {
    /// Divides `n_steps` steps into `n_blocks` blocks, as equal as whole steps allow; `None` if there are no blocks or fewer steps than
    /// blocks.
    #[must_use]
    pub fn new(hold: Hold, n_blocks: usize, n_steps: usize, step: f64) -> Option<Self> {
        if n_blocks == 0 || n_steps < n_blocks {
            return None;
        }
        let edges = (0..=n_blocks)
            .map(|block| {
                // Rounds to nearest in integers, which is exact for any size that fits in memory.
                let product = block as u128 * n_steps as u128;
                ((2 * product + n_blocks as u128) / (2 * n_blocks as u128)) as usize
            })
            .collect();
        Some(Self { hold, edges, step })
    }

    /// Returns the same function of time on a grid whose steps are `factor` times shorter.
    #[must_use]
    pub fn refined(&self, factor: usize) -> Self {
        Self {
            hold: self.hold,
            edges: self.edges.iter().map(|edge| edge * factor).collect(),
            step: self.step / factor as f64,
        }
    }

    /// Returns the same coefficients over a duration multiplied by `time_scale`.
    #[must_use]
    pub fn with_time_scale(&self, time_scale: f64) -> Self {
        Self {
            step: self.step * time_scale,
            ..self.clone()
        }
    }

    /// Returns the number of blocks.
    #[must_use]
    pub fn n_blocks(&self) -> usize {
        self.edges.len() - 1
    }

    /// Returns the number of coefficients per component.
    #[must_use]
    pub fn n_coefficients(&self) -> usize {
        self.n_blocks() + self.hold.degree()
    }

    /// Returns the number of steps of the grid.
    #[must_use]
    pub fn n_steps(&self) -> usize {
        self.edges[self.edges.len() - 1]
    }

    /// Returns the first step of every block, and the number of steps at the end.
    #[must_use]
    pub fn edges(&self) -> &[usize] {
        &self.edges
    }

    /// Returns the times at which blocks begin, and the end, s.
    #[must_use]
    pub fn edge_times(&self) -> Vec<f64> {
        self.edges
            .iter()
            .map(|&edge| edge as f64 * self.step)
            .collect()
    }

    /// Returns the time of each coefficient, s: the middle of its block, its knot, or the mean of the knots inside its basis function
    /// (Greville abscissa).
    #[must_use]
    pub fn coefficient_times(&self) -> Vec<f64> {
        let knot = |i: isize| {
            let last = self.edges.len() as isize - 1;
            self.edges[i.clamp(0, last) as usize] as f64 * self.step
        };
        (0..self.n_coefficients() as isize)
            .map(|j| match self.hold {
                Hold::Constant => 0.5 * (knot(j) + knot(j + 1)),
                Hold::Linear => knot(j),
                Hold::Cubic => (knot(j - 2) + knot(j - 1) + knot(j)) / 3.0,
            })
            .collect()
    }

    /// Returns the basis functions that do not vanish in a block, at the fraction `s` of it, from the block's own index on, and their
    /// derivatives, 1/s.
    fn basis(&self, block: usize, s: f64) -> ([f64; 4], [f64; 4]) {
        // De Boor's recursion over the knots around the block, which repeat at either end.
        let knot = |i: isize| {
            let last = self.edges.len() as isize - 1;
            self.edges[(block as isize + i).clamp(0, last) as usize] as f64
        };
        let (from, to) = (knot(0), knot(1));
        let t = from + s * (to - from);
        let degree = self.hold.degree();
        let mut values = [1.0, 0.0, 0.0, 0.0];
        let mut slopes = [0.0; 4];
        for p in 1..=degree {
            let lower = values;
            values = [0.0; 4];
            slopes = [0.0; 4];
            for i in 0..p {
                let (left, right) = (knot(i as isize + 1 - p as isize), knot(i as isize + 1));
                let part = lower[i] / (right - left);
                values[i] += (right - t) * part;
                values[i + 1] += (t - left) * part;
                slopes[i] -= p as f64 * part;
                slopes[i + 1] += p as f64 * part;
            }
        }
        (values, slopes.map(|slope| slope / self.step))
    }

    /// Returns the coefficients that act at time node `k`, with their weights: the mean of both sides where constant blocks meet.
    #[must_use]
    pub fn weights(&self, k: usize) -> Weights {
        let last = self.n_blocks() - 1;
        // The block whose interval begins at or before k; the last one also owns the end.
        let block = self
            .edges
            .partition_point(|&edge| edge <= k)
            .saturating_sub(1)
            .min(last);
        if self.hold == Hold::Constant && block > 0 && k == self.edges[block] {
            return [(block - 1, 0.5), (block, 0.5), (block, 0.0), (block, 0.0)];
        }
        let (from, to) = (self.edges[block], self.edges[block + 1]);
        let s = (k - from) as f64 / (to - from) as f64;
        let (values, _) = self.basis(block, s);
        let degree = self.hold.degree();
        std::array::from_fn(|i| (block + i.min(degree), values[i]))
    }

    /// Returns the number of leading coefficients that act at time node `k` or earlier.
    #[must_use]
    pub fn n_started(&self, k: usize) -> usize {
        self.weights(k)[3].0 + 1
    }

    /// Returns the value of the function at time node `k`, from the coefficients.
    #[must_use]
    pub fn value(&self, k: usize, coefficient: impl Fn(usize) -> f64) -> f64 {
        weigh(&self.weights(k), coefficient)
    }

    /// Returns the symmetric matrix `M` with `∫ |u|² dt = Σ_ij M_ij u_i u_j` per component, s.
    #[must_use]
    pub fn effort_matrix(&self) -> Mat<f64> {
        self.gram(|block, s| self.basis(block, s).0)
    }

    /// Returns the symmetric matrix of `∫ |du/dt|² dt`, 1/s. Jumps of a constant hold count as ramps between the middles of the blocks.
    #[must_use]
    pub fn rate_matrix(&self) -> Mat<f64> {
        if self.hold != Hold::Constant {
            return self.gram(|block, s| self.basis(block, s).1);
        }
        let n = self.n_coefficients();
        let mut out = Mat::zeros(n, n);
        for (j, gap) in self.rate_gaps().into_iter().enumerate() {
            out[(j, j)] += 1.0 / gap;
            out[(j + 1, j + 1)] += 1.0 / gap;
            out[(j, j + 1)] -= 1.0 / gap;
            out[(j + 1, j)] -= 1.0 / gap;
        }
        out
    }

    /// Returns the times `g_j`, s, such that `|u_{j+1} - u_j| ≤ r g_j` for all `j` bounds the rate by `r` at all times: the ramp between
    /// the middles of constant blocks, the time between knots, and for the cubic spline the support of a basis function of its derivative
    /// divided by its degree.
    #[must_use]
    pub fn rate_gaps(&self) -> Vec<f64> {
        let last = self.edges.len() - 1;
        let knot = |i: usize| self.edges[i.min(last)] as f64 * self.step;
        (0..self.n_coefficients() - 1)
            .map(|j| match self.hold {
                Hold::Constant => 0.5 * (knot(j + 2) - knot(j)),
                Hold::Linear => knot(j + 1) - knot(j),
                Hold::Cubic => (knot(j + 1) - knot(j.saturating_sub(2))) / 3.0,
            })
            .collect()
    }

    /// Returns weights of the coefficients whose sums bound the command `u + lag du/dt` at all times: its values just after the start and
    /// just before the end of every block of a linear hold; its Bernstein coefficients in every block of a spline, the one that two blocks
    /// share once. Empty for a constant hold, whose command is not a function.
    #[must_use]
    pub fn command_rows(&self, lag: f64) -> Vec<Vec<(usize, f64)>> {
        // Weights of the values at these fractions of a block in every row (Farouki 2012, section 3.3).
        const LINEAR: ([f64; 2], [[f64; 2]; 2]) = ([0.0, 1.0], [[1.0, 0.0], [0.0, 1.0]]);
        const CUBIC: ([f64; 4], [[f64; 4]; 4]) = (
            [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0],
            [
                [1.0, 0.0, 0.0, 0.0],
                [-5.0 / 6.0, 3.0, -1.5, 1.0 / 3.0],
                [1.0 / 3.0, -1.5, 3.0, -5.0 / 6.0],
                [0.0, 0.0, 0.0, 1.0],
            ],
        );
        let mut out = Vec::new();
        let mut add = |block: usize, points: &[f64], rows: &[&[f64]]| {
            let values: Vec<[f64; 4]> = (points.iter())
                .map(|&s| {
                    let (values, slopes) = self.basis(block, s);
                    std::array::from_fn(|i| values[i] + lag * slopes[i])
                })
                .collect();
            for row in rows {
                let weight = |i: usize| -> f64 {
                    (row.iter().zip(&values))
                        .map(|(w, value)| w * value[i])
                        .sum()
                };
                let weights = (0..=self.hold.degree()).map(|i| (block + i, weight(i)));
                out.push(weights.filter(|(_, weight)| *weight != 0.0).collect());
            }
        };
        for block in 0..self.n_blocks() {
            match self.hold {
                Hold::Constant => {}
                Hold::Linear => add(block, &LINEAR.0, &LINEAR.1.each_ref().map(|row| &row[..])),
                Hold::Cubic => {
                    let rows = CUBIC.1.each_ref().map(|row| &row[..]);
                    let last = block + 1 == self.n_blocks();
                    add(block, &CUBIC.0, &rows[..if last { 4 } else { 3 }]);
                }
            }
        }
        out
    }

    /// Returns the weights of the coefficients in `u + lag du/dt` just after time node `k`, or just before it at the end.
    #[must_use]
    pub fn command_weights(&self, k: usize, lag: f64) -> Weights {
        let begun = self.edges.partition_point(|&edge| edge <= k);
        let block = begun.saturating_sub(1).min(self.n_blocks() - 1);
        let (from, to) = (self.edges[block], self.edges[block + 1]);
        let (values, slopes) = self.basis(block, (k - from) as f64 / (to - from) as f64);
        let degree = self.hold.degree();
        std::array::from_fn(|i| (block + i.min(degree), values[i] + lag * slopes[i]))
    }

    fn gram(&self, functions: impl Fn(usize, f64) -> [f64; 4]) -> Mat<f64> {
        let n = self.n_coefficients();
        let mut out = Mat::zeros(n, n);
        let count = self.hold.degree() + 1;
        for block in 0..self.n_blocks() {
            let duration = (self.edges[block + 1] - self.edges[block]) as f64 * self.step;
            for (s, weight) in QUADRATURE {
                let values = functions(block, s);
                for i in 0..count {
                    for j in 0..count {
                        out[(block + i, block + j)] += weight * duration * values[i] * values[j];
                    }
                }
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOLDS: [Hold; 3] = [Hold::Constant, Hold::Linear, Hold::Cubic];

    /// Returns the force along x at time node `k`.
    fn force(grid: &ControlGrid, k: usize, coefficients: &[f64]) -> f64 {
        grid.value(k, |j| coefficients[j])
    }

    fn quadratic(matrix: &Mat<f64>, u: &[f64]) -> f64 {
        let row = |i: usize| -> f64 { u.iter().enumerate().map(|(j, v)| matrix[(i, j)] * v).sum() };
        u.iter().enumerate().map(|(i, v)| v * row(i)).sum()
    }

    /// Weights at every node add to one, and refining the grid keeps the function: the shared nodes agree.
    #[test]
    fn refinement_keeps_the_function() {
        for hold in HOLDS {
            for (blocks, steps) in [(1, 1), (3, 10), (7, 7), (20, 1000)] {
                let grid = ControlGrid::new(hold, blocks, steps, 0.01).expect("enough steps");
                let u: Vec<f64> = (0..grid.n_coefficients()).map(|j| (j * j) as f64).collect();
                let ones = vec![1.0; u.len()];
                let fine = grid.refined(4);
                for k in 0..=steps {
                    let (coarse, fine) = (force(&grid, k, &u), force(&fine, 4 * k, &u));
                    assert!((coarse - fine).abs() < 1e-12 * (1.0 + coarse.abs()));
                    assert!((force(&grid, k, &ones) - 1.0).abs() < 1e-14);
                }
            }
        }
    }

    /// Coefficients at their own times reproduce u = t, whose `∫ u² dt` and `∫ u̇² dt` over [0, 1] are 1/3 and 1; blocks of unequal
    /// length.
    #[test]
    fn ramps_are_exact_and_integrate() {
        for hold in [Hold::Linear, Hold::Cubic] {
            for blocks in [1, 3, 7, 30] {
                let grid = ControlGrid::new(hold, blocks, 100, 0.01).expect("enough steps");
                let u = grid.coefficient_times();
                for k in 0..=100 {
                    assert!((force(&grid, k, &u) - k as f64 * 0.01).abs() < 1e-14);
                }
                assert!((quadratic(&grid.effort_matrix(), &u) - 1.0 / 3.0).abs() < 1e-14);
                assert!((quadratic(&grid.rate_matrix(), &u) - 1.0).abs() < 1e-12);
                let slopes =
                    (u.windows(2).zip(grid.rate_gaps())).map(|(u, gap)| (u[1] - u[0]) / gap);
                assert!(slopes.into_iter().all(|slope| (slope - 1.0).abs() < 1e-12));
            }
        }
    }

    /// The spline's cost matrices against sums over a fine grid, and its rate within the bound of its coefficients' differences.
    #[test]
    fn splines_integrate_and_keep_their_rate() {
        let grid = ControlGrid::new(Hold::Cubic, 7, 100, 0.01).expect("enough steps");
        let u: Vec<f64> = (0..10).map(|j| ((j * 7) % 5) as f64).collect();
        let n = 100 * 64;
        let fine = grid.refined(64);
        let values: Vec<f64> = (0..=n).map(|k| force(&fine, k, &u)).collect();
        let h = 1.0 / n as f64;
        let square: f64 = values
            .windows(2)
            .map(|v| h * 0.25 * (v[0] + v[1]).powi(2))
            .sum();
        let slopes: Vec<f64> = values.windows(2).map(|v| (v[1] - v[0]) / h).collect();
        let rate: f64 = slopes.iter().map(|s| h * s * s).sum();
        // Midpoint rule: off by h²/24 times second derivatives of order (7 blocks)² of squares of order 16.
        assert!((quadratic(&grid.effort_matrix(), &u) - square).abs() < 1e-5);
        assert!((quadratic(&grid.rate_matrix(), &u) - rate).abs() < 1e-3 * rate);
        let bound = (u.windows(2).zip(grid.rate_gaps()))
            .map(|(u, gap)| (u[1] - u[0]).abs() / gap)
            .fold(0.0, f64::max);
        let largest = slopes.iter().fold(0.0, |m: f64, s| m.max(s.abs()));
        assert!(largest <= bound && largest > 0.5 * bound);
    }

    /// The command `u + lag du/dt` lies between the least and the largest row, is a row at the ends of blocks, and of `u = t` it is
    /// `t + lag`: the rows are then those of a line, at the ends of blocks or at thirds of them.
    #[test]
    fn rows_of_commands_enclose_the_command() {
        let lag = 0.07;
        for hold in [Hold::Linear, Hold::Cubic] {
            let grid = ControlGrid::new(hold, 7, 100, 0.01).expect("enough steps");
            let rows = grid.command_rows(lag);
            let of = |u: &[f64]| -> Vec<f64> {
                let sum = |row: &Vec<(usize, f64)>| row.iter().map(|&(j, w)| w * u[j]).sum();
                rows.iter().map(sum).collect()
            };
            let times = grid.edge_times();
            let line = of(&grid.coefficient_times());
            let mut expected = Vec::new();
            for edge in times.windows(2) {
                let places: &[f64] = match hold {
                    Hold::Linear => &[0.0, 1.0],
                    _ => &[0.0, 1.0 / 3.0, 2.0 / 3.0],
                };
                expected.extend(
                    places
                        .iter()
                        .map(|s| edge[0] + s * (edge[1] - edge[0]) + lag),
                );
            }
            if hold == Hold::Cubic {
                expected.push(1.0 + lag);
            }
            assert_eq!(line.len(), expected.len());
            for (found, expected) in line.iter().zip(&expected) {
                assert!((found - expected).abs() < 1e-13, "{found} {expected}");
            }
            let u: Vec<f64> = (0..grid.n_coefficients())
                .map(|j| ((j * 7) % 5) as f64)
                .collect();
            let own = of(&u);
            let (low, high) = own
                .iter()
                .fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(*x), b.max(*x)));
            let fine = grid.refined(16);
            let mut reached = [false; 2];
            for k in 0..=1600 {
                let c: f64 = fine
                    .command_weights(k, lag)
                    .iter()
                    .map(|(j, w)| w * u[*j])
                    .sum();
                assert!(
                    low - 1e-12 <= c && c <= high + 1e-12,
                    "{c} not in {low}..{high}"
                );
                reached[0] |= c < low + 0.1 * (high - low);
                reached[1] |= c > high - 0.1 * (high - low);
            }
            assert_eq!(reached, [true; 2]);
        }
        let grid = ControlGrid::new(Hold::Constant, 7, 100, 0.01).expect("enough steps");
        assert!(grid.command_rows(lag).is_empty());
    }

    /// More blocks than steps, and no blocks, are refused.
    #[test]
    fn impossible_blocks_are_refused() {
        assert!(ControlGrid::new(Hold::Constant, 0, 10, 0.1).is_none());
        assert!(ControlGrid::new(Hold::Constant, 11, 10, 0.1).is_none());
    }
}
