//! What is wrong: alarms, and SAFE when the data are too old, too wrong or too few.

use std::cmp::Reverse;

use super::air::Short;
use super::state::{BLIND_FRAMES, LATE_OVER_S, Phase, REMEDY, STALE_SAFE_S, STALE_WARN_S, Twin};
use crate::link::wire::fault;
use crate::link::{Order, fault_words};
use crate::signal::{
    Alarm, AlarmCause, AlarmKey, BOARDS, CHAMBERS, IMUS, SPRINGS, Severity, Stamp, TOO_FEW_SENSORS,
};
use crate::twin::command::Event;

/// The same after this computer was busy.
pub(super) const REMEDY_BUSY: &str = "Close other programs";
/// The same when boards are silent.
const REMEDY_BOARDS: &str = "Check their power and the USB cable";
/// The same when a virtual rig in a process of its own is silent.
const REMEDY_RIG: &str = "Close other programs, or choose the virtual rig that runs in this one";
/// More than this of a second makes a busy computer the cause of what was lost in it, s.
const BUSY_S: f64 = 0.1;
/// More than this share of the last second's frames lost puts the twin into SAFE.
pub(super) const LOSS_SAFE: f64 = 0.1;
/// A tick without admissible rates is alarmed for so long, s.
pub(super) const UNSOLVED_S: f64 = 2.0;
/// The boards get this long to act on a reset, s.
const RESET_ACTS_S: f64 = 0.5;
/// Frames within that second below which a share means little.
const LOSS_MIN_FRAMES: u64 = 50;

/// Alarms that hold now, before it is known since when.
pub(super) type Found = Vec<(Severity, AlarmCause)>;

impl Twin {
    /// Alarms, and SAFE when the data are too old, too wrong or too few.
    pub(super) fn watch(&mut self, events: &mut Vec<Event>) {
        let mut found = Found::new();
        let moving = matches!(self.phase, Phase::Hold | Phase::Moving { .. });
        self.watch_age(moving, &mut found, events);
        self.watch_boards(moving, &mut found, events);
        self.watch_sensors(moving, &mut found, events);
        self.watch_pressure(moving, &mut found, events);
        self.watch_pumps(&mut found, events);
        self.watch_contact(events);
        self.go_on_checking_gauges(events);
        if self.expects_pushes && !self.link.practice {
            found.push((Severity::Warning, AlarmCause::ContactIgnored));
        }
        if moving
            && self
                .unsolved_at
                .is_some_and(|at| self.now.since(at) < UNSOLVED_S)
        {
            let ticks = self.controller.unsolved_ticks();
            found.push((Severity::Warning, AlarmCause::Unsolved { ticks }));
        }
        if let Phase::Safe(reason) = &self.phase {
            let (reason, remedy) = (reason.clone(), self.remedy);
            found.push((Severity::Critical, AlarmCause::Safe { reason, remedy }));
        }
        found.sort_by_key(|(severity, _)| Reverse(*severity));
        self.alarms = found
            .into_iter()
            .map(|(severity, cause)| Alarm {
                since: self.since(cause.key()),
                severity,
                cause,
            })
            .collect();
    }

    /// Since when the alarm of this identity has held: from now on if it is new.
    fn since(&self, key: AlarmKey) -> Stamp {
        let known = self.alarms.iter().find(|a| a.key() == key);
        known.map_or(self.now, |a| a.since)
    }

    fn watch_age(&mut self, moving: bool, found: &mut Found, events: &mut Vec<Event>) {
        match self.last_frame.map(|t| self.now.since(t)) {
            Some(age_s) if age_s > STALE_SAFE_S => {
                let busy_s = self.busy_while_silent_s(age_s);
                if moving {
                    let (reason, remedy) = self.why_stale(busy_s);
                    self.go_safe_for(&reason, remedy, events);
                }
                found.push((Severity::Critical, AlarmCause::DataOld { age_s, busy_s }));
            }
            Some(age_s) if age_s > STALE_WARN_S => {
                let busy_s = self.busy_while_silent_s(age_s);
                found.push((Severity::Warning, AlarmCause::DataOld { age_s, busy_s }));
            }
            Some(_) => {}
            None => found.push((Severity::Info, AlarmCause::NoDataYet)),
        }
        if let Some(late_s) = self.late_s()
            && late_s > STALE_WARN_S
        {
            if moving && late_s > STALE_SAFE_S {
                let text = format!("Data come {:.0} ms late", late_s * 1e3);
                self.go_safe(&text, events);
            }
            found.push((Severity::Warning, AlarmCause::DataLate { late_s }));
        }
    }

    fn watch_boards(&mut self, moving: bool, found: &mut Found, events: &mut Vec<Event>) {
        if let Some((board, age_s)) = self.oldest_board()
            && age_s > STALE_WARN_S
        {
            let severity = if age_s > STALE_SAFE_S {
                if moving {
                    let text = format!("no data from board {} for 100 ms", board + 1);
                    self.go_safe(&text, events);
                }
                Severity::Critical
            } else {
                Severity::Warning
            };
            found.push((severity, AlarmCause::BoardOld { board, age_s }));
        }
        if self.bad_frames > 1 && moving {
            self.go_safe("the boards send values that make no sense", events);
        }
        let faults = self.raw.as_ref().map_or(0, |r| r.faults);
        if faults & fault::SAFE != 0 {
            let words = fault_words(faults & !fault::SAFE);
            let busy_s = self
                .busy_s()
                .filter(|_| faults & fault::HEARTBEAT_LOST != 0);
            if moving && let Some(busy_s) = busy_s {
                let reason = format!(
                    "{}, so the boards switched their pumps off",
                    busy_for(busy_s)
                );
                self.go_safe_for(&reason, REMEDY_BUSY, events);
            } else if moving {
                self.go_safe(
                    &format!("the boards switched their pumps off: {words}"),
                    events,
                );
            } else if faults & fault::LATCHING == fault::SAFE | fault::BOOTED
                && self.link.practice
                && !self.has_greeted
            {
                // A virtual rig that this program has just made: nobody has to look at it first.
                self.has_greeted = true;
                self.reset(events);
            } else if self
                .reset_at
                .is_none_or(|at| self.now.since(at) > RESET_ACTS_S)
            {
                // From before this twin was there, or from elsewhere: the causes stay as the boards report them, one
                // board after the other.
                self.latched |= faults & !fault::SAFE;
                let reason = format!("the boards are latched: {}", fault_words(self.latched));
                match &mut self.phase {
                    Phase::Safe(known) if known.starts_with("the boards are latched") => {
                        *known = reason
                    }
                    _ => self.enter_safe(&reason, REMEDY, events),
                }
            }
        }
        if let Some(ratio) = self.loss_ratio()
            && ratio > LOSS_SAFE
        {
            let busy_s = self.busy_s();
            if moving {
                let text = format!(
                    "{:.0} % of the last second's frames were lost",
                    ratio * 100.0
                );
                match busy_s {
                    Some(busy_s) => {
                        let reason = format!("{}, so {text}", busy_for(busy_s));
                        self.go_safe_for(&reason, REMEDY_BUSY, events);
                    }
                    None => self.go_safe(&text, events),
                }
            }
            found.push((Severity::Warning, AlarmCause::FramesLost { ratio, busy_s }));
        }
    }

    fn watch_sensors(&mut self, moving: bool, found: &mut Found, events: &mut Vec<Event>) {
        let Some(frame) = &self.sensors else {
            return;
        };
        let segment_of_imu = self.robot.pad_of_imu();
        let springs = (0..SPRINGS).map(|i| (i, frame.spring_evidence(i)));
        for (spring, evidence) in springs.filter(|(_, e)| e.is_abnormal()) {
            let cause = AlarmCause::Spring { spring, evidence };
            found.push((Severity::Warning, cause));
        }
        let imus = (0..IMUS).map(|i| (i, frame.imu_evidence(i)));
        for (imu, evidence) in imus.filter(|(_, e)| e.is_abnormal()) {
            found.push((Severity::Warning, AlarmCause::Imu { imu, evidence }));
        }
        for segment in 0..frame.quality.segment_suspect.len() {
            if let Some(suspects) = frame.quality.suspects(segment, segment_of_imu) {
                let cause = AlarmCause::SegmentSuspect { segment, suspects };
                found.push((Severity::Warning, cause));
            }
        }
        if let Some(need) = frame.quality.need {
            found.push((Severity::Info, AlarmCause::PoseUnknown { need }));
        }
        if self.blind_frames > BLIND_FRAMES {
            if moving {
                self.go_safe(TOO_FEW_SENSORS, events);
            }
            // Without a clock there is no length yet.
            if self.clocks_are_known() {
                found.push((Severity::Critical, AlarmCause::TooFewSensors));
            }
        }
    }

    fn watch_pressure(&mut self, moving: bool, found: &mut Found, events: &mut Vec<Event>) {
        let over: Vec<(usize, f64)> = self.over_pressures().collect();
        for (chamber, measured_pa) in over {
            if moving {
                let kpa = measured_pa * 1e-3;
                let text = format!("over-pressure in chamber {} ({kpa:+.1} kPa)", chamber + 1);
                self.go_safe(&text, events);
            }
            let cause = AlarmCause::OverPressure {
                chamber,
                measured_pa,
                limit_pa: self.robot.over_pressure_pa,
            };
            found.push((Severity::Critical, cause));
        }
        if moving && let Some(Short { chamber, pa, .. }) = self.air.adrift() {
            let [measured, set] = pa.map(|pa| pa * 1e-3);
            let text = format!(
                "chamber {} is at {measured:+.1} kPa instead of {set:+.1} and does not follow: look at its hose",
                chamber + 1
            );
            self.go_safe(&text, events);
        }
        if let Some(short) = self.short {
            if moving && short.unsafe_now {
                let text = format!("chamber {} does not hold its pressure", short.chamber + 1);
                self.go_safe(&text, events);
            }
            let [measured_pa, set_pa] = short.pa;
            let cause = AlarmCause::ShortOfAir {
                chamber: short.chamber,
                measured_pa,
                set_pa,
            };
            found.push((Severity::Warning, cause));
        }
    }

    /// Chambers (0-based) beyond the over-pressure limit with their gauge pressures, Pa. By what the boards
    /// delivered, also where the sensing does not use the gauge: a reading that far off stops the arm, whether the
    /// chamber or the gauge is at fault.
    pub(super) fn over_pressures(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        let raw = self.raw.iter();
        raw.flat_map(|raw| (0..CHAMBERS).map(move |i| (raw.has_chamber(i), i, raw.chamber_pa[i])))
            .filter(|(delivered, _, pa)| *delivered && self.robot.is_over_pressure(*pa))
            .map(|(_, i, pa)| (i, pa))
    }

    /// How long the program was not run in the last second, s, if that explains what is missing of it.
    pub(super) fn busy_s(&self) -> Option<f64> {
        let busy_s = self.delays.within_s(self.now.plus(-1.0), self.now);
        (busy_s > BUSY_S).then_some(busy_s)
    }

    /// How long the program was not run since data came last, `age_s` ago, if that is why none has come.
    fn busy_while_silent_s(&self, age_s: f64) -> Option<f64> {
        let not_run_s = self.delays.within_s(self.now.plus(-age_s), self.now);
        // Had the boards sent, something would have come in the time that is left.
        (age_s - not_run_s < STALE_WARN_S && 2.0 * not_run_s > age_s).then_some(not_run_s)
    }

    /// Why data have been missing for too long, and what to do about it.
    fn why_stale(&self, busy_s: Option<f64>) -> (String, &'static str) {
        if let Some(busy_s) = busy_s {
            let text = format!("{}, so the boards' data came too late", busy_for(busy_s));
            return (text, REMEDY_BUSY);
        }
        let (who, remedy) = match self.link.practice {
            true => ("the virtual rig", REMEDY_RIG),
            false => ("the boards", REMEDY_BOARDS),
        };
        let text = format!("no data from {who} for 100 ms although this program was running");
        (text, remedy)
    }

    /// How old frames are when they arrive, at least, s; `None` while too few have arrived.
    fn late_s(&mut self) -> Option<f64> {
        let (now, late) = (self.now, &mut self.lateness_s);
        while late.front().is_some_and(|l| now.since(l.0) > LATE_OVER_S) {
            late.pop_front();
        }
        let oldest = late.front()?.0;
        let least_s = late.iter().map(|l| l.1).fold(f64::MAX, f64::min);
        (now.since(oldest) > 0.8 * LATE_OVER_S).then_some(least_s)
    }

    /// The board whose newest sample is the oldest, and how old it was in the newest frame, s.
    fn oldest_board(&self) -> Option<(usize, f64)> {
        let ages_s = self.raw.as_ref()?.board_age_s;
        let boards = ages_s.into_iter().enumerate();
        boards.max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Share of the last second's frames that were lost, if there were enough.
    fn loss_ratio(&mut self) -> Option<f64> {
        self.traffic
            .push_back((self.now, self.link.frames, self.link.frames_lost));
        while self
            .traffic
            .front()
            .is_some_and(|t| self.now.since(t.0) > 1.0)
        {
            self.traffic.pop_front();
        }
        let (_, frames, lost) = *self.traffic.front()?;
        // A link that was opened again counts from zero again.
        let lost = self.link.frames_lost.checked_sub(lost)?;
        // What is lost is counted per board, a frame has one part of each.
        let all = self.link.frames.checked_sub(frames)? * BOARDS as u64 + lost;
        (all >= LOSS_MIN_FRAMES).then(|| lost as f64 / all as f64)
    }

    /// Leaves SAFE.
    pub(super) fn reset(&mut self, events: &mut Vec<Event>) {
        self.reset_at = Some(self.now);
        self.latched = 0;
        self.pumps.forget();
        // The boards open the supply again.
        self.pumps.has_cut = false;
        self.orders.push(Order::Reset);
        if self.is_safe() {
            self.enter(Phase::Disarmed, events);
        }
    }

    pub(super) fn go_safe(&mut self, reason: &str, events: &mut Vec<Event>) {
        self.go_safe_for(reason, REMEDY, events);
    }

    pub(super) fn go_safe_for(
        &mut self,
        reason: &str,
        remedy: &'static str,
        events: &mut Vec<Event>,
    ) {
        if !self.is_safe() {
            self.orders.push(Order::Stop);
            self.enter_safe(reason, remedy, events);
        }
    }

    fn enter_safe(&mut self, reason: &str, remedy: &'static str, events: &mut Vec<Event>) {
        if self.is_safe() {
            return;
        }
        self.enter(Phase::Safe(reason.to_owned()), events);
        self.remedy = remedy;
        self.command = None;
        self.preview = None;
        self.check = None;
        self.paused = None;
    }
}

/// Message about a computer that did not run this program for `busy_s` of the last second.
pub(super) fn busy_for(busy_s: f64) -> String {
    if busy_s > 0.99 {
        return "this computer was busy for a second or more".to_owned();
    }
    format!("this computer was busy for {:.0} ms", busy_s * 1e3)
}
