//! The list of recordings and what can be done with each.

use egui::{Align, Button, Layout, Popup, ProgressBar, RichText, ScrollArea, Ui, vec2};

use super::act::{Act, act_gate};
use super::sort::By;
use super::{Library, Side, Trouble, notes, recording_dialog, rename};
use crate::analysis::player::Player;
use crate::gui::panels::files::Ask;
use crate::gui::panels::widgets::{cell, cell_left, gated, minutes, note, number, status};
use crate::gui::services::{RecordingEntry, Services};
use crate::gui::theme::{Level, Palette};

impl Library {
    /// Which of two recordings that are loaded this is; nothing of others.
    fn sides_of(&self, entry: &RecordingEntry, player: Option<&Player>) -> Vec<Side> {
        let sides = [Side::A, Side::B].into_iter().zip(self.pair.sides(player));
        let is_it =
            |p: Option<&Player>| p.is_some_and(|p| p.about.path.as_ref() == Some(&entry.path));
        sides
            .filter(|(_, p)| is_it(*p))
            .map(|(side, _)| side)
            .collect()
    }
}

/// The list.
pub fn ui(ui: &mut Ui, library: &mut Library, player: &Option<Player>, services: &mut Services) {
    head(ui, library, services);
    elsewhere(ui, library, services);
    // Without one that is played they stand beside the list, with what is known of the selected one.
    if let Some(player) = player {
        actions(ui, library, player, services);
    }
    progress(ui, library);
    library.film.ui(ui);
    Trouble::show_until_closed(&mut library.trouble, ui);
    if library.entries.is_empty() {
        note(
            ui,
            if library.scanning.is_busy() {
                "Looking for recordings…"
            } else {
                "No recordings yet: press ● REC to make one, open one above, or drop a file here."
            },
        );
        return;
    }
    // The details of what is played lie below.
    let height = match player {
        Some(_) => (ui.available_height() * 0.45).max(96.0),
        None => ui.available_height(),
    };
    list(ui, library, height, player.as_ref(), services);
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

fn actions(ui: &mut Ui, library: &mut Library, player: &Player, services: &mut Services) {
    let chosen = library.selected_entry().cloned();
    let mut wanted = None;
    ui.horizontal_wrapped(|ui| {
        for act in [
            Act::Load(Side::A),
            Act::Load(Side::B),
            Act::Video,
            Act::Rerun,
        ] {
            let gate = match &chosen {
                Some(entry) => act_gate(library, entry, Some(player), act),
                None => Err("Select a recording first.".to_owned()),
            };
            if gated(ui, &gate, Button::new(act.name()), act.hover()).clicked() {
                wanted = Some(act);
            }
        }
    });
    if let (Some(act), Some(entry)) = (wanted, chosen) {
        library.act(act, &entry.path, services);
    }
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

/// Widths of the columns behind the name, points; a column that does not fit is 0.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Columns {
    name: f32,
    date: f32,
    length: f32,
    size: f32,
    source: f32,
    note: f32,
}

/// Between two columns, points.
const GAP: f32 = 6.0;
/// Width of what is loaded, new or being recorded, points.
const STATE: f32 = 38.0;
/// Width of the button with the menu of a row, points.
const MORE: f32 = 26.0;
/// A name is at least so wide; columns give way to it, points.
const NAME: f32 = 120.0;
/// A note has a column of its own where it gets so wide, points.
const NOTE: f32 = 180.0;
/// Before the column of notes, which begins where another one ends, points.
const BEFORE_NOTE: f32 = 10.0;
/// Rows so far out of sight are laid out, points.
const BESIDE: f32 = 300.0;
/// Margin of the name within its button, points.
const INSET: f32 = 10.0;

impl Columns {
    /// What fits. The size gives way first, then the source and the length.
    fn of(width: f32) -> Self {
        let mut all = Self {
            name: 0.0,
            date: 118.0,
            length: 50.0,
            size: 66.0,
            source: 70.0,
            note: 0.0,
        };
        // The bar of the list stands at its right.
        let rest = |c: &Self| {
            let shown = [c.date, c.length, c.size, c.source].into_iter();
            let taken: f32 = shown.filter(|w| *w > 0.0).map(|w| w + GAP).sum();
            width - taken - STATE - MORE - 3.0 * GAP - 12.0
        };
        let give_way: [fn(&mut Self) -> &mut f32; 3] =
            [|c| &mut c.size, |c| &mut c.source, |c| &mut c.length];
        for column in give_way {
            if rest(&all) < NAME {
                *column(&mut all) = 0.0;
            }
        }
        let rest = rest(&all);
        // Half of what is left, where both are wide then.
        all.note = match 0.5 * (rest - GAP - BEFORE_NOTE) {
            half if half >= NOTE => half,
            _ => 0.0,
        };
        let taken = match all.note > 0.0 {
            true => all.note + GAP + BEFORE_NOTE,
            false => 0.0,
        };
        all.name = (rest - taken).max(60.0);
        all
    }
}

fn list(
    ui: &mut Ui,
    library: &mut Library,
    height: f32,
    player: Option<&Player>,
    services: &mut Services,
) {
    let columns = Columns::of(ui.available_width());
    let top = ui.cursor().top();
    heads(ui, library, &columns);
    let mut asked = None;
    let mut selected = None;
    let rest = (height - (ui.cursor().top() - top)).max(60.0);
    let entries = std::mem::take(&mut library.entries);
    let mut heights = std::mem::take(&mut library.heights);
    ScrollArea::vertical()
        .id_salt("library")
        .auto_shrink([false, true])
        .max_height(rest)
        .show(ui, |ui| {
            ui.spacing_mut().item_spacing.y = 2.0;
            let found = |e: &&RecordingEntry| notes::is_found(e, &library.search);
            let shown: Vec<&RecordingEntry> = entries.iter().filter(found).collect();
            if shown.is_empty() {
                note(ui, "Nothing is found: shorten what is searched for.");
            }
            heights.resize(shown.len(), f32::INFINITY);
            for (entry, height) in shown.into_iter().zip(&mut heights) {
                // What is out of sight keeps its place and costs nothing.
                let top = ui.cursor().top();
                let seen = ui.clip_rect().y_range().expand(BESIDE);
                let away = top + *height < seen.min || (top > seen.max && height.is_finite());
                if away && !library.renaming.is_of(&entry.path) {
                    ui.add_space(*height);
                    continue;
                }
                let (row, act) = row(ui, library, entry, player, &columns);
                if row.clicked() {
                    selected = Some(entry.path.clone());
                }
                let act = act.or_else(|| row.double_clicked().then_some(Act::Load(Side::A)));
                asked = act.map(|act| (act, entry.path.clone())).or(asked.take());
                below(ui, library, entry, &columns);
                if library.renaming.is_of(&entry.path) {
                    rename::ui(ui, library, entry, player, services);
                }
                *height = ui.cursor().top() - top;
            }
        });
    library.entries = entries;
    library.heights = heights;
    if let Some(path) = selected {
        library.select(&path);
    }
    if let Some((act, path)) = asked {
        library.select(&path);
        library.act(act, &path, services);
    }
}

/// The heads of the columns; those of name and date order the list.
fn heads(ui: &mut Ui, library: &mut Library, columns: &Columns) {
    let p = *Palette::in_ui(ui);
    let small = |t: &str| RichText::new(t).small().color(p.weak);
    let mut pressed = None;
    ui.horizontal(|ui| {
        ui.spacing_mut().interact_size.y = 16.0;
        ui.spacing_mut().item_spacing.x = GAP;
        ui.add_space(INSET);
        for (by, text, width, name, hover) in [
            (
                By::Name,
                "name",
                columns.name - INSET,
                "Sort by name",
                "Order the list by name; again: the other way round",
            ),
            (
                By::Date,
                "date (local)",
                columns.date,
                "Sort by date",
                "Order the list by when recordings began, newest first; again: oldest first",
            ),
        ] {
            let text = small(&format!("{text}{}", library.sort.arrow(by)));
            let button = Button::new(text).frame(false).right_text("");
            let head = ui.add_sized(vec2(width, 18.0), button);
            if head.accessible_name(name).on_hover_text(hover).clicked() {
                pressed = Some(by);
            }
            if by == By::Name {
                ui.add_space(STATE + GAP);
            }
        }
        for (width, text) in [
            (columns.length, "length"),
            (columns.size, "size"),
            (columns.source, "source"),
        ] {
            if width > 0.0 {
                cell(ui, width, small(text));
            }
        }
        if columns.note > 0.0 {
            ui.add_space(BEFORE_NOTE);
            cell_left(ui, columns.note, small("note and marks"));
        }
    });
    if let Some(by) = pressed {
        library.sort_by(library.sort.pressed(by));
    }
}

/// A row, and what was chosen in its menu.
fn row(
    ui: &mut Ui,
    library: &Library,
    entry: &RecordingEntry,
    player: Option<&Player>,
    columns: &Columns,
) -> (egui::Response, Option<Act>) {
    let p = *Palette::in_ui(ui);
    let mut act = None;
    let row = ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = GAP;
        let selected = library.selected.as_ref() == Some(&entry.path);
        // An empty text on the right keeps the name on the left.
        let size = vec2(columns.name, 26.0);
        let button = Button::selectable(selected, short_name(entry))
            .right_text("")
            .truncate()
            .min_size(size);
        let r = ui
            .add_sized(size, button)
            .accessible_name(entry.name.as_str())
            .on_hover_text(row_hover(entry));
        state(ui, library, entry, player);
        cell_left(
            ui,
            columns.date,
            RichText::new(date_text(entry)).color(p.weak),
        );
        if columns.length > 0.0 {
            let seconds = match library.is_under_way(entry) {
                true => library.rec.lasted_s,
                false => entry.seconds,
            };
            cell(ui, columns.length, seconds.map_or("—".into(), minutes));
        }
        if columns.size > 0.0 {
            cell(ui, columns.size, size_text(entry.bytes));
        }
        if columns.source > 0.0 {
            cell(
                ui,
                columns.source,
                RichText::new(source_text(entry)).color(p.weak),
            );
        }
        if columns.note > 0.0 {
            ui.add_space(BEFORE_NOTE);
            let text = entry.noted.join(" · ").replace('\n', " ");
            let label = cell_left(ui, columns.note, RichText::new(text).color(p.weak));
            if !entry.noted.is_empty() {
                label.on_hover_text(entry.noted.join("\n"));
            }
        }
        let more = ui
            .add(Button::new("⋯").min_size(vec2(MORE, 22.0)))
            .accessible_name(format!("More for {}", entry.name))
            .on_hover_text(
                "What can be done with this recording; also by a right click on its name",
            );
        Popup::menu(&more)
            .accessible_name(format!("Menu of {}", entry.name))
            .show(|ui| act = menu(ui, library, entry, player));
        r
    });
    let row = row.inner;
    row.context_menu(|ui| act = menu(ui, library, entry, player).or(act));
    (row, act)
}

/// The menu of a row; what was chosen.
fn menu(
    ui: &mut Ui,
    library: &Library,
    entry: &RecordingEntry,
    player: Option<&Player>,
) -> Option<Act> {
    let mut chosen = None;
    for act in Act::ALL {
        let gate = act_gate(library, entry, player, act);
        if gated(ui, &gate, Button::new(act.name()), act.hover()).clicked() {
            chosen = Some(act);
            ui.close();
        }
    }
    chosen
}

/// What is loaded, new or being recorded.
fn state(ui: &mut Ui, library: &Library, entry: &RecordingEntry, player: Option<&Player>) {
    let p = *Palette::in_ui(ui);
    let sides = library.sides_of(entry, player);
    let (text, color, hover) = match sides.as_slice() {
        _ if library.is_under_way(entry) => ("● REC", p.critical, "It is being recorded"),
        [Side::A, Side::B, ..] => ("A B", p.text, "Loaded as A and as B"),
        [Side::A] => ("A", p.text, "Loaded as A"),
        [Side::B] => ("B", p.text, "Loaded as B"),
        _ if library.fresh.contains(&entry.path) => (
            "● new",
            p.text,
            "It has appeared while this window was open",
        ),
        _ => ("", p.weak, ""),
    };
    let text = RichText::new(text).small().strong().color(color);
    let label = cell_left(ui, STATE, text);
    if !hover.is_empty() {
        label.on_hover_text(hover);
    }
}

/// What stands below a row: what was noted, where it has no column, and what is unusual.
fn below(ui: &mut Ui, library: &Library, entry: &RecordingEntry, columns: &Columns) {
    if columns.note == 0.0 {
        notes::remark(ui, entry);
    }
    let text = match library.is_under_way(entry) {
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

/// Length of the date and time in front of a name, with what separates them: `2026-11-23_14-05-12_`.
const DATED: usize = 20;

/// The name without the date in front of it, where that is in a column of its own and something else is left.
fn short_name(entry: &RecordingEntry) -> &str {
    let is_dated = |date: &str| {
        let digits = date.chars().filter(char::is_ascii_digit).count();
        let others = date.chars().filter(|c| "-_".contains(*c)).count();
        (digits, others) == (14, 6) && date.ends_with('_')
    };
    let name = entry.name.as_str();
    match (&entry.begun, name.split_at_checked(DATED)) {
        (Some(_), Some((date, rest))) if is_dated(date) && !rest.is_empty() => rest,
        _ => name,
    }
}

/// Local date and time at which a recording began.
pub fn date_text(entry: &RecordingEntry) -> String {
    let begun = entry.begun.as_ref();
    begun.map_or_else(|| "—".to_owned(), |b| b.local.clone())
}

/// Where the data of a recording come from.
pub fn source_text(entry: &RecordingEntry) -> &'static str {
    match entry.simulated {
        _ if entry.sample => "sample",
        Some(true) => "simulated",
        Some(false) => "hardware",
        None => "—",
    }
}

/// All that is known of a row, also what its columns have no space for.
fn row_hover(entry: &RecordingEntry) -> String {
    format!(
        "{}\nBegan {} (local), length {} min:s, {}, {}",
        entry.path.display(),
        date_text(entry),
        entry.seconds.map_or("—".into(), minutes),
        size_text(entry.bytes),
        source_text(entry)
    )
}

/// A size in kB, MB or GB.
pub fn size_text(bytes: u64) -> String {
    match bytes as f64 / 1e3 {
        kb if kb < 1e3 => format!("{} kB", number(kb, 0)),
        kb if kb < 1e6 => format!("{} MB", number(kb / 1e3, 1)),
        kb => format!("{} GB", number(kb / 1e6, 1)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_give_way_to_the_name_and_a_note_gets_one_where_it_fits() {
        let wide = Columns::of(1200.0);
        assert!(wide.note >= NOTE && wide.name >= NOTE && wide.size > 0.0);
        let middle = Columns::of(600.0);
        assert!(middle.note == 0.0 && middle.source > 0.0 && middle.name >= NAME);
        let narrow = Columns::of(402.0);
        assert!(narrow.size == 0.0 && narrow.date > 0.0, "{narrow:?}");
        for columns in [wide, middle, narrow] {
            let Columns {
                name,
                date,
                length,
                size,
                source,
                note,
            } = columns;
            assert!(name >= 120.0, "{columns:?}");
            let all = name + date + length + size + source + note;
            assert!(all < 1200.0);
        }
    }

    #[test]
    fn a_name_stands_without_the_date_that_is_beside_it() {
        let short = |name: &str, is_dated: bool| {
            let begun = is_dated.then(|| crate::gui::services::Begun {
                unix_s: 0,
                local: String::new(),
            });
            let entry = RecordingEntry {
                name: name.into(),
                begun,
                ..RecordingEntry::default()
            };
            short_name(&entry).to_owned()
        };
        assert_eq!(short("2026-11-23_14-05-12_leak-3", true), "leak-3");
        for (name, is_dated) in [
            ("2026-11-23_14-05-12_leak-3", false),
            ("2026-11-23_14-05-12", true),
            ("2026-11-23_14-05-12-2", true),
            ("point-to-point-again-and-again", true),
            ("äöüäöüäöüäöüäöüäöü", true),
        ] {
            assert_eq!(short(name, is_dated), name);
        }
    }

    #[test]
    fn sizes_have_the_unit_that_fits() {
        let texts = [412_000, 1_240_000, 57_300_000_000].map(size_text);
        assert_eq!(texts, ["412 kB", "1.2 MB", "57.3 GB"]);
    }
}
