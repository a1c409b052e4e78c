//! What the window's twin can be put on.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::Result;

use super::baselines::{BASELINES, baseline_file, virtual_baseline_file};
use super::calibrate::Setting;
use crate::cli::args::{Kind, watch};
use crate::cli::user::ROLLING;
use springtwin::calibrate::Store;
use springtwin::drive::{DEFAULT_RIG, Driver, Instruments, TwinBuilder, is_virtual, model};
use springtwin::gui::services::PortEntry;
use springtwin::gui::services::gap::Arm;
use springtwin::lab::virtual_baseline;
use springtwin::link;
use springtwin::recording::RollingFolder;
use springtwin::rig::RigOptions;
use springtwin::robot::RobotSpec;
use springtwin::sensing::Calibration;
use springtwin::sensing::registration::Registration;
use springtwin::signal::{Mode, Snapshot};
use springtwin::twin::{Command, Handle, Maps, RollingOf, Watch};

/// A port that was just let go may be held for a moment: so often it is tried, and so long apart.
const TRIES: usize = 5;
const BETWEEN: Duration = Duration::from_millis(100);

/// Between two looks at twins that end.
const LOOK: Duration = Duration::from_millis(10);

/// A drill that stalls the control loop does so after so much motion, s.
const STALL_AFTER_S: f64 = 1.0;

/// The threads of the twins that were started.
#[derive(Clone, Default)]
pub struct Twins(Arc<Mutex<Vec<JoinHandle<()>>>>);

impl Twins {
    fn add(&self, thread: JoinHandle<()>) {
        let mut threads = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        threads.retain(|t| !t.is_finished());
        threads.push(thread);
    }

    /// Waits until all have ended, for `patience` at most; whether they have. Their handles must be dropped.
    pub fn wait(&self, patience: Duration) -> bool {
        let threads = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut waited = Duration::ZERO;
        while threads.iter().any(|t| !t.is_finished()) {
            if waited >= patience {
                return false;
            }
            std::thread::sleep(LOOK);
            waited += LOOK;
        }
        true
    }
}

/// What every twin of this window has in common.
#[derive(Clone)]
pub struct Rigs {
    /// The rig that was named at the start.
    pub rig: String,
    pub robot: RobotSpec,
    pub robot_file: Option<PathBuf>,
    pub maps: Maps,
    pub options: RigOptions,
    pub kind: Kind,
    pub instruments: Instruments,
    /// The commissioned rig that the arm is compared with, if one was named.
    pub baseline: Option<PathBuf>,
    /// Where the user's data are; without it no saved calibration is looked for.
    pub data: Option<PathBuf>,
    pub twins: Twins,
    /// Ends every twin once it is set.
    pub ends: Arc<AtomicBool>,
    /// For how long the control loop stands still on purpose, once the arm moves.
    pub stall: Option<Duration>,
}

impl Rigs {
    /// The networks for a twin on `rig`: those of its instruments, else those of the rig that was named where both are virtual,
    /// or neither.
    fn maps(&self, rig: &str, instruments: &Instruments) -> Result<Maps> {
        let of_named = is_virtual(rig) == is_virtual(&self.rig);
        match &instruments.networks {
            saved if of_named && *saved == self.instruments.networks => Ok(self.maps.clone()),
            saved => model::maps_for(&self.robot, rig, saved.as_deref()),
        }
    }

    /// A twin on `rig`. Nothing moves.
    pub fn driver(&self, rig: &str) -> Result<Driver> {
        let (_, instruments, trouble) = self.with_active(rig);
        let maps = self.maps(rig, &instruments)?;
        let mut driver = TwinBuilder::new(&self.robot)
            .robot_file(self.robot_file.as_deref())
            .rig(rig, self.options.clone())
            .maps(maps)
            .gains(self.kind.gains())
            .instruments(instruments)
            .rolling(self.rolling(), RollingOf::EveryArm)
            .watch(self.watch(rig)?)
            .ends_with(Arc::clone(&self.ends))
            .build()?;
        if let Some(why) = trouble {
            driver.runner.twin.explain_calibration(why);
        }
        Ok(driver)
    }

    /// The monitor of `rig`: with the baseline that was named for it, or that is kept for the arm, or that ships with the program.
    fn watch(&self, rig: &str) -> Result<Option<Watch>> {
        if let Some(named) = self.baseline.as_deref().filter(|_| rig == self.rig) {
            return watch(named, &self.robot).map(Some);
        }
        let calibration = self.calibration_of(rig)?;
        let arm = if is_virtual(rig) {
            Arm::Virtual
        } else {
            Arm::Real
        };
        let kept = self.data.as_deref();
        let kept = kept.map(|data| self.kept_for(arm, &calibration, data));
        let kept = kept.filter(|file| file.is_file()).and_then(|file| {
            let read = watch(&file, &self.robot);
            read.inspect_err(|e| log::warn!("{} is not compared with: {e:#}", file.display()))
                .ok()
        });
        if kept.is_some() || arm == Arm::Real {
            return Ok(kept);
        }
        // Without it everything else works.
        let shipped = virtual_baseline::watch(&self.robot, &self.options, &calibration);
        Ok(shipped.unwrap_or_else(|e| {
            log::warn!("twin and arm are not compared: {e:#}");
            None
        }))
    }

    /// The calibration that `rig` is read by.
    fn calibration_of(&self, rig: &str) -> Result<Calibration> {
        let (_, instruments, _) = self.with_active(rig);
        model::calibration(instruments.calibration.as_deref())
    }

    /// Where the baseline of an arm is kept in the user's `data`. Of a virtual rig there is one for each unit and calibration.
    fn kept_for(&self, arm: Arm, calibration: &Calibration, data: &Path) -> PathBuf {
        match arm {
            Arm::Real => baseline_file(data, &self.robot),
            Arm::Virtual => {
                virtual_baseline_file(data, &self.robot, self.options.unit, calibration)
            }
        }
    }

    /// The baseline of the arm that the window is on, as a file: what was named for it, what is kept in `data`, or what ships with the
    /// program; `None` where there is none.
    pub fn baseline_of(&self, arm: Arm, data: &Path) -> Result<Option<PathBuf>> {
        let named_is_virtual = is_virtual(&self.rig);
        let is_named = named_is_virtual == (arm == Arm::Virtual);
        if let Some(named) = self.baseline.as_ref().filter(|_| is_named) {
            return Ok(Some(named.clone()));
        }
        let kept = self.place_of(arm, data)?;
        if kept.is_file() {
            return Ok(Some(kept));
        }
        let calibration = self.calibration_of(self.one(arm))?;
        let ships = arm == Arm::Virtual
            && virtual_baseline::is_of(&self.robot, &self.options, &calibration);
        match ships {
            true => virtual_baseline::shipped_file(&data.join(BASELINES)).map(Some),
            false => Ok(None),
        }
    }

    /// Where a new baseline of an arm goes in the user's `data`.
    pub fn place_of(&self, arm: Arm, data: &Path) -> Result<PathBuf> {
        let calibration = self.calibration_of(self.one(arm))?;
        Ok(self.kept_for(arm, &calibration, data))
    }

    /// A rig of this kind: the one that was named, where it is one.
    fn one(&self, arm: Arm) -> &str {
        match (arm, is_virtual(&self.rig)) {
            (Arm::Virtual, false) => DEFAULT_RIG,
            _ => &self.rig,
        }
    }

    /// Where rolling recordings go.
    pub fn rolling(&self) -> Option<RollingFolder> {
        let data = self.data.as_deref();
        data.map(|data| RollingFolder::of(data.join(ROLLING)))
    }

    /// Where calibrations of `rig` are kept, and its instruments with the calibration that was saved last
    /// in the window, where none is named; and why the active one is not used, if so.
    fn with_active(&self, rig: &str) -> (Option<Store>, Instruments, Option<String>) {
        let is_virtual = is_virtual(rig);
        let data = self.data.as_deref();
        let store = data.map(|data| Store::of(&self.robot, is_virtual, data));
        // What was named belongs to the rig that was named.
        let named = match rig == self.rig {
            true => self.instruments.clone(),
            false if is_virtual => Instruments {
                expect_pushes: self.instruments.expect_pushes,
                ..Instruments::default()
            },
            false => {
                let mut other = self.instruments.clone();
                other.calibration = None;
                other.accept_virtual_calibration = false;
                other.accept_simulated_boards = false;
                other.expect_pushes = false;
                other
            }
        };
        let (out, trouble) = match &store {
            Some(store) => store.complete(named, is_virtual),
            None => (named, None),
        };
        (store, out, trouble)
    }

    /// What the wizard needs to know of `rig`, and where motion capture lies on it.
    pub fn belongings(&self, rig: &str) -> Result<(Setting, Option<Registration>)> {
        let (store, instruments, _) = self.with_active(rig);
        let registration = instruments.registration()?;
        let setting = Setting {
            robot: self.robot.clone(),
            maps: self.maps(rig, &instruments)?,
            in_use: model::calibration(instruments.calibration.as_deref())?,
            registration: registration.clone(),
            store,
            unit: is_virtual(rig).then_some(self.options.unit),
            networks: instruments.networks,
        };
        Ok((setting, registration))
    }

    /// The first commands of a twin on `rig`: what hangs in the gripper of an emulated arm.
    fn declared(&self, rig: &str) -> Vec<Command> {
        let payload_kg = self.options.surroundings.payload_kg;
        let declared = Command::DeclarePayload(payload_kg);
        is_virtual(rig).then_some(declared).into_iter().collect()
    }

    /// Starts the thread of a twin on `rig`, which [`Twins::wait`] waits for. Nothing moves.
    pub fn start(
        &self,
        rig: &str,
        driver: Driver,
        mut repaint: impl FnMut() + Send + 'static,
    ) -> std::io::Result<Handle> {
        let mut stall = self.stall;
        let mut moves_since = None;
        let seen = move |snapshot: &Snapshot| {
            if matches!(snapshot.mode, Mode::Moving) {
                let since = *moves_since.get_or_insert(snapshot.stamp);
                if snapshot.stamp.since(since) > STALL_AFTER_S
                    && let Some(stall) = stall.take()
                {
                    std::thread::sleep(stall);
                }
            }
            repaint();
        };
        let (handle, thread) = driver.spawn(self.declared(rig), seen)?;
        self.twins.add(thread);
        Ok(handle)
    }

    /// Starts a twin on `rig`. Nothing moves.
    pub fn connect(
        &self,
        rig: &str,
        repaint: impl FnMut() + Send + 'static,
    ) -> Result<Handle, String> {
        let mut tried = 1;
        let made = loop {
            std::thread::sleep(BETWEEN);
            match self.driver(rig) {
                Ok(made) => break made,
                Err(e) if tried == TRIES => {
                    return Err(format!(
                        "Not connected to {rig}: {e:#}. Nothing is connected now: choose again."
                    ));
                }
                Err(_) => tried += 1,
            }
        };
        self.start(rig, made, repaint)
            .map_err(|e| format!("Cannot start the twin's thread: {e}."))
    }
}

/// The serial ports there are.
pub fn serial_ports() -> Result<Vec<PortEntry>, String> {
    let found =
        link::ports::list().map_err(|e| format!("The system does not list its ports: {e}"))?;
    let entry = |p: link::ports::PortInfo| PortEntry {
        name: p.name,
        what: p.what,
    };
    Ok(found.into_iter().map(entry).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use springtwin::calibrate::NewVersion;
    use springtwin::drive::rig_options;
    use springtwin::gui::panels::connect::VIRTUAL;
    use springtwin::rig::Unit;
    use springtwin::robot::REFERENCE;
    use springtwin::signal::{Mode, SPRINGS, SensorRef};
    use springtwin::twin::Clock;

    /// A window's rigs as without options.
    fn rigs_on(rig: &str, robot: RobotSpec, data: &Path) -> Rigs {
        Rigs {
            rig: rig.into(),
            maps: model::maps_for(&robot, DEFAULT_RIG, None).expect("the shipped networks load"),
            robot,
            robot_file: None,
            options: rig_options(0.0, 1),
            kind: Kind::Ours,
            instruments: Instruments::default(),
            baseline: None,
            data: Some(data.to_owned()),
            twins: Twins::default(),
            ends: Arc::default(),
            stall: None,
        }
    }

    #[test]
    fn a_damaged_active_version_gives_way_to_the_last_good_one_and_pictures_look_at_none() {
        let name = format!("springtwin-rigs-{}", std::process::id());
        let data = std::env::temp_dir().join(name);
        let robot = RobotSpec::reference();
        let store = Store::of(&robot, true, &data);
        let saved = |name: &str| NewVersion {
            note: String::new(),
            calibration: Calibration {
                name: name.into(),
                ..Calibration::virtual_rig()
            },
            registration: None,
            networks: None,
        };
        store.save(saved("first"), "2026-03-01").expect("saves");
        store.save(saved("second"), "2026-03-02").expect("saves");
        let mut rigs = rigs_on("sim", robot, &data);
        let in_use = |rigs: &Rigs| rigs.belongings("sim").expect("starts").0.in_use.name;
        assert_eq!(in_use(&rigs), "second");
        let files = store.active().expect("reads").expect("is there");
        std::fs::write(files.calibration, "name = 3").expect("writes");
        assert_eq!(in_use(&rigs), "first");
        let files = store.last_good().expect("the first one");
        std::fs::write(files.calibration, "").expect("writes");
        assert_eq!(store.last_good(), None);
        assert_eq!(in_use(&rigs), Calibration::virtual_rig().name);
        rigs.data = None;
        assert!(rigs.belongings("sim").expect("starts").0.store.is_none());
        std::fs::remove_dir_all(data).expect("cleans up");
    }

    #[test]
    fn a_list_that_cannot_be_read_is_named_where_hardware_refuses_to_be_armed() {
        let name = format!("springtwin-rigs-newer-{}", std::process::id());
        let data = std::env::temp_dir().join(name);
        let robot = RobotSpec::reference();
        let store = Store::of(&robot, false, &data);
        let new = NewVersion {
            note: String::new(),
            calibration: Calibration::virtual_rig(),
            registration: None,
            networks: None,
        };
        store.save(new, "2026-03-01").expect("saves");
        let files = store.active().expect("reads").expect("is there");
        let list = files.calibration.with_file_name("versions.toml");
        std::fs::write(&list, "format = 9\n").expect("writes");
        let mut rigs = rigs_on("/dev/ttyUSB0", robot, &data);
        rigs.instruments.accept_virtual_calibration = true;
        let (_, instruments, trouble) = rigs.with_active("/dev/ttyUSB0");
        assert!(instruments.calibration.is_none() && instruments.accept_virtual_calibration);
        assert!(trouble.is_some_and(|t| t.contains("newer springtwin")));
        std::fs::write(&list, "active = \n").expect("writes");
        let (_, instruments, trouble) = rigs.with_active("/dev/ttyUSB0");
        assert!(instruments.calibration.is_none());
        assert!(trouble.is_some_and(|t| t.contains("is damaged") && !t.contains('\n')));
        // The word was given for the rig that was named.
        let (_, elsewhere, _) = rigs.with_active("/dev/ttyUSB1");
        assert!(!elsewhere.accept_virtual_calibration);
        rigs.instruments.expect_pushes = true;
        assert!(rigs.with_active("/dev/ttyUSB0").1.expect_pushes);
        assert!(!rigs.with_active("/dev/ttyUSB1").1.expect_pushes);
        std::fs::remove_dir_all(data).expect("cleans up");
    }

    /// The window's first start: nothing was kept, and twin and arm are compared.
    #[test]
    fn a_fresh_start_on_the_virtual_rig_has_a_baseline_and_no_other_rig_has_it() {
        let name = format!("springtwin-rigs-baseline-{}", std::process::id());
        let data = std::env::temp_dir().join(name);
        let robot = RobotSpec::reference();
        let fresh = rigs_on(DEFAULT_RIG, robot, &data);
        let watched = |rigs: &Rigs, rig: &str| rigs.watch(rig).expect("reads").is_some();
        assert!(watched(&fresh, "sim") && watched(&fresh, "pty"));
        assert!(!watched(&fresh, "/dev/ttyUSB0"));
        // Gap has it as a file.
        let file = fresh.baseline_of(Arm::Virtual, &data).expect("writes");
        let file = file.expect("ships");
        assert!(file.starts_with(&data) && file.is_file());
        assert_eq!(fresh.baseline_of(Arm::Real, &data).expect("looks"), None);
        let other_unit = Rigs {
            options: RigOptions {
                unit: Unit(2),
                ..rig_options(0.0, 1)
            },
            ..fresh.clone()
        };
        let longer = REFERENCE.replace("rest_length_mm = 145.0", "rest_length_mm = 146.0");
        let other_robot = Rigs {
            robot: RobotSpec::from_toml(&longer).expect("reads"),
            ..fresh.clone()
        };
        for other in [&other_unit, &other_robot] {
            assert!(!watched(other, "sim"));
            assert_eq!(other.baseline_of(Arm::Virtual, &data).expect("looks"), None);
        }
        // What is kept of the virtual rig goes before it, and is of this unit alone.
        let kept = fresh.place_of(Arm::Virtual, &data).expect("a place");
        assert_ne!(
            kept,
            other_unit.place_of(Arm::Virtual, &data).expect("a place")
        );
        assert_ne!(kept, fresh.place_of(Arm::Real, &data).expect("a place"));
        std::fs::copy(&file, &kept).expect("copies");
        assert_eq!(
            fresh.baseline_of(Arm::Virtual, &data).expect("looks"),
            Some(kept)
        );
        assert!(!watched(&other_unit, "sim") && !watched(&fresh, "/dev/ttyUSB0"));
        // Another calibration reads it otherwise.
        let store = Store::of(&fresh.robot, true, &data);
        let mut calibration = Calibration::virtual_rig();
        calibration.base_tilt_rad[0] += 1e-3;
        let new = NewVersion {
            note: String::new(),
            calibration,
            registration: None,
            networks: None,
        };
        store.save(new, "2026-03-01").expect("saves");
        assert!(!watched(&fresh, "sim"));
        assert_eq!(fresh.baseline_of(Arm::Virtual, &data).expect("looks"), None);
        std::fs::remove_dir_all(data).expect("cleans up");
    }

    #[test]
    fn a_virtual_rig_rests_when_it_is_connected_to_and_declares_its_payload() {
        let robot = RobotSpec::reference();
        let rigs = Rigs {
            rig: "sim".to_owned(),
            maps: model::maps_for(&robot, DEFAULT_RIG, None).expect("the networks"),
            robot,
            robot_file: None,
            options: rig_options(0.15, 1),
            kind: Kind::Ours,
            instruments: Instruments::default(),
            baseline: None,
            data: None,
            twins: Twins::default(),
            ends: Arc::default(),
            stall: None,
        };
        assert_eq!(rigs.declared("/dev/ttyUSB0"), []);
        // Hardware is not read by the networks of the virtual rig's unit.
        let at_rest = SensorRef::from_fn(|i, _| if i < SPRINGS { 0.15 } else { 0.0 });
        let pose = |rig: &str| {
            rigs.maps(rig, &Instruments::default())
                .expect("the networks")
                .pose
                .pose(&at_rest)
                .pose
        };
        assert_eq!(pose("pty"), pose("sim"));
        assert_ne!(pose("/dev/ttyUSB0"), pose("sim"));
        // What the window opens on, and what its menu offers first, is in step with the twin.
        assert_eq!(DEFAULT_RIG, VIRTUAL[0].0);
        let driver = rigs.driver(DEFAULT_RIG).expect("the virtual rig");
        assert_eq!(driver.runner.clock(), Clock::Lockstep);
        let handle = rigs.connect(DEFAULT_RIG, || {}).expect("the virtual rig");
        let mut looks = 0;
        while handle.snapshot().payload_kg != 0.15 {
            looks += 1;
            assert!(looks < 6000, "{:?}", handle.snapshot().payload_kg);
            std::thread::sleep(LOOK);
        }
        assert!(!rigs.twins.wait(Duration::ZERO), "it runs");
        // At rest, and nothing drives it: for longer than the filters take to settle.
        let (mut ticks, mut tip_m) = (0, None);
        while ticks < 300 {
            let snapshot = handle.feed.recv_timeout(Duration::from_secs(60));
            let snapshot = snapshot.expect("it ticks");
            ticks += 1;
            assert_eq!(snapshot.mode, Mode::Disarmed, "at tick {ticks}");
            assert_eq!((&snapshot.goal, &snapshot.command), (&None, &None));
            if let Some(truth) = &snapshot.truth {
                let tip = truth.base_from_tip.translation.vector;
                let from = *tip_m.get_or_insert(tip);
                assert!((tip - from).norm() < 1e-3, "it has moved by tick {ticks}");
            }
        }
        assert!(tip_m.is_some(), "motion capture sees it");
        drop(handle);
        assert!(rigs.twins.wait(Duration::from_secs(60)));
    }
}
