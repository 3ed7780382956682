//! Paths to follow that stand in a CSV file beside the scene.

use super::error::SceneError;
use super::keys::{given, given_of};
use super::model::{Scene, TrackKeys};
use super::source::SceneSource;
use crate::output::open_regular;

/// Most rows of a file.
const MOST_ROWS: usize = 1_000_000;
/// Size of the largest file in bytes: rows of eight numbers of 24 characters, with as many for separators and comments.
const LARGEST_FILE: u64 = 8 * 32 * MOST_ROWS as u64;

impl Scene {
    /// Reads the files of all tracks into their rows, so that the scene no longer depends on them.
    pub(super) fn read_paths(&mut self, source: &SceneSource) -> Result<(), SceneError> {
        let tracks = self
            .objective
            .iter_mut()
            .flat_map(|objective| &mut objective.track);
        for (index, track) in tracks.enumerate() {
            read_path(track, source, &format!("objective.track.{index}"))?;
        }
        Ok(())
    }
}

fn read_path(track: &mut TrackKeys, source: &SceneSource, section: &str) -> Result<(), SceneError> {
    let Some(name) = track.path_csv.take() else {
        return Ok(());
    };
    let key = format!("{section}.path_csv");
    if let Some(other) = given_of(&given!(track: path_m, circle, figure_eight)).next() {
        let message = format!("path_csv and {other} are two paths");
        return Err(source.error_at(&key, message, Some("leave one out".into())));
    }
    let path = source.beside(&name);
    let refuse = |message: String| {
        let help = "a row a point, t in s, x, y and z in m, with increasing t, and after them, if it is to be turned, the quaternion w, x, y, z; a first row of names and lines that begin with # are passed over";
        source.error_at(
            &key,
            format!("{}: {message}", path.display()),
            Some(help.into()),
        )
    };
    let file = open_regular(&path, LARGEST_FILE).map_err(|error| refuse(error.to_string()))?;
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .comment(Some(b'#'))
        .flexible(true)
        .trim(csv::Trim::All)
        .from_reader(file);
    let mut turns = Vec::new();
    for (index, record) in reader.records().enumerate() {
        let record = record.map_err(|error| refuse(error.to_string()))?;
        let line = record
            .position()
            .map_or(index as u64 + 1, csv::Position::line);
        let numbers: Result<Vec<f64>, _> = record.iter().map(str::parse).collect();
        let row = match numbers {
            Ok(numbers) => numbers,
            Err(_) if index == 0 => continue,
            Err(_) => {
                let words = record.iter().find(|word| word.parse::<f64>().is_err());
                let word = words.unwrap_or_default();
                return Err(refuse(format!("line {line}: {word:?} is not a number")));
            }
        };
        if track.path_m.len() == MOST_ROWS {
            return Err(refuse(format!("more than {MOST_ROWS} rows")));
        }
        if !row.iter().all(|number| number.is_finite()) {
            return Err(refuse(format!(
                "line {line} has a number that is not finite"
            )));
        }
        let expected = match (track.path_m.is_empty(), row.len()) {
            (true, 4 | 8) => row.len(),
            (true, _) => 4,
            (false, _) if turns.is_empty() => 4,
            (false, _) => 8,
        };
        if row.len() != expected {
            let n = row.len();
            let message = format!("line {line} has {n} numbers, expected {expected}");
            return Err(refuse(message));
        }
        if (track.path_m.last()).is_some_and(|before| !(before[0] < row[0])) {
            return Err(refuse(format!("line {line}: t does not increase")));
        }
        track.path_m.push([row[0], row[1], row[2], row[3]]);
        if let [t, _, _, _, w, x, y, z] = row[..] {
            turns.push([t, w, x, y, z]);
        }
    }
    if !turns.is_empty() && !track.orientations_wxyz.is_empty() {
        let message = "path_csv has quaternions, and there are orientations_wxyz";
        return Err(source.error_at(&key, message, Some("leave one out".into())));
    }
    track.orientations_wxyz.append(&mut turns);
    if track.path_m.is_empty() {
        return Err(refuse("there is no row of numbers".into()));
    }
    Ok(())
}
