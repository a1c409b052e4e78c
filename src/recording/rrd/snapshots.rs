//! The snapshots that the rows of a batch make.

use arrow::array::{Array, AsArray, ListArray};
use arrow::datatypes::{Float32Type, Float64Type, Int64Type, UInt32Type};
use rerun::TextLog;
use rerun::log::Chunk;

use super::columns::{Columns, times};
use super::schema::{COLUMNS, Kind, column};
use super::stored;
use crate::recording::{RecordedEvent, RecordingMeta};
use crate::signal::{
    Estimate, Goal, GroundTruth, Matrix6, PressureCommand, RawFrame, SIGNALS, SensorFrame,
    SensorRef, Snapshot, Stamp,
};

/// The values of a column, of whichever type.
enum Values<'a> {
    F64(&'a [f64]),
    F32(&'a [f32]),
    I64(&'a [i64]),
    U32(&'a [u32]),
    Text(&'a arrow::array::StringArray),
}

/// A column with what is in force at the present row.
struct Current<'a> {
    list: &'a ListArray,
    values: Values<'a>,
    width: usize,
    /// Where the present value lies; `None` where there is none.
    at: Option<(usize, usize)>,
    /// Rows with a new value, and times of the first and the last of them.
    seen: Option<(u64, i64, i64)>,
}

/// How often a column had a new value, and between which times, ns.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    pub(super) rows: u64,
    pub(super) first: i64,
    pub(super) last: i64,
}

/// The rows of one batch.
pub(super) struct Rows<'a> {
    times: &'a [i64],
    columns: Vec<Option<Current<'a>>>,
}

impl<'a> Rows<'a> {
    /// Looks into a batch.
    ///
    /// # Errors
    /// A sentence for a column of another type than it should have.
    pub(super) fn of(table: &'a Columns) -> Result<Self, String> {
        let columns = COLUMNS.iter().zip(&table.lists).map(|(spec, list)| {
            let Some(list) = list else {
                return Ok(None);
            };
            let values = list.values();
            let typed = match spec.kind {
                Kind::F64 => values
                    .as_primitive_opt::<Float64Type>()
                    .map(|v| Values::F64(v.values())),
                Kind::F32 => values
                    .as_primitive_opt::<Float32Type>()
                    .map(|v| Values::F32(v.values())),
                Kind::I64 => values
                    .as_primitive_opt::<Int64Type>()
                    .map(|v| Values::I64(v.values())),
                Kind::U32 => values
                    .as_primitive_opt::<UInt32Type>()
                    .map(|v| Values::U32(v.values())),
                Kind::Text => values.as_string_opt::<i32>().map(Values::Text),
            };
            let values = typed.ok_or_else(|| format!("{}: values of another type", spec.name))?;
            Ok(Some(Current {
                list,
                values,
                width: spec.width,
                at: None,
                seen: None,
            }))
        });
        Ok(Self {
            columns: columns.collect::<Result<_, String>>()?,
            times: &table.times,
        })
    }

    /// The snapshots of the rows that `wanted` selects by their times, in order.
    ///
    /// # Errors
    /// A sentence for a row of another width than its column.
    pub(super) fn snapshots(
        &mut self,
        meta: &RecordingMeta,
        mut wanted: impl FnMut(i64) -> bool,
    ) -> Result<Vec<Snapshot>, String> {
        let mut snapshots = Vec::with_capacity(self.times.len());
        for row in 0..self.times.len() {
            let t = self.times[row];
            for (spec, column) in COLUMNS.iter().zip(&mut self.columns) {
                if let Some(column) = column {
                    column
                        .go_to(row, t)
                        .map_err(|e| format!("{}: {e}", spec.name))?;
                }
            }
            if wanted(t) {
                snapshots.push(Snapshot::default());
                if let Some(new) = snapshots.last_mut() {
                    self.fill(new, t, meta);
                }
            }
        }
        Ok(snapshots)
    }

    /// What was seen of every column.
    pub(super) fn seen(&self) -> impl Iterator<Item = Option<Seen>> {
        self.columns.iter().map(|c| {
            let (rows, first, last) = c.as_ref()?.seen?;
            Some(Seen { rows, first, last })
        })
    }

    fn f64<const N: usize>(&self, column: usize) -> Option<[f64; N]> {
        let c = self.columns[column].as_ref()?;
        let (from, to) = c.at?;
        match &c.values {
            Values::F64(v) => v[from..to].try_into().ok(),
            Values::F32(v) => {
                let v: &[f32; N] = v[from..to].try_into().ok()?;
                Some(v.map(f64::from))
            }
            _ => None,
        }
    }

    fn i64<const N: usize>(&self, column: usize) -> Option<[i64; N]> {
        let c = self.columns[column].as_ref()?;
        let (from, to) = c.at?;
        match &c.values {
            Values::I64(v) => v[from..to].try_into().ok(),
            _ => None,
        }
    }

    fn u32<const N: usize>(&self, column: usize) -> Option<[u32; N]> {
        let c = self.columns[column].as_ref()?;
        let (from, to) = c.at?;
        match &c.values {
            Values::U32(v) => v[from..to].try_into().ok(),
            _ => None,
        }
    }

    fn text(&self, column: usize) -> String {
        let text = || {
            let c = self.columns[column].as_ref()?;
            let (from, to) = c.at?;
            match &c.values {
                Values::Text(v) if from < to && v.is_valid(from) => Some(v.value(from).to_owned()),
                _ => None,
            }
        };
        text().unwrap_or_default()
    }

    /// Puts the present row into a new snapshot, where it lies: a snapshot is large.
    fn fill(&self, snapshot: &mut Snapshot, t: i64, meta: &RecordingMeta) {
        snapshot.stamp = Stamp(t);
        snapshot.payload_kg = meta.payload_kg;
        snapshot.raw = self.raw();
        snapshot.sensors = self.sensors();
        snapshot.estimate = self.estimate();
        snapshot.truth = self.truth();
        snapshot.goal = self.goal();
        snapshot.sensor_ref = self.f64::<SIGNALS>(column::SENSOR_REF).map(SensorRef::from);
        snapshot.command = self.command();
        let link = self.f64(column::LINK);
        let counts = self.i64(column::LINK_COUNTS);
        let reason = || self.text(column::MODE_REASON);
        stored::set_tick(snapshot, meta, link, counts, reason);
    }

    fn raw(&self) -> Option<RawFrame> {
        let raw = stored::Raw {
            frame: self.i64(column::RAW_FRAME)?,
            clocks: self.f64(column::RAW_CLOCKS)?,
            counts: self.u32(column::RAW_COUNTS)?,
            gates: self.u32(column::RAW_GATES)?,
            gyro_rad_s: self.f64(column::RAW_GYRO)?,
            accel_m_s2: self.f64(column::RAW_ACCEL)?,
            chamber_pa: self.f64(column::RAW_PRESSURE)?,
        };
        Some(raw.frame())
    }

    fn sensors(&self) -> Option<SensorFrame> {
        let [stamp] = self.i64(column::SENSOR_STAMP)?;
        let sensors = stored::Sensors {
            stamp,
            codes: self
                .u32::<{ stored::CODES }>(column::HEALTH)?
                .map(i64::from),
            spring_m: self.f64(column::SPRINGS)?,
            imu_rad: self.f64(column::IMUS)?,
            chamber_pa: self.f64(column::PRESSURE)?,
            delivered: self.f64(column::DELIVERED),
            extra_sigma: self.f64(column::EXTRA_SIGMA),
        };
        Some(sensors.frame())
    }

    fn estimate(&self) -> Option<Estimate> {
        let [stamp] = self.i64(column::ESTIMATE_STAMP)?;
        let triangle: [f64; 21] = self.f64(column::COVARIANCE)?;
        let mut covariance = Matrix6::zeros();
        let places = (0..6).flat_map(|c| (c..6).map(move |r| (r, c)));
        for ((r, c), value) in places.zip(triangle) {
            covariance[(r, c)] = value;
            covariance[(c, r)] = value;
        }
        let values = self.f64(column::ESTIMATE)?;
        Some(stored::estimate(stamp, &values, covariance))
    }

    fn truth(&self) -> Option<GroundTruth> {
        let values = self.f64(column::MOCAP_POSE)?;
        Some(stored::truth(self.i64(column::MOCAP)?, &values))
    }

    fn goal(&self) -> Option<Goal> {
        let [aim] = self.i64(column::GOAL)?;
        let point_m = self.f64(column::GOAL_POINT).unwrap_or_default();
        let goal = stored::goal(aim, &self.f64(column::GOAL_POSE)?);
        Some(Goal { point_m, ..goal })
    }

    fn command(&self) -> Option<PressureCommand> {
        let ints = self.i64(column::COMMAND)?;
        Some(stored::command(ints, self.f64(column::SET)?))
    }
}

impl Current<'_> {
    /// Makes a row the present one.
    fn go_to(&mut self, row: usize, t: i64) -> Result<(), String> {
        if self.list.is_null(row) {
            return Ok(());
        }
        let offsets = self.list.value_offsets();
        let (from, to) = (offsets[row] as usize, offsets[row + 1] as usize);
        if from == to {
            self.at = None;
            return Ok(());
        }
        if to - from != self.width {
            return Err(format!("{} values, {} expected", to - from, self.width));
        }
        self.at = Some((from, to));
        let (rows, _, last) = self.seen.get_or_insert((0, t, t));
        *rows += 1;
        *last = t;
        Ok(())
    }
}

/// The lines of a text log.
pub(super) fn events(chunk: &Chunk) -> Vec<RecordedEvent> {
    let path = chunk.entity_path().to_string();
    let list = chunk
        .components()
        .get_array(TextLog::descriptor_text().component);
    let (Some(list), Some(times)) = (list, times(chunk)) else {
        return Vec::new();
    };
    let mut events = Vec::new();
    for (i, t) in times.iter().enumerate() {
        if list.is_null(i) {
            continue;
        }
        let row = list.value(i);
        if let Some(text) = row.as_string_opt::<i32>()
            && !text.is_empty()
            && text.is_valid(0)
        {
            events.push(RecordedEvent {
                stamp: Stamp(*t),
                log: path.trim_start_matches('/').to_owned(),
                text: text.value(0).to_owned(),
            });
        }
    }
    events
}
