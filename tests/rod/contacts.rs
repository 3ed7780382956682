//! Contacts: their potential and its derivatives, energy of arms that fall and bounce, the check's integrator, stable steps.

use nalgebra::{Matrix3, Vector3, Vector6};
use proptest::prelude::*;
use softarm::control::Shape;
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{
    BaseCondition, Contact, Energy, Material, NodeWrenches, OfPose, Pose, Posed, Rod, RodModel,
    RodParameters, Section, SectionProfile, State, Stepper, StrainRule, TimeScheme, Touch, Wrench,
    stable_step,
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
    (rod.posed(Posed::Alone, &[]))
        .map(|(own, factor)| {
            let at = own.pose(&rod.rest.positions, &rod.rest.rotations);
            own.wrench(&at, factor).force
        })
        .sum()
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
                let off = (force(&rod(&parameters(n, vec![body]))) - expected).norm();
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
    /// Gradient, second derivative and that of `λ·∇V` are those of the values, for bodies and arms from micrometers to hundreds of meters,
    /// forces and penetrations of any size, away from the edges at which the distance has no second derivative; outside all of them are zero.
    #[test]
    fn derivatives_of_contacts_are_derivatives(
        x in prop::array::uniform3(-1.0..1.0f64),
        lambda in prop::array::uniform3(-1.0..1.0f64),
        turn in prop::array::uniform3(-2.0..2.0f64),
        exponents in prop::array::uniform3(-6.0..2.0f64),
    ) {
        let [size, force, penetration] = exponents.map(|e| 10f64.powf(e));
        let penetration = penetration * size;
        let x = Vector3::from(x) * size;
        let lambda = Vector3::from(lambda);
        for shape in shapes(size, Vector3::from(turn)) {
            let touch = Touch { contact: 0, shape, radius: 0.3 * size, force, penetration };
            let function = OfPose::Touch(touch);
            let pose = |x: Vector3<f64>| Pose { position: x, rotation: Matrix3::identity() };
            let h = 1e-5 * size;
            let along = |i: usize, s: f64| pose(x + Vector3::ith(i, s * h));
            let depth = touch.depth(&x);
            // Nothing within a shift of where it touches, or of an edge.
            let smooth = (0..3).all(|i| {
                let [a, b] = [1.0, -1.0].map(|s| shape.distance(&along(i, s).position));
                (a.curvature - b.curvature).norm() * size < 1e-2 * (1.0 + (a.bend * size).powi(2))
                    && (a.gradient - b.gradient).norm() < 1e-2
            });
            if !smooth || depth.abs() < 4.0 * h {
                continue;
            }
            // Of V, per unit of length; a second derivative along an axis has the bend of the distance besides.
            let unit = force / (penetration * penetration);
            let bend = 1.0 + shape.distance(&x).bend * size;
            let scale = unit * size.powi(3) * bend.powi(3);
            let value = |at: &Pose| function.function().value(at);
            let gradient = |at: &Pose| function.function().gradient(at).force;
            let hessian = function.function().hessian(&pose(x));
            let covector = Wrench { force: lambda, moment: Vector3::zeros() };
            let bent = function.curvature(&pose(x), &covector, size);
            let pulled = |at: &Pose| (function.tangent(at).transpose() * Vector6::from(covector.to_array())).fixed_rows::<3>(0).into_owned();
            for i in 0..3 {
                let slope = (value(&along(i, 1.0)) - value(&along(i, -1.0))) / (2.0 * h);
                prop_assert!((slope - gradient(&pose(x))[i]).abs() < 1e-8 * scale / size, "{shape:?} {slope:e}");
                let slopes = (gradient(&along(i, 1.0)) - gradient(&along(i, -1.0))) / (2.0 * h);
                let column = hessian.fixed_view::<3, 1>(0, i);
                prop_assert!((slopes - column).norm() < 1e-8 * scale / (size * size), "{shape:?} {slopes}");
                let slopes = (pulled(&along(i, 1.0)) - pulled(&along(i, -1.0))) / (2.0 * h);
                let column = bent.fixed_view::<3, 1>(0, i);
                prop_assert!((slopes - column).norm() < 1e-7 * scale / size.powi(3), "{shape:?} {slopes} {column}");
            }
            prop_assert!(depth > 0.0 || (value(&pose(x)) == 0.0 && hessian.amax() == 0.0 && bent.amax() == 0.0));
        }
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
