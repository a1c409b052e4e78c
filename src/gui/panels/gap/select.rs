//! Select: a healthy and a suspect session, an example, and the finder at work.

mod selection;

use egui::{Button, ProgressBar, RichText, ScrollArea, Ui, vec2};

use super::{GapState, Trouble, experiment};
use crate::analysis::recorded::origin_name;
use crate::gap::Stage;
use crate::gui::panels::files::Ask;
use crate::gui::panels::widgets::card;
use crate::gui::panels::widgets::{
    badge, cell, cell_left, gated, heading, minutes, note, number, pane, status,
};
use crate::gui::services::gap::{Arm, Kept, Part, RobotMatch, SessionSheet};
use crate::gui::services::{Dialog, DialogKind, Services};
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::twin::Command;
pub use selection::Selection;
use selection::{Slot, trouble_with};

impl Part {
    fn title(self) -> &'static str {
        match self {
            Self::Healthy => "Healthy session (commissioning)",
            Self::Suspect => "Suspect session",
        }
    }

    /// The dialog that asks for its session.
    fn dialog(self) -> Dialog {
        Dialog {
            title: self.title().to_owned(),
            kind: DialogKind::Open,
            filter: Some((
                "sessions".to_owned(),
                ["rrd", "toml", "csv"].map(str::to_owned).to_vec(),
            )),
            name: String::new(),
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Healthy => {
                "Recorded when the rig was healthy. Optional: without it the factory model is the \
                 baseline, and every verdict is weaker."
            }
            Self::Suspect => "Recorded now, of the same rig. It may contain an effect.",
        }
    }
}

impl GapState {
    /// Asks for a session in a file dialog, unless one is open.
    pub fn browse_for(&mut self, part: Part, services: &mut Services) {
        let slot = &mut self.select.slots[part as usize];
        slot.path.browse(part.dialog(), services);
    }

    /// Chooses no session.
    pub fn clear(&mut self, part: Part) {
        self.select.slots[part as usize] = Slot::default();
    }
}

/// The step.
pub fn ui(
    ui: &mut Ui,
    state: &mut GapState,
    live: &View<'_>,
    services: &mut Services,
    commands: &mut Vec<Command>,
) {
    if !state.select.scanned {
        state.select.scanned = true;
        let found = (services.scan)(services.recordings.path());
        state.select.scanning.begin(found);
        state.select.asked_for = None;
    }
    let arm = Arm::of(live.snapshot);
    if state.select.asked_for != Some(arm) {
        state.select.ask_for_baseline(arm, services);
    }
    let free = !state.running.is_busy();
    // What is known of a session needs more than the field of its path.
    let known = state.select.slots.iter().any(|s| s.sheet.is_some());
    let share = if known { 0.44 } else { 0.30 };
    let height = (share * ui.available_height()).clamp(150.0, 244.0);
    ui.horizontal_top(|ui| {
        // A card's stroke lies outside of what it is given.
        let width = (ui.available_width() - 8.0) / 2.0 - 3.0;
        for part in Part::ALL {
            ui.allocate_ui(vec2(width, height), |ui| {
                pane(ui, part.name(), |ui| {
                    ui.add_enabled_ui(free, |ui| {
                        slot(ui, part, &mut state.select, services);
                    });
                });
            });
        }
    });
    ui.horizontal_top(|ui| {
        let height = ui.available_height();
        let left = ui.available_width() * 0.56;
        ui.allocate_ui(vec2(left, height), |ui| {
            card(ui, |ui| {
                ui.set_min_size(ui.available_size());
                match experiment::wanted(state) {
                    // Nothing can be chosen meanwhile.
                    Some(programme) => experiment::preview(ui, programme, live.spec),
                    None => {
                        ui.add_enabled_ui(free, |ui| library(ui, &mut state.select, services));
                    }
                }
            });
        });
        ui.vertical(|ui| {
            pane(ui, "find", |ui| {
                run(ui, state, live, services, commands);
            });
        });
    });
}

fn slot(ui: &mut Ui, part: Part, selection: &mut Selection, services: &mut Services) {
    let keeping = selection.keeping.is_busy();
    let slot = &mut selection.slots[part as usize];
    ui.label(RichText::new(part.title()).strong());
    ui.horizontal(|ui| {
        let name = format!("Path of the {} session", part.name());
        let browse = format!("Browse for the {} session", part.name());
        let ask = Ask {
            name: &name,
            hint: "session folder, session.toml, .csv or .rrd",
            hover: "Path of a session log or a recording; Enter reads it",
            browse: &browse,
            right: 40.0,
        };
        let dialog = || part.dialog();
        let before = slot.path.text.clone();
        let chosen = slot.path.ui(ui, &ask, dialog, services);
        if slot.path.text != before {
            slot.sheet = None;
            slot.told = None;
            slot.looking.cancel();
        }
        if let Some(path) = chosen {
            slot.choose(&path, services);
        }
        let gate = match slot.path.text.is_empty() {
            true => Err("Nothing is chosen.".to_owned()),
            false => Ok(()),
        };
        let clear = gated(ui, &gate, Button::new("×"), "Choose none");
        if clear
            .accessible_name(format!("Clear the {} session", part.name()))
            .clicked()
        {
            *slot = Slot::default();
        }
    });
    slot.path.trouble(ui);
    if slot.looking.is_busy() {
        ui.horizontal(|ui| {
            ui.spinner();
            note(ui, "Reading the session…");
        });
        return;
    }
    match &slot.sheet {
        None => {
            note(ui, part.words());
        }
        Some(Err(e)) => Trouble::new(
            e.clone(),
            "The session is not used.",
            "Choose another file, or look into it with springtwin inspect.",
        )
        .show(ui),
        Some(Ok(sheet)) => {
            facts(ui, sheet);
            if let Some(trouble) = trouble_with(part, sheet) {
                trouble.show(ui);
            } else if part == Part::Suspect && sheet.simulated.is_none() {
                ui.horizontal_wrapped(|ui| {
                    ui.label("Origin not recorded. It is");
                    for (value, text, hover) in [
                        (
                            true,
                            "simulated",
                            "Every figure is then labelled as simulated",
                        ),
                        (false, "measured", "The data were measured on a real arm"),
                    ] {
                        ui.radio_value(&mut slot.told, Some(value), text)
                            .on_hover_text(hover)
                            .accessible_name(format!("The suspect session is {text}"));
                    }
                });
            } else if part == Part::Healthy {
                let path = sheet.path.clone();
                if kept(ui, sheet, keeping) {
                    selection.keeping.begin((services.gap.commission)(&path));
                }
            }
        }
    }
}

/// A baseline older than this is no longer trusted without a word, days.
const OLD_DAYS: f64 = 30.0;

/// The age of a baseline, or the way to make one of a session; true when it is to be made.
fn kept(ui: &mut Ui, sheet: &SessionSheet, keeping: bool) -> bool {
    match sheet.kept {
        Some(Kept::Days(days)) if days > OLD_DAYS => {
            let old = "Rubber ages: commission the rig again when you can, and whenever it was taken apart.";
            status(ui, Level::Warning, old);
            false
        }
        Some(_) => false,
        None if keeping => {
            ui.horizontal(|ui| {
                ui.spinner();
                note(ui, "Fitting the healthy rig…");
            });
            false
        }
        None => ui
            .button("Keep as baseline")
            .on_hover_text(
                "Fit the rig in order once and keep it for this robot: it is then chosen here by itself, and suspect sessions \
                 need no motion capture",
            )
            .clicked(),
    }
}

/// Since when there is a baseline, in words.
fn age(kept: Kept) -> String {
    match kept {
        Kept::Shipped => "with the program".to_owned(),
        Kept::Days(d) if d < 1.0 => "today".to_owned(),
        Kept::Days(d) if d < 2.0 => "a day ago".to_owned(),
        Kept::Days(d) => format!("{} days ago", number(d.floor(), 0)),
    }
}

fn facts(ui: &mut Ui, sheet: &SessionSheet) {
    let p = *Palette::in_ui(ui);
    ui.horizontal(|ui| {
        ui.label(RichText::new(&sheet.name).strong());
        if sheet.kept.is_none() {
            badge(ui, origin_name(sheet.simulated), p.raised, p.text)
                .on_hover_text("Where the data come from");
        }
    });
    ui.spacing_mut().item_spacing.y = 3.0;
    ui.spacing_mut().interact_size.y = 20.0;
    let row = |ui: &mut Ui, name: &str, text: String| {
        ui.horizontal_top(|ui| {
            cell_left(ui, 76.0, RichText::new(name).color(p.weak));
            ui.add(egui::Label::new(text).wrap());
        });
    };
    match sheet.kept {
        Some(kept) => row(
            ui,
            "kept",
            format!("{}, at {} Hz", age(kept), number(sheet.rate_hz, 0)),
        ),
        None => row(
            ui,
            "length",
            format!(
                "{} ({} s) at {} Hz, payload {} g",
                minutes(sheet.seconds),
                number(sheet.seconds, 0),
                number(sheet.rate_hz, 0),
                number(1e3 * sheet.payload_kg, 0)
            ),
        ),
    }
    let channels: Vec<String> = sheet
        .groups
        .iter()
        .map(|g| match (g.of, g.present) {
            (1, 1) => g.name.clone(),
            (_, 0) => format!("no {}", g.name),
            _ => format!("{} {}/{}", g.name, g.present, g.of),
        })
        .collect();
    row(ui, "channels", channels.join(" · "));
    let robot = match &sheet.robot {
        RobotMatch::Same => "this robot file".to_owned(),
        RobotMatch::Silent => "not recorded: assumed to be this one".to_owned(),
        RobotMatch::Other { recorded, .. } => format!("another robot file ({recorded})"),
    };
    row(ui, "robot", robot);
}

fn library(ui: &mut Ui, selection: &mut Selection, services: &mut Services) {
    let p = *Palette::in_ui(ui);
    ui.horizontal(|ui| {
        ui.label("Library");
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            if ui
                .button("↻ Refresh")
                .on_hover_text("Look for recordings again")
                .clicked()
            {
                let found = (services.scan)(services.recordings.path());
                selection.scanning.begin(found);
            }
        });
    });
    if selection.library.is_empty() {
        note(
            ui,
            if selection.scanning.is_busy() {
                "Looking for recordings…"
            } else {
                "No recordings yet: type a path above, or use the example."
            },
        );
        return;
    }
    let buttons = 168.0;
    let columns = [56.0, 76.0];
    let name_width =
        (ui.available_width() - buttons - columns.iter().sum::<f32>() - 44.0).max(100.0);
    let mut chosen = None;
    ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        ui.spacing_mut().item_spacing.y = 3.0;
        for entry in &selection.library {
            ui.horizontal(|ui| {
                cell_left(ui, name_width, entry.name.as_str())
                    .on_hover_text(entry.path.display().to_string());
                let length = entry.seconds.map_or("—".into(), minutes);
                cell(ui, columns[0], length).on_hover_text("Length, min:s");
                let source = match entry.simulated {
                    Some(true) => "simulated",
                    Some(false) => "hardware",
                    None => "—",
                };
                cell(ui, columns[1], RichText::new(source).color(p.weak));
                for part in Part::ALL {
                    let used = selection.slots[part as usize].path.text
                        == entry.path.display().to_string();
                    let r = ui
                        .add(Button::selectable(used, part.name()))
                        .accessible_name(format!("Use {} as {} session", entry.name, part.name()))
                        .on_hover_text(format!("Use it as the {} session", part.name()));
                    if r.clicked() {
                        chosen = Some((part, entry.path.clone()));
                    }
                }
            });
        }
    });
    if let Some((part, path)) = chosen {
        selection.slots[part as usize].choose(&path, services);
    }
}

fn run(
    ui: &mut Ui,
    state: &mut GapState,
    live: &View<'_>,
    services: &mut Services,
    commands: &mut Vec<Command>,
) {
    if state.running.is_busy() {
        experiment::under_way(ui, state, live, commands);
        at_work(ui, state, commands);
        return;
    }
    let selection = &mut state.select;
    ui.label(RichText::new("Find what is missing").strong());
    let gate = selection.gate();
    let weaker = selection.slots[0].known().is_none();
    let mut begun = false;
    ui.horizontal(|ui| {
        let button = Button::new(RichText::new("▶ Find").strong()).min_size(vec2(110.0, 32.0));
        if gated(
            ui,
            &gate,
            button,
            "Search for effects that explain the disagreement of simulation and measurement. Takes up to a minute; the twin keeps running.",
        )
        .clicked()
        {
            begun = true;
        }
    });
    if begun {
        state.find(services);
        return;
    }
    if let Err(reason) = &gate {
        note(ui, reason.as_str());
    } else if weaker {
        status(
            ui,
            Level::Warning,
            "No healthy session: the factory model is the baseline, and the verdict is weaker.",
        );
    }
    if let Some(said) = &state.said {
        note(ui, said.as_str());
    }
    ui.separator();
    experiment::begin(ui, state, live, services);
    if state.running.is_busy() {
        return;
    }
    let selection = &mut state.select;
    ui.separator();
    example(ui, selection, services);
}

// The way to have an example made.
fn example(ui: &mut Ui, selection: &mut Selection, services: &mut Services) {
    let making = selection.making.stage();
    ui.horizontal_wrapped(|ui| {
        ui.label(RichText::new("No sessions at hand?").strong());
        if making.is_some() {
            return;
        }
        let text = match selection.examples_made {
            0 => "Use the example",
            _ => "Use another example",
        };
        let hover = "Have two sessions of a virtual rig made: 45 s each, about a second's work";
        if ui.button(text).on_hover_text(hover).clicked() {
            selection.make_example(services);
        }
    });
    note(
        ui,
        "Two sessions of the virtual rig, with an effect hidden in the second. The answer can be revealed after the verdict. Simulated.",
    );
    let Some(stage) = making else { return };
    let mut cancel = false;
    ui.horizontal_wrapped(|ui| {
        ui.spinner();
        note(
            ui,
            match stage.what.is_empty() {
                true => "Making the example…",
                false => &stage.what,
            },
        );
        let hover = "Stop making it; nothing is kept";
        cancel = ui
            .button("Cancel the example")
            .on_hover_text(hover)
            .clicked();
    });
    if cancel {
        selection.making.cancel();
    }
}

// The stages of the finder, how far it is, and Cancel.
fn at_work(ui: &mut Ui, state: &mut GapState, commands: &mut Vec<Command>) {
    let Some(stage) = state.running.stage() else {
        return;
    };
    let p = *Palette::in_ui(ui);
    let at = Stage::ALL.iter().position(|s| s.name() == stage.what);
    ui.label(RichText::new("The finder is running").strong());
    // An experiment does other things besides.
    let searches = at.is_some() || state.conduct.is_none();
    let share = at.map_or(stage.share.unwrap_or(0.0), |i| {
        (i as f32 + stage.share.unwrap_or(0.0)) / Stage::ALL.len() as f32
    });
    ui.add(
        ProgressBar::new(share)
            .desired_width(ui.available_width())
            .fill(p.bar)
            .text(match at {
                Some(i) => format!("stage {} of {}", i + 1, Stage::ALL.len()),
                None => stage.what.clone(),
            }),
    )
    .accessible_name("Progress of the finder");
    ui.spacing_mut().item_spacing.y = 2.0;
    let stages = Stage::ALL.into_iter().filter(|_| searches);
    for (i, s) in stages.enumerate() {
        let (glyph, color) = match at {
            Some(now) if i < now => ("●", p.weak),
            Some(now) if i == now => ("▶", p.text),
            _ => ("○", p.weak),
        };
        let percent = match at {
            Some(now) if i == now => stage
                .share
                .filter(|s| *s > 0.0)
                .map_or(String::new(), |s| format!(", {:.0} %", 100.0 * s)),
            _ => String::new(),
        };
        ui.label(RichText::new(format!("{glyph} {}{percent}", s.name())).color(color));
    }
    ui.add_space(4.0);
    if ui
        .button("Cancel the finder")
        .on_hover_text("Stop looking; the sessions stay chosen")
        .clicked()
    {
        let for_law = state.running.context().is_some_and(|s| s.known.is_some());
        state.end_experiment(commands);
        state.running.cancel();
        state.said = Some(match for_law {
            true => "Cancelled: the finding before it is kept.".into(),
            false => "Cancelled: there is no verdict.".into(),
        });
    }
    heading(
        ui,
        "It takes up to a minute. The twin and STOP stay in operation.",
    );
}
