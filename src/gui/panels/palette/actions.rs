//! The one list of what can be done, on whatever screen: name, other words it is found by, why it is off, and
//! what it does.

use crate::gui::panels::connect::{self, Connection, VIRTUAL};
use crate::gui::panels::operating::hold_gate;
use crate::gui::panels::shell::ShellAction;
use crate::gui::panels::target::gripper_gate;
use crate::gui::screen::{Action, Known, Task, check};
use crate::gui::screens::{ScreenId, Screens};
use crate::gui::view::Gate;
use crate::signal::{ControllerKind, Gripper, Mode, Simulator};
use crate::twin::Command;

/// What an entry does.
pub enum Choice {
    /// Acts on the window.
    Window(ShellAction),
    /// Sends an order to the twin.
    Twin(Command),
    /// Acts on a screen.
    Screen(ScreenId, Task<Screens>),
}

/// One entry.
pub type Entry = Action<Choice>;

/// Everything that can be done, with what stands in the way of what cannot be done now.
pub fn entries(known: &Known<'_>, connection: &Connection, screens: &Screens) -> Vec<Entry> {
    let mut all = List::default();
    window(&mut all, known, connection);
    twin(&mut all, known);
    let of_screens = screens.actions(known).into_iter();
    all.0.extend(of_screens.map(|action| {
        action.map(|(id, task)| match task {
            Task::Twin(command) => Choice::Twin(command),
            task => Choice::Screen(id, task),
        })
    }));
    all.0
}

#[derive(Default)]
struct List(Vec<Entry>);

impl List {
    fn add(&mut self, name: impl Into<String>, words: &'static str, gate: Gate, task: Choice) {
        self.0.push(Entry {
            name: name.into(),
            words,
            keys: "",
            gate,
            task,
        });
    }

    /// The last one has this shortcut.
    fn by(&mut self, keys: &'static str) {
        if let Some(last) = self.0.last_mut() {
            last.keys = keys;
        }
    }
}

fn window(all: &mut List, known: &Known<'_>, connection: &Connection) {
    for screen in ScreenId::ALL {
        let name = format!("Show {}", screen.name());
        let show = Choice::Window(ShellAction::Show(screen));
        all.add(name, "screen go to", Ok(()), show);
        all.by(screen.shortcut());
    }
    for (name, words, gate, action) in [
        (
            "Close the replay",
            "live recording",
            check(known.shown.replay.is_some(), "No recording is shown."),
            ShellAction::CloseReplay,
        ),
        (
            "Switch between light and dark",
            "theme colours mode night day appearance",
            Ok(()),
            ShellAction::ToggleTheme,
        ),
        (
            "Reset the layout of Operate",
            "panels default dock",
            Ok(()),
            ShellAction::ResetLayout,
        ),
        (
            "Keyboard shortcuts",
            "keys help list",
            Ok(()),
            ShellAction::ToggleShortcuts,
        ),
        (
            "Show the welcome",
            "help begin start tour",
            Ok(()),
            ShellAction::ShowWelcome,
        ),
    ] {
        all.add(name, words, gate, Choice::Window(action));
        if action == ShellAction::ToggleShortcuts {
            all.by("?");
        }
    }
    let gate = connect::gate(&known.live, connection);
    for (rig, title, _) in VIRTUAL {
        let name = format!("Connect to: {}", title.to_lowercase());
        let words = "simulated simulation sim demo start rig";
        all.add(
            name,
            words,
            gate.clone(),
            Choice::Window(ShellAction::Connect(rig)),
        );
    }
    let words = "connect serial usb hardware arduino port";
    let menu = Choice::Window(ShellAction::ChoosePort);
    all.add("Choose a port of the boards…", words, Ok(()), menu);
    let name = match known.window.frozen_end_s {
        Some(_) => "Follow the newest values in the plots",
        None => "Freeze the plots",
    };
    let freeze = Choice::Window(ShellAction::ToggleFreeze);
    all.add(name, "pause signals time", Ok(()), freeze);
}

fn twin(all: &mut List, known: &Known<'_>) {
    let live = &known.live;
    let s = live.snapshot;
    let there = check(!known.twin_gone, "No twin is running.");
    let is_safe = matches!(s.mode, Mode::Safe(_));
    let stop = Choice::Twin(Command::Stop);
    all.add("Stop: pumps off", "emergency halt", there.clone(), stop);
    all.by("Shift+Esc");
    let hold = there.clone().and(hold_gate(s));
    all.add("Hold", "pause wait", hold, Choice::Twin(Command::Hold));
    all.by("Space");
    let held = check(
        !s.link.moves_hardware(),
        "Hardware moves: keep RESUME in the top bar pressed.",
    );
    let resume = there.clone().and(known.may_resume.clone()).and(held);
    let task = Choice::Twin(Command::Resume);
    all.add("Resume the plan on hold", "continue go on", resume, task);
    let simulated = check(
        !s.link.moves_hardware(),
        "Hardware is armed in the Target panel, after its checks.",
    );
    let armed = check(s.mode == Mode::Disarmed, "The arm is not disarmed.");
    let disarmed = check(
        !is_safe && s.mode != Mode::Disarmed,
        "The arm is not armed.",
    );
    for (name, words, gate, command) in [
        (
            "Reset: leave SAFE",
            "alarm clear",
            check(is_safe, "The arm is not in SAFE."),
            Command::Reset,
        ),
        (
            "Arm the simulated arm",
            "enable motion",
            there.clone().and(simulated).and(armed),
            Command::Arm,
        ),
        ("Disarm", "disable motion", disarmed, Command::Disarm),
    ] {
        all.add(name, words, gate, Choice::Twin(command));
    }
    for (name, gripper) in [
        ("Open the gripper", Gripper::Open),
        ("Close the gripper", Gripper::Closed),
    ] {
        let drops = gripper == Gripper::Open && s.link.moves_hardware() && s.payload_kg > 0.0;
        let falls = check(
            !drops,
            "The load would fall: hold the button in the Target panel.",
        );
        let gate = there.clone().and(gripper_gate(live)).and(falls);
        all.add(
            name,
            "hand grip",
            gate,
            Choice::Twin(Command::Grip(gripper)),
        );
    }
    for (name, kind) in [
        (
            "Use the controller: null-space QP",
            ControllerKind::NullSpaceQp,
        ),
        (
            "Use the controller: ADRC (paper)",
            ControllerKind::PaperAdrc,
        ),
    ] {
        let gate = check(s.controller != kind, "This controller is in use.");
        let task = Choice::Twin(Command::Steer(kind));
        all.add(name, "control", there.clone().and(gate), task);
    }
    for (name, simulator) in [
        ("Draw the arm by the rod model", Simulator::Rod),
        ("Draw the arm by the mesh", Simulator::Mesh),
    ] {
        let gate = check(
            s.simulator != simulator,
            "The arm is drawn this way already.",
        );
        let task = Choice::Twin(Command::Show(simulator));
        all.add(name, "simulator", there.clone().and(gate), task);
    }
}
