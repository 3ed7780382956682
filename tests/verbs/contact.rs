//! Arms that touch bodies, through the verbs: figures of the check, a simulation, the statics, a solve of the built-in scene, a loop.

#![cfg(feature = "cli")]

use crate::tool;

use std::fs;
use std::path::PathBuf;
use std::process::Command;

use serde_json::Value;
use tempfile::TempDir;
use tool::{DONE, USAGE};

/// An arm that begins straight above a table and falls onto it and a ball.
const FALL: &str = "\
[rod]
length_m = 0.4
elements = 10
[rod.material]
youngs_modulus_pa = 2e5
poisson_ratio = 0.4
density_kg_m3 = 1070.0
[rod.section]
radius_m = 0.01
[base]
direction = [1.0, 0.0, 0.0]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[damping]
viscous_1_s = 10.0
[[contact]]
name = \"table\"
half_space = { point_m = [0.0, 0.0, -0.06], normal = [0.0, 0.0, 2.0] }
penetration_m = 1e-3
[[contact]]
sphere = { center_m = [0.2, 0.0, -0.08], radius_m = 0.05 }
penetration_m = 2e-3
force_n = 2.0
[time]
end_s = 2.0
";

struct Desk(TempDir);

impl Desk {
    fn with(scene: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("scene.toml"), scene).unwrap();
        Self(folder)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Returns exit code, summary, and words of a run.
    fn run(&self, arguments: &[&str]) -> (i32, Value, String) {
        let output = Command::new(env!("CARGO_BIN_EXE_softarm"))
            .args(arguments)
            .args(["--threads", "1"])
            .current_dir(self.0.path())
            .env("NO_COLOR", "1")
            .output()
            .unwrap();
        let words = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!words.contains("panicked"), "{words}");
        let summary = serde_json::from_slice(&output.stdout).unwrap_or_default();
        (output.status.code().unwrap(), summary, words)
    }
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

/// A damped arm that fell comes to rest as its statics say, on both bodies, hardly deeper than their penetrations; its scene has the forces
/// written out, of a body without one the weight.
#[test]
fn an_arm_falls_and_lies() {
    let desk = Desk::with(FALL);
    let (code, summary, words) = desk.run(&["simulate", "scene.toml", "--out", "run", "--json"]);
    assert_eq!(code, DONE, "{words}");
    let names: Vec<_> = (0..2)
        .map(|i| summary["contact"][i]["contact"].clone())
        .collect();
    assert_eq!(names, ["table", "contact 1"]);
    for i in 0..2 {
        assert!(
            number(&summary["contact"][i]["penetration_m"]) > 1e-4,
            "{summary}"
        );
    }
    let (code, at_rest, words) =
        desk.run(&["equilibrium", "scene.toml", "--out", "rest", "--json"]);
    assert_eq!(code, DONE, "{words}");
    let tips = [&summary["tip"]["position_m"], &at_rest["tip"]["position_m"]];
    for axis in 0..3 {
        let [moved, rest] = tips.map(|tip| number(&tip[axis]));
        // What e^(-10/s 2 s/2) leaves of the fall, a twentieth of its height of 5 cm at most, is damped further by every bounce.
        assert!((moved - rest).abs() < 1e-3, "{axis}: {moved} {rest}");
    }
    let scene = fs::read_to_string(desk.path("run/scene.toml")).unwrap();
    let forces: Vec<f64> = (scene
        .lines()
        .filter_map(|line| line.strip_prefix("force_n = ")))
    .map(|number| number.parse().unwrap())
    .collect();
    let mass = 1070.0 * std::f64::consts::PI * 1e-4 * 0.4;
    assert_eq!(forces.len(), 2);
    assert!(
        (forces[0] / (mass * 9.81) - 1.0).abs() < 1e-12,
        "{forces:?}"
    );
    assert_eq!(forces[1], 2.0);
    let page = fs::read_to_string(desk.path("run/report.html")).unwrap();
    assert!(page.contains("\"is_touched\":true") && page.contains("contact 1"));
    assert!(page.contains("without friction"));
}

/// A rod of 3 mm is pushed through a slot of 1 mm to spare between two bars of 5 mm, with elements that are three and six times as long as a bar
/// is thick: it lies on the lower bar, wherever its nodes are, hardly deeper than the penetration, and never goes through.
#[test]
fn a_rod_is_pushed_through_a_slot() {
    let slot = r#"
[rod]
length_m = 0.3
elements = 20
[rod.material]
youngs_modulus_pa = 5e6
poisson_ratio = 0.45
density_kg_m3 = 1100.0
[rod.section]
radius_m = 0.003
[base]
kind = "driven"
position_m = [-0.265, 0.0, 0.0]
direction = [1.0, 0.0, 0.0]
motion = { translation_m = [[0.0, 0.0, 0.0, 0.0], [1.0, 0.1, 0.0, 0.0]] }
[gravity]
acceleration_m_s2 = [0.0, 0.0, -1]
[damping]
viscous_1_s = 5.0
internal_s = 0.005
[[contact]]
name = "lower"
capsule = { from_m = [0.02, -0.1, -0.0085], to_m = [0.02, 0.1, -0.0085], radius_m = 0.005 }
penetration_m = 5e-4
[[contact]]
name = "upper"
capsule = { from_m = [0.02, -0.1, 0.0085], to_m = [0.02, 0.1, 0.0085], radius_m = 0.005 }
penetration_m = 5e-4
[time]
end_s = 1.2
"#;
    let desk = Desk::with(slot);
    let mut depths = Vec::new();
    for elements in ["rod.elements=10", "rod.elements=20"] {
        let (code, summary, words) = desk.run(&[
            "simulate",
            "scene.toml",
            "--out",
            "run",
            "--json",
            "--set",
            elements,
        ]);
        assert_eq!(code, DONE, "{words}");
        for own in summary["contact"].as_array().unwrap() {
            assert!(number(&own["through"]) < 0.2, "{elements}: {own}");
        }
        depths.push(number(&summary["contact"][0]["penetration_m"]));
    }
    // The force of the bar is that of twice the weight at most: the rod turns about it while it is pushed on.
    assert!(
        depths.iter().all(|depth| (2e-4..1e-3).contains(depth)),
        "{depths:?}"
    );
    assert!((depths[0] / depths[1] - 1.0).abs() < 0.1, "{depths:?}");
}

/// A soft wire of 2 mm that falls onto something that is thinner than it, at rest or so fast that it passes between two steps, with a bar instead of
/// a floor below it.
fn falling(body: &str, height: f64, speed: f64, end: f64) -> String {
    format!(
        r#"
[rod]
length_m = 0.3
elements = 8
[rod.material]
preset = "dragon-skin-30"
[rod.section]
radius_m = 0.001
[base]
kind = "free"
position_m = [0.05, 0.0, {height}]
direction = [1.0, 0.0, 0.0]
[initial]
velocity_m_s = [0.0, 0.0, {speed}]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[[contact]]
{body}
[time]
end_s = {end}
"#
    )
}

/// What a thin body does not hold is told, and the depth is looked for on the way between two steps as well: a wire falls slowly onto a soft plate,
/// whose middle it comes through, and one of 100 m/s passes a thin bar within a step of 5 ms. A plate that is hard enough holds it without a word.
#[test]
fn passing_through_thin_bodies_is_told() {
    let plate = |penetration: &str| {
        format!(
            "box = {{ center_m = [0.2, 0.0, 0.0], size_m = [0.4, 0.2, 0.001] }}\npenetration_m = {penetration}"
        )
    };
    let bar = "capsule = { from_m = [0.18, -0.2, 0.0], to_m = [0.18, 0.2, 0.0], radius_m = 5e-4 }\npenetration_m = 1e-4";
    for (body, speed, end, step, is_told) in [
        (plate("1e-3"), 0.0, 0.2, "\"auto\"", true),
        (bar.into(), -100.0, 0.01, "\"auto\"", true),
        (bar.into(), -100.0, 0.005, "5e-3", true),
        (plate("1e-5"), 0.0, 0.2, "\"auto\"", false),
    ] {
        let desk = Desk::with(&falling(&body, 0.1, speed, end));
        let scheme = if step == "5e-3" { "implicit" } else { "auto" };
        let (code, summary, words) = desk.run(&[
            "simulate",
            "scene.toml",
            "--out",
            "run",
            "--json",
            "--set",
            &format!("time.step_s={step}"),
            "--set",
            &format!("time.integrator={scheme:?}"),
        ]);
        assert_eq!(code, DONE, "{words}");
        let told = summary["warnings"]
            .to_string()
            .contains("of the way to its middle");
        assert_eq!(told, is_told, "{body} {speed} {step}: {summary}");
        assert_eq!(number(&summary["contact"][0]["through"]) > 0.5, is_told);
    }
}

/// An arm that is led through a bar that cannot hold it is no certified reach.
#[test]
fn reaching_through_a_bar_is_refused() {
    let through = r#"
[rod]
length_m = 0.3
elements = 6
[rod.material]
youngs_modulus_pa = 5e6
poisson_ratio = 0.4
density_kg_m3 = 1100.0
[rod.section]
radius_m = 0.003
[base]
direction = [1.0, 0.0, 0.0]
[damping]
viscous_1_s = 6.0
[[contact]]
capsule = { from_m = [0.2, -0.2, -0.012], to_m = [0.2, 0.2, -0.012], radius_m = 0.001 }
force_n = 0.02
penetration_m = 2e-3
[time]
end_s = 1.0
[task]
position_m = [0.27, 0.0, -0.1]
tolerance_m = 4e-3
at_rest = false
[control]
blocks = 6
force_max_n = 0.05
[solver]
guess = "static"
"#;
    let (code, summary, words) =
        Desk::with(through).run(&["solve", "scene.toml", "--out", "run", "--json"]);
    assert_eq!(code, tool::REJECTED, "{words}");
    let criteria = summary["check"]["criteria"].as_array().unwrap();
    let own = criteria.iter().find(|own| own["name"] == "contact_through");
    assert!(number(&own.unwrap()["value"]) > 0.9, "{criteria:?}");
}

/// A free arm that begins pressed into a floor has energy there, which it gets back: it is flung out, which is said, and the run is right.
#[test]
fn arms_that_begin_inside_are_flung_out() {
    let inside = r#"
[rod]
length_m = 0.3
elements = 8
[rod.material]
preset = "dragon-skin-30"
[rod.section]
radius_m = 0.01
[base]
kind = "free"
position_m = [0.0, 0.0, 0.009]
direction = [1.0, 0.0, 0.0]
[[contact]]
half_space = { point_m = [0.0, 0.0, 0.0], normal = [0.0, 0.0, 1.0] }
penetration_m = 1e-4
[time]
end_s = 0.05
"#;
    let (code, summary, words) =
        Desk::with(inside).run(&["simulate", "scene.toml", "--out", "run", "--json"]);
    assert_eq!(code, DONE, "{words}");
    assert!(
        summary["warnings"]
            .to_string()
            .contains("is flung out of it")
    );
    // The stored energy, EI/L² per length at the depth of the penetration, becomes kinetic: all nodes rise alike.
    let energy = &summary["energy_J"];
    let [from, to] = ["initial", "final"].map(|name| number(&energy[name]));
    assert!((to / from - 1.0).abs() < 0.05, "{energy}");
}

/// A run whose steps an impact made shorter goes on from its end, with the rows of one that was not cut in two; one that ends before the impact begins
/// anew when it is continued; and the resolved scene has the same rows.
#[test]
fn shorter_steps_go_on() {
    let desk = Desk::with(
        &FALL
            .replace("penetration_m = 1e-3", "penetration_m = 1e-6")
            .replace("viscous_1_s = 10.0", "viscous_1_s = 1.0"),
    );
    let run = |scene: &str, out: &str, end: &str, more: &[&str]| {
        let end = format!("time.end_s={end}");
        let arguments = ["simulate", scene, "--out", out, "--json", "--set", &end];
        let (code, summary, words) = desk.run(&[&arguments, more].concat());
        assert_eq!(code, DONE, "{words}");
        summary
    };
    let whole = run("scene.toml", "whole", "0.4", &[]);
    let part = run("scene.toml", "parts", "0.2", &[]);
    let short = number(&part["step_s"]);
    assert!((short / number(&whole["step_s"]) - 1.0).abs() < 1e-12);
    let early = run("scene.toml", "early", "0.05", &[]);
    assert!(number(&early["step_s"]) > 4.0 * short);
    let rows = |name: &str| {
        let file = desk.path(name).join("trajectory.npz");
        fs::metadata(file).unwrap().len()
    };
    for (out, digits) in [("parts", 1e-12), ("early", 1e-2)] {
        let on = run("scene.toml", out, "0.4", &["--resume"]);
        let [here, there] = [&on, &whole].map(|own| number(&own["energy_J"]["final"]));
        assert!((here / there - 1.0).abs() < digits, "{out}: {here} {there}");
        assert!(number(&on["step_s"]) < 0.5 * number(&early["step_s"]));
    }
    assert_eq!(rows("parts"), rows("whole"));
    run("whole/scene.toml", "again", "0.4", &[]);
    assert_eq!(rows("again"), rows("whole"));
}

/// The check prints what contacts do to the step; one that shortens it has a remedy, which works; an arm that begins inside is named.
#[test]
fn the_check_knows_the_step() {
    let desk = Desk::with(FALL);
    let check = |more: &[&str]| {
        let mut arguments = vec!["check", "scene.toml", "--json"];
        arguments.extend(more);
        let (code, summary, words) = desk.run(&arguments);
        assert_eq!(code, DONE, "{words}");
        let warnings = summary["warnings"].to_string();
        (summary, warnings)
    };
    let (usual, warnings) = check(&[]);
    assert!(!warnings.contains("penetration_m"), "{warnings}");
    let contact = &usual["contact"];
    // 2/ω, ω² = 2 Σ F/δ over the mass: one node has both.
    let mass = 1070.0 * std::f64::consts::PI * 1e-4 * 0.4;
    let omega = (2.0 * (9.81 / 1e-3 + 2.0 / (2e-3 * mass))).sqrt();
    assert!((number(&contact["step_s"]) * omega / 2.0 - 1.0).abs() < 1e-9);
    let explicit = "time.integrator='explicit'";
    let stiff = [
        "--set",
        explicit,
        "--set",
        "contact.0.penetration_m=1e-7",
        "--set",
        "contact.1.penetration_m=1e-7",
    ];
    let (short, warnings) = check(&stiff);
    assert!(warnings.contains("contact.penetration_m"), "{warnings}");
    assert!(
        number(&short["stable_step_s"]) < 0.5 * number(&short["contact"]["stable_step_without_s"])
    );
    let factor = (warnings.split(" times the penetration_m").next().unwrap())
        .rsplit(' ')
        .next()
        .unwrap()
        .parse::<f64>()
        .unwrap();
    let remedy = format!("{:e}", 1e-7 * factor * 1.01);
    let [a, b] = [0, 1].map(|i| format!("contact.{i}.penetration_m={remedy}"));
    let (_, warnings) = check(&["--set", explicit, "--set", &a, "--set", &b]);
    assert!(!warnings.contains("contact.penetration_m"), "{warnings}");
    let (_, warnings) = check(&["--set", "contact.0.half_space.point_m=[0.0, 0.0, 0.02]"]);
    assert!(
        warnings.contains("deep in table") && warnings.contains("flung"),
        "{warnings}"
    );
}

/// Bad keys are errors that name the contact and the remedy; a word for contact finds its page.
#[test]
fn errors_name_the_contact() {
    let desk = Desk::with(FALL);
    for (set, expected) in [
        ("contact.0.penetration_m=0.0", "penetration"),
        ("contact.0.penetration_m=-1e-3", "table"),
        ("contact.0.force_n=nan", "table"),
        ("contact.1.from=1.0", "does not come after from"),
        (
            "contact.1.box={center_m=[0.0, 0.0, 0.0], size_m=[1.0, 1.0, 1.0]}",
            "contact 1",
        ),
        ("contact.0.half_space.normal=[0.0, 0.0, 0.0]", "table"),
        ("contact.0.friction=0.3", "without friction"),
        ("floor.height_m=0.0", "\"Contact\" in docs/solves.md"),
        ("collision.enabled=true", "[[contact]]"),
    ] {
        let (code, _, words) = desk.run(&["check", "scene.toml", "--set", set]);
        assert_eq!(code, USAGE, "{set}: {words}");
        assert!(words.contains(expected), "{set}: {words}");
    }
    let without = FALL.replace("penetration_m = 1e-3\n", "");
    let (code, _, words) = Desk::with(&without).run(&["check", "scene.toml"]);
    assert_eq!(code, USAGE);
    assert!(words.contains("penetration_m"), "{words}");
}

/// The built-in scene is certified with its contact, and stays; every analytic derivative of it agrees with differences.
#[test]
fn an_arm_slides_along_a_table() {
    let desk = Desk::with("");
    let (code, summary, words) = desk.run(&["solve", "reach-table", "--out", "run", "--json"]);
    assert_eq!(code, DONE, "{words}");
    assert_eq!(summary["stays"]["verdict"], "stays");
    let contact = &summary["check"]["contact"];
    let depth = number(&contact["penetration_m"]);
    assert!(depth > 1e-4 && depth < 5e-3, "{depth}");
    let (code, _, words) = desk.run(&["derivatives", "reach-table", "--json"]);
    assert_eq!(code, DONE, "{words}");
}

/// A loop whose model and plant lie on the same table follows a path across it, with a plant that is softer; the page has the table.
#[test]
fn a_loop_slides_along_a_table() {
    let scene = "\
[rod]
length_m = 0.4
elements = 6
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.4
density_kg_m3 = 1070.0
[rod.section]
radius_m = 0.01
[base]
direction = [1.0, 0.0, 0.0]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[damping]
viscous_1_s = 4.0
[[contact]]
name = \"table\"
half_space = { point_m = [0.0, 0.0, -0.03], normal = [0.0, 0.0, 1.0] }
penetration_m = 1e-3
[initial]
shape = \"equilibrium\"
[time]
end_s = 1.5
[control]
force_max_n = 0.5
[[objective.track]]
weight = 3e4
path_m = [[0.0, 0.398, 0.0, -0.021], [0.6, 0.391, 0.06, -0.021], [1.0, 0.391, 0.06, -0.021]]
[mpc]
period_s = 0.02
horizon_s = 0.2
computing = \"fixed\"
counted_from_s = 1.2
[plant]
elements = 12
stiffness_factor = 0.9
";
    let desk = Desk::with(scene);
    let (code, summary, words) = desk.run(&["mpc", "scene.toml", "--out", "run", "--json"]);
    assert_eq!(code, DONE, "{words}");
    let error = number(&summary["tip_error_over_length"]["rms"]);
    // Beyond a hundredth, a loop has advice.
    assert!(error < 0.01, "{error}");
    let page = fs::read_to_string(desk.path("run/report.html")).unwrap();
    assert!(page.contains("\"is_touched\":true"));
}
