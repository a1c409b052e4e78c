//! Work that drives the arm with the window: what it wants is shown, begins with the operator's consent, is recorded, and ends with
//! STOP and HOLD like everything else.

use egui::{Ui, vec2};

use super::operating::ends_recording;
use super::target::{Fire, HoldToGo, arm_simulated};
use super::widgets::{Gate, note};
use crate::gui::services::conduct::{Conducted, Wanted};
use crate::gui::view::View;
use crate::signal::{Mode, Snapshot};
use crate::task::{Plan, Programme};
use crate::twin::{Command, Event};

/// What work under way waits for.
enum Awaits {
    /// The work itself.
    Work,
    /// The operator, before this is driven.
    Consent(Wanted),
    /// The end of an excitation of this name, which has begun or not.
    End { name: String, has_begun: bool },
    /// The end of its recording.
    Recording,
}

/// How often the operator of hardware is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Consent {
    /// Before every excitation: what comes next depends on those before.
    Each,
    /// Before the first one: all of them are known.
    Once,
}

/// Work under way that drives the arm.
pub struct Conduct {
    link: Conducted,
    consent: Consent,
    awaits: Awaits,
    hold: HoldToGo,
    /// Whether the operator of hardware has agreed.
    agreed: bool,
    /// Whether the arm was held, stopped or disarmed after an excitation.
    held: bool,
    /// The excitations so far, with the reason for each.
    driven: Vec<String>,
    /// The newest of them.
    programme: Option<Programme>,
}

const PROCEED: Fire = Fire {
    now: "▶ Drive it",
    hold: "▶ Hold to drive it",
    hover: "Drives this excitation and records it; STOP and HOLD end it",
};

/// Why work ends that an operator ended at the arm.
const HELD: &str = "The arm was held.";

impl Conduct {
    /// Of work that has begun.
    pub fn new(link: Conducted, consent: Consent) -> Self {
        Self {
            link,
            consent,
            awaits: Awaits::Work,
            hold: HoldToGo::default(),
            agreed: false,
            held: false,
            driven: Vec::new(),
            programme: None,
        }
    }

    /// The excitation that is to be driven next, or is being driven; `None` between two of them.
    pub fn programme(&self) -> Option<&Programme> {
        let is_at_work = matches!(self.awaits, Awaits::Work | Awaits::Recording);
        self.programme.as_ref().filter(|_| !is_at_work)
    }

    /// Ends it: what moves for it is held.
    pub fn end(self, commands: &mut Vec<Command>) {
        if matches!(self.awaits, Awaits::End { .. } | Awaits::Recording) {
            commands.extend([Command::Hold, Command::StopRecording]);
        }
    }

    /// Answers the work.
    fn answer(&mut self, answer: Result<(), String>) {
        self.awaits = Awaits::Work;
        // It may have ended.
        let _ = self.link.driven.try_send(answer);
    }

    /// Takes what is wanted; on the virtual rig, or with consent, it begins by itself.
    pub fn poll(&mut self, view: &View<'_>, commands: &mut Vec<Command>) {
        if let (Awaits::Work, Ok(wanted)) = (&self.awaits, self.link.wanted.try_recv()) {
            if self.held {
                self.answer(Err(HELD.to_owned()));
                return;
            }
            self.driven.push(wanted.why.clone());
            self.programme = Some(wanted.programme.clone());
            self.awaits = Awaits::Consent(wanted);
            let is_agreed = self.consent == Consent::Once && self.agreed;
            if is_agreed || !view.snapshot.link.moves_hardware() {
                self.begin(view, commands);
            }
        }
    }

    fn begin(&mut self, view: &View<'_>, commands: &mut Vec<Command>) {
        if let Awaits::Consent(wanted) = std::mem::replace(&mut self.awaits, Awaits::Work) {
            arm_simulated(view, commands);
            commands.push(Command::StartRecording(wanted.record));
            commands.push(Command::Note(wanted.why));
            let name = wanted.programme.name.clone();
            commands.push(Command::Start(Plan::excite(wanted.programme)));
            self.awaits = Awaits::End {
                name,
                has_begun: false,
            };
        }
    }

    /// Follows the arm; gives what is to be ordered of the twin now.
    pub fn follow(&mut self, live: &Snapshot, events: &[Event]) -> Vec<Command> {
        let failed = events.iter().find_map(|e| match e {
            Event::RecordingFailed { reason, .. } => Some(format!("It was not recorded: {reason}")),
            _ => None,
        });
        let Awaits::End { name, has_begun } = &mut self.awaits else {
            // What was driven leaves the arm at its goal until somebody acts. Where each excitation needs consent, so does the next.
            let is_off = matches!(live.mode, Mode::Hold | Mode::Disarmed | Mode::Safe(_));
            let between = matches!(self.awaits, Awaits::Recording)
                || (matches!(self.awaits, Awaits::Work) && !self.driven.is_empty());
            self.held |= self.consent == Consent::Once && between && is_off;
            let is_closed = live.recording.is_none() && events.iter().any(ends_recording);
            if matches!(self.awaits, Awaits::Recording) && is_closed {
                self.answer(match (failed, self.held) {
                    (Some(why), _) => Err(why),
                    (None, true) => Err(HELD.to_owned()),
                    (None, false) => Ok(()),
                });
            }
            return Vec::new();
        };
        let finished = events
            .iter()
            .any(|e| matches!(e, Event::Finished { name: n, .. } if n == name));
        if finished {
            self.awaits = Awaits::Recording;
            return vec![Command::StopRecording];
        }
        *has_begun |= live.mode == Mode::Moving;
        // Once it moves, what is refused is something else.
        let refused = events.iter().find_map(|e| match e {
            Event::Refused { reason, .. } if !*has_begun => Some(reason.clone()),
            _ => None,
        });
        let ended = match &live.mode {
            Mode::Safe(reason) => Some(format!("The arm went SAFE: {reason}.")),
            Mode::Hold | Mode::Disarmed if *has_begun => Some(HELD.to_owned()),
            _ => failed.or(refused),
        };
        match ended {
            Some(why) => {
                self.answer(Err(why));
                let hold = (live.mode == Mode::Moving).then_some(Command::Hold);
                hold.into_iter().chain([Command::StopRecording]).collect()
            }
            None => Vec::new(),
        }
    }

    /// What was driven so far, and the operator's consent to what is next.
    pub fn ui(&mut self, ui: &mut Ui, live: &View<'_>, commands: &mut Vec<Command>) {
        for (k, why) in self.driven.iter().enumerate() {
            note(ui, format!("{}. {why}", k + 1));
        }
        match &self.awaits {
            Awaits::Work => {}
            Awaits::Consent(_) => {
                let mut hold = std::mem::take(&mut self.hold);
                if hold.button(ui, live, &Ok(()), &PROCEED, vec2(160.0, 32.0)) {
                    self.agreed = true;
                    self.begin(live, commands);
                }
                self.hold = hold;
            }
            Awaits::End { .. } | Awaits::Recording => {
                note(ui, "The arm is being driven; STOP and HOLD end it.");
            }
        }
    }
}

/// Whether the arm may be driven and recorded for such work, or why not.
pub fn conduct_gate(live: &View<'_>) -> Gate {
    let s = live.snapshot;
    if !s.link.connected {
        return Err("Not connected: there is no arm to drive.".into());
    }
    if s.recording.is_some() {
        return Err("A recording is running: stop it first.".into());
    }
    match &s.mode {
        Mode::Safe(_) => Err("SAFE: remove the cause, then press Reset.".into()),
        Mode::Moving => Err("The arm moves: hold it first.".into()),
        Mode::Disarmed if s.link.moves_hardware() => Err("Disarmed: arm the rig first.".into()),
        _ => Ok(()),
    }
}
