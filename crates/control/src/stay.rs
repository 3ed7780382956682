//! Staying: an arm that comes to rest in an equilibrium under a wrench that is constant from then on.
//!
//! Under a constant wrench, the energy of a deviation from a stable equilibrium `z*` does not grow, nor, to second order, that of any of
//! its modes. With the deviation `d = (δx, η)` of the free nodes and their momenta `P`, the mode `φ` of angular frequency `ω` has the
//! energy `½ |(ω φᵀ M d, φᵀ P)|²`. The ball `|r| ≤ ρ` over these pairs of the slow modes, which have nearly all of the compliance `C` of
//! the tip, holds for all later times: these modes move the tip by at most `ρ sqrt(C)`. Faster modes can carry much energy without moving
//! the tip.

use nalgebra::{Matrix3, Vector3, Vector6};

use super::held::Held;
use mechanics::forms::NODE_COMPONENTS;
use mechanics::rotation::{log, log_tangent};
use mechanics::slow_modes::{GROUP, SlowModes};
use mechanics::{BaseCondition, Configuration, FormTerm, Rod, State};

/// Fraction of the allowed distance (`task.stays_m`) that the motion after the arrival may use, half of it (decision 81). The rest is for
/// fast waves and for the grid: on a finer one, the equilibrium of the same wrench lies elsewhere. The check measures the distance itself.
const MOTION_SHARE: f64 = 0.5;

/// The equilibrium in which an arm stays after its task, and the wrench that holds it there.
#[derive(Clone, Debug)]
pub struct Stay {
    /// Index of the goal to which the stay belongs.
    pub goal: usize,
    /// Controls from the end of the horizon on, which are their last coefficient.
    pub controls: Vec<f64>,
    /// The equilibrium under these controls.
    pub shape: Configuration,
    /// Duration of the stay, s.
    pub seconds: f64,
    /// Largest allowed distance of the goal's node from its place at the equilibrium, m.
    pub distance: f64,
    /// Largest eigenvalue of the compliance of the goal's node, m/N.
    pub compliance: f64,
    /// Tells whether deviations do not grow; under a body moment they may, by no more than `Stay::ROOM`.
    pub is_stable: bool,
    modes: SlowModes,
    first_free_node: usize,
}

impl Stay {
    /// Factor by which a deviation may grow, in length, before the tip is at the allowed distance.
    pub const ROOM: f64 = 1.0 / MOTION_SHARE;

    /// Returns the stay in the equilibrium `held` of this rod, for a duration in s and within a distance in m, as a part of goal number
    /// `goal` at `node`. Returns `None` if the symmetric part of the tangent stiffness is not positive.
    ///
    /// A free arm has no restoring force, but it can drift away only during the stay `τ`: with `K + M/τ²` in the place of the stiffness, a
    /// rigid motion of velocity `v` counts as one of amplitude `v τ`.
    #[must_use]
    pub fn at(
        rod: &Rod,
        held: Held,
        [seconds, distance]: [f64; 2],
        (goal, node): (usize, usize),
    ) -> Option<Self> {
        let unit = held.least_squared_frequency;
        let tangent = match rod.base {
            BaseCondition::Free if rod.has_free_tip() => {
                (held.tangent).with_inertia(rod, &held.shape, seconds.powi(-2))
            }
            _ => held.tangent,
        };
        let modes = SlowModes::about(rod, (&held.shape, node), tangent, unit)?;
        Some(Self {
            goal,
            compliance: modes.compliance(),
            is_stable: held.is_stable,
            controls: held.controls,
            shape: held.shape,
            seconds,
            distance,
            modes,
            first_free_node: rod.first_free_node(),
        })
    }

    /// Returns the largest energy of the slow modes at the arrival, J: with `½ (share δ)²/C` the node stays within that share of the
    /// distance `δ`.
    #[must_use]
    pub fn energy(&self) -> f64 {
        0.5 * (MOTION_SHARE * self.distance).powi(2) / self.compliance
    }

    /// Returns the radius `ρ` of the ball of `r`, J^½.
    #[must_use]
    pub fn radius(&self) -> f64 {
        (2.0 * self.energy()).sqrt()
    }

    /// Returns the energy of the deviation of a state, J, to second order.
    #[must_use]
    pub fn energy_of(&self, state: &State) -> f64 {
        let [deviation, momenta] = self.deviation(state);
        self.modes.energy(&deviation, &momenta)
    }

    /// Returns the largest distance of the goal's node from its place at the equilibrium, m, with the energy that a state's deviation has in each
    /// of its modes, to second order: at most `sqrt(2 E C)`.
    #[must_use]
    pub fn reach(&self, state: &State) -> f64 {
        let [deviation, momenta] = self.deviation(state);
        self.modes.reach(&deviation, &momenta)
    }

    /// Returns `(δx, η)` and `(δp, δπ)` of the free nodes.
    fn deviation(&self, state: &State) -> [Vec<Vector6<f64>>; 2] {
        let at = &state.configuration;
        let nodes = self.free_nodes();
        let pose = |q: usize| self.pose(q, &at.positions[q], &at.rotations[q]);
        let momenta = |q: usize| join(state.linear_momentum[q], state.angular_momentum[q]);
        [
            nodes.clone().map(pose).collect(),
            nodes.map(momenta).collect(),
        ]
    }

    /// Returns `(x - x*, log(R*ᵀ R))` of a node of the rod.
    fn pose(&self, q: usize, x: &Vector3<f64>, r: &Matrix3<f64>) -> Vector6<f64> {
        join(x - self.shape.positions[q], self.turn(q, r))
    }

    /// Returns the number of vectors of `r`: for every three slow modes one of `ω φᵀ M d` and one of `φᵀ P`.
    #[must_use]
    pub fn n_vectors(&self) -> usize {
        2 * self.modes.n_groups()
    }

    /// Returns a vector of `r`, J^½, from the positions and rotations of all nodes and their momenta.
    #[must_use]
    pub fn vector(
        &self,
        vector: usize,
        [x, p, pi]: [&[Vector3<f64>]; 3],
        r: &[Matrix3<f64>],
    ) -> Vector3<f64> {
        self.free_nodes()
            .map(|q| self.part_of_node(vector, q, [&x[q], &p[q], &pi[q]], &r[q]))
            .sum()
    }

    /// Returns the term of one node of the rod in a vector of `r`, which is a sum over the free nodes.
    #[must_use]
    pub fn part_of_node(
        &self,
        vector: usize,
        q: usize,
        [x, p, pi]: [&Vector3<f64>; 3],
        r: &Matrix3<f64>,
    ) -> Vector3<f64> {
        let of_node = match Half::of(vector) {
            Half::Deviation => self.pose(q, x, r),
            Half::Momenta => join(*p, *pi),
        };
        let covectors = self.covectors(vector, q);
        Vector3::from_fn(|i, _| covectors[i].dot(&of_node))
    }

    /// Returns the derivatives of the components of a vector of `r` along a node's pose or its momenta, whichever the vector depends on.
    fn covectors(&self, vector: usize, q: usize) -> [Vector6<f64>; GROUP] {
        let (group, free) = (vector / 2, q - self.first_free_node);
        match Half::of(vector) {
            Half::Deviation => self.modes.along_deviation(group, free),
            Half::Momenta => self.modes.along_momenta(group, free),
        }
    }

    /// Returns the derivative of component `axis` of a vector along `(δx, ζ)` or `(δp, δπ)` of the nodes with these rotations: six terms
    /// for each free node, in order.
    pub(crate) fn gradient<'a>(
        &'a self,
        vector: usize,
        axis: usize,
        r: &'a [Matrix3<f64>],
    ) -> impl Iterator<Item = FormTerm> + 'a {
        self.free_nodes().flat_map(move |q| {
            let mut along = self.covectors(vector, q)[axis];
            let first = match Half::of(vector) {
                Half::Deviation => {
                    let psi = self.turn(q, &r[q]);
                    // δψ = Sᵀ ζ
                    let slope = log_tangent(&psi);
                    let turned = slope * along.fixed_rows::<3>(3);
                    along.fixed_rows_mut::<3>(3).copy_from(&turned);
                    0
                }
                Half::Momenta => NODE_COMPONENTS / 2,
            };
            (0..6).map(move |i| FormTerm {
                node: q,
                component: first + i,
                coefficient: along[i],
            })
        })
    }

    /// Returns the covector `Σ y·r` with respect to the logarithm `log(R*ᵀ R)` of a node of the rod.
    #[must_use]
    pub fn on_turn(&self, q: usize, y: &[Vector3<f64>]) -> Vector3<f64> {
        let vectors = (0..self.n_vectors()).filter(|vector| Half::of(*vector) == Half::Deviation);
        vectors
            .flat_map(|vector| {
                let covectors = self.covectors(vector, q);
                (0..GROUP).map(move |i| covectors[i].fixed_rows::<3>(3) * y[vector][i])
            })
            .sum()
    }

    /// Returns the free nodes of the rod.
    #[must_use]
    pub fn free_nodes(&self) -> std::ops::Range<usize> {
        self.first_free_node..self.shape.positions.len()
    }

    /// Returns `log(R*ᵀ R)` of a node of the rod.
    #[must_use]
    pub fn turn(&self, q: usize, r: &Matrix3<f64>) -> Vector3<f64> {
        log(&(self.shape.rotations[q].transpose() * r))
    }
}

/// The part of the state that a vector of `r` depends on.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Half {
    Deviation,
    Momenta,
}

impl Half {
    fn of(vector: usize) -> Self {
        match vector % 2 {
            0 => Self::Deviation,
            _ => Self::Momenta,
        }
    }
}

fn join(a: Vector3<f64>, b: Vector3<f64>) -> Vector6<f64> {
    Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z)
}
