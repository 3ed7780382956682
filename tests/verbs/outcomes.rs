//! Every extreme ends in a typed outcome: an exit code of the contract, a status, and names. What is certified holds when it is
//! simulated again, and the same run gives the same bytes.

#![cfg(feature = "cli")]

use crate::tool;

use std::fs::File;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use serde_json::Value;
use softarm::control::{
    Bound, Enforcement, Goal, Guess, OptimalControlProblem, PathEnforcement, PathLimit,
    PlacedChannel, Shape, Transcription, first_point,
};
use softarm::mechanics::rotation::log;
use softarm::mechanics::{State, Stepper};
use softarm::scene::Scene;
use softarm::sqp::{SqpStatus, solve};
use tempfile::TempDir;
use tool::{DONE, HANGS, INFEASIBLE, NOT_CONVERGED, NUMERICAL, REJECTED, SCENE, STOPPED, USAGE};

/// Where the arm is at the start.
const STAY: &str = "task.position_m=[0.0, 0.0, 1.0]";
/// Where the base is.
const BASE: &str = "task.position_m=[0.0, 0.0, 0.0]";

fn speed_limit(largest: f64) -> String {
    format!("[[limit]]\nname = \"slow tip\"\nspeed_max_m_s = {largest}\n")
}

fn ball(center: [f64; 3], radius: f64, more: &str) -> String {
    format!(
        "[[obstacle]]\nname = \"ball\"\nsphere = {{ center_m = {center:?}, radius_m = {radius} }}\n{more}\n"
    )
}

/// The wall `x ≥ at`.
fn wall(at: f64) -> String {
    format!(
        "[[obstacle]]\nname = \"wall\"\nhalf_space = {{ point_m = [{at}, 0.0, 0.0], normal = [1.0, 0.0, 0.0] }}\n"
    )
}

fn via(more: &str) -> String {
    format!("[[task.via]]\nat_s = 0.15\n{more}\n")
}

struct Desk {
    folder: TempDir,
}

/// What a run left behind.
struct Run {
    what: String,
    code: i32,
    stdout: String,
    stderr: String,
    result: PathBuf,
}

impl Desk {
    fn new() -> Self {
        Self {
            folder: tempfile::tempdir().unwrap(),
        }
    }

    /// Runs `softarm VERB` on a scene of this text, to its end.
    #[track_caller]
    fn run(&self, verb: &str, scene: &str, settings: &[&str], arguments: &[&str]) -> Run {
        let path = |name: &str| self.folder.path().join(name);
        std::fs::write(path("scene.toml"), scene).unwrap();
        let out = match arguments {
            ["--out", out, ..] => out,
            _ => "run",
        };
        let mut command = Command::new(env!("CARGO_BIN_EXE_softarm"));
        command.args([verb, "scene.toml", "--json"]);
        if verb == "solve" && out == "run" {
            command.args(["--out", out]);
        }
        command.args(arguments);
        for setting in settings {
            command.args(["--set", setting]);
        }
        let what = format!("{command:?}");
        let mut child = command
            .current_dir(self.folder.path())
            .env("NO_COLOR", "1")
            .stdin(Stdio::null())
            .stdout(File::create(path("stdout")).unwrap())
            .stderr(File::create(path("stderr")).unwrap())
            .spawn()
            .unwrap();
        let started = Instant::now();
        let status = loop {
            if let Some(status) = child.try_wait().unwrap() {
                break status;
            }
            if started.elapsed() > HANGS {
                let _ = child.kill();
                panic!("{what} does not end");
            }
            std::thread::sleep(Duration::from_millis(5));
        };
        let read = |name: &str| std::fs::read_to_string(path(name)).unwrap();
        let run = Run {
            code: status.code().unwrap(),
            stdout: read("stdout"),
            stderr: read("stderr"),
            result: path(out),
            what,
        };
        assert!(!run.stderr.contains("panicked"), "{run:?}");
        println!(
            "{:.2} s, code {}: {}",
            started.elapsed().as_secs_f64(),
            run.code,
            run.what
        );
        run
    }

    /// Solves the scene with what is added and set; the outcome is one of `codes`, and is what it says it is.
    #[track_caller]
    fn solve(&self, settings: &[&str], more: &str, codes: &[i32]) -> Value {
        self.solve_with(settings, more, &[], codes)
    }

    #[track_caller]
    fn solve_with(
        &self,
        settings: &[&str],
        more: &str,
        arguments: &[&str],
        codes: &[i32],
    ) -> Value {
        let run = self.run("solve", &format!("{SCENE}{more}"), settings, arguments);
        assert!(codes.contains(&run.code), "{run:?}");
        run.judge()
    }

    /// `check` and `solve` refuse the scene at the key, with these words.
    #[track_caller]
    fn refuse(&self, settings: &[&str], more: &str, words: &[&str]) {
        for verb in ["check", "solve"] {
            let run = self.run(verb, &format!("{SCENE}{more}"), settings, &[]);
            assert_eq!(run.code, USAGE, "{run:?}");
            assert_eq!(run.stdout, "");
            for word in words {
                assert!(run.stderr.contains(word), "no `{word}` in {run:?}");
            }
        }
    }
}

impl std::fmt::Debug for Run {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        writeln!(f, "{}\ncode {}\n{}", self.what, self.code, self.stdout)?;
        f.write_str(&self.stderr)
    }
}

impl Run {
    /// Status and code belong together; what did not converge says why, and which constraints are off, where, when and by how much;
    /// controls are within their bounds, whatever the outcome; and what is certified is true.
    #[track_caller]
    fn judge(&self) -> Value {
        let summary: Value = serde_json::from_str(&self.stdout).unwrap();
        let status = summary["status"].as_str().unwrap();
        let codes: &[i32] = match status {
            "converged" => &[DONE, REJECTED],
            "iteration-limit" | "step-too-small" => &[NOT_CONVERGED],
            "locally-infeasible" => &[INFEASIBLE],
            "failed" => &[NUMERICAL],
            "deadline" => &[STOPPED],
            _ => &[],
        };
        assert!(codes.contains(&self.code), "{self:?}");
        let verdict = &summary["check"]["verdict"];
        assert_eq!(
            self.code == DONE,
            status == "converged" && verdict == "certified",
            "{self:?}"
        );
        let (problem, coefficients) = self.read();
        let motion = Motion::replay(&problem, &coefficients);
        if status != "converged" {
            let message = summary["message"].as_str().unwrap();
            assert!(self.stderr.contains(message), "{self:?}");
            let worst = summary["worst_constraints"].as_array().unwrap();
            assert!((1..=5).contains(&worst.len()), "{self:?}");
            for row in worst {
                let of = |key: &str| row[key].as_f64().unwrap();
                assert!(
                    self.stderr.contains(row["name"].as_str().unwrap()),
                    "{self:?}"
                );
                assert!(of("node") <= problem.rod.tip() as f64);
                assert!((0.0..=problem.grid.duration() * (1.0 + 1e-12)).contains(&of("time_s")));
                assert!(
                    of("amount").is_finite() && of("multiplier").is_finite(),
                    "{row}"
                );
            }
        }
        if status == "locally-infeasible" {
            let worst = &summary["worst_constraints"][0];
            assert!(worst["amount"].as_f64().unwrap().abs() > 1e-6, "{self:?}");
            assert!(
                summary["message"]
                    .as_str()
                    .unwrap()
                    .contains(worst["name"].as_str().unwrap())
            );
        }
        for own in coefficients.chunks(problem.n_numbers()) {
            for (at, PlacedChannel { channel, .. }) in problem.channels.iter().enumerate() {
                let u = problem.vector(own, at);
                let over = channel.bound.map_or(0.0, |bound| excess(&bound, &u));
                // The accuracy of a subproblem.
                assert!(
                    over <= 1e-6 * channel.scale,
                    "{over:e} over a bound: {self:?}"
                );
            }
        }
        if self.code == DONE {
            motion.keeps(&problem);
        }
        summary
    }

    /// The problem and the controls that were written.
    fn read(&self) -> (OptimalControlProblem, Vec<f64>) {
        let path = self.result.join("scene.toml");
        let (scene, source) = Scene::load(path.to_str().unwrap(), &[]).unwrap();
        let problem = scene.optimal_control(&source).unwrap().problem;
        let named = problem.named_controls();
        let text = std::fs::read_to_string(self.result.join("controls.csv")).unwrap();
        let coefficients = (text.lines().skip(1))
            .flat_map(|line| {
                let cells = line.split(',').skip(2);
                let mut own = vec![0.0; problem.n_numbers()];
                for (control, cell) in named.iter().zip(cells) {
                    control.write(cell.parse().unwrap(), &mut own);
                }
                own
            })
            .collect();
        (problem, coefficients)
    }
}

/// How far beyond a bound a vector is.
fn excess(bound: &Bound, u: &Vector3<f64>) -> f64 {
    match bound {
        Bound::Norm(limit) => u.norm() - limit,
        Bound::PerAxis(limits) => (u.abs() - limits).max(),
        Bound::Between { lower, upper } => (u - upper).max().max((lower - u).max()),
    }
}

/// States at all time nodes, by the integrator; empty where it breaks down.
struct Motion(Vec<State>);

impl Motion {
    fn replay(problem: &OptimalControlProblem, coefficients: &[f64]) -> Self {
        let control = problem.signal(&problem.control, coefficients);
        let (rod, grid) = (&problem.rod, problem.grid);
        let mut integrator = Stepper::new(rod, grid.step, problem.initial.clone());
        let mut states = vec![problem.initial.clone()];
        for k in 0..grid.n_steps {
            if integrator
                .advance([control.at(k), control.at(k + 1)])
                .is_err()
            {
                return Self(Vec::new());
            }
            states.push(integrator.state().clone());
        }
        Self(states)
    }

    /// Hard goals are met to what the check promises (1e-4 of the length, or rad), hard limits to 1 %, at nodes and time nodes.
    #[track_caller]
    fn keeps(&self, problem: &OptimalControlProblem) {
        let rod = &problem.rod;
        assert_eq!(self.0.len(), problem.grid.n_steps + 1);
        for goal in &problem.goals {
            let (distance, angle) = match goal.enforcement {
                Enforcement::Soft { .. } => continue,
                Enforcement::Hard => (0.0, 0.0),
                Enforcement::Within {
                    distance, angle, ..
                } => (distance, angle),
            };
            let state = &self.0[goal.time_node];
            let shape = &state.configuration;
            if let Some(target) = goal.position {
                let off = (shape.positions[goal.node] - target).norm();
                assert!(
                    off <= distance + 1e-4 * rod.scales.length,
                    "{}: {off:e} m",
                    goal.name
                );
            }
            if let Some(target) = goal.rotation {
                let off = log(&(target.transpose() * shape.rotations[goal.node])).norm();
                assert!(off <= angle + 1e-4, "{}: {off:e} rad", goal.name);
            }
            if goal.at_rest {
                let speed = state.linear_momentum[goal.node].norm() / rod.nodes[goal.node].mass;
                assert!(
                    speed <= 1e-4 * rod.scales.length / rod.scales.time,
                    "{speed:e} m/s"
                );
            }
        }
        let hard = problem
            .path
            .iter()
            .filter(|path| path.enforcement == PathEnforcement::Hard);
        for path in hard {
            for states in self.0.windows(2) {
                let x = |end: usize| &states[end].configuration.positions;
                match &path.limit {
                    PathLimit::Speed { at, largest } => {
                        let node = at.node(&problem.rod.mesh);
                        let speed = (x(1)[node] - x(0)[node]).norm() / problem.grid.step;
                        assert!(speed <= 1.01 * largest, "{}: {speed} m/s", path.name);
                    }
                    PathLimit::Clearance { shape, margin, .. } => {
                        for (x, arm) in x(1).iter().zip(&problem.radii) {
                            let (distance, size) = match shape {
                                Shape::Sphere { center, radius } => {
                                    ((x - center).norm() - radius, *radius)
                                }
                                Shape::HalfSpace { point, normal } => {
                                    ((x - point).dot(normal), 0.0)
                                }
                                other => panic!("no distance of {other:?} here"),
                            };
                            let depth = arm + margin - distance;
                            assert!(depth <= 0.01 * (size + arm), "{}: {depth:e} m", path.name);
                        }
                    }
                    PathLimit::Stretch { least, largest } => {
                        for (x, rest) in x(1).windows(2).zip(&rod.rest_chords) {
                            let stretch = (x[1] - x[0]).norm() / rest;
                            assert!(
                                stretch >= least - 0.01 && stretch <= largest + 0.01,
                                "{stretch}"
                            );
                        }
                    }
                    other => panic!("no measure of {other:?} here"),
                }
            }
        }
    }
}

/// Too weak, too short a time, too slow: infeasible, and the task is named with node and time, its residual and the multiplier that
/// pulls at it with the sign of the residual.
#[test]
fn infeasible_by_physics() {
    let desk = Desk::new();
    let weak = ["control.force_max_n=0.01", "control.moment_max_n_m=0.001"];
    let short = ["time.end_s=0.02", "control.blocks=2"];
    // Too slow is known before anything is solved.
    desk.refuse(&[], &speed_limit(0.05), &["limit.0", "0.3516 m/s"]);
    for (settings, more) in [(&weak[..], ""), (&short[..], "")] {
        let summary = desk.solve(settings, more, &[INFEASIBLE]);
        let worst = &summary["worst_constraints"][0];
        assert_eq!(worst["name"], "task.position_m x", "{worst}");
        assert_eq!(worst["node"], 4);
        assert_eq!(
            worst["time_s"],
            summary["step_s"].as_f64().unwrap() * summary["steps"].as_f64().unwrap()
        );
        let of = |key: &str| worst[key].as_f64().unwrap();
        assert!(of("amount") * of("multiplier") > 0.0, "{worst}");
    }
    // With bounds like these the tip stays where it is: what is missing is the whole way, to the part that the bounds allow.
    let summary = desk.solve(&weak, "", &[INFEASIBLE]);
    let off = summary["worst_constraints"][0]["amount"].as_f64().unwrap();
    assert!((off + 0.1).abs() < 1e-3, "{off}");
}

/// Two places at once, beyond what tolerances bridge; a target within an obstacle; a start beyond a limit: refused at the key of the
/// contradiction. What is soft, tolerant enough, or said twice is no contradiction.
#[test]
fn contradictions() {
    let desk = Desk::new();
    let here = via("position_m = [0.1, 0.0, 0.985]");
    let there = |more: &str| via(&format!("position_m = [-0.1, 0.0, 0.985]\n{more}"));
    let both = format!("{here}{}", there(""));
    desk.refuse(
        &[],
        &both,
        &[
            "task.via.1.position_m",
            "task.via.0",
            "2.000e-1 m",
            "node 4",
            "t = 1.5",
        ],
    );
    let tight = format!("{here}{}", there("tolerance_m = 0.1999"));
    desk.refuse(&[], &tight, &["task.via.1.position_m", "task.via.0"]);
    let [upright, tilted] = ["[1.0, 0.0, 0.0, 0.0]", "[1.0, 0.3, 0.0, 0.0]"]
        .map(|q| via(&format!("orientation_wxyz = {q}")));
    let turned = format!("{upright}{tilted}");
    // 2 atan 0.3 = 0.5829.
    desk.refuse(
        &[],
        &turned,
        &["task.via.1.orientation_wxyz", "5.829e-1 rad"],
    );
    // Half a step before the task's time is the task's time.
    let last = here.replace("0.15", "0.29999").replace("0.1,", "-0.1,");
    desk.refuse(&[], &last, &["task.position_m", "task.via.0"]);
    let held = via("node = 0\norientation_wxyz = [1.0, 0.3, 0.0, 0.0]");
    desk.refuse(
        &[],
        &held,
        &["task.via.0.orientation_wxyz", "held", "base.kind"],
    );
    let far = via("node = 2\nposition_m = [0.4, 0.0, 0.9]");
    desk.refuse(&[], &far, &["task.via.0.position_m", "0.650 m", "node 2"]);

    let around = ball([0.25, 0.03, 0.985], 0.12, "");
    desk.refuse(
        &[],
        &around,
        &["task.position_m", "\"ball\"", "2.000e-2 m", "node 4"],
    );
    let stretched = "[[limit]]\nname = \"long\"\nstretch = [1.1, 1.3]\n";
    desk.refuse(
        &[],
        stretched,
        &["limit.0", "\"long\"", "t = 0", "1.000e-1"],
    );
    let straight = "[[limit]]\nname = \"straight\"\ncurvature_max_1_m = 0.5\n";
    let bent = [
        "rod.reference.curvature_1_m=[1.0, 0.0, 0.0]",
        "task.position_m=[0.1, -0.4, 0.8]",
    ];
    desk.refuse(
        &bent,
        straight,
        &["limit.0", "\"straight\"", "5.000e-1 1/m"],
    );
    desk.refuse(
        &bent,
        "[[limit]]\nstretch = [0.0, 0.0]\n",
        &["limit.0.stretch.1"],
    );

    for more in [
        format!("{here}{}", there("hard = false")),
        format!("{here}{}", there("tolerance_m = 0.21")),
        format!("{here}{here}"),
        ball([0.25, 0.03, 0.985], 0.12, "soft = { linear = 1.0 }"),
    ] {
        desk.solve(&[], &more, &[DONE, REJECTED]);
    }
    // A goal that is soft may lie within an obstacle: the arm stops before it.
    desk.solve(
        &["task.hard=false", "task.weight=100.0"],
        &around,
        &[DONE, REJECTED],
    );
}

/// Bounds of zero and next to it: what is held by them all cannot move, and says so; the rest position needs nothing.
#[test]
fn zero_bounds() {
    let desk = Desk::new();
    let zero = ["control.force_max_n=0.0", "control.moment_max_n_m=0.0"];
    desk.refuse(
        &zero,
        "",
        &["control", "moment_max_n_m", "nothing to control"],
    );
    desk.refuse(
        &["control.force_rate_max_n_s=0.0"],
        "",
        &["control.force_rate_max_n_s", "positive"],
    );
    for channel in zero {
        desk.solve(&[channel], "", &[DONE]);
        let stay = desk.solve(&[channel, STAY, "task.at_rest=\"tip\""], "", &[DONE]);
        assert_eq!(stay["objective"], 0.0);
    }
    // A pull along the axis only stretches a straight arm: 0.1 m aside are out of reach.
    let along = [
        "control.force_max_n=[0.0, 0.0, 20.0]",
        "control.moment_max_n_m=0.0",
    ];
    let summary = desk.solve(&along, "", &[INFEASIBLE]);
    let worst = &summary["worst_constraints"][0];
    assert_eq!(worst["name"], "task.position_m x");
    assert!(
        (worst["amount"].as_f64().unwrap() + 0.1).abs() < 1e-6,
        "{worst}"
    );
    let tiny = ["control.force_max_n=1e-12", "control.moment_max_n_m=1e-12"];
    desk.solve(&tiny, "", &[INFEASIBLE]);
    desk.solve(&[tiny[0], tiny[1], STAY], "", &[DONE]);
    // As good as one block, and the tip comes with a speed that this needs.
    let slow = [
        "control.force_rate_max_n_s=1e-12",
        "control.moment_rate_max_n_m_s=1e-12",
    ];
    let held = desk.solve(&slow, "", &[DONE, REJECTED]);
    let one = desk.solve(&["control.blocks=1"], "", &[DONE, REJECTED]);
    let of = |summary: &Value| summary["objective"].as_f64().unwrap();
    assert!((of(&held) / of(&one) - 1.0).abs() < 1e-6);
}

/// The tip where the base is: infeasible with little force, something or other with much, and a compromise where it is soft. A
/// straight arm in line with its target is no proof that it cannot get nearer.
#[test]
fn target_at_the_base() {
    let desk = Desk::new();
    let strong = [
        "control.force_max_n=200.0",
        "control.moment_max_n_m=50.0",
        "time.end_s=0.6",
    ];
    desk.solve(&[BASE], "", &[INFEASIBLE, NOT_CONVERGED]);
    desk.solve(
        &[&[BASE][..], &strong[..]].concat(),
        "",
        &[INFEASIBLE, NOT_CONVERGED, DONE, REJECTED],
    );
    let light = [BASE, "task.hard=false", "task.weight=1.0"];
    desk.solve(&light, "", &[DONE, REJECTED]);
    // A soft goal is met by its own variable at any weight, and never infeasible.
    let heavy = [
        BASE,
        "task.hard=false",
        "task.weight=1e6",
        "solver.max_iterations=100",
    ];
    desk.solve(&heavy, "", &[DONE, REJECTED, NOT_CONVERGED]);
    // Pressed straight down, the tip yields 17 mm under the 20 N; bent, it comes lower than that.
    let below = ["task.position_m=[0.0, 0.0, 0.9]"];
    let summary = desk.solve(&below, "", &[DONE, REJECTED, NOT_CONVERGED, INFEASIBLE]);
    let off = summary["tip_error_m"].as_f64().unwrap();
    assert!(off < 0.05, "{off}");
}

/// Obstacles around the base and around the whole arm are refused where the arm begins in them, and paid for where they are soft.
/// Those that only touch it can be left.
#[test]
fn obstacles_at_the_start() {
    let desk = Desk::new();
    let at_base = ball([0.0, 0.0, 0.0], 0.1, "");
    desk.refuse(
        &[],
        &at_base,
        &["obstacle.0", "\"ball\"", "t = 0", "node 0", "1.500e-1 m"],
    );
    let cage = "[[obstacle]]\nname = \"cage\"\ncapsule = { from_m = [0.0, 0.0, -1.0], to_m = [0.0, 0.0, 2.0], radius_m = 1.0 }\n";
    desk.refuse(&[], cage, &["obstacle.0", "\"cage\"", "1.050e0 m"]);
    let paid = desk.solve(&[], &format!("{cage}soft = {{ linear = 1.0 }}\n"), &[DONE]);
    // Nine points of the arm and more, all a radius deep, at a price of 1 per length and second.
    assert!(paid["objective"].as_f64().unwrap() > 0.3 * 1.0);
    let tip = ball([-0.15, 0.0, 1.0], 0.1, "");
    let middle = ball([0.15, 0.0, 0.5], 0.1, "");
    for touching in [tip, middle] {
        let summary = desk.solve(&[], &touching, &[DONE]);
        assert_eq!(summary["guess"], "rest");
    }
    let behind = wall(-0.05);
    let away = ["task.position_m=[-0.1, 0.03, 0.985]"];
    desk.refuse(
        &away,
        &behind,
        &["task.position_m", "\"wall\"", "1.000e-1 m"],
    );
}

/// One block, one step, two steps, a block for every step, by every hold.
#[test]
fn short_horizons() {
    let desk = Desk::new();
    desk.solve(&["control.blocks=1"], "", &[DONE, REJECTED]);
    // Nine conditions on six numbers.
    desk.solve(
        &["control.blocks=1", "task.at_rest=\"tip\""],
        "",
        &[INFEASIBLE],
    );
    for hold in ["constant", "linear", "cubic"] {
        let hold = format!("control.hold=\"{hold}\"");
        let one = [
            hold.as_str(),
            "time.end_s=5e-4",
            "time.step_s=5e-4",
            "control.blocks=1",
        ];
        let two = [
            hold.as_str(),
            "time.end_s=1e-3",
            "time.step_s=5e-4",
            "control.blocks=2",
        ];
        for (steps, settings) in [(1, one), (2, two)] {
            let summary = desk.solve(&settings, "", &[INFEASIBLE]);
            assert_eq!(summary["steps"], steps);
            for rest in ["task.at_rest=false", "task.at_rest=\"tip\""] {
                desk.solve(&[&settings[..], &[STAY, rest][..]].concat(), "", &[DONE]);
            }
        }
        let all = format!("{}{}", speed_limit(1.0), ball([0.5, 0.0, 0.5], 0.1, ""));
        desk.solve(&[&one[..], &[STAY][..]].concat(), &all, &[DONE]);
        let each = [
            hold.as_str(),
            "time.end_s=1e-2",
            "time.step_s=5e-4",
            "control.blocks=20",
            "task.position_m=[0.001, 0.0, 1.0]",
        ];
        let summary = desk.solve(&each, "", &[DONE]);
        assert_eq!(summary["steps"], 20);
    }
}

/// Weights and prices from 1e-12 to 1e12: an optimum does not depend on the unit of its objective, negligible terms change nothing,
/// prices that are never paid are no matter; where digits run out it is said. A soft task that weighs nothing is not gone to, one that
/// weighs much is reached.
#[test]
fn extreme_weights() {
    let desk = Desk::new();
    let of = |summary: &Value| summary["objective"].as_f64().unwrap();
    let plain = of(&desk.solve(&[], "", &[DONE]));
    desk.refuse(
        &["objective.effort=0.0"],
        "",
        &["objective.effort", "objective.rate"],
    );
    for (weight, factor) in [("1e-12", 1e-12), ("1e12", 1e12)] {
        let effort = desk.solve(&[&format!("objective.effort={weight}")], "", &[DONE]);
        // To the multipliers times what the target may be missed by, 1e-9 of its scale.
        assert!((of(&effort) / (factor * plain) - 1.0).abs() < 1e-8);
        let soft = format!("task.weight={weight}");
        let soft = desk.solve(&["task.hard=false", &soft], "", &[DONE]);
        let off = soft["tip_error_m"].as_f64().unwrap();
        // 0.1 aside, 0.03 across, 0.015 down; or, at this weight, less than the multiplier 1 over it.
        let expected = if factor < 1.0 { 0.105_475_1 } else { 0.0 };
        assert!((off - expected).abs() < 1e-6, "{off}");
        for price in ["linear", "quadratic"] {
            let aside = ball(
                [0.2, 0.0, 0.75],
                0.08,
                &format!("soft = {{ {price} = {weight} }}"),
            );
            let summary = desk.solve(&[], &aside, &[DONE]);
            assert!((of(&summary) / plain - 1.0).abs() < 1e-9);
        }
    }
    let path = |weight: &str| {
        format!(
            "[[objective.track]]\npath_m = [[0.0, 0.0, 0.0, 1.0], [0.3, 0.1, 0.03, 0.985]]\nweight = {weight}\n"
        )
    };
    for small in ["objective.rate=1e-12", "objective.energy=1e-12"] {
        assert!((of(&desk.solve(&[small], "", &[DONE])) / plain - 1.0).abs() < 1e-9);
    }
    assert!((of(&desk.solve(&[], &path("1e-12"), &[DONE])) / plain - 1.0).abs() < 1e-9);
    // Twelve digits of 1e12 are those of the effort, or of the multipliers: what remains is enough to solve for the large term alone, and for
    // both where the other does not compete with it. A path that cannot be kept competes with the target by 1e12: the target is met, and the
    // last digits of the controls may be out of reach.
    let few = "solver.max_iterations=30";
    for settings in [
        &["objective.rate=1e12", few][..],
        &["objective.rate=1e12", "objective.effort=0.0", few][..],
        &["objective.energy=1e12", few][..],
    ] {
        // Four elements are at the limit of what the check calls resolved.
        let summary = desk.solve(settings, "", &[DONE, REJECTED]);
        assert_resolved_or_coarse(&summary);
        assert_eq!(summary["status"], "converged");
        assert!(summary["tip_error_m"].as_f64().unwrap() < 1e-6);
    }
    let summary = desk.solve(&[few], &path("1e12"), &[DONE, NOT_CONVERGED, REJECTED]);
    if summary["status"] == "converged" {
        assert_resolved_or_coarse(&summary);
    }
    assert!(summary["tip_error_m"].as_f64().unwrap() < 1e-5);
    // Beyond what floating point holds: typed as well.
    for wild in [
        "objective.effort=1e300",
        "objective.rate=1e300",
        "objective.energy=1e300",
    ] {
        desk.solve(&[wild], "", &[NUMERICAL, NOT_CONVERGED, REJECTED]);
    }
    // Without a weight of its own a soft goal is reached to some thousandths of the way, and what is left is said.
    let soft = desk.solve(&["task.hard=false", "time.end_s=1.0"], "", &[DONE]);
    let left = soft["soft_goals"][0]["left_m"].as_f64().unwrap();
    assert!(left > 0.0 && left < 5e-3 * 0.105, "{left}");
    assert!(
        (soft["tip_error_m"].as_f64().unwrap() / left - 1.0).abs() < 1e-3,
        "{soft}"
    );
    // The terms of a soft goal's residuals, weight times residual, do not hide what is left along the controls.
    let near = [
        "task.hard=false",
        "task.weight=1000.0",
        "task.position_m=[0.001, 0.0, 1.0]",
        "task.at_rest=\"tip\"",
    ];
    desk.solve(&near, "", &[DONE]);
}

/// The check objects to nothing but the number of elements.
fn assert_resolved_or_coarse(summary: &Value) {
    let failed = summary["check"]["failed"].as_array().unwrap();
    assert!(
        failed.iter().all(|name| name == "refined_space_m"),
        "{failed:?}"
    );
}

/// Starts that are of no use, and ends that come at once.
#[test]
fn starts_and_limits() {
    let desk = Desk::new();
    let weak = ["control.force_max_n=0.01", "control.moment_max_n_m=0.001"];
    let many = ["--starts", "8", "--threads", "2"];
    for (settings, code) in [
        (&weak[..], INFEASIBLE),
        (&["solver.max_iterations=1"][..], NOT_CONVERGED),
        (&["solver.deadline_s=1e-9"][..], STOPPED),
    ] {
        let summary = desk.solve_with(settings, "", &many, &[code]);
        let starts = summary["starts"].as_array().unwrap();
        assert_eq!(starts.len(), 8);
        assert!(starts.iter().all(|start| start["status"] != "converged"));
        desk.solve(settings, "", &[code]);
    }
    desk.refuse(
        &["solver.deadline_s=0.0"],
        "",
        &["solver.deadline_s", "positive"],
    );
    desk.refuse(&["solver.max_iterations=0"], "", &["solver.max_iterations"]);

    // From a solution, of this scene and of another, and from controls that no arm survives: the same optimum.
    let plain = desk.solve_with(&[], "", &["--out", "earlier"], &[DONE]);
    let from = ["--from", "earlier"];
    let again = desk.solve_with(&[], "", &from, &[DONE]);
    assert_eq!(again["guess"], "previous");
    assert!(again["iterations"].as_u64() <= Some(1));
    desk.solve_with(
        &["rod.elements=6", "control.blocks=7", "time.end_s=0.5"],
        "",
        &from,
        &[DONE],
    );
    let path = desk.folder.path().join("earlier/controls.csv");
    let written = std::fs::read_to_string(&path).unwrap();
    for huge in ["1e6", "1e300"] {
        let rows = written.lines().enumerate().map(|(i, line)| {
            let mut cells: Vec<&str> = line.split(',').collect();
            if i > 0 {
                (cells[2], cells[6]) = (huge, huge);
            }
            cells.join(",") + "\n"
        });
        std::fs::write(&path, rows.collect::<String>()).unwrap();
        let summary = desk.solve_with(&[], "", &from, &[DONE]);
        let of = |summary: &Value| summary["objective"].as_f64().unwrap();
        assert!((of(&summary) / of(&plain) - 1.0).abs() < 1e-6);
    }
    for word in ["nan", "inf"] {
        let first = written.lines().nth(1).unwrap();
        let cell = first.split(',').nth(2).unwrap();
        std::fs::write(&path, written.replacen(cell, word, 1)).unwrap();
        let run = desk.run("solve", SCENE, &[], &from);
        assert_eq!(run.code, USAGE, "{run:?}");
        assert!(run.stderr.contains("controls.csv") && run.stderr.contains("finite"));
    }
}

/// Rest before the end of the horizon is not a condition that can be made: a solve says whose it is, and when.
#[test]
fn rest_on_the_way_is_refused() {
    let desk = Desk::new();
    desk.solve(&[], "", &[DONE]);
    let path = desk.folder.path().join("scene.toml");
    let (scene, source) = Scene::load(path.to_str().unwrap(), &[]).unwrap();
    let setup = scene.optimal_control(&source).unwrap();
    let mut problem = setup.problem;
    for enforcement in [Enforcement::Hard, Enforcement::Soft { weight: 1.0 }] {
        problem.goals[0] = Goal {
            name: "pause".into(),
            time_node: 7,
            at_rest: true,
            enforcement,
            ..problem.goals[0].clone()
        };
        let program = Transcription::new(&problem, 1);
        let (start, _) = first_point(&problem, Guess::Rest, None).unwrap();
        let outcome = solve(&program, start, &setup.settings, &mut |_| {
            ControlFlow::Continue(())
        });
        let SqpStatus::Failed(reason) = outcome.status else {
            panic!("{:?}", outcome.status)
        };
        assert!(reason.contains("pause.at_rest at time node 7"), "{reason}");
    }
}

/// A file of a result without what the clock says: the columns and fields of times, and the folder.
fn timeless(folder: &std::path::Path, name: &str) -> Vec<u8> {
    let bytes = std::fs::read(folder.join(name)).unwrap();
    let text = || String::from_utf8(bytes.clone()).unwrap();
    match name {
        "summary.json" => {
            let mut summary: Value = serde_json::from_str(&text()).unwrap();
            let fields = summary.as_object_mut().unwrap();
            for field in ["wall_s", "iteration_s", "phases_s", "directory"] {
                fields.remove(field).unwrap();
            }
            summary.to_string().into_bytes()
        }
        "iterations.csv" => {
            let text = text();
            let mut heads = text.lines().next().unwrap().split(',');
            let clock = heads.position(|head| head == "elapsed_s").unwrap();
            let rows = text.lines().map(|line| {
                let cells = line.split(',').enumerate();
                let kept: Vec<_> = cells
                    .filter(|(i, _)| *i != clock)
                    .map(|(_, cell)| cell)
                    .collect();
                kept.join(",")
            });
            rows.collect::<Vec<_>>().join("\n").into_bytes()
        }
        "report.html" => {
            let without = |text: String, from: &str, to: &str| {
                let (before, rest) = text.split_once(from).unwrap();
                let (_, after) = rest.split_once(to).unwrap();
                [before, after].concat()
            };
            let text = without(text(), "; computed in ", "\"");
            let text = without(text, "[\"wall time\",", "]");
            let text = without(text, "\"wall_s\":", "\"kkt\":");
            without(text, "\"directory\":", "}").into_bytes()
        }
        _ => bytes,
    }
}

/// The same scene and seed by one thread and by two, with one start and with four, and once more: the same bytes in every file, times
/// aside, converged or not. Another seed makes other detours, and the first start the same.
#[test]
fn results_are_the_same_bytes() {
    let desk = Desk::new();
    let obstacle = ball([0.2, 0.0, 0.75], 0.08, "");
    let weak = ["control.force_max_n=0.01", "control.moment_max_n_m=0.001"];
    for (settings, more, code) in [
        (&[][..], obstacle.as_str(), DONE),
        (&weak[..], "", INFEASIBLE),
    ] {
        for starts in ["1", "4"] {
            let solve = |out: &str, threads: &str, seed: &str| {
                let arguments = [
                    "--out",
                    out,
                    "--starts",
                    starts,
                    "--threads",
                    threads,
                    "--seed",
                    seed,
                ];
                desk.solve_with(settings, more, &arguments, &[code])
            };
            let first = solve("first", "1", "7");
            solve("second", "2", "7");
            solve("third", "2", "7");
            let [first_folder, others @ ..] =
                ["first", "second", "third"].map(|out| desk.folder.path().join(out));
            let mut names: Vec<String> = std::fs::read_dir(&first_folder)
                .unwrap()
                .map(|entry| entry.unwrap().file_name().into_string().unwrap())
                .collect();
            names.sort();
            assert!(names.len() >= 7, "{names:?}");
            for name in &names {
                for other in &others {
                    let same = timeless(&first_folder, name) == timeless(other, name);
                    assert!(same, "{name} of {}", other.display());
                }
            }
            if starts == "4" {
                let other = solve("other", "2", "8");
                let of = |summary: &Value, i: usize| {
                    let start = &summary["starts"][i];
                    (start["objective"].clone(), start["iterations"].clone())
                };
                assert_eq!(of(&first, 0), of(&other, 0));
                assert!((1..4).any(|i| of(&first, i) != of(&other, i)));
            }
        }
    }
}

/// A thin wire on a winch that pulls 4 mm within one implicit step: what the step does not resolve changes its sign from step to step for good,
/// and a sentence and the summary say so. Pulled over twenty steps it does not ring, and nothing is said.
#[test]
fn ringing_motions_are_told() {
    let scene = |pulled: f64| {
        format!(
            r#"
[rod]
length_m = 0.1865
elements = 9
[rod.material]
youngs_modulus_pa = 50e9
poisson_ratio = 0.3
density_kg_m3 = 20000.0
[rod.section]
radius_m = 0.5e-3
[damping]
viscous_1_s = 60.0
internal_s = 0.02
[[tendon]]
offset_m = [0.0045, 0.0]
displacement_profile = [[0.0, 0.0], [{pulled}, -4e-3]]
compliance_1_n = 1.4e-5
free_length_m = 10.0
[time]
end_s = 1.0
step_s = 0.02
integrator = "implicit"
"#
        )
    };
    let desk = Desk::new();
    let told = |pulled: f64| {
        let run = desk.run("simulate", &scene(pulled), &[], &["--out", "run"]);
        assert_eq!(run.code, DONE, "{run:?}");
        let summary: Value = serde_json::from_str(&run.stdout).unwrap();
        let rings = summary["ringing_J"].as_f64();
        let said = summary["warnings"]
            .to_string()
            .contains("change their sign from step to step");
        assert_eq!(rings.is_some(), said, "{run:?}");
        rings
    };
    assert!(told(0.02).is_some_and(|energy| energy > 1e-5));
    assert_eq!(told(0.4), None);
}
