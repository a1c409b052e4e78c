//! Compares the pumps with the mode, and lets the air out.

use super::air::{at_lengths_pa, lengths_m};
use super::pumps::*;
use super::state::{Phase, Twin};
use super::watch::Found;
use crate::link::Order;
use crate::link::wire::fault;
use crate::signal::{AlarmCause, BOARDS, CHAMBERS, Severity};
use crate::twin::command::Event;

impl Twin {
    /// Brings the chambers to 0 Pa, SAFE or not.
    pub(super) fn vent(&mut self, events: &mut Vec<Event>) {
        if self.link.stop_open {
            return self.refuse(
                "The emergency stop is pressed: release it, then vent.",
                events,
            );
        }
        let faults = self.raw.as_ref().map_or(0, |r| r.faults);
        if faults & fault::STOP_INPUT != 0 {
            return self.refuse(
                "The emergency stop was pressed: press Reset, then vent.",
                events,
            );
        }
        if matches!(self.phase, Phase::Moving { .. }) {
            return self.refuse("The arm moves: hold it first, then vent.", events);
        }
        if !self.is_safe() {
            self.disarm(events);
        }
        self.pumps.vent_at = Some(self.now);
        self.orders.push(Order::Vent);
    }

    pub(super) fn watch_pumps(&mut self, found: &mut Found, events: &mut Vec<Event>) {
        let is_on = matches!(self.phase, Phase::Hold | Phase::Moving { .. });
        let asked = self.pumps.vent_at.map(|at| self.now.since(at));
        let vents = self.link.venting || asked.is_some_and(|s| s < VENT_BEGINS_S);
        self.tell_of_venting(events);
        for board in 0..BOARDS {
            let differs = match self.link.pumps[board] {
                Some(true) => !is_on && !vents,
                Some(false) => is_on,
                None => false,
            };
            let since = &mut self.pumps.differ_since[board];
            *since = differs.then(|| since.unwrap_or(self.now));
            if since.is_none_or(|since| self.now.since(since) <= DIFFER_S) {
                continue;
            }
            let n = board + 1;
            if is_on {
                self.go_safe(&format!("the pumps of board {n} do not run"), events);
            } else {
                self.go_safe(
                    &format!("the pumps of board {n} run although disarmed"),
                    events,
                );
                self.cut_supply();
                found.push((Severity::Critical, AlarmCause::PumpsRun { board }));
            }
        }
        if is_on || vents {
            self.pumps.forget();
            self.pumps.has_cut &= !is_on;
        } else {
            self.watch_still_fed(found, events);
        }
        if self.link.stop_open {
            found.push((Severity::Critical, AlarmCause::EmergencyStop));
        }
    }

    fn watch_still_fed(&mut self, found: &mut Found, events: &mut Vec<Event>) {
        let Some(raw) = &self.raw else {
            return;
        };
        let length_m = lengths_m(&self.robot, &self.sensing.pads());
        let mut fed = Vec::new();
        for (chamber, least) in self.pumps.least.iter_mut().enumerate() {
            if !raw.has_chamber(chamber) {
                *least = None;
                continue;
            }
            let pa = raw.chamber_pa[chamber];
            let (least_pa, then_m) = *least.get_or_insert((pa.abs(), length_m[chamber]));
            // Who bends the arm by hand compresses the air that is in it.
            let same_pa = at_lengths_pa(pa, length_m[chamber], then_m);
            if pa.abs() < least_pa {
                *least = Some((pa.abs(), length_m[chamber]));
            } else if pa.abs().min(same_pa.abs()) > least_pa + STILL_FED_PA {
                fed.push((chamber, pa));
            }
        }
        for (chamber, measured_pa) in fed {
            self.go_safe("the supply is still on although the pumps are off", events);
            self.cut_supply();
            let cause = AlarmCause::StillFed {
                chamber,
                measured_pa,
            };
            found.push((Severity::Critical, cause));
        }
    }

    /// Opens the second output, once.
    fn cut_supply(&mut self) {
        if !std::mem::replace(&mut self.pumps.has_cut, true) {
            self.orders.push(Order::CutSupply);
        }
    }

    fn tell_of_venting(&mut self, events: &mut Vec<Event>) {
        let was = std::mem::replace(&mut self.pumps.is_venting, self.link.venting);
        let text = match (was, self.link.venting) {
            (false, true) => "Venting: the chambers are brought to 0 kPa.".to_owned(),
            (true, false) => {
                let pa = self.raw.as_ref().map_or([0.0; CHAMBERS], |r| r.chamber_pa);
                let most = (0..CHAMBERS).max_by(|i, k| pa[*i].abs().total_cmp(&pa[*k].abs()));
                let most = most.unwrap_or_default();
                let kpa = pa[most] * 1e-3;
                if pa[most].abs() > VENTED_PA {
                    return events.push(Event::Warning {
                        stamp: self.now,
                        text: format!(
                            "Not vented: chamber {} is still at {kpa:+.1} kPa. Vent again, or let its air out by hand.",
                            most + 1
                        ),
                    });
                }
                format!("Vented: no chamber is beyond {:.1} kPa.", kpa.abs())
            }
            _ => return,
        };
        events.push(Event::Notice {
            stamp: self.now,
            text,
        });
    }
}
