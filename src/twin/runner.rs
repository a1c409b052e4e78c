//! The twin with its surroundings: a port, a recorder, and the thread that ticks.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::mesh::mesh_worker;
use super::newest::Newest;
use super::stream::LAST_WORDS;
use super::{Command, Event, Handle, MeshAnswer, MeshQuestion, Twin};
use crate::recording::{ArmDrawing, LiveStream, Recorder, RecordingMeta};
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
    recorder: Option<(PathBuf, Recorder)>,
    pub(super) stream: Option<LiveStream>,
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
            recorder: None,
            stream: None,
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
                Command::StopRecording => self.stop_recording(now, &mut events),
                Command::StreamLive(address) => {
                    self.start_stream(now, *address, simulated, &mut events);
                }
                Command::StopStream => {
                    self.stop_stream(now, Duration::ZERO, &mut events);
                }
                _ => {}
            }
        }
        self.watch_stream(now, &mut events);
        for event in &events {
            log::info!("{:9.3} s  {}", now.seconds(), event.text());
        }
        self.exchange_mesh();
        let snapshot = Arc::new(self.twin.snapshot());
        if let Some((_, recorder)) = &self.recorder {
            recorder.push(Arc::clone(&snapshot));
            for event in &events {
                recorder.event(now, event.text());
            }
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

    fn start_recording(
        &mut self,
        now: Stamp,
        path: &Path,
        simulated: bool,
        events: &mut Vec<Event>,
    ) {
        if self.recorder.is_some() {
            events.push(Event::Refused {
                stamp: now,
                reason: "A recording is running already: stop it first.".to_owned(),
            });
            return;
        }
        let name = path
            .file_stem()
            .map_or_else(String::new, |s| s.to_string_lossy().into_owned());
        let meta = self.session(name.clone(), simulated);
        match Recorder::start(path, meta) {
            Ok(recorder) => {
                self.recorder = Some((path.to_owned(), recorder));
                self.twin.observe_recording(Some(name));
                let text = format!("Recording to {}.", path.display());
                events.push(Event::Recording { stamp: now, text });
            }
            Err(e) => events.push(Event::Refused {
                stamp: now,
                reason: e.to_string(),
            }),
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

    /// Closes the recording, if one runs.
    pub fn stop_recording(&mut self, now: Stamp, events: &mut Vec<Event>) {
        let Some((path, recorder)) = self.recorder.take() else {
            return;
        };
        self.twin.observe_recording(None);
        let summary = recorder.stop();
        let text = match (&summary.failed, summary.dropped) {
            (Some(reason), _) => {
                format!("The recording {} stopped early: {reason}", path.display())
            }
            (None, 0) => format!("Recorded {} ({} snapshots).", path.display(), summary.rows),
            (None, dropped) => format!(
                "Recorded {} ({} snapshots, {dropped} dropped because the disk was too slow).",
                path.display(),
                summary.rows,
            ),
        };
        events.push(Event::Recording { stamp: now, text });
    }
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
/// handle is dropped.
///
/// # Errors
/// When the thread cannot be started.
pub fn spawn(
    mut runner: Runner,
    start: Instant,
    mut first: Vec<Command>,
    mut repaint: impl FnMut() + Send + 'static,
) -> std::io::Result<Handle> {
    let (command_tx, command_rx): (SyncSender<Command>, Receiver<Command>) = sync_channel(64);
    let (event_tx, event_rx) = sync_channel(256);
    let (feed_tx, feed_rx) = sync_channel(FEED);
    let latest = Arc::new(Mutex::new(Arc::new(Snapshot::default())));
    let published = Arc::clone(&latest);
    std::thread::Builder::new()
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
            let now = Stamp::from_seconds(start.elapsed().as_secs_f64());
            let mut last = Vec::new();
            runner.stop_recording(now, &mut last);
            runner.stop_stream(now, LAST_WORDS, &mut last);
        })?;
    Ok(Handle {
        commands: command_tx,
        events: event_rx,
        feed: feed_rx,
        latest,
    })
}
