//! Motion capture: pairs of the robot's pose and the seen one while the arm rests. No window in here.

use std::collections::VecDeque;

use nalgebra::UnitQuaternion;

use crate::sensing::registration::{
    FitOptions, FrameFit, ObjectFrame, PosePair, Registration, RegistrationError, digest, register,
};
use crate::signal::{Pose, Snapshot, Stamp};

/// The arm must have rested for so long, s.
const REST_S: f64 = 0.5;
/// It rests when the seen pose moves more slowly than this, m/s and rad/s.
const REST_M_S: f64 = 1.5e-3;
const REST_RAD_S: f64 = 1.0 * std::f64::consts::PI / 180.0;
/// A pose is captured by itself when it is so far from all others, m or rad.
const APART_M: f64 = 12e-3;
const APART_RAD: f64 = 4.0 * std::f64::consts::PI / 180.0;
/// Most pairs kept.
const PAIRS_MAX: usize = 60;

/// The pairs and what they give.
#[derive(Clone, Debug, Default)]
pub struct ViconTake {
    pairs: Vec<PosePair>,
    window: VecDeque<(Stamp, Pose, Pose)>,
    fit: Option<Result<FrameFit, RegistrationError>>,
    object_is_pad: bool,
    /// Whether poses are captured by themselves when the arm rests.
    pub automatic: bool,
}

impl ViconTake {
    /// The pairs captured.
    pub fn pairs(&self) -> &[PosePair] {
        &self.pairs
    }

    /// What they give, once there are any.
    pub fn fit(&self) -> Option<&Result<FrameFit, RegistrationError>> {
        self.fit.as_ref()
    }

    /// The registration for the file: chained to the one that the poses went through already, if one did.
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

    /// The mean pose of the last moments, if the arm rested; else why not.
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
        let rows = || self.window.range(range.clone());
        let n = rows().count().max(1) as f64;
        let of = |pick: fn(&(Stamp, Pose, Pose)) -> &Pose| {
            let sum: nalgebra::Vector3<f64> = rows().map(|r| pick(r).translation.vector).sum();
            let Some(first) = rows().next().map(|r| pick(r).rotation) else {
                return Pose::identity();
            };
            let off: nalgebra::Vector3<f64> = rows()
                .map(|r| (pick(r).rotation * first.inverse()).scaled_axis())
                .sum();
            Pose::from_parts(
                (sum / n).into(),
                UnitQuaternion::from_scaled_axis(off / n) * first,
            )
        };
        (of(|r| &r.1), of(|r| &r.2))
    }

    /// Takes in a live snapshot.
    pub fn observe(&mut self, snapshot: &Snapshot) {
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

    /// Keeps a pair.
    pub fn add(&mut self, pair: PosePair) {
        if self.pairs.len() < PAIRS_MAX {
            self.pairs.push(pair);
            self.refit();
        }
    }

    /// Takes a pair out again.
    pub fn remove(&mut self, i: usize) {
        if i < self.pairs.len() {
            self.pairs.remove(i);
            self.refit();
        }
    }

    /// Whether the tracked object is taken to be the end pad's own frame.
    pub fn object_is_pad(&self) -> bool {
        self.object_is_pad
    }

    /// Takes the tracked object to be the end pad's own frame, or fits where it is.
    pub fn set_object_is_pad(&mut self, known: bool) {
        self.object_is_pad = known;
        self.refit();
    }

    fn refit(&mut self) {
        let options = FitOptions {
            object: match self.object_is_pad {
                true => ObjectFrame::Known(Pose::identity()),
                false => ObjectFrame::Unknown,
            },
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
    use crate::gui::fixture;
    use crate::signal::pose_from_ypr;

    // Seven poses per radius about the middle, each tilted its own way.
    fn pose(k: usize) -> Pose {
        let a = k as f64 * 0.9;
        pose_from_ypr(
            [0.05 * a.cos(), 0.05 * a.sin(), -0.3 + 0.004 * k as f64],
            [0.1 * a.sin(), 0.3 * a.sin(), 0.3 * a.cos()],
        )
    }

    fn rest_at(take: &mut ViconTake, from_s: f64, at: &Pose, seen: &Pose) {
        for k in 0..80 {
            let mut s = fixture::snapshot(from_s + 0.01 * f64::from(k));
            if let Some(e) = &mut s.estimate {
                e.base_from_tip = *at;
            }
            if let Some(t) = &mut s.truth {
                t.base_from_tip = *seen;
            }
            take.observe(&s);
        }
    }

    #[test]
    fn poses_are_captured_at_rest_once_each_and_give_the_frames_back() {
        let x = pose_from_ypr([0.4, -0.2, 1.1], [0.7, 0.1, -0.2]);
        let y = pose_from_ypr([0.01, 0.0, 0.02], [0.3, 0.0, 0.0]);
        let mut take = ViconTake {
            automatic: true,
            ..ViconTake::default()
        };
        for k in 0..12 {
            let at = pose(k);
            let seen = x.inverse() * at * y.inverse();
            rest_at(&mut take, k as f64, &at, &seen);
        }
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
        let mut take = ViconTake::default();
        let at = pose(0);
        rest_at(&mut take, 0.0, &at, &at);
        assert!(take.rested().is_ok());
        // The cameras lose it: the newest truth there is stays the old one.
        for k in 0..40 {
            let mut s = fixture::snapshot(0.8 + 0.01 * f64::from(k));
            if let Some(t) = &mut s.truth {
                t.stamp = Stamp::from_seconds(0.79);
            }
            take.observe(&s);
        }
        assert!(take.rested().is_err_and(|e| e.contains("must see")));
    }

    #[test]
    fn a_moving_arm_gives_no_pair() {
        let mut take = ViconTake::default();
        for k in 0..80 {
            let t_s = 0.01 * f64::from(k);
            let mut s = fixture::snapshot(t_s);
            if let Some(t) = &mut s.truth {
                t.base_from_tip = Pose::translation(5e-3 * t_s, 0.0, -0.3);
            }
            take.observe(&s);
        }
        assert!(take.rested().is_err_and(|e| e.contains("moves")));
    }
}
