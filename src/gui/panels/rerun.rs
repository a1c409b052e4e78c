//! The running twin in the Rerun viewer: start, watch, stop.

use core::net::SocketAddr;

use egui::{Button, Ui};

use super::widgets::{Gate, gated, note, status};
use crate::gui::services::{Pending, Services};
use crate::gui::theme::Level;
use crate::gui::view::View;
use crate::signal::{StreamState, StreamStatus};
use crate::twin::Command;

/// A viewer that is being started.
#[derive(Default)]
pub struct LiveViewer {
    starting: Pending<SocketAddr>,
    /// Why it could not be started: one sentence.
    error: Option<String>,
}

impl LiveViewer {
    /// Whether something is awaited.
    pub fn busy(&self) -> bool {
        self.starting.is_busy()
    }

    /// Starts a viewer, or finds the one that runs.
    pub fn start(&mut self, services: &mut Services) {
        self.error = None;
        self.starting.begin((services.start_viewer)());
    }

    /// Takes what has come, whatever screen is shown: a viewer that is ready is streamed to.
    pub fn poll(&mut self, commands: &mut Vec<Command>) {
        let Some(answer) = self.starting.take() else {
            return;
        };
        match answer {
            Ok(address) => commands.push(Command::StreamLive(address)),
            Err(e) => self.error = Some(e),
        }
    }
}

/// The row.
pub fn live_in_rerun(
    ui: &mut Ui,
    live: &View<'_>,
    twin_gone: bool,
    viewer: &mut LiveViewer,
    services: &mut Services,
    commands: &mut Vec<Command>,
) {
    let gate: Gate = if twin_gone {
        Err("No twin is running: there is nothing to stream.".into())
    } else {
        Ok(())
    };
    let stream = live.snapshot.streaming.as_ref();
    ui.horizontal_wrapped(|ui| match (viewer.starting.is_busy(), stream) {
        (true, _) => {
            ui.spinner();
            note(ui, "Starting the Rerun viewer…");
            if ui
                .button("Cancel")
                .accessible_name("Cancel starting the viewer")
                .on_hover_text("Do not wait for the Rerun viewer")
                .clicked()
            {
                viewer.starting.cancel();
            }
        }
        (false, Some(s)) if !matches!(s.state, StreamState::Ended(_)) => {
            streaming(ui, &gate, s, commands);
            // A viewer that is away is given up for another.
            if matches!(s.state, StreamState::Away(_)) && open(ui, &gate, viewer, services) {
                commands.push(Command::StopStream);
            }
        }
        (false, _) => {
            open(ui, &gate, viewer, services);
        }
    });
    let ended = stream.and_then(|s| match &s.state {
        StreamState::Ended(reason) | StreamState::Away(reason) => Some(reason),
        StreamState::Starting | StreamState::Streaming => None,
    });
    if !viewer.starting.is_busy()
        && let Some(text) = viewer.error.as_ref().or(ended)
    {
        status(ui, Level::Warning, text);
    }
}

/// The button that starts a viewer to stream to; whether it was pressed.
fn open(ui: &mut Ui, gate: &Gate, viewer: &mut LiveViewer, services: &mut Services) -> bool {
    let hover = "Show the running twin in the Rerun viewer, on this computer only";
    let pressed = gated(ui, gate, Button::new("Open live in Rerun"), hover).clicked();
    if pressed {
        viewer.start(services);
    }
    pressed
}

fn streaming(ui: &mut Ui, gate: &Gate, s: &StreamStatus, commands: &mut Vec<Command>) {
    let hover = "End the stream; the viewer keeps what it has";
    if gated(ui, gate, Button::new("■ Stop streaming"), hover).clicked() {
        commands.push(Command::StopStream);
    }
    if s.state == StreamState::Starting {
        ui.spinner();
        note(ui, format!("Connecting to the viewer at {}…", s.address));
        return;
    }
    if matches!(s.state, StreamState::Away(_)) {
        ui.spinner();
        note(ui, "Viewer away: trying again");
        return;
    }
    ui.label(format!("● streaming to {}", s.address))
        .on_hover_text(format!("{} snapshots were sent", s.sent));
    if s.dropped > 0 {
        status(ui, Level::Warning, &format!("{} dropped", s.dropped)).on_hover_text(
            "Snapshots that the viewer was too slow to take; control does not wait for it",
        );
    }
}
