//! Which simulator stands behind the drawn arm, and how far apart the two are.

use egui::{Button, Margin, RichText, Ui};

use super::widgets::{gated, note, number};
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::signal::{Simulator, Snapshot};
use crate::twin::Command;

/// The bar above the 3D view.
pub fn ui(ui: &mut Ui, view: &View<'_>, commands: &mut Vec<Command>) {
    let p = *Palette::in_ui(ui);
    let frame = egui::Frame::new()
        .fill(p.panel)
        .inner_margin(Margin::symmetric(10, 4));
    frame.show(ui, |ui| {
        ui.set_width(ui.available_width());
        // The text never takes a line of its own: the view below stays where it is.
        ui.horizontal(|ui| {
            note(ui, "Simulator");
            let gate = view.live();
            for (simulator, name, hover) in [
                (
                    Simulator::Rod,
                    "Rod",
                    "Draw the arm by the rod model. Nothing moves.",
                ),
                (
                    Simulator::Mesh,
                    "Mesh",
                    "Draw the arm by the geometric simulator, its mesh as the skin. Nothing moves.",
                ),
            ] {
                let chosen = view.snapshot.simulator == simulator;
                let button = Button::selectable(chosen, name).frame_when_inactive(true);
                if gated(ui, &gate, button, hover).clicked() && !chosen {
                    commands.push(Command::Show(simulator));
                }
            }
            let (text, color) = match (readout(view.snapshot), &view.snapshot.mesh_trouble) {
                (_, Some(trouble)) => {
                    let text = format!("{} {trouble}", Level::Warning.glyph());
                    (text, p.warning)
                }
                (Some(text), None) => (text, p.weak),
                (None, None) => return,
            };
            ui.add(egui::Label::new(RichText::new(text).color(color)).truncate())
                .on_hover_text(
                    "Distance between the tips by the mesh and by the rod model at the same \
                     pressures and payload",
                );
        });
    });
}

/// The text beside the switch while nothing is wrong.
fn readout(snapshot: &Snapshot) -> Option<String> {
    match (snapshot.simulator, &snapshot.mesh) {
        (Simulator::Rod, _) => None,
        (Simulator::Mesh, None) if snapshot.sensors.is_none() => {
            Some("Waiting for the first pressures.".into())
        }
        (Simulator::Mesh, None) => {
            Some("The mesh is being built; until then the rod model is drawn.".into())
        }
        (Simulator::Mesh, Some(mesh)) => Some(match mesh.apart_m {
            Some(m) => format!("{} mm from the rod model", number(m * 1e3, 1)),
            None => "The rod model finds no equilibrium here.".into(),
        }),
    }
}
