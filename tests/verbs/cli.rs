//! The command line as a script sees it: exit codes, what stands on stdout and stderr, and the files.

#![cfg(feature = "cli")]

use crate::tool;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;
use tool::{DONE, INFEASIBLE, NOT_CONVERGED, NUMERICAL, REJECTED, SCENE, STOPPED, USAGE};

/// A folder of its own with a scene in it.
struct Desk {
    folder: TempDir,
}

impl Desk {
    fn new() -> Self {
        let desk = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        desk.write("scene.toml", SCENE);
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path(name), text).unwrap();
    }

    /// Runs the tool in the folder; whatever happens, it does not panic.
    #[track_caller]
    fn run(&self, arguments: &[&str]) -> Run {
        let output = Command::new(env!("CARGO_BIN_EXE_softarm"))
            .args(arguments)
            .current_dir(self.folder.path())
            .env("NO_COLOR", "1")
            .output()
            .unwrap();
        let run = Run::of(output);
        assert!(!run.stderr.contains("panicked"), "{}", run.stderr);
        run
    }
}

struct Run {
    code: i32,
    stdout: String,
    stderr: String,
}

impl Run {
    fn of(output: Output) -> Self {
        Self {
            code: output.status.code().unwrap(),
            stdout: String::from_utf8(output.stdout).unwrap(),
            stderr: String::from_utf8(output.stderr).unwrap(),
        }
    }

    #[track_caller]
    fn exits(self, code: i32) -> Self {
        assert_eq!(self.code, code, "{}\n{}", self.stdout, self.stderr);
        self
    }

    /// The one JSON object on stdout, which begins with `schema_version`.
    #[track_caller]
    fn summary(&self) -> Value {
        let value: Value = serde_json::from_str(&self.stdout).unwrap();
        let first = value.as_object().unwrap().keys().next().unwrap();
        assert_eq!(first, "schema_version");
        value
    }

    /// Refused: code 2, silence on stdout, and all of `words` on stderr.
    #[track_caller]
    fn refused(self, words: &[&str]) {
        let run = self.exits(USAGE);
        assert_eq!(run.stdout, "");
        for word in words {
            assert!(run.stderr.contains(word), "no `{word}` in:\n{}", run.stderr);
        }
        assert!(
            run.stderr.len() < 4000,
            "{} bytes of error",
            run.stderr.len()
        );
    }
}

#[track_caller]
fn has_fields(summary: &Value, pointers: &[&str]) {
    for pointer in pointers {
        let value = summary.pointer(&format!("/{}", pointer.replace('.', "/")));
        assert!(value.is_some(), "no {pointer} in {summary:#}");
    }
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

const SOLVE_FILES: [&str; 9] = [
    "controls.csv",
    "end.npz",
    "feedback.npz",
    "iterations.csv",
    "multipliers.json",
    "report.html",
    "scene.toml",
    "summary.json",
    "trajectory.npz",
];

/// Of a solve that did not converge: no feedback around what is no solution.
const UNSOLVED_FILES: [&str; 8] = [
    "controls.csv",
    "end.npz",
    "iterations.csv",
    "multipliers.json",
    "report.html",
    "scene.toml",
    "summary.json",
    "trajectory.npz",
];

const SIMULATE_FILES: [&str; 6] = [
    "checkpoint.json",
    "end.npz",
    "report.html",
    "scene.toml",
    "summary.json",
    "trajectory.npz",
];

/// `check` says what a run would do, writes nothing, and talks on stderr only.
#[test]
fn check_reports_derived_figures() {
    let desk = Desk::new();
    let run = desk.run(&["check", "scene.toml"]).exits(DONE);
    assert_eq!(run.stdout, "");
    assert!(run.stderr.contains("stable below") && run.stderr.contains("the scene is valid"));
    let run = desk
        .run(&["check", "scene.toml", "--json", "--quiet"])
        .exits(DONE);
    assert_eq!(run.stderr, "");
    has_fields(
        &run.summary(),
        &[
            "command",
            "stable_step_s",
            "steps",
            "memory_bytes",
            "optimal_control.variables",
        ],
    );
    assert_eq!(names(desk.folder.path()), ["scene.toml"]);
}

/// The variables that `check` counts are those that `solve` names on its way and in its summary: 30 controls, and the three residuals of a
/// goal within a tolerance.
#[test]
fn variables_are_those_of_the_solver() {
    let desk = Desk::new();
    let within = ["--set", "task.tolerance_m=0.001"];
    let run = |verb: &str| {
        let run = desk.run(&[&[verb, "scene.toml", "--json"][..], &within].concat());
        let run = run.exits(DONE);
        (run.summary(), run.stderr)
    };
    let (checked, described) = run("check");
    let (solved, told) = run("solve");
    assert_eq!(checked["optimal_control"]["variables"], 33);
    assert_eq!(solved["variables"], 33);
    for words in [described, told] {
        assert!(words.contains("33 variables"), "{words}");
    }
}

/// A solve for an accuracy lists the iterations on all of its grids with the numbers of these, its page repeats them to the byte when it is
/// made from the files, and the legend of kinds on the terminal explains those of every grid.
#[test]
fn iterations_are_those_of_all_grids() {
    let desk = Desk::new();
    desk.write(
        "scene.toml",
        &SCENE.replace("elements = 4", "accuracy = 3e-3"),
    );
    let run = desk
        .run(&["solve", "scene.toml", "--out", "run", "--json"])
        .exits(DONE);
    let summary = run.summary();
    let levels = summary["accuracy"]["levels"].as_array().unwrap().len();
    assert!(levels > 1, "{:#}", summary["accuracy"]);
    let text = std::fs::read_to_string(desk.path("run/iterations.csv")).unwrap();
    let rows: Vec<Vec<&str>> = (text.lines())
        .map(|line| line.split(',').collect())
        .collect();
    let column = |name| rows[0].iter().position(|own| *own == name).unwrap();
    let (grid, iteration, kind) = (column("grid"), column("iteration"), column("kind"));
    let mut per_grid = vec![0; levels];
    for row in &rows[1..] {
        per_grid[row[grid].parse::<usize>().unwrap() - 1] += usize::from(row[iteration] != "0");
        for sign in row[kind].chars().filter(|sign| "gxclr+".contains(*sign)) {
            let words = format!("{sign} ");
            let legend = run
                .stderr
                .lines()
                .find(|line| line.contains("kind: "))
                .unwrap();
            assert!(legend.contains(&words), "{sign}: {legend}");
        }
    }
    assert!(per_grid.iter().all(|n| *n > 0), "{per_grid:?}");
    assert_eq!(summary["iterations"], per_grid[levels - 1]);
    let page = std::fs::read(desk.path("run/report.html")).unwrap();
    desk.run(&["report", "run"]).exits(DONE);
    assert!(std::fs::read(desk.path("run/report.html")).unwrap() == page);
    assert!(String::from_utf8_lossy(&page).contains("\"grid\":2"));
}

/// The predicted time of a solve is a range whose larger end grows where a limit adds rows, and the words say why.
#[test]
fn predicted_times_count_limits() {
    let desk = Desk::new();
    let predicted = || {
        let run = desk.run(&["check", "scene.toml", "--json"]).exits(DONE);
        let cost = run.summary()["solve_cost"].clone();
        let at = |key: &str, i: usize| cost[key][i].as_f64().unwrap();
        let iteration = cost["iteration_s"].as_f64().unwrap();
        let least = at("iterations", 0) * iteration + cost["check_s"].as_f64().unwrap();
        assert!((at("total_s", 0) - least).abs() < 1e-9 * least);
        let words: Vec<&str> = run.stderr.split_whitespace().collect();
        (at("iterations", 1), at("total_s", 1), words.join(" "))
    };
    let (iterations, seconds, words) = predicted();
    assert!(words.contains("half of random reaches"), "{words}");
    desk.write(
        "scene.toml",
        &format!("{SCENE}[[limit]]\ncurvature_max_1_m = 3.0\n"),
    );
    let (more, longer, words) = predicted();
    assert!(more > 2.0 * iterations && longer > 4.0 * seconds);
    assert!(words.contains("rows of obstacles and limits"), "{words}");
}

/// `simulate` writes its directory, and its summary holds every field of the contract.
#[test]
fn simulate_writes_its_directory() {
    let desk = Desk::new();
    let run = desk
        .run(&["simulate", "scene.toml", "--out", "run", "--json"])
        .exits(DONE);
    let summary = run.summary();
    has_fields(
        &summary,
        &[
            "command",
            "model",
            "strain",
            "elements",
            "step_s",
            "steps",
            "wall_s",
            "node_steps_per_s",
            "tip.position_m.2",
            "tip.orientation_wxyz.3",
            "energy_J.initial",
            "energy_J.final",
            "energy_J.min",
            "energy_J.max",
            "dilatation.min",
            "dilatation.max",
            "length_m.min",
            "length_m.max",
        ],
    );
    assert_eq!(summary["command"], "simulate");
    assert_eq!(names(&desk.path("run")), SIMULATE_FILES);
    let written = std::fs::read_to_string(desk.path("run/summary.json")).unwrap();
    assert_eq!(serde_json::from_str::<Value>(&written).unwrap(), summary);
}

/// `solve` certifies, its summary holds every field of the contract, and `verify` agrees; a control that was changed
/// afterwards is rejected by name.
#[test]
fn solve_and_verify() {
    let desk = Desk::new();
    let run = desk
        .run(&["solve", "scene.toml", "--out", "run", "--json"])
        .exits(DONE);
    let summary = run.summary();
    has_fields(
        &summary,
        &[
            "command",
            "status",
            "iterations",
            "objective",
            "wall_s",
            "phases_s.linearize",
            "phases_s.condense",
            "phases_s.qp",
            "phases_s.globalize",
            "phases_s.certify",
            "phases_s.feedback",
            "kkt.stationarity",
            "kkt.feasibility",
            "kkt.complementarity",
            "tip_error_m",
            "tip_speed_m_s",
            "check.same_grid_m",
            "check.refined_time_m",
            "check.refined_space_m",
            "check.verdict",
            "check.kkt_parts.0.worst.time_s",
            "check.momentum.over_rounding",
            "worst_constraints",
            "qp_backend",
            "hessian",
            "elements",
            "steps",
            "control_blocks",
            "variables",
        ],
    );
    assert_eq!(summary["status"], "converged");
    assert_eq!(summary["check"]["verdict"], "certified");
    assert_eq!(names(&desk.path("run")), SOLVE_FILES);
    let iterations = std::fs::read_to_string(desk.path("run/iterations.csv")).unwrap();
    assert_eq!(
        iterations.lines().count() as u64,
        summary["iterations"].as_u64().unwrap() + 2
    );

    let verified = desk.run(&["verify", "run", "--json"]).exits(DONE).summary();
    assert_eq!(verified["command"], "verify");
    assert_eq!(verified["check"]["verdict"], "certified");
    assert_eq!(verified["check"]["kkt"], summary["check"]["kkt"]);
    assert_eq!(
        verified["check"]["kkt_parts"],
        summary["check"]["kkt_parts"]
    );
    assert_eq!(verified["check"]["second_order"]["verdict"], "minimum");
    let growth = verified["check"]["growth"]["amplification"]
        .as_f64()
        .unwrap();
    assert!(growth > 0.5 && growth < 2.0, "{growth}");

    let path = desk.path("run/controls.csv");
    let controls = std::fs::read_to_string(&path).unwrap();
    let mut lines: Vec<String> = controls.lines().map(String::from).collect();
    assert_eq!(
        lines[0],
        "t_start,t_end,tip force x (N),tip force y (N),tip force z (N),tip moment x (N m),tip moment y (N m),tip moment z (N m)"
    );
    let mut cells: Vec<String> = lines[2].split(',').map(String::from).collect();
    let fx: f64 = cells[2].parse().unwrap();
    cells[2] = (1.01 * fx).to_string();
    lines[2] = cells.join(",");
    std::fs::write(&path, lines.join("\n") + "\n").unwrap();
    let run = desk.run(&["verify", "run", "--json"]).exits(REJECTED);
    assert!(run.stderr.contains("FAIL") && run.stderr.contains("rejected"));
    let rejected = run.summary();
    assert_eq!(rejected["check"]["verdict"], "rejected");
    let failed = rejected["check"]["failed"].as_array().unwrap();
    assert!(failed.contains(&"same_grid_m".into()), "{failed:?}");

    // Not numbers, and too few of them.
    std::fs::write(&path, controls.replacen(&lines[1], "a,b,c,d,e,f,g,h", 1)).unwrap();
    desk.run(&["verify", "run"]).refused(&["controls.csv"]);
    std::fs::write(&path, format!("{}\n{}\n", lines[0], lines[1])).unwrap();
    desk.run(&["verify", "run"])
        .refused(&["controls.csv", "1 rows", "5"]);
}

/// A nitinol wire by implicit steps of 900 times the explicit limit, and a soft arm with internal damping: solved, certified, and
/// verified from the files to the same conditions; a damping that was changed by 1 % afterwards is found.
#[test]
fn stiff_and_damped_arms_are_certified() {
    let desk = Desk::new();
    for (scene, settings, damping) in [
        (
            "wire-reach",
            &[
                "rod.elements=6",
                "time.step_s=2.5e-4",
                "task.at_rest=\"tip\"",
            ][..],
            "0.0002",
        ),
        (
            "scene.toml",
            &["damping.internal_s=0.01", "task.at_rest=\"tip\""],
            "0.01",
        ),
    ] {
        let out = scene.split('.').next().unwrap();
        let mut arguments = vec!["solve", scene, "--out", out, "--json"];
        arguments.extend(settings.iter().flat_map(|setting| ["--set", setting]));
        let summary = desk.run(&arguments).exits(DONE).summary();
        assert_eq!(summary["status"], "converged");
        assert_eq!(summary["check"]["verdict"], "certified");
        let verified = (desk.run(&["verify", out, "--quick", "--json"]).exits(DONE)).summary();
        assert!(verified["check"]["second_order"].is_null());
        assert_eq!(verified["check"]["kkt"], summary["check"]["kkt"]);

        let file = format!("{out}/scene.toml");
        let text = std::fs::read_to_string(desk.path(&file)).unwrap();
        let changed: f64 = 1.01 * damping.parse::<f64>().unwrap();
        let given = format!("internal_s = {damping}");
        assert_eq!(text.matches(&given).count(), 1, "{text}");
        desk.write(
            &file,
            &text.replace(&given, &format!("internal_s = {changed}")),
        );
        let rejected = desk
            .run(&["verify", out, "--json"])
            .exits(REJECTED)
            .summary();
        let failed = rejected["check"]["failed"].as_array().unwrap();
        for name in ["kkt.feasibility", "same_grid_m"] {
            assert!(failed.contains(&name.into()), "{failed:?}");
        }
    }
}

/// A directory that no solve wrote cannot be verified, and says so.
#[test]
fn foreign_directories_are_not_verified() {
    let desk = Desk::new();
    std::fs::create_dir(desk.path("notes")).unwrap();
    desk.write("notes/todo.txt", "eat");
    desk.run(&["verify", "notes"])
        .refused(&["notes", "not the result directory"]);
    desk.run(&["verify", "nowhere"]).refused(&["nowhere"]);
    desk.run(&["simulate", "scene.toml", "--out", "run"])
        .exits(DONE);
    desk.run(&["verify", "run"])
        .refused(&["not the result directory of a solve"]);
}

/// `example` lists and prints scenes that `check` accepts; `schema` is a JSON Schema.
#[test]
fn examples_and_schema() {
    let desk = Desk::new();
    let list = desk.run(&["example"]).exits(DONE).stdout;
    let summary = desk.run(&["example", "--json"]).exits(DONE).summary();
    let scenes = summary["scenes"].as_array().unwrap().clone();
    assert!(scenes.contains(&"reach".into()));
    for scene in &scenes {
        let name = scene.as_str().unwrap();
        assert!(list.contains(name));
        let text = desk.run(&["example", name]).exits(DONE).stdout;
        desk.write("printed.toml", &text);
        desk.run(&["check", "printed.toml"]).exits(DONE);
    }
    desk.run(&["example", "raech"]).refused(&["reach"]);
    let schema = desk.run(&["schema"]).exits(DONE).stdout;
    let schema: Value = serde_json::from_str(&schema).unwrap();
    assert!(schema["properties"]["rod"].is_object());
}

/// What is unknown is refused with the nearest that is known.
#[test]
fn unknown_words_get_a_suggestion() {
    let desk = Desk::new();
    desk.run(&["sovle", "scene.toml"]).refused(&["solve"]);
    desk.run(&["solve", "scene.toml", "--jsn"])
        .refused(&["--json"]);
    desk.run(&["check", "scene.toml", "--set", "rod.elments=4"])
        .refused(&["rod.elments", "elements"]);
    desk.run(&["check", "scene.toml", "--set", "rod.elements"])
        .refused(&["KEY=VALUE"]);
    desk.run(&["check", "scene.toml", "--threads", "0"])
        .refused(&["--threads"]);
    desk.run(&["check"]).refused(&["SCENE"]);
    desk.run(&[]).refused(&["Usage"]);
}

/// Scenes that are wrong, each in its way: refused with the key, the line and what was expected.
#[test]
fn wrong_scenes_are_refused() {
    let desk = Desk::new();
    let wrong = |from: &str, to: &str, words: &[&str]| {
        assert!(SCENE.contains(from));
        desk.write("wrong.toml", &SCENE.replace(from, to));
        for verb in ["check", "solve"] {
            desk.run(&[verb, "wrong.toml", "--json"]).refused(words);
        }
    };
    wrong(
        "radius_m",
        "raduis_m",
        &["raduis_m", "radius_m", "wrong.toml:9"],
    );
    wrong(
        "length_m = 1.0",
        "length_m = -1.0",
        &["rod.length_m", "wrong.toml:2", "positive"],
    );
    wrong(
        "end_s = 0.3",
        "end_s = nan",
        &["time.end_s", "wrong.toml:13"],
    );
    wrong(
        "end_s = 0.3",
        "end_s = 0.3\nstep_s = 0.1",
        &["time.step_s", "stable", "auto"],
    );
    wrong(
        "[0.1, 0.03, 0.985]",
        "[5.0, 0.0, 0.0]",
        &["task.position_m", "reach"],
    );
    wrong(
        "blocks = 5",
        "blocks = 0",
        &["control.blocks", "wrong.toml:18"],
    );
    wrong(
        "blocks = 5",
        "blocks = 5000",
        &["control.blocks", "5000 blocks"],
    );
    wrong(
        "[damping]",
        "[rod.stiffness]\nea_n = 1\nga_n = 1\nei_n_m2 = 1\ngj_n_m2 = 1\n[damping]",
        &["rod.stiffness", "rod.material"],
    );
    assert_eq!(names(desk.folder.path()), ["scene.toml", "wrong.toml"]);
}

/// Steps that a scene may have, but not without a word: implicit ones above the limit of a bent arm, and ones in which viscous
/// damping takes more than the momentum there is. `check` and `simulate` name the key, the figures and a step that serves,
/// the last number they say; with that step they are silent.
#[test]
fn doubtful_steps_are_warned_of() {
    let desk = Desk::new();
    let (scene, _) = SCENE.split_once("[task]").unwrap();
    desk.write("swing.toml", &scene.replace("0.3", "0.04"));
    let said = |settings: &[&str]| {
        let settings = settings.iter().flat_map(|setting| ["--set", setting]);
        let [check, simulate] = ["check", "simulate"].map(|verb| {
            let arguments: Vec<_> = [verb, "swing.toml"]
                .into_iter()
                .chain(settings.clone())
                .collect();
            let stderr = desk.run(&arguments).exits(DONE).stderr;
            let warnings = stderr.lines().filter(|line| line.starts_with("warning"));
            warnings.map(String::from).collect::<Vec<_>>()
        });
        assert_eq!(check, simulate);
        check.join("\n")
    };
    let implicit = "time.integrator=\"implicit\"";
    let heavy = "damping.viscous_1_s=1e4";
    for (setting, step, words) in [
        (
            implicit,
            "2e-2",
            ["time.step_s: 2.000e-2 s", "implicit", "bent", "auto"],
        ),
        (
            heavy,
            "5e-4",
            [
                "damping.viscous_1_s: 1.000e4 1/s",
                "5.000e-4 s",
                "5.000;",
                "sign",
            ],
        ),
    ] {
        let warning = said(&[setting, &format!("time.step_s={step}")]);
        for word in words {
            assert!(warning.contains(word), "no `{word}` in: {warning}");
        }
        let mut words = warning.rsplit([' ', ',']);
        let limit = words.find_map(|word| word.parse::<f64>().ok()).unwrap();
        assert!(limit < step.parse().unwrap(), "{warning}");
        assert_eq!(
            said(&[setting, &format!("time.step_s={}", 0.99 * limit)]),
            ""
        );
    }
    assert_eq!(said(&[implicit]), "");
}

/// Things that are not scenes at all.
#[test]
fn non_scenes_are_refused() {
    let desk = Desk::new();
    std::fs::create_dir(desk.path("folder")).unwrap();
    desk.run(&["check", "folder"])
        .refused(&["folder", "directory"]);
    desk.write("empty.toml", "");
    desk.run(&["check", "empty.toml"]).refused(&["empty"]);
    desk.run(&["check", "missing.toml"])
        .refused(&["missing.toml"]);
    let mut state = 1u64;
    let noise: Vec<u8> = (0..10_000_000)
        .map(|_| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 56) as u8
        })
        .collect();
    std::fs::write(desk.path("noise.toml"), noise).unwrap();
    desk.run(&["check", "noise.toml"]).refused(&["noise.toml"]);
}

/// A target that the bounded control cannot reach: code 4, the residual by its scene key, and the files.
#[test]
fn unreachable_target_is_infeasible() {
    let desk = Desk::new();
    let run = desk
        .run(&[
            "solve",
            "scene.toml",
            "--out",
            "run",
            "--json",
            "--set",
            "control.force_max_n=0.01",
            "--set",
            "control.moment_max_n_m=0.001",
        ])
        .exits(INFEASIBLE);
    assert!(run.stderr.contains("task.position_m"));
    let summary = run.summary();
    assert_eq!(summary["status"], "locally-infeasible");
    let worst = summary["worst_constraints"][0]["name"].as_str().unwrap();
    assert!(worst.starts_with("task.position_m"), "{worst}");
    assert_eq!(names(&desk.path("run")), UNSOLVED_FILES);
    // The prices of what cannot be met pull back: their signs are those of the residuals.
    for row in summary["worst_constraints"].as_array().unwrap() {
        let of = |key: &str| row[key].as_f64().unwrap();
        assert!(of("amount") * of("multiplier") > 0.0, "{row}");
        assert_eq!((of("node"), of("time_s")), (4.0, 0.3));
    }
}

/// The built-in reach past two obstacles: certified, and it leans on both; its report has their names, and the clearances come down to
/// the margins and not below.
#[test]
fn obstacles_are_touched_and_shown() {
    let desk = Desk::new();
    let run = desk.run(&["solve", "reach-obstacle", "--out", "run", "--json"]);
    assert_eq!(run.exits(DONE).summary()["check"]["verdict"], "certified");

    let text = |name: &str| std::fs::read_to_string(desk.path("run").join(name)).unwrap();
    let multipliers: Value = serde_json::from_str(&text("multipliers.json")).unwrap();
    let push = |constraint: usize| -> f64 {
        (multipliers["path"].as_array().unwrap().iter())
            .filter(|row| row["constraint"] == constraint)
            .map(|row| row["multiplier"].as_f64().unwrap())
            .sum()
    };
    assert!(push(0) > 0.01 && push(1) > 0.01, "{multipliers}");

    let page = text("report.html");
    let (_, rest) = page.split_once("type=\"application/json\">").unwrap();
    let (json, _) = rest.split_once("</script>").unwrap();
    let data: Value = serde_json::from_str(json).unwrap();
    let bodies = data["obstacles"]["bodies"].as_array().unwrap();
    let rows = data["obstacles"]["t"].as_array().unwrap().len();
    for (body, (name, kind)) in (bodies.iter()).zip([("ball", "sphere"), ("beam", "capsule")]) {
        assert_eq!(
            (&body["name"], &body["shape"]["kind"]),
            (&name.into(), &kind.into())
        );
        let clearance = body["clearance"].as_array().unwrap();
        assert_eq!(clearance.len(), rows);
        let least = (clearance.iter().map(|c| c.as_f64().unwrap())).fold(f64::INFINITY, f64::min);
        let beyond = least - body["margin"].as_f64().unwrap();
        // Single precision below, and above at most the motion between two rows.
        assert!((-1e-7..1e-3).contains(&beyond), "{name}: {beyond}");
    }
    assert_eq!(bodies.len(), 2);
}

/// A free duration: found, said, kept in the scene of the result, verified from the files, and taken up again by a solve from them.
#[test]
fn a_free_duration_is_found_and_verified() {
    let desk = Desk::new();
    let scene = (SCENE.replace("elements = 4", "elements = 8"))
        .replace("hold = \"constant\"", "hold = \"linear\"")
        .replace("at_rest = false", "at_rest = \"tip\"");
    let free = "[task.free_duration]\nshortest_s = 0.2\nlongest_s = 0.6\nprice = 1.0\n";
    desk.write("scene.toml", &(scene + free));
    let run = desk.run(&["solve", "scene.toml", "--out", "run", "--json"]);
    let summary = run.exits(DONE).summary();
    let duration = summary["duration_s"].as_f64().unwrap();
    assert!(
        (0.2..0.6).contains(&duration) && duration != 0.3,
        "{duration}"
    );
    let steps = summary["steps"].as_f64().unwrap();
    assert!((steps * summary["step_s"].as_f64().unwrap() / duration - 1.0).abs() < 1e-12);

    desk.run(&["verify", "run"]).exits(DONE);
    let dearer = desk.run(&[
        "verify",
        "run",
        "--json",
        "--set",
        "task.free_duration.price=2.0",
    ]);
    let failed = dearer.exits(REJECTED).summary()["check"]["failed"].clone();
    // The price is part of the objective in the summary as well.
    assert_eq!(failed, serde_json::json!(["duration", "summary.json"]));

    let again = desk.run(&[
        "solve",
        "scene.toml",
        "--from",
        "run",
        "--out",
        "again",
        "--json",
    ]);
    let summary = again.exits(DONE).summary();
    assert!(summary["iterations"].as_u64().unwrap() <= 3, "{summary}");
    let other = summary["duration_s"].as_f64().unwrap();
    assert!(
        (other / duration - 1.0).abs() < 1e-6,
        "{other} and {duration}"
    );
}

/// A ball in the plane of the reach: a solver that does not see their curvature stops at one, and neither `solve` nor `verify` certifies it.
#[test]
fn saddles_are_rejected() {
    let desk = Desk::new();
    let scene = (SCENE.replace("elements = 4", "elements = 8"))
        .replace("end_s = 0.3", "end_s = 0.8")
        .replace("[0.1, 0.03, 0.985]", "[0.5, 0.0, 0.8]")
        .replace(
            "at_rest = false",
            "at_rest = \"tip\"\ntolerance_m_s = 0\ntolerance_rad_s = 0",
        )
        .replace("blocks = 5", "blocks = 10");
    let ball = "[[obstacle]]\nname = \"ball\"\nsphere = { center_m = [0.25, 0.0, 1.03], radius_m = 0.05 }\nmargin_m = 0.001\n";
    desk.write("saddle.toml", &format!("{scene}{ball}"));
    let stay = [
        "solve",
        "saddle.toml",
        "--out",
        "run",
        "--set",
        "solver.hessian='gauss-newton'",
    ];
    let run = desk.run(&stay).exits(REJECTED);
    assert!(run.stderr.contains("not a minimum"), "{}", run.stderr);
    let run = desk.run(&["verify", "run", "--json"]).exits(REJECTED);
    let check = &run.summary()["check"];
    assert_eq!(check["failed"], serde_json::json!(["second_order"]));
    assert_eq!(check["second_order"]["verdict"], "not a minimum");
}

/// A force that cannot hold the arm at its target: locally infeasible, and the static force that it takes is said beside the bound, on the
/// terminal and in the summary; a solve that is certified has no advice.
#[test]
fn failures_come_with_advice() {
    let desk = Desk::new();
    let weak = [
        "solve",
        "scene.toml",
        "--json",
        "--set",
        "task.at_rest=\"tip\"",
        "--set",
        "control.moment_max_n_m=0",
        "--set",
        "control.force_max_n=0.5",
    ];
    let run = desk.run(&weak).exits(INFEASIBLE);
    assert!(run.stderr.contains("holding the tip at the target takes"));
    let summary = run.summary();
    let advice = summary["advice"].as_array().unwrap();
    assert!(
        advice[0].as_str().unwrap().contains("bound of 5.000e-1 N"),
        "{advice:?}"
    );
    let run = desk
        .run(&["solve", "scene.toml", "--json", "--out", "strong"])
        .exits(DONE);
    assert_eq!(run.summary()["advice"], serde_json::json!([]));
}

/// No time: code 6; one iteration: code 3; either way the best point is written.
#[test]
fn limits_stop_with_files() {
    let desk = Desk::new();
    for (setting, code, status) in [
        ("solver.deadline_s=1e-9", STOPPED, "deadline"),
        ("solver.max_iterations=1", NOT_CONVERGED, "iteration-limit"),
    ] {
        let run = desk
            .run(&[
                "solve",
                "scene.toml",
                "--out",
                status,
                "--json",
                "--set",
                setting,
            ])
            .exits(code);
        assert_eq!(run.summary()["status"], status);
        // Without a check the end of the motion is not known.
        let is_checked = status != "deadline";
        let files = UNSOLVED_FILES
            .iter()
            .filter(|name| is_checked || **name != "end.npz");
        assert_eq!(
            names(&desk.path(status)),
            files.copied().collect::<Vec<_>>()
        );
        // What was not solved is not certified.
        desk.run(&["verify", status]).exits(REJECTED);
    }
}

/// A directory with somebody's files is refused as a target and stays as it was; an earlier result is replaced.
#[test]
fn foreign_targets_are_refused() {
    let desk = Desk::new();
    std::fs::create_dir(desk.path("thesis")).unwrap();
    desk.write("thesis/chapter.tex", "words");
    for verb in ["solve", "simulate"] {
        desk.run(&[verb, "scene.toml", "--out", "thesis"])
            .refused(&["thesis"]);
    }
    assert_eq!(names(&desk.path("thesis")), ["chapter.tex"]);
    assert_eq!(
        std::fs::read_to_string(desk.path("thesis/chapter.tex")).unwrap(),
        "words"
    );
    for _ in 0..2 {
        desk.run(&["simulate", "scene.toml", "--out", "run"])
            .exits(DONE);
    }
    assert_eq!(names(desk.folder.path()), ["run", "scene.toml", "thesis"]);
}

/// The resolved scene is the same problem: its solution has the same objective to the bit. The number of threads
/// changes no byte of controls and trajectory.
#[test]
fn results_are_reproducible() {
    let desk = Desk::new();
    let solve = |scene: &str, out: &str, threads: &str| {
        desk.run(&["solve", scene, "--out", out, "--json", "--threads", threads])
            .exits(DONE)
            .summary()
    };
    let first = solve("scene.toml", "one", "1");
    let second = solve("scene.toml", "two", "2");
    let again = solve("one/scene.toml", "again", "1");
    for other in [&second, &again] {
        for field in [
            "objective",
            "iterations",
            "kkt",
            "multipliers",
            "steps",
            "step_s",
        ] {
            assert_eq!(first[field], other[field], "{field}");
        }
    }
    let bytes = |name: &str| std::fs::read(desk.path(name)).unwrap();
    for file in ["controls.csv", "trajectory.npz"] {
        for other in ["two", "again"] {
            assert!(
                bytes(&format!("one/{file}")) == bytes(&format!("{other}/{file}")),
                "{other}/{file}"
            );
        }
    }
    assert_eq!(bytes("one/scene.toml"), bytes("again/scene.toml"));
}

/// A load that tears the arm apart: code 5, with node, step and time; what was computed until then is written. A solve
/// has nothing to write.
#[test]
fn breakdown_is_located() {
    let desk = Desk::new();
    let load = "[[load]]\nnode = \"tip\"\nforce_n = [1e6, 0, 0]\nmoment_n_m = [0, 1e5, 0]\n";
    desk.write("wild.toml", &format!("{SCENE}{load}"));
    desk.write(
        "late.toml",
        &format!("{SCENE}{load}profile = [[0.0, 0.0], [0.1, 0.0], [0.2, 1.0]]\n"),
    );
    for (scene, words) in [
        ("wild.toml", ["node 4", "step 0", "t = 0 s"]),
        ("late.toml", ["node 4", "step ", "t = 0.1"]),
    ] {
        let run = desk
            .run(&["simulate", scene, "--out", "run", "--json"])
            .exits(NUMERICAL);
        let summary = run.summary();
        assert_eq!(summary["status"], "failed");
        let error = summary["error"].as_str().unwrap();
        for word in words {
            assert!(error.contains(word) && run.stderr.contains(word), "{error}");
        }
        // Nothing continues it.
        let files: Vec<&str> = SIMULATE_FILES[2..].to_vec();
        assert_eq!(names(&desk.path("run")), files);
        let record = motion(&desk.path("run"));
        assert_eq!(
            record.n_rows() as u64,
            summary["steps"].as_u64().unwrap() + 1
        );
        desk.run(&["simulate", scene, "--out", "run", "--resume"])
            .refused(&["checkpoint", "without --resume"]);
    }
    assert_eq!(
        names(desk.folder.path()),
        ["late.toml", "run", "scene.toml", "wild.toml"]
    );
    desk.run(&["solve", "wild.toml", "--out", "solve"])
        .exits(NUMERICAL);
}

fn motion(folder: &Path) -> softarm::output::MotionRecord {
    softarm::output::MotionRecord::read_npz(&folder.join("trajectory.npz")).unwrap()
}

/// Minutes of computing, if one lets it; loads with profiles and both frames, gravity, damping, and diagnostics.
const LONG: &str = "\
[rod]
length_m = 1.0
elements = 12
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.05
[gravity]
acceleration_m_s2 = [0.0, 1.0, -3.0]
[damping]
viscous_1_s = 0.3
[[load]]
node = \"tip\"
force_n = [1.0, 0.5, 0.0]
moment_n_m = [0.0, 0.1, 0.2]
profile = [[0.0, 0.0], [1.0, 1.0], [7.0, -0.5], [50.0, 1.0]]
[[load]]
node = 5
force_n = [0.3, 0.0, 0.1]
frame = \"body\"
[time]
end_s = 1e5
[output]
rate_hz = 2.0
diagnostics = true
";

/// The summary without what the clock and the folder say.
fn timeless(mut summary: Value) -> Value {
    let fields = summary.as_object_mut().unwrap();
    for field in ["wall_s", "node_steps_per_s", "directory", "scene"] {
        fields.remove(field).unwrap();
    }
    summary
}

#[track_caller]
fn same_result(desk: &Desk, one: &str, other: &str) {
    let read = |folder: &str, name: &str| std::fs::read(desk.path(folder).join(name)).unwrap();
    for name in [
        "trajectory.npz",
        "diagnostics.npz",
        "scene.toml",
        "checkpoint.json",
    ] {
        assert!(read(one, name) == read(other, name), "{name} differs");
    }
    let summary = |folder| timeless(serde_json::from_slice(&read(folder, "summary.json")).unwrap());
    assert_eq!(summary(one), summary(other));
}

impl Desk {
    /// Starts the tool and waits until `ready`.
    fn spawn(&self, arguments: &[&str], ready: impl Fn() -> bool) -> std::process::Child {
        let mut child = Command::new(env!("CARGO_BIN_EXE_softarm"))
            .args(arguments)
            .current_dir(self.folder.path())
            .stdout(std::process::Stdio::null())
            .stderr(std::process::Stdio::null())
            .spawn()
            .unwrap();
        let started = std::time::Instant::now();
        while !ready() {
            if started.elapsed() > tool::HANGS || child.try_wait().unwrap().is_some() {
                let _ = child.kill();
                panic!("ended, or never ready: {arguments:?}");
            }
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        child
    }

    /// Steps in the checkpoint of a run that is on its way; 0 before there is one.
    fn running_step(&self, out: &str) -> u64 {
        std::fs::read_to_string(self.path(&format!(".{out}.running/checkpoint.json")))
            .ok()
            .and_then(|text| serde_json::from_str::<Value>(&text).ok())
            .map_or(0, |checkpoint| checkpoint["step"].as_u64().unwrap())
    }
}

/// A run that is interrupted by Ctrl-C, resumed, killed, and resumed again ends with the same bytes as one that was left
/// alone. The interrupted one exits with 6 and a result of its own.
#[cfg(unix)]
#[test]
fn resumed_runs_are_the_same_to_the_bit() {
    const STEP: f64 = 1.0 / 1024.0;
    let desk = Desk::new();
    desk.write(
        "long.toml",
        &LONG.replace("1e5", &format!("1e5\nstep_s = {STEP}")),
    );
    let simulate = ["simulate", "long.toml", "--out", "parts"];
    let resume = ["simulate", "long.toml", "--out", "parts", "--resume"];
    let running = desk.path(".parts.running/checkpoint.json");
    let mut child = desk.spawn(&simulate, || running.exists());
    let interrupt = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status()
        .unwrap();
    assert!(interrupt.success());
    assert_eq!(child.wait().unwrap().code(), Some(STOPPED));
    let summary = std::fs::read(desk.path("parts/summary.json")).unwrap();
    let summary: Value = serde_json::from_slice(&summary).unwrap();
    assert_eq!(summary["status"], "interrupted");
    let interrupted_at = summary["steps"].as_u64().unwrap();
    assert!(!running.exists());

    // Killed after it has got on: the result of the interruption still stands, the rest is in the hidden folder.
    let mut child = desk.spawn(&resume, || desk.running_step("parts") > interrupted_at);
    child.kill().unwrap();
    assert_eq!(child.wait().unwrap().code(), None);
    let killed_at = desk.running_step("parts");
    assert!(desk.path("parts/trajectory.npz").exists());

    let end = format!("time.end_s={}", (killed_at + 5000) as f64 * STEP);
    let run = desk
        .run(&[&resume[..], &["--set", &end]].concat())
        .exits(DONE);
    assert!(
        run.stderr.contains(&format!("step {killed_at} of")),
        "{}",
        run.stderr
    );
    desk.run(&["simulate", "long.toml", "--out", "whole", "--set", &end])
        .exits(DONE);
    same_result(&desk, "whole", "parts");
    assert_eq!(
        names(desk.folder.path()),
        ["long.toml", "parts", "scene.toml", "whole"]
    );
}

/// A finished run goes on to a later end, with the bytes of one that was that long from the start, though its last checkpoint
/// is some steps back. A changed scene, an end between two steps, an end before the checkpoint and a directory without one
/// are refused, and nothing is touched.
#[test]
fn finished_runs_can_be_extended() {
    let desk = Desk::new();
    let base = LONG.replace("1e5", "0.501").replace("2.0", "200.0");
    desk.write("short.toml", &base);
    // 100.85 rows: the last row of the short run is not one of the long run.
    let set = [
        "--set",
        "output.rate_hz=201.3",
        "--set",
        "time.step_s=1e-3",
        "--set",
        "rod.model=consistent",
    ];
    let run = |out: &str, more: &[&str]| {
        let mut arguments = vec!["simulate", "short.toml", "--out", out];
        arguments.extend(set);
        arguments.extend(more);
        desk.run(&arguments)
    };
    run("parts", &[]).exits(DONE);
    let before = std::fs::read(desk.path("parts/summary.json")).unwrap();
    run("parts", &["--resume", "--set", "rod.elements=11"]).refused(&[
        "elements = 11",
        "elements = 12",
        "without --resume",
    ]);
    run("parts", &["--resume", "--set", "time.end_s=0.7505"])
        .refused(&["time.end_s", "whole number"]);
    run("parts", &["--resume", "--set", "time.end_s=0.25"]).refused(&[
        "time.end_s",
        "0.25 s",
        "before the 0.256 s",
    ]);
    run("nowhere", &["--resume"]).refused(&["nowhere", "checkpoint", "without --resume"]);
    assert_eq!(
        std::fs::read(desk.path("parts/summary.json")).unwrap(),
        before
    );
    assert_eq!(
        names(desk.folder.path()),
        ["parts", "scene.toml", "short.toml"]
    );

    run("parts", &["--resume", "--set", "time.end_s=1.002"]).exits(DONE);
    run("whole", &["--set", "time.end_s=1.002"]).exits(DONE);
    same_result(&desk, "whole", "parts");
}

/// Diagnostics are written when they are asked for, with as many rows as the trajectory; `check` says how much a
/// simulation writes and warns when it is more than a gigabyte.
#[test]
fn output_is_what_was_asked_for() {
    let desk = Desk::new();
    desk.write(
        "short.toml",
        &LONG.replace("1e5", "0.5").replace("2.0", "200.0"),
    );
    let summary = desk
        .run(&["check", "short.toml", "--json"])
        .exits(DONE)
        .summary();
    // Row: time, 13 nodes of 12 numbers, 9 of the tip and the energy, 12 dilatations; and diagnostics with time, 12
    // elements of 12 numbers, 8 vectors, volume and 4 powers.
    let row = 8 * ((1 + 13 * 12 + 9 + 12) + (1 + 12 * 12 + 8 * 3 + 1 + 4));
    let rows = summary["output"]["rows"].as_u64().unwrap();
    assert_eq!(summary["output"]["bytes"].as_u64().unwrap(), rows * row);
    desk.run(&["simulate", "short.toml", "--out", "run"])
        .exits(DONE);
    assert_eq!(motion(&desk.path("run")).n_rows() as u64, rows);
    assert!(desk.path("run/diagnostics.npz").exists());
    // Resuming what is finished, with a step that the tool chose, changes nothing.
    desk.run(&["simulate", "short.toml", "--out", "again"])
        .exits(DONE);
    desk.run(&["simulate", "short.toml", "--out", "run", "--resume"])
        .exits(DONE);
    same_result(&desk, "run", "again");
    desk.run(&[
        "simulate",
        "short.toml",
        "--out",
        "run",
        "--set",
        "output.diagnostics=false",
    ])
    .exits(DONE);
    assert_eq!(names(&desk.path("run")), SIMULATE_FILES);

    let run = desk
        .run(&["check", "short.toml", "--set", "time.end_s=1e5"])
        .exits(DONE);
    assert!(
        run.stderr.contains("GB") && run.stderr.contains("output.rate_hz"),
        "{}",
        run.stderr
    );
}
