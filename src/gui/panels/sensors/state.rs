//! What the Sensors screen keeps, and which signals it shows.

use crate::analysis::history::Channel;
use crate::gui::panels::plot::Export;
use crate::gui::view::View;

/// What figures and plots show of the sensors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reading {
    /// Lengths in mm and angles in deg.
    #[default]
    Calibrated,
    /// Frequencies in kHz and angular rates in deg/s, as the boards deliver them.
    Raw,
    /// Calibrated less the twin's own model at the measured pressures.
    Residual,
}

/// What the screen keeps.
#[derive(Default)]
pub struct SensorsState {
    /// The spring (0-based) that stands out in plots and 3D.
    pub selected_spring: Option<usize>,
    /// Which angle of the IMUs is plotted: yaw, pitch or roll. Of raw rates: x, y or z.
    pub angle: usize,
    /// What figures and plots show.
    pub reading: Reading,
    /// A file of what the plots show.
    pub export: Export,
}

/// The signal of a spring (0-based) under a reading.
pub fn spring_channel(reading: Reading, i: usize) -> Channel {
    match reading {
        Reading::Calibrated => Channel::Spring(i),
        Reading::Raw => Channel::SpringRaw(i),
        Reading::Residual => Channel::SpringResidual(i),
    }
}

/// Age of a channel's newest reading, s: by the newest frame, else by the history of the last minutes.
pub fn channel_age_s(
    view: &View<'_>,
    delivered: bool,
    board: usize,
    channel: Channel,
) -> Option<f64> {
    match &view.snapshot.raw {
        Some(raw) if delivered => {
            Some(view.snapshot.stamp.since(raw.stamp) + raw.board_age_s[board])
        }
        _ => {
            let now_s = view.now_s.max(view.snapshot.stamp.seconds());
            let age_s = now_s - view.history.last_before(channel, now_s)?;
            (age_s <= 600.0).then_some(age_s)
        }
    }
}

/// What the three figures of an IMU are called.
pub fn axes(reading: Reading) -> [&'static str; 3] {
    match reading {
        Reading::Raw => ["rate x", "rate y", "rate z"],
        Reading::Calibrated | Reading::Residual => ["yaw", "pitch", "roll"],
    }
}

/// The signal of an IMU (0-based) under a reading.
pub fn imu_channel(reading: Reading, i: usize, k: usize) -> Channel {
    match reading {
        Reading::Calibrated => Channel::Imu(i, k),
        Reading::Raw => Channel::Gyro(i, k),
        Reading::Residual => Channel::ImuResidual(i, k),
    }
}
