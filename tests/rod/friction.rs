//! Tendons with friction in motion: what is lost, and the order of the steps.

use nalgebra::Vector3;
use softarm::mechanics::{
    Configuration, Density, Energy, Friction, Material, NodeWrenches, Rod, RodParameters, Route,
    Section, SectionProfile, State, Stepper, StrainActuator, StrainRule, TimeScheme,
};

const LENGTH: f64 = 0.3;

/// The tensions of two tendons, which are pulled and let go one after the other.
fn pulled() -> [Vec<(f64, f64)>; 2] {
    [
        vec![(0.0, 0.3), (0.1, 0.8), (0.3, 0.3)],
        vec![(0.2, 0.3), (0.4, 0.6)],
    ]
}

/// A soft arm between two tendons, bent at rest.
fn arm(
    rule: StrainRule,
    (coefficient, speed): (f64, f64),
    (bend, damping): (f64, f64),
    efforts: [Vec<(f64, f64)>; 2],
) -> Rod {
    let silicone = Material::isotropic(1e5, 0.4, 1070.0);
    let section = SectionProfile::Uniform(Section::circle(&silicone, 0.01));
    let tendon = |x: f64, effort: Vec<(f64, f64)>| StrainActuator {
        name: "tendon".into(),
        density: Density::Shortening,
        scale: 1.0,
        route: Route::straight([x, 0.0]),
        effort,
        winch: None,
        further: Vec::new(),
        friction: Some(Friction {
            coefficient,
            speed,
            at_rest: 0.0,
        }),
        largest: 1.0,
    };
    let [left, right] = efforts;
    Rod::new(&RodParameters {
        strain_rule: rule,
        scheme: TimeScheme::Implicit,
        rest_curvature: Vector3::new(0.0, bend, 0.0),
        viscous_damping: damping,
        actuators: vec![tendon(8e-3, left), tendon(-8e-3, right)],
        ..RodParameters::straight(LENGTH, 8, section)
    })
    .expect("a rod")
}

fn inputs(rod: &Rod, t: f64) -> Vec<f64> {
    rod.actuators.efforts(t)
}

/// Energy of the arm, work of the motors and loss by friction over a motion, and its tip.
fn account(rod: &Rod, step: f64, time: f64) -> ([f64; 3], Vec<f64>, Vector3<f64>) {
    let mut stepper = Stepper::new(rod, step, State::at_rest(rod.rest.clone()));
    let start = Energy::of(rod, &stepper.state()).total();
    let (mut work, mut lost, mut losses) = (0.0, 0.0, Vec::new());
    for k in 0..(time / step).round() as usize {
        let before = stepper.state().configuration;
        stepper.advance([NodeWrenches::NONE; 2]).expect("a step");
        let after = stepper.state().configuration;
        let ends = [0.0, 1.0].map(|end| inputs(rod, (k as f64 + end) * step));
        let mean: Vec<f64> = ends[0]
            .iter()
            .zip(&ends[1])
            .map(|(a, b)| 0.5 * (a + b))
            .collect();
        let poses = [&before, &after].map(Configuration::poses);
        let [y0, y1] =
            [&before, &after].map(|at| rod.actuator_coordinates(&at.positions, &at.rotations));
        work += (0..2).map(|i| mean[i] * (y1[i] - y0[i])).sum::<f64>();
        let loss = rod.friction_loss(&mean, poses, step) * step;
        lost += loss;
        losses.push(loss);
    }
    let state = stepper.state();
    let tip = state.configuration.positions[rod.tip()];
    (
        [Energy::of(rod, &state).total() - start, work, lost],
        losses,
        tip,
    )
}

/// The motors' work is the energy that the arm gains and what friction takes, to second order in the step, and friction never gives.
#[test]
fn friction_takes_what_the_motors_do_and_the_arm_does_not_get() {
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        let rod = arm(rule, (0.3, 5e-3), (2.0, 0.0), pulled());
        let gap = |step: f64| {
            let ([gained, work, lost], losses, _) = account(&rod, step, 0.4);
            assert!(losses.iter().all(|loss| *loss >= 0.0), "{rule:?}");
            assert!(lost > 0.1 * work.abs(), "{rule:?}: {lost:e} {work:e}");
            (gained + lost - work).abs() / lost
        };
        let (coarse, fine) = (gap(2e-3), gap(1e-3));
        eprintln!("{rule:?}: {coarse:e} {fine:e}");
        assert!(
            fine < 1e-2 && fine < 0.4 * coarse,
            "{rule:?}: {coarse:e} {fine:e}"
        );
    }
}

/// Steps are of second order where the speed of sliding is resolved.
#[test]
fn steps_with_friction_are_of_second_order() {
    let smooth = [
        vec![(0.0, 0.0), (0.2, 0.8), (0.4, 0.2)],
        vec![(0.0, 0.0), (0.4, 0.4)],
    ];
    let rod = arm(StrainRule::Helical, (0.3, 5e-2), (5.0, 20.0), smooth);
    let [a, b, c] = [4e-3, 2e-3, 1e-3].map(|step| account(&rod, step, 0.4).2);
    let ratio = (a - b).norm() / (b - c).norm();
    eprintln!("{ratio}");
    assert!((3.0..5.0).contains(&ratio), "{ratio}");
}

/// A tendon that hardly turns has no friction: a straight arm under the same tension on both sides stays straight and keeps its energy.
#[test]
fn where_no_path_turns_nothing_is_lost() {
    let same = [(); 2].map(|()| vec![(0.0, 0.5)]);
    let rod = arm(StrainRule::Helical, (0.5, 1e-3), (0.0, 0.0), same);
    let mut stepper = Stepper::new(&rod, 1e-3, State::at_rest(rod.rest.clone()));
    for _ in 0..100 {
        let before = stepper.state().configuration;
        stepper.advance([NodeWrenches::NONE; 2]).expect("a step");
        let after = stepper.state().configuration;
        let poses = [&before, &after].map(Configuration::poses);
        assert!(rod.friction_loss(&[0.5, 0.5], poses, 1e-3) < 1e-15);
    }
    assert!(stepper.position(rod.tip()).x.abs() < 1e-12);
}

/// An arm that was pulled stays where it is when its tendon is let go a little, while one without friction goes back with it.
#[test]
fn an_arm_sticks_where_its_tendon_is_let_go_a_little() {
    let held = |coefficient: f64| {
        let pull = vec![(0.0, 0.0), (3.0, 0.3), (10.0, 0.3), (10.1, 0.28)];
        let efforts = [pull, vec![(0.0, 0.0)]];
        let rod = arm(
            StrainRule::Helical,
            (coefficient, 1e-6),
            (0.0, 4.0),
            efforts,
        );
        let mut stepper = Stepper::new(&rod, 4e-3, State::at_rest(rod.rest.clone()));
        let mut tips = Vec::new();
        for _ in 0..3750 {
            stepper.advance([NodeWrenches::NONE; 2]).expect("a step");
            tips.push(stepper.position(rod.tip()).x);
        }
        tips[2500] - tips[3749]
    };
    let (with, without) = (held(0.3), held(1e-9));
    eprintln!("{with:e} {without:e}");
    assert!(
        without > 1e-3 && with.abs() < 0.2 * without,
        "{with:e} {without:e}"
    );
}
