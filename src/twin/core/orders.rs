//! The operator's commands.

use std::sync::Arc;

use super::state::{Check, Phase, Then, Twin};
use crate::control::Gains;
use crate::link::Order;
use crate::sensing::Calibration;
use crate::signal::Gripper;
use crate::twin::command::{Command, Event};

const NOTHING_TO_RESUME: &str = "There is nothing to resume: pick a target first.";

impl Twin {
    pub(super) fn refuse(&self, reason: impl Into<String>, events: &mut Vec<Event>) {
        events.push(Event::Refused {
            stamp: self.now,
            reason: reason.into(),
        });
    }

    pub(super) fn disarm(&mut self, events: &mut Vec<Event>) {
        self.enter(Phase::Disarmed, events);
        self.command = None;
        self.check = None;
        self.paused = None;
    }

    pub(super) fn handle(&mut self, command: &Command, events: &mut Vec<Event>) {
        match command {
            Command::Stop => {
                self.stopped_at = Some(self.now);
                // Boards that vent in SAFE are stopped, too.
                if self.is_safe() {
                    self.orders.push(Order::Stop);
                }
                self.go_safe("stopped by the operator", events);
            }
            Command::Reset if self.stopped_at == Some(self.now) => {
                self.refuse(
                    "STOP was pressed at the same time: press Reset again.",
                    events,
                );
            }
            Command::Reset if self.link.stop_open => self.refuse(
                "The emergency stop is pressed: release it, then press Reset.",
                events,
            ),
            Command::Reset => {
                if self.is_safe() {
                    self.reset(events);
                }
            }
            Command::Vent => self.vent(events),
            Command::Disarm => {
                if !self.is_safe() {
                    self.disarm(events);
                }
            }
            Command::Arm => self.arm(events),
            Command::Hold => self.hold_only(events),
            Command::Resume => {
                let paused = self.paused.as_ref().map(|r| r.stops_ahead());
                match (&self.phase, paused) {
                    (Phase::Hold, Some(stops)) => match self.just_held().or(self.not_ready()) {
                        Some(reason) => self.refuse(reason, events),
                        None => {
                            self.check = Some(Check {
                                stops,
                                reaches: Vec::new(),
                                then: Then::Resume,
                            });
                        }
                    },
                    _ => self.refuse(NOTHING_TO_RESUME, events),
                }
            }
            Command::Preview(goal) => self.preview(goal, events),
            Command::CancelPreview => self.preview = None,
            Command::Go => self.go(events),
            Command::Goto(goal) => {
                self.preview(goal, events);
                if self.preview.is_some() {
                    self.go(events);
                }
            }
            Command::Start(plan) => self.start(plan, events),
            Command::Steer(kind) => self.controller.choose(Gains::of(*kind)),
            Command::DeclarePayload(kg) => {
                if (0.0..=self.robot.payload_max_kg).contains(kg) {
                    let is_another = self.payload_kg != *kg;
                    self.payload_kg = *kg;
                    if is_another
                        && self
                            .check
                            .take_if(|c| !matches!(c.then, Then::GoOn))
                            .is_some()
                    {
                        self.refuse(
                            "The load has changed while a motion was being checked for another: start it again.",
                            events,
                        );
                    }
                    // Another load, another verdict.
                    if let Some((goal, _)) = self.preview.clone() {
                        self.preview(&goal, events);
                    }
                } else {
                    self.refuse(
                        format!(
                            "A payload of {kg} kg is outside of 0 to {} kg: nothing was changed.",
                            self.robot.payload_max_kg
                        ),
                        events,
                    );
                }
            }
            // What is asked for is done now, not at the next arming.
            Command::Grip(_) if matches!(self.phase, Phase::Disarmed | Phase::Safe(_)) => {
                self.refuse("Not armed: the gripper stays as it is.", events);
            }
            Command::Grip(Gripper::Open)
                if self.payload_kg > 0.0 && matches!(self.phase, Phase::Moving { .. }) =>
            {
                self.refuse(
                    "The arm moves with a load: hold it first, then open the gripper.",
                    events,
                );
            }
            Command::Grip(gripper) => {
                self.gripper = Some(*gripper);
                if *gripper == Gripper::Open
                    && let Some(kg) = self.before_grip_kg.take()
                {
                    self.payload_kg = kg;
                }
            }
            Command::Calibrate(calibration) => self.calibrate(calibration, events),
            // Pictures, files and viewers belong to whoever runs the twin.
            Command::Show(_)
            | Command::Mute { .. }
            | Command::Unmute(_)
            | Command::TryPatch { .. }
            | Command::DropPatch
            | Command::KeepPatch
            | Command::RevertPatch
            | Command::StartRecording(_)
            | Command::StopRecording
            | Command::Mark(_)
            | Command::Note(_)
            | Command::StreamLive(_)
            | Command::StopStream => {}
        }
    }

    /// Reads the sensors by another calibration; the filters settle within a second.
    fn calibrate(&mut self, calibration: &Arc<Calibration>, events: &mut Vec<Event>) {
        if matches!(self.phase, Phase::Moving { .. }) || self.check.is_some() {
            return self.refuse(
                "The arm moves: hold it first, a calibration is changed at rest.",
                events,
            );
        }
        self.sensing = self.maps.sensing(&self.robot, calibration);
        self.arming.note(calibration);
        if matches!(self.phase, Phase::Hold) && !self.link.practice {
            events.push(Event::Notice {
                stamp: self.now,
                text: "Another calibration: press Arm, so that its first motion is checked."
                    .to_owned(),
            });
        }
        events.push(Event::Calibrated {
            stamp: self.now,
            calibration: Arc::clone(calibration),
        });
    }
}
