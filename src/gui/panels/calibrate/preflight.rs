//! Preflight: whether everything is there.

use egui::Ui;

use super::wizard::Wizard;
use super::{CalibrateState, save};
use crate::gui::panels::View;
use crate::gui::panels::sensors::card;
use crate::gui::panels::shell::age;
use crate::gui::panels::widgets::{Gate, note, number, status};
use crate::gui::services::Services;
use crate::gui::theme::Level;
use crate::signal::{BOARDS, CHAMBERS, IMUS, Mode, SPRINGS, Snapshot};

/// Boards slower than this do not deliver what the filters are laid out for, Hz.
const RATE_MIN_HZ: f64 = 90.0;
/// Motion capture older than this is not seen, s.
const TRUTH_AGE_S: f64 = 0.5;

/// A check: its name, what is found, and what to do where it fails.
pub struct Check {
    /// Name.
    pub name: &'static str,
    /// What is found.
    pub found: String,
    /// Whether it passed, or what to do.
    pub verdict: Gate,
}

fn missing(what: &str, list: &[usize]) -> Gate {
    if list.is_empty() {
        return Ok(());
    }
    let words: Vec<String> = list.iter().map(|i| (i + 1).to_string()).collect();
    Err(format!(
        "{what} {}: check plug and cable.",
        words.join(", ")
    ))
}

fn check(name: &'static str, found: String, verdict: Gate) -> Check {
    Check {
        name,
        found,
        verdict,
    }
}

fn fail(ok: bool, what: &str) -> Gate {
    if ok { Ok(()) } else { Err(what.to_owned()) }
}

/// Of boards that answer: their rates and what they read.
fn sensors(s: &Snapshot) -> Vec<Check> {
    let raw = s.raw.as_ref();
    let mut out = Vec::new();
    for (b, name) in (0..BOARDS).zip(["Board 1 rate", "Board 2 rate"]) {
        let hz = s.link.board_rate_hz[b];
        let verdict = fail(
            hz >= RATE_MIN_HZ,
            "Less than 90 frames a second: use another USB port or hub.",
        );
        out.push(check(name, format!("{} Hz", number(hz, 1)), verdict));
    }
    let silent: Vec<usize> = (0..SPRINGS)
        .filter(|i| raw.is_none_or(|r| !r.has_spring(*i) || r.spring_counts[*i] == 0))
        .collect();
    let found = format!("{} of {SPRINGS} counted", SPRINGS - silent.len());
    out.push(check(
        "Springs",
        found,
        missing("No counts from spring", &silent),
    ));
    let dead: Vec<usize> = (0..IMUS)
        .filter(|i| raw.is_none_or(|r| !r.has_imu(*i)))
        .collect();
    let found = format!("{} of {IMUS} answer", IMUS - dead.len());
    out.push(check("IMUs", found, missing("No data from IMU", &dead)));
    let health = s.sensors.as_ref().map(|f| f.health.chambers);
    let bad: Vec<usize> = (0..CHAMBERS)
        .filter(|i| raw.is_none() || health.is_none_or(|h| !h[*i].usable()))
        .collect();
    let found = format!("{} of {CHAMBERS} read", CHAMBERS - bad.len());
    out.push(check(
        "Pressure gauges",
        found,
        missing("No pressure from gauge", &bad),
    ));
    out
}

/// The checks, in the order they are shown. Without a link there is nothing to say of the sensors.
pub fn checks(view: &View<'_>) -> Vec<Check> {
    let s = view.snapshot;
    let link = match (&s.link.refusal, s.link.connected) {
        (Some(why), _) => Err(why.clone()),
        (None, false) => {
            Err("Plug the boards in and start with --rig PORT, or read a bench log.".into())
        }
        (None, true) => fail(s.link.age_s < 0.25, "Frames are old: check the cable."),
    };
    let mut out = vec![check(
        "Link",
        match s.link.connected {
            true => format!("{}, {} old", s.link.source, age(s.link.age_s)),
            false => "no boards".into(),
        },
        link,
    )];
    if s.link.connected {
        out.extend(sensors(s));
    }
    let seen = s
        .truth
        .as_ref()
        .is_some_and(|t| s.stamp.since(t.stamp) < TRUTH_AGE_S);
    let found = match seen {
        true => format!("{} sees the end pad", view.truth_name()),
        false => "not seen".into(),
    };
    let text = "The Vicon step will be skipped: start Tracker's stream to have predictions scored.";
    out.push(check("Motion capture", found, fail(seen, text)));
    let (found, verdict) = match &s.mode {
        Mode::Safe(why) => (format!("SAFE: {why}"), Err("Press Reset first.".to_owned())),
        Mode::Moving => ("moves".into(), Err("Press HOLD first.".into())),
        Mode::Hold => ("holds".into(), Ok(())),
        Mode::AtGoal => ("rests at its goal".into(), Ok(())),
        Mode::Disarmed => ("disarmed".into(), Ok(())),
    };
    out.push(check("Arm at rest", found, verdict));
    out
}

/// The step.
pub fn ui(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    services: &mut Services,
) {
    ui.columns(2, |columns| {
        card(&mut columns[0], |ui| {
            ui.set_min_width(ui.available_width());
            ui.heading("Is everything there?");
            ui.add_space(4.0);
            let checks = checks(live);
            for c in &checks {
                match &c.verdict {
                    Ok(()) => {
                        note(ui, format!("● {}: {}", c.name, c.found));
                    }
                    Err(todo) => {
                        status(ui, Level::Warning, &format!("{}: {}", c.name, c.found));
                        ui.horizontal_wrapped(|ui| {
                            ui.add_space(18.0);
                            ui.label(todo);
                        });
                    }
                }
            }
            ui.add_space(8.0);
            let failed = checks.iter().filter(|c| c.verdict.is_err()).count();
            wizard.not_passed = Some(failed);
            let text = match failed {
                0 => format!("All checks passed ({}). Next: the springs.", live.origin()),
                n => format!(
                    "{n} of {} checks did not pass. You may go on: a step whose needs are missing says so, and a \
                     bench log can be read without any boards.",
                    checks.len()
                ),
            };
            ui.label(text);
        });
        card(&mut columns[1], |ui| {
            ui.set_min_width(ui.available_width());
            save::versions(ui, live, wizard, state, services);
        });
    });
}
