use std::io;
use std::path::{Path, PathBuf};

/// Why a file could not be written, read or replaced; every variant names the path.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// The operating system said no.
    #[error("{}: {action}: {source}", path.display())]
    Io {
        /// The file or directory.
        path: PathBuf,
        /// What was attempted, as in "cannot write".
        action: &'static str,
        /// The operating system's answer.
        source: io::Error,
    },
    /// The content is not what the file promises.
    #[error("{}{}: {reason}", path.display(), line.map(|line| format!(":{line}")).unwrap_or_default())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The line in a text file, counted from 1.
        line: Option<u64>,
        /// What is wrong, and what was expected.
        reason: String,
    },
    /// Replacing the path would destroy something that is not an earlier result.
    #[error("{}: {reason}", path.display())]
    Refused {
        /// The path that was to be replaced.
        path: PathBuf,
        /// What stands there, and what to do.
        reason: String,
    },
}

impl OutputError {
    /// Turns an I/O error into one that names the path; made for `map_err`.
    pub(crate) fn io(path: &Path, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io {
            path: path.to_path_buf(),
            action,
            source,
        }
    }

    /// Content error without a line number.
    pub(super) fn malformed(path: &Path, reason: impl Into<String>) -> Self {
        Self::Malformed {
            path: path.to_path_buf(),
            line: None,
            reason: reason.into(),
        }
    }

    /// Refusal to replace `path`.
    pub(super) fn refused(path: &Path, reason: impl Into<String>) -> Self {
        Self::Refused {
            path: path.to_path_buf(),
            reason: reason.into(),
        }
    }
}
