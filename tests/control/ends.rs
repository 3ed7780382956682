//! Solves with pinned bases and held tips.

use softarm::scene::Scene;
use softarm::solve::{Solution, SolveOptions, solve_problem};
use softarm::task::{DiscretizeError, Staying};

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
    assert!(refused(&["task.at_rest=true"]).contains("the tip is pinned"));
    assert!(refused(&["control.force_max_n=1"]).contains("control.force_max_n"));
    assert!(refused(&["tip.kind=clamped"]).contains("tip.axis"));
    assert!(refused(&["tip.motion.velocity_m_s=[1, 0, 0]"]).contains("tip.motion"));
}

/// Nothing is known about staying on an arm with a pinned end, and it is refused, not replaced by a stop for an instant: by the scene, and by
/// the library for a task that comes from elsewhere.
#[test]
fn staying_is_refused_between_held_ends() {
    let text = format!("{ARM}{HANGING}");
    let staying = ["task.at_rest=true".to_string()];
    let error = Scene::from_toml("scene.toml", &text, &staying)
        .err()
        .unwrap();
    let words = error.to_string();
    assert!(
        words.contains("task.at_rest") && words.contains("the base is pinned"),
        "{words}"
    );
    let (scene, source) = Scene::from_toml("scene.toml", &text, &[]).unwrap();
    let posed = scene.optimal_control(&source).unwrap();
    let task = posed.task.staying(Staying::default());
    let refused = task.discretize(&posed.arm, &posed.discretization);
    let refused = refused.err().unwrap();
    assert!(matches!(refused, DiscretizeError::NotHeld(_)), "{refused}");
}
