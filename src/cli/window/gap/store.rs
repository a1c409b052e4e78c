//! Robot files with patches, kept beside each other.

use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use springtwin::gap::{Edits, Patch};
use springtwin::gui::services::gap::PatchedRobot;
use springtwin::lab::patch_history::{PatchHistory, Put};
use springtwin::lab::patches;
use springtwin::recording::{self, RecordingError};
use springtwin::robot::{REFERENCE, RobotSpec};

use crate::cli::calibrate::now;
use crate::cli::read_toml;
use crate::cli::window::baselines::short;

/// The copy of the robot file that carries the accepted patches.
///
/// It lies beside the robot file. Where that folder cannot be written to (an installed robot file), it lies in the user's
/// data folder; one that is there goes before one beside the robot file.
pub(super) struct Store {
    /// The file the program was started with; the reference robot without one.
    original: Option<PathBuf>,
    /// The copy beside it.
    beside: PathBuf,
    /// The user's data folder.
    data: PathBuf,
    /// Writes a file.
    write: Put,
}

impl Store {
    pub(super) fn new(robot_file: Option<&Path>, data: &Path) -> Self {
        Self::with_writer(robot_file, data, recording::write_text)
    }

    pub(super) fn with_writer(robot_file: Option<&Path>, data: &Path, write: Put) -> Self {
        let path = match robot_file {
            None => data.join("reference.patched.toml"),
            Some(file) => {
                let name = file.file_name().unwrap_or_default().to_string_lossy();
                if name.ends_with(".patched.toml") {
                    file.to_owned()
                } else {
                    file.with_extension("patched.toml")
                }
            }
        };
        Self {
            original: robot_file.map(Path::to_owned),
            beside: std::path::absolute(&path).unwrap_or(path),
            data: data.to_owned(),
            write,
        }
    }

    fn original_text(&self) -> Result<String> {
        match &self.original {
            Some(file) => read_toml(file),
            None => Ok(REFERENCE.to_owned()),
        }
    }

    /// Where the copy lies when it cannot lie beside the robot file: its name has the hash of the robot without patches.
    fn in_data(&self) -> Result<PathBuf> {
        let hash = RobotSpec::from_toml(&self.original_text()?)?.base_hash;
        let name = self.beside.file_name().unwrap_or_default();
        let name = name.to_string_lossy();
        let stem = name.strip_suffix(".patched.toml").unwrap_or(&name);
        let file = format!("{stem}-{}.patched.toml", short(&hash));
        Ok(self.data.join("robots").join(file))
    }

    /// The copy in use; where there is none yet, the place beside the robot file.
    pub(super) fn path(&self) -> Result<PathBuf> {
        let in_data = self.in_data()?;
        Ok(match in_data.exists() {
            true => in_data,
            false => self.beside.clone(),
        })
    }

    /// The text of the copy; of the original where there is no copy yet.
    fn present(&self) -> Result<String> {
        let path = self.path()?;
        match path.exists() {
            true => read_toml(&path),
            false => self.original_text(),
        }
    }

    /// The same, of a copy that is of the original.
    fn text(&self) -> Result<String> {
        let (original, text) = (self.original_text()?, self.present()?);
        let base = |text: &str| -> Result<String> { Ok(RobotSpec::from_toml(text)?.base_hash) };
        anyhow::ensure!(
            base(&text)? == base(&original)?,
            "{} was made from another robot file: move it away, and patches can be accepted again",
            self.path()?.display()
        );
        Ok(text)
    }

    fn history(&self, path: &Path) -> PatchHistory {
        PatchHistory::with_writer(path, self.write)
    }

    pub(super) fn read(&self) -> Result<PatchedRobot> {
        let (path, text) = (self.path()?, self.text());
        let history = self.history(&path);
        let edited = history.edited(&self.present()?)?;
        // What was edited may be no robot file any more: what was written last is, and can be put back.
        let text = match (text, &edited) {
            (Err(e), Some(_)) => history.written()?.ok_or(e)?,
            (text, _) => text?,
        };
        Ok(PatchedRobot {
            robot: RobotSpec::from_toml(&text)?,
            history: history.records(&text)?,
            edited,
            path,
        })
    }

    pub(super) fn accept(&self, patch: &Patch) -> Result<PatchedRobot> {
        let _lock = self.lock();
        let text = self.text()?;
        let (new, _) = patches::text_with(&text, patch)?;
        // Two findings on the same robot would correct the rig twice.
        let before = RobotSpec::from_toml(&text)?;
        anyhow::ensure!(
            before.hash == patch.robot,
            "{} carries {} patch(es) that this finding does not know: take them back, or start with \
             that file and look again",
            self.path()?.display(),
            before.patches.len()
        );
        self.keep(&|history| history.replace(&text, &new, patch.name.clone(), &now()))?;
        self.read()
    }

    pub(super) fn undo(&self, edits: Edits) -> Result<PatchedRobot> {
        let _lock = self.lock();
        let text = self.present()?;
        self.keep(&|history| history.revert(&text, edits, &now()).map(|_| ()))?;
        self.read()
    }

    /// Locks the copies against other windows until the result is dropped. Without a lock it goes on: a folder that cannot
    /// be locked must not keep the robot from being patched.
    fn lock(&self) -> Option<File> {
        let path = self.data.join("robots").join("lock");
        let locked = std::fs::create_dir_all(self.data.join("robots"))
            .and_then(|()| File::create(&path))
            .and_then(|file| file.lock().map(|()| file));
        locked
            .inspect_err(|e| log::warn!("{}: cannot lock: {e}", path.display()))
            .ok()
    }

    /// Changes the copy, in the data folder where it cannot be written beside the robot file.
    fn keep(&self, change: &dyn Fn(&PatchHistory) -> Result<()>) -> Result<()> {
        let path = self.path()?;
        let Err(refused) = self.changed(&path, change) else {
            return Ok(());
        };
        let in_data = self.in_data()?;
        if path == in_data || self.original.is_none() || !is_read_only(&refused) {
            return Err(refused);
        }
        self.changed(&in_data, change)?;
        log::info!(
            "{refused:#} The patched robot file is {}",
            in_data.display()
        );
        Ok(())
    }

    fn changed(&self, path: &Path, change: &dyn Fn(&PatchHistory) -> Result<()>) -> Result<()> {
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder)
                .with_context(|| format!("cannot create the folder {}", folder.display()))?;
        }
        change(&self.history(path))
    }
}

/// Whether a file could not be written because it may not be.
fn is_read_only(e: &anyhow::Error) -> bool {
    let kind = match e.downcast_ref() {
        Some(RecordingError::Io { source, .. }) => Some(source.kind()),
        _ => e.downcast_ref::<std::io::Error>().map(std::io::Error::kind),
    };
    matches!(
        kind,
        Some(ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem)
    )
}
