//! Options that several commands have, and parsers for values. An error names what was given and what is needed.

use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};
#[cfg(feature = "gui")]
use std::time::Duration;

use anyhow::Context as _;
use clap::{Args, ValueEnum};

use super::user;
use springtwin::calibrate::Store;
use springtwin::control::Gains;
use springtwin::drive::{Instruments, Resets, is_virtual};
use springtwin::gap::Commissioned;
use springtwin::lab::gap_files::read_baseline;
pub use springtwin::lab::ranges::{payload_in_range, pressures_in_range};
use springtwin::link::wire::fault;
use springtwin::link::{fault_names, fault_of_name};
use springtwin::rig::hidden::Hidden;
use springtwin::rig::{Obstacle, Unit};
use springtwin::robot::RobotSpec;
use springtwin::signal::{BOARDS, CHAMBERS, ControllerKind};
use springtwin::task::Item;
use springtwin::twin::{RollingOf, Watch};

/// The two controllers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Kind {
    /// Sensor-space descent and ADRC, as the paper has it (corrected)
    Paper,
    /// A bounded quadratic programme in actuator space
    Ours,
}

impl Kind {
    /// Its tuning.
    pub fn gains(self) -> Gains {
        Gains::of(match self {
            Self::Paper => ControllerKind::PaperAdrc,
            Self::Ours => ControllerKind::NullSpaceQp,
        })
    }
}

/// The rolling recording of a run.
#[derive(Args, Clone, Copy, Debug)]
pub struct RollingArgs {
    /// Keep a rolling recording from Arm on also of a simulated arm, as is always done of hardware
    #[arg(long)]
    rolling: bool,
}

impl RollingArgs {
    /// Which arms have one.
    pub fn of(self) -> RollingOf {
        match self.rolling {
            true => RollingOf::EveryArm,
            false => RollingOf::Hardware,
        }
    }
}

/// What belongs to a rig besides its boards.
#[derive(Args, Clone, Debug, Default)]
pub struct InstrumentArgs {
    /// Calibration of springs and IMUs, from `calibrate springs` and `calibrate imus`; without it the saved version of this arm that
    /// is in use, with its networks and registration; on the virtual rig its own, unless the robot file was measured on it
    #[arg(long, value_name = "F.toml")]
    calibration: Option<PathBuf>,
    /// Networks from `train`; those that ship for such a rig without it
    #[arg(long, value_name = "F.safetensors")]
    networks: Option<PathBuf>,
    /// Let hardware be armed although only the virtual rig's calibration is in use: lengths and pose are then wrong
    #[arg(long)]
    accept_virtual_calibration: bool,
    /// Let boards at a serial port be armed that report a simulated arm
    #[arg(long)]
    accept_simulated_boards: bool,
    /// Detect no contact: go on when the arm is pushed, as in an experiment with disturbances
    #[arg(long)]
    expect_pushes: bool,
    /// Receive motion capture (Vicon Tracker's object stream) at this address of this computer; loopback,
    /// port 51001, without it
    #[arg(long = "mocap-listen", value_name = "IP:PORT")]
    listen: Option<SocketAddr>,
    /// Take it from these senders only; from this computer without it
    #[arg(long = "mocap-from", value_name = "IP,IP", value_delimiter = ',')]
    from: Vec<IpAddr>,
    /// Where motion capture's world and object are on the robot, from `calibrate mocap`; without it the
    /// object is `end_pad` in the robot's base
    #[arg(long = "registration", value_name = "F.toml")]
    registration: Option<PathBuf>,
}

impl InstrumentArgs {
    /// Those for driving an arm: without a calibration among the named ones, those of its saved version that is in use. On the
    /// virtual rig a command depends on the files that are named alone, unless the robot file was measured on it.
    pub fn of_arm(&self, robot: &RobotSpec, rig: &str) -> Instruments {
        match is_virtual(rig) && robot.virtual_unit.is_none() {
            true => self.plain(),
            false => self.with_saved(robot, rig),
        }
    }

    /// Those that were named; without a calibration among them, those of the saved version that is in use.
    pub fn with_saved(&self, robot: &RobotSpec, rig: &str) -> Instruments {
        let (named, simulated) = (self.plain(), is_virtual(rig));
        let Some(data) = user::data_folder() else {
            return named;
        };
        let (instruments, trouble) = Store::of(robot, simulated, &data).complete(named, simulated);
        if let Some(trouble) = trouble {
            log::warn!("{trouble}");
        }
        instruments
    }

    /// Those that were named, as a twin's builder takes them.
    pub fn plain(&self) -> Instruments {
        Instruments {
            calibration: self.calibration.clone(),
            accept_virtual_calibration: self.accept_virtual_calibration,
            accept_simulated_boards: self.accept_simulated_boards,
            expect_pushes: self.expect_pushes,
            mocap_listen: self.listen,
            mocap_from: self.from.clone(),
            registration: self.registration.clone(),
            networks: self.networks.clone(),
        }
    }
}

/// Whether the arm is compared with its commissioned twin.
#[derive(Args, Clone)]
pub struct MonitorArgs {
    /// Compare the arm with what its commissioned twin predicts from the pressures, and warn where they disagree: a file that
    /// `gap commission --baseline` wrote
    #[arg(long, value_name = "FILE")]
    pub baseline: Option<PathBuf>,
}

impl MonitorArgs {
    /// The monitor that was asked for.
    ///
    /// # Errors
    /// When the file cannot be read, or is of another robot.
    pub fn watch(&self, robot: &RobotSpec) -> anyhow::Result<Option<Watch>> {
        let file = self.baseline.as_deref();
        file.map(|file| watch(file, robot)).transpose()
    }
}

/// A monitor of the rig that was commissioned in `file`.
///
/// # Errors
/// When it cannot be read, or is of another robot.
pub fn watch(file: &Path, robot: &RobotSpec) -> anyhow::Result<Watch> {
    Watch::new(robot, commissioned(file)?).with_context(|| file.display().to_string())
}

/// The commissioned rig in a file.
///
/// # Errors
/// When it cannot be read, or holds none.
pub fn commissioned(file: &Path) -> anyhow::Result<Commissioned> {
    read_baseline(file)?.with_context(|| {
        format!(
            "{} is no baseline file. `springtwin gap commission --baseline FILE` writes one",
            file.display()
        )
    })
}

fn numbers<const N: usize>(text: &str, what: &str) -> Result<[f64; N], String> {
    let parts: Vec<&str> = text.split(',').map(str::trim).collect();
    if parts.len() != N {
        return Err(format!(
            "{what} needs {N} numbers separated by commas, but got {}",
            parts.len()
        ));
    }
    let mut out = [0.0; N];
    for (slot, part) in out.iter_mut().zip(parts) {
        let value: f64 = part
            .parse()
            .map_err(|_| format!("{what}: '{part}' is not a number"))?;
        if !value.is_finite() {
            return Err(format!("{what}: '{part}' is not a finite number"));
        }
        *slot = value;
    }
    Ok(out)
}

/// `X,Y,Z` in mm, to m.
pub fn xyz_mm(text: &str) -> Result<[f64; 3], String> {
    numbers::<3>(text, "a position (x,y,z in mm)").map(|v| v.map(|x| x * 1e-3))
}

/// `X,Y,Z` in N.
pub fn xyz_n(text: &str) -> Result<[f64; 3], String> {
    numbers::<3>(text, "a force (x,y,z in N)")
}

/// Six pressures in kPa, to Pa.
pub fn six_kpa(text: &str) -> Result<[f64; CHAMBERS], String> {
    numbers::<CHAMBERS>(text, "pressures (six values in kPa)").map(|v| v.map(|x| x * 1e3))
}

/// `X,Y,Z` that is not all zero.
pub fn direction(text: &str) -> Result<[f64; 3], String> {
    let d = numbers::<3>(text, "a direction (x,y,z)")?;
    match d.iter().any(|v| *v != 0.0) {
        true => Ok(d),
        false => Err("a direction of 0,0,0 points nowhere: 0,0,-1 is straight down".to_owned()),
    }
}

/// `X,Y,Z,KG`: where to grasp it (mm), and its mass.
pub fn item(text: &str) -> Result<Item, String> {
    let [x, y, z, mass_kg] = numbers::<4>(text, "an item (x,y,z in mm and its mass in kg)")?;
    if mass_kg < 0.0 {
        return Err(format!("{mass_kg} kg is no mass: it must be 0 or more"));
    }
    Ok(Item {
        name: format!("item of {:.0} g", mass_kg * 1e3),
        grasp_m: [x * 1e-3, y * 1e-3, z * 1e-3],
        mass_kg,
    })
}

fn within(text: &str, range: std::ops::RangeInclusive<f64>, what: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if range.contains(&v) => Ok(v),
        _ => Err(format!(
            "'{text}' is no {what}: it must be a number from {} to {}",
            range.start(),
            range.end()
        )),
    }
}

/// A cause of SAFE.
pub fn cause(text: &str) -> Result<u16, String> {
    fault_of_name(text).ok_or_else(|| {
        let all = fault_names(fault::LATCHING).replace(',', ", ");
        format!("'{text}' is no cause of SAFE: name some of {all}")
    })
}

/// What `--reset` lets go, with the causes that were named.
pub fn resets(named: Option<&[u16]>) -> Resets {
    named.map_or_else(Resets::default, Resets::usual_and)
}

/// The unit of the virtual rig that a command moves: that of a robot file that was measured on one, else the one that was given.
///
/// # Errors
/// When the file and the option name different ones.
pub fn unit_of(robot: &RobotSpec, given: u64) -> anyhow::Result<Unit> {
    match robot.virtual_unit {
        None => Ok(Unit(given)),
        Some(own) if own == given || Unit(given) == Unit::default() => Ok(Unit(own)),
        Some(own) => anyhow::bail!(
            "the robot file was measured on unit {own} of the virtual rig: leave --unit out, or leave --robot out for unit {given}"
        ),
    }
}

/// Refuses to hide effects in boards that are not the virtual rig's.
///
/// # Errors
/// What to do instead.
pub fn hides_in_virtual(hide: &[Hidden], rig: &str) -> anyhow::Result<()> {
    anyhow::ensure!(
        hide.is_empty() || is_virtual(rig),
        "--hide is for the virtual rig (--rig sim or pty): a rig behind a port is started with springtwin rig --hide"
    );
    Ok(())
}

/// A span of a session's own clock, s.
pub fn window(text: &str) -> Result<[f64; 2], String> {
    let ends = text.split_once(':').and_then(|(from, to)| {
        let [from, to]: [f64; 2] = [from.trim().parse().ok()?, to.trim().parse().ok()?];
        (from < to && from.is_finite() && to.is_finite()).then_some([from, to])
    });
    ends.ok_or_else(|| {
        format!(
            "'{text}' is no window: give two times in seconds, the earlier one first, such as 22:29"
        )
    })
}

/// A factor on the arm's stiffness.
pub fn stiffness(text: &str) -> Result<f64, String> {
    within(text, 0.3..=3.0, "stiffness")
}

/// `A,B` in ppm for the two boards, to s/s.
pub fn clocks_ppm(text: &str) -> Result<[f64; BOARDS], String> {
    let ppm = numbers::<BOARDS>(text, "a pair of clocks (ppm of board 1, of board 2)")?;
    match ppm.iter().all(|v| v.abs() <= 20_000.0) {
        true => Ok(ppm.map(|v| v * 1e-6)),
        false => Err(format!(
            "'{text}' is beyond what a clock can be off: at most 20000 ppm"
        )),
    }
}

/// Half the extent of a path, mm.
pub fn size_mm(text: &str) -> Result<f64, String> {
    within(text, 1.0..=300.0, "size in mm")
}

/// A speed along a path, mm/s.
pub fn speed_mm_s(text: &str) -> Result<f64, String> {
    within(text, 0.1..=50.0, "speed in mm/s")
}

/// A number of waypoints.
pub fn waypoints(text: &str) -> Result<usize, String> {
    match text.parse::<usize>() {
        Ok(n) if (3..=2000).contains(&n) => Ok(n),
        _ => Err(format!("'{text}' is no number of waypoints: 3 to 2000")),
    }
}

/// A number that is finite and not negative.
pub fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v.is_finite() && v >= 0.0 => Ok(v),
        Ok(v) => Err(format!("{v} must be a finite number, 0 or more")),
        Err(_) => Err(format!("'{text}' is not a number")),
    }
}

/// Hours of a long run.
pub fn hours(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v > 0.0 && v <= 1e4 => Ok(v),
        _ => Err(format!(
            "'{text}' is no number of hours: it must be greater than 0 and at most 10000"
        )),
    }
}

/// A number greater than 0, at most 8.
#[cfg(feature = "gui")]
pub fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v > 0.0 && v <= 8.0 => Ok(v),
        _ => Err(format!(
            "'{text}' must be a number greater than 0 and at most 8"
        )),
    }
}

/// What goes wrong on purpose.
#[cfg(feature = "gui")]
#[derive(Clone, Copy, Debug)]
pub enum Drill {
    /// The window's graphics device is lost so long after the start.
    LoseGpu(Duration),
    /// The control loop stands still for so long, once the arm moves.
    Stall(Duration),
}

#[cfg(feature = "gui")]
impl Drill {
    /// When the graphics device is lost.
    pub fn loss(&self) -> Option<Duration> {
        match self {
            Self::LoseGpu(at) => Some(*at),
            Self::Stall(_) => None,
        }
    }

    /// For how long the control loop stands still.
    pub fn stall(&self) -> Option<Duration> {
        match self {
            Self::LoseGpu(_) => None,
            Self::Stall(lasts) => Some(*lasts),
        }
    }
}

/// `lose-gpu=S` or `stall=S`.
#[cfg(feature = "gui")]
pub fn drill(text: &str) -> Result<Drill, String> {
    let seconds = |s: &str| {
        let s = s
            .parse()
            .ok()
            .filter(|s: &f64| (0.0..=86_400.0).contains(s));
        s.map(Duration::from_secs_f64)
    };
    let read = text.split_once('=').and_then(|(what, s)| match what {
        "lose-gpu" => seconds(s).map(Drill::LoseGpu),
        "stall" => seconds(s).map(Drill::Stall),
        _ => None,
    });
    read.ok_or_else(|| format!("'{text}' is no drill: write lose-gpu=S or stall=S, S in seconds"))
}

/// A flat thing: a point on it (mm) and the direction out of it.
pub fn obstacle(text: &str) -> Result<Obstacle, String> {
    let [x, y, z, nx, ny, nz] = numbers::<6>(text, "an obstacle")?;
    if nx == 0.0 && ny == 0.0 && nz == 0.0 {
        return Err(format!(
            "'{text}': the direction out of the obstacle has no length"
        ));
    }
    Ok(Obstacle {
        point_m: [x, y, z].map(|mm| mm * 1e-3),
        normal: [nx, ny, nz],
        stiffness_n_m: Obstacle::TABLE_N_M,
    })
}

/// `WxH`, both from 64 to 8192.
#[cfg(feature = "gui")]
pub fn size(text: &str) -> Result<[u32; 2], String> {
    let parse = |s: &str| s.parse().ok().filter(|v| (64..=8192).contains(v));
    text.split_once('x')
        .and_then(|(w, h)| Some([parse(w)?, parse(h)?]))
        .ok_or_else(|| {
            format!("'{text}' is not a size: write WxH, for example 1280x720 (64 to 8192)")
        })
}

/// Where a viewer listens on this machine.
pub fn viewer(text: &str) -> Result<SocketAddr, String> {
    match text.parse::<SocketAddr>() {
        Ok(address) if address.ip().is_loopback() && address.port() != 0 => Ok(address),
        Ok(address) if address.port() != 0 => Err(format!(
            "{address} is not on this machine, and a stream is not encrypted: use 127.0.0.1, or --stream-remote {address} if the network may read it"
        )),
        _ => Err(format!(
            "'{text}' is no address: write IP:PORT, for example 127.0.0.1:9876"
        )),
    }
}

/// `i/n`, 1-based.
pub fn shard(text: &str) -> Result<(usize, usize), String> {
    let wrong = || format!("'{text}' is not a shard: write i/n with 1 <= i <= n, for example 3/16");
    let (i, n) = text.split_once('/').ok_or_else(wrong)?;
    let (i, n): (usize, usize) = (
        i.parse().map_err(|_| wrong())?,
        n.parse().map_err(|_| wrong())?,
    );
    if i == 0 || i > n {
        Err(wrong())
    } else {
        Ok((i, n))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stream_stays_on_this_machine() {
        assert!(viewer("127.0.0.1:9876").is_ok() && viewer("[::1]:9876").is_ok());
        let remote = viewer("192.168.0.7:9876").unwrap_err();
        assert!(
            remote.contains("--stream-remote 192.168.0.7:9876"),
            "{remote}"
        );
        assert!(viewer("0.0.0.0:9876").is_err() && viewer("127.0.0.1:0").is_err());
        assert!(viewer("localhost").unwrap_err().contains("IP:PORT"));
    }

    #[test]
    fn refusals_say_what_is_wrong() {
        assert_eq!(xyz_mm("60, 40,-300").map(|v| v[2]), Ok(-0.3));
        assert!(
            xyz_mm("nan,0,0")
                .unwrap_err()
                .contains("'nan' is not a finite number")
        );
        assert!(xyz_mm("1,2").unwrap_err().contains("3 numbers"));
        assert!(
            six_kpa("1,2,3,4,5,x")
                .unwrap_err()
                .contains("'x' is not a number")
        );
        assert!(shard("0/4").is_err() && shard("5/4").is_err() && shard("2/4") == Ok((2, 4)));
        assert_eq!(clocks_ppm("5000,-300"), Ok([5e-3, -300.0 * 1e-6]));
        assert!(clocks_ppm("5000").unwrap_err().contains("2 numbers"));
        assert!(
            clocks_ppm("0,30000")
                .unwrap_err()
                .contains("at most 20000 ppm")
        );
        assert!(not_negative("-1").is_err() && not_negative("inf").is_err());
    }
}
