//! The controls of an earlier solution, on the grid of another problem.

use crate::control::{ActuatedNode, OptimalControlProblem};
use crate::mechanics::Wrench;
use crate::scene::OptimalControl;

/// An earlier solution: its problem and the coefficients of its controls.
pub(crate) struct Earlier {
    pub problem: OptimalControlProblem,
    pub coefficients: Vec<Wrench>,
}

impl Earlier {
    /// Gives a problem with free final time the duration of the earlier solution, clamped to the problem's bounds.
    pub fn timed(&self, setup: OptimalControl) -> OptimalControl {
        let Some(free) = setup.problem.duration else {
            return setup;
        };
        let duration = self
            .problem
            .grid
            .duration()
            .clamp(free.shortest, free.longest);
        setup.with_time_scale(duration / setup.problem.grid.duration())
    }

    /// Returns the coefficients of another problem: the earlier control at the times of its coefficients, from the actuator at the same
    /// place of the arm, or zero where there was none.
    pub fn controls(&self, problem: &OptimalControlProblem) -> Vec<Wrench> {
        let earlier = &self.problem;
        let n = earlier.actuators.len();
        let last = earlier.grid.n_steps;
        let [n_wrenches, n_earlier] = [problem, earlier].map(|p| p.wrench_actuators().len());
        let found = |(index, actuator): (usize, &ActuatedNode)| {
            if index >= n_wrenches {
                // Controls of user-defined actuators follow those of the nodes.
                return Some(index - n_wrenches + n_earlier).filter(|a| *a < n);
            }
            let node = (earlier.rod.mesh).node_at(problem.rod.mesh.fraction(actuator.node));
            let same = |other: &ActuatedNode| Some(other.node) == node;
            earlier.wrench_actuators().iter().position(same)
        };
        let places: Vec<_> = problem.actuators.iter().enumerate().map(found).collect();
        let mut out = Vec::new();
        for t in problem.control.coefficient_times() {
            let k = ((t / earlier.grid.step).round() as usize).min(last);
            out.extend(places.iter().map(|place| {
                place.map_or_else(Wrench::default, |a| {
                    (earlier.control).value(k, |j| self.coefficients[j * n + a])
                })
            }));
        }
        out
    }
}
