//! Versions of a calibration: what is saved, and what one calibration changes against another.

use std::sync::Arc;

use crate::sensing::Calibration;
use crate::sensing::registration::Registration;
use crate::signal::{IMUS, SPRINGS};

/// A saved calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct Version {
    /// Number, from 1.
    pub number: u32,
    /// Local time at which it was saved, with its offset from UTC (`2026-03-01 14:05 +01:00`); a day (UTC) where an earlier
    /// program saved it.
    pub date: String,
    /// What passed, one line.
    pub note: String,
    /// Whether the program starts with it.
    pub active: bool,
    /// What it holds, or why its files cannot be read: one sentence.
    pub kept: Result<Kept, String>,
}

/// Content of a version.
#[derive(Clone, Debug, PartialEq)]
pub struct Kept {
    /// The calibration.
    pub calibration: Arc<Calibration>,
    /// The registration of motion capture saved with it; `None` if there is none.
    pub registration: Option<Registration>,
    /// SHA-256 of the networks that were learned with it; `None` if there are none.
    pub networks: Option<String>,
}

impl Kept {
    /// That it has networks, with the beginning of their hash; `None` if it has none.
    pub fn with_networks(&self) -> Option<String> {
        let hash = self.networks.as_deref()?;
        let start = hash.get(..8).unwrap_or(hash);
        Some(format!("with networks of its own ({start})"))
    }
}

/// A version to save; the date is set when it is saved.
#[derive(Clone, Debug, PartialEq)]
pub struct NewVersion {
    /// What passed, one line.
    pub note: String,
    /// The calibration, with its name.
    pub calibration: Calibration,
    /// The registration of motion capture; `None` if there is none.
    pub registration: Option<Registration>,
    /// Networks that were learned with this calibration: content of their file; `None` if there are none.
    pub networks: Option<Vec<u8>>,
}

/// Whether two calibrations read alike, whatever their names.
pub fn same(a: &Calibration, b: &Calibration) -> bool {
    a.springs == b.springs && a.imus == b.imus && a.base_tilt_rad == b.base_tilt_rad
}

/// Differences of calibration `new` from `old`, one line each; `range_m` is the range of lengths in use, shortest first.
pub fn changes(old: &Calibration, new: &Calibration, range_m: [f64; 2]) -> Vec<String> {
    let mut lines = Vec::new();
    let (mut changed, mut fresh, mut worst_m) = (Vec::new(), Vec::new(), 0.0_f64);
    for i in 0..SPRINGS {
        match (old.spring(i), new.spring(i)) {
            (a, b) if a == b => {}
            (Some(a), Some(b)) => {
                // Largest difference of the two curves over the readings that both cover.
                let low = a.curve.domain[0].max(b.curve.domain[0]);
                let high = a.curve.domain[1].min(b.curve.domain[1]);
                for k in 0..=40 {
                    let reading = low + (high - low) * f64::from(k) / 40.0;
                    let lengths = (a.curve.length_m(reading), b.curve.length_m(reading));
                    if let (Some(was_m), Some(is_m)) = lengths
                        && (range_m[0]..=range_m[1]).contains(&is_m)
                    {
                        worst_m = worst_m.max((was_m - is_m).abs());
                    }
                }
                changed.push((i + 1).to_string());
            }
            _ => fresh.push((i + 1).to_string()),
        }
    }
    let all = |list: &[String], n: usize| match list.len() == n {
        true => format!("all {n}"),
        false => list.join(", "),
    };
    if !changed.is_empty() {
        lines.push(format!(
            "Springs {}: lengths move by up to {:.2} mm",
            all(&changed, SPRINGS),
            worst_m * 1e3
        ));
    }
    if !fresh.is_empty() {
        lines.push(format!(
            "Springs {}: had no curve before",
            all(&fresh, SPRINGS)
        ));
    }
    for i in 0..IMUS {
        let turn_rad = old.mounting(i).angle_to(&new.mounting(i));
        // Rounding is no change.
        if turn_rad > 1e-6 {
            lines.push(format!(
                "IMU {}: mounting turned by {:.2}°",
                i + 1,
                turn_rad.to_degrees()
            ));
        }
        let (was, is) = (old.imu_zero(i), new.imu_zero(i));
        if was != is {
            lines.push(format!(
                "IMU {}: zero moved by {:.2}°/s and {:.3} m/s²",
                i + 1,
                (is.gyro_bias_rad_s - was.gyro_bias_rad_s)
                    .norm()
                    .to_degrees(),
                (is.accel_bias_m_s2 - was.accel_bias_m_s2).norm()
            ));
        }
    }
    let tilt_rad = old.level_from_base().angle_to(&new.level_from_base());
    if tilt_rad > 1e-6 {
        lines.push(format!(
            "Base: tilt changed by {:.2}°",
            tilt_rad.to_degrees()
        ));
    }
    lines
}
