//! The refusal of impossible signals.

use crate::signal::{Measurement, Quantity};

/// Sum of one square of a standard normal number, or of three, that is exceeded once in 10⁹ times (decision 80), and its median:
/// chi-square with one and with three degrees of freedom.
const ONE: [f64; 2] = [37.324_893, 0.454_936];
const THREE: [f64; 2] = [44.841_275, MEDIAN];
/// Median of the sum of three, to which squares of other sums are brought.
const MEDIAN: f64 = 2.365_974;
/// Number of recent signals from whose squares the gate decides whether the model is wrong. The median of `n` squares has the standard
/// deviation `1/(2 f sqrt n)` with the density `f = 0.188` of chi-square at its median: 0.5 of 2.4 for 30, so that the threshold is known
/// to a fifth.
const RECENT: usize = 30;
/// Number of consecutive refusals of a signal, after which it is accepted (decision 80): a cap on the time for which a wrong estimate
/// refuses right signals, three periods of a sensor. The first 0.6 s of `mpc-reach`, in which 14 signals are refused, are the same with two
/// and with six.
const MOST_REFUSALS: usize = 3;

/// Refuses impossible signals: their squares exceed the limit of chi-square, multiplied by the ratio of the median of recent squares to its
/// expected value.
///
/// A single wrong signal is an outlier among its neighbors. If most signals are off, as after a jump of the command that excites waves a
/// coarse model does not have, the model is wrong, and refusing the signals would leave it wrong. The median remains that of the right
/// signals as long as fewer than half are wrong (the identifier of Hampel 1974).
#[derive(Debug)]
pub struct Gate {
    /// Marks for the refused signals of the last measurement; empty if all are used.
    refused: Vec<bool>,
    /// Signals that were refused, and how many consecutive times.
    in_a_row: Vec<(Quantity, f64, [f64; 2], usize)>,
    /// Squares of the last [`RECENT`] signals; the oldest is at `oldest` once there are as many.
    recent: Vec<f64>,
    oldest: usize,
    sorted: Vec<f64>,
}

impl Default for Gate {
    fn default() -> Self {
        Self {
            refused: Vec::new(),
            in_a_row: Vec::new(),
            recent: Vec::with_capacity(RECENT),
            oldest: 0,
            sorted: Vec::with_capacity(RECENT),
        }
    }
}

impl Gate {
    /// Accepts all signals of the next measurement.
    pub fn clear(&mut self) {
        self.refused.clear();
    }

    /// Returns marks for the refused signals of the last measurement; empty if all are used.
    pub fn refused(&self) -> &[bool] {
        &self.refused
    }

    /// Judges the signals of a measurement by the normalized squares of their innovations; returns the number of refused ones.
    pub fn judge(
        &mut self,
        measurement: &Measurement,
        squares: impl Iterator<Item = f64>,
    ) -> usize {
        self.refused.clear();
        let excess = self.excess();
        for (signal, square) in measurement.signals.iter().zip(squares) {
            let (quantity, place, offset) =
                (signal.reading.quantity(), signal.place, signal.offset);
            let [largest, median] = match quantity.row().numbers {
                1 => ONE,
                _ => THREE,
            };
            self.note(square * (MEDIAN / median));
            let largest = largest * excess;
            let at = (self.in_a_row.iter())
                .position(|own| (own.0, own.1, own.2) == (quantity, place, offset));
            let is_refused = square > largest && {
                let at = at.unwrap_or_else(|| {
                    self.in_a_row.push((quantity, place, offset, 0));
                    self.in_a_row.len() - 1
                });
                self.in_a_row[at].3 += 1;
                self.in_a_row[at].3 <= MOST_REFUSALS
            };
            if let (Some(at), true) = (at, square <= largest) {
                self.in_a_row[at].3 = 0;
            }
            self.refused.push(is_refused);
        }
        self.refused.iter().filter(|refused| **refused).count()
    }

    /// Returns the ratio of the median of recent squares to its expected value, at least 1; 1 until there are enough of them.
    fn excess(&mut self) -> f64 {
        if self.recent.len() < RECENT {
            return 1.0;
        }
        self.sorted.clone_from(&self.recent);
        self.sorted.sort_unstable_by(f64::total_cmp);
        (self.sorted[RECENT / 2] / MEDIAN).max(1.0)
    }

    fn note(&mut self, square: f64) {
        if self.recent.len() < RECENT {
            self.recent.push(square);
        } else {
            self.recent[self.oldest] = square;
            self.oldest = (self.oldest + 1) % RECENT;
        }
    }
}
