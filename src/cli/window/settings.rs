//! Where the window keeps its settings between two starts, such that several windows share them: each writes a file of
//! its own, which then takes the place of the shared one in a whole. The last one wins; half a file is never there.

use std::path::{Path, PathBuf};

use springtwin::recording::write_bytes;

/// Settings of one window. Its own file goes with it.
pub struct Settings {
    shared: PathBuf,
    own: PathBuf,
}

impl Settings {
    /// Begins with what is in the shared file in `folder`; `apart` is where this window's own file goes.
    pub fn begin(folder: &Path, apart: &Path) -> std::io::Result<Self> {
        std::fs::create_dir_all(folder)?;
        let shared = folder.join("app.ron");
        let own = apart.join(format!("springtwin-window-{}.ron", std::process::id()));
        match std::fs::read(&shared) {
            Ok(kept) => std::fs::write(&own, kept)?,
            // Of an earlier program with the same number.
            Err(_) if own.exists() => std::fs::remove_file(&own)?,
            Err(_) => {}
        }
        Ok(Self { shared, own })
    }

    /// This window's own file.
    pub fn own(&self) -> &Path {
        &self.own
    }

    /// Puts what this window has kept in the place of the shared file. Call while nothing is being written.
    pub fn publish(&self) {
        let kept = match std::fs::read(&self.own) {
            Ok(kept) if !kept.is_empty() => kept,
            _ => return,
        };
        if let Err(e) = write_bytes(&self.shared, &kept) {
            log::warn!("the window's settings are not kept: {e}");
        }
    }
}

impl Drop for Settings {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.own);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_begins_with_what_was_kept_and_replaces_it_in_a_whole() {
        let name = format!("springtwin-settings-{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        let (data, apart) = (folder.join("data"), folder.join("apart"));
        std::fs::create_dir_all(&apart).expect("a folder");
        let first = Settings::begin(&data, &apart).expect("begins");
        assert!(!first.own().exists());
        first.publish();
        assert!(!first.shared.exists(), "nothing was kept");
        std::fs::write(first.own(), "kept").expect("writes");
        // Whoever reads the shared file meanwhile reads all of it.
        let before = std::fs::File::create(&first.shared).expect("a file");
        std::io::Write::write_all(&mut &before, b"before").expect("writes");
        let mut reader = std::fs::File::open(&first.shared).expect("opens");
        first.publish();
        let mut read = String::new();
        std::io::Read::read_to_string(&mut reader, &mut read).expect("reads");
        assert_eq!(read, "before");
        let shared = first.shared.clone();
        drop(first);
        let second = Settings::begin(&data, &apart).expect("begins");
        assert_eq!(std::fs::read(second.own()).expect("is there"), b"kept");
        drop(second);
        assert_eq!(std::fs::read_dir(&apart).expect("a folder").count(), 0);
        assert_eq!(std::fs::read(shared).expect("is there"), b"kept");
        std::fs::remove_dir_all(folder).expect("cleans up");
    }
}
