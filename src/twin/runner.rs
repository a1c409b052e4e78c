//! The twin with its surroundings: a port, a recorder, a stream.

use std::sync::Arc;

use super::loops::Clock;
use super::mesh::mesh_worker;
use super::newest::Newest;
use super::record::Recording;
use super::shape::Drawing;
use super::stream::{LAST_WORDS, OldStream, Told};
use super::{Command, Event, MeshAnswer, MeshQuestion, Twin};
use crate::link::LinkEvent;
use crate::recording::{ArmDrawing, LiveStream, RecordingMeta};
use crate::robot::RobotSpec;
use crate::signal::{GroundTruth, LinkStatus, PressureCommand, RawFrame, Snapshot, Stamp};

/// Frames after which the orientation filters have settled.
pub const SETTLING_FRAMES: u64 = 100;

/// What arrived since the last poll.
#[derive(Default)]
pub struct Arrivals {
    /// Frames, oldest first.
    pub frames: Vec<RawFrame>,
    /// Motion capture, oldest first.
    pub truths: Vec<GroundTruth>,
    /// State of the link.
    pub status: LinkStatus,
    /// Things worth telling.
    pub notices: Vec<LinkEvent>,
}

/// The boards, however they are reached: over a serial port, or in this process on simulated time.
pub trait Port: Send {
    /// The clock that passes at the other end.
    fn clock(&self) -> Clock;
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
    pub(super) robot: RobotSpec,
    pub(super) recording: Option<Recording>,
    pub(super) stream: Option<LiveStream>,
    pub(super) old_streams: Vec<OldStream>,
    pub(super) streaming_told: Told,
    /// Started when the mesh is shown for the first time.
    pub(super) mesh: Option<Newest<MeshQuestion, MeshAnswer>>,
    pub(super) drawing: Drawing,
    /// Whether somebody looks at the arm.
    pub(super) looked_at: bool,
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
            drawing: Drawing::default(),
            looked_at: false,
            was_safe: false,
        }
    }

    /// The clock that passes at the other end of the port.
    pub fn clock(&self) -> Clock {
        self.port.clock()
    }

    /// One tick: port, twin, port, recorder. Every frame that waited is processed; commands go
    /// with the last one.
    pub fn tick(&mut self, now: Stamp, commands: &[Command]) -> (Arc<Snapshot>, Vec<Event>) {
        let arrivals = self.port.poll(now);
        let mut events: Vec<Event> = arrivals
            .notices
            .into_iter()
            .map(|event| Event::of_link(now, &event))
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
        self.exchange_shape();
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
            begun: String::new(),
            drawing: Some(drawing(&self.robot)),
        }
    }

    /// Ends what is under way: lets the port go first, so that another twin can have it, then ends stream
    /// and recording. Waits for the disk.
    pub(super) fn end(&mut self, now: Stamp) {
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
    fn clock(&self) -> Clock {
        Clock::Lockstep
    }
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
