//! Distances from obstacles against brute force, and their derivatives against differences.

use nalgebra::Vector3;
use proptest::prelude::*;
use softarm::mechanics::rotation::exp;
use softarm::mechanics::solid::Shape;

fn shapes() -> Vec<Shape> {
    let rotation = exp(&Vector3::new(0.4, -0.7, 1.1));
    vec![
        Shape::Sphere {
            center: Vector3::new(0.1, -0.2, 0.3),
            radius: 0.25,
        },
        Shape::Capsule {
            from: Vector3::new(-0.3, 0.1, 0.0),
            to: Vector3::new(0.4, 0.2, -0.3),
            radius: 0.1,
        },
        Shape::HalfSpace {
            point: Vector3::new(0.0, 0.1, 0.2),
            normal: rotation.column(0).into_owned(),
        },
        Shape::Cuboid {
            center: Vector3::new(0.1, 0.0, -0.1),
            rotation,
            half_size: Vector3::new(0.2, 0.1, 0.3),
        },
    ]
}

/// Signed distance by brute force: the nearest of many points of the surface, from known parametrizations.
fn brute_force(shape: &Shape, x: &Vector3<f64>) -> f64 {
    let n = 400;
    match shape {
        Shape::Sphere { center, radius } => (x - center).norm() - radius,
        Shape::Capsule { from, to, radius } => {
            let nearest = |s: f64| (x - from - (to - from) * s).norm();
            let least = (0..=n).map(|i| nearest(f64::from(i) / f64::from(n)));
            least.fold(f64::INFINITY, f64::min) - radius
        }
        Shape::HalfSpace { point, normal } => (x - point).dot(normal),
        Shape::Cuboid {
            center,
            rotation,
            half_size,
        } => {
            // The nearest point of a box: clamp; from inside, the nearest of six faces.
            let local = rotation.tr_mul(&(x - center));
            let clamped = local.zip_map(half_size, |c, h| c.clamp(-h, h));
            if clamped == local {
                let faces = (0..3).map(|i| half_size[i] - local[i].abs());
                -faces.fold(f64::INFINITY, f64::min)
            } else {
                (local - clamped).norm()
            }
        }
    }
}

proptest! {
    /// Value against brute force; gradient and curvature against differences, away from where the gradient jumps.
    #[test]
    fn distances_and_derivatives(x in prop::array::uniform3(-1.0..1.0f64)) {
        let x = Vector3::from(x);
        for shape in shapes() {
            let found = shape.distance(&x);
            // 400 points of a segment of length below 1 m: the nearest is off by less than `½ s²/d`, with the spacing `s`.
            prop_assert!((found.value - brute_force(&shape, &x)).abs() < 2e-3);
            prop_assert!((found.gradient.norm() - 1.0).abs() < 1e-12);
            let h = 1e-5;
            let near = |i: usize, s: f64| shape.distance(&(x + Vector3::ith(i, s * h)));
            let smooth = (0..3).all(|i| {
                let turn = (near(i, 1.0).gradient - near(i, -1.0).gradient).norm();
                let bend = (near(i, 1.0).curvature - near(i, -1.0).curvature).norm();
                turn < 1e-2 && bend < 1e-2 * (1.0 + found.curvature.norm())
            });
            if !smooth {
                continue;
            }
            for i in 0..3 {
                let slope = (near(i, 1.0).value - near(i, -1.0).value) / (2.0 * h);
                prop_assert!((slope - found.gradient[i]).abs() < 1e-6);
                let bend = (near(i, 1.0).gradient - near(i, -1.0).gradient) / (2.0 * h);
                prop_assert!((bend - found.curvature.column(i)).norm() < 1e-4 * (1.0 + found.curvature.norm().powi(3)));
                // Third derivative: that of the curvature, off by its own next derivative but one times h²/6.
                let turn = (near(i, 1.0).curvature - near(i, -1.0).curvature) / (2.0 * h);
                let third = found.third_derivative(&Vector3::ith(i, 1.0));
                prop_assert!((turn - third).norm() < 1e-4 * (1.0 + found.bend.powi(4)));
            }
        }
    }
}

/// At the center of a sphere and on the axis of a capsule the gradient is still a unit vector, out of the body.
#[test]
fn cores_have_a_direction() {
    for shape in shapes() {
        let x = match shape {
            Shape::Sphere { center, .. } => center,
            Shape::Capsule { from, to, .. } => (from + to) * 0.5,
            _ => continue,
        };
        let found = shape.distance(&x);
        assert!((found.gradient.norm() - 1.0).abs() < 1e-12);
        assert!(found.curvature.iter().all(|c| c.is_finite()));
        assert!(found.value < 0.0);
    }
}
