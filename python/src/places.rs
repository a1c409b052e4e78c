//! Where functions write: a file that is there is replaced only when that was asked for.

use std::path::Path;

use anyhow::{Result, ensure};

/// Refuses a file that is there, unless it may be replaced, and a folder in its place.
///
/// # Errors
/// The message names the file and what to do.
pub fn free(path: &Path, overwrite: bool) -> Result<()> {
    ensure!(
        !path.is_dir(),
        "{} is a folder: give the name of a file",
        path.display()
    );
    ensure!(
        overwrite || !path.is_file(),
        "{} exists already: give another name, or overwrite=True to replace it",
        path.display()
    );
    Ok(())
}

/// The same for those of a folder's files that will be written; the folder need not exist.
///
/// # Errors
/// As [`free`].
pub fn all_free(folder: &Path, names: &[&str], overwrite: bool) -> Result<()> {
    ensure!(
        !folder.is_file(),
        "{} is a file: give the name of a folder",
        folder.display()
    );
    let mut names = names.iter();
    names.try_for_each(|name| free(&folder.join(name), overwrite))
}
