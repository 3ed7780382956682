//! Efforts of tendons, chambers and their kind as controls: derivatives, and what an actuator written anew makes of the same tendon.

use nalgebra::Vector3;
use softarm::control::{
    ActuatedNode, Bound, Channel, ControlGrid, Goal, Hold, OptimalControlProblem,
};
use softarm::derivatives::{Verdict, check};
use softarm::mechanics::{
    Density, Efforts, Material, Rod, RodModel, RodParameters, Route, Section, SectionProfile,
    State, StrainActuator, StrainRule, TimeGrid, TimeScheme, TipSpring, stable_step,
    static_equilibrium,
};
use softarm::solve::solve;
use softarm::task::{Arm, Discretization, EffortControl, StartShape, Staying, Task};

/// A helical tendon over a part of the arm, a converging push rod, a chamber, a muscle and a braid, with given efforts.
fn actuators() -> Vec<StrainActuator> {
    let of = |density, scale, route, effort: f64| StrainActuator {
        name: String::new(),
        density,
        scale,
        route,
        effort: vec![(0.0, effort)],
    };
    let helix = Route {
        from: 0.1,
        to: 0.83,
        turns: 0.7,
        ..Route::straight([8e-3, 2e-3])
    };
    let cone = Route {
        offset_to: [2e-3, -4e-3],
        ..Route::straight([-3e-3, -8e-3])
    };
    let short = Route {
        to: 0.6,
        ..Route::straight([-6e-3, 0.0])
    };
    let braid = Density::Braid {
        fibre: 2.0,
        turns: 30.0,
    };
    vec![
        of(Density::Shortening, 1.0, helix, 0.3),
        of(Density::Lengthening, 1.0, cone, 0.1),
        of(Density::Volume, 1e-4, Route::straight([0.0, 7e-3]), 1e3),
        of(Density::Muscle, 1.0, short, 0.3),
        of(braid, 1.0, Route::straight([0.0, -5e-3]), 50.0),
    ]
}

fn problem(
    rule: StrainRule,
    model: RodModel,
    scheme: TimeScheme,
    damping: [f64; 2],
) -> OptimalControlProblem {
    let silicone = Material::isotropic(1e5, 0.4, 1070.0);
    let section = SectionProfile::Uniform(Section::circle(&silicone, 0.01));
    let rod = Rod::new(&RodParameters {
        strain_rule: rule,
        model,
        scheme,
        gravity: Vector3::new(-9.81, 0.0, 0.0),
        viscous_damping: damping[0],
        internal_damping: damping[1],
        actuators: actuators(),
        ..RodParameters::straight(0.3, 5, section)
    })
    .expect("a rod");
    let grid = TimeGrid {
        start: 0.0,
        step: 0.4 * stable_step(&rod),
        n_steps: 60,
    };
    let control = ControlGrid::new(Hold::Linear, 5, grid.n_steps, grid.step).expect("blocks");
    let channel =
        |scale: [f64; 3]| Channel::new(scale[0], Some(Bound::PerAxis(Vector3::from(scale))));
    let none = Channel::new(1.0, Some(Bound::PerAxis(Vector3::zeros())));
    let initial = State::at_rest(rod.rest.clone());
    let goal = Goal::reach(&rod, grid, Vector3::new(0.05, 0.02, 0.28));
    let mut problem =
        OptimalControlProblem::least_effort(rod, grid, initial, control, [none, none], goal);
    let efforts = |scale: f64| channel([scale; 3]);
    problem.actuators[0].force = channel([0.01; 3]);
    problem.actuators.push(ActuatedNode {
        node: 0,
        force: efforts(0.2),
        moment: efforts(0.5),
    });
    // The chamber and the braid, whose unit is another, are given; the tendon, the rod and the muscle are driven.
    problem.efforts = Some(Efforts {
        actuators: vec![0, 1, 3],
        first: 1,
        places: vec![0, 1, 3],
    });
    problem.actuators[1].force.axes = [true, true, false];
    problem.actuators[1].moment.axes = [true, false, false];
    problem
}

/// Gradients, Jacobians, the Hessian and the linearized step agree with differences, under all rules, schemes and dampings.
#[test]
fn derivatives_of_efforts_are_derivatives() {
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
            let report = check(&problem(rule, model, scheme, damping), 7).expect("a motion");
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

/// A soft arm that hangs, with four parallel tendons.
fn four_tendons() -> Arm {
    let silicone = Material::isotropic(1e5, 0.4, 1070.0);
    let tendon = |x: f64, y: f64| StrainActuator {
        name: String::new(),
        density: Density::Shortening,
        scale: 1.0,
        route: Route::straight([x, y]),
        effort: vec![(0.0, 0.05)],
    };
    let d = 8e-3;
    Arm {
        gravity: Vector3::new(0.0, 0.0, -9.81),
        viscous_damping: 1.0,
        internal_damping: 5e-3,
        actuators: vec![
            tendon(d, 0.0),
            tendon(0.0, d),
            tendon(-d, 0.0),
            tendon(0.0, -d),
        ],
        ..Arm::cylinder(&silicone, 0.3, 0.01).pointing(-Vector3::z())
    }
}

/// Returns the tip of the arm at rest under the given tensions, N.
fn tip_under(arm: &Arm, discretization: &Discretization, tensions: &[f64]) -> Vector3<f64> {
    let mut arm = arm.clone();
    for (actuator, tension) in arm.actuators.iter_mut().zip(tensions) {
        actuator.effort = vec![(0.0, *tension)];
    }
    let rod = arm.rod(discretization).expect("a rod");
    let shape = static_equilibrium(&rod, &rod.rest, 0.0, &TipSpring::default()).expect("a shape");
    shape.positions[rod.tip()]
}

/// Four tendons that only pull bring a hanging arm to the tip of a static shape and keep it there; the certificate holds, by explicit and
/// implicit steps and under both strain rules.
#[test]
fn tendons_reach_and_stay() {
    let arm = four_tendons();
    for (rule, scheme, elements) in [
        (StrainRule::Helical, TimeScheme::Implicit, 10),
        (StrainRule::Helical, TimeScheme::Explicit, 5),
        // Elements as short as the radius, so that the rule does not lock.
        (StrainRule::Trapezoidal, TimeScheme::Implicit, 30),
    ] {
        let discretization = Discretization {
            strain_rule: rule,
            scheme: Some(scheme),
            blocks: 10,
            ..Discretization::with_elements(elements)
        };
        let target = tip_under(&arm, &discretization, &[0.3, 0.2, 0.05, 0.05]);
        let mut task = Task::reach(target, 1.0, 1.0).staying(Staying::default());
        task.start.shape = StartShape::Equilibrium;
        task.actuators.clear();
        task.efforts = (0..4)
            .map(|actuator| EffortControl {
                actuator,
                bounds: [0.0, 1.0],
                rate: None,
                scale: None,
            })
            .collect();
        for target in &mut task.targets {
            target.tolerances.distance = Some(3e-4);
        }
        let solution = solve(&arm, &task, &discretization).expect("a solution");
        eprintln!(
            "{rule:?} {scheme:?}: {:?}, {} iterations, objective {}",
            solution.status(),
            solution.attempt.iterations(),
            solution.objective()
        );
        let check = solution.certify().expect("a check");
        assert!(check.is_certified(), "{rule:?} {scheme:?}");
    }
}
