//! What a run adds up to, in memory that does not grow with its length.

use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::sync::Arc;

use super::driver::Observer;
use crate::learn::RunningStats;
use crate::signal::{Goal, Snapshot, Stamp, StreamStatus, pose_error};
use crate::twin::{Command, Event};

/// The distance from the target is the mean over so long before the end, s.
const TARGET_S: f64 = 1.0;

/// Running sums over the ticks of a run.
#[derive(Default)]
pub struct Tally {
    target: Option<Goal>,
    /// Position errors of the estimate where motion capture saw the tip at the same time, mm.
    pub tip_error_mm: RunningStats,
    /// Rotation errors of the estimate at the same times, degrees.
    pub rotation_error_deg: RunningStats,
    /// Distance of the true tip from the target with its time, over the last second, mm.
    off_target_mm: VecDeque<(Stamp, f64)>,
    /// Why the recording ended before the run; `None` if it did not.
    pub recording_failed: Option<String>,
    /// Whether a goal was reached.
    pub reached: bool,
    /// Control steps to the goal that was reached last.
    pub steps: u64,
    /// The newest snapshot; `None` before the first.
    pub last: Option<Arc<Snapshot>>,
    /// The live stream as it was at the end; `None` if there was none.
    pub stream: Option<StreamStatus>,
}

impl Tally {
    /// Of a run to a target, or with `None` without one.
    pub fn new(target: Option<Goal>) -> Self {
        Self {
            target,
            ..Self::default()
        }
    }

    /// Takes one tick. The memory does not grow with the number of ticks.
    fn take(&mut self, snapshot: &Arc<Snapshot>, events: &[Event]) {
        for event in events {
            match event {
                Event::RecordingFailed { reason, .. } => {
                    self.recording_failed = Some(reason.clone());
                }
                Event::Reached { steps, .. } => {
                    self.reached = true;
                    self.steps = *steps;
                }
                _ => {}
            }
        }
        // What motion capture saw before it lost the object is no reference for now.
        let truth = snapshot.fresh_truth();
        if let (Some(estimate), Some(truth)) = (&snapshot.estimate, truth) {
            let e = pose_error(&estimate.base_from_tip, &truth.base_from_tip);
            self.tip_error_mm.push(e.fixed_rows::<3>(0).norm() * 1e3);
            self.rotation_error_deg
                .push(e.fixed_rows::<3>(3).norm().to_degrees());
        }
        if let (Some(target), Some(truth)) = (&self.target, truth) {
            let d =
                truth.base_from_tip.translation.vector - nalgebra::Vector3::from(target.position_m);
            self.off_target_mm
                .push_back((snapshot.stamp, d.norm() * 1e3));
        }
        let is_old = |(at, _): &(Stamp, f64)| snapshot.stamp.since(*at) >= TARGET_S;
        while self.off_target_mm.front().is_some_and(is_old) {
            self.off_target_mm.pop_front();
        }
        self.last = Some(Arc::clone(snapshot));
    }

    /// Mean distance of the true tip from the target over the last second, mm; `None` without ground truth.
    pub fn target_error_mm(&self) -> Option<f64> {
        let off_mm = self.off_target_mm.iter().map(|(_, mm)| mm);
        (!self.off_target_mm.is_empty())
            .then(|| off_mm.sum::<f64>() / self.off_target_mm.len() as f64)
    }
}

impl Observer for Tally {
    fn observe(
        &mut self,
        snapshot: &Arc<Snapshot>,
        events: &[Event],
        _commands: &mut Vec<Command>,
    ) -> ControlFlow<()> {
        self.take(snapshot, events);
        ControlFlow::Continue(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::{Estimate, GroundTruth, Matrix6, Pose, TruthSource};

    /// A tick of a tip that moves by 1 mm/s along x; motion capture sees it exactly until `lost_s`.
    fn tick(k: u32, lost_s: f64) -> Arc<Snapshot> {
        let at = |t_s: f64| Pose::translation(1e-3 * t_s, 0.0, -0.3);
        let t_s = f64::from(k) * 0.01;
        let seen_s = t_s.min(lost_s);
        Arc::new(Snapshot {
            stamp: Stamp::from_seconds(t_s),
            estimate: Some(Estimate {
                stamp: Stamp::from_seconds(t_s),
                base_from_tip: at(t_s),
                covariance: Matrix6::zeros(),
                training_distance: 1.0,
            }),
            truth: Some(GroundTruth {
                stamp: Stamp::from_seconds(seen_s),
                base_from_tip: at(seen_s),
                source: TruthSource::Vicon,
            }),
            ..Snapshot::default()
        })
    }

    #[test]
    fn a_pose_from_before_motion_capture_stopped_scores_nothing() {
        let target = Goal::position([0.0, 0.0, -0.3]);
        let mut tally = Tally::new(Some(target));
        for k in 0..2000 {
            tally.take(&tick(k, 5.0), &[]);
        }
        // Up to 0.1 s old it is compared: 0.1 mm at 1 mm/s.
        let most_mm = tally.tip_error_mm.stats().expect("scored").max;
        assert!(most_mm <= 0.1 + 1e-9, "{most_mm}");
        assert_eq!(tally.tip_error_mm.count(), 511);
        assert_eq!(tally.target_error_mm(), None, "15 s without");
    }

    #[test]
    fn hours_take_no_more_memory_than_seconds() {
        let target = Goal::position([0.0, 0.0, -0.3]);
        let mut tally = Tally::new(Some(target));
        let bytes = |t: &Tally| {
            let queue = t.off_target_mm.capacity() * size_of::<(Stamp, f64)>();
            t.tip_error_mm.bytes() + t.rotation_error_deg.bytes() + queue
        };
        for k in 0..2000 {
            tally.take(&tick(k, f64::MAX), &[]);
        }
        let early = bytes(&tally);
        for k in 2000..200_000 {
            tally.take(&tick(k, f64::MAX), &[]);
        }
        assert_eq!(bytes(&tally), early);
        assert!(early < 100_000, "{early} bytes");
        let off_mm = tally.target_error_mm().expect("seen to the end");
        assert!((off_mm - 1999.5).abs() < 0.1, "{off_mm}");
    }
}
