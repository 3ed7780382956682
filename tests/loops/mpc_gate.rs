//! The refusal of impossible signals by an estimator.

use nalgebra::Vector3;
use softarm::mpc::estimator::gate::Gate;
use softarm::mpc::{Measurement, Quantity, Reading, Signal};

/// Numbers of refused signals for successive measurements of five signals with these squares.
fn judged(squares: &[[f64; 5]]) -> Vec<usize> {
    let measurement = Measurement {
        time: 0.0,
        signals: (1..=5)
            .map(|place| Signal {
                place: f64::from(place) / 5.0,
                offset: [0.0; 2],
                reading: Reading::Vector(Quantity::Position, Vector3::zeros()),
                sigma: 1e-3,
            })
            .collect(),
    };
    let mut gate = Gate::default();
    (squares.iter())
        .map(|squares| gate.judge(&measurement, squares.iter().copied()))
        .collect()
}

/// A single signal that is off is refused three times; if most of them are off, those that are as far off as the others are used.
#[test]
fn outliers_are_refused_and_wrong_models_are_not() {
    let right = [3.0; 5];
    let one = [3.0, 3.0, 3.0, 3.0, 1e4];
    let mut squares = vec![right; 10];
    squares.extend([one, one, one, one, right, one]);
    assert_eq!(judged(&squares)[10..], [1, 1, 1, 0, 0, 1]);
    // All signals are ten times farther off than expected, and one of them far more.
    let off = [240.0; 5];
    let mut squares = vec![off; 10];
    let one = [240.0, 240.0, 240.0, 240.0, 1e5];
    squares.extend([one, off]);
    let found = judged(&squares);
    assert_eq!(found[..4], [5, 5, 5, 0]);
    assert_eq!(found[6..], [0, 0, 0, 0, 1, 0]);
}
