//! The order of central differences.

use softarm::mechanics::differences::slope;

/// Slopes are exact for polynomials up to the fourth degree; for the fifth the error is `4 step⁴` times its coefficient.
#[test]
fn slopes_are_of_fourth_order() {
    let step = 0.1_f64;
    for degree in 0..=5 {
        let f = |x: f64| 1.0 + 3.0 * x.powi(degree);
        let found = slope([f(step), f(-step)], [f(2.0 * step), f(-2.0 * step)], step);
        let exact = match degree {
            1 => 3.0,
            5 => -12.0 * step.powi(4),
            _ => 0.0,
        };
        assert!((found - exact).abs() < 1e-14, "{degree}: {found}");
    }
}
