//! Whether the pumps do what the mode states.

use crate::signal::{BOARDS, CHAMBERS, Stamp};

/// Pumps that run against the mode, or do not run, for so long lead to SAFE, s.
pub(super) const DIFFER_S: f64 = 0.1;
/// Boards get this long to begin venting, s.
pub(super) const VENT_BEGINS_S: f64 = 0.3;
/// Chambers count as vented when none shows more than this, Pa.
pub(super) const VENTED_PA: f64 = 2e3;
/// A chamber that moves so far away from 0 while the pumps are off still gets air, Pa.
pub(super) const STILL_FED_PA: f64 = 2e3;

/// What is known of the pumps.
#[derive(Clone, Debug, Default)]
pub(super) struct PumpWatch {
    /// Since when each board's pumps have differed from the mode.
    pub(super) differ_since: [Option<Stamp>; BOARDS],
    /// The smallest pressures (magnitudes) since the pumps went off, Pa, and the lengths of the bellows then, m.
    pub(super) least: [Option<(f64, f64)>; CHAMBERS],
    /// Whether the supply has been cut for what runs although it should not.
    pub(super) has_cut: bool,
    pub(super) vent_at: Option<Stamp>,
    pub(super) is_venting: bool,
}

impl PumpWatch {
    /// What pressures do from now on has nothing to do with what they were.
    pub(super) fn forget(&mut self) {
        self.least = [None; CHAMBERS];
    }
}
