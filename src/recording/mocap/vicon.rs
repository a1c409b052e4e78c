//! Tables of Vicon Nexus and Tracker: sections of a title, a rate, names, columns, units and rows.
//!
//! ```text
//! Segments
//! 200
//! ,,Subject:Object,,,,,,
//! Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ
//! ,,deg,deg,deg,mm,mm,mm
//! 1,0,0.710638,0.853171,5.68858,128.549,175.789,492.51
//! ```
//!
//! Tracker writes `Global Angle Subject:Object` for the name. Its three rotations may be helical or Euler
//! angles; unless a heading states which, they are helical, and no longer than half a turn.

use std::io::BufRead;
use std::path::Path;

use nalgebra::Vector3;

use super::columns::{Block, Source, Track, blocks, has_sub_frame, name_of};
use super::file::{ACCEPTED, MocapFile, MocapFormat, RATE_MAX_HZ, unsupported};
use super::rotation::MocapRotation;
use super::sections::{Section, join};
use super::table::{LINE_MAX, Row, Seen, Table};
use crate::recording::RecordingError;
use crate::recording::csv::Lines;

/// Refuses a text that is no such table: it has no line that begins with `Frame`.
pub(super) fn refuse_others(reader: impl BufRead, path: &Path) -> Result<(), RecordingError> {
    let seen = Seen::default();
    let mut tap = |bytes: &[u8]| seen.take(bytes);
    let mut lines = Lines::with_max(reader, path, &mut tap, LINE_MAX);
    // A line that is no text or has no end: some other file.
    while let Ok(Some(line)) = lines.next_line() {
        let first = line.trim_start_matches([' ', '\t', '"']);
        let starts = |word: &str| {
            let head = first.as_bytes().get(..word.len());
            head.is_some_and(|h| h.eq_ignore_ascii_case(word.as_bytes()))
        };
        if starts("Frame;") || starts("Frame\t") {
            return Err(unsupported(
                path,
                "the columns are separated by semicolons or tabs: export them separated by commas, with decimal points",
            ));
        }
        if starts("Frame,") || starts("Frame\"") || line.trim() == "Frame" {
            return Ok(());
        }
    }
    Err(unsupported(
        path,
        format!("this is no motion-capture file that can be read: {ACCEPTED}"),
    ))
}

/// What stands above a section's columns.
#[derive(Default)]
struct Preamble {
    title: String,
    /// With its line.
    rate_hz: Option<(f64, usize)>,
    names: Vec<String>,
}

impl Preamble {
    fn take(&mut self, row: &Row<'_>) {
        match row.alone() {
            Some(text) => match text.parse::<f64>() {
                Ok(rate) => self.rate_hz = Some((rate, row.line)),
                // What a section before this one left behind is not of this one.
                Err(_) => {
                    *self = Self {
                        title: text.to_owned(),
                        ..Self::default()
                    };
                }
            },
            None => self.names = row.to_texts(),
        }
    }

    /// What kind of section it is; `None` for one that is ignored.
    fn format(&self) -> Option<MocapFormat> {
        match self.title.to_ascii_lowercase().as_str() {
            "trajectories" => Some(MocapFormat::ViconTrajectories),
            "segments" => Some(MocapFormat::ViconSegments),
            "objects" => Some(MocapFormat::ViconTracker),
            // Tracker's two lines on top are not always those.
            _ => self
                .names
                .iter()
                .any(|n| name_of(n).is_global)
                .then_some(MocapFormat::ViconTracker),
        }
    }
}

/// Where the reader stands.
enum State {
    /// Above a section's columns.
    Above(Preamble),
    /// Behind the line of column names: units follow.
    Units {
        preamble: Preamble,
        format: MocapFormat,
        columns: Vec<String>,
    },
    Rows(Section, Vec<Block>),
    /// In a section that is not read.
    Over,
}

/// Reads such a table.
pub(super) fn parse(
    reader: impl BufRead,
    path: &Path,
    wanted: Option<MocapRotation>,
) -> Result<MocapFile, RecordingError> {
    let seen = Seen::default();
    let mut tap = |bytes: &[u8]| seen.take(bytes);
    let lines = Lines::with_max(reader, path, &mut tap, LINE_MAX);
    let mut table = Table::new(lines, path, &seen);
    let mut sections = Vec::new();
    let mut notes = Vec::new();
    let mut state = State::Above(Preamble::default());
    while let Some(row) = table.next_row()? {
        state = step(state, &row, wanted, &seen, &mut sections, &mut notes)?;
    }
    match state {
        State::Rows(section, _) => sections.push(section),
        State::Units { .. } => {
            return Err(unsupported(
                path,
                "the file ends behind its column names: export it again",
            ));
        }
        State::Above(_) | State::Over => {}
    }
    join(path, sections, notes, &seen)
}

/// Takes one line.
fn step(
    state: State,
    row: &Row<'_>,
    wanted: Option<MocapRotation>,
    seen: &Seen,
    sections: &mut Vec<Section>,
    notes: &mut Vec<String>,
) -> Result<State, RecordingError> {
    let opens = || row.alone().is_some_and(|t| t.parse::<f64>().is_err());
    match state {
        State::Over if row.is_blank() => Ok(State::Above(Preamble::default())),
        State::Above(_) if row.is_blank() => Ok(state),
        State::Above(preamble) if row.text(0).eq_ignore_ascii_case("frame") => {
            columns_of(preamble, row, notes)
        }
        State::Above(mut preamble) => {
            preamble.take(row);
            Ok(State::Above(preamble))
        }
        State::Units {
            preamble,
            format,
            columns,
        } => {
            if row.text(0).parse::<f64>().is_ok() {
                return Err(row.refuse(
                    0,
                    "the line of units (mm, deg, ...) is missing below the column names",
                ));
            }
            let source = Source {
                title: &preamble.title,
                format,
                names: &preamble.names,
                columns: &columns,
                wanted,
            };
            let blocks = blocks(&source, row, notes)?;
            let rate_hz = preamble.rate_hz.unwrap_or_default();
            let sub = has_sub_frame(&columns);
            let section = Section::new(format, rate_hz, &blocks, sub);
            Ok(State::Rows(section, blocks))
        }
        State::Rows(section, _) if row.is_blank() => {
            sections.push(section);
            Ok(State::Above(Preamble::default()))
        }
        // A title without an empty line above it.
        State::Rows(section, _) if opens() => {
            sections.push(section);
            let mut preamble = Preamble::default();
            preamble.take(row);
            Ok(State::Above(preamble))
        }
        State::Rows(mut section, blocks) => {
            take_row(&mut section, &blocks, row)?;
            if !seen.allows(section.frames.len(), blocks.len()) {
                return Err(row.too_much());
            }
            seen.hold(row.path(), blocks.len())?;
            Ok(State::Rows(section, blocks))
        }
        State::Over if opens() => {
            let mut preamble = Preamble::default();
            preamble.take(row);
            Ok(State::Above(preamble))
        }
        State::Over => Ok(State::Over),
    }
}

/// The line of column names: what follows depends on the section above it.
fn columns_of(
    preamble: Preamble,
    row: &Row<'_>,
    notes: &mut Vec<String>,
) -> Result<State, RecordingError> {
    if row.text(1).to_ascii_lowercase().starts_with("time") {
        return Err(row.refuse(
            1,
            "this looks like an OptiTrack Motive export without its header: export it with the header",
        ));
    }
    let Some(format) = preamble.format() else {
        let title = if preamble.title.is_empty() {
            "without a title".to_owned()
        } else {
            format!("'{}'", preamble.title)
        };
        notes.push(format!("a section {title} was ignored"));
        return Ok(State::Over);
    };
    let sound = |(r, _)| r > 0.0 && r <= RATE_MAX_HZ;
    if !preamble.rate_hz.is_some_and(sound) {
        return Err(row.refuse(
            0,
            "the frame rate in Hz is missing: it must stand alone on a line between the section's title and its names",
        ));
    }
    if preamble.names.iter().all(String::is_empty) {
        return Err(row.refuse(0, "the line of names is missing above the column names"));
    }
    Ok(State::Units {
        preamble,
        format,
        columns: row.to_texts(),
    })
}

fn take_row(section: &mut Section, blocks: &[Block], row: &Row<'_>) -> Result<(), RecordingError> {
    row.check_whole(section.columns)?;
    let frame = row.frame(section.frames.last().copied())?;
    if section.has_sub_frame && row.number(1)?.is_some_and(|v| v != 0.0) {
        return Err(row.refuse(
            1,
            "a sub frame other than 0: export markers and objects at the cameras' rate",
        ));
    }
    let (mut markers, mut objects) = (section.markers.iter_mut(), section.objects.iter_mut());
    for block in blocks {
        match &block.track {
            Track::Marker(at) => {
                let position = at.read(row)?.map(Vector3::from);
                if let Some((_, to)) = markers.next() {
                    to.push(position);
                }
            }
            Track::Object(at, turn) => {
                let pose = match (at.read(row)?, turn.read(row, &block.name)?) {
                    (Some(at_m), Some(rotation)) => Some(super::rotation::pose(at_m, rotation)),
                    _ => None,
                };
                if let Some((_, to)) = objects.next() {
                    to.push(pose);
                }
            }
        }
    }
    section.frames.push(frame);
    Ok(())
}
