//! Pictures of the arm at rest, by either simulator.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, Result};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};

use springtwin::gui::offscreen::Offscreen;
use springtwin::gui::scene::{Picking, Scene, SceneInput, Theme};
use springtwin::gui::theme::Palette;
use springtwin::robot::RobotSpec;
use springtwin::signal::{
    CHAMBERS, Health, LinkStatus, Quality, SIGNALS, SensorFrame, Simulator, Snapshot, Stamp,
};
use springtwin::sim::{Inputs, Model, State, observe, settle};
use springtwin::twin::{MeshQuestion, MeshSolver};

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

/// Writes a picture as small as PNG makes it; a window is opaque, so its alpha is dropped.
pub fn save(picture: image::RgbaImage, out: &Path) -> Result<()> {
    let refused = || format!("cannot write {}", out.display());
    let file = std::fs::File::create(out).with_context(refused)?;
    let encoder = PngEncoder::new_with_quality(
        std::io::BufWriter::new(file),
        CompressionType::Best,
        FilterType::Adaptive,
    );
    image::DynamicImage::ImageRgba8(picture)
        .into_rgb8()
        .write_with_encoder(encoder)
        .with_context(refused)
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
