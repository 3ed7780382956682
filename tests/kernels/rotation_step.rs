//! The rotational equation of a step, all the way to the limit of its solvability.

use cosserat::rotation_step::solve_rotation;
use nalgebra::Vector3;
use proptest::prelude::*;

fn residual(j: &Vector3<f64>, f: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    let jf = j.component_mul(f);
    (jf + 0.5 * f.cross(&jf) - b * (1.0 + 0.25 * f.norm_squared())).norm()
}

proptest! {
    /// The rotational equation is solved to rounding all the way to the solvability limit, axisymmetric and general
    /// inertia, over twenty orders of magnitude, on the branch below a quarter turn.
    #[test]
    fn rotation_is_solved(
        j in proptest::array::uniform3(0.1..10.0f64),
        direction in proptest::array::uniform3(-1.0..1.0f64),
        level in prop_oneof![Just(0.0), Just(1e-9), 0.0..0.5f64, 0.5..0.999f64],
        exponent in -10i32..10,
        axisymmetric in any::<bool>(),
    ) {
        let mut j = Vector3::from(j);
        if axisymmetric { j.y = j.x; }
        j *= 10f64.powi(exponent);
        let direction = Vector3::from(direction);
        prop_assume!(direction.norm() > 1e-3);
        let b = direction.normalize() * (level * j.min());
        let f = solve_rotation(&j, &b).expect("inside the limit");
        prop_assert!(residual(&j, &f, &b) <= 1e-13 * j.max());
        prop_assert!(f.norm() < 2.0 + 1e-6);
    }
}

/// Outside the limit, and for NaN, there is no solution rather than a wrong one.
#[test]
fn rotation_beyond_a_quarter_turn_is_refused() {
    let j = Vector3::new(1.0, 1.0, 2.0);
    assert!(solve_rotation(&j, &Vector3::new(1.0, 0.0, 0.0)).is_none());
    assert!(solve_rotation(&j, &Vector3::new(f64::NAN, 0.0, 0.0)).is_none());
    assert!(
        solve_rotation(
            &Vector3::new(1.0, 1.5, 2.0),
            &Vector3::new(0.0, f64::INFINITY, 0.0)
        )
        .is_none()
    );
}
