//! The columns of a session log: their names, units and values.

use super::data::SessionLog;
use crate::signal::{CHAMBERS, IMUS, SPRINGS, ypr_from_rotation};

pub(super) const KPA: f64 = 1e3;
pub(super) const MM: f64 = 1e-3;
pub(super) const DEG: f64 = std::f64::consts::PI / 180.0;

pub(super) const YPR: [&str; 3] = ["yaw", "pitch", "roll"];
pub(super) const VICON: [&str; 6] = [
    "vicon_x_mm",
    "vicon_y_mm",
    "vicon_z_mm",
    "vicon_yaw_deg",
    "vicon_pitch_deg",
    "vicon_roll_deg",
];

/// Names of the columns this program writes, in order, without the optional ones.
pub(crate) fn column_names() -> Vec<String> {
    let mut names = vec!["t_s".to_owned()];
    names.extend((1..=CHAMBERS).map(|i| format!("p{i}_kpa")));
    names.extend((1..=SPRINGS).map(|i| format!("spring{i}_mm")));
    names.extend((1..=IMUS).flat_map(|i| YPR.map(|a| format!("imu{i}_{a}_deg"))));
    names.extend(VICON.map(str::to_owned));
    names
}

/// One column of a log: the value of a row in the unit of the column's name, NaN where it is missing.
pub(crate) type Column<'a> = (String, Box<dyn Fn(usize) -> f64 + 'a>);

/// Every column that a log has values for, in the order of [`column_names`], then the optional ones.
pub(crate) fn columns(log: &SessionLog) -> Vec<Column<'_>> {
    let mut out: Vec<Column<'_>> = Vec::new();
    let mut names = column_names().into_iter().skip(1);
    let mut name = || names.next().unwrap_or_default();
    for i in 0..CHAMBERS {
        out.push((name(), Box::new(move |n| log.chamber_pa[n][i] / KPA)));
    }
    for i in 0..SPRINGS {
        out.push((name(), Box::new(move |n| log.sensors[n].spring_m[i] / MM)));
    }
    for i in 0..IMUS {
        for k in 0..3 {
            let angle = move |n: usize| log.sensors[n].imu_ypr_rad[i][k] / DEG;
            out.push((name(), Box::new(angle)));
        }
    }
    // A log without motion capture lacks a system, not cells.
    if log.truth.iter().any(Option::is_some) {
        for k in 0..6 {
            let value = move |n: usize| match &log.truth[n] {
                None => f64::NAN,
                Some(pose) if k < 3 => pose.translation.vector[k] / MM,
                Some(pose) => ypr_from_rotation(&pose.rotation)[k - 3] / DEG,
            };
            out.push((name(), Box::new(value)));
        }
    }
    if let Some(rows) = &log.commanded_pa {
        for i in 0..CHAMBERS {
            let value = move |n: usize| rows[n][i] / KPA;
            out.push((format!("u{}_kpa", i + 1), Box::new(value)));
        }
    }
    if let Some(rows) = &log.payload_column_kg {
        out.push(("payload_kg".to_owned(), Box::new(move |n| rows[n])));
    }
    out
}
