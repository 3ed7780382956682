//! Kernels of coupled drifts: they read, multiply and write vectors of columns of a tile, several at a time, which share the broadcast of
//! every coefficient.

use pulp::Simd;

use super::INCREMENT_ROWS;
use super::step::LinearizedStep;
use cosserat::forms::NODE_COMPONENTS;

/// `V` vectors of columns beside each other.
pub(super) type Wide<S, const V: usize> = [<S as Simd>::f64s; V];

/// Vectors that a kernel works on at a time, where there are as many: their sums fill the registers of AVX2.
pub(super) const AT_ONCE: usize = 2;

/// Evaluates an expression for all vectors with columns, `at` the first of those at hand and `V` their number: [`AT_ONCE`] at a time and
/// the last one by itself.
macro_rules! for_all_vectors {
    ($at:expr, $used:expr, $V:ident => $call:expr) => {{
        $at = 0;
        while $at + $crate::columns::AT_ONCE <= $used {
            const $V: usize = $crate::columns::AT_ONCE;
            $call;
            $at += $V;
        }
        while $at < $used {
            const $V: usize = 1;
            $call;
            $at += $V;
        }
    }};
}
pub(super) use for_all_vectors;

/// The columns of a tile, in the vectors from `at` on.
pub(super) struct Columns<'a, S: Simd> {
    pub simd: S,
    pub step: &'a LinearizedStep,
    pub data: &'a mut [S::f64s],
    pub increments: &'a mut [S::f64s],
    pub width: usize,
    /// Vectors with columns.
    pub used: usize,
    pub at: usize,
}

impl<S: Simd> Columns<'_, S> {
    #[inline(always)]
    pub fn zero<const V: usize>(&self) -> Wide<S, V> {
        [self.simd.splat_f64s(0.0); V]
    }

    #[inline(always)]
    pub fn plus<const V: usize>(&self, a: Wide<S, V>, b: Wide<S, V>) -> Wide<S, V> {
        let mut out = a;
        for (out, b) in out.iter_mut().zip(b) {
            *out = self.simd.add_f64s(*out, b);
        }
        out
    }

    #[inline(always)]
    pub fn minus<const V: usize>(&self, a: Wide<S, V>, b: Wide<S, V>) -> Wide<S, V> {
        let mut out = a;
        for (out, b) in out.iter_mut().zip(b) {
            *out = self.simd.sub_f64s(*out, b);
        }
        out
    }

    /// `a - b`, row by row.
    #[inline(always)]
    pub fn less<const N: usize, const V: usize>(
        &self,
        a: [Wide<S, V>; N],
        b: [Wide<S, V>; N],
    ) -> [Wide<S, V>; N] {
        let mut out = a;
        for (out, b) in out.iter_mut().zip(b) {
            *out = self.minus(*out, b);
        }
        out
    }

    /// `a + b`, row by row.
    #[inline(always)]
    pub fn sum_of<const N: usize, const V: usize>(
        &self,
        a: [Wide<S, V>; N],
        b: [Wide<S, V>; N],
    ) -> [Wide<S, V>; N] {
        let mut out = a;
        for (out, b) in out.iter_mut().zip(b) {
            *out = self.plus(*out, b);
        }
        out
    }

    #[inline(always)]
    pub fn times<const V: usize>(&self, factor: f64, a: Wide<S, V>) -> Wide<S, V> {
        let factor = self.simd.splat_f64s(factor);
        let mut out = a;
        for out in &mut out {
            *out = self.simd.mul_f64s(factor, *out);
        }
        out
    }

    /// `factor a + b`
    #[inline(always)]
    pub fn fused<const V: usize>(&self, factor: f64, a: Wide<S, V>, b: Wide<S, V>) -> Wide<S, V> {
        let factor = self.simd.splat_f64s(factor);
        let mut out = b;
        for (out, a) in out.iter_mut().zip(a) {
            *out = self.simd.mul_add_e_f64s(factor, a, *out);
        }
        out
    }

    #[inline(always)]
    fn load<const V: usize>(&self, row: usize) -> Wide<S, V> {
        let vectors = &self.data[row * self.width + self.at..][..V];
        let mut out = self.zero();
        out.copy_from_slice(vectors);
        out
    }

    #[inline(always)]
    fn store<const V: usize>(&mut self, row: usize, value: Wide<S, V>) {
        self.data[row * self.width + self.at..][..V].copy_from_slice(&value);
    }

    /// `N` rows of a node, from `part` on.
    #[inline(always)]
    pub fn get<const N: usize, const V: usize>(&self, node: usize, part: usize) -> [Wide<S, V>; N] {
        let mut out = [self.zero(); N];
        for (i, out) in out.iter_mut().enumerate() {
            *out = self.load(node * NODE_COMPONENTS + part + i);
        }
        out
    }

    #[inline(always)]
    pub fn set<const N: usize, const V: usize>(
        &mut self,
        node: usize,
        part: usize,
        value: [Wide<S, V>; N],
    ) {
        for (i, value) in value.into_iter().enumerate() {
            self.store(node * NODE_COMPONENTS + part + i, value);
        }
    }

    #[inline(always)]
    pub fn add<const N: usize, const V: usize>(
        &mut self,
        node: usize,
        part: usize,
        factor: f64,
        change: [Wide<S, V>; N],
    ) {
        let mut value: [_; N] = self.get(node, part);
        for (value, change) in value.iter_mut().zip(change) {
            *value = self.fused(factor, change, *value);
        }
        self.set(node, part, value);
    }

    #[inline(always)]
    pub fn increment<const V: usize>(&self, node: usize, part: usize) -> [Wide<S, V>; 3] {
        let mut out = [self.zero(); 3];
        for (i, out) in out.iter_mut().enumerate() {
            let row = node * INCREMENT_ROWS + part + i;
            out.copy_from_slice(&self.increments[row * self.width + self.at..][..V]);
        }
        out
    }

    #[inline(always)]
    pub fn set_increment<const V: usize>(
        &mut self,
        node: usize,
        part: usize,
        value: [Wide<S, V>; 3],
    ) {
        for (i, value) in value.into_iter().enumerate() {
            let row = node * INCREMENT_ROWS + part + i;
            self.increments[row * self.width + self.at..][..V].copy_from_slice(&value);
        }
    }

    #[inline(always)]
    pub fn add_increment<const V: usize>(
        &mut self,
        node: usize,
        part: usize,
        along: &[f64; 3],
        change: Wide<S, V>,
    ) {
        let mut value = self.increment(node, part);
        for (value, along) in value.iter_mut().zip(along) {
            *value = self.fused(*along, change, *value);
        }
        self.set_increment(node, part, value);
    }

    /// `x_{q+1} - x_q`
    #[inline(always)]
    pub fn dx<const V: usize>(&self, q: usize) -> [Wide<S, V>; 3] {
        self.less(self.get(q + 1, 0), self.get(q, 0))
    }

    /// `(δx_b - δx_a, ζ_a, ζ_b)` of element `q`.
    #[inline(always)]
    pub fn element<const V: usize>(&self, q: usize) -> [Wide<S, V>; 9] {
        let (dx, a, b): (_, [_; 3], [_; 3]) = (self.dx(q), self.get(q, 3), self.get(q + 1, 3));
        [dx[0], dx[1], dx[2], a[0], a[1], a[2], b[0], b[1], b[2]]
    }

    #[inline(always)]
    pub fn dot<const N: usize, const V: usize>(
        &self,
        a: &[f64; N],
        b: [Wide<S, V>; N],
        start: Wide<S, V>,
    ) -> Wide<S, V> {
        let mut sum = start;
        for (a, b) in a.iter().zip(b) {
            sum = self.fused(*a, b, sum);
        }
        sum
    }

    #[inline(always)]
    pub fn product<const N: usize, const V: usize>(
        &self,
        m: &[[f64; N]; N],
        v: [Wide<S, V>; N],
    ) -> [Wide<S, V>; N] {
        // Closures over this many are not inlined, and the vector instructions with them.
        let mut out = [self.zero(); N];
        for (out, row) in out.iter_mut().zip(m) {
            *out = self.dot(row, v, self.zero());
        }
        out
    }

    /// `Mᵀ v`
    #[inline(always)]
    pub fn product_transposed<const N: usize, const V: usize>(
        &self,
        m: &[[f64; N]; N],
        v: [Wide<S, V>; N],
    ) -> [Wide<S, V>; N] {
        if N != 9 {
            return self.rows_transposed(m, v, 0);
        }
        // Nine sums of several vectors have no room in the registers of AVX2.
        let near: [Wide<S, V>; 5] = self.rows_transposed(m, v, 0);
        let far: [Wide<S, V>; 4] = self.rows_transposed(m, v, 5);
        let mut out = [self.zero(); N];
        for (out, own) in out.iter_mut().zip(near.into_iter().chain(far)) {
            *out = own;
        }
        out
    }

    /// `R` rows of `Mᵀ v`, from row `first` on.
    #[inline(always)]
    fn rows_transposed<const R: usize, const N: usize, const V: usize>(
        &self,
        m: &[[f64; N]; N],
        v: [Wide<S, V>; N],
        first: usize,
    ) -> [Wide<S, V>; R] {
        let mut out = [self.zero(); R];
        for (row, v) in m.iter().zip(v) {
            for (out, m) in out.iter_mut().zip(&row[first..]) {
                *out = self.fused(*m, v, *out);
            }
        }
        out
    }
}
