//! The nodes of a rod: fractions of the rest length at which its elements end.

/// Fractions of the length that differ by less than this are one place.
pub const SAME: f64 = 1e-9;
/// Cap on the elements that a scene may ask for and that advice recommends; a larger number is taken for a typing error.
pub const MOST_ELEMENTS: usize = 5000;

/// The division of a rod into elements, from base to tip.
///
/// Breaks divide the rod into pieces, and the elements of a piece are equally long. Without breaks there is one piece.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    pieces: Vec<Piece>,
}

/// A part of the rod whose elements are equally long.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Piece {
    /// Fractions of the rest length at its ends.
    from: f64,
    to: f64,
    /// Index of its first element.
    first: usize,
    /// Number of its elements.
    elements: usize,
}

impl Piece {
    fn span(&self) -> f64 {
        self.to - self.from
    }
}

impl Mesh {
    /// Returns the mesh of equal elements.
    #[must_use]
    pub fn uniform(n_elements: usize) -> Self {
        Self::new(n_elements, &[], 1)
    }

    /// Divides a rod at the `breaks`, fractions of the length in any order; those at base, tip, or one another count once. The elements are
    /// shared out among the pieces by length: every piece gets the whole part of `n_elements` times its fraction of the length, and the
    /// elements that are left go one by one to the pieces with the largest remainders. A piece has at least one element, so that a mesh may
    /// have more than `n_elements`, one for each piece. They are shared out in lots of `multiple`, by which every piece's number is then
    /// divisible: a mesh of `m n_elements` in lots of `m` divides every element of a mesh of `n_elements` into `m`.
    #[must_use]
    pub fn new(n_elements: usize, breaks: &[f64], multiple: usize) -> Self {
        let mut ends: Vec<f64> = (breaks.iter().copied())
            .filter(|s| *s > SAME && *s < 1.0 - SAME)
            .collect();
        ends.sort_by(f64::total_cmp);
        ends.dedup_by(|b, a| *b - *a < SAME);
        let starts = [0.0].into_iter().chain(ends.iter().copied());
        let spans: Vec<[f64; 2]> = starts
            .zip(ends.iter().copied().chain([1.0]))
            .map(Into::into)
            .collect();
        let multiple = multiple.max(1);
        let shares = shared_out(n_elements / multiple, &spans);
        let mut first = 0;
        let pieces = spans.iter().zip(shares).map(|(&[from, to], share)| {
            let piece = Piece {
                from,
                to,
                first,
                elements: share * multiple,
            };
            first += piece.elements;
            piece
        });
        Self {
            pieces: pieces.collect(),
        }
    }

    /// Returns the number of elements.
    #[must_use]
    pub fn n_elements(&self) -> usize {
        self.pieces
            .last()
            .map_or(0, |last| last.first + last.elements)
    }

    /// Returns the number of pieces, the least number of elements.
    #[must_use]
    pub fn n_pieces(&self) -> usize {
        self.pieces.len()
    }

    /// Returns the arc length of a node at rest, divided by that of the tip.
    #[must_use]
    pub fn fraction(&self, node: usize) -> f64 {
        if node >= self.n_elements() {
            return 1.0;
        }
        self.along(node, 0.0)
    }

    /// Returns the [fractions](Self::fraction) of all nodes.
    #[must_use]
    pub fn fractions(&self) -> Vec<f64> {
        (0..=self.n_elements())
            .map(|node| self.fraction(node))
            .collect()
    }

    /// Returns the arc length at the fraction `s` of an element, divided by that of the tip.
    #[must_use]
    pub fn along(&self, element: usize, s: f64) -> f64 {
        let piece = self.piece(element);
        piece.from + piece.span() * (((element - piece.first) as f64 + s) / piece.elements as f64)
    }

    /// Returns the length of an element of a rod of rest length `length`, m.
    #[must_use]
    pub fn length(&self, element: usize, length: f64) -> f64 {
        let piece = self.piece(element);
        length * piece.span() / piece.elements as f64
    }

    /// Returns the node nearest to a fraction of the length.
    #[must_use]
    pub fn nearest(&self, fraction: f64) -> usize {
        let at = self.pieces.partition_point(|piece| piece.to < fraction);
        let piece = &self.pieces[at.min(self.pieces.len() - 1)];
        let within = (fraction - piece.from) / piece.span() * piece.elements as f64;
        piece.first + (within.round() as usize).min(piece.elements)
    }

    /// Returns the node at a fraction of the length, up to rounding; `None` if there is none.
    #[must_use]
    pub fn node_at(&self, fraction: f64) -> Option<usize> {
        let node = self.nearest(fraction);
        ((self.fraction(node) - fraction).abs() < SAME).then_some(node)
    }

    /// Returns the piece of an element; the last one for an element that does not exist.
    fn piece(&self, element: usize) -> &Piece {
        let after = self.pieces.partition_point(|piece| piece.first <= element);
        &self.pieces[after - 1]
    }
}

/// Shares out a number of elements among pieces, given by their ends.
fn shared_out(n_elements: usize, spans: &[[f64; 2]]) -> Vec<usize> {
    let due: Vec<f64> = (spans.iter())
        .map(|[from, to]| n_elements as f64 * (to - from))
        .collect();
    let mut shares: Vec<usize> = due.iter().map(|due| (*due as usize).max(1)).collect();
    let mut left = n_elements as i64 - shares.iter().sum::<usize>() as i64;
    let lacking = |shares: &[usize], q: usize| due[q] - shares[q] as f64;
    while left != 0 {
        let all = 0..shares.len();
        let chosen = if left > 0 {
            // The first of equals.
            all.rev()
                .max_by(|&a, &b| lacking(&shares, a).total_cmp(&lacking(&shares, b)))
        } else {
            all.filter(|&q| shares[q] > 1)
                .min_by(|&a, &b| lacking(&shares, a).total_cmp(&lacking(&shares, b)))
        };
        let Some(chosen) = chosen else { break };
        if left > 0 {
            shares[chosen] += 1;
            left -= 1;
        } else {
            shares[chosen] -= 1;
            left += 1;
        }
    }
    shares
}
