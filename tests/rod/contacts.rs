//! Contacts: their potential and its derivatives, energy of arms that fall and bounce, the check's integrator, stable steps.

use nalgebra::{Matrix3, Vector3};
use proptest::prelude::*;
use softarm::control::Shape;
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{
    BaseCondition, Contact, Energy, Material, NodeWrenches, Rod, RodModel, RodParameters, Section,
    SectionProfile, State, Stepper, StrainRule, TimeScheme, Touch, stable_step,
};
use softarm::verify::ReferenceStepper;

fn floor(height: f64) -> Shape {
    Shape::HalfSpace {
        point: Vector3::new(0.0, 0.0, height),
        normal: Vector3::z(),
    }
}

fn contact(shape: Shape, force: f64, penetration: f64) -> Contact {
    Contact {
        name: "body".into(),
        shape,
        part: [0.0, 1.0],
        force,
        penetration,
    }
}

/// A soft arm of 0.3 m and 1 cm radius along the first axis.
fn parameters(n_elements: usize, contacts: Vec<Contact>) -> RodParameters {
    let silicone = Material::isotropic(1e5, 0.4, 1070.0);
    let section = SectionProfile::Uniform(Section::circle(&silicone, 0.01));
    RodParameters {
        base_rotation: exp(&Vector3::new(0.0, std::f64::consts::FRAC_PI_2, 0.0)),
        gravity: Vector3::new(0.0, 0.0, -9.81),
        radii: vec![(0.0, 0.01), (1.0, 0.01)],
        contacts,
        ..RodParameters::straight(0.3, n_elements, section)
    }
}

fn rod(parameters: &RodParameters) -> Rod {
    Rod::new(parameters).expect("a rod")
}

/// The force on the nodes that move and do not, from the contacts alone.
fn force(rod: &Rod) -> Vector3<f64> {
    let mut sum = Vector3::zeros();
    rod.visit_contact_forces(|node| rod.rest.positions[node], |_, force| sum += force);
    sum
}

/// An arm that is as deep in a floor as the penetration, over all of its length or over the part that can touch, is pushed with the force of
/// the contact, whatever its elements are; at twice the depth with four times that.
#[test]
fn the_force_is_that_of_the_whole_part() {
    for (depth, times) in [(2e-3, 1.0), (4e-3, 4.0)] {
        for n in [3, 4, 7, 40] {
            for part in [[0.0, 1.0], [0.31, 0.77]] {
                let body = Contact {
                    part,
                    ..contact(floor(-0.01 + depth), 3.0, 2e-3)
                };
                let expected = Vector3::new(0.0, 0.0, 3.0 * times);
                // A rounding of the depth counts twice, and the arm is turned by half a right angle's rounding.
                // Beside a mount nothing touches, so that the arm has none.
                let free = RodParameters {
                    base: BaseCondition::Free,
                    ..parameters(n, vec![body])
                };
                let off = (force(&rod(&free)) - expected).norm();
                assert!(off < 1e-12 * times, "{n} {part:?}: {off:e}");
            }
        }
    }
}

/// Bad numbers of a contact are errors that name them.
#[test]
fn contacts_are_checked() {
    let good = contact(floor(0.0), 1.0, 1e-3);
    for (bad, what) in [
        (
            Contact {
                force: -1.0,
                ..good.clone()
            },
            "force",
        ),
        (
            Contact {
                force: f64::NAN,
                ..good.clone()
            },
            "force",
        ),
        (
            Contact {
                penetration: 0.0,
                ..good.clone()
            },
            "penetration",
        ),
        (
            Contact {
                penetration: 1e-200,
                ..good.clone()
            },
            "stiffness",
        ),
        (
            Contact {
                part: [0.5, 0.5],
                ..good.clone()
            },
            "place",
        ),
        (
            Contact {
                part: [0.5, 1.5],
                ..good
            },
            "place",
        ),
    ] {
        let error = Rod::new(&parameters(4, vec![bad]))
            .expect_err(what)
            .to_string();
        assert!(error.contains(what), "{error}");
    }
}

fn shapes(size: f64, turn: Vector3<f64>) -> [Shape; 4] {
    let rotation: Matrix3<f64> = exp(&turn);
    [
        Shape::Sphere {
            center: Vector3::new(0.1, -0.2, 0.3) * size,
            radius: 0.5 * size,
        },
        Shape::Capsule {
            from: rotation.column(0) * (-0.3 * size),
            to: rotation.column(0) * (0.4 * size),
            radius: 0.3 * size,
        },
        Shape::HalfSpace {
            point: Vector3::new(0.0, 0.1, 0.2) * size,
            normal: rotation.column(1).into_owned(),
        },
        Shape::Cuboid {
            center: Vector3::new(0.1, 0.0, -0.1) * size,
            rotation,
            half_size: Vector3::new(0.3, 0.2, 0.4) * size,
        },
    ]
}

proptest! {
    /// Forces, second derivative and that of `λ·∇V` along both ends of a chord are those of the values, for bodies and arms from micrometers to hundreds of
    /// meters, forces and penetrations of any size, away from the edges at which the distance has no second derivative; outside all of them are absent.
    #[test]
    fn derivatives_of_contacts_are_derivatives(
        x in prop::array::uniform6(-1.0..1.0f64),
        lambda in prop::array::uniform6(-1.0..1.0f64),
        turn in prop::array::uniform3(-2.0..2.0f64),
        exponents in prop::array::uniform3(-6.0..2.0f64),
        intervals in 1usize..6,
    ) {
        let [size, force, penetration] = exponents.map(|e| 10f64.powf(e));
        let penetration = penetration * size;
        let pair = |v: [f64; 6]| [Vector3::new(v[0], v[1], v[2]), Vector3::new(v[3], v[4], v[5])];
        let (ends, lambda) = (pair(x).map(|x| x * size), pair(lambda));
        for shape in shapes(size, Vector3::from(turn)) {
            let touch = Touch {
                contact: 0, element: 0, shape, radii: [0.3 * size, 0.2 * size], share: 0.7, intervals, first: 0, force, penetration,
            };
            let h = 1e-5 * size;
            let along = |i: usize, s: f64| {
                let mut out = ends;
                out[i / 3][i % 3] += s * h;
                out
            };
            let point = |[a, b]: [Vector3<f64>; 2], i: usize| a + (b - a) * (i as f64 / intervals as f64);
            // No point within a shift of where it touches, or of an edge.
            let mut bend = 1.0f64;
            let smooth = (0..=intervals).all(|j| {
                let here = shape.distance(&point(ends, j));
                bend = bend.max(1.0 + here.bend * size);
                let radius = (0.3 - 0.1 * j as f64 / intervals as f64) * size;
                (radius - here.value).abs() > 4.0 * h && (0..6).all(|i| {
                    let [a, b] = [1.0, -1.0].map(|s| shape.distance(&point(along(i, s), j)));
                    (a.curvature - b.curvature).norm() * size < 1e-2 * (1.0 + (a.bend * size).powi(2))
                        && (a.gradient - b.gradient).norm() < 1e-2
                })
            });
            if !smooth {
                continue;
            }
            // Of V, per unit of length; a second derivative along an axis has the bend of the distance besides.
            let unit = force / (penetration * penetration);
            let scale = unit * size.powi(3) * bend.powi(3);
            let of = |[a, b]: &[Vector3<f64>; 2]| {
                let ends = [a, b];
                let forces = touch.forces(ends).unwrap_or_default();
                let hessian = touch.hessian(ends).unwrap_or_default();
                let covector = nalgebra::Vector6::from_iterator(lambda.iter().flat_map(|l| l.iter().copied()));
                let gradient = -nalgebra::Vector6::from_iterator(forces.iter().flat_map(|f| f.iter().copied()));
                (touch.energy(ends), gradient, hessian, hessian * covector)
            };
            let (value, gradient, hessian, _) = of(&ends);
            let bent = touch.curvature([&ends[0], &ends[1]], [&lambda[0], &lambda[1]]);
            prop_assert!(bent.is_some() == (value > 0.0));
            let bent = bent.unwrap_or_default();
            for i in 0..6 {
                let [ahead, behind] = [1.0, -1.0].map(|s| of(&along(i, s)));
                let slope = (ahead.0 - behind.0) / (2.0 * h);
                prop_assert!((slope - gradient[i]).abs() < 1e-8 * scale / size, "{shape:?} {slope:e}");
                let slopes = (ahead.1 - behind.1) / (2.0 * h);
                prop_assert!((slopes - hessian.column(i)).norm() < 1e-8 * scale / (size * size), "{shape:?} {slopes}");
                let slopes = (ahead.3 - behind.3) / (2.0 * h);
                prop_assert!((slopes - bent.column(i)).norm() < 1e-7 * scale / size.powi(3), "{shape:?} {slopes}");
            }
        }
    }

    /// The points of a chord that are passed over do not touch: energy and largest depth are those of all points.
    #[test]
    fn passing_over_points_leaves_nothing_out(
        x in prop::array::uniform6(-1.0..1.0f64),
        turn in prop::array::uniform3(-2.0..2.0f64),
        intervals in 1usize..200,
    ) {
        let [a, b] = [Vector3::new(x[0], x[1], x[2]), Vector3::new(x[3], x[4], x[5])];
        for shape in shapes(0.3, Vector3::from(turn)) {
            let touch = Touch {
                contact: 0, element: 0, shape, radii: [0.02, 0.04], share: 1.0, intervals, first: 0, force: 3.0, penetration: 0.01,
            };
            let (mut sum, mut most) = (0.0, f64::NEG_INFINITY);
            for i in 0..=intervals {
                let s = i as f64 / intervals as f64;
                let depth = 0.02 + 0.02 * s - shape.distance(&(a + (b - a) * s)).value;
                let weight = if i == 0 || i == intervals { 0.5 } else { 1.0 } / intervals as f64;
                sum += weight * 3.0 / (3.0 * 0.01 * 0.01) * depth.max(0.0).powi(3);
                most = f64::max(most, depth);
            }
            prop_assert!((touch.energy([&a, &b]) - sum).abs() <= 1e-12 * (1.0 + sum));
            prop_assert!((touch.deepest([&a, &b])[0] - most).abs() < 1e-12);
        }
    }
}

/// A long element across a thin bar is pushed out of it wherever the bar is, by the same force: that of the pressure over the piece that touches,
/// `F/ℓ (p/δ)² 16/15 √(2 R p)`, with the distance `R` of the chord from the axis of the bar, by which the distance grows beside the nearest point.
#[test]
fn a_thin_bar_is_felt_between_nodes() {
    let (radius, penetration) = (1e-3, 5e-4);
    let round = 0.01 + radius;
    let pushes = (1..20).map(|i| {
        // From the middle of the first element to beyond the last node but one.
        let x = 0.3 * (0.3 + 0.6 * f64::from(i) / 20.0);
        let z = -round + penetration;
        let bar = Shape::Capsule {
            from: Vector3::new(x, -0.1, z),
            to: Vector3::new(x, 0.1, z),
            radius,
        };
        force(&rod(&parameters(3, vec![contact(bar, 1.0, penetration)]))).z
    });
    let distance = round - penetration;
    let expected = 16.0 / 15.0 * (2.0 * distance * penetration).sqrt() / 0.3;
    for push in pushes {
        // The pressure at the depth δ is felt at 4.5 points; the first omitted terms of its Fourier series, 16/k³ with k = 14 on both sides, are 0.011 of
        // it. The distance grows less than by the square over the half width a of the piece, by a²/(4 R²) = δ/(2 R) of itself, which is 0.024 at its ends.
        assert!((push / expected - 1.0).abs() < 0.03, "{push} {expected}");
    }
}

const CASES: [(RodModel, TimeScheme); 3] = [
    (RodModel::Standard, TimeScheme::Explicit),
    (RodModel::Consistent, TimeScheme::Explicit),
    (RodModel::Standard, TimeScheme::Implicit),
];

/// An arm that falls on a floor, from a clamped base above it or free.
fn falling(rule: StrainRule, (model, scheme): (RodModel, TimeScheme), base: BaseCondition) -> Rod {
    rod(&RodParameters {
        strain_rule: rule,
        model,
        scheme,
        base,
        ..parameters(10, vec![contact(floor(-0.05), 2.0, 3e-3)])
    })
}

/// Runs for a time, and returns the largest change of energy and the largest depth.
fn bounce(rod: &Rod, step: f64, duration: f64) -> [f64; 2] {
    let mut stepper = Stepper::new(rod, step, State::at_rest(rod.rest.clone()));
    let start = Energy::of(rod, &stepper.state()).total();
    let mut most = [0.0, f64::NEG_INFINITY];
    for _ in 0..(duration / step).round() as usize {
        stepper.advance([NodeWrenches::NONE; 2]).expect("a step");
        let state = stepper.state();
        let off = (Energy::of(rod, &state).total() - start).abs();
        let depth = rod.depths(&state.configuration.positions)[0].depth;
        most = [most[0].max(off), most[1].max(depth)];
    }
    most
}

/// An arm that falls on a floor and bounces keeps its energy up to an error that falls with the square of the step, under all rules, models
/// and schemes, clamped or free: the third derivative of the potential jumps, at a number of instants that does not grow with the steps.
#[test]
fn a_bouncing_arm_keeps_its_energy() {
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        for case in CASES {
            for base in [BaseCondition::Clamped, BaseCondition::Free] {
                let rod = falling(rule, case, base.clone());
                let step = 0.5 * stable_step(&rod);
                let [coarse, depth] = bounce(&rod, step, 0.3);
                let [fine, _] = bounce(&rod, 0.5 * step, 0.3);
                eprintln!("{rule:?} {case:?} {base:?}: {coarse:e} {fine:e} {depth:e}");
                assert!(depth > 1e-3, "it does not touch: {depth}");
                assert!(
                    fine < 0.35 * coarse,
                    "{rule:?} {case:?} {base:?}: {coarse:e} {fine:e}"
                );
            }
        }
    }
}

/// The check's integrator, which has its own distances and differentiates the potential by itself, makes the same motion.
#[test]
fn the_reference_makes_the_same_motion_in_contact() {
    for case in CASES {
        for shape in [
            floor(-0.03),
            Shape::Sphere {
                center: Vector3::new(0.2, 0.01, -0.13),
                radius: 0.1,
            },
            Shape::Cuboid {
                center: Vector3::new(0.3, 0.0, -0.13),
                rotation: exp(&Vector3::new(0.3, 0.7, 0.1)),
                half_size: Vector3::new(0.1, 0.1, 0.08),
            },
        ] {
            let rod = rod(&RodParameters {
                model: case.0,
                scheme: case.1,
                ..parameters(10, vec![contact(shape, 2.0, 3e-3)])
            });
            let step = 0.5 * stable_step(&rod);
            let start = State::at_rest(rod.rest.clone());
            let mut stepper = Stepper::new(&rod, step, start.clone());
            let mut reference = ReferenceStepper::new(&rod, step, start);
            let mut deepest = f64::NEG_INFINITY;
            for _ in 0..(0.15 / step).round() as usize {
                stepper.advance([NodeWrenches::NONE; 2]).expect("a step");
                reference.advance([NodeWrenches::NONE; 2]).expect("a step");
                let at = stepper.state().configuration.positions;
                deepest = deepest.max(rod.depths(&at)[0].depth);
            }
            assert!(deepest > 5e-4, "{shape:?}: {deepest}");
            let (found, expected) = (stepper.state(), reference.state());
            let tip = rod.tip();
            let off = found.configuration.positions[tip] - expected.configuration.positions[tip];
            // Rounding of some thousand steps; the reference solves implicit steps to a part in 1e10.
            let allowed = if case.1 == TimeScheme::Implicit {
                1e-9
            } else {
                1e-12
            };
            assert!(off.norm() < allowed, "{case:?} {shape:?}: {off}");
        }
    }
}

/// One element that does not bend is a mass on the spring of its contact: pressed to the penetration, its frequency is the one by which the
/// stable step counts it, `ω² = 2 F/(δ M)` of the whole arm, and steps beyond `2/ω` are not stable there.
#[test]
fn the_step_counts_the_stiffness_at_the_penetration() {
    let (force, depth) = (50.0, 1e-4);
    let body = contact(floor(-0.01 + depth), force, depth);
    let p = RodParameters {
        base: BaseCondition::Free,
        ..parameters(1, vec![body])
    };
    // Balanced at the penetration by its weight.
    let mass = rod(&p).mass();
    let rod = rod(&RodParameters {
        gravity: Vector3::new(0.0, 0.0, -force / mass),
        ..p
    });
    let expected = 2.0 * (mass * depth / (2.0 * force)).sqrt();
    assert!((rod.contact_step() / expected - 1.0).abs() < 1e-12);
    assert!(stable_step(&rod) < expected);
    let mut start = State::at_rest(rod.rest.clone());
    for x in &mut start.configuration.positions {
        x.z += 1e-3 * depth;
    }
    // Largest deviation over a thousand steps, in penetrations.
    let wander = |step: f64| {
        let mut stepper = Stepper::new(&rod, step, start.clone());
        (0..1000)
            .map(|_| match stepper.advance([NodeWrenches::NONE; 2]) {
                Ok(()) => stepper.position(0).z.abs() / depth,
                Err(_) => f64::INFINITY,
            })
            .fold(0.0, f64::max)
    };
    let [stable, unstable] = [0.9, 1.1].map(|factor| wander(factor * expected));
    assert!(stable < 1e-2, "{stable}");
    assert!(unstable > 0.1, "{unstable}");
}
