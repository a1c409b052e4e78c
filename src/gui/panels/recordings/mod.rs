//! The Recordings screen: list, play, compare, look inside, rename, open elsewhere.

mod act;
mod details;
mod film;
mod folder;
mod library;
mod notes;
mod pair;
mod rename;
mod rolling;
mod selected;
mod shown;
mod sort;
mod typed;

use std::path::{Path, PathBuf};

use egui::{Ui, vec2};

use super::operating::recording_gate;
use super::widgets::pane;
use crate::analysis::findings::Findings;
use crate::analysis::player::Player;
use crate::gui::panels::files::PathField;
use crate::gui::panels::plot::TimeWindow;
use crate::gui::services::gap::Part;
use crate::gui::services::{Dialog, DialogKind, Job, Pending, RecordingEntry, Services};
use crate::gui::theme::Palette;
use crate::gui::view::{Gate, View};
use crate::twin::Command;
use pair::Pair;

pub use super::trouble::Trouble;
pub use act::{Act, act_gate};
pub use library::size_text;
pub use notes::{mark_gate, mark_now};
pub use pair::{Compared, Quantity, Side};
pub use rolling::{in_strip, keep, keep_gate};
pub use shown::played_title;
pub use sort::{By, Sort};
pub use typed::{LONGEST, RecState};

/// What a recording is loaded for.
struct Loading {
    name: String,
    side: Side,
    /// Whether it is to be compared with the other one.
    compared: bool,
}

/// What the lower left shows about the recording that is played.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Detail {
    /// Its log.
    #[default]
    Events,
    /// Channels, gaps, what is missing.
    Contents,
    /// The operator's note and the marks.
    Notes,
}

/// The list of recordings and what is being done with it.
#[derive(Default)]
pub struct Library {
    /// What was found, in the order of the list.
    pub entries: Vec<RecordingEntry>,
    /// The order of the list.
    pub sort: Sort,
    /// REC in the top bar: what is typed for a recording.
    pub rec: RecState,
    /// What the Gap screen is to use, and as what.
    pub for_gap: Option<(Part, PathBuf)>,
    /// A recording has another name: where it was and where it is.
    pub renamed: Option<[PathBuf; 2]>,
    /// The selected recording.
    pub selected: Option<PathBuf>,
    /// What went wrong last.
    pub trouble: Option<Trouble>,
    /// The viewer of the running twin.
    pub viewer: super::rerun::LiveViewer,
    /// Two recordings beside each other.
    pub pair: Pair,
    /// What is shown about the recording that is played.
    pub detail: Detail,
    /// Name of the recording that is being written.
    pub under_way: Option<String>,
    /// Whether a recording has ended since the folder was read.
    pub has_new: bool,
    scanned: bool,
    scanning: Pending<Vec<RecordingEntry>>,
    /// Recordings that have appeared since the list was first shown, until they are selected.
    fresh: Vec<PathBuf>,
    /// Whether the folder has been read.
    listed: bool,
    /// Heights of the rows of the list, points.
    heights: Vec<f32>,
    /// Number of the frame in which the screen was shown last.
    shown_in: u64,
    preview: selected::Preview,
    renaming: rename::Renaming,
    loading: Vec<Pending<Player, Loading>>,
    /// A part of the recording that is played, at its full rate: of which file, from when to when, s.
    near: Pending<Player, (PathBuf, [f64; 2])>,
    /// Where the position was when it was last looked at, and whether more shall be read once it rests there, s.
    looked_at_s: (f64, bool),
    opening: Pending<()>,
    naming: Pending<PathBuf>,
    open: PathField,
    choice: folder::Choice,
    findings: Option<Findings>,
    /// What is noted.
    pub notes: notes::Notes,
    /// The rolling recording.
    pub rolling: rolling::Rolling,
    /// A film of a recording.
    pub film: film::Film,
    /// What the list is searched for.
    search: String,
}

impl Library {
    /// Looks for recordings again.
    pub fn rescan(&mut self, services: &mut Services) {
        self.scanned = true;
        self.rolling.ask(services);
        let found = (services.scan)(services.recordings.path());
        self.scanning.begin(found);
    }

    /// Whether a recording may be begun or ended, or why not.
    pub fn record_gate(&self, live: &View<'_>, twin_gone: bool) -> Gate {
        match self.is_naming() {
            true => Err("The recording's file is being made.".into()),
            false => recording_gate(live, twin_gone),
        }
    }

    /// Ends the recording under way, with its note as it is now.
    pub fn end_recording(&mut self, commands: &mut Vec<Command>) {
        commands.extend(self.rec.changed_note());
        commands.push(Command::StopRecording);
    }

    /// Begins a recording as soon as it has a file.
    pub fn record(&mut self, services: &mut Services) {
        let path = (services.new_recording)(services.recordings.path(), &self.rec.name);
        self.naming.begin(path);
    }

    /// Whether a recording begins as soon as it has a file.
    pub fn is_naming(&self) -> bool {
        self.naming.is_busy()
    }

    /// Orders the list.
    pub fn sort_by(&mut self, sort: Sort) {
        self.sort = sort;
        sort.apply(&mut self.entries);
    }

    /// The selected recording, where it is in the list.
    pub fn selected_entry(&self) -> Option<&RecordingEntry> {
        let path = self.selected.as_ref()?;
        self.entries.iter().find(|e| e.path == *path)
    }

    /// Selects a recording; one that is new is no longer marked as such.
    fn select(&mut self, path: &Path) {
        self.fresh.retain(|p| p != path);
        self.selected = Some(path.to_owned());
    }

    /// Takes what was found, and marks what was not there before.
    fn list(&mut self, mut found: Vec<RecordingEntry>) {
        self.sort.apply(&mut found);
        let is_new = |e: &&RecordingEntry| !e.sample && !is_among(&self.entries, &e.path);
        let new: Vec<PathBuf> = match self.listed {
            true => found
                .iter()
                .filter(is_new)
                .map(|e| e.path.clone())
                .collect(),
            false => Vec::new(),
        };
        self.listed = true;
        self.entries = found;
        let is_there = |path: &Path| is_among(&self.entries, path);
        self.fresh.retain(|p| is_there(p));
        if let Some(first) = new.first()
            && self.selected.as_deref().is_none_or(|p| !is_there(p))
        {
            self.selected = Some(first.clone());
        }
        self.fresh.extend(new);
    }

    /// Whether a recording is being loaded as `side`.
    fn is_loading(&self, side: Side) -> bool {
        let mut all = self.loading.iter();
        all.any(|l| l.context().is_some_and(|l| l.side == side))
    }

    /// Whether a part of the recording that is played is being read at its full rate.
    fn reads_near(&self) -> bool {
        self.near.is_busy()
    }

    /// Reads the full rate around a position that rests, where a long recording is shown with samples that are farther
    /// apart.
    fn look_closer(
        &mut self,
        player: &mut Option<Player>,
        window: &TimeWindow,
        services: &mut Services,
    ) {
        let Some(player) = player else {
            self.near.cancel();
            self.looked_at_s.1 = false;
            return;
        };
        let is_of = |path: &Path| player.about.path.as_deref() == Some(path);
        if let Some(((path, range_s), part)) = self.near.take_for()
            && is_of(&path)
        {
            if let Err(cause) = &part {
                log::info!("{}: {cause}", path.display());
            }
            player.set_near(range_s, part.ok());
        }
        let now_s = player.now_s();
        let shown_s = window.range_s(now_s);
        let wanted = player.wants_near(shown_s);
        let rests = self.looked_at_s.0 == now_s;
        self.looked_at_s = (now_s, wanted.is_some() && !rests);
        let Some((path, range_s)) = wanted.filter(|_| rests) else {
            return;
        };
        let is_read = self.near.context().is_some_and(|(of, [from_s, to_s])| {
            of == path && *from_s <= shown_s[0] && shown_s[1] <= *to_s
        });
        if !is_read {
            let part = format!("{}@{}..{}", path.display(), range_s[0], range_s[1]);
            let of = (path.to_owned(), range_s);
            self.near.begin_for(of, (services.load)(Path::new(&part)));
        }
    }

    /// Whether something is awaited.
    pub fn busy(&self) -> bool {
        self.scanning.is_busy()
            || !self.loading.is_empty()
            || self.near.is_busy()
            || self.looked_at_s.1
            || self.opening.is_busy()
            || self.naming.is_busy()
            || self.open.is_busy()
            || self.choice.is_busy()
            || self.notes.is_busy()
            || self.rec.is_busy()
            || self.preview.is_busy()
            || self.renaming.is_busy()
            || self.rolling.is_busy()
            || self.film.is_busy()
            || self.pair.busy()
            || self.viewer.busy()
    }

    /// Loads files that were dropped on the window: one is played (compared, with Shift), two are compared.
    /// Returns whether there were any.
    pub fn take_drops(&mut self, ctx: &egui::Context, services: &mut Services) -> bool {
        let (paths, shift) = ctx.input(|i| {
            let files = i.raw.dropped_files.iter();
            let paths: Vec<PathBuf> = files.map(|f| f.path().to_owned()).collect();
            (paths, i.modifiers.shift)
        });
        match paths.as_slice() {
            [] => return false,
            [one] => {
                let side = if shift { Side::B } else { Side::A };
                self.load(one.clone(), (side, shift), services);
            }
            [one, other, ..] => {
                self.load(one.clone(), (Side::A, true), services);
                self.load(other.clone(), (Side::B, true), services);
            }
        }
        true
    }

    /// Loads a recording and plays it.
    pub fn play(&mut self, path: PathBuf, services: &mut Services) {
        self.load(path, (Side::A, false), services);
    }

    /// Asks for a recording in a file dialog, unless one is open.
    pub fn browse(&mut self, services: &mut Services) {
        self.open.browse(recording_dialog(), services);
    }

    /// Loads a recording as `side`, and compares it with the other one if `compared`.
    fn load(&mut self, path: PathBuf, (side, compared): (Side, bool), services: &mut Services) {
        let name = path
            .file_name()
            .map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        self.trouble = None;
        self.loading
            .retain(|l| l.context().is_some_and(|l| l.side != side));
        let mut pending = Pending::default();
        let of = Loading {
            name,
            side,
            compared,
        };
        let job = match self.preview.take(&path) {
            Some(player) => Job::ready(Ok(player)),
            None => (services.load)(&path),
        };
        pending.begin_for(of, job);
        self.loading.push(pending);
        self.select(&path);
    }

    /// Takes what has come, whatever screen is shown. Gives a sentence for the operator where a recording has no
    /// file.
    pub fn poll(
        &mut self,
        player: &mut Option<Player>,
        window: &TimeWindow,
        services: &mut Services,
        commands: &mut Vec<Command>,
    ) -> Option<String> {
        self.look_closer(player, window, services);
        self.pair.poll();
        self.poll_notes(player, services);
        self.poll_rename(services);
        self.film.poll(services);
        self.preview.poll();
        self.viewer.poll(commands);
        let mut refused = None;
        match self.naming.take() {
            Some(Ok(path)) => {
                commands.push(Command::StartRecording(path));
                let note = self.rec.begin();
                if !note.is_empty() {
                    commands.push(Command::Note(note));
                }
            }
            Some(Err(cause)) => refused = Some(format!("Nothing is recorded. {cause}")),
            None => {}
        }
        if let Some(found) = self.scanning.take() {
            match found {
                Ok(entries) => self.list(entries),
                Err(cause) => {
                    self.trouble = Some(Trouble::new(
                        cause,
                        "The list may be out of date.",
                        "Press Refresh to look again.",
                    ));
                }
            }
        }
        let mut loaded = Vec::new();
        self.loading.retain_mut(|pending| {
            let answer = pending.take_for();
            let waits = answer.is_none();
            loaded.extend(answer);
            waits
        });
        for (Loading { side, compared, .. }, answer) in loaded {
            match answer {
                Ok(new) => self.pair.place((side, compared), new, player, services),
                Err(cause) => {
                    self.preview.clear();
                    self.trouble = Some(Trouble::new(
                        cause,
                        "Nothing was loaded: what was shown before stays.",
                        "Choose another recording, or copy this one again from where it was made.",
                    ));
                }
            }
        }
        if let Some(Err(cause)) = self.opening.take() {
            self.trouble = Some(Trouble::new(
                cause,
                "The recording was not shown there.",
                "Load and play shows it in this window.",
            ));
        }
        refused
    }
}

fn is_among(entries: &[RecordingEntry], path: &Path) -> bool {
    entries.iter().any(|e| e.path == path)
}

fn recording_dialog() -> Dialog {
    let kinds = ["rrd", "toml", "csv"].map(str::to_owned).to_vec();
    Dialog {
        title: "Open a recording".into(),
        kind: DialogKind::Open,
        filter: Some(("Recordings and session logs".into(), kinds)),
        name: String::new(),
    }
}

/// What the screen is given.
pub struct RecordingsInput<'a> {
    /// The live twin's view.
    pub live: View<'a>,
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
    let frame = ui.ctx().cumulative_frame_nr();
    // Other programs record, too: looked for whenever the screen is entered.
    if !library.scanned || frame > library.shown_in + 1 {
        library.rescan(services);
    }
    library.shown_in = frame;
    let whole = ui.available_rect_before_wrap();
    ui.horizontal_top(|ui| {
        let height = ui.available_height();
        // Beside what is played the plots need the width, else the list.
        let width = ui.available_width();
        let left = match player {
            Some(_) => (width * 0.46).clamp(420.0, 720.0),
            None => (width * 0.54).clamp(480.0, 1240.0),
        };
        ui.allocate_ui(vec2(left, height), |ui| {
            pane(ui, "library", |ui| {
                rolling::ui(ui, input.live.snapshot, library, services);
                folder::ui(ui, library, services);
                let (live, gone) = (&input.live, input.twin_gone);
                let viewer = &mut library.viewer;
                super::rerun::live_in_rerun(ui, live, gone, viewer, services, commands);
                ui.separator();
                library::ui(ui, library, player, services);
                if let Some(player) = player {
                    ui.separator();
                    details::ui(ui, library, player, services);
                }
            });
        });
        ui.vertical(|ui| {
            pane(ui, "played", |ui| {
                if player.is_some() {
                    return shown::ui(ui, input, library, player, services);
                }
                if library.pair.other.is_some() {
                    shown::still_loaded(ui, library, player);
                    ui.separator();
                }
                selected::ui(ui, input, library, services);
            });
        });
    });
    if ui.input(|i| !i.raw.hovered_files.is_empty()) {
        drop_here(ui, whole);
    }
}

// What a file that hangs over the window would do.
fn drop_here(ui: &Ui, rect: egui::Rect) {
    let p = *Palette::in_ui(ui);
    let layer = egui::LayerId::new(egui::Order::Foreground, egui::Id::unique("drop here"));
    let painter = ui.ctx().layer_painter(layer);
    painter.rect(
        rect.shrink(4.0),
        6.0,
        p.selected.gamma_multiply(0.9),
        egui::Stroke::new(2.0, p.text),
        egui::StrokeKind::Inside,
    );
    painter.text(
        rect.center(),
        egui::Align2::CENTER_CENTER,
        "Drop a recording to play it as A.\nHold Shift to compare it as B. Drop two to compare them.",
        egui::TextStyle::Heading.resolve(ui.style()),
        p.text,
    );
}
