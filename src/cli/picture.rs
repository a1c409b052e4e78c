//! Pictures: of the arm at rest, by either simulator, and of figures for print.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, Result};
use clap::ValueEnum;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};

use springtwin::charts::{Anchor, FONT_PT, Figure, Mark, Rgb};
use springtwin::gui::offscreen::Offscreen;
use springtwin::gui::scene::{Picking, Scene, SceneInput, Theme};
use springtwin::gui::theme::Palette;
use springtwin::robot::RobotSpec;
use springtwin::signal::{
    CHAMBERS, Health, LinkStatus, Quality, SIGNALS, SensorFrame, Simulator, Snapshot, Stamp,
};
use springtwin::sim::{Inputs, Model, State, observe, settle};
use springtwin::twin::{MeshQuestion, MeshSolver};

/// Light or dark.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ThemeName {
    /// Dark on light, as for print
    Light,
    /// Light on dark
    Dark,
}

impl ThemeName {
    /// The theme.
    pub fn theme(self) -> egui::Theme {
        match self {
            Self::Light => egui::Theme::Light,
            Self::Dark => egui::Theme::Dark,
        }
    }
}

/// The arm settled under pressures by the rod model.
pub fn at_rest(
    robot: &RobotSpec,
    chamber_pa: &[f64; CHAMBERS],
    payload_kg: f64,
) -> Result<Snapshot> {
    let model = Model::nominal(robot);
    let mut state = State::rest(&model);
    let inputs = Inputs {
        chamber_pa: *chamber_pa,
        payload_kg,
        ..Inputs::default()
    };
    settle(&model, &mut state, &inputs)?;
    let seen = observe(&model, &state);
    Ok(Snapshot {
        link: LinkStatus {
            connected: true,
            simulated: true,
            source: "rod model".to_owned(),
            ..LinkStatus::default()
        },
        sensors: Some(SensorFrame {
            stamp: Stamp::ZERO,
            extra_sigma: [0.0; SIGNALS],
            delivered: Default::default(),
            sensors: seen.sensors,
            chamber_pa: *chamber_pa,
            health: Health::default(),
            quality: Quality::default(),
        }),
        shape: Some(Arc::new(seen.shape)),
        payload_kg,
        ..Snapshot::default()
    })
}

/// Settles the mesh at a snapshot's pressures and shows it.
pub fn show_mesh(robot: &RobotSpec, snapshot: &mut Snapshot) -> Result<()> {
    let sensors = snapshot
        .sensors
        .as_ref()
        .context("there are no pressures to settle the mesh at")?;
    let question = MeshQuestion {
        stamp: snapshot.stamp,
        inputs: Inputs {
            chamber_pa: sensors.chamber_pa,
            payload_kg: snapshot.payload_kg,
            ..Inputs::default()
        },
    };
    let mesh = MeshSolver::new(robot).solve(&question)?;
    snapshot.simulator = Simulator::Mesh;
    snapshot.mesh = Some(Arc::new(mesh));
    Ok(())
}

/// The 3D view alone, with a caption.
pub fn arm(
    offscreen: &mut Offscreen,
    mut scene: Scene,
    theme: egui::Theme,
    snapshot: &Snapshot,
) -> Result<image::RgbaImage> {
    let (title, details) = caption(snapshot);
    let palette = Palette::of(theme);
    // Between ceiling plate and floor there is more space than the arm needs.
    scene.camera.distance_m *= 0.82;
    let picture = offscreen.render(|ui| {
        let bar = egui::Frame::new()
            .fill(palette.panel)
            .inner_margin(egui::Margin::symmetric(12, 6));
        egui::Panel::top("caption").frame(bar).show(ui, |ui| {
            ui.horizontal(|ui| {
                ui.label(egui::RichText::new(&title).color(palette.text));
                ui.label(egui::RichText::new(&details).color(palette.weak));
            });
        });
        egui::CentralPanel::default()
            .frame(egui::Frame::NONE)
            .show(ui, |ui| {
                let input = SceneInput {
                    theme: match theme {
                        egui::Theme::Dark => Theme::Dark,
                        egui::Theme::Light => Theme::Light,
                    },
                    picking: Picking::Disabled,
                    ..SceneInput::new(snapshot)
                };
                scene.ui(ui, &input);
            });
    })?;
    Ok(picture)
}

/// Which simulator, and under what.
fn caption(snapshot: &Snapshot) -> (String, String) {
    let title = match snapshot.simulator {
        Simulator::Rod => "Rod model, simulated",
        Simulator::Mesh => "Mesh, simulated",
    };
    let mut details = match &snapshot.sensors {
        Some(sensors) => {
            let kpa = sensors.chamber_pa.map(|p| format!("{:.0}", p * 1e-3));
            format!("{} kPa", kpa.join(", ").replace('-', "−"))
        }
        None => String::new(),
    };
    if snapshot.payload_kg > 0.0 {
        details.push_str(&format!(", {:.0} g", snapshot.payload_kg * 1e3));
    }
    (title.to_owned(), details)
}

/// A figure with so many pixels per inch.
pub fn figure(figure: &Figure, dpi: f64) -> Result<image::RgbaImage> {
    let scale = dpi / 72.0;
    let pixels = figure.size_pt().map(|pt| (pt * scale).round() as u32);
    let marks = figure.marks();
    let mut offscreen = Offscreen::new(pixels, scale as f32)?;
    offscreen.context.set_theme(egui::Theme::Light);
    Ok(offscreen.render(|ui| paint(ui.painter(), &marks))?)
}

/// Paints the marks of a figure on white.
fn paint(painter: &egui::Painter, marks: &[Mark]) {
    painter.rect_filled(painter.clip_rect(), 0.0, egui::Color32::WHITE);
    let at = |[x, y]: [f64; 2]| egui::pos2(x as f32, y as f32);
    let of = |[r, g, b]: Rgb| egui::Color32::from_rgb(r, g, b);
    for mark in marks {
        match mark {
            Mark::Line {
                points,
                width_pt,
                colour,
                dashed,
            } => {
                let points: Vec<egui::Pos2> = points.iter().map(|p| at(*p)).collect();
                let stroke = egui::Stroke::new(*width_pt as f32, of(*colour));
                match dashed {
                    true => {
                        painter.extend(egui::Shape::dashed_line(&points, stroke, 3.0, 2.0));
                    }
                    false => {
                        painter.add(egui::Shape::line(points, stroke));
                    }
                }
            }
            Mark::Text {
                at: place,
                anchor,
                upright,
                text,
            } => {
                let font = egui::FontId::proportional(FONT_PT as f32);
                let galley = painter.layout_no_wrap(text.clone(), font, egui::Color32::BLACK);
                let back = match anchor {
                    Anchor::Start => 0.0,
                    Anchor::Middle => 0.5 * galley.size().x,
                    Anchor::End => galley.size().x,
                };
                // From the base line to the top of the row.
                let up = galley.rows.first().and_then(|r| r.glyphs.first());
                let up = up.map_or(0.8 * galley.size().y, |g| g.pos.y);
                let place = at(*place);
                let (corner, angle) = match upright {
                    true => (place + egui::vec2(-up, back), -std::f32::consts::FRAC_PI_2),
                    false => (place - egui::vec2(back, up), 0.0),
                };
                let shape = egui::epaint::TextShape::new(corner, galley, egui::Color32::BLACK);
                painter.add(shape.with_angle(angle));
            }
        }
    }
}

/// Writes a picture as small as PNG makes it; a window is opaque, so its alpha is dropped.
pub fn save(picture: image::RgbaImage, out: &Path) -> Result<()> {
    let refused = || format!("cannot write {}", out.display());
    let file = std::fs::File::create(out).with_context(refused)?;
    let to = std::io::BufWriter::new(file);
    encode(picture, to, CompressionType::Best).with_context(refused)
}

/// As [`save`], and whole or not at all.
pub fn save_whole(picture: image::RgbaImage, out: &Path) -> Result<()> {
    let mut bytes = Vec::new();
    encode(picture, &mut bytes, CompressionType::Best)?;
    Ok(springtwin::recording::write_bytes(out, &bytes)?)
}

/// Writes an opaque picture as PNG.
pub fn encode(
    picture: image::RgbaImage,
    to: impl std::io::Write,
    how: CompressionType,
) -> image::ImageResult<()> {
    let encoder = PngEncoder::new_with_quality(to, how, FilterType::Adaptive);
    image::DynamicImage::ImageRgba8(picture)
        .into_rgb8()
        .write_with_encoder(encoder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_at_rest_is_simulated_and_can_be_shown_by_either_simulator() {
        let robot = RobotSpec::reference();
        let chamber_pa = [20e3, -10e3, -10e3, 0.0, 0.0, 0.0];
        let mut snapshot = at_rest(&robot, &chamber_pa, 0.5).expect("settles");
        assert!(snapshot.link.simulated && snapshot.shown_mesh().is_none());
        let rod = snapshot.shown_shape().cloned();
        assert_eq!(
            caption(&snapshot),
            (
                "Rod model, simulated".to_owned(),
                "20, −10, −10, 0, 0, 0 kPa, 500 g".to_owned()
            )
        );
        show_mesh(&robot, &mut snapshot).expect("settles");
        assert!(snapshot.shown_mesh().is_some());
        assert_ne!(snapshot.shown_shape().cloned(), rod);
        assert!(caption(&snapshot).0.starts_with("Mesh"));
    }
}
