//! `softarm export`, completions, the manual, and lines of JSON.

#![cfg(feature = "cli")]

mod tool;

use std::fs;
use std::path::PathBuf;
use std::process::Command;

use serde_json::Value;
use softarm::output::MotionRecord;
use tempfile::TempDir;
use tool::{DONE, SCENE, USAGE};

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

    fn run(&self, arguments: &[&str]) -> (i32, String, String) {
        let output = Command::new(env!("CARGO_BIN_EXE_softarm"))
            .args(arguments)
            .current_dir(self.0.path())
            .output()
            .unwrap();
        let [stdout, stderr] =
            [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap());
        (output.status.code().unwrap(), stdout, stderr)
    }
}

/// The numbers of a data array of a VTK file.
fn numbers(text: &str, name: &str) -> Vec<f64> {
    let (_, rest) = text.split_once(&format!("Name=\"{name}\"")).unwrap();
    let (_, rest) = rest.split_once('>').unwrap();
    let (data, _) = rest.split_once("</DataArray>").unwrap();
    data.split_whitespace()
        .map(|number| number.parse().unwrap())
        .collect()
}

/// The last file of a VTK series has the last positions, radii and directors of the motion, to the digit; the index names every file with its
/// time; the table has the same positions.
#[test]
fn exports_are_the_motion() {
    let desk = Desk::new();
    let (code, _, talk) = desk.run(&[
        "simulate",
        "scene.toml",
        "--out",
        "run",
        "--set",
        "load.0.force_n=[2.0, 0.0, 0.0]",
        "--set",
        "load.0.node=tip",
    ]);
    assert_eq!(code, DONE, "{talk}");
    let (code, _, talk) = desk.run(&[
        "export", "run", "--to", "vtk", "--out", "vtk", "--frames", "7",
    ]);
    assert_eq!(code, DONE, "{talk}");
    let motion = MotionRecord::read_npz(&desk.path("run/trajectory.npz")).unwrap();
    let index = fs::read_to_string(desk.path("vtk/motion.pvd")).unwrap();
    assert_eq!(index.matches("<DataSet").count(), 7);
    let last = motion.n_rows() - 1;
    assert!(
        index.contains(&format!("timestep=\"{}\"", motion.t[last])),
        "{index}"
    );
    let text = fs::read_to_string(desk.path("vtk/motion-0006.vtp")).unwrap();
    let n = motion.n_nodes;
    assert_eq!(numbers(&text, "positions"), motion.x[3 * n * last..]);
    assert_eq!(numbers(&text, "radius"), vec![0.05; n]);
    let rotation = &motion.rotation[9 * n * last..];
    let third = numbers(&text, "d3");
    for q in 0..n {
        for i in 0..3 {
            assert_eq!(third[3 * q + i], rotation[9 * q + 3 * i + 2]);
        }
    }
    let (code, _, talk) = desk.run(&["export", "run", "--to", "csv"]);
    assert_eq!(code, DONE, "{talk}");
    let table = fs::read_to_string(desk.path("run/csv/motion.csv")).unwrap();
    let row: Vec<f64> = (table.lines().last().unwrap().split(','))
        .map(|number| number.parse().unwrap())
        .collect();
    assert_eq!(row[3..6], motion.x[3 * (n * (last + 1) - 1)..]);
    assert!((row[6..10].iter().map(|v| v * v).sum::<f64>() - 1.0).abs() < 1e-12);
    let (code, _, talk) = desk.run(&["export", "vtk", "--to", "csv"]);
    assert_eq!(code, USAGE);
    assert!(talk.contains("no result"), "{talk}");
}

/// Every line on standard output is an object with its kind; iterations count up, and the last line is the summary.
#[test]
fn lines_are_events() {
    let desk = Desk::new();
    let (code, stdout, talk) = desk.run(&["solve", "scene.toml", "--out", "run", "--json-lines"]);
    assert_eq!(code, DONE, "{talk}");
    let events: Vec<Value> = stdout
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let (last, rows) = events.split_last().unwrap();
    assert_eq!(last["event"], "summary");
    assert_eq!(last["status"], "converged");
    for (count, row) in rows.iter().enumerate() {
        assert_eq!(row["event"], "iteration");
        assert_eq!(row["iteration"].as_u64().unwrap() as usize, count);
    }
    assert_eq!(
        last["iterations"].as_u64().unwrap() as usize,
        rows.len() - 1
    );
}

/// Completions and manual name verbs and options; a verb that is none is refused.
#[test]
fn shells_and_manuals_are_served() {
    let desk = Desk::new();
    for shell in ["bash", "zsh", "fish"] {
        let (code, text, _) = desk.run(&["completions", shell]);
        assert_eq!(code, DONE);
        assert!(
            text.contains("tradeoff") && text.contains("budget"),
            "{shell}"
        );
    }
    let (code, text, _) = desk.run(&["man"]);
    assert_eq!(code, DONE);
    assert!(text.contains(".TH softarm") && text.contains("tradeoff"));
    let (code, text, _) = desk.run(&["man", "tradeoff"]);
    assert_eq!(code, DONE);
    assert!(text.contains("budget"));
    let (code, _, talk) = desk.run(&["man", "nothing"]);
    assert_eq!(code, USAGE);
    assert!(talk.contains("no verb `nothing`"), "{talk}");
}
