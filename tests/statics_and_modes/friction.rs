//! Friction of tendons along their paths at rest: closed forms, and the derivatives of shapes.

use nalgebra::Vector3;
use softarm::mechanics::at_rest::{Wanted, shapes_at_rest};
use softarm::mechanics::{
    Configuration, Density, Friction, Material, Rod, RodParameters, Route, Section, SectionProfile,
    StrainActuator, StrainRule, TimeScheme, Winch, static_equilibrium,
};

const LENGTH: f64 = 0.3;
const OFFSET: f64 = 0.01;

fn tendon(route: Route, input: f64, (coefficient, at_rest): (f64, f64)) -> StrainActuator {
    StrainActuator {
        name: "tendon".into(),
        density: Density::Shortening,
        scale: 1.0,
        route,
        effort: vec![(0.0, input)],
        winch: None,
        further: Vec::new(),
        friction: Some(Friction {
            coefficient,
            speed: 1e-3,
            at_rest,
        }),
        largest: input.abs(),
    }
}

fn arm(n_elements: usize, rule: StrainRule, actuators: Vec<StrainActuator>) -> RodParameters {
    let material = Material {
        shear_factor: 1.0,
        ..Material::isotropic(1e9, 0.3, 1000.0)
    };
    let section = SectionProfile::Uniform(Section::circle(&material, 2e-3));
    RodParameters {
        strain_rule: rule,
        scheme: TimeScheme::Implicit,
        actuators,
        ..RodParameters::straight(LENGTH, n_elements, section)
    }
}

fn rest(rod: &Rod) -> Configuration {
    static_equilibrium(rod, &rod.rest, 0.0, &Default::default()).expect("an equilibrium")
}

fn tensions(rod: &Rod, shape: &Configuration) -> Vec<f64> {
    let inputs = rod.actuators.efforts(0.0);
    rod.efforts_at(inputs, &shape.positions, &shape.rotations)
}

/// Around a bend the tension falls by `exp(-μ φ)` and rises by the inverse: on an arc the path turns by `κ s` up to the place `s`.
#[test]
fn the_tension_around_a_bend_is_that_of_a_capstan() {
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        for (direction, sign) in [(1.0, -1.0), (-1.0, 1.0), (0.0, 0.0)] {
            let (curvature, friction, n) = (7.0, 0.3, 24);
            let own = tendon(Route::straight([OFFSET, 0.0]), 2.0, (friction, direction));
            let rod = Rod::new(&RodParameters {
                rest_curvature: Vector3::new(0.0, curvature, 0.0),
                ..arm(n, rule, vec![own])
            })
            .expect("a rod");
            let found = tensions(&rod, &rod.rest);
            assert_eq!(found.len(), 1 + n);
            for (q, tension) in found[1..].iter().enumerate() {
                let turn = curvature * LENGTH * (q as f64 + 0.5) / n as f64;
                let expected = 2.0 * (sign * friction * turn).exp();
                // The rotation vector of a trapezoidal element is that of Cayley, longer by a twelfth of the square of the angle.
                let off = match rule {
                    StrainRule::Helical => 1e-12,
                    StrainRule::Trapezoidal => {
                        friction * turn * (curvature * LENGTH / n as f64).powi(2) / 10.0
                    }
                };
                assert!((tension / expected - 1.0).abs() < off, "{rule:?} {q}");
            }
        }
    }
}

/// The path of a tendon that winds around a straight arm by `ω` per length turns by `ω² d/√(1 + ω² d²)` per length.
#[test]
fn the_path_of_a_helix_turns_along_a_straight_arm() {
    let turns = 2.0;
    let route = Route {
        turns,
        ..Route::straight([OFFSET, 0.0])
    };
    let error = |n: usize| {
        let own = tendon(route, 1.0, (0.2, 1.0));
        let rod = Rod::new(&arm(n, StrainRule::Helical, vec![own])).expect("a rod");
        let rate = std::f64::consts::TAU * turns / LENGTH;
        let turned = rate * rate * OFFSET / (1.0 + (rate * OFFSET).powi(2)).sqrt();
        let last = *tensions(&rod, &rod.rest).last().expect("a line");
        let place = LENGTH * (1.0 - 0.5 / n as f64);
        (last.ln() + 0.2 * turned * place).abs()
    };
    let (coarse, fine) = (error(40), error(80));
    assert!(coarse < 1e-2 && fine < 0.27 * coarse, "{coarse:e} {fine:e}");
}

/// A pulled tendon bends an arm without other loads so that `EI φ' = T₀ d exp(-μ φ)` holds for the turn `φ` of the sections: the tip turns by
/// `ln(1 + μ T₀ d L/EI)/μ`. A released one has `-μ` in its place. The error falls with the square of the elements' length.
#[test]
fn the_bend_of_an_arm_is_the_closed_form() {
    let bending = 1e9 * std::f64::consts::PI * 2e-3f64.powi(4) / 4.0;
    for (direction, friction) in [(1.0, 0.3), (-1.0, 0.3)] {
        let tension = 1.5 * bending / (OFFSET * LENGTH);
        let mu = direction * friction;
        let expected = (1.0 + mu * 1.5f64).ln() / mu;
        let error = |n: usize| {
            let own = tendon(
                Route::straight([OFFSET, 0.0]),
                tension,
                (friction, direction),
            );
            let rod = Rod::new(&arm(n, StrainRule::Helical, vec![own])).expect("a rod");
            let axis = rest(&rod).rotations[rod.tip()] * Vector3::z();
            (axis.x.atan2(axis.z) - expected).abs()
        };
        let (coarse, fine) = (error(20), error(40));
        assert!(fine < 1e-3 && fine < 0.27 * coarse, "{coarse:e} {fine:e}");
    }
}

/// The tangent of a shape under friction is the derivative of its tip along the input, of a tension and of the displacement of a winch, by
/// central differences of equilibria.
#[test]
fn the_jacobian_of_a_tip_is_that_of_differences() {
    let helix = Route {
        turns: 0.3,
        to: 0.8,
        ..Route::straight([0.0, -0.7 * OFFSET])
    };
    for (input, winch, step) in [
        (1.2, None, 1e-3),
        (
            -4e-3,
            Some(Winch {
                compliance: 2e-3,
                outside: 0.1,
            }),
            1e-6,
        ),
    ] {
        let of = |inputs: [f64; 2]| {
            let own = [(Route::straight([OFFSET, 0.0]), 1.0), (helix, -1.0)];
            let actuators =
                (own.iter().zip(inputs)).map(|((route, direction), input)| StrainActuator {
                    winch,
                    largest: 0.0,
                    ..tendon(*route, input, (0.25, *direction))
                });
            let rod = Rod::new(&RodParameters {
                gravity: Vector3::new(0.0, 2.0, 0.0),
                ..arm(8, StrainRule::Helical, actuators.collect())
            });
            let rod = rod.expect("a rod");
            let shape = rest(&rod);
            let wanted = Wanted {
                jacobian: true,
                stability: false,
            };
            let found = shapes_at_rest(&rod, &inputs, wanted, 1, &Default::default());
            let found = found.expect("a shape");
            (
                shape.positions[rod.tip()],
                found[0].jacobian.clone().expect("a jacobian"),
            )
        };
        let here = [input, 0.6 * input];
        let jacobian = of(here).1;
        for i in 0..2 {
            let moved = |size: f64| {
                let mut inputs = here;
                inputs[i] += size;
                of(inputs).0
            };
            let slope = (moved(step) - moved(-step)) / (2.0 * step);
            let error = (jacobian[i] - slope).norm() / slope.norm();
            assert!(error < 2e-5, "{winch:?} {i}: {error:e}");
        }
    }
}
