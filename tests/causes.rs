//! What a run that broke down says of its cause: an arm that topples, a model that is no variation of an action.

#![cfg(feature = "cli")]

mod tool;

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
[initial]
shape = \"equilibrium\"
[time]
end_s = 1.5
[task]
position_m = [0.1, 0.0, {height}]
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
