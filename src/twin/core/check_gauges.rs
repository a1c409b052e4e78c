//! The check of gauges and chambers when hardware is armed.

use nalgebra::SVector;

use super::arming::*;
use super::state::{Phase, Twin};
use crate::signal::{CHAMBERS, SIGNALS, SPRINGS, Stamp};
use crate::twin::command::Event;

impl Twin {
    /// Begins to check gauges and chambers of an arm that has just been armed.
    pub(super) fn check_gauges(&mut self) {
        let Some(sensors) = &self.sensors else {
            return;
        };
        self.arming.is_checked = false;
        self.arming.check = Some(GaugeCheck {
            from_pa: self.held_pa.unwrap_or(sensors.chamber_pa),
            step_pa: match self.arming.is_proved {
                true => GAUGE_STEP_PA,
                false => FIRST_STEP_PA,
            },
            chamber: 0,
            since: self.now,
            from_signals: sensors.sensors.to_vector(),
            followed: None,
            returns_from: None,
            returned: None,
        });
    }

    /// Goes on with the check.
    pub(super) fn go_on_checking_gauges(&mut self, events: &mut Vec<Event>) {
        if !matches!(self.phase, Phase::Hold) {
            self.arming.give_up();
        }
        let now = self.now;
        let (Some(check), Some(sensors)) = (&self.arming.check, &self.sensors) else {
            return;
        };
        let (i, wanted_pa) = (check.chamber, check.signed_pa());
        let moved_pa: [f64; CHAMBERS] =
            std::array::from_fn(|k| sensors.chamber_pa[k] - check.from_pa[k]);
        let share = moved_pa[i] / wanted_pa;
        let other = (0..CHAMBERS)
            .filter(|k| *k != i && sensors.health.chambers[*k].usable())
            .find(|k| moved_pa[*k].abs() > OTHERS * check.step_pa);
        let signals = sensors.sensors.to_vector();
        let trouble = match (check.followed, other) {
            (_, Some(other)) if check.returns_from.is_none() => Some(format!(
                "gauge {} follows chamber {}: look at its wire and hose",
                other + 1,
                i + 1
            )),
            (None, None) if now.since(check.since) > FOLLOWS_S => Some(format!(
                "gauge {} shows {:+.1} kPa of {:+.1} kPa after {FOLLOWS_S:.0} s: look at its wire and hose",
                i + 1,
                moved_pa[i] * 1e-3,
                wanted_pa * 1e-3
            )),
            (Some(_), _)
                if check.returns_from.is_some()
                    && check.returned.is_none()
                    && share > BACK
                    && now.since(check.since) > FOLLOWS_S =>
            {
                Some(format!(
                    "chamber {} does not come back: gauge {} still shows {:+.1} kPa after {FOLLOWS_S:.0} s; look at its \
                     regulator and hose",
                    i + 1,
                    i + 1,
                    moved_pa[i] * 1e-3
                ))
            }
            _ if !self.arming.is_proved
                && check.returned.is_some_and(|at| now.since(at) >= SHAPE_S)
                && !self.moves_as_expected(check, &signals) =>
            {
                Some(format!(
                    "chamber {} moves the arm otherwise than this calibration and plant map predict: look at the hoses, the \
                     springs' plugs and the calibration",
                    i + 1
                ))
            }
            _ => None,
        };
        if let Some(trouble) = trouble {
            self.refuse(format!("Not armed: {trouble}."), events);
            return self.disarm(events);
        }
        let is_proved = self.arming.is_proved;
        let Some(check) = &mut self.arming.check else {
            return;
        };
        if check.followed.is_none() && share > FOLLOWS {
            check.followed = Some(now);
        }
        let rests = |at: Stamp| is_proved || now.since(at) >= SHAPE_S;
        if check.returns_from.is_none() && check.followed.is_some_and(rests) {
            check.returns_from = Some(signals);
            check.since = now;
        }
        if check.returns_from.is_some() && check.returned.is_none() && share < BACK {
            check.returned = Some(now);
        }
        if check.returned.is_some_and(rests) {
            check.chamber += 1;
            check.since = now;
            check.from_signals = signals;
            check.followed = None;
            check.returns_from = None;
            check.returned = None;
            if check.chamber == CHAMBERS {
                self.arming.pass();
                events.push(Event::Notice {
                    stamp: now,
                    text: "Armed: all six gauges follow their chambers.".to_owned(),
                });
            }
        }
    }

    /// Whether the springs have changed as the plant map expects of the chamber, there and back: what else goes on
    /// steadily meanwhile, an arm that creeps back from where it was, is not in that.
    fn moves_as_expected(&self, check: &GaugeCheck, signals: &SVector<f64, SIGNALS>) -> bool {
        let Some(far) = check.returns_from else {
            return true;
        };
        let carried_kg = self.model.carried_kg(self.payload_kg);
        let plant = self.maps.plant.sensors(&check.from_pa, carried_kg);
        let expected = plant.jacobian.column(check.chamber) * check.signed_pa();
        let seen = far - 0.5 * (check.from_signals + signals);
        let [expected, seen] = [expected, seen].map(|v| v.fixed_rows::<SPRINGS>(0).into_owned());
        expected.dot(&seen) > ALIKE * expected.norm() * seen.norm()
    }
}
