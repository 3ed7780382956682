//! Linear systems with a banded matrix, by Gaussian elimination: the adjoint of an implicit step couples neighboring nodes.

/// A square matrix whose entries vanish further than `half_width` from the diagonal.
#[derive(Clone, Debug)]
pub(super) struct Banded {
    half_width: usize,
    size: usize,
    /// Row by row from `half_width` left of the diagonal to twice that right of it, where exchanged rows fill in.
    entries: Vec<f64>,
}

impl Banded {
    pub fn zeros(size: usize, half_width: usize) -> Self {
        Self {
            half_width,
            size,
            entries: vec![0.0; size * (3 * half_width + 1)],
        }
    }

    fn index(&self, row: usize, column: usize) -> usize {
        row * (3 * self.half_width + 1) + column + self.half_width - row
    }

    /// Adds to an entry within the band.
    pub fn add(&mut self, row: usize, column: usize, value: f64) {
        let at = self.index(row, column);
        self.entries[at] += value;
    }

    /// `A⁻¹ b` in place, with rows of equal size and partial pivoting; a singular matrix leaves what is not finite.
    pub fn solve(mut self, b: &mut [f64]) {
        let (n, reach) = (self.size, self.half_width);
        for (row, b) in self.entries.chunks_mut(3 * reach + 1).zip(&mut *b) {
            let largest = row.iter().fold(0.0, |m: f64, entry| m.max(entry.abs()));
            row.iter_mut().for_each(|entry| *entry /= largest);
            *b /= largest;
        }
        for column in 0..n {
            let below = column..(column + reach + 1).min(n);
            let right = column..(column + 2 * reach + 1).min(n);
            let size = |row: usize| self.entries[self.index(row, column)].abs();
            let pivot = below
                .clone()
                .max_by(|&a, &b| size(a).total_cmp(&size(b)))
                .unwrap_or(column);
            for j in right.clone() {
                let (a, b) = (self.index(column, j), self.index(pivot, j));
                self.entries.swap(a, b);
            }
            b.swap(column, pivot);
            for row in below.skip(1) {
                let factor = self.entries[self.index(row, column)]
                    / self.entries[self.index(column, column)];
                for j in right.clone() {
                    let change = factor * self.entries[self.index(column, j)];
                    let at = self.index(row, j);
                    self.entries[at] -= change;
                }
                b[row] -= factor * b[column];
            }
        }
        for row in (0..n).rev() {
            let known: f64 = (row + 1..(row + 2 * reach + 1).min(n))
                .map(|j| self.entries[self.index(row, j)] * b[j])
                .sum();
            b[row] = (b[row] - known) / self.entries[self.index(row, row)];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Random bands, with zeros on the diagonal so that rows must be exchanged, and rows of very different sizes: the solve
    /// gives back a known solution.
    #[test]
    fn solves_a_known_system() {
        for (n, reach) in [(1, 0), (7, 2), (40, 11), (5, 11)] {
            let mut matrix = Banded::zeros(n, reach);
            let x: Vec<f64> = (0..n).map(|i| (0.7 * i as f64).cos()).collect();
            let mut b = vec![0.0; n];
            for (i, b) in b.iter_mut().enumerate() {
                for j in i.saturating_sub(reach)..(i + reach + 1).min(n) {
                    let noise = (1.3 * i as f64 + 2.9 * j as f64 + 0.4).sin();
                    let value = if i == j && n > 1 { 0.0 } else { noise };
                    let value = value * 10f64.powi(i as i32 % 7 - 3);
                    matrix.add(i, j, value);
                    *b += value * x[j];
                }
            }
            matrix.solve(&mut b);
            for (found, wanted) in b.iter().zip(&x) {
                assert!(
                    (found - wanted).abs() < 1e-10,
                    "{n} {reach}: {found} {wanted}"
                );
            }
        }
    }
}
