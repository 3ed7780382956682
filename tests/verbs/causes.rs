//! What a run that broke down says of its cause: an arm that topples, a model that is no variation of an action.

#![cfg(feature = "cli")]

use crate::tool;

use std::process::Command;

use serde_json::Value;
use tool::{DONE, NOT_CONVERGED, NUMERICAL};

/// A soft tapered arm with a payload at its tip and a target beside it; `direction` is where it points, up or down.
fn arm(direction: &str, height: &str) -> String {
    format!(
        "[rod]
length_m = 0.30
elements = 12
[rod.material]
youngs_modulus_pa = 69e3
poisson_ratio = 0.5
density_kg_m3 = 1070.0
[rod.section]
radius_base_m = 0.01
radius_tip_m = 0.005
[base]
direction = [0.0, 0.0, {direction}]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[payload]
mass_kg = 0.05
[time]
end_s = 1.5
[task]
position_m = [0.1, 0.0, {height}]
at_rest = 'tip'
[control]
blocks = 10
force_max_n = 1.0
moment_max_n_m = 0.0
[solver]
max_iterations = 2
guess = \"rest\"
"
    )
}

/// A soft arm with a lateral force of 5 N, stepped on, under the paper's model.
const PULLED: &str = "\
[rod]
length_m = 1.0
elements = 20
model = \"dilatation\"
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.05
[[load]]
node = \"tip\"
force_n = [5.0, 0.0, 0.0]
[time]
end_s = 1.5
[output]
rate_hz = 20.0
";

/// Exit code, summary and what was said.
fn run(verb: &str, scene: &str, more: &[&str]) -> (i32, Value, String) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("scene.toml"), scene).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_softarm"))
        .args([verb, "scene.toml", "--json"])
        .args(more)
        .current_dir(folder.path())
        .env("NO_COLOR", "1")
        .output()
        .unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    let summary = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
    (output.status.code().unwrap(), summary, said)
}

/// An upright arm that cannot stand is told so before anything else: that the motion is unstable, how fast deviations grow, its weight number
/// beside the one that matters, and what to change. The same arm hanging, which stops as early, is told nothing of the kind.
#[test]
fn a_toppling_arm_is_told_that_it_topples() {
    let (code, summary, said) = run("solve", &arm("1.0", "0.2"), &[]);
    assert!([NOT_CONVERGED, NUMERICAL].contains(&code), "{code}: {said}");
    let message = summary["message"].as_str().unwrap();
    assert!(message.starts_with("the motion is unstable"), "{message}");
    for part in ["grow as exp(", "weight number", "7.84", "base.direction"] {
        assert!(message.contains(part), "{message}");
    }
    assert!(said.contains("the motion is unstable"), "{said}");

    let (code, summary, said) = run("solve", &arm("-1.0", "-0.2"), &[]);
    assert_ne!(code, DONE, "{said}");
    assert!(!summary.to_string().contains("unstable"), "{summary}");
    assert!(!said.contains("topple"), "{said}");
}

/// The paper's model with helical strains breaks down under a force of 5 N on grids of 20 elements and more, and not with 10: the error and
/// the warning before it point to `consistent`, which, followed, works.
#[test]
fn a_broken_model_points_to_the_consistent_one() {
    for elements in ["20", "40"] {
        let set = format!("rod.elements={elements}");
        let (code, summary, said) = run("simulate", PULLED, &["--set", &set]);
        assert_eq!(code, NUMERICAL, "{said}");
        let error = summary["error"].as_str().unwrap();
        for text in [error, &said] {
            assert!(text.contains("rod.model = \"consistent\""), "{text}");
        }
        let warning = said
            .lines()
            .find(|line| line.starts_with("warning"))
            .unwrap();
        assert!(
            warning.contains("consistent") && warning.contains("finer the grid"),
            "{warning}"
        );
        let consistent = ["--set", &set, "--set", "rod.model=consistent"];
        let (code, _, said) = run("simulate", PULLED, &consistent);
        assert_eq!(code, DONE, "{said}");
        assert!(!said.contains("dilatation"), "{said}");
    }
    let (code, _, said) = run("simulate", PULLED, &["--set", "rod.elements=10"]);
    assert_eq!(code, DONE, "{said}");
}

/// An upright arm under the weight number at which it topples by itself, which its payload makes fall, is told both numbers, of which the
/// fractions add up to more than 1; without the payload it stands.
#[test]
fn a_payload_is_counted_where_an_arm_topples() {
    let scene = |payload: f64| {
        format!(
            "[rod]\nlength_m = 0.3\nelements = 12\n[rod.material]\nyoungs_modulus_pa = 2e6\npoisson_ratio = 0.5\ndensity_kg_m3 = 1000.0\n\
             [rod.section]\nradius_m = 0.01\n[gravity]\nacceleration_m_s2 = [0.0, 0.0, -9.81]\n[payload]\nmass_kg = {payload}\n[time]\nend_s = 3.0\n"
        )
    };
    let (code, summary, said) = run("check", &scene(0.0), &[]);
    assert_eq!(code, DONE, "{said}");
    let share = summary["at_rest"]["weight_number"].as_f64().unwrap() / 7.837_347;
    assert!(share < 1.0 && !said.contains("TOPPLES"), "{share} {said}");
    let (code, _, said) = run("check", &scene(0.05), &[]);
    assert_eq!(code, DONE, "{said}");
    assert!(
        said.contains("TOPPLES under its own weight and its payload"),
        "{said}"
    );
    let (_, rest) = said.split_once("make up about 1: here ").unwrap();
    let sum: f64 = rest.split(')').next().unwrap().parse().unwrap();
    // m g L²/EI over Euler's π²/4.
    let stiffness = 2e6 * std::f64::consts::PI * 0.01_f64.powi(4) / 4.0;
    let payload = 0.05 * 9.81 * 0.09 / stiffness / (std::f64::consts::PI.powi(2) / 4.0);
    assert!(
        sum > 1.0 && (sum - share - payload).abs() < 0.01,
        "{sum} {share} {payload}"
    );

    // A simulation of it stands by its symmetry, and says so.
    let (code, summary, said) = run("simulate", &scene(0.05), &[]);
    assert_eq!(code, DONE, "{said}");
    assert!(summary["tip"]["position_m"][0].as_f64().unwrap().abs() < 1e-6);
    assert!(said.contains("by its symmetry"), "{said}");
    let (_, _, said) = run("simulate", &scene(0.0), &[]);
    assert!(!said.contains("symmetry"), "{said}");
}

/// A dead load along a straight arm above Euler's is told in a simulation, below it is not.
#[test]
fn a_buckling_load_is_told() {
    let stiffness = 1e6 * std::f64::consts::PI * 0.01_f64.powi(4) / 4.0;
    let euler = std::f64::consts::PI.powi(2) * stiffness / (4.0 * 0.09);
    for (factor, buckles) in [(0.8, false), (1.5, true)] {
        let scene = format!(
            "[rod]\nlength_m = 0.3\nelements = 12\n[rod.material]\nyoungs_modulus_pa = 1e6\npoisson_ratio = 0.5\ndensity_kg_m3 = 1000.0\n\
             [rod.section]\nradius_m = 0.01\n[[load]]\nnode = \"tip\"\nforce_n = [0.0, 0.0, {}]\nprofile = [[0.0, 0.0], [0.5, 1.0], [9.0, 1.0]]\n\
             [time]\nend_s = 2.0\n",
            -factor * euler
        );
        for verb in ["simulate", "check"] {
            let (code, _, said) = run(verb, &scene, &[]);
            assert_eq!(code, DONE, "{said}");
            assert_eq!(
                said.contains("by its symmetry"),
                buckles,
                "{verb} {factor}: {said}"
            );
        }
    }
}

/// A follower load below Beck's, 20.05 EI/L², at an implicit step beyond the automatic one: the step is the cause that is named, and nobody says
/// that the arm cannot stand.
#[test]
fn a_step_that_is_too_long_is_named() {
    let stiffness = 1e6 * std::f64::consts::PI * 0.01_f64.powi(4) / 4.0;
    let beck = 20.05 * stiffness / 0.09;
    let scene = format!(
        "[rod]\nlength_m = 0.3\nelements = 20\n[rod.material]\nyoungs_modulus_pa = 1e6\npoisson_ratio = 0.5\ndensity_kg_m3 = 1000.0\n\
         [rod.section]\nradius_m = 0.01\n[[load]]\nnode = \"tip\"\nframe = \"body\"\nforce_n = [0.0, 0.0, {}]\n\
         [[load]]\nnode = 0.5\nforce_n = [0.001, 0.0, 0.0]\n[time]\nend_s = 20.0\nstep_s = 0.01\nintegrator = \"implicit\"\n",
        -0.95 * beck
    );
    let (code, summary, said) = run("simulate", &scene, &[]);
    assert!(!said.contains("cannot stand"), "{said}");
    if code != DONE {
        let error = summary["error"].as_str().unwrap();
        assert!(
            error.contains("time.step_s") && error.contains("automatic"),
            "{error}"
        );
    }
}

/// Numbers that are powers of ten away from arms that there are, and loads that no arm bears, are named with their key; the scenes that come
/// with the program have none.
#[test]
fn what_is_hardly_meant_is_named() {
    let scene = |e: f64, density: f64, length: f64, moment: f64| {
        format!(
            "[rod]\nlength_m = {length}\nelements = 8\n[rod.material]\nyoungs_modulus_pa = {e}\npoisson_ratio = 0.5\ndensity_kg_m3 = {density}\n\
             [rod.section]\nradius_m = {}\n[[load]]\nnode = \"tip\"\nframe = \"body\"\nmoment_n_m = [{moment}, 0.0, 0.0]\n[time]\nend_s = 0.01\n\
             step_s = \"auto\"\n",
            0.05 * length
        )
    };
    let unit = 1e6 * std::f64::consts::PI * 0.05_f64.powi(4) / 4.0;
    for (text, key) in [
        (scene(1e6, 1000.0, 1.0, unit), None),
        (
            scene(1.0, 1000.0, 1.0, 0.0),
            Some("rod.material.youngs_modulus_pa: "),
        ),
        (
            scene(1e6, 1e6, 1.0, 0.0),
            Some("rod.material.density_kg_m3: "),
        ),
        (scene(1e6, 1000.0, 300.0, 0.0), Some("rod: ")),
        (
            scene(1e6, 1000.0, 1.0, 1000.0 * unit),
            Some("load.0.moment_n_m: "),
        ),
        (
            scene(1e6, 1000.0, 1.0, 0.0)
                + "[[tendon]]\noffset_m = [0.02, 0.0]\nprofile = [[0.0, 1.0]]\n\
                   [[tendon]]\noffset_m = [20.0, 0.0]\nprofile = [[0.0, 1.0]]\n",
            Some("tendon.1.offset_m: "),
        ),
    ] {
        let (code, summary, said) = run("check", &text, &[]);
        assert_eq!(code, DONE, "{said}");
        assert_eq!(
            said.contains("hardly meant") || said.contains("mistaken"),
            key.is_some(),
            "{said}"
        );
        let warnings = summary["warnings"].to_string();
        assert!(
            key.is_none_or(|key| warnings.contains(key)),
            "{key:?} {warnings}"
        );
    }
}

/// A simulation says how near the arm comes to obstacles that it does not know: the sag of an arm over a half-space, to the radius.
#[test]
fn simulations_tell_their_clearance() {
    let scene = |height: f64| {
        format!(
            "[rod]\nlength_m = 0.5\nelements = 10\n[rod.material]\nyoungs_modulus_pa = 1e6\npoisson_ratio = 0.5\ndensity_kg_m3 = 1000.0\n\
             [rod.section]\nradius_m = 0.02\n[base]\ndirection = [1.0, 0.0, 0.0]\n[gravity]\nacceleration_m_s2 = [0.0, 0.0, -9.81]\n\
             [initial]\nshape = \"equilibrium\"\n[[obstacle]]\nname = \"floor\"\nhalf_space = {{ point_m = [0.0, 0.0, {height}], normal = [0.0, 0.0, 1.0] }}\n\
             [time]\nend_s = 0.05\n"
        )
    };
    let (code, summary, said) = run("simulate", &scene(-1.0), &[]);
    assert_eq!(code, DONE, "{said}");
    let found = &summary["clearance"][0];
    let z = summary["tip"]["position_m"][2].as_f64().unwrap();
    let least = found["least_m"].as_f64().unwrap();
    assert!((least - (z + 1.0 - 0.02)).abs() < 1e-6, "{found} {z}");
    assert_eq!(found["obstacle"], "floor");
    assert_eq!(found["place"], 1.0);
    assert!(!said.contains("goes through"), "{said}");
    let (_, _, said) = run("simulate", &scene(-0.03), &[]);
    assert!(said.contains("goes through"), "{said}");
}

/// A scene with controls and nothing that is wanted of them is one for a simulation, as it is and from its result.
#[test]
fn controls_without_a_task_are_simulated_and_checked() {
    let scene = "[rod]\nlength_m = 1.0\nelements = 4\n[rod.material]\nyoungs_modulus_pa = 1e6\npoisson_ratio = 0.5\ndensity_kg_m3 = 1000.0\n\
        [rod.section]\nradius_m = 0.05\n[time]\nend_s = 0.05\n[control]\nforce_max_n = 2.0\n";
    let (code, _, said) = run("check", scene, &[]);
    assert_eq!(code, DONE, "{said}");
    assert!(said.contains("plays no part"), "{said}");
    let (code, _, said) = run("simulate", scene, &[]);
    assert_eq!(code, DONE, "{said}");
}
