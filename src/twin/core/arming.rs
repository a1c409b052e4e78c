//! What arming and resuming depend on besides the link.

use crate::sensing::Calibration;
use crate::signal::Stamp;

/// RESUME does nothing for so long after HOLD, s: a second press in a hurry restarts nothing.
pub const RESUME_OFF_S: f64 = 1.0;

/// What arming and resuming depend on besides the link.
pub(super) struct Arming {
    /// When the operator last pressed HOLD.
    pub(super) held_at: Option<Stamp>,
    /// Whether the sensors are read by the virtual rig's calibration.
    pub(super) calibration_is_virtual: bool,
    /// Whether hardware may move on it nevertheless.
    pub(super) is_accepted: bool,
    /// Why no calibration of the robot could be used, if that is known.
    pub(super) trouble: Option<String>,
}

impl Arming {
    pub(super) fn new(calibration: &Calibration) -> Self {
        Self {
            held_at: None,
            calibration_is_virtual: calibration.is_of_virtual_rig(),
            is_accepted: false,
            trouble: None,
        }
    }

    /// Takes note of whose calibration the sensors are read by.
    pub(super) fn note(&mut self, calibration: &Calibration) {
        self.calibration_is_virtual = calibration.is_of_virtual_rig();
    }
}
