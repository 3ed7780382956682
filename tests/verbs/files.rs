//! What the tool writes, what it leaves alone, and what is left after it was stopped, killed, or out of room.

#![cfg(feature = "cli")]

use crate::tool;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;
use tool::{DONE, HANGS, NOT_CONVERGED, SCENE, STOPPED, UNWRITTEN, USAGE};

/// A folder of its own with a scene in it, which is solved and simulated in a blink.
struct Desk {
    folder: TempDir,
}

/// An unreachable tolerance: a solve of `SCENE` that ends only when it is stopped.
const ENDLESS: [&str; 4] = [
    "--set",
    "solver.tolerance=1e-300",
    "--set",
    "solver.max_iterations=1000000",
];

impl Desk {
    fn new() -> Self {
        let desk = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        fs::write(desk.path("scene.toml"), SCENE).unwrap();
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_softarm"));
        command.args(arguments);
        self.prepared(command)
    }

    fn prepared(&self, mut command: Command) -> Command {
        command
            .current_dir(self.folder.path())
            .env("TMPDIR", self.folder.path())
            .env("HOME", self.folder.path())
            .env("NO_COLOR", "1");
        command
    }

    #[track_caller]
    fn run(&self, arguments: &[&str]) -> Run {
        Run::of(&self.command(arguments).output().unwrap())
    }

    /// Starts the tool, and waits until `ready`.
    fn start(&self, arguments: &[&str], ready: impl Fn() -> bool) -> Child {
        let mut child = (self.command(arguments))
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let started = Instant::now();
        while !ready() {
            if started.elapsed() > HANGS || child.try_wait().unwrap().is_some() {
                let _ = child.kill();
                panic!("ended, or never ready: {arguments:?}");
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        child
    }
}

struct Run {
    code: Option<i32>,
    stdout: String,
    stderr: String,
}

impl Run {
    #[track_caller]
    fn of(output: &Output) -> Self {
        let run = Self {
            code: output.status.code(),
            stdout: String::from_utf8_lossy(&output.stdout).into(),
            stderr: String::from_utf8_lossy(&output.stderr).into(),
        };
        assert!(!run.stderr.contains("panicked"), "{}", run.stderr);
        run
    }

    #[track_caller]
    fn exits(self, code: i32) -> Self {
        assert_eq!(self.code, Some(code), "{}\n{}", self.stdout, self.stderr);
        self
    }

    #[track_caller]
    fn says(&self, words: &[&str]) {
        for word in words {
            assert!(
                self.stderr.contains(word),
                "no `{word}` in:\n{}",
                self.stderr
            );
        }
    }
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

/// A rerun replaces the files of the result, removes those that it does not write, and leaves a user's files and folders where they
/// are; the result of the other command is not replaced, by neither.
#[test]
fn a_rerun_leaves_the_users_files() {
    let desk = Desk::new();
    let run = |verb: &str, out: &str, more: &[&str]| {
        desk.run(&[&[verb, "scene.toml", "--out", out], more].concat())
    };
    run("solve", "solved", &[]).exits(DONE);
    run(
        "simulate",
        "simulated",
        &["--set", "output.diagnostics=true"],
    )
    .exits(DONE);
    for out in ["solved", "simulated"] {
        fs::write(desk.path(&format!("{out}/notes.md")), "mine").unwrap();
        fs::create_dir(desk.path(&format!("{out}/figures"))).unwrap();
        fs::write(desk.path(&format!("{out}/figures/summary.json")), "mine").unwrap();
        fs::write(desk.path(&format!("{out}/report.html")), "spoiled").unwrap();
    }
    let before = names(&desk.path("solved"));
    run("solve", "simulated", &[]).exits(USAGE).says(&[
        "simulated",
        "`softarm simulate`",
        "another --out",
    ]);
    run("simulate", "solved", &[]).exits(USAGE).says(&[
        "solved",
        "`softarm solve`",
        "another --out",
    ]);
    // One iteration: no feedback around what is no solution.
    run("solve", "solved", &["--set", "solver.max_iterations=1"]);
    run("simulate", "simulated", &[]).exits(DONE);

    let mut expected = before;
    expected.retain(|name| name != "feedback.npz");
    assert_eq!(names(&desk.path("solved")), expected);
    assert!(!desk.path("simulated/diagnostics.npz").exists());
    for out in ["solved", "simulated"] {
        let read = |name: &str| fs::read_to_string(desk.path(out).join(name)).unwrap();
        assert_eq!(read("notes.md"), "mine");
        assert_eq!(read("figures/summary.json"), "mine");
        assert_ne!(read("report.html"), "spoiled");
        let summary: Value = serde_json::from_str(&read("summary.json")).unwrap();
        let keys: Vec<&String> = summary.as_object().unwrap().keys().take(3).collect();
        assert_eq!(keys, ["schema_version", "tool", "command"]);
        assert_eq!(summary["tool"], "softarm");
    }
    assert_eq!(
        names(desk.folder.path()),
        ["scene.toml", "simulated", "solved"]
    );
}

/// A directory with somebody's files, with somebody's summary of any version, and a link are no targets, and stay as they are.
#[test]
fn foreign_directories_are_not_written_into() {
    let desk = Desk::new();
    fs::create_dir(desk.path("thesis")).unwrap();
    fs::write(desk.path("thesis/report.html"), "mine").unwrap();
    for summary in [
        "",
        "mine",
        "[]",
        r#"{"schema_version": 1}"#,
        r#"{"schema_version": 1, "command": "solve"}"#,
        r#"{"schema_version": 1, "tool": "other", "command": "solve"}"#,
        r#"{"schema_version": 1, "tool": "softarm", "command": "check"}"#,
    ] {
        fs::write(desk.path("thesis/summary.json"), summary).unwrap();
        for verb in ["solve", "simulate"] {
            desk.run(&[verb, "scene.toml", "--out", "thesis"])
                .exits(USAGE)
                .says(&["thesis", "no result of softarm"]);
        }
        assert_eq!(names(&desk.path("thesis")), ["report.html", "summary.json"]);
        let read = |name: &str| fs::read_to_string(desk.path("thesis").join(name)).unwrap();
        assert_eq!(read("summary.json"), summary);
        assert_eq!(read("report.html"), "mine");
    }
    assert_eq!(names(desk.folder.path()), ["scene.toml", "thesis"]);
}

/// Links in the place of the result, and of the directory of the run, are refused, and what they lead to is as it was.
#[cfg(unix)]
#[test]
fn links_lead_nowhere() {
    let desk = Desk::new();
    fs::create_dir(desk.path("home")).unwrap();
    fs::write(desk.path("home/letters"), "mine").unwrap();
    for link in ["run", ".run.running"] {
        std::os::unix::fs::symlink(desk.path("home"), desk.path(link)).unwrap();
        for verb in ["solve", "simulate"] {
            for out in ["run", "run/", "./run"] {
                desk.run(&[verb, "scene.toml", "--out", out])
                    .exits(USAGE)
                    .says(&[link]);
            }
        }
        fs::remove_file(desk.path(link)).unwrap();
    }
    assert_eq!(names(&desk.path("home")), ["letters"]);
    assert_eq!(names(desk.folder.path()), ["home", "scene.toml"]);
}

/// A second solve into a directory is refused while the first lives; what the first leaves when it is killed is gone after the next.
#[test]
fn two_solves_do_not_share_a_directory() {
    let desk = Desk::new();
    let solve = ["solve", "scene.toml", "--out", "run"];
    let lock = desk.path(".run.running/lock");
    let mut first = desk.start(&[&solve[..], &ENDLESS].concat(), || lock.exists());
    desk.run(&solve)
        .exits(USAGE)
        .says(&["another run", ".run.running"]);
    first.kill().unwrap();
    first.wait().unwrap();
    assert_eq!(names(desk.folder.path()), [".run.running", "scene.toml"]);
    desk.run(&solve).exits(DONE);
    assert_eq!(names(desk.folder.path()), ["run", "scene.toml"]);
}

/// The directory in which one is can hold the result: its files are written into it, and it stays the same directory.
#[test]
fn the_current_directory_takes_a_result() {
    let desk = Desk::new();
    fs::create_dir(desk.path("here")).unwrap();
    for _ in 0..2 {
        let mut command = desk.command(&["simulate", "../scene.toml", "--out", "."]);
        command.current_dir(desk.path("here"));
        Run::of(&command.output().unwrap()).exits(DONE);
    }
    assert!(desk.path("here/summary.json").exists());
    assert_eq!(names(desk.folder.path()), ["here", "scene.toml"]);
}

/// What goes to a full device is not done: code 8, with the reason; a reader that closes its end is content.
#[cfg(target_os = "linux")]
#[test]
fn a_full_device_is_no_success() {
    let desk = Desk::new();
    let full = || {
        fs::OpenOptions::new()
            .write(true)
            .open("/dev/full")
            .unwrap()
    };
    for arguments in [
        &["schema"][..],
        &["example"],
        &["example", "reach"],
        &["example", "--json"],
        &["check", "scene.toml", "--json"],
        &["derivatives", "scene.toml", "--json"],
        &["simulate", "scene.toml", "--out", "simulated", "--json"],
        &["solve", "scene.toml", "--out", "solved", "--json"],
        &["verify", "solved", "--quick", "--json"],
    ] {
        let output = desk.command(arguments).stdout(full()).output().unwrap();
        Run::of(&output)
            .exits(UNWRITTEN)
            .says(&["standard output", "No space left on device"]);
    }
    for arguments in [&["--help"][..], &["--version"], &["solve", "--help"]] {
        let status = desk.command(arguments).stdout(full()).status().unwrap();
        assert_eq!(status.code(), Some(UNWRITTEN), "{arguments:?}");
    }
    // The files are there all the same.
    for out in ["simulated", "solved"] {
        assert!(desk.path(out).join("summary.json").exists());
    }
    for arguments in [
        &["schema"][..],
        &["example"],
        &["check", "scene.toml", "--json"],
    ] {
        let mut child = (desk.command(arguments))
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        drop(child.stdout.take());
        let run = Run::of(&child.wait_with_output().unwrap()).exits(DONE);
        assert!(!run.stderr.contains("error"), "{}", run.stderr);
    }
}

/// Runs the tool in a shell in which no file may grow beyond 2 KB, and writing more is an error.
#[cfg(unix)]
fn cramped(desk: &Desk, arguments: &[&str]) -> Run {
    let mut command = Command::new("sh");
    command
        .args(["-c", "trap '' XFSZ; ulimit -f 4; exec \"$0\" \"$@\""])
        .arg(env!("CARGO_BIN_EXE_softarm"))
        .args(arguments);
    Run::of(&desk.prepared(command).output().unwrap())
}

/// Where no place takes the result of a solve: code 8, the places and the reason, the summary on stdout, nothing half-written, and an
/// earlier result untouched.
#[cfg(unix)]
#[test]
fn a_solve_without_room_says_so() {
    let desk = Desk::new();
    let solve = ["solve", "scene.toml", "--out", "run", "--json"];
    for earlier in [false, true] {
        if earlier {
            desk.run(&solve).exits(DONE);
            fs::write(desk.path("run/notes.md"), "mine").unwrap();
        }
        let before = names(desk.folder.path());
        let content = |name: &str| fs::read(desk.path("run").join(name)).ok();
        let files = ["notes.md", "summary.json", "trajectory.npz"];
        let contents = files.map(content);
        let run = cramped(&desk, &solve).exits(UNWRITTEN);
        run.says(&["cannot write", "File too large", "nor could"]);
        let summary: Value = serde_json::from_str(&run.stdout).unwrap();
        assert_eq!(summary["status"], "converged");
        assert_eq!(names(desk.folder.path()), before);
        assert!(files.map(content) == contents);
    }
}

/// A simulation without room keeps what it has: the same command with --resume, and room, ends with the bytes of one that was left
/// alone.
#[cfg(unix)]
#[test]
fn a_simulation_without_room_can_go_on() {
    let desk = Desk::new();
    let simulate = ["simulate", "scene.toml", "--out", "run"];
    let run = cramped(&desk, &simulate).exits(UNWRITTEN);
    run.says(&["cannot write", "File too large", ".run.running", "--resume"]);
    assert_eq!(names(desk.folder.path()), [".run.running", "scene.toml"]);
    desk.run(&[&simulate[..], &["--resume"]].concat())
        .exits(DONE);
    desk.run(&["simulate", "scene.toml", "--out", "whole"])
        .exits(DONE);
    for name in ["trajectory.npz", "checkpoint.json", "scene.toml"] {
        let read = |out: &str| fs::read(desk.path(out).join(name)).unwrap();
        assert!(read("run") == read("whole"), "{name}");
    }
    assert_eq!(names(desk.folder.path()), ["run", "scene.toml", "whole"]);
}

/// On a disk of 64 KB a solve does not fit: its result is written among the temporary files, the error says where, and it verifies.
/// Where the system lets nobody make such a disk, there is nothing to test.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_does_not_lose_a_solve() {
    let desk = Desk::new();
    fs::create_dir(desk.path("disk")).unwrap();
    let on_disk = |script: &str| {
        let mut command = Command::new("unshare");
        let script = format!("mount -t tmpfs -o size=64k none disk && {script}");
        command
            .args(["--user", "--map-root-user", "--mount", "sh", "-c"])
            .args([&script, env!("CARGO_BIN_EXE_softarm")]);
        desk.prepared(command).output()
    };
    if !on_disk("true").is_ok_and(|output| output.status.success()) {
        eprintln!("no disk of one's own on this system");
        return;
    }
    let script =
        "\"$0\" solve scene.toml --out disk/run --json; code=$?; ls -A disk >&2; exit $code";
    let run = Run::of(&on_disk(script).unwrap()).exits(UNWRITTEN);
    run.says(&["No space left on device", "the result is in"]);
    assert!(!run.stderr.contains(".run.running\n"), "{}", run.stderr);
    let summary: Value = serde_json::from_str(&run.stdout).unwrap();
    let place = summary["directory"].as_str().unwrap();
    run.says(&[place]);
    assert!(Path::new(place).starts_with(desk.folder.path()));
    desk.run(&["verify", place, "--quick"]).exits(DONE);
}

/// A directory that becomes somebody else's while a solve is on its way stays as it is, and the result is written elsewhere.
#[cfg(unix)]
#[test]
fn a_place_that_is_taken_does_not_lose_a_solve() {
    let desk = Desk::new();
    let solve = [
        &["solve", "scene.toml", "--out", "run", "--json"],
        &ENDLESS[..],
    ]
    .concat();
    let mut child = desk.start(&solve, || true);
    // The place is looked at before the first iteration.
    let talk = first_row(&mut child);
    fs::create_dir(desk.path("run")).unwrap();
    fs::write(desk.path("run/letters"), "mine").unwrap();
    signal(&child, "INT");
    let mut output = child.wait_with_output().unwrap();
    output.stderr = talk.join().unwrap().into_bytes();
    let run = Run::of(&output).exits(UNWRITTEN);
    run.says(&["no result of softarm", "the result is in"]);
    let summary: Value = serde_json::from_str(&run.stdout).unwrap();
    let place = PathBuf::from(summary["directory"].as_str().unwrap());
    assert!(place.join("controls.csv").exists());
    assert_eq!(names(&desk.path("run")), ["letters"]);
    fs::remove_dir_all(place).unwrap();
    assert_eq!(names(desk.folder.path()), ["run", "scene.toml"]);
}

#[cfg(unix)]
fn signal(child: &Child, name: &str) {
    let arguments = [format!("-{name}"), child.id().to_string()];
    let status = Command::new("kill").args(arguments).status().unwrap();
    assert!(status.success());
}

/// SIGTERM and SIGHUP are handled like Ctrl-C: code 6, and the best iterate, or the simulation so far, is written.
#[cfg(unix)]
#[test]
fn requests_to_end_are_heard() {
    let desk = Desk::new();
    let ignored = hangups_are_ignored();
    for name in ["INT", "TERM", "HUP"] {
        if name == "HUP" && ignored {
            continue; // so they are by what this test starts
        }
        let solve = [&["solve", "scene.toml", "--out", "solved"], &ENDLESS[..]].concat();
        let simulate = [
            "simulate",
            "scene.toml",
            "--out",
            "run",
            "--set",
            "time.end_s=1e6",
        ];
        // The table begins when signals are caught; a checkpoint is written after that.
        let checkpoint = desk.path(".run.running/checkpoint.json");
        let mut child = desk.start(&simulate, || checkpoint.exists());
        signal(&child, name);
        assert_eq!(child.wait().unwrap().code(), Some(STOPPED), "{name}");
        let mut child = desk.start(&solve, || true);
        first_row(&mut child);
        signal(&child, name);
        assert_eq!(child.wait().unwrap().code(), Some(STOPPED), "{name}");
        for out in ["run", "solved"] {
            let text = fs::read_to_string(desk.path(out).join("summary.json")).unwrap();
            let summary: Value = serde_json::from_str(&text).unwrap();
            assert_eq!(summary["status"], "interrupted");
        }
        assert_eq!(names(desk.folder.path()), ["run", "scene.toml", "solved"]);
    }
}

/// Reads the talk of a solve up to the first row of its table, and goes on reading it in the background: what follows.
#[cfg(unix)]
fn first_row(child: &mut Child) -> std::thread::JoinHandle<String> {
    use std::io::BufRead as _;
    let mut lines = std::io::BufReader::new(child.stderr.take().unwrap()).lines();
    lines
        .by_ref()
        .map(Result::unwrap)
        .find(|line| line.trim_start().starts_with("1 "))
        .unwrap();
    std::thread::spawn(move || lines.map_while(Result::ok).collect::<Vec<_>>().join("\n"))
}

/// Whether this process, and so what it starts, ignores SIGHUP.
#[cfg(unix)]
fn hangups_are_ignored() -> bool {
    let script = "kill -HUP $$; echo ignored";
    let output = Command::new("sh").args(["-c", script]).output().unwrap();
    !output.stdout.is_empty()
}

/// SIGHUP that is ignored, as under `nohup`, stays ignored: the run goes on until it is asked otherwise.
#[cfg(target_os = "linux")]
#[test]
fn ignored_hangups_stay_ignored() {
    let desk = Desk::new();
    let mut command = Command::new("sh");
    command
        .args([
            "-c",
            "trap '' HUP; exec \"$0\" simulate scene.toml --out run --set time.end_s=1e6",
        ])
        .arg(env!("CARGO_BIN_EXE_softarm"));
    let mut child = desk
        .prepared(command)
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let step = || {
        let text =
            fs::read_to_string(desk.path(".run.running/checkpoint.json")).unwrap_or_default();
        let checkpoint: Option<Value> = serde_json::from_str(&text).ok();
        checkpoint.map(|checkpoint| checkpoint["step"].as_u64().unwrap())
    };
    let wait_for = |ready: &dyn Fn() -> bool| {
        let started = Instant::now();
        while !ready() {
            assert!(started.elapsed() < HANGS);
            std::thread::sleep(Duration::from_millis(5));
        }
    };
    wait_for(&|| step().is_some());
    let before = step();
    signal(&child, "HUP");
    wait_for(&|| step() > before);
    assert!(child.try_wait().unwrap().is_none());
    signal(&child, "TERM");
    assert_eq!(child.wait().unwrap().code(), Some(STOPPED));
}

/// A second Ctrl-C, or SIGTERM, ends the process at once with code 130, whatever it is doing.
#[cfg(unix)]
#[test]
fn a_second_request_ends_at_once() {
    let desk = Desk::new();
    // Stopped, both signals wait for it: it does not get to its end between them.
    let simulate = [
        "simulate",
        "scene.toml",
        "--out",
        "run",
        "--set",
        "time.end_s=1e6",
    ];
    let checkpoint = desk.path(".run.running/checkpoint.json");
    for second in ["INT", "TERM"] {
        let mut child = desk.start(&simulate, || checkpoint.exists());
        signal(&child, "STOP");
        signal(&child, if second == "INT" { "TERM" } else { "INT" });
        signal(&child, second);
        signal(&child, "CONT");
        assert_eq!(child.wait().unwrap().code(), Some(130));
        // It is as if it had been killed: the next run takes over.
        desk.run(&["simulate", "scene.toml", "--out", "run"])
            .exits(DONE);
        assert_eq!(names(desk.folder.path()), ["run", "scene.toml"]);
        fs::remove_dir_all(desk.path("run")).unwrap();
    }
}

/// A checkpoint that is no file, has no end, or is longer than any of the scene, and one that was changed, are refused at once, with what to
/// do; so are rows and archives that are not those of the checkpoint. What is there stays, and a run from the start replaces it.
#[cfg(unix)]
#[test]
fn what_is_resumed_is_checked() {
    let desk = Desk::new();
    // 600 steps: the checkpoint is at step 512.
    let short = ["--set", "time.step_s=5e-4"];
    let simulate = [&["simulate", "scene.toml", "--out", "run"], &short[..]].concat();
    let later = [&simulate[..], &["--resume", "--set", "time.end_s=0.6"]].concat();
    desk.run(&simulate).exits(DONE);
    let checkpoint = desk.path("run/checkpoint.json");
    let good = fs::read_to_string(&checkpoint).unwrap();
    let refused = |words: &[&str]| {
        desk.run(&later).exits(USAGE).says(words);
        assert_eq!(names(desk.folder.path()), ["run", "scene.toml"]);
    };

    fs::remove_file(&checkpoint).unwrap();
    std::os::unix::fs::symlink("/dev/zero", &checkpoint).unwrap();
    refused(&["checkpoint.json", "not a file"]);
    fs::remove_file(&checkpoint).unwrap();
    let made = Command::new("mkfifo").arg(&checkpoint).status().unwrap();
    assert!(made.success());
    refused(&["checkpoint.json", "not a file"]);
    fs::remove_file(&checkpoint).unwrap();
    let sparse = fs::File::create(&checkpoint).unwrap();
    sparse.set_len(1 << 36).unwrap();
    refused(&["checkpoint.json", "68719476736 bytes", "without --resume"]);
    let step = good.find("\"step\":").unwrap() + "\"step\":".len();
    let changed = [&good[..step], "1", &good[step..]].concat();
    fs::write(&checkpoint, changed).unwrap();
    refused(&["checkpoint.json", "checksum", "without --resume"]);
    let number = good.rfind("0.").unwrap();
    let changed = [&good[..number], "1.", &good[number + 2..]].concat();
    fs::write(&checkpoint, changed).unwrap();
    refused(&["checkpoint.json", "checksum"]);
    fs::write(&checkpoint, &good).unwrap();

    // The rows of another motion, of the same shape.
    let rows = fs::read(desk.path("run/trajectory.npz")).unwrap();
    let gravity = ["--set", "gravity.acceleration_m_s2=[1,0,0]"];
    let other = [
        &["simulate", "scene.toml", "--out", "other"],
        &short[..],
        &gravity,
    ]
    .concat();
    desk.run(&other).exits(DONE);
    fs::rename(
        desk.path("other/trajectory.npz"),
        desk.path("run/trajectory.npz"),
    )
    .unwrap();
    fs::remove_dir_all(desk.path("other")).unwrap();
    refused(&["the rows are not those", "without --resume"]);
    fs::write(desk.path("run/trajectory.npz"), &rows).unwrap();
    desk.run(&later).exits(DONE);

    // Rows of a run that was stopped.
    cramped(&desk, &simulate).exits(UNWRITTEN);
    let x = desk.path(".run.running/trajectory/x.f64");
    let mut bytes = fs::read(&x).unwrap();
    bytes[7] ^= 1;
    fs::write(&x, &bytes).unwrap();
    let resume = [&simulate[..], &["--resume"]].concat();
    desk.run(&resume)
        .exits(USAGE)
        .says(&["the rows are not those"]);
    assert_eq!(fs::read(&x).unwrap(), bytes);
    desk.run(&simulate).exits(DONE);
    assert_eq!(names(desk.folder.path()), ["run", "scene.toml"]);
}

/// A run whose result is there ends without computing it again; another option, scene or verb is another result, and threads are not.
#[test]
fn existing_results_are_skipped() {
    let desk = Desk::new();
    let sweep = |more: &[&str]| {
        let words = [
            "simulate",
            "scene.toml",
            "--out",
            "sweep",
            "--skip-existing",
        ];
        let run = desk.run(&[&words[..], more].concat());
        assert_eq!(run.code, Some(DONE), "{}", run.stderr);
        run.stderr.contains("there already")
    };
    let count = || fs::read_dir(desk.path("sweep")).unwrap().count();
    assert!(!sweep(&[]));
    let first = fs::read_dir(desk.path("sweep"))
        .unwrap()
        .next()
        .unwrap()
        .unwrap()
        .path();
    let written = fs::metadata(first.join("trajectory.npz"))
        .unwrap()
        .modified()
        .unwrap();
    assert!(sweep(&[]));
    assert!(sweep(&["--threads", "2"]));
    assert_eq!(count(), 1);
    let untouched = fs::metadata(first.join("trajectory.npz"))
        .unwrap()
        .modified()
        .unwrap();
    assert_eq!(written, untouched);
    assert!(!sweep(&["--set", "time.end_s=0.1"]));
    assert!(sweep(&["--set", "time.end_s=0.1"]));
    assert_eq!(count(), 2);
    // A result that was being replaced does not count.
    let summary = fs::read_to_string(first.join("summary.json")).unwrap();
    let mut summary: Value = serde_json::from_str(&summary).unwrap();
    summary["status"] = "unfinished".into();
    fs::write(first.join("summary.json"), summary.to_string()).unwrap();
    assert!(!sweep(&[]));
    let run = desk.run(&["check", "scene.toml", "--skip-existing"]);
    assert_eq!(run.code, Some(USAGE), "{}", run.stderr);
}

/// A solve that did not converge has the same exit code when it is skipped, with its reason; one that was stopped is computed again.
#[test]
fn skipped_results_keep_their_exit_codes() {
    let desk = Desk::new();
    let words = [
        "solve",
        "scene.toml",
        "--out",
        "sweep",
        "--skip-existing",
        "--quiet",
        "--set",
        "solver.max_iterations=1",
    ];
    desk.run(&words).exits(NOT_CONVERGED);
    desk.run(&words)
        .exits(NOT_CONVERGED)
        .says(&["iteration-limit", "exit code 3"]);
    let place = (fs::read_dir(desk.path("sweep")).unwrap().next().unwrap())
        .unwrap()
        .path()
        .join("summary.json");
    let text = fs::read_to_string(&place).unwrap();
    fs::write(
        &place,
        text.replacen("\"iteration-limit\"", "\"interrupted\"", 1),
    )
    .unwrap();
    let run = desk.run(&words);
    assert!(!run.stderr.contains("exit code 3"), "{}", run.stderr);
    let text = fs::read_to_string(&place).unwrap();
    assert!(text.contains("\"iteration-limit\""), "{text}");
}

/// Without its large files a result has its numbers, and `verify` says what is missing.
#[test]
fn small_results_keep_their_numbers() {
    let desk = Desk::new();
    let run = desk.run(&[
        "solve",
        "scene.toml",
        "--out",
        "small",
        "--small",
        "--quiet",
    ]);
    assert_eq!(run.code, Some(DONE), "{}", run.stderr);
    for gone in ["trajectory.npz", "report.html"] {
        assert!(!desk.path("small").join(gone).exists(), "{gone}");
    }
    for kept in ["summary.json", "scene.toml", "controls.csv", "end.npz"] {
        assert!(desk.path("small").join(kept).exists(), "{kept}");
    }
    let run = desk.run(&["verify", "small"]);
    assert_eq!(run.code, Some(USAGE), "{}", run.stderr);
    assert!(
        run.stderr.contains("trajectory.npz") && run.stderr.contains("--small"),
        "{}",
        run.stderr
    );
    // The whole result takes its place again.
    let run = desk.run(&["solve", "scene.toml", "--out", "small", "--quiet"]);
    assert_eq!(run.code, Some(DONE), "{}", run.stderr);
    assert!(desk.path("small/trajectory.npz").exists());
}
