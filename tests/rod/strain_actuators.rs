//! Motions of arms with tendons, push rods, chambers, muscles, braids and learned densities: balances of energy and momentum, and orders.

use nalgebra::Vector3;
use softarm::mechanics::{
    Density, Energy, LearnedStrains, Material, NodeWrenches, Rod, RodModel, RodParameters, Route,
    Section, SectionProfile, State, StepError, Stepper, StrainActuator, StrainRule, TimeScheme,
    stable_step,
};
use softarm::verify::ReferenceStepper;

use crate::common::learned::learned;

const LENGTH: f64 = 0.3;

fn silicone() -> Material {
    Material::isotropic(1e5, 0.4, 1070.0)
}

/// A helical tendon over a part of the arm, a tendon through disks, a push rod, a chamber, a muscle, a braid and learned densities, all with an effect on the motion.
fn actuators() -> Vec<StrainActuator> {
    let area = 1e-4;
    let of = |density, scale, route, effort: f64| StrainActuator {
        name: String::new(),
        density,
        scale,
        route,
        effort: vec![(0.0, effort)],
        winch: None,
        further: Vec::new(),
        friction: None,
        largest: 0.0,
    };
    vec![
        of(
            Density::Shortening,
            1.0,
            Route {
                from: 0.1,
                to: 0.83,
                turns: 0.7,
                ..Route::straight([8e-3, 2e-3])
            },
            0.3,
        ),
        of(
            Density::Lengthening,
            1.0,
            Route {
                offset_to: [2e-3, -4e-3],
                ..Route::straight([-3e-3, -8e-3])
            },
            0.1,
        ),
        of(
            Density::Threaded {
                spacing: 0.05,
                clearance: 0.0,
            },
            1.0,
            Route::straight([4e-3, -7e-3]),
            0.2,
        ),
        of(
            Density::Threaded {
                spacing: 0.05,
                clearance: 1e-3,
            },
            1.0,
            Route::straight([-5e-3, 2e-3]),
            0.2,
        ),
        of(Density::Volume, area, Route::straight([0.0, 7e-3]), 1e3),
        of(
            Density::Muscle,
            1e4 * area,
            Route {
                to: 0.6,
                ..Route::straight([-6e-3, 0.0])
            },
            0.6,
        ),
        of(
            Density::Braid {
                fibre: 2.0,
                turns: 30.0,
            },
            1.0,
            Route::straight([0.0, -5e-3]),
            50.0,
        ),
        of(
            Density::Learned(learned(LearnedStrains::OfSection)),
            1.0,
            Route::straight([0.0; 2]),
            1e-3,
        ),
        of(
            Density::Learned(learned(LearnedStrains::OfLine)),
            1.0,
            Route {
                turns: 0.3,
                ..Route::straight([4e-3, 3e-3])
            },
            1e-3,
        ),
    ]
}

fn arm(
    rule: StrainRule,
    model: RodModel,
    scheme: TimeScheme,
    actuators: Vec<StrainActuator>,
) -> Rod {
    let section = SectionProfile::Uniform(Section::circle(&silicone(), 0.01));
    Rod::new(&RodParameters {
        strain_rule: rule,
        model,
        scheme,
        gravity: Vector3::new(-9.81, 0.0, 0.0),
        rest_curvature: Vector3::new(0.0, 2.0, 1.0),
        actuators,
        ..RodParameters::straight(LENGTH, 10, section)
    })
    .expect("a rod")
}

fn potential(rod: &Rod, state: &State) -> f64 {
    let at = &state.configuration;
    let efforts = rod.actuators.efforts(0.0);
    Energy::of(rod, state).total() + rod.actuator_energy(&at.positions, &at.rotations, &efforts)
}

/// Runs for a time, and returns the change of energy with constant efforts at the end, and the largest on the way.
fn wander(rod: &Rod, step: f64, duration: f64) -> [f64; 2] {
    let mut stepper = Stepper::new(rod, step, State::at_rest(rod.rest.clone()));
    let start = potential(rod, &stepper.state());
    let mut most = 0.0_f64;
    let mut last = 0.0;
    for _ in 0..(duration / step).round() as usize {
        stepper.advance([NodeWrenches::NONE; 2]).expect("a step");
        last = potential(rod, &stepper.state()) - start;
        most = most.max(last.abs());
    }
    [last, most]
}

/// With constant efforts `E - Σ u y` has no drift, and what it wanders falls with the square of the step.
#[test]
fn energy_and_efforts_balance() {
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        for (model, scheme) in [
            (RodModel::Standard, TimeScheme::Explicit),
            (RodModel::Consistent, TimeScheme::Explicit),
            (RodModel::Standard, TimeScheme::Implicit),
        ] {
            let rod = arm(rule, model, scheme, actuators());
            let step = 0.5 * stable_step(&rod);
            let coarse = wander(&rod, step, 0.2);
            let fine = wander(&rod, 0.5 * step, 0.2);
            eprintln!("{rule:?} {model:?} {scheme:?}: {coarse:?} {fine:?}");
            assert!(
                fine[1] < 0.35 * coarse[1],
                "{rule:?} {model:?} {scheme:?}: {coarse:?} {fine:?}"
            );
        }
    }
}

/// A small tension that is there at once swings the tip as the modes of a clamped beam do under a moment at the tip: `w(L, t) = (T d L²/EI)
/// Σ 4σ_n/β_n³ (1 - cos ω_n t)`, whose coefficients sum to ½.
#[test]
fn a_step_of_tension_swings_the_modes() {
    let (length, radius, offset, tension) = (0.5, 1e-3, 0.015, 1e-3);
    let steel = Material::isotropic(200e9, 0.3, 8000.0);
    let section = Section::circle(&steel, radius);
    let rod = Rod::new(&RodParameters {
        scheme: TimeScheme::Implicit,
        actuators: vec![StrainActuator {
            name: String::new(),
            density: Density::Shortening,
            scale: 1.0,
            route: Route::straight([offset, 0.0]),
            effort: vec![(0.0, tension)],
            winch: None,
            further: Vec::new(),
            friction: None,
            largest: 0.0,
        }],
        ..RodParameters::straight(length, 40, SectionProfile::Uniform(section))
    })
    .expect("a rod");
    let bending = section.angular_stiffness.y;
    let modes = [
        (1.875_104_07_f64, 0.734_095_5_f64),
        (4.694_091_13, 1.018_467_3),
        (7.854_757_44, 0.999_224_5),
        (10.995_540_73, 1.000_033_6),
        (14.137_168_39, 1.0),
    ];
    let unit = (bending / section.mass).sqrt() / (length * length);
    let expected = |t: f64| {
        let sum: f64 = (modes.iter())
            .map(|(beta, sigma)| {
                4.0 * sigma / beta.powi(3) * (1.0 - (beta * beta * unit * t).cos())
            })
            .sum();
        tension * offset * length * length / bending * sum
    };
    let period = std::f64::consts::TAU / (modes[0].0.powi(2) * unit);
    let step = period / 4000.0;
    let mut stepper = Stepper::new(&rod, step, State::at_rest(rod.rest.clone()));
    let size = expected(0.5 * period);
    let mut worst = 0.0_f64;
    for k in 1..=4000 {
        stepper.advance([NodeWrenches::NONE; 2]).expect("a step");
        let w = stepper.position(rod.tip()).x;
        worst = worst.max((w - expected(k as f64 * step)).abs() / size);
    }
    eprintln!("{worst}");
    // The sixth mode and beyond have 0.0025 of the sum of 0.5, and swing by up to twice that.
    assert!(worst < 0.01, "{worst}");
}

/// A tendon in the axis that pulls with more than the axial stiffness presses the arm together: an error with element and time, by the
/// integrator of simulations, explicit and implicit, and by that of the check.
#[test]
fn an_element_that_is_pressed_together_is_an_error() {
    for scheme in [TimeScheme::Explicit, TimeScheme::Implicit] {
        let mut rod = arm(StrainRule::Helical, RodModel::Standard, scheme, Vec::new());
        let pull = 1.5 * rod.elements[0].linear_stiffness.z;
        rod = arm(
            StrainRule::Helical,
            RodModel::Standard,
            scheme,
            vec![StrainActuator {
                name: "axis".into(),
                density: Density::Shortening,
                scale: 1.0,
                route: Route::straight([0.0; 2]),
                effort: vec![(0.0, 0.0), (0.05, pull)],
                winch: None,
                further: Vec::new(),
                friction: None,
                largest: 0.0,
            }],
        );
        let step = 0.5 * stable_step(&rod);
        let start = State::at_rest(rod.rest.clone());
        let is_pressed = |error: StepError| match error {
            StepError::ElementPressed { stretch, time, .. } => stretch <= 0.0 && time > 0.01,
            other => panic!("{other}"),
        };
        let mut stepper = Stepper::new(&rod, step, start.clone());
        let mut found = (0..10_000).map(|_| stepper.advance([NodeWrenches::NONE; 2]));
        assert!(is_pressed(found.find_map(Result::err).expect("an error")));
        let mut reference = ReferenceStepper::new(&rod, step, start);
        let mut found = (0..10_000).map(|_| reference.advance([NodeWrenches::NONE; 2]));
        assert!(is_pressed(found.find_map(Result::err).expect("an error")));
    }
}

/// A muscle pulls only in its range of stretches, 0.577 to 1.596: beyond either end a step with a large activation is the step without, in
/// vector instructions and by the check's integrator, and within it is not.
#[test]
fn a_muscle_that_is_too_short_or_too_long_exerts_nothing() {
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        for scheme in [TimeScheme::Explicit, TimeScheme::Implicit] {
            let muscle = |activation: f64| StrainActuator {
                name: String::new(),
                density: Density::Muscle,
                scale: 1.0,
                route: Route::straight([0.0; 2]),
                effort: vec![(0.0, activation)],
                winch: None,
                further: Vec::new(),
                friction: None,
                largest: 0.0,
            };
            let arms = [1.0, 0.0].map(|activation| {
                let section = SectionProfile::Uniform(Section::circle(&silicone(), 0.01));
                Rod::new(&RodParameters {
                    strain_rule: rule,
                    scheme,
                    actuators: vec![muscle(activation)],
                    ..RodParameters::straight(LENGTH, 10, section)
                })
                .expect("a rod")
            });
            // As short as a step of the arm at rest allows, so that the implicit one converges from stretches far from rest.
            let step = 1e-2 * stable_step(&arms[0]);
            for (stretch, pulls) in [(0.5, false), (1.0, true), (1.4, true), (1.7, false)] {
                let moved = |rod: &Rod, check: bool| {
                    let mut at = State::at_rest(rod.rest.clone());
                    for x in &mut at.configuration.positions {
                        *x *= stretch;
                    }
                    let state = if check {
                        let mut stepper = ReferenceStepper::new(rod, step, at);
                        stepper.advance([NodeWrenches::NONE; 2]).expect("a step");
                        stepper.state().clone()
                    } else {
                        let mut stepper = Stepper::new(rod, step, at);
                        stepper.advance([NodeWrenches::NONE; 2]).expect("a step");
                        stepper.state()
                    };
                    state.linear_momentum[rod.tip()].z
                };
                for check in [false, true] {
                    let [with, without] = [&arms[0], &arms[1]].map(|rod| moved(rod, check));
                    let what = format!("{rule:?} {scheme:?} at {stretch}, {with} and {without}");
                    assert_eq!(
                        (with - without).abs() > 1e-12 * without.abs().max(step),
                        pulls,
                        "{what}"
                    );
                }
            }
        }
    }
}

/// The length of a tendon through disks along an arm of 0.3 m that is bent to an arc of this curvature about its second axis.
fn threaded_length(curvature: f64, offset: f64, spacing: f64, clearance: f64) -> f64 {
    let section = SectionProfile::Uniform(Section::circle(&silicone(), 0.01));
    let rod = Rod::new(&RodParameters {
        rest_curvature: Vector3::new(0.0, curvature, 0.0),
        actuators: vec![StrainActuator {
            name: "threaded".into(),
            density: Density::Threaded { spacing, clearance },
            scale: 1.0,
            route: Route::straight([offset, 0.0]),
            effort: Vec::new(),
            winch: None,
            further: Vec::new(),
            friction: None,
            largest: 1.0,
        }],
        ..RodParameters::straight(0.3, 9, section)
    })
    .unwrap();
    -rod.actuator_coordinates(&rod.rest.positions, &rod.rest.rotations)[0]
}

/// On an arm that is bent to an arc of curvature `κ`, the length of a tendon through disks at the distance `s` is that of its chords: the loss
/// by the chords is right to the part `(κ s)²/80` of the next term of the sine, and beside the axis to the part `κ r` of the distance `r`.
#[test]
fn a_threaded_tendon_is_as_long_as_its_chords() {
    let (length, curvature) = (0.3, 8.0);
    for (offset, disks) in [(0.0, 6), (0.0, 12), (5e-3, 6)] {
        let spacing = length / f64::from(disks);
        let found = threaded_length(curvature, offset, spacing, 0.0);
        // The center of the arc lies on the side of the first axis.
        let chord = 2.0 * (1.0 / curvature - offset) * (0.5 * curvature * spacing).sin();
        let expected = f64::from(disks) * chord;
        let straight = length * (1.0 - curvature * offset);
        let apart = (found - expected).abs() / (straight - expected);
        let missing = (curvature * spacing).powi(2) / 80.0 + curvature * offset;
        assert!(apart < 1.1 * missing, "{offset} {disks}: {apart} {missing}");
        assert!(found < straight);
    }
}

/// In wide holes the chords lie nearer to the center of the arc by the clearance `c`, on whichever side of the axis the tendon is. That is so but
/// for the part `κ₀/κ` with `κ₀ = 8 c/s²`, by which a tendon still is straight through more than two disks; an arm that hardly bends loses
/// nothing, and one that bends to the other side as much.
#[test]
fn a_tendon_in_wide_holes_lies_on_their_inner_side() {
    let (length, spacing, clearance) = (0.3, 0.05, 2e-4);
    let least = 8.0 * clearance / (spacing * spacing);
    for offset in [0.0, 5e-3, -5e-3] {
        for curvature in [8.0, 4.0, -8.0] {
            let [wide, narrow] =
                [clearance, 0.0].map(|own| threaded_length(curvature, offset, spacing, own));
            let half: f64 = 0.5 * curvature.abs() * spacing;
            let shift = length / spacing * 2.0 * clearance * half.sin();
            let part = (narrow - wide) / shift;
            let most = 1.0 + half * half / 5.0;
            assert!(
                part < most && part > 1.0 - least / curvature.abs(),
                "{offset} {curvature}: {part}"
            );
        }
        let [wide, narrow] =
            [clearance, 0.0].map(|own| threaded_length(0.01, offset, spacing, own));
        assert!((narrow - wide).abs() < 0.01 * clearance * length * 0.01);
    }
}
