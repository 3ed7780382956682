//! Motions that start from the end of another result, or from a shape in rows.

#![cfg(feature = "cli")]

use crate::tool;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use nalgebra::Vector3;
use serde_json::Value;
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{Configuration, Material, NodalState, State};
use softarm::output::{MotionRecord, read_end, write_end};
use softarm::scene::Scene;
use softarm::sqp::SqpSettings;
use softarm::task::{Arm, Discretization, StartShape, Task};
use tempfile::TempDir;
use tool::{DONE, REJECTED, SCENE, USAGE};

/// A hanging arm that falls sideways under gravity: 512 steps in half a second.
const FALL: &str = "\
[rod]
length_m = 1.0
elements = 4
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.05
[base]
position_m = [0.1, -0.2, 0.3]
direction = [0.2, 0.1, 1.0]
[gravity]
acceleration_m_s2 = [3.0, -9.81, 0.5]
[time]
end_s = 0.5
step_s = 0.0009765625
integrator = \"implicit\"
";

/// Elements and gravity of an arm that moves at some decimeters a second when it is taken over.
const PULLED: &str = "--set rod.elements=8 --set gravity.acceleration_m_s2=[1,-1,0]";

/// A folder with scenes and results.
struct Desk {
    folder: TempDir,
}

impl Desk {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("fall.toml"), FALL).unwrap();
        fs::write(folder.path().join("reach.toml"), SCENE).unwrap();
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Runs a line of words, and returns exit code and standard error.
    #[track_caller]
    fn run(&self, line: &str) -> (Option<i32>, String) {
        let output = Command::new(env!("CARGO_BIN_EXE_softarm"))
            .args(line.split_whitespace())
            .current_dir(self.folder.path())
            .env("NO_COLOR", "1")
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!text.contains("panicked"), "{line}: {text}");
        (output.status.code(), text)
    }

    #[track_caller]
    fn done(&self, line: &str) {
        let (code, text) = self.run(line);
        assert_eq!(code, Some(DONE), "{line}: {text}");
    }

    /// Runs a line that is refused, and returns the error.
    #[track_caller]
    fn refused(&self, line: &str) -> String {
        let (code, text) = self.run(line);
        assert_eq!(code, Some(USAGE), "{line}: {text}");
        text
    }

    #[track_caller]
    fn end(&self, name: &str) -> NodalState {
        read_end(&self.path(name).join("end.npz")).unwrap()
    }

    fn motion(&self, name: &str) -> MotionRecord {
        MotionRecord::read_npz(&self.path(name).join("trajectory.npz")).unwrap()
    }

    fn summary(&self, name: &str) -> Value {
        let text = fs::read_to_string(self.path(name).join("summary.json")).unwrap();
        serde_json::from_str(&text).unwrap()
    }
}

fn bytes(path: &Path) -> Vec<u8> {
    fs::read(path).unwrap()
}

/// Returns the largest difference between the poses of the last row of one motion and of the first one of another.
fn gap(last: &MotionRecord, first: &MotionRecord) -> f64 {
    let n = last.n_nodes;
    let end = |values: &[f64], width: usize| values[values.len() - width * n..].to_vec();
    let mut a = end(&last.x, 3);
    a.extend(end(&last.rotation, 9));
    let mut b = first.x[..3 * n].to_vec();
    b.extend(&first.rotation[..9 * n]);
    assert_eq!(a.len(), b.len());
    a.iter()
        .zip(&b)
        .fold(0.0, |far, (a, b)| far.max((a - b).abs()))
}

/// One second is half a second and another half from its end, to the bit, where the first ends at a multiple of the steps after which the
/// integrator goes on from its state alone: with the implicit and the explicit step, with an inertia that follows the dilatation, and on a
/// free arm that spins.
#[test]
fn half_a_second_twice_is_a_second() {
    let desk = Desk::new();
    let spin = "--set base.kind=\"free\" --set initial.angular_velocity_rad_s=[1,2,-1]";
    for more in [
        "",
        "--set time.integrator=\"explicit\" --set time.step_s=0.00006103515625",
        "--set rod.model=\"consistent\" --set time.integrator=\"explicit\" --set time.step_s=0.00006103515625",
        spin,
    ] {
        let row = "--set output.rate_hz=64";
        desk.done(&format!(
            "simulate fall.toml --out whole --set time.end_s=1.0 {row} {more}"
        ));
        desk.done(&format!("simulate fall.toml --out half {row} {more}"));
        let more = more.replace("--set initial.angular_velocity_rad_s=[1,2,-1]", "");
        desk.done(&format!(
            "simulate fall.toml --out other --set initial.from=\"half\" {row} {more}"
        ));
        let [whole, other] = ["whole", "other"].map(|name| bytes(&desk.path(name).join("end.npz")));
        assert!(whole == other, "{more}");
        // The pose of a held base is that of the scene, which rows repeat to rounding.
        assert!(
            gap(&desk.motion("half"), &desk.motion("other")) < 1e-15,
            "{more}"
        );
    }
}

/// Where the first half ends elsewhere, the state is rounded once: the ends agree within the rounding of a momentum, 1e-16 of the speed of
/// sound, that grows by the sensitivity of the motion, which is below 1e3 over half a second.
#[test]
fn a_continuation_elsewhere_is_rounded() {
    let desk = Desk::new();
    let step = "--set time.step_s=0.001";
    desk.done(&format!(
        "simulate fall.toml --out whole --set time.end_s=1.0 {step}"
    ));
    desk.done(&format!("simulate fall.toml --out half {step}"));
    desk.done(&format!(
        "simulate fall.toml --out other {step} --set initial.from=\"half\""
    ));
    let [whole, other] = ["whole", "other"].map(|name| desk.end(name).state.configuration);
    for (a, b) in whole.positions.iter().zip(&other.positions) {
        assert!((a - b).norm() < 1e-12, "{a} {b}");
    }
}

/// The scene in the new result has the state itself: without the earlier result it gives the same files again, and the same page.
#[test]
fn the_new_scene_is_whole() {
    let desk = Desk::new();
    desk.done("simulate fall.toml --out first");
    desk.done("simulate fall.toml --out second --set initial.from=\"first\"");
    fs::remove_dir_all(desk.path("first")).unwrap();
    desk.done("simulate second/scene.toml --out third");
    for file in ["trajectory.npz", "end.npz", "scene.toml"] {
        let [a, b] = ["second", "third"].map(|name| bytes(&desk.path(name).join(file)));
        assert!(a == b, "{file}");
    }
    let text = fs::read_to_string(desk.path("second/scene.toml")).unwrap();
    assert!(!text.contains("first") && text.contains("[initial.state]"));
    // A shape on the command line goes before the state in the text.
    desk.done("simulate second/scene.toml --out rest --set initial.shape=\"rest\"");
    desk.done("simulate fall.toml --out plain");
    let [a, b] = ["rest", "plain"].map(|name| bytes(&desk.path(name).join("end.npz")));
    assert!(a == b);
}

/// A solve starts from the velocities at the end of a simulation, and another one from those at its own end, and both are certified, and
/// certified again by `verify`; a simulation goes on from the end of the solve, and a payload takes over the velocities.
#[test]
fn solves_start_from_the_end_of_others() {
    let desk = Desk::new();
    let solve = "solve reach.toml --set rod.elements=8";
    desk.done(&format!("simulate reach.toml --out fall {PULLED}"));
    desk.done(&format!("{solve} --out first --set initial.from=\"fall\""));
    desk.done(&format!(
        "{solve} --out second --set initial.from=\"first\" --set task.position_m=[0.05,-0.05,0.99]"
    ));
    for (before, name) in [("fall", "first"), ("first", "second")] {
        let start = desk.end(before);
        let speed = |q: usize| start.state.linear_momentum[q].norm() / start.mass[q];
        assert!(speed(8) > 0.1, "{before}");
        assert_eq!(desk.summary(name)["check"]["verdict"], "certified");
        let far = gap(&desk.motion(before), &desk.motion(name));
        // The motion of a solve satisfies its own equations within the tolerance, and its end is that of a replay.
        assert!(far < 1e-6, "{before}: {far}");
        desk.done(&format!("verify {name} --quick"));
    }
    desk.done(
        "simulate reach.toml --out after --set rod.elements=8 --set initial.from=\"second\" --set payload.mass_kg=0.5",
    );
    let text = fs::read_to_string(desk.path("after/scene.toml")).unwrap();
    let (scene, source) = Scene::from_toml("after", &text, &[]).unwrap();
    let after = scene.simulation(&source).unwrap();
    let before = desk.end("second");
    for q in 1..9 {
        let velocity = after.initial.linear_momentum[q] / after.rod.nodes[q].mass;
        let expected = before.state.linear_momentum[q] / before.mass[q];
        assert!(
            (velocity - expected).norm() < 1e-14 * (1.0 + expected.norm()),
            "{q}"
        );
    }
}

/// Other elements take the poses of shared nodes and the velocities between them.
#[test]
fn other_elements_take_the_state_over() {
    let desk = Desk::new();
    desk.done("simulate fall.toml --out coarse");
    desk.done("simulate fall.toml --out fine --set rod.elements=8 --set initial.from=\"coarse\"");
    let [coarse, fine] = ["coarse", "fine"].map(|name| desk.motion(name));
    let last = &coarse.x[coarse.x.len() - 15..];
    for q in 0..5 {
        assert_eq!(last[3 * q..3 * q + 3], fine.x[6 * q..6 * q + 3], "{q}");
    }
}

/// `verify` finds a changed end, and a changed start.
#[test]
fn changed_states_are_rejected() {
    let desk = Desk::new();
    desk.done(&format!("simulate reach.toml --out fall {PULLED}"));
    desk.done("solve reach.toml --out run --set rod.elements=8 --set initial.from=\"fall\"");
    let path = desk.path("run/end.npz");
    let honest = desk.end("run");
    let mut changed = honest.clone();
    changed.state.linear_momentum[3].x *= 1.001;
    write_end(&path, &changed).unwrap();
    let (code, text) = desk.run("verify run --quick");
    assert_eq!(code, Some(REJECTED), "{text}");
    assert!(text.contains("end.npz: p, node 3"), "{text}");
    write_end(&path, &honest).unwrap();
    desk.done("verify run --quick");
    let scene = desk.path("run/scene.toml");
    let text = fs::read_to_string(&scene).unwrap();
    let (before, after) = text.split_once("momentum_kg_m_s = [[").unwrap();
    let rows = after.find("],").unwrap();
    let changed = format!(
        "{before}momentum_kg_m_s = [[0.0, 0.0, 0.0], [0.3, 0.1, 0.0{}",
        {
            let second = rows + after[rows + 1..].find(']').unwrap() + 1;
            &after[second..]
        }
    );
    fs::write(&scene, changed).unwrap();
    let (code, text) = desk.run("verify run --quick");
    assert_eq!(code, Some(REJECTED), "{text}");
}

/// A start that cannot be taken is refused at its key, with the reason and a remedy.
#[test]
fn unfit_starts_are_refused() {
    let desk = Desk::new();
    desk.done("simulate fall.toml --out run");
    desk.done("equilibrium fall.toml --out statics --points 2");
    fs::create_dir(desk.path("empty")).unwrap();
    let both = format!("{FALL}[initial]\nshape = \"equilibrium\"\nfrom = \"run\"\n");
    fs::write(desk.path("both.toml"), both).unwrap();
    let from = |name: &str| format!("simulate fall.toml --out new --set initial.from=\"{name}\"");
    for (line, words) in [
        (from("nowhere"), &["initial.from", "no such directory"][..]),
        (from("empty"), &["initial.from", "no summary.json"]),
        (
            from("statics"),
            &["initial.from", "no motion to go on with"],
        ),
        (
            from("run") + " --set rod.length_m=1.1",
            &["initial", "an arm of 1 m", "1.1 m", "equally long"],
        ),
        (
            from("run") + " --set base.position_m=[0,0,0]",
            &["initial", "from the base", "base.position_m"],
        ),
        (
            "simulate both.toml --out new".into(),
            &["initial.shape", "contradicts initial.from"],
        ),
    ] {
        let text = desk.refused(&line);
        for word in words {
            assert!(text.contains(word), "{line}: {text}");
        }
        assert!(!desk.path("new").exists(), "{line}");
    }
    let path = desk.path("run/end.npz");
    let good = desk.end("run");
    for (node, word) in [
        (2, "not finite"),
        (1, "not a rotation"),
        (4, "not all positive"),
    ] {
        let mut bad = good.clone();
        match word {
            "not finite" => bad.state.angular_momentum[node].y = f64::NAN,
            "not a rotation" => bad.state.configuration.rotations[node] *= 1.01,
            _ => bad.mass[node] = -1.0,
        }
        write_end(&path, &bad).unwrap();
        let text = desk.refused(&from("run"));
        assert!(
            text.contains(&format!("end.npz: node {node}: ")) && text.contains(word),
            "{text}"
        );
    }
    let whole = bytes(&desk.path("run/trajectory.npz"));
    for (content, word) in [
        (whole, "array length: missing"),
        (b"no archive".to_vec(), "not a numpy archive"),
    ] {
        fs::write(&path, content).unwrap();
        let text = desk.refused(&from("run"));
        assert!(text.contains(word), "{text}");
    }
    fs::remove_file(&path).unwrap();
    let text = desk.refused(&from("run"));
    assert!(
        text.contains("no end.npz") && text.contains("run it again"),
        "{text}"
    );
}

/// A loop starts from the end of a simulation, and a simulation from the end of a loop, with the poses where the other ended.
#[test]
fn loops_start_and_end_like_others() {
    let desk = Desk::new();
    let short = "--set mpc.duration_s=0.2 --set plant.elements=4 --set rod.elements=4";
    desk.done(&format!("mpc mpc-reach --out loop {short}"));
    let text = fs::read_to_string(desk.path("loop/scene.toml")).unwrap();
    fs::write(desk.path("again.toml"), &text).unwrap();
    desk.done(&format!(
        "mpc again.toml --out next --set initial.from=\"loop\" {short}"
    ));
    // The pose of a held base is that of the scene, which rows repeat to rounding.
    assert!(gap(&desk.motion("loop"), &desk.motion("next")) < 1e-15);
    desk.done("simulate again.toml --out after --set initial.from=\"next\" --set time.end_s=0.01 --set time.step_s=\"auto\"");
    // The pose of a held base is that of the scene, which rows repeat to rounding.
    assert!(gap(&desk.motion("next"), &desk.motion("after")) < 1e-15);
}

/// Rows of curvature are the arc that they describe, also between rows that make a step; rows of poses along that arc are the same shape.
#[test]
fn shapes_in_rows_are_what_they_say() {
    let desk = Desk::new();
    let k = 2.0;
    let curvature = format!("--set initial.shape=[[0.0,0.0,{k},0.0]]");
    // At the end of no time; a straight base makes the arc plain.
    let still = "--set time.end_s=0.0 --set time.step_s=\"auto\" --set base.direction=[0,0,1] --set base.position_m=[0,0,0]";
    desk.done(&format!("simulate fall.toml --out arc {curvature} {still}"));
    let at = |s: f64| {
        let a = k * s;
        [(1.0 - a.cos()) / k, 0.0, a.sin() / k]
    };
    let arc = desk.end("arc").state.configuration;
    for (q, x) in arc.positions.iter().enumerate() {
        let expected = at(0.25 * q as f64);
        for axis in 0..3 {
            assert!((x[axis] - expected[axis]).abs() < 1e-14, "{x} {expected:?}");
        }
    }
    let row = |s: f64| {
        let ([x, y, z], half) = (at(s), 0.5 * k * s);
        format!("[{s},{x},{y},{z},{},0.0,{},0.0]", half.cos(), half.sin())
    };
    let rows = [0.0, 0.4, 1.0].map(row).join(",");
    desk.done(&format!(
        "simulate fall.toml --out poses --set initial.shape=[{rows}] {still}"
    ));
    let poses = desk.end("poses").state.configuration;
    for (a, b) in arc.positions.iter().zip(&poses.positions) {
        assert!((a - b).norm() < 1e-14, "{a} {b}");
    }
    // Straight up to the middle, and twice the curvature from there on.
    let step = "--set initial.shape=[[0.5,0,0,0],[0.5,0,4,0]]";
    desk.done(&format!("simulate fall.toml --out step {step} {still}"));
    let tip = desk.end("step").state.configuration.positions[4];
    let expected = [(1.0 - 2.0_f64.cos()) / 4.0, 0.5 + 2.0_f64.sin() / 4.0];
    assert!(
        (tip.x - expected[0]).abs() < 1e-14 && (tip.z - expected[1]).abs() < 1e-14,
        "{tip}"
    );

    for (rows, word) in [
        ("[]", "no rows"),
        ("[[0,1,2]]", "a row of 3 numbers"),
        ("[[0,0,1,0],[0.5,0,0,0,1,0,0,0]]", "a row of 8 numbers"),
        ("[[0.5,0,1,0],[0.4,0,1,0]]", "0.4 is not a later place"),
        ("[[0,0,1,nan]]", "not a finite number"),
        ("[[0,0,0,0,1,0,0,0]]", "from 0 at the base to 1 at the tip"),
        (
            "[[0,0,0,0,0,0,0,0],[1,0,0,1,1,0,0,0]]",
            "all components are zero",
        ),
        (
            "[[0,0.1,0,0,1,0,0,0],[1,0,0,1,1,0,0,0]]",
            "from the base at t = 0",
        ),
        ("[[0,0,20,0]]", "half a turn or more"),
        ("\"bent\"", "rows of numbers"),
    ] {
        let text = desk.refused(&format!(
            "simulate fall.toml --set initial.shape={rows} {still}"
        ));
        assert!(
            text.contains(word) && text.contains("initial.shape"),
            "{rows}: {text}"
        );
    }
}

/// A problem of a program begins with the same state when its scene is read again, whatever its start is: states and curvatures to the bit,
/// poses to the rounding of their quaternions.
#[test]
fn starts_of_programs_are_described() {
    let arm = Arm::cylinder(&Material::isotropic(1e6, 0.5, 1000.0), 1.0, 0.05);
    let grid = Discretization::with_elements(4);
    let rod = arm.rod(&grid).unwrap();
    let mut moving = State::at_rest(rod.rest.clone());
    moving.linear_momentum[3] = Vector3::new(0.1, 1.0 / 3.0, -0.2);
    moving.angular_momentum[2] = Vector3::new(1e-3, 0.0, 1.0 / 7.0);
    let curvature = vec![(0.0, Vector3::x()), (1.0, Vector3::new(0.3, 0.1, 0.2))];
    let turned = rod.rest.rotations.iter().enumerate();
    let turned = turned.map(|(q, r)| r * exp(&Vector3::new(0.0, 0.1 * q as f64, 0.0)));
    let poses = Configuration {
        positions: rod.rest.positions.clone(),
        rotations: turned.collect(),
    };
    for shape in [
        StartShape::Equilibrium,
        StartShape::Curvature(curvature),
        StartShape::Poses(rod.places(), poses),
        StartShape::State(Box::new(NodalState::of(&rod, &moving))),
    ] {
        let mut task = Task::reach(Vector3::new(0.2, 0.0, 0.97), 1.0, 20.0);
        task.start.shape = shape;
        let problem = task.discretize(&arm, &grid).unwrap();
        let scene = Scene::describing(&problem, &SqpSettings::default()).unwrap();
        let (read, source) = Scene::from_toml("described", &scene.to_toml(), &[]).unwrap();
        let again = read.optimal_control(&source).unwrap().problem;
        let off = again.initial.difference(&problem.discrete.initial);
        let parts = [&off.positions, &off.rotations, &off.linear, &off.angular];
        let far = parts.into_iter().flatten().map(|v| v.norm());
        assert!(far.fold(0.0, f64::max) < 1e-14, "{:?}", task.start.shape);
    }
}
