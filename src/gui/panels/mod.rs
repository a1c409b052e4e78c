//! The panels: each is a function of what is known now and pushes commands; it keeps only
//! selection and text drafts.

pub mod accuracy;
pub mod calibrate;
pub mod chambers;
pub mod connect;
pub mod dashboard;
pub mod files;
pub mod gap;
pub mod operate;
pub mod palette;
pub mod plans;
pub mod plot;
pub mod pose;
pub mod recordings;
pub mod rerun;
pub mod sensors;
pub mod shell;
pub mod simulator;
pub mod strips;
pub mod target;
pub mod toasts;
pub mod trouble;
pub mod view3d;
pub mod welcome;
pub mod widgets;

use serde::{Deserialize, Serialize};

use crate::analysis::history::History;
use crate::analysis::recorded::origin_name;
use crate::robot::RobotSpec;
use crate::signal::{Mode, Snapshot, Stamp, TruthSource};
use widgets::Gate;

/// The screens, in the order of the rail. Numbers are those of the shortcuts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Screen {
    /// Move the arm.
    #[default]
    Operate,
    /// Springs and IMUs.
    Sensors,
    /// Predicted against measured pose.
    Accuracy,
    /// The wizard that calibrates springs, IMUs and motion capture.
    Calibrate,
    /// Library and player.
    Recordings,
    /// What the model is missing.
    Gap,
}

impl Screen {
    /// All screens there are.
    pub const ALL: [Self; 6] = [
        Self::Operate,
        Self::Sensors,
        Self::Accuracy,
        Self::Calibrate,
        Self::Recordings,
        Self::Gap,
    ];

    /// Name on screen.
    pub fn name(self) -> &'static str {
        match self {
            Self::Operate => "Operate",
            Self::Sensors => "Sensors",
            Self::Accuracy => "Accuracy",
            Self::Calibrate => "Calibrate",
            Self::Recordings => "Recordings",
            Self::Gap => "Gap",
        }
    }

    /// The digit that goes with Ctrl.
    pub fn key(self) -> egui::Key {
        match self {
            Self::Operate => egui::Key::Num1,
            Self::Sensors => egui::Key::Num2,
            Self::Accuracy => egui::Key::Num3,
            Self::Calibrate => egui::Key::Num4,
            Self::Recordings => egui::Key::Num5,
            Self::Gap => egui::Key::Num6,
        }
    }

    /// Width and height that its panels need at least, points: in a lesser window it is scrolled.
    pub fn least_points(self) -> egui::Vec2 {
        match self {
            // Its panels are scrolled one by one: they would not be cut at the edge of a scroll area around all.
            Self::Operate => egui::vec2(300.0, 150.0),
            Self::Sensors => egui::vec2(880.0, 564.0),
            Self::Accuracy => egui::vec2(900.0, 520.0),
            Self::Calibrate => egui::vec2(880.0, 320.0),
            Self::Recordings => egui::vec2(880.0, 480.0),
            Self::Gap => egui::vec2(900.0, 540.0),
        }
    }

    /// What it is for, one sentence.
    pub fn purpose(self) -> &'static str {
        match self {
            Self::Operate => "See the arm, choose a target and move.",
            Self::Sensors => "The twelve springs, the four IMUs and the boards.",
            Self::Accuracy => "The predicted pose against motion capture.",
            Self::Calibrate => "Calibrate springs, IMUs and motion capture, step by step.",
            Self::Recordings => "Record, play, compare and open recordings.",
            Self::Gap => "Find what the model is missing, add it and prove it.",
        }
    }
}

/// What the panels look at: the live twin, or a recording at its playhead.
#[derive(Clone, Copy)]
pub struct View<'a> {
    /// Everything known at the instant shown.
    pub snapshot: &'a Snapshot,
    /// The signals over time.
    pub history: &'a History,
    /// The instant shown, s on the time base of the snapshot.
    pub now_s: f64,
    /// Name of the recording, when one is shown instead of the live twin.
    pub replay: Option<&'a str>,
    /// The robot.
    pub spec: &'a RobotSpec,
    /// Whether the data shown were simulated; `None` when nobody says.
    pub simulated: Option<bool>,
}

/// An age of the last data from which on it is told, s.
const TOLD_S: f64 = 0.25;

/// When the last data came from the boards, if they came and come no longer.
fn last_data(live: &Snapshot) -> Option<Stamp> {
    let sensors = live.sensors.as_ref().filter(|_| !live.link.connected)?;
    Some(sensors.stamp)
}

/// Up to when plots show a live twin, s: now, or while no data come the time of the last.
pub fn live_until_s(live: &Snapshot) -> f64 {
    last_data(live).unwrap_or(live.stamp).seconds()
}

/// Opacity of values that no longer come: they stay readable.
const STALE_OPACITY: f32 = 0.65;

impl View<'_> {
    /// Whether a question may be put to the live twin about what is shown.
    pub fn live(&self) -> Gate {
        match self.replay {
            Some(name) => Err(format!(
                "Replaying {name}: close the replay to control the arm."
            )),
            None => Ok(()),
        }
    }

    /// Greys values that no longer come; they stay readable.
    pub fn grey_if_stale(&self, ui: &mut egui::Ui) {
        if self.is_stale() {
            ui.multiply_opacity(STALE_OPACITY);
        }
    }

    /// Whether live values are shown that no longer come.
    pub fn is_stale(&self) -> bool {
        self.replay.is_none() && last_data(self.snapshot).is_some()
    }

    /// How long ago the last data came, s, when that is long enough to be told.
    pub fn stale_s(&self) -> Option<f64> {
        let at = last_data(self.snapshot).filter(|_| self.replay.is_none())?;
        Some(self.snapshot.stamp.since(at)).filter(|stale_s| *stale_s > TOLD_S)
    }

    /// Whether the arm may be moved.
    pub fn motion(&self) -> Gate {
        self.live()?;
        if !self.snapshot.link.connected {
            return Err("Not connected: motion is off until frames arrive.".into());
        }
        match &self.snapshot.mode {
            Mode::Safe(_) => Err("SAFE: the pumps are off. Press Reset first.".into()),
            Mode::Disarmed if !self.snapshot.link.simulated => {
                Err("Disarmed: arm the hardware first.".into())
            }
            _ => Ok(()),
        }
    }

    /// Whether motion capture sees the end pad at the instant of the estimate.
    pub fn truth_is_fresh(&self) -> bool {
        self.snapshot.fresh_truth().is_some()
    }

    /// Name of the ground truth, with its origin.
    pub fn truth_name(&self) -> &'static str {
        match self.snapshot.truth.as_ref().map(|t| t.source) {
            Some(TruthSource::VirtualRig) => "Vicon (simulated)",
            Some(TruthSource::Vicon) | None => "Vicon",
        }
    }

    /// Where the data shown come from: [`origin_name`].
    pub fn origin(&self) -> &'static str {
        origin_name(self.simulated)
    }
}
