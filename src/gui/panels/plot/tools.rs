//! The row of controls above plots: cursors, smoothing, export, and the window of time.

use egui::{Button, Popup, PopupCloseBehavior, Ui};

use super::TimeWindow;
use super::export::{Export, Format};
use crate::gui::view::View;

/// How much width the controls have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fit {
    /// Little: signs only, and what is needed less often is in a menu.
    Brief,
    /// What is needed less often is in a menu.
    Menu,
    /// Smoothing and export are in a menu.
    Cursors,
    /// Everything in the row.
    Full,
}

const CURSORS: &str = "Two cursors with differences. A click in a plot moves the nearer one";
const SMOOTH: &str =
    "Show a moving average over 0.2 s (or five pixels, if these are longer) over the signals";

/// The controls.
pub fn tools(ui: &mut Ui, view: &View<'_>, window: &mut TimeWindow, export: &mut Export, fit: Fit) {
    if fit >= Fit::Cursors {
        let button = Button::selectable(window.cursors_s.is_some(), "A|B");
        if ui
            .add(button.frame_when_inactive(true))
            .accessible_name("Cursors A and B")
            .on_hover_text(CURSORS)
            .clicked()
        {
            window.toggle_cursors(view);
        }
    }
    if fit == Fit::Full {
        let button = Button::selectable(window.smooth, "Smooth").frame_when_inactive(true);
        if ui.add(button).on_hover_text(SMOOTH).clicked() {
            window.smooth = !window.smooth;
        }
        let response = ui
            .button("Export ▾")
            .accessible_name("Export")
            .on_hover_text("Write what the plots show to a file");
        Popup::menu(&response)
            .accessible_name("Export")
            .show(|ui| formats(ui, export));
    } else {
        menu(ui, view, window, export, fit);
    }
    window.controls_in(ui, view, fit == Fit::Brief);
}

fn menu(ui: &mut Ui, view: &View<'_>, window: &mut TimeWindow, export: &mut Export, fit: Fit) {
    let text = match fit {
        Fit::Brief => "▾",
        Fit::Menu | Fit::Cursors | Fit::Full => "Tools ▾",
    };
    let has_cursors = fit < Fit::Cursors;
    let active = window.smooth || (has_cursors && window.cursors_s.is_some());
    let response = ui
        .add(Button::selectable(active, text).frame_when_inactive(true))
        .accessible_name("Plot tools")
        .on_hover_text("Cursors, smoothing, export");
    Popup::menu(&response)
        .accessible_name("Plot tools")
        .close_behavior(PopupCloseBehavior::CloseOnClick)
        .show(|ui| {
            let mut on = window.cursors_s.is_some();
            if has_cursors
                && ui
                    .checkbox(&mut on, "Cursors A and B")
                    .on_hover_text(CURSORS)
                    .clicked()
            {
                window.toggle_cursors(view);
            }
            ui.checkbox(&mut window.smooth, "Smooth")
                .on_hover_text(SMOOTH);
            ui.separator();
            formats(ui, export);
        });
}

fn formats(ui: &mut Ui, export: &mut Export) {
    for format in Format::ALL {
        let button = ui.button(format!("Export {}", format.name()));
        if button.on_hover_text(format.hover()).clicked() {
            export.wanted = Some(format);
        }
    }
}
