//! Rows of path limits: their derivatives against differences, and how far chords between their points dip into an obstacle.

use nalgebra::Vector3;
use softarm::control::path::{CHORD_DIP, MOST_POINTS, RowGradient};
use softarm::control::{PathLimit, RodView, Shape};
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{
    FormTerm, Material, Place, Rod, RodParameters, Section, SectionProfile, StrainRule, TimeGrid,
    Trajectory, TrajectoryTangent,
};

fn rod(rule: StrainRule) -> Rod {
    let section = Section::circle(&Material::isotropic(1e6, 0.5, 1e3), 0.05);
    let parameters = RodParameters {
        strain_rule: rule,
        ..RodParameters::straight(1.0, 4, SectionProfile::Uniform(section))
    };
    Rod::new(&parameters).expect("a valid rod")
}

/// Numbers that look random, between -1 and 1.
fn numbers(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

fn trajectory(rod: &Rod) -> Trajectory {
    let mut next = numbers(5);
    let mut vector = |size: f64| Vector3::new(next(), next(), next()) * size;
    let mut out = Trajectory::with_capacity(rod.n_nodes(), 3);
    for _ in 0..3 {
        let mut shape = rod.rest.clone();
        for x in &mut shape.positions {
            *x += vector(0.05 * rod.scales.length);
        }
        for r in &mut shape.rotations {
            *r *= exp(&vector(0.6));
        }
        out.push(&shape);
    }
    out
}

fn direction(trajectory: &Trajectory, seed: u64) -> TrajectoryTangent {
    let mut next = numbers(seed);
    let mut vectors = |size: f64| -> Vec<Vector3<f64>> {
        (trajectory.positions.iter())
            .map(|_| Vector3::new(next(), next(), next()) * size)
            .collect()
    };
    TrajectoryTangent {
        positions: vectors(0.3),
        rotations: vectors(1.0),
    }
}

fn limits() -> Vec<PathLimit> {
    let x = Vector3::new(0.03, -0.05, 0.4);
    vec![
        PathLimit::Clearance {
            shape: Shape::Sphere {
                center: x,
                radius: 0.1,
            },
            velocity: Vector3::zeros(),
            margin: 0.01,
            points: Some(3),
        },
        PathLimit::Clearance {
            shape: Shape::Capsule {
                from: x,
                to: Vector3::new(0.5, 0.3, 0.1),
                radius: 0.1,
            },
            velocity: Vector3::new(0.3, -0.2, 0.1),
            margin: 0.01,
            points: Some(2),
        },
        PathLimit::Stretch {
            least: 0.7,
            largest: 1.3,
        },
        PathLimit::Curvature { largest: 2.0 },
        PathLimit::Twist { largest: 2.0 },
        PathLimit::Speed {
            at: Place::Tip,
            largest: 1.0,
        },
        PathLimit::Tilt {
            at: Place::Tip,
            axis: Vector3::new(0.6, 0.0, 0.8),
            direction: Vector3::new(0.0, 0.8, -0.6),
            largest: 1.0,
        },
    ]
}

fn along(gradient: &RowGradient, direction: &TrajectoryTangent, n_nodes: usize) -> f64 {
    let term = |k: usize, term: &FormTerm| {
        let row = k * n_nodes + term.node;
        let vector = if term.component < 3 {
            direction.positions[row]
        } else {
            direction.rotations[row]
        };
        term.coefficient * vector[term.component % 3]
    };
    (gradient.iter())
        .map(|form| {
            form.terms
                .iter()
                .map(|t| term(form.time_node, t))
                .sum::<f64>()
        })
        .sum()
}

/// First and second derivatives of every limit's rows, along random directions, against differences of values and of first
/// derivatives along the same curve.
#[test]
fn derivatives_equal_differences() {
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        let rod = rod(rule);
        let here = trajectory(&rod);
        let n = rod.n_nodes();
        let radii: Vec<f64> = (0..n).map(|q| 0.05 - 0.005 * q as f64).collect();
        fn rod_view<'a>(rod: &'a Rod, radii: &'a [f64], trajectory: &'a Trajectory) -> RodView<'a> {
            RodView {
                rod,
                radii,
                trajectory,
                grid: TimeGrid {
                    start: 0.0,
                    step: 0.1,
                    n_steps: 1,
                },
            }
        }
        let still = rod_view(&rod, &radii, &here);
        let h = 1e-5;
        for limit in limits() {
            for item in 0..limit.n_items(&rod) {
                let d = direction(&here, 11 + item as u64);
                let moved = [h, -h].map(|s| here.retract(&d, s));
                let [ahead, behind] = moved
                    .each_ref()
                    .map(|t| limit.value(&rod_view(&rod, &radii, t), 2, item));
                let value = limit.value(&still, 2, item);
                let gradient = limit.gradient(&still, 2, item);
                let slope = along(&gradient, &d, n);
                let found = (ahead - behind) / (2.0 * h);
                assert!(
                    (slope - found).abs() < 1e-7 * (1.0 + found.abs()),
                    "{limit:?} {item}: {slope} and {found}"
                );
                let curvature = limit.curvature(&still, 2, item);
                let forms: Vec<f64> = curvature.forms.iter().map(|f| along(f, &d, n)).collect();
                let m = forms.len();
                let bend: f64 = (0..m * m)
                    .map(|ij| forms[ij / m] * curvature.matrix[(ij / m, ij % m)] * forms[ij % m])
                    .sum();
                let found = (ahead - 2.0 * value + behind) / (h * h);
                // Rounding of values of order one, twice over h².
                assert!(
                    (bend - found).abs() < 2e-4 * (1.0 + found.abs()),
                    "{limit:?} {item}: {bend} and {found}"
                );
            }
        }
    }
}

/// A chord between two points that touch a sphere dips into it by less than the bound of `points_per_element`.
#[test]
fn chords_dip_little() {
    for (chord, radius) in [(0.05, 0.15), (0.08, 0.11), (0.1, 10.0)] {
        let points = PathLimit::points_per_element(chord, radius);
        let s: f64 = chord / points as f64;
        let dip = radius - (radius * radius - 0.25 * s * s).sqrt();
        assert!(dip < 1.1 * CHORD_DIP * radius, "{points}");
        assert!(points == 1 || chord / (points - 1) as f64 > s);
    }
    assert_eq!(PathLimit::points_per_element(0.1, f64::INFINITY), 1);
    assert_eq!(PathLimit::points_per_element(0.1, 0.0), MOST_POINTS);
}
