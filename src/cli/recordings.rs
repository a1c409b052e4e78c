//! `cut`, `merge`, `convert`, `reprocess`: recordings made of others; `note`: what is noted on one; `keep`: the end of a rolling
//! one.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Args;
use serde_json::json;

use super::model;
use super::outputs::Overwrite;
use super::progress::Bar;
use super::{Report, args, user};
use springtwin::drive::read_toml;
use springtwin::lab::reprocess::{Means, reprocess};
use springtwin::recording::{
    Mark, NoteChange, RecordingFile, RecordingMeta, RecordingSummary, RecordingWriter, Selection,
    annotate, annotations, is_mcap, is_rrd, join, keep_last, read_log, session_table, table_file,
    write_mcap, write_session_table,
};
use springtwin::robot::RobotSpec;
use springtwin::signal::Stamp;

#[cfg(feature = "gui")]
#[derive(Args)]
pub struct OpenArgs {
    /// Recording (.rrd), session folder or session.toml; one that is being written is shown up to now
    #[arg(value_name = "F.rrd|SESSION")]
    file: PathBuf,
}

#[cfg(feature = "gui")]
impl OpenArgs {
    /// The file, if it can be opened at all.
    pub fn checked(&self) -> Result<PathBuf> {
        match is_rrd(&self.file) {
            true => drop(RecordingFile::open(&self.file)?),
            false => anyhow::ensure!(
                self.file.exists(),
                "{} is not there: name a recording (.rrd) or a session",
                self.file.display()
            ),
        }
        Ok(self.file.canonicalize()?)
    }
}

#[derive(Args)]
pub struct CutArgs {
    /// Recording
    #[arg(value_name = "F.rrd")]
    recording: PathBuf,
    /// From this time on, s since the session's start
    #[arg(long, value_name = "S", value_parser = args::not_negative)]
    from: Option<f64>,
    /// Up to this time, s since the session's start
    #[arg(long, value_name = "S", value_parser = args::not_negative)]
    to: Option<f64>,
    /// The part
    #[arg(long, value_name = "F.rrd")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
}

/// `cut`.
pub fn cut(a: &CutArgs) -> Result<Report> {
    recording_file(a.overwrite, &a.out, &[&a.recording])?;
    anyhow::ensure!(
        a.from.is_some() || a.to.is_some(),
        "name the part with --from, --to, or both (s)"
    );
    anyhow::ensure!(
        a.from.zip(a.to).is_none_or(|(from, to)| from < to),
        "--from must be before --to"
    );
    let file = RecordingFile::open(&a.recording)?;
    let part = Selection::between(a.from, a.to);
    let bound = |s: Option<f64>| s.map_or(String::new(), |s| s.to_string());
    let range = format!("{}..{} s", bound(a.from), bound(a.to));
    let meta = RecordingMeta {
        id: format!("{}@{range}", file.meta().id),
        name: name_of(&a.out),
        derived_from: format!("{}, {range} ({})", file.meta().name, file.meta().id),
        ..file.meta().clone()
    };
    let summary = join(&[(&file, part)], &a.out, meta)?;
    Ok(written(&a.out, &summary))
}

#[derive(Args)]
pub struct MergeArgs {
    /// Recordings of one session, in their order
    #[arg(value_name = "F.rrd", num_args = 2.., required = true)]
    recordings: Vec<PathBuf>,
    /// All of them in one
    #[arg(long, value_name = "F.rrd")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
}

/// `merge`.
pub fn merge(a: &MergeArgs) -> Result<Report> {
    let inputs: Vec<&Path> = a.recordings.iter().map(PathBuf::as_path).collect();
    recording_file(a.overwrite, &a.out, &inputs)?;
    let files = inputs.iter().map(|path| RecordingFile::open(path));
    let files = files.collect::<Result<Vec<_>, _>>()?;
    let first = files.first().context("there is nothing to merge")?.meta();
    for (path, file) in inputs.iter().zip(&files) {
        let m = file.meta();
        for (what, one, other) in [
            ("robot file", &first.robot_hash, &m.robot_hash),
            ("calibration", &first.calibration, &m.calibration),
        ] {
            anyhow::ensure!(
                one == other,
                "{} has another {what} than {}: merge recordings of one session only",
                path.display(),
                inputs[0].display()
            );
        }
    }
    let names: Vec<&str> = files.iter().map(|f| f.meta().name.as_str()).collect();
    let notes = files.iter().map(|f| f.meta().note.as_str());
    let mut notes: Vec<&str> = notes.filter(|n| !n.is_empty()).collect();
    notes.dedup();
    let meta = RecordingMeta {
        id: format!("{}+{}", first.id, files.len() - 1),
        name: name_of(&a.out),
        derived_from: names.join(" + "),
        note: notes.join("\n"),
        ..first.clone()
    };
    let parts: Vec<_> = files.iter().map(|f| (f, Selection::default())).collect();
    let summary = join(&parts, &a.out, meta)?;
    Ok(written(&a.out, &summary))
}

#[derive(Args)]
pub struct ConvertArgs {
    /// Recording or session, or a part of it: F.rrd@FROM..TO (s)
    #[arg(value_name = "F.rrd|SESSION")]
    input: PathBuf,
    /// Table of what was measured (.csv, .parquet; readings as the sensors gave them), ROS 2 messages (.mcap), or recording (.rrd)
    #[arg(value_name = "F.csv|F.parquet|F.mcap|F.rrd")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
}

/// `convert`.
pub fn convert(a: &ConvertArgs) -> Result<Report> {
    if !is_rrd(&a.out) && !is_mcap(&a.out) {
        table_file(&a.out)?;
    }
    recording_file(a.overwrite, &a.out, &[&a.input])?;
    if is_mcap(&a.out) {
        let summary = write_mcap(&a.input, &a.out)?;
        return Ok(Report {
            text: format!(
                "{} samples in {} messages in {}",
                summary.rows,
                summary.messages,
                a.out.display()
            ),
            json: json!({"out": a.out, "rows": summary.rows, "messages": summary.messages}),
        });
    }
    let log = read_log(&a.input)?;
    if is_rrd(&a.out) {
        let trace = log.to_trace();
        let meta = RecordingMeta {
            name: log.name.clone(),
            robot_hash: log.robot.clone(),
            payload_kg: log.payload_kg,
            derived_from: format!("the session {}", log.name),
            corrected_by: log.corrected_by.clone(),
            simulated: log.simulated,
            ..RecordingMeta::default()
        };
        let mut writer = RecordingWriter::create(&a.out, meta)?;
        for snapshot in &trace.snapshots {
            writer.push(snapshot)?;
        }
        return Ok(written(&a.out, &writer.finish()?));
    }
    // A table has no place to state by what its readings are corrected: it has them as the sensors gave them.
    let corrected = log.corrected_by.is_some();
    let log = log.uncorrected();
    match a
        .out
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("csv"))
    {
        true => write_session_table(&a.out, &log)?,
        false => session_table(&log).write(&a.out)?,
    }
    let mut text = format!("{} rows in {}", log.len(), a.out.display());
    if corrected {
        text +=
            "; readings as the sensors gave them, without the corrections of the robot's patches";
    }
    Ok(Report {
        text,
        json: json!({"out": a.out, "rows": log.len(), "corrections_taken_back": corrected}),
    })
}

#[derive(Args)]
pub struct KeepArgs {
    /// The recording
    #[arg(long, value_name = "F.rrd")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// How many minutes of it
    #[arg(long, value_name = "MIN", default_value = "5", value_parser = args::not_negative)]
    minutes: f64,
    /// The operator's note
    #[arg(long, value_name = "TEXT")]
    note: Option<String>,
}

/// `keep`: of the newest rolling recording.
pub fn keep(a: &KeepArgs) -> Result<Report> {
    recording_file(a.overwrite, &a.out, &[])?;
    let folder = user::rolling_folder()
        .context("this user has no data folder, and therefore no rolling recordings")?;
    let note = a.note.as_deref().unwrap_or_default();
    let summary = keep_last(&folder, None, 60.0 * a.minutes, &a.out, note)?;
    Ok(written(&a.out, &summary))
}

#[derive(Args)]
pub struct NoteArgs {
    /// Recording
    #[arg(value_name = "F.rrd")]
    recording: PathBuf,
    /// The note, in place of the one before; empty for none
    #[arg(long, value_name = "TEXT")]
    text: Option<String>,
    /// A mark at a time, s since the session's start; may be given again
    #[arg(long, value_name = "S=TEXT", value_parser = mark)]
    mark: Vec<Mark>,
    /// Remove the marks at this time, as it is printed; may be given again
    #[arg(long, value_name = "S", value_parser = args::not_negative)]
    remove: Vec<f64>,
}

/// `S=TEXT`.
fn mark(text: &str) -> std::result::Result<Mark, String> {
    let (at_s, text) = text
        .split_once('=')
        .filter(|(_, text)| !text.trim().is_empty())
        .ok_or_else(|| format!("'{text}' is no mark: write S=TEXT, such as 12.5=\"touched\""))?;
    Ok(Mark {
        stamp: Stamp::from_seconds(args::not_negative(at_s)?),
        text: text.trim().to_owned(),
    })
}

/// `note`: shows note and marks, and changes them.
pub fn note(a: &NoteArgs) -> Result<Report> {
    anyhow::ensure!(
        is_rrd(&a.recording),
        "{} is no recording (.rrd): only these have notes",
        a.recording.display()
    );
    let known = annotations(&a.recording)?;
    let mut changes: Vec<NoteChange> = a.text.clone().map(NoteChange::Note).into_iter().collect();
    for at_s in &a.remove {
        // Times are printed to a millisecond.
        let near = |m: &&Mark| (m.stamp.seconds() - at_s).abs() <= 5e-4;
        let before = changes.len();
        let marks = known.marks.iter().filter(near).cloned();
        changes.extend(marks.map(NoteChange::Remove));
        anyhow::ensure!(changes.len() > before, "there is no mark at {at_s} s");
    }
    changes.extend(a.mark.iter().cloned().map(NoteChange::Add));
    let now = match changes.is_empty() {
        true => known,
        false => annotate(&a.recording, &changes)?,
    };
    let mut text = vec![match now.note.as_str() {
        "" => "no note".to_owned(),
        note => note.to_owned(),
    }];
    let line = |m: &Mark| format!("{:10.3} s  {}", m.stamp.seconds(), m.text);
    text.extend(now.marks.iter().map(line));
    let object = |m: &Mark| json!({"at_s": m.stamp.seconds(), "text": m.text});
    let marks: Vec<_> = now.marks.iter().map(object).collect();
    Ok(Report {
        text: text.join("\n"),
        json: json!({"recording": a.recording, "note": now.note, "marks": marks}),
    })
}

#[derive(Args)]
pub struct ReprocessArgs {
    /// Recording with raw frames
    #[arg(value_name = "F.rrd")]
    recording: PathBuf,
    /// The recording with lengths, angles and poses that were computed again
    #[arg(long, value_name = "F.rrd")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Calibration of springs and IMUs; the one in the recording without it
    #[arg(long, value_name = "F.toml")]
    calibration: Option<PathBuf>,
    /// Networks; those that ship for such a rig without it
    #[arg(long, value_name = "F.safetensors")]
    networks: Option<PathBuf>,
}

/// `reprocess`.
pub fn reprocess_command(a: &ReprocessArgs, robot: &RobotSpec) -> Result<Report> {
    recording_file(a.overwrite, &a.out, &[&a.recording])?;
    let source = RecordingFile::open(&a.recording)?;
    let old = source.meta().clone();
    anyhow::ensure!(
        old.robot_hash.is_empty() || [&robot.hash, &robot.base_hash].contains(&&old.robot_hash),
        "{} was recorded with another robot file ({}): name it with --robot",
        a.recording.display(),
        old.robot
    );
    let maps = model::maps_for(robot, &rig_of(&old), a.networks.as_deref())?;
    let means = Means {
        robot,
        maps: &maps,
        calibration: a.calibration.as_deref().map(read_toml).transpose()?,
    };
    let summary = reprocess(&a.recording, &a.out, &means, &Bar::default())?;
    let mut report = written(&a.out, &summary);
    let changed = [
        (
            "calibration",
            means
                .calibration
                .as_ref()
                .is_some_and(|c| *c != old.calibration),
        ),
        (
            "networks",
            !old.networks.is_empty() && old.networks != maps.networks,
        ),
        (
            "version of the program",
            old.program != env!("CARGO_PKG_VERSION"),
        ),
    ];
    let changed: Vec<&str> = changed
        .iter()
        .filter(|(_, is)| *is)
        .map(|(what, _)| *what)
        .collect();
    if !changed.is_empty() {
        report.text += &format!("; with another {}", changed.join(", another "));
    }
    report.json["changed"] = json!(changed);
    Ok(report)
}

/// The rig that a recording is of, as networks are chosen by.
fn rig_of(meta: &RecordingMeta) -> String {
    match meta.simulated {
        Some(true) => springtwin::drive::DEFAULT_RIG.to_owned(),
        _ => meta.source.clone(),
    }
}

fn name_of(path: &Path) -> String {
    path.file_stem()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

/// Refuses a file that is there unless it may be replaced, and one that is read.
fn recording_file(overwrite: Overwrite, out: &Path, inputs: &[&Path]) -> Result<()> {
    overwrite.file(out)?;
    let same = |input: &&Path| {
        let [a, b] = [*input, out].map(|p| p.canonicalize().ok());
        a.is_some() && a == b
    };
    anyhow::ensure!(
        !inputs.iter().any(same),
        "{} is read and cannot be written at the same time: give another name",
        out.display()
    );
    Ok(())
}

fn written(out: &Path, summary: &RecordingSummary) -> Report {
    let parts = match summary.segments {
        0 | 1 => String::new(),
        n => format!(" in {n} files"),
    };
    Report {
        text: format!(
            "{} snapshots in {}{parts} ({:.1} MB)",
            summary.rows,
            out.display(),
            summary.bytes as f64 * 1e-6
        ),
        json: json!({
            "out": out, "rows": summary.rows, "bytes": summary.bytes, "segments": summary.segments,
        }),
    }
}
