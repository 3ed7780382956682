//! The deviation of an axis from a direction against rotation vectors, and its derivatives against differences.

use nalgebra::{Matrix3, Vector3};
use softarm::mechanics::differences::slope;
use softarm::mechanics::direction::{Deviation, NEAREST_TO_ANTIPODE, across};
use softarm::mechanics::rotation::{exp, log};

/// Rotations that turn the axis by angles from zero to near a half turn away from a direction.
fn cases() -> Vec<(Vector3<f64>, Matrix3<f64>)> {
    let directions = [
        Vector3::z(),
        -Vector3::z(),
        Vector3::new(-0.355, 0.0, -0.935).normalize(),
        Vector3::new(0.3, -0.8, 0.5).normalize(),
    ];
    let angles = [0.0, 1e-9, 1e-4, 0.3, 0.45, 0.46, 1.2, 2.0, 3.0];
    let mut out = Vec::new();
    for (at, d) in directions.iter().enumerate() {
        for (i, angle) in angles.iter().enumerate() {
            let [a, b] = across(d);
            let about = a * (i as f64).cos() + b * (i as f64).sin();
            let frame = Matrix3::from_columns(&[a, b, *d]);
            let roll = exp(&(Vector3::z() * (0.7 * (at + i) as f64)));
            out.push((*d, exp(&(about * *angle)) * frame * roll));
        }
    }
    out
}

/// The axes across a direction are a right-handed frame with it.
#[test]
fn axes_across_are_a_frame() {
    for (d, _) in cases() {
        let [a, b] = across(&d);
        let frame = Matrix3::from_columns(&[a, b, d]);
        assert!((frame.determinant() - 1.0).abs() < 1e-14);
        assert!((frame.tr_mul(&frame) - Matrix3::identity()).amax() < 1e-14);
    }
}

/// The deviation is the rotation vector of the smallest rotation from the direction to the axis, turned back by a quarter turn about the
/// direction; its norm is the angle, and no roll changes it.
#[test]
fn deviation_is_the_smallest_rotation() {
    for (d, r) in cases() {
        let own = Deviation::of(&d, &r);
        let t: Vector3<f64> = r.column(2).into();
        let sum = t + d;
        // The half turn about the middle of two directions after that about the first one.
        let half = |axis: &Vector3<f64>| {
            axis * axis.transpose() * (2.0 / axis.norm_squared()) - Matrix3::identity()
        };
        let turn = log(&(half(&sum) * half(&d)));
        let [a, b] = across(&d);
        let expected = [b.dot(&turn), -a.dot(&turn)];
        for (found, expected) in own.value().iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
        assert!((own.angle() - turn.norm()).abs() < 1e-12);
        let rolled = Deviation::of(&d, &(r * exp(&(Vector3::z() * 1.3))));
        assert!((rolled.value()[0] - own.value()[0]).abs() < 1e-12);
        assert!((rolled.value()[1] - own.value()[1]).abs() < 1e-12);
    }
}

/// First and second derivatives are those of central differences of fourth order, with an error that grows as powers of the inverse
/// sine toward the antipode.
#[test]
fn derivatives_are_those_of_differences() {
    let step = 1e-3;
    let central = |f: &dyn Fn(f64) -> f64, step: f64| {
        slope([f(step), f(-step)], [f(2.0 * step), f(-2.0 * step)], step)
    };
    for (d, r) in cases() {
        let own = Deviation::of(&d, &r);
        let y = [0.7, -1.3];
        let zeta = [
            Vector3::x(),
            Vector3::y(),
            Vector3::z(),
            Vector3::new(0.4, -0.5, 0.8),
        ];
        // The fifth derivative grows as the fifth power.
        let far = if own.angle() > 1.6 {
            own.angle().sin().powi(-5)
        } else {
            1.0
        };
        let tolerance = 1e-10 * far;
        for zeta in zeta {
            let at = |s: f64| Deviation::of(&d, &(r * exp(&(zeta * s))));
            for i in [0, 1] {
                let expected = central(&|s| at(s).value()[i], step);
                let found = own.gradients()[i].dot(&zeta);
                assert!((found - expected).abs() < tolerance, "{found} {expected}");
            }
            let along = |s: f64| {
                let [a, b] = at(s).gradients();
                (a * y[0] + b * y[1]).dot(&zeta)
            };
            let expected = central(&along, step);
            let found = zeta.dot(&(own.curvature(y) * zeta));
            let tolerance = 10.0 * tolerance * far.powf(0.2);
            assert!((found - expected).abs() < tolerance, "{found} {expected}");
            // The derivative of the gradient of half the square, without symmetry.
            let (_, own) = own.of_half_square();
            for axis in 0..3 {
                let gradient = |s: f64| at(s).of_half_square().0[axis];
                let expected = central(&gradient, step);
                let found = (own * zeta)[axis];
                assert!(
                    (found - expected).abs() < 4.0 * tolerance,
                    "{found} {expected}"
                );
            }
        }
    }
}

/// At the antipode, the deviation is nearly half a turn and its derivatives are numbers.
#[test]
fn antipode_is_far() {
    let d = Vector3::new(0.6, 0.0, 0.8);
    let [a, b] = across(&d);
    let own = Deviation::of(&d, &Matrix3::from_columns(&[a, -b, -d]));
    assert!((own.angle() - std::f64::consts::PI).abs() < 2.0 * NEAREST_TO_ANTIPODE);
    assert!(
        own.gradients()
            .iter()
            .all(|g| g.iter().all(|x| x.is_finite()))
    );
    assert!(own.curvature([1.0, 1.0]).iter().all(|x| x.is_finite()));
}
