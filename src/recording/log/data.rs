//! A session log in memory.

use crate::recording::Selection;
use crate::signal::{
    CHAMBERS, ChannelHealth, GroundTruth, Health, IMUS, PAIR_S, Pose, Quality, SIGNALS, SPRINGS,
    SensorErrors, SensorFrame, SensorVec, Snapshot, Stamp, Trace, TruthSource, pose_between,
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
    /// Measured gauge pressure per chamber, 1 to 6, Pa; NaN where missing.
    pub chamber_pa: Vec<[f64; CHAMBERS]>,
    /// The 24 sensor signals; NaN where missing.
    pub sensors: Vec<SensorVec>,
    /// Motion capture's pose of the end pad, base from tip; `None` where missing.
    pub truth: Vec<Option<Pose>>,
    /// Commanded gauge pressure per chamber, Pa, NaN where missing; `None` if it was not logged.
    pub commanded_pa: Option<Vec<[f64; CHAMBERS]>>,
    /// Attached mass, kg, NaN where missing; `None` if it was not logged per sample.
    pub payload_column_kg: Option<Vec<f64>>,
    /// Whether the last line of the file was cut, and left out.
    pub cut: bool,
    /// SHA-256 of the file, hexadecimal; empty for a log that came from no file.
    pub hash: String,
    /// Hash of the robot file it was recorded with; empty when unknown.
    pub robot: String,
    /// Sensor errors of the robot's patches by which the readings were corrected; `None` for none.
    pub corrected_by: Option<SensorErrors>,
    /// Whether the data are simulated; `None` when unknown.
    pub simulated: Option<bool>,
}

impl SessionLog {
    /// With springs and IMUs as they would read without a correction of their errors.
    pub fn uncorrected(mut self) -> Self {
        if let Some(errors) = self.corrected_by.take() {
            self.sensors.iter_mut().for_each(|s| *s = errors.read(s));
        }
        self
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.t_s.len()
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.t_s.is_empty()
    }

    /// The samples of a part of it.
    pub fn part(mut self, part: &Selection) -> Self {
        let wanted: Vec<bool> = self
            .t_s
            .iter()
            .map(|t_s| part.contains(Stamp::from_seconds(*t_s).0))
            .collect();
        fn keep<T>(rows: &mut Vec<T>, wanted: &[bool]) {
            let mut wanted = wanted.iter();
            rows.retain(|_| wanted.next().is_none_or(|w| *w));
        }
        keep(&mut self.t_s, &wanted);
        keep(&mut self.chamber_pa, &wanted);
        keep(&mut self.sensors, &wanted);
        keep(&mut self.truth, &wanted);
        if let Some(rows) = &mut self.commanded_pa {
            keep(rows, &wanted);
        }
        if let Some(rows) = &mut self.payload_column_kg {
            keep(rows, &wanted);
        }
        self
    }

    /// Appends the rows of a log that goes on where this one ends.
    pub(crate) fn append(&mut self, mut more: Self) {
        let (mine, theirs) = (self.len(), more.len());
        let of = |log: &mut Self, n: usize| {
            log.commanded_pa
                .take()
                .unwrap_or_else(|| vec![[f64::NAN; CHAMBERS]; n])
        };
        if self.commanded_pa.is_some() || more.commanded_pa.is_some() {
            let mut rows = of(self, mine);
            rows.append(&mut of(&mut more, theirs));
            self.commanded_pa = Some(rows);
        }
        let declared =
            |log: &Self, n: usize| (0..n).map(|k| log.payload_at_kg(k)).collect::<Vec<_>>();
        let changes = mine > 0
            && (self.payload_column_kg.is_some()
                || more.payload_column_kg.is_some()
                || self.payload_kg != more.payload_kg);
        if mine == 0 {
            self.payload_kg = more.payload_kg;
            self.payload_column_kg = more.payload_column_kg.take();
        } else if changes && theirs > 0 {
            let mut rows = declared(self, mine);
            rows.extend(declared(&more, theirs));
            self.payload_column_kg = Some(rows);
        }
        self.t_s.append(&mut more.t_s);
        self.chamber_pa.append(&mut more.chamber_pa);
        self.sensors.append(&mut more.sensors);
        self.truth.append(&mut more.truth);
    }

    /// Payload that the operator declared for sample `k`, kg: of the column, where it has one, or of the whole session.
    pub fn payload_at_kg(&self, k: usize) -> f64 {
        let column_kg = self.payload_column_kg.as_ref();
        let own_kg = column_kg.and_then(|rows| rows.get(k).copied());
        own_kg
            .filter(|kg| kg.is_finite())
            .unwrap_or(self.payload_kg)
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
                        delivered: Default::default(),
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
                        source: match self.simulated {
                            Some(true) => TruthSource::VirtualRig,
                            _ => TruthSource::Vicon,
                        },
                    }),
                    payload_kg: self.payload_at_kg(n),
                    ..Snapshot::default()
                }
            })
            .collect();
        Trace {
            name: self.name.clone(),
            snapshots,
            payload_kg: self.payload_kg,
            simulated: self.simulated,
        }
    }

    /// A log of what a trace has measured: a row per frame of sensors, at its own time, with what the channels delivered
    /// ([`SensorFrame::measured`]), motion capture at that time, and the commands and the payload that were in force. What
    /// was held or reconstructed is a gap. `rate_hz` is the nominal rate.
    pub fn from_trace(trace: &Trace, rate_hz: f64) -> Self {
        Self::from_snapshots(trace, trace.snapshots.iter(), rate_hz)
    }

    /// The same of other snapshots than the trace's own; name and payload are the trace's.
    pub(crate) fn from_snapshots<'a>(
        trace: &Trace,
        snapshots: impl Iterator<Item = &'a Snapshot> + Clone,
        rate_hz: f64,
    ) -> Self {
        let mut log = Self {
            name: trace.name.clone(),
            simulated: trace.simulated,
            rate_hz,
            payload_kg: trace.payload_kg,
            ..Self::default()
        };
        let captured = Captured::of(snapshots.clone());
        let (mut commanded, mut payloads_kg) = (Vec::new(), Vec::new());
        let mut last = None;
        for snapshot in snapshots {
            // A frame that is shown again is measured once.
            let Some(frame) = &snapshot.sensors else {
                continue;
            };
            if last.is_some_and(|t| frame.stamp <= t) {
                continue;
            }
            last = Some(frame.stamp);
            let chamber_pa = std::array::from_fn(|i| match frame.health.chambers[i] {
                ChannelHealth::Missing => f64::NAN,
                _ => frame.chamber_pa[i],
            });
            log.t_s.push(frame.stamp.seconds());
            log.chamber_pa.push(chamber_pa);
            log.sensors.push(frame.measured());
            log.truth.push(captured.at(frame.stamp));
            payloads_kg.push(snapshot.payload_kg);
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
        match payloads_kg.first() {
            Some(first_kg) if payloads_kg.iter().all(|kg| kg == first_kg) => {
                log.payload_kg = *first_kg;
            }
            Some(_) => log.payload_column_kg = Some(payloads_kg),
            None => {}
        }
        log
    }
}

/// What motion capture saw, each pose once.
struct Captured(Vec<GroundTruth>);

impl Captured {
    fn of<'a>(snapshots: impl Iterator<Item = &'a Snapshot>) -> Self {
        let mut seen: Vec<GroundTruth> = Vec::new();
        for truth in snapshots.filter_map(|s| s.truth.as_ref()) {
            if seen.last().is_none_or(|last| truth.stamp > last.stamp) {
                seen.push(truth.clone());
            }
        }
        Self(seen)
    }

    /// The pose at a time, between the two poses around it; `None` where they are far apart, and beside the ends.
    fn at(&self, stamp: Stamp) -> Option<Pose> {
        let after = self.0.partition_point(|t| t.stamp < stamp);
        let next = self.0.get(after)?;
        if next.stamp == stamp {
            return Some(next.base_from_tip);
        }
        let before = self.0.get(after.checked_sub(1)?)?;
        let apart_s = next.stamp.since(before.stamp);
        let share = stamp.since(before.stamp) / apart_s;
        (apart_s <= PAIR_S).then(|| pose_between(&before.base_from_tip, &next.base_from_tip, share))
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
