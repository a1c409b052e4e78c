//! Session logs: a folder with `session.toml` and `log.csv`, one row per sample.
//!
//! | columns of `log.csv` | unit | |
//! |---|---|---|
//! | `t_s` | s | time, strictly increasing |
//! | `p1_kpa` .. `p6_kpa` | kPa | measured gauge pressure |
//! | `spring1_mm` .. `spring12_mm` | mm | spring length |
//! | `imu1_yaw_deg`, `imu1_pitch_deg`, `imu1_roll_deg`, .. `imu4_*` | deg | pad under each IMU |
//! | `vicon_x_mm`, `vicon_y_mm`, `vicon_z_mm`, `vicon_yaw_deg`, `vicon_pitch_deg`, `vicon_roll_deg` | mm, deg | end pad in the base frame; all six or none |
//! | `u1_kpa` .. `u6_kpa` | kPa | commanded gauge pressure; all six or none |
//! | `payload_kg` | kg | optional |
//!
//! Columns come in any order, others are ignored, an empty cell is a gap. In memory everything is
//! SI and a gap is NaN (or `None` for a pose).

mod read;
mod write;

use crate::signal::{
    CHAMBERS, ChannelHealth, GroundTruth, Health, IMUS, Pose, SIGNALS, SPRINGS, SensorFrame,
    SensorVec, Snapshot, Stamp, Trace, TruthSource, ypr_from_rotation,
};
pub(crate) use read::{median_step_s, not_our_header};
pub use read::{parse_log, read_session, read_session_with};
pub(crate) use write::write_whole;
pub use write::{SESSION_FILES, write_bytes, write_session, write_text};

/// A session log in memory: columns of equal length, SI units.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SessionLog {
    /// Name of the session.
    pub name: String,
    /// Nominal sample rate, Hz.
    pub rate_hz: f64,
    /// Mass the operator believes is attached, kg.
    pub payload_kg: f64,
    /// Time of each sample, s, strictly increasing.
    pub t_s: Vec<f64>,
    /// Measured gauge pressure per chamber, Pa; NaN where missing.
    pub chamber_pa: Vec<[f64; CHAMBERS]>,
    /// The 24 sensor signals; NaN where missing.
    pub sensors: Vec<SensorVec>,
    /// Motion capture's pose of the end pad, base from tip; `None` where missing.
    pub truth: Vec<Option<Pose>>,
    /// Commanded gauge pressure per chamber, Pa, if it was logged; NaN where missing.
    pub commanded_pa: Option<Vec<[f64; CHAMBERS]>>,
    /// Attached mass, kg, if it was logged per sample; NaN where missing.
    pub payload_column_kg: Option<Vec<f64>>,
    /// SHA-256 of the file, hexadecimal; empty for a log that came from no file.
    pub hash: String,
    /// Hash of the robot file it was recorded with; empty when it does not say.
    pub robot: String,
}

const YPR: [&str; 3] = ["yaw", "pitch", "roll"];
const VICON: [&str; 6] = [
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

const KPA: f64 = 1e3;
const MM: f64 = 1e-3;
const DEG: f64 = std::f64::consts::PI / 180.0;

impl SessionLog {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.t_s.len()
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.t_s.is_empty()
    }

    /// The log as snapshots: calibrated sensors with their health and motion capture.
    ///
    /// A missing channel is [`ChannelHealth::Missing`] and holds its last good value (its first
    /// good one before that). A log's commands were not built through a robot's limits, so the
    /// snapshots carry none: they stay in [`SessionLog::commanded_pa`].
    pub fn to_trace(&self) -> Trace {
        let mut held_spring_m = std::array::from_fn(|i| {
            first_finite(self.sensors.iter().map(|s: &SensorVec| s.spring_m[i]))
        });
        let mut held_ypr_rad: [[f64; 3]; IMUS] = std::array::from_fn(|i| {
            std::array::from_fn(|k| first_finite(self.sensors.iter().map(|s| s.imu_ypr_rad[i][k])))
        });
        let mut held_pa = std::array::from_fn(|i| {
            first_finite(self.chamber_pa.iter().map(|p: &[f64; CHAMBERS]| p[i]))
        });
        let snapshots = (0..self.len())
            .map(|n| {
                let stamp = Stamp::from_seconds(self.t_s[n]);
                let s = &self.sensors[n];
                let mut health = Health::default();
                for i in 0..SPRINGS {
                    health.springs[i] = hold(&mut held_spring_m[i..=i], &s.spring_m[i..=i]);
                }
                for (i, held_rad) in held_ypr_rad.iter_mut().enumerate() {
                    health.imus[i] = hold(held_rad, &s.imu_ypr_rad[i]);
                }
                for i in 0..CHAMBERS {
                    health.chambers[i] = hold(&mut held_pa[i..=i], &self.chamber_pa[n][i..=i]);
                }
                Snapshot {
                    stamp,
                    sensors: Some(SensorFrame {
                        stamp,
                        extra_sigma: [0.0; SIGNALS],
                        sensors: SensorVec {
                            spring_m: held_spring_m,
                            imu_ypr_rad: held_ypr_rad,
                        },
                        chamber_pa: held_pa,
                        health,
                    }),
                    truth: self.truth[n].map(|base_from_tip| GroundTruth {
                        stamp,
                        base_from_tip,
                        source: TruthSource::Vicon,
                    }),
                    payload_kg: self.payload_kg,
                    ..Snapshot::default()
                }
            })
            .collect();
        Trace {
            name: self.name.clone(),
            snapshots,
            payload_kg: self.payload_kg,
            simulated: None,
        }
    }

    /// A log of the calibrated sensors, motion capture and commands of a trace.
    ///
    /// Snapshots whose time does not advance are left out; channels that cannot be used become
    /// gaps. `rate_hz` is the nominal rate.
    pub fn from_trace(trace: &Trace, rate_hz: f64) -> Self {
        let mut log = Self {
            name: trace.name.clone(),
            rate_hz,
            payload_kg: trace.payload_kg,
            ..Self::default()
        };
        let mut commanded = Vec::new();
        let mut last = None;
        for snapshot in &trace.snapshots {
            if last.is_some_and(|t| snapshot.stamp <= t) {
                continue;
            }
            last = Some(snapshot.stamp);
            let mut chamber_pa = [f64::NAN; CHAMBERS];
            let mut sensors = SensorVec {
                spring_m: [f64::NAN; SPRINGS],
                imu_ypr_rad: [[f64::NAN; 3]; IMUS],
            };
            if let Some(frame) = &snapshot.sensors {
                let missing = |h: ChannelHealth| h == ChannelHealth::Missing;
                for i in (0..CHAMBERS).filter(|i| !missing(frame.health.chambers[*i])) {
                    chamber_pa[i] = frame.chamber_pa[i];
                }
                for i in (0..SPRINGS).filter(|i| !missing(frame.health.springs[*i])) {
                    sensors.spring_m[i] = frame.sensors.spring_m[i];
                }
                for i in (0..IMUS).filter(|i| !missing(frame.health.imus[*i])) {
                    sensors.imu_ypr_rad[i] = frame.sensors.imu_ypr_rad[i];
                }
            }
            log.t_s.push(snapshot.stamp.seconds());
            log.chamber_pa.push(chamber_pa);
            log.sensors.push(sensors);
            log.truth
                .push(snapshot.truth.as_ref().map(|t| t.base_from_tip));
            commanded.push(
                snapshot
                    .command
                    .as_ref()
                    .map_or([f64::NAN; CHAMBERS], |c| *c.chamber_pa()),
            );
        }
        if commanded.iter().flatten().any(|v| v.is_finite()) {
            log.commanded_pa = Some(commanded);
        }
        log
    }
}

fn first_finite(mut values: impl Iterator<Item = f64>) -> f64 {
    values.find(|v| v.is_finite()).unwrap_or(0.0)
}

/// Takes `new` into `held` when all of it is there.
fn hold(held: &mut [f64], new: &[f64]) -> ChannelHealth {
    if new.iter().all(|v| v.is_finite()) {
        held.copy_from_slice(new);
        ChannelHealth::Ok
    } else {
        ChannelHealth::Missing
    }
}

#[cfg(test)]
mod tests;
