//! The snapshots that a file's rows make.

use super::Content;
use crate::recording::RecordingMeta;
use crate::recording::rrd::schema::{SAFE_PREFIX, health_from};
use crate::recording::rrd::snapshots::{pose, recorded_command};
use crate::recording::rrd::v1::schema::table;
use crate::signal::{
    BOARDS, CHAMBERS, Delivered, Estimate, Goal, Gripper, GroundTruth, Health, IMUS, ImuRaw,
    LinkStatus, Matrix6, Mode, OrientationGoal, PressureCommand, Quality, RawFrame, SIGNALS,
    SPRINGS, SensorFrame, SensorRef, SensorVec, Snapshot, Stamp, TruthSource,
};

impl Content {
    /// The snapshots of all rows, which are brought in order of time.
    pub fn snapshots(&mut self, meta: &RecordingMeta) -> Vec<Snapshot> {
        for rows in self.scalars.iter_mut().chain(&mut self.exact) {
            rows.sort();
        }
        for rows in &mut self.ints {
            rows.sort();
        }
        self.events.sort_by_key(|e| e.stamp);
        let mut ticks = self.ints[table::TICK].times.clone();
        ticks.dedup();
        let modes = self.events.iter().filter(|e| e.log == "mode").map(|e| {
            let reason = e.text.strip_prefix(SAFE_PREFIX).unwrap_or_default();
            (e.stamp, reason.to_owned())
        });
        let mut next_mode = modes.collect::<Vec<_>>().into_iter().peekable();
        let mut reason = String::new();
        let mut snapshots = Vec::with_capacity(ticks.len());
        for t in ticks {
            while let Some((_, text)) = next_mode.next_if(|(s, _)| s.0 <= t) {
                reason = text;
            }
            snapshots.push(self.snapshot(t, meta, &reason));
        }
        snapshots
    }

    fn snapshot(&mut self, t: i64, meta: &RecordingMeta, reason: &str) -> Snapshot {
        let mut snapshot = Snapshot {
            stamp: Stamp(t),
            payload_kg: meta.payload_kg,
            raw: self.raw(t),
            sensors: self.sensors(t),
            estimate: self.estimate(t),
            truth: self.truth(t),
            goal: self.goal(t),
            sensor_ref: self.sensor_ref(t),
            command: self.command(t),
            ..Snapshot::default()
        };
        if let Some([connected, age_s, rate_0, rate_1, payload_kg]) =
            fixed(self.exact[table::TICK].row(t))
        {
            snapshot.payload_kg = payload_kg;
            snapshot.link = LinkStatus {
                connected: connected != 0.0,
                source: meta.source.clone(),
                simulated: meta.simulated == Some(true),
                age_s,
                board_rate_hz: [rate_0, rate_1],
                ..LinkStatus::default()
            };
        }
        if let Some([frames, frames_lost, mode]) = fixed(self.ints[table::TICK].row(t)) {
            snapshot.link.frames = frames as u64;
            snapshot.link.frames_lost = frames_lost as u64;
            snapshot.mode = match mode {
                1 => Mode::Hold,
                2 => Mode::Moving,
                3 => Mode::AtGoal,
                4 => Mode::Safe(reason.to_owned()),
                _ => Mode::Disarmed,
            };
        }
        snapshot
    }

    fn raw(&mut self, t: i64) -> Option<RawFrame> {
        let [rate_hz, age_0, age_1] = fixed(self.exact[table::RAW_FRAME].row(t))?;
        // Recordings of before both clocks were measured have the nominal rate alone.
        let clocks = fixed(self.exact[table::CLOCKS].row(t));
        let [rate_0, rate_1, sd_0, sd_1] = clocks.unwrap_or([rate_hz, rate_hz, 0.0, 0.0]);
        let [seq, stamp, present, faults] = fixed(self.ints[table::RAW_FRAME].row(t))?;
        let counts: [f64; SPRINGS] = fixed(self.scalars[table::COUNTS].row(t))?;
        let gates: [f64; SPRINGS] = fixed(self.scalars[table::GATES].row(t))?;
        let gyro: [f64; 3 * IMUS] = fixed(self.scalars[table::GYRO].row(t))?;
        let accel: [f64; 3 * IMUS] = fixed(self.scalars[table::ACCEL].row(t))?;
        let board_age_s: [f64; BOARDS] = [age_0, age_1];
        Some(RawFrame {
            seq: seq as u32,
            stamp: Stamp(stamp),
            // Doubles hold every u32.
            spring_counts: counts.map(|c| c as u32),
            spring_gate_ticks: gates.map(|c| c as u32),
            tick_rate_hz: [rate_0, rate_1],
            tick_rate_sd: [sd_0, sd_1],
            imu: std::array::from_fn(|i| ImuRaw {
                gyro_rad_s: std::array::from_fn(|k| gyro[3 * i + k]),
                accel_m_s2: std::array::from_fn(|k| accel[3 * i + k]),
            }),
            chamber_pa: fixed(self.scalars[table::RAW_PRESSURE].row(t))?,
            present: present as u32,
            board_age_s,
            faults: faults as u16,
        })
    }

    fn sensors(&mut self, t: i64) -> Option<SensorFrame> {
        let codes: [i64; 1 + SPRINGS + IMUS + CHAMBERS] = fixed(self.ints[table::HEALTH].row(t))?;
        let health = |i: usize| health_from(codes[1 + i]);
        let imu_rad: [f64; 3 * IMUS] = fixed(self.exact[table::IMUS].row(t))?;
        Some(SensorFrame {
            stamp: Stamp(codes[0]),
            extra_sigma: [0.0; SIGNALS],
            delivered: fixed(self.exact[table::DELIVERED].row(t))
                .map(|values| Delivered::from_array(&values))
                .unwrap_or_default(),
            sensors: SensorVec {
                spring_m: fixed(self.exact[table::SPRINGS].row(t))?,
                imu_ypr_rad: std::array::from_fn(|i| std::array::from_fn(|k| imu_rad[3 * i + k])),
            },
            chamber_pa: fixed(self.exact[table::PRESSURE].row(t))?,
            health: Health {
                springs: std::array::from_fn(health),
                imus: std::array::from_fn(|i| health(SPRINGS + i)),
                chambers: std::array::from_fn(|i| health(SPRINGS + IMUS + i)),
            },
            quality: Quality::default(),
        })
    }

    fn estimate(&mut self, t: i64) -> Option<Estimate> {
        let [stamp] = fixed(self.ints[table::PREDICTED].row(t))?;
        let values = self.exact[table::PREDICTED].row(t)?;
        Some(Estimate {
            stamp: Stamp(stamp),
            base_from_tip: pose(&values[..7]),
            training_distance: values[7],
            covariance: Matrix6::from_column_slice(&values[8..44]),
        })
    }

    fn truth(&mut self, t: i64) -> Option<GroundTruth> {
        let [stamp, source] = fixed(self.ints[table::VICON].row(t))?;
        Some(GroundTruth {
            stamp: Stamp(stamp),
            base_from_tip: pose(self.exact[table::VICON].row(t)?),
            source: match source {
                0 => TruthSource::Vicon,
                _ => TruthSource::VirtualRig,
            },
        })
    }

    fn goal(&mut self, t: i64) -> Option<Goal> {
        let [present, aim] = fixed(self.ints[table::GOAL].latest(t))?;
        let values = self.exact[table::GOAL].latest(t)?;
        (present != 0).then(|| Goal {
            position_m: [values[0], values[1], values[2]],
            orientation: match aim {
                0 => OrientationGoal::Free,
                1 => OrientationGoal::Rotation(pose(values).rotation),
                _ => OrientationGoal::Direction(nalgebra::Unit::new_normalize(
                    nalgebra::Vector3::new(values[3], values[4], values[5]),
                )),
            },
            tolerance_m: values[7],
        })
    }

    fn sensor_ref(&mut self, t: i64) -> Option<SensorRef> {
        let spring_m: [f64; SPRINGS] = fixed(self.exact[table::SPRING_REF].row(t))?;
        let imu_rad: [f64; 3 * IMUS] = fixed(self.exact[table::IMU_REF].row(t))?;
        Some(SensorRef::from_iterator(
            spring_m.into_iter().chain(imu_rad),
        ))
    }

    fn command(&mut self, t: i64) -> Option<PressureCommand> {
        let [stamp, gripper] = fixed(self.ints[table::SET].row(t))?;
        let recorded_pa: [f64; CHAMBERS] = fixed(self.exact[table::SET].row(t))?;
        let gripper = match gripper {
            0 => Some(Gripper::Open),
            1 => Some(Gripper::Closed),
            _ => None,
        };
        Some(recorded_command(Stamp(stamp), recorded_pa, gripper))
    }
}

fn fixed<T: Copy, const N: usize>(row: Option<&[T]>) -> Option<[T; N]> {
    row?.try_into().ok()
}
