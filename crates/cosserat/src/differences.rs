//! Central differences, for functions without an analytic derivative.

use std::ops::{Mul, Sub};

/// Returns `f'(0) + O(step⁴)` from `f(step)`, `f(-step)` and `f(2 step)`, `f(-2 step)`.
pub fn slope<T>(near: [T; 2], far: [T; 2], step: f64) -> T
where
    T: Sub<Output = T> + Mul<f64, Output = T>,
{
    let difference = |[plus, minus]: [T; 2]| plus - minus;
    difference(near) * (2.0 / (3.0 * step)) - difference(far) * (1.0 / (12.0 * step))
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
