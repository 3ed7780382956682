//! Controls are named numbers in every file: two tendons with a pretension, under names that CSV has to quote.

#![cfg(feature = "cli")]

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::{Value, json};
use softarm::output::{ControlRow, EffortRow, read_controls, read_efforts, write_controls};
use tempfile::TempDir;

use crate::tool::{DONE, NOT_CONVERGED, REJECTED, USAGE};

/// Name of the second tendon.
const RIGHT: &str = "right, \"#2\"\nof two";

/// An arm that two tendons bend, in the shape of an equilibrium at the end, with gains.
const SCENE: &str = r##"
[rod]
length_m = 0.2
elements = 4
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.01
[damping]
viscous_1_s = 5.0
[time]
end_s = 0.5
[[tendon]]
name = "left"
offset_m = [0.008, 0.0]
tension_n = [0.0, 10.0]
pretension_n = 1.0
[[tendon]]
name = "right, \"#2\"\nof two"
offset_m = [-0.008, 0.0]
tension_n = [0.0, 10.0]
pretension_n = 1.0
[task]
position_m = [0.03, 0.0, 0.195]
tolerance_m = 2e-3
[control]
blocks = 3
[control.feedback]
"##;

struct Desk(TempDir);

impl Desk {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("scene.toml"), SCENE).unwrap();
        Self(folder)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Exit code, summary and words of a run.
    fn run(&self, line: &[&str]) -> (i32, Value, String) {
        let output = Command::new(env!("CARGO_BIN_EXE_softarm"))
            .args(line)
            .args(["--json", "--threads", "1"])
            .current_dir(self.0.path())
            .env("NO_COLOR", "1")
            .output()
            .unwrap();
        let words = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!words.contains("panicked"), "{words}");
        let summary = serde_json::from_slice(&output.stdout).unwrap_or_default();
        (output.status.code().unwrap(), summary, words)
    }

    #[track_caller]
    fn done(&self, line: &[&str]) -> (Value, String) {
        let (code, summary, words) = self.run(line);
        assert_eq!(code, DONE, "{line:?}: {words}");
        (summary, words)
    }
}

fn headings() -> [String; 2] {
    ["left (N)".into(), format!("{RIGHT} (N)")]
}

fn controls(path: &Path, n_rows: usize) -> Vec<ControlRow> {
    read_controls(path, &headings(), n_rows).unwrap()
}

fn efforts(path: &Path, n_times: usize) -> Vec<EffortRow> {
    read_efforts(path, 2 * n_times, RIGHT.len()).unwrap()
}

/// The words of an array of text, UTF-32 after a header that ends a line.
fn words_of(path: &Path, name: &str) -> Vec<String> {
    let mut archive = zip::ZipArchive::new(fs::File::open(path).unwrap()).unwrap();
    let mut bytes = Vec::new();
    let mut entry = archive.by_name(name).unwrap();
    entry.read_to_end(&mut bytes).unwrap();
    let start = bytes.iter().position(|byte| *byte == b'\n').unwrap() + 1;
    let header = String::from_utf8_lossy(&bytes[..start]).into_owned();
    let width = header.split("'<U").nth(1).unwrap().split('\'').next();
    let width: usize = width.unwrap().parse().unwrap();
    (bytes[start..].chunks(4 * width))
        .map(|word| {
            let code = |four: &[u8]| u32::from_le_bytes(four.try_into().unwrap());
            let codes = word.chunks(4).map(code).filter(|code| *code != 0);
            codes.map(|code| char::from_u32(code).unwrap()).collect()
        })
        .collect()
}

/// Files, summary, certificate and gains have the tensions by the names of the tendons, in N, whole: those of `efforts.csv` at the knots.
/// None has a wrench, on which nothing of the arm acts. The files are verified, and give the page again to the byte.
#[test]
fn tendons_are_called_by_their_names() {
    let desk = Desk::new();
    let (summary, words) = desk.done(&["solve", "scene.toml", "--out", "run"]);
    assert_eq!(summary["schema_version"], 2);
    assert!(!words.contains("control x") && !words.contains("of node 0"));
    let path = desk.path("run/controls.csv");
    let text = fs::read_to_string(&path).unwrap();
    let header = "t_start,t_end,left (N),\"right, \"\"#2\"\"\nof two (N)\"\n";
    assert!(text.starts_with(header), "{text}");
    // Four knots of three blocks, and what is held.
    let rows = controls(&path, 5);
    let n_times = summary["steps"].as_u64().unwrap() as usize + 1;
    let acting = efforts(&desk.path("run/efforts.csv"), n_times);
    for row in &rows[..4] {
        let at = (acting.iter())
            .position(|own| (own.t - row.t_start).abs() < 1e-9)
            .unwrap();
        for (value, own) in row.values.iter().zip(&acting[at..]) {
            // Rounding of a difference from the pretension.
            assert!((value - own.effort).abs() < 1e-14, "{value} {}", own.effort);
            assert!((-1e-9..=10.0 + 1e-9).contains(value));
        }
    }

    let stays = &summary["stays"];
    assert!(stays["wrench"].is_null());
    for (i, name) in ["left", RIGHT].into_iter().enumerate() {
        let own = &stays["controls"][i];
        assert_eq!((&own["name"], &own["unit"]), (&json!(name), &json!("N")));
        assert_eq!(own["value"].as_f64().unwrap(), rows[4].values[i]);
    }
    for part in summary["check"]["kkt_parts"].as_array().unwrap() {
        let worst = &part["worst"];
        if part["name"] == "stationarity" && !worst.is_null() {
            let name = worst["name"].as_str().unwrap();
            assert!(name == "left" || name == RIGHT, "{worst}");
            assert!(worst["node"].is_null(), "{worst}");
            assert_eq!(
                (&worst["component"], &worst["unit"]),
                (&json!(""), &json!("1/(N)"))
            );
        }
    }
    assert_eq!(
        words_of(&desk.path("run/feedback.npz"), "input.npy"),
        headings()
    );
    let motion = softarm::output::MotionRecord::read_npz(&desk.path("run/trajectory.npz")).unwrap();
    assert!(
        motion
            .tip_force
            .iter()
            .chain(&motion.tip_moment)
            .all(|u| *u == 0.0)
    );
    let page = fs::read_to_string(desk.path("run/report.html")).unwrap();
    assert!(page.contains("\"controls\":null"));

    desk.done(&["verify", "run", "--quick"]);
    desk.done(&["report", "run"]);
    assert!(page == fs::read_to_string(desk.path("run/report.html")).unwrap());
}

/// A value in any column, changed by a hundredth of the range, is rejected; another head of a column is refused by its name, and a file of
/// schema 1 with what to do, by every verb that reads controls.
#[test]
fn changed_controls_are_found() {
    let desk = Desk::new();
    desk.done(&["solve", "scene.toml", "--out", "run"]);
    let path = desk.path("run/controls.csv");
    let rows = controls(&path, 5);
    for (at, column) in [(1, 0), (2, 1), (4, 0), (4, 1)] {
        let mut changed = rows.clone();
        changed[at].values[column] += 0.1;
        write_controls(&path, &headings(), &changed).unwrap();
        let (code, summary, words) = desk.run(&["verify", "run", "--quick"]);
        assert_eq!(code, REJECTED, "{at} {column}: {words}");
        if at == 4 {
            let found = summary["mismatches"].to_string();
            let place = json!(format!("{}, line", headings()[column])).to_string();
            assert!(found.contains(place.trim_end_matches('"')), "{found}");
        }
    }
    let renamed = ["first (N)".to_string(), headings()[1].clone()];
    write_controls(&path, &renamed, &rows).unwrap();
    let (code, _, words) = desk.run(&["verify", "run"]);
    assert_eq!(code, USAGE);
    assert!(words.contains("no column left (N)"), "{words}");
    fs::write(
        &path,
        "t_start,t_end,fx,fy,fz,mx,my,mz,node\n0,0,0,0,0,0,0,0,0\n",
    )
    .unwrap();
    for line in [
        &["verify", "run"][..],
        &["report", "run"],
        &["solve", "scene.toml", "--from", "run", "--out", "again"],
    ] {
        let (code, _, words) = desk.run(line);
        assert_eq!(code, USAGE, "{line:?}: {words}");
        assert!(words.contains("schema 1"), "{words}");
        assert!(
            words.contains("solve the scene.toml beside it again"),
            "{words}"
        );
    }
}

/// A solve that begins with the controls of another one has its tensions, tendon by tendon, though the tendons stand in another order and
/// one has another pretension.
#[test]
fn a_solve_begins_with_the_tensions_of_another() {
    let desk = Desk::new();
    let scene = SCENE
        .replace("tolerance_m = 2e-3\n", "at_rest = false\nhard = false\n")
        .replace("[control.feedback]\n", "");
    let (head, rest) = scene.split_at(scene.find("[[tendon]]").unwrap());
    let (tendons, tail) = rest.split_at(rest.find("[task]").unwrap());
    let (left, right) = tendons.split_at(tendons.rfind("[[tendon]]").unwrap());
    let left = left.replace("pretension_n = 1.0", "pretension_n = 1.5");
    fs::write(desk.path("first.toml"), &scene).unwrap();
    fs::write(desk.path("other.toml"), [head, right, &left, tail].concat()).unwrap();
    desk.done(&["solve", "first.toml", "--out", "first"]);
    // One iteration, whose step leads away from where tensions in motion meet the target: the point at its start is the result.
    let line = ["solve", "other.toml", "--from", "first", "--out", "other"];
    let (code, _, words) = desk.run(&[&line[..], &["--set", "solver.max_iterations=1"]].concat());
    assert_eq!(code, NOT_CONVERGED, "{words}");
    let before = controls(&desk.path("first/controls.csv"), 4);
    let after = controls(&desk.path("other/controls.csv"), 4);
    for (a, b) in before.iter().zip(&after) {
        assert!(
            a.values
                .iter()
                .zip(&b.values)
                .all(|(a, b)| (a - b).abs() < 1e-14)
        );
    }
    let text = fs::read_to_string(desk.path("other/controls.csv")).unwrap();
    assert!(text.starts_with("t_start,t_end,\"right"), "{text}");
}

/// The commands of a closed loop are whole tensions by name as well, within the bounds, and those that the plant has at their times.
#[test]
fn commands_are_called_by_their_names() {
    let desk = Desk::new();
    let scene = SCENE
        .replace(
            "tension_n = [0.0, 10.0]",
            "tension_n = [0.0, 10.0]\nrate_n_s = 20.0",
        )
        .replace("tolerance_m = 2e-3\n", "at_rest = false\nhard = false\n")
        .replace("blocks = 3\n[control.feedback]\n", "")
        .replace(
            "[control]",
            "[mpc]\nperiod_s = 0.02\nhorizon_s = 0.2\nblock_s = 0.04\ncomputing = \"fixed\"\n",
        );
    fs::write(desk.path("loop.toml"), scene).unwrap();
    let (summary, _) = desk.done(&["mpc", "loop.toml", "--out", "loop"]);
    let samples = summary["samples"].as_u64().unwrap() as usize;
    let rows = controls(&desk.path("loop/controls.csv"), 2 * samples);
    let acting = efforts(&desk.path("loop/efforts.csv"), samples + 1);
    let range = |i: usize| {
        let own = acting.iter().skip(i).step_by(2).map(|row| row.effort);
        own.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], e| {
            [a.min(e), b.max(e)]
        })
    };
    for i in 0..2 {
        assert!(
            rows.iter()
                .all(|row| (-1e-9..=10.0 + 1e-9).contains(&row.values[i]))
        );
        // The loop begins at the pretension.
        assert!(
            (rows[0].values[i] - 1.0).abs() < 1e-9,
            "{}",
            rows[0].values[i]
        );
        let [least, most] = range(i);
        let sent = rows.iter().map(|row| row.values[i]);
        assert!(sent.clone().any(|value| (value - 1.0).abs() > 1e-3));
        // What acted was sent.
        let covers = |bound: f64| {
            sent.clone()
                .fold(f64::INFINITY, |d, value| d.min((value - bound).abs()))
        };
        assert!(
            covers(least) < 0.41 && covers(most) < 0.41,
            "{least} {most}"
        );
    }
}
