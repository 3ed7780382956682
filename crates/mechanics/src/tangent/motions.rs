//! The growth of small motions.

use faer::Mat;
use nalgebra::{Complex, DMatrix, Matrix6, Schur, Vector3, Vector6};

use super::{ASYMMETRIC, Tangent, dot};
use crate::vibration::inertia_roots;
use cosserat::block_tridiagonal::BlockTridiagonal;
use cosserat::configuration::Configuration;
use cosserat::element::IntervalStress;
use cosserat::rod::Rod;

/// Number of unknowns of small motions up to which all of them are computed, by a dense eigenvalue problem: a second for 100 elements with
/// viscous damping alone, or 50 with internal damping.
const ALL_MOTIONS: usize = 600;
/// Dimension of the Krylov space in which the slowest motions are found where there are more unknowns: about a hundred frequencies.
const KRYLOV: usize = 400;
/// Dimension of the smaller space whose eigenvalues tell which of the larger one have converged, and the relative change up to which they
/// have: an error of a motion of 1000 times the first frequency is then 1e-5 of that frequency, below
/// [`SLOWEST_GROWTH`](super::SLOWEST_GROWTH).
const SMALLER_KRYLOV: usize = 360;
const CONVERGED: f64 = 1e-8;
/// Number of modes by which a search follows the growth of motions without a potential.
const GROWTH_MODES: usize = 12;
/// Steps of inverse iteration that improve them: the error of the slowest motions is then the cube of the ratio of their `ω²` to that of
/// the fastest one.
const INVERSE_ITERATIONS: usize = 3;
/// Cap on the steps of the QR iteration for each eigenvalue.
const QR_STEPS: usize = 100;

impl Tangent {
    /// Returns the largest real part of the `s` of the [slowest motions](Self::slowest_motions), 1/s: positive if small deviations grow.
    /// Fast motions, which may grow under moments, are left out: a guide of a search, not a result.
    pub fn slow_growth_rate(&self, rod: &Rod, at: &Configuration, unit: f64) -> Option<f64> {
        let motions = self.slowest_motions(rod, at, unit)?;
        let largest = motions
            .iter()
            .map(|s| s.re)
            .fold(f64::NEG_INFINITY, f64::max);
        Some(largest)
    }

    /// Returns deviations that span the slowest [`GROWTH_MODES`] motions without damping, orthonormal with respect to `M`: the lowest modes
    /// of the symmetric part, improved by inverse iteration with the whole matrix. Those modes alone miss the boundary conditions of a
    /// force that turns with the tip, and put Beck's load 7 % too low.
    fn growth_basis(
        &self,
        rod: &Rod,
        at: &Configuration,
        unit: f64,
    ) -> Option<Vec<Vec<Vector6<f64>>>> {
        let modes = self.lowest_modes(rod, at, unit, GROWTH_MODES)?;
        let mut basis: Vec<_> = modes.into_iter().map(|mode| mode.shape).collect();
        if self.asymmetry() <= ASYMMETRIC {
            return Some(basis);
        }
        let roots = inertia_roots(rod, at);
        let mut shifted = self.clone();
        for (q, root) in roots.iter().enumerate() {
            let inertia = root.map(|root| unit / (root * root));
            shifted.add(q, q, &Matrix6::from_diagonal(&inertia));
        }
        let factor = shifted.factor()?;
        let n = basis.len();
        for _ in 0..INVERSE_ITERATIONS {
            let right: Vec<Vec<Vector6<f64>>> = (basis.iter())
                .map(|q| {
                    (q.iter().zip(&roots))
                        .map(|(q, root)| q.component_div(&root.component_mul(root)))
                        .collect()
                })
                .collect();
            let answer = factor.solve(&right);
            let scaled = DMatrix::from_fn(6 * self.n_blocks, n, |i, j| {
                answer[j][i / 6][i % 6] / roots[i / 6][i % 6]
            });
            let scaled = scaled.qr().q();
            basis = (0..n)
                .map(|j| {
                    (roots.iter().enumerate())
                        .map(|(q, root)| Vector6::from_fn(|i, _| scaled[(6 * q + i, j)] * root[i]))
                        .collect()
                })
                .collect();
        }
        Some(basis)
    }

    /// Returns the `s` of motions `exp(s t)`, 1/s, in the space of [`Self::growth_basis`] (Galerkin), with viscous and Kelvin-Voigt
    /// damping.
    pub(super) fn slowest_motions(
        &self,
        rod: &Rod,
        at: &Configuration,
        unit: f64,
    ) -> Option<Vec<Complex<f64>>> {
        let modes = self.growth_basis(rod, at, unit)?;
        let n = modes.len();
        let damping = Self::of(strain_stiffness(rod, at));
        let project = |matrix: &Self| {
            let moved: Vec<_> = modes.iter().map(|mode| matrix.times(mode)).collect();
            DMatrix::from_fn(n, n, |i, j| dot(&modes[i], &moved[j]))
        };
        let (stiffness, strain) = (project(self), project(&damping));
        let mut first_order = DMatrix::zeros(2 * n, 2 * n);
        for i in 0..n {
            first_order[(i, n + i)] = 1.0;
            first_order[(n + i, n + i)] = -rod.viscous_damping;
            for j in 0..n {
                first_order[(n + i, j)] = -stiffness[(i, j)];
                first_order[(n + i, n + j)] -= rod.internal_damping * strain[(i, j)];
            }
        }
        // In this unit of time both halves are of about the same size.
        let time = unit.sqrt().recip();
        for i in 0..n {
            for j in 0..n {
                first_order[(n + i, j)] *= time * time;
                first_order[(n + i, n + j)] *= time;
            }
        }
        let schur = Schur::try_new(first_order, f64::EPSILON, QR_STEPS * n)?;
        let values = schur.complex_eigenvalues();
        Some(values.iter().map(|value| value / time).collect())
    }

    /// Returns the `s` of all motions `exp(s t)`, 1/s, with viscous and Kelvin-Voigt damping, which solve `(s² M + s C + K) q = 0`.
    ///
    /// A moment on a node that turns with it couples modes of two bending planes. It feeds modes of frequency `ω` at a rate of about its
    /// coupling divided by `2 ω`, which hardly depends on `ω`, for slopes of bending modes grow like their `ω`: whether a mode grows is
    /// decided by how near the frequencies of the two planes are, and any mode of the grid may be the one. Beyond [`ALL_MOTIONS`] unknowns,
    /// the slowest ones that converge in a Krylov space are returned.
    pub(super) fn small_motions(
        &self,
        rod: &Rod,
        at: &Configuration,
        unit: f64,
    ) -> Option<Vec<Complex<f64>>> {
        let roots = inertia_roots(rod, at);
        // In this unit of time the first frequency is one.
        let time = unit.sqrt().recip();
        let viscous = rod.viscous_damping * time;
        let stiffness = self.scaled(&roots, time * time);
        let internal = (rod.internal_damping > 0.0).then(|| {
            let factor = rod.internal_damping * time;
            Self::of(strain_stiffness(rod, at)).scaled(&roots, factor)
        });
        let motions = motions_of(&stiffness, viscous, internal)?;
        Some(motions.into_iter().map(|s| s / time).collect())
    }
}

/// Returns the `s` of all motions with `(s² + s (c + C) + K) q = 0`: `K` the stiffness and `C` the internal damping, divided by the roots of
/// the inertia on both sides, and `c` the viscous damping, in a unit of time in which the first frequency is about one. Beyond a cap, the
/// slowest ones that converge. `None` if a value is not finite.
pub fn motions_of(
    stiffness: &Tangent,
    viscous: f64,
    internal: Option<Tangent>,
) -> Option<Vec<Complex<f64>>> {
    let is_finite = |matrix: &Tangent| {
        let mut entries = matrix.blocks.values().flat_map(|block| block.iter());
        let mut products = matrix.products.iter().flat_map(|(_, vector)| vector);
        entries.all(|entry| entry.is_finite())
            && products.all(|part| part.iter().all(|entry| entry.is_finite()))
    };
    if !(is_finite(stiffness) && internal.as_ref().is_none_or(is_finite) && viscous.is_finite()) {
        return None;
    }
    let n = stiffness.n_unknowns();
    if internal.is_none() && n <= ALL_MOTIONS {
        // Every eigenvalue `μ` of `K` has the pair `s² + c s + μ = 0`.
        let squares = stiffness.dense().eigenvalues().ok()?;
        let pairs = squares.iter().flat_map(|square| {
            let half = 0.5 * viscous;
            let root = (Complex::from(half * half) - Complex::new(square.re, square.im)).sqrt();
            [root - half, -root - half]
        });
        return Some(pairs.collect());
    }
    let mut damping = internal.unwrap_or_else(|| Tangent::zeros(stiffness.n_blocks));
    for i in 0..stiffness.n_blocks {
        damping.add(i, i, &Matrix6::from_diagonal_element(viscous));
    }
    if 2 * n > ALL_MOTIONS {
        return slowest_of(stiffness, &damping);
    }
    let (k, c) = (stiffness.dense(), damping.dense());
    let first_order = Mat::from_fn(2 * n, 2 * n, |i, j| match (i < n, j < n) {
        (true, true) => 0.0,
        (true, false) => f64::from(u8::from(i + n == j)),
        (false, true) => -k[(i - n, j)],
        (false, false) => -c[(i - n, j - n)],
    });
    let motions = first_order.eigenvalues().ok()?;
    Some(motions.iter().map(|s| Complex::new(s.re, s.im)).collect())
}

/// Returns the slowest `s` of `(s² + s C + K) q = 0` that converge in the Krylov space of `(A - s₀)⁻¹`, the inverse of the first-order
/// system `(q, v)' = A (q, v)` with a shift `s₀ = 1` (Arnoldi's method; Saad 2011, chapter 6).
fn slowest_of(stiffness: &Tangent, damping: &Tangent) -> Option<Vec<Complex<f64>>> {
    const SHIFT: f64 = 1.0;
    let n = stiffness.n_blocks;
    let mut shifted = stiffness.clone();
    let mut moving = damping.clone();
    for (&(row, column), block) in &damping.blocks {
        shifted.add(row, column, &(block * SHIFT));
    }
    for i in 0..n {
        shifted.add(i, i, &Matrix6::from_diagonal_element(SHIFT * SHIFT));
        moving.add(i, i, &Matrix6::from_diagonal_element(SHIFT));
    }
    let factor = shifted.factor()?;
    let apply = |y: &[Vector6<f64>]| {
        let (q, v) = y.split_at(n);
        let right: Vec<_> = (moving.times(q).iter().zip(v))
            .map(|(moved, v)| -(moved + v))
            .collect();
        let mut out = factor.solve(&[right]).swap_remove(0);
        let speeds: Vec<_> = (q.iter().zip(&out))
            .map(|(q, step)| q + step * SHIFT)
            .collect();
        out.extend(speeds);
        out
    };
    let m = KRYLOV.min(12 * n - 1);
    // Any direction: no motion of an arm is orthogonal to it.
    let mut first: Vec<_> = (0..2 * n)
        .map(|q| Vector6::from_fn(|i, _| (1.0 + 1.37 * (6 * q + i) as f64).sin()))
        .collect();
    let norm = dot(&first, &first).sqrt();
    first.iter_mut().for_each(|part| *part /= norm);
    let mut basis = vec![first];
    let mut small = Mat::<f64>::zeros(m, m);
    for j in 0..m {
        let mut next = apply(&basis[j]);
        // Twice is enough (Parlett 1998, section 6.9).
        for _ in 0..2 {
            for (i, earlier) in basis.iter().enumerate() {
                let along = dot(earlier, &next);
                small[(i, j)] += along;
                for (part, earlier) in next.iter_mut().zip(earlier) {
                    *part -= earlier * along;
                }
            }
        }
        let norm = dot(&next, &next).sqrt();
        if !(norm > 0.0 && norm.is_finite()) {
            return None;
        }
        if j + 1 < m {
            small[(j + 1, j)] = norm;
            next.iter_mut().for_each(|part| *part /= norm);
            basis.push(next);
        }
    }
    let values = |size: usize| small.get(..size, ..size).eigenvalues().ok();
    let (all, fewer) = (values(m)?, values(SMALLER_KRYLOV.min(m))?);
    let has_converged = |theta: &&faer::c64| {
        let change = fewer.iter().map(|other| (**theta - other).norm());
        change.fold(f64::INFINITY, f64::min) < CONVERGED * theta.norm()
    };
    let motions = all.iter().filter(has_converged);
    Some(
        motions
            .map(|theta| Complex::new(theta.re, theta.im).inv() + SHIFT)
            .collect(),
    )
}

/// Returns the stiffness of the elements along their strains alone, without their stress.
fn strain_stiffness(rod: &Rod, at: &Configuration) -> BlockTridiagonal {
    let first = rod.first_free_node();
    let mut out = BlockTridiagonal::zeros(rod.n_nodes() - first);
    let nothing = IntervalStress {
        linear: [Vector3::zeros(); 2],
        angular: Vector3::zeros(),
    };
    for (q, element) in rod.elements.iter().enumerate() {
        let pose = Rod::element_pose(q, &at.positions, &at.rotations);
        out.add_element(
            first,
            q,
            &element.stiffness_under(rod.strain_rule, &pose, &nothing, 1.0),
        );
    }
    out
}
