//! Data sets of settled samples as Parquet files: one row per sample, SI units in the names.
//!
//! | columns | unit | |
//! |---|---|---|
//! | `p1_pa` .. `p6_pa` | Pa | gauge pressure per chamber |
//! | `payload_kg` | kg | mass in the gripper |
//! | `force_x_n`, `force_y_n`, `force_z_n` | N | force on the end pad's origin, base frame |
//! | `spring1_m` .. `spring12_m` | m | spring length |
//! | `imu1_yaw_rad`, `imu1_pitch_rad`, `imu1_roll_rad`, .. `imu4_*` | rad | pad under each IMU |
//! | `x_m`, `y_m`, `z_m` | m | end pad's origin in the base frame |
//! | `qw`, `qx`, `qy`, `qz` | 1 | its rotation, base from tip, as unit quaternion |
//! | `off_nominal` | 1 | 1 for an arm off nominal or displaced pads, otherwise 0; 0 in files without the column |
//! | `yaw_rad`, `pitch_rad`, `roll_rad` | rad | the same rotation for other tools; not read back |
//!
//! The file's key-value metadata hold `springtwin.schema`, `springtwin.source`, `springtwin.seed`
//! and `springtwin.robot_hash`; in a part of a data set `springtwin.shard`, too, and for a trajectory
//! `springtwin.row_s`, the time between its rows in seconds. The same samples give the same bytes, however they are appended.

use std::fs::File;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray, Float64Array, RecordBatch};
use arrow::datatypes::{DataType, Field, Float64Type, Schema};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use parquet::arrow::arrow_writer::{ArrowWriter, ArrowWriterOptions};
use parquet::basic::{Compression, ZstdLevel};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;

use super::RecordingError;
use super::error::refuse;
use super::parquet_guard::{self, Wanted};
use super::size_limit::SizeLimit;
use crate::signal::{CHAMBERS, Dataset, IMUS, Pose, SPRINGS, Sample, SensorVec, ypr_from_rotation};

/// Version of the columns; a reader refuses any other.
const SCHEMA: &str = "1";
/// Rows per row group.
const GROUP_ROWS: usize = 4096;
/// Columns that are read back; three derived ones follow them in the file.
pub(super) const EXACT_COLUMNS: usize = CHAMBERS + 1 + 3 + SPRINGS + 3 * IMUS + 7 + 1;
pub(super) const COLUMNS: usize = EXACT_COLUMNS + 3;

/// Column that files of earlier versions lack.
const OFF_NOMINAL: &str = "off_nominal";

/// Most bytes that a sample takes on a disk while a data set is made: its row in the journal and, at the end, its row in
/// the file beside it.
pub const DATASET_SAMPLE_BYTES: u64 = 8 * (EXACT_COLUMNS + COLUMNS) as u64;

/// Names of the columns, in the file's order.
pub fn dataset_columns() -> Vec<String> {
    let mut names: Vec<String> = (1..=CHAMBERS).map(|i| format!("p{i}_pa")).collect();
    names.push("payload_kg".to_owned());
    names.extend(["x", "y", "z"].map(|a| format!("force_{a}_n")));
    names.extend((1..=SPRINGS).map(|i| format!("spring{i}_m")));
    names.extend(
        (1..=IMUS)
            .flat_map(|i| ["yaw", "pitch", "roll"].map(|angle| format!("imu{i}_{angle}_rad"))),
    );
    names.extend(["x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"].map(str::to_owned));
    names.push(OFF_NOMINAL.to_owned());
    names.extend(["yaw_rad", "pitch_rad", "roll_rad"].map(str::to_owned));
    names
}

pub(super) fn row_of(s: &Sample) -> [f64; COLUMNS] {
    let mut row = [0.0; COLUMNS];
    let p = &s.base_from_tip.translation;
    let q = &s.base_from_tip.rotation;
    let values = s
        .chamber_pa
        .into_iter()
        .chain([s.payload_kg])
        .chain(s.tip_force_n)
        .chain(s.sensors.spring_m)
        .chain(s.sensors.imu_ypr_rad.into_iter().flatten())
        .chain([p.x, p.y, p.z, q.w, q.i, q.j, q.k])
        .chain([f64::from(u8::from(s.off_nominal))])
        .chain(ypr_from_rotation(q));
    for (cell, value) in row.iter_mut().zip(values) {
        *cell = value;
    }
    row
}

/// The sample in a row, or the sentence why it is none.
pub(super) fn sample_of(row: &[f64; EXACT_COLUMNS]) -> Result<Sample, &'static str> {
    if row.iter().any(|v| !v.is_finite()) {
        return Err("a value is not finite");
    }
    let (chamber_pa, rest) = row.split_at(CHAMBERS);
    let (load, rest) = rest.split_at(4);
    let (spring_m, rest) = rest.split_at(SPRINGS);
    let (imu_rad, pose) = rest.split_at(3 * IMUS);
    let q = Quaternion::new(pose[3], pose[4], pose[5], pose[6]);
    if (q.norm() - 1.0).abs() > 1e-6 {
        return Err("the rotation is not a unit quaternion");
    }
    Ok(Sample {
        chamber_pa: std::array::from_fn(|i| chamber_pa[i]),
        payload_kg: load[0],
        tip_force_n: [load[1], load[2], load[3]],
        off_nominal: pose[7] != 0.0,
        sensors: SensorVec {
            spring_m: std::array::from_fn(|i| spring_m[i]),
            imu_ypr_rad: std::array::from_fn(|i| std::array::from_fn(|k| imu_rad[3 * i + k])),
        },
        // Not normalised again, so that the value read is the value written.
        base_from_tip: Pose::from_parts(
            Translation3::new(pose[0], pose[1], pose[2]),
            UnitQuaternion::new_unchecked(q),
        ),
    })
}

/// Appends samples to a new Parquet file.
///
/// The file appears under its name when [`DatasetWriter::finish`] succeeds; until then it lies
/// beside it with the ending `.part`.
pub struct DatasetWriter {
    path: PathBuf,
    part: PathBuf,
    schema: Arc<Schema>,
    writer: Option<ArrowWriter<File>>,
    pending: Vec<[f64; COLUMNS]>,
    rows: u64,
}

impl DatasetWriter {
    /// Begins a file. Of `about` the source, seed, robot hash, row interval and shard are stored; its samples are not.
    ///
    /// # Errors
    /// [`RecordingError::Io`] when the file cannot be made.
    pub fn create(path: &Path, about: &Dataset) -> Result<Self, RecordingError> {
        let fields: Vec<Field> = dataset_columns()
            .into_iter()
            .map(|name| Field::new(name, DataType::Float64, false))
            .collect();
        let schema = Arc::new(Schema::new(fields));
        let mut name = path.file_name().unwrap_or_default().to_owned();
        name.push(".part");
        let part = path.with_file_name(name);
        let file = File::create(&part).map_err(RecordingError::io(&part, "create"))?;
        let entry = |key: &str, value: String| KeyValue::new(format!("springtwin.{key}"), value);
        let mut metadata = vec![
            entry("schema", SCHEMA.to_owned()),
            entry("source", about.source.clone()),
            entry("seed", about.seed.to_string()),
            entry("robot_hash", about.robot_hash.clone()),
        ];
        metadata.extend(about.row_s.map(|s| entry("row_s", s.to_string())));
        metadata.extend(about.shard.iter().map(|s| entry("shard", s.clone())));
        let properties = WriterProperties::builder()
            .set_created_by("springtwin".to_owned())
            .set_compression(Compression::ZSTD(ZstdLevel::default()))
            // Distinct doubles gain nothing from a dictionary.
            .set_dictionary_enabled(false)
            .set_key_value_metadata(Some(metadata))
            .build();
        let options = ArrowWriterOptions::new()
            .with_properties(properties)
            .with_skip_arrow_metadata(true);
        let writer = ArrowWriter::try_new_with_options(file, schema.clone(), options)
            .map_err(|e| refuse(path, format!("cannot begin the file: {e}")))?;
        Ok(Self {
            path: path.to_owned(),
            part,
            schema,
            writer: Some(writer),
            pending: Vec::with_capacity(GROUP_ROWS),
            rows: 0,
        })
    }

    /// Appends samples; whole row groups go to the file at once.
    ///
    /// # Errors
    /// [`RecordingError::Dataset`] when writing fails.
    pub fn append(&mut self, samples: &[Sample]) -> Result<(), RecordingError> {
        for sample in samples {
            self.pending.push(row_of(sample));
            if self.pending.len() == GROUP_ROWS {
                self.write_group()?;
            }
        }
        Ok(())
    }

    /// Samples appended so far.
    pub fn rows(&self) -> u64 {
        self.rows + self.pending.len() as u64
    }

    fn write_group(&mut self) -> Result<(), RecordingError> {
        let Some(writer) = &mut self.writer else {
            return Ok(());
        };
        let columns: Vec<ArrayRef> = (0..COLUMNS)
            .map(|c| {
                let values: Vec<f64> = self.pending.iter().map(|row| row[c]).collect();
                Arc::new(Float64Array::from(values)) as ArrayRef
            })
            .collect();
        let path = &self.path;
        let failed = |e: String| refuse(path, format!("cannot write: {e}"));
        let batch = RecordBatch::try_new(self.schema.clone(), columns)
            .map_err(|e| failed(e.to_string()))?;
        writer.write(&batch).map_err(|e| failed(e.to_string()))?;
        writer.flush().map_err(|e| failed(e.to_string()))?;
        self.rows += self.pending.len() as u64;
        self.pending.clear();
        Ok(())
    }

    /// Writes what is left and gives the file its name. Returns the number of samples.
    ///
    /// # Errors
    /// [`RecordingError::Dataset`] or [`RecordingError::Io`] when writing fails.
    pub fn finish(mut self) -> Result<u64, RecordingError> {
        if !self.pending.is_empty() {
            self.write_group()?;
        }
        if let Some(writer) = self.writer.take() {
            let file = writer
                .into_inner()
                .map_err(|e| refuse(&self.path, format!("cannot end the file: {e}")))?;
            file.sync_all()
                .and_then(|()| std::fs::rename(&self.part, &self.path))
                .map_err(RecordingError::io(&self.path, "write"))?;
        }
        Ok(self.rows)
    }
}

impl Drop for DatasetWriter {
    fn drop(&mut self) {
        // Not finished: half a data set is of no use, and the caller is gone.
        if self.writer.take().is_some() {
            let _ = std::fs::remove_file(&self.part);
        }
    }
}

/// Writes a whole data set.
///
/// # Errors
/// As [`DatasetWriter`].
pub fn write_dataset(path: &Path, dataset: &Dataset) -> Result<(), RecordingError> {
    let mut writer = DatasetWriter::create(path, dataset)?;
    writer.append(&dataset.samples)?;
    writer.finish().map(|_| ())
}

/// Reads a data set.
///
/// # Errors
/// [`RecordingError::Io`] when the file cannot be opened, [`RecordingError::Dataset`] when it is
/// damaged or its columns are others.
pub fn read_dataset(path: &Path) -> Result<Dataset, RecordingError> {
    read_within(path, SizeLimit::of_memory())
}

/// Reads a data set that may take so much memory.
pub(super) fn read_within(path: &Path, limit: SizeLimit) -> Result<Dataset, RecordingError> {
    read_parquet(path, |path, file| read_open(path, file, limit))
}

/// Opens a Parquet file for `read`. The decoder asserts on some damaged files; a file's content must
/// not end the program.
pub(super) fn read_parquet<T>(
    path: &Path,
    read: impl FnOnce(&Path, File) -> Result<T, RecordingError>,
) -> Result<T, RecordingError> {
    let file = File::open(path).map_err(RecordingError::io(path, "open"))?;
    catch_unwind(AssertUnwindSafe(|| read(path, file)))
        .unwrap_or_else(|_| Err(refuse(path, "the file is damaged".to_owned())))
}

fn read_open(path: &Path, file: File, limit: SizeLimit) -> Result<Dataset, RecordingError> {
    let damaged = |e: &dyn std::fmt::Display| {
        refuse(
            path,
            format!(
                "the file is damaged or no Parquet file ({}): generate it again",
                e.to_string().replace('\n', " ")
            ),
        )
    };
    let names = dataset_columns();
    let columns: Vec<&str> = names[..EXACT_COLUMNS].iter().map(String::as_str).collect();
    let wanted = Wanted {
        columns: &columns,
        batch_rows: GROUP_ROWS,
        row_bytes: size_of::<Sample>(),
        limit,
    };
    let (builder, stated) = parquet_guard::open(path, file, &wanted)?;
    let metadata = builder.metadata().file_metadata();
    let entries = metadata.key_value_metadata();
    let entry = |key: &str| {
        let key = format!("springtwin.{key}");
        entries
            .into_iter()
            .flatten()
            .find(|kv| kv.key == key)
            .and_then(|kv| kv.value.clone())
    };
    match entry("schema").as_deref() {
        Some(SCHEMA) => {}
        Some(other) => {
            let text = format!("data set version {other}; this program reads version {SCHEMA}");
            return Err(refuse(path, text));
        }
        None => {
            return Err(refuse(
                path,
                "the file is not a data set of this program".to_owned(),
            ));
        }
    }
    let seed = entry("seed").unwrap_or_default();
    let mut dataset = Dataset {
        samples: Vec::new(),
        source: entry("source").unwrap_or_default(),
        seed: seed
            .parse()
            .map_err(|_| refuse(path, format!("the seed {seed:?} is not a whole number")))?,
        robot_hash: entry("robot_hash").unwrap_or_default(),
        row_s: entry("row_s")
            .map(|text| row_interval(path, &text))
            .transpose()?,
        shard: entry("shard"),
    };
    let reader = builder.build().map_err(|e| damaged(&e))?;
    for batch in reader {
        let batch = batch.map_err(|e| damaged(&e))?;
        if (dataset.samples.len() + batch.num_rows()) as u64 > stated {
            return Err(damaged(&"it holds more rows than it states"));
        }
        let mut columns = Vec::with_capacity(EXACT_COLUMNS);
        let nominal = vec![0.0; batch.num_rows()];
        for name in &names[..EXACT_COLUMNS] {
            if name == OFF_NOMINAL && batch.column_by_name(name).is_none() {
                columns.push(nominal.as_slice());
                continue;
            }
            let column = batch
                .column_by_name(name)
                .and_then(|c| c.as_primitive_opt::<Float64Type>())
                .filter(|c| c.null_count() == 0)
                .ok_or_else(|| {
                    let text = format!("the column {name:?} must be there, double and full");
                    refuse(path, text)
                })?;
            columns.push(&column.values()[..]);
        }
        let rows = (0..batch.num_rows()).map(|r| std::array::from_fn(|c| columns[c][r]));
        for row in rows {
            let at = dataset.samples.len() + 1;
            let sample = sample_of(&row).map_err(|e| refuse(path, format!("row {at}: {e}")))?;
            dataset.samples.push(sample);
        }
    }
    Ok(dataset)
}

/// The time between the rows of a trajectory from a file's metadata, s.
fn row_interval(path: &Path, text: &str) -> Result<f64, RecordingError> {
    let value = text.parse().ok();
    value
        .filter(|s: &f64| s.is_finite() && *s > 0.0)
        .ok_or_else(|| {
            let text = format!("the time between rows {text:?} is not a number of seconds above 0");
            refuse(path, text)
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::pose_from_ypr;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    fn dataset(n: usize, seed: u64) -> Dataset {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let samples = (0..n)
            .map(|_| Sample {
                chamber_pa: std::array::from_fn(|_| rng.random_range(-40e3..40e3)),
                payload_kg: rng.random_range(0.0..0.5),
                tip_force_n: std::array::from_fn(|_| rng.random_range(-5.0..5.0)),
                off_nominal: seed % 2 == 1,
                sensors: SensorVec {
                    spring_m: std::array::from_fn(|_| rng.random_range(0.07..0.24)),
                    imu_ypr_rad: std::array::from_fn(|_| {
                        std::array::from_fn(|_| rng.random_range(-1.0..1.0))
                    }),
                },
                base_from_tip: pose_from_ypr(
                    std::array::from_fn(|_| rng.random_range(-0.4..0.4)),
                    std::array::from_fn(|_| rng.random_range(-1.5..1.5)),
                ),
            })
            .collect();
        Dataset {
            samples,
            source: "rod".to_owned(),
            seed,
            robot_hash: "ab12".to_owned(),
            row_s: (seed == 3).then_some(0.02),
            shard: None,
        }
    }

    fn temp(name: &str) -> PathBuf {
        std::env::temp_dir().join(format!(
            "springtwin-ds-{name}-{}.parquet",
            std::process::id()
        ))
    }

    #[test]
    fn round_trip_is_exact() {
        let path = temp("round");
        let d = dataset(GROUP_ROWS + 7, 3);
        write_dataset(&path, &d).unwrap();
        assert_eq!(read_dataset(&path).unwrap(), d);
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn same_samples_same_bytes_however_appended() {
        let (a, b) = (temp("a"), temp("b"));
        let d = dataset(2 * GROUP_ROWS + 100, 5);
        write_dataset(&a, &d).unwrap();
        let mut w = DatasetWriter::create(&b, &d).unwrap();
        for chunk in d.samples.chunks(777) {
            w.append(chunk).unwrap();
        }
        assert_eq!(w.finish().unwrap(), d.samples.len() as u64);
        assert!(std::fs::read(&a).unwrap() == std::fs::read(&b).unwrap());
        std::fs::remove_file(a).unwrap();
        std::fs::remove_file(b).unwrap();
    }

    #[test]
    fn unfinished_leaves_nothing() {
        let path = temp("unfinished");
        let d = dataset(10, 1);
        let mut w = DatasetWriter::create(&path, &d).unwrap();
        w.append(&d.samples).unwrap();
        let part = w.part.clone();
        assert!(part.exists());
        drop(w);
        assert!(!part.exists() && !path.exists());
    }

    #[test]
    fn damage_is_an_error() {
        let path = temp("damage");
        write_dataset(&path, &dataset(200, 9)).unwrap();
        let whole = std::fs::read(&path).unwrap();
        for n in (0..whole.len()).step_by(997) {
            std::fs::write(&path, &whole[..n]).unwrap();
            assert!(matches!(
                read_dataset(&path),
                Err(RecordingError::Dataset { .. })
            ));
        }
        // A flipped bit is found or changes numbers only; it never ends the program.
        for n in (0..whole.len()).step_by(499) {
            let mut bytes = whole.clone();
            bytes[n] ^= 0x20;
            std::fs::write(&path, &bytes).unwrap();
            if let Ok(d) = read_dataset(&path) {
                assert!(d.samples.len() <= 200);
            }
        }
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn documented_columns() {
        let names = dataset_columns();
        assert_eq!(names.len(), COLUMNS);
        assert_eq!(names[0], "p1_pa");
        assert_eq!(names[EXACT_COLUMNS], "yaw_rad");
    }
}
