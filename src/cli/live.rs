//! `run`, `rig`, `record`: commands with a rig at the other end.

mod report;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
#[cfg(unix)]
use std::sync::atomic::Ordering;

use anyhow::{Context as _, Result};
use clap::{Args, ValueEnum};

use super::args::{self, InstrumentArgs, Kind, MonitorArgs, RollingArgs};
use super::outputs::Overwrite;
use super::{Failed, Report, user};
use springtwin::drive::{self, DEFAULT_RIG, Run, TwinBuilder, objects, rig_options};
use springtwin::rig::clock::Clock;
#[cfg(unix)]
use springtwin::rig::faults::Script;
use springtwin::rig::hidden::Hidden;
use springtwin::rig::inertial::InertialErrors;
use springtwin::rig::pty::{Lines, Pty};
use springtwin::rig::{Obstacle, RigOptions, Unit, VirtualRig};
use springtwin::robot::RobotSpec;
use springtwin::signal::{BOARDS, Goal};
use springtwin::task::Item;

#[derive(Args)]
pub struct RunArgs {
    /// Run without a window
    #[arg(long)]
    pub headless: bool,
    /// How long, s
    #[arg(long, value_name = "S", default_value = "60", value_parser = args::not_negative, requires = "headless")]
    pub seconds: f64,
    /// Where the boards are: `sim` (in this process, simulated time), `pty` (a rig process behind a
    /// pseudo-terminal), or a serial port
    #[arg(long, value_name = "sim|pty|PORT[,PORT]", default_value = DEFAULT_RIG)]
    pub rig: String,
    /// Record to this file
    #[arg(long, value_name = "F.rrd", requires = "headless")]
    pub record: Option<PathBuf>,
    /// The operator's note on the recording
    #[arg(long, value_name = "TEXT", requires = "record")]
    pub note: Option<String>,
    #[command(flatten)]
    pub overwrite: Overwrite,
    /// Stream to the Rerun viewer that listens there on this machine (start it with
    /// `rerun --bind 127.0.0.1`); 127.0.0.1:9876 without an address
    #[arg(long, value_name = "IP:PORT", value_parser = args::viewer, num_args = 0..=1, default_missing_value = "127.0.0.1:9876")]
    pub stream: Option<SocketAddr>,
    /// As --stream, to another machine; anyone on the way can read it
    #[arg(long, value_name = "IP:PORT", conflicts_with = "stream")]
    pub stream_remote: Option<SocketAddr>,
    /// Steer the tip there, mm
    #[arg(long, value_name = "X,Y,Z", value_parser = args::xyz_mm, allow_hyphen_values = true, requires = "headless")]
    pub target: Option<[f64; 3]>,
    /// Mass in the virtual rig's gripper, kg (also declared to the twin)
    #[arg(long, value_name = "KG", default_value = "0", value_parser = args::not_negative)]
    pub payload: f64,
    /// Seed of the virtual rig's noise
    #[arg(long, value_name = "N", default_value = "1")]
    pub seed: u64,
    /// A flat thing that the virtual rig's arm cannot enter: a point on it (mm) and the direction out of it
    #[arg(long, value_name = "X,Y,Z,NX,NY,NZ", value_parser = args::obstacle, allow_hyphen_values = true)]
    pub obstacle: Option<Obstacle>,
    /// Hide an effect in the virtual rig, as `rig --hide` does; the twin does not know it
    #[arg(long, value_name = "ID[:TARGET][=VALUE,..][@S]")]
    pub hide: Vec<Hidden>,
    /// Which controller steers
    #[arg(long, value_enum, default_value_t = Kind::Ours)]
    pub controller: Kind,
    /// Let boards that are SAFE from before leave it: after an earlier program has ended or was not heard any more, and
    /// for causes that are named (such as `over-pressure`), which must be removed first
    #[arg(long, value_name = "CAUSE,...", num_args = 0..=1, value_delimiter = ',', value_parser = args::cause, requires = "headless")]
    pub reset: Option<Vec<u16>>,
    /// A fire drill: lose the window's graphics device so long after the start (`lose-gpu=S`), or let the control loop
    /// stand still for so long once the arm has moved for a second (`stall=S`)
    #[arg(long, hide = true, value_name = "lose-gpu=S|stall=S", value_parser = args::drill, conflicts_with = "headless")]
    #[cfg(feature = "gui")]
    pub drill: Vec<args::Drill>,
    #[command(flatten)]
    pub instruments: InstrumentArgs,
    #[command(flatten)]
    pub monitor: MonitorArgs,
    #[command(flatten)]
    pub rolling: RollingArgs,
}

impl RunArgs {
    /// The virtual rig.
    ///
    /// # Errors
    /// When something is to be hidden in boards that are not the virtual rig's.
    pub fn options(&self) -> Result<RigOptions> {
        args::hides_in_virtual(&self.hide, &self.rig)?;
        let mut options = rig_options(self.payload, self.seed);
        options.surroundings.obstacle = self.obstacle;
        options.hidden.clone_from(&self.hide);
        Ok(options)
    }

    /// The viewer to stream to.
    pub fn viewer(&self) -> Option<SocketAddr> {
        self.stream.or(self.stream_remote)
    }
}

#[derive(Args)]
pub struct RigArgs {
    /// Put a symbolic link to the port here; with a line for each board: PATH-1 and PATH-2
    #[arg(long, value_name = "PATH")]
    link: Option<PathBuf>,
    /// Number of serial lines: one that both boards share, or one each
    #[arg(long, value_name = "1|2", default_value = "1", value_parser = clap::value_parser!(u8).range(1..=2))]
    lines: u8,
    /// Let the boards run the real firmware in a simulator, a line for each: the folder that
    /// `make -C assets/firmware OUT="$PWD/DIR"` made
    #[arg(long, value_name = "DIR")]
    firmware: Option<PathBuf>,
    /// Mass in the gripper, kg
    #[arg(long, value_name = "KG", default_value = "0", value_parser = args::not_negative)]
    payload: f64,
    /// Seed of the noise
    #[arg(long, value_name = "N", default_value = "1")]
    seed: u64,
    /// Which manufactured arm
    #[arg(long, value_name = "N", default_value = "1")]
    unit: u64,
    /// Hide an effect: id, channel (1-based, all without it), values in SI units (usual ones without
    /// them), and when it begins (s); `springtwin rig effects` lists them
    #[arg(long, value_name = "ID[:TARGET][=VALUE,..][@S]")]
    hide: Vec<Hidden>,
    /// Frequency errors of the clocks of board 1 and board 2, ppm; without it those of the unit, within 5000
    #[arg(long, value_name = "A,B", value_parser = args::clocks_ppm, allow_hyphen_values = true)]
    clock_skew: Option<[f64; BOARDS]>,
    /// By how much these errors change in the first ten minutes, ppm; without it by 50, up or down with the unit
    #[arg(long, value_name = "A,B", value_parser = args::clocks_ppm, allow_hyphen_values = true)]
    clock_drift: Option<[f64; BOARDS]>,
    /// Errors of the IMUs: those of parts as delivered, or of parts whose offsets were removed
    #[arg(long, value_enum, default_value_t = ImuErrors::Zeroed)]
    imu_errors: ImuErrors,
    /// Send emulated motion capture to this address
    #[arg(long, value_name = "IP:PORT")]
    vicon: Option<std::net::SocketAddr>,
    /// Stiffness of the arm as a factor
    #[arg(long, value_name = "K", default_value = "1", value_parser = args::stiffness)]
    stiffness: f64,
    /// A flat thing that the arm cannot enter: a point on it (mm) and the direction out of it
    #[arg(long, value_name = "X,Y,Z,NX,NY,NZ", value_parser = args::obstacle, allow_hyphen_values = true)]
    obstacle: Option<Obstacle>,
    /// Something to pick up: where the tip grasps it (mm) and its mass (kg); may be given several times
    #[arg(long, value_name = "X,Y,Z,KG", value_parser = args::item, allow_hyphen_values = true)]
    object: Vec<Item>,
    /// Fault schedule to apply: a file with a [[fault]] for each (see the guide, "Faults")
    #[arg(long, value_name = "F.toml")]
    faults: Option<PathBuf>,
    /// End when the starting process ends
    #[arg(long, hide = true)]
    with_parent: bool,
}

/// Which errors the virtual rig's IMUs have.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum ImuErrors {
    /// Offsets and scales within the data sheet's tolerances
    Delivered,
    /// Offsets were removed
    Zeroed,
}

impl ImuErrors {
    fn errors(self) -> InertialErrors {
        match self {
            Self::Delivered => InertialErrors::as_delivered(),
            Self::Zeroed => InertialErrors::zeroed(),
        }
    }
}

impl RigArgs {
    /// Clocks of the boards: those of the unit where nothing else is given.
    fn clocks(&self, unit: Unit) -> [Clock; BOARDS] {
        let drawn = Clock::of_unit(unit.0);
        std::array::from_fn(|b| Clock {
            skew: self.clock_skew.map_or(drawn[b].skew, |all| all[b]),
            drift: self.clock_drift.map_or(drawn[b].drift, |all| all[b]),
        })
    }
}

/// `run --headless`.
pub fn run(a: &RunArgs, robot_file: Option<&Path>, robot: &RobotSpec) -> Result<Report> {
    args::payload_in_range(robot, a.payload)?;
    if let Some(file) = &a.record {
        a.overwrite.file(file)?;
    }
    let twin = TwinBuilder::new(robot)
        .robot_file(robot_file)
        .rig(&a.rig, a.options()?)
        .gains(a.controller.gains())
        .instruments(a.instruments.of_arm(robot, &a.rig))
        .rolling(user::rolling_folder(), a.rolling.of())
        .watch(a.monitor.watch(robot)?)
        .ends_with(super::signals::asked_to_end()?);
    carry_out(
        twin,
        &Run {
            seconds: a.seconds,
            declared_kg: a.payload,
            target: a.target.map(Goal::position),
            record: a.record.clone(),
            note: a.note.clone().unwrap_or_default(),
            viewer: a.viewer(),
            reset: args::resets(a.reset.as_deref()),
        },
    )
}

/// Runs a twin and reports how it went; an error with the report where the recording has failed.
fn carry_out(twin: TwinBuilder<'_>, run: &Run) -> Result<Report> {
    let ran = drive::run(twin, run)?;
    let report = report::report(&ran, run.record.as_deref());
    match ran.tally.recording_failed {
        None => Ok(report),
        Some(why) => Err(Failed { report, why }.into()),
    }
}

/// `record`: the same as `run --headless --record`.
#[derive(Args)]
pub struct RecordArgs {
    /// Where to put the recording
    #[arg(value_name = "F.rrd")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// The operator's note on it
    #[arg(long, value_name = "TEXT")]
    note: Option<String>,
    /// How long, s
    #[arg(long, value_name = "S", default_value = "10", value_parser = args::not_negative)]
    seconds: f64,
    /// Where the boards are: `sim`, `pty`, or a serial port
    #[arg(long, value_name = "sim|pty|PORT[,PORT]", default_value = DEFAULT_RIG)]
    rig: String,
    /// Steer the tip there meanwhile, mm
    #[arg(long, value_name = "X,Y,Z", value_parser = args::xyz_mm, allow_hyphen_values = true)]
    target: Option<[f64; 3]>,
    /// Let boards that are SAFE from before leave it: after an earlier program has ended or was not heard any more, and
    /// for causes that are named (such as `over-pressure`), which must be removed first
    #[arg(long, value_name = "CAUSE,...", num_args = 0..=1, value_delimiter = ',', value_parser = args::cause)]
    reset: Option<Vec<u16>>,
    #[command(flatten)]
    instruments: InstrumentArgs,
    #[command(flatten)]
    monitor: MonitorArgs,
    #[command(flatten)]
    rolling: RollingArgs,
}

/// `record`.
pub fn record(a: &RecordArgs, robot_file: Option<&Path>, robot: &RobotSpec) -> Result<Report> {
    a.overwrite.file(&a.out)?;
    let twin = TwinBuilder::new(robot)
        .robot_file(robot_file)
        .rig(&a.rig, rig_options(0.0, 1))
        .instruments(a.instruments.of_arm(robot, &a.rig))
        .rolling(user::rolling_folder(), a.rolling.of())
        .watch(a.monitor.watch(robot)?)
        .ends_with(super::signals::asked_to_end()?);
    carry_out(
        twin,
        &Run {
            seconds: a.seconds,
            target: a.target.map(Goal::position),
            record: Some(a.out.clone()),
            note: a.note.clone().unwrap_or_default(),
            reset: args::resets(a.reset.as_deref()),
            ..Run::default()
        },
    )
}

/// `rig`: the virtual rig as a process.
#[cfg(unix)]
pub fn rig(a: &RigArgs, robot: &RobotSpec) -> Result<Report> {
    args::payload_in_range(robot, a.payload)?;
    let unit = args::unit_of(robot, a.unit)?;
    let mut options = RigOptions {
        unit,
        objects: objects(&a.object),
        hidden: a.hide.clone(),
        clocks: Some(a.clocks(unit)),
        inertial: a.imu_errors.errors(),
        ..rig_options(a.payload, a.seed)
    };
    options.surroundings.stiffness = a.stiffness;
    options.surroundings.obstacle = a.obstacle;
    let mut rig = VirtualRig::new(robot, &options)?;
    if let Some(folder) = &a.firmware {
        rig.use_firmware(folder)?;
    }
    if let Some(path) = &a.faults {
        let text = super::read_text(path)?;
        let script = Script::from_toml(&text).with_context(|| path.display().to_string())?;
        rig.faults.follow(script);
    }
    let ended = super::signals::asked_to_end()?;
    let mut lines = open_lines(a)?;
    super::stdio::line(&lines.ports().to_string())?;
    let parent = nix::unistd::getppid();
    // A rig that belongs to a program has nobody left to serve when that is gone.
    lines.run(&mut rig, a.vicon, || {
        !ended.load(Ordering::Relaxed) && (!a.with_parent || nix::unistd::getppid() == parent)
    })?;
    Ok(super::silent())
}

/// One line for both boards, or one each.
#[cfg(unix)]
fn open_lines(a: &RigArgs) -> Result<Lines> {
    if a.lines == 1 && a.firmware.is_none() {
        return Ok(Lines::Shared(Pty::open(a.link.as_deref())?));
    }
    let open = |board: usize| {
        let link = a.link.as_ref().map(|link| {
            let mut name = link.clone().into_os_string();
            name.push(format!("-{board}"));
            PathBuf::from(name)
        });
        Pty::open(link.as_deref())
    };
    Ok(Lines::Each([open(1)?, open(2)?]))
}

/// `rig` where there are no pseudo-terminals.
#[cfg(not(unix))]
pub fn rig(_: &RigArgs, _: &RobotSpec) -> Result<Report> {
    anyhow::bail!("this system has no pseudo-terminals: use `run --headless --rig sim` instead")
}
