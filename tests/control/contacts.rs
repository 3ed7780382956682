//! Contacts in optimal control: derivatives, and reaches that lean on a body.

use nalgebra::Vector3;
use softarm::control::{
    ActuatedNode, Bound, Channel, ControlGrid, Goal, Hold, OptimalControlProblem, Shape,
};
use softarm::derivatives::{Verdict, check};
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{
    Contact, Material, Rod, RodModel, RodParameters, Section, SectionProfile, State, StrainRule,
    TimeGrid, TimeScheme, stable_step,
};

fn contact(shape: Shape, part: [f64; 2]) -> Contact {
    Contact {
        name: "body".into(),
        shape,
        part,
        force: 1.0,
        penetration: 2e-3,
    }
}

/// An arm that begins a millimeter deep in a wall with its whole length, in a ball, in the edge of a box and in a bar.
fn problem(
    rule: StrainRule,
    model: RodModel,
    scheme: TimeScheme,
    damping: [f64; 2],
) -> OptimalControlProblem {
    let silicone = Material::isotropic(1e5, 0.4, 1070.0);
    let section = SectionProfile::Uniform(Section::circle(&silicone, 0.01));
    let wall = Shape::HalfSpace {
        point: Vector3::new(-9e-3, 0.0, 0.0),
        normal: Vector3::x(),
    };
    let ball = Shape::Sphere {
        center: Vector3::new(0.0, 0.1082, 0.21),
        radius: 0.1,
    };
    // An edge faces the tip, so that its nodes are near neither face.
    let edge = Shape::Cuboid {
        center: Vector3::new(0.0, -0.017, 0.3),
        rotation: exp(&Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_4)),
        half_size: Vector3::new(0.01, 0.01, 0.07) / std::f64::consts::SQRT_2,
    };
    let bar = Shape::Capsule {
        from: Vector3::new(0.0174, -0.1, 0.27),
        to: Vector3::new(0.0174, 0.1, 0.27),
        radius: 0.01,
    };
    let rod = Rod::new(&RodParameters {
        strain_rule: rule,
        model,
        scheme,
        gravity: Vector3::new(-9.81, 0.0, 0.0),
        viscous_damping: damping[0],
        internal_damping: damping[1],
        radii: vec![(0.0, 0.012), (1.0, 0.008)],
        contacts: vec![
            contact(wall, [0.0, 1.0]),
            contact(ball, [0.3, 0.9]),
            contact(edge, [0.7, 1.0]),
            contact(bar, [0.0, 1.0]),
        ],
        ..RodParameters::straight(0.3, 5, section)
    })
    .expect("a rod");
    let grid = TimeGrid {
        start: 0.0,
        step: 0.4 * stable_step(&rod),
        n_steps: 60,
    };
    let control = ControlGrid::new(Hold::Linear, 5, grid.n_steps, grid.step).expect("blocks");
    let channel = |scale: f64| Channel::new(scale, Some(Bound::PerAxis(Vector3::repeat(scale))));
    let initial = State::at_rest(rod.rest.clone());
    let goal = Goal::reach(&rod, grid, Vector3::new(0.05, 0.02, 0.28));
    let mut problem = OptimalControlProblem::least_effort(
        rod,
        grid,
        initial,
        control,
        [channel(0.01), channel(1e-3)],
        goal,
    );
    let beside = ActuatedNode {
        node: 3,
        force: channel(0.05),
        moment: channel(0.01),
    };
    problem.channels.extend(beside.channels());
    problem
}

/// Gradients, Jacobians, the Hessian and the linearized step agree with differences while an arm presses against a wall, a ball, an edge and
/// a bar, under all rules, schemes and dampings.
#[test]
fn derivatives_in_contact_are_derivatives() {
    use TimeScheme::{Explicit, Implicit};
    let mut failed = Vec::new();
    for rule in [StrainRule::Helical, StrainRule::Trapezoidal] {
        for (model, scheme, damping) in [
            (RodModel::Standard, Explicit, [0.5, 0.0]),
            (RodModel::Standard, Explicit, [0.0, 2e-3]),
            (RodModel::Consistent, Explicit, [0.5, 0.0]),
            (RodModel::Dilatation, Explicit, [0.5, 0.0]),
            (RodModel::Standard, Implicit, [0.5, 0.0]),
            (RodModel::Standard, Implicit, [0.5, 2e-3]),
        ] {
            let problem = problem(rule, model, scheme, damping);
            let depths = problem.rod.depths(&problem.rod.rest.positions);
            assert!(depths.iter().all(|own| own.depth > 5e-4), "{depths:?}");
            let report = check(&problem, 7).expect("a motion");
            assert!((report.blocks.iter()).any(|block| block.name == "poses.tangent"));
            let wrong: Vec<_> = (report.blocks.iter())
                .filter(|block| block.verdict != Verdict::Ok)
                .map(|block| format!("{}: {:?} {:?}", block.name, block.verdict, block.worst))
                .collect();
            if !wrong.is_empty() {
                failed.push(format!(
                    "{rule:?} {model:?} {scheme:?} {damping:?}: {wrong:#?}"
                ));
            }
        }
    }
    assert!(failed.is_empty(), "{}", failed.join("\n"));
}
