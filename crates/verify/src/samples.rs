//! Integrals over time by the trapezoidal rule on the samples.

use control::{OptimalControlProblem, PathConstraint};

/// Returns the weights of the trapezoidal rule: half of every interval between neighboring time nodes for either of its ends, s.
#[must_use]
pub fn trapezoidal(nodes: &[usize], step: f64) -> Vec<(usize, f64)> {
    let mut out: Vec<(usize, f64)> = nodes.iter().map(|&k| (k, 0.0)).collect();
    for i in 1..nodes.len() {
        let half = 0.5 * step * (nodes[i] - nodes[i - 1]) as f64;
        out[i - 1].1 += half;
        out[i].1 += half;
    }
    out
}

/// Returns the time nodes at which costs on states are sampled, as even as whole steps allow, with the duration that each represents, s.
pub(super) fn of_costs(problem: &OptimalControlProblem) -> Vec<(usize, f64)> {
    let objective = &problem.objective;
    if !objective.sees_states() {
        return Vec::new();
    }
    let n = problem.grid.n_steps;
    let intervals = objective.samples.clamp(1, n);
    let nodes: Vec<usize> = (0..=intervals)
        .map(|i| (i as f64 * n as f64 / intervals as f64).round() as usize)
        .collect();
    trapezoidal(&nodes, problem.grid.step)
}

/// Returns the time nodes of a path constraint, with the duration that each represents, s; a single one represents one second.
pub(super) fn of_path(constraint: &PathConstraint, step: f64) -> Vec<(usize, f64)> {
    match constraint.time_nodes.as_slice() {
        [k] => vec![(*k, 1.0)],
        nodes => trapezoidal(nodes, step),
    }
}
