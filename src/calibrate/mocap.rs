//! Motion capture: pairs of estimated and measured pose while the arm rests, and the registration from them.

use std::collections::VecDeque;
use std::sync::Arc;

use crate::sensing::Calibration;
use crate::sensing::registration::{
    FitOptions, FrameFit, ObjectFrame, PosePair, Registration, RegistrationError, digest, register,
};
use crate::signal::{Pose, RawFrame, Snapshot, Stamp};
use crate::twin::{FrameLog, Rest, RestPoses, TRIAL_SETTLING_S, mean_pose};

/// Time that the arm must have rested, s.
const REST_S: f64 = 0.5;
/// Speed of the measured pose below which the arm rests, m/s and rad/s.
const REST_M_S: f64 = 1.5e-3;
const REST_RAD_S: f64 = 1.0 * std::f64::consts::PI / 180.0;
/// Least distance from all other poses for a pose to be captured automatically, m or rad.
const APART_M: f64 = 12e-3;
const APART_RAD: f64 = 4.0 * std::f64::consts::PI / 180.0;
/// Largest number of pairs.
const PAIRS_MAX: usize = 60;
/// Time before the first pose from which raw frames are kept, s: the filters settle meanwhile.
const BEFORE_S: f64 = TRIAL_SETTLING_S + 1.0;
/// Largest number of raw frames, ten minutes of them; later poses register motion capture, but take no part in the
/// validation.
const RAW_MAX: usize = 60_000;

/// The pairs and the registration fitted to them.
#[derive(Clone, Debug, Default)]
pub struct MocapTake {
    pairs: Vec<PosePair>,
    /// Per pair, its time and the calibration in use.
    kept: Vec<(Rest, Arc<Calibration>)>,
    raw: FrameLog,
    reads_by: Option<Arc<Calibration>>,
    window: VecDeque<(Stamp, Pose, Pose)>,
    fit: Option<Result<FrameFit, RegistrationError>>,
    object_is_pad: bool,
    /// Whether poses are captured automatically when the arm rests.
    pub automatic: bool,
}

impl MocapTake {
    /// The pairs captured.
    pub fn pairs(&self) -> &[PosePair] {
        &self.pairs
    }

    /// What has changed since the poses were captured, if they were read with another calibration than `draft`; else `None`.
    pub fn outdated(&self, draft: &Calibration) -> Option<&'static str> {
        let any = |f: &dyn Fn(&Calibration) -> bool| self.kept.iter().any(|(_, c)| f(c));
        if any(&|c| c.springs != draft.springs) {
            return Some("the springs have changed since");
        }
        let changed =
            |c: &Calibration| c.imus != draft.imus || c.base_tilt_rad != draft.base_tilt_rad;
        any(&changed).then_some("the IMUs have changed since")
    }

    /// The poses as raw frames, to compare calibrations. The frames are shared.
    pub fn raw_poses(&self) -> RestPoses {
        RestPoses {
            frames: self.raw.clone(),
            rests: self.kept.iter().map(|(rest, _)| *rest).collect(),
            object: self.object(),
        }
    }

    /// The registration fitted to the poses; `None` before there are any.
    pub fn fit(&self) -> Option<&Result<FrameFit, RegistrationError>> {
        self.fit.as_ref()
    }

    /// The registration for the file: chained to `in_use`, by which the poses were already transformed (`None`: by none).
    /// `None` without a fit that succeeded.
    pub fn registration(
        &self,
        in_use: Option<&Registration>,
        object: &str,
    ) -> Option<Registration> {
        let fit = self.fit.as_ref()?.as_ref().ok()?;
        let mut found = Registration::of_poses(fit, object, "not stated", &digest(&self.pairs));
        if let Some(old) = in_use {
            // B = X (X₀ A Y₀) Y
            found.base_from_world.pose *= old.base_from_world.pose;
            found.object_from_tip.pose = old.object_from_tip.pose * found.object_from_tip.pose;
            found.object.clone_from(&old.object);
            found.clock = old.clock;
        }
        Some(found)
    }

    /// The mean pose of the last half second.
    ///
    /// # Errors
    /// Why there is none: the arm moves, or motion capture does not see it.
    pub fn rested(&self) -> Result<PosePair, String> {
        let span = self.window.front().zip(self.window.back());
        let span_s = span.map_or(0.0, |(a, b)| b.0.since(a.0));
        if span_s < 0.9 * REST_S {
            return Err("No pose of both yet: motion capture must see the end pad.".into());
        }
        let half = self.window.len() / 2;
        let (old, new) = (self.mean(0..half), self.mean(half..self.window.len()));
        let seen_m = (new.1.translation.vector - old.1.translation.vector).norm();
        let seen_rad = new.1.rotation.angle_to(&old.1.rotation);
        let between_s = 0.5 * span_s;
        if seen_m > REST_M_S * between_s || seen_rad > REST_RAD_S * between_s {
            return Err("The arm moves: let it rest first.".into());
        }
        let (base_from_tip, world_from_object) = self.mean(0..self.window.len());
        Ok(PosePair {
            base_from_tip,
            world_from_object,
        })
    }

    fn mean(&self, range: std::ops::Range<usize>) -> (Pose, Pose) {
        let (robot, seen): (Vec<Pose>, Vec<Pose>) =
            self.window.range(range).map(|r| (r.1, r.2)).unzip();
        let of = |poses: &[Pose]| mean_pose(poses).unwrap_or_else(Pose::identity);
        (of(&robot), of(&seen))
    }

    fn keep_raw(&mut self, raw: &RawFrame) {
        let newer = self.raw.last().is_none_or(|l| raw.stamp > l.stamp);
        if !newer || self.raw.len() >= RAW_MAX {
            return;
        }
        self.raw.push(raw.clone());
        if self.pairs.is_empty() {
            self.raw.forget_before(raw.stamp.plus(-BEFORE_S));
        }
    }

    /// Processes a live snapshot of a robot whose sensors are read with `in_use`.
    pub fn observe(&mut self, snapshot: &Snapshot, in_use: &Arc<Calibration>) {
        if let Some(raw) = &snapshot.raw {
            self.keep_raw(raw);
        }
        if self.reads_by.as_ref() != Some(in_use) {
            self.reads_by = Some(Arc::clone(in_use));
            self.window.clear();
        }
        let (Some(estimate), Some(truth)) = (&snapshot.estimate, snapshot.fresh_truth()) else {
            self.window.clear();
            return;
        };
        if self
            .window
            .back()
            .is_some_and(|last| truth.stamp <= last.0 || truth.stamp.since(last.0) > 0.2)
        {
            if self.window.back().is_some_and(|last| truth.stamp > last.0) {
                self.window.clear();
            }
            return;
        }
        let row = (truth.stamp, estimate.base_from_tip, truth.base_from_tip);
        self.window.push_back(row);
        while self
            .window
            .front()
            .is_some_and(|first| truth.stamp.since(first.0) > REST_S)
        {
            self.window.pop_front();
        }
        if self.automatic
            && let Ok(pair) = self.rested()
            && self.pairs.iter().all(|p| is_apart(p, &pair))
        {
            self.add(pair);
        }
    }

    /// Adds a pair.
    pub fn add(&mut self, pair: PosePair) {
        let span = self.window.front().zip(self.window.back());
        if let (Some((first, last)), Some(reads_by)) = (span, &self.reads_by)
            && self.pairs.len() < PAIRS_MAX
        {
            let rest = Rest {
                from: first.0,
                to: last.0,
                world_from_object: pair.world_from_object,
            };
            self.kept.push((rest, Arc::clone(reads_by)));
            self.pairs.push(pair);
            self.refit();
        }
    }

    /// Removes pair `i` (0-based).
    pub fn remove(&mut self, i: usize) {
        if i < self.pairs.len() {
            self.pairs.remove(i);
            self.kept.remove(i);
            self.refit();
        }
    }

    /// Whether the tracked object is assumed to be the end pad's own frame.
    pub fn object_is_pad(&self) -> bool {
        self.object_is_pad
    }

    /// Assumes the tracked object to be the end pad's own frame, or fits where it is.
    pub fn set_object_is_pad(&mut self, known: bool) {
        self.object_is_pad = known;
        self.refit();
    }

    fn object(&self) -> ObjectFrame {
        match self.object_is_pad {
            true => ObjectFrame::Known(Pose::identity()),
            false => ObjectFrame::Unknown,
        }
    }

    fn refit(&mut self) {
        let options = FitOptions {
            object: self.object(),
            ..FitOptions::default()
        };
        self.fit = (!self.pairs.is_empty()).then(|| register(&self.pairs, &options));
    }
}

fn is_apart(a: &PosePair, b: &PosePair) -> bool {
    let (a, b) = (&a.world_from_object, &b.world_from_object);
    (a.translation.vector - b.translation.vector).norm() > APART_M
        || a.rotation.angle_to(&b.rotation) > APART_RAD
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::fixture::{captured, frames, in_use, pose, rest_at, snapshot};

    #[test]
    fn poses_are_captured_at_rest_once_each_and_give_the_frames_back() {
        let [x, y] = frames();
        let mut take = captured();
        assert_eq!(take.pairs().len(), 12);
        let found = take.registration(None, "pad").expect("registers");
        assert!(found.base_from_world.pose.rotation.angle_to(&x.rotation) < 1e-6);
        // What went through a registration already is chained to it: the two undo each other.
        let mut old = found.clone();
        old.base_from_world.pose = x.inverse();
        old.object_from_tip.pose = y.inverse();
        let chained = take.registration(Some(&old), "pad").expect("registers");
        assert!(chained.base_from_world.pose.rotation.angle() < 1e-6);
        assert!(chained.object_from_tip.pose.translation.vector.norm() < 1e-6);
        // They were read with one calibration, and another one makes them old.
        let mut draft = Calibration::virtual_rig();
        assert_eq!(take.outdated(&draft), None);
        draft.imus.clear();
        let other_imus = draft.imus != Calibration::virtual_rig().imus;
        assert_eq!(take.outdated(&draft).is_some(), other_imus);
        draft.springs[0].curve.coefficients_m[0] += 1e-3;
        assert_eq!(
            take.outdated(&draft),
            Some("the springs have changed since")
        );
        take.set_object_is_pad(true);
        assert!(
            matches!(take.fit(), Some(Err(RegistrationError::Disagree { .. }))),
            "the object is not the pad here: {:?}",
            take.fit()
        );
        take.set_object_is_pad(false);
        take.remove(0);
        take.remove(0);
        take.remove(0);
        assert!(matches!(
            take.fit(),
            Some(Err(RegistrationError::TooFew { poses: 9 }))
        ));
    }

    #[test]
    fn an_object_that_is_hidden_gives_no_pair_of_its_former_pose() {
        let mut take = MocapTake::default();
        let at = pose(0);
        rest_at(&mut take, 0.0, &at, &at);
        assert!(take.rested().is_ok());
        // The cameras lose it: the newest truth there is stays the old one.
        for k in 0..40 {
            let mut s = snapshot(0.8 + 0.01 * f64::from(k));
            if let Some(t) = &mut s.truth {
                t.stamp = Stamp::from_seconds(0.79);
            }
            take.observe(&s, &in_use());
        }
        assert!(take.rested().is_err_and(|e| e.contains("must see")));
    }

    #[test]
    fn a_moving_arm_gives_no_pair() {
        let mut take = MocapTake::default();
        for k in 0..80 {
            let t_s = 0.01 * f64::from(k);
            let mut s = snapshot(t_s);
            if let Some(t) = &mut s.truth {
                t.base_from_tip = Pose::translation(5e-3 * t_s, 0.0, -0.3);
            }
            take.observe(&s, &in_use());
        }
        assert!(take.rested().is_err_and(|e| e.contains("moves")));
    }
}
