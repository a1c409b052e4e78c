//! The operator of a soak: arms, sends the arm about, rests, records, streams to a viewer that is not there, and
//! resets a twin that went SAFE.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use rand::{Rng as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

use crate::robot::RobotSpec;
use crate::signal::{ControllerKind, Goal, Gripper, Mode, Simulator, Snapshot, StreamState};
use crate::task::{Follow, Item, PATH_WAYPOINTS, Plan, circle, figure_eight};
use crate::twin::{Command, Event};

/// A motion that takes longer is given up, s.
const GIVE_UP_S: f64 = 180.0;
/// Names of recordings that take turns.
const FILES: u64 = 3;

/// Counts of the operator's actions.
#[derive(Clone, Copy, Debug, Default)]
pub struct Done {
    /// Times that the twin went SAFE.
    pub safe: u64,
    /// Resets asked for.
    pub resets: u64,
    /// Goals and plans asked for.
    pub motions: u64,
    /// Goals reached, stops of plans included.
    pub goals_reached: u64,
    /// Plans carried out.
    pub plans_finished: u64,
    /// Commands that were refused.
    pub refused: u64,
    /// Recordings ended, and those of them that failed.
    pub recordings: u64,
    /// Recordings that failed.
    pub recordings_failed: u64,
    /// Streams begun.
    pub streams: u64,
    /// Longest time in SAFE, s.
    pub longest_safe_s: f64,
}

/// The operator.
pub struct Operator {
    rng: Pcg64Mcg,
    folder: PathBuf,
    viewer: SocketAddr,
    payload_max_kg: f64,
    /// Counts of the actions so far.
    pub done: Done,
    mode: Mode,
    mode_since_s: f64,
    /// When the geometric simulator is shown next, and until when, s. Its thread stays once it was shown.
    mesh_s: [f64; 2],
    /// Time of the next command about motion, s.
    act_s: f64,
    record_s: f64,
    /// The recording that runs, or is being ended.
    recording: Option<Recorded>,
    stream_s: f64,
    streaming: bool,
    /// No recording or stream begins before, s.
    quiet_until_s: f64,
}

struct Recorded {
    path: PathBuf,
    until_s: f64,
    /// Whether its end was asked for.
    closing: bool,
}

impl Operator {
    /// An operator whose recordings go to `folder` and whose streams go to `viewer`.
    pub fn new(robot: &RobotSpec, seed: u64, folder: &Path, viewer: SocketAddr) -> Self {
        Self {
            rng: Pcg64Mcg::seed_from_u64(seed ^ 0x6f70_6572),
            folder: folder.to_owned(),
            viewer,
            payload_max_kg: robot.payload_max_kg,
            done: Done::default(),
            mode: Mode::Disarmed,
            mode_since_s: 0.0,
            mesh_s: [35.0, 45.0],
            act_s: 0.0,
            record_s: 5.0,
            recording: None,
            stream_s: 40.0,
            streaming: false,
            quiet_until_s: 0.0,
        }
    }

    /// Ends recording and stream and begins none until `t_s`, s.
    pub fn be_quiet_until(&mut self, t_s: f64) {
        self.quiet_until_s = t_s;
    }

    /// Whether neither a recording nor a stream is open.
    pub fn is_quiet(&self) -> bool {
        self.recording.is_none() && !self.streaming
    }

    /// Takes the snapshot and events of a tick and adds commands for the next.
    pub fn attend(&mut self, snapshot: &Snapshot, events: &[Event], commands: &mut Vec<Command>) {
        let t_s = snapshot.stamp.seconds();
        for event in events {
            self.note(event);
        }
        self.note_mode(t_s, &snapshot.mode);
        self.show(t_s, commands);
        self.move_about(t_s, snapshot, commands);
        self.record(t_s, commands);
        self.stream(t_s, snapshot, commands);
    }

    /// Shows the geometric simulator for a while now and then.
    fn show(&mut self, t_s: f64, commands: &mut Vec<Command>) {
        let [from_s, to_s] = self.mesh_s;
        if t_s >= from_s {
            commands.push(Command::Show(Simulator::Mesh));
            self.mesh_s[0] = f64::INFINITY;
        }
        if t_s >= to_s {
            commands.push(Command::Show(Simulator::Rod));
            let next_s = t_s + self.rng.random_range(300.0..900.0);
            self.mesh_s = [next_s, next_s + self.rng.random_range(2.0..20.0)];
        }
    }

    fn note(&mut self, event: &Event) {
        match event {
            Event::Refused { reason, .. } => {
                self.done.refused += 1;
                // A recording that could not begin says so in its own words.
                if let Some(r) = &self.recording
                    && reason.contains(&*r.path.to_string_lossy())
                {
                    self.done.recordings_failed += 1;
                    self.recording = None;
                }
            }
            Event::Reached { .. } => self.done.goals_reached += 1,
            Event::Finished { .. } => self.done.plans_finished += 1,
            Event::Recording { text, .. } if text.starts_with("Recorded") => self.recorded(),
            Event::RecordingFailed { .. } => {
                self.done.recordings_failed += 1;
                self.recorded();
            }
            _ => {}
        }
    }

    fn recorded(&mut self) {
        if let Some(r) = self.recording.take() {
            self.done.recordings += 1;
            // One that was removed under way is gone already.
            let _ = std::fs::remove_file(&r.path);
        }
    }

    fn note_mode(&mut self, t_s: f64, mode: &Mode) {
        if let Mode::Safe(_) = self.mode {
            let longest_s = &mut self.done.longest_safe_s;
            *longest_s = longest_s.max(t_s - self.mode_since_s);
        }
        if *mode == self.mode {
            return;
        }
        let was_safe = matches!(self.mode, Mode::Safe(_));
        if matches!(mode, Mode::Safe(_)) && !was_safe {
            self.done.safe += 1;
        }
        self.mode = mode.clone();
        self.mode_since_s = t_s;
        self.act_s = t_s
            + match mode {
                Mode::Safe(_) => self.rng.random_range(0.5..8.0),
                Mode::Disarmed => self.rng.random_range(0.5..3.0),
                Mode::Hold => self.rng.random_range(0.5..20.0),
                Mode::AtGoal => self.rng.random_range(0.5..40.0),
                Mode::Moving => GIVE_UP_S,
            };
    }

    fn move_about(&mut self, t_s: f64, snapshot: &Snapshot, commands: &mut Vec<Command>) {
        if t_s < self.act_s {
            return;
        }
        // What is refused is tried again.
        self.act_s = t_s + 3.0;
        match self.mode {
            Mode::Safe(_) => {
                self.done.resets += 1;
                commands.push(Command::Reset);
            }
            Mode::Disarmed => {
                if snapshot.has_settled() {
                    commands.push(Command::Arm);
                }
            }
            Mode::Moving => commands.push(Command::Hold),
            Mode::Hold | Mode::AtGoal => self.next_motion(commands),
        }
    }

    fn next_motion(&mut self, commands: &mut Vec<Command>) {
        self.done.motions += 1;
        match self.rng.random_range(0..20) {
            0 => commands.push(Command::Disarm),
            1 => commands.push(Command::Resume),
            2 => {
                // Heavier than what is really there: that is what declarations are like.
                let kg = self.rng.random_range(0.0..0.3 * self.payload_max_kg);
                commands.extend([Command::DeclarePayload(kg), Command::Hold]);
            }
            3 => commands.push(Command::Stop),
            // Refused while it moves on.
            4 if matches!(self.mode, Mode::Hold) => commands.push(Command::Vent),
            4 => {
                let kind = match self.rng.random() {
                    true => ControllerKind::PaperAdrc,
                    false => ControllerKind::NullSpaceQp,
                };
                commands.push(Command::Steer(kind));
            }
            5 => {
                commands.extend([Command::Grip(Gripper::Closed), Command::DeclarePayload(0.0)]);
            }
            6 => {
                commands.extend([Command::Grip(Gripper::Open), Command::DeclarePayload(0.0)]);
            }
            7 | 8 => {
                let centre = [0.0, 0.0, -self.rng.random_range(0.29..0.32)];
                let path = match self.rng.random() {
                    true => circle(centre, self.rng.random_range(0.03..0.05), PATH_WAYPOINTS),
                    false => figure_eight(centre, 0.05, PATH_WAYPOINTS),
                };
                let speed_m_s = self.rng.random_range(3e-3..12e-3);
                let follow = Follow {
                    path,
                    speed_m_s,
                    laps: 1,
                };
                commands.extend(Plan::follow(follow).map(Command::Start));
            }
            9 => {
                let items = [Item {
                    name: "item".to_owned(),
                    grasp_m: [-0.06, 0.02, -0.32],
                    mass_kg: 0.1,
                }];
                let plan = Plan::pick_and_place(&items, [0.06, 0.0, -0.30], 0.03);
                commands.push(Command::Start(plan));
            }
            _ => {
                let goal = Goal::position(self.point_m());
                match self.rng.random() {
                    true => commands.push(Command::Goto(goal)),
                    false => commands.extend([Command::Preview(goal), Command::Go]),
                }
            }
        }
    }

    /// Somewhere below the base, mostly within reach, m.
    fn point_m(&mut self) -> [f64; 3] {
        let mut side = || self.rng.random_range(-0.09..0.09);
        let (x, y) = (side(), side());
        [x, y, -self.rng.random_range(0.27..0.35)]
    }

    fn record(&mut self, t_s: f64, commands: &mut Vec<Command>) {
        let quiet = t_s < self.quiet_until_s;
        match &mut self.recording {
            Some(r) if !r.closing && (t_s >= r.until_s || quiet) => {
                r.closing = true;
                // Now and then somebody removes the file first.
                if self.rng.random_bool(0.1) {
                    let _ = std::fs::remove_file(&r.path);
                }
                commands.push(Command::StopRecording);
            }
            None if t_s >= self.record_s && !quiet => {
                let n = self.done.recordings % FILES;
                let path = self.folder.join(format!("soak-{n}.rrd"));
                let until_s = t_s + self.rng.random_range(5.0..90.0);
                self.record_s = until_s + self.rng.random_range(5.0..300.0);
                commands.push(Command::StartRecording(path.clone()));
                self.recording = Some(Recorded {
                    path,
                    until_s,
                    closing: false,
                });
            }
            _ => {}
        }
    }

    fn stream(&mut self, t_s: f64, snapshot: &Snapshot, commands: &mut Vec<Command>) {
        let quiet = t_s < self.quiet_until_s;
        let ended = snapshot
            .streaming
            .as_ref()
            .is_some_and(|s| matches!(s.state, StreamState::Ended(_)));
        if self.streaming && (ended || quiet) {
            self.streaming = false;
            commands.push(Command::StopStream);
        } else if !self.streaming && !quiet && t_s >= self.stream_s {
            self.stream_s = t_s + self.rng.random_range(60.0..600.0);
            self.streaming = true;
            self.done.streams += 1;
            commands.push(Command::StreamLive(self.viewer));
        }
    }
}
