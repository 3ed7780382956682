//! The controls of an earlier solution, on the grid of another problem.

use crate::control::{ActuatedNode, OptimalControlProblem};
use crate::mechanics::Wrench;
use crate::scene::OptimalControl;

/// An earlier solution.
pub(crate) struct Earlier {
    pub problem: OptimalControlProblem,
    pub coefficients: Vec<Wrench>,
}

impl Earlier {
    /// A problem with a free duration begins with that of the earlier solution, as near as its limits allow.
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

    /// The coefficients at the times of a problem's, of actuators at the same places of the arm.
    pub fn controls(&self, problem: &OptimalControlProblem) -> Vec<Wrench> {
        let earlier = &self.problem;
        let n = earlier.actuators.len();
        let last = earlier.grid.n_steps;
        let [n_wrenches, n_earlier] = [problem, earlier].map(|p| p.wrench_actuators().len());
        let [elements, before] = [problem, earlier].map(|p| p.rod.n_elements());
        let found = |(index, actuator): (usize, &ActuatedNode)| {
            if index >= n_wrenches {
                // Controls of actuators of one's own follow those of the nodes.
                return Some(index - n_wrenches + n_earlier).filter(|a| *a < n);
            }
            let same = |other: &ActuatedNode| other.node * elements == actuator.node * before;
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
