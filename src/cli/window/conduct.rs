//! The end of work that drives the arm with the window: it asks, and waits for what was driven and recorded.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

use anyhow::{Context as _, Result};

use springtwin::gui::services::Worker;
use springtwin::gui::services::conduct::{Conducted, Wanted};

/// How often it is looked whether the work was cancelled.
const LOOK: Duration = Duration::from_millis(100);

/// The end of the work.
pub struct Ask {
    wants: SyncSender<Wanted>,
    answers: Receiver<Result<(), String>>,
}

impl Ask {
    /// Both ends, for work whose first recording is `first`.
    pub fn new(first: PathBuf) -> (Self, Conducted) {
        let (wants, wanted) = sync_channel(1);
        let (driven, answers) = sync_channel(1);
        let conducted = Conducted {
            wanted,
            driven,
            first,
        };
        (Self { wants, answers }, conducted)
    }

    /// Has an excitation driven and recorded; whether that was done, or the work was cancelled.
    ///
    /// # Errors
    /// Why it was not driven, or not recorded.
    pub fn drive<T>(
        &self,
        wanted: Wanted,
        worker: &Worker<T>,
        ctx: &egui::Context,
    ) -> Result<bool> {
        self.wants.send(wanted).context("the window has gone")?;
        ctx.request_repaint();
        loop {
            match self.answers.recv_timeout(LOOK) {
                Ok(Ok(())) => return Ok(true),
                Ok(Err(why)) => anyhow::bail!("{why}"),
                Err(RecvTimeoutError::Timeout) if !worker.cancelled() => {}
                Err(_) => return Ok(false),
            }
        }
    }
}

/// The first folder of a number that is not there yet.
pub fn free_folder(parent: &Path) -> PathBuf {
    let numbers = 1..=u32::MAX;
    let mut folders = numbers.map(|n| parent.join(n.to_string()));
    folders
        .find(|f| !f.exists())
        .unwrap_or_else(|| parent.to_owned())
}
