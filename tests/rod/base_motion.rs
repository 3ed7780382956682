//! Prescribed motions of a base: splines through tables, and velocities against differences.

use nalgebra::Vector3;
use softarm::mechanics::rotation::{exp, log};
use softarm::mechanics::{BaseMotion, CubicSpline, MotionCurve, Oscillation};

fn wavy_points() -> [(f64, Vector3<f64>); 6] {
    [0.0, 0.3, 0.5, 1.1, 1.2, 2.0]
        .map(|t: f64| (t, Vector3::new(t.sin(), 1.0 - t * t, (3.0 * t).cos())))
}

fn wavy_table() -> CubicSpline {
    CubicSpline::through(&wavy_points()).expect("increasing times")
}

fn tumbling() -> BaseMotion {
    let oscillation = Oscillation {
        amplitude: Vector3::new(0.7, -0.2, 0.4),
        frequency: 0.8,
        phase: 0.6,
    };
    BaseMotion {
        translation: MotionCurve {
            rate: Vector3::new(0.1, 0.0, -0.3),
            table: Some(wavy_table()),
            oscillations: vec![oscillation],
        },
        rotation: MotionCurve {
            rate: Vector3::new(2.0, -1.0, 3.0),
            table: Some(wavy_table()),
            oscillations: vec![oscillation],
        },
    }
}

/// The spline passes through its points, has flat ends and is constant outside; value, slope and curvature are continuous at the inner
/// points.
#[test]
fn spline_is_smooth() {
    let (points, spline) = (wavy_points(), wavy_table());
    for (t, value) in points {
        assert_eq!(spline.at(t).0, value);
    }
    let (first, last) = (points[0].0, 2.0);
    assert_eq!(spline.at(first - 1.0), (points[0].1, Vector3::zeros()));
    assert_eq!(spline.at(last + 1.0), (points[5].1, Vector3::zeros()));
    assert!(spline.at(first + 1e-9).1.norm() < 1e-6);
    assert!(spline.at(last - 1e-9).1.norm() < 1e-6);
    // One-sided second derivatives from slopes; their error is h times the third derivative, which is below 1e3.
    let h = 1e-6;
    for (t, _) in points[1..5].iter().copied() {
        let here = spline.at(t).1;
        let left = (here - spline.at(t - h).1) / h;
        let right = (spline.at(t + h).1 - here) / h;
        assert!((left - right).norm() < 2e-3, "{t}: {left} {right}");
    }
}

/// A clamped spline reproduces a cubic with flat ends, `3t² - 2t³`, whatever the points between.
#[test]
fn spline_reproduces_a_cubic() {
    let cubic = |t: f64| Vector3::repeat(t * t * (3.0 - 2.0 * t));
    let points: Vec<_> = [0.0, 0.1, 0.45, 0.9, 1.0].map(|t| (t, cubic(t))).into();
    let spline = CubicSpline::through(&points).expect("increasing times");
    for i in 0..=100 {
        let t = 0.01 * f64::from(i);
        assert!((spline.at(t).0 - cubic(t)).norm() < 1e-14, "{t}");
    }
}

/// Velocities are the central differences of the pose, rotation vectors beyond a full turn included.
#[test]
fn velocities_are_derivatives() {
    let motion = tumbling();
    let (x, r) = (
        Vector3::new(1.0, 2.0, 3.0),
        exp(&Vector3::new(0.3, 2.0, -1.0)),
    );
    let h = 1e-5;
    for t in [-0.5, 0.05, 0.7, 1.15, 1.9, 4.0] {
        let [before, here, after] = [t - h, t, t + h].map(|t| motion.at(&x, &r, t));
        let velocity = (after.position - before.position) / (2.0 * h);
        let spin = log(&before.rotation.tr_mul(&after.rotation)) / (2.0 * h);
        // The error of the difference is h² times third derivatives of order 1e3.
        assert!((velocity - here.velocity).norm() < 1e-6, "{t}");
        assert!((spin - here.angular_velocity).norm() < 1e-6, "{t}");
    }
}

/// Without a table the motion starts in the reference pose.
#[test]
fn starts_in_the_reference_pose() {
    let mut motion = tumbling();
    motion.translation.table = None;
    motion.rotation.table = None;
    let (x, r) = (
        Vector3::new(1.0, 2.0, 3.0),
        exp(&Vector3::new(0.3, 2.0, -1.0)),
    );
    let start = motion.at(&x, &r, 0.0);
    assert_eq!((start.position, start.rotation), (x, r));
}

/// A table that is not a function of time is refused.
#[test]
fn invalid_tables_are_refused() {
    let point = |t| (t, Vector3::zeros());
    assert!(CubicSpline::through(&[]).is_err());
    assert!(CubicSpline::through(&[point(0.0), point(0.0)]).is_err());
    assert!(CubicSpline::through(&[point(1.0), point(0.0)]).is_err());
    assert!(CubicSpline::through(&[point(f64::NAN)]).is_err());
    assert!(CubicSpline::through(&[(0.0, Vector3::repeat(f64::INFINITY))]).is_err());
    let mut motion = tumbling();
    motion.rotation.oscillations[0].frequency = f64::NAN;
    assert!(motion.check().is_err());
}
