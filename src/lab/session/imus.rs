//! Calibration of a unit's IMUs as a lab makes it: a rest, then slow motion to all sides, with the springs as reference.

use std::f64::consts::TAU;

use super::excitation::Pumping;
use super::plan::SessionError;
use crate::lab::frames::raw_frame;
use crate::rig::{PHYSICS_STEP_S, RigOptions, VirtualRig};
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::imu_fit::{Capture, REST_S, Start, Windows, ends_sigma_m, first_rest, fit};
use crate::signal::{CHAMBERS, IMUS};

/// Rest before the motion, s: the arm settles, then the gyros are zeroed.
const STILL_S: f64 = REST_S + 4.0;
/// Length of the motion, s.
const MOTION_S: f64 = 80.0;
/// Rings per segment of the arm: half of the usual number, since pads and springs are all that matters here.
const RINGS: usize = 4;

/// `calibration`, whose springs are those of the unit in `options`, with the IMUs and the base's tilt of that rig.
///
/// # Errors
/// [`SessionError`] when the rig cannot be set up or follow the motion, or an IMU is refused.
pub fn calibrate_imus(
    robot: &RobotSpec,
    mut calibration: Calibration,
    options: &RigOptions,
) -> Result<Calibration, SessionError> {
    let failed = |reason: String| SessionError::Imus {
        specimen: options.unit.0,
        reason,
    };
    let rig = VirtualRig::of_rings(robot, options, RINGS);
    let mut rig = rig.map_err(|e| SessionError::Rig(e.to_string()))?;
    let mut maker = Windows::new(robot, &calibration);
    let mut windows = Vec::new();
    let steps = ((STILL_S + MOTION_S) / PHYSICS_STEP_S) as u32;
    for seq in 1..=steps {
        let t_s = f64::from(seq) * PHYSICS_STEP_S;
        rig.step(&set_pa(robot, t_s).map(Some));
        windows.extend(maker.push(&raw_frame(seq, &rig)));
    }
    if rig.refused_steps > 0 {
        let steps = rig.refused_steps;
        return Err(SessionError::Arm { steps });
    }
    let rest = first_rest(&windows, robot).map_err(|e| failed(e.to_string()))?;
    let mut captures: [Capture; IMUS] = Default::default();
    for w in &windows {
        for (i, capture) in captures.iter_mut().enumerate() {
            if let (Some(pad), Some(raw)) = (&w.base_from_pad[robot.imus[i].pad.index()], &w.imu[i])
            {
                capture.add(w.t_s, pad, raw);
            }
        }
    }
    let start = Start {
        gyro_bias_rad_s: rest.gyro_bias_rad_s,
        base_tilt_rad: [0.0; 2],
        springs_out: maker.springs_out(),
        ends_sigma_m: ends_sigma_m(&calibration),
    };
    let found = fit(robot, &captures.each_ref().map(Some), &start);
    for (i, of_imu) in found.imus.into_iter().flatten().enumerate() {
        let of_imu = of_imu.map_err(|e| failed(format!("IMU {}: {e}", i + 1)))?;
        let mut entry = of_imu.entry;
        calibration.date.clone_into(&mut entry.date);
        let put = calibration.set_imu(entry);
        put.map_err(|e| failed(e.to_string()))?;
    }
    calibration.base_tilt_rad = found.base_tilt_rad;
    Ok(calibration)
}

/// Set pressures of the rest and of a rose of four petals: both segments bend by cos 2φ towards φ, Pa.
fn set_pa(robot: &RobotSpec, t_s: f64) -> [f64; CHAMBERS] {
    let turn = TAU * ((t_s - STILL_S) / MOTION_S).clamp(0.0, 1.0);
    let most_pa = Pumping::of(robot).most_pa * (2.0 * turn).sin();
    std::array::from_fn(|i| {
        let at_m = robot.bellows_m[i].xy();
        let across_m = at_m.norm().max(f64::MIN_POSITIVE);
        most_pa * (at_m.x * turn.cos() + at_m.y * turn.sin()) / across_m
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lab::session::calibration::springs_of;
    use crate::rig::Unit;
    use crate::rig::hidden::Hidden;
    use crate::sensing::imu::credible;
    use nalgebra::{UnitQuaternion, Vector3};

    /// Over other poses: largest RMS angle between up by a pad's two IMUs, and of either from the truth, rad.
    fn up_off_rad(robot: &RobotSpec, c: &Calibration, options: &RigOptions) -> [f64; 2] {
        let other = RigOptions {
            seed: options.seed + 1,
            ..options.clone()
        };
        let mut rig = VirtualRig::new(robot, &other).expect("a rig");
        let most_pa = Pumping::of(robot).most_pa;
        let (mut apart, mut off, mut n) = ([0.0; 2], [0.0; IMUS], 0.0);
        for k in 0..24 {
            let at: [f64; CHAMBERS] =
                std::array::from_fn(|i| most_pa * (1.3 * f64::from(k) + 2.1 * i as f64).sin());
            rig.settle_at(&at).expect("settles");
            let mut mean = [Vector3::zeros(); IMUS];
            for seq in 0..100 {
                rig.dwell();
                let raw = raw_frame(seq, &rig);
                for (i, mean) in mean.iter_mut().enumerate() {
                    assert!(credible(&raw.imu[i]));
                    *mean += Vector3::from(c.imu_zero(i).remove(&raw.imu[i]).accel_m_s2) / 100.0;
                }
            }
            let up: [Vector3<f64>; IMUS] = std::array::from_fn(|i| {
                let drawn = UnitQuaternion::from_rotation_matrix(&robot.imus[i].pad_from_imu);
                c.mounting(i) * drawn * mean[i]
            });
            let truth = rig.plant.truth().base_from_pad;
            for (i, up) in up.iter().enumerate() {
                let pad = truth[1 + robot.imus[i].pad.index()].rotation;
                let level = c.level_from_base() * pad * up;
                off[i] += f64::powi(level.angle(&Vector3::z()), 2);
            }
            for pad in 0..2 {
                apart[pad] += up[2 * pad].angle(&up[2 * pad + 1]).powi(2);
            }
            n += 1.0;
        }
        let worst = |of: &[f64]| of.iter().fold(0.0, |w: f64, s| w.max((s / n).sqrt()));
        [worst(&apart), worst(&off)]
    }

    #[test]
    fn a_units_imus_are_calibrated_and_twice_alike() {
        let robot = RobotSpec::reference();
        for (unit, tilt_rad) in [(1, 0.0), (2, 0.05)] {
            let hidden = format!("base-tilt={tilt_rad}");
            let options = RigOptions {
                unit: Unit(unit),
                seed: 90,
                hidden: match tilt_rad > 0.0 {
                    true => vec![hidden.parse::<Hidden>().expect("an effect")],
                    false => Vec::new(),
                },
                ..RigOptions::default()
            };
            let springs = springs_of(&robot, Unit(unit)).expect("draws");
            let found = calibrate_imus(&robot, springs.clone(), &options).expect("calibrates");
            println!("unit {unit}");
            println!("tilt {:?} deg", found.base_tilt_rad.map(f64::to_degrees));
            for m in &found.imus {
                println!("{m:?}");
            }
            assert_eq!(found.imus.len(), IMUS);
            assert!(
                found
                    .to_toml()
                    .is_ok_and(|t| Calibration::from_toml(&t).is_ok())
            );
            if unit == 2 {
                let again = calibrate_imus(&robot, springs, &options).expect("calibrates");
                assert_eq!(found, again);
            }
            let [apart_deg, off_deg] = up_off_rad(&robot, &found, &options).map(f64::to_degrees);
            println!("apart {apart_deg:.3} deg, off {off_deg:.3} deg");
            assert!(apart_deg < 0.2, "{apart_deg}");
            // The springs hang half a millimetre off the drawing: the same for both IMUs of a pad.
            assert!(off_deg < 2.5, "{off_deg}");
        }
    }
}
