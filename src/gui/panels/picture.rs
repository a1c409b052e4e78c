//! Pictures of a part of the window, as PNG.

use std::io::Cursor;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use egui::{ColorImage, Rect, Ui};

use crate::gui::services::{Content, Existing};

/// Where a file goes, and what is done with one that is there.
pub type To = (PathBuf, Existing);

// A picture that the renderer is asked for.
struct Shot {
    to: To,
    rect: Rect,
    image: Arc<Mutex<Option<Arc<ColorImage>>>>,
}

/// A picture that is being taken.
#[derive(Default)]
pub struct Picture {
    /// It is taken of the next frame, which shows no controls of its own.
    pose: Option<To>,
    shot: Option<Shot>,
}

impl Picture {
    /// Whether a picture is being taken: what shall not be on it is not drawn.
    pub fn is_posing(&self) -> bool {
        self.pose.is_some() || self.shot.is_some()
    }

    /// Has a picture taken of the next frame.
    pub fn take(&mut self, to: To) {
        self.pose = Some(to);
    }

    /// Takes the picture of `rect`, points; once it is there, gives where it goes and what makes its bytes. Call once per frame.
    pub fn poll(&mut self, ui: &Ui, rect: Rect) -> Option<(To, Content)> {
        if let Some(to) = self.pose.take() {
            self.shot = Some(ask(ui, to, rect));
        }
        let shot = self.shot.take()?;
        let image = shot
            .image
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        let Some(image) = image else {
            self.shot = Some(shot);
            return None;
        };
        let (rect, scale) = (shot.rect, ui.ctx().pixels_per_point());
        let rect = rect.intersect(ui.ctx().content_rect());
        let content: Content = match rect.is_positive() {
            true => Box::new(move || png(&image.region(&rect, Some(scale)))),
            false => Box::new(|| Err("The plots are too low for a picture.".into())),
        };
        ui.ctx().request_repaint();
        Some((shot.to, content))
    }
}

fn ask(ui: &Ui, to: To, rect: Rect) -> Shot {
    let image = Arc::new(Mutex::new(None));
    let (slot, ctx) = (Arc::clone(&image), ui.ctx().clone());
    ui.ctx().request_screenshot(move |picture| {
        *slot.lock().unwrap_or_else(PoisonError::into_inner) = Some(picture);
        ctx.request_repaint();
    });
    Shot { to, rect, image }
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
