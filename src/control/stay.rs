//! Staying: an arm that comes to rest in an equilibrium under a wrench that is held from then on.
//!
//! Under a constant wrench the energy of a deviation from a stable equilibrium `z*` does not grow. With the deviation `d = (δx, η, p, π)` of
//! the free nodes, the tangent stiffness `K` at `z*` (gravity and loads with it) and the inertia `M` of the nodes it is, to second order,
//! `E = ½ (δx, η)ᵀ K (δx, η) + ½ (p, π)ᵀ M⁻¹ (p, π) = ½ |r|²`. A tip whose compliance at `z*` has the largest eigenvalue `C` is never
//! farther from its place at `z*` than `sqrt(2 E C)`. One ball, `|r| ≤ ρ`, is therefore a promise for all later time.

use nalgebra::{Matrix3, Vector3, Vector6};

use super::holding::Held;
use crate::mechanics::forms::NODE_COMPONENTS;
use crate::mechanics::rotation::{InverseTangentCoefficients, log, log_tangent};
use crate::mechanics::{Configuration, EnergyNorm, FormTerm, Rod, State, Wrench};

/// Fraction of the allowed distance that the motion after the arrival may use. The rest is for the grid: on a finer one the equilibrium of
/// the held wrench lies elsewhere.
const MOTION_SHARE: f64 = 0.5;
/// Vectors of three components in the deviation of a node.
pub const VECTORS: usize = NODE_COMPONENTS / 3;

/// Where an arm stays after its task, and what holds it there.
#[derive(Clone, Debug)]
pub struct Stay {
    /// Index of the goal that it belongs to.
    pub goal: usize,
    /// The wrench of every actuator from the end of the horizon on; the last coefficient of the control.
    pub wrenches: Vec<Wrench>,
    /// The equilibrium under these wrenches.
    pub shape: Configuration,
    /// How long the arm stays, s.
    pub seconds: f64,
    /// How far the tip may be from its place at the equilibrium meanwhile, m.
    pub distance: f64,
    /// Largest eigenvalue of the tip's compliance, m/N.
    pub compliance: f64,
    /// Tells whether deviations do not grow; a body moment may let them, by no more than the stay has room for.
    pub is_stable: bool,
    norm: EnergyNorm,
    first_free_node: usize,
}

impl Stay {
    /// Factor by which a deviation may grow, in length, before the tip is as far off as it may be.
    pub(crate) const ROOM: f64 = 1.0 / MOTION_SHARE;

    /// Staying where `held` holds the arm of this rod, for some seconds and within a distance in m, as a part of goal number `goal`. `None` where
    /// the equilibrium is not stable, or an actuator couples nodes that are no neighbors.
    #[must_use]
    pub fn at(rod: &Rod, held: Held, [seconds, distance]: [f64; 2], goal: usize) -> Option<Self> {
        let norm = EnergyNorm::about(rod, &held.shape, &held.tangent)?;
        Some(Self {
            goal,
            compliance: held.least_stiffness().recip(),
            is_stable: held.is_stable,
            wrenches: held.wrenches,
            shape: held.shape,
            seconds,
            distance,
            norm,
            first_free_node: rod.first_free_node(),
        })
    }

    /// Largest energy of a deviation at the arrival, J: with `½ (share δ)²/C` the tip stays within that share of the distance `δ`.
    #[must_use]
    pub fn energy(&self) -> f64 {
        0.5 * (MOTION_SHARE * self.distance).powi(2) / self.compliance
    }

    /// Radius `ρ` of the ball of `r`, J^½.
    #[must_use]
    pub fn radius(&self) -> f64 {
        (2.0 * self.energy()).sqrt()
    }

    /// Energy `½ |r|²` of the deviation of a state, J.
    #[must_use]
    pub fn energy_of(&self, state: &State) -> f64 {
        let at = &state.configuration;
        let vectors = [
            &at.positions[..],
            &state.linear_momentum,
            &state.angular_momentum,
        ];
        (0..self.n_vectors())
            .map(|vector| 0.5 * self.vector(vector, vectors, &at.rotations).norm_squared())
            .sum()
    }

    /// Number of vectors of `r`: of every free node the two of `Lᵀ d` that begin with its pose, and its two momenta.
    #[must_use]
    pub fn n_vectors(&self) -> usize {
        VECTORS * self.n_nodes()
    }

    /// A vector of `r`, J^½, from the positions and rotations of all nodes and their momenta.
    #[must_use]
    pub fn vector(
        &self,
        vector: usize,
        [x, p, pi]: [&[Vector3<f64>]; 3],
        r: &[Matrix3<f64>],
    ) -> Vector3<f64> {
        let (node, part) = (vector / VECTORS, vector % VECTORS);
        let q = self.first_free_node + node;
        let pose = |q: usize| match x.get(q) {
            Some(x) => join(x - self.shape.positions[q], self.turn(q, &r[q])),
            None => Vector6::zeros(),
        };
        let momenta = join(p[q], pi[q]);
        let found = self.norm.of_node(node, [&pose(q), &pose(q + 1), &momenta]);
        found[part / 2].fixed_rows::<3>(3 * (part % 2)).into_owned()
    }

    /// Derivative of component `axis` of a vector along `(δx, ζ, δp, δπ)`.
    #[must_use]
    pub fn gradient(&self, vector: usize, axis: usize, r: &[Matrix3<f64>]) -> Vec<FormTerm> {
        let mut y = vec![Vector3::zeros(); self.n_vectors()];
        y[vector][axis] = 1.0;
        let node = vector / VECTORS;
        // A vector of a pose reaches to the next node.
        (node..self.n_nodes().min(node + 2))
            .flat_map(|node| self.pull(node, &y, r))
            .collect()
    }

    /// Covector `Σ y·r` over the components of one free node's state.
    fn pull(&self, node: usize, y: &[Vector3<f64>], r: &[Matrix3<f64>]) -> Vec<FormTerm> {
        let q = self.first_free_node + node;
        let [on_pose, on_momenta] = self.on_deviation(node, y);
        let psi = self.turn(q, &r[q]);
        // δψ = Sᵀ ζ
        let slope = log_tangent(&psi, &InverseTangentCoefficients::at(psi.norm_squared()));
        let turned = slope * on_pose.fixed_rows::<3>(3);
        let parts = [
            on_pose.fixed_rows::<3>(0).into_owned(),
            turned,
            on_momenta.fixed_rows::<3>(0).into_owned(),
            on_momenta.fixed_rows::<3>(3).into_owned(),
        ];
        (0..NODE_COMPONENTS)
            .map(|component| FormTerm {
                node: q,
                component,
                coefficient: parts[component / 3][component % 3],
            })
            .filter(|term| term.coefficient != 0.0)
            .collect()
    }

    /// Covector `Σ y·r` over a free node's deviation, poses and momenta: `L y`.
    #[must_use]
    pub fn on_deviation(&self, node: usize, y: &[Vector3<f64>]) -> [Vector6<f64>; 2] {
        let of =
            |node: usize, from: usize| join(y[VECTORS * node + from], y[VECTORS * node + from + 1]);
        let before = node
            .checked_sub(1)
            .map_or_else(Vector6::zeros, |at| of(at, 0));
        (self.norm).pulled(node, [&before, &of(node, 0), &of(node, 2)])
    }

    /// Number of free nodes.
    #[must_use]
    pub fn n_nodes(&self) -> usize {
        self.norm.n_nodes()
    }

    /// Node of the rod of a free node.
    #[must_use]
    pub fn node(&self, free: usize) -> usize {
        self.first_free_node + free
    }

    /// `log(R*ᵀ R)` of a node of the rod.
    #[must_use]
    pub fn turn(&self, q: usize, r: &Matrix3<f64>) -> Vector3<f64> {
        log(&(self.shape.rotations[q].transpose() * r))
    }
}

fn join(a: Vector3<f64>, b: Vector3<f64>) -> Vector6<f64> {
    Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z)
}
