//! Arming and holding: what must be so before hardware moves, and what only ever holds the arm.

use super::arming::{Arming, RESUME_OFF_S};
use super::state::{BLIND_FRAMES, Phase, STALE_WARN_S, Twin};
use crate::link::wire::fault;
use crate::signal::{ArmingCheck, ENOUGH_SENSORS, RawFrame, TOO_FEW_SENSORS};
use crate::twin::command::Event;

impl Twin {
    /// Lets hardware be armed although only the virtual rig's calibration is in use: the operator's explicit word.
    pub fn accept_virtual_calibration(&mut self) {
        self.arming.is_accepted = true;
    }

    /// Sets the reason why the robot's active calibration could not be used: a warning now, and part of the message that
    /// refuses to arm. One clause.
    pub fn explain_calibration(&mut self, why: String) {
        self.arming.to_report = Some(format!(
            "Calibration: {why}. Save a new one, or choose one on the Calibrate screen."
        ));
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

    /// Lets simulated boards at a serial port be armed: the operator's explicit word.
    pub fn accept_simulated_boards(&mut self) {
        self.arming.accepts_simulated = true;
    }

    /// Why boards at a serial port may not be armed by what they are.
    fn boards_refusal(&self) -> Option<String> {
        let simulated = self.link.board_simulated;
        let text = match simulated {
            _ if self.link.practice => return None,
            [Some(a), Some(b)] if a != b => {
                "One board is simulated and the other is not: connect the two boards of one arm.".to_owned()
            }
            _ if simulated.contains(&Some(true)) && !self.arming.accepts_simulated => {
                "The boards at this port are simulated: start with --accept-simulated-boards if that is meant.".to_owned()
            }
            _ => match (self.link.rig, self.arming.rig) {
                ([Some(a), Some(b)], _) if a != b => format!(
                    "The boards belong to two arms (numbers {a} and {b}): connect the two boards of one arm."
                ),
                ([Some(is), None] | [None, Some(is)], _) => format!(
                    "One board is of arm {is} and the other has no number: connect the two boards of one arm, or \
                     write the number to its EEPROM."
                ),
                ([Some(is), _], Some(wanted)) if is != wanted => format!(
                    "This is arm {is}, but the calibration is of arm {wanted}: choose the calibration of this arm."
                ),
                _ => return None,
            },
        };
        Some(text)
    }

    /// Allows motion. Pressures and gripper stay as the boards report them.
    pub(super) fn arm(&mut self, events: &mut Vec<Event>) {
        match self.not_ready() {
            Some(reason) => self.refuse(reason, events),
            None => {
                if matches!(self.phase, Phase::Disarmed) {
                    self.arming.is_checked = false;
                    self.hold(events);
                }
                if self.is_check_due() {
                    self.check_gauges();
                }
            }
        }
    }

    /// Holds what moves, and nothing else: it neither arms nor resumes, however often it is asked for.
    pub(super) fn hold_only(&mut self, events: &mut Vec<Event>) {
        self.arming.held_at = Some(self.now);
        let checked = self.check.take().is_some();
        if self.arming.give_up() {
            self.refuse(
                "Held: the gauges were not checked to the end. Press Arm to check them again.",
                events,
            );
        }
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

    /// Why nothing may set out yet: it was held a moment ago.
    pub(super) fn just_held(&self) -> Option<String> {
        let ago_s = self.now.since(self.arming.held_at?);
        (ago_s < RESUME_OFF_S).then(|| {
            format!("Held {ago_s:.1} s ago: Go and RESUME work {RESUME_OFF_S:.0} s after HOLD.")
        })
    }

    /// The same for hardware that a person may stand beside.
    pub(super) fn held_on_hardware(&self) -> Option<String> {
        self.just_held().filter(|_| !self.link.practice)
    }

    /// Whether the gauges of an armed hardware arm have to be checked before it moves.
    fn is_check_due(&self) -> bool {
        let holds = matches!(self.phase, Phase::Hold) && !self.link.practice;
        holds && !self.arming.is_checked && !self.arming.is_checking()
    }

    /// The check of the gauges as the operator sees it.
    pub(super) fn gauge_check(&self) -> ArmingCheck {
        match &self.arming.check {
            Some(check) => ArmingCheck::Chamber(check.chamber),
            None if self.is_check_due() => ArmingCheck::Due,
            None => ArmingCheck::NotNeeded,
        }
    }

    /// Why motion is not allowed now.
    pub(super) fn not_ready(&self) -> Option<String> {
        if let Phase::Safe(reason) = &self.phase {
            return Some(format!(
                "SAFE ({reason}): remove the cause, then press Reset."
            ));
        }
        if let Some(refusal) = &self.link.refusal {
            return Some(refusal.clone());
        }
        if self
            .raw
            .as_ref()
            .is_some_and(|r| r.faults & fault::SAFE != 0)
        {
            return Some("The boards have not left SAFE yet: wait a moment.".to_owned());
        }
        if self.link.venting {
            return Some("Venting: wait until the chambers are at 0 kPa.".to_owned());
        }
        if let Some(reason) = self.boards_refusal().or_else(|| self.calibration_refusal()) {
            return Some(reason);
        }
        match self.last_frame {
            None => Some("No data from the boards yet: connect a rig first.".to_owned()),
            Some(t) if self.now.since(t) > STALE_WARN_S => {
                Some("The data from the boards are too old to move on.".to_owned())
            }
            Some(_) if self.blind_frames > BLIND_FRAMES && !self.clocks_are_known() => {
                Some("The clocks of the boards are still being measured: wait a moment.".to_owned())
            }
            Some(_) if self.blind_frames > BLIND_FRAMES => {
                Some(format!("There are {TOO_FEW_SENSORS}: {ENOUGH_SENSORS}."))
            }
            Some(_) => self.over_pressures().next().map(|(chamber, pa)| {
                format!(
                    "Over-pressure in chamber {} ({:+.1} kPa): let its air out first.",
                    chamber + 1,
                    pa * 1e-3
                )
            }),
        }
    }

    /// Whether the rates of the clocks that count the springs' gates are known.
    pub(super) fn clocks_are_known(&self) -> bool {
        self.raw.as_ref().is_some_and(RawFrame::clocks_are_known)
    }

    /// Why nothing may set out now.
    pub(super) fn not_allowed(&self) -> Option<String> {
        self.not_ready().or_else(|| {
            if matches!(self.phase, Phase::Disarmed) && !self.link.practice {
                return Some("Disarmed: arm the rig first.".to_owned());
            }
            let due = "The gauges are not checked: press Arm first.";
            self.is_check_due().then(|| due.to_owned())
        })
    }

    pub(super) fn hold(&mut self, events: &mut Vec<Event>) {
        let last = self.command.as_ref().map(|c| *c.chamber_pa());
        self.held_pa = last.or_else(|| self.sensors.as_ref().map(|s| s.chamber_pa));
        self.check = None;
        if let Phase::Moving { routine, .. } = &self.phase {
            self.paused = Some(routine.clone());
        }
        self.enter(Phase::Hold, events);
    }
}
