//! Hostile files for readers: small good files with damage, and files that state or unpack to far more than they are.
//!
//! A reader answers each with what it holds or with one sentence; it never panics, and never reserves memory for what a
//! file merely states: an allocation that fails would end the program that drives the arm.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow::array::{ArrayRef, Float64Array, RecordBatch};
use parquet::arrow::arrow_writer::ArrowWriter;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use rand::{Rng as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

use super::log::column_names;
use super::{
    RecordingError, SizeLimit, Table, asu, dataset, dataset_columns, imu_log, log, parse_log,
    parse_session_file, read_asu_arm, read_dataset, read_imu_log, read_mocap, read_session,
};

/// Damaged copies of each file.
const COPIES: u64 = 120;

/// Damaged copies of a good file, the same in every run.
pub(crate) fn damaged(whole: &[u8]) -> impl Iterator<Item = Vec<u8>> + '_ {
    (0..COPIES).map(|seed| {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut bytes = whole.to_vec();
        for _ in 0..rng.random_range(1..4) {
            damage(&mut bytes, seed % 6, &mut rng);
        }
        bytes
    })
}

fn damage(bytes: &mut Vec<u8>, kind: u64, rng: &mut Pcg64Mcg) {
    if bytes.is_empty() {
        return;
    }
    let at = rng.random_range(0..bytes.len());
    match kind {
        0 => bytes.truncate(at),
        1 => bytes[at] ^= 1 << rng.random_range(0..8),
        2 => {
            let inserted: Vec<u8> = (0..rng.random_range(1..9)).map(|_| rng.random()).collect();
            bytes.splice(at..at, inserted);
        }
        // A huge length in binary, or as digits.
        3 => {
            let huge: &[u8] = match rng.random_range(0..4) {
                0 => &[0xff, 0xff, 0xff, 0x7f],
                1 => &[0xff; 8],
                2 => &[0xfc, 0xff, 0xff, 0xff, 0xff, 0x07],
                _ => b"99999999999999999999",
            };
            let end = (at + huge.len()).min(bytes.len());
            bytes.splice(at..end, huge.iter().copied());
        }
        4 => {
            let end = rng.random_range(at..=bytes.len());
            let piece = bytes[at..end].to_vec();
            bytes.splice(at..at, piece);
        }
        _ => {
            let end = rng.random_range(at..=bytes.len());
            bytes.drain(at..end);
        }
    }
}

/// Whether an error can stand in a status line.
pub(crate) fn assert_sentence(text: &str) {
    assert!(
        !text.is_empty() && !text.contains('\n') && text.len() < 1000,
        "not one sentence: {text}"
    );
}

/// A file of the test's own, which is removed at its end.
pub(crate) struct Scratch(PathBuf);

impl Scratch {
    pub(crate) fn new(name: &str) -> Self {
        let id = std::process::id();
        Self(std::env::temp_dir().join(format!("springtwin-hostile-{id}-{name}")))
    }

    pub(crate) fn path(&self) -> &Path {
        &self.0
    }

    /// The file with these bytes.
    pub(crate) fn with(&self, bytes: &[u8]) -> &Path {
        std::fs::write(&self.0, bytes).unwrap();
        &self.0
    }

    /// The file with these bytes, and then holes up to four terabytes: they take no place on the disk.
    #[cfg(unix)]
    fn grown(&self, bytes: &[u8]) -> &Path {
        let file = File::create(self.with(bytes)).unwrap();
        file.set_len(4 << 40).unwrap();
        std::os::unix::fs::FileExt::write_all_at(&file, bytes, 0).unwrap();
        &self.0
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Reads damaged copies of a file; so many are read after all.
fn read_all<T>(
    name: &str,
    whole: &[u8],
    read: impl Fn(&Path) -> Result<T, RecordingError>,
) -> usize {
    let file = Scratch::new(name);
    assert!(read(file.with(whole)).is_ok(), "{name} is good");
    let sound = damaged(whole).filter(|bytes| match read(file.with(bytes)) {
        Ok(_) => true,
        Err(e) => {
            assert_sentence(&e.to_string());
            false
        }
    });
    sound.count()
}

fn session_csv(rows: usize) -> String {
    let mut text = column_names().join(",");
    for n in 0..rows {
        let cells = [&["1.5"; 6][..], &["150.25"; 12], &["2.5"; 18]].concat();
        text.push_str(&format!("\n{:.2},{}", 0.02 * n as f64, cells.join(",")));
    }
    text + "\n"
}

fn table_csv() -> String {
    (0..20).fold("a_mm,b_s\n".to_owned(), |text, n| {
        text + &format!("{n},{}.5\n", 2 * n)
    })
}

fn asu_csv() -> String {
    (0..10).fold(String::new(), |text, n| {
        text + &format!("{n}.5,{}\n", ["1.25"; asu::COLUMNS - 1].join(","))
    })
}

#[test]
fn damaged_tables_are_refused_in_a_sentence_or_read() {
    read_all("session.csv", session_csv(20).as_bytes(), read_session);
    read_all("table.csv", table_csv().as_bytes(), Table::read);
    read_all("arm.csv", asu_csv().as_bytes(), read_asu_arm);
}

#[test]
fn damaged_descriptions_are_refused_in_a_sentence_or_read() {
    let whole =
        b"name = \"a\"\nlog = \"log.csv\"\nrate_hz = 50.0\npayload_kg = 0.1\nrobot = \"ab\"\n";
    for bytes in damaged(whole) {
        let text = String::from_utf8_lossy(&bytes);
        if let Err(e) = parse_session_file(&text, Path::new("session.toml")) {
            assert_sentence(&e.to_string());
        }
    }
}

#[test]
fn damaged_motion_capture_is_refused_in_a_sentence_or_read() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus");
    for name in [
        "c3d/intel-float",
        "c3d/mips-float",
        "vicon/trajectories",
        "motive/quaternion",
    ] {
        let mut whole = std::fs::read(corpus.join(name)).unwrap();
        // The corpus is of what follows.
        if name.starts_with("motive") {
            whole.splice(0..0, *b"Format Version,1.23,");
        }
        read_all(&name.replace('/', "-"), &whole, |path| {
            read_mocap(path, None)
        });
    }
}

/// A file of equal rows in columns with these names.
fn parquet(path: &Path, names: &[String], rows: usize, dictionary: bool) {
    let value = |name: &str| {
        if name == "qw" || name.ends_with("q_w") {
            1.0
        } else {
            0.0
        }
    };
    let column = |name: &String| -> ArrayRef {
        let values: Vec<f64> = match name == "t_s" {
            true => (0..rows).map(|n| n as f64).collect(),
            false => vec![value(name); rows],
        };
        Arc::new(Float64Array::from(values))
    };
    let columns: Vec<(&str, ArrayRef)> = names.iter().map(|n| (n.as_str(), column(n))).collect();
    let batch = RecordBatch::try_from_iter(columns).unwrap();
    let entry =
        |key: &str, value: &str| KeyValue::new(format!("springtwin.{key}"), value.to_owned());
    let properties = WriterProperties::builder()
        .set_dictionary_enabled(dictionary)
        .set_data_page_row_count_limit(1 << 30)
        .set_compression(parquet::basic::Compression::ZSTD(Default::default()))
        .set_key_value_metadata(Some(vec![entry("schema", "1"), entry("seed", "1")]))
        .build();
    let file = File::create(path).unwrap();
    let mut writer = ArrowWriter::try_new(file, batch.schema(), Some(properties)).unwrap();
    writer.write(&batch).unwrap();
    writer.close().unwrap();
}

fn imu_names() -> Vec<String> {
    let names = imu_log::COLUMNS.iter().filter(|n| **n != "movement");
    names.map(|n| (*n).to_owned()).collect()
}

#[test]
fn damaged_parquet_is_refused_in_a_sentence_or_read() {
    for dictionary in [false, true] {
        let file = Scratch::new("good.parquet");
        parquet(file.path(), &dataset_columns(), 20, dictionary);
        let whole = std::fs::read(file.path()).unwrap();
        read_all("damaged.parquet", &whole, read_dataset);
        parquet(file.path(), &imu_names(), 20, dictionary);
        let whole = std::fs::read(file.path()).unwrap();
        read_all("damaged-imu.parquet", &whole, read_imu_log);
        // Most of the sense is in the description at the end.
        let footer = &whole[whole.len() - 8..];
        let length = u32::from_le_bytes(footer[..4].try_into().unwrap()) as usize;
        let (data, description) = whole[..whole.len() - 8].split_at(whole.len() - 8 - length);
        for damaged in damaged(description) {
            let length = (damaged.len() as u32).to_le_bytes();
            let bytes = [data, &damaged, &length, b"PAR1"].concat();
            if let Err(e) = read_imu_log(file.with(&bytes)) {
                assert_sentence(&e.to_string());
            }
        }
    }
}

fn refused<T>(read: Result<T, RecordingError>, why: &str) {
    let e = read.err().expect("refused").to_string();
    assert_sentence(&e);
    assert!(e.contains(why), "{e}");
}

#[test]
fn rows_that_unpack_to_more_than_memory_are_refused() {
    let limit = SizeLimit::memory(16 << 20);
    let file = Scratch::new("equal.parquet");
    parquet(file.path(), &dataset_columns(), 100_000, true);
    assert!(
        file.path().metadata().unwrap().len() < 100_000,
        "it is small"
    );
    refused(
        dataset::read_within(file.path(), limit),
        "100000 rows take 67 MB of memory, which is more than the 17 MB",
    );
    assert_eq!(read_dataset(file.path()).unwrap().samples.len(), 100_000);
    let mut names = imu_names();
    names.retain(|n| n != "t_s");
    parquet(file.path(), &names, 400_000, true);
    refused(imu_log::read_within(file.path(), limit), "400000 rows take");
    // Rows of nothing.
    let empty = format!("{}\n", ",".repeat(36));
    let rows: String = (0..50_000).map(|n| format!("{n}{empty}")).collect();
    let text = format!("{}\n{rows}", column_names().join(","));
    refused(
        log::read_within(
            Scratch::new("empty.csv").with(text.as_bytes()),
            limit,
            &mut |_| true,
        ),
        "rows take",
    );
    let text = format!("a\n{}", "1\n".repeat(500_000));
    refused(
        Table::read_within(Scratch::new("thin.csv").with(text.as_bytes()), limit),
        "rows take",
    );
}

#[test]
fn pages_and_dictionaries_that_state_more_than_they_are_are_refused() {
    let file = Scratch::new("pages.parquet");
    parquet(file.path(), &imu_names(), 200_000, false);
    let whole = std::fs::read(file.path()).unwrap();
    // The first page's head: its kind, and after decompression 1 MB. The largest number of as many bytes is 134 MB.
    assert_eq!(whole[4..7], [0x15, 0, 0x15]);
    assert!(whole[7..10].iter().all(|b| b & 0x80 != 0) && whole[10] & 0x80 == 0);
    let mut bytes = whole.clone();
    bytes[7..11].copy_from_slice(&[0xfe, 0xff, 0xff, 0x7f]);
    let limit = SizeLimit::memory(100 << 20);
    assert!(imu_log::read_within(file.path(), limit).is_ok());
    refused(
        imu_log::read_within(file.with(&bytes), limit),
        " MB are more than the 105 MB of memory",
    );
    // A dictionary of one value that states 63.
    parquet(file.path(), &imu_names()[1..2], 10, true);
    let mut bytes = std::fs::read(file.path()).unwrap();
    let head = bytes.iter().position(|b| *b == 0x4c).expect("a dictionary");
    assert_eq!(bytes[head + 1..head + 3], [0x15, 2]);
    bytes[head + 2] = 126;
    refused(
        read_imu_log(file.with(&bytes)),
        "states more values than it holds",
    );
}

#[test]
fn a_description_that_states_two_billion_columns_is_refused() {
    let file = Scratch::new("columns.parquet");
    // Version 1, and a list of structures.
    let description = [0x15, 2, 0x19, 0xfc, 0xff, 0xff, 0xff, 0xff, 7, 0, 0];
    let length = (description.len() as u32).to_le_bytes();
    let bytes = [b"PAR1", description.as_slice(), &length, b"PAR1"].concat();
    refused(read_dataset(file.with(&bytes)), "damaged");
    refused(read_imu_log(file.path()), "damaged");
}

#[cfg(unix)]
#[test]
fn files_of_terabytes_are_refused_before_they_are_read() {
    let file = Scratch::new("terabytes.csv");
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus");
    let c3d = std::fs::read(corpus.join("c3d/intel-float")).unwrap();
    refused(
        read_mocap(file.grown(&c3d), None),
        "4.4 TB are more than the",
    );
    let csv = session_csv(3);
    refused(
        read_session(file.grown(csv.as_bytes())),
        "cut it into parts",
    );
    refused(Table::read(file.path()), "cut it into parts");
    refused(read_asu_arm(file.path()), "cut it into parts");
    refused(read_imu_log(file.path()), "a log of one IMU can have");
    let folder = std::env::temp_dir().join(format!("springtwin-hostile-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let toml = Scratch(folder.join("session.toml"));
    refused(
        read_session(toml.grown(b"name = \"a\"\n").parent().unwrap()),
        "too large",
    );
    drop(toml);
    std::fs::remove_dir(folder).unwrap();
}

/// Rows without an end, as from a pipe.
struct Endless {
    row: u64,
    text: Vec<u8>,
}

impl std::io::Read for Endless {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        if self.text.is_empty() {
            self.row += 1;
            self.text = format!("{}{}\n", self.row, ",".repeat(36)).into_bytes();
        }
        let n = buffer.len().min(self.text.len());
        buffer[..n].copy_from_slice(&self.text[..n]);
        self.text.drain(..n);
        Ok(n)
    }
}

#[test]
fn rows_without_an_end_are_given_up() {
    let text = (column_names().join(",") + "\n").into_bytes();
    let reader = std::io::BufReader::new(Endless { row: 0, text });
    let read = log::parse_within(reader, Path::new("pipe"), SizeLimit::memory(4 << 20));
    refused(read, "rows take");
    assert!(parse_log(session_csv(2).as_bytes(), Path::new("x")).is_ok());
}
