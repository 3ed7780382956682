//! Options for many runs: a result that is there is not computed again, and results keep their numbers alone.

use std::fs;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::io;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::console::Console;
use super::error::CliError;
use super::{Command, Global, Outcome, SceneAndOut, exit};
use crate::output::summary::SCHEMA_VERSION;
use crate::output::{OutputError, ResultKind};
use crate::scene::Scene;

/// The large files of a result, which its scene leads to again.
const LARGE: [&str; 4] = [
    "trajectory.npz",
    "diagnostics.npz",
    "checkpoint.json",
    "report.html",
];

impl Command {
    /// Returns scene and result directory of a verb that writes a result, with the kind of result.
    fn result(&mut self) -> Option<(&mut SceneAndOut, ResultKind)> {
        match self {
            Self::Simulate { arguments, .. } => Some((arguments, ResultKind::Simulate)),
            Self::Equilibrium(arguments) => Some((&mut arguments.scene, ResultKind::Equilibrium)),
            Self::Solve(arguments) => Some((&mut arguments.scene, ResultKind::Solve)),
            Self::Mpc(arguments) => Some((&mut arguments.scene, ResultKind::Mpc)),
            Self::Tradeoff(arguments) => Some((&mut arguments.scene, ResultKind::Tradeoff)),
            Self::Fit(arguments) => Some((&mut arguments.scene, ResultKind::Fit)),
            _ => None,
        }
    }
}

/// Runs a verb under the options of a sweep, and otherwise as `run` does.
///
/// With `--skip-existing` the result directory is named by a hash of the verb, its options, the scene with all defaults, and the version of
/// softarm: a folder of its own in `--out`, by default in `results`. A result that is there ends the verb at once. Files that options name
/// count by their names; for a fit, which is made of little else, there is only `--small`.
pub(super) fn run(
    command: &mut Command,
    global: &Global,
    console: &Console,
    run: impl FnOnce(&Command) -> Outcome,
) -> Outcome {
    if !(global.skip_existing || global.small) {
        return run(command);
    }
    let refuse = |words: &str| Err(CliError::Directory(words.into()));
    let Some((arguments, kind)) = command.result() else {
        return refuse(
            "--skip-existing and --small go with simulate, equilibrium, solve, mpc and tradeoff, and --small with fit",
        );
    };
    if global.skip_existing && kind == ResultKind::Fit {
        return refuse(
            "--skip-existing: a fit depends on what its --data holds, and not only on the name of that file",
        );
    }
    let mut own = std::mem::take(arguments);
    if global.skip_existing {
        let folder = (own.out.take()).unwrap_or_else(|| PathBuf::from("results"));
        let (scene, _) = console.load(&own.scene, global)?;
        let key = key(command, global, &scene);
        let place = folder.join(&key);
        let before = finished(&place, kind)?;
        let there = before.is_some();
        console.event("result", &json!({ "key": key, "there": there }));
        if let Some((summary, code)) = before {
            console.say(&format!("{}: there already", place.display()));
            if code != exit::DONE {
                let status = summary["status"].as_str().unwrap_or("rejected");
                console.always(&format!(
                    "{}: {status}, exit code {code} as when it was computed",
                    place.display()
                ));
            }
            console.summary(&summary);
            return Ok(code);
        }
        own.out = Some(place);
    }
    let place = own.directory(kind.command());
    if let Some((arguments, _)) = command.result() {
        *arguments = own;
    }
    let code = run(command)?;
    if global.small {
        shrink(&place, kind)?;
    }
    Ok(code)
}

/// Returns the name of the result of a verb whose scene and directory are left out: a hash of all that it depends on.
fn key(command: &Command, global: &Global, scene: &Scene) -> String {
    let mut hasher = DefaultHasher::new();
    (format!("{command:?}"), global.seed, global.small).hash(&mut hasher);
    let layout = (env!("CARGO_PKG_VERSION"), SCHEMA_VERSION);
    (scene.to_toml(), layout).hash(&mut hasher);
    format!("{:016x}", hasher.finish())
}

/// Returns the summary of a result of this kind that ended by itself, and the exit code of its verb; `None` if there is none, one that was
/// stopped, or one whose files were being replaced.
fn finished(place: &Path, kind: ResultKind) -> Result<Option<(Value, u8)>, CliError> {
    if !place.join("summary.json").is_file() {
        return Ok(None);
    }
    match ResultKind::read(place) {
        Ok((own, summary)) => {
            let code = (own == kind).then(|| code_of(kind, &summary)).flatten();
            Ok(code.map(|code| (summary, code)))
        }
        // An earlier run was killed while it replaced files: the next one completes them.
        Err(OutputError::Refused { .. }) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

/// Returns the exit code with which a verb ended that wrote this summary; `None` where it was stopped before its end, by a deadline, an
/// interrupt or a budget.
fn code_of(kind: ResultKind, summary: &Value) -> Option<u8> {
    let status = summary["status"].as_str();
    match kind {
        ResultKind::Equilibrium | ResultKind::Fit => Some(exit::DONE),
        ResultKind::Simulate | ResultKind::Mpc => match status? {
            "completed" => Some(exit::DONE),
            "failed" => Some(exit::NUMERICAL),
            _ => None,
        },
        ResultKind::Tradeoff => match (status?, summary["recommended"]["checked"].as_bool()) {
            ("completed", Some(true)) => Some(exit::DONE),
            ("completed", _) => Some(exit::NOT_CONVERGED),
            _ => None,
        },
        ResultKind::Solve => {
            let is_accurate = summary["accuracy"]["met"].as_bool() != Some(false);
            match (status?, summary["check"]["verdict"].as_str()) {
                ("converged", Some("certified")) if is_accurate => Some(exit::DONE),
                ("converged", Some(_)) => Some(exit::REJECTED),
                ("iteration-limit" | "step-too-small", _) => Some(exit::NOT_CONVERGED),
                ("locally-infeasible", _) => Some(exit::INFEASIBLE),
                ("failed", _) => Some(exit::NUMERICAL),
                _ => None,
            }
        }
    }
}

/// Removes the large files of a result.
fn shrink(place: &Path, kind: ResultKind) -> Result<(), CliError> {
    for name in kind.files().iter().filter(|name| LARGE.contains(name)) {
        let path = place.join(name);
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(OutputError::unwritten(&path, "cannot remove")(error).into());
            }
            _ => {}
        }
    }
    Ok(())
}
