//! Calibration of a unit: the shipped one for the unit that it belongs to, else springs from the unit's own bench and
//! IMUs from a motion of its own.

use super::imus::calibrate_imus;
use super::plan::SessionError;
use crate::calibrate::bench::{PracticeBench, draw};
use crate::rig::{RigOptions, Unit};
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::bench::calibrate;
use crate::signal::SPRINGS;

/// Runs of the bench for springs that a fit refuses, the first one included.
const RUNS: usize = 3;

/// Seed of the motion that calibrates the IMUs: no study moves a rig with it.
const IMUS_SEED: u64 = 90;

/// The calibration of `unit`: springs, IMUs and the base's tilt.
///
/// # Errors
/// [`SessionError`] when a spring is refused in every run of the bench, or an IMU after its motion.
pub fn calibration_of(robot: &RobotSpec, unit: Unit) -> Result<Calibration, SessionError> {
    if is_shipped(robot, unit) {
        return Ok(Calibration::virtual_rig());
    }
    let options = RigOptions {
        unit,
        seed: IMUS_SEED,
        ..RigOptions::default()
    };
    calibrate_imus(robot, springs_of(robot, unit)?, &options)
}

fn is_shipped(robot: &RobotSpec, unit: Unit) -> bool {
    unit == Unit::default() && robot.base_hash == RobotSpec::reference().base_hash
}

/// The springs of `unit`, its IMUs as drawn: those of sessions were zeroed.
///
/// # Errors
/// As [`calibration_of`].
pub(super) fn springs_for(robot: &RobotSpec, unit: Unit) -> Result<Calibration, SessionError> {
    if !is_shipped(robot, unit) {
        return springs_of(robot, unit);
    }
    let shipped = Calibration::virtual_rig();
    Ok(Calibration {
        imus: Vec::new(),
        base_tilt_rad: [0.0; 2],
        ..shipped
    })
}

/// The springs of `unit` from its own bench.
///
/// # Errors
/// [`SessionError::Bench`] when a spring is refused in every run of the bench.
pub fn springs_of(robot: &RobotSpec, unit: Unit) -> Result<Calibration, SessionError> {
    let failed = |reason: String| SessionError::Bench {
        specimen: unit.0,
        reason,
    };
    let mut bench = PracticeBench::with_loose(None);
    let mut request = bench.draw_all();
    let mut made: Option<Calibration> = None;
    let mut refused = Vec::new();
    for _ in 0..RUNS {
        let log = draw(robot, unit, &request).map_err(|e| failed(format!("{e:#}")))?;
        let name = format!("virtual-rig unit {}", unit.0);
        let (fresh, verdicts) = calibrate(&log, &name, "simulated", robot.spring.range_m);
        match &mut made {
            Some(so_far) => so_far.springs.extend(fresh.springs),
            none => *none = Some(fresh),
        }
        let bad = verdicts.into_iter().filter_map(|(spring, verdict)| {
            let why = verdict.err()?;
            (1..=SPRINGS).contains(&spring).then_some((spring, why))
        });
        refused = bad.collect();
        if refused.is_empty() {
            break;
        }
        request = bench.redraw(refused.iter().map(|(spring, _)| spring - 1).collect());
    }
    match (made, refused.first()) {
        (_, Some((spring, why))) => Err(failed(format!("spring {spring}: {why}"))),
        (Some(mut made), None) => {
            made.springs.sort_by_key(|s| s.spring);
            Ok(made)
        }
        (None, None) => Err(failed("no run was made".to_owned())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_unit_has_springs_and_imus_of_its_own() {
        let robot = RobotSpec::reference();
        let of = |unit| calibration_of(&robot, Unit(unit)).expect("calibrates");
        assert_eq!(of(1), Calibration::virtual_rig());
        for unit in [2, 3, 0x5eed_0000_0000_0007] {
            let c = of(unit);
            assert_eq!(c.uncovered(), [] as [usize; 0], "unit {unit}");
            assert_eq!(c, of(unit));
            assert_ne!(c.springs, of(1).springs);
            assert_eq!(c.imus.len(), crate::signal::IMUS, "unit {unit}");
        }
    }
}
