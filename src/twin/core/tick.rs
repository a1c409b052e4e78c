//! One tick: from raw frames to a pressure command.

use super::state::{Phase, STOOD_STILL_S, Twin};
use super::watch::{REMEDY_BUSY, busy_for};
use crate::control::{Maps as ControlMaps, StepInput};
use crate::learn::estimate;
use crate::signal::{Gripper, PressureCommand, RawFrame, Stamp};
use crate::task::{Happening, Target};
use crate::twin::command::{Command, Event};
use crate::twin::maps::Reading;

/// In an excitation, a set pressure is at most so far from the gauge, Pa: pumps are at work in full by then, and a chamber that does
/// not follow shows.
const AHEAD_PA: f64 = 4e3;

impl Twin {
    /// One step: takes what arrived (`raw`: `None` if no frame did), answers with a command for the boards (`None`: no set
    /// pressures) and events.
    pub fn tick(
        &mut self,
        now: Stamp,
        raw: Option<RawFrame>,
        commands: &[Command],
    ) -> (Option<PressureCommand>, Vec<Event>) {
        let stood_still_s = now.since(self.now);
        self.now = now;
        self.delays.tick(now, self.link.host_delay);
        let mut events = Vec::new();
        if let Some(raw) = raw {
            self.absorb(raw);
        }
        if let Some(text) = self.arming.to_report.take() {
            let stamp = now;
            events.push(Event::Warning { stamp, text });
        }
        let is_on = matches!(self.phase, Phase::Hold | Phase::Moving { .. });
        self.watch(&mut events);
        if is_on && stood_still_s > STOOD_STILL_S {
            let reason = format!(
                "{}, so the control loop stood still",
                busy_for(stood_still_s)
            );
            self.go_safe_for(&reason, REMEDY_BUSY, &mut events);
        }
        for command in commands {
            self.handle(command, &mut events);
        }
        self.judge_again();
        self.go_on_checking(&mut events);
        let out = self.steer(&mut events);
        (out, events)
    }

    /// Calibrates a frame and estimates the pose. A frame that makes no sense is dropped; the last
    /// good one is held.
    pub fn absorb(&mut self, raw: RawFrame) {
        let (frame, eval) = match self.maps.read(&mut self.sensing, &raw) {
            Reading::Whole(frame, eval) => (*frame, *eval),
            Reading::Silent => {
                self.raw = Some(raw);
                return;
            }
            Reading::Bad => {
                self.bad_frames += 1;
                return;
            }
        };
        self.bad_frames = 0;
        self.last_frame = Some(self.now);
        self.lateness_s
            .push_back((self.now, self.now.since(frame.stamp)));
        self.estimate = Some(estimate(frame.stamp, &eval));
        self.eval = Some(eval);
        self.blind_frames = if frame.is_blind() {
            self.blind_frames + 1
        } else {
            0
        };
        self.short = match &self.command {
            Some(command) => self.air.update(
                &self.robot,
                frame.stamp,
                &frame.chamber_pa,
                command.chamber_pa(),
                &self.sensing.pads(),
            ),
            // The pumps are off.
            None => {
                self.air.reset();
                None
            }
        };
        self.sensors = Some(frame);
        self.raw = Some(raw);
    }

    pub(super) fn enter(&mut self, phase: Phase, events: &mut Vec<Event>) {
        if matches!(self.phase, Phase::Disarmed)
            && matches!(phase, Phase::Hold | Phase::Moving { .. })
        {
            self.gripper = None;
        }
        self.phase = phase;
        self.contact.begin();
        self.sensor_ref = None;
        events.push(Event::Mode {
            stamp: self.now,
            mode: self.mode(),
        });
    }

    /// The command of this tick, if the phase has one.
    fn steer(&mut self, events: &mut Vec<Event>) -> Option<PressureCommand> {
        let carried_kg = self.model.carried_kg(self.payload_kg);
        let sensors = self.sensors.as_ref()?;
        let mut stall = None;
        self.solve_s = None;
        let wanted_pa = match &mut self.phase {
            Phase::Disarmed | Phase::Safe(_) => {
                self.command = None;
                return None;
            }
            Phase::Hold => {
                let held_pa = self.held_pa.unwrap_or(sensors.chamber_pa);
                let offset_pa = self.arming.offset_pa();
                std::array::from_fn(|i| held_pa[i] + offset_pa[i])
            }
            Phase::Moving { routine, steps } => {
                let (estimate, eval) = (self.estimate.as_ref()?, self.eval.as_ref()?);
                *steps += 1;
                for happening in routine.update(self.now, estimate) {
                    match happening {
                        Happening::Arrived(arrival) => {
                            events.push(Event::Reached {
                                stamp: self.now,
                                distance_m: arrival.distance_m,
                                steps: *steps,
                            });
                            *steps = 0;
                        }
                        Happening::Gripped(gripper, payload_kg) => {
                            self.before_grip_kg = match gripper {
                                Gripper::Closed => Some(self.payload_kg),
                                Gripper::Open => None,
                            };
                            self.gripper = Some(gripper);
                            self.payload_kg = payload_kg;
                            let what = match gripper {
                                Gripper::Closed => "closes on",
                                Gripper::Open => "opens; left in it:",
                            };
                            events.push(Event::Notice {
                                stamp: self.now,
                                text: format!("The gripper {what} {:.0} g.", payload_kg * 1e3),
                            });
                        }
                        Happening::Finished => events.push(Event::Finished {
                            stamp: self.now,
                            name: routine.plan().name.clone(),
                        }),
                    }
                }
                let mut excited_pa = None;
                match routine.target() {
                    Some(Target::Pressures(set_pa)) => excited_pa = Some(set_pa),
                    Some(Target::Goal(goal, reach)) => {
                        // A path that has ended is settled from where it led.
                        if reach.is_none() {
                            self.controller.lead(goal.clone(), None);
                        } else if self.controller.goal() != Some(goal) {
                            self.controller.set_goal(goal.clone(), reach);
                        }
                    }
                    Some(Target::Along(goal, via)) => self.controller.lead(goal, Some(via)),
                    None => self.controller.hold(),
                }
                if let Some(set_pa) = excited_pa {
                    self.sensor_ref = None;
                    std::array::from_fn(|i| {
                        let pa = sensors.chamber_pa[i];
                        set_pa[i].clamp(pa - AHEAD_PA, pa + AHEAD_PA)
                    })
                } else {
                    let maps = ControlMaps {
                        pose: self.maps.pose.as_ref(),
                        plant: self.maps.plant.as_ref(),
                        samples: &self.maps.seeds,
                    };
                    let unsolved = self.controller.unsolved_ticks();
                    let out = self.controller.step(
                        maps,
                        &StepInput {
                            frame: sensors,
                            eval,
                            payload_kg: carried_kg,
                            previous: self.command.as_ref(),
                            stamp: self.now,
                        },
                    );
                    if self.controller.unsolved_ticks() > unsolved {
                        self.unsolved_at = Some(self.now);
                    }
                    self.sensor_ref = out.sensor_ref;
                    self.solve_s = out.solve_s;
                    stall = out.stall;
                    out.wanted_pa
                }
            }
        };
        let command = PressureCommand::limited(
            self.now,
            wanted_pa,
            self.gripper,
            self.command.as_ref(),
            &sensors.chamber_pa,
            &self.robot.pressure,
        );
        self.command = Some(command.clone());
        if let Some(stall) = stall {
            let (chamber, pa) = stall.chamber;
            self.refuse(
                format!(
                    "The tip does not come nearer than {:.0} mm: chamber {chamber} is at {:+.0} kPa. Holding.",
                    stall.distance_m * 1e3,
                    pa * 1e-3
                ),
                events,
            );
            let pressed_from_pa = self.pressed_from();
            self.hold(events);
            if pressed_from_pa.is_some() {
                self.held_pa = pressed_from_pa;
                let text = "Something may be in its way: the pressures went back to where it last came nearer.";
                self.refuse(text, events);
            }
        }
        Some(command)
    }
}
