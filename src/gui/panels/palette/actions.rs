//! The one list of what can be done, on whatever screen: name, other words it is found by, why it is off, and
//! what it does.

use std::path::PathBuf;

use crate::analysis::player::Player;
use crate::calibrate::Step;
use crate::gui::panels::accuracy::{self, Below, Plots, Scope};
use crate::gui::panels::calibrate::CalibrateState;
use crate::gui::panels::connect::{self, Connection, VIRTUAL};
use crate::gui::panels::gap::{self, GapState};
use crate::gui::panels::operate::{OperateState, PANES, Pane};
use crate::gui::panels::plans::PlanKind;
use crate::gui::panels::plot::TimeWindow;
use crate::gui::panels::recordings::Library;
use crate::gui::panels::sensors::Reading;
use crate::gui::panels::shell::{ShellAction, hold_gate, recording_gate};
use crate::gui::panels::target::{go_gate, gripper_gate};
use crate::gui::panels::widgets::Gate;
use crate::gui::panels::{Screen, View};
use crate::gui::scene::camera::View as Side;
use crate::signal::{ControllerKind, Gripper, Mode, Simulator};
use crate::twin::Command;

/// What an entry does.
#[derive(Clone, Debug, PartialEq)]
pub enum Deed {
    /// Something of the window.
    Window(ShellAction),
    /// Something of the twin.
    Twin(Command),
    /// Something of one screen, which is shown for it.
    Screen(Act),
}

/// What is done on one screen.
#[derive(Clone, Debug, PartialEq)]
pub enum Act {
    /// Begin a recording under a fresh name.
    Record,
    /// Bring a panel of Operate to the front.
    Pane(Pane),
    /// Set up a plan of this kind.
    Plan(PlanKind),
    /// Make waypoints by clicks in the 3D view.
    Draw,
    /// Preview the place of the tip without pressure.
    Home,
    /// Preview the target that is typed.
    Preview,
    /// Move to the target under preview.
    Go,
    /// Look from this side.
    Look(Side),
    /// Perspective or parallel lines.
    Projection,
    /// Let the arm fill the view.
    Frame,
    /// Hold the plots still, or follow the newest values.
    Freeze,
    /// Two cursors in the plots of the sensors.
    Cursors,
    /// What figures and plots of the sensors show.
    Reading(Reading),
    /// What the plots of the errors show.
    Plots(Plots),
    /// What stands below the table of errors.
    Below(Below),
    /// What is scored.
    Score(Scope),
    /// Next (else previous) peak of the error.
    Peak(bool),
    /// Write the scores.
    Export(accuracy::Kind),
    /// A step of the calibration.
    Calibrate(Step),
    /// Look for recordings again.
    Refresh,
    /// Choose a recording in a file dialog.
    Browse,
    /// Load this recording and play it.
    Play(PathBuf),
    /// Play or pause the recording that is shown.
    PlayPause,
    /// Show the running twin in the Rerun viewer.
    LiveInRerun,
    /// Have two sessions made in which something is hidden.
    Example,
    /// Look for what the model is missing.
    Find,
    /// A step of the search for what is missing.
    Gap(gap::Step),
    /// Connect to a rig of this name.
    Connect(&'static str),
    /// Open the list of boards.
    ConnectMenu,
}

/// One entry.
pub struct Entry {
    /// What it does, in words.
    pub name: String,
    /// Other words it is found by.
    pub words: &'static str,
    /// Its shortcut; may be empty.
    pub keys: &'static str,
    /// Whether it can be done now, or why not.
    pub gate: Gate,
    /// What it does.
    pub deed: Deed,
}

/// What the list is made from.
pub struct Known<'a> {
    /// The live twin's view.
    pub live: View<'a>,
    /// Whether the plan on hold may be resumed, or why not.
    pub may_resume: &'a Gate,
    /// Whether there is no twin.
    pub twin_gone: bool,
    /// The recording that is shown, if one is.
    pub player: Option<&'a Player>,
    /// The window of time of all plots.
    pub window: &'a TimeWindow,
    /// Operate.
    pub operate: &'a OperateState,
    /// Calibrate.
    pub calibrate: &'a CalibrateState,
    /// The recordings.
    pub library: &'a Library,
    /// Gap.
    pub gap: &'a GapState,
    /// What the twin could be connected to.
    pub connection: &'a Connection,
}

/// Everything that can be done, with what stands in the way of what cannot be done now.
pub fn entries(known: &Known<'_>) -> Vec<Entry> {
    let mut all = List::default();
    window(&mut all, known);
    twin(&mut all, known);
    operate(&mut all, known);
    plots(&mut all, known);
    calibrate(&mut all, known);
    recordings(&mut all, known);
    search(&mut all, known);
    all.0
}

#[derive(Default)]
struct List(Vec<Entry>);

impl List {
    fn add(&mut self, name: impl Into<String>, words: &'static str, gate: Gate, deed: Deed) {
        self.0.push(Entry {
            name: name.into(),
            words,
            keys: "",
            gate,
            deed,
        });
    }

    fn act(&mut self, name: impl Into<String>, words: &'static str, gate: Gate, act: Act) {
        self.add(name, words, gate, Deed::Screen(act));
    }

    /// The last one has this shortcut.
    fn by(&mut self, keys: &'static str) {
        if let Some(last) = self.0.last_mut() {
            last.keys = keys;
        }
    }
}

fn check(ok: bool, why: &str) -> Gate {
    if ok { Ok(()) } else { Err(why.to_owned()) }
}

fn window(all: &mut List, known: &Known<'_>) {
    let keys = ["Ctrl+1", "Ctrl+2", "Ctrl+3", "Ctrl+4", "Ctrl+5", "Ctrl+6"];
    for (screen, keys) in Screen::ALL.into_iter().zip(keys) {
        let show = Deed::Window(ShellAction::Show(screen));
        all.add(
            format!("Show {}", screen.name()),
            "screen go to",
            Ok(()),
            show,
        );
        all.by(keys);
    }
    for (name, words, gate, action) in [
        (
            "Close the replay",
            "live recording",
            check(known.player.is_some(), "No recording is shown."),
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
        all.add(name, words, gate, Deed::Window(action));
        if action == ShellAction::ToggleShortcuts {
            all.by("?");
        }
    }
    let gate = connect::gate(&known.live, known.connection);
    for (rig, title, _) in VIRTUAL {
        let name = format!("Connect to: {}", title.to_lowercase());
        let words = "simulated simulation sim demo start rig";
        all.act(name, words, gate.clone(), Act::Connect(rig));
    }
    let words = "connect serial usb hardware arduino port";
    all.act(
        "Choose a port of the boards…",
        words,
        Ok(()),
        Act::ConnectMenu,
    );
}

fn twin(all: &mut List, known: &Known<'_>) {
    let live = &known.live;
    let s = live.snapshot;
    let there = check(!known.twin_gone, "No twin is running.");
    let is_safe = matches!(s.mode, Mode::Safe(_));
    let stop = Deed::Twin(Command::Stop);
    all.add("Stop: pumps off", "emergency halt", there.clone(), stop);
    all.by("Shift+Esc");
    let hold = there.clone().and(hold_gate(s));
    all.add("Hold", "pause wait", hold, Deed::Twin(Command::Hold));
    all.by("Space");
    let held = check(
        s.link.simulated,
        "Hardware moves: keep RESUME in the top bar pressed.",
    );
    let resume = there.clone().and(known.may_resume.clone()).and(held);
    let deed = Deed::Twin(Command::Resume);
    all.add("Resume the plan on hold", "continue go on", resume, deed);
    let simulated = check(
        s.link.simulated,
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
        all.add(name, words, gate, Deed::Twin(command));
    }
    for (name, gripper) in [
        ("Open the gripper", Gripper::Open),
        ("Close the gripper", Gripper::Closed),
    ] {
        let gate = there.clone().and(gripper_gate(live));
        all.add(name, "hand grip", gate, Deed::Twin(Command::Grip(gripper)));
    }
    for (name, kind) in [
        (
            "Steer by the bounded controller",
            ControllerKind::NullSpaceQp,
        ),
        ("Steer by the paper's controller", ControllerKind::PaperAdrc),
    ] {
        let gate = check(s.controller != kind, "It steers already.");
        let deed = Deed::Twin(Command::Steer(kind));
        all.add(name, "control", there.clone().and(gate), deed);
    }
    for (name, simulator) in [
        ("Draw the arm by the rod model", Simulator::Rod),
        ("Draw the arm by the mesh", Simulator::Mesh),
    ] {
        let gate = check(s.simulator != simulator, "It is drawn so already.");
        let deed = Deed::Twin(Command::Show(simulator));
        all.add(name, "simulator", there.clone().and(gate), deed);
    }
    let recording = recording_gate(live, known.twin_gone);
    let words = "record recording save log file";
    match s.recording {
        Some(_) => {
            let deed = Deed::Twin(Command::StopRecording);
            all.add("End the recording", words, recording, deed);
        }
        None => all.act("Record", words, recording, Act::Record),
    }
    match s.streaming {
        Some(_) => {
            let deed = Deed::Twin(Command::StopStream);
            all.add("Stop streaming", "rerun viewer", there, deed);
        }
        None => all.act(
            "Open live in Rerun",
            "viewer stream",
            there,
            Act::LiveInRerun,
        ),
    }
}

fn operate(all: &mut List, known: &Known<'_>) {
    let live = &known.live;
    let draft = &known.operate.draft;
    let s = live.snapshot;
    let shown = check(
        known.player.is_none(),
        "A recording is shown: close the replay first.",
    );
    let typed = shown.clone().and(draft.parse().map(|_| ()));
    all.act(
        "Preview the target",
        "check reach goal",
        typed,
        Act::Preview,
    );
    let held = check(
        s.link.simulated,
        "Hardware moves only while ▶ Hold to go is held in the Target panel.",
    );
    let go = shown.clone().and(go_gate(live, draft)).and(held);
    all.act("Go to the target", "move motion", go, Act::Go);
    let cancel = check(s.preview.is_some(), "Nothing is under preview.");
    let deed = Deed::Twin(Command::CancelPreview);
    all.add("Cancel the preview", "forget target", cancel, deed);
    all.by("Esc");
    let words = "home rest zero neutral straight down park centre";
    all.act("Preview the home position", words, shown.clone(), Act::Home);
    for (kind, name, words) in [
        (PlanKind::Circle, "Set up a circle", "plan path loop round"),
        (PlanKind::Eight, "Set up a figure 8", "plan path eight loop"),
        (
            PlanKind::PickPlace,
            "Set up pick and place",
            "plan gripper lift object",
        ),
        (PlanKind::Points, "Set up waypoints", "plan path points"),
    ] {
        all.act(name, words, Ok(()), Act::Plan(kind));
    }
    let words = "plan path points click";
    all.act("Draw waypoints in the 3D view", words, shown, Act::Draw);
    for pane in PANES {
        let name = format!("Show the panel {}", pane.title());
        all.act(name, "operate dock tab", Ok(()), Act::Pane(pane));
    }
    let scene = check(
        known.operate.view3d.scene.is_some(),
        "There is no graphics adapter: the side view has one direction.",
    );
    for (name, keys, act) in [
        (
            "Look at the arm from the front",
            "1",
            Act::Look(Side::Front),
        ),
        (
            "Look at the arm from the right",
            "3",
            Act::Look(Side::Right),
        ),
        ("Look at the arm from the top", "7", Act::Look(Side::Top)),
        ("Perspective or parallel lines", "5", Act::Projection),
        ("Frame the arm", "F", Act::Frame),
    ] {
        all.act(name, "3d view camera zoom fit", scene.clone(), act);
        all.by(keys);
    }
}

fn plots(all: &mut List, known: &Known<'_>) {
    let name = match known.window.frozen_end_s {
        Some(_) => "Follow the newest values in the plots",
        None => "Freeze the plots",
    };
    all.act(name, "pause signals time", Ok(()), Act::Freeze);
    let words = "a b difference measure plots sensors";
    all.act("Cursors A and B", words, Ok(()), Act::Cursors);
    for (name, reading) in [
        ("Show calibrated readings", Reading::Calibrated),
        ("Show raw readings", Reading::Raw),
        ("Show residuals of the readings", Reading::Residual),
    ] {
        let words = "sensors springs imu lengths angles frequency";
        all.act(name, words, Ok(()), Act::Reading(reading));
    }
    for (name, act) in [
        ("Plot the errors", Act::Plots(Plots::Errors)),
        (
            "Plot prediction and Vicon overlaid",
            Act::Plots(Plots::Overlay),
        ),
        ("Show errors over time", Act::Below(Below::Time)),
        ("Show errors in space", Act::Below(Below::Space)),
        ("Show errors by bins", Act::Below(Below::Bins)),
        ("Show frames and clocks", Act::Below(Below::Frames)),
        ("Score everything", Act::Score(Scope::All)),
        ("Score the window", Act::Score(Scope::Window)),
    ] {
        all.act(name, "accuracy workspace load speed", Ok(()), act);
    }
    let history = known.player.map_or(known.live.history, Player::history);
    let now_s = known.player.map_or(known.live.now_s, Player::now_s);
    let scored = check(
        accuracy::is_scored(history, now_s),
        "Nothing is scored yet: there are no errors.",
    );
    for (name, keys, forward) in [
        ("Next peak of the error", "J", true),
        ("Previous peak of the error", "K", false),
    ] {
        all.act(name, "accuracy worst", scored.clone(), Act::Peak(forward));
        all.by(keys);
    }
    for (name, kind) in [
        ("Export the errors as a table (CSV)", accuracy::Kind::Csv),
        ("Export a picture of Accuracy (PNG)", accuracy::Kind::Png),
        (
            "Export the report of Accuracy (HTML)",
            accuracy::Kind::Report,
        ),
    ] {
        let words = "write save file accuracy scores";
        all.act(name, words, scored.clone(), Act::Export(kind));
    }
}

fn calibrate(all: &mut List, known: &Known<'_>) {
    for step in Step::ALL {
        let gate = known
            .calibrate
            .wizard()
            .map_or(Ok(()), |w| w.may_enter(step));
        let name = format!("Calibrate: {}", step.name());
        all.act(name, "calibration wizard step", gate, Act::Calibrate(step));
    }
}

fn recordings(all: &mut List, known: &Known<'_>) {
    let some = check(known.player.is_some(), "No recording is shown.");
    all.act(
        "Play or pause the recording",
        "replay",
        some,
        Act::PlayPause,
    );
    all.by("P");
    let words = "open load file log session";
    all.act("Browse for a recording…", words, Ok(()), Act::Browse);
    let words = "library scan recordings";
    all.act("Look for recordings again", words, Ok(()), Act::Refresh);
    for entry in &known.library.entries {
        let name = format!("Play {}", entry.name);
        let act = Act::Play(entry.path.clone());
        all.act(name, "recording load replay open", Ok(()), act);
    }
}

fn search(all: &mut List, known: &Known<'_>) {
    let words = "example demo sample hidden gap practice";
    let gate = known.gap.example_gate();
    all.act(
        "Use an example with a hidden effect",
        words,
        gate,
        Act::Example,
    );
    let words = "gap finder model search effect";
    let gate = known.gap.find_gate();
    all.act("Find what the model is missing", words, gate, Act::Find);
    for step in gap::Step::ALL {
        let words = match step {
            gap::Step::Prove => "effect finding report export save",
            _ => "effect finding sessions",
        };
        let name = format!("Gap: {}", step.name());
        all.act(name, words, known.gap.gate(step), Act::Gap(step));
    }
}
