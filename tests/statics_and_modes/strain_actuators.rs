//! Tendons, push rods and chambers at rest: closed forms, and values of a shooting method that is independent of any integrator here.
//!
//! The arm of the tendon cases: E 200 GPa, G 80 GPa, radius 1 mm, 8000 kg/m³, 0.5 m along +z, one tendon at 15.06 mm along the first axis
//! with 15 N, after Till's robot (ContinuumRobotExamples, 01_Statics). The reference tips solve the boundary-value problem of a Cosserat rod
//! with the tendon's distributed load by shooting with RK4 (60 and 120 steps).

use nalgebra::Vector3;
use softarm::mechanics::{Configuration, Rod};
use softarm::mechanics::{
    Density, Material, RodParameters, Route, Section, SectionProfile, Stability, StrainActuator,
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
        winch: None,
        further: Vec::new(),
        friction: None,
        largest: 0.0,
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

/// A chamber without gravity bends the arm away from itself and lengthens it, `κ = p A d/EI` and stretch `1 + p A/EA`, exactly for any
/// number of helical elements; the trapezoidal rule has the same curvature measure to second order.
#[test]
fn a_chamber_bends_and_lengthens_exactly() {
    let silicone = Material::isotropic(1e5, 0.4, 1070.0);
    let (radius, length, pressure, area, offset) = (0.01, 0.3, 2e3, 5e-5, 0.006);
    let section = Section::circle(&silicone, radius);
    let chamber = StrainActuator {
        name: "chamber".into(),
        density: Density::Volume,
        scale: area,
        route: Route::straight([offset, 0.0]),
        effort: vec![(0.0, pressure)],
        winch: None,
        further: Vec::new(),
        friction: None,
        largest: 0.0,
    };
    let kappa = -pressure * area * offset / section.angular_stiffness.y;
    let stretch = 1.0 + pressure * area / section.linear_stiffness.z;
    let (turn, arc) = (kappa * length, stretch * length);
    let expected = Vector3::new((1.0 - turn.cos()) / turn, 0.0, turn.sin() / turn) * arc;
    let at = |strain_rule, elements| {
        let (rod, shape) = rest(&RodParameters {
            strain_rule,
            actuators: vec![chamber.clone()],
            ..RodParameters::straight(length, elements, SectionProfile::Uniform(section))
        });
        let y = rod.actuator_coordinates(&shape.positions, &shape.rotations)[0];
        ((shape.positions[rod.tip()] - expected).norm(), y)
    };
    for elements in [1, 2, 7, 20] {
        let (error, volume) = at(StrainRule::Helical, elements);
        assert!(error < 1e-10, "{elements}: {error}");
        // Of the line of centroids, `V = A ∫ (v + κ × d)·e₃ ds`.
        let exact = area * length * (stretch - kappa * offset);
        assert!(
            (volume / exact - 1.0).abs() < 1e-10,
            "{elements}: {volume} {exact}"
        );
    }
    let [coarse, fine] = [160, 320].map(|elements| at(StrainRule::Trapezoidal, elements).0);
    assert!((coarse / fine - 4.0).abs() < 0.3, "{coarse} {fine}");
}

/// A tendon in the axis does not buckle the arm, however far it is above Euler's load: its force turns with the arm.
#[test]
fn a_tendon_in_the_axis_does_not_buckle() {
    let bending = 200e9 * std::f64::consts::PI * 0.25 * 1e-12;
    let euler = bending * (std::f64::consts::PI / (2.0 * LENGTH)).powi(2);
    let (rod, shape) = rest(&wire(
        20,
        1e-6,
        vec![tendon(Route::straight([0.0; 2]), 10.0 * euler)],
    ));
    // A millionth of a meter per second squared bends it by what it bends the arm without the tendon, to the shortening of the arm.
    let (_, free) = rest(&wire(20, 1e-6, Vec::new()));
    let [bent, alone] = [&shape, &free].map(|shape| shape.positions[rod.tip()].x);
    assert!((bent / alone - 1.0).abs() < 1e-3, "{bent} {alone}");
    let stability = Stability::of(&rod, &shape, 0.0).expect("modes");
    assert!(stability.is_stable);
}

/// Till's tendon robot at rest (ContinuumRobotExamples, 02_Dynamics): slack, and under the tensions that his winch has at the start and the
/// end of its ramp.
#[test]
fn tills_robot_at_rest() {
    let (length, radius): (f64, f64) = (0.7144, 0.675e-3);
    let steel = Material::isotropic(
        207e9,
        0.3,
        0.034 / (length * std::f64::consts::PI * radius * radius),
    );
    let section = SectionProfile::Uniform(Section::circle(&steel, radius));
    for (tension, tip) in [
        (0.0, [-0.35627, 0.0, 0.60349]),
        (5.7249, [0.20918, 0.0, 0.64047]),
    ] {
        let parameters = RodParameters {
            gravity: Vector3::new(-9.81, 0.0, 0.0),
            actuators: vec![tendon(Route::straight([OFFSET, 0.0]), tension)],
            ..RodParameters::straight(length, 20, section.clone())
        };
        let off = error(&parameters, tip);
        eprintln!("{tension} N: {off:.2e} m");
        assert!(off < 5e-4, "{tension} N: {off}");
    }
}

/// A braid as long as its fibres allow: its contraction is `p (3 λ² - β²)/(4 π ν²)` and its twisting moment `p λ (β² - λ²)/(4 π² ν³)` (Chou
/// and Hannaford 1996), here at the strain of the arm at rest.
#[test]
fn a_braid_pulls_and_twists() {
    let (fibre, turns, pressure) = (1.3, 25.0, 1e4);
    let braid = StrainActuator {
        name: "braid".into(),
        density: Density::Braid { fibre, turns },
        scale: 1.0,
        route: Route::straight([0.0; 2]),
        effort: vec![(0.0, pressure)],
        winch: None,
        further: Vec::new(),
        friction: None,
        largest: 0.0,
    };
    let rod = Rod::new(&wire(4, 0.0, vec![braid])).expect("a rod");
    let stress = rod
        .active_stress(1, &rod.elements[1].rest, &[pressure])
        .expect("a stress");
    let tau = std::f64::consts::TAU;
    let contraction = pressure * (3.0 - fibre * fibre) / (2.0 * tau * turns * turns);
    let twist = pressure * (fibre * fibre - 1.0) / (tau * tau * turns.powi(3));
    assert!((stress.linear[0].z / contraction - 1.0).abs() < 1e-12);
    assert!((stress.angular.z / twist - 1.0).abs() < 1e-12);
}

/// A tendon that ends at 0.53 of the length: elements end there too, so that the error falls with the square of their length, against a
/// grid of eight times as many.
#[test]
fn a_tendon_ends_where_it_ends() {
    let route = Route {
        from: 0.2,
        to: 0.53,
        ..Route::straight([OFFSET, 0.0])
    };
    let tip = |elements| {
        let (rod, shape) = rest(&wire(elements, 9.81, vec![tendon(route, 15.0)]));
        shape.positions[rod.tip()]
    };
    let fine = tip(320);
    let [coarse, found] = [20, 40].map(|elements| (tip(elements) - fine).amax());
    eprintln!("{coarse:.2e} {found:.2e}");
    assert!(found < 1e-6, "{found}");
    assert!(coarse / found > 3.0, "{coarse} {found}");
}
