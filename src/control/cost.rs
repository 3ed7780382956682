//! The part of the objective that depends on the states: least squares of rows, sampled over the horizon.

use nalgebra::{Matrix3, SVector, Vector3};

use super::path::{
    RodView, RowCurvature, RowGradient, along, at, element_curvature, element_form, term_curvature,
    turn_curvature,
};
use super::problem::OptimalControlProblem;
use crate::mechanics::element::IntervalStress;
use crate::mechanics::rotation::log_tangent;
use crate::mechanics::{Rod, StrainRule};

/// A residual `r` of the cost `½ r²`, with its gradient.
#[derive(Clone, Debug)]
pub struct CostRow {
    /// `r`, with the square root of the weight as a factor.
    pub residual: f64,
    /// `δr`
    pub gradient: RowGradient,
}

/// Returns the time nodes at which costs on states are sampled, and the duration that each represents, s: the trapezoidal rule over a
/// subset of the time nodes that is as even as possible, both ends included.
#[must_use]
pub fn sample_times(problem: &OptimalControlProblem) -> Vec<(usize, f64)> {
    let objective = &problem.objective;
    if !objective.sees_states() {
        return Vec::new();
    }
    let n = problem.grid.n_steps;
    let intervals = objective.samples.clamp(1, n);
    let node = |i: usize| (2 * i * n + intervals) / (2 * intervals);
    let nodes: Vec<usize> = (0..=intervals).map(node).collect();
    durations(&nodes, problem.grid.step)
}

/// Returns the durations that ascending time nodes represent by the trapezoidal rule, s.
#[must_use]
pub fn durations(nodes: &[usize], step: f64) -> Vec<(usize, f64)> {
    let last = nodes.len().saturating_sub(1);
    nodes
        .iter()
        .enumerate()
        .map(|(i, &k)| {
            let before = nodes[i.saturating_sub(1)];
            let after = nodes[(i + 1).min(last)];
            (k, 0.5 * (after - before) as f64 * step)
        })
        .collect()
}

/// Returns the residuals at one sample that represents `duration` seconds.
#[must_use]
pub fn cost_rows(
    problem: &OptimalControlProblem,
    rod_view: &RodView,
    k: usize,
    duration: f64,
) -> Vec<CostRow> {
    let mut rows = Vec::new();
    let t = rod_view.grid.time(k);
    let tracked = &problem.objective.tracking;
    for tracking in tracked.iter().filter(|tracking| tracking.counts(t)) {
        let node = tracking.node;
        let mut add = |from: usize, factor: f64, off: &Vector3<f64>, slope: &Matrix3<f64>| {
            rows.extend((0..3).map(|axis| CostRow {
                residual: factor * off[axis],
                gradient: at(
                    k,
                    along(node, from, &(slope.column(axis) * factor)).collect(),
                ),
            }));
        };
        if let Some(place) = tracking.position(t) {
            let off = rod_view.trajectory.positions_at(k)[node] - place;
            let factor = (tracking.weight * duration).sqrt() / problem.rod.scales.length;
            add(0, factor, &off, &Matrix3::identity());
        }
        if let Some(psi) = tracking.turn(t, &rod_view.trajectory.rotations_at(k)[node]) {
            // δψ = Sᵀ ζ: row i of Sᵀ is column i of S.
            let slope = log_tangent(&psi);
            add(
                3,
                (tracking.rotation_weight * duration).sqrt(),
                &psi,
                &slope,
            );
        }
    }
    for cost in &problem.objective.terms {
        let factor = (cost.weight * duration).sqrt();
        let view = rod_view.view(k);
        rows.extend((0..cost.term.n_values(&problem.rod)).map(|item| {
            let mut form = cost.term.gradient(&view, item).terms;
            for part in &mut form {
                part.coefficient *= factor;
            }
            CostRow {
                residual: factor * cost.term.value(&view, item),
                gradient: at(k, form),
            }
        }));
    }
    if problem.objective.energy > 0.0 {
        for q in 0..problem.rod.n_elements() {
            energy_rows(problem, rod_view, k, q, duration, &mut rows);
        }
    }
    rows
}

/// Returns the residuals of tracked velocities between two successive samples, by the mean velocity: `sqrt(w Δt) T/L ((x_b - x_a) - (x*_b -
/// x*_a))/Δt`. They are linear in the states.
#[must_use]
pub fn speed_rows(
    problem: &OptimalControlProblem,
    rod_view: &RodView,
    [from, to]: [usize; 2],
) -> Vec<CostRow> {
    let times = [from, to].map(|k| rod_view.grid.time(k));
    let [between, unit] = [
        times[1] - times[0],
        problem.rod.scales.time / problem.rod.scales.length,
    ];
    let mut rows = Vec::new();
    for tracking in &problem.objective.tracking {
        if tracking.speed_weight == 0.0 || !tracking.counts(times[0]) {
            continue;
        }
        let [a, b] = [from, to].map(|k| rod_view.trajectory.positions_at(k)[tracking.node]);
        let off = (b - a) / between - tracking.velocity(times);
        let factor = (tracking.speed_weight * between).sqrt() * unit;
        rows.extend((0..3).map(|axis| {
            let along_axis = |k: usize, slope: f64| {
                let direction = Vector3::ith(axis, slope);
                at(k, along(tracking.node, 0, &direction).collect())
            };
            CostRow {
                residual: factor * off[axis],
                gradient: [
                    along_axis(from, -factor / between),
                    along_axis(to, factor / between),
                ]
                .concat(),
            }
        }));
    }
    rows
}

/// Returns the weight of the elastic energy at a sample, 1/J.
fn energy_weight(problem: &OptimalControlProblem, duration: f64) -> f64 {
    problem.objective.energy * duration / problem.rod.scales.moment
}

/// Returns residuals `r` of one element for which `½ Σ r²` is its weighted energy.
fn energy_rows(
    problem: &OptimalControlProblem,
    rod_view: &RodView,
    k: usize,
    q: usize,
    duration: f64,
    rows: &mut Vec<CostRow>,
) {
    let rod = &problem.rod;
    let element = &rod.elements[q];
    let (x, r) = (
        rod_view.trajectory.positions_at(k),
        rod_view.trajectory.rotations_at(k),
    );
    let pose = Rod::element_pose(q, x, r);
    let (strain, slope) = rod.strain_rule.strain_derivative(element.length, &pose);
    let weight = energy_weight(problem, duration) * element.length;
    let mut add = |from: usize, stiffness: &Vector3<f64>, strain: &Vector3<f64>, weight: f64| {
        for axis in 0..3 {
            let factor = (weight * stiffness[axis]).sqrt();
            let w: SVector<f64, 9> = slope.row(from + axis).transpose() * factor;
            rows.push(CostRow {
                residual: factor * strain[axis],
                gradient: at(k, element_form(q, &w)),
            });
        }
    };
    // The helical rule has the same strain at both ends of an element.
    let ends = match rod.strain_rule {
        StrainRule::Helical => 1,
        StrainRule::Trapezoidal => 2,
    };
    for end in 0..ends {
        let linear = strain.linear[end] - element.rest.linear[end];
        add(
            3 * end,
            &element.linear_stiffness,
            &linear,
            weight / ends as f64,
        );
    }
    let angular = strain.curvature - element.rest.curvature;
    add(6, &element.angular_stiffness, &angular, weight);
}

/// Returns `Σ r ∇²r` at one sample: of the energy, of tracked orientations, and of user-defined terms.
#[must_use]
pub fn cost_curvature(
    problem: &OptimalControlProblem,
    rod_view: &RodView,
    k: usize,
    duration: f64,
) -> Vec<RowCurvature> {
    let rod = &problem.rod;
    let mut bent = Vec::new();
    let t = rod_view.grid.time(k);
    let tracked = &problem.objective.tracking;
    for tracking in tracked.iter().filter(|tracking| tracking.counts(t)) {
        let r = &rod_view.trajectory.rotations_at(k)[tracking.node];
        if let Some(psi) = tracking.turn(t, r) {
            let weighted = psi * (tracking.rotation_weight * duration);
            bent.push(turn_curvature(k, tracking.node, &psi, &weighted));
        }
    }
    for cost in &problem.objective.terms {
        for item in 0..cost.term.n_values(rod) {
            let value = cost.term.value(&rod_view.view(k), item);
            let factor = cost.weight * duration * value;
            bent.push(term_curvature(&cost.term, rod_view, k, item, factor));
        }
    }
    if !(problem.objective.energy > 0.0) {
        return bent;
    }
    let weight = energy_weight(problem, duration);
    let (x, r) = (
        rod_view.trajectory.positions_at(k),
        rod_view.trajectory.rotations_at(k),
    );
    bent.extend((0..rod.n_elements()).map(|q| {
        let element = &rod.elements[q];
        let pose = Rod::element_pose(q, x, r);
        let strain = rod.strain_rule.strain(element.length, &pose);
        let stress: IntervalStress = element.interval_stress([&strain, &strain], [weight, 0.0]);
        let own = element.stiffness_under(rod.strain_rule, &pose, &stress, 0.0);
        element_curvature(k, q, &own)
    }));
    bent
}
