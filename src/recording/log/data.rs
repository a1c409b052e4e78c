//! A session log in memory.

use crate::signal::{
    CHAMBERS, ChannelHealth, GroundTruth, Health, IMUS, Pose, Quality, SIGNALS, SPRINGS,
    SensorFrame, SensorVec, Snapshot, Stamp, Trace, TruthSource,
};

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
    /// Hash of the robot file it was recorded with; empty when unknown.
    pub robot: String,
}

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
                        quality: Quality::default(),
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

/// Median distance of neighbouring times, s; `None` below two samples.
pub(crate) fn median_step_s(t_s: &[f64]) -> Option<f64> {
    median(t_s.windows(2).map(|w| w[1] - w[0]))
}

/// Middle of the finite values; `None` without any.
pub(super) fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut v: Vec<f64> = values.filter(|x| x.is_finite()).collect();
    let middle = v.len() / 2;
    (!v.is_empty()).then(|| *v.select_nth_unstable_by(middle, f64::total_cmp).1)
}
