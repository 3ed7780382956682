//! Results that were changed after the solve, or made by others: `verify` says what is wrong with them, or that it cannot read them; it does not
//! panic, hang, or certify what differs.

#![cfg(feature = "cli")]

use crate::tool;

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

use npyz::{NpyFile, WriteOptions, WriterBuilder as _};
use proptest::prelude::*;
use serde_json::{Value, json};
use softarm::control::{PathMultiplier, simulated};
use softarm::output::{ControlRow, MotionRecord, read_controls, write_controls};
use softarm::scene::Scene;
use softarm::verify::{SolutionMultipliers, kkt};
use tempfile::TempDir;
use tool::{DONE, NUMERICAL, REJECTED, SCENE, USAGE};
use zip::write::SimpleFileOptions;
use zip::{ZipArchive, ZipWriter};

/// A reach past a ball with a soft limit of speed and a rate at its bound: every kind of multiplier is there.
fn scene() -> String {
    let limited = "blocks = 5\nhold = \"linear\"\nforce_rate_max_n_s = 8.0";
    let more = "
[[obstacle]]
name = \"ball\"
sphere = { center_m = [-0.1, 0.0, 0.6], radius_m = 0.04 }
[[limit]]
speed_max_m_s = 0.45
soft = { linear = 0.05 }
";
    let plain = "blocks = 5\nhold = \"constant\"";
    assert!(SCENE.contains(plain));
    SCENE.replace(plain, limited) + more
}

/// The result of a solve, untouched.
static ORIGINAL: LazyLock<TempDir> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("scene.toml"), scene()).unwrap();
    let status = Command::new(env!("CARGO_BIN_EXE_softarm"))
        .args(["solve", "scene.toml", "--out", "run", "--quiet"])
        .current_dir(folder.path())
        .status()
        .unwrap();
    assert_eq!(status.code(), Some(DONE));
    folder
});

/// A copy of the result, to be changed.
struct Copy {
    folder: TempDir,
}

/// How a verification ended.
struct Verified {
    code: i32,
    stderr: String,
    summary: Value,
}

impl Copy {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        for entry in fs::read_dir(ORIGINAL.path().join("run")).unwrap() {
            let entry = entry.unwrap();
            fs::copy(entry.path(), folder.path().join(entry.file_name())).unwrap();
        }
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap()
    }

    fn json(&self, name: &str) -> Value {
        serde_json::from_str(&self.text(name)).unwrap()
    }

    #[track_caller]
    fn verify(&self) -> Verified {
        let output = Command::new(env!("CARGO_BIN_EXE_softarm"))
            .args(["verify", ".", "--quick", "--json", "--threads", "1"])
            .current_dir(self.folder.path())
            .env("NO_COLOR", "1")
            .output()
            .unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!stderr.contains("panicked"), "{stderr}");
        Verified {
            code: output.status.code().unwrap(),
            stderr,
            summary: serde_json::from_slice(&output.stdout).unwrap_or_default(),
        }
    }
}

impl Verified {
    /// Rejected for what a file says at a place.
    #[track_caller]
    fn rejects(&self, file: &str, place: &str) {
        assert_eq!(self.code, REJECTED, "{file} {place}: {}", self.stderr);
        let failed = self.summary["check"]["failed"].as_array().unwrap();
        assert!(failed.contains(&file.into()), "{file} {place}: {failed:?}");
        let mismatch = (self.summary["mismatches"].as_array().unwrap().iter())
            .find(|mismatch| mismatch["file"] == file)
            .unwrap();
        let found = mismatch["place"].as_str().unwrap();
        assert!(found.starts_with(place), "{found} is not {place}");
        assert!(self.stderr.contains(&format!("{file}: {place}")));
    }

    /// Refused as unreadable, with all of `words`.
    #[track_caller]
    fn refuses(&self, words: &[&str]) {
        assert_eq!(self.code, USAGE, "{}", self.stderr);
        for word in words {
            assert!(self.stderr.contains(word), "no `{word}` in {}", self.stderr);
        }
        assert!(self.stderr.len() < 4000);
    }
}

type Arrays = BTreeMap<String, (Vec<u64>, Vec<f64>)>;

fn read_arrays(path: &Path) -> Arrays {
    let mut archive = ZipArchive::new(File::open(path).unwrap()).unwrap();
    let files: Vec<String> = archive.file_names().map(String::from).collect();
    (files.into_iter())
        // Text is not among the numbers.
        .filter(|file| file != "input.npy")
        .map(|file| {
            let array = NpyFile::new(archive.by_name(&file).unwrap()).unwrap();
            let shape = array.shape().to_vec();
            let name = file.strip_suffix(".npy").unwrap().to_string();
            (name, (shape, array.into_vec().unwrap()))
        })
        .collect()
}

/// The bytes of an array of text in a file, if it has one.
fn words(path: &Path) -> Option<Vec<u8>> {
    let mut archive = ZipArchive::new(File::open(path).ok()?).ok()?;
    let mut bytes = Vec::new();
    let mut entry = archive.by_name("input.npy").ok()?;
    entry.read_to_end(&mut bytes).ok()?;
    Some(bytes)
}

fn write_arrays(path: &Path, arrays: &Arrays) {
    write_with(path, arrays, words(path));
}

fn write_with(path: &Path, arrays: &Arrays, words: Option<Vec<u8>>) {
    let mut archive = ZipWriter::new(File::create(path).unwrap());
    if let Some(words) = words {
        (archive.start_file("input.npy", SimpleFileOptions::default())).unwrap();
        archive.write_all(&words).unwrap();
    }
    for (name, (shape, values)) in arrays {
        let options = SimpleFileOptions::default();
        (archive.start_file(format!("{name}.npy"), options)).unwrap();
        let mut writer = WriteOptions::new()
            .default_dtype()
            .shape(shape)
            .writer(&mut archive)
            .begin_nd()
            .unwrap();
        writer.extend(values).unwrap();
        writer.finish().unwrap();
    }
    archive.finish().unwrap();
}

/// The untouched result is certified, and the certificate lists every file that it is about, and no other.
#[test]
fn certificates_list_what_they_cover() {
    let copy = Copy::new();
    let verified = copy.verify();
    assert_eq!(verified.code, DONE, "{}", verified.stderr);
    let covers = json!([
        "controls.csv",
        "end.npz",
        "feedback.npz",
        "multipliers.json",
        "scene.toml",
        "summary.json",
        "trajectory.npz"
    ]);
    assert_eq!(verified.summary["covers"], covers);
    assert_eq!(
        verified.summary["not_covered"],
        json!(["iterations.csv", "report.html"])
    );
    assert_eq!(verified.summary["mismatches"], json!([]));
    let others = verified.summary["summary_not_recomputed"]
        .as_array()
        .unwrap();
    assert!(others.contains(&"wall_s".into()) && !others.contains(&"objective".into()));
    assert!(
        verified
            .stderr
            .contains("covers controls.csv, end.npz, feedback.npz")
    );

    for name in [
        "summary.json",
        "feedback.npz",
        "end.npz",
        "iterations.csv",
        "report.html",
    ] {
        fs::remove_file(copy.path(name)).unwrap();
        let verified = copy.verify();
        assert_eq!(verified.code, DONE, "{}", verified.stderr);
        let covers = verified.summary["covers"].to_string();
        assert!(!covers.contains(name), "{covers}");
    }
    assert_eq!(copy.verify().summary["not_covered"], json!([]));
    for name in [
        "scene.toml",
        "controls.csv",
        "multipliers.json",
        "trajectory.npz",
    ] {
        let copy = Copy::new();
        fs::remove_file(copy.path(name)).unwrap();
        copy.verify().refuses(&[name]);
    }
}

/// One number of every array beside the configurations, changed by a thousandth of the array's largest; a rotation that is none, or
/// turned over; two arrays that changed places.
#[test]
fn motions_say_what_follows() {
    let original = MotionRecord::read_npz(&Copy::new().path("trajectory.npz")).unwrap();
    let rejected = |place: &str, change: &dyn Fn(&mut MotionRecord)| {
        let copy = Copy::new();
        let mut record = original.clone();
        change(&mut record);
        record.write_npz(&copy.path("trajectory.npz")).unwrap();
        copy.verify().rejects("trajectory.npz", place);
    };
    let row = 40;
    let off = |values: &[f64]| 1e-3 * values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    rejected("t, row 40", &|r| r.t[row] += 1e-3 * (r.t[1] - r.t[0]));
    rejected("tip_force, row 40", &|r| {
        r.tip_force[3 * row + 1] += off(&r.tip_force)
    });
    rejected("tip_moment, row 40", &|r| {
        r.tip_moment[3 * row + 2] += off(&r.tip_moment)
    });
    rejected("energy, row 40, kinetic", &|r| {
        r.energy[3 * row] += off(&r.energy)
    });
    rejected("energy, row 40, elastic", &|r| {
        r.energy[3 * row + 1] += off(&r.energy)
    });
    rejected("energy, row 40, potential", &|r| {
        r.energy[3 * row + 2] += off(&r.energy)
    });
    rejected("dilatation, row 40, element 2", &|r| {
        r.dilatation[4 * row + 2] += off(&r.dilatation);
    });
    let node = 9 * (5 * row + 3);
    rejected("R, row 40, node 3: distance", &|r| {
        r.rotation[node] *= 1.0 + 1e-6
    });
    rejected("R, row 40, node 3: determinant", &|r| {
        for value in &mut r.rotation[node..node + 9] {
            *value = -*value;
        }
    });
    rejected("energy", &|r| {
        for energy in r.energy.chunks_mut(3) {
            energy.swap(0, 1);
        }
    });
    rejected("t", &|r| {
        std::mem::swap(&mut r.tip_force, &mut r.tip_moment)
    });

    // Positions and rotations that move belong to no motion of these controls.
    for (name, change) in [
        (
            "same_grid_m",
            (|r, at| r.x[at / 3] += 1e-7) as fn(&mut MotionRecord, usize),
        ),
        ("same_grid_rad", |r, at| {
            let (s, c) = 1e-7f64.sin_cos();
            for row in r.rotation[at..at + 9].chunks_mut(3) {
                (row[0], row[1]) = (c * row[0] + s * row[1], c * row[1] - s * row[0]);
            }
        }),
    ] {
        let copy = Copy::new();
        let mut record = original.clone();
        change(&mut record, node);
        record.write_npz(&copy.path("trajectory.npz")).unwrap();
        let verified = copy.verify();
        assert_eq!(verified.code, REJECTED);
        let failed = verified.summary["check"]["failed"].to_string();
        assert!(failed.contains(name), "{failed}");
    }
}

/// A solve that was stopped before its check says nothing of tips and energies: the certificate does not cover them, and says so.
#[test]
fn solves_that_were_not_checked_can_be() {
    let copy = Copy::new();
    let mut summary = copy.json("summary.json");
    summary["check"] = json!({"verdict": "not checked", "reason": "the deadline is over"});
    for field in ["tip_error_m", "tip_angle_rad", "tip_speed_m_s"] {
        summary[field] = Value::Null;
    }
    fs::write(copy.path("summary.json"), summary.to_string()).unwrap();
    let path = copy.path("trajectory.npz");
    let mut record = MotionRecord::read_npz(&path).unwrap();
    for energy in record.energy.chunks_mut(3) {
        energy[0] = 0.0;
    }
    record.write_npz(&path).unwrap();
    let verified = copy.verify();
    assert_eq!(verified.code, DONE, "{}", verified.stderr);
    let rest = verified.summary["not_covered"].as_array().unwrap();
    assert!(
        rest.contains(&"energy in trajectory.npz".into()),
        "{rest:?}"
    );
    fs::remove_file(copy.path("summary.json")).unwrap();
    copy.verify().rejects("trajectory.npz", "energy");
}

/// The heads of the columns of a file of controls, and its rows.
fn controls(path: &Path) -> (Vec<String>, Vec<ControlRow>) {
    let mut table = csv::Reader::from_path(path).unwrap();
    let headings: Vec<String> = (table.headers().unwrap().iter().skip(2))
        .map(String::from)
        .collect();
    let rows = read_controls(path, &headings, 6).unwrap();
    (headings, rows)
}

/// Times of the controls, which nothing else of the check reads.
#[test]
fn controls_say_when() {
    for (column, change) in [("t_start", [-1e-6, 0.0]), ("t_end", [0.0, 1e-6])] {
        let copy = Copy::new();
        let path = copy.path("controls.csv");
        let (headings, mut rows) = controls(&path);
        rows[2].t_start += change[0];
        rows[2].t_end += change[1];
        write_controls(&path, &headings, &rows).unwrap();
        (copy.verify()).rejects("controls.csv", &format!("{column}, line 4"));
    }
}

/// The largest number of every array of the gains, changed by a thousandth, or for norms by a hundredth.
#[test]
fn gains_are_computed_again() {
    let original = read_arrays(&Copy::new().path("feedback.npz"));
    assert_eq!(original.len(), 11);
    for name in original.keys() {
        let copy = Copy::new();
        let mut arrays = original.clone();
        let values = &mut arrays.get_mut(name).unwrap().1;
        let at = (0..values.len())
            .max_by(|a, b| values[*a].abs().total_cmp(&values[*b].abs()))
            .unwrap();
        values[at] *= if name.starts_with("sensitivity") {
            1.01
        } else {
            1.001
        };
        write_arrays(&copy.path("feedback.npz"), &arrays);
        copy.verify().rejects("feedback.npz", &format!("{name}["));
    }
    // Other names of the controls.
    let copy = Copy::new();
    let path = copy.path("feedback.npz");
    let mut named = words(&path).unwrap();
    let at = named.iter().rposition(|byte| *byte == b'x').unwrap();
    named[at] = b'w';
    write_with(&path, &original, Some(named));
    copy.verify().rejects("feedback.npz", "input[");
    // Gains of another regulator.
    let copy = Copy::new();
    let scene = copy.text("scene.toml");
    let (weights, others) = (
        "[control.feedback]\nstate = 1.0\n",
        "[control.feedback]\nstate = 2.0\n",
    );
    assert!(scene.contains(weights));
    fs::write(copy.path("scene.toml"), scene.replace(weights, others)).unwrap();
    let verified = copy.verify();
    assert_eq!(verified.code, REJECTED, "{}", verified.stderr);
    let failed = verified.summary["check"]["failed"].to_string();
    assert!(failed.contains("feedback.npz"), "{failed}");
}

/// Every field of the summary that can be recomputed, changed.
#[test]
fn summaries_say_what_was_found() {
    let original = Copy::new().json("summary.json");
    for pointer in [
        "/command",
        "/schema_version",
        "/status",
        "/objective",
        "/tip_error_m",
        "/tip_speed_m_s",
        "/model",
        "/strain",
        "/hessian",
        "/elements",
        "/steps",
        "/step_s",
        "/duration_s",
        "/control_blocks",
        "/variables",
        "/multipliers/1",
        "/open_loop_sensitivity/worst",
        "/closed_loop_sensitivity/horizon",
        "/check/verdict",
        "/check/failed",
        "/check/objective",
        "/check/same_grid_m",
        "/check/same_grid_rad",
        "/check/refined_time_m",
        "/check/refined_space_m",
        "/check/order_time",
        "/check/kkt/stationarity",
        "/check/kkt_parts/1/scaled",
        "/check/energy/work_J",
        "/check/energy/relative_residual",
        "/check/momentum/over_rounding",
        "/check/momentum/linear_n_s",
        "/check/strains/stretch/1",
        "/check/strains/curvature_1_m",
        "/check/between/0/excess",
        "/check/between/0/name",
        "/check/between/0/unit",
        "/check/kkt_parts/2/name",
    ] {
        let mut summary = original.clone();
        let value = summary.pointer_mut(pointer).unwrap();
        *value = match &*value {
            Value::Number(number) => json!(number.as_f64().unwrap() * 1.1 + 3.0),
            Value::Array(_) => json!(["energy"]),
            _ => json!("something else"),
        };
        let copy = Copy::new();
        fs::write(copy.path("summary.json"), summary.to_string()).unwrap();
        let place = pointer[1..].replace('/', ".");
        copy.verify().rejects("summary.json", &place);
    }
    for (pointer, value) in [
        ("/check", json!([])),
        ("/check", json!("x")),
        ("/check/between", json!([])),
        ("/check/kkt_parts", json!(7)),
    ] {
        let mut summary = original.clone();
        *summary.pointer_mut(pointer).unwrap() = value;
        let copy = Copy::new();
        fs::write(copy.path("summary.json"), summary.to_string()).unwrap();
        let place = pointer[1..].replace('/', ".");
        copy.verify().rejects("summary.json", &place);
    }
    for text in ["", "[]", "{}", "null", "{\"schema_version\": 1"] {
        let copy = Copy::new();
        fs::write(copy.path("summary.json"), text).unwrap();
        let code = copy.verify().code;
        assert!([USAGE, REJECTED].contains(&code), "{text}: {code}");
    }
}

/// Numbers and words of the summary that no row of the table of tolerances names: compared by their unit, or exactly.
#[test]
fn numbers_without_a_rule_of_their_own_are_compared() {
    let original = Copy::new().json("summary.json");
    for (pointer, change) in [
        ("/check/between/0/reference", json!(0.0504)),
        ("/check/strains/twist_1_m", json!(0.3)),
        ("/check/criteria/3/holds", json!(false)),
        ("/check/criteria/3/name", json!("same_grid")),
        ("/check/criteria/0/unit", json!("m")),
        ("/tip_angle_rad", json!(1e-3)),
    ] {
        let mut summary = original.clone();
        *summary.pointer_mut(pointer).unwrap() = change;
        let copy = Copy::new();
        fs::write(copy.path("summary.json"), summary.to_string()).unwrap();
        let place = pointer[1..].replace('/', ".");
        copy.verify().rejects("summary.json", &place);
    }
    // A number that is left out where nothing else is left out: as wrong as another one.
    let mut summary = original.clone();
    summary["check"]["energy"]
        .as_object_mut()
        .unwrap()
        .remove("work_J");
    let copy = Copy::new();
    fs::write(copy.path("summary.json"), summary.to_string()).unwrap();
    copy.verify().rejects("summary.json", "check.energy.work_J");
}

/// The value of every criterion that is no rounding, set to nothing and doubled: none is believed. What is left of equations that are solved
/// to rounding, and of the replay on the same grid, is beyond what a second run repeats.
#[test]
fn values_of_criteria_are_compared() {
    const ROUNDING: [&str; 7] = [
        "kkt.stationarity",
        "kkt.feasibility",
        "kkt.complementarity",
        "same_grid_m",
        "same_grid_rad",
        "momentum",
        "tip_error_m",
    ];
    let original = Copy::new().json("summary.json");
    let criteria = original["check"]["criteria"].as_array().unwrap();
    let mut n_tampered = 0;
    for (i, item) in criteria.iter().enumerate() {
        let value = item["value"].as_f64().unwrap();
        if ROUNDING.contains(&item["name"].as_str().unwrap()) || value == 0.0 {
            continue;
        }
        for factor in [0.0, 2.0] {
            let mut summary = original.clone();
            summary["check"]["criteria"][i]["value"] = json!(factor * value);
            let copy = Copy::new();
            fs::write(copy.path("summary.json"), summary.to_string()).unwrap();
            let place = format!("check.criteria.{i}.value");
            copy.verify().rejects("summary.json", &place);
            n_tampered += 1;
        }
    }
    assert!(n_tampered >= 6, "{n_tampered}");
}

/// Counts and indices that are not the problem's: refused at the field, not taken for rows. An obstacle that was removed from the scene shifts
/// all indices after it.
#[test]
fn multipliers_of_other_problems_are_refused() {
    let original = Copy::new().json("multipliers.json");
    assert!(original["path"].as_array().unwrap().len() > 10);
    type Change = fn(&mut Value);
    let cases: [(Change, &[&str]); 12] = [
        (
            |m| m["path"][3]["constraint"] = json!(2),
            &["path[3].constraint: 2", "2 path constraints"],
        ),
        (
            |m| m["path"][3]["constraint"] = json!(u64::MAX),
            &["path[3].constraint"],
        ),
        (
            |m| m["path"][4]["time_node"] = json!(161),
            &["path[4].time_node: 161"],
        ),
        (
            |m| m["path"][4]["time_node"] = json!(-1),
            &["multipliers.json:"],
        ),
        (
            |m| m["path"][5]["item"] = json!(1),
            &["path[5].item: 1", "1 items"],
        ),
        (
            |m| m["path"][7] = m["path"][6].clone(),
            &["path[7]", "path[6] again"],
        ),
        (
            |m| m["path"][7]["multiplier"] = Value::Null,
            &["multipliers.json:"],
        ),
        (
            |m| m["goals"] = json!([0.0]),
            &["goals: 1 rows, but the problem has 3"],
        ),
        (
            |m| m["rates"] = json!([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0]]),
            &["rates: 1 rows, but the problem has 5"],
        ),
        (|m| m["rates"][0] = json!([0.0]), &["multipliers.json:"]),
        (|m| m["goals"][1] = json!("1e999"), &["multipliers.json:"]),
        (|m| *m = json!([]), &["multipliers.json:"]),
    ];
    for (change, words) in cases {
        let copy = Copy::new();
        let mut multipliers = original.clone();
        change(&mut multipliers);
        let text = multipliers.to_string().replace("\"1e999\"", "1e999");
        fs::write(copy.path("multipliers.json"), text).unwrap();
        copy.verify().refuses(words);
    }
    let copy = Copy::new();
    let text = copy.text("scene.toml");
    let (from, to) = (
        text.find("[[obstacle]]").unwrap(),
        text.find("[[limit]]").unwrap(),
    );
    fs::write(
        copy.path("scene.toml"),
        [&text[..from], &text[to..]].concat(),
    )
    .unwrap();
    copy.verify().refuses(&[
        "multipliers.json",
        "path[0].constraint: 1",
        "1 path constraints",
    ]);
}

/// Directories, devices that never end, pipes that nobody writes to, and files that are far longer than what they should hold.
#[test]
fn what_is_no_file_of_a_result_is_refused() {
    let files = [
        "scene.toml",
        "controls.csv",
        "multipliers.json",
        "trajectory.npz",
        "summary.json",
        "feedback.npz",
        "end.npz",
    ];
    for name in files {
        let copy = Copy::new();
        let path = copy.path(name);
        fs::remove_file(&path).unwrap();
        fs::create_dir(&path).unwrap();
        copy.verify().refuses(&[name, "a directory"]);
        fs::remove_dir(&path).unwrap();
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink("/dev/zero", &path).unwrap();
            copy.verify().refuses(&[name, "a device or a pipe"]);
            fs::remove_file(&path).unwrap();
            let made = Command::new("mkfifo").arg(&path).status().unwrap();
            assert!(made.success());
            copy.verify().refuses(&[name, "a device or a pipe"]);
            fs::remove_file(&path).unwrap();
        }
        fs::write(&path, vec![b' '; 6 << 20]).unwrap();
        copy.verify().refuses(&[name, "takes at most"]);
    }
}

/// Numbers that are none, arrays of another type or shape, rows that are missing or doubled.
#[test]
fn malformed_numbers_are_refused() {
    let arrays = read_arrays(&Copy::new().path("trajectory.npz"));
    for value in [f64::NAN, f64::INFINITY] {
        let copy = Copy::new();
        let mut changed = arrays.clone();
        changed.get_mut("energy").unwrap().1[7] = value;
        write_arrays(&copy.path("trajectory.npz"), &changed);
        copy.verify()
            .refuses(&["trajectory.npz", "array energy", "row 2"]);
    }
    let copy = Copy::new();
    let mut changed = arrays.clone();
    changed.get_mut("R").unwrap().0 = vec![161, 5, 9];
    write_arrays(&copy.path("trajectory.npz"), &changed);
    copy.verify()
        .refuses(&["array R", "[161, 5, 9], not [161, 5, 3, 3]"]);
    let copy = Copy::new();
    let mut changed = arrays.clone();
    changed.remove("tip_force");
    write_arrays(&copy.path("trajectory.npz"), &changed);
    copy.verify().refuses(&["array tip_force: missing"]);

    let copy = Copy::new();
    let text = copy.text("controls.csv");
    let lines: Vec<&str> = text.lines().collect();
    for (rows, words) in [
        (lines[..6].join("\n"), "5 rows, but scene.toml describes 6"),
        (
            format!("{text}{}\n", lines[3]),
            "7 rows, but scene.toml describes 6",
        ),
        (
            text.replacen(lines[2], "0.06,0.06,NaN,0,0,0,0,0", 1),
            ":3: tip force x (N): NaN",
        ),
        (
            text.replacen("force x (N)", "force x (kN)", 1),
            "no column tip force x (N)",
        ),
    ] {
        fs::write(copy.path("controls.csv"), rows).unwrap();
        copy.verify().refuses(&["controls.csv", words]);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Any counts, indices and numbers as multipliers: told from the problem's own, and no reason to panic for the conditions, which do not hold
    /// with multipliers of rows that do not exist.
    #[test]
    fn any_multipliers_are_judged(
        goals in prop::collection::vec(any::<f64>(), 0..6),
        path in prop::collection::vec((0..4usize, 0..200usize, 0..60usize, any::<f64>()), 0..6),
        rates in prop::collection::vec(-1.0..1.0f64, 0..48),
    ) {
        let (scene, source) = Scene::from_toml("scene.toml", &scene(), &[]).unwrap();
        let problem = scene.optimal_control(&source).unwrap().problem;
        let coefficients = vec![0.0; 6 * problem.n_numbers()];
        let point = simulated(&problem, &coefficients).unwrap();
        let path: Vec<PathMultiplier> = (path.into_iter())
            .map(|(constraint, time_node, item, multiplier)| PathMultiplier {
                constraint,
                time_node,
                item,
                multiplier,
            })
            .collect();
        let multipliers = SolutionMultipliers {
            goals: &goals,
            path: &path,
            rates: &rates,
            commands: &[],
        };
        let constraints = &problem.path;
        let exists = |row: &PathMultiplier| {
            (constraints.get(row.constraint)).is_some_and(|constraint| {
                constraint.time_nodes.contains(&row.time_node)
                    && row.item < constraint.limit.n_items(&problem.rod)
            })
        };
        let found = kkt::recompute(&problem, &point.trajectory, &coefficients, &multipliers);
        if !path.iter().all(exists) {
            prop_assert!(multipliers.validate(&problem).is_err());
            prop_assert!(!(found.residual.max() <= 1e-3));
        }
        if multipliers.validate(&problem).is_ok() {
            prop_assert!(goals.len() == 3 && (rates.is_empty() || rates.len() == 5 * 6));
            prop_assert!(goals.iter().all(|y| y.is_finite()));
        }
    }
}

/// The scene's tolerance loosens what the check asks of stationarity, but not beyond what a certificate may say.
#[test]
fn tolerances_do_not_buy_certificates() {
    for (tolerance, limit) in [("1e-9", 1e-6), ("1e-5", 1e-5), ("1e3", 1e-3)] {
        let overrides = [format!("solver.tolerance={tolerance}")];
        let (scene, source) = Scene::from_toml("scene.toml", &scene(), &overrides).unwrap();
        let setup = scene.optimal_control(&source).unwrap();
        assert_eq!(setup.check_limits().kkt, limit);
    }
}

/// Bytes flipped, cut, doubled and put in at random: a result that passes says what it said.
#[test]
fn damaged_results_do_not_pass_for_others() {
    let mut dice = fastrand::Rng::with_seed(21);
    let files = [
        "controls.csv",
        "multipliers.json",
        "trajectory.npz",
        "feedback.npz",
        "summary.json",
        "scene.toml",
    ];
    let mut counts = BTreeMap::new();
    for round in 0..120 {
        let copy = Copy::new();
        let path = copy.path(files[round % files.len()]);
        let mut bytes = fs::read(&path).unwrap();
        for _ in 0..1 + dice.usize(0..3) {
            let at = dice.usize(0..bytes.len());
            match dice.u8(0..6) {
                0 => bytes.truncate(at.max(1)),
                1 => bytes.insert(at, dice.u8(..)),
                2 => {
                    bytes.remove(at);
                }
                3 => {
                    let end = (at + dice.usize(1..40)).min(bytes.len());
                    let part = bytes[at..end].to_vec();
                    bytes.splice(at..at, part);
                }
                // A digit for another.
                4 => bytes[at] = b'0' + dice.u8(0..10),
                _ => bytes[at] ^= 1 << dice.u8(0..8),
            }
        }
        fs::write(&path, &bytes).unwrap();
        let verified = copy.verify();
        *counts.entry(verified.code).or_insert(0) += 1;
        assert!(
            [DONE, USAGE, NUMERICAL, REJECTED].contains(&verified.code),
            "{}: {}",
            verified.code,
            verified.stderr
        );
        if verified.code == DONE {
            says_the_same(&copy);
        }
    }
    println!("{counts:?}");
}

/// Numbers of a copy that was certified against the original's.
#[track_caller]
fn says_the_same(copy: &Copy) {
    let original = Copy::new();
    for name in ["trajectory.npz", "feedback.npz"] {
        let [ours, theirs] = [&original, copy].map(|of| read_arrays(&of.path(name)));
        for (name, (shape, values)) in &ours {
            let (other_shape, others) = &theirs[name];
            assert_eq!(shape, other_shape);
            let size = values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            for (a, b) in values.iter().zip(others) {
                assert!((a - b).abs() <= 3e-3 * size, "{name}: {a} {b}");
            }
        }
    }
    let [ours, theirs] = [&original, copy].map(|of| controls(&of.path("controls.csv")).1);
    for (a, b) in ours.iter().zip(&theirs) {
        for (a, b) in a.values.iter().zip(&b.values) {
            assert!((a - b).abs() <= 1e-6, "{a} {b}");
        }
    }
    let [ours, theirs] = [&original, copy].map(|of| of.json("summary.json"));
    for pointer in [
        "/objective",
        "/tip_error_m",
        "/check/refined_space_m",
        "/check/objective",
    ] {
        // A field whose name was damaged says nothing any more.
        let [Some(a), Some(b)] = [&ours, &theirs].map(|s| s.pointer(pointer)) else {
            continue;
        };
        let [a, b] = [a, b].map(|value| value.as_f64().unwrap());
        assert!((a - b).abs() <= 1e-2 * a.abs() + 1e-6, "{pointer}: {a} {b}");
    }
    for pointer in ["/status", "/check/verdict", "/steps"] {
        if let Some(found) = theirs.pointer(pointer) {
            assert_eq!(ours.pointer(pointer), Some(found));
        }
    }
}

/// A wire with a magnet that a field bends, and a cable.
const FIELD: &str = "
[rod]
length_m = 0.04
elements = 4
[rod.material]
youngs_modulus_pa = 5e5
poisson_ratio = 0.45
density_kg_m3 = 1100.0
[rod.section]
diameter_m = 0.002
[damping]
viscous_1_s = 20.0
internal_s = 2e-3
[time]
end_s = 0.2
integrator = \"implicit\"
[[magnet]]
name = \"tip\"
moment_a_m2 = [0.0, 0.0, 2e-3]
field_t = [[-0.05, 0.05], [-0.05, 0.05], [0.0, 0.0]]
[[cable]]
name = \"stay\"
at = 0.5
anchor_m = [-0.02, 0.0, 0.02]
profile = [[0.0, 1e-4]]
[control]
blocks = 4
[task]
position_m = [0.012, 0.006, 0.0366]
tolerance_m = 1e-3
at_rest = false
";

/// An effort or a coordinate in `efforts.csv` that is off by a thousandth is found, and the untouched result is certified again.
#[test]
fn efforts_of_fields_are_checked() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("scene.toml"), FIELD).unwrap();
    let run = |args: &[&str]| {
        Command::new(env!("CARGO_BIN_EXE_softarm"))
            .args(args)
            .args(["--threads", "1"])
            .current_dir(folder.path())
            .env("NO_COLOR", "1")
            .output()
            .unwrap()
    };
    let solved = run(&["solve", "scene.toml", "--out", "run", "--quiet"]);
    assert_eq!(
        solved.status.code(),
        Some(DONE),
        "{}",
        String::from_utf8_lossy(&solved.stderr)
    );
    let path = folder.path().join("run").join("efforts.csv");
    let text = fs::read_to_string(&path).unwrap();
    assert_eq!(
        run(&["verify", "run", "--quick", "--json"]).status.code(),
        Some(DONE)
    );
    let rows: Vec<&str> = text.lines().collect();
    for (name, column) in [("tip Bx", 2), ("tip By", 3), ("stay", 3)] {
        let at = rows.len() - 5
            + rows[rows.len() - 5..]
                .iter()
                .position(|row| row.contains(name))
                .unwrap();
        let mut parts: Vec<String> = rows[at].split(',').map(Into::into).collect();
        let number: f64 = parts[column].parse().unwrap();
        parts[column] = (number * 1.001).to_string();
        let mut changed: Vec<String> = rows.iter().map(ToString::to_string).collect();
        changed[at] = parts.join(",");
        fs::write(&path, changed.join("\n") + "\n").unwrap();
        let verified = run(&["verify", "run", "--quick", "--json"]);
        assert_eq!(verified.status.code(), Some(REJECTED), "{name}");
        let summary: Value = serde_json::from_slice(&verified.stdout).unwrap();
        let failed = summary["check"]["failed"].as_array().unwrap();
        assert!(failed.contains(&"efforts.csv".into()), "{name}: {failed:?}");
        fs::write(&path, &text).unwrap();
    }
}
