//! Work of the program around the window that drives the arm: it asks for one excitation after the other.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use crate::task::Programme;

/// An excitation that is asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct Wanted {
    /// The pressures to set.
    pub programme: Programme,
    /// Why: one sentence.
    pub why: String,
    /// Where to record it.
    pub record: PathBuf,
}

/// The window's end.
pub struct Conducted {
    /// What is to be driven next.
    pub wanted: Receiver<Wanted>,
    /// Takes whether it was driven and recorded, or why not.
    pub driven: SyncSender<Result<(), String>>,
    /// Where the first excitation will be recorded.
    pub first: PathBuf,
}

impl Conducted {
    /// One whose other end is gone.
    pub fn by_nobody() -> Self {
        let ((_, wanted), (driven, _)) = (sync_channel(1), sync_channel(1));
        Self {
            wanted,
            driven,
            first: PathBuf::new(),
        }
    }
}
