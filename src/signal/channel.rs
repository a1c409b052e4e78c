//! Where something can be wrong with an arm: the side it is on, and the channel.

use super::{CHAMBERS, IMUS, SPRINGS};

/// Side on which an effect acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Between commanded and chamber pressure.
    Actuation,
    /// In the arm.
    Mechanics,
    /// In springs and IMUs.
    Sensing,
    /// In frame and clock of the motion capture.
    FrameAndTime,
}

/// Kind of channel that an effect acts on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// One chamber.
    Chamber,
    /// One spring.
    Spring,
    /// One IMU.
    Imu,
    /// One segment.
    Segment,
    /// The whole.
    None,
}

impl Target {
    /// Number of such channels.
    pub fn count(self) -> usize {
        match self {
            Self::Chamber => CHAMBERS,
            Self::Spring => SPRINGS,
            Self::Imu => IMUS,
            Self::Segment => 2,
            Self::None => 0,
        }
    }
}
