//! The recordings the window lists and opens.

use std::path::{Path, PathBuf};

use springtwin::gui::RecordingEntry;
use springtwin::gui::services::{About, ChannelFacts, ChannelFault, Loaded, LoggedEvent};
use springtwin::recording::{
    Inspection, inspect, inspect_log, inspect_recording, is_rrd, read_rrd_with, read_session_with,
};
use springtwin::signal::Stamp;

/// Folders that are looked through for recordings.
pub fn folders() -> Vec<PathBuf> {
    let mut folders = vec![PathBuf::from("recordings")];
    if let Ok(exe) = std::env::current_exe()
        && let Some(dir) = exe.parent()
    {
        folders.push(dir.join("recordings"));
        folders.push(dir.join("../share/springtwin/recordings"));
    }
    folders
}

/// Larger recordings are not opened only to be listed, bytes.
const GLANCE_BYTES: u64 = 32 << 20;

fn describe(path: PathBuf, name: String, bytes: u64) -> RecordingEntry {
    let entry = RecordingEntry {
        path,
        name,
        bytes,
        ..RecordingEntry::default()
    };
    if bytes > GLANCE_BYTES {
        return entry;
    }
    match inspect(&entry.path) {
        Ok(seen) => RecordingEntry {
            seconds: Some(seen.seconds),
            simulated: seen.simulated,
            note: (!seen.complete).then(|| "Cut off: plays to its last whole part.".to_owned()),
            ..entry
        },
        Err(e) => RecordingEntry {
            note: Some(e.to_string()),
            ..entry
        },
    }
}

pub fn scan(folders: &[PathBuf]) -> Vec<RecordingEntry> {
    let mut found = Vec::new();
    for folder in folders {
        let Ok(entries) = std::fs::read_dir(folder) else {
            continue;
        };
        for entry in entries.flatten() {
            let path = entry.path();
            let is_session = path.join("session.toml").is_file();
            if !is_session && !is_rrd(&path) {
                continue;
            }
            let name = path
                .file_stem()
                .map_or_else(String::new, |s| s.to_string_lossy().into_owned());
            let bytes = if is_session {
                std::fs::metadata(path.join("log.csv")).map_or(0, |m| m.len())
            } else {
                entry.metadata().map_or(0, |m| m.len())
            };
            found.push(describe(path, name, bytes));
        }
    }
    found.sort_by(|a, b| a.name.cmp(&b.name));
    found
}

/// Reads a recording or a session log, and looks into it. Given up when `go_on`, which is told the share that
/// is done, answers `false`.
pub fn load(path: &Path, go_on: &mut dyn FnMut(f32) -> bool) -> Result<Loaded, String> {
    let (trace, events, seen) = if is_rrd(path) {
        let read = read_rrd_with(path, go_on).map_err(|e| e.to_string())?;
        let seen = inspect_recording(&read);
        (read.trace, read.events, seen)
    } else {
        let log = read_session_with(path, go_on).map_err(|e| e.to_string())?;
        let seen = inspect_log(&log);
        (log.to_trace(), Vec::new(), seen)
    };
    let events = events.into_iter().map(|e| LoggedEvent {
        stamp: e.stamp,
        log: e.log,
        text: e.text,
    });
    let about = About {
        path: Some(path.to_owned()),
        events: events.collect(),
        ..about(&seen)
    };
    Ok(Loaded { trace, about })
}

fn about(seen: &Inspection) -> About {
    let channels = seen.channels.iter().map(|c| ChannelFacts {
        name: c.name.clone(),
        unit: c.unit.clone(),
        rows: c.rows,
        rate_hz: c.rate_hz,
    });
    let faults = seen.health.channels.iter().map(|c| ChannelFault {
        name: c.name.clone(),
        missing: c.missing,
        flagged: c.flagged,
    });
    About {
        channels: channels.collect(),
        faults: faults.collect(),
        gaps: seen.health.gaps,
        longest_step_s: seen.health.longest_step_s,
        cut_at: seen.recovered_until.map(Stamp::from_seconds),
        ..About::default()
    }
}

/// `recordings/session-<seconds since 1970>.rrd`.
pub fn default_recording() -> PathBuf {
    #[expect(
        clippy::disallowed_methods,
        reason = "a file name tells when it was made"
    )]
    let now = std::time::SystemTime::now();
    let seconds = now
        .duration_since(std::time::UNIX_EPOCH)
        .map_or(0, |d| d.as_secs());
    let folder = PathBuf::from("recordings");
    // Of two windows on one computer, each has a name of its own.
    let name = folder.join(format!("session-{seconds}.rrd"));
    match name.exists() {
        true => folder.join(format!("session-{seconds}-{}.rrd", std::process::id())),
        false => name,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_with_its_ending_in_capitals_is_one() {
        let whole = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/point-to-point.rrd");
        let name = format!("springtwin-capitals-{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&folder).expect("folder");
        let path = folder.join("X.RRD");
        std::fs::copy(&whole, &path).expect("copied");
        let (listed, loaded) = (
            scan(std::slice::from_ref(&folder)),
            load(&path, &mut |_| true),
        );
        std::fs::remove_dir_all(&folder).expect("removed");
        assert_eq!(listed.len(), 1);
        assert!(loaded.is_ok_and(|l| !l.trace.snapshots.is_empty()));
    }

    #[test]
    fn a_recording_that_was_cut_loads_to_its_last_record_and_says_so() {
        let whole = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/point-to-point.rrd");
        let all = load(&whole, &mut |_| true).expect("the sample recording");
        assert!(all.about.cut_at.is_none() && !all.about.channels.is_empty());
        assert!(!all.about.events.is_empty());
        let bytes = std::fs::read(&whole).expect("the sample recording");
        let name = format!("springtwin-cut-{}.rrd", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, &bytes[..bytes.len() * 6 / 10]).expect("written");
        let cut = load(&path, &mut |_| true);
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
