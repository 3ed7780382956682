//! The tangent stiffness of an arm with everything that acts on it, as a sparse matrix: its inverse, its lowest modes, and the growth of
//! small motions.
//!
//! Deviations `q = (δx, η)` of the free nodes obey `M q̈ + C q̇ + K q = 0`. `K` couples neighbors by the elements, and any nodes by
//! actuators that depend on them; body moments make it unsymmetric. `C` is viscous damping `c M` and Kelvin-Voigt damping, `τ` times the
//! elements' stiffness without stress.

mod factors;
mod motions;

use std::collections::BTreeMap;

use faer::Mat;
use faer::linalg::solvers::Solve as _;
use nalgebra::{DMatrix, Matrix3, Matrix6, Vector6};

pub use self::factors::TangentLu;
use self::factors::positive;
pub use self::motions::motions_of;
use super::vibration::inertia_roots;
use cosserat::block_tridiagonal::BlockTridiagonal;
use cosserat::configuration::Configuration;
use cosserat::rod::Rod;
use cosserat::stiffness::{Product, friction_stiffness, tangent_stiffness, winch_stiffness};

/// A square matrix of 6×6 blocks over the free nodes, the first of them in block 0, and products `f v vᵀ` of winches.
///
/// The tension of a winch couples all nodes that its tendon passes. As products these couplings cost as much as the nodes, as blocks the
/// square of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Tangent {
    n_blocks: usize,
    blocks: BTreeMap<(usize, usize), Matrix6<f64>>,
    /// `f > 0` and `v` of every winch with tension.
    products: Vec<(f64, Vec<Vector6<f64>>)>,
}

/// A mode of `K_s q = ω² M q`, `K_s` the symmetric part of `K`, with `qᵀ M q = 1`.
#[derive(Clone, Debug)]
pub struct Mode {
    /// `ω²`, 1/s²; negative for a deviation that grows.
    pub squared_frequency: f64,
    /// `(δx, η)` of every free node.
    pub shape: Vec<Vector6<f64>>,
}

/// Stability of an equilibrium under constant loads and controls.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stability {
    /// Tells whether small deviations stay small: nothing grows, and for loads with a potential the smallest `ω²` is above rounding.
    pub is_stable: bool,
    /// Tells whether the tangent stiffness is symmetric, so that all loads have a potential.
    pub has_potential: bool,
    /// Tells whether the symmetric part of the stiffness is positive definite beyond rounding.
    pub is_definite: bool,
    /// Smallest `ω²`, 1/s², of the symmetric part of the tangent stiffness and the inertia.
    pub least_squared_frequency: f64,
    /// Rate `s` at which small deviations grow as `exp(s t)`, 1/s, with damping; `None` if they do not grow.
    pub growth_rate: Option<f64>,
    /// Angular frequency of growing deviations, rad/s: zero for an arm that topples or buckles, positive for one that flutters; `None` if
    /// nothing grows.
    pub growth_frequency: Option<f64>,
    /// Lowest angular frequency of a stable equilibrium, rad/s: without damping if the loads have a potential, otherwise with it.
    pub first_frequency: Option<f64>,
}

/// Motions whose growth decides about the stability under loads without a potential.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motions {
    /// All of the grid: a result. A dense eigenvalue problem.
    All,
    /// The slowest ones: a guide along a path.
    Slowest,
    /// None: without a potential the stability remains unknown.
    None,
}

impl Stability {
    /// Computes the stability of an equilibrium of a rod under its loads at time `t`; `None` if a value is not finite.
    #[must_use]
    pub fn of(rod: &Rod, at: &Configuration, t: f64) -> Option<Self> {
        let unit = own_squared_frequency(rod);
        Tangent::stiffness(rod, at, t).stability(rod, at, unit, Motions::All)
    }
}

/// Growth rate, divided by the frequency of the arm at rest, up to which an equilibrium counts as stable: growth by a factor e in 1600 of
/// its periods. Without damping, all `s` are imaginary but for rounding: that of `M^{-½} K M^{-½}`, 1e-16 of its largest `ω²`, is up to
/// 1e-7 of the first `ω²` for slender arms, and its square root where two of them meet.
pub const SLOWEST_GROWTH: f64 = 1e-4;
/// `ω²`, relative to that of the arm at rest, above which an equilibrium is certainly stable: shapes that may turn about the base's axis
/// have 0 up to an error of discretization.
pub(crate) const POSITIVE: f64 = 1e-6;
/// Imaginary part of an `s`, relative to its size, above which a motion swings: two equal real `s` are off by about the square root of the
/// rounding of the matrix, in either direction, which is 1e-5 of the largest one at most.
const LEAST_SWING: f64 = 1e-4;
/// Unsymmetric part of the stiffness, relative to its largest entry, above which loads have no potential.
const ASYMMETRIC: f64 = 1e-9;

/// Returns `ω²` of the slowest mode of an arm in its stress-free shape, without loads, 1/s²: the unit of the thresholds of
/// [`Tangent::stability`].
pub fn own_squared_frequency(rod: &Rod) -> f64 {
    let guess = rod.scales.time.powi(-2);
    let bare = Rod {
        loads: Vec::new(),
        ..rod.clone()
    };
    let loose = loose_motions_of_held(rod);
    let tangent = Tangent::stiffness(&bare, &rod.rest, 0.0);
    let least = match loose {
        0 => 0.0,
        _ => (POSITIVE * guess).max(tangent.rounding(rod, &rod.rest)),
    };
    tangent
        .lowest_modes(rod, &rod.rest, guess, 1 + loose)
        .and_then(|modes| {
            let squares = modes.iter().map(|mode| mode.squared_frequency);
            squares.take(1 + loose).find(|square| *square > least)
        })
        .unwrap_or(guess)
}

/// Returns the largest number of motions that the ends of a held rod leave without stiffness.
fn loose_motions_of_held(rod: &Rod) -> usize {
    if rod.is_held() {
        rod.most_loose_motions()
    } else {
        0
    }
}

/// Number of additional modes that are computed, so that subspace iteration converges fast.
const GUARD_MODES: usize = 4;
/// Change of an `ω²`, relative to itself and the shift, at which subspace iteration ends, and cap on its iterations.
const MODE_TOLERANCE: f64 = 1e-11;
const MODE_ITERATIONS: usize = 100;

impl Tangent {
    /// Returns the matrix with the given blocks.
    pub fn of(blocks: BlockTridiagonal) -> Self {
        let mut out = Self {
            n_blocks: blocks.diagonal.len(),
            blocks: BTreeMap::new(),
            products: Vec::new(),
        };
        out.add_blocks(blocks);
        out
    }

    /// Adds a block-tridiagonal matrix.
    pub fn add_blocks(&mut self, blocks: BlockTridiagonal) {
        for (i, block) in blocks.diagonal.iter().enumerate() {
            self.add(i, i, block);
        }
        for (i, (below, above)) in blocks.below.iter().zip(&blocks.above).enumerate() {
            self.add(i + 1, i, below);
            self.add(i, i + 1, above);
        }
    }

    /// Returns the stiffness of the elements and of the rod's own loads at time `t`.
    pub fn stiffness(rod: &Rod, at: &Configuration, t: f64) -> Self {
        let mut out = Self::of(tangent_stiffness(rod, at, t));
        out.add_efforts(rod, at, t);
        out
    }

    /// Adds the change of efforts with the configuration, which couples all nodes that a tendon pulls: of winches as products, and with
    /// friction along the path as blocks.
    pub fn add_efforts(&mut self, rod: &Rod, at: &Configuration, t: f64) {
        let taut = winch_stiffness(rod, at, t).into_iter();
        self.products
            .extend(taut.filter(|(factor, _)| *factor > 0.0));
        for Product { left, right } in &friction_stiffness(rod, at, t) {
            let pulled = left.iter().enumerate();
            for (row, left) in pulled.filter(|(_, own)| **own != Vector6::zeros()) {
                for (column, right) in right.iter().enumerate() {
                    self.add(row, column, &(left * right.transpose()));
                }
            }
        }
    }

    /// Returns the same matrix with the products of winches as blocks.
    pub fn in_blocks(&self) -> Self {
        let mut out = Self {
            products: Vec::new(),
            ..self.clone()
        };
        for (factor, vector) in &self.products {
            for (row, left) in vector.iter().enumerate() {
                for (column, right) in vector.iter().enumerate() {
                    out.add(row, column, &(left * right.transpose() * *factor));
                }
            }
        }
        out
    }

    /// Returns the number of rows and columns.
    pub fn n_unknowns(&self) -> usize {
        6 * self.n_blocks
    }

    /// Returns the symmetric part.
    pub fn symmetric(&self) -> Self {
        let mut blocks = BTreeMap::new();
        for (&(row, column), block) in &self.blocks {
            *blocks.entry((row, column)).or_insert_with(Matrix6::zeros) += 0.5 * block;
            *blocks.entry((column, row)).or_insert_with(Matrix6::zeros) += 0.5 * block.transpose();
        }
        Self {
            blocks,
            n_blocks: self.n_blocks,
            products: self.products.clone(),
        }
    }

    /// Returns the transposed matrix.
    pub fn transposed(&self) -> Self {
        let blocks = self.blocks.iter();
        Self {
            blocks: blocks
                .map(|(&(row, column), block)| ((column, row), block.transpose()))
                .collect(),
            n_blocks: self.n_blocks,
            products: self.products.clone(),
        }
    }

    /// Returns `K + σ M`, `σ` in 1/s².
    pub fn with_inertia(mut self, rod: &Rod, at: &Configuration, sigma: f64) -> Self {
        for (i, root) in inertia_roots(rod, at).iter().enumerate() {
            let inertia = root.map(|r| sigma / (r * r));
            self.add(i, i, &Matrix6::from_diagonal(&inertia));
        }
        self
    }

    /// Adds a block.
    pub fn add(&mut self, row: usize, column: usize, block: &Matrix6<f64>) {
        *self.blocks.entry((row, column)).or_default() += block;
    }

    /// Computes the lowest `count` modes, ascending, with the inertia of the rod; `unit` (1/s²) is about the smallest `ω²` of a stable arm.
    /// `None` if a value is not finite.
    ///
    /// The method is subspace iteration with the inverse of `M^{-½} K_s M^{-½} + s`, where the shift `s` makes it positive definite (Bathe
    /// 2014, section 11.6).
    pub fn lowest_modes(
        &self,
        rod: &Rod,
        at: &Configuration,
        unit: f64,
        count: usize,
    ) -> Option<Vec<Mode>> {
        let roots = inertia_roots(rod, at);
        let mut scaled = self.symmetric().blocks;
        for (&(row, column), block) in &mut scaled {
            block.component_mul_assign(&(roots[row] * roots[column].transpose()));
        }
        let (shift, factor) = positive(self.n_blocks, &scaled, unit)?;
        let n = 6 * self.n_blocks;
        // The products V F Vᵀ of winches, as in `factor`.
        let m = self.products.len();
        let added = DMatrix::from_fn(n, m, |i, j| {
            self.products[j].1[i / 6][i % 6] * roots[i / 6][i % 6]
        });
        let answers = factor.solve(&Mat::from_fn(n, m, |i, j| added[(i, j)]));
        let answers = DMatrix::from_fn(n, m, |i, j| answers[(i, j)]);
        let mut small = added.tr_mul(&answers);
        for (j, (own, _)) in self.products.iter().enumerate() {
            small[(j, j)] += own.recip();
        }
        let inner = small.try_inverse()?;
        let size = (count + GUARD_MODES).min(n);
        let mut basis = DMatrix::from_fn(n, size, |i, j| {
            (1.0 + i as f64 * (1.0 + 0.37 * j as f64)).sin()
        });
        let mut values = vec![f64::INFINITY; size];
        for _ in 0..MODE_ITERATIONS {
            basis = basis.qr().q();
            let answer = factor.solve(&Mat::from_fn(n, size, |i, j| basis[(i, j)]));
            let mut answer = DMatrix::from_fn(n, size, |i, j| answer[(i, j)]);
            if m > 0 {
                answer -= &answers * (&inner * added.tr_mul(&answer));
            }
            let small = basis.tr_mul(&answer);
            let eigen = (0.5 * (&small + small.transpose())).symmetric_eigen();
            let mut order: Vec<usize> = (0..size).collect();
            order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
            let found: Vec<f64> = (order.iter())
                .map(|&i| eigen.eigenvalues[i].recip() - shift)
                .collect();
            if !found.iter().take(count).all(|value| value.is_finite()) {
                return None;
            }
            let turn = DMatrix::from_fn(size, size, |i, j| eigen.eigenvectors[(i, order[j])]);
            basis = answer * turn;
            let is_settled = (found.iter().zip(&values).take(count))
                .all(|(new, old)| (new - old).abs() <= MODE_TOLERANCE * (new.abs() + shift));
            values = found;
            if is_settled {
                break;
            }
        }
        let modes = (0..count.min(size)).map(|j| {
            let norm = basis.column(j).norm();
            Mode {
                squared_frequency: values[j],
                shape: (roots.iter().enumerate())
                    .map(|(q, root)| {
                        Vector6::from_fn(|i, _| basis[(6 * q + i, j)] / norm * root[i])
                    })
                    .collect(),
            }
        });
        Some(modes.collect())
    }

    /// Returns the matrix multiplied by a factor, and on both sides by the diagonal matrix of `roots`.
    pub fn scaled(&self, roots: &[Vector6<f64>], factor: f64) -> Self {
        let mut out = self.clone();
        for (&(row, column), block) in &mut out.blocks {
            block.component_mul_assign(&(factor * roots[row] * roots[column].transpose()));
        }
        for (size, vector) in &mut out.products {
            *size *= factor;
            for (part, root) in vector.iter_mut().zip(roots) {
                part.component_mul_assign(root);
            }
        }
        out
    }

    /// Returns a matrix of zeros.
    pub fn zeros(n_blocks: usize) -> Self {
        Self {
            n_blocks,
            blocks: BTreeMap::new(),
            products: Vec::new(),
        }
    }

    /// Returns all entries.
    pub fn dense(&self) -> Mat<f64> {
        let n = self.n_unknowns();
        let mut out = Mat::zeros(n, n);
        for (&(row, column), block) in &self.blocks {
            for i in 0..6 {
                for j in 0..6 {
                    out[(6 * row + i, 6 * column + j)] = block[(i, j)];
                }
            }
        }
        for (size, vector) in &self.products {
            for i in 0..n {
                let left = size * vector[i / 6][i % 6];
                for j in 0..n {
                    out[(i, j)] += left * vector[j / 6][j % 6];
                }
            }
        }
        out
    }

    /// Returns the stability of the equilibrium with this stiffness. The smallest `ω²` of a stiffness with a potential decides; without a
    /// potential (body moments, forces that turn with the arm), or if it is negative, the growth rate does. Motions that [the ends leave
    /// loose](Rod::most_loose_motions) do not count where nothing else holds them. `unit` is
    /// [`own_squared_frequency`]. `None` if a value is not finite, or if no motions are to decide where they would.
    pub fn stability(
        &self,
        rod: &Rod,
        at: &Configuration,
        unit: f64,
        motions: Motions,
    ) -> Option<Stability> {
        let has_potential = self.asymmetry() <= ASYMMETRIC;
        if motions == Motions::None && !has_potential {
            return None;
        }
        let loose = loose_motions_of_held(rod);
        let mut rounding = POSITIVE * unit;
        if loose > 0 {
            rounding = rounding.max(self.rounding(rod, at));
        }
        let modes = self.lowest_modes(rod, at, unit, 1 + loose)?;
        // Motions that the ends leave without stiffness neither return nor grow.
        let square = (modes.iter().enumerate())
            .map(|(i, mode)| (i, mode.squared_frequency))
            .find(|(i, square)| *i == loose || square.abs() > rounding)?
            .1;
        let is_definite = square > rounding;
        let mut growth = None;
        let mut lowest = is_definite.then(|| square.sqrt());
        if motions != Motions::None && (!has_potential || square < -rounding) {
            // With a potential, the lowest modes are those that grow.
            let motions = if has_potential || motions == Motions::Slowest {
                self.slowest_motions(rod, at, unit)?
            } else {
                self.small_motions(rod, at, unit)?
            };
            growth = (motions.iter())
                .copied()
                .max_by(|a, b| a.re.total_cmp(&b.re))
                .filter(|fastest| fastest.re > SLOWEST_GROWTH * unit.sqrt());
            // Of two equal decays without a swing, rounding makes a pair that swings very slowly.
            lowest = (motions.iter())
                .filter(|motion| motion.im > LEAST_SWING * motion.norm())
                .map(|motion| motion.im)
                .min_by(f64::total_cmp);
        }
        let is_stable = growth.is_none() && (is_definite || !has_potential);
        Some(Stability {
            is_stable,
            has_potential,
            is_definite,
            least_squared_frequency: square,
            growth_rate: growth.map(|motion| motion.re),
            growth_frequency: growth.map(|motion| motion.im.abs()),
            first_frequency: lowest.filter(|_| is_stable),
        })
    }

    /// Returns the rounding of an `ω²` of zero, 1/s²: that of the largest entry of `M^{-½} K M^{-½}`.
    pub fn rounding(&self, rod: &Rod, at: &Configuration) -> f64 {
        let roots = inertia_roots(rod, at);
        let scaled = self.blocks.iter().map(|(&(row, column), block)| {
            (block.component_mul(&(roots[row] * roots[column].transpose()))).amax()
        });
        let mut largest = scaled.fold(0.0, f64::max);
        for (factor, vector) in &self.products {
            let parts = vector
                .iter()
                .zip(&roots)
                .map(|(v, root)| v.component_mul(root).amax());
            largest = largest.max(factor * parts.fold(0.0, f64::max).powi(2));
        }
        64.0 * f64::EPSILON * largest
    }

    /// Returns the motions without stiffness, which [the ends leave loose](Rod::most_loose_motions) and no load holds; `unit` is
    /// [`own_squared_frequency`].
    pub fn loose_motions(&self, rod: &Rod, at: &Configuration, unit: f64) -> Vec<Mode> {
        let most = rod.most_loose_motions();
        let modes = match most {
            0 => None,
            _ => self.lowest_modes(rod, at, unit, most),
        };
        let least = (POSITIVE * unit).max(self.rounding(rod, at));
        let is_loose = |mode: &Mode| mode.squared_frequency.abs() <= least;
        modes.into_iter().flatten().filter(is_loose).collect()
    }

    /// Returns the displacement of the tip per force on it, m/N, spatial frame; `None` if the matrix is singular.
    pub fn tip_compliance(&self) -> Option<Matrix3<f64>> {
        self.compliance(self.n_blocks - 1)
    }

    /// Returns the displacement of a free node (node 0 is the first of them) per force on it, as [`Self::tip_compliance`].
    pub fn compliance(&self, free: usize) -> Option<Matrix3<f64>> {
        Some(self.compliances([free])?.swap_remove(0))
    }

    /// Returns the displacement of each of some free nodes per force on it, as [`Self::compliance`].
    pub fn compliances(&self, nodes: impl IntoIterator<Item = usize>) -> Option<Vec<Matrix3<f64>>> {
        let factor = self.factor()?;
        let at = |free| self.compliance_by(&factor, free);
        Some(nodes.into_iter().map(at).collect())
    }

    fn compliance_by(&self, factor: &TangentLu, free: usize) -> Matrix3<f64> {
        let unit_force = |axis: usize| {
            let mut force = vec![Vector6::zeros(); self.n_blocks];
            force[free][axis] = 1.0;
            force
        };
        let answers = factor.solve(&[0, 1, 2].map(unit_force));
        Matrix3::from_fn(|i, j| answers[j][free][i])
    }

    /// Returns the largest entry of the unsymmetric part, divided by the largest entry.
    pub fn asymmetry(&self) -> f64 {
        // The products of winches are symmetric.
        let largest = self.blocks.values().map(Matrix6::amax).fold(0.0, f64::max);
        let zero = Matrix6::zeros();
        let unsymmetric = self.blocks.iter().map(|(&(row, column), block)| {
            let other = self.blocks.get(&(column, row)).unwrap_or(&zero);
            (block - other.transpose()).amax()
        });
        unsymmetric.fold(0.0, f64::max) / largest
    }

    /// Returns `K v`.
    pub fn times(&self, vector: &[Vector6<f64>]) -> Vec<Vector6<f64>> {
        let mut out = vec![Vector6::zeros(); self.n_blocks];
        for (&(row, column), block) in &self.blocks {
            out[row] += block * vector[column];
        }
        for (factor, own) in &self.products {
            let size = factor * dot(own, vector);
            for (out, own) in out.iter_mut().zip(own) {
                *out += own * size;
            }
        }
        out
    }
}

/// Returns `aᵀ b`.
pub fn dot(a: &[Vector6<f64>], b: &[Vector6<f64>]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
}
