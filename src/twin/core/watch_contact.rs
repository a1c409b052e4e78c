//! Backs off from contact, and stops what goes the wrong way.

use std::collections::VecDeque;

use nalgebra::Vector3;

use super::contact::*;
use super::state::{Phase, Twin};
use crate::control::{SEGMENTS, judging_gains};
use crate::robot::KeepOut;
use crate::sensing::platform::pads_of_lengths;
use crate::signal::{CHAMBERS, Goal, Stamp};
use crate::task::Target;
use crate::twin::command::Event;

impl Twin {
    /// Motion goes on when the arm is pushed or held off, as in an experiment with disturbances.
    pub fn expect_pushes(&mut self) {
        self.expects_pushes = true;
    }

    /// Backs off and holds when the arm is held off or moved by something else, and goes SAFE when it goes the wrong
    /// way.
    pub(super) fn watch_contact(&mut self, events: &mut Vec<Event>) {
        if self.is_excited() {
            return self.watch_excitation(events);
        }
        let Some((leg, target_m, on_path)) = self.steered_to() else {
            self.contact = ContactWatch::default();
            return;
        };
        let Some((stamp, tip_m, chamber_pa)) = self.where_it_is() else {
            return;
        };
        if self.contact.leg != Some(leg) {
            self.contact = ContactWatch {
                leg: Some(leg),
                looks: std::mem::take(&mut self.contact.looks),
                known_m: self.contact.known_m,
                depth_m: match self.contact.leg {
                    Some(_) => std::mem::take(&mut self.contact.depth_m),
                    None => self.depths_m().collect(),
                },
                ..ContactWatch::default()
            };
        }
        self.note_depths();
        if self.hold_intruder(events) {
            return;
        }
        // A chamber that has lost its air moves the tip, too: that has a check of its own.
        let (now, disturbs) = (self.now, !self.expects_pushes && !self.air.drifts());
        let limit_m_s = FAST * self.robot.tip_speed_max_m_s;
        if self.contact.is_faster(limit_m_s, stamp, &tip_m) && disturbs {
            self.refuse("Holding: the tip is moved by something else.", events);
            return self.hold_at(chamber_pa, events);
        }
        let way = target_m - tip_m;
        let nearest_m = self.contact.nearest_m.get_or_insert(way.norm());
        *nearest_m = nearest_m.min(way.norm());
        let is_away = disturbs && way.norm() > *nearest_m + AWAY_M;
        if lasts(&mut self.contact.away_since, is_away, now, AWAY_S) {
            let text =
                "the tip goes away from its target: look at the hoses, and for what pushes it";
            return self.go_safe(text, events);
        }
        let is_there = !on_path && way.norm() < THERE_M;
        let held_off = self.is_held_off(stamp, tip_m, chamber_pa, &target_m, is_there);
        if let Some((why, before_pa)) = held_off {
            self.back_off(why, before_pa, events);
        }
    }

    /// Whether pressures are set that no controller computes: the arm has no target then.
    fn is_excited(&self) -> bool {
        match &self.phase {
            Phase::Moving { routine, .. } => {
                matches!(routine.target(), Some(Target::Pressures(_)))
            }
            _ => false,
        }
    }

    /// Holds an arm that comes into a space that it keeps out of.
    fn watch_excitation(&mut self, events: &mut Vec<Event>) {
        if self.contact.depth_m.is_empty() {
            self.contact.depth_m = self.depths_m().collect();
        }
        self.note_depths();
        self.hold_intruder(events);
    }

    /// Holds where the arm has entered a space that it keeps out of; whether it has.
    fn hold_intruder(&mut self, events: &mut Vec<Event>) -> bool {
        let Some(name) = self.intrudes() else {
            return false;
        };
        let text = format!("Holding: the arm is in the space that it keeps out of ({name}).");
        self.refuse(text, events);
        self.hold(events);
        true
    }

    /// Whether the tip stays behind what its pressures should make of it. One that `is_there` has nothing to make
    /// progress to, and is held off when its pressures go on changing by what should move it.
    fn is_held_off(
        &mut self,
        stamp: Stamp,
        tip_m: Vector3<f64>,
        chamber_pa: [f64; CHAMBERS],
        target_m: &Vector3<f64>,
        is_there: bool,
    ) -> Option<HeldOff> {
        if self.expects_pushes {
            return None;
        }
        self.contact.since_mark.add(&tip_m, &chamber_pa);
        let newest = self.contact.marks.back();
        if newest.is_some_and(|m| stamp.since(m.stamp) < MARK_S - 1e-6) {
            return None;
        }
        let (tip_m, chamber_pa) = self.contact.since_mark.take_mean()?;
        let m_per_signal = self.eval.as_ref()?.jacobian.fixed_rows::<3>(0).into_owned();
        let carried_kg = self.model.carried_kg(self.payload_kg);
        let here = Mark {
            stamp,
            tip_m,
            chamber_pa,
            signals: self.maps.plant.sensors(&chamber_pa, carried_kg).sensors,
        };
        let expected_m = |from: &Mark, to: &Mark| m_per_signal * (to.signals - from.signals);
        let watch = &mut self.contact;
        while let [first, second, ..] = watch.marks.make_contiguous() {
            if stamp.since(second.stamp) < WINDOW_S {
                break;
            }
            let expected_m = expected_m(first, second);
            let made_m = (second.tip_m - first.tip_m).dot(&direction(&expected_m));
            watch.known_m[0] += made_m;
            watch.known_m[1] += expected_m.norm();
            watch.marks.pop_front();
        }
        watch.marks.push_back(here);
        let from = *watch.progress.get_or_insert(here);
        let way = direction(&(target_m - from.tip_m));
        if (tip_m - from.tip_m).dot(&way) >= PROGRESS_M {
            watch.before = watch.progress.replace(here);
        } else if stamp.since(from.stamp) >= STUCK_S
            && most(&chamber_pa, &from.chamber_pa) > PRESSED_PA
            && expected_m(&from, &here).dot(&way) > EXPECTED_M
        {
            let free = watch.before.unwrap_or(from);
            return Some(("something holds the arm off", free.chamber_pa));
        }
        if is_there {
            watch.marks = VecDeque::from([here]);
            watch.low_since = None;
            // What rubber does in minutes takes pressure, too.
            if stamp.since(from.stamp) >= THERE_S {
                watch.before = watch.progress.replace(here);
            }
            return None;
        }
        let usual = watch.usual_share(stamp, expected_m)?;
        let enough = |m: &&Mark| expected_m(m, &here).norm() * usual >= WINDOW_M;
        let Some(from) = watch.marks.iter().rev().find(enough) else {
            watch.low_since = None;
            return None;
        };
        let expected_m = expected_m(from, &here);
        let made_m = (tip_m - from.tip_m).dot(&direction(&expected_m));
        let is_low = made_m < SHARE * usual * expected_m.norm();
        let before_pa = watch.while_free(usual, m_per_signal);
        lasts(&mut watch.low_since, is_low, stamp, HELD_OFF_S).then_some((
            "the arm moves much less than its pressures did before",
            before_pa?,
        ))
    }

    /// The pressures with which the tip still made progress, if they have changed since by what should have moved it: what
    /// the controller takes for the end of its reach may be something in the way, Pa.
    pub(super) fn pressed_from(&self) -> Option<[f64; CHAMBERS]> {
        if self.expects_pushes {
            return None;
        }
        let (_, target_m, _) = self.steered_to()?;
        let (_, tip_m, chamber_pa) = self.where_it_is()?;
        let from = self.contact.progress?;
        let m_per_signal = self.eval.as_ref()?.jacobian.fixed_rows::<3>(0).into_owned();
        let carried_kg = self.model.carried_kg(self.payload_kg);
        let signals = self.maps.plant.sensors(&chamber_pa, carried_kg).sensors;
        let way = direction(&(target_m - from.tip_m));
        let expected_m = (m_per_signal * (signals - from.signals)).dot(&way);
        let made_m = (tip_m - from.tip_m).dot(&way);
        let free = self.contact.before.unwrap_or(from);
        (expected_m > PROGRESS_M && made_m < SHARE * expected_m).then_some(free.chamber_pa)
    }

    /// How deep the arm is in each half-space that it keeps out of, m.
    fn depths_m(&self) -> impl Iterator<Item = f64> {
        let pads = self.sensing.pads();
        let middle_m = pads[0].translation.vector;
        let tip = self.estimate.as_ref().map(|e| e.base_from_tip);
        let tip_m = tip.unwrap_or(pads[1]).translation.vector;
        let spaces = self.robot.keep_out.iter();
        spaces.map(move |k| k.depth_m(&middle_m).max(k.depth_m(&tip_m)))
    }

    /// The half-space that the arm has entered, if it has.
    fn intrudes(&self) -> Option<String> {
        let set_out = self.contact.depth_m.iter();
        let mut depths = self.depths_m().zip(set_out);
        let k =
            depths.position(|(depth_m, from_m)| depth_m > INTRUSION_M.max(from_m + DEEPER_M))?;
        Some(self.robot.keep_out[k].name.clone())
    }

    /// An arm that has come out of a half-space does not go back in as far as it was.
    fn note_depths(&mut self) {
        let depths_m: Vec<f64> = self.depths_m().collect();
        for (from_m, now_m) in self.contact.depth_m.iter_mut().zip(depths_m) {
            *from_m = from_m.min(now_m);
        }
    }

    /// Why a goal is refused: the arm would enter a space that it keeps out of.
    pub(super) fn kept_out(&self, goal: &Goal) -> Option<String> {
        let at_m = goal.position_m.into();
        let space = self
            .robot
            .keep_out
            .iter()
            .find(|k| k.depth_m(&at_m) > 0.0)?;
        Some(format!(
            "The target is {:.0} mm inside the space that the arm keeps out of ({}): choose one outside.",
            space.depth_m(&at_m) * 1e3,
            space.name
        ))
    }

    /// Why the way to pressures that reach a goal is refused: the middle or the end pad would pass through a space that
    /// the arm keeps out of. The pressures are taken to change together, from those of the stop before, or the present
    /// ones.
    pub(super) fn way_is_kept_out(
        &self,
        from_pa: Option<[f64; CHAMBERS]>,
        to_pa: &[f64; CHAMBERS],
        held_kg: f64,
    ) -> Option<String> {
        if self.robot.keep_out.is_empty() {
            return None;
        }
        let from_pa = from_pa.or_else(|| self.sensors.as_ref().map(|s| s.chamber_pa))?;
        let carried_kg = self.model.carried_kg(held_kg);
        let gains = judging_gains(self.controller.plant_gains());
        let pads_m = |share: f64| {
            let alike_pa = std::array::from_fn(|i| {
                (from_pa[i] + share * (to_pa[i] - from_pa[i])) * gains[i * SEGMENTS / CHAMBERS]
            });
            let signals = self.maps.plant.sensors(&alike_pa, carried_kg).sensors;
            let pads = pads_of_lengths(&self.robot, &std::array::from_fn(|i| signals[i]));
            pads.map(|pad| pad.translation.vector)
        };
        let depth_m = |space: &KeepOut, at_m: &[Vector3<f64>; 2]| {
            space.depth_m(&at_m[0]).max(space.depth_m(&at_m[1]))
        };
        let first_m = pads_m(0.0);
        (1..=WAY_SAMPLES).find_map(|k| {
            let at_m = pads_m(f64::from(k) / f64::from(WAY_SAMPLES));
            self.robot.keep_out.iter().find_map(|space| {
                let deep_m = depth_m(space, &at_m);
                // An arm that is inside may come out.
                let limit_m = INTRUSION_M.max(depth_m(space, &first_m) + DEEPER_M);
                (deep_m > limit_m).then(|| {
                    format!(
                        "The way there leads {:.0} mm into the space that the arm keeps out of ({}): choose another, or \
                         go there in steps.",
                        deep_m * 1e3,
                        space.name
                    )
                })
            })
        })
    }

    /// The leg under way, where the tip shall be (m) while the end pad is turned as it is, and whether that moves on along a path.
    fn steered_to(&self) -> Option<(usize, Vector3<f64>, bool)> {
        let Phase::Moving { routine, .. } = &self.phase else {
            return None;
        };
        let (target_m, on_path) = match routine.target()? {
            Target::Goal(goal, _) => {
                let turned = self.estimate.as_ref()?.base_from_tip.rotation;
                let at_m = Vector3::from(goal.position_m) - goal.arm_m(&turned);
                (at_m, false)
            }
            Target::Along(_, via) => (via.position_m.into(), true),
            Target::Pressures(_) => return None,
        };
        Some((routine.legs_done(), target_m, on_path))
    }

    fn where_it_is(&self) -> Option<(Stamp, Vector3<f64>, [f64; CHAMBERS])> {
        let (estimate, sensors) = (self.estimate.as_ref()?, self.sensors.as_ref()?);
        let tip_m = estimate.base_from_tip.translation.vector;
        Some((estimate.stamp, tip_m, sensors.chamber_pa))
    }

    /// Goes back to these pressures and holds them.
    fn back_off(&mut self, why: &str, chamber_pa: [f64; CHAMBERS], events: &mut Vec<Event>) {
        let text = format!("Holding: {why}. The pressures went back to where it was free.");
        self.refuse(text, events);
        self.hold_at(chamber_pa, events);
    }

    fn hold_at(&mut self, chamber_pa: [f64; CHAMBERS], events: &mut Vec<Event>) {
        self.hold(events);
        self.held_pa = Some(chamber_pa);
    }
}
