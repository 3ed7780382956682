use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::Serialize;
use tempfile::TempDir;

use super::OutputError;

/// A result directory in the making: it appears at its target whole, or not at all.
///
/// Files are written to a hidden sibling of the target; [`finish`](Self::finish) renames it into place.
/// Dropped before that, it leaves nothing behind.
#[derive(Debug)]
pub struct ResultDirectory {
    target: PathBuf,
    /// Holds the new directory, and for a moment the one that it replaces.
    workshop: TempDir,
    path: PathBuf,
}

impl ResultDirectory {
    /// Opens a directory that will become `target`; parents are made.
    ///
    /// The target may be absent, empty, or an earlier result (its `summary.json` has a `schema_version`).
    pub fn create(target: &Path) -> Result<Self, OutputError> {
        Self::create_in(None, target)
    }

    /// The same with the files in `folder`, on the disk of the target, until they are in place; without one, beside the
    /// target.
    pub fn create_in(folder: Option<&Path>, target: &Path) -> Result<Self, OutputError> {
        let cannot_create = |path| OutputError::io(path, "cannot create");
        let target = resolve(target)?;
        refuse_to_destroy(&target)?;
        let (Some(parent), Some(name)) = (target.parent(), target.file_name()) else {
            return Err(OutputError::refused(&target, "not a name for a directory"));
        };
        fs::create_dir_all(parent).map_err(cannot_create(parent))?;
        let parent = folder.unwrap_or(parent);
        let workshop = tempfile::Builder::new()
            .prefix(&format!(".{}.", name.to_string_lossy()))
            .tempdir_in(parent)
            .map_err(cannot_create(parent))?;
        // A subdirectory, because the temporary one is readable by its owner alone.
        let path = workshop.path().join("new");
        fs::create_dir(&path).map_err(cannot_create(&path))?;
        Ok(Self {
            target,
            workshop,
            path,
        })
    }

    /// Whether [`create`](Self::create) would accept `target`, without touching anything.
    pub fn permit(target: &Path) -> Result<(), OutputError> {
        refuse_to_destroy(&resolve(target)?)
    }

    /// Where to write files until [`finish`](Self::finish).
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes a text file.
    pub fn write_text(&self, name: &str, text: &str) -> Result<(), OutputError> {
        let path = self.path.join(name);
        fs::write(&path, text).map_err(OutputError::io(&path, "cannot write"))
    }

    /// Writes a value as indented JSON with a newline at its end; non-finite numbers become `null`.
    pub fn write_json(&self, name: &str, value: &impl Serialize) -> Result<(), OutputError> {
        let text = serde_json::to_string_pretty(value)
            .map_err(|error| OutputError::malformed(&self.path.join(name), error.to_string()))?;
        self.write_text(name, &(text + "\n"))
    }

    /// Puts the directory in its place and returns it; an earlier result there is replaced.
    pub fn finish(self) -> Result<PathBuf, OutputError> {
        let Self {
            target,
            workshop,
            path,
        } = self;
        refuse_to_destroy(&target)?;
        let cannot_replace = || OutputError::io(&target, "cannot put the result in place");
        let previous = workshop.path().join("previous");
        let replaces = match fs::rename(&target, &previous) {
            Ok(()) => true,
            Err(error) if error.kind() == io::ErrorKind::NotFound => false,
            Err(error) => return Err(cannot_replace()(error)),
        };
        if let Err(error) = fs::rename(&path, &target) {
            if replaces && fs::rename(&previous, &target).is_err() {
                let _ = workshop.keep(); // the only copy of the earlier result is in there
            }
            return Err(cannot_replace()(error));
        }
        workshop
            .close()
            .map_err(OutputError::io(&target, "cannot remove the earlier result"))?;
        Ok(target)
    }
}

/// The absolute target, through symbolic links if it exists.
pub(super) fn resolve(target: &Path) -> Result<PathBuf, OutputError> {
    match fs::canonicalize(target) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => std::path::absolute(target),
        other => other,
    }
    .map_err(OutputError::io(target, "cannot open"))
}

/// `Ok` if the target is absent, empty or an earlier result.
fn refuse_to_destroy(target: &Path) -> Result<(), OutputError> {
    let cannot_read = || OutputError::io(target, "cannot read");
    let metadata = match fs::symlink_metadata(target) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        other => other.map_err(cannot_read())?,
    };
    if !metadata.is_dir() {
        return Err(OutputError::refused(
            target,
            "exists and is not a directory; choose another",
        ));
    }
    if std::env::current_dir().is_ok_and(|current| current.starts_with(target)) {
        return Err(OutputError::refused(
            target,
            "the current directory cannot be replaced; name one inside it",
        ));
    }
    let is_empty = fs::read_dir(target)
        .map_err(cannot_read())?
        .next()
        .is_none();
    if is_empty || is_result(target) {
        return Ok(());
    }
    Err(OutputError::refused(
        target,
        "holds files that are not an earlier result \
         (no summary.json with a schema_version); choose another directory, or empty it",
    ))
}

fn is_result(directory: &Path) -> bool {
    let Ok(text) = fs::read_to_string(directory.join("summary.json")) else {
        return false;
    };
    serde_json::from_str::<serde_json::Value>(&text)
        .is_ok_and(|summary| summary.get("schema_version").is_some())
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

    /// Until `finish` the target does not exist; after it, it holds what was written and no sibling remains.
    #[test]
    fn result_appears_whole() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("deep").join("result");
        let result = ResultDirectory::create(&target).unwrap();
        result.write_text("scene.toml", "[rod]\n").unwrap();
        result
            .write_json("summary.json", &serde_json::json!({"schema_version": 1}))
            .unwrap();
        assert!(!target.exists());
        assert_eq!(
            result.finish().unwrap().canonicalize().unwrap(),
            target.canonicalize().unwrap()
        );
        assert_eq!(names(&target), ["scene.toml", "summary.json"]);
        assert_eq!(
            fs::read_to_string(target.join("summary.json")).unwrap(),
            "{\n  \"schema_version\": 1\n}\n"
        );
        assert_eq!(names(target.parent().unwrap()), ["result"]);
    }

    /// Dropped unfinished, it leaves nothing, and the earlier result stays as it was.
    #[test]
    fn unfinished_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("result");
        let result = ResultDirectory::create(&target).unwrap();
        result.write_text("a", "").unwrap();
        drop(result);
        assert!(names(folder.path()).is_empty());

        fs::create_dir(&target).unwrap();
        fs::write(target.join("summary.json"), r#"{"schema_version": 1}"#).unwrap();
        drop(ResultDirectory::create(&target).unwrap());
        assert_eq!(names(folder.path()), ["result"]);
        assert_eq!(names(&target), ["summary.json"]);
    }

    /// An earlier result and an empty directory are replaced; nothing of the old content remains.
    #[test]
    fn earlier_results_are_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("result");
        fs::create_dir(&target).unwrap();
        for round in ["first", "second"] {
            let result = ResultDirectory::create(&target).unwrap();
            result.write_text(round, "").unwrap();
            result
                .write_json("summary.json", &serde_json::json!({"schema_version": 1}))
                .unwrap();
            result.finish().unwrap();
            assert_eq!(names(&target), [round, "summary.json"]);
            assert_eq!(names(folder.path()), ["result"]);
        }
    }

    /// A file, a directory of other files, one with a foreign summary.json, and one that becomes foreign
    /// while the result is written are refused and keep their content.
    #[test]
    fn foreign_directories_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("thesis");
        fs::create_dir(&target).unwrap();
        let late = ResultDirectory::create(&target).unwrap();
        fs::write(target.join("summary.json"), r#"{"chapters": 7}"#).unwrap();
        for error in [
            ResultDirectory::create(&target).unwrap_err(),
            late.finish().unwrap_err(),
        ] {
            assert!(matches!(error, OutputError::Refused { .. }));
            assert!(error.to_string().contains("thesis"), "{error}");
        }
        assert_eq!(names(&target), ["summary.json"]);
        let error = ResultDirectory::create(&target.join("summary.json")).unwrap_err();
        assert!(error.to_string().contains("not a directory"), "{error}");
        let error = ResultDirectory::create(Path::new(".")).unwrap_err();
        assert!(error.to_string().contains("current directory"), "{error}");
        assert_eq!(names(folder.path()), ["thesis"]);
    }
}
