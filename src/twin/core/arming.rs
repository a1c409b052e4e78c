//! Arming and holding: what must be so before hardware moves, and what only ever holds the arm.

use super::{Phase, Twin};
use crate::sensing::Calibration;
use crate::signal::Stamp;
use crate::twin::Event;

/// RESUME does nothing for so long after HOLD, s: a second press in a hurry restarts nothing.
pub const RESUME_OFF_S: f64 = 1.0;

/// What arming and resuming depend on besides the link.
pub(super) struct Arming {
    /// When the operator last pressed HOLD.
    held_at: Option<Stamp>,
    /// Whether the sensors are read by the virtual rig's calibration.
    calibration_is_virtual: bool,
    /// Whether hardware may move on it nevertheless.
    is_accepted: bool,
    /// Why no calibration of the robot could be used, if that is known.
    trouble: Option<String>,
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

impl Twin {
    /// Lets hardware be armed although only the virtual rig's calibration is in use: the operator's explicit word.
    pub fn accept_virtual_calibration(&mut self) {
        self.arming.is_accepted = true;
    }

    /// Says why no calibration of the robot could be used, for the message that refuses to arm. One sentence.
    pub fn explain_calibration(&mut self, why: String) {
        self.arming.trouble = Some(why);
    }

    /// Why hardware may not be armed with the calibration in use.
    pub(super) fn calibration_refusal(&self) -> Option<String> {
        let Arming {
            calibration_is_virtual,
            is_accepted,
            trouble,
            ..
        } = &self.arming;
        if self.link.simulated || *is_accepted || !calibration_is_virtual {
            return None;
        }
        let cause = trouble
            .as_ref()
            .map_or(String::new(), |why| format!(" ({why})"));
        Some(format!(
            "The virtual rig's calibration is in use, not one of this robot{cause}: calibrate it on the Calibrate \
             screen, or start with --calibration F.toml."
        ))
    }

    /// Allows motion. Pressures and gripper stay as the boards report them.
    pub(super) fn arm(&mut self, events: &mut Vec<Event>) {
        match self.not_ready() {
            Some(reason) => self.refuse(reason, events),
            None => self.hold(events),
        }
    }

    /// Holds what moves, and nothing else: it neither arms nor resumes, however often it is asked for.
    pub(super) fn hold_only(&mut self, events: &mut Vec<Event>) {
        self.arming.held_at = Some(self.now);
        let checked = self.check.take().is_some();
        match &self.phase {
            Phase::Moving { .. } => self.hold(events),
            Phase::Hold if checked => {
                self.refuse(
                    "Held: the motion that was being checked does not begin.",
                    events,
                );
            }
            Phase::Hold => {}
            Phase::Disarmed => self.refuse(
                "Disarmed: no pressure is commanded, there is nothing to hold.",
                events,
            ),
            Phase::Safe(_) => {
                self.refuse("SAFE: the pumps are off, there is nothing to hold.", events)
            }
        }
    }

    /// Why a plan on hold may not be resumed yet: it was held a moment ago.
    pub(super) fn just_held(&self) -> Option<String> {
        let ago_s = self.now.since(self.arming.held_at?);
        (ago_s < RESUME_OFF_S)
            .then(|| format!("Held {ago_s:.1} s ago: RESUME works {RESUME_OFF_S:.0} s after HOLD."))
    }

    /// Keeps the gripper as it is when the rig is armed: what the boards report is what they are commanded.
    pub(super) fn adopt_gripper(&mut self) {
        if let Some(gripper) = self.link.gripper {
            self.gripper = gripper;
        }
    }
}
