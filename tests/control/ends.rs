//! Solves with pinned bases and held tips.

use softarm::control::{Holding, holding};
use softarm::mechanics::equilibrium::{NodeSpring, static_equilibrium};
use softarm::mechanics::{Load, LoadFrame};
use softarm::scene::Scene;
use softarm::solve::{Solution, SolveOptions, solve_problem};
use softarm::task::{DiscretizeError, Staying, Task};

const ARM: &str = "\
[rod]
length_m = 0.5
elements = 10
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.02
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[damping]
viscous_1_s = 1.0
";

/// An arm that hangs from a ball joint, or from a hinge about y, and is pulled aside by its tip.
const HANGING: &str = "\
[base]
kind = \"pinned\"
direction = [0.0, 0.0, -1.0]
[time]
end_s = 0.6
[task]
position_m = [0.2, 0.0, -0.42]
at_rest = \"tip\"
[control]
blocks = 10
force_max_n = 6.0
";

/// An arm between a clamp and a hinge, whose middle is pushed up.
const BETWEEN: &str = "\
[base]
direction = [1.0, 0.0, 0.0]
[tip]
kind = \"pinned\"
axis = [0.0, 1.0, 0.0]
[time]
end_s = 0.4
[task]
node = 0.5
position_m = [0.25, 0.0, 0.02]
at_rest = \"tip\"
[control]
blocks = 10
[[control.actuator]]
node = 5
force_max_n = 12.0
";

/// An arm between a clamp and a hinge, for tendons; the place of a node on it.
const STRUT: &str = "\
[base]
direction = [1.0, 0.0, 0.0]
[tip]
kind = \"pinned\"
axis = [0.0, 1.0, 1.0]
[initial]
shape = \"equilibrium\"
[time]
end_s = 0.8
[task]
node = 3
position_m = [0.15, 0.01, -0.01]
tolerance_m = 0.003
[control]
blocks = 12
";

fn solved(text: &str, overrides: &[&str]) -> Solution {
    let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
    let text = format!("{ARM}{text}");
    let (scene, source) = Scene::from_toml("scene.toml", &text, &overrides).unwrap();
    let posed = scene.optimal_control(&source).unwrap().posed();
    let solution = solve_problem(&posed, &SolveOptions::default()).unwrap();
    assert!(solution.has_converged(), "{:?}", solution.status());
    solution
}

/// A solve meets its goal on an arm with a pinned base, and on one that is held at both ends, and the check, whose equations are its own,
/// certifies it, with explicit steps, with internal damping and with implicit ones.
#[test]
fn solves_are_certified() {
    for (text, overrides) in [
        (HANGING, &[][..]),
        (HANGING, &["base.axis=[0, 1, 0]"][..]),
        (
            HANGING,
            &["base.axis=[0, 1, 0]", "time.integrator=implicit"][..],
        ),
        (BETWEEN, &[][..]),
        (BETWEEN, &["damping.internal_s=1e-3"][..]),
    ] {
        let solution = solved(text, overrides);
        let check = solution.certify().expect("a check");
        assert!(check.is_certified(), "{overrides:?}: {:?}", check.verdict());
        let rod = &solution.problem.discrete.rod;
        assert!(!rod.joints.is_empty());
    }
}

/// Tasks and controls on ends that are held are refused at their keys.
#[test]
fn held_ends_have_no_task() {
    let refused = |overrides: &[&str]| {
        let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
        let text = format!("{ARM}{BETWEEN}");
        Scene::from_toml("scene.toml", &text, &overrides)
            .err()
            .map(|error| error.to_string())
            .unwrap_or_default()
    };
    assert!(refused(&["task.node=tip"]).contains("task.node"));
    assert!(refused(&["control.force_max_n=1"]).contains("control.force_max_n"));
    assert!(refused(&["tip.kind=clamped"]).contains("tip.axis"));
    assert!(refused(&["tip.motion.velocity_m_s=[1, 0, 0]"]).contains("tip.motion"));
}

/// Between ball joints, and from one without another end, all sections may turn about their own axes, and nothing brings them back: staying is
/// refused, not replaced by a stop for an instant, by the scene, and by the library for a task that comes from elsewhere.
#[test]
fn staying_is_refused_where_sections_may_spin() {
    for (text, overrides, end) in [
        (HANGING, &[][..], "the base is pinned"),
        (
            BETWEEN,
            &["base.kind=pinned", "tip={kind=\"pinned\"}"][..],
            "the base is pinned",
        ),
        (
            BETWEEN,
            &["base.kind=free", "tip={kind=\"pinned\"}"][..],
            "the tip is pinned",
        ),
    ] {
        let text = format!("{ARM}{text}");
        let mut overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
        let posed = {
            let (scene, source) = Scene::from_toml("scene.toml", &text, &overrides).unwrap();
            scene.optimal_control(&source).unwrap()
        };
        overrides.push("task.at_rest=true".to_string());
        let error = Scene::from_toml("scene.toml", &text, &overrides).err();
        let words = error.unwrap().to_string();
        assert!(
            words.contains("task.at_rest") && words.contains(end),
            "{words}"
        );
        let task = posed.task.staying(Staying::default());
        let refused = task.discretize(&posed.arm, &posed.discretization);
        let refused = refused.err().unwrap();
        assert!(
            matches!(refused, DiscretizeError::NotHeld { .. }),
            "{refused}"
        );
    }
}

/// A cable of a rubber between two hands, 4 cm nearer to each other than it is long: its middle is pushed aside.
const CABLE: &str = "\
[base]
direction = [1.0, 0.0, 0.0]
[tip]
kind = \"clamped\"
position_m = [0.46, 0.0, 0.0]
direction = [1.0, 0.0, 0.0]
[initial]
shape = \"equilibrium\"
[time]
end_s = 1.2
[task]
node = 0.5
position_m = [0.23, 0.03, -0.08]
[control]
blocks = 12
[[control.actuator]]
node = 5
force_max_n = 12.0
";

/// The hand at the tip moves by 4 cm and stands still before the task ends.
const MOVED_HAND: &[&str] = &[
    "tip.kind=driven",
    "tip.position_m=[0.48, 0.0, 0.0]",
    "tip.motion={translation_m=[[0.0, 0.0, 0.0, 0.0], [0.6, -0.02, 0.0, 0.02]]}",
    "task.position_m=[0.231, 0.015, -0.07]",
    "control.actuator.0.force_max_n=20.0",
];

/// Two tendons from the base to two thirds of an arm between a clamp and a hinge.
const TENDONS: &str = "\
[[tendon]]
offset_m = [0.015, 0.0]
to = 0.6
tension_n = [0.0, 40.0]
[[tendon]]
offset_m = [0.0, 0.015]
to = 0.6
tension_n = [0.0, 40.0]
";

/// What stays between two ends: the node of the task is held, by a force on it or by tendons, while the joints hold the ends. The check, whose
/// equations are its own, certifies it; on its finest grid the node stays within what the task allows for a period of the held arm, and
/// the ends where they are held.
#[test]
fn nodes_between_held_ends_stay() {
    let strut = format!("{STRUT}{TENDONS}");
    let place = place_under([12.0, 8.0]);
    for (text, overrides) in [
        (BETWEEN, &["task.at_rest=true", "time.end_s=0.8"][..]),
        (CABLE, MOVED_HAND),
        (
            &strut,
            &[
                &place,
                "time.integrator=implicit",
                "damping.internal_s=1e-3",
            ][..],
        ),
    ] {
        let solution = solved(text, overrides);
        let problem = &solution.problem.discrete;
        let stay = problem.stay.as_ref().expect("the arm stays");
        assert!(stay.is_stable);
        let check = solution.certify().expect("a check");
        assert!(check.is_certified(), "{overrides:?}: {:?}", check.items);
        let found = check.stays.expect("the motion afterwards");
        // Of the tolerance of its place, and a hundredth of the length.
        let most = 0.003 + 0.01 * 0.5;
        assert!(found.tip_error < most, "{overrides:?}: {found:?}");
        let end = problem.grid.duration();
        let (gap, turn) = problem.rod.largest_gap(&stay.shape, end);
        assert!(gap < 1e-12 && turn < 1e-9, "{gap:e} {turn:e}");
    }
}

/// Returns the place of the node of [`STRUT`] at rest under these tensions, by the statics of the given efforts, as an override.
fn place_under(tensions: [f64; 2]) -> String {
    let overrides: Vec<String> = (tensions.iter().enumerate())
        .map(|(i, tension)| format!("tendon.{i}.pretension_n={tension}"))
        .collect();
    let text = format!("{ARM}{STRUT}{TENDONS}");
    let (scene, source) = Scene::from_toml("scene.toml", &text, &overrides).unwrap();
    let passing = Task {
        targets: Vec::new(),
        ..scene.posed_task(&source).unwrap()
    };
    let posed = passing.discretize(&scene.arm(&source).unwrap(), &scene.discretization());
    let rod = posed.unwrap().discrete.rod;
    let none = NodeSpring::default();
    let x = static_equilibrium(&rod, &rod.rest, 0.0, &none)
        .unwrap()
        .positions[3];
    format!("task.position_m=[{}, {}, {}]", x.x, x.y, x.z)
}

/// The search finds the tensions of an equilibrium between two ends from the place of its node alone, which the statics of given tensions has
/// found: to the `1e-6` of the length to which a place is met, over its slope along a tension, a few ten-thousandths of the length per newton.
#[test]
fn tensions_between_ends_are_found_from_a_place() {
    for tensions in [[6.0, 0.0], [4.0, 9.0], [20.0, 2.0]] {
        let text = format!("{ARM}{STRUT}{TENDONS}");
        let overrides = [place_under(tensions)];
        let (scene, source) = Scene::from_toml("scene.toml", &text, &overrides).unwrap();
        let problem = scene.optimal_control(&source).unwrap().posed().discrete;
        let Holding::Held(held) = holding(&problem).unwrap() else {
            panic!("{tensions:?} are not found");
        };
        let own = problem.efforts.as_ref().unwrap();
        for (place, tension) in own.places.iter().zip(tensions) {
            let found = problem.inputs(&held.controls)[*place];
            assert!((found - tension).abs() < 1e-2, "{tensions:?}: {found}");
        }
    }
}

/// A place that no force within the bounds holds is refused with the nearest one: along a straight way up, that which the largest force holds, by
/// the statics of a load of this size.
#[test]
fn places_beyond_the_bounds_are_refused_with_their_distance() {
    let text = format!("{ARM}{BETWEEN}");
    let overrides = ["task.at_rest=true", "task.position_m=[0.25, 0.0, 0.06]"];
    let overrides = overrides.map(ToString::to_string);
    let (scene, source) = Scene::from_toml("scene.toml", &text, &overrides).unwrap();
    let error = scene.optimal_control(&source).err().unwrap();
    let nearest = error.nearest().expect("a place");
    let refused = error.to_string();
    assert!(
        refused.contains("the nearest place of node 5 that can be held")
            && refused.contains("m from it"),
        "{refused}"
    );
    let (_, after) = refused.split_once("is [").unwrap();
    let (place, after) = after.split_once("] m, ").unwrap();
    let place: Vec<f64> = place.split(", ").map(|x| x.parse().unwrap()).collect();
    let distance: f64 = after.split_once(" m from it").unwrap().0.parse().unwrap();
    let place = nalgebra::Vector3::from_column_slice(&place);
    let target = nalgebra::Vector3::new(0.25, 0.0, 0.06);
    assert!((place - nalgebra::Vector3::from(nearest.position)).norm() < 1e-6);
    assert!((nearest.distance / distance - 1.0).abs() < 5e-3);
    assert!(
        ((place - target).norm() / distance - 1.0).abs() < 5e-3,
        "{refused}"
    );
    // No push in another direction comes nearer than the best one found.
    let passing = "task.at_rest=\"tip\"".to_string();
    let (scene, source) = Scene::from_toml("scene.toml", &text, &[passing]).unwrap();
    let posed = scene.optimal_control(&source).unwrap();
    let rod = posed.arm.rod(&posed.discretization).unwrap();
    for angle in [-0.3_f64, -0.1, 0.0, 0.1, 0.3] {
        let mut pushed = rod.clone();
        pushed.loads.push(Load {
            node: 5,
            force: nalgebra::Vector3::new(angle.sin(), 0.0, angle.cos()) * 12.0,
            moment: nalgebra::Vector3::zeros(),
            frame: LoadFrame::Spatial,
            profile: Vec::new(),
        });
        let none = NodeSpring::default();
        let shape = static_equilibrium(&pushed, &rod.rest, 0.0, &none).unwrap();
        let off = (shape.positions[5] - target).norm();
        assert!(off > distance * (1.0 - 5e-3), "{angle}: {off} {distance}");
    }
}

/// A hand that still moves when the task ends is named as the reason.
#[test]
fn a_moving_hand_holds_nothing() {
    let text = format!("{ARM}{CABLE}");
    let mut overrides: Vec<String> = MOVED_HAND.iter().map(ToString::to_string).collect();
    overrides[2] = "tip.motion={velocity_m_s=[-0.01, 0.0, 0.0]}".to_string();
    let (scene, source) = Scene::from_toml("scene.toml", &text, &overrides).unwrap();
    let refused = scene.optimal_control(&source).err().unwrap().to_string();
    assert!(refused.contains("the tip still moves"), "{refused}");
}
