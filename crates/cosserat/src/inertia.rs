//! Rotary inertia that follows the dilatation, and the kinetic reaction that this causes.
//!
//! An element whose chord is `e = |dx|/|dx_rest|` times its rest length gives its ends their shares of rotary inertia divided by `e`. The
//! [model](RodModel) determines which `e` an interval `[k, k+1]` uses:
//!
//! * `dilatation`: `e^k` at its start and `e^{k+1}` at its end, the printed equation (81) of the paper;
//! * `consistent`: one value for the whole interval, so that there is a discrete Lagrangian: `e^k` for even `k`, `e^{k+1}` for odd `k`.
//! Every step is then explicit, and two steps together are symmetric, hence of second order.
//!
//! The rotational kinetic energy of an element over an interval, `T = Σ_ends f·J f / (2 h² α e)` with the ends' Cayley vectors `f` and `α =
//! 1 + |f|²/4`, pulls its nodes together with the impulse `h ∂T/∂dx` at that end of the interval whose `e` it uses.

use nalgebra::Vector3;

use super::element::RodModel;
use super::rod::Rod;

/// The ends of an interval at which the inertia follows the dilatation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InertiaRule {
    /// Neither end: the inertia is that of the rod at rest.
    Constant,
    /// Both ends: the momentum that leaves the start has the inertia of the start, the momentum that arrives at the end that of the end.
    Both,
    /// The start only, with the kinetic reaction there.
    Start,
    /// The end only, with the kinetic reaction there.
    End,
}

impl InertiaRule {
    /// Returns the rule for the interval from time node `k` on.
    #[inline]
    #[must_use]
    pub fn of(model: RodModel, k: usize) -> Self {
        match model {
            RodModel::Standard => Self::Constant,
            RodModel::Dilatation => Self::Both,
            RodModel::Consistent if k.is_multiple_of(2) => Self::Start,
            RodModel::Consistent => Self::End,
        }
    }
}

impl Rod {
    /// Returns the principal moments of inertia of every node in a configuration, kg m², body frame; those at rest under
    /// [`RodModel::Standard`].
    #[must_use]
    pub fn rotary_at(&self, positions: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let mut rotary = Vec::with_capacity(self.n_nodes());
        self.write_rotary(positions, &mut rotary);
        rotary
    }

    /// Writes [`Self::rotary_at`] to a buffer.
    pub(super) fn write_rotary(&self, positions: &[Vector3<f64>], rotary: &mut Vec<Vector3<f64>>) {
        rotary.clear();
        rotary.extend(self.nodes.iter().map(|node| node.rotary));
        if self.model == RodModel::Standard {
            return;
        }
        for (q, shares) in self.element_inertia.iter().enumerate() {
            let change = 1.0 / self.chord_dilatation(q, positions) - 1.0;
            for (end, share) in shares.iter().enumerate() {
                rotary[q + end] += share.rotary * change;
            }
        }
    }

    /// Returns the moments of node 0 in [`Self::rotary_at`].
    pub fn base_rotary(&self, positions: &[Vector3<f64>]) -> Vector3<f64> {
        let rotary = self.nodes[0].rotary;
        if self.model == RodModel::Standard {
            return rotary;
        }
        let change = 1.0 / self.chord_dilatation(0, positions) - 1.0;
        rotary + self.element_inertia[0][0].rotary * change
    }

    /// Returns the dilatation of a chord, `|x_{q+1} - x_q|/|x_{q+1} - x_q|_rest`.
    #[inline]
    pub fn chord_dilatation(&self, q: usize, positions: &[Vector3<f64>]) -> f64 {
        (positions[q + 1] - positions[q]).norm() / self.rest_chords[q]
    }

    /// Returns `h c/l`: the dilatation at which the axial stiffness `EA/e²` of element `q` reaches the stability limit of the step.
    pub fn least_dilatation(&self, q: usize, time_step: f64) -> f64 {
        let [a, b] = &self.element_inertia[q];
        let element = &self.elements[q];
        let stiffness = element.linear_stiffness.z / element.length;
        0.5 * time_step * (stiffness * (1.0 / a.mass + 1.0 / b.mass)).sqrt()
    }

    /// Adds `factor` times the impulses of the kinetic reaction at `positions` to the momenta of the moving nodes; `turn` returns the
    /// Cayley vector of a node's step.
    pub fn add_kinetic_reaction<'a>(
        &self,
        positions: &[Vector3<f64>],
        turn: impl Fn(usize) -> &'a Vector3<f64>,
        factor: f64,
        h: f64,
        p: &mut [Vector3<f64>],
    ) {
        for q in 0..self.n_elements() {
            let dx = positions[q + 1] - positions[q];
            let impulse = factor * self.kinetic_reaction(q, &dx, [turn(q), turn(q + 1)], h);
            if q >= self.first_free_node() {
                p[q] -= impulse;
            }
            p[q + 1] += impulse;
        }
    }

    /// Returns the impulse of the kinetic reaction on node `q + 1` (opposite on node `q`), kg m/s, for the Cayley vectors of the two ends:
    /// `-h L₀ T dx/|dx|³`, `T = Σ_ends f·J f/(2 h² α)`, `L₀ = |dx_rest|`.
    #[inline]
    pub fn kinetic_reaction(
        &self,
        q: usize,
        dx: &Vector3<f64>,
        turns: [&Vector3<f64>; 2],
        h: f64,
    ) -> Vector3<f64> {
        self.kinetic_pull(q, dx, self.rotational_energy(q, turns, h)) * h
    }

    /// Returns the force on node `q + 1` (opposite on node `q`), N, of an element whose ends rotate with the kinetic energy `energy` at `e
    /// = 1`: `∂L/∂dx = -L₀ T dx/|dx|³`.
    #[inline]
    pub fn kinetic_pull(&self, q: usize, dx: &Vector3<f64>, energy: f64) -> Vector3<f64> {
        let length = dx.norm();
        dx * (-self.rest_chords[q] * energy / (length * length * length))
    }

    /// Returns `Σ_ends f·J f/(2 h² α)` of element `q` at `e = 1`, J.
    pub fn rotational_energy(&self, q: usize, turns: [&Vector3<f64>; 2], h: f64) -> f64 {
        let shares = &self.element_inertia[q];
        (0..2)
            .map(|end| {
                let f = turns[end];
                let rate = f / h;
                rate.dot(&shares[end].rotary.component_mul(&rate)) / (1.0 + 0.25 * f.norm_squared())
            })
            .sum::<f64>()
            * 0.5
    }
}
