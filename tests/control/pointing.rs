//! Goals of a direction: the tangent of the arm at a node points along it, and the roll about it is free.

use nalgebra::{Matrix3, Vector3};
use softarm::control::{GoalPart, OptimalControlProblem};
use softarm::mechanics::rotation::{exp, log};
use softarm::scene::{OptimalControl, Scene};
use softarm::solve::{Solution, SolveOptions, solve_problem};

/// A hanging arm with four tendons, which bend it in every plane and cannot turn it about its axis.
const TENDONS: &str = r#"
[rod]
length_m = 0.3
elements = 6
[rod.material]
youngs_modulus_pa = 1.1e5
poisson_ratio = 0.45
density_kg_m3 = 1080.0
[rod.section]
radius_m = 0.012
[base]
direction = [0, 0, -1]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[damping]
viscous_1_s = 1.0
internal_s = 0.02
[time]
end_s = 0.8
integrator = "implicit"
[[tendon]]
name = "a"
offset_m = [0.009, 0.0]
tension_n = [0.0, 3.0]
[[tendon]]
name = "b"
offset_m = [0.0, 0.009]
tension_n = [0.0, 3.0]
[[tendon]]
name = "c"
offset_m = [-0.009, 0.0]
tension_n = [0.0, 3.0]
[[tendon]]
name = "d"
offset_m = [0.0, -0.009]
tension_n = [0.0, 3.0]
[control]
blocks = 5
"#;

/// An arm under a force and a moment on its tip.
const WRENCH: &str = r#"
[rod]
length_m = 0.5
elements = 6
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.02
[damping]
internal_s = 0.015
[time]
end_s = 1.0
integrator = "implicit"
[control]
blocks = 8
force_max_n = 8.0
moment_max_n_m = 1.0
"#;

fn posed(scene: &str, more: &str) -> OptimalControl {
    let text = format!("{scene}{more}");
    let (scene, source) = Scene::from_toml("pointing.toml", &text, &[]).unwrap();
    scene.optimal_control(&source).unwrap()
}

fn solved(scene: &str, more: &str) -> Solution {
    solve_problem(&posed(scene, more).posed(), &SolveOptions::default()).unwrap()
}

/// Rotation of a node at the time node of the goal of this name.
fn rotation(solution: &Solution, problem: &OptimalControlProblem, name: &str) -> Matrix3<f64> {
    let goal = (problem.goals.iter())
        .find(|goal| goal.name == name && goal.direction.is_some())
        .expect("a goal with a direction");
    solution.trajectory().rotations_at(goal.time_node)[goal.node]
}

/// Angle between the axis of a section and a direction of any length, rad.
fn angle(r: &Matrix3<f64>, direction: [f64; 3]) -> f64 {
    (r * Vector3::z()).angle(&Vector3::from(direction))
}

/// Tendons cannot choose the roll of a tip. An orientation that has the direction of the tip that they reach, and another roll, is out of
/// their reach; the direction alone is met, within its tolerance and exactly, and certified.
#[test]
fn tendons_point_the_tip() {
    let direction = [0.45, 0.2, -0.87];
    let target = "position_m = [0.065, 0.029, -0.27]\ntolerance_m = 0.01\nat_rest = false";
    for (tolerance, allowed) in [("tolerance_rad = 0.05\n", 0.05), ("", 0.0)] {
        let goal = format!("[task]\n{target}\ndirection = {direction:?}\n{tolerance}");
        let setup = posed(TENDONS, &goal);
        let solution = solve_problem(&setup.posed(), &SolveOptions::default()).unwrap();
        let check = solution.certify().unwrap();
        assert!(check.kkt.max() < 1e-6, "{:?}", check.kkt);
        assert!(check.is_certified(), "{:?}", check.items);
        let problem = setup.posed().discrete;
        let off = angle(&rotation(&solution, &problem, "task"), direction);
        assert!(off < allowed + 1e-6, "{off}");
        assert!((check.tip_angle - off).abs() < 1e-6, "{}", check.tip_angle);
    }
    let setup = posed(
        TENDONS,
        &format!("[task]\n{target}\ndirection = {direction:?}\n"),
    );
    let solution = solve_problem(&setup.posed(), &SolveOptions::default()).unwrap();
    let reached = rotation(&solution, &setup.posed().discrete, "task");
    // The roll that tendons leave is that of the smallest turn from the base, up to what twists a bent arm.
    let start = setup.posed().discrete.initial.configuration.rotations[6];
    let roll = log(&start.tr_mul(&reached)).z.abs();
    assert!(roll < 0.1, "{roll}");
}

/// A direction is the orientation whose roll costs least: with the orientation that the solution for a direction has reached, the least
/// objective is the same, and with another roll it is larger.
#[test]
fn roll_is_free() {
    let direction = [0.6, 0.1, 0.7];
    let task = "[task]\nposition_m = [0.2, 0.03, 0.42]\nat_rest = false\n";
    let setup = posed(WRENCH, &format!("{task}direction = {direction:?}\n"));
    let solution = solve_problem(&setup.posed(), &SolveOptions::default()).unwrap();
    assert!(solution.certify().unwrap().kkt.max() < 1e-6);
    let reached = rotation(&solution, &setup.posed().discrete, "task");
    assert!(angle(&reached, direction) < 1e-6);
    let with = |roll: f64| {
        let mut setup = posed(WRENCH, &format!("{task}direction = {direction:?}\n"));
        let goal = &mut setup.problem.goals[0];
        goal.direction = None;
        goal.rotation = Some(reached * exp(&(Vector3::z() * roll)));
        solve_problem(&setup.posed(), &SolveOptions::default())
            .unwrap()
            .objective()
    };
    let (free, same) = (solution.objective(), with(0.0));
    assert!((same - free).abs() < 1e-5 * free, "{free} {same}");
    for roll in [-0.2, 0.2] {
        assert!(with(roll) > free * (1.0 + 1e-4));
    }
}

/// A waypoint of a node on the way, within a tolerance, and a soft direction at the end: the waypoint is kept to its tolerance, and the soft
/// goal is missed by more with a smaller weight.
#[test]
fn waypoints_and_soft_goals_point() {
    let via = "[[task.via]]\nat_s = 0.5\nnode = 0.5\ndirection = [0.0, 0.35, 1.0]\ntolerance_rad = 0.02\n";
    let at = |weight: f64| {
        let goal = format!(
            "[task]\ndirection = [1, 0, 1]\nat_rest = false\nhard = false\nweight = {weight}\n{via}"
        );
        let setup = posed(WRENCH, &goal);
        let solution = solve_problem(&setup.posed(), &SolveOptions::default()).unwrap();
        let check = solution.certify().unwrap();
        assert!(check.kkt.max() < 1e-6, "{:?}", check.kkt);
        let problem = setup.posed().discrete;
        let on_the_way = angle(
            &rotation(&solution, &problem, "task.via.0"),
            [0.0, 0.35, 1.0],
        );
        assert!((on_the_way - 0.02).abs() < 1e-5, "{on_the_way}");
        angle(&rotation(&solution, &problem, "task"), [1.0, 0.0, 1.0])
    };
    let (much, little) = (at(0.3), at(30.0));
    assert!(little > 1e-4 && much > 10.0 * little, "{much} {little}");
}

/// A goal that is opposite to the direction at the start, where no way to turn is preferred, is reached.
#[test]
fn half_turns_are_found() {
    let solution = solved(
        WRENCH,
        "[task]\ndirection = [0, 0, -1]\nat_rest = false\n[solver]\nmax_iterations = 300\n",
    );
    let end = solution.trajectory().n_times() - 1;
    let reached = solution.trajectory().rotations_at(end)[6];
    assert!(angle(&reached, [0.0, 0.0, -1.0]) < 1e-6);
    assert!(solution.certify().unwrap().kkt.max() < 1e-6);
}

/// A velocity is met at the end, within its tolerance and exactly: the last steps move the tip with it.
#[test]
fn velocities_are_met() {
    let wanted = Vector3::new(0.3, 0.0, -0.1);
    for (tolerance, allowed) in [("0.0", 0.0), ("0.05", 0.05)] {
        let setup = posed(
            WRENCH,
            &format!(
                "[task]\nposition_m = [0.2, 0.0, 0.42]\nvelocity_m_s = [0.3, 0.0, -0.1]\nat_rest = false\ntolerance_m_s = {tolerance}\n"
            ),
        );
        let solution = solve_problem(&setup.posed(), &SolveOptions::default()).unwrap();
        let check = solution.certify().unwrap();
        assert!(check.kkt.max() < 1e-6, "{:?}", check.kkt);
        assert!(check.is_certified(), "{:?}", check.items);
        let step = setup.posed().discrete.grid.step;
        let trajectory = solution.trajectory();
        let end = trajectory.n_times() - 1;
        let x = |back: usize| trajectory.positions_at(end - back)[6];
        // Of second order in the step, about 1e-3 s beside the motion's tenths.
        let velocity = (x(0) * 3.0 - x(1) * 4.0 + x(2)) / (2.0 * step);
        let off = (velocity - wanted).norm();
        assert!((off - allowed).abs() < 2e-3, "{off} {allowed}");
        assert!((check.tip_velocity_error - allowed).abs() < 1e-4);
    }
}

/// A track of directions turns the node along great circles, without regard to its roll, and the check accepts its costs.
#[test]
fn tracks_of_directions_are_followed() {
    let setup = posed(
        WRENCH,
        "[[objective.track]]\ndirections = [[0.3, 0.0, 0.3, 1.0], [0.9, 0.5, 0.0, 2.0]]\norientation_weight = 1e4\n",
    );
    let solution = solve_problem(&setup.posed(), &SolveOptions::default()).unwrap();
    let check = solution.certify().unwrap();
    assert!(check.kkt.max() < 1e-6, "{:?}", check.kkt);
    let problem = setup.posed().discrete;
    let track = &problem.objective.tracking[0];
    let middle = track.direction(0.6).unwrap();
    let ends = [0.3, 0.9].map(|t| track.direction(t).unwrap());
    assert!((middle.angle(&ends[0]) - middle.angle(&ends[1])).abs() < 1e-12);
    assert!((middle.angle(&ends[0]) - 0.5 * ends[0].angle(&ends[1])).abs() < 1e-12);
    let k = (0.6 / problem.grid.step).round() as usize;
    let off = solution.trajectory().rotations_at(k)[6]
        .column(2)
        .angle(&middle);
    assert!(off < 0.02, "{off}");
}

/// A direction has two rows, an orientation three.
#[test]
fn directions_have_two_rows() {
    let setup = posed(
        WRENCH,
        "[task]\nposition_m = [0.2, 0.0, 0.42]\ndirection = [0, 0, 2]\nat_rest = false\n",
    );
    let rows = setup.posed().discrete.goal_rows();
    let turned = rows.iter().filter(|row| row.part == GoalPart::Direction);
    assert_eq!((rows.len(), turned.count()), (5, 2));
}

/// Directions that no motion can have are refused: that of a clamped node, and two at once.
#[test]
fn impossible_directions_are_refused() {
    let refusal = |more: &str| {
        let text =
            format!("{WRENCH}[task]\nposition_m = [0.2, 0.0, 0.42]\nat_rest = false\n{more}");
        let (scene, source) = Scene::from_toml("pointing.toml", &text, &[]).unwrap();
        let error = scene.optimal_control(&source).expect_err("a refusal");
        (
            error.key().unwrap_or_default().to_string(),
            error.to_string(),
        )
    };
    let via = |node: &str, direction: &str| {
        format!(
            "[[task.via]]\nat_s = 0.5\nnode = {node}\ndirection = {direction}\ntolerance_rad = 0.1\n"
        )
    };
    let (key, text) = refusal(&via("0", "[1, 0, 1]"));
    assert_eq!(key, "task.via.0.direction", "{text}");
    let both = format!("{}{}", via("0.5", "[1, 0, 1]"), via("0.5", "[-1, 0, 1]"));
    let (key, text) = refusal(&both);
    assert_eq!(key, "task.via.1.direction", "{text}");
}
