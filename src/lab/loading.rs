//! Recordings and session logs as the window plays them: snapshots, and what else is known of them.

use std::path::Path;

use super::predicted;
use crate::analysis::recorded::{About, ChannelFacts, ChannelFault, Loaded, LoggedEvent};
use crate::recording::{
    Inspection, Inspector, RecordedEvent, RecordingFile, Selection, SizeLimit, Thinning,
    inspect_log, is_rrd, part_of, read_session_with,
};
use crate::robot::RobotSpec;
use crate::signal::{Snapshot, Stamp, Trace};

/// Snapshots that are held at most: 20 min at 100 Hz, 0.5 GB. Of a longer recording the window reads what is near the
/// position again, at its full rate.
const SNAPSHOTS: u64 = 120_000;

/// Reads a recording or a session log, or the part of it that is named as [`part_of`] has it, and looks into it. Of a long
/// recording there are fewer snapshots, evenly apart ([`About::apart_s`]). What nothing estimates is completed by the
/// model of `robot`. Given up when `go_on`, which receives the share that is done, answers `false`.
///
/// # Errors
/// A sentence: what is not there, cannot be read or does not fit the memory, or that the work was given up.
pub fn load(
    robot: &RobotSpec,
    path: &Path,
    go_on: &mut dyn FnMut(f32) -> bool,
) -> Result<Loaded, String> {
    let mut loaded = read(path, go_on)?;
    if let Err(e) = predicted::complete(robot, &mut loaded.trace) {
        log::warn!("{} is shown without its arm: {e}", path.display());
    }
    Ok(loaded)
}

/// As [`load`], of the part from one time to another, s since the session's start; without one, from or to the end.
///
/// # Errors
/// As [`load`].
pub fn load_part(
    robot: &RobotSpec,
    path: &Path,
    [from, to]: [Option<f64>; 2],
    go_on: &mut dyn FnMut(f32) -> bool,
) -> Result<Loaded, String> {
    if from.is_none() && to.is_none() {
        return load(robot, path, go_on);
    }
    if !path.exists() {
        return Err(format!("{} is not there.", path.display()));
    }
    let bound = |s: Option<f64>| s.map_or_else(String::new, |s| s.to_string());
    let part = format!("{}@{}..{}", path.display(), bound(from), bound(to));
    load(robot, Path::new(&part), go_on)
}

fn read(path: &Path, go_on: &mut dyn FnMut(f32) -> bool) -> Result<Loaded, String> {
    let (path, part) = part_of(path).map_err(|e| e.to_string())?;
    let path = path.as_path();
    if !is_rrd(path) {
        let log = read_session_with(path, go_on).map_err(|e| e.to_string())?;
        let log = log.part(&part);
        let (each, rows) = (size_of::<Snapshot>() as u64, log.len() as u64);
        let fits = SizeLimit::of_memory().check_count(path, rows, "rows", each);
        fits.map_err(|e| e.to_string())?;
        let seen = inspect_log(&log);
        let about = about(path, &seen, Vec::new());
        let mut trace = log.to_trace();
        hold_truth(&mut trace);
        return Ok(Loaded { trace, about });
    }
    let file = RecordingFile::open(path).map_err(|e| e.to_string())?;
    let apart_s = apart_s(&file, &part);
    let mut thinning = Thinning::new(apart_s.unwrap_or(0.0));
    let (mut trace, mut events) = (Trace::default(), Vec::new());
    let rows = file.rows_in(&part).unwrap_or(0).min(SNAPSHOTS);
    trace.snapshots.reserve(rows as usize);
    let mut inspector = Inspector::default();
    let read = file.read_in_windows(&part, go_on, &mut |mut window| {
        inspector.take(&window);
        events.append(&mut window.read.events);
        let mut snapshots = std::mem::take(&mut trace.snapshots);
        let new = &mut window.read.trace.snapshots;
        new.retain(|s| thinning.takes(s.stamp));
        snapshots.append(new);
        trace = Trace {
            snapshots,
            ..window.read.trace
        };
    });
    read.map_err(|e| e.to_string())?;
    let about = About {
        note: file.meta().note.clone(),
        begun: Some(file.meta().begun.clone()).filter(|b| !b.is_empty()),
        apart_s,
        ..about(path, &inspector.finish(), events)
    };
    Ok(Loaded { trace, about })
}

/// Motion capture that is slower than a log: its newest pose stays, as on a live twin.
fn hold_truth(trace: &mut Trace) {
    let mut newest = None;
    for s in &mut trace.snapshots {
        match &s.truth {
            Some(_) => newest.clone_from(&s.truth),
            None => s.truth.clone_from(&newest),
        }
    }
}

/// How far apart the snapshots of a part of a recording must be for the window to hold them, s; `None` for all of them.
fn apart_s(file: &RecordingFile, part: &Selection) -> Option<f64> {
    let (rows, last) = (file.rows_in(part)?, file.last()?);
    let from_s = part.from.map_or(0.0, Stamp::seconds);
    let to_s = part.to.map_or(last, |to| to.min(last)).seconds();
    (rows > SNAPSHOTS).then(|| (100.0 * (to_s - from_s) / SNAPSHOTS as f64).ceil() / 100.0)
}

fn about(path: &Path, seen: &Inspection, events: Vec<RecordedEvent>) -> About {
    let events = events.into_iter().map(|e| LoggedEvent {
        stamp: e.stamp,
        log: e.log,
        text: e.text,
    });
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
        path: Some(path.to_owned()),
        events: events.collect(),
        channels: channels.collect(),
        faults: faults.collect(),
        gaps: seen.health.gaps,
        longest_step_s: seen.health.longest_step_s,
        cut_at: seen.recovered_until.map(Stamp::from_seconds),
        ..About::default()
    }
}
