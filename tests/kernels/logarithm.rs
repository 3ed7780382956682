//! The logarithm of a rotation in lanes, at every angle.

use cosserat::logarithm::logarithm;
use cosserat::rotation::InverseTangentCoefficients;
use cosserat::vector::{Lanes, Quaternion, Vec3};
use proptest::prelude::*;
use pulp::Scalar;

proptest! {
    /// Angle and coefficients for every angle below half a turn and both signs of the quaternion. Cancellation in the far `c` is below
    /// a few roundings divided by the square of the angle (at least 0.255); the slope has three times its error, divided by that
    /// square.
    #[test]
    fn logarithm_is_accurate(
        angle in prop_oneof![Just(0.0), Just(1e-9), 0.0..0.6f64, 0.5..0.51f64, 0.0..3.1f64],
        flip in any::<bool>(),
    ) {
        let sign = if flip { -1.0 } else { 1.0 };
        let one = |value: f64| Lanes::splat(Scalar, value * sign);
        let (sine, cosine) = (0.5 * angle).sin_cos();
        let rotation = Quaternion {
            w: one(cosine),
            v: Vec3 { x: one(0.6 * sine), y: one(0.0), z: one(-0.8 * sine) },
        };
        let log = logarithm(rotation);
        let exact = InverseTangentCoefficients::at(angle * angle);
        let error = |value: Lanes<Scalar>, exact: f64| (value.value - exact).abs();
        prop_assert!(error(log.psi.x, 0.6 * angle) <= 2e-15 * angle);
        prop_assert!(error(log.psi.z, -0.8 * angle) <= 2e-15 * angle);
        prop_assert!(error(log.angle_squared, angle * angle) <= 4e-15 * angle * angle);
        prop_assert!(error(log.c, exact.value) <= 3e-15);
        // Five times the error of the slope, divided by the square once more.
        prop_assert!(error(log.bend, exact.bend) <= 7.1e-13);
        prop_assert!(error(log.slope, exact.slope) <= 3.6e-14, "{} {}", log.slope.value, exact.slope);
    }
}
