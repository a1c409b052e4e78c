//! Locks of files against other processes. A file system without locks (many cluster shares) is no reason to refuse
//! the work: that is warned of, and the work goes on.

use std::fs::{File, TryLockError};
use std::io;
use std::path::Path;

/// Waits until no other process holds the lock `path`, an empty file beside what it protects; it is held until the
/// result is dropped.
///
/// # Errors
/// When the file cannot be made.
pub fn wait_for_lock(path: &Path) -> io::Result<File> {
    // What is in it does not matter, and on Windows nobody else may write while it is locked.
    let file = File::options()
        .write(true)
        .create(true)
        .truncate(false)
        .open(path)?;
    if let Err(e) = file.lock() {
        warn(path, &e);
    }
    Ok(file)
}

/// Whether a file is this process's own after an attempt to lock it. Where there are no locks, it is taken as such.
pub(super) fn is_own(attempt: Result<(), TryLockError>, path: &Path) -> bool {
    match attempt {
        Ok(()) => true,
        Err(TryLockError::WouldBlock) => false,
        Err(TryLockError::Error(e)) => {
            warn(path, &e);
            true
        }
    }
}

fn warn(path: &Path, e: &io::Error) {
    log::warn!(
        "{} cannot be locked ({e}): its file system may have no locks; let no other program write there meanwhile",
        path.display()
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_system_without_locks_is_no_reason_to_refuse() {
        let path = Path::new("share/d.parquet.resume");
        assert!(is_own(Ok(()), path));
        assert!(!is_own(Err(TryLockError::WouldBlock), path));
        let without = io::Error::from(io::ErrorKind::Unsupported);
        assert!(is_own(Err(TryLockError::Error(without)), path));
    }

    #[test]
    fn a_lock_is_held_until_it_is_dropped() {
        let name = format!("springtwin-lock-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        let held = wait_for_lock(&path).expect("a lock");
        let other = File::options().write(true).open(&path).expect("opens");
        assert!(matches!(other.try_lock(), Err(TryLockError::WouldBlock)));
        drop(held);
        assert!(other.try_lock().is_ok());
        std::fs::remove_file(path).expect("removed");
    }
}
