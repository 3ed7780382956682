//! The controls over a receding horizon as functions of time.

use mechanics::TimeGrid;

use super::error::MpcError;
use control::Hold;

/// Two knots are one if they are closer than this fraction of a block: far above the rounding of times, and too near for a plan to tell
/// them.
const SAME: f64 = 1e-6;

/// Coefficients of a control over `[start, end]`, on a lattice of block lengths that is fixed in time while the horizon moves: a plan that
/// is carried over from one sample to the next is the same function of time.
///
/// The first and the last knot are the ends of the horizon, those between them lie on the lattice. Blocks may double in length with their
/// distance from the start: a block of `2^m` lattice lengths then begins at a multiple of itself, so that it is divided when it comes
/// nearer, and no other knot is lost.
#[derive(Debug)]
pub struct Knots {
    hold: Hold,
    block: f64,
    /// Number of whole blocks of each length after the block that has begun; `None` if all are equal.
    doubling: Option<usize>,
    times: Vec<f64>,
}

/// The coefficients that act at one time, with their weights; unused entries have weight 0.
pub type Pair = [(usize, f64); 2];

impl Clone for Knots {
    fn clone(&self) -> Self {
        Self {
            times: self.times.clone(),
            ..*self
        }
    }

    /// Copies into existing memory.
    fn clone_from(&mut self, other: &Self) {
        self.hold = other.hold;
        self.block = other.block;
        self.doubling = other.doubling;
        self.times.clone_from(&other.times);
    }
}

impl Knots {
    /// Creates the knots.
    ///
    /// # Errors
    /// Returns [`MpcError::Hold`] for a hold that is neither constant nor linear.
    pub fn new(
        hold: Hold,
        block: f64,
        doubling: Option<usize>,
        longest: f64,
    ) -> Result<Self, MpcError> {
        if hold == Hold::Cubic {
            return Err(MpcError::Hold);
        }
        let most = (longest / block).ceil() as usize + 3;
        Ok(Self {
            hold,
            block,
            doubling,
            times: Vec::with_capacity(most),
        })
    }

    /// Returns the largest number of blocks in a horizon of this length.
    pub fn blocks(&self, longest: f64) -> usize {
        match self.doubling {
            None => (longest / self.block).round().max(1.0) as usize,
            Some(_) => self.most(longest) - 1,
        }
    }

    /// Returns the largest number of coefficients in a horizon of this length.
    pub fn most(&self, longest: f64) -> usize {
        let inside = if self.doubling.is_none() {
            (longest / self.block - SAME).ceil() as usize
        } else {
            // The pattern of blocks repeats with the longest block, which is not longer than the horizon.
            let phases = ((longest / self.block).ceil() as usize).next_power_of_two();
            let mut tried = self.clone();
            let inside = (0..phases).map(|phase| {
                let start = (phase as f64 + 0.5) * self.block;
                tried.place(start, start + longest);
                tried.times.len() - 2
            });
            inside.max().unwrap_or(0)
        };
        match self.hold {
            Hold::Constant => inside + 1,
            Hold::Linear | Hold::Cubic => inside + 2,
        }
    }

    /// Places the knots for a horizon from `start` to `end`.
    pub fn place(&mut self, start: f64, end: f64) {
        let least = SAME * self.block;
        self.times.clear();
        self.times.push(start);
        let first = (start / self.block).floor();
        let mut index = first + 1.0;
        while index * self.block < end - least {
            if index * self.block > start + least {
                self.times.push(index * self.block);
            }
            index += self.stride(index, index - first - 1.0);
        }
        self.times.push(end);
    }

    /// Returns the length, in lattice lengths, of the block that begins at a place of the lattice, at the given distance from the first one
    /// ahead.
    fn stride(&self, index: f64, distance: f64) -> f64 {
        let Some(equal) = self.doubling else {
            return 1.0;
        };
        // There are equally many blocks of each length: those of `m` lattice lengths begin `m - 1` times as many of these away.
        let longest = 1.0 + distance / equal as f64;
        let mut stride = 1.0;
        while 2.0 * stride <= longest && index % (2.0 * stride) == 0.0 {
            stride *= 2.0;
        }
        stride
    }

    /// Returns the course of the control within a block.
    pub fn hold(&self) -> Hold {
        self.hold
    }

    /// Returns the number of coefficients.
    pub fn n_coefficients(&self) -> usize {
        match self.hold {
            Hold::Constant => self.times.len() - 1,
            Hold::Linear | Hold::Cubic => self.times.len(),
        }
    }

    /// Returns the time of a coefficient, s: its knot, or the middle of its block.
    pub fn time(&self, index: usize) -> f64 {
        match self.hold {
            Hold::Constant => 0.5 * (self.times[index] + self.times[index + 1]),
            Hold::Linear | Hold::Cubic => self.times[index],
        }
    }

    /// Returns the time between a coefficient and the next one, s.
    pub fn gap(&self, index: usize) -> f64 {
        self.time(index + 1) - self.time(index)
    }

    /// Returns the coefficients of the control at time `t`, which is constant outside the horizon.
    pub fn at(&self, t: f64) -> Pair {
        let last = self.times.len() - 1;
        let piece = (self.times.partition_point(|knot| *knot <= t)).clamp(1, last) - 1;
        match self.hold {
            Hold::Constant => [(piece, 1.0), (piece, 0.0)],
            Hold::Linear | Hold::Cubic => {
                let (a, b) = (self.times[piece], self.times[piece + 1]);
                let s = ((t - a) / (b - a)).clamp(0.0, 1.0);
                [(piece, 1.0 - s), (piece + 1, s)]
            }
        }
    }

    /// Returns the coefficients of the control at time node `k`: its value if the course is linear, its mean over half an interval on
    /// either side if the course is constant.
    pub fn at_node(&self, grid: &TimeGrid, k: usize) -> Pair {
        let t = grid.time(k);
        if self.hold == Hold::Linear {
            return self.at(t);
        }
        let half = 0.5 * grid.step;
        let from = if k == 0 { t } else { t - half };
        let to = if k == grid.n_steps { t } else { t + half };
        let ([(a, _), _], [(b, _), _]) = (self.at(from), self.at(to * (1.0 - f64::EPSILON)));
        if a == b || to <= from {
            return [(a, 1.0), (a, 0.0)];
        }
        let s = ((self.times[b] - from) / (to - from)).clamp(0.0, 1.0);
        [(a, s), (b, 1.0 - s)]
    }

    /// Returns the integral of the square over the horizon as a tridiagonal form: the entries of coefficient `index` with itself and with
    /// the next one.
    pub fn square(&self, index: usize) -> [f64; 2] {
        match self.hold {
            Hold::Constant => [self.times[index + 1] - self.times[index], 0.0],
            Hold::Linear | Hold::Cubic => {
                let after =
                    (self.times.get(index + 1)).map_or(0.0, |next| next - self.times[index]);
                let before = index.checked_sub(1);
                let before = before.map_or(0.0, |i| self.times[index] - self.times[i]);
                [(before + after) / 3.0, after / 6.0]
            }
        }
    }
}
