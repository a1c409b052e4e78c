//! `calibrate imus`.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Args;
use serde_json::{Value, json};

use crate::cli::outputs::{Overwrite, replace_keeping};
use crate::cli::{Failed, Report};
use springtwin::recording::each_snapshot;
use springtwin::robot::RobotSpec;
use springtwin::sensing::Calibration;
use springtwin::sensing::imu_fit::{
    Capture, FRAMES, Fit, ImuFit, Parameter, RestError, RestZero, Start, Window, Windows,
    ends_sigma_m, first_rest, fit,
};
use springtwin::signal::IMUS;
use springtwin::twin::Patched;

#[derive(Args)]
pub struct ImusArgs {
    /// A recording of a rest of four seconds and slow motion to all sides, a minute or more
    #[arg(value_name = "F.rrd")]
    recording: PathBuf,
    /// Where to put the calibration: the springs of --calibration, the IMUs and the base's tilt. A file that is replaced is
    /// kept beside it as `F.toml.~1~`, `F.toml.~2~` and so on
    #[arg(long, value_name = "F.toml")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// The springs' calibration; the virtual rig's without it
    #[arg(long, value_name = "F.toml")]
    calibration: Option<PathBuf>,
    /// Only zero the gyros, from a recording of a rest; mountings and accelerometers of --calibration are kept
    #[arg(long)]
    zero: bool,
    /// Date to write into the file
    #[arg(long, value_name = "DATE", default_value = "not stated")]
    date: String,
}

/// `calibrate imus`.
pub fn imus(a: &ImusArgs, robot: &RobotSpec) -> Result<Report> {
    a.overwrite.file(&a.out)?;
    let calibration = match &a.calibration {
        None => Calibration::virtual_rig(),
        Some(path) => Calibration::from_toml(&springtwin::drive::read_toml(path)?)
            .with_context(|| path.display().to_string())?,
    };
    let patched = Patched::new(robot, &calibration);
    let mut averages = Windows::new(&patched.geometry, &patched.calibration);
    let mut windows: Vec<Window> = Vec::new();
    let kept = size_of::<Window>() / FRAMES;
    let meta = each_snapshot(&a.recording, kept, &mut |snapshot| {
        windows.extend(snapshot.raw.as_ref().and_then(|raw| averages.push(raw)));
    })?;
    let springs_out = averages.springs_out();
    anyhow::ensure!(
        !windows.is_empty(),
        "{} holds no raw frames: record the boards with springtwin record",
        a.recording.display()
    );
    let rest = first_rest(&windows, robot);
    let label = match meta.simulated {
        Some(true) => " (simulated rig)",
        Some(false) => "",
        None => " (origin unknown)",
    };
    let mut report = match a.zero {
        true => zeroed(a, calibration, rest, label)?,
        false => {
            let start = Start {
                gyro_bias_rad_s: rest.as_ref().map_or([None; IMUS], |r| r.gyro_bias_rad_s),
                base_tilt_rad: calibration.base_tilt_rad,
                springs_out,
                ends_sigma_m: ends_sigma_m(&calibration),
            };
            let captures = captures(robot, &patched, &windows);
            let found = fit(robot, &captures.each_ref().map(Some), &start);
            fitted(a, calibration, &found, rest.err(), label)?
        }
    };
    report.report.json["simulated"] = json!(meta.simulated);
    match report.why.is_empty() {
        true => Ok(report.report),
        false => Err(report.into()),
    }
}

fn captures(robot: &RobotSpec, patched: &Patched, windows: &[Window]) -> [Capture; IMUS] {
    std::array::from_fn(|i| {
        let mut capture = Capture::default();
        for w in windows {
            if let (Some(pad), Some(raw)) = (&w.base_from_pad[robot.imus[i].pad.index()], &w.imu[i])
            {
                capture.add(w.t_s, &pad.turned(&patched.imu[i]), raw);
            }
        }
        capture
    })
}

/// Puts in the zeros of a rest and writes the file.
fn zeroed(
    a: &ImusArgs,
    mut calibration: Calibration,
    rest: Result<RestZero, RestError>,
    label: &str,
) -> Result<Failed> {
    let rest = rest.with_context(|| a.recording.display().to_string())?;
    let mut text = format!("zeros of the gyros{label} in {}", a.out.display());
    let (mut imus, mut why) = (Vec::new(), Vec::new());
    for (i, bias) in rest.gyro_bias_rad_s.iter().enumerate() {
        let Some(bias_rad_s) = bias else {
            why.push(format!("IMU {}: no readings during the rest", i + 1));
            imus.push(json!({"id": i + 1, "ok": false}));
            continue;
        };
        let mut entry = calibration.imu_entry(i);
        entry.zero.gyro_bias_rad_s = *bias_rad_s;
        a.date.clone_into(&mut entry.date);
        calibration.set_imu(entry)?;
        let bias_deg_s: [f64; 3] = bias_rad_s.map(f64::to_degrees).into();
        let [x, y, z] = bias_deg_s;
        text += &format!("\nIMU {}: zero {x:.3}, {y:.3}, {z:.3} deg/s", i + 1);
        imus.push(json!({"id": i + 1, "ok": true, "gyro_bias_deg_s": bias_deg_s}));
    }
    replace_keeping(&a.out, &calibration.to_toml()?)?;
    let json = json!({"imus": imus});
    Ok(Failed {
        report: Report { text, json },
        why: why.join("; "),
    })
}

/// Puts in what was fitted and writes the file.
fn fitted(
    a: &ImusArgs,
    mut calibration: Calibration,
    found: &Fit,
    no_rest: Option<RestError>,
    label: &str,
) -> Result<Failed> {
    let mut good = 0;
    for fit in found.imus.iter().flatten().flatten() {
        let mut entry = fit.entry.clone();
        a.date.clone_into(&mut entry.date);
        calibration.set_imu(entry)?;
        calibration.base_tilt_rad = found.base_tilt_rad;
        good += 1;
    }
    if good > 0 {
        replace_keeping(&a.out, &calibration.to_toml()?)?;
    }
    let why: Vec<String> = found
        .imus
        .iter()
        .enumerate()
        .filter_map(|(i, f)| Some(format!("IMU {}: {}", i + 1, f.as_ref()?.as_ref().err()?)))
        .collect();
    Ok(Failed {
        report: report(found, good, no_rest, label, &a.out),
        why: why.join("; "),
    })
}

fn report(found: &Fit, good: usize, no_rest: Option<RestError>, label: &str, out: &Path) -> Report {
    let mut text = match good {
        0 => format!("no IMU was calibrated{label}"),
        _ => format!("{good} of {IMUS} IMUs{label} in {}", out.display()),
    };
    if let Some(why) = &no_rest {
        text += &format!("\nno zero at rest, gyro biases are from the motion: {why}");
    }
    if let Some(tilt) = &found.tilt {
        text += "\nbase:";
        tilt.iter().for_each(|p| text += &line(p));
    }
    let mut imus: Vec<Value> = Vec::new();
    for (i, fit) in found.imus.iter().enumerate() {
        let (ok, why) = match fit {
            Some(Ok(ok)) => (Some(ok), None),
            Some(Err(e)) => (None, Some(e.to_string())),
            None => (None, None),
        };
        if let Some(f) = ok {
            text += &format!(
                "\nIMU {}: {:.3} deg off nominal, {:.3} deg RMS residual in {} samples",
                i + 1,
                f.entry.fit.correction_rad.norm().to_degrees(),
                f.entry.fit.residual_rad.to_degrees(),
                f.entry.fit.samples
            );
            f.parameters.iter().for_each(|p| text += &line(p));
        }
        if let Some(why) = &why {
            text += &format!("\nIMU {}: refused: {why}", i + 1);
        }
        imus.push(of_imu(i, ok, why.as_deref()));
    }
    let open = found.open();
    open.iter().for_each(|s| text += &format!("\nopen: {s}"));
    Report {
        text,
        json: json!({
            "imus": imus,
            "base_tilt_deg": found.base_tilt_rad.map(f64::to_degrees),
            "tilt": found.tilt.as_ref().map(|t| parameters(t)),
            "open": open,
            "no_rest": no_rest.map(|e| e.to_string()),
        }),
    }
}

/// One parameter on a line of its own.
fn line(p: &Parameter) -> String {
    let state = match p.is_observed() {
        true => "",
        false => ", not determined",
    };
    let space = if p.unit.is_empty() { "" } else { " " };
    format!(
        "\n    {}: {:.4} +- {:.4}{space}{}{state}",
        p.name, p.value, p.sigma, p.unit
    )
}

fn parameters(of: &[Parameter]) -> Vec<Value> {
    of.iter()
        .map(|p| {
            json!({
                "name": p.name, "unit": p.unit, "value": p.value, "sigma": p.sigma,
                "prior_sigma": p.prior_sigma, "observed": p.is_observed(),
            })
        })
        .collect()
}

fn of_imu(i: usize, fit: Option<&ImuFit>, why: Option<&str>) -> Value {
    let correction_deg = fit.map(|f| -> [f64; 3] {
        let correction_rad = &f.entry.fit.correction_rad;
        correction_rad.map(f64::to_degrees).into()
    });
    json!({
        "id": i + 1, "ok": fit.is_some(), "why": why,
        "correction_deg": correction_deg,
        "residual_deg": fit.map(|f| f.entry.fit.residual_rad.to_degrees()),
        "samples": fit.map(|f| f.entry.fit.samples),
        "parameters": fit.map(|f| parameters(&f.parameters)),
    })
}
