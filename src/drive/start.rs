//! What is checked before anything is asked of a rig.

use anyhow::Result;

use crate::signal::{LinkStatus, Mode, Snapshot};
use crate::twin::{Command, SETTLING_FRAMES};

/// Time the boards have to introduce themselves, s.
pub const HELLO_S: f64 = 5.0;

/// The check whether a rig is ready to be steered.
pub struct Start {
    /// Whether boards that are SAFE from before may leave it.
    reset: bool,
    tried: bool,
}

impl Start {
    /// `reset` if boards that are SAFE from before may leave it.
    pub fn new(reset: bool) -> Self {
        Self {
            reset,
            tried: false,
        }
    }

    /// Whether something can be asked of the rig now; may add a reset to the commands.
    ///
    /// # Errors
    /// Why the rig cannot become ready.
    pub fn ready(
        &mut self,
        snapshot: &Snapshot,
        commands: &mut Vec<Command>,
    ) -> std::result::Result<bool, String> {
        if let Mode::Safe(reason) = &snapshot.mode {
            if !self.reset {
                return Err(format!(
                    "SAFE from before ({reason}): remove the cause, then start again with --reset"
                ));
            }
            if self.tried {
                return Err(format!(
                    "still SAFE after a reset ({reason}): remove the cause"
                ));
            }
            self.tried = true;
            commands.push(Command::Reset);
            return Ok(false);
        }
        Ok(snapshot.link.connected && snapshot.link.frames > SETTLING_FRAMES)
    }
}

/// Refuses a link on which no data came.
///
/// # Errors
/// Why nothing came, and what to look at.
pub fn check_link(link: &LinkStatus, rig: &str) -> Result<()> {
    if let Some(refusal) = &link.refusal {
        anyhow::bail!("{refusal}");
    }
    anyhow::ensure!(
        link.connected || link.frames > 0,
        "no data from the boards on {rig} within {HELLO_S} s: check the cable, the boards' power and the firmware"
    );
    Ok(())
}
