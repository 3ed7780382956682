//! Tendons, push rods and chambers at rest: closed forms, and values of a shooting method that is independent of any integrator here.
//!
//! The arm of the tendon cases: E 200 GPa, G 80 GPa, radius 1 mm, 8000 kg/m³, 0.5 m along +z, one tendon at 15.06 mm along the first axis
//! with 15 N, after Till's robot (ContinuumRobotExamples, 01_Statics). The reference tips solve the boundary-value problem of a Cosserat rod
//! with the tendon's distributed load by shooting with RK4 (60 and 120 steps).

use nalgebra::Vector3;
use softarm::mechanics::{Configuration, Rod};
use softarm::mechanics::{
    Density, Material, RodModel, RodParameters, Route, Section, SectionProfile, StrainActuator,
    StrainRule, static_equilibrium,
};

const LENGTH: f64 = 0.5;
const OFFSET: f64 = 0.01506;

fn tendon(route: Route, tension: f64) -> StrainActuator {
    StrainActuator {
        name: String::new(),
        density: Density::Shortening,
        scale: 1.0,
        route,
        effort: vec![(0.0, tension)],
    }
}

fn wire(n_elements: usize, gravity: f64, actuators: Vec<StrainActuator>) -> RodParameters {
    let steel = Material {
        youngs_modulus: 200e9,
        shear_modulus: 80e9,
        density: 8000.0,
        shear_factor: 1.0,
    };
    let section = SectionProfile::Uniform(Section::circle(&steel, 1e-3));
    RodParameters {
        gravity: Vector3::new(gravity, 0.0, 0.0),
        actuators,
        ..RodParameters::straight(LENGTH, n_elements, section)
    }
}

fn rest(parameters: &RodParameters) -> (Rod, Configuration) {
    let rod = Rod::new(parameters).expect("a rod");
    let shape =
        static_equilibrium(&rod, &rod.rest, 0.0, &Default::default()).expect("an equilibrium");
    (rod, shape)
}

/// Largest component by which the tip differs from a place, m.
fn error(parameters: &RodParameters, tip: [f64; 3]) -> f64 {
    let (rod, shape) = rest(parameters);
    (shape.positions[rod.tip()] - Vector3::from(tip)).amax()
}

/// Without gravity a parallel tendon bends the arm into an arc, `EI κ = T d (1 + ...)`, which helical elements represent exactly.
#[test]
fn a_parallel_tendon_without_gravity_makes_an_arc() {
    for elements in [1, 3, 10, 40] {
        let parameters = wire(
            elements,
            0.0,
            vec![tendon(Route::straight([OFFSET, 0.0]), 15.0)],
        );
        let (rod, shape) = rest(&parameters);
        let tip = shape.positions[rod.tip()];
        let expected = Vector3::new(0.172_148_020, 0.0, 0.458_001_854);
        assert!((tip - expected).amax() < 1e-8, "{elements}: {tip}");
        let y = rod.actuator_coordinates(&shape.positions, &shape.rotations)[0];
        assert!((-y - 0.489_158_989).abs() < 1e-8, "{elements}: length {y}");
    }
}

/// With gravity across the arm, along parallel, helical and converging lines, the error falls with the square of the elements' length.
#[test]
fn tendons_under_gravity_converge_to_shooting() {
    let helical = Route {
        turns: 1.0,
        ..Route::straight([OFFSET, 0.0])
    };
    let converging = Route {
        offset_to: [0.5 * OFFSET, 0.0],
        ..Route::straight([OFFSET, 0.0])
    };
    let cases = [
        (
            Route::straight([OFFSET, 0.0]),
            [0.182_211_694_5, 0.0, 0.453_229_270_9],
            [2.8e-6, 7.1e-7],
        ),
        (
            helical,
            [0.012_209_95, 0.058_188_82, 0.493_348_33],
            [5.3e-5, 1.3e-5],
        ),
        (
            converging,
            [0.156_536_282_5, 0.0, 0.467_760_172_0],
            [3.65e-5, 9e-6],
        ),
    ];
    for (route, tip, expected) in cases {
        let of = |elements| error(&wire(elements, 9.81, vec![tendon(route, 15.0)]), tip);
        let found = [of(20), of(40)];
        eprintln!("{route:?}: {found:?}");
        assert!((found[0] / found[1] - 4.0).abs() < 0.4, "{found:?}");
        for (found, expected) in found.into_iter().zip(expected) {
            assert!(found < 1.1 * expected, "{found:e}, {expected:e}");
        }
    }
}
