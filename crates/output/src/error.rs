use std::io;
use std::path::{Path, PathBuf};

/// The reason why a file could not be written, read or replaced; every variant names the path.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// The operating system did not let a file be read.
    #[error("{}: {action}: {source}", path.display())]
    Io {
        /// The file or directory.
        path: PathBuf,
        /// The operation that failed, as in "cannot read".
        action: &'static str,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The operating system did not let a file be written, moved or removed: a full disk, a missing permission.
    #[error("{}: {action}: {source}", path.display())]
    Unwritten {
        /// The file or directory.
        path: PathBuf,
        /// The operation that failed, as in "cannot write".
        action: &'static str,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The content of a file is invalid.
    #[error("{}{}: {reason}", path.display(), line.map(|line| format!(":{line}")).unwrap_or_default())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The line in a text file, counted from 1.
        line: Option<u64>,
        /// The fault, and what was expected.
        reason: String,
    },
    /// Writing there would touch a file that is not softarm's, or that another run uses.
    #[error("{}: {reason}", path.display())]
    Refused {
        /// The path that was to be written.
        path: PathBuf,
        /// The contents of the directory, and what to do.
        reason: String,
    },
    /// A result is not at the requested place, but saved elsewhere.
    #[error("{source}; the result is in {}", place.display())]
    Elsewhere {
        /// Directory of the result.
        place: PathBuf,
        /// The reason why the result is not in its own place.
        source: Box<OutputError>,
    },
    /// A result could not be written anywhere.
    #[error("{source}; nor could the result be written elsewhere: {last}")]
    Nowhere {
        /// The reason why the result is not in its own place.
        source: Box<OutputError>,
        /// The reason why the last of the other places does not have it.
        last: Box<OutputError>,
    },
    /// A simulation could not write its result, and can be resumed.
    #[error(
        "{source}; the computed rows are kept in {}; the same command with --resume continues from there",
        folder.display()
    )]
    Kept {
        /// The directory of the run.
        folder: PathBuf,
        /// The reason why the simulation ended.
        source: Box<OutputError>,
    },
}

impl OutputError {
    /// Turns an I/O error while reading into one that names the path, for `map_err`.
    pub fn io(path: &Path, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io {
            path: path.to_path_buf(),
            action,
            source,
        }
    }

    /// Turns an I/O error while writing into one that names the path, for `map_err`.
    pub fn unwritten(path: &Path, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Unwritten {
            path: path.to_path_buf(),
            action,
            source,
        }
    }

    /// Returns an error about the content, without a line number.
    pub fn malformed(path: &Path, reason: impl Into<String>) -> Self {
        Self::Malformed {
            path: path.to_path_buf(),
            line: None,
            reason: reason.into(),
        }
    }

    /// Returns the refusal to write to `path`.
    pub(super) fn refused(path: &Path, reason: impl Into<String>) -> Self {
        Self::Refused {
            path: path.to_path_buf(),
            reason: reason.into(),
        }
    }

    /// Tells whether a computed or requested result is not at its place.
    #[must_use]
    pub fn is_unwritten(&self) -> bool {
        match self {
            Self::Unwritten { .. }
            | Self::Elsewhere { .. }
            | Self::Nowhere { .. }
            | Self::Kept { .. } => true,
            Self::Io { .. } | Self::Malformed { .. } | Self::Refused { .. } => false,
        }
    }
}
