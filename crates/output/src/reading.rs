//! Reading of files that a user wrote, or of results that may have been changed: only regular files are opened, and no more data is read
//! than the result can have.

use std::fmt;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::Path;

use super::OutputError;

/// The reason why a file of a user or of a result is not read.
#[derive(Debug)]
pub enum Unreadable {
    /// The system refuses to read the file.
    Io(io::Error),
    /// The file is not a regular one; the name of its kind is given.
    Kind(&'static str),
    /// The file has at least the first number of bytes, and may have at most the second.
    Large(u64, u64),
}

impl Unreadable {
    fn of(self, path: &Path) -> OutputError {
        match self {
            Self::Io(error) => OutputError::io(path, "cannot read")(error),
            unfit => OutputError::malformed(path, unfit.to_string()),
        }
    }
}

impl fmt::Display for Unreadable {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Io(error) => write!(f, "cannot be read: {error}"),
            Self::Kind(kind) => write!(f, "{kind}, not a file"),
            Self::Large(found, largest) => write!(
                f,
                "{found} bytes or more; what it should hold takes at most {largest}"
            ),
        }
    }
}

/// Opens a regular file of at most `largest` bytes; other kinds are refused unopened (reading a pipe could wait for ever, a device never
/// ends).
pub fn open_regular(path: &Path, largest: u64) -> Result<File, Unreadable> {
    let found = fs::metadata(path).map_err(Unreadable::Io)?;
    if !found.is_file() {
        let kind = if found.is_dir() {
            "a directory"
        } else {
            "a device or a pipe"
        };
        return Err(Unreadable::Kind(kind));
    }
    let file = File::open(path).map_err(Unreadable::Io)?;
    let length = file.metadata().map_err(Unreadable::Io)?.len();
    if length > largest {
        return Err(Unreadable::Large(length, largest));
    }
    Ok(file)
}

/// Opens a regular file of a result.
pub(super) fn open(path: &Path, largest: u64) -> Result<File, OutputError> {
    open_regular(path, largest).map_err(|error| error.of(path))
}

/// Reads a regular file of at most `largest` bytes.
pub fn read_regular(path: &Path, largest: u64) -> Result<Vec<u8>, Unreadable> {
    let mut bytes = Vec::new();
    // Some files report a size of zero although they are not empty.
    open_regular(path, largest)?
        .take(largest.saturating_add(1))
        .read_to_end(&mut bytes)
        .map_err(Unreadable::Io)?;
    if bytes.len() as u64 > largest {
        return Err(Unreadable::Large(bytes.len() as u64, largest));
    }
    Ok(bytes)
}

/// Reads a text of at most `largest` bytes.
///
/// # Errors
/// Returns [`OutputError`] for a path that is not a file, a larger file, or one that is not UTF-8.
pub fn read_text(path: &Path, largest: u64) -> Result<String, OutputError> {
    let bytes = read_regular(path, largest).map_err(|error| error.of(path))?;
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        OutputError::malformed(
            path,
            format!("not UTF-8 text: the byte at offset {at} is invalid"),
        )
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Damage to the bytes of a file.
    #[derive(Clone, Debug)]
    pub(crate) enum Accident {
        Flip(prop::sample::Index, u8),
        Cut(prop::sample::Index),
        Insert(prop::sample::Index, Vec<u8>),
        Remove(prop::sample::Index, usize),
        Repeat(prop::sample::Index, usize),
    }

    pub(crate) fn accidents() -> impl Strategy<Value = Vec<Accident>> {
        let at = any::<prop::sample::Index>;
        let one = prop_oneof![
            4 => (at(), 0..8u8).prop_map(|(at, bit)| Accident::Flip(at, bit)),
            1 => at().prop_map(Accident::Cut),
            2 => (at(), prop::collection::vec(any::<u8>(), 1..20)).prop_map(|(at, b)| Accident::Insert(at, b)),
            1 => (at(), 1..200usize).prop_map(|(at, n)| Accident::Remove(at, n)),
            1 => (at(), 1..200usize).prop_map(|(at, n)| Accident::Repeat(at, n)),
        ];
        prop::collection::vec(one, 1..4)
    }

    pub(crate) fn damaged(bytes: &[u8], accidents: &[Accident]) -> Vec<u8> {
        let mut bytes = bytes.to_vec();
        for accident in accidents {
            if bytes.is_empty() {
                break;
            }
            let n = bytes.len();
            match accident {
                Accident::Flip(at, bit) => bytes[at.index(n)] ^= 1 << bit,
                Accident::Cut(at) => bytes.truncate(at.index(n)),
                Accident::Insert(at, more) => {
                    let at = at.index(n);
                    bytes.splice(at..at, more.iter().copied());
                }
                Accident::Remove(at, count) => {
                    let at = at.index(n);
                    bytes.drain(at..(at + count).min(n));
                }
                Accident::Repeat(at, count) => {
                    let at = at.index(n);
                    let part = bytes[at..(at + count).min(n)].to_vec();
                    bytes.splice(at..at, part);
                }
            }
        }
        bytes
    }

    /// A directory, a device, a text that is too long and one that is not UTF-8 are refused by their kind.
    #[test]
    fn only_text_files_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("text");
        let refused = |path: &Path, word: &str| {
            let error = read_text(path, 10).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        };
        refused(folder.path(), "a directory, not a file");
        fs::write(&path, "0123456789a").unwrap();
        refused(&path, "11 bytes or more");
        fs::write(&path, b"abc\xff").unwrap();
        refused(&path, "offset 3");
        fs::write(&path, "0123456789").unwrap();
        assert_eq!(read_text(&path, 10).unwrap(), "0123456789");
        if cfg!(unix) {
            refused(Path::new("/dev/zero"), "a device or a pipe, not a file");
        }
    }
}
