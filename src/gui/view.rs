//! What a screen shows: the live twin, or a recording at its playhead.

use crate::analysis::history::History;
use crate::analysis::player::Near;
use crate::analysis::recorded::origin_name;
use crate::robot::RobotSpec;
use crate::signal::{ArmingCheck, Mode, Snapshot, Stamp, TruthSource};

/// Whether an action is possible now, or why not (one sentence).
pub type Gate = Result<(), String>;

/// Everything that a panel shows, at one instant.
#[derive(Clone, Copy)]
pub struct View<'a> {
    /// Everything known at the instant shown.
    pub snapshot: &'a Snapshot,
    /// The signals over time.
    pub history: &'a History,
    /// Some of them at the full rate, where those of a long recording are farther apart.
    pub near: Option<&'a Near>,
    /// The instant shown, s on the time base of the snapshot.
    pub now_s: f64,
    /// Name of the recording, when one is shown instead of the live twin.
    pub replay: Option<&'a str>,
    /// The robot.
    pub spec: &'a RobotSpec,
    /// Whether the data shown were simulated; `None` if unknown.
    pub simulated: Option<bool>,
}

/// Age of the last data from which on they are called old, s.
const STALE_AFTER_S: f64 = 0.25;

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
pub const STALE_OPACITY: f32 = 0.65;

impl View<'_> {
    /// The signals of a span of time, at the full rate where that was read.
    pub fn signals(&self, range_s: [f64; 2]) -> &History {
        let near = self.near.and_then(|near| near.history(range_s));
        near.unwrap_or(self.history)
    }

    /// Whether a question may be put to the live twin about what is shown.
    pub fn live(&self) -> Gate {
        match self.replay {
            Some(name) => Err(format!(
                "Replaying {name}: close the replay to control the arm."
            )),
            None => self.drivable(),
        }
    }

    /// Whether this program can drive the robot at all.
    pub fn drivable(&self) -> Gate {
        match self.spec.lacks() {
            Some(lacks) => Err(format!(
                "This arm has {lacks}: nothing estimates its pose, so it cannot be driven. Its recordings can be replayed, and \
                 compared with the model."
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

    /// How long ago the last data came, s, once they are old.
    pub fn stale_s(&self) -> Option<f64> {
        let at = last_data(self.snapshot).filter(|_| self.replay.is_none())?;
        Some(self.snapshot.stamp.since(at)).filter(|stale_s| *stale_s > STALE_AFTER_S)
    }

    /// Whether the arm may be moved.
    pub fn motion(&self) -> Gate {
        self.live()?;
        if !self.snapshot.link.connected {
            return Err("Not connected: motion is off until frames arrive.".into());
        }
        match &self.snapshot.mode {
            Mode::Safe(_) => Err("SAFE: the pumps are off. Press Reset first.".into()),
            Mode::Disarmed if self.snapshot.link.moves_hardware() => {
                Err("Disarmed: arm the hardware first.".into())
            }
            Mode::Hold if self.snapshot.gauge_check == ArmingCheck::Due => {
                Err("The gauges are not checked: press Arm in the Target panel.".into())
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
