//! The snapshots that a file's rows make.

use super::Content;
use crate::recording::RecordingMeta;
use crate::recording::rrd::schema::SAFE_PREFIX;
use crate::recording::rrd::stored;
use crate::recording::rrd::v1::schema::table;
use crate::signal::{
    Estimate, Goal, GroundTruth, IMUS, Matrix6, PressureCommand, RawFrame, SPRINGS, SensorFrame,
    SensorRef, Snapshot, Stamp,
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
        let link = fixed(self.exact[table::TICK].row(t));
        let counts = fixed(self.ints[table::TICK].row(t));
        stored::set_tick(&mut snapshot, meta, link, counts, || reason.to_owned());
        snapshot
    }

    fn raw(&mut self, t: i64) -> Option<RawFrame> {
        let [rate_hz, age_0, age_1] = fixed(self.exact[table::RAW_FRAME].row(t))?;
        // Recordings of before both clocks were measured have the nominal rate alone.
        let clocks = fixed(self.exact[table::CLOCKS].row(t));
        let [rate_0, rate_1, sd_0, sd_1] = clocks.unwrap_or([rate_hz, rate_hz, 0.0, 0.0]);
        let counts: [f64; SPRINGS] = fixed(self.scalars[table::COUNTS].row(t))?;
        let gates: [f64; SPRINGS] = fixed(self.scalars[table::GATES].row(t))?;
        let raw = stored::Raw {
            frame: fixed(self.ints[table::RAW_FRAME].row(t))?,
            clocks: [rate_0, rate_1, sd_0, sd_1, age_0, age_1],
            // Doubles hold every u32.
            counts: counts.map(|c| c as u32),
            gates: gates.map(|c| c as u32),
            gyro_rad_s: fixed(self.scalars[table::GYRO].row(t))?,
            accel_m_s2: fixed(self.scalars[table::ACCEL].row(t))?,
            chamber_pa: fixed(self.scalars[table::RAW_PRESSURE].row(t))?,
        };
        Some(raw.frame())
    }

    fn sensors(&mut self, t: i64) -> Option<SensorFrame> {
        let ints: [i64; 1 + stored::CODES] = fixed(self.ints[table::HEALTH].row(t))?;
        let sensors = stored::Sensors {
            stamp: ints[0],
            codes: std::array::from_fn(|i| ints[1 + i]),
            spring_m: fixed(self.exact[table::SPRINGS].row(t))?,
            imu_rad: fixed(self.exact[table::IMUS].row(t))?,
            chamber_pa: fixed(self.exact[table::PRESSURE].row(t))?,
            delivered: fixed(self.exact[table::DELIVERED].row(t)),
            extra_sigma: None,
        };
        Some(sensors.frame())
    }

    fn estimate(&mut self, t: i64) -> Option<Estimate> {
        let [stamp] = fixed(self.ints[table::PREDICTED].row(t))?;
        let values: [f64; 44] = fixed(self.exact[table::PREDICTED].row(t))?;
        let first = std::array::from_fn(|i| values[i]);
        let covariance = Matrix6::from_column_slice(&values[8..]);
        Some(stored::estimate(stamp, &first, covariance))
    }

    fn truth(&mut self, t: i64) -> Option<GroundTruth> {
        let ints = fixed(self.ints[table::VICON].row(t))?;
        let values = fixed(self.exact[table::VICON].row(t))?;
        Some(stored::truth(ints, &values))
    }

    fn goal(&mut self, t: i64) -> Option<Goal> {
        let [present, aim] = fixed(self.ints[table::GOAL].latest(t))?;
        let values = fixed(self.exact[table::GOAL].latest(t))?;
        (present != 0).then(|| stored::goal(aim, &values))
    }

    fn sensor_ref(&mut self, t: i64) -> Option<SensorRef> {
        let spring_m: [f64; SPRINGS] = fixed(self.exact[table::SPRING_REF].row(t))?;
        let imu_rad: [f64; 3 * IMUS] = fixed(self.exact[table::IMU_REF].row(t))?;
        Some(SensorRef::from_iterator(
            spring_m.into_iter().chain(imu_rad),
        ))
    }

    fn command(&mut self, t: i64) -> Option<PressureCommand> {
        let ints = fixed(self.ints[table::SET].row(t))?;
        let recorded_pa = fixed(self.exact[table::SET].row(t))?;
        Some(stored::command(ints, recorded_pa))
    }
}

fn fixed<T: Copy, const N: usize>(row: Option<&[T]>) -> Option<[T; N]> {
    row?.try_into().ok()
}
