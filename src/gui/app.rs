//! The window: drains the twin's feed, shows a screen, sends commands.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::TryRecvError;
use std::time::Duration;

use egui::{Panel, Theme, Ui};
use serde::{Deserialize, Serialize};

use super::history::{History, LIVE_ROWS};
use super::panels::accuracy::{self, AccuracyState};
use super::panels::operate::{self, OperateState, Pane};
use super::panels::player::Player;
use super::panels::plot::TimeWindow;
use super::panels::recordings::{self, Library, RecordingsInput};
use super::panels::sensors::{self, SensorsState};
use super::panels::shell::{self, KeyAction, Message, ShellAction, ShellInput};
use super::panels::{Screen, View};
use super::services::Services;
use super::theme::{self, Level};
use crate::robot::RobotSpec;
use crate::signal::{Snapshot, Stamp};
use crate::twin::{Command, Event, Handle};

/// How long a message stays in the strip, s.
const MESSAGE_S: f64 = 8.0;
/// Messages kept.
const MESSAGES: usize = 200;
/// Key of the kept settings; the number changes when their form does.
const STORAGE_KEY: &str = "springtwin window 1";

/// What is kept from one start to the next.
#[derive(Serialize, Deserialize)]
struct Settings {
    layout: egui_tiles::Tree<Pane>,
    screen: Screen,
    dark: Option<bool>,
    span_s: f64,
}

/// The window of a twin.
pub struct App {
    handle: Option<Handle>,
    twin_gone: bool,
    stop_pending: bool,
    spec: RobotSpec,
    /// What the window asks of the program around it.
    pub services: Services,
    live: Arc<Snapshot>,
    live_history: History,
    messages: VecDeque<Message>,
    recording_since: Option<Stamp>,
    set_up: bool,
    theme: Option<Theme>,
    shortcuts_open: bool,
    /// The screen that is shown.
    pub screen: Screen,
    /// The window of time of all plots.
    pub window: TimeWindow,
    /// Panels, target draft and 3D view of Operate.
    pub operate: OperateState,
    /// Selection on Sensors.
    pub sensors: SensorsState,
    /// Scope on Accuracy.
    pub accuracy: AccuracyState,
    /// The recordings.
    pub library: Library,
    /// The recording that is shown instead of the live twin, if one is.
    pub player: Option<Player>,
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
            spec,
            services,
            live,
            live_history: History::new(LIVE_ROWS),
            messages: VecDeque::new(),
            recording_since: None,
            set_up: false,
            theme: None,
            shortcuts_open: false,
            screen: Screen::default(),
            window: TimeWindow::default(),
            operate: OperateState::default(),
            sensors: SensorsState::default(),
            accuracy: AccuracyState::default(),
            library: Library::default(),
            player: None,
        }
    }

    /// A window without a twin that shows `snapshots` as if they were live, for pictures.
    pub fn for_screenshot(
        screen: Screen,
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
        if let Some(settings) = storage.and_then(|s| eframe::get_value::<Settings>(s, STORAGE_KEY))
        {
            if operate::is_complete(&settings.layout) {
                self.operate.tree = settings.layout;
            }
            self.screen = settings.screen;
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
        self.drain(&ctx, now_s);
        let mut commands = Vec::new();
        self.keys(&ctx, &mut commands);
        if let Some(player) = self.library.poll() {
            self.player = Some(player);
            self.window.frozen_end_s = None;
        }
        if let Some(player) = &mut self.player
            && player.playing
        {
            player.advance(f64::from(ctx.input(|i| i.unstable_dt)).min(0.1));
            ctx.request_repaint();
        }
        if self.library.busy() {
            ctx.request_repaint_after(Duration::from_millis(100));
        }
        self.show(ui, now_s, &mut commands);
        for command in commands {
            self.send(command, now_s);
        }
        if self.stop_pending {
            self.send(Command::Stop, now_s);
            ctx.request_repaint();
        }
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
                    came = true;
                }
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => {
                    self.twin_gone = true;
                    break;
                }
            }
        }
        self.live = handle.snapshot();
        let mut messages = Vec::new();
        while let Ok(event) = handle.events.try_recv() {
            let level = match &event {
                Event::Refused { .. } => Level::Warning,
                _ => Level::Normal,
            };
            messages.push((event.text(), level));
        }
        for (text, level) in messages {
            self.say(text, level, now_s);
        }
        self.recording_since = match &self.live.recording {
            Some(_) => self.recording_since.or(Some(self.live.stamp)),
            None => None,
        };
        // The twin asks for repaints; this one shows that it has fallen silent.
        if came {
            ctx.request_repaint_after(Duration::from_millis(500));
        }
        if let Some(m) = self.messages.back() {
            let left = m.at_s + MESSAGE_S - now_s;
            if left > 0.0 {
                ctx.request_repaint_after(Duration::from_secs_f64(left));
            }
        }
    }

    fn say(&mut self, text: impl Into<String>, level: Level, now_s: f64) {
        if self.messages.len() == MESSAGES {
            self.messages.pop_front();
        }
        self.messages.push_back(Message {
            text: text.into(),
            level,
            at_s: now_s,
        });
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
                KeyAction::Hold => match &mut self.player {
                    Some(player) => player.toggle(),
                    None => {
                        if let (_, Ok(command)) = shell::hold_action(&self.live) {
                            commands.push(command);
                        }
                    }
                },
                KeyAction::Cancel => {
                    if self.shortcuts_open {
                        self.shortcuts_open = false;
                    } else if self.live.preview.is_some() {
                        self.operate.draft.asked_m = None;
                        commands.push(Command::CancelPreview);
                    }
                }
                KeyAction::Show(screen) => self.screen = screen,
                KeyAction::Shortcuts => self.shortcuts_open = !self.shortcuts_open,
            }
        }
    }

    fn show(&mut self, ui: &mut Ui, now_s: f64, commands: &mut Vec<Command>) {
        let palette = *theme::Palette::in_ui(ui);
        let live_snapshot = Arc::clone(&self.live);
        let live = View {
            snapshot: &live_snapshot,
            history: &self.live_history,
            now_s: live_snapshot.stamp.seconds(),
            replay: None,
            spec: &self.spec,
        };
        let title = self.player.as_ref().map(Player::title);
        let message = self.messages.back().filter(|m| now_s - m.at_s < MESSAGE_S);
        let recording_s = self
            .recording_since
            .map(|since| live_snapshot.stamp.since(since));
        let input = ShellInput {
            live,
            replay: title.as_deref(),
            message,
            recording_s,
            twin: self.handle.is_some(),
            twin_gone: self.twin_gone,
        };
        let mut actions = Vec::new();
        let bar =
            |margin: egui::Margin| egui::Frame::new().fill(palette.panel).inner_margin(margin);
        Panel::top("shell")
            .exact_size(56.0)
            .resizable(false)
            .frame(bar(egui::Margin::symmetric(12, 4)))
            .show(ui, |ui| shell::top_bar(ui, &live, commands));
        shell::banners(ui, &input, commands, &mut actions);
        Panel::bottom("strip")
            .exact_size(28.0)
            .resizable(false)
            .frame(bar(egui::Margin::symmetric(12, 2)))
            .show(ui, |ui| shell::strip(ui, &input));
        Panel::left("screens")
            .exact_size(152.0)
            .resizable(false)
            .frame(bar(egui::Margin::symmetric(8, 8)))
            .show(ui, |ui| shell::rail(ui, self.screen, &mut actions));
        let central = egui::CentralPanel::default()
            .frame(egui::Frame::new().fill(palette.window).inner_margin(6))
            .show(ui, |ui| {
                if self.screen == Screen::Recordings {
                    let input = RecordingsInput {
                        live,
                        recording_s,
                        twin_gone: self.twin_gone || self.handle.is_none(),
                    };
                    recordings::ui(
                        ui,
                        &input,
                        &mut self.library,
                        &mut self.player,
                        &mut self.services,
                        commands,
                    );
                    return;
                }
                let shown = match &self.player {
                    Some(player) => View {
                        snapshot: player.snapshot(),
                        history: player.history(),
                        now_s: player.now_s(),
                        replay: title.as_deref(),
                        spec: &self.spec,
                    },
                    None => live,
                };
                match self.screen {
                    Screen::Operate => {
                        self.operate.view3d.selected_spring = self.sensors.selected_spring;
                        operate::ui(ui, &shown, &mut self.operate, &mut self.window, commands);
                        self.sensors.selected_spring = self.operate.view3d.selected_spring;
                    }
                    Screen::Sensors => {
                        sensors::ui(ui, &shown, &mut self.sensors, &mut self.window);
                    }
                    Screen::Accuracy => {
                        accuracy::ui(ui, &shown, &mut self.accuracy, &mut self.window);
                    }
                    Screen::Recordings => {}
                }
            });
        let ctx = ui.ctx().clone();
        shell::shortcuts(&ctx, &mut self.shortcuts_open, central.response.rect);
        for action in actions {
            self.act(&ctx, action);
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
            ShellAction::ResetLayout => self.operate.tree = operate::default_layout(),
            ShellAction::ToggleShortcuts => self.shortcuts_open = !self.shortcuts_open,
            ShellAction::CloseReplay => {
                self.player = None;
                self.window.frozen_end_s = None;
            }
        }
    }
}

impl eframe::App for App {
    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        self.frame(ui);
    }

    fn save(&mut self, storage: &mut dyn eframe::Storage) {
        let settings = Settings {
            layout: self.operate.tree.clone(),
            screen: self.screen,
            dark: self.theme.map(|t| t == Theme::Dark),
            span_s: self.window.span_s,
        };
        eframe::set_value(storage, STORAGE_KEY, &settings);
    }
}
