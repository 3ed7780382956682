//! Equilibria that lose deviations slowly enough for a short stay.

use nalgebra::Vector3;
use softarm::control::{CannotHold, Held, Holding, holding};
use softarm::mechanics::Material;
use softarm::task::staying::judged;
use softarm::task::{Arm, Discretization, Staying, Task};

/// An equilibrium that only a body moment makes unstable is held if a deviation grows by no more than the stay leaves room for, a
/// factor of two, and not held if it grows by more; an equilibrium without a positive stiffness is not held, however slowly deviations
/// grow.
#[test]
fn slow_growth_is_held_over_a_short_stay() {
    let silicone = Material::isotropic(1e6, 0.5, 1000.0);
    let arm = Arm::cylinder(&silicone, 1.0, 0.05);
    let task = Task::reach(Vector3::new(0.05, 0.0, 0.99), 1.0, 40.0);
    let problem = task
        .discretize(&arm, &Discretization::with_elements(4))
        .unwrap();
    let problem = problem.discrete;
    // A force alone holds no tip but on a surface: the nearest one that it holds.
    let held = match holding(&problem).unwrap() {
        Holding::Held(held) => held,
        Holding::CannotBeHeld {
            nearest: Some((held, _)),
            ..
        } => held,
        other => panic!("{other:?}"),
    };
    let seconds = 0.5;
    let staying = Staying {
        seconds: Some(seconds),
        distance: None,
    };
    let verdict = |rate: f64, square: f64| {
        let unstable = Held {
            is_stable: false,
            growth_rate: Some(rate),
            least_squared_frequency: square,
            ..(*held).clone()
        };
        let found = Holding::CannotBeHeld {
            why: CannotHold::Unstable(Box::new(unstable)),
            nearest: None,
        };
        judged(found, &problem, staying, arm.length).is_ok()
    };
    let square = held.least_squared_frequency;
    let doubles = 2.0_f64.ln() / seconds;
    assert!(verdict(0.99 * doubles, square) && !verdict(1.01 * doubles, square));
    assert!(!verdict(0.01 * doubles, -square));
}
