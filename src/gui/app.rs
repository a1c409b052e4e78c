//! The window: drains the twin's feed, shows a screen, sends commands.

mod device;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::Duration;

use egui::{Panel, Theme, Ui};
use serde::{Deserialize, Serialize};

use super::pace::Pace;
use super::panels::connect::{self, Connection};
use super::panels::operate::Pane;
use super::panels::operating::{hold_gate, severity_level};
use super::panels::palette::{self, Choice, CommandPalette};
use super::panels::plot::{Chosen, TimeWindow};
use super::panels::rec::Rec;
use super::panels::recordings;
use super::panels::shell::{self, KeyAction, Resume, ShellAction, ShellInput, Vent};
use super::panels::toasts::{self, Messages};
use super::panels::view3d::Shown;
use super::screen::{Ctx, Known, Task};
use super::screens::{ScreenId, Screens};
use super::services::{Connected, Services};
use super::theme::{self, Level};
use super::view::{View, live_until_s};
use crate::analysis::history::History;
use crate::analysis::player::{Near, Player};
use crate::robot::{RobotSpec, SupplyOff};
use crate::signal::{Mode, Severity, Snapshot, Stamp, Trace};
use crate::twin::{Command, Event, Handle};

/// Key of the kept settings; the number changes when their form does.
const STORAGE_KEY: &str = "springtwin window 1";

/// What is kept from one start to the next.
#[derive(Serialize, Deserialize)]
struct Settings {
    /// The panels as the operator arranged them; `None` while they follow the window's width.
    #[serde(default)]
    arranged: Option<egui_tiles::Tree<Pane>>,
    screen: ScreenId,
    dark: Option<bool>,
    span_s: f64,
    #[serde(default)]
    welcomed: bool,
    #[serde(default)]
    view: Shown,
    #[serde(default)]
    recordings: Option<PathBuf>,
    /// Names of the actions that were done last, the newest first.
    #[serde(default)]
    recent: Vec<String>,
    /// Signals that are plotted by name.
    #[serde(default)]
    signals: Chosen,
}

/// How often progress is shown: where pictures are made in software, more would take the work's own time.
const PROGRESS_LOOK: Duration = Duration::from_millis(500);
/// Snapshots come every 10 ms: an armed arm whose control loop has not reported for so long is shown as silent, s.
const SILENT_S: f64 = 0.35;
/// How often a window on an arm that moves looks for it by itself. Where it rests, whoever starts the twin looks, and what rests is
/// painted seldom.
const SILENT_LOOK: Duration = Duration::from_millis(100);

/// Whether the arm follows commands.
fn is_armed(snapshot: &Snapshot) -> bool {
    matches!(snapshot.mode, Mode::Hold | Mode::Moving | Mode::AtGoal)
}

/// Whether the control loop drives the boards' pumps.
fn drives(snapshot: &Snapshot) -> bool {
    is_armed(snapshot) || snapshot.link.venting
}

/// The window of a twin.
pub struct App {
    handle: Option<Handle>,
    twin_gone: bool,
    stop_pending: bool,
    /// Whether text was typed in the last frame.
    typed: bool,
    spec: RobotSpec,
    /// What the window asks of the program around it.
    pub services: Services,
    live: Arc<Snapshot>,
    live_history: History,
    messages: Messages,
    recording_since: Option<Stamp>,
    set_up: bool,
    /// How often the window wants to be painted.
    pub pace: Pace,
    theme: Option<Theme>,
    shortcuts_open: bool,
    command_palette: CommandPalette,
    resume: Resume,
    vent: Vent,
    /// The operator is asked whether the window may close although the arm is armed.
    asks_to_close: bool,
    /// Closes the window once it is set, without a question: the program was asked to end.
    pub ends: Arc<AtomicBool>,
    /// Warnings of the program that are not events of its twin.
    pub warnings: Option<Receiver<(Severity, String)>>,
    /// Window time of the newest snapshot, s.
    heard_at_s: f64,
    /// What the twin could be connected to.
    pub connection: Connection,
    /// Whether a newcomer is greeted.
    pub welcome: bool,
    /// The screen that is shown.
    pub screen: ScreenId,
    /// The window of time of all plots.
    pub window: TimeWindow,
    /// The spring (0-based) that is highlighted in plots and in 3D.
    pub selected_spring: Option<usize>,
    /// What the screens keep.
    pub screens: Screens,
    /// The recording that is shown instead of the live twin, if one is.
    pub player: Option<Player>,
    looked: Option<Looked>,
    twins: u64,
}

/// Whose time base the window shows.
enum Looked {
    /// The live session: which twin, which of its sessions.
    Live(u64, u64),
    /// A recording.
    Trace(Arc<Trace>),
}

impl Looked {
    fn is(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Live(twin, session), Self::Live(other_twin, other_session)) => {
                twin == other_twin && session == other_session
            }
            (Self::Trace(a), Self::Trace(b)) => Arc::ptr_eq(a, b),
            _ => false,
        }
    }
}

/// Shows a screen in at least the size that it needs, points; a smaller window scrolls it.
fn roomy(ui: &mut Ui, least: egui::Vec2, screen: impl FnOnce(&mut Ui)) {
    let room = ui.available_size();
    if room.x >= least.x && room.y >= least.y {
        return screen(ui);
    }
    egui::ScrollArea::both().show(ui, |ui| {
        ui.set_min_size(room.max(least));
        ui.set_max_size(room.max(least));
        screen(ui);
    });
}

/// The live twin, as screens see it.
fn live_view<'a>(snapshot: &'a Snapshot, history: &'a History, spec: &'a RobotSpec) -> View<'a> {
    View {
        snapshot,
        history,
        near: None,
        now_s: live_until_s(snapshot),
        replay: None,
        spec,
        simulated: Some(snapshot.link.simulated),
    }
}

/// The recording that is played, at its playhead.
struct Played {
    trace: Arc<Trace>,
    history: Arc<History>,
    near: Option<Arc<Near>>,
    newest: usize,
    now_s: f64,
    title: String,
}

impl Played {
    fn of(player: &Player) -> Self {
        let (trace, newest) = player.newest();
        Self {
            trace: Arc::clone(trace),
            history: Arc::clone(player.shared_history()),
            near: player.near().cloned(),
            newest,
            now_s: player.now_s(),
            title: player.title(),
        }
    }

    fn view<'a>(&'a self, spec: &'a RobotSpec) -> View<'a> {
        View {
            snapshot: &self.trace.snapshots[self.newest],
            history: &self.history,
            near: self.near.as_deref(),
            now_s: self.now_s,
            replay: Some(&self.title),
            spec,
            simulated: self.trace.simulated,
        }
    }
}

impl App {
    /// A window onto a twin; without a handle it only shows recordings.
    pub fn new(handle: Option<Handle>, spec: RobotSpec, services: Services) -> Self {
        let live = handle
            .as_ref()
            .map_or_else(Default::default, Handle::snapshot);
        Self {
            twin_gone: false,
            handle,
            stop_pending: false,
            typed: false,
            spec,
            services,
            live,
            live_history: History::live(),
            messages: Messages::default(),
            recording_since: None,
            set_up: false,
            pace: Pace::default(),
            theme: None,
            shortcuts_open: false,
            command_palette: CommandPalette::default(),
            resume: Resume::default(),
            vent: Vent::default(),
            asks_to_close: false,
            ends: Arc::default(),
            warnings: None,
            heard_at_s: 0.0,
            connection: Connection::default(),
            welcome: false,
            screen: ScreenId::default(),
            window: TimeWindow::default(),
            selected_spring: None,
            screens: Screens::default(),
            player: None,
            looked: None,
            twins: 0,
        }
    }

    /// A window without a twin that shows `snapshots` as if they were live, for pictures.
    pub fn for_screenshot(
        screen: ScreenId,
        theme: Theme,
        spec: RobotSpec,
        snapshots: &[Snapshot],
    ) -> Self {
        let mut app = Self::new(None, spec, Services::none());
        app.screen = screen;
        app.theme = Some(theme);
        for s in snapshots {
            app.live_history.push(s);
        }
        if let Some(last) = snapshots.last() {
            app.live = Arc::new(last.clone());
        }
        app
    }

    /// Styles the context and takes back what was kept. Call before the first frame.
    pub fn set_up(&mut self, ctx: &egui::Context, storage: Option<&dyn eframe::Storage>) {
        theme::install(ctx);
        let kept = storage.and_then(|s| eframe::get_value::<Settings>(s, STORAGE_KEY));
        self.welcome |= storage.is_some() && !kept.as_ref().is_some_and(|k| k.welcomed);
        if let Some(settings) = kept {
            if let Some(tree) = settings.arranged {
                self.screens.operate.take_layout(tree);
            }
            self.screen = settings.screen;
            self.screens.operate.view3d.shown = settings.view;
            self.services.recordings.chosen = settings.recordings;
            self.screens.operate.strips.chosen = settings.signals;
            self.command_palette.take_recent(settings.recent);
            self.theme = settings
                .dark
                .map(|dark| if dark { Theme::Dark } else { Theme::Light });
            if settings.span_s.is_finite() {
                self.window.span_s = settings.span_s.clamp(1.0, 600.0);
            }
        }
        if let Some(theme) = self.theme {
            ctx.set_theme(theme);
        }
        self.set_up = true;
    }

    /// Whether something is awaited that was asked of the program around the window.
    pub fn busy(&self) -> bool {
        self.connection.busy() || self.screens.busy()
    }

    /// One frame: everything the window shows, into `ui` (the whole window).
    pub fn frame(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        if !self.set_up {
            self.set_up(&ctx, None);
            // Style and fonts hold from the next pass on.
            ctx.request_repaint();
            return;
        }
        let now_s = ctx.input(|i| i.time);
        if let Some(handle) = &self.handle {
            handle.pictures.count();
        }
        self.drain(&ctx, now_s);
        for (severity, text) in self.warnings.iter().flat_map(Receiver::try_iter) {
            self.messages.say(text, severity_level(severity), now_s);
        }
        self.ask_to_close(&ctx);
        let mut commands = Vec::new();
        self.keys(&ctx, &mut commands);
        if self.screen.replays() && self.screens.library.take_drops(&ctx, &mut self.services) {
            self.screen = ScreenId::Recordings;
        }
        self.with(now_s, &mut commands, |screens, ctx| screens.poll(ctx));
        if let Some(player) = &mut self.player
            && player.playing
        {
            player.advance(f64::from(ctx.input(|i| i.unstable_dt)).min(0.1));
            ctx.request_repaint();
        }
        match self.connection.poll() {
            Some((_, Ok(connected))) => self.adopt(connected, now_s),
            Some((_, Err(e))) => self.say(e, Level::Critical, now_s),
            None => {}
        }
        if self.busy() {
            // Whoever answers asks for a picture; between the two only the progress moves.
            ctx.request_repaint_after(PROGRESS_LOOK);
        }
        self.forget_what_was_shown();
        self.show(ui, now_s, &mut commands);
        self.typed = ctx.text_edit_focused();
        if commands.contains(&Command::Hold) {
            self.resume.held(now_s);
        }
        for command in commands {
            self.send(command, now_s);
        }
        if self.stop_pending {
            self.send(Command::Stop, now_s);
            ctx.request_repaint();
        }
    }

    /// Calls `act` on the screens, with what they see and may change.
    fn with<R>(
        &mut self,
        now_s: f64,
        commands: &mut Vec<Command>,
        act: impl FnOnce(&mut Screens, &mut Ctx<'_>) -> R,
    ) -> R {
        let snapshot = Arc::clone(&self.live);
        let live = live_view(&snapshot, &self.live_history, &self.spec);
        let played = self.player.as_ref().map(Played::of);
        let mut ctx = Ctx {
            live,
            shown: played.as_ref().map_or(live, |p| p.view(&self.spec)),
            twin_gone: self.twin_gone || self.handle.is_none(),
            window: &mut self.window,
            selected_spring: &mut self.selected_spring,
            player: &mut self.player,
            services: &mut self.services,
            commands,
            messages: Vec::new(),
        };
        let answer = act(&mut self.screens, &mut ctx);
        for (text, level) in ctx.messages {
            self.messages.say(text, level, now_s);
        }
        answer
    }

    // Instants and scores of one session mean nothing in another: a frozen window, cursors and peaks go when
    // another recording or another live session is shown.
    fn forget_what_was_shown(&mut self) {
        let now = match &self.player {
            Some(player) => Looked::Trace(Arc::clone(player.shared_trace())),
            None => Looked::Live(self.twins, self.live_history.sessions()),
        };
        if self.looked.as_ref().is_some_and(|before| !before.is(&now)) {
            self.window.frozen_end_s = None;
            self.window.cursors_s = None;
            self.screens.forget();
        }
        self.looked = Some(now);
    }

    // Looks at another twin from now on.
    fn adopt(&mut self, connected: Connected, now_s: f64) {
        let Connected { handle, belongings } = connected;
        match belongings {
            Ok((calibration, registration)) => {
                self.services.calibration = calibration;
                self.screens.accuracy.registration = registration;
            }
            Err(e) => self.say(e, Level::Warning, now_s),
        }
        self.screens.reconnect();
        self.live = handle.snapshot();
        self.handle = Some(handle);
        self.twin_gone = false;
        self.stop_pending = false;
        self.live_history = History::live();
        self.twins += 1;
        self.recording_since = None;
    }

    fn connect(&mut self, name: &str) {
        self.leave_twin();
        self.connection.join(name, &mut self.services);
    }

    // Its thread ends, and stops the boards as it does.
    fn leave_twin(&mut self) {
        self.handle = None;
        // A twin that was let go has no state any more.
        self.live = Arc::default();
        self.twin_gone = false;
        self.stop_pending = false;
    }

    // Takes what the twin has published since the last frame.
    fn drain(&mut self, ctx: &egui::Context, now_s: f64) {
        let Some(handle) = &self.handle else {
            return;
        };
        let mut came = false;
        loop {
            match handle.feed.try_recv() {
                Ok(snapshot) => {
                    self.live_history.push(&snapshot);
                    self.screens.observe(&snapshot, &self.spec);
                    came = true;
                }
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => {
                    self.twin_gone = true;
                    break;
                }
            }
        }
        let before = std::mem::replace(&mut self.live, handle.snapshot());
        if self.live.mode == Mode::Hold && before.mode != Mode::Hold {
            self.resume.held(now_s);
        }
        if self.twin_gone {
            let mut last = Snapshot::clone(&self.live);
            last.link.connected = false;
            last.mode = Mode::Disarmed;
            (last.goal, last.preview, last.recording) = (None, None, None);
            (last.tried, last.kept_patch) = (None, None);
            self.live = Arc::new(last);
        }
        let hidden = ctx.input(|i| i.viewport().minimized == Some(true));
        self.pace.update(&self.live, now_s, hidden);
        let events: Vec<Event> = handle.events.try_iter().collect();
        for event in &events {
            let level = severity_level(event.severity());
            // The banner and the badge show the mode: in the list it is enough.
            match event {
                Event::Mode { .. } => self.messages.list(event.text(), level, now_s),
                _ => self.messages.say(event.text(), level, now_s),
            }
        }
        self.screens.follow(&self.live, &events);
        self.recording_since = match &self.live.recording {
            Some(_) => self.recording_since.or(Some(self.live.stamp)),
            None => None,
        };
        // The twin asks for repaints; this one shows that it has fallen silent.
        if came {
            self.heard_at_s = now_s;
            ctx.request_repaint_after(self.pace.patience());
        }
        if self.live.mode == Mode::Moving || self.live.link.venting {
            ctx.request_repaint_after(SILENT_LOOK);
        }
    }

    /// For how long the control loop of an armed arm has not reported, s, if that is too long.
    fn silent_s(&self, now_s: f64) -> Option<f64> {
        let silent_s = now_s - self.heard_at_s;
        let is_silent = drives(&self.live) && !self.twin_gone && self.handle.is_some();
        (is_silent && silent_s > SILENT_S).then_some(silent_s)
    }

    /// Keeps a window on an armed hardware arm open until the operator has agreed to close it, and closes one whose
    /// program was asked to end, also where nothing of it is painted: minimised or hidden. Call before each frame, and instead of one that is not painted.
    pub fn logic(&mut self, ctx: &egui::Context) {
        if self.ends.load(Ordering::Relaxed) {
            self.asks_to_close = false;
            // The pumps are off before anything is stored or torn down.
            self.leave_twin();
            ctx.send_viewport_cmd(egui::ViewportCommand::Close);
            return;
        }
        let wanted = ctx.input(|i| i.viewport().close_requested());
        let Some(handle) = self.handle.as_ref().filter(|_| wanted) else {
            return;
        };
        let now = handle.snapshot();
        if is_armed(&now) && now.link.moves_hardware() && !self.twin_gone {
            use egui::ViewportCommand::{CancelClose, Focus, Minimized};
            for command in [CancelClose, Minimized(false), Focus] {
                ctx.send_viewport_cmd(command);
            }
            self.asks_to_close = true;
        }
    }

    /// Loads a recording and shows it.
    pub fn open_recording(&mut self, path: std::path::PathBuf) {
        self.screen = ScreenId::Recordings;
        self.screens.library.play(path, &mut self.services);
    }

    /// Asks whether a window on an armed hardware arm shall close.
    fn ask_to_close(&mut self, ctx: &egui::Context) {
        if !self.asks_to_close {
            return;
        }
        // No modal: STOP and HOLD stay within reach.
        egui::Window::new("The arm is armed")
            .collapsible(false)
            .resizable(false)
            .anchor(egui::Align2::CENTER_CENTER, [0.0, 0.0])
            .show(ctx, |ui| {
                ui.set_width(380.0);
                ui.label(match self.spec.supply_off {
                    SupplyOff::Keeps => {
                        "Closing the window switches the pumps off. By the robot file (supply_off) the chambers keep their \
                         air: the arm should stay as it is."
                    }
                    SupplyOff::Vents => {
                        "Closing the window switches the pumps off. By the robot file (supply_off) the chambers lose their \
                         air: the arm sags, with its load."
                    }
                });
                ui.add_space(8.0);
                ui.horizontal(|ui| {
                    if ui.button("Stay").clicked() {
                        self.asks_to_close = false;
                    }
                    if ui.button("Switch the pumps off and close").clicked() {
                        self.asks_to_close = false;
                        // The pumps are off before anything is stored or torn down.
                        self.leave_twin();
                        ctx.send_viewport_cmd(egui::ViewportCommand::Close);
                    }
                });
            });
    }

    fn say(&mut self, text: impl Into<String>, level: Level, now_s: f64) {
        self.messages.say(text, level, now_s);
    }

    // A stop that does not get through is tried again each frame.
    fn send(&mut self, command: Command, now_s: f64) {
        let is_stop = command == Command::Stop;
        let sent = match &self.handle {
            Some(handle) => handle.send(command),
            None => Err("No twin is running: the command went nowhere."),
        };
        if is_stop {
            self.stop_pending = sent.is_err() && self.handle.is_some() && !self.twin_gone;
        }
        if let Err(reason) = sent {
            self.say(reason, Level::Critical, now_s);
        }
    }

    fn keys(&mut self, ctx: &egui::Context, commands: &mut Vec<Command>) {
        for action in shell::keys(ctx) {
            match action {
                KeyAction::Stop => commands.push(Command::Stop),
                // The arm, whatever is shown.
                KeyAction::Hold if hold_gate(&self.live).is_ok() => {
                    commands.push(Command::Hold);
                }
                KeyAction::Hold => {}
                KeyAction::Replay(by) if self.screen.replays() => {
                    if let Some(player) = &mut self.player {
                        player.drive(by);
                    }
                }
                KeyAction::Replay(_) => {}
                KeyAction::Keep => {
                    recordings::keep(&mut self.screens.library, &self.live, &mut self.services);
                }
                KeyAction::Mark => {
                    let live = live_view(&self.live, &self.live_history, &self.spec);
                    let gone = self.twin_gone || self.handle.is_none();
                    if recordings::mark_gate(&live, gone).is_ok() {
                        recordings::mark_now(&mut self.screens.library, &self.live, commands);
                    }
                }
                KeyAction::Cancel => {
                    if self.shortcuts_open {
                        self.shortcuts_open = false;
                    } else if self.command_palette.open {
                        self.command_palette.toggle();
                    } else {
                        self.screens.cancel(&self.live, self.typed, commands);
                    }
                }
                KeyAction::Show(screen) => self.screen = screen,
                KeyAction::Shortcuts => self.shortcuts_open = !self.shortcuts_open,
                KeyAction::Palette => self.command_palette.toggle(),
            }
        }
    }

    fn show(&mut self, ui: &mut Ui, now_s: f64, commands: &mut Vec<Command>) {
        let palette = *theme::Palette::in_ui(ui);
        self.messages.pin_safe(&self.live.mode, now_s);
        let live_snapshot = Arc::clone(&self.live);
        let live = live_view(&live_snapshot, &self.live_history, &self.spec);
        let title = self.player.as_ref().map(recordings::played_title);
        let recording_s = self
            .recording_since
            .map(|since| live_snapshot.stamp.since(since));
        let input = ShellInput {
            live,
            replay: title.as_deref(),
            messages: &self.messages,
            window_s: now_s,
            joining: self.connection.joining(),
            twin: self.handle.is_some(),
            twin_gone: self.twin_gone,
            silent_s: self.silent_s(now_s),
            welcome: self.welcome,
        };
        let mut actions = Vec::new();
        let bar =
            |margin: egui::Margin| egui::Frame::new().fill(palette.panel).inner_margin(margin);
        let pressed = Panel::top("shell")
            .exact_size(56.0)
            .resizable(false)
            .frame(bar(egui::Margin::symmetric(12, 4)))
            .show(ui, |ui| {
                let controls = (&mut self.resume, &mut self.vent);
                let mut rec = Rec {
                    library: &mut self.screens.library,
                    services: &mut self.services,
                    recording_s,
                    twin_gone: self.twin_gone || self.handle.is_none(),
                };
                shell::top_bar(ui, &live, controls, &mut rec, commands)
            })
            .inner;
        if pressed.twin {
            self.screens
                .gap
                .explain_live(&live_snapshot, &mut self.selected_spring);
            actions.push(ShellAction::Show(ScreenId::Gap));
        }
        // As high with and without something to say: nothing below it moves.
        Panel::top("banners")
            .exact_size(shell::LINE)
            .resizable(false)
            .frame(bar(egui::Margin::ZERO))
            .show(ui, |ui| shell::banners(ui, &input, commands, &mut actions));
        Panel::bottom("strip")
            .exact_size(28.0)
            .resizable(false)
            .frame(bar(egui::Margin::symmetric(12, 2)))
            .show(ui, |ui| shell::strip(ui, &input));
        let rail = shell::RAIL[usize::from(ui.ctx().content_rect().width() < shell::NARROW)];
        Panel::left("screens")
            .exact_size(rail)
            .resizable(false)
            .frame(bar(egui::Margin::symmetric(8, 8)))
            .show(ui, |ui| shell::rail(ui, self.screen, &mut actions));
        let central = egui::CentralPanel::default()
            .frame(egui::Frame::new().fill(palette.window).inner_margin(6))
            .show(ui, |ui| {
                let screen = self.screen;
                roomy(ui, screen.least_points(), |ui| {
                    self.with(now_s, commands, |screens, ctx| screens.ui(screen, ui, ctx));
                });
            });
        let ctx = ui.ctx().clone();
        let within = central.response.rect;
        shell::shortcuts(&ctx, &mut self.shortcuts_open, within);
        let live = live_view(&live_snapshot, &self.live_history, &self.spec);
        let mut chosen = None;
        if self.command_palette.open {
            let may_resume = self.resume.gate(&live, now_s);
            let played = self.player.as_ref().map(Played::of);
            let known = Known {
                live,
                shown: played.as_ref().map_or(live, |p| p.view(&self.spec)),
                may_resume: &may_resume,
                twin_gone: self.twin_gone || self.handle.is_none(),
                window: &self.window,
            };
            let typed = self.command_palette.typed();
            let all = palette::entries(&known, &self.connection, &self.screens, typed);
            let here = self.screen.name();
            match self.command_palette.ui(&ctx, within, here, all) {
                Some(Choice::Window(action)) => actions.push(action),
                Some(Choice::Twin(command)) => commands.push(command),
                Some(Choice::Screen(id, task)) => chosen = Some((id, task)),
                None => {}
            }
        }
        let wanted = connect::menu(
            ui,
            &pressed.connection,
            &live,
            &mut self.connection,
            &mut self.services,
        );
        self.messages.toasts(&ctx, now_s, within);
        for action in actions {
            self.act(&ctx, action);
        }
        match chosen {
            Some((id, Task::Shown(act))) => {
                self.screen = id;
                self.with(now_s, commands, act);
            }
            Some((_, Task::Behind(act))) => self.with(now_s, commands, act),
            Some((_, Task::Twin(command))) => commands.push(command),
            None => {}
        }
        if let Some(name) = wanted {
            self.connect(&name);
        }
        if let Some([before, after]) = self.screens.library.renamed.take() {
            let gap = &mut self.screens.gap;
            gap.renamed(&before, &after, &mut self.services);
        }
        if let Some((part, path)) = self.screens.library.for_gap.take() {
            self.screens.gap.use_as(part, &path, &mut self.services);
            self.screen = ScreenId::Gap;
        }
    }

    fn act(&mut self, ctx: &egui::Context, action: ShellAction) {
        match action {
            ShellAction::Show(screen) => self.screen = screen,
            ShellAction::ToggleTheme => {
                let theme = match ctx.theme() {
                    Theme::Dark => Theme::Light,
                    Theme::Light => Theme::Dark,
                };
                self.theme = Some(theme);
                ctx.set_theme(theme);
            }
            ShellAction::ResetLayout => self.screens.operate.reset_layout(),
            ShellAction::ToggleShortcuts => self.shortcuts_open = !self.shortcuts_open,
            ShellAction::TogglePalette => self.command_palette.toggle(),
            ShellAction::CloseWelcome => self.welcome = false,
            ShellAction::ShowWelcome => self.welcome = true,
            ShellAction::ShowMessages => egui::Popup::open_id(ctx, toasts::list_id()),
            ShellAction::ShowAlarms => egui::Popup::open_id(ctx, shell::alarms_id()),
            ShellAction::CancelConnecting => self.connection.cancel(),
            ShellAction::Connect(rig) => self.connect(rig),
            ShellAction::ChoosePort => self.connection.wanted = true,
            ShellAction::ToggleFreeze => {
                self.window.frozen_end_s = match (self.window.frozen_end_s, &self.player) {
                    (Some(_), _) => None,
                    (None, Some(player)) => Some(player.now_s()),
                    (None, None) => Some(self.live.stamp.seconds()),
                };
            }
            ShellAction::CloseReplay => {
                self.player = None;
            }
        }
    }
}

impl eframe::App for App {
    fn logic(&mut self, ctx: &egui::Context, _frame: &mut eframe::Frame) {
        App::logic(self, ctx);
    }

    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        self.frame(ui);
    }

    fn save(&mut self, storage: &mut dyn eframe::Storage) {
        let settings = Settings {
            arranged: match self.screens.operate.form {
                Some(_) => None,
                None => Some(self.screens.operate.tree.clone()),
            },
            screen: self.screen,
            dark: self.theme.map(|t| t == Theme::Dark),
            span_s: self.window.span_s,
            welcomed: !self.welcome,
            view: self.screens.operate.view3d.shown,
            recordings: self.services.recordings.chosen.clone(),
            recent: self.command_palette.recent(),
            signals: self.screens.operate.strips.chosen.clone(),
        };
        eframe::set_value(storage, STORAGE_KEY, &settings);
    }
}
