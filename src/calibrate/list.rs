//! The list of versions in a folder, `versions.toml`: which there are, and which is in use. It is written last: a version that it does
//! not list does not exist.

use std::fs::File;
use std::path::Path;

use anyhow::{Context as _, Result};
use serde::{Deserialize, Serialize};

use crate::drive::read_toml;
use crate::recording::{wait_for_lock, write_text};
use crate::signal::toml_error;

/// Name of its file.
pub(super) const INDEX: &str = "versions.toml";
/// Format of the list that this program writes; a list without a number has format 1.
const FORMAT: u32 = 1;
/// Name of the empty file that is locked while the folder is changed.
const LOCK: &str = "lock";

/// The list of versions in the file.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VersionList {
    #[serde(default = "first_format")]
    format: u32,
    /// Number of the version in use; 0 before there is one.
    pub active: u32,
    /// All of them, oldest first.
    #[serde(default)]
    pub version: Vec<Entry>,
}

/// A version.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// Number, from 1.
    pub number: u32,
    /// When it was saved.
    pub date: String,
    /// What it is, one line.
    pub note: String,
}

fn first_format() -> u32 {
    1
}

impl Default for VersionList {
    fn default() -> Self {
        Self {
            format: FORMAT,
            active: 0,
            version: Vec::new(),
        }
    }
}

/// The part that a list of any format has.
#[derive(Deserialize)]
struct Head {
    #[serde(default = "first_format")]
    format: u32,
}

impl VersionList {
    /// The list in a folder; an empty one where there is none. `otherwise` is what one can do without it: it ends the sentence
    /// about a list of a newer program.
    ///
    /// # Errors
    /// When it cannot be read, is damaged, or was written by a newer program.
    pub fn read(folder: &Path, otherwise: &str) -> Result<Self> {
        let path = folder.join(INDEX);
        if !path.exists() {
            return Ok(Self::default());
        }
        let text = read_toml(&path)?;
        let damaged =
            |e| anyhow::anyhow!("{} is damaged: {}", path.display(), toml_error(&text, &e));
        let Head { format } = toml::from_str(&text).map_err(damaged)?;
        anyhow::ensure!(
            format <= FORMAT,
            "{} was written by a newer springtwin (format {format}, this one reads up to {FORMAT}): use that version, \
             or {otherwise}",
            path.display()
        );
        toml::from_str(&text).map_err(damaged)
    }

    /// Writes it into the folder.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        write_text(&folder.join(INDEX), &toml::to_string(self)?)?;
        Ok(())
    }

    /// Adds a version and makes it the one in use; its number.
    pub fn add(&mut self, date: &str, note: String) -> u32 {
        let number = self.next();
        self.active = number;
        self.version.push(Entry {
            number,
            date: date.to_owned(),
            note,
        });
        number
    }

    /// The number of the next version.
    pub fn next(&self) -> u32 {
        self.version.iter().map(|e| e.number).max().unwrap_or(0) + 1
    }
}

/// Locks a folder, which is made where it is not there, against changes by other processes until the result is dropped.
///
/// # Errors
/// When the folder or its lock cannot be made.
pub fn lock_folder(folder: &Path) -> Result<File> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let path = folder.join(LOCK);
    wait_for_lock(&path).with_context(|| format!("cannot lock {}", path.display()))
}
