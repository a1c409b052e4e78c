//! Readings that look like another unit than the one in their column's name.
//!
//! Columns whose usual value no such arm can have are refused when a log is read. This module checks numbers that are
//! possible by themselves but inconsistent with each other: the springs determine how far the arm moves, and pressures,
//! angles and positions have to agree. The result is a suspicion; nothing is converted.

use super::SessionLog;
use crate::signal::{CHAMBERS, IMUS, SPRINGS};

/// Change of a spring's length per pressure of the arms that this program is for, m/Pa: 75 mm at 40 kPa.
const SPRING_PER_PRESSURE_M_PA: f64 = 0.075 / 40e3;
/// A unit is suspected when its factor explains a ratio to within this factor.
const WITHIN: f64 = 2.5;
/// Difference of the springs' lengths within a segment per tilt of its pad, m/rad.
const SPRINGS_PER_TILT_M_RAD: f64 = 0.13;
/// Smallest change of the springs' lengths that allows a judgement, m.
const SPRINGS_MOVE_M: f64 = 0.02;
/// Springs per segment.
const PER_SEGMENT: usize = SPRINGS / 2;

/// Readings that look like another unit than their channel's, a sentence each: which, what was read, what is expected.
pub fn suspected_units(log: &SessionLog) -> Vec<String> {
    let springs_m = spread(log.sensors.iter().map(|s| s.spring_m));
    let mut out = Vec::new();
    out.extend(pressures(log, springs_m));
    let tilt_rad = tilt_rad(log);
    out.extend(angles(log, tilt_rad));
    out.extend(captured(log, tilt_rad));
    out.extend(times(log));
    out.extend(payload(log));
    out
}

/// Largest difference between a column's high and low values, in the middle 96 % of each: single absurd readings are the
/// business of whoever judges the channels' health. 0 without values.
fn spread<const N: usize>(rows: impl Iterator<Item = [f64; N]>) -> f64 {
    let mut columns: [Vec<f64>; N] = std::array::from_fn(|_| Vec::new());
    for row in rows {
        for (column, v) in columns.iter_mut().zip(row) {
            column.extend(v.is_finite().then_some(v));
        }
    }
    let between = |column: &mut Vec<f64>| {
        let (low, high) = (quantile(column, 0.02)?, quantile(column, 0.98)?);
        Some(high - low)
    };
    columns.iter_mut().filter_map(between).fold(0.0, f64::max)
}

/// The value below which a share of the values lies; `None` without any.
fn quantile(values: &mut [f64], share: f64) -> Option<f64> {
    let last = values.len().checked_sub(1)?;
    let at = (last as f64 * share).round() as usize;
    Some(*values.select_nth_unstable_by(at, f64::total_cmp).1)
}

fn pressures(log: &SessionLog, springs_m: f64) -> Option<String> {
    let pressures_pa = spread(log.chamber_pa.iter().copied());
    if springs_m < SPRINGS_MOVE_M || pressures_pa <= 0.0 {
        return None;
    }
    let ratio = springs_m / pressures_pa / SPRING_PER_PRESSURE_M_PA;
    let named = [("psi", 6.894757), ("bar", 100.0), ("MPa", 1e3)];
    let (unit, _) = named.iter().find(|(_, factor)| {
        let off = ratio / factor;
        (1.0 / WITHIN..WITHIN).contains(&off)
    })?;
    Some(format!(
        "p1_kpa to p{CHAMBERS}_kpa look like {unit}: they change by at most {:.3}, while the springs change by {:.0} mm; \
         kPa is expected",
        pressures_pa / 1e3,
        springs_m * 1e3
    ))
}

/// the largest tilt of a pad that the springs show, rad.
fn tilt_rad(log: &SessionLog) -> f64 {
    let in_segment = |springs_m: &[f64]| {
        let high = springs_m.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        high - springs_m.iter().copied().fold(f64::INFINITY, f64::min)
    };
    let mut most_m: f64 = 0.0;
    for segment in 0..2 {
        let own = segment * PER_SEGMENT..(segment + 1) * PER_SEGMENT;
        let each = log
            .sensors
            .iter()
            .map(|s| in_segment(&s.spring_m[own.clone()]));
        let mut apart_m: Vec<f64> = each.filter(|m| m.is_finite()).collect();
        most_m = most_m.max(quantile(&mut apart_m, 0.98).unwrap_or(0.0));
    }
    most_m / SPRINGS_PER_TILT_M_RAD
}

/// Whether angles that were read as degrees are radians, given how far the pads tilt.
fn are_radians(read_rad: f64, tilt_rad: f64) -> bool {
    // A full turn in radians; what tilts by less is lost in mountings and headings.
    let turn_deg = std::f64::consts::TAU;
    let tilts = tilt_rad > SPRINGS_MOVE_M / SPRINGS_PER_TILT_M_RAD;
    tilts && read_rad > 0.0 && read_rad.to_degrees() <= turn_deg && read_rad * 8.0 < tilt_rad
}

fn angles(log: &SessionLog, tilt_rad: f64) -> Option<String> {
    let read_rad = spread(log.sensors.iter().map(|s| {
        let mut all = [f64::NAN; 3 * IMUS];
        all.copy_from_slice(s.imu_ypr_rad.as_flattened());
        all
    }));
    are_radians(read_rad, tilt_rad).then(|| {
        format!(
            "imu1_yaw_deg to imu{IMUS}_roll_deg look like radians: they change by at most {:.3}, while the springs show a \
             tilt of {:.0} deg; degrees are expected",
            read_rad.to_degrees(),
            tilt_rad.to_degrees()
        )
    })
}

fn captured(log: &SessionLog, tilt_rad: f64) -> Vec<String> {
    let mut out = Vec::new();
    let poses = || log.truth.iter().flatten();
    let farthest_m = poses()
        .map(|p| p.translation.vector.amax())
        .fold(0.0, f64::max);
    // No arm of this kind is tracked within 2 mm of the origin throughout; one within 2 m is.
    if farthest_m > 0.0 && farthest_m < 2e-3 {
        out.push(format!(
            "vicon_x_mm to vicon_z_mm look like metres: the largest is {:.4}; mm are expected",
            farthest_m * 1e3
        ));
    }
    let read_rad = spread(poses().map(|p| crate::signal::ypr_from_rotation(&p.rotation)));
    if are_radians(read_rad, tilt_rad) {
        out.push(format!(
            "vicon_yaw_deg to vicon_roll_deg look like radians: they change by at most {:.3}, while the springs show a \
             tilt of {:.0} deg; degrees are expected",
            read_rad.to_degrees(),
            tilt_rad.to_degrees()
        ));
    }
    out
}

fn times(log: &SessionLog) -> Option<String> {
    let step_s = super::log::median_step_s(&log.t_s)?;
    (step_s >= 1.0).then(|| {
        format!("t_s looks like milliseconds: it usually steps by {step_s}; seconds are expected")
    })
}

fn payload(log: &SessionLog) -> Option<String> {
    let per_row = log.payload_column_kg.iter().flatten().copied();
    let most_kg = per_row
        .chain([log.payload_kg])
        .filter(|kg| kg.is_finite())
        .fold(0.0, f64::max);
    (most_kg >= 5.0).then(|| {
        format!("payload_kg looks like grams: it is {most_kg}; kg are expected, and such an arm carries less than one")
    })
}

/// What a length in a column of mm looks like, when its usual value is no spring's; with the range that is expected.
pub(super) fn length_unit(middle_mm: f64, expected_mm: [f64; 2]) -> Option<&'static str> {
    by_factor(
        middle_mm,
        expected_mm,
        &[
            ("metres", 1e3),
            ("inches", 25.4),
            ("centimetres", 10.0),
            ("micrometres", 1e-3),
        ],
    )
}

/// What a pressure in a column of kPa looks like, when its usual value is beyond any gauge.
pub(super) fn pressure_unit(middle_kpa: f64, expected_kpa: [f64; 2]) -> Option<&'static str> {
    by_factor(
        middle_kpa,
        expected_kpa,
        &[("hPa (mbar)", 0.1), ("Pa", 1e-3)],
    )
}

fn by_factor(
    middle: f64,
    [low, high]: [f64; 2],
    units: &[(&'static str, f64)],
) -> Option<&'static str> {
    let fits = |factor: f64| (low..=high).contains(&(middle * factor));
    units.iter().find(|(_, f)| fits(*f)).map(|(unit, _)| *unit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::{SensorVec, pose_from_ypr};

    /// An arm that bends: each row another pressure, springs and pads as they follow.
    fn log() -> SessionLog {
        let mut log = SessionLog::default();
        for n in 0..200 {
            let share = (f64::from(n) * 0.1).sin();
            let bend_m = 0.04 * share;
            let tilt_rad = 2.0 * bend_m / SPRINGS_PER_TILT_M_RAD;
            log.t_s.push(f64::from(n) * 0.02);
            log.chamber_pa
                .push([21e3 * share, -21e3 * share, 0.0, 5e3, 0.0, 1e3]);
            let mut spring_m = [0.15; SPRINGS];
            spring_m[0] += bend_m;
            spring_m[2] -= bend_m;
            log.sensors.push(SensorVec {
                spring_m,
                imu_ypr_rad: [[0.1, tilt_rad, -0.05]; IMUS],
            });
            log.truth.push(Some(pose_from_ypr(
                [0.1 * share, 0.0, -0.3],
                [0.1, tilt_rad, -0.05],
            )));
        }
        log
    }

    /// The one sentence that a log is given.
    fn said(log: &SessionLog) -> String {
        match &suspected_units(log)[..] {
            [one] => one.clone(),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn an_arm_in_its_units_raises_no_suspicion() {
        assert!(
            suspected_units(&log()).is_empty(),
            "{:?}",
            suspected_units(&log())
        );
        assert!(suspected_units(&SessionLog::default()).is_empty());
    }

    #[test]
    fn another_unit_is_named_with_its_columns() {
        let scaled_pressure = |factor: f64| {
            let mut log = log();
            log.chamber_pa
                .as_flattened_mut()
                .iter_mut()
                .for_each(|p| *p /= factor);
            said(&log)
        };
        assert!(scaled_pressure(6.894757).starts_with("p1_kpa to p6_kpa look like psi"));
        assert!(scaled_pressure(100.0).contains("look like bar"));

        let mut radians = log();
        for s in &mut radians.sensors {
            s.imu_ypr_rad
                .as_flattened_mut()
                .iter_mut()
                .for_each(|a| *a = a.to_radians());
        }
        assert!(said(&radians).starts_with("imu1_yaw_deg to imu4_roll_deg look like radians"));

        let mut metres = log();
        for pose in metres.truth.iter_mut().flatten() {
            pose.translation.vector *= 1e-3;
        }
        assert!(said(&metres).contains("vicon_x_mm to vicon_z_mm look like metres"));

        let mut turned = log();
        for pose in turned.truth.iter_mut().flatten() {
            let [x, y, z] = pose.translation.vector.into();
            let ypr = crate::signal::ypr_from_rotation(&pose.rotation).map(f64::to_radians);
            *pose = pose_from_ypr([x, y, z], ypr);
        }
        assert!(said(&turned).contains("vicon_yaw_deg to vicon_roll_deg look like radians"));

        let mut milliseconds = log();
        milliseconds.t_s.iter_mut().for_each(|t| *t *= 1e3);
        assert!(said(&milliseconds).contains("milliseconds"));

        let mut grams = log();
        grams.payload_kg = 200.0;
        assert!(said(&grams).contains("grams"));
    }

    #[test]
    fn units_are_found_by_their_factor() {
        assert_eq!(length_unit(0.15, [70.0, 240.0]), Some("metres"));
        assert_eq!(length_unit(15.0, [70.0, 240.0]), Some("centimetres"));
        assert_eq!(length_unit(6.0, [70.0, 240.0]), Some("inches"));
        assert_eq!(length_unit(3.0e9, [70.0, 240.0]), None);
        assert_eq!(pressure_unit(30_000.0, [0.0, 42.0]), Some("Pa"));
        assert_eq!(pressure_unit(300.0, [0.0, 42.0]), Some("hPa (mbar)"));
    }
}
