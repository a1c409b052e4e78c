//! The bar above the 3D view: which simulator draws the arm, from where one looks, and what else is drawn.

use egui::{Button, Margin, Popup, PopupCloseBehavior, RichText, Ui};

use super::{Shown, View3d};
use crate::gui::panels::widgets::{gated, number};
use crate::gui::scene::Controls;
use crate::gui::scene::camera::View as Side;
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::signal::{Simulator, Snapshot};
use crate::twin::Command;

/// A part of the picture that can be switched off: where that is kept, name, tooltip.
pub type Layer = (fn(&mut Shown) -> &mut bool, &'static str, &'static str);

/// What can be drawn besides the arm.
pub const LAYERS: [Layer; 5] = [
    (
        |s| &mut s.hull,
        "Hull",
        "Outlines of where the tip has been able to go, every 25 mm of height, while a place is being chosen. Whether \
         a target can be reached is for its verdict to show.",
    ),
    (
        |s| &mut s.trails,
        "Trails",
        "Where the tip was in the last 20 s",
    ),
    (
        |s| &mut s.ghost,
        "Ghost",
        "The arm at the end of the preview, by the rod model",
    ),
    (
        |s| &mut s.walls,
        "Shadows",
        "What arm and target look like from two more sides, while a place is being chosen",
    ),
    (
        |s| &mut s.measured,
        "Measured shape",
        "The arm as springs and IMUs measure it, light and translucent, beside that of the model; not while a patch is tried",
    ),
];

/// The standard directions: name, tooltip, direction.
const SIDES: [(&str, &str, Side); 4] = [
    ("Front", "Look along y, x to the right (1)", Side::Front),
    ("Right", "Look along −x, y to the right (3)", Side::Right),
    ("Top", "Look down, x to the right (7)", Side::Top),
    (
        "Below",
        "Look up from the floor, x to the right (9)",
        Side::Below,
    ),
];

/// The bar.
pub fn ui(ui: &mut Ui, state: &mut View3d, view: &View<'_>, commands: &mut Vec<Command>) {
    let p = *Palette::in_ui(ui);
    let frame = egui::Frame::new()
        .fill(p.panel)
        .inner_margin(Margin::symmetric(8, 4));
    frame.show(ui, |ui| {
        ui.set_width(ui.available_width());
        // One line: the picture below stays where it is.
        ui.horizontal(|ui| {
            ui.spacing_mut().item_spacing.x = 3.0;
            ui.spacing_mut().button_padding.x = 5.0;
            simulators(ui, view, commands);
            let View3d { scene, shown, .. } = state;
            if let Some(scene) = scene {
                ui.separator();
                for (name, hover, side) in SIDES {
                    if ui.button(name).on_hover_text(hover).clicked() {
                        scene.camera.look(side);
                    }
                }
                let hover = "Fit the arm to the view (F)";
                if ui.button("Frame").on_hover_text(hover).clicked() {
                    scene.frame(view.snapshot);
                }
                ui.separator();
                let menu = ui
                    .button("View ▾")
                    .on_hover_text("Projection, what else is drawn, and mouse buttons");
                let mut perspective = scene.camera.is_perspective();
                Popup::menu(&menu)
                    .accessible_name("View")
                    .close_behavior(PopupCloseBehavior::CloseOnClickOutside)
                    .show(|ui| options(ui, shown, &mut perspective));
                if perspective != scene.camera.is_perspective() {
                    scene.camera.toggle_projection();
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
            ui.add_space(4.0);
            ui.add(egui::Label::new(RichText::new(text).color(color)).truncate())
                .on_hover_text(
                    "Distance between the tips by the mesh and by the rod model at the same pressures and payload",
                );
        });
    });
}

fn simulators(ui: &mut Ui, view: &View<'_>, commands: &mut Vec<Command>) {
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
}

fn options(ui: &mut Ui, shown: &mut Shown, perspective: &mut bool) {
    ui.checkbox(perspective, "Perspective")
        .on_hover_text("Far things are smaller; off: parallel lines stay parallel (5)");
    ui.separator();
    for (on, name, hover) in LAYERS {
        ui.checkbox(on(shown), name).on_hover_text(hover);
    }
    ui.separator();
    let mut cad = shown.controls == Controls::Cad;
    let hover = "On: left or middle drag turns the view, right drag shifts it. Off, as in Blender: left or middle drag \
                 turns it, with Shift it is shifted. The wheel zooms to the pointer.";
    if ui
        .checkbox(&mut cad, "CAD mouse")
        .on_hover_text(hover)
        .changed()
    {
        shown.controls = match cad {
            true => Controls::Cad,
            false => Controls::Blender,
        };
    }
}

/// The text at the right while nothing is wrong.
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
