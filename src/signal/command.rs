use nalgebra::SVector;
use serde::{Deserialize, Serialize};

use super::{CHAMBERS, SIGNALS, Stamp};

/// What the gripper shall do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Gripper {
    /// Open, holds nothing.
    #[default]
    Open,
    /// Closed around an object.
    Closed,
}

/// Which controller steers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ControllerKind {
    /// Sensor-space descent with ADRC, as in the paper.
    PaperAdrc,
    /// Null-space QP: a bounded quadratic programme in actuator space.
    #[default]
    NullSpaceQp,
}

/// The bounds every pressure command obeys. Read from the robot file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PressureLimits {
    /// Lowest gauge pressure, Pa.
    pub min_pa: f64,
    /// Highest gauge pressure, Pa.
    pub max_pa: f64,
    /// Fastest change of a chamber's set pressure, Pa/s.
    pub rate_pa_s: f64,
}

/// The sensor signals the inner loop steers to: 24 values as in [`super::SensorVec::to_vector`].
pub type SensorRef = SVector<f64, SIGNALS>;

/// Set pressures for the boards. Can only be built through [`PressureLimits`], so a value of this
/// type is always finite, within range and within rate of its predecessor.
#[derive(Clone, Debug, PartialEq)]
pub struct PressureCommand {
    stamp: Stamp,
    chamber_pa: [f64; CHAMBERS],
    gripper: Option<Gripper>,
}

impl PressureCommand {
    /// Clamps `wanted_pa` into the limits and into the rate limit from `previous`.
    ///
    /// A wanted value that is not finite is replaced by the previous one (or by 0 Pa when there is
    /// none). Without a `previous` command (`None`) the start is taken to be `measured_pa`. A `gripper` of `None` leaves
    /// the gripper as it is. Pressures are gauge pressures in the order of the chambers, Pa.
    pub fn limited(
        stamp: Stamp,
        wanted_pa: [f64; CHAMBERS],
        gripper: impl Into<Option<Gripper>>,
        previous: Option<&Self>,
        measured_pa: &[f64; CHAMBERS],
        limits: &PressureLimits,
    ) -> Self {
        let chamber_pa = std::array::from_fn(|i| {
            let (from, dt_s) = match previous {
                Some(p) => (p.chamber_pa[i], stamp.since(p.stamp).clamp(0.0, 0.1)),
                None => (measured_pa[i], 0.01),
            };
            let from = if from.is_finite() {
                from.clamp(limits.min_pa, limits.max_pa)
            } else {
                0.0
            };
            let step = limits.rate_pa_s * dt_s;
            let wanted = if wanted_pa[i].is_finite() {
                wanted_pa[i]
            } else {
                from
            };
            wanted
                .clamp(from - step, from + step)
                .clamp(limits.min_pa, limits.max_pa)
        });
        Self {
            stamp,
            chamber_pa,
            gripper: gripper.into(),
        }
    }

    /// When the command was computed.
    pub fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// Set gauge pressure of each chamber, 1 to 6, Pa.
    pub fn chamber_pa(&self) -> &[f64; CHAMBERS] {
        &self.chamber_pa
    }

    /// What the gripper shall do; `None`: stay as it is.
    pub fn gripper(&self) -> Option<Gripper> {
        self.gripper
    }
}
