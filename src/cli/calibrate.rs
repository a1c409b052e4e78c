//! `calibrate`: calibrations of springs and IMUs, registrations of motion capture.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::{Args, Subcommand};
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};

mod imus;
mod self_;
mod springs;
mod wizard;

pub use springs::{BenchArgs, bench};

use super::outputs::Overwrite;
use super::{Report, args, model};
use imus::ImusArgs;
use self_::SelfArgs;
use springs::SpringsArgs;
use springtwin::learn::to_pose;
use springtwin::link::wire::objects::END_PAD;
use springtwin::recording::{each_snapshot, file_sha256, part_of, read_session, write_text};
use springtwin::robot::RobotSpec;
use springtwin::sensing::registration::{
    ClockOptions, FitOptions, ObjectFrame, Placed, Registration, StreamOptions, StreamRegistration,
    register_streams,
};
use springtwin::signal::{Pose, hex, ypr_from_rotation};
use wizard::WizardArgs;

/// How far the tip by the springs trails behind on its way, m: their hysteresis is 0.05 to 0.11 mm on the bench.
const TRAILS_M: f64 = 0.1e-3;

#[derive(Subcommand)]
pub enum CalibrateCommand {
    /// All steps of the window's wizard on a rig, without a window: preflight, springs, IMUs, motion
    /// capture, validation, save. The arm moves. Every step prints PASS or REDO with its figures; a
    /// refused step is repeated
    Wizard(WizardArgs),
    /// A curve per spring from the log of a bench that drew them up and down, with a verdict on each
    Springs(SpringsArgs),
    /// Zeros and mountings of the IMUs and the base's tilt, from a recording of a rest and of slow motion; with
    /// --zero, the gyros alone, from a rest
    Imus(ImusArgs),
    /// Ends and gains of the springs, mountings and biases of the IMUs and the base's tilt in one adjustment, from recordings of
    /// slow motion, with or without motion capture of the end pad. Only what improves blocks of time that were held out is
    /// kept; what the motion leaves open is listed, with what would close it
    #[command(name = "self")]
    OfItself(SelfArgs),
    /// Where motion capture's world and object are on the robot, and the offset of its clock, from one
    /// motion that both recorded: half a minute or more of bending to all sides. An error of the robot's
    /// poses that is the same everywhere cannot be separated from the place of the world, and is part of it
    Mocap(MocapArgs),
}

#[derive(Args)]
pub struct MocapArgs {
    /// What the robot recorded: session folder, session.toml or .rrd
    #[arg(value_name = "RECORDING")]
    recording: PathBuf,
    /// What motion capture recorded of it: session folder whose vicon columns hold the object in its
    /// own world, as `springtwin import` writes it
    #[arg(value_name = "MOCAP")]
    mocap: PathBuf,
    /// Where to put the registration
    #[arg(long, value_name = "F.toml")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Name of the tracked object
    #[arg(long, value_name = "NAME", default_value = END_PAD)]
    object: String,
    /// The object was defined on the end pad's own frame: fit only where the world is
    #[arg(long)]
    object_is_pad: bool,
    /// Date to write into the file
    #[arg(long, value_name = "DATE", default_value = "not stated")]
    date: String,
    /// Look for the clock offset (robot's less motion capture's) about this, s
    #[arg(
        long,
        value_name = "S",
        default_value = "0",
        allow_negative_numbers = true
    )]
    about: f64,
    /// Look for it so far to both sides, s
    #[arg(long, value_name = "S", default_value = "10", value_parser = args::not_negative)]
    search: f64,
    /// Networks that estimate a session's poses; the shipped ones without it
    #[arg(long, value_name = "F.safetensors")]
    model: Option<PathBuf>,
}

/// The time now, as a saved calibration carries it.
pub fn now() -> String {
    local_time(&jiff::Zoned::now())
}

/// Local time with its offset from UTC, as 2026-03-01 14:05 +01:00.
fn local_time(time: &jiff::Zoned) -> String {
    time.strftime("%Y-%m-%d %H:%M %:z").to_string()
}

/// `calibrate`.
pub fn run(
    command: &CalibrateCommand,
    robot_file: Option<&Path>,
    robot: &RobotSpec,
    json: bool,
) -> Result<Report> {
    match command {
        CalibrateCommand::Wizard(a) => wizard::wizard(a, robot_file, robot, json),
        CalibrateCommand::Springs(a) => springs::springs(a, robot),
        CalibrateCommand::Imus(a) => imus::imus(a, robot),
        CalibrateCommand::OfItself(a) => self_::self_(a, robot),
        CalibrateCommand::Mocap(a) => mocap(a),
    }
}

fn mocap(a: &MocapArgs) -> Result<Report> {
    a.overwrite.file(&a.out)?;
    let robot = robot_poses(&a.recording, a.model.as_deref())?;
    let seen = read_session(&a.mocap)?;
    anyhow::ensure!(
        seen.truth.iter().any(Option::is_some),
        "{} has no poses of motion capture: import it with springtwin import",
        a.mocap.display()
    );
    // A slow stream has no gaps between its own samples.
    let slowest_hz = robot.rate_hz.min(seen.rate_hz);
    let usual = ClockOptions::default();
    let object: Vec<_> = seen.t_s.iter().copied().zip(seen.truth).collect();
    let options = StreamOptions {
        fit: FitOptions {
            object: match a.object_is_pad {
                true => ObjectFrame::Known(Pose::identity()),
                false => ObjectFrame::Unknown,
            },
            ..FitOptions::default()
        },
        clock: ClockOptions {
            trails_m: TRAILS_M,
            about_s: a.about,
            search_s: a.search,
            gap_max_s: usual.gap_max_s.max(2.5 / slowest_hz).min(1.0),
        },
    };
    let found = register_streams(&robot.poses, &object, &options)
        .with_context(|| format!("{} and {}", a.recording.display(), a.mocap.display()))?;
    let data = hex(&Sha256::digest(format!("{}\n{}\n", robot.hash, seen.hash)));
    let registration = Registration::new(&found, &a.object, &a.date, &data);
    write_text(&a.out, &registration.to_toml()?)?;
    let mut out = report(&found, &registration, &a.out);
    if robot.simulated == Some(true) {
        out.text.insert_str(0, "simulated: ");
    }
    out.json["simulated"] = json!(robot.simulated);
    Ok(out)
}

/// Estimated poses of the tip.
struct RobotPoses {
    /// Time by its clock, s; base from tip.
    poses: Vec<(f64, Pose)>,
    /// Nominal rate, Hz.
    rate_hz: f64,
    /// Whether the arm was simulated, if known.
    simulated: Option<bool>,
    /// SHA-256 of the file.
    hash: String,
}

/// The estimates of a recording, or those that the networks make of a session's sensors.
fn robot_poses(path: &Path, networks: Option<&Path>) -> Result<RobotPoses> {
    let robot = if springtwin::recording::is_rrd(path) {
        recorded(path)?
    } else {
        estimated(path, networks)?
    };
    anyhow::ensure!(
        !robot.poses.is_empty(),
        "{} holds no pose of the tip: it needs samples with all sensors, or recorded estimates",
        path.display()
    );
    Ok(robot)
}

fn recorded(path: &Path) -> Result<RobotPoses> {
    let mut poses: Vec<(f64, Pose)> = Vec::new();
    let meta = each_snapshot(path, size_of::<(f64, Pose)>(), &mut |snapshot| {
        // Between two frames a snapshot repeats the last estimate.
        if let Some(e) = &snapshot.estimate
            && poses.last().is_none_or(|last| e.stamp.seconds() > last.0)
        {
            poses.push((e.stamp.seconds(), e.base_from_tip));
        }
    })?;
    let span_s = poses.first().zip(poses.last()).map(|(a, b)| b.0 - a.0);
    let rate_hz = poses.len() as f64 / span_s.unwrap_or_default();
    Ok(RobotPoses {
        poses,
        rate_hz,
        simulated: meta.simulated,
        hash: file_sha256(&part_of(path)?.0)?,
    })
}

fn estimated(path: &Path, networks: Option<&Path>) -> Result<RobotPoses> {
    let log = read_session(path)?;
    let maps = model::maps(networks)?;
    let poses = model::estimates(&log, &maps)
        .map(|(k, eval)| (log.t_s[k], to_pose(&eval.pose)))
        .collect();
    Ok(RobotPoses {
        poses,
        rate_hz: log.rate_hz,
        simulated: None,
        hash: log.hash,
    })
}

fn transform(placed: &Placed) -> Value {
    let mm: [f64; 3] = (placed.pose.translation.vector * 1e3).into();
    json!({
        "mm": mm,
        "ypr_deg": ypr_from_rotation(&placed.pose.rotation).map(f64::to_degrees),
        "sigma_mm": placed.sigma.position_m * 1e3,
        "sigma_deg": placed.sigma.rotation_rad.to_degrees(),
    })
}

fn report(found: &StreamRegistration, r: &Registration, out: &Path) -> Report {
    let (fit, clock, loo) = (&found.fit, &found.clock, &found.fit.summary);
    let (pos_mm, rot_deg) = (loo.position_rms_m * 1e3, loo.rotation_rms_rad.to_degrees());
    let worst_mm = loo.position_worst_m * 1e3;
    let worst_deg = loo.rotation_worst_rad.to_degrees();
    let mut text = format!(
        "{} poses to {}: clock offset {:.2} ms (one sigma {:.2} ms); left out, a pose is predicted to \
         {pos_mm:.2} mm and {rot_deg:.2} deg RMS, {worst_mm:.2} mm and {worst_deg:.2} deg at worst",
        r.poses,
        out.display(),
        clock.offset_s * 1e3,
        clock.sigma_s * 1e3,
    );
    let mut suspects = Vec::new();
    for &i in &fit.suspects {
        let (t_s, h) = (found.t_s[i], &fit.held_out[i]);
        let (off_mm, off_deg) = (h.distance_m() * 1e3, h.angle_rad().to_degrees());
        text.push_str(&format!(
            "\nnot used: the pose at {t_s:.2} s is {off_mm:.2} mm and {off_deg:.2} deg from what the others \
             predict"
        ));
        suspects.push(json!({"t_s": t_s, "pos_mm": off_mm, "rot_deg": off_deg}));
    }
    if clock.glitches > 0 {
        text.push_str(&format!(
            "\n{} of {} instants were left out of the offset as glitches",
            clock.glitches,
            clock.glitches + clock.instants
        ));
    }
    Report {
        text,
        json: json!({
            "poses": r.poses,
            "offset_ms": clock.offset_s * 1e3,
            "offset_sigma_ms": clock.sigma_s * 1e3,
            "correlation": clock.correlation,
            "glitches": clock.glitches,
            "base_from_world": transform(&r.base_from_world),
            "object_from_tip": transform(&r.object_from_tip),
            "loo": {
                "pos_mm_rms": pos_mm, "pos_mm_worst": worst_mm,
                "rot_deg_rms": rot_deg, "rot_deg_worst": worst_deg,
            },
            "suspects": suspects,
        }),
    }
}

#[cfg(test)]
mod tests {
    use springtwin::lab::session::{Excitation, SessionPlan, session, session_log};
    use springtwin::recording::{SessionLog, write_session};
    use springtwin::robot::RobotSpec;
    use springtwin::sensing::registration::Frames;
    use springtwin::signal::pose_from_ypr;

    use super::*;

    fn rig_log(excitation: Excitation) -> SessionLog {
        let robot = RobotSpec::reference();
        let plan = SessionPlan {
            name: "moved".into(),
            seed: 5,
            specimen: 1,
            seconds: 300.0,
            rate_hz: 50.0,
            excitation,
            payload_kg: 0.0,
            hidden: Vec::new(),
        };
        session_log(session(&robot, &plan).expect("runs"), &robot)
    }

    /// What motion capture would have written: its own world, its own object, its clock 0.8 s behind,
    /// one second in ten not seen.
    fn seen(log: &SessionLog, frames: &Frames) -> SessionLog {
        let (x, y) = (
            frames.base_from_world.inverse(),
            frames.object_from_tip.inverse(),
        );
        let mut out = log.clone();
        for k in 0..log.len() {
            out.t_s[k] -= 0.8;
            let hidden = log.t_s[k] % 10.0 < 1.0;
            out.truth[k] = log.truth[k].filter(|_| !hidden).map(|b| x * b * y);
        }
        out
    }

    fn args(dir: &Path) -> MocapArgs {
        MocapArgs {
            overwrite: Overwrite::default(),
            recording: dir.join("robot"),
            mocap: dir.join("mocap"),
            out: dir.join("registration.toml"),
            object: "flange".into(),
            object_is_pad: false,
            date: "2025-03-01".into(),
            about: 0.0,
            search: 10.0,
            // The unit's own networks.
            model: Some("assets/networks/unit-1/reference.safetensors".into()),
        }
    }

    /// Half past midnight in Vienna is another day in UTC.
    #[test]
    fn a_calibration_carries_the_local_time_with_its_offset() {
        let time: jiff::Timestamp = "2026-02-28T23:30:12Z".parse().expect("a time");
        let vienna = jiff::tz::TimeZone::fixed(jiff::tz::offset(1));
        assert_eq!(
            local_time(&time.to_zoned(vienna)),
            "2026-03-01 00:30 +01:00"
        );
        let now: jiff::Timestamp = jiff::fmt::strtime::parse("%Y-%m-%d %H:%M %:z", now())
            .and_then(|t| t.to_timestamp())
            .expect("reads back");
        assert!(jiff::Timestamp::now().duration_since(now).as_secs() < 120);
    }

    #[test]
    fn a_simulated_session_is_registered_and_one_at_rest_refused() {
        let dir = std::env::temp_dir().join(format!("springtwin-mocap-{}", std::process::id()));
        let frames = Frames {
            base_from_world: pose_from_ypr([1.2, -0.8, 0.4], [2.0, 0.3, -0.2]),
            object_from_tip: pose_from_ypr([0.01, 0.02, -0.03], [0.5, -0.1, 3.0]),
        };
        let write = |excitation| {
            let log = rig_log(excitation);
            write_session(&dir.join("robot"), &log).expect("writes");
            write_session(&dir.join("mocap"), &seen(&log, &frames)).expect("writes");
        };
        write(Excitation::Loads);
        let report = mocap(&args(&dir)).expect("registers");
        println!("{}\n{}", report.text, report.json);
        let number = |path: &str| {
            report
                .json
                .pointer(path)
                .and_then(Value::as_f64)
                .expect(path)
        };
        // At some millimetres per second a clock cannot be told to a millisecond.
        let sigma_ms = number("/offset_sigma_ms");
        assert!((number("/offset_ms") - 800.0).abs() < 3.0 * sigma_ms && sigma_ms < 40.0);
        assert!(number("/poses") >= 10.0);
        assert!(number("/loo/pos_mm_rms") < 5.0 && number("/loo/rot_deg_rms") < 3.0);
        let text = std::fs::read_to_string(dir.join("registration.toml")).expect("there");
        let file = Registration::from_toml(&text).expect("reads");
        assert_eq!((&*file.object, &*file.date), ("flange", "2025-03-01"));
        // The tip as motion capture measures it through the file, against the truth.
        let log = rig_log(Excitation::Loads);
        let raw = seen(&log, &frames);
        let off_m: Vec<f64> = (0..log.len())
            .filter_map(|k| {
                let seen = file.ground_truth_pose(&raw.truth[k]?);
                Some((seen.translation.vector - log.truth[k]?.translation.vector).norm())
            })
            .collect();
        let mean_m = off_m.iter().sum::<f64>() / off_m.len() as f64;
        // As good as the estimates it was registered to, whose constant part it takes over.
        let robot = estimated(&dir.join("robot"), args(&dir).model.as_deref()).expect("estimates");
        let estimates_m: f64 = (0..log.len())
            .filter_map(|k| {
                let estimate = robot.poses.get(k)?.1.translation.vector;
                Some((estimate - log.truth[k]?.translation.vector).norm())
            })
            .sum();
        let estimates_m = estimates_m / log.len() as f64;
        println!("mean from the truth: {mean_m} m, of the estimates {estimates_m} m");
        assert!(
            mean_m < 1.1 * estimates_m && mean_m < 2e-3,
            "{mean_m} {estimates_m}"
        );

        write(Excitation::Still);
        std::fs::remove_file(args(&dir).out).expect("was written");
        let e = format!("{:#}", mocap(&args(&dir)).expect_err("at rest"));
        assert!(e.contains("correlation") && e.contains("mocap"), "{e}");
        std::fs::remove_dir_all(&dir).expect("cleans up");
    }

    #[test]
    fn the_command_parses() {
        use clap::Parser as _;
        let line =
            "springtwin calibrate mocap a b --out c.toml --object x --date 2025-01-01 --about -3";
        assert!(crate::cli::program::Cli::try_parse_from(line.split(' ')).is_ok());
    }
}
