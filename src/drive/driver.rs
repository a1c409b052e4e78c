//! A twin on a rig: put together in one place, ticked by one loop that observers look at.

use super::files::read_toml;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::Result;

use super::model;
use super::ports::{self, DEFAULT_RIG, Instruments, Script, rig_options};
use crate::control::{Gains, Stopwatch};
use crate::recording::RollingFolder;
use crate::rig::RigOptions;
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::signal::{ControllerKind, Snapshot, Stamp, StreamStatus};
use crate::twin::{
    Clock, Command, Event, Handle, LAST_WORDS, Maps, Pace, Port, RollingOf, Runner, Twin, Watch,
    run_in_real_time, run_in_simulated_time, spawn_until,
};

/// Builds a twin on a rig: robot, networks, calibration, controller and port.
pub struct TwinBuilder<'a> {
    pub(super) robot: &'a RobotSpec,
    robot_file: Option<&'a Path>,
    pub(super) rig: &'a str,
    options: RigOptions,
    maps: Option<Maps>,
    gains: Gains,
    instruments: Instruments,
    calibration: Option<Calibration>,
    pub(super) script: Option<Script>,
    port: Option<Box<dyn Port>>,
    stopwatch: Option<Stopwatch>,
    rolling: Option<(RollingFolder, RollingOf)>,
    watch: Option<Watch>,
    ends: Arc<AtomicBool>,
    start: Instant,
}

impl<'a> TwinBuilder<'a> {
    /// A twin of `robot` with the shipped networks, calibration and controller, on the virtual rig in this process.
    /// The session's time begins now.
    pub fn new(robot: &'a RobotSpec) -> Self {
        #[expect(
            clippy::disallowed_methods,
            reason = "whoever builds a twin owns the time of its session"
        )]
        let start = Instant::now();
        Self {
            robot,
            robot_file: None,
            rig: DEFAULT_RIG,
            options: rig_options(0.0, 1),
            maps: None,
            gains: Gains::of(ControllerKind::default()),
            instruments: Instruments::default(),
            calibration: None,
            script: None,
            port: None,
            stopwatch: None,
            rolling: None,
            watch: None,
            ends: Arc::default(),
            start,
        }
    }

    /// The file that the robot came from: a rig in a process of its own reads it, too. With `None` that rig takes the
    /// shipped robot.
    pub fn robot_file(mut self, file: Option<&'a Path>) -> Self {
        self.robot_file = file;
        self
    }

    /// The rig: `sim`, `pty`, or serial ports; `options` are those of a virtual one.
    pub fn rig(mut self, rig: &'a str, options: RigOptions) -> Self {
        (self.rig, self.options) = (rig, options);
        self
    }

    /// Networks in place of the shipped ones.
    pub fn maps(mut self, maps: Maps) -> Self {
        self.maps = Some(maps);
        self
    }

    /// The controller's tuning.
    pub fn gains(mut self, gains: Gains) -> Self {
        self.gains = gains;
        self
    }

    /// A calibration in place of the one that the instruments name.
    pub fn calibration(mut self, calibration: Calibration) -> Self {
        self.calibration = Some(calibration);
        self
    }

    /// Calibration and motion capture.
    pub fn instruments(mut self, instruments: Instruments) -> Self {
        self.instruments = instruments;
        self
    }

    /// What happens to a virtual rig in this process; `None`: nothing.
    pub fn script(mut self, script: Option<Script>) -> Self {
        self.script = script;
        self
    }

    /// A port in place of the one that the rig's name stands for. One on the host's clock was opened at
    /// [`Self::start`].
    pub fn port(mut self, port: Box<dyn Port>) -> Self {
        self.port = Some(port);
        self
    }

    /// Times the controller; the figures decide nothing.
    pub fn timed(mut self) -> Self {
        self.stopwatch = Some(stopwatch);
        self
    }

    /// Keeps a rolling recording of some arms in a folder, from Arm on; with `None` as the folder none.
    pub fn rolling(mut self, folder: Option<RollingFolder>, of: RollingOf) -> Self {
        self.rolling = folder.map(|folder| (folder, of));
        self
    }

    /// Compares the arm with its commissioned twin; `None`: not.
    pub fn watch(mut self, watch: Option<Watch>) -> Self {
        self.watch = watch;
        self
    }

    /// Ends every run once this is set: the boards are stopped, and recordings are completed.
    pub fn ends_with(mut self, ended: Arc<AtomicBool>) -> Self {
        self.ends = ended;
        self
    }

    /// When the session's time began.
    pub fn start(&self) -> Instant {
        self.start
    }

    /// Opens the port and puts the twin on it. Nothing moves.
    ///
    /// # Errors
    /// When networks or calibration cannot be read, or the port cannot be opened.
    pub fn build(self) -> Result<Driver> {
        let robot = self.robot;
        if let Some(why) = robot.why_not_driven() {
            anyhow::bail!(why);
        }
        let maps = match self.maps {
            Some(maps) => maps,
            None => model::maps_for(robot, self.rig, self.instruments.networks.as_deref())?,
        };
        let sensing = match &self.calibration {
            Some(calibration) => maps.sensing(robot, calibration),
            None => {
                let file = self.instruments.calibration.as_deref();
                maps.sensing(robot, &model::calibration(file)?)
            }
        };
        let mut twin = Twin::new(robot, maps.clone(), sensing, self.gains);
        if let Some(stopwatch) = self.stopwatch {
            twin.time_with(stopwatch);
        }
        if self.instruments.accept_virtual_calibration {
            twin.accept_virtual_calibration();
        }
        if self.instruments.accept_simulated_boards {
            twin.accept_simulated_boards();
        }
        if self.instruments.expect_pushes {
            twin.expect_pushes();
        }
        let port = match self.port {
            Some(port) => port,
            None => ports::open(
                self.rig,
                &self.options,
                self.robot_file,
                robot,
                self.start,
                &self.instruments,
                self.script,
            )?,
        };
        let mut runner = Runner::new(twin, port, robot);
        if let Some(file) = &self.instruments.registration {
            runner.register(read_toml(file)?);
        }
        if let Some((folder, of)) = self.rolling {
            runner.keep_rolling(folder, of);
        }
        if let Some(watch) = self.watch {
            runner.watch(watch);
        }
        Ok(Driver {
            runner,
            maps,
            ends: self.ends,
            start: self.start,
        })
    }
}

/// Time since the first call: the stopwatch that is handed to the controller.
#[expect(
    clippy::disallowed_methods,
    reason = "a stopwatch that is handed to the controller and decides nothing"
)]
pub fn stopwatch() -> Duration {
    static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    START.get_or_init(Instant::now).elapsed()
}

/// Looks at every tick of a run.
pub trait Observer {
    /// Takes a snapshot and what happened; may add commands for the next tick, or end the run.
    fn observe(
        &mut self,
        snapshot: &Arc<Snapshot>,
        events: &[Event],
        commands: &mut Vec<Command>,
    ) -> ControlFlow<()>;
}

impl<F> Observer for F
where
    F: FnMut(&Arc<Snapshot>, &[Event], &mut Vec<Command>) -> ControlFlow<()>,
{
    fn observe(
        &mut self,
        snapshot: &Arc<Snapshot>,
        events: &[Event],
        commands: &mut Vec<Command>,
    ) -> ControlFlow<()> {
        self(snapshot, events, commands)
    }
}

/// What was under way when a run ended.
pub struct Ended {
    /// How recording and stream ended.
    pub events: Vec<Event>,
    /// The live stream as it was; `None` if there was none.
    pub stream: Option<StreamStatus>,
}

/// A twin on a rig.
pub struct Driver {
    /// The twin with its port and its recorder.
    pub runner: Runner,
    pub(super) maps: Maps,
    ends: Arc<AtomicBool>,
    start: Instant,
}

impl Driver {
    /// Whether this program was asked to end meanwhile.
    pub fn was_ended(&self) -> bool {
        self.ends.load(Ordering::Relaxed)
    }

    /// Ticks until an observer ends the run: as fast as it goes where the rig lives on simulated time, else on the
    /// host's clock. All observers see every tick, in order.
    pub fn run(&mut self, observers: &mut [&mut dyn Observer]) -> Pace {
        let ends = Arc::clone(&self.ends);
        let each = |snapshot: &Arc<Snapshot>, events: &[Event], commands: &mut Vec<Command>| {
            let mut flow = ControlFlow::Continue(());
            if ends.load(Ordering::Relaxed) {
                flow = ControlFlow::Break(());
            }
            for observer in observers.iter_mut() {
                if observer.observe(snapshot, events, commands).is_break() {
                    flow = ControlFlow::Break(());
                }
            }
            flow
        };
        match self.runner.clock() {
            Clock::Lockstep => run_in_simulated_time(&mut self.runner, each),
            Clock::Host => run_in_real_time(&mut self.runner, self.start, each),
        }
    }

    /// Stops the boards and lets the port go, then ends recording and stream at `end`, the time of the last tick. Waits
    /// for the disk, and a moment for the viewer.
    pub fn finish(mut self, end: Stamp) -> Ended {
        self.runner.let_port_go();
        let mut events = Vec::new();
        self.runner.stop_recording(end, &mut events);
        let stream = self.runner.stop_stream(end, LAST_WORDS, &mut events);
        for event in &events {
            log::info!("{}", event.text());
        }
        Ended { events, stream }
    }

    /// Starts the twin's own thread; see [`spawn_until`]. It ends with the handle, or when the program is asked to end.
    ///
    /// # Errors
    /// When the thread cannot be started.
    pub fn spawn(
        self,
        first: Vec<Command>,
        repaint: impl FnMut(&Snapshot) + Send + 'static,
    ) -> std::io::Result<(Handle, JoinHandle<()>)> {
        spawn_until(self.ends, self.runner, self.start, first, repaint)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::RollingStatus;

    #[test]
    fn all_observers_see_every_tick_until_one_ends_the_run() {
        let robot = RobotSpec::reference();
        let mut driver = TwinBuilder::new(&robot).build().expect("a twin");
        assert_eq!(driver.runner.clock(), Clock::Lockstep);
        let (mut first, mut second) = (Vec::new(), Vec::new());
        let mut ends = |snapshot: &Arc<Snapshot>, _: &[Event], commands: &mut Vec<Command>| {
            first.push(snapshot.stamp);
            match first.len() {
                5 => commands.push(Command::DeclarePayload(0.1)),
                20 => return ControlFlow::Break(()),
                _ => {}
            }
            ControlFlow::Continue(())
        };
        let mut watches = |snapshot: &Arc<Snapshot>, _: &[Event], _: &mut Vec<Command>| {
            second.push((snapshot.stamp, snapshot.payload_kg));
            ControlFlow::Continue(())
        };
        let pace = driver.run(&mut [&mut ends, &mut watches]);
        assert_eq!((pace.ticks, pace.missed), (20, 0));
        assert!(first.iter().eq(second.iter().map(|(stamp, _)| stamp)));
        // A command takes effect in the next tick.
        assert_eq!((second[4].1, second[5].1), (0.0, 0.1));
        let end = driver.finish(first[19]);
        assert!(end.events.is_empty() && end.stream.is_none());
    }

    /// Ticks a twin on the virtual rig with a rolling recording of some arms in `folder`: it is armed at 1.5 s, marked at
    /// 4 s, disarmed at 5 s, armed again at 80 s. The states of the rolling recording at some times.
    fn rolls(folder: &Path, of: RollingOf, commands: &[Command]) -> Vec<RollingStatus> {
        let robot = RobotSpec::reference();
        // How full the disk of the tests is has no say.
        let mut rolling = RollingFolder::of(folder.to_owned());
        rolling.least_free_bytes = 0;
        let twin = TwinBuilder::new(&robot).rolling(Some(rolling), of);
        let mut driver = twin.build().expect("a twin");
        let mut states = Vec::new();
        let mut end = Stamp::ZERO;
        let mut observe = |s: &Arc<Snapshot>, _: &[Event], out: &mut Vec<Command>| {
            end = s.stamp;
            let tick = (s.stamp.seconds() * 100.0).round() as u64;
            if (150..400).contains(&tick) && s.rolling == RollingStatus::Waits {
                // Its file is made beside simulated time.
                std::thread::sleep(Duration::from_millis(10));
            }
            match tick {
                100 => out.extend_from_slice(commands),
                150 | 8000 => out.push(Command::Arm),
                400 => out.push(Command::Mark("slipped".into())),
                500 => out.push(Command::Disarm),
                _ => {}
            }
            if [140, 450, 6400, 6600, 8100].contains(&tick) {
                states.push(s.rolling.clone());
            }
            match tick < 8100 {
                true => ControlFlow::Continue(()),
                false => ControlFlow::Break(()),
            }
        };
        driver.run(&mut [&mut observe]);
        driver.finish(end);
        states
    }

    #[cfg(feature = "rrd")]
    #[test]
    fn a_rolling_recording_begins_with_arm_and_pauses_a_minute_after_the_arm_is_disarmed() {
        let name = format!("springtwin-driver-rolls-{}", std::process::id());
        let home = std::env::temp_dir().join(name);
        let (folder, wanted) = (home.join("rolling"), home.join("wanted.rrd"));
        std::fs::create_dir_all(&home).expect("a folder");
        let records = [Command::StartRecording(wanted.clone())];
        let states = rolls(&folder, RollingOf::EveryArm, &records);
        let RollingStatus::Records(first) = &states[1] else {
            panic!("{states:?}");
        };
        let (records, paused) = (
            RollingStatus::Records(Arc::clone(first)),
            RollingStatus::Paused(Arc::clone(first)),
        );
        assert_eq!(
            states,
            [
                RollingStatus::Waits,
                records.clone(),
                records.clone(),
                paused,
                records
            ]
        );
        let read = |path: &Path| crate::recording::read_rrd(path).expect("a recording");
        let (rolled, wanted) = (read(first), read(&wanted));
        assert!(rolled.complete && wanted.complete);
        let stamps = rolled.trace.snapshots.iter().map(|s| s.stamp.seconds());
        let stamps: Vec<f64> = stamps.collect();
        // From Arm to a minute after Disarm, and from the next Arm on.
        assert!((1.5..1.6).contains(&stamps[0]), "{}", stamps[0]);
        assert!(!stamps.iter().any(|t| (65.2..80.0).contains(t)));
        assert!(stamps.iter().any(|t| *t > 80.5));
        for recording in [&rolled, &wanted] {
            let mut marks = recording.events.iter().filter(|e| e.log == "marks");
            assert!(marks.any(|e| e.text == "slipped"));
        }
        assert!(rolled.meta.name.starts_with("rolling ") && rolled.meta.robot == "reference");
        std::fs::remove_dir_all(home).expect("removed");
    }

    #[test]
    fn a_simulated_arm_has_no_rolling_recording_where_only_hardware_has() {
        let name = format!("springtwin-driver-rolls-not-{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        let states = rolls(&folder, RollingOf::Hardware, &[]);
        assert!(
            states.iter().all(|s| *s == RollingStatus::Off),
            "{states:?}"
        );
        assert!(!folder.exists());
    }

    /// The window's twin: its thread ends although the window still holds it.
    #[test]
    fn a_twin_with_a_window_ends_with_the_program_and_completes_its_recording() {
        let name = format!("springtwin-driver-ends-{}.rrd", std::process::id());
        let path = std::env::temp_dir().join(name);
        let robot = RobotSpec::reference();
        let ends = Arc::new(AtomicBool::new(false));
        let twin = TwinBuilder::new(&robot).ends_with(Arc::clone(&ends));
        let driver = twin.build().expect("a twin");
        let (handle, thread) = driver.spawn(Vec::new(), |_| {}).expect("a thread");
        let wait_until = |what: &str, is: &dyn Fn() -> bool| {
            let is_so = (0..6000).any(|_| {
                std::thread::sleep(Duration::from_millis(10));
                is()
            });
            assert!(is_so, "{what}");
        };
        handle
            .send(Command::StartRecording(path.clone()))
            .expect("a free place");
        wait_until("it records", &|| handle.snapshot().recording.is_some());
        ends.store(true, Ordering::Relaxed);
        wait_until("it ends", &|| thread.is_finished());
        thread.join().expect("no panic");
        let read = crate::recording::read_rrd(&path).expect("a recording");
        std::fs::remove_file(&path).expect("removed");
        assert!(read.complete, "cut off at {:?}", read.recovered_until);
    }
}
