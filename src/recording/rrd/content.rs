//! What is taken from a file's tables, and the snapshots made of it.

mod columns;
mod snapshots;

use std::collections::BTreeMap;
use std::path::Path;

use arrow::array::{Array, AsArray};
use rerun::log::Chunk;
use rerun::{ComponentIdentifier, Scalars, TextLog, TimelineName};

use super::plain::{Kind, Plain, words};
use super::schema::{self, SPECS, table};
use crate::recording::{RecordedEvent, RecordingError, RecordingMeta};
use crate::signal::Stamp;
pub(super) use columns::Rows;
use columns::{take_f64, take_i64};
pub(super) use snapshots::{Carried, Part};

/// Tables whose scalars snapshots are made of.
const SCALARS_USED: std::ops::RangeInclusive<usize> = table::COUNTS..=table::RAW_PRESSURE;

/// Span of one entity on the timeline.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    pub(super) rows: u64,
    pub(super) first: i64,
    pub(super) last: i64,
}

impl Span {
    /// Of some times; `None` without any.
    fn of(times: impl Iterator<Item = i64>) -> Option<Self> {
        let mut span: Option<Self> = None;
        for t in times {
            let s = span.get_or_insert(Self {
                rows: 0,
                first: t,
                last: t,
            });
            s.rows += 1;
            s.first = s.first.min(t);
            s.last = s.last.max(t);
        }
        span
    }

    pub(super) fn add(&mut self, other: Self) {
        self.rows += other.rows;
        self.first = self.first.min(other.first);
        self.last = self.last.max(other.last);
    }
}

/// Spans by entity.
pub(super) type Spans = BTreeMap<String, Span>;

/// Adds spans to those of the same entities.
pub(super) fn add_spans(spans: &mut Spans, more: Spans) {
    for (name, span) in more {
        match spans.get_mut(&name) {
            Some(s) => s.add(span),
            None => {
                spans.insert(name, span);
            }
        }
    }
}

/// Everything taken from a file's chunks.
pub(super) struct Content {
    scalars: Vec<Rows<f64>>,
    exact: Vec<Rows<f64>>,
    ints: Vec<Rows<i64>>,
    pub(super) events: Vec<RecordedEvent>,
    pub(super) spans: Spans,
    pub(super) properties: BTreeMap<String, String>,
    /// Whether it is a comparison for the viewer.
    is_comparison: bool,
}

impl Default for Content {
    fn default() -> Self {
        Self {
            scalars: SPECS.iter().map(|s| Rows::new(s.scalars)).collect(),
            exact: SPECS.iter().map(|s| Rows::new(s.exact)).collect(),
            ints: SPECS.iter().map(|s| Rows::new(s.ints)).collect(),
            events: Vec::new(),
            spans: BTreeMap::new(),
            properties: BTreeMap::new(),
            is_comparison: false,
        }
    }
}

impl Content {
    /// Clears the rows and keeps their capacity; properties of the file as a whole stay.
    pub(super) fn clear_rows(&mut self) {
        self.scalars.iter_mut().for_each(Rows::clear);
        self.exact.iter_mut().for_each(Rows::clear);
        self.ints.iter_mut().for_each(Rows::clear);
    }

    /// Whether an entity's numbers are taken.
    pub(super) fn wants(entity: &str) -> bool {
        schema::LOGS.contains(&entity)
            || SPECS
                .iter()
                .any(|s| s.path == entity || s.exact_path == entity)
    }

    /// Whether a table closes a batch.
    pub(super) fn closes(entity: &str) -> bool {
        entity == SPECS[table::TICK].exact_path
    }

    /// First and last time of all rows that snapshots are made of.
    pub(super) fn extent(&self) -> Option<(i64, i64)> {
        let floats = self.scalars.iter().chain(&self.exact).map(|r| &r.times);
        let all = floats.chain(self.ints.iter().map(|r| &r.times));
        let span = Span::of(all.flatten().copied())?;
        Some((span.first, span.last))
    }

    fn add_span(&mut self, path: &str, times: impl Iterator<Item = i64>) {
        let Some(span) = Span::of(times) else {
            return;
        };
        match self.spans.get_mut(path) {
            Some(s) => s.add(span),
            None => {
                self.spans.insert(path.to_owned(), span);
            }
        }
    }

    /// Takes a plain table; `false`, with nothing taken, when something in it is not as expected.
    pub(super) fn take_plain(&mut self, plain: &Plain<'_>) -> bool {
        let scalars = Scalars::descriptor_scalars().component;
        let mut places = Vec::with_capacity(plain.lists.len());
        for list in &plain.lists {
            let spec = |of: fn(&schema::Spec, &str) -> bool| {
                SPECS.iter().position(|s| of(s, plain.entity))
            };
            let is_scalars = list.component == scalars.as_str();
            let place = if is_scalars {
                spec(|s, entity| s.path == entity)
            } else if [schema::EXACT, schema::INTS].contains(&list.component) {
                spec(|s, entity| s.exact_path == entity || s.path == entity)
            } else {
                None
            };
            // Scalars that only repeat exact values in another unit are for viewers.
            let Some(i) = place.filter(|i| !is_scalars || SCALARS_USED.contains(i)) else {
                continue;
            };
            let (kind, width) = match list.component {
                schema::INTS => (Kind::Int, SPECS[i].ints),
                schema::EXACT => (Kind::Float, SPECS[i].exact),
                _ => (Kind::Float, SPECS[i].scalars),
            };
            if (kind, width) != (list.kind, list.width) {
                return false;
            }
            places.push((i, is_scalars, list));
        }
        for (i, is_scalars, list) in places {
            let times = words(plain.times, i64::from_le_bytes);
            if list.kind == Kind::Int {
                let rows = &mut self.ints[i];
                rows.times.extend(times);
                rows.values.extend(words(list.values, i64::from_le_bytes));
                continue;
            }
            let rows = if is_scalars {
                &mut self.scalars[i]
            } else {
                &mut self.exact[i]
            };
            rows.times.extend(times);
            rows.values.extend(words(list.values, f64::from_le_bytes));
        }
        self.add_span(plain.entity, words(plain.times, i64::from_le_bytes));
        true
    }

    /// Takes what is known of a chunk, and its extent.
    pub(super) fn take(&mut self, chunk: &Chunk) -> Result<(), String> {
        let path = chunk.entity_path().to_string();
        if chunk.is_static() {
            if path == format!("/__properties/{}", schema::PROPERTY) {
                self.take_properties(chunk);
            }
            self.is_comparison |= path == format!("/__properties/{}", schema::COMPARISON);
            return Ok(());
        }
        let timeline = TimelineName::try_new(schema::TIMELINE).map_err(|e| e.to_string())?;
        let Some(times) = chunk.timelines().get(&timeline) else {
            return Ok(());
        };
        let times = times.times_raw();
        self.add_span(&path, times.iter().copied());
        if schema::LOGS.contains(&path.as_str()) {
            self.take_log(chunk, times, path.trim_start_matches('/'));
        }
        let scalars = Scalars::descriptor_scalars().component;
        let [exact, ints] = [schema::EXACT, schema::INTS].map(ComponentIdentifier::from);
        let place = |e: String| format!("{path}: {e}");
        let scalars_at = SPECS.iter().position(|s| s.path == path);
        if let Some(i) = scalars_at.filter(|i| SCALARS_USED.contains(i)) {
            take_f64(&mut self.scalars[i], chunk, times, scalars).map_err(place)?;
        }
        // Recordings of the first days have the exact values beside the scalars.
        let exact_at = |s: &schema::Spec| s.exact_path == path || s.path == path;
        if let Some(i) = SPECS.iter().position(exact_at) {
            take_f64(&mut self.exact[i], chunk, times, exact).map_err(place)?;
            take_i64(&mut self.ints[i], chunk, times, ints).map_err(place)?;
        }
        Ok(())
    }

    fn take_properties(&mut self, chunk: &Chunk) {
        for descriptor in chunk.component_descriptors() {
            let name = descriptor.component.as_str();
            let Some(key) = name.strip_prefix("springtwin:") else {
                continue;
            };
            if let Some(value) = chunk
                .components()
                .get_array(descriptor.component)
                .and_then(|list| list.values().as_string_opt::<i32>())
                .filter(|strings| !strings.is_empty() && strings.is_valid(0))
            {
                self.properties
                    .insert(key.to_owned(), value.value(0).to_owned());
            }
        }
    }

    fn take_log(&mut self, chunk: &Chunk, times: &[i64], log: &str) {
        let list = chunk
            .components()
            .get_array(TextLog::descriptor_text().component);
        let Some(list) = list else {
            return;
        };
        for (i, t) in times.iter().enumerate() {
            if list.is_null(i) {
                continue;
            }
            let row = list.value(i);
            if let Some(text) = row.as_string_opt::<i32>()
                && !text.is_empty()
                && text.is_valid(0)
            {
                self.events.push(RecordedEvent {
                    stamp: Stamp(*t),
                    log: log.to_owned(),
                    text: text.value(0).to_owned(),
                });
            }
        }
    }

    pub(super) fn property(&self, key: &str) -> String {
        self.properties.get(key).cloned().unwrap_or_default()
    }

    pub(super) fn check_schema(&self, path: &Path) -> Result<(), RecordingError> {
        let refuse = |text: String| RecordingError::Unsupported {
            path: path.to_owned(),
            text,
        };
        match self.property("schema").parse::<u32>() {
            Ok(schema::SCHEMA_VERSION) => Ok(()),
            Ok(version) => Err(refuse(format!(
                "the recording has layout {version}; this program reads {}",
                schema::SCHEMA_VERSION
            ))),
            Err(_) if self.is_comparison => Err(refuse(
                "this is the comparison that `gap run` writes for the Rerun viewer, not a session: look at it with \
                 `rerun FILE`, and give the session or recording that it was made of"
                    .to_owned(),
            )),
            Err(_) if self.spans.is_empty() => Err(refuse(
                "the recording was cut before its first data: nothing can be recovered".to_owned(),
            )),
            Err(_) => Err(refuse(
                "the recording was not made by this program".to_owned(),
            )),
        }
    }

    /// The session as a whole.
    pub(super) fn meta(&self) -> RecordingMeta {
        RecordingMeta {
            name: self.property("name"),
            robot: self.property("robot"),
            robot_hash: self.property("robot_hash"),
            source: self.property("source"),
            simulated: self.property("simulated").parse().ok(),
            payload_kg: self.property("payload_kg").parse().unwrap_or(0.0),
            begun: self.property("begun"),
            calibration: self.property("calibration"),
            program: self.property("program"),
            drawing: None,
        }
    }
}
