//! Around every screen: state and STOP on top, the screens on the left, messages below.

mod banners;
mod keys;

use std::time::Duration;

use egui::{Align, Button, Layout, RichText, Ui, vec2};

use super::agreement::{self, SPARK, Spark};
use super::operating::{hold_gate, mode_words, severity_level};
use super::rec::{self, Rec};
use super::target::{Fire, HoldToGo};
use super::toasts::Messages;
use super::widgets::{age, badge, gated, goes_down, minutes, note, status};
use crate::gui::screens::ScreenId;
use crate::gui::theme::{Level, Palette};
use crate::gui::view::{Gate, STALE_OPACITY, View};
use crate::signal::{CHAMBERS, IMUS, Mode, SPRINGS, Severity, Snapshot};
use crate::twin::{Command, RESUME_OFF_S, explain_alarm};
pub use banners::{LINE, banners, disconnected};
pub use keys::{KeyAction, keys, shortcuts};

/// Age above which link and ground truth count as late, s.
const LATE_S: f64 = 0.25;

/// Gauge pressure up to which a chamber counts as empty, Pa.
const EMPTY_PA: f64 = 2e3;

/// A simulation with a real-time factor from here on keeps up.
const KEEPS_UP: f64 = 0.95;

/// What the shell shows besides the live snapshot.
pub struct ShellInput<'a> {
    /// The live twin's view, also while a recording is shown.
    pub live: View<'a>,
    /// Title of the recording that is shown, if one is.
    pub replay: Option<&'a str>,
    /// The messages of the program.
    pub messages: &'a Messages,
    /// Window time, s.
    pub window_s: f64,
    /// What is being connected to, if anything is.
    pub joining: Option<&'a str>,
    /// Whether the window was opened onto a twin.
    pub twin: bool,
    /// Whether the twin behind the window has ended.
    pub twin_gone: bool,
    /// For how long the control loop of an armed arm has not reported, s, if that is too long.
    pub silent_s: Option<f64>,
    /// Whether a newcomer is greeted.
    pub welcome: bool,
}

/// What the operator asked of the window itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShellAction {
    /// Show another screen.
    Show(ScreenId),
    /// Switch between light and dark.
    ToggleTheme,
    /// Put the panels of Operate back where they were.
    ResetLayout,
    /// Show or hide the shortcuts.
    ToggleShortcuts,
    /// Show or hide the list of everything that can be done.
    TogglePalette,
    /// Close the recording that is shown.
    CloseReplay,
    /// Close the welcome and do not show it again.
    CloseWelcome,
    /// Show the welcome again.
    ShowWelcome,
    /// Connect to a virtual rig of this name.
    Connect(&'static str),
    /// Open the list of ports.
    ChoosePort,
    /// Freeze the plots, or follow the newest values.
    ToggleFreeze,
    /// Open the list of messages.
    ShowMessages,
    /// Open the list of alarms.
    ShowAlarms,
    /// Stop connecting.
    CancelConnecting,
}

/// The control that resumes a plan on hold: apart from HOLD, and held down on hardware.
#[derive(Clone, Debug, Default)]
pub struct Resume {
    button: HoldToGo,
    /// Window time at which HOLD was pressed or the arm was seen to hold, s.
    held_at_s: Option<f64>,
}

impl Resume {
    /// Takes note that the arm was held at `now_s` (window time, s).
    pub fn held(&mut self, now_s: f64) {
        self.held_at_s = Some(now_s);
    }

    /// Whether something is paused.
    pub fn is_offered(snapshot: &Snapshot) -> bool {
        snapshot.mode == Mode::Hold && snapshot.routine.is_some()
    }

    /// Whether the plan may be resumed at `now_s` (window time, s), or why not.
    pub fn gate(&self, live: &View<'_>, now_s: f64) -> Gate {
        if !Self::is_offered(live.snapshot) {
            return Err("Nothing is paused: pick a target or start a plan.".into());
        }
        if self.held_at_s.is_some_and(|t| now_s - t < RESUME_OFF_S) {
            return Err("Just held: RESUME works 1 s after HOLD.".into());
        }
        live.motion()
    }

    fn ui(&mut self, ui: &mut Ui, live: &View<'_>, commands: &mut Vec<Command>) {
        let now_s = ui.input(|i| i.time);
        let gate = self.gate(live, now_s);
        if let Some(held_s) = self.held_at_s {
            let left_s = RESUME_OFF_S - (now_s - held_s);
            if left_s > 0.0 {
                ui.ctx()
                    .request_repaint_after(Duration::from_secs_f64(left_s));
            }
        }
        let fire = Fire {
            now: "▶ RESUME",
            hold: "▶ Hold to resume",
            hover: "Continue the plan on hold",
        };
        if self
            .button
            .button(ui, live, &gate, &fire, vec2(128.0, 40.0))
        {
            commands.push(Command::Resume);
        }
    }
}

/// The control that lets the air out: held down on hardware, where the arm sags.
#[derive(Clone, Debug, Default)]
pub struct Vent {
    button: HoldToGo,
}

impl Vent {
    /// Whether the arm rests with air in its chambers.
    pub fn is_offered(s: &Snapshot) -> bool {
        let rests = !matches!(s.mode, Mode::Moving | Mode::AtGoal);
        let has_air = s.raw.as_ref().is_some_and(|r| {
            (0..CHAMBERS).any(|i| r.has_chamber(i) && r.chamber_pa[i].abs() > EMPTY_PA)
        });
        s.link.venting || (rests && has_air)
    }

    /// Whether the air may be let out, or why not.
    pub fn gate(live: &View<'_>) -> Gate {
        let link = &live.snapshot.link;
        live.live()?;
        if link.venting {
            return Err("Venting: the chambers are brought to 0 kPa.".into());
        }
        if link.stop_open {
            return Err("The emergency stop is pressed: release it first.".into());
        }
        match link.connected {
            true => Ok(()),
            false => Err("Not connected: the boards do not answer.".into()),
        }
    }

    fn ui(&mut self, ui: &mut Ui, live: &View<'_>, commands: &mut Vec<Command>) {
        let fire = Fire {
            now: "VENT",
            hold: "Hold: VENT",
            hover: "Bring all chambers to 0 kPa and switch the pumps off; the arm sags, in SAFE too",
        };
        let size = vec2(92.0, 40.0);
        if self.button.button(ui, live, &Self::gate(live), &fire, size) {
            commands.push(Command::Vent);
        }
    }
}

/// The bar on top: always there, never covered.
///
/// Gives the badge of the connection, behind which its menu opens.
pub fn top_bar(
    ui: &mut Ui,
    live: &View<'_>,
    (resume, vent): (&mut Resume, &mut Vent),
    rec: &mut Rec<'_>,
    commands: &mut Vec<Command>,
) -> Pressed {
    let s = live.snapshot;
    // From the right: where the window is narrow, STOP keeps its place and the rest gives way.
    ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
        stop(ui, commands);
        hold(ui, s, commands);
        alarms(ui, s);
        rec::button(ui, live, rec, commands);
        // Away from HOLD: a second press on that never reaches it.
        if Resume::is_offered(s) {
            resume.ui(ui, live, commands);
        }
        if Vent::is_offered(s) {
            vent.ui(ui, live, commands);
        }
        let left = Layout::left_to_right(Align::Center);
        ui.with_layout(left, |ui| {
            ui.set_clip_rect(ui.clip_rect().intersect(ui.max_rect()));
            state(ui, live)
        })
        .inner
    })
    .inner
}

// What is connected, what it does, and whether its signals come.
fn state(ui: &mut Ui, live: &View<'_>) -> Pressed {
    let s = live.snapshot;
    let p = Palette::in_ui(ui);
    let (text, hover) = if s.link.source.is_empty() {
        ("OFFLINE", "Nothing is connected.")
    } else if !s.link.moves_hardware() {
        ("SIM", "The data come from a simulation, not from hardware.")
    } else {
        ("HARDWARE", "Commands move a real arm.")
    };
    let button = Button::new(RichText::new(text).color(p.panel)).fill(p.text);
    let connection = ui
        .add(button)
        .on_hover_text(format!("{hover} Click to connect to something else."));
    let (glyph, word, level) = mode_words(&s.mode);
    let (fill, color) = match level {
        Level::Critical => (p.critical_fill, p.on_critical),
        _ => (p.raised, p.text),
    };
    badge(ui, &format!("{glyph} {word}"), fill, color).on_hover_text(match &s.mode {
        Mode::Safe(reason) => reason.as_str(),
        _ => "What the twin is doing",
    });
    ui.separator();
    Pressed {
        twin: counts(ui, live),
        connection,
    }
}

fn stop(ui: &mut Ui, commands: &mut Vec<Command>) {
    let p = Palette::in_ui(ui);
    let text = RichText::new("■ STOP").size(19.0).color(p.on_critical);
    let button = Button::new(text)
        .fill(p.critical_fill)
        .min_size(vec2(122.0, 40.0));
    let hover = "Pumps off as it goes down, latched until Reset (Shift+Esc, also while typing)";
    if goes_down(&ui.add(button).on_hover_text(hover)) {
        commands.push(Command::Stop);
    }
}

fn hold(ui: &mut Ui, s: &Snapshot, commands: &mut Vec<Command>) {
    let button = Button::new(RichText::new("▮▮ HOLD").size(16.0)).min_size(vec2(108.0, 40.0));
    let hover = "Keep the present pressures (Space)";
    if goes_down(&gated(ui, &hold_gate(s), button, hover)) {
        commands.push(Command::Hold);
    }
}

/// Id of the list of alarms.
pub fn alarms_id() -> egui::Id {
    egui::Id::unique("alarms")
}

fn alarms(ui: &mut Ui, s: &Snapshot) {
    let p = Palette::in_ui(ui);
    let level = s.alarms.iter().map(|a| severity_level(a.severity)).max();
    let n = s.alarms.len();
    let text = match level {
        None => "alarms 0".into(),
        Some(level) => format!("{} alarms {n}", level.glyph()),
    };
    let color = level.map_or(p.weak, |l| p.level(l));
    let response = ui
        .add(Button::new(RichText::new(text).color(color)).min_size(vec2(0.0, 40.0)))
        .on_hover_text("All active alarms");
    egui::Popup::menu(&response)
        .id(alarms_id())
        .accessible_name("Alarms")
        .show(|ui| {
            ui.set_max_width(420.0);
            if s.alarms.is_empty() {
                note(ui, "No active alarms.");
            }
            for alarm in &s.alarms {
                let since = s.stamp.since(alarm.since);
                let text = format!("{} (for {})", alarm.text(), minutes(since));
                status(ui, severity_level(alarm.severity), &text);
                let help = explain_alarm(&alarm.cause);
                note(ui, format!("{} {}", help.follows, help.check))
                    .on_hover_text(format!("{} More: springtwin alarms {}", help.when, help.id));
            }
        });
}

/// Between two items of the top bar, points.
const ITEM_GAP: f32 = 14.0;

/// What was done with the top bar.
pub struct Pressed {
    /// The badge of the connection.
    pub connection: egui::Response,
    /// Whether the disagreement of twin and arm was clicked.
    pub twin: bool,
}

/// The item that shows whether twin and arm agree, by its words alone.
const TWIN: &str = "twin";

/// One name and value of the top bar.
struct Item {
    level: Level,
    name: &'static str,
    value: String,
    hover: String,
    /// Whether it was true when data came last: greyed.
    stale: bool,
    /// How it was before.
    spark: Option<Spark>,
    /// Whether it has nothing to show: grey.
    is_quiet: bool,
}

impl Item {
    /// Abnormal ones get glyph and colour.
    fn name(&self) -> String {
        match self.level {
            _ if self.name == TWIN => String::new(),
            Level::Normal => self.name.to_owned(),
            level => format!("{} {}", level.glyph(), self.name),
        }
    }

    fn width(&self, ui: &Ui) -> f32 {
        let font = egui::TextStyle::Body.resolve(ui.style());
        let of = |text: String| {
            let galley = ui
                .painter()
                .layout_no_wrap(text, font.clone(), egui::Color32::WHITE);
            galley.size().x
        };
        let spark = self.spark.as_ref().map_or(0.0, |_| SPARK + 5.0);
        of(self.name()) + 5.0 + of(self.value.clone()) + spark + ITEM_GAP
    }

    /// Shows it; whether it was clicked.
    fn show(&self, ui: &mut Ui) -> bool {
        let p = Palette::in_ui(ui);
        let share = if self.stale { STALE_OPACITY } else { 1.0 };
        ui.spacing_mut().item_spacing.x = 5.0;
        let color = match self.is_quiet {
            true => p.weak,
            false => p.level_text(self.level),
        };
        let color = color.gamma_multiply(share);
        let value = RichText::new(&self.value).color(color);
        let sense = match self.name {
            TWIN => egui::Sense::click(),
            _ => egui::Sense::hover(),
        };
        let label = |ui: &mut Ui, text: RichText| ui.add(egui::Label::new(text).sense(sense));
        let response = match self.name {
            "" => label(ui, value),
            TWIN => {
                let words = label(ui, value);
                match &self.spark {
                    Some(spark) => {
                        let (rect, line) = ui.allocate_exact_size(vec2(SPARK, 16.0), sense);
                        spark.paint(ui, rect, color);
                        words.union(line)
                    }
                    None => words,
                }
            }
            _ => {
                let color = p.level(self.level).gamma_multiply(share);
                let name = label(ui, RichText::new(self.name()).color(color));
                name.union(label(ui, value))
            }
        };
        let clicked = response.on_hover_text(self.hover.as_str()).clicked();
        ui.add_space(ITEM_GAP - 5.0);
        clicked
    }
}

fn warn_if(abnormal: bool) -> Level {
    if abnormal {
        Level::Warning
    } else {
        Level::Normal
    }
}

// Shows the items; whether that of the twin was clicked.
fn counts(ui: &mut Ui, live: &View<'_>) -> bool {
    let s = live.snapshot;
    if s.link.source.is_empty() {
        note(ui, "Nothing is connected");
        return false;
    }
    let mut clicked = false;
    let mut all = items(live);
    let room = ui.available_width();
    if all.iter().map(|i| i.width(ui)).sum::<f32>() <= room {
        all.iter().for_each(|i| clicked |= i.show(ui));
        return clicked;
    }
    // In two lines; where even those are too short, what is normal gives way, the last first.
    let mut hidden: Vec<Item> = Vec::new();
    let lines = loop {
        let lines = in_lines(ui, &all, room - if hidden.is_empty() { 0.0 } else { 24.0 });
        if lines.len() <= 2 || all.len() < 2 {
            break lines;
        }
        let normal = all.iter().rposition(|i| i.level == Level::Normal);
        hidden.insert(0, all.remove(normal.unwrap_or(all.len() - 1)));
    };
    let last = lines.len().saturating_sub(1);
    ui.vertical(|ui| {
        ui.spacing_mut().interact_size.y = 18.0;
        ui.spacing_mut().item_spacing.y = 2.0;
        ui.add_space(5.0);
        for (i, line) in lines.into_iter().enumerate() {
            ui.horizontal(|ui| {
                all[line].iter().for_each(|i| clicked |= i.show(ui));
                if i == last && !hidden.is_empty() {
                    let words: Vec<String> = hidden
                        .iter()
                        .map(|h| format!("{} {}: {}", h.name, h.value, h.hover))
                        .collect();
                    note(ui, "…").on_hover_text(words.join("\n"));
                }
            });
        }
    });
    clicked
}

/// Which items stand in which line of that width.
fn in_lines(ui: &Ui, items: &[Item], width: f32) -> Vec<std::ops::Range<usize>> {
    let mut lines: Vec<std::ops::Range<usize>> = Vec::new();
    let mut used = f32::INFINITY;
    for (i, item) in items.iter().enumerate() {
        let own = item.width(ui);
        match lines.last_mut() {
            Some(line) if used + own <= width => line.end = i + 1,
            _ => {
                lines.push(i..i + 1);
                used = 0.0;
            }
        }
        used += own;
    }
    lines
}

fn items(live: &View<'_>) -> Vec<Item> {
    let s = live.snapshot;
    let item = |level, name, value: String, hover: String| Item {
        level,
        name,
        value,
        hover,
        stale: false,
        spark: None,
        is_quiet: false,
    };
    let (springs, imus) = s.sensors.as_ref().map_or((0, 0), |f| {
        (f.health.springs_usable(), f.health.imus_usable())
    });
    let vicon = match &s.truth {
        Some(t) => {
            let late = s.stamp.since(t.stamp);
            let hover =
                "Age of the newest motion-capture pose. It is never used for control.".to_owned();
            item(warn_if(late > LATE_S), "Vicon", age(late.max(0.0)), hover)
        }
        None => {
            let why = &s.link.mocap_trouble;
            let level = warn_if(why.is_some());
            let hover = why
                .clone()
                .unwrap_or_else(|| "No motion capture: predictions cannot be scored.".to_owned());
            item(level, "Vicon", "—".into(), hover)
        }
    };
    let lost = s.link.frames_lost as f64 / (s.link.frames + s.link.frames_lost).max(1) as f64;
    // What was true of signals that no longer come is greyed, with its age.
    let stale = live.is_stale();
    let few = |name, usable: usize, of: usize, hover: &str| Item {
        stale,
        ..item(
            warn_if(usable < of && !stale),
            name,
            format!("{usable}/{of}"),
            hover.into(),
        )
    };
    let mut all = vec![
        few("springs", springs, SPRINGS, "Springs that may be used"),
        few("IMU", imus, IMUS, "IMUs that may be used"),
    ];
    if let Some(stale_s) = live.stale_s() {
        let hover = "When springs and IMUs gave data last";
        let ago = format!("{} ago", age(stale_s));
        all.push(item(Level::Normal, "", ago, hover.into()));
    }
    let light = agreement::light(live);
    all.push(Item {
        stale,
        spark: agreement::spark(live),
        is_quiet: s.disagreement.is_none(),
        ..item(light.level, TWIN, light.text, light.hover)
    });
    all.extend([
        vicon,
        item(
            warn_if(!s.link.connected || s.link.age_s > LATE_S),
            "link",
            age(s.link.age_s),
            format!("Age of the newest frame from {}", s.link.source),
        ),
        item(
            warn_if(lost > 0.01),
            "drops",
            s.link.frames_lost.to_string(),
            format!("Frames lost since the link opened: {:.2} %", lost * 100.0),
        ),
    ]);
    all
}

/// Width of the rail with and without the keys of its screens, points.
pub const RAIL: [f32; 2] = [152.0, 116.0];

/// Windows narrower than this have the narrow rail, points.
pub const NARROW: f32 = 1200.0;

/// The rail on the left: the screens, and what concerns the window. Where it is narrow the keys stand in the
/// tooltips only.
pub fn rail(ui: &mut Ui, current: ScreenId, actions: &mut Vec<ShellAction>) {
    let p = *Palette::in_ui(ui);
    ui.spacing_mut().item_spacing.y = 4.0;
    let width = ui.available_width();
    let narrow = width < 0.5 * (RAIL[0] + RAIL[1]);
    if narrow {
        ui.spacing_mut().button_padding.x = 6.0;
    }
    let shown = |button: Button<'static>, keys: &str| match narrow {
        true => button,
        false => button.right_text(RichText::new(keys).small().color(p.weak)),
    };
    for screen in ScreenId::ALL {
        let hint = screen.shortcut();
        let button = Button::selectable(current == screen, screen.name());
        let button = shown(button, hint).min_size(vec2(width, 34.0));
        let hover = format!("{} ({hint})", screen.purpose());
        let response = ui.add(button).on_hover_text(hover);
        if response.accessible_name(screen.name()).clicked() {
            actions.push(ShellAction::Show(screen));
        }
    }
    ui.with_layout(Layout::bottom_up(Align::Min), |ui| {
        let mut small = |ui: &mut Ui, text: &str, keys: &str, hover: &str, action| {
            let button = Button::selectable(false, text.to_owned());
            let button = shown(button, keys).min_size(vec2(width, 28.0));
            let hover = match keys {
                "" => hover.to_owned(),
                keys => format!("{hover} ({keys})"),
            };
            let response = ui.add(button).on_hover_text(hover);
            if response.accessible_name(text).clicked() {
                actions.push(action);
            }
        };
        small(
            ui,
            "Commands",
            "Ctrl+P",
            "Find any action by typing",
            ShellAction::TogglePalette,
        );
        small(
            ui,
            "Shortcuts",
            "?",
            "All keyboard shortcuts",
            ShellAction::ToggleShortcuts,
        );
        let theme = if ui.visuals().dark_mode {
            "Light theme"
        } else {
            "Dark theme"
        };
        small(
            ui,
            theme,
            "",
            "Switch between light and dark",
            ShellAction::ToggleTheme,
        );
        if current == ScreenId::Operate {
            small(
                ui,
                "Reset layout",
                "",
                "Put the panels back where they were at first",
                ShellAction::ResetLayout,
            );
        }
    });
}

/// The strip at the bottom: the newest message or the most urgent alarm (a critical one first), the rolling
/// recording, and all messages.
pub fn strip(ui: &mut Ui, input: &ShellInput<'_>) {
    let s = input.live.snapshot;
    ui.horizontal_centered(|ui| {
        let urgent = s
            .alarms
            .iter()
            .filter(|a| a.severity >= Severity::Warning)
            .max_by_key(|a| a.severity);
        match (input.messages.newest(input.window_s), urgent) {
            (Some(m), a) if a.is_none_or(|a| a.severity < Severity::Critical) => {
                ui.label(m.text.as_str());
            }
            (_, Some(a)) => {
                status(ui, severity_level(a.severity), &a.text());
            }
            (_, None) => {}
        }
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            note(ui, minutes(s.stamp.seconds())).on_hover_text("Session time, min:s");
            if let Some(factor) = s.real_time_factor.filter(|f| *f < KEEPS_UP) {
                note(ui, format!("simulation at {factor:.1}× real time")).on_hover_text(
                    "This computer is busy: the simulation runs more slowly; no data are lost.",
                );
            }
            input.messages.button(ui, input.window_s);
            super::recordings::in_strip(ui, s);
        });
    });
}
