//! The items of a limit that a controller watches.

use softarm::mpc::limits::maxima;

/// The greatest local maxima, ends and plateaus among them.
#[test]
fn maxima_are_local() {
    let of = |values: &[f64]| maxima(values.len(), |i| values[i]);
    assert_eq!(of(&[1.0, 0.0, 3.0, 2.0, 2.5]), [Some(2), Some(4)]);
    assert_eq!(of(&[5.0, 4.0, 3.0]), [Some(0), None]);
    assert_eq!(of(&[0.0, 2.0, 2.0, 1.0]), [Some(2), None]);
    assert_eq!(of(&[7.0]), [Some(0), None]);
}
