//! Bags of other labs, read by a map of their topics (TOML): [`super::tables`].

use std::collections::BTreeSet;
use std::io::Read;
use std::path::Path;

use super::records::{End, refuse};
use super::rows::Rows;
use super::series::{Collected, Series, Wanted, What, collect};
use super::tables::{Source, Tables};
use crate::recording::{MappedLog, RecordingError, SizeLimit, file_sha256};
use crate::signal::toml_error;

/// Largest map that is read.
const MAP: SizeLimit = SizeLimit::of_kind(64 << 10, "a map of topics");
/// Clocks of headers and of the bag that are further apart than this are not one, s.
const APART_S: f64 = 1.0;

/// What the topics of a lab's bags hold.
#[derive(Clone, Debug)]
pub struct BagMap {
    tables: Tables,
    /// In the order in which [`BagMap::read_bag`] takes them: rows, pressures, commands, springs, IMUs, payload, bodies.
    wanted: Vec<Wanted>,
}

/// A bag as its map reads it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MappedBag {
    /// Its columns. Times count from the first row.
    pub log: MappedLog,
    /// What the reader should know, a sentence each.
    pub notes: Vec<String>,
}

impl BagMap {
    /// Reads a map.
    ///
    /// # Errors
    /// [`RecordingError::Session`] with line and column, or the table that is wrong.
    pub fn read(path: &Path) -> Result<Self, RecordingError> {
        Self::from_toml(&MAP.read_text(path)?).map_err(|text| RecordingError::Session {
            path: path.to_owned(),
            text,
        })
    }

    /// A map from its text.
    ///
    /// # Errors
    /// One sentence: what is wrong, with line and column for syntax.
    pub fn from_toml(text: &str) -> Result<Self, String> {
        let tables: Tables = toml::from_str(text).map_err(|e| toml_error(text, &e))?;
        tables.check()?;
        let mut wanted = Vec::new();
        let mut add = |sources: &[Source], what: What| {
            for source in sources {
                if let Source::Field(field) = source {
                    wanted.push(Wanted::parse(field, what)?);
                }
            }
            Ok::<(), String>(())
        };
        for table in [
            Some(&tables.pressure),
            tables.command.as_ref(),
            tables.springs.as_ref(),
        ] {
            add(table.map_or(&[], |t| &t.fields), What::Number)?;
        }
        if let Some(imus) = &tables.imus {
            add(imus.orientations.as_deref().unwrap_or_default(), What::Turn)?;
            add(imus.fields.as_deref().unwrap_or_default(), What::Number)?;
        }
        if let Some(payload) = &tables.payload {
            add(std::slice::from_ref(&payload.field), What::Number)?;
        }
        let bodies = [
            &tables.bodies.base,
            &tables.bodies.middle,
            &tables.bodies.end,
        ];
        for body in bodies.into_iter().flatten() {
            add(&[Source::Field(body.clone())], What::Place)?;
        }
        // The rows are the messages of a topic, whatever is read of it.
        if !wanted.iter().any(|w| w.topic == tables.rows) {
            return Err(format!(
                "rows = '{}' is a topic of which the map reads nothing: name the topic of the springs or the pressures",
                tables.rows
            ));
        }
        Ok(Self { tables, wanted })
    }

    /// Reads a bag.
    ///
    /// # Errors
    /// [`RecordingError::Session`] for topics and fields that are not there, messages that are not understood, and clocks that
    /// jump back or differ; [`RecordingError::Unsupported`] for what is no MCAP file; [`RecordingError::TooLarge`].
    pub fn log(&self, path: &Path) -> Result<MappedBag, RecordingError> {
        let file = SizeLimit::memory(u64::MAX).open(path)?;
        let mut bag = self.read_bag(file, path)?;
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        bag.log.name = name.into_owned();
        bag.log.hash = file_sha256(path)?;
        Ok(bag)
    }

    /// Reads the bytes of a bag. `path` is for refusals.
    ///
    /// # Errors
    /// As [`Self::log`].
    pub fn read_bag(&self, source: impl Read, path: &Path) -> Result<MappedBag, RecordingError> {
        let t = &self.tables;
        let mut read = collect(source, path, &self.wanted, t.clock, "")?;
        let refuse = |text: String| refuse(path, &text);
        if let Some(absent) = self
            .wanted
            .iter()
            .find(|w| !read.topics.contains_key(&w.topic))
        {
            let text = format!(
                "the map asks for the topic {}, and {}",
                absent.topic,
                read.names_text()
            );
            return Err(refuse(text));
        }
        for (series, wanted) in read.series.iter_mut().zip(&self.wanted) {
            series
                .in_order()
                .map_err(|text| refuse(format!("{}: {text}", wanted.topic)))?;
        }
        self.check_clocks(&read).map_err(&refuse)?;
        let rows_ns = self.rows(&read).map_err(&refuse)?;
        let Some(origin) = rows_ns.first().copied() else {
            return Err(refuse(format!(
                "{} has no message: name another topic as rows",
                t.rows
            )));
        };
        let mut rows = Rows {
            tables: t,
            wanted: &self.wanted,
            read: &read,
            stamps_ns: &rows_ns,
            origin,
            next: 0,
        };
        let log = rows.log().map_err(&refuse)?;
        let notes = self.notes(&read, &log, origin);
        Ok(MappedBag { log, notes })
    }

    /// The rows' times: all messages of their topic.
    fn rows(&self, read: &Collected) -> Result<Vec<i64>, String> {
        let of_rows = self.wanted.iter().zip(&read.series);
        let of_rows = of_rows.filter(|(w, _)| w.topic == self.tables.rows);
        let all: BTreeSet<i64> = of_rows
            .flat_map(|(_, s)| s.stamps_ns.iter().copied())
            .collect();
        Ok(all.into_iter().collect())
    }

    /// Refuses topics whose times are of different clocks: those of headers as far as they are off the bag's.
    fn check_clocks(&self, read: &Collected) -> Result<(), String> {
        let all = || self.wanted.iter().zip(&read.series);
        let topic = |(w, _): (&Wanted, &Series)| w.topic.clone();
        let by_log = all().find(|(_, s)| s.by_clock[1] > 0);
        // One message may have waited long before it was recorded.
        let headers = || {
            let offset = |(w, s): (&Wanted, &Series)| Some((w.topic.clone(), s.offset_s?));
            all().filter(|(_, s)| s.by_clock[0] > 1).filter_map(offset)
        };
        let first = headers().min_by(|a, b| a.1.total_cmp(&b.1));
        let last = headers().max_by(|a, b| a.1.total_cmp(&b.1));
        let (Some(first), Some(last)) = (first, last) else {
            return Ok(());
        };
        let far = if first.1.abs() > last.1.abs() {
            &first
        } else {
            &last
        };
        let other = match by_log.map(topic) {
            Some(log) if far.1.abs() > APART_S => format!("{log} has no stamps"),
            _ if last.1 - first.1 > APART_S => {
                let near = if far == &first { &last } else { &first };
                format!("those of {} {:.1} s", near.0, near.1)
            }
            _ => return Ok(()),
        };
        Err(format!(
            "the stamps of {} are {:.1} s off the times at which the bag received them, and {other}: set clock = \"log\"",
            far.0, far.1
        ))
    }

    fn notes(&self, read: &Collected, log: &MappedLog, origin: i64) -> Vec<String> {
        const SECOND_NS: i64 = 1_000_000_000;
        let mut notes = vec![format!(
            "0 s is the first row, {}.{:09} s on the clock of {}",
            origin.div_euclid(SECOND_NS),
            origin.rem_euclid(SECOND_NS),
            self.tables.rows
        )];
        let topics = |clock: usize| -> Vec<&str> {
            let with = self.wanted.iter().zip(&read.series);
            let with = with.filter(|(_, s)| s.by_clock[clock] > 0);
            let names: BTreeSet<&str> = with.map(|(w, _)| w.topic.as_str()).collect();
            names.into_iter().collect()
        };
        for (clock, what) in [
            (0, "the stamps of the headers"),
            (1, "when the bag received them"),
        ] {
            let names = topics(clock);
            if !names.is_empty() {
                notes.push(format!("times of {}: {what}", names.join(", ")));
            }
        }
        let mut repeated: Vec<String> = Vec::new();
        for (wanted, series) in self.wanted.iter().zip(&read.series) {
            let text = format!("{} of {}", series.repeated, wanted.topic);
            if series.repeated > 0 && !repeated.contains(&text) {
                repeated.push(text);
            }
        }
        if !repeated.is_empty() {
            notes.push(format!(
                "messages with the time of the one before are left out: {}",
                repeated.join(", ")
            ));
        }
        let mut steps: Vec<(f64, f64)> = log.t_s.windows(2).map(|w| (w[1] - w[0], w[0])).collect();
        steps.sort_by(|a, b| a.0.total_cmp(&b.0));
        let usual_s = steps.get(steps.len() / 2).map_or(0.0, |s| s.0);
        if let Some((longest_s, at_s)) = steps.last().filter(|s| s.0 > 5.0 * usual_s) {
            notes.push(format!(
                "the longest gap between rows is {longest_s:.2} s, at {at_s:.2} s"
            ));
        }
        if read.end == End::Cut {
            notes.push("the file ends within a record: what is before it was read".to_owned());
        }
        notes
    }
}
