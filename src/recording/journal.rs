//! Journal of a long run's results, from which a run that was killed continues.
//!
//! The journal lies beside the data set it will become, with the ending `.resume`: a head of text
//! that identifies the computation, then blocks of samples, each with its checksum. A block is
//! there as a whole or not at all; what follows the last whole block is cut off. When all is
//! computed the data set is written from the journal under its own name, and the journal removed.
//!
//! | block | |
//! |---|---|
//! | `u32` | indices covered (samples and left-out ones) |
//! | `u32` | samples |
//! | samples × exact columns `f64` | the samples |
//! | `u32` | CRC-32 of all of the above |
//!
//! All little-endian.

use std::fs::{File, OpenOptions};
use std::io::{BufReader, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::RecordingError;
use super::dataset::{DatasetWriter, EXACT_COLUMNS, row_of, sample_of};
use super::error::refuse;
use super::lock::is_own;
use crate::signal::{Dataset, Sample};

const CRC32: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
const MAGIC: &str = "springtwin dataset journal 1";
/// Most samples in one block: a larger number means damage.
const BLOCK_ROWS: u32 = 1 << 20;

/// A data set in the making.
pub struct DatasetJournal {
    out: PathBuf,
    path: PathBuf,
    file: File,
    /// Length of the head in the file, bytes.
    head: u64,
    /// Indices covered so far.
    pub done: usize,
    /// Samples so far.
    pub samples: usize,
}

impl DatasetJournal {
    /// Where the journal of the data set `out` lies.
    pub fn path_of(out: &Path) -> PathBuf {
        let mut name = out.file_name().unwrap_or_default().to_owned();
        name.push(".resume");
        out.with_file_name(name)
    }

    /// Opens the journal of the data set `out`, or begins it. `about` names everything the samples
    /// depend on; a journal that was begun with anything else is refused.
    ///
    /// # Errors
    /// [`RecordingError::Io`] when the file cannot be used, [`RecordingError::Dataset`] when it
    /// belongs to another data set or another process is writing it.
    pub fn open(out: &Path, about: &[(&str, String)]) -> Result<Self, RecordingError> {
        let path = Self::path_of(out);
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)
            .map_err(RecordingError::io(&path, "create"))?;
        if !is_own(file.try_lock(), &path) {
            let text = "another process is computing this data set: wait for it, or give another \
                        file";
            return Err(refuse(&path, text.to_owned()));
        }
        let wanted = head(about);
        let mut found = Vec::new();
        (&file)
            .take(wanted.len() as u64)
            .read_to_end(&mut found)
            .map_err(RecordingError::io(&path, "read"))?;
        let (mut done, mut samples, mut end) = (0, 0, wanted.len() as u64);
        if found == wanted.as_bytes() {
            let mut blocks = Blocks::new(&file, end).map_err(RecordingError::io(&path, "read"))?;
            while let Some(block) = blocks.next(&path)? {
                done += block.indices;
                samples += block.samples.len();
                end = blocks.at;
            }
            file.set_len(end)
                .map_err(RecordingError::io(&path, "write"))?;
        } else if wanted.as_bytes().starts_with(&found) {
            // New, or cut off while the head was written.
            file.set_len(0)
                .and_then(|()| file.seek(SeekFrom::Start(0)))
                .and_then(|_| file.write_all(wanted.as_bytes()))
                .map_err(RecordingError::io(&path, "write"))?;
        } else {
            let found = String::from_utf8_lossy(&found);
            return Err(refuse(&path, differs(&found, &wanted)));
        }
        file.seek(SeekFrom::Start(end))
            .map_err(RecordingError::io(&path, "read"))?;
        Ok(Self {
            out: out.to_owned(),
            path,
            file,
            head: wanted.len() as u64,
            done,
            samples,
        })
    }

    /// Appends what the next `indices` indices gave; those without a sample are left out.
    ///
    /// # Errors
    /// [`RecordingError::Io`] when writing fails.
    pub fn append(&mut self, indices: usize, samples: &[Sample]) -> Result<(), RecordingError> {
        let mut bytes = Vec::with_capacity(12 + samples.len() * EXACT_COLUMNS * 8);
        bytes.extend((indices as u32).to_le_bytes());
        bytes.extend((samples.len() as u32).to_le_bytes());
        for sample in samples {
            let row = row_of(sample);
            bytes.extend(row[..EXACT_COLUMNS].iter().flat_map(|x| x.to_le_bytes()));
        }
        bytes.extend(CRC32.checksum(&bytes).to_le_bytes());
        self.file
            .write_all(&bytes)
            .map_err(RecordingError::io(&self.path, "write"))?;
        self.done += indices;
        self.samples += samples.len();
        Ok(())
    }

    /// Writes the data set under its name, source, seed and robot as in `about`, and removes the
    /// journal. Returns the number of samples.
    ///
    /// # Errors
    /// As [`DatasetWriter`].
    pub fn finish(self, about: &Dataset) -> Result<u64, RecordingError> {
        let mut writer = DatasetWriter::create(&self.out, about)?;
        let mut blocks =
            Blocks::new(&self.file, self.head).map_err(RecordingError::io(&self.path, "read"))?;
        while let Some(block) = blocks.next(&self.path)? {
            writer.append(&block.samples)?;
        }
        if writer.rows() != self.samples as u64 {
            let text = "the journal was damaged while it was used: start again";
            return Err(refuse(&self.path, text.to_owned()));
        }
        let rows = writer.finish()?;
        std::fs::remove_file(&self.path).map_err(RecordingError::io(&self.path, "remove"))?;
        Ok(rows)
    }
}

fn head(about: &[(&str, String)]) -> String {
    let mut text = format!("{MAGIC}\n");
    for (key, value) in about {
        text.push_str(&format!("{key} {value}\n"));
    }
    text.push('\n');
    text
}

/// The first line in which two heads differ, as a sentence.
fn differs(found: &str, wanted: &str) -> String {
    let what = found
        .lines()
        .zip(wanted.lines())
        .find(|(a, b)| a != b)
        .map_or_else(String::new, |(a, b)| format!(" ({a:?}, not {b:?})"));
    format!(
        "this is the beginning of another data set{what}: finish that one, remove the file, or give \
         another --out"
    )
}

struct Block {
    indices: usize,
    samples: Vec<Sample>,
}

/// Reads blocks from a place in the file on.
struct Blocks<'a> {
    reader: BufReader<&'a File>,
    /// Where the last whole block ends, bytes.
    at: u64,
}

impl<'a> Blocks<'a> {
    fn new(mut file: &'a File, at: u64) -> std::io::Result<Self> {
        file.seek(SeekFrom::Start(at))?;
        Ok(Self {
            reader: BufReader::new(file),
            at,
        })
    }

    /// The next whole block.
    fn next(&mut self, path: &Path) -> Result<Option<Block>, RecordingError> {
        match self.read() {
            Ok(block) => Ok(block),
            Err(e) if e.kind() == ErrorKind::UnexpectedEof => Ok(None),
            Err(e) => Err(RecordingError::io(path, "read")(e)),
        }
    }

    fn read(&mut self) -> std::io::Result<Option<Block>> {
        let mut bytes = vec![0; 8];
        self.reader.read_exact(&mut bytes)?;
        let [indices, rows] = [0, 4]
            .map(|at| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]));
        if rows > indices || rows > BLOCK_ROWS {
            return Ok(None);
        }
        let length = 8 + rows as usize * EXACT_COLUMNS * 8;
        let left = self
            .reader
            .get_ref()
            .metadata()?
            .len()
            .saturating_sub(self.at);
        if length as u64 > left {
            return Ok(None);
        }
        bytes.resize(length, 0);
        self.reader.read_exact(&mut bytes[8..])?;
        let mut sum = [0; 4];
        self.reader.read_exact(&mut sum)?;
        if u32::from_le_bytes(sum) != CRC32.checksum(&bytes) {
            return Ok(None);
        }
        let mut samples = Vec::with_capacity(rows as usize);
        for row in bytes[8..].chunks_exact(EXACT_COLUMNS * 8) {
            let mut values = [0.0; EXACT_COLUMNS];
            for (value, b) in values.iter_mut().zip(row.chunks_exact(8)) {
                *value = f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]);
            }
            let Ok(sample) = sample_of(&values) else {
                return Ok(None);
            };
            samples.push(sample);
        }
        self.at += length as u64 + 4;
        Ok(Some(Block {
            indices: indices as usize,
            samples,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::{read_dataset, write_dataset};
    use crate::signal::{SensorVec, pose_from_ypr};

    fn dataset(n: usize) -> Dataset {
        let samples = (0..n)
            .map(|i| Sample {
                chamber_pa: std::array::from_fn(|k| (i * 7 + k) as f64),
                payload_kg: 0.1,
                tip_force_n: [0.0; 3],
                off_nominal: i % 3 == 0,
                sensors: SensorVec {
                    spring_m: [0.15; 12],
                    imu_ypr_rad: [[0.1; 3]; 4],
                },
                base_from_tip: pose_from_ypr([0.0, 0.01 * i as f64, -0.3], [0.3, 0.2, 0.1]),
            })
            .collect();
        Dataset {
            samples,
            source: "rod".to_owned(),
            seed: 3,
            robot_hash: "ab12".to_owned(),
            row_s: None,
            shard: None,
        }
    }

    fn about(seed: u64) -> Vec<(&'static str, String)> {
        vec![("seed", seed.to_string()), ("robot", "ab12".to_owned())]
    }

    fn folder(name: &str) -> PathBuf {
        let dir = std::env::temp_dir().join(format!("springtwin-dj-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&dir).unwrap();
        dir
    }

    /// Appends blocks of 10 samples and one left-out index up to `to` samples.
    fn work(journal: &mut DatasetJournal, d: &Dataset, to: usize) {
        while journal.samples < to {
            let from = journal.samples;
            journal.append(11, &d.samples[from..from + 10]).unwrap();
        }
    }

    #[test]
    fn any_cut_goes_on_to_the_same_bytes() {
        let dir = folder("cut");
        let d = dataset(50);
        let whole = dir.join("whole.parquet");
        write_dataset(&whole, &d).unwrap();
        let whole = std::fs::read(whole).unwrap();

        let out = dir.join("d.parquet");
        let mut journal = DatasetJournal::open(&out, &about(3)).unwrap();
        work(&mut journal, &d, 40);
        drop(journal);
        let path = dir.join("d.parquet.resume");
        let bytes = std::fs::read(&path).unwrap();
        for cut in (0..=bytes.len()).step_by(613).chain([bytes.len()]) {
            std::fs::write(&path, &bytes[..cut]).unwrap();
            let mut journal = DatasetJournal::open(&out, &about(3)).unwrap();
            assert!(journal.done * 10 == journal.samples * 11 && journal.samples <= 40);
            assert!(cut < bytes.len() || journal.samples == 40);
            work(&mut journal, &d, 50);
            assert!(!out.exists());
            assert_eq!(
                journal
                    .finish(&Dataset {
                        samples: vec![],
                        ..d.clone()
                    })
                    .unwrap(),
                50
            );
            assert!(
                std::fs::read(&out).unwrap() == whole && !path.exists(),
                "cut at {cut}"
            );
            std::fs::remove_file(&out).unwrap();
        }
        std::fs::remove_dir_all(dir).unwrap();
    }

    #[test]
    fn a_flipped_bit_costs_its_block_and_what_follows() {
        let dir = folder("flip");
        let d = dataset(50);
        let out = dir.join("d.parquet");
        let mut journal = DatasetJournal::open(&out, &about(3)).unwrap();
        let head = journal.head as usize;
        work(&mut journal, &d, 40);
        drop(journal);
        let path = dir.join("d.parquet.resume");
        let bytes = std::fs::read(&path).unwrap();
        let block = (bytes.len() - head) / 4;
        for at in (head..bytes.len()).step_by(401) {
            let mut bytes = bytes.clone();
            bytes[at] ^= 0x10;
            std::fs::write(&path, &bytes).unwrap();
            let journal = DatasetJournal::open(&out, &about(3)).unwrap();
            assert_eq!(journal.samples, 10 * ((at - head) / block), "bit at {at}");
        }
        let mut journal = DatasetJournal::open(&out, &about(3)).unwrap();
        work(&mut journal, &d, 50);
        journal.finish(&d).unwrap();
        assert_eq!(read_dataset(&out).unwrap(), d);
        std::fs::remove_dir_all(dir).unwrap();
    }

    #[test]
    fn another_run_is_refused() {
        let dir = folder("other");
        let out = dir.join("d.parquet");
        let d = dataset(10);
        let mut journal = DatasetJournal::open(&out, &about(3)).unwrap();
        journal.append(10, &d.samples).unwrap();
        let busy = DatasetJournal::open(&out, &about(3)).err().unwrap();
        assert!(busy.to_string().contains("another process"), "{busy}");
        drop(journal);
        let other = DatasetJournal::open(&out, &about(4)).err().unwrap();
        let text = other.to_string();
        assert!(text.contains("\"seed 3\", not \"seed 4\""), "{text}");
        assert_eq!(DatasetJournal::open(&out, &about(3)).unwrap().samples, 10);
        // A file of somebody else is not touched either.
        let path = dir.join("d.parquet.resume");
        std::fs::write(&path, "notes").unwrap();
        assert!(DatasetJournal::open(&out, &about(3)).is_err());
        assert_eq!(std::fs::read(&path).unwrap(), b"notes");
        std::fs::remove_dir_all(dir).unwrap();
    }
}
