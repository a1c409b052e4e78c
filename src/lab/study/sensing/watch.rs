//! What a sensing does with the frames of a motion.

use crate::lab::motions::Sent;
use crate::lab::units::Lab;
use crate::learn::{Coverage, PoseMap as _, pose_residual};
use crate::robot::RobotSpec;
use crate::sensing::Sensing;
use crate::signal::{
    ChannelHealth, FAULT_NAMED, IMUS, Matrix6, RawFrame, SPRINGS, SensorFrame, Vector6,
};
use crate::twin::sensing_for;

/// Gives frames to a new sensing: `spoil` changes a frame first, or loses it, and `each` looks at the result.
pub(super) fn replay(
    robot: &RobotSpec,
    lab: &Lab,
    tape: &[Sent],
    spoil: &mut dyn FnMut(f64, &mut RawFrame) -> Delivery,
    each: &mut dyn FnMut(&Sent, &Sensing, &SensorFrame),
) {
    let mut sensing = sensing_for(robot, &lab.calibration);
    for sent in tape {
        let mut raw = sent.raw.clone();
        if spoil(sent.t_s, &mut raw) == Delivery::Lost {
            continue;
        }
        let frame = sensing.update(&raw);
        each(sent, &sensing, &frame);
    }
}

/// Whether a frame arrives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Delivery {
    /// It does.
    Arrives,
    /// It does not.
    Lost,
}

/// Errors of the tip's pose by a unit's networks, with what is stated of each.
#[derive(Default)]
pub(super) struct Tip {
    stated: Vec<(Vector6, Matrix6)>,
}

impl Tip {
    /// Takes in one frame.
    pub fn add(&mut self, lab: &Lab, sent: &Sent, frame: &SensorFrame) {
        let mut eval = lab.networks.cascade.pose(&frame.sensors.to_vector());
        eval.add_sigma(&frame.extra_sigma);
        let error = pose_residual(&eval.pose, &sent.base_from_pad[2]);
        self.stated.push((error, eval.covariance));
    }

    /// Errors of the position, mm.
    fn errors_mm(&self) -> impl Iterator<Item = f64> + '_ {
        let stated = self.stated.iter();
        stated.map(|(e, _)| e.fixed_rows::<3>(0).norm() * 1e3)
    }

    /// Mean error of the position, mm.
    pub fn mean_mm(&self) -> f64 {
        self.errors_mm().sum::<f64>() / self.stated.len() as f64
    }

    /// Shares of errors inside the stated regions.
    pub fn coverage(&self) -> Coverage {
        Coverage::of(&self.stated)
    }

    /// The number of errors.
    pub fn len(&self) -> usize {
        self.stated.len()
    }

    /// Those from the last `n` on.
    pub fn last(&self, n: usize) -> Self {
        let from = self.stated.len().saturating_sub(n);
        Self {
            stated: self.stated[from..].to_vec(),
        }
    }

    /// Adds those of another one.
    pub fn extend(&mut self, other: &Self) {
        self.stated.extend_from_slice(&other.stated);
    }
}

/// Springs and IMUs that are named as faulty.
pub(super) fn named(frame: &SensorFrame) -> [bool; SPRINGS + IMUS] {
    let wrong = |h: ChannelHealth| matches!(h, ChannelHealth::Stuck | ChannelHealth::OutOfRange);
    std::array::from_fn(|c| {
        let health = match c.checked_sub(SPRINGS) {
            None => frame.health.springs[c],
            Some(i) => frame.health.imus[i],
        };
        frame.quality.fault_probability[c] > FAULT_NAMED || wrong(health)
    })
}
