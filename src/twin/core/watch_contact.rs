//! Backs off from contact, and stops what goes the wrong way.

use nalgebra::Vector3;

use super::contact::*;
use super::state::{Phase, Twin};
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
        if let Some(name) = self.intrudes() {
            let text = format!("Holding: the arm is in the space that it keeps out of ({name}).");
            self.refuse(text, events);
            return self.hold(events);
        }
        // A chamber that has lost its air moves the tip, too: that has a check of its own.
        let (now, disturbs) = (self.now, !self.expects_pushes && !self.air.drifts());
        let limit_m_s = FAST * self.robot.tip_speed_max_m_s;
        if self.contact.is_faster(limit_m_s, stamp, &tip_m) && disturbs {
            return self.back_off("the tip is moved by something else", chamber_pa, events);
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
        if !on_path && way.norm() < THERE_M {
            self.contact.marks.clear();
            self.contact.progress = None;
        } else if let Some((why, before_pa)) = self.is_held_off(stamp, tip_m, chamber_pa, &target_m)
        {
            self.back_off(why, before_pa, events);
        }
    }

    /// Whether the tip stays behind what its pressures should make of it.
    fn is_held_off(
        &mut self,
        stamp: Stamp,
        tip_m: Vector3<f64>,
        chamber_pa: [f64; CHAMBERS],
        target_m: &Vector3<f64>,
    ) -> Option<HeldOff> {
        if self.expects_pushes {
            return None;
        }
        let newest = self.contact.marks.back();
        if newest.is_some_and(|m| stamp.since(m.stamp) < MARK_S - 1e-6) {
            return None;
        }
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
            watch.progress = Some(here);
        } else if stamp.since(from.stamp) >= STUCK_S
            && most(&chamber_pa, &from.chamber_pa) > PRESSED_PA
            && expected_m(&from, &here).dot(&way) > EXPECTED_M
        {
            return Some(("something holds the arm off", from.chamber_pa));
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

    /// How deep the arm is in each half-space that it keeps out of, m.
    fn depths_m(&self) -> impl Iterator<Item = f64> {
        let pads = self.sensing.pads().base_from_pad;
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
        let k = depths.position(|(depth_m, from_m)| depth_m > INTRUSION_M + from_m.max(0.0))?;
        Some(self.robot.keep_out[k].name.clone())
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

    /// The leg under way, the point that the tip is steered to (m), and whether it moves on along a path.
    fn steered_to(&self) -> Option<(usize, Vector3<f64>, bool)> {
        let Phase::Moving { routine, .. } = &self.phase else {
            return None;
        };
        let (target_m, on_path) = match routine.target()? {
            Target::Goal(goal, _) => (goal.position_m, false),
            Target::Along(_, via) => (via.position_m, true),
        };
        Some((routine.legs_done(), target_m.into(), on_path))
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
        self.hold(events);
        self.held_pa = Some(chamber_pa);
    }
}
