//! The controls of an earlier solution, on the grid of another problem.

use crate::control::{NamedControl, OptimalControlProblem};
use crate::scene::OptimalControl;

/// An earlier solution: its problem and the coefficients of its controls.
pub(crate) struct Earlier {
    pub problem: OptimalControlProblem,
    pub coefficients: Vec<f64>,
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

    /// Returns the coefficients of another problem: the values of the earlier controls of the same name and unit at the times of its
    /// coefficients, and the controls at rest where there was none.
    pub fn controls(&self, problem: &OptimalControlProblem) -> Vec<f64> {
        let earlier = &self.problem;
        let (n, n_earlier) = (problem.n_numbers(), earlier.n_numbers());
        let last = earlier.grid.n_steps;
        let (named, before) = (problem.named_controls(), earlier.named_controls());
        let same = |own: &NamedControl| {
            (before.iter()).find(|other| (&other.name, other.unit) == (&own.name, own.unit))
        };
        let pairs: Vec<_> = (named.iter())
            .filter_map(|own| Some((own, same(own)?)))
            .collect();
        let times = problem.control.coefficient_times();
        let mut out = vec![0.0; n * times.len()];
        for (out, t) in out.chunks_mut(n.max(1)).zip(times) {
            let k = ((t / earlier.grid.step).round() as usize).min(last);
            let at: Vec<f64> = (0..n_earlier)
                .map(|i| (earlier.control).value(k, |j| self.coefficients[j * n_earlier + i]))
                .collect();
            for (own, other) in &pairs {
                own.write(other.value(&at), out);
            }
        }
        out
    }
}
