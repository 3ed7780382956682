//! Comparison of numbers of which one may not be a number.

/// Returns the larger number; NaN if either is.
pub(super) fn worse(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() {
        f64::NAN
    } else {
        a.max(b)
    }
}
