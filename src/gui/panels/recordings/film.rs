//! A film of a recording: where it goes, how far it is, where it is.

use std::path::{Path, PathBuf};

use egui::{Align, Layout, ProgressBar, RichText, Ui};

use crate::gui::panels::files::Written;
use crate::gui::panels::widgets::status;
use crate::gui::services::{Dialog, DialogKind, Existing, Filmed, Pending, Picked, Services};
use crate::gui::theme::{Level, Palette};

/// A film that is asked for, made, or done.
#[derive(Default)]
pub struct Film {
    /// Where the film of a recording goes.
    picking: Pending<Picked, PathBuf>,
    /// The film of a recording of this name.
    making: Pending<Filmed, String>,
    /// What was made last, or why not.
    made: Option<Result<Filmed, String>>,
}

impl Film {
    /// Whether something is awaited.
    pub fn is_busy(&self) -> bool {
        self.picking.is_busy() || self.making.is_busy()
    }

    /// Whether a film is being made.
    pub fn is_under_way(&self) -> bool {
        self.making.is_busy()
    }

    /// Makes no film; nothing is left of it.
    pub fn cancel(&mut self) {
        self.making.cancel();
    }

    /// Asks where the film of a recording goes.
    pub(super) fn ask(&mut self, recording: &Path, services: &mut Services) {
        self.made = None;
        let kinds = ["mp4", "mov", "mkv", "webm"].map(str::to_owned).to_vec();
        let job = (services.pick)(Dialog {
            title: "Make a video".into(),
            kind: DialogKind::Save,
            filter: Some(("Videos".into(), kinds)),
            name: name_of(recording),
        });
        self.picking.begin_for(recording.to_owned(), job);
    }

    /// Takes what has come.
    pub(super) fn poll(&mut self, services: &mut Services) {
        if let Some((recording, picked)) = self.picking.take_for() {
            let usual = services.exports.join(name_of(&recording));
            let to = match picked {
                Ok(Picked::Path(path)) => Some((path, Existing::Replaced)),
                Ok(Picked::Cancelled) => None,
                // Without a dialog it goes where tables and pictures go.
                Ok(Picked::NoDialog) | Err(_) => Some((usual, Existing::Kept)),
            };
            if let Some((path, existing)) = to {
                let job = (services.film)(&recording, &path, existing);
                self.making.begin_for(stem_of(&recording), job);
            }
        }
        if let Some((_, made)) = self.making.take_for() {
            self.made = Some(made);
        }
    }

    /// How far it is, and where it is.
    pub(super) fn ui(&mut self, ui: &mut Ui) {
        if let (Some(name), Some(stage)) = (self.making.context(), self.making.stage()) {
            let text = format!("Making a video of {name}… {}", stage.what);
            let text = RichText::new(text).color(Palette::in_ui(ui).weak);
            ui.add(egui::Label::new(text).truncate());
            let mut cancelled = false;
            ui.horizontal(|ui| {
                ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                    let cancel = ui.button("Cancel the video");
                    cancelled = cancel.on_hover_text("Nothing is left of it").clicked();
                    match stage.share {
                        Some(share) => {
                            let bar = ProgressBar::new(share).show_percentage();
                            ui.add(bar.desired_width(ui.available_width()));
                        }
                        None => {
                            ui.spinner();
                        }
                    }
                });
            });
            if cancelled {
                self.cancel();
            }
        }
        let mut closed = false;
        match &self.made {
            Some(Ok(film)) => {
                if let Some(why) = &film.why_frames {
                    status(ui, Level::Warning, why);
                }
                ui.horizontal(|ui| {
                    closed = close(ui);
                    Written {
                        what: film.what.clone(),
                        path: film.path.clone(),
                    }
                    .show(ui);
                });
            }
            Some(Err(why)) => {
                status(ui, Level::Warning, &format!("No video was made. {why}"));
                closed = close(ui);
            }
            None => {}
        }
        if closed {
            self.made = None;
        }
    }
}

fn close(ui: &mut Ui) -> bool {
    ui.button("Close")
        .accessible_name("Close the note on the video")
        .on_hover_text("Close this line")
        .clicked()
}

fn stem_of(recording: &Path) -> String {
    let stem = recording.file_stem().unwrap_or_default();
    stem.to_string_lossy().into_owned()
}

fn name_of(recording: &Path) -> String {
    format!("{}.mp4", stem_of(recording))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gui::services::Job;

    /// Services whose dialog answers so, and what they were asked to film.
    fn services(picked: Picked) -> (Services, std::sync::Arc<std::sync::Mutex<Vec<PathBuf>>>) {
        let asked = std::sync::Arc::<std::sync::Mutex<Vec<PathBuf>>>::default();
        let films = std::sync::Arc::clone(&asked);
        let mut services = Services::none();
        services.pick = Box::new(move |_| Job::ready(Ok(picked.clone())));
        services.film = Box::new(move |recording, out, existing| {
            let is_usual = out.starts_with("exports");
            assert_eq!(existing == Existing::Kept, is_usual);
            let mut films = films.lock().expect("not poisoned");
            films.extend([recording.to_owned(), out.to_owned()]);
            Job::ready(Ok(Filmed {
                path: out.to_owned(),
                what: "the video of 1.0 s".into(),
                why_frames: None,
            }))
        });
        (services, asked)
    }

    #[test]
    fn a_film_goes_where_it_is_chosen_and_without_a_dialog_beside_the_tables() {
        for (picked, out) in [
            (Picked::Path("films/b.webm".into()), Some("films/b.webm")),
            (Picked::NoDialog, Some("exports/circle.mp4")),
            (Picked::Cancelled, None),
        ] {
            let (mut services, asked) = services(picked);
            let mut film = Film::default();
            film.ask(Path::new("recordings/circle.rrd"), &mut services);
            assert!(film.is_busy() && !film.is_under_way());
            film.poll(&mut services);
            assert!(!film.is_busy());
            let films = asked.lock().expect("not poisoned");
            let wanted = out.map(|out| vec!["recordings/circle.rrd".into(), PathBuf::from(out)]);
            assert_eq!(*films, wanted.unwrap_or_default());
            assert_eq!(film.made.is_some(), out.is_some());
        }
    }
}
