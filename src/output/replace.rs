//! A file that is there as a whole or not at all.

use std::io::Write as _;
use std::path::Path;

use super::OutputError;

/// Writes a file beside its place and renames it: nobody ever finds half of it, and what was there before stays if the disk is full.
///
/// # Errors
/// [`OutputError`] where it cannot be written.
pub fn replace(path: &Path, text: &str) -> Result<(), OutputError> {
    let unwritten = || OutputError::unwritten(path, "cannot write");
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    // Those of any new file: the mask of the process goes on top.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut file = builder.tempfile_in(folder).map_err(unwritten())?;
    file.write_all(text.as_bytes()).map_err(unwritten())?;
    file.persist(path)
        .map_err(|error| unwritten()(error.error))?;
    Ok(())
}
