//! The Recordings screen: record, list, play, open elsewhere.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, TryRecvError};

use egui::{Align, Button, Layout, RichText, ScrollArea, Slider, Ui, vec2};

use super::View;
use super::player::{AtEnd, Player};
use super::plot::{AXIS, Legend, Series, TimeAxis, TimePlot, TimeWindow};
use super::sensors::card;
use super::shell::recording_gate;
use super::widgets::{cell, cell_left, gated, heading, minutes, note, number, status};
use crate::gui::history::{Channel, POSE_NAMES};
use crate::gui::services::{RecordingEntry, Services};
use crate::gui::theme::{Level, Palette};
use crate::signal::Trace;
use crate::twin::Command;

/// The list of recordings and what is being done with it.
#[derive(Default)]
pub struct Library {
    /// What was found, newest first.
    pub entries: Vec<RecordingEntry>,
    /// The selected recording.
    pub selected: Option<PathBuf>,
    /// What went wrong last: one sentence.
    pub error: Option<String>,
    scanned: bool,
    scanning: Option<Receiver<Result<Vec<RecordingEntry>, String>>>,
    loading: Option<(String, Receiver<Result<Trace, String>>)>,
}

impl Library {
    /// Looks for recordings again.
    pub fn rescan(&mut self, services: &mut Services) {
        self.scanned = true;
        self.scanning = Some((services.scan)());
    }

    /// Whether something is awaited.
    pub fn busy(&self) -> bool {
        self.scanning.is_some() || self.loading.is_some()
    }

    /// Takes what has come; returns a player when a recording is loaded.
    pub fn poll(&mut self) -> Option<Player> {
        if let Some(rx) = &self.scanning {
            match rx.try_recv() {
                Ok(Ok(entries)) => {
                    self.entries = entries;
                    self.error = None;
                    self.scanning = None;
                }
                Ok(Err(e)) => {
                    self.error = Some(e);
                    self.scanning = None;
                }
                Err(TryRecvError::Disconnected) => self.scanning = None,
                Err(TryRecvError::Empty) => {}
            }
        }
        let (name, rx) = self.loading.as_ref()?;
        let result = match rx.try_recv() {
            Ok(r) => r,
            Err(TryRecvError::Empty) => return None,
            Err(TryRecvError::Disconnected) => Err(format!("{name} could not be loaded.")),
        };
        let name = name.clone();
        self.loading = None;
        match result {
            Ok(trace) => {
                self.error = None;
                let player = Player::new(trace);
                if player.is_none() {
                    self.error = Some(format!("{name} holds no data: nothing to play."));
                }
                player
            }
            Err(e) => {
                self.error = Some(e);
                None
            }
        }
    }
}

/// What the screen is given.
pub struct RecordingsInput<'a> {
    /// The live twin's view.
    pub live: View<'a>,
    /// Seconds the running recording has lasted.
    pub recording_s: Option<f64>,
    /// Whether there is no twin.
    pub twin_gone: bool,
}

/// The screen. The player's window of time is that of all plots.
pub fn ui(
    ui: &mut Ui,
    input: &RecordingsInput<'_>,
    library: &mut Library,
    player: &mut Option<Player>,
    services: &mut Services,
    commands: &mut Vec<Command>,
) {
    if !library.scanned {
        library.rescan(services);
    }
    ui.horizontal_top(|ui| {
        let height = ui.available_height();
        let left = (ui.available_width() * 0.48).clamp(420.0, 760.0);
        ui.allocate_ui(vec2(left, height), |ui| {
            card(ui, |ui| {
                ui.set_min_size(ui.available_size());
                record(ui, input, services, commands);
                ui.separator();
                list(ui, library, services);
            });
        });
        ui.vertical(|ui| {
            card(ui, |ui| {
                ui.set_min_size(ui.available_size());
                playing(ui, input, library, player);
            });
        });
    });
}

fn record(
    ui: &mut Ui,
    input: &RecordingsInput<'_>,
    services: &mut Services,
    commands: &mut Vec<Command>,
) {
    let gate = recording_gate(&input.live, input.twin_gone);
    let p = *Palette::in_ui(ui);
    ui.horizontal(|ui| match &input.live.snapshot.recording {
        Some(name) => {
            let button = Button::new("■ End recording").min_size(vec2(0.0, 32.0));
            if gated(ui, &gate, button, "Close the file").clicked() {
                commands.push(Command::StopRecording);
            }
            ui.label(
                RichText::new(format!("● {}", minutes(input.recording_s.unwrap_or(0.0))))
                    .color(p.critical),
            )
            .on_hover_text("Time since the recording began, min:s");
            note(ui, name.as_str());
        }
        None => {
            let button = Button::new("● Record").min_size(vec2(0.0, 32.0));
            if gated(
                ui,
                &gate,
                button,
                "Write everything the live twin knows to a file",
            )
            .clicked()
            {
                commands.push(Command::StartRecording((services.default_recording)()));
            }
            note(ui, "Records the live twin, also while a replay is shown.");
        }
    });
}

fn list(ui: &mut Ui, library: &mut Library, services: &mut Services) {
    let p = *Palette::in_ui(ui);
    ui.horizontal(|ui| {
        ui.label("Library");
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            if ui
                .button("↻ Refresh")
                .on_hover_text("Look for recordings again")
                .clicked()
            {
                library.rescan(services);
            }
            let chosen = library.selected.clone();
            let gate = match &chosen {
                Some(_) => Ok(()),
                None => Err("Select a recording first.".to_owned()),
            };
            if gated(
                ui,
                &gate,
                Button::new("Open in Rerun"),
                "Show the selected recording in the Rerun viewer",
            )
            .clicked()
                && let Some(path) = &chosen
                && let Err(e) = (services.open_in_rerun)(path)
            {
                library.error = Some(e);
            }
            let gate = if library.loading.is_some() {
                Err("A recording is being loaded.".to_owned())
            } else {
                gate
            };
            if gated(
                ui,
                &gate,
                Button::new("Load and play"),
                "Load the selected recording and play it",
            )
            .clicked()
                && let Some(path) = &chosen
            {
                library.load(path.clone(), services);
            }
        });
    });
    if let Some(e) = &library.error {
        status(ui, Level::Warning, e);
    }
    if let Some((name, _)) = &library.loading {
        let text = format!("Loading {name}…");
        let mut cancel = false;
        ui.horizontal(|ui| {
            ui.spinner();
            note(ui, text);
            cancel = ui.button("Cancel loading").clicked();
        });
        if cancel {
            library.loading = None;
        }
    }
    if library.entries.is_empty() {
        note(
            ui,
            if library.scanning.is_some() {
                "Looking for recordings…"
            } else {
                "No recordings yet: press Record to make one."
            },
        );
        return;
    }
    let columns = [62.0, 72.0, 84.0];
    let name_width = (ui.available_width() - columns.iter().sum::<f32>() - 5.0 * 8.0).max(120.0);
    let head = |t: &str| RichText::new(t).small().color(p.weak);
    ui.horizontal(|ui| {
        ui.add_space(10.0);
        cell_left(ui, name_width - 10.0, head("name"));
        cell(ui, columns[0], head("length"));
        cell(ui, columns[1], head("size"));
        cell(ui, columns[2], head("source"));
    });
    let mut open = None;
    ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        ui.spacing_mut().item_spacing.y = 2.0;
        for entry in &library.entries {
            let selected = library.selected.as_ref() == Some(&entry.path);
            let row = ui.horizontal(|ui| {
                // An empty text on the right keeps the name on the left.
                let button = Button::selectable(selected, entry.name.as_str())
                    .right_text("")
                    .truncate()
                    .min_size(vec2(name_width, 28.0));
                let r = ui
                    .add_sized(vec2(name_width, 28.0), button)
                    .accessible_name(entry.name.as_str())
                    .on_hover_text(entry.path.display().to_string());
                cell(ui, columns[0], entry.seconds.map_or("—".into(), minutes));
                cell(ui, columns[1], size_text(entry.bytes));
                let source = match entry.simulated {
                    Some(true) => "simulated",
                    Some(false) => "hardware",
                    None => "—",
                };
                cell(ui, columns[2], RichText::new(source).color(p.weak));
                r
            });
            if row.inner.clicked() {
                library.selected = Some(entry.path.clone());
            }
            if row.inner.double_clicked() {
                open = Some(entry.path.clone());
            }
            if let Some(text) = &entry.note {
                ui.horizontal(|ui| {
                    ui.add_space(12.0);
                    status(ui, Level::Warning, text);
                });
            }
        }
    });
    if let Some(path) = open {
        library.load(path, services);
    }
}

impl Library {
    fn load(&mut self, path: PathBuf, services: &mut Services) {
        let name = path
            .file_name()
            .map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        self.error = None;
        self.loading = Some((name, (services.load)(&path)));
        self.selected = Some(path);
    }
}

fn size_text(bytes: u64) -> String {
    let kb = bytes as f64 / 1e3;
    if kb < 1e3 {
        format!("{} kB", number(kb, 0))
    } else {
        format!("{} MB", number(kb / 1e3, 1))
    }
}

fn playing(
    ui: &mut Ui,
    input: &RecordingsInput<'_>,
    library: &Library,
    player: &mut Option<Player>,
) {
    let Some(p) = player else {
        super::widgets::empty(
            ui,
            "Nothing is played",
            if library.entries.is_empty() {
                "Record something, then play it here."
            } else {
                "Select a recording and press Load and play. All screens then show it."
            },
        );
        return;
    };
    ui.label(RichText::new(p.title()).heading());
    let duration = p.duration_s();
    let mut close = false;
    ui.horizontal(|ui| {
        let (text, hover) = if p.playing {
            ("▮▮ Pause", "Pause (Space)")
        } else {
            ("▶ Play", "Play (Space)")
        };
        let button = Button::new(text).min_size(vec2(84.0, 30.0));
        if ui
            .add(button)
            .accessible_name("Play or pause")
            .on_hover_text(hover)
            .clicked()
        {
            p.toggle();
        }
        if ui
            .add(Button::new("⇤").min_size(vec2(32.0, 30.0)))
            .accessible_name("Back to the start")
            .on_hover_text("Back to the start")
            .clicked()
        {
            p.position_s = 0.0;
        }
        egui::ComboBox::from_id_salt("speed")
            .selected_text(format!("{}×", p.speed))
            .width(64.0)
            .show_ui(ui, |ui| {
                for s in [0.25, 0.5, 1.0, 2.0, 5.0, 10.0] {
                    ui.selectable_value(&mut p.speed, s, format!("{s}×"));
                }
            })
            .response
            .accessible_name("Speed")
            .on_hover_text("Seconds of recording per second");
        let mut looped = p.at_end == AtEnd::Loop;
        if ui
            .checkbox(&mut looped, "Loop")
            .on_hover_text("Begin again at the end")
            .changed()
        {
            p.at_end = if looped { AtEnd::Loop } else { AtEnd::Stop };
        }
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            close = ui
                .button("Close")
                .accessible_name("Close the recording")
                .on_hover_text("Show the live twin again")
                .clicked();
            note(
                ui,
                format!("{} of {}", minutes(p.position_s), minutes(duration)),
            );
        });
    });
    ui.scope(|ui| {
        ui.spacing_mut().slider_width = ui.available_width();
        ui.add(
            Slider::new(&mut p.position_s, 0.0..=duration.max(1e-3))
                .show_value(false)
                .trailing_fill(true),
        )
        .accessible_name("Position in the recording, s")
        .on_hover_text("Position in the recording, s");
    });
    let snapshot = p.snapshot();
    let end_s = p.now_s() - p.position_s + duration;
    // The whole recording, with the position as a line.
    let whole = View {
        snapshot,
        history: p.history(),
        now_s: end_s,
        replay: Some(&p.trace().name),
        spec: input.live.spec,
    };
    let mut window = TimeWindow {
        span_s: duration.max(1.0),
        frozen_end_s: None,
    };
    heading(ui, "The whole recording");
    let axis = AXIS;
    let height = (ui.available_height() - axis) / 3.0 - ui.spacing().item_spacing.y;
    for (i, name) in POSE_NAMES.iter().take(3).enumerate() {
        let last = i == 2;
        TimePlot {
            title: &format!("{name} / mm"),
            series: &[
                Series::solid(Channel::Tip(i), "predicted"),
                Series::dashed(Channel::Truth(i), whole.truth_name()),
            ],
            min_span: 2.0,
            emphasis: &[],
            time_axis: if last {
                TimeAxis::Shown
            } else {
                TimeAxis::Hidden
            },
            legend: if i == 0 {
                Legend::Shown
            } else {
                Legend::Hidden
            },
            playhead_s: Some(p.now_s()),
        }
        .show(
            ui,
            &whole,
            &mut window,
            height + if last { axis } else { 0.0 },
        );
    }
    if close {
        *player = None;
    }
}
