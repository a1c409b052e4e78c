//! Scores as files: a table, a picture, a report.

use std::sync::Arc;

use egui::{Button, Rect, Ui};

use super::AccuracyState;
use super::frames::sentences;
use super::table::published;
use crate::analysis::score::{ReportFacts, csv, report};
use crate::analysis::scores::Analysis;
use crate::gui::panels::files::Saving;
use crate::gui::panels::picture::{Picture, To};
use crate::gui::panels::plot::file_name;
use crate::gui::panels::widgets::{Gate, gated, note};
use crate::gui::services::{Content, Dialog, DialogKind, Services};
use crate::gui::view::View;

/// A kind of file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Every pair as a line of text.
    Csv,
    /// A picture of this screen.
    Png,
    /// Tables and plots in one HTML file.
    Report,
}

impl Kind {
    const ALL: [Self; 3] = [Self::Csv, Self::Png, Self::Report];

    fn name(self) -> &'static str {
        match self {
            Self::Csv => "CSV",
            Self::Png => "PNG",
            Self::Report => "Report",
        }
    }

    fn extension(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Png => "png",
            Self::Report => "html",
        }
    }

    fn hover(self) -> &'static str {
        match self {
            Self::Csv => "Write every pair that is scored as a table (.csv)",
            Self::Png => "Write a picture of this screen (.png)",
            Self::Report => "Write tables, plots and what they rest on as one page (.html)",
        }
    }
}

/// Files that are being written.
#[derive(Default)]
pub struct Export {
    /// A kind of file that was asked for from elsewhere.
    pub wanted: Option<Kind>,
    kind: Option<Kind>,
    /// Path, writing, and what was written last.
    pub saving: Saving,
    picture: Picture,
}

impl Export {
    /// Whether a picture is being taken: the controls are not drawn.
    pub fn is_posing(&self) -> bool {
        self.picture.is_posing()
    }

    /// Whether something is awaited.
    pub fn is_busy(&self) -> bool {
        self.saving.is_busy() || self.is_posing()
    }
}

fn suggested(view: &View<'_>, kind: Kind) -> String {
    file_name(view, "accuracy", kind.extension())
}

/// The buttons, or the path that is asked for. In a picture the row names what is shown.
pub fn ui(ui: &mut Ui, view: &View<'_>, state: &mut AccuracyState, services: &mut Services) {
    if state.export.is_posing() {
        let height = ui.spacing().interact_size.y;
        ui.horizontal(|ui| {
            ui.set_min_height(height);
            note(ui, caption(view, state));
        });
        return;
    }
    let analysis = state.scores.shown();
    let n = analysis.map_or(0, |a| a.scored.len());
    let export = &mut state.export;
    if let Some(kind) = export.kind.filter(|_| export.saving.is_asking()) {
        let dialog = || Dialog {
            title: format!("Write {}", kind.name()),
            kind: DialogKind::Save,
            filter: Some((kind.name().into(), vec![kind.extension().into()])),
            name: suggested(view, kind),
        };
        if let Some(to) = export.saving.ui(ui, kind.hover(), dialog, services) {
            write(view, state, kind, to, services);
            ui.ctx().request_repaint();
        }
        return;
    }
    let gate: Gate = if n == 0 {
        Err("Nothing is scored in this window: there is nothing to write.".into())
    } else if export.is_busy() {
        Err("A file is being written.".into())
    } else {
        Ok(())
    };
    let wanted = export.wanted.take();
    if let (Some(_), Err(why)) = (wanted, &gate) {
        export.saving.said = Some(Err(why.clone()));
    }
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        note(ui, "Export");
        for kind in Kind::ALL {
            let pressed = gated(ui, &gate, Button::new(kind.name()), kind.hover()).clicked();
            if pressed || (wanted == Some(kind) && gate.is_ok()) {
                export.kind = Some(kind);
                let path = services.exports.join(suggested(view, kind));
                export.saving.ask(&path);
            }
        }
        export.saving.show(ui);
    });
}

// What is scored, in a line.
fn caption(view: &View<'_>, state: &AccuracyState) -> String {
    let Some(analysis) = state.scores.shown() else {
        return String::new();
    };
    let facts = facts(view, state, analysis);
    let [from, to] = facts.range_s;
    format!(
        "{}, {} data, {from:.1} to {to:.1} s, {} poses",
        facts.source,
        facts.origin,
        analysis.scored.len()
    )
}

/// Takes pictures and what was written.
pub fn finish(ui: &Ui, state: &mut AccuracyState, services: &mut Services, whole: Rect) {
    let export = &mut state.export;
    export.saving.poll();
    if let Some((to, content)) = export.picture.poll(ui, whole) {
        export.saving.write(to, "the picture", content, services);
    }
}

// The files are made by whoever writes them: a long table takes longer than a frame may.
fn write(view: &View<'_>, state: &mut AccuracyState, kind: Kind, to: To, services: &mut Services) {
    let Some(analysis) = state.scores.shown() else {
        return;
    };
    let scored = Arc::clone(&analysis.scored);
    match kind {
        Kind::Png => state.export.picture.take(to),
        Kind::Csv => {
            let (origin, what) = (view.origin(), format!("{} rows", scored.len()));
            let content: Content = Box::new(move || Ok(csv(&scored, origin).into_bytes()));
            state.export.saving.write(to, what, content, services);
        }
        Kind::Report => {
            let facts = facts(view, state, analysis);
            let content: Content = Box::new(move || Ok(report(&scored, &facts).into_bytes()));
            state
                .export
                .saving
                .write(to, "the report", content, services);
        }
    }
}

fn facts(view: &View<'_>, state: &AccuracyState, analysis: &Analysis) -> ReportFacts {
    let ends = analysis.scored.first().zip(analysis.scored.last());
    ReportFacts {
        source: view.replay.map_or_else(
            || format!("the live twin on {}", view.snapshot.link.source),
            |name| format!("the recording {name}"),
        ),
        origin: view.origin().to_owned(),
        range_s: ends.map_or([0.0, 0.0], |(a, b)| [a.t_s, b.t_s]),
        occlusions: analysis.occlusions.clone(),
        excluded: analysis.excluded,
        paper: published(view.snapshot.payload_kg),
        frames: sentences(view, state.registration.as_ref()),
    }
}
