//! A rig on pseudo-terminals in a thread of its own, and a twin that steers it in real time. Both look at the
//! same clock, so that what happens on one side can be timed on the other.

use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use springtwin::link::Origin;
use springtwin::link::serial;
use springtwin::link::wire::Config;
use springtwin::rig::pty::{Lines, Pty};
use springtwin::rig::{RigOptions, VirtualRig};
use springtwin::robot::RobotSpec;
use springtwin::signal::{BOARDS, CHAMBERS, Goal, Mode, Snapshot};
use springtwin::twin::{Command, Event, Runner, SETTLING_FRAMES, SerialPort, run_in_real_time};

use crate::conformance::firmware_folder;
use crate::program::scratch;

/// What the rig's boards are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Boards {
    /// Emulated.
    Emulated,
    /// The real firmware under simavr.
    Firmware,
}

/// An attempt in which a loop stood still for longer than this says nothing when it fails, s.
const STALL_S: f64 = 0.008;
const ATTEMPTS: u32 = 5;

/// The rig at one of its steps.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// When, s.
    pub t_s: f64,
    /// Whether a pump of each board runs.
    pub pumps: [bool; BOARDS],
    /// What the gauges read, Pa; NaN where one reads nothing.
    pub gauge_pa: [f64; CHAMBERS],
    /// Frames that a fault has hit.
    pub hits: u64,
}

type Deed = Box<dyn FnOnce(&mut VirtualRig) + Send>;

struct RigThread {
    deeds: SyncSender<Deed>,
    moments: Arc<Mutex<Vec<Moment>>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// The rig and the twin.
pub struct Bench {
    rig: RigThread,
    /// Nothing once the program is dead.
    runner: Option<Runner>,
    start: Instant,
    /// The newest snapshot.
    pub now: Arc<Snapshot>,
    /// Everything that happened, with its time (s).
    pub events: Vec<(f64, String)>,
    /// Frames' stamps as the twin got them, s.
    pub stamps: Vec<f64>,
    commands: Vec<Command>,
    last_tick_s: f64,
    worst_gap_s: f64,
    looks_from: usize,
}

/// Carries out a case. A failure counts only when the machine kept time.
pub fn case(name: &str, boards: Boards, act: impl Fn(&mut Bench)) {
    for attempt in 1..=ATTEMPTS {
        let mut bench = Bench::new(&format!("{name}-{boards:?}"), boards);
        let done = catch_unwind(AssertUnwindSafe(|| {
            bench.settle();
            act(&mut bench);
        }));
        let Err(failure) = done else { return };
        let gap_s = bench.worst_gap_s();
        if gap_s <= STALL_S || attempt == ATTEMPTS {
            println!("{:#?}", bench.events);
            resume_unwind(failure);
        }
        println!(
            "the machine stood still for {:.0} ms: once more",
            gap_s * 1e3
        );
    }
}

impl Bench {
    fn new(name: &str, boards: Boards) -> Self {
        let dir = scratch(&format!("faults-{name}"));
        let robot = RobotSpec::reference();
        #[expect(
            clippy::disallowed_methods,
            reason = "the bench owns its threads and their time"
        )]
        let start = Instant::now();
        let link = dir.join("port");
        let (rig, ports) = RigThread::start(&robot, boards, &link, start);
        let link = serial::open(&ports, start, Config::built_in(), Origin::Simulated)
            .expect("the port opens");
        Self {
            runner: Some(Runner::new(
                crate::firmware::twin(&robot),
                Box::new(SerialPort::new(link)),
                &robot,
            )),
            rig,
            start,
            now: Arc::default(),
            events: Vec::new(),
            stamps: Vec::new(),
            commands: Vec::new(),
            last_tick_s: 0.0,
            worst_gap_s: 0.0,
            looks_from: 0,
        }
    }

    /// Until the boards are there and the filters have settled. Timing counts from here.
    fn settle(&mut self) {
        let settled = |b: &Self| b.now.link.connected && b.now.link.frames > SETTLING_FRAMES + 150;
        self.until("the boards are there", 20.0, settled);
        self.worst_gap_s = 0.0;
        self.looks_from = self.moments().len();
    }

    /// Seconds since the start.
    pub fn t_s(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    /// Ticks until `done`, for at most `limit_s`; how long it took, s.
    pub fn until(&mut self, what: &str, limit_s: f64, done: impl Fn(&Self) -> bool) -> f64 {
        let from_s = self.t_s();
        self.tick_while(|b| !done(b) && b.t_s() - from_s < limit_s);
        assert!(
            done(self),
            "{what}: not within {limit_s} s; {:?}",
            self.now.mode
        );
        self.t_s() - from_s
    }

    /// Ticks for so long.
    pub fn run(&mut self, for_s: f64) {
        let to_s = self.t_s() + for_s;
        self.tick_while(|b| b.t_s() < to_s);
    }

    fn tick_while(&mut self, go_on: impl Fn(&Self) -> bool) {
        // Lent to the loop; what the loop sees goes into the rest.
        let mut runner = self.runner.take().expect("the program lives");
        let start = self.start;
        self.last_tick_s = self.t_s();
        run_in_real_time(&mut runner, start, |snapshot, events, commands| {
            self.see(snapshot, events);
            commands.append(&mut self.commands);
            match go_on(self) {
                true => ControlFlow::Continue(()),
                false => ControlFlow::Break(()),
            }
        });
        self.runner = Some(runner);
    }

    fn see(&mut self, snapshot: &Arc<Snapshot>, events: &[Event]) {
        let t_s = self.t_s();
        let late_s = t_s - self.last_tick_s - springtwin::twin::TICK_S;
        self.worst_gap_s = self.worst_gap_s.max(late_s);
        self.last_tick_s = t_s;
        self.now = Arc::clone(snapshot);
        self.events.extend(events.iter().map(|e| (t_s, e.text())));
        if let Some(sensors) = &snapshot.sensors {
            let stamp_s = sensors.stamp.seconds();
            if self.stamps.last().is_none_or(|last| *last != stamp_s) {
                self.stamps.push(stamp_s);
            }
        }
    }

    /// The longest that the twin's or the rig's loop stood still since the start of the case, s.
    fn worst_gap_s(&self) -> f64 {
        let moments = self.moments();
        let gaps = moments[self.looks_from.min(moments.len())..].windows(2);
        let gap = |m: &[Moment]| m[1].t_s - m[0].t_s;
        gaps.map(gap).fold(self.worst_gap_s, f64::max)
    }

    /// Gives the twin a command with its next tick.
    pub fn tell(&mut self, command: Command) {
        self.commands.push(command);
    }

    /// Arms, and steers to a target (m) until the arm moves.
    pub fn go(&mut self, target_m: [f64; 3]) {
        self.tell(Command::Arm);
        self.tell(Command::Goto(Goal::position(target_m)));
        self.until("the arm moves", 3.0, |b| b.now.mode == Mode::Moving);
    }

    /// Does something to the rig, now; gives the time (s).
    pub fn rig(&self, deed: impl FnOnce(&mut VirtualRig) + Send + 'static) -> f64 {
        let (done, heard) = sync_channel(1);
        let start = self.start;
        let deed = Box::new(move |rig: &mut VirtualRig| {
            deed(rig);
            let _ = done.send(start.elapsed().as_secs_f64());
        });
        self.rig.deeds.send(deed).expect("the rig runs");
        // The twin ticks on meanwhile: the rig looks every millisecond.
        heard
            .recv_timeout(Duration::from_secs(5))
            .expect("the rig runs")
    }

    /// The rig's moments so far.
    pub fn moments(&self) -> Vec<Moment> {
        self.rig.moments.lock().expect("not poisoned").clone()
    }

    /// When the pumps of all boards were off after `from_s`, s.
    pub fn pumps_off_s(&self, from_s: f64) -> Option<f64> {
        let moments = self.moments();
        let off = moments
            .iter()
            .find(|m| m.t_s >= from_s && m.pumps == [false; BOARDS])?;
        Some(off.t_s)
    }

    /// Whether a pump ran between two times (s).
    pub fn pumps_ran(&self, from_s: f64, to_s: f64) -> bool {
        let within = |m: &&Moment| (from_s..to_s).contains(&m.t_s);
        let moments = self.moments();
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

    /// Ends the twin and its link as a program that dies does: nothing more is said. Gives the time, s.
    pub fn die(&mut self) -> f64 {
        self.runner = None;
        self.t_s()
    }
}

impl RigThread {
    fn start(robot: &RobotSpec, boards: Boards, link: &Path, start: Instant) -> (Self, String) {
        let robot = robot.clone();
        let link = link.to_owned();
        let (deeds, todo): (SyncSender<Deed>, Receiver<Deed>) = sync_channel(8);
        let (tell_ports, ports) = sync_channel(1);
        let moments = Arc::new(Mutex::new(Vec::with_capacity(200_000)));
        let stop = Arc::new(AtomicBool::new(false));
        let (seen, halt) = (Arc::clone(&moments), Arc::clone(&stop));
        let rig_loop = move || {
            let mut rig = VirtualRig::new(&robot, &RigOptions::default()).expect("settles");
            let open = |path: &Path| Pty::open(Some(path)).expect("a pseudo-terminal");
            let (mut lines, names) = match boards {
                Boards::Emulated => (Lines::Shared(open(&link)), link.display().to_string()),
                Boards::Firmware => {
                    rig.use_firmware(&firmware_folder())
                        .expect("the firmware starts");
                    let each = [link.with_extension("1"), link.with_extension("2")];
                    let names = each.each_ref().map(|p| p.display().to_string()).join(",");
                    (Lines::Each(each.each_ref().map(|p| open(p))), names)
                }
            };
            tell_ports.send(names).expect("somebody waits for it");
            while !halt.load(Ordering::Relaxed) {
                let t_s = start.elapsed().as_secs_f64();
                while let Ok(deed) = todo.try_recv() {
                    deed(&mut rig);
                }
                lines.exchange(&mut rig, t_s).expect("the lines work");
                seen.lock().expect("not poisoned").push(Moment {
                    t_s,
                    pumps: std::array::from_fn(|b| rig.set_pa()[3 * b].is_some()),
                    gauge_pa: std::array::from_fn(|i| {
                        rig.readings()[i / 3].chamber_pa[i % 3].unwrap_or(f64::NAN)
                    }),
                    hits: rig.faults.hits(),
                });
                std::thread::sleep(Duration::from_millis(1));
            }
        };
        let thread = std::thread::Builder::new()
            .name("rig".to_owned())
            .spawn(rig_loop)
            .expect("a thread for the rig");
        let rig = Self {
            deeds,
            moments,
            stop,
            thread: Some(thread),
        };
        let ports = ports.recv_timeout(Duration::from_secs(60));
        (rig, ports.expect("the rig starts"))
    }
}

impl Drop for RigThread {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
