//! The dense algebra of a Kalman filter, in memory that is reused.
//!
//! The error has a state and disturbances that change at random. With `A` and `B` the derivatives of a motion's end along its start and
//! along the disturbances, and `Q` the covariance of unknown forces and random changes, a motion maps `P` to `F P Fᵀ + Q`, `F = [A B; 0
//! I]`. A measurement with derivatives `H`, noise `R` and innovation `e` corrects an error of mean `ξ` to `ξ + K (e - H ξ)`, `K = P Hᵀ
//! S⁻¹`, `S = H P Hᵀ + R`, and leaves Joseph's form `(I - K H) P (I - K H)ᵀ + K R Kᵀ`, which stays positive semidefinite for any rounding
//! of `K`.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{
    LltRegularization, cholesky_in_place, cholesky_in_place_scratch,
};
use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::triangular_solve::{
    solve_lower_triangular_in_place, solve_upper_triangular_in_place,
};
use faer::prelude::*;
use faer::{Accum, Mat, MatRef, Par, Spec};
use nalgebra::{Matrix3, Matrix6, Vector3};

use mechanics::forms::NODE_COMPONENTS;
use mechanics::strain_coordinates::ShapeTransport;

use super::EstimateError;
use super::node_frames::POSE;
use super::readings::Terms;

/// Rows of a measurement, three for each signal.
#[derive(Debug, Default)]
pub(super) struct Rows {
    /// Derivatives of all signals, one signal after the other.
    pub terms: Terms,
    pub signals: Vec<Row>,
}

/// Rows of one signal.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    /// End of its terms.
    pub end: usize,
    /// Measured minus expected.
    pub residual: Vector3<f64>,
    /// How many of the three numbers are there; the others are 0, and so are their derivatives.
    pub numbers: usize,
    /// Standard deviation of its noise.
    pub sigma: f64,
}

impl Rows {
    /// Returns `H` times an error, for every signal.
    pub fn times<'a>(&'a self, error: &'a [f64]) -> impl Iterator<Item = Vector3<f64>> + 'a {
        self.iter().map(|(_, terms)| {
            (terms.iter())
                .map(|(i, slope)| slope * error[*i])
                .sum::<Vector3<f64>>()
        })
    }

    pub fn clear(&mut self) {
        self.terms.clear();
        self.signals.clear();
    }

    /// Removes the signals that are marked; there is one mark for each signal, or none at all.
    pub fn retain(&mut self, refused: &[bool]) {
        if !refused.contains(&true) {
            return;
        }
        let (mut start, mut kept, mut end) = (0, 0, 0);
        for (index, refused) in refused.iter().enumerate().take(self.signals.len()) {
            let row = self.signals[index];
            if !refused {
                self.terms.copy_within(start..row.end, end);
                end += row.end - start;
                self.signals[kept] = Row { end, ..row };
                kept += 1;
            }
            start = row.end;
        }
        self.signals.truncate(kept);
        self.terms.truncate(end);
    }

    /// Returns every signal with its terms.
    fn iter(&self) -> impl Iterator<Item = (&Row, &[(usize, Vector3<f64>)])> {
        let mut start = 0;
        self.signals.iter().map(move |row| {
            let terms = &self.terms[start..row.end];
            start = row.end;
            (row, terms)
        })
    }
}

/// A covariance, and the memory for its changes.
pub(super) struct Covariance {
    /// `P`, symmetric.
    pub matrix: Mat<f64>,
    /// `P` in the tangent of another state, and the mean of the error there: the start of a correction.
    prior: Mat<f64>,
    pub mean: Vec<f64>,
    n_state: usize,
    /// Covariance that is being computed.
    next: Mat<f64>,
    /// `[A B] P`
    moved: Mat<f64>,
    /// Six columns each, for a transport.
    columns: [Mat<f64>; 2],
    /// `P Hᵀ`, and `P Hᵀ` of the covariance without its last correction.
    cross: Mat<f64>,
    /// `L⁻¹ H P`, later `Kᵀ`.
    solved: Mat<f64>,
    /// `S`, later its factor `L`.
    inner: Mat<f64>,
    scratch: MemBuffer,
    /// `L⁻¹ e`
    innovation: Mat<f64>,
    /// `ξ + K (e - H ξ)`
    pub correction: Vec<f64>,
}

impl Covariance {
    /// Creates a covariance of `n` components, the first `n_state` of which are those of the state.
    pub fn new(n: usize, n_state: usize) -> Self {
        let mut out = Self {
            matrix: Mat::zeros(n, n),
            prior: Mat::zeros(n, n),
            mean: vec![0.0; n],
            n_state,
            next: Mat::zeros(n, n),
            moved: Mat::zeros(n_state, n),
            columns: [(); 2].map(|()| Mat::zeros(n, NODE_COMPONENTS / 2)),
            cross: Mat::zeros(0, 0),
            solved: Mat::zeros(0, 0),
            inner: Mat::zeros(0, 0),
            scratch: MemBuffer::new(faer::dyn_stack::StackReq::empty()),
            innovation: Mat::zeros(0, 1),
            correction: vec![0.0; n],
        };
        out.make_room(3);
        out
    }

    /// Writes `F P Fᵀ` to the next matrix, without the noise.
    pub fn predict(&mut self, state: &Mat<f64>, input: &Mat<f64>) {
        let (n, n_state) = (self.matrix.nrows(), self.n_state);
        let n_input = n - n_state;
        let p = self.matrix.as_ref();
        let moved = &mut self.moved;
        matmul(
            moved.as_mut(),
            Accum::Replace,
            state,
            p.subrows(0, n_state),
            1.0,
            Par::Seq,
        );
        if n_input > 0 {
            matmul(
                moved.as_mut(),
                Accum::Add,
                input,
                p.subrows(n_state, n_input),
                1.0,
                Par::Seq,
            );
        }
        let mut next = self.next.as_mut();
        let own = next.rb_mut().submatrix_mut(0, 0, n_state, n_state);
        lower_product(
            own,
            Accum::Replace,
            moved.as_ref().subcols(0, n_state),
            state.transpose(),
            1.0,
        );
        if n_input > 0 {
            let own = next.rb_mut().submatrix_mut(0, 0, n_state, n_state);
            let with_input = moved.as_ref().subcols(n_state, n_input);
            lower_product(own, Accum::Add, with_input, input.transpose(), 1.0);
            (next.rb_mut().submatrix_mut(n_state, 0, n_input, n_state))
                .copy_from(with_input.transpose());
            (next
                .rb_mut()
                .submatrix_mut(n_state, n_state, n_input, n_input))
            .copy_from(p.submatrix(n_state, n_state, n_input, n_input));
        }
        mirror(&mut self.next);
    }

    /// Adds to the next matrix the covariance that an unknown of the present one makes along a direction of the state, which is scaled by its standard
    /// deviation; their correlation is left out.
    pub fn consider(&mut self, unknown: usize, direction: &mut [f64]) {
        let deviation = self.matrix[(unknown, unknown)].max(0.0).sqrt();
        direction.iter_mut().for_each(|own| *own *= deviation);
        for (j, own) in direction.iter().enumerate() {
            let column = self.next.col_as_slice_mut(j);
            for (sum, value) in column.iter_mut().zip(direction.iter()) {
                *sum += own * value;
            }
        }
    }

    /// Returns the matrix after a motion, to which noise is added.
    pub fn next_mut(&mut self) -> &mut Mat<f64> {
        &mut self.next
    }

    /// Starts a correction from the present matrix and a zero mean error.
    pub fn begin_correction(&mut self) {
        self.prior.copy_from(&self.matrix);
        self.mean.fill(0.0);
    }

    /// Returns `eᵀ S⁻¹ e` of every signal by itself, with the covariance from which a correction starts; infinite if `S` has no inverse.
    pub fn squares<'a>(&'a self, rows: &'a Rows) -> impl Iterator<Item = f64> + 'a {
        rows.iter().map(|(row, terms)| {
            let mut inner = Matrix3::from_diagonal_element(row.sigma * row.sigma);
            for (i, left) in terms {
                for (j, right) in terms {
                    inner += left * right.transpose() * self.prior[(*i, *j)];
                }
            }
            let factor = inner.cholesky();
            factor.map_or(f64::INFINITY, |factor| {
                row.residual.dot(&factor.solve(&row.residual))
            })
        })
    }

    /// Changes a component of the correction, and the others by their regression on it in the corrected covariance.
    pub fn shift(&mut self, at: usize, change: f64) {
        let own = self.next[(at, at)];
        if change == 0.0 {
            return;
        }
        for (i, value) in self.correction.iter_mut().enumerate() {
            if i == at {
                *value += change;
            } else if own > 0.0 {
                *value += self.next[(i, at)] / own * change;
            }
        }
    }

    /// Starts a correction from the present matrix, carried to another shape if there is a transport, and from the mean that is written to
    /// [`mean`](Self::mean). The components of the state are those of the nodes from `first` on.
    pub fn move_prior(&mut self, transport: Option<&ShapeTransport>, first: usize) {
        self.prior.copy_from(&self.matrix);
        if let Some(transport) = transport {
            congruence(&mut self.prior, &mut self.columns, transport, first);
        }
    }

    /// Writes the corrected covariance to the next matrix, and the corrected error to [`correction`](Self::correction); returns the square
    /// of the innovation, `eᵀ S⁻¹ e` with `e - H ξ` in the place of `e`.
    ///
    /// # Errors
    /// Returns [`EstimateError::Singular`] if `S` has no factor.
    pub fn correct(&mut self, rows: &Rows) -> Result<f64, EstimateError> {
        let n = self.matrix.nrows();
        let m = 3 * rows.signals.len();
        self.make_room(m);
        times_rows(&self.prior, rows, &mut self.cross);
        let mut inner = self.inner.as_mut().submatrix_mut(0, 0, m, m);
        for column in 0..m {
            let cross = self.cross.col_as_slice(column);
            for (signal, (row, terms)) in rows.iter().enumerate() {
                let mut sum = Vector3::zeros();
                for (i, slope) in terms {
                    sum += slope * cross[*i];
                }
                if column / 3 == signal {
                    sum[column % 3] += row.sigma * row.sigma;
                }
                for axis in 0..3 {
                    inner[(3 * signal + axis, column)] = sum[axis];
                }
            }
        }
        cholesky_in_place(
            inner.rb_mut(),
            LltRegularization::default(),
            Par::Seq,
            MemStack::new(&mut self.scratch),
            Spec::default(),
        )
        .map_err(|_| EstimateError::Singular)?;
        let factor = self.inner.as_ref().submatrix(0, 0, m, m);
        let mut solved = self.solved.as_mut().subrows_mut(0, m);
        solved.copy_from(self.cross.as_ref().subcols(0, m).transpose());
        solve_lower_triangular_in_place(factor, solved.rb_mut(), Par::Seq);
        let mut innovation = self.innovation.as_mut().subrows_mut(0, m);
        let expected = rows.times(&self.mean);
        for (signal, (row, expected)) in rows.signals.iter().zip(expected).enumerate() {
            for axis in 0..3 {
                innovation[(3 * signal + axis, 0)] = row.residual[axis] - expected[axis];
            }
        }
        solve_lower_triangular_in_place(factor, innovation.rb_mut(), Par::Seq);
        let mut normalized = 0.0;
        self.correction.copy_from_slice(&self.mean);
        for i in 0..m {
            normalized += innovation[(i, 0)] * innovation[(i, 0)];
        }
        for (j, correction) in self.correction.iter_mut().enumerate() {
            *correction += (0..m)
                .map(|i| solved[(i, j)] * innovation[(i, 0)])
                .sum::<f64>();
        }
        // Joseph's last term is rounding here and left out.
        self.next.copy_from(&self.prior);
        lower_product(
            self.next.as_mut(),
            Accum::Add,
            solved.rb().transpose(),
            solved.rb(),
            -1.0,
        );
        mirror(&mut self.next);
        solve_upper_triangular_in_place(factor.transpose(), solved.rb_mut(), Par::Seq);
        times_rows(&self.next, rows, &mut self.cross);
        for (signal, row) in rows.signals.iter().enumerate() {
            for i in 3 * signal..3 * signal + 3 {
                let column = self.cross.col_as_slice_mut(i);
                for (j, value) in column[..n].iter_mut().enumerate() {
                    *value -= row.sigma * row.sigma * solved[(i, j)];
                }
            }
        }
        matmul(
            self.next.as_mut(),
            Accum::Add,
            self.cross.as_ref().subcols(0, m),
            solved.rb(),
            -1.0,
            Par::Seq,
        );
        make_symmetric(&mut self.next);
        let sound = (0..n).all(|i| self.next[(i, i)] >= 0.0 && self.correction[i].is_finite());
        if sound {
            Ok(normalized)
        } else {
            Err(EstimateError::Singular)
        }
    }

    /// Carries the next matrix to another shape.
    pub fn transport(&mut self, transport: &ShapeTransport, first: usize) {
        congruence(&mut self.next, &mut self.columns, transport, first);
    }

    /// Makes the next matrix the present one.
    pub fn commit(&mut self) {
        std::mem::swap(&mut self.matrix, &mut self.next);
    }

    /// Allocates memory for at least `m` rows.
    fn make_room(&mut self, m: usize) {
        if m <= self.inner.nrows() {
            return;
        }
        let n = self.matrix.nrows();
        self.cross = Mat::zeros(n, m);
        self.solved = Mat::zeros(m, n);
        self.inner = Mat::zeros(m, m);
        self.innovation = Mat::zeros(m, 1);
        let need = cholesky_in_place_scratch::<f64>(m, Par::Seq, Spec::default());
        self.scratch = MemBuffer::new(need);
    }
}

/// Writes `P Hᵀ` to the first columns of `out`.
fn times_rows(p: &Mat<f64>, rows: &Rows, out: &mut Mat<f64>) {
    for (signal, (_, terms)) in rows.iter().enumerate() {
        for axis in 0..3 {
            let out = out.col_as_slice_mut(3 * signal + axis);
            out.fill(0.0);
            for (j, slope) in terms {
                let slope = slope[axis];
                if slope != 0.0 {
                    for (out, p) in out.iter_mut().zip(p.col_as_slice(*j)) {
                        *out += slope * p;
                    }
                }
            }
        }
    }
}

/// Computes the lower half of a symmetric product.
fn lower_product(
    out: faer::MatMut<f64>,
    accum: Accum,
    left: faer::MatRef<f64>,
    right: faer::MatRef<f64>,
    factor: f64,
) {
    triangular::matmul(
        out,
        BlockStructure::TriangularLower,
        accum,
        left,
        BlockStructure::Rectangular,
        right,
        BlockStructure::Rectangular,
        factor,
        Par::Seq,
    );
}

/// Replaces `P` by `J P Jᵀ`, with `J` the transport of the poses of the nodes from `first` on.
fn congruence(
    matrix: &mut Mat<f64>,
    columns: &mut [Mat<f64>; 2],
    transport: &ShapeTransport,
    first: usize,
) {
    for _ in 0..2 {
        times_transposed(matrix, columns, transport, first);
        for j in 0..matrix.ncols() {
            for i in 0..j {
                let value = matrix[(i, j)];
                matrix[(i, j)] = matrix[(j, i)];
                matrix[(j, i)] = value;
            }
        }
    }
    make_symmetric(matrix);
}

/// Replaces `P` by `P Jᵀ`, six columns at a time.
fn times_transposed(
    matrix: &mut Mat<f64>,
    [before, made]: &mut [Mat<f64>; 2],
    transport: &ShapeTransport,
    first: usize,
) {
    let add = |made: &mut Mat<f64>, own: MatRef<f64>, map: &Matrix6<f64>, accum: Accum| {
        let map = MatRef::from_column_major_slice(map.as_slice(), POSE, POSE);
        matmul(made.as_mut(), accum, own, map.transpose(), 1.0, Par::Seq);
    };
    for node in first..=transport.links.len() {
        let at = NODE_COMPONENTS * (node - first);
        let own = matrix.as_ref().subcols(at, POSE);
        match node.checked_sub(1).map(|element| &transport.links[element]) {
            None => add(made, own, &transport.base, Accum::Replace),
            Some([near, far, moved]) => {
                add(made, own, far, Accum::Replace);
                if node > first {
                    let near_end = matrix.as_ref().subcols(at - NODE_COMPONENTS, POSE);
                    add(made, before.as_ref(), near, Accum::Add);
                    add(made, near_end, moved, Accum::Add);
                }
            }
        }
        before.copy_from(own);
        matrix.as_mut().subcols_mut(at, POSE).copy_from(&*made);
    }
}

/// Removes the asymmetry of rounding.
fn make_symmetric(matrix: &mut Mat<f64>) {
    for j in 0..matrix.ncols() {
        for i in 0..j {
            let mean = 0.5 * (matrix[(i, j)] + matrix[(j, i)]);
            matrix[(i, j)] = mean;
            matrix[(j, i)] = mean;
        }
    }
}

/// Copies the lower half to the upper one.
fn mirror(matrix: &mut Mat<f64>) {
    for j in 0..matrix.ncols() {
        for i in 0..j {
            matrix[(i, j)] = matrix[(j, i)];
        }
    }
}
