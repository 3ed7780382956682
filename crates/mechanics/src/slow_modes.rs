//! The slow modes of an arm about an equilibrium, which have nearly all of the compliance of one of its nodes, and the energy of a deviation
//! in each of them.
//!
//! A deviation `d = (δx, η)` of the free nodes with momenta `P = (δp, δπ)` has in a mode `K φ = ω² M φ`, `φᵀ M φ = 1`, the amplitude `φᵀ M
//! d` and the velocity `φᵀ P`. With `r = (ω φᵀ M d, φᵀ P)` its energy is `½ |r|²`, and as long as `K` is symmetric and constant the mode
//! moves the node `q` by no more than `|r| |φ_q|/ω`.

use nalgebra::{Vector3, Vector6};

use super::tangent::{Mode, Tangent, dot};
use super::vibration::inertia_roots;
use cosserat::configuration::Configuration;
use cosserat::rod::Rod;

/// Largest fraction of the node's compliance in modes beyond the slow ones.
const LEFT_OUT: f64 = 1e-3;
/// Largest fraction of the node's compliance in modes whose energies are not computed one by one.
const LUMPED: f64 = 1e-6;
/// Modes are grouped by three, so that their amplitudes fill vectors.
pub const GROUP: usize = 3;
/// Number of modes that are computed at first.
const FIRST_MODES: usize = 4 * GROUP;

/// Modes about a stable equilibrium.
#[derive(Clone, Debug)]
pub struct SlowModes {
    /// Modes, ascending; their number is a multiple of [`GROUP`].
    modes: Vec<Mode>,
    /// Number of slow modes, which come first.
    n_slow: usize,
    tangent: Tangent,
    /// The diagonal of the inertia of every free node.
    inertia: Vec<Vector6<f64>>,
    /// The node, counted from the first free one.
    node: usize,
    /// Largest eigenvalue of the node's compliance, and of its part in all other modes, m/N.
    compliance: f64,
    left_out: f64,
}

impl SlowModes {
    /// Computes the slowest modes, with all but [`LEFT_OUT`] of the compliance of a `node` of the rod that is not held, by the symmetric part
    /// of the tangent stiffness at an equilibrium; `unit` is about the smallest `ω²` of a stable arm, 1/s². `None` if an `ω²` is not
    /// positive.
    pub fn about(
        rod: &Rod,
        (at, node): (&Configuration, usize),
        tangent: Tangent,
        unit: f64,
    ) -> Option<Self> {
        let node = node.checked_sub(rod.first_free_node())?;
        let symmetric = tangent.symmetric();
        let whole = symmetric.compliance(node)?;
        let compliance = whole.symmetric_eigenvalues().max();
        let n_all = symmetric.n_unknowns();
        let mut count = FIRST_MODES.min(n_all);
        let mut n_slow = None;
        loop {
            let mut modes = symmetric.lowest_modes(rod, at, unit, count)?;
            if !modes.iter().all(|mode| mode.squared_frequency > 0.0) {
                return None;
            }
            let mut rest = whole;
            for taken in (GROUP..=modes.len()).step_by(GROUP) {
                for mode in &modes[taken - GROUP..taken] {
                    let way = mode.displacement(node);
                    rest -= way * way.transpose() / mode.squared_frequency;
                }
                let left_out = rest.symmetric_eigenvalues().max().max(0.0);
                if left_out <= LEFT_OUT * compliance || taken == n_all {
                    n_slow = n_slow.or(Some(taken));
                }
                if left_out <= LUMPED * compliance || taken == n_all {
                    modes.truncate(taken);
                    return Some(Self {
                        modes,
                        n_slow: n_slow?,
                        node,
                        tangent,
                        inertia: (inertia_roots(rod, at).iter())
                            .map(|root| root.map(|r| (r * r).recip()))
                            .collect(),
                        compliance,
                        left_out,
                    });
                }
            }
            count = (2 * count).min(n_all);
        }
    }

    /// Returns the number of groups of [`GROUP`] slow modes.
    pub fn n_groups(&self) -> usize {
        self.n_slow / GROUP
    }

    /// Returns the slow modes.
    pub fn slow(&self) -> &[Mode] {
        &self.modes[..self.n_slow]
    }

    /// Returns the diagonal of the inertia of every free node.
    pub fn inertia(&self) -> &[Vector6<f64>] {
        &self.inertia
    }

    /// Returns the largest eigenvalue of the node's compliance, m/N.
    pub fn compliance(&self) -> f64 {
        self.compliance
    }

    /// Returns the covectors of a free node's deviation (node 0 is the first free one) in the `ω φᵀ M d` of a group's modes.
    pub fn along_deviation(&self, group: usize, free: usize) -> [Vector6<f64>; GROUP] {
        std::array::from_fn(|i| {
            let mode = &self.modes[GROUP * group + i];
            self.inertia[free].component_mul(&mode.shape[free]) * mode.squared_frequency.sqrt()
        })
    }

    /// Returns the covectors of a node's momenta in the `φᵀ P` of a group's modes.
    pub fn along_momenta(&self, group: usize, free: usize) -> [Vector6<f64>; GROUP] {
        std::array::from_fn(|i| self.modes[GROUP * group + i].shape[free])
    }

    /// Returns the energy `½ dᵀ K d + ½ Pᵀ M⁻¹ P` of a deviation, J.
    pub fn energy(&self, deviation: &[Vector6<f64>], momenta: &[Vector6<f64>]) -> f64 {
        let elastic = dot(deviation, &self.tangent.times(deviation));
        let kinetic: f64 = (momenta.iter().zip(&self.inertia))
            .map(|(p, inertia)| p.dot(&p.component_div(inertia)))
            .sum();
        0.5 * (elastic + kinetic)
    }

    /// Returns an upper bound of the distance of the node from the equilibrium, m, with the energy that a deviation has in each of its
    /// modes.
    ///
    /// Modes of energy `E` together move the node by at most `sqrt(2 E C)` (Cauchy and Schwarz), one mode by `sqrt(2 E_k) |φ_q,k|/ω_k`,
    /// and all modes beyond the known ones by `sqrt(2 E C_r)` with their part `C_r` of the compliance. The first modes count together, the
    /// others one by one; the number of the first ones is the one with the smallest bound. The result never exceeds `sqrt(2 E C)` of the
    /// whole energy.
    pub fn reach(&self, deviation: &[Vector6<f64>], momenta: &[Vector6<f64>]) -> f64 {
        let whole = 2.0 * self.energy(deviation, momenta);
        let doubled: Vec<f64> = (self.modes.iter())
            .map(|mode| {
                let amplitude: f64 = (mode.shape.iter().zip(deviation).zip(&self.inertia))
                    .map(|((shape, d), inertia)| shape.dot(&d.component_mul(inertia)))
                    .sum();
                mode.squared_frequency * amplitude.powi(2) + dot(&mode.shape, momenta).powi(2)
            })
            .collect();
        let known: f64 = doubled.iter().sum();
        let mut one_by_one = ((whole - known).max(0.0) * self.left_out).sqrt();
        let mut together = known;
        let mut least = one_by_one + (together * self.compliance).sqrt();
        for (energy, mode) in doubled.iter().zip(&self.modes).rev() {
            together = (together - energy).max(0.0);
            one_by_one +=
                (energy / mode.squared_frequency).sqrt() * mode.displacement(self.node).norm();
            least = least.min(one_by_one + (together * self.compliance).sqrt());
        }
        least.min((whole * self.compliance).sqrt())
    }
}

impl Mode {
    /// Returns the displacement of a free node.
    fn displacement(&self, free: usize) -> Vector3<f64> {
        self.shape[free].fixed_rows::<3>(0).into_owned()
    }
}
