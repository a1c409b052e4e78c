//! The twin with its surroundings: a port, a recorder, and the thread that ticks.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::mesh::mesh_worker;
use super::newest::Newest;
use super::record::Recording;
use super::stream::{LAST_WORDS, OldStream, Told};
use super::{Command, Event, Handle, MeshAnswer, MeshQuestion, Twin};
use crate::recording::{ArmDrawing, LiveStream, RecordingMeta};
use crate::robot::RobotSpec;
use crate::signal::{GroundTruth, LinkStatus, PressureCommand, RawFrame, Snapshot, Stamp};

/// The twin's period, s.
pub const TICK_S: f64 = 0.01;
/// Frames after which the orientation filters have settled.
pub const SETTLING_FRAMES: u64 = 100;
/// Snapshots that wait for the window at most: two seconds' worth.
const FEED: usize = 200;

/// What arrived since the last poll.
#[derive(Default)]
pub struct Arrivals {
    /// Frames, oldest first.
    pub frames: Vec<RawFrame>,
    /// Motion capture, oldest first.
    pub truths: Vec<GroundTruth>,
    /// State of the link.
    pub status: LinkStatus,
    /// Things worth telling, one sentence each.
    pub notices: Vec<String>,
}

/// The boards, however they are reached: over a serial port, or in this process on simulated time.
pub trait Port: Send {
    /// What arrived up to `now`.
    fn poll(&mut self, now: Stamp) -> Arrivals;
    /// Sends a command. `None` sends no pressures.
    fn send(&mut self, now: Stamp, command: Option<&PressureCommand>);
    /// Tells the boards to switch their pumps off and latch.
    fn estop(&mut self, now: Stamp);
    /// Lets the boards leave their latched state.
    fn reset(&mut self, now: Stamp);
}

/// A twin, its port and its recorder.
pub struct Runner {
    /// The twin.
    pub twin: Twin,
    port: Box<dyn Port>,
    robot: RobotSpec,
    pub(super) recording: Option<Recording>,
    pub(super) stream: Option<LiveStream>,
    pub(super) old_streams: Vec<OldStream>,
    pub(super) streaming_told: Told,
    /// Started when the mesh is shown for the first time.
    pub(super) mesh: Option<Newest<MeshQuestion, MeshAnswer>>,
    was_safe: bool,
}

impl Runner {
    /// Puts a twin on a port.
    pub fn new(twin: Twin, port: Box<dyn Port>, robot: &RobotSpec) -> Self {
        Self {
            twin,
            port,
            robot: robot.clone(),
            recording: None,
            stream: None,
            old_streams: Vec::new(),
            streaming_told: Told::default(),
            mesh: None,
            was_safe: false,
        }
    }

    /// One tick: port, twin, port, recorder. Every frame that waited is processed; commands go
    /// with the last one.
    pub fn tick(&mut self, now: Stamp, commands: &[Command]) -> (Arc<Snapshot>, Vec<Event>) {
        let arrivals = self.port.poll(now);
        let mut events: Vec<Event> = arrivals
            .notices
            .into_iter()
            .map(|text| Event::Notice { stamp: now, text })
            .collect();
        for truth in arrivals.truths {
            self.twin.observe_truth(truth);
        }
        let simulated = arrivals.status.simulated;
        self.twin.observe_link(arrivals.status);
        // Only the newest frame is answered; older ones that piled up still move the filters.
        let mut frames = arrivals.frames;
        let newest = frames.pop();
        for older in frames {
            self.twin.absorb(older);
        }
        let (command, twin_events) = self.twin.tick(now, newest, commands);
        events.extend(twin_events);
        match (self.was_safe, self.twin.is_safe()) {
            // The link repeats the stop by itself until it is reset.
            (false, true) => self.port.estop(now),
            (true, true) => {}
            (true, false) => self.port.reset(now),
            (false, false) => self.port.send(now, command.as_ref()),
        }
        self.was_safe = self.twin.is_safe();
        for command in commands {
            match command {
                Command::StartRecording(path) => {
                    self.start_recording(now, path, simulated, &mut events)
                }
                Command::StopRecording => self.close_recording(),
                Command::StreamLive(address) => {
                    self.start_stream(now, *address, simulated, &mut events);
                }
                Command::StopStream => self.close_stream(now),
                _ => {}
            }
        }
        self.watch_recording(now, &mut events);
        self.watch_stream(now, &mut events);
        for event in &events {
            let level = match event {
                Event::Warning { .. } | Event::RecordingFailed { .. } => log::Level::Warn,
                _ => log::Level::Info,
            };
            log::log!(level, "{:9.3} s  {}", now.seconds(), event.text());
        }
        self.exchange_mesh();
        let snapshot = Arc::new(self.twin.snapshot());
        if let Some(recording) = &self.recording {
            recording.push(now, &snapshot, &events);
        }
        if let Some(stream) = &self.stream {
            stream.push(Arc::clone(&snapshot));
            for event in &events {
                stream.event(now, event.text());
            }
        }
        (snapshot, events)
    }

    /// Hands the mesh's thread its next question and fetches what it has found; waits for nothing.
    fn exchange_mesh(&mut self) {
        if let Some(question) = self.twin.mesh_question() {
            if self.mesh.is_none() {
                match mesh_worker(&self.robot) {
                    Ok(worker) => self.mesh = Some(worker),
                    Err(e) => {
                        let reason = format!("a thread for the mesh cannot be started ({e})");
                        self.twin.observe_mesh(Err(reason));
                    }
                }
            }
            if let Some(worker) = &self.mesh {
                worker.ask(question);
            }
        }
        if let Some(answer) = self.mesh.as_ref().and_then(Newest::answer) {
            self.twin.observe_mesh(answer);
        }
    }

    /// What a recording tells of the session as a whole.
    pub(super) fn session(&self, name: String, simulated: bool) -> RecordingMeta {
        let now_known = self.twin.snapshot();
        RecordingMeta {
            name,
            robot: self.robot.name.clone(),
            robot_hash: self.robot.hash.clone(),
            source: now_known.link.source,
            simulated: Some(simulated),
            payload_kg: now_known.payload_kg,
            drawing: Some(drawing(&self.robot)),
        }
    }

    /// Ends what is under way: lets the port go first, so that another twin can have it, then ends stream
    /// and recording. Waits for the disk.
    fn end(&mut self, now: Stamp) {
        self.port = Box::new(NoPort);
        let mut last = Vec::new();
        self.close_recording();
        self.stop_stream(now, LAST_WORDS, &mut last);
        self.stop_recording(now, &mut last);
        for event in &last {
            log::info!("{:9.3} s  {}", now.seconds(), event.text());
        }
    }
}

/// What stands for a port that was let go.
struct NoPort;

impl Port for NoPort {
    fn poll(&mut self, _now: Stamp) -> Arrivals {
        Arrivals::default()
    }
    fn send(&mut self, _now: Stamp, _command: Option<&PressureCommand>) {}
    fn estop(&mut self, _now: Stamp) {}
    fn reset(&mut self, _now: Stamp) {}
}

/// What a viewer draws around the arm's centre lines.
fn drawing(robot: &RobotSpec) -> ArmDrawing {
    ArmDrawing {
        bellows_m: robot.bellows_m.map(Into::into),
        bellows_radius_m: 0.5 * robot.bellows_outer_diameter_m,
        pad_radius_m: robot.bellows_m[0].norm() + 0.5 * robot.bellows_outer_diameter_m,
        pad_thickness_m: robot.pad_thickness_m,
    }
}

/// How well a loop kept its period.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pace {
    /// Ticks run.
    pub ticks: u64,
    /// Ticks that began more than one period late and were skipped.
    pub missed: u64,
}

/// Ticks in real time until `each` says stop. `each` sees every snapshot with its events and may
/// add commands for the next tick.
pub fn run_in_real_time(
    runner: &mut Runner,
    start: Instant,
    mut each: impl FnMut(&Arc<Snapshot>, &[Event], &mut Vec<Command>) -> std::ops::ControlFlow<()>,
) -> Pace {
    let period = Duration::from_secs_f64(TICK_S);
    let mut pace = Pace::default();
    let mut due = start.elapsed();
    let mut commands = Vec::new();
    loop {
        let elapsed = start.elapsed();
        if elapsed < due {
            std::thread::sleep(due - elapsed);
        }
        let late = start.elapsed().saturating_sub(due);
        let skipped = (late.as_secs_f64() / TICK_S) as u32;
        pace.missed += u64::from(skipped);
        if skipped > 0 {
            log::debug!("{skipped} ticks missed");
        }
        due += period * skipped;
        let now = Stamp::from_seconds(start.elapsed().as_secs_f64());
        let (snapshot, events) = runner.tick(now, &std::mem::take(&mut commands));
        pace.ticks += 1;
        if each(&snapshot, &events, &mut commands).is_break() {
            return pace;
        }
        due += period;
    }
}

/// Ticks on simulated time, as fast as it goes, until `each` says stop.
pub fn run_in_simulated_time(
    runner: &mut Runner,
    mut each: impl FnMut(&Arc<Snapshot>, &[Event], &mut Vec<Command>) -> std::ops::ControlFlow<()>,
) -> Pace {
    let mut pace = Pace::default();
    let mut commands = Vec::new();
    loop {
        let now = Stamp::from_seconds(pace.ticks as f64 * TICK_S);
        let (snapshot, events) = runner.tick(now, &std::mem::take(&mut commands));
        pace.ticks += 1;
        if each(&snapshot, &events, &mut commands).is_break() {
            return pace;
        }
    }
}

/// Starts the twin's own thread. `first` is commanded once a second of frames has come in: by then
/// the orientation filters have settled. `repaint` is called after every snapshot. The thread ends when the
/// handle is dropped; whoever ends the program joins it first, or the end of a recording is lost.
///
/// # Errors
/// When the thread cannot be started.
pub fn spawn(
    mut runner: Runner,
    start: Instant,
    mut first: Vec<Command>,
    mut repaint: impl FnMut() + Send + 'static,
) -> std::io::Result<(Handle, JoinHandle<()>)> {
    let (command_tx, command_rx): (SyncSender<Command>, Receiver<Command>) = sync_channel(64);
    let (event_tx, event_rx) = sync_channel(256);
    let (feed_tx, feed_rx) = sync_channel(FEED);
    let latest = Arc::new(Mutex::new(Arc::new(Snapshot::default())));
    let published = Arc::clone(&latest);
    let thread = std::thread::Builder::new()
        .name("twin".to_owned())
        .spawn(move || {
            run_in_real_time(&mut runner, start, |snapshot, events, commands| {
                match published.lock() {
                    Ok(mut slot) => *slot = Arc::clone(snapshot),
                    Err(poisoned) => *poisoned.into_inner() = Arc::clone(snapshot),
                }
                // A window that does not keep up loses history, never the control loop its time.
                let _ = feed_tx.try_send(Arc::clone(snapshot));
                for event in events {
                    let _ = event_tx.try_send(event.clone());
                }
                repaint();
                if snapshot.link.connected && snapshot.link.frames > SETTLING_FRAMES {
                    commands.append(&mut first);
                }
                loop {
                    match command_rx.try_recv() {
                        Ok(command) => commands.push(command),
                        Err(std::sync::mpsc::TryRecvError::Empty) => {
                            return std::ops::ControlFlow::Continue(());
                        }
                        // The window is gone: nobody could press STOP any more.
                        Err(std::sync::mpsc::TryRecvError::Disconnected) => {
                            return std::ops::ControlFlow::Break(());
                        }
                    }
                }
            });
            runner.end(Stamp::from_seconds(start.elapsed().as_secs_f64()));
        })?;
    let handle = Handle {
        commands: command_tx,
        events: event_rx,
        feed: feed_rx,
        latest,
    };
    Ok((handle, thread))
}
