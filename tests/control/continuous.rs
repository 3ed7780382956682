//! The continuous problem: arms and tasks without elements and steps, and the discrete problems that are made of them.

use nalgebra::Vector3;
use softarm::control::{Bound, FreeDuration, Hold, OptimalControlProblem, PathEnforcement, Shape};
use softarm::mechanics::{
    BaseCondition, LoadFrame, Material, NodeInertia, RodModel, RotaryInertia, Section,
    SectionProfile, SectionSegment, StrainRule, TimeScheme,
};
use softarm::scene::Scene;
use softarm::task::{
    Arm, ChannelLimits, Discretization, DiscretizeError, Limit, Obstruction, PathLimit, Place,
    PointLoad, Rest, Start, StartShape, Target, Task, Tolerances, WrenchActuator,
};

fn silicone() -> Material {
    Material::isotropic(1e6, 0.5, 1000.0)
}

/// The arm and the task of [`SCENE`].
fn posed() -> (Arm, Task, Discretization) {
    let arm = Arm {
        gravity: Vector3::new(0.0, 0.0, -9.81),
        viscous_damping: 1.0,
        loads: vec![PointLoad {
            at: Place::Fraction(0.5),
            force: Vector3::new(0.0, 0.2, 0.0),
            frame: LoadFrame::Body,
            profile: vec![(0.0, 0.0), (0.5, 1.0)],
            ..PointLoad::default()
        }],
        ..Arm::cone(&silicone(), 1.0, [0.05, 0.04])
    }
    .pointing(Vector3::new(0.0, 0.0, -2.0));
    let mut task = Task::reach(Vector3::new(0.3, 0.0, -0.9), 1.0, 20.0);
    task.start.shape = StartShape::Equilibrium;
    task.targets.insert(
        0,
        Target {
            name: "task.via.0".into(),
            at: Place::Fraction(0.5),
            time: Some(0.4),
            position: Some(Vector3::new(0.05, 0.0, -0.45)),
            tolerances: Tolerances {
                distance: Some(0.05),
                ..Tolerances::default()
            },
            ..Target::default()
        },
    );
    task.limits = vec![
        Limit {
            name: "ball".into(),
            kind: PathLimit::Clearance {
                velocity: Vector3::zeros(),
                shape: Shape::Sphere {
                    center: Vector3::new(0.5, 0.5, 0.0),
                    radius: 0.1,
                },
                margin: 0.01,
                points: None,
            },
            rate: Some(50.0),
            span: [None; 2],
            enforcement: PathEnforcement::Hard,
        },
        Limit {
            name: "speed".into(),
            kind: PathLimit::Speed {
                at: Place::Tip,
                largest: 5.0,
            },
            rate: None,
            span: [None; 2],
            enforcement: PathEnforcement::Hard,
        },
    ];
    task.actuators.push(WrenchActuator {
        at: Place::Fraction(0.25),
        force: ChannelLimits::NONE,
        moment: ChannelLimits::at_most(0.5),
    });
    (arm, task, Discretization::with_elements(8))
}

const SCENE: &str = "[rod]\nlength_m = 1.0\nelements = 8\n[rod.material]\nyoungs_modulus_pa = 1e6\npoisson_ratio = 0.5\ndensity_kg_m3 = 1000\n\
    [rod.section]\nradius_base_m = 0.05\nradius_tip_m = 0.04\n[base]\ndirection = [0, 0, -1]\n[gravity]\nacceleration_m_s2 = [0, 0, -9.81]\n\
    [damping]\nviscous_1_s = 1.0\n[[load]]\nnode = 4\nforce_n = [0, 0.2, 0]\nframe = 'body'\nprofile = [[0, 0], [0.5, 1]]\n\
    [initial]\nshape = 'equilibrium'\n[time]\nend_s = 1.0\n[task]\nposition_m = [0.3, 0, -0.9]\nat_rest = 'tip'\n[[task.via]]\nat_s = 0.4\nnode = 4\n\
    position_m = [0.05, 0, -0.45]\ntolerance_m = 0.05\n[[obstacle]]\nname = 'ball'\nsphere = { center_m = [0.5, 0.5, 0], radius_m = 0.1 }\n\
    margin_m = 0.01\nrate_hz = 50\n[[limit]]\nspeed_max_m_s = 5\n[control]\nforce_max_n = 20\n[[control.actuator]]\nnode = 2\n\
    moment_max_n_m = 0.5\n";

/// Everything that a solver sees of a problem but its rod.
#[track_caller]
fn assert_same(one: &OptimalControlProblem, other: &OptimalControlProblem) {
    assert_eq!(one.grid, other.grid);
    assert_eq!(one.duration, other.duration);
    assert_eq!(one.initial, other.initial);
    assert_eq!(one.control, other.control);
    assert_eq!(one.channels, other.channels);
    assert_eq!(one.goals, other.goals);
    assert_eq!(one.path, other.path);
    assert_eq!(one.objective, other.objective);
    assert_eq!(one.radii, other.radii);
    assert_eq!(one.rod.nodes, other.rod.nodes);
    assert_eq!(one.rod.loads, other.rod.loads);
    assert_eq!(one.rod.rest, other.rod.rest);
}

/// A problem that is written in Rust is the one that a scene describes.
#[test]
fn a_scene_and_the_library_pose_the_same_problem() {
    let (arm, task, discretization) = posed();
    let ours = task.discretize(&arm, &discretization).unwrap();
    let (scene, source) = Scene::from_toml("arm", SCENE, &[]).unwrap();
    let theirs = scene.optimal_control(&source).unwrap();
    assert_same(&ours.discrete, &theirs.problem);
    assert_eq!(ours.discretization, theirs.discretization);
}

/// What was chosen is said: discretized by it, the problem is the same again, and nothing is left to choose.
#[test]
fn choices_are_part_of_the_problem() {
    let (arm, task, discretization) = posed();
    let wire = Arm::cylinder(&Material::isotropic(200e9, 0.3, 7850.0), 0.3, 0.5e-3);
    let to_the_side = Task::reach(Vector3::new(0.1, 0.0, 0.27), 0.5, 5.0);
    for (arm, task, expected) in [
        (&arm, &task, (TimeScheme::Explicit, RotaryInertia::Section)),
        (
            &wire,
            &to_the_side,
            (TimeScheme::Implicit, RotaryInertia::Segment),
        ),
    ] {
        let first = task.discretize(arm, &discretization).unwrap();
        let chosen = first.discretization;
        assert_eq!(chosen.scheme.zip(chosen.rotary_inertia), Some(expected));
        let again = task.discretize(arm, &chosen).unwrap();
        assert_eq!(again.discretization, chosen);
        assert_same(&first.discrete, &again.discrete);
    }
}

/// Another discretization of the same problem has loads, goals and wrenches at the same places, its samples at the same times, and a state to
/// start from of its own; with twice the elements it is the rod that the check compares with.
#[test]
fn places_stay_where_they_are() {
    let (arm, task, _) = posed();
    let at = |elements: usize| {
        let discretization = Discretization::with_elements(elements);
        task.discretize(&arm, &discretization).unwrap()
    };
    let (coarse, fine) = (at(8), at(16));
    for (node, finer) in [
        (
            coarse.discrete.rod.loads[0].node,
            fine.discrete.rod.loads[0].node,
        ),
        (coarse.discrete.goals[0].node, fine.discrete.goals[0].node),
        (
            coarse.discrete.actuated_nodes()[1],
            fine.discrete.actuated_nodes()[1],
        ),
        (coarse.discrete.rod.tip(), fine.discrete.rod.tip()),
    ] {
        assert_eq!(2 * node, finer);
    }
    let time = |problem: &OptimalControlProblem| {
        let path = &problem.path[0];
        problem.grid.time(path.time_nodes[1])
    };
    let step = coarse.discrete.grid.step;
    assert!((time(&coarse.discrete) - time(&fine.discrete)).abs() <= step);
    assert!((time(&coarse.discrete) - 1.0 / 50.0).abs() <= step);
    let (rod, start) = coarse.finer(2).unwrap();
    assert_eq!(rod.nodes, fine.discrete.rod.nodes);
    assert_eq!(start, fine.discrete.initial);
    // The equilibria of both are those of one arm, to second order in the elements.
    let tip = |problem: &OptimalControlProblem| {
        problem.initial.configuration.positions[problem.rod.tip()]
    };
    assert!((tip(&coarse.discrete) - tip(&fine.discrete)).norm() < 1e-3);
}

/// A longer problem is the same at another pace: its points on the way at the same parts of it, on as many steps.
#[test]
fn stretched_problems_are_discretized_alike() {
    let (arm, task, discretization) = posed();
    let problem = task
        .discretize(&arm, &discretization)
        .unwrap()
        .with_time_scale(1.25);
    assert_eq!(problem.task.horizon, 1.25);
    assert_eq!(problem.task.targets[0].time, Some(0.5));
    let again = (problem.task)
        .discretize(&problem.arm, &problem.discretization)
        .unwrap();
    assert_eq!(again.discrete.grid.n_steps, problem.discrete.grid.n_steps);
    for (one, other) in again.discrete.goals.iter().zip(&problem.discrete.goals) {
        assert_eq!(one.time_node, other.time_node);
    }
    assert!((again.discrete.grid.step / problem.discrete.grid.step - 1.0).abs() < 1e-12);
}

/// What cannot be discretized says what is wrong with it.
#[test]
fn refusals_are_typed() {
    let refusal = |change: &dyn Fn(&mut Arm, &mut Task, &mut Discretization)| {
        let (mut arm, mut task, mut discretization) = posed();
        change(&mut arm, &mut task, &mut discretization);
        match task.discretize(&arm, &discretization) {
            Ok(_) => panic!("accepted"),
            Err(error) => error,
        }
    };
    let out_of_range = |error: DiscretizeError| match error {
        DiscretizeError::OutOfRange { what, .. } => what,
        other => panic!("{other:?}"),
    };
    assert_eq!(
        out_of_range(refusal(&|_, task, _| task.horizon = 0.0)),
        "horizon"
    );
    assert_eq!(
        out_of_range(refusal(&|_, task, _| task.horizon = f64::NAN)),
        "horizon"
    );
    assert_eq!(out_of_range(refusal(&|_, _, d| d.blocks = 0)), "blocks");
    assert_eq!(out_of_range(refusal(&|_, _, d| d.elements = 0)), "elements");
    assert_eq!(
        out_of_range(refusal(&|_, _, d| d.step = Some(-1.0))),
        "step"
    );
    assert_eq!(
        out_of_range(refusal(&|_, task, _| task.targets[0].time = Some(2.0))),
        "target.time"
    );
    assert_eq!(
        out_of_range(refusal(&|_, task, _| task.targets[0].rest = Rest::Instant)),
        "target.time"
    );
    assert_eq!(
        out_of_range(refusal(
            &|_, task, _| task.actuators[1].at = Place::Fraction(0.97)
        )),
        "actuator.at"
    );
    assert_eq!(
        out_of_range(refusal(&|_, task, _| {
            task.free_duration = Some(FreeDuration {
                shortest: 2.0,
                longest: 3.0,
                price: 1.0,
            });
        })),
        "free_duration.shortest"
    );
    assert!(matches!(
        refusal(&|arm, _, _| arm.length = -1.0),
        DiscretizeError::Rod(error) if error.parameter() == "length"
    ));
    assert!(matches!(
        refusal(&|arm, _, d| {
            arm.model = RodModel::Consistent;
            d.scheme = Some(TimeScheme::Implicit);
        }),
        DiscretizeError::Rod(error) if error.parameter() == "scheme"
    ));
    assert!(matches!(
        refusal(&|_, _, d| {
            d.scheme = Some(TimeScheme::Explicit);
            d.step = Some(0.1);
        }),
        DiscretizeError::UnstableStep { step: 0.1, .. }
    ));
    assert!(matches!(
        refusal(&|_, _, d| d.blocks = 100_000),
        DiscretizeError::TooManyVariables { .. } | DiscretizeError::TooManyBlocks { .. }
    ));
    assert!(matches!(
        refusal(&|_, _, d| d.step = Some(1e-12)),
        DiscretizeError::TooManySteps { .. }
    ));
    assert!(matches!(
        refusal(&|_, _, d| d.step = Some(1e-8)),
        DiscretizeError::TooManyStates { .. }
    ));
    assert!(matches!(
        refusal(&|arm, _, _| arm.base = BaseCondition::Free),
        DiscretizeError::Start(_)
    ));
    assert!(matches!(
        refusal(&|_, task, _| {
            task.limits[0].kind = PathLimit::Clearance {
                velocity: Vector3::zeros(),
                shape: Shape::Sphere {
                    center: Vector3::new(0.0, 0.0, -0.5),
                    radius: 0.1,
                },
                margin: 0.0,
                points: None,
            };
        }),
        DiscretizeError::ViolatedAtStart { limit: 0, .. }
    ));
    assert!(matches!(
        refusal(&|_, task, _| {
            let mut other = task.targets[1].clone();
            other.position = Some(Vector3::new(0.0, 0.3, -0.9));
            task.targets.push(other);
        }),
        DiscretizeError::GoalConflict {
            with: Obstruction::Goal,
            ..
        }
    ));
    assert!(matches!(
        refusal(&|_, task, _| {
            task.actuators[0].force.rate_bound = Some(Bound::Norm(1.0));
            task.free_duration = Some(FreeDuration {
                shortest: 0.5,
                longest: 2.0,
                price: 1.0,
            });
        }),
        DiscretizeError::Duration { .. }
    ));
}

/// The defaults of the library are those of scenes.
#[test]
fn defaults_are_those_of_scenes() {
    let text = "[rod]\nlength_m = 1\nelements = 20\n[rod.material]\npreset = 'pdms'\n[rod.section]\nradius_m = 0.02\n[time]\nend_s = 1\n\
                [task]\nposition_m = [0.1, 0, 0.9]\nat_rest = 'tip'\n[control]\nforce_max_n = 1\n";
    let (scene, source) = Scene::from_toml("arm", text, &[]).unwrap();
    assert_eq!(scene.discretization(), Discretization::default());
    assert_eq!(scene.start(), Start::default());
    let task = scene.posed_task(&source).unwrap();
    assert_eq!(task, Task::reach(Vector3::new(0.1, 0.0, 0.9), 1.0, 1.0));
    let default = Discretization::default();
    assert_eq!(
        (default.strain_rule, default.hold),
        (StrainRule::Helical, Hold::Linear)
    );
}

/// The scene that describes a problem poses it again, for every built-in scene without actuators of its own, which are refused, and the problem of this file: the rods, loads, goals, limits and
/// prices are the same, orientations and what follows from them to rounding.
#[test]
fn problems_can_be_described_as_scenes() {
    let near = |a: f64, b: f64| (a - b).abs() <= 1e-12 * (1.0 + a.abs());
    let mut problems = Vec::new();
    for name in softarm::scene::builtin::names() {
        let (scene, source) = Scene::load(name, &[]).unwrap();
        if scene.control.is_some() {
            let setup = scene.optimal_control(&source).unwrap();
            problems.push((name.to_string(), setup.posed(), setup.settings));
        }
    }
    assert!(problems.len() >= 5);
    let (arm, task, discretization) = posed();
    let ours = task.discretize(&arm, &discretization).unwrap();
    problems.push(("program".into(), ours, softarm::sqp::SqpSettings::default()));
    for (name, problem, settings) in problems {
        if !problem.discrete.acting.is_empty() {
            let refused = Scene::describing(&problem, &settings).unwrap_err();
            assert!(
                refused.to_string().contains("actuator"),
                "{name}: {refused}"
            );
            continue;
        }
        let described = Scene::describing(&problem, &settings).unwrap().to_toml();
        let (scene, source) = Scene::from_toml(&name, &described, &[])
            .unwrap_or_else(|error| panic!("{name}: {error}\n{described}"));
        let again = scene
            .optimal_control(&source)
            .unwrap_or_else(|error| panic!("{name}: {error}\n{described}"));
        let (one, other) = (&problem.discrete, &again.problem);
        assert_eq!(one.grid, other.grid, "{name}");
        assert_eq!(one.control, other.control, "{name}");
        assert_eq!(one.duration, other.duration, "{name}");
        assert_eq!(one.channels, other.channels, "{name}");
        assert_eq!(one.objective, other.objective, "{name}");
        assert_eq!(one.radii, other.radii, "{name}");
        assert_eq!(one.rod.nodes, other.rod.nodes, "{name}");
        assert_eq!(one.rod.loads, other.rod.loads, "{name}");
        assert_eq!(one.rod.scheme, other.rod.scheme, "{name}");
        assert_eq!(one.goals.len(), other.goals.len(), "{name}");
        for (goal, again) in one.goals.iter().zip(&other.goals) {
            assert_eq!(goal.name, again.name);
            assert_eq!((goal.node, goal.time_node), (again.node, again.time_node));
            assert_eq!(goal.position, again.position);
            assert_eq!(goal.enforcement, again.enforcement);
            assert_eq!(goal.at_rest, again.at_rest);
            if let (Some(a), Some(b)) = (goal.rotation, again.rotation) {
                assert!((a - b).norm() < 1e-14, "{name}");
            }
        }
        assert_eq!(one.path.len(), other.path.len(), "{name}");
        for (path, again) in one.path.iter().zip(&other.path) {
            assert_eq!(path.name, again.name);
            assert_eq!(path.time_nodes, again.time_nodes);
            assert_eq!(path.enforcement, again.enforcement);
        }
        let tips =
            [one, other].map(|problem| problem.initial.configuration.positions[one.rod.tip()]);
        assert!(
            (0..3).all(|i| near(tips[0][i], tips[1][i])),
            "{name}: {tips:?}"
        );
    }
}

/// An arm of segments with steps in section, curvature at rest and thickness, and with a body, is described by a scene that means the same
/// arm: elements, nodes and radii are those of the program, up to rounding.
#[test]
fn arms_in_pieces_are_described() {
    let strip = softarm::mechanics::Outline::Rectangle {
        width: 0.1,
        height: 0.06,
    };
    let profiles = [
        (
            0.4,
            SectionProfile::Uniform(Section::of_shape(&silicone(), &strip)),
        ),
        (
            1.0,
            SectionProfile::TaperedCircle {
                material: silicone(),
                base_radius: 0.05,
                tip_radius: 0.03,
            },
        ),
    ];
    let segments = profiles.map(|(to, section)| SectionSegment { to, section });
    let [straight, bent] = [0.0, 0.3].map(|kappa| Vector3::new(kappa, 0.1, 0.0));
    let body = NodeInertia {
        mass: 0.2,
        rotary: Vector3::new(1e-4, 2e-4, 3e-4),
    };
    let arm = Arm {
        viscous_damping: 1.0,
        curvature_rows: vec![(0.4, straight), (0.4, bent), (0.9, straight)],
        bodies: vec![(0.7, body)],
        radii: vec![(0.0, 0.04), (0.4, 0.04), (0.4, 0.05), (1.0, 0.03)],
        ..Arm::straight(1.0, SectionProfile::Segments(segments.into()))
    };
    let task = Task::reach(Vector3::new(0.4, 0.0, 0.85), 1.0, 20.0);
    let discretization = Discretization {
        elements: 10,
        blocks: 6,
        ..Discretization::default()
    };
    let problem = task.discretize(&arm, &discretization).unwrap();
    let settings = softarm::sqp::SqpSettings::default();
    let described = Scene::describing(&problem, &settings).unwrap().to_toml();
    let (scene, source) = Scene::from_toml("described", &described, &[]).unwrap();
    let again = scene.optimal_control(&source).unwrap().problem;
    let (one, other) = (&problem.discrete, &again);
    assert_eq!(one.rod.n_elements(), other.rod.n_elements());
    let near = |a: f64, b: f64| (a - b).abs() <= 1e-12 * (a.abs() + b.abs());
    for (a, b) in one.rod.elements.iter().zip(&other.rod.elements) {
        assert!(near(a.length, b.length));
        for i in 0..3 {
            assert!(near(a.angular_stiffness[i], b.angular_stiffness[i]));
            assert!((a.rest.curvature[i] - b.rest.curvature[i]).abs() < 1e-12);
        }
    }
    for (a, b) in one.rod.nodes.iter().zip(&other.rod.nodes) {
        assert!(near(a.mass, b.mass) && (0..3).all(|i| near(a.rotary[i], b.rotary[i])));
    }
    for (a, b) in one.radii.iter().zip(&other.radii) {
        assert!(near(*a, *b), "{:?} {:?}", one.radii, other.radii);
    }
}

/// What no scene can say is refused, by what it is.
#[test]
fn what_no_scene_can_say_is_refused() {
    let refusal = |change: &dyn Fn(&mut Task)| {
        let (arm, mut task, discretization) = posed();
        change(&mut task);
        let problem = task.discretize(&arm, &discretization).unwrap();
        let settings = softarm::sqp::SqpSettings::default();
        Scene::describing(&problem, &settings)
            .expect_err("refused")
            .to_string()
    };
    assert!(refusal(&|task| task.limits.swap(0, 1)).contains("obstacles"));
    assert!(refusal(&|task| task.actuators.swap(0, 1)).contains("first actuator"));
    assert!(
        refusal(&|task| task.actuators[1].moment.rate_bound = Some(Bound::Norm(1.0)))
            .contains("rates")
    );
}

/// A goal of another place than the tip is said by its node.
#[test]
fn goals_of_other_places_are_said_by_their_node() {
    let (arm, mut task, discretization) = posed();
    task.targets[1].at = Place::Fraction(0.5);
    task.targets[1].position = Some(Vector3::new(0.1, 0.0, -0.45));
    let problem = task.discretize(&arm, &discretization).unwrap();
    let scene = Scene::describing(&problem, &softarm::sqp::SqpSettings::default()).unwrap();
    let (again, source) = Scene::from_toml("described", &scene.to_toml(), &[]).unwrap();
    let again = again.posed_task(&source).unwrap();
    assert_eq!(again.targets[1].at, Place::Fraction(0.5));
}

/// Ten lines of library: pose, solve, certify, regulate, save; what was saved is certified by the program, and is the same solve that the program
/// makes of the scene.
#[test]
fn a_problem_is_solved_certified_and_saved() {
    let arm = Arm {
        viscous_damping: 1.0,
        ..Arm::cylinder(&silicone(), 1.0, 0.05)
    };
    let task = Task::reach(Vector3::new(0.4, 0.0, 0.85), 1.0, 20.0);
    let discretization = Discretization {
        elements: 6,
        blocks: 6,
        ..Discretization::default()
    };
    let solution = softarm::solve(&arm, &task, &discretization).unwrap();
    assert!(solution.has_converged());
    let certificate = solution.certify().unwrap();
    assert!(certificate.is_certified(), "{:?}", certificate.items);
    let weights = softarm::control::FeedbackWeights::default();
    let regulator = solution.regulator(&weights, 1).unwrap();
    let rates = [&regulator.closed_loop, &regulator.open_loop].map(|growth| growth[0]);
    assert!(
        rates.iter().all(|rate| rate.is_finite() && *rate > 0.0),
        "{rates:?}"
    );

    let folder = tempfile::tempdir().unwrap();
    let directory = solution.save(&folder.path().join("result")).unwrap();
    for file in [
        "summary.json",
        "controls.csv",
        "trajectory.npz",
        "multipliers.json",
        "iterations.csv",
        "scene.toml",
        "report.html",
    ] {
        assert!(directory.join(file).is_file(), "{file}");
    }
    let text = std::fs::read_to_string(directory.join("scene.toml")).unwrap();
    let (scene, source) = Scene::from_toml("saved", &text, &[]).unwrap();
    let setup = scene.optimal_control(&source).unwrap();
    let again =
        softarm::solve::solve_problem(&setup.posed(), &softarm::solve::SolveOptions::default())
            .unwrap();
    let difference = again.objective() / solution.objective() - 1.0;
    assert!(difference.abs() < 1e-9, "{difference:e}");
    // A second save replaces the first; a file that is not softarm's stays.
    std::fs::write(directory.join("notes.txt"), "mine").unwrap();
    solution.save(&directory).unwrap();
    assert_eq!(std::fs::read(directory.join("notes.txt")).unwrap(), b"mine");
}

/// A directory that a program saved is one that `softarm verify` certifies.
#[cfg(feature = "cli")]
#[test]
fn what_was_saved_is_verified() {
    let arm = Arm::cone(&silicone(), 0.5, [0.03, 0.02]).pointing(Vector3::new(1.0, 0.0, 0.0));
    let task = Task::reach(Vector3::new(0.4, 0.2, 0.1), 0.8, 5.0);
    let solution = softarm::solve(&arm, &task, &Discretization::with_elements(8)).unwrap();
    assert!(solution.has_converged());
    let folder = tempfile::tempdir().unwrap();
    let directory = solution.save(&folder.path().join("result")).unwrap();
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_softarm"))
        .arg("verify")
        .arg(&directory)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
}
