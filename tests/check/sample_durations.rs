//! Durations of samples in the check against those of the solver.

use proptest::prelude::*;
use softarm::control::path::durations;
use softarm::verify::samples::trapezoidal;

proptest! {
    /// Any ascending nodes: the durations are those of the solver, and add up to the time between the first and the last.
    #[test]
    fn durations_equal_those_of_the_solver(gaps in prop::collection::vec(1..50usize, 0..20), step in 1e-6..1.0f64) {
        let mut nodes = vec![3];
        for gap in gaps {
            nodes.push(nodes[nodes.len() - 1] + gap);
        }
        let (ours, theirs) = (trapezoidal(&nodes, step), durations(&nodes, step));
        let end = step * (nodes[nodes.len() - 1] - 3) as f64;
        for ((k, a), (other, b)) in ours.iter().zip(&theirs) {
            prop_assert!(k == other && (a - b).abs() <= 1e-14 * end);
        }
        let sum: f64 = ours.iter().map(|(_, durations)| durations).sum();
        prop_assert!((sum - end).abs() <= 1e-13 * end);
    }
}
