//! The block-tridiagonal equations of a step, factored from both ends of the rod toward its middle: two chains of
//! operations that do not wait for one another. The lanes of a vector are along the columns of a block, because there is one matrix at a
//! time; the products with the pivots are kept, because factors serve the right-hand sides of many steps. Where there is a matrix in each
//! lane, the [plain recursion](cosserat::block_tridiagonal) has enough that does not wait.

/// Components of a node: three of its motion, three of its rotation.
pub const SIZE: usize = 6;

/// The components of a node, padded to a cache line, so that no vector straddles two.
#[repr(align(64))]
#[derive(Clone, Copy, Debug)]
pub struct Column(pub [f64; 8]);

/// A 6×6 matrix, column by column.
pub type ChainBlock = [Column; SIZE];

const NONE: Column = Column([0.0; 8]);
pub const ZERO: ChainBlock = [NONE; SIZE];

/// Factors of a block-tridiagonal matrix. With `i` on the way to the middle and `j` the next node on it:
#[derive(Clone, Debug)]
struct Link {
    /// `A_ji P_i`: factor of the right-hand side of `i` that is subtracted from that of `j`.
    onward: ChainBlock,
    /// `P_i`, the inverse of the pivot.
    pivot: ChainBlock,
    /// `P_i A_ij`: factor of the solution of `j` that is subtracted from that of `i`.
    back: ChainBlock,
}

/// A factored matrix, and a right-hand side.
#[derive(Clone, Debug)]
pub struct Chain {
    links: Vec<Link>,
    /// The right-hand side, then the solution.
    pub columns: Vec<Column>,
}

/// The blocks of a matrix.
pub trait ChainBlocks {
    /// `A_ii`
    fn diagonal(&self, i: usize) -> ChainBlock;
    /// `A_ij` of neighbors.
    fn beside(&self, i: usize, j: usize) -> ChainBlock;
}

impl Chain {
    pub fn new(n: usize) -> Self {
        let link = Link {
            onward: ZERO,
            pivot: ZERO,
            back: ZERO,
        };
        Self {
            links: vec![link; n],
            columns: vec![NONE; n],
        }
    }

    /// Factors a matrix. A singular pivot leaves numbers that are not finite.
    #[inline(always)]
    pub fn factor(&mut self, blocks: &impl ChainBlocks) {
        let n = self.links.len();
        let middle = n / 2;
        // What the links so far take from the next diagonal block of either chain.
        let mut fills = [ZERO; 2];
        for t in 0..middle {
            fills[0] = self.link(blocks, t, t + 1, &fills[0]);
            let i = n - 1 - t;
            if i > middle {
                fills[1] = self.link(blocks, i, i - 1, &fills[1]);
            }
        }
        let pivot = difference(&blocks.diagonal(middle), &fills[0]);
        self.links[middle].pivot = inverse(difference(&pivot, &fills[1]));
    }

    /// Eliminates `i`, with `j` next; returns the block that is subtracted from the diagonal block of `j`.
    #[inline(always)]
    fn link(
        &mut self,
        blocks: &impl ChainBlocks,
        i: usize,
        j: usize,
        fill: &ChainBlock,
    ) -> ChainBlock {
        let pivot = inverse(difference(&blocks.diagonal(i), fill));
        let onward = blocks.beside(j, i);
        let back = product(&pivot, &blocks.beside(i, j));
        let fill = product(&onward, &back);
        self.links[i] = Link {
            onward: product(&onward, &pivot),
            pivot,
            back,
        };
        fill
    }

    /// Solves for the right-hand side in the columns, in place.
    #[inline(always)]
    pub fn solve(&mut self) {
        let n = self.links.len();
        let middle = n / 2;
        let (links, columns) = (&self.links, &mut self.columns);
        for t in 0..middle {
            subtract(columns, t + 1, &links[t].onward, t);
            let i = n - 1 - t;
            if i > middle {
                subtract(columns, i - 1, &links[i].onward, i);
            }
        }
        columns[middle] = apply(&links[middle].pivot, &columns[middle]);
        for t in (0..middle).rev() {
            columns[t] = apply(&links[t].pivot, &columns[t]);
            subtract(columns, t, &links[t].back, t + 1);
            let i = n - 1 - t;
            if i > middle {
                columns[i] = apply(&links[i].pivot, &columns[i]);
                subtract(columns, i, &links[i].back, i - 1);
            }
        }
    }
}

/// `b_to ← b_to - M b_from`
#[inline(always)]
fn subtract(columns: &mut [Column], to: usize, m: &ChainBlock, from: usize) {
    let change = apply(m, &columns[from]);
    for (sum, change) in columns[to].0.iter_mut().zip(change.0) {
        *sum -= change;
    }
}

/// `M v`
#[inline(always)]
fn apply(m: &ChainBlock, v: &Column) -> Column {
    let mut out = NONE;
    for (row, out) in out.0.iter_mut().enumerate() {
        let term = |j: usize| m[j].0[row] * v.0[j];
        *out = ((term(0) + term(1)) + (term(2) + term(3))) + (term(4) + term(5));
    }
    out
}

/// `M N`
#[inline(always)]
fn product(m: &ChainBlock, n: &ChainBlock) -> ChainBlock {
    let mut out = ZERO;
    for (out, column) in out.iter_mut().zip(n) {
        *out = apply(m, column);
    }
    out
}

#[inline(always)]
fn difference(m: &ChainBlock, n: &ChainBlock) -> ChainBlock {
    let mut out = *m;
    for (out, n) in out.iter_mut().zip(n) {
        for (out, n) in out.0.iter_mut().zip(n.0) {
            *out -= n;
        }
    }
    out
}

/// Returns the inverse by Gauss-Jordan elimination; the pivots are the diagonal entries, which is stable if inertia and stiffness make them
/// large.
#[inline(always)]
fn inverse(mut m: ChainBlock) -> ChainBlock {
    for k in 0..SIZE {
        let pivot = 1.0 / m[k].0[k];
        let column = m[k].0;
        for j in 0..SIZE {
            if j == k {
                continue;
            }
            let factor = m[j].0[k] * pivot;
            for (entry, along) in m[j].0.iter_mut().zip(&column) {
                *entry -= along * factor;
            }
            m[j].0[k] = factor;
        }
        for entry in &mut m[k].0 {
            *entry *= -pivot;
        }
        m[k].0[k] = pivot;
    }
    m
}
