//! Contacts of a result, changed after the solve: `verify` rejects a body that is softer, stiffer or elsewhere, and a summary that says so.

#![cfg(feature = "cli")]

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::tool::{DONE, REJECTED};

/// An arm that lies on a table and is led sideways along it.
const SCENE: &str = r#"
[rod]
length_m = 0.4
elements = 8
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
name = "table"
half_space = { point_m = [0.0, 0.0, -0.03], normal = [0.0, 0.0, 1.0] }
penetration_m = 1e-3
[initial]
shape = "equilibrium"
[time]
end_s = 0.4
[control]
blocks = 6
force_max_n = 0.5
[task]
position_m = [0.387, 0.06, -0.0207]
tolerance_m = 2e-3
at_rest = false
"#;

fn softarm(folder: &Path, arguments: &[&str]) -> (i32, Value, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_softarm"))
        .args(arguments)
        .args(["--json", "--threads", "1"])
        .current_dir(folder)
        .env("NO_COLOR", "1")
        .output()
        .unwrap();
    let words = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!words.contains("panicked"), "{words}");
    let summary = serde_json::from_slice(&output.stdout).unwrap_or_default();
    (output.status.code().unwrap(), summary, words)
}

/// A reach that leans on a table is certified with its penetration, and verified. Its scene with a penetration, a force or a table that are
/// off by a thousandth has another motion, and its summary with less depth or a smaller change is not that of the motion: all are rejected.
#[test]
fn contacts_are_verified() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    fs::write(folder.path().join("scene.toml"), SCENE).unwrap();
    let (code, summary, words) = softarm(folder.path(), &["solve", "scene.toml", "--out", "run"]);
    assert_eq!(code, DONE, "{words}");
    let contact = &summary["check"]["contact"];
    assert_eq!(contact["contact"], "table");
    let depth = contact["penetration_m"].as_f64().unwrap();
    assert!((1e-4..1e-2).contains(&depth), "{depth}");
    assert!(contact["stiffer_m"].as_f64().unwrap() > 0.0);
    let page = fs::read_to_string(run.join("report.html")).unwrap();
    assert!(page.contains("\"is_touched\":true"));
    let verify = || softarm(folder.path(), &["verify", "run", "--quick"]);
    assert_eq!(verify().0, DONE, "{}", verify().2);

    let scene = fs::read_to_string(run.join("scene.toml")).unwrap();
    let force = scene
        .lines()
        .find(|line| line.starts_with("force_n = "))
        .unwrap();
    let number: f64 = force["force_n = ".len()..].parse().unwrap();
    let stronger = format!("force_n = {}", number * 1.001);
    for (from, to) in [
        ("penetration_m = 0.001", "penetration_m = 0.001001"),
        (force, stronger.as_str()),
        ("-0.03", "-0.03001"),
    ] {
        let changed = scene.replace(from, to);
        assert_ne!(changed, scene, "{from}");
        fs::write(run.join("scene.toml"), changed).unwrap();
        let (code, _, words) = verify();
        assert_eq!(code, REJECTED, "{to}: {words}");
    }
    fs::write(run.join("scene.toml"), &scene).unwrap();

    let said = fs::read_to_string(run.join("summary.json")).unwrap();
    for key in ["penetration_m", "over_penetration", "stiffer_m"] {
        let mut changed: Value = serde_json::from_str(&said).unwrap();
        let number = &mut changed["check"]["contact"][key];
        *number = (0.9 * number.as_f64().unwrap()).into();
        fs::write(run.join("summary.json"), changed.to_string()).unwrap();
        let (code, _, words) = verify();
        assert_eq!(code, REJECTED, "{key}: {words}");
        assert!(words.contains(key), "{words}");
    }
    fs::write(run.join("summary.json"), &said).unwrap();
    assert_eq!(verify().0, DONE);
}

/// Bodies as soft as a tenth of the arm are not rigid: the certificate says so, and by which factor `penetration_m` should fall.
#[test]
fn soft_bodies_are_rejected() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("scene.toml"), SCENE).unwrap();
    let soft = [
        "solve",
        "scene.toml",
        "--out",
        "run",
        "--set",
        "contact.0.penetration_m=0.04",
        "--set",
        "task.position_m=[0.387, 0.06, -0.06]",
    ];
    let (code, summary, words) = softarm(folder.path(), &soft);
    assert_eq!(code, REJECTED, "{words}");
    assert_eq!(
        summary["check"]["failed"][0], "stiffer_contact_m",
        "{words}"
    );
    assert!(words.contains("multiply every penetration_m"), "{words}");
}
