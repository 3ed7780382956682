//! What is said of all plants from the count of some.

use softarm::verify::doubt::{Margins, at_most};

/// The bound of Clopper and Pearson in closed form where none, or all but one, of the plants leave a limit; where some do, the value of their
/// tables; and where all do, everything.
#[test]
fn bounds_on_parts_are_those_of_clopper_and_pearson() {
    for n in [1, 20, 100, 10_000] {
        let none = 1.0 - 0.05f64.powf(1.0 / n as f64);
        assert!((at_most(0, n) - none).abs() < 1e-9, "{n}");
        let all_but_one = 0.95f64.powf(1.0 / n as f64);
        assert!((at_most(n - 1, n) - all_but_one).abs() < 1e-9, "{n}");
        assert_eq!(at_most(n, n), 1.0);
    }
    assert!((at_most(1, 10) - 0.394163).abs() < 1e-6);
    assert!((at_most(5, 100) - 0.102253).abs() < 1e-6);
}

/// Of 19 plants none may leave a limit that a twentieth of all may leave, and fewer plants cannot tell.
#[test]
fn quantiles_need_plants() {
    assert_eq!(Margins::most_violating(0.05, 18), None);
    assert_eq!(Margins::most_violating(0.05, 19), Some(0));
    assert_eq!(Margins::most_violating(0.1, 200), Some(19));
}
