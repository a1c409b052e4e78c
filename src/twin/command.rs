use core::net::SocketAddr;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError};
use std::sync::{Arc, Mutex};

use crate::link::{LinkEvent, StopLine};
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::signal::ControllerKind;
use crate::signal::{Goal, Gripper, Mode, Severity, Simulator, Snapshot, Stamp};
use crate::task::Plan;

/// A command of the operator (or of a script) to the twin.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
    /// Allow motion; pressures and gripper stay as they are. Refused while the link is not healthy, and on hardware
    /// without a calibration of the robot.
    Arm,
    /// Stop commanding pressures; the boards keep their last set point until it times out.
    Disarm,
    /// Keep the present pressures. Never arms and never resumes: refused while disarmed.
    Hold,
    /// Continue after a hold. Refused within [`super::RESUME_OFF_S`] of it.
    Resume,
    /// Pumps off now, latched: the SAFE state.
    Stop,
    /// Leave the SAFE state (to disarmed). Refused in the tick of a [`Self::Stop`], and while the emergency stop is pressed.
    Reset,
    /// Bring all chambers to 0 Pa and switch the pumps off, SAFE or not. Refused while the arm moves.
    Vent,
    /// Ask whether a goal can be reached; nothing moves.
    Preview(Goal),
    /// Forget the goal under preview.
    CancelPreview,
    /// Steer to the goal under preview. Refused unless it is reachable.
    Go,
    /// Preview and go in one step. Refused unless the goal is reachable.
    Goto(Goal),
    /// Check every stop of a plan and, when all are reachable, carry it out. Refused as a whole otherwise.
    Start(Plan),
    /// Steer by this controller from now on.
    Steer(ControllerKind),
    /// What the operator believes is in the gripper, kg.
    DeclarePayload(f64),
    /// Open or close the gripper. Refused while disarmed.
    Grip(Gripper),
    /// Draw the arm by this simulator. Nothing moves.
    Show(Simulator),
    /// Read the sensors by this calibration from now on. Refused while the arm moves.
    Calibrate(Arc<Calibration>),
    /// An effect that the monitor has named is known, for this reason: it counts no longer. Refused without a reason.
    Mute {
        /// Its name, as in [`crate::signal::Disagreement::likely`].
        effect: String,
        /// Why.
        reason: String,
    },
    /// A muted effect counts again.
    Unmute(String),
    /// Settle the model of a patched robot beside the twin's own, at the same measured pressures, and show what both predict.
    /// Refused for another robot.
    TryPatch {
        /// What the patch adds, for people.
        name: String,
        /// The robot with the patch.
        robot: Arc<RobotSpec>,
    },
    /// End the trial of a patch.
    DropPatch,
    /// The model that is tried becomes the twin's own: the arm that is drawn and previewed, the residuals, the monitor. Networks,
    /// sensing and control stay as they are.
    KeepPatch,
    /// The twin's own model is that of its robot file again.
    RevertPatch,
    /// Record to this file.
    StartRecording(PathBuf),
    /// Close the recording.
    StopRecording,
    /// Mark this moment in the recordings that run, with what for; the text may be empty.
    Mark(String),
    /// The operator's note on the recording that runs, in place of the one before.
    Note(String),
    /// Stream every snapshot to the Rerun viewer that listens there. Data go unencrypted.
    StreamLive(SocketAddr),
    /// End the stream.
    StopStream,
}

/// Something that happened, for logs, toasts and recordings.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The mode changed.
    Mode {
        /// When.
        stamp: Stamp,
        /// The new mode.
        mode: Mode,
    },
    /// A command was refused, with the reason as one sentence.
    Refused {
        /// When.
        stamp: Stamp,
        /// Why, and what to do.
        reason: String,
    },
    /// A goal was reached.
    Reached {
        /// When.
        stamp: Stamp,
        /// Distance of the estimate from the goal, m.
        distance_m: f64,
        /// Control steps since the goal was set.
        steps: u64,
    },
    /// A plan is carried out.
    Finished {
        /// When.
        stamp: Stamp,
        /// Which.
        name: String,
    },
    /// The sensors are read by another calibration from now on.
    Calibrated {
        /// When.
        stamp: Stamp,
        /// Which.
        calibration: Arc<Calibration>,
    },
    /// A recording began or ended, or a moment of it was marked.
    Recording {
        /// When.
        stamp: Stamp,
        /// What happened, as one sentence.
        text: String,
    },
    /// A recording ended before it was asked to.
    RecordingFailed {
        /// When.
        stamp: Stamp,
        /// Why, what is kept, and what to do.
        reason: String,
    },
    /// Something that the operator should repair soon.
    Warning {
        /// When.
        stamp: Stamp,
        /// One sentence.
        text: String,
    },
    /// Anything else the operator should know.
    Notice {
        /// When.
        stamp: Stamp,
        /// One sentence.
        text: String,
    },
}

impl Event {
    /// What was noticed about the link at `stamp`.
    pub fn of_link(stamp: Stamp, event: &LinkEvent) -> Self {
        let text = event.text();
        match event.severity() {
            Severity::Info => Self::Notice { stamp, text },
            Severity::Warning | Severity::Critical => Self::Warning { stamp, text },
        }
    }

    /// How urgent it is.
    pub fn severity(&self) -> Severity {
        match self {
            Self::Mode {
                mode: Mode::Safe(_),
                ..
            } => Severity::Critical,
            Self::Refused { .. } | Self::RecordingFailed { .. } | Self::Warning { .. } => {
                Severity::Warning
            }
            Self::Mode { .. }
            | Self::Reached { .. }
            | Self::Finished { .. }
            | Self::Calibrated { .. }
            | Self::Recording { .. }
            | Self::Notice { .. } => Severity::Info,
        }
    }

    /// The event as one sentence.
    pub fn text(&self) -> String {
        match self {
            Self::Mode { mode, .. } => match mode {
                Mode::Disarmed => "Mode: disarmed".to_owned(),
                Mode::Hold => "Mode: hold".to_owned(),
                Mode::Moving => "Mode: moving".to_owned(),
                Mode::AtGoal => "Mode: at goal".to_owned(),
                Mode::Safe(reason) => format!("Mode: SAFE ({reason})"),
            },
            Self::Refused { reason, .. } | Self::RecordingFailed { reason, .. } => reason.clone(),
            Self::Reached {
                distance_m, steps, ..
            } => {
                format!(
                    "Goal reached: {:.1} mm away after {steps} steps",
                    distance_m * 1e3
                )
            }
            Self::Finished { name, .. } => format!("Done: {name}"),
            Self::Calibrated { calibration, .. } => {
                format!("Calibration in use: {}", calibration.name)
            }
            Self::Recording { text, .. }
            | Self::Warning { text, .. }
            | Self::Notice { text, .. } => text.clone(),
        }
    }
}

/// Counts the pictures that the window has painted: while it does, it would have taken a press of STOP.
#[derive(Clone, Debug, Default)]
pub struct Pictures(Arc<AtomicU64>);

impl Pictures {
    /// How many there were.
    pub(super) fn counted(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }

    /// One more.
    pub fn count(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}

/// The window's end of a running twin.
pub struct Handle {
    /// Commands to the twin (bounded).
    pub commands: SyncSender<Command>,
    /// Events from the twin.
    pub events: Receiver<Event>,
    /// Every snapshot since the last drain, oldest first (bounded: the newest are dropped when full).
    pub feed: Receiver<Arc<Snapshot>>,
    /// The newest snapshot.
    pub latest: Arc<Mutex<Arc<Snapshot>>>,
    /// STOP goes this way, too: to the boards, whatever the twin's thread does meanwhile.
    pub stop_line: StopLine,
    /// The window's pictures, to be counted.
    pub pictures: Pictures,
}

impl Handle {
    /// Sends a command; an error when the twin is gone or its queue is full.
    ///
    /// # Errors
    /// One sentence for the operator.
    pub fn send(&self, command: Command) -> Result<(), &'static str> {
        if command == Command::Stop {
            self.stop_line.press();
        }
        self.commands.try_send(command).map_err(|e| match e {
            TrySendError::Full(_) => "The twin is busy: the command was not taken. Try again.",
            TrySendError::Disconnected(_) => "The twin has stopped: restart the program.",
        })
    }

    /// The newest snapshot.
    pub fn snapshot(&self) -> Arc<Snapshot> {
        match self.latest.lock() {
            Ok(guard) => Arc::clone(&guard),
            Err(poisoned) => Arc::clone(&poisoned.into_inner()),
        }
    }
}
