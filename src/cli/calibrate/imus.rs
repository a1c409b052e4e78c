//! `calibrate imus`.

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::Args;
use nalgebra::UnitQuaternion;
use serde_json::{Value, json};

use crate::cli::outputs::Overwrite;
use crate::cli::{Failed, Report, model};
use springtwin::recording::{read_rrd, write_text};
use springtwin::robot::RobotSpec;
use springtwin::sensing::mounting::{MountingError, MountingFit, fit_mounting};
use springtwin::sensing::{Calibration, Sensing};
use springtwin::signal::{IMUS, RawFrame};

/// Time that the filters take to settle, s.
const SETTLING_S: f64 = 10.0;
/// One frame in this many is used: neighbours are correlated.
const EVERY: usize = 10;

#[derive(Args)]
pub struct ImusArgs {
    /// A recording of slow motion to all sides, a minute or more
    #[arg(value_name = "F.rrd")]
    recording: PathBuf,
    /// Where to put the calibration: the springs of --calibration, and the mountings
    #[arg(long, value_name = "F.toml")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// The springs' calibration; the virtual rig's without it
    #[arg(long, value_name = "F.toml")]
    calibration: Option<PathBuf>,
}

/// `calibrate imus`.
pub fn imus(a: &ImusArgs, robot: &RobotSpec) -> Result<Report> {
    a.overwrite.file(&a.out)?;
    let read = read_rrd(&a.recording)?;
    let mut calibration = match &a.calibration {
        None => Calibration::virtual_rig(),
        Some(path) => Calibration::from_toml(&springtwin::drive::read_toml(path)?)
            .with_context(|| path.display().to_string())?,
    };
    let mut frames: Vec<&RawFrame> = Vec::new();
    for raw in read.trace.snapshots.iter().filter_map(|s| s.raw.as_ref()) {
        // Between two frames a snapshot repeats the last one.
        if frames.last().is_none_or(|last| raw.seq != last.seq) {
            frames.push(raw);
        }
    }
    anyhow::ensure!(
        !frames.is_empty(),
        "{} holds no raw frames: record the boards with springtwin record",
        a.recording.display()
    );
    let sensing = model::sensing(robot, a.calibration.as_deref())?;
    let fits = pairs(sensing, &frames).map(|p| fit_mounting(&p));
    let good = fits.iter().filter(|f| f.is_ok()).count();
    for (i, fit) in fits.iter().enumerate() {
        if let Ok(fit) = fit {
            calibration.set_imu(i, *fit);
        }
    }
    if good > 0 {
        write_text(&a.out, &calibration.to_toml()?)?;
    }
    let report = report(&fits, good, read.trace.simulated, &a.out);
    let bad: Vec<String> = fits
        .iter()
        .enumerate()
        .filter_map(|(i, f)| Some(format!("IMU {}: {}", i + 1, f.as_ref().err()?)))
        .collect();
    if bad.is_empty() {
        return Ok(report);
    }
    let why = bad.join("; ");
    Err(Failed { report, why }.into())
}

type Pairs = Vec<(UnitQuaternion<f64>, UnitQuaternion<f64>)>;

/// Orientation of each IMU's pad from the springs and from the IMU.
fn pairs(mut sensing: Sensing, frames: &[&RawFrame]) -> [Pairs; IMUS] {
    let mut pairs: [Pairs; IMUS] = Default::default();
    let Some(start) = frames.first().map(|f| f.stamp) else {
        return pairs;
    };
    for (k, raw) in frames.iter().enumerate() {
        let out = sensing.update(raw);
        if raw.stamp.since(start) < SETTLING_S || !k.is_multiple_of(EVERY) {
            continue;
        }
        for (i, pairs) in pairs.iter_mut().enumerate() {
            if out.health.imus[i] == springtwin::signal::ChannelHealth::Ok {
                let by_imu =
                    UnitQuaternion::from_rotation_matrix(&out.sensors.base_from_imu_pad(i));
                if let Some(pad) = sensing.pads_by_springs()[i / 2] {
                    pairs.push((pad.rotation, by_imu));
                }
            }
        }
    }
    pairs
}

fn report(
    fits: &[std::result::Result<MountingFit, MountingError>; IMUS],
    good: usize,
    simulated: Option<bool>,
    out: &std::path::Path,
) -> Report {
    let label = match simulated {
        Some(true) => " (simulated rig)",
        Some(false) => "",
        None => " (origin unknown)",
    };
    let mut text = match good {
        0 => format!("no IMU's mounting was found{label}"),
        _ => format!("{good} of {IMUS} mountings{label} in {}", out.display()),
    };
    let mut imus: Vec<Value> = Vec::new();
    for (i, fit) in fits.iter().enumerate() {
        match fit {
            Ok(f) => {
                text += &format!(
                    "\nIMU {}: {:.3} deg off nominal, {:.3} deg RMS residual in {} samples",
                    i + 1,
                    f.correction_rad.norm().to_degrees(),
                    f.residual_rad.to_degrees(),
                    f.samples
                );
            }
            Err(e) => text += &format!("\nIMU {}: refused: {e}", i + 1),
        }
        let found = fit.as_ref().ok();
        let degrees =
            |f: &MountingFit| -> [f64; 3] { f.correction_rad.map(f64::to_degrees).into() };
        imus.push(json!({
            "id": i + 1, "ok": found.is_some(),
            "why": fit.as_ref().err().map(ToString::to_string),
            "correction_deg": found.map(degrees),
            "residual_deg": found.map(|f| f.residual_rad.to_degrees()),
            "samples": found.map(|f| f.samples),
        }));
    }
    Report {
        text,
        json: json!({"imus": imus, "simulated": simulated}),
    }
}
