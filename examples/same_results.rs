//! Compares two builds of the program `softarm` on this machine: every file that they leave, every summary on stdout, every exit code, and the schema.
//!
//! ```text
//! git worktree add ../before COMMIT && (cd ../before && cargo build --release)
//! cargo build --release
//! cargo run --release --example same_results -- ../before/target/release/softarm target/release/softarm
//! ```
//!
//! Every case runs once by each program, in an empty folder. The files have to be the same to the byte, but for clocks: the keys [`CLOCK_KEYS`] of JSON,
//! the columns [`CLOCK_COLUMNS`] of CSV, the warning that a loop is too slow for its period, and the numbers of pages, which are made of the files. A case
//! that differs runs once more by the first program: one that does not repeat itself is named as such. Nothing is stored.
//!
//! With `--within 1e-9` numbers may differ by that part of the largest number of their array, or in texts of themselves and one; everything else,
//! whole numbers such as iterations among it, has to be the same, but for the keys [`ROUNDING_KEYS`].
//!
//! Exits with 1 where anything differs.

use std::collections::BTreeMap;
use std::error::Error;
use std::io::Cursor;
use std::path::Path;
use std::process::{Command, ExitCode, Stdio};

use serde_json::Value;

/// Keys of JSON whose values are clocks, or counts of what they said.
const CLOCK_KEYS: [&str; 12] = [
    "elapsed_s",
    "estimate_s",
    "feedback_s",
    "first_sample_s",
    "iteration_s",
    "node_steps_per_s",
    "overruns",
    "phases_s",
    "prepare_s",
    "real_time_factor",
    "sample_s",
    "wall_s",
];
/// Keys of JSON whose values are measures of rounding, which another order of operations changes.
const ROUNDING_KEYS: [&str; 3] = ["contraction", "halving_ratio", "over_rounding"];
/// Columns of CSV whose values are clocks.
const CLOCK_COLUMNS: [&str; 7] = [
    "elapsed_s",
    "estimate_ms",
    "feedback_ms",
    "overrun",
    "predict_ms",
    "prepare_ms",
    "sample_ms",
];
/// Parts of sentences on loops that are too slow for their period, which depends on the machine.
const SLOW_LOOP: [&str; 2] = ["takes more than the period", "longer than the period"];

/// What is run: a name, a verb, a scene (built-in, or one of [`SCENES`]), and keys that are changed, or flags.
type Case = (
    &'static str,
    &'static str,
    &'static str,
    &'static [&'static str],
);

/// A hanging arm that reaches to the side.
const HANGING: &str = "\
[rod]
length_m = 0.3
elements = 6
material = { preset = \"dragon-skin-30\" }
section = { radius_base_m = 0.015, radius_tip_m = 0.008 }
[base]
direction = [0.0, 0.0, -1.0]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[damping]
viscous_1_s = 1.0
[initial]
shape = \"equilibrium\"
[time]
end_s = 0.8
[task]
position_m = [0.1, 0.02, -0.27]
at_rest = \"tip\"
[control]
blocks = 8
force_max_n = 3.0
moment_max_n_m = 0.2
";
/// A free rod that flies and is given a pose.
const FREE: &str = "\
[rod]
length_m = 0.5
elements = 6
material = { youngs_modulus_pa = 1e6, poisson_ratio = 0.45, density_kg_m3 = 1100.0 }
section = { radius_m = 0.02 }
[base]
kind = \"free\"
[initial]
velocity_m_s = [0.1, 0.0, 0.0]
angular_velocity_rad_s = [0.0, 1.0, 0.5]
[time]
end_s = 0.5
[[load]]
node = 0.5
force_n = [0.0, 0.5, 0.0]
profile = [[0.0, 0.0], [0.2, 1.0], [0.3, 0.0]]
";
const SCENES: [(&str, &str); 2] = [("hanging", HANGING), ("free", FREE)];

/// Strain rules, models of the section, integrators, bases, loads, holds, bounds, actuators, goals, limits, objectives, solvers, loops.
const CASES: [Case; 34] = [
    (
        "trapezoidal strain",
        "simulate",
        "swing",
        &["rod.strain='trapezoidal'", "rod.elements=16"],
    ),
    (
        "consistent section",
        "simulate",
        "swing",
        &["rod.model='consistent'", "rod.elements=8"],
    ),
    (
        "dilatation",
        "simulate",
        "swing",
        &["rod.model='dilatation'", "rod.elements=8", "time.end_s=0.2"],
    ),
    (
        "implicit steps",
        "simulate",
        "swing",
        &[
            "time.integrator='implicit'",
            "rod.elements=10",
            "output.diagnostics=true",
        ],
    ),
    (
        "implicit, trapezoidal",
        "simulate",
        "swing",
        &[
            "time.integrator='implicit'",
            "rod.strain='trapezoidal'",
            "rod.elements=10",
        ],
    ),
    (
        "implicit, damped inside",
        "simulate",
        "wire",
        &["damping.internal_s=0.002", "time.end_s=0.05"],
    ),
    (
        "driven base",
        "simulate",
        "shaken-base",
        &["rod.elements=8", "time.end_s=1.0"],
    ),
    ("free rod", "simulate", "free", &[]),
    (
        "chosen grid",
        "simulate",
        "swing",
        &["--accuracy=1e-2", "time.end_s=0.2"],
    ),
    (
        "statics",
        "equilibrium",
        "hanging",
        &["load=[{ node = 'tip', force_n = [0.3, 0.0, 0.1] }]"],
    ),
    ("tip that stops", "solve", "hanging", &[]),
    (
        "arm that stays",
        "solve",
        "hanging",
        &["task.at_rest=true", "time.end_s=1.2"],
    ),
    (
        "passing, constant hold",
        "solve",
        "hanging",
        &["task.at_rest=false", "control.hold='constant'"],
    ),
    (
        "cubic hold, components",
        "solve",
        "hanging",
        &[
            "control.hold='cubic'",
            "control.force_max_n=[2.0, 1.0, 3.0]",
        ],
    ),
    (
        "rates",
        "solve",
        "hanging",
        &[
            "control.force_rate_max_n_s=20.0",
            "control.moment_rate_max_n_m_s=2.0",
        ],
    ),
    (
        "goals within tolerances",
        "solve",
        "hanging",
        &[
            "task.tolerance_m=0.01",
            "task.orientation_wxyz=[0.96, 0.0, 0.0, 0.28]",
            "task.tolerance_rad=0.5",
            "base.direction=[0.0, 0.0, 1.0]",
            "gravity.acceleration_m_s2=[0.0, 0.0, 0.0]",
            "task.position_m=[0.1, 0.02, 0.27]",
        ],
    ),
    (
        "soft goal, energy",
        "solve",
        "hanging",
        &[
            "task.hard=false",
            "objective.energy=0.1",
            "task.at_rest=false",
        ],
    ),
    (
        "sphere and speed",
        "solve",
        "hanging",
        &[
            "obstacle=[{ sphere = { center_m = [0.06, 0.0, -0.27], radius_m = 0.02 } }]",
            "limit=[{ speed_max_m_s = 0.6 }]",
            "task.at_rest=false",
        ],
    ),
    (
        "soft limits of shape",
        "solve",
        "hanging",
        &[
            "limit=[{ curvature_max_1_m = 8.0, soft = { linear = 5.0, quadratic = 10.0 } }, { stretch = [0.95, 1.1] }]",
            "task.at_rest=false",
        ],
    ),
    (
        "two actuators, regulator",
        "solve",
        "hanging",
        &[
            "control.actuator=[{ node = 3, force_max_n = 1.0 }]",
            "control.feedback={}",
        ],
    ),
    (
        "couples along the arm",
        "solve",
        "hanging",
        &[
            "control.distributed={ points = 3, moment_max_n_m_per_m = 2.0 }",
            "task.at_rest=false",
        ],
    ),
    (
        "path and velocity",
        "solve",
        "hanging",
        &[
            "objective.track=[{ path_m = [[0.0, 0.0, 0.0, -0.3], [0.8, 0.1, 0.0, -0.27]], weight = 1e3, speed_weight = 1.0 }]",
            "task.at_rest=false",
        ],
    ),
    (
        "point on the way",
        "solve",
        "hanging",
        &[
            "task.via=[{ at_s = 0.4, node = 4, position_m = [0.02, 0.0, -0.2], tolerance_m = 0.01 }]",
            "task.at_rest=false",
        ],
    ),
    (
        "free duration",
        "solve",
        "hanging",
        &[
            "task.free_duration={ shortest_s = 0.4, longest_s = 1.2 }",
            "task.at_rest=false",
        ],
    ),
    (
        "sparse subproblems",
        "solve",
        "hanging",
        &[
            "solver.qp='sparse'",
            "time.integrator='explicit'",
            "task.at_rest=false",
            "rod.elements=3",
            "time.end_s=0.2",
            "task.position_m=[0.03, 0.0, -0.295]",
            "control.blocks=5",
        ],
    ),
    (
        "Gauss and Newton",
        "solve",
        "hanging",
        &[
            "solver.hessian='gauss-newton'",
            "solver.guess='slow'",
            "task.at_rest=false",
        ],
    ),
    (
        "consistent section, reach",
        "solve",
        "hanging",
        &[
            "rod.model='consistent'",
            "task.at_rest=false",
            "rod.elements=4",
        ],
    ),
    (
        "dilatation, reach",
        "solve",
        "hanging",
        &[
            "rod.model='dilatation'",
            "task.at_rest=false",
            "rod.elements=4",
        ],
    ),
    (
        "trapezoidal strain, reach",
        "solve",
        "hanging",
        &[
            "rod.strain='trapezoidal'",
            "task.at_rest=false",
            "rod.elements=4",
        ],
    ),
    (
        "loop, everything known",
        "mpc",
        "hanging",
        &["mpc.computing='fixed'", "mpc.duration_s=0.3"],
    ),
    (
        "loop, filter and bounds",
        "mpc",
        "mpc-reach",
        &[
            "estimator.kind='kalman'",
            "sensor=[{ preset = 'mocap' }]",
            "control.hold='constant'",
            "control.force_rate_max_n_s=5.0",
            "mpc.duration_s=0.4",
            "mpc.counted_from_s=0.1",
        ],
    ),
    (
        "loop, late and limited",
        "mpc",
        "mpc-track-circle",
        &[
            "plant.actuator={ delay_s = 0.01, lag_s = 0.005, force_max_n = 10.0 }",
            "mpc.duration_s=0.3",
            "mpc.counted_from_s=0.1",
        ],
    ),
    (
        "loop that is due",
        "mpc",
        "hanging",
        &[
            "mpc.due_s=0.6",
            "task.at_rest=true",
            "mpc.duration_s=0.8",
            "mpc.computing='fixed'",
        ],
    ),
    (
        "a target above the bounds",
        "solve",
        "hanging",
        &[
            "control.force_max_n=0.05",
            "control.moment_max_n_m=0.0",
            "task.at_rest=true",
        ],
    ),
];

/// Built-in scenes whose loops are shortened, and those that take minutes, with a coarser grid.
const SHORTER: [(&str, &[&str]); 13] = [
    (
        "mpc-track-circle",
        &["mpc.duration_s=0.3", "mpc.counted_from_s=0.1"],
    ),
    (
        "mpc-reach",
        &["mpc.duration_s=0.3", "mpc.counted_from_s=0.1"],
    ),
    (
        "mpc-push",
        &["mpc.duration_s=0.3", "mpc.counted_from_s=0.1"],
    ),
    (
        "mpc-payload",
        &["mpc.duration_s=0.3", "mpc.counted_from_s=0.1"],
    ),
    (
        "mpc-delay",
        &["mpc.duration_s=0.3", "mpc.counted_from_s=0.1"],
    ),
    (
        "mpc-catch",
        &["mpc.duration_s=0.3", "mpc.counted_from_s=0.1"],
    ),
    (
        "mpc-obstacle",
        &["mpc.duration_s=0.3", "mpc.counted_from_s=0.1"],
    ),
    ("mpc-elastica-case1", &["mpc.duration_s=0.3"]),
    ("paper-flying-beam", &["time.end_s=0.5"]),
    ("paper-stretching", &["time.end_s=0.02"]),
    ("paper-bending-stretching", &["time.end_s=0.02"]),
    ("paper-convergence", &["time.end_s=0.02"]),
    ("wire", &["time.end_s=0.1"]),
];

/// Everything that a case leaves: the exit code, stdout, and files by their paths in the result.
type Left = BTreeMap<String, Vec<u8>>;

fn main() -> Result<ExitCode, Box<dyn Error>> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let mut option = |name: &str| match arguments.iter().position(|argument| argument == name) {
        Some(at) if at + 1 < arguments.len() => arguments.drain(at..at + 2).nth(1),
        _ => None,
    };
    let only = option("--only");
    let within: f64 = option("--within").map_or(Ok(0.0), |text| text.parse())?;
    let [old, new] = &arguments[..] else {
        return Err("usage: same_results OLD NEW [--only WORD] [--within PART]".into());
    };
    let programs = [old, new].map(std::fs::canonicalize);
    let [old, new] = programs.map(|path| path.map_err(|error| format!("no such program: {error}")));
    let (old, new) = (old?, new?);

    let listed = output(&old, &["example"])?;
    let built_in: Vec<String> = (listed.lines())
        .filter_map(|line| line.split_whitespace().next().map(String::from))
        .collect();
    let mut cases: Vec<(String, Vec<String>)> = Vec::new();
    for name in &built_in {
        let shorter = SHORTER.iter().find(|(own, _)| own == name);
        let changes = shorter.map_or(&[][..], |(_, changes)| *changes);
        let verb = verb_of(&old, name)?;
        cases.push((format!("{verb} {name}"), arguments_of(verb, name, changes)));
        cases.push((
            format!("check {name}"),
            arguments_of("check", name, changes),
        ));
        cases.push((
            format!("example {name}"),
            vec!["example".into(), name.clone()],
        ));
    }
    for (name, verb, scene, changes) in CASES {
        cases.push((name.into(), arguments_of(verb, scene, changes)));
        cases.push((
            format!("check: {name}"),
            arguments_of("check", scene, changes),
        ));
    }
    cases.push(("schema".into(), vec!["schema".into()]));

    let mut n_different = 0;
    let is_asked = |name: &str| only.as_deref().is_none_or(|word| name.contains(word));
    let asked: Vec<_> = cases.iter().filter(|(name, _)| is_asked(name)).collect();
    for (name, arguments) in &asked {
        let (before, after) = (left_by(&old, arguments)?, left_by(&new, arguments)?);
        let different = differences(&before, &after, within);
        if different.is_empty() {
            let code = String::from_utf8_lossy(&before["exit code"]);
            println!(
                "same       {name}: exit code {code}, {} files",
                before.len() - 2
            );
            continue;
        }
        n_different += 1;
        let again = differences(&before, &left_by(&old, arguments)?, within);
        let what = if again.is_empty() {
            "DIFFERENT"
        } else {
            "UNSTEADY "
        };
        println!("{what}  {name}");
        for line in if again.is_empty() { different } else { again } {
            println!("           {line}");
        }
    }
    println!("{} cases, {n_different} different", asked.len());
    Ok(ExitCode::from(u8::from(n_different > 0)))
}

/// The verb that a built-in scene is for.
fn verb_of(program: &Path, scene: &str) -> Result<&'static str, Box<dyn Error>> {
    let text = output(program, &["example", scene])?;
    let has = |section: &str| {
        text.lines()
            .any(|line| line.trim_start().starts_with(section))
    };
    Ok(if has("[mpc]") {
        "mpc"
    } else if has("[control]") {
        "solve"
    } else {
        "simulate"
    })
}

/// Arguments of a run whose result goes to the folder `result`; a scene of [`SCENES`] is a file beside it.
fn arguments_of(verb: &str, scene: &str, changes: &[&str]) -> Vec<String> {
    let is_own = SCENES.iter().any(|(name, _)| *name == scene);
    let scene = if is_own {
        format!("{scene}.toml")
    } else {
        scene.to_string()
    };
    let mut arguments = vec![verb.to_string(), scene, "--json".into(), "--quiet".into()];
    if verb != "check" {
        arguments.extend(["--out".into(), "result".into()]);
    }
    for change in changes {
        if change.starts_with("--") {
            arguments.push((*change).into());
        } else {
            arguments.extend(["--set".into(), (*change).into()]);
        }
    }
    arguments
}

/// Stdout of a program, which has to end with success.
fn output(program: &Path, arguments: &[&str]) -> Result<String, Box<dyn Error>> {
    let done = Command::new(program).args(arguments).output()?;
    if !done.status.success() {
        let shown = program.display();
        return Err(format!("{shown} {}: {}", arguments.join(" "), done.status).into());
    }
    Ok(String::from_utf8(done.stdout)?)
}

/// Everything that a run in an empty folder leaves.
fn left_by(program: &Path, arguments: &[String]) -> Result<Left, Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    for (name, text) in SCENES {
        std::fs::write(folder.path().join(format!("{name}.toml")), text)?;
    }
    let done = Command::new(program)
        .args(arguments)
        .current_dir(folder.path())
        .stdin(Stdio::null())
        .output()?;
    let mut left = Left::new();
    let code = done
        .status
        .code()
        .map_or("none".into(), |code| code.to_string());
    left.insert("exit code".into(), code.into_bytes());
    left.insert("stdout.json".into(), done.stdout);
    let result = folder.path().join("result");
    if result.is_dir() {
        for entry in std::fs::read_dir(result)? {
            let entry = entry?;
            let name = entry.file_name().to_string_lossy().into_owned();
            left.insert(name, std::fs::read(entry.path())?);
        }
    }
    Ok(left)
}

/// A line for each thing that two runs left otherwise.
fn differences(a: &Left, b: &Left, within: f64) -> Vec<String> {
    let mut out = Vec::new();
    for name in a.keys().filter(|name| !b.contains_key(*name)) {
        out.push(format!("{name}: only before"));
    }
    for (name, after) in b {
        let Some(before) = a.get(name) else {
            out.push(format!("{name}: only after"));
            continue;
        };
        if before == after {
            continue;
        }
        let [before, after] = [before, after].map(|bytes| without_clocks(name, bytes, within));
        if before == after {
            continue;
        }
        if within > 0.0 {
            if let Some(far) = first_far(name, [&before, &after], within) {
                out.push(format!("{name}: {far}"));
            }
            continue;
        }
        let (before, after) = (
            String::from_utf8_lossy(&before),
            String::from_utf8_lossy(&after),
        );
        let differs = |(i, (a, b)): (usize, (&str, &str))| {
            (a != b).then(|| format!("line {}: {}", i + 1, first_difference(a, b)))
        };
        let line = before
            .lines()
            .zip(after.lines())
            .enumerate()
            .find_map(differs);
        out.push(format!(
            "{name}: {}",
            line.unwrap_or_else(|| "another length".into())
        ));
    }
    out
}

/// The first thing by which two files differ that is no small part of a number.
fn first_far(name: &str, files: [&[u8]; 2], within: f64) -> Option<String> {
    if name.ends_with(".npz") {
        let [Ok(a), Ok(b)] = files.map(arrays) else {
            return Some("no archive of numbers".into());
        };
        if !a.keys().eq(b.keys()) {
            return Some("other arrays".into());
        }
        return a.iter().zip(b.values()).find_map(|((name, a), b)| {
            let largest = a.iter().fold(0.0f64, |m, value| m.max(value.abs()));
            let is_far = |(a, b): (&f64, &f64)| {
                let same = a == b || (a.is_nan() && b.is_nan());
                !same && !((a - b).abs() <= within * largest)
            };
            let far = a.iter().zip(b).position(is_far);
            (far.or((a.len() != b.len()).then_some(0)))
                .map(|at| format!("{name}[{at}]: {:?} | {:?}", a.get(at), b.get(at)))
        });
    }
    let [Ok(before), Ok(after)] = files.map(std::str::from_utf8) else {
        return Some("other bytes".into());
    };
    let [a, b] = [before, after].map(words);
    let is_far = |(a, b): (&&str, &&str)| {
        let is_real = [a, b].iter().any(|word| word.contains(['.', 'e']));
        let close = match (a.parse::<f64>(), b.parse::<f64>()) {
            (Ok(x), Ok(y)) if is_real => (x - y).abs() <= within * (1.0 + x.abs()),
            _ => false,
        };
        a != b && !close
    };
    let far = a.iter().zip(&b).position(is_far);
    far.or((a.len() != b.len()).then_some(0)).map(|at| {
        let [a, b] = [&a, &b].map(|words| {
            words[at.saturating_sub(4)..][..5.min(words.len() - at.saturating_sub(4))].join(" ")
        });
        format!("{a} | {b}")
    })
}

/// A text cut at everything that is no part of a word or a number.
fn words(text: &str) -> Vec<&str> {
    text.split(|c: char| !(c.is_alphanumeric() || ".+-_".contains(c)))
        .filter(|word| !word.is_empty())
        .collect()
}

/// The arrays of numbers of an archive.
fn arrays(bytes: &[u8]) -> Result<BTreeMap<String, Vec<f64>>, Box<dyn Error>> {
    let mut archive = zip::ZipArchive::new(Cursor::new(bytes))?;
    let mut out = BTreeMap::new();
    for index in 0..archive.len() {
        let file = archive.by_index(index)?;
        let name = file.name().to_string();
        out.insert(name, npyz::NpyFile::new(file)?.into_vec()?);
    }
    Ok(out)
}

/// Two lines from shortly before they differ.
fn first_difference(a: &str, b: &str) -> String {
    let same = a.chars().zip(b.chars()).take_while(|(a, b)| a == b).count();
    let [a, b] = [a, b].map(|line| -> String {
        let visible = line.chars().skip(same.saturating_sub(20)).take(80);
        visible
            .map(|c| if c.is_control() { ' ' } else { c })
            .collect()
    });
    format!("{a} | {b}")
}

/// A file without its clocks; what is no text with clocks stays as it is.
fn without_clocks(name: &str, bytes: &[u8], within: f64) -> Vec<u8> {
    let Ok(text) = std::str::from_utf8(bytes) else {
        return bytes.to_vec();
    };
    let masked = match Path::new(name)
        .extension()
        .and_then(|extension| extension.to_str())
    {
        Some("json") => serde_json::from_str(text).ok().map(|mut value: Value| {
            mask(&mut value, &CLOCK_KEYS);
            if within > 0.0 {
                mask(&mut value, &ROUNDING_KEYS);
            }
            format!("{value:#}")
        }),
        Some("csv") => Some(without_columns(text)),
        Some("html") => Some(without_numbers(text)),
        _ => None,
    };
    masked.map_or_else(|| bytes.to_vec(), String::into_bytes)
}

fn mask(value: &mut Value, keys: &[&str]) {
    match value {
        Value::Object(entries) => {
            for key in keys {
                if let Some(clock) = entries.get_mut(*key) {
                    *clock = Value::Null;
                }
            }
            entries.values_mut().for_each(|value| mask(value, keys));
        }
        Value::Array(entries) => {
            entries.retain(|entry| !entry.as_str().is_some_and(is_of_a_slow_loop));
            entries.iter_mut().for_each(|value| mask(value, keys));
        }
        _ => (),
    }
}

fn without_columns(text: &str) -> String {
    let header: Vec<&str> = text.lines().next().unwrap_or("").split(',').collect();
    let kept = |line: &str| {
        let fields = line.split(',').enumerate();
        let kept = fields.filter(|(i, _)| {
            header
                .get(*i)
                .is_none_or(|name| !CLOCK_COLUMNS.contains(name))
        });
        kept.map(|(_, field)| field).collect::<Vec<_>>().join(",")
    };
    text.lines().map(kept).collect::<Vec<_>>().join("\n")
}

/// A page without its numbers and the units of its times, and without the warning of a slow loop.
fn without_numbers(text: &str) -> String {
    let parts = text.split_inclusive(['\n', '>', '"', ';']);
    let kept: String = parts.filter(|part| !is_of_a_slow_loop(part)).collect();
    let mut out = String::new();
    let mut is_number = false;
    for character in kept.chars() {
        let belongs = "0123456789⁰¹²³⁴⁵⁶⁷⁸⁹⁻".contains(character)
            || (is_number && ".eE+-·".contains(character));
        if belongs && !is_number {
            out.push('#');
        }
        is_number = belongs;
        if !belongs {
            out.push(character);
        }
    }
    for unit in ["ms", "µs", "min"] {
        out = out.replace(&format!("# {unit}"), "# s");
    }
    out
}

fn is_of_a_slow_loop(text: &str) -> bool {
    SLOW_LOOP.iter().any(|part| text.contains(part))
}
