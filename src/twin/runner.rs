//! The twin with its surroundings: a port, a view, a recorder, a stream.

use std::sync::Arc;
use std::time::Duration;

use super::command::{Command, Event};
use super::core::Twin;
use super::port::{Clock, NoPort, Port};
use super::record::Recordings;
use super::rolling::{Rolling, RollingOf};
use super::stream::{LAST_WORDS, Streams};
use super::tried::Trial;
use super::view::View;
use super::watch::Watch;
use crate::link::StopLine;
use crate::recording::{ArmDrawing, QueueFull, RecordingMeta, RollingFolder};
use crate::robot::RobotSpec;
use crate::signal::{Snapshot, Stamp, StreamStatus};

/// A twin, its port, its view and its recorder.
pub struct Runner {
    /// The twin.
    pub twin: Twin,
    port: Box<dyn Port>,
    robot: RobotSpec,
    pub(super) view: View,
    recordings: Recordings,
    rolling: Option<Rolling>,
    watch: Option<Watch>,
    streams: Streams,
    /// Where simulated time is kept beside real time.
    real_time_factor: Option<f64>,
    /// The last tick.
    last_tick: Stamp,
    /// Where motion capture is on the robot, as its file states it (TOML); empty without one.
    registration: String,
}

impl Runner {
    /// Puts a twin on a port.
    pub fn new(twin: Twin, port: Box<dyn Port>, robot: &RobotSpec) -> Self {
        Self {
            view: View::new(robot, twin.corrected_by()),
            twin,
            port,
            robot: robot.clone(),
            recordings: Recordings::default(),
            rolling: None,
            watch: None,
            streams: Streams::default(),
            real_time_factor: None,
            last_tick: Stamp::ZERO,
            registration: String::new(),
        }
    }

    /// States in recordings how motion capture is registered with the robot (the text of its file).
    pub fn register(&mut self, registration: String) {
        self.registration = registration;
    }

    /// Keeps a rolling recording in a folder, from Arm on.
    pub fn keep_rolling(&mut self, folder: RollingFolder, of: RollingOf) {
        self.rolling = Some(Rolling::new(folder, of));
    }

    /// Compares the arm with its commissioned twin from now on.
    pub fn watch(&mut self, mut watch: Watch) {
        watch.corrected_by(self.twin.corrected_by());
        self.watch = Some(watch);
    }

    /// The clock that passes at the other end of the port.
    pub fn clock(&self) -> Clock {
        self.port.clock()
    }

    /// A way to stop the boards whatever the loop that ticks this runner does meanwhile.
    pub fn stop_line(&self) -> StopLine {
        self.port.stop_line()
    }

    /// Settles the arm's shapes from now on, because somebody looks at them. A recording and a stream do so, too.
    pub fn draw_shapes(&mut self) {
        self.view.look();
    }

    /// Lets a thread of its own settle the shapes.
    pub(super) fn draw_beside(&mut self) {
        self.view.draw_beside();
        if let Some(watch) = &mut self.watch {
            watch.beside();
        }
    }

    /// Loses no row of a recording: ticks wait for the disk, because no clock waits for them.
    pub(super) fn record_whole(&mut self) {
        self.recordings.full = QueueFull::Wait;
    }

    /// Takes simulated time per real time over the last seconds, for the snapshot.
    pub(super) fn observe_real_time_factor(&mut self, factor: Option<f64>) {
        self.real_time_factor = factor;
    }

    /// One tick. The command goes to the boards before anything is recorded, logged or drawn.
    pub fn tick(&mut self, now: Stamp, commands: &[Command]) -> (Arc<Snapshot>, Vec<Event>) {
        let mut late = Vec::new();
        let mut events = self.control(now, commands, &mut late);
        let mut snapshot = self.twin.snapshot();
        for command in commands {
            self.serve(now, command, &snapshot, &mut events);
        }
        self.recordings.watch(now, &mut events);
        self.streams.watch(now, &mut events);
        if let Some(rolling) = &mut self.rolling {
            let (robot, registration) = (&self.robot, &self.registration);
            let session = |name| session(robot, &self.twin, registration, &snapshot, name);
            rolling.update(now, &snapshot, self.recordings.full, session, &mut events);
            snapshot.rolling = rolling.status().clone();
        }
        if let Some(watch) = &mut self.watch {
            watch.update(&mut snapshot, &mut events);
        }
        for event in &events {
            let level = match event {
                Event::Warning { .. } | Event::RecordingFailed { .. } => log::Level::Warn,
                _ => log::Level::Info,
            };
            log::log!(level, "{:9.3} s  {}", now.seconds(), event.text());
        }
        let is_kept = self.recordings.is_running() || self.streams.is_running();
        self.view.update(&mut snapshot, is_kept);
        snapshot.real_time_factor = self.real_time_factor;
        snapshot.recording = self.recordings.name().cloned();
        snapshot.streaming = self.streams.status().cloned();
        let snapshot = Arc::new(snapshot);
        self.record_late(now, late);
        self.recordings.push(now, &snapshot, &events);
        if let Some(rolling) = &self.rolling {
            rolling.push(now, &snapshot, &events);
        }
        self.streams.push(now, &snapshot, &events);
        (snapshot, events)
    }

    /// Records frames and poses of motion capture that waited for the tick, between it and the last one, at the times of
    /// their samples.
    fn record_late(&mut self, now: Stamp, late: Vec<Snapshot>) {
        let mut before = std::mem::replace(&mut self.last_tick, now);
        for mut snapshot in late {
            let earliest = Stamp(before.0.saturating_add(1));
            snapshot.stamp = snapshot.stamp.max(earliest).min(Stamp(now.0 - 1));
            before = snapshot.stamp;
            let snapshot = Arc::new(snapshot);
            self.recordings.push(now, &snapshot, &[]);
            if let Some(rolling) = &self.rolling {
                rolling.push(now, &snapshot, &[]);
            }
        }
    }

    /// Port, twin, port: every frame that waited is processed; commands go with the last one. What older ones showed goes
    /// to `late`, for a recording.
    fn control(
        &mut self,
        now: Stamp,
        commands: &[Command],
        late: &mut Vec<Snapshot>,
    ) -> Vec<Event> {
        let arrivals = self.port.poll(now);
        let mut events: Vec<Event> = arrivals
            .notices
            .into_iter()
            .map(|event| Event::of_link(now, &event))
            .collect();
        self.twin.observe_link(arrivals.status);
        // Only the newest frame is answered; older ones that piled up still move the filters.
        let mut frames = arrivals.frames;
        let newest = frames.pop();
        let mut older = frames.into_iter().peekable();
        let mut truths = arrivals.truths.into_iter().peekable();
        loop {
            let truth_is_next = match (truths.peek(), older.peek()) {
                (Some(truth), Some(frame)) => truth.stamp <= frame.stamp,
                (truth, _) => truth.is_some(),
            };
            let stamp = if truth_is_next {
                let Some(truth) = truths.next() else { break };
                let stamp = truth.stamp;
                self.twin.observe_truth(truth);
                // The newest one is part of the snapshot that comes next, the tick's at the latest.
                if truths.peek().is_none() {
                    continue;
                }
                stamp
            } else {
                let Some(frame) = older.next() else { break };
                let stamp = frame.stamp;
                self.twin.absorb(frame);
                stamp
            };
            let rolls = self.rolling.as_ref().is_some_and(Rolling::is_running);
            if self.recordings.is_running() || rolls {
                late.push(Snapshot {
                    stamp,
                    ..self.twin.snapshot()
                });
            }
        }
        let (command, twin_events) = self.twin.tick(now, newest, commands);
        events.extend(twin_events);
        for order in self.twin.take_orders() {
            self.port.order(now, order);
        }
        // The link repeats a stop by itself until it is reset.
        if !self.twin.is_safe() {
            self.port.send(now, command.as_ref());
        }
        events
    }

    /// Carries out a command that is not the twin's own.
    fn serve(&mut self, now: Stamp, command: &Command, known: &Snapshot, events: &mut Vec<Event>) {
        let robot = &self.robot;
        match command {
            Command::Show(simulator) => self.view.show(*simulator),
            Command::StartRecording(path) => {
                let registration = &self.registration;
                let session = |name| session(robot, &self.twin, registration, known, name);
                self.recordings.start(now, path, session, events);
            }
            Command::StopRecording => self.recordings.close(),
            Command::Mute { effect, reason } => events.push(self.mute(now, effect, reason)),
            Command::Unmute(effect) => {
                if let Some(watch) = &mut self.watch {
                    watch.mute(effect, false);
                }
                let text = format!("{effect} counts again as a disagreement.");
                events.push(Event::Notice { stamp: now, text });
            }
            Command::TryPatch { .. }
            | Command::DropPatch
            | Command::KeepPatch
            | Command::RevertPatch => events.push(self.patch(now, command)),
            Command::Mark(text) => events.push(self.mark(now, text)),
            Command::Note(text) => events.extend(self.note(now, text)),
            Command::StreamLive(address) => {
                let registration = &self.registration;
                let session = |name| session(robot, &self.twin, registration, known, name);
                self.streams.start(now, *address, session, events);
            }
            Command::StopStream => self.streams.close(now),
            _ => {}
        }
    }

    /// Hands the note to the recording; a refusal without one.
    fn note(&self, now: Stamp, text: &str) -> Option<Event> {
        let Some(recorder) = self.recordings.recorder() else {
            return Some(Event::Refused {
                stamp: now,
                reason: "Nothing is recorded: the note is not kept.".to_owned(),
            });
        };
        recorder.note(text.to_owned());
        None
    }

    /// Lets the monitor take an effect as known.
    fn mute(&mut self, stamp: Stamp, effect: &str, reason: &str) -> Event {
        match &mut self.watch {
            _ if reason.trim().is_empty() => {
                let reason = format!("{effect} is not muted without a reason.");
                Event::Refused { stamp, reason }
            }
            Some(watch) => {
                watch.mute(effect, true);
                let text = format!("{effect} is muted: {}", reason.trim());
                Event::Notice { stamp, text }
            }
            None => Event::Refused {
                stamp,
                reason: "There is no baseline, and nothing to mute.".to_owned(),
            },
        }
    }

    /// Tries a patch, or ends its trial: what happened, or why nothing did.
    fn patch(&mut self, stamp: Stamp, command: &Command) -> Event {
        let done = match command {
            Command::TryPatch { name, robot } => {
                let trial = Trial::new(name, robot, stamp);
                let tried = self.view.try_patch(trial);
                tried.map(|()| format!("Tried beside the twin's own model: {name}. Control does not use it."))
            }
            Command::KeepPatch => self.view.keep_tried().map(|(robot, name)| {
                self.watch_by(&robot);
                format!("The twin's own model has the patch from now on: {name}. Networks, sensing and control stay as they are.")
            }),
            Command::RevertPatch => self.view.revert_kept().map(|(robot, name)| {
                self.watch_by(&robot);
                format!("The twin's own model is that of its robot file again, without {name}.")
            }),
            _ => self.view.drop_tried().map(|name| format!("No longer tried: {name}.")),
        };
        match done {
            Ok(text) => Event::Notice { stamp, text },
            Err(why) => Event::Refused {
                stamp,
                reason: why.to_string(),
            },
        }
    }

    /// Compares the arm with the twin's own model as it is now.
    fn watch_by(&mut self, robot: &Arc<RobotSpec>) {
        if let Some(watch) = &mut self.watch {
            watch.compare_with(robot);
        }
    }

    /// Marks this moment in what is recorded.
    fn mark(&self, now: Stamp, text: &str) -> Event {
        let text = match text.trim() {
            "" => "Mark",
            text => text,
        };
        let rolling = self.rolling.as_ref().and_then(|r| r.recorder(now));
        let mut taken = false;
        for recorder in self.recordings.recorder().into_iter().chain(rolling) {
            recorder.mark(now, text.to_owned());
            taken = true;
        }
        match taken {
            true => Event::Recording {
                stamp: now,
                text: format!("Marked at {:.1} s: {text}", now.seconds()),
            },
            false => Event::Refused {
                stamp: now,
                reason: "Nothing is recorded: the mark is not kept. Press Record first.".to_owned(),
            },
        }
    }

    /// Stops the boards and closes the port; the boards are SAFE afterwards.
    pub fn let_port_go(&mut self) {
        self.port = Box::new(NoPort);
    }

    /// Ends the recordings, if some run, and reports how it went. Waits for the disk: the control loop must
    /// be over.
    pub fn stop_recording(&mut self, now: Stamp, events: &mut Vec<Event>) {
        self.recordings.stop(now, events);
        self.stop_rolling();
    }

    fn stop_rolling(&mut self) {
        if let Some(rolling) = &mut self.rolling {
            rolling.stop();
        }
    }

    /// Ends the stream and reports how it went; `None` if none runs. Waits for what is left to arrive no longer than
    /// `patience`: the control loop must be over.
    pub fn stop_stream(
        &mut self,
        now: Stamp,
        patience: Duration,
        events: &mut Vec<Event>,
    ) -> Option<StreamStatus> {
        self.streams.stop(now, patience, events)
    }

    /// Ends what is under way: lets the port go first, so that another twin can have it, then ends stream
    /// and recording. Waits for the disk.
    pub(super) fn end(&mut self, now: Stamp) {
        self.let_port_go();
        let mut last = Vec::new();
        self.recordings.close();
        self.streams.stop(now, LAST_WORDS, &mut last);
        self.recordings.stop(now, &mut last);
        self.stop_rolling();
        for event in &last {
            log::info!("{:9.3} s  {}", now.seconds(), event.text());
        }
    }
}

/// The session as a whole, for a recording or a stream.
fn session(
    robot: &RobotSpec,
    twin: &Twin,
    registration: &str,
    known: &Snapshot,
    name: String,
) -> RecordingMeta {
    RecordingMeta {
        id: String::new(),
        name,
        robot: robot.name.clone(),
        robot_hash: robot.hash.clone(),
        source: known.link.source.clone(),
        simulated: Some(known.link.simulated),
        payload_kg: known.payload_kg,
        begun: String::new(),
        // Without it a recording is still one.
        calibration: twin.calibration().to_toml().unwrap_or_default(),
        corrected_by: twin.corrected_by().stated(),
        registration: registration.to_owned(),
        networks: twin.networks().to_owned(),
        firmware: firmware(known),
        controller: twin.controller(),
        note: String::new(),
        program: String::new(),
        derived_from: String::new(),
        drawing: Some(drawing(robot)),
    }
}

/// What the boards report of themselves: the protocol of this program, and the number of the arm at each board.
fn firmware(known: &Snapshot) -> String {
    let arms = known
        .link
        .rig
        .map(|arm| arm.map_or("-".to_owned(), |n| n.to_string()));
    format!(
        "protocol {}, arm {}",
        crate::link::wire::VERSION,
        arms.join("/")
    )
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
