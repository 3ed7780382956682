//! `softarm tradeoff`: what it recommends holds, what it writes can be used, and what it cannot do it says.

#![cfg(feature = "cli")]

use crate::tool;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;
use softarm::scene::Scene;
use tempfile::TempDir;
use tool::{DONE, NOT_CONVERGED, SCENE, USAGE};

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

    fn run(&self, arguments: &[&str]) -> (i32, Value, String) {
        let Output {
            status,
            stdout,
            stderr,
        } = Command::new(env!("CARGO_BIN_EXE_softarm"))
            .args(arguments)
            .arg("--json")
            .current_dir(self.0.path())
            .output()
            .unwrap();
        let summary = serde_json::from_slice(&stdout).unwrap_or(Value::Null);
        let talk = String::from_utf8(stderr).unwrap();
        let code = status.code();
        (
            code.unwrap_or_else(|| panic!("{status}: {talk}")),
            summary,
            talk,
        )
    }
}

/// A soft arm that a force pulls aside within a quarter of a second.
const SWING: &str = "[rod]\nlength_m = 1.0\nelements = 8\n[rod.material]\nyoungs_modulus_pa = 1e6\npoisson_ratio = 0.5\n\
    density_kg_m3 = 1000.0\n[rod.section]\nradius_m = 0.05\n[damping]\nviscous_1_s = 1.0\n[[load]]\nnode = \"tip\"\n\
    force_n = [3.0, 0.0, 0.0]\nprofile = [[0.0, 0.0], [0.1, 1.0], [1.0, 1.0]]\n[time]\nend_s = 0.3\n";

/// A budget that no sweep of these scenes comes to, however busy the machine.
const LONG: &str = "6h";

/// Goes on with a sweep, without the time for another point.
const NO_TIME: [&str; 3] = ["--resume", "--budget", "0.001s"];

fn points(summary: &Value) -> &Vec<Value> {
    summary["points"].as_array().unwrap()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

/// Reads a scene that was written.
fn scene(path: &Path) -> Scene {
    let (scene, _) = Scene::load(&path.to_string_lossy(), &[]).unwrap();
    scene
}

/// The recommended setting of a motion is the fastest that meets the tolerance, holds against a run finer by four, and is the scene that is
/// written; the front is a front; a sweep that goes on does not run its points again.
#[test]
fn a_motion() {
    let desk = Desk::with(&format!(
        "# An arm.\n\n{}",
        SWING.replace("elements = 8", "elements = 8 # few")
    ));
    let verb = [
        "tradeoff",
        "scene.toml",
        "--out",
        "run",
        "--budget",
        LONG,
        "--tolerance",
        "3e-3",
        "--apply=applied.toml",
        "--set",
        "damping.viscous_1_s=1.5",
    ];
    let (code, summary, talk) = desk.run(&verb);
    assert_eq!(code, DONE, "{talk}");
    assert_eq!(summary["command"], "tradeoff");
    let recommended = &summary["recommended"];
    assert!(number(&recommended["checked_error"]) <= 3e-3);
    assert_eq!(recommended["checked"], true);
    let reference = number(&summary["reference"]["error"]);
    assert!(reference < 3e-4, "{reference}");
    for point in points(&summary) {
        let Some(error) = point["error"].as_f64() else {
            continue;
        };
        let time = number(&point["cpu_s"]);
        if error <= 3e-3 - reference {
            assert!(time >= number(&recommended["cpu_s"]));
        }
        if point["on_front"] == true {
            let beats = |other: &Value| {
                let (e, t) = (other["error"].as_f64(), other["cpu_s"].as_f64());
                e.zip(t).is_some_and(|(e, t)| e < error && t < time)
            };
            assert!(!points(&summary).iter().any(beats));
        }
    }
    let is_on_front = |point: &&Value| point["on_front"] == true;
    let mut front = points(&summary).iter().filter(is_on_front);
    let own = front.any(|point| {
        point["elements"] == recommended["elements"] && point["cpu_s"] == recommended["cpu_s"]
    });
    assert_eq!(recommended["on_front"], own);
    // Helical elements converge with the second order that they have.
    let helical = |model: &&Value| model["of"] == "helical";
    let models = summary["models"]["error"].as_array().unwrap();
    let order = number(&models.iter().find(helical).unwrap()["order"]);
    assert!((1.7..2.3).contains(&order), "{order}");
    for name in [
        "scene.toml",
        "points.csv",
        "front.svg",
        "report.html",
        "recommended.toml",
    ] {
        assert!(desk.path("run").join(name).is_file(), "{name}");
    }
    // Attributes are apart, and elements end.
    let picture = fs::read_to_string(desk.path("run/front.svg")).unwrap();
    for after_value in picture.split('"').skip(2).step_by(2) {
        assert!(after_value.starts_with([' ', '/', '>']), "{after_value}");
    }
    for tag in ["svg", "g", "text"] {
        let [open, close] =
            [format!("<{tag} "), format!("</{tag}>")].map(|part| picture.matches(&part).count());
        assert_eq!(open, close, "{tag}");
    }
    let applied = scene(&desk.path("applied.toml"));
    assert_eq!(
        applied.rod.elements as u64,
        recommended["elements"].as_u64().unwrap()
    );
    assert_eq!(applied, scene(&desk.path("run/recommended.toml")));
    let text = fs::read_to_string(desk.path("applied.toml")).unwrap();
    assert!(
        text.starts_with("# An arm.\n\n[rod]\n") && text.contains(" # few\n"),
        "{text}"
    );
    assert!(text.contains("viscous_1_s = 1.5\n"), "{text}");
    let rows = fs::read_to_string(desk.path("run/points.csv")).unwrap();
    assert_eq!(rows.lines().count(), 1 + points(&summary).len());

    let done = points(&summary)
        .iter()
        .filter(|point| point["status"] == "done")
        .count();
    let (code, again, talk) = desk.run(&[
        "tradeoff",
        "scene.toml",
        "--out",
        "run",
        "--budget",
        LONG,
        "--tolerance",
        "3e-3",
        "--resume",
        "--set",
        "damping.viscous_1_s=1.5",
    ]);
    assert_eq!(code, DONE, "{talk}");
    assert!(
        talk.contains(&format!("{done} points are there already")),
        "{talk}"
    );
    let find = |summary: &Value| points(summary)[0]["wall_s"].clone();
    assert_eq!(find(&again), find(&summary), "a point was run again");

    // Another scene has no part in this sweep.
    let (code, _, talk) = desk.run(&[
        "tradeoff",
        "scene.toml",
        "--out",
        "run",
        "--resume",
        "--set",
        "time.end_s=0.2",
    ]);
    assert_eq!(code, USAGE);
    assert!(talk.contains("the scene has changed"), "{talk}");
}

/// The page of a sweep is made of its files as the run wrote it, to the byte, and does not depend on a page that is there; of several sweeps
/// one page has what is recommended by each, as their summaries have it, and the keys in which their scenes differ.
#[test]
fn pages_from_files() {
    let desk = Desk::with(SWING);
    let sweep = |out: &str, tolerance: &str, more: &[&str]| {
        let mut verb = vec!["tradeoff", "scene.toml", "--out", out];
        verb.extend(["--tolerance", tolerance]);
        verb.extend(more);
        let (_, summary, talk) = desk.run(&verb);
        assert!(summary.is_object(), "{talk}");
        summary
    };
    // One that fails in parts, and one that recommends nothing: it has no time beyond the points of a coarser tolerance.
    let long = ["--budget", LONG];
    let shorter = [&long[..], &["--set", "time.end_s=0.2"]].concat();
    sweep("none", "1e-2", &long);
    let sweeps = [
        sweep("fine", "3e-3", &long),
        sweep("short", "1e-2", &shorter),
        sweep("none", "1e-9", &NO_TIME),
    ];
    for name in ["fine", "short", "none"] {
        let page = desk.path(name).join("report.html");
        let written = fs::read(&page).unwrap();
        let (code, _, talk) = desk.run(&["report", name]);
        assert_eq!(code, DONE, "{talk}");
        assert!(fs::read(&page).unwrap() == written, "{name}");
        fs::remove_file(&page).unwrap();
        desk.run(&["report", name]);
        assert!(fs::read(&page).unwrap() == written, "{name}");
    }
    let page = fs::read_to_string(desk.path("fine/report.html")).unwrap();
    let elements = &sweeps[0]["recommended"]["elements"];
    assert!(
        page.contains(&format!("<pre>rod.elements = {elements}")),
        "{elements}"
    );
    let (code, report, talk) = desk.run(&["report", "fine", "short", "none"]);
    assert_eq!(code, DONE, "{talk}");
    let page = fs::read_to_string(desk.path("comparison.html")).unwrap();
    assert_eq!(page.matches("<svg").count(), 1);
    let [recommended, scenes] = &report["differences"].as_array().unwrap()[..] else {
        panic!("{report}")
    };
    let row = |table: &Value, key: &str| -> Vec<String> {
        let rows = table["rows"].as_array().unwrap();
        let row = rows.iter().find(|row| row["key"] == *key).unwrap();
        (row["values"].as_array().unwrap().iter())
            .map(|value| value.as_str().unwrap().to_string())
            .collect()
    };
    let settings = row(recommended, "setting");
    for (setting, summary) in settings.iter().zip(&sweeps) {
        match summary["recommended"]["elements"].as_u64() {
            Some(elements) => assert!(setting.starts_with(&format!("{elements} ")), "{setting}"),
            None => assert_eq!(setting, "–"),
        }
        assert!(page.contains(&format!(">{setting}</td>")), "{setting}");
    }
    assert_eq!(settings[2], "–");
    assert_eq!(row(recommended, "tolerance"), ["3e-3", "1e-2", "1e-9"]);
    assert_eq!(row(scenes, "time.end_s"), ["0.3", "0.2", "0.3"]);
    // Every point of a front is a disk of its sweep's color, and the legend has one more.
    for (summary, color) in sweeps.iter().zip(["#1f77b4", "#e66a00", "#2c9f4b"]) {
        let on_front = points(summary).iter().filter(|p| p["on_front"] == true);
        let disk = format!("fill=\"{color}\" stroke=\"none\"");
        let drawn = page
            .lines()
            .filter(|l| l.starts_with("<circle") && l.contains(&disk));
        assert_eq!(drawn.count(), on_front.count() + 1, "{color}");
    }
}

/// The recommended setting of an optimal-control problem has a motion within the tolerance under the same controls on a finer grid, at an
/// objective that is no worse by a hundredth than the best grid's.
#[test]
fn an_optimal_control_problem() {
    let desk = Desk::with(&SCENE.replace("[control.feedback]\n", ""));
    let (code, summary, talk) = desk.run(&[
        "tradeoff",
        "scene.toml",
        "--out",
        "run",
        "--budget",
        LONG,
        "--tolerance",
        "1e-2",
    ]);
    assert_eq!(code, DONE, "{talk}");
    let recommended = &summary["recommended"];
    assert!(number(&recommended["checked_error"]) <= 1e-2);
    let best = number(&summary["reference"]["objective"]);
    assert!(number(&recommended["objective"]) <= best + 0.0101 * best.abs());
    let kinds = |key: &str| {
        let mut kinds: Vec<String> = points(&summary)
            .iter()
            .map(|point| point[key].to_string())
            .collect();
        kinds.sort();
        kinds.dedup();
        kinds.len()
    };
    assert!(
        kinds("elements") > 4
            && kinds("hold") == 3
            && kinds("hessian") == 3
            && kinds("strain") == 2
    );
}

/// A tolerance that no budget reaches is refused in a sentence with an exit code of its own, and what was run is written.
#[test]
fn what_cannot_be_met_is_said() {
    let desk = Desk::with(SWING);
    let verb = ["tradeoff", "scene.toml", "--out", "run"];
    let earlier = ["--tolerance", "1e-2", "--budget", LONG];
    let (code, _, talk) = desk.run(&[&verb[..], &earlier].concat());
    assert_eq!(code, DONE, "{talk}");
    let (code, summary, talk) = desk.run(&[&verb[..], &["--tolerance", "1e-9"], &NO_TIME].concat());
    assert_eq!(code, NOT_CONVERGED, "{talk}");
    assert_eq!(summary["recommended"], Value::Null);
    let findings = summary["findings"].to_string();
    assert!(findings.contains("--budget"), "{findings}");
    assert!(desk.path("run/summary.json").is_file());
}

/// Times and tolerances that are none are refused.
#[test]
fn wrong_options_are_refused() {
    let desk = Desk::with(SWING);
    for (option, words) in [
        (["--budget", "soon"], "90s, 5min or 1h"),
        (["--budget", "0"], "above 0"),
        (["--tolerance", "2"], "between 0 and 1"),
        (["--tolerance", "near"], "not a number"),
    ] {
        let (code, _, talk) = desk.run(&["tradeoff", "scene.toml", option[0], option[1]]);
        assert_eq!(code, USAGE);
        assert!(talk.contains(words), "{talk}");
    }
}

/// A sweep that was ended before it wrote anything goes on from its beginning, and says so.
#[test]
fn sweeps_without_a_point_begin_again() {
    let desk = Desk::with(SWING);
    let verb = [
        "tradeoff",
        "scene.toml",
        "--out",
        "run",
        "--resume",
        "--budget",
        LONG,
    ];
    let (code, summary, talk) = desk.run(&[&verb[..], &["--tolerance", "1e-2"]].concat());
    assert_eq!(code, DONE, "{talk}");
    assert!(talk.contains("holds no sweep"), "{talk}");
    assert!(!points(&summary).is_empty());
}

/// With no time left a sweep that goes on recommends from the points that are there, and none of them is lost.
#[test]
fn sweeps_recommend_from_what_is_there() {
    let desk = Desk::with(SWING);
    let verb = [
        "tradeoff",
        "scene.toml",
        "--out",
        "run",
        "--tolerance",
        "3e-3",
    ];
    let (code, first, talk) = desk.run(&[&verb[..], &["--budget", LONG]].concat());
    assert_eq!(code, DONE, "{talk}");
    let (code, second, talk) = desk.run(&[&verb[..], &NO_TIME].concat());
    assert_eq!(code, DONE, "{talk}");
    let done = |summary: &Value| {
        let mut settings: Vec<String> = (points(summary).iter())
            .filter(|point| point["status"] == "done")
            .map(|point| {
                format!(
                    "{} {} {}",
                    point["elements"], point["strain"], point["wall_s"]
                )
            })
            .collect();
        settings.sort();
        settings
    };
    assert_eq!(done(&first), done(&second));
    let recommended = |summary: &Value| summary["recommended"]["wall_s"].clone();
    assert_eq!(recommended(&first), recommended(&second));
}

/// Numbers that no sweep writes are not believed: a sweep that goes on says which point they are of and runs it again, and a page is refused.
#[test]
fn tampered_sweeps_are_not_believed() {
    let desk = Desk::with(SWING);
    let verb = [
        "tradeoff",
        "scene.toml",
        "--out",
        "run",
        "--tolerance",
        "1e-2",
        "--budget",
        LONG,
    ];
    let (code, summary, talk) = desk.run(&verb);
    assert_eq!(code, DONE, "{talk}");
    let path = desk.path("run/summary.json");
    let at = (points(&summary).iter())
        .position(|p| p["status"] == "done")
        .unwrap();
    for (key, value) in [
        ("step_s", serde_json::json!(0)),
        ("step_s", serde_json::json!(-1)),
        ("step_s", serde_json::json!(1e-300)),
        ("wall_s", serde_json::json!(1e308)),
        ("wall_s", serde_json::json!(-1.0)),
        ("wall_s", serde_json::json!(null)),
        ("error", serde_json::json!(-1e300)),
        ("error", serde_json::json!("none")),
        ("elements", serde_json::json!(0)),
        ("elements", serde_json::json!(1_000_000_000)),
        ("step_over_automatic", serde_json::json!(0)),
    ] {
        let mut changed = summary.clone();
        changed["points"][at][key] = value.clone();
        changed["reference"]["elements"] = serde_json::json!(1_u64 << 60);
        fs::write(&path, changed.to_string()).unwrap();
        let (code, _, talk) = desk.run(&["report", "run"]);
        assert_eq!(code, USAGE, "{key} {value}: {talk}");
        if key == "error" || value == -1.0 {
            continue; // the same by another number
        }
        let (code, again, talk) = desk.run(&[&verb[..], &["--resume"]].concat());
        assert_eq!(code, DONE, "{key} {value}: {talk}");
        assert!(
            talk.contains(&format!("points.{at}")),
            "{key} {value}: {talk}"
        );
        let believed = |time: &Value| time.as_f64().is_none_or(|time| time > 0.0 && time < 1e6);
        assert!(
            points(&again)
                .iter()
                .all(|point| believed(&point["wall_s"]))
        );
    }
}

/// `--apply` changes SCENE, through links and with its mode; another file that is there it replaces only where --force names it, a device it
/// writes to, and what is read-only stays.
#[cfg(unix)]
#[test]
fn applying_replaces_no_file_of_others() {
    use std::os::unix::fs::{FileTypeExt as _, PermissionsExt as _, symlink};
    let desk = Desk::with(SWING);
    let sweep = |more: &[&str]| {
        let verb = [
            "tradeoff",
            "link.toml",
            "--out",
            "run",
            "--budget",
            LONG,
            "--tolerance",
            "1e-2",
        ];
        desk.run(&[&verb[..], more].concat())
    };
    let mode = |name: &str| fs::metadata(desk.path(name)).unwrap().permissions().mode() & 0o7777;
    let set_mode = |name: &str, mode: u32| {
        fs::set_permissions(desk.path(name), fs::Permissions::from_mode(mode)).unwrap();
    };
    symlink("scene.toml", desk.path("link.toml")).unwrap();
    set_mode("scene.toml", 0o640);
    let (code, summary, talk) = sweep(&["--apply"]);
    assert_eq!(code, DONE, "{talk}");
    assert!(
        fs::symlink_metadata(desk.path("link.toml"))
            .unwrap()
            .is_symlink()
    );
    assert_eq!(mode("scene.toml"), 0o640);
    let elements = summary["recommended"]["elements"].as_u64().unwrap();
    assert_eq!(
        scene(&desk.path("scene.toml")).rod.elements as u64,
        elements
    );

    // Of a built-in scene it makes a file, and changes none.
    fs::write(desk.path("swing.toml"), "mine").unwrap();
    let (code, _, talk) = desk.run(&["tradeoff", "swing", "--out", "built-in", "--apply"]);
    assert_eq!(code, USAGE, "{talk}");
    assert!(talk.contains("--force=swing.toml"), "{talk}");
    assert!(!desk.path("built-in").exists());
    fs::write(desk.path("mine.toml"), "mine").unwrap();
    symlink("mine.toml", desk.path("to-mine.toml")).unwrap();
    for name in ["mine.toml", "to-mine.toml"] {
        let (code, _, talk) = sweep(&[&format!("--apply={name}")]);
        assert_eq!(code, USAGE, "{talk}");
        assert!(talk.contains("--force") && talk.contains(name), "{talk}");
        let (code, _, talk) = sweep(&[&format!("--apply={name}"), "--force", "scene.toml"]);
        assert_eq!(code, USAGE, "{talk}");
        assert_eq!(fs::read_to_string(desk.path("mine.toml")).unwrap(), "mine");
    }
    set_mode("mine.toml", 0o444);
    let (code, _, talk) = sweep(&["--apply=mine.toml", "--force=mine.toml"]);
    assert_eq!(code, USAGE, "{talk}");
    assert!(talk.contains("read-only"), "{talk}");
    set_mode("mine.toml", 0o600);
    let (code, summary, talk) = sweep(&["--apply=to-mine.toml", "--force=mine.toml"]);
    assert_eq!(code, DONE, "{talk}");
    assert_eq!(mode("mine.toml"), 0o600);
    assert!(
        fs::symlink_metadata(desk.path("to-mine.toml"))
            .unwrap()
            .is_symlink()
    );
    let elements = summary["recommended"]["elements"].as_u64().unwrap();
    assert_eq!(scene(&desk.path("mine.toml")).rod.elements as u64, elements);

    // A link to a file that is not there yet makes that file, and names that share a file go on to share it.
    symlink("new.toml", desk.path("to-new.toml")).unwrap();
    fs::hard_link(desk.path("scene.toml"), desk.path("second.toml")).unwrap();
    let (code, _, talk) = sweep(&["--apply=to-new.toml"]);
    assert_eq!(code, DONE, "{talk}");
    assert!(
        fs::symlink_metadata(desk.path("new.toml"))
            .unwrap()
            .is_file()
    );
    let (code, _, talk) = sweep(&["--apply", "--set", "time.end_s=0.25"]);
    assert_eq!(code, DONE, "{talk}");
    assert_eq!(scene(&desk.path("second.toml")).time.end_s.get(), 0.25);

    let (code, _, talk) = sweep(&["--apply=/dev/null"]);
    assert_eq!(code, DONE, "{talk}");
    let null = fs::metadata("/dev/null").unwrap();
    assert!(null.file_type().is_char_device());
    assert!(
        Command::new("mkfifo")
            .arg(desk.path("pipe"))
            .status()
            .unwrap()
            .success()
    );
    let (code, _, talk) = sweep(&["--apply=pipe"]);
    assert_eq!(code, tool::UNWRITTEN, "{talk}");
    assert!(
        fs::metadata(desk.path("pipe"))
            .unwrap()
            .file_type()
            .is_fifo()
    );
}

/// Every feature of a motion is measured with and without; what the scene has is marked.
#[test]
fn features_have_a_price() {
    let desk = Desk::with(SWING);
    let (_, summary, talk) = desk.run(&[
        "tradeoff",
        "scene.toml",
        "--out",
        "run",
        "--budget",
        LONG,
        "--tolerance",
        "1e-2",
    ]);
    let features = summary["features"].as_array().unwrap();
    let of = |name: &str| {
        let found = features.iter().find(|cost| cost["feature"] == name);
        found.unwrap_or_else(|| panic!("{name}: {talk}"))
    };
    assert_eq!(of("viscous damping")["in_scene"], true);
    assert_eq!(of("gravity")["in_scene"], false);
    for cost in features {
        assert!(
            number(&cost["with"]) > 0.0 && number(&cost["without"]) > 0.0,
            "{cost}"
        );
    }
    assert_eq!(of("internal damping")["in_scene"], false);
}

/// Waits for the first five points that a sweep says; those of them that were run to their end.
#[cfg(unix)]
fn first_points(lines: impl Iterator<Item = String>) -> usize {
    let seen: Vec<String> = lines
        .filter(|line| line.contains("elements,") || line.ends_with("elements"))
        .filter(|line| !line.starts_with("reference"))
        .take(5)
        .collect();
    assert_eq!(seen.len(), 5, "{seen:?}");
    let n_done = seen.iter().filter(|line| !line.contains("failed")).count();
    assert!(n_done > 0, "{seen:?}");
    n_done
}

/// Ctrl-C ends a sweep: what was run is written, the exit code says so, and the sweep goes on later. (A sweep that is done before the signal
/// comes is done.)
#[cfg(unix)]
#[test]
fn interrupted_sweeps_go_on() {
    let desk = Desk::with(SWING);
    let verb = ["tradeoff", "scene.toml", "--out", "run", "--budget", LONG];
    let mut child = Command::new(env!("CARGO_BIN_EXE_softarm"))
        .args(verb)
        .args(["--tolerance", "1e-5"])
        .current_dir(desk.0.path())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = std::io::BufRead::lines(std::io::BufReader::new(child.stderr.take().unwrap()));
    let seen = first_points(lines.by_ref().map_while(Result::ok));
    let interrupt = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status()
        .unwrap();
    assert!(interrupt.success());
    let _ = lines.count();
    let status = child.wait().unwrap();
    let text = fs::read_to_string(desk.path("run/summary.json")).unwrap();
    let summary: Value = serde_json::from_str(&text).unwrap();
    let was_stopped = status.code() == Some(tool::STOPPED);
    assert!(status.code().is_some(), "{status}");
    assert_eq!(summary["status"] == "interrupted", was_stopped, "{status}");
    let ran = points(&summary)
        .iter()
        .filter(|point| point["status"] == "done")
        .count();
    assert!(ran >= seen, "{ran} of {seen}");
    let (code, again, talk) = desk.run(&[&verb[..], &["--tolerance", "3e-3", "--resume"]].concat());
    assert_eq!(code, DONE, "{talk}");
    assert!(
        talk.contains(&format!("{ran} points are there already")),
        "{talk}"
    );
    assert!(points(&again).len() >= ran);
}

/// What a sweep has run is not lost when it is killed: the next one with `--resume` has its points, one without begins anew, and nothing is left beside the result.
#[cfg(unix)]
#[test]
fn killed_sweeps_go_on() {
    let desk = Desk::with(SWING);
    let verb = ["tradeoff", "scene.toml", "--out", "run", "--budget", LONG];
    let killed = || {
        let mut child = Command::new(env!("CARGO_BIN_EXE_softarm"))
            .args(verb)
            .args(["--tolerance", "1e-6"])
            .current_dir(desk.0.path())
            .stderr(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        let pipe = std::io::BufReader::new(child.stderr.take().unwrap());
        let seen = first_points(std::io::BufRead::lines(pipe).map_while(Result::ok));
        child.kill().unwrap();
        child.wait().unwrap();
        seen
    };
    let seen = killed();
    assert!(!desk.path("run/summary.json").exists());
    let resumed = [&verb[..], &["--tolerance", "3e-3", "--resume"]].concat();
    let (code, summary, talk) = desk.run(&resumed);
    assert_eq!(code, DONE, "{talk}");
    let there = talk
        .lines()
        .find_map(|line| line.strip_suffix(" points are there already"));
    let there: usize = there.expect(&talk).parse().unwrap();
    assert!(there >= seen, "{there} of {seen}");
    assert!(points(&summary).len() >= there);
    assert!(!desk.path(".run.running").exists());

    killed();
    let (code, _, talk) = desk.run(&[&verb[..], &["--tolerance", "3e-3"]].concat());
    assert_eq!(code, DONE, "{talk}");
    assert!(!talk.contains("there already"), "{talk}");
}
