//! Momenta that arrive at a time node, where a stress depends on both ends of an interval.
//!
//! The tiles carry them without the stiffness of that stress where it arrives, which the next kick adds to that of the elements. A form
//! of such a momentum has it among the configurations. What a change of the tension of a winch adds is part of the drift.

use super::Task;
use crate::linearization::Motion;
use cosserat::configuration::Trajectory;
use cosserat::element::ElementStiffness;
use cosserat::forms::NODE_COMPONENTS;
use cosserat::implicit::IntervalWeights;
use cosserat::rod::Rod;
use cosserat::signal::interval_effort;
use cosserat::time::TimeScheme;

/// Components of the configuration with their coefficients: twelve of either element beside a node.
pub(super) type Terms = [(usize, f64); 24];

/// Returns the momentum in row `component` (6..12) of a node at a time node, apart from the part that a tile carries: a sum over rows of
/// the tile, in the order of [`NODE_COMPONENTS`]. `None` if it is zero: before the first kick and after the last, of held nodes, and of
/// other steps.
pub(super) fn arriving_terms(
    task: &Task,
    k: usize,
    node: usize,
    component: usize,
) -> Option<Terms> {
    let (motion, rod) = (task.motion, task.motion.rod);
    let inside = (1..motion.grid.n_steps).contains(&k);
    if component < 6 || node < rod.first_free_node() || !inside {
        return None;
    }
    IntervalWeights::of(rod, motion.grid.step)?;
    let mut terms = [(0, 0.0); 24];
    let right = (node < rod.n_elements()).then_some((node, 0));
    let left = node.checked_sub(1).map(|q| (q, 1));
    for (slot, (q, end)) in right.into_iter().chain(left).enumerate() {
        let stiffness = arriving_stiffness(motion, task.trajectory, k - 1, q);
        // An element pulls its end a with +F and its end b with -F, and turns them with -M.
        let (row, sign) = match component {
            6..9 => (component - 6, if end == 0 { 1.0 } else { -1.0 }),
            _ => (component - 9 + 3 + 3 * end, -1.0),
        };
        for (at, term) in terms[12 * slot..][..12].iter_mut().enumerate() {
            let (part, axis) = (at / 3, at % 3);
            // δx_a, δx_b, ζ_a, ζ_b
            let (of, component, column, factor) = [
                (q, axis, axis, -1.0),
                (q + 1, axis, axis, 1.0),
                (q, 3 + axis, 3 + axis, 1.0),
                (q + 1, 3 + axis, 6 + axis, 1.0),
            ][part];
            let coefficient = sign * factor * stiffness[(row, column)];
            *term = (of * NODE_COMPONENTS + component, coefficient);
        }
    }
    Some(terms)
}

/// `∂(B_{k+1}ᵀ σ)` along the configuration at `k + 1`, over `(δx_b - δx_a, ζ_a, ζ_b)` of an element and the interval from `k` to `k + 1`,
/// with the weight of the impulse. Zero where no stress depends on both ends.
fn arriving_stiffness(
    motion: &Motion,
    trajectory: &Trajectory,
    k: usize,
    q: usize,
) -> ElementStiffness {
    let Motion { rod, grid, .. } = *motion;
    let Some(weights) = IntervalWeights::of(rod, grid.step) else {
        return ElementStiffness::zeros();
    };
    let element = &rod.elements[q];
    let poses = [k, k + 1]
        .map(|k| Rod::element_pose(q, trajectory.positions_at(k), trajectory.rotations_at(k)));
    let [start, end] = (poses.each_ref()).map(|pose| rod.strain_rule.strain(element.length, pose));
    let stress = weights.stress(element, &start, &end);
    let arriving = 0.5 * grid.step * motion.arriving_impulse();
    let mut stiffness = element.stiffness_under(rod.strain_rule, &poses[1], &stress, weights.end);
    if rod.scheme == TimeScheme::Implicit && !rod.actuators.is_empty() {
        let mut state = rod.actuators.effort_state();
        if rod.actuators.follow_shape() {
            let ends = [k, k + 1].map(|k| trajectory.poses_at(k));
            rod.write_interval_effort_state(ends, grid.step, &mut state);
        }
        let effort = |line: usize| {
            let actuator = rod.actuators.actuator_of(line);
            let input = interval_effort(&rod.actuators, &grid, motion.control, k, actuator);
            let law = rod.actuators.law(actuator, input, &state);
            law.effort * rod.actuators.share(line, &state)
        };
        let active = rod.interval_active_stiffness(q, &poses, &effort);
        stiffness += active.map_or_else(ElementStiffness::zeros, |[_, _, end]| end);
    }
    stiffness * arriving
}
