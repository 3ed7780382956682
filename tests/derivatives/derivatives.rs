//! `softarm derivatives`: right derivatives pass, and wrong ones are seen.

use crate::common;

use common::{Dice, busy_arm, methods, random_state};
use nalgebra::{Matrix3, Vector3};
use softarm::control::{Objective, PathConstraint, PathEnforcement, PathLimit, Shape, Tracking};
use softarm::derivatives::mechanics::step_linearization;
use softarm::derivatives::{Block, Report, Verdict, check, check_motion};
use softarm::mechanics::rotation::exp;
use softarm::mechanics::sensitivity::LinearizedStep;
use softarm::mechanics::stability::stable_step;
use softarm::mechanics::{Place, TimeScheme};
use softarm::scene::{Scene, builtin};

#[track_caller]
fn assert_right(name: &str, report: &Report) {
    for block in &report.blocks {
        assert_eq!(block.verdict, Verdict::Ok, "{name}: {block:?}");
    }
    assert_eq!(report.verdict, Verdict::Ok);
}

fn block<'a>(report: &'a Report, name: &str) -> &'a Block {
    let found = report.blocks.iter().find(|block| block.name == name);
    found.unwrap_or_else(|| panic!("no {name} among {:?}", report.blocks))
}

/// Arms so stiff that the differences of their implicit steps are blunt at some states: of these nothing may be wrong.
const STIFF: [&str; 3] = ["till-tendons", "knode-tendons", "mpc-knode"];

/// Every scene that comes with the program.
#[test]
fn built_in_scenes_are_right() {
    for name in builtin::names() {
        let (scene, source) = Scene::load(name, &[]).unwrap();
        // An implicit step costs a hundred explicit ones.
        let seeds = if name == "wire-reach" { 0..1 } else { 0..2 };
        for seed in seeds {
            let report = if scene.task.is_some() {
                check(&scene.optimal_control(&source).unwrap().problem, seed).unwrap()
            } else {
                let setup = scene.simulation(&source).unwrap();
                check_motion(&setup.rod, setup.grid, seed).unwrap()
            };
            if STIFF.contains(&name) {
                let is_wrong = |block: &&Block| block.verdict == Verdict::Wrong;
                let wrong: Vec<_> = report.blocks.iter().filter(is_wrong).collect();
                assert!(wrong.is_empty(), "{name}: {wrong:?}");
            } else {
                assert_right(name, &report);
            }
        }
    }
}

/// Implicit steps of stiff arms: a relative error of 1e-5 in the solved equations of one step is called wrong at any seed, although these
/// arms hardly react to what accelerates a node.
#[test]
fn wrong_steps_of_stiff_arms_are_seen() {
    for name in STIFF {
        let (scene, source) = Scene::load(name, &[]).unwrap();
        let setup = scene.simulation(&source).unwrap();
        for seed in 0..2 {
            let judge = |factor: f64| {
                let spoil = |step: &mut LinearizedStep| {
                    for entry in step.solve.pivots.as_flattened_mut().as_flattened_mut() {
                        *entry *= factor;
                    }
                };
                let (rod, h) = (&setup.rod, setup.grid.step);
                step_linearization(rod, h, &setup.initial, &spoil, seed)
                    .unwrap()
                    .unwrap()
                    .verdict
            };
            assert_ne!(judge(1.0), Verdict::Wrong, "{name}");
            assert_eq!(judge(1.0 + 1e-5), Verdict::Wrong, "{name}");
        }
    }
}

/// All costs, obstacles, limits and goals at once, with implicit steps and with explicit ones: each has a block of its own.
#[test]
fn everything_a_problem_may_have_is_checked() {
    let scene = "\
[rod]
length_m = 1.0
elements = 5
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.05
[damping]
viscous_1_s = 1.0
internal_s = 1e-3
[time]
end_s = 0.3
[task]
position_m = [0.1, 0.03, 0.985]
orientation_wxyz = [0.98, 0.1, 0.1, 0.1]
at_rest = 'tip'
hard = false
weight = 10.0
[[task.via]]
at_s = 0.2
position_m = [0.05, 0.0, 0.98]
tolerance_m = 0.01
[control]
blocks = 5
hold = \"cubic\"
force_max_n = inf
moment_max_n_m = inf
[objective]
rate = 0.1
energy = 0.3
";
    for integrator in ["explicit", "implicit"] {
        let set = [format!("time.integrator={integrator}")];
        let (scene, source) = Scene::from_toml("all", scene, &set).unwrap();
        let mut problem = scene.optimal_control(&source).unwrap().problem;
        let turn = Vector3::new(0.3, -0.4, 0.2);
        problem.objective = Objective {
            tracking: vec![Tracking {
                node: 3,
                path: vec![(0.0, Vector3::zeros()), (0.3, Vector3::new(0.1, 0.2, 0.9))],
                weight: 2.0,
                rotations: vec![(0.0, Matrix3::identity()), (0.3, exp(&turn))],
                directions: Vec::new(),
                rotation_weight: 3.0,
                speed_weight: 0.7,
                from: 0.0,
            }],
            samples: 30,
            ..problem.objective
        };
        let center = Vector3::new(0.3, 0.1, 0.6);
        let clear_of = |shape| PathLimit::Clearance {
            velocity: Vector3::new(0.1, -0.2, 0.05),
            shape,
            margin: 0.01,
            points: Some(2),
        };
        let limits = [
            (
                "ball",
                clear_of(Shape::Sphere {
                    center,
                    radius: 0.1,
                }),
            ),
            (
                "bar",
                clear_of(Shape::Capsule {
                    from: center,
                    to: Vector3::new(0.6, -0.4, 0.2),
                    radius: 0.05,
                }),
            ),
            (
                "stretch",
                PathLimit::Stretch {
                    least: 0.9,
                    largest: 1.1,
                },
            ),
            ("curvature", PathLimit::Curvature { largest: 3.0 }),
            ("twist", PathLimit::Twist { largest: 3.0 }),
            (
                "speed",
                PathLimit::Speed {
                    at: Place::Tip,
                    largest: 5.0,
                },
            ),
            (
                "tilt",
                PathLimit::Tilt {
                    at: Place::Tip,
                    axis: Vector3::z(),
                    direction: Vector3::new(0.6, 0.0, 0.8),
                    largest: 0.5,
                },
            ),
        ];
        for (name, limit) in limits {
            problem.path.push(PathConstraint {
                name: name.into(),
                limit,
                time_nodes: (0..=problem.grid.n_steps).collect(),
                enforcement: PathEnforcement::Hard,
                margins: Vec::new(),
            });
        }
        let report = check(&problem, 3).unwrap();
        assert_right(integrator, &report);
        for name in [
            "element.stress",
            "element.stiffness",
            "step.linearization",
            "objective",
            "objective.effort",
            "objective.rate",
            "objective.energy",
            "objective.track.0",
            "task.position_m",
            "task.orientation_wxyz",
            "task.at_rest (velocity)",
            "task.via.0.position_m",
            "ball (path)",
            "ball (distance)",
            "bar (distance)",
            "stretch (path)",
            "curvature (path)",
            "twist (path)",
            "speed (path)",
            "hessian",
        ] {
            block(&report, name);
        }
    }
}

/// Goals and tracks of directions have right derivatives, first and second, and so has a goal of a velocity.
#[test]
fn directions_and_velocities_are_checked() {
    let scene = "\
[rod]
length_m = 1.0
elements = 4
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.05
[damping]
internal_s = 1e-3
[time]
end_s = 0.3
[task]
direction = [0.5, 0.2, 0.8]
velocity_m_s = [0.3, 0.0, -0.1]
at_rest = false
[[task.via]]
at_s = 0.2
node = 0.5
direction = [0.0, 0.4, 0.9]
tolerance_rad = 0.1
[control]
blocks = 4
force_max_n = inf
moment_max_n_m = inf
[[objective.track]]
directions = [[0.0, 0.0, 0.0, 1.0], [0.3, 0.4, -0.3, 0.8]]
orientation_weight = 3.0
";
    for integrator in ["explicit", "implicit"] {
        let set = [format!("time.integrator={integrator}")];
        let (scene, source) = Scene::from_toml("directions", scene, &set).unwrap();
        let problem = scene.optimal_control(&source).unwrap().problem;
        let report = check(&problem, 5).unwrap();
        assert_right(integrator, &report);
        for name in [
            "objective.track.0",
            "task.direction",
            "task.velocity_m_s",
            "task.via.0.direction",
            "hessian",
        ] {
            block(&report, name);
        }
    }
}

/// Makes matrices wrong.
fn spoilt<const N: usize>(matrices: &mut [[[f64; N]; N]]) {
    for entry in matrices.as_flattened_mut().as_flattened_mut() {
        *entry *= 1.0 + 1e-6;
    }
}

/// What makes a linearized step wrong.
type Spoil = fn(&mut LinearizedStep);

/// Every law and integrator passes; a relative error of 1e-6 in any matrix of one linearized step is called wrong.
#[test]
fn wrong_linearizations_are_seen() {
    let spoil: [(&str, Spoil); 6] = [
        ("stiffness", |step| spoilt(&mut step.elements)),
        ("mobility", |step| {
            for drift in &mut step.drifts {
                drift.mobility *= 1.0 + 1e-6;
            }
            for node in &mut step.solve.nodes {
                node.mass_rate *= 1.0 + 1e-6;
            }
        }),
        ("theta", |step| {
            for drift in &mut step.drifts {
                spoilt(std::slice::from_mut(&mut drift.theta));
            }
        }),
        ("momentum", |step| {
            for drift in &mut step.drifts {
                spoilt(std::slice::from_mut(&mut drift.momentum));
            }
            for node in &mut step.solve.nodes {
                spoilt(std::slice::from_mut(&mut node.spin));
            }
        }),
        ("coupling", |step| spoilt(&mut step.solve.coupling)),
        ("pivots", |step| spoilt(&mut step.solve.pivots)),
    ];
    for method in methods() {
        let rod = method.rod(busy_arm(method.rule, 4));
        let state = random_state(&rod, 0.05, 0.5, &mut Dice(3));
        let h = 0.5 * stable_step(&rod);
        let judge = |spoil: Spoil| {
            let found = step_linearization(&rod, h, &state, &spoil, 5).unwrap();
            found.unwrap()
        };
        let right = judge(|_| {});
        assert_eq!(right.verdict, Verdict::Ok, "{method:?} {right:?}");
        for (what, spoil) in spoil {
            let solved = method.scheme == TimeScheme::Implicit || method.internal_damping > 0.0;
            let absent = match what {
                "coupling" | "pivots" => !solved,
                "theta" => solved,
                _ => false,
            };
            if absent {
                continue;
            }
            let wrong = judge(spoil);
            assert_eq!(wrong.verdict, Verdict::Wrong, "{method:?} {what} {wrong:?}");
        }
    }
}
