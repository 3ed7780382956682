//! Reads a scene from its file, and refuses what is too large or not text.

use super::builtin;
use super::error::{SceneError, excerpt, nearest};
use crate::output::{Unreadable, read_regular};
use std::path::Path;

/// Size of the largest scene file in bytes: a scene has some kilobytes, and the [state](super::InitialState) of the arm with the most
/// elements takes 24 numbers of at most 25 characters a node, 3 MB.
pub(crate) const LARGEST_SCENE: u64 = 1 << 22;

pub(super) const EXAMPLE_HELP: &str =
    "`softarm example reach` prints a commented scene to start from";

/// Returns the text of the regular file at `path`, of at most the allowed length. Pipes and devices are refused, since they may never end.
pub(super) fn read(path: &str) -> Result<String, SceneError> {
    let bytes = read_regular(Path::new(path), LARGEST_SCENE).map_err(|error| match error {
        Unreadable::Io(_) => SceneError::of_source(path, error.to_string()),
        Unreadable::Large(..) => {
            SceneError::of_source(path, "larger than 4 MiB, which is no scene file")
                .with_help(EXAMPLE_HELP)
        }
        Unreadable::Kind(kind) => SceneError::of_source(path, format!("{kind}, not a scene file"))
            .with_help("write the scene into a file, and name that"),
    })?;
    String::from_utf8(bytes).map_err(|error| {
        let position = error.utf8_error().valid_up_to();
        SceneError::of_source(
            path,
            format!("not UTF-8 text (the byte at offset {position} is invalid)"),
        )
        .with_help(EXAMPLE_HELP)
    })
}

/// Returns the error for a `path` that is a directory; a result directory has the scene that it was computed from.
pub(super) fn directory_error(path: &Path, name: &str) -> SceneError {
    let error = SceneError::of_source(name, "a directory, not a scene file");
    if path.join("scene.toml").is_file() {
        let inside = path.join("scene.toml");
        error.with_help(format!(
            "did you mean `{}`?",
            excerpt(&inside.to_string_lossy())
        ))
    } else {
        error
    }
}

/// Returns the error for a `name` that is neither a readable file nor a built-in scene.
pub(super) fn missing_error(name: &str, reason: &std::io::Error) -> SceneError {
    if reason.kind() != std::io::ErrorKind::NotFound {
        return SceneError::of_source(name, format!("cannot be read: {reason}"));
    }
    let known: Vec<&str> = builtin::names().collect();
    let list = format!("built-in scenes: {}", known.join(", "));
    let stem = name.strip_suffix(".toml").unwrap_or(name);
    let help = match nearest(stem, known.iter().copied()) {
        Some(near) => format!("did you mean `{near}`? {list}"),
        None => list,
    };
    SceneError::of_source(name, "no file and no built-in scene of this name").with_help(help)
}
