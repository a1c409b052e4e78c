//! The recordings the window lists and opens.

pub mod film;
pub mod names;
pub mod rename;
mod samples;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::SystemTime;

use jiff::tz::TimeZone;
use springtwin::gui::RecordingEntry;
use springtwin::gui::services::Space;
use springtwin::recording::{
    RecordingError, RecordingFile, free_bytes, inspect, is_later_segment, is_rrd, notes_path,
    segment_path,
};

/// Where the window finds recordings, besides the folder that it records to.
#[derive(Clone, Debug)]
pub struct Places {
    /// Where the samples lie that come with the program; written there when they are not installed.
    samples: PathBuf,
    /// Further folders.
    more: Vec<PathBuf>,
    /// What was listed before.
    known: Arc<Known>,
}

impl Places {
    /// With `scratch` for the samples of a program that is not installed.
    pub fn new(scratch: &Path) -> Self {
        let exe = std::env::current_exe().ok();
        let beside = exe.as_deref().and_then(Path::parent);
        let installed = beside.map(|dir| dir.join("../share/springtwin/recordings"));
        Self {
            samples: installed
                .filter(|folder| folder.is_dir())
                .unwrap_or_else(|| scratch.join("samples")),
            // Where programs before this one recorded to.
            more: vec![PathBuf::from("recordings")],
            known: Arc::default(),
        }
    }

    /// All recordings: those in `folder`, newest first, then others, then the samples. Of two files of one name
    /// and size the first is listed.
    pub fn scan(&self, folder: &Path) -> Vec<RecordingEntry> {
        if let Err(e) = samples::unpack(&self.samples) {
            log::warn!("the sample recordings cannot be written: {e}");
        }
        let mut own = scan(folder, &self.known);
        own.sort_by(|a, b| b.name.cmp(&a.name));
        let mut others: Vec<_> = self
            .more
            .iter()
            .flat_map(|f| scan(f, &self.known))
            .collect();
        others.sort_by(|a, b| a.name.cmp(&b.name));
        let samples = scan(&self.samples, &self.known)
            .into_iter()
            .map(|e| RecordingEntry { sample: true, ..e });
        let mut all: Vec<RecordingEntry> = Vec::new();
        for entry in own.into_iter().chain(samples).chain(others) {
            let same = |e: &RecordingEntry| (&e.name, e.bytes) == (&entry.name, entry.bytes);
            if !all.iter().any(same) {
                all.push(entry);
            }
        }
        // Samples stand last.
        all.sort_by_key(|e| e.sample);
        all
    }
}

/// Recordings of the first layout and sessions that are larger are not opened only to be listed, bytes.
const GLANCE_BYTES: u64 = 32 << 20;

/// What is known of files that were listed, by their size and their time.
#[derive(Debug, Default)]
struct Known(Mutex<HashMap<PathBuf, (u64, SystemTime, RecordingEntry)>>);

impl Known {
    /// The entry of a file that may have been listed before: nothing is read twice.
    fn entry(&self, path: PathBuf, name: String, bytes: u64) -> RecordingEntry {
        let time = |path: &Path| std::fs::metadata(path).and_then(|m| m.modified()).ok();
        let noted = time(&notes_path(&path));
        // Notes are made later than the recording.
        let changed = time(&path).max(noted);
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let (Some((size, time, entry)), Some(changed)) = (known.get(&path), changed)
            && (*size, *time) == (bytes, changed)
        {
            return entry.clone();
        }
        let entry = describe(path.clone(), name, bytes);
        if let Some(changed) = changed {
            known.insert(path, (bytes, changed, entry.clone()));
        }
        entry
    }
}

fn describe(path: PathBuf, name: String, bytes: u64) -> RecordingEntry {
    let entry = RecordingEntry {
        path,
        name,
        bytes,
        ..RecordingEntry::default()
    };
    let stem = stem_of(&entry.path);
    let dated = |recorded: &str| names::begun(recorded, &stem, &TimeZone::system());
    match glance(&entry.path, bytes) {
        Ok(None) => RecordingEntry {
            begun: dated(""),
            ..entry
        },
        Ok(Some(Glance {
            seconds,
            simulated,
            complete,
            noted,
            begun,
        })) => RecordingEntry {
            seconds: Some(seconds),
            simulated,
            noted,
            begun: dated(&begun),
            note: (!complete).then(|| "Cut off: plays to its last whole part.".to_owned()),
            ..entry
        },
        Err(e) => RecordingEntry {
            note: Some(e.to_string()),
            begun: dated(""),
            ..entry
        },
    }
}

/// What is seen of a recording without reading it.
struct Glance {
    seconds: f64,
    simulated: Option<bool>,
    complete: bool,
    /// Note and marks.
    noted: Vec<String>,
    /// Local date and time at which it began, with their offset; may be empty.
    begun: String,
}

/// What a recording is by where its parts lie, without reading them; of other files by reading them.
fn glance(path: &Path, bytes: u64) -> Result<Option<Glance>, RecordingError> {
    if is_rrd(path) {
        let file = RecordingFile::open(path)?;
        if let (Some(first), Some(last)) = (file.first()?, file.last()) {
            return Ok(Some(Glance {
                seconds: last.since(first),
                simulated: file.meta().simulated,
                complete: file.is_complete(),
                noted: noted(&file.meta().note, file.marks()?.into_iter().map(|m| m.text)),
                begun: file.meta().begun.clone(),
            }));
        }
    }
    if bytes > GLANCE_BYTES {
        return Ok(None);
    }
    let seen = inspect(path)?;
    let note = seen.provenance.as_ref().map_or("", |p| p.note.as_str());
    Ok(Some(Glance {
        seconds: seen.seconds,
        simulated: seen.simulated,
        complete: seen.complete,
        noted: noted(note, seen.marks.iter().map(|m| m.text.clone())),
        begun: seen.provenance.map_or_else(String::new, |p| p.begun),
    }))
}

/// The note, where there is one, and the texts of the marks.
fn noted(note: &str, marks: impl Iterator<Item = String>) -> Vec<String> {
    let note = Some(note.to_owned()).filter(|n| !n.is_empty());
    note.into_iter().chain(marks).collect()
}

/// The recordings in a folder, in order of name; none where there is no folder.
fn scan(folder: &Path, known: &Known) -> Vec<RecordingEntry> {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return Vec::new();
    };
    let mut found = Vec::new();
    for entry in entries.flatten() {
        let path = entry.path();
        let is_session = path.join("session.toml").is_file();
        if !is_session && (!is_rrd(&path) || is_later_segment(&path)) {
            continue;
        }
        let stem = stem_of(&path);
        let bytes = if is_session {
            std::fs::metadata(path.join("log.csv")).map_or(0, |m| m.len())
        } else {
            size_of_all(&path)
        };
        // The name of a recording that has not begun yet.
        if bytes == 0 {
            continue;
        }
        found.push(known.entry(path, names::shown(&stem, &TimeZone::system()), bytes));
    }
    found.sort_by(|a, b| a.name.cmp(&b.name));
    found
}

/// Name of a file without its ending.
fn stem_of(path: &Path) -> String {
    let stem = path.file_stem();
    stem.map_or_else(String::new, |s| s.to_string_lossy().into_owned())
}

/// What a folder has left for recordings, and what the recording `name` in it takes. A folder that is not there yet
/// has what the one above it has.
pub fn space(folder: &Path, name: &str) -> Space {
    let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    let there = folder.ancestors().find(|f| f.is_dir());
    let written = || size_of_all(&folder.join(format!("{name}.rrd")));
    Space {
        free_bytes: there.and_then(|f| free_bytes(&f.join("new.rrd"))),
        written_bytes: if name.is_empty() { 0 } else { written() },
        local: names::minute(jiff::Zoned::now().datetime()),
    }
}

/// Size of a recording with all its segments, bytes.
fn size_of_all(path: &Path) -> u64 {
    let size = |n| {
        std::fs::metadata(segment_path(path, n))
            .ok()
            .map(|m| m.len())
    };
    (1..).map_while(size).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use springtwin::lab::loading::load;
    use springtwin::robot::RobotSpec;

    #[test]
    fn a_recording_with_its_ending_in_capitals_is_one() {
        let whole = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/point-to-point.rrd");
        let name = format!("springtwin-capitals-{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&folder).expect("folder");
        let path = folder.join("X.RRD");
        std::fs::copy(&whole, &path).expect("copied");
        let (listed, loaded) = (
            scan(&folder, &Known::default()),
            load(&RobotSpec::reference(), &path, &mut |_| true),
        );
        std::fs::remove_dir_all(&folder).expect("removed");
        assert_eq!(listed.len(), 1);
        assert!(loaded.is_ok_and(|l| !l.trace.snapshots.is_empty()));
    }

    #[test]
    fn samples_and_new_recordings_are_listed_wherever_the_program_is_started() {
        let name = format!("springtwin-library-{}", std::process::id());
        let home = std::env::temp_dir().join(name);
        let recordings = home.join("data/recordings");
        let places = Places {
            samples: home.join("data/samples"),
            more: vec![home.join("nowhere")],
            known: Arc::default(),
        };
        let names = |entries: &[RecordingEntry]| -> Vec<String> {
            entries.iter().map(|e| e.name.clone()).collect()
        };
        let empty = places.scan(&recordings);
        assert_eq!(names(&empty), ["payload-200g", "point-to-point"]);
        assert!(empty.iter().all(|e| e.sample && e.seconds.is_some()));
        let at: jiff::civil::DateTime = "2026-11-23T14:05:12".parse().expect("a time");
        let first = names::fresh(&recordings, at, "").expect("the folder is made");
        let sample = &empty[0].path;
        std::fs::copy(sample, &first).expect("recorded");
        let left = space(&recordings.join("not/yet"), "");
        assert!(!cfg!(unix) || left.free_bytes.is_some_and(|b| b > 0));
        assert_eq!(left.written_bytes, 0);
        let taken = space(&recordings, "2026-11-23_14-05-12").written_bytes;
        assert_eq!(Some(taken), std::fs::metadata(&first).ok().map(|m| m.len()));
        let second = names::fresh(&recordings, at, "").expect("the folder is there");
        std::fs::copy(sample, &second).expect("recorded");
        std::fs::copy(sample, recordings.join("session-1763906712-77.rrd")).expect("copied");
        let listed = places.scan(&recordings);
        std::fs::remove_dir_all(home).expect("removed");
        assert_eq!(
            names(&listed)[..2],
            ["2026-11-23_14-05-12-2", "2026-11-23_14-05-12"]
        );
        assert!(
            listed[2].name.ends_with("(session-1763906712-77)"),
            "{}",
            listed[2].name
        );
        assert_eq!(listed.len(), 5);
    }

    #[test]
    fn a_recording_that_was_cut_loads_to_its_last_record_and_says_so() {
        let robot = RobotSpec::reference();
        let whole = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/point-to-point.rrd");
        let all = load(&robot, &whole, &mut |_| true).expect("the sample recording");
        assert!(all.about.cut_at.is_none() && !all.about.channels.is_empty());
        assert!(!all.about.events.is_empty());
        let bytes = std::fs::read(&whole).expect("the sample recording");
        let name = format!("springtwin-cut-{}.rrd", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, &bytes[..bytes.len() * 6 / 10]).expect("written");
        let cut = load(&robot, &path, &mut |_| true);
        let entry = describe(path.clone(), "cut".into(), 1);
        std::fs::remove_file(&path).expect("removed");
        let cut = cut.expect("its first part is whole");
        let last = cut.trace.snapshots.last().map(|s| s.stamp);
        assert!(last.is_some() && cut.about.cut_at == last);
        assert!(cut.trace.snapshots.len() < all.trace.snapshots.len());
        assert_eq!(
            entry.note.as_deref(),
            Some("Cut off: plays to its last whole part.")
        );
    }
}
