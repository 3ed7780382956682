//! The journal of a sweep in progress, one point a line, from which a killed sweep can be resumed.

use std::fs::{self, File};
use std::io::Write as _;
use std::path::Path;

use crate::output::{JOURNAL_FILE, OutputError, read_text};
use crate::tradeoff::Point;

/// Cap on the bytes of a journal that is read.
const LARGEST: u64 = 1 << 24;

/// Writes points as they are measured: the text of the scene in the first line, then one point a line, each as JSON.
#[derive(Debug)]
pub struct Journal {
    file: File,
}

impl Journal {
    /// Begins a journal in the folder of a run, with the points of an earlier sweep.
    ///
    /// # Errors
    /// Returns [`OutputError`] if it cannot be written.
    pub fn begin(folder: &Path, scene: &str, known: &[Point]) -> Result<Self, OutputError> {
        let path = folder.join(JOURNAL_FILE);
        let unwritten = || OutputError::unwritten(&path, "cannot write");
        let mut file = File::create(&path).map_err(unwritten())?;
        let first = serde_json::Value::from(scene);
        writeln!(file, "{first}").map_err(unwritten())?;
        let mut journal = Self { file };
        for point in known {
            journal.note(point);
        }
        Ok(journal)
    }

    /// Adds a point. If that fails, the sweep continues without a journal and still writes its result at the end.
    pub fn note(&mut self, point: &Point) {
        let erased: &dyn erased_serde::Serialize = point;
        if let Ok(line) = serde_json::to_string(erased) {
            let _ = self.file.write_all((line + "\n").as_bytes());
        }
    }
}

/// Reads the journal that a sweep left in the folder of its run: the text of its scene, and its points; an incomplete last line is skipped.
/// Returns `None` if there is no journal or it cannot be read.
#[must_use]
pub fn journal_in(folder: &Path) -> Option<(String, Vec<serde_json::Value>)> {
    let path = folder.join(JOURNAL_FILE);
    if !fs::symlink_metadata(&path).is_ok_and(|found| found.is_file()) {
        return None;
    }
    let text = read_text(&path, LARGEST).ok()?;
    let mut lines = text.lines();
    let scene = serde_json::from_str(lines.next()?).ok()?;
    let points = lines.filter_map(|line| serde_json::from_str(line).ok());
    Some((scene, points.collect()))
}
