//! What a solve says on its way and leaves behind: attempts told apart, starts as they end, a verdict when quiet, diagnostics.

#![cfg(feature = "cli")]

use crate::tool;

use std::fs::File;
use std::path::Path;
use std::process::Command;

use npyz::NpyFile;
use serde_json::Value;
use tempfile::TempDir;
use tool::{DONE, SCENE};
use zip::ZipArchive;

struct Said {
    stdout: String,
    stderr: String,
}

/// Runs the tool in a folder that holds `scene.toml`.
#[track_caller]
fn run(folder: &TempDir, scene: &str, arguments: &[&str]) -> Said {
    std::fs::write(folder.path().join("scene.toml"), scene).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_softarm"))
        .args(arguments)
        .current_dir(folder.path())
        .output()
        .unwrap();
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
    let (stdout, stderr) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(output.status.code(), Some(DONE), "{stderr}");
    Said { stdout, stderr }
}

fn read(folder: &TempDir, name: &str) -> String {
    std::fs::read_to_string(folder.path().join(name)).unwrap()
}

/// A scene whose duration is free: solves that hold one lead to the one that counts.
fn timed() -> String {
    SCENE.replace(
        "at_rest = false\n",
        "at_rest = false\n[task.free_duration]\nshortest_s = 0.2\nlongest_s = 0.4\nprice = 2.0\n",
    )
}

/// Quiet, a certified solve says one line: the verdict.
#[test]
fn quiet_solve_says_its_verdict() {
    let folder = tempfile::tempdir().unwrap();
    let said = run(&folder, SCENE, &["--quiet", "solve", "scene.toml"]);
    assert_eq!(said.stdout, "");
    assert_eq!(said.stderr.lines().count(), 1, "{}", said.stderr);
    assert!(said.stderr.starts_with("certified"), "{}", said.stderr);
}

/// Several starts say a row each as they end, with what stands in the summary about them.
#[test]
fn starts_say_how_they_ended() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["solve", "scene.toml", "--starts", "3", "--json"];
    let said = run(&folder, SCENE, &arguments);
    let summary: Value = serde_json::from_str(&said.stdout).unwrap();
    let rows: Vec<&str> = (said.stderr.lines())
        .filter(|line| line.starts_with("start "))
        .collect();
    assert_eq!(rows.len(), 3, "{}", said.stderr);
    for start in summary["starts"].as_array().unwrap() {
        let number = format!("start {:3} ", start["start"].as_u64().unwrap());
        let row = rows.iter().find(|row| row.starts_with(&number)).unwrap();
        for field in ["from", "status"] {
            assert!(row.contains(start[field].as_str().unwrap()), "{row}");
        }
        let iterations = format!(" {} iterations", start["iterations"]);
        assert!(row.contains(&iterations), "{row}");
    }
}

/// As lines of JSON, every start ends once, with what stands in the summary about it, and every iteration says whose it is.
#[test]
fn starts_end_in_lines_of_json() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["solve", "scene.toml", "--starts", "3", "--json-lines"];
    let said = run(&folder, SCENE, &arguments);
    let lines: Vec<Value> = (said.stdout.lines())
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let of = |kind: &'static str| lines.iter().filter(move |line| line["event"] == kind);
    let summary = lines.last().unwrap();
    assert_eq!(summary["event"], "summary");
    assert_eq!(of("start").count(), 3);
    for start in summary["starts"].as_array().unwrap() {
        let number = &start["start"];
        let mut ends = of("start").filter(|line| line["start"] == *number);
        let end = ends.next().unwrap();
        for key in ["from", "status", "objective", "iterations"] {
            assert_eq!(end[key], start[key]);
        }
        let rows = of("iteration").filter(|line| line["start"] == *number);
        assert!(rows.count() as u64 > start["iterations"].as_u64().unwrap());
    }
    // No drawing where nobody looks.
    assert!(!said.stderr.contains("starts done"), "{}", said.stderr);
}

/// Attempts are told apart on the terminal, in the table of iterations, in the summary and in the report, each with what it began from and
/// with how it ended; all their iterations are there.
#[test]
fn attempts_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["solve", "scene.toml", "--out", "run", "--json"];
    let said = run(&folder, &timed(), &arguments);
    let summary: Value = serde_json::from_str(&said.stdout).unwrap();
    let attempts = summary["attempts"].as_array().unwrap();
    assert!(attempts.len() >= 2);
    let from = |attempt: &Value| attempt["from"].as_str().unwrap().to_string();
    assert!(from(&attempts[0]).contains("duration held at 0.3000 s"));
    assert!(from(&attempts[1]).starts_with("duration held at"));
    let results = attempts.iter().filter(|a| a["is_result"] == true);
    assert_eq!(results.count(), 1);
    for (number, attempt) in attempts.iter().enumerate().skip(1) {
        let line = format!("attempt {}, from {};", number + 1, from(attempt));
        assert!(
            said.stderr.contains(&line),
            "no `{line}` in {}",
            said.stderr
        );
    }
    let mut table = csv::Reader::from_path(folder.path().join("run/iterations.csv")).unwrap();
    let heads: Vec<String> = table.headers().unwrap().iter().map(String::from).collect();
    assert_eq!(heads[0], "iteration");
    assert_eq!(heads[heads.len() - 3..], ["elapsed_s", "attempt", "from"]);
    let mut rows = vec![0; attempts.len()];
    for row in table.records() {
        let row = row.unwrap();
        let number: usize = row[heads.len() - 2].parse().unwrap();
        assert_eq!(row[heads.len() - 1], from(&attempts[number - 1]));
        assert_eq!(row[0].parse::<usize>().unwrap(), rows[number - 1]);
        rows[number - 1] += 1;
    }
    for (rows, attempt) in rows.iter().zip(attempts) {
        assert_eq!(*rows, attempt["iterations"].as_u64().unwrap() as usize + 1);
    }
    let total: usize = rows.iter().map(|rows| rows - 1).sum();
    assert_eq!(summary["iterations"], total);
    let page = read(&folder, "run/report.html");
    assert!(page.contains(&from(&attempts[1])));
}

fn arrays(path: &Path) -> Vec<(String, Vec<f64>)> {
    let mut archive = ZipArchive::new(File::open(path).unwrap()).unwrap();
    let mut names: Vec<String> = archive.file_names().map(String::from).collect();
    names.sort();
    (names.into_iter())
        .map(|name| {
            let array = NpyFile::new(archive.by_name(&name).unwrap()).unwrap();
            (name, array.into_vec().unwrap())
        })
        .collect()
}

/// Diagnostics of a solve are those that a simulation writes whose loads are the solution's controls: two routes to every array.
#[test]
fn diagnostics_of_a_solve_are_those_of_its_motion() {
    let folder = tempfile::tempdir().unwrap();
    let scene = SCENE
        .replace("hold = \"constant\"", "hold = \"linear\"")
        .replace("moment_max_n_m = 5.0", "moment_max_n_m = 0.0")
        + "[output]\ndiagnostics = true\n";
    run(&folder, &scene, &["solve", "scene.toml", "--out", "solved"]);
    // One load an axis, which the profile makes the control's own course, constant before and after.
    let mut table = csv::Reader::from_path(folder.path().join("solved/controls.csv")).unwrap();
    let rows: Vec<Vec<f64>> = table
        .records()
        .map(|row| {
            row.unwrap()
                .iter()
                .map(|cell| cell.parse().unwrap())
                .collect()
        })
        .collect();
    let mut loads = String::new();
    for axis in 0..3 {
        let point = |t: f64, row: &[f64]| format!("[{t:e}, {:e}]", row[2 + axis]);
        let mut points = vec![point(-1.0, &rows[0])];
        points.extend(rows.iter().map(|row| point(row[0], row)));
        points.push(point(2.0, &rows[rows.len() - 1]));
        let direction = [0, 1, 2].map(|i| f64::from(u8::from(i == axis)));
        loads += &format!(
            "[[load]]\nnode = \"tip\"\nforce_n = {direction:?}\nprofile = [{}]\n",
            points.join(", ")
        );
    }
    let resolved = read(&folder, "solved/scene.toml");
    let step = resolved
        .lines()
        .find(|line| line.starts_with("step_s"))
        .unwrap();
    let (before, _) = scene.split_once("[task]").unwrap();
    let simulated = before.replace("end_s = 0.3\n", &format!("end_s = 0.3\n{step}\n"))
        + &loads
        + "[output]\ndiagnostics = true\n";
    run(
        &folder,
        &simulated,
        &["simulate", "scene.toml", "--out", "simulated"],
    );
    let [solved, simulated] = ["solved", "simulated"]
        .map(|name| arrays(&folder.path().join(name).join("diagnostics.npz")));
    assert_eq!(solved.len(), 15);
    for ((name, ours), (other, theirs)) in solved.iter().zip(&simulated) {
        assert_eq!(name, other);
        assert_eq!(ours.len(), theirs.len(), "{name}");
        let size = theirs.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
        // Rounding of the controls' digits and of times, through 300 steps of a damped arm.
        let off = (ours.iter().zip(theirs)).fold(0.0, |m: f64, (a, b)| m.max((a - b).abs()));
        assert!(off <= 1e-8 * size.max(1e-6), "{name}: {off} of {size}");
    }
}
