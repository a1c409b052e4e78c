//! Logs of one IMU beside an optical reference: Parquet with the columns below, in any order.
//!
//! | column | unit | |
//! |---|---|---|
//! | `t_s` | s | rising |
//! | `gyro_x_rad_s` .. `gyro_z_rad_s` | rad/s | |
//! | `accel_x_m_s2` .. `accel_z_m_s2` | m/s² | |
//! | `ref_q_w`, `ref_q_x`, `ref_q_y`, `ref_q_z` | | earth from IMU, z up; NaN or null where it is not seen |
//! | `movement` | bool | whether errors count; all do where the column is missing |
//!
//! Other columns (a magnetometer, a position) are not read.

use std::fs::File;
use std::path::Path;

use arrow::array::{Array, AsArray, RecordBatch};
use arrow::compute::cast;
use arrow::datatypes::{DataType, Float64Type};
use nalgebra::{Quaternion, UnitQuaternion};

use super::RecordingError;
use super::dataset::read_parquet;
use super::error::refuse;
use super::parquet_guard::{self, Wanted};
use super::size_limit::SizeLimit;

/// Largest log of one IMU; an hour at 286 Hz takes about 100 MB.
const FILE_LIMIT: SizeLimit = SizeLimit::of_kind(2 << 30, "a log of one IMU");
/// Rows that are decoded at a time.
const BATCH_ROWS: usize = 1024;
/// Columns that are read.
pub(super) const COLUMNS: [&str; 12] = [
    "t_s",
    "gyro_x_rad_s",
    "gyro_y_rad_s",
    "gyro_z_rad_s",
    "accel_x_m_s2",
    "accel_y_m_s2",
    "accel_z_m_s2",
    "ref_q_w",
    "ref_q_x",
    "ref_q_y",
    "ref_q_z",
    "movement",
];

/// One sample of such a log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// Time, s.
    pub t_s: f64,
    /// Angular rate in the IMU's own axes, rad/s.
    pub gyro_rad_s: [f64; 3],
    /// Specific force in the IMU's own axes, m/s².
    pub accel_m_s2: [f64; 3],
    /// Earth from IMU by the optical reference; `None` where it does not see.
    pub reference: Option<UnitQuaternion<f64>>,
    /// Whether errors count here.
    pub movement: bool,
}

/// Reads such a log.
///
/// # Errors
/// [`RecordingError::Io`] when the file cannot be opened, [`RecordingError::Dataset`] when it is
/// damaged, lacks a column, or its time does not rise.
pub fn read_imu_log(path: &Path) -> Result<Vec<ImuSample>, RecordingError> {
    read_within(path, SizeLimit::of_memory())
}

/// Reads such a log that may take so much memory.
pub(super) fn read_within(path: &Path, limit: SizeLimit) -> Result<Vec<ImuSample>, RecordingError> {
    read_parquet(path, |path, file| read_open(path, file, limit))
}

fn read_open(path: &Path, file: File, limit: SizeLimit) -> Result<Vec<ImuSample>, RecordingError> {
    let damaged = |e: &dyn std::fmt::Display| {
        refuse(
            path,
            format!(
                "the file is damaged or no Parquet file ({}): copy it again",
                e.to_string().replace('\n', " ")
            ),
        )
    };
    let about = file.metadata().map_err(RecordingError::io(path, "open"))?;
    FILE_LIMIT.check(path, about.len())?;
    let wanted = Wanted {
        columns: &COLUMNS,
        batch_rows: BATCH_ROWS,
        row_bytes: size_of::<ImuSample>(),
        limit,
    };
    let (builder, stated) = parquet_guard::open(path, file, &wanted)?;
    let mut samples: Vec<ImuSample> = Vec::new();
    for batch in builder.build().map_err(|e| damaged(&e))? {
        let batch = batch.map_err(|e| damaged(&e))?;
        if (samples.len() + batch.num_rows()) as u64 > stated {
            return Err(damaged(&"it holds more rows than it states"));
        }
        let column = |name: &str| doubles(path, &batch, name);
        let axes = |start: &str, end: &str| -> Result<[Vec<f64>; 3], RecordingError> {
            let [x, y, z] = ["x", "y", "z"].map(|axis| column(&format!("{start}_{axis}_{end}")));
            Ok([x?, y?, z?])
        };
        let t_s = column("t_s")?;
        let gyro = axes("gyro", "rad_s")?;
        let accel = axes("accel", "m_s2")?;
        let [w, i, j, k] = ["w", "x", "y", "z"].map(|part| column(&format!("ref_q_{part}")));
        let (w, i, j, k) = (w?, i?, j?, k?);
        let movement = movement(path, &batch)?;
        for row in 0..batch.num_rows() {
            let at = samples.len() + 1;
            let rises = samples.last().is_none_or(|s| t_s[row] > s.t_s);
            if !t_s[row].is_finite() || !rises {
                return Err(refuse(
                    path,
                    format!("row {at}: t_s must be there and rise"),
                ));
            }
            let reference = Quaternion::new(w[row], i[row], j[row], k[row]);
            samples.push(ImuSample {
                t_s: t_s[row],
                gyro_rad_s: [0, 1, 2].map(|a| gyro[a][row]),
                accel_m_s2: [0, 1, 2].map(|a| accel[a][row]),
                reference: UnitQuaternion::try_new(reference, 0.5),
                movement: movement.as_ref().is_none_or(|m| m[row]),
            });
        }
    }
    Ok(samples)
}

/// A column of numbers; what is null is NaN.
fn doubles(path: &Path, batch: &RecordBatch, name: &str) -> Result<Vec<f64>, RecordingError> {
    let missing = || refuse(path, format!("there must be a column {name:?} of numbers"));
    let column = batch.column_by_name(name).ok_or_else(missing)?;
    if !column.data_type().is_numeric() {
        return Err(missing());
    }
    let column = cast(column, &DataType::Float64).map_err(|_| missing())?;
    let column = column
        .as_primitive_opt::<Float64Type>()
        .ok_or_else(missing)?;
    Ok(column.iter().map(|v| v.unwrap_or(f64::NAN)).collect())
}

fn movement(path: &Path, batch: &RecordBatch) -> Result<Option<Vec<bool>>, RecordingError> {
    let Some(column) = batch.column_by_name("movement") else {
        return Ok(None);
    };
    let column = column
        .as_boolean_opt()
        .ok_or_else(|| refuse(path, "the column \"movement\" must be true or false".into()))?;
    Ok(Some(column.iter().map(|v| v.unwrap_or(false)).collect()))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use arrow::array::{ArrayRef, BooleanArray, Float32Array, Float64Array};
    use parquet::arrow::arrow_writer::ArrowWriter;

    use super::*;

    const NAMES: [&str; 10] = [
        "gyro_x_rad_s",
        "gyro_y_rad_s",
        "gyro_z_rad_s",
        "accel_x_m_s2",
        "accel_y_m_s2",
        "accel_z_m_s2",
        "ref_q_w",
        "ref_q_x",
        "ref_q_y",
        "ref_q_z",
    ];

    fn write(name: &str, t_s: [f64; 2], without: &str) -> std::path::PathBuf {
        let path =
            std::env::temp_dir().join(format!("springtwin-imu-{name}-{}", std::process::id()));
        let mut columns: Vec<(&str, ArrayRef)> =
            vec![("t_s", Arc::new(Float64Array::from(t_s.to_vec())))];
        for (k, n) in NAMES.into_iter().enumerate().filter(|(_, n)| *n != without) {
            let second = if n.starts_with("ref") { f32::NAN } else { 0.5 };
            let first = if n == "ref_q_w" {
                1.0
            } else if n.starts_with("ref") {
                0.0
            } else {
                k as f32
            };
            columns.push((n, Arc::new(Float32Array::from(vec![first, second]))));
        }
        columns.push((
            "movement",
            Arc::new(BooleanArray::from(vec![Some(true), None])),
        ));
        let batch = RecordBatch::try_from_iter(columns).expect("columns");
        let file = File::create(&path).expect("a file");
        let mut writer = ArrowWriter::try_new(file, batch.schema(), None).expect("a writer");
        writer.write(&batch).expect("writes");
        writer.close().expect("closes");
        path
    }

    #[test]
    fn columns_go_where_they_belong_and_gaps_stay() {
        let path = write("good", [0.0, 0.01], "");
        let log = read_imu_log(&path).expect("reads");
        assert_eq!(log[0].gyro_rad_s, [0.0, 1.0, 2.0]);
        assert_eq!(log[0].accel_m_s2, [3.0, 4.0, 5.0]);
        assert_eq!(log[0].reference, Some(UnitQuaternion::identity()));
        assert_eq!(
            (log[1].reference, log[0].movement, log[1].movement),
            (None, true, false)
        );
        std::fs::remove_file(path).expect("removes");
    }

    #[test]
    fn refusals_say_what_is_missing() {
        let path = write("less", [0.0, 0.01], "accel_y_m_s2");
        let said = read_imu_log(&path).expect_err("incomplete").to_string();
        assert!(said.contains("accel_y_m_s2"), "{said}");
        std::fs::remove_file(path).expect("removes");
        let path = write("still", [0.01, 0.01], "");
        let said = read_imu_log(&path).expect_err("time").to_string();
        assert!(said.contains("row 2"), "{said}");
        std::fs::write(&path, b"PAR1 no PAR1").expect("writes");
        assert!(read_imu_log(&path).is_err());
        std::fs::remove_file(path).expect("removes");
    }
}
