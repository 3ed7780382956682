//! Variables that are led back into balls.

use softarm::sqp::ConvexSet;
use softarm::sqp::balls::into_balls;

/// A ball of differences: the difference ends on the sphere in its old direction, the mean of the two stays.
#[test]
fn differences_are_shortened_to_the_sphere() {
    let rows = (0..2).map(|i| vec![(i + 2, 1.0), (i, -1.0)]).collect();
    let set = ConvexSet::Ball { rows, radius: 1.0 };
    let v = into_balls(vec![0.0, 0.0, 3.0, 4.0], std::iter::once(&set));
    let expected = [1.2, 1.6, 1.8, 2.4];
    for (found, expected) in v.iter().zip(expected) {
        assert!((found - expected).abs() < 1e-15);
    }
    assert!(set.violation(&v).abs() < 1e-15);
}
