//! What the twin is connected to, and how to connect it to something else.

use egui::{Button, RichText, TextEdit, Ui, vec2};

use super::widgets::{Gate, gated, heading, note, status};
use crate::gui::services::{Connected, Pending, PortEntry, Services};
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::signal::Mode;

/// The rigs that need no hardware: name for the program, name on screen, what it is.
pub const VIRTUAL: [(&str, &str, &str); 2] = [
    (
        "sim",
        "Virtual rig",
        "An emulated arm in this program, on simulated time: a busy computer only makes it slower",
    ),
    (
        "pty",
        "Virtual rig in real time",
        "An emulated arm in a process of its own, behind a pseudo-terminal: as hardware would be",
    ),
];

/// What the menu keeps.
#[derive(Default)]
pub struct Connection {
    /// Serial ports found last.
    pub ports: Vec<PortEntry>,
    /// What is typed as a port's name.
    typed: String,
    /// What went wrong last: one sentence.
    pub error: Option<String>,
    listing: Pending<Vec<PortEntry>>,
    joining: Pending<Connected, String>,
    /// Whether the menu is to be opened.
    pub wanted: bool,
    was_open: bool,
}

/// Height of the list of ports: longer lists are scrolled, points.
const PORTS: f32 = 140.0;

impl Connection {
    /// Whether something is awaited.
    pub fn busy(&self) -> bool {
        self.listing.is_busy() || self.joining.is_busy()
    }

    /// Takes what has come; gives the rig's name and the twin when a connection is made.
    pub fn poll(&mut self) -> Option<(String, Result<Connected, String>)> {
        match self.listing.take() {
            Some(Ok(ports)) => self.ports = ports,
            Some(Err(e)) => self.error = Some(e),
            None => {}
        }
        let (name, answer) = self.joining.take_for()?;
        self.error = answer.as_ref().err().cloned();
        Some((name, answer))
    }

    /// What is being connected to.
    pub fn joining(&self) -> Option<&str> {
        self.joining.context().map(String::as_str)
    }

    /// Gives up connecting.
    pub fn cancel(&mut self) {
        self.joining.cancel();
    }

    /// Begins to connect.
    pub fn join(&mut self, name: &str, services: &mut Services) {
        self.error = None;
        self.joining
            .begin_for(name.to_owned(), (services.connect)(name));
    }
}

/// Whether the twin may be put on another port now.
pub fn gate(live: &View<'_>, connection: &Connection) -> Gate {
    if let Some(name) = connection.joining() {
        return Err(format!("Connecting to {name}…"));
    }
    let s = live.snapshot;
    if s.recording.is_some() {
        return Err("A recording runs: end it first.".into());
    }
    let moves = matches!(s.mode, Mode::Moving | Mode::AtGoal | Mode::Hold);
    if moves && !s.link.practice && s.link.connected {
        return Err("The arm is armed: disarm it first.".into());
    }
    Ok(())
}

/// The menu behind the badge on top; gives the name of what to connect to.
pub fn menu(
    ui: &mut Ui,
    badge: &egui::Response,
    live: &View<'_>,
    connection: &mut Connection,
    services: &mut Services,
) -> Option<String> {
    let gate = gate(live, connection);
    let mut wanted = None;
    let shown = egui::Popup::menu(badge)
        .accessible_name("Connection")
        .close_behavior(egui::PopupCloseBehavior::CloseOnClickOutside)
        .show(|ui| {
            ui.set_width(380.0);
            wanted = contents(ui, live, connection, services, &gate);
        });
    if shown.is_some() && !connection.was_open {
        connection.listing.begin((services.ports)());
    }
    connection.was_open = shown.is_some();
    if wanted.is_some() {
        egui::Popup::close_all(ui.ctx());
    }
    // From the next frame on: the click that asked for it does not close it.
    if std::mem::take(&mut connection.wanted) {
        egui::Popup::open_id(ui.ctx(), egui::Popup::default_response_id(badge));
    }
    wanted
}

fn contents(
    ui: &mut Ui,
    live: &View<'_>,
    connection: &mut Connection,
    services: &mut Services,
    gate: &Gate,
) -> Option<String> {
    let link = &live.snapshot.link;
    let mut wanted = None;
    let now = if link.source.is_empty() {
        "Nothing is connected."
    } else {
        link.source.as_str()
    };
    ui.horizontal(|ui| {
        note(ui, "Now");
        ui.add(egui::Label::new(now).truncate());
    });
    if let Some(e) = &connection.error {
        status(ui, Level::Warning, e);
    }
    ui.separator();
    heading(ui, "Without hardware (simulated)");
    for (name, title, what) in VIRTUAL {
        if gated(ui, gate, row(ui, title, ""), what)
            .accessible_name(title)
            .clicked()
        {
            wanted = Some(name.to_owned());
        }
    }
    ui.separator();
    ui.horizontal(|ui| {
        heading(ui, "Serial ports");
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            if ui
                .small_button("↻")
                .accessible_name("Look for ports again")
                .on_hover_text("Look for serial ports again")
                .clicked()
            {
                connection.listing.begin((services.ports)());
            }
        });
    });
    if connection.ports.is_empty() {
        let text = if connection.listing.is_busy() {
            "Looking…"
        } else {
            "None found. Plug the boards in and look again; see springtwin doctor for rights."
        };
        note(ui, text);
    }
    egui::ScrollArea::vertical()
        .id_salt("ports")
        .max_height(PORTS)
        .show(ui, |ui| {
            for port in &connection.ports {
                let hover = format!(
                    "Connect to the boards on {} (hardware). {}",
                    port.name, port.what
                );
                if gated(
                    ui,
                    gate,
                    row(ui, &port.name, &shortened(&port.what)),
                    &hover,
                )
                .accessible_name(port.name.as_str())
                .clicked()
                {
                    wanted = Some(port.name.clone());
                }
            }
        });
    ui.horizontal(|ui| {
        let field = TextEdit::singleline(&mut connection.typed)
            .hint_text("PORT or PORT1,PORT2")
            .desired_width(260.0);
        ui.add(field)
            .accessible_name("Port or ports of the boards")
            .on_hover_text(
                "One port for both boards, or one per board with a comma between: segment 1 first",
            );
        let name = connection.typed.trim().to_owned();
        let gate = match name.is_empty() {
            true => Err("Type the name of a port first.".to_owned()),
            false => gate.clone(),
        };
        let hover = "Connect to the boards there (hardware)";
        if gated(ui, &gate, Button::new("Connect"), hover).clicked() {
            wanted = Some(name);
        }
    });
    wanted
}

/// What is behind a port, so short that the port's name stays whole; the tooltip has all of it.
fn shortened(what: &str) -> String {
    const MOST: usize = 32;
    match what.chars().count() > MOST {
        true => what.chars().take(MOST - 1).chain(['…']).collect(),
        false => what.to_owned(),
    }
}

fn row<'a>(ui: &Ui, title: &'a str, what: &str) -> Button<'a> {
    let p = Palette::in_ui(ui);
    Button::selectable(false, title)
        .right_text(RichText::new(what).small().color(p.weak))
        .truncate()
        .min_size(vec2(ui.available_width(), 28.0))
}
