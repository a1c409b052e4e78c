//! The topics that this program writes.

use super::messages::MessageKind;

/// A topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Topic {
    Payload,
    Springs,
    /// By its number from 0 on, like those below.
    Imu(usize),
    ImuRaw(usize),
    Pressure(usize),
    SetPressure(usize),
    Estimate,
    Mocap(Capture),
    Load,
    Transforms,
    Diagnostics,
}

/// Whether motion capture is a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Capture {
    Measured,
    Simulated,
}

impl Topic {
    /// Its name.
    pub(super) fn name(self) -> String {
        match self {
            Self::Payload => super::PAYLOAD.to_owned(),
            Self::Springs => super::SPRINGS_TOPIC.to_owned(),
            Self::Imu(i) => super::imu_topic(i),
            Self::ImuRaw(i) => format!("/imu{}/data_raw", i + 1),
            Self::Pressure(i) => super::pressure_topic(i),
            Self::SetPressure(i) => super::set_pressure_topic(i),
            Self::Estimate => "/estimate/pose".to_owned(),
            Self::Mocap(Capture::Measured) => super::MOCAP.to_owned(),
            Self::Mocap(Capture::Simulated) => super::SIMULATED_MOCAP.to_owned(),
            Self::Load => "/load".to_owned(),
            Self::Transforms => "/tf".to_owned(),
            Self::Diagnostics => "/diagnostics".to_owned(),
        }
    }

    /// The type of its messages.
    pub(super) fn kind(self) -> MessageKind {
        match self {
            Self::Payload => MessageKind::Float64,
            Self::Springs => MessageKind::JointState,
            Self::Imu(_) | Self::ImuRaw(_) => MessageKind::Imu,
            Self::Pressure(_) | Self::SetPressure(_) => MessageKind::FluidPressure,
            Self::Estimate | Self::Mocap(_) => MessageKind::Pose,
            Self::Load => MessageKind::Wrench,
            Self::Transforms => MessageKind::Transforms,
            Self::Diagnostics => MessageKind::Diagnostics,
        }
    }

    /// What a reader of the topic should know.
    pub(super) fn about(self) -> Option<(&'static str, &'static str)> {
        match self {
            Self::Payload => Some(("unit", "kg, as declared")),
            Self::Springs => Some(("unit", "m")),
            Self::Imu(_) => Some(("orientation", "pad under the IMU, base from pad")),
            Self::ImuRaw(_) => Some(("frame", "axes of the IMU")),
            Self::Pressure(_) => Some(("pressure", "gauge, Pa, measured")),
            Self::SetPressure(_) => Some(("pressure", "gauge, Pa, set")),
            Self::Mocap(Capture::Simulated) => Some(("source", "simulated motion capture")),
            _ => None,
        }
    }
}
