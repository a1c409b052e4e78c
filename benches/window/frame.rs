//! The window without a screen: what a frame costs the processor, graphics apart.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use springtwin::gui::offscreen::Offscreen;
use springtwin::gui::scene::Scene;
use springtwin::gui::screens::ScreenId;
use springtwin::gui::{App, Services};
use springtwin::link::StopLine;
use springtwin::robot::RobotSpec;
use springtwin::signal::Snapshot;
use springtwin::twin::{Command, Event, Handle, Pictures};

use super::session::Session;

/// Rate of the snapshots, Hz.
pub const HZ: u64 = 1000;

/// An [`App`] that is fed by hand.
pub struct Window {
    /// The window.
    pub app: App,
    context: egui::Context,
    session: Session,
    feed: SyncSender<Arc<Snapshot>>,
    latest: Arc<Mutex<Arc<Snapshot>>>,
    _commands: Receiver<Command>,
    _events: SyncSender<Event>,
    device: Option<Offscreen>,
    next: u64,
    time_s: f64,
}

impl Window {
    /// A window of 1280 x 720 points that has seen `rows` snapshots.
    pub fn new(rows: u64) -> Self {
        Self::drawn_by(Offscreen::new([64, 64], 1.0).ok(), rows)
    }

    /// The same, for [`Window::draw`]: its size is that of the device.
    pub fn drawn_by(device: Option<Offscreen>, rows: u64) -> Self {
        let (command_tx, commands) = sync_channel(64);
        let (events, event_rx) = sync_channel(64);
        let (feed, feed_rx) = sync_channel(1024);
        let session = Session::new();
        let latest = Arc::new(Mutex::new(Arc::new(session.snapshot(0, HZ))));
        let handle = Handle {
            commands: command_tx,
            events: event_rx,
            feed: feed_rx,
            latest: Arc::clone(&latest),
            stop_line: StopLine::default(),
            pictures: Pictures::default(),
        };
        let robot = RobotSpec::reference();
        let mut app = App::new(Some(handle), robot.clone(), Services::none());
        let own = egui::Context::default;
        let context = device.as_ref().map_or_else(own, |d| d.context.clone());
        app.set_up(&context, None);
        app.screens.operate.view3d.scene = device
            .as_ref()
            .map(|d| Scene::new(d.render_state(), &robot));
        let mut window = Self {
            app,
            context,
            session,
            feed,
            latest,
            _commands: commands,
            _events: events,
            device,
            next: 0,
            time_s: 0.0,
        };
        while window.next < rows {
            window.publish(1000);
            window.frame();
        }
        window
    }

    /// Publishes `n` more snapshots as the twin would.
    pub fn publish(&mut self, n: u64) {
        for k in self.next..self.next + n {
            let s = Arc::new(self.session.snapshot(k, HZ));
            if let Ok(mut latest) = self.latest.lock() {
                *latest = Arc::clone(&s);
            }
            assert!(self.feed.try_send(s).is_ok(), "the window drains its feed");
        }
        self.next += n;
    }

    /// One frame: layout, shapes, triangles.
    pub fn frame(&mut self) -> Cost {
        self.time_s += 1.0 / 60.0;
        let size = egui::vec2(1280.0, 720.0);
        let input = egui::RawInput {
            screen_rect: Some(egui::Rect::from_min_size(egui::Pos2::ZERO, size)),
            time: Some(self.time_s),
            ..egui::RawInput::default()
        };
        let app = &mut self.app;
        let start = now();
        let output = self.context.run_ui(input, |ui| app.frame(ui));
        let laid_out = now();
        let shapes = output.shapes.len();
        let meshes = self.context.tessellate(output.shapes, 1.0);
        let end = now();
        let vertices = meshes
            .iter()
            .map(|m| match &m.primitive {
                egui::epaint::Primitive::Mesh(mesh) => mesh.vertices.len(),
                egui::epaint::Primitive::Callback(_) => 0,
            })
            .sum();
        std::hint::black_box(&meshes);
        Cost {
            layout: laid_out - start,
            tessellation: end - laid_out,
            shapes,
            vertices,
        }
    }

    /// One frame that the graphics device draws, or the reason why it does not.
    #[allow(dead_code, reason = "not every bench asks")]
    pub fn draw(&mut self) -> Result<Duration, String> {
        let start = now();
        let device = self.device.as_mut().ok_or("no graphics device")?;
        let app = &mut self.app;
        device
            .frame(|ui| app.frame(ui))
            .map_err(|e| e.to_string())?;
        Ok(now() - start)
    }

    /// Snapshots so far.
    #[allow(dead_code, reason = "not every bench asks")]
    pub fn rows(&self) -> u64 {
        self.next
    }
}

/// What a frame took.
#[derive(Clone, Copy, Debug, Default)]
#[allow(dead_code, reason = "each bench prints some of it")]
pub struct Cost {
    /// Draining, layout and shapes.
    pub layout: Duration,
    /// Shapes to triangles.
    pub tessellation: Duration,
    /// Shapes.
    pub shapes: usize,
    /// Vertices.
    pub vertices: usize,
}

impl Cost {
    /// Both parts.
    #[allow(dead_code, reason = "not every bench asks")]
    pub fn total(&self) -> Duration {
        self.layout + self.tessellation
    }
}

/// All screens with their names.
pub fn screens() -> impl Iterator<Item = (ScreenId, &'static str)> {
    ScreenId::ALL.into_iter().map(|s| (s, s.name()))
}

#[expect(clippy::disallowed_methods, reason = "a bench measures time")]
pub fn now() -> Instant {
    Instant::now()
}
