//! `efforts.csv` of an arm with a winch and an effort with a lag, changed after the solve: `verify` names the column.

#![cfg(feature = "cli")]

use std::fs;
use std::process::Command;

use serde_json::Value;
use softarm::output::{EffortRow, read_efforts, write_efforts};

use crate::tool::{DONE, REJECTED};

/// A hanging arm that a winch and a tendon with a lag lead to a tip, where it need not stay.
const SCENE: &str = r#"
[rod]
length_m = 0.3
elements = 5
[rod.material]
youngs_modulus_pa = 1e5
poisson_ratio = 0.4
density_kg_m3 = 1070.0
[rod.section]
radius_m = 0.01
[base]
direction = [0.0, 0.0, -1.0]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[damping]
viscous_1_s = 2.0
internal_s = 5e-3
[[tendon]]
name = "winch"
offset_m = [0.008, 0.0]
displacement_m = [-0.03, 0.0]
rest_displacement_m = -0.002
compliance_1_n = 5e-3
free_length_m = 0.1
[[tendon]]
name = "motor"
offset_m = [0.0, 0.008]
tension_n = [0.0, 1.0]
lag_s = 0.05
pretension_n = 0.05
[initial]
shape = "equilibrium"
[time]
end_s = 0.6
[control]
blocks = 8
[task]
position_m = [0.02, -0.02, -0.29]
tolerance_m = 2e-3
at_rest = false
"#;

fn softarm(folder: &std::path::Path, arguments: &[&str]) -> (i32, Value, String) {
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

/// The solve is certified and its files are verified; a change of any column of `efforts.csv` by a thousandth is rejected at that column.
#[test]
fn efforts_of_winches_and_lags_are_verified() {
    efforts_are_verified(&["time.integrator=explicit"]);
}

/// The same of implicit steps.
#[test]
fn efforts_of_winches_in_implicit_steps_are_verified() {
    efforts_are_verified(&["time.integrator=implicit", "time.step_s=2e-3"]);
}

fn efforts_are_verified(steps: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("scene.toml"), SCENE).unwrap();
    let mut solve = vec!["solve", "scene.toml", "--out", "run"];
    solve.extend(steps.iter().flat_map(|set| ["--set", set]));
    let (code, summary, words) = softarm(folder.path(), &solve);
    assert_eq!(code, DONE, "{words}");
    assert_eq!(summary["slack"][0]["name"], "winch");
    let path = folder.path().join("run/efforts.csv");
    let header = fs::read_to_string(&path).unwrap();
    let header = header.lines().next().unwrap();
    assert_eq!(header, "t,name,effort,coordinate,command,displacement");
    let n_rows = fs::read_to_string(&path).unwrap().lines().count() - 1;
    let rows = read_efforts(&path, n_rows, 5).unwrap();
    let verify = || softarm(folder.path(), &["verify", "run", "--quick"]);
    assert_eq!(verify().0, DONE, "{}", verify().2);
    // A row of the winch and one of the motor, late in the motion.
    let late = n_rows / 2 / 2 * 2;
    type Change = fn(&mut EffortRow);
    let changes: [(&str, usize, Change); 5] = [
        ("effort", late, |row| row.effort *= 1.001),
        ("coordinate", late + 1, |row| row.coordinate *= 1.001),
        ("displacement", late, |row| {
            row.displacement = row.displacement.map(|z| z.map(|z| z * 1.001));
        }),
        ("command", late + 1, |row| {
            row.command = row.command.map(|c| c * 1.001)
        }),
        ("displacement", late + 1, |row| {
            row.displacement = Some(None)
        }),
    ];
    for (column, at, change) in changes {
        let mut changed = rows.clone();
        change(&mut changed[at]);
        write_efforts(&path, &changed).unwrap();
        let (code, summary, words) = verify();
        assert_eq!(code, REJECTED, "{column}: {words}");
        let mismatch = (summary["mismatches"].as_array().unwrap().iter())
            .find(|mismatch| mismatch["file"] == "efforts.csv")
            .unwrap();
        let place = mismatch["place"].as_str().unwrap();
        assert!(place.starts_with(column), "{place} is not {column}");
    }
}
