//! The rolling recording: what the arm does from Arm on, in short files in a folder of its own, the oldest of which are
//! removed when they take more than a limit. A part of it that is wanted becomes a recording ([`keep_last`]).

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde::{Deserialize, Serialize};

use super::lock::is_own;
use super::rrd::recording_id;
use super::space::LOW_SPACE_BYTES;
use super::{
    RecordingError, RecordingFile, RecordingMeta, RecordingSummary, Selection, SizeLimit, join,
    write_text,
};
use crate::signal::Stamp;

/// Limit without a choice of the user's, bytes.
pub const ROLLING_BYTES: u64 = 2_000_000_000;
/// Length of a file, s.
pub(super) const SEGMENT_S: f64 = 300.0;
/// Files are not shorter than this for their size, bytes.
const LEAST_SEGMENT_BYTES: u64 = 1_000_000;
/// So many files are within the limit at least.
const LEAST_SEGMENTS: u64 = 8;
/// What the names of the files begin with.
const PREFIX: &str = "rolling_";
/// File with the user's choices.
const SETTINGS: &str = "settings.toml";

/// The user's choices.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// What all files may take, bytes; 0 for no rolling recording.
    limit_bytes: u64,
}

/// The folder of rolling recordings.
#[derive(Clone, Debug, PartialEq)]
pub struct RollingFolder {
    path: PathBuf,
    /// Nothing is recorded while less is free on its disk, bytes.
    pub(crate) least_free_bytes: u64,
    /// Length of a file, s.
    pub(super) segment_s: f64,
}

/// A file of a rolling recording, by its name.
#[derive(Clone, Debug, PartialEq, Eq)]
struct RollingFile {
    path: PathBuf,
    bytes: u64,
    modified: SystemTime,
    /// Identity of its recording.
    id: String,
    /// Number of the segment, from 1.
    number: u32,
}

impl RollingFolder {
    /// The folder, which need not be there yet.
    pub fn of(path: PathBuf) -> Self {
        Self {
            path,
            least_free_bytes: LOW_SPACE_BYTES,
            segment_s: SEGMENT_S,
        }
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What its files may take, bytes; 0 when nothing is recorded. Settings that cannot be read are those without a choice.
    pub fn limit_bytes(&self) -> u64 {
        let path = self.path.join(SETTINGS);
        if !path.is_file() {
            return ROLLING_BYTES;
        }
        let text = SizeLimit::of_kind(64 << 10, "settings").read_text(&path);
        let settings = text.map_err(|e| e.to_string());
        let settings =
            settings.and_then(|t| toml::from_str::<Settings>(&t).map_err(|e| e.to_string()));
        match settings {
            Ok(settings) => settings.limit_bytes,
            Err(e) => {
                log::warn!("{}: {e}", path.display());
                ROLLING_BYTES
            }
        }
    }

    /// Chooses what its files may take, bytes; 0 for no rolling recording.
    ///
    /// # Errors
    /// [`RecordingError::Io`] when the choice cannot be kept.
    pub fn set_limit(&self, limit_bytes: u64) -> Result<(), RecordingError> {
        std::fs::create_dir_all(&self.path).map_err(RecordingError::io(&self.path, "make"))?;
        let path = self.path.join(SETTINGS);
        write_text(&path, &format!("limit_bytes = {limit_bytes}\n"))
    }

    /// What its files take, bytes.
    pub fn used_bytes(&self) -> u64 {
        self.files().iter().map(|f| f.bytes).sum()
    }

    /// A recording that begins now: its identity, the name and the first file.
    pub(super) fn begin(&self, now: &jiff::Zoned) -> std::io::Result<(String, String, PathBuf)> {
        std::fs::create_dir_all(&self.path)?;
        let (ns, process) = (now.timestamp().as_nanosecond(), std::process::id());
        let id = format!("{ns:x}-{process:x}");
        let at = now.strftime("%Y-%m-%d_%H-%M-%S");
        let path = self.path.join(format!("{PREFIX}{at}_{id}.rrd"));
        Ok((id, format!("rolling {at}"), path))
    }

    /// Size after which a file ends, bytes.
    pub(super) fn segment_bytes(&self, limit_bytes: u64) -> u64 {
        (limit_bytes / LEAST_SEGMENTS).clamp(LEAST_SEGMENT_BYTES, 500_000_000)
    }

    /// Removes the oldest files until all take no more than `limit_bytes`. Only files that a rolling recording has made
    /// are removed: the identity in the name is that in the file. One that is being written stays.
    pub(super) fn prune(&self, limit_bytes: u64) {
        let mut files = self.files();
        let sum = |files: &[RollingFile]| files.iter().map(|f| f.bytes).sum::<u64>();
        if sum(&files) <= limit_bytes {
            return;
        }
        files.retain(|f| recording_id(&f.path).is_some_and(|id| id == f.id));
        let mut total = sum(&files);
        for file in files {
            if total <= limit_bytes {
                return;
            }
            if is_being_written(&file.path) {
                continue;
            }
            match std::fs::remove_file(&file.path) {
                Ok(()) => total -= file.bytes,
                Err(e) => log::warn!("{}: cannot be removed: {e}", file.path.display()),
            }
        }
    }

    /// Files that are named like those of a rolling recording, the oldest first.
    fn files(&self) -> Vec<RollingFile> {
        let entries = std::fs::read_dir(&self.path).into_iter().flatten();
        let mut files: Vec<_> = entries
            .flatten()
            .filter_map(|e| RollingFile::of(e.path()))
            .collect();
        files.sort_by(|a, b| (a.modified, &a.path).cmp(&(b.modified, &b.path)));
        files
    }

    /// The files of the recording that begins with `first`, or of the newest one, in their order.
    fn recording(&self, first: Option<&Path>) -> Vec<RollingFile> {
        let mut files = self.files();
        let id = match first {
            Some(first) => RollingFile::named(first).map(|(id, _)| id),
            None => files.last().map(|f| f.id.clone()),
        };
        files.retain(|f| Some(&f.id) == id.as_ref());
        files.sort_by_key(|f| f.number);
        files
    }
}

impl RollingFile {
    /// Identity and number in a name.
    fn named(path: &Path) -> Option<(String, u32)> {
        let name = path.file_name()?.to_str()?;
        let name = name.strip_prefix(PREFIX)?.strip_suffix(".rrd")?;
        let (name, number) = match name.rsplit_once("_part") {
            Some((name, number)) => (name, number.parse().ok()?),
            None => (name, 1),
        };
        let (_, id) = name.rsplit_once('_')?;
        Some((id.to_owned(), number))
    }

    fn of(path: PathBuf) -> Option<Self> {
        let (id, number) = Self::named(&path)?;
        // What a link leads to is not in this folder.
        let about = std::fs::symlink_metadata(&path).ok()?;
        about.is_file().then(|| Self {
            bytes: about.len(),
            modified: about.modified().unwrap_or(SystemTime::UNIX_EPOCH),
            path,
            id,
            number,
        })
    }
}

fn is_being_written(path: &Path) -> bool {
    let file = std::fs::File::options().write(true).open(path);
    file.is_ok_and(|file| !is_own(file.try_lock(), path))
}

/// Makes a recording of the last `seconds` of a rolling recording: of that which begins with the file `first`; `None`:
/// of the newest one. Its marks are in it.
///
/// # Errors
/// [`RecordingError::Unsupported`] when there is none; as [`join`].
pub fn keep_last(
    folder: &RollingFolder,
    first: Option<&Path>,
    seconds: f64,
    out: &Path,
    note: &str,
) -> Result<RecordingSummary, RecordingError> {
    let mut parts: Vec<RecordingFile> = Vec::new();
    let mut from = None;
    for file in folder.recording(first).iter().rev() {
        let file = RecordingFile::open_segment(&file.path)?;
        let Some(last) = file.last() else {
            continue;
        };
        let from = *from.get_or_insert_with(|| last.plus(-seconds));
        if last < from {
            break;
        }
        parts.insert(0, file);
    }
    let (Some(from), Some(begin)) = (from, parts.first()) else {
        return Err(RecordingError::Unsupported {
            path: folder.path.clone(),
            text: "there is no rolling recording: it begins when the arm is armed".to_owned(),
        });
    };
    let from = Stamp(from.0.max(0));
    let source = begin.meta();
    let name = out.file_stem().unwrap_or_default();
    let meta = RecordingMeta {
        id: format!("{}@{}", source.id, from.0),
        name: name.to_string_lossy().into_owned(),
        note: note.to_owned(),
        derived_from: format!("{}, from {:.1} s on", source.name, from.seconds()),
        ..source.clone()
    };
    let selection = Selection {
        from: Some(from),
        ..Selection::default()
    };
    let parts: Vec<_> = parts.iter().map(|file| (file, selection)).collect();
    join(&parts, out, meta)
}

#[cfg(all(test, feature = "rrd"))]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::recording::{QueueFull, Recorder, RecorderState, annotations, read_rrd};
    use crate::signal::Snapshot;

    struct Scratch(RollingFolder);

    impl Scratch {
        fn new(name: &str) -> Self {
            let name = format!("springtwin-rolling-{name}-{}", std::process::id());
            let path = std::env::temp_dir().join(name);
            let _ = std::fs::remove_dir_all(&path);
            Self(RollingFolder {
                least_free_bytes: 0,
                segment_s: 10.0,
                ..RollingFolder::of(path)
            })
        }
    }

    impl Drop for Scratch {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.0.path);
        }
    }

    fn snapshot(n: i64) -> Arc<Snapshot> {
        Arc::new(Snapshot {
            stamp: Stamp(n * 10_000_000),
            ..Snapshot::default()
        })
    }

    fn begin(folder: &RollingFolder) -> Recorder {
        Recorder::start_rolling(folder, RecordingMeta::default(), QueueFull::Wait)
            .expect("is there")
    }

    fn ended(recorder: Recorder) -> RecordingSummary {
        match recorder.stop() {
            RecorderState::Ended(summary) => summary,
            other => panic!("{other:?}"),
        }
    }

    fn names(folder: &RollingFolder) -> Vec<String> {
        let files = folder.files();
        let name = |f: &RollingFile| {
            f.path
                .file_name()
                .expect("is there")
                .to_string_lossy()
                .into_owned()
        };
        files.iter().map(name).collect()
    }

    /// Records `seconds` with a mark at every tenth of them.
    fn record(folder: &RollingFolder, seconds: i64) {
        let recorder = begin(folder);
        for n in 0..seconds * 100 {
            recorder.push(snapshot(n));
            if n % 1000 == 500 {
                recorder.mark(Stamp(n * 10_000_000), format!("at {} s", n / 100));
            }
        }
        assert_eq!(ended(recorder).failed, None);
    }

    #[test]
    fn the_oldest_files_go_and_nothing_else_does() {
        let scratch = Scratch::new("limit");
        let folder = &scratch.0;
        record(folder, 60);
        let all = names(folder);
        assert_eq!(all.len(), 6, "{all:?}");
        // A copy of a recording under such a name, a table, and a link.
        let foreign = folder.path.join("rolling_2020-01-01_00-00-00_abc.rrd");
        std::fs::copy(&folder.files()[0].path, &foreign).unwrap();
        std::fs::write(folder.path.join("notes.txt"), "mine").unwrap();
        #[cfg(unix)]
        std::os::unix::fs::symlink(
            folder.path.join("notes.txt"),
            folder.path.join("rolling_2020-01-01_00-00-00_def.rrd"),
        )
        .unwrap();
        let files = folder.files();
        let newest: u64 = files.iter().rev().take(3).map(|f| f.bytes).sum();
        // The copy is the newest file, and takes none of the limit.
        let kept = newest - files[files.len() - 1].bytes + 1;
        folder.prune(kept);
        let left = names(folder);
        assert!(left.contains(&"rolling_2020-01-01_00-00-00_abc.rrd".to_owned()));
        assert!(foreign.is_file() && folder.path.join("notes.txt").is_file());
        assert_eq!(left[0], all[4], "{left:?}");
        folder.prune(0);
        assert_eq!(names(folder), ["rolling_2020-01-01_00-00-00_abc.rrd"]);
        #[cfg(unix)]
        assert!(
            std::fs::symlink_metadata(folder.path.join("rolling_2020-01-01_00-00-00_def.rrd"))
                .is_ok()
        );
    }

    #[test]
    fn files_are_removed_while_it_is_recorded_and_the_one_that_is_written_stays() {
        let scratch = Scratch::new("under-way");
        let folder = &scratch.0;
        folder.set_limit(1).unwrap();
        assert_eq!(folder.limit_bytes(), 1);
        let recorder = begin(folder);
        for n in 0..5500 {
            recorder.push(snapshot(n));
        }
        let summary = ended(recorder);
        assert_eq!((summary.segments, summary.failed), (6, None));
        let left = names(folder);
        assert_eq!(left.len(), 1, "{left:?}");
        assert!(left[0].ends_with("_part006.rrd"));
    }

    #[test]
    fn a_limit_of_zero_turns_it_off_under_way() {
        let scratch = Scratch::new("off");
        let folder = &scratch.0;
        folder.set_limit(0).unwrap();
        let off = ended(begin(folder));
        assert_eq!((off.segments, off.failed), (0, None));
        assert!(names(folder).is_empty());
        folder.set_limit(ROLLING_BYTES).unwrap();
        let recorder = begin(folder);
        recorder.push(snapshot(0));
        while recorder.state() != RecorderState::Recording {
            std::thread::yield_now();
        }
        folder.set_limit(0).unwrap();
        for n in 1..3000 {
            recorder.push(snapshot(n));
        }
        assert!(matches!(recorder.state(), RecorderState::Ended(_)));
    }

    #[test]
    fn it_stops_where_the_disk_is_nearly_full() {
        let scratch = Scratch::new("full");
        let folder = RollingFolder {
            least_free_bytes: u64::MAX,
            ..scratch.0.clone()
        };
        let recorder = begin(&folder);
        for n in 0..200 {
            recorder.push(snapshot(n));
        }
        let failed = ended(recorder).failed.unwrap();
        assert!(failed.contains("is free on the disk"), "{failed}");
    }

    #[test]
    fn the_last_seconds_become_a_recording_also_when_its_beginning_is_gone() {
        let scratch = Scratch::new("keep");
        let folder = &scratch.0;
        let out = folder.path.join("kept.rrd");
        assert!(keep_last(folder, None, 5.0, &out, "").is_err());
        record(folder, 20);
        record(folder, 60);
        let first = folder.files().into_iter().find(|f| f.number == 1);
        std::fs::remove_file(first.unwrap().path).unwrap();
        let summary = keep_last(folder, None, 25.0, &out, "it slipped").unwrap();
        assert_eq!(summary.rows, 2501);
        let read = read_rrd(&out).unwrap();
        let stamps = read.trace.snapshots.iter().map(|s| s.stamp.seconds());
        let stamps: Vec<f64> = stamps.collect();
        assert!((stamps[0] - 34.99).abs() < 1e-9 && (stamps[2500] - 59.99).abs() < 1e-9);
        assert!(read.complete && read.meta.derived_from.starts_with("rolling "));
        let kept = annotations(&out).unwrap();
        assert_eq!(kept.note, "it slipped");
        let marks: Vec<&str> = kept.marks.iter().map(|m| m.text.as_str()).collect();
        assert_eq!(marks, ["at 35 s", "at 45 s", "at 55 s"]);
        // The first one, by name.
        let files = folder.files();
        let older = files.iter().find(|f| f.id != files[files.len() - 1].id);
        let summary = keep_last(folder, Some(&older.unwrap().path), 1e6, &out, "").unwrap();
        assert!((900..1000).contains(&summary.rows), "{}", summary.rows);
    }

    #[test]
    fn what_is_being_recorded_can_be_kept() {
        let scratch = Scratch::new("live");
        let folder = &scratch.0;
        let recorder = begin(folder);
        for n in 0..1500 {
            recorder.push(snapshot(n));
        }
        // Until the queue is empty and waits for more, which writes what is left.
        let out = folder.path.join("kept.rrd");
        let rows = (0..200).find_map(|_| {
            std::thread::sleep(std::time::Duration::from_millis(50));
            let kept = keep_last(folder, None, 1e6, &out, "").ok()?;
            (kept.rows == 1500).then_some(kept.rows)
        });
        assert_eq!(rows, Some(1500));
        assert_eq!(ended(recorder).rows, 1500);
    }
}
