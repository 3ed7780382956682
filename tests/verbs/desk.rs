//! A folder with a scene, where runs of the tool leave their results.

use std::fs;
use std::path::PathBuf;
use std::process::Command;

use serde_json::Value;
use tempfile::TempDir;

use crate::tool::DONE;

/// A folder of its own with the scene `arm.toml`; it goes with the value.
pub struct Desk(TempDir);

impl Desk {
    pub fn holding(scene: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("arm.toml"), scene).unwrap();
        Self(folder)
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn read(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap()
    }

    /// Runs a line of words, and returns its exit code, its summary and its talk.
    pub fn run(&self, line: &str) -> (i32, Value, String) {
        let output = Command::new(env!("CARGO_BIN_EXE_softarm"))
            .args(line.split_whitespace())
            .args(["--json", "--quiet"])
            .current_dir(self.0.path())
            .output()
            .unwrap();
        let talk = String::from_utf8_lossy(&output.stderr).into_owned();
        let summary = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
        (output.status.code().unwrap(), summary, talk)
    }

    /// Returns the summary of a run that ends well.
    #[track_caller]
    pub fn done(&self, line: &str) -> Value {
        let (code, summary, talk) = self.run(line);
        assert_eq!(code, DONE, "{line}: {talk}");
        summary
    }
}
