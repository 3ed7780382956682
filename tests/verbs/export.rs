//! `softarm export`, completions, the manual, and lines of JSON.

#![cfg(feature = "cli")]

use crate::tool;

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
    // Fewer frames leave none of the export before, and a file of the user's own stays whatever its name.
    fs::write(desk.path("vtk/motion-0042.vtp"), "mine").unwrap();
    let (code, _, talk) = desk.run(&[
        "export", "run", "--to", "vtk", "--out", "vtk", "--frames", "3",
    ]);
    assert_eq!(code, DONE, "{talk}");
    let mut left: Vec<String> = (fs::read_dir(desk.path("vtk")).unwrap())
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    left.sort();
    assert_eq!(
        left,
        [
            "motion-0000.vtp",
            "motion-0001.vtp",
            "motion-0002.vtp",
            "motion-0042.vtp",
            "motion.pvd"
        ]
    );
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

/// Pictures hold the whole motion: every corner of every outline is within the window, the tip of the last still is where the projection puts
/// it, and the animation has as many outlines as there are stills.
#[test]
fn pictures_hold_the_motion() {
    let desk = Desk::new();
    let (code, _, talk) = desk.run(&["solve", "scene.toml", "--out", "run"]);
    assert_eq!(code, DONE, "{talk}");
    let (code, _, talk) = desk.run(&[
        "export", "run", "--to", "svg", "--frames", "5", "--turn", "90",
    ]);
    assert_eq!(code, DONE, "{talk}");
    let read = |name: &str| fs::read_to_string(desk.path("run/svg").join(name)).unwrap();
    let attribute = |text: &str, before: &str| -> Vec<f64> {
        let (_, rest) = text.split_once(before).unwrap();
        let (values, _) = rest.split_once('"').unwrap();
        values
            .split([' ', ','])
            .map(|number| number.parse().unwrap())
            .collect()
    };
    for number in 0..5 {
        let text = read(&format!("motion-000{number}.svg"));
        let window = attribute(&text, "viewBox=\"");
        let corners = attribute(&text, "class=\"arm\" points=\"");
        for corner in corners.chunks(2) {
            assert!(corner[0] >= 0.0 && corner[0] <= window[2]);
            assert!(corner[1] >= 0.0 && corner[1] <= window[3]);
        }
    }
    let animated = read("motion.svg");
    let (_, arm) = animated.split_once("class=\"arm\"").unwrap();
    let (_, values) = arm.split_once("values=\"").unwrap();
    assert_eq!(values.split_once('"').unwrap().0.split(';').count(), 5);
    // The first still looks along y: the arm, upright and 1 m long, is as high as that, but for the elevation of the eye.
    let text = read("motion-0000.svg");
    let corners = attribute(&text, "class=\"arm\" points=\"");
    let n = corners.len() / 4;
    let [base, tip] = [0, n - 1].map(|q| {
        let other = corners.len() / 2 - 1 - q;
        [0, 1].map(|i| 0.5 * (corners[2 * q + i] + corners[2 * other + i]))
    });
    let radius = 0.5 * (corners[0] - corners[corners.len() - 2]).abs();
    let height = (base[1] - tip[1]) / radius * 0.05;
    assert!((height - 12f64.to_radians().cos()).abs() < 0.02, "{height}");
    assert!((base[0] - tip[0]).abs() < 0.2);
    let (code, _, talk) = desk.run(&["export", "run", "--to", "svg", "--seconds", "0"]);
    assert_eq!(code, USAGE);
    assert!(talk.contains("above 0"), "{talk}");
}

/// Exports and pages replace their own files and no others, unless --force names them or their folder; all is refused before anything is
/// written. Links are followed, modes stay, and a device is written to.
#[cfg(unix)]
#[test]
fn exports_and_pages_replace_their_own_files() {
    use std::os::unix::fs::{FileTypeExt as _, PermissionsExt as _, symlink};
    let desk = Desk::new();
    let (code, _, talk) = desk.run(&["simulate", "scene.toml", "--out", "run"]);
    assert_eq!(code, DONE, "{talk}");
    let read = |name: &str| fs::read_to_string(desk.path(name)).unwrap();
    for (format, last) in [
        ("vtk", "motion.pvd"),
        ("csv", "motion.csv"),
        ("svg", "motion.svg"),
    ] {
        let verb = [
            "export", "run", "--to", format, "--out", "out", "--frames", "3",
        ];
        fs::create_dir(desk.path("out")).unwrap();
        fs::write(desk.path("out").join(last), "mine").unwrap();
        let (code, _, talk) = desk.run(&verb);
        assert_eq!(code, USAGE, "{talk}");
        assert!(talk.contains("--force") && talk.contains(last), "{talk}");
        let mut names: Vec<_> = fs::read_dir(desk.path("out")).unwrap().collect();
        assert_eq!(names.pop().unwrap().unwrap().file_name(), last);
        assert!(names.is_empty());
        assert_eq!(read(&format!("out/{last}")), "mine");
        for forced in [format!("out/{last}"), "out".to_string()] {
            fs::write(desk.path("out").join(last), "mine").unwrap();
            let (code, _, talk) = desk.run(&[&verb[..], &["--force", &forced]].concat());
            assert_eq!(code, DONE, "{talk}");
        }
        // What was exported is exported again, through a link, and stays as private as it was made.
        fs::rename(desk.path("out").join(last), desk.path("elsewhere")).unwrap();
        symlink("../elsewhere", desk.path("out").join(last)).unwrap();
        let private = fs::Permissions::from_mode(0o600);
        fs::set_permissions(desk.path("elsewhere"), private).unwrap();
        let before = read("elsewhere");
        let (code, _, talk) = desk.run(&verb);
        assert_eq!(code, DONE, "{talk}");
        assert_eq!(read("elsewhere"), before);
        let metadata = fs::metadata(desk.path("elsewhere")).unwrap();
        assert_eq!(metadata.permissions().mode() & 0o777, 0o600);
        assert!(
            fs::symlink_metadata(desk.path("out").join(last))
                .unwrap()
                .is_symlink()
        );
        fs::remove_dir_all(desk.path("out")).unwrap();
    }
    fs::write(desk.path("page.html"), "mine").unwrap();
    let verb = ["report", "run", "--out", "page.html"];
    let (code, _, talk) = desk.run(&verb);
    assert_eq!(code, USAGE, "{talk}");
    let (code, _, talk) = desk.run(&[&verb[..], &["--force", "page.html"]].concat());
    assert_eq!(code, DONE, "{talk}");
    assert_eq!(read("page.html"), read("run/report.html"));
    let (code, _, talk) = desk.run(&["report", "run", "--out", "/dev/null"]);
    assert_eq!(code, DONE, "{talk}");
    assert!(
        fs::metadata("/dev/null")
            .unwrap()
            .file_type()
            .is_char_device()
    );
    let (code, page, talk) = desk.run(&["report", "run", "--out", "/dev/stdout"]);
    assert_eq!(code, DONE, "{talk}");
    assert_eq!(page, read("page.html"));
    // A run again keeps the modes of its files.
    let mode = |name: &str| fs::metadata(desk.path(name)).unwrap().permissions().mode() & 0o777;
    fs::set_permissions(
        desk.path("run/report.html"),
        fs::Permissions::from_mode(0o640),
    )
    .unwrap();
    let (code, _, talk) = desk.run(&["simulate", "scene.toml", "--out", "run"]);
    assert_eq!(code, DONE, "{talk}");
    assert_eq!(mode("run/report.html"), 0o640);
}
