//! What a screen of the window is, and what every screen is given.

use egui::{Ui, Vec2};

use super::panels::plot::TimeWindow;
use super::services::Services;
use super::theme::Level;
use super::view::{Gate, View};
use crate::analysis::player::Player;
use crate::robot::RobotSpec;
use crate::signal::Snapshot;
use crate::twin::{Command, Event};

/// What a screen sees and may change besides its own state.
pub struct Ctx<'a> {
    /// The live twin.
    pub live: View<'a>,
    /// The recording that is played, else the live twin.
    pub shown: View<'a>,
    /// Whether there is no twin.
    pub twin_gone: bool,
    /// The time window of all plots.
    pub window: &'a mut TimeWindow,
    /// The spring (0-based) that is highlighted in plots and in 3D.
    pub selected_spring: &'a mut Option<usize>,
    /// The recording that is played instead of the live twin, if one is.
    pub player: &'a mut Option<Player>,
    /// What the window asks of the program around it.
    pub services: &'a mut Services,
    /// Orders to the twin.
    pub commands: &'a mut Vec<Command>,
    /// Messages for the operator.
    pub messages: Vec<(String, Level)>,
}

/// A screen of the window: what it keeps, shows and offers. A screen is added by one file with its `impl Screen`,
/// and one line in the list of [`screens`](super::screens).
pub trait Screen: Sized {
    /// Name on screen.
    const NAME: &'static str;
    /// Its purpose, one sentence.
    const PURPOSE: &'static str;
    /// Width and height that its panels need at least, points: in a smaller window it is scrolled.
    const LEAST_POINTS: Vec2;
    /// Whether it shows or handles recordings: P plays them, and files may be dropped on it.
    const REPLAYS: bool = true;

    /// Shows the screen.
    fn ui(&mut self, ui: &mut Ui, ctx: &mut Ctx<'_>);

    /// Whether it awaits an answer.
    fn busy(&self) -> bool {
        false
    }

    /// Takes answers that have come. Called every frame, whatever screen is shown.
    fn poll(&mut self, _ctx: &mut Ctx<'_>) {}

    /// Takes a snapshot of the live twin. Called for each of them, whatever screen is shown.
    fn observe(&mut self, _snapshot: &Snapshot, _robot: &RobotSpec) {}

    /// Takes the newest state of the live twin and its events since the last frame, whatever screen is shown.
    fn follow(&mut self, _live: &Snapshot, _events: &[Event]) {}

    /// Forgets the twin that was connected before.
    fn reconnect(&mut self) {}

    /// Forgets what was computed of another session or recording.
    fn forget(&mut self) {}

    /// Cancels what Esc cancels here; whether there was anything. `typed`: Esc only left a text field.
    fn cancel(&mut self, _live: &Snapshot, _typed: bool, _commands: &mut Vec<Command>) -> bool {
        false
    }

    /// Adds its actions to the list of commands.
    fn actions(&self, _known: &Known<'_>, _list: &mut List<Self>) {}
}

/// What decides whether an action is possible now.
pub struct Known<'a> {
    /// The live twin.
    pub live: View<'a>,
    /// The recording that is played, else the live twin.
    pub shown: View<'a>,
    /// Whether the plan on hold may be resumed, or why not.
    pub may_resume: &'a Gate,
    /// Whether there is no twin.
    pub twin_gone: bool,
    /// The time window of all plots.
    pub window: &'a TimeWindow,
}

/// `Ok` if `ok` holds, else the reason.
pub fn check(ok: bool, why: &str) -> Gate {
    if ok { Ok(()) } else { Err(why.to_owned()) }
}

/// A change of the state `S` of a screen, or of all screens.
pub type Act<S> = Box<dyn FnOnce(&mut S, &mut Ctx<'_>)>;

/// What an action does.
pub enum Task<S> {
    /// Sends an order to the twin.
    Twin(Command),
    /// Acts on the screen, which is then shown.
    Shown(Act<S>),
    /// Acts on the screen, whatever is shown.
    Behind(Act<S>),
}

/// An action that can be found by typing.
pub struct Action<D> {
    /// The screen it acts on, or what it concerns; empty until it is listed.
    pub group: &'static str,
    /// What it does, in words.
    pub name: String,
    /// Other words it is found by.
    pub words: &'static str,
    /// Its shortcut; may be empty.
    pub keys: &'static str,
    /// Whether it is possible now, or why not.
    pub gate: Gate,
    /// What it does.
    pub task: D,
}

impl<D> Action<D> {
    /// The same action in another form.
    pub fn map<E>(self, form: impl FnOnce(D) -> E) -> Action<E> {
        let Self {
            group,
            name,
            words,
            keys,
            gate,
            task,
        } = self;
        Action {
            group,
            name,
            words,
            keys,
            gate,
            task: form(task),
        }
    }
}

/// The actions of a screen with the state `S`.
pub struct List<S>(pub Vec<Action<Task<S>>>);

impl<S> Default for List<S> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<S> List<S> {
    /// Adds an action.
    pub fn add(&mut self, name: impl Into<String>, words: &'static str, gate: Gate, task: Task<S>) {
        self.0.push(Action {
            group: "",
            name: name.into(),
            words,
            keys: "",
            gate,
            task,
        });
    }

    /// Adds an action on the screen, which is then shown.
    pub fn act(
        &mut self,
        name: impl Into<String>,
        words: &'static str,
        gate: Gate,
        act: impl FnOnce(&mut S, &mut Ctx<'_>) + 'static,
    ) {
        self.add(name, words, gate, Task::Shown(Box::new(act)));
    }

    /// Gives the last action a shortcut.
    pub fn by(&mut self, keys: &'static str) {
        if let Some(last) = self.0.last_mut() {
            last.keys = keys;
        }
    }
}
