use std::ffi::OsStr;
use std::fs::{self, DirEntry, File, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use serde_json::json;

use super::OutputError;
use super::checkpoint::{CHECKPOINT_FILE, FRESH_CHECKPOINT_FILE};
use super::directory::{ResultDirectory, ResultKind, SUMMARY, UNFINISHED, locate, permit};
use super::summary::{SCHEMA_VERSION, TOOL};

const LOCK_FILE: &str = "lock";
/// Folder in which the files of a result are written.
const DRAFT: &str = "draft";
/// Name of that folder after all files are written, when they belong into the result directory.
const READY: &str = "ready";
/// Names of the files with which a [`READY`] folder began, one a line.
const MANIFEST: &str = "manifest";
/// Placeholder for the summary of a directory whose files are being replaced.
const PLACEHOLDER: &str = "unfinished.json";
/// Folders of the rows of a simulation.
const ROW_FOLDERS: [&str; 2] = ["trajectory", "diagnostics"];
/// Points of a trade-off in progress.
pub const JOURNAL_FILE: &str = "points.jsonl";
/// Extension of files of rows.
const ROW_ENDING: &str = "f64";
/// Cap on the attempts to create a directory that other runs remove at the same moment.
const ATTEMPTS: usize = 100;

/// The directory of a run in progress: `.NAME.running`, beside the result directory `NAME`.
///
/// It is locked while its run lives; the operating system releases the lock of a dead process, and the next run into `NAME` takes over its
/// files: a simulation can be resumed, a complete result is moved to its place, the rest is removed. It contains only files of softarm;
/// anything else in it, and a symbolic link in its place, is refused and kept.
///
/// [`publish`](Self::publish) replaces, one by one, the files of the [kind](ResultKind) of result, and leaves every other file of the
/// result directory alone. During the replacement, the status in `summary.json` is `unfinished`.
///
/// Written data survive the process, but not a loss of power, because nothing is forced onto the disk.
#[derive(Debug)]
pub struct RunDirectory {
    /// The path as the user wrote it.
    named: PathBuf,
    target: PathBuf,
    kind: ResultKind,
    folder: PathBuf,
    _lock: File,
}

impl RunDirectory {
    /// Opens the directory for the result `target`, and creates its parents. It may have files of an earlier simulation to resume.
    ///
    /// # Errors
    /// Returns [`OutputError::Refused`] for a target that is neither absent, nor empty, nor a result of the same kind, and while another
    /// run uses it.
    pub fn open(target: &Path, kind: ResultKind) -> Result<Self, OutputError> {
        let named = target.to_path_buf();
        let target = locate(target)?;
        permit(&target, kind)?;
        let folder = Self::folder_of(&target)?;
        if let Some(parent) = target.parent() {
            fs::create_dir_all(parent).map_err(OutputError::unwritten(parent, "cannot create"))?;
        }
        let directory = Self {
            _lock: lock(&folder)?,
            named,
            target,
            kind,
            folder,
        };
        // The files that a dead run moved there may belong to the other kind.
        directory.put_in_place()?;
        permit(&directory.target, kind)?;
        if !directory.folder.join(CHECKPOINT_FILE).exists() {
            directory.clear()?;
        } else if kind == ResultKind::Simulate {
            directory.clear_result()?;
        } else {
            return Err(OutputError::refused(
                &directory.folder,
                format!(
                    "holds a simulation that was stopped and can be resumed, which `softarm {}` does not replace; choose another \
                     --out, or remove it",
                    kind.command()
                ),
            ));
        }
        Ok(directory)
    }

    /// Returns the folder of the run of the result `target`, whether it exists or not.
    pub fn folder_of(target: &Path) -> Result<PathBuf, OutputError> {
        let target = locate(target)?;
        let mut name = OsStr::new(".").to_os_string();
        name.push(target.file_name().unwrap_or_default());
        name.push(".running");
        Ok(target.with_file_name(name))
    }

    /// Returns the directory of the files.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.folder
    }

    /// Removes the files of softarm, except the lock.
    pub fn clear(&self) -> Result<(), OutputError> {
        self.clear_where(|name| name != LOCK_FILE)
    }

    /// Removes the rest of a result that a dead run was writing.
    fn clear_result(&self) -> Result<(), OutputError> {
        self.clear_where(|name| {
            [DRAFT, READY, MANIFEST, PLACEHOLDER]
                .iter()
                .any(|own| name == *own)
        })
    }

    /// Removes the files of softarm whose names are `doomed`.
    fn clear_where(&self, doomed: impl Fn(&OsStr) -> bool) -> Result<(), OutputError> {
        let remove_all = || {
            for entry in fs::read_dir(&self.folder)? {
                let entry = entry?;
                if !doomed(&entry.file_name()) || !is_own(&entry)? {
                    continue;
                }
                let path = entry.path();
                if entry.file_type()?.is_dir() {
                    for inner in fs::read_dir(&path)? {
                        let inner = inner?;
                        if is_own_within(&entry.file_name(), &inner)? {
                            fs::remove_file(inner.path())?;
                        }
                    }
                    fs::remove_dir(&path)?;
                } else {
                    fs::remove_file(&path)?;
                }
            }
            Ok(())
        };
        remove_all().map_err(OutputError::unwritten(&self.folder, "cannot empty"))
    }

    /// Removes the directory.
    pub fn remove(self) -> Result<(), OutputError> {
        self.clear() // the rest is removed on drop
    }

    /// Lets `fill` write the files of the result, moves them to the place of those of an earlier one, and removes this directory. Returns
    /// the result directory, by the name that the user gave it.
    ///
    /// # Errors
    /// Returns the error of `fill`, and [`OutputError`] if the files cannot be moved to their place. A simulation in this directory can
    /// still be resumed.
    pub fn publish(
        self,
        fill: impl FnOnce(&ResultDirectory) -> Result<(), OutputError>,
    ) -> Result<PathBuf, OutputError> {
        self.write(fill)?;
        self.put_in_place()?;
        self.clear()?;
        Ok(self.named.clone())
    }

    /// [Publishes](Self::publish), or else writes the result to another place and returns [`OutputError::Elsewhere`].
    ///
    /// # Errors
    /// Returns [`OutputError::Elsewhere`], and [`OutputError::Nowhere`] if no place accepts the result.
    pub fn publish_or_rescue(
        self,
        fill: impl Fn(&ResultDirectory) -> Result<(), OutputError>,
    ) -> Result<PathBuf, OutputError> {
        let Err(source) = self.write(&fill).and_then(|()| self.put_in_place()) else {
            self.clear()?;
            return Ok(self.named.clone());
        };
        let source = Box::new(source);
        let name = self.target.file_name().unwrap_or_default();
        match ResultDirectory::rescue(name, &fill) {
            Ok(place) => {
                let _ = self.clear(); // otherwise the next run would do it
                Err(OutputError::Elsewhere { place, source })
            }
            Err(last) => Err(OutputError::Nowhere {
                source,
                last: Box::new(last),
            }),
        }
    }

    /// Writes the files of a result, up to the point from which the next run would move them to their place.
    fn write(
        &self,
        fill: impl FnOnce(&ResultDirectory) -> Result<(), OutputError>,
    ) -> Result<(), OutputError> {
        let draft = self.folder.join(DRAFT);
        let write = || {
            fs::create_dir(&draft).map_err(OutputError::unwritten(&draft, "cannot create"))?;
            fill(&ResultDirectory::new(&draft, &self.named))?;
            let names = self.names_in(&draft)?;
            let manifest = self.folder.join(MANIFEST);
            fs::write(&manifest, names.join("\n"))
                .and_then(|()| fs::rename(&draft, self.folder.join(READY)))
                .map_err(OutputError::unwritten(&manifest, "cannot write"))
        };
        write().inspect_err(|_| {
            let _ = self.clear_result(); // makes room
        })
    }

    /// Returns the names of the files in the draft of a result, all of which must belong to its kind.
    fn names_in(&self, draft: &Path) -> Result<Vec<&'static str>, OutputError> {
        let n_entries = fs::read_dir(draft).map_err(cannot_read(draft))?.count();
        let names: Vec<&str> = (self.kind.files().iter())
            .copied()
            .filter(|name| draft.join(name).is_file())
            .collect();
        if names.len() == n_entries {
            Ok(names)
        } else {
            let names = names.join(", ");
            Err(OutputError::malformed(
                draft,
                format!("{n_entries} entries, of which only {names} belong to such a result"),
            ))
        }
    }

    /// Moves the ready files into the result directory, the summary last, and removes other files of the same kind of result. Continues the
    /// work of a run that died.
    fn put_in_place(&self) -> Result<(), OutputError> {
        let Self { folder, target, .. } = self;
        let ready = folder.join(READY);
        // Without a summary nothing is ready, because the summary is moved last.
        let Some(kind) = ResultKind::of_directory(&ready) else {
            return Ok(());
        };
        permit(target, kind)?;
        if !target.exists() {
            return fs::rename(&ready, target).map_err(cannot_replace(target));
        }
        let manifest = folder.join(MANIFEST);
        let names = fs::read_to_string(&manifest).map_err(cannot_read(&manifest))?;
        self.put_placeholder(kind)?;
        for name in kind.files() {
            let (from, to) = (ready.join(name), target.join(name));
            if from.exists() {
                move_file(&from, &to).map_err(cannot_replace(&to))?;
            } else if !names.lines().any(|written| written == *name) {
                absent_is_fine(fs::remove_file(&to)).map_err(cannot_replace(&to))?;
            }
        }
        empty_folder(&ready).map_err(OutputError::unwritten(&ready, "cannot remove"))
    }

    /// Marks the result directory as one whose files are being replaced.
    fn put_placeholder(&self, kind: ResultKind) -> Result<(), OutputError> {
        let placeholder = self.folder.join(PLACEHOLDER);
        let text = json!({
            "schema_version": SCHEMA_VERSION,
            "tool": TOOL,
            "command": kind.command(),
            "status": UNFINISHED,
            "message": "softarm was stopped while it replaced the files of this directory; its next run into it completes them",
        });
        fs::write(&placeholder, format!("{text:#}\n"))
            .and_then(|()| move_file(&placeholder, &self.target.join(SUMMARY)))
            .map_err(OutputError::unwritten(&placeholder, "cannot write"))
    }
}

impl Drop for RunDirectory {
    /// Removes the directory if there is nothing to resume.
    fn drop(&mut self) {
        let holds_more =
            |entries: fs::ReadDir| (entries.flatten()).any(|entry| entry.file_name() != LOCK_FILE);
        if fs::read_dir(&self.folder).is_ok_and(|entries| !holds_more(entries)) {
            let _ = fs::remove_file(self.folder.join(LOCK_FILE));
            let _ = fs::remove_dir(&self.folder);
        }
    }
}

/// Creates the folder if there is none, and locks it.
fn lock(folder: &Path) -> Result<File, OutputError> {
    let path = folder.join(LOCK_FILE);
    let at_work = || {
        OutputError::refused(
            folder,
            "another run is at work on this result; wait for it, or choose another --out",
        )
    };
    for _ in 0..ATTEMPTS {
        match fs::create_dir(folder) {
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists => {
                return Err(OutputError::unwritten(folder, "cannot create")(error));
            }
            _ => refuse_foreign(folder)?,
        }
        let file = match OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)
        {
            Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
            other => other.map_err(OutputError::unwritten(&path, "cannot create"))?,
        };
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(at_work()),
            Err(TryLockError::Error(error)) => {
                return Err(OutputError::unwritten(&path, "cannot lock")(error));
            }
        }
        // The previous holder may have removed the directory since it was opened.
        if is_at(&file, &path) {
            return Ok(file);
        }
    }
    Err(at_work())
}

/// Tells whether an open file is the one at `path`.
fn is_at(file: &File, path: &Path) -> bool {
    let (Ok(open), Ok(named)) = (file.metadata(), fs::symlink_metadata(path)) else {
        return false;
    };
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt as _;
        (open.dev(), open.ino()) == (named.dev(), named.ino())
    }
    #[cfg(not(unix))]
    {
        open.is_file() && named.is_file() // an open file cannot be removed here
    }
}

fn cannot_read(path: &Path) -> impl FnOnce(io::Error) -> OutputError {
    OutputError::io(path, "cannot read")
}

fn cannot_replace(path: &Path) -> impl FnOnce(io::Error) -> OutputError {
    OutputError::unwritten(path, "cannot put in place")
}

/// Checks that the folder is a directory with files of softarm only.
fn refuse_foreign(folder: &Path) -> Result<(), OutputError> {
    let refuse = |path: &Path| {
        Err(OutputError::refused(
            path,
            "stands where softarm keeps a run on its way, and is not from it; move it away, or choose another --out",
        ))
    };
    match fs::symlink_metadata(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        other => {
            if !other.map_err(cannot_read(folder))?.is_dir() {
                return refuse(folder);
            }
        }
    }
    let entries = |path: &Path| -> Result<Vec<DirEntry>, OutputError> {
        match fs::read_dir(path).and_then(Iterator::collect) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
            other => other.map_err(cannot_read(path)),
        }
    };
    for entry in entries(folder)? {
        let path = entry.path();
        if !is_own(&entry).map_err(cannot_read(&path))? {
            return refuse(&path);
        }
        if !entry.file_type().map_err(cannot_read(&path))?.is_dir() {
            continue;
        }
        for inner in entries(&path)? {
            let inner_path = inner.path();
            if !is_own_within(&entry.file_name(), &inner).map_err(cannot_read(&inner_path))? {
                return refuse(&inner_path);
            }
        }
    }
    Ok(())
}

/// Tells whether softarm creates such an entry in the directory of a run.
fn is_own(entry: &DirEntry) -> io::Result<bool> {
    let (name, kind) = (entry.file_name(), entry.file_type()?);
    let is_one_of = |names: &[&str]| names.iter().any(|own| name == *own);
    let files = [
        LOCK_FILE,
        MANIFEST,
        PLACEHOLDER,
        CHECKPOINT_FILE,
        FRESH_CHECKPOINT_FILE,
        JOURNAL_FILE,
    ];
    Ok((kind.is_file() && is_one_of(&files))
        || (kind.is_dir() && (is_one_of(&ROW_FOLDERS) || is_one_of(&[DRAFT, READY]))))
}

/// Tells whether softarm creates such an entry in one of its folders.
fn is_own_within(folder: &OsStr, entry: &DirEntry) -> io::Result<bool> {
    let name = entry.file_name();
    let is_known = if ROW_FOLDERS.iter().any(|rows| folder == *rows) {
        Path::new(&name).extension() == Some(OsStr::new(ROW_ENDING))
    } else {
        (ResultKind::ALL.iter())
            .flat_map(|kind| kind.files())
            .chain(&[FRESH_CHECKPOINT_FILE])
            .any(|own| name == *own)
    };
    Ok(is_known && entry.file_type()?.is_file())
}

/// Moves a file over another, whose mode it takes, or over a link, in one operation; in two onto another disk.
fn move_file(from: &Path, to: &Path) -> io::Result<()> {
    if let Ok(old) = fs::symlink_metadata(to)
        && old.is_file()
    {
        fs::set_permissions(from, old.permissions())?;
    }
    match fs::rename(from, to) {
        Err(error) if error.kind() == io::ErrorKind::CrossesDevices => {
            absent_is_fine(fs::remove_file(to))?; // a link would be followed
            let mut target = File::create_new(to)?;
            io::copy(&mut File::open(from)?, &mut target)?;
            fs::remove_file(from)
        }
        other => other,
    }
}

/// Removes a folder of files.
fn empty_folder(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        fs::remove_file(entry?.path())?;
    }
    fs::remove_dir(folder)
}

fn absent_is_fine(outcome: io::Result<()>) -> io::Result<()> {
    match outcome {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    fn summary(kind: ResultKind) -> serde_json::Value {
        json!({"schema_version": SCHEMA_VERSION, "tool": TOOL, "command": kind.command()})
    }

    /// Writes a solve with these files besides the summary, with their own names as content.
    fn fill(files: &[&str]) -> impl Fn(&ResultDirectory) -> Result<(), OutputError> {
        move |result| {
            for name in files {
                result.write_text(name, name)?;
            }
            result.write_json(SUMMARY, &summary(ResultKind::Solve))
        }
    }

    fn solve(target: &Path, files: &[&str]) -> Result<PathBuf, OutputError> {
        RunDirectory::open(target, ResultKind::Solve)?.publish(fill(files))
    }

    /// The target does not exist before it is published; afterwards it has the written files, and no folder beside it remains. An abandoned
    /// run leaves nothing.
    #[test]
    fn result_appears_whole() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("deep").join("result");
        drop(RunDirectory::open(&target, ResultKind::Solve).unwrap());
        assert!(names(target.parent().unwrap()).is_empty());
        let run = RunDirectory::open(&target, ResultKind::Solve).unwrap();
        let written = run
            .publish(|result| {
                assert_eq!(result.place(), target);
                fill(&["scene.toml"])(result)?;
                assert!(!target.exists());
                Ok(())
            })
            .unwrap();
        assert_eq!(written, target);
        assert_eq!(names(&target), ["scene.toml", SUMMARY]);
        assert_eq!(names(target.parent().unwrap()), ["result"]);
    }

    /// Files of an earlier result are removed, whether the new one has them or not; files and folders of the user are kept, with their
    /// content, also in a directory that was empty.
    #[test]
    fn only_own_files_are_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("result");
        fs::create_dir(&target).unwrap();
        solve(&target, &["controls.csv", "report.html"]).unwrap();
        fs::write(target.join("notes.md"), "mine").unwrap();
        fs::write(
            target.join("checkpoint.json"),
            "mine: no solve has such a file",
        )
        .unwrap();
        fs::create_dir(target.join("figures")).unwrap();
        fs::write(target.join("figures/report.html"), "mine").unwrap();
        fs::write(target.join("report.html"), "changed").unwrap();
        solve(&target, &["iterations.csv", "report.html"]).unwrap();
        let expected = [
            "checkpoint.json",
            "figures",
            "iterations.csv",
            "notes.md",
            "report.html",
            SUMMARY,
        ];
        assert_eq!(names(&target), expected);
        let read = |name: &str| fs::read_to_string(target.join(name)).unwrap();
        assert_eq!(read("report.html"), "report.html");
        assert_eq!(read("notes.md"), "mine");
        assert_eq!(read("figures/report.html"), "mine");
        assert_eq!(names(folder.path()), ["result"]);
    }

    /// A file, a directory of other files, one with a foreign summary, one with the result of another command, and one in which a directory
    /// has the name of one of softarm's files, are refused and kept unchanged; so is a directory that becomes foreign during the run.
    #[test]
    fn foreign_directories_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("thesis");
        let refused = |word: &str| {
            let before = names(&target);
            let error = solve(&target, &["report.html"]).unwrap_err();
            assert!(matches!(error, OutputError::Refused { .. }), "{error}");
            let error = error.to_string();
            assert!(error.contains(word) && error.contains("thesis"), "{error}");
            assert_eq!(names(&target), before);
            assert_eq!(names(folder.path()), ["thesis"]);
        };
        fs::create_dir(&target).unwrap();
        fs::write(target.join("chapter.tex"), "").unwrap();
        refused("no result of softarm");
        fs::write(
            target.join(SUMMARY),
            r#"{"schema_version": 1, "command": "solve"}"#,
        )
        .unwrap();
        refused("no result of softarm");
        let simulation = summary(ResultKind::Simulate).to_string();
        fs::write(target.join(SUMMARY), simulation).unwrap();
        refused("`softarm simulate`");
        fs::write(target.join(SUMMARY), summary(ResultKind::Solve).to_string()).unwrap();
        fs::create_dir(target.join("controls.csv")).unwrap();
        refused("`controls.csv`");
        fs::remove_dir(target.join("controls.csv")).unwrap();
        let run = RunDirectory::open(&target, ResultKind::Solve).unwrap();
        fs::write(target.join(SUMMARY), r#"{"chapters": 7}"#).unwrap();
        assert!(run.publish(fill(&[])).is_err());
        assert_eq!(names(&target), ["chapter.tex", SUMMARY]);
        let error = solve(&target.join(SUMMARY), &[]).unwrap_err().to_string();
        assert!(error.contains("not a directory"), "{error}");
    }

    /// A symbolic link in the place of the result, of the run's directory, of its lock or of one of its folders is refused, and its target
    /// is kept; one in the place of a file of the result is replaced, not followed.
    #[cfg(unix)]
    #[test]
    fn links_are_not_followed() {
        use std::os::unix::fs::symlink;
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let target = path("result");
        fs::create_dir(path("precious")).unwrap();
        fs::write(path("precious/report.html"), "mine").unwrap();
        fs::write(path("precious/lock"), "mine").unwrap();
        let refused = |link: &str, to: &str| {
            symlink(path(to), path(link)).unwrap();
            for kind in ResultKind::ALL {
                let error = RunDirectory::open(&target, kind).unwrap_err().to_string();
                assert!(error.contains(link), "{error}");
            }
            fs::remove_file(path(link)).unwrap();
        };
        refused("result", "precious");
        refused("result", "nothing");
        refused(".result.running", "precious");
        refused(".result.running", "nothing");
        fs::create_dir(path(".result.running")).unwrap();
        for link in ["lock", "draft", "ready", "trajectory", "checkpoint.json"] {
            refused(&format!(".result.running/{link}"), "precious");
            refused(&format!(".result.running/{link}"), "precious/lock");
        }
        solve(&target, &["report.html"]).unwrap();
        fs::remove_file(target.join("report.html")).unwrap();
        symlink(path("precious/report.html"), target.join("report.html")).unwrap();
        solve(&target, &["report.html"]).unwrap();
        let read = |name: &str| fs::read_to_string(path(name)).unwrap();
        assert_eq!(read("result/report.html"), "report.html");
        assert_eq!(read("precious/report.html"), "mine");
        assert_eq!(names(folder.path()), ["precious", "result"]);
    }

    /// Any foreign file in the directory of a run is refused before anything is changed.
    #[test]
    fn foreign_files_in_a_run_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("result");
        let running = folder.path().join(".result.running");
        for foreign in [
            "notes.md",
            "draft/notes.md",
            "trajectory/notes.md",
            "draft/deep/x",
        ] {
            let path = running.join(foreign);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(running.join(MANIFEST), "").unwrap();
            fs::write(&path, "mine").unwrap();
            let error = solve(&target, &[]).unwrap_err().to_string();
            assert!(error.contains("move it away"), "{error}");
            assert_eq!(fs::read_to_string(&path).unwrap(), "mine");
            assert!(running.join(MANIFEST).exists());
            fs::remove_dir_all(&running).unwrap();
        }
    }

    /// The remains of a run that died while it wrote any file of a result, or a checkpoint there, are removed by the next run.
    #[test]
    fn remains_of_dead_runs_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("result");
        let draft = folder.path().join(".result.running").join(DRAFT);
        let files = ResultKind::ALL.map(ResultKind::files).concat();
        for name in [&files[..], &[FRESH_CHECKPOINT_FILE]].concat() {
            fs::create_dir_all(&draft).unwrap();
            fs::write(draft.join(name), "half").unwrap();
            solve(&target, &["report.html"]).unwrap();
            assert_eq!(names(folder.path()), ["result"], "{name}");
        }
    }

    /// Two runs cannot share a directory; the files of the first are available to the next run of its kind, and refused to the other kind.
    #[test]
    fn run_directory_is_locked_and_stays() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("result");
        let open = || RunDirectory::open(&target, ResultKind::Simulate);
        let first = open().unwrap();
        fs::create_dir(first.path().join("trajectory")).unwrap();
        fs::write(first.path().join("trajectory/t.f64"), "12345678").unwrap();
        fs::write(first.path().join(CHECKPOINT_FILE), "{}").unwrap();
        for kind in ResultKind::ALL {
            let error = RunDirectory::open(&target, kind).unwrap_err().to_string();
            assert!(error.contains("another run"), "{error}");
        }
        drop(first);
        let error = solve(&target, &[]).unwrap_err().to_string();
        assert!(error.contains("can be resumed"), "{error}");
        let second = open().unwrap();
        assert!(second.path().join("trajectory/t.f64").exists());
        second.clear().unwrap();
        assert_eq!(names(second.path()), [LOCK_FILE]);
        assert!(open().is_err());
        second.remove().unwrap();
        assert!(names(folder.path()).is_empty());
    }

    /// Wherever a run dies while its files replace those of an earlier result, the next run finds a directory that does not count as a
    /// finished result, completes it, and loses no file of the user.
    #[test]
    fn a_dead_run_is_completed() {
        let new = ["scene.toml", "controls.csv", "report.html"];
        // Number of files that had been moved when the run died; the summary is moved last.
        for (n_moved, placeholder) in [(0, false), (0, true), (1, true), (3, true), (4, true)] {
            let folder = tempfile::tempdir().unwrap();
            let target = folder.path().join("result");
            solve(&target, &["scene.toml", "feedback.npz", "report.html"]).unwrap();
            fs::write(target.join("scene.toml"), "old").unwrap();
            fs::write(target.join("notes.md"), "mine").unwrap();

            let run = RunDirectory::open(&target, ResultKind::Solve).unwrap();
            let ready = run.path().join(READY);
            fs::create_dir(&ready).unwrap();
            fill(&new)(&ResultDirectory::new(&ready, &target)).unwrap();
            fs::write(
                run.path().join(MANIFEST),
                [&new[..], &[SUMMARY]].concat().join("\n"),
            )
            .unwrap();
            if placeholder {
                run.put_placeholder(ResultKind::Solve).unwrap();
                let summary = fs::read_to_string(target.join(SUMMARY)).unwrap();
                assert!(summary.contains("unfinished"));
            }
            for name in [&new[..], &[SUMMARY]].concat().iter().take(n_moved) {
                fs::rename(ready.join(name), target.join(name)).unwrap();
            }
            drop(run);

            let next = RunDirectory::open(&target, ResultKind::Solve).unwrap();
            if n_moved < 4 {
                assert_eq!(
                    names(&target),
                    [
                        "controls.csv",
                        "notes.md",
                        "report.html",
                        "scene.toml",
                        SUMMARY
                    ]
                );
            }
            let read = |name: &str| fs::read_to_string(target.join(name)).unwrap();
            assert_eq!(read("scene.toml"), "scene.toml");
            assert_eq!(read("notes.md"), "mine");
            assert!(!read(SUMMARY).contains("unfinished"));
            next.clear().unwrap();
            drop(next);
            assert_eq!(names(folder.path()), ["result"]);
        }
    }

    /// A failed `fill` leaves the earlier result unchanged, and no files of its own; a result that its place does not accept is written to
    /// another one, which the error names.
    #[test]
    fn a_result_without_a_place_is_rescued() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("result");
        solve(&target, &["report.html"]).unwrap();
        let run = RunDirectory::open(&target, ResultKind::Solve).unwrap();
        let full = || io::Error::from(io::ErrorKind::StorageFull);
        let error = run
            .publish_or_rescue(|result| {
                result.write_text("report.html", "new")?;
                if result.place() == target {
                    return Err(OutputError::unwritten(result.path(), "cannot write")(full()));
                }
                result.write_json(SUMMARY, &summary(ResultKind::Solve))
            })
            .unwrap_err();
        assert!(error.is_unwritten());
        let OutputError::Elsewhere { place, source } = error else {
            panic!("{error}")
        };
        assert!(source.to_string().contains("cannot write"), "{source}");
        assert_eq!(names(&place), ["report.html", SUMMARY]);
        fs::remove_dir_all(place).unwrap();
        assert_eq!(names(folder.path()), ["result"]);
        let kept = fs::read_to_string(target.join("report.html")).unwrap();
        assert_eq!(kept, "report.html");

        let run = RunDirectory::open(&target, ResultKind::Solve).unwrap();
        let error = run
            .publish_or_rescue(|result| {
                Err(OutputError::unwritten(result.path(), "cannot write")(full()))
            })
            .unwrap_err();
        assert!(matches!(error, OutputError::Nowhere { .. }), "{error}");
        assert_eq!(names(folder.path()), ["result"]);
    }
}
