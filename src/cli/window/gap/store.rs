//! Robot files with patches, kept beside each other.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use springtwin::gap::Patch;
use springtwin::gui::services::gap::PatchedRobot;
use springtwin::lab::patches;
use springtwin::recording;
use springtwin::robot::{REFERENCE, RobotSpec, without_last_patch};

use crate::cli::read_text;

/// The copy of the robot file that carries the accepted patches.
pub(super) struct Store {
    /// The file the program was started with; the reference robot without one.
    original: Option<PathBuf>,
    /// The copy.
    pub(super) path: PathBuf,
}

impl Store {
    pub(super) fn new(robot_file: Option<&Path>, data: &Path) -> Self {
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
            path: std::path::absolute(&path).unwrap_or(path),
        }
    }

    fn original_text(&self) -> Result<String> {
        match &self.original {
            Some(file) => read_text(file),
            None => Ok(REFERENCE.to_owned()),
        }
    }

    /// The text of the copy; of the original where there is no copy yet.
    fn text(&self) -> Result<String> {
        let original = self.original_text()?;
        if !self.path.exists() {
            return Ok(original);
        }
        let text = read_text(&self.path)?;
        let base = |text: &str| -> Result<String> { Ok(RobotSpec::from_toml(text)?.base_hash) };
        anyhow::ensure!(
            base(&text)? == base(&original)?,
            "{} was made from another robot file: move it away, and patches can be accepted again",
            self.path.display()
        );
        Ok(text)
    }

    pub(super) fn robot(&self, text: &str) -> Result<PatchedRobot> {
        Ok(PatchedRobot {
            path: self.path.clone(),
            robot: RobotSpec::from_toml(text)?,
        })
    }

    pub(super) fn read(&self) -> Result<PatchedRobot> {
        self.robot(&self.text()?)
    }

    pub(super) fn accept(&self, patch: &Patch) -> Result<PatchedRobot> {
        let text = self.text()?;
        let (new, robot) = patches::text_with(&text, patch)?;
        // Two findings on the same robot would correct the rig twice.
        let now = RobotSpec::from_toml(&text)?.patches.len();
        anyhow::ensure!(
            RobotSpec::from_toml(&text)?.hash == patch.robot,
            "{} carries {now} patch(es) that this finding does not know: take them back, or start with \
             that file and look again",
            self.path.display()
        );
        if let Some(folder) = self.path.parent() {
            std::fs::create_dir_all(folder)
                .with_context(|| format!("cannot create the folder {}", folder.display()))?;
        }
        recording::write_text(&self.path, &new)?;
        Ok(PatchedRobot {
            path: self.path.clone(),
            robot,
        })
    }

    pub(super) fn undo(&self) -> Result<PatchedRobot> {
        let text = self.text()?;
        let old = without_last_patch(&text)?;
        recording::write_text(&self.path, old)?;
        self.robot(old)
    }
}
