//! What is wrong: alarms, and SAFE when the data are too old, too wrong or too few.

use super::{
    BLIND, BLIND_FRAMES, LATE_OVER_S, Phase, SPRINGS_NEEDED, STALE_SAFE_S, STALE_WARN_S, Twin,
};
use crate::link::fault_words;
use crate::link::wire::fault;
use crate::signal::{Alarm, BOARDS, ChannelHealth, Severity, Stamp, spring_name};
use crate::twin::Event;

/// More than this share of the last second's frames lost puts the twin into SAFE.
const LOSS_SAFE: f64 = 0.1;
/// The boards get this long to act on a reset, s.
const RESET_ACTS_S: f64 = 0.5;
/// Frames within that second below which a share says little.
const LOSS_MIN_FRAMES: u64 = 50;

impl Twin {
    /// Alarms, and SAFE when the data are too old, too wrong or too few.
    pub(super) fn watch(&mut self, events: &mut Vec<Event>) {
        let mut alarms: Vec<(Severity, String)> = Vec::new();
        let age_s = self.last_frame.map(|t| self.now.since(t));
        let moving = matches!(self.phase, Phase::Hold | Phase::Moving { .. });
        match age_s {
            Some(age) if age > STALE_SAFE_S => {
                let text = format!(
                    "No data from the boards for {:.0} ms: check the cable and the boards' power.",
                    age * 1e3
                );
                if moving {
                    self.go_safe("no data from the boards for 100 ms", events);
                }
                alarms.push((Severity::Critical, text));
            }
            Some(age) if age > STALE_WARN_S => {
                alarms.push((
                    Severity::Warning,
                    format!("Data are {:.0} ms old.", age * 1e3),
                ));
            }
            Some(_) => {}
            None => alarms.push((Severity::Info, "Waiting for the first data.".to_owned())),
        }
        if let Some(late_s) = self.late_s()
            && late_s > STALE_WARN_S
        {
            let text = format!("Data come {:.0} ms late", late_s * 1e3);
            if moving && late_s > STALE_SAFE_S {
                self.go_safe(&text, events);
            }
            alarms.push((Severity::Warning, format!("{text}: check the cable.")));
        }
        let oldest = self.oldest_board();
        if let Some((board, age_s)) = oldest
            && age_s > STALE_SAFE_S
        {
            let text = format!("no data from board {} for 100 ms", board + 1);
            if moving {
                self.go_safe(&text, events);
            }
            let text = format!("There is {text}: check its cable and power.");
            alarms.push((Severity::Critical, text));
        } else if let Some((board, age_s)) = oldest
            && age_s > STALE_WARN_S
        {
            let text = format!("Data of board {} are {:.0} ms old.", board + 1, age_s * 1e3);
            alarms.push((Severity::Warning, text));
        }
        if self.bad_frames > 1 && moving {
            self.go_safe("the boards send values that make no sense", events);
        }
        let faults = self.raw.as_ref().map_or(0, |r| r.faults);
        if faults & fault::SAFE != 0 {
            let words = fault_words(faults & !fault::SAFE);
            if moving {
                self.go_safe(
                    &format!("the boards switched their pumps off: {words}"),
                    events,
                );
            } else if self
                .reset_at
                .is_none_or(|at| self.now.since(at) > RESET_ACTS_S)
            {
                // From before this twin was there, or from elsewhere.
                self.go_safe(&format!("the boards are latched: {words}"), events);
            }
        }
        if let Some(ratio) = self.loss_ratio()
            && ratio > LOSS_SAFE
        {
            let text = format!(
                "{:.0} % of the last second's frames were lost",
                ratio * 100.0
            );
            if moving {
                self.go_safe(&text, events);
            }
            alarms.push((Severity::Warning, format!("{text}: check the cable.")));
        }
        if let Some(sensors) = &self.sensors {
            let usable = sensors.health.springs_usable();
            for (i, h) in sensors.health.springs.iter().enumerate() {
                if *h != ChannelHealth::Ok {
                    alarms.push((
                        Severity::Warning,
                        format!("Spring {} ({}) is {}.", i + 1, spring_name(i), describe(*h)),
                    ));
                }
            }
            for (i, h) in sensors.health.imus.iter().enumerate() {
                if *h != ChannelHealth::Ok {
                    alarms.push((
                        Severity::Warning,
                        format!("IMU {} is {}.", i + 1, describe(*h)),
                    ));
                }
            }
            let over = sensors
                .chamber_pa
                .iter()
                .position(|p| *p > self.robot.over_pressure_pa);
            if usable < SPRINGS_NEEDED && moving {
                self.go_safe("too few springs give a reading", events);
            }
            if self.blind_frames > BLIND_FRAMES {
                if moving {
                    self.go_safe(BLIND, events);
                }
                alarms.push((Severity::Critical, format!("There are {BLIND}.")));
            }
            if let Some(i) = over
                && moving
            {
                self.go_safe(&format!("over-pressure in chamber {}", i + 1), events);
            }
        }
        if let Some(short) = self.short {
            let chamber = short.chamber + 1;
            let [has, wanted] = short.pa.map(|pa| pa * 1e-3);
            let text = format!(
                "Chamber {chamber} does not hold its pressure ({has:+.1} instead of {wanted:+.1} kPa): look for a leak \
                 in its line, and whether its supply runs."
            );
            if moving && short.unsafe_now {
                self.go_safe(
                    &format!("chamber {chamber} does not hold its pressure"),
                    events,
                );
            }
            alarms.push((Severity::Warning, text));
        }
        if let Phase::Safe(reason) = &self.phase {
            alarms.push((
                Severity::Critical,
                format!("SAFE: {reason}. Remove the cause, then press Reset."),
            ));
        }
        alarms.sort_by_key(|(severity, _)| std::cmp::Reverse(*severity));
        let since = |text: &str, old: &[Alarm], now: Stamp| {
            // Ages inside a text change; its first words do not.
            let key = |t: &str| t.chars().take_while(|c| !c.is_ascii_digit()).count().max(6);
            old.iter()
                .find(|a| a.text.get(..key(text)) == text.get(..key(text)))
                .map_or(now, |a| a.since)
        };
        self.alarms = alarms
            .into_iter()
            .map(|(severity, text)| Alarm {
                since: since(&text, &self.alarms, self.now),
                severity,
                text,
            })
            .collect();
    }

    /// How old frames are when they arrive, at least, s; `None` while too few have arrived to tell.
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

    /// Share of the last second's frames that were lost, if there were enough to tell.
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
        // A link that was opened anew counts from zero again.
        let lost = self.link.frames_lost.checked_sub(lost)?;
        // What is lost is counted per board, a frame has one part of each.
        let all = self.link.frames.checked_sub(frames)? * BOARDS as u64 + lost;
        (all >= LOSS_MIN_FRAMES).then(|| lost as f64 / all as f64)
    }

    pub(super) fn go_safe(&mut self, reason: &str, events: &mut Vec<Event>) {
        if self.is_safe() {
            return;
        }
        self.enter(Phase::Safe(reason.to_owned()), events);
        self.command = None;
        self.preview = None;
        self.check = None;
        self.paused = None;
    }
}

fn describe(health: ChannelHealth) -> &'static str {
    match health {
        ChannelHealth::Ok => "ok",
        ChannelHealth::Suspect => "in disagreement with the others",
        ChannelHealth::Stuck => "stuck",
        ChannelHealth::OutOfRange => "outside of its calibrated range",
        ChannelHealth::Missing => "not delivering",
    }
}
