//! The one rule by which single files are written: what softarm did not write is replaced only where the user names it.
//!
//! Links are followed to what they lead to, and stay links. A file that is replaced is there as a whole, old or new, at every moment, and keeps its
//! mode and its owner. A device or a pipe is written to and stays one; a disk, a socket and a directory are refused. A file that nobody may write
//! is refused too, although its folder would let it be replaced.

use std::fs::{self, File, FileType, Metadata, OpenOptions};
use std::io::{self, Read as _, Write as _};
use std::path::{Path, PathBuf};

use super::{OutputError, PAGE_MARK};

/// Bytes of a file at its beginning in which the mark of softarm is looked for, where it has one.
const HEAD: u64 = 1 << 16;
/// Bytes of a page that is looked at before it is replaced.
const LARGEST_PAGE: u64 = 1 << 30;
/// Links that follow one another, at most, as in Linux.
const MOST_LINKS: usize = 40;
/// First words of an exported table.
pub(super) const TABLE_HEAD: &str = "t_s,node,s,x_m,y_m,z_m,qw,qx,qy,qz\n";
/// A comment in the head of exported XML.
pub(super) const EXPORT_MARK: &str = "<!-- made by softarm export -->";

/// How a file that is there already is known to be one of softarm's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Own {
    /// By nothing: it is the user's.
    Nothing,
    /// A page of softarm.
    Page,
    /// A picture or a data file of `softarm export`.
    Export,
    /// Every file: the user named this one to be changed.
    Everything,
}

impl Own {
    /// Tells whether the beginning of a file is that of one of softarm's.
    fn has_head(self, head: &str) -> bool {
        match self {
            Self::Nothing => false,
            // Pages of earlier versions have no mark, but their data.
            Self::Page => head.contains(PAGE_MARK) || head.contains("<script id=\"data\""),
            Self::Export => head.starts_with(TABLE_HEAD) || head.contains(EXPORT_MARK),
            Self::Everything => true,
        }
    }

    /// What such a file is called.
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
    /// Files and folders of files that the user lets be replaced although softarm did not write them.
    forced: Vec<PathBuf>,
}

/// What stands at a path, links followed.
enum Found {
    /// Nothing; a file is to be made here.
    Nothing(PathBuf),
    /// A regular file, here.
    File(PathBuf, Metadata),
    /// A device or a pipe.
    Stream,
}

impl Writer {
    /// Lets the named files, and those in named folders, be replaced, whoever wrote them.
    #[must_use]
    pub fn forcing(files: &[PathBuf]) -> Self {
        Self {
            forced: files.to_vec(),
        }
    }

    /// Tells, before anything is computed, whether a file may be written.
    ///
    /// # Errors
    /// [`OutputError`] for a path that [`write`](Self::write) would refuse.
    pub fn permit(&self, path: &Path, own: Own) -> Result<(), OutputError> {
        self.found(path, own).map(|_| ())
    }

    /// Writes a text to a file.
    ///
    /// # Errors
    /// [`OutputError::Refused`] for a file that is not softarm's and not forced, for one that is read-only, and for what is neither a file nor a
    /// stream of bytes; [`OutputError::Unwritten`] where the system does not take it.
    pub fn write(&self, path: &Path, own: Own, text: &str) -> Result<(), OutputError> {
        let unwritten = || OutputError::unwritten(path, "cannot write");
        match self.found(path, own)? {
            Found::Nothing(place) => put(&place, None, text),
            Found::File(place, old) if is_shared(&place, path, &old) => {
                fs::write(&place, text) // in place, so that all of its names lead to it still
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
        // What /proc and /dev call a file need not be at that path.
        let place = fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
        if old.permissions().readonly() {
            return refuse("read-only; make it writable, or name another file".into());
        }
        // Whoever may change the folder may not therefore change the file.
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

    /// Tells whether the user named this file, or the folder that it is in.
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
    // Those of any new file: the mask of the process goes on top.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut file = builder.tempfile_in(folder)?;
    file.write_all(text.as_bytes())?;
    if let Some(old) = old {
        #[cfg(unix)]
        {
            use std::os::unix::fs::{MetadataExt as _, fchown};
            // Of somebody else's file in a folder of one's own; who may not give a file away becomes its owner.
            let _ = fchown(file.as_file(), Some(old.uid()), Some(old.gid()));
        }
        file.as_file().set_permissions(old.permissions())?;
    }
    file.persist(place).map_err(|error| error.error)?;
    Ok(())
}

/// Tells whether the beginning of a file shows that it is softarm's.
fn has_head(path: &Path, own: Own) -> io::Result<bool> {
    if own == Own::Nothing {
        return Ok(false);
    }
    let mut head = Vec::new();
    // The data of an earlier page may stand behind its style sheet.
    let most = if own == Own::Page { LARGEST_PAGE } else { HEAD };
    File::open(path)?.take(most).read_to_end(&mut head)?;
    Ok(own.has_head(&String::from_utf8_lossy(&head)))
}

/// Tells whether a file has several names, or is only known by an open descriptor: renaming would part them.
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

/// Where a chain of links that leads to nothing would have its file.
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

/// Opens a device or a pipe; a pipe that nobody reads is an error at once, where it would wait for ever.
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
