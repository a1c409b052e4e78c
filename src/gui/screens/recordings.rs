//! The screen of recordings: library, player, comparison.

use egui::{Ui, Vec2, vec2};

use super::settings;
use crate::gui::panels::operating::ends_recording;
use crate::gui::panels::rec;
use crate::gui::panels::recordings::{
    self, Act, By, Library, RecordingsInput, Side, act_gate, keep, keep_gate, mark_gate, mark_now,
};
use crate::gui::screen::{Ctx, Known, List, Screen, Task, check};
use crate::gui::services::gap::Part;
use crate::gui::theme::Level;
use crate::signal::Snapshot;
use crate::twin::{Command, Event};

impl Screen for Library {
    const NAME: &'static str = "Recordings";
    const PURPOSE: &'static str = "Record, play, compare and open recordings.";
    const LEAST_POINTS: Vec2 = vec2(880.0, 480.0);

    fn ui(&mut self, ui: &mut Ui, ctx: &mut Ctx<'_>) {
        let input = RecordingsInput {
            live: ctx.live,
            twin_gone: ctx.twin_gone,
        };
        recordings::ui(ui, &input, self, ctx.player, ctx.services, ctx.commands);
    }

    fn busy(&self) -> bool {
        Self::busy(self)
    }

    fn poll(&mut self, ctx: &mut Ctx<'_>) {
        if std::mem::take(&mut self.has_new) {
            self.rescan(ctx.services);
        }
        self.poll_rolling(ctx);
        let window = *ctx.window;
        if let Some(text) = Self::poll(self, ctx.player, &window, ctx.services, ctx.commands) {
            ctx.messages.push((text, Level::Warning));
        }
    }

    fn follow(&mut self, live: &Snapshot, events: &[Event]) {
        self.rec
            .follow(self.under_way.as_ref(), live.recording.as_ref());
        self.under_way.clone_from(&live.recording);
        // Also one that has just begun: it is listed as the one that is being recorded.
        self.has_new |= events.iter().any(ends_recording);
    }

    fn actions(&self, known: &Known<'_>, list: &mut List<Self>) {
        let live = &known.live;
        let there = check(!known.twin_gone, "No twin is running.");
        let words = "record recording save log file";
        let gate = self.record_gate(live, known.twin_gone);
        let (name, act): (_, fn(&mut Self, &mut Ctx<'_>)) = match live.snapshot.recording {
            Some(_) => ("End the recording", |library, ctx| {
                library.end_recording(ctx.commands);
            }),
            None => ("Record", |library, ctx| library.record(ctx.services)),
        };
        list.add(name, words, gate, Task::Behind(Box::new(act)));
        let opens = |library: &mut Self, _: &mut Ctx<'_>| library.rec.wanted = true;
        let words = "record rec save comment disk space left folder";
        let task = Task::Behind(Box::new(opens));
        list.add(rec::MENU, words, Ok(()), task);
        let gate = mark_gate(live, known.twin_gone);
        let mark = |library: &mut Self, ctx: &mut Ctx<'_>| {
            mark_now(library, ctx.live.snapshot, ctx.commands);
        };
        let task = Task::Behind(Box::new(mark));
        list.add("Mark this moment", "recording note flag event", gate, task);
        list.by("M");
        let keeps = |library: &mut Self, ctx: &mut Ctx<'_>| {
            keep(library, ctx.live.snapshot, ctx.services);
        };
        let gate = there.clone().and(keep_gate(live.snapshot));
        let task = Task::Behind(Box::new(keeps));
        let words = "rolling recording save before black box";
        list.add("Keep the last 5 minutes", words, gate, task);
        list.by("B");
        match live.snapshot.streaming {
            Some(_) => {
                let task = Task::Twin(Command::StopStream);
                list.add("Stop streaming", "rerun viewer", there, task);
            }
            None => {
                let start = |library: &mut Self, ctx: &mut Ctx<'_>| {
                    library.viewer.start(ctx.services);
                };
                let task = Task::Behind(Box::new(start));
                list.add("Open live in Rerun", "viewer stream", there, task);
            }
        }
        let words = "open load file log session";
        list.act(
            "Browse for a recording…",
            words,
            Ok(()),
            |library, ctx| {
                library.browse(ctx.services);
            },
        );
        let words = "library scan recordings look again";
        list.act("Refresh the library", words, Ok(()), |library, ctx| {
            library.rescan(ctx.services);
        });
        for (by, name) in [
            (By::Date, "Sort the library by date"),
            (By::Name, "Sort the library by name"),
        ] {
            let words = "order newest oldest recordings";
            list.act(name, words, Ok(()), move |library, _| {
                library.sort_by(library.sort.pressed(by));
            });
        }
        self.row_actions(list);
        let gate = check(self.film.is_under_way(), "No video is being made.");
        list.act("Cancel the video", "film stop", gate, |library, _| {
            library.film.cancel();
        });
        for entry in &self.entries {
            let name = format!("Play {}", entry.name);
            let path = entry.path.clone();
            let words = "recording load replay open";
            list.act(name, words, Ok(()), |library, ctx| {
                library.play(path, ctx.services);
            });
        }
        settings::recordings(self, known, list);
    }
}

impl Library {
    /// What can be done with the selected recording, besides playing it.
    fn row_actions(&self, list: &mut List<Self>) {
        for (act, name, words) in [
            (
                Act::Load(Side::B),
                "Compare the selected recording as B",
                "load difference beside",
            ),
            (
                Act::Gap(Part::Healthy),
                "Use the selected recording as healthy session",
                "gap baseline commissioning",
            ),
            (
                Act::Gap(Part::Suspect),
                "Use the selected recording as suspect session",
                "gap find effect",
            ),
            (
                Act::Rename,
                "Rename the selected recording…",
                "name file library",
            ),
            (
                Act::Video,
                "Make a video of the selected recording…",
                "film movie mp4 animation export frames",
            ),
            (
                Act::Rerun,
                "Open the selected recording in Rerun",
                "viewer show",
            ),
        ] {
            let entry = self.selected_entry();
            let gate = match entry {
                Some(entry) => act_gate(self, entry, None, act),
                None => Err("No recording is selected in the library.".to_owned()),
            };
            let path = entry.map(|e| e.path.clone()).unwrap_or_default();
            list.act(name, words, gate, move |library, ctx| {
                library.act(act, &path, ctx.services);
            });
        }
    }
}
