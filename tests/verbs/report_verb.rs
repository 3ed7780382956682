//! `softarm report`: pages that are made anew from the files of a result, pages that compare several, what they say, and what is refused.

#![cfg(feature = "cli")]

use crate::tool;

use std::fs;
use std::path::PathBuf;
use std::process::Command;

use serde_json::Value;
use tempfile::TempDir;
use tool::{DONE, SCENE, UNWRITTEN, USAGE};

/// A loop of a fifth of a second, with a disturbance that the controller does not know.
const LOOP: &str = "\
[rod]
length_m = 1.0
elements = 6
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.05
[damping]
viscous_1_s = 1.0
[time]
end_s = 0.2
[control]
force_max_n = 20.0
[[objective.track]]
weight = 3e4
circle = { center_m = [0.0, 0.0, 0.98], radius_m = 0.15, turn_s = 2.0, from_m = [0.0, 0.0, 1.0], ramp_s = 1.0 }
[mpc]
period_s = 0.02
horizon_s = 0.2
computing = \"fixed\"
counted_from_s = 0.1
[plant]
elements = 8
[sensor]
preset = \"mocap\"
[estimator]
kind = \"kalman\"
disturbances = [\"tip_force\"]
";

/// An arm that hangs to the side and sags, with a load that ends.
const SAG: &str = "\
[rod]
length_m = 1.0
elements = 5
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.05
[base]
direction = [1.0, 0.0, 0.0]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[[load]]
node = \"tip\"
force_n = [0.0, 3.0, 4.0]
profile = [[0.0, 1.0], [0.1, 1.0]]
[time]
end_s = 0.3
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
        for (name, text) in [("solve", SCENE), ("loop", LOOP), ("sag", SAG)] {
            fs::write(folder.path().join(format!("{name}.toml")), text).unwrap();
        }
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn read(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap()
    }

    fn run(&self, arguments: &[&str]) -> Run {
        let output = Command::new(env!("CARGO_BIN_EXE_softarm"))
            .args(arguments)
            .current_dir(self.folder.path())
            .env("NO_COLOR", "1")
            .output()
            .unwrap();
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        let run = Run {
            code: output.status.code().unwrap(),
            stdout: text(&output.stdout),
            stderr: text(&output.stderr),
        };
        assert!(!run.stderr.contains("panicked"), "{}", run.stderr);
        run
    }

    #[track_caller]
    fn done(&self, arguments: &[&str]) -> Run {
        let run = self.run(arguments);
        assert_eq!(run.code, DONE, "{arguments:?}: {}", run.stderr);
        run
    }

    #[track_caller]
    fn refused(&self, arguments: &[&str], code: i32, words: &[&str]) {
        let run = self.run(arguments);
        assert_eq!(run.code, code, "{arguments:?}: {}", run.stderr);
        for word in words {
            assert!(run.stderr.contains(word), "no `{word}` in: {}", run.stderr);
        }
    }

    /// The data that a page draws.
    fn data(&self, page: &str) -> Value {
        let page = self.read(page);
        let (_, rest) = page.split_once("type=\"application/json\">").unwrap();
        let (json, _) = rest.split_once("</script>").unwrap();
        serde_json::from_str(json).unwrap()
    }
}

fn numbers(value: &Value) -> Vec<f64> {
    let items = value.as_array().unwrap().iter();
    items.map(|v| v.as_f64().unwrap()).collect()
}

/// The page of a solve, of simulations with and without diagnostics, and of a closed loop, made of their files alone, are those of the
/// runs, to the byte: whatever a page says, the files say too.
#[test]
fn pages_from_files_are_those_of_the_run() {
    let desk = Desk::new();
    let linear = ["--set", "control.hold=\"linear\""];
    let cubic = ["--set", "control.hold=\"cubic\""];
    let diagnostics = ["--set", "output.diagnostics=true"];
    let runs: [(&str, &str, &str, &[&str]); 8] = [
        ("solve", "solve.toml", "held", &[]),
        ("solve", "solve.toml", "linear", &linear),
        ("solve", "solve.toml", "cubic", &cubic),
        ("simulate", "sag.toml", "sag", &[]),
        ("simulate", "sag.toml", "diagnosed", &diagnostics),
        (
            "simulate",
            "sag.toml",
            "rows",
            &["--set", "output.rate_hz=50"],
        ),
        ("mpc", "loop.toml", "loop", &["--baselines"]),
        ("equilibrium", "sag.toml", "rests", &["--to", "2"]),
    ];
    for (verb, scene, out, more) in runs {
        desk.done(&[&[verb, scene, "--out", out, "--quiet"], more].concat());
        let page = format!("{out}/report.html");
        let before = desk.read(&page);
        fs::remove_file(desk.path(&page)).unwrap();
        desk.done(&["report", out]);
        assert!(before == desk.read(&page), "{out} differs");
        // And once more over a page that is there, to a place of one's own too.
        desk.done(&["report", out]);
        desk.done(&["report", out, "--out", "elsewhere.html"]);
        assert!(before == desk.read("elsewhere.html"), "{out} differs");
        let left: Vec<_> = (fs::read_dir(desk.path(out)).unwrap())
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .filter(|name| name.starts_with('.'))
            .collect();
        assert!(left.is_empty(), "{left:?}");
    }
}

/// The first lines of a page: what moved where, with which largest force of `controls.csv`, the verdict, and the error of the check. The
/// arm and what acts on it stand beside.
#[test]
fn a_page_begins_with_what_happened() {
    let desk = Desk::new();
    desk.done(&["solve", "solve.toml", "--out", "run", "--quiet"]);
    let data = desk.data("run/report.html");
    let lead = data["lead"].as_str().unwrap();
    let mut table = csv::Reader::from_path(desk.path("run/controls.csv")).unwrap();
    let mut largest: f64 = 0.0;
    for row in table.records() {
        let row = row.unwrap();
        let part = |i: usize| row[i].parse::<f64>().unwrap();
        largest = largest.max((part(2).powi(2) + part(3).powi(2) + part(4).powi(2)).sqrt());
    }
    let force = softarm::output::figure(largest, 3);
    let begins = "The tip goes from (0, 0, 1) to (0.1, 0.03, 0.985) m in 0.3 s with at most";
    assert!(
        lead.starts_with(&format!("{begins} {force} N and ")),
        "{lead}"
    );
    assert!(
        lead.contains("; certified, and on finer grids it ends ")
            && lead.contains(" from its target; 4 elements; computed in "),
        "{lead}"
    );
    assert!(
        data["trust"]
            .as_str()
            .unwrap()
            .contains("criteria of the check hold")
    );
    let control = (data["arrows"].as_array().unwrap().iter())
        .find(|arrow| arrow["name"] == "control" && arrow["kind"] == "force")
        .unwrap();
    assert_eq!(control["peak"].as_f64().unwrap(), largest);
    assert_eq!(control["node"], 4);
    let label = |list: &str, label: &str| {
        let pairs = data[list].as_array().unwrap();
        let pair = pairs.iter().find(|pair| pair[0] == label);
        pair.unwrap_or_else(|| panic!("no {label}"))[1]
            .as_str()
            .unwrap()
            .to_string()
    };
    assert_eq!(label("arm_facts", "length"), "1 m");
    assert_eq!(
        label("arm_facts", "discretized by"),
        "4 elements, helical, model standard"
    );
    assert_eq!(
        label("acting", "control at the tip"),
        "force up to 20 N, moment up to 5 N·m"
    );
    assert_eq!(label("acting", "damping"), "viscous 1 1/s");

    desk.done(&["simulate", "sag.toml", "--out", "sag", "--quiet"]);
    let data = desk.data("sag/report.html");
    let lead = data["lead"].as_str().unwrap();
    assert!(
        lead.contains("under its weight and a force of 5 N; completed"),
        "{lead}"
    );
    let arrows = data["arrows"].as_array().unwrap();
    let of = |name: &str| arrows.iter().find(|arrow| arrow["name"] == name).unwrap();
    assert_eq!(of("load")["peak"], 5.0);
    assert_eq!(numbers(&of("load")["vectors"][0]), [0.0, 3.0, 4.0]);
    let last = of("load")["vectors"].as_array().unwrap().last().unwrap();
    assert_eq!(numbers(last), [0.0; 3]);
    // Mass times gravity.
    let weight = numbers(&of("weight")["vectors"][0])[2];
    let mass = 1000.0 * std::f64::consts::PI * 0.05_f64.powi(2);
    assert!(
        (weight + 9.81 * mass).abs() < 1e-5 * 9.81 * mass,
        "{weight}"
    );
}

/// The images over arc length and time have the extremes that the check finds by code of its own: every time step of a short motion is a
/// frame. What is zero throughout has no image.
#[test]
fn images_have_the_extremes_of_the_check() {
    let desk = Desk::new();
    // A load twists the arm, which the optimum of the scene does not.
    let twisted = "load=[{ node = \"tip\", moment_n_m = [0.0, 0.0, 0.05], frame = \"body\", profile = [[0.0, 0.0], [0.2, 1.0]] }]";
    desk.done(&[
        "solve",
        "solve.toml",
        "--out",
        "run",
        "--quiet",
        "--set",
        twisted,
    ]);
    let summary: Value = serde_json::from_str(&desk.read("run/summary.json")).unwrap();
    let steps = summary["steps"].as_u64().unwrap();
    assert!(steps < 240, "{steps}");
    let strains = &summary["check"]["strains"];
    let data = desk.data("run/report.html");
    let fields = data["fields"]["fields"].as_array().unwrap();
    let of = |name: &str| fields.iter().find(|field| field["name"] == name).unwrap();
    let number = |value: &Value| value.as_f64().unwrap();
    let close = |a: f64, b: f64| assert!((a - b).abs() <= 1e-6 * b.abs().max(1e-3), "{a} {b}");
    close(
        number(&of("bending curvature")["high"]),
        number(&strains["curvature_1_m"]),
    );
    close(number(&of("twist")["high"]), number(&strains["twist_1_m"]));
    let [least, most] = [0, 1].map(|i| number(&strains["stretch"][i]));
    close(
        number(&of("stretch")["high"]) - 1.0,
        (most - 1.0).max(1.0 - least),
    );
    let codes = of("speed")["codes"].as_array().unwrap();
    assert_eq!(codes.len() as u64, steps + 1);
    // The base is clamped, and speeds are those of nodes.
    assert!(
        codes
            .iter()
            .all(|row| row[0] == 0 && row.as_array().unwrap().len() == 5)
    );

    // A planar motion does not twist.
    let plane = [
        "--set",
        "load=[{ node = \"tip\", force_n = [0.0, 0.0, 4.0] }]",
    ];
    desk.done(
        &[
            &["simulate", "sag.toml", "--out", "plane", "--quiet"],
            &plane[..],
        ]
        .concat(),
    );
    let data = desk.data("plane/report.html");
    let names: Vec<&Value> = (data["fields"]["fields"].as_array().unwrap().iter())
        .map(|field| &field["name"])
        .collect();
    assert!(
        names.iter().any(|name| *name == "internal moment"),
        "{names:?}"
    );
    assert!(!names.iter().any(|name| *name == "twist"), "{names:?}");
}

/// The page of a loop has the tip beside its reference, estimates with bands, other laws as bars of their errors in the summary, the sensors, and in which figures the
/// arm is not the controller's model.
#[test]
fn the_page_of_a_loop_says_what_it_knows() {
    let desk = Desk::new();
    let set = [
        "--set",
        "plant.actuator.delay_s=0.02",
        "--set",
        "mpc.actuator_delay_s=0.01",
    ];
    let run = ["mpc", "loop.toml", "--out", "loop", "--baselines", "--json"];
    let run = desk.done(&[&run[..], &set].concat());
    let summary: Value = serde_json::from_str(&run.stdout).unwrap();
    let data = desk.data("loop/report.html");
    let list = |key: &str| data[key].as_array().unwrap().clone();
    let mut samples = csv::Reader::from_path(desk.path("loop/samples.csv")).unwrap();
    let heads = samples.headers().unwrap().clone();
    let rows: Vec<csv::StringRecord> = samples.records().map(Result::unwrap).collect();
    let column = |name: &str| -> Vec<f64> {
        let at = heads.iter().position(|head| head == name).unwrap();
        rows.iter().map(|row| row[at].parse().unwrap()).collect()
    };
    let charts = list("charts");
    let chart = |title: &str| charts.iter().find(|chart| chart["title"] == title).unwrap();
    let tip = &chart("Tip beside its reference, x")["series"];
    assert_eq!(numbers(&tip[0]["y"]), column("tip_x"));
    assert_eq!(numbers(&tip[1]["y"]), column("reference_x"));
    assert!(tip[1]["dashed"] == true && tip[0]["dashed"] == false);
    let force = &chart("Estimated force on the tip")["series"];
    assert_eq!(numbers(&force[0]["band"]), column("deviation_tip_fx"));
    let bars = &list("bars")[0]["bars"];
    let laws = summary["baselines"].as_object().unwrap();
    assert_eq!(bars.as_array().unwrap().len(), 1 + laws.len());
    for (name, law) in laws {
        let name = name.replace('_', " ");
        let bar = (bars.as_array().unwrap().iter()).find(|bar| bar[0] == *name);
        let rms = law["tip_error_over_length"]["rms"].as_f64();
        let shown = bar.unwrap_or_else(|| panic!("no {name}"))[1].as_f64();
        assert_eq!(shown, rms.map(|part| 100.0 * part), "{name}");
    }
    let tables = list("tables");
    let [sensors, plant] = &tables[..] else {
        panic!("{tables:?}")
    };
    assert_eq!(sensors["rows"].as_array().unwrap().len(), 2);
    assert!(
        sensors["rows"][1][1]
            .as_str()
            .unwrap()
            .ends_with("tip force")
    );
    let names: Vec<&Value> = (plant["rows"].as_array().unwrap().iter())
        .map(|row| &row[0])
        .collect();
    assert_eq!(names, ["discretized by", "delay of commands"]);
    assert_eq!(
        list("advice").len(),
        summary["advice"].as_array().map_or(0, Vec::len)
    );
}

/// The page of statics: its clock is the load factor, the loads at its frames are so many times those of the scene, and its figures are those of the tables beside it;
/// a load factor of 1 has the shape of `initial.shape = "equilibrium"`.
#[test]
fn the_page_of_statics_is_over_the_load_factor() {
    let desk = Desk::new();
    let run = ["equilibrium", "sag.toml", "--out", "rests", "--json"];
    let run = desk.done(&[&run[..], &["--to", "2", "--points", "4"]].concat());
    let summary: Value = serde_json::from_str(&run.stdout).unwrap();
    let data = desk.data("rests/report.html");
    assert_eq!(data["clock"]["name"], "load factor");
    // 0, 2/3, 4/3 and 2, and 1 in any case.
    let factors = [0.0, 2.0 / 3.0, 1.0, 4.0 / 3.0, 2.0];
    assert_eq!(numbers(&data["motion"]["t"]), factors);
    let arrows = data["arrows"].as_array().unwrap();
    let of = |name: &str| arrows.iter().find(|arrow| arrow["name"] == name).unwrap();
    let mass = 1000.0 * std::f64::consts::PI * 0.05_f64.powi(2);
    for (frame, factor) in factors.into_iter().enumerate() {
        let load = numbers(&of("load")["vectors"][frame]);
        for (part, whole) in load.iter().zip([0.0, 3.0, 4.0]) {
            assert!((part - factor * whole).abs() < 1e-5, "{load:?}");
        }
        let weight = numbers(&of("weight")["vectors"][frame])[2];
        assert!((weight + factor * 9.81 * mass).abs() < 1e-4 * 9.81 * mass);
    }
    let mut sweep = csv::Reader::from_path(desk.path("rests/sweep.csv")).unwrap();
    let rows: Vec<csv::StringRecord> = sweep.records().map(Result::unwrap).collect();
    let tip = numbers(&summary["tip"]["position_m"]);
    let at_one: Vec<f64> = (1..4).map(|i| rows[2][i].parse().unwrap()).collect();
    assert_eq!(at_one, tip);
    let mut shape = csv::Reader::from_path(desk.path("rests/shape.csv")).unwrap();
    let last = shape.records().last().unwrap().unwrap();
    let end: Vec<f64> = (2..5).map(|i| last[i].parse().unwrap()).collect();
    assert_eq!(end, tip);
    // The base carries the weight and the load.
    let base = numbers(&summary["base"]["force_n"]);
    assert!((base[1] + 3.0).abs() < 1e-6 && (base[2] + 4.0 - 9.81 * mass).abs() < 1e-6);

    let shape = "initial.shape=\"equilibrium\"";
    let set = ["--set", shape, "--set", "time.end_s=0.001"];
    let simulate = ["simulate", "sag.toml", "--out", "moves", "--quiet"];
    desk.done(&[&simulate[..], &set].concat());
    let motion = desk.data("moves/report.html");
    let start = numbers(&motion["motion"]["tip"][0]);
    for (a, b) in start.iter().zip(&tip) {
        assert!((a - b).abs() < 1e-9, "{start:?} {tip:?}");
    }
    // And it can be drawn and taken elsewhere like any motion.
    desk.done(&["export", "rests", "--to", "svg"]);
}

/// What statics cannot find or do is refused, each by its name.
#[test]
fn statics_that_are_none_are_refused() {
    let desk = Desk::new();
    let refused = |more: &[&str], code: i32, words: &[&str]| {
        desk.refused(&[&["equilibrium", "sag.toml"], more].concat(), code, words);
        assert!(!desk.path("results/sag-equilibrium").exists());
    };
    refused(&["--to", "0.5"], USAGE, &["--to 0.5", "from 1"]);
    refused(&["--to", "nan"], USAGE, &["--to NaN"]);
    refused(&["--time", "-1"], USAGE, &["--time"]);
    refused(&["--imperfection", "2"], USAGE, &["--imperfection 2"]);
    refused(&["--vary", "wind"], USAGE, &["wind", "gravity"]);
    refused(
        &["--set", "base.kind=\"free\""],
        USAGE,
        &["base.kind", "free"],
    );
    refused(
        &["--set", "rod.elemnts=4"],
        USAGE,
        &["elemnts", "did you mean"],
    );
}

/// Several results on one page: every run with its motion, the keys of the scenes and of the summaries that differ, by how much, and the
/// same by `--json`.
#[test]
fn results_are_compared() {
    let desk = Desk::new();
    for (out, elements) in [("coarse", "4"), ("middle", "6"), ("fine", "8")] {
        let set = format!("rod.elements={elements}");
        desk.done(&[
            "solve",
            "solve.toml",
            "--out",
            out,
            "--quiet",
            "--set",
            &set,
        ]);
    }
    let run = desk.done(&["report", "coarse", "fine", "--json"]);
    let data = desk.data("comparison.html");
    assert!(data["runs"][0]["name"] == "coarse" && data["runs"][1]["name"] == "fine");
    for (i, nodes) in [(0, 5), (1, 9)] {
        let frame = &data["runs"][i]["data"]["motion"]["x"][0];
        assert_eq!(frame.as_array().unwrap().len(), nodes);
    }
    let row = |title: &str, key: &str| {
        let tables = data["tables"].as_array().unwrap();
        let table = tables.iter().find(|table| table["title"] == title).unwrap();
        let row = table["rows"]
            .as_array()
            .unwrap()
            .iter()
            .find(|row| row["key"] == key);
        row.unwrap_or_else(|| panic!("no {key} in {table}")).clone()
    };
    let elements = row("Scenes", "rod.elements");
    assert_eq!(elements["values"], serde_json::json!(["4", "8"]));
    assert_eq!(elements["change"], "+100 %");
    row("Results", "objective");
    row("Results", "check.refined_space_m");
    // What was changed comes before what follows from it.
    assert_eq!(data["tables"][0]["title"], "Scenes");
    let said: Value = serde_json::from_str(&run.stdout).unwrap();
    assert_eq!(said["differences"], data["tables"]);
    assert_eq!(said["report"], "comparison.html");

    // Three have a trade-off; a result is as good as itself, and not better.
    desk.done(&["report", "coarse", "middle", "fine", "--out", "three.html"]);
    let points = desk.data("three.html")["tradeoff"].clone();
    let points = points.as_array().unwrap();
    assert_eq!(points.len(), 3);
    let finest = points.iter().find(|point| point["name"] == "fine").unwrap();
    assert_eq!(finest["on_front"], true);
    desk.done(&["report", "fine", "fine", "--out", "same.html"]);
    let same = desk.data("same.html");
    assert_eq!(same["tables"], serde_json::json!([]));
    assert_eq!(same["runs"][1]["name"], "fine (2)");
}

/// The pages of a solve and of a comparison of simulations work in a browser, wide and narrow, light and dark: no error on the console,
/// no request, nothing beyond the edge, no blank picture. Skipped where there is no Chromium, or no Python to drive it.
#[test]
fn pages_work_in_a_browser() {
    let desk = Desk::new();
    desk.done(&["solve", "solve.toml", "--out", "run", "--quiet"]);
    desk.done(&["simulate", "sag.toml", "--out", "sag", "--quiet"]);
    desk.done(&["report", "sag", "sag"]);
    desk.done(&[
        "mpc",
        "loop.toml",
        "--out",
        "loop",
        "--baselines",
        "--quiet",
    ]);
    desk.done(&["equilibrium", "sag.toml", "--out", "rests", "--quiet"]);
    let shapes = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/examples/data/soromox-shapes.toml"
    );
    let modulus = "rod.material.youngs_modulus_pa";
    let fit = [
        "fit",
        "soromox-tendons",
        "--data",
        shapes,
        "--free",
        modulus,
        "--out",
        "fit",
    ];
    desk.done(&[&fit[..], &["--quiet"]].concat());
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/report_page.py");
    let pages = [
        "run/report.html",
        "comparison.html",
        "loop/report.html",
        "rests/report.html",
        "fit/report.html",
    ];
    let started = Command::new("python3")
        .arg(script)
        .args(pages)
        .current_dir(desk.folder.path())
        .output();
    let Ok(output) = started else {
        println!("skipped: no python3");
        return;
    };
    let said = String::from_utf8_lossy(&output.stdout);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}{errors}");
    assert!(
        said.contains("20 passed, 0 failed") || said.contains("skipped"),
        "{said}{errors}"
    );
}

/// What is no result, results of different verbs, files that are missing or do not fit, overrides, and files of others in the place of the
/// page are refused, each by its name, and nothing is written.
#[test]
fn what_cannot_be_shown_is_refused() {
    let desk = Desk::new();
    desk.done(&["solve", "solve.toml", "--out", "run", "--quiet"]);
    desk.done(&["simulate", "sag.toml", "--out", "sag", "--quiet"]);
    desk.refused(&["report"], USAGE, &["DIR"]);
    desk.refused(
        &["report", "nowhere"],
        USAGE,
        &["nowhere", "no such directory"],
    );
    fs::create_dir(desk.path("empty")).unwrap();
    desk.refused(&["report", "empty"], USAGE, &["empty", "no summary.json"]);
    fs::write(desk.path("empty/summary.json"), "{\"tool\": \"hardarm\"}").unwrap();
    desk.refused(&["report", "empty"], USAGE, &["not the summary"]);
    fs::write(desk.path("empty/summary.json"), "{\n,").unwrap();
    desk.refused(&["report", "empty"], USAGE, &["summary.json:2"]);
    let tradeoff = "{\"schema_version\": 1, \"tool\": \"softarm\", \"command\": \"tradeoff\"}";
    fs::write(desk.path("empty/summary.json"), tradeoff).unwrap();
    fs::copy(desk.path("solve.toml"), desk.path("empty/scene.toml")).unwrap();
    desk.refused(
        &["report", "empty"],
        USAGE,
        &["summary.json", "missing field"],
    );
    desk.refused(
        &["report", "run", "sag"],
        USAGE,
        &["run holds a solve", "sag a simulate"],
    );
    desk.refused(
        &["report", "run", "--set", "rod.elements=3"],
        USAGE,
        &["--set"],
    );
    fs::write(desk.path("thesis.html"), "mine").unwrap();
    desk.refused(
        &["report", "run", "--out", "thesis.html"],
        USAGE,
        &["thesis.html"],
    );
    assert_eq!(desk.read("thesis.html"), "mine");
    desk.refused(
        &["report", "run", "--out", "sag"],
        USAGE,
        &["no page of softarm"],
    );
    desk.refused(
        &["report", "run", "--out", "no/page.html"],
        UNWRITTEN,
        &["no/page.html"],
    );
    assert!(!desk.path("comparison.html").exists());

    let page = desk.read("run/report.html");
    fs::rename(desk.path("run/iterations.csv"), desk.path("aside")).unwrap();
    desk.refused(&["report", "run"], USAGE, &["iterations.csv"]);
    fs::rename(desk.path("aside"), desk.path("run/iterations.csv")).unwrap();
    let controls = desk.read("run/controls.csv");
    let shorter: Vec<&str> = controls.lines().take(4).collect();
    fs::write(desk.path("run/controls.csv"), shorter.join("\n")).unwrap();
    desk.refused(&["report", "run"], USAGE, &["controls.csv", "3 rows"]);
    fs::write(desk.path("run/controls.csv"), controls).unwrap();
    fs::copy(
        desk.path("sag/trajectory.npz"),
        desk.path("run/trajectory.npz"),
    )
    .unwrap();
    desk.refused(
        &["report", "run"],
        USAGE,
        &["trajectory.npz", "rows; scene.toml describes at most"],
    );
    for name in ["trajectory.npz", "scene.toml"] {
        fs::remove_file(desk.path(&format!("run/{name}"))).unwrap();
        desk.refused(&["report", "run"], USAGE, &[name]);
    }
    assert!(page == desk.read("run/report.html"));
}
