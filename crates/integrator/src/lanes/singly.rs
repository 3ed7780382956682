//! Nodes that are turned one at a time, by the scalar solver.

use nalgebra::Vector3;

use super::place::{Slot, Slots};
use super::sweep::TurnSingly;
use cosserat::rod::Rod;
use cosserat::rotation::{cay, cayley_quaternion, wxyz};
use cosserat::rotation_step::solve_rotation;

/// A node that cannot be turned, its angular momentum and inertia.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Failure {
    pub node: usize,
    pub g: Vector3<f64>,
    pub inertia: Vector3<f64>,
}

/// Turns nodes with [`solve_rotation`] and stores the first that it cannot turn.
pub struct SingleTurns<'a> {
    pub rod: &'a Rod,
    pub slots: Slots,
    pub time_step: f64,
    pub failure: Option<Failure>,
}

impl TurnSingly for SingleTurns<'_> {
    fn turn(
        &mut self,
        block: usize,
        lane: usize,
        g: [f64; 3],
        inertia: Option<[f64; 3]>,
    ) -> ([f64; 4], [f64; 3]) {
        let node = self.slots.node(Slot { block, lane });
        let g = Vector3::from(g);
        let still = ([1.0, 0.0, 0.0, 0.0], g.into());
        if node < self.rod.first_free_node() || node >= self.rod.n_nodes() {
            return still;
        }
        let inertia = inertia.map_or(self.rod.nodes[node].rotary, Vector3::from);
        let Some(f) = solve_rotation(&inertia, &(g * self.time_step)) else {
            if self.failure.is_none_or(|first| node < first.node) {
                self.failure = Some(Failure { node, g, inertia });
            }
            return still;
        };
        let turn = wxyz(&cayley_quaternion(&f));
        (turn, (cay(&f).transpose() * g).into())
    }
}
