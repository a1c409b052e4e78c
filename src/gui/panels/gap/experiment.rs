//! The finder drives the arm: what it wants is shown, begins with the operator's consent, is recorded, and ends with STOP and HOLD
//! like everything else.

use egui::{RichText, Role, Ui, WidgetInfo};

use super::chart::{Chart, Line};
use super::tried::{Trace, in_short, show};
use super::{GapState, Step, Trouble};
use crate::analysis::history::Channel;
use crate::gap::report::Origin;
use crate::gui::panels::conduct::{Conduct, Consent, conduct_gate};
use crate::gui::panels::plot::{Dash, swatch};
use crate::gui::panels::recordings::keep_gate;
use crate::gui::panels::widgets::{Gate, gated, note, number, status};
use crate::gui::services::Services;
use crate::gui::services::gap::Pair;
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, Disagreement, IMUS, SPRINGS, Snapshot, capitalised};
use crate::task::Programme;
use crate::twin::{Command, Event};

/// How much of the rolling recording is checked, s: about as long as a session that the finder judges well.
const CHECKED_S: f64 = 90.0;

impl GapState {
    /// Whether a search can begin against a baseline that was kept, or why not.
    fn kept_gate(&self) -> Gate {
        if self.running.is_busy() || self.keeping_last.is_busy() {
            return Err("The finder is running: wait, or cancel it.".into());
        }
        match self.select.slots[0].known() {
            Some(sheet) if sheet.kept.is_some() => Ok(()),
            _ => Err("Choose a baseline that was kept in the place of the healthy session: Keep as baseline.".into()),
        }
    }

    /// Whether the last minutes can be looked into, or why not.
    pub fn check_gate(&self, live: &View<'_>) -> Gate {
        self.kept_gate().and_then(|()| keep_gate(live.snapshot))
    }

    /// Sets the finder to work on the last minutes; the arm goes on.
    pub fn check_last(&mut self, live: &View<'_>, services: &mut Services) {
        if let (Ok(()), Some(first)) = (self.check_gate(live), live.snapshot.rolling.first()) {
            let folder = services.recordings.path().to_owned();
            let words = "Checked by the gap finder".to_owned();
            let job = (services.keep)(first, &folder, CHECKED_S, words);
            self.keeping_last.begin_for(origin(live), job);
        }
    }

    /// Begins the search once the last minutes are a recording.
    pub fn poll_check(&mut self, services: &mut Services) {
        match self.keeping_last.take_for() {
            Some((origin, Ok(suspect))) => {
                let healthy = self.select.slots[0].known().map(|s| s.path.clone());
                let search = super::Search {
                    pair: Pair { suspect, healthy },
                    origin,
                    answer: None,
                    known: None,
                };
                self.begin(search, services);
            }
            Some((_, Err(e))) => {
                self.trouble = Some(Trouble::new(
                    e,
                    "The last minutes were not checked.",
                    "Remove the cause named above, then press the button again.",
                ));
            }
            None => {}
        }
    }

    /// Whether the finder may drive the arm, or why not.
    pub fn experiment_gate(&self, live: &View<'_>) -> Gate {
        self.kept_gate()?;
        conduct_gate(live)
    }

    /// Lets the finder drive the arm.
    pub fn experiment(&mut self, live: &View<'_>, services: &mut Services) {
        let healthy = self.select.slots[0].known().map(|s| s.path.clone());
        if let (Ok(()), Some(healthy)) = (self.experiment_gate(live), healthy) {
            let (job, link) = (services.gap.experiment)(&healthy, live.snapshot.payload_kg);
            let search = super::Search {
                pair: Pair {
                    suspect: link.first.clone(),
                    healthy: Some(healthy),
                },
                origin: origin(live),
                answer: None,
                known: None,
            };
            self.step = Step::Select;
            self.trouble = None;
            self.conduct = Some(Conduct::new(link, Consent::Each));
            self.running.begin_for(search, job);
        }
    }

    /// Goes on with an experiment under way, whatever screen is shown, and hands over what was ordered.
    pub fn poll_experiment(&mut self, live: &View<'_>, commands: &mut Vec<Command>) {
        if let Some(conduct) = &mut self.conduct {
            conduct.poll(live, commands);
        }
        commands.append(&mut self.orders);
    }

    /// Follows the arm of an experiment under way.
    pub fn follow_experiment(&mut self, live: &Snapshot, events: &[Event]) {
        if let Some(conduct) = &mut self.conduct {
            self.orders.extend(conduct.follow(live, events));
        }
    }

    /// Ends an experiment: what moves for it is held.
    pub fn end_experiment(&mut self, commands: &mut Vec<Command>) {
        if let Some(conduct) = self.conduct.take() {
            conduct.end(commands);
        }
    }
}

/// Where what the live arm does comes from.
fn origin(live: &View<'_>) -> Origin {
    match live.snapshot.link.simulated {
        true => Origin::Simulated,
        false => Origin::Measured,
    }
}

/// What the finder wants to drive, and the operator's consent to it.
pub fn under_way(ui: &mut Ui, state: &mut GapState, live: &View<'_>, commands: &mut Vec<Command>) {
    if let Some(conduct) = &mut state.conduct {
        ui.label(RichText::new("The finder drives the arm").strong());
        conduct.ui(ui, live, commands);
    }
}

/// What is left below the plot of an excitation for its words, points.
const WORDS: f32 = 64.0;
/// Points of its lines: as many as there are pixels at most.
const PREVIEW_POINTS: usize = 600;

/// The excitation that the finder wants to drive, or drives.
pub fn wanted(state: &GapState) -> Option<&Programme> {
    state.conduct.as_ref()?.programme()
}

/// The pressures that an excitation sets over its time, with the limits of the robot.
pub fn preview(ui: &mut Ui, programme: &Programme, spec: &RobotSpec) {
    const NAMES: [&str; CHAMBERS] = [
        "chamber 1",
        "chamber 2",
        "chamber 3",
        "chamber 4",
        "chamber 5",
        "chamber 6",
    ];
    let p = *Palette::in_ui(ui);
    let t_s: Vec<f64> = (0..=PREVIEW_POINTS)
        .map(|k| programme.seconds * k as f64 / PREVIEW_POINTS as f64)
        .collect();
    let set_kpa: Vec<[f64; CHAMBERS]> = t_s
        .iter()
        .map(|t| programme.at(*t).map(|pa| 1e-3 * pa))
        .collect();
    let line = |i: usize| Line {
        name: NAMES[i],
        color: p.signal(Channel::ChamberSet(i)),
        dash: Dash::Solid,
        values: set_kpa.iter().map(|all| all[i]).collect(),
    };
    let limits = [spec.pressure.min_pa, spec.pressure.max_pa].map(|pa| 1e-3 * pa);
    Chart {
        title: "Pressures that it sets / kPa (dashed: limits)",
        unit: "kPa",
        t_s: &t_s,
        lines: (0..CHAMBERS).map(line).collect(),
        range_s: [0.0, programme.seconds],
        mark_s: None,
        begins_s: None,
        band: None,
        limits: Some(limits),
        min_span: 10.0,
        legend: false,
    }
    .show(ui, (ui.available_height() - WORDS).max(100.0));
    ui.horizontal(|ui| {
        note(ui, "chamber");
        for (i, name) in NAMES.into_iter().enumerate() {
            swatch(ui, p.signal(Channel::ChamberSet(i)), Dash::Solid);
            let number = note(ui, (i + 1).to_string());
            number.widget_info(|| WidgetInfo::labeled(Role::Label, true, name));
        }
    });
    let all = || set_kpa.iter().flatten().copied();
    let (low, high) = (
        all().fold(f64::INFINITY, f64::min),
        all().fold(f64::NEG_INFINITY, f64::max),
    );
    let [least, most] = limits;
    note(
        ui,
        format!(
            "“{}” takes {} s and sets {} to {} kPa; the limits are {} and {} kPa.",
            programme.name,
            number(programme.seconds, 0),
            number(low, 1),
            number(high, 1),
            number(least, 0),
            number(most, 0)
        ),
    );
}

/// Buttons that take one of the likely effects as known, for a reason.
fn mute(ui: &mut Ui, state: &mut GapState, likely: &[String]) {
    if likely.is_empty() {
        return;
    }
    ui.horizontal_wrapped(|ui| {
        let field = egui::TextEdit::singleline(&mut state.mute_reason)
            .desired_width(180.0)
            .hint_text("known? why");
        ui.add(field).accessible_name("Reason to mute it");
        let reason = state.mute_reason.trim().to_owned();
        let gate = match reason.is_empty() {
            true => Err("Type why it is known; the reason is logged and recorded.".to_owned()),
            false => Ok(()),
        };
        let hover = "It counts no longer as a disagreement until this window is closed, or until it is counted again";
        for name in likely {
            let button = egui::Button::new(format!("Mute {name}"));
            if gated(ui, &gate, button, hover).clicked() && gate.is_ok() {
                state.orders.push(Command::Mute {
                    effect: name.clone(),
                    reason: reason.clone(),
                });
                state.mute_reason.clear();
            }
        }
    });
}

/// The residual of the channel that disagrees most, by the twin's own model; `None` for what has none.
fn residual_of(d: &Disagreement) -> Option<Channel> {
    let number = |text: &str| text.parse::<usize>().ok()?.checked_sub(1);
    match *d.channel.split(' ').collect::<Vec<_>>() {
        ["spring", i] => number(i)
            .filter(|i| *i < SPRINGS)
            .map(Channel::SpringResidual),
        // About x, y, z, which is roll, pitch, yaw near the hanging arm.
        ["IMU", i, axis] => {
            let k = ["z", "y", "x"].iter().position(|a| *a == axis)?;
            number(i)
                .filter(|i| *i < IMUS)
                .map(|i| Channel::ImuResidual(i, k))
        }
        _ => None,
    }
}

impl GapState {
    /// Shows what the monitor finds of the live arm, and highlights the spring that disagrees most.
    pub fn explain_live(&mut self, live: &Snapshot, selected_spring: &mut Option<usize>) {
        if self.gate(Step::Select).is_ok() {
            self.step = Step::Select;
        }
        let d = live.off();
        if let Some(Channel::SpringResidual(i)) = d.and_then(residual_of) {
            *selected_spring = Some(i);
        }
    }
}

/// How a monitor of this arm is had.
fn no_baseline(live: &View<'_>) -> &'static str {
    match live.snapshot.link.moves_hardware() {
        true => {
            "No baseline, so nothing compares twin and arm. Choose a session of the rig in order as the healthy session, press Keep as \
             baseline, and connect again."
        }
        false => {
            "No baseline, so nothing compares twin and arm: one ships for the reference robot's virtual rig, unit 1, with the calibration it \
             comes with. Choose a recording of this rig in order as the healthy session, press Keep as baseline, and connect again."
        }
    }
}

/// What the monitor finds.
fn verdict(ui: &mut Ui, live: &View<'_>) {
    let s = live.snapshot;
    match &s.disagreement {
        Some(d) if d.is_off() => {
            let ago = number((s.stamp.seconds() - d.since_s).max(0.0), 0);
            let text = format!(
                "Twin and arm disagree since {ago} s ago, most in {}.{}",
                d.channel,
                d.looks_like()
            );
            status(ui, Level::Warning, &text);
        }
        Some(d) => {
            let text = format!(
                "Twin and arm agree: {} of the limit, most in {}.",
                number(d.ratio, 1),
                d.channel
            );
            status(ui, Level::Normal, &text);
        }
        None if s.is_monitored => {
            note(
                ui,
                "A monitor compares twin and arm; its first verdict comes after some seconds of readings.",
            );
        }
        None if !s.link.source.is_empty() => {
            note(ui, format!("○ {}", no_baseline(live)));
        }
        None => {}
    }
}

/// The residual of what disagrees, over the last minute; nothing while nothing does.
fn trace(ui: &mut Ui, live: &View<'_>) {
    let d = live.snapshot.off();
    let Some((d, channel)) = d.and_then(|d| Some((d, residual_of(d)?))) else {
        return;
    };
    let p = *Palette::in_ui(ui);
    let title = format!("Residual of {}, last 60 s", d.channel);
    let line = Trace {
        name: "twin's model",
        color: p.text,
        channel,
        from_s: f64::NEG_INFINITY,
    };
    show(ui, live, &title, &[line]);
}

/// The ways to let the finder look at the live arm.
pub fn begin(ui: &mut Ui, state: &mut GapState, live: &View<'_>, services: &mut Services) {
    ui.label(RichText::new("The live arm").strong());
    let s = live.snapshot;
    verdict(ui, live);
    in_short(ui, live, &mut state.orders);
    if let Some(d) = s.off() {
        mute(ui, state, &d.likely);
    }
    for name in s.disagreement.iter().flat_map(|d| &d.muted) {
        let text = format!("{} is muted: count it again", capitalised(name));
        if ui.button(text).clicked() {
            state.orders.push(Command::Unmute(name.clone()));
        }
    }
    let (mut checks, mut begins) = (false, false);
    ui.horizontal_wrapped(|ui| {
        let gate = state.check_gate(live);
        let text = format!("Check the last {CHECKED_S:.0} s");
        let hover = "Looks for what is missing in what the rolling recording kept; the arm goes on";
        checks = gated(ui, &gate, egui::Button::new(text), hover).clicked();
        let gate = state.experiment_gate(live);
        let button = egui::Button::new("Run an experiment");
        let hover = "Computes what to drive (about a minute), drives and records it, and looks; ten minutes of motion at most. The arm moves: \
                     hardware is asked for each excitation.";
        begins = gated(ui, &gate, button, hover).clicked();
        if state.keeping_last.is_busy() {
            ui.spinner();
        }
    });
    let what = "An experiment drives what separates the possible effects best, until one is found or nothing is missing.";
    note(ui, what);
    trace(ui, live);
    if checks {
        state.check_last(live, services);
    }
    if begins {
        state.experiment(live, services);
    }
}
