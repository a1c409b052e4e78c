//! Files that are written whole or not at all.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use super::RecordingError;

/// Writes a text file that is whole or not there.
///
/// # Errors
/// [`RecordingError::Io`] when it cannot be written.
pub fn write_text(path: &Path, text: &str) -> Result<(), RecordingError> {
    write_bytes(path, text.as_bytes())
}

/// Writes a small file that is whole or not there.
///
/// # Errors
/// [`RecordingError::Io`] when it cannot be written.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), RecordingError> {
    write_whole(path, |w| w.write_all(bytes))
}

/// Writes beside the target and renames, so that a reader never sees half a file.
pub(crate) fn write_whole(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
) -> Result<(), RecordingError> {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    // Another program may write to the same place at the same time.
    name.push(format!(".{}.part", std::process::id()));
    let part: PathBuf = path.with_file_name(name);
    let result = File::create(&part)
        .and_then(|file| {
            let mut w = BufWriter::new(file);
            write(&mut w)?;
            w.into_inner()?.sync_all()
        })
        .and_then(|()| std::fs::rename(&part, path));
    result.map_err(|source| {
        // The error that matters is the first one.
        let _ = std::fs::remove_file(&part);
        RecordingError::Io {
            path: path.to_owned(),
            doing: "write",
            source,
        }
    })
}
