//! IMUs as delivered, and a base that hangs off level, after the lab's calibration of the IMUs.

use anyhow::Result;
use nalgebra::{UnitQuaternion, Vector3};

use super::groups::{Bar, Results};
use super::motion_seed;
use crate::lab::motions::{Arm, Motion, each_sent};
use crate::lab::session::calibrate_imus;
use crate::lab::study::item::Found;
use crate::lab::study::setup::Setup;
use crate::lab::units::{ALL, Lab, side_by_side};
use crate::rig::RigOptions;
use crate::rig::inertial::InertialErrors;
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::score::{Judged, score};
use crate::signal::IMUS;
use crate::twin::sensing_for;

/// How far the base hangs off level, rad, and the directions in which it does.
const TILT_RAD: f64 = 3.0 * std::f64::consts::PI / 180.0;
const DIRECTIONS: usize = 4;
/// Orientations count from here on, s of motion, one in so many.
const SETTLED_S: f64 = 10.0;
const EVERY: u32 = 5;
/// The motion, in lengths of the usual one.
const LONG: f64 = 10.0;
/// Seed of the calibrations beside that of the motions.
const CALIBRATION_SEED: u64 = 400;

/// The calibration of a lab with IMUs and base as they are in `options`.
fn calibrated(robot: &RobotSpec, lab: &Lab, options: &RigOptions) -> Result<Calibration> {
    let mut springs = lab.calibration.clone();
    springs.imus.clear();
    springs.base_tilt_rad = [0.0; 2];
    Ok(calibrate_imus(robot, springs, options)?)
}

/// Root mean square errors of inclination over a motion, deg: the worst IMU of a frame's orientations, and the worst pad
/// of the estimator's.
fn inclination_deg(
    robot: &RobotSpec,
    calibration: &Calibration,
    motion: &Motion,
    arm: &Arm,
) -> Result<[f64; 2]> {
    let mut sensing = sensing_for(robot, calibration);
    let mut pairs: [Vec<Judged>; 2 * IMUS] = Default::default();
    each_sent(robot, motion, arm, &mut |sent| {
        let frame = sensing.update(&sent.raw);
        if sent.t_s < SETTLED_S || !sent.raw.seq.is_multiple_of(EVERY) {
            return;
        }
        let pads = sensing.pads();
        for i in 0..IMUS {
            let pad = robot.imus[i].pad.index();
            let by_imu = UnitQuaternion::from_rotation_matrix(&frame.sensors.base_from_imu_pad(i));
            for (k, estimate) in [by_imu, pads[pad].rotation].into_iter().enumerate() {
                pairs[k * IMUS + i].push(Judged {
                    estimate,
                    reference: sent.base_from_pad[1 + pad].rotation,
                    counts: true,
                });
            }
        }
    })?;
    let worst = |pairs: &[Vec<Judged>]| {
        let each = pairs.iter().map(|p| score(p, p.len()).inclination_rad);
        each.fold(0.0, f64::max).to_degrees()
    };
    Ok([worst(&pairs[..IMUS]), worst(&pairs[IMUS..])])
}

/// Result of one calibration.
struct Calibrated {
    is_accepted: bool,
    inclination_deg: [f64; 2],
}

/// IMUs with the tolerances of their data sheet.
pub(super) fn as_delivered(setup: &mut Setup) -> Result<Found> {
    let labs = setup.labs(&ALL)?;
    let (robot, sizes) = (&setup.robot, setup.sizes);
    let seconds = LONG * sizes.seconds;
    let mut found = Found::default();
    for (label, inertial) in [
        (
            "IMUs as delivered, calibrated",
            InertialErrors::as_delivered(),
        ),
        (
            "IMUs zeroed by their maker, calibrated",
            InertialErrors::zeroed(),
        ),
    ] {
        let arm = Arm {
            inertial,
            ..Arm::default()
        };
        let made = side_by_side(&labs, |lab| {
            let motion = &Motion::of(lab.unit, seconds, motion_seed(sizes.seed, lab.unit) + 500);
            let options = RigOptions {
                seed: motion.seed + CALIBRATION_SEED,
                ..arm.options(motion)
            };
            let result = match calibrated(robot, lab, &options) {
                Ok(calibration) => Calibrated {
                    is_accepted: true,
                    inclination_deg: inclination_deg(robot, &calibration, motion, &arm)?,
                },
                Err(_) => Calibrated {
                    is_accepted: false,
                    inclination_deg: [f64::INFINITY; 2],
                },
            };
            Ok((motion.unit, result))
        })?;
        let results = Results::new(made);
        let row = |what: &str| format!("{label}: {what}");
        let all = Bar::AtLeast(100.0);
        results.add_share(&mut found, &row("calibration accepted, %"), all, |c| {
            c.is_accepted
        });
        let what = row("RMS inclination error of the worst IMU by VQF, deg (worst)");
        results.add_worst(&mut found, &what, Bar::AtMost(0.3), |c| {
            c.inclination_deg[0]
        });
        let what = row("the same of the worst pad by the estimator, deg (worst)");
        results.add_worst(&mut found, &what, Bar::None, |c| c.inclination_deg[1]);
        let what = row("estimator over VQF (worst)");
        results.add_worst(&mut found, &what, Bar::AtMost(1.0), |c| {
            c.inclination_deg[1] / c.inclination_deg[0]
        });
        found = found.after(seconds * ALL.len() as f64);
    }
    Ok(found)
}

/// A base that hangs off level.
pub(super) fn off_level(setup: &mut Setup) -> Result<Found> {
    let labs = setup.labs(&ALL)?;
    let mut found = Found::default();
    let sways = "base 3 deg off level on a mount that sways by a twentieth of that";
    for (label, mount, bar) in [
        ("base level", Mount::Level, Bar::AtMost(0.1)),
        ("base 3 deg off level", Mount::Bolted, Bar::AtMost(0.1)),
        (sways, Mount::Sways, Bar::None),
    ] {
        let mut jobs: Vec<(&Lab, [f64; 2])> = Vec::new();
        for lab in &labs {
            let directions = (0..DIRECTIONS).map(|k| {
                let turn = std::f64::consts::TAU * (k as f64 + 0.3) / DIRECTIONS as f64;
                (lab.as_ref(), [TILT_RAD * turn.cos(), TILT_RAD * turn.sin()])
            });
            match mount {
                Mount::Level => jobs.push((lab, [0.0; 2])),
                Mount::Bolted | Mount::Sways => jobs.extend(directions),
            }
        }
        let (robot, seed) = (&setup.robot, setup.sizes.seed);
        let made = side_by_side(&jobs, |(lab, tilt_rad)| {
            Ok((lab.unit, left_deg(robot, lab, mount, *tilt_rad, seed)?))
        })?;
        let results = Results::new(made);
        let what = format!("{label}: remaining after calibration, deg (worst)");
        results.add_worst(&mut found, &what, bar, |left| *left);
        let what = format!("{label}: remaining after calibration, deg (mean)");
        results.add_mean(&mut found, &what, Bar::None, |left| *left);
    }
    Ok(found)
}

/// What holds the base.
#[derive(Clone, Copy)]
enum Mount {
    Level,
    /// At a tilt that does not change.
    Bolted,
    /// As the hidden effect has it.
    Sways,
}

/// Angle between the true vertical (its mean, on a mount that sways) and the calibrated one, deg; infinite when the
/// calibration is refused.
fn left_deg(
    robot: &RobotSpec,
    lab: &Lab,
    mount: Mount,
    tilt_rad: [f64; 2],
    seed: u64,
) -> Result<f64> {
    let [x, y] = tilt_rad;
    let mut options = RigOptions {
        unit: lab.unit,
        seed: seed.wrapping_mul(1000) + lab.unit.0 + CALIBRATION_SEED,
        ..RigOptions::default()
    };
    match mount {
        Mount::Level => {}
        Mount::Bolted => options.surroundings.base_tilt_rad = tilt_rad,
        Mount::Sways => {
            let hidden = format!("base-tilt={x},{y}").parse();
            let hidden =
                hidden.map_err(|e| anyhow::anyhow!("the hidden tilt does not parse: {e}"))?;
            options.hidden.push(hidden);
        }
    }
    let Ok(calibration) = calibrated(robot, lab, &options) else {
        return Ok(f64::INFINITY);
    };
    // Gravity is turned by the tilt in the base's axes.
    let up = UnitQuaternion::from_scaled_axis(Vector3::new(x, y, 0.0)) * Vector3::z();
    let found = calibration.level_from_base().inverse() * Vector3::z();
    Ok(up.angle(&found).to_degrees())
}
