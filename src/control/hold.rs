//! Control signals: coefficients held constant over blocks, or joined linearly between knots.

use crate::mechanics::Wrench;

/// How coefficients become a function of time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hold {
    /// One coefficient per block, constant over it.
    Constant,
    /// One coefficient per knot (blocks + 1 of them), linear in between.
    Linear,
}

/// The blocks of a control on a time grid, and how its coefficients act at the time nodes.
#[derive(Clone, Debug, PartialEq)]
pub struct ControlGrid {
    /// How coefficients become a function of time.
    pub hold: Hold,
    /// First step of every block, and the number of steps at the end.
    edges: Vec<usize>,
    /// Step of the grid, s.
    step: f64,
}

impl ControlGrid {
    /// `n_blocks` blocks, as equal as whole steps allow. `None` when there are no blocks or fewer steps than blocks.
    #[must_use]
    pub fn new(hold: Hold, n_blocks: usize, n_steps: usize, step: f64) -> Option<Self> {
        if n_blocks == 0 || n_steps < n_blocks {
            return None;
        }
        let edges = (0..=n_blocks)
            .map(|block| {
                // Round to nearest in integers: exact for any size that fits in memory.
                let product = block as u128 * n_steps as u128;
                ((2 * product + n_blocks as u128) / (2 * n_blocks as u128)) as usize
            })
            .collect();
        Some(Self { hold, edges, step })
    }

    /// The same function of time on a grid whose steps are `factor` times shorter.
    #[must_use]
    pub fn refined(&self, factor: usize) -> Self {
        Self {
            hold: self.hold,
            edges: self.edges.iter().map(|edge| edge * factor).collect(),
            step: self.step / factor as f64,
        }
    }

    /// Number of blocks.
    #[must_use]
    pub fn n_blocks(&self) -> usize {
        self.edges.len() - 1
    }

    /// Number of coefficients per component: blocks, or knots.
    #[must_use]
    pub fn n_coefficients(&self) -> usize {
        match self.hold {
            Hold::Constant => self.n_blocks(),
            Hold::Linear => self.n_blocks() + 1,
        }
    }

    /// Number of steps of the grid.
    #[must_use]
    pub fn n_steps(&self) -> usize {
        self.edges[self.edges.len() - 1]
    }

    /// Times at which blocks begin, and the end, s.
    #[must_use]
    pub fn edge_times(&self) -> Vec<f64> {
        self.edges
            .iter()
            .map(|&edge| edge as f64 * self.step)
            .collect()
    }

    /// Coefficients that act at time node `k`, with their weights: the mean of both sides where blocks meet.
    ///
    /// Never more than two; the second weight is zero where one suffices.
    #[must_use]
    pub fn weights(&self, k: usize) -> [(usize, f64); 2] {
        let last = self.n_blocks() - 1;
        // The block whose interval begins at or before k; the last one also owns the end.
        let block = self
            .edges
            .partition_point(|&edge| edge <= k)
            .saturating_sub(1)
            .min(last);
        match self.hold {
            Hold::Constant => {
                if block > 0 && k == self.edges[block] {
                    [(block - 1, 0.5), (block, 0.5)]
                } else {
                    [(block, 1.0), (block, 0.0)]
                }
            }
            Hold::Linear => {
                let (from, to) = (self.edges[block], self.edges[block + 1]);
                let s = (k - from) as f64 / (to - from) as f64;
                [(block, 1.0 - s), (block + 1, s)]
            }
        }
    }

    /// Number of leading coefficients that act at time node `k` or earlier.
    #[must_use]
    pub fn n_started(&self, k: usize) -> usize {
        self.weights(k)[1].0 + 1
    }

    /// Wrench at every time node.
    #[must_use]
    pub fn nodal_wrenches(&self, coefficients: &[Wrench]) -> Vec<Wrench> {
        (0..=self.n_steps())
            .map(|k| {
                let mut sum = Wrench::default();
                for (coefficient, weight) in self.weights(k) {
                    sum.force += coefficients[coefficient].force * weight;
                    sum.moment += coefficients[coefficient].moment * weight;
                }
                sum
            })
            .collect()
    }

    /// Symmetric tridiagonal matrix `M` with `∫ |u|² dt = Σ_ij M_ij u_i u_j` per component, as (diagonal, off-diagonal), s.
    #[must_use]
    pub fn effort_matrix(&self) -> (Vec<f64>, Vec<f64>) {
        let durations = self.durations();
        match self.hold {
            Hold::Constant => (durations.clone(), vec![0.0; durations.len() - 1]),
            Hold::Linear => {
                let mut diagonal = vec![0.0; durations.len() + 1];
                for (i, d) in durations.iter().enumerate() {
                    diagonal[i] += d / 3.0;
                    diagonal[i + 1] += d / 3.0;
                }
                (diagonal, durations.iter().map(|d| d / 6.0).collect())
            }
        }
    }

    /// Symmetric tridiagonal matrix of `∫ |du/dt|² dt`, 1/s. A constant hold counts its jumps as ramps between the
    /// middles of the blocks.
    #[must_use]
    pub fn rate_matrix(&self) -> (Vec<f64>, Vec<f64>) {
        let durations = self.durations();
        let gaps: Vec<f64> = match self.hold {
            Hold::Constant => durations.windows(2).map(|d| 0.5 * (d[0] + d[1])).collect(),
            Hold::Linear => durations,
        };
        let mut diagonal = vec![0.0; gaps.len() + 1];
        for (i, gap) in gaps.iter().enumerate() {
            diagonal[i] += 1.0 / gap;
            diagonal[i + 1] += 1.0 / gap;
        }
        (diagonal, gaps.iter().map(|gap| -1.0 / gap).collect())
    }

    fn durations(&self) -> Vec<f64> {
        self.edges
            .windows(2)
            .map(|edge| (edge[1] - edge[0]) as f64 * self.step)
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn ramp(grid: &ControlGrid) -> Vec<Wrench> {
        (0..grid.n_coefficients())
            .map(|j| Wrench {
                force: Vector3::new(j as f64, 1.0, 0.0),
                ..Wrench::default()
            })
            .collect()
    }

    /// Weights at every node add to one, and refining the grid keeps the function: the shared nodes agree.
    #[test]
    fn refinement_keeps_the_function() {
        for hold in [Hold::Constant, Hold::Linear] {
            for (blocks, steps) in [(1, 1), (3, 10), (7, 7), (20, 1000)] {
                let grid = ControlGrid::new(hold, blocks, steps, 0.01).expect("enough steps");
                let u = ramp(&grid);
                let coarse = grid.nodal_wrenches(&u);
                let fine = grid.refined(4).nodal_wrenches(&u);
                for (k, wrench) in coarse.iter().enumerate() {
                    assert!((wrench.force - fine[4 * k].force).norm() < 1e-12);
                    assert!((wrench.force.y - 1.0).abs() < 1e-15);
                }
            }
        }
    }

    /// `∫ u² dt` and `∫ u̇² dt` by the matrices equal the closed forms of u = t on [0, 1] under linear hold.
    #[test]
    fn cost_matrices_integrate() {
        let grid = ControlGrid::new(Hold::Linear, 10, 100, 0.01).expect("enough steps");
        let u: Vec<f64> = grid.edge_times();
        let quadratic = |(diagonal, off): (Vec<f64>, Vec<f64>)| -> f64 {
            diagonal.iter().zip(&u).map(|(d, u)| d * u * u).sum::<f64>()
                + off
                    .iter()
                    .zip(u.windows(2))
                    .map(|(o, u)| 2.0 * o * u[0] * u[1])
                    .sum::<f64>()
        };
        assert!((quadratic(grid.effort_matrix()) - 1.0 / 3.0).abs() < 1e-14);
        assert!((quadratic(grid.rate_matrix()) - 1.0).abs() < 1e-13);
    }

    /// More blocks than steps, and no blocks, are refused.
    #[test]
    fn impossible_blocks_are_refused() {
        assert!(ControlGrid::new(Hold::Constant, 0, 10, 0.1).is_none());
        assert!(ControlGrid::new(Hold::Constant, 11, 10, 0.1).is_none());
    }
}
