//! What the verbs make of arms with tendons and chambers: pages, exports, trade-offs, and accuracies.

#![cfg(feature = "cli")]

use crate::desk::Desk;
use crate::tool;

use std::fs;
use std::process::Command;

use nalgebra::Vector3;
use serde_json::Value;
use softarm::output::{EffortRow, MotionRecord, read_efforts};
use softarm::scene::Scene;
use softarm::tradeoff::Subject;
use tool::DONE;

/// A hanging arm that two opposed tendons pull toward a point, past a chamber whose pressure is given.
const ARM: &str = "\
[rod]
length_m = 0.3
elements = 8
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
viscous_1_s = 1.0
internal_s = 5e-3
[[tendon]]
name = \"front, <1>\"
offset_m = [0.008, 0.0]
tension_n = [0.0, 2.0]
[[tendon]]
name = \"back\"
offset_m = [-0.008, 0.0]
to = 0.5
tension_n = [0.0, 2.0]
[[chamber]]
name = \"side\"
area_m2 = 2e-5
offset_m = [0.0, 0.006]
profile = [[0.0, 0.0], [0.2, 2e3]]
[time]
end_s = 0.3
[task]
position_m = [0.03, 0.0, -0.29]
hard = false
weight = 1e4
at_rest = false
";

impl Desk {
    fn efforts(&self, run: &str) -> (MotionRecord, Vec<EffortRow>) {
        let motion = MotionRecord::read_npz(&self.path(run).join("trajectory.npz")).unwrap();
        let n = self.read(&format!("{run}/efforts.csv")).lines().count() - 1;
        let rows = read_efforts(&self.path(run).join("efforts.csv"), n, 16).unwrap();
        (motion, rows)
    }

    /// The data that a page draws.
    fn page(&self, run: &str) -> Value {
        let page = self.read(&format!("{run}/report.html"));
        let (_, rest) = page.split_once("type=\"application/json\">").unwrap();
        serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
    }
}

fn numbers(value: &Value) -> Vec<f64> {
    (value.as_array().unwrap().iter())
        .map(|number| number.as_f64().unwrap())
        .collect()
}

/// The picture has every actuator at its offset in the section, over the nodes that it passes, with the efforts of `efforts.csv` at its
/// frames; without effort it is slack; charts have efforts and bounds; the page is made anew to the byte. A page without actuators has none.
#[test]
fn pages_show_actuators() {
    let desk = Desk::holding(ARM);
    for verb in ["simulate", "solve"] {
        desk.done(&format!("{verb} arm.toml --out run"));
        let (motion, efforts) = desk.efforts("run");
        let page = desk.page("run");
        let routes = page["routes"].as_array().unwrap();
        let t = numbers(&page["motion"]["t"]);
        let expected = [
            ("front, <1>", "tendon", 9, [0.008, 0.0]),
            ("back", "tendon", 5, [-0.008, 0.0]),
            ("side", "chamber", 9, [0.0, 0.006]),
        ];
        for (i, (name, kind, n_nodes, offset)) in expected.into_iter().enumerate() {
            let route = &routes[i];
            assert_eq!(
                (&route["name"], &route["kind"]),
                (&name.into(), &kind.into())
            );
            assert_eq!(
                (&route["first"], route["offsets"].as_array().unwrap().len()),
                (&0.into(), n_nodes)
            );
            for found in route["offsets"].as_array().unwrap() {
                let found = numbers(found);
                assert!((found[0] - offset[0]).abs() < 1e-9 && (found[1] - offset[1]).abs() < 1e-9);
            }
            let drawn = numbers(&route["efforts"]);
            let most = route["most"].as_f64().unwrap();
            let slack = route["slack"].as_array().unwrap();
            assert_eq!(drawn.len(), t.len());
            for ((effort, slack), t) in drawn.iter().zip(slack).zip(&t) {
                let row = (motion.t.iter())
                    .position(|own| (own - t).abs() < 1e-9)
                    .unwrap();
                let own = efforts[3 * row + i].effort;
                // Numbers of a picture have seven digits.
                assert!((effort - own).abs() <= 1e-7 * most, "{effort} {own}");
                assert_eq!(slack.as_bool().unwrap(), own.abs() <= 1e-4 * most);
            }
            let radius = route["radius"].as_f64().unwrap();
            let chamber = (2e-5 / std::f64::consts::PI).sqrt();
            assert_eq!(radius, if kind == "chamber" { chamber } else { 0.0 });
        }
        assert_eq!(routes[2]["slack"][0], true);
        let charts = page["charts"].as_array().unwrap();
        let chart = |title: &str| charts.iter().find(|chart| chart["title"] == title).unwrap();
        let names = |chart: &Value| -> Vec<String> {
            let series = chart["series"].as_array().unwrap().iter();
            series
                .map(|own| own["name"].as_str().unwrap().to_string())
                .collect()
        };
        assert_eq!(
            names(chart("Tensions")),
            ["front, <1>", "back", "bound", "bound"]
        );
        assert_eq!(names(chart("Pressures")), ["side"]);
        assert_eq!(chart("Pressures")["unit"], "Pa");
        assert_eq!(numbers(&chart("Tensions")["series"][3]["y"]), [2.0, 2.0]);
        let acting = page["acting"].to_string();
        assert!(
            acting.contains("allowed 0 N to 2 N") && acting.contains("to 0.5 of the length"),
            "{acting}"
        );
        let before = desk.read("run/report.html");
        desk.done("report run");
        assert!(desk.read("run/report.html") == before, "{verb}");
        fs::remove_dir_all(desk.path("run")).unwrap();
    }
    fs::write(desk.path("plain.toml"), tool::SCENE).unwrap();
    desk.done("simulate plain.toml --out plain");
    assert_eq!(desk.page("plain")["routes"], Value::Null);
}

/// VTK files have effort and coordinate of their time as field data, and the table a column for each actuator, whatever its name is.
#[test]
fn exports_have_efforts() {
    let desk = Desk::holding(ARM);
    desk.done("solve arm.toml --out run");
    let (motion, efforts) = desk.efforts("run");
    let last = &efforts[3 * (motion.n_rows() - 1)..];
    desk.done("export run --to vtk --out vtk --frames 3");
    let text = desk.read("vtk/motion-0002.vtp");
    for (name, own) in ["front, &lt;1&gt;", "back", "side"].into_iter().zip(last) {
        for (word, value) in [("effort", own.effort), ("coordinate", own.coordinate)] {
            let head = format!("Name=\"{word} {name}\" NumberOfTuples=\"1\" format=\"ascii\">\n");
            let (_, rest) = text.split_once(&head).expect(&head);
            assert_eq!(rest.lines().next().unwrap().parse::<f64>().unwrap(), value);
        }
    }
    for _ in 0..2 {
        // The second export replaces the first one, which it knows by its head.
        desk.done("export run --to csv --out csv --frames 3");
    }
    let path = desk.path("csv/motion.csv");
    let mut table = csv::Reader::from_path(path).unwrap();
    let heads: Vec<String> = table.headers().unwrap().iter().map(String::from).collect();
    assert_eq!(
        heads[10..],
        ["effort front, <1>", "effort back", "effort side"]
    );
    let row = table.records().last().unwrap().unwrap();
    for (i, own) in last.iter().enumerate() {
        assert_eq!(row[10 + i].parse::<f64>().unwrap(), own.effort);
    }
}

/// A scene whose only controls are efforts is an optimal-control problem to a trade-off, with blocks of its own, which a changed setting
/// writes into the scene; without a goal it is a motion.
#[test]
fn efforts_are_controls_of_a_tradeoff() {
    let (scene, _) = Scene::from_toml("arm", ARM, &[]).unwrap();
    assert_eq!(Subject::of(&scene), Subject::OptimalControl);
    let (task, _) = ARM.split_once("[task]").unwrap();
    let (motion, _) = Scene::from_toml("motion", task, &[]).unwrap();
    assert_eq!(Subject::of(&motion), Subject::Motion);
    let own = scene.discretization();
    let wanted = softarm::task::Discretization {
        blocks: 7,
        elements: 6,
        ..own
    };
    assert_eq!(scene.with_grid(&wanted).discretization().blocks, 7);
    assert_eq!(scene.with_grid(&own).control, None);
}

/// An accuracy that the first grid misses leads to a finer one, which begins with the efforts of the coarser one: it needs fewer iterations
/// than a solve of that grid from the beginning, and the result is certified.
#[test]
fn efforts_are_carried_to_finer_grids() {
    let desk = Desk::holding(ARM);
    let hard = ARM.replace("hard = false\nweight = 1e4", "tolerance_m = 2e-3");
    let scene = hard.replace("elements = 8\n", "accuracy = 2e-3\n");
    fs::write(desk.path("accurate.toml"), scene).unwrap();
    fs::write(desk.path("hard.toml"), hard).unwrap();
    let summary = desk.done("solve accurate.toml --out run");
    assert_eq!(summary["check"]["verdict"], "certified");
    let accuracy = &summary["accuracy"];
    let levels = accuracy["levels"].as_array().unwrap();
    assert!(levels.len() > 1, "{accuracy}");
    let elements = levels.last().unwrap()["elements"].as_u64().unwrap();
    let alone = desk.done(&format!(
        "solve hard.toml --out alone --set rod.elements={elements}"
    ));
    let [carried, fresh] = [&summary, &alone].map(|own| own["iterations"].as_u64().unwrap());
    assert!(carried <= fresh, "{carried} {fresh}");
    let [a, b] = [&summary, &alone].map(|own| own["objective"].as_f64().unwrap());
    // Both are optima of one grid, of objectives that a solve knows to the square of its tolerance.
    assert!((a - b).abs() < 1e-6 * b.abs(), "{a} {b}");
}

/// A soft goal is solved at any weight, on grids whose subproblems have many tensions at their bounds: the variables of the goal have a penalty
/// of unit curvature, whatever the weight is. The distance that is left falls as the inverse of a large weight, to first order in it.
#[test]
fn heavy_weights_are_solved() {
    let desk = Desk::holding(ARM);
    let left = |weight: &str| {
        let set = "--set rod.elements=16 --set solver.max_iterations=40";
        desk.done(&format!(
            "solve arm.toml {set} --set task.weight={weight} --out run"
        ));
        let (motion, _) = desk.efforts("run");
        let tip = Vector3::from_column_slice(&motion.x[motion.x.len() - 3..]);
        (tip - Vector3::new(0.03, 0.0, -0.29)).norm()
    };
    let [light, heavy, heaviest] = ["1e2", "1e4", "1e6"].map(left);
    assert!(
        heaviest < heavy && heavy < light,
        "{light:e} {heavy:e} {heaviest:e}"
    );
}

/// `check` says of every tendon its bounds and its tension at the target, and of chambers, muscles and magnets likewise. Implicit steps beyond the
/// limit of an arm that a moment bends are a remark only where something else than actuators along the arm bends it, or nothing damps it.
#[test]
fn check_names_every_actuator() {
    let desk = Desk::holding(ARM);
    let talk = |line: &str| {
        let output = Command::new(env!("CARGO_BIN_EXE_softarm"))
            .args(line.split_whitespace())
            .current_dir(desk.path("."))
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(DONE), "{line}");
        String::from_utf8_lossy(&output.stderr).into_owned()
            + &String::from_utf8_lossy(&output.stdout)
    };
    for scene in ["till-tendons", "knode-tendons"] {
        let words = talk(&format!("check {scene}"));
        for name in ["first", "second", "third", "fourth"] {
            let mut lines = words.lines();
            let line = lines.find(|line| line.contains(&format!("{name}, 0 to")));
            assert!(
                line.is_some_and(|line| line.contains("at the target")),
                "{words}"
            );
        }
        assert!(!words.contains("time.step_s"), "{words}");
        let undamped = talk(&format!("check {scene} --set damping.internal_s=0"));
        assert!(undamped.contains("time.step_s"), "{undamped}");
    }
    // A number without a unit has no prefix.
    assert!(talk("check elastica-muscles").contains("first, 0 to 1; at the target 0.5"));
}

/// Two pairs of tendons on two motors, which pull one tendon of a pair and let the other one out.
const MOTORS: &str = "\
[rod]
length_m = 0.2
elements = 12
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.01
[damping]
viscous_1_s = 5.0
[time]
end_s = 0.4
[[tendon]]
name = \"left\"
offset_m = [0.008, 0.0]
tension_n = [1.0, 10.0]
pretension_n = 3.0
[[tendon]]
name = \"right\"
offset_m = [-0.008, 0.0]
tension_n = [1.0, 10.0]
pretension_n = 3.0
follows = { name = \"left\", gain = -1.0 }
[[tendon]]
name = \"front\"
offset_m = [0.0, 0.008]
tension_n = [1.0, 10.0]
pretension_n = 3.0
[[tendon]]
name = \"back\"
offset_m = [0.0, -0.008]
tension_n = [1.0, 10.0]
pretension_n = 3.0
follows = { name = \"front\", gain = -0.5 }
[task]
position_m = [0.03, 0.02, 0.19]
at_rest = false
hard = false
[control]
blocks = 4
";

/// The same pairs on winches.
fn on_winches() -> String {
    MOTORS
        .replace("elements = 12", "elements = 6")
        .replace(
            "tension_n = [1.0, 10.0]",
            "displacement_m = [-0.02, 0.02]\ncompliance_1_n = 2e-2",
        )
        .replace("pretension_n = 3.0", "rest_displacement_m = -0.004")
        .replace("[0.03, 0.02, 0.19]", "[0.006, 0.004, 0.199]")
}

/// One motor for two tendons is one control: files have its column alone, the tensions, or the displacements of winches, of its tendons keep
/// their relation to the last digits, and both keep their bounds: a motor that begins at 3 N pulls by 5 N at most where its other tendon should
/// keep 1 N. All derivatives are those of differences, and results are certified by code that knows the relation by itself.
#[test]
fn two_tendons_share_a_motor() {
    let desk = Desk::holding(ARM);
    fs::write(desk.path("motors.toml"), MOTORS).unwrap();
    fs::write(desk.path("winches.toml"), on_winches()).unwrap();
    for (scene, implicit) in [("motors", false), ("motors", true), ("winches", true)] {
        let scheme = if implicit {
            "--set time.integrator=implicit"
        } else {
            ""
        };
        let found = desk.done(&format!("derivatives {scene}.toml {scheme}"));
        assert_eq!(found["verdict"], "ok", "{scene} {implicit}: {found}");
    }
    // Rest, gain of the second, and unit.
    for (scene, rest, unit) in [("motors", 3.0, "N"), ("winches", -0.004, "m")] {
        let summary = desk.done(&format!("solve {scene}.toml --out {scene}"));
        assert_eq!(summary["check"]["verdict"], "certified", "{scene}");
        let controls = desk.read(&format!("{scene}/controls.csv"));
        let head = format!("t_start,t_end,left ({unit}),front ({unit})");
        assert_eq!(controls.lines().next(), Some(&head[..]));
        let (_, rows) = desk.efforts(scene);
        for row in rows.chunks(4) {
            let [left, right, front, back] = [0, 1, 2, 3].map(|i| match unit {
                "N" => row[i].effort,
                _ => row[i].displacement.flatten().unwrap(),
            } - rest);
            assert!((right + left).abs() < 1e-12 && (back + 0.5 * front).abs() < 1e-12);
        }
        if scene == "motors" {
            let most = |i: usize| rows.chunks(4).map(|row| row[i].effort).fold(0.0, f64::max);
            let least = |i: usize| rows.chunks(4).map(|row| row[i].effort).fold(9.0, f64::min);
            assert!((most(0) - 5.0).abs() < 1e-6 && (least(1) - 1.0).abs() < 1e-6);
            assert!(most(2) < 7.0 + 1e-9 && least(3) > 1.0 - 1e-9);
        }
        desk.done(&format!("verify {scene}"));
    }
}

/// In a loop the commands of a pair, and the efforts that follow them with the lag of the motor, keep their relation at every sample, within the bounds of both, and lead the arm on its path.
#[test]
fn loops_drive_pairs() {
    let desk = Desk::holding(ARM);
    let rest: Vec<String> = (0..4)
        .map(|i| format!("--set tendon.{i}.pretension_n=0.725"))
        .collect();
    let follow = "--set tendon.2.follows={name=\"first\",gain=-1.0} --set tendon.3.follows={name=\"second\",gain=-1.0}";
    for lag in ["", "--set tendon.0.lag_s=0.03 --set tendon.1.lag_s=0.03"] {
        let summary = desk.done(&format!(
            "mpc mpc-tendons --out loop --set mpc.duration_s=5.0 {follow} {lag} {}",
            rest.join(" ")
        ));
        let off = summary["tip_error_over_length"]["rms"].as_f64().unwrap();
        // The circle is a little lower than the tip under these sums of tensions.
        assert!(off < 6e-3, "{off}");
        let (_, rows) = desk.efforts("loop");
        assert!(rows.len() > 1000);
        for row in rows.chunks(4) {
            let efforts = [0, 1, 2, 3].map(|i| row[i].effort);
            assert!((efforts[0] + efforts[2] - 1.45).abs() < 1e-12);
            assert!((efforts[1] + efforts[3] - 1.45).abs() < 1e-12);
            assert!(efforts.iter().all(|effort| *effort > -1e-9));
        }
    }
}

/// Tendons through disks: derivatives are those of differences, and solves by tensions and by winches are
/// certified by code that computes their lengths by itself.
#[test]
fn tendons_run_through_disks() {
    let desk = Desk::holding(ARM);
    let threaded = |text: &str| text.replace("offset_m =", "disk_spacing_m = 0.03\noffset_m =");
    fs::write(desk.path("motors.toml"), threaded(MOTORS)).unwrap();
    fs::write(desk.path("winches.toml"), threaded(&on_winches())).unwrap();
    for (scene, scheme) in [
        ("motors", "explicit"),
        ("motors", "implicit"),
        ("winches", "implicit"),
    ] {
        let scheme =
            format!("--set time.integrator={scheme} --set rod.elements=6 --set time.end_s=0.25");
        let found = desk.done(&format!("derivatives {scene}.toml {scheme}"));
        assert_eq!(found["verdict"], "ok", "{scene} {scheme}: {found}");
        let summary = desk.done(&format!("solve {scene}.toml --out {scene} {scheme}"));
        assert_eq!(summary["check"]["verdict"], "certified", "{scene}");
        desk.done(&format!("verify {scene}"));
    }
}
