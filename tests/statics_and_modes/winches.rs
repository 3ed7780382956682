//! Tendons on winches at rest: Till's dynamic robot under given displacements of its winch.
//!
//! Till et al. 2019 (ContinuumRobotExamples, 02_Dynamics): E 207 GPa, ν 0.3, radius 0.675 mm, 34 g, 0.7144 m along +z, one tendon at
//! 15.06 mm along the first axis, gravity along -x, 51.8 mm of the tendon outside of the arm, compliance 1e-4 /N. The reference values solve
//! the boundary-value problem of a Cosserat rod by shooting with RK4 (60 and 120 steps), with `ℓ + b = (L + b + z)(1 + C T)`.

use nalgebra::Vector3;
use softarm::mechanics::{
    Configuration, Density, Load, LoadFrame, LoadPath, Material, Rod, RodParameters, Route,
    Section, SectionProfile, StrainActuator, Varied, Winch, static_equilibrium,
};
use softarm::stop::StopSignal;

const LENGTH: f64 = 0.7144;
const RADIUS: f64 = 0.675e-3;

fn robot(n_elements: usize, displacement: f64) -> RodParameters {
    let volume = std::f64::consts::PI * RADIUS * RADIUS * LENGTH;
    let steel = Material {
        shear_factor: 1.0,
        ..Material::isotropic(207e9, 0.3, 0.034 / volume)
    };
    let section = SectionProfile::Uniform(Section::circle(&steel, RADIUS));
    RodParameters {
        gravity: Vector3::new(-9.81, 0.0, 0.0),
        actuators: vec![StrainActuator {
            name: "tendon".into(),
            density: Density::Shortening,
            scale: 1.0,
            route: Route::straight([0.01506, 0.0]),
            effort: vec![(0.0, displacement)],
            winch: Some(Winch {
                compliance: 1e-4,
                outside: 0.0518,
            }),
            further: Vec::new(),
            friction: None,
            largest: 0.0,
        }],
        ..RodParameters::straight(LENGTH, n_elements, section)
    }
}

/// Returns the arm at rest, the place of its tip and the tension.
fn rest(n_elements: usize, displacement: f64) -> (Rod, Configuration, Vector3<f64>, f64) {
    let rod = Rod::new(&robot(n_elements, displacement)).expect("a rod");
    let shape =
        static_equilibrium(&rod, &rod.rest, 0.0, &Default::default()).expect("an equilibrium");
    let inputs = rod.actuators.efforts(0.0);
    let tension = rod.efforts_at(inputs, &shape.positions, &shape.rotations)[0];
    let tip = shape.positions[rod.tip()];
    (rod, shape, tip, tension)
}

/// Slack, at zero and pulled in by 16.19 mm: the tip is within 0.4 mm of shooting at 20 elements and four times nearer at 40, and so is the
/// tension; a slack tendon has no tension and no effect.
#[test]
fn the_robot_of_till_rests_where_its_winch_pulls_it() {
    let cases = [
        (0.1, 0.0, [-0.35627, 0.0, 0.60349]),
        (0.0, 2.5078, [-0.14781, 0.0, f64::NAN]),
        (-16.19e-3, 5.7249, [0.20918, 0.0, 0.64047]),
    ];
    for (displacement, tension, tip) in cases {
        let found = [10, 20, 40, 80].map(|elements| {
            let (_, _, tip, tension) = rest(elements, displacement);
            (tip, tension)
        });
        let off = |(at, _): &(Vector3<f64>, f64)| {
            let axes = (0..3).filter(|&axis| tip[axis].is_finite());
            axes.map(|axis| (at[axis] - tip[axis]).abs())
                .fold(0.0, f64::max)
        };
        let errors = found.each_ref().map(off);
        let tensions = found.each_ref().map(|(_, t)| t - tension);
        eprintln!("z = {displacement}: tip {errors:?} m, tension {tensions:?} N");
        assert!(errors[1] < 0.4e-3, "{errors:?}");
        // Digits of the reference.
        assert!(errors[3] < errors[1] / 16.0 + 1e-5, "{errors:?}");
        assert!(
            tensions[3].abs() < tensions[1].abs() / 16.0 + 1e-4,
            "{tensions:?}"
        );
        let change = |a: usize| (found[a].0 - found[a + 1].0).norm();
        assert!(
            (change(1) / change(2) - 4.0).abs() < 0.4,
            "order of the tip"
        );
        if tension == 0.0 {
            assert!(found.iter().all(|(_, tension)| *tension == 0.0));
        }
    }
}

/// The relation of the winch holds at the equilibrium, and a winch that has a displacement gives the tension from which this displacement
/// is computed back.
#[test]
fn tension_and_displacement_belong_together() {
    for displacement in [0.0, -5e-3, -16.19e-3] {
        let (rod, shape, _, tension) = rest(20, displacement);
        let y = rod.actuator_coordinates(&shape.positions, &shape.rotations)[0];
        let (length, outside, compliance) = (-y, 0.0518, 1e-4);
        let right = (LENGTH + outside + displacement) * (1.0 + compliance * tension);
        assert!((length + outside - right).abs() < 1e-14, "{length} {right}");
        let winch = rod
            .actuators
            .iter()
            .next()
            .and_then(|own| own.winch)
            .expect("a winch");
        let back = winch.displacement(tension, y, rod.actuators.at_rest()[0]);
        assert!((back - displacement).abs() < 1e-15, "{back}");
    }
}

/// A force across the tip moves an arm whose winch holds less than one whose tendon keeps its tension, and the shape under the force is that
/// of the arm whose tendon has the tension which the winch then has.
#[test]
fn a_winch_stiffens_the_arm() {
    let push = |parameters: RodParameters, force: f64| {
        let rod = Rod::new(&RodParameters {
            loads: vec![Load {
                node: 20,
                force: Vector3::new(force, 0.0, 0.0),
                moment: Vector3::zeros(),
                frame: LoadFrame::Spatial,
                profile: Vec::new(),
            }],
            ..parameters
        })
        .expect("a rod");
        let shape =
            static_equilibrium(&rod, &rod.rest, 0.0, &Default::default()).expect("an equilibrium");
        let inputs = rod.actuators.efforts(0.0);
        let tension = rod.efforts_at(inputs, &shape.positions, &shape.rotations)[0];
        (shape.positions[rod.tip()], tension)
    };
    let with_tension = |tension: f64| {
        let mut parameters = robot(20, 0.0);
        parameters.actuators[0].winch = None;
        parameters.actuators[0].effort = vec![(0.0, tension)];
        parameters
    };
    let winch = || robot(20, -16.19e-3);
    let (start, before) = push(winch(), 0.0);
    let (held, after) = push(winch(), 0.05);
    let (loose, _) = push(with_tension(before), 0.05);
    let (same, _) = push(with_tension(after), 0.05);
    eprintln!("{before} {after}: {} {}", held - start, loose - start);
    assert!(after < before, "the force slackens the tendon");
    assert!((held - start).norm() < 0.5 * (loose - start).norm());
    assert!((same - held).norm() < 1e-8, "{}", (same - held).norm());
}

/// A weightless arm bends into an arc under its winch, whose tension is a closed form: with the strain `-T/EA` and the curvature `T d/EI` the
/// tendon keeps `L (1 - T/EA - T d²/EI)` inside of the arm, and `ℓ + b = (L + b + z)(1 + C T)` is linear in `T`. It is found for sections
/// from a thousand times softer to a hundred times stiffer than the tendon's hold on them, and along the path of the loads.
#[test]
fn winches_are_found_at_any_stiffness() {
    let (length, radius, offset, compliance, outside) = (0.1865, 0.5e-3, 4.5e-3, 1.4e-5, 10.0);
    for modulus in [1e6, 1e7, 2.5e7, 5e7, 1e8, 1e9, 1e10, 1e11] {
        let section = Section::circle(&Material::isotropic(modulus, 0.3, 2e4), radius);
        let (axial, bending) = (section.linear_stiffness.z, section.angular_stiffness.y);
        let tension = |z: f64| {
            let inside = length / axial + length * offset * offset / bending;
            -z / (inside + compliance * (length + outside + z))
        };
        let rod = |z: f64| {
            let parameters = RodParameters {
                actuators: vec![StrainActuator {
                    name: "tendon".into(),
                    density: Density::Shortening,
                    scale: 1.0,
                    route: Route::straight([offset, 0.0]),
                    effort: vec![(0.0, z)],
                    winch: Some(Winch {
                        compliance,
                        outside,
                    }),
                    further: Vec::new(),
                    friction: None,
                    largest: 0.0,
                }],
                ..RodParameters::straight(length, 9, SectionProfile::Uniform(section))
            };
            Rod::new(&parameters).expect("a rod")
        };
        let assert_arc = |rod: &Rod, z: f64, shape: &Configuration| {
            let found = rod.efforts_at(vec![z], &shape.positions, &shape.rotations)[0];
            let exact = tension(z);
            // Newton's method ends at 1e-9 of EI/L², and the rounding of positions is the stretch of the tendon outside.
            let rounding = 1e-9 * bending / (length * length) + 1e-15 / (compliance * length);
            assert!(
                (found - exact).abs() < 1e-7 * exact + rounding,
                "{modulus:e}: {found} {exact}"
            );
            let (bent, stretch) = (exact * offset / bending, 1.0 - exact / axial);
            let aside = stretch * (1.0 - (bent * length).cos()) / bent;
            let tip = shape.positions[rod.tip()];
            assert!(
                (tip.xy().norm() - aside).abs() < 1e-6 * length,
                "{modulus:e}: {tip} {aside}"
            );
        };
        let pulled = rod(-1e-3);
        let shape = static_equilibrium(&pulled, &pulled.rest, 0.0, &Default::default());
        assert_arc(&pulled, -1e-3, &shape.expect("an equilibrium"));
        let stop = StopSignal::default();
        let path = LoadPath::new(&pulled, Varied::All, 0.0, None, &stop).expect("a held base");
        assert!(path.is_loaded());
        let half = path
            .at(&path.start().expect("a start"), 0.5)
            .expect("an equilibrium");
        assert_arc(&rod(-0.5e-3), -0.5e-3, &half.shape);
    }
}
