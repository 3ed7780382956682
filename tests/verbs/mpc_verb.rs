//! `softarm mpc`: its files and their figures, results that repeat, runs that end early, and what is refused by its key.
//!
//! One loop serves for most claims: a soft arm of eight elements as the controller knows it, twelve elements and nine tenths of its stiffness
//! as it is, motion capture, and a Kalman filter, for a second of simulated time.

#![cfg(feature = "cli")]

use crate::tool;

use std::fs;
use std::path::PathBuf;
use std::process::Command;

use serde_json::{Value, json};
use softarm::output::{MotionRecord, read_controls};
use softarm::scene::Scene;
use softarm::stop::StopSignal;
use tempfile::TempDir;
use tool::{DONE, NUMERICAL, STOPPED, USAGE};

const LOOP: &str = "\
[rod]
length_m = 1.0
elements = 8
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.05
[damping]
viscous_1_s = 1.0
[time]
end_s = 1.0
[control]
force_max_n = 20.0
moment_max_n_m = [5.0, 5.0, 0.0]
[objective]
samples = 10
[[objective.track]]
weight = 3e4
circle = { center_m = [0.0, 0.0, 0.98], radius_m = 0.15, turn_s = 2.0, from_m = [0.0, 0.0, 1.0], ramp_s = 1.0 }
[mpc]
period_s = 0.02
horizon_s = 0.4
computing = \"fixed\"
counted_from_s = 0.5
[plant]
elements = 12
stiffness_factor = 0.9
[sensor]
preset = \"mocap\"
[estimator]
kind = \"kalman\"
disturbances = [\"tip_force\", \"stiffness\"]
";

struct Desk {
    folder: TempDir,
}

struct Run {
    code: i32,
    stdout: String,
    stderr: String,
}

impl Desk {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("loop.toml"), LOOP).unwrap();
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn run(&self, arguments: &[&str]) -> Run {
        let output = Command::new(env!("CARGO_BIN_EXE_softarm"))
            .args(arguments)
            .current_dir(self.folder.path())
            .env("NO_COLOR", "1")
            .output()
            .unwrap();
        Run {
            code: output.status.code().unwrap(),
            stdout: String::from_utf8(output.stdout).unwrap(),
            stderr: String::from_utf8(output.stderr).unwrap(),
        }
    }

    fn summary(&self, result: &str) -> Value {
        serde_json::from_str(&self.read(&format!("{result}/summary.json"))).unwrap()
    }

    fn read(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap()
    }

    /// Header and rows of `samples.csv`.
    fn samples(&self, result: &str) -> (Vec<String>, Vec<Vec<String>>) {
        let text = self.read(&format!("{result}/samples.csv"));
        let mut rows = text
            .lines()
            .map(|line| line.split(',').map(str::to_string).collect());
        (rows.next().unwrap(), rows.collect())
    }
}

/// Numbers of a column; nothing where there is none.
fn column(header: &[String], rows: &[Vec<String>], name: &str) -> Vec<Option<f64>> {
    let at = header
        .iter()
        .position(|own| own == name)
        .unwrap_or_else(|| panic!("no column {name}"));
    rows.iter().map(|row| row[at].parse().ok()).collect()
}

/// Rows without what is of this machine.
fn untimed(header: &[String], rows: &[Vec<String>]) -> Vec<Vec<String>> {
    let first = header
        .iter()
        .position(|name| name == softarm::output::closed_loop::FIRST_TIMED_COLUMN)
        .unwrap();
    rows.iter().map(|row| row[..first].to_vec()).collect()
}

/// The result directory has every file, the files agree with each other, and the error of the summary is that of the samples and of the
/// motion; controls are within their bounds.
#[test]
fn files_agree() {
    let desk = Desk::new();
    let run = desk.run(&["mpc", "loop.toml", "--out", "run", "--json"]);
    assert_eq!(run.code, DONE, "{}", run.stderr);
    let printed: Value = serde_json::from_str(&run.stdout).unwrap();
    let summary = desk.summary("run");
    assert_eq!(printed, summary);
    for name in [
        "scene.toml",
        "trajectory.npz",
        "controls.csv",
        "report.html",
    ] {
        assert!(desk.path("run").join(name).is_file(), "{name}");
    }
    assert_eq!(summary["schema_version"], 2);
    assert_eq!(summary["command"], "mpc");
    assert_eq!(summary["status"], "completed");
    assert_eq!(summary["samples"], 50);
    assert_eq!(summary["period_s"], 0.02);
    assert!(summary["overruns"].is_u64() && summary["fallbacks"].is_object());
    assert!(summary["real_time_factor"].as_f64().unwrap() > 0.0);
    for part in ["sample_s", "estimate_s", "feedback_s", "prepare_s"] {
        let times = ["p50", "p95", "p99", "max"].map(|p| summary[part][p].as_f64().unwrap());
        assert!(times[0] > 0.0 && times.is_sorted(), "{part}: {times:?}");
    }

    let (header, rows) = desk.samples("run");
    assert_eq!(rows.len(), 50);
    assert!(rows.iter().all(|row| row.len() == header.len()));
    let numbers = |name: &str| column(&header, &rows, name);
    let t = numbers("t");
    let error = numbers("error");
    let counted: Vec<f64> = (t.iter().zip(&error))
        .filter(|(t, _)| t.unwrap() >= 0.5)
        .map(|(_, error)| error.unwrap())
        .collect();
    let rms = (counted.iter().map(|e| e * e).sum::<f64>() / counted.len() as f64).sqrt();
    let said = summary["tip_error_m"]["rms"].as_f64().unwrap();
    assert!((said / rms - 1.0).abs() < 1e-12, "{said} and {rms}");
    // The arm is 1 m long.
    assert_eq!(summary["tip_error_over_length"]["rms"], said);
    let largest = counted.iter().copied().fold(0.0, f64::max);
    assert_eq!(summary["tip_error_m"]["max"], largest);
    assert_eq!(summary["tip_error_m"]["final"], *counted.last().unwrap());
    // It follows, which an arm at rest, off by up to the circle's radius, does not.
    assert!(rms < 0.02, "{rms}");
    assert!(numbers("innovation_normalized")[49].is_some());
    assert!(numbers("estimated_stiffness").iter().all(Option::is_some));

    // Rows of the motion are those of the beginnings of samples, and one at the end.
    let motion = MotionRecord::read_npz(&desk.path("run/trajectory.npz")).unwrap();
    assert_eq!((motion.n_rows(), motion.n_nodes), (51, 13));
    for k in 0..rows.len() {
        let tip = ["tip_x", "tip_y", "tip_z"].map(|name| numbers(name)[k].unwrap());
        let node = &motion.x[(k * 13 + 12) * 3..][..3];
        assert!(
            tip.iter().zip(node).all(|(a, b)| (a - b).abs() < 1e-12),
            "{k}"
        );
    }
    let headings = [
        "tip force x (N)",
        "tip force y (N)",
        "tip force z (N)",
        "tip moment x (N m)",
        "tip moment y (N m)",
    ]
    .map(String::from);
    let controls = read_controls(&desk.path("run/controls.csv"), &headings, 100).unwrap();
    for row in &controls {
        assert!(row.values[..3].iter().map(|f| f * f).sum::<f64>().sqrt() <= 20.0 + 1e-9);
        assert!(row.values[3..].iter().all(|m| m.abs() <= 5.0 + 1e-9));
    }
    let text = desk.read("run/controls.csv");
    let header = text.lines().next().unwrap();
    assert_eq!(header, format!("t_start,t_end,{}", headings.join(",")));
    // The first command acts one period after the first sample.
    assert_eq!(numbers("acts_from")[0], Some(0.02));
    assert_eq!(controls[0].t_start, 0.02);
    let page = desk.read("run/report.html");
    assert!(page.contains("Samples by their time on this machine"));
    assert!(page.contains("Estimated factor on the stiffness"));
}

/// The scene in a result directory gives the same samples, motion and scene again, to the byte, but for times of the machine; another seed
/// gives others.
#[test]
fn resolved_scenes_repeat() {
    let desk = Desk::new();
    let short = ["--set", "time.end_s=0.3", "--quiet"];
    let run = |scene: &str, out: &str, extra: &[&str]| {
        let run = desk.run(&[&["mpc", scene, "--out", out], extra].concat());
        assert_eq!(run.code, DONE, "{}", run.stderr);
        let (header, rows) = desk.samples(out);
        untimed(&header, &rows)
    };
    let first = run(
        "loop.toml",
        "first",
        &[&short[..], &["--seed", "7"]].concat(),
    );
    let again = run("first/scene.toml", "again", &["--quiet"]);
    assert_eq!(first, again);
    let bytes = |name: &str| fs::read(desk.path(name)).unwrap();
    for name in ["trajectory.npz", "controls.csv", "scene.toml"] {
        let [one, other] = ["first", "again"].map(|run| bytes(&format!("{run}/{name}")));
        assert!(one == other, "{name} differs");
    }
    assert_eq!(desk.summary("again")["seed"], 7);
    // A seed on the command line goes before that of the scene.
    let other = run("first/scene.toml", "other", &["--quiet", "--seed", "8"]);
    assert_ne!(first, other);
}

/// `check` tells of a loop its horizon, its sensors, what a sample takes, and the force that holds the tip along its path; where the bounds do not allow it,
/// a warning says when and how much.
#[test]
fn check_tells_of_the_loop() {
    let desk = Desk::new();
    let check = |force: &str| {
        let bound = format!("control.force_max_n={force}");
        let run = desk.run(&["check", "loop.toml", "--json", "--set", &bound]);
        assert_eq!(run.code, DONE, "{}", run.stderr);
        let summary: Value = serde_json::from_str(&run.stdout).unwrap();
        (summary["closed_loop"].clone(), run.stderr)
    };
    let (wide, said) = check("1000.0");
    assert!(!said.contains("above the bounds"), "{said}");
    assert!(wide["sample_s"].as_f64().unwrap() > 0.0);
    assert_eq!(wide["sensors"].as_array().unwrap().len(), 1);
    let force = |found: &Value| {
        let all = found["reference"]["force_n"].as_array().unwrap().clone();
        let squares: f64 = all.iter().map(|f| f.as_f64().unwrap().powi(2)).sum();
        squares.sqrt()
    };
    assert_eq!(wide["reference"]["force_excess_n"], 0.0);
    let half = 0.5 * force(&wide);
    let (narrow, said) = check(&half.to_string());
    assert!(said.contains("above the bounds"), "{said}");
    let excess = narrow["reference"]["force_excess_n"].as_f64().unwrap();
    assert!((excess - half).abs() < 1e-6 * half, "{excess} {half}");
}

/// With `--baselines` the summary has the other laws, the controller is nearer to its reference than its plan alone on an arm that is softer,
/// and nearest where the arm is its model; one table says so.
#[test]
fn baselines_are_compared() {
    let desk = Desk::new();
    let softer = "plant.stiffness_factor=0.7";
    let run = desk.run(&[
        "mpc",
        "loop.toml",
        "--out",
        "run",
        "--baselines",
        "--set",
        softer,
    ]);
    assert_eq!(run.code, DONE, "{}", run.stderr);
    let summary = desk.summary("run");
    let rms = |part: &Value| part["tip_error_m"]["rms"].as_f64().unwrap();
    let baselines = &summary["baselines"];
    let [open, regulator, pd, model, waits] = [
        "open_loop",
        "regulator",
        "pd",
        "plant_is_model",
        "plant_waits",
    ]
    .map(|name| rms(&baselines[name]));
    let own = rms(&summary);
    assert!(own < 0.5 * open, "{own} and {open}");
    assert!(model < 0.5 * open, "{model} and {open}");
    assert!(regulator > 0.0 && pd > 0.0 && waits > 0.0);
    for label in [
        "open loop",
        "regulator",
        "PID at the tip",
        "plant = model",
        "plant waits",
    ] {
        assert!(run.stderr.contains(label), "{}", run.stderr);
    }
}

/// Open loop on an arm that is its model, from the same start, with a regulator that has nothing to do and without, does what the controller
/// does with the true state: within a thousandth of the
/// length, where standing still would be off by the circle's radius.
#[test]
fn open_loop_follows_on_its_own_model() {
    let desk = Desk::new();
    let text = LOOP
        .replace("stiffness_factor = 0.9\n", "")
        .replace("elements = 12\n", "")
        .replace("[sensor]\npreset = \"mocap\"\n", "");
    let text = &text[..text.find("[estimator]").unwrap()];
    fs::write(desk.path("exact.toml"), text).unwrap();
    let run = desk.run(&["mpc", "exact.toml", "--out", "run", "--baselines"]);
    assert_eq!(run.code, DONE, "{}", run.stderr);
    let summary = desk.summary("run");
    let rms = |part: &Value| part["tip_error_m"]["rms"].as_f64().unwrap();
    let baselines = &summary["baselines"];
    let [open, regulator] = ["open_loop", "regulator"].map(|name| rms(&baselines[name]));
    let own = rms(&summary);
    assert!((open - own).abs() < 1e-3 && own < 0.02, "{open} and {own}");
    // The arm has a time step of its own.
    assert!((open - regulator).abs() < 1e-3, "{open} and {regulator}");
}

/// The summary says how fast the limited node of the plant was: on a circle of 0.15 m in 2 s it moves at 0.471 m/s, which a limit without a price of
/// its own does not change, and its excess over a limit of 0.2 m/s is the rest.
#[test]
fn speeds_beyond_a_limit_are_told() {
    let desk = Desk::new();
    let limit = "[[limit]]\nspeed_max_m_s = 0.2\nsoft = { linear = 1e-9 }\n";
    fs::write(desk.path("fast.toml"), format!("{LOOP}{limit}")).unwrap();
    let run = desk.run(&["mpc", "fast.toml", "--out", "run"]);
    assert_eq!(run.code, DONE, "{}", run.stderr);
    let peak = &desk.summary("run")["limits"][0];
    let speed = 0.2 + peak["excess"].as_f64().unwrap();
    let on_circle = std::f64::consts::TAU * 0.15 / 2.0;
    assert!(
        (0.9..1.5).contains(&(speed / on_circle)),
        "{speed} {on_circle}"
    );
    assert!(peak["at_s"].as_f64() > Some(0.5), "{peak}");
    assert_eq!((&peak["unit"], &peak["node"]), (&json!("m/s"), &json!(12)));
}

/// A deadline ends a loop, and so does Ctrl-C: exit code 6, and what ran by then is a complete result.
#[cfg(unix)]
#[test]
fn what_ran_is_kept() {
    use std::io::{BufRead as _, BufReader, Read as _};
    use std::process::Stdio;

    let desk = Desk::new();
    let long = ["--set", "mpc.duration_s=20000", "--set", "time.end_s=1.0"];
    // A loop that is stopped before its first sample has nothing to keep: wait longer.
    let mut deadline_s = 1.0;
    while !desk.path("deadline/summary.json").exists() {
        let setting = format!("solver.deadline_s={deadline_s}");
        let deadline = ["--set", &setting, "--out", "deadline"];
        let run = desk.run(&[&["mpc", "loop.toml"], &long[..], &deadline].concat());
        assert_eq!(run.code, STOPPED, "{}", run.stderr);
        deadline_s *= 2.0;
    }
    assert_eq!(desk.summary("deadline")["status"], "deadline");

    let mut patience = std::time::Duration::from_millis(200);
    while !desk.path("stopped/summary.json").exists() {
        let mut child = Command::new(env!("CARGO_BIN_EXE_softarm"))
            .args(["mpc", "loop.toml", "--out", "stopped"])
            .args(long)
            .current_dir(desk.folder.path())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut talk = BufReader::new(child.stderr.take().unwrap());
        let mut line = String::new();
        talk.read_line(&mut line).unwrap();
        assert!(line.contains("samples of"), "{line}");
        std::thread::sleep(patience);
        patience *= 2;
        let id = child.id().to_string();
        let sent = Command::new("kill").args(["-INT", &id]).status().unwrap();
        assert!(sent.success());
        let mut rest = String::new();
        talk.read_to_string(&mut rest).unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(STOPPED), "{rest}");
    }
    let summary = desk.summary("stopped");
    assert_eq!(summary["status"], "interrupted");

    for result in ["deadline", "stopped"] {
        let n = desk.summary(result)["samples"].as_u64().unwrap() as usize;
        // Of 20 000 s with 50 samples each.
        assert!(n < 1_000_000, "{n}");
        let (_, rows) = desk.samples(result);
        assert_eq!(rows.len(), n);
        let file = desk.path(result).join("trajectory.npz");
        assert_eq!(MotionRecord::read_npz(&file).unwrap().n_rows(), n + 1);
    }
}

/// A blow that the arm's motion does not survive ends the run with exit code 5, the node and the time, and keeps the samples before it.
#[test]
fn a_plant_that_breaks_down_is_a_numerical_failure() {
    let desk = Desk::new();
    let blow = "disturbance=[{node = 'tip', moment_n_m = [1e6, 0, 0], profile = [[0.2, 0], [0.21, 1], [1, 1]]}]";
    let run = desk.run(&["mpc", "loop.toml", "--out", "run", "--set", blow]);
    assert_eq!(run.code, NUMERICAL, "{}", run.stderr);
    assert!(run.stderr.contains("broke down"), "{}", run.stderr);
    let summary = desk.summary("run");
    assert_eq!(summary["status"], "failed");
    assert!(summary["error"].as_str().unwrap().contains("node"));
    let n = summary["samples"].as_u64().unwrap();
    assert!((9..50).contains(&n), "{n}");
    // Nothing was counted before.
    assert!(summary["tip_error_m"]["rms"].is_null());
}

/// What cannot be run is refused by the key that says it, and with exit code 2; nothing is written.
#[test]
fn refusals_name_their_keys() {
    let cases: &[(&str, &[&str])] = &[
        ("mpc.horizon_s", &["mpc.horizon_s=0.001"]),
        ("mpc.period_s", &["mpc.period_s=0"]),
        ("mpc.iterations", &["mpc.iterations=0"]),
        ("mpc.hoizon_s", &["mpc.hoizon_s=1"]),
        ("plant.elements", &["plant.elements=0"]),
        ("plant.stiffness_factor", &["plant.stiffness_factor=-1"]),
        (
            "plant.section.radius_tip_m",
            &["plant.section.radius_base_m=0.05"],
        ),
        ("plant.actuator.delay_s", &["plant.actuator.delay_s=-0.1"]),
        (
            "sensor.0.places.0",
            &["sensor={places=[1.5], position_sigma_m=1e-3}"],
        ),
        ("sensor.0.places", &["sensor={position_sigma_m=1e-3}"]),
        ("sensor.0.preset", &["sensor={rate_hz=10}"]),
        ("sensor.0.rate_hz", &["sensor.rate_hz=-1"]),
        ("estimator.kind", &["estimator.kind=kalmann"]),
        ("estimator.kind", &["estimator.kind=observer"]),
        ("sensor", &["sensor=[]"]),
        ("disturbance.0.node", &["disturbance=[{node = 17}]"]),
        ("control.hold", &["control.hold=cubic"]),
        (
            "objective.track.0.circle",
            &["objective.track.0.path_m=[[0, 0, 0, 1]]"],
        ),
        (
            "objective.track.0.path_m",
            &["objective.track=[{weight = 1}]"],
        ),
        (
            "objective.track.0.figure_eight",
            &[
                "objective.track.0.figure_eight={center_m = [0, 0, 1], half_length_m = 0.1, turn_s = 1}",
            ],
        ),
        (
            "objective.track.0.circle.normal",
            &["objective.track.0.circle.normal=[0, 0, 0]"],
        ),
    ];
    for (key, overrides) in cases {
        let overrides: Vec<String> = overrides.iter().map(|text| text.to_string()).collect();
        let error = match Scene::from_toml("loop", LOOP, &overrides) {
            Err(error) => error,
            Ok((scene, source)) => scene
                .closed_loop(&source, 0, &StopSignal::default())
                .err()
                .unwrap_or_else(|| panic!("accepted: {overrides:?}")),
        };
        assert_eq!(error.key(), Some(*key), "{error}");
    }
    let desk = Desk::new();
    for arguments in [
        &["mpc", "swing"][..],
        &["mpc", "loop.toml", "--set", "mpc.horizon_s=0.001"],
        &["mpc", "loop.toml", "--seed", "5000000000"],
    ] {
        let run = desk.run(arguments);
        assert_eq!(run.code, USAGE, "{}", run.stderr);
    }
    assert!(!desk.path("results").exists());
    // A section of one sensor is pointed at by its line.
    let text = LOOP.replace("preset = \"mocap\"", "preset = \"mocap\"\nrate_hz = -1.0");
    let error = Scene::from_toml("loop", &text, &[]).unwrap_err();
    let line = text
        .lines()
        .position(|line| line.starts_with("rate_hz"))
        .unwrap()
        + 1;
    assert_eq!(error.line(), Some(line), "{error}");
}

/// What goes on after its task is due is warned of, and the result of a loop is none that `verify` certifies.
#[test]
fn what_is_not_meant_is_said() {
    let desk = Desk::new();
    let run = desk.run(&[
        "mpc",
        "loop.toml",
        "--out",
        "run",
        "--set",
        "time.end_s=0.2",
        "--set",
        "mpc.due_s=0.1",
    ]);
    assert_eq!(run.code, DONE, "{}", run.stderr);
    assert!(
        run.stderr.contains("nothing holds the arm"),
        "{}",
        run.stderr
    );
    let run = desk.run(&["verify", "run"]);
    assert_eq!(run.code, USAGE, "{}", run.stderr);
    assert!(run.stderr.contains("of a closed loop"), "{}", run.stderr);
}

/// A camera that sees the arm twice a second, later than any fall-back waits by default: the patience of a loop follows its slowest sensor, so that nothing falls back
/// and a softer arm stays at its target, which it left by half of its length when the loop did not wait.
#[test]
fn slow_cameras_are_waited_for() {
    const CAMERA: &str = "\
[rod]
length_m = 0.5
elements = 10
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.02
[damping]
viscous_1_s = 1.0
internal_s = 0.005
[time]
end_s = 5.0
[task]
position_m = [0.15, 0.0, 0.472]
[control]
force_max_n = 3.0
moment_max_n_m = 0.0
[objective]
rate = 0.003
[mpc]
counted_from_s = 1.0
computing = \"fixed\"
[plant]
stiffness_factor = 0.85
[[sensor]]
preset = \"camera\"
rate_hz = 2
[estimator]
kind = \"kalman\"
disturbances = [\"tip_force\", \"stiffness\"]
";
    let desk = Desk::new();
    fs::write(desk.path("camera.toml"), CAMERA).unwrap();
    let run = desk.run(&["mpc", "camera.toml", "--out", "run"]);
    assert_eq!(run.code, DONE, "{}", run.stderr);
    let summary = desk.summary("run");
    assert_eq!(summary["fallbacks"], serde_json::json!({}));
    // The motion between two pictures is that of the model until its stiffness is found.
    let off = &summary["tip_error_over_length"];
    let [rms, last] = ["rms", "final"].map(|key| off[key].as_f64().unwrap());
    assert!(rms < 0.015 && last < 0.005, "{off}");
}

/// A circle is a path of points: on the circle to four parts in 100 000 of its radius, and from its beginning on to the end of the loop and
/// of its last horizon.
#[test]
fn circles_last_as_long_as_the_loop() {
    let (scene, source) = Scene::from_toml("loop", LOOP, &[]).unwrap();
    let setup = scene
        .closed_loop(&source, 0, &StopSignal::default())
        .unwrap();
    let path = &setup.experiment.task.cost.tracks[0].path;
    assert_eq!(path[0].1.as_slice(), [0.0, 0.0, 1.0]);
    assert!(path.last().unwrap().0 >= 1.4);
    for pair in path.windows(2).filter(|pair| pair[0].0 >= 1.0) {
        for point in [pair[0].1, (pair[0].1 + pair[1].1) * 0.5] {
            let radius = point.x.hypot(point.y);
            assert!((radius / 0.15 - 1.0).abs() < 4e-5, "{radius}");
            assert!((point.z - 0.98).abs() < 1e-12);
        }
    }
}

/// A figure eight begins in its center, is as long as it is told, crosses itself in its plane half a turn later, and lasts as long as the loop.
#[test]
fn figure_eights_cross_themselves() {
    let eight = "objective.track=[{figure_eight = {center_m = [0, 0, 0.97], half_length_m = 0.1, turn_s = 0.5}}]";
    let (scene, source) = Scene::from_toml("loop", LOOP, &[eight.into()]).unwrap();
    let setup = scene.closed_loop(&source, 0, &StopSignal::default());
    let path = &setup.unwrap().experiment.task.cost.tracks[0].path;
    assert!(path.last().unwrap().0 >= 1.4);
    let at = |t: f64| {
        let next = path.partition_point(|point| point.0 <= t + 1e-12);
        path[next - 1].1
    };
    for crossing in [0.0, 0.25, 0.5] {
        assert!((at(crossing) - nalgebra::Vector3::new(0.0, 0.0, 0.97)).norm() < 1e-12);
    }
    let farthest = path
        .iter()
        .map(|point| point.1.x.abs().max(point.1.y.abs()));
    assert!((farthest.fold(0.0, f64::max) - 0.1).abs() < 1e-12);
    assert!(path.iter().all(|point| (point.1.z - 0.97).abs() < 1e-15));
}

/// The built-in loops are set up, and their resolved scenes are scenes of the same loop.
#[test]
fn built_in_loops_are_loops() {
    let names: Vec<&str> = softarm::scene::builtin::names()
        .filter(|name| name.starts_with("mpc-"))
        .collect();
    assert_eq!(names.len(), 15);
    for name in names {
        let (scene, source) = Scene::load(name, &[]).unwrap();
        let setup = scene
            .closed_loop(&source, 3, &StopSignal::default())
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        assert!(setup.warnings.is_empty(), "{name}: {:?}", setup.warnings);
        let paths = setup.unbent_paths(&StopSignal::default());
        assert!(paths.is_empty(), "{name}: {paths:?}");
        let text = setup.resolved.to_toml();
        let (again, source) = Scene::from_toml(name, &text, &[]).unwrap();
        assert_eq!(again, setup.resolved, "{name}");
        let again = again
            .closed_loop(&source, 0, &StopSignal::default())
            .unwrap();
        assert_eq!(again.resolved, setup.resolved, "{name}");
        assert_eq!(again.experiment.mpc, setup.experiment.mpc, "{name}");
        assert_eq!(again.experiment.sensing, setup.experiment.sensing, "{name}");
        assert_eq!(again.plant.nodes, setup.plant.nodes, "{name}");
        assert_eq!(again.plant.loads, setup.plant.loads, "{name}");
    }
}

/// A figure eight in a plane, below a hanging arm: in its middle the tip must be pushed up, which the loop says before it runs; moved to where it says, half of
/// that remains.
#[test]
fn paths_off_the_swept_surface_are_named() {
    const EIGHT: &str = "\
[rod]
length_m = 0.30
elements = 8
[rod.material]
preset = \"dragon-skin-30\"
[rod.section]
radius_base_m = 0.015
radius_tip_m = 0.008
[base]
direction = [0.0, 0.0, -1.0]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[payload]
mass_kg = 0.04
[initial]
shape = \"equilibrium\"
[time]
end_s = 8.0
[control]
force_max_n = 2.0
[[objective.track]]
figure_eight = { center_m = [0.0, 0.0, -0.29], half_length_m = 0.08, turn_s = 3.0 }
[mpc]
";
    let of = |height: f64| {
        let text = EIGHT.replace("-0.29]", &format!("{height}]"));
        let (scene, source) = Scene::from_toml("eight", &text, &[]).unwrap();
        let setup = scene.closed_loop(&source, 0, &StopSignal::default());
        setup.unwrap().unbent_paths(&StopSignal::default())
    };
    let off = of(-0.29);
    assert!(
        off.len() == 1 && off[0].contains("it is pressed together"),
        "{off:?}"
    );
    let (_, after) = off[0].split_once("center_m = [0.0000, 0.0000, ").unwrap();
    let height: f64 = after.split_once(']').unwrap().0.parse().unwrap();
    // The hanging arm ends at -0.301 m, and the ends of the figure are higher.
    assert!((-0.301..-0.29).contains(&height), "{height}");
    let range = |sentence: &str| -> [f64; 2] {
        let (_, rest) = sentence.split_once("passes this path at ").unwrap();
        let (range, _) = rest.split_once(" mm").unwrap();
        let (least, most) = range.split_once(" to ").unwrap();
        [least.parse().unwrap(), most.parse().unwrap()]
    };
    let [least, most] = range(&off[0]);
    let moved = of(height);
    let [nearer, farther] = range(&moved[0]);
    let half = 0.5 * (most - least);
    assert!(
        (nearer + half).abs() < 0.1 && (farther - half).abs() < 0.1,
        "{moved:?}"
    );
}

/// A soft arm whose force steps at the start to many times what holds it: the filter is wrecked, and puts 62 ms into the delay with a standard
/// deviation of 0.05 ms. `advice` says that nothing confirms it, and does not name it as a value of `mpc.actuator_delay_s`.
#[test]
fn an_unconfirmed_delay_is_not_recommended() {
    let desk = Desk::new();
    let scene = r#"
[rod]
length_m = 0.3
elements = 6
material = { preset = "ecoflex-00-30" }
section = { radius_m = 0.0125 }
[base]
direction = [0.0, 0.0, -1.0]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[damping]
viscous_1_s = 0.5
internal_s = 0.002
[initial]
shape = "equilibrium"
[time]
end_s = 1.0
[task]
position_m = [0.2, 0.0, -0.15]
[control]
force_max_n = 5.0
moment_max_n_m = 0.2
[objective]
rate = 0.003
[mpc]
period_s = 0.02
counted_from_s = 0.5
[plant]
elements = 24
stiffness_factor = 0.8
[[sensor]]
preset = "mocap"
[estimator]
kind = "kalman"
"#;
    fs::write(desk.path("wrecked.toml"), scene).unwrap();
    desk.run(&["mpc", "wrecked.toml", "--quiet", "--out", "run"]);
    let summary = desk.summary("run");
    assert_eq!(summary["innovations"]["is_off"], true);
    let advice = summary["advice"].as_array().unwrap();
    let has = |words: &str| {
        advice
            .iter()
            .any(|own| own.as_str().unwrap().contains(words))
    };
    assert!(has("is not confirmed"), "{advice:#?}");
    assert!(!has("mpc.actuator_delay_s ="), "{advice:#?}");
}

/// A reference that wanders 5 m away: the loop goes on within its bounds, and the first line of its advice is that no controller gets there.
#[test]
fn references_out_of_reach_are_named() {
    let desk = Desk::new();
    let scene = r#"
[rod]
length_m = 0.3
elements = 4
material = { preset = "ecoflex-00-30" }
section = { radius_m = 0.0125 }
[base]
direction = [0.0, 0.0, -1.0]
[damping]
viscous_1_s = 2.0
[time]
end_s = 0.3
[control]
force_max_n = 0.2
[[objective.track]]
weight = 1e3
path_m = [[0.0, 0.0, 0.0, -0.3], [0.2, 5.0, 0.0, 0.0]]
[mpc]
period_s = 0.02
horizon_s = 0.1
counted_from_s = 0.1
"#;
    fs::write(desk.path("far.toml"), scene).unwrap();
    desk.run(&["mpc", "far.toml", "--quiet", "--out", "run"]);
    let summary = desk.summary("run");
    let first = summary["advice"][0].as_str().unwrap();
    assert!(
        first.contains("the reference is 5.000 m from the base"),
        "{first}"
    );
    let controls = fs::read_to_string(desk.path("run/controls.csv")).unwrap();
    let forces = controls.lines().skip(1).flat_map(|row| {
        let cells = row
            .split(',')
            .map(|cell| cell.parse::<f64>().unwrap_or(0.0));
        cells.skip(2).take(3).collect::<Vec<_>>()
    });
    assert!(forces.into_iter().all(|force| force.abs() <= 0.2 + 1e-9));
}

/// A ball that crosses the middle of a hanging arm, whose tip is to stay where it is.
const CROSSED: &str = r#"
[rod]
length_m = 0.4
elements = 6
material = { preset = "dragon-skin-30" }
section = { radius_m = 0.012 }
[base]
direction = [0.0, 0.0, -1.0]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[damping]
viscous_1_s = 2.0
internal_s = 0.005
[initial]
shape = "equilibrium"
[time]
end_s = 1.0
[task]
position_m = [0.0, 0.0, -0.4]
[control]
force_max_n = 3.0
[[obstacle]]
name = "ball"
sphere = { center_m = [-0.1, 0.01, -0.22], radius_m = 0.03 }
velocity_m_s = [0.1, 0.0, 0.0]
[plant]
elements = 12
[mpc]
counted_from_s = 0.0
"#;

/// The price of an obstacle follows the pull of the target: the ball of the scene, which at the price of 5000 goes 25 mm into the arm, is
/// kept clear of to within a hundredth of the radius of ball and arm (0.42 mm). With a given price the violation is in the first line of the
/// output, in the summary and in the advice, and where the force is too weak, the advice says that nothing keeps the arm clear.
#[test]
fn obstacles_are_kept_clear_of_or_told() {
    let desk = Desk::new();
    fs::write(desk.path("crossed.toml"), CROSSED).unwrap();
    let ball = |run: &str| desk.summary(run)["limits"][0].clone();
    let advice = |run: &str| desk.summary(run)["advice"].to_string();

    desk.run(&["mpc", "crossed.toml", "--out", "kept"]);
    let kept = ball("kept");
    assert_eq!(kept["violated"], false, "{kept}");
    assert!(kept["excess"].as_f64().unwrap() < 0.01 * 0.042, "{kept}");
    assert!(!advice("kept").contains("exceeded"));
    assert_eq!(desk.summary("kept")["breaking"], 0);

    let price = ["--set", "mpc.limit_price=5000"];
    let run = desk.run(&[&["mpc", "crossed.toml", "--out", "cheap"], &price[..]].concat());
    let cheap = ball("cheap");
    assert_eq!(cheap["violated"], true);
    assert!(cheap["excess"].as_f64().unwrap() > 0.01, "{cheap}");
    assert!(advice("cheap").contains("mpc.limit_price = 5000"));
    assert!(run.stderr.contains("VIOLATED: ball exceeded by"));

    let weak = ["--set", "control.force_max_n=0.02"];
    desk.run(&[&["mpc", "crossed.toml", "--out", "weak"], &weak[..]].concat());
    assert_eq!(ball("weak")["violated"], true);
    let breaking = &desk.summary("weak")["breaking"];
    assert!(breaking.as_u64().unwrap() > 10);
    let gave_way = &ball("weak")["gave_way"];
    assert_eq!(&gave_way["samples"], breaking);
    assert!(
        gave_way["by"].as_f64().unwrap() > 0.01 * 0.042,
        "{gave_way}"
    );
    let (header, rows) = desk.samples("weak");
    let in_samples = |name: &str| header.iter().position(|own| own == name).unwrap();
    let gave = (rows.iter()).filter(|row| row[in_samples("gave_way")] == "true");
    assert_eq!(gave.count() as u64, breaking.as_u64().unwrap());
    assert!(advice("weak").contains("no command within the bounds"));
}

/// A filter that measures the whole state exactly follows an arm that is a fifth softer and has twice the elements as well as one with motion
/// capture, to a fifth of the error, and the scene says that the sensor is more exact than the model.
#[test]
fn exact_sensors_do_no_harm() {
    let desk = Desk::new();
    let scene = CROSSED
        .replace(
            "position_m = [0.0, 0.0, -0.4]",
            "position_m = [0.1, 0.0, -0.372]",
        )
        .replace("elements = 12", "elements = 12\nstiffness_factor = 0.8")
        .replace("counted_from_s = 0.0", "counted_from_s = 0.75");
    let (before, rest) = scene.split_once("[[obstacle]]").unwrap();
    let (_, after) = rest.split_once("[plant]").unwrap();
    let scene = format!(
        "{before}[plant]{after}[[sensor]]\npreset = \"state\"\n[estimator]\nkind = \"kalman\"\n"
    );
    fs::write(desk.path("exact.toml"), scene).unwrap();
    let run = desk.run(&["mpc", "exact.toml", "--out", "exact"]);
    assert!(
        run.stderr
            .contains("sensor.0 is more exact than a model of 6 elements")
    );
    let seen = ["--set", "sensor.0.preset=mocap"];
    desk.run(&[&["mpc", "exact.toml", "--out", "seen"], &seen[..]].concat());
    let error = |run: &str| {
        let summary = desk.summary(run);
        summary["tip_error_over_length"]["rms"].as_f64().unwrap()
    };
    let [exact, seen] = ["exact", "seen"].map(error);
    assert!(exact < 1.2 * seen, "{exact} and {seen}");
}

/// Overrides by which the tendons of the plant of `mpc-tendons` follow their commands with a lag, s.
fn lagging(lag: f64) -> Vec<String> {
    let names = ["first", "second", "third", "fourth"];
    (names.iter().enumerate())
        .flat_map(|(index, name)| {
            let name = format!("plant.tendon.{index}.name=\"{name}\"");
            let lag = format!("plant.tendon.{index}.lag_s={lag}");
            ["--set".into(), name, "--set".into(), lag]
        })
        .collect()
}

/// To commands that change slowly, a lag looks like a delay: with one of a third of the horizon, which nobody knows, the tip stays within
/// 0.6 % of the length of its circle (root mean square) after the first turn.
#[test]
fn a_long_lag_is_taken_for_a_delay() {
    let desk = Desk::new();
    let lag = lagging(0.08);
    let mut arguments = vec![
        "mpc",
        "mpc-tendons",
        "--set",
        "time.end_s=9.0",
        "--out",
        "late",
    ];
    arguments.extend(lag.iter().map(String::as_str));
    desk.run(&arguments);
    let found = desk.summary("late");
    let error = found["tip_error_over_length"]["rms"].as_f64().unwrap();
    assert!(error < 6e-3, "{error}");
}

/// A lag of the tendons that the model does not know puts the estimate in doubt, and the advice names the unknown that finds it; with it, the
/// estimate is consistent.
#[test]
fn an_unknown_lag_is_named_or_found() {
    let desk = Desk::new();
    let mut arguments: Vec<String> = ["mpc", "mpc-tendons", "--set", "time.end_s=4.0"]
        .map(Into::into)
        .into();
    arguments.extend(lagging(0.03));
    let go = |more: &[&str]| {
        let all: Vec<&str> = arguments
            .iter()
            .map(String::as_str)
            .chain(more.iter().copied())
            .collect();
        desk.run(&all);
    };
    let without =
        "estimator.disturbances=[\"tip_force\", \"tip_moment\", \"distributed\", \"stiffness\"]";
    go(&["--set", without, "--out", "without"]);
    let summary = desk.summary("without");
    assert_eq!(summary["innovations"]["is_off"], true);
    assert!(
        summary["advice"]
            .to_string()
            .contains("\\\"delay\\\" finds them"),
        "{}",
        summary["advice"]
    );
    go(&["--out", "with"]);
    assert_eq!(desk.summary("with")["innovations"]["is_off"], false);
}

/// The scene of a loop that is shorter than a step of its horizon gives the same loop again, and an equilibrium does not mind the step. A
/// solve, whose motion is as long as its scene says, refuses it by its key.
#[test]
fn scenes_of_short_loops_are_read_again() {
    let desk = Desk::new();
    fs::write(desk.path("crossed.toml"), CROSSED).unwrap();
    let short = [
        "--set",
        "time.end_s=0.01",
        "--set",
        "time.step_s=0.02",
        "--set",
        "time.integrator=implicit",
    ];
    let run = desk.run(&[&["mpc", "crossed.toml", "--out", "once"], &short[..]].concat());
    assert_eq!(run.code, DONE, "{}", run.stderr);
    let scene = desk.path("once/scene.toml");
    let run = desk.run(&["mpc", scene.to_str().unwrap(), "--out", "again"]);
    assert_eq!(run.code, DONE, "{}", run.stderr);
    let run = desk.run(&["equilibrium", scene.to_str().unwrap(), "--out", "rest"]);
    assert_eq!(run.code, DONE, "{}", run.stderr);
    let run = desk.run(&["solve", "reach", "--set", "time.step_s=2", "--out", "long"]);
    assert_eq!(run.code, USAGE, "{}", run.stderr);
    assert!(run.stderr.contains("--set time.step_s=2"), "{}", run.stderr);
    assert!(
        run.stderr.contains("is longer than time.end_s"),
        "{}",
        run.stderr
    );
}
