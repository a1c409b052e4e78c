//! Scores as files: a table, a picture, a report.

use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use egui::{Button, ColorImage, Rect, TextEdit, Ui};

use super::frames::sentences;
use super::table::published;
use super::{AccuracyState, Analysis};
use crate::gui::panels::View;
use crate::gui::panels::widgets::{Gate, gated, note, status};
use crate::gui::score::{ReportFacts, csv, report};
use crate::gui::services::{Dialog, DialogKind, Job, Services};
use crate::gui::theme::Level;

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

// A picture that the renderer is asked for.
struct Shot {
    path: PathBuf,
    rect: Rect,
    image: Arc<Mutex<Option<Arc<ColorImage>>>>,
}

/// Files that are being written.
#[derive(Default)]
pub struct Export {
    /// The path that is typed, where there is no dialog.
    pub draft: Option<(Kind, String)>,
    /// A kind of file that was asked for from elsewhere.
    pub wanted: Option<Kind>,
    /// What was written last, or why not.
    pub said: Option<Result<String, String>>,
    picking: Option<(Kind, Job<Option<PathBuf>>)>,
    shot: Option<Shot>,
    asked: Option<(Kind, PathBuf)>,
}

fn suggested(view: &View<'_>, kind: Kind) -> String {
    let of = view
        .replay
        .and_then(|r| r.split(" (").next())
        .unwrap_or("live");
    format!("accuracy-{of}-{}.{}", view.origin(), kind.extension())
}

/// The buttons, and the path where it is typed.
pub fn ui(ui: &mut Ui, view: &View<'_>, state: &mut AccuracyState, services: &mut Services) {
    let n = state.analysis.as_ref().map_or(0, |a| a.scored.len());
    let export = &mut state.export;
    let gate: Gate = if n == 0 {
        Err("Nothing is scored in this window: there is nothing to write.".into())
    } else if export.picking.is_some() {
        Err("A file dialog is open.".into())
    } else {
        Ok(())
    };
    let mut write = None;
    let wanted = export.wanted.take();
    if let (Some(_), Err(why)) = (wanted, &gate) {
        export.said = Some(Err(why.clone()));
    }
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        if let Some((kind, path)) = &mut export.draft {
            let mut cancel = false;
            let field = TextEdit::singleline(path).desired_width(ui.available_width() - 150.0);
            ui.add(field)
                .accessible_name("Path to write")
                .on_hover_text("Where the file is written; a relative path begins where the program was started");
            let empty: Gate = match path.trim().is_empty() {
                true => Err("Type a path first.".into()),
                false => Ok(()),
            };
            if gated(ui, &empty, Button::new("Write"), kind.hover()).clicked() {
                write = Some((*kind, PathBuf::from(path.trim())));
            }
            cancel |= ui
                .button("Cancel")
                .accessible_name("Cancel writing")
                .on_hover_text("Write nothing")
                .clicked();
            if cancel {
                export.draft = None;
            }
            return;
        }
        note(ui, "Export");
        for kind in Kind::ALL {
            let pressed = gated(ui, &gate, Button::new(kind.name()), kind.hover()).clicked();
            if pressed || (wanted == Some(kind) && gate.is_ok()) {
                export.said = None;
                let name = suggested(view, kind);
                let dialog = Dialog {
                    title: format!("Write {}", kind.name()),
                    kind: DialogKind::Save,
                    filter: Some((kind.name().into(), vec![kind.extension().into()])),
                    name,
                };
                export.picking = Some((kind, (services.pick)(dialog)));
            }
        }
        match &export.said {
            Some(Ok(text)) => {
                ui.add(egui::Label::new(text).truncate()).on_hover_text(text);
            }
            Some(Err(text)) => {
                status(ui, Level::Warning, text);
            }
            None if export.shot.is_some() => {
                ui.spinner();
                note(ui, "Taking the picture…");
            }
            None => {}
        }
    });
    if let Some(w) = write {
        export.draft = None;
        export.asked = Some(w);
    }
}

/// Takes answers of dialogs and pictures, and writes.
pub fn finish(
    ui: &Ui,
    view: &View<'_>,
    state: &mut AccuracyState,
    services: &mut Services,
    whole: Rect,
) {
    let export = &mut state.export;
    if let Some((kind, answer)) = export
        .picking
        .as_ref()
        .and_then(|(k, j)| Some((*k, j.poll()?)))
    {
        export.picking = None;
        match answer {
            Ok(Some(path)) => export.asked = Some((kind, path)),
            Ok(None) => export.draft = Some((kind, suggested(view, kind))),
            Err(e) => export.said = Some(Err(e)),
        }
    }
    if export.picking.is_some() {
        ui.ctx().request_repaint_after(Duration::from_millis(100));
    }
    if let Some(shot) = export.shot.take() {
        let image = shot
            .image
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        match image {
            Some(image) => {
                let part = image.region(&shot.rect, Some(ui.ctx().pixels_per_point()));
                let said =
                    png(&part).and_then(|bytes| write(services, &shot.path, &bytes, "the picture"));
                export.said = Some(said);
            }
            None => export.shot = Some(shot),
        }
    }
    let Some((kind, path)) = export.asked.take() else {
        return;
    };
    let Some(analysis) = &state.analysis else {
        return;
    };
    match kind {
        Kind::Png => state.export.shot = Some(take_picture(ui, path, whole)),
        Kind::Csv => {
            let text = csv(&analysis.scored, view.origin());
            let what = format!("{} rows", analysis.scored.len());
            state.export.said = Some(write(services, &path, text.as_bytes(), &what));
        }
        Kind::Report => {
            let html = report(&analysis.scored, &facts(view, state, analysis));
            state.export.said = Some(write(services, &path, html.as_bytes(), "the report"));
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

fn write(services: &mut Services, path: &Path, bytes: &[u8], what: &str) -> Result<String, String> {
    (services.write)(path, bytes)
        .map(|()| format!("Wrote {what} to {}.", path.display()))
        .map_err(|e| format!("{e} Nothing was written: choose another place."))
}

fn take_picture(ui: &Ui, path: PathBuf, rect: Rect) -> Shot {
    let image = Arc::new(Mutex::new(None));
    let (slot, ctx) = (Arc::clone(&image), ui.ctx().clone());
    ui.ctx().request_screenshot(move |picture| {
        *slot.lock().unwrap_or_else(PoisonError::into_inner) = Some(picture);
        ctx.request_repaint();
    });
    Shot { path, rect, image }
}

fn png(image: &ColorImage) -> Result<Vec<u8>, String> {
    let [width, height] = image.size.map(|n| n as u32);
    let bytes: Vec<u8> = image.pixels.iter().flat_map(|p| p.to_array()).collect();
    let picture = image::RgbaImage::from_raw(width, height, bytes)
        .ok_or_else(|| "The picture has no pixels.".to_owned())?;
    let mut out = Cursor::new(Vec::new());
    picture
        .write_to(&mut out, image::ImageFormat::Png)
        .map_err(|e| format!("The picture cannot be written as PNG: {e}."))?;
    Ok(out.into_inner())
}
