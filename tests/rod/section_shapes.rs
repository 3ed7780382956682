//! Areas, second moments and torsion constants of shapes of sections.

use softarm::mechanics::Outline;

/// A rectangle of 30 x 10 mm, a square, and a strip have the torsion constants of tables: 0.263 a b³ for an aspect of 3, 0.140577 a⁴, and
/// a b³/3 less 0.63025 b⁴/3.
#[test]
fn rectangles_twist_by_st_venant() {
    let of = |width, height| Outline::Rectangle { width, height }.torsion_constant();
    assert!((of(0.03, 0.01) / 7.90e-9 - 1.0).abs() < 1e-3);
    assert_eq!(of(0.03, 0.01), of(0.01, 0.03));
    assert!((of(1.0, 1.0) / 0.140_577 - 1.0).abs() < 1e-5);
    let strip = 100.0 / 3.0 - 0.630_25 / 3.0;
    assert!((of(100.0, 1.0) / strip - 1.0).abs() < 1e-6);
}

/// A round ellipse and a ring without hole are the circle; no section twists more stiffly than by its polar moment.
#[test]
fn shapes_agree_where_they_meet() {
    let circle = Outline::Circle { radius: 0.3 };
    let [width, height] = [0.6; 2];
    let ring = Outline::Ring {
        radius: 0.3,
        inner_radius: 0.0,
    };
    let round = Outline::Ellipse { width, height };
    for other in [ring, round] {
        let [a, b] = [circle, other].map(|shape| {
            let [first, second] = shape.second_moments();
            [
                shape.area(),
                first,
                second,
                shape.torsion_constant(),
                shape.half_width(),
            ]
        });
        for (a, b) in a.into_iter().zip(b) {
            assert!((a / b - 1.0).abs() < 1e-15);
        }
    }
    for shape in [
        Outline::Rectangle {
            width: 0.2,
            height: 0.5,
        },
        Outline::Ellipse {
            width: 0.2,
            height: 0.5,
        },
    ] {
        let [first, second] = shape.second_moments();
        assert!(first > second && shape.torsion_constant() < first + second);
    }
}
