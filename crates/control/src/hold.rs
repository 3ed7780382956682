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

/// Returns the B-splines of a degree up to 3 that do not vanish between the knots 0 and 1, and their derivatives along `t`, by the recursion
/// of Cox and de Boor. The knots from `1 - degree` to `degree` increase, and knot 1 is beyond knot 0.
#[must_use]
pub fn b_splines(knot: impl Fn(isize) -> f64, degree: usize, t: f64) -> ([f64; 4], [f64; 4]) {
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
    (values, slopes)
}

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
        let knot = |i: isize| {
            let last = self.edges.len() as isize - 1;
            self.edges[(block as isize + i).clamp(0, last) as usize] as f64
        };
        let t = knot(0) + s * (knot(1) - knot(0));
        let (values, slopes) = b_splines(knot, self.hold.degree(), t);
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
