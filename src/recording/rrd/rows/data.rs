//! The data of a batch: one table with a row per snapshot.

use std::sync::Arc;

use arrow::array::{ArrayRef, Float32Array, Float64Array, Int64Array, StringArray, UInt32Array};
use arrow::buffer::{NullBuffer, OffsetBuffer};
use arrow::datatypes::Field;
use rerun::external::arrow::array::ListArray;

use super::tables::own;
use crate::recording::rrd::scene::Part;
use crate::recording::rrd::schema::{self, COLUMNS, Kind, column};
use crate::signal::{
    ChannelHealth, Estimate, Goal, Gripper, GroundTruth, Matrix6, Mode, OrientationGoal, Pose,
    PressureCommand, RawFrame, SensorFrame, Snapshot, TruthSource,
};

/// Values of one type.
enum Values {
    F64(Vec<f64>),
    F32(Vec<f32>),
    I64(Vec<i64>),
    U32(Vec<u32>),
    Text(Vec<String>),
}

impl Values {
    fn new(kind: Kind) -> Self {
        match kind {
            Kind::F64 => Self::F64(Vec::new()),
            Kind::F32 => Self::F32(Vec::new()),
            Kind::I64 => Self::I64(Vec::new()),
            Kind::U32 => Self::U32(Vec::new()),
            Kind::Text => Self::Text(Vec::new()),
        }
    }

    fn array(self) -> ArrayRef {
        match self {
            Self::F64(v) => Arc::new(Float64Array::from(v)),
            Self::F32(v) => Arc::new(Float32Array::from(v)),
            Self::I64(v) => Arc::new(Int64Array::from(v)),
            Self::U32(v) => Arc::new(UInt32Array::from(v)),
            Self::Text(v) => Arc::new(StringArray::from(v)),
        }
    }

    fn len(&self) -> usize {
        match self {
            Self::F64(v) => v.len(),
            Self::F32(v) => v.len(),
            Self::I64(v) => v.len(),
            Self::U32(v) => v.len(),
            Self::Text(v) => v.len(),
        }
    }

    /// Appends a row; returns whether it is the one at `last`, and was not appended.
    fn repeats(&mut self, last: Option<(usize, usize)>, row: Row<'_>) -> bool {
        fn add<T: Clone>(
            all: &mut Vec<T>,
            last: Option<(usize, usize)>,
            row: impl ExactSizeIterator<Item = T> + Clone,
            same: fn(&T, &T) -> bool,
        ) -> bool {
            let repeats = last.is_some_and(|(from, to)| {
                to - from == row.len()
                    && all[from..to]
                        .iter()
                        .zip(row.clone())
                        .all(|(a, b)| same(a, &b))
            });
            if !repeats {
                all.extend(row);
            }
            repeats
        }
        match (self, row) {
            (Self::F64(all), Row::F64(row)) => add(all, last, row.iter().copied(), |a, b| {
                a.to_bits() == b.to_bits()
            }),
            (Self::F32(all), Row::F64(row)) => {
                let single = row.iter().map(|x| *x as f32);
                add(all, last, single, |a, b| a.to_bits() == b.to_bits())
            }
            (Self::I64(all), Row::I64(row)) => add(all, last, row.iter().copied(), |a, b| a == b),
            (Self::U32(all), Row::U32(row)) => add(all, last, row.iter().copied(), |a, b| a == b),
            (Self::Text(all), Row::Text(row)) => {
                let one = std::iter::once(row.to_owned());
                add(all, last, one, |a, b| a == b)
            }
            _ => unreachable!("a column is given the values of its type"),
        }
    }
}

/// Values of a row of one column.
#[derive(Clone, Copy)]
enum Row<'a> {
    F64(&'a [f64]),
    I64(&'a [i64]),
    U32(&'a [u32]),
    Text(&'a str),
}

/// A column since the batch began.
struct Growing {
    values: Values,
    /// Per row the number of values, or `None` for "as before".
    lengths: Vec<Option<usize>>,
    /// Where the newest value lies; empty for "none". `None` before the first row.
    last: Option<(usize, usize)>,
}

/// Rows of data since the last batch.
pub(super) struct Data {
    times: Vec<i64>,
    columns: Vec<Growing>,
    /// Parts of snapshots with a value that is not finite: they are recorded as "none".
    pub(super) rejected: u64,
}

impl Data {
    pub(super) fn new() -> Self {
        Self {
            times: Vec::new(),
            columns: fresh(),
            rejected: 0,
        }
    }

    /// Takes a snapshot.
    pub(super) fn push(&mut self, snapshot: &Snapshot) {
        self.times.push(snapshot.stamp.0);
        self.push_raw(snapshot.raw.as_ref());
        self.push_sensors(snapshot.sensors.as_ref());
        self.push_estimate(snapshot.estimate.as_ref());
        self.push_truth(snapshot.truth.as_ref());
        self.push_command(snapshot.command.as_ref());
        let reference = snapshot.sensor_ref.as_ref().map(|r| r.as_slice());
        let reference = reference.filter(|r| self.is_finite(r));
        self.set(column::SENSOR_REF, reference.map(Row::F64));
        self.push_goal(snapshot.goal.as_ref());
        let link = &snapshot.link;
        let [rate_0, rate_1] = link.board_rate_hz;
        let connected = f64::from(u8::from(link.connected));
        let values = [connected, link.age_s, rate_0, rate_1, snapshot.payload_kg];
        self.set(column::LINK, Some(Row::F64(&values)));
        let (mode, reason) = mode(&snapshot.mode);
        let counts = [link.frames as i64, link.frames_lost as i64, mode];
        self.set(column::LINK_COUNTS, Some(Row::I64(&counts)));
        self.set(column::MODE_REASON, Some(Row::Text(reason)));
    }

    fn set(&mut self, column: usize, row: Option<Row<'_>>) {
        let Growing {
            values,
            lengths,
            last,
        } = &mut self.columns[column];
        let from = values.len();
        let repeats = match row {
            Some(row) => values.repeats(*last, row),
            None => last.is_some_and(|(from, to)| from == to),
        };
        if repeats {
            lengths.push(None);
        } else {
            *last = Some((from, values.len()));
            lengths.push(Some(values.len() - from));
        }
    }

    /// Whether all values are finite; counts when not.
    fn is_finite(&mut self, values: &[f64]) -> bool {
        let finite = values.iter().all(|v| v.is_finite());
        self.rejected += u64::from(!finite);
        finite
    }

    fn push_raw(&mut self, raw: Option<&RawFrame>) {
        let raw = raw.map(|raw| {
            let gyro: Vec<f64> = raw.imu.iter().flat_map(|i| i.gyro_rad_s).collect();
            let accel: Vec<f64> = raw.imu.iter().flat_map(|i| i.accel_m_s2).collect();
            let clocks = [raw.tick_rate_hz, raw.tick_rate_sd, raw.board_age_s].concat();
            (raw, gyro, accel, clocks)
        });
        let raw = raw.filter(|(raw, gyro, accel, clocks)| {
            self.is_finite(&[gyro, accel, clocks, &raw.chamber_pa[..]].concat())
        });
        let raw = raw.as_ref();
        let frame = raw.map(|(raw, ..)| {
            let flags = [raw.present.into(), raw.faults.into()];
            [i64::from(raw.seq), raw.stamp.0, flags[0], flags[1]]
        });
        self.set(column::RAW_FRAME, frame.as_ref().map(|r| Row::I64(r)));
        self.set(column::RAW_CLOCKS, raw.map(|(.., clocks)| Row::F64(clocks)));
        self.set(
            column::RAW_COUNTS,
            raw.map(|(r, ..)| Row::U32(&r.spring_counts)),
        );
        self.set(
            column::RAW_GATES,
            raw.map(|(r, ..)| Row::U32(&r.spring_gate_ticks)),
        );
        self.set(column::RAW_GYRO, raw.map(|(_, gyro, ..)| Row::F64(gyro)));
        self.set(
            column::RAW_ACCEL,
            raw.map(|(_, _, accel, _)| Row::F64(accel)),
        );
        self.set(
            column::RAW_PRESSURE,
            raw.map(|(r, ..)| Row::F64(&r.chamber_pa)),
        );
    }

    fn push_sensors(&mut self, frame: Option<&SensorFrame>) {
        let frame = frame.filter(|frame| {
            let imu_rad = frame.sensors.imu_ypr_rad.as_flattened();
            let parts = [
                &frame.sensors.spring_m[..],
                imu_rad,
                &frame.chamber_pa,
                &frame.extra_sigma,
            ];
            self.is_finite(&parts.concat())
        });
        let stamp = frame.map(|f| [f.stamp.0]);
        self.set(column::SENSOR_STAMP, stamp.as_ref().map(|r| Row::I64(r)));
        let health = frame.map(|f| {
            let h = &f.health;
            let all = h.springs.iter().chain(&h.imus).chain(&h.chambers);
            all.map(|c: &ChannelHealth| schema::health_code(*c))
                .collect::<Vec<_>>()
        });
        self.set(column::HEALTH, health.as_ref().map(|r| Row::U32(r)));
        let springs = frame.map(|f| Row::F64(&f.sensors.spring_m));
        self.set(column::SPRINGS, springs);
        let imus = frame.map(|f| Row::F64(f.sensors.imu_ypr_rad.as_flattened()));
        self.set(column::IMUS, imus);
        self.set(column::PRESSURE, frame.map(|f| Row::F64(&f.chamber_pa)));
        // All channels are right most of the time.
        let delivered = frame.map(|f| f.delivered.to_array());
        let delivered = delivered.filter(|d| d.iter().any(|x| x.is_finite()));
        self.set(column::DELIVERED, delivered.as_ref().map(|r| Row::F64(r)));
        let sigma = frame.map(|f| &f.extra_sigma);
        let sigma = sigma.filter(|s| s.iter().any(|x| *x != 0.0));
        self.set(column::EXTRA_SIGMA, sigma.map(|r| Row::F64(r)));
    }

    fn push_estimate(&mut self, estimate: Option<&Estimate>) {
        let values = estimate.map(|e| {
            let [x, y, z, i, j, k, w] = pose_values(&e.base_from_tip);
            let exact = [x, y, z, i, j, k, w, e.training_distance];
            (e.stamp.0, exact, lower_triangle(&e.covariance))
        });
        let values = values
            .filter(|(_, exact, covariance)| self.is_finite(&[&exact[..], covariance].concat()));
        let values = values.as_ref();
        let stamp = values.map(|(stamp, ..)| Row::I64(std::slice::from_ref(stamp)));
        self.set(column::ESTIMATE_STAMP, stamp);
        self.set(
            column::ESTIMATE,
            values.map(|(_, exact, _)| Row::F64(exact)),
        );
        self.set(column::COVARIANCE, values.map(|(.., c)| Row::F64(c)));
    }

    fn push_truth(&mut self, truth: Option<&GroundTruth>) {
        let pose = truth.map(|g| {
            let source = match g.source {
                TruthSource::Vicon => 0,
                TruthSource::VirtualRig => 1,
            };
            ([g.stamp.0, source], pose_values(&g.base_from_tip))
        });
        let pose = pose.filter(|(_, pose)| self.is_finite(pose));
        let pose = pose.as_ref();
        self.set(column::MOCAP, pose.map(|(ints, _)| Row::I64(ints)));
        self.set(column::MOCAP_POSE, pose.map(|(_, pose)| Row::F64(pose)));
    }

    fn push_command(&mut self, command: Option<&PressureCommand>) {
        let command = command.filter(|c| self.is_finite(c.chamber_pa()));
        let ints = command.map(|c| {
            let gripper = match c.gripper() {
                Some(Gripper::Open) => 0,
                Some(Gripper::Closed) => 1,
                None => -1,
            };
            [c.stamp().0, gripper]
        });
        self.set(column::COMMAND, ints.as_ref().map(|r| Row::I64(r)));
        self.set(column::SET, command.map(|c| Row::F64(c.chamber_pa())));
    }

    fn push_goal(&mut self, goal: Option<&Goal>) {
        let point = |g: &&Goal| !g.is_of_tip() && self.is_finite(&g.point_m);
        let point_m = goal.filter(point).map(|g| &g.point_m);
        let goal = goal.map(goal_values);
        let goal = goal.filter(|(_, values)| self.is_finite(values));
        let goal = goal.as_ref();
        self.set(
            column::GOAL,
            goal.map(|(aim, _)| Row::I64(std::slice::from_ref(aim))),
        );
        self.set(column::GOAL_POSE, goal.map(|(_, values)| Row::F64(values)));
        self.set(column::GOAL_POINT, point_m.map(|p| Row::F64(p)));
    }

    /// Snapshots that wait.
    pub(super) fn waiting(&self) -> usize {
        self.times.len()
    }

    /// Takes the rows as one entity of a batch; the next one begins with full rows again.
    pub(super) fn take(&mut self) -> Result<Option<Part>, arrow::error::ArrowError> {
        let times = std::mem::take(&mut self.times);
        if times.is_empty() {
            return Ok(None);
        }
        let mut columns = Vec::with_capacity(COLUMNS.len());
        let grown = std::mem::replace(&mut self.columns, fresh());
        for (spec, column) in COLUMNS.iter().zip(grown) {
            let lengths = column.lengths.iter().map(|n| n.unwrap_or(0));
            let nulls: NullBuffer = column.lengths.iter().map(Option::is_some).collect();
            let values = column.values.array();
            let field = Arc::new(Field::new_list_field(values.data_type().clone(), true));
            let offsets = OffsetBuffer::from_lengths(lengths);
            let list = ListArray::try_new(field, offsets, values, Some(nulls))?;
            columns.push((own(spec.name), list));
        }
        Ok(Some(Part {
            path: schema::DATA,
            times,
            columns,
        }))
    }
}

fn fresh() -> Vec<Growing> {
    let column = |c: &schema::Column| Growing {
        values: Values::new(c.kind),
        lengths: Vec::new(),
        last: None,
    };
    COLUMNS.iter().map(column).collect()
}

/// x, y, z, i, j, k, w.
fn pose_values(pose: &Pose) -> [f64; 7] {
    let (p, q) = (&pose.translation, &pose.rotation);
    [p.x, p.y, p.z, q.i, q.j, q.k, q.w]
}

/// The entries on and below the diagonal, column by column.
fn lower_triangle(m: &Matrix6) -> [f64; 21] {
    let mut entries = (0..6).flat_map(|c| (c..6).map(move |r| m[(r, c)]));
    std::array::from_fn(|_| entries.next().unwrap_or(f64::NAN))
}

fn goal_values(goal: &Goal) -> (i64, [f64; 8]) {
    let [x, y, z] = goal.position_m;
    let (aim, [i, j, k, w]) = match goal.orientation {
        OrientationGoal::Free => (0, [0.0, 0.0, 0.0, 1.0]),
        OrientationGoal::Rotation(q) => (1, [q.i, q.j, q.k, q.w]),
        OrientationGoal::Direction(d) => (2, [d.x, d.y, d.z, 0.0]),
    };
    (aim, [x, y, z, i, j, k, w, goal.tolerance_m])
}

fn mode(mode: &Mode) -> (i64, &str) {
    match mode {
        Mode::Disarmed => (0, ""),
        Mode::Hold => (1, ""),
        Mode::Moving => (2, ""),
        Mode::AtGoal => (3, ""),
        Mode::Safe(reason) => (4, reason),
    }
}
