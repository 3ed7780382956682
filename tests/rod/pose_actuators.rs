//! Motions under fields and cables: energy, the check's integrator, efforts that jump.

use nalgebra::{Matrix3, Vector3};
use softarm::mechanics::{
    Cable, Energy, Magnet, Material, NodeWrenches, OfPose, Place, PoseActuator, Rod, RodModel,
    RodParameters, Section, SectionProfile, Span, State, Stepper, StrainRule, TimeScheme,
    stable_step,
};
use softarm::verify::ReferenceStepper;

/// A soft arm with a magnet at its tip and a magnetized stretch in a field with a gradient, and a cable beside its axis.
fn arm(rule: StrainRule, model: RodModel, scheme: TimeScheme, efforts: [&[(f64, f64)]; 2]) -> Rod {
    let silicone = Material::isotropic(1e5, 0.4, 1070.0);
    let section = SectionProfile::Uniform(Section::circle(&silicone, 0.01));
    let magnet = |moment: [f64; 3]| {
        OfPose::Magnet(Magnet {
            moment: Vector3::from(moment),
            field: Vector3::new(1.0, 0.3, 0.0),
            gradient: Matrix3::new(1.0, 0.3, -0.2, 0.3, -0.4, 0.5, -0.2, 0.5, -0.6),
            center: Vector3::zeros(),
        })
    };
    let cable = OfPose::Cable(Cable {
        offset: Vector3::new(0.01, 0.0, 0.0),
        anchor: Vector3::new(0.2, 0.1, 0.1),
    });
    let actuator = |parts, effort: &[(f64, f64)]| PoseActuator {
        name: String::new(),
        unit: "",
        parts,
        effort: effort.to_vec(),
        largest: 0.0,
    };
    let fields = vec![
        (Span::At(Place::Tip), magnet([0.0, 0.02, 0.1])),
        (Span::Along(0.25, 0.6), magnet([0.0, 0.0, 0.2])),
    ];
    Rod::new(&RodParameters {
        strain_rule: rule,
        model,
        scheme,
        gravity: Vector3::new(-9.81, 0.0, 0.0),
        rest_curvature: Vector3::new(0.0, 2.0, 1.0),
        pose_actuators: vec![
            actuator(fields, efforts[0]),
            actuator(vec![(Span::At(Place::Fraction(0.6)), cable)], efforts[1]),
        ],
        ..RodParameters::straight(0.3, 10, section)
    })
    .expect("a rod")
}

const CASES: [(RodModel, TimeScheme); 3] = [
    (RodModel::Standard, TimeScheme::Explicit),
    (RodModel::Consistent, TimeScheme::Explicit),
    (RodModel::Standard, TimeScheme::Implicit),
];

fn potential(rod: &Rod, state: &State) -> f64 {
    let at = &state.configuration;
    let efforts = rod.actuators.efforts(0.0);
    Energy::of(rod, state).total() + rod.actuator_energy(&at.positions, &at.rotations, &efforts)
}

/// Runs for a time, and returns the largest change of energy less `Σ u y`.
fn wander(rod: &Rod, step: f64, duration: f64) -> f64 {
    let mut stepper = Stepper::new(rod, step, State::at_rest(rod.rest.clone()));
    let start = potential(rod, &stepper.state());
    (0..(duration / step).round() as usize)
        .map(|_| {
            stepper.advance([NodeWrenches::NONE; 2]).expect("a step");
            (potential(rod, &stepper.state()) - start).abs()
        })
        .fold(0.0, f64::max)
}

/// With constant efforts what `E - Σ u y` wanders falls with the square of the step: the work of fields and cables is that of their
/// coordinates.
#[test]
fn energy_and_efforts_on_poses_balance() {
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        for (model, scheme) in CASES {
            let rod = arm(rule, model, scheme, [&[(0.0, 0.05)], &[(0.0, 0.1)]]);
            let step = 0.5 * stable_step(&rod);
            let coarse = wander(&rod, step, 0.2);
            let fine = wander(&rod, 0.5 * step, 0.2);
            eprintln!("{rule:?} {model:?} {scheme:?}: {coarse:e} {fine:e}");
            assert!(
                fine < 0.35 * coarse,
                "{rule:?} {model:?} {scheme:?}: {coarse:e} {fine:e}"
            );
        }
    }
}

/// The check's integrator, which differentiates the coordinates by itself, makes the same motion, also where efforts change and jump
/// between time nodes.
#[test]
fn the_reference_makes_the_same_motion() {
    let field = [(0.0, 0.0), (0.02, 0.05), (0.0313, 0.05), (0.0313, -0.03)];
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        for (model, scheme) in CASES {
            let rod = arm(rule, model, scheme, [&field, &[(0.0, 0.1), (0.05, 0.0)]]);
            let step = 0.5 * stable_step(&rod);
            let start = State::at_rest(rod.rest.clone());
            let mut stepper = Stepper::new(&rod, step, start.clone());
            let mut reference = ReferenceStepper::new(&rod, step, start);
            let n = (0.06 / step).round() as usize;
            for _ in 0..n {
                stepper.advance([NodeWrenches::NONE; 2]).expect("a step");
                reference.advance([NodeWrenches::NONE; 2]).expect("a step");
            }
            let (found, expected) = (stepper.state(), reference.state());
            let tip = rod.tip();
            let moved = found.configuration.positions[tip] - rod.rest.positions[tip];
            assert!(moved.norm() > 1e-3, "{moved}");
            let off = found.configuration.positions[tip] - expected.configuration.positions[tip];
            // Rounding of some thousand steps; the reference solves implicit steps to a part in 1e10.
            let allowed = if scheme == TimeScheme::Implicit {
                1e-9
            } else {
                1e-12
            };
            assert!(off.norm() < allowed, "{rule:?} {model:?} {scheme:?}: {off}");
        }
    }
}
