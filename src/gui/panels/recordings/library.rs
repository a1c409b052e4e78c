//! The list of recordings and its buttons.

use egui::{Align, Button, Layout, ProgressBar, RichText, ScrollArea, Ui, vec2};

use super::{Library, Side, Trouble, notes, recording_dialog};
use crate::gui::panels::files::Ask;
use crate::gui::panels::widgets::{cell, cell_left, gated, minutes, note, number, status};
use crate::gui::services::{RecordingEntry, Services};
use crate::gui::theme::{Level, Palette};

/// The list.
pub fn ui(ui: &mut Ui, library: &mut Library, details: bool, services: &mut Services) {
    head(ui, library, services);
    elsewhere(ui, library, services);
    actions(ui, library, services);
    progress(ui, library);
    Trouble::show_until_closed(&mut library.trouble, ui);
    if library.entries.is_empty() {
        note(
            ui,
            if library.scanning.is_busy() {
                "Looking for recordings…"
            } else {
                "No recordings yet: press Record to make one, open one above, or drop a file here."
            },
        );
        return;
    }
    // The details of what is played lie below.
    let height = if details {
        (ui.available_height() * 0.45).max(96.0)
    } else {
        ui.available_height()
    };
    list(ui, library, height, services);
}

fn head(ui: &mut Ui, library: &mut Library, services: &mut Services) {
    ui.horizontal(|ui| {
        ui.label("Library");
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            let looking = library.scanning.is_busy();
            if ui
                .button("↻ Refresh")
                .on_hover_text("Look for recordings again")
                .clicked()
            {
                library.rescan(services);
            }
            if looking {
                ui.spinner();
            }
            notes::search(ui, &mut library.search);
        });
    });
}

// A recording that lies elsewhere.
fn elsewhere(ui: &mut Ui, library: &mut Library, services: &mut Services) {
    let ask = Ask {
        name: "Path of a recording",
        hint: "a recording elsewhere: .rrd, session folder, .toml, .csv",
        hover: "Path of a recording (.rrd) or a session log (folder, .toml, .csv); Enter plays it as A",
        browse: "Browse…",
        right: 0.0,
    };
    let chosen = ui
        .horizontal(|ui| library.open.ui(ui, &ask, recording_dialog, services))
        .inner;
    library.open.trouble(ui);
    if let Some(path) = chosen {
        library.play(path, services);
    }
}

fn actions(ui: &mut Ui, library: &mut Library, services: &mut Services) {
    let chosen = library.selected.clone();
    let gate = match &chosen {
        Some(_) => Ok(()),
        None => Err("Select a recording first.".to_owned()),
    };
    ui.horizontal_wrapped(|ui| {
        for (side, text, hover) in [
            (
                Side::A,
                "Load and play",
                "Load the selected recording as A and play it on all screens",
            ),
            (
                Side::B,
                "Load as B",
                "Load the selected recording as B, to compare it with A",
            ),
        ] {
            let gate = match library.is_loading(side) {
                true => Err(format!("A recording is being loaded as {}.", side.name())),
                false => gate.clone(),
            };
            if gated(ui, &gate, Button::new(text), hover).clicked()
                && let Some(path) = &chosen
            {
                library.load(path.clone(), (side, side == Side::B), services);
            }
        }
        let hover = "Show the selected recording in the Rerun viewer";
        if gated(ui, &gate, Button::new("Open in Rerun"), hover).clicked()
            && let Some(path) = &chosen
        {
            library.opening.begin((services.open_in_rerun)(path));
        }
    });
}

fn progress(ui: &mut Ui, library: &mut Library) {
    let mut cancelled = None;
    for (k, loading) in library.loading.iter().enumerate() {
        let (Some(of), Some(stage)) = (loading.context(), loading.stage()) else {
            continue;
        };
        let side = of.side.name();
        let text = format!("Loading {} as {side}… {}", of.name, stage.what);
        let text = RichText::new(text).color(Palette::in_ui(ui).weak);
        ui.add(egui::Label::new(text).truncate());
        ui.horizontal(|ui| {
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                let hover = "Nothing changes: what was shown before stays";
                if ui.button("Cancel loading").on_hover_text(hover).clicked() {
                    cancelled = Some(k);
                }
                match stage.share {
                    Some(share) => {
                        let width = ui.available_width();
                        ui.add(
                            ProgressBar::new(share)
                                .desired_width(width)
                                .show_percentage(),
                        );
                    }
                    None => {
                        ui.spinner();
                    }
                }
            });
        });
    }
    if let Some(k) = cancelled {
        library.loading.remove(k);
    }
}

fn list(ui: &mut Ui, library: &mut Library, height: f32, services: &mut Services) {
    let p = *Palette::in_ui(ui);
    let columns = [56.0, 70.0, 76.0];
    let name_width = (ui.available_width() - columns.iter().sum::<f32>() - 5.0 * 8.0).max(120.0);
    let head = |t: &str| RichText::new(t).small().color(p.weak);
    let top = ui.cursor().top();
    ui.horizontal(|ui| {
        ui.spacing_mut().interact_size.y = 16.0;
        ui.add_space(10.0);
        cell_left(ui, name_width - 10.0, head("name"));
        cell(ui, columns[0], head("length"));
        cell(ui, columns[1], head("size"));
        cell(ui, columns[2], head("source"));
    });
    let mut open = None;
    let rest = (height - (ui.cursor().top() - top)).max(60.0);
    ScrollArea::vertical()
        .id_salt("library")
        .auto_shrink([false, true])
        .max_height(rest)
        .show(ui, |ui| {
            ui.spacing_mut().item_spacing.y = 2.0;
            let found = |e: &&RecordingEntry| notes::is_found(e, &library.search);
            if !library.entries.iter().any(|e| found(&e)) {
                note(ui, "Nothing is found: shorten what is searched for.");
            }
            for entry in library.entries.iter().filter(found) {
                let selected = library.selected.as_ref() == Some(&entry.path);
                let row = row(ui, entry, selected, name_width, columns);
                if row.clicked() {
                    library.selected = Some(entry.path.clone());
                }
                if row.double_clicked() {
                    open = Some(entry.path.clone());
                }
                notes::remark(ui, entry);
                let growing = library.under_way.is_some()
                    && library.under_way.as_deref()
                        == entry.path.file_stem().and_then(|s| s.to_str());
                let text = match growing {
                    true => Some("Being recorded: complete once the recording has ended."),
                    false => entry.note.as_deref(),
                };
                if let Some(text) = text {
                    ui.horizontal_wrapped(|ui| {
                        ui.add_space(12.0);
                        status(ui, Level::Warning, text);
                    });
                }
            }
        });
    if let Some(path) = open {
        library.play(path, services);
    }
}

fn row(
    ui: &mut Ui,
    entry: &RecordingEntry,
    selected: bool,
    name_width: f32,
    columns: [f32; 3],
) -> egui::Response {
    let p = *Palette::in_ui(ui);
    ui.horizontal(|ui| {
        // An empty text on the right keeps the name on the left.
        let button = Button::selectable(selected, entry.name.as_str())
            .right_text("")
            .truncate()
            .min_size(vec2(name_width, 26.0));
        let r = ui
            .add_sized(vec2(name_width, 26.0), button)
            .accessible_name(entry.name.as_str())
            .on_hover_text(entry.path.display().to_string());
        cell(ui, columns[0], entry.seconds.map_or("—".into(), minutes));
        cell(ui, columns[1], size_text(entry.bytes));
        let source = match entry.simulated {
            _ if entry.sample => "sample",
            Some(true) => "simulated",
            Some(false) => "hardware",
            None => "—",
        };
        cell(ui, columns[2], RichText::new(source).color(p.weak));
        r
    })
    .inner
}

pub(super) fn size_text(bytes: u64) -> String {
    let kb = bytes as f64 / 1e3;
    if kb < 1e3 {
        format!("{} kB", number(kb, 0))
    } else {
        format!("{} MB", number(kb / 1e3, 1))
    }
}
