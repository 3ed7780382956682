//! The splines of couples along an arm, and the moments that they give its nodes.

use softarm::mechanics::{Actuator, Material};
use softarm::task::distributed::basis;
use softarm::task::{Arm, Discretization, DistributedCouple};

/// A cubic that is 0 at both ends is its own interpolating spline; so is a parabola, with one point and with any number.
#[test]
fn cubics_are_their_own_splines() {
    let places: Vec<f64> = (0..=50).map(|i| 0.02 * f64::from(i)).collect();
    for n in 1..=9 {
        let cubic = if n == 1 { 0.0 } else { 1.0 };
        let f = |s: f64| s * (1.0 - s) * (1.0 + cubic * 2.3 * s);
        let values = basis(n, &places);
        for (row, s) in places.iter().enumerate() {
            let found: f64 = (0..n)
                .map(|i| values[(row, i)] * f((i + 1) as f64 / (n + 1) as f64))
                .sum();
            assert!((found - f(*s)).abs() < 1e-13, "{n} points, {s}: {found}");
        }
    }
}

/// The spline goes through its points, and is twice continuously differentiable at them: second differences on both sides agree to the
/// third derivative times their distance.
#[test]
fn splines_are_smooth() {
    let (n, h) = (6, 1e-3);
    let jump = |i: usize| {
        let s = (i + 1) as f64 / (n + 1) as f64;
        let second = |t: f64| {
            let v = basis(n, &[t - h, t, t + h]);
            (v.row(0) - 2.0 * v.row(1) + v.row(2)) / (h * h)
        };
        (second(s - h) - second(s + h)).amax()
    };
    for i in 0..n {
        let s = (i + 1) as f64 / (n + 1) as f64;
        let own = basis(n, &[s]);
        for j in 0..n {
            let expected = f64::from(u8::from(i == j));
            assert!((own[(0, j)] - expected).abs() < 1e-13);
        }
        // Third derivatives of a spline with knots 1/7 apart are at most a few 7³.
        assert!(jump(i) < 2.0 * h * 10.0 * 343.0, "{}", jump(i));
    }
}

/// The moments of all nodes add up to the integral of the couple, to the second order of the elements' length: four times nearer with
/// twice as many elements. A parabola over the length is 2/3 in the mean.
#[test]
fn moments_add_up() {
    let arm = Arm::cylinder(&Material::isotropic(1e6, 0.5, 1000.0), 2.0, 0.05);
    let couple = DistributedCouple {
        points: 1,
        axes: [false, true, false],
    };
    let off = |elements: usize| {
        let rod = arm.rod(&Discretization::with_elements(elements)).unwrap();
        let map = couple.linear_map(&rod).unwrap();
        let sum: f64 = (0..map.nrows()).map(|i| map[(i, 0)]).sum();
        let about = (0..map.nrows()).filter(|i| i % 6 != 4);
        assert!(about.into_iter().all(|i| map[(i, 0)] == 0.0));
        (sum - 2.0 * 2.0 / 3.0).abs()
    };
    let ratio = off(10) / off(20);
    assert!((ratio - 4.0).abs() < 1e-6, "{ratio}");
}
