//! The drag of a node: what it takes away, the step that is solved for, and derivatives against differences.

use nalgebra::{Matrix3, SMatrix, Vector3};
use softarm::mechanics::resistance::Resistance;
use softarm::mechanics::rotation::exp;

const LAW: Resistance = Resistance {
    normal: 0.7,
    tangential: 0.2,
};

fn cases() -> Vec<(Vector3<f64>, Matrix3<f64>)> {
    let r = exp(&Vector3::new(0.4, -0.9, 0.3));
    let t = r.column(2).into_owned();
    vec![
        (Vector3::new(0.3, -0.2, 0.9), r),
        (
            Vector3::new(-3.0, 2.0, 0.1),
            exp(&Vector3::new(2.0, 0.1, -1.0)),
        ),
        (t * 0.4, r),
        (Vector3::zeros(), r),
    ]
}

/// The force opposes the motion, and has no part in the other direction where the velocity has none.
#[test]
fn resistance_takes_energy_away() {
    for (v, r) in cases() {
        let t = r.column(2).into_owned();
        assert!(LAW.force(&v, &t).dot(&v) <= 0.0);
    }
    let z = Vector3::z();
    let x = Vector3::x();
    for (of, c) in [(z, LAW.tangential), (x, LAW.normal)] {
        assert!((LAW.force(&(of * -3.0), &z) - of * (9.0 * c)).norm() < 1e-14);
    }
}

/// The closed form solves its equation, from no weight to one that stops the node at once, and never turns a motion around.
#[test]
fn slowed_momentum_solves_the_equation() {
    for (p, r) in cases() {
        let t = r.column(2).into_owned();
        for weight in [0.0, 1e-9, 1.0, 1e9] {
            let mass = 0.3;
            let after = LAW.slowed(&p, &t, mass, weight);
            let back = after - LAW.force(&(after / mass), &t) * weight;
            // A heavy resistance magnifies the rounding of a part that is zero to the square root.
            assert!((back - p).norm() <= 1e-10 * p.norm(), "{weight}");
            assert!(after.dot(&p) >= 0.0 && after.norm() <= p.norm() * (1.0 + 1e-15));
        }
    }
}

/// Central differences of the force along velocity and rotation.
#[test]
fn slopes_are_derivatives() {
    for (v, r) in cases().into_iter().take(3) {
        let slope = LAW.slope(&v, &r);
        // Without speed across, the difference of its square is `h`.
        let h = 1e-7;
        for i in 0..3 {
            let e = Vector3::ith(i, h);
            let at = |v: Vector3<f64>, z: Vector3<f64>| {
                LAW.force(&v, &(r * exp(&z)).column(2).into_owned())
            };
            let zero = Vector3::zeros();
            let by_v = (at(v + e, zero) - at(v - e, zero)) / (2.0 * h);
            let by_z = (at(v, e) - at(v, -e)) / (2.0 * h);
            assert!((by_v + slope.velocity.column(i)).norm() < 1e-6 * v.norm());
            assert!((by_z + slope.rotation.column(i)).norm() < 1e-6 * v.norm());
        }
    }
}

/// Central differences of the slopes; the second derivative in the chart is the symmetric part of that of the left-trivialized slope.
#[test]
fn curvature_is_the_derivative_of_slopes() {
    let covector = Vector3::new(0.8, 0.5, -1.1);
    for (v, r) in cases().into_iter().take(2) {
        let found = LAW.curvature(&covector, &v, &r);
        let h = 1e-5;
        let mut expected = SMatrix::<f64, 6, 6>::zeros();
        for i in 0..6 {
            let slope = |sign: f64| {
                let (mut v, mut z) = (v, Vector3::zeros());
                if i < 3 {
                    v[i] += sign * h;
                } else {
                    z[i - 3] = sign * h;
                }
                let at = LAW.slope(&v, &(r * exp(&z)));
                let parts = [at.velocity.tr_mul(&covector), at.rotation.tr_mul(&covector)];
                SMatrix::<f64, 6, 1>::from_iterator(parts.iter().flatten().map(|x| -x))
            };
            let column = (slope(1.0) - slope(-1.0)) / (2.0 * h);
            expected.set_column(i, &column);
        }
        let symmetric = (expected + expected.transpose()) * 0.5;
        assert!((found - symmetric).norm() < 1e-8 * found.norm());
        assert_eq!(found, found.transpose());
    }
}
