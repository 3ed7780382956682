use std::ffi::OsStr;
use std::fs;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::Value;

use super::OutputError;
use super::end_state::END_FILE;
use super::reading::read_text;
use super::summary::TOOL;

/// Name of the summary of a result, which is the last file to be put in place.
pub(super) const SUMMARY: &str = "summary.json";
/// Status of a result whose files are being replaced.
pub(super) const UNFINISHED: &str = "unfinished";
/// Cap on the bytes of a summary that is read.
const LARGEST_SUMMARY: u64 = 1 << 24;

/// The command that made a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResultKind {
    /// `softarm simulate`
    Simulate,
    /// `softarm solve`
    Solve,
    /// `softarm mpc`
    Mpc,
    /// `softarm tradeoff`
    Tradeoff,
    /// `softarm equilibrium`
    Equilibrium,
    /// `softarm fit`
    Fit,
}

impl ResultKind {
    /// Every kind.
    pub const ALL: [Self; 6] = [
        Self::Simulate,
        Self::Solve,
        Self::Mpc,
        Self::Tradeoff,
        Self::Equilibrium,
        Self::Fit,
    ];

    /// Returns the word of the command line.
    #[must_use]
    pub fn command(self) -> &'static str {
        match self {
            Self::Simulate => "simulate",
            Self::Solve => "solve",
            Self::Mpc => "mpc",
            Self::Tradeoff => "tradeoff",
            Self::Equilibrium => "equilibrium",
            Self::Fit => "fit",
        }
    }

    /// Returns the names of the files that softarm writes into such a result directory, the summary last. All others belong to the user.
    #[must_use]
    pub fn files(self) -> &'static [&'static str] {
        match self {
            Self::Simulate => &[
                "scene.toml",
                "trajectory.npz",
                END_FILE,
                "efforts.csv",
                "diagnostics.npz",
                "checkpoint.json",
                "report.html",
                SUMMARY,
            ],
            Self::Solve => &[
                "scene.toml",
                "trajectory.npz",
                END_FILE,
                "diagnostics.npz",
                "controls.csv",
                "efforts.csv",
                "iterations.csv",
                "multipliers.json",
                "feedback.npz",
                "failed-subproblem.json",
                "report.html",
                SUMMARY,
            ],
            Self::Mpc => &[
                "scene.toml",
                "trajectory.npz",
                END_FILE,
                "samples.csv",
                "controls.csv",
                "efforts.csv",
                "report.html",
                SUMMARY,
            ],
            Self::Tradeoff => &[
                "scene.toml",
                "recommended.toml",
                "points.csv",
                "front.svg",
                "report.html",
                SUMMARY,
            ],
            Self::Equilibrium => &[
                "scene.toml",
                "trajectory.npz",
                "shape.csv",
                "elements.csv",
                "sweep.csv",
                "report.html",
                SUMMARY,
            ],
            Self::Fit => &[
                "scene.toml",
                "trajectory.npz",
                "residuals.csv",
                "report.html",
                SUMMARY,
            ],
        }
    }

    /// Returns the keys that a summary without `tool` must have to count as one of softarm: those of layouts before that field.
    fn signature(self) -> &'static [&'static str] {
        match self {
            Self::Simulate => &["node_steps_per_s", "strain", "directory"],
            Self::Solve => &["qp_backend", "hessian", "control_blocks", "directory"],
            // Summaries of these kinds always name their tool.
            Self::Mpc | Self::Tradeoff | Self::Equilibrium | Self::Fit => &["tool"],
        }
    }

    /// Returns the kind of result that a summary describes; `None` if it is not one of softarm.
    fn of_summary(summary: &Value) -> Option<Self> {
        let summary = summary.as_object()?;
        summary.get("schema_version")?.as_u64()?;
        let command = summary.get("command")?.as_str()?;
        let kind = (Self::ALL.into_iter()).find(|kind| kind.command() == command)?;
        let is_ours = match summary.get("tool") {
            Some(tool) => tool == TOOL,
            None => (kind.signature().iter()).all(|key| summary.contains_key(*key)),
        };
        is_ours.then_some(kind)
    }

    /// Returns the kind of result in `directory`, and its summary.
    ///
    /// # Errors
    /// Returns [`OutputError`] for a directory that is not a result of softarm, and for one whose files are being replaced.
    pub fn read(directory: &Path) -> Result<(Self, Value), OutputError> {
        if !directory.is_dir() {
            return Err(OutputError::refused(
                directory,
                "no such directory; name the result directory of a simulate, solve, mpc, tradeoff, equilibrium or fit",
            ));
        }
        let path = directory.join(SUMMARY);
        if !path.is_file() {
            return Err(OutputError::refused(
                directory,
                "no result of softarm, because it has no summary.json; `softarm solve SCENE --out DIR` writes one",
            ));
        }
        let text = read_text(&path, LARGEST_SUMMARY)?;
        let summary: Value =
            serde_json::from_str(&text).map_err(|error| OutputError::Malformed {
                path: path.clone(),
                line: Some(error.line() as u64),
                reason: error.to_string(),
            })?;
        let Some(kind) = Self::of_summary(&summary) else {
            return Err(OutputError::malformed(
                &path,
                "not the summary of a simulate, solve, mpc, tradeoff, equilibrium or fit of softarm",
            ));
        };
        if summary["status"] == UNFINISHED {
            return Err(OutputError::refused(
                directory,
                "its files are being replaced, or were when a run was killed; run it again",
            ));
        }
        Ok((kind, summary))
    }

    /// Returns the kind of result in `directory`; `None` if it has none.
    pub(super) fn of_directory(directory: &Path) -> Option<Self> {
        let path = directory.join(SUMMARY);
        let metadata = fs::symlink_metadata(&path).ok()?;
        if !metadata.is_file() || metadata.len() > LARGEST_SUMMARY {
            return None;
        }
        let mut text = String::new();
        let file = fs::File::open(&path).ok()?;
        file.take(LARGEST_SUMMARY).read_to_string(&mut text).ok()?;
        Self::of_summary(&serde_json::from_str(&text).ok()?)
    }
}

/// A folder in which the files of one result are written; a [`RunDirectory`](super::RunDirectory) moves them to their place.
#[derive(Debug)]
pub struct ResultDirectory {
    path: PathBuf,
    place: PathBuf,
}

impl ResultDirectory {
    /// Creates a folder whose files are written to `path` and moved to `place`.
    pub(super) fn new(path: &Path, place: &Path) -> Self {
        Self {
            path: path.into(),
            place: place.into(),
        }
    }

    /// Returns the directory to which files are written during the run.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the directory of the result.
    #[must_use]
    pub fn place(&self) -> &Path {
        &self.place
    }

    /// Writes a text file.
    pub fn write_text(&self, name: &str, text: &str) -> Result<(), OutputError> {
        let path = self.path.join(name);
        fs::write(&path, text).map_err(OutputError::unwritten(&path, "cannot write"))
    }

    /// Writes a value as indented JSON with a newline at its end; non-finite numbers become `null`.
    pub fn write_json(&self, name: &str, value: &impl Serialize) -> Result<(), OutputError> {
        let erased: &dyn erased_serde::Serialize = value;
        let text = serde_json::to_string_pretty(erased)
            .map_err(|error| OutputError::malformed(&self.path.join(name), error.to_string()))?;
        self.write_text(name, &(text + "\n"))
    }

    /// Writes a result that its own place did not accept to the first place that does: a new directory `softarm-NAME-…` among the temporary
    /// files, in the user's home, or in the current directory. Returns its path.
    pub(super) fn rescue(
        name: &OsStr,
        fill: impl Fn(&Self) -> Result<(), OutputError>,
    ) -> Result<PathBuf, OutputError> {
        let places = [
            Some(std::env::temp_dir()),
            std::env::home_dir(),
            std::env::current_dir().ok(),
        ];
        let prefix = format!("softarm-{}-", name.to_string_lossy());
        let write_to = |place: &Path| {
            let folder = tempfile::Builder::new()
                .prefix(&prefix)
                .tempdir_in(place)
                .map_err(OutputError::unwritten(place, "cannot write into"))?;
            fill(&Self::new(folder.path(), folder.path()))?;
            Ok(folder.keep())
        };
        let mut outcome = Err(OutputError::refused(Path::new(name), "no other place"));
        for place in places.into_iter().flatten() {
            outcome = write_to(&place);
            if outcome.is_ok() {
                break;
            }
        }
        outcome
    }
}

/// Returns the absolute path of a result directory, by its parent and its name: a symbolic link in its last part is not followed.
pub(super) fn locate(target: &Path) -> Result<PathBuf, OutputError> {
    let cannot_open = || OutputError::io(target, "cannot open");
    let absolute = std::path::absolute(target).map_err(cannot_open())?;
    let absolute = match absolute.file_name() {
        Some(_) => absolute,
        None => fs::canonicalize(&absolute).map_err(cannot_open())?, // it ends in `..`
    };
    // The path is joined again, because a slash at the end would follow a link.
    match (absolute.parent(), absolute.file_name()) {
        (Some(parent), Some(name)) => Ok(parent.join(name)),
        _ => Err(OutputError::refused(target, "not a name for a directory")),
    }
}

/// Checks that a result of this kind may be written to `target`: it is absent, empty, or has a result of this kind, whose names are files.
pub(super) fn permit(target: &Path, kind: ResultKind) -> Result<(), OutputError> {
    let cannot_read = || OutputError::io(target, "cannot read");
    let refuse = |reason: String| Err(OutputError::refused(target, reason));
    let metadata = match fs::symlink_metadata(target) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        other => other.map_err(cannot_read())?,
    };
    if metadata.is_symlink() {
        return refuse("a symbolic link; name the directory that it leads to".into());
    }
    if !metadata.is_dir() {
        return refuse("exists and is not a directory; choose another --out".into());
    }
    let is_empty = fs::read_dir(target)
        .map_err(cannot_read())?
        .next()
        .is_none();
    if is_empty {
        return Ok(());
    }
    let command = kind.command();
    match ResultKind::of_directory(target) {
        None => refuse(
            "holds files and no result of softarm (a summary.json that names softarm as its tool, and a command); choose another \
             --out, or empty it"
                .into(),
        ),
        Some(other) if other != kind => refuse(format!(
            "holds the result of `softarm {}`, which `softarm {command}` does not replace; choose another --out, or remove it",
            other.command()
        )),
        Some(_) => match (kind.files().iter()).find(|name| target.join(name).is_dir()) {
            Some(name) => refuse(format!(
                "`{name}` in it is a directory, and softarm writes a file of that name; move it away, or choose another --out"
            )),
            None => Ok(()),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// A summary is one of softarm if it has a version of its layout, one of the commands, and the tool's name; or, without a tool, the
    /// keys that only softarm wrote before it named itself.
    #[test]
    fn foreign_summaries_are_recognized() {
        let kind = |summary: Value| ResultKind::of_summary(&summary);
        let named = |tool: &str, command: &str| json!({"schema_version": 1, "tool": tool, "command": command});
        assert_eq!(kind(named("softarm", "solve")), Some(ResultKind::Solve));
        assert_eq!(
            kind(named("softarm", "simulate")),
            Some(ResultKind::Simulate)
        );
        let mut earlier = json!({"schema_version": 1, "command": "simulate", "node_steps_per_s": 1.0, "strain": "helical",
            "directory": "results/swing"});
        assert_eq!(kind(earlier.clone()), Some(ResultKind::Simulate));
        earlier["command"] = "solve".into();
        for foreign in [
            earlier,
            named("hardarm", "solve"),
            named("softarm", "verify"),
            json!({"tool": "softarm", "command": "solve"}),
            json!({"schema_version": 1, "tool": "softarm"}),
            json!({"schema_version": 1, "command": "solve"}),
            json!({"schema_version": 1}),
            json!([{"schema_version": 1, "tool": "softarm", "command": "solve"}]),
            json!("softarm"),
        ] {
            assert_eq!(kind(foreign.clone()), None, "{foreign}");
        }
    }

    /// Dots, slashes at the end and a parent folder lead to the same directory; a root is refused.
    #[test]
    fn targets_are_located() {
        let folder = tempfile::tempdir().unwrap();
        let root = fs::canonicalize(folder.path()).unwrap();
        let target = root.join("run");
        fs::create_dir_all(target.join("deep")).unwrap();
        for path in ["run", "run/", "./run/.", "run/deep/.."] {
            assert_eq!(locate(&root.join(path)).unwrap(), target, "{path}");
        }
        assert!(locate(Path::new("/")).is_err());
        assert!(locate(Path::new("")).is_err());
    }
}
