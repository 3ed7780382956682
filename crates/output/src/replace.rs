//! The rule by which single files are written: a file that softarm did not write is replaced only if the user names it.
//!
//! Links are followed to their target, and stay links. A file is replaced atomically, so that it is complete, old or new, at every moment,
//! and keeps its mode and its owner. A device or a pipe is written to and stays one; a disk, a socket and a directory are refused. A
//! read-only file is refused too, although its folder would allow to replace it.

use std::fs::{self, File, FileType, Metadata, OpenOptions};
use std::io::{self, Read as _, Write as _};
use std::path::{Path, PathBuf};

use super::{OutputError, PAGE_MARK};

/// Bytes at the beginning of a file in which softarm's mark is expected.
pub(super) const HEAD: u64 = 1 << 16;
/// Cap on the bytes of a page that is read before it is replaced.
const LARGEST_PAGE: u64 = 1 << 30;
/// Cap on successive links, as in Linux.
const MOST_LINKS: usize = 40;
/// Beginning of the first line of an exported table.
pub(super) const TABLE_HEAD: &str = "t_s,node,s,x_m,y_m,z_m,qw,qx,qy,qz";
/// A comment in the head of exported XML.
pub(super) const EXPORT_MARK: &str = "<!-- made by softarm export -->";

/// Evidence that an existing file was written by softarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Own {
    /// No evidence: the file belongs to the user.
    Nothing,
    /// A page of softarm.
    Page,
    /// A picture or a data file of `softarm export`.
    Export,
    /// No evidence is needed: the user named this file to be changed.
    Everything,
}

impl Own {
    /// Tells whether the beginning of a file is that of one of softarm's files.
    fn has_head(self, head: &str) -> bool {
        match self {
            Self::Nothing => false,
            // Pages of earlier versions have no mark, but their data.
            Self::Page => head.contains(PAGE_MARK) || head.contains("<script id=\"data\""),
            Self::Export => head.starts_with(TABLE_HEAD) || head.contains(EXPORT_MARK),
            Self::Everything => true,
        }
    }

    /// Returns the name of such a file in messages.
    fn name(self) -> &'static str {
        match self {
            Self::Page => "page of softarm",
            Self::Export => "export of softarm",
            Self::Nothing | Self::Everything => "file of softarm",
        }
    }
}

/// Writes single files by the rule of this module.
#[derive(Clone, Debug, Default)]
pub struct Writer {
    /// Files, and folders of files, that may be replaced although softarm did not write them.
    forced: Vec<PathBuf>,
}

/// The object at a path, with links followed.
enum Found {
    /// No object; a file is to be created at this path.
    Nothing(PathBuf),
    /// A regular file at this path.
    File(PathBuf, Metadata),
    /// A device or a pipe.
    Stream,
}

impl Writer {
    /// Creates a writer that may replace the named files, and those in named folders, whoever wrote them.
    #[must_use]
    pub fn forcing(files: &[PathBuf]) -> Self {
        Self {
            forced: files.to_vec(),
        }
    }

    /// Tells, before anything is computed, whether a file may be written.
    ///
    /// # Errors
    /// Returns [`OutputError`] for a path that [`write`](Self::write) would refuse.
    pub fn permit(&self, path: &Path, own: Own) -> Result<(), OutputError> {
        self.found(path, own).map(|_| ())
    }

    /// Writes a text to a file.
    ///
    /// # Errors
    /// Returns [`OutputError::Refused`] for a file that is not softarm's and not forced, for one that is read-only, and for a path that is
    /// neither a file nor a stream of bytes; [`OutputError::Unwritten`] if the system fails to write.
    pub fn write(&self, path: &Path, own: Own, text: &str) -> Result<(), OutputError> {
        let unwritten = || OutputError::unwritten(path, "cannot write");
        match self.found(path, own)? {
            Found::Nothing(place) => put(&place, None, text),
            Found::File(place, old) if is_shared(&place, path, &old) => {
                fs::write(&place, text) // in place, so that all of its names still refer to it
            }
            Found::File(place, old) => put(&place, Some(&old), text),
            Found::Stream => stream(path).and_then(|mut file| {
                file.write_all(text.as_bytes())?;
                file.flush()
            }),
        }
        .map_err(unwritten())
    }

    fn found(&self, path: &Path, own: Own) -> Result<Found, OutputError> {
        let refuse = |reason: String| Err(OutputError::refused(path, reason));
        let old = match fs::metadata(path) {
            Ok(old) => old,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return Ok(Found::Nothing(end_of_links(path)?));
            }
            Err(error) => return Err(OutputError::unwritten(path, "cannot write")(error)),
        };
        if old.is_dir() {
            return refuse(format!("a directory and no {}; name a file", own.name()));
        }
        if !old.is_file() {
            return match is_stream(old.file_type()) {
                true => Ok(Found::Stream),
                false => refuse("a disk or a socket, which softarm does not write to".into()),
            };
        }
        // The target of an entry in /proc and /dev need not exist at its path.
        let place = fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
        if old.permissions().readonly() {
            return refuse("read-only; make it writable, or name another file".into());
        }
        // Permission to change the folder is not permission to change the file.
        (OpenOptions::new().write(true).open(path))
            .map_err(OutputError::unwritten(path, "cannot write"))?;
        let is_own = own == Own::Everything
            || old.len() == 0
            || self.is_forced(&place)
            || has_head(path, own).map_err(OutputError::io(path, "cannot read"))?;
        if !is_own {
            let name = path.display();
            return refuse(format!(
                "exists and is no {}; name another file, remove it, or let it be replaced with --force={name}",
                own.name()
            ));
        }
        Ok(Found::File(place, old))
    }

    /// Tells whether the user named this file, or its folder.
    fn is_forced(&self, place: &Path) -> bool {
        let mut named = (self.forced.iter()).filter_map(|named| fs::canonicalize(named).ok());
        named.any(|named| named == place || place.parent() == Some(&named))
    }
}

/// Writes a file beside its place and renames it, with mode and owner of the `old` one.
fn put(place: &Path, old: Option<&Metadata>, text: &str) -> io::Result<()> {
    let folder = match place.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    // The permissions of any new file; the mask of the process applies on top.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut file = builder.tempfile_in(folder)?;
    file.write_all(text.as_bytes())?;
    if let Some(old) = old {
        #[cfg(unix)]
        {
            use std::os::unix::fs::{MetadataExt as _, fchown};
            // Keeps the owner of another user's file if the system permits it; otherwise the process becomes its owner.
            let _ = fchown(file.as_file(), Some(old.uid()), Some(old.gid()));
        }
        file.as_file().set_permissions(old.permissions())?;
    }
    file.persist(place).map_err(|error| error.error)?;
    Ok(())
}

/// Tells whether the beginning of a file shows that softarm wrote it.
fn has_head(path: &Path, own: Own) -> io::Result<bool> {
    if own == Own::Nothing {
        return Ok(false);
    }
    let mut head = Vec::new();
    // The data of an earlier page may follow its style sheet.
    let most = if own == Own::Page { LARGEST_PAGE } else { HEAD };
    File::open(path)?.take(most).read_to_end(&mut head)?;
    Ok(own.has_head(&String::from_utf8_lossy(&head)))
}

/// Tells whether a file has several names, or is only known by an open descriptor: renaming would separate them.
fn is_shared(place: &Path, path: &Path, old: &Metadata) -> bool {
    let by_descriptor = ["/dev", "/proc"].iter().any(|root| path.starts_with(root));
    #[cfg(unix)]
    let has_names = std::os::unix::fs::MetadataExt::nlink(old) > 1;
    #[cfg(not(unix))]
    let has_names = {
        let _ = old;
        false
    };
    has_names || (by_descriptor && place != path)
}

/// Returns the path at which a chain of links without a target would create its file.
fn end_of_links(path: &Path) -> Result<PathBuf, OutputError> {
    let mut place = path.to_path_buf();
    for _ in 0..MOST_LINKS {
        match fs::read_link(&place) {
            Ok(next) => place = place.parent().unwrap_or(Path::new("")).join(next),
            Err(_) => return Ok(place),
        }
    }
    Err(OutputError::refused(path, "links that lead to each other"))
}

#[cfg(unix)]
fn is_stream(kind: FileType) -> bool {
    use std::os::unix::fs::FileTypeExt as _;
    kind.is_char_device() || kind.is_fifo()
}

#[cfg(not(unix))]
fn is_stream(_: FileType) -> bool {
    false
}

/// Opens a device or a pipe; a pipe without a reader is an error at once, instead of waiting for ever.
fn stream(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.write(true);
    // Held while the file is opened once more: only opening is not to wait, writing to a full pipe is.
    #[cfg(unix)]
    let _held = {
        use std::os::unix::fs::OpenOptionsExt as _;
        let at_once = rustix::fs::OFlags::NONBLOCK.bits().cast_signed();
        options.clone().custom_flags(at_once).open(path)?
    };
    options.open(path)
}
