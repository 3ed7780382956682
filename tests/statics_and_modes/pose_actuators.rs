//! Magnets and cables at rest: closed forms.

use nalgebra::{Matrix3, Vector3};
use softarm::mechanics::{
    Cable, Configuration, Load, LoadFrame, Magnet, NodeInertia, OfPose, Place, PoseActuator, Rod,
    RodParameters, Section, SectionProfile, SmallMotions, Span, static_equilibrium,
};

/// Length (m) and bending stiffness (N m²) of the soft tip of the simulator mCR.
const LENGTH: f64 = 0.034;
const BENDING: f64 = 2.80e-6;

/// The soft tip of mCR's guidewire as an arm that hardly stretches and shears.
fn guidewire(n_elements: usize, parts: Vec<(Span, OfPose)>, effort: f64) -> RodParameters {
    let section = Section {
        linear_stiffness: Vector3::new(1.0, 1.0, 1.0) * (1e6 * BENDING / LENGTH.powi(2)),
        angular_stiffness: Vector3::new(BENDING, BENDING, BENDING),
        mass: 1e-3,
        rotary: Vector3::repeat(1e-10),
    };
    RodParameters {
        pose_actuators: vec![PoseActuator {
            name: "field".into(),
            unit: "T",
            parts,
            effort: vec![(0.0, effort)],
            largest: 0.0,
        }],
        ..RodParameters::straight(LENGTH, n_elements, SectionProfile::Uniform(section))
    }
}

fn magnet(moment: Vector3<f64>, field: Vector3<f64>) -> OfPose {
    OfPose::Magnet(Magnet {
        moment,
        field,
        gradient: Matrix3::zeros(),
        center: Vector3::zeros(),
    })
}

fn rest(parameters: &RodParameters) -> (Rod, Configuration) {
    let rod = Rod::new(parameters).expect("a rod");
    let shape =
        static_equilibrium(&rod, &rod.rest, 0.0, &Default::default()).expect("an equilibrium");
    (rod, shape)
}

/// A magnet at the tip in a field across the arm: `k L = (m B L/EI) cos k L`, an arc, which helical elements represent exactly; mCR's
/// magnet of 3.73e-3 A m² in 10, 20 and 40 mT.
#[test]
fn a_magnet_at_the_tip_bends_the_arm_into_an_arc() {
    let table = [
        (0.01, 23.753, 6.947e-3),
        (0.02, 39.848, 11.354e-3),
        (0.04, 56.816, 15.521e-3),
    ];
    for (field, degrees, aside) in table {
        for elements in [1, 4, 16] {
            let part = magnet(Vector3::z() * 3.73e-3, Vector3::x());
            let parts = vec![(Span::At(Place::Tip), part)];
            let (rod, shape) = rest(&guidewire(elements, parts, field));
            let tip = rod.tip();
            let along = shape.rotations[tip] * Vector3::z();
            let angle = along.x.atan2(along.z).to_degrees();
            // Digits of the table; the arm stretches by 1e-9.
            assert!((angle - degrees).abs() < 6e-4, "{elements}: {angle}");
            let x = shape.positions[tip].x;
            assert!((x - aside).abs() < 6e-7, "{elements}: {x}");
        }
    }
}

/// An arm that is magnetized evenly along its axis is bent by a field as by a dead force `M B` per length times the length on its tip: the
/// elastica, `A M B L²/EI = 4`, with its tip at (0.66996, 0.67106) of the length; the error falls with the square of the elements.
#[test]
fn an_arm_magnetized_along_its_axis_is_one_with_a_force_on_its_tip() {
    // The whole moment A M L times B over L is the force.
    let moment = Vector3::z() * 1e-3;
    let field = 4.0 * BENDING / (LENGTH * moment.z);
    let elastica = Vector3::new(0.66996, 0.0, 0.67106);
    let magnetized = |elements| {
        let parts = vec![(Span::Along(0.0, 1.0), magnet(moment, Vector3::x()))];
        let (rod, shape) = rest(&guidewire(elements, parts, field));
        shape.positions[rod.tip()] / LENGTH
    };
    let forced = |elements| {
        let mut parameters = guidewire(elements, Vec::new(), 0.0);
        parameters.loads = vec![Load {
            node: elements,
            force: Vector3::x() * (4.0 * BENDING / LENGTH.powi(2)),
            moment: Vector3::zeros(),
            frame: LoadFrame::Spatial,
            profile: Vec::new(),
        }];
        let (rod, shape) = rest(&parameters);
        shape.positions[rod.tip()] / LENGTH
    };
    // Of second order, so that a third of the last difference is the error that is left.
    let reference = (forced(80) * 4.0 - forced(40)) / 3.0;
    // Five digits, and a stretch of the order of 4e-6 here.
    assert!((reference - elastica).norm() < 2e-5, "{reference}");
    let found = [10, 20, 40].map(|elements| (magnetized(elements) - reference).norm());
    eprintln!("{found:?}");
    for pair in found.windows(2) {
        assert!((pair[0] / pair[1] - 4.0).abs() < 0.4, "{found:?}");
    }
}

/// A field against the magnet turns a deviation `θ` of the tip on, by the moment `m B θ`, and the straight arm, whose tip resists by `EI θ/L`,
/// loses its stability where `m B L/EI = 1`.
#[test]
fn a_field_against_the_magnet_buckles_the_arm() {
    let critical = BENDING / (3.73e-3 * LENGTH);
    for (factor, stable) in [(0.99, true), (1.01, false)] {
        let part = magnet(Vector3::z() * 3.73e-3, -Vector3::z());
        let parts = vec![(Span::At(Place::Tip), part)];
        let rod = Rod::new(&guidewire(10, parts, factor * critical)).expect("a rod");
        let motions = SmallMotions::about(&rod, &rod.rest, 0.0);
        assert_eq!(motions.squared_frequency(0) > 0.0, stable, "{factor}");
    }
}

/// A cable that is attached beside the axis pulls along the line to its anchor: force and moment of the equilibrium are those of the base,
/// `T t` and the lever of the attachment, which the bent arm carries.
#[test]
fn a_cable_pulls_toward_its_anchor() {
    let (offset, anchor, tension) = (
        Vector3::new(2e-3, 0.0, 0.0),
        Vector3::new(0.03, 0.01, 0.01),
        2e-3,
    );
    let cable = OfPose::Cable(Cable { offset, anchor });
    let mut parameters = guidewire(20, vec![(Span::At(Place::Fraction(0.53)), cable)], tension);
    parameters.bodies = vec![(
        0.53,
        NodeInertia {
            mass: 0.0,
            rotary: Vector3::zeros(),
        },
    )];
    let (rod, shape) = rest(&parameters);
    let node = rod
        .mesh
        .node_at(0.53)
        .expect("elements end where a cable is attached");
    let attached = shape.positions[node] + shape.rotations[node] * offset;
    let pull = (anchor - attached).normalize() * tension;
    // The stress of the first element carries force and moment of the cable about its middle.
    let pose = Rod::element_pose(0, &shape.positions, &shape.rotations);
    let gradient = rod.elements[0].gradient(rod.strain_rule, &pose);
    assert!(
        (gradient.force - pull).norm() < 1e-7 * tension,
        "{}",
        gradient.force
    );
    let lever = (attached - shape.positions[0]).cross(&pull);
    let moment = -(shape.rotations[0] * gradient.moment_a);
    assert!((moment - lever).norm() < 1e-7 * tension, "{moment} {lever}");
}
