//! Deadlines and Ctrl-C: work ends soon, whatever it is busy with, and what there is by then is written.
//!
//! How soon is measured in processor time, which does not depend on what else a machine does, and in forward simulations of the same scene:
//! uninterrupted, every phase that is stopped here takes many times as long. Where the system does not say what time a process used, the
//! outcomes alone are compared.

#![cfg(all(unix, feature = "cli"))]

use crate::tool;

use std::io::{BufRead as _, BufReader, Read as _};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::Value;
use tempfile::TempDir;
use tool::{DONE, SCENE, STOPPED, USAGE};

struct Desk {
    folder: TempDir,
}

impl Desk {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("scene.toml"), SCENE).unwrap();
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn command(&self, verb: &[&str], settings: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_softarm"));
        command
            .args(verb)
            .args(settings.iter().flat_map(|setting| ["--set", setting]))
            .current_dir(self.folder.path())
            .env("NO_COLOR", "1");
        command
    }

    /// Runs a command to its end.
    fn ended(&self, verb: &[&str], settings: &[&str]) -> End {
        let mut child = (self.command(verb, settings))
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut talk = String::new();
        let mut pipe = child.stderr.take().unwrap();
        pipe.read_to_string(&mut talk).unwrap();
        End {
            used: processor_time(&child),
            code: child.wait().unwrap().code().unwrap(),
            talk,
        }
    }

    fn summary(&self, result: &str) -> Value {
        let text = std::fs::read_to_string(self.path(result).join("summary.json")).unwrap();
        serde_json::from_str(&text).unwrap()
    }

    /// The processor time that may be used from the moment when work is to end: a few forward simulations, and a second to begin and to write.
    fn allowance(&self, settings: &[&str]) -> Duration {
        let few_rows = [settings, &["output.rate_hz=20"]].concat();
        let once = self.ended(&["simulate", "scene.toml", "--out", "once"], &few_rows);
        assert_eq!(once.code, DONE, "{}", once.talk);
        Duration::from_secs(1) + 4 * once.used
    }
}

/// How a command ended.
struct End {
    code: i32,
    /// Processor time of all threads; zero where the system does not say.
    used: Duration,
    talk: String,
}

/// Processor time of a process so far, which may have ended already; zero where there is no `/proc` that says it.
fn processor_time(child: &Child) -> Duration {
    /// Unit of these times, s: `USER_HZ` of Linux.
    const TICK: f64 = 0.01;
    let Ok(stat) = std::fs::read_to_string(format!("/proc/{}/stat", child.id())) else {
        return Duration::ZERO;
    };
    // After the name in parentheses, the 12th and 13th word are the times in user and in system mode (proc_pid_stat(5)).
    let (_, words) = stat.rsplit_once(')').unwrap();
    let ticks = words.split_whitespace().skip(11).take(2);
    let ticks: f64 = ticks.map(|word| word.parse::<f64>().unwrap()).sum();
    Duration::from_secs_f64(TICK * ticks)
}

/// Interrupts a command as Ctrl-C does once a line of its talk is the one; the time is that used from then. The command is halted while it is
/// measured, so that it does not get on meanwhile.
fn interrupted(mut command: Command, is_moment: impl Fn(&str) -> bool) -> End {
    let mut child = command
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut pipe = BufReader::new(child.stderr.take().unwrap());
    let mut talk = String::new();
    loop {
        let mut line = String::new();
        assert!(
            pipe.read_line(&mut line).unwrap() > 0,
            "it never came to that:\n{talk}"
        );
        talk.push_str(&line);
        if is_moment(&line) {
            break;
        }
    }
    signal(&child, "STOP");
    let before = processor_time(&child);
    signal(&child, "INT");
    signal(&child, "CONT");
    pipe.read_to_string(&mut talk).unwrap();
    End {
        used: processor_time(&child).saturating_sub(before),
        code: child.wait().unwrap().code().unwrap(),
        talk,
    }
}

fn signal(child: &Child, name: &str) {
    let arguments = [format!("-{name}"), child.id().to_string()];
    let status = Command::new("kill").args(arguments).status().unwrap();
    assert!(status.success());
}

/// Implicit steps, of which one roll-out is a fraction of a second, a sweep many of these, and a check hundreds.
const HEAVY: &[&str] = &[
    "time.integrator=\"implicit\"",
    "time.step_s=2e-5",
    "rod.elements=16",
];

/// Work that takes minutes ends at its deadline: plain, from many starts, with many variables, with a free duration, with an obstacle's
/// rows at every step, and on the sparse route; the result says that it was not checked, and whether residuals were still falling.
#[test]
fn deadlines_hold() {
    let desk = Desk::new();
    let allowance = desk.allowance(HEAVY);
    let starts = ["--starts", "6", "--threads", "2"];
    let plain = ["--threads", "1"];
    let duration = "task.free_duration={shortest_s=0.2, longest_s=0.5, price=1.0}";
    let obstacle =
        "obstacle=[{name=\"ball\", sphere={center_m=[0.3, 0.3, 0.6], radius_m=0.1}, rate_hz=5000}]";
    let many = "control.blocks=100";
    for (name, extra, flags, n_threads) in [
        ("plain", &[][..], &plain[..], 1),
        ("starts", &[][..], &starts[..], 2),
        ("many", &[many][..], &plain[..], 1),
        ("duration", &[duration][..], &plain[..], 1),
        ("obstacle", &[obstacle][..], &plain[..], 1),
        ("exact", &["solver.hessian=\"exact\""][..], &plain[..], 1),
    ] {
        let settings = [HEAVY, extra, &["solver.deadline_s=1.0"]].concat();
        let verb = [&["solve", "scene.toml", "--out", name], flags].concat();
        let End { code, used, talk } = desk.ended(&verb, &settings);
        assert_eq!(code, STOPPED, "{name}: {talk}");
        let allowed = n_threads * Duration::from_secs(1) + allowance;
        assert!(used < allowed, "{name}: {used:?} of {allowed:?}\n{talk}");
        let summary = desk.summary(name);
        assert_eq!(summary["check"]["verdict"], "not checked", "{name}");
        assert!(talk.contains("not checked"), "{name}: {talk}");
        if summary["iterations"].as_u64() > Some(0) && name == "plain" {
            let trend = summary["progress"]["trend"].as_str().unwrap();
            assert!(["falling", "stalled"].contains(&trend), "{trend}");
            assert!(talk.contains("residuals were"), "{talk}");
        }
        assert!(desk.path(name).join("controls.csv").is_file());
    }
}

/// Ctrl-C ends an iteration half-way, and a check right after the solver has converged: exit code 6, the result is written, and says that it
/// converged but was not checked. So does `verify`.
#[test]
fn ctrl_c_is_obeyed_in_every_phase() {
    let desk = Desk::new();
    let allowance = desk.allowance(HEAVY);
    let solve = |name| ["solve", "scene.toml", "--threads", "1", "--out", name];
    let is_row = |line: &str| line.trim_start().starts_with("0 ");
    let command = desk.command(&solve("iterating"), HEAVY);
    let End { code, used, talk } = interrupted(command, is_row);
    assert_eq!(code, STOPPED, "{talk}");
    assert!(used < allowance, "{used:?} of {allowance:?}");
    assert_eq!(desk.summary("iterating")["status"], "interrupted");

    // The last row has no step. A check that was done before the signal came is made longer.
    let is_last = |line: &str| line.split_whitespace().nth(7) == Some("-");
    let checking = |step: f64| {
        let heavy = [
            "time.integrator=\"implicit\"",
            &format!("time.step_s={step}"),
        ];
        let command = desk.command(&[&solve("checking")[..], &["--deep"]].concat(), &heavy);
        interrupted(command, is_last)
    };
    let steps = [1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5];
    let mut ends = steps.into_iter().map(checking);
    let End { code, used, talk } = ends.find(|end| end.code != DONE).expect("no check ends");
    assert_eq!(code, STOPPED, "{talk}");
    assert!(used < allowance, "{used:?} of {allowance:?}");
    let summary = desk.summary("checking");
    assert_eq!(summary["status"], "converged");
    assert_eq!(summary["check"]["verdict"], "not checked");
    assert!(talk.contains("converged, not checked"), "{talk}");
}

/// A result of many steps, of which all are needed to check it, is packed with fewer rows when nobody waits for it.
#[test]
fn stopped_motions_are_written_in_short() {
    let desk = Desk::new();
    let settings = ["time.step_s=1e-5", "solver.deadline_s=1e-3"];
    let End { code, talk, .. } = desk.ended(&["solve", "scene.toml", "--out", "short"], &settings);
    assert_eq!(code, STOPPED, "{talk}");
    let stride = desk.summary("short")["steps_per_row"].as_u64().unwrap();
    assert!(
        stride > 1 && talk.contains(&format!("every {stride} steps")),
        "{talk}"
    );
    let size = std::fs::metadata(desk.path("short").join("trajectory.npz"))
        .unwrap()
        .len();
    assert!(size < 5_000_000, "{size}");
    // What was not stopped has them all.
    let End { code, talk, .. } = desk.ended(&["solve", "scene.toml", "--out", "long"], &[]);
    assert_eq!(code, DONE, "{talk}");
    assert_eq!(desk.summary("long")["steps_per_row"], Value::Null);
}

/// A deadline that is not reached changes nothing, to the byte.
#[test]
fn a_deadline_that_is_far_changes_nothing() {
    let desk = Desk::new();
    for (name, settings) in [
        ("without", &[][..]),
        ("with", &["solver.deadline_s=3600.0"][..]),
    ] {
        let End { code, talk, .. } = desk.ended(&["solve", "scene.toml", "--out", name], settings);
        assert_eq!(code, DONE, "{talk}");
    }
    for file in [
        "controls.csv",
        "trajectory.npz",
        "multipliers.json",
        "feedback.npz",
    ] {
        let [a, b] =
            ["without", "with"].map(|name| std::fs::read(desk.path(name).join(file)).unwrap());
        assert!(a == b, "{file}");
    }
}

/// What a process may not have is refused before the work begins, with what it takes and what there is; no command dies of it.
#[test]
#[cfg(target_os = "linux")]
fn too_little_memory_is_refused() {
    let desk = Desk::new();
    let limited = |verb: &str, settings: &str| {
        let tool = env!("CARGO_BIN_EXE_softarm");
        let line = format!("ulimit -v 400000; exec {tool} {verb} {settings}");
        let output = Command::new("sh")
            .args(["-c", &line])
            .current_dir(desk.folder.path())
            .output()
            .unwrap();
        (
            output.status.code(),
            String::from_utf8(output.stderr).unwrap(),
        )
    };
    let solve = "solve scene.toml --threads 1 --out limited";
    let (code, talk) = limited(solve, "--set time.step_s=1e-6");
    assert_eq!(code, Some(USAGE), "{talk}");
    for words in [
        "time.step_s: needs about",
        "the limit of the address space",
        "MB",
        "longer time.step_s",
    ] {
        assert!(talk.contains(words), "no `{words}` in: {talk}");
    }
    let (code, talk) = limited(solve, "--set control.blocks=300");
    assert_eq!(code, Some(USAGE), "{talk}");
    assert!(talk.contains("control.blocks: needs about"), "{talk}");
    let (code, talk) = limited(solve, "");
    assert_eq!(code, Some(DONE), "{talk}");
    let (code, talk) = limited("verify limited", "");
    assert_eq!(code, Some(DONE), "{talk}");
    let (code, talk) = limited("verify limited", "--set time.step_s=1e-6 --quick");
    assert_eq!(code, Some(USAGE), "{talk}");
    assert!(talk.contains("needs about"), "{talk}");
}
