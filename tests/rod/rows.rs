//! Functions that rows of a table define: means, sides and steps.

use softarm::mechanics::rows::{mean, sides, steps};

/// A ramp, a step and constant ends have the means of their areas, and a step has two sides.
#[test]
fn rows_have_means_and_sides() {
    let rows = [(0.2, 1.0), (0.4, 3.0), (0.4, -1.0), (0.8, -1.0)];
    let close = |a: Option<f64>, b: f64| assert!((a.unwrap() - b).abs() < 1e-14, "{a:?} {b}");
    close(mean(&rows, 0.0, 0.1), 1.0);
    close(mean(&rows, 0.2, 0.4), 2.0);
    close(mean(&rows, 0.0, 1.0), 0.2 + 0.4 - 0.6);
    for (at, expected) in [
        (0.4, [3.0, -1.0]),
        (0.3, [2.0; 2]),
        (0.0, [1.0; 2]),
        (1.0, [-1.0; 2]),
    ] {
        let found = sides(&rows, at).unwrap();
        (0..2).for_each(|side| close(Some(found[side]), expected[side]));
    }
    assert_eq!(steps(&rows).collect::<Vec<_>>(), [0.4]);
    assert_eq!(mean::<f64>(&[], 0.0, 1.0), None);
}
