//! Small motions about a configuration at rest: natural frequencies, and the growth of deviations from an unstable one.
//!
//! Deviations `q = (δx, η)` of the free nodes obey `M q̈ + c M q̇ + K q = 0` with the inertia `M` of the nodes, the viscous damping `c` and
//! the tangent stiffness `K`. In a mode `K q = ω² M q` they change as `exp(s t)` with `s² + c s + ω² = 0`: if `ω² < 0` they grow. Of loads
//! without a potential (body-fixed forces, spatial moments) the symmetric part of their stiffness is used, and Kelvin-Voigt damping is left
//! out. So are the springs of winches, which couple all elements: with them no frequency is lower than without, and
//! [`Stability`](super::Stability) counts them.
//!
//! By Sylvester's law of inertia `M^{-½} K M^{-½} - σ I` has as many negative pivot eigenvalues as there are `ω² < σ`. Counting them costs
//! O(K), and bisection over `σ` finds any `ω²` to the rounding of the largest.

use nalgebra::{Matrix6, Vector6};

use cosserat::configuration::Configuration;
use cosserat::rod::Rod;
use cosserat::stiffness::tangent_stiffness;

/// Weight number `ρA g L³/EI` above which a uniform column that is clamped upright topples under its own weight: `9/4 j²` with
/// `j = 1.86635` the first zero of the Bessel function `J_{-1/3}` (Greenhill 1881).
pub const TOPPLING_WEIGHT_NUMBER: f64 = 7.837_347;

/// Payload number `m g L²/EI` above which a payload topples a light uniform column that is clamped upright: `π²/4` (Euler).
pub const TOPPLING_PAYLOAD_NUMBER: f64 = 2.467_401;

/// Describes the weight of a rod relative to its stiffness, beside the limit of a uniform column, in words that follow a colon or a
/// parenthesis.
///
/// For a column with a payload, the fractions of both limits add up to about 1 when it topples, and to no more (Dunkerley).
#[must_use]
pub fn weight_in_words(rod: &Rod) -> String {
    let own = weight_number(rod);
    let payload = rod.mass() * rod.gravity.norm() / rod.scales.force - own;
    if payload <= 1e-9 * own {
        return format!(
            "weight number rho A g L^3/EI {own:.3}; a uniform arm clamped upright topples above {TOPPLING_WEIGHT_NUMBER:.2}"
        );
    }
    let share = own / TOPPLING_WEIGHT_NUMBER + payload / TOPPLING_PAYLOAD_NUMBER;
    format!(
        "weight number rho A g L^3/EI {own:.3} and of the payload m g L^2/EI {payload:.3}; a uniform arm clamped upright topples by its weight above \
         {TOPPLING_WEIGHT_NUMBER:.2}, by a payload above {TOPPLING_PAYLOAD_NUMBER:.2}, by both where the fractions make up about 1: here {share:.2}"
    )
}

/// Returns `m g / (EI/L²)`, which is `ρA g L³/EI`: the rod's own weight divided by its scale of force, whatever its direction; the payload
/// is left out.
#[must_use]
pub fn weight_number(rod: &Rod) -> f64 {
    let shares = rod.element_inertia.iter().flatten();
    let mass: f64 = shares.map(|share| share.mass).sum();
    mass * rod.gravity.norm() / rod.scales.force
}

/// The small motions about a configuration.
#[derive(Clone, Debug)]
pub struct SmallMotions {
    /// Blocks of the symmetric `M^{-½} K M^{-½}` on the diagonal, 1/s².
    diagonal: Vec<Matrix6<f64>>,
    /// Blocks below the diagonal, 1/s².
    below: Vec<Matrix6<f64>>,
    /// Upper bound of the absolute eigenvalues, 1/s².
    bound: f64,
    /// Number of rigid modes, which have no energy.
    rigid: usize,
    /// Viscous damping, 1/s.
    damping: f64,
}

impl SmallMotions {
    /// Computes the small motions about `at`, an equilibrium of `rod` under its loads at time `t`; a driven base is held.
    #[must_use]
    pub fn about(rod: &Rod, at: &Configuration, t: f64) -> Self {
        let stiffness = tangent_stiffness(rod, at, t);
        let roots = inertia_roots(rod, at);
        let scaled = |block: Matrix6<f64>, row: usize, column: usize| {
            block.component_mul(&(roots[row] * roots[column].transpose()))
        };
        let diagonal: Vec<_> = (stiffness.diagonal.iter().enumerate())
            .map(|(i, block)| scaled(0.5 * (block + block.transpose()), i, i))
            .collect();
        let below: Vec<_> = (stiffness.below.iter().zip(&stiffness.above).enumerate())
            .map(|(i, (below, above))| scaled(0.5 * (below + above.transpose()), i + 1, i))
            .collect();
        let bound = largest_row_sum(&diagonal, &below);
        let mut out = Self {
            diagonal,
            below,
            bound,
            rigid: 0,
            damping: rod.viscous_damping,
        };
        out.rigid = match rod.most_loose_motions() {
            _ if !rod.is_held() => 6,
            // A load may hold what the ends leave loose, as its weight holds a pendulum.
            most => (0..most)
                .filter(|&mode| out.squared_frequency(mode).abs() <= out.rounding())
                .count(),
        };
        out
    }

    /// Returns the number of slowest modes without stiffness.
    #[must_use]
    pub fn n_loose(&self) -> usize {
        self.rigid
    }

    /// Returns the `mode`-th smallest `ω²`, counted from 0 and including the modes without stiffness of a rod whose ends do not hold it, 1/s². NaN if there is no such mode,
    /// or the stiffness is not finite.
    #[must_use]
    pub fn squared_frequency(&self, mode: usize) -> f64 {
        if !self.bound.is_finite() || mode >= 6 * self.diagonal.len() {
            return f64::NAN;
        }
        let (mut low, mut high) = (-self.bound, self.bound);
        while high - low > f64::EPSILON * self.bound {
            let middle = 0.5 * (low + high);
            // The bisection also ends if there is no number between the two.
            if !(low < middle && middle < high) {
                break;
            }
            if self.count_below(middle) > mode {
                high = middle;
            } else {
                low = middle;
            }
        }
        0.5 * (low + high)
    }

    /// Returns the angular frequency of the slowest mode that deforms the rod, rad/s, without damping; `None` if that mode grows.
    #[must_use]
    pub fn first_frequency(&self) -> Option<f64> {
        let square = self.squared_frequency(self.rigid);
        (square > self.rounding()).then(|| square.sqrt())
    }

    /// Returns the rate `s` of the fastest growth `exp(s t)` of a small deviation, 1/s, with viscous damping; `None` about a configuration
    /// that is stable to rounding.
    #[must_use]
    pub fn growth_rate(&self) -> Option<f64> {
        let square = self.squared_frequency(0);
        (square < -self.rounding()).then(|| {
            let c = 0.5 * self.damping;
            // The positive root of s² + 2 c s + ω² = 0, without cancellation.
            -square / (c + (c * c - square).sqrt())
        })
    }

    /// Returns the rounding of an `ω²` of zero, 1/s².
    fn rounding(&self) -> f64 {
        64.0 * f64::EPSILON * self.bound
    }

    /// Returns the number of `ω²` below `shift`.
    fn count_below(&self, shift: f64) -> usize {
        let least = f64::EPSILON * f64::EPSILON * self.bound;
        let mut count = 0;
        let mut fill = Matrix6::zeros();
        for (i, block) in self.diagonal.iter().enumerate() {
            let pivot = (block - Matrix6::from_diagonal_element(shift) - fill).symmetric_eigen();
            // A pivot of exactly zero is an eigenvalue at the shift: it may count as either.
            let values =
                (pivot.eigenvalues).map(|value| if value.abs() < least { least } else { value });
            count += values.iter().filter(|value| **value < 0.0).count();
            if let Some(below) = self.below.get(i) {
                let turned = below * pivot.eigenvectors;
                fill =
                    turned * Matrix6::from_diagonal(&values.map(f64::recip)) * turned.transpose();
                fill = 0.5 * (fill + fill.transpose());
            }
        }
        count
    }
}

/// Returns the diagonal of `M^{-½}` with respect to `(δx, η)` of every free node.
pub(super) fn inertia_roots(rod: &Rod, at: &Configuration) -> Vec<Vector6<f64>> {
    let rotary = rod.rotary_at(&at.positions);
    (rod.nodes.iter().zip(&rotary).skip(rod.first_free_node()))
        .map(|(node, j)| {
            let m = node.mass;
            Vector6::new(m, m, m, j.x, j.y, j.z).map(|inertia| 1.0 / inertia.sqrt())
        })
        .collect()
}

/// Returns the largest sum of the absolute entries of a row of a symmetric block-tridiagonal matrix (Gershgorin).
fn largest_row_sum(diagonal: &[Matrix6<f64>], below: &[Matrix6<f64>]) -> f64 {
    let sums = |block: &Matrix6<f64>| block.abs().column_sum();
    (0..diagonal.len())
        .map(|i| {
            let mut rows = sums(&diagonal[i]);
            if let Some(left) = i.checked_sub(1) {
                rows += sums(&below[left]);
            }
            if let Some(right) = below.get(i) {
                rows += sums(&right.transpose());
            }
            // A NaN must not be lost, as it would be in a maximum.
            rows.iter().fold(
                0.0,
                |largest: f64, sum| if *sum <= largest { largest } else { *sum },
            )
        })
        .fold(
            0.0,
            |largest: f64, sum| if sum <= largest { largest } else { sum },
        )
}
