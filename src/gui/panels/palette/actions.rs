//! The one list of what can be done, on whatever screen: name, other words it is found by, why it is off, and
//! what it does.

use crate::gui::panels::connect::{self, Connection, VIRTUAL};
use crate::gui::panels::operating::hold_gate;
use crate::gui::panels::plot::SPANS;
use crate::gui::panels::shell::{ShellAction, Vent};
use crate::gui::panels::target::gripper_gate;
use crate::gui::screen::{Action, Ctx, Known, Task, check};
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

/// Everything that can be done, with what stands in the way of what cannot be done now. `typed` may have a number that
/// an action needs.
pub fn entries(
    known: &Known<'_>,
    connection: &Connection,
    screens: &Screens,
    typed: &str,
) -> Vec<Entry> {
    let mut found = Vec::new();
    let mut take = |group, all: List| {
        found.extend(all.0.into_iter().map(|action| Entry { group, ..action }));
    };
    let mut of_window = List::default();
    window(&mut of_window, known, connection);
    take("Window", of_window);
    let mut of_arm = List::default();
    twin(&mut of_arm, known);
    payload(&mut of_arm, known, typed);
    take("Arm", of_arm);
    let of_screens = screens.actions(known).into_iter();
    found.extend(of_screens.map(|action| {
        // The name of the screen, whatever it does.
        let group = action.task.0.name();
        let action = action.map(|(id, task)| match task {
            Task::Twin(command) => Choice::Twin(command),
            task => Choice::Screen(id, task),
        });
        Entry { group, ..action }
    }));
    found
}

#[derive(Default)]
struct List(Vec<Entry>);

impl List {
    fn add(&mut self, name: impl Into<String>, words: &'static str, gate: Gate, task: Choice) {
        self.0.push(Entry {
            group: "",
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
        (
            "Show the messages",
            "notices warnings log list",
            Ok(()),
            ShellAction::ShowMessages,
        ),
        (
            "Show the alarms",
            "warnings critical list",
            Ok(()),
            ShellAction::ShowAlarms,
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
    let words = "connect serial usb hardware arduino port offline";
    let menu = Choice::Window(ShellAction::ChoosePort);
    all.add("Choose a port of the boards…", words, Ok(()), menu);
    let name = match known.window.frozen_end_s {
        Some(_) => "Follow the newest values in the plots",
        None => "Freeze the plots",
    };
    let freeze = Choice::Window(ShellAction::ToggleFreeze);
    all.add(name, "pause signals time", Ok(()), freeze);
    for (span_s, text) in SPANS {
        let task = Task::Behind(Box::new(move |_: &mut Screens, ctx: &mut Ctx<'_>| {
            ctx.window.span_s = span_s;
        }));
        let gate = check(
            known.window.span_s != span_s,
            "The plots show this much time already.",
        );
        let name = format!("Show {text} in the plots");
        let words = "time window span zoom seconds minutes";
        all.add(name, words, gate, Choice::Screen(ScreenId::default(), task));
    }
}

/// The mass in the gripper: the number that is typed behind the word, g.
fn payload(all: &mut List, known: &Known<'_>, typed: &str) {
    let words = "mass load weight gripper grams g object";
    let number = typed.split_whitespace().find_map(|word| {
        let grams = word.trim_end_matches('g').replace(',', ".");
        let grams = grams.parse::<f64>().ok().filter(|g| g.is_finite())?;
        Some((word, grams))
    });
    let there = check(!known.twin_gone, "No twin is running.").and(known.live.live());
    let most_g = known.live.spec.payload_max_kg * 1e3;
    let Some((word, grams)) = number else {
        let why = "Type the mass in g behind it, as “payload 35”.".to_owned();
        let task = Choice::Twin(Command::DeclarePayload(0.0));
        all.add("Declare the payload", words, there.and(Err(why)), task);
        return;
    };
    let within = match (0.0..=most_g).contains(&grams) {
        true => Ok(()),
        false => Err(format!("The gripper carries 0 to {most_g:.0} g.")),
    };
    let task = Choice::Twin(Command::DeclarePayload(grams * 1e-3));
    // As it was typed, so that it is found.
    let unit = if word.ends_with('g') { "" } else { " g" };
    let name = format!("Declare the payload: {word}{unit}");
    all.add(name, words, there.and(within), task);
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
    let rests = check(
        Vent::is_offered(s),
        "There is no air to let out of an arm at rest.",
    );
    let held = check(
        !s.link.moves_hardware(),
        "Hardware sags: keep VENT in the top bar pressed.",
    );
    let vent = there.clone().and(rests).and(Vent::gate(live)).and(held);
    let task = Choice::Twin(Command::Vent);
    let words = "air out release deflate pressure empty";
    all.add("Vent the chambers", words, vent, task);
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
            "hand grip closed",
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
