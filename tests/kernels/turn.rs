//! The rotation of nodes in lanes against the scalar solver.

use cosserat::rotation::cay;
use cosserat::rotation_step::solve_rotation;
use cosserat::vector::{Lanes, Vec3};
use integrator::lanes::turn::{Gyration, TURN_LIMIT};
use nalgebra::Vector3;
use proptest::prelude::*;
use pulp::Scalar;

fn one(value: f64) -> Lanes<Scalar> {
    Lanes::splat(Scalar, value)
}

fn vector(v: &Vector3<f64>) -> Vec3<Scalar> {
    Vec3 {
        x: one(v.x),
        y: one(v.y),
        z: one(v.z),
    }
}

fn plain(v: Vec3<Scalar>) -> Vector3<f64> {
    Vector3::new(v.x.value, v.y.value, v.z.value)
}

proptest! {
    /// Every rotation of at most half the limit is within the lanes' range, and agrees with the scalar solver to rounding: turn,
    /// momentum, unit length; for flat, isotropic and elongated inertia.
    #[test]
    fn turn_agrees_with_the_scalar_solver(
        direction in proptest::array::uniform3(-1.0..1.0f64),
        size in prop_oneof![Just(0.0), Just(1e-9), 0.0..0.5f64, Just(0.5)],
        flatness in prop_oneof![Just(1.0), Just(2.0), 1.0..30.0f64],
        exponent in -8i32..8,
    ) {
        let direction = Vector3::from(direction);
        prop_assume!(direction.norm() > 1e-3);
        let h = 1e-3;
        let a = 10f64.powi(exponent);
        let inertia = Vector3::new(a, a, a * flatness);
        let g = direction.normalize() * (0.999_999 * size * a / h);
        let turn = Gyration {
            lateral: one(h / a),
            axial: one(h / inertia.z),
            excess: one((inertia.z - a) / a),
            precession: one(4.0 * (inertia.z - a) / h),
        }
        .turn(vector(&g));
        prop_assert!(turn.level.value <= TURN_LIMIT);
        let f = solve_rotation(&inertia, &(g * h)).expect("inside the limit");
        let w = 1.0 / (1.0 + 0.25 * f.norm_squared()).sqrt();
        let v = plain(turn.rotation.v);
        prop_assert!((turn.rotation.w.value - w).abs() < 1e-15);
        prop_assert!((v - f * (0.5 * w)).norm() <= 2e-15 * v.norm(), "{v} {f}");
        prop_assert!((plain(turn.momentum) - cay(&f).transpose() * g).norm() <= 4e-15 * g.norm());
    }
}
