//! A rig that breaks on purpose and a twin that steers it, in lockstep on simulated time: what happens on one side is
//! timed on the other, to the millisecond.

use std::sync::{Arc, Mutex, MutexGuard};

use springtwin::lab::units::Lab;
use springtwin::link::HostSession;
use springtwin::rig::{RigOptions, VirtualRig};
use springtwin::robot::RobotSpec;
use springtwin::signal::{BOARDS, Goal, Mode, Snapshot, Stamp};
use springtwin::twin::{Command, Event, Runner, TICK_S};

use crate::conformance::firmware_folder;
pub use crate::lockstep::Moment;
use crate::lockstep::{World, runner, runner_of, simulated_host, twin_with};

/// What the rig's boards are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Boards {
    /// Emulated.
    Emulated,
    /// The real firmware under simavr.
    Firmware,
}

/// The rig and the twin.
pub struct Bench {
    world: Arc<Mutex<World>>,
    /// Nothing once the program is dead.
    runner: Option<Runner>,
    ticks: u64,
    /// The newest snapshot.
    pub now: Arc<Snapshot>,
    /// Everything that happened, with its time (s).
    pub events: Vec<(f64, String)>,
    /// Frames' stamps as the twin got them, s.
    pub stamps: Vec<f64>,
    commands: Vec<Command>,
}

/// Frames after which a case begins.
const SETTLED: u64 = 250;

/// Carries out a case, once the boards are there and the filters have settled.
pub fn case(boards: Boards, act: impl FnOnce(&mut Bench)) {
    case_of(&RigOptions::default(), boards, act);
}

/// The same, of a rig that is not the default one.
pub fn case_of(options: &RigOptions, boards: Boards, act: impl FnOnce(&mut Bench)) {
    act_on(Bench::new(options, boards, None), act);
}

/// The same without the check of the gauges when the arm is armed, which boards at a port would have.
pub fn case_unchecked(options: &RigOptions, boards: Boards, act: impl FnOnce(&mut Bench)) {
    let bench = Bench::new(options, boards, None);
    bench.world().host = simulated_host();
    act_on(bench, act);
}

/// The same of a unit with emulated boards after its lab's calibration.
pub fn case_in_lab(options: &RigOptions, lab: Option<&Lab>, act: impl FnOnce(&mut Bench)) {
    act_on(Bench::new(options, Boards::Emulated, lab), act);
}

fn act_on(mut bench: Bench, act: impl FnOnce(&mut Bench)) {
    let settled = |b: &Bench| b.now.has_settled() && b.now.link.frames > SETTLED;
    bench.until("the boards are there", 20.0, settled);
    bench.reset();
    act(&mut bench);
}

impl Bench {
    fn new(options: &RigOptions, boards: Boards, lab: Option<&Lab>) -> Self {
        let folder = (boards == Boards::Firmware).then(firmware_folder);
        let mut world = World::of(options, folder.as_deref());
        world.moments = Some(Vec::with_capacity(100_000));
        let (runner, world) = match lab {
            None => runner(world),
            Some(lab) => {
                let (networks, curves) = (lab.networks.clone(), lab.calibration.clone());
                runner_of(world, twin_with(&RobotSpec::reference(), networks, curves))
            }
        };
        Self {
            world,
            runner: Some(runner),
            ticks: 0,
            now: Arc::default(),
            events: Vec::new(),
            stamps: Vec::new(),
            commands: Vec::new(),
        }
    }

    fn world(&self) -> MutexGuard<'_, World> {
        self.world.lock().expect("not poisoned")
    }

    /// Simulated seconds since the start.
    pub fn t_s(&self) -> f64 {
        self.ticks as f64 * TICK_S
    }

    /// Ticks until `done`, for at most `limit_s`; how long it took, s.
    pub fn until(&mut self, what: &str, limit_s: f64, done: impl Fn(&Self) -> bool) -> f64 {
        let from_s = self.t_s();
        while !done(self) {
            assert!(
                self.t_s() - from_s < limit_s,
                "{what}: not within {limit_s} s; {:?}",
                self.now.mode
            );
            self.tick();
        }
        self.t_s() - from_s
    }

    /// Ticks for so long.
    pub fn run(&mut self, for_s: f64) {
        for _ in 0..(for_s / TICK_S).round() as u64 {
            self.tick();
        }
    }

    fn tick(&mut self) {
        self.ticks += 1;
        let t_s = self.t_s();
        let Some(runner) = &mut self.runner else {
            // The rig goes on without the program.
            self.world().run_to(t_s);
            return;
        };
        let commands = std::mem::take(&mut self.commands);
        let (snapshot, events) = runner.tick(Stamp::from_seconds(t_s), &commands);
        self.see(snapshot, &events);
    }

    fn see(&mut self, snapshot: Arc<Snapshot>, events: &[Event]) {
        let t_s = self.t_s();
        self.events.extend(events.iter().map(|e| (t_s, e.text())));
        if let Some(sensors) = &snapshot.sensors {
            let stamp_s = sensors.stamp.seconds();
            if self.stamps.last().is_none_or(|last| *last != stamp_s) {
                self.stamps.push(stamp_s);
            }
        }
        self.now = snapshot;
    }

    /// Gives the twin a command with its next tick.
    pub fn tell(&mut self, command: Command) {
        self.commands.push(command);
    }

    /// Arms, and steers to a target (m) until the arm moves.
    pub fn go(&mut self, target_m: [f64; 3]) {
        self.tell(Command::Arm);
        self.tell(Command::Goto(Goal::position(target_m)));
        // The gauges are checked first where the boards are at a port.
        self.until("the arm moves", 20.0, |b| b.now.mode == Mode::Moving);
    }

    /// Leaves SAFE, and waits until the filters have settled.
    pub fn reset(&mut self) {
        self.tell(Command::Reset);
        self.until("it is reset", 2.0, |b| b.now.mode == Mode::Disarmed);
        self.run(0.6);
    }

    /// The program's control loop does not tick for so long, while its link goes on.
    pub fn stall(&mut self, for_s: f64) {
        self.ticks += (for_s / TICK_S).round() as u64;
        let t_s = self.t_s();
        self.world().run_to(t_s);
    }

    /// Does something to the host's end of the link, now.
    pub fn link(&self, deed: impl FnOnce(&mut HostSession)) {
        deed(&mut self.world().host);
    }

    /// Does something to the rig, now; gives the time (s).
    pub fn rig(&self, deed: impl FnOnce(&mut VirtualRig)) -> f64 {
        deed(&mut self.world().rig);
        self.t_s()
    }

    /// The rig's moments so far.
    pub fn moments(&self) -> Vec<Moment> {
        self.world().moments.clone().unwrap_or_default()
    }

    /// When the pumps of all boards were off after `from_s`, s.
    pub fn pumps_off_s(&self, from_s: f64) -> Option<f64> {
        let world = self.world();
        let moments = world.moments.as_deref().unwrap_or_default();
        let from = moments.partition_point(|m| m.t_s < from_s);
        let off = moments[from..].iter();
        off.map(|m| (m.t_s, m.pumps))
            .find(|(_, pumps)| *pumps == [false; BOARDS])
            .map(|(t_s, _)| t_s)
    }

    /// Whether a pump ran between two times (s).
    pub fn pumps_ran(&self, from_s: f64, to_s: f64) -> bool {
        let within = |m: &&Moment| (from_s..to_s).contains(&m.t_s);
        let world = self.world();
        let moments = world.moments.as_deref().unwrap_or_default();
        moments
            .iter()
            .filter(within)
            .any(|m| m.pumps != [false; BOARDS])
    }

    /// Whether the twin is SAFE for a reason with these words.
    pub fn is_safe(&self, words: &str) -> bool {
        matches!(&self.now.mode, Mode::Safe(reason) if reason.contains(words))
    }

    /// Whether there is an alarm with these words.
    pub fn alarmed(&self, words: &str) -> bool {
        self.now.alarms.iter().any(|a| a.text().contains(words))
    }

    /// When an event with these words came after `from_s`, s.
    pub fn event_s(&self, from_s: f64, words: &str) -> Option<f64> {
        let found = |(t_s, text): &&(f64, String)| *t_s >= from_s && text.contains(words);
        self.events.iter().find(found).map(|(t_s, _)| *t_s)
    }

    /// The pushes that follow are meant.
    pub fn expect_pushes(&mut self) {
        let runner = self.runner.as_mut().expect("the program lives");
        runner.twin.expect_pushes();
    }

    /// Keeps no moments of the rig from now on.
    pub fn forget_moments(&self) {
        self.world().moments = None;
    }

    /// Ends the recording that runs. Waits for the disk.
    pub fn end_recording(&mut self) {
        let (now, mut last) = (Stamp::from_seconds(self.t_s()), Vec::new());
        let runner = self.runner.as_mut().expect("the program lives");
        runner.stop_recording(now, &mut last);
        let t_s = self.t_s();
        self.events.extend(last.iter().map(|e| (t_s, e.text())));
    }

    /// Ends the twin and its link as a program that dies does: nothing more is said. Gives the time, s.
    pub fn die(&mut self) -> f64 {
        self.runner = None;
        self.world().frozen = true;
        self.t_s()
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        if std::thread::panicking() {
            println!("{:#?}", self.events);
        }
    }
}
