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
