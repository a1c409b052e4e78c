//! Health of the channels.

use serde::{Deserialize, Serialize};

use super::{CHAMBERS, IMUS, SPRINGS};

/// What is known about one channel's trustworthiness.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub enum ChannelHealth {
    /// Delivered and plausible.
    #[default]
    Ok,
    /// Delivered, but disagrees with the other channels.
    Suspect,
    /// Does not move while the arm does.
    Stuck,
    /// Outside the range its calibration covers.
    OutOfRange,
    /// Not delivered.
    Missing,
}

impl ChannelHealth {
    /// Whether the channel may be used for estimation.
    pub fn usable(self) -> bool {
        matches!(self, Self::Ok | Self::Suspect)
    }
}

/// Health of every channel at one instant.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Health {
    /// Per spring, in the order 1A, 1B to 6A, 6B.
    pub springs: [ChannelHealth; SPRINGS],
    /// Per IMU, 1 to 4.
    pub imus: [ChannelHealth; IMUS],
    /// Per chamber gauge, 1 to 6.
    pub chambers: [ChannelHealth; CHAMBERS],
}

impl Health {
    /// How many springs may be used.
    pub fn springs_usable(&self) -> usize {
        self.springs.iter().filter(|h| h.usable()).count()
    }

    /// How many IMUs may be used.
    pub fn imus_usable(&self) -> usize {
        self.imus.iter().filter(|h| h.usable()).count()
    }
}

/// Standard deviation of a length that is only held, m.
pub const UNKNOWN_M: f64 = 0.02;
/// Standard deviation of an angle that is only held, rad.
pub const UNKNOWN_RAD: f64 = 0.35;

/// Name of a spring (0-based) as on the screens: pair (1 to 6) and A or B.
pub fn spring_name(i: usize) -> String {
    format!(
        "{}{}",
        i / 2 + 1,
        if i.is_multiple_of(2) { "A" } else { "B" }
    )
}
